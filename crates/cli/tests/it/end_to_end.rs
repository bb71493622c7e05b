//! Fits from scans to output files, with the example data of the repository.

use crate::support::{names, part_of_pebble, pebble, planish, repository};

#[test]
fn fit_then_info_then_compare() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |args: &[&str]| planish(folder.path(), args).ok();
    let job = pebble("job.toml");
    let result = run(&["fit", &job, "-o", "p.step", "-o", "p.ply", "-o", "p.planish"]);
    for words in ["Fitted a ball", "rejected", "outlier", "laser", "held out", "Wrote p.step", "Wrote p.ply"]
    {
        assert!(result.stdout.contains(words), "{words}: {}", result.stdout);
    }
    assert!(result.stderr.contains("sensor \"old\" states σ"), "{}", result.stderr);
    assert_eq!(names(folder.path()), ["p.planish", "p.ply", "p.step"]);
    let step = std::fs::read_to_string(folder.path().join("p.step")).expect("text");
    assert!(step.starts_with("ISO-10303-21;") && step.trim_end().ends_with("END-ISO-10303-21;"));
    assert!(step.contains("B_SPLINE_SURFACE_WITH_KNOTS") && step.contains("MANIFOLD_SOLID_BREP"));

    let mesh = run(&["info", "p.ply", "--json"]).json();
    assert_eq!((&mesh["watertight"], &mesh["components"]), (&true.into(), &1.into()));
    let model = run(&["info", "p.planish", "--json"]).json();
    assert_eq!(model["sessions"][0]["inputs"].as_array().map(Vec::len), Some(6));
    let (area, of_mesh) =
        (model["area"].as_f64().expect("a number"), mesh["area"].as_f64().expect("a number"));
    assert!((area / of_mesh - 1.0).abs() < 1e-3, "{area} {of_mesh}");

    // The true σ is at most 0.1 mm; the chord error of the reference mesh is 0.12 mm.
    for model in ["p.planish", "p.ply"] {
        let found = run(&["compare", model, &pebble("truth.ply"), "--json"]).json();
        let backward = &found["backward"];
        assert!(backward["rms"].as_f64().is_some_and(|rms| rms < 0.06), "{model}: {found:#}");
        assert!(backward["mean"].as_f64().is_some_and(|mean| mean.abs() < 0.01), "{model}: {found:#}");
        let coverage = found["coverage95"].as_f64().expect("a number");
        assert!((0.9..=1.0).contains(&coverage), "{model}: {coverage}");
    }
}

#[test]
fn second_session_is_added_to_the_first() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, scans: &[&str]| {
        std::fs::write(folder.path().join(name), part_of_pebble(scans)).expect("a job");
    };
    write("first.toml", &["laser-1.ply", "laser-2.ply", "old-1.ply"]);
    write("second.toml", &["laser-3.ply"]);
    let run = |args: &[&str]| planish(folder.path(), args).ok().json();
    let first = run(&["fit", "first.toml", "-o", "first.planish", "--json"]);
    let both = run(&["fit", "second.toml", "--update", "first.planish", "-o", "both.planish", "--json"]);
    assert_eq!(both["coefficients"], first["coefficients"], "the grid stays");
    let count = |object: &serde_json::Value, key: &str| object[key].as_u64().expect("a count");
    assert_eq!(
        count(&both, "observations_of_all_sessions"),
        count(&first, "observations") + count(&both, "observations")
    );
    let median = |object: &serde_json::Value| object["sigma"]["median"].as_f64().expect("a number");
    assert!(median(&both) < median(&first), "more readings, less σ");
    let truth = |model: &str| run(&["compare", model, &pebble("truth.ply"), "--json"]);
    let rms = |object: &serde_json::Value| object["backward"]["rms"].as_f64().expect("a number");
    assert!(rms(&truth("both.planish")) < rms(&truth("first.planish")));
    let info = run(&["info", "both.planish", "--json"]);
    assert_eq!(info["sessions"].as_array().map(Vec::len), Some(2));
    // The same scan twice is probably a mistake, so a warning is expected.
    let again = run(&["fit", "second.toml", "--update", "both.planish", "--json"]);
    let warnings = again["warnings"].as_array().expect("a list");
    assert!(warnings.iter().any(|w| w.as_str().is_some_and(|w| w.contains("count twice"))));
}

