//! `planish merge`.

use crate::support::planish;
use std::fmt::Write;
use std::path::Path;

/// A zone of a ball of radius 10 between two latitudes as OBJ, with its rows rotated, optionally facing
/// inwards.
fn zone(path: &Path, from_deg: f64, to_deg: f64, turn_deg: f64, scale: f64, inwards: bool) {
    const AROUND: usize = 72;
    const ROWS: usize = 30;
    let mut text = String::new();
    for row in 0..=ROWS {
        let latitude = (from_deg + (to_deg - from_deg) * row as f64 / ROWS as f64).to_radians();
        for column in 0..AROUND {
            let longitude = (turn_deg + 360.0 * column as f64 / AROUND as f64).to_radians();
            let (r, z) = (10.0 * scale * latitude.cos(), 10.0 * scale * latitude.sin());
            writeln!(text, "v {} {} {}", r * longitude.cos(), r * longitude.sin(), z).expect("text");
        }
    }
    for row in 0..ROWS {
        for column in 0..AROUND {
            let at = |i: usize, j: usize| 1 + (row + i) * AROUND + (column + j) % AROUND;
            let mut square = [[at(0, 0), at(0, 1), at(1, 1)], [at(0, 0), at(1, 1), at(1, 0)]];
            if inwards {
                square.iter_mut().for_each(|t| t.swap(1, 2));
            }
            for [a, b, c] in square {
                writeln!(text, "f {a} {b} {c}").expect("text");
            }
        }
    }
    std::fs::write(path, text).expect("a file");
}

#[test]
fn two_zones_of_a_ball_merge_for_any_orientation() {
    let folder = tempfile::tempdir().expect("a folder");
    zone(&folder.path().join("low.obj"), -80.0, 20.0, 0.0, 1.0, false);
    zone(&folder.path().join("high.obj"), -10.0, 80.0, 2.3, 1.0, true);
    let result = planish(folder.path(), &["merge", "low.obj", "high.obj", "-o", "whole.ply", "--json"]).ok();
    let found = result.json();
    // The poles are not covered by a patch and stay open.
    assert_eq!(found["boundary_edges"], 144, "{found:#}");
    assert_eq!((&found["nonmanifold_edges"], &found["parts"]), (&0.into(), &1.into()));
    assert_eq!(found["regions"].as_array().map(Vec::len), Some(1));
    assert!(result.stderr.contains("was reversed"), "{}", result.stderr);
    let read = planish(folder.path(), &["info", "whole.ply", "--json"]).ok().json();
    assert_eq!((&read["manifold"], &read["components"]), (&true.into(), &1.into()), "{read:#}");
    let area = read["area"].as_f64().expect("a number");
    let exact = 2.0 * std::f64::consts::PI * 100.0 * 2.0 * 80_f64.to_radians().sin();
    assert!((area / exact - 1.0).abs() < 0.01, "{area}, {exact}");
    // With --fill, the poles are filled smoothly and marked; larger holes stay open.
    let filled = planish(
        folder.path(),
        &["merge", "low.obj", "high.obj", "--fill", "72", "--curvature", "-o", "filled.ply", "--json"],
    )
    .ok()
    .json();
    let (watertight, lids) = (&filled["watertight"], &filled["filled"]);
    assert_eq!(
        (watertight, &lids["holes"], &lids["left_open"]),
        (&true.into(), &2.into(), &0.into()),
        "{filled:#}"
    );
    assert!(lids["vertices"].as_u64() > Some(100), "{filled:#}");
    let read = planish(folder.path(), &["info", "filled.ply", "--json"]).ok().json();
    let columns = read["columns"].to_string();
    assert!(columns.contains("mean_curvature") && columns.contains("border"), "{read:#}");
    let view =
        ["view", "filled.ply", "--color", "mean-curvature", "--size", "200x150", "-o", "k.png", "--json"];
    let viewed = planish(folder.path(), &view).ok().json();
    assert_eq!(viewed["color"], "mean_curvature", "{viewed:#}");
    let left =
        planish(folder.path(), &["merge", "low.obj", "high.obj", "--fill", "71", "--json"]).ok().json();
    assert_eq!((&left["filled"]["holes"], &left["filled"]["left_open"]), (&0.into(), &2.into()));
}

