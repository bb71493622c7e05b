//! A deformation about another pose than rest.
//!
//! In: a deformation and the displacements of all vertices in a pose. Out: a deformation whose parameters
//! count from that pose, `V = V0 + b + W q`.
//!
//! Few controls do not interpolate large rotations: the error is `h² θ'² r/8` for controls at distances `h`
//! and a twist `θ'` at the radius `r`. The pose has them, and the controls only correct it.

use super::{Deformation, SparseRow, displacements};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;

/// A deformation with constant displacements `b` in addition.
pub(crate) struct PosedDeformation {
    pub inner: Box<dyn Deformation>,
    /// Displacements of the vertices in the pose.
    pub pose: Vec<DVec3>,
}

impl Deformation for PosedDeformation {
    fn parameters(&self) -> usize {
        self.inner.parameters()
    }

    fn basis(&self) -> usize {
        self.inner.basis()
    }

    fn vertices(&self) -> usize {
        self.inner.vertices()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        self.inner.row(vertex, direction, visit);
    }

    fn add_to(&self, vertices: &[(u32, DVec3)], row: &mut SparseRow) {
        self.inner.add_to(vertices, row);
    }

    fn reduction(&self) -> Option<&DMatrix<f64>> {
        self.inner.reduction()
    }

    fn nonlinear_displacements(&self, q: &DVector<f64>) -> Option<Vec<DVec3>> {
        let mut all = displacements(&*self.inner, q);
        all.iter_mut().zip(&self.pose).for_each(|(by, pose)| *by += *pose);
        Some(all)
    }

    fn linearised_at(&self, q: &DVector<f64>) -> Option<Box<dyn Deformation + '_>> {
        self.inner.linearised_at(q)
    }

    fn controls(&self) -> Option<&[DVec3]> {
        self.inner.controls()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::automatic_controls;
    use crate::deformation::{Dirichlet, displaced_positions};
    use planish_mesh::icosphere;

    /// Parameters zero are the pose, and others are displacements from it.
    #[test]
    fn parameters_count_from_the_pose() {
        let ball = icosphere(1.0, 2);
        let inner = Dirichlet::new(&automatic_controls(&ball, 20).unwrap().points, &ball.positions).unwrap();
        let turned = |p: &DVec3| DVec3::new(-p[1], p[0], p[2]);
        let pose = ball.positions.iter().map(|p| turned(p) - *p).collect();
        let posed = PosedDeformation { inner: Box::new(inner), pose };
        let mut q = DVector::zeros(posed.parameters());
        let at = |q: &DVector<f64>| displaced_positions(&ball.positions, &posed, q);
        let off = |q: &DVector<f64>, by: DVec3| {
            let far = at(q)
                .iter()
                .zip(&ball.positions)
                .map(|(a, p)| a.distance(turned(p) + by))
                .fold(0.0, f64::max);
            assert!(far < 1e-9, "{far}");
        };
        off(&q, DVec3::ZERO);
        q.iter_mut().step_by(3).for_each(|x| *x = 0.5);
        off(&q, 0.5 * DVec3::X);
    }
}
