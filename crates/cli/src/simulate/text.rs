//! JSON keys and text output that scenes of scans share.

use crate::lines::{Align, Lines};
use crate::numbers::{count, significant};
use crate::summary::Summary;
use planish::Finding;
use planish::Unit;
use planish::finding::with_warnings;
use planish::simulate::{ScanSceneSummary, TruthSummary};
use serde::Serialize;
use std::path::Path;

/// JSON keys of a scene of scans.
#[derive(Serialize)]
pub struct ScanSceneBody {
    rows: usize,
    columns: Vec<String>,
    truth: TruthSummary,
    #[serde(flatten, serialize_with = "with_warnings")]
    // A simulation has no findings, but all JSON objects have the key.
    findings: Vec<Finding>,
    termination: &'static str,
}

/// The summary of a scene. `next_options` are options of `fit` and of `compare` that suit the scene.
pub fn summary(
    out: &Path,
    made: ScanSceneSummary,
    unit: Unit,
    next_options: [&str; 2],
) -> Summary<ScanSceneBody> {
    let what = format!("a {}", made.truth.shape);
    summary_of(&what, out, made, unit, next_options)
}

/// As [`summary`]; `what` names the object with its article.
pub fn summary_of(
    what: &str,
    out: &Path,
    made: ScanSceneSummary,
    unit: Unit,
    next_options: [&str; 2],
) -> Summary<ScanSceneBody> {
    Summary {
        text: text(what, out, &made, unit, next_options),
        unit: Some(unit),
        inputs: Vec::new(),
        outputs: made.files.clone(),
        findings: Vec::new(),
        body: ScanSceneBody {
            rows: made.rows,
            columns: made.columns,
            truth: made.truth,
            findings: Vec::new(),
            termination: "converged",
        },
    }
}

fn text(what: &str, out: &Path, made: &ScanSceneSummary, unit: Unit, [fit, compare]: [&str; 2]) -> String {
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of {what}.", count(made.rows)));
    lines.gap();
    let rows: Vec<Vec<String>> = made
        .truth
        .scans
        .iter()
        .map(|scan| vec![scan.file.clone(), scan.sensor.clone(), count(scan.readings), count(scan.outliers)])
        .collect();
    lines.table(
        &[
            ("scan", Align::Left),
            ("sensor", Align::Left),
            ("readings", Align::Right),
            ("outliers", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    let rows: Vec<Vec<String>> = made
        .truth
        .sensors
        .iter()
        .map(|s| {
            vec![
                s.name.clone(),
                significant(s.sigma_along, 3),
                significant(s.sigma_across, 3),
                // The stated σ shows which sensor misstates its σ; the fit should detect it.
                significant(s.sigma_along / s.misstatement, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            (&format!("true σ along / {unit}"), Align::Right),
            ("across", Align::Right),
            ("stated along", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    // The commands can be pasted as they are, so that the example needs no manual.
    let job = out.join("job.toml");
    lines.line(format!("Wrote {} files to {}. Next:", made.files.len(), out.display()));
    lines.line(format!("  planish fit {}{fit} -o part.planish", job.display()));
    lines.line(format!("  planish compare part.planish {}{compare}", out.join("truth.ply").display()));
    lines.into_text()
}
