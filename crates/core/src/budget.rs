//! Limits on the memory that an input may take.
//!
//! In: the size of an input, and each amount of memory before it is used. Out: an error as soon as a limit
//! would be exceeded. There are two limits:
//!
//! - *Of the process* ([`max_memory`]): what the user states, or three quarters of the memory of the machine.
//! - *Of one input* ([`Budget::of_compressed`]): in proportion to its size, for inputs whose size does not
//!   bound what they describe (compressed files, pictures, entities, placed copies). It is not applied if the
//!   user states a limit of the process.
//!
//! The limit of an input counts what readers take, so the same input gives the same answer on every machine.
//! There is no limit of time, because it would depend on the machine, too: time follows from the number of
//! elements, and these take memory.
//!
//! Not guaranteed: memory that code takes without asking is noticed only at the next request
//! ([`check_memory`]), and only on Linux.

use crate::error::{Error, Result};
use crate::setting::Setting;
use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// Memory that any single input may take, in bytes.
///
/// A picture of 24 megapixels in colour takes 288 MB, so this must be larger. With it, a hostile file of up
/// to 24 MB stays below 512 MB, the goal for such files (see `docs/hostile-inputs.md`).
const MIN_INPUT_BYTES: u64 = 384 << 20;
/// Share of the memory of the machine that is used without a stated limit: three quarters, as a quotient. The
/// rest is for the system and for code that does not ask.
const SHARE_OF_MACHINE: (u64, u64) = (3, 4);
/// Memory after which the size of the process is examined again. A smaller step would slow down readers of
/// large files; a larger one would notice the limit later.
const EXAMINED_BYTES: u64 = 16 << 20;

/// The limit that the user states, in bytes; 0 for none.
static STATED: AtomicU64 = AtomicU64::new(0);

/// States the maximum memory of the process in bytes; `None` restores the default.
///
/// It is a property of the process, as the number of threads is, so it is stated once for all jobs.
pub fn set_max_memory(bytes: Option<u64>) {
    STATED.store(bytes.unwrap_or(0), Ordering::Relaxed);
}

/// The memory that the user allows, if stated.
fn stated() -> Option<u64> {
    Some(STATED.load(Ordering::Relaxed)).filter(|bytes| *bytes > 0)
}

/// Maximum memory of the process in bytes: the stated one, or three quarters of what the machine, its
/// container and its resource limits allow. `u64::MAX` if none of these is known.
///
/// # Examples
/// ```
/// assert!(planish_core::budget::max_memory() > 1 << 20);
/// ```
#[must_use]
pub fn max_memory() -> u64 {
    static MACHINE: OnceLock<u64> = OnceLock::new();
    stated().unwrap_or_else(|| *MACHINE.get_or_init(|| share(machine::memory())))
}

/// The part of the memory of a machine that is used.
fn share(machine: Option<u64>) -> u64 {
    machine.map_or(u64::MAX, |bytes| bytes / SHARE_OF_MACHINE.1 * SHARE_OF_MACHINE.0)
}

/// Rejects work that would bring the process above [`max_memory`] if it took `more` bytes.
///
/// # Errors
/// `Unsupported` if it would. The message names both sizes.
pub fn check_memory(more: u64) -> Result<()> {
    let max = max_memory();
    let needed = machine::used().saturating_add(more);
    match needed > max {
        true => Err(Error::unsupported(format!(
            "expected to need at most {} of memory, found {}: use less data or state a larger maximum",
            size(max),
            size(needed)
        ))
        .with_setting(Setting::MaxMemory)),
        false => Ok(()),
    }
}

/// The memory that one input may take, and how much of it is taken. Clones share it.
///
/// # Examples
/// A compressed file of 1000 bytes may not describe a billion points, but a plain file may be of any size:
/// ```
/// use planish_core::budget::Budget;
/// let bomb = Budget::of_compressed(1000, 16);
/// let error = bomb.take_elements(1_000_000_000, 24, "points").unwrap_err();
/// assert!(error.to_string().contains("1000000000 points"));
/// assert!(Budget::of_process().take_elements(1_000_000, 24, "points").is_ok());
/// ```
#[derive(Debug, Clone)]
pub struct Budget {
    state: Arc<State>,
}

impl Default for Budget {
    /// The budget of the process.
    fn default() -> Self {
        Self::of_process()
    }
}

