//! `planish sense contours`.

use crate::common::{CommonArgs, short_help};
use crate::lines::{Align, Lines, sigma_quantiles};
use crate::numbers::{count, percent, significant};
use crate::summary::{self, Summary};
use crate::values::{self, positive};
use clap::{Args, ValueHint};
use planish::occluding::{OccludingJob, OccludingOptions, OccludingReport};
use planish::progress::Progress;
use planish::{Job, Result, Unit};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish sense contours views.toml -o points.ply
  planish sense contours views.toml --patch patch.ply --patch patch.planish --hull hull.ply --json

views.toml has a table [[view]] for each view, in the order of the camera's path. It has a mask (or \
contours, a CSV of x,y,sigma_px,contour), and K R t or P. A view with held_out = true is used only for \
validation. `box = [[x, y, z], [x, y, z]]` states a box that contains the object: pixels of masks whose line \
of sight misses it are background.

A contour point is matched in the previous and the next view along epipolar planes. The circle that is \
tangent to the three lines of sight gives its depth. Its normal needs only one view. Points that are \
inconsistent, or that the camera's motion does not determine, are counted and rejected.

Connected points of neighbouring views form a strip, and --patch writes a surface for each strip: \
patch.1.ply, patch.2.ply and so on. These are meshes between the contours of consecutive views, with σ, for \
`planish merge`. For splines (.planish, .step) a sheet is fitted.";

/// Arguments of `planish sense contours`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish sense contours views.toml -o points.ply"),
          after_long_help = EXAMPLES)]
pub struct ContoursArgs {
    /// Cameras of the views with their masks or contours
    #[arg(value_name = "VIEWS.toml", value_hint = ValueHint::FilePath)]
    views: PathBuf,
    /// Write points with covariance and normals (.ply); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// Write a surface patch of each strip; repeatable
    ///
    /// A number is inserted before the extension. Formats: .ply (with σ and `observed`), .planish, .step,
    /// .glb, .obj and .stl.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    patch: Vec<PathBuf>,
    /// Write the visual hull of the masks (.ply, .glb, .obj, .stl)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    hull: Option<PathBuf>,
    /// Write the closed surface that agrees best with all masks (.ply, .glb, .obj, .stl)
    ///
    /// The visual hull loses every place that one mask shows as background by mistake. This surface restores
    /// places where the other views show the object. Both only bound the object, so `observed` is 2 in .ply.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    surface: Option<PathBuf>,
    /// Compare the outlines of this mesh, and of the hull, with each mask
    #[arg(long, value_name = "MESH", value_hint = ValueHint::FilePath)]
    judge: Option<PathBuf>,
    /// Minimum number of points of a strip with a patch
    #[arg(long = "least-points", value_name = "N", default_value_t = 200, value_parser = values::count,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Estimation")]
    min_points: usize,
    /// Half width of the window that gives position and tangent of a contour, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 6.0, value_parser = positive,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Estimation")]
    window: f64,
    /// Angle to the epipolar line below which a contour point is a frontier point, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 15.0, value_parser = positive,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Estimation")]
    frontier: f64,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// JSON keys of `sense contours`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: OccludingReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ContoursArgs) -> u8 {
    summary::run("sense contours", &args.common, |progress| work(args, progress))
}

fn work(args: &ContoursArgs, progress: &dyn Progress) -> Result<Summary<Body>> {
    let job = OccludingJob {
        views: args.views.clone(),
        outputs: args.output.clone(),
        patches: args.patch.clone(),
        min_points: args.min_points,
        hull: args.hull.clone(),
        surface: args.surface.clone(),
        judged: args.judge.clone(),
        options: OccludingOptions {
            // Options that are not on the command line keep the defaults of the library.
            half_window_px: args.window,
            frontier_deg: args.frontier,
            ..OccludingOptions::default()
        },
        unit: args.common.unit.map(Unit::from),
        seed: args.common.seed,
    };
    let done = job.run(progress)?;
    // The JSON object lists every file that was written, and patches are reported apart from points.
    let patches = done.patches.iter().flat_map(|p| &p.files).map(|w| w.file.clone());
    Ok(Summary {
        text: text(&done),
        unit: done.unit,
        inputs: done.inputs.clone(),
        outputs: done.written.iter().cloned().chain(patches).collect(),
        findings: done.findings.clone(),
        body: Body { report: done, termination: "converged" },
    })
}

