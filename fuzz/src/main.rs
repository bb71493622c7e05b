//! Damaged files by the million, for every reader: none may panic, stand still, or take the memory.
//!
//! Comes in: a number of cases and a seed; the same seed gives the same files. Goes out: a line for each
//! reader (how many files it took and refused, the slowest, the most memory), and for every failure the
//! smallest file that still fails. The exit code is 1 when there was any.
//!
//! Not guaranteed: that every line of the readers was reached. The damage knows formats, not code.

mod mutate;
mod targets;
mod valid;
mod watch;
mod worker;

use cap::Cap;
use clap::Parser;
use std::alloc::System;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use targets::{TARGETS, Target};
use worker::{MOST_MEMORY, Outcome};

/// Counts what is allocated, and gives no more than the limit.
#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

/// Feed every reader with damaged files.
#[derive(Debug, Parser)]
#[command(name = "planish-fuzz")]
struct Arguments {
    /// Readers to feed [default: all]
    target: Vec<String>,
    /// Files for each of them
    #[arg(long, default_value_t = 10_000)]
    cases: u64,
    /// Seed of the damage
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for files that break a reader
    #[arg(long, default_value = "target/fuzz")]
    out: PathBuf,
    /// Read this one file instead, and say what came of it
    #[arg(long)]
    input: Option<PathBuf>,
    /// Work on the cases from `--from` on in this folder
    #[arg(long, hide = true)]
    worker: Option<PathBuf>,
    #[arg(long, hide = true, default_value_t = 0)]
    from: u64,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            let _ = writeln!(io::stderr(), "planish-fuzz: {e}");
            ExitCode::from(2)
        }
    }
}

/// Whether nothing failed.
fn run(arguments: &Arguments) -> io::Result<bool> {
    let mut targets: Vec<&Target> = Vec::new();
    for name in &arguments.target {
        let found = TARGETS.iter().find(|t| t.name == name);
        targets.push(found.ok_or_else(|| io::Error::other(format!("no reader is called `{name}`")))?);
    }
    if targets.is_empty() {
        targets.extend(TARGETS);
    }
    if let Some(path) = &arguments.input {
        return one_file(&targets, path);
    }
    if let Some(folder) = &arguments.worker {
        worker::keep_panics();
        for target in targets {
            worker::work(target, arguments.seed, (arguments.from, arguments.cases), folder)?;
        }
        return Ok(true);
    }
    all_cases(&targets, arguments)
}

/// Says what the readers do with a file.
fn one_file(targets: &[&Target], path: &Path) -> io::Result<bool> {
    worker::keep_panics();
    let _ = ALLOCATOR.set_limit(ALLOCATOR.allocated() + MOST_MEMORY);
    let mut good = true;
    for target in targets {
        let said = match worker::outcome(target, path) {
            Outcome::Accepted => "accepted".to_owned(),
            Outcome::Refused(message) => format!("refused: {message}"),
            Outcome::Panicked(message) => {
                good = false;
                format!("panicked: {message}")
            }
        };
        writeln!(io::stdout(), "{}: {said}", target.name)?;
    }
    Ok(good)
}

fn all_cases(targets: &[&Target], arguments: &Arguments) -> io::Result<bool> {
    // Memory is the fastest disk.
    let memory = Path::new("/dev/shm");
    let scratch = match memory.is_dir() {
        true => tempfile::tempdir_in(memory)?,
        false => tempfile::tempdir()?,
    };
    let mut out = io::stdout().lock();
    writeln!(
        out,
        "{:<10} {:>9} {:>9} {:>9} {:>7} {:>12} {:>11} {:>8}",
        "reader", "cases", "accepted", "refused", "failed", "slowest (ms)", "most memory", "time (s)"
    )?;
    let mut good = true;
    for target in targets {
        let begun = Instant::now();
        let report = watch::run(
            target,
            arguments.seed,
            arguments.cases,
            &scratch.path().join(target.name),
            &arguments.out,
        )?;
        let tally = report.tally;
        writeln!(
            out,
            "{:<10} {:>9} {:>9} {:>9} {:>7} {:>12.1} {:>7.1} MiB {:>8.1}",
            target.name,
            tally.accepted + tally.refused + tally.failed,
            tally.accepted,
            tally.refused,
            tally.failed,
            tally.slowest.0 as f64 / 1e3,
            tally.memory as f64 / f64::from(1 << 20),
            begun.elapsed().as_secs_f64()
        )?;
        for (message, path) in &report.failures {
            good = false;
            writeln!(out, "  {}: {message}", path.display())?;
        }
        out.flush()?;
    }
    Ok(good)
}
