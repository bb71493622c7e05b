//! Sensors: what a scan is, how its errors are modelled, and which readings are not to be trusted.

mod pose;
mod scan;

pub use pose::Pose;
pub use scan::{RangeGrid, Scan, Viewing};