#[derive(Debug)]
struct State {
    /// Maximum in bytes.
    max: u64,
    /// Size of the input, if it decides the maximum.
    input: Option<u64>,
    taken: AtomicU64,
    /// Value of `taken` at which the process is examined again.
    examine_at: AtomicU64,
}

impl Budget {
    /// The budget of an input of `length` bytes whose content may be larger: `ratio` bytes of memory per
    /// byte, and at least 384 MiB. If the user states a maximum of the process, only that one applies.
    ///
    /// Readers choose the ratio so that it exceeds what measurements of their format take.
    #[must_use]
    pub fn of_compressed(length: u64, ratio: u64) -> Self {
        match stated() {
            Some(_) => Self::of_process(),
            None => Self::with(length.saturating_mul(ratio).max(MIN_INPUT_BYTES), Some(length)),
        }
    }

    /// The budget of an input whose size bounds what it describes: limited only by [`max_memory`].
    #[must_use]
    pub fn of_process() -> Self {
        Self::with(u64::MAX, None)
    }

    /// A budget of `max` bytes for an input of `length` bytes, whatever the user states.
    #[must_use]
    pub fn with_max(max: u64, length: u64) -> Self {
        Self::with(max, Some(length))
    }

    fn with(max: u64, input: Option<u64>) -> Self {
        let (taken, examine_at) = (AtomicU64::new(0), AtomicU64::new(EXAMINED_BYTES));
        Self { state: Arc::new(State { max, input, taken, examine_at }) }
    }

    /// Takes memory for a number of elements of `bytes` each; `what` names them in the plural.
    ///
    /// # Errors
    /// `Unsupported` if more than the budget is taken, or the process would exceed [`max_memory`]. The budget
    /// is then used up.
    #[inline]
    pub fn take_elements(&self, count: u64, bytes: u64, what: impl Display) -> Result<()> {
        let wanted = count.saturating_mul(bytes);
        // Relaxed, because no other memory depends on these counts. Saturation is not needed: every sum that
        // could overflow is rejected before it grows further.
        let before = self.state.taken.fetch_add(wanted.min(u64::MAX / 4), Ordering::Relaxed);
        let after = before.saturating_add(wanted);
        // A saturated sum exceeds every limit, also that of a machine whose memory is not known.
        if after > self.state.max || after == u64::MAX {
            return Err(self.exceeded(count, &what));
        }
        if after < self.state.examine_at.load(Ordering::Relaxed) {
            return Ok(());
        }
        self.state.examine_at.store(after.saturating_add(EXAMINED_BYTES), Ordering::Relaxed);
        check_memory(wanted).map_err(|e| e.in_context(&what))
    }

    /// Number of further elements of `bytes` each that the budget allows. It limits what readers reserve in
    /// advance.
    #[must_use]
    pub fn left(&self, bytes: u64) -> u64 {
        let taken = self.state.taken.load(Ordering::Relaxed);
        self.state.max.min(max_memory()).saturating_sub(taken) / bytes.max(1)
    }

    #[cold]
    fn exceeded(&self, count: u64, what: &dyn Display) -> Error {
        let of = match self.state.input {
            Some(length) => format!("an input of {}", size(length)),
            None => "the input".to_owned(),
        };
        // A count of one belongs to a request inside a loop, where it says nothing.
        let found = if count > 1 { format!("{count} {what}") } else { format!("more {what}") };
        Error::unsupported(format!(
            "expected {of} to take at most {} of memory, found {found}: the input is probably damaged; if it \
             is valid, state the maximum memory",
            size(self.state.max)
        ))
        .with_setting(Setting::MaxMemory)
    }
}

/// A number of bytes for messages.
fn size(bytes: u64) -> String {
    match bytes {
        0..10_000 => format!("{bytes} bytes"),
        10_000..10_000_000 => format!("{} kB", bytes / 1000),
        10_000_000..10_000_000_000 => format!("{} MB", bytes / 1_000_000),
        _ => format!("{} GB", bytes / 1_000_000_000),
    }
}

/// What the operating system says of memory.
mod machine {
    use std::fs::read_to_string;
    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::time::Instant;

    /// Maximum age of the size of the process in milliseconds. Reading it takes about 20 µs, which some loops
    /// cannot afford in every round; in this time a process grows by some 10 MB.
    const STALE_MS: u64 = 5;

