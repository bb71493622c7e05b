//! What is known, whether that is true, and where to measure next: files in, numbers out.
//!
//! `cargo run --release -p planish --example next`, in the root of the repository.

#![allow(clippy::print_stdout, reason = "a program whose output is what it has to say")]

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
    println!("σ {:.4} mm in the median, {:.4} at most", fitted.sigma.median, fitted.sigma.max);

    // Against the truth, which a simulated pebble has.
    let job = CompareJob {
        model: model.clone(),
        reference: PathBuf::from("examples/data/pebble/truth.ply"),
        ..CompareJob::default()
    };
    let compared = job.run(&Silent)?;
    if let Some(share) = compared.coverage95 {
        println!("{:.1} % of the truth lies within 1.96 σ", 100.0 * share);
    }

    // Each point is the best one given those before it.
    let options = NextOptions { count: 3, sigma: Some(0.004), ..NextOptions::default() };
    for point in next_points(&saved::load(&model)?, &options, &Silent)?.points {
        println!(
            "touch {:.1?}: σ from {:.4} to {:.4}",
            point.position, point.sigma_before, point.sigma_after
        );
    }
    Ok(())
}
