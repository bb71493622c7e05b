//! `planish solid`: reconstructs solids from views.

mod text;

use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::summary::{self, Summary};
use crate::values::{length, positive, probability};
use clap::{Args, ValueEnum, ValueHint};
use planish::progress::Progress;
use planish::solid::{Projection, SolidJob, SolidReport, ViewKind, ViewPlace};
use planish::{ErrorKind, Job, Length, Result};
use serde::Serialize;
use std::cell::Cell;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish solid examples/data/bracket/front.dxf examples/data/bracket/top.dxf examples/data/bracket/side.dxf \
-o bracket.step
  planish solid front.dxf top.dxf -o part.step --all --json
  planish solid sheet.dxf -o part.step
  planish solid sheet.pdf --projection first -o part.step
  planish solid sheet.dxf --view front=20,20,60,40 --view top=20,60,60,90 -o part.step
  planish solid picture.png --scale 0.25 -o part.step
  planish solid front.svg top.svg side.svg -o part.glb --mesh-tolerance 0.01
  planish solid front.json side.json --as front,side -o part.step -o part.json --graphs graphs.json

Views:
  front  seen from -y, shows x and z
  top    seen from +z, shows x and y
  side   seen from +x, shows y and z
All views share one frame and one scale. On a sheet with all views, the views are found and aligned with \
the front view; frame, title block, dimensions, notes, sections and other views are left out and listed \
(--json). The lower left corner of each view becomes its origin, on such a sheet and in SVG and PDF files \
and pictures. Lengths are multiplied by the scale that the dimensions or the title block state.

Hidden lines have dashes of one length, or a layer or line type whose name says so (HIDDEN, VERDECKT, CACHE \
...). Centre lines, of alternating dashes, are ignored. Faces are planes parallel to a line of sight and \
cylinders along an axis. Smooth edges may be drawn or omitted. A solid is written only if its visible and \
hidden lines are those of the drawing.

Contours written by `planish contour` (.json) are also views. Relations in each contour are found by χ² \
tests, or read from the file if it was made with --constrain or --given. Coordinates of different views are \
matched by χ² tests and fused into one geometry, weighted by their information. part.json then has vertices \
and dimensions in space with their σ.";

/// Arguments of `planish solid`.
#[derive(Debug, Args)]
#[command(
    after_help = short_help!(
        "planish solid examples/data/bracket/front.dxf examples/data/bracket/top.dxf -o part.step"
    ),
    after_long_help = EXAMPLES
)]
pub struct SolidArgs {
    /// Front, top and optional side view (.dxf, .svg, .pdf, .png, .json), or one drawing with all views
    ///
    /// Views are drawings (.dxf, .svg, .pdf), pictures of drawings (.png, .jpg, .tif) or contours (.json).
    #[arg(value_name = "VIEW", value_hint = ValueHint::FilePath, num_args = 1..=3, required = true)]
    views: Vec<PathBuf>,
    /// Kinds of the views, such as `front,side` [default: front, top and side]
    #[arg(long = "as", value_name = "VIEWS", value_delimiter = ',', value_enum, help_heading = "Views")]
    kinds: Vec<ViewName>,
    /// For contours: probability that a true relation or match is rejected
    #[arg(long, value_name = "PROBABILITY", default_value_t = planish::contour::DEFAULT_LEVEL,
          value_parser = probability, allow_negative_numbers = true, hide_short_help = true,
          help_heading = "Contours")]
    level: f64,
    /// For contours: write the constraint graphs of the views and their composite graph
    ///
    /// Formats: .json and .dot; repeatable.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, hide_short_help = true,
          help_heading = "Contours")]
    graphs: Vec<PathBuf>,
    /// Write the best solid (.step), its mesh (.ply, .stl, .glb, .obj), or its σ (.json); repeatable
    ///
    /// A .json file has the vertices and dimensions with σ; it needs views that are contours.
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// Maximum distance of a mesh from the solid [default: 1/2000 of the drawing's size]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          hide_short_help = true)]
    mesh_tolerance: Option<Length>,
    /// Maximum distance of coordinates that are treated as equal
    ///
    /// This joins lines with small gaps between their ends, and views whose scales differ slightly.
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Views")]
    tolerance: Option<Length>,
    /// Write all solids with these views, best first: NAME.1.step, NAME.2.step, ...
    #[arg(long)]
    all: bool,
    /// Write the solid with the fewest edits of lines if no solid has these views
    ///
    /// Lines are added, removed, moved or drawn in the other style. The edits are listed first.
    #[arg(long)]
    repair: bool,
    /// Arrangement of the views of one file
    #[arg(long, value_enum, default_value_t = ProjectionName::Auto, help_heading = "Views")]
    projection: ProjectionName,
    /// For a picture: length of the part per pixel
    #[arg(long, value_name = "FACTOR", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Views")]
    scale: Option<f64>,
    /// Place of a view in one file with all views, such as `front=0,0,40,20`; repeatable
    ///
    /// The numbers are left, bottom, right and top in the coordinates of the file. Lines elsewhere are left
    /// out.
    #[arg(long = "view", value_name = "KIND=X0,Y0,X1,Y1", value_parser = place, hide_short_help = true,
          help_heading = "Views")]
    places: Vec<ViewPlace>,
    /// The report.
    #[command(flatten)]
    page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Value of `--projection`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ProjectionName {
    /// First angle (Europe): the top view is below the front view
    First,
    /// Third angle (America): the top view is above the front view
    Third,
    /// The convention that the places of the views show
    Auto,
}

