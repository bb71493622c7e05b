//! Bright lines of an image with subpixel accuracy.
//!
//! In: an image and the smoothing scale `s`. Out: for every pixel on a bright line its nearest point on the
//! line, the line's direction and its strength.
//!
//! Across a line, along the eigenvector n of the Hessian with the eigenvalue λ of greatest size, the smoothed
//! brightness is `I + g·n t + λ t²/2`: its top lies at `t = −g·n/λ`. White noise of σ in the image moves
//! that by `σ / (√(8π) s² |λ|)`, and along the line by errors that are correlated as `exp(−Δ²/4s²)`.
//!
//! # References
//! - Steger, *An unbiased detector of curvilinear structures*, PAMI 1998, equations 13–18.

use rayon::prelude::*;

use crate::Image;

/// Minimum strength of a line as a share of the typical strong line; weaker lines are texture or noise.
const MIN_STRENGTH: f64 = 0.15;
/// Radius of kernels in scales, where a Gaussian has decayed to 3·10⁻⁴.
const KERNEL_SCALES: f64 = 4.0;

/// A point on a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ridge {
    /// Position in pixels.
    pub place: [f64; 2],
    /// Unit vector along the line, either way.
    pub direction: [f64; 2],
    /// `−λ`: how sharply brightness falls off across.
    pub strength: f64,
}

/// The bright lines of an image.
pub(super) struct Ridges {
    columns: usize,
    rows: usize,
    at: Vec<Option<Ridge>>,
    /// Smoothing scale in pixels.
    pub scale: f64,
}

/// Smoothed derivatives of an image.
pub(super) struct Derivatives {
    /// The gradient.
    pub slopes: [Image; 2],
    /// The Hessian.
    pub xx: Vec<f32>,
    pub xy: Vec<f32>,
    pub yy: Vec<f32>,
}

impl Derivatives {
    /// Derivatives at a scale, by separable kernels; border pixels are repeated outwards.
    pub fn new(image: &Image, scale: f64) -> Self {
        let kernels = [0, 1, 2].map(|order| kernel(scale, order));
        let rows = [0, 1, 2].map(|order| along_rows(image, &kernels[order]));
        let down = |of: &Vec<f32>, order: usize| along_columns(of, image.columns, &kernels[order]);
        let image_of = |values: Vec<f32>| Image { columns: image.columns, rows: image.rows, values };
        Self {
            slopes: [image_of(down(&rows[1], 0)), image_of(down(&rows[0], 1))],
            xx: down(&rows[2], 0),
            xy: down(&rows[1], 1),
            yy: down(&rows[0], 2),
        }
    }

    /// The eigenvalues of the Hessian at a pixel, that of greatest size first, and the unit eigenvector of
    /// the first.
    pub fn bend(&self, k: usize) -> ([f64; 2], [f64; 2]) {
        let (a, b, c) = (f64::from(self.xx[k]), f64::from(self.xy[k]), f64::from(self.yy[k]));
        let (mean, half) = (0.5 * (a + c), (0.25 * (a - c) * (a - c) + b * b).sqrt());
        let first = if mean < 0.0 { mean - half } else { mean + half };
        // The angle of the eigenvector of the larger eigenvalue; that of the smaller is perpendicular.
        let angle = 0.5 * (2.0 * b).atan2(a - c);
        let (sin, cos) = angle.sin_cos();
        let vector = if mean < 0.0 { [-sin, cos] } else { [cos, sin] };
        ([first, 2.0 * mean - first], vector)
    }
}

/// Samples of a Gaussian or of its first or second derivative, for a correlation.
fn kernel(scale: f64, order: usize) -> Vec<f32> {
    let reach = (KERNEL_SCALES * scale).ceil() as i64;
    let gauss = |t: f64| (-0.5 * t * t / (scale * scale)).exp() / (std::f64::consts::TAU.sqrt() * scale);
    let weight_at = |i: i64| {
        let t = i as f64;
        let factor = match order {
            0 => 1.0,
            // The sign differs from that of a convolution, because the kernel is used for correlation.
            1 => t / (scale * scale),
            _ => (t * t / (scale * scale) - 1.0) / (scale * scale),
        };
        factor * gauss(t)
    };
    let mut values: Vec<f64> = (-reach..=reach).map(weight_at).collect();
    // Sampling and truncation change the moments; the second derivative of a constant must be zero.
    let sum: f64 = values.iter().sum();
    match order {
        0 => values.iter_mut().for_each(|v| *v /= sum),
        2 => {
            let share = sum / values.len() as f64;
            values.iter_mut().for_each(|v| *v -= share);
        }
        _ => {}
    }
    values.into_iter().map(|v| v as f32).collect()
}

