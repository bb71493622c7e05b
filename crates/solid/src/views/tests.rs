use super::*;
use crate::drawing::ViewContent;
use std::f64::consts::{PI, TAU};

fn drawn(curve: Curve2, style: LineStyle) -> DrawnCurve {
    DrawnCurve { curve, style, entity: "test".to_owned() }
}

pub(super) fn segment(a: [f64; 2], b: [f64; 2], style: LineStyle) -> DrawnCurve {
    drawn(Curve2::Segment(a, b), style)
}

pub(super) fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<DrawnCurve> {
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    (0..4).map(|k| segment(corners[k], corners[(k + 1) % 4], LineStyle::Visible)).collect()
}

/// A box of 40 × 30 × 20 with a hole of diameter 12 from top to bottom.
fn box_with_hole() -> Drawing {
    let with = |mut curves: Vec<DrawnCurve>, at: [f64; 2]| {
        curves.extend(at.map(|u| segment([u, 0.0], [u, 20.0], LineStyle::Hidden)));
        curves
    };
    let mut top = rectangle([0.0, 0.0], [40.0, 30.0]);
    let hole = Curve2::Arc { center: [20.0, 15.0], radius: 6.0, start: 0.0, sweep: TAU };
    top.push(drawn(hole, LineStyle::Visible));
    let view = |kind, curves| View::new(kind, curves);
    Drawing {
        views: vec![
            view(ViewKind::Front, with(rectangle([0.0, 0.0], [40.0, 20.0]), [14.0, 26.0])),
            view(ViewKind::Top, top),
            view(ViewKind::Side, with(rectangle([0.0, 0.0], [30.0, 20.0]), [9.0, 21.0])),
        ],
    }
}

