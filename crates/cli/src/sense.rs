//! `planish sense`: converts sensor data into points with covariance.

mod contours;
mod depth;
mod grid;
mod photometric;
mod stereo;

use crate::common::CommonArgs;
use crate::lines::{Lines, sigma_quantiles};
use crate::numbers::{count, percent, significant};
use crate::summary::{self, Summary};
use clap::{Args, Subcommand};
use planish::progress::Progress;
use planish::sense::{SenseJob, SenseKind, SenseReport};
use planish::{Job, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `planish sense`.
#[derive(Debug, Args)]
pub struct SenseArgs {
    /// The sensor.
    #[command(subcommand)]
    sensor: SenseCommand,
}

/// The sensors.
#[derive(Debug, Subcommand)]
enum SenseCommand {
    /// Stereo images, matched densely: points with covariance, or disparities with σ
    Stereo(stereo::StereoArgs),
    /// An image of crossed projected stripes: points, normals and curvatures with σ
    Grid(grid::GridArgs),
    /// Images of one view under at least three lights, or a normal map: normals with σ
    Photometric(photometric::PhotometricArgs),
    /// A depth image: points with covariance
    Depth(depth::DepthArgs),
    /// Views from a camera that moves around an object: points and patches from its occluding contours
    Contours(contours::ContoursArgs),
}

/// JSON keys of `sense`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: SenseReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SenseArgs) -> u8 {
    let (name, kind, output, common) = match &args.sensor {
        SenseCommand::Stereo(args) => ("sense stereo", stereo::kind(args), &args.output, &args.common),
        SenseCommand::Grid(args) => ("sense grid", Ok(grid::kind(args)), &args.output, &args.common),
        SenseCommand::Photometric(args) => {
            ("sense photometric", photometric::kind(args), &args.output, &args.common)
        }
        SenseCommand::Depth(args) => ("sense depth", Ok(depth::kind(args)), &args.output, &args.common),
        // Contours need many views and write patches and a hull, so they have a job and a report of their
        // own.
        SenseCommand::Contours(args) => return contours::run(args),
    };
    // Options that exclude each other are an error of the work, so that it is printed like any other.
    summary::run(name, common, |progress| work(kind?, output, common, progress))
}

fn work(
    kind: SenseKind,
    output: &[PathBuf],
    common: &CommonArgs,
    progress: &dyn Progress,
) -> Result<Summary<Body>> {
    let job = SenseJob { kind, outputs: output.to_vec(), unit: common.unit.map(Unit::from) };
    let done = job.run(progress)?;
    Ok(Summary {
        text: text(&done),
        unit: done.unit,
        inputs: done.inputs.clone(),
        outputs: done.written.iter().map(|w| w.file.clone()).collect(),
        findings: done.findings.clone(),
        body: Body { report: done, termination: "converged" },
    })
}

fn text(done: &SenseReport) -> String {
    let mut lines = Lines::default();
    // An image may be empty; the divisor is at least 1.
    let share = percent(done.observations as f64 / done.pixels.max(1) as f64);
    let found = count(done.observations);
    let pixels = count(done.pixels);
    lines.line(match done.kind {
        "photometric" => format!("Computed {found} normals from {pixels} pixels ({share})."),
        // Crossings are sparse by design, so a share of the pixels would look like a failure.
        "grid" => format!("Found {found} stripe crossings in {pixels} pixels."),
        _ => format!("Computed {found} points from {pixels} pixels ({share})."),
    });
    lines.gap();
    let unit = done.unit.map_or("", Unit::name);
    let per_unit = done.unit.map_or(String::new(), |unit| format!("1/{unit}"));
    let rejected: Vec<String> =
        // The keys are those of the JSON object, so that a cause has one name in both outputs.
        done.rejected.iter().map(|(cause, n)| format!("{} {}", count(*n), cause.replace('_', "-"))).collect();
    lines.facts([
        ("rejected", rejected.join(", ")),
        (
            if done.kind == "grid" { "σ of crossings" } else { "σ of disparity" },
            sigma_quantiles(done.sigma_px, "px"),
        ),
        ("σ along rays", sigma_quantiles(done.sigma, unit)),
        ("σ of normals", sigma_quantiles(done.sigma_n_deg, "°")),
        ("σ of curvatures", sigma_quantiles(done.sigma_k, &per_unit)),
        ("ambient light", done.ambient.map_or(String::new(), percent)),
        ("σ of brightness", done.sigma_brightness.map_or(String::new(), |s| significant(s, 3))),
    ]);
    for file in &done.written {
        // Images have no points; their bands say what each value of a pixel is.
        let held = match file.points {
            Some(points) => format!("{} points", count(points)),
            None => file.bands.join(", "),
        };
        lines.line(format!("Wrote {} ({held}).", file.file.display()));
    }
    lines.into_text()
}
