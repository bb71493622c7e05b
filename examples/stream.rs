//! A surface that grows while a sensor reads: one reading at a time, in constant time each.
//!
//! `cargo run --release -p planish --example stream`

#![allow(clippy::print_stdout, reason = "a program whose output is what it has to say")]

use planish::Result;
use planish::stream::{Reading, StreamOptions, SurfaceStream};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};

fn main() -> Result<()> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(2);
    let sigma = 0.02;
    let error = Normal::new(0.0, sigma).expect("a positive σ");
    let mut read = || {
        let (x, y) = (8.0 * random.random::<f64>(), 6.0 * random.random::<f64>());
        Reading::position([x, y, 0.3 * x.sin() + error.sample(&mut random)], sigma)
    };

    // The first readings tell which kind of surface it is; from then on they come one by one.
    let first: Vec<Reading> = (0..400).map(|_| read()).collect();
    let mut surface = SurfaceStream::start(&first, &StreamOptions::default())?;
    let mut left_out = 0;
    for n in 401..=20_000 {
        // A reading that cannot be of this surface is left out, and it says why.
        left_out += usize::from(surface.push(&read())?.is_some());
        if n % 5000 == 0 {
            let place = surface.nearest([4.0, 3.0, 0.0]);
            println!(
                "{n} readings, {} patches: z = {:.4} ± {:.4} (true {:.4})",
                surface.patches(),
                place.position[2],
                place.sigma,
                0.3 * place.position[0].sin()
            );
        }
    }
    println!("{left_out} readings were left out");
    Ok(())
}
