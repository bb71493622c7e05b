//! Which contour a sensor of uncertain pose saw, and how well its sizes are known.
//!
//! `cargo run --release -p planish-solid --example contour`

#![allow(clippy::print_stdout, reason = "a program whose output is what it has to say")]

use planish_contour::planar::{FitOptions, Kind, SensorOptions, auto_kinds, choose, ranges};
use planish_estimate::Result;

fn main() -> Result<()> {
    // Three hundred readings of a slot of 1.8 by 0.8, turned by 0.4, with errors of place, heading and range.
    let truth = [0.0, 0.0, 1.8, 0.8, 0.4];
    let sensor = SensorOptions::around(1.0, 0.5);
    let readings = ranges(&Kind::Slot, &truth, [0.0; 2], 300, &sensor, 7).noisy;

    // All kinds are tried, chains of lines and arcs among them; the best explains the readings with the
    // fewest numbers.
    let choice = choose(&auto_kinds(), true, &readings, &FitOptions::default())?;
    let fit = &choice.fit;
    println!("{}; the next best kind has a BIC {:.1} larger", fit.kind, choice.bic_margin.unwrap_or(0.0));
    for (k, truth) in truth.iter().enumerate() {
        println!("{:.4} ± {:.4}, truly {truth}", fit.state[k], fit.covariance[(k, k)].sqrt());
    }
    Ok(())
}