#[test]
fn sigma_column_is_used_and_smaller_in_overlaps() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, from, to) in [("a", -60.0, 30.0), ("b", -30.0, 60.0)] {
        zone(&folder.path().join("zone.obj"), from, to, 0.7, 1.0, false);
        let text = std::fs::read_to_string(folder.path().join("zone.obj")).expect("text");
        let vertices: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("v ")).collect();
        let faces: Vec<Vec<usize>> = text
            .lines()
            .filter_map(|l| l.strip_prefix("f "))
            .map(|l| l.split(' ').map(|k| k.parse::<usize>().expect("a number") - 1).collect())
            .collect();
        let mut ply = format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
             property double z\nproperty double sigma\nelement face {}\n\
             property list uchar int vertex_indices\nend_header\n",
            vertices.len(),
            faces.len()
        );
        for v in vertices {
            writeln!(ply, "{v} 0.02").expect("text");
        }
        for f in faces {
            writeln!(ply, "3 {} {} {}", f[0], f[1], f[2]).expect("text");
        }
        std::fs::write(folder.path().join(format!("{name}.ply")), ply).expect("a file");
    }
    let found = planish(folder.path(), &["merge", "a.ply", "b.ply", "--json"]).ok().json();
    assert_eq!(found["sigma_estimated"], false);
    let sigma = |key: &str| found["sigma"][key].as_f64().expect("a number");
    assert!((sigma("max") - 0.02).abs() < 1e-12, "{found:#}");
    let read = found["patches"][0]["sigma"].as_f64().expect("a number");
    assert!((read - 0.02).abs() < 1e-12);
}

#[test]
fn merged_mesh_is_written_as_a_spline() {
    let folder = tempfile::tempdir().expect("a folder");
    zone(&folder.path().join("low.obj"), -60.0, 20.0, 0.0, 1.0, false);
    zone(&folder.path().join("high.obj"), -10.0, 60.0, 2.3, 1.0, false);
    let found = planish(
        folder.path(),
        &["merge", "low.obj", "high.obj", "-o", "whole.step", "-o", "whole.planish", "--json"],
    )
    .ok()
    .json();
    let spline = &found["spline"];
    assert!(spline["coefficients"].as_u64().expect("a number") > 16, "{found:#}");
    assert!(spline["rms"].as_f64().expect("a number") < 0.02, "{found:#}");
    let step = std::fs::read_to_string(folder.path().join("whole.step")).expect("a STEP file");
    assert!(step.contains("B_SPLINE_SURFACE"));
    let read = planish(folder.path(), &["info", "whole.planish", "--json"]).ok().json();
    assert_eq!(read["coefficients"], spline["coefficients"], "{read:#}");
}

#[test]
fn inputs_that_cannot_be_merged_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("a.obj"), -60.0, 10.0, 0.0, 1.0, false);
    zone(&path("far.obj"), -60.0, 10.0, 0.0, 2.0, false);
    std::fs::copy(path("a.obj"), path("copy.obj")).expect("a copy");
    std::fs::write(path("points.xyz"), "0 0 0\n1 0 0\n0 1 0\n").expect("a file");
    for (name, text) in [
        ("empty.obj", ""),
        ("nan.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
        (
            "zero.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n\
             property double z\nproperty double sigma\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n0 0 0 0.1\n1 0 0 0\n0 1 0 0.1\n3 0 1 2\n",
        ),
        ("part.step", "ISO-10303-21;\n"),
        ("part.iges", "an older part\n"),
    ] {
        std::fs::write(path(name), text).expect("a file");
    }
    for (line, code, words) in [
        ("merge a.obj -o w.ply", 2, "two patches"),
        ("merge a.obj far.obj -o w.ply", 1, "overlap"),
        ("merge a.obj points.xyz -o w.ply", 2, "unconnected points"),
        ("merge a.obj far.obj -o w.tif", 2, "cannot write this format"),
        ("merge a.obj far.obj -o a.obj", 2, "a.obj"),
        ("merge a.obj none.obj", 3, "none.obj"),
        ("merge a.obj empty.obj -o w.ply", 2, "empty.obj: the file is empty"),
        ("merge a.obj nan.obj -o w.ply", 2, "nan.obj: line 2"),
        ("merge a.obj line.obj -o w.ply", 1, "overlap"),
        ("merge a.obj zero.ply -o w.ply", 2, "zero.ply: vertex 1: expected σ > 0, found 0"),
        ("merge a.obj part.step -o w.ply", 2, "part.step: line 1: the file ends before `END-ISO-10303-21;`"),
        ("merge a.obj part.iges -o w.ply", 2, "found IGES, which is not supported: convert it to STEP"),
        ("merge a.obj --align -o w.ply", 2, "two patches"),
        ("merge a.obj copy.obj -o w.ply", 2, "copy.obj has the same vertices as a.obj"),
        ("merge a.obj copy.obj --align -o w.ply", 2, "counts once"),
        ("merge a.obj far.obj --epsilon 1yd", 2, "yd"),
        ("merge a.obj far.obj --theta 120", 2, "90"),
        ("merge a.obj far.obj --epsilon 0", 2, "above 0"),
    ] {
        let result = planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
        assert_eq!(result.code, code, "{line}: {}", result.stderr);
        assert!(result.stderr.contains(words), "{line}: {}", result.stderr);
        assert!(!path("w.ply").exists(), "{line}");
    }
}

