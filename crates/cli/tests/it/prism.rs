//! The prism of the paper from readings to STEP: contours, constraints, graphs, and a solid with σ.

use crate::support::planish;
use serde_json::Value;
use std::path::Path;

/// Width, depth and height of the prism that `simulate scene views` makes.
const SIZE: [f64; 3] = [80.0, 100.0, 60.0];

/// Readings of the prism's views, and their contours.
fn contours(folder: &Path, seed: u64) {
    let seed = seed.to_string();
    planish(folder, &["simulate", "scene", "views", "--out", "prism", "--seed", &seed, "-q"]).ok();
    for (view, kind) in [("front", "polygon-3"), ("top", "polygon-4"), ("side", "polygon-4")] {
        let readings = format!("prism/{view}/readings.csv");
        let written = format!("{view}.json");
        planish(folder, &["contour", &readings, "--kind", kind, "--constrain", "-o", &written, "-q"]).ok();
    }
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("a file")).expect("JSON")
}

#[test]
fn prism_views_give_a_solid_whose_intervals_cover_the_true_sizes() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    contours(at, 2);
    let args = ["solid", "front.json", "top.json", "side.json", "-o", "p.step", "-o", "p.json", "--json"];
    let result = planish(at, &args).ok().json();
    assert_eq!(result["solutions"][0]["faces"]["plane"], 5);
    assert_eq!(json(&at.join("p.json"))["geometry"], result["geometry"]);
    let step = std::fs::read_to_string(at.join("p.step")).expect("STEP");
    assert!(step.starts_with("ISO-10303-21;") && step.matches("PLANE(").count() == 5);
    let dimensions = result["geometry"]["dimensions"].as_array().expect("dimensions");
    assert_eq!(dimensions.len(), 3 + 9);
    let truths = [SIZE[0], SIZE[1], SIZE[2], SIZE[0].hypot(SIZE[2])];
    for dimension in dimensions {
        let (value, sigma) =
            (dimension["value"].as_f64().expect("a value"), dimension["sigma"].as_f64().expect("σ"));
        let off = truths.iter().map(|t| (t - value).abs()).fold(f64::INFINITY, f64::min);
        assert!(off < 4.0 * sigma && sigma > 0.01 && sigma < 0.3, "{dimension}");
    }
    for vertex in result["geometry"]["vertices"].as_array().expect("vertices") {
        assert!(
            vertex["sigma"].as_array().is_some_and(|s| s.iter().all(|s| s.as_f64() > Some(0.0))),
            "{vertex}"
        );
    }
    // Each view that shows an axis reduces its σ.
    let front = json(&at.join("front.json"));
    let bars = front["constrained"]["bars"].as_array().expect("bars");
    let extent = dimensions[2]["sigma"].as_f64().expect("σ");
    assert!(bars.iter().any(|bar| bar["sigma"].as_f64() > Some(extent)));
}

#[test]
fn prism_graphs_match_the_paper() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    contours(at, 2);
    let args = [
        "solid",
        "front.json",
        "side.json",
        "--as",
        "front,side",
        "-o",
        "p.step",
        "--graphs",
        "g.json",
        "--graphs",
        "g.dot",
        "-q",
    ];
    planish(at, &args).ok();
    let graphs = json(&at.join("g.json"));
    // Ranks 6 and 8, with matchings of the same size: eq. 4.1 and 4.2 of the paper.
    for (i, rank) in [6, 8].into_iter().enumerate() {
        let view = &graphs["views"][i];
        assert_eq!(
            (&view["parameters"], &view["rank"], &view["structure"]["rank"]),
            (&rank.into(), &rank.into(), &rank.into())
        );
        assert_eq!(view["matching"].as_array().map(Vec::len), Some(rank));
        assert_eq!(view["full"]["nodes"].as_array().map(Vec::len), Some(rank));
        assert_eq!(view["pair"]["nodes"].as_array().map(Vec::len), Some(rank / 2));
        assert_eq!(view["tours"][0]["repeated"].as_array().map(Vec::len), Some(0));
    }
    let composite = &graphs["composite"];
    assert_eq!(composite["vertices"].as_array().map(Vec::len), Some(6));
    assert!(composite["unmatched"].as_array().is_some_and(Vec::is_empty));
    // Nine edges, and a diagonal of each face that both views see edge-on.
    assert!(composite["edges"].as_array().map(Vec::len) >= Some(9));
    assert_eq!(composite["tour"]["vertices"][0], "V1");
    let dot = std::fs::read_to_string(at.join("g.dot")).expect("DOT");
    for name in [
        "graph front_full {",
        "graph side_bipartite {",
        "digraph front_minimal {",
        "digraph side_pair {",
        "graph composite {",
    ] {
        assert!(dot.contains(name), "{name}");
    }
}

#[test]
fn inconsistent_views_are_reported() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = folder.path();
    contours(at, 2);
    // The side view in another frame.
    let moved = std::fs::read_to_string(at.join("side.json")).expect("a file");
    let mut side: Value = serde_json::from_str(&moved).expect("JSON");
    for part in ["x0", "x1", "x2", "x3", "y0", "y1", "y2", "y3"] {
        let value = &mut side["contours"][0]["parameters"][part]["value"];
        *value = (value.as_f64().expect("a value") * 1.1).into();
    }
    std::fs::write(at.join("scaled.json"), side.to_string()).expect("a file");
    side["unit"] = "in".into();
    std::fs::write(at.join("inches.json"), side.to_string()).expect("a file");
    std::fs::write(at.join("broken.json"), "{ \"kind\": 3 }").expect("a file");
    std::fs::write(at.join("a.dxf"), "0\nEOF\n").expect("a file");
    for (args, expected) in [
        (&["front.json"][..], "found 1"),
        (
            &["front.json", "top.json", "scaled.json"],
            "expected views of one object, at one scale, in one frame",
        ),
        (&["front.json", "top.json", "inches.json"], "inches.json: expected one unit"),
        (&["front.json", "broken.json"], "broken.json: expected contours as"),
        (&["front.json", "a.dxf"], "a.dxf: expected a contour"),
        (&["front.json", "side.json"], "the front view ends at x"),
        (&["front.json", "side.json", "--as", "front"], "expected one name for each of the 2 views"),
        (&["front.json", "side.json", "--as", "side,side"], "each once, found side,side"),
        (
            &["front.json", "side.json", "--as", "front,side", "--graphs", "g.png"],
            "g.png: cannot write this format: expected .json or .dot",
        ),
        (
            &["front.json", "side.json", "--as", "front,side", "-o", "p.iges"],
            "p.iges: cannot write this format: expected .step",
        ),
        (
            &["a.dxf", "a.dxf", "--graphs", "g.dot"],
            "expected contours with their covariance (.json) for graphs",
        ),
    ] {
        let result = planish(at, &[&["solid"], args].concat());
        assert!(
            result.code == 2 && result.stderr.contains(expected),
            "{args:?}: {} {}",
            result.code,
            result.stderr
        );
    }
}
