//! Arguments of `planish merge`.

use crate::args::{CommonArgs, ReportArgs, length, whole, within};
use clap::{Args, ValueEnum, ValueHint};
use planish::merge::MergeMethod;
use planish::next::Length;
use std::path::PathBuf;

const MERGE_EXAMPLES: &str = "\
Examples:
  planish merge left.planish right.planish -o whole.ply
  planish merge left.ply right.ply -o whole.step -o whole.planish
  planish merge bun.conf -o bunny.ply --json
  planish merge left.ply right.ply --align -o whole.ply
  planish merge part.step scan.ply -o whole.ply
  planish merge a.ply b.stl c.obj --epsilon 0.2 --theta 40 -o whole.glb

Patches are saved models, meshes with faces, faces of STEP files (those that share edges are one patch), and scans in rows and columns (or lists of them), all in one frame. Places of two patches are \
one where they are nearer than ε and their normals differ by less than θ; both follow from σ unless they are given. A mesh states σ in \
a column `sigma`; where nothing states it, it is told from how patches differ. Where patches share a place, all of them say where the \
surface is, each with the weight of its information. Then each place is given to one patch, and the gaps are sewn: no edge has \
more than two triangles, whatever came in. A whole without handles can be written as a spline, too (.step, .planish): a sheet, a tube \
or a ball through the mesh, with the mesh's σ. With \
`--align` patches are moved first to where they lie on one another, the first as it stands; the covariance of every motion is in the JSON.";

/// How shared places are fused.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; `--method` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MethodName {
    Information,
    Refit,
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
#[command(after_help = MERGE_EXAMPLES)]
pub struct MergeArgs {
    /// Patches: saved models (.planish), meshes (.ply, .obj, .stl, .off, .glb), CAD faces (.step), scans in
    /// rows and columns, lists of scans (.conf, .toml)
    #[arg(value_name = "PATCH", required = true, value_hint = ValueHint::FilePath)]
    pub patches: Vec<PathBuf>,
    /// A file to write; its extension says the format (.ply with σ and `observed`, .glb, .obj, .stl; .step or
    /// .planish as one spline); may be repeated
    #[arg(short, long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// How shared places are fused: one spline by the information of all patches, one through their points
    /// all alike (the paper's), or the mean by information without a spline [default: information where all
    /// patches state σ, else refit]
    #[arg(long, value_name = "METHOD", value_enum)]
    pub method: Option<MethodName>,
    /// ε: places nearer than this may be one, as a length [default: 2.58 σ of their difference, 99 %]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true)]
    pub epsilon: Option<Length>,
    /// θ: normals of one place differ by less, in degrees [default: by σ and the length of edges, at most 69]
    #[arg(long, value_name = "DEGREES", value_parser = right_angle, allow_negative_numbers = true)]
    pub theta: Option<f64>,
    /// Bring patches that stand a little off (a percent of their size, a degree) onto the first before they
    /// are merged
    #[arg(long)]
    pub align: bool,
    /// Fill holes of up to so many edges, smoothly: new vertices are flagged as completed, their σ is a
    /// guess. The outer rim of a sheet is no hole
    #[arg(long, value_name = "EDGES", default_value_t = 0, value_parser = whole, allow_negative_numbers = true)]
    pub fill: usize,
    /// Tell of every vertex how the surface bends there, and whether it is on the border: columns
    /// `mean_curvature`, `gaussian_curvature`, `sigma_mean_curvature`, `border` in .ply and .glb
    #[arg(long)]
    pub curvature: bool,
    /// A closed surface that the thing lies within, such as the visual hull that `sense contours --hull`
    /// writes: it stands where no patch is, flagged as completed
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub complete: Option<PathBuf>,
    /// Most that chords leave the surface of a saved model or of CAD faces, as a length [default: half the
    /// median σ of a model, a ten thousandth of the size of CAD faces]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true)]
    pub mesh_tolerance: Option<Length>,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn right_angle(text: &str) -> Result<f64, String> {
    within(text, "an angle above 0 and up to 90 degrees", |v| v > 0.0 && v <= 90.0)
}
