//! `planish solid` on difficult drawings: touching bodies, small gaps, very small tolerances; and options of
//! `planish contour` that do not apply.

use crate::support::planish;
use std::fmt::Write;
use std::path::Path;

/// A DXF file of lines (from, to) and arcs (centre, radius, from and to in degrees).
fn dxf(lines: &[[f64; 4]], arcs: &[[f64; 5]]) -> String {
    let mut text = "0\nSECTION\n2\nENTITIES\n".to_owned();
    for (k, [a, b, c, d]) in lines.iter().enumerate() {
        write!(text, "0\nLINE\n5\n{k:X}\n8\n0\n10\n{a}\n20\n{b}\n11\n{c}\n21\n{d}\n").expect("text");
    }
    for (k, [x, y, r, from, to]) in arcs.iter().enumerate() {
        write!(text, "0\nARC\n5\nA{k:X}\n8\n0\n10\n{x}\n20\n{y}\n40\n{r}\n50\n{from}\n51\n{to}\n")
            .expect("text");
    }
    text + "0\nENDSEC\n0\nEOF\n"
}

fn rectangle([x, y]: [f64; 2], [w, h]: [f64; 2]) -> Vec<[f64; 4]> {
    let corners = [[x, y], [x + w, y], [x + w, y + h], [x, y + h]];
    (0..4).map(|k| [corners[k][0], corners[k][1], corners[(k + 1) % 4][0], corners[(k + 1) % 4][1]]).collect()
}

fn put(folder: &Path, name: &str, lines: &[[f64; 4]], arcs: &[[f64; 5]]) {
    std::fs::write(folder.join(name), dxf(lines, arcs)).expect("a drawing");
}

/// A half circle over a circle.
fn dome(folder: &Path) {
    put(folder, "front.dxf", &[[-10.0, 0.0, 10.0, 0.0]], &[[0.0, 0.0, 10.0, 0.0, 180.0]]);
    put(folder, "top.dxf", &[], &[[0.0, 0.0, 10.0, 0.0, 180.0], [0.0, 0.0, 10.0, 180.0, 360.0]]);
}

#[test]
fn candidates_touching_along_a_line_are_not_written() {
    let folder = tempfile::tempdir().expect("a folder");
    dome(folder.path());
    let result = planish(folder.path(), &["solid", "front.dxf", "top.dxf", "--all", "-o", "dome.step"]).ok();
    assert!(result.stdout.contains("4 solids have these views, best first."), "{}", result.stdout);
    assert!(
        result.stdout.contains("1 more candidate is invalid: two bodies only touch along a line through"),
        "{}",
        result.stdout
    );
    assert!(folder.path().join("dome.4.step").exists() && !folder.path().join("dome.5.step").exists());
}

#[test]
fn separate_bodies_share_one_step_file() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, second) in [("front.dxf", [20.0, 0.0]), ("top.dxf", [20.0, 15.0]), ("side.dxf", [15.0, 0.0])] {
        let mut lines = rectangle([0.0, 0.0], [10.0, 10.0]);
        lines.extend(rectangle(second, [10.0, 10.0]));
        put(folder.path(), name, &lines, &[]);
    }
    planish(folder.path(), &["solid", "front.dxf", "top.dxf", "side.dxf", "-o", "two.step"]).ok();
    let step = std::fs::read_to_string(folder.path().join("two.step")).expect("the solids");
    assert_eq!(step.matches("MANIFOLD_SOLID_BREP(").count(), 2);
    assert_eq!(step.matches("BREP_WITH_VOIDS(").count(), 0);
}

#[test]
fn too_fine_mesh_tolerance_suggests_a_larger_one() {
    let folder = tempfile::tempdir().expect("a folder");
    dome(folder.path());
    let mesh = |tolerance: &str| {
        let options = ["solid", "front.dxf", "top.dxf", "-o", "dome.ply", "--mesh-tolerance", tolerance];
        planish(folder.path(), &options)
    };
    let refused = mesh("1e-9");
    assert_eq!(refused.code, 2, "{}", refused.stderr);
    assert!(refused.stderr.contains("for a chord error of 1e-9"), "{}", refused.stderr);
    assert!(refused.stderr.contains("(option --mesh-tolerance)"), "{}", refused.stderr);
    assert!(!folder.path().join("dome.ply").exists());
    mesh("1e-3").ok();
}

