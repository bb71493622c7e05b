//! `planish fit`.

use crate::args::{Completion, FitArgs};
use crate::numbers::{count, counted, percent, significant};
use crate::report::{self, Align, Lines, Summary, sensor_cells};
use clap::ValueEnum;
use planish::Job;
use planish::animation::AnimationReport;
use planish::complete::{GapReport, SymmetryChoice, SymmetryReport};
use planish::fit::{
    BendingReport, Filter, FitOptions, FitReport, FitTermination, GroundWidth, ObjectMotion, RefineBy,
};
use planish::fit_files::{FitJob, FitJobReport};
use planish::output::{OutputFormat, WrittenFile};
use planish::progress::Progress;
use planish::{Result, SymmetryKind, Unit};
use serde::Serialize;
use std::path::PathBuf;

/// The keys of `fit` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    fit: FitReport,
    /// Readings of all sessions that the model holds.
    observations_of_all_sessions: usize,
    /// Seconds without reading and writing.
    fit_seconds: f64,
    written: Vec<WrittenFile>,
    #[serde(skip_serializing_if = "Option::is_none")]
    animation: Option<AnimationReport>,
}

/// Runs the command; returns the exit code.
pub fn run(args: &FitArgs) -> u8 {
    report::run("fit", &args.common, |progress| work(args, progress))
}

fn work(args: &FitArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let job = FitJob {
        inputs: args.scans.clone(),
        update: args.update.clone(),
        outputs: args.output.clone(),
        unit: args.common.unit.map(Unit::from),
        options: FitOptions {
            shape: args.shape.map(Into::into),
            known_parameters: args.known_uv,
            align: args.align,
            ground: args.ground.map(|width| width.map_or(GroundWidth::Usual, GroundWidth::Widest)),
            filter: args.filter.map(Filter::from),
            max_depth: args.max_depth,
            refine_by: args.refine_by.into(),
            max_coefficients: args.max_coefficients,
            symmetry: args.symmetry,
            motion: args.motion.map(ObjectMotion::from),
            complete_smooth: args.complete == Some(Completion::Smooth),
            gate: args.gate,
            held_out_share: args.held_out,
            seed: args.common.seed,
            ..FitOptions::default()
        },
        tolerance: args.tolerance,
        mesh_tolerance: args.mesh_tolerance,
        cell_size: args.cell_size,
        states: args.states.clone(),
        animation: args.animate.clone(),
        report: args.page.output(&args.common),
        arguments: deciding_arguments(args),
    };
    let done = job.run(progress)?;
    Ok(Summary {
        text: text(args, &done),
        unit: Some(done.unit),
        inputs: read(args, &done),
        outputs: (done.written.iter().map(|w| w.file.clone()))
            .chain(done.animation.iter().map(|a| a.file.clone()))
            .chain(args.page.report.clone())
            .collect(),
        warnings: done.fit.warnings.clone(),
        body: Body {
            fit: done.fit,
            observations_of_all_sessions: done.observations_of_all_sessions,
            fit_seconds: done.fit_seconds,
            written: done.written,
            animation: done.animation,
        },
    })
}

/// Every file that was read: scans and lists, then the model that was updated.
fn read(args: &FitArgs, done: &FitJobReport) -> Vec<PathBuf> {
    let scans = done.inputs.iter().map(|input| input.path.clone());
    scans.chain(args.update.clone()).collect()
}