fn text(done: &OccludingReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Computed {} points from {} contour points of {} views ({}).",
        count(done.observations),
        count(done.contour_points),
        count(done.views),
        // The divisor is at least 1: masks may be empty.
        percent(done.observations as f64 / done.contour_points.max(1) as f64)
    ));
    lines.gap();
    let unit = done.unit.map_or("", Unit::name);
    // The keys are those of the JSON object, so that a cause has one name in both outputs.
    let rejected: Vec<String> = (done.rejected.iter())
        .map(|(cause, n)| format!("{} {}", count(*n), cause.replace('_', "-")))
        .collect();
    // One sequence is the normal case and needs no line.
    let pairs = (done.sequences > 1).then(|| format!("{} sequences of views", count(done.sequences)));
    lines.facts([
        ("rejected", rejected.join(", ")),
        ("views", pairs.unwrap_or_default()),
        ("contours", format!("reduced χ² {:.3} of the local parabolas", done.chi2)),
        ("σ of depths", sigma_quantiles(done.sigma_depth, unit)),
        // The circle through three lines of sight has an error of its own in wide steps
        // (docs/decisions/0035-occluding-contours.md).
        ("of the circle model", sigma_quantiles(done.sigma_circle, unit)),
        ("σ along normals", sigma_quantiles(done.sigma, unit)),
        ("σ of normals", sigma_quantiles(done.sigma_n_deg, "°")),
        (
            "unobserved",
            // There the hull is only a bound of the object.
            done.unseen_share.map_or(String::new(), |share| {
                format!(
                    "{} of the surface of the visual hull has no contour nearby (concave, or between views)",
                    percent(share)
                )
            }),
        ),
    ]);
    if let Some(surface) = &done.surface {
        lines.gap();
        lines.facts([(
            "surface",
            format!("{} facets in {} parts", count(surface.triangles), count(surface.parts)),
        )]);
    }
    if !done.patches.is_empty() {
        lines.gap();
        patches(&mut lines, done, unit);
    }
    if !done.iou.is_empty() {
        lines.gap();
        overlaps(&mut lines, done);
    }
    lines.gap();
    for file in done.written.iter().chain(done.patches.iter().flat_map(|p| p.files.iter().map(|w| &w.file))) {
        lines.line(format!("Wrote {}.", file.display()));
    }
    lines.into_text()
}

/// A table of the patches.
fn patches(lines: &mut Lines, done: &OccludingReport, unit: &str) {
    let rows: Vec<Vec<String>> = (done.patches.iter())
        .enumerate()
        .map(|(k, p)| {
            vec![
                (k + 1).to_string(),
                count(p.points),
                count(p.views),
                significant(p.sigma, 3),
                significant(p.area, 4),
                percent(p.missing_share),
            ]
        })
        .collect();
    lines.table(
        &[
            ("patch", Align::Right),
            ("points", Align::Right),
            ("views", Align::Right),
            (&format!("σ / {unit}"), Align::Right),
            ("area", Align::Right),
            ("rejected inside", Align::Right),
        ],
        &rows,
    );
}

/// A table of the intersection over union of outlines and masks.
fn overlaps(lines: &mut Lines, done: &OccludingReport) {
    // Four decimals: values near 1 differ only in the last ones.
    let share = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.4}"));
    let rows: Vec<Vec<String>> = (done.iou.iter())
        .map(|row| {
            // Only held-out views judge independently: the others have shaped the hull.
            let held = if row.held_out { "held out" } else { "" };
            vec![row.view.clone(), held.to_owned(), share(row.hull), share(row.surface), share(row.judged)]
        })
        .collect();
    lines.table(
        &[
            ("view", Align::Left),
            ("", Align::Left),
            ("IoU of the hull", Align::Right),
            ("of the surface", Align::Right),
            ("of the mesh", Align::Right),
        ],
        &rows,
    );
}
