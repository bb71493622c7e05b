//! Views to solids, from files to files: the example bracket, damaged input, and drawings with known solids
//! if they are available.

#![allow(clippy::print_stdout, reason = "a skipped test is said aloud")]

use planish::ErrorKind;
use planish::Job;
use planish::progress::Silent;
use planish::solid::{SolidJob, SolidReport};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

const VIEWS: [&str; 3] = ["front", "top", "side"];

fn bracket() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/data/bracket");
    VIEWS.map(|v| folder.join(format!("{v}.dxf"))).to_vec()
}

fn solved(views: Vec<PathBuf>, outputs: Vec<PathBuf>) -> planish::Result<SolidReport> {
    let job = SolidJob { views, outputs, ..SolidJob::default() };
    job.run(&Silent)
}

/// A DXF file of lines: from, to, layer.
fn dxf(lines: &[([f64; 2], [f64; 2], &str)]) -> String {
    let entity = |n: usize, ([a, b], [c, d], layer): &([f64; 2], [f64; 2], &str)| {
        format!("0\nLINE\n5\n{n:X}\n8\n{layer}\n10\n{a}\n20\n{b}\n11\n{c}\n21\n{d}\n")
    };
    let entities: String = lines.iter().enumerate().map(|(n, l)| entity(n + 16, l)).collect();
    format!("0\nSECTION\n2\nENTITIES\n{entities}0\nENDSEC\n0\nEOF\n")
}

fn rectangle(width: f64, height: f64) -> Vec<([f64; 2], [f64; 2], &'static str)> {
    let corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]];
    (0..4).map(|k| (corners[k], corners[(k + 1) % 4], "VISIBLE")).collect()
}

/// Writes three views of a box, the front one changed.
fn box_with(front: Vec<([f64; 2], [f64; 2], &'static str)>, folder: &Path) -> Vec<PathBuf> {
    let drawn = [front, rectangle(40.0, 30.0), rectangle(30.0, 20.0)];
    VIEWS
        .iter()
        .zip(drawn)
        .map(|(view, lines)| {
            let path = folder.join(format!("{view}.dxf"));
            std::fs::write(&path, dxf(&lines)).expect("a temporary folder can be written");
            path
        })
        .collect()
}

#[test]
fn the_bracket_of_the_examples_has_its_volume() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("bracket.step");
    let report = solved(bracket(), vec![output.clone()]).unwrap();
    assert_eq!(report.solutions.len(), 1);
    let best = &report.solutions[0];
    let truth = 42_000.0 - 610.0 * PI;
    assert!((best.volume / truth - 1.0).abs() < 1e-9, "{}", best.volume);
    let step = std::fs::read_to_string(output).unwrap();
    assert_eq!(step.matches("CYLINDRICAL_SURFACE").count(), best.faces.cylinder);
}

#[test]
fn the_written_bracket_reads_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bracket.step");
    solved(bracket(), vec![path.clone()]).unwrap();
    let faces = planish_exchange::step::read_step(&path).unwrap();
    let read = faces.triangles(&faces.fineness(Some(0.005))).unwrap();
    assert_eq!((read.parts.len(), read.unreadable.len()), (1, 0));
    let part = &read.parts[0];
    let mesh = planish_mesh::TriangleMesh::try_new(part.points.clone(), part.triangles.clone()).unwrap();
    let check = mesh.check();
    assert!(check.watertight && check.oriented && check.manifold, "{check:?}");
    let truth = 42_000.0 - 610.0 * PI;
    let volume = mesh.signed_volume().unwrap();
    assert!((volume / truth - 1.0).abs() < 1e-4, "{volume} is not {truth}");
}

#[test]
fn tiny_and_duplicate_lines_do_not_change_the_solid() {
    let folder = tempfile::tempdir().unwrap();
    let mut front = rectangle(40.0, 20.0);
    front.push(front[0]);
    front.push(([0.0, 0.0], [25.0, 0.0], "VISIBLE"));
    front.push(([5.0, 20.0], [5.0, 20.0], "VISIBLE"));
    let report = solved(box_with(front, folder.path()), Vec::new()).unwrap();
    assert_eq!(report.solutions.len(), 1);
    assert!((report.solutions[0].volume - 24_000.0).abs() < 1e-9);
    let named = report.findings.iter().any(|f| f.text.contains("LINE 16") && f.text.contains("no length"));
    assert!(named, "{:?}", report.findings);
    let twice =
        report.findings.iter().any(|f| f.text.contains("front.dxf: LINE 10 (line 6) repeats LINE 14"));
    assert!(twice, "{:?}", report.findings);
}

