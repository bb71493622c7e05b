//! `planish shell fit` from files to files: the appearance of a mesh is kept, and rigid parts stay rigid.

use planish::Job;
use planish::progress::{Progress, Silent};
use planish::shell::fit::{DeformationKind, Metaball, ShellFitJob};
use planish_core::DVec3;
use planish_estimate::ErrorKind;
use planish_exchange::mesh::{PolygonMesh, read_mesh};
use planish_exchange::textured::read_textured;
use planish_mesh::icosphere;
use std::cell::{Cell, RefCell};
use std::fmt::Write;
use std::path::Path;

const PICTURE: &[u8] = b"\x89PNG a picture that nobody looks into";

/// A ball of 10 with texture coordinates by longitude, its upper part an object of its own; and points of a
/// ball that is longer along x.
fn job(folder: &Path, outputs: &[&str]) -> ShellFitJob {
    let ball = icosphere(10.0, 3);
    let mut text = String::from("mtllib ball.mtl\nusemtl skin\n");
    for DVec3 { x, y, z } in &ball.positions {
        writeln!(text, "v {x:?} {y:?} {z:?}").unwrap();
    }
    for DVec3 { x, y, z } in &ball.positions {
        let u = y.atan2(*x) / std::f64::consts::TAU + 0.5;
        writeln!(text, "vt {u:?} {:?}", 0.05 * z + 0.5).unwrap();
    }
    for upper in [false, true] {
        writeln!(text, "o {}", if upper { "cap" } else { "rest" }).unwrap();
        for t in &ball.triangles {
            let of = t.map(|v| v + 1);
            if t.iter().all(|v| ball.positions[*v as usize][2] > 7.0) == upper {
                writeln!(text, "f {0}/{0} {1}/{1} {2}/{2}", of[0], of[1], of[2]).unwrap();
            }
        }
    }
    std::fs::write(folder.join("ball.obj"), text).unwrap();
    std::fs::write(folder.join("ball.mtl"), "newmtl skin\nmap_Kd ball.png\n").unwrap();
    std::fs::write(folder.join("ball.png"), PICTURE).unwrap();
    let mut points = String::new();
    for DVec3 { x, y, z } in icosphere(10.0, 4).positions {
        writeln!(points, "{:?} {y:?} {z:?}", 1.05 * x).unwrap();
    }
    std::fs::write(folder.join("points.xyz"), points).unwrap();
    ShellFitJob {
        mesh: folder.join("ball.obj"),
        points: vec![folder.join("points.xyz")],
        silhouettes: None,
        landmarks: None,
        sequence: None,
        causal: false,
        deformation: DeformationKind::Dirichlet,
        controls: Some(20),
        controls_file: None,
        family: Vec::new(),
        rigid: Vec::new(),
        blend: None,
        metaball: Metaball::Triangular,
        outline_step_px: 5.0,
        believe_sigma: false,
        rough_start: false,
        force: false,
        outputs: outputs.iter().map(|name| folder.join(name)).collect(),
        report: None,
        unit: None,
    }
}

/// How far places are from the longer ball, at most, along its radius.
fn off(points: &[DVec3]) -> f64 {
    (points.iter().map(|DVec3 { x, y, z }| (DVec3::new(x / 1.05, *y, *z).length() - 10.0).abs()))
        .fold(0.0, f64::max)
}

