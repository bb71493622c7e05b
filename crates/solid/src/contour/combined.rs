//! A batch, and of curved kinds a filter after it, whose estimate has no bias.
//!
//! The batch looks at all readings at once: it finds back from a start that is rough, and tells which readings are wild. What curvature adds to distances it
//! takes off to fourth order in the noise, which is not enough where the noise is a good part of the radius of curvature; the noise-updated filter,
//! which linearises every reading at its own place on the contour, has hardly any bias there, but does not find back from wild readings. So the filter
//! starts at what the batch found, and takes in all readings that are not wild for the batch.

use super::fit::{ContourFit, FitOptions, Method, batch, equations, shared};
use super::kind::Kind;
use super::recursive::recursive;
use super::sighting::{Motion, Setting, Sighting};
use planish_estimate::Result;
use planish_estimate::implicit::{ImplicitOptions, fit_implicit};
use std::f64::consts::TAU;

/// The filter is only asked where there are so many readings for each unknown.
const READINGS_AN_UNKNOWN: usize = 8;
/// Bias moves an estimate by a few standard deviations; where a filter ends farther from the batch than this, it has lost its way.
const FARTHEST: f64 = 5.0;

/// Where more of a round contour than this is unseen, its size hangs on the curvature of an arc, and the filter, which is sharp about each
/// reading, is too sure of it (±35° of a circle: NEES 5.9, batch 2.5).
const MOST_UNSEEN_RAD: f64 = 3.8;

/// The largest angle about the centre in which there is no reading.
fn unseen_turn(found: &ContourFit, sightings: &[Sighting], kept: &[usize]) -> f64 {
    let mut angles: Vec<f64> = (kept.iter())
        .map(|k| {
            let [x, y] = sightings[*k].point();
            (y - found.state[1]).atan2(x - found.state[0])
        })
        .collect();
    angles.sort_by(f64::total_cmp);
    let around = match (angles.first(), angles.last()) {
        (Some(first), Some(last)) => first + TAU - last,
        _ => TAU,
    };
    angles.windows(2).map(|pair| pair[1] - pair[0]).fold(around, f64::max)
}

/// The batch, and the filter where it has less bias.
///
/// # Errors
/// As [`batch`].
pub(super) fn combined(
    setting: &Setting,
    sightings: &[Sighting],
    start: &[f64],
    options: &FitOptions,
    thresholds: &[f64],
) -> Result<ContourFit> {
    let mut found = batch(setting, sightings, start, options, thresholds)?;
    let is_curved = matches!(setting.kind, Kind::Circle | Kind::Ellipse | Kind::Slot);
    if !is_curved || setting.motion != Motion::Still || !options.correct_bias {
        return Ok(found);
    }
    // What the batch could give no place on the contour is not wild for that: without it a circle would be too large.
    let (all, groups) = equations(setting, sightings);
    let look = ImplicitOptions {
        max_iterations: 0,
        correct_bias: false,
        ..ImplicitOptions::default()
    };
    let seen = fit_implicit(&all, shared(setting, &groups), &found.state, &look)?.distances;
    let is_wild = |k: usize| seen[k].is_finite() && options.gate.is_some_and(|gate| seen[k].abs() > gate);
    let kept: Vec<usize> = (0..sightings.len()).filter(|k| !is_wild(*k)).collect();
    if kept.len() < READINGS_AN_UNKNOWN * setting.unknowns() {
        return Ok(found);
    }
    if matches!(setting.kind, Kind::Circle | Kind::Ellipse) && unseen_turn(&found, sightings, &kept) > MOST_UNSEEN_RAD {
        return Ok(found);
    }
    let readings: Vec<Sighting> = kept.iter().map(|k| sightings[*k]).collect();
    let options = FitOptions {
        method: Method::NoiseUpdated,
        ..options.clone()
    };
    let Ok(filtered) = recursive(setting, &readings, found.state.as_slice(), &options) else {
        return Ok(found);
    };
    let off = &filtered.state - &found.state;
    let solved = found.covariance.clone().cholesky().map(|c| c.solve(&off));
    let is_near = solved.is_some_and(|s| off.dot(&s) < FARTHEST * FARTHEST * off.len() as f64);
    if is_near && filtered.covariance.iter().all(|c| c.is_finite()) {
        found.distances.fill(f64::NAN);
        found.used.fill(false);
        for (k, at) in kept.into_iter().enumerate() {
            (found.distances[at], found.used[at]) = (filtered.distances[k], filtered.used[k]);
        }
        found.state = filtered.state;
        found.covariance = filtered.covariance;
        found.squares = filtered.squares;
        found.least_seen = filtered.least_seen;
    }
    Ok(found)
}
