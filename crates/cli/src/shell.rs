//! `planish shell`.

use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use crate::shell_args::{ShellArgs, ShellCommand, ShellFitArgs};
use planish::Result;
use planish::progress::Progress;
use planish::shell::fit::{ReadingsReport, ShellFitJob, ShellFitReport, shell_fit_files};

/// Runs the command; returns the exit code.
pub fn run(args: &ShellArgs) -> u8 {
    match &args.command {
        ShellCommand::Fit(args) => report::run("shell fit", &args.common, |progress| fit(args, progress)),
    }
}

fn fit(args: &ShellFitArgs, progress: &dyn Progress) -> Result<Summary<ShellFitReport>> {
    let job = ShellFitJob {
        mesh: args.mesh.clone(),
        points: args.points.clone(),
        silhouettes: args.silhouettes.clone(),
        sequence: args.sequence.clone(),
        deformation: args.deformation.into(),
        controls: args.controls as usize,
        controls_file: args.controls_file.clone(),
        family: args.family.clone(),
        metaball: args.metaball.into(),
        outline_step_px: args.outline_step,
        believe_sigma: args.believe_sigma,
        outputs: args.output.clone(),
        unit: args.common.unit.map(Into::into),
    };
    let report = shell_fit_files(&job, progress)?;
    Ok(Summary {
        text: fit_text(&report),
        unit: Some(report.unit),
        inputs: report.inputs.clone(),
        outputs: report.written.clone(),
        warnings: report.warnings.clone(),
        body: report,
    })
}

fn fit_text(report: &ShellFitReport) -> String {
    let mut lines = Lines::default();
    let unit = report.unit;
    lines.line(format!(
        "Fitted a shell by {} controls in {} iterations.",
        count(report.controls),
        report.iterations
    ));
    lines.gap();
    let of = |name: &str, r: &Option<ReadingsReport>, unit: &str| {
        r.as_ref().map(|r| {
            vec![
                name.to_owned(),
                count(r.count),
                count(r.outliers),
                format!("{} {unit}", significant(r.rms, 3)),
                significant(r.sigma_factor, 3),
            ]
        })
    };
    let rows: Vec<Vec<String>> = [
        of("points", &report.points, &unit.to_string()),
        of("outlines", &report.outlines, "px"),
        of("tracks", &report.tracks, "σ"),
    ]
    .into_iter()
    .flatten()
    .collect();
    lines.table(
        &[
            ("", Align::Left),
            ("readings", Align::Right),
            ("gross errors", Align::Right),
            ("rms", Align::Right),
            ("σ found/stated", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    if !report.iou.is_empty() {
        let rows: Vec<Vec<String>> = (report.iou.iter())
            .map(|(view, iou)| {
                vec![
                    view.clone(),
                    significant(report.iou_before[view], 3),
                    significant(*iou, 3),
                    if report.held_out.contains(view) {
                        "held out".to_owned()
                    } else {
                        String::new()
                    },
                ]
            })
            .collect();
        lines.table(
            &[
                ("view", Align::Left),
                ("IoU before", Align::Right),
                ("after", Align::Right),
                ("", Align::Left),
            ],
            &rows,
        );
        lines.gap();
    }
    if !report.frames.is_empty() {
        let shown = |value: Option<f64>| value.map_or_else(String::new, |value| significant(value, 3));
        let rows: Vec<Vec<String>> = (report.frames.iter())
            .map(|frame| {
                vec![
                    frame.frame.clone(),
                    shown(frame.rms_points),
                    shown(frame.rms_silhouettes_px),
                    shown(frame.iou),
                    shown(frame.surprise),
                    significant(frame.sigma, 3),
                ]
            })
            .collect();
        lines.table(
            &[
                ("frame", Align::Left),
                ("rms points", Align::Right),
                ("rms outlines px", Align::Right),
                ("IoU", Align::Right),
                ("surprise/σ", Align::Right),
                ("σ", Align::Right),
            ],
            &rows,
        );
        lines.gap();
    }
    if !report.poses.is_empty() {
        let largest = |values: [f64; 3]| significant(values.into_iter().fold(0.0, f64::max), 2);
        let rows: Vec<Vec<String>> = (report.poses.iter())
            .map(|pose| {
                vec![
                    pose.view.clone(),
                    format!("{}°", significant(pose.turned_deg, 3)),
                    format!("{}°", largest(pose.sigma_rotation_deg)),
                    significant(pose.moved, 3),
                    largest(pose.sigma_translation),
                ]
            })
            .collect();
        lines.table(
            &[
                ("camera", Align::Left),
                ("turned", Align::Right),
                ("σ", Align::Right),
                ("moved", Align::Right),
                ("σ", Align::Right),
            ],
            &rows,
        );
        lines.gap();
    }
    lines.facts([
        (
            "σ of the vertices",
            format!(
                "median {} {unit}, 95 % below {}, largest {}",
                significant(report.sigma.median, 3),
                significant(report.sigma.p95, 3),
                significant(report.sigma.max, 3)
            ),
        ),
        (
            "measured",
            format!("{:.1} % of the vertices", 100.0 * report.observed_fraction),
        ),
    ]);
    lines.into_text()
}
