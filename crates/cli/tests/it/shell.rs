//! `planish shell` and `planish simulate scene shell`.

use crate::support::planish;
use std::path::Path;

/// Lines of a text file that begin with a word.
fn lines(folder: &Path, name: &str, word: &str) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join(name)).expect("a file");
    text.lines().filter(|line| line.split(' ').next() == Some(word)).map(str::to_owned).collect()
}

/// Numbers of the lines that begin with a word.
fn numbers(folder: &Path, name: &str, word: &str) -> Vec<Vec<f64>> {
    let parsed = |line: &String| line.split(' ').skip(1).map(|x| x.parse().expect("a number")).collect();
    lines(folder, name, word).iter().map(parsed).collect()
}

/// A tetrahedron in two parts, with texture coordinates, and one face missing.
const OPEN: &str = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nvt 0 0\nvt 1 0\nvt 0 1\ng bottom\n\
    f 1/1 3/3 2/2\ng sides\nf 1/1 2/2 4/3\nf 2/1 3/2 4/3\n";

#[test]
fn open_mesh_has_a_closed_shell_and_no_offset() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("a.obj"), OPEN).expect("written");
    let paper = ["--surface", "shell", "--thickness", "1", "--softness", "0.2", "--cell", "0.5"];
    let outer = ["--offset", "1", "--cell", "0.5"];
    for (options, far) in [(&paper[..], 0.2), (&outer[..], 0.1)] {
        let args = [&["shell", "mesh", "a.obj", "-o", "s.off", "--json"], options].concat();
        let result = planish(folder.path(), &args).ok().json();
        assert!(
            result["watertight"] == true && result["manifold"] == true && result["components"] == 1,
            "{result}"
        );
        assert!(result["deviation_max"].as_f64().expect("a number") < far, "{result}");
        let faces = lines(folder.path(), "s.off", "3").len() as u64;
        assert_eq!(faces, result["triangles"].as_u64().expect("a number"));
    }
    let ignored = planish(folder.path(), &["shell", "mesh", "a.obj", "--thickness", "1", "-o", "o.ply"]);
    assert!(ignored.code == 2 && ignored.stderr.contains("--surface shell"), "{}", ignored.stderr);
    let result = planish(
        folder.path(),
        &["shell", "mesh", "a.obj", "--surface", "offset", "--offset", "1", "-o", "o.ply"],
    );
    assert!(
        result.code == 1 && result.stderr.contains("a.obj") && result.stderr.contains("boundary edges"),
        "{}",
        result.stderr
    );
    assert!(!folder.path().join("o.ply").exists());
}

#[test]
fn poses_keep_texture_coordinates_and_rigid_parts() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    write("a.obj", OPEN);
    write(
        "p.toml",
        "controls = 4\nblend = 0\n[[pose]]\nname = \"up\"\nmove = [{ near = [0, 0, 10], by = [0, 0, 5] }]\n\
         [[keyframe]]\nseconds = 0\nweights = { up = 1 }\n",
    );
    let args = [
        "shell", "pose", "a.obj", "--poses", "p.toml", "--rigid", "bottom", "-o", "b.obj", "-o", "b.glb",
        "--json",
    ];
    let result = planish(folder.path(), &args).ok().json();
    assert!(result["poses"][0]["moved"] == 1 && result["rigid"][0]["vertices"] == 3, "{result}");
    let numbers_in = |name: &str, word: &str| numbers(folder.path(), name, word);
    assert_eq!(numbers_in("a.obj", "vt"), numbers_in("b.obj", "vt"));
    assert_eq!(lines(folder.path(), "a.obj", "f"), lines(folder.path(), "b.obj", "f"));
    let (before, after) = (numbers_in("a.obj", "v"), numbers_in("b.obj", "v"));
    assert_eq!(after[3], [0.0, 0.0, 15.0]);
    let length =
        |points: &[Vec<f64>]| (0..3).map(|k| (points[0][k] - points[1][k]).powi(2)).sum::<f64>().sqrt();
    assert!((length(&before) - length(&after)).abs() < 1e-9);
    let glb = std::fs::read(folder.path().join("b.glb")).expect("a file");
    assert!(glb.starts_with(b"glTF"));
    let result = planish(
        folder.path(),
        &["shell", "pose", "a.obj", "--poses", "p.toml", "--rigid", "head", "-o", "c.glb"],
    );
    assert!(
        result.code == 2 && result.stderr.contains("`head`") && result.stderr.contains("bottom, sides"),
        "{}",
        result.stderr
    );
    write("p.toml", "[[pose]]\nname = \"up\"\nmove = [{ control = 99, by = [0, 0, 5] }]\n");
    let result = planish(folder.path(), &["shell", "pose", "a.obj", "--poses", "p.toml", "-o", "c.glb"]);
    assert!(
        result.code == 2 && result.stderr.contains("pose `up`") && result.stderr.contains("found 99"),
        "{}",
        result.stderr
    );
}

