//! Files of several formats in the commands that read them.

use crate::support::planish;
use std::fs;

/// A rough hill, 0.5 m between points, as text with σ.
fn hill() -> String {
    let mut text = "x,y,z,sigma\n".to_owned();
    for k in 0..900_u32 {
        let (x, y) = (0.5 * f64::from(k % 30), 0.5 * f64::from(k / 30));
        let noise = 0.02 * (f64::from(k.wrapping_mul(2_654_435_761) >> 16) / 65536.0 - 0.5);
        let z = 3.0 + (0.3 * x).sin() + 0.2 * (0.4 * y).cos() + noise;
        text += &format!("{x},{y},{z},0.01\n");
    }
    text
}

#[test]
fn a_raster_of_a_fit_is_read_by_info_view_verify_and_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("hill.csv"), hill()).expect("a file");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    run("fit hill.csv --shape sheet --unit m -o hill.tif --cell-size 500mm").ok();
    let info = run("info hill.tif --json").ok().json();
    assert_eq!((&info["kind"], &info["unit"]), (&"scan".into(), &"m".into()), "{info:#}");
    assert!(info["points"].as_u64() > Some(700) && info["columns"].to_string().contains("czz"), "{info:#}");
    let verified = run("verify hill.tif").ok().stdout;
    assert!(verified.contains("ok") && verified.contains("scan of"), "{verified}");
    run("view hill.tif -o hill.png --size 64x48").ok();
    let again = run("fit hill.tif --shape sheet -o again.ply --json").ok().json();
    assert_eq!(again["unit"], "m");
    // The surface of the raster is that of the points.
    let compared = run("compare again.ply hill.csv --unit m --json").ok().json();
    let rms = compared["backward"]["rms"].as_f64().expect("a number");
    assert!(rms < 0.02, "{compared:#}");
}

#[test]
fn lengths_may_have_a_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("hill.csv"), hill()).expect("a file");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    let tolerance = |option: &str| {
        let fit = format!("fit hill.csv --shape sheet --unit m -o a.ply --mesh-tolerance {option} --json");
        run(&fit).ok().json()["written"][0]["tolerance"].clone()
    };
    assert_eq!(tolerance("20mm"), tolerance("0.02"));
    let wrong = run("fit hill.csv -o a.ply --mesh-tolerance 20km");
    assert_eq!(wrong.code, 2, "{}", wrong.stderr);
    run("fit hill.csv --shape sheet --unit m -o a.planish").ok();
    let compared = |option: &str| {
        let line = format!("compare a.planish a.ply --unit m --mesh-tolerance {option} --json");
        run(&line).ok().json()["forward"]["n"].clone()
    };
    assert_eq!(compared("20mm"), compared("0.02"));
    assert_ne!(compared("20mm"), compared("200mm"));
}

#[test]
fn info_counts_the_faces_of_a_step_file_and_names_what_it_does_not_describe() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("hill.csv"), hill()).expect("a file");
    let run = |line: &str| planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
    run("fit hill.csv --shape sheet --unit m -o hill.step").ok();
    // The order of a scan and its surface does not matter, and an exchange is stated.
    let compared = |line: &str| run(line).ok();
    let usual = compared("compare hill.step hill.csv --unit m --json").json();
    let exchanged = compared("compare hill.csv hill.step --unit m --json").json();
    assert_eq!(usual["backward"], exchanged["backward"]);
    assert!(exchanged["findings"].to_string().contains("files-exchanged"), "{exchanged:#}");
    assert!(!usual["findings"].to_string().contains("files-exchanged"));
    let text = compared("compare hill.csv hill.step --unit m").stdout;
    assert!(text.starts_with("Deviations of hill.step from hill.csv"), "{text}");
    let info = run("info hill.step --json").ok().json();
    let faces = &info["faces"];
    assert!(faces["read"].as_u64() > Some(0), "{info:#}");
    assert_eq!(faces["kinds"]["B-spline"], faces["read"]);
    assert_eq!(faces["unreadable"].as_array().map(Vec::len), Some(0));
    fs::write(folder.path().join("v.toml"), "[[view]]\nmask = \"a.png\"\n").expect("a file");
    let views = run("info v.toml");
    assert!(views.code == 2 && views.stderr.contains("found views"), "{}", views.stderr);
}
