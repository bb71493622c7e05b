//! The solid that oriented points enclose, as a blurred indicator function on a grid.
//!
//! Input: points with outward normals. Output: a function that is high inside and low outside, at any blur,
//! and the level that passes through the points. It fills holes smoothly and is robust against noise and
//! outliers. At strong blur the solid is a blob, so a surface that follows the level set from strong to weak
//! blur grows into the shape without tearing or folding.
//!
//! With normals `n_i` and areas `a_i`, the indicator obeys `∇χ = −Σ a_i n_i δ(x − p_i)`, hence in Fourier
//! space `χ̂ = i k·V̂ / |k|²`, and a blur is a factor `exp(−σ²k²/2)`. Areas come from the local density of
//! points.
//!
//! Not guaranteed: detail smaller than one grid cell.
//!
//! # References
//! Kazhdan, *Reconstruction of solid models from oriented point sets*, SGP 2005.

use planish_core::{BoundingBox, DVec3};
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{FftDirection, FftPlanner};
use std::f64::consts::TAU;

/// Grid cells along each side: 2⁵ · 3, which is fast to transform. A complex grid takes 14 MB; a finer one
/// would find thinner parts at eight times the cost for each doubling.
pub(super) const CELLS: usize = 96;
/// Side of the grid over that of the points, so that periodic images do not touch.
const PADDING: f64 = 1.6;
/// Weakest blur that the full grid can represent, in its cells.
pub(super) const MIN_BLUR_CELLS: f64 = 0.85;
/// A coarser grid is used if the blur spans at least this many of its cells. With half as many a film stays
/// between the ears of the bunny. See decision 0001.
const AMPLE_BLUR_CELLS: f64 = 1.7;
/// Blur of the density estimate, in grid cells. A weaker blur follows single points; a stronger one mixes
/// the densities of different scans.
const DENSITY_BLUR: f64 = 2.0;

/// Columns and rows of a tile: two cache lines of each row.
const TILE: [usize; 2] = [8, 32];

/// The transformed indicator of a cloud.
pub(super) struct Indicator {
    grid: Grid,
    spectrum: Vec<Complex<f64>>,
}

/// The indicator at one blur.
pub(super) struct BlurredIndicator {
    grid: Grid,
    values: Vec<f64>,
}

/// A cubic grid of sample points, periodic for transforms.
#[derive(Clone, Copy)]
struct Grid {
    origin: DVec3,
    /// Distance between points, and how many there are along each side.
    cell: f64,
    cells: usize,
}

impl Indicator {
    /// The indicator of oriented points; those with zero normals do not count.
    pub(super) fn new(points: &[DVec3], normals: &[DVec3]) -> Self {
        Self::on_grid(points, normals, CELLS)
    }

    /// Side of the grid around points.
    pub(super) fn grid_side(points: &[DVec3]) -> f64 {
        let (lo, hi) = bounds_of(points);
        PADDING * (hi - lo).max_element().max(0.0)
    }

