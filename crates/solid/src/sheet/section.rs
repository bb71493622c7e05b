//! Sections among the views: hatching lines, and where the cutting planes are.
//!
//! A cutting plane is marked in another view by a line across it, with arrowheads and equal letters at its
//! ends. Without such marks, lines of symmetry that cross a view are candidates, and the middle of the part.

use super::choice::Choice;
use super::groups::{CurveGroup, is_within};
use super::{SetAsideReason, SheetBox, SheetReader};
use crate::drawing::{Curve2, Hatch, LineStyle, ViewKind, distance, spacing_of};
use std::collections::BTreeMap;

/// Minimum number of equidistant parallel lines that are hatching.
const MIN_HATCHING: usize = 5;
/// Maximum deviation of hatching lines from equal distances, in distances.
const UNEVEN: f64 = 0.05;
/// Angles of hatching lines differ from those of the axes by at least this. Parts have parallel edges along
/// the axes, seldom several equidistant ones across.
const MIN_SLANT_DEG: f64 = 10.0;
/// Distance of arrowheads and letters from the ends of their line, relative to the size of all curves.
const MARK_REACH: f64 = 0.06;
/// Maximum number of cutting planes that are tried if no mark shows one.
const MAX_PLANES: usize = 3;

/// A possible cutting plane.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mark {
    /// On the sheet, along the axis across the plane.
    at: f64,
    /// Two if arrowheads are at both ends, one more if equal letters are.
    score: u32,
}

