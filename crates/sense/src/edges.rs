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
    /// σ of a displacement along `axis` that points of one side share if their subpixel positions agree.
    ///
    /// It is zero for an image whose pixels are averages over their area, as of a camera. An image drawn with
    /// whole pixels, or with `n × n` samples per pixel, has `1/√12` or `1/(n √12)`.
    pub sampling_px: f64,
    /// The axis along which the edge was located: 0 for a column, 1 for a row.
    pub axis: usize,
}

/// Minimum gradient of an edge, in σ of the gradient caused by noise. Lower values find fainter edges and
/// more noise.
const MIN_SIGMAS: f64 = 6.0;
/// σ of an edge point by the vertex of its gradient, without noise, in pixels. It depends on the position of
/// the edge in its pixel: up to 0.042 pixels for a side along the rows (decision record 0172).
const RASTER_PX: f64 = 0.03;
/// σ of an edge point by its area, without noise, in pixels: what straight sides of 0° to 45° and discs of
/// radius 12 leave with exact coverage of the pixels.
const AREA_PX: f64 = 0.004;
/// Rows beside an edge point over which its profile is averaged, in σ of the smoothing. More rows reduce the
/// noise and widen the profile of an inclined edge.
const PROFILE_ROWS: f64 = 2.0;
/// Pixels at each end of a profile whose mean is the brightness beside the edge.
const PLATEAU: usize = 3;
/// Maximum difference of the brightness at one end of a profile, in σ of its noise. Another edge is too near
/// if it is larger.
const PLATEAU_SIGMAS: f64 = 5.0;
/// Maximum number of samples per pixel and axis that is recognised. More leave an error below 0.06 pixels,
/// and their grey levels are more and more those of any picture.
const MAX_SAMPLES: usize = 4;
/// Grey levels count as those of `n` samples if their variance about them is below this fraction of that of
/// evenly spread levels. Four sides along the rows at independent places pass by chance in 2 of 100 pictures;
/// σ is then too large. A single side passes more often: its levels do not show it.
const SAMPLED_SHARE: f64 = 0.1;
/// Minimum distance of points in σ of the smoothing; closer points have correlated errors.
const MIN_DISTANCE_SIGMAS: f64 = 3.0;
/// Minimum radius of curvature of an edge in σ of the smoothing; sharper bends are corners. Averaged over
/// [`BEND_RADIUS`], a corner that turns by `φ` has the curvature `φ/6`: turns from 50° are corners.
const MIN_RADIUS: f64 = 7.0;
/// Radius, in σ of the smoothing, over which curvature is averaged to find corners. Over twice as much, a
/// right angle had the curvature of a disc of radius 8, and points beside corners, 0.05 pixels off, were
/// kept.
const BEND_RADIUS: f64 = 3.0;
/// Radius, in σ of the smoothing, over which curvature is averaged and within which a corner excludes points.
const AVERAGING_RADIUS: f64 = 6.0;

