//! Fusing scans into a surface.
mod observations;
pub use observations::{ObservationOptions, Observations, Rejection};
mod engine;
mod growth;
mod indicator;
mod evolve;
pub use evolve::debug_fit;
