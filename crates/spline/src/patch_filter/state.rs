//! State of a patch filter as plain data, for saving and resuming.
//!
//! Input: a [`PatchFilter`]. Output: its [`PatchFilterState`], and a filter from such a state that continues
//! with identical results, bit for bit.

use super::belief::PatchBelief;
use super::criterion::InnovationSum;
use super::filter::{Member, PatchFilter};
use super::options::{PatchFilterOptions, StateLayout};
use super::prior::SmoothnessPrior;
use super::quadtree::{FilterPatch, Quadtree, VERTICES};
use crate::hierarchy::{Cell, Hierarchy, MAX_LEVEL, Shape};
use crate::surface::Surface;
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::sync::Arc;

/// Complete state of a patch filter.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchFilterState {
    /// The topology.
    pub shape: Shape,
    /// Number of base cells along u and v.
    pub base: [usize; 2],
    /// Vertices of the initial surface over the base grid.
    pub initial_vertices: Vec<DVec3>,
    /// Vertices of the surface that defines the metric of the smoothness prior, over the base grid.
    pub metric_vertices: Vec<DVec3>,
    /// The prior.
    pub prior: SmoothnessPrior,
    /// The options.
    pub options: PatchFilterOptions,
    /// Number of readings used so far.
    pub readings: u64,
    /// The leaf patches.
    pub patches: Vec<PatchState>,
}

/// State of one leaf patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchState {
    /// The patch.
    pub patch: FilterPatch,
    /// Its belief.
    pub belief: PatchBelief,
    /// The belief before readings that neighbours have not yet received.
    pub before: Option<PatchBelief>,
    /// Prior covariance of one coordinate, 49 × 49.
    pub prior_covariance: Vec<f64>,
    /// Sums of squared innovations, by cell.
    pub innovations: [InnovationSum; 16],
}

impl PatchFilterState {
    /// Moves every point by `by`. Covariances do not change.
    pub fn translate(&mut self, by: DVec3) {
        // The metric depends on derivatives only; its vertices are moved as well, so that both surfaces stay
        // in one frame.
        for vertices in [&mut self.initial_vertices, &mut self.metric_vertices] {
            for p in vertices {
                *p += by;
            }
        }
        // The unknowns are x, y, z in turn, or heights alone.
        let heights = self.options.layout == StateLayout::Height;
        for patch in &mut self.patches {
            for belief in [Some(&mut patch.belief), patch.before.as_mut()].into_iter().flatten() {
                belief.translate(|k| if heights { by[2] } else { by[k % 3] });
            }
        }
    }
}

impl PatchFilter {
    /// The complete state of the filter.
    #[must_use]
    pub fn state(&self) -> PatchFilterState {
        PatchFilterState {
            // Patches exist only over grids.
            shape: self.initial.space().shape().unwrap_or(Shape::Sheet),
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

    /// Restores a filter from its state.
    ///
    /// # Errors
    /// `Input` when parts of the state are inconsistent.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{
    ///     Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, parameter_plane,
    /// };
    ///
    /// let plane = parameter_plane(&Hierarchy::uniform(Shape::Sheet, [4, 4])?.into())?;
    /// let prior = SmoothnessPrior { weight: 1.0, hold: 0.01 };
    /// let filter = PatchFilter::new(&plane, &plane, prior, PatchFilterOptions::default())?;
    /// let restored = PatchFilter::from_state(&filter.state())?;
    /// assert_eq!(restored.state(), filter.state());
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn from_state(state: &PatchFilterState) -> Result<Self> {
        state.prior.validate()?;
        let deepest = state.options.maximum_depth;
        if usize::from(deepest) > MAX_LEVEL || state.patches.iter().any(|p| p.patch.depth > deepest) {
            return Err(Error::input(format!(
                "the state of a patch filter has patches deeper than its maximum depth of {deepest}, or this \
                 exceeds {MAX_LEVEL}"
            )));
        }
        let base = Arc::new(Hierarchy::uniform(state.shape, state.base)?);
        let initial = Surface::new(Arc::clone(&base), state.initial_vertices.clone())?;
        let metric = Surface::new(base, state.metric_vertices.clone())?;
        // A damaged file may contain any numbers. Saturated ones lie outside the grid and are rejected with a
        // message.
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
        // Recomputed instead of stored: it follows from the initial surface and the patches.
        let refined = initial.refined(space)?;
        if quadtree.patches.len() != state.patches.len() {
            return Err(Error::input("the state of a patch filter lists a patch twice"));
        }
        let sizes = state.options.layout.size();
        let members = quadtree
            .patches
            .iter()
            .enumerate()
            .map(|(p, patch)| {
                // Searched by patch, because the order in the state may differ from that of the quadtree.
                // Rejecting duplicates above makes the match unique.
                let own =
                    state.patches.iter().find(|s| s.patch == *patch).ok_or_else(|| {
                        Error::input(format!("the state of a patch filter lacks {patch:?}"))
                    })?;
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
