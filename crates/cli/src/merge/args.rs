//! Arguments of `planish merge`.

use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::values::{count, length, right_angle};
use clap::{Args, ValueEnum, ValueHint};
use planish::Length;
use planish::merge::MergeMethod;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish merge left.planish right.planish -o whole.ply
  planish merge left.ply right.ply -o whole.step -o whole.planish
  planish merge bun.conf -o bunny.ply --json
  planish merge left.ply right.ply --align -o whole.ply
  planish merge part.step scan.ply -o whole.ply
  planish merge a.ply b.stl c.obj --epsilon 0.2 --theta 40 -o whole.glb

Patches are saved models, meshes with faces, CAD faces (connected faces form one patch), and organised scans \
or lists of them. All patches are in one frame.

Points of two patches correspond if their distance is below ε and their normals differ by less than θ. Both \
limits follow from σ by default. A mesh gives σ in a column `sigma`; if no σ is given, it is estimated from \
the differences between patches. Corresponding points are fused, weighted by their information. Each region \
is then assigned to one patch and the gaps are closed. In the result no edge has more than two triangles.

A result of one part can also be written as one spline (.step, .planish): a sheet, a tube or a closed \
surface with any number of handles, fitted to the mesh, with the σ of the mesh. With --align, the other \
patches are first registered to the first patch; the JSON object has the covariance of each motion.";

/// Value of `--method`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    /// One spline through all patches, weighted by information: smoother, but it loses fine shape
    Information,
    /// The same with equal weights, as in the paper
    Refit,
    /// The mean weighted by information, without a spline (default)
    Mean,
}

impl From<MethodName> for MergeMethod {
    fn from(name: MethodName) -> Self {
        match name {
            MethodName::Information => Self::Information,
            MethodName::Refit => Self::Refit,
            MethodName::Mean => Self::Mean,
        }
    }
}

/// Arguments of `planish merge`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish merge left.ply right.ply -o whole.ply"),
          after_long_help = EXAMPLES)]
pub struct MergeArgs {
    /// Patches: models, meshes, CAD faces (.step), organised scans or lists of scans
    ///
    /// Formats: .planish, .ply, .obj, .stl, .off, .glb, .step, and lists of scans in .conf and .toml.
    #[arg(value_name = "PATCH", required = true, value_hint = ValueHint::FilePath)]
    pub patches: Vec<PathBuf>,
    /// Output file; the extension selects the format; repeatable
    ///
    /// Formats: .ply (with σ and `observed`), .glb, .obj, .stl; .step or .planish for one spline.
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// How corresponding points are fused [default: mean]
    #[arg(long, value_name = "METHOD", value_enum, hide_short_help = true, help_heading = "Fusion")]
    pub method: Option<MethodName>,
    /// ε: maximum distance of corresponding points [default: from σ]
    ///
    /// The default is 2.58 σ of the difference of the points (99 %).
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Fusion")]
    pub epsilon: Option<Length>,
    /// θ: maximum angle between corresponding normals [default: from σ]
    ///
    /// The default follows from σ and the length of the edges and is at most 69°.
    // Normals more than 90° apart belong to opposite sides of a wall, which must not be fused.
    #[arg(long, value_name = "DEGREES", value_parser = right_angle, allow_negative_numbers = true,
          help_heading = "Fusion")]
    pub theta: Option<f64>,
    /// Register the patches to the first one (corrects 1 % of their size and 1°)
    #[arg(long, help_heading = "Fusion")]
    pub align: bool,
    /// Use each stated σ unchanged
    ///
    /// Otherwise σ of every patch is compared with the differences in its overlaps, and enlarged if it is too
    /// small.
    #[arg(long, hide_short_help = true, help_heading = "Fusion")]
    pub believe_sigma: bool,
    /// Fill holes of at most this many edges; 0: none [default: holes up to 3 edges wide]
    ///
    /// New vertices are marked as completed; their σ is a rough estimate. The outer rim of a sheet is not
    /// filled. The width of a hole is that of a slit, and half the diameter of a round hole.
    #[arg(long, value_name = "EDGES", value_parser = count, allow_negative_numbers = true,
          help_heading = "Result")]
    pub fill: Option<usize>,
    /// Write curvatures and a boundary flag for each vertex
    ///
    /// Columns `mean_curvature`, `gaussian_curvature`, `sigma_mean_curvature` and `border` in .ply and .glb.
    #[arg(long, hide_short_help = true, help_heading = "Result")]
    pub curvature: bool,
    /// Closed mesh that bounds the object; it fills the parts without patches
    ///
    /// An example is the visual hull of `sense contours --hull`. The filled parts are marked as completed.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, hide_short_help = true,
          help_heading = "Result")]
    pub complete: Option<PathBuf>,
    /// Maximum chord error when models or CAD faces are meshed, as a length
    ///
    /// Default: half the median σ of a model, or 1/10000 of the size of CAD faces.
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          hide_short_help = true, help_heading = "Result")]
    pub mesh_tolerance: Option<Length>,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}