fn along_rows(image: &Image, kernel: &[f32]) -> Vec<f32> {
    let (columns, reach) = (image.columns, kernel.len() / 2);
    let mut out = vec![0.0; image.values.len()];
    out.par_chunks_mut(columns).enumerate().for_each(|(y, out)| {
        // A padded copy instead of a test of the border at every tap: the inner loop vectorises.
        let row = image.row(y);
        let mut padded = vec![row[0]; reach];
        padded.extend_from_slice(row);
        padded.resize(columns + 2 * reach, row[columns - 1]);
        for (value, window) in out.iter_mut().zip(padded.windows(kernel.len())) {
            *value = window.iter().zip(kernel).map(|(a, k)| a * k).sum();
        }
    });
    out
}

fn along_columns(values: &[f32], columns: usize, kernel: &[f32]) -> Vec<f32> {
    let (rows, reach) = (values.len() / columns, kernel.len() / 2);
    let mut out = vec![0.0; values.len()];
    out.par_chunks_mut(columns).enumerate().for_each(|(y, out)| {
        for (i, weight) in kernel.iter().enumerate() {
            let from = (y + i).saturating_sub(reach).min(rows - 1);
            // Whole rows are added, so memory is read in order. Columns one by one would use one value of
            // each cache line.
            let row = &values[from * columns..][..columns];
            out.iter_mut().zip(row).for_each(|(o, v)| *o += weight * v);
        }
    });
    out
}

/// Values on a raster, smoothed by a Gaussian.
pub(super) fn smoothed(values: Vec<f32>, columns: usize, scale: f64) -> Vec<f32> {
    let (kernel, rows) = (kernel(scale, 0), values.len() / columns);
    let image = Image { columns, rows, values };
    along_columns(&along_rows(&image, &kernel), columns, &kernel)
}

/// Typical strength of strong lines: the mean weighted by strength, in which many weak lines count little.
pub(super) fn typical(strengths: impl Iterator<Item = f64>) -> f64 {
    let (sum, squares) = strengths.fold((0.0, 0.0), |(sum, squares), s| (sum + s, squares + s * s));
    if sum > 0.0 { squares / sum } else { 0.0 }
}

impl Ridges {
    /// The bright lines of an image.
    pub fn new(image: &Image, scale: f64) -> Self {
        let bent = Derivatives::new(image, scale);
        let (columns, rows) = (image.columns, image.rows);
        let mut at: Vec<Option<Ridge>> = (0..columns * rows)
            .into_par_iter()
            .with_min_len(columns)
            .map(|k| {
                let ([bend, _], across) = bent.bend(k);
                let pixel = [(k % columns) as f64, (k / columns) as f64];
                let at = |off: f64| [0, 1].map(|c| pixel[c] + off * across[c]);
                // The profile is not a parabola, so a second Newton step starts from the first one.
                let step = |off: f64| {
                    let [u, v] = at(off);
                    let [x, y] = [0, 1].map(|c| bent.slopes[c].between(u, v).map_or(f64::NAN, f64::from));
                    -(x * across[0] + y * across[1]) / bend
                };
                let first = step(0.0);
                let off = first + step(first);
                // Slightly more than half a pixel, so that no line is lost between two pixels.
                let inside = across.iter().all(|c| (c * off).abs() <= 0.6);
                let is_ridge = bend < 0.0 && inside && first.abs() <= 1.0 && (off - first).abs() <= 0.2;
                is_ridge.then(|| Ridge {
                    place: at(off),
                    direction: [-across[1], across[0]],
                    strength: -bend,
                })
            })
            .collect();
        // The threshold is relative to the image itself, because strength depends on exposure and contrast.
        let minimum = MIN_STRENGTH * typical(at.iter().flatten().map(|r| r.strength));
        at.iter_mut().for_each(|r| *r = r.filter(|r| r.strength > 0.0 && r.strength >= minimum));
        Self { columns, rows, at, scale }
    }

    /// All points on lines.
    pub fn all(&self) -> impl Iterator<Item = &Ridge> {
        self.at.iter().flatten()
    }

    /// The points on lines whose pixels lie within `reach` of a position in both coordinates.
    pub fn near(&self, place: [f64; 2], reach: f64) -> impl Iterator<Item = &Ridge> {
        let span = |c: f64, n: usize| {
            let from = (c - reach).ceil().max(0.0) as usize;
            from..((c + reach).floor() + 1.0).clamp(0.0, n as f64) as usize
        };
        let across = span(place[0], self.columns);
        span(place[1], self.rows).flat_map(move |y| {
            let row = &self.at[y * self.columns..][..self.columns];
            row.get(across.clone()).into_iter().flatten().flatten()
        })
    }

