use super::*;
use std::f64::consts::{PI, TAU};

fn drawn(curve: Curve2, style: LineStyle) -> DrawnCurve {
    DrawnCurve {
        curve,
        style,
        entity: "test".to_owned(),
    }
}

fn segment(a: [f64; 2], b: [f64; 2], style: LineStyle) -> DrawnCurve {
    drawn(Curve2::Segment(a, b), style)
}

fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<DrawnCurve> {
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    (0..4)
        .map(|k| segment(corners[k], corners[(k + 1) % 4], LineStyle::Visible))
        .collect()
}

/// A box of 40 × 30 × 20 with a hole of diameter 12 from top to bottom.
fn box_with_hole() -> Drawing {
    let with = |mut curves: Vec<DrawnCurve>, at: [f64; 2]| {
        curves.extend(at.map(|u| segment([u, 0.0], [u, 20.0], LineStyle::Hidden)));
        curves
    };
    let mut top = rectangle([0.0, 0.0], [40.0, 30.0]);
    let hole = Curve2::Arc {
        center: [20.0, 15.0],
        radius: 6.0,
        start: 0.0,
        sweep: TAU,
    };
    top.push(drawn(hole, LineStyle::Visible));
    let view = |kind, curves| View { kind, curves };
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
    assert_eq!(solid.faces_by_kind(), [6, 1]);
    assert!(
        (measures.volume - (24_000.0 - 36.0 * PI * 20.0)).abs() < 1e-8,
        "{}",
        measures.volume
    );
    let area = 2.0 * (1200.0 + 800.0 + 600.0) - 72.0 * PI + 12.0 * PI * 20.0;
    assert!((measures.area - area).abs() < 1e-8, "{}", measures.area);
    for (found, truth) in measures.centroid.iter().zip([20.0, 15.0, 10.0]) {
        assert!((found - truth).abs() < 1e-9);
    }
}

#[test]
fn a_hidden_line_that_nothing_explains_is_named() {
    let mut drawing = box_with_hole();
    let mut stray = segment([5.0, 0.0], [5.0, 20.0], LineStyle::Hidden);
    stray.entity = "LINE 7F (line 12)".to_owned();
    drawing.views[0].curves.push(stray);
    let e = solve(&drawing).unwrap_err();
    assert_eq!(e.kind(), planish_estimate::ErrorKind::Undetermined);
    let said = e.to_string();
    assert!(said.contains("LINE 7F"), "{said}");
}

#[test]
fn a_boundary_with_a_face_missing_is_refused() {
    let mut solid = solve(&box_with_hole()).unwrap().solutions.remove(0).solid;
    solid.check(1e-6).unwrap();
    solid.faces.pop();
    assert!(solid.check(1e-6).is_err());
}

#[test]
fn one_view_is_not_enough() {
    let mut drawing = box_with_hole();
    drawing.views.truncate(1);
    let e = solve(&drawing).unwrap_err();
    assert!(e.to_string().contains("needed two or three views, found 1"), "{e}");
}
