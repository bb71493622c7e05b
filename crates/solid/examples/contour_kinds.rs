//! How often `--kind auto` finds the kind that was measured, as CSV on stdout: a confusion matrix for three noise levels.
//!
//! `cargo run --release -p planish-solid --example contour_kinds [runs]`

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use planish_solid::contour::{FitOptions, Kind, SensorOptions, auto_kinds, choose, ranges};
use rayon::prelude::*;
use std::collections::BTreeMap;

fn main() {
    let runs: u64 = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(20);
    let shapes = [
        (Kind::Circle, vec![0.0, 0.0, 1.0]),
        (Kind::Ellipse, vec![0.0, 0.0, 1.0, 0.6, 0.5]),
        (Kind::Rectangle, vec![0.0, 0.0, 1.6, 1.2, 0.5]),
        (Kind::RoundedRectangle, vec![0.0, 0.0, 1.8, 1.2, 0.5, 0.3]),
        (Kind::Slot, vec![0.0, 0.0, 2.0, 0.9, 0.5]),
        (Kind::RegularPolygon(6), vec![0.0, 0.0, 1.0, 0.3]),
        (Kind::Polygon(4), vec![-0.8, -0.7, 0.9, -0.5, 0.6, 0.8, -0.7, 0.5]),
    ];
    println!("noise,truth,runs,found: count");
    let begun = std::time::Instant::now();
    let mut all = 0;
    for noise in [0.1, 0.3, 1.0] {
        for (kind, theta) in &shapes {
            let sensor = SensorOptions::around(1.0, noise);
            let names: Vec<String> = (0..runs)
                .into_par_iter()
                .map(|run| {
                    let made = ranges(kind, theta, [0.0; 2], 200, &sensor, run);
                    choose(&auto_kinds(), true, &made.noisy, &FitOptions::default())
                        .map_or_else(|_| "none".to_owned(), |choice| choice.fit.kind.to_string())
                })
                .collect();
            let mut counts: BTreeMap<String, usize> = BTreeMap::new();
            for name in names {
                *counts.entry(name).or_default() += 1;
            }
            let said: Vec<String> = counts.iter().map(|(name, n)| format!("{name}: {n}")).collect();
            println!("{noise},{kind},{runs},{}", said.join("; "));
            all += runs;
        }
    }
    println!(
        "# {:.3} s a run on {} threads",
        begun.elapsed().as_secs_f64() * rayon::current_num_threads() as f64 / all as f64,
        rayon::current_num_threads()
    );
}
