//! Fits a model, compares it with the ground truth, and chooses the next points to measure.
//!
//! `cargo run --release -p planish --example next` (in the root of the repository)

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Job;
use planish::Result;
use planish::compare::CompareJob;
use planish::fit_files::FitJob;
use planish::next::{NextOptions, next_points};
use planish::progress::Silent;
use planish::saved;
use std::path::PathBuf;

fn main() -> Result<()> {
    let model = PathBuf::from("pebble.planish");
    let job = FitJob {
        inputs: vec![PathBuf::from("examples/data/pebble/job.toml")],
        outputs: vec![model.clone()],
        ..FitJob::default()
    };
    let fitted = job.run(&Silent)?.fit;
    println!("median σ {:.4} mm, maximum {:.4} mm", fitted.sigma.median, fitted.sigma.max);

    // The pebble is simulated, so its exact surface is known.
    let job = CompareJob {
        model: model.clone(),
        reference: PathBuf::from("examples/data/pebble/truth.ply"),
        ..CompareJob::default()
    };
    let compared = job.run(&Silent)?;
    if let Some(share) = compared.coverage95 {
        println!("{:.1} % of the reference points lie within 1.96 σ", 100.0 * share);
    }

    // Points are chosen one after another, each given the previous ones.
    let options = NextOptions { count: 3, sigma: Some(0.004), ..NextOptions::default() };
    for point in next_points(&saved::load(&model)?, &options, &Silent)?.points {
        println!(
            "touch {:.1?}: σ decreases from {:.4} to {:.4} mm",
            point.position, point.sigma_before, point.sigma_after
        );
    }
    Ok(())
}
