//! Deforms a ball by 30 controls until it matches the points and silhouettes of another object.
//!
//! `cargo run --release -p planish --example shell`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Job;
use planish::progress::Silent;
use planish::shell::fit::{DeformationKind, ShellFitJob};
use planish::simulate::{ShellSceneOptions, write_shell_scene};
use planish::{Result, Unit};
use planish_shell::Metaball;
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
        sequence: None,
        deformation: DeformationKind::Dirichlet,
        controls: Some(30),
        controls_file: None,
        family: Vec::new(),
        rigid: Vec::new(),
        blend: None,
        metaball: Metaball::Triangular,
        outline_step_px: 5.0,
        believe_sigma: false,
        rough_start: false,
        outputs: vec![PathBuf::from("fitted.ply")],
        report: None,
        unit: Some(Unit::Millimetre),
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
