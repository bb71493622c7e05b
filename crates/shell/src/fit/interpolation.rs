//! The error of interpolation between controls: what closer controls would change.
//!
//! In: the equations of a converged fit whose parameters are the displacements of controls. Out: the
//! change of each vertex along its normal if the fit had closer controls.
//!
//! The sampling of the controls is refined until their distances are [`CLOSER`] times as large. One step
//! of a fit with these controls, from the result and with the same smoothness, gives the change `c`. Its
//! variance by noise alone is that of steps from the residuals of random signs. The error of
//! interpolation is in the square of the distance, so closer controls leave 0.36 of it (L. F. Richardson,
//! *The approximate arithmetical solution by finite differences*, 1911): the squared error is `(c² −
//! noise)/(1 − 0.36)²`, averaged over neighbouring vertices, because single changes are zero by chance.
//!
//! Correlated residuals show the same error only on average over many points. It is largest at tips and
//! between the controls of unobserved parts, where few or no points are.
//!
//! Not guaranteed: closer controls are vertices of the mesh, so they show nothing where all vertices are
//! controls already.

use super::correlation::DRAWS;
use super::dense::Factor;
use super::equations::{Equation, EquationRow, Equations, NormalEquations, SCALES};
use super::residual_leverage::Signs;
use super::smoothness::Smoothness;
use crate::controls::{ControlSampling, Controls, stiffness};
use crate::deformation::{Deformation, Dirichlet, in_basis, row_product};
use crate::fit::stiffness_for_xyz;
use crate::point_tree::PointTree;
use crate::rigidity::Rigidity;
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// Ratio of the distances of controls after and before. There are up to 2.8 times as many.
const CLOSER: f64 = 0.6;
/// Maximum number of closer controls. Time grows with the cube.
const MAX_CONTROLS: usize = 500;
/// Error over change: if the error is in the square of the distance, closer controls leave 0.36 of it.
const RICHARDSON: f64 = 1.0 / (1.0 - CLOSER * CLOSER);
/// Multiple of the variance by noise that is subtracted: its mean and one σ of a mean square of two values,
/// about the number of independent ones around a vertex. With the mean alone, chance left errors where
/// controls can follow the motion exactly.
const NOISE_REMOVED: f64 = 2.0;
/// Number of vertices over which squared changes are averaged.
const CHANGE_NEIGHBOURS: usize = 12;

/// The vectors `−Jᵀ W D` over closer controls of residuals that are noise alone: of random signs times
/// `scale`, after the fit ([`super::residual_leverage`]).
pub(super) fn noise_vectors(
    equations: &[Equations],
    left: &[Signs],
    deformation: &dyn Deformation,
    (factors, poses, scale): (&[f64; SCALES], usize, f64),
    counts: impl Fn(&Equation) -> bool,
) -> Vec<DVector<f64>> {
    let basis = deformation.basis();
    let mut sum = DMatrix::zeros(basis + 6 * poses, DRAWS);
    let mut row = EquationRow::new(deformation, poses);
    for ((equation, vertices, own_poses), [_, left]) in equations.iter().flat_map(Equations::iter).zip(left) {
        if !counts(equation) {
            continue;
        }
        let weight = -scale * equation.chance.0 / (equation.sigma * factors[equation.source.scale()]);
        for &(k, entry) in row.of(vertices, own_poses) {
            for (draw, left) in left.iter().enumerate() {
                sum[(k, draw)] += weight * left * entry;
            }
        }
    }
    let own = |draw: usize| sum.view((0, draw), (basis, 1)).column(0).into_owned();
    (0..DRAWS)
        .map(|draw| match deformation.reduction() {
            Some(r) => r.tr_mul(&own(draw)),
            None => own(draw),
        })
        .collect()
}

/// Smoothness of the fit whose controls are refined.
#[derive(Debug, Clone, Copy)]
pub(super) struct FitSmoothness {
    /// Its weight; zero if the fit has another prior. The weight of maximum likelihood of the change is
    /// used then.
    pub weight: f64,
    /// True if rotations of parts have no energy.
    pub allows_rotations: bool,
}

