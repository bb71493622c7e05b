//! Accumulation of positions with known parameters on one thread:
//! `cargo bench -p planish-spline --bench accumulation`.
//!
//! One row per grid: millions of positions per second, best of several runs. Compares the stream of moments
//! (with and without weights) to direct accumulation of each reading with the same isotropic information.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first error")]

use planish_core::DVec3;
use planish_spline::{CellInformation, Hierarchy, PositionSums, Shape, leaf_weights};
use rand::{RngExt, SeedableRng};
use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

const POSITIONS: usize = 1 << 20;

/// CPU time of this thread in seconds on Linux; elsewhere elapsed time.
fn seconds(since: Instant) -> f64 {
    let counted = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = counted.and_then(|line| line.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or(since.elapsed().as_secs_f64(), |n| n * 1e-9)
}

fn rate(runs: usize, mut work: impl FnMut()) -> f64 {
    let since = Instant::now();
    let shortest = (0..runs)
        .map(|_| {
            let start = seconds(since);
            work();
            seconds(since) - start
        })
        .fold(f64::INFINITY, f64::min);
    POSITIONS as f64 / shortest / 1e6
}

fn main() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    println!("{:<12} {:>10} {:>10} {:>10}", "cells", "moments", "weighted", "by weights");
    for across in [8, 61, 200] {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [across, across]).unwrap());
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let side = across as f64;
        let at: Vec<[f64; 2]> =
            (0..POSITIONS).map(|_| [side * random.random::<f64>(), side * random.random::<f64>()]).collect();
        let z: Vec<DVec3> = at.iter().map(|&[u, v]| DVec3::new(u, v, (u * v).sin())).collect();
        let w = vec![2.0; POSITIONS];
        let (moments, weighted) = pool.install(|| {
            let mut sums = PositionSums::new(&space);
            let moments = rate(20, || sums.add(&at, &z, None).unwrap());
            let weighted = rate(20, || sums.add(&at, &z, Some(&w)).unwrap());
            black_box(sums.count());
            (moments, weighted)
        });
        let mut cells = vec![CellInformation::default(); space.leaves().len()];
        let plain = rate(1, || {
            for (&[u, v], z) in at.iter().zip(&z) {
                let (leaf, local) = space.locate(u, v);
                cells[leaf].add_vector(
                    &leaf_weights(local[0], local[1]),
                    *z,
                    &[1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
                );
            }
        });
        black_box(&cells);
        println!("{:<12} {moments:>10.1} {weighted:>10.1} {plain:>10.1}", format!("{across}x{across}"));
    }
}
