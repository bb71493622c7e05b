//! Readings of a fit: intake, errors common to a scan, and feet on a surface.
//!
//! Input: a [`ScanSet`](planish_exchange::ScanSet). Output: [`Observations`], readings in the world frame
//! with their covariances, and for a given surface the foot points and equations of all of them.
//!
//! | module | purpose |
//! |---|---|
//! | domain | range of numbers that a fit accepts |
//! | observations | checks of scans, duplicates, normals, channels, held-out readings |
//! | quantity, rejection | what readings measure, and why they are rejected |
//! | scan_errors | errors common to all readings of a scan: poses and biases |
//! | feet | projection of readings on a surface, their residuals and equations |
//! | step | one Gauss–Newton step of the surface |

mod domain;
mod feet;
mod hashing;
mod observations;
mod quantity;
mod rejection;
mod scan_errors;
mod step;

pub use domain::check_domain;
pub use feet::surface_extent;
pub(crate) use feet::*;
pub(crate) use hashing::{BitsHasher, hash01};
pub(crate) use observations::has_ground;
pub use observations::{
    InferredReading, InferredVariance, IntakeFigures, ObservationOptions, Observations, ReadingColumns,
    ScanColumns,
};
pub(crate) use quantity::Measured;
pub use quantity::{Channel, Quantity};
pub use rejection::RejectionCause;
pub(crate) use scan_errors::{Linearized, ScanErrors};
pub(crate) use step::{FootChannels, StepInput, normal_step};