#[test]
fn shell_scene_has_all_inputs_of_shell_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    let args = ["simulate", "scene", "shell", "--out", "bent", "--points", "500", "--views", "2", "--json"];
    let result = planish(folder.path(), &args).ok().json();
    assert_eq!(result["rows"], 500);
    for name in
        ["mesh.obj", "points.ply", "truth.ply", "truth.json", "views.toml", "mask01.png", "mask02.png"]
    {
        assert!(folder.path().join("bent").join(name).is_file(), "{name}");
    }
}

#[test]
fn sequence_is_fitted_frame_by_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("frames")).expect("a folder");
    for (name, seed) in [("a", "1"), ("b", "2")] {
        let out = format!("frames/{name}");
        let args = [
            "simulate",
            "scene",
            "shell",
            "--out",
            &out,
            "--points",
            "300",
            "--views",
            "2",
            "--controls",
            "8",
            "--deformation",
            "0.01",
            "--seed",
            seed,
        ];
        planish(folder.path(), &args).ok();
    }
    let args = [
        "shell",
        "fit",
        "frames/a/mesh.obj",
        "--sequence",
        "frames",
        "--controls",
        "10",
        "-o",
        "moved.ply",
        "--json",
    ];
    let result = planish(folder.path(), &args).ok().json();
    let frames = result["frames"].as_array().expect("frames");
    assert_eq!(frames.len(), 2, "{result}");
    for (frame, name) in frames.iter().zip(["a", "b"]) {
        // σ of points is 0.2 % of some 173 mm; a pixel is about half a millimetre.
        let rms = frame["rms_points"].as_f64().expect("a number");
        assert!(frame["frame"] == name && rms < 1.0, "{frame}");
        assert!(frame["iou"].as_f64().expect("a number") > 0.95, "{frame}");
        assert!(folder.path().join(format!("moved.{name}.ply")).is_file());
    }
    // The first frame has no predecessor, so it has no surprise value.
    assert!(frames[0]["surprise"].is_null() && frames[1]["surprise"].as_f64().is_some_and(|s| s > 0.0));
    std::fs::create_dir(folder.path().join("frames/c")).expect("a folder");
    let result = planish(folder.path(), &args);
    let found = result.stderr.contains("expected views.toml, points.* or landmarks.csv");
    assert!(result.code == 2 && found, "{}", result.stderr);
    let args =
        ["shell", "fit", "frames/a/mesh.obj", "--sequence", "frames", "--points", "frames/a/points.ply"];
    assert_eq!(planish(folder.path(), &args).code, 2);
}

#[test]
fn mesh_is_coloured_from_images() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
    // Two sheets seen from above and from below; the left half of the image is red, the right half blue.
    let mut sheet = String::from("# unit mm\n");
    for y in 0..9 {
        for x in 0..9 {
            sheet += &format!("v {x} {y} 0\n");
        }
    }
    for y in 0..8 {
        for x in 0..8 {
            let a = 9 * y + x + 1;
            sheet += &format!("f {} {} {}\nf {} {} {}\n", a, a + 1, a + 10, a, a + 10, a + 9);
        }
    }
    write("a.obj", &sheet);
    let row = "250 10 10 ".repeat(20) + &"10 10 250 ".repeat(21) + "\n";
    write("p.ppm", &format!("P3 41 41 255\n{}", row.repeat(41)));
    // From above: x to the right, y downwards.
    write(
        "views.toml",
        "unit = \"mm\"\n[[view]]\nimage = \"p.ppm\"\nK = [[80, 0, 20], [0, 80, 20], [0, 0, 1]]\n\
         R = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]\nt = [-4, 4, 20]\n",
    );
    let args = [
        "shell",
        "texture",
        "a.obj",
        "--views",
        "views.toml",
        "--colours",
        "vertices",
        "-o",
        "c.ply",
        "--json",
    ];
    let result = planish(folder.path(), &args).ok().json();
    // The boundary of the sheet is at a depth edge.
    assert!(
        result["vertices"] == 81
            && result["seen"] == 49
            && result["filled"] == 32
            && result["texture"].is_null(),
        "{result}"
    );
    assert!(result["views"][0]["view"] == "p" && result["views"][0]["seen"] == 49, "{result}");
    let result = planish(folder.path(), &["info", "c.ply"]).ok();
    assert!(result.stdout.contains("81"), "{}", result.stdout);
    let result =
        planish(folder.path(), &["shell", "texture", "a.obj", "--views", "views.toml", "-o", "c.stl"]);
    assert!(result.code == 2 && result.stderr.contains(".obj (with a texture)"), "{}", result.stderr);
}

