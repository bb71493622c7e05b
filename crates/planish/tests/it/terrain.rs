//! The bare earth of airborne lidar: simulated, and the reference samples of Sithole and Vosselman where they
//! are at hand.

use crate::common;
use planish_core::DVec3;

use planish::Shape;
use planish::fit::{Fit, FitOptions, GlobalOptions, GroundWidth, Strategy, fit};
use planish::progress::Silent;
use planish_exchange::{ScanSet, Unit, read_inputs};
use planish_sense::{Ground, GroundOptions, classify_ground};
use planish_spline::{FootPointSearch, ProjectionOptions};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

const SIGMA: f64 = 0.08;

fn meadow(x: f64, y: f64) -> f64 {
    3.0 * (0.06 * x).sin() + 2.0 * (0.05 * y).cos()
}

/// A village of 100 m on a map: meadows with three houses and a wood, seen from above.
fn village(place: DVec3) -> ScanSet {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let house = |x: f64, y: f64| {
        [[20.0, 20.0], [50.0, 30.0], [75.0, 15.0]]
            .iter()
            .any(|c| (x - c[0]).abs() < 7.0 && (y - c[1]).abs() < 5.0)
    };
    let points = (0..20_000)
        .map(|_| {
            let (x, y): (f64, f64) = (rng.random_range(0.0..100.0), rng.random_range(0.0..100.0));
            let noise: f64 = SIGMA * Distribution::<f64>::sample(&StandardNormal, &mut rng);
            let above = if house(x, y) {
                6.0
            } else if y > 60.0 && rng.random_bool(0.6) {
                rng.random_range(0.3..14.0)
            } else {
                0.0
            };
            DVec3::new(x + place[0], y + place[1], meadow(x, y) + above + noise + place[2])
        })
        .collect();
    ScanSet { unit: Some(Unit::Metre), ..common::probed(points, None, None) }
}

fn ground(set: &ScanSet) -> Fit {
    let global = GlobalOptions { ground: Some(GroundWidth::Default), ..GlobalOptions::default() };
    let options = FitOptions { strategy: Strategy::Global(global), ..FitOptions::default() };
    fit(set, &options, &Silent).unwrap()
}

