//! Differential geometry at a surface point: fundamental forms, normals, curvatures and their directions.
//!
//! Input: a [`Jet`]. Output: normal, forms, principal, Gaussian and mean curvature. Curvature is positive if
//! the surface bends towards its normal, so a sphere with outward normals has κ = −1/r.
//!
//! Not guaranteed: values where `S_u × S_v = 0`; at the poles of a ball use [`crate::Surface::curvature`],
//! which changes the chart.
//!
//! # References
//! do Carmo, *Differential Geometry of Curves and Surfaces*, 1976, §3.3.

use crate::hierarchy::Shape;
use crate::surface::{Jet, Surface};
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use rayon::prelude::*;

/// Curvature of a surface at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curvature {
    /// Unit normal `S_u × S_v / |S_u × S_v|`.
    pub normal: DVec3,
    /// Principal curvatures, `principal[0] ≥ principal[1]`.
    pub principal: [f64; 2],
    /// Unit principal directions in space, orthogonal to each other and to the normal.
    pub directions: [DVec3; 2],
}

impl Curvature {
    /// Gaussian curvature `K = κ1 κ2`.
    #[must_use]
    pub fn gaussian(&self) -> f64 {
        self.principal[0] * self.principal[1]
    }

    /// Mean curvature `H = (κ1 + κ2)/2`.
    #[must_use]
    pub fn mean(&self) -> f64 {
        0.5 * (self.principal[0] + self.principal[1])
    }

    /// Computes curvatures from the symmetric second fundamental form `[[a, b], [b, c]]` in an orthonormal
    /// tangent frame.
    fn from_orthonormal(normal: DVec3, e1: DVec3, e2: DVec3, [a, b, c]: [f64; 3]) -> Self {
        // By the half difference: `√(H² − K)` of nearly equal curvatures would lose half of the digits.
        let mean = 0.5 * (a + c);
        let half = 0.5 * (a - c);
        let radius = half.hypot(b);
        let angle = 0.5 * b.atan2(half);
        let (s, co) = angle.sin_cos();
        let first = co * e1 + s * e2;
        Self { normal, principal: [mean + radius, mean - radius], directions: [first, normal.cross(first)] }
    }
}

impl Jet {
    /// The jet after a short parameter step with constant second derivatives. The error of the point is a
    /// sixth of the third derivative times the cube of the step.
    #[inline]
    pub(crate) fn shifted(&self, [u, v]: [f64; 2]) -> Self {
        let mut moved = *self;
        for d in 0..3 {
            let (along_u, along_v) = (self.duu[d] * u + self.duv[d] * v, self.duv[d] * u + self.dvv[d] * v);
            moved.point[d] += u * (self.du[d] + 0.5 * along_u) + v * (self.dv[d] + 0.5 * along_v);
            moved.du[d] += along_u;
            moved.dv[d] += along_v;
        }
        moved
    }

    /// First fundamental form `[E, F, G]`.
    #[must_use]
    pub fn first_form(&self) -> [f64; 3] {
        [self.du.length_squared(), self.du.dot(self.dv), self.dv.length_squared()]
    }

    /// Area element `√(EG − F²)`: area of the surface per area of the parameters.
    #[must_use]
    pub fn area_element(&self) -> f64 {
        let [e, f, g] = self.first_form();
        (e * g - f * f).max(0.0).sqrt()
    }

    /// Unit normal; `None` if `S_u` and `S_v` are parallel or zero.
    #[must_use]
    pub fn normal(&self) -> Option<DVec3> {
        self.du.cross(self.dv).try_normalize()
    }

    /// Second fundamental form `[e, f, g]` along a unit normal.
    #[must_use]
    pub fn second_form(&self, normal: DVec3) -> [f64; 3] {
        [self.duu.dot(normal), self.duv.dot(normal), self.dvv.dot(normal)]
    }