#[test]
fn a_circle_of_radius_zero_is_ignored_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let views = box_with(rectangle(40.0, 20.0), folder.path());
    let text = std::fs::read_to_string(&views[0]).unwrap();
    let point = "0\nCIRCLE\n5\nA7\n8\nVISIBLE\n10\n7\n20\n7\n40\n0\n0\nENDSEC";
    std::fs::write(&views[0], text.replacen("0\nENDSEC", point, 1)).unwrap();
    let report = solved(views, Vec::new()).unwrap();
    assert!((report.solutions[0].volume - 24_000.0).abs() < 1e-9);
    let named = |f: &planish::Finding| f.text.contains("CIRCLE A7") && f.text.contains("no length");
    assert!(report.findings.iter().any(named), "{:?}", report.findings);
}

#[test]
fn drawings_too_large_for_step_files_are_rejected_with_name_and_size() {
    let folder = tempfile::tempdir().unwrap();
    for (factor, is_fine) in [(1e-6, false), (1e-3, true), (1e3, true), (1e8, false)] {
        let drawn =
            [[40.0, 20.0], [40.0, 30.0], [30.0, 20.0]].map(|[w, h]| rectangle(factor * w, factor * h));
        let views: Vec<PathBuf> = VIEWS.iter().map(|v| folder.path().join(format!("{v}.dxf"))).collect();
        for (path, lines) in views.iter().zip(drawn) {
            std::fs::write(path, dxf(&lines)).unwrap();
        }
        match solved(views, Vec::new()) {
            Ok(report) => {
                let volume = report.solutions[0].volume / factor.powi(3);
                assert!(is_fine && (volume - 24_000.0).abs() < 1e-6, "{factor}: {volume}");
            }
            Err(e) => {
                let message = e.to_string();
                assert!(!is_fine && e.kind() == ErrorKind::Input, "{factor}: {message}");
                assert!(message.contains("front.dxf") && message.contains("0.001 mm to 1e9 mm"), "{message}");
            }
        }
    }
}

#[test]
fn an_open_contour_is_rejected_and_its_ends_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut front = rectangle(40.0, 20.0);
    front.pop();
    let report = solved(box_with(front, folder.path()), Vec::new()).unwrap();
    assert!(report.solutions.is_empty());
    assert!(report.unexplained.iter().any(|u| u.view == "front"), "{:?}", report.unexplained);
    // The two lines beside the missing one are named with their open ends.
    for wanted in [
        "LINE 10 (line 6) of the front view ends at 0.0000 0.0000",
        "LINE 12 (line 34) of the front view ends at 0.0000 20.0000",
    ] {
        assert!(report.findings.iter().any(|f| f.text.contains(wanted)), "{:?}", report.findings);
    }
}

#[test]
fn views_of_another_scale_and_single_views_are_rejected_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let e = solved(box_with(rectangle(80.0, 40.0), folder.path()), Vec::new()).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Input);
    assert!(e.to_string().contains("LINE") && e.to_string().contains("it is 0.5000 times as long"), "{e}");
    let one = box_with(rectangle(40.0, 20.0), folder.path()).remove(0);
    let e = solved(vec![one], Vec::new()).unwrap_err();
    assert!(e.to_string().contains("found 1"), "{e}");
}

#[test]
fn meshes_are_closed_and_satisfy_the_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let outputs: Vec<PathBuf> =
        ["ply", "stl", "glb", "obj"].map(|e| folder.path().join(format!("bracket.{e}"))).to_vec();
    let job = |tolerance: f64| SolidJob {
        views: bracket(),
        outputs: outputs.clone(),
        mesh_tolerance: Some(tolerance.into()),
        ..SolidJob::default()
    };
    let mut triangles = 0;
    for tolerance in [0.1, 0.01] {
        let report = job(tolerance).run(&Silent).unwrap();
        assert_eq!(report.written, outputs);
        let exact = &report.solutions[0];
        for path in &outputs {
            let read = planish_exchange::mesh::read_mesh(path).unwrap();
            let unit = read.unit;
            let mesh = planish_mesh::TriangleMesh::try_new(read.points, read.triangles).unwrap().welded();
            let found = mesh.check();
            assert!(found.watertight && found.oriented && found.manifold, "{}", path.display());
            // GLB holds metres.
            let scale = unit.map_or(1.0, planish_exchange::Unit::millimetres);
            let volume = mesh.signed_volume().unwrap() * scale.powi(3);
            assert!((volume - exact.volume).abs() < tolerance * exact.area, "{}: {volume}", path.display());
        }
        let made = planish_exchange::mesh::read_mesh(&outputs[0]).unwrap().triangles.len();
        assert!(made > triangles);
        triangles = made;
    }
    let e = job(-1.0).run(&Silent).unwrap_err();
    assert!(e.to_string().contains("expected a mesh tolerance > 0"), "{e}");
}

