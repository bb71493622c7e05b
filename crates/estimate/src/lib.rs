//! Estimation for Planish: every measurement is an equation, and information adds up.
//!
//! This crate contains no geometry. A model provides its measurement equation `g(z − v, x) = 0` with noise
//! `v ~ N(0, R)`. All methods use its linearisation:
//!
//! ```text
//! MeasurementEquation ─► Linearization ─┬─► Information ─► Belief            merge, update, marginals
//!                                       ├─► KalmanFilter                     sequential: EKF, IEKF, NUIEKF
//!                                       └─► least_squares                    batch, with robust losses
//! residuals ─► Loss, TruncatedNormal, VarianceComponents, SmoothnessModel    estimates of σ and of weights
//! few readings ─► SmoothnessPosterior                                        both integrated out
//! deviations ─► ChiSquareMean, Coverage, whiteness                           tests of the stated σ
//! ```
//!
//! Small states use dense matrices; [`sparse`] is for large ones. [`implicit`] is a fast path for readings of
//! one equation each.
//!
//! # Example
//! Estimate a constant from two readings, then check a third against the result:
//! ```
//! use nalgebra::{DMatrix, DVector};
//! use planish_estimate::{Belief, Information, KalmanFilter, Linear, MeasurementEquation};
//!
//! let one = DMatrix::identity(1, 1);
//! let mut belief = Belief::from_information(Information::zero(1), Information::zero(1))?;
//! for (value, variance) in [(10.2, 0.04), (9.9, 0.01)] {
//!     let reading = Linear::new(one.clone(), DVector::from_element(1, value))?;
//!     let at = reading.linearized(&DVector::zeros(1), &DVector::zeros(1))?;
//!     belief.update(&at, &(&one * variance))?;
//! }
//! assert!((belief.mean()?[0] - 9.96).abs() < 1e-12);
//! assert!((belief.covariance()?[(0, 0)] - 0.008).abs() < 1e-12);
//!
//! let mut filter = KalmanFilter::from_belief(&belief)?;
//! let innovation = filter.update_scalar(&DVector::from_element(1, 1.0), 12.0, 0.01)?;
//! assert!(innovation.normalized_squared > 100.0); // an outlier: 15 standard deviations
//! # Ok::<(), planish_estimate::Error>(())
//! ```
//!
//! Residuals are measured minus predicted. All values are `f64` in the units of the caller; decisions on rank
//! do not depend on units. The same input gives the same bytes. Results report a failure to converge or an
//! undetermined state. An [`Error`] means that there is no result.

pub mod implicit;
pub mod sparse;

mod batches;
mod belief;
mod conditions;
mod consistency;
mod dense;
mod equation;
mod kalman;
mod least_squares;
mod line_search;
mod reml;
mod robust;
mod smoothness_posterior;
mod variance_components;

pub use batches::{NestedBatches, PairProducts};
pub use belief::{Belief, Information};
pub use conditions::{Condition, adjusted, adjusted_without_conflicts, residual_variance};
pub use consistency::{
    ChiSquareBand, ChiSquareMean, Coverage, Whiteness, chi_square_deviation, normalized_squared, whiteness,
};
pub use equation::{
    Dimensions, Explicit, Implicit, Linear, Linearization, MeasurementEquation, check_jacobians,
};
pub use kalman::{
    EquationUpdate, Innovation, KalmanFilter, Relinearization, ScalarInnovation, joseph_covariance,
};
pub use least_squares::{LeastSquaresFit, LeastSquaresOptions, Measurement, Termination, least_squares};
pub use planish_core::{Error, ErrorKind, Result};
pub use reml::{
    Dispersion, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch, SmoothnessWeight, fellner_schall,
    log_pseudo_determinant, maximize_restricted_likelihood,
};
pub use robust::{
    GatedScale, Loss, LossMoments, StudentTScale, TruncatedNormal, gated_scale, gated_scale_from,
    gated_scale_over_background, median_absolute_deviation, median_magnitude_scale, sandwich_factor,
};
pub use smoothness_posterior::{PenalizedReadings, SmoothnessPosterior};
pub use variance_components::{
    IteratedVarianceComponents, VarianceComponent, VarianceComponents, iterate_variance_components,
};

#[cfg(test)]
mod test_support;
