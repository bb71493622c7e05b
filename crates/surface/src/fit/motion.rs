//! A rigid body that moves while it is scanned: a Kalman filter of pose and velocity.
//!
//! The state is the pose `T(t)` of the object and its twist `ξ`, constant but for white noise of
//! acceleration: `T(t + dt) = T(t) exp(ξ dt)`. Errors are multiplied from the right, `T = T̂ exp(δ)`. A scan
//! at a known time is matched to the surface of the scans before it: that of the first, and once half of a
//! scan lies beyond it, one that is fitted to all scans so far. The height of a reading `z` over that
//! surface is `h = n·(T⁻¹z − foot)`, with `∂h/∂δ = −[p × n, n]` and `p = T⁻¹z`. Gauss–Newton on these
//! heights and the predicted pose is the iterated Kalman filter.
//!
//! The surface has errors of its own, `e ~ N(0, Σ)` of its nodes along their normals, common to all scans.
//! They move a pose by `P Aᵀe`, with `A = Σ w a jᵀ` over the matched readings (`a` their rows over the nodes,
//! `j = ∂h/∂δ`, `P` the inverse of the pose's information). Readings are weighted by `w = 1/(σ² + σ_S²)`,
//! with σ_S of the surface at their feet. The covariance of a pose is then `P (Λ₀ + Σ w²σ² jjᵀ + AᵀΣA) P`,
//! with `Λ₀` the information of the prediction. Only differences between scans matter for the velocity: for
//! the filter, the frame has the covariance `B = N/N₀ H⁻¹`, with `H` the information of the `N` readings of a
//! scan and `N₀` the readings of the surface.
//!
//! Positions are relative to the middle of the object, so that rotation and translation are nearly
//! independent.
//!
//! Afterwards all scans are fitted together. The tracked poses, with σ enlarged four times, are the prior of
//! that fit: all scans together determine each pose better than the first scan alone.
//! [`RigidTracker::adopt_poses`] then takes these poses over, and the steady motion nearest to them.
//!
//! Not guaranteed: rotations of more than about forty degrees from scan to scan are not found.
//!
//! # References
//! Bell & Cathey, *The iterated Kalman filter update as a Gauss–Newton method*, IEEE TAC 38 (1993).

mod matching;
mod report;
mod tracker;

pub use report::{MotionPose, MotionReport};

use super::{Fit, FitOptions, GlobalOptions, fit, observation_options, observe, scans_of};
use crate::observe::ObservationOptions;
use planish_core::{DVec3, Progress, ProgressPart};
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use planish_spline::Shape;
use tracker::RigidTracker;

/// A part of the surface faces away if its normal has a smaller cosine with the mean normal: 66° (decision
/// 0019).
const AWAY_COSINE: f64 = 0.4;
/// Largest share of the area of a sheet that faces away. More of it is the side of a solid object.
const MAX_AWAY: f64 = 0.03;

