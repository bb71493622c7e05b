//! Progress reports of long work, and requests to stop it.
//!
//! In: a [`Progress`] from the caller, often [`Silent`]. Out: calls of its methods, with shares of the whole
//! job that increase from 0 to 1. A job hands a [`ProgressPart`] to each of its parts.
//!
//! Work asks for interruption at its check points, so it stops at the next of them, not at once.

use crate::budget::check_memory;
use crate::error::{Error, Result};

/// Name of the stage in which a job writes its files.
pub const WRITING_STAGE: &str = "writing";
/// Name of the stage in which a result is shown until the user ends it. Stopping then is not an interruption.
pub const SHOWING_STAGE: &str = "showing";

/// Receives the progress of long work.
///
/// All methods are called from the thread that runs the job, so implementations need not be `Sync`.
///
/// # Examples
/// A listener that stops the work halfway:
/// ```
/// use planish_core::{ErrorKind, Progress, Result};
/// use std::cell::Cell;
///
/// struct UntilHalf(Cell<f64>);
/// impl Progress for UntilHalf {
///     fn advance(&self, _stage: &str, share: f64) {
///         self.0.set(share);
///     }
///     fn interrupted(&self) -> bool {
///         self.0.get() >= 0.5
///     }
/// }
///
/// fn work(progress: &dyn Progress) -> Result<()> {
///     (0..10).try_for_each(|k| progress.check("fitting", f64::from(k) / 10.0))
/// }
///
/// let listener = UntilHalf(Cell::new(0.0));
/// assert_eq!(work(&listener).unwrap_err().kind(), ErrorKind::Interrupted);
/// assert_eq!(listener.0.get(), 0.5);
/// ```
pub trait Progress {
    /// Reports that the work is in a stage and has done a share of the whole job, in `[0, 1]`.
    fn advance(&self, stage: &str, share: f64);

    /// Reports the root mean square residual of the current round, in the unit of the job. Only iterative
    /// jobs call it.
    fn rms(&self, _rms: f64) {}

    /// Reports how many items the stage has done, and what they are, in the plural: `readings`.
    fn items(&self, _done: usize, _what: &'static str) {}

    /// True if the work should stop.
    fn interrupted(&self) -> bool {
        false
    }

    /// Calls [`Progress::advance`] and returns an error if the work should stop.
    ///
    /// # Errors
    /// `Interrupted` if [`Progress::interrupted`] is true; `Unsupported` if the process takes more than
    /// [`max_memory`](crate::budget::max_memory).
    fn check(&self, stage: &str, share: f64) -> Result<()> {
        // Progress first: a listener may decide by the share that it has just received.
        self.advance(stage, share);
        if self.interrupted() {
            return Err(Error::interrupted());
        }
        // Here, because every long work passes this point, whatever it allocates.
        check_memory(0).map_err(|e| e.in_context(stage))
    }
}

/// Ignores all progress and never stops the work.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn advance(&self, _: &str, _: f64) {}
}

/// The progress of one part of a job: maps the part's shares from 0 to 1 to a range of the whole job.
///
/// # Examples
/// ```
/// use planish_core::{Progress, ProgressPart};
/// use std::cell::Cell;
///
/// struct Last(Cell<f64>);
/// impl Progress for Last {
///     fn advance(&self, _stage: &str, share: f64) {
///         self.0.set(share);
///     }
/// }
///
/// let parent = Last(Cell::new(0.0));
/// let second_half = ProgressPart::new(&parent, 0.5, 1.0);
/// second_half.advance("writing", 0.5);
/// assert_eq!(parent.0.get(), 0.75);
/// ```
pub struct ProgressPart<'a> {
    parent: &'a dyn Progress,
    from: f64,
    to: f64,
}

impl<'a> ProgressPart<'a> {
    /// The part of `parent` between two of its shares.
    #[must_use]
    pub fn new(parent: &'a dyn Progress, from: f64, to: f64) -> Self {
        Self { parent, from, to }
    }
}

impl Progress for ProgressPart<'_> {
    fn advance(&self, stage: &str, share: f64) {
        self.parent.advance(stage, self.from + (self.to - self.from) * share);
    }

    fn rms(&self, rms: f64) {
        // Not scaled: residuals and counts belong to the stage, only shares to the whole job.
        self.parent.rms(rms);
    }

    fn items(&self, done: usize, what: &'static str) {
        self.parent.items(done, what);
    }

    fn interrupted(&self) -> bool {
        self.parent.interrupted()
    }
}
