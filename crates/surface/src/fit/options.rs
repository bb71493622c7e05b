//! Settings of a fit.

use super::noise::NoiseRules;
use crate::complete::SymmetryChoice;
use crate::subdivision::RefineBy;
use planish_sense::ScanChecks;
use planish_spline::Shape;
use serde::Serialize;

/// Settings of a fit.
///
/// The strategy holds the settings that only it has; the other fields apply to every strategy. One exception:
/// a fit with known parameters has a fixed grid, so it does not use `tolerance`, `max_depth`, `refine_by` and
/// `max_coefficients`.
///
/// Lengths are in the unit of the scans.
///
/// # Examples
/// ```
/// use planish_surface::fit::{FitOptions, GlobalOptions, Strategy};
/// let options = FitOptions { gate: 3.0, max_depth: Some(4), ..FitOptions::default() };
/// assert_eq!(options.strategy, Strategy::Global(GlobalOptions::default()));
/// assert_eq!((options.held_out_share, options.shape), (0.1, None));
///
/// // The same with scan poses estimated.
/// let global = GlobalOptions { align: true, ..GlobalOptions::default() };
/// let aligned = FitOptions { strategy: Strategy::Global(global), ..options };
/// assert!(aligned.gate == 3.0 && aligned.ground().is_none());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// How the readings are turned into a surface (default: all at once, the object does not move).
    pub strategy: Strategy,
    /// Topology; if none is given, it is chosen from the cloud. A sheet that bends has only one choice.
    pub shape: Option<Shape>,
    /// Distance to the points at which refinement stops; if none is given, it stops at their noise.
    pub tolerance: Option<f64>,
    /// Maximum subdivision depth beyond the base grid. If none is given, refinement goes as deep as the
    /// readings allow; the patch filter goes to 3.
    pub max_depth: Option<u8>,
    /// Criterion for subdivision (default: residuals).
    pub refine_by: RefineBy,
    /// Maximum number of control vertices (default 62,500, which take about 2 GB: see
    /// [`max_coefficients_within`]).
    pub max_coefficients: usize,
    /// Reject readings more than this many σ from the surface (default 4).
    pub gate: f64,
    /// Lower a stated σ to that of the residuals if these are smaller (default: no).
    ///
    /// A σ that is too small is always raised. Small residuals alone do not prove a small σ: the surface
    /// follows errors that neighbouring readings share, as those of smoothed scans.
    pub estimate_sigma: bool,
    /// Share of the readings held out to judge the fit (default 0.1).
    pub held_out_share: f64,
    /// Keep a surface that does not follow much of its readings instead of refusing it (default: no).
    pub force: bool,
    /// Seed of every random choice (default 0).
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
}

/// How readings are turned into a surface, with the settings that only this way has.
///
/// | strategy | readings | unknowns of a vertex | covariance |
/// |---|---|---|---|
/// | `Global` | all at once | displacement along the normal | of the whole surface |
/// | `Patches` | one after the other | displacement along the normal | of each patch |
/// | `KnownParameters` | all at once, with columns `u` and `v` | its coordinates | of the whole surface |
/// | `Moving` | all at once, with the motion known | displacement along the normal | of the whole surface |
/// | `Bending` | time by time | its coordinates | of the whole surface at each time |
///
/// # Examples
/// ```
/// use planish_surface::complete::SymmetryChoice;
/// use planish_surface::fit::{FitOptions, GlobalOptions, Strategy};
/// // An object that turns while it is scanned; its unobserved parts are completed by symmetry.
/// let global = GlobalOptions { symmetry: Some(SymmetryChoice::Auto), ..GlobalOptions::default() };
/// let turning = FitOptions { strategy: Strategy::Moving(global), ..FitOptions::default() };
/// assert!(matches!(turning.strategy, Strategy::Moving(_)));
///
/// // Readings on a grid of 61 × 61 cells; the columns `u` and `v` hold their parameters.
/// let strategy = Strategy::KnownParameters { cells: [61, 61] };
/// assert_ne!(strategy, Strategy::default());
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Strategy {
    /// All readings at once: one sparse information matrix over all control vertices. The most accurate.
    Global(GlobalOptions),
    /// One reading after the other: a quadtree of patches with a dense covariance each. Memory does not grow
    /// with the readings, and σ is known at any time.
    ///
    /// The filter takes readings as independent. It therefore neither estimates poses nor uses readings
    /// inferred from others, whose errors are correlated.
    Patches(PatchOptions),
    /// One linear step over a uniform grid, for scans whose columns `u` and `v` in `[0, 1]` state the
    /// parameters of each reading. The surface is a sheet unless a shape is given.
    KnownParameters {
        /// Number of cells along `u` and `v`.
        cells: [usize; 2],
    },
    /// A rigid object that moves with a velocity of its own. The scans state their times. The model is the
    /// object at the first scan.
    Moving(GlobalOptions),
    /// A sheet that bends without stretch between scans: lengths along it are preserved. The model is the
    /// sheet at the last time.
    Bending,
}

