//! A ball that is moved by thirty controls until it goes through points of something else.
//!
//! `cargo run --release -p planish --example shell`

#![allow(clippy::print_stdout, reason = "a program whose output is what it has to say")]

use planish::Job;
use planish::progress::Silent;
use planish::shell::fit::{DeformationKind, ShellFitJob};
use planish::simulate::{ShellSceneOptions, write_shell_scene};
use planish::{Result, Unit};
use planish_shell::Metaball;
use std::path::{Path, PathBuf};

fn main() -> Result<()> {
    // A deformed ball as points with gross errors, and masks from three sides; the truth beside them.
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
        controls: 30,
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
        "{} iterations, {} gross errors, σ {:.4} in the median",
        report.iterations, report.outliers, report.sigma.median
    );
    for (view, share) in &report.iou {
        println!("{view}: intersection over union {:.4}, {:.4} before", share, report.iou_before[view]);
    }
    Ok(())
}