    /// Memory that the process may use: of the machine, its container, and its resource limits.
    pub(super) fn memory() -> Option<u64> {
        let file = |path: &str| read_to_string(path).unwrap_or_default();
        let number = |text: String| text.trim().parse().ok();
        [
            kilobytes(&file("/proc/meminfo"), "MemTotal:"),
            // Control groups, versions 2 and 1. Without a limit they hold `max`, or a number beyond any
            // memory.
            number(file("/sys/fs/cgroup/memory.max")),
            number(file("/sys/fs/cgroup/memory/memory.limit_in_bytes")),
            // `ulimit -v`: beyond it, allocations fail, which would end the process without a message.
            soft_limit(&file("/proc/self/limits"), "Max address space"),
        ]
        .into_iter()
        .flatten()
        .min()
    }

    /// Memory that the process uses now, as of at most [`STALE_MS`] ago.
    pub(super) fn used() -> u64 {
        static BEGUN: OnceLock<Instant> = OnceLock::new();
        static READ_AT_MS: AtomicU64 = AtomicU64::new(0);
        static USED: AtomicU64 = AtomicU64::new(0);
        let now = BEGUN.get_or_init(Instant::now).elapsed().as_millis() as u64 + STALE_MS;
        // A race between threads only reads the size twice.
        if now >= READ_AT_MS.load(Ordering::Relaxed) + STALE_MS {
            let status = read_to_string("/proc/self/status").unwrap_or_default();
            USED.store(kilobytes(&status, "VmRSS:").unwrap_or(0), Ordering::Relaxed);
            READ_AT_MS.store(now, Ordering::Relaxed);
        }
        USED.load(Ordering::Relaxed)
    }

    /// The value of a line such as `MemTotal:  16316412 kB`, in bytes.
    pub(super) fn kilobytes(text: &str, key: &str) -> Option<u64> {
        let value = text.lines().find_map(|line| line.strip_prefix(key))?;
        value.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.checked_mul(1024)
    }

    /// The soft limit of a line such as `Max address space  unlimited  unlimited  bytes`.
    pub(super) fn soft_limit(text: &str, key: &str) -> Option<u64> {
        let values = text.lines().find_map(|line| line.strip_prefix(key))?;
        values.split_whitespace().next()?.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_budget_is_shared_by_its_clones_and_ends() {
        let budget = Budget::with_max(1000, 10);
        let other = budget.clone();
        assert!(budget.take_elements(5, 100, "points").is_ok());
        assert_eq!((budget.left(100), other.left(100)), (5, 5));
        let error = other.take_elements(6, 100, "points").unwrap_err();
        assert_eq!(error.settings(), [Setting::MaxMemory]);
        assert_eq!(
            error.to_string(),
            "expected an input of 10 bytes to take at most 1000 bytes of memory, found 6 points: the input \
             is probably damaged; if it is valid, state the maximum memory"
        );
    }

    #[test]
    fn counts_that_overflow_are_rejected() {
        let budget = Budget::of_process();
        for _ in 0..5 {
            assert!(budget.take_elements(u64::MAX, u64::MAX, "points").is_err());
        }
        assert_eq!(Budget::of_compressed(u64::MAX, 16).left(1), max_memory());
    }

    #[test]
    fn small_inputs_may_take_what_a_picture_takes() {
        assert!(Budget::of_compressed(1, 16).take_elements(24_000_000, 12, "pixels").is_ok());
        assert!(Budget::of_compressed(1_500_000, 16).take_elements(40_000 * 38_000, 4, "pixels").is_err());
        // Large inputs may take memory in proportion.
        assert!(Budget::of_compressed(1 << 40, 16).left(1) > MIN_INPUT_BYTES);
    }

    #[test]
    fn limits_of_the_system_are_parsed() {
        let memory = machine::kilobytes("MemFree: 5 kB\nMemTotal:       16316412 kB\n", "MemTotal:");
        assert_eq!(memory, Some(16_316_412 * 1024));
        let limits = "Limit  Soft  Hard  Units\nMax address space         4294967296   unlimited   bytes\n";
        assert_eq!(machine::soft_limit(limits, "Max address space"), Some(4 << 30));
        assert_eq!(
            machine::soft_limit(&limits.replace("4294967296", "unlimited"), "Max address space"),
            None
        );
        assert_eq!((share(Some(4000)), share(None)), (3000, u64::MAX));
        assert_eq!([size(9999), size(1_500_000), size(402_653_184)], ["9999 bytes", "1500 kB", "402 MB"]);
    }
}