#[test]
fn texture_and_its_coordinates_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(folder.path(), &["out/fitted.obj", "out/fitted.glb", "out/fitted.ply"]);
    std::fs::create_dir(folder.path().join("out")).unwrap();
    let report = job.run(&Silent).unwrap();
    let names: Vec<String> = (report.written.iter())
        .map(|path| path.file_name().unwrap().to_string_lossy().into_owned())
        .collect();
    assert_eq!(names, ["fitted.png", "fitted.mtl", "fitted.obj", "fitted.glb", "fitted.ply"]);
    let (before, after) = (read_textured(&job.mesh).unwrap(), read_textured(&job.outputs[0]).unwrap());
    assert_eq!((before.uv, before.uv_triangles), (after.uv, after.uv_triangles));
    assert_eq!(before.triangles, after.triangles);
    assert_eq!(std::fs::read(after.texture.unwrap()).unwrap(), PICTURE);
    let text = std::fs::read_to_string(&job.outputs[0]).unwrap();
    for line in ["o rest", "o cap", "usemtl skin", "mtllib fitted.mtl"] {
        assert!(text.lines().any(|l| l == line), "{line}");
    }
    assert!(off(&before.points) > 0.3 && off(&after.points) < 0.1, "{}", off(&after.points));
    // GLB holds the picture and coordinates, PLY what σ is.
    let glb = std::fs::read(&job.outputs[1]).unwrap();
    let has = |what: &[u8]| glb.windows(what.len()).any(|bytes| bytes == what);
    assert!(has(PICTURE) && has(b"TEXCOORD_0"));
    // It is in metres, split at no seam as there is none, and says what the PLY says of σ.
    let in_metres = read_mesh(&job.outputs[1]).unwrap();
    let stated = read_mesh(&job.outputs[2]).unwrap();
    let sigma = |mesh: &PolygonMesh| mesh.column("sigma").unwrap().iter().sum::<f64>();
    assert!((1000.0 * sigma(&in_metres) / sigma(&stated) - 1.0).abs() < 1e-6);
    assert_eq!(in_metres.column("observed"), stated.column("observed"));
    let points: Vec<DVec3> = in_metres.points.iter().map(|p| p.map(|x| 1000.0 * x)).collect();
    assert!(off(&points) < 0.1, "{}", off(&points));
    let ply = std::fs::read(&job.outputs[2]).unwrap();
    assert!(ply.windows(5).any(|bytes| bytes == b"sigma"));
}

/// A progress listener that records its calls and interrupts at an iteration.
struct Recorder {
    stages: RefCell<Vec<String>>,
    rms: RefCell<Vec<f64>>,
    iteration: Cell<usize>,
    stop_at: usize,
}

impl Progress for Recorder {
    fn advance(&self, stage: &str, share: f64) {
        assert!((0.0..=1.0).contains(&share), "{stage} {share}");
        let mut stages = self.stages.borrow_mut();
        if stages.last().is_none_or(|last| last != stage) {
            stages.push(stage.to_owned());
        }
    }

    fn rms(&self, rms: f64) {
        self.rms.borrow_mut().push(rms);
    }

    fn items(&self, done: usize, what: &'static str) {
        assert_eq!(what, "iterations");
        self.iteration.set(done);
    }

    fn interrupted(&self) -> bool {
        self.iteration.get() >= self.stop_at
    }
}

/// Every iteration reports its residual. After an interruption, no further iteration starts and nothing is
/// written.
#[test]
fn a_fit_reports_its_progress_and_can_be_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let job = job(folder.path(), &["fitted.ply"]);
    let listener = |stop_at| Recorder {
        stages: RefCell::default(),
        rms: RefCell::default(),
        iteration: Cell::new(0),
        stop_at,
    };
    let stopped = listener(3);
    let error = job.run(&stopped).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Interrupted);
    assert!(stopped.rms.borrow().len() == 4 && !job.outputs[0].exists());
    let complete = listener(usize::MAX);
    let report = job.run(&complete).unwrap();
    assert_eq!(*complete.stages.borrow(), ["reading", "fitting", "writing"]);
    let rms = complete.rms.borrow();
    assert_eq!(rms.len(), report.iterations);
    assert!(rms[0] > 0.2 && rms[rms.len() - 1] < 0.05, "{rms:?}");
}

