//! `planish contour`, and the scene `readings`.

use crate::constrained_text::constrained_text;
use crate::contour_args::{ContourArgs, ContourFilter, ContourMotion, KindChoice, ReadingsArgs, ViewsArgs};
use crate::numbers::{count, significant};
use crate::report::{self, Align, Lines, Summary};
use planish::Job;
use planish::contour::{
    CarmenOptions, ConstrainJob, ContourJob, ContourReport, FitOptions, Form, Method, Motion, PartReport,
    Relation, SigmaDefaults,
};
use planish::progress::Progress;
use planish::simulate::{
    ReadingsOptions, ReadingsSummary, ViewsOptions, write_readings_scene, write_views_scene,
};
use planish::{Error, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

/// The keys of `contour` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: ContourReport,
    warnings: Vec<String>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ContourArgs) -> u8 {
    report::run("contour", &args.common, |progress| work(args, progress))
}

fn work(args: &ContourArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let mut kinds = Vec::new();
    let mut shapes = Vec::new();
    for choice in &args.kind {
        match choice {
            KindChoice::Auto | KindChoice::Chain => {}
            KindChoice::Of(kind) => kinds.push(kind.clone()),
            KindChoice::InSpace(shape) => shapes.push(*shape),
        }
    }
    let all = args.kind.contains(&KindChoice::Auto);
    if !shapes.is_empty() && shapes.len() < args.kind.len() {
        return Err(Error::input(
            "--kind names shapes in space and contours in the plane: readings are either of the one or of the other",
        ));
    }
    let job = ContourJob {
        input: args.readings.clone(),
        kinds: if all { Vec::new() } else { kinds },
        chains: !all && args.kind.contains(&KindChoice::Chain),
        shapes,
        fit: FitOptions {
            method: match args.filter {
                ContourFilter::Auto => Method::Combined,
                ContourFilter::Batch => Method::Batch,
                ContourFilter::Ekf => Method::Extended,
                ContourFilter::Iekf => Method::Iterated,
                ContourFilter::Nuiekf => Method::NoiseUpdated,
            },
            form: if args.product { Form::Product } else { Form::ActiveFacet },
            motion: match args.motion {
                ContourMotion::None => Motion::Still,
                ContourMotion::Linear => Motion::Linear,
                ContourMotion::Rigid => Motion::Rigid,
            },
            gate: (args.gate > 0.0).then_some(args.gate),
            corner_margin: (args.corner_margin > 0.0).then_some(args.corner_margin),
            ..FitOptions::default()
        },
        sigma: SigmaDefaults {
            position: args.sigma_position,
            heading_deg: args.sigma_heading_deg,
            range: args.sigma_range,
            point: args.sigma_point,
        },
        carmen: CarmenOptions {
            first: args.scan,
            count: args.scans,
            range: args.range_gate,
            region: args.region,
        },
        gap: args.gap,
        constrain: ConstrainJob {
            propose: args.constrain || args.snap.is_some() || !args.graphs.is_empty(),
            level: Some(args.level),
            snap: args.snap,
            given: args.given.clone(),
            graphs: args.graphs.clone(),
        },
        pixel: args.pixel_size,
        outputs: args.output.clone(),
        unit: Some(args.common.unit.map_or(Unit::Millimetre, Unit::from)),
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    let outputs: Vec<_> = args.output.iter().chain(&args.graphs).chain(&args.page.report).cloned().collect();
    Ok(Summary {
        text: text(&report, &outputs),
        unit: report.unit,
        inputs: vec![args.readings.clone()],
        outputs,
        warnings: report.warnings.clone(),
        body: Body { warnings: report.warnings.clone(), termination: "converged", report },
    })
}

fn text(report: &ContourReport, outputs: &[PathBuf]) -> String {
    let mut lines = Lines::default();
    for (i, part) in report.contours.iter().enumerate() {
        if i > 0 {
            lines.gap();
        }
        part_text(&mut lines, part, i, report);
    }
    if let Some(levels) = &report.levels {
        lines.gap();
        let what = match levels.relation {
            Relation::Prism => "agree: a prism",
            Relation::Revolution => "are circles about one axis: a revolution",
            Relation::None => "do not agree",
        };
        lines.line(format!(
            "The contours of {} levels {what} (χ² {} of {} degrees).",
            levels.levels.len(),
            significant(levels.chi_square, 3),
            levels.degrees
        ));
    }
    if let Some(constrained) = &report.constrained {
        lines.gap();
        lines.line("So far the readings alone. With what was given and what was found to hold:");
        lines.gap();
        constrained_text(&mut lines, constrained);
    }
    if !outputs.is_empty() {
        lines.gap();
        let names: Vec<String> = outputs.iter().map(|path| path.display().to_string()).collect();
        lines.line(format!("Wrote {}.", names.join(", ")));
    }
    lines.into_text()
}

fn part_text(lines: &mut Lines, part: &PartReport, index: usize, report: &ContourReport) {
    let level = part.level.map_or_else(String::new, |level| format!(" at level {level}"));
    let hole = part.hole_of.map_or_else(String::new, |of| format!(", a hole of contour {}", of + 1));
    let name = if report.contours.len() > 1 { format!("Contour {}: ", index + 1) } else { String::new() };
    lines.line(format!(
        "{name}{}{level}{hole}, from {} readings ({} left out beyond the gate).",
        part.kind,
        count(part.readings),
        count(part.rejected)
    ));
    if let (Some(margin), Some(other)) = (part.bic_margin, part.alternatives.first()) {
        lines.line(format!("Next best: {} (BIC {} more).", other.kind, significant(margin, 3)));
    }
    lines.gap();
    let rows: Vec<Vec<String>> = (part.parameters.iter().chain(&part.sides))
        .map(|(name, value)| vec![name.clone(), significant(value.value, 6), significant(value.sigma, 2)])
        .collect();
    lines.table(&[("parameter", Align::Left), ("value", Align::Right), ("σ", Align::Right)], &rows);
}

/// The keys of `simulate scene readings` beside the common ones.
#[derive(Serialize)]
struct SceneBody {
    rows: usize,
    columns: Vec<&'static str>,
    warnings: [String; 0],
    termination: &'static str,
}

fn scene_summary(made: ReadingsSummary, unit: Unit, lines: Lines) -> Summary<SceneBody> {
    Summary {
        text: lines.into_text(),
        unit: Some(unit),
        inputs: Vec::new(),
        outputs: made.files,
        warnings: Vec::new(),
        body: SceneBody { rows: made.rows, columns: made.columns, warnings: [], termination: "converged" },
    }
}

/// Runs `simulate scene readings`; returns the exit code.
pub fn run_scene(args: &ReadingsArgs) -> u8 {
    report::run("simulate scene readings", &args.common, |_| scene(args))
}

fn scene(args: &ReadingsArgs) -> Result<Summary<SceneBody>> {
    let KindChoice::Of(kind) = args.shape.clone() else {
        return Err(Error::input("a scene needs a shape of its own: auto is none"));
    };
    let unit = args.common.unit.map_or(Unit::Millimetre, Unit::from);
    let options = ReadingsOptions {
        kind,
        readings: args.readings,
        sweep: args.sweep,
        noise: args.noise,
        outlier_share: args.outliers,
        velocity: args.velocity.map_or([0.0; 3], |[x, y, deg]| [x, y, deg.to_radians()]),
        seed: args.common.seed,
        unit,
    };
    let made = write_readings_scene(&options, &args.out)?;
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of a {}.", count(made.rows), options.kind));
    lines.gap();
    lines.line(format!("Wrote {} files to {}. Next:", made.files.len(), args.out.display()));
    let motion = match args.velocity {
        None => "",
        Some([_, _, 0.0]) => " --motion linear",
        Some(_) => " --motion rigid",
    };
    lines.line(format!(
        "  planish contour {}{motion} -o contour.json -o contour.svg",
        args.out.join("readings.csv").display()
    ));
    Ok(scene_summary(made, unit, lines))
}

/// Runs `simulate scene views`; returns the exit code.
pub fn run_views(args: &ViewsArgs) -> u8 {
    report::run("simulate scene views", &args.common, |_| views(args))
}

fn views(args: &ViewsArgs) -> Result<Summary<SceneBody>> {
    let unit = args.common.unit.map_or(Unit::Millimetre, Unit::from);
    let options = ViewsOptions {
        readings: args.readings,
        sweep: args.sweep,
        noise: args.noise,
        seed: args.common.seed,
        unit,
    };
    let made = write_views_scene(&options, &args.out)?;
    let mut lines = Lines::default();
    lines.line(format!("Simulated {} readings of a prism in three views.", count(made.rows)));
    lines.gap();
    lines.line(format!(
        "Wrote {} files to {}. Next, for front, top and side:",
        made.files.len(),
        args.out.display()
    ));
    lines.line(format!(
        "  planish contour {} --constrain -o front.json",
        args.out.join("front/readings.csv").display()
    ));
    lines.line("  planish solid front.json top.json side.json -o prism.step -o prism.json");
    Ok(scene_summary(made, unit, lines))
}
