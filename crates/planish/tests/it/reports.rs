//! Reports: a self-contained page whose 3D view holds the values of the files, with findings about problems.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use planish::Job;
use planish::compare::CompareJob;
use planish::fit_files::FitJob;
use planish::next::{NextJob, NextOptions};
use planish::progress::Silent;
use planish::report::ReportOutput;
use planish_exchange::mesh::read_mesh;
use serde_json::Value;
use std::path::{Path, PathBuf};

fn pebble() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/data/pebble")
}

fn output(path: PathBuf) -> ReportOutput {
    ReportOutput { path, command: "planish <test>".to_owned(), seed: 0 }
}

/// The page, and the scene in it.
fn read(path: &Path) -> (String, Value) {
    let page = std::fs::read_to_string(path).expect("a report");
    let scene = page.split("<script type=\"application/json\" id=\"scene\">").nth(1).expect("a report");
    let scene = serde_json::from_str(scene.split("</script>").next().expect("a report")).expect("a report");
    (page, scene)
}

fn floats(packed: &Value) -> Vec<f32> {
    assert_eq!(packed["type"], "f32");
    let bytes = STANDARD.decode(packed["data"].as_str().expect("a report")).expect("a report");
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

fn field<'a>(surface: &'a Value, key: &str) -> &'a Value {
    let fields = surface["fields"].as_array().expect("a report");
    fields.iter().find(|f| f["key"] == key).expect("a report")
}

/// A page that loads nothing: no script, style, picture or frame from elsewhere, and a policy that forbids
/// it.
fn needs_no_network(page: &str) {
    assert!(page.contains("default-src 'none'") && page.contains("script-src 'sha256-"));
    let policy = page.split("Content-Security-Policy").nth(1).and_then(|rest| rest.split('>').next());
    assert!(policy.is_some_and(|policy| !policy.contains("unsafe")), "{policy:?}");
    // Names of namespaces and licences are in the scripts; what is around them has no address at all.
    let around: String =
        page.split("<script").map(|part| part.split("</script>").last().unwrap_or_default()).collect();
    for load in ["http:", "https:", " src=", "url(", "@import", "<iframe", "<img"] {
        assert!(!around.contains(load), "the page has {load}");
    }
    // The policy permits the style sheet only, so browsers would ignore attributes with style or code.
    for refused in [" style=", " onclick=", " onload=", "javascript:"] {
        assert!(!around.contains(refused), "the page has {refused}");
    }
}

#[test]
fn a_report_of_a_fit_contains_the_figures_of_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let [page, mesh] = ["pebble.html", "pebble.ply"].map(|name| folder.path().join(name));
    let job = FitJob {
        inputs: vec![pebble().join("job.toml")],
        outputs: vec![mesh.clone()],
        mesh_tolerance: Some(0.05.into()),
        report: Some(output(page.clone())),
        ..FitJob::default()
    };
    let done = job.run(&Silent).unwrap();
    let (text, scene) = read(&page);
    needs_no_network(&text);
    let written = read_mesh(&mesh).unwrap();
    let surface = &scene["surfaces"][0];
    let positions = floats(&surface["positions"]);
    assert_eq!(positions.len(), 3 * written.points.len());
    for (shown, point) in positions.chunks_exact(3).zip(&written.points) {
        for d in 0..3 {
            let position = f64::from(shown[d]) + scene["centre"][d].as_f64().unwrap();
            assert!((position - point[d]).abs() < 1e-5, "{position} {}", point[d]);
        }
    }
    // What a click reads is what the file says.
    let sigma: Vec<f32> = written.column("sigma").unwrap().iter().map(|s| *s as f32).collect();
    assert_eq!(floats(&field(surface, "sigma")["values"]), sigma);
    // The sensor with a misstated σ is named, and the accuracy of the others is shown.
    let false_sigma = |f: &planish::Finding| {
        f.code == planish::FindingCode::SensorSigmaMisstated && f.text.contains("\"old\"")
    };
    assert!(done.fit.findings.iter().any(false_sigma) && text.contains("states σ = "));
    assert!(!text.contains("does not fit") && text.contains("σ is consistent"));
    assert!(done.fit.sensors.iter().all(|sensor| text.contains(&sensor.name)));
    // The command is text, not markup; every input has its checksum.
    assert!(text.contains("planish &#60;test&#62;") || text.contains("planish &lt;test&gt;"));
    assert!(text.contains(&planish_exchange::sha256_of(&pebble().join("probe.ply")).unwrap()));
    // The number of used readings is that of the fit's figures, and every part was seen by a scan that
    // exists.
    let clouds = scene["clouds"].as_array().unwrap();
    assert!(clouds[0]["name"].as_str().unwrap().starts_with("readings"));
    assert_eq!(scene["marks"].as_array().unwrap().len(), 5);
    let sets = &surface["sets"];
    let scans = sets["names"].as_array().unwrap().len();
    assert_eq!(scans, 5);
    for set in sets["sets"].as_array().unwrap() {
        assert!(set.as_array().unwrap().iter().all(|s| (s.as_u64().unwrap() as usize) < scans));
    }
    // The same files and the same command give the same bytes.
    job.run(&Silent).unwrap();
    assert_eq!(std::fs::read_to_string(&page).unwrap(), text);
}