#[test]
fn a_unit_that_nothing_stated_can_be_stated_later() {
    let folder = tempfile::tempdir().expect("a folder");
    // A dome of 0.16 m, in metres that the file does not name. Both halves have the same name and size.
    for (half, name) in ["a", "b"].into_iter().enumerate() {
        let place = |k: usize| [k % 40, k / 40].map(|i| (i as f64 - 19.5) * 0.004);
        let lines: String = (half..1600)
            .step_by(2)
            .map(|k| {
                let [x, y] = place(k);
                let noise = 1e-5 * ((k * 7919 % 1000) as f64 / 500.0 - 1.0);
                format!("{x} {y} {}\n", 0.05 - 2.0 * (x * x + y * y) + noise)
            })
            .collect();
        std::fs::create_dir(folder.path().join(name)).expect("a folder");
        std::fs::write(folder.path().join(name).join("scan.xyz"), lines).expect("points");
    }
    let run = |args: &[&str]| planish(folder.path(), args).ok().json();
    let codes = |object: &serde_json::Value| -> Vec<String> {
        let findings = object["findings"].as_array().expect("a list").iter();
        findings.map(|f| f["code"].as_str().expect("a code").to_owned()).collect()
    };
    let has = |object: &serde_json::Value, code: &str| codes(object).iter().any(|c| c == code);
    let first = run(&["fit", "a/scan.xyz", "--shape", "sheet", "-o", "first.planish", "--json"]);
    assert!(has(&first, "unit-implausible") && !has(&first, "unit-assumed"), "{:?}", codes(&first));
    // No unit is stated, so the option is that of both files, and nothing is converted.
    let compared = run(&["compare", "first.planish", "b/scan.xyz", "--unit", "m", "--json"]);
    assert_eq!(compared["unit"], "m");
    assert!(compared["backward"]["rms"].as_f64().is_some_and(|rms| rms < 1e-4), "{compared:#}");
    assert!(!has(&compared, "unit-converted") && !has(&compared, "unit-implausible"));
    let update = ["fit", "b/scan.xyz", "--update", "first.planish", "-o", "both.planish"];
    let both = run(&[&update[..], &["--unit", "m", "--json"]].concat());
    assert!(!has(&both, "unit-implausible"), "{:?}", codes(&both));
    // The other half is no second copy of the first.
    assert!(!has(&both, "scan-added-twice"), "{:?}", codes(&both));
    // The unit is remembered.
    let info = run(&["info", "both.planish", "--json"]);
    assert_eq!(info["unit"], "m");
    assert!(!has(&info, "unit-assumed"));
    let copy = folder.path().join("renamed.xyz");
    std::fs::copy(folder.path().join("a/scan.xyz"), copy).expect("a copy");
    let again = run(&["fit", "renamed.xyz", "--update", "both.planish", "-o", "c.planish", "--json"]);
    assert!(has(&again, "scan-added-twice"), "{:?}", codes(&again));
    let other = planish(folder.path(), &["fit", "renamed.xyz", "--update", "both.planish", "--unit", "in"]);
    assert!(other.stderr.contains("a model of the same unit"), "{}", other.stderr);
}

#[test]
fn readings_far_from_the_model_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("first.toml"), part_of_pebble(&["laser-1.ply"])).expect("a job");
    std::fs::write(folder.path().join("far.xyz"), far_points()).expect("points");
    planish(folder.path(), &["fit", "first.toml", "-o", "first.planish", "--quiet"]).ok();
    let result =
        planish(folder.path(), &["fit", "far.xyz", "--update", "first.planish", "-o", "second.planish"]);
    assert_eq!(result.code, 1, "{}", result.stdout);
    assert!(result.stderr.contains("far.xyz: the readings lie"), "{}", result.stderr);
    assert!(!folder.path().join("second.planish").exists());
}

