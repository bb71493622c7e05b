//! Settings of a fit.

use crate::complete::SymmetryChoice;
use crate::subdivision::RefineBy;
use planish_sense::ScanChecks;
use planish_spline::Shape;
use serde::Serialize;

/// Settings of a fit.
///
/// # Examples
/// ```
/// use planish_surface::fit::{Filter, FitOptions};
/// let options = FitOptions { gate: 3.0, filter: Some(Filter::Patch), ..FitOptions::default() };
/// assert_eq!((options.held_out_share, options.shape), (0.1, None));
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Topology; if none is given, it is chosen from the cloud.
    pub shape: Option<Shape>,
    /// Cells of the uniform grid that is fitted to scans whose readings carry their parameters `u` and `v` in
    /// `[0, 1]`. The problem is linear then: no tolerance and no limit of coefficients apply.
    pub known_parameters: Option<[usize; 2]>,
    /// Distance to the points at which refinement stops, in the model's unit; if none is given, it stops at
    /// their noise.
    pub tolerance: Option<f64>,
    /// Keep only bare earth of scans from above; the shape is a sheet then.
    pub ground: Option<GroundWidth>,
    /// How readings are fused; if none is given, globally, and into a saved model as it was made.
    pub filter: Option<Filter>,
    /// Maximum subdivision depth beyond the base grid. If none is given, refinement goes as deep as the
    /// readings allow; the patch filter goes to 3.
    pub max_depth: Option<u8>,
    /// Criterion for subdivision.
    pub refine_by: RefineBy,
    /// Estimate the pose of every scan but the first. Poses with a stated σ are estimated in any case.
    pub align: bool,
    /// Maximum number of control vertices.
    pub max_coefficients: usize,
    /// Symmetry by which unobserved parts are completed.
    pub symmetry: Option<SymmetryChoice>,
    /// Motion of the object between its scans, at the times that they state; if none is given, it stood
    /// still.
    pub motion: Option<ObjectMotion>,
    /// Complete gaps by the simple shape of their surroundings.
    pub complete_smooth: bool,
    /// Number of snapshots to keep of the model as it forms, if any: see [`Fit::formation`](super::Fit).
    pub snapshots: Option<usize>,
    /// Reject readings more than this many σ from the surface.
    pub gate: f64,
    /// Share of the readings held out to judge the fit.
    pub held_out_share: f64,
    /// Seed of every random choice.
    pub seed: u64,
    /// Checks of each scan.
    pub checks: ScanChecks,
}

/// How an object moves between scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectMotion {
    /// As a rigid body with a velocity of its own.
    Rigid,
    /// A sheet bends without stretch: lengths along it are preserved.
    Bend,
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
    Usual,
    /// Up to this width, in the unit of the scans.
    Widest(f64),
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            shape: None,
            known_parameters: None,
            tolerance: None,
            ground: None,
            filter: None,
            max_depth: None,
            refine_by: RefineBy::Residuals,
            align: false,
            max_coefficients: 12_000,
            symmetry: None,
            motion: None,
            complete_smooth: false,
            snapshots: None,
            gate: 4.0,
            held_out_share: 0.1,
            seed: 0,
            checks: ScanChecks::default(),
        }
    }
}

impl FitOptions {
    /// The same options; with `ground` the shape is a sheet unless another is given.
    pub(super) fn with_shape_of_ground(&self) -> Self {
        Self { shape: self.shape.or(self.ground.map(|_| Shape::Sheet)), ..self.clone() }
    }
}
