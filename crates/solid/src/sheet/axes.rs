//! Candidates for what is round about an axis along which no view looks.
//!
//! Two views across an axis show a cylinder and a square bar of the same width in the same way. Drawings say
//! which one it is by a centre line, or by a diameter. Where both views have a centre line, and lines at one
//! distance on both sides of it, a circle is a candidate.

use super::choice::Choice;
use super::{SheetReader, into_part};
use crate::drawing::{Curve2, DrawnCurve, LineStyle, View, ViewContent, ViewKind};
use std::f64::consts::TAU;

/// Maximum number of candidates; with more, positions of equal holes cannot be told apart.
const MAX_CIRCLES: usize = 40;

/// An axis in a view: its coordinate across, and the distances of lines on both sides.
struct Axis {
    at: f64,
    radii: Vec<f64>,
}

impl SheetReader<'_> {
    /// A view of candidate circles along the axis that no view shows; none if there are no candidates.
    pub(super) fn candidates(&self, choice: &Choice, views: &[View], origins: &[[f64; 2]]) -> Option<View> {
        let is_whole = |kind: ViewKind| {
            views.iter().any(|view| view.section().is_none() && view.kind.axes()[2] == kind.axes()[2])
        };
        let kind = ViewKind::ALL.into_iter().find(|kind| !is_whole(*kind))?;
        let [right, up, along] = kind.axes();
        let [first, second] = [right, up].map(|across| {
            (0..views.len())
                .filter(|v| views[*v].kind.axes()[2] != along && views[*v].kind.axes()[..2].contains(&across))
                .flat_map(|v| self.axes_in(choice, views, origins, v, across))
                .collect::<Vec<Axis>>()
        });
        let mut curves: Vec<DrawnCurve> = Vec::new();
        for (a, b) in first.iter().flat_map(|a| second.iter().map(move |b| (a, b))) {
            for radius in &a.radii {
                let is_same = |other: &f64| (other - radius).abs() <= self.near;
                let is_known = |drawn: &DrawnCurve| match &drawn.curve {
                    Curve2::Arc { center, radius: known, .. } => {
                        [center[0] - a.at, center[1] - b.at, known - radius]
                            .iter()
                            .all(|d| d.abs() <= self.near)
                    }
                    _ => false,
                };
                if b.radii.iter().any(is_same) && !curves.iter().any(is_known) {
                    curves.push(DrawnCurve {
                        curve: Curve2::Arc { center: [a.at, b.at], radius: *radius, start: 0.0, sweep: TAU },
                        style: LineStyle::Visible,
                        entity: "candidate circle".to_owned(),
                    });
                }
            }
        }
        let is_few = !curves.is_empty() && curves.len() <= MAX_CIRCLES;
        is_few.then_some(View { kind, curves, content: ViewContent::Candidates })
    }

    /// Centre lines of a view across an axis of the part, with the lines on both sides.
    fn axes_in(
        &self,
        choice: &Choice,
        views: &[View],
        origins: &[[f64; 2]],
        v: usize,
        across: usize,
    ) -> Vec<Axis> {
        let view = &views[v];
        let k = usize::from(view.kind.axes()[1] == across);
        let to_part = into_part(view.kind, origins[v]);
        let bounds = choice.views[v].1.bounds;
        let mut levels: Vec<f64> = Vec::new();
        for drawn in &view.curves {
            if let Curve2::Segment(a, b) = &drawn.curve
                && (a[k] - b[k]).abs() <= self.near
            {
                levels.push((a[k] + b[k]) / 2.0);
            }
        }
        levels.sort_by(f64::total_cmp);
        levels.dedup_by(|b, a| (*b - *a).abs() <= self.near);
        let mut found: Vec<Axis> = Vec::new();
        for line in &self.annotations.centre_lines {
            let middle = [0, 1].map(|c| (line[0][c] + line[1][c]) / 2.0);
            let is_in = (0..2).all(|c| middle[c] >= bounds[c][0] && middle[c] <= bounds[c][1]);
            let [a, b] = [to_part(line[0]), to_part(line[1])];
            if !is_in || (a[k] - b[k]).abs() > self.near {
                continue;
            }
            let own = (a[k] + b[k]) / 2.0;
            if found.iter().any(|axis| (axis.at - own).abs() <= self.near) {
                continue;
            }
            let above = levels.iter().filter(|l| **l > own + self.near);
            let has_mirror = |l: &&f64| levels.iter().any(|m| (m + **l - 2.0 * own).abs() <= 2.0 * self.near);
            let radii: Vec<f64> = above.filter(has_mirror).map(|l| l - own).collect();
            if !radii.is_empty() {
                found.push(Axis { at: own, radii });
            }
        }
        found
    }
}
