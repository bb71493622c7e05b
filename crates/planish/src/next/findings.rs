//! Judgement of a plan: whether it reaches the goal, and what no reading improves.

use super::{NextReport, UnmeasurableSigma, ViewsReport};
use crate::report::words::SmallUnit;
use planish_core::{Finding, FindingCode, Setting};
use planish_exchange::Unit;
use planish_report::numbers::{count, counted, percent, significant};

/// Findings about planned points.
pub(super) fn judge_points(next: &NextReport, unit: Unit) -> Vec<Finding> {
    let mut found = Vec::new();
    match next.reached_goal {
        Some(true) => found.push(Finding::new(FindingCode::GoalReached, "the planned points reach the goal")),
        Some(false) => {
            let text = format!(
                "the goal is not reached with {} points: plan more, or measure with a smaller σ",
                next.points.len()
            );
            found.push(Finding::new(FindingCode::GoalNotReached, text).with_setting(Setting::Count));
        }
        None => {}
    }
    found.extend(next.unresolved_shape.map(|left| unresolved_shape(left, unit)));
    found
}

/// Findings about planned views, of which `wanted` were requested.
pub(super) fn judge_views(next: &ViewsReport, wanted: usize, unit: Unit) -> Vec<Finding> {
    let mut found = Vec::new();
    let planned = next.views.len();
    match next.reached_goal {
        Some(true) => found.push(Finding::new(FindingCode::GoalReached, "the planned views reach the goal")),
        Some(false) => {
            let text = format!(
                "the goal is not reached with {}: plan more, or use a more accurate sensor",
                counted(planned, "view")
            );
            found.push(Finding::new(FindingCode::GoalNotReached, text).with_setting(Setting::Views));
        }
        None => {}
    }
    // Fewer views than requested are no error: further views may have nothing to add.
    if planned < wanted && next.reached_goal != Some(true) {
        let text =
            format!("{} of {wanted} chosen: further views would not reduce σ", counted(planned, "view"));
        found.push(Finding::new(FindingCode::FewerViews, text));
    }
    found.extend(next.unresolved_shape.map(|left| unresolved_shape(left, unit)));
    if let Some(place) = next.worst_unseen.filter(|_| next.unseen > 0.0) {
        let text = format!(
            "{} of the area is visible from none of the {} candidate poses; its largest σ is {} at {}",
            percent(next.unseen),
            count(next.candidates),
            // The unit of the page, so that both figures can be compared.
            SmallUnit::for_length(unit.name(), next.worst_sigma.before).text(place.sigma),
            place.position.to_array().map(|c| significant(c, 4)).join(", ")
        );
        found.push(Finding::new(FindingCode::AreaUnseen, text));
    }
    found
}

/// Unresolved shape is the part of σ in `info` and `fit` that readings do not reduce.
fn unresolved_shape(left: UnmeasurableSigma, unit: Unit) -> Finding {
    let text = format!(
        "σ does not include unresolved shape of up to {2} {unit} on {0} of the area, because readings do \
         not reduce it; including it, the largest σ after the plan is {1} {unit}; fit again with a larger \
         maximum depth or more coefficients",
        percent(left.area_fraction),
        significant(left.worst_sigma_after, 3),
        significant(left.largest, 3)
    );
    Finding::new(FindingCode::UnresolvedShape, text)
        // Either limit may have stopped the refinement.
        .with_setting(Setting::MaxDepth)
        .with_setting(Setting::MaxCoefficients)
}
