//! `planish shell mesh`.

use crate::args::{CommonArgs, positive};
use crate::numbers::{count, significant};
use crate::report::{self, Lines, Summary};
use crate::shell_args::MetaballName;
use clap::{Args, ValueEnum, ValueHint};
use planish::Job;
use planish::Result;
use planish::progress::Progress;
use planish::shell::surface::{IsoLevel, ShellMeshJob, ShellMeshReport};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell mesh mesh.obj -o shell.ply
  planish shell mesh mesh.obj --surface outer --thickness 2 --softness 0.5 -o outer.ply
  planish shell mesh mesh.obj --surface offset --offset -1.5 --cell 0.5 -o inner.stl
  planish shell mesh mesh.obj --surface offset --offset 0 -o clean.ply

The mesh may be open, not manifold and uneven. `shell` is where the field of all metaballs, sum exp(-k (r - d0)), reaches the threshold: two sheets, at about the thickness on either side of the mesh. `outer` is the outer one alone, and `offset` the \
places whose smooth distance from the mesh is --offset, negative inside: both need a closed mesh, whose inside is told by winding numbers, so that faces may cross or lie double. The result is closed and manifold; its distance from the exact surface is told.";

/// Arguments of `planish shell mesh`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ShellMeshArgs {
    /// The mesh: .ply, .obj, .stl, .off, .glb, or the faces of a .step
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub mesh: PathBuf,
    /// Mesh to write; may be repeated: .ply, .obj, .stl, .off, .glb
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Which surface: both sheets of the shell, its outer sheet, or an offset of the mesh
    #[arg(long, value_enum, default_value_t = SurfaceName::Shell)]
    pub surface: SurfaceName,
    /// Of --surface offset: how far from the mesh, in its unit; negative is inside
    #[arg(long, value_name = "LENGTH", default_value_t = 0.0, allow_negative_numbers = true)]
    pub offset: f64,
    /// What metaballs are built around: whole facets, or the middles of small ones
    #[arg(long, value_enum, default_value_t = MetaballName::Triangular)]
    pub metaball: MetaballName,
    /// Thickness d0 of triangular metaballs, in the mesh's unit [default: 1/100 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub thickness: Option<f64>,
    /// Length 1/k over which the field dies away: what is nearer to each other blends [default: 1/500 of the
    /// mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub softness: Option<f64>,
    /// The field's value T at the shell
    #[arg(long, value_name = "VALUE", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true)]
    pub threshold: f64,
    /// Side of a cell, in the mesh's unit: what is smaller is not seen [default: 1/150 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub cell: Option<f64>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// A surface on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the surfaces")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SurfaceName {
    Shell,
    Outer,
    Offset,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellMeshArgs) -> u8 {
    report::run("shell mesh", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellMeshArgs, progress: &dyn Progress) -> Result<Summary<ShellMeshReport>> {
    let job = ShellMeshJob {
        mesh: args.mesh.clone(),
        level: match args.surface {
            SurfaceName::Shell => IsoLevel::Shell,
            SurfaceName::Outer => IsoLevel::Outer,
            SurfaceName::Offset => IsoLevel::Offset(args.offset),
        },
        metaball: args.metaball.into(),
        thickness: args.thickness,
        softness: args.softness,
        threshold: args.threshold,
        cell: args.cell,
        outputs: args.output.clone(),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text(&report),
        unit: report.unit,
        inputs: vec![args.mesh.clone()],
        outputs: report.written.clone(),
        warnings: report.warnings.clone(),
        body: report,
    })
}

fn text(report: &ShellMeshReport) -> String {
    let mut lines = Lines::default();
    let unit = report.unit.map_or(String::new(), |unit| format!(" {unit}"));
    lines.line(format!(
        "Meshed a shell of {} facets: {} triangles, {} vertices, {} {}{}.",
        count(report.facets),
        count(report.triangles),
        count(report.vertices),
        count(report.components),
        if report.components == 1 { "part" } else { "parts" },
        match (report.watertight, report.manifold) {
            (true, true) => ", closed and manifold",
            _ => ", neither closed nor manifold everywhere",
        }
    ));
    lines.line(format!(
        "Cells of {}{unit}; facets lie {}{unit} (rms) from the exact surface, {}{unit} at most.",
        significant(report.cell, 3),
        significant(report.deviation_rms, 3),
        significant(report.deviation_max, 3)
    ));
    lines.into_text()
}
