//! The solid that oriented points enclose, as a blurred indicator function on a grid.
//!
//! Comes in: points with outward normals. Goes out: a function that is high inside and low outside, at any blur, and the
//! level that passes through the points. It fills holes smoothly, forgives noise and outliers, and at strong blur it is a
//! blob: a surface that follows its level set from strong to weak blur grows into the shape without tearing or folding.
//!
//! With normals `n_i` and areas `a_i`, the indicator obeys `∇χ = −Σ a_i n_i δ(x − p_i)`, hence in Fourier space
//! `χ̂ = i k·V̂ / |k|²`, and a blur is a factor `exp(−σ²k²/2)`. Areas come from the local density of points.
//!
//! Not guaranteed: detail below one grid cell.
//!
//! # References
//! Kazhdan, *Reconstruction of solid models from oriented point sets*, SGP 2005.

use planish_estimate::vector3::{dot, scale, sub};
use rayon::prelude::*;
use rustfft::num_complex::Complex;
use rustfft::{FftDirection, FftPlanner};
use std::f64::consts::TAU;

/// Grid cells along each side: 2⁵ · 3, which transforms fast.
const CELLS: usize = 96;
/// The box around the points is this much larger than they are, so that its periodic images do not meet.
const PADDING: f64 = 1.6;
/// Blur of the density estimate, in grid cells.
const DENSITY_BLUR: f64 = 2.0;

/// The transformed indicator of a cloud.
pub(super) struct Indicator {
    origin: [f64; 3],
    cell: f64,
    spectrum: Vec<Complex<f64>>,
}

/// The indicator at one blur.
pub(super) struct BlurredIndicator {
    origin: [f64; 3],
    cell: f64,
    values: Vec<f64>,
}

impl Indicator {
    /// Transforms oriented points; those with zero normals are left out.
    pub(super) fn new(points: &[[f64; 3]], normals: &[[f64; 3]]) -> Self {
        let (lo, hi) = points.iter().fold(([f64::MAX; 3], [f64::MIN; 3]), |(lo, hi), p| {
            ([0, 1, 2].map(|d| lo[d].min(p[d])), [0, 1, 2].map(|d| hi[d].max(p[d])))
        });
        let side = PADDING * (0..3).map(|d| hi[d] - lo[d]).fold(0.0, f64::max);
        let origin = [0, 1, 2].map(|d| 0.5 * (lo[d] + hi[d]) - 0.5 * side);
        let cell = side / CELLS as f64;
        let mut counts = vec![Complex::new(0.0, 0.0); CELLS.pow(3)];
        for p in points {
            splat(origin, cell, *p, |index, w| counts[index].re += w);
        }
        transform(&mut counts, FftDirection::Forward);
        blur(&mut counts, DENSITY_BLUR);
        transform(&mut counts, FftDirection::Inverse);
        let density = BlurredIndicator {
            origin,
            cell,
            values: counts.iter().map(|c| c.re / counts.len() as f64).collect(),
        };
        // Two real fields ride in one complex transform; the third has its own.
        let mut xy = vec![Complex::new(0.0, 0.0); CELLS.pow(3)];
        let mut z = xy.clone();
        for (p, n) in points.iter().zip(normals) {
            let there = density.sample(*p).0;
            if there <= 0.0 {
                continue;
            }
            // A sheet of ρ points an area has the blurred density ρ/(√2π σ) on it; the constant drops out of the level set.
            let a = scale(1.0 / there, *n);
            splat(origin, cell, *p, |index, w| {
                xy[index] += Complex::new(w * a[0], w * a[1]);
                z[index].re += w * a[2];
            });
        }
        transform(&mut xy, FftDirection::Forward);
        transform(&mut z, FftDirection::Forward);
        let spectrum = (0..CELLS.pow(3))
            .into_par_iter()
            .map(|index| {
                let k = wave(index);
                let k2 = dot(k, k);
                if k2 == 0.0 {
                    return Complex::new(0.0, 0.0);
                }
                // Apart again: x̂ = (F(k) + F̄(−k))/2, ŷ = (F(k) − F̄(−k))/2i.
                let (f, g) = (xy[index], xy[mirrored(index)].conj());
                let x = (f + g) * 0.5;
                let y = (f - g) * Complex::new(0.0, -0.5);
                (x * k[0] + y * k[1] + z[index] * k[2]) * Complex::new(0.0, 1.0 / k2)
            })
            .collect();
        Self { origin, cell, spectrum }
    }

    /// Side of a grid cell.
    pub(super) fn cell(&self) -> f64 {
        self.cell
    }

    /// The indicator blurred by a Gaussian of the given σ (a length).
    pub(super) fn blurred(&self, sigma: f64) -> BlurredIndicator {
        let mut grid = self.spectrum.clone();
        blur(&mut grid, sigma / self.cell);
        transform(&mut grid, FftDirection::Inverse);
        BlurredIndicator {
            origin: self.origin,
            cell: self.cell,
            values: grid.iter().map(|c| c.re).collect(),
        }
    }
}

impl BlurredIndicator {
    /// Value and gradient by trilinear interpolation; outside the box, of its nearest point.
    pub(super) fn sample(&self, p: [f64; 3]) -> (f64, [f64; 3]) {
        let (corner, t) = locate(self.origin, self.cell, p);
        let at = |a: usize, b: usize, c: usize| {
            self.values[((corner[2] + c) % CELLS * CELLS + (corner[1] + b) % CELLS) * CELLS + (corner[0] + a) % CELLS]
        };
        let (mut value, mut gradient) = (0.0, [0.0; 3]);
        for c in 0..2 {
            for b in 0..2 {
                for a in 0..2 {
                    let v = at(a, b, c);
                    let w = [[1.0 - t[0], t[0]][a], [1.0 - t[1], t[1]][b], [1.0 - t[2], t[2]][c]];
                    let s = [[-1.0, 1.0][a], [-1.0, 1.0][b], [-1.0, 1.0][c]];
                    value += v * w[0] * w[1] * w[2];
                    gradient[0] += v * s[0] * w[1] * w[2];
                    gradient[1] += v * w[0] * s[1] * w[2];
                    gradient[2] += v * w[0] * w[1] * s[2];
                }
            }
        }
        (value, scale(1.0 / self.cell, gradient))
    }

