//! Subdivision by curvature, for the global filter: leaves around which Gaussian curvature varies.
//!
//! Input: a surface that has converged on its readings, with the factor of its information. Output: the
//! leaves with `sd(K)/max(|K̄|, σ_K) > 0.5`, where K is taken at the middles of the leaf and its neighbours.
//! The part of `sd(K)²` that σ_K explains is subtracted first.
//!
//! Not guaranteed: that more cells reduce the error. A surface may follow its readings to within the noise
//! and still be curved unevenly.
//!
//! # References
//! Wang, Wang 1994, eq. 11–13, with the correction in decision 0023.

use super::division::{CORNERS, MIN_LEAF_SIGMAS, MIN_READINGS, Misfit};
use super::leaves::{leaf_areas, neighbourhood};
use super::noise::SensorNoise;
use crate::model::{NodeCovariance, Posterior, VertexMotion};
use crate::observe::{FootState, ProjectedReadings, Quantity, by_leaf};
use crate::subdivision::Cause;
use planish_estimate::Result;
use planish_estimate::sparse::{CholeskyFactor, SelectedInverse};
use planish_spline::{Surface, curvature_variation};
use rayon::prelude::*;
use std::sync::Arc;

/// Largest variation of a leaf that is not divided (Wang & Wang 1994, eq. 13, made free of units). See
/// decision 0006.
const MAX_VARIATION: f64 = 0.5;

/// Leaves around which curvature varies, most variable first. Leaves at the deepest level are excluded, and
/// those that are too small or have too few readings.
pub(super) fn leaves_of_varying_curvature(
    surface: &Surface,
    factor: &CholeskyFactor,
    readings: ProjectedReadings<'_>,
    noise: &SensorNoise,
    deepest: u8,
) -> Result<Vec<Misfit>> {
    let feet = readings.feet;
    let space = surface.space();
    let leaves = space.leaves().len();
    // The factor of the last step is at hand and is near the posterior; a new one would cost a
    // factorisation.
    let motion = VertexMotion::Along(surface.directions());
    let covariance = Arc::new(NodeCovariance::of_motion(SelectedInverse::new(factor), motion));
    let posterior = Posterior::new(surface, covariance);
    let curvatures: Vec<Option<[f64; 2]>> = (0..leaves)
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| curvature_with_sigma(surface, &posterior, leaf))
        .collect::<Result<_>>()?;
    let (start, order) = by_leaf(feet, leaves);
    let areas = leaf_areas(surface);
    let mut found = Vec::new();
    for leaf in (0..leaves).filter(|&leaf| space.leaves()[leaf].level < deepest) {
        let own = &order[start[leaf] as usize..start[leaf + 1] as usize];
        let variances: Vec<f64> = (own.iter().map(|&k| k as usize))
            .filter(|&k| feet[k].state == FootState::Good && feet[k].quantity == Quantity::Position)
            .map(|k| noise.variance(readings, k))
            .collect();
        let mean = variances.iter().sum::<f64>() / variances.len().max(1) as f64;
        // The same limits as for misfits: on a leaf with few readings, curvature is that of the prior.
        if own.len() < MIN_READINGS as usize || areas[leaf] < MIN_LEAF_SIGMAS.powi(2) * mean {
            continue;
        }
        let around: Vec<[f64; 2]> =
            (neighbourhood(space, leaf).into_iter()).filter_map(|other| curvatures[other]).collect();
        // Curvature that σ_K explains does not count: noise alone would divide flat parts (decision 0006).
        let variation = curvature_variation(&around, true);
        if variation > MAX_VARIATION {
            found.push(Misfit {
                leaf,
                cause: Cause::Curvature,
                severity: variation,
                corner: corner_of_max_deviation(surface, leaf, &around),
            });
        }
    }
    found.sort_by(|a, b| b.severity.total_cmp(&a.severity).then(a.leaf.cmp(&b.leaf)));
    Ok(found)
}

/// Gaussian curvature at the middle of a leaf, and its σ to first order:
/// `dK = II₂₂ dII₁₁ − 2 II₁₂ dII₁₂ + II₁₁ dII₂₂`.
fn curvature_with_sigma(
    surface: &Surface,
    posterior: &Posterior<'_>,
    leaf: usize,
) -> Result<Option<[f64; 2]>> {
    let Some(rows) = surface.tangent_rows(leaf, [0.5; 2]) else {
        return Ok(None);
    };
    let [a, b, c] = rows.form;
    let bends = &rows.bends_along_normals;
    let slope: [f64; 16] = std::array::from_fn(|k| c * bends[0][k] - 2.0 * b * bends[1][k] + a * bends[2][k]);
    let variance = posterior.leaf(leaf)?.variance_along(&slope, rows.normal);
    Ok(Some([a * c - b * b, variance.max(0.0).sqrt()]))
}

/// Signs of the corner of a leaf whose curvature deviates most from the mean around it.
fn corner_of_max_deviation(surface: &Surface, leaf: usize, around: &[[f64; 2]]) -> [f64; 2] {
    let mean = around.iter().map(|[k, _]| k).sum::<f64>() / around.len() as f64;
    let off = |[s, t]: [f64; 2]| {
        // The middles of the four leaves that a division would make.
        let curvature = surface.leaf_jet(leaf, 0.5 + 0.25 * s, 0.5 + 0.25 * t).curvature();
        curvature.map_or(0.0, |c| (c.gaussian() - mean).abs())
    };
    CORNERS.into_iter().max_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or([1.0, 1.0])
}
