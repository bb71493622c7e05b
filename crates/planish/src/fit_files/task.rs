//! The task of a fit job: a new model, or more scans for a saved one.

use planish_surface::fit::{FitOptions, GroundWidth, UpdateOptions};
use std::path::{Path, PathBuf};

/// The task of a [`FitJob`](super::FitJob): a new fit, or an update.
///
/// # Examples
/// ```
/// use planish::fit::{FitOptions, UpdateOptions};
/// use planish::fit_files::FitTask;
/// let new = FitTask::Fit(FitOptions { seed: 7, ..FitOptions::default() });
/// assert!(new.model().is_none() && new.seed() == 7);
/// let later = FitTask::Update { model: "part.planish".into(), options: UpdateOptions::default() };
/// assert!(later.model().is_some());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum FitTask {
    /// Fits a new model.
    Fit(FitOptions),
    /// Adds the scans to a saved model, whose shape and grid are kept.
    Update {
        /// The saved model.
        model: PathBuf,
        /// Settings of the update.
        options: UpdateOptions,
    },
}

impl Default for FitTask {
    fn default() -> Self {
        Self::Fit(FitOptions::default())
    }
}

impl FitTask {
    /// The saved model that is updated, if any.
    #[must_use]
    pub fn model(&self) -> Option<&Path> {
        match self {
            Self::Fit(_) => None,
            Self::Update { model, .. } => Some(model),
        }
    }

    /// Settings of a new fit; none for an update.
    #[must_use]
    pub fn fit_options(&self) -> Option<&FitOptions> {
        match self {
            Self::Fit(options) => Some(options),
            // The saved model decides what these options would decide.
            Self::Update { .. } => None,
        }
    }

    /// The seed of every random choice.
    #[must_use]
    pub fn seed(&self) -> u64 {
        match self {
            Self::Fit(options) => options.seed,
            Self::Update { options, .. } => options.seed,
        }
    }

    /// The width of objects on the ground that are removed, if only bare earth is kept.
    #[must_use]
    pub fn ground(&self) -> Option<GroundWidth> {
        match self {
            Self::Fit(options) => options.ground(),
            Self::Update { options, .. } => options.ground,
        }
    }

    // New fits and updates share these settings, but have different structs: an update has neither a shape
    // nor a strategy (docs/decisions/0086-types-instead-of-flags.md).
    pub(super) fn gate(&self) -> f64 {
        match self {
            Self::Fit(options) => options.gate,
            Self::Update { options, .. } => options.gate,
        }
    }

    pub(super) fn held_out_share(&self) -> f64 {
        match self {
            Self::Fit(options) => options.held_out_share,
            Self::Update { options, .. } => options.held_out_share,
        }
    }

    pub(super) fn max_coefficients(&self) -> usize {
        match self {
            Self::Fit(options) => options.max_coefficients,
            Self::Update { options, .. } => options.max_coefficients,
        }
    }
}
