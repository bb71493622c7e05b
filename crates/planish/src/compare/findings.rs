//! Judgement of a comparison: whether σ of the model is consistent, and whether deviations have one sign.

use super::ComparisonReport;
use crate::report::words::SmallUnit;
use planish_core::{Finding, FindingCode};
use planish_report::numbers::percent;

/// Coverage of 1.96 σ that counts as consistent; 95 % is expected. The errors of neighbouring points are
/// correlated, so the coverage of a correct σ scatters more than the number of points suggests. The test
/// `filters` keeps both filters within this band.
const CONSISTENT_COVERAGE: [f64; 2] = [0.92, 0.985];
/// Maximum mean deviation relative to the rms. Beyond it, most deviations have one sign, as with shifted
/// frames.
const MAX_BIAS: f64 = 0.5;
/// Coverage of 1.96 σ below which σ is not merely optimistic but useless. Stated in `docs/reports.md`.
const MIN_USABLE_COVERAGE: f64 = 0.7;

/// The findings that follow from the figures of a report.
pub(super) fn judge(report: &ComparisonReport) -> Vec<Finding> {
    let mut found = Vec::new();
    if let Some(share) = report.coverage95 {
        let text = format!("{} of the reference points lie within 1.96 σ", percent(share));
        found.push(if share < CONSISTENT_COVERAGE[0] {
            let code = if share < MIN_USABLE_COVERAGE {
                FindingCode::CoverageVeryLow
            } else {
                FindingCode::CoverageLow
            };
            Finding::new(code, format!("σ is too small: only {text} (expected: 95 %)"))
        } else if share > CONSISTENT_COVERAGE[1] {
            Finding::new(FindingCode::CoverageHigh, format!("σ is too large: {text} (expected: 95 %)"))
        } else {
            Finding::new(FindingCode::CoverageConsistent, format!("σ is consistent: {text} (expected: 95 %)"))
        });
    } else {
        found.push(Finding::new(
            FindingCode::ModelWithoutSigma,
            "the model has no σ: its uncertainty cannot be checked",
        ));
    }
    // Backward first: it exists for clouds, too, and its feet on a spline are exact.
    if let Some(d) = report.backward.or(report.forward)
        && d.mean.abs() > MAX_BIAS * d.rms
    {
        let unit = SmallUnit::for_length(report.unit.name(), d.rms);
        found.push(Finding::new(
            FindingCode::DeviationsBiased,
            format!(
                "most deviations have one sign: {} on average; the frames or the scales of the two may \
                 differ",
                unit.text(d.mean)
            ),
        ));
    }
    found
}