/// Finds points on the strongest edges of an image.
///
/// A straight edge blurred by a Gaussian of variance `t²` has gradients `m exp(−d²/2t²)` across it, so that
/// the logarithms of three neighbouring pixels, on the axis nearer to the gradient, lie on a parabola whose
/// vertex is near the edge. `t²` is the median over the parabolas.
///
/// The vertex depends on the position of the edge in its pixel: a pixel that the edge cuts is a mixture of
/// both sides, whose gradient is skewed. The edge is therefore located by area: with the brightness `a` and
/// `b` at both ends of a profile across the edge, `Σ (I − a)/(b − a)` is the part of the profile on the side
/// of `b`, exactly for a straight edge and pixels that average over their area. Where another edge is too
/// near for that, the vertex stays, with 0.03 pixels of σ for its dependence.
///
/// Blur moves an edge of curvature `κ` by `½ κ t²` towards its centre; this is corrected. With noise `σ_n` of
/// a pixel, the σ of a zero crossing of the second derivative is `σ = σ_n √(3/16π) t² / (s³ m)` for smoothing
/// `s` and gradient `m`; that of an area follows from its weights. The noise is estimated from the image
/// (Immerkær) and is at least that of whole grey levels.
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
/// van Vliet 1994, *On the location error of curved edges in low-pass filtered 2-D and 3-D images*;
/// Trujillo-Pino et al. 2013, *Accurate subpixel edge location based on partial area effect*.
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
    let reach = AVERAGING_RADIUS * s;
    let mean_curvature = |i: usize, within: f64, is_used: &dyn Fn(usize) -> bool| {
        let near = grid.near(&found, found[i].position, within).filter(|&k| is_used(k));
        let (sum, count) = near.fold((0.0, 0), |(sum, n), k| (sum + found[k].curvature, n + 1));
        sum / f64::from(count.max(1))
    };
    let is_bend = |i: usize| mean_curvature(i, BEND_RADIUS * s, &|_| true).abs() * MIN_RADIUS * s > 1.0;
    let bend: Vec<bool> = (0..found.len()).map(is_bend).collect();
    // Blur moves points near a corner inwards.
    let near_corner: Vec<bool> =
        (found.iter()).map(|edge| grid.near(&found, edge.position, reach).any(|k| bend[k])).collect();
    let profiles = Profiles { image, smoothing: s, spread, noise };
    let mut kept: Vec<EdgePoint> = Vec::new();
    let mut shares = Vec::new();
    let mut is_kept = vec![false; found.len()];
    for (i, edge) in found.iter().enumerate() {
        // Points closer than the filter share its noise.
        if near_corner[i] || grid.near(&found, edge.position, MIN_DISTANCE_SIGMAS * s).any(|k| is_kept[k]) {
            continue;
        }
        is_kept[i] = true;
        let (mut position, mut sigma_px, blur);
        if let Some(area) = profiles.locate(edge) {
            position = edge.position;
            position[edge.axis] = area.along;
            sigma_px = (area.sigma * edge.uphill[edge.axis].abs()).hypot(AREA_PX);
            // The profile is the mean of rows along the edge, on both sides of it: only the blur of the image
            // and the distance of those rows move it.
            blur = area.spread / edge.uphill[edge.axis].powi(2);
            shares.push(area.share);
        } else {
            position = edge.position;
            sigma_px = (sigma_at_one / edge.magnitude).hypot(RASTER_PX);
            blur = spread;
        }
        // Away from the centre of curvature, which lies on the brighter side where κ is positive.
        // Points beside a corner have a curvature that is not that of the side: it moved sides outwards by
        // 0.01.
        let back = 0.5 * mean_curvature(i, reach, &|k| !near_corner[k]) * blur;
        position = [0, 1].map(|k| position[k] - back * edge.uphill[k]);
        sigma_px = sigma_px.max(f64::MIN_POSITIVE);
        kept.push(EdgePoint { position, sigma_px, sampling_px: 0.0, axis: edge.axis });
    }
    let sampling_px = sampling(&shares);
    for point in &mut kept {
        // Within a side the displacement varies as well, wherever the side crosses rows of pixels.
        point.sigma_px = point.sigma_px.hypot(sampling_px);
        point.sampling_px = sampling_px;
    }
    Ok(kept)
}

/// σ of the displacement of edges by an image with few samples per pixel; zero if its pixels are averages.
///
/// `shares` are the parts of the pixel at each edge on the brighter side, with their variance by noise. With
/// `n × n` samples, a straight side along the rows cuts pixels into multiples of `1/n` only.
fn sampling(shares: &[(f64, f64)]) -> f64 {
    let count = shares.len().max(1) as f64;
    let by_noise = shares.iter().map(|share| share.1).sum::<f64>() / count;
    for n in 1..=MAX_SAMPLES {
        let n = n as f64;
        let even = 1.0 / (12.0 * n * n);
        // Noise as wide as the levels are apart would hide them.
        if by_noise > 0.5 * even {
            break;
        }
        let off = |share: &(f64, f64)| (share.0 - (n * share.0).round() / n).powi(2);
        let variance = shares.iter().map(off).sum::<f64>() / count - by_noise;
        if variance < SAMPLED_SHARE * even {
            return even.sqrt();
        }
    }
    0.0
}

/// An edge located by the area of its profile.
struct Area {
    /// Coordinate along the axis of the edge.
    along: f64,
    /// σ along the axis, by noise.
    sigma: f64,
    /// Variance by which curvature moves the result.
    spread: f64,
    /// Part of the middle pixel on the brighter side, from 0 to 1, and its variance by noise.
    share: (f64, f64),
}

/// Profiles of an image across its edges.
struct Profiles<'a> {
    image: &'a Image,
    smoothing: f64,
    /// Variance of the smoothed edges across them.
    spread: f64,
    noise: f64,
}