    /// Unit normal, orthonormal tangents `e1`, `e2` and the second fundamental form in them:
    /// `[II(e1, e1), II(e1, e2), II(e2, e2)]`; `None` if the parametrisation is singular.
    #[inline]
    fn orthonormal_form(&self) -> Option<OrthonormalForm> {
        let normal = self.normal()?;
        // e1 along S_u: S_u = l e1, S_v = m e1 + q e2.
        let l = self.du.length();
        let e1 = 1.0 / l * self.du;
        let e2 = normal.cross(e1);
        let (m, q) = (self.dv.dot(e1), self.dv.dot(e2));
        let [e, f, g] = self.second_form(normal);
        let a = e / (l * l);
        let b = (f / l - m * a) / q;
        let c = (g - 2.0 * m * q * b - m * m * a) / (q * q);
        Some(OrthonormalForm { normal, tangents: [e1, e2], form: [a, b, c] })
    }

    /// Normal, principal curvatures and directions; `None` if the parametrisation is singular.
    #[must_use]
    pub fn curvature(&self) -> Option<Curvature> {
        let OrthonormalForm { normal, tangents: [e1, e2], form } = self.orthonormal_form()?;
        Some(Curvature::from_orthonormal(normal, e1, e2, form))
    }

    /// Mean curvature `H = (κ1 + κ2)/2`; `None` if the parametrisation is singular.
    #[must_use]
    pub fn mean_curvature(&self) -> Option<f64> {
        let [a, _, c] = self.orthonormal_form()?.form;
        Some(0.5 * (a + c))
    }

    /// `tr(II R_t)/2`: the mean apparent height over the surface due to tangential noise of covariance `R`,
    /// to second order; `None` if the parametrisation is singular.
    ///
    /// For isotropic noise on a sphere of radius r with outward normals this is `−σ²/r`. The expected signed
    /// distance of a noisy point is `−tr(II R_t)/2`.
    #[inline]
    #[must_use]
    pub fn tangential_bias(&self, covariance: &SymmetricMatrix3) -> Option<f64> {
        let OrthonormalForm { tangents: [e1, e2], form: [a, b, c], .. } = self.orthonormal_form()?;
        let (r1, r2) = (covariance.times(e1), covariance.times(e2));
        Some(0.5 * (a * e1.dot(r1) + 2.0 * b * e2.dot(r1) + c * e2.dot(r2)))
    }
}

/// The second fundamental form in an orthonormal frame.
struct OrthonormalForm {
    normal: DVec3,
    tangents: [DVec3; 2],
    form: [f64; 3],
}

impl Surface {
    /// Unit normal at `(u, v)`, including the poles of a ball; `None` if the surface is degenerate.
    #[must_use]
    pub fn normal(&self, u: f64, v: f64) -> Option<DVec3> {
        match self.pole_direction(v) {
            None => self.jet(u, v).normal(),
            Some(inward) => self.pole_normal(v, inward),
        }
    }

    /// Unit normal at the anchor of every node: the direction in which its vertex changes the shape. Zero
    /// where the surface is degenerate.
    #[must_use]
    pub fn node_normals(&self) -> Vec<DVec3> {
        let space = self.space();
        (space.node_anchors().par_iter().with_min_len(256))
            .map(|a| {
                // Anchors of functions at an open border lie outside the domain.
                let [u, v] = space.wrap(a[0], a[1]);
                self.normal(u, v).unwrap_or(DVec3::ZERO)
            })
            .collect()
    }

