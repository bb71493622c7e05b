//! Deforms a ball by 30 controls until it matches the points and silhouettes of another object.
//!
//! `cargo run --release -p planish --example shell`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Job;
use planish::progress::Silent;
use planish::shell::fit::ShellFitJob;
use planish::simulate::{ShellSceneOptions, write_shell_scene};
use planish::{Result, Unit};
use std::path::{Path, PathBuf};

fn main() -> Result<()> {
    // Simulate a deformed ball: points with gross errors, masks from three sides, and the ground truth.
    let folder = Path::new("bent");
    let scene = ShellSceneOptions {
        mesh: None,
        controls: 30,
        deformation: 0.03,
        points: 4000,
        noise: 0.002,
        outliers: 0.1,
        views: 3,
        seed: 0,
        unit: Unit::Millimetre,
    };
    write_shell_scene(&scene, folder)?;

    let job = ShellFitJob {
        mesh: folder.join("mesh.obj"),
        points: vec![folder.join("points.ply")],
        silhouettes: Some(folder.join("views.toml")),
        controls: Some(30),
        outputs: vec![PathBuf::from("fitted.ply")],
        unit: Some(Unit::Millimetre),
        ..ShellFitJob::default()
    };
    let report = job.run(&Silent)?;
    println!(
        "{} iterations, {} gross errors, median σ {:.4}",
        report.iterations, report.outliers, report.sigma.median
    );
    for (view, share) in &report.iou {
        println!(
            "{view}: intersection over union {:.4} ({:.4} before the fit)",
            share, report.iou_before[view]
        );
    }
    Ok(())
}
