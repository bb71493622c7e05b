//! `planish merge`.

use crate::merge_args::MergeArgs;
use crate::numbers::{count, counted, significant};
use crate::report::{self, Align, Lines, Summary};
use clap::ValueEnum;
use planish::Job;
use planish::merge::{FillReport, MergeJob, MergeJobReport, MergeOptions, MergeReport, SplineReport};
use planish::next::Length;
use planish::progress::Progress;
use planish::{Result, Unit};
use serde::Serialize;

/// So many regions are shown.
const SHOWN: usize = 10;

/// The keys of `merge` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: MergeReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    spline: Option<SplineReport>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &MergeArgs) -> u8 {
    report::run("merge", &args.common, |progress| work(args, progress))
}

fn work(args: &MergeArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let options = MergeOptions {
        method: args.method.map(Into::into),
        unit: args.common.unit.map(Unit::from),
        mesh_tolerance: args.mesh_tolerance,
        epsilon: args.epsilon,
        theta_deg: args.theta,
        fill: args.fill,
        curvature: args.curvature,
        align: args.align,
    };
    let job = MergeJob {
        patches: args.patches.clone(),
        bound: args.complete.clone(),
        options,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
        seed: args.common.seed,
        arguments: deciding_arguments(args),
    };
    let MergeJobReport { merge: report, spline } = job.run(progress)?;
    let warnings = report.warnings.clone();
    Ok(Summary {
        text: text(args, &report, spline.as_ref()),
        unit: Some(report.unit),
        inputs: report.inputs.clone(),
        outputs: args.output.iter().chain(&args.page.report).cloned().collect(),
        warnings,
        body: Body { report, spline, termination: "converged" },
    })
}

/// The arguments that decide the answer, as on the command line.
fn deciding_arguments(args: &MergeArgs) -> Vec<String> {
    let mut all = vec!["merge".to_owned()];
    all.extend(args.patches.iter().map(|path| path.display().to_string()));
    let method = args.method.and_then(|m| m.to_possible_value());
    let stated = |length: Length| format!("{}{}", length.value, length.unit.map_or("", Unit::name));
    let given = [
        ("--method", method.map(|v| v.get_name().to_owned())),
        ("--epsilon", args.epsilon.map(stated)),
        ("--theta", args.theta.map(|v| v.to_string())),
        ("--fill", (args.fill > 0).then(|| args.fill.to_string())),
        ("--mesh-tolerance", args.mesh_tolerance.map(stated)),
        ("--complete", args.complete.as_ref().map(|p| p.display().to_string())),
        ("--unit", args.common.unit.map(|u| Unit::from(u).name().to_owned())),
        ("--seed", (args.common.seed > 0).then(|| args.common.seed.to_string())),
    ];
    for (name, value) in given {
        if let Some(value) = value {
            all.extend([name.to_owned(), value]);
        }
    }
    if args.align {
        all.push("--align".to_owned());
    }
    if args.curvature {
        all.push("--curvature".to_owned());
    }
    all
}

/// What fills holes, and what was left open.
fn filled_in_words(filled: &FillReport) -> String {
    let mut words = format!(
        "{} filled with {} vertices (`observed` 2, σ a guess)",
        counted(filled.holes, "hole"),
        count(filled.vertices)
    );
    if filled.left_open > 0 {
        words +=
            &format!("; {} left open, with more edges than --fill allows", counted(filled.left_open, "hole"));
    }
    if filled.outer_rims > 0 {
        words += &format!("; {} left open, as that of a sheet is", counted(filled.outer_rims, "outer rim"));
    }
    words + "."
}

