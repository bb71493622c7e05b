//! Smoothness energies of a surface, as quadratic forms on its leaves.
//!
//! Input: a reference [`Surface`] that defines the metric. Output: for every leaf, the thin-plate form on its
//! sixteen coefficients, and its area.
//!
//! The thin-plate energy of a function f on the surface is `∫ |∇∇f|² dA` with the covariant Hessian
//! `∇_a∇_b f = f_ab − Γ^c_ab f_c` of the metric of the reference. It does not depend on the parametrisation,
//! so it stays finite at the poles of a ball and where a chart is stretched. The parametric energy
//! `∫ f_uu² + 2 f_uv² + f_vv²` does not; both agree on a flat reference. Summed over the three coordinates it
//! is the bending energy `∫ κ1² + κ2² dA` to leading order.
//!
//! # References
//! Duchon, *Splines minimizing rotation-invariant semi-norms in Sobolev spaces*, 1977; do Carmo, *Riemannian
//! Geometry*, 1992, ch. 2.

use crate::basis::cubic;
use crate::cell_information::add_to_triangle;
use crate::hierarchy::Hierarchy;
use crate::surface::{Jet, Surface};
use planish_core::DVec3;
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// Four Gauss–Legendre points and weights on [0, 1]: exact to degree 7, sufficient for squares of cubics on a
/// plane.
const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_7, 0.173_927_422_568_726_9),
    (0.330_009_478_207_571_9, 0.326_072_577_431_273_1),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_9),
];

/// Energy forms of one leaf.
#[derive(Debug, Clone)]
pub struct LeafEnergy {
    /// `∫ ∇∇B_k : ∇∇B_l dA` over the leaf.
    pub thin_plate: [[f64; 16]; 16],
    /// Area of the leaf on the reference surface.
    pub area: f64,
}

impl LeafEnergy {
    /// The energy of the sixteen coefficients of a leaf, summed over the three coordinates: `∫ κ1² + κ2² dA`
    /// to leading order.
    #[must_use]
    pub fn energy(&self, coefficients: &[DVec3; 16]) -> f64 {
        let mut sum = 0.0;
        for k in 0..16 {
            for l in 0..16 {
                sum += self.thin_plate[k][l] * coefficients[k].dot(coefficients[l]);
            }
        }
        sum
    }
}

/// A quadrature point of a leaf, for integrals over the surface.
#[derive(Debug, Clone, Copy)]
pub struct QuadraturePoint {
    /// Leaf-local coordinates.
    pub local: [f64; 2],
    /// Fraction of the parameter area of the leaf.
    pub weight: f64,
}

/// The sixteen quadrature points of a leaf.
#[must_use]
pub fn quadrature() -> [QuadraturePoint; 16] {
    std::array::from_fn(|n| {
        let ((s, ws), (t, wt)) = (GAUSS[n % 4], GAUSS[n / 4]);
        QuadraturePoint { local: [s, t], weight: ws * wt }
    })
}

