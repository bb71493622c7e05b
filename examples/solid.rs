//! Finds every solid that matches the front, top and side view of a bracket.
//!
//! `cargo run --release -p planish --example solid` (in the root of the repository)

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Job;
use planish::Result;
use planish::progress::Silent;
use planish::solid::SolidJob;
use std::path::PathBuf;

fn main() -> Result<()> {
    let view = |name: &str| PathBuf::from(format!("examples/data/bracket/{name}.dxf"));
    let job = SolidJob {
        views: vec![view("front"), view("top"), view("side")],
        outputs: vec![PathBuf::from("bracket.step")],
        ..SolidJob::default()
    };
    let report = job.run(&Silent)?;
    for solid in &report.solutions {
        println!(
            "volume {:.3}, {} planes and {} cylinders",
            solid.volume, solid.faces.plane, solid.faces.cylinder
        );
    }
    // Lines that no solid explains, with the reason. The list is empty if a solid was found.
    for line in &report.unexplained {
        println!("{}: {}", line.view, line.reason);
    }
    Ok(())
}