/// Fits an object that moved between its scans.
///
/// The first scan gives a surface. The others are matched to it, which gives the motion. All scans together
/// then give the model, in the pose of the object at the first scan.
pub(super) fn fit_moving(
    set: &ScanSet,
    global: &GlobalOptions,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Fit> {
    let order = scans_in_time(set)?;
    let mut still = options.with_global(global.clone());
    // The first scan alone is fitted without completion: symmetry and gaps are those of all scans together.
    let GlobalOptions { ground, align, .. } = *global;
    let mut plain = options.with_global(GlobalOptions { ground, align, ..GlobalOptions::default() });
    let mut first = fit(&scans_of(set, &order[..1]), &plain, &ProgressPart::new(progress, 0.0, 0.15))?;
    // A turning object shows its sides in time: one that curves away from the scanner is no sheet.
    if options.shape.is_none()
        && first.model.surface.space().shape() == Some(Shape::Sheet)
        && curves_away(&first)
    {
        (still.shape, plain.shape) = (Some(Shape::Ball), Some(Shape::Ball));
        first = fit(&scans_of(set, &order[..1]), &plain, &ProgressPart::new(progress, 0.15, 0.3))?;
    }
    let mut tracker = RigidTracker::new(&first, set, &order)?;
    let share = |k: usize| 0.3 + 0.2 * k as f64 / order.len() as f64;
    // What some of the scans cannot show is judged in the fit of all.
    let partial = FitOptions { force: true, ..plain.clone() };
    for (k, &scan) in order.iter().enumerate().skip(1) {
        progress.check("tracking the motion", share(k))?;
        progress.items(k - 1, "scans");
        let readings = observe(
            &scans_of(set, &[scan]),
            // Tracking judges nothing; the fit of all scans holds readings out.
            &ObservationOptions { held_out_share: 0.0, ..observation_options(set, &plain) },
        )?;
        // The first scan saw one side. Of an object that turns further, the surface grows with the scans.
        if tracker.leaves_surface(&readings) {
            let part = ProgressPart::new(progress, share(k), share(k + 1));
            let so_far = scans_of(&in_object_frame(set, &tracker, order[0]), &order[..k]);
            tracker.refer_to(&fit(&so_far, &partial, &part)?)?;
        }
        tracker.follow(scan, &readings)?;
    }
    let moved = in_object_frame(set, &tracker, order[0]);
    let mut fitted = fit(&moved, &still, &ProgressPart::new(progress, 0.5, 1.0))?;
    tracker.adopt_poses(set, &fitted.report.poses)?;
    fitted.report.propagation.get_or_insert_default().motion = Some(tracker.report(set)?);
    Ok(fitted)
}

/// The scans in the frame of the object, where it rests and the scanners move, so that they can be fitted
/// together.
///
/// All scans together determine the poses better than the tracker did, so they stay unknowns; what it found
/// is their prior. Scans that were not tracked yet stay.
fn in_object_frame(set: &ScanSet, tracker: &RigidTracker, first: usize) -> ScanSet {
    let mut moved = set.clone();
    for (k, posed) in moved.scans.iter_mut().enumerate() {
        let Some(world_from_object) = tracker.pose(k) else {
            continue;
        };
        posed.scan.world_from_scanner = world_from_object.inverse().after(&posed.scan.world_from_scanner);
        if k != first {
            let [translation, rotation] = tracker.sigmas(k, posed.scan.world_from_scanner.translation);
            posed.sigma_translation = Some(translation);
            posed.sigma_rotation_deg = Some(rotation.to_degrees());
        }
    }
    moved
}

/// True if more than 3 % of the measured area is turned from the mean normal by more than 66° (cosine
/// [`AWAY_COSINE`]).
fn curves_away(fitted: &Fit) -> bool {
    let surface = &fitted.model.surface;
    let areas: Vec<DVec3> = (0..surface.space().leaves().len())
        .filter(|&leaf| fitted.model.observed[leaf].is_measured())
        .filter_map(|leaf| {
            let [u, v] = surface.space().parameters(leaf, [0.5, 0.5]);
            Some(surface.leaf_area(leaf) * surface.normal(u, v)?)
        })
        .collect();
    let Some(towards) = areas.iter().sum::<DVec3>().try_normalize() else {
        // Normals that cancel each other are those of a closed object.
        return true;
    };
    let all: f64 = areas.iter().map(|a| a.length()).sum();
    let away: f64 = (areas.iter().map(|a| (a.length(), a.dot(towards))))
        .filter(|(area, facing)| *facing < AWAY_COSINE * area)
        .map(|(area, _)| area)
        .sum();
    away > MAX_AWAY * all
}

/// The scans in the order of their times.
///
/// # Errors
/// `Input` if one states no time, or all state the same.
pub(crate) fn scans_in_time(set: &ScanSet) -> Result<Vec<usize>> {
    if let Some(without_time) = set.scans.iter().find(|posed| posed.scan.time_s.is_none()) {
        return Err(Error::input(
            "expected the time of every scan of a moving object, found none: add `time = 1.5` (seconds) to \
             its [[scan]]",
        )
        .at(&without_time.scan.name));
    }
    let time = |k: usize| set.scans[k].scan.time_s.unwrap_or_default();
    let mut order: Vec<usize> = (0..set.scans.len()).collect();
    order.sort_by(|&a, &b| time(a).total_cmp(&time(b)));
    match (order.first(), order.last()) {
        (Some(&first), Some(&last)) if time(last) > time(first) => Ok(order),
        _ => Err(Error::input(format!(
            "expected scans of at least two times, found {} of one",
            set.scans.len()
        ))),
    }
}
