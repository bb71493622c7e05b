//! Deformations `V = V0 + W q`: how a few parameters move all vertices of a mesh, linearly.
//!
//! Comes in: a mesh, and controls of one kind or another. Goes out: displacements of vertices, and rows
//! `dᵀ ∂V_v/∂q` for whoever fits `q`.
//!
//! A deformation works over a *basis* of its own, which may be larger than the parameters: what follows from
//! all of them together (the affine part of Dirichlet deformations) would else make every row full. Equations
//! are summed over the basis and reduced once: `q_basis = R q`, `N = Rᵀ N_basis R`.
//!
//! Not guaranteed: that a deformed mesh does not cross itself.

mod dirichlet;
mod lattice;
mod modes;
mod rigid;

pub use dirichlet::Dirichlet;
pub use lattice::{Lattice, LatticeBasis};
pub use modes::{Modes, VertexDisplacements};
pub use rigid::{PartMotion, RigidPart, RigidParts};

use nalgebra::{DMatrix, DVector};
use planish_estimate::vector3::add;
use rayon::prelude::*;

/// Vertices moved linearly by parameters.
pub trait Deformation: Sync {
    /// How many parameters there are.
    fn parameters(&self) -> usize;

    /// How many numbers rows are made of; the parameters, unless stated otherwise.
    fn basis(&self) -> usize {
        self.parameters()
    }

    /// How many vertices are moved.
    fn vertices(&self) -> usize;

    /// Visits the entries of `dᵀ ∂V_v/∂q` over the basis that may not be zero; an index may come more than
    /// once.
    fn row(&self, vertex: u32, direction: [f64; 3], visit: &mut dyn FnMut(usize, f64));

    /// `R`, from parameters to the basis; `None` where they are the same.
    fn reduction(&self) -> Option<&DMatrix<f64>> {
        None
    }

    /// Where the parameters are control points, one after the other with x, y and z each: where those stand.
    fn controls(&self) -> Option<&[[f64; 3]]> {
        None
    }
}

/// Displacements of all vertices.
#[must_use]
pub fn displacements(deformation: &dyn Deformation, q: &DVector<f64>) -> Vec<[f64; 3]> {
    let basis = in_basis(deformation, q);
    (0..deformation.vertices() as u32)
        .into_par_iter()
        .map(|vertex| {
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|direction| {
                let mut sum = 0.0;
                deformation.row(vertex, direction, &mut |k, entry| sum += entry * basis[k]);
                sum
            })
        })
        .collect()
}

/// Where vertices that lay at some places come to lie.
#[must_use]
pub fn displaced_positions(
    positions: &[[f64; 3]],
    deformation: &dyn Deformation,
    q: &DVector<f64>,
) -> Vec<[f64; 3]> {
    let by = displacements(deformation, q);
    positions.iter().zip(by).map(|(p, by)| add(*p, by)).collect()
}

/// `dᵀ ∂V_v/∂q` over the parameters.
#[must_use]
pub fn parameter_row(deformation: &dyn Deformation, vertex: u32, direction: [f64; 3]) -> DVector<f64> {
    let mut row = DVector::zeros(deformation.basis());
    deformation.row(vertex, direction, &mut |k, entry| row[k] += entry);
    match deformation.reduction() {
        Some(reduction) => reduction.tr_mul(&row),
        None => row,
    }
}

/// The parameters in the basis of the rows.
pub(crate) fn in_basis(deformation: &dyn Deformation, q: &DVector<f64>) -> DVector<f64> {
    match deformation.reduction() {
        Some(reduction) => reduction * q,
        None => q.clone(),
    }
}
