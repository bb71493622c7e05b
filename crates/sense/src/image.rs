//! Brightness on a raster of pixels.

use planish_estimate::{Error, Result};

/// A picture of one channel: what a camera saw, row by row from the top, with pixel centres at integers.
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
    /// [`Input`](planish_estimate::ErrorKind::Input) where there are not as many values as pixels, or no pixels at all.
    pub fn try_new(columns: usize, rows: usize, values: Vec<f32>) -> Result<Self> {
        if values.is_empty() || columns.checked_mul(rows) != Some(values.len()) {
            return Err(Error::input(format!(
                "needed {columns} × {rows} pixels, found {} values",
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
        let inside =
            |t: f64, n: usize| (t >= 0.0 && t <= (n - 1) as f64).then(|| (t as usize).min(n.saturating_sub(2)));
        let (i, j) = (inside(u, self.columns)?, inside(v, self.rows)?);
        let (s, t) = ((u - i as f64) as f32, (v - j as f64) as f32);
        let (right, below) = ((i + 1).min(self.columns - 1), (j + 1).min(self.rows - 1));
        let upper = (1.0 - s) * self.at(i, j) + s * self.at(right, j);
        let lower = (1.0 - s) * self.at(i, below) + s * self.at(right, below);
        Some((1.0 - t) * upper + t * lower)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_pixels_a_linear_image_is_exact() {
        let values = (0..12).map(|k| (3 * (k % 4) + 10 * (k / 4)) as f32).collect();
        let image = Image::try_new(4, 3, values).unwrap();
        assert_eq!(image.between(1.5, 0.25), Some(7.0));
        assert_eq!(image.between(3.0, 2.0), Some(29.0));
        assert_eq!(image.between(3.01, 0.0), None);
        assert_eq!(image.between(-0.01, 0.0), None);
        assert!(Image::try_new(4, 3, vec![0.0; 11]).is_err());
    }
}
