use super::*;
use crate::drawing::Curve2;
use std::f64::consts::{PI, TAU};

fn segment(a: [f64; 2], b: [f64; 2], style: LineStyle) -> DrawnCurve {
    DrawnCurve { curve: Curve2::Segment(a, b), style, entity: format!("{style:?} line from {a:?} to {b:?}") }
}

fn outline(points: &[[f64; 2]]) -> Vec<DrawnCurve> {
    let next = |k: usize| points[(k + 1) % points.len()];
    (0..points.len()).map(|k| segment(points[k], next(k), LineStyle::Visible)).collect()
}

/// A block of 40 × 30 × 20 with a step of 15 × 30 × 12 at its right and a hole of 8 through the rest.
fn block() -> Drawing {
    let mut front = outline(&[[0.0, 0.0], [40.0, 0.0], [40.0, 8.0], [25.0, 8.0], [25.0, 20.0], [0.0, 20.0]]);
    front.extend([8.0, 16.0].map(|x| segment([x, 0.0], [x, 20.0], LineStyle::Hidden)));
    let mut top = outline(&[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]]);
    top.push(segment([25.0, 0.0], [25.0, 30.0], LineStyle::Visible));
    let curve = Curve2::Arc { center: [12.0, 10.0], radius: 4.0, start: 0.0, sweep: TAU };
    top.push(DrawnCurve { curve, style: LineStyle::Visible, entity: "circle".to_owned() });
    let mut side = outline(&[[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]]);
    side.push(segment([0.0, 8.0], [30.0, 8.0], LineStyle::Visible));
    side.extend([6.0, 14.0].map(|y| segment([y, 0.0], [y, 20.0], LineStyle::Hidden)));
    let views = [(ViewKind::Front, front), (ViewKind::Top, top), (ViewKind::Side, side)];
    Drawing { views: views.map(|(kind, curves)| View::new(kind, curves)).to_vec() }
}

const VOLUME: f64 = 40.0 * 30.0 * 20.0 - 15.0 * 30.0 * 12.0 - 16.0 * PI * 20.0;

/// The edits of a drawing; its solid must be the block.
fn edits_of(drawing: &Drawing) -> Vec<Edit> {
    let found = repair(drawing).expect("a repair");
    assert!((found.solution.measures.volume - VOLUME).abs() < 1e-6, "{:?}", found.edits);
    assert_eq!(found.others, 0);
    found.edits
}

#[test]
fn a_deleted_line_is_added() {
    let mut drawing = block();
    // The edge of the step in the top view.
    drawing.views[1].curves.remove(4);
    let edits = edits_of(&drawing);
    assert_eq!((edits.len(), edits[0].kind, edits[0].view), (1, EditKind::Add, ViewKind::Top));
    assert!(edits[0].places.iter().all(|p| (p[0] - 25.0).abs() < 1e-6), "{edits:?}");
}

#[test]
fn a_line_of_the_wrong_style_is_restyled() {
    let mut drawing = block();
    drawing.views[2].curves[4].style = LineStyle::Hidden;
    let edits = edits_of(&drawing);
    let wanted = (1, EditKind::Restyle, ViewKind::Side, LineStyle::Visible);
    assert_eq!((edits.len(), edits[0].kind, edits[0].view, edits[0].style), wanted);
    assert_eq!(edits[0].entity, block().views[2].curves[4].entity.clone().into());
}

#[test]
fn a_moved_line_is_moved_back() {
    let mut drawing = block();
    let moved = segment([0.0, 10.5], [30.0, 10.5], LineStyle::Visible);
    drawing.views[2].curves[4] = moved.clone();
    let edits = edits_of(&drawing);
    assert_eq!(
        (edits.len(), edits[0].kind, edits[0].entity.as_ref()),
        (1, EditKind::Move, Some(&moved.entity))
    );
    assert!(edits[0].moved_to.iter().all(|p| (p[1] - 8.0).abs() < 1e-6), "{edits:?}");
}

#[test]
fn a_line_too_many_is_removed_and_many_wrong_lines_are_not_repaired() {
    let mut drawing = block();
    let stray = segment([3.0, 3.0], [3.0, 27.0], LineStyle::Visible);
    drawing.views[1].curves.push(stray.clone());
    let edits = edits_of(&drawing);
    assert_eq!(
        (edits.len(), edits[0].kind, edits[0].entity.as_ref()),
        (1, EditKind::Remove, Some(&stray.entity))
    );
    for k in 0..4 {
        drawing.views[0].curves.push(segment(
            [1.0 + f64::from(k), 1.0],
            [1.0 + f64::from(k), 19.0],
            LineStyle::Visible,
        ));
    }
    assert_eq!(repair(&drawing), None);
}
