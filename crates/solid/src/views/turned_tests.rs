//! Drawings of cones, spheres and tori, compared with exact measures.

use super::tests::{arc, circle, hidden, rectangle, segment, visible};
use super::*;
use crate::reprojection::{ReprojectionOptions, disagreements};
use std::f64::consts::{FRAC_PI_2, PI};

pub(super) fn drawing(views: Vec<(ViewKind, Vec<DrawnCurve>)>) -> Drawing {
    Drawing { views: views.into_iter().map(|(kind, curves)| View::new(kind, curves)).collect() }
}

/// The same curves in front and side view, as turned parts have them.
pub(super) fn turned(across: Vec<DrawnCurve>, top: Vec<DrawnCurve>) -> Drawing {
    drawing(vec![(ViewKind::Front, across.clone()), (ViewKind::Top, top), (ViewKind::Side, across)])
}

pub(super) fn line(a: [f64; 2], b: [f64; 2]) -> DrawnCurve {
    segment(a, b, LineStyle::Visible)
}

/// The only solid of a drawing, checked.
pub(super) fn only(drawing: &Drawing) -> Solution {
    let found = solve(drawing).unwrap();
    assert_eq!((found.solutions.len(), found.complete), (1, true), "{:?}", found.unexplained);
    let solution = found.solutions.into_iter().next().unwrap();
    solution.solid.check(1e-6).unwrap();
    // Checked independently by reprojection.
    assert_eq!(disagreements(&solution.solid, drawing, &ReprojectionOptions::default()), []);
    solution
}

pub(super) fn assert_near(found: f64, truth: f64, within: f64) {
    assert!((found - truth).abs() < within * truth.abs().max(1.0), "{found} is not {truth}");
}

fn half_circle() -> Vec<DrawnCurve> {
    vec![visible(arc([0.0, 0.0], 10.0, 0.0, PI)), line([-10.0, 0.0], [10.0, 0.0])]
}

#[test]
fn half_circle_over_a_circle_is_first_a_half_ball() {
    let two = drawing(vec![
        (ViewKind::Front, half_circle()),
        (ViewKind::Top, vec![visible(circle([0.0, 0.0], 10.0))]),
    ]);
    let mut found = solve(&two).unwrap().solutions;
    // An earlier version also found a solid with a boundary turned inside out.
    assert!(found.iter().all(|s| s.measures.volume > 0.0));
    let best = found.remove(0);
    assert_eq!(best.solid.faces_by_kind(), [1, 0, 0, 1, 0]);
    assert_near(best.measures.volume, 2000.0 / 3.0 * PI, 1e-9);
    assert_near(best.measures.area, 300.0 * PI, 1e-9);
    assert_near(best.measures.centroid[2], 3.75, 1e-9);
}

#[test]
fn a_half_ball_in_three_views_is_the_only_solid() {
    let solution = only(&turned(half_circle(), vec![visible(circle([0.0, 0.0], 10.0))]));
    assert_eq!(solution.solid.faces_by_kind(), [1, 0, 0, 1, 0]);
    assert_near(solution.measures.volume, 2000.0 / 3.0 * PI, 1e-9);
}

/// A plate of 40 × 40 × 10 with a hole of diameter 10 and a countersink to diameter 20.
fn countersunk(outer_circle: bool) -> Drawing {
    let mut across = rectangle([-20.0, 0.0], [20.0, 10.0]);
    for sign in [-1.0, 1.0] {
        across.push(hidden([sign * 5.0, 0.0], [sign * 5.0, 5.0]));
        across.push(hidden([sign * 5.0, 5.0], [sign * 10.0, 10.0]));
    }
    across.push(hidden([-5.0, 5.0], [5.0, 5.0]));
    let mut top = rectangle([-20.0, -20.0], [20.0, 20.0]);
    top.push(visible(circle([0.0, 0.0], 5.0)));
    if outer_circle {
        top.push(visible(circle([0.0, 0.0], 10.0)));
    }
    turned(across, top)
}

#[test]
fn a_countersunk_hole_has_one_cone() {
    let solution = only(&countersunk(true));
    assert_eq!(solution.solid.faces_by_kind(), [6, 1, 1, 0, 0]);
    let cone = PI * 5.0 / 3.0 * (25.0 + 50.0 + 100.0);
    assert_near(solution.measures.volume, 16_000.0 - 125.0 * PI - cone, 1e-9);
    let area = 2.0 * 1600.0 + 4.0 * 400.0 - 125.0 * PI + 50.0 * PI + PI * 15.0 * 50_f64.sqrt();
    assert_near(solution.measures.area, area, 1e-9);
}

#[test]
fn countersink_without_its_circle_is_rejected() {
    let found = solve(&countersunk(false)).unwrap();
    assert!(found.solutions.is_empty() && !found.unexplained.is_empty());
}

