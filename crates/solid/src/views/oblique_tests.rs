//! Drawings of parts with faces oblique to all views.

use super::tests::{rectangle, segment, visible};
use super::*;
use std::f64::consts::{FRAC_PI_2, PI};

fn only(drawing: &Drawing) -> Solution {
    let found = solve(drawing).unwrap();
    assert_eq!(
        (found.solutions.len(), found.complete),
        (1, true),
        "{:?} {:?}",
        found.unexplained,
        found.rejected
    );
    let solution = found.solutions.into_iter().next().unwrap();
    solution.solid.check(1e-6).unwrap();
    solution
}

#[test]
fn cube_without_a_corner_has_one_oblique_plane() {
    let view = |kind, cut: [[f64; 2]; 2]| {
        let mut curves: Vec<DrawnCurve> = rectangle([0.0, 0.0], [10.0, 10.0]);
        curves.push(segment(cut[0], cut[1], LineStyle::Visible));
        View::new(kind, curves)
    };
    // Through (7, 0, 10), (10, 4, 10) and (10, 0, 5).
    let drawing = Drawing {
        views: vec![
            view(ViewKind::Front, [[7.0, 10.0], [10.0, 5.0]]),
            view(ViewKind::Top, [[7.0, 0.0], [10.0, 4.0]]),
            view(ViewKind::Side, [[4.0, 10.0], [0.0, 5.0]]),
        ],
    };
    let solution = only(&drawing);
    assert_eq!(solution.solid.faces_by_kind(), [7, 0, 0, 0, 0]);
    assert!((solution.measures.volume - 990.0).abs() < 1e-8);
}

/// Three unit vectors at right angles, none near an axis.
const FRAME: [DVec3; 3] = [
    DVec3::new(2.0 / 15.0, 10.0 / 15.0, 11.0 / 15.0),
    DVec3::new(14.0 / 15.0, -5.0 / 15.0, 2.0 / 15.0),
    DVec3::new(5.0 / 15.0, 10.0 / 15.0, -10.0 / 15.0),
];

/// A block turned about all axes, one edge along its third direction rounded where the radius is not zero;
/// edges of tangent faces are not drawn.
struct Block {
    frame: [DVec3; 3],
    size: [f64; 3],
    radius: f64,
}

impl Block {
    fn at(&self, DVec3 { x, y, z }: DVec3) -> DVec3 {
        let [a, b, c] = self.frame;
        x * a + y * b + z * c
    }

    fn drawing(&self) -> Drawing {
        let kinds = ViewKind::ALL.into_iter();
        Drawing { views: kinds.map(|kind| self.view(kind)).collect() }
    }

    fn view(&self, kind: ViewKind) -> View {
        let [right, up, sight] = kind.axes();
        let mut eye = DVec3::ZERO;
        eye[sight] = if kind.depth_increases_away() { -1.0 } else { 1.0 };
        let image = |p: DVec3| [self.at(p)[right], self.at(p)[up]];
        let faces = |n: DVec3| self.at(n).dot(eye) > 0.0;
        let style = |is_seen: bool| {
            if is_seen { LineStyle::Visible } else { LineStyle::Hidden }
        };
        let [w, h, d] = self.size;
        let r = self.radius;
        let mut curves = Vec::new();
        let mut line = |p: DVec3, q: DVec3, n: DVec3, m: DVec3| {
            curves.push(segment(image(p), image(q), style(faces(n) || faces(m))));
        };
        // Outward normals of the sides, and corners between them; the last corner may be rounded.
        let sides = [DVec3::new(0.0, -1.0, 0.0), DVec3::X, DVec3::Y, DVec3::new(-1.0, 0.0, 0.0)];
        let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
        for k in 0..4 {
            let ([x, y], before) = (corners[k], sides[(k + 3) % 4]);
            if k != 2 || r == 0.0 {
                line(DVec3::new(x, y, 0.0), DVec3::new(x, y, d), before, sides[k]);
            }
            let (mut p, mut q) = (corners[k], corners[(k + 1) % 4]);
            if k == 1 {
                q[1] -= r;
            }
            if k == 2 {
                p[0] -= r;
            }
            for (z, n) in [(0.0, DVec3::new(0.0, 0.0, -1.0)), (d, DVec3::Z)] {
                line(DVec3::new(p[0], p[1], z), DVec3::new(q[0], q[1], z), sides[k], n);
            }
        }
        if r > 0.0 {
            let around = |t: f64| DVec3::new(t.cos(), t.sin(), 0.0);
            let on = |t: f64, z: f64| DVec3::new(w - r + r * t.cos(), h - r + r * t.sin(), z);
            // Where the line of sight touches the cylinder.
            let [x, y] = [0, 1].map(|k| self.frame[k].dot(eye));
            let touching = (-x).atan2(y).rem_euclid(PI);
            let mut cuts = vec![0.0, FRAC_PI_2];
            if touching < FRAC_PI_2 {
                cuts.insert(1, touching);
                let curve = Curve2::Segment(image(on(touching, 0.0)), image(on(touching, d)));
                curves.push(visible(curve));
            }
            for (z, n) in [(0.0, DVec3::new(0.0, 0.0, -1.0)), (d, DVec3::Z)] {
                for cut in cuts.windows(2) {
                    let middle = (cut[0] + cut[1]) / 2.0;
                    let t = |k: usize| cut[0] + (cut[1] - cut[0]) * k as f64 / 60.0;
                    curves.push(DrawnCurve {
                        curve: Curve2::Chain((0..=60).map(|k| image(on(t(k), z))).collect()),
                        style: style(faces(n) || faces(around(middle))),
                        entity: "arc".to_owned(),
                    });
                }
            }
        }
        View::new(kind, curves)
    }
}

#[test]
fn a_block_turned_about_all_axes_is_the_only_solid_of_its_views() {
    let block = Block { frame: FRAME, size: [10.0, 8.0, 6.0], radius: 0.0 };
    let solution = only(&block.drawing());
    assert_eq!(solution.solid.faces_by_kind(), [6, 0, 0, 0, 0]);
    assert!((solution.measures.volume / 480.0 - 1.0).abs() < 1e-9);
}

#[test]
fn a_rounded_edge_of_a_turned_block_is_a_cylinder() {
    let block = Block { frame: FRAME, size: [10.0, 8.0, 6.0], radius: 3.0 };
    let solution = only(&block.drawing());
    assert_eq!(solution.solid.faces_by_kind(), [6, 1, 0, 0, 0]);
    let volume = 6.0 * (80.0 - 9.0 * (1.0 - PI / 4.0));
    // The tangent plane of the cylinder is measured independently of it.
    assert!((solution.measures.volume / volume - 1.0).abs() < 1e-7);
}

#[test]
fn missing_edge_of_an_oblique_block_is_reported() {
    let block = Block { frame: FRAME, size: [10.0, 8.0, 6.0], radius: 0.0 };
    let mut drawing = block.drawing();
    drawing.views[0].curves.remove(0);
    let found = solve(&drawing).unwrap();
    assert!(found.solutions.is_empty() && !found.unexplained.is_empty());
}
