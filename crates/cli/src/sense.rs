//! `planish sense`.

use crate::args::{CommonArgs, DepthArgs, GridArgs, PhotometricArgs, SenseArgs, Sensed, StereoArgs};
use crate::numbers::{count, percent, significant};
use crate::report::{self, Lines, Summary};
use planish::Job;
use planish::progress::Progress;
use planish::sense::{SenseJob, SenseKind, SenseReport};
use planish::{Error, GridOptions, Result, StereoOptions, StereoPoints, Unit};
use serde::Serialize;
use std::path::PathBuf;

/// The keys of `sense` beside the common ones.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: SenseReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SenseArgs) -> u8 {
    let (name, kind, output, common) = match &args.kind {
        Sensed::Stereo(args) => ("sense stereo", stereo(args), &args.output, &args.common),
        Sensed::Grid(args) => ("sense grid", Ok(grid(args)), &args.output, &args.common),
        Sensed::Photometric(args) => ("sense photometric", photometric(args), &args.output, &args.common),
        Sensed::Depth(args) => ("sense depth", Ok(depth(args)), &args.output, &args.common),
        Sensed::Contours(args) => return crate::occluding::run(args),
    };
    report::run(name, common, |progress| work(kind?, output, common, progress))
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
        warnings: done.warnings.clone(),
        body: Body { report: done, termination: "converged" },
    })
}

fn stereo(args: &StereoArgs) -> Result<SenseKind> {
    let [first, last] = args.disparities;
    let disparities = usize::try_from(i64::from(last) - i64::from(first) + 1);
    let disparities = disparities
        .map_err(|_| Error::input(format!("needed disparities from low to high, found {first}..{last}")))?;
    Ok(SenseKind::Stereo {
        left: args.left.clone(),
        right: args.right.clone(),
        calibration: args.calib.clone(),
        options: StereoOptions {
            least_disparity: first,
            disparities,
            small_step: args.p1,
            large_step: args.p2,
            uniqueness: args.uniqueness,
            left_right: args.left_right,
            speckle: args.speckle,
        },
        points: StereoPoints { step: args.step, max_sigma_px: args.max_sigma.unwrap_or(f64::INFINITY) },
    })
}

fn grid(args: &GridArgs) -> SenseKind {
    SenseKind::Grid {
        image: args.image.clone(),
        plain: args.plain.clone(),
        calibration: args.calib.clone(),
        options: GridOptions { scale_px: args.scale },
    }
}

fn photometric(args: &PhotometricArgs) -> Result<SenseKind> {
    match (&args.calib, args.normal_map, &args.images[..]) {
        (Some(calibration), None, images) => Ok(SenseKind::Photometric {
            images: images.to_vec(),
            mask: args.mask.clone(),
            calibration: calibration.clone(),
        }),
        (None, Some(sigma_deg), [image]) => Ok(SenseKind::NormalMap { image: image.clone(), sigma_deg }),
        (None, Some(_), images) => Err(Error::input(format!(
            "needed one picture of normals with --normal-map, found {}",
            images.len()
        ))),
        _ => Err(Error::input(
            "needed --calib with the lights, or --normal-map with the σ of a picture of normals",
        )),
    }
}

fn depth(args: &DepthArgs) -> SenseKind {
    SenseKind::Depth { image: args.image.clone(), calibration: args.calib.clone() }
}

fn text(done: &SenseReport) -> String {
    let mut lines = Lines::default();
    let share = percent(done.observations as f64 / done.pixels.max(1) as f64);
    let found = count(done.observations);
    let pixels = count(done.pixels);
    lines.line(match done.kind {
        "photometric" => format!("Sensed {found} normals of {pixels} pixels ({share})."),
        "grid" => format!("Sensed {found} places where stripes cross, in {pixels} pixels."),
        _ => format!("Sensed {found} points of {pixels} pixels ({share})."),
    });
    lines.gap();
    let unit = done.unit.map_or("", Unit::name);
    let per_unit = done.unit.map_or(String::new(), |unit| format!("1/{unit}"));
    let rejected: Vec<String> =
        done.rejected.iter().map(|(cause, n)| format!("{} {}", count(*n), cause.replace('_', "-"))).collect();
    lines.facts([
        ("left out", rejected.join(", ")),
        (
            if done.kind == "grid" { "σ of crossings" } else { "σ of disparity" },
            report::sigma_quantiles(done.sigma_px, "px"),
        ),
        ("σ along rays", report::sigma_quantiles(done.sigma, unit)),
        ("σ of normals", report::sigma_quantiles(done.sigma_n_deg, "°")),
        ("σ of curvatures", report::sigma_quantiles(done.sigma_k, &per_unit)),
        ("light from everywhere", done.ambient.map_or(String::new(), percent)),
        ("σ of brightness", done.sigma_brightness.map_or(String::new(), |s| significant(s, 3))),
    ]);
    for file in &done.written {
        let held = match file.points {
            Some(points) => format!("{} points", count(points)),
            None => file.bands.join(", "),
        };
        lines.line(format!("Wrote {} ({held}).", file.file.display()));
    }
    lines.into_text()
}
