use super::*;
use crate::brep::{TrimmedFace, met_by_distance};
use crate::drawing::ViewContent;
use crate::views::{Curve2, DrawnCurve, LineStyle, View, solve};
use planish_core::DVec3;
use std::f64::consts::{PI, TAU};

fn drawn(curve: Curve2, style: LineStyle, entity: &str) -> DrawnCurve {
    DrawnCurve { curve, style, entity: entity.to_owned() }
}

fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Vec<DrawnCurve> {
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    let side = |k: usize| Curve2::Segment(corners[k], corners[(k + 1) % 4]);
    (0..4).map(|k| drawn(side(k), LineStyle::Visible, "outline")).collect()
}

fn upright(u: f64, z: [f64; 2], style: LineStyle, entity: &str) -> DrawnCurve {
    drawn(Curve2::Segment([u, z[0]], [u, z[1]]), style, entity)
}

fn level(z: f64, u: [f64; 2], style: LineStyle, entity: &str) -> DrawnCurve {
    drawn(Curve2::Segment([u[0], z], [u[1], z]), style, entity)
}

fn ring(center: [f64; 2], radius: f64, style: LineStyle, entity: &str) -> DrawnCurve {
    let circle = Curve2::Arc { center, radius, start: 0.0, sweep: TAU };
    drawn(circle, style, entity)
}

/// A box of 40 × 30 × 20 with a stepped hole: diameter 6 below, 12 above z = 12.
fn stepped_hole() -> Drawing {
    use LineStyle::{Hidden, Visible};
    let with = |mut curves: Vec<DrawnCurve>, middle: f64| {
        for (radius, z) in [(3.0, [0.0, 12.0]), (6.0, [12.0, 20.0])] {
            curves.push(upright(middle - radius, z, Hidden, "left of the hole"));
            curves.push(upright(middle + radius, z, Hidden, "right of the hole"));
        }
        curves.push(level(12.0, [middle - 6.0, middle + 6.0], Hidden, "the step"));
        curves
    };
    let mut top = rectangle([0.0, 0.0], [40.0, 30.0]);
    top.push(ring([20.0, 15.0], 6.0, Visible, "wide circle"));
    top.push(ring([20.0, 15.0], 3.0, Visible, "narrow circle"));
    let view = |kind, curves| View::new(kind, curves);
    Drawing {
        views: vec![
            view(ViewKind::Front, with(rectangle([0.0, 0.0], [40.0, 20.0]), 20.0)),
            view(ViewKind::Top, top),
            view(ViewKind::Side, with(rectangle([0.0, 0.0], [30.0, 20.0]), 15.0)),
        ],
    }
}

fn solved(drawing: &Drawing) -> Solid {
    solve(drawing).unwrap().solutions.remove(0).solid
}

fn compared(solid: &Solid, drawing: &Drawing) -> Vec<Disagreement> {
    disagreements(solid, drawing, &ReprojectionOptions::default())
}

fn curve<'a>(drawing: &'a mut Drawing, view: usize, entity: &str) -> &'a mut DrawnCurve {
    drawing.views[view].curves.iter_mut().find(|c| c.entity == entity).unwrap()
}

#[test]
fn solid_agrees_with_its_own_drawing() {
    let drawing = stepped_hole();
    let found = compared(&solved(&drawing), &drawing);
    assert!(found.is_empty(), "{found:?}");
}

#[test]
fn drawn_line_without_an_edge_is_reported() {
    let mut drawing = stepped_hole();
    let solid = solved(&drawing);
    let stray = level(5.0, [0.0, 40.0], LineStyle::Hidden, "LINE 7F (line 12)");
    drawing.views[0].curves.push(stray);
    let [named] = &compared(&solid, &drawing)[..] else { panic!("expected one difference") };
    assert_eq!((named.view, named.entity.as_deref()), (ViewKind::Front, Some("LINE 7F (line 12)")));
    assert_eq!(named.difference.reason(), "a hidden line is drawn, but the solid has no line there");
}