/// How many handles a closed surface has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Handles {
    /// As many as the readings show.
    AsSeen,
    /// This number.
    Exactly(usize),
}

/// Settings of a global fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct GlobalOptions {
    /// Keep only bare earth of scans from above (default: keep all); the shape is a sheet then.
    pub ground: Option<GroundWidth>,
    /// Estimate the pose of every scan but the first (default: no). Poses with a stated σ are estimated in
    /// any case.
    pub align: bool,
    /// Symmetry by which unobserved parts are completed (default: none).
    pub symmetry: Option<SymmetryChoice>,
    /// Complete gaps by the simple shape of their surroundings (default: no).
    pub fill_gaps: bool,
    /// Number of snapshots to keep of the model as it forms (default: none): see
    /// [`Fit::formation`](super::Fit).
    pub snapshots: Option<usize>,
    /// Number of handles of a closed object, which are the holes through it (default: as many as the readings
    /// show). It overrides the shape, and a ball lies over quads.
    pub genus: Option<usize>,
    /// Fit a surface that is smooth everywhere (default: sharp edges of closed objects are followed).
    pub smooth: bool,
}

/// Settings of a fit by the patch filter.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PatchOptions {
    /// Keep only bare earth of scans from above (default: keep all); the shape is a sheet then.
    pub ground: Option<GroundWidth>,
    /// Number of snapshots to keep of the model as it forms (default: none): see
    /// [`Fit::formation`](super::Fit).
    pub snapshots: Option<usize>,
}

/// Settings of an update of a saved model.
///
/// The model decides shape, grid and strategy. `refine_by` and `max_coefficients` apply to models of the
/// patch filter; the grid of other models is kept.
///
/// # Examples
/// ```
/// use planish_surface::fit::{FitOptions, UpdateOptions};
/// let options = UpdateOptions { align: true, ..UpdateOptions::default() };
/// assert_eq!(options.gate, FitOptions::default().gate);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct UpdateOptions {
    /// The filter that the model must come from (default: any).
    pub filter: Option<Filter>,
    /// Keep only bare earth of scans from above (default: keep all).
    pub ground: Option<GroundWidth>,
    /// Estimate the poses of the scans (default: no). The patch filter cannot.
    pub align: bool,
    /// Criterion for subdivision of patches (default: residuals).
    pub refine_by: RefineBy,
    /// Maximum number of control vertices (default 62,500).
    pub max_coefficients: usize,
    /// Reject readings more than this many σ from the surface (default 4).
    pub gate: f64,
    /// Lower a stated σ to that of the residuals if these are smaller (default: no).
    ///
    /// A σ that is too small is always raised. Small residuals alone do not prove a small σ: the surface
    /// follows errors that neighbouring readings share, as those of smoothed scans.
    pub estimate_sigma: bool,
    /// Share of the readings held out to judge the fit (default 0.1).
    pub held_out_share: f64,
    /// Seed of every random choice (default 0).
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
}

/// How readings are fused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// All at once: one sparse information matrix over all control vertices.
    #[default]
    Global,
    /// One after the other: a quadtree of patches with a dense covariance each. Memory does not grow with
    /// the readings, and σ is known at any time.
    Patch,
}

/// Width of objects on the ground that do not belong to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GroundWidth {
    /// Up to 36 m: houses, and most other objects in a landscape.
    Default,
    /// Up to this width, in the unit of the scans.
    Widest(f64),
}

impl Default for Strategy {
    fn default() -> Self {
        Self::Global(GlobalOptions::default())
    }
}

/// Memory of the control vertices of a fit with default options, in bytes. It does not depend on the machine,
/// because the result would do so as well.
const DEFAULT_MEMORY: u64 = 2_000_000_000;
/// Memory of a control vertex, with its share of the factor and of the covariance: 31 KB between 12,000 and
/// 24,000 vertices of the ten bunny scans.
const BYTES_PER_COEFFICIENT: u64 = 32_000;

