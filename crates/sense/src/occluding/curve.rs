//! A contour as a smooth curve: position, tangent and curvature anywhere along it, with σ.
//!
//! In: a [`Contour`] whose errors are independent, or correlated over some distance. Out: parabolas fitted to
//! the points in a window.
//!
//! Not guaranteed: detail smaller than the window is lost. Positions whose window contains a corner are
//! marked.

use super::outline::Contour;
use planish_core::matrix3::rows;

/// Minimum number of points in a window: a parabola has three coefficients, and the residuals need degrees of
/// freedom.
const MIN_PLACES: usize = 5;
/// Minimum extent of a window on either side, as a share of its half width.
const MIN_SIDE: f64 = 0.6;
/// Turn over half of the window above which a position is a corner, in radians: 40°. A parabola no longer
/// fits there.
const CORNER_TURN: f64 = 0.7;
/// Reduced χ² above which a position is a corner or a T-junction, where one part hides another.
const CORNER_CHI2: f64 = 6.0;

/// A parabola at a position of a contour.
#[derive(Debug, Clone, Copy)]
pub(super) struct Local {
    /// The pixel.
    pub place: [f64; 2],
    /// Unit tangent, along the way.
    pub along: [f64; 2],
    /// σ across the contour, in pixels.
    pub sigma_across: f64,
    /// σ of the direction of the tangent, in radians.
    pub sigma_turn: f64,
    /// χ² of the residuals, and its degrees of freedom.
    pub chi2: f64,
    pub freedom: f64,
    /// True at a corner.
    pub corner: bool,
}

impl Local {
    /// The unit direction away from the object.
    pub fn outward(&self) -> [f64; 2] {
        [self.along[1], -self.along[0]]
    }
}

/// A contour with the lengths along it.
pub(super) struct Curve<'a> {
    contour: &'a Contour,
    /// Arc length at each point.
    lengths: Vec<f64>,
    /// Total length.
    pub total: f64,
    /// Half width of the window, in pixels.
    half: f64,
    /// σ of a point.
    sigma: f64,
    /// Length within which errors are correlated.
    apart: f64,
}

impl<'a> Curve<'a> {
    /// A curve with arc lengths; `None` for a contour shorter than two windows.
    pub fn new(contour: &'a Contour, half: f64, sigma: f64, apart: f64) -> Option<Self> {
        let mut lengths = Vec::with_capacity(contour.places.len());
        let mut total = 0.0;
        for (k, p) in contour.places.iter().enumerate() {
            if k > 0 {
                let q = contour.places[k - 1];
                total += (p[0] - q[0]).hypot(p[1] - q[1]);
            }
            lengths.push(total);
        }
        if let (true, Some(first), Some(last)) =
            (contour.closed, contour.places.first(), contour.places.last())
        {
            total += (first[0] - last[0]).hypot(first[1] - last[1]);
        }
        (total > 4.0 * half && total.is_finite()).then_some(Self {
            contour,
            lengths,
            total,
            half,
            sigma,
            apart,
        })
    }

    pub fn closed(&self) -> bool {
        self.contour.closed
    }

    /// An arc length, wrapped into the range of a closed contour.
    pub fn wrapped(&self, s: f64) -> f64 {
        match self.contour.closed {
            true => s.rem_euclid(self.total),
            false => s,
        }
    }

    /// Distance of two arc lengths along the contour.
    pub fn between(&self, a: f64, b: f64) -> f64 {
        let d = (a - b).abs();
        match self.contour.closed {
            true => d.min(self.total - d),
            false => d,
        }
    }

