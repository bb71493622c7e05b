//! Runs the cases of one target in a separate process, which may run out of memory or stack.
//!
//! In: a target, a seed and a range of cases. Out: a [`Tally`] in a file, and one file for every input that
//! made a reader panic. The tally is written before every case, so that the watching process knows which case
//! ended the worker.

use crate::ALLOCATOR;
use crate::processor_time::Stopwatch;
use planish_fuzz::mutate::damaged;
use planish_fuzz::targets::FuzzTarget;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::time::Duration;

/// Memory limit of a case, in bytes, in addition to that of the idle process.
///
/// The test files have some kilobytes. A reader that needs more memory trusts a length in the file.
pub const MAX_MEMORY: usize = 256 << 20;
/// Limit on the processor time of a case.
///
/// Wall time is not limited here: it depends on the load of the machine.
pub const MAX_TIME: Duration = Duration::from_secs(5);
/// Number of panics at different places that are kept as files; more are rarely different bugs.
const MAX_PANICS: usize = 20;

/// Progress and results of a worker.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of the current case.
    pub case: u64,
    /// Number of files that were read completely.
    pub accepted: u64,
    /// Number of files that were rejected with an error.
    pub rejected: u64,
    /// Longest processor time, in microseconds, and the number of its case.
    pub slowest: (u64, u64),
    /// Maximum allocated memory, in bytes, in addition to that of the idle process.
    pub memory: u64,
    /// Number of cases that panicked or exceeded the time limit.
    pub failed: u64,
}

impl Tally {
    /// The numbers in the order of the file.
    fn words(&self) -> [u64; 7] {
        let (time, at) = self.slowest;
        [self.case, self.accepted, self.rejected, time, at, self.memory, self.failed]
    }

    /// The last tally that a worker wrote; zeros if there is none.
    pub fn read(path: &Path) -> Self {
        let bytes = fs::read(path).unwrap_or_default();
        let mut words = [0; 7];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        let [case, accepted, rejected, time, at, memory, failed] = words;
        Self { case, accepted, rejected, slowest: (time, at), memory, failed }
    }

    /// The sums of both; the case of the later one.
    pub fn plus(self, later: Self) -> Self {
        Self {
            case: later.case,
            accepted: self.accepted + later.accepted,
            rejected: self.rejected + later.rejected,
            slowest: self.slowest.max(later.slowest),
            memory: self.memory.max(later.memory),
            failed: self.failed + later.failed,
        }
    }
}

/// The bytes of a case. They depend only on the target, the seed and the case number.
pub fn case_bytes(target: &FuzzTarget, valid: &[Vec<u8>], seed: u64, case: u64) -> Vec<u8> {
    // The name is part of the seed (FNV-1), so that readers of one format get different damage.
    let name = target.name.bytes().fold(seed, |h, b| h.wrapping_mul(0x100_0000_01b3) ^ u64::from(b));
    let mut random = ChaCha8Rng::seed_from_u64(name ^ case.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut bytes = damaged(valid, target.words, &mut random);
    (target.repair)(&mut bytes, &mut random);
    bytes
}

/// Result of reading a file.
pub enum CaseOutcome {
    /// The file was read.
    Accepted,
    /// The file was rejected with this error message.
    Rejected(String),
    /// The reader panicked; the message includes the source location.
    Panicked(String),
}

// A hook has no access to the caller of `catch_unwind`, so the message goes through the thread.
thread_local! {
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Stores the messages of panics instead of printing them.
pub fn keep_panics() {
    panic::set_hook(Box::new(|info| PANIC.set(info.to_string())));
}

/// Reads a file with the reader of the target.
pub fn outcome(target: &FuzzTarget, path: &Path) -> CaseOutcome {
    match panic::catch_unwind(AssertUnwindSafe(|| (target.read)(path))) {
        Ok(Ok(())) => CaseOutcome::Accepted,
        Ok(Err(e)) => CaseOutcome::Rejected(e.to_string()),
        Err(_) => CaseOutcome::Panicked(PANIC.take()),
    }
}

/// Reads the cases `from..to`.
///
/// `folder` holds the tally, the valid files (`valid-N`) and the working folder `files`.
///
/// # Errors
/// When a file in `folder` cannot be read or written.
pub fn work(target: &FuzzTarget, seed: u64, (from, to): (u64, u64), folder: &Path) -> io::Result<()> {
    let mut valid = Vec::new();
    while let Ok(bytes) = fs::read(folder.join(format!("valid-{}", valid.len()))) {
        valid.push(bytes);
    }
    let kept = File::create(folder.join("tally"))?;
    let path = folder.join("files").join(target.file);
    let mut tally = Tally::default();
    let mut locations = BTreeSet::new();
    let idle = ALLOCATOR.allocated();
    // The allocator aborts the process beyond the limit. Setting it fails only if it is set already.
    let _ = ALLOCATOR.set_limit(idle + MAX_MEMORY);
    for case in from..to {
        tally.case = case;
        tally.memory = ALLOCATOR.max_allocated().saturating_sub(idle) as u64;
        kept.write_all_at(tally.words().map(u64::to_le_bytes).as_flattened(), 0)?;
        let bytes = case_bytes(target, &valid, seed, case);
        fs::write(&path, &bytes)?;
        // Writing the file is not part of the time of the reader.
        let stopwatch = Stopwatch::for_this_thread();
        let outcome = outcome(target, &path);
        let time = stopwatch.elapsed();
        tally.slowest = tally.slowest.max((time.as_micros() as u64, case));
        let failure = match outcome {
            CaseOutcome::Accepted => {
                tally.accepted += 1;
                None
            }
            CaseOutcome::Rejected(_) => {
                tally.rejected += 1;
                None
            }
            CaseOutcome::Panicked(message) => Some(message),
        };
        let slow = (time > MAX_TIME).then(|| format!("took {time:?} of processor time"));
        if let Some(failure) = failure.or(slow) {
            tally.failed += 1;
            // The first line names the source location: one file per location is enough.
            let location = failure.lines().next().unwrap_or_default().to_owned();
            if locations.len() < MAX_PANICS && locations.insert(location) {
                fs::write(folder.join(format!("case-{case}")), &bytes)?;
                fs::write(folder.join(format!("case-{case}.txt")), &failure)?;
            }
        }
    }
    tally.case = to;
    tally.memory = ALLOCATOR.max_allocated().saturating_sub(idle) as u64;
    kept.write_all_at(tally.words().map(u64::to_le_bytes).as_flattened(), 0)
}
