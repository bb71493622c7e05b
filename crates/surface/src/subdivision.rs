//! Criteria for subdivision, and the log of divisions.

use planish_spline::{Subdivision, SubdivisionReason};
use serde::Serialize;
use std::collections::BTreeMap;

/// Criterion for subdivision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RefineBy {
    /// Correlated residuals, which show that the surface cannot follow its readings.
    #[default]
    Residuals,
    /// Varying Gaussian curvature: `sd(K)/max(|K̄|, σ_K) > 0.5`, without the variation that σ_K explains.
    Curvature,
    /// Residuals or curvature.
    Both,
    /// Residuals, and cells wider than the smoothing length: for surfaces that are rough at every scale. It
    /// takes up to four times as many cells.
    Roughness,
}

impl RefineBy {
    /// True if residuals are used.
    ///
    /// ```
    /// use planish_surface::subdivision::RefineBy;
    /// assert!(RefineBy::Both.residuals() && !RefineBy::Curvature.residuals());
    /// ```
    #[must_use]
    pub fn residuals(self) -> bool {
        self != Self::Curvature
    }

    /// True if curvature is used.
    ///
    /// ```
    /// use planish_surface::subdivision::RefineBy;
    /// assert!(RefineBy::Both.curvature() && !RefineBy::Residuals.curvature());
    /// ```
    #[must_use]
    pub fn curvature(self) -> bool {
        matches!(self, Self::Curvature | Self::Both)
    }
}

/// Cause of a division.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
    /// Its residuals are correlated.
    Residuals,
    /// A cubic spline of its size misses more than σ of the surface.
    SplineError,
    /// Its curvature varies.
    Curvature,
    /// It is wider than the smoothing length.
    Roughness,
    /// A neighbour was divided.
    Grading,
    /// A ball grew into the indicator of its points.
    Growth,
}

impl Cause {
    fn name(self) -> &'static str {
        match self {
            Self::Residuals => "residuals",
            Self::SplineError => "spline",
            Self::Curvature => "curvature",
            Self::Roughness => "roughness",
            Self::Grading => "grading",
            Self::Growth => "growth",
        }
    }
}

/// Divisions of one level.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LevelRefinement {
    /// The level, 0 for the base grid.
    pub level: usize,
    /// Number of cells (for the patch filter: patches) divided into four.
    pub divided: usize,
    /// The same by cause: `residuals`, `curvature`, `roughness`, `grading` next to a divided cell, `growth`
    /// of a ball into its points.
    pub causes: BTreeMap<&'static str, usize>,
}

/// Counts of divisions by level and cause.
#[derive(Debug, Clone, Default)]
pub(crate) struct RefinementLog(BTreeMap<usize, BTreeMap<&'static str, usize>>);

impl RefinementLog {
    pub(crate) fn add(&mut self, level: usize, cause: Cause, count: usize) {
        if count > 0 {
            *self.0.entry(level).or_default().entry(cause.name()).or_insert(0) += count;
        }
    }

    /// Adds divisions of patches whose base grid has the level `base_level`.
    pub(crate) fn add_patches(&mut self, base_level: usize, divided: &[Subdivision]) {
        for division in divided {
            let cause = match division.reason {
                SubdivisionReason::ChiSquare(_) => Cause::Residuals,
                SubdivisionReason::CurvatureVariation(_) => Cause::Curvature,
                SubdivisionReason::Grading | SubdivisionReason::Requested => Cause::Grading,
            };
            self.add(base_level + usize::from(division.patch.depth), cause, 1);
        }
    }

    pub(crate) fn levels(&self) -> Vec<LevelRefinement> {
        // Sorted maps list levels and causes in the same order in every run.
        (self.0.iter())
            .map(|(&level, causes)| LevelRefinement {
                level,
                divided: causes.values().sum(),
                causes: causes.clone(),
            })
            .collect()
    }
}
