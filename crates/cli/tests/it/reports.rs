//! HTML reports: each is self-contained and shows the results of its command.

use crate::support::{pebble, planish, repository};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// A report and its scene; null if it has none.
fn read(folder: &Path, name: &str) -> (String, Value) {
    let page = std::fs::read_to_string(folder.join(name)).expect("a report");
    assert!(page.contains("default-src 'none'"), "{name} may load from elsewhere");
    let scene = page.split("id=\"scene\">").nth(1).and_then(|rest| rest.split("</script>").next());
    let scene = scene.map_or(Value::Null, |scene| serde_json::from_str(scene).expect("a scene"));
    (page, scene)
}

/// Points evenly over a ball.
fn ball(radius: f64, stretch: f64) -> String {
    let mut text = String::new();
    for k in 0..600 {
        let z = 1.0 - 2.0 * (f64::from(k) + 0.5) / 600.0;
        let (sine, cosine) = (2.399_963 * f64::from(k)).sin_cos();
        let r = (1.0 - z * z).sqrt();
        let [x, y, z] = [r * cosine * stretch, r * sine, z].map(|c| radius * c);
        writeln!(text, "{x} {y} {z}").expect("text");
    }
    text
}

#[test]
fn planned_views_are_marked_on_the_model() {
    let folder = tempfile::tempdir().expect("a folder");
    planish(
        folder.path(),
        &["fit", &pebble("job.toml"), "-o", "a.planish", "--max-coefficients", "300", "--quiet"],
    )
    .ok();
    let sensor = repository().join("examples/data/camera.toml").display().to_string();
    let result = planish(
        folder.path(),
        &["next", "a.planish", "--views", "2", "--sensor", &sensor, "--report", "a.html", "--json"],
    )
    .ok()
    .json();
    let (page, scene) = read(folder.path(), "a.html");
    let views = result["views"].as_array().expect("views");
    assert_eq!(scene["marks"].as_array().map(Vec::len), Some(views.len()));
    assert!(page.contains("fields of view") && page.contains("Views to take, in this order"));
    // Each line of sight goes from the surface to the sensor, so its ends and the sensor are collinear.
    let lines = scene["lines"].as_array().expect("lines");
    assert!(lines.iter().any(|line| line["name"] == "lines to the sensor" && line["hidden"] == false));
    let number = |value: &Value| value.as_f64().expect("a number");
    for (mark, view) in scene["marks"].as_array().expect("marks").iter().zip(views) {
        let off: Vec<f64> = (0..3)
            .map(|d| number(&view["translation"][d]) - number(&mark["at"][d]) - number(&scene["centre"][d]))
            .collect();
        let length = off.iter().map(|c| c * c).sum::<f64>().sqrt();
        let along: f64 = (0..3).map(|d| off[d] / length * number(&mark["normal"][d])).sum();
        assert!(along > 0.999_999, "{along}");
        assert!((50.0..900.0).contains(&length), "{length}");
    }
}

#[test]
fn report_shows_a_shape_in_space_with_its_readings() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut readings = "x,y,z,sigma\n".to_owned();
    for line in ball(2.0, 1.0).lines() {
        readings += &format!("{},0.01\n", line.replace(' ', ","));
    }
    std::fs::write(folder.path().join("points.csv"), readings).expect("a file");
    let result = planish(
        folder.path(),
        &["contour", "points.csv", "--kind", "sphere", "--report", "a.html", "--json"],
    );
    assert_eq!(result.code, 0, "{}", result.stderr);
    let (page, scene) = read(folder.path(), "a.html");
    assert!(page.contains("One sphere in 600 readings."));
    assert_eq!(scene["surfaces"][0]["name"], "sphere");
    assert_eq!(scene["clouds"][0]["hidden"], false);
    assert!((scene["high"][0].as_f64().expect("a number") - 2.0).abs() < 0.01);
}

#[test]
fn report_shows_displacements_of_a_fitted_mesh() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("points.xyz"), ball(10.0, 1.1)).expect("a file");
    let octahedron = "v 10 0 0\nv -10 0 0\nv 0 10 0\nv 0 -10 0\nv 0 0 10\nv 0 0 -10\n\
                      f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
    std::fs::write(folder.path().join("start.obj"), octahedron).expect("a file");
    let result = planish(
        folder.path(),
        &[
            "shell",
            "fit",
            "start.obj",
            "--points",
            "points.xyz",
            "--deformation",
            "vertices",
            "--report",
            "a.html",
            "--json",
        ],
    );
    assert_eq!(result.code, 0, "{}", result.stderr);
    let result = result.json();
    let (page, scene) = read(folder.path(), "a.html");
    let keys: Vec<&str> = (scene["surfaces"][0]["fields"].as_array().expect("fields").iter())
        .filter_map(|field| field["key"].as_str())
        .collect();
    assert_eq!(keys, ["sigma", "observed", "moved"]);
    assert_eq!(scene["surfaces"][1]["name"], "input mesh");
    assert!(page.contains("input points") && page.contains("<td>points</td>"));
    let outputs = result["outputs"].as_array().expect("outputs");
    assert!(outputs.iter().any(|output| output == "a.html"));
}

#[test]
fn report_shows_curves_of_a_simulated_sphere() {
    let folder = tempfile::tempdir().expect("a folder");
    let result = planish(
        folder.path(),
        &[
            "simulate",
            "sphere",
            "--sets",
            "1",
            "--readings",
            "50",
            "--depth",
            "0",
            "-o",
            "a.csv",
            "--report",
            "a.html",
            "--json",
        ],
    )
    .ok()
    .json();
    let (page, scene) = read(folder.path(), "a.html");
    assert!(scene.is_null());
    let rows = result["rows"].as_array().expect("rows").len();
    let table = page.split("<tbody>").nth(1).and_then(|rest| rest.split("</tbody>").next()).expect("a table");
    assert_eq!(table.matches("<tr>").count(), rows);
    assert!(page.contains("<svg") && page.contains("<polyline"));
}
