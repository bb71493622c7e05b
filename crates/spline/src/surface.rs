//! A hierarchical B-spline surface: a hierarchy and its control vertices.
//!
//! Input: a [`Hierarchy`] and one vertex per node. Output: points and derivatives at any parameters, and
//! exact refinements. Derivatives are with respect to u and v in base-grid units.
//!
//! Not guaranteed: a surface without folds. `S_u = 0` at the poles of a ball by construction.

use crate::basis::cubic;
use crate::hierarchy::{Cell, Hierarchy, quarter3};
use planish_core::DVec3;
use planish_core::vector3::coordinates;
use planish_estimate::{Error, Result};
use std::sync::Arc;

/// A point of a surface with its first and second derivatives.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Jet {
    /// `S`
    pub point: DVec3,
    /// `∂S/∂u`
    pub du: DVec3,
    /// `∂S/∂v`
    pub dv: DVec3,
    /// `∂²S/∂u²`
    pub duu: DVec3,
    /// `∂²S/∂u∂v`
    pub duv: DVec3,
    /// `∂²S/∂v²`
    pub dvv: DVec3,
}

/// The four third derivatives of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ThirdDerivatives {
    /// `∂³S/∂u³`
    pub duuu: DVec3,
    /// `∂³S/∂u²∂v`
    pub duuv: DVec3,
    /// `∂³S/∂u∂v²`
    pub duvv: DVec3,
    /// `∂³S/∂v³`
    pub dvvv: DVec3,
}

/// A hierarchical bicubic B-spline surface.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{Hierarchy, Shape, Surface};
/// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?;
/// // Control vertices at their anchors reproduce the plane.
/// let vertices = space.node_anchors().iter().map(|a| DVec3::new(a[0], a[1], 0.0)).collect();
/// let plane = Surface::new(space.into(), vertices)?;
/// let p = plane.point(1.3, 2.7);
/// assert!((p[0] - 1.3).abs() < 1e-12 && (p[1] - 2.7).abs() < 1e-12);
/// # Ok::<(), planish_spline::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Surface {
    space: Arc<Hierarchy>,
    vertices: Vec<DVec3>,
    /// The sixteen coefficients of every leaf. Stored, because evaluation needs only these.
    local: Vec<[DVec3; 16]>,
}

impl Surface {
    /// A surface with the given control vertices, one per node.
    ///
    /// # Errors
    /// `Input` when the numbers of vertices and nodes differ or a coordinate is not finite.
    pub fn new(space: Arc<Hierarchy>, vertices: Vec<DVec3>) -> Result<Self> {
        if vertices.len() != space.node_count() {
            return Err(Error::input(format!(
                "expected one control vertex per node, found {} vertices for {} nodes",
                vertices.len(),
                space.node_count()
            )));
        }
        if let Some(at) = vertices.iter().position(|p| !p.is_finite()) {
            return Err(Error::input(format!("control vertex {at} is not finite")));
        }
        // The mixture of levels is resolved once per leaf. An evaluation then has the cost of a plain bicubic
        // patch.
        let local = space.leaf_coefficients(&vertices);
        Ok(Self { space, vertices, local })
    }

    /// The hierarchy.
    #[must_use]
    pub fn space(&self) -> &Arc<Hierarchy> {
        &self.space
    }

    /// The control vertices, one per node.
    #[must_use]
    pub fn vertices(&self) -> &[DVec3] {
        &self.vertices
    }

    /// The sixteen B-spline coefficients of a leaf, `4 · row + column`.
    #[must_use]
    pub fn leaf_coefficients(&self, leaf: usize) -> &[DVec3; 16] {
        &self.local[leaf]
    }

    /// The sixteen coefficients on a cell that is a leaf or lies inside one; `None` if the surface is finer
    /// there.
    #[must_use]
    pub fn cell_coefficients(&self, cell: Cell) -> Option<[DVec3; 16]> {
        let leaf = self.space.leaf_over(cell)?;
        let mut coefficients = self.local[leaf];
        let depth = cell.level - self.space.leaves()[leaf].level;
        // From the highest bit down: the quarter, then the quarter of the quarter.
        for d in (0..depth).rev() {
            coefficients = quarter3(&coefficients, (cell.i >> d) as usize & 1, (cell.j >> d) as usize & 1);
        }
        Some(coefficients)
    }

