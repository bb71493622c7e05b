//! Output for programs: progress events, shell completions and pages of the manual.

use crate::support::{names, pebble, planish};
use serde_json::Value;

#[test]
fn json_progress_has_one_object_per_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = planish(
        folder.path(),
        &[
            "fit",
            &pebble("job.toml"),
            "-o",
            "a.planish",
            "--max-coefficients",
            "300",
            "--progress",
            "json",
            "--json",
        ],
    )
    .ok();
    let events: Vec<Value> = (result.stderr.lines().filter(|line| line.starts_with('{')))
        .map(|line| serde_json::from_str(line).expect("an object"))
        .collect();
    let (last, progress) = events.split_last().expect("events");
    assert_eq!((last["event"].as_str(), last["exit_code"].as_u64()), (Some("finished"), Some(0)));
    assert!(progress.iter().all(|event| event["event"] == "progress"));
    let stages: Vec<&str> = progress.iter().filter_map(|event| event["stage"].as_str()).collect();
    assert!(stages.contains(&"reading") && stages.contains(&"writing"), "{stages:?}");
    let seconds: Vec<f64> = events.iter().filter_map(|event| event["seconds"].as_f64()).collect();
    assert!(seconds.is_sorted() && seconds.len() == events.len());
    assert!(progress.iter().all(|event| event["share"].as_f64().is_some_and(|s| (0.0..=1.0).contains(&s))));
    // The final rms of the pebble's residuals is 0.157 mm.
    let rms = progress.iter().filter_map(|event| event["rms"].as_f64()).next_back();
    assert!(rms.is_some_and(|rms| (0.1..0.4).contains(&rms)), "{rms:?}");
    // Stdout has only the result.
    assert_eq!(result.json()["command"], "fit");
}

#[test]
fn pipes_get_no_progress_unless_requested() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = planish(folder.path(), &["info", &pebble("job.toml")]).ok();
    assert_eq!(result.stderr, "");
    let failed = planish(folder.path(), &["info", "gone.ply", "--progress", "json"]);
    let last = failed.stderr.lines().last().expect("a line");
    let event: Value = serde_json::from_str(last).expect("an object");
    assert_eq!((event["event"].as_str(), event["exit_code"].as_u64()), (Some("finished"), Some(3)));
}

#[test]
fn completions_and_manual_cover_all_commands() {
    let folder = tempfile::tempdir().expect("a folder");
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = planish(folder.path(), &["completions", shell]).ok().stdout;
        for command in ["fit", "view", "simulate", "mesh-tolerance"] {
            assert!(script.contains(command), "{shell} does not complete {command}");
        }
    }
    let page = planish(folder.path(), &["man"]).ok().stdout;
    assert!(page.contains(".TH planish 1") && page.contains("planish\\-fit(1)"), "{page}");
    let fit_page = planish(folder.path(), &["man", "fit"]).ok().stdout;
    assert!(fit_page.contains(".TH planish-fit 1") && fit_page.contains("max\\-coefficients"), "{fit_page}");
    let scene_page = planish(folder.path(), &["man", "simulate", "scene", "scans"]).ok().stdout;
    assert!(scene_page.contains(".TH planish-simulate-scene-scans 1"), "{scene_page}");
    let unknown = planish(folder.path(), &["man", "frobnicate"]);
    assert!(unknown.code == 2 && unknown.stderr.contains("found `frobnicate`"), "{}", unknown.stderr);
    planish(folder.path(), &["man", "--out", "man1"]).ok();
    let pages = names(&folder.path().join("man1"));
    for name in ["planish.1", "planish-fit.1", "planish-simulate-scene-scans.1", "planish-view.1"] {
        assert!(pages.iter().any(|page| page == name), "{name} is not among {pages:?}");
    }
    let fit = std::fs::read_to_string(folder.path().join("man1/planish-fit.1")).expect("a page");
    assert!(fit.contains("planish fit") && fit.contains("max\\-coefficients"));
}
