//! Fits of a few dozen readings: σ and the smoothness weight are not known, and σ of the surface says so.

use crate::common;
use planish::fit::{Fit, FitOptions, fit};
use planish::progress::Silent;
use planish_core::{DVec3, ErrorKind};
use planish_spline::{FootPointSearch, ProjectionOptions, Shape};
use planish_surface::model::Posterior;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// A shape by its points at two parameters in `[0, 1]`, with random proportions.
struct Truth {
    shape: Shape,
    form: [f64; 5],
}

impl Truth {
    fn random(shape: Shape, rng: &mut ChaCha8Rng) -> Self {
        Self { shape, form: [(); 5].map(|()| rng.random_range(-1.0..1.0)) }
    }

    fn point(&self, a: f64, b: f64) -> DVec3 {
        let [p, q, r, s, t] = self.form;
        let (sin, cos) = (TAU * a).sin_cos();
        match self.shape {
            Shape::Sheet => {
                let (x, y) = (20.0 * a - 10.0, 20.0 * b - 10.0);
                let z = 0.05 * (p * x * x + q * y * y + r * x * y) + 0.1 * (s * x + t * y);
                DVec3::new(x, y, z)
            }
            Shape::Tube => {
                let radius =
                    8.0 + 2.0 * p + 0.3 * q * (2.0 * TAU * a + r).sin() + 0.3 * s * (4.0 * b + t).sin();
                DVec3::new(radius * cos, radius * sin, 40.0 * b)
            }
            Shape::Ball => {
                let z = 2.0 * b - 1.0;
                let flat = (1.0 - z * z).sqrt();
                let radius =
                    50.0 * (1.0 + 0.04 * (p * (2.0 * z + q).sin() + r * (2.0 * flat * cos + s).sin()));
                radius * DVec3::new(flat * cos, flat * sin, z)
            }
            Shape::Torus => {
                let tube = 9.0 + 2.0 * p;
                let out = 30.0 + tube * (TAU * b).cos();
                DVec3::new(out * cos, out * sin, tube * (TAU * b).sin())
            }
        }
    }

    fn readings(&self, count: usize, sigma: f64, rng: &mut ChaCha8Rng) -> Vec<DVec3> {
        let read = |rng: &mut ChaCha8Rng| {
            let point = self.point(rng.random(), rng.random());
            let noise: [f64; 3] = [(); 3].map(|()| StandardNormal.sample(rng));
            point + sigma * DVec3::from_array(noise)
        };
        (0..count).map(|_| read(rng)).collect()
    }

    /// Share of places of the truth whose foot lies on a measured leaf within 1.96 σ.
    fn coverage(&self, found: &Fit, rng: &mut ChaCha8Rng) -> f64 {
        let (surface, posterior) = (&found.model.surface, found.posterior());
        let search = FootPointSearch::new(surface, 2, 0.0).unwrap();
        let (mut inside, mut all) = (0.0, 0.0);
        for _ in 0..300 {
            let p = self.point(rng.random_range(0.02..0.98), rng.random_range(0.02..0.98));
            let foot = surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
            if found.model.observed[foot.leaf as usize].is_measured() && !foot.at_border {
                let leaf = posterior.leaf(foot.leaf as usize).unwrap();
                let sigma = Posterior::sigma_along(&leaf, foot.local, foot.normal);
                inside += f64::from(u8::from(foot.height.abs() < 1.96 * sigma));
                all += 1.0;
            }
        }
        inside / all
    }
}

#[test]
fn intervals_of_a_few_readings_hold_or_the_fit_is_refused() {
    let few: &[usize] = &[15, 40, 100];
    let shapes = [
        (Shape::Sheet, 0.01, few),
        (Shape::Tube, 0.05, few),
        (Shape::Ball, 0.05, few),
        (Shape::Torus, 0.05, &[60, 100]),
    ];
    for (shape, sigma, counts) in shapes {
        for &count in counts {
            let mut rng = ChaCha8Rng::seed_from_u64(count as u64);
            let mut covered = Vec::new();
            for _ in 0..6 {
                let truth = Truth::random(shape, &mut rng);
                let set = common::probed(truth.readings(count, sigma, &mut rng), None, None);
                let options = FitOptions { shape: Some(shape), ..FitOptions::default() };
                match fit(&set, &options, &Silent) {
                    Ok(found) => covered.push(truth.coverage(&found, &mut rng)),
                    Err(error) => {
                        assert_eq!(error.kind(), ErrorKind::Undetermined, "{shape:?}, {count}: {error}");
                        assert!(error.to_string().contains("do not determine the shape"), "{error}");
                    }
                }
            }
            let mean = covered.iter().sum::<f64>() / covered.len() as f64;
            assert!(covered.is_empty() || mean > 0.9, "{shape:?}, {count}: covered {mean}");
            assert!(count < 40 || covered.len() >= 5, "{shape:?}, {count}: refused");
        }
    }
}

