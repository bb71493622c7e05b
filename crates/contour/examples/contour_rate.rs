//! Readings per second of the recursive filters and of the batch, on one core.
//!
//! `cargo run --release -p planish-contour --example contour_rate`

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use planish_contour::planar::{ContourFitOptions, ContourKind, Method, SensorOptions, fit, ranges};
use std::time::Instant;

fn main() {
    let sensor = SensorOptions::around(1.0, 1.0);
    for (kind, theta) in [
        (ContourKind::Circle, vec![0.0, 0.0, 1.0]),
        (ContourKind::Ellipse, vec![0.0, 0.0, 1.0, 0.6, 0.5]),
        (ContourKind::Rectangle, vec![0.0, 0.0, 1.6, 1.2, 0.5]),
    ] {
        let made = ranges(&kind, &theta, [0.0; 2], 100_000, &sensor, 1);
        for (method, correct_bias) in
            [(Method::NoiseUpdated, true), (Method::NoiseUpdated, false), (Method::Extended, false)]
        {
            let options = ContourFitOptions {
                method,
                gate: None,
                correct_bias,
                start: Some(theta.clone()),
                ..ContourFitOptions::default()
            };
            let begun = Instant::now();
            let found = fit(&kind, &made.noisy, &options);
            let seconds = begun.elapsed().as_secs_f64();
            // The time includes the final evaluation of all distances.
            println!(
                "{kind} {method:?} bias corrected {correct_bias}: {:.0} readings/s ({})",
                1e5 / seconds,
                found.is_ok()
            );
        }
    }
}