#[test]
fn small_gaps_are_reported_and_joined_with_tolerance() {
    let folder = tempfile::tempdir().expect("a folder");
    let views = ["solid", "front.dxf", "top.dxf", "side.dxf", "-o", "block.step"];
    let solve = |more: &[&str]| planish(folder.path(), &[&views, more].concat());
    let mut front = rectangle([0.0, 0.0], [40.0, 20.0]);
    front[0][2] -= 1.37e-4;
    put(folder.path(), "front.dxf", &front, &[]);
    put(folder.path(), "top.dxf", &rectangle([0.0, 0.0], [40.0, 30.0]), &[]);
    put(folder.path(), "side.dxf", &rectangle([0.0, 0.0], [30.0, 20.0]), &[]);
    let estimated = solve(&[]).ok();
    assert!(
        estimated.stderr.contains("coordinates that differ by up to 0.00015 are the same"),
        "{}",
        estimated.stderr
    );
    assert!(estimated.stdout.contains("24000"), "{}", estimated.stdout);
    let given = solve(&["--tolerance", "2e-4"]).ok();
    assert!(!given.stderr.contains("are the same"), "{}", given.stderr);
    put(folder.path(), "front.dxf", &rectangle([0.0, 0.0], [40.0, 20.0]), &[]);
    put(folder.path(), "top.dxf", &rectangle([0.0, 0.0], [40.04, 30.03]), &[]);
    let estimated = solve(&[]).ok();
    assert!(estimated.stderr.contains("differ by up to 0.044 are the same"), "{}", estimated.stderr);
    let joined = solve(&["--tolerance", "0.05"]).ok();
    assert!(joined.stdout.contains("24000"), "{}", joined.stdout);
}

#[test]
fn options_that_do_not_apply_are_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let points: String = (0..60)
        .map(|k| {
            let angle = 0.1 * f64::from(k);
            format!("{},{},0.01\n", 10.0 * angle.cos(), 10.0 * angle.sin())
        })
        .collect();
    std::fs::write(folder.path().join("points.csv"), format!("x,y,sigma\n{points}")).expect("readings");
    for (option, value) in
        [("--region", "0,0,4,3"), ("--pixel-size", "0.05"), ("--scan", "3"), ("--sigma-range", "0.1")]
    {
        let result = planish(folder.path(), &["contour", "points.csv", "--kind", "circle", option, value]);
        assert_eq!(result.code, 2, "{}", result.stderr);
        assert!(result.stderr.contains(&format!("(option {option})")), "{}", result.stderr);
    }
    planish(folder.path(), &["contour", "points.csv", "--kind", "circle"]).ok();
}

#[test]
fn given_lengths_accept_units_and_impossible_ones_are_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    planish(folder.path(), &["simulate", "scene", "readings", "--shape", "rectangle", "--out", "seen"]).ok();
    let given = |sentence: &str| {
        let options = ["contour", "seen/readings.csv", "--kind", "rectangle", "--given", sentence];
        planish(folder.path(), &options)
    };
    let empty = given("P1P2 is 0 long");
    assert_eq!(empty.code, 2, "{}", empty.stderr);
    assert!(
        empty.stderr.contains("`P1P2 is 0 long` cannot be satisfied by these contours"),
        "{}",
        empty.stderr
    );
    let huge = given("P1P2 is 1e300 long");
    assert!(huge.stderr.len() < 400, "{}", huge.stderr);
    given("P1P2 is 100mm long").ok();
    let unknown = given("P1P2 is 100km long");
    assert_eq!(unknown.code, 2);
    assert!(unknown.stderr.contains("expected `mm`, `m`, `in` or `ft`"), "{}", unknown.stderr);
}
