//! Bias, RMSE relative to the Kanatani–Cramér–Rao bound, and NEES of EKF, IEKF, NUIEKF and batch.
//!
//! ```text
//! cargo run --release -p planish-contour --example contour_accuracy [runs] [radius|diameter|noise factor]
//!     [circle,ellipse,…|all] [50,200,…|all] [ekf,batch,…|all] [folder]
//! ```
//!
//! Writes CSV to stdout. The second argument selects the size of the object, which scales the standoff (three
//! sizes) and the pose noise (2 %). The readings of all runs are written into the folder, for other programs.

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use nalgebra::DVector;
use planish_contour::planar::{
    ContourFitOptions, ContourKind, ContourReading, ContourTarget, Method, SensorOptions, bound, fit, ranges,
};
use planish_estimate::normalized_squared;
use rayon::prelude::*;
use std::fmt::Write as _;

/// Contours of circumradius 1 about the origin: kind, parameters, period of the angle, and its index.
fn contours() -> Vec<(ContourKind, Vec<f64>, f64)> {
    let pi = std::f64::consts::PI;
    vec![
        (ContourKind::Circle, vec![0.0, 0.0, 1.0], 0.0),
        (ContourKind::Ellipse, vec![0.0, 0.0, 1.0, 0.6, 0.5], pi),
        (ContourKind::Rectangle, vec![0.0, 0.0, 1.6, 1.2, 0.5], pi),
        (ContourKind::RegularPolygon(6), vec![0.0, 0.0, 1.0, 0.3], pi / 3.0),
    ]
}

fn main() {
    let mut args = std::env::args().skip(1);
    let runs: usize = args.next().and_then(|a| a.parse().ok()).unwrap_or(100);
    // A number scales all noise, at a standoff of three radii.
    let (size, noise) = match args.next().as_deref() {
        None | Some("diameter") => (2.0, 1.0),
        Some("radius") => (1.0, 1.0),
        Some(factor) => (1.0, factor.parse().unwrap_or(1.0)),
    };
    let mut list = || args.next().filter(|a| a != "all");
    let (chosen, numbers, methods, folder) = (list(), list(), list(), list());
    let has =
        |list: &Option<String>, name: &str| list.as_ref().is_none_or(|l| l.split(',').any(|one| one == name));
    let sensor = SensorOptions::around(size, noise);
    println!(
        "kind,readings,method,runs,failed,bias_over_kcr,bias_of_size_over_kcr,rmse_over_kcr,\
         scatter_over_kcr,nees_per_unknown,median_rmse_over_kcr,biases_over_kcr"
    );
    for (kind, truth, period) in contours() {
        if !has(&chosen, kind.family()) {
            continue;
        }
        for n in [50, 200, 2000].into_iter().filter(|n| has(&numbers, &n.to_string())) {
            if let Some(folder) = &folder {
                write_dump(folder, &kind, &truth, n, runs, &sensor);
            }
            let all = [
                ("ekf", Method::Extended, false, None),
                ("iekf", Method::Iterated, false, None),
                ("nuiekf", Method::NoiseUpdated, true, None),
                ("batch", Method::Batch, true, None),
                ("batch-uncorrected", Method::Batch, false, None),
                ("nuiekf-margin", Method::NoiseUpdated, true, Some(2.0)),
                ("auto", Method::Combined, true, None),
                ("batch-margin", Method::Batch, true, Some(2.0)),
            ];
            // Few readings all count.
            let has_corners =
                matches!(kind, ContourKind::Rectangle | ContourKind::RegularPolygon(_)) && n > 50;
            for (name, method, correct_bias, corner_margin) in
                all.into_iter().filter(|m| has(&methods, m.0) && (m.3.is_none() || has_corners))
            {
                let options = ContourFitOptions {
                    method,
                    gate: None,
                    corner_margin,
                    correct_bias,
                    ..ContourFitOptions::default()
                };
                let outcomes: Vec<Option<Outcome>> = (0..runs)
                    .into_par_iter()
                    .map(|run| one(&kind, &truth, period, n, &sensor, &options, run as u64))
                    .collect();
                print_row(&kind, n, name, &outcomes);
            }
        }
    }
}

/// Errors divided by σ of the bound, errors whitened by the bound, NEES, and the mean square of the whitened
/// ones.
struct Outcome {
    normalized: Vec<f64>,
    whitened: DVector<f64>,
    nees: f64,
    squared: f64,
}

