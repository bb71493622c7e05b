//! Error and coverage for moving contours, shared poses, points, the product form and primitives in space.
//!
//! `cargo run --release -p planish-contour --example contour_lines [runs] [part with_motion a line's name]`
//!
//! Writes one line per case as CSV to stdout. Errors are root mean squares divided by the stated σ, parameter
//! by parameter. Coverage is the fraction of errors within 1.96 σ.

#![allow(clippy::print_stdout, reason = "a program whose output is its table")]

use planish_contour::planar::{
    ContourFitOptions, ContourKind, ContourReading, Form, Method, PlanarMotion, SensorOptions, fit, points,
    ranges,
};
use planish_contour::primitive::{self, PrimitiveKind, SimulatedPrimitive, SpaceSensor};
use planish_core::DVec3;
use rayon::prelude::*;

/// Errors of one run divided by their σ; `None` if the fit failed.
type Errors = Option<Vec<f64>>;

fn main() {
    let runs: u64 = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(100);
    let still = SensorOptions::around(1.0, 1.0);
    let exact =
        SensorOptions { sigma: [0.006, 0.006, 0.6f64.to_radians(), 0.0], sigma_range_share: 0.003, ..still };
    println!("what,readings,runs,failed,errors_over_sigma,coverage_95,largest_rms");
    let circle = (ContourKind::Circle, vec![0.1, -0.2, 1.0]);
    let ellipse = (ContourKind::Ellipse, vec![0.1, -0.2, 1.0, 0.6, 0.5]);
    let rectangle = (ContourKind::Rectangle, vec![0.1, -0.2, 1.6, 1.2, 0.5]);
    let planar = |name: &str,
                  (kind, theta): &(ContourKind, Vec<f64>),
                  sensor: &SensorOptions,
                  options: &ContourFitOptions,
                  n: usize| {
        let extra = sensor.velocity[..options.motion.unknowns()].to_vec();
        let truth = [theta.clone(), extra].concat();
        table(name, n, runs, |seed| {
            let made = ranges(kind, theta, [0.1, -0.2], n, sensor, seed);
            planar_errors(kind, &made.noisy, options, &truth)
        });
    };
    let moving = |velocity: [f64; 3]| SensorOptions { velocity, ..still };
    let with_motion = |motion| ContourFitOptions { motion, ..ContourFitOptions::default() };
    planar("circle moving", &circle, &moving([0.2, -0.1, 0.0]), &with_motion(PlanarMotion::Linear), 200);
    planar("ellipse moving", &ellipse, &moving([0.2, -0.1, 0.0]), &with_motion(PlanarMotion::Linear), 200);
    rigid(runs, &ellipse, &moving([0.2, -0.1, 0.1]));
    planar(
        "rectangle moving",
        &rectangle,
        &moving([0.2, -0.1, 0.0]),
        &with_motion(PlanarMotion::Linear),
        200,
    );
    let shared = SensorOptions { sweep: 10, ..still };
    planar("circle; ten readings a pose", &circle, &shared, &ContourFitOptions::default(), 200);
    for (name, (kind, theta)) in
        [("circle overhead", &circle), ("ellipse overhead", &ellipse), ("rectangle overhead", &rectangle)]
    {
        table(name, 200, runs, |seed| {
            let made = points(kind, theta, 200, 0.02, seed);
            planar_errors(kind, &made.noisy, &ContourFitOptions::default(), theta)
        });
    }
    for (method, name) in [(Method::Batch, "batch"), (Method::NoiseUpdated, "nuiekf")] {
        for (form, form_name) in [(Form::ActiveFacet, "active facet"), (Form::Product, "product")] {
            for (sensor, noise) in [(&exact, "0.3 of the noise"), (&still, "all of the noise")] {
                let options = ContourFitOptions { form, method, ..ContourFitOptions::default() };
                let name = format!("rectangle; {method}; {form_name}; {noise}", method = name);
                planar(&name, &rectangle, sensor, &options, 200);
            }
        }
    }
    in_space(runs);
}