    /// The point at `(u, v)`.
    #[must_use]
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        // One search for the leaf; callers that know it use the functions of leaves.
        let (leaf, [s, t]) = self.space.locate(u, v);
        self.leaf_point(leaf, s, t)
    }

    /// The point at leaf-local coordinates in `[0, 1]²`.
    #[inline]
    #[must_use]
    pub fn leaf_point(&self, leaf: usize, s: f64, t: f64) -> DVec3 {
        combine(&self.local[leaf], &cubic(s)[0], &cubic(t)[0], 1.0)
    }

    /// Point and derivatives up to the second order at `(u, v)`.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        let (leaf, [s, t]) = self.space.locate(u, v);
        self.leaf_jet(leaf, s, t)
    }

    /// Point and derivatives up to the second order at leaf-local coordinates.
    ///
    /// Cost: about 300 multiply-adds.
    #[inline]
    #[must_use]
    pub fn leaf_jet(&self, leaf: usize, s: f64, t: f64) -> Jet {
        jet_of(&self.local[leaf], 1.0 / self.space.leaves()[leaf].side(), s, t)
    }

    /// Third derivatives at `(u, v)`. They can jump across knots, as for every cubic spline.
    #[must_use]
    pub fn third_derivatives(&self, u: f64, v: f64) -> ThirdDerivatives {
        let (leaf, [s, t]) = self.space.locate(u, v);
        let (c, bu, bv) = (&self.local[leaf], cubic(s), cubic(t));
        let h = self.space.leaves()[leaf].side().powi(-3);
        ThirdDerivatives {
            duuu: combine(c, &bu[3], &bv[0], h),
            duuv: combine(c, &bu[2], &bv[1], h),
            duvv: combine(c, &bu[1], &bv[2], h),
            dvvv: combine(c, &bu[0], &bv[3], h),
        }
    }

    /// The same surface over a finer hierarchy. It is exact, except over quads around extraordinary vertices
    /// that are split there.
    ///
    /// # Errors
    /// `Input` when shape or base grid differ, or the other hierarchy is coarser somewhere.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// let coarse = BaseShape::sphere(DVec3::ZERO, 1.0, DVec3::Z).surface([8, 4])?;
    /// let fine = coarse.refined(coarse.space().refine_all().into())?;
    /// let (a, b) = (coarse.point(2.7, 1.1), fine.point(2.7, 1.1));
    /// assert!((0..3).all(|d| (a[d] - b[d]).abs() < 1e-12));
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn refined(&self, finer: Arc<Hierarchy>) -> Result<Self> {
        if !finer.same_base(&self.space) {
            return Err(Error::input("refinement needs the same shape and base grid"));
        }
        // `vertices_from` needs coefficients on every cell, so this is checked first.
        if let Some(cell) = finer.coarser_than(&self.space) {
            return Err(Error::input(format!(
                "the other hierarchy is coarser at {cell:?} and cannot represent this surface"
            )));
        }
        let vertices = match self.space.refined_nodes(&finer) {
            Some(rows) => rows
                .iter()
                .map(|row| row.iter().map(|&(node, w)| w * self.vertices[node as usize]).sum())
                .collect(),
            None => finer.vertices_from(|cell| self.cell_coefficients(cell).unwrap_or([DVec3::ZERO; 16])),
        };
        Self::new(finer, vertices)
    }

    /// A surface over the same space with other vertices.
    ///
    /// # Errors
    /// As for [`Surface::new`].
    pub fn with_vertices(&self, vertices: Vec<DVec3>) -> Result<Self> {
        Self::new(Arc::clone(&self.space), vertices)
    }
}

/// The coordinates of a coefficient as the first three of four SIMD lanes. The fourth lane holds an adjacent
/// value and is ignored.
#[inline(always)]
pub(crate) fn coordinates_in_fours(c: &[DVec3; 16], k: usize) -> [f64; 4] {
    let flat = coordinates(c);
    match k {
        15 => [flat[45], flat[46], flat[47], 0.0],
        _ => [flat[3 * k], flat[3 * k + 1], flat[3 * k + 2], flat[3 * k + 3]],
    }
}