impl Profiles<'_> {
    /// Locates an edge; `None` if the brightness beside it is not even, or the image ends there.
    fn locate(&self, edge: &Edge) -> Option<Area> {
        let s = self.smoothing;
        let rows = (PROFILE_ROWS * s).round().max(1.0) as i64;
        let weights: Vec<f64> = (-rows..=rows).map(|j| (-0.5 * (j as f64 / s).powi(2)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        let [along, across] =
            [edge.position[edge.axis].round() as i64, edge.position[1 - edge.axis].round() as i64];
        // The window holds the blur of the image, of variance `spread − s²`, and the inclined edge in all
        // rows.
        let blur = (self.spread - s * s).max(0.0);
        let slope = (edge.uphill[1 - edge.axis] / edge.uphill[edge.axis]).abs();
        let half = (1.0 + 2.5 * (blur - 1.0 / 6.0).max(0.0).sqrt() + rows as f64 * slope).ceil() as i64;
        let reach = half + PLATEAU as i64;
        let profile: Option<Vec<f64>> = (-reach..=reach)
            .map(|k| {
                let row = (-rows..=rows).zip(&weights);
                row.map(|(j, w)| Some(w / sum * self.value(edge.axis, along + k, across + j)?)).sum()
            })
            .collect();
        let profile = profile?;
        let (low, rest) = profile.split_at(PLATEAU);
        let (middle, high) = rest.split_at(rest.len() - PLATEAU);
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (a, b) = (mean(low), mean(high));
        let of_rows = self.noise * weights.iter().map(|w| (w / sum).powi(2)).sum::<f64>().sqrt();
        let is_even = |values: &[f64]| {
            let (least, most) =
                values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, m), &v| (l.min(v), m.max(v)));
            most - least < PLATEAU_SIGMAS * of_rows
        };
        if !is_even(low) || !is_even(high) || (b - a).abs() < PLATEAU_SIGMAS * of_rows {
            return None;
        }
        let share: f64 = middle.iter().map(|value| (value - a) / (b - a)).sum();
        let n = middle.len() as f64;
        // An error of a plateau counts for the half of the profile on its side.
        let variance = n + 2.0 * (0.5 * n).powi(2) / PLATEAU as f64;
        let at_edge = (self.value(edge.axis, along, across)? - a) / (b - a);
        Some(Area {
            along: (along + half) as f64 + 0.5 - share,
            sigma: of_rows * variance.sqrt() / (b - a).abs(),
            spread: s * s + (blur - 1.0 / 6.0).max(0.0),
            share: (at_edge, (self.noise / (b - a)).powi(2)),
        })
    }

    /// Brightness at a place along an axis and across it.
    fn value(&self, axis: usize, along: i64, across: i64) -> Option<f64> {
        let (column, row) = if axis == 0 { (along, across) } else { (across, along) };
        let (column, row) = (usize::try_from(column).ok()?, usize::try_from(row).ok()?);
        (column < self.image.columns && row < self.image.rows)
            .then(|| f64::from(self.image.values[row * self.image.columns + column]))
    }
}

/// A subpixel position of maximum gradient.
struct Edge {
    position: [f64; 2],
    /// The axis nearer to the gradient: 0 along a row, 1 along a column.
    axis: usize,
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
                    axis,
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

    /// A bright half-plane right of `x = at + slope (y − 40)`; each pixel has `n × n` samples.
    fn half_plane(at: f64, slope: f64, n: i32, noise: f64, seed: u64) -> Image {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let values = (0..80 * 80).map(|k| {
            let (x, y) = (f64::from(k % 80), f64::from(k / 80));
            let step = |s: i32| (f64::from(s) + 0.5) / f64::from(n) - 0.5;
            let inside = (0..n * n).filter(|s| x + step(s % n) > at + slope * (y + step(s / n) - 40.0));
            let clean = 40.0 + 160.0 * inside.count() as f64 / f64::from(n * n);
            (clean + noise * random.sample::<f64, _>(StandardNormal)).round() as f32
        });
        Image::try_new(80, 80, values.collect()).expect("an image")
    }

    #[test]
    fn a_side_has_no_shared_error_at_any_place_in_its_pixel() {
        // By the vertex of the gradient, the mean was off by up to 0.042 pixels along the rows.
        for slope in [0.0, 0.02, 0.3, 0.9] {
            for phase in [0.1, 0.3, 0.5, 0.8] {
                let image = half_plane(40.0 + phase, slope, 40, 0.0, 1);
                let points = edge_points(&image, &EdgeOptions::default()).expect("edges");
                let across = |p: &EdgePoint| {
                    (p.position[0] - 40.0 - phase - slope * (p.position[1] - 40.0)) / slope.hypot(1.0)
                };
                let mean = points.iter().map(across).sum::<f64>() / points.len() as f64;
                assert!(mean.abs() < 0.004, "slope {slope}, phase {phase}: {mean}");
                // A side along the rows cuts all pixels alike, which may look like few samples.
                assert!(slope < 0.1 || points.iter().all(|p| p.sampling_px == 0.0));
            }
        }
    }

    #[test]
    fn few_samples_per_pixel_are_recognised() {
        for (n, noise) in [(1, 0.0), (1, 4.0), (2, 4.0), (4, 2.0)] {
            let image = half_plane(40.23, 0.0, n, noise, 3);
            let points = edge_points(&image, &EdgeOptions::default()).expect("edges");
            let expected = 1.0 / (f64::from(n) * 12f64.sqrt());
            // A single side may lie at a multiple of a smaller number of samples by chance, never of a
            // larger.
            assert!(points[0].sampling_px >= expected - 1e-12, "{n}: {}", points[0].sampling_px);
        }
    }

    #[test]
    fn noise_alone_contains_no_edges() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let values = (0..6400).map(|_| 100.0 + 5.0 * random.sample::<f32, _>(StandardNormal));
        let image = Image::try_new(80, 80, values.collect()).expect("an image");
        assert!(edge_points(&image, &EdgeOptions::default()).is_err());
    }
}
