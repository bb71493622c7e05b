//! Controls that are added where the mesh does not follow its points.

use super::*;

fn build(mesh: &TriangleMesh, controls: &Controls) -> Result<ControlledDeformation> {
    let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
    Ok(ControlledDeformation {
        deformation: Box::new(Dirichlet::new(&controls.points, &mesh.positions)?),
        rigidity: Some(Rigidity::new(&controls.points, &controls.edges, &k)?),
        stiffness: Some(stiffness_for_xyz(&k)),
    })
}

/// Noisy points of a ball whose radius is changed by `height`, and the true surface.
fn points_of(height: impl Fn(DVec3) -> f64, seed: u64) -> (TriangleMesh, TriangleMesh, Vec<PointReading>) {
    let mesh = icosphere(1.0, 4);
    let mut deformed = mesh.clone();
    deformed.positions.iter_mut().for_each(|p| *p = (1.0 + height(*p)) * *p);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut noise = ChaCha8Rng::seed_from_u64(seed + 1);
    let points = (sample_points(&deformed, 4000, || random.random_range(0.0..1.0)).unwrap().iter())
        .map(|sample| {
            let mut normal = || -> f64 { StandardNormal.sample(&mut noise) };
            let off = DVec3::new(normal(), normal(), normal());
            let at = sample.position + SIGMA * off;
            PointReading { at, covariance: SymmetricMatrix3::isotropic(SIGMA * SIGMA) }
        })
        .collect();
    (mesh, deformed, points)
}

fn grown(mesh: &TriangleMesh, points: &[PointReading], growth: ControlGrowth) -> GrownFit {
    let readings = ShellReadings { points, ..ShellReadings::default() };
    let options = ShellFitOptions::default();
    let of = |controls: &Controls| build(mesh, controls);
    fit_with_growing_controls(mesh, mesh, &of, &readings, &options, growth, &mut |_| Ok(())).unwrap()
}

/// A bump that few controls cannot follow gets more of them, the rest of the ball does not. The fit becomes
/// nearer, and σ holds.
#[test]
fn controls_are_added_at_a_bump() {
    for seed in [31, 32, 33] {
        let toward = DVec3::new(0.3, -0.8, 0.5).normalize();
        let (mesh, deformed, points) =
            points_of(|p| 0.3 * (-(p - toward).length_squared() / 0.08).exp(), seed);
        let growth = ControlGrowth { initial: 25, max: 150 };
        let few = grown(&mesh, &points, ControlGrowth { max: growth.initial, ..growth });
        let made = grown(&mesh, &points, growth);
        let near = |made: &GrownFit| made.controls.points.iter().filter(|p| p.distance(toward) < 0.6).count();
        let count = made.controls.points.len();
        assert_eq!(few.controls.points.len(), growth.initial);
        // Less than a tenth of the ball is near the bump.
        assert!(count > growth.initial + 10 && 7 * near(&made) > count, "{} of {count}", near(&made));
        let search = MeshSearch::try_new(&deformed).unwrap();
        let heights = |made: &GrownFit| -> Vec<f64> {
            made.fit.positions.iter().map(|p| search.closest(*p).unwrap().distance).collect()
        };
        let (before, after) = (heights(&few), heights(&made));
        assert!(rms(&after) < 0.6 * rms(&before), "{} {}", rms(&after), rms(&before));
        let found = TriangleMesh { positions: made.fit.positions.clone(), triangles: mesh.triangles.clone() };
        let normals = found.vertex_normals();
        let covered = (0..after.len())
            .filter(|v| after[*v] < 1.96 * made.fit.sigma_along(&*made.deformation, *v as u32, normals[*v]))
            .count();
        assert!(covered as f64 > 0.9 * after.len() as f64, "{covered} of {}", after.len());
    }
}

/// Noise and shape that the controls follow need no more of them.
#[test]
fn no_controls_are_added_for_noise() {
    for seed in [41, 42, 43] {
        let (mesh, _, points) = points_of(|_| 0.05, seed);
        let made = grown(&mesh, &points, ControlGrowth { initial: 25, max: 150 });
        assert_eq!(made.controls.points.len(), 25);
    }
}

/// A state of another fit is refused.
#[test]
fn states_of_other_fits_are_refused() {
    let (mesh, _, points) = points_of(|_| 0.0, 51);
    let controls = automatic_controls(&mesh, 20).unwrap();
    let ControlledDeformation { deformation, .. } = build(&mesh, &controls).unwrap();
    let camera = super::outlines::camera_at(DVec3::new(5.0, 0.0, 0.6), 0.0);
    for (parameters, cameras) in [(57, Vec::new()), (60, vec![camera])] {
        let parameters = DVector::zeros(parameters);
        let resume = Some(ResumePoint { parameters, cameras, smoothness_weight: 1.0 });
        let options = ShellFitOptions { resume, ..ShellFitOptions::default() };
        assert!(fit_points(&mesh, &*deformation, &points, &options).is_err());
    }
}