/// The arguments on which the answer depends, in one order; outputs, threads and printing are not among them.
fn deciding_arguments(args: &FitArgs) -> Vec<String> {
    let mut all = vec!["fit".to_owned()];
    all.extend(args.scans.iter().map(|path| path.display().to_string()));
    if args.align {
        all.push("--align".to_owned());
    }
    let value_name = |value: Option<clap::builder::PossibleValue>| value.map(|v| v.get_name().to_owned());
    let mut option = |name: &str, value: Option<String>| {
        if let Some(value) = value {
            all.extend([name.to_owned(), value]);
        }
    };
    let defaults = FitOptions::default();
    let differs = |value: f64, usual: f64| (value != usual).then(|| value.to_string());
    option("--update", args.update.as_ref().map(|path| path.display().to_string()));
    option("--shape", args.shape.map(|s| planish::Shape::from(s).name().to_owned()));
    option("--known-uv", args.known_uv.map(|[u, v]| format!("{u}x{v}")));
    let ground = |width: Option<f64>| width.map_or(String::new(), |w| w.to_string());
    option("--ground", args.ground.map(ground));
    option("--motion", args.motion.and_then(|m| value_name(m.to_possible_value())));
    option("--complete", args.complete.map(|_| "smooth".to_owned()));
    option("--symmetry", args.symmetry.as_ref().map(named));
    option("--tolerance", args.tolerance.map(|t| format!("{}{}", t.value, t.unit.map_or("", Unit::name))));
    option(
        "--max-coefficients",
        (args.max_coefficients != defaults.max_coefficients).then(|| args.max_coefficients.to_string()),
    );
    option("--filter", args.filter.and_then(|f| value_name(f.to_possible_value())));
    option("--max-depth", args.max_depth.map(|d| d.to_string()));
    option(
        "--refine-by",
        value_name(args.refine_by.to_possible_value())
            .filter(|_| RefineBy::from(args.refine_by) != defaults.refine_by),
    );
    option("--gate", differs(args.gate, defaults.gate));
    option("--held-out", differs(args.held_out, defaults.held_out_share));
    option("--unit", args.common.unit.map(|u| Unit::from(u).name().to_owned()));
    option("--seed", (args.common.seed != defaults.seed).then(|| args.common.seed.to_string()));
    all
}

fn text(args: &FitArgs, done: &FitJobReport) -> String {
    let FitJobReport { fit, unit, .. } = done;
    let length = |value: f64| format!("{} {unit}", significant(value, 3));
    let mut lines = Lines::default();
    let verb = match args.update {
        None => "Fitted",
        Some(_) => "Updated",
    };
    lines.line(format!(
        "{verb} a {} of {} ({}, {}) with {}.",
        fit.shape,
        counted(fit.coefficients, "control vertex"),
        counted(fit.levels, "level"),
        counted(fit.cells, "cell"),
        counted(fit.observations, "reading"),
    ));
    lines.gap();
    lines.facts([
        (
            "readings of all sessions",
            args.update.as_ref().map_or(String::new(), |_| count(done.observations_of_all_sessions)),
        ),
        (
            "residuals",
            format!(
                "rms {}; over their σ {} (reduced χ² {})",
                length(fit.rms),
                significant(fit.rms_normalised, 3),
                significant(fit.reduced_chi_square, 3)
            ),
        ),
        (
            "held out",
            match fit.held_out.n {
                0 => "none".to_owned(),
                n => format!(
                    "{}; rms over their σ {} (1 where the stated σ is true)",
                    counted(n, "reading"),
                    significant(fit.held_out.rms_normalised, 3)
                ),
            },
        ),
        (
            "σ of the surface",
            format!(
                "median {}, 95 % below {}, largest {}",
                length(fit.sigma.median),
                length(fit.sigma.p95),
                length(fit.sigma.max)
            ),
        ),
        ("measured", format!("{} of the area", percent(fit.observed_area_fraction))),
        ("divided", divided(fit)),
        ("ended", ending(fit).to_owned()),
    ]);
    if let Some(left) = &fit.unresolved_shape {
        lines.line(format!(
            "On {} of the area cells are too large to follow the shape: {} rms, which σ takes in",
            percent(left.area_fraction),
            length(left.rms)
        ));
    }
    propagation(&mut lines, fit, *unit);
    set_aside(&mut lines, fit);
    sensors(&mut lines, fit, *unit);
    lines.poses(&fit.poses, *unit);
    lines.gap();
    if done.written.is_empty() && done.animation.is_none() && args.page.report.is_none() {
        lines.line(
            "Nothing was written: add -o part.step, -o part.ply or -o part.planish to keep the result.",
        );
    }
    for file in &done.written {
        lines.line(format!("Wrote {}: {}", file.file.display(), contents(file, *unit)));
    }
    if let Some(AnimationReport { file, readings, .. }) = &done.animation {
        let [first, last] = [readings.first(), readings.last()].map(|n| count(n.copied().unwrap_or(0)));
        lines.line(format!(
            "Wrote {}: {} of the model forming, from {first} to {last} readings",
            file.display(),
            counted(readings.len(), "frame")
        ));
    }
    if let Some(written) = args.page.written() {
        lines.line(written);
    }
    lines.into_text()
}

