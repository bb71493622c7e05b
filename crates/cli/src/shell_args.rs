//! Arguments of `planish shell`.

use crate::shell_fit::ShellFitArgs;
use crate::shell_mesh::ShellMeshArgs;
use crate::shell_pose::ShellPoseArgs;
use crate::shell_texture::ShellTextureArgs;
use clap::{Args, Subcommand, ValueEnum};
use planish::shell::surface::Metaball;

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
    /// Mesh the surface of a shell: closed and manifold, whatever the mesh is like
    Mesh(ShellMeshArgs),
    /// Pose a mesh by moving a few controls, and write it with its texture and its poses
    Pose(ShellPoseArgs),
    /// Colour a mesh from calibrated pictures: its vertices, or a texture on it
    Texture(ShellTextureArgs),
}

/// A kind of metaballs on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the kinds")]
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
