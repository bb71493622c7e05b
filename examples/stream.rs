//! Fits a surface during the measurement, in constant time per reading.
//!
//! `cargo run --release -p planish --example stream`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Result;
use planish::stream::{Reading, StreamOptions, SurfaceStream};
use planish_core::DVec3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

fn main() -> Result<()> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(2);
    let sigma = 0.02;
    let error = Normal::new(0.0, sigma).expect("a positive σ");
    let mut measure = || {
        let (x, y) = (8.0 * random.random::<f64>(), 6.0 * random.random::<f64>());
        Reading::position(DVec3::new(x, y, 0.3 * x.sin() + error.sample(&mut random)), sigma)
    };

    // The first readings determine the topology. All others are added one by one.
    let first: Vec<Reading> = (0..400).map(|_| measure()).collect();
    let mut surface = SurfaceStream::start(&first, &StreamOptions::default())?;
    let mut rejected = 0;
    for n in 401..=20_000 {
        // `push` returns the reason if it rejects the reading as an outlier.
        rejected += usize::from(surface.push(&measure())?.is_some());
        if n % 5000 == 0 {
            let nearest = surface.nearest(DVec3::new(4.0, 3.0, 0.0));
            println!(
                "{n} readings, {} patches: z = {:.4} ± {:.4} (true value {:.4})",
                surface.patches(),
                nearest.position[2],
                nearest.sigma,
                0.3 * nearest.position[0].sin()
            );
        }
    }
    println!("{rejected} readings were rejected");
    Ok(())
}