/// What was divided, level by level, and why.
fn divided(fit: &FitReport) -> String {
    let what = match fit.filter {
        Filter::Global => "cell",
        Filter::Patch => "patch",
    };
    let levels: Vec<String> = (fit.refined.iter())
        .map(|level| {
            let causes: Vec<String> = level.causes.iter().map(|(cause, n)| format!("{n} {cause}")).collect();
            let number = counted(level.divided, what);
            format!("{number} of level {} ({})", level.level, causes.join(", "))
        })
        .collect();
    if levels.is_empty() { "nothing".to_owned() } else { levels.join("; ") }
}

fn ending(fit: &FitReport) -> &'static str {
    match fit.termination {
        FitTermination::Converged if fit.rejected_readings() * 20 > fit.observations => {
            "converged, but see what was set aside"
        }
        FitTermination::Converged => "converged: only noise is left",
        FitTermination::ReachedTolerance => "reached the tolerance",
        FitTermination::Limit => "at the limit of coefficients or iterations",
    }
}

/// A symmetry as the command line names it.
fn named(choice: &SymmetryChoice) -> String {
    let towards = |d: &Option<[f64; 3]>| d.map_or(String::new(), |[x, y, z]| format!(":{x},{y},{z}"));
    match choice {
        SymmetryChoice::Auto => "auto".to_owned(),
        SymmetryChoice::Of(SymmetryKind::Mirror { towards: d }) => format!("mirror{}", towards(d)),
        SymmetryChoice::Of(SymmetryKind::Rotation { order, towards: d }) => {
            let order = order.map_or("full".to_owned(), |n| n.to_string());
            format!("rotation:{order}{}", towards(d))
        }
    }
}

/// What was completed, and by what.
fn propagation(lines: &mut Lines, fit: &FitReport, unit: Unit) {
    let Some(found) = &fit.propagation else { return };
    lines.gap();
    if let Some(symmetry) = &found.symmetry {
        lines.line(symmetry_line(symmetry, unit));
    }
    if let Some(motion) = &found.motion {
        let pair =
            |[value, sigma]: [f64; 2]| format!("{} ± {}", significant(value, 5), significant(sigma, 2));
        lines.line(format!(
            "Motion: turned by {}° a second, its middle moved by {} {unit} a second, over {}.",
            pair(motion.rate_deg_per_s),
            pair(motion.speed),
            counted(motion.poses.len(), "scan")
        ));
        if found.symmetry.is_none() && found.gaps.is_empty() {
            return;
        }
    }
    if let Some(bending) = &found.bending {
        return bent(lines, bending, unit);
    }
    for gap in found.gaps.iter().take(GAPS_SHOWN) {
        lines.line(gap_line(gap, unit));
    }
    if found.gaps.len() > GAPS_SHOWN {
        lines.line(format!("Gaps: {} more, see --json.", found.gaps.len() - GAPS_SHOWN));
    }
    lines.line(format!(
        "Completed: {} of the area, by {} that were concluded from others.",
        percent(found.inferred_area_fraction),
        counted(found.pseudo_readings, "reading")
    ));
}

/// State by state, what is left over and how well lengths were kept.
fn bent(lines: &mut Lines, bending: &BendingReport, unit: Unit) {
    let rows: Vec<Vec<String>> = (bending.states.iter().enumerate())
        .map(|(k, state)| {
            let [e, f, g] = state.largest_change.map(|change| significant(100.0 * change, 2));
            vec![
                state.time_s.map_or((k + 1).to_string(), |time| format!("{time} s")),
                count(state.observations),
                significant(state.rms, 3),
                significant(state.sigma, 3),
                if k == 0 { "reference".to_owned() } else { format!("{e}, {f}, {g}") },
                percent(state.carried_area_fraction),
                if state.isometric { "yes" } else { "no" }.to_owned(),
            ]
        })
        .collect();
    lines.table(
        &[
            ("state", Align::Left),
            ("readings", Align::Right),
            (&format!("rms / {unit}"), Align::Right),
            ("σ", Align::Right),
            ("most change of E, F, G / %", Align::Right),
            ("carried", Align::Right),
            ("isometric", Align::Left),
        ],
        &rows,
    );
}

/// Gaps that are told one by one.
const GAPS_SHOWN: usize = 6;

