//! JSON keys that other programs rely on.

use crate::support::{part_of_pebble, pebble, planish, repository};
use serde_json::Value;

const COMMON: [&str; 11] = [
    "command",
    "version",
    "seconds",
    "threads",
    "seed",
    "unit",
    "inputs",
    "outputs",
    "warnings",
    "findings",
    "termination",
];

#[track_caller]
fn has(object: &Value, keys: &[&str]) {
    for key in keys {
        assert!(object.get(key).is_some(), "no `{key}` in {object:#}");
    }
}

#[track_caller]
fn has_common(object: &Value, command: &str) {
    has(object, &COMMON);
    assert_eq!(object["command"], command);
    assert_eq!(object["version"], env!("CARGO_PKG_VERSION"));
    assert!(object["seconds"].as_f64().is_some_and(|s| s > 0.0));
    for list in ["inputs", "outputs", "warnings"] {
        assert!(object[list].as_array().is_some_and(|l| l.iter().all(Value::is_string)), "{list}");
    }
    for finding in object["findings"].as_array().expect("a list") {
        has(finding, &["code", "level", "text"]);
    }
    let endings = ["converged", "reached_tolerance", "limit", "undetermined"];
    assert!(endings.contains(&object["termination"].as_str().unwrap_or_default()));
}

/// `next` on `p.planish`: its keys, and poses that `fit` accepts once the scans exist.
#[track_caller]
fn proposes_points_and_views(folder: &std::path::Path) {
    let run = |args: &[&str]| planish(folder, args).ok().json();
    let next = run(&["next", "p.planish", "--count", "3", "--against-random", "5", "--json"]);
    has_common(&next, "next");
    let keys = ["position", "normal", "sigma_before", "sigma_after", "worst_sigma_after"];
    has(&next["points"][2], &keys);
    has(&next["worst_sigma"], &["before", "after"]);
    has(&next["random"], &["draws", "worst_sigma_median"]);

    let sensor = repository().join("examples/data/camera.toml").display().to_string();
    let line = ["next", "p.planish", "--views", "2", "--sensor", &sensor, "-o", "views.toml", "--json"];
    let views = run(&line);
    has_common(&views, "next");
    let keys = ["translation", "quaternion_xyzw", "readings", "seen", "worst_sigma_after"];
    has(&views["views"][1], &keys);
    has(&views, &["worst_sigma", "mean_sigma", "unseen", "candidates"]);
    let after = |k: &str| views["worst_sigma"][k].as_f64().expect("a number");
    assert!(after("after") < after("before"), "{views:#}");
    for scan in ["view-1.ply", "view-2.ply"] {
        std::fs::copy(pebble("laser-1.ply"), folder.join(scan)).expect("a copy");
    }
    let job = run(&["info", "views.toml", "--json"]);
    assert_eq!(job["kind"], "scans", "{job:#}");
    let alone = planish(folder, &["next", "p.planish", "--views", "2"]);
    assert!(alone.code == 2 && alone.stderr.contains("--sensor"), "{}", alone.stderr);
}

#[test]
fn every_command_prints_one_object_with_the_keys_of_the_contract() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |args: &[&str]| planish(folder.path(), args).ok();
    std::fs::write(folder.path().join("job.toml"), part_of_pebble(&["laser-1.ply", "old-1.ply"]))
        .expect("a job");

    let fit = run(&["fit", "job.toml", "-o", "p.planish", "--json", "--threads", "1", "--seed", "3"]).json();
    has_common(&fit, "fit");
    has(
        &fit,
        &[
            "observations",
            "rejected",
            "shape",
            "coefficients",
            "levels",
            "cells",
            "rms",
            "rms_normalised",
            "reduced_chi_square",
            "sensors",
            "poses",
            "sigma",
            "observed_area_fraction",
            "smoothness_weight",
            "held_out",
        ],
    );
    has(&fit["sensors"][0], &["name", "observations", "sigma_stated", "sigma_estimated", "rms"]);
    let pose = ["scan", "translation", "quaternion_xyzw", "sigma_translation", "sigma_rotation_deg"];
    has(&fit["poses"][0], &pose);
    has(&fit["sigma"], &["median", "p95", "max"]);
    has(&fit["held_out"], &["n", "rms_normalised"]);
    assert!(fit["rejected"].as_object().is_some_and(|r| r.values().all(Value::is_u64)));
    assert_eq!((&fit["threads"], &fit["seed"], &fit["unit"]), (&1.into(), &3.into(), &"mm".into()));
    assert_eq!(fit["outputs"], serde_json::json!(["p.planish"]));
    assert_eq!(fit["inputs"].as_array().map(Vec::len), Some(3), "the job and its scans");

    proposes_points_and_views(folder.path());

    let compare = run(&["compare", "p.planish", &pebble("truth.ply"), "--json"]).json();
    has_common(&compare, "compare");
    has(&compare, &["forward", "backward", "coverage95"]);
    for direction in ["forward", "backward"] {
        has(&compare[direction], &["rms", "mean", "p50", "p95", "max", "n"]);
    }

    for (file, kind, keys) in [
        ("job.toml", "scans", &["points", "box", "sensors", "scans"][..]),
        (&pebble("laser-1.ply"), "scan", &["points", "columns", "box", "grid"]),
        (&pebble("truth.ply"), "mesh", &["vertices", "triangles", "watertight", "box"]),
        ("p.planish", "model", &["shape", "coefficients", "levels", "sensors", "sessions", "sigma"]),
    ] {
        let info = run(&["info", file, "--json"]).json();
        has_common(&info, "info");
        assert_eq!(info["kind"], kind);
        has(&info, keys);
    }

    let scene = run(&["simulate", "scene", "scans", "--readings", "400", "--out", "scene", "--json"]).json();
    has_common(&scene, "simulate scene scans");
    has(&scene, &["rows", "columns"]);
}

