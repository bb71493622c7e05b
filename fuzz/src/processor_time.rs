//! Processor time of threads, so that time limits hold on a busy machine, too.
//!
//! Wall time depends on what else the machine does: a file that takes 1 s can take 6 s beside ten other jobs.
//! Linux counts the time that a thread was running in `/proc/…/schedstat` (the first number, in ns). The
//! kernel updates it at each timer tick, so differences are exact to some milliseconds.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Measures how long a thread was running since the start.
pub struct Stopwatch {
    schedstat: PathBuf,
    started: Instant,
    running: Option<Duration>,
}

impl Stopwatch {
    /// Starts for the calling thread.
    pub fn for_this_thread() -> Self {
        Self::new(PathBuf::from("/proc/thread-self/schedstat"))
    }

    /// Starts for the main thread of another process.
    pub fn for_process(id: u32) -> Self {
        Self::new(PathBuf::from(format!("/proc/{id}/schedstat")))
    }

    /// Starts with this file of the kernel.
    fn new(schedstat: PathBuf) -> Self {
        let running = running_time(&schedstat);
        Self { schedstat, started: Instant::now(), running }
    }

    /// Processor time since the start; wall time where the system does not count it.
    pub fn elapsed(&self) -> Duration {
        // Both ends have to come from the same clock, so wall time is used if either is missing.
        match (self.running, running_time(&self.schedstat)) {
            (Some(before), Some(now)) => now.saturating_sub(before),
            _ => self.started.elapsed(),
        }
    }

    /// Wall time since the start.
    pub fn wall_time(&self) -> Duration {
        self.started.elapsed()
    }
}

/// The running time that the kernel has counted; `None` on systems without it.
fn running_time(schedstat: &Path) -> Option<Duration> {
    let text = std::fs::read_to_string(schedstat).ok()?;
    // Later numbers are waiting time and time slices, which depend on other jobs.
    text.split_whitespace().next()?.parse().ok().map(Duration::from_nanos)
}
