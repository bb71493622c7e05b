//! Line styles by patterns of dashes and gaps.

use planish_solid::views::LineStyle;

/// Minimum ratio of the longest to the shortest dash of a centre line. Hidden lines have equal dashes; centre
/// lines alternate long dashes with dots. Guarded by `dashes_are_hidden_lines_and_dash_dots_centre_lines`.
const CENTRE_LINE_RATIO: f64 = 1.5;

/// Style of lines with dashes and gaps in turn; none for centre lines.
pub(crate) fn style_of_pattern(mut all: Vec<f64>) -> Option<LineStyle> {
    if all.iter().all(|x| *x <= 0.0) {
        return Some(LineStyle::Visible);
    }
    // A list of odd length is repeated, so that dashes and gaps alternate.
    if all.len() % 2 == 1 {
        all.extend(all.clone());
    }
    let dashes = all.iter().step_by(2);
    let (shortest, longest) = dashes.fold((f64::MAX, 0.0_f64), |(lo, hi), d| (lo.min(*d), hi.max(*d)));
    (longest <= CENTRE_LINE_RATIO * shortest).then_some(LineStyle::Hidden)
}
