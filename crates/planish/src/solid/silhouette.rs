//! The outer contour of a view: curves that lie beside what is outside of it.
//!
//! Curves are drawn into a grid, which is then filled from its border. A curve belongs to the contour if the
//! fill reaches most of its points. Gaps of less than two cells do not let the fill in.

use planish_solid::drawing::{DrawnCurve, LineStyle, View, distance};

/// Number of cells along the longer side of a view.
const CELLS: f64 = 256.0;
/// Cells of margin around the view.
const MARGIN: usize = 4;
/// Distance in cells within which the fill reaches a point.
const NEAR: isize = 3;
/// Minimum share of the points of a curve that the fill reaches.
const MIN_SHARE: f64 = 0.5;

/// The visible curves of the outer contour of a view.
pub(super) fn silhouette(view: &View) -> Vec<DrawnCurve> {
    let visible: Vec<&DrawnCurve> = view.curves.iter().filter(|c| c.style == LineStyle::Visible).collect();
    let bounds = visible.iter().map(|c| c.curve.bounds()).fold([[f64::MAX, f64::MIN]; 2], |all, b| {
        [0, 1].map(|k| [all[k][0].min(b[k][0]), all[k][1].max(b[k][1])])
    });
    let cell = bounds.iter().map(|r| r[1] - r[0]).fold(0.0, f64::max) / CELLS;
    if cell <= 0.0 || !cell.is_finite() {
        return Vec::new();
    }
    let size = bounds.map(|r| ((r[1] - r[0]) / cell) as usize + 1 + 2 * MARGIN);
    let place = |p: [f64; 2]| [0, 1].map(|k| ((p[k] - bounds[k][0]) / cell) as usize + MARGIN);
    let mut is_drawn = vec![false; size[0] * size[1]];
    let samples: Vec<Vec<[usize; 2]>> = visible
        .iter()
        .map(|c| points_along(&c.curve.points(), 0.5 * cell).into_iter().map(place).collect())
        .collect();
    for [x, y] in samples.iter().flatten() {
        for (dx, dy) in (0..3).flat_map(|dx| (0..3).map(move |dy| (dx, dy))) {
            is_drawn[(y + dy - 1) * size[0] + x + dx - 1] = true;
        }
    }
    let is_outside = filled_from_border(&is_drawn, size);
    let is_beside = |[x, y]: &[usize; 2]| {
        let around = (-NEAR..=NEAR).flat_map(|dx| (-NEAR..=NEAR).map(move |dy| (dx, dy)));
        around
            .into_iter()
            .any(|(dx, dy)| is_outside[y.saturating_add_signed(dy) * size[0] + x.saturating_add_signed(dx)])
    };
    let is_contour = |points: &Vec<[usize; 2]>| {
        let reached = points.iter().filter(|p| is_beside(p)).count();
        reached as f64 >= MIN_SHARE * points.len() as f64
    };
    let kept = visible.into_iter().zip(&samples).filter(|(_, points)| is_contour(points));
    kept.map(|(drawn, _)| drawn.clone()).collect()
}

/// Points along a polygon at most a step apart.
fn points_along(points: &[[f64; 2]], step: f64) -> Vec<[f64; 2]> {
    let mut found = Vec::new();
    for pair in points.windows(2) {
        let n = (distance(pair[0], pair[1]) / step).ceil().max(1.0) as usize;
        let at = |k: usize| [0, 1].map(|c| pair[0][c] + (pair[1][c] - pair[0][c]) * k as f64 / n as f64);
        found.extend((0..=n).map(at));
    }
    found
}

/// The cells that are connected to the first one without drawn cells between.
fn filled_from_border(is_drawn: &[bool], [columns, rows]: [usize; 2]) -> Vec<bool> {
    let mut is_filled = vec![false; is_drawn.len()];
    let mut open = vec![0_usize];
    is_filled[0] = true;
    while let Some(k) = open.pop() {
        let (x, y) = (k % columns, k / columns);
        let beside = [
            (x > 0).then(|| k - 1),
            (x + 1 < columns).then(|| k + 1),
            (y > 0).then(|| k - columns),
            (y + 1 < rows).then(|| k + columns),
        ];
        for other in beside.into_iter().flatten() {
            if !is_drawn[other] && !is_filled[other] {
                is_filled[other] = true;
                open.push(other);
            }
        }
    }
    is_filled
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_solid::drawing::{Curve2, ViewKind};

    #[test]
    fn lines_within_the_contour_are_left_out() {
        let line = |a: [f64; 2], b: [f64; 2], style| DrawnCurve {
            curve: Curve2::Segment(a, b),
            style,
            entity: format!("{a:?}"),
        };
        let corners = [[0.0, 0.0], [40.0, 0.0], [40.0, 10.0], [15.0, 10.0], [15.0, 20.0], [0.0, 20.0]];
        let mut curves: Vec<DrawnCurve> =
            (0..6).map(|k| line(corners[k], corners[(k + 1) % 6], LineStyle::Visible)).collect();
        curves.push(line([15.0, 10.0], [15.0, 0.0], LineStyle::Visible));
        curves.push(line([0.0, 20.0], [15.0, 20.0], LineStyle::Hidden));
        let kept = silhouette(&View::new(ViewKind::Front, curves.clone()));
        assert_eq!(kept, curves[..6]);
        assert!(silhouette(&View::new(ViewKind::Front, Vec::new())).is_empty());
    }
}
