//! Chooses poses of a sensor one after the other.
//!
//! Input: a model and a sensor with a field of view. Output: poses with σ after each. Each pose is the best
//! of the candidates, given the views before it.
//!
//! Candidates surround the model at feasible distances. They are compared by representatives: a few hundred
//! places, each of which represents the surface around it. If a representative is visible, it also represents
//! all rays that hit its surroundings: `n` readings with variance `r` count as one with variance `r/n`. Let
//! `K` be the covariance of the representatives, `B` the visible ones and `R` their variances. The remaining
//! covariance is `K_mm − K_mB (K_BB + R)⁻¹ K_Bm`. The chosen view is then evaluated exactly: all its readings
//! are added to the sparse information, which is factorised again.
//!
//! Not guaranteed: the best set of views (see [`super::next_points`]), or the best of all poses.

use super::sight::Sight;
use super::{
    Change, NextOptions, Objective, Place, Prepared, UnmeasurableSigma, check_lengths, check_view_count,
    chosen, columns, cost, figures, variances_of,
};
use nalgebra::{Cholesky, DMatrix};
use planish_core::{DVec3, Progress, Silent};
use planish_estimate::Error;
use planish_estimate::Result;
use planish_estimate::sparse::CholeskyFactor;
use planish_sense::{Pose, ViewSensor};
use planish_surface::model::SurfaceModel;
use rayon::prelude::*;
use serde::Serialize;

/// Number of places that represent the surface while candidates are compared. The cost of a candidate grows
/// with its cube.
const REPRESENTATIVES: usize = 200;
/// Minimum relative improvement of a view. The choice ends when no view reaches it. It only excludes rounding
/// errors; how much is worthwhile is for the user to decide.
const MIN_GAIN: f64 = 1e-6;

/// A pose to measure from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NextView {
    /// The sensor's place: translation of `p_world = R p_sensor + t`, in the model's unit.
    pub translation: DVec3,
    /// Its rotation; the sensor looks along its z, with x right and y down.
    pub quaternion_xyzw: [f64; 4],
    /// Number of rays with a reading.
    pub readings: usize,
    /// Share of the region's area that it sees.
    pub seen: f64,
    /// Share that it or a view before it sees.
    pub seen_so_far: f64,
    /// Largest σ of the region after this view and those before it.
    pub worst_sigma_after: f64,
    /// The root of the mean variance of the region then, by area.
    pub mean_sigma_after: f64,
}

/// A place that no candidate sees.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnseenPlace {
    /// Position on the surface.
    pub position: DVec3,
    /// The surface's unit normal there.
    pub normal: DVec3,
    /// σ of the surface along the normal after all views.
    pub sigma: f64,
}

/// Planned poses of a sensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewsReport {
    /// The poses, best first.
    pub views: Vec<NextView>,
    /// The largest σ of the region.
    pub worst_sigma: Change,
    /// The root of the mean variance of the region, by area.
    pub mean_sigma: Change,
    /// Poses that were compared.
    pub candidates: usize,
    /// Share of the region's area that none of them sees.
    pub unseen: f64,
    /// The place with the largest σ that no view sees. Absent if all places can be seen.
    pub worst_unseen: Option<UnseenPlace>,
    /// Mean σ of the planned readings along their rays.
    pub sigma_along: Option<f64>,
    /// Whether the goal is reached; none if no goal was given.
    pub reached_goal: Option<bool>,
    /// σ of unresolved shape, which all other figures exclude. Absent if there is none.
    #[serde(rename = "shape_left", skip_serializing_if = "Option::is_none")]
    pub unresolved_shape: Option<UnmeasurableSigma>,
}

