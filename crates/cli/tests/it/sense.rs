//! `planish sense`: from sensor data to points.

use crate::support::{names, planish};
use std::path::Path;

const COLUMNS: usize = 96;
const ROWS: usize = 48;
/// Shift of the right image, in pixels.
const SHIFT: usize = 7;

/// An image with a non-repeating texture, starting at a column.
fn pgm(from: usize) -> Vec<u8> {
    let mut bytes = format!("P5 {COLUMNS} {ROWS} 255\n").into_bytes();
    for y in 0..ROWS {
        for x in from..from + COLUMNS {
            let (x, y) = (x as f64, y as f64);
            let wave = (0.9 * x + 0.31 * y).sin()
                + (0.47 * x - 0.8 * y + 1.0).sin()
                + (0.013 * x * y + 0.21 * x).sin();
            bytes.push((128.0 + 40.0 * wave) as u8);
        }
    }
    bytes
}

fn pair(folder: &Path) {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file");
    write("left.pgm", &pgm(0));
    write("right.pgm", &pgm(SHIFT));
    write(
        "cameras.toml",
        b"unit = \"mm\"\nf = 400\ncx = 47.5\ncy = 23.5\nbaseline = 70\nsigma_disparity_px = 0.05\n",
    );
}

#[test]
fn stereo_pair_gives_points_and_disparities() {
    let folder = tempfile::tempdir().expect("a folder");
    pair(folder.path());
    let run = |threads: &str, points: &str| {
        let line = format!(
            "sense stereo left.pgm right.pgm --calib cameras.toml --disparities 0..15 -o {points} -o d.npy \
             --json --threads {threads}"
        );
        planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok().json()
    };
    let result = run("1", "a.ply");
    run("2", "b.ply");
    assert_eq!((result["command"].as_str(), result["unit"].as_str()), (Some("sense stereo"), Some("mm")));
    assert_eq!(result["termination"], "converged");
    let points = result["observations"].as_u64().expect("a count") as usize;
    assert!(points > COLUMNS * ROWS / 2, "{points}");
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a file");
    assert!(read("a.ply") == read("b.ply"), "threads change the points");
    let head = String::from_utf8_lossy(&read("a.ply")[..600]).into_owned();
    assert!(head.contains("property double czz") && head.contains("comment unit mm"), "{head}");
    // Disparity and σ, pixel by pixel, behind the header.
    let array = read("d.npy");
    let body = &array[array.len() - COLUMNS * ROWS * 8..];
    let value = |k: usize| f32::from_le_bytes([body[k], body[k + 1], body[k + 2], body[k + 3]]);
    let errors = (0..COLUMNS * ROWS).map(|k| value(8 * k) - SHIFT as f32).filter(|e| e.is_finite());
    let far = errors.filter(|e| e.abs() > 0.2).count();
    assert!(far * 25 < points, "{far} of {points} are off");
    // `fit` can read the output.
    let info = planish(folder.path(), &["info", "a.ply"]).ok().stdout;
    assert!(info.contains("cxx cxy cxz cyy cyz czz"), "{info}");
}

#[test]
fn normal_map_and_depth_image_give_points() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).expect("a file");
    write("n.ppm", b"P3 2 1 255 128 128 255 0 0 0");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok().json();
    let result = run("sense photometric n.ppm --normal-map 2.5 -o n.ply -o n.tif --json");
    assert_eq!(
        (result["observations"].as_u64(), result["rejected"]["undetermined"].as_u64()),
        (Some(1), Some(1))
    );
    assert_eq!(result["sigma_n_deg"]["median"], 2.5);
    let mut depth = b"\x93NUMPY\x01\x00".to_vec();
    let header = "{'descr': '<u2', 'fortran_order': False, 'shape': (1, 20)}\n";
    depth.extend((header.len() as u16).to_le_bytes());
    depth.extend(header.as_bytes());
    depth.extend((0..20_u16).flat_map(|k| (if k == 3 { 0 } else { 1000 + k }).to_le_bytes()));
    write("d.npy", &depth);
    write("d.toml", b"unit = \"m\"\nfx = 500\nfy = 500\ncx = 10\ncy = 0\nscale = 0.001\nsigma_a = 0.002\n");
    let result = run("sense depth d.npy -o d.ply --json");
    assert_eq!(
        (result["observations"].as_u64(), result["rejected"]["no_reading"].as_u64()),
        (Some(19), Some(1))
    );
    assert_eq!(result["inputs"].as_array().map(Vec::len), Some(2));
}

