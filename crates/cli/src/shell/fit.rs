//! `planish shell fit`.

mod text;

use super::MetaballName;
use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::summary::{self, Summary};
use crate::values::positive;
use clap::{Args, ValueEnum, ValueHint};
use planish::progress::Progress;
use planish::shell::fit::{DeformationKind, ShellFitJob, ShellFitReport};
use planish::{Error, Job, Result};
use std::path::PathBuf;

/// Maximum number of controls; with more, the equations become too large.
const MAX_CONTROLS: u64 = 1000;

const EXAMPLES: &str = "\
Examples:
  planish shell fit mesh.obj --points cloud.ply -o fitted.ply -o fitted.glb
  planish shell fit ball.ply --silhouettes views.toml --controls 100 -o fitted.ply
  planish shell fit mesh.ply --points cloud.ply --silhouettes views.toml -o fitted.obj
  planish shell fit person.obj --points cloud.ply --rigid head -o fitted.glb
  planish shell fit person.obj --points cloud.ply --landmarks landmarks.csv -o fitted.glb
  planish shell fit body.ply --sequence frames --controls 40 -o moved.ply

Points are read as by `planish fit`, with σ or covariance if the file has them.

Columns of a CSV file of landmarks, named in its first line:
  x, y, z            measured position
  vertex             vertex of the mesh, counted from 0; or instead of it
  mesh_x, mesh_y, mesh_z
                     the place, near the surface of the mesh
  sigma, name        optional

views.toml has a table [[view]] for each view:
  K, R and t, or P   camera: X_camera = R X + t; x right, y down, pixel centres at integers
  mask               silhouette, such as mask = \"a.png\"
  name, image        optional
  contours           optional CSV of points (x,y) on outlines inside the mask
  held_out           true if the view is used only for validation
Keys of one view or of all views:
  mask_threshold, sigma_px
  mask_least_share   specks and holes below this share are filled
  box                two corners of a box that contains the object; for all views only
  sigma_rotation_deg, sigma_translation
                     the pose of the view is estimated, too
  tracks             CSV (track,view,x,y) of features tracked over views; for all views only

Meshes may be open and non-manifold. For silhouettes, their faces need consistent orientation. PLY and GLB \
have sigma along the normal, and observed: 1 if points are near, or if outlines give most of the \
information; 3 if the mesh does not follow the points there. OBJ and GLB keep the texture and the texture \
coordinates of an OBJ or GLB. Rigid parts turn by up to about 45°.";

/// Arguments of `planish shell fit`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish shell fit mesh.obj --points cloud.ply -o fitted.ply"),
          after_long_help = EXAMPLES)]
