//! What a user should know about a fit.

use super::{Finishing, has_uncertain_pose};
use crate::fit::noise::SensorNoise;
use crate::fit::patch::{PatchFilterOutcome, unused_biases};
use crate::fit::rejected_readings;
use crate::model::{SensorReport, SigmaSummary};
use crate::observe::{Quantity, RejectionCause};
use std::collections::BTreeMap;

/// Smallest plausible ratio of the surface's median σ to σ of the mean of all positions.
///
/// No part of a surface can be known better than one number that all positions measure. The margin below 1
/// allows for errors of the estimated σ; a folded surface is far below it.
const MIN_SIGMA_RATIO: f64 = 0.3;

/// Findings of the last stage from which warnings are made.
pub(super) struct SurfaceFindings<'a> {
    pub sensors: &'a [SensorReport],
    pub noise: &'a SensorNoise,
    pub rejected: &'a BTreeMap<String, usize>,
    pub sigma: SigmaSummary,
    /// Shares of the surface's area.
    pub observed_share: f64,
    pub inferred_share: f64,
    /// True if the depth limit leaves much shape unresolved.
    pub too_shallow: bool,
    pub reached_limit: bool,
}

/// Every warning of a fit but those about its poses, in the order of the report.
pub(super) fn all_warnings(fit: &Finishing<'_>, found: &SurfaceFindings<'_>) -> Vec<String> {
    let Finishing { set, observations, options, filtered, .. } = *fit;
    let mut warnings = common_warnings(
        found.sensors,
        found.observed_share,
        found.inferred_share,
        found.rejected,
        fit.total(),
    );
    // Sensors of earlier sessions are not among `sensors`, but further batches are.
    if fit.added.is_none() && found.sigma.median < MIN_SIGMA_RATIO * min_sigma(found.sensors) {
        warnings.push(
            "σ of the surface is less than all readings together could make it: the surface is folded, and \
             none of its figures holds; give another --shape, or normals"
                .to_owned(),
        );
    }
    if found.too_shallow {
        warnings.push(
            "the limit of depth was reached before the residuals were down to noise: σ takes in what is \
             left out of the shape, but σ of sensors that are estimated do so, too; raise --max-depth for \
             more detail"
                .to_owned(),
        );
    }
    if found.reached_limit {
        warnings.push(format!(
            "the limit of {} coefficients was reached before the residuals were down to noise: raise \
             --max-coefficients for more detail",
            options.max_coefficients
        ));
    }
    let lacking = observations.channels.iter().zip(&found.noise.lacks_redundancy);
    for (channel, _) in lacking.filter(|(_, lacks_redundancy)| **lacks_redundancy) {
        warnings.push(format!(
            "the readings of sensor \"{}\" state no σ and are so few that the surface follows them wherever \
             they go: they count with what they missed the model by before, which is too little if the \
             model has heard of them; state their σ",
            set.sensors[channel.sensor].name
        ));
    }
    warnings.extend(filtered.and_then(PatchFilterOutcome::warning));
    if filtered.is_some() && has_uncertain_pose(set) {
        warnings.push("the patch filter takes poses as exact: their σ was not used".to_owned());
    }
    if filtered.is_some() {
        warnings.extend(unused_biases(set));
    }
    warnings.extend(observations.duplicate_scan_warnings(set));
    warnings
}

/// σ of the mean of all positions, as if they were readings of one number. No part of a surface is known
/// better than that.
fn min_sigma(sensors: &[SensorReport]) -> f64 {
    let information: f64 = (sensors.iter())
        .filter(|s| s.quantity == Quantity::Position.name())
        .map(|s| s.observations as f64 / s.sigma_estimated.powi(2))
        .sum();
    if information > 0.0 { 1.0 / information.sqrt() } else { 0.0 }
}

/// Warnings that every kind of fit gives; `total` counts readings before any rejection.
pub(in crate::fit) fn common_warnings(
    sensors: &[SensorReport],
    observed: f64,
    inferred: f64,
    rejected: &BTreeMap<String, usize>,
    total: usize,
) -> Vec<String> {
    let mut warnings = Vec::new();
    for sensor in sensors {
        if let (Some(stated), true) = (sensor.sigma_stated, sensor.sigma_used_is_estimated) {
            warnings.push(format!(
                "sensor {:?} states σ = {stated:.3e}, but its residuals say {:.3e}: the estimate was used",
                sensor.name, sensor.sigma_estimated
            ));
        }
    }
    if observed < 0.5 {
        let completed = if inferred > 0.0 {
            format!(", {:.0} % was completed by what was measured elsewhere", 100.0 * inferred)
        } else {
            String::new()
        };
        warnings.push(format!(
            "only {:.0} % of the surface was measured{completed}: the rest is the smoothness prior's guess",
            100.0 * observed
        ));
    }
    let not_finite = rejected.get(RejectionCause::NotFinite.name()).copied().unwrap_or(0);
    if not_finite > 0 {
        warnings.push(format!(
            "{not_finite} of {total} points have coordinates that are not finite numbers: they were left out"
        ));
    }
    let turned = rejected.get(RejectionCause::NormalMismatch.name()).copied().unwrap_or(0);
    if turned * 50 > total {
        warnings.push(format!(
            "{turned} of {total} readings face another way than the surface near them: it misses folds or \
             thin parts there, or their normals are wrong; σ says nothing of that"
        ));
    }
    let gated = rejected_readings(rejected);
    let total = total - (rejected.values().sum::<usize>() - gated);
    if gated * 10 > total {
        warnings.push(format!("{gated} of {total} readings were set aside: see `rejected`"));
    }
    warnings
}
