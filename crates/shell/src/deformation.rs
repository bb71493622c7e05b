//! Deformations `V = V0 + W q`: a few parameters move all vertices of a mesh. Those with rotations are linear
//! about given parameters only.
//!
//! In: a mesh and its controls. Out: displacements of vertices, and the rows `dᵀ ∂V_v/∂q` for estimating `q`.
//!
//! Rows refer to a *basis* that may be larger than the parameters. Otherwise the affine part of a Dirichlet
//! deformation, which depends on all controls, would make every row dense. Equations are summed over the
//! basis and reduced once: `q_basis = R q`, `N = Rᵀ N_basis R`.
//!
//! Not guaranteed: a deformed mesh may intersect itself.

mod dirichlet;
mod lattice;
mod modes;
mod posed;
mod rigid;
mod sparse_row;

pub use dirichlet::Dirichlet;
pub use lattice::{Lattice, LatticeBasis};
pub use modes::{Modes, VertexDisplacements};
pub(crate) use posed::PosedDeformation;
pub(crate) use rigid::nearest_rotation;
pub use rigid::{PartMotion, RigidPart, RigidParts};
pub use sparse_row::SparseRow;

use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use rayon::prelude::*;
use std::borrow::Cow;

/// A map from parameters to the displacements of all vertices.
pub trait Deformation: Sync {
    /// Number of parameters.
    fn parameters(&self) -> usize;

    /// Length of the rows (default: the number of parameters).
    fn basis(&self) -> usize {
        self.parameters()
    }

    /// Number of vertices.
    fn vertices(&self) -> usize;

    /// Visits the nonzero entries of `dᵀ ∂V_v/∂q` over the basis, for parameters zero unless the map is
    /// linear; an index may occur more than once.
    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64));

    /// Adds the rows of several vertices and directions, of which one may come more than once, to a row.
    fn add_to(&self, vertices: &[(u32, DVec3)], row: &mut SparseRow) {
        for (vertex, direction) in vertices {
            self.row(*vertex, *direction, &mut |k, entry| row.add(k, entry));
        }
    }

    /// The matrix `R` from parameters to the basis; `None` if they are the same.
    fn reduction(&self) -> Option<&DMatrix<f64>> {
        None
    }

    /// The displacements of all vertices, if they are not linear in the parameters.
    fn nonlinear_displacements(&self, _q: &DVector<f64>) -> Option<Vec<DVec3>> {
        None
    }

    /// The same map with its rows at other parameters than zero, if they depend on them.
    fn linearised_at(&self, _q: &DVector<f64>) -> Option<Box<dyn Deformation + '_>> {
        None
    }

    /// Rest positions of the control points, if the parameters are their displacements (x, y, z of each in
    /// turn).
    fn controls(&self) -> Option<&[DVec3]> {
        None
    }
}

/// Displacements of all vertices.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use nalgebra::DVector;
/// use planish_shell::{VertexDisplacements, displacements};
/// let deformation = VertexDisplacements::new(&[DVec3::ZERO, DVec3::X]);
/// let q = DVector::from_vec(vec![0.0, 0.0, 0.5, 0.0, 0.0, 0.0]);
/// assert_eq!(displacements(&deformation, &q), [0.5 * DVec3::Z, DVec3::ZERO]);
/// ```
#[must_use]
pub fn displacements(deformation: &dyn Deformation, q: &DVector<f64>) -> Vec<DVec3> {
    if let Some(all) = deformation.nonlinear_displacements(q) {
        return all;
    }
    // Once for all vertices; the rows themselves stay short.
    let basis = in_basis(deformation, q);
    (0..deformation.vertices() as u32)
        .into_par_iter()
        .map(|vertex| {
            let along = |direction| row_product(deformation, vertex, direction, &basis);
            DVec3::from_array(DVec3::AXES.map(along))
        })
        .collect()
}

/// The rest positions plus their displacements.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use nalgebra::DVector;
/// use planish_shell::{VertexDisplacements, displaced_positions};
/// let rest = [DVec3::new(1.0, 2.0, 3.0)];
/// let deformation = VertexDisplacements::new(&rest);
/// let q = DVector::from_vec(vec![0.0, 0.0, 1.0]);
/// assert_eq!(displaced_positions(&rest, &deformation, &q), [DVec3::new(1.0, 2.0, 4.0)]);
/// ```
#[must_use]
pub fn displaced_positions(
    positions: &[DVec3],
    deformation: &dyn Deformation,
    q: &DVector<f64>,
) -> Vec<DVec3> {
    let by = displacements(deformation, q);
    positions.iter().zip(by).map(|(p, by)| *p + by).collect()
}

/// `dᵀ ∂V_v/∂q` over the parameters, as [`Deformation::row`].
#[must_use]
pub fn parameter_row(deformation: &dyn Deformation, vertex: u32, direction: DVec3) -> DVector<f64> {
    let mut row = DVector::zeros(deformation.basis());
    deformation.row(vertex, direction, &mut |k, entry| row[k] += entry);
    match deformation.reduction() {
        Some(reduction) => reduction.tr_mul(&row),
        None => row,
    }
}

/// Quadratic forms `rᵀ C r` of rows `r = dᵀ ∂V_v/∂q` with a symmetric matrix of the parameters, such as the
/// variance of a vertex along a direction.
///
/// Rows over the basis have few entries, so that the matrix is transformed once for all vertices.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_core::DVec3;
/// use planish_shell::{RowForms, VertexDisplacements};
/// let deformation = VertexDisplacements::new(&[DVec3::ZERO]);
/// let covariance = DMatrix::from_diagonal_element(3, 3, 4.0);
/// let forms = RowForms::new(&deformation, &covariance);
/// assert_eq!(forms.at(0, DVec3::Y), 4.0);
/// ```
pub struct RowForms<'a> {
    deformation: &'a dyn Deformation,
    of_basis: Cow<'a, DMatrix<f64>>,
}

impl<'a> RowForms<'a> {
    /// The forms with a matrix of the parameters.
    #[must_use]
    pub fn new(deformation: &'a dyn Deformation, matrix: &'a DMatrix<f64>) -> Self {
        let of_basis = match deformation.reduction() {
            Some(reduction) => Cow::Owned(reduction * matrix * reduction.transpose()),
            None => Cow::Borrowed(matrix),
        };
        Self { deformation, of_basis }
    }

    /// The form at a vertex along a direction.
    #[must_use]
    pub fn at(&self, vertex: u32, direction: DVec3) -> f64 {
        let mut row = Vec::new();
        self.deformation.row(vertex, direction, &mut |k, entry| row.push((k, entry)));
        let times = |(k, entry): &(usize, f64)| {
            entry * row.iter().map(|(j, other)| other * self.of_basis[(*j, *k)]).sum::<f64>()
        };
        row.iter().map(times).sum()
    }
}

/// The product of a row with a vector over the basis ([`in_basis`]).
pub(crate) fn row_product(
    deformation: &dyn Deformation,
    vertex: u32,
    direction: DVec3,
    basis: &DVector<f64>,
) -> f64 {
    let mut sum = 0.0;
    deformation.row(vertex, direction, &mut |k, entry| sum += entry * basis[k]);
    sum
}

/// The parameters in the basis of the rows.
pub(crate) fn in_basis(deformation: &dyn Deformation, q: &DVector<f64>) -> DVector<f64> {
    match deformation.reduction() {
        Some(reduction) => reduction * q,
        None => q.clone(),
    }
}