fn text(args: &MergeArgs, report: &MergeReport, spline: Option<&SplineReport>) -> String {
    let mut lines = Lines::default();
    let unit = report.unit;
    lines.line(format!(
        "Merged {} patches into {} triangles and {} vertices{}.",
        report.patches.len(),
        count(report.triangles),
        count(report.vertices),
        if report.watertight { ", watertight" } else { "" }
    ));
    lines.gap();
    let sigma = &report.sigma;
    let most = report.valence.iter().skip(7).sum::<usize>();
    lines.facts([
        (
            "σ",
            format!(
                "median {} {unit}, 95 % below {} {unit}, largest {} {unit}{}",
                significant(sigma.median, 3),
                significant(sigma.p95, 3),
                significant(sigma.max, 3),
                if report.sigma_estimated {
                    " (told from how patches differ)"
                } else {
                    ""
                }
            ),
        ),
        (
            "topology",
            format!(
                "{} {}, {} open edges, {} edges of three triangles and more",
                report.parts,
                if report.parts == 1 { "part" } else { "parts" },
                count(report.boundary_edges),
                report.nonmanifold_edges
            ),
        ),
        (
            "seams",
            format!(
                "{} triangles, {} holes closed; {} of {} vertices have more than six edges",
                count(report.stitched_triangles),
                count(report.holes_closed),
                count(most),
                count(report.valence.iter().sum())
            ),
        ),
        (
            "triangles",
            report.quality.as_ref().map_or_else(String::new, |q| {
                format!(
                    "smallest angle {:.1}° in the median, 99 % above {:.1}°; longest edge over height {:.2} in the median, 99 % below {}",
                    q.smallest_angle_median_deg,
                    q.smallest_angle_p1_deg,
                    q.aspect_median,
                    significant(q.aspect_p99, 3)
                )
            }),
        ),
    ]);
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .patches
        .iter()
        .enumerate()
        .map(|(k, p)| {
            vec![
                k.to_string(),
                p.name.clone(),
                count(p.triangles),
                count(p.vertices_kept),
                significant(p.sigma, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("patch", Align::Right),
            ("from", Align::Left),
            ("triangles", Align::Right),
            ("vertices kept", Align::Right),
            ("σ", Align::Right),
        ],
        &rows,
    );
    if let Some(completed) = &report.completed {
        lines.gap();
        lines.line(format!(
            "{} vertices are of {}, where no patch is (`observed` 2); {} triangles reached out of it and were carved away.",
            count(completed.vertices),
            completed.name,
            count(completed.carved)
        ));
    }
    if let Some(filled) = &report.filled {
        lines.gap();
        lines.line(filled_in_words(filled));
    }
    if report.fragments_left_out > 0 {
        lines.gap();
        lines.line(format!(
            "{} of a few triangles that were left over {} left out.",
            counted(report.fragments_left_out, "part"),
            if report.fragments_left_out == 1 { "was" } else { "were" }
        ));
    }
    lines.poses(&report.poses, unit);
    lines.gap();
    let rows: Vec<Vec<String>> = report
        .regions
        .iter()
        .take(SHOWN)
        .map(|r| {
            vec![format!("{} and {}", r.patches[0], r.patches[1]), count(r.points), significant(r.rms, 3)]
        })
        .collect();
    lines.table(
        &[("common regions of", Align::Left), ("points", Align::Right), ("rms between them", Align::Right)],
        &rows,
    );
    if report.regions.len() > SHOWN {
        lines.line(format!("and {} smaller ones (--json names all)", count(report.regions.len() - SHOWN)));
    }
    lines.gap();
    if let Some(spline) = spline {
        lines.line(format!(
            "As a spline: a {} of {} control vertices ({} levels), {} {unit} rms from the vertices of the mesh; σ median {} {unit}",
            spline.shape,
            count(spline.coefficients),
            spline.levels,
            significant(spline.rms, 3),
            significant(spline.sigma.median, 3)
        ));
        lines.gap();
    }
    if args.output.is_empty() {
        lines.line("Nothing was written: give -o FILE.");
    }
    for path in &args.output {
        lines.line(format!("Wrote {}", path.display()));
    }
    lines.into_text()
}
