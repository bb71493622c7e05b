//! Findings about the stated σ of patches, from the differences in their overlaps.
//!
//! Input: the tests of [`planish_mesh::SigmaCheck`]. Output: findings that name the patches. Not guaranteed:
//! with two patches, differences do not show which of them is wrong.

use super::MergeOptions;
use planish_core::{Finding, FindingCode, Setting};
use planish_exchange::Unit;
use planish_mesh::{Overlap, SigmaCheck, SigmaVerdict};
use planish_report::numbers::{percent, significant};

/// Share of the differences of a patch that a common displacement explains, above which it counts as
/// displaced. Independent errors explain a few percent.
const MIN_DISPLACED_SHARE: f64 = 0.5;
/// A patch is named as the wrong one if its factor is this many times that of every patch without a finding.
const MIN_CONTRAST: f64 = 1.5;

/// Findings about patches whose stated σ do not agree with the differences. `names` are in the order of the
/// overlap.
pub(super) fn sigma_findings(
    overlap: &Overlap,
    names: &[String],
    options: &MergeOptions,
    unit: Unit,
) -> Vec<Finding> {
    let with = |verdict: SigmaVerdict| -> Vec<(&String, SigmaCheck)> {
        (names.iter().zip(&overlap.patches))
            .filter_map(|(name, patch)| Some((name, patch.check.filter(|check| check.verdict == verdict)?)))
            .collect()
    };
    let (too_small, consistent) = (with(SigmaVerdict::TooSmall), with(SigmaVerdict::Consistent));
    let mut found: Vec<Finding> = (too_small.iter())
        .map(|(name, check)| {
            let stands_out = consistent.iter().all(|(_, other)| check.factor > MIN_CONTRAST * other.factor)
                && !consistent.is_empty();
            too_small_finding(name, *check, stands_out, options, unit)
        })
        .collect();
    found.extend(with(SigmaVerdict::Shared).into_iter().map(|(name, check)| {
        let kept = match options.believe_sigma {
            true => "the errors count as independent, as specified",
            false => "σ was not reduced by fusing",
        };
        let text = format!(
            "{name}: the differences from other patches are {} of what their σ predict: σ is too large, or \
             the patches share measurements; {kept}",
            percent(check.factor)
        );
        Finding::new(FindingCode::SharedErrors, text).with_setting(Setting::BelieveSigma)
    }));
    found
}

/// The finding about a patch whose σ is too small; `stands_out` if the other patches agree among themselves.
fn too_small_finding(
    name: &str,
    check: SigmaCheck,
    stands_out: bool,
    options: &MergeOptions,
    unit: Unit,
) -> Finding {
    let used = match options.believe_sigma {
        true => "the stated σ was used",
        false => "the estimate was used",
    };
    let times = significant(check.factor, 2);
    let wrong = match stands_out {
        true => ", while the other patches agree",
        false => "",
    };
    let shows = format!(
        "{name}: the differences from other patches indicate that its σ is {times} times the stated \
         value{wrong}"
    );
    if check.displaced_share > MIN_DISPLACED_SHARE {
        let text = format!(
            "{shows}: {} of the differences are a common displacement of {} {unit} (rms), by an error of its \
             pose or a bias; {used}",
            percent(check.displaced_share),
            significant(check.displacement, 2)
        );
        let finding = Finding::new(FindingCode::SensorSigmaMisstated, text);
        // What an alignment left is no reason to align again.
        let finding = match options.align {
            true => finding,
            false => finding.with_setting(Setting::Align),
        };
        return finding.with_setting(Setting::BelieveSigma);
    }
    let text =
        format!("{shows}: the stated σ is wrong, or the triangles are too large for the shape; {used}");
    Finding::new(FindingCode::SensorSigmaMisstated, text).with_setting(Setting::BelieveSigma)
}