impl Surface {
    /// The area of a leaf, integrated by [`quadrature`].
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// let sheet = BaseShape::plane(DVec3::ZERO, [DVec3::X, DVec3::Y], [2.0, 1.0]).surface([4,
    /// 4])?; assert!((sheet.leaf_area(0) - 8.0 / 16.0).abs() < 1e-12);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn leaf_area(&self, leaf: usize) -> f64 {
        let side = self.space().leaves()[leaf].side();
        quadrature()
            .iter()
            .map(|q| q.weight * side * side * self.leaf_jet(leaf, q.local[0], q.local[1]).area_element())
            .sum()
    }

    /// The thin-plate forms of all leaves of `space` in the metric of this surface.
    ///
    /// `space` is that of this surface or a refinement of it. Cost: 16 jets and about 7,000 multiply-adds per
    /// leaf, in parallel.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// // A sphere of radius r has the bending energy ∫ κ1² + κ2² dA = 8π for any r.
    /// let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z).surface([32, 16])?;
    /// let forms = ball.thin_plate(ball.space());
    /// let energy: f64 = (forms.iter().enumerate())
    ///     .map(|(leaf, form)| form.energy(ball.leaf_coefficients(leaf)))
    ///     .sum();
    /// assert!((energy / (8.0 * std::f64::consts::PI) - 1.0).abs() < 0.05);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn thin_plate(&self, space: &Hierarchy) -> Vec<LeafEnergy> {
        let bases = quadrature().map(PointBasis::new);
        (0..space.leaves().len())
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| self.leaf_energy(space, leaf, &bases))
            .collect()
    }

    /// The thin-plate form of one leaf in the metric of this surface.
    pub(crate) fn leaf_thin_plate(&self, leaf: usize) -> [[f64; 16]; 16] {
        self.leaf_energy(self.space(), leaf, &quadrature().map(PointBasis::new)).thin_plate
    }

    fn leaf_energy(&self, space: &Hierarchy, leaf: usize, bases: &[PointBasis; 16]) -> LeafEnergy {
        let mut thin_plate = [[0.0; 16]; 16];
        let mut total_area = 0.0;
        let side = space.leaves()[leaf].side();
        let own = std::ptr::eq(space, &**self.space());
        for basis in bases {
            let [s, t] = basis.point.local;
            // The usual case: the leaf is known and need not be located.
            let jet = if own {
                self.leaf_jet(leaf, s, t)
            } else {
                let [u, v] = space.parameters(leaf, [s, t]);
                self.jet(u, v)
            };
            // Gauss points are inside the leaf and never at a pole, so only a fold is singular. Its energy
            // would be infinite.
            let Some((rows, area)) = basis.hessian_rows(&jet, side) else {
                continue;
            };
            let weight = basis.point.weight * side * side * area;
            total_area += weight;
            for row in &rows {
                for k in 0..16 {
                    add_to_triangle(&mut thin_plate[k], k, weight * row[k], row);
                }
            }
        }
        for k in 0..16 {
            for l in 0..k {
                thin_plate[l][k] = thin_plate[k][l];
            }
        }
        LeafEnergy { thin_plate, area: total_area }
    }
}

/// The sixteen functions of a leaf at a quadrature point, common to all leaves.
struct PointBasis {
    point: QuadraturePoint,
    /// Derivatives `u, v, uu, uv, vv` in local coordinates.
    derivatives: [[f64; 16]; 5],
}

impl PointBasis {
    fn new(point: QuadraturePoint) -> Self {
        let [bu, bv] = point.local.map(cubic);
        let derivatives = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
            .map(|(along_u, along_v)| std::array::from_fn(|k| bu[along_u][k % 4] * bv[along_v][k / 4]));
        Self { point, derivatives }
    }

