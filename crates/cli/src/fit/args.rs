//! Arguments of `planish fit`.

use super::values::{depth, gate, genus, held_out, max_coefficients, symmetry};
use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::values::{grid, length, positive};
use clap::{Args, ValueEnum, ValueHint};
use planish::Length;
use planish::Shape;
use planish::complete::SymmetryChoice;
use planish::export::Closing;
use planish::fit::{Filter, RefineBy};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish fit examples/data/pebble/job.toml -o part.step -o part.ply -o part.planish
  planish fit bun.conf --unit m -o bunny.step
  planish fit today.ply --update part.planish -o newer.planish
  planish fit tile.laz --ground -o ground.tif
  planish fit vessel/job.toml --symmetry rotation:full -o whole.ply
  planish fit examples/data/pebble/job.toml --filter patch --max-depth 3 -o part.planish
  planish fit bending/job.toml --motion bend -o sheet.planish
  planish fit examples/data/pebble/job.toml --animate pebble.glb

Inputs:
  scans          .ply .pcd .e57 .las .laz .obj .stl .glb .npy .npz .xyz .txt .asc .csv .pts
  depth images   .png .tif, with the camera's calibration in a .toml file of the same name
  lists of scans .conf (VRIP) or .toml (a job, which can also specify the sensors and their σ)

If no σ is given, it is estimated from the data. A stated σ that is inconsistent with the data is \
reported and replaced. All lengths are in the unit of the files.

Outputs:
  .step .stp   the exact surface, for CAD programs
  .ply .glb    a mesh; each vertex has its normal, σ along the normal, and `observed`: 1 measured,
               2 completed, 0 neither
  .obj .stl    a mesh without σ
  .tif .tiff   a raster of heights and their σ, for sheets over z (GeoTIFF)
  .planish     the model with its covariance, for `compare`, `next` and `fit --update`";

/// Arguments of `planish fit`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish fit examples/data/pebble/job.toml -o part.step"),
          after_long_help = EXAMPLES)]
