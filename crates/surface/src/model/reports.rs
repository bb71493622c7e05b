//! Figures of sensors, poses and σ that a model carries.

use planish_mesh::quantile_of_sorted;
use serde::{Deserialize, Serialize};

/// The figures of one sensor and quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// Name of the sensor.
    pub name: String,
    /// Quantity: `position`, `normal` or `curvature`. σ and residuals are in the model's unit, in degrees, or
    /// in one over the unit.
    #[serde(default = "position")]
    pub quantity: String,
    /// Readings used.
    pub observations: usize,
    /// Stated σ, if any.
    pub sigma_stated: Option<f64>,
    /// σ estimated from the residuals.
    pub sigma_estimated: f64,
    /// σ of the errors that neighbouring readings share, if there are any: a mean over readings does not
    /// reduce it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_shared: Option<f64>,
    /// Root mean square of the residuals along the normals.
    pub rms: f64,
    /// True if the fit used the estimated σ: none was stated, or the residuals contradict it.
    pub sigma_used_is_estimated: bool,
}

/// The quantity in files that name none: older versions measured positions only.
fn position() -> String {
    "position".to_owned()
}

/// Quantiles of the surface's σ along its normal, over its measured area.
///
/// # Examples
/// ```
/// use planish_surface::model::SigmaSummary;
/// let sigma = SigmaSummary::from_values(vec![0.3, 0.1, 0.2]);
/// assert_eq!((sigma.median, sigma.max), (0.2, 0.3));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SigmaSummary {
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

impl SigmaSummary {
    /// Quantiles of values with equal weights; zero if there are none.
    #[must_use]
    pub fn from_values(mut sigmas: Vec<f64>) -> Self {
        sigmas.sort_by(f64::total_cmp);
        let at = |share: f64| match sigmas.is_empty() {
            true => 0.0,
            false => quantile_of_sorted(&sigmas, share),
        };
        Self { median: at(0.5), p95: at(0.95), max: at(1.0) }
    }
}

/// The pose of a scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ScanPoseReport {
    /// Name of the scan.
    pub scan: String,
    /// Translation, world from scanner.
    pub translation: [f64; 3],
    /// Rotation, world from scanner.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the translation.
    pub sigma_translation: Option<f64>,
    /// σ of the rotation in degrees.
    pub sigma_rotation_deg: Option<f64>,
    /// Covariance of translation and rotation vector (radians, about the world's axes), if the pose was
    /// estimated with the surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Directions of translation and rotation vector that no reading determines, each as long as one stated
    /// σ.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undetermined: Vec<[f64; 6]>,
    /// Distance by which the scan's readings were moved from their stated positions (root mean square).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<f64>,
    /// Angle by which the scan was turned from its stated pose, in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turned_deg: Option<f64>,
    /// Bias of every reading of the scan, if it was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias: Option<f64>,
    /// σ of the bias.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_bias: Option<f64>,
}

impl ScanPoseReport {
    /// Sets the covariance of translation and rotation vector, and σ of both as root mean squares over the
    /// three axes.
    pub fn set_covariance(&mut self, covariance: [[f64; 6]; 6]) {
        let sigma = |from: usize| {
            // The trace does not depend on the axes, so σ is the same in every frame.
            let trace: f64 = (from..from + 3).map(|k| covariance[k][k]).sum();
            (trace / 3.0).max(0.0).sqrt()
        };
        self.sigma_translation = Some(sigma(0));
        self.sigma_rotation_deg = Some(sigma(3).to_degrees());
        self.covariance = Some(covariance);
    }
}
