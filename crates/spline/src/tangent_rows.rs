//! Linearised equations of measured orientations and curvatures: rows over the control vertices at a surface
//! point.
//!
//! Input: a surface and a point on it. Output: weights over the sixteen coefficients of the leaf, which give
//! the change of tangent plane and curvature for motions of the vertices along the normal.
//!
//! With the orthonormal tangents `e_i = M_ia S_a` of the current surface, a measured unit normal `m` and a
//! measured second fundamental form `C` obey, to first order in a displacement `δP`,
//!
//! ```text
//! m·e_i(P + δP) = m·e_i + Σ_k (M_ia ∂_a b_k) n·δP_k = 0
//! II_ij(P + δP) = II_ij + Σ_k M_ia M_jb (∂_ab b_k − Γ^c_ab ∂_c b_k) n·δP_k = e_iᵀ C e_j
//! ```
//!
//! The tangents have unit length, so a collapsing surface does not reduce the residuals. The covariant
//! derivative makes the second line valid for any parametrisation; equations 6 and 7 of the paper require
//! unit speed.
//!
//! The second line assumes that all vertices move along the normal `n` of the point. If each vertex moves
//! along its own normal, as in a growing ball, tangents are stretched, too: `e_c·δS_i = −II_ic φ`. Unit
//! tangents turn this into curvature (the term `−2 S_aᵀ C δS_b` of the equation `n·S_ab = S_aᵀ C S_b`). With
//! `δ_k` the offset of coefficient `k` from the point, where the normal is `n − II δ_k` to first order, its
//! row becomes
//!
//! ```text
//! b_k,ij + b_k,i (II² δ_k)_j + b_k,j (II² δ_k)_i
//! ```
//!
//! For a constant motion `φ` the additional terms sum to `2 II² φ`. A growing ball of radius R then has the
//! correct `δII = φ/R²`; the simple row gives `−φ/R²`.
//!
//! Not guaranteed: terms of second order in the size of a cell.
//!
//! # References
//! Wang, Wang and Aggarwal, *3D model construction by fusing heterogeneous sensor data*, 1998, eq. 4–7; do
//! Carmo, *Riemannian Geometry*, 1992, §6.

use crate::basis::cubic;
use crate::surface::{Jet, Surface};
use planish_core::{DVec3, SymmetricMatrix3};

/// The tangent frame at a point and the rows of orientation and curvature.
#[derive(Debug, Clone, Copy)]
pub struct TangentRows {
    /// The unit normal.
    pub normal: DVec3,
    /// Orthonormal tangents, a right-handed frame with the normal.
    pub tangents: [DVec3; 2],
    /// The second fundamental form in this frame: `[II_11, II_12, II_22]`.
    pub form: [f64; 3],
    /// `∂_{e_i} b_k`: weights over the sixteen coefficients.
    pub slopes: [[f64; 16]; 2],
    /// `∇²b_k (e_i, e_j)` for `11, 12, 22`, if vertices move along the normal of the point.
    pub bends: [[f64; 16]; 3],
    /// The same if every vertex moves along its own normal: weights of the components of these motions along
    /// the normal of the point.
    pub bends_along_normals: [[f64; 16]; 3],
}

impl Surface {
    /// Frame and rows at leaf-local coordinates; `None` if the parametrisation is singular.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{Hierarchy, Shape, fit_function};
    ///
    /// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?.into();
    /// let plane = fit_function(&space, |u, v| DVec3::new(u, v, 0.0))?;
    /// let rows = plane.tangent_rows(5, [0.5, 0.5]).expect("a tangent plane");
    /// // A measured normal that leans by 0.01 rad towards u.
    /// let [along_u, along_v] = rows.tilt(DVec3::new(0.01, 0.0, 1.0));
    /// assert!((along_u - 0.01).abs() < 1e-12 && along_v.abs() < 1e-12);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn tangent_rows(&self, leaf: usize, [s, t]: [f64; 2]) -> Option<TangentRows> {
        let jet = self.leaf_jet(leaf, s, t);
        TangentRows::new(&jet, 1.0 / self.space().leaves()[leaf].side(), [s, t])
    }
}

