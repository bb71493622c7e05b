//! What was divided while a surface was refined, and why.

use planish_spline::{Subdivision, SubdivisionReason};
use serde::Serialize;
use std::collections::BTreeMap;

/// What asks for subdivision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RefineBy {
    /// Readings that err together where the surface cannot follow them.
    #[default]
    Residuals,
    /// Gaussian curvature that varies: `sd(K)/max(|K̄|, σ_K) > 0.5`, what varies within its σ not counted.
    Curvature,
    /// Either.
    Both,
    /// Residuals, and a smoothness that leaves shape finer than the cells: for surfaces that are rough at
    /// every scale. Takes up to four times as many cells.
    Roughness,
}

impl RefineBy {
    /// Whether residuals are looked at.
    #[must_use]
    pub fn residuals(self) -> bool {
        self != Self::Curvature
    }

    /// Whether curvature is.
    #[must_use]
    pub fn curvature(self) -> bool {
        matches!(self, Self::Curvature | Self::Both)
    }
}

/// Why something was divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
    /// Its readings err together.
    Residuals,
    /// Its curvature varies.
    Curvature,
    /// The smoothness that was found leaves shape finer than it.
    Roughness,
    /// Beside something that was divided.
    Grading,
    /// A ball grew into the indicator of its points.
    Growth,
}

impl Cause {
    fn name(self) -> &'static str {
        match self {
            Self::Residuals => "residuals",
            Self::Curvature => "curvature",
            Self::Roughness => "roughness",
            Self::Grading => "grading",
            Self::Growth => "growth",
        }
    }
}

/// What was divided of one level.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LevelRefinement {
    /// The level, 0 for the base grid.
    pub level: usize,
    /// How many cells (of the patch filter: patches) were divided into four.
    pub divided: usize,
    /// The same by cause: `residuals`, `curvature`, `roughness`, `grading` beside something that was divided,
    /// `growth` of a ball into its points.
    pub causes: BTreeMap<&'static str, usize>,
}

/// Divisions as they come.
#[derive(Debug, Clone, Default)]
pub(crate) struct RefinementLog(BTreeMap<usize, BTreeMap<&'static str, usize>>);

impl RefinementLog {
    pub(crate) fn add(&mut self, level: usize, cause: Cause, count: usize) {
        if count > 0 {
            *self.0.entry(level).or_default().entry(cause.name()).or_insert(0) += count;
        }
    }

    /// Divisions of patches whose base grid has that level.
    pub(crate) fn add_patches(&mut self, base_level: usize, divided: &[Subdivision]) {
        for one in divided {
            let cause = match one.reason {
                SubdivisionReason::ChiSquare(_) => Cause::Residuals,
                SubdivisionReason::CurvatureVariation(_) => Cause::Curvature,
                SubdivisionReason::Grading | SubdivisionReason::Requested => Cause::Grading,
            };
            self.add(base_level + usize::from(one.patch.depth), cause, 1);
        }
    }

    pub(crate) fn levels(&self) -> Vec<LevelRefinement> {
        (self.0.iter())
            .map(|(&level, causes)| LevelRefinement {
                level,
                divided: causes.values().sum(),
                causes: causes.clone(),
            })
            .collect()
    }
}