/// Without σ, unrelated surfaces are merged where they are close. A warning reports it; --epsilon prevents
/// it.
#[test]
fn patches_of_different_objects_give_a_warning() {
    let folder = tempfile::tempdir().expect("a folder");
    let sheet = |name: &str, slope: f64| {
        let mut text = String::new();
        for k in 0..21 * 21 {
            let (x, y) = (5.0 * f64::from(k % 21), 5.0 * f64::from(k / 21));
            writeln!(text, "v {x} {y} {}", slope * (x - 50.0)).expect("a string");
        }
        for k in (0..20 * 20).map(|k| k / 20 * 21 + k % 20 + 1) {
            writeln!(text, "f {} {} {}\nf {} {} {}", k, k + 1, k + 22, k, k + 22, k + 21).expect("a string");
        }
        std::fs::write(folder.path().join(name), text).expect("a file");
    };
    sheet("flat.obj", 0.0);
    sheet("slanted.obj", 0.3);
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    let result = run("merge flat.obj slanted.obj -o whole.ply --unit mm");
    assert!(result.stderr.contains("flat.obj: patches near it differ by "), "{}", result.stderr);
    let result = run("merge flat.obj slanted.obj -o whole.ply --unit mm --epsilon 0.2");
    assert!(!result.stderr.contains("differ by"), "{}", result.stderr);
    sheet("near.obj", 0.001);
    let result = run("merge flat.obj near.obj -o whole.ply --unit mm");
    assert!(!result.stderr.contains("differ by"), "{}", result.stderr);
}

/// Faces of a STEP file are merged with those of another, and with a mesh.
#[test]
fn faces_of_step_files_are_patches() {
    // One half of a bent sheet is a mesh; the other half is fitted to points and written as CAD faces.
    let folder = tempfile::tempdir().expect("a folder");
    let height = |x: f64, y: f64| 3.0 * (0.09 * x).sin() * (0.07 * y).cos();
    for (name, from) in [("left", 0.0), ("right", 25.0)] {
        let mut text = String::new();
        for i in 0..=70 {
            for j in 0..=60 {
                let (x, y) = (from + 0.5 * f64::from(i), 0.5 * f64::from(j));
                writeln!(text, "{x} {y} {}", height(x, y)).expect("a string");
            }
        }
        std::fs::write(folder.path().join(format!("{name}.xyz")), text).expect("a file");
    }
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    for name in ["left", "right"] {
        run(&format!("fit {name}.xyz -o {name}.step -o {name}.ply --tolerance 0.002mm --unit mm"));
    }
    for pair in ["left.step right.step", "left.step right.ply"] {
        let found = run(&format!("merge {pair} -o whole.obj --json")).json();
        assert_eq!((&found["unit"], &found["parts"]), (&"mm".into(), &1.into()), "{pair}: {found:#}");
        assert_eq!(found["nonmanifold_edges"], 0);
        let text = std::fs::read_to_string(folder.path().join("whole.obj")).expect("a mesh");
        let (mut square, mut n) = (0.0, 0.0_f64);
        for line in text.lines().filter_map(|l| l.strip_prefix("v ")) {
            let p: Vec<f64> = line.split(' ').take(3).map(|x| x.parse().expect("a number")).collect();
            if (0.0..=60.0).contains(&p[0]) && (0.0..=30.0).contains(&p[1]) {
                square += (p[2] - height(p[0], p[1])).powi(2);
                n += 1.0;
            }
        }
        assert!(n > 1000.0 && (square / n).sqrt() < 0.01, "{pair}: {}", (square / n).sqrt());
    }
    // The same file as a reference of `compare`.
    let compared = run("compare left.step left.xyz --json").json();
    let rms = compared["backward"]["rms"].as_f64().expect("a number");
    assert!(rms < 0.01, "{rms}");
}

