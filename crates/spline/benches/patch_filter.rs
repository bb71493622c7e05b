//! Updates of the patch filter on one thread: `cargo bench -p planish-spline --bench patch_filter`.
//!
//! One row per layout: updates per second over many readings, latency of single readings, and cost of a
//! reconciliation.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first error")]

use planish_core::DVec3;
use planish_spline::{
    Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, StateLayout, SurfaceReading,
    parameter_plane,
};
use rand::{RngExt, SeedableRng};
use std::sync::Arc;
use std::time::Instant;

fn main() {
    println!(
        "{:<10} {:>8} {:>14} {:>10} {:>10} {:>14} {:>12}",
        "layout", "patches", "updates/s", "p50 / µs", "p99 / µs", "reconcile / ms", "memory / kB"
    );
    for (layout, readings) in
        [(StateLayout::Height, 1_000_000), (StateLayout::Isotropic, 1_000_000), (StateLayout::Full, 50_000)]
    {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [16, 16]).unwrap());
        let plane = parameter_plane(&space).unwrap();
        let prior = SmoothnessPrior { weight: 10.0, hold: 0.01 };
        let options = PatchFilterOptions { layout, ..PatchFilterOptions::default() };
        let mut filter = PatchFilter::new(&plane, &plane, prior, options).unwrap();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let mut reading = || {
            let [u, v] = [16.0 * random.random::<f64>(), 16.0 * random.random::<f64>()];
            SurfaceReading::Position {
                parameters: [u, v],
                point: DVec3::new(u, v, (0.5 * u).sin() + 0.01 * random.random::<f64>()),
                variance: 1e-4,
            }
        };
        let some: Vec<SurfaceReading> = (0..100_000).map(|_| reading()).collect();
        let start = Instant::now();
        for k in 0..readings {
            filter.observe(&some[k % some.len()]).unwrap();
        }
        let rate = readings as f64 / start.elapsed().as_secs_f64();
        let mut micros: Vec<f64> = some[..20_000]
            .iter()
            .map(|reading| {
                let start = Instant::now();
                filter.observe(reading).unwrap();
                1e6 * start.elapsed().as_secs_f64()
            })
            .collect();
        micros.sort_by(f64::total_cmp);
        let start = Instant::now();
        filter.reconcile().unwrap();
        let reconcile = 1e3 * start.elapsed().as_secs_f64();
        println!(
            "{:<10} {:>8} {:>14.0} {:>10.2} {:>10.2} {:>14.1} {:>12}",
            format!("{layout:?}"),
            filter.patches().len(),
            rate,
            micros[micros.len() / 2],
            micros[micros.len() * 99 / 100],
            reconcile,
            filter.bytes() / 1000
        );
    }
}