#[test]
fn conflicting_scans_are_named_together() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["laser-1.ply", "laser-2.ply", "laser-3.ply", "old-1.ply", "probe.ply"] {
        std::fs::copy(pebble().join(name), folder.path().join(name)).unwrap();
    }
    // The pose of the second scan is wrong by 0.4 mm (five σ), which shows at the exact points of the probe.
    let job = std::fs::read_to_string(pebble().join("job.toml")).unwrap();
    let [at, rest] = job.split_once("laser-2.ply").map(|(a, b)| [a, b]).unwrap();
    let (before, numbers) = rest.split_once("translation = [").unwrap();
    let (x, after) = numbers.split_once(',').unwrap();
    let moved: f64 = x.trim().parse::<f64>().unwrap() + 0.4;
    let job = format!("{at}laser-2.ply{before}translation = [{moved},{after}");
    std::fs::write(folder.path().join("job.toml"), job).unwrap();
    let page = folder.path().join("page.html");
    let job = FitJob {
        inputs: vec![folder.path().join("job.toml")],
        report: Some(output(page.clone())),
        ..FitJob::default()
    };
    job.run(&Silent).unwrap();
    let (text, _) = read(&page);
    let summary = text.split("<section class=\"verdict").nth(1).unwrap();
    let summary = summary.split("</section>").next().unwrap();
    assert!(summary.starts_with(" bad"), "{summary}");
    assert!(summary.contains("Scan probe.ply does not fit the others"), "{summary}");
}

#[test]
fn a_report_of_a_comparison_is_coloured_by_the_deviations_that_it_counts() {
    let folder = tempfile::tempdir().unwrap();
    let [mesh, model, page] = ["a.ply", "a.planish", "page.html"].map(|name| folder.path().join(name));
    let job = FitJob {
        inputs: vec![pebble().join("job.toml")],
        outputs: vec![mesh.clone(), model.clone()],
        mesh_tolerance: Some(0.05.into()),
        ..FitJob::default()
    };
    job.run(&Silent).unwrap();
    let truth = pebble().join("truth.ply");
    let page_output = output(page.clone());
    let compare = |model: &Path| {
        let job = CompareJob {
            model: model.to_path_buf(),
            reference: truth.clone(),
            report: Some(page_output.clone()),
            ..CompareJob::default()
        };
        job.run(&Silent).unwrap()
    };
    let report = compare(&mesh);
    let (text, scene) = read(&page);
    needs_no_network(&text);
    let deviations = floats(&field(&scene["surfaces"][0], "deviation")["values"]);
    let known: Vec<f64> = deviations.iter().copied().filter(|d| d.is_finite()).map(f64::from).collect();
    let forward = report.forward.unwrap();
    assert_eq!(known.len(), forward.n);
    let rms = (known.iter().map(|d| d * d).sum::<f64>() / known.len() as f64).sqrt();
    assert!((rms / forward.rms - 1.0).abs() < 1e-5, "{rms} {}", forward.rms);
    // Of a model, too, and the verdict is that of the figures.
    let report = compare(&model);
    assert!(report.coverage95.unwrap() > 0.93);
    assert!(read(&page).0.contains("σ is consistent"));
    // Points to measure stand on the model.
    let job = NextJob {
        model: model.clone(),
        options: NextOptions { count: 3, ..NextOptions::default() },
        report: Some(page_output),
        ..NextJob::default()
    };
    let next = job.run(&Silent).unwrap();
    let (_, scene) = read(&page);
    for (mark, point) in scene["marks"].as_array().unwrap().iter().zip(&next.next.points) {
        for d in 0..3 {
            let position = mark["at"][d].as_f64().unwrap() + scene["centre"][d].as_f64().unwrap();
            assert!((position - point.position[d]).abs() < 1e-9);
        }
    }
    assert_eq!(scene["marks"].as_array().unwrap().len(), 3);
}

#[test]
fn a_report_is_written_to_a_separate_file() {
    let folder = tempfile::tempdir().unwrap();
    let error_of = |page: PathBuf, outputs: Vec<PathBuf>| {
        let job = FitJob {
            inputs: vec![pebble().join("job.toml")],
            outputs,
            report: Some(output(page)),
            ..FitJob::default()
        };
        job.run(&Silent).unwrap_err().to_string()
    };
    let wrong = error_of(folder.path().join("page.pdf"), Vec::new());
    assert!(wrong.contains("page.pdf") && wrong.contains(".html"), "{wrong}");
    let missing = error_of(folder.path().join("none/page.html"), Vec::new());
    assert!(missing.contains("page.html"), "{missing}");
}