/// Closer controls than those of a fit.
pub(super) struct CloserControls {
    controls: Controls,
    /// The displacements of all vertices by those of the controls.
    pub deformation: Dirichlet,
}

impl CloserControls {
    /// Refines the sampling of a mesh by controls, given by their positions on the mesh at rest; `None`
    /// if no control can be added.
    ///
    /// # Errors
    /// As [`Dirichlet::new`].
    pub(super) fn new(rest: &TriangleMesh, controls: &[DVec3]) -> Result<Option<Self>> {
        let tree = PointTree::new(&rest.positions)?;
        let vertices: Vec<u32> =
            controls.iter().filter_map(|p| tree.nearest(*p, 1).first().map(|(_, v)| *v)).collect();
        let mut sampling = ControlSampling::of_vertices(rest, &vertices);
        let radii: Vec<f64> = sampling.radii().iter().map(|radius| CLOSER * radius).collect();
        if sampling.refine(&radii, MAX_CONTROLS.saturating_sub(sampling.count())) == 0 {
            return Ok(None);
        }
        let controls = sampling.controls();
        let deformation = Dirichlet::new(&controls.points, &rest.positions)?;
        Ok(Some(Self { controls, deformation }))
    }

    /// Error of interpolation along normals around each vertex. `pass` is the sum of the equations over
    /// these controls, `noise` are vectors like its own of noise alone, `start` the positions from which
    /// smooth displacements are counted. Zeros if the equations do not determine a change.
    ///
    /// # Errors
    /// As [`Smoothness::new`].
    pub(super) fn changes(
        &self,
        moved: &TriangleMesh,
        start: &[DVec3],
        pass: &NormalEquations,
        noise: &[DVector<f64>],
        fit: FitSmoothness,
    ) -> Result<Vec<f64>> {
        let Controls { vertices, points, triangles, edges } = &self.controls;
        let size = 3 * points.len();
        let k = stiffness(points, triangles, edges);
        let rigidity = match fit.allows_rotations {
            true => Some(Rigidity::new(points, edges, &k)?),
            false => None,
        };
        let mut smooth = Smoothness::new(stiffness_for_xyz(&k), rigidity, None)?;
        // Poses stay as they are.
        let information = pass.information.view((0, 0), (size, size)).into_owned();
        let vector = pass.vector.rows(0, size).into_owned();
        let (weight, displaced) = if fit.weight > 0.0 {
            let of_vertex = |v: &u32| (moved.positions[*v as usize] - start[*v as usize]).to_array();
            (fit.weight, DVector::from_iterator(size, vertices.iter().flat_map(of_vertex)))
        } else {
            let none = DVector::zeros(size);
            (smooth.weight(&information, &vector, &none)?, none)
        };
        let own = smooth.linearised(&displaced);
        let Some(factor) = Factor::new(&(information + weight * &*own.information)) else {
            return Ok(vec![0.0; moved.positions.len()]);
        };
        let of_basis = |change: DVector<f64>| in_basis(&self.deformation, &change);
        let change = of_basis(factor.solve(&(vector - weight * own.gradient)));
        let by_noise: Vec<DVector<f64>> =
            noise.iter().map(|vector| of_basis(factor.solve(&vector.rows(0, size).into_owned()))).collect();
        let per = 1.0 / noise.len().max(1) as f64;
        let normals = moved.vertex_normals();
        let squares: Vec<f64> = (0..normals.len())
            .into_par_iter()
            .map(|v| {
                let along = |basis| row_product(&self.deformation, v as u32, normals[v], basis);
                let by_noise: f64 = by_noise.iter().map(|noise| per * along(noise).powi(2)).sum();
                along(&change).powi(2) - NOISE_REMOVED * by_noise
            })
            .collect();
        let tree = PointTree::new(&moved.positions)?;
        let around = |at: &DVec3| {
            let near = tree.nearest(*at, CHANGE_NEIGHBOURS);
            let sum: f64 = near.iter().map(|(_, v)| squares[*v as usize]).sum();
            RICHARDSON * (sum / near.len().max(1) as f64).max(0.0).sqrt()
        };
        Ok(moved.positions.par_iter().map(around).collect())
    }
}