    /// How steeply the indicator falls at the points: their median slope.
    pub(super) fn steepness(&self, points: &[[f64; 3]]) -> f64 {
        let mut slopes: Vec<f64> = points
            .iter()
            .map(|p| dot(self.sample(*p).1, self.sample(*p).1).sqrt())
            .collect();
        let middle = slopes.len() / 2;
        *slopes.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The value deep inside: the 99.5th percentile over the grid.
    pub(super) fn inside(&self) -> f64 {
        let mut values = self.values.clone();
        let high = values.len() - values.len() / 200;
        *values.select_nth_unstable_by(high, f64::total_cmp).1
    }

    /// The level at which the surface passes through the points: their median value.
    pub(super) fn level(&self, points: &[[f64; 3]]) -> f64 {
        let mut values: Vec<f64> = points.iter().map(|p| self.sample(*p).0).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

fn locate(origin: [f64; 3], cell: f64, p: [f64; 3]) -> ([usize; 3], [f64; 3]) {
    let x = scale(1.0 / cell, sub(p, origin)).map(|c| c.clamp(0.0, CELLS as f64 - 1.0));
    let corner = x.map(|c| c as usize);
    (corner, [0, 1, 2].map(|d| x[d] - corner[d] as f64))
}

fn splat(origin: [f64; 3], cell: f64, p: [f64; 3], mut add: impl FnMut(usize, f64)) {
    let (corner, t) = locate(origin, cell, p);
    for c in 0..2 {
        for b in 0..2 {
            for a in 0..2 {
                let w = [1.0 - t[0], t[0]][a] * [1.0 - t[1], t[1]][b] * [1.0 - t[2], t[2]][c];
                add(
                    ((corner[2] + c) % CELLS * CELLS + (corner[1] + b) % CELLS) * CELLS + (corner[0] + a) % CELLS,
                    w,
                );
            }
        }
    }
}

/// Wave vector of a spectral index, in radians a grid cell.
fn wave(index: usize) -> [f64; 3] {
    [index % CELLS, index / CELLS % CELLS, index / CELLS / CELLS].map(|m| {
        let signed = if m > CELLS / 2 {
            m as f64 - CELLS as f64
        } else {
            m as f64
        };
        // The highest frequency has no sign: an odd multiplier must leave it out.
        if m == CELLS / 2 {
            0.0
        } else {
            TAU * signed / CELLS as f64
        }
    })
}

fn mirrored(index: usize) -> usize {
    let m = [index % CELLS, index / CELLS % CELLS, index / CELLS / CELLS].map(|m| (CELLS - m) % CELLS);
    (m[2] * CELLS + m[1]) * CELLS + m[0]
}

fn blur(grid: &mut [Complex<f64>], sigma_cells: f64) {
    grid.par_iter_mut().enumerate().for_each(|(index, value)| {
        let k = wave(index);
        *value *= (-0.5 * sigma_cells * sigma_cells * dot(k, k)).exp();
    });
}

/// The transform along all three axes, not normalised.
fn transform(grid: &mut Vec<Complex<f64>>, direction: FftDirection) {
    let plan = FftPlanner::new().plan_fft(CELLS, direction);
    for _ in 0..3 {
        grid.par_chunks_mut(CELLS * CELLS).for_each(|slab| plan.process(slab));
        // Turn the axes: what was contiguous becomes the slowest.
        let turned: Vec<Complex<f64>> = {
            let source = &*grid;
            let mut out = vec![Complex::new(0.0, 0.0); source.len()];
            out.par_chunks_mut(CELLS * CELLS).enumerate().for_each(|(x, slab)| {
                for (row, line) in slab.iter_mut().enumerate() {
                    *line = source[row * CELLS + x];
                }
            });
            out
        };
        *grid = turned;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_set_of_a_half_seen_sphere_lies_on_the_points_and_closes_behind_them() {
        let mut points = Vec::new();
        for i in 0..6000 {
            let z = 1.0 - 2.0 * (i as f64 + 0.5) / 6000.0;
            let a = i as f64 * 2.399_963_229_728_653;
            let r = (1.0_f64 - z * z).sqrt();
            points.push([r * a.cos() + 5.0, r * a.sin(), z]);
        }
        points.retain(|p| p[2] > -0.8);
        let normals: Vec<[f64; 3]> = points.iter().map(|p| sub(*p, [5.0, 0.0, 0.0])).collect();
        let indicator = Indicator::new(&points, &normals);
        let field = indicator.blurred(1.5 * indicator.cell());
        let level = field.level(&points);
        for p in points.iter().step_by(50) {
            let (value, gradient) = field.sample(*p);
            let off = (value - level) / dot(gradient, gradient).sqrt();
            assert!(off.abs() < 0.05, "{p:?} is {off} off the level set");
            assert!(
                dot(gradient, sub(*p, [5.0, 0.0, 0.0])) < 0.0,
                "the indicator falls outwards"
            );
        }
        assert!(field.sample([5.0, 0.0, 0.0]).0 > level && field.sample([5.0, 0.0, -1.4]).0 < level);
    }
}
