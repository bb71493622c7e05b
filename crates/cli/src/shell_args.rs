//! Arguments of `planish shell`.

use crate::args::{CommonArgs, positive};
use clap::{Args, Subcommand, ValueEnum, ValueHint};
use planish::shell::fit::{DeformationKind, Metaball};
use std::path::PathBuf;

/// Controls beyond this make equations too large.
const MOST_CONTROLS: u64 = 1000;

/// Arguments of `planish shell`.
#[derive(Debug, Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
pub struct ShellArgs {
    /// What to do with the shell.
    #[command(subcommand)]
    pub command: ShellCommand,
}

/// The jobs of a shell.
#[derive(Debug, Subcommand)]
pub enum ShellCommand {
    /// Move a mesh by a few controls until it fits points and silhouettes, and say how well it is known
    Fit(ShellFitArgs),
}

const SHELL_FIT_EXAMPLES: &str = "\
Examples:
  planish shell fit mesh.obj --points cloud.ply -o fitted.ply -o fitted.glb
  planish shell fit ball.ply --silhouettes views.toml --controls 100 -o fitted.ply
  planish shell fit mesh.ply --points cloud.ply --silhouettes views.toml --metaball spherical -o fitted.obj
  planish shell fit body.ply --sequence frames --controls 40 -o moved.ply

Points are read as by `planish fit`, with σ or covariance where the file has them. views.toml holds a table [[view]] for each view: K, R and t (X_camera = R X + t; x right, y down, pixel \
centres at integers) or P, and mask = \"a.png\"; optionally name, image, contours = \"a.csv\" (x,y of places on outlines inside of the mask), held_out = true (the view only judges), and for one view or \
for all: mask_threshold, mask_least_share (specks and holes below it are filled), sigma_px, and sigma_rotation_deg with sigma_translation, which make its pose one of the unknowns. tracks = \"tracks.csv\" (track,view,x,y) beside them holds features that were followed over views.
Meshes need neither be closed nor manifold; for silhouettes their faces have to be turned the same way. PLY and GLB hold sigma, along the normal, and observed: 1 where more than half of what is known comes from the readings.";

/// Arguments of `planish shell fit`.
#[derive(Debug, Args)]
#[command(after_help = SHELL_FIT_EXAMPLES)]
pub struct ShellFitArgs {
    /// The mesh to move: .ply, .obj, .stl or .glb
    #[arg(value_name = "MESH", value_hint = ValueHint::FilePath)]
    pub mesh: PathBuf,
    /// Points that it is to go through (repeatable)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, required_unless_present_any = ["silhouettes", "sequence"])]
    pub points: Vec<PathBuf>,
    /// Cameras with the masks that it is to fill: views.toml, see below
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub silhouettes: Option<PathBuf>,
    /// A folder with one for each frame of something that moves, in the order of their names, each with views.toml, points.* or both; meshes are written as NAME.FRAME.ply
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath, conflicts_with_all = ["points", "silhouettes"])]
    pub sequence: Option<PathBuf>,
    /// Mesh to write; may be repeated: .ply, .glb, .obj, .stl
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// What moves the mesh: natural neighbours of controls, a lattice around it, every vertex, or the modes of a family
    #[arg(long, value_enum, default_value_t = DeformationName::Dirichlet)]
    pub deformation: DeformationName,
    /// How many controls, chosen on the mesh, denser where it bends; of a lattice its points in all, of modes the most
    #[arg(long, value_name = "N", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=MOST_CONTROLS))]
    pub controls: u64,
    /// Control points instead, on the mesh or off it, as a file of points
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub controls_file: Option<PathBuf>,
    /// A member of the family whose modes move the mesh, with the same vertices (repeatable; two at least)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, required_if_eq("deformation", "modes"))]
    pub family: Vec<PathBuf>,
    /// What the shell is built around: facets, or spheres about small pieces of them
    #[arg(long, value_enum, default_value_t = MetaballName::Triangular)]
    pub metaball: MetaballName,
    /// Places on the border of a mask are at least so far apart
    #[arg(long, value_name = "PIXELS", default_value_t = 5.0, value_parser = positive, allow_negative_numbers = true)]
    pub outline_step: f64,
    /// Take every stated σ for true, instead of finding one factor for points and one for outlines
    #[arg(long)]
    pub believe_sigma: bool,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// A deformation on the command line.
#[allow(
    missing_docs,
    reason = "a doc comment becomes a paragraph of help; the names are the deformations"
)]
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

/// A kind of metaballs on the command line.
#[allow(
    missing_docs,
    reason = "a doc comment becomes a paragraph of help; the names are the kinds"
)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MetaballName {
    Triangular,
    Spherical,
}

impl From<MetaballName> for Metaball {
    fn from(name: MetaballName) -> Self {
        match name {
            MetaballName::Triangular => Self::Triangular,
            MetaballName::Spherical => Self::Spherical,
        }
    }
}
