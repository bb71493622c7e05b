//! The scans, sensors and files of one fit.
//!
//! Readers of lists, such as jobs, use this module without depending on the reading of all formats.

use std::path::PathBuf;

use planish_core::random::{GOLDEN_GAMMA, mix64};
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
    /// Hash of the coordinates of the points, which recognises the same readings in another file; 0 for a
    /// list.
    pub points_hash: u64,
}

impl InputFile {
    /// A list, which has no points itself.
    pub(crate) fn list(path: PathBuf) -> Self {
        Self { path, points: 0, dropped_not_finite: 0, points_hash: 0 }
    }

    /// A file with scans.
    pub(crate) fn with_scans(path: PathBuf, scans: &[Scan]) -> Self {
        let points = scans.iter().flat_map(|scan| &scan.points);
        let mut points_hash = 0;
        for word in points.clone().flat_map(|p| p.to_array()) {
            points_hash = mix64(u64::wrapping_add(points_hash, GOLDEN_GAMMA) ^ word.to_bits());
        }
        Self {
            path,
            points: points.count(),
            dropped_not_finite: scans.iter().map(|scan| scan.dropped_not_finite).sum(),
            points_hash,
        }
    }
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
