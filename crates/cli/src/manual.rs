//! `planish completions` and `planish man`: what shells and manuals know of the command line, made from the
//! command line itself.

use crate::args::{Cli, CompletionsArgs, ManArgs};
use crate::failure;
use clap::CommandFactory;
use planish::output::write_files;
use planish::{Error, Result};
use std::io::Write;
use std::path::Path;

/// Writes a completion script on stdout; returns the exit code.
pub fn completions(args: &CompletionsArgs) -> u8 {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "planish", &mut script);
    outcome("completions", print(&script))
}

/// Writes the manual's first page on stdout, or all of its pages into a folder; returns the exit code.
pub fn man(args: &ManArgs) -> u8 {
    outcome(
        "man",
        match &args.out {
            None => page(Cli::command()).and_then(|page| print(&page)),
            Some(folder) => pages(folder),
        },
    )
}

fn outcome(name: &str, done: Result<()>) -> u8 {
    match done {
        Ok(()) => 0,
        Err(e) => {
            failure::print(&e, name);
            e.kind().exit_code()
        }
    }
}

fn print(bytes: &[u8]) -> Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
        // The reader has seen enough (`planish man | head`).
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::io("nothing could be printed").with_source(e))
        }
        _ => Ok(()),
    }
}

/// A page in roff.
fn page(command: clap::Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command)
        .manual("Planish")
        .render(&mut page)
        .map_err(|e| Error::io("a page of the manual could not be made").with_source(e))?;
    Ok(page)
}

/// `planish.1`, `planish-fit.1`, `planish-simulate-scene-scans.1` and so on.
fn pages(folder: &Path) -> Result<()> {
    let mut command = Cli::command();
    // The names of subcommands are whole once it is built: `planish-fit`.
    command.build();
    let mut waiting = vec![command];
    let mut files = Vec::new();
    while let Some(command) = waiting.pop() {
        let inner = command.get_subcommands().filter(|c| c.get_name() != "help");
        waiting.extend(inner.cloned());
        let name = command.get_display_name().unwrap_or_else(|| command.get_name());
        let file = format!("{name}.1");
        files.push((file, page(command)?));
    }
    write_files(folder, &files)
}
