//! Edges of an image as subpixel points with their σ.
//!
//! In: an [`Image`]. Out: [`EdgePoint`]s, thinned until their errors are nearly independent.
//!
//! Not guaranteed: edges closer to each other than about three pixels. Points near corners are omitted,
//! because blur moves them inwards.

use crate::Image;
use planish_estimate::{Error, Result};

/// Options of [`edge_points`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeOptions {
    /// σ of the Gaussian by which the image is smoothed, in pixels.
    pub smoothing_px: f64,
    /// Minimum gradient of an edge, as a share of the largest in the image.
    pub min_share: f64,
}

impl Default for EdgeOptions {
    fn default() -> Self {
        Self { smoothing_px: 1.0, min_share: 0.3 }
    }
}

/// A point on an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePoint {
    /// Column and row, pixel centres at integers.
    pub position: [f64; 2],
    /// σ across the edge, in pixels.
    pub sigma_px: f64,
}

/// Minimum gradient of an edge, in σ of the gradient caused by noise. Lower values find fainter edges and
/// more noise.
const MIN_SIGMAS: f64 = 6.0;
/// σ of an edge point without noise, in pixels, measured on discs of radius 12 and 25. It exists because a
/// square pixel is not a Gaussian.
const RASTER_PX: f64 = 0.02;
/// Minimum distance of points in σ of the smoothing; closer points have correlated errors.
const MIN_DISTANCE_SIGMAS: f64 = 3.0;
/// Minimum radius of curvature of an edge in σ of the smoothing; sharper bends are corners.
const MIN_RADIUS: f64 = 6.0;
/// Radius, in σ of the smoothing, over which curvature is averaged and within which a corner excludes points.
const AVERAGING_RADIUS: f64 = 6.0;