#[test]
fn exact_readings_are_fitted() {
    for (shape, count) in [(Shape::Sheet, 15), (Shape::Sheet, 60), (Shape::Ball, 40), (Shape::Tube, 40)] {
        for seed in 0..3 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let truth = Truth::random(shape, &mut rng);
            let set = common::probed(truth.readings(count, 0.0, &mut rng), None, None);
            let options = FitOptions { shape: Some(shape), ..FitOptions::default() };
            let found = fit(&set, &options, &Silent).unwrap();
            assert!(truth.coverage(&found, &mut rng) > 0.9, "{shape:?}, {count}, {seed}");
        }
    }
}

#[test]
fn stated_sigma_of_a_few_readings_is_kept() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut covered = 0.0;
    for _ in 0..8 {
        let truth = Truth::random(Shape::Sheet, &mut rng);
        let found = fit(
            &common::probed(truth.readings(20, 0.05, &mut rng), None, Some(0.05)),
            &FitOptions::default(),
            &Silent,
        )
        .unwrap();
        assert!(!found.report.sensors[0].sigma_used_is_estimated);
        covered += truth.coverage(&found, &mut rng) / 8.0;
    }
    assert!(covered > 0.92, "covered {covered}");
}

#[test]
fn too_few_readings_and_readings_about_a_line_are_refused_with_the_reason() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let truth = Truth::random(Shape::Torus, &mut rng);
    let refusal = |points: Vec<DVec3>, shape: Shape| {
        let options = FitOptions { shape: Some(shape), ..FitOptions::default() };
        fit(&common::probed(points, None, None), &options, &Silent).err().expect("a refusal").to_string()
    };
    let text = refusal(truth.readings(12, 0.05, &mut rng), Shape::Torus);
    assert!(text.contains("at least 45 readings for a torus, found 12"), "{text}");
    let line = (0..40).map(|k| {
        let noise: [f64; 3] = [(); 3].map(|()| StandardNormal.sample(&mut rng));
        f64::from(k) * DVec3::new(1.0, 0.3, 0.2) + 0.1 * DVec3::from_array(noise)
    });
    let text = refusal(line.collect(), Shape::Sheet);
    assert!(text.contains("about a line"), "{text}");
}

#[test]
fn the_shape_of_a_few_readings_is_chosen_without_normals() {
    for (shape, count) in [(Shape::Sheet, 15), (Shape::Sheet, 40), (Shape::Ball, 30), (Shape::Tube, 50)] {
        for seed in 0..4 {
            let mut rng = ChaCha8Rng::seed_from_u64(100 + seed);
            let truth = Truth::random(shape, &mut rng);
            let set = common::probed(truth.readings(count, 0.02, &mut rng), None, None);
            match fit(&set, &FitOptions::default(), &Silent) {
                Ok(found) => {
                    assert_eq!(found.report.topology.shape, shape.name(), "{count} readings, seed {seed}")
                }
                Err(error) => assert_ne!(shape, Shape::Sheet, "{count} readings, seed {seed}: {error}"),
            }
        }
    }
}

/// Waves that are nearly as short as the readings are apart, where normals of neighbours are wrong, and a
/// body that is as thin.
#[test]
fn neighbours_in_a_plane_show_sheets_and_bodies() {
    let mut rng = ChaCha8Rng::seed_from_u64(30);
    let mut noisy =
        |p: DVec3| p + 0.01 * DVec3::from_array([(); 3].map(|()| StandardNormal.sample(&mut rng)));
    let waves: Vec<DVec3> = (0..121)
        .map(|k| {
            let [x, y] = [f64::from(k % 11), f64::from(k / 11)];
            noisy(DVec3::new(x, y, (0.07 * x * x).sin() + (0.15 * y).cos()))
        })
        .collect();
    let found = fit(&common::probed(waves, None, None), &FitOptions::default(), &Silent).unwrap();
    assert_eq!(found.report.topology.shape, "sheet");
    let thin: Vec<DVec3> = (0..121)
        .map(|k| {
            let z = 2.0 * (f64::from(k) + 0.5) / 121.0 - 1.0;
            let (sin, cos) = (2.4 * f64::from(k)).sin_cos();
            let flat = (1.0 - z * z).sqrt();
            noisy(DVec3::new(7.0 * flat * cos, 6.0 * flat * sin, 2.0 * z))
        })
        .collect();
    let refusal = fit(&common::probed(thin, None, None), &FitOptions::default(), &Silent).err().unwrap();
    assert_eq!(refusal.kind(), ErrorKind::Undetermined);
    let text = refusal.to_string();
    assert!(text.contains("does not follow") || text.contains("two layers"), "{text}");
}