impl TangentRows {
    /// Frame and rows from the jet at local coordinates of a cell of side `1/h`.
    pub(crate) fn new(jet: &Jet, h: f64, [s, t]: [f64; 2]) -> Option<Self> {
        let normal = jet.normal()?;
        // S_u = l e1, S_v = m e1 + q e2.
        let l = jet.du.length();
        let e1 = jet.du.try_normalize()?;
        let e2 = normal.cross(e1);
        let (m, q) = (jet.dv.dot(e1), jet.dv.dot(e2));
        let frame = [[1.0 / l, 0.0], [-m / (l * q), 1.0 / q]];
        // Tangents that are parallel up to rounding have a normal, but no usable frame.
        if !frame.iter().flatten().all(|x| x.is_finite()) {
            return None;
        }
        let (bu, bv) = (cubic(s), cubic(t));
        let weights = |order_u: usize, order_v: usize| -> [f64; 16] {
            let scale = h.powi((order_u + order_v) as i32);
            std::array::from_fn(|k| scale * bv[order_v][k / 4] * bu[order_u][k % 4])
        };
        let first = [weights(1, 0), weights(0, 1)];
        // Covariant second derivatives: subtract the contribution of the coordinates. Γ^c_ab S_c is the
        // tangential part of S_ab.
        let second = [(weights(2, 0), jet.duu), (weights(1, 1), jet.duv), (weights(0, 2), jet.dvv)].map(
            |(mut w, along)| {
                let by_frame = [along.dot(e1), along.dot(e2)];
                let christoffel = [0, 1].map(|c| by_frame[0] * frame[0][c] + by_frame[1] * frame[1][c]);
                for k in 0..16 {
                    w[k] -= christoffel[0] * first[0][k] + christoffel[1] * first[1][k];
                }
                w
            },
        );
        let slopes: [[f64; 16]; 2] =
            [0, 1].map(|i| std::array::from_fn(|k| frame[i][0] * first[0][k] + frame[i][1] * first[1][k]));
        let in_frame = |[uu, uv, vv]: [f64; 3], i: usize, j: usize| {
            let (a, b) = (frame[i], frame[j]);
            a[0] * b[0] * uu + (a[0] * b[1] + a[1] * b[0]) * uv + a[1] * b[1] * vv
        };
        let pairs = [(0, 0), (0, 1), (1, 1)];
        let form = pairs.map(|(i, j)| in_frame(jet.second_form(normal), i, j));
        let bends: [[f64; 16]; 3] = pairs.map(|(i, j)| {
            std::array::from_fn(|k| in_frame([second[0][k], second[1][k], second[2][k]], i, j))
        });
        let [a, b, c] = form;
        let squared = [[a * a + b * b, b * (a + c)], [b * (a + c), b * b + c * c]];
        // Offsets of the coefficients from the point: Greville points have a spacing of one cell, starting at
        // −1.
        let bent: [[f64; 2]; 16] = std::array::from_fn(|k| {
            let [du, dv] = [(k % 4) as f64 - 1.0 - s, (k / 4) as f64 - 1.0 - t].map(|off| off / h);
            let place = [l * du + m * dv, q * dv];
            squared.map(|row| row[0] * place[0] + row[1] * place[1])
        });
        let bends_along_normals = [0, 1, 2].map(|n| {
            let (i, j) = pairs[n];
            std::array::from_fn(|k| bends[n][k] + slopes[i][k] * bent[k][j] + slopes[j][k] * bent[k][i])
        });
        Some(Self { normal, tangents: [e1, e2], form, slopes, bends, bends_along_normals })
    }

    /// Sines of the angles between the tangents and the plane perpendicular to a measured unit normal:
    /// `[m·e_1, m·e_2]`.
    #[must_use]
    pub fn tilt(&self, measured: DVec3) -> [f64; 2] {
        self.tangents.map(|e| measured.dot(e))
    }

    /// A measured curvature tensor minus that of the surface: `[11, 12, 22]`.
    #[must_use]
    pub fn bend(&self, measured: &SymmetricMatrix3) -> [f64; 3] {
        let [e1, e2] = self.tangents;
        let (c1, c2) = (measured.times(e1), measured.times(e2));
        [e1.dot(c1) - self.form[0], e2.dot(c1) - self.form[1], e2.dot(c2) - self.form[2]]
    }
}

/// The tensor `κ1 d1 d1ᵀ + κ2 d2 d2ᵀ` of principal curvatures, `d2 = n × d1`.
///
/// The normal component of `d1` is removed. `None` if nothing remains or the normal is zero.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::curvature_tensor;
///
/// // A cylinder of radius 2 along z, at its point on the x axis: curved around y only.
/// let tensor = curvature_tensor([-0.5, 0.0], DVec3::Y, DVec3::X);
/// assert_eq!(tensor.map(|t| t.to_array()), Some([0.0, 0.0, 0.0, -0.5, 0.0, 0.0]));
/// ```
#[must_use]
pub fn curvature_tensor([k1, k2]: [f64; 2], direction: DVec3, normal: DVec3) -> Option<SymmetricMatrix3> {
    let n = normal.try_normalize()?;
    let d1 = (direction - direction.dot(n) * n).try_normalize()?;
    Some(tensor_of([k1, k2], [d1, n.cross(d1)]))
}

