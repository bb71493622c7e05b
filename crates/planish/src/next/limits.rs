//! Limits of the size of a plan.
//!
//! In: the options of a plan. Out: a refusal if choosing so many points would take hours, which looks like a
//! program that hangs.

use super::NextOptions;
use planish_core::Setting;
use planish_estimate::{Error, Result};

/// Maximum number of points of one plan. They are chosen one after the other, in 31 ms of processor time each
/// on the model of `examples/data/pebble`, so 10 000 take minutes. More points than that are a scan, which
/// needs no choice.
pub const MAX_POINTS: usize = 10_000;
/// Maximum number of poses of one plan. Each costs a factorisation.
pub const MAX_VIEWS: usize = 1000;
/// Maximum number of random sets.
pub const MAX_RANDOM_SETS: usize = 10_000;

/// Refuses too many points or random sets.
///
/// # Errors
/// `Input`.
pub(super) fn check_counts(options: &NextOptions) -> Result<()> {
    if options.count > MAX_POINTS {
        let error = format!("expected at most {MAX_POINTS} points to plan, found {}", options.count);
        return Err(Error::input(error).with_setting(Setting::Count));
    }
    if options.against_random > MAX_RANDOM_SETS {
        return Err(Error::input(format!(
            "expected at most {MAX_RANDOM_SETS} random sets of points, found {}",
            options.against_random
        )));
    }
    Ok(())
}

/// Refuses too many poses.
///
/// # Errors
/// `Input`.
pub(super) fn check_view_count(options: &NextOptions) -> Result<()> {
    match options.count {
        0..=MAX_VIEWS => Ok(()),
        count => {
            let error = format!("expected at most {MAX_VIEWS} poses to plan, found {count}");
            Err(Error::input(error).with_setting(Setting::Views))
        }
    }
}
