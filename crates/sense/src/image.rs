//! Images of one channel, with interpolation.

use planish_estimate::{Error, Result};

/// An image of one channel, row by row from the top, with pixel centres at integers.
///
/// # Examples
/// ```
/// use planish_sense::Image;
/// let image = Image::try_new(2, 2, vec![0.0, 1.0, 2.0, 3.0])?;
/// assert_eq!(image.at(1, 0), 1.0);
/// assert_eq!(image.between(0.5, 0.5), Some(1.5));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Image {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Brightness, row by row; the scale is that of the file (0–255 or 0–65535).
    pub values: Vec<f32>,
}

impl Image {
    /// An image of known size.
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) if the numbers of values and pixels differ, or there are
    /// no pixels.
    pub fn try_new(columns: usize, rows: usize, values: Vec<f32>) -> Result<Self> {
        if values.is_empty() || columns.checked_mul(rows) != Some(values.len()) {
            return Err(Error::input(format!(
                "expected {columns} × {rows} pixels, found {} values",
                values.len()
            )));
        }
        Ok(Self { columns, rows, values })
    }

    /// The brightness of a pixel.
    #[inline]
    #[must_use]
    pub fn at(&self, column: usize, row: usize) -> f32 {
        self.values[row * self.columns + column]
    }

    /// The pixels of a row.
    #[inline]
    #[must_use]
    pub fn row(&self, row: usize) -> &[f32] {
        &self.values[row * self.columns..][..self.columns]
    }

    /// The brightness between pixels, bilinear; `None` outside the centres of the border.
    #[inline]
    #[must_use]
    pub fn between(&self, u: f64, v: f64) -> Option<f32> {
        // The last interval includes its end, so that the border itself can be interpolated.
        let inside = |t: f64, n: usize| {
            (t >= 0.0 && t <= (n - 1) as f64).then(|| (t as usize).min(n.saturating_sub(2)))
        };
        let (i, j) = (inside(u, self.columns)?, inside(v, self.rows)?);
        let (s, t) = ((u - i as f64) as f32, (v - j as f64) as f32);
        let (right, below) = ((i + 1).min(self.columns - 1), (j + 1).min(self.rows - 1));
        let upper = (1.0 - s) * self.at(i, j) + s * self.at(right, j);
        let lower = (1.0 - s) * self.at(i, below) + s * self.at(right, below);
        Some((1.0 - t) * upper + t * lower)
    }

    /// The brightness between pixels, by bicubic interpolation (Keys 1981). It is exact at pixels and keeps
    /// more contrast of texture and noise than bilinear interpolation. `None` outside the centres of the
    /// border, and for images of one row or column.
    #[inline]
    #[must_use]
    pub fn smoothly_between(&self, u: f64, v: f64) -> Option<f32> {
        if !(v >= 0.0 && v <= (self.rows - 1) as f64) || self.rows.min(self.columns) < 2 {
            return None;
        }
        let j = (v as usize).min(self.rows - 2);
        let mut near = [0.0; 4];
        for (k, value) in near.iter_mut().enumerate() {
            let row = (j + k).saturating_sub(1).min(self.rows - 1);
            *value = cubic(self.row(row), u as f32)?.0;
        }
        Some(cubic(&near, (v - j as f64) as f32 + 1.0)?.0)
    }
}

/// The value and slope of a row at a position between pixels (Keys 1981, a = −1/2); `None` outside it.
#[inline]
pub(crate) fn cubic(row: &[f32], place: f32) -> Option<(f32, f32)> {
    if !(place >= 0.0 && place <= (row.len() - 1) as f32) {
        return None;
    }
    // Beyond the border its pixel is repeated, so the kernel always has four values.
    let k = (place as usize).min(row.len() - 2);
    let t = place - k as f32;
    let p = [row[k.saturating_sub(1)], row[k], row[k + 1], row[(k + 2).min(row.len() - 1)]];
    let a = 0.5 * (3.0 * (p[1] - p[2]) + p[3] - p[0]);
    let b = p[0] - 2.5 * p[1] + 2.0 * p[2] - 0.5 * p[3];
    let c = 0.5 * (p[2] - p[0]);
    Some((((a * t + b) * t + c) * t + p[1], (3.0 * a * t + 2.0 * b) * t + c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_interpolation_is_exact_for_parabolas() {
        let row: Vec<f32> = (0..12).map(|k| 0.5 * (k * k) as f32 - 3.0 * k as f32).collect();
        for place in [2.0_f32, 4.25, 7.9] {
            let (value, slope) = cubic(&row, place).unwrap();
            assert!((value - (0.5 * place * place - 3.0 * place)).abs() < 1e-4);
            assert!((slope - (place - 3.0)).abs() < 1e-4);
        }
        assert_eq!(cubic(&row, 11.1), None);
    }

    #[test]
    fn linear_interpolation_is_exact_for_linear_images() {
        let values = (0..12).map(|k| (3 * (k % 4) + 10 * (k / 4)) as f32).collect();
        let image = Image::try_new(4, 3, values).unwrap();
        assert_eq!(image.between(1.5, 0.25), Some(7.0));
        assert_eq!(image.between(3.0, 2.0), Some(29.0));
        assert_eq!(image.between(3.01, 0.0), None);
        assert_eq!(image.between(-0.01, 0.0), None);
        assert!(Image::try_new(4, 3, vec![0.0; 11]).is_err());
    }
}
