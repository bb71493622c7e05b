//! `planish shell mesh`.

use super::MetaballName;
use crate::common::{CommonArgs, short_help};
use crate::lines::Lines;
use crate::numbers::{count, significant};
use crate::summary::{self, Summary};
use crate::values::positive;
use clap::{Args, ValueEnum, ValueHint};
use planish::progress::Progress;
use planish::shell::surface::{MeshedSurface, ShellMeshJob, ShellMeshReport};
use planish::{Error, Job, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell mesh mesh.obj -o around.ply
  planish shell mesh mesh.obj --offset 2 --cell 0.5 -o around.stl
  planish shell mesh mesh.obj --surface offset --offset -1.5 -o inner.stl
  planish shell mesh mesh.obj --surface offset --offset 0 -o clean.ply
  planish shell mesh mesh.obj --surface shell --thickness 2 --softness 0.5 -o shell.ply

The input mesh may be open, non-manifold and uneven. `outer` and `offset` are at exact distances and keep \
sharp edges. `offset` needs a closed mesh; its faces may intersect or coincide. `shell` is where the field \
sum exp(-k (r - d0)) of all metaballs reaches the threshold. The result is closed and manifold; its distance \
from the exact surface is reported.";

/// Heading of the options that only the paper's shell has.
const SHELL_HEADING: &str = "With --surface shell";

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
    #[arg(long, value_enum, default_value_t = SurfaceName::Outer)]
    surface: SurfaceName,
    /// Distance from the mesh, in its unit; negative is inside [default: 1/100 of the mesh's size, 0 with
    /// --surface offset]
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true)]
    offset: Option<f64>,
    /// Kind of metaballs [default: triangular]
    #[arg(long, value_enum, hide_short_help = true, help_heading = SHELL_HEADING)]
    metaball: Option<MetaballName>,
    /// Thickness d0 of triangular metaballs, in the mesh's unit [default: 1/100 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = SHELL_HEADING)]
    thickness: Option<f64>,
    /// Decay length 1/k of the field; nearer parts blend [default: 1/500 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = SHELL_HEADING)]
    softness: Option<f64>,
    /// Value T of the field at the shell [default: 1]
    #[arg(long, value_name = "VALUE", value_parser = positive, allow_negative_numbers = true,
          hide_short_help = true, help_heading = SHELL_HEADING)]
    threshold: Option<f64>,
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
    /// Points at the distance --offset that can be reached from outside: one sheet
    Outer,
    /// All points at the signed distance --offset from a closed mesh
    Offset,
    /// Where the field reaches the threshold: a sheet on each side of the mesh, at about the thickness
    Shell,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellMeshArgs) -> u8 {
    summary::run("shell mesh", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellMeshArgs, progress: &dyn Progress) -> Result<Summary<ShellMeshReport>> {
    check_options(args)?;
    let defaults = ShellMeshJob::default();
    let job = ShellMeshJob {
        mesh: args.mesh.clone(),
        surface: match args.surface {
            SurfaceName::Shell => MeshedSurface::Shell,
            SurfaceName::Outer => MeshedSurface::Outer(args.offset),
            SurfaceName::Offset => MeshedSurface::Offset(args.offset.unwrap_or(0.0)),
        },
        metaball: args.metaball.map_or(defaults.metaball, Into::into),
        thickness: args.thickness,
        softness: args.softness,
        threshold: args.threshold.unwrap_or(defaults.threshold),
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

/// Rejects options that the chosen surface would ignore.
fn check_options(args: &ShellMeshArgs) -> Result<()> {
    let of_shell = [
        ("--metaball", args.metaball.is_some()),
        ("--thickness", args.thickness.is_some()),
        ("--softness", args.softness.is_some()),
        ("--threshold", args.threshold.is_some()),
    ];
    match (args.surface, of_shell.iter().find(|(_, given)| *given)) {
        (SurfaceName::Shell, _) if args.offset.is_some() => Err(Error::input(
            "--offset has no effect with --surface shell: use --thickness, or another surface",
        )),
        (SurfaceName::Outer | SurfaceName::Offset, Some((name, _))) => Err(Error::input(format!(
            "{name} needs --surface shell: the distance of the other surfaces is --offset"
        ))),
        _ => Ok(()),
    }
}

fn text(report: &ShellMeshReport) -> String {
    let mut lines = Lines::default();
    let unit = report.unit.map_or(String::new(), |unit| format!(" {unit}"));
    let place = match report.distance {
        Some(distance) => {
            format!("the surface at {}{unit} from {} facets", significant(distance, 3), count(report.facets))
        }
        None => format!("a shell of {} facets", count(report.facets)),
    };
    lines.line(format!(
        "Meshed {place}: {} triangles, {} vertices, {} {}{}.",
        count(report.triangles),
        count(report.vertices),
        count(report.components),
        if report.components == 1 { "part" } else { "parts" },
        match (report.watertight && report.manifold, report.self_intersections) {
            // Measured on the result, not assumed.
            (true, 0) => ", closed and manifold, without self-intersections".to_owned(),
            (true, pairs) => format!(", closed and manifold, with {} self-intersections", count(pairs)),
            (false, _) => ", not closed or not manifold".to_owned(),
        }
    ));
    if report.enclosed > 0 {
        lines.line(format!(
            "{} {} that cannot be reached from outside {} left out.",
            count(report.enclosed),
            if report.enclosed == 1 { "sheet" } else { "sheets" },
            if report.enclosed == 1 { "was" } else { "were" },
        ));
    }
    lines.line(format!(
        "Cell size {}{unit}; distance from the exact surface: rms {}{unit}, largest {}{unit}.",
        significant(report.cell, 3),
        // The deviation from the exact surface tells whether the cell size was small enough.
        significant(report.deviation_rms, 3),
        significant(report.deviation_max, 3)
    ));
    lines.into_text()
}
