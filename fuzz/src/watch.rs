//! Watches a worker process and restarts it after the case at which it died or hung.
//!
//! In: a target and a number of cases. Out: a [`Report`], and for every failure the smallest input found that
//! still fails.

use crate::processor_time::Stopwatch;
use crate::worker::{MAX_TIME, Tally, case_bytes};
use planish_fuzz::targets::FuzzTarget;
use planish_fuzz::valid;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Number of deaths after which a target is given up; more are rarely different bugs.
const MAX_CRASHES: usize = 20;
/// Attempts at a repair that leaves a valid file valid.
const MAX_REPAIRS: u64 = 64;
/// Attempts to shorten a failing input.
const MAX_ATTEMPTS: usize = 400;

/// Results of all cases of a target.
pub struct Report {
    /// The sums over all workers.
    pub tally: Tally,
    /// A message and an input file for every different failure.
    pub failures: Vec<(String, PathBuf)>,
}

/// Wall time limit, in multiples of the limit on processor time: ends processes that wait forever.
///
/// A busy machine must not end a healthy process, and a deadlock uses no processor time.
const WALL_TIME_FACTOR: u32 = 12;

/// Waits for a process and returns why it failed.
///
/// The process is ended as hung if `progress` does not change for `limit` of processor time, or for
/// [`WALL_TIME_FACTOR`] times that of wall time.
fn wait(child: &mut Child, limit: Duration, mut progress: impl FnMut() -> u64) -> io::Result<Option<String>> {
    let (mut last, mut since_change) = (progress(), Stopwatch::for_process(child.id()));
    // Short pauses first: shortening an input starts hundreds of processes that end at once.
    let mut pause = Duration::from_millis(1);
    loop {
        // Polling, because the standard library cannot wait with a limit.
        if let Some(status) = child.try_wait()? {
            return Ok((!status.success()).then(|| format!("ended with {status}")));
        }
        std::thread::sleep(pause);
        pause = (2 * pause).min(Duration::from_millis(50));
        let now = progress();
        if now != last {
            (last, since_change) = (now, Stopwatch::for_process(child.id()));
        } else if since_change.elapsed() > limit || since_change.wall_time() > WALL_TIME_FACTOR * limit {
            child.kill()?;
            child.wait()?;
            return Ok(Some(format!("no progress for {limit:?} of processor time")));
        }
    }
}

/// Runs a target's cases in `folder`, and keeps failing inputs under `kept`.
///
/// # Errors
/// When a process cannot be started or a file cannot be written.
pub fn run(target: &FuzzTarget, seed: u64, cases: u64, folder: &Path, kept: &Path) -> io::Result<Report> {
    let files = (target.valid)().map_err(io::Error::other)?;
    // Workers read the valid files from here; making some of them, such as saved models, takes a fit.
    fs::create_dir_all(folder.join("files"))?;
    for (k, bytes) in files.iter().enumerate() {
        fs::write(folder.join(format!("valid-{k}")), bytes)?;
    }
    for (name, bytes) in valid::neighbours().map_err(io::Error::other)? {
        fs::write(folder.join("files").join(name), bytes)?;
    }
    // Every valid file must be accepted, or the damage tests nothing. Repairs of packed formats also damage,
    // so several seeds are tried.
    let path = folder.join("files").join(target.file);
    let mut read = Ok(());
    for bytes in &files {
        for seed in 0..MAX_REPAIRS {
            let mut bytes = bytes.clone();
            (target.repair)(&mut bytes, &mut ChaCha8Rng::seed_from_u64(seed));
            fs::write(&path, bytes)?;
            read = (target.read)(&path);
            if read.is_ok() {
                break;
            }
        }
        read.as_ref().map_err(|e| io::Error::other(e.to_string()))?;
    }
    // A worker runs cases until it dies. The next one continues behind the case that ended it.
    let mut tally = Tally::default();
    let mut crashes: Vec<(u64, String)> = Vec::new();
    let mut from = 0;
    while from < cases && crashes.len() < MAX_CRASHES {
        let mut child = Command::new(std::env::current_exe()?)
            .args(["--seed", &seed.to_string(), "--cases", &cases.to_string(), "--from", &from.to_string()])
            .arg("--worker")
            .arg(folder)
            .arg(target.name)
            .stderr(Stdio::null())
            .spawn()?;
        let file = folder.join("tally");
        // Twice the limit of a case: the worker itself reports cases that are slow but end.
        let crash = wait(&mut child, 2 * MAX_TIME, || Tally::read(&file).case)?;
        let found = Tally::read(&file);
        tally = tally.plus(found);
        match crash {
            None => break,
            Some(crash) => {
                tally.failed += 1;
                crashes.push((found.case, crash));
                from = found.case + 1;
            }
        }
    }
    let mut failures = Vec::new();
    let mut keep = |case: u64, message: String, bytes: Vec<u8>| -> io::Result<()> {
        fs::create_dir_all(kept)?;
        let path = kept.join(format!("{}-{case}.{}", target.name, target.file));
        fs::write(&path, smallest(target, bytes, folder)?)?;
        failures.push((message, path));
        Ok(())
    };
    // The inputs of deaths are computed again; a dying worker could not save them.
    for (case, crash) in crashes {
        keep(case, crash, case_bytes(target, &files, seed, case))?;
    }
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(Ok(case)) = name.strip_prefix("case-").map(str::parse) {
            let message = fs::read_to_string(path.with_extension("txt"))?;
            keep(case, message.replace('\n', " "), fs::read(&path)?)?;
        }
    }
    Ok(Report { tally, failures })
}

/// Returns true if a process that reads this input fails.
fn fails(target: &FuzzTarget, bytes: &[u8], folder: &Path) -> io::Result<bool> {
    let path = folder.join("files").join(target.file);
    fs::write(&path, bytes)?;
    // In a process of its own, because a failure can be a crash.
    let mut child = Command::new(std::env::current_exe()?)
        .arg("--input")
        .arg(&path)
        .arg(target.name)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    Ok(wait(&mut child, MAX_TIME, || 0)?.is_some())
}

/// Removes parts that are not needed for the failure, in ever smaller pieces.
fn smallest(target: &FuzzTarget, mut bytes: Vec<u8>, folder: &Path) -> io::Result<Vec<u8>> {
    let mut attempts = 0;
    let mut length = bytes.len() / 2;
    while length > 0 && attempts < MAX_ATTEMPTS {
        let mut at = 0;
        while at < bytes.len() && attempts < MAX_ATTEMPTS {
            let mut shorter = bytes.clone();
            shorter.drain(at..bytes.len().min(at + length));
            attempts += 1;
            if fails(target, &shorter, folder)? {
                bytes = shorter;
            } else {
                at += length;
            }
        }
        // From halves to single bytes, as delta debugging does (Zeller and Hildebrandt 2002), without its
        // complements.
        length /= 2;
    }
    Ok(bytes)
}
