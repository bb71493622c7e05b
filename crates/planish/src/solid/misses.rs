//! Near misses in a drawing: line ends that almost meet, and views whose sizes almost agree. They are
//! reported if no solid was found.

use super::nearby_curves::NearbyCurves;
use planish_core::{Finding, FindingCode, Setting};
use planish_solid::views::{Curve2, Drawing, LineStyle, distance, nearest_on_curve};
use std::path::PathBuf;

/// Maximum difference of a near miss, relative to the drawing's size. Larger differences are taken as
/// intended.
const NEAR_MISS_RATIO: f64 = 2e-3;

/// Distance within which coordinates are treated as equal: the rounding of six digits in files.
fn rounding(drawing: &Drawing) -> f64 {
    1e-6 * drawing.size()
}

fn file(paths: &[PathBuf], view: usize) -> String {
    paths
        .get(view.min(paths.len().saturating_sub(1)))
        .map_or_else(String::new, |path| path.display().to_string())
}

fn inexact(text: String) -> Finding {
    Finding::new(FindingCode::DrawingInexact, text).with_setting(Setting::Tolerance)
}

/// Views that share an axis and span it nearly, but not quite, the same: scales that differ by a thousandth,
/// or an outline that is a little too long.
pub(super) fn nearly_equal_extents(drawing: &Drawing, paths: &[PathBuf]) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut seen: [Option<(f64, usize)>; 3] = [None; 3];
    for (index, view) in drawing.views.iter().enumerate() {
        for k in 0..2 {
            let axis = view.kind.axes()[k];
            let sides = view.curves.iter().map(|c| c.curve.bounds()[k]);
            let [lo, hi] = sides.fold([f64::MAX, f64::MIN], |[lo, hi], s| [lo.min(s[0]), hi.max(s[1])]);
            let size = hi - lo;
            // Each later view is compared with the first one that has the axis.
            let Some((first, other)) = seen[axis] else {
                seen[axis] = Some((size, index));
                continue;
            };
            let off = (size - first).abs();
            // Equal but for rounding is no reason for a failure, and a larger difference is an error already.
            if off > rounding(drawing) && off <= NEAR_MISS_RATIO * drawing.size() {
                let text = format!(
                    "{}: expected one scale, found an extent of the {} view of {size:.6} along {}, and of \
                     the {} view ({}) of {first:.6} (ratio {:.6}); a tolerance of {:.1e} makes them equal",
                    file(paths, index),
                    view.kind.name(),
                    ["x", "y", "z"][axis],
                    drawing.views[other].kind.name(),
                    file(paths, other),
                    size / first,
                    // A tenth more, so that the tolerance still joins them after rounding to two digits.
                    1.1 * off
                );
                found.push(inexact(text));
            }
        }
    }
    found
}

/// Ends of visible lines that almost meet another line.
pub(super) fn nearly_meeting_ends(drawing: &Drawing, paths: &[PathBuf]) -> Vec<Finding> {
    let (same, nearly) = (rounding(drawing), NEAR_MISS_RATIO * drawing.size());
    let mut found = Vec::new();
    for (index, view) in drawing.views.iter().enumerate() {
        let is_closed = |curve: &Curve2| {
            let points = curve.points();
            distance(points[0], points[points.len() - 1]) <= same
        };
        let Some(nearby) = NearbyCurves::new(view, nearly) else { continue };
        for (k, drawn) in view.curves.iter().enumerate() {
            // Hidden lines end behind others, and closed curves have no ends.
            if drawn.style != LineStyle::Visible || is_closed(&drawn.curve) {
                continue;
            }
            let points = drawn.curve.points();
            for end in [points[0], points[points.len() - 1]] {
                let Some(others) = nearby.around(end, k) else { return found };
                let nearest = (others.into_iter().map(|other| &view.curves[other]))
                    .map(|other| (nearest_on_curve(&other.curve, end), &other.entity))
                    .map(|(at, entity)| (distance(at, end), at, entity))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                if let Some((off, at, entity)) = nearest
                    && off > same
                    && off <= nearly
                {
                    let text = format!(
                        "{}: {} of the {} view ends at {:.6} {:.6}, {off:.1e} from {entity} at {:.6} {:.6}: \
                         a tolerance of {:.1e} joins them",
                        file(paths, index),
                        drawn.entity,
                        view.kind.name(),
                        end[0],
                        end[1],
                        at[0],
                        at[1],
                        1.1 * off
                    );
                    found.push(inexact(text));
                }
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_solid::views::{DrawnCurve, View, ViewKind};

    fn rectangle(kind: ViewKind, [w, h]: [f64; 2], gap: f64) -> View {
        let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
        let side = |k: usize| {
            let mut to = corners[(k + 1) % 4];
            if k == 0 {
                to[0] -= gap;
            }
            DrawnCurve {
                curve: Curve2::Segment(corners[k], to),
                style: LineStyle::Visible,
                entity: format!("LINE {k}"),
            }
        };
        View::new(kind, (0..4).map(side).collect())
    }

    #[test]
    fn nearly_equal_sizes_and_ends_are_reported_with_a_sufficient_tolerance() {
        let paths = ["front.dxf", "top.dxf"].map(PathBuf::from);
        let open = Drawing {
            views: vec![
                rectangle(ViewKind::Front, [40.0, 20.0], 1e-3),
                rectangle(ViewKind::Top, [40.0, 30.0], 0.0),
            ],
        };
        let message = nearly_meeting_ends(&open, &paths);
        assert_eq!(
            message[0].text,
            "front.dxf: LINE 0 of the front view ends at 39.999000 0.000000, 1.0e-3 from LINE 1 at \
             40.000000 0.000000: a tolerance of 1.1e-3 joins them"
        );
        let scaled = Drawing {
            views: vec![
                rectangle(ViewKind::Front, [40.0, 20.0], 0.0),
                rectangle(ViewKind::Top, [40.04, 30.0], 0.0),
            ],
        };
        let message = nearly_equal_extents(&scaled, &paths);
        assert_eq!(
            message.iter().map(|finding| finding.text.as_str()).collect::<Vec<_>>(),
            ["top.dxf: expected one scale, found an extent of the top view of 40.040000 along x, and of \
                 the front view (front.dxf) of 40.000000 (ratio 1.001000); a tolerance of 4.4e-2 makes \
                 them equal"]
        );
        let fits = Drawing {
            views: vec![
                rectangle(ViewKind::Front, [40.0, 20.0], 0.0),
                rectangle(ViewKind::Top, [40.0, 30.0], 0.0),
            ],
        };
        assert!(
            nearly_meeting_ends(&fits, &paths).is_empty() && nearly_equal_extents(&fits, &paths).is_empty()
        );
    }
}