impl SheetReader<'_> {
    /// Sets aside equidistant parallel lines of one pen, which hatch a section.
    pub(super) fn set_aside_hatching(&mut self) {
        let mut families: BTreeMap<(u32, i64), Vec<usize>> = BTreeMap::new();
        for k in (0..self.curves.len()).filter(|k| self.is_left(*k)) {
            let Curve2::Segment(a, b) = &self.curves[k].curve else { continue };
            let angle = (b[1] - a[1]).atan2(b[0] - a[0]).to_degrees().rem_euclid(180.0);
            let slant = angle.rem_euclid(90.0);
            if self.curves[k].style == LineStyle::Visible
                && slant.min(90.0 - slant) > MIN_SLANT_DEG
                // Short lines have inaccurate directions; they join the family if they are near it.
                && distance(*a, *b) > 10.0 * self.near
            {
                families.entry((self.annotations.pen(k), angle.round() as i64)).or_default().push(k);
            }
        }
        for ((pen, angle), family) in families {
            let Some(levels) = self.levels_of(&family) else { continue };
            if family.len() < MIN_HATCHING || levels < MIN_HATCHING {
                continue;
            }
            let of_family = |k: &usize| {
                self.is_left(*k) && self.annotations.pen(*k) == pen && self.is_nearly_at(*k, angle as f64)
            };
            let lines: Vec<usize> = (0..self.curves.len()).filter(of_family).collect();
            for k in &lines {
                if let Curve2::Segment(a, b) = &self.curves[*k].curve {
                    self.hatching.push([*a, *b]);
                }
            }
            self.set_aside(lines, SetAsideReason::Hatching);
        }
    }

    /// Whether a curve is a straight line of a direction, within the accuracy of its ends.
    fn is_nearly_at(&self, curve: usize, angle_deg: f64) -> bool {
        let Curve2::Segment(a, b) = &self.curves[curve].curve else { return false };
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let across = ((b[0] - a[0]) * sin - (b[1] - a[1]) * cos).abs();
        across <= self.near + 0.02 * distance(*a, *b)
    }

    /// Number of different levels of parallel lines, if these are equidistant.
    fn levels_of(&self, family: &[usize]) -> Option<usize> {
        let ends = |k: usize| match &self.curves[k].curve {
            Curve2::Segment(a, b) => Some([*a, *b]),
            _ => None,
        };
        let longest = family
            .iter()
            .filter_map(|k| ends(*k))
            .max_by(|p, q| distance(p[0], p[1]).total_cmp(&distance(q[0], q[1])))?;
        let length = distance(longest[0], longest[1]);
        let normal = [longest[0][1] - longest[1][1], longest[1][0] - longest[0][0]].map(|c| c / length);
        let level = |p: [f64; 2]| p[0] * normal[0] + p[1] * normal[1];
        let mut levels: Vec<f64> =
            family.iter().filter_map(|k| ends(*k)).map(|[a, b]| (level(a) + level(b)) / 2.0).collect();
        levels.sort_by(f64::total_cmp);
        let spacing = spacing_of(&levels)?;
        let steps = |l: &f64| (l - levels[0]) / spacing;
        let is_even = levels.iter().all(|l| (steps(l) - steps(l).round()).abs() < UNEVEN * 2.0);
        let mut distinct: Vec<i64> = levels.iter().map(|l| steps(l).round() as i64).collect();
        distinct.dedup();
        is_even.then_some(distinct.len())
    }

    /// Whether a group is hatched.
    pub(super) fn is_section(&self, bounds: &SheetBox) -> bool {
        let is_in = |points: &[[f64; 2]]| {
            points.iter().all(|p| is_within(&[[p[0]; 2], [p[1]; 2]], bounds, self.near))
        };
        self.annotations.hatches.iter().any(|outline| is_in(outline))
            || self.hatching.iter().filter(|line| is_in(&line[..])).count() >= MIN_HATCHING
    }

    /// The hatches within a group, on the sheet.
    pub(super) fn hatch_of(&self, bounds: &SheetBox) -> Hatch {
        let is_in = |points: &[[f64; 2]]| {
            points.iter().all(|p| is_within(&[[p[0]; 2], [p[1]; 2]], bounds, self.near))
        };
        Hatch {
            outlines: self.annotations.hatches.iter().filter(|o| is_in(o)).cloned().collect(),
            lines: self.hatching.iter().filter(|line| is_in(&line[..])).copied().collect(),
        }
    }

    /// Possible cutting planes of a section, the most plausible first: the view that shows it edge-on (by its
    /// index), and its position on the sheet. Empty if no view does.
    pub(super) fn planes_of(&self, choice: &Choice, section: usize) -> Vec<(usize, f64)> {
        let (kind, group) = &choice.views[section];
        let sight = kind.axes()[2];
        let letter = self.letter_of(group);
        let mut marks: Vec<(usize, Mark)> = Vec::new();
        let mut middles: Vec<(usize, f64)> = Vec::new();
        for (index, (other, group)) in choice.views.iter().enumerate() {
            let Some(k) = (0..2).find(|k| other.axes()[*k] == sight) else { continue };
            marks.extend(self.marks_across(group, k, letter).into_iter().map(|mark| (index, mark)));
            middles.push((index, (group.bounds[k][0] + group.bounds[k][1]) / 2.0));
        }
        let best = marks.iter().map(|(_, mark)| mark.score).max().unwrap_or(0);
        if best > 0 {
            marks.retain(|(_, mark)| mark.score == best);
            return marks.into_iter().map(|(index, mark)| (index, mark.at)).take(MAX_PLANES).collect();
        }
        let mut planes = middles.clone();
        planes.truncate(1);
        // Lines of symmetry nearest to the middle first.
        let from_middle = |(index, mark): &(usize, Mark)| {
            middles.iter().find(|m| m.0 == *index).map_or(f64::MAX, |m| (mark.at - m.1).abs())
        };
        marks.sort_by(|a, b| from_middle(a).total_cmp(&from_middle(b)));
        planes.extend(marks.iter().map(|(index, mark)| (*index, mark.at)));
        planes.truncate(MAX_PLANES);
        planes
    }

    /// Lines across a view, from beyond one side to beyond the other.
    fn marks_across(&self, group: &CurveGroup, k: usize, letter: Option<char>) -> Vec<Mark> {
        let size = super::groups::size_of_boxes(&self.boxes);
        let drawn = (0..self.curves.len()).filter(|c| !self.is_left(*c)).filter_map(|c| {
            match &self.curves[c].curve {
                Curve2::Segment(a, b) => Some([*a, *b]),
                _ => None,
            }
        });
        let mut marks: Vec<Mark> = Vec::new();
        for [a, b] in self.annotations.centre_lines.iter().copied().chain(drawn) {
            let [side, along] = [group.bounds[k], group.bounds[1 - k]];
            let crosses = (a[k] - b[k]).abs() <= self.near
                && a[k] > side[0] + self.near
                && a[k] < side[1] - self.near
                && a[1 - k].min(b[1 - k]) < along[0]
                && a[1 - k].max(b[1 - k]) > along[1];
            if !crosses {
                continue;
            }
            let has_arrow = |end: [f64; 2]| {
                self.annotations
                    .arrowheads
                    .iter()
                    .flatten()
                    .any(|p| distance(*p, end) <= 0.5 * MARK_REACH * size)
            };
            let letters = |end: [f64; 2]| -> Vec<char> {
                let near = self.annotations.texts.iter().filter(|t| distance(t.at, end) <= MARK_REACH * size);
                near.filter_map(|t| single_letter(&t.text)).collect()
            };
            let (first, second) = (letters(a), letters(b));
            let common = first.iter().any(|c| second.contains(c) && letter.is_none_or(|own| own == *c));
            // Dimensions have arrowheads as well, but no letters, and centre lines have neither.
            let score = match (common, has_arrow(a) && has_arrow(b)) {
                (true, arrows) => 1 + u32::from(arrows),
                (false, _) => 0,
            };
            if !marks.iter().any(|mark| (mark.at - a[k]).abs() <= self.near && mark.score >= score) {
                marks.push(Mark { at: (a[k] + b[k]) / 2.0, score });
            }
        }
        marks
    }

    /// The letter of the name of a section beside it, as A in `A-A`.
    fn letter_of(&self, group: &CurveGroup) -> Option<char> {
        let size = super::groups::size_of_boxes(&self.boxes);
        let reach = MARK_REACH * size;
        let grown = group.bounds.map(|[lo, hi]| [lo - reach, hi + reach]);
        let beside =
            self.annotations.texts.iter().filter(|t| is_within(&[[t.at[0]; 2], [t.at[1]; 2]], &grown, 0.0));
        let named = beside.filter_map(|t| {
            let letters: Vec<char> = t.text.chars().filter(|c| !c.is_whitespace()).collect();
            let pair = letters.iter().rev().take(3).rev().copied().collect::<Vec<char>>();
            match pair[..] {
                [a, '-' | '–' | '—', b] if a == b && a.is_alphabetic() => Some(a),
                _ => None,
            }
        });
        named.min()
    }
}