    /// σ of a point on a line of strength one, to be divided by [`Ridge::strength`]. `sigma_brightness` is
    /// the σ of a pixel's brightness.
    pub fn unit_sigma(&self, sigma_brightness: f64) -> f64 {
        sigma_brightness / ((8.0 * std::f64::consts::PI).sqrt() * self.scale * self.scale)
    }

    /// Correlation of the errors of two points on one line at a distance in pixels.
    pub fn correlation(&self, apart: f64) -> f64 {
        (-0.25 * (apart / self.scale).powi(2)).exp()
    }
}

/// σ of pixels brighter than `darkest`, from the median of second differences along both axes, in which
/// smooth brightness cancels.
///
/// # References
/// Immerkær, *Fast noise variance estimation*, CVIU 1996, with a median in place of the mean.
pub(super) fn sigma_of_brightness(image: &Image, darkest: f32) -> f64 {
    let mut found = Vec::new();
    for y in 1..image.rows.saturating_sub(1) {
        for x in 1..image.columns.saturating_sub(1) {
            let p = |i: usize, j: usize| image.at(x + i - 1, y + j - 1);
            if p(1, 1) < darkest {
                continue;
            }
            // The kernel [1 −2 1] in both directions: linear and bilinear brightness cancel.
            let sides = p(1, 0) + p(0, 1) + p(2, 1) + p(1, 2);
            let corners = p(0, 0) + p(2, 0) + p(0, 2) + p(2, 2);
            found.push((corners - 2.0 * sides + 4.0 * p(1, 1)).abs());
        }
    }
    let middle = found.len() / 2;
    if found.is_empty() {
        return 0.0;
    }
    let (_, median, _) = found.select_nth_unstable_by(middle, f32::total_cmp);
    // The kernel's norm is 6; 0.6745 σ is the median of |N(0, σ²)|.
    f64::from(*median) / (6.0 * 0.6745)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A bright line through (20.3, 20) at an angle.
    fn line(angle: f64, sigma: f64, seed: u64) -> Image {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (sin, cos) = angle.sin_cos();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let values = (0..41 * 41).map(|k| {
            let (x, y) = ((k % 41) as f64 - 20.3, (k / 41) as f64 - 20.0);
            let off = -sin * x + cos * y;
            (30.0 + 150.0 * (-0.5 * (off / 1.6).powi(2)).exp() + sigma * normal()) as f32
        });
        Image::try_new(41, 41, values.collect()).unwrap()
    }

    fn off(r: &Ridge, angle: f64) -> f64 {
        -angle.sin() * (r.place[0] - 20.3) + angle.cos() * (r.place[1] - 20.0)
    }

    #[test]
    fn points_on_a_line_have_subpixel_accuracy() {
        for angle in [0.0, 0.3, 0.8, 1.4, 2.2] {
            let ridges = Ridges::new(&line(angle, 0.0, 0), 1.5);
            let found: Vec<&Ridge> = ridges.near([20.0, 20.0], 10.0).collect();
            assert!(found.len() >= 20, "{}", found.len());
            for r in found {
                assert!(off(r, angle).abs() < 0.04, "{angle}: {r:?}");
                let turned = r.direction[0] * angle.sin() - r.direction[1] * angle.cos();
                assert!(turned.abs() < 3e-3, "{angle}: {r:?}");
            }
        }
    }

    #[test]
    fn sigma_and_correlation_match_a_simulation() {
        let (angle, sigma) = (0.0, 3.0);
        let (mut squares, mut stated, mut products, mut n) = (0.0, 0.0, 0.0, 0.0);
        for seed in 0..400 {
            let ridges = Ridges::new(&line(angle, sigma, seed), 1.5);
            let at = |x: f64| ridges.near([x, 20.0], 1.0).find(|r| (r.place[0] - x).abs() < 0.3).copied();
            if let (Some(a), Some(b)) = (at(15.0), at(17.0)) {
                squares += off(&a, angle).powi(2);
                products += off(&a, angle) * off(&b, angle);
                stated += (ridges.unit_sigma(sigma) / a.strength).powi(2);
                n += 1.0;
            }
        }
        assert!(n > 390.0);
        // The standard error of a variance from 400 draws is 7 %.
        assert!((squares / stated - 1.0).abs() < 0.2, "{}", squares / stated);
        let expected = (-0.25_f64 * (2.0_f64 / 1.5).powi(2)).exp();
        assert!((products / squares - expected).abs() < 0.12, "{}", products / squares);
    }

    #[test]
    fn lines_do_not_affect_the_estimated_noise() {
        let found = sigma_of_brightness(&line(0.7, 4.0, 5), 0.0);
        assert!((found / 4.0 - 1.0).abs() < 0.12, "{found}");
    }
}