    /// Curvature at `(u, v)`, including the poles of a ball; `None` if the surface is degenerate.
    ///
    /// A pole is evaluated in its tangent plane: normal curvatures of the meridians, `S_vv·n/|S_v|²`, give
    /// the second fundamental form by least squares over directions. A ball is C¹ there, so the form is that
    /// of the best quadric.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z).surface([32, 16])?;
    /// let curvature = ball.curvature(3.0, 8.0).expect("a regular point");
    /// assert!((curvature.gaussian() - 0.25).abs() < 0.01);
    /// assert!((curvature.mean() + 0.5).abs() < 0.01); // negative with outward normals
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn curvature(&self, u: f64, v: f64) -> Option<Curvature> {
        let Some(inward) = self.pole_direction(v) else {
            return self.jet(u, v).curvature();
        };
        let normal = self.pole_normal(v, inward)?;
        let (e1, e2) = tangents(normal);
        let extent = self.space().extent()[0];
        let count = 8 * self.space().base()[0];
        // Least squares for [a, b, c] in a x² + 2 b x y + c y² = κ over unit directions (x, y).
        let (mut m, mut r) = ([DVec3::ZERO; 3], DVec3::ZERO);
        // A ball is only C¹ at a pole: curvatures differ from meridian to meridian, so many of them are
        // averaged.
        for n in 0..count {
            let jet = self.jet(extent * n as f64 / count as f64, v);
            let speed = jet.dv.length_squared();
            if speed == 0.0 {
                return None;
            }
            let (x, y) = (jet.dv.dot(e1) / speed.sqrt(), jet.dv.dot(e2) / speed.sqrt());
            let row = [x * x, 2.0 * x * y, y * y];
            let kappa = jet.dvv.dot(normal) / speed;
            for i in 0..3 {
                r[i] += row[i] * kappa;
                for j in 0..3 {
                    m[i][j] += row[i] * row[j];
                }
            }
        }
        // Cramer's rule: the matrix is well conditioned, because directions cover the whole circle.
        let determinant = m[0].dot(m[1].cross(m[2]));
        let solve = |k: usize| {
            let mut n = m;
            for i in 0..3 {
                n[i][k] = r[i];
            }
            n[0].dot(n[1].cross(n[2])) / determinant
        };
        Some(Curvature::from_orthonormal(normal, e1, e2, [solve(0), solve(1), solve(2)]))
    }

    /// Direction of v (+1 or −1) away from the pole, if `v` is at a pole of a ball.
    fn pole_direction(&self, v: f64) -> Option<f64> {
        let extent = self.space().extent()[1];
        // Farther from a pole, `S_u` has correct digits and the usual formulas hold.
        let near = 1e-9 * extent;
        if self.space().shape() != Some(Shape::Ball) {
            None
        } else if v <= near {
            Some(1.0)
        } else if v >= extent - near {
            Some(-1.0)
        } else {
            None
        }
    }

    /// Normal at a pole from two meridians a quarter turn apart. `S_u ∝ ∂S_v/∂u · distance` determines its
    /// sign.
    fn pole_normal(&self, v: f64, inward: f64) -> Option<DVec3> {
        let quarter = self.space().extent()[0] / 4.0;
        let (a, b) = (self.jet(0.0, v).dv, self.jet(quarter, v).dv);
        // Near the bottom pole S_u ≈ v ∂_u S_v, so S_u × S_v ∥ b × a. Near the top pole the distance is n −
        // v, so the sign changes with the direction away from the pole.
        (inward * b.cross(a)).try_normalize()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curvature_of_a_quadric_in_a_skew_chart_is_exact() {
        // z = (p x² + q y²)/2 at the origin with x = u + 0.4 v, y = 2 v.
        let (p, q) = (1.5, -0.7);
        let jet = Jet {
            point: DVec3::ZERO,
            du: DVec3::X,
            dv: DVec3::new(0.4, 2.0, 0.0),
            duu: DVec3::new(0.0, 0.0, p),
            duv: DVec3::new(0.0, 0.0, 0.4 * p),
            dvv: DVec3::new(0.0, 0.0, 0.16 * p + 4.0 * q),
        };
        let curvature = jet.curvature().unwrap();
        assert!((curvature.principal[0] - p).abs() < 1e-12 && (curvature.principal[1] - q).abs() < 1e-12);
        assert!(
            curvature.directions[0][0].abs() > 1.0 - 1e-12 && curvature.directions[1][1].abs() > 1.0 - 1e-12
        );
        assert!(
            (curvature.gaussian() - p * q).abs() < 1e-12 && (curvature.mean() - 0.5 * (p + q)).abs() < 1e-12
        );
    }
}
