//! Ten million readings through the streaming API, one at a time: `cargo bench -p planish --bench stream`; a
//! number after `--` streams that many.
//!
//! A row each at a tenth, a half and all of them: readings a second since the row before, with everything
//! that comes between (neighbours being told, patches being divided), the latency of single readings, the
//! longest, and the most memory that the process ever had.
#![allow(clippy::print_stdout, reason = "a bench prints its table")]
#![allow(clippy::unwrap_used, reason = "a bench stops at the first surprise")]

use planish::stream::{Reading, StreamOptions, SurfaceStream};
use planish::{DVec3, Shape};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::time::{Duration, Instant};

const SIGMA: f64 = 0.02;
const SIZE: [f64; 2] = [40.0, 30.0];

fn height(x: f64, y: f64) -> f64 {
    0.4 * (0.9 * x).sin() * (0.7 * y).cos()
}

fn reading(random: &mut ChaCha8Rng) -> Reading {
    let [x, y] = SIZE.map(|s| s * random.random::<f64>());
    let point = DVec3::from_array([x, y, height(x, y)].map(|c| {
        let noise: f64 = StandardNormal.sample(random);
        c + SIGMA * noise
    }));
    Reading::position(point, SIGMA)
}

/// Latencies by their logarithm: 2 % wide, whatever their number.
struct Latencies([u64; 1400]);

impl Latencies {
    fn add(&mut self, time: Duration) {
        let nanos = time.as_nanos().max(1) as f64;
        self.0[((nanos.ln() / 1.02_f64.ln()) as usize).min(1399)] += 1;
    }

    fn quantile_micros(&self, share: f64) -> f64 {
        let all: u64 = self.0.iter().sum();
        let mut sum = 0;
        let at = self.0.iter().position(|n| {
            sum += n;
            sum as f64 >= share * all as f64
        });
        1e-3 * 1.02_f64.powf(at.unwrap_or(0) as f64 + 0.5)
    }
}

/// Peak memory of this process in megabytes. Absent if the system does not report it.
fn peak_megabytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? / 1e3)
}

fn main() {
    let total: u64 = std::env::args().filter_map(|a| a.parse().ok()).next().unwrap_or(10_000_000);
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let first: Vec<Reading> = (0..20_000).map(|_| reading(&mut random)).collect();
    let options = StreamOptions { shape: Some(Shape::Sheet), ..StreamOptions::default() };
    let start = Instant::now();
    let mut stream = SurfaceStream::start(&first, &options).unwrap();
    println!("first fit of {} readings: {:.2} s", first.len(), start.elapsed().as_secs_f64());
    println!(
        "{:>12} {:>8} {:>12} {:>9} {:>9} {:>9} {:>11} {:>12}",
        "readings", "patches", "readings/s", "p50 / µs", "p99 / µs", "max / s", "peak / MB", "median σ"
    );
    let mut latencies = Latencies([0; 1400]);
    let (mut longest, mut spent) = (Duration::ZERO, Duration::ZERO);
    let mut counted = 0;
    for k in 1..=total {
        let one = reading(&mut random);
        let before = Instant::now();
        stream.push(&one).unwrap();
        let elapsed = before.elapsed();
        latencies.add(elapsed);
        longest = longest.max(elapsed);
        spent += elapsed;
        if [total / 10, total / 2, total].contains(&k) {
            stream.surface().unwrap();
            let mut sigmas: Vec<f64> = (0..200)
                .map(|_| {
                    let [x, y] = SIZE.map(|s| s * random.random::<f64>());
                    stream.nearest(DVec3::new(x, y, height(x, y))).sigma
                })
                .collect();
            sigmas.sort_by(f64::total_cmp);
            println!(
                "{:>12} {:>8} {:>12.0} {:>9.2} {:>9.2} {:>9.2} {:>11} {:>12.6}",
                k,
                stream.patches(),
                (k - counted) as f64 / spent.as_secs_f64(),
                latencies.quantile_micros(0.5),
                latencies.quantile_micros(0.99),
                longest.as_secs_f64(),
                peak_megabytes().map_or("?".to_owned(), |m| format!("{m:.0}")),
                sigmas[100],
            );
            (counted, spent) = (k, Duration::ZERO);
        }
    }
}
