//! `planish shell fit`: its arguments, and what it says.

use crate::args::{CommonArgs, ReportArgs, positive};
use crate::numbers::{count, counted, significant};
use crate::report::{self, Align, Lines, Summary};
use crate::shell_args::MetaballName;
use clap::{Args, ValueEnum, ValueHint};
use planish::Job;
use planish::progress::Progress;
use planish::shell::fit::{DeformationKind, ReadingsReport, ShellFitJob, ShellFitReport};
use planish::{Error, Result};
use std::path::PathBuf;

/// Controls beyond this make equations too large.
const MOST_CONTROLS: u64 = 1000;

const SHELL_FIT_EXAMPLES: &str = "\
Examples:
  planish shell fit mesh.obj --points cloud.ply -o fitted.ply -o fitted.glb
  planish shell fit ball.ply --silhouettes views.toml --controls 100 -o fitted.ply
  planish shell fit mesh.ply --points cloud.ply --silhouettes views.toml -o fitted.obj
  planish shell fit person.obj --points cloud.ply --rigid head -o fitted.glb
  planish shell fit body.ply --sequence frames --controls 40 -o moved.ply

Points are read as by `planish fit`, with σ or covariance where the file has them. views.toml holds a table [[view]] for each view: K, R and t (X_camera = R X + t; x right, y down, pixel \
centres at integers) or P, and mask = \"a.png\"; optionally name, image, contours = \"a.csv\" (x,y of places on outlines inside of the mask), held_out = true (the view only judges), and for one view or \
for all: mask_threshold, mask_least_share (specks and holes below it are filled), sigma_px, and sigma_rotation_deg with sigma_translation, which make its pose one of the unknowns. tracks = \"tracks.csv\" (track,view,x,y) beside them holds features that were followed over views.
Meshes need neither be closed nor manifold; for silhouettes their faces have to be turned the same way. PLY and GLB hold sigma, along the normal, and observed: 1 where more than half of what is known comes from the readings. \
Where an OBJ or GLB has texture coordinates, OBJ and GLB keep them and its texture. Rigid parts turn by small angles only: what is fitted is linear in them.";

/// Arguments of `planish shell fit`.
#[derive(Debug, Args)]
#[command(after_help = SHELL_FIT_EXAMPLES)]
pub struct ShellFitArgs {
    /// The mesh to move: .ply, .obj, .stl, .off, .glb, or the faces of a .step
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub mesh: PathBuf,
    /// Points that it is to go through (repeatable)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, required_unless_present_any = ["silhouettes", "sequence"])]
    pub points: Vec<PathBuf>,
    /// Cameras with the masks that it is to fill: views.toml, see below
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub silhouettes: Option<PathBuf>,
    /// A folder with one for each frame of something that moves, in the order of their names, each with
    /// views.toml, points.* or both; meshes are written as NAME.FRAME.ply
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath, conflicts_with_all = ["points", "silhouettes"])]
    pub sequence: Option<PathBuf>,
    /// Mesh to write; may be repeated: .ply, .glb, .obj, .stl
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// What moves the mesh: natural neighbours of controls, a lattice around it, every vertex (of 600 at
    /// most), or the modes of a family
    #[arg(long, value_enum, default_value_t = DeformationName::Dirichlet)]
    pub deformation: DeformationName,
    /// How many controls, chosen on the mesh, denser where it bends; of a lattice its points in all, as the
    /// nearest cube of a whole number (8 at least), of modes the most
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=MOST_CONTROLS))]
    pub controls: u64,
    /// Control points instead, on the mesh or off it, as a file of points
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub controls_file: Option<PathBuf>,
    /// A member of the family whose modes move the mesh, with the same vertices (repeatable; two at least)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, required_if_eq("deformation", "modes"))]
    pub family: Vec<PathBuf>,
    /// A part that stays rigid: a group, object or material of the OBJ, or a file of vertex indices
    /// (repeatable)
    #[arg(long, value_name = "PART")]
    pub rigid: Vec<String>,
    /// Over which length rigid parts fade into the rest [default: a tenth of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, requires = "rigid")]
    pub blend: Option<f64>,
    /// What the shell is built around: facets, or spheres about small pieces of them
    #[arg(long, value_enum, default_value_t = MetaballName::Triangular)]
    pub metaball: MetaballName,
    /// Places on the border of a mask are at least so far apart
    #[arg(long, value_name = "PIXELS", default_value_t = 5.0, value_parser = positive, allow_negative_numbers = true)]
    pub outline_step: f64,
    /// Take every stated σ for true, instead of finding one factor for points and one for outlines
    #[arg(long)]
    pub believe_sigma: bool,
    /// Take the mesh for a rough start, such as an ellipsoid: before the fit it flows out where masks are not
    /// covered, is cut where they show nothing, and is meshed anew. It has to be closed; its texture is lost
    #[arg(long, requires = "silhouettes", conflicts_with_all = ["rigid", "controls_file", "family"])]
    pub rough_start: bool,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// A deformation on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the deformations")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DeformationName {
    Dirichlet,
    Lattice,
    Vertices,
    Modes,
}