#[test]
fn views_in_svg_give_the_same_solid() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, body: &str| {
        let path = folder.path().join(format!("{name}.svg"));
        let text = format!(
            "<svg xmlns='http://www.w3.org/2000/svg' width='100mm' viewBox='0 0 100 100'>{body}</svg>"
        );
        std::fs::write(&path, text).unwrap();
        path
    };
    // The box of 40 × 30 × 20 with a hole of diameter 12, each view anywhere on its page.
    let dashed = "stroke-dasharray='3 2'";
    let views = vec![
        write(
            "front",
            &format!("<rect x='7' y='9' width='40' height='20'/><path {dashed} d='M21 9v20M33 9v20'/>"),
        ),
        write("top", "<rect x='3' y='30' width='40' height='30'/><circle cx='23' cy='45' r='6'/>"),
        write(
            "side",
            &format!(
                "<rect width='30' height='20'/><g {dashed}><line x1='9' x2='9' y2='20'/><line x1='21' \
                 x2='21' y2='20'/></g>"
            ),
        ),
    ];
    let report = solved(views, Vec::new()).unwrap();
    assert_eq!(report.solutions.len(), 1);
    let best = &report.solutions[0];
    assert!((best.volume - 21_738.053_289).abs() < 1e-6, "{}", best.volume);
    assert_eq!((best.faces.plane, best.faces.cylinder), (6, 1));
}

#[test]
fn candidates_that_only_touch_or_do_not_close_are_dropped_and_counted() {
    let folder = data().join("drawings");
    if !folder.is_dir() {
        println!("skipped: {} is not there", folder.display());
        return;
    }
    // Beside the one solid the search finds boundaries that touch themselves along a line, and some that do
    // not close.
    let views = VIEWS.map(|v| folder.join(format!("ex_boxes_on_faces.{v}.dxf"))).to_vec();
    let report = solved(views, Vec::new()).unwrap();
    assert_eq!((report.solutions.len(), report.refused.len()), (1, 0));
    assert_eq!(report.solutions[0].faces.plane, 36);
    let reason: Vec<&str> = report.dropped.iter().map(|dropped| dropped.reason).collect();
    assert_eq!(reason, ["touches", "does_not_close"], "{:?}", report.dropped);
    assert!(report.dropped[0].first.contains("where it is not manifold"));
}

fn data() -> PathBuf {
    std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    )
}

/// Regression tests for drawings: holes that touch walls and planes, circles in pieces, crossing holes, and
/// faces oblique to all views.
#[test]
fn known_parts_are_reproduced() {
    let folder = data().join("drawings");
    if !folder.is_dir() {
        println!("skipped: {} is not there", folder.display());
        return;
    }
    for name in [
        "part_1_01",
        "part_1_03",
        "part_1_06",
        "part_1_08",
        "part_1_13",
        "part_1_14",
        "part_1_15",
        "ex_joints",
        "ttt-ppp0101",
    ] {
        let truth = std::fs::read_to_string(folder.join(format!("{name}.truth.json"))).unwrap();
        let truth: serde_json::Value = serde_json::from_str(&truth).unwrap();
        let views = VIEWS.map(|v| folder.join(format!("{name}.{v}.dxf"))).to_vec();
        let report = solved(views, Vec::new()).unwrap();
        assert_eq!(report.solutions.len(), 1, "{name}");
        let best = &report.solutions[0];
        let volume = truth["volume"].as_f64().unwrap();
        assert!((best.volume / volume - 1.0).abs() < 1e-6, "{name}: {} for {volume}", best.volume);
        let faces = |kind: &str| truth["faces"][kind].as_u64().unwrap() as usize;
        assert_eq!([best.faces.plane, best.faces.cylinder], ["plane", "cylinder"].map(faces), "{name}");
    }
}
