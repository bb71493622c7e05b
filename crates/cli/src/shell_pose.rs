//! `planish shell pose`.

use crate::args::CommonArgs;
use crate::numbers::{count, counted, significant};
use crate::report::{self, Align, Lines, Summary};
use clap::{Args, ValueHint};
use planish::Job;
use planish::Result;
use planish::progress::Progress;
use planish::shell::pose::{ShellPoseJob, ShellPoseReport};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish shell pose person.obj --poses poses.toml -o posed.glb
  planish shell pose person.obj --poses poses.toml --rigid head -o posed.glb -o posed.obj

poses.toml:

  controls = 60                     # chosen on the mesh; or their places: controls = [[x, y, z], ...]
  blend = 2.0                       # over which length rigid parts fade into the rest
  [[rigid]]
  part = \"head\"                     # a group, object or material of the OBJ, or a file of vertex indices
  motion = \"follow\"                 # or \"held\"
  [[pose]]
  name = \"shoulders up\"
  move = [{ near = [10, 0, 2], by = [0, 3, 0] }, { near = [0, 0, 0], within = 6, by = [0, 1, 0] }, { control = 7, by = [0, 3, 0] }]
  [[keyframe]]
  seconds = 0
  weights = { \"shoulders up\" = 0 }
  [[keyframe]]
  seconds = 1.5
  weights = { \"shoulders up\" = 1 }

.glb holds the mesh at rest with its texture, a morph target for each pose, and an animation where there are keyframes; other formats hold the first pose. Controls that are not moved stay; a rigid part goes along \
with the controls around it, as nearly as a rigid motion can.";

/// Arguments of `planish shell pose`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ShellPoseArgs {
    /// The mesh: .obj (with texture coordinates, parts and materials), .ply, .stl, .off or .glb
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub mesh: PathBuf,
    /// Poses and keyframes: poses.toml, see below
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub poses: PathBuf,
    /// A part that stays rigid: a group, object or material of the OBJ, or a file of vertex indices
    /// (repeatable)
    #[arg(long, value_name = "PART")]
    pub rigid: Vec<String>,
    /// File to write; may be repeated: .glb with all poses, .obj, .ply, .stl or .off with the first
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellPoseArgs) -> u8 {
    report::run("shell pose", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellPoseArgs, progress: &dyn Progress) -> Result<Summary<ShellPoseReport>> {
    let job = ShellPoseJob {
        mesh: args.mesh.clone(),
        poses: args.poses.clone(),
        rigid: args.rigid.clone(),
        outputs: args.output.clone(),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text(&report),
        unit: report.unit,
        inputs: report.inputs.clone(),
        outputs: report.written.clone(),
        warnings: report.warnings.clone(),
        body: report,
    })
}

fn text(report: &ShellPoseReport) -> String {
    let mut lines = Lines::default();
    lines.line(format!(
        "Posed {} by {}.",
        counted(report.vertices, "vertex"),
        counted(report.controls, "control")
    ));
    lines.gap();
    let rows: Vec<Vec<String>> = (report.poses.iter())
        .map(|pose| vec![pose.name.clone(), count(pose.moved), significant(pose.farthest, 3)])
        .collect();
    let farthest =
        report.unit.map_or_else(|| "farthest vertex".to_owned(), |unit| format!("farthest vertex / {unit}"));
    lines.table(&[("pose", Align::Left), ("controls moved", Align::Right), (&farthest, Align::Right)], &rows);
    for part in &report.rigid {
        lines.line(format!(
            "{} stays rigid: {} vertices{}.",
            part.part,
            count(part.vertices),
            if part.held { ", held" } else { "" }
        ));
    }
    lines.into_text()
}
