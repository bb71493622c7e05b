//! Drawings of surfaces of revolution as draughtsmen make them, without smooth edges: balls, rings, domes,
//! rims, grooves.

use super::tests::{arc, circle, rectangle, visible};
use super::turned_tests::{assert_near, drawing, line, only, turned};
use super::*;
use std::f64::consts::{FRAC_PI_2, PI};

fn dashed(curve: Curve2) -> DrawnCurve {
    DrawnCurve { style: LineStyle::Hidden, ..visible(curve) }
}

fn ball() -> Vec<DrawnCurve> {
    vec![visible(circle([5.0, 5.0], 10.0))]
}

#[test]
fn three_equal_circles_are_a_ball() {
    let solution = only(&turned(ball(), ball()));
    assert_eq!(solution.solid.faces_by_kind(), [0, 0, 0, 1, 0]);
    assert_near(solution.measures.volume, 4000.0 / 3.0 * PI, 1e-12);
    assert_near(solution.measures.area, 400.0 * PI, 1e-12);
    assert!((0..3).all(|k| (solution.measures.centroid[k] - 5.0).abs() < 1e-12));
}

#[test]
fn two_equal_circles_are_a_ball_before_crossing_cylinders() {
    let two = drawing(vec![(ViewKind::Front, ball()), (ViewKind::Top, ball())]);
    let found = solve(&two).unwrap().solutions;
    assert_eq!(found[0].solid.faces_by_kind(), [0, 0, 0, 1, 0]);
    assert_near(found[0].measures.volume, 4000.0 / 3.0 * PI, 1e-12);
    let cylinders = found.iter().find(|s| s.solid.faces_by_kind() == [0, 4, 0, 0, 0]).unwrap();
    assert_near(cylinders.measures.volume, 16_000.0 / 3.0, 1e-9);
}

/// A ring of round section: a tube of diameter 16 around a circle of diameter 60.
#[test]
fn a_ring_of_round_section_is_one_torus() {
    let mut across = vec![line([-30.0, 8.0], [30.0, 8.0]), line([-30.0, -8.0], [30.0, -8.0])];
    for (at, outer) in [(30.0, -FRAC_PI_2), (-30.0, FRAC_PI_2)] {
        across.push(visible(arc([at, 0.0], 8.0, outer, PI)));
        across.push(dashed(arc([at, 0.0], 8.0, outer + PI, PI)));
    }
    let top = vec![visible(circle([0.0, 0.0], 38.0)), visible(circle([0.0, 0.0], 22.0))];
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [0, 0, 0, 0, 1]);
    assert_near(solution.measures.volume, 2.0 * PI * PI * 30.0 * 64.0, 1e-12);
    assert_near(solution.measures.area, 4.0 * PI * PI * 30.0 * 8.0, 1e-12);
}

/// A pin of diameter 20 whose upper end is half a ball; `lower`: the other end as well.
fn pin(lower: bool) -> Drawing {
    let mut across = vec![line([-10.0, 0.0], [-10.0, 20.0]), line([10.0, 0.0], [10.0, 20.0])];
    across.push(visible(arc([0.0, 20.0], 10.0, 0.0, PI)));
    across.push(match lower {
        true => visible(arc([0.0, 0.0], 10.0, PI, PI)),
        false => line([-10.0, 0.0], [10.0, 0.0]),
    });
    turned(across, vec![visible(circle([0.0, 0.0], 10.0))])
}

#[test]
fn a_domed_pin_needs_no_line_where_the_dome_begins() {
    let solution = only(&pin(false));
    assert_eq!(solution.solid.faces_by_kind(), [1, 1, 0, 1, 0]);
    assert_near(solution.measures.volume, 2000.0 * PI + 2000.0 / 3.0 * PI, 1e-12);
    assert_near(solution.measures.area, 100.0 * PI + 400.0 * PI + 200.0 * PI, 1e-12);
}

#[test]
fn a_capsule_has_two_spheres() {
    let solution = only(&pin(true));
    assert_eq!(solution.solid.faces_by_kind(), [0, 1, 0, 2, 0]);
    assert_near(solution.measures.volume, 2000.0 * PI + 4000.0 / 3.0 * PI, 1e-12);
}