/// The jet of sixteen coefficients; `h` is the inverse of the side of the leaf.
#[inline(always)]
pub(crate) fn jet_of(c: &[DVec3; 16], h: f64, s: f64, t: f64) -> Jet {
    let (bu, bv) = (cubic(s), cubic(t));
    // Padded to four lanes: each inner loop is one vector operation.
    let mut sums = [[0.0; 4]; 6];
    for r in 0..4 {
        // Three derivatives along the row, then down the columns.
        let mut row = [[0.0; 4]; 3];
        for k in 0..4 {
            let p = coordinates_in_fours(c, 4 * r + k);
            for order in 0..3 {
                for d in 0..4 {
                    row[order][d] += bu[order][k] * p[d];
                }
            }
        }
        for (n, (order_u, order_v)) in
            [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)].into_iter().enumerate()
        {
            for d in 0..4 {
                sums[n][d] += bv[order_v][r] * row[order_u][d];
            }
        }
    }
    // Scaled once at the end instead of in every weight.
    let part = |n: usize, scale: f64| scale * DVec3::new(sums[n][0], sums[n][1], sums[n][2]);
    Jet {
        point: part(0, 1.0),
        du: part(1, h),
        dv: part(2, h),
        duu: part(3, h * h),
        duv: part(4, h * h),
        dvv: part(5, h * h),
    }
}

#[inline]
fn combine(c: &[DVec3; 16], bu: &[f64; 4], bv: &[f64; 4], scale: f64) -> DVec3 {
    let mut out = DVec3::ZERO;
    for r in 0..4 {
        for k in 0..4 {
            let w = scale * bv[r] * bu[k];
            out += w * c[4 * r + k];
        }
    }
    out
}

/// The sixteen tensor-product weights at leaf-local coordinates, `4 · row + column`.
///
/// # Examples
/// ```
/// let weights = planish_spline::leaf_weights(0.3, 0.8);
/// assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-15);
/// ```
#[inline]
#[must_use]
pub fn leaf_weights(s: f64, t: f64) -> [f64; 16] {
    let (bu, bv) = (cubic(s)[0], cubic(t)[0]);
    let mut w = [0.0; 16];
    for r in 0..4 {
        for k in 0..4 {
            w[4 * r + k] = bv[r] * bu[k];
        }
    }
    w
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::Shape;

    #[test]
    fn jets_and_third_derivatives_agree_with_differences() {
        let space = Hierarchy::uniform(Shape::Torus, [5, 6]).unwrap();
        let vertices = (0..space.node_count())
            .map(|i| DVec3::from_array([0, 1, 2].map(|d| ((7 * i + 3 * d) as f64).sin())))
            .collect();
        let surface = Surface::new(space.refine(&[3, 4, 8, 9]).into(), Vec::new());
        assert!(surface.is_err(), "a wrong number of vertices is an error");
        let surface = Surface::new(space.into(), vertices).unwrap();
        let surface = surface.refined(surface.space().refine(&[3, 4, 8, 9]).into()).unwrap();
        let (u, v, h) = (3.21, 1.37, 1e-5);
        let at = |du: f64, dv: f64| surface.jet(u + du, v + dv);
        let jet = at(0.0, 0.0);
        let third = surface.third_derivatives(u, v);
        for d in 0..3 {
            let diff = |f: &dyn Fn(&Jet) -> DVec3, du: f64, dv: f64| {
                (f(&at(du, dv))[d] - f(&at(-du, -dv))[d]) / (2.0 * h)
            };
            for (exact, estimate) in [
                (jet.du[d], diff(&|j| j.point, h, 0.0)),
                (jet.dv[d], diff(&|j| j.point, 0.0, h)),
                (jet.duu[d], diff(&|j| j.du, h, 0.0)),
                (jet.duv[d], diff(&|j| j.du, 0.0, h)),
                (jet.dvv[d], diff(&|j| j.dv, 0.0, h)),
                (third.duuu[d], diff(&|j| j.duu, h, 0.0)),
                (third.duuv[d], diff(&|j| j.duu, 0.0, h)),
                (third.duvv[d], diff(&|j| j.dvv, h, 0.0)),
                (third.dvvv[d], diff(&|j| j.dvv, 0.0, h)),
            ] {
                assert!((exact - estimate).abs() < 1e-6, "{exact} {estimate}");
            }
        }
    }
}
