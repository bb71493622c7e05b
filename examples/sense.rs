//! Converts a stereo pair to points with covariance.
//!
//! `cargo run --release -p planish --example sense`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::Job;
use planish::progress::Silent;
use planish::sense::{SenseJob, SenseKind};
use planish::simulate::{PictureScene, PictureSceneOptions, write_picture_scene};
use planish::{Result, StereoOptions, StereoPoints};
use std::path::{Path, PathBuf};

fn main() -> Result<()> {
    let folder = Path::new("pairs");
    let scene = PictureSceneOptions { views: 1, size: [320, 240], ..PictureSceneOptions::default() };
    write_picture_scene(PictureScene::Stereo, &scene, folder, &Silent)?;
    let job = SenseJob {
        kind: SenseKind::Stereo {
            left: folder.join("left-1.png"),
            right: folder.join("right-1.png"),
            calibration: Some(folder.join("cameras.toml")),
            options: StereoOptions::default(),
            points: StereoPoints::default(),
        },
        outputs: vec![PathBuf::from("points.ply")],
        unit: None,
    };
    let report = job.run(&Silent)?;
    println!("{} points from {} pixels", report.observations, report.pixels);
    if let Some(sigma) = report.sigma {
        println!("σ along rays: median {:.3}, 95 % below {:.3}", sigma.median, sigma.p95);
    }
    for (reason, count) in &report.rejected {
        println!("rejected ({reason}): {count}");
    }
    Ok(())
}
