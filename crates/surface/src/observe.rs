//! Readings of a fit: intake, errors that a scan shares, and feet on a surface.
//!
//! Input: a [`ScanSet`](planish_exchange::ScanSet). Output: [`Observations`], readings in the world frame with
//! their covariances, and for a given surface the foot points and equations of all of them.
//!
//! | module | purpose |
//! |---|---|
//! | domain | range of numbers that a fit accepts |
//! | observations | checks of scans, outlier classes, channels, held-out readings |
//! | scan_errors | errors that all readings of a scan share: poses and biases |
//! | feet | one iteration: project readings, weigh them, accumulate and solve the equations |

mod domain;
mod feet;
mod observations;
mod scan_errors;
mod step;

pub use domain::check_domain;
pub use feet::surface_extent;
pub(crate) use feet::*;
pub(crate) use observations::{BitsHasher, Measured, has_ground, hash01, moved_viewing};
pub use observations::{
    InferredReading, InferredVariance, ObservationOptions, Observations, Quantity, RejectionCause,
};
pub(crate) use scan_errors::{Linearized, ScanErrors};
pub(crate) use step::{FootChannels, StepInput, normal_step};
