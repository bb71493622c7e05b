//! Both filters on the same scans: their results must be consistent, and so must their σ.

use planish::fit::{
    Filter, Fit, FitOptions, GlobalOptions, PatchOptions, RefineBy, Strategy, UpdateOptions, fit,
};
use planish::model::Posterior;
use planish::progress::Silent;
use planish::simulate::{ScanScene, ScanSceneOptions, scans};
use planish_core::DVec3;
use planish_spline::{FootPointSearch, ProjectionOptions, Shape};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn scene(shape: Shape, seed: u64) -> ScanScene {
    scene_with(shape, seed, None)
}

fn scene_with(shape: Shape, seed: u64, sigma: Option<f64>) -> ScanScene {
    let options = ScanSceneOptions {
        shape,
        seed,
        sigma,
        readings: 12_000,
        old_scanner: false,
        probe_points: 0,
        ..ScanSceneOptions::default()
    };
    scans(&options).unwrap()
}

fn strategy(filter: Filter) -> Strategy {
    match filter {
        Filter::Global => Strategy::Global(GlobalOptions::default()),
        Filter::Patch => Strategy::Patches(PatchOptions::default()),
    }
}

fn fitted(scene: &ScanScene, filter: Filter) -> Fit {
    let options =
        FitOptions { strategy: strategy(filter), shape: Some(scene.options.shape), ..FitOptions::default() };
    fit(&scene.set, &options, &Silent).unwrap()
}

/// How far a surface lies above places of the truth, along its own normal, and its σ there.
fn deviations(fit: &Fit, places: &[(DVec3, DVec3)]) -> Vec<Option<(f64, f64)>> {
    let surface = &fit.model.surface;
    let posterior = fit.posterior();
    let search = FootPointSearch::new(surface, 2, 20.0).unwrap();
    let judge = |&(position, normal)| {
        let start = search.nearest(position, normal);
        let foot = surface.project(position, start, &ProjectionOptions::default());
        let leaf = foot.leaf as usize;
        if foot.at_border || !fit.model.observed[leaf].is_measured() {
            return None;
        }
        let cell = posterior.leaf(leaf).unwrap();
        Some((-foot.height, Posterior::sigma_along(&cell, foot.local, foot.normal)))
    };
    places.iter().map(judge).collect()
}

/// The intervals of both filters cover the truth, and the two lie well within a σ of each other, although
/// each has found cells of its own. (Over the same cells an adaptive quadtree lies within half a σ of the
/// global filter: a test of the filter itself.)
#[test]
fn the_patch_filter_agrees_with_the_global_one_and_both_cover_the_truth() {
    for shape in [Shape::Sheet, Shape::Ball] {
        let (mut apart, mut both) = (0.0, 0.0);
        let mut covered = [0.0; 2];
        for seed in 0..3 {
            let scene = scene(shape, seed);
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let places: Vec<_> = (scene.truth.sample_area_uniform(2000, &mut random).iter())
                .map(|p| (p.position, p.normal))
                .collect();
            let [patch, global] = [Filter::Patch, Filter::Global].map(|filter| fitted(&scene, filter));
            let [a, b] = [&patch, &global].map(|fit| deviations(fit, &places));
            for ((p, sp), (g, sg)) in a.into_iter().zip(b).filter_map(|(a, b)| a.zip(b)) {
                both += 1.0;
                apart += ((p - g) / sp.max(sg)).powi(2);
                covered[0] += f64::from(u8::from(p.abs() < 1.96 * sp));
                covered[1] += f64::from(u8::from(g.abs() < 1.96 * sg));
            }
        }
        let apart = (apart / both).sqrt();
        let covered = covered.map(|c| c / both);
        println!(
            "{shape:?}: {apart:.3} σ apart (rms), patch covers {:.3}, global {:.3}",
            covered[0], covered[1]
        );
        assert!(apart < 0.8, "{shape:?}: {apart} σ apart");
        for share in covered {
            assert!((0.92..0.985).contains(&share), "{shape:?}: {share} covered");
        }
    }
}

/// A session of half the scans and one of the others must know about as much as one of all, and take them at
/// the same σ.
#[test]
fn scans_of_another_day_update_the_patch_filter() {
    let scene = scene(Shape::Ball, 7);
    let all = fitted(&scene, Filter::Patch);
    let mut first = scene.set.clone();
    let last = first.scans.pop().unwrap();
    let mut second = scene.set.clone();
    second.scans = vec![last];
    let options =
        FitOptions { strategy: strategy(Filter::Patch), shape: Some(Shape::Ball), ..FitOptions::default() };
    let first_fit = fit(&first, &options, &Silent).unwrap();
    let updated =
        planish::fit::update(&first_fit.model, &second, &UpdateOptions::default(), &Silent).unwrap();
    assert!(updated.model.known.filter().is_some());
    assert!(updated.report.observed_area_fraction >= first_fit.report.observed_area_fraction);
    let ratio = updated.report.sigma.median / all.report.sigma.median;
    // Cells that were refined late have a larger σ; a coarser model has a smaller one.
    println!("{ratio:.2} times the σ of one session, {:?} held out", updated.report.held_out);
    assert!((0.5..1.5).contains(&ratio), "{ratio} times the σ of one session");
    let judged = updated.report.held_out.rms_normalised;
    assert!((0.9..1.15).contains(&judged), "held-out readings are {judged} of their σ off");
    assert_eq!(updated.model.observations, first_fit.report.observations + updated.report.observations);
    let refused = UpdateOptions { filter: Some(Filter::Global), ..UpdateOptions::default() };
    let e = planish::fit::update(&first_fit.model, &second, &refused, &Silent).err().unwrap();
    assert!(e.to_string().contains("patch filter"), "{e}");
}

/// Either criterion alone divides, the report says which did, and no level is deeper than asked for.
#[test]
fn criteria_and_depth_are_kept_and_reported() {
    let scene = scene_with(Shape::Sheet, 3, Some(0.01));
    for filter in [Filter::Global, Filter::Patch] {
        for refine_by in [RefineBy::Residuals, RefineBy::Curvature, RefineBy::Both] {
            for depth in [0, 2] {
                let options = FitOptions {
                    shape: Some(Shape::Sheet),
                    strategy: strategy(filter),
                    refine_by,
                    max_depth: Some(depth),
                    ..FitOptions::default()
                };
                let report = fit(&scene.set, &options, &Silent).unwrap().report;
                let name = format!("{filter:?} {refine_by:?} {depth}");
                assert!(report.levels <= usize::from(depth) + 1, "{name}: {} levels", report.levels);
                let causes: Vec<&str> =
                    report.refined.iter().flat_map(|l| l.causes.keys().copied()).collect();
                assert_eq!(causes.is_empty(), depth == 0, "{name}: {causes:?}");
                let disabled_cause = match refine_by {
                    RefineBy::Residuals => Some("curvature"),
                    RefineBy::Curvature => Some("residuals"),
                    RefineBy::Both | RefineBy::Roughness => None,
                };
                assert!(disabled_cause.is_none_or(|cause| !causes.contains(&cause)), "{name}: {causes:?}");
                let divided: usize = report.refined.iter().map(|l| l.divided).sum();
                if filter == Filter::Global {
                    // Every division makes three leaves more.
                    let base = report.cells - 3 * divided;
                    assert!((80..200).contains(&base), "{name}: {base} cells to begin with");
                }
            }
        }
    }
}
