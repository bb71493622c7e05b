//! Identifies a contour from readings of a sensor with an uncertain pose, and prints its sizes with σ.
//!
//! `cargo run --release -p planish-contour --example contour`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish_contour::planar::{ContourFitOptions, ContourKind, SensorOptions, auto_kinds, choose, ranges};
use planish_estimate::Result;

fn main() -> Result<()> {
    // 300 readings of a slot of 1.8 by 0.8, rotated by 0.4 rad. Position, heading and range have errors.
    let truth = [0.0, 0.0, 1.8, 0.8, 0.4];
    let sensor = SensorOptions::around(1.0, 0.5);
    let readings = ranges(&ContourKind::Slot, &truth, [0.0; 2], 300, &sensor, 7).noisy;

    // Try all types, including chains of lines and arcs. The result is the one with the lowest BIC.
    let choice = choose(&auto_kinds(), true, &readings, &ContourFitOptions::default())?;
    let fit = &choice.fit;
    println!("{}; the BIC of the next best type is {:.1} larger", fit.kind, choice.bic_margin.unwrap_or(0.0));
    for (k, truth) in truth.iter().enumerate() {
        println!("{:.4} ± {:.4} (true value {truth})", fit.state[k], fit.covariance[(k, k)].sqrt());
    }
    Ok(())
}