/// Writes an OBJ file with its vertices scaled and moved.
fn placed(folder: &Path, from: &str, to: &str, by: f64, shift: f64) {
    let text = std::fs::read_to_string(folder.join(from)).expect("a file");
    let place = |line: &str| match line.strip_prefix("v ") {
        Some(rest) => {
            let coordinates: Vec<f64> = rest.split(' ').map(|x| x.parse().expect("a number")).collect();
            format!("v {} {} {}", coordinates[0] * by + shift, coordinates[1] * by, coordinates[2] * by)
        }
        None => line.to_owned(),
    };
    let lines: Vec<String> = text.lines().map(place).collect();
    std::fs::write(folder.join(to), lines.join("\n")).expect("written");
}

/// Meshes in another unit or far away are refused, and unusual views are reported. An unused vertex far away
/// and duplicate faces change little.
#[test]
fn implausible_inputs_are_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    planish(at, &["simulate", "scene", "shell", "--out", "bent", "--points", "3000", "--views", "3"]).ok();
    placed(at, "bent/mesh.obj", "bent/metres.obj", 1e-3, 0.0);
    placed(at, "bent/mesh.obj", "bent/far.obj", 1.0, 300.0);
    let fit = |mesh: &str, more: &[&str]| {
        let args = [&["shell", "fit", mesh, "--points", "bent/points.ply", "--json"], more].concat();
        planish(at, &args)
    };
    for (mesh, words) in [("bent/metres.obj", "similar size"), ("bent/far.obj", "bring both into one frame")]
    {
        let result = fit(mesh, &[]);
        assert!(result.code == 1 && result.stderr.contains(words), "{mesh}: {}", result.stderr);
    }
    let plain = fit("bent/mesh.obj", &[]).ok();
    assert!(!plain.stderr.contains("fold"), "{}", plain.stderr);
    let rms = |result: &serde_json::Value| result["rms_points"].as_f64().expect("a number");
    let wanted = rms(&plain.json());
    let text = std::fs::read_to_string(at.join("bent/mesh.obj")).expect("a file");
    let faces: Vec<&str> = text.lines().filter(|line| line.starts_with("f ")).collect();
    std::fs::write(at.join("stray.obj"), format!("{text}\nv 500 500 500\n")).expect("written");
    std::fs::write(at.join("double.obj"), format!("{text}\n{}\n", faces.join("\n"))).expect("written");
    let stray = rms(&fit("stray.obj", &[]).ok().json());
    assert!((stray / wanted - 1.0).abs() < 0.1, "{stray}, {wanted}");
    let double = rms(&fit("double.obj", &[]).ok().json());
    assert!((double / wanted - 1.0).abs() < 1e-6, "{double}, {wanted}");
    // A camera of an image four times as large, and exchanged masks.
    let views = std::fs::read_to_string(at.join("bent/views.toml")).expect("a file");
    let scaled = views.replacen(
        "K = [[768.0, 0.0, 319.5], [0.0, 768.0, 239.5]",
        "K = [[3072.0, 0.0, 1278.0], [0.0, 3072.0, 958.0]",
        1,
    );
    assert_ne!(scaled, views);
    std::fs::write(at.join("bent/larger.toml"), scaled).expect("written");
    let result = fit("bent/mesh.obj", &["--silhouettes", "bent/larger.toml"]).ok();
    assert!(result.stderr.contains("the optical axis meets the image at 1278, 958"), "{}", result.stderr);
    assert!(result.stderr.contains("view mask01: the mesh hardly overlaps its mask"), "{}", result.stderr);
    let refused = planish(
        at,
        &["shell", "fit", "bent/mesh.obj", "--points", "bent/points.ply", "--family", "stray.obj"],
    );
    assert!(refused.code == 2 && refused.stderr.contains("--deformation modes"), "{}", refused.stderr);
}