/// A plane far from the model.
fn far_points() -> String {
    (0..400).map(|k| format!("{} {} 9000\n", 9000 + k % 20, 9000 + k / 20)).collect()
}

#[test]
fn runs_and_threads_give_the_same_bytes() {
    let outputs = ["p.step", "p.ply", "p.planish"];
    let runs = ["1", "2", "2"].map(|threads| {
        let folder = tempfile::tempdir().expect("a folder");
        let mut args = vec!["fit", "examples/data/pebble/job.toml", "--quiet", "--threads", threads];
        let paths = outputs.map(|name| folder.path().join(name).display().to_string());
        for path in &paths {
            args.extend(["-o", path]);
        }
        planish(&repository(), &args).ok();
        paths.map(|path| std::fs::read(path).expect("an output"))
    });
    for (k, name) in outputs.iter().enumerate() {
        assert!(!runs[0][k].is_empty());
        assert!(runs[0][k] == runs[1][k], "{name}: one thread and two differ");
        assert!(runs[1][k] == runs[2][k], "{name}: two runs differ");
    }
    let text = String::from_utf8_lossy(&runs[0][2]);
    assert!(!text.contains("--threads") && !text.contains("--quiet"), "the model names how it was run");
}

#[test]
fn simulated_scenes_do_not_depend_on_threads() {
    let runs = ["1", "2"].map(|threads| {
        let folder = tempfile::tempdir().expect("a folder");
        let args = ["simulate", "scene", "scans", "--readings", "500", "--out", "s", "--threads", threads];
        planish(folder.path(), &args).ok();
        let scene = folder.path().join("s");
        let read = |name: String| (std::fs::read(scene.join(&name)).expect("a file"), name);
        names(&scene).into_iter().map(read).collect::<Vec<_>>()
    });
    assert!(runs[0] == runs[1]);
    assert_eq!(runs[0].len(), 8);
}

// Other systems round the last digit of sines differently.
#[cfg(all(target_os = "linux", target_arch = "x86_64", target_env = "gnu"))]
#[test]
fn pebble_data_matches_its_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let args = "simulate scene scans --shape ball --seed 7 --readings 12000 --out pebble".split(' ');
    planish(folder.path(), &args.collect::<Vec<_>>()).ok();
    for name in names(&folder.path().join("pebble")) {
        let made = std::fs::read(folder.path().join("pebble").join(&name)).expect("a file");
        assert!(made == std::fs::read(pebble(&name)).expect("a file"), "{name} differs");
    }
}