/// Only axes and rotation rate: the fit rotates about the mean of the readings, the simulation about the
/// origin, so that their velocities differ.
fn rigid(runs: u64, (kind, theta): &(ContourKind, Vec<f64>), sensor: &SensorOptions) {
    let options = ContourFitOptions { motion: PlanarMotion::Rigid, ..ContourFitOptions::default() };
    table("ellipse moving and turning (its shape and turn)", 200, runs, |seed| {
        let made = ranges(kind, theta, [0.1, -0.2], 200, sensor, seed);
        let found = fit(kind, &made.noisy, &options).ok()?;
        // These do not depend on the centre of rotation.
        let k = kind.parameters();
        let (values, from) = kind.canonical(&found.state.as_slice()[..k]);
        let sigma = |i: usize| found.covariance[(i, i)].sqrt();
        let axis = |i: usize| (values[i] - theta[i]) / sigma(from[i].0);
        let turn = (found.state[k + 2] - sensor.velocity[2]) / sigma(k + 2);
        let each = [axis(2), axis(3), turn];
        Some(each.to_vec())
    });
}

fn planar_errors(
    kind: &ContourKind,
    readings: &[ContourReading],
    options: &ContourFitOptions,
    truth: &[f64],
) -> Errors {
    let found = fit(kind, readings, options).ok()?;
    let k = kind.parameters();
    let (values, from) = kind.canonical(&found.state.as_slice()[..k]);
    let (right, _) = kind.canonical(&truth[..k]);
    let errors = (0..truth.len()).map(|i| {
        if i >= k {
            return (found.state[i] - truth[i]) / found.covariance[(i, i)].sqrt();
        }
        let mut off = values[i] - right[i];
        if i == 4 {
            off -= std::f64::consts::PI * (off / std::f64::consts::PI).round();
        }
        off / found.covariance[(from[i].0, from[i].0)].sqrt()
    });
    Some(errors.collect())
}

fn in_space(runs: u64) {
    let sensor = SpaceSensor {
        standoff: 3.0,
        sigma_position: 0.02,
        sigma_angle_rad: 2f64.to_radians(),
        sigma_range_share: 0.01,
    };
    for (shape, size) in [
        (PrimitiveKind::Plane, [1.5, 1.2, 0.0]),
        (PrimitiveKind::Sphere, [0.8, 0.0, 0.0]),
        (PrimitiveKind::Cylinder, [0.6, 1.6, 0.0]),
        (PrimitiveKind::Box, [1.4, 1.0, 0.8]),
    ] {
        let solid = SimulatedPrimitive {
            shape,
            center: DVec3::new(0.3, -0.2, 0.5),
            turn: DVec3::new(0.3, -0.5, 0.7),
            size,
        };
        let truth = solid.parameters();
        for (method, name) in [(Method::Batch, "batch"), (Method::NoiseUpdated, "nuiekf")] {
            let options = ContourFitOptions { method, ..ContourFitOptions::default() };
            table(&format!("{shape} in space; {name}"), 400, runs, |seed| {
                let made = primitive::rays(&solid, 400, &sensor, seed);
                let found = primitive::fit(shape, &made.noisy, &options).ok()?;
                // The point on the axis of a cylinder depends on the readings.
                let first = if shape == PrimitiveKind::Cylinder { 3 } else { 0 };
                // Of a direction the sign is a matter of convention.
                let sign = |k: usize| {
                    let first = match shape {
                        PrimitiveKind::Plane => 0,
                        PrimitiveKind::Box if k >= 6 => k - k % 3,
                        _ => return 1.0,
                    };
                    let along: f64 = (first..first + 3).map(|i| found.parameters[i] * truth[i]).sum();
                    along.signum()
                };
                let error =
                    |k: usize| (sign(k) * found.parameters[k] - truth[k]) / found.covariance[(k, k)].sqrt();
                Some((first..truth.len()).map(error).collect())
            });
        }
    }
}

fn table(name: &str, readings: usize, runs: u64, one: impl Fn(u64) -> Errors + Sync) {
    if std::env::args().nth(2).is_some_and(|part| !name.contains(&part)) {
        return;
    }
    let all: Vec<Errors> = (0..runs).into_par_iter().map(&one).collect();
    let good: Vec<&Vec<f64>> = all.iter().flatten().collect();
    let count = good.len() as f64;
    let unknowns = good.first().map_or(0, |errors| errors.len());
    let rms = |k: usize| (good.iter().map(|e| e[k] * e[k]).sum::<f64>() / count).sqrt();
    let each: Vec<f64> = (0..unknowns).map(rms).collect();
    let within = good.iter().flat_map(|e| e.iter()).filter(|e| e.abs() < 1.96).count();
    println!(
        "{name},{readings},{},{},{},{:.3},{:.2}",
        runs,
        all.len() - good.len(),
        each.iter().map(|e| format!("{e:.2}")).collect::<Vec<_>>().join(" "),
        within as f64 / (count * unknowns as f64),
        each.iter().copied().fold(0.0, f64::max)
    );
}