/// One value of `--view`.
fn place(text: &str) -> std::result::Result<ViewPlace, String> {
    let wrong = || format!("expected a view and its box, such as front=0,0,40,20, found `{text}`");
    let (kind, numbers) = text.split_once('=').ok_or_else(wrong)?;
    let kinds = [ViewKind::Front, ViewKind::Top, ViewKind::Side, ViewKind::Left];
    let kind = kinds
        .into_iter()
        .find(|k| k.name() == kind.trim())
        .ok_or_else(|| format!("expected front, top, side or left before `=`, found `{kind}`"))?;
    let numbers: Vec<f64> = numbers
        .split(',')
        .map(|n| n.trim().parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(wrong))
        .collect::<std::result::Result<_, _>>()?;
    let bounds: [f64; 4] = numbers.try_into().map_err(|_| wrong())?;
    match bounds[0] < bounds[2] && bounds[1] < bounds[3] {
        true => Ok(ViewPlace { kind, bounds }),
        false => Err(format!("expected left < right and bottom < top, found `{text}`")),
    }
}

// The variants have no doc comments: the names are the views, and a doc comment would become help.
/// One value of `--as`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ViewName {
    Front,
    Top,
    Side,
}

impl From<ViewName> for ViewKind {
    fn from(name: ViewName) -> Self {
        match name {
            ViewName::Front => Self::Front,
            ViewName::Top => Self::Top,
            ViewName::Side => Self::Side,
        }
    }
}

/// JSON keys of `solid`.
#[derive(Serialize)]
struct Body {
    #[serde(flatten)]
    report: SolidReport,
    termination: &'static str,
}

/// Runs the command; returns the exit code.
pub fn run(args: &SolidArgs) -> u8 {
    // A drawing without a solution is a result with exit code 1, not an error: the summary lists the lines
    // that do not fit.
    let is_solved = Cell::new(true);
    let code = summary::run("solid", &args.common, |progress| work(args, progress, &is_solved));
    match code {
        0 if !is_solved.get() => ErrorKind::Undetermined.exit_code(),
        code => code,
    }
}

fn work(args: &SolidArgs, progress: &dyn Progress, is_solved: &Cell<bool>) -> Result<Summary<Body>> {
    let job = SolidJob {
        views: args.views.clone(),
        projection: match args.projection {
            ProjectionName::First => Some(Projection::FirstAngle),
            ProjectionName::Third => Some(Projection::ThirdAngle),
            ProjectionName::Auto => None,
        },
        places: args.places.clone(),
        scale: args.scale,
        kinds: (!args.kinds.is_empty()).then(|| args.kinds.iter().copied().map(Into::into).collect()),
        level: args.level,
        graphs: args.graphs.clone(),
        outputs: args.output.clone(),
        mesh_tolerance: args.mesh_tolerance,
        tolerance: args.tolerance,
        all: args.all,
        repair: args.repair,
        unit: args.common.unit.map(Into::into),
        report: args.page.output(&args.common),
    };
    let report = job.run(progress)?;
    // A cell, because `summary::run` returns only the exit code.
    is_solved.set(!report.solutions.is_empty());
    Ok(Summary {
        text: text::text(&report),
        unit: Some(report.unit),
        inputs: args.views.clone(),
        outputs: report.written.clone(),
        findings: report.findings.clone(),
        body: Body {
            // "limit" means that the search ended early, so there may be more solids with these views.
            termination: match (report.solutions.is_empty(), report.complete) {
                (true, _) => "undetermined",
                (false, true) => "converged",
                (false, false) => "limit",
            },
            report,
        },
    })
}
