//! Reads the ten range scans of the Stanford bunny. The tests are skipped unless the scans are in
//! `../shared/data` beside the repository, or in the folder that PLANISH_DATA names.

#![allow(clippy::print_stdout, reason = "reports skipped tests and times")]

use planish_core::DVec3;
use std::path::PathBuf;
use std::time::Instant;

use planish_exchange::{ply, read_inputs};
use planish_sense::Viewing;

fn bunny() -> Option<PathBuf> {
    let data = std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    );
    let folder = data.join("scans/bunny");
    if folder.join("bun.conf").is_file() {
        return Some(folder);
    }
    println!("skipped: the scans are not at {}", folder.display());
    None
}

#[test]
fn all_points_and_grids_are_read() {
    let Some(folder) = bunny() else { return };
    let start = Instant::now();
    let one = ply::read_scan(&folder.join("bun000.ply")).unwrap();
    println!("bun000.ply: {:?}", start.elapsed());
    assert_eq!(one.points.len(), 40_256);
    assert_eq!(one.viewing, Viewing::Direction(DVec3::new(0.0, 0.0, -1.0)));
    let start = Instant::now();
    let set = read_inputs(&[folder.join("bun.conf")], None).unwrap();
    println!("ten scans: {:?}", start.elapsed());
    assert_eq!(set.scans.len(), 10);
    assert_eq!(set.inputs.len(), 11);
    assert_eq!(set.scans.iter().map(|s| s.scan.points.len()).sum::<usize>(), 362_272);
    for posed in &set.scans {
        let grid = posed.scan.grid.as_ref().unwrap();
        assert_eq!((grid.columns, grid.rows), (512, 400));
        let mut cells: Vec<u32> = grid.cells.iter().copied().filter(|c| *c != u32::MAX).collect();
        cells.sort_unstable();
        // Every point is in exactly one cell.
        assert!(cells.iter().enumerate().all(|(k, &c)| k == c as usize));
        assert_eq!(cells.len(), posed.scan.points.len());
    }
}

#[test]
fn rows_of_the_grid_run_along_x() {
    let Some(folder) = bunny() else { return };
    let scan = ply::read_scan(&folder.join("bun000.ply")).unwrap();
    let grid = scan.grid.as_ref().unwrap();
    let mut steps: Vec<[f64; 2]> = Vec::new();
    for row in 0..grid.rows {
        for column in 1..grid.columns {
            if let (Some(a), Some(b)) = (grid.point(column - 1, row), grid.point(column, row)) {
                let (a, b) = (scan.points[a], scan.points[b]);
                steps.push([(b[0] - a[0]).abs(), (b[1] - a[1]).abs()]);
            }
        }
    }
    // The scanner moves by half a millimetre from column to column.
    let along = steps.iter().filter(|s| (s[0] - 0.0005).abs() < 1e-5).count();
    assert!(steps.len() > 30_000 && along > steps.len() * 9 / 10, "{along} of {}", steps.len());
}

#[test]
fn poses_align_the_scans() {
    let Some(folder) = bunny() else { return };
    let set = read_inputs(&[folder.join("bun.conf")], None).unwrap();
    let world = |name: &str| -> Vec<DVec3> {
        let scan = &set.scans.iter().find(|s| s.scan.name == name).unwrap().scan;
        scan.points.iter().map(|p| scan.world_from_scanner.apply(*p)).collect()
    };
    let (a, b) = (world("bun000.ply"), world("bun045.ply"));
    let mut nearest: Vec<f64> = a
        .iter()
        .step_by(200)
        .map(|p| {
            let squared = b.iter().map(|q| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>());
            squared.fold(f64::INFINITY, f64::min).sqrt()
        })
        .collect();
    nearest.sort_by(f64::total_cmp);
    let median = nearest[nearest.len() / 2];
    println!("median distance between neighbours of two scans: {:.3} mm", 1000.0 * median);
    assert!(median < 0.0006, "{median} m");
}