    /// The covariant Hessian of each of the functions, in an orthonormal tangent frame of the jet: rows for
    /// 11, √2·12 and 22; and the area element.
    fn hessian_rows(&self, jet: &Jet, side: f64) -> Option<([[f64; 16]; 3], f64)> {
        let [e, f, g] = jet.first_form();
        let area2 = e * g - f * f;
        if !(area2 > 1e-24 * (e + g) * (e + g) && e > 0.0) {
            return None;
        }
        // Christoffel symbols Γ^c_ab = g^{cd} S_ab · S_d.
        let christoffel = |second: DVec3| {
            let (a, b) = (second.dot(jet.du), second.dot(jet.dv));
            [(g * a - f * b) / area2, (e * b - f * a) / area2]
        };
        let gamma = [christoffel(jet.duu), christoffel(jet.duv), christoffel(jet.dvv)];
        // Orthonormal frame: e1 = ∂u/√E, e2 = (∂v − F/E ∂u)/√(area²/E).
        let a1 = 1.0 / e.sqrt();
        let b2 = (e / area2).sqrt();
        let a2 = -f / e * b2;
        // Coefficients of uu, uv and vv in each row of the frame, and those of u and v by the Christoffel
        // symbols.
        // The factor √2 of the mixed row makes the sum of squares equal to `|∇∇f|²`, which counts 12 and 21.
        let frame = [
            [a1 * a1, 0.0, 0.0],
            [SQRT_2 * a1 * a2, SQRT_2 * a1 * b2, 0.0],
            [a2 * a2, 2.0 * a2 * b2, b2 * b2],
        ];
        let h = 1.0 / side;
        let [du, dv, duu, duv, dvv] = &self.derivatives;
        let rows = frame.map(|second| {
            let first = [0, 1].map(|c| -h * (0..3).map(|i| second[i] * gamma[i][c]).sum::<f64>());
            let second = second.map(|x| h * h * x);
            std::array::from_fn(|k| {
                first[0] * du[k]
                    + first[1] * dv[k]
                    + second[0] * duu[k]
                    + second[1] * duv[k]
                    + second[2] * dvv[k]
            })
        });
        Some((rows, area2.sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::{BaseShape, fit_function};
    use crate::hierarchy::Shape;
    use std::sync::Arc;

    fn energy(surface: &Surface, of: &Surface, coordinate: usize) -> f64 {
        let space = surface.space();
        let forms = surface.thin_plate(space);
        (0..space.leaves().len())
            .map(|leaf| {
                let c = of.leaf_coefficients(leaf);
                (0..16)
                    .map(|k| {
                        (0..16)
                            .map(|l| c[k][coordinate] * forms[leaf].thin_plate[k][l] * c[l][coordinate])
                            .sum::<f64>()
                    })
                    .sum::<f64>()
            })
            .sum()
    }

    #[test]
    fn area_and_bending_energy_of_a_sphere_are_analytic() {
        let r = 2.0;
        let sphere = BaseShape::sphere(DVec3::ZERO, r, DVec3::Z).surface([48, 24]).unwrap();
        let area: f64 = sphere.thin_plate(sphere.space()).iter().map(|leaf| leaf.area).sum();
        assert!((area / (4.0 * std::f64::consts::PI * r * r) - 1.0).abs() < 1e-4, "area {area}");
        // Σ over coordinates of |∇∇x|² = κ1² + κ2² = 2/r²: total 8π.
        let total: f64 = (0..3).map(|d| energy(&sphere, &sphere, d)).sum();
        assert!((total / (8.0 * std::f64::consts::PI) - 1.0).abs() < 5e-3, "energy {total}");
    }

    #[test]
    fn energy_does_not_depend_on_the_parametrisation() {
        // The same quadratic function over the unit square, on a straight and on a curved chart of the plane.
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [24, 24]).unwrap());
        let straight = fit_function(&space, |u, v| DVec3::new(u / 24.0, v / 24.0, 0.0)).unwrap();
        let warp = |u: f64, v: f64| {
            let (a, b) = (u / 24.0, v / 24.0);
            (a + 0.1 * a * (1.0 - a) * b, b + 0.15 * b * (1.0 - b) * (1.0 - a))
        };
        let bent = fit_function(&space, |u, v| {
            let (x, y) = warp(u, v);
            DVec3::new(x, y, 0.0)
        })
        .unwrap();
        let height = |x: f64, y: f64| 1.5 * x * x - 0.8 * x * y + 0.3 * y * y;
        let plain = fit_function(&space, |u, v| DVec3::new(height(u / 24.0, v / 24.0), 0.0, 0.0)).unwrap();
        let bent_height = fit_function(&space, |u, v| {
            let (x, y) = warp(u, v);
            DVec3::new(height(x, y), 0.0, 0.0)
        })
        .unwrap();
        let exact = 3.0 * 3.0 + 2.0 * 0.8 * 0.8 + 0.6 * 0.6;
        assert!((energy(&straight, &plain, 0) - exact).abs() < 1e-9);
        assert!((energy(&bent, &bent_height, 0) / exact - 1.0).abs() < 1e-4);
    }

    #[test]
    fn refinement_keeps_the_energy() {
        let sphere = BaseShape::sphere(DVec3::ZERO, 1.0, DVec3::Z).surface([16, 8]).unwrap();
        let fine_space = Arc::new(sphere.space().refine(&[40, 41, 56, 57]));
        let fine = sphere.refined(Arc::clone(&fine_space)).unwrap();
        // Quadrature differs on split cells, so the energies differ in the last digits.
        let (a, b) = (energy(&sphere, &sphere, 0), energy(&fine, &fine, 0));
        assert!((a / b - 1.0).abs() < 1e-5, "{a} {b}");
    }
}
