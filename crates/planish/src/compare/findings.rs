//! Judgement of a comparison: whether the deviations have a common offset, and whether σ of the model is
//! consistent.

use super::{CommonOffset, ComparisonReport};
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
    // The offset comes first: it explains deviations everywhere, and σ is judged with and without it.
    let offset = notable_offset(report);
    let mut found: Vec<Finding> = (offset.iter())
        .map(|offset| {
            let unit = SmallUnit::for_length(report.unit.name(), offset.value);
            Finding::new(FindingCode::CommonOffset, offset.text(unit))
        })
        .collect();
    if let Some(share) = report.coverage95 {
        let without = (offset.and(report.coverage95_without_offset))
            .map_or_else(String::new, |share| format!("; without the common offset, {}", percent(share)));
        let text = format!("{} of the reference points lie within 1.96 σ", percent(share));
        found.push(if share < CONSISTENT_COVERAGE[0] {
            let code = if share < MIN_USABLE_COVERAGE {
                FindingCode::CoverageVeryLow
            } else {
                FindingCode::CoverageLow
            };
            Finding::new(code, format!("σ is too small: only {text} (expected: 95 %){without}"))
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
    // Backward first: it exists for clouds, too, and its feet on a spline are exact. A mean that is no common
    // offset has other causes.
    if let Some(d) = report.backward.or(report.forward)
        && offset.is_none()
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

/// The common offset, if both directions show it.
///
/// The chord error of a coarse mesh is an offset in one direction only: its vertices lie on the surface, its
/// faces inside of it. The smaller offset of two is therefore reported.
fn notable_offset(report: &ComparisonReport) -> Option<CommonOffset> {
    let known = || [report.backward, report.forward].into_iter().flatten().filter_map(|d| d.offset);
    let smaller = known().min_by(|a, b| a.value.abs().total_cmp(&b.value.abs()))?;
    known()
        .all(|offset| offset.is_notable() && offset.value.signum() == smaller.value.signum())
        .then_some(smaller)
}