pub struct ShellFitArgs {
    /// Mesh to deform: .ply, .obj, .stl, .off, .glb, or the faces of a .step
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    mesh: PathBuf,
    /// Points on the target surface; repeatable
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath,
          required_unless_present_any = ["silhouettes", "landmarks", "sequence"])]
    points: Vec<PathBuf>,
    /// Cameras with masks of the target (views.toml)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    silhouettes: Option<PathBuf>,
    /// Measured positions of places of the mesh (CSV)
    ///
    /// Points say where the surface is, landmarks say which place of it is where. Three or more also bring a
    /// mesh to its points that starts far away.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    landmarks: Option<PathBuf>,
    /// Folder of frames of a moving object
    ///
    /// It has a folder for each frame, ordered by name, with views.toml, points.* or landmarks.csv. The
    /// meshes are written as NAME.FRAME.ply, when a frame has been followed and again when the later frames
    /// are known.
    // The frames have their own points and views, so files for all of them would be ambiguous.
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath,
          conflicts_with_all = ["points", "silhouettes", "landmarks"], hide_short_help = true)]
    sequence: Option<PathBuf>,
    /// Estimate each frame of a sequence from those up to it only
    #[arg(long, requires = "sequence", hide_short_help = true)]
    causal: bool,
    /// Output mesh: .ply, .glb, .obj or .stl; repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    output: Vec<PathBuf>,
    /// How the mesh is deformed
    #[arg(long, value_enum, default_value_t = DeformationName::Dirichlet, help_heading = "Deformation")]
    deformation: DeformationName,
    /// Number of controls [default: 60, and up to 400 where points need more]
    ///
    /// Controls are chosen on the mesh, denser where it is curved. By default, fits to points add controls
    /// where the mesh does not follow them; sequences do not. For a lattice it is the total number of points,
    /// rounded to a cube of at least 8. For modes it is the maximum number of modes.
    // `u64`, because clap checks ranges of fixed-width integers only.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=MAX_CONTROLS),
          help_heading = "Deformation")]
    controls: Option<u64>,
    /// File of points to use as controls, on or off the mesh
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, hide_short_help = true,
          help_heading = "Deformation")]
    controls_file: Option<PathBuf>,
    /// With --deformation modes: a mesh of the family, with the same vertices; give at least two
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, hide_short_help = true,
          required_if_eq("deformation", "modes"), help_heading = "Deformation")]
    family: Vec<PathBuf>,
    /// A rigid part: a group, object or material of the OBJ, or a file of vertex indices; repeatable
    #[arg(long, value_name = "PART", hide_short_help = true, help_heading = "Deformation")]
    rigid: Vec<String>,
    /// Width of the transition around rigid parts [default: 1/10 of the mesh's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          requires = "rigid", hide_short_help = true, help_heading = "Deformation")]
    blend: Option<f64>,
    /// Kind of metaballs that form the shell
    #[arg(long, value_enum, default_value_t = MetaballName::Triangular, hide_short_help = true,
          help_heading = "Fit")]
    metaball: MetaballName,
    /// Minimum distance of points on the outline of a mask
    #[arg(long, value_name = "PIXELS", default_value_t = 5.0, value_parser = positive,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Fit")]
    outline_step: f64,
    /// Use each stated σ unchanged
    ///
    /// Otherwise one factor for σ of the points and one for σ of the outlines are estimated.
    #[arg(long, hide_short_help = true, help_heading = "Fit")]
    believe_sigma: bool,
    /// The mesh is only a rough initial shape, such as an ellipsoid
    ///
    /// Before the fit the mesh grows into uncovered parts of the masks, is cut outside of the masks, and is
    /// remeshed. The mesh must be closed; its texture is lost.
    // The mesh is remeshed, so vertex indices of parts, controls and a family would no longer apply.
    #[arg(long, requires = "silhouettes", conflicts_with_all = ["rigid", "controls_file", "family"],
          hide_short_help = true, help_heading = "Fit")]
    rough_start: bool,
    /// Write the mesh even if it does not follow much of its points
    ///
    /// A fit is refused if more than 5 % of the points agree with their neighbours but are 1 % of the size
    /// away from the mesh, as with a part that was found turned by a wrong angle. With this option the mesh
    /// is written, with a finding of level `error`.
    #[arg(long, hide_short_help = true, help_heading = "Fit")]
    force: bool,
    /// The report.
    #[command(flatten)]
    page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    common: CommonArgs,
}

/// Value of `--deformation`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DeformationName {
    /// Natural neighbour interpolation of controls (Dirichlet free-form deformation)
    Dirichlet,
    /// A lattice around the mesh
    Lattice,
    /// Every vertex; at most 600
    Vertices,
    /// The modes of a family of meshes
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
    summary::run("shell fit", &args.common, |progress| work(args, progress))
}

fn work(args: &ShellFitArgs, progress: &dyn Progress) -> Result<Summary<ShellFitReport>> {
    // clap has `required_if_eq` for the opposite direction only.
    if !args.family.is_empty() && args.deformation != DeformationName::Modes {
        return Err(Error::input("expected --deformation modes with --family"));
    }
    let job = ShellFitJob {
        mesh: args.mesh.clone(),
        points: args.points.clone(),
        silhouettes: args.silhouettes.clone(),
        landmarks: args.landmarks.clone(),
        sequence: args.sequence.clone(),
        deformation: args.deformation.into(),
        // The parser has limited the number to 1000, so the cast loses nothing.
        controls: args.controls.map(|count| count as usize),
        controls_file: args.controls_file.clone(),
        family: args.family.clone(),
        metaball: args.metaball.into(),
        rigid: args.rigid.clone(),
        blend: args.blend,
        outline_step_px: args.outline_step,
        believe_sigma: args.believe_sigma,
        rough_start: args.rough_start,
        causal: args.causal,
        force: args.force,
        outputs: args.output.clone(),
        report: args.page.output(&args.common),
        unit: args.common.unit.map(Into::into),
    };
    let report = job.run(progress)?;
    Ok(Summary {
        text: text::text(&report),
        unit: Some(report.unit),
        inputs: report.inputs.clone(),
        outputs: report.written.iter().chain(&args.page.report).cloned().collect(),
        findings: report.findings.clone(),
        body: report,
    })
}
