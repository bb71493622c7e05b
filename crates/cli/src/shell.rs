//! `planish shell`.

use crate::shell_args::{ShellArgs, ShellCommand};

/// Runs the command; returns the exit code.
pub fn run(args: &ShellArgs) -> u8 {
    match &args.command {
        ShellCommand::Fit(args) => crate::shell_fit::run(args),
        ShellCommand::Mesh(args) => crate::shell_mesh::run(args),
        ShellCommand::Pose(args) => crate::shell_pose::run(args),
        ShellCommand::Texture(args) => crate::shell_texture::run(args),
    }
}
