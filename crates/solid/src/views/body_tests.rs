//! Solids whose parts touch or are apart, and drawings with many balls.

use super::tests::{arc, circle, rectangle, visible};
use super::turned_tests::{assert_near, drawing, line};
use super::*;
use std::f64::consts::PI;

/// Two cubes of side 10; the second one starts at the given place, in the same height.
fn two_cubes([x, y]: [f64; 2]) -> Drawing {
    let both = |a: [f64; 2], b: [f64; 2]| {
        let mut curves = rectangle(a, [a[0] + 10.0, a[1] + 10.0]);
        curves.extend(rectangle(b, [b[0] + 10.0, b[1] + 10.0]));
        curves
    };
    drawing(vec![
        (ViewKind::Front, both([0.0, 0.0], [x, 0.0])),
        (ViewKind::Top, both([0.0, 0.0], [x, y])),
        (ViewKind::Side, both([0.0, 0.0], [y, 0.0])),
    ])
}

#[test]
fn two_cubes_apart_are_two_bodies() {
    let found = solve(&two_cubes([15.0, 15.0])).unwrap();
    let best = &found.solutions[0];
    assert_near(best.measures.volume, 2000.0, 1e-12);
    assert_eq!(best.solid.bodies().len(), 2);
    assert_eq!(best.solid.contacts(1e-3), []);
}

#[test]
fn bodies_of_a_solid_that_is_inside_out_are_all_found() {
    let found = solve(&two_cubes([15.0, 15.0])).unwrap();
    let mut solid = found.solutions[0].solid.clone();
    for face in &mut solid.faces {
        face.outward = !face.outward;
        for edges in &mut face.loops {
            edges.reverse();
            edges.iter_mut().for_each(|c| c.forward = !c.forward);
        }
    }
    assert!(solid.shells().iter().all(|shell| solid.volume_of(shell) < 0.0));
    assert_eq!(solid.bodies().len(), 2);
}

#[test]
fn two_cubes_that_touch_along_an_edge_are_no_solid() {
    let refused = solve(&two_cubes([10.0, 10.0])).unwrap_err().to_string();
    assert!(refused.contains("two bodies only touch along a line through 10.0000 10.0000"), "{refused}");
}

/// Half balls of radius 10 on a plate of height 5, in front and top view.
fn domes(at: &[[f64; 2]], width: f64, depth: f64) -> Drawing {
    let mut front = rectangle([-width / 2.0, 0.0], [width / 2.0, 5.0]);
    let mut top = rectangle([-width / 2.0, -depth / 2.0], [width / 2.0, depth / 2.0]);
    let mut drawn: Vec<f64> = Vec::new();
    for center in at {
        top.push(visible(circle(*center, 10.0)));
        if !drawn.contains(&center[0]) {
            drawn.push(center[0]);
            front.push(visible(arc([center[0], 5.0], 10.0, 0.0, PI)));
        }
    }
    drawing(vec![(ViewKind::Front, front), (ViewKind::Top, top)])
}

#[test]
fn dome_in_two_views_gives_only_manifold_solids() {
    let half = vec![visible(arc([0.0, 0.0], 10.0, 0.0, PI)), line([-10.0, 0.0], [10.0, 0.0])];
    let top = vec![visible(circle([0.0, 0.0], 10.0))];
    let found = solve(&drawing(vec![(ViewKind::Front, half), (ViewKind::Top, top)])).unwrap();
    assert_eq!(found.solutions.len(), 4);
    assert!(found.solutions.iter().all(|s| s.solid.contacts(1e-3).is_empty()));
    let [dropped] = &found.rejected[..] else { panic!("{:?}", found.rejected) };
    assert_eq!(dropped.reason, CandidateRejection::Touches);
    assert!(dropped.message.starts_with("two bodies only touch along a line"), "{}", dropped.message);
}

#[test]
fn three_domes_in_two_views_are_three_half_balls_first() {
    let row = domes(&[[-24.0, 0.0], [0.0, 0.0], [24.0, 0.0]], 80.0, 30.0);
    let best = solve(&row).unwrap().solutions.remove(0);
    assert_eq!(best.solid.faces_by_kind(), [6, 0, 0, 3, 0]);
    assert_near(best.measures.volume, 12_000.0 + 2000.0 * PI, 1e-9);
}

#[test]
fn four_domes_in_two_views_are_four_half_balls_first() {
    let square = domes(&[[-12.0, -12.0], [12.0, -12.0], [-12.0, 12.0], [12.0, 12.0]], 54.0, 54.0);
    let best = solve(&square).unwrap().solutions.remove(0);
    assert_eq!(best.solid.faces_by_kind(), [6, 0, 0, 4, 0]);
    assert_near(best.measures.volume, 54.0 * 54.0 * 5.0 + 8000.0 / 3.0 * PI, 1e-9);
}