fn single_letter(text: &str) -> Option<char> {
    let mut letters = text.trim().chars();
    letters.next().filter(|c| c.is_alphabetic() && letters.next().is_none())
}

impl SheetReader<'_> {
    /// The place on the sheet of the origin of a view: where the lower left corner of the whole part would
    /// be (the lower right one of views from the left, which are mirrored).
    ///
    /// A section may show less than the whole; then its place along an axis is that at which most of its
    /// coordinates are those of another view.
    pub(super) fn origin_of(&self, choice: &Choice, view: usize, near: f64) -> [f64; 2] {
        let (kind, group) = &choice.views[view];
        [0, 1].map(|k| {
            let axis = kind.axes()[k];
            let own = corner(*kind, group, k);
            let extent = group.extent(k);
            let shows = |(_, (other, g)): &(usize, &(ViewKind, CurveGroup))| {
                !g.is_section && other.axes()[..2].contains(&axis)
            };
            let mut others = choice.views.iter().enumerate().filter(|(other, _)| *other != view);
            let Some((_, (other, whole))) = others.find(shows).filter(|_| group.is_section) else {
                return own;
            };
            let l = usize::from(other.axes()[1] == axis);
            if (whole.extent(l) - extent).abs() <= near {
                return own;
            }
            let sign = |kind: ViewKind, k: usize| if k == 0 && kind == ViewKind::Left { -1.0 } else { 1.0 };
            let places = |kind: ViewKind, group: &CurveGroup, k: usize| -> Vec<f64> {
                let from = corner(kind, group, k);
                let bounds = group.curves.iter().flat_map(|c| self.boxes[*c][k]);
                bounds.map(|at| sign(kind, k) * (at - from)).collect()
            };
            let (seen, known) = (places(*kind, group, k), places(*other, whole, l));
            // The first and last coordinate of the section are those of edges in the other view as well.
            let shifts = known.iter().flat_map(|at| [*at, *at - extent]);
            let matches = |shift: f64| {
                let has = |at: &&f64| known.iter().any(|other| (other - shift - **at).abs() <= 0.1 * near);
                seen.iter().filter(has).count()
            };
            let best = shifts.max_by_key(|shift| matches(*shift)).unwrap_or(0.0);
            own - sign(*kind, k) * best
        })
    }
}

/// The corner of a group from which coordinates of a view are counted, along an axis of the sheet.
fn corner(kind: ViewKind, group: &CurveGroup, k: usize) -> f64 {
    group.bounds[k][usize::from(k == 0 && kind == ViewKind::Left)]
}