/// `κ1 d1 d1ᵀ + κ2 d2 d2ᵀ`.
pub(crate) fn tensor_of([k1, k2]: [f64; 2], [d1, d2]: [DVec3; 2]) -> SymmetricMatrix3 {
    SymmetricMatrix3::from_entries(|i, j| k1 * d1[i] * d1[j] + k2 * d2[i] * d2[j])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::{Hierarchy, Shape};
    use std::sync::Arc;

    /// A bumpy sheet with a skewed, uneven parametrisation.
    fn sheet() -> Surface {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [6, 5]).unwrap());
        crate::base::fit_function(&space, |u, v| {
            let (x, y) = (u + 0.2 * (0.7 * v).sin() + 0.04 * u * u, 1.3 * v + 0.3 * u);
            DVec3::new(x, y, 0.5 * (0.6 * x).sin() + 0.3 * (0.5 * y + 0.3 * x).cos())
        })
        .unwrap()
    }

    #[test]
    fn rows_are_the_derivatives_of_tilt_and_curvature() {
        let surface = sheet();
        let (leaf, local) = (13, [0.3, 0.8]);
        let rows = surface.tangent_rows(leaf, local).unwrap();
        let measured = (rows.normal + 1e-3 * rows.tangents[0]).try_normalize().unwrap();
        let step = 1e-6;
        // Each vertex in turn moves along the normal of the point.
        for node in surface.space().extraction(leaf).0 {
            let mut vertices = surface.vertices().to_vec();
            let moved = &mut vertices[*node as usize];
            *moved += step * rows.normal;
            let after = surface.with_vertices(vertices).unwrap();
            let displaced: Vec<f64> = after
                .leaf_coefficients(leaf)
                .iter()
                .zip(surface.leaf_coefficients(leaf))
                .map(|(a, b)| (*a - *b).dot(rows.normal))
                .collect();
            let predicted = |w: &[f64; 16]| w.iter().zip(&displaced).map(|(w, d)| w * d).sum::<f64>() / step;
            let now = after.tangent_rows(leaf, local).unwrap();
            let tensor = |rows: &TangentRows, e: DVec3, f: DVec3| {
                // II(e, f) of fixed directions in the frame of the current surface.
                let [a, b] = [e, f].map(|x| rows.tangents.map(|t| t.dot(x)));
                a[0] * b[0] * rows.form[0]
                    + (a[0] * b[1] + a[1] * b[0]) * rows.form[1]
                    + a[1] * b[1] * rows.form[2]
            };
            for i in 0..2 {
                // The frame may rotate in its plane, so compare the tilt along the original direction.
                let tilt = |rows: &TangentRows, e: DVec3| {
                    let inside = rows.tangents.map(|t| t.dot(e));
                    measured.dot(inside[0] * rows.tangents[0]) + measured.dot(inside[1] * rows.tangents[1])
                };
                let e = rows.tangents[i];
                let change = (tilt(&now, e) - tilt(&rows, e)) / step;
                assert!(
                    (change - predicted(&rows.slopes[i])).abs() < 5e-3 * (1.0 + change.abs()),
                    "{change}"
                );
            }
            for (n, (i, j)) in [(0, 0), (0, 1), (1, 1)].into_iter().enumerate() {
                let (e, f) = (rows.tangents[i], rows.tangents[j]);
                let change = (tensor(&now, e, f) - tensor(&rows, e, f)) / step;
                assert!(
                    (change - predicted(&rows.bends[n])).abs() < 1e-4 * (1.0 + change.abs()),
                    "{n}: {change} {}",
                    predicted(&rows.bends[n])
                );
            }
        }
    }

    /// The curvature `−1/R` of a ball that grows by δ changes by `δII = δ/R²` along both tangents. A
    /// translation does not change it.
    #[test]
    fn growth_of_a_ball_reduces_its_curvature_and_translation_does_not() {
        let space = Arc::new(Hierarchy::uniform(Shape::Ball, [32, 16]).unwrap());
        let radius = 5.0;
        let step = std::f64::consts::PI / 16.0;
        let ball = crate::base::fit_function(&space, |u, v| {
            let (longitude, latitude) = (step * u, step * v);
            DVec3::new(
                radius * latitude.sin() * longitude.cos(),
                radius * latitude.sin() * longitude.sin(),
                -radius * latitude.cos(),
            )
        })
        .unwrap();
        let leaves = ball.space().leaves();
        let leaf = (0..leaves.len()).find(|&leaf| leaves[leaf].j == 6).unwrap();
        let rows = ball.tangent_rows(leaf, [0.4, 0.3]).unwrap();
        let unit_change = 1.0 / (radius * radius);
        let predicted = |motion: &dyn Fn(DVec3) -> DVec3, row: &[f64; 16]| -> f64 {
            let coefficients = ball.leaf_coefficients(leaf);
            (row.iter().zip(coefficients)).map(|(w, p)| w * motion(*p).dot(rows.normal)).sum()
        };
        let grown = |p: DVec3| p.try_normalize().unwrap();
        // Translation along the normal of the point: each vertex moves by the component along its own normal.
        let shifted = |p: DVec3| grown(p).dot(rows.normal) * grown(p);
        for n in [0, 2] {
            let growth = predicted(&grown, &rows.bends_along_normals[n]);
            assert!((growth - unit_change).abs() < 0.06 * unit_change, "{growth} {unit_change}");
            let shift = predicted(&shifted, &rows.bends_along_normals[n]);
            assert!(shift.abs() < 0.05 * unit_change, "{shift}");
            // The row for motions along one normal has the wrong sign for growth.
            assert!(predicted(&grown, &rows.bends[n]) < -0.9 * unit_change);
        }
    }

    /// Each vertex of a half cylinder in turn moves along its own normal.
    #[test]
    fn rows_along_normals_are_the_derivatives_for_motions_along_own_normals() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [13, 8]).unwrap());
        let (radius, turn) = (30.0, 0.2);
        let cylinder = crate::base::fit_function(&space, |u, v| {
            let a = turn * (u - 6.5);
            DVec3::new(radius * a.sin(), 6.0 * v, radius * a.cos())
        })
        .unwrap();
        let leaf = (0..space.leaves().len())
            .find(|&l| space.leaves()[l].i == 6 && space.leaves()[l].j == 4)
            .unwrap();
        let local = [0.3, 0.8];
        let rows = cylinder.tangent_rows(leaf, local).unwrap();
        let step = 1e-4;
        let (mut plain, mut along) = (0.0_f64, 0.0_f64);
        for node in cylinder.space().extraction(leaf).0 {
            let mut vertices = cylinder.vertices().to_vec();
            let moved = &mut vertices[*node as usize];
            let own = DVec3::new(moved[0], 0.0, moved[2]).try_normalize().unwrap();
            *moved += step * own;
            let after = cylinder.with_vertices(vertices).unwrap();
            let displaced: Vec<f64> =
                (after.leaf_coefficients(leaf).iter().zip(cylinder.leaf_coefficients(leaf)))
                    .map(|(a, b)| (*a - *b).dot(rows.normal))
                    .collect();
            let predicted = |w: &[f64; 16]| w.iter().zip(&displaced).map(|(w, d)| w * d).sum::<f64>() / step;
            let now = after.tangent_rows(leaf, local).unwrap();
            for n in 0..3 {
                // The first tangent stays in the plane of the first direction, to first order.
                let change = (now.form[n] - rows.form[n]) / step;
                plain += (change - predicted(&rows.bends[n])).powi(2);
                along += (change - predicted(&rows.bends_along_normals[n])).powi(2);
            }
        }
        assert!(along < 0.01 * plain, "{along} {plain}");
    }

    #[test]
    fn plain_second_derivatives_report_curvature_of_a_plane() {
        // A plane with nonuniform parameters: S_uu is not zero, but the curvature is.
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4]).unwrap());
        let plane = crate::base::fit_function(&space, |u, v| DVec3::new(u + 0.2 * u * u, v, 0.0)).unwrap();
        let rows = plane.tangent_rows(5, [0.4, 0.4]).unwrap();
        assert!(rows.form.iter().all(|k| k.abs() < 1e-12));
        let jet = plane.leaf_jet(5, 0.4, 0.4);
        assert!(jet.duu.length() > 0.3);
        // A tilt of the plane does not change its curvature. Covariant rows are zero, plain second
        // derivatives are not.
        let predicted =
            |w: &[f64; 16]| -> f64 { w.iter().zip(plane.leaf_coefficients(5)).map(|(w, c)| w * c[0]).sum() };
        assert!(predicted(&rows.bends[0]).abs() < 1e-12);
    }

    #[test]
    fn the_tensor_of_a_cylinder_is_recovered() {
        let tensor = curvature_tensor([0.0, -0.5], DVec3::new(0.1, 0.0, 1.0), DVec3::X).unwrap();
        assert_eq!(tensor.to_array(), [0.0, 0.0, 0.0, -0.5, 0.0, 0.0]);
        assert!(curvature_tensor([1.0, 1.0], DVec3::X, DVec3::X).is_none());
    }
}