/// Finds points on the strongest edges of an image.
///
/// A straight edge blurred by a Gaussian of variance `t²` has gradients `m exp(−d²/2t²)` across it, so that
/// the logarithms of three neighbouring pixels, on the axis nearer to the gradient, lie on a parabola whose
/// vertex is the edge. `t²` is the median over the parabolas. Blur moves an edge of curvature `κ` by `½ κ t²`
/// towards its centre; this is corrected. With noise `σ_n` of a pixel, smoothing `s` and gradient `m`, the σ
/// of a zero crossing of the second derivative is `σ = σ_n √(3/16π) t² / (s³ m)`; 0.02 pixels of other causes
/// are added. The noise is estimated from the image (Immerkær) and is at least that of whole grey levels.
///
/// Cost: one pass of a separable filter, and a local search per edge pixel.
///
/// # Errors
/// `Input` for a smoothing below half a pixel, or an image smaller than the filter; `Undetermined` if no
/// gradient exceeds the noise.
///
/// # Examples
/// ```
/// use planish_sense::{EdgeOptions, Image, edge_points};
/// // A vertical step edge between columns 19 and 20.
/// let values = (0..1600).map(|k| if k % 40 < 20 { 10.0 } else { 200.0 }).collect();
/// let points = edge_points(&Image::try_new(40, 40, values)?, &EdgeOptions::default())?;
/// assert!(points.iter().all(|p| (p.position[0] - 19.5).abs() < 0.1));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Canny 1986, *A computational approach to edge detection*; Devernay 1995, *A non-maxima suppression method
/// for edge detection with sub-pixel accuracy*; Immerkær 1996, *Fast noise variance estimation*; Verbeek and
/// van Vliet 1994, *On the location error of curved edges in low-pass filtered 2-D and 3-D images*.
pub fn edge_points(image: &Image, options: &EdgeOptions) -> Result<Vec<EdgePoint>> {
    let s = options.smoothing_px;
    if !(s >= 0.5 && s.is_finite()) {
        return Err(Error::input(format!("expected a smoothing of half a pixel or more, found {s}")));
    }
    // Within the radius of the kernel, repeated border pixels would bend edges.
    let border = (4.0 * s).ceil() as usize + 2;
    if image.columns <= 2 * border || image.rows <= 2 * border {
        return Err(Error::input(format!(
            "expected a larger image for edges smoothed by {s}, found {} × {} pixels",
            image.columns, image.rows
        )));
    }
    let field = Gradients::new(image, s);
    // A noise-free image still has the rounding of whole grey levels, of variance 1/12.
    let noise = noise_of(image).max(1.0 / 12f64.sqrt());
    // Variance of a Gaussian derivative of white noise in a plane: σ² / 8π s⁴.
    let minimum = MIN_SIGMAS * noise / ((8.0 * std::f64::consts::PI).sqrt() * s * s);
    let strongest = field.magnitude.iter().copied().fold(0.0, f64::max);
    let threshold = minimum.max(options.min_share * strongest);
    let found = field.ridges(border, threshold);
    if found.is_empty() {
        return Err(Error::undetermined("expected edges above the noise of the image, found none"));
    }
    // The median over all edges, because a single parabola of three logarithms is noisy. The blur is assumed
    // to be the same everywhere.
    let mut spreads: Vec<f64> = found.iter().map(|edge| edge.spread).collect();
    spreads.sort_by(f64::total_cmp);
    let spread = spreads[spreads.len() / 2].max(s * s);
    let sigma_at_one = noise * (3.0 / (16.0 * std::f64::consts::PI)).sqrt() * spread / s.powi(3);
    // Curvature is a second derivative; averaging over the neighbourhood makes its noise small enough for the
    // correction.
    let grid = Buckets::new(&found, AVERAGING_RADIUS * s);
    let curvature: Vec<f64> = found
        .iter()
        .map(|edge| {
            let near: Vec<f64> =
                grid.near(&found, edge.position, AVERAGING_RADIUS * s).map(|k| found[k].curvature).collect();
            near.iter().sum::<f64>() / near.len() as f64
        })
        .collect();
    let corner: Vec<bool> = curvature.iter().map(|k| k.abs() * MIN_RADIUS * s > 1.0).collect();
    let mut kept: Vec<EdgePoint> = Vec::new();
    let mut is_kept = vec![false; found.len()];
    for (i, edge) in found.iter().enumerate() {
        let near_corner = grid.near(&found, edge.position, AVERAGING_RADIUS * s).any(|k| corner[k]);
        // Blur moves points near a corner inwards; points closer than the filter share its noise.
        if near_corner || grid.near(&found, edge.position, MIN_DISTANCE_SIGMAS * s).any(|k| is_kept[k]) {
            continue;
        }
        is_kept[i] = true;
        // Away from the centre of curvature, which lies on the brighter side where κ is positive.
        let back = 0.5 * curvature[i] * spread;
        kept.push(EdgePoint {
            position: [0, 1].map(|k| edge.position[k] - back * edge.uphill[k]),
            sigma_px: (sigma_at_one / edge.magnitude).hypot(RASTER_PX),
        });
    }
    Ok(kept)
}

/// A subpixel position of maximum gradient.
struct Edge {
    position: [f64; 2],
    /// The direction in which brightness grows.
    uphill: [f64; 2],
    magnitude: f64,
    /// Variance of the blur across the edge.
    spread: f64,
    /// Curvature of the level line; positive if its centre is on the brighter side.
    curvature: f64,
}

struct Gradients {
    columns: usize,
    rows: usize,
    by: [Vec<f64>; 2],
    magnitude: Vec<f64>,
}