fn gap_line(gap: &GapReport, unit: Unit) -> String {
    let area = format!("Gap of {} {unit}²", significant(gap.area, 3));
    let shape = match (gap.kind.as_str(), gap.radius) {
        ("none", _) => {
            return format!("{area}: what surrounds it is no plane, sphere or cylinder; left to the prior.");
        }
        (kind, Some([r, sigma])) => {
            format!("a {kind} of radius {} ± {} {unit}", significant(r, 4), significant(sigma, 2))
        }
        (kind, None) => format!("a {kind}"),
    };
    format!(
        "{area}: {shape}, by {} around it (reduced χ² {}, probability {}).",
        counted(gap.readings, "reading"),
        significant(gap.reduced_chi_square.unwrap_or(f64::NAN), 3),
        significant(gap.probability.unwrap_or(f64::NAN), 2)
    )
}

fn symmetry_line(found: &SymmetryReport, unit: Unit) -> String {
    if !found.is_found() {
        return "Symmetry: none that the readings bear out.".to_owned();
    }
    let what = match (found.kind.as_str(), found.order) {
        ("mirror", _) => "a mirror plane".to_owned(),
        (_, Some(order)) => format!("a rotation of order {order}"),
        (_, None) => "a surface of revolution".to_owned(),
    };
    let proposed = if found.proposed { ", proposed" } else { "" };
    let largest = |values: &[f64]| values.iter().fold(0.0, |a: f64, b| a.max(*b));
    format!(
        "Symmetry: {what}{proposed}; {} of {} pieces of the cloud agree; its place is known to {} {unit}, its direction to {}°.",
        count(found.agreeing),
        count(found.compared),
        significant(largest(&found.sigma_point), 2),
        significant(largest(&found.sigma_direction_deg), 2)
    )
}

fn set_aside(lines: &mut Lines, fit: &FitReport) {
    let total: usize = fit.rejected.values().sum();
    lines.gap();
    if total == 0 {
        lines.line("Set aside: no reading.");
        return;
    }
    let all = (total + fit.observations + fit.held_out.n) as f64;
    let mut causes: Vec<(&String, usize)> = fit.rejected.iter().map(|(cause, n)| (cause, *n)).collect();
    causes.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    let rows: Vec<Vec<String>> = causes
        .into_iter()
        .map(|(cause, n)| vec![cause.replace('_', " "), count(n), percent(n as f64 / all)])
        .collect();
    lines.table(&[("set aside", Align::Left), ("readings", Align::Right), ("share", Align::Right)], &rows);
}

fn sensors(lines: &mut Lines, fit: &FitReport, unit: Unit) {
    lines.gap();
    lines.line(format!("Sensors, along the surface's normals, in {unit}:"));
    let rows: Vec<Vec<String>> = fit
        .sensors
        .iter()
        .map(|sensor| {
            let mut cells = sensor_cells(sensor).to_vec();
            cells.push(significant(sensor.rms, 3));
            cells
        })
        .collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            ("readings", Align::Right),
            ("σ stated", Align::Right),
            ("estimated", Align::Right),
            ("used", Align::Left),
            ("rms residual", Align::Right),
        ],
        &rows,
    );
}

/// Poses are of interest where they are not all exact.
fn contents(file: &WrittenFile, unit: Unit) -> String {
    match file.format {
        OutputFormat::Step => {
            format!("the exact surface in {}", counted(file.faces.unwrap_or(0), "B-spline face"))
        }
        OutputFormat::Ply | OutputFormat::Obj | OutputFormat::Stl | OutputFormat::Glb => {
            let with = match file.format {
                OutputFormat::Ply | OutputFormat::Glb => ", with σ",
                _ => "",
            };
            format!(
                "{} within {} {unit} of the surface{with}",
                counted(file.triangles.unwrap_or(0), "triangle"),
                significant(file.tolerance.unwrap_or(f64::NAN), 2)
            )
        }
        OutputFormat::Tiff => {
            let [columns, rows, known] = file.cells.unwrap_or_default();
            format!(
                "heights and their σ in {columns} × {rows} cells of {} {unit}, {} known",
                significant(file.cell_size.unwrap_or(f64::NAN), 3),
                percent(known as f64 / (columns * rows).max(1) as f64)
            )
        }
        OutputFormat::Planish => "the model with its covariance".to_owned(),
    }
}
