//! `planish shell mesh`.

use super::MetaballName;
use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::{count, significant};
use crate::summary::{self, Summary};
use crate::values::positive;
use clap::{Args, ValueEnum, ValueHint};
use planish::progress::Progress;
use planish::shell::surface::{IsoLevel, ShellMeshJob, ShellMeshReport};
use planish::{Job, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell mesh mesh.obj -o shell.ply
  planish shell mesh mesh.obj --surface outer --thickness 2 --softness 0.5 -o outer.ply
  planish shell mesh mesh.obj --surface offset --offset -1.5 --cell 0.5 -o inner.stl
  planish shell mesh mesh.obj --surface offset --offset 0 -o clean.ply

The input mesh may be open, non-manifold and uneven. The field of all metaballs is sum exp(-k (r - d0)). \
`outer` and `offset` need a closed mesh. Its inside is determined by winding numbers, so faces may intersect \
or coincide. The result is closed and manifold; its distance from the exact surface is reported.";

/// Arguments of `planish shell mesh`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish shell mesh examples/data/pebble/truth.ply -o shell.ply"),
          after_long_help = EXAMPLES)]
pub struct ShellMeshArgs {
    /// Input mesh: .ply, .obj, .stl, .off, .glb, or the faces of a .step
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    mesh: PathBuf,
    /// Output mesh: .ply, .obj, .stl, .off or .glb; repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// Surface to mesh
    #[arg(long, value_enum, default_value_t = SurfaceName::Shell)]
    surface: SurfaceName,
    /// With --surface offset: distance from the mesh, in its unit; negative is inside
    #[arg(long, value_name = "LENGTH", default_value_t = 0.0, allow_negative_numbers = true)]
    offset: f64,
    /// Kind of metaballs
    #[arg(long, value_enum, default_value_t = MetaballName::Triangular, hide_short_help = true,
          help_heading = "Field")]
    metaball: MetaballName,
    /// Thickness d0 of triangular metaballs, in the mesh's unit [default: 1/100 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Field")]
    thickness: Option<f64>,
    /// Decay length 1/k of the field; nearer parts blend [default: 1/500 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Field")]
    softness: Option<f64>,
    /// Value T of the field at the shell
    #[arg(long, value_name = "VALUE", default_value_t = 1.0, value_parser = positive,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Field")]
    threshold: f64,
    /// Cell size, in the mesh's unit; smaller details are lost [default: 1/150 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    cell: Option<f64>,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Value of `--surface`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SurfaceName {
    /// Where the field reaches the threshold: a sheet on each side of the mesh, at about the thickness
    Shell,
    /// The outer sheet of the shell
    Outer,
    /// Points whose smooth distance from the mesh is --offset
    Offset,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellMeshArgs) -> u8 {
    summary::run("shell mesh", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellMeshArgs, progress: &dyn Progress) -> Result<Summary<ShellMeshReport>> {
    let job = ShellMeshJob {
        mesh: args.mesh.clone(),
        level: match args.surface {
            SurfaceName::Shell => IsoLevel::Shell,
            SurfaceName::Outer => IsoLevel::Outer,
            // The other surfaces need no distance: thickness and threshold decide where they are.
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
        findings: report.findings.clone(),
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
            // Measured on the result and not assumed, although marching tetrahedra should guarantee both
            // (docs/decisions/0068-marching-tetrahedra.md).
            (true, true) => ", closed and manifold",
            _ => ", not closed or not manifold",
        }
    ));
    lines.line(format!(
        "Cell size {}{unit}; distance from the exact surface: rms {}{unit}, largest {}{unit}.",
        significant(report.cell, 3),
        // The deviation from the exact surface tells whether the cell size was small enough.
        significant(report.deviation_rms, 3),
        significant(report.deviation_max, 3)
    ));
    lines.into_text()
}