/// Of two files with the same vertices, one is used; the message names both.
#[test]
fn duplicate_patch_is_ignored() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("a.obj"), -60.0, 20.0, 0.0, 1.0, false);
    zone(&path("b.obj"), -20.0, 60.0, 2.3, 1.0, false);
    std::fs::copy(path("a.obj"), path("copy.obj")).expect("a copy");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    run("merge a.obj b.obj -o two.ply");
    let result = run("merge a.obj b.obj copy.obj -o three.ply");
    assert!(
        result.stderr.contains("copy.obj has the same vertices as a.obj: it was ignored"),
        "{}",
        result.stderr
    );
    let read = |name: &str| std::fs::read(path(name)).expect("a mesh");
    assert_eq!(read("two.ply"), read("three.ply"));
}

/// A copy in single precision, or with few decimals in another order of its vertices, is no new measurement.
/// The file with more digits is used, whatever their order.
#[test]
fn rounded_copies_are_ignored() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("a.obj"), -60.0, 20.0, 0.0, 1.0, false);
    zone(&path("b.obj"), -20.0, 60.0, 2.3, 1.0, false);
    let exact = std::fs::read_to_string(path("a.obj")).expect("a mesh");
    let count = exact.lines().filter(|line| line.starts_with('v')).count();
    let rounded = |digits: &dyn Fn(f64) -> String, backwards: bool| {
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        for line in exact.lines() {
            let mut words = line.split(' ');
            match words.next() {
                Some("v") => {
                    let numbers: Vec<String> =
                        words.map(|word| digits(word.parse().expect("a number"))).collect();
                    vertices.push(format!("v {}", numbers.join(" ")));
                }
                _ => {
                    let turned = |k: usize| if backwards { count + 1 - k } else { k };
                    let corners: Vec<String> =
                        words.map(|word| turned(word.parse().expect("a number")).to_string()).collect();
                    faces.push(format!("f {}", corners.join(" ")));
                }
            }
        }
        if backwards {
            vertices.reverse();
        }
        vertices.extend(faces);
        vertices.join("\n") + "\n"
    };
    std::fs::write(path("single.obj"), rounded(&|x| (x as f32).to_string(), false)).expect("a file");
    std::fs::write(path("text.obj"), rounded(&|x| format!("{x:.4}"), true)).expect("a file");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    run("merge a.obj b.obj -o two.ply");
    let two = std::fs::read(path("two.ply")).expect("a mesh");
    for (line, copy) in [
        ("merge a.obj b.obj single.obj -o three.ply", "single.obj"),
        ("merge a.obj b.obj text.obj -o three.ply", "text.obj"),
        ("merge text.obj a.obj b.obj -o three.ply", "text.obj"),
    ] {
        let result = run(line);
        let expected = format!("{copy} has the same vertices as a.obj up to rounding: it was ignored");
        assert!(result.stderr.contains(&expected), "{line}: {}", result.stderr);
        assert!(std::fs::read(path("three.ply")).expect("a mesh") == two, "{line}");
    }
}

/// The same surface with rounded numbers: zero residuals between the patches are no failure.
#[test]
fn patches_with_rounded_coordinates_are_aligned() {
    let folder = tempfile::tempdir().expect("a folder");
    zone(&folder.path().join("a.obj"), -60.0, 20.0, 0.0, 1.0, false);
    // Rotated by one of 72 columns.
    zone(&folder.path().join("b.obj"), -60.0, 20.0, 5.0, 1.0, true);
    let line = "merge a.obj b.obj --align --report page.html --json";
    let result = planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    let found = result.json();
    let page = std::fs::read_to_string(folder.path().join("page.html")).expect("a page");
    let open = found["poses"][1]["undetermined"].as_array().map_or(0, Vec::len);
    assert!(page.contains("<h2>Alignment") && page.contains(&format!("{open} of 6")));
    assert_eq!((&found["parts"], &found["nonmanifold_edges"]), (&1.into(), &0.into()));
    let moved = found["poses"][1]["moved"].as_f64().expect("a length");
    assert!(moved < 1e-6, "{moved}");
    // Of two patches of equal size, the second is flipped.
    let turned = |k: usize| found["patches"][k]["turned_over"].as_bool();
    assert_eq!((turned(0), turned(1)), (Some(false), Some(true)));
}

