//! The program `planish`: parses the command line, runs a job of the library and prints its result.
//!
//! In: a command line. Out: files, a summary on stdout, warnings and errors on stderr, and an exit code.
//! The exit codes are listed in [`EXIT_CODES`]. Each command has a module with its options and its call; its
//! text output and the parsers of its values are submodules. Commands do not import each other, except for
//! option values that they share.

mod common;
mod compare;
mod completions;
mod contour;
mod failure;
mod fit;
mod info;
mod lines;
mod man;
mod merge;
mod next;
mod numbers;
mod options;
mod progress;
mod sense;
mod serve;
mod shell;
mod simulate;
mod solid;
mod summary;
mod values;
mod verify;
mod view;

use clap::builder::styling::{AnsiColor, Styles};
use clap::{CommandFactory, Parser, Subcommand};
use std::process::ExitCode;

// clap drops colours by itself if the output is no terminal, or if NO_COLOR is set.
const STYLES: Styles = Styles::styled()
    .header(AnsiColor::Green.on_default().bold())
    .usage(AnsiColor::Green.on_default().bold())
    .literal(AnsiColor::Cyan.on_default());

const EXIT_CODES: &str = "\
Exit codes:
  0    success
  1    the data do not determine the result
  2    wrong use or invalid input
  3    a file could not be read or written
  101  a bug in planish
  130  interrupted; nothing was written
Run a command with -h for its main options, or with --help for all of them.
Example: planish fit examples/data/pebble/job.toml -o part.step";

/// Fit surfaces and solids to measurements, and report how accurate the result is.
#[derive(Debug, Parser)]
#[command(name = "planish", version, styles = STYLES, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    /// The command to run.
    #[command(subcommand)]
    command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
// The first lines of these comments are the help texts, so they are imperative and have no period at the end.
enum Command {
    /// Fit a surface to scans and report its uncertainty
    Fit(fit::FitArgs),
    /// Measure deviations of a model from a reference, and check its σ
    Compare(compare::CompareArgs),
    /// Convert sensor data into points with covariance
    Sense(sense::SenseArgs),
    /// Identify a contour from range readings; report its dimensions and their σ
    Contour(contour::ContourArgs),
    /// Describe the contents of a file
    Info(info::InfoArgs),
    /// Merge overlapping surface patches into one mesh
    Merge(merge::MergeArgs),
    /// Plan the next measurements: where they reduce σ most
    Next(next::NextArgs),
    /// Deform a mesh to points and silhouettes, and mesh, pose or colour it
    Shell(shell::ShellArgs),
    /// Reconstruct solids from two or three views of a drawing
    Solid(solid::SolidArgs),
    /// Simulate measurements with known ground truth
    Simulate(simulate::SimulateArgs),
    /// Verify that files are whole and consistent
    Verify(verify::VerifyArgs),
    /// Show a file in the browser, or render an image of it
    View(view::ViewArgs),
    /// Print a script for shell completion
    Completions(completions::CompletionsArgs),
    /// Print a page of the manual, or write all pages
    Man(man::ManArgs),
}

fn main() -> ExitCode {
    // First, so that a panic while parsing is announced as well.
    failure::announce_bugs();
    // Not `parse`, which ends the process: a wrong command line also gets its JSON object and the event
    // `finished`.
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => return ExitCode::from(summary::print_parse_error(&e, Cli::command())),
    };
    let code = match cli.command {
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
        Command::Verify(args) => verify::run(&args),
        Command::View(args) => view::run(&args),
        Command::Completions(args) => completions::run(&args, Cli::command()),
        Command::Man(args) => man::run(&args, Cli::command()),
    };
    ExitCode::from(code)
}

#[cfg(test)]
mod tests {
    use super::Cli;
    use clap::CommandFactory;

    #[test]
    fn option_definitions_are_consistent() {
        Cli::command().debug_assert();
    }

    /// Short help is for users who look for one option, so it must fit one screen.
    #[test]
    fn short_help_fits_one_screen() {
        let mut commands = vec![Cli::command()];
        while let Some(mut command) = commands.pop() {
            commands.extend(command.get_subcommands().cloned());
            let help = command.render_help().to_string();
            assert!(help.lines().count() <= 34, "{}", help);
            let has_hidden_options = command.get_arguments().any(|arg| arg.is_hide_short_help_set());
            assert_eq!(has_hidden_options, help.contains("Run with --help for all options."), "{help}");
        }
    }
}