impl Gradients {
    /// Derivatives of the image after smoothing by a Gaussian of σ `s`.
    fn new(image: &Image, s: f64) -> Self {
        let reach = (4.0 * s).ceil() as i64;
        let weight = |k: i64| (-0.5 * (k as f64 / s).powi(2)).exp();
        let sum: f64 = (-reach..=reach).map(weight).sum();
        let smooth: Vec<f64> = (-reach..=reach).map(|k| weight(k) / sum).collect();
        // Scaled so that a ramp keeps its slope.
        // Normalised by the discrete moment: samples of a Gaussian derivative would change the slope for a
        // small σ.
        let moment: f64 = (-reach..=reach).map(|k| (k * k) as f64 * weight(k)).sum();
        let slope: Vec<f64> = (-reach..=reach).map(|k| k as f64 * weight(k) / moment).collect();
        let values: Vec<f64> = image.values.iter().map(|&v| f64::from(v)).collect();
        let (columns, rows) = (image.columns, image.rows);
        let filtered = |across: &[f64], down: &[f64]| {
            let clamp = |k: i64, n: usize| k.clamp(0, n as i64 - 1) as usize;
            let mut half = vec![0.0; values.len()];
            for row in 0..rows {
                for column in 0..columns {
                    let taps = across.iter().zip(-reach..);
                    half[row * columns + column] = taps
                        .map(|(w, k)| w * values[row * columns + clamp(column as i64 + k, columns)])
                        .sum();
                }
            }
            let mut smoothed = vec![0.0; values.len()];
            for row in 0..rows {
                for (w, k) in down.iter().zip(-reach..) {
                    let from = clamp(row as i64 + k, rows) * columns;
                    for column in 0..columns {
                        smoothed[row * columns + column] += w * half[from + column];
                    }
                }
            }
            smoothed
        };
        let by = [filtered(&slope, &smooth), filtered(&smooth, &slope)];
        let magnitude = by[0].iter().zip(&by[1]).map(|(x, y)| x.hypot(*y)).collect();
        Self { columns, rows, by, magnitude }
    }

    fn ridges(&self, border: usize, threshold: f64) -> Vec<Edge> {
        let mut found = Vec::new();
        for row in border..self.rows - border {
            for column in border..self.columns - border {
                let at = row * self.columns + column;
                let m = self.magnitude[at];
                if m < threshold {
                    continue;
                }
                let [gx, gy] = [self.by[0][at], self.by[1][at]];
                // Along the axis nearer to the gradient three pixels cross the edge; no interpolation is
                // needed.
                let axis = usize::from(gy.abs() > gx.abs());
                let step = [1, self.columns][axis];
                let (before, after) = (self.magnitude[at - step], self.magnitude[at + step]);
                // Greater on one side and not smaller on the other: of two equal pixels exactly one is used.
                if !(m > before && m >= after && before > 0.0 && after > 0.0) {
                    continue;
                }
                // The logarithm of a Gaussian is a parabola, so the vertex is exact. A parabola through the
                // gradients themselves is biased towards pixel centres.
                let [a, b, c] = [before, m, after].map(f64::ln);
                let bend = a - 2.0 * b + c;
                let mut position = [column as f64, row as f64];
                position[axis] += 0.5 * (a - c) / bend;
                let uphill = [gx / m, gy / m];
                let slope =
                    |field: usize, step: usize| 0.5 * (self.by[field][at + step] - self.by[field][at - step]);
                let (xx, xy, yy) = (slope(0, 1), slope(0, self.columns), slope(1, self.columns));
                found.push(Edge {
                    position,
                    uphill,
                    magnitude: m,
                    spread: -uphill[axis].powi(2) / bend,
                    curvature: -(xx * uphill[1].powi(2) - 2.0 * xy * uphill[0] * uphill[1]
                        + yy * uphill[0].powi(2))
                        / m,
                });
            }
        }
        found
    }
}

/// Edges sorted into square cells.
struct Buckets {
    cell: f64,
    at: std::collections::BTreeMap<[i64; 2], Vec<usize>>,
}

impl Buckets {
    fn new(edges: &[Edge], cell: f64) -> Self {
        // Points within a cell's side lie in a block of 3 × 3 cells. An ordered map keeps the order of visits
        // the same in every run.
        let mut at = std::collections::BTreeMap::<_, Vec<usize>>::new();
        for (k, edge) in edges.iter().enumerate() {
            at.entry(edge.position.map(|c| (c / cell).floor() as i64)).or_default().push(k);
        }
        Self { cell, at }
    }

