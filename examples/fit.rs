//! A surface from points in memory: two sensors, one of which states a σ that is not true.
//!
//! `cargo run --release -p planish --example fit`

#![allow(clippy::print_stdout, reason = "a program whose output is what it has to say")]

use planish::fit::{FitOptions, fit};
use planish::progress::Silent;
use planish::{Result, Unit, saved};
use planish_exchange::{PosedScan, ScanSet};
use planish_sense::{Noise, Scan, Sensor, SensorKind};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use std::path::Path;

/// What is measured: a wavy sheet of 80 by 60 mm.
fn height(x: f64, y: f64) -> f64 {
    3.0 * (x / 9.0).sin() * (y / 12.0).cos()
}

fn main() -> Result<()> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    // Each sensor says how good it is; the second one is wrong about that.
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
                [x, y, height(x, y)].map(|coordinate| coordinate + error.sample(&mut random))
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
        "a {} of {} control vertices, σ {:.4} mm in the median",
        report.shape, report.coefficients, report.sigma.median
    );
    for sensor in &report.sensors {
        println!(
            "{}: σ stated {:.2}, found {:.3}",
            sensor.name,
            sensor.sigma_stated.unwrap_or(f64::NAN),
            sensor.sigma_estimated
        );
    }
    // The model with its covariance; `planish compare`, `next` and `fit --update` go on from it.
    saved::save(&found.model, &[], Path::new("sheet.planish"))
}