impl From<DeformationName> for DeformationKind {
    fn from(name: DeformationName) -> Self {
        match name {
            DeformationName::Dirichlet => Self::Dirichlet,
            DeformationName::Lattice => Self::Lattice,
            DeformationName::Vertices => Self::Vertices,
            DeformationName::Modes => Self::Modes,
        }
    }
}

/// Runs the command; returns the exit code.
pub fn run(args: &ShellFitArgs) -> u8 {
    report::run("shell fit", &args.common, |progress| fit(args, progress))
}

fn fit(args: &ShellFitArgs, progress: &dyn Progress) -> Result<Summary<ShellFitReport>> {
    if !args.family.is_empty() && args.deformation != DeformationName::Modes {
        return Err(Error::input("--family is for --deformation modes"));
    }
    let job = ShellFitJob {
        mesh: args.mesh.clone(),
        points: args.points.clone(),
        silhouettes: args.silhouettes.clone(),
        sequence: args.sequence.clone(),
        deformation: args.deformation.into(),
        controls: args.controls as usize,
        controls_file: args.controls_file.clone(),
        family: args.family.clone(),
        metaball: args.metaball.into(),
        rigid: args.rigid.clone(),
        blend: args.blend,
        outline_step_px: args.outline_step,
        believe_sigma: args.believe_sigma,
        rough_start: args.rough_start,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: fit_text(&report),
        unit: Some(report.unit),
        inputs: report.inputs.clone(),
        outputs: report.written.iter().chain(&args.page.report).cloned().collect(),
        warnings: report.warnings.clone(),
        body: report,
    })
}

fn fit_text(report: &ShellFitReport) -> String {
    let mut lines = Lines::default();
    let unit = report.unit;
    lines.line(format!(
        "Fitted a shell by {} in {}.",
        counted(report.controls, "control"),
        counted(report.iterations, "iteration")
    ));
    lines.gap();
    let of = |name: &str, r: &Option<ReadingsReport>, unit: &str| {
        r.as_ref().map(|r| {
            vec![
                name.to_owned(),
                count(r.count),
                count(r.outliers),
                format!("{} {unit}", significant(r.rms, 3)),
                significant(r.sigma_factor, 3),
            ]
        })
    };
    let rows: Vec<Vec<String>> = [
        of("points", &report.points, &unit.to_string()),
        of("outlines", &report.outlines, "px"),
        of("tracks", &report.tracks, "σ"),
    ]
    .into_iter()
    .flatten()
    .collect();
    lines.table(
        &[
            ("", Align::Left),
            ("readings", Align::Right),
            ("gross errors", Align::Right),
            ("rms", Align::Right),
            ("σ found/stated", Align::Right),
        ],
        &rows,
    );
    lines.gap();
    if !report.iou.is_empty() {
        let rows: Vec<Vec<String>> = (report.iou.iter())
            .map(|(view, iou)| {
                vec![
                    view.clone(),
                    significant(report.iou_before[view], 3),
                    significant(*iou, 3),
                    if report.held_out.contains(view) { "held out".to_owned() } else { String::new() },
                ]
            })
            .collect();
        lines.table(
            &[
                ("view", Align::Left),
                ("IoU before", Align::Right),
                ("after", Align::Right),
                ("", Align::Left),
            ],
            &rows,
        );
        lines.gap();
    }
    if !report.frames.is_empty() {
        let shown = |value: Option<f64>| value.map_or_else(String::new, |value| significant(value, 3));
        let rows: Vec<Vec<String>> = (report.frames.iter())
            .map(|frame| {
                vec![
                    frame.frame.clone(),
                    shown(frame.rms_points),
                    shown(frame.rms_silhouettes_px),
                    shown(frame.iou),
                    shown(frame.surprise),
                    significant(frame.sigma, 3),
                ]
            })
            .collect();
        let (rms_points, sigma) = (format!("rms points / {unit}"), format!("σ / {unit}"));
        lines.table(
            &[
                ("frame", Align::Left),
                (&rms_points, Align::Right),
                ("rms outlines px", Align::Right),
                ("IoU", Align::Right),
                ("surprise/σ", Align::Right),
                (&sigma, Align::Right),
            ],
            &rows,
        );
        lines.gap();
    }
    if !report.poses.is_empty() {
        let largest = |values: [f64; 3]| significant(values.into_iter().fold(0.0, f64::max), 2);
        let rows: Vec<Vec<String>> = (report.poses.iter())
            .map(|pose| {
                vec![
                    pose.view.clone(),
                    format!("{}°", significant(pose.turned_deg, 3)),
                    format!("{}°", largest(pose.sigma_rotation_deg)),
                    significant(pose.moved, 3),
                    largest(pose.sigma_translation),
                ]
            })
            .collect();
        let moved = format!("moved / {unit}");
        lines.table(
            &[
                ("camera", Align::Left),
                ("turned", Align::Right),
                ("σ", Align::Right),
                (&moved, Align::Right),
                ("σ", Align::Right),
            ],
            &rows,
        );
        lines.gap();
    }
    lines.facts([
        (
            "σ of the vertices",
            format!(
                "median {} {unit}, 95 % below {}, largest {}",
                significant(report.sigma.median, 3),
                significant(report.sigma.p95, 3),
                significant(report.sigma.max, 3)
            ),
        ),
        ("measured", format!("{:.1} % of the vertices", 100.0 * report.observed_fraction)),
    ]);
    lines.into_text()
}
