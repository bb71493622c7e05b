//! Options of a contour fit, and the thresholds that follow from them.

use super::reading::{ContourModel, Form, PlanarMotion};

/// With fewer readings per side than this, readings near corners are kept in the last batch fit.
///
/// Leaving them out removes the bias of assigning a reading to the nearer side (decision record 0052), but
/// loses information. With few readings the scatter of the estimate is larger than that bias.
const READINGS_PER_SIDE: usize = 25;

/// Gate of the likelihood if the user disables the gate, in σ.
///
/// The likelihood always needs a bound: without it, one gross error would decide the kind.
const DEFAULT_OUTLIER_GATE: f64 = 10.0;

/// Method of estimation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// A batch, then the maximum of the marginal likelihood, in which the places of the readings on the
    /// outline are integrated out. The least biased method and the default.
    Combined,
    /// All readings at once (Gauss–Helmert with misclosures at the corrected readings).
    Batch,
    /// Extended Kalman filter: one reading after the other, linearised at the prediction.
    Extended,
    /// Iterated Kalman filter: relinearised in the state at each reading.
    Iterated,
    /// Noise-updated iterated Kalman filter (NUIEKF): relinearised in state and noise (Weiss-Cohen et al.
    /// 2009, eq. 2.17).
    NoiseUpdated,
}

/// Options of a contour fit.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourFitOptions {
    /// Method of estimation.
    pub method: Method,
    /// How the pieces of a contour are combined into one equation.
    pub form: Form,
    /// Motion of the object during the measurement.
    pub motion: PlanarMotion,
    /// Reject readings more than this many σ from the contour (default 4); `None` keeps all.
    pub gate: Option<f64>,
    /// Leave readings within this many σ of a corner out of the last batch fit (default 2).
    ///
    /// Their side is uncertain, and assigning them to the nearer one is a bias. Applies to rectangles and
    /// polygons with at least 25 readings per side.
    pub corner_margin: Option<f64>,
    /// Correct distances for the curvature of the contour (batch and NUIEKF); see decision record 0049.
    pub correct_bias: bool,
    /// Starting values of all parameters, followed by those of the motion; `None` derives them from the
    /// readings.
    pub start: Option<Vec<f64>>,
}

impl Default for ContourFitOptions {
    fn default() -> Self {
        Self {
            method: Method::Combined,
            form: Form::ActiveFacet,
            motion: PlanarMotion::Still,
            gate: Some(4.0),
            corner_margin: Some(2.0),
            correct_bias: true,
            start: None,
        }
    }
}

/// The margin at corners in σ, or `None` with too few readings per side ([`READINGS_PER_SIDE`]).
pub(super) fn corner_margin(
    model: &ContourModel,
    readings: usize,
    options: &ContourFitOptions,
) -> Option<f64> {
    let enough = readings >= READINGS_PER_SIDE * model.kind.pieces();
    options.corner_margin.filter(|_| enough)
}

/// Distance in σ beyond which the likelihood of a reading no longer decreases.
pub(super) fn outlier_gate(options: &ContourFitOptions) -> f64 {
    options.gate.unwrap_or(DEFAULT_OUTLIER_GATE)
}

/// Cost of a rejected reading: that of one exactly at the gate.
///
/// Were it free, a kind could improve its BIC by rejecting readings.
pub(super) fn gate_cost(gate: Option<f64>) -> f64 {
    gate.map_or(0.0, |g| 0.5 * g * g)
}
