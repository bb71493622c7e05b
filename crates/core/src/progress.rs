//! How long work tells how far it is, and is told to stop.

use crate::error::{Error, Result};

/// The stage in which files are written, of every job that writes any.
pub const WRITING_STAGE: &str = "writing";
/// The stage in which a result is shown until somebody ends it: to stop is no interruption then.
pub const SHOWING_STAGE: &str = "showing";

/// A listener to long work. All methods may be called from the thread that runs the job only.
pub trait Progress {
    /// A stage has reached a share of the whole job, in `[0, 1]`.
    fn advance(&self, stage: &str, share: f64);

    /// How far readings lie from what is known so far, root mean square, in the unit of the job; of jobs that
    /// go round after round.
    fn rms(&self, _rms: f64) {}

    /// How many of the things that this stage works through are done, and what they are, in the plural:
    /// `readings`.
    fn items(&self, _done: usize, _what: &'static str) {}

    /// Whether the work is to stop.
    fn interrupted(&self) -> bool {
        false
    }

    /// [`Progress::advance`], then an error where the work is to stop.
    ///
    /// # Errors
    /// `Interrupted` when [`Progress::interrupted`] says so.
    fn check(&self, stage: &str, share: f64) -> Result<()> {
        self.advance(stage, share);
        if self.interrupted() { Err(Error::interrupted()) } else { Ok(()) }
    }
}

/// Tells nobody and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn advance(&self, _: &str, _: f64) {}
}

/// A part of a longer job: its shares run from one share of the whole to another.
pub struct ProgressPart<'a> {
    whole: &'a dyn Progress,
    from: f64,
    to: f64,
}

impl<'a> ProgressPart<'a> {
    /// The part of a job between two of its shares.
    #[must_use]
    pub fn new(whole: &'a dyn Progress, from: f64, to: f64) -> Self {
        Self { whole, from, to }
    }
}

impl Progress for ProgressPart<'_> {
    fn advance(&self, stage: &str, share: f64) {
        self.whole.advance(stage, self.from + (self.to - self.from) * share);
    }

    fn rms(&self, rms: f64) {
        self.whole.rms(rms);
    }

    fn items(&self, done: usize, what: &'static str) {
        self.whole.items(done, what);
    }

    fn interrupted(&self) -> bool {
        self.whole.interrupted()
    }
}