/// The number of control vertices of which a fit takes about this memory, in bytes.
#[must_use]
pub fn max_coefficients_within(memory: u64) -> usize {
    (memory / BYTES_PER_COEFFICIENT) as usize
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            strategy: Strategy::default(),
            shape: None,
            tolerance: None,
            max_depth: None,
            refine_by: RefineBy::Residuals,
            max_coefficients: max_coefficients_within(DEFAULT_MEMORY),
            // Of normal residuals, 0.006 % lie beyond 4 σ, so hardly any correct reading is rejected.
            gate: 4.0,
            estimate_sigma: false,
            held_out_share: 0.1,
            force: false,
            seed: 0,
            checks: ScanChecks::default(),
        }
    }
}

impl Default for UpdateOptions {
    fn default() -> Self {
        // The shared defaults come from one place, so that a fit and an update gate alike.
        let FitOptions { refine_by, max_coefficients, gate, estimate_sigma, .. } = FitOptions::default();
        let FitOptions { held_out_share, seed, checks, .. } = FitOptions::default();
        Self {
            filter: None,
            ground: None,
            align: false,
            refine_by,
            max_coefficients,
            gate,
            estimate_sigma,
            held_out_share,
            seed,
            checks,
        }
    }
}

impl Strategy {
    /// Where the number of snapshots is set; none for strategies that do not use one reading after the other.
    pub fn snapshots_mut(&mut self) -> Option<&mut Option<usize>> {
        match self {
            Self::Global(GlobalOptions { snapshots, .. })
            | Self::Moving(GlobalOptions { snapshots, .. })
            | Self::Patches(PatchOptions { snapshots, .. }) => Some(snapshots),
            Self::KnownParameters { .. } | Self::Bending => None,
        }
    }
}

impl FitOptions {
    /// The handles of a closed surface over quads; none if the surface is a sheet, tube, ball or torus.
    pub(super) fn handles(&self) -> Option<Handles> {
        let Strategy::Global(GlobalOptions { genus, .. }) = &self.strategy else { return None };
        match genus {
            Some(genus) => Some(Handles::Exactly(*genus)),
            None if self.shape.is_some() => None,
            None => Some(Handles::AsSeen),
        }
    }

    /// True if sharp edges of closed objects are followed.
    pub(super) fn follows_creases(&self) -> bool {
        matches!(&self.strategy, Strategy::Global(global) if !global.smooth)
    }

    /// The width of objects that are removed, if only bare earth is kept.
    #[must_use]
    pub fn ground(&self) -> Option<GroundWidth> {
        match &self.strategy {
            Strategy::Global(GlobalOptions { ground, .. })
            | Strategy::Moving(GlobalOptions { ground, .. })
            | Strategy::Patches(PatchOptions { ground, .. }) => *ground,
            Strategy::KnownParameters { .. } | Strategy::Bending => None,
        }
    }

    /// The same options; with `ground` the shape is a sheet unless another is given.
    pub(super) fn with_shape_of_ground(&self) -> Self {
        Self { shape: self.shape.or(self.ground().map(|_| Shape::Sheet)), ..self.clone() }
    }

    /// How residuals determine the noise.
    pub(super) fn noise_rules(&self) -> NoiseRules {
        NoiseRules { gate: self.gate, may_lower: self.estimate_sigma }
    }

    /// The same options with a global fit.
    pub(super) fn with_global(&self, global: GlobalOptions) -> Self {
        Self { strategy: Strategy::Global(global), ..self.clone() }
    }
}

impl UpdateOptions {
    /// The settings that the stages of a fit share with an update.
    pub(super) fn fit_options(&self) -> FitOptions {
        // The filter is that of the model and was checked before. A global strategy only carries `ground` and
        // `align` to the stages that all filters share.
        let Self { filter: _, ground, align, refine_by, max_coefficients, .. } = *self;
        let Self { gate, estimate_sigma, held_out_share, seed, checks, .. } = *self;
        let global = GlobalOptions { ground, align, ..GlobalOptions::default() };
        let shared = FitOptions {
            refine_by,
            max_coefficients,
            gate,
            estimate_sigma,
            held_out_share,
            seed,
            checks,
            ..FitOptions::default()
        };
        shared.with_global(global)
    }
}
