//! Subpixel disparities and their σ, by least squares on brightness.
//!
//! In: both images and an initial disparity for every accepted pixel. Out: a [`Refined`] for each of them.
//!
//! Not guaranteed: at depth edges the window contains two surfaces. Pixels of the other one are excluded by
//! their disparity and brightness, but not always.
//!
//! In a window about the pixel p the surface is a plane, `d(q) = d + s·(q − p)`, whose slopes s are fitted to
//! the first disparities. Then `Σ_q w_q (I_L(q) − I_R(x_q − d(q)) − b)²` is minimised over d and the offset b
//! by Gauss–Newton. The right image is interpolated by cubics; linear interpolation biases disparities
//! towards integers. The variance is that of least squares with weights that are no inverse variances,
//! `σ² = s² Σ w² (g − ḡ)² / (Σ w (g − ḡ)²)²`, g the gradient of the right image, s² the variance of the
//! residuals: steep texture makes it small, noise large.
//!
//! # References
//! - Lucas and Kanade, *An iterative image registration technique*, 1981.
//! - Kanade and Okutomi, *A stereo matching algorithm with an adaptive window*, PAMI 1994, eq. 13, for the
//!   variance.
//! - Shimizu and Okutomi, *Precise sub-pixel estimation on area-based matching*, ICCV 2001, for the bias
//!   towards whole pixels.

use rayon::prelude::*;

use crate::Image;
use crate::image::cubic;

/// Half the window, in pixels. Larger windows reduce noise and contain more of other surfaces.
const HALF: usize = 4;
/// Maximum difference of disparity between pixels of one surface, in pixels.
const SAME_SURFACE: f32 = 1.5;
/// Maximum number of Gauss–Newton steps.
const STEPS: usize = 4;
/// Length of a step below which the iteration has converged, in pixels: a fraction of the smallest σ of 0.11.
const CONVERGED: f32 = 0.02;
/// The noise is estimated at every `PILOT`-th column and row, to save time.
const PILOT: usize = 5;
/// Maximum change of a disparity by least squares, in pixels. A larger change means another minimum.
const MAX_MOVE: f32 = 1.0;
/// Weight, in pixels, with which the residual variance of a window is shrunk towards that of the image.
const SHRINKAGE: f32 = 5.0;

/// A disparity between whole pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Refined {
    /// The disparity.
    pub(super) disparity: f32,
    /// Its σ from texture and noise, in pixels.
    pub(super) sigma: f32,
    /// How far the first disparities of the window lie from their plane (root mean square).
    pub(super) rough: f32,
    /// How far least squares moved the disparity from the plane.
    pub(super) moved: f32,
    /// Share of the window that lies on the pixel's surface.
    pub(super) support: f32,
}

/// Refines every disparity that is finite, where there is texture to do it by; `contrast` is the difference
/// of brightness that halves a neighbour's weight.
pub(super) fn refine(left: &Image, right: &Image, first: &[f32], contrast: f32) -> Vec<Option<Refined>> {
    let columns = left.columns;
    let window = |x: usize, y: usize| {
        let known = first[y * columns + x].is_finite();
        known.then(|| Window::new(left, first, x, y, contrast))
    };
    // The image's own noise is the median of what the windows of some pixels find.
    let mut variances: Vec<f32> = (0..left.rows / PILOT)
        .into_par_iter()
        .flat_map_iter(|y| (0..columns / PILOT).map(move |x| (PILOT * x, PILOT * y)))
        .filter_map(|(x, y)| window(x, y)?.refine(left, right, None))
        .map(|(_, variance)| variance)
        .collect();
    let middle = variances.len() / 2;
    let noise = match variances.is_empty() {
        true => 0.0,
        false => *variances.select_nth_unstable_by(middle, f32::total_cmp).1,
    };
    let mut found = vec![None; first.len()];
    found.par_chunks_mut(columns).enumerate().for_each(|(y, found)| {
        for (x, found) in found.iter_mut().enumerate() {
            *found = window(x, y)
                .and_then(|window| window.refine(left, right, Some(noise)))
                .map(|(refined, _)| refined);
        }
    });
    found
}

/// The pixels about one, as far as they are of its surface.
struct Window {
    x: usize,
    y: usize,
    /// Column and row from the middle, weight.
    members: Vec<(i32, i32, f32)>,
    /// Disparity of the plane in the middle and its slopes.
    plane: [f32; 3],
    rough: f32,
}

impl Window {
    fn new(left: &Image, first: &[f32], x: usize, y: usize, contrast: f32) -> Self {
        let columns = left.columns;
        let middle = first[y * columns + x];
        let brightness = left.at(x, y);
        let mut members = Vec::with_capacity((2 * HALF + 1).pow(2));
        // Normal equations of the plane, about the first disparity in the middle.
        let (mut m, mut r) = ([0.0_f32; 6], [0.0_f32; 3]);
        for row in y.saturating_sub(HALF)..(y + HALF + 1).min(left.rows) {
            for column in x.saturating_sub(HALF)..(x + HALF + 1).min(columns) {
                let apart = first[row * columns + column] - middle;
                // NaN is not near.
                let near = apart.abs() <= SAME_SURFACE;
                if !near {
                    continue;
                }
                let change = (left.at(column, row) - brightness) / contrast;
                let (dx, dy) = (column as i32 - x as i32, row as i32 - y as i32);
                // Pixels of another brightness are more likely on another surface.
                let w = 1.0 / (1.0 + change * change);
                members.push((dx, dy, w));
                let (i, j) = (dx as f32, dy as f32);
                for (sum, product) in m.iter_mut().zip([1.0, i, j, i * i, i * j, j * j]) {
                    *sum += w * product;
                }
                for (sum, product) in r.iter_mut().zip([1.0, i, j]) {
                    *sum += w * product * apart;
                }
            }
        }
        // Few or collinear pixels do not determine the slopes; a weak prior pulls them to zero.
        m[3] += 4.0;
        m[5] += 4.0;
        let [level, along, across] = solve(m, r);
        let (mut squares, mut weight) = (0.0, 0.0);
        for &(dx, dy, w) in &members {
            let place = (y as i32 + dy) as usize * columns + (x as i32 + dx) as usize;
            let residual = first[place] - middle - level - along * dx as f32 - across * dy as f32;
            squares += w * residual * residual;
            weight += w;
        }
        Self { x, y, members, plane: [middle + level, along, across], rough: (squares / weight).sqrt() }
    }

