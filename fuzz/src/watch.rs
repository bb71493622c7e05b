//! Watching a worker: what it found, and the case at which it died or stood still.
//!
//! Comes in: a target and a number of cases. Goes out: a [`Report`], and for every failure the smallest input
//! found that still fails.

use crate::targets::Target;
use crate::valid;
use crate::worker::{MOST_TIME, Tally, case_bytes};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Workers that die more often than this are one bug.
const MOST_DEATHS: usize = 20;
/// Attempts at mending a valid file so that it is one.
const MOST_MENDED: u64 = 64;
/// Attempts at a smaller input.
const MOST_ATTEMPTS: usize = 400;

/// What came of a target's cases.
pub struct Report {
    /// The sums.
    pub tally: Tally,
    /// A message and a file for every way to fail.
    pub failures: Vec<(String, PathBuf)>,
}

/// Waits for a process; after `most` without a change of what `watched` gives it is ended, and said to hang.
fn wait(child: &mut Child, most: Duration, mut watched: impl FnMut() -> u64) -> io::Result<Option<String>> {
    let (mut last, mut changed) = (watched(), Instant::now());
    let mut pause = Duration::from_millis(1);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok((!status.success()).then(|| format!("ended with {status}")));
        }
        std::thread::sleep(pause);
        pause = (2 * pause).min(Duration::from_millis(50));
        let now = watched();
        if now != last {
            (last, changed) = (now, Instant::now());
        } else if changed.elapsed() > most {
            child.kill()?;
            child.wait()?;
            return Ok(Some(format!("took more than {most:?}")));
        }
    }
}

/// Runs a target's cases in `folder`, and keeps failing inputs under `kept`.
///
/// # Errors
/// When a process cannot be started or a file of ours cannot be written.
pub fn run(target: &Target, seed: u64, cases: u64, folder: &Path, kept: &Path) -> io::Result<Report> {
    let files = (target.valid)().map_err(io::Error::other)?;
    fs::create_dir_all(folder.join("files"))?;
    for (k, bytes) in files.iter().enumerate() {
        fs::write(folder.join(format!("valid-{k}")), bytes)?;
    }
    for (name, bytes) in valid::neighbours().map_err(io::Error::other)? {
        fs::write(folder.join("files").join(name), bytes)?;
    }
    // What is mended is packed too, and may be damaged on the way.
    let path = folder.join("files").join(target.file);
    let mut read = Ok(());
    for bytes in &files {
        for seed in 0..MOST_MENDED {
            let mut bytes = bytes.clone();
            (target.mend)(&mut bytes, &mut ChaCha8Rng::seed_from_u64(seed));
            fs::write(&path, bytes)?;
            read = (target.read)(&path);
            if read.is_ok() {
                break;
            }
        }
        read.as_ref().map_err(|e| io::Error::other(e.to_string()))?;
    }
    let mut tally = Tally::default();
    let mut deaths: Vec<(u64, String)> = Vec::new();
    let mut from = 0;
    while from < cases && deaths.len() < MOST_DEATHS {
        let mut child = Command::new(std::env::current_exe()?)
            .args(["--seed", &seed.to_string(), "--cases", &cases.to_string(), "--from", &from.to_string()])
            .arg("--worker")
            .arg(folder)
            .arg(target.name)
            .stderr(Stdio::null())
            .spawn()?;
        let file = folder.join("tally");
        let death = wait(&mut child, 2 * MOST_TIME, || Tally::read(&file).case)?;
        let found = Tally::read(&file);
        tally = tally.and(found);
        match death {
            None => break,
            Some(death) => {
                tally.failed += 1;
                deaths.push((found.case, death));
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
    for (case, death) in deaths {
        keep(case, death, case_bytes(target, &files, seed, case))?;
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

/// Whether a process that reads this input fails.
fn fails(target: &Target, bytes: &[u8], folder: &Path) -> io::Result<bool> {
    let path = folder.join("files").join(target.file);
    fs::write(&path, bytes)?;
    let mut child = Command::new(std::env::current_exe()?)
        .arg("--input")
        .arg(&path)
        .arg(target.name)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    Ok(wait(&mut child, MOST_TIME, || 0)?.is_some())
}

/// Leaves out whatever need not be there, in ever smaller pieces.
fn smallest(target: &Target, mut bytes: Vec<u8>, folder: &Path) -> io::Result<Vec<u8>> {
    let mut attempts = 0;
    let mut piece = bytes.len() / 2;
    while piece > 0 && attempts < MOST_ATTEMPTS {
        let mut at = 0;
        while at < bytes.len() && attempts < MOST_ATTEMPTS {
            let mut shorter = bytes.clone();
            shorter.drain(at..bytes.len().min(at + piece));
            attempts += 1;
            if fails(target, &shorter, folder)? {
                bytes = shorter;
            } else {
                at += piece;
            }
        }
        piece /= 2;
    }
    Ok(bytes)
}