    /// The indicator on a grid with a given number of cells along each side, which has to be even.
    pub(super) fn on_grid(points: &[DVec3], normals: &[DVec3], cells: usize) -> Self {
        let (lo, hi) = bounds_of(points);
        let side = Self::grid_side(points);
        let grid =
            Grid { origin: 0.5 * (lo + hi) - DVec3::splat(0.5 * side), cell: side / cells as f64, cells };
        let mut counts = vec![Complex::new(0.0, 0.0); cells.pow(3)];
        for p in points {
            // One thread adds all points: the order of additions decides the last digits.
            grid.splat(*p, |index, w| counts[index].re += w);
        }
        transform(&mut counts, cells, FftDirection::Forward);
        blur(&mut counts, cells, DENSITY_BLUR);
        transform(&mut counts, cells, FftDirection::Inverse);
        let density =
            BlurredIndicator { grid, values: counts.iter().map(|c| c.re / counts.len() as f64).collect() };
        // Two real fields share one complex transform; the third has its own.
        let mut xy = vec![Complex::new(0.0, 0.0); cells.pow(3)];
        let mut z = xy.clone();
        for (p, n) in points.iter().zip(normals) {
            let local_density = density.sample(*p).0;
            if local_density <= 0.0 {
                continue;
            }
            // A sheet of ρ points an area has the blurred density ρ/(√2π σ) on it; the constant drops out of
            // the level set.
            let a = 1.0 / local_density * *n;
            grid.splat(*p, |index, w| {
                xy[index] += Complex::new(w * a[0], w * a[1]);
                z[index].re += w * a[2];
            });
        }
        transform(&mut xy, cells, FftDirection::Forward);
        transform(&mut z, cells, FftDirection::Forward);
        let spectrum = (0..cells.pow(3))
            .into_par_iter()
            .map(|index| {
                let k = wave(index, cells);
                let k2 = k.length_squared();
                // The mean of χ is arbitrary, because its level is the median at the points.
                if k2 == 0.0 {
                    return Complex::new(0.0, 0.0);
                }
                // Apart again: x̂ = (F(k) + F̄(−k))/2, ŷ = (F(k) − F̄(−k))/2i.
                let (f, g) = (xy[index], xy[mirrored(index, cells)].conj());
                let x = (f + g) * 0.5;
                let y = (f - g) * Complex::new(0.0, -0.5);
                (x * k[0] + y * k[1] + z[index] * k[2]) * Complex::new(0.0, 1.0 / k2)
            })
            .collect();
        Self { grid, spectrum }
    }

    /// Side of a grid cell.
    pub(super) fn cell(&self) -> f64 {
        self.grid.cell
    }

    /// The indicator blurred by a Gaussian of the given σ (a length), on a grid just fine enough for it.
    pub(super) fn blurred(&self, sigma: f64) -> BlurredIndicator {
        let mut grid = self.grid;
        // Grid sides stay even, since wave numbers are split at half a side.
        while grid.cells.is_multiple_of(4) && sigma >= AMPLE_BLUR_CELLS * 2.0 * grid.cell {
            grid.cells /= 2;
            grid.cell *= 2.0;
        }
        // A coarser grid contains the low frequencies only; the blur removes the others.
        let (n, all) = (grid.cells, self.grid.cells);
        let mut waves: Vec<Complex<f64>> = (0..n.pow(3))
            .into_par_iter()
            .with_min_len(4096)
            .map(|index| {
                let [a, b, c] = split(index, n).map(|m| if m > n / 2 { m + all - n } else { m });
                self.spectrum[(c * all + b) * all + a]
            })
            .collect();
        blur(&mut waves, n, sigma / grid.cell);
        transform(&mut waves, n, FftDirection::Inverse);
        BlurredIndicator { grid, values: waves.iter().map(|c| c.re).collect() }
    }
}

impl BlurredIndicator {
    /// Value and gradient by trilinear interpolation; outside the box, of its nearest point.
    pub(super) fn sample(&self, p: DVec3) -> (f64, DVec3) {
        let (corner, t) = self.grid.locate(p);
        let (n, first) = (self.grid.cells, self.grid.index(corner));
        let values = &self.values[first..first + n * n + n + 2];
        let at = |a: usize, b: usize, c: usize| values[(c * n + b) * n + a];
        // Along x, then y, then z; each step keeps what the derivatives need.
        let along_x = |b: usize, c: usize| {
            let (low, high) = (at(0, b, c), at(1, b, c));
            [low + t[0] * (high - low), high - low]
        };
        let along_y = |c: usize| {
            let ([low, low_x], [high, high_x]) = (along_x(0, c), along_x(1, c));
            [low + t[1] * (high - low), low_x + t[1] * (high_x - low_x), high - low]
        };
        let (low, high) = (along_y(0), along_y(1));
        let [value, gx, gy] = [0, 1, 2].map(|k| low[k] + t[2] * (high[k] - low[k]));
        (value, 1.0 / self.grid.cell * DVec3::new(gx, gy, high[0] - low[0]))
    }

    /// The values at all grid points, x fastest, and their number along each side.
    pub(super) fn grid_values(&self) -> (&[f64], usize) {
        (&self.values, self.grid.cells)
    }

    /// Side of a grid cell.
    pub(super) fn cell(&self) -> f64 {
        self.grid.cell
    }