    /// The refined disparity and the variance of the residuals; none where the window has no texture.
    fn refine(&self, left: &Image, right: &Image, noise: Option<f32>) -> Option<(Refined, f32)> {
        let [start, along, across] = self.plane;
        let mut disparity = start;
        let (mut sigma, mut variance) = (0.0, 0.0);
        for _ in 0..STEPS {
            let mut sums = Sums::default();
            for &(dx, dy, w) in &self.members {
                let (column, row) = (self.x as i32 + dx, (self.y as i32 + dy) as usize);
                let right_column = column as f32 - disparity - along * dx as f32 - across * dy as f32;
                if let Some((value, slope)) = cubic(right.row(row), right_column) {
                    sums.add(w, left.at(column as usize, row) - value, slope);
                }
            }
            let (step, residual, information, spread) = sums.solve()?;
            let shrunk = noise.map_or(residual, |noise| {
                (sums.weight * residual + SHRINKAGE * noise) / (sums.weight + SHRINKAGE)
            });
            variance = residual;
            sigma = (shrunk * spread).sqrt() / information;
            disparity += step.clamp(-0.5, 0.5);
            if step.abs() < CONVERGED || (disparity - start).abs() > MAX_MOVE {
                break;
            }
        }
        let moved = disparity - start;
        if moved.abs() > MAX_MOVE {
            disparity = start;
            sigma = MAX_MOVE;
        }
        let refined = Refined {
            disparity,
            sigma,
            rough: self.rough,
            moved: moved.clamp(-MAX_MOVE, MAX_MOVE),
            support: self.members.len() as f32 / (2.0 * HALF as f32 + 1.0).powi(2),
        };
        Some((refined, variance))
    }
}

/// Sums of the two unknowns, disparity and offset of brightness.
#[derive(Default)]
struct Sums {
    weight: f32,
    r: f32,
    g: f32,
    rr: f32,
    rg: f32,
    gg: f32,
    ww: f32,
    wwg: f32,
    wwgg: f32,
}

impl Sums {
    fn add(&mut self, w: f32, r: f32, g: f32) {
        self.weight += w;
        self.r += w * r;
        self.g += w * g;
        self.rr += w * r * r;
        self.rg += w * r * g;
        self.gg += w * g * g;
        self.ww += w * w;
        self.wwg += w * w * g;
        self.wwgg += w * w * g * g;
    }

    /// The step of the disparity, the residual variance after it, `Σ w (g − ḡ)²` and `Σ w² (g − ḡ)²`.
    fn solve(&self) -> Option<(f32, f32, f32, f32)> {
        // Two unknowns; with unequal weights each uses up `Σ w²/Σ w` of the total weight.
        let freedom = self.weight - 2.0 * self.ww / self.weight;
        if !(self.weight > 0.0 && freedom > 1.0) {
            return None;
        }
        let mean = self.g / self.weight;
        let information = self.gg - self.g * mean;
        let mixed = self.rg - self.r * mean;
        if information <= 1e-6 * self.gg {
            return None;
        }
        // I_R(x − d − δ) = I_R(x − d) − g δ, hence r + g δ − b.
        let step = -mixed / information;
        let squares = self.rr - self.r * self.r / self.weight - mixed * mixed / information;
        let spread = self.wwgg - 2.0 * mean * self.wwg + mean * mean * self.ww;
        Some((step, squares.max(0.0) / freedom, information, spread.max(0.0)))
    }
}

/// Solves a symmetric system `[m00 m01 m02; m11 m12; m22] x = r`, given row by row as 00 01 02 11 12 22.
fn solve(m: [f32; 6], r: [f32; 3]) -> [f32; 3] {
    let [a, b, c, d, e, f] = m;
    let (l1, l2) = (b / a, c / a);
    let p1 = d - l1 * b;
    let q = (e - l2 * b) / p1;
    let p2 = f - l2 * c - q * (e - l2 * b);
    let (y1, y2) = (r[1] - l1 * r[0], r[2] - l2 * r[0]);
    let z = (y2 - q * y1) / p2;
    let y = y1 / p1 - q * z;
    [(r[0] - b * y - c * z) / a, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_small_system_is_solved() {
        let m = [4.0, 1.0, 0.5, 3.0, -0.5, 2.0];
        let x = solve(m, [4.0 + 2.0 + 1.5, 1.0 + 6.0 - 1.5, 0.5 - 1.0 + 6.0]);
        assert!(x.iter().zip([1.0, 2.0, 3.0]).all(|(a, b)| (a - b).abs() < 1e-5), "{x:?}");
    }
}
