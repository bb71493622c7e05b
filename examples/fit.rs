//! Fits a surface to points in memory from two sensors, one of which states a wrong σ.
//!
//! `cargo run --release -p planish --example fit`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::fit::{FitOptions, fit};
use planish::progress::Silent;
use planish::{Result, Unit, saved};
use planish_core::DVec3;
use planish_exchange::{PosedScan, ScanSet};
use planish_sense::{Noise, Scan, Sensor, SensorKind};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use std::path::Path;

/// Height of the object, a wavy sheet of 80 by 60 mm.
fn height(x: f64, y: f64) -> f64 {
    3.0 * (x / 9.0).sin() * (y / 12.0).cos()
}

fn main() -> Result<()> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    // Name, stated σ and true σ. The second sensor states a wrong σ.
    let sensors = [("laser", 0.05, 0.05), ("camera", 0.10, 0.30)];
    let mut set = ScanSet { unit: Some(Unit::Millimetre), ..ScanSet::default() };
    for (k, (name, stated, true_sigma)) in sensors.into_iter().enumerate() {
        set.sensors.push(Sensor {
            name: name.to_owned(),
            kind: SensorKind::Range,
            noise: Some(Noise::Isotropic { sigma: stated }),
            ..Sensor::default()
        });
        let error = Normal::new(0.0, true_sigma).expect("a positive σ");
        let points = (0..4000)
            .map(|_| {
                let (x, y) = (80.0 * random.random::<f64>(), 60.0 * random.random::<f64>());
                DVec3::from_array(
                    [x, y, height(x, y)].map(|coordinate| coordinate + error.sample(&mut random)),
                )
            })
            .collect();
        set.scans.push(PosedScan {
            scan: Scan { name: name.to_owned(), points, ..Scan::default() },
            sensor: k,
            sigma_translation: None,
            sigma_rotation_deg: None,
        });
    }

    let found = fit(&set, &FitOptions::default(), &Silent)?;
    let report = &found.report;
    println!(
        "{} with {} control vertices, median σ {:.4} mm",
        report.topology, report.coefficients, report.sigma.median
    );
    for sensor in &report.sensors {
        println!(
            "{}: stated σ {:.2}, estimated {:.3}",
            sensor.name,
            sensor.sigma_stated.unwrap_or(f64::NAN),
            sensor.sigma_estimated
        );
    }
    // The model includes its covariance. `planish compare`, `next` and `fit --update` can read it.
    saved::save(&found.model, &[], Path::new("sheet.planish"))
}