    /// The grid point of the smallest coordinates.
    pub(super) fn origin(&self) -> DVec3 {
        self.grid.origin
    }

    /// The box around the points: the grid without the parts where its periodic images might matter.
    pub(super) fn bounds(&self) -> BoundingBox {
        let side = self.grid.cell * (self.grid.cells - 1) as f64;
        let margin = DVec3::splat(0.1 * side);
        let min = self.grid.origin + margin;
        BoundingBox { min, max: self.grid.origin + DVec3::splat(side) - margin }
    }

    /// A bound of the slope everywhere.
    pub(super) fn largest_slope(&self) -> f64 {
        let n = self.grid.cells;
        let along = |step: usize| {
            (self.values.iter().zip(&self.values[step..])).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        [1, n, n * n].map(along).iter().map(|d| d * d).sum::<f64>().sqrt() / self.grid.cell
    }

    /// Median slope of the indicator at the points.
    pub(super) fn steepness(&self, points: &[DVec3]) -> f64 {
        let mut slopes: Vec<f64> = points.iter().map(|p| self.sample(*p).1.length()).collect();
        let middle = slopes.len() / 2;
        *slopes.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The value deep inside: the 99.5th percentile over the grid.
    pub(super) fn inside(&self) -> f64 {
        let mut values = self.values.clone();
        // A percentile instead of the maximum, which a dense cluster of points could raise alone.
        let high = values.len() - values.len() / 200;
        *values.select_nth_unstable_by(high, f64::total_cmp).1
    }

    /// The level at which the surface passes through the points: their median value.
    pub(super) fn level(&self, points: &[DVec3]) -> f64 {
        let mut values: Vec<f64> = points.iter().map(|p| self.sample(*p).0).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

impl Grid {
    /// The lowest corner of the cube that holds `p`, and the local coordinates in it.
    fn locate(self, p: DVec3) -> ([usize; 3], DVec3) {
        let x = (1.0 / self.cell * (p - self.origin)).map(|c| c.clamp(0.0, self.cells as f64 - 1.0));
        let corner = x.to_array().map(|c| (c as usize).min(self.cells - 2));
        (corner, DVec3::from_array([0, 1, 2].map(|d| x[d] - corner[d] as f64)))
    }

    /// The index of a grid point.
    fn index(self, [a, b, c]: [usize; 3]) -> usize {
        (c * self.cells + b) * self.cells + a
    }

    /// Distributes a unit over the eight grid points around `p`: the transpose of the interpolation in
    /// [`BlurredIndicator::sample`].
    fn splat(self, p: DVec3, mut add: impl FnMut(usize, f64)) {
        let (corner, t) = self.locate(p);
        for c in 0..2 {
            for b in 0..2 {
                for a in 0..2 {
                    let w = [1.0 - t[0], t[0]][a] * [1.0 - t[1], t[1]][b] * [1.0 - t[2], t[2]][c];
                    add(self.index([corner[0] + a, corner[1] + b, corner[2] + c]), w);
                }
            }
        }
    }
}

/// The smallest and largest coordinates of points.
fn bounds_of(points: &[DVec3]) -> (DVec3, DVec3) {
    points.iter().fold((DVec3::MAX, DVec3::MIN), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
}

/// Position along each axis of a point of a grid of `n` points a side.
fn split(index: usize, n: usize) -> [usize; 3] {
    [index % n, index / n % n, index / n / n]
}

/// Wave vector of a spectral index, in radians a grid cell.
fn wave(index: usize, n: usize) -> DVec3 {
    DVec3::from(split(index, n).map(|m| {
        let signed = if m > n / 2 { m as f64 - n as f64 } else { m as f64 };
        // The highest frequency has no sign, so an odd multiplier must be zero there.
        if m == n / 2 { 0.0 } else { TAU * signed / n as f64 }
    }))
}

/// Spectral index of the opposite wave vector.
fn mirrored(index: usize, cells: usize) -> usize {
    let m = split(index, cells).map(|m| (cells - m) % cells);
    (m[2] * cells + m[1]) * cells + m[0]
}

/// Multiplies a spectrum by that of a Gaussian, whose σ is in grid cells.
fn blur(grid: &mut [Complex<f64>], n: usize, sigma_cells: f64) {
    // A Gaussian is the product of Gaussians along the axes. The highest frequency has a size, though no
    // sign: unblurred, the points of a plane across an axis changed the density everywhere along it, and the
    // area of single points was far too large (decision 0124).
    let frequency = |m: usize| TAU * m.min(n - m) as f64 / n as f64;
    let along: Vec<f64> = (0..n).map(|m| (-0.5 * (sigma_cells * frequency(m)).powi(2)).exp()).collect();
    grid.par_chunks_mut(n).enumerate().for_each(|(row, values)| {
        let across = along[row % n] * along[row / n];
        for (value, w) in values.iter_mut().zip(&along) {
            *value *= across * w;
        }
    });
}

/// The transform along all three axes, not normalised.
fn transform(grid: &mut Vec<Complex<f64>>, n: usize, direction: FftDirection) {
    let plan = FftPlanner::new().plan_fft(n, direction);
    let mut turned = vec![Complex::new(0.0, 0.0); grid.len()];
    // Three passes with a turn after each, so that every pass transforms rows that are contiguous in
    // memory.
    for _ in 0..3 {
        grid.par_chunks_mut(n * n).for_each(|slab| plan.process(slab));
        // Rotate the axes: the contiguous one becomes the slowest. Small tiles are turned one after another,
        // since rows are a multiple of a memory page apart and displace each other from the cache.
        let source = &*grid;
        turned.par_chunks_mut(n * n * TILE[0]).enumerate().for_each(|(chunk, slabs)| {
            for (tile, rows) in source.chunks(n * TILE[1]).enumerate() {
                for (k, slab) in slabs.chunks_exact_mut(n * n).enumerate() {
                    let line = slab[tile * TILE[1]..].iter_mut().zip(rows.chunks_exact(n));
                    line.for_each(|(number, row)| *number = row[chunk * TILE[0] + k]);
                }
            }
        });
        std::mem::swap(grid, &mut turned);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plane of points across an axis must not change the density at a point far from it.
    #[test]
    fn the_highest_frequency_is_blurred_as_well() {
        let n = 32;
        let mut counts = vec![Complex::new(0.0, 0.0); n * n * n];
        for z in 0..n {
            for y in 0..n {
                counts[(z * n + y) * n + 4].re = 1.0;
            }
        }
        transform(&mut counts, n, FftDirection::Forward);
        blur(&mut counts, n, DENSITY_BLUR);
        transform(&mut counts, n, FftDirection::Inverse);
        let density = |x: usize| counts[(16 * n + 16) * n + x].re / counts.len() as f64;
        assert!((density(4) - 0.1995).abs() < 1e-3, "{}", density(4));
        assert!((17..24).all(|x| density(x).abs() < 1e-6), "{}", density(20));
    }

    #[test]
    fn level_set_of_a_half_seen_sphere_lies_on_the_points_and_closes_behind_them() {
        let mut points = Vec::new();
        for i in 0..6000 {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / 6000.0;
            let a = i as f64 * 2.399_963_229_728_653;
            let r = (1.0_f64 - z * z).sqrt();
            points.push(DVec3::new(r * a.cos() + 5.0, r * a.sin(), z));
        }
        points.retain(|p| p[2] > -0.8);
        let normals: Vec<DVec3> = points.iter().map(|p| *p - DVec3::new(5.0, 0.0, 0.0)).collect();
        let indicator = Indicator::new(&points, &normals);
        let field = indicator.blurred(1.5 * indicator.cell());
        let level = field.level(&points);
        for p in points.iter().step_by(50) {
            let (value, gradient) = field.sample(*p);
            let off = (value - level) / gradient.length();
            assert!(off.abs() < 0.05, "{p:?} is {off} off the level set");
            assert!(gradient.dot(*p - DVec3::new(5.0, 0.0, 0.0)) < 0.0, "the indicator falls outwards");
        }
        assert!(
            field.sample(DVec3::new(5.0, 0.0, 0.0)).0 > level
                && field.sample(DVec3::new(5.0, 0.0, -1.4)).0 < level
        );
    }
}