#[test]
fn edge_without_a_drawn_line_is_reported() {
    let mut drawing = stepped_hole();
    let solid = solved(&drawing);
    drawing.views[1].curves.retain(|c| c.entity != "narrow circle");
    let found = compared(&solid, &drawing);
    assert!(!found.is_empty());
    for named in found {
        assert_eq!((named.view, named.entity), (ViewKind::Top, None));
        assert_eq!(named.difference.reason(), "the solid shows a visible line, but none is drawn");
        let off = (named.places[0][0] - 20.0).hypot(named.places[0][1] - 15.0) - 3.0;
        assert!(off.abs() < 1e-3, "{off}");
    }
}

#[test]
fn lines_drawn_in_the_wrong_style_are_reported() {
    let mut drawing = stepped_hole();
    let solid = solved(&drawing);
    curve(&mut drawing, 2, "the step").style = LineStyle::Visible;
    curve(&mut drawing, 1, "wide circle").style = LineStyle::Hidden;
    let found = compared(&solid, &drawing);
    let is_reported =
        |view, reason: &str| found.iter().any(|d| d.view == view && d.difference.reason() == reason);
    assert!(
        is_reported(ViewKind::Side, "a line is drawn visible, but it is hidden in the solid"),
        "{found:?}"
    );
    assert!(
        is_reported(ViewKind::Top, "the solid shows a visible line, but it is drawn hidden"),
        "{found:?}"
    );
    assert!(found.iter().all(|d| d.view != ViewKind::Front));
}

#[test]
fn different_solid_with_the_same_outlines_is_reported() {
    let drawing = stepped_hole();
    let mut through = drawing.clone();
    for view in &mut through.views {
        view.curves.retain(|c| c.entity != "narrow circle" && c.entity != "the step");
        for drawn in &mut view.curves {
            if let Curve2::Segment(a, b) = &mut drawn.curve
                && drawn.entity.ends_with("hole")
            {
                let middle = if view.kind == ViewKind::Front { 20.0 } else { 15.0 };
                let u = middle + 6.0 * (a[0] - middle).signum();
                (*a, *b) = ([u, 0.0], [u, 20.0]);
            }
        }
    }
    let found = compared(&solved(&through), &drawing);
    let views: Vec<ViewKind> =
        ViewKind::ALL.into_iter().filter(|v| found.iter().any(|d| d.view == *v)).collect();
    assert_eq!(views, ViewKind::ALL, "{found:?}");
}

#[test]
fn rounded_edge_has_an_outline_only_where_it_turns_away() {
    // A bar along y of 20 × 10 whose upper right edge is rounded by 4.
    use LineStyle::Visible;
    let mut front = vec![
        drawn(Curve2::Segment([0.0, 0.0], [20.0, 0.0]), Visible, "a"),
        drawn(Curve2::Segment([20.0, 0.0], [20.0, 6.0]), Visible, "b"),
        drawn(Curve2::Segment([16.0, 10.0], [0.0, 10.0]), Visible, "c"),
        drawn(Curve2::Segment([0.0, 10.0], [0.0, 0.0]), Visible, "d"),
    ];
    front.push(drawn(
        Curve2::Arc { center: [16.0, 6.0], radius: 4.0, start: 0.0, sweep: PI / 2.0 },
        Visible,
        "rounding",
    ));
    let views = [front, rectangle([0.0, 0.0], [20.0, 30.0]), rectangle([0.0, 0.0], [30.0, 10.0])];
    let drawing = Drawing {
        views: ViewKind::ALL.into_iter().zip(views).map(|(kind, curves)| View::new(kind, curves)).collect(),
    };
    let solid = solved(&drawing);
    assert_eq!(solid.faces_by_kind(), [6, 1, 0, 0, 0]);
    let found = compared(&solid, &drawing);
    assert!(found.is_empty(), "{found:?}");
    // The smooth edge may be drawn; a line beside it is not an edge of the solid.
    for (at, differences) in [(16.0, 0), (15.0, 1)] {
        let mut more = drawing.clone();
        more.views[1].curves.push(upright(at, [0.0, 30.0], Visible, "smooth"));
        assert_eq!(compared(&solid, &more).len(), differences);
    }
}

