//! Direction of imports: between crates by their manifests, between the top-level modules of a crate by its
//! code.

use crate::sources::{Source, sources};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// For each crate its layer. A crate may use those of lower layers, never its peers or what lies above.
const LAYERS: [(&str, u8); 15] = [
    ("planish-core", 0),
    ("planish-report", 1),
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

/// Violations of the layering, given the crates that each crate uses.
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
        // Dependencies of tests and benches count, because a reader of the crate needs them, too.
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
fn forbidden_dependency_is_found() {
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

/// The top-level modules of each crate with the modules that each of them names as `crate::…`, outside tests.
fn module_uses(sources: &[Source]) -> BTreeMap<(String, String), BTreeSet<String>> {
    let mut uses = BTreeMap::<(String, String), BTreeSet<String>>::new();
    for source in sources.iter().filter(|source| !source.is_test()) {
        let Some(module) = source.module() else { continue };
        let used = uses.entry((source.krate.clone(), module.to_owned())).or_default();
        let code = source.code();
        for (at, _) in code.match_indices("crate::") {
            if !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_') {
                used.extend(first_names(&code[at + "crate::".len()..]));
            }
        }
    }
    uses
}

/// The first names of a path, or of each path of a group in braces.
fn first_names(path: &str) -> Vec<String> {
    let name = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let Some(group) = path.strip_prefix('{') else {
        return vec![name(path)];
    };
    let mut depth = 0;
    let mut names = Vec::new();
    let mut start = 0;
    for (at, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' | ',' if depth == 0 => {
                names.push(name(group[start..at].trim_start()));
                start = at + 1;
                if c == '}' {
                    break;
                }
            }
            '}' => depth -= 1,
            _ => {}
        }
    }
    names
}

/// Pairs of top-level modules that import each other, as `crate: a <-> b`.
fn mutual_pairs(uses: &BTreeMap<(String, String), BTreeSet<String>>) -> Vec<String> {
    let names = |krate: &str, a: &str, b: &str| {
        uses.get(&(krate.to_owned(), a.to_owned())).is_some_and(|used| used.contains(b))
    };
    uses.iter()
        .flat_map(|((krate, a), used)| {
            used.iter()
                .filter(move |b| a < *b && names(krate, b, a))
                .map(move |b| format!("{krate}: {a} <-> {b}"))
        })
        .collect()
}

#[test]
fn no_two_top_level_modules_of_a_crate_import_each_other() {
    let pairs = mutual_pairs(&module_uses(&sources()));
    assert!(pairs.is_empty(), "{}", pairs.join("\n"));
}

#[test]
fn mutual_imports_are_found() {
    let source = |path: &str, text: &str| Source {
        krate: "mesh".to_owned(),
        path: format!("src/{path}"),
        text: text.to_owned(),
    };
    let found = |sources: &[Source]| mutual_pairs(&module_uses(sources));
    let upper = source("upper/part.rs", "use crate::{error::Error, lower::{self, Leaf}};\n");
    let lower = source("lower.rs", "fn f() {\n    crate::upper::part();\n}\n");
    assert_eq!(found(&[upper, lower]), ["mesh: lower <-> upper"]);
    // Imports in comments and tests do not count.
    let upper = source("upper.rs", "use crate::lower::Leaf;\n");
    let lower = source(
        "lower.rs",
        "/// See [`crate::upper`].\nstruct A;\n#[cfg(test)]\nmod tests {\n    use crate::upper::B;\n}\n",
    );
    assert!(found(&[upper, lower]).is_empty());
}

#[test]
fn only_the_exchange_crate_touches_files() {
    let pure =
        ["core", "estimate", "spline", "mesh", "contour", "solid", "shell", "sense", "report", "surface"];
    for source in sources().iter().filter(|s| pure.contains(&s.krate.as_str()) || s.krate == "planish") {
        // The budget reads what the machine says about its memory, no file of a user.
        let is_budget = source.krate == "core" && source.path.ends_with("budget.rs");
        if source.is_test() || source.module().is_none() || is_budget {
            continue;
        }
        let code = source.code();
        for touch in ["std::fs", "File::open", "File::create", "OpenOptions"] {
            assert!(!code.contains(touch), "{}/{} uses {touch}", source.krate, source.path);
        }
    }
}
