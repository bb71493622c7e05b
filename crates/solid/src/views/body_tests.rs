//! Solids whose parts touch or are apart, and drawings with many balls.

use super::tests::{arc, circle, rectangle, segment, visible};
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

#[test]
fn a_pin_in_a_plate_is_a_body_of_its_own() {
    let hidden = |a, b| segment(a, b, LineStyle::Hidden);
    let side = |[from, to]: [f64; 2]| {
        let mut curves = rectangle([0.0, 0.0], [40.0, 12.0]);
        curves.extend(rectangle([from, 12.0], [to, 30.0]).into_iter().skip(1));
        curves.extend([from, to].map(|u| hidden([u, 0.0], [u, 12.0])));
        curves
    };
    let mut top = rectangle([0.0, 0.0], [40.0, 40.0]);
    top.push(visible(circle([15.0, 20.0], 6.0)));
    let found = solve(&drawing(vec![
        (ViewKind::Front, side([9.0, 21.0])),
        (ViewKind::Top, top),
        (ViewKind::Side, side([14.0, 26.0])),
    ]))
    .unwrap();
    let [only] = &found.solutions[..] else { panic!("{:?}", found.rejected) };
    assert_eq!(only.solid.bodies().len(), 2);
    assert_eq!(only.solid.faces_by_kind()[..2], [8, 2]);
    assert_near(only.measures.volume, 1600.0 * 12.0 + 36.0 * PI * 18.0, 1e-9);
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

#[test]
fn nine_countersunk_holes_go_through_first() {
    let hidden = |a, b| segment(a, b, LineStyle::Hidden);
    let places = [10.0, 30.0, 50.0];
    let mut side = rectangle([0.0, 0.0], [60.0, 10.0]);
    let mut top = rectangle([0.0, 0.0], [60.0, 60.0]);
    for u in places {
        side.push(hidden([u - 2.0, 8.0], [u + 2.0, 8.0]));
        for sign in [-1.0, 1.0] {
            side.push(hidden([u + 2.0 * sign, 0.0], [u + 2.0 * sign, 8.0]));
            side.push(hidden([u + 2.0 * sign, 8.0], [u + 4.0 * sign, 10.0]));
        }
        top.extend(places.iter().flat_map(|v| [2.0, 4.0].map(|r| visible(circle([u, *v], r)))));
    }
    let views = vec![(ViewKind::Front, side.clone()), (ViewKind::Top, top), (ViewKind::Side, side)];
    let found = solve(&drawing(views)).unwrap();
    let hole = PI * 4.0 * 8.0 + PI * 2.0 / 3.0 * (16.0 + 8.0 + 4.0);
    assert_near(found.solutions[0].measures.volume, 36_000.0 - 9.0 * hole, 1e-9);
    // In each row and column, one hole explains the hidden lines, so the others may be dimples.
    assert!(found.solutions.len() > 1);
}

/// A plane that ends elsewhere divides the edge of a pocket's floor 0.09 before the rounding of its corner
/// begins. The rounding is then nearer to the middle of this part than points around an edge usually are.
#[test]
fn a_plane_that_passes_close_to_a_rounded_corner_leaves_the_pocket_closed() {
    let hidden = |a, b| segment(a, b, LineStyle::Hidden);
    let slope = 10.0 / 9.09;
    let high = 20.0 + 6.0 * slope;
    let corners = [[0.0, 0.0], [50.0, 0.0], [50.0, high], [40.0, high], [34.0, 20.0], [0.0, 20.0]];
    let mut side: Vec<DrawnCurve> = (0..6).map(|k| line(corners[k], corners[(k + 1) % 6])).collect();
    let mut front = rectangle([0.0, 0.0], [40.0, high]);
    front.push(line([0.0, 20.0], [40.0, 20.0]));
    for view in [&mut side, &mut front] {
        view.push(hidden([10.0, 10.0], [30.0, 10.0]));
        view.extend([10.0, 30.0].map(|u| hidden([u, 10.0], [u, 20.0])));
    }
    let mut top = rectangle([0.0, 0.0], [40.0, 50.0]);
    top.extend([34.0, 40.0].map(|v| line([0.0, v], [40.0, v])));
    for (k, center) in [[25.0, 25.0], [15.0, 25.0], [15.0, 15.0], [25.0, 15.0]].into_iter().enumerate() {
        top.push(visible(arc(center, 5.0, PI / 2.0 * k as f64, PI / 2.0)));
    }
    for u in [10.0, 30.0] {
        top.extend([line([u, 15.0], [u, 25.0]), line([15.0, u], [25.0, u])]);
    }
    let views = vec![(ViewKind::Front, front), (ViewKind::Top, top), (ViewKind::Side, side)];
    let best = solve(&drawing(views)).unwrap().solutions.remove(0);
    let profile = 34.0 * 20.0 + 6.0 * (20.0 + high) / 2.0 + 10.0 * high;
    let pocket = 10.0 * (400.0 - (4.0 - PI) * 25.0);
    assert_near(best.measures.volume, 40.0 * profile - pocket, 1e-9);
}
