//! `planish simulate`.

use crate::args::{ScansArgs, Scene, SimulateArgs, Simulated};
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::progress::Progress;
use planish::simulate::{ScanSceneOptions, ScanSceneSummary, TruthSummary, write_scans_scene};
use planish::{Result, Unit};
use serde::Serialize;

/// The keys of `simulate` beside the common ones.
#[derive(Serialize)]
struct Body {
    rows: usize,
    columns: Vec<String>,
    truth: TruthSummary,
    warnings: [String; 0],
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SimulateArgs) -> u8 {
    let Simulated::Scene(scene) = &args.what;
    let Scene::Scans(args) = &scene.scene;
    report::run("simulate scene scans", &args.common, |progress| scans(args, progress))
}

fn scans(args: &ScansArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = ScanSceneOptions {
        shape: args.shape.into(),
        seed: args.common.seed,
        readings: args.readings,
        sigma: args.sigma,
        views: args.views,
        old_scanner: !args.no_old_scanner,
        misstated: args.misstated,
        probe_points: args.probe_points,
        outlier_share: args.outliers,
        unevenness: args.unevenness,
        organised: !args.no_grids,
        unit: args.common.unit.map_or(Unit::Millimetre, Unit::from),
        truth_triangles: args.truth_triangles,
    };
    let made = write_scans_scene(&options, &args.out, progress)?;
    Ok(Summary {
        text: text(args, &made, options.unit),
        unit: Some(options.unit),
        inputs: Vec::new(),
        outputs: made.files.clone(),
        warnings: Vec::new(),
        body: Body {
            rows: made.rows,
            columns: made.columns,
            truth: made.truth,
            warnings: [],
            termination: "converged",
        },
    })
}

fn text(args: &ScansArgs, made: &ScanSceneSummary, unit: Unit) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Simulated {} readings of a {}.",
        count(made.rows),
        made.truth.shape
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = made
        .truth
        .scans
        .iter()
        .map(|scan| {
            vec![
                scan.file.clone(),
                scan.sensor.clone(),
                count(scan.readings),
                count(scan.outliers),
            ]
        })
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
    let job = args.out.join("job.toml");
    lines.line(format!(
        "Wrote {} files to {}. Next:",
        made.files.len(),
        args.out.display()
    ));
    lines.line(format!("  planish fit {} -o part.planish", job.display()));
    lines.line(format!(
        "  planish compare part.planish {}",
        args.out.join("truth.ply").display()
    ));
    lines.into_text()
}
