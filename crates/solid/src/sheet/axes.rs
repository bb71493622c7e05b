//! Candidates for what is round about an axis along which no view looks.
//!
//! Two views across an axis show a cylinder and a square bar of the same width in the same way. Drawings say
//! which one it is by a centre line or by a diameter. Input: pairs of lines at one distance on both sides of
//! a middle, in each view across the axis, with the evidence that they belong to something round. Output:
//! circles for the pairs of both views that agree.
//!
//! Without centre lines, pairs of equal hidden lines in both views are holes: drilled ones are common, square
//! ones are not. Outlines of equal widths stay open ([`SheetReading::open_widths`](super::SheetReading)).

use super::choice::Choice;
use super::{SheetReader, into_part};
use crate::drawing::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewContent, ViewKind};
use std::f64::consts::TAU;

/// Maximum number of candidates; with more, positions of equal holes cannot be told apart.
const MAX_CIRCLES: usize = 40;

/// Evidence that a pair of lines belongs to something round, the best last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Evidence {
    /// Visible lines of equal extents.
    Outlines,
    /// Hidden lines of equal extents.
    HiddenLines,
    /// A centre line in the middle.
    CentreLine,
    /// A dimension that states a diameter.
    Diameter,
}

/// Lines on both sides of a middle, in a view across an axis.
struct LinePair {
    middle: f64,
    radius: f64,
    evidence: Evidence,
    /// Ends along the axis, of lines of equal extents.
    extent: Option<[f64; 2]>,
}

/// What two views leave open.
pub(super) struct RoundCandidates {
    /// Circles along the line of sight that no view has.
    pub view: Option<View>,
    /// Whether outlines of equal widths in both views may be round or flat, and nothing shows which.
    pub are_open: bool,
}

impl SheetReader<'_> {
    /// Candidates along the axis that no view shows; none if each axis has a view.
    pub(super) fn candidates(
        &self,
        choice: &Choice,
        views: &[View],
        origins: &[[f64; 2]],
    ) -> Option<RoundCandidates> {
        let is_whole = |kind: ViewKind| {
            views.iter().any(|view| view.section().is_none() && view.kind.axes()[2] == kind.axes()[2])
        };
        let kind = ViewKind::ALL.into_iter().find(|kind| !is_whole(*kind))?;
        let [right, up, along] = kind.axes();
        let [first, second] = [right, up].map(|across| {
            (0..views.len())
                .filter(|v| views[*v].kind.axes()[2] != along && views[*v].kind.axes()[..2].contains(&across))
                .flat_map(|v| self.pairs_in(choice, views, origins, v, across))
                .collect::<Vec<LinePair>>()
        });
        let mut curves: Vec<DrawnCurve> = Vec::new();
        let mut are_open = false;
        for (a, b) in first.iter().flat_map(|a| second.iter().map(move |b| (a, b))) {
            if (a.radius - b.radius).abs() > self.near {
                continue;
            }
            if !self.are_round(a, b) {
                are_open |= have_equal_extents(a, b, self.near);
                continue;
            }
            add_circle(&mut curves, [a.middle, b.middle], a.radius, self.near);
        }
        // Where centre lines are drawn, what has none is flat.
        let has_centre_lines = first.iter().chain(&second).any(|pair| pair.evidence >= Evidence::CentreLine);
        let is_few = !curves.is_empty() && curves.len() <= MAX_CIRCLES;
        Some(RoundCandidates {
            view: is_few.then_some(View { kind, curves, content: ViewContent::Candidates }),
            are_open: are_open && !has_centre_lines,
        })
    }

    /// Whether two pairs of equal widths belong to something round.
    fn are_round(&self, a: &LinePair, b: &LinePair) -> bool {
        let weaker = a.evidence.min(b.evidence);
        a.evidence.max(b.evidence) == Evidence::Diameter
            || weaker >= Evidence::CentreLine
            || weaker == Evidence::HiddenLines && have_equal_extents(a, b, self.near)
    }

    /// Pairs of lines of a view across an axis of the part, with their evidence.
    fn pairs_in(
        &self,
        choice: &Choice,
        views: &[View],
        origins: &[[f64; 2]],
        v: usize,
        across: usize,
    ) -> Vec<LinePair> {
        let view = &views[v];
        let k = usize::from(view.kind.axes()[1] == across);
        let to_part = into_part(view.kind, origins[v]);
        let bounds = choice.views[v].1.bounds;
        let is_in = |p: [f64; 2]| {
            (0..2).all(|c| p[c] >= bounds[c][0] - self.near && p[c] <= bounds[c][1] + self.near)
        };
        let mut found = pairs_of_extents(view, k, self.near);
        let levels = self.levels_of_profiles(view, k);
        for line in &self.annotations.centre_lines {
            let middle = [0, 1].map(|c| (line[0][c] + line[1][c]) / 2.0);
            let [a, b] = line.map(&to_part);
            if !is_in(middle) || (a[k] - b[k]).abs() > self.near {
                continue;
            }
            let own = (a[k] + b[k]) / 2.0;
            let has_mirror = |l: &&f64| levels.iter().any(|m| (m + **l - 2.0 * own).abs() <= 2.0 * self.near);
            for level in levels.iter().filter(|l| **l > own + self.near).filter(has_mirror) {
                let evidence = Evidence::CentreLine;
                found.push(LinePair { middle: own, radius: level - own, evidence, extent: None });
            }
        }
        for ends in &self.annotations.diameters {
            let [a, b] = ends.map(&to_part);
            let is_across = (a[1 - k] - b[1 - k]).abs() <= self.near;
            // One end may be beside the view, on an extension line.
            let is_beside =
                |p: [f64; 2]| p[k] >= bounds[k][0] - self.near && p[k] <= bounds[k][1] + self.near;
            if is_across && ends.iter().all(|p| is_beside(*p)) && ends.iter().any(|p| is_in(*p)) {
                let (middle, radius) = ((a[k] + b[k]) / 2.0, (a[k] - b[k]).abs() / 2.0);
                found.push(LinePair { middle, radius, evidence: Evidence::Diameter, extent: None });
            }
        }
        found
    }

    /// Coordinates across an axis of lines along it, and of ends of slanted lines.
    fn levels_of_profiles(&self, view: &View, k: usize) -> Vec<f64> {
        let mut levels: Vec<f64> = Vec::new();
        for drawn in &view.curves {
            if let Curve2::Segment(a, b) = &drawn.curve {
                match [0, 1].map(|c| (a[c] - b[c]).abs() <= self.near) {
                    across if across[k] => levels.push((a[k] + b[k]) / 2.0),
                    across if !across[1 - k] => levels.extend([a[k], b[k]]),
                    _ => {}
                }
            }
        }
        levels.sort_by(f64::total_cmp);
        levels.dedup_by(|b, a| (*b - *a).abs() <= self.near);
        levels
    }
}

