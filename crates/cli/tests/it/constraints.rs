//! Constraints of contours: detection, given constraints, snapping, degrees of freedom and graphs.

use crate::support::planish;
use serde_json::Value;
use std::path::Path;

/// Readings of a rotated rectangle of 90 × 55 with low noise.
fn readings(folder: &Path, noise: &str) {
    let args = [
        "simulate",
        "scene",
        "readings",
        "--shape",
        "rectangle",
        "--noise",
        noise,
        "--seed",
        "3",
        "--out",
        "seen",
        "-q",
    ];
    planish(folder, &args).ok();
}

fn contour(folder: &Path, args: &[&str]) -> Value {
    let all = [&["contour", "seen/readings.csv", "--json"], args].concat();
    planish(folder, &all).ok().json()
}

fn texts(list: &Value, keep: impl Fn(&Value) -> bool) -> Vec<&str> {
    let all = list.as_array().expect("a list").iter().filter(|item| keep(item));
    all.map(|item| item["text"].as_str().expect("a text")).collect()
}

#[test]
fn relations_are_imposed_and_sizes_snapped() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    readings(at, "0.1");
    let args = [
        "--kind",
        "polygon-4",
        "--snap",
        "5mm",
        "-o",
        "c.json",
        "-o",
        "c.dxf",
        "--graphs",
        "g.json",
        "--graphs",
        "g.dot",
    ];
    let result = contour(at, &args);
    let found = &result["constrained"];
    let imposed = texts(&found["relations"], |r| r["outcome"] == "imposed");
    assert_eq!(imposed.len(), 3, "{imposed:?}");
    assert!(found["relations"].as_array().expect("a list").iter().all(|r| r["p_value"].as_f64().is_some()));
    // The detected relations are those of a rectangle.
    for text in texts(&found["relations"], |r| r["outcome"] == "imposed" || r["outcome"] == "implied") {
        assert!(!text.contains("horizontal") && !text.contains("vertical"), "{text}");
    }
    let mut sizes: Vec<f64> = found["bars"]
        .as_array()
        .expect("bars")
        .iter()
        .map(|b| b["value"].as_f64().expect("a length"))
        .collect();
    sizes.sort_by(f64::total_cmp);
    for (size, truth) in sizes.iter().zip([55.0, 55.0, 90.0, 90.0]) {
        assert!((size - truth).abs() < 1e-6, "{sizes:?}");
    }
    let outcomes: Vec<&str> = found["sizes"]
        .as_array()
        .expect("sizes")
        .iter()
        .map(|s| s["outcome"].as_str().expect("a word"))
        .collect();
    assert_eq!(outcomes.iter().filter(|o| **o == "snapped").count(), 2, "{outcomes:?}");
    assert_eq!(outcomes.iter().filter(|o| **o == "implied").count(), 2, "{outcomes:?}");
    let free = &found["freedoms"];
    assert_eq!(
        (&free["parameters"], &free["rank"], &free["free"], &free["rigid_motions"]),
        (&8.into(), &5.into(), &3.into(), &3.into())
    );
    // Each implied relation names a minimal set of relations that implies it.
    assert!(found["redundant"].as_array().is_some_and(|sets| {
        !sets.is_empty() && sets.iter().all(|s| !s["with"].as_array().expect("a set").is_empty())
    }));
    // With the dimensions there are no free parameters, and the graphs match all parameters.
    let graphs: Value =
        serde_json::from_str(&std::fs::read_to_string(at.join("g.json")).expect("a file")).expect("JSON");
    assert_eq!(graphs["views"][0]["matching"].as_array().map(Vec::len), Some(8));
    assert!(std::fs::read_to_string(at.join("g.dot")).expect("DOT").contains("graph contour_bipartite {"));
    // The drawing shows the constrained contour.
    let corner = &found["contours"][0]["parameters"]["x0"]["value"];
    let dxf = std::fs::read_to_string(at.join("c.dxf")).expect("DXF");
    assert!(dxf.contains(&format!("\n{corner}\n")), "{corner}");
}

