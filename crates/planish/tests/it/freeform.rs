//! The whole pipeline on freeform truths: scans are simulated, fitted without knowing (u, v), and judged
//! against the truth.

use planish::fit::{Fit, FitOptions, fit};
use planish::model::Posterior;
use planish::progress::Silent;
use planish::simulate::{ScanScene, ScanSceneOptions, scans};
use planish_estimate::Coverage;
use planish_spline::{FootPointSearch, ProjectionOptions, Shape};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

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
    let options = FitOptions { shape: Some(scene.options.shape), ..FitOptions::default() };
    fit(&scene.set, &options, &Silent).unwrap()
}

/// A truth point against the surface.
struct Judged {
    deviation: f64,
    sigma: f64,
    /// Smaller of the true radii of curvature over the object's length.
    radius: f64,
    level: u8,
    /// Knot spans of the base to the nearest open border.
    to_border: f64,
}

/// Area-uniform truth points against the surface, where it was measured.
fn judge(scene: &ScanScene, fit: &Fit, count: usize) -> Vec<Judged> {
    let surface = &fit.model.surface;
    let posterior = fit.model.posterior().unwrap();
    let search = FootPointSearch::new(surface, 2, 20.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(scene.options.seed);
    let space = surface.space();
    scene
        .truth
        .sample_area_uniform(count, &mut rng)
        .iter()
        .filter_map(|point| {
            let start = search.nearest(point.position, point.normal);
            let foot = surface.project(point.position, start, &ProjectionOptions::default());
            let leaf = foot.leaf as usize;
            if foot.at_border || !fit.model.observed[leaf].is_measured() {
                return None;
            }
            let cell = posterior.leaf(leaf).unwrap();
            let [u, v] = space.parameters(leaf, foot.local);
            let [width, height] = space.extent();
            let along =
                |x: f64, length: f64, open: bool| if open { x.min(length - x) } else { f64::INFINITY };
            let shape = scene.options.shape;
            let bend = foot.jet.curvature().map_or(0.0, |c| c.principal[0].abs().max(c.principal[1].abs()));
            Some(Judged {
                deviation: foot.height,
                sigma: Posterior::sigma_along(&cell, foot.local, foot.normal),
                radius: 1.0 / (bend * scene.options.size()),
                level: space.leaves()[leaf].level,
                to_border: along(u, width, shape == Shape::Sheet).min(along(v, height, shape != Shape::Ball)),
            })
        })
        .collect()
}

/// Coverage over all, and over every class of place: where it is off.
#[derive(Default)]
struct Map(BTreeMap<String, (f64, f64, f64)>);

impl Map {
    fn add(&mut self, place: String, deviation: f64, sigma: f64) {
        let r = deviation / sigma;
        let (n, covered, square) = self.0.entry(place).or_default();
        *n += 1.0;
        *covered += f64::from(r.abs() <= 1.959_964);
        *square += r * r;
    }

    fn print(&self, shape: Shape) {
        println!("{shape:?}: place, points, coverage, normalised rms");
        for (place, (n, covered, square)) in &self.0 {
            println!("  {place:28} {n:8} {:.3} {:.3}", covered / n, (square / n).sqrt());
        }
    }
}

fn coverage_of(shape: Shape, seeds: std::ops::Range<u64>, readings: usize) -> f64 {
    let mut coverage = Coverage::of_interval(0.95).unwrap();
    let mut map = Map::default();
    for seed in seeds {
        let scene = scene(shape, seed, readings);
        let fit = fit_scene(&scene);
        let median = fit.report.sigma.median;
        for Judged { deviation, sigma, radius, level, to_border } in judge(&scene, &fit, 400) {
            coverage.add(deviation, sigma).unwrap();
            let mut at = |place: String| map.add(place, deviation, sigma);
            at("everywhere".to_owned());
            at(format!("leaves of level {level}"));
            at(format!(
                "σ near {:+} octaves of median",
                (sigma / median).log2().round().clamp(-2.0, 4.0) + 0.0
            ));
            at(format!(
                "bend of radius 1/{:04} length",
                (1.0 / radius).log2().round().clamp(-2.0, 8.0).exp2()
            ));
            if to_border.is_finite() {
                at(format!("{:02} spans from the border", to_border.min(4.0).floor()));
            }
        }
    }
    map.print(shape);
    coverage.share()
}

#[test]
fn stated_sigma_covers_freeform_truths() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball] {
        let share = coverage_of(shape, 0..5, 6000);
        println!("{shape:?}: coverage {share:.3}");
        assert!((0.92..=0.98).contains(&share), "{shape:?}: 95 % intervals cover {share}");
    }
}

#[test]
#[ignore = "two hundred fits a shape: run by `just nightly`"]
fn two_hundred_freeform_truths_are_covered() {
    for shape in [Shape::Sheet, Shape::Tube, Shape::Ball] {
        let share = coverage_of(shape, 0..200, 6000);
        println!("{shape:?}: coverage {share:.4}");
        assert!((0.93..=0.97).contains(&share), "{shape:?}: 95 % intervals cover {share}");
    }
}
