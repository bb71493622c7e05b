//! `planish man`: pages of the manual in roff, generated from the definitions of the options.

use crate::summary::print_document;
use clap::{Args, ValueHint};
use planish::output::write_files;
use planish::{Error, Result};
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  planish man
  planish man fit
  planish man simulate scene scans
  planish man --out man1

A page goes to stdout in roff; `planish man fit | man -l -` shows it. With --out, each command gets a file: \
planish.1, planish-fit.1 and so on. The command `man` finds them in ~/.local/share/man/man1.";

/// Arguments of `planish man`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ManArgs {
    /// Command whose page is printed [default: the page of planish]
    #[arg(value_name = "COMMAND")]
    command: Vec<String>,
    /// Write all pages to this folder
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath, conflicts_with = "command")]
    out: Option<PathBuf>,
}

/// Prints the page of a command, or writes all pages to a folder; returns the exit code.
pub fn run(args: &ManArgs, mut command: clap::Command) -> u8 {
    // Building sets the full names of subcommands, such as `planish-fit`.
    command.build();
    let text = match &args.out {
        None => named(command, &args.command).and_then(page),
        Some(folder) => write_pages(folder, command).map(|()| Vec::new()),
    };
    print_document("man", text)
}

/// The subcommand with this name, such as `["simulate", "scene"]`.
fn named(mut command: clap::Command, names: &[String]) -> Result<clap::Command> {
    for name in names {
        command = command.find_subcommand(name).cloned().ok_or_else(|| {
            let known: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
            match known.is_empty() {
                true => Error::input(format!(
                    "expected a command without subcommands after {}, found `{name}`",
                    command.get_name()
                )),
                false => Error::input(format!("expected one of {}, found `{name}`", known.join(", "))),
            }
        })?;
    }
    Ok(command)
}

/// The page of one command in roff.
fn page(command: clap::Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command)
        .manual("Planish")
        .render(&mut page)
        .map_err(|e| Error::io("a page of the manual could not be generated").with_source(e))?;
    Ok(page)
}

/// Writes `planish.1`, `planish-fit.1`, `planish-simulate-scene-scans.1` and so on.
fn write_pages(folder: &Path, command: clap::Command) -> Result<()> {
    let mut waiting = vec![command];
    let mut files = Vec::new();
    while let Some(command) = waiting.pop() {
        // clap adds a command `help` to each command; it has no page.
        let inner = command.get_subcommands().filter(|c| c.get_name() != "help");
        waiting.extend(inner.cloned());
        let name = command.get_display_name().unwrap_or_else(|| command.get_name());
        let file = format!("{name}.1");
        files.push((file, page(command)?));
    }
    // Every page is made before the first one is written, so an error leaves no incomplete set.
    write_files(folder, &files)
}
