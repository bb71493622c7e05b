//! How long work tells how far it is, and is told to stop.

use planish_estimate::{Error, Result};

/// A listener to long work. All methods may be called from the thread that runs the job only.
pub trait Progress {
    /// A stage has reached a share of the whole job, in `[0, 1]`.
    fn advance(&self, stage: &str, share: f64);

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
        if self.interrupted() {
            Err(Error::interrupted())
        } else {
            Ok(())
        }
    }
}

/// Tells nobody and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn advance(&self, _: &str, _: f64) {}
}
