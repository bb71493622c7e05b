//! `planish contour`: identifies a contour from range readings.

mod args;
mod constraints_text;
mod text;
mod values;

use crate::summary::{self, Summary};
pub use args::ContourArgs;
use args::{ContourFilter, ContourMotion};
use planish::Finding;
use planish::contour::{
    CarmenOptions, ConstrainJob, ContourFitOptions, ContourJob, ContourReport, Form, Method, PlanarMotion,
    SigmaDefaults,
};
use planish::finding::with_warnings;
use planish::progress::Progress;
use planish::{Error, Job, Result, Unit};
use serde::Serialize;
pub use values::{KindChoice, kind};

/// JSON keys of `contour`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: ContourReport,
    #[serde(flatten, serialize_with = "with_warnings")]
    findings: Vec<Finding>,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ContourArgs) -> u8 {
    summary::run("contour", &args.common, |progress| work(args, progress))
}

fn work(args: &ContourArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let report = job(args)?.run(progress)?;
    let outputs: Vec<_> = args.output.iter().chain(&args.graphs).chain(&args.page.report).cloned().collect();
    Ok(Summary {
        text: text::text(&report, &outputs),
        unit: report.unit,
        inputs: vec![args.readings.clone()],
        outputs,
        findings: report.findings.clone(),
        body: Body { findings: report.findings.clone(), termination: "converged", report },
    })
}

/// The job of these arguments.
fn job(args: &ContourArgs) -> Result<ContourJob> {
    let mut kinds = Vec::new();
    let mut shapes = Vec::new();
    for choice in &args.kind {
        match choice {
            // These are switches of the job, set below.
            KindChoice::Auto | KindChoice::Chain | KindChoice::Walls => {}
            KindChoice::Plane(kind) => kinds.push(kind.clone()),
            KindChoice::Space(shape) => shapes.push(*shape),
        }
    }
    // `auto` includes all kinds, so other kinds are redundant.
    let all = args.kind.contains(&KindChoice::Auto);
    if !shapes.is_empty() && shapes.len() < args.kind.len() {
        return Err(Error::input(
            "expected kinds of one sort for --kind, found shapes in space and contours in the plane",
        ));
    }
    let walls = args.kind.contains(&KindChoice::Walls);
    if walls && args.kind.len() > 1 {
        return Err(Error::input(
            "expected `walls` as the only --kind: the search for walls has no other kinds to compare",
        ));
    }
    Ok(ContourJob {
        input: args.readings.clone(),
        kinds: if all { Vec::new() } else { kinds },
        chains: !all && args.kind.contains(&KindChoice::Chain),
        walls,
        shapes,
        fit: ContourFitOptions {
            method: match args.filter {
                ContourFilter::Auto => Method::Combined,
                ContourFilter::Batch => Method::Batch,
                ContourFilter::Ekf => Method::Extended,
                ContourFilter::Iekf => Method::Iterated,
                ContourFilter::Nuiekf => Method::NoiseUpdated,
            },
            form: if args.product { Form::Product } else { Form::ActiveFacet },
            motion: match args.motion {
                ContourMotion::None => PlanarMotion::Still,
                ContourMotion::Linear => PlanarMotion::Linear,
                ContourMotion::Rigid => PlanarMotion::Rigid,
            },
            // On the command line 0 means none, since an option with a default cannot be absent.
            gate: (args.gate > 0.0).then_some(args.gate),
            corner_margin: (args.corner_margin > 0.0).then_some(args.corner_margin),
            ..ContourFitOptions::default()
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
            // Snapping and graphs need the relations, so they imply the search.
            propose: args.constrain || args.snap.is_some() || !args.graphs.is_empty(),
            level: Some(args.level),
            snap: args.snap,
            given: args.given.clone(),
            graphs: args.graphs.clone(),
        },
        pixel: args.pixel_size,
        outputs: args.output.clone(),
        // A table of readings states no unit, so the default of the option applies here.
        unit: Some(args.common.unit.map_or(Unit::Millimetre, Unit::from)),
        report: args.page.output(&args.common),
    })
}
