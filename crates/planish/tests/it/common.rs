//! Helpers that several tests share.

use planish_core::DVec3;
use planish_exchange::{PosedScan, ScanSet};
use planish_sense::{Noise, Scan, Sensor, SensorKind};

/// One cloud of a touch probe, without grid and viewpoint; σ stated or not.
pub fn probed(points: Vec<DVec3>, normals: Option<Vec<DVec3>>, sigma: Option<f64>) -> ScanSet {
    ScanSet {
        sensors: vec![Sensor {
            name: "probe".to_owned(),
            kind: SensorKind::Touch,
            noise: sigma.map(|sigma| Noise::Isotropic { sigma }),
            ..planish_sense::Sensor::default()
        }],
        scans: vec![PosedScan {
            scan: Scan { name: "cloud".to_owned(), points, normals, ..Scan::default() },
            sensor: 0,
            sigma_translation: None,
            sigma_rotation_deg: None,
        }],
        ..ScanSet::default()
    }
}
