//! Confusion matrix of the automatic choice of a kind at three noise levels, as CSV on stdout.
//!
//! ```text
//! cargo run --release -p planish-contour --example contour_kinds [runs or first..end] [noise,noise,…]
//!     [a shape's name]
//! ```
//!
//! Run `k` of a line has the seed `k`. Lines can therefore be run one by one, and the runs of a line in
//! several parts whose counts add up.

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use planish_contour::planar::{ContourFitOptions, ContourKind, SensorOptions, auto_kinds, choose, ranges};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A measured object: name, kind, parameters, and the centre around which the sensor moves.
struct Truth {
    name: &'static str,
    kind: ContourKind,
    theta: Vec<f64>,
    middle: [f64; 2],
}

fn truths() -> Vec<Truth> {
    let all_around =
        |name, kind, theta: &[f64]| Truth { name, kind, theta: theta.to_vec(), middle: [0.0; 2] };
    let chain = |arcs: &[bool], closed| ContourKind::Chain { arcs: arcs.to_vec(), closed };
    vec![
        all_around("circle", ContourKind::Circle, &[0.0, 0.0, 1.0]),
        all_around("ellipse", ContourKind::Ellipse, &[0.0, 0.0, 1.0, 0.6, 0.5]),
        all_around("rectangle", ContourKind::Rectangle, &[0.0, 0.0, 1.6, 1.2, 0.5]),
        all_around("rounded-rectangle", ContourKind::RoundedRectangle, &[0.0, 0.0, 1.8, 1.2, 0.5, 0.3]),
        all_around("slot", ContourKind::Slot, &[0.0, 0.0, 2.0, 0.9, 0.5]),
        all_around("regular-polygon-6", ContourKind::RegularPolygon(6), &[0.0, 0.0, 1.0, 0.3]),
        all_around("polygon-4", ContourKind::Polygon(4), &[-0.8, -0.7, 0.9, -0.5, 0.6, 0.8, -0.7, 0.5]),
        all_around("polygon-3", ContourKind::Polygon(3), &[-0.9, -0.6, 0.9, -0.7, -0.2, 0.9]),
        all_around(
            "polygon-6 (an L)",
            ContourKind::Polygon(6),
            &[-0.8, -0.8, 0.9, -0.8, 0.9, -0.1, 0.0, -0.1, 0.0, 0.8, -0.8, 0.8],
        ),
        all_around("chain (a D)", chain(&[false, true], true), &[-0.4, 0.8, -0.4, -0.8, 0.9]),
        // From one side.
        Truth {
            name: "chain (an open L)",
            kind: chain(&[false, false], false),
            theta: vec![-1.0, 0.3, 0.1, -0.5, 0.8, 0.7],
            middle: [0.0, 1.0],
        },
        Truth {
            name: "chain (a rounded step)",
            kind: chain(&[false, true, false], false),
            theta: vec![-1.0, -0.4, 0.0, -0.4, 0.5, 0.1, 0.5, 0.9, 0.414_213_562],
            middle: [-1.0, 1.0],
        },
        Truth {
            name: "line",
            kind: chain(&[false], false),
            theta: vec![-1.0, 0.1, 1.0, -0.1],
            middle: [0.0, 1.0],
        },
    ]
}

/// `n` for the seeds `0..n`, or `a..b`.
fn seeds(text: &str) -> Option<std::ops::Range<u64>> {
    match text.split_once("..") {
        Some((first, end)) => Some(first.parse().ok()?..end.parse().ok()?),
        None => Some(0..text.parse().ok()?),
    }
}

fn main() {
    let argument = |k: usize| std::env::args().nth(k);
    let runs = argument(1).map_or(Some(0..20), |a| seeds(&a)).expect("a number of runs, or first..end");
    let noises = argument(2).unwrap_or_else(|| "0.1,0.3,1".to_owned());
    println!("noise,truth,runs,found: count");
    let begun = std::time::Instant::now();
    let mut all = 0;
    for noise in noises.split(',').filter_map(|n| n.parse::<f64>().ok()) {
        for truth in truths() {
            if argument(3).is_some_and(|name| name != truth.name) {
                continue;
            }
            let sensor = SensorOptions::around(1.0, noise);
            let names: Vec<String> = runs
                .clone()
                .into_par_iter()
                .map(|run| {
                    let made = ranges(&truth.kind, &truth.theta, truth.middle, 200, &sensor, run);
                    choose(&auto_kinds(), true, &made.noisy, &ContourFitOptions::default())
                        .map_or_else(|_| "none".to_owned(), |choice| choice.fit.kind.to_string())
                })
                .collect();
            let mut counts: BTreeMap<String, usize> = BTreeMap::new();
            for name in names {
                *counts.entry(name).or_default() += 1;
            }
            let found: Vec<String> = counts.iter().map(|(name, n)| format!("{name}: {n}")).collect();
            let n = runs.end - runs.start;
            println!("{noise},{},{n},{}", truth.name, found.join("; "));
            all += n;
        }
    }
    println!(
        "# {:.3} s a run on {} threads",
        begun.elapsed().as_secs_f64() * rayon::current_num_threads() as f64 / all as f64,
        rayon::current_num_threads()
    );
}
