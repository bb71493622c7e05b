//! The whole pipeline on freeform truths: scans are simulated, fitted without knowing (u, v), and judged against the truth.

use planish::fit::{Fit, FitOptions, fit};
use planish::model::Posterior;
use planish::progress::Silent;
use planish::simulate::{ScanScene, ScanSceneOptions, scans};
use planish_estimate::Coverage;
use planish_spline::{FootPointSearch, ProjectionOptions, Shape};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn scene(shape: Shape, seed: u64, readings: usize) -> ScanScene {
    let options = ScanSceneOptions {
        shape,
        seed,
        readings,
        old_scanner: false,
        probe_points: 0,
        outlier_share: 0.0,
        ..ScanSceneOptions::default()
    };
    scans(&options).unwrap()
}

fn fit_scene(scene: &ScanScene) -> Fit {
    let options = FitOptions {
        shape: Some(scene.options.shape),
        ..FitOptions::default()
    };
    fit(&scene.set, &options, &Silent).unwrap()
}

/// Deviations of area-uniform truth points from the surface with their σ, where the surface was measured.
fn judge(scene: &ScanScene, fit: &Fit, count: usize) -> Vec<(f64, f64)> {
    let surface = &fit.model.surface;
    let posterior = fit.model.posterior().unwrap();
    let search = FootPointSearch::new(surface, 2, 20.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(scene.options.seed);
    scene
        .truth
        .sample_area_uniform(count, &mut rng)
        .iter()
        .filter_map(|point| {
            let start = search.nearest(point.position, point.normal);
            let foot = surface.project(point.position, start, &ProjectionOptions::default());
            if foot.at_border || !fit.model.observed[foot.leaf as usize] {
                return None;
            }
            let cell = posterior.leaf(foot.leaf as usize).unwrap();
            Some((foot.height, Posterior::sigma_along(&cell, foot.local, foot.normal)))
        })
        .collect()
}

fn coverage_of(shape: Shape, seeds: std::ops::Range<u64>, readings: usize) -> (f64, f64) {
    let mut coverage = Coverage::of_interval(0.95).unwrap();
    let (mut square, mut n) = (0.0, 0.0);
    for seed in seeds {
        let scene = scene(shape, seed, readings);
        let fit = fit_scene(&scene);
        for (height, sigma) in judge(&scene, &fit, 400) {
            coverage.add(height, sigma).unwrap();
            square += (height / sigma).powi(2);
            n += 1.0;
        }
    }
    (coverage.share(), (square / n).sqrt())
}

#[test]
fn stated_sigma_covers_freeform_truths() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball] {
        let (share, normalised) = coverage_of(shape, 0..3, 6000);
        println!("{shape:?}: coverage {share:.3}, normalised rms {normalised:.3}");
        assert!(
            (0.9..=0.99).contains(&share),
            "{shape:?}: 95 % intervals cover {share}, normalised rms {normalised}"
        );
    }
}

#[test]
#[ignore = "two hundred fits a shape: run by `just nightly`"]
fn two_hundred_freeform_truths_are_covered() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball] {
        let (share, normalised) = coverage_of(shape, 0..200, 6000);
        println!("{shape:?}: coverage {share:.4}, normalised rms {normalised:.3}");
        assert!(
            (0.93..=0.97).contains(&share),
            "{shape:?}: 95 % intervals cover {share}"
        );
    }
}