#[test]
fn closed_form_and_distance_give_the_same_ray_intersections() {
    let solid = solved(&stepped_hole());
    let reach = [DVec3::splat(-50.0), DVec3::splat(90.0)];
    let cylinder =
        solid.faces.iter().find(|f| matches!(f.surface, crate::brep::FaceSurface::Cylinder { .. })).unwrap();
    let face = TrimmedFace::new(&solid, cylinder, reach);
    let direction = DVec3::new(0.6, 0.0, 0.8);
    for y in [12.5, 14.0, 15.3, 16.9] {
        let origin = DVec3::new(-10.0, y, -20.0);
        let exact = face.met(origin, direction, [0.0, 200.0]);
        let followed = met_by_distance(face.surface(), origin, direction, [0.0, 200.0]);
        assert_eq!(exact.len(), followed.len());
        for (a, b) in exact.iter().zip(followed) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
    let beyond = DVec3::new(-10.0, 40.0, -20.0);
    assert!(face.met(beyond, direction, [0.0, 200.0]).is_empty());
    assert!(met_by_distance(face.surface(), beyond, direction, [0.0, 200.0]).is_empty());
}

#[test]
fn plane_with_holes_contains_the_points_between_its_loops() {
    let solid = solved(&stepped_hole());
    let above = |f: &&crate::brep::Face| {
        f.surface.distance(DVec3::new(1.0, 1.0, 20.0)).abs() < 1e-9 && f.loops.len() == 2
    };
    let face = solid.faces.iter().find(above).unwrap();
    let face = TrimmedFace::new(&solid, face, [DVec3::splat(-50.0), DVec3::splat(90.0)]);
    for k in 0..720 {
        let (sin, cos) = (TAU * f64::from(k) / 720.0).sin_cos();
        let at = |radius: f64| DVec3::new(20.0 + radius * cos, 15.0 + radius * sin, 20.0);
        assert!(!face.contains(at(6.0 - 1e-6)) && face.contains(at(6.0 + 1e-6)), "{k}");
        assert!(!face.contains(at(40.0)));
    }
}

#[test]
fn without_hidden_lines_the_end_of_a_hole_is_open_and_that_of_a_step_is_not() {
    let mut drawing = stepped_hole();
    let solid = solved(&drawing);
    for view in &mut drawing.views {
        view.curves.retain(|c| c.style == LineStyle::Visible);
        view.content = ViewContent::VisibleEdges;
    }
    assert!(!unseen_edges(&solid, &drawing, &ReprojectionOptions::default()).is_empty());
    // A block with a step at its right end: all edges follow from the three views.
    let outline = [[0.0, 0.0], [40.0, 0.0], [40.0, 8.0], [25.0, 8.0], [25.0, 20.0], [0.0, 20.0]];
    let side = |k: usize| Curve2::Segment(outline[k], outline[(k + 1) % 6]);
    let front = (0..6).map(|k| drawn(side(k), LineStyle::Visible, "outline")).collect();
    let mut top = rectangle([0.0, 0.0], [40.0, 30.0]);
    top.push(upright(25.0, [0.0, 30.0], LineStyle::Visible, "step"));
    let mut right = rectangle([0.0, 0.0], [30.0, 20.0]);
    right.push(level(8.0, [0.0, 30.0], LineStyle::Visible, "step"));
    let views = [(ViewKind::Front, front), (ViewKind::Top, top), (ViewKind::Side, right)];
    let step = Drawing { views: views.map(|(kind, curves)| View::new(kind, curves)).to_vec() };
    assert!(unseen_edges(&solved(&step), &step, &ReprojectionOptions::default()).is_empty());
}