/// A disc of diameter 40 and height 15 whose upper rim is rounded by 5.
fn rim() -> Drawing {
    let mut across = vec![line([-20.0, 0.0], [20.0, 0.0]), line([-15.0, 15.0], [15.0, 15.0])];
    for side in [-1.0, 1.0] {
        across.push(line([side * 20.0, 0.0], [side * 20.0, 10.0]));
    }
    across.push(visible(arc([15.0, 10.0], 5.0, 0.0, FRAC_PI_2)));
    across.push(visible(arc([-15.0, 10.0], 5.0, FRAC_PI_2, FRAC_PI_2)));
    turned(across, vec![visible(circle([0.0, 0.0], 20.0))])
}

#[test]
fn a_rounded_rim_is_a_torus() {
    let solution = only(&rim());
    assert_eq!(solution.solid.faces_by_kind(), [2, 1, 0, 0, 1]);
    let rim = PI * (225.0 * 5.0 + 30.0 * PI * 25.0 / 4.0 + 25.0 * 5.0 - 125.0 / 3.0);
    assert_near(solution.measures.volume, 4000.0 * PI + rim, 1e-9);
}

/// A shaft of diameter 40 with a half-round groove of radius 4 around it.
#[test]
fn a_groove_around_a_shaft_is_half_a_tube() {
    let mut across = Vec::new();
    for height in [0.0, 16.0, 24.0, 40.0] {
        across.push(line([-20.0, height], [20.0, height]));
    }
    for side in [-1.0, 1.0] {
        across.push(line([side * 20.0, 0.0], [side * 20.0, 16.0]));
        across.push(line([side * 20.0, 24.0], [side * 20.0, 40.0]));
        across.push(visible(arc([side * 20.0, 20.0], 4.0, side * FRAC_PI_2, PI)));
    }
    let top = vec![visible(circle([0.0, 0.0], 20.0)), dashed(circle([0.0, 0.0], 16.0))];
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [2, 2, 0, 0, 1]);
    let groove = 2.0 * PI * (20.0 - 16.0 / (3.0 * PI)) * 8.0 * PI;
    assert_near(solution.measures.volume, 16_000.0 * PI - groove, 1e-9);
}

/// A ring of half-round section, radius 4, around a circle of diameter 60 on a plate.
#[test]
fn a_half_round_ring_on_a_plate_is_half_a_tube() {
    let mut across = rectangle([-40.0, 0.0], [40.0, 10.0]);
    across.push(line([-30.0, 14.0], [30.0, 14.0]));
    for (at, outer, inner) in [(30.0, 0.0, FRAC_PI_2), (-30.0, FRAC_PI_2, 0.0)] {
        across.push(visible(arc([at, 10.0], 4.0, outer, FRAC_PI_2)));
        across.push(dashed(arc([at, 10.0], 4.0, inner, FRAC_PI_2)));
    }
    let mut top = rectangle([-40.0, -40.0], [40.0, 40.0]);
    top.extend([34.0, 26.0].map(|radius| visible(circle([0.0, 0.0], radius))));
    let solution = only(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [7, 0, 0, 0, 1]);
    assert_near(solution.measures.volume, 64_000.0 + 60.0 * PI * 8.0 * PI, 1e-9);
}

#[test]
fn very_large_and_very_small_drawings_give_the_same_solid() {
    for factor in [1e-8, 1e8] {
        let solution = &solve(&pin(false).scaled(factor)).unwrap().solutions[0];
        assert_eq!(solution.solid.faces_by_kind(), [1, 1, 0, 1, 0]);
        let truth = (2000.0 * PI + 2000.0 / 3.0 * PI) * factor.powi(3);
        assert!((solution.measures.volume / truth - 1.0).abs() < 1e-9);
        solution.solid.check(1e-6 * 30.0 * factor).unwrap();
    }
}

#[test]
fn messages_give_positions_in_the_unit_of_a_small_drawing() {
    let mut bad = pin(false);
    bad.views[0].curves.push(line([-4.0, 3.0], [4.0, 3.0]));
    let found = solve(&bad.scaled(1e-8)).unwrap();
    assert!(found.unexplained.iter().any(|u| u.reason.contains("e-8")), "{:?}", found.unexplained);
}