#[test]
fn summary_reports_a_missing_output() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("job.toml"), part_of_pebble(&["laser-1.ply"])).expect("a job");
    let result = planish(folder.path(), &["fit", "job.toml"]).ok();
    assert!(result.stdout.contains("Nothing was written"), "{}", result.stdout);
    assert_eq!(names(folder.path()), ["job.toml"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_no_files() {
    use std::process::Stdio;
    use std::time::Duration;
    let folder = tempfile::tempdir().expect("a folder");
    planish(folder.path(), &["simulate", "scene", "scans", "--out", "s", "--readings", "60000", "--quiet"])
        .ok();
    let before = names(folder.path());
    let child =
        crate::support::command(folder.path(), &["fit", "s/job.toml", "-o", "p.ply", "-o", "p.planish"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("planish runs");
    std::thread::sleep(Duration::from_millis(700));
    let kill = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(kill.expect("kill runs").success());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("interrupted: nothing was written"));
    assert_eq!(names(folder.path()), before);
}

#[cfg(unix)]
#[test]
fn closed_pipe_is_no_error() {
    use std::process::Stdio;
    let mut child =
        crate::support::command(&repository(), &["info", "examples/data/pebble/job.toml", "--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("planish runs");
    drop(child.stdout.take());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!((output.status.code(), String::from_utf8_lossy(&output.stderr).as_ref()), (Some(0), ""));
}

#[test]
fn vessel_scanned_from_one_side_is_completed() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |args: &[&str]| planish(folder.path(), args).ok();
    let result = run(&["simulate", "scene", "vessel", "--readings", "8000", "--out", "v"]);
    assert!(result.stdout.contains("--symmetry rotation:full"), "{}", result.stdout);
    let found = run(&[
        "fit",
        "v/job.toml",
        "--symmetry",
        "auto",
        "-o",
        "v.planish",
        "-o",
        "v.ply",
        "-o",
        "v.glb",
        "--json",
    ])
    .json();
    let symmetry = &found["propagation"]["symmetry"];
    assert_eq!((&symmetry["kind"], &symmetry["proposed"]), (&"rotation".into(), &true.into()));
    let share = |value: &serde_json::Value| value.as_f64().expect("a number");
    assert!(share(&found["propagation"]["invented_area_fraction"]) > 0.4);
    let info = run(&["info", "v.planish", "--json"]).json();
    assert!(share(&info["invented_area_fraction"]) > 0.4);
    for model in ["v.planish", "v.ply", "v.glb"] {
        let judged = run(&["compare", model, "v/truth.ply", "--part", "completed", "--json"]).json();
        assert!(share(&judged["backward"]["rms"]) < 0.3, "{model}: {judged:#}");
    }
}

#[test]
fn motion_of_a_turning_object_is_estimated() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |args: &[&str]| planish(folder.path(), args).ok();
    run(&["simulate", "scene", "turning", "--readings", "16000", "--views", "4", "--out", "t"]);
    let found = run(&["fit", "t/job.toml", "--motion", "rigid", "-o", "t.planish", "--json"]).json();
    let rate = found["propagation"]["motion"]["rate_deg_per_s"].as_array().expect("two numbers").clone();
    let [rate, sigma] = [0, 1].map(|k: usize| rate[k].as_f64().expect("a number"));
    assert!((rate - 6.0).abs() < 4.0 * sigma && sigma < 0.3, "{rate} ± {sigma}");
}

#[test]
fn bending_sheet_is_followed_and_animated() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |args: &[&str]| planish(folder.path(), args).ok();
    run(&["simulate", "scene", "bending", "--readings", "8000", "--states", "3", "--out", "b"]);
    let found =
        run(&["fit", "b/job.toml", "--motion", "bend", "--states", "states", "-o", "b.planish", "--json"])
            .json();
    let bending = &found["propagation"]["bending"];
    assert_eq!(bending["isometric"], true, "{bending:#}");
    assert_eq!(bending["states"].as_array().expect("states").len(), 3);
    assert!(folder.path().join("states/state-2.ply").is_file());
    let judged = run(&["compare", "states/state-2.planish", "b/truth-2.ply", "--json"]).json();
    assert!(judged["coverage95"].as_f64().expect("a share") > 0.85, "{judged:#}");
    // A model of a bending sheet cannot be updated without its states.
    let refused = planish(folder.path(), &["fit", "b/laser-1.ply", "--update", "b.planish"]);
    assert_eq!(refused.code, 2);
    assert!(refused.stderr.contains("(option --motion)"), "{}", refused.stderr);

    run(&["fit", "b/laser-3.ply", "--animate", "forming.glb"]);
    let info = run(&["info", "forming.glb"]).stdout;
    assert!(info.contains("triangles"), "{info}");
    run(&["fit", "b/laser-3.ply", "--filter", "patch", "--animate", "frames"]);
    let frames = std::fs::read_dir(folder.path().join("frames")).expect("a folder").count();
    assert!((12..=25).contains(&frames), "{frames}");
    let refused = planish(folder.path(), &["fit", "b/laser-3.ply", "--animate", "frames"]);
    assert!(refused.stderr.contains("expected a new or empty folder"), "{}", refused.stderr);
}
