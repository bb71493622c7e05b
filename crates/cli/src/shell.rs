//! `planish shell`: deforms, meshes, poses and colours a mesh.

mod fit;
mod mesh;
mod pose;
mod texture;

use clap::{Args, Subcommand, ValueEnum};
use planish::shell::surface::Metaball;

/// Arguments of `planish shell`.
#[derive(Debug, Args)]
#[command(subcommand_required = true, arg_required_else_help = true)]
pub struct ShellArgs {
    /// The command.
    #[command(subcommand)]
    command: ShellCommand,
}

/// The commands of a shell.
#[derive(Debug, Subcommand)]
enum ShellCommand {
    /// Deform a mesh by controls until it fits points and silhouettes; report its σ
    Fit(fit::ShellFitArgs),
    /// Mesh the surface of a shell: closed and manifold for any input mesh
    Mesh(mesh::ShellMeshArgs),
    /// Pose a mesh by moving controls; write it with its texture and poses
    Pose(pose::ShellPoseArgs),
    /// Colour the vertices or the texture of a mesh from calibrated images
    Texture(texture::ShellTextureArgs),
}

/// Value of `--metaball`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
// `shell fit` and `shell mesh` build the same field, so they share this value.
enum MetaballName {
    /// Built around whole facets
    Triangular,
    /// Spheres around the centres of small facets
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

/// Runs the command; returns the exit code.
pub fn run(args: &ShellArgs) -> u8 {
    match &args.command {
        // Each command has its own JSON keys, so each calls `summary::run` itself.
        ShellCommand::Fit(args) => fit::run(args),
        ShellCommand::Mesh(args) => mesh::run(args),
        ShellCommand::Pose(args) => pose::run(args),
        ShellCommand::Texture(args) => texture::run(args),
    }
}
