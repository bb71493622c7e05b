//! What a user should know about a fit.

use super::{Finishing, has_uncertain_pose};
use crate::fit::noise::{STATED_SIGMA_TOLERANCE, SensorNoise};
use crate::fit::patch::{PatchFilterOutcome, unused_biases};
use crate::fit::rejected_readings;
use crate::fit::shared_errors::MAX_OVERSTATEMENT;
use crate::model::{SensorReport, SigmaSummary};
use crate::observe::{Quantity, RejectionCause};
use planish_core::numbers::significant;
use planish_core::{Finding, FindingCode, Setting, SmallUnit, Unit};
use std::collections::BTreeMap;

/// Smallest plausible ratio of the surface's median σ to σ of the mean of all positions.
///
/// No part of a surface can be known better than one number that all positions measure. The margin below 1
/// allows for errors of the estimated σ; a folded surface is far below it.
const MIN_SIGMA_RATIO: f64 = 0.3;

/// Share of the length of sharp edges that is reported if the surface is smooth there. Lengths of edges with
/// noise differ from those of the surface by a few percent.
const MIN_SMOOTH_SHARE: f64 = 0.1;

/// Results of the last stage that the findings depend on.
pub(super) struct SurfaceResults<'a> {
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
    /// Lengths of the sharp edges that the readings show, and of those of the surface.
    pub edge_lengths: [f64; 2],
}

/// Every finding about a fit except those about its poses, in the order of the report.
pub(super) fn all_findings(fit: &Finishing<'_>, found: &SurfaceResults<'_>) -> Vec<Finding> {
    let Finishing { set, observations, options, filtered, .. } = *fit;
    let mut findings = common_findings(
        found.sensors,
        set.unit.unwrap_or(Unit::Millimetre),
        found.observed_share,
        found.inferred_share,
        found.rejected,
        fit.total(),
    );
    // Sensors of earlier sessions are not among `sensors`, but further batches are.
    if fit.added.is_none() && found.sigma.median < MIN_SIGMA_RATIO * min_sigma(found.sensors) {
        let text = "σ of the surface is smaller than all readings together allow: the surface is folded \
            and the result is not valid; specify another shape, or add normals";
        findings.push(Finding::new(FindingCode::SurfaceFolded, text).with_setting(Setting::Shape));
    }
    if found.too_shallow {
        findings.push(
            Finding::new(
                FindingCode::DepthLimit,
                "the maximum depth was reached before only noise remained in the residuals: σ includes the \
                 unresolved shape, but so does the estimated σ of sensors; raise the maximum depth for \
                 more detail",
            )
            .with_setting(Setting::MaxDepth),
        );
    }
    if found.reached_limit {
        let text = format!(
            "the limit of {} coefficients was reached before only noise remained in the residuals: raise \
             it for more detail",
            options.max_coefficients
        );
        findings
            .push(Finding::new(FindingCode::CoefficientLimit, text).with_setting(Setting::MaxCoefficients));
    }
    findings.extend(smooth_edges(found.edge_lengths, set.unit.unwrap_or(Unit::Millimetre)));
    let lacking = observations.channels.iter().zip(&found.noise.lacks_redundancy);
    for (channel, _) in lacking.filter(|(_, lacks_redundancy)| **lacks_redundancy) {
        let text = format!(
            "sensor \"{}\" has no stated σ and too few readings to estimate it: σ is taken from their \
             distances to the earlier model, and is too small if that model includes them; specify σ",
            set.sensors[channel.sensor].name
        );
        findings.push(Finding::new(FindingCode::SigmaNotEstimable, text));
    }
    findings.extend(shared_errors_of_unstated(fit, found.noise));
    findings.extend(filtered.and_then(PatchFilterOutcome::finding));
    if filtered.is_some() && has_uncertain_pose(set) {
        findings.push(Finding::new(
            FindingCode::PoseSigmaUnused,
            "the patch filter treats poses as exact: their σ was not used",
        ));
    }
    if filtered.is_some() {
        findings.extend(unused_biases(set));
    }
    findings.extend(observations.duplicate_scan_findings(set));
    findings.extend(observations.normal_findings(set));
    findings
}

/// Edges that the readings show, and the surface does not have.
fn smooth_edges([shown, followed]: [f64; 2], unit: Unit) -> Option<Finding> {
    let left = shown - followed;
    let text = format!(
        "the readings show sharp edges of length {} {unit}; {} {unit} of them are smooth on the surface, \
         which is rounded there over the width of a cell: most of it is marked `observed` = 3",
        significant(shown, 3),
        significant(left, 2)
    );
    (left > MIN_SMOOTH_SHARE * shown).then(|| Finding::new(FindingCode::EdgesSmooth, text))
}

