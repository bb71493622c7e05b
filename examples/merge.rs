//! Aligns and merges two overlapping meshes, one of which has a small pose error.
//!
//! `cargo run --release -p planish --example merge`

#![allow(clippy::print_stdout, reason = "the program prints its result")]

use planish::merge::{MergeOptions, NamedPatch, PatchSet, merge, write_merged};
use planish::progress::Silent;
use planish::{Result, Unit};
use planish_core::DVec3;
use planish_mesh::{MergePatch, grid_sheet};
use planish_sense::Pose;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use std::path::Path;

const SIGMA: f64 = 0.02;

fn height(x: f64, y: f64) -> f64 {
    3.0 * (x / 6.0).sin() * (y / 7.0).cos()
}

fn main() -> Result<()> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let error = Normal::new(0.0, SIGMA).expect("a positive σ");
    let pose_error = Pose::from_rotation_vector(DVec3::new(0.004, -0.006, 0.005), DVec3::new(0.3, -0.2, 0.3));
    let mut patches = Vec::new();
    for (name, x, pose) in [("left", 0.0, Pose::identity()), ("right", 18.0, pose_error)] {
        let mut mesh = grid_sheet(40.0, 40.0, 60, 60);
        for p in &mut mesh.positions {
            let position = DVec3::new(p[0] + x, p[1], height(p[0] + x, p[1]) + error.sample(&mut random));
            *p = pose.apply(position);
        }
        let sigma = vec![SIGMA; mesh.positions.len()];
        patches.push(NamedPatch {
            name: name.to_owned(),
            tidied: MergePatch::make_manifold(&mesh, &sigma)?,
            observed: Vec::new(),
        });
    }

    let set = PatchSet { patches, unit: Some(Unit::Millimetre), ..PatchSet::default() };
    let options = MergeOptions { align: true, ..MergeOptions::default() };
    let merged = merge(set, &options, &Silent)?;
    let report = &merged.report;
    println!(
        "{} triangles, {} non-manifold edges, median σ {:.4} mm",
        report.triangles, report.nonmanifold_edges, report.sigma.median
    );
    for pose in &report.poses {
        println!(
            "{}: moved by {:.3} mm, σ {:.3} mm",
            pose.scan,
            pose.moved.unwrap_or(0.0),
            pose.sigma_translation.unwrap_or(0.0)
        );
    }
    write_merged(&merged, Path::new("whole.ply"), &Silent)
}