/// Distances along the normal of truth from a fitted sheet, where it was measured.
fn heights_off(fit: &Fit, truth: impl Iterator<Item = DVec3>) -> Vec<f64> {
    let surface = &fit.model.surface;
    let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
    truth
        .filter_map(|p| {
            let foot = surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
            let inside = fit.model.observed[foot.leaf as usize].is_measured() && !foot.at_border;
            inside.then_some(foot.height)
        })
        .collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn the_meadow_under_houses_and_trees_is_found() {
    let fit = ground(&village(DVec3::ZERO));
    assert_eq!(fit.report.topology.shape, Shape::Sheet.name());
    assert!(fit.report.rejected["above_ground"] > 4000, "{:?}", fit.report.rejected);
    let places = (0..400).map(|k| [5.0 + 4.5 * f64::from(k % 20), 5.0 + 4.5 * f64::from(k / 20)]);
    let off = heights_off(&fit, places.map(|[x, y]| DVec3::new(x, y, meadow(x, y))));
    assert!(off.len() > 340 && rms(&off) < 1.5 * SIGMA, "{} {}", off.len(), rms(&off));
    let sigma = fit.report.sensors[0].sigma_estimated;
    assert!((sigma / SIGMA - 1.0).abs() < 0.3, "{sigma}");
}

#[test]
fn ground_on_a_map_is_the_ground_at_the_origin() {
    let (near, place) = (ground(&village(DVec3::ZERO)), DVec3::new(524_288.0, 4_194_304.0, 512.0));
    let far = ground(&village(place));
    assert_eq!(near.report.coefficients, far.report.coefficients);
    let points = near.model.surface.vertices().iter().zip(far.model.surface.vertices());
    let off = points.flat_map(|(a, b)| [0, 1, 2].map(|d| (b[d] - place[d] - a[d]).abs()));
    let off = off.fold(0.0, f64::max);
    assert!(off < 1e-3 * SIGMA, "{off}");
}

/// Of the samples of Sithole and Vosselman (2004): type I, type II and total error in per cent, Cohen's κ in
/// per cent.
fn agreement(truth: &[bool], found: &[bool]) -> [f64; 4] {
    let count =
        |t: bool, f: bool| truth.iter().zip(found).filter(|(a, b)| **a == t && **b == f).count() as f64;
    let [a, b, c, d] = [count(true, true), count(true, false), count(false, true), count(false, false)];
    let n = a + b + c + d;
    let (agreed, chance) = ((a + d) / n, ((a + b) * (a + c) + (c + d) * (b + d)) / (n * n));
    [
        100.0 * b / (a + b),
        100.0 * c / (c + d),
        100.0 * (b + c) / n,
        100.0 * (agreed - chance) / (1.0 - chance),
    ]
}

/// Set `PLANISH_ISPRS` to the folder with `sampNN-utm.pcd` and `sampNN-utm-ground.pcd`: the table is printed.
#[test]
#[ignore = "needs data that are not in the repository"]
fn the_reference_samples_are_classified() {
    let Some(folder) = std::env::var_os("PLANISH_ISPRS").map(PathBuf::from) else {
        println!("PLANISH_ISPRS is not set: nothing was measured");
        return;
    };
    let read = |path: &Path| read_inputs(&[path], Some(Unit::Metre)).unwrap();
    println!(
        "sample   type I  type II   total       κ |  of the sheet: σ of readings   median off     rms off   \
         within 0.5 m"
    );
    let mut all: Vec<[f64; 4]> = Vec::new();
    for sample in ["11", "12", "21", "22", "23", "24", "31", "41", "42", "51", "52", "53", "54", "61", "71"] {
        let path = folder.join(format!("samp{sample}-utm.pcd"));
        if !path.exists() {
            continue;
        }
        let set = read(&path);
        let truth = read(&folder.join(format!("samp{sample}-utm-ground.pcd")));
        let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
        let bare: HashSet<[u64; 3]> = truth.scans[0].scan.points.iter().map(bits).collect();
        let points = &set.scans[0].scan.points;
        let is_ground: Vec<bool> = points.iter().map(|p| bare.contains(&bits(p))).collect();
        let found: Vec<bool> = (classify_ground(points, &GroundOptions::for_unit(1.0)).unwrap().iter())
            .map(|what| *what == Ground::Bare)
            .collect();
        let scores = agreement(&is_ground, &found);
        let fit = ground(&set);
        // Classification of every point by the sheet, including points that the filter rejected.
        let surface = &fit.model.surface;
        let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
        let sigma = fit.report.sensors[0].sigma_estimated;
        let heights: Vec<f64> = (points.iter())
            .map(|&p| {
                surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default()).height
            })
            .collect();
        for max_height in [4.0 * sigma, 0.5] {
            let near: Vec<bool> = heights.iter().map(|h| h.abs() < max_height).collect();
            let of_sheet = agreement(&is_ground, &near);
            println!("    within {max_height:.2} m of the sheet: {of_sheet:.2?}");
        }
        let mut off = heights_off(&fit, truth.scans[0].scan.points.iter().copied());
        let root = rms(&off);
        off.sort_by(f64::total_cmp);
        let near = off.iter().filter(|d| d.abs() < 0.5).count() as f64 / off.len() as f64;
        println!(
            "samp{sample}  {:7.2}  {:7.2} {:7.2} {:7.2} | {:28.3} {:12.3} {root:11.3} {:13.1} %",
            scores[0],
            scores[1],
            scores[2],
            scores[3],
            fit.report.sensors[0].sigma_estimated,
            off[off.len() / 2],
            100.0 * near
        );
        all.push(scores);
    }
    let mean = [0, 1, 2, 3].map(|k| all.iter().map(|s| s[k]).sum::<f64>() / all.len() as f64);
    println!("mean    {:7.2}  {:7.2} {:7.2} {:7.2}", mean[0], mean[1], mean[2], mean[3]);
    assert!(mean[2] < 3.8 && mean[3] > 91.5, "{mean:?}");
}

/// Ten million points: 14 s of processor time when this was written.
#[test]
#[ignore = "prints a time"]
fn ten_million_points_are_classified() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let points: Vec<DVec3> = (0..10_000_000)
        .map(|_| {
            let (x, y): (f64, f64) = (rng.random_range(0.0..3000.0), rng.random_range(0.0..3000.0));
            let tree = if rng.random_bool(0.3) { rng.random_range(0.0..15.0) } else { 0.0 };
            DVec3::new(x, y, meadow(x, y) + tree)
        })
        .collect();
    let start = std::time::Instant::now();
    let found = classify_ground(&points, &GroundOptions::for_unit(1.0)).unwrap();
    println!("{:?}", start.elapsed());
    let bare = found.iter().filter(|what| **what == Ground::Bare).count();
    assert!((0.65..0.8).contains(&(bare as f64 / 1e7)), "{bare}");
}