pub struct FitArgs {
    /// Scans (.ply, .e57, .las, .xyz, …), depth images, or lists of scans (.conf, .toml)
    #[arg(required = true, value_name = "SCAN", value_hint = ValueHint::FilePath)]
    pub scans: Vec<PathBuf>,
    /// Output file; the extension selects the format; repeatable
    ///
    /// Formats: .step, .ply, .glb, .obj, .stl, .tif and .planish.
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Show the model forming, reading by reading: a .glb animation or a folder of images
    ///
    /// The folder must be new or empty; the images are frame_0001.png and so on. Colours show σ from dark
    /// violet (small) to yellow (large). Orange dots in the images are the readings used so far.
    // An animation shows readings in their order (docs/decisions/0021-animation.md). An update starts
    // from a finished model, and known parameters are solved in one step.
    #[arg(long, value_name = "OUT.glb|DIR", value_hint = ValueHint::AnyPath, hide_short_help = true,
          conflicts_with_all = ["update", "known_uv", "ground"])]
    pub animate: Option<PathBuf>,

    /// Add the scans to a saved model; its grid is kept
    ///
    /// The smoothness prior of the model is not counted a second time.
    // The model decides shape and grid (docs/decisions/0086-types-instead-of-flags.md).
    #[arg(long, value_name = "MODEL.planish", help_heading = "Surface", value_hint = ValueHint::FilePath,
          conflicts_with_all = ["shape", "tolerance", "max_coefficients", "max_depth"])]
    pub update: Option<PathBuf>,
    /// Topology [default: detected, with any number of handles]
    #[arg(long, value_name = "SHAPE", value_enum, help_heading = "Surface")]
    pub shape: Option<ShapeName>,
    /// Number of handles of a closed object: the holes through it [default: detected]
    // Completion needs the regular parameters of a shape.
    #[arg(long, value_name = "N", value_parser = genus, allow_negative_numbers = true,
          help_heading = "Surface", hide_short_help = true,
          conflicts_with_all = ["shape", "update", "known_uv", "motion", "symmetry", "complete", "ground"])]
    pub genus: Option<usize>,
    /// Fit a surface that is smooth everywhere [default: sharp edges of closed objects are followed]
    #[arg(long, help_heading = "Surface", hide_short_help = true,
          conflicts_with_all = ["update", "known_uv", "motion", "symmetry", "complete", "ground"])]
    pub smooth: bool,
    /// Fit a fixed grid of NxM cells; columns u and v of the files give the parameters
    ///
    /// The fit takes one step. u and v are in [0, 1]. The surface is a sheet unless --shape is given; balls
    /// and tori need at least 4x4 cells. σ is taken only from the `sigma` column or from a sensor. At most
    /// 3000 readings are held out. A sheet of 61x61 cells has 64x64 control vertices.
    // One linear step on a fixed grid refines nothing and searches no foot points, so these options have no
    // effect.
    #[arg(long, value_name = "NxM", value_parser = grid, help_heading = "Surface", hide_short_help = true,
          conflicts_with_all = ["update", "tolerance", "max_coefficients", "max_depth", "refine_by", "filter",
                                "ground"])]
    pub known_uv: Option<[usize; 2]>,
    /// Stop refining at this distance from the points [default: when only noise remains]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Surface", hide_short_help = true)]
    pub tolerance: Option<Length>,
    /// How readings are fused [default: global]
    #[arg(long, value_name = "FILTER", value_enum, help_heading = "Surface", hide_short_help = true)]
    pub filter: Option<FilterName>,
    /// Maximum subdivision depth [default: limited by the readings; 3 with --filter patch]
    #[arg(long, value_name = "N", value_parser = depth, allow_negative_numbers = true,
          help_heading = "Surface", hide_short_help = true)]
    pub max_depth: Option<u8>,
    /// Criterion for the subdivision of cells
    #[arg(long, value_name = "CAUSE", value_enum, default_value_t = RefineByName::Residuals,
          help_heading = "Surface", hide_short_help = true)]
    pub refine_by: RefineByName,
    /// Maximum number of control vertices, of which each takes about 32 KB of memory [default: 62500, which
    /// take 2 GB, or those that half of a stated `--max-memory` holds]
    #[arg(long, value_name = "N", value_parser = max_coefficients,
          allow_negative_numbers = true, help_heading = "Surface", hide_short_help = true)]
    pub max_coefficients: Option<usize>,
    /// Maximum chord error of meshes, as a length [default: half the median σ]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Surface", hide_short_help = true)]
    pub mesh_tolerance: Option<Length>,
    /// Cell size of a .tif raster, as a length [default: about the spacing of the readings]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Surface", hide_short_help = true)]
    pub cell_size: Option<Length>,
    /// Close meshes and STEP files over places without readings
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = ClosingName::Auto,
          help_heading = "Surface", hide_short_help = true)]
    pub close: ClosingName,

    /// Keep only bare earth below objects up to WIDTH [default width: 36 m]
    ///
    /// The points are seen from above (z up). Ground classes in the file are used.
    // `require_equals`: otherwise `--ground scan.laz` would take the scan as the width.
    #[arg(long, value_name = "WIDTH", value_parser = positive, num_args = 0..=1, require_equals = true,
          help_heading = "Readings")]
    #[allow(clippy::option_option, reason = "clap's type of an option whose value is optional")]
    pub ground: Option<Option<f64>>,
    /// Estimate scan poses (corrects errors of a few percent of the size)
    ///
    /// The first scan stays fixed. The other scans may be off by a few percent of the object's size and by a
    /// few degrees. A pose whose σ the job specifies is estimated without this option.
    #[arg(long, help_heading = "Readings", conflicts_with = "known_uv")]
    pub align: bool,
    /// Reject readings more than this many σ from the surface
    #[arg(long, value_name = "SIGMAS", default_value_t = 4.0, value_parser = gate,
          allow_negative_numbers = true, help_heading = "Readings")]
    pub gate: f64,
    /// Lower a stated σ if the residuals are smaller
    ///
    /// A stated σ that is too small is always raised. Small residuals alone do not lower it, because the
    /// surface follows errors that neighbouring readings share (smoothed scans, meshes of other programs).
    /// Use this option for a sensor whose errors are independent and whose σ is stated too large.
    #[arg(long, help_heading = "Readings", hide_short_help = true)]
    pub estimate_sigma: bool,
    /// Write a result even if the surface does not follow much of the readings
    ///
    /// A fit is refused if more than 5 % of the measured area is not followed, as with a hole through the
    /// object or several bodies. With this option the result is written, with a finding of level `error`.
    #[arg(long, help_heading = "Readings", hide_short_help = true,
          conflicts_with_all = ["update", "known_uv"])]
    pub force: bool,
    /// Share of the readings that is held out to validate the fit, from 0 to below 0.9
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = held_out,
          allow_negative_numbers = true, help_heading = "Readings", hide_short_help = true)]
    pub held_out: f64,

    /// Complete unobserved parts: auto, mirror, rotation:full or rotation:N
    ///
    /// The axis or plane is fitted to the readings. `rotation:full` is a surface of revolution; `auto`
    /// selects the symmetry that the readings support, if any. An approximate direction may follow, as in
    /// rotation:full:z or mirror:0,1,0.2. Completed parts have `observed` = 2. Measurements take precedence.
    // Completion happens during a fit with refinement; an update keeps the strategy of its model.
    #[arg(long, value_name = "SYMMETRY", value_parser = symmetry, help_heading = "Completion",
          conflicts_with_all = ["update", "known_uv"])]
    pub symmetry: Option<SymmetryChoice>,
    /// Fill gaps with the plane, sphere or cylinder that fits their surroundings
    ///
    /// A gap is filled only if the readings around it fit such a shape. σ of the filled part includes the
    /// uncertainty of the fitted shape and of its type.
    #[arg(long, value_name = "HOW", value_enum, help_heading = "Completion", hide_short_help = true,
          conflicts_with_all = ["update", "known_uv"])]
    pub complete: Option<Completion>,
    /// The object moves during scanning; estimate its motion
    ///
    /// The job gives the time of each scan (`time`, in seconds).
    #[arg(long, value_name = "HOW", value_enum, help_heading = "Completion", hide_short_help = true,
          conflicts_with_all = ["update", "known_uv", "ground"])]
    pub motion: Option<MotionName>,
    /// With --motion bend: write the sheet at each time to this folder
    ///
    /// The files are state-1.planish, state-1.ply and so on.
    #[arg(long, value_name = "DIR", requires = "motion", help_heading = "Completion", hide_short_help = true,
          value_hint = ValueHint::DirPath)]
    pub states: Option<PathBuf>,

    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Value of `--shape`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ShapeName {
    /// One boundary
    Sheet,
    /// Open at both ends
    Tube,
    /// Closed, without handles
    Ball,
    /// Closed, with one handle
    Torus,
}

