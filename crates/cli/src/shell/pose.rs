//! `planish shell pose`.

use crate::common::{CommonArgs, short_help};
use crate::lines::{Align, Lines};
use crate::numbers::{count, counted, significant};
use crate::summary::{self, Summary};
use clap::{Args, ValueHint};
use planish::progress::Progress;
use planish::shell::pose::{ShellPoseJob, ShellPoseReport};
use planish::{Job, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell pose person.obj --poses poses.toml -o posed.glb
  planish shell pose person.obj --poses poses.toml --rigid head -o posed.glb -o posed.obj

poses.toml:

  controls = 60                     # chosen on the mesh; or positions: controls = [[x, y, z], ...]
  blend = 2.0                       # width of the transition around rigid parts
  [[rigid]]
  part = \"head\"                     # group, object or material of the OBJ, or a file of indices
  motion = \"follow\"                 # or \"held\"
  [[pose]]
  name = \"shoulders up\"
  move = [
    { near = [10, 0, 2], by = [0, 3, 0] },
    { near = [0, 0, 0], within = 6, by = [0, 1, 0] },
    { control = 7, by = [0, 3, 0] },
  ]
  [[keyframe]]
  seconds = 0
  weights = { \"shoulders up\" = 0 }
  [[keyframe]]
  seconds = 1.5
  weights = { \"shoulders up\" = 1 }

A .glb file has the undeformed mesh with its texture, a morph target for each pose, and an animation if \
there are keyframes. Other formats have the first pose. Controls that are not moved stay fixed. A rigid part \
follows the controls around it with the nearest rigid motion.";

/// Arguments of `planish shell pose`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish shell pose person.obj --poses poses.toml -o posed.glb"),
          after_long_help = EXAMPLES)]
pub struct ShellPoseArgs {
    /// Mesh: .obj (with texture coordinates, parts and materials), .ply, .stl, .off or .glb
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    mesh: PathBuf,
    /// Poses and keyframes (poses.toml)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    poses: PathBuf,
    /// A rigid part: a group, object or material of the OBJ, or a file of vertex indices; repeatable
    #[arg(long, value_name = "PART")]
    rigid: Vec<String>,
    /// Output file: .glb has all poses; .obj, .ply, .stl and .off have the first pose; repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellPoseArgs) -> u8 {
    summary::run("shell pose", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellPoseArgs, progress: &dyn Progress) -> Result<Summary<ShellPoseReport>> {
    let job = ShellPoseJob {
        mesh: args.mesh.clone(),
        poses: args.poses.clone(),
        rigid: args.rigid.clone(),
        // Only .glb has morph targets; the job writes the first pose to all other formats.
        outputs: args.output.clone(),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text(&report),
        unit: report.unit,
        inputs: report.inputs.clone(),
        outputs: report.written.clone(),
        findings: report.findings.clone(),
        body: report,
    })
}

fn text(report: &ShellPoseReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Posed {} with {}.",
        counted(report.vertices, "vertex"),
        counted(report.controls, "control")
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (report.poses.iter())
        .map(|pose| vec![pose.name.clone(), count(pose.moved), significant(pose.farthest, 3)])
        .collect();
    // Without a unit in the file, the heading has none either.
    let farthest =
        report.unit.map_or_else(|| "farthest vertex".to_owned(), |unit| format!("farthest vertex / {unit}"));
    lines.table(&[("pose", Align::Left), ("controls moved", Align::Right), (&farthest, Align::Right)], &rows);
    for part in &report.rigid {
        lines.line(format!(
            "{} is rigid: {} vertices{}.",
            part.part,
            count(part.vertices),
            // Other rigid parts follow the surface around them.
            if part.held { ", fixed" } else { "" }
        ));
    }
    lines.into_text()
}
