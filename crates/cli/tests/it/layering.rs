//! Which crate may use which: the arrows of the architecture, read off the manifests.

use serde_json::Value;
use std::collections::BTreeMap;
use std::process::Command;

/// For each crate its layer. A crate may use those of lower layers, never its peers or what lies above.
const LAYERS: [(&str, u8); 15] = [
    ("planish-core", 0),
    ("planish-report", 0),
    ("planish-estimate", 1),
    ("planish-spline", 2),
    ("planish-mesh", 2),
    ("planish-contour", 3),
    ("planish-shell", 3),
    ("planish-sense", 3),
    ("planish-solid", 4),
    ("planish-exchange", 5),
    ("planish-surface", 6),
    ("planish-simulate", 7),
    ("planish", 8),
    ("planish-cli", 9),
    ("planish-fuzz", 9),
];

/// What is wrong with the arrows between these crates and the crates that each of them uses.
fn complaints(uses: &BTreeMap<String, Vec<String>>) -> Vec<String> {
    let layers = BTreeMap::from(LAYERS);
    let mut found = Vec::new();
    for (user, used) in uses {
        let Some(layer) = layers.get(user.as_str()) else {
            found.push(format!("{user} has no layer: give it one here and in ARCHITECTURE.md"));
            continue;
        };
        for used in used.iter().filter(|name| uses.contains_key(*name)) {
            if layers.get(used.as_str()).is_none_or(|below| below >= layer) {
                found.push(format!("{user} must not use {used}"));
            }
        }
    }
    found
}

fn workspace() -> BTreeMap<String, Vec<String>> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--format-version", "1", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo prints JSON");
    let name = |value: &Value| value["name"].as_str().expect("a name").to_owned();
    let list = |value: &Value| value.as_array().expect("a list").clone();
    list(&metadata["packages"])
        .iter()
        // Tests and benches count too: what they need, a reader of the crate needs.
        .map(|package| (name(package), list(&package["dependencies"]).iter().map(name).collect()))
        .collect()
}

#[test]
fn crates_use_only_what_lies_below_them() {
    let uses = workspace();
    assert!(uses.contains_key("planish") && uses["planish-cli"].contains(&"planish".to_owned()));
    let found = complaints(&uses);
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn an_arrow_that_points_up_or_sideways_is_found() {
    for (user, used) in [
        ("planish-estimate", "planish-spline"),
        ("planish-mesh", "planish-spline"),
        ("planish-sense", "planish-exchange"),
        ("planish-exchange", "planish"),
        ("planish", "planish-cli"),
    ] {
        let mut uses = workspace();
        uses.get_mut(user).expect("a crate of the workspace").push(used.to_owned());
        assert_eq!(complaints(&uses), [format!("{user} must not use {used}")]);
    }
    let mut uses = workspace();
    uses.insert("planish-new".to_owned(), Vec::new());
    assert!(complaints(&uses)[0].contains("planish-new has no layer"));
}

#[test]
fn only_the_exchange_crate_touches_files() {
    let crates = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for name in ["estimate", "spline", "mesh", "sense", "report", "surface", "planish"] {
        let mut folders = vec![crates.join(name).join("src")];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).expect("a folder").map(|e| e.expect("an entry").path()) {
                if entry.is_dir() {
                    folders.push(entry);
                } else if entry.extension().is_some_and(|e| e == "rs") && !entry.ends_with("tests.rs") {
                    let text = std::fs::read_to_string(&entry).expect("a source file");
                    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
                    for touch in ["std::fs", "File::open", "File::create", "OpenOptions"] {
                        assert!(!code.contains(touch), "{} uses {touch}", entry.display());
                    }
                }
            }
        }
    }
}