/// Chooses poses one after the other. The options `sigma` and `against_random` are ignored.
///
/// Cost: one line of sight for every candidate and place. For every view: one factorisation, and for every
/// candidate the Cholesky factor of the representatives that it sees.
///
/// # Errors
/// Those of [`super::next_points`]; `Input` also for an invalid sensor, and if no pose sees any part of the
/// region.
pub fn next_views(
    model: &SurfaceModel,
    sensor: &ViewSensor,
    options: &NextOptions,
    progress: &dyn Progress,
) -> Result<ViewsReport> {
    sensor.sanity_check()?;
    check_view_count(options)?;
    check_lengths(&[("goal", options.goal)])?;
    let Prepared { system, directions, mut information, places } = Prepared::new(model, options, progress)?;
    let mut factor = system.factorize_scalar(&information)?;
    progress.check("covariance", 0.1)?;
    let mut variances = variances_of(model, &factor, directions.clone(), &places)?;
    progress.check("lines of sight", 0.15)?;
    let sight = Sight::new(model, sensor)?;
    let representatives = Representatives::new(&places, &variances);
    // Visibility does not depend on the views chosen so far, so it is computed once.
    let candidates = candidates(&sight, sensor, &places, &representatives, progress)?;
    let visible_from_any = seen_by_any(&sight, &places, &candidates, progress)?;
    let before = figures(&places, &variances);
    let area: f64 = places.iter().map(|p| p.area).sum();
    let share = |seen: &[bool]| {
        let areas = places.iter().zip(seen).filter(|(_, s)| **s).map(|(p, _)| p.area);
        // `sum()` of an empty iterator is −0, which would be printed with its sign.
        areas.fold(0.0, |sum, a| sum + a) / area
    };
    let mut seen_so_far = vec![false; places.len()];
    let mut views: Vec<NextView> = Vec::new();
    let (mut noise, mut readings) = (0.0, 0.0);
    let reached = |variances: &[f64]| options.goal.map(|goal| figures(&places, variances).0 <= goal);
    while views.len() < options.count && reached(&variances) != Some(true) {
        let done = views.len() as f64 / options.count as f64;
        progress.check("choosing", 0.4 + 0.6 * done)?;
        progress.items(views.len(), "views");
        let together = representatives.covariance(&factor, directions.len(), &places)?;
        let Some(best) = best_of(&candidates, &together, &representatives, options.objective) else {
            break;
        };
        let pose = candidates[best].pose;
        // The comparison used representatives. The chosen view is added with all its rays, so that σ after it
        // is exact.
        let visible = sight.readings(&pose);
        let of_leaf = visible.by_leaf(model.surface.space().leaves().len());
        let more = system.accumulate_along(&directions, |leaf, add| {
            for (weights, normal, value, information) in &of_leaf[leaf] {
                add(weights, *normal, *value, *information);
            }
        })?;
        information.add_scaled(&more, 1.0)?;
        // The sparsity pattern is unchanged: readings only couple nodes of one leaf.
        factor = factor.refactorize(&information)?;
        variances = variances_of(model, &factor, directions.clone(), &places)?;
        // All places, not only representatives: the reported area must be that of the surface.
        let seen: Vec<bool> =
            (places.par_iter()).map(|p| sight.visible_coordinates(&pose, p).is_some()).collect();
        seen_so_far.iter_mut().zip(&seen).for_each(|(all, new)| *all |= new);
        let (worst, mean) = figures(&places, &variances);
        // Weighted by rays, because a job file has one σ for all readings of the sensor.
        noise += visible.rays_per_reading * visible.readings.iter().map(|r| r.sigma_along).sum::<f64>();
        let count = visible.rays_per_reading * visible.readings.len() as f64;
        readings += count;
        views.push(NextView {
            translation: pose.translation,
            quaternion_xyzw: pose.quaternion_xyzw(),
            readings: count.round() as usize,
            seen: share(&seen),
            seen_so_far: share(&seen_so_far),
            worst_sigma_after: worst,
            mean_sigma_after: mean,
        });
    }
    let after = figures(&places, &variances);
    let unseen: Vec<bool> = visible_from_any.iter().map(|s| !s).collect();
    let worst_unseen =
        (0..places.len()).filter(|&k| unseen[k]).max_by(|&a, &b| variances[a].total_cmp(&variances[b]));
    progress.advance("done", 1.0);
    Ok(ViewsReport {
        views,
        worst_sigma: Change { before: before.0, after: after.0 },
        mean_sigma: Change { before: before.1, after: after.1 },
        candidates: candidates.len(),
        unseen: share(&unseen),
        worst_unseen: worst_unseen.map(|k| UnseenPlace {
            position: places[k].position,
            normal: places[k].normal,
            sigma: variances[k].sqrt(),
        }),
        sigma_along: (readings > 0.0).then(|| noise / readings),
        reached_goal: reached(&variances),
        unresolved_shape: UnmeasurableSigma::new(model, &places, &variances),
    })
}

/// Places that represent the surface.
struct Representatives {
    /// Their places.
    places: Vec<usize>,
    /// The area that each represents.
    areas: Vec<f64>,
}

impl Representatives {
    fn new(places: &[Place], variances: &[f64]) -> Self {
        let chosen = chosen(places, variances, REPRESENTATIVES);
        let size = places.iter().map(|p| p.area).sum::<f64>().sqrt();
        // Opposite sides of a thin part are not near.
        let apart = |a: &Place, b: &Place| {
            a.position.distance(b.position).powi(2) + size * size * (1.0 - a.normal.dot(b.normal)).powi(2)
        };
        let nearest: Vec<usize> = (places.par_iter())
            .map(|place| {
                let to = |k: &usize| apart(place, &places[chosen[*k]]);
                (0..chosen.len()).min_by(|a, b| to(a).total_cmp(&to(b))).unwrap_or(0)
            })
            .collect();
        let mut areas = vec![0.0; chosen.len()];
        for (place, k) in places.iter().zip(nearest) {
            areas[k] += place.area;
        }
        Self { places: chosen, areas }
    }