fn one(
    kind: &ContourKind,
    truth: &[f64],
    period: f64,
    n: usize,
    sensor: &SensorOptions,
    options: &ContourFitOptions,
    run: u64,
) -> Option<Outcome> {
    let made = ranges(kind, truth, [0.0; 2], n, sensor, run);
    let kcr = bound(kind, truth, &made.exact).ok()?;
    let found = fit(kind, &made.noisy, options).ok()?;
    let truth = DVector::from_column_slice(truth);
    let mut off = &found.state - &truth;
    if period > 0.0 {
        let k = truth.len() - 1;
        let mut swapped = found.state.clone();
        if matches!(kind, ContourKind::Ellipse | ContourKind::Rectangle) && found.state[2] < found.state[3] {
            swapped.swap_rows(2, 3);
            swapped[k] += std::f64::consts::FRAC_PI_2;
            off = &swapped - &truth;
        }
        off[k] = (off[k] + 0.5 * period).rem_euclid(period) - 0.5 * period;
    }
    let whitened = kcr.clone().cholesky()?.l().solve_lower_triangular(&off)?;
    Some(Outcome {
        normalized: (0..off.len()).map(|k| off[k] / kcr[(k, k)].sqrt()).collect(),
        nees: normalized_squared(&off, &found.covariance).ok()?,
        squared: whitened.norm_squared() / off.len() as f64,
        whitened,
    })
}

fn print_row(kind: &ContourKind, n: usize, name: &str, outcomes: &[Option<Outcome>]) {
    let good: Vec<&Outcome> = outcomes.iter().flatten().collect();
    let count = good.len() as f64;
    let unknowns = good.first().map_or(1, |o| o.normalized.len());
    let mean = |k: usize| good.iter().map(|o| o.normalized[k]).sum::<f64>() / count;
    let bias = (0..unknowns).map(|k| mean(k).abs()).fold(0.0, f64::max);
    // Scatter about the mean error, whitened by the bound.
    let middle = good.iter().fold(DVector::zeros(unknowns), |sum: DVector<f64>, o| sum + &o.whitened) / count;
    let spread: f64 = good.iter().map(|o| (&o.whitened - &middle).norm_squared()).sum();
    let scatter = (spread / ((count - 1.0).max(1.0) * unknowns as f64)).sqrt();
    let all = (good.iter().map(|o| o.squared).sum::<f64>() / count).sqrt();
    let mut squares: Vec<f64> = good.iter().map(|o| o.squared).collect();
    squares.sort_by(f64::total_cmp);
    let nees = good.iter().map(|o| o.nees).sum::<f64>() / (count * unknowns as f64);
    println!(
        "{kind},{n},{name},{},{},{bias:.3},{:.3},{all:.3},{scatter:.3},{nees:.3},{:.3},{}",
        outcomes.len(),
        outcomes.len() - good.len(),
        mean(2),
        squares.get(squares.len() / 2).copied().unwrap_or(f64::NAN).sqrt(),
        (0..unknowns).map(|k| format!("{:+.2}", mean(k))).collect::<Vec<_>>().join(" ")
    );
}

/// Writes the readings of all runs, with and without errors: one CSV file per contour and number of readings.
fn write_dump(
    folder: &str,
    kind: &ContourKind,
    truth: &[f64],
    n: usize,
    runs: usize,
    sensor: &SensorOptions,
) {
    let mut text = String::from("run,x,y,heading_deg,range,sigma_x,sigma_y,sigma_heading_deg,sigma_range");
    text.push_str(",exact_x,exact_y,exact_heading_deg,exact_range\n");
    let columns = |reading: &ContourReading| match reading.target {
        ContourTarget::Range { origin, heading_rad, range, sigma: [x, y, heading, along] } => (
            format!("{},{},{},{range}", origin[0], origin[1], heading_rad.to_degrees()),
            format!("{x},{y},{},{along}", heading.to_degrees()),
        ),
        ContourTarget::Point { .. } => (String::new(), String::new()),
    };
    for run in 0..runs {
        let made = ranges(kind, truth, [0.0; 2], n, sensor, run as u64);
        for (noisy, exact) in made.noisy.iter().zip(&made.exact) {
            let (read, sigma) = columns(noisy);
            let _ = writeln!(text, "{run},{read},{sigma},{}", columns(exact).0);
        }
    }
    if let Err(e) = std::fs::write(format!("{folder}/{kind}-{n}.csv"), text) {
        println!("# {folder}: {e}");
    }
}
