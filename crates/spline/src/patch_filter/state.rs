//! A patch filter as plain numbers, to be saved and resumed.
//!
//! Comes in: a [`PatchFilter`]. Goes out: a [`PatchFilterState`] that holds all of it, and the filter again,
//! which goes on as if nothing had happened, to the last bit.

use super::belief::PatchBelief;
use super::criterion::InnovationSum;
use super::filter::{Member, PatchFilter, PatchFilterOptions, StateLayout};
use super::prior::SmoothnessPrior;
use super::quadtree::{Patch, Quadtree, VERTICES};
use crate::hierarchy::{Cell, Hierarchy, MAX_LEVEL, Shape};
use crate::surface::Surface;
use nalgebra::DMatrix;
use planish_estimate::vector3::add;
use planish_estimate::{Error, Result};
use std::sync::Arc;

/// All that a patch filter knows.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchFilterState {
    /// The topology.
    pub shape: Shape,
    /// Base cells along u and v.
    pub base: [usize; 2],
    /// Vertices of the initial surface over the base grid.
    pub initial_vertices: Vec<[f64; 3]>,
    /// Vertices of the surface whose metric smoothness is meant in, over the base grid.
    pub metric_vertices: Vec<[f64; 3]>,
    /// The prior.
    pub prior: SmoothnessPrior,
    /// How it works.
    pub options: PatchFilterOptions,
    /// Readings taken in so far.
    pub readings: u64,
    /// The leaf patches.
    pub patches: Vec<PatchState>,
}

/// All that is kept of one leaf patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchState {
    /// Which.
    pub patch: Patch,
    /// What it believes.
    pub belief: PatchBelief,
    /// What it believed before the readings that its neighbours have not heard of.
    pub before: Option<PatchBelief>,
    /// Prior covariance of one coordinate, 49 × 49.
    pub prior_covariance: Vec<f64>,
    /// What its readings said, cell by cell.
    pub innovations: [InnovationSum; 16],
}

impl PatchFilterState {
    /// The same in coordinates whose origin lies at `−by`: every point moves by `by`, no covariance changes.
    pub fn translate(&mut self, by: [f64; 3]) {
        for vertices in [&mut self.initial_vertices, &mut self.metric_vertices] {
            for p in vertices {
                *p = add(*p, by);
            }
        }
        // The unknowns of a mean are coordinates in turn, or heights alone.
        let heights = self.options.layout == StateLayout::Height;
        for patch in &mut self.patches {
            for belief in [Some(&mut patch.belief), patch.before.as_mut()].into_iter().flatten() {
                belief.translate(|k| if heights { by[2] } else { by[k % 3] });
            }
        }
    }
}

impl PatchFilter {
    /// All that the filter knows, as plain numbers.
    #[must_use]
    pub fn state(&self) -> PatchFilterState {
        PatchFilterState {
            shape: self.initial.space().shape(),
            base: self.initial.space().base(),
            initial_vertices: self.initial.vertices().to_vec(),
            metric_vertices: self.metric.vertices().to_vec(),
            prior: self.prior,
            options: self.options,
            readings: self.readings,
            patches: self
                .quadtree
                .patches
                .iter()
                .zip(&self.members)
                .map(|(&patch, member)| PatchState {
                    patch,
                    belief: member.belief.clone(),
                    before: member.before.clone(),
                    prior_covariance: member.prior.as_slice().to_vec(),
                    innovations: member.innovations,
                })
                .collect(),
        }
    }

    /// The filter that had this state.
    ///
    /// # Errors
    /// `Input` when parts of the state do not fit each other.
    pub fn from_state(state: &PatchFilterState) -> Result<Self> {
        state.prior.validate()?;
        let deepest = state.options.maximum_depth;
        if usize::from(deepest) > MAX_LEVEL || state.patches.iter().any(|p| p.patch.depth > deepest) {
            return Err(Error::input(format!(
                "a patch filter's state has patches deeper than its maximum depth of {deepest}, or that is \
                 beyond {MAX_LEVEL}"
            )));
        }
        let base = Arc::new(Hierarchy::uniform(state.shape, state.base)?);
        let initial = Surface::new(Arc::clone(&base), state.initial_vertices.clone())?;
        let metric = Surface::new(base, state.metric_vertices.clone())?;
        let cells: Vec<Cell> = state
            .patches
            .iter()
            .flat_map(|p| {
                (0..16).map(|k| Cell {
                    level: p.patch.depth,
                    i: p.patch.i.saturating_mul(4).saturating_add(k % 4),
                    j: p.patch.j.saturating_mul(4).saturating_add(k / 4),
                })
            })
            .collect();
        let space = Arc::new(Hierarchy::from_leaves(state.shape, state.base, &cells)?);
        let quadtree = Quadtree::new(Arc::clone(&space))?;
        let refined = initial.refined(space)?;
        if quadtree.patches.len() != state.patches.len() {
            return Err(Error::input("a patch filter's state lists a patch twice"));
        }
        let sizes = state.options.layout.size();
        let members = quadtree
            .patches
            .iter()
            .enumerate()
            .map(|(p, patch)| {
                let own = state
                    .patches
                    .iter()
                    .find(|s| s.patch == *patch)
                    .ok_or_else(|| Error::input(format!("a patch filter's state lacks {patch:?}")))?;
                let beliefs = [Some(&own.belief), own.before.as_ref()];
                if own.prior_covariance.len() != VERTICES * VERTICES
                    || beliefs.iter().flatten().any(|b| (b.dimension(), b.columns()) != sizes)
                {
                    return Err(Error::input(format!("the state of {patch:?} has the wrong size")));
                }
                Ok(Member {
                    belief: own.belief.clone(),
                    before: own.before.clone(),
                    prior: DMatrix::from_column_slice(VERTICES, VERTICES, &own.prior_covariance),
                    innovations: own.innovations,
                    initial: quadtree.coefficients(p, |leaf| *refined.leaf_coefficients(leaf)),
                })
            })
            .collect::<Result<_>>()?;
        Self::assemble(initial, metric, state.prior, state.options, quadtree, members, state.readings)
    }
}