/// `--unit` applies to files without a unit, also if other files have one; ε may have its own unit.
#[test]
fn units_of_files_and_of_options_are_independent() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("zone.obj"), -60.0, 20.0, 0.0, 1.0, false);
    let text = std::fs::read_to_string(path("zone.obj")).expect("text");
    std::fs::write(path("named.obj"), format!("# unit mm\n{text}")).expect("a file");
    zone(&path("inches.obj"), -20.0, 60.0, 2.3, 1.0 / 25.4, false);
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    assert_eq!(run("info named.obj --json").ok().json()["unit"], "mm");
    let result = run("merge named.obj inches.obj --unit in --epsilon 0.01in --json").ok();
    let found = result.json();
    assert_eq!((&found["unit"], &found["parts"]), (&"mm".into(), &1.into()), "{found:#}");
    assert!(result.stderr.contains("converted from in to mm"), "{}", result.stderr);
    let left = run("merge named.obj inches.obj");
    assert_eq!(left.code, 1, "{}", left.stderr);
}

/// A patch that intersects itself is reported, with the intersecting triangles of its file.
#[test]
fn self_intersecting_patch_is_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("a.obj"), -60.0, 20.0, 0.0, 1.0, false);
    zone(&path("b.obj"), -20.0, 60.0, 2.3, 1.0, false);
    let mut text = std::fs::read_to_string(path("b.obj")).expect("text");
    // A spike through the zone, the last triangle of the file.
    let (vertices, faces) = (text.matches("\nv ").count() + 1, text.matches("\nf ").count());
    text +=
        &format!("v 5 0 5\nv 12 0.3 9\nv 12 0.1 8.5\nf {} {} {}\n", vertices + 1, vertices + 2, vertices + 3);
    std::fs::write(path("b.obj"), text).expect("a file");
    let result = planish(folder.path(), &["merge", "a.obj", "b.obj"]).ok();
    assert!(result.stderr.contains("b.obj intersects itself"), "{}", result.stderr);
    assert!(result.stderr.contains(&format!("and {faces} (counted from 0)")), "{}", result.stderr);
    assert!(result.stderr.contains("the merged mesh does not intersect itself"), "{}", result.stderr);
}

/// Objects of kilometres and of nanometres are merged like objects of millimetres.
#[test]
fn scale_of_the_object_does_not_matter() {
    let folder = tempfile::tempdir().expect("a folder");
    let merged = [1.0, 1e6, 1e-6].map(|scale| {
        zone(&folder.path().join("a.obj"), -60.0, 20.0, 0.0, scale, false);
        zone(&folder.path().join("b.obj"), -20.0, 60.0, 2.3, scale, false);
        let found = planish(folder.path(), &["merge", "a.obj", "b.obj", "-o", "w.ply", "--json"]).ok().json();
        assert_eq!(found["parts"], 1, "{found:#}");
        assert_eq!(found["boundary_edges"], 144, "{found:#}");
        found["triangles"].as_f64().expect("a number")
    });
    // Rounding decides which patch gets vertices that both have equally.
    for other in &merged[1..] {
        assert!((other / merged[0] - 1.0).abs() < 0.02, "{merged:?}");
    }
}

/// Parts without a patch come from the bounding mesh and are marked as completed.
#[test]
fn bounding_mesh_fills_parts_without_patches() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    zone(&path("a.obj"), -60.0, 20.0, 0.0, 1.0, false);
    zone(&path("b.obj"), -20.0, 60.0, 2.3, 1.0, false);
    zone(&path("bound.obj"), -89.0, 89.0, 1.1, 1.01, false);
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    let found = run("merge a.obj b.obj --complete bound.obj -o w.ply --json").ok().json();
    let of_bound = found["completed"]["vertices"].as_u64().expect("a number");
    assert!(of_bound > 100 && found["nonmanifold_edges"] == 0 && found["parts"] == 1, "{found:#}");
    // The bounding mesh has two holes at its poles.
    assert_eq!(found["boundary_edges"], 144, "{found:#}");
    let read = run("info w.ply --json").ok().json();
    assert!(read["area"].as_f64().expect("a number") > 0.99 * 400.0 * std::f64::consts::PI, "{read:#}");
    // Patches that face inwards are flipped.
    zone(&path("a_in.obj"), -60.0, 20.0, 0.0, 1.0, true);
    zone(&path("b_in.obj"), -20.0, 60.0, 2.3, 1.0, true);
    let inwards = run("merge a_in.obj b_in.obj --complete bound.obj -o in.ply --json").ok();
    let turned = inwards.json();
    assert_eq!(turned["completed"]["vertices"].as_u64(), Some(of_bound), "{turned:#}");
    assert!(turned.to_string().contains("faced inwards"), "{turned:#}");
    let refused = run("merge a.obj b.obj --complete none.obj -o x.ply");
    assert!(refused.code == 3 && refused.stderr.contains("none.obj"), "{}", refused.stderr);
    assert_eq!(run("merge a.obj b.obj --complete bound.obj -o bound.obj").code, 2);
}