impl From<ShapeName> for Shape {
    fn from(name: ShapeName) -> Self {
        match name {
            ShapeName::Sheet => Self::Sheet,
            ShapeName::Tube => Self::Tube,
            ShapeName::Ball => Self::Ball,
            ShapeName::Torus => Self::Torus,
        }
    }
}

/// Value of `--motion`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MotionName {
    /// A rigid object: estimates its poses and velocity. The model is the object at the first scan
    Rigid,
    /// A sheet that bends without stretching. Scans of one time form one state; without times, each file
    /// does. Parts that a scan missed are transferred from other times (`observed` = 2). The model is the
    /// sheet at the last time. The summary reports whether the sheet stretched
    Bend,
}

/// Value of `--complete`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Completion {
    /// By a plane, sphere or cylinder
    Smooth,
}

/// Value of `--close`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ClosingName {
    /// All shapes but sheets, which end where their readings end
    Auto,
    /// All shapes: a sheet covers a whole rectangle of parameters
    Always,
    /// No shape: surfaces are open where nothing was measured or completed
    Never,
}

impl From<ClosingName> for Closing {
    fn from(name: ClosingName) -> Self {
        match name {
            ClosingName::Auto => Self::Auto,
            ClosingName::Always => Self::Always,
            ClosingName::Never => Self::Never,
        }
    }
}

/// Value of `--filter`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FilterName {
    /// All readings at once; the most accurate
    Global,
    /// One reading at a time into small patches, like the filter of a live sensor; memory does not grow with
    /// the number of readings
    Patch,
}

impl From<FilterName> for Filter {
    fn from(name: FilterName) -> Self {
        match name {
            FilterName::Global => Self::Global,
            FilterName::Patch => Self::Patch,
        }
    }
}

/// Value of `--refine-by`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RefineByName {
    /// Correlated residuals, which show that the surface cannot follow the readings
    Residuals,
    /// Varying Gaussian curvature: sd(K) / max(|K|, σ_K) > 0.5 beyond what σ_K explains
    Curvature,
    /// Residuals or curvature
    Both,
    /// As `both`, and cells too large for the estimated roughness; gives the correct σ for surfaces that are
    /// rough at every scale, but is slower
    Roughness,
}

impl From<RefineByName> for RefineBy {
    fn from(name: RefineByName) -> Self {
        match name {
            RefineByName::Residuals => Self::Residuals,
            RefineByName::Curvature => Self::Curvature,
            RefineByName::Both => Self::Both,
            RefineByName::Roughness => Self::Roughness,
        }
    }
}