/// Sensors without a stated σ whose readings may share errors that the surface follows.
fn shared_errors_of_unstated(fit: &Finishing<'_>, noise: &SensorNoise) -> Vec<Finding> {
    let Finishing { set, observations, .. } = *fit;
    let unit = set.unit.unwrap_or(Unit::Millimetre);
    (observations.channels.iter().zip(&noise.estimated_factors))
        .filter(|(channel, _)| !channel.stated && !channel.inferred)
        .filter_map(|(channel, factor)| {
            let shared = channel.independent_noise()?.shared?;
            let lengths = SmallUnit::for_length(unit.name(), shared.sigma);
            let text = format!(
                "sensor {:?} states no σ, and its readings vary by {} over distances of {}, but only by {} \
                 between neighbours: this is shape, or errors that neighbours share, which σ does not \
                 include; state σ if they are errors",
                set.sensors[channel.sensor].name,
                lengths.text(shared.sigma),
                lengths.text(shared.radius),
                lengths.text(factor.sqrt())
            );
            (shared.sigma > MAX_OVERSTATEMENT * factor.sqrt())
                .then(|| Finding::new(FindingCode::SharedErrors, text))
        })
        .collect()
}

/// What follows from residuals that are clearly smaller than a stated σ that is kept.
fn smaller_residuals(sensor: &SensorReport) -> Option<Finding> {
    let stated = sensor.sigma_stated.filter(|_| !sensor.sigma_used_is_estimated)?;
    let found = sensor.sigma_estimated;
    let (code, consequence) = if sensor.sigma_shared.is_some() {
        (
            FindingCode::SharedErrors,
            "neighbouring readings seem to share their errors, as those of a smoothed scan do, so means over \
             them are not more certain than one reading",
        )
    } else if stated > STATED_SIGMA_TOLERANCE * found {
        (FindingCode::SensorSigmaCautious, "the stated σ is kept")
    } else {
        return None;
    };
    let text = format!(
        "sensor {:?} states σ = {stated:.3e}, but its residuals indicate only {found:.3e}: {consequence}",
        sensor.name
    );
    Some(Finding::new(code, text).with_setting(Setting::EstimateSigma))
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

/// σ of a sensor with the unit of its quantity.
fn sigma_text(sensor: &SensorReport, sigma: f64, unit: Unit) -> String {
    if sensor.quantity == Quantity::Normal.name() {
        format!("{}°", significant(sigma, 3))
    } else if sensor.quantity == Quantity::Curvature.name() {
        format!("{} 1/{unit}", significant(sigma, 3))
    } else {
        // One unit for the stated and the estimated σ, so that they can be compared.
        SmallUnit::for_length(unit.name(), sensor.sigma_estimated).text(sigma)
    }
}

/// Findings that every kind of fit has; `total` counts readings before any rejection.
pub(in crate::fit) fn common_findings(
    sensors: &[SensorReport],
    unit: Unit,
    observed: f64,
    inferred: f64,
    rejected: &BTreeMap<String, usize>,
    total: usize,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    // Points of unwanted classes are no readings of this surface: they count neither as rejected nor in the
    // total.
    let gated = rejected_readings(rejected);
    let wanted = total - (rejected.values().sum::<usize>() - gated);
    let many_rejected = gated * 10 > wanted;
    for sensor in sensors {
        let sigma = |value| sigma_text(sensor, value, unit);
        if let (Some(stated), true) = (sensor.sigma_stated, sensor.sigma_used_is_estimated) {
            // Residuals do not distinguish gross errors near the surface from errors of the sensor.
            let (code, cause) = if many_rejected {
                let cause = format!(
                    ", for which the {} % of gross errors may be the cause",
                    significant(100.0 * gated as f64 / wanted as f64, 2)
                );
                (FindingCode::LargerResiduals, cause)
            } else {
                (FindingCode::SensorSigmaMisstated, String::new())
            };
            let text = format!(
                "sensor {:?} states σ = {}, but its residuals indicate {}{cause}: the estimate is used",
                sensor.name,
                sigma(stated),
                sigma(sensor.sigma_estimated)
            );
            findings.push(Finding::new(code, text));
        }
        findings.extend(smaller_residuals(sensor));
    }
    if observed < 0.5 {
        let completed = if inferred > 0.0 {
            format!(", {:.0} % was completed from measurements elsewhere", 100.0 * inferred)
        } else {
            String::new()
        };
        let text = format!(
            "only {:.0} % of the surface was measured{completed}: the rest follows from the smoothness prior",
            100.0 * observed
        );
        findings.push(Finding::new(FindingCode::MostlyUnmeasured, text));
    }
    let not_finite = rejected.get(RejectionCause::NotFinite.name()).copied().unwrap_or(0);
    if not_finite > 0 {
        let text =
            format!("{not_finite} of {total} points have coordinates that are not finite: they were ignored");
        findings.push(Finding::new(FindingCode::PointsNotFinite, text));
    }
    let turned = rejected.get(RejectionCause::NormalMismatch.name()).copied().unwrap_or(0);
    if turned * 50 > total {
        let text = format!(
            "the normals of {turned} of {total} readings disagree with the surface near them: it lacks \
             folds or thin parts there, or the normals are wrong; σ does not include this"
        );
        findings.push(Finding::new(FindingCode::NormalsMismatch, text));
    }
    if many_rejected {
        findings.push(Finding::new(
            FindingCode::ManyRejected,
            format!("{gated} of {wanted} readings were rejected: see `rejected`"),
        ));
    }
    findings
}
