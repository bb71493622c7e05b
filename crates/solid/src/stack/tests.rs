use super::{SectionLoop, Slab, stack_of};
use std::f64::consts::PI;

fn rectangle([x0, y0, x1, y1]: [f64; 4]) -> SectionLoop {
    SectionLoop::Outline { vertices: vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]], bulges: vec![0.0; 4] }
}

fn slabs(each: &[(f64, f64, Vec<SectionLoop>)]) -> Vec<Slab> {
    each.iter()
        .map(|(bottom, top, loops)| Slab { bottom: *bottom, top: *top, loops: loops.clone() })
        .collect()
}

#[test]
fn a_bracket_shares_three_walls_of_both_sections() {
    let solid = stack_of(&slabs(&[
        (0.0, 10.0, vec![rectangle([0.0, 0.0, 60.0, 40.0])]),
        (10.0, 50.0, vec![rectangle([0.0, 0.0, 8.0, 40.0])]),
    ]))
    .unwrap();
    assert!((solid.measures().volume - (24_000.0 + 12_800.0)).abs() < 1e-6);
    // Two flat faces of the foot, the top, and four walls of each slab.
    assert_eq!(solid.faces_by_kind(), [11, 0, 0, 0, 0]);
}

#[test]
fn a_pocket_and_a_through_hole_are_holes_of_sections() {
    let plate = rectangle([0.0, 0.0, 80.0, 50.0]);
    let hole = SectionLoop::Circle { center: [60.0, 25.0], radius: 6.0 };
    let pocket = SectionLoop::Outline {
        vertices: vec![[15.0, 15.0], [35.0, 15.0], [35.0, 35.0], [15.0, 35.0]],
        bulges: vec![0.0, 1.0, 0.0, 1.0],
    };
    let solid = stack_of(&slabs(&[
        (0.0, 12.0, vec![plate.clone(), hole.clone()]),
        (12.0, 20.0, vec![pocket, hole, plate]),
    ]))
    .unwrap();
    let slot = 20.0 * 20.0 + PI * 100.0;
    let volume = (4000.0 - PI * 36.0) * 20.0 - slot * 8.0;
    assert!((solid.measures().volume - volume).abs() < 1e-6 * volume, "{}", solid.measures().volume);
}

#[test]
fn crossing_sections_are_cut_at_their_crossings() {
    // A cross of two bars on top of each other.
    let solid = stack_of(&slabs(&[
        (0.0, 5.0, vec![rectangle([-30.0, -5.0, 30.0, 5.0])]),
        (5.0, 9.0, vec![rectangle([-5.0, -30.0, 5.0, 30.0])]),
    ]))
    .unwrap();
    assert!((solid.measures().volume - 600.0 * 9.0).abs() < 1e-6);
}

#[test]
fn what_is_no_body_is_refused() {
    let apart = slabs(&[
        (0.0, 5.0, vec![rectangle([0.0, 0.0, 10.0, 10.0])]),
        (5.0, 9.0, vec![rectangle([20.0, 0.0, 30.0, 10.0])]),
    ]);
    assert!(stack_of(&apart).unwrap_err().to_string().contains("2 bodies"));
    let crossed = slabs(&[
        (0.0, 5.0, vec![rectangle([0.0, 0.0, 10.0, 10.0])]),
        (5.0, 9.0, vec![SectionLoop::Circle { center: [10.0, 5.0], radius: 3.0 }]),
    ]);
    assert!(stack_of(&crossed).unwrap_err().to_string().contains("crosses"));
    assert!(stack_of(&[]).is_err());
}