#[test]
fn rigid_parts_keep_their_lengths() {
    let folder = tempfile::tempdir().unwrap();
    let stretched = |rigid: &[&str]| {
        let job = ShellFitJob {
            rigid: rigid.iter().map(|part| (*part).to_owned()).collect(),
            blend: Some(4.0),
            ..job(folder.path(), &["fitted.obj"])
        };
        job.run(&Silent).unwrap();
        let (before, after) = (read_textured(&job.mesh).unwrap(), read_textured(&job.outputs[0]).unwrap());
        let cap = before.vertices_of("cap").unwrap();
        assert!(cap.len() > 20);
        let length = |points: &[DVec3], a: u32, b: u32| points[a as usize].distance(points[b as usize]);
        (cap.iter().flat_map(|a| cap.iter().map(move |b| (*a, *b))))
            .filter(|(a, b)| a != b)
            .map(|(a, b)| (length(&after.points, a, b) / length(&before.points, a, b) - 1.0).abs())
            .fold(0.0, f64::max)
    };
    // What is rigid does not follow the points, which are longer by a twentieth.
    assert!(stretched(&[]) > 0.03);
    let stays = stretched(&["cap"]);
    // Turns are linear, and lengths grow by half the square of the angle: a ball does not tell how its cap is
    // turned. How far it turns depends on where controls stand: 0.7 % is a turn of 0.12.
    assert!(stays < 0.01, "{stays}");
    let unknown = ShellFitJob { rigid: vec!["hat".to_owned()], ..job(folder.path(), &[]) };
    let message = unknown.run(&Silent).unwrap_err().to_string();
    assert!(
        message.contains("ball.obj") && message.contains("cap, rest") || message.contains("rest, cap"),
        "{message}"
    );
}

/// An eye in the rigid head is unconnected and near no point. It gets no control, so no control is
/// undetermined.
#[test]
fn unconnected_parts_of_rigid_regions_need_no_readings() {
    let folder = tempfile::tempdir().unwrap();
    let job = ShellFitJob {
        rigid: vec!["cap".to_owned()],
        blend: Some(4.0),
        ..job(folder.path(), &["fitted.obj"])
    };
    let mut text = std::fs::read_to_string(&job.mesh).unwrap();
    let first = icosphere(10.0, 3).positions.len() as u32 + 1;
    let eye = icosphere(0.5, 1);
    for DVec3 { x, y, z } in &eye.positions {
        writeln!(text, "v {x:?} {y:?} {:?}", z + 5.0).unwrap();
    }
    writeln!(text, "o cap").unwrap();
    for t in eye.triangles.iter().map(|t| t.map(|v| v + first)) {
        writeln!(text, "f {} {} {}", t[0], t[1], t[2]).unwrap();
    }
    std::fs::write(&job.mesh, text).unwrap();
    let report = job.run(&Silent).unwrap();
    assert_eq!(report.controls, 20);
    let found = read_textured(&job.outputs[0]).unwrap();
    assert!(off(&found.points[..first as usize - 1]) < 0.35, "{}", off(&found.points[..first as usize - 1]));
}

/// Points of two surfaces: the mesh follows one of them. The fit is refused and nothing is written, or it is
/// forced and does not count as converged.
#[test]
fn meshes_that_do_not_follow_much_of_their_points_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let own = job(folder.path(), &["fitted.ply"]);
    let mut points = String::new();
    for p in icosphere(10.0, 4).positions {
        writeln!(points, "{:?} {:?} {:?}", p[0], p[1], p[2]).unwrap();
        if p[2] > 3.0 {
            writeln!(points, "{:?} {:?} {:?}", 1.3 * p[0], 1.3 * p[1], 1.3 * p[2]).unwrap();
        }
    }
    std::fs::write(folder.path().join("points.xyz"), points).unwrap();
    let refused = own.run(&Silent).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Undetermined, "{refused}");
    assert!(!own.outputs[0].exists());
    let forced = ShellFitJob { force: true, ..own }.run(&Silent).unwrap();
    assert_eq!(forced.termination, "not_following");
    assert!(forced.written[0].exists());
    let codes: Vec<&str> = forced.findings.iter().map(|f| f.code.as_str()).collect();
    assert!(codes.contains(&"surface-refused") && !codes.contains(&"converged"), "{codes:?}");
}
