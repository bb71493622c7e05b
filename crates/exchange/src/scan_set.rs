//! The scans, sensors and files of one fit.
//!
//! Readers of lists, such as jobs, use this module without depending on the reading of all formats.

use std::path::PathBuf;

use planish_sense::{Scan, Sensor, SensorKind};

use crate::{GeoReference, Unit};

/// All scans, sensors and files of one fit.
#[derive(Debug, Clone, Default)]
pub struct ScanSet {
    /// The unit of every length, if the caller or a file states it.
    pub unit: Option<Unit>,
    /// The sensors that the scans refer to.
    pub sensors: Vec<Sensor>,
    /// The scans, in the order of the paths and lists.
    pub scans: Vec<PosedScan>,
    /// The map projection of the coordinates, if all scans state the same one.
    pub georeference: Option<GeoReference>,
    /// Every file that was read; lists come before the files that they name.
    pub inputs: Vec<InputFile>,
}

/// A scan with the settings of its list entry.
#[derive(Debug, Clone)]
pub struct PosedScan {
    /// The points and, in `scan.world_from_scanner`, the pose.
    pub scan: Scan,
    /// Index into [`ScanSet::sensors`].
    pub sensor: usize,
    /// Standard deviation of each coordinate of the translation; none for an exact pose.
    pub sigma_translation: Option<f64>,
    /// Standard deviation of the rotation about each axis, in degrees; none for an exact pose.
    pub sigma_rotation_deg: Option<f64>,
}

/// A file that was read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputFile {
    /// Its path, as it was opened.
    pub path: PathBuf,
    /// Number of points; 0 for a list.
    pub points: usize,
    /// Number of records dropped because a coordinate was not finite.
    pub dropped_not_finite: usize,
}

/// Sensor of scans for which none is named: a range sensor whose σ is estimated.
pub(crate) fn unnamed_sensor() -> Sensor {
    Sensor {
        name: "scanner".to_owned(),
        kind: SensorKind::Range,
        noise: None,
        ..planish_sense::Sensor::default()
    }
}
