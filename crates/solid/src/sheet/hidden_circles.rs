//! Candidates for circles that views without hidden lines do not draw.

use super::axes::circles_across;
use crate::drawing::{Curve2, Drawing, DrawnCurve, View, ViewContent, distance, nearest_on_curve};

/// Distance within which lines are equal, relative to the size of the drawing.
const ACCURACY: f64 = 1e-5;
/// Distance within which a candidate is a drawn curve, in distances of equal lines.
const COINCIDENT: f64 = 10.0;
/// Maximum number of candidates of a drawing. Each divides the cells of the search further.
const MAX_CIRCLES: usize = 8;

/// Views with circles that may be behind a view without hidden lines, as candidates; none if there are many.
///
/// Pairs of lines of equal widths and ends in the two other views are a cylinder or a square bar. If the view
/// along it draws neither the circle nor the square, something hides it. A cylinder has fewer faces.
///
/// ```
/// use planish_solid::drawing::Drawing;
/// use planish_solid::sheet::hidden_circles;
///
/// assert!(hidden_circles(&Drawing::default()).is_empty());
/// ```
#[must_use]
pub fn hidden_circles(drawing: &Drawing) -> Vec<View> {
    let near = ACCURACY * drawing.size();
    let mut found = Vec::new();
    for view in drawing.views.iter().filter(|view| view.content == ViewContent::VisibleEdges) {
        let mut curves = circles_across(drawing, view.kind, near);
        curves.retain(|candidate| !is_drawn(view, candidate, COINCIDENT * near));
        if !curves.is_empty() {
            found.push(View { kind: view.kind, curves, content: ViewContent::Candidates });
        }
    }
    match found.iter().map(|view| view.curves.len()).sum::<usize>() > MAX_CIRCLES {
        true => Vec::new(),
        false => found,
    }
}

/// Whether a view draws a circle, or at least three sides of the square around it.
fn is_drawn(view: &View, circle: &DrawnCurve, near: f64) -> bool {
    let Curve2::Arc { center, radius, .. } = circle.curve else { return false };
    let is_on = |p: [f64; 2], is_used: &dyn Fn(&Curve2) -> bool| {
        let mut curves = view.curves.iter().map(|drawn| &drawn.curve).filter(|curve| is_used(curve));
        curves.any(|curve| distance(nearest_on_curve(curve, p), p) <= near)
    };
    // Beside the middles of the sides, which are points of the circle, too.
    let sides = [[1.0, 0.3], [-1.0, 0.3], [0.3, 1.0], [0.3, -1.0]];
    let sides = sides.map(|side| [0, 1].map(|k| center[k] + radius * side[k]));
    let is_segment = |curve: &Curve2| matches!(curve, Curve2::Segment(..));
    circle.curve.points().iter().all(|p| is_on(*p, &|_| true))
        || sides.iter().filter(|p| is_on(**p, &is_segment)).count() >= 3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::{LineStyle, ViewKind};

    fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<DrawnCurve> {
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        let side = |k: usize| Curve2::Segment(corners[k], corners[(k + 1) % 4]);
        let drawn = |curve| DrawnCurve { curve, style: LineStyle::Visible, entity: "side".to_owned() };
        (0..4).map(|k| drawn(side(k))).collect()
    }

    #[test]
    fn boss_below_a_plate_may_be_round_and_a_square_one_above_it_is_not() {
        // A plate of 40 × 30 with a boss of 10 below it, seen from the front, above and the side.
        let bossed = |width: f64, at: f64| {
            let mut curves = rectangle([0.0, 0.0], [width, 5.0]);
            curves.extend(rectangle([at, -8.0], [at + 10.0, 0.0]));
            curves
        };
        let views = [
            (ViewKind::Front, bossed(40.0, 12.0)),
            (ViewKind::Top, rectangle([0.0, 0.0], [40.0, 30.0])),
            (ViewKind::Side, bossed(30.0, 9.0)),
        ];
        let view = |(kind, curves)| View { kind, curves, content: ViewContent::VisibleEdges };
        let mut drawing = Drawing { views: views.map(view).to_vec() };
        let has_circle = |drawing: &Drawing| {
            let mut curves = hidden_circles(drawing).into_iter().flat_map(|view| view.curves);
            let is_boss = |drawn: DrawnCurve| match drawn.curve {
                Curve2::Arc { center, radius, .. } => center == [17.0, 14.0] && radius == 5.0,
                _ => false,
            };
            curves.any(is_boss)
        };
        assert!(has_circle(&drawing));
        drawing.views[1].curves.extend(rectangle([12.0, 9.0], [22.0, 19.0]));
        assert!(!has_circle(&drawing));
    }
}
