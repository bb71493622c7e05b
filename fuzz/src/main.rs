//! Tests every reader and whole commands with millions of damaged files: none may panic, hang or exhaust the
//! memory.
//!
//! In: a number of cases and a seed; the same seed gives the same files. Out: one line per reader (numbers of
//! accepted and rejected files, longest time, maximum memory), and for every failure the smallest file that
//! still fails. The exit code is 1 if a reader failed.
//!
//! Not guaranteed: that every line of the readers is reached. The damage knows formats, not code.

mod processor_time;
mod watch;
mod worker;

use cap::Cap;
use clap::Parser;
use planish_fuzz::targets::{COMMANDS, FuzzTarget, TARGETS};
use std::alloc::System;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use worker::{CaseOutcome, MAX_MEMORY};

/// Counts allocations and enforces the memory limit.
#[global_allocator]
static ALLOCATOR: Cap<System> = Cap::new(System, usize::MAX);

/// One case of a command for so many of a reader.
const READER_CASES_PER_COMMAND_CASE: u64 = 100;

/// Test every reader, and commands, with damaged files
#[derive(Debug, Parser)]
#[command(name = "planish-fuzz")]
struct Arguments {
    /// Readers and commands to test [default: all]
    target: Vec<String>,
    /// Number of damaged files per reader; a command gets a hundredth
    #[arg(long, default_value_t = 10_000)]
    cases: u64,
    /// Seed of the damage
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder for files that make a reader fail
    #[arg(long, default_value = "target/fuzz")]
    out: PathBuf,
    /// Read only this file and print the result
    #[arg(long)]
    input: Option<PathBuf>,
    /// Run as a worker in this folder, from case `--from` on
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

/// Runs the command; returns true if no reader failed.
fn run(arguments: &Arguments) -> io::Result<bool> {
    let mut targets: Vec<&FuzzTarget> = Vec::new();
    for name in &arguments.target {
        // Unknown names end the run before any work: a misspelt reader must not count as tested.
        let found = TARGETS.iter().chain(COMMANDS).find(|t| t.name == name);
        targets.push(found.ok_or_else(|| io::Error::other(format!("unknown reader `{name}`")))?);
    }
    if targets.is_empty() {
        targets.extend(TARGETS.iter().chain(COMMANDS));
    }
    // The watching process starts this program again with `--input` or `--worker`.
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

/// Prints what the readers do with a file; returns true if none panicked.
fn one_file(targets: &[&FuzzTarget], path: &Path) -> io::Result<bool> {
    worker::keep_panics();
    // The same limit as in a worker, so that a failing file fails here, too.
    let _ = ALLOCATOR.set_limit(ALLOCATOR.allocated() + MAX_MEMORY);
    let mut good = true;
    for target in targets {
        let result = match worker::outcome(target, path) {
            CaseOutcome::Accepted => "accepted".to_owned(),
            CaseOutcome::Rejected(message) => format!("rejected: {message}"),
            CaseOutcome::Panicked(message) => {
                good = false;
                format!("panicked: {message}")
            }
        };
        writeln!(io::stdout(), "{}: {result}", target.name)?;
    }
    Ok(good)
}

/// Runs all cases of the targets and prints the table; returns true if none failed.
fn all_cases(targets: &[&FuzzTarget], arguments: &Arguments) -> io::Result<bool> {
    // Millions of small files are written: a file system in memory is fastest.
    let memory = Path::new("/dev/shm");
    let scratch = match memory.is_dir() {
        true => tempfile::tempdir_in(memory)?,
        false => tempfile::tempdir()?,
    };
    let mut out = io::stdout().lock();
    writeln!(
        out,
        "{:<11} {:>9} {:>9} {:>9} {:>7} {:>12} {:>11} {:>8}",
        "target", "cases", "accepted", "rejected", "failed", "slowest (ms)", "max. memory", "time (s)"
    )?;
    let mut good = true;
    for target in targets {
        // Wall time, for the user; the limits use processor time.
        let begun = Instant::now();
        let is_command = COMMANDS.iter().any(|command| command.name == target.name);
        let cases = if is_command {
            arguments.cases.div_ceil(READER_CASES_PER_COMMAND_CASE)
        } else {
            arguments.cases
        };
        let report =
            watch::run(target, arguments.seed, cases, &scratch.path().join(target.name), &arguments.out)?;
        let tally = report.tally;
        writeln!(
            out,
            "{:<11} {:>9} {:>9} {:>9} {:>7} {:>12.1} {:>7.1} MiB {:>8.1}",
            target.name,
            tally.accepted + tally.rejected + tally.failed,
            tally.accepted,
            tally.rejected,
            tally.failed,
            tally.slowest.0 as f64 / 1e3,
            tally.memory as f64 / f64::from(1 << 20),
            begun.elapsed().as_secs_f64()
        )?;
        for (message, path) in &report.failures {
            good = false;
            writeln!(out, "  {}: {message}", path.display())?;
        }
        // A run with many cases takes long: each line appears when its reader is done.
        out.flush()?;
    }
    Ok(good)
}
