//! Estimation for Planish: every measurement is an equation, and information adds.
//!
//! This crate knows no geometry. Models plug in through one interface, the measurement equation
//! `g(z − v, x) = 0` with noise `v ~ N(0, R)`; everything else is done to its linearisation:
//!
//! ```text
//! MeasurementEquation ─► Linearization ─┬─► Information ─► Belief            merge, update, marginals
//!                                       ├─► KalmanFilter             one at a time, EKF, IEKF, NUIEKF
//!                                       └─► least_squares                    a batch, with robust losses
//! residuals ─► Loss, TruncatedNormal, VarianceComponents, SmoothnessModel    checks of the stated σ
//! deviations ─► ChiSquareMean, Coverage, whiteness                           whether they were
//! ```
//!
//! Small states are dense; [`sparse`] holds the information of large ones.
//!
//! Residuals are measured minus predicted. Everything is `f64`; units are the caller's, and no judgement of
//! rank depends on them. The same input gives the same bytes. What is not converged or not determined is told
//! in the result; an [`Error`] is for what has no result.

pub mod implicit;
pub mod sparse;
pub use planish_core::vector3;

mod batches;
mod belief;
mod consistency;
mod dense;
mod equation;
mod kalman;
mod least_squares;
mod line_search;
mod reml;
mod robust;
mod variance_components;

pub use batches::{NestedBatches, PairProducts};
pub use belief::{Belief, Information};
pub use consistency::{ChiSquareBand, ChiSquareMean, Coverage, Whiteness, normalized_squared, whiteness};
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
    GatedScale, Loss, LossMoments, StudentTScale, TruncatedNormal, gated_scale, median_absolute_deviation,
    median_magnitude_scale, sandwich_factor,
};
pub use variance_components::{
    IteratedVarianceComponents, VarianceComponent, VarianceComponents, iterate_variance_components,
};

#[cfg(test)]
mod test_support;
