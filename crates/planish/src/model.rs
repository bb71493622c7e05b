//! A fitted surface with what is known of it: the thing that is saved, compared, updated and exported.
//!
//! Prior and data information are kept apart, so that a later session adds its data to yesterday's and counts the prior once.

use planish_estimate::sparse::{BlockInformation, CholeskyFactor, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_spline::{CellCovariance, Surface, SurfaceSystem, leaf_weights};
use serde::{Deserialize, Serialize};

/// What a fit says of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// Its name.
    pub name: String,
    /// Readings used.
    pub observations: usize,
    /// σ as stated; none where it was not.
    pub sigma_stated: Option<f64>,
    /// σ as the residuals say.
    pub sigma_estimated: f64,
    /// Root mean square of the residuals along the normals.
    pub rms: f64,
    /// Whether the fit used the estimated σ: it was not stated, or the data contradict it.
    pub sigma_used_is_estimated: bool,
}

/// The pose of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
    /// The scan's name.
    pub scan: String,
    /// Translation, world from scanner.
    pub translation: [f64; 3],
    /// Rotation, world from scanner.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the translation.
    pub sigma_translation: Option<f64>,
    /// σ of the rotation in degrees.
    pub sigma_rotation_deg: Option<f64>,
}

/// A surface and the information about its control vertices.
///
/// Blocks of three, one for each node of `surface.space()`; linearised at `surface`.
#[derive(Debug, Clone)]
pub struct SurfaceModel {
    /// Unit of every length.
    pub unit: Unit,
    /// The posterior mean.
    pub surface: Surface,
    /// Information of the smoothness prior and of the weak hold on tangential motion.
    pub prior: BlockInformation,
    /// Information of the measurements.
    pub data: BlockInformation,
    /// For each leaf, whether it was measured: an ungated foot point within one knot span.
    pub observed: Vec<bool>,
    /// Sensors that went in.
    pub sensors: Vec<SensorReport>,
    /// Poses that went in.
    pub poses: Vec<PoseReport>,
    /// Weight of the thin-plate energy.
    pub smoothness_weight: f64,
    /// How many readings the data information holds.
    pub observations: usize,
}

/// The posterior covariance of a model, ready for questions.
pub struct Posterior<'a> {
    model: &'a SurfaceModel,
    inverse: SelectedInverse,
}

impl SurfaceModel {
    /// Factors the information and inverts it where nodes share a leaf.
    ///
    /// # Errors
    /// `Undetermined` when prior and data leave a vertex open.
    pub fn posterior(&self) -> Result<Posterior<'_>> {
        let system = SurfaceSystem::new(self.surface.space())?;
        let mut total = self.data.clone();
        total.add_scaled(&self.prior, 1.0)?;
        let factor: CholeskyFactor = system.factorize(&total)?;
        Ok(Posterior { model: self, inverse: SelectedInverse::new(&factor) })
    }
}

impl<'a> Posterior<'a> {
    /// From a selected inverse that is there already.
    #[must_use]
    pub fn from_inverse(model: &'a SurfaceModel, inverse: SelectedInverse) -> Self {
        Self { model, inverse }
    }

    /// The covariance of a leaf's sixteen coefficients: for many points of one leaf.
    ///
    /// # Errors
    /// `Undetermined` never in practice: every leaf's nodes are coupled in the factor.
    pub fn leaf(&self, leaf: usize) -> Result<CellCovariance> {
        let space = self.model.surface.space();
        let dense = self
            .inverse
            .dense(space.extraction(leaf).0)
            .ok_or_else(|| Error::undetermined(format!("leaf {leaf} has no covariance")))?;
        Ok(CellCovariance::new(space, leaf, &dense))
    }

    /// σ of the surface point at leaf-local coordinates along a unit direction.
    #[must_use]
    pub fn sigma_along(cell: &CellCovariance, local: [f64; 2], direction: [f64; 3]) -> f64 {
        cell.variance_along(&leaf_weights(local[0], local[1]), direction).max(0.0).sqrt()
    }
}