#[test]
fn simulated_grid_gives_points_normals_and_curvatures() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok();
    let scene = run("simulate scene grid --out s --views 1 --size 320x240 --stripe-spacing 14 --json").json();
    assert_eq!(
        (scene["command"].as_str(), scene["unit"].as_str()),
        (Some("simulate scene grid"), Some("mm"))
    );
    let result =
        run("sense grid s/stripes-1.png --plain s/plain-1.png --calib s/grid.toml -o s/grid-1.ply --json")
            .json();
    let found = result["observations"].as_u64().expect("a count");
    assert!(found > 40, "{found}");
    assert!(result["sigma_px"]["median"].as_f64().expect("a number") < 0.3);
    let info = run("info s/grid-1.ply").stdout;
    assert!(info.contains("sigma_n_deg") && info.contains("k1 k2"), "{info}");
    // Points and the curvatures computed from them would count the same measurements twice.
    let job = std::fs::read_to_string(folder.path().join("s/job.toml")).expect("a job");
    assert!(job.contains("kind = \"curvature\""), "{job}");
    // The job of the scene names the sensed points, in the frame of the reference.
    let near = run("compare s/truth.ply s/job.toml --json").json();
    assert!(near["backward"]["p95"].as_f64().expect("a number").abs() < 1.0, "{near}");
    let wrong =
        planish(folder.path(), &["sense", "grid", "s/plain-1.png", "--calib", "s/grid.toml", "-o", "p.ply"]);
    assert!(
        wrong.code == 1 && wrong.stderr.contains("could not be identified"),
        "{} {}",
        wrong.code,
        wrong.stderr
    );
}

#[test]
fn errors_are_reported_before_anything_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    pair(folder.path());
    std::fs::write(folder.path().join("misspelt.toml"), "f = 400\ncx = 1\ncy = 1\nbase = 70\n")
        .expect("a file");
    let before = names(folder.path());
    for (line, code, words) in [
        ("sense stereo left.pgm right.pgm -o p.ply", 2, "--calib"),
        ("sense stereo left.pgm right.pgm --calib misspelt.toml -o p.ply", 2, "misspelt.toml: line 4"),
        ("sense stereo left.pgm gone.pgm -o d.npy", 3, "gone.pgm"),
        ("sense stereo left.pgm right.pgm -o d.step", 2, "found `step`"),
        ("sense stereo left.pgm right.pgm --disparities 9..3", 2, "as in 0..127"),
        ("sense stereo left.pgm cameras.toml -o d.npy", 2, "extension `toml`"),
        ("sense photometric left.pgm", 2, "--calib with the lights"),
        ("sense grid left.pgm --calib misspelt.toml -o p.ply", 2, "misspelt.toml: line 4"),
        ("sense grid left.pgm -o p.ply", 2, "--calib"),
        ("sense depth left.pgm --calib misspelt.toml -o p.ply", 2, "misspelt.toml"),
    ] {
        let result = planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
        assert!(
            result.code == code && result.stderr.contains(words),
            "{line}: {} {}",
            result.code,
            result.stderr
        );
        assert_eq!(names(folder.path()), before, "{line}");
    }
}

#[test]
fn points_are_in_the_frame_of_the_calibration() {
    let folder = tempfile::tempdir().expect("a folder");
    pair(folder.path());
    // The same rectified pair as two views; the first camera is at (1000, 0, 0).
    let view = "[[view]]\nK = [[400, 0, 47.5], [0, 400, 23.5], [0, 0, 1]]\n";
    let text = format!(
        "unit = \"mm\"\nsigma_disparity_px = 0.05\n{view}t = [-1000, 0, 0]\n{view}t = [-1070, 0, 0]\n"
    );
    std::fs::write(folder.path().join("views.toml"), &text).expect("a file");
    let run = |calibration: &str, out: &str| {
        let line =
            format!("sense stereo left.pgm right.pgm --calib {calibration} -o {out} --speckle 1 --json");
        planish(folder.path(), &line.split(' ').collect::<Vec<_>>()).ok().json()
    };
    let (level, views) = (run("cameras.toml", "a.ply"), run("views.toml", "b.ply"));
    let share = |field: fn(&serde_json::Value) -> &serde_json::Value| {
        field(&views).as_f64().expect("a number") / field(&level).as_f64().expect("a number")
    };
    let (n, sigma) = (share(|v| &v["observations"]), share(|v| &v["sigma"]["median"]));
    // With two views, disparities outside the right image are rejected, which includes the worst ones.
    assert!((n - 1.0).abs() < 0.02 && (sigma - 1.0).abs() < 0.05, "{n} {sigma}");
    let x = |file: &str| {
        let info = planish(folder.path(), &["info", file, "--json"]).ok().json();
        info["box"]["max"][0].as_f64().or(info["box"][0][0].as_f64()).expect("a corner")
    };
    assert!((x("b.ply") - x("a.ply") - 1000.0).abs() < 1e-3, "{} {}", x("a.ply"), x("b.ply"));
    let behind = text.replace("[-1070, 0, 0]", "[-1000, 0, -70]");
    std::fs::write(folder.path().join("views.toml"), behind).expect("a file");
    let line = "sense stereo left.pgm right.pgm --calib views.toml -o c.ply";
    let result = planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    assert!(result.code == 2 && result.stderr.contains("epipole"), "{}", result.stderr);
}