#[test]
fn a_drilled_hole_ends_in_a_cone_with_an_apex() {
    let mut across = rectangle([-20.0, 0.0], [20.0, 30.0]);
    for sign in [-1.0, 1.0] {
        across.push(hidden([sign * 6.0, 15.0], [sign * 6.0, 30.0]));
        across.push(hidden([sign * 6.0, 15.0], [0.0, 11.0]));
    }
    across.push(hidden([-6.0, 15.0], [6.0, 15.0]));
    let mut top = rectangle([-20.0, -20.0], [20.0, 20.0]);
    top.push(visible(circle([0.0, 0.0], 6.0)));
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [6, 1, 1, 0, 0]);
    let truth = 48_000.0 - PI * 36.0 * 15.0 - PI * 36.0 * 4.0 / 3.0;
    assert_near(solution.measures.volume, truth, 1e-9);
}

/// A flange of diameter 40 and height 5 with a boss of diameter 16 up to 20, and a fillet of 4 between them,
/// whose smooth edges are not drawn.
#[test]
fn a_fillet_around_a_boss_is_one_torus() {
    let level = |r: f64, z: f64| line([-r, z], [r, z]);
    let mut across = vec![level(20.0, 0.0), level(20.0, 5.0), level(8.0, 20.0)];
    for sign in [-1.0, 1.0] {
        across.push(line([sign * 20.0, 0.0], [sign * 20.0, 5.0]));
        across.push(line([sign * 8.0, 9.0], [sign * 8.0, 20.0]));
        let start = if sign > 0.0 { PI } else { 3.0 * FRAC_PI_2 };
        across.push(visible(arc([sign * 12.0, 9.0], 4.0, start, FRAC_PI_2)));
    }
    let top = vec![visible(circle([0.0, 0.0], 20.0)), visible(circle([0.0, 0.0], 8.0))];
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [3, 2, 0, 0, 1]);
    // Pappus: the square between boss and flange less the quarter of a circle, each at its centroid's
    // distance.
    let quarter = PI * 4.0;
    let fillet = 2.0 * PI * (16.0 * 10.0 - quarter * (12.0 - 16.0 / (3.0 * PI)));
    assert_near(solution.measures.volume, 2000.0 * PI + 64.0 * 15.0 * PI + fillet, 1e-9);
    // So for the torus' area: the arc's centroid is 2ρ/π inside of its centre.
    let torus = 2.0 * PI * (12.0 - 8.0 / PI) * 2.0 * PI;
    let planes = 400.0 * PI + 64.0 * PI + (400.0 - 144.0) * PI;
    let cylinders = 2.0 * PI * (20.0 * 5.0 + 8.0 * 11.0);
    assert_near(solution.measures.area, torus + planes + cylinders, 1e-9);
}

/// A ball of diameter 20 cut by two planes beside its centre, as on knobs.
#[test]
fn a_ball_cut_on_two_sides_is_one_sphere() {
    let (up, out) = (6.0, 8.0);
    let angle = (up / 10.0_f64).asin();
    let mut across = vec![line([-out, up], [out, up]), line([-out, -up], [out, -up])];
    across.push(visible(arc([0.0, 0.0], 10.0, -angle, 2.0 * angle)));
    across.push(visible(arc([0.0, 0.0], 10.0, PI - angle, 2.0 * angle)));
    let top = vec![visible(circle([0.0, 0.0], 10.0)), visible(circle([0.0, 0.0], out))];
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [2, 0, 0, 1, 0]);
    assert_near(solution.measures.volume, 2.0 * PI * (100.0 * up - up.powi(3) / 3.0), 1e-9);
    assert_near(solution.measures.area, 2.0 * PI * 64.0 + 2.0 * PI * 10.0 * 12.0, 1e-9);
}

/// A quarter of a ball: its plane through the poles.
#[test]
fn a_quarter_of_a_ball_is_measured_although_edges_pass_the_poles() {
    let top = vec![visible(arc([0.0, 0.0], 10.0, 0.0, PI)), line([-10.0, 0.0], [10.0, 0.0])];
    let side = vec![
        visible(arc([0.0, 0.0], 10.0, 0.0, FRAC_PI_2)),
        line([0.0, 0.0], [10.0, 0.0]),
        line([0.0, 0.0], [0.0, 10.0]),
    ];
    let quarter =
        drawing(vec![(ViewKind::Front, half_circle()), (ViewKind::Top, top), (ViewKind::Side, side)]);
    let solution = only(&quarter);
    assert_eq!(solution.solid.faces_by_kind(), [2, 0, 0, 1, 0]);
    assert_near(solution.measures.volume, 1000.0 / 3.0 * PI, 1e-9);
    assert_near(solution.measures.area, 200.0 * PI, 1e-9);
}
