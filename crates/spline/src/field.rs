//! Vector fields over a surface, sampled at the 2 × 2 Gauss points of every leaf.
//!
//! Input: a [`SurfaceSystem`] and values at the points. Output: right-hand sides `∫ B_a f dA`, and points and
//! tangents of the surface for the evaluation of the field. Quantities that depend only on the four points
//! are computed once.

use crate::basis::cubic;
use crate::surface::{Surface, coordinates_in_fours};
use crate::system::SurfaceSystem;
use planish_core::DVec3;
use rayon::prelude::*;

/// The 2 × 2 Gauss points of a leaf: exact for fields that are cubic in u and in v.
#[derive(Debug, Clone)]
pub struct FieldPoints {
    /// The two coordinates along each side.
    along: [f64; 2],
    /// Values and slopes of the four cubics at these coordinates.
    value: [[f64; 4]; 2],
    slope: [[f64; 4]; 2],
}

impl Default for FieldPoints {
    fn default() -> Self {
        // Two points per direction. With a single one in the middle, thin parts of a growing ball came out
        // too short (`docs/decisions/0001-growing-a-ball.md`).
        let near = 0.5 - 0.5 / 3.0_f64.sqrt();
        let along = [near, 1.0 - near];
        Self { along, value: along.map(|s| cubic(s)[0]), slope: along.map(|s| cubic(s)[1]) }
    }
}

impl FieldPoints {
    /// Number of points per leaf.
    pub const COUNT: usize = 4;

    /// Leaf-local coordinates of the `n`-th point.
    #[must_use]
    pub fn local(&self, n: usize) -> [f64; 2] {
        [self.along[n % 2], self.along[n / 2]]
    }

    /// Point and tangents `S, S_u, S_v` at the four points of a leaf with these coefficients and this side.
    #[inline]
    #[must_use]
    pub fn frames(&self, coefficients: &[DVec3; 16], side: f64) -> [[DVec3; 3]; Self::COUNT] {
        // Rows first, then columns: the sums along a row are shared by two points.
        let mut sums = [[[0.0; 4]; 3]; Self::COUNT];
        for r in 0..4 {
            let mut row = [[[0.0; 4]; 2]; 2];
            for k in 0..4 {
                let p = coordinates_in_fours(coefficients, 4 * r + k);
                for a in 0..2 {
                    for d in 0..4 {
                        row[a][0][d] += self.value[a][k] * p[d];
                        row[a][1][d] += self.slope[a][k] * p[d];
                    }
                }
            }
            for (n, sum) in sums.iter_mut().enumerate() {
                let (row, value, slope) = (&row[n % 2], self.value[n / 2][r], self.slope[n / 2][r]);
                for d in 0..4 {
                    sum[0][d] += value * row[0][d];
                    sum[1][d] += value * row[1][d];
                    sum[2][d] += slope * row[0][d];
                }
            }
        }
        let h = 1.0 / side;
        sums.map(|[point, du, dv]| {
            [
                DVec3::new(point[0], point[1], point[2]),
                DVec3::new(h * du[0], h * du[1], h * du[2]),
                DVec3::new(h * dv[0], h * dv[1], h * dv[2]),
            ]
        })
    }

    /// `Σ_n B_k(point n) f_n` for the sixteen coefficients of a leaf.
    #[inline]
    fn spread(&self, field: &[DVec3; Self::COUNT]) -> [DVec3; 16] {
        std::array::from_fn(|k| {
            let mut sum = DVec3::ZERO;
            for (n, value) in field.iter().enumerate() {
                let weight = self.value[n / 2][k / 4] * self.value[n % 2][k % 4];
                sum += weight * value;
            }
            sum
        })
    }
}

impl SurfaceSystem {
    /// Area of each point in the metric of a reference surface, by leaf, for [`Self::project_field`].
    #[must_use]
    pub fn field_weights(&self, points: &FieldPoints, reference: &Surface) -> Vec<[f64; FieldPoints::COUNT]> {
        (0..self.space().leaves().len())
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| {
                let side = self.space().leaves()[leaf].side();
                std::array::from_fn(|n| {
                    let [s, t] = points.local(n);
                    0.25 * side * side * reference.leaf_jet(leaf, s, t).area_element()
                })
            })
            .collect()
    }

    /// Right-hand sides `∫ B_a f dA` of a vector field: node-major, three columns.
    ///
    /// `field(leaf)` are the values at the points of a leaf; `weights` are those of [`Self::field_weights`].
    #[must_use]
    pub fn project_field(
        &self,
        points: &FieldPoints,
        weights: &[[f64; FieldPoints::COUNT]],
        field: impl Fn(usize) -> [DVec3; FieldPoints::COUNT] + Sync,
    ) -> Vec<f64> {
        let of_leaves: Vec<[DVec3; 16]> = (0..self.space().leaves().len())
            .into_par_iter()
            .with_min_len(32)
            .map(|leaf| {
                let mut values = field(leaf);
                for (value, w) in values.iter_mut().zip(&weights[leaf]) {
                    *value = value.map(|x| w * x);
                }
                // Leaves are independent. Their sums at the nodes are formed afterwards in a fixed order.
                points.spread(&values)
            })
            .collect();
        self.space().sparse_extraction().gather(&of_leaves, self.space().node_count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::BaseShape;

    /// Frames of a growing ball agree with its jets.
    #[test]
    fn frames_are_the_jets_of_the_surface_and_projections_integrate_it() {
        let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z).surface([12, 8]).unwrap();
        let points = FieldPoints::default();
        let system = SurfaceSystem::new(ball.space()).unwrap();
        let weights = system.field_weights(&points, &ball);
        for leaf in [0, 17, 50] {
            let side = ball.space().leaves()[leaf].side();
            for (n, [point, du, dv]) in
                points.frames(ball.leaf_coefficients(leaf), side).into_iter().enumerate()
            {
                let [s, t] = points.local(n);
                let jet = ball.leaf_jet(leaf, s, t);
                for d in 0..3 {
                    assert!((point[d] - jet.point[d]).abs() < 1e-14);
                    assert!((du[d] - jet.du[d]).abs() < 1e-13 && (dv[d] - jet.dv[d]).abs() < 1e-13);
                }
            }
        }
        // The functions of the nodes sum to one, so right-hand sides of a constant sum to the area, 16 π.
        let sums =
            system.project_field(&points, &weights, |_| [DVec3::new(1.0, 0.0, -2.0); FieldPoints::COUNT]);
        let total =
            sums.chunks_exact(3).fold(DVec3::ZERO, |t, s| DVec3::new(t[0] + s[0], t[1] + s[1], t[2] + s[2]));
        let area = 16.0 * std::f64::consts::PI;
        assert!((total[0] / area - 1.0).abs() < 2e-3, "{total:?} of {area}");
        assert!(total[1] == 0.0 && (total[2] + 2.0 * total[0]).abs() < 1e-9);
    }
}
