//! Drawings that show smooth (tangent) edges, as many programs export them, and the same without.

use super::tests::{arc, circle, hidden, rectangle, visible};
use super::turned_tests::{assert_near, drawing, line, turned};
use super::*;
use std::f64::consts::{FRAC_PI_2, PI};

/// The best solid of a drawing.
fn best(drawing: &Drawing) -> Solution {
    let found = solve(drawing).unwrap();
    assert!(found.unexplained.is_empty(), "{:?}", found.unexplained);
    let best = found.solutions.into_iter().next().unwrap();
    assert_eq!(disagreements(&best.solid, drawing, &ReprojectionOptions::default()), []);
    best
}

/// A block of 40 × 30 × 20 whose upright edges on the right are rounded: by 8 in front, by 5 behind.
fn rounded(with_smooth_edges: bool) -> Drawing {
    let mut front = rectangle([0.0, 0.0], [40.0, 20.0]);
    let mut side = rectangle([0.0, 0.0], [30.0, 20.0]);
    let top = vec![
        line([0.0, 0.0], [32.0, 0.0]),
        visible(arc([32.0, 8.0], 8.0, -FRAC_PI_2, FRAC_PI_2)),
        line([40.0, 8.0], [40.0, 25.0]),
        visible(arc([35.0, 25.0], 5.0, 0.0, FRAC_PI_2)),
        line([35.0, 30.0], [0.0, 30.0]),
        line([0.0, 30.0], [0.0, 0.0]),
    ];
    if with_smooth_edges {
        front.push(line([32.0, 0.0], [32.0, 20.0]));
        front.push(hidden([35.0, 0.0], [35.0, 20.0]));
        side.push(line([8.0, 0.0], [8.0, 20.0]));
        side.push(line([25.0, 0.0], [25.0, 20.0]));
    }
    drawing(vec![(ViewKind::Front, front), (ViewKind::Top, top), (ViewKind::Side, side)])
}

#[test]
fn a_rounded_block_is_the_same_with_and_without_its_smooth_edges() {
    let volume = 24_000.0 - (1.0 - PI / 4.0) * (64.0 + 25.0) * 20.0;
    for with_smooth_edges in [false, true] {
        let solution = best(&rounded(with_smooth_edges));
        assert_eq!(solution.solid.faces_by_kind(), [6, 2, 0, 0, 0]);
        assert_near(solution.measures.volume, volume, 1e-12);
    }
}

#[test]
fn some_smooth_edges_may_be_drawn_and_others_not() {
    let mut some = rounded(true);
    some.views[0].curves.pop();
    some.views[2].curves.pop();
    assert_eq!(best(&some).solid.faces_by_kind(), [6, 2, 0, 0, 0]);
}

#[test]
fn line_that_is_no_edge_is_reported_among_smooth_edges() {
    let mut bad = rounded(true);
    let mut stray = line([20.0, 0.0], [20.0, 20.0]);
    stray.entity = "LINE 7F (line 12)".to_owned();
    bad.views[0].curves.push(stray);
    let found = solve(&bad).unwrap();
    assert!(found.solutions.is_empty());
    let named: Vec<Option<&str>> = found.unexplained.iter().map(|u| u.entity.as_deref()).collect();
    assert_eq!(named, [Some("LINE 7F (line 12)")]);
}

/// A flange of diameter 40 and height 5 with a boss of diameter 16 up to 20, and a fillet of 4 between them,
/// with its limits drawn.
#[test]
fn the_limits_of_a_fillet_around_a_boss_may_be_drawn() {
    let level = |r: f64, z: f64| line([-r, z], [r, z]);
    let mut across = vec![level(20.0, 0.0), level(20.0, 5.0), level(8.0, 20.0), level(8.0, 9.0)];
    for sign in [-1.0, 1.0] {
        across.push(line([sign * 20.0, 0.0], [sign * 20.0, 5.0]));
        across.push(line([sign * 8.0, 9.0], [sign * 8.0, 20.0]));
        let start = if sign > 0.0 { PI } else { 3.0 * FRAC_PI_2 };
        across.push(visible(arc([sign * 12.0, 9.0], 4.0, start, FRAC_PI_2)));
    }
    let top = [20.0, 8.0, 12.0].map(|r| visible(circle([0.0, 0.0], r))).to_vec();
    let solution = best(&turned(across, top));
    assert_eq!(solution.solid.faces_by_kind(), [3, 2, 0, 0, 1]);
    let fillet = 2.0 * PI * (16.0 * 10.0 - PI * 4.0 * (12.0 - 16.0 / (3.0 * PI)));
    assert_near(solution.measures.volume, 2000.0 * PI + 64.0 * 15.0 * PI + fillet, 1e-9);
}

#[test]
fn the_line_where_a_dome_begins_may_be_drawn() {
    let mut across = vec![line([-10.0, 0.0], [-10.0, 20.0]), line([10.0, 0.0], [10.0, 20.0])];
    across.push(visible(arc([0.0, 20.0], 10.0, 0.0, PI)));
    across.push(line([-10.0, 0.0], [10.0, 0.0]));
    across.push(line([-10.0, 20.0], [10.0, 20.0]));
    let solution = best(&turned(across, vec![visible(circle([0.0, 0.0], 10.0))]));
    assert_eq!(solution.solid.faces_by_kind(), [1, 1, 0, 1, 0]);
    assert_near(solution.measures.volume, 2000.0 * PI + 2000.0 / 3.0 * PI, 1e-12);
}