    /// Edges within a distance, which is at most the side of a cell.
    fn near<'a>(&'a self, edges: &'a [Edge], p: [f64; 2], within: f64) -> impl Iterator<Item = usize> + 'a {
        let [i, j] = p.map(|c| (c / self.cell).floor() as i64);
        let cells = (-1..=1).flat_map(move |di| (-1..=1).map(move |dj| [i + di, j + dj]));
        cells.flat_map(|cell| self.at.get(&cell).map_or(&[][..], Vec::as_slice)).copied().filter(move |&k| {
            let q = edges[k].position;
            (q[0] - p[0]).hypot(q[1] - p[1]) <= within
        })
    }
}

/// σ of the noise of an image: the median response to the difference of two Laplacians. It is zero on planes
/// and small at most edges.
fn noise_of(image: &Image) -> f64 {
    let mut responses = Vec::new();
    for row in 1..image.rows - 1 {
        let [up, middle, down] = [row - 1, row, row + 1].map(|r| image.row(r));
        for k in 1..image.columns - 1 {
            let corners = up[k - 1] + up[k + 1] + down[k - 1] + down[k + 1];
            let sides = up[k] + down[k] + middle[k - 1] + middle[k + 1];
            responses.push(f64::from((corners - 2.0 * sides + 4.0 * middle[k]).abs()));
        }
    }
    let middle = responses.len() / 2;
    let median = *responses.select_nth_unstable_by(middle, f64::total_cmp).1;
    // 36 is the sum of the squared weights; 0.6745 the median of |N(0, 1)|.
    median / (6.0 * 0.6745)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    const CENTER: [f64; 2] = [60.3, 55.8];

    /// A bright disc with noise; its share of each pixel is from 40 × 40 samples.
    fn disc(radius: f64, noise: f64, seed: u64) -> Image {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let values = (0..120 * 120).map(|k| {
            let (x, y) = (f64::from(k % 120) - CENTER[0], f64::from(k / 120) - CENTER[1]);
            let off = x.hypot(y) - radius;
            let share = if off.abs() > 1.0 {
                f64::from(off < 0.0)
            } else {
                let step = |s: i32| (f64::from(s) + 0.5) / 40.0 - 0.5;
                let inside = (0..1600).filter(|s| (x + step(s % 40)).hypot(y + step(s / 40)) < radius);
                inside.count() as f64 / 1600.0
            };
            let clean = 40.0 + 160.0 * share;
            (clean + noise * random.sample::<f64, _>(StandardNormal)) as f32
        });
        Image::try_new(120, 120, values.collect()).expect("an image")
    }

    #[test]
    fn edge_points_agree_with_their_sigma() {
        let (mut squares, mut bias, mut count) = (0.0, 0.0, 0.0);
        for seed in 0..6 {
            for point in edge_points(&disc(25.0, 4.0, seed), &EdgeOptions::default()).expect("edges") {
                let off = (point.position[0] - CENTER[0]).hypot(point.position[1] - CENTER[1]) - 25.0;
                squares += (off / point.sigma_px).powi(2);
                bias += off;
                count += 1.0;
            }
        }
        // Blur alone would move them inwards by 0.02.
        assert!(count > 200.0 && (bias / count).abs() < 0.01, "{} of {count}", bias / count);
        assert!((0.6..1.6).contains(&(squares / count)), "{}", squares / count);
    }

    #[test]
    fn noise_alone_contains_no_edges() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let values = (0..6400).map(|_| 100.0 + 5.0 * random.sample::<f32, _>(StandardNormal));
        let image = Image::try_new(80, 80, values.collect()).expect("an image");
        assert!(edge_points(&image, &EdgeOptions::default()).is_err());
    }
}
