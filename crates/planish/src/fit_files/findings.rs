//! Judgement of a fit: scans that do not fit the others, and whether σ agrees with held-out readings.

use crate::report::words::SmallUnit;
use planish_core::{Finding, FindingCode, Setting};
use planish_report::numbers::{counted, percent, significant};
use planish_surface::fit::{Fit, FitReport, FitTermination, FitVerdict, ScanSummary};

/// Maximum rms of a scan's residuals, in σ. A common σ of several scans is right only on average, so some
/// excess is normal. This and the following limits are stated in `docs/reports.md`.
const MAX_NORMALISED: f64 = 1.5;
/// Maximum mean residual of a scan, in σ of a reading. The mean of many readings is known far better, so
/// smaller shifts are significant, too. They matter little, because the noise hides them.
const MAX_MEAN_SIGMAS: f64 = 0.5;
/// Maximum difference of a scan from the others where they overlap, in σ of a reading. Where they do not, the
/// surface follows each of them, so it is wrong by as much.
const MAX_DIFFERENCE_SIGMAS: f64 = 0.5;
/// Maximum rejected share of a scan. A scan does not fit if its share is larger than this, and larger than
/// three times the share of all scans.
const MAX_REJECTED: f64 = 0.1;
/// Minimum number of readings for judging a scan. With 30, the rms has a relative σ of 13 %.
const MIN_JUDGED: usize = 30;
/// Largest ratio between predicted and observed σ of held-out readings that counts as consistent, apart from
/// chance. Intervals of 95 % cover 92.5 % of normal errors then.
const SIGMA_TOLERANCE: f64 = 1.1;
/// Standard errors of the ratio, `1/√(2n)` for `n` readings, that are added for chance.
const CHANCE: f64 = 3.0;

/// The findings that follow from the figures of a fit.
pub(super) fn judge(fit: &Fit, report: &FitReport) -> Vec<Finding> {
    // The unit of the page, so that findings and figures can be compared.
    let unit = SmallUnit::for_length(fit.model.unit.name(), report.rms.max(report.sigma.median));
    let scans = fit.readings.as_ref().map_or(&[][..], |readings| &readings.scans);
    let share = share_rejected(scans);
    let mut found: Vec<Finding> = scans.iter().filter_map(|scan| misfit(scan, share, unit)).collect();
    if found.is_empty() {
        found.extend(differences(scans, report.poses.iter().any(|pose| pose.moved.is_some()), unit));
    }
    let follows = found.is_empty() && report.verdict == FitVerdict::Converged && report.misfit.is_none();
    found.extend(held_out(report));
    if report.termination == FitTermination::Converged && follows {
        let text = "the fit converged: only noise remains in the residuals";
        found.push(Finding::new(FindingCode::Converged, text));
    }
    found
}

/// Whether σ agrees with the held-out readings.
fn held_out(report: &FitReport) -> Option<Finding> {
    let ratio = report.held_out.rms_normalised;
    let tolerance = SIGMA_TOLERANCE + CHANCE / (2.0 * report.held_out.n.max(1) as f64).sqrt();
    let (code, text) = match report.held_out.n {
        0 => return None,
        _ if ratio > tolerance => (
            FindingCode::SigmaTooSmall,
            format!("σ is too small: normalised rms of held-out readings is {}", significant(ratio, 3)),
        ),
        // The same factor in both directions: σ that is too large is wrong, too.
        _ if ratio < 1.0 / tolerance => (
            FindingCode::SigmaTooLarge,
            format!("σ is too large: normalised rms of held-out readings is {}", significant(ratio, 3)),
        ),
        n => (
            FindingCode::SigmaConsistent,
            format!(
                "σ is consistent: normalised rms of {} is {}",
                counted(n, "held-out reading"),
                significant(ratio, 3)
            ),
        ),
    };
    Some(Finding::new(code, text))
}

/// Whether a scan does not fit the others, and how that shows.
pub(super) fn misfit(scan: &ScanSummary, share_of_all: f64, unit: SmallUnit<'_>) -> Option<Finding> {
    let total = scan.used + scan.rejected;
    if total < MIN_JUDGED {
        return None;
    }
    // Rejections are tested first: they shift the mean and the rms of what remains.
    let share = scan.rejected as f64 / total as f64;
    // The mean σ of the scan's readings, which may differ in their own.
    let sigma = scan.rms / scan.rms_normalised.max(f64::MIN_POSITIVE);
    let name = &scan.name;
    if share > MAX_REJECTED && share > 3.0 * share_of_all {
        let text = format!(
            "scan {name} does not fit the others: {} of its readings were rejected, {} of all readings; \
             its pose or σ may be wrong, or those of neighbouring scans, or the object moved",
            percent(share),
            percent(share_of_all)
        );
        Some(Finding::new(FindingCode::ScanMisfit, text))
    } else if scan.mean.abs() > MAX_MEAN_SIGMAS * sigma {
        let text = format!(
            "scan {name} has a mean deviation of {} from the others ({} σ of a reading): its pose may be \
             wrong; align the scans to estimate it",
            unit.text(scan.mean),
            significant(scan.mean.abs() / sigma, 2)
        );
        Some(Finding::new(FindingCode::ScanMisfit, text).with_setting(Setting::Align))
    } else if scan.rms_normalised > MAX_NORMALISED {
        let times = significant(scan.rms_normalised, 2);
        let text = format!("scan {name} does not fit: its residuals are {times} times their σ");
        Some(Finding::new(FindingCode::ScanMisfit, text))
    } else {
        None
    }
}

/// Whether scans differ where they overlap.
fn differences(scans: &[ScanSummary], are_aligned: bool, unit: SmallUnit<'_>) -> Option<Finding> {
    let ratio = |scan: &ScanSummary| scan.difference.map_or(0.0, |d| d.rms / d.sigma);
    let off: Vec<&ScanSummary> = scans.iter().filter(|scan| ratio(scan) > MAX_DIFFERENCE_SIGMAS).collect();
    let largest = off.iter().max_by(|a, b| ratio(a).total_cmp(&ratio(b)))?;
    let advice = match are_aligned {
        true => "their poses were estimated, so the scans are distorted, or the object moved",
        false => "their poses may be wrong; align the scans to estimate them",
    };
    let text = format!(
        "{} of {} scans differ from the others where they overlap, most of all {} by {} ({} σ of a reading): \
         {advice}",
        off.len(),
        scans.len(),
        largest.name,
        unit.text(largest.difference.map_or(0.0, |d| d.rms)),
        significant(ratio(largest), 2),
    );
    let finding = Finding::new(FindingCode::ScanMisfit, text);
    Some(if are_aligned { finding } else { finding.with_setting(Setting::Align) })
}

/// The share of readings that were rejected.
pub(super) fn share_rejected(scans: &[ScanSummary]) -> f64 {
    let rejected: usize = scans.iter().map(|scan| scan.rejected).sum();
    let all: usize = rejected + scans.iter().map(|scan| scan.used).sum::<usize>();
    rejected as f64 / all.max(1) as f64
}