#[test]
fn json_is_alone_on_stdout_and_warnings_on_stderr() {
    let folder = tempfile::tempdir().expect("a folder");
    let xyz: String = (0..400).map(|k| format!("{} {} 0.0{}\n", k % 20, k / 20, (7 * k) % 10)).collect();
    std::fs::write(folder.path().join("a.xyz"), xyz).expect("points");
    let result = planish(folder.path(), &["fit", "a.xyz", "--json"]).ok();
    assert!(result.json()["warnings"][0].as_str().is_some_and(|w| w.contains("unit of length")));
    assert!(result.stderr.contains("planish: warning: no file states its unit of length"));
    let result = planish(folder.path(), &["fit", "a.xyz", "--json", "--quiet", "--unit", "m"]).ok();
    assert_eq!((result.json()["unit"].as_str(), result.stderr.as_str()), (Some("m"), ""));
    let result = planish(folder.path(), &["fit", "a.xyz", "--quiet"]).ok();
    assert_eq!((result.stdout.as_str(), result.stderr.as_str()), ("", ""));
}

#[test]
fn parse_error_prints_an_object() {
    let folder = tempfile::tempdir().expect("a folder");
    for (line, command, words) in [
        ("fit --json", "fit", "required arguments were not provided: <SCAN>..."),
        ("fit a.xyz --json --gate 0", "fit", "expected at least 1 σ"),
        ("frobnicate --json", "", "unrecognized subcommand 'frobnicate'"),
        ("simulate scene scans --json", "simulate scene scans", "--out <DIR>"),
    ] {
        let result = planish(folder.path(), &line.split(' ').collect::<Vec<_>>());
        assert_eq!(result.code, 2, "{line}");
        let object = result.json();
        has(&object, &COMMON);
        assert_eq!((&object["command"], &object["termination"]), (&command.into(), &Value::Null));
        assert_eq!(object["error"]["kind"], "input");
        let message = object["error"]["message"].as_str().unwrap_or_default();
        assert!(message.contains(words) && !message.starts_with("error"), "{message}");
        assert!(result.stderr.contains("--help"), "people are told too: {}", result.stderr);
    }
    let help = planish(folder.path(), &["fit", "--json", "--help"]).ok();
    assert!(help.stdout.contains("Usage: planish fit"));
}

#[test]
fn failure_prints_an_object() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("three.xyz"), "0 0 0\n1 0 0\n0 1 0\n").expect("points");
    let result = planish(folder.path(), &["fit", "three.xyz", "--json"]);
    assert_eq!(result.code, 1);
    let object = result.json();
    has(&object, &COMMON);
    assert_eq!(
        (&object["termination"], &object["error"]["kind"]),
        (&"undetermined".into(), &"undetermined".into())
    );
    let object = planish(folder.path(), &["fit", "gone.xyz", "--json"]).json();
    assert_eq!((&object["termination"], &object["error"]["kind"]), (&Value::Null, &"io".into()));
    assert!(object["error"]["message"].as_str().is_some_and(|m| m.contains("gone.xyz")));
}
