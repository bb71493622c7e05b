//! The scans, sensors and files of one fit.
//!
//! Readers of lists, such as jobs, use this module without depending on the reading of all formats.

use std::path::PathBuf;

use planish_sense::{Scan, Sensor, SensorKind};

use crate::{GeoReference, Unit};

/// Everything that was read for one fit.
#[derive(Debug, Clone, Default)]
pub struct ScanSet {
    /// The unit of every length, where the caller or a file names it.
    pub unit: Option<Unit>,
    /// The sensors that the scans refer to.
    pub sensors: Vec<Sensor>,
    /// The scans, in the order in which they were named.
    pub scans: Vec<PosedScan>,
    /// The map that the coordinates belong to, where every scan names the same.
    pub georeference: Option<GeoReference>,
    /// Every file that was read, lists before what they list.
    pub inputs: Vec<InputFile>,
}

/// A scan with what its list says about it.
#[derive(Debug, Clone)]
pub struct PosedScan {
    /// The points; `scan.world_from_scanner` holds the pose.
    pub scan: Scan,
    /// Which of the set's sensors took it.
    pub sensor: usize,
    /// Standard deviation of each coordinate of the pose's translation; exact where not stated.
    pub sigma_translation: Option<f64>,
    /// Standard deviation of the pose's rotation about each axis, in degrees; exact where not stated.
    pub sigma_rotation_deg: Option<f64>,
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputFile {
    /// Its path, as it was opened.
    pub path: PathBuf,
    /// How many points it gave; 0 for a list.
    pub points: usize,
    /// How many records were dropped because a coordinate was not finite.
    pub dropped_not_finite: usize,
}

/// The sensor of scans for which none is named: a range sensor whose σ is to be estimated.
pub(crate) fn unnamed_sensor() -> Sensor {
    Sensor {
        name: "scanner".to_owned(),
        kind: SensorKind::Range,
        noise: None,
        ..planish_sense::Sensor::default()
    }
}
