//! Formation of a model with a growing number of readings, for animations.
//!
//! Input: a converged surface with its readings. Output: [`Snapshot`]s of the posterior after the first `n`
//! readings, in a random order by the seed, with `n` growing by a constant factor.
//!
//! For the global filter, a snapshot is the posterior of the first `n` readings over the final hierarchy,
//! with the final prior and feet. Information adds, so each takes one factorisation of `Λ_prior + Λ_n`. For
//! the patch filter, snapshots are states of the filter as it runs, preceded by those of the fit of its first
//! readings.
//!
//! Not guaranteed: that a fit of the first `n` readings alone would choose the same shape, hierarchy and
//! prior. Those come from all readings.

use super::FitOptions;
use super::patch::shuffled;
use super::refine::ConvergedFit;
use super::weights::{Weighting, weights};
use crate::model::{NodeCovariance, Posterior, VertexMotion};
use crate::observe::Observations;
use crate::observe::{FootState, by_leaf};
use planish_core::vector3::coordinates;
use planish_core::{DVec3, Progress};
use planish_estimate::Result;
use planish_estimate::sparse::SelectedInverse;
use planish_spline::{PatchFilter, Surface};
use std::sync::Arc;

/// Readings of the first snapshot.
const FIRST_READINGS: usize = 16;
/// Share of the mean diagonal that is added to it. It keeps directions that few readings leave open at their
/// final place.
const DIAGONAL_SHARE: f64 = 1e-7;

/// The posterior after a number of readings.
pub struct Snapshot {
    /// Number of readings.
    pub readings: usize,
    /// The surface at that moment.
    pub surface: Surface,
    covariance: Arc<NodeCovariance>,
}

/// The formation of a model.
#[derive(Default)]
pub struct Formation {
    /// Snapshots, from few readings to all of them.
    pub snapshots: Vec<Snapshot>,
    /// Positions of the readings, in their order.
    pub places: Vec<DVec3>,
}

impl Snapshot {
    /// The covariance of the surface at that moment.
    #[must_use]
    pub fn posterior(&self) -> Posterior<'_> {
        Posterior::new(&self.surface, Arc::clone(&self.covariance))
    }

    /// The posterior of a patch filter after `readings` readings, with its patches reconciled.
    ///
    /// # Errors
    /// What [`PatchFilter::reconcile`] and [`PatchFilter::surface`] report.
    pub fn of_patches(readings: usize, mut filter: PatchFilter) -> Result<Self> {
        filter.reconcile()?;
        let surface = filter.surface()?;
        Ok(Self::new(readings, surface, NodeCovariance::Patches(Arc::new(filter))))
    }

    fn new(readings: usize, surface: Surface, covariance: NodeCovariance) -> Self {
        Self { readings, surface, covariance: Arc::new(covariance) }
    }
}

impl Formation {
    /// The same with every point moved.
    pub(super) fn translated(mut self, by: DVec3) -> Result<Self> {
        if by == DVec3::ZERO {
            return Ok(self);
        }
        // Covariances do not depend on the origin, so only vertices and places move.
        for snapshot in &mut self.snapshots {
            let moved = snapshot.surface.vertices().iter().map(|p| *p + by).collect();
            snapshot.surface = snapshot.surface.with_vertices(moved)?;
        }
        self.places.iter_mut().for_each(|p| *p += by);
        Ok(self)
    }
}

/// At most `frames` numbers from `first` to `all`, growing by a constant factor.
pub(super) fn counts(first: usize, all: usize, frames: usize) -> Vec<usize> {
    let first = first.min(all).max(1);
    let steps = frames.saturating_sub(1).max(1) as f64;
    let mut counts: Vec<usize> = (0..frames)
        .map(|k| (first as f64 * (all as f64 / first as f64).powf(k as f64 / steps)).round() as usize)
        .collect();
    counts.dedup();
    counts
}

/// Snapshots of a fit by the global filter.
pub(super) fn formation_of_global_fit(
    observations: &Observations,
    converged: &ConvergedFit,
    options: &FitOptions,
    frames: usize,
    progress: &dyn Progress,
) -> Result<Formation> {
    let ConvergedFit { surface, system, subset, feet, noise, prior, .. } = converged;
    let information = weights(converged.readings(observations), noise, options.gate, Weighting::Gated);
    let numbers: Vec<u32> = (0..subset.len() as u32).collect();
    // A random order: in the order of the files, the model would form scan by scan.
    let order: Vec<u32> = shuffled(&numbers, options.seed)
        .into_iter()
        .filter(|&k| information[k as usize] > 0.0 && feet[k as usize].state == FootState::Good)
        .filter(|&k| observations.inferred(subset[k as usize] as usize).is_none())
        .collect();
    // Inferred readings come with the last real one; rejected ones have no information.
    let mut rank = vec![order.len().saturating_sub(1); subset.len()];
    for (place, &k) in order.iter().enumerate() {
        rank[k as usize] = place;
    }
    let directions = surface.directions();
    let of_prior = system.contract(prior, &directions)?;
    let x: Vec<f64> = coordinates(surface.vertices()).to_vec();
    let mut product = vec![0.0; x.len()];
    prior.multiply(&x, &mut product)?;
    let pull: Vec<f64> = (directions.iter().enumerate())
        .map(|(unknown, d)| {
            let first = 3 * surface.space().node_of_unknown(unknown);
            let of = |values: &[f64]| DVec3::from_slice(&values[first..]);
            (of(prior.vector()) - of(&product)).dot(*d)
        })
        .collect();
    let (start, by_place) = by_leaf(feet, surface.space().leaves().len());
    let counts = counts(FIRST_READINGS, order.len(), frames);
    let mut formation = Formation {
        snapshots: Vec::with_capacity(counts.len()),
        places: order.iter().map(|&k| observations.readings.points[subset[k as usize] as usize]).collect(),
    };
    for (number, &count) in counts.iter().enumerate() {
        progress.check("animating", number as f64 / counts.len() as f64)?;
        progress.items(number, "frames");
        let mut total = system.accumulate_along(&directions, |leaf, add| {
            for &k in &by_place[start[leaf] as usize..start[leaf + 1] as usize] {
                let k = k as usize;
                if rank[k] < count && information[k] > 0.0 {
                    feet[k].rows(surface, |r, row| {
                        add(row, feet[k].normal, feet[k].residuals()[r], information[k])
                    });
                }
            }
        })?;
        // The step is taken from the final surface: its prior pulls by `η − K x`, the first readings by
        // theirs.
        let mut step: Vec<f64> = total.vector().iter().zip(&pull).map(|(a, b)| a + b).collect();
        total.add_scaled(&of_prior, 1.0)?;
        // Few readings leave directions open that the prior does not hold either.
        let hold = DIAGONAL_SHARE * total.diagonal().iter().sum::<f64>() / total.dimension() as f64;
        total.add_diagonal(hold.max(f64::MIN_POSITIVE));
        let factor = system.factorize_scalar(&total)?;
        factor.solve_in_place(&mut step)?;
        let motion = VertexMotion::Along(directions.clone());
        let covariance = NodeCovariance::of_motion(SelectedInverse::new(&factor), motion);
        formation.snapshots.push(Snapshot::new(count, surface.displaced(&directions, &step)?, covariance));
    }
    Ok(formation)
}