/// Neighbouring lines with the same ends along an axis: parallel to it, or slanted and mirrored. Slanted
/// ones make a pair for each end.
fn pairs_of_extents(view: &View, k: usize, accuracy: f64) -> Vec<LinePair> {
    // The ends along the axis, ascending, and the coordinates across it at these ends.
    let mut lines: Vec<([f64; 2], [f64; 2], LineStyle)> = Vec::new();
    for drawn in &view.curves {
        let Curve2::Segment(a, b) = &drawn.curve else { continue };
        let (a, b) = if a[1 - k] <= b[1 - k] { (a, b) } else { (b, a) };
        if b[1 - k] - a[1 - k] > accuracy {
            lines.push(([a[1 - k], b[1 - k]], [a[k], b[k]], drawn.style));
        }
    }
    lines.sort_by(|a, b| (a.1[0] + a.1[1]).total_cmp(&(b.1[0] + b.1[1])));
    let near = |a: f64, b: f64| (a - b).abs() <= 2.0 * accuracy;
    let mut found = Vec::new();
    for (index, (extent, own, style)) in lines.iter().enumerate() {
        // Mirrored about one middle at both ends.
        let is_mirrored = |(ends, other, also): &&([f64; 2], [f64; 2], LineStyle)| {
            also == style
                && (0..2).all(|e| near(ends[e], extent[e]))
                && near(other[0] + own[0], other[1] + own[1])
        };
        let Some((_, other, _)) = lines[index + 1..].iter().find(is_mirrored) else { continue };
        let evidence = match style {
            LineStyle::Hidden => Evidence::HiddenLines,
            LineStyle::Visible => Evidence::Outlines,
        };
        let mut radii = [0, 1].map(|e| (other[e] - own[e]) / 2.0).to_vec();
        radii.dedup_by(|b, a| near(*b, *a));
        for radius in radii.into_iter().filter(|r| r.abs() > accuracy) {
            let middle = (own[0] + other[0]) / 2.0;
            found.push(LinePair { middle, radius: radius.abs(), evidence, extent: Some(*extent) });
        }
    }
    found
}

/// Circles along the line of sight of a kind of view that pairs of lines of equal widths and ends in two
/// other views may show.
pub(crate) fn circles_across(drawing: &Drawing, kind: ViewKind, accuracy: f64) -> Vec<DrawnCurve> {
    let [right, up, along] = kind.axes();
    let [first, second] = [right, up].map(|across| {
        let views = drawing.views.iter().filter(|view| {
            view.is_compared() && view.kind.axes()[2] != along && view.kind.axes()[..2].contains(&across)
        });
        views
            .flat_map(|view| pairs_of_extents(view, usize::from(view.kind.axes()[1] == across), accuracy))
            .collect::<Vec<LinePair>>()
    });
    let mut curves: Vec<DrawnCurve> = Vec::new();
    for (a, b) in first.iter().flat_map(|a| second.iter().map(move |b| (a, b))) {
        if (a.radius - b.radius).abs() <= accuracy && have_equal_extents(a, b, accuracy) {
            add_circle(&mut curves, [a.middle, b.middle], a.radius, accuracy);
        }
    }
    curves.truncate(MAX_CIRCLES);
    curves
}

/// Adds a circle unless it is known.
fn add_circle(curves: &mut Vec<DrawnCurve>, center: [f64; 2], radius: f64, accuracy: f64) {
    let is_known = |drawn: &DrawnCurve| match &drawn.curve {
        Curve2::Arc { center: known, radius: r, .. } => {
            [known[0] - center[0], known[1] - center[1], r - radius].iter().all(|d| d.abs() <= accuracy)
        }
        _ => false,
    };
    if !curves.iter().any(is_known) {
        curves.push(DrawnCurve {
            curve: Curve2::Arc { center, radius, start: 0.0, sweep: TAU },
            style: LineStyle::Visible,
            entity: "candidate circle".to_owned(),
        });
    }
}

/// Whether two pairs have the same ends along the axis; true if either has no ends.
fn have_equal_extents(a: &LinePair, b: &LinePair, accuracy: f64) -> bool {
    match (a.extent, b.extent) {
        (Some(a), Some(b)) => (0..2).all(|e| (a[e] - b[e]).abs() <= accuracy),
        _ => true,
    }
}