#[test]
fn a_box_with_a_hole_has_its_volume_area_and_one_cylinder() {
    let found = solve(&box_with_hole()).unwrap();
    assert!(found.complete && found.unexplained.is_empty());
    assert_eq!(found.solutions.len(), 1);
    let Solution { solid, measures, .. } = &found.solutions[0];
    assert_eq!(solid.faces_by_kind()[..2], [6, 1]);
    assert!((measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8, "{}", measures.volume);
    let area = 2.0 * (1200.0 + 800.0 + 600.0) - 72.0 * PI + 12.0 * PI * 20.0;
    assert!((measures.area - area).abs() < 1e-8, "{}", measures.area);
    for (found, truth) in measures.centroid.to_array().iter().zip([20.0, 15.0, 10.0]) {
        assert!((found - truth).abs() < 1e-9);
    }
}

#[test]
fn a_hole_drawn_as_an_inaccurate_spline_is_exact() {
    let mut drawing = box_with_hole();
    let point = |k: usize| {
        let angle = TAU * k as f64 / 160.0;
        let radius = 6.0 * (1.0 + 3e-5 * (5.0 * angle).cos());
        [20.0 + radius * angle.cos(), 15.0 + radius * angle.sin()]
    };
    let hole = drawing.views[1].curves.last_mut().unwrap();
    hole.curve = Curve2::Chain((0..=160).map(point).collect());
    let found = solve(&drawing).unwrap();
    let [only] = &found.solutions[..] else { panic!("{:?}", found.unexplained) };
    assert!((only.measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8, "{}", only.measures.volume);
}

#[test]
fn only_a_fragment_that_lies_on_another_line_is_dropped() {
    // Open Cascade leaves such lines at most cross holes.
    let is_kept = |a, b| {
        let mut drawing = box_with_hole();
        let front = &mut drawing.views[0].curves;
        front.push(segment(a, b, LineStyle::Visible));
        let count = front.len();
        tidy::tidied(&drawing).views[0].curves.len() == count
    };
    assert!(!is_kept([14.0, 3.0], [14.00001, 3.005]));
    assert!(is_kept([10.0, 3.0], [10.00001, 3.005]));
    // A short piece of a line begins where its neighbour ends.
    assert!(is_kept([40.0, 20.0], [40.005, 20.0]));
}

#[test]
fn unexplained_hidden_line_is_reported_by_name() {
    let mut drawing = box_with_hole();
    let mut stray = segment([5.0, 0.0], [5.0, 20.0], LineStyle::Hidden);
    stray.entity = "LINE 7F (line 12)".to_owned();
    drawing.views[0].curves.push(stray);
    let found = solve(&drawing).unwrap();
    assert!(found.solutions.is_empty());
    let [named] = &found.unexplained[..] else { panic!("{:?}", found.unexplained) };
    assert_eq!(named.entity.as_deref(), Some("LINE 7F (line 12)"));
    assert!(named.reason.starts_with("no solid shows a hidden line at 5.0000"), "{}", named.reason);
}

#[test]
fn boundary_without_one_face_is_rejected() {
    let mut solid = solve(&box_with_hole()).unwrap().solutions.remove(0).solid;
    solid.check(1e-6).unwrap();
    solid.faces.pop();
    assert!(solid.check(1e-6).is_err());
}

pub(super) fn circle(center: [f64; 2], radius: f64) -> Curve2 {
    arc(center, radius, 0.0, TAU)
}

pub(super) fn arc(center: [f64; 2], radius: f64, start: f64, sweep: f64) -> Curve2 {
    Curve2::Arc { center, radius, start, sweep }
}

pub(super) fn hidden(a: [f64; 2], b: [f64; 2]) -> DrawnCurve {
    segment(a, b, LineStyle::Hidden)
}

pub(super) fn visible(curve: Curve2) -> DrawnCurve {
    drawn(curve, LineStyle::Visible)
}

fn three(front: Vec<DrawnCurve>, top: Vec<DrawnCurve>, side: Vec<DrawnCurve>) -> Drawing {
    let views = ViewKind::ALL.into_iter().zip([front, top, side]);
    Drawing { views: views.map(|(kind, curves)| View::new(kind, curves)).collect() }
}

fn only(drawing: &Drawing) -> Solution {
    let mut found = solve(drawing).unwrap();
    assert_eq!(found.solutions.len(), 1);
    found.solutions.remove(0)
}

#[test]
fn circle_in_pieces_with_an_inaccurate_one_is_one_cylinder() {
    let mut drawing = box_with_hole();
    let top = &mut drawing.views[1].curves;
    top.pop();
    let on = |angle: f64| [20.0 + 6.0 * angle.cos(), 15.0 + 6.0 * angle.sin()];
    // The last piece is in the right place, but its circle has a centre that is off by 0.01.
    let (off, sweep) = (0.01, 0.083);
    let turn = TAU - sweep / 2.0;
    let center = [20.0 + off * turn.cos(), 15.0 + off * turn.sin()];
    let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
    let (from, to) = (on(TAU - sweep), on(0.0));
    let radius = (to[0] - center[0]).hypot(to[1] - center[1]);
    top.push(visible(arc([20.0, 15.0], 6.0, 0.0, TAU - sweep)));
    top.push(visible(arc(center, radius, angle(from), angle(to) - angle(from))));
    // A short piece is drawn a second time, as its chord.
    top.push(segment(on(1.0), on(1.0005), LineStyle::Visible));
    let Solution { solid, measures, .. } = only(&drawing);
    assert_eq!(solid.faces_by_kind()[..2], [6, 1]);
    assert!((measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8);
}

#[test]
fn rounded_circle_is_moved_to_its_tangent_lines() {
    let mut drawing = box_with_hole();
    let top = &mut drawing.views[1].curves;
    top.pop();
    top.push(visible(circle([20.000_01, 14.999_995], 6.000_01)));
    let Solution { solid, measures, .. } = only(&drawing);
    assert_eq!(solid.faces_by_kind()[..2], [6, 1]);
    assert!((measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8);
}

#[test]
fn hole_that_touches_a_wall_divides_the_wall() {
    let side = |at: [f64; 2]| {
        let mut curves = rectangle([0.0, 0.0], [20.0, 20.0]);
        curves.extend(at.map(|u| hidden([u, 0.0], [u, 20.0])));
        curves
    };
    let mut top = rectangle([0.0, 0.0], [20.0, 20.0]);
    top.push(visible(circle([5.0, 10.0], 5.0)));
    let mut front = rectangle([0.0, 0.0], [20.0, 20.0]);
    front.push(hidden([10.0, 0.0], [10.0, 20.0]));
    let Solution { solid, measures, .. } = only(&three(front, top, side([5.0, 15.0])));
    // The wall is divided at the line, and the hole is divided at its seam, which is opposite.
    assert_eq!(solid.faces_by_kind()[..2], [7, 2]);
    assert!((measures.volume - (8000.0 - 500.0 * PI)).abs() < 1e-8);
}

#[test]
fn hole_that_touches_a_groove_from_below_is_found() {
    let outline = [[0.0, 11.0], [0.0, 0.0], [20.0, 0.0], [20.0, 11.0]];
    let mut front: Vec<DrawnCurve> =
        outline.windows(2).map(|p| segment(p[0], p[1], LineStyle::Visible)).collect();
    front.push(segment([0.0, 11.0], [7.0, 11.0], LineStyle::Visible));
    front.push(segment([13.0, 11.0], [20.0, 11.0], LineStyle::Visible));
    front.push(visible(arc([10.0, 11.0], 3.0, PI, PI)));
    front.extend([2.0, 8.0].map(|z| hidden([0.0, z], [20.0, z])));
    let mut top = rectangle([0.0, 0.0], [20.0, 20.0]);
    top.extend([7.0, 13.0].map(|x| segment([x, 0.0], [x, 20.0], LineStyle::Visible)));
    top.extend([7.0, 13.0].map(|y| hidden([0.0, y], [20.0, y])));
    let mut side = rectangle([0.0, 0.0], [20.0, 11.0]);
    side.push(visible(circle([10.0, 5.0], 3.0)));
    side.push(hidden([0.0, 8.0], [20.0, 8.0]));
    let Solution { solid, measures, .. } = only(&three(front, top, side));
    assert_eq!(solid.faces_by_kind()[..2], [7, 2]);
    assert!((measures.volume - (4400.0 - 270.0 * PI)).abs() < 1e-7);
}

#[test]
fn nearly_straight_arc_is_no_cylinder() {
    let mut drawing = box_with_hole();
    let bent = arc([20.0, -30.0], 32.0, 1.56, 0.02);
    drawing.views[1].curves.push(visible(bent));
    let tidy = tidy::tidied(&drawing);
    let last = &tidy.views[1].curves.last().unwrap().curve;
    assert!(matches!(last, Curve2::Chain(_)), "{last:?}");
}

#[test]
fn circle_seen_at_a_small_angle_is_no_circle() {
    // Tilted by 0.3°, so that the smaller diameter is 1.6e-4 less than the larger one.
    let is_arc = |tilt_deg: f64| {
        let mut drawing = box_with_hole();
        let point = |k: usize| {
            let (sin, cos) = (TAU * k as f64 / 48.0).sin_cos();
            [20.0 + 6.0 * tilt_deg.to_radians().cos() * cos, 15.0 + 6.0 * sin]
        };
        let hole = drawing.views[1].curves.last_mut().unwrap();
        hole.curve = Curve2::Chain((0..=48).map(point).collect());
        matches!(tidy::tidied(&drawing).views[1].curves.last().unwrap().curve, Curve2::Arc { .. })
    };
    assert!(is_arc(0.0) && !is_arc(0.3) && !is_arc(0.1));
}

#[test]
fn one_view_is_not_enough() {
    let mut drawing = box_with_hole();
    drawing.views.truncate(1);
    let e = solve(&drawing).unwrap_err();
    assert!(e.to_string().contains("expected two or three views, found 1"), "{e}");
}

#[test]
fn without_hidden_lines_a_hole_goes_through_and_a_missing_visible_line_is_named() {
    let mut drawing = box_with_hole();
    for view in &mut drawing.views {
        view.curves.retain(|c| c.style == LineStyle::Visible);
    }
    // As drawings of all edges, the views show that there is no hole.
    assert!(!solve(&drawing).unwrap().unexplained.is_empty());
    for view in &mut drawing.views {
        view.content = ViewContent::VisibleEdges;
    }
    let found = solve(&drawing).unwrap();
    let best = &found.solutions[0];
    assert!((best.measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8, "{}", best.measures.volume);
    assert!(disagreements(&best.solid, &drawing, &ReprojectionOptions::default()).is_empty());
    assert!(!found.has_unseen_faces);
    // A step that only the side view shows has a visible edge in the top view, too.
    drawing.views[2].curves = rectangle([0.0, 0.0], [30.0, 12.0]);
    drawing.views[2].curves.extend(rectangle([0.0, 12.0], [3.0, 20.0]));
    let refused = |found: Result<Solutions>| found.map_or(true, |found| !found.unexplained.is_empty());
    assert!(refused(solve(&drawing)));
}

#[test]
fn candidate_circles_make_cylinders_of_what_could_be_square() {
    // Front and side view of a bar of 20 along z.
    let mut drawing = Drawing {
        views: [ViewKind::Front, ViewKind::Side]
            .map(|kind| View::new(kind, rectangle([0.0, 0.0], [10.0, 20.0])))
            .to_vec(),
    };
    let volume = |drawing: &Drawing| solve(drawing).unwrap().solutions[0].measures.volume;
    assert!((volume(&drawing) - 2000.0).abs() < 1e-9);
    let circle = Curve2::Arc { center: [5.0, 5.0], radius: 5.0, start: 0.0, sweep: TAU };
    let content = ViewContent::Candidates;
    drawing.views.push(View {
        kind: ViewKind::Top,
        curves: vec![drawn(circle, LineStyle::Visible)],
        content,
    });
    let found = solve(&drawing).unwrap();
    assert!((volume(&drawing) - 500.0 * PI).abs() < 1e-8, "{}", volume(&drawing));
    // The square bar still has these views.
    assert!(found.solutions.iter().any(|s| (s.measures.volume - 2000.0).abs() < 1e-8));
    assert!(disagreements(&found.solutions[0].solid, &drawing, &ReprojectionOptions::default()).is_empty());
}