    /// Their covariance with each other.
    fn covariance(&self, factor: &CholeskyFactor, unknowns: usize, places: &[Place]) -> Result<DMatrix<f64>> {
        let columns = columns(factor, unknowns, places, self.places.clone(), &Silent)?;
        let n = self.places.len();
        Ok(DMatrix::from_fn(n, n, |i, j| places[self.places[i]].dot(&columns[j].column)))
    }
}

/// A pose that sees something: which representatives, and the information of the rays that meet them.
struct CandidateView {
    pose: Pose,
    seen: Vec<(usize, f64)>,
}

fn candidates(
    sight: &Sight<'_>,
    sensor: &ViewSensor,
    places: &[Place],
    representatives: &Representatives,
    progress: &dyn Progress,
) -> Result<Vec<CandidateView>> {
    let poses = sight.poses(places, &representatives.places);
    let mut found = Vec::with_capacity(poses.len());
    // Chunks allow an interruption. Their order is that of the poses.
    for part in poses.chunks(256) {
        progress.check("lines of sight", 0.2)?;
        found.par_extend(part.par_iter().filter_map(|pose| {
            let information = |k: usize| {
                let place = &places[representatives.places[k]];
                let (local, cosine) = sight.visible_coordinates(pose, place)?;
                let range = local.length_squared().sqrt();
                // A representative counts with all rays that meet its area.
                let rays = sensor.rays_on(local, representatives.areas[k], cosine);
                Some((k, rays / sensor.variance_along_normal(range, cosine)))
            };
            let seen: Vec<_> = (0..representatives.places.len()).filter_map(information).collect();
            (!seen.is_empty()).then_some(CandidateView { pose: *pose, seen })
        }));
    }
    if found.is_empty() {
        return Err(Error::input(
            "expected a sensor whose range and field of view fit the size of the model, found no pose that \
             sees the region: check the units",
        ));
    }
    Ok(found)
}

/// For each place, whether any candidate sees it.
fn seen_by_any(
    sight: &Sight<'_>,
    places: &[Place],
    candidates: &[CandidateView],
    progress: &dyn Progress,
) -> Result<Vec<bool>> {
    let mut seen = vec![false; places.len()];
    for (k, part) in candidates.chunks(64).enumerate() {
        progress.check("lines of sight", 0.25 + 0.15 * (64 * k) as f64 / candidates.len() as f64)?;
        progress.items(64 * k, "views");
        seen.par_iter_mut().zip(places).with_min_len(16).for_each(|(seen, place)| {
            *seen = *seen || part.iter().any(|view| sight.visible_coordinates(&view.pose, place).is_some());
        });
    }
    Ok(seen)
}

/// The candidate with the smallest remaining objective, or none if no candidate improves it enough.
fn best_of(
    candidates: &[CandidateView],
    covariance: &DMatrix<f64>,
    representatives: &Representatives,
    objective: Objective,
) -> Option<usize> {
    let total = |variance: &dyn Fn(usize) -> f64| -> f64 {
        let cost_of = |(k, area): (usize, &f64)| area * cost(objective, variance(k).max(0.0));
        representatives.areas.iter().enumerate().map(cost_of).sum()
    };
    // All candidates start from the same covariance, so it is computed once per view and not once per
    // candidate.
    let now = total(&|k| covariance[(k, k)]);
    let left: Vec<f64> = candidates
        .par_iter()
        .map(|view| match variance_reductions(covariance, &view.seen) {
            Some(reduction) => total(&|k| covariance[(k, k)] - reduction[k]),
            // A factorisation that fails by rounding only excludes its candidate.
            None => f64::INFINITY,
        })
        .collect();
    // Of equally good candidates the first counts, whatever the number of threads.
    (0..left.len())
        .min_by(|&a, &b| left[a].total_cmp(&left[b]))
        .filter(|&best| left[best] < (1.0 - MIN_GAIN) * now)
}

/// Reduction of the variance of each representative by readings of some: the diagonal of `K_·B (K_BB + R)⁻¹
/// K_B·`.
fn variance_reductions(covariance: &DMatrix<f64>, seen: &[(usize, f64)]) -> Option<Vec<f64>> {
    let own = DMatrix::from_fn(seen.len(), seen.len(), |i, j| {
        let reading = if i == j { 1.0 / seen[i].1 } else { 0.0 };
        covariance[(seen[i].0, seen[j].0)] + reading
    });
    let mut rows = DMatrix::from_fn(seen.len(), covariance.ncols(), |i, j| covariance[(seen[i].0, j)]);
    let solved = Cholesky::new(own)?.l().solve_lower_triangular_mut(&mut rows);
    solved.then(|| rows.column_iter().map(|column| column.norm_squared()).collect())
}
