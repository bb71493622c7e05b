//! The `planish` command: parse, call the façade, print.
//!
//! Comes in: a command line. Goes out: files, a summary on stdout, warnings and errors on stderr, and an exit
//! code: 0 done, 1 ran but the data do not determine the answer, 2 wrong use or input, 3 file trouble, 130
//! interrupted, 101 a bug of ours.

mod args;
mod compare;
mod constrained_text;
mod contour;
mod contour_args;
mod failure;
mod fit;
mod info;
mod manual;
mod merge;
mod merge_args;
mod next;
mod numbers;
mod occluding;
mod progress;
mod report;
mod sense;
mod serve;
mod shell;
mod shell_args;
mod shell_fit;
mod shell_mesh;
mod shell_pose;
mod shell_scene;
mod shell_texture;
mod simulate;
mod solid;
mod view;
mod view_args;

use args::{Cli, Command};
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    failure::announce_bugs();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return ExitCode::from(report::not_understood(&e)),
    };
    let outcome = match cli.command {
        Command::Fit(args) => fit::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Sense(args) => sense::run(&args),
        Command::Contour(args) => contour::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Merge(args) => merge::run(&args),
        Command::Next(args) => next::run(&args),
        Command::Shell(args) => shell::run(&args),
        Command::Solid(args) => solid::run(&args),
        Command::Simulate(args) => simulate::run(&args),
        Command::View(args) => view::run(&args),
        Command::Completions(args) => manual::completions(&args),
        Command::Man(args) => manual::man(&args),
    };
    ExitCode::from(outcome)
}
