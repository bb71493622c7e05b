//! The cases of one target, in a process of their own: what runs out of memory or stack takes nobody else
//! along.
//!
//! Comes in: a target, a seed and a range of cases. Goes out: a [`Tally`] in a file, renewed before every
//! case, so that whoever watches knows the case that was the last one; and a file for every input that made a
//! reader panic.

use crate::ALLOCATOR;
use crate::mutate::damaged;
use crate::targets::Target;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::time::{Duration, Instant};

/// Memory that a case may take beyond what the process has when it begins.
pub const MOST_MEMORY: usize = 256 << 20;
/// Time that a case may take.
pub const MOST_TIME: Duration = Duration::from_secs(5);
/// Panics at more places than this are one bug.
const MOST_PANICS: usize = 20;

/// Where a worker stands.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// The case that is being read.
    pub case: u64,
    /// How many were read to their end.
    pub accepted: u64,
    /// How many were refused with a message.
    pub refused: u64,
    /// The longest time, in microseconds, and the case that took it.
    pub slowest: (u64, u64),
    /// The most memory that was ever taken, in bytes, beyond that of an idle process.
    pub memory: u64,
    /// How many cases made a reader panic, or took too long.
    pub failed: u64,
}

impl Tally {
    fn words(&self) -> [u64; 7] {
        let (time, at) = self.slowest;
        [self.case, self.accepted, self.refused, time, at, self.memory, self.failed]
    }

    /// Where a worker stood last.
    pub fn read(path: &Path) -> Self {
        let bytes = fs::read(path).unwrap_or_default();
        let mut words = [0; 7];
        for (word, bytes) in words.iter_mut().zip(bytes.as_chunks::<8>().0) {
            *word = u64::from_le_bytes(*bytes);
        }
        let [case, accepted, refused, time, at, memory, failed] = words;
        Self { case, accepted, refused, slowest: (time, at), memory, failed }
    }

    /// Both together; the case is the later one.
    pub fn and(self, later: Self) -> Self {
        Self {
            case: later.case,
            accepted: self.accepted + later.accepted,
            refused: self.refused + later.refused,
            slowest: self.slowest.max(later.slowest),
            memory: self.memory.max(later.memory),
            failed: self.failed + later.failed,
        }
    }
}

/// The bytes of a case: the same in every run.
pub fn case_bytes(target: &Target, valid: &[Vec<u8>], seed: u64, case: u64) -> Vec<u8> {
    let name = target.name.bytes().fold(seed, |h, b| h.wrapping_mul(0x100_0000_01b3) ^ u64::from(b));
    let mut random = ChaCha8Rng::seed_from_u64(name ^ case.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut bytes = damaged(valid, target.words, &mut random);
    (target.mend)(&mut bytes, &mut random);
    bytes
}

/// What a reader did with a file.
pub enum Outcome {
    /// It was read.
    Accepted,
    /// It was refused, in these words.
    Refused(String),
    /// The reader panicked: the message and its place.
    Panicked(String),
}

thread_local! {
    static PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Keeps panics' messages instead of printing them.
pub fn keep_panics() {
    panic::set_hook(Box::new(|info| PANIC.set(info.to_string())));
}

/// Reads a file.
pub fn outcome(target: &Target, path: &Path) -> Outcome {
    match panic::catch_unwind(AssertUnwindSafe(|| (target.read)(path))) {
        Ok(Ok(())) => Outcome::Accepted,
        Ok(Err(e)) => Outcome::Refused(e.to_string()),
        Err(_) => Outcome::Panicked(PANIC.take()),
    }
}

/// Reads the cases `from..to`; `folder` holds the tally, the valid files (`valid-N`) and a folder `files` to
/// work in.
///
/// # Errors
/// When a file of its own cannot be read or written, which is no case's fault.
pub fn work(target: &Target, seed: u64, (from, to): (u64, u64), folder: &Path) -> io::Result<()> {
    let mut valid = Vec::new();
    while let Ok(bytes) = fs::read(folder.join(format!("valid-{}", valid.len()))) {
        valid.push(bytes);
    }
    let kept = File::create(folder.join("tally"))?;
    let path = folder.join("files").join(target.file);
    let mut tally = Tally::default();
    let mut places = BTreeSet::new();
    let idle = ALLOCATOR.allocated();
    // Whoever asks for more is killed by the allocator: a limit that cannot be set is one that was set
    // before.
    let _ = ALLOCATOR.set_limit(idle + MOST_MEMORY);
    for case in from..to {
        tally.case = case;
        tally.memory = ALLOCATOR.max_allocated().saturating_sub(idle) as u64;
        kept.write_all_at(tally.words().map(u64::to_le_bytes).as_flattened(), 0)?;
        let bytes = case_bytes(target, &valid, seed, case);
        fs::write(&path, &bytes)?;
        let begun = Instant::now();
        let outcome = outcome(target, &path);
        let time = begun.elapsed();
        tally.slowest = tally.slowest.max((time.as_micros() as u64, case));
        let complaint = match outcome {
            Outcome::Accepted => {
                tally.accepted += 1;
                None
            }
            Outcome::Refused(_) => {
                tally.refused += 1;
                None
            }
            Outcome::Panicked(message) => Some(message),
        };
        let slow = (time > MOST_TIME).then(|| format!("took {time:?}"));
        if let Some(complaint) = complaint.or(slow) {
            tally.failed += 1;
            // The place is enough to tell one bug from another.
            let place = complaint.lines().next().unwrap_or_default().to_owned();
            if places.len() < MOST_PANICS && places.insert(place) {
                fs::write(folder.join(format!("case-{case}")), &bytes)?;
                fs::write(folder.join(format!("case-{case}.txt")), &complaint)?;
            }
        }
    }
    tally.case = to;
    tally.memory = ALLOCATOR.max_allocated().saturating_sub(idle) as u64;
    kept.write_all_at(tally.words().map(u64::to_le_bytes).as_flattened(), 0)
}