#[test]
fn unsupported_grid_is_not_imposed() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    readings(at, "0.1");
    let outcomes = |grid: &str| -> Vec<String> {
        let result = contour(at, &["--kind", "rectangle", "--snap", grid]);
        let sizes = result["constrained"]["sizes"].as_array().expect("sizes").clone();
        sizes.iter().map(|s| s["outcome"].as_str().expect("a word").to_owned()).collect()
    };
    assert!(outcomes("0.01mm").iter().all(|o| o == "ambiguous"));
    assert!(outcomes("37mm").iter().all(|o| o == "off_grid"));
}

#[test]
fn given_constraints_are_imposed_and_tested() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    readings(at, "0.1");
    let result = contour(at, &["--kind", "rectangle", "--given", "P1P2 is 90 long"]);
    let width = &result["constrained"]["contours"][0]["parameters"]["width"];
    assert!((width["value"].as_f64().expect("a width") - 90.0).abs() < 1e-9);
    assert!(
        width["sigma"].as_f64() < Some(1e-6)
            && result["contours"][0]["parameters"]["width"]["sigma"].as_f64() > Some(0.01)
    );
    assert_eq!(result["warnings"].as_array().map(Vec::len), Some(0), "{result}");
    // A constraint that contradicts the readings gives a warning.
    let result = contour(at, &["--kind", "rectangle", "--given", "P1P2 is 85 long"]);
    assert!(
        result["warnings"][0].as_str().is_some_and(|w| w.contains("conflict with the readings")),
        "{result}"
    );
    // A redundant constraint names the constraints that imply it.
    let result = contour(at, &["--kind", "rectangle", "--given", "P1P2 parallel to P3P4"]);
    let redundant = &result["constrained"]["redundant"][0];
    assert_eq!(
        (redundant["text"].as_str(), redundant["with"].as_array().map(Vec::len)),
        (Some("P1P2 parallel to P3P4"), Some(2))
    );
}

#[test]
fn invalid_constraints_are_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    readings(at, "0.1");
    for (args, expected) in [
        (
            &["--given", "P1P9 horizontal"][..],
            "constraint `P1P9 horizontal`: the drawing has no point `P9`: it has 4",
        ),
        (&["--given", "P1P2 over P3P4"], "constraint `P1P2 over P3P4`: expected a sentence such as"),
        (&["--given", "P1P2 is 90 long", "--given", "P3P4 is 80 long"], "`P3P4 is 80 long` conflicts with"),
        (&["--snap", "0"], "--snap"),
        (&["--snap", "2parsec"], "unit `parsec`"),
        (&["--level", "1"], "a probability above 0 and below 1"),
        (&["--graphs", "g.txt"], "g.txt: cannot write this format: expected .json or .dot"),
        (&["--graphs", "seen/readings.csv"], "seen/readings.csv"),
    ] {
        let all = [&["contour", "seen/readings.csv", "--kind", "rectangle"], args].concat();
        let result = planish(at, &all);
        assert!(
            result.code == 2 && result.stderr.contains(expected),
            "{args:?}: {} {}",
            result.code,
            result.stderr
        );
    }
}

#[test]
fn contours_of_every_kind_are_constrained() {
    for shape in ["circle", "ellipse", "slot", "rounded-rectangle", "regular-polygon-6", "polygon-6"] {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path();
        planish(
            at,
            &["simulate", "scene", "readings", "--shape", shape, "--noise", "0.1", "--out", "seen", "-q"],
        )
        .ok();
        let result = contour(at, &["--kind", shape, "--constrain"]);
        let found = &result["constrained"];
        let (before, after) = (&result["contours"][0], &found["contours"][0]);
        assert_eq!((&before["kind"], &before["order"]), (&after["kind"], &after["order"]), "{shape}");
        for name in before["order"].as_array().expect("names") {
            let name = name.as_str().expect("a name");
            let value =
                |result: &Value, what: &str| result["parameters"][name][what].as_f64().expect("a number");
            let off = (value(before, "value") - value(after, "value")).abs();
            assert!(off <= 4.0 * value(before, "sigma"), "{shape} {name}: {off}");
            assert!(value(after, "sigma") <= 1.0001 * value(before, "sigma") + 1e-9, "{shape} {name}");
        }
        assert!(found["freedoms"]["free"].as_u64() >= Some(3), "{shape}");
    }
}