    /// The parabola at an arc length; `None` if there are too few points around it.
    pub fn at(&self, s: f64) -> Option<Local> {
        let s = self.wrapped(s);
        let count = self.contour.places.len();
        // (length relative to s, index) of the points in the window.
        let mut near: Vec<(f64, usize)> = Vec::new();
        // From the position outwards on both sides, across the seam of a closed contour.
        // Lengths are ascending, so a search by bisection replaces a pass over the contour.
        let start = self.lengths.partition_point(|l| *l < s);
        for (by, way) in [(0, 1_isize), (-1, -1)] {
            let mut k = start as isize + by;
            for _ in 0..count {
                let turns = k.div_euclid(count as isize);
                if turns != 0 && !self.contour.closed {
                    break;
                }
                let index = k.rem_euclid(count as isize) as usize;
                let offset = self.lengths[index] + turns as f64 * self.total - s;
                if offset.abs() > self.half {
                    break;
                }
                near.push((offset, index));
                k += way;
            }
        }
        if near.len() < MIN_PLACES {
            return None;
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (low, high) = (near[0], near[near.len() - 1]);
        // At an end of an open contour the window is one-sided, and the tangent of the parabola uncertain.
        if low.0 > -MIN_SIDE * self.half || high.0 < MIN_SIDE * self.half {
            return None;
        }
        // In coordinates along and across the chord, with the origin at the nearest point.
        let middle = near.iter().min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
        let place = |k: usize| self.contour.places[k];
        let (a, b) = (place(low.1), place(high.1));
        let chord = (b[0] - a[0]).hypot(b[1] - a[1]);
        // A contour that turns back within its window is no function over the chord.
        if chord <= 0.2 * (high.0 - low.0) {
            return None;
        }
        let along = [(b[0] - a[0]) / chord, (b[1] - a[1]) / chord];
        let across = [along[1], -along[0]];
        let origin = place(middle.1);
        let origin = [0, 1].map(|k| origin[k] - middle.0 * along[k]);
        let local = |k: usize| {
            let d = [place(k)[0] - origin[0], place(k)[1] - origin[1]];
            // Lengths in half widths of the window: powers of x are then at most 1, and the normal matrix is
            // well conditioned.
            [(d[0] * along[0] + d[1] * along[1]) / self.half, d[0] * across[0] + d[1] * across[1]]
        };
        let mut normal = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        for (_, k) in &near {
            let [x, y] = local(*k);
            let row = [1.0, x, x * x];
            for i in 0..3 {
                right[i] += row[i] * y;
                for j in 0..3 {
                    normal[i][j] += row[i] * row[j];
                }
            }
        }
        let inverse = inverse3(&normal)?;
        let c = [0, 1, 2].map(|i| (0..3).map(|j| inverse[i][j] * right[j]).sum::<f64>());
        let left: f64 = (near.iter())
            .map(|(_, k)| {
                let [x, y] = local(*k);
                (y - c[0] - c[1] * x - c[2] * x * x).powi(2)
            })
            .sum();
        // Points with correlated errors count as one.
        let spacing = (high.0 - low.0) / (near.len() - 1) as f64;
        // The variance of a mean of correlated errors is that of fewer independent ones.
        let points_per_independent = (self.apart / spacing).max(1.0);
        let variance = self.sigma * self.sigma * points_per_independent;
        let freedom = near.len() as f64 - 3.0;
        let slope = c[1] / self.half;
        let length = slope.hypot(1.0);
        Some(Local {
            place: [0, 1].map(|k| origin[k] + c[0] * across[k]),
            along: [0, 1].map(|k| (along[k] + slope * across[k]) / length),
            sigma_across: (variance * inverse[0][0]).sqrt(),
            sigma_turn: (variance * inverse[1][1]).sqrt() / self.half,
            // With the stated σ, not the enlarged variance: this tests σ itself.
            chi2: left / (self.sigma * self.sigma),
            freedom,
            corner: (2.0 * c[2] / self.half).abs() > CORNER_TURN
                || left > CORNER_CHI2 * self.sigma * self.sigma * freedom,
        })
    }
}

fn inverse3(m: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let [a, b, c] = rows(m);
    let columns = [b.cross(c), c.cross(a), a.cross(b)];
    let determinant = a.dot(columns[0]);
    (determinant.abs() > 0.0 && determinant.is_finite())
        .then(|| [0, 1, 2].map(|i| [0, 1, 2].map(|j| columns[j][i] / determinant)))
}
