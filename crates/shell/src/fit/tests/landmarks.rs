//! Landmarks, which say where places of the mesh are along the surface.

use super::*;
use planish_core::Pose;

/// Number of landmarks, and their σ.
const COUNT: usize = 14;
const LANDMARK_SIGMA: f64 = 0.005;

/// A motion of a place of a ball.
type Motion<'a> = &'a dyn Fn(DVec3) -> DVec3;

/// A ball, its true places after a motion, points on it, and landmarks spread over it.
fn scene(
    motion: Motion<'_>,
    seed: u64,
) -> (TriangleMesh, Vec<DVec3>, Vec<PointReading>, Vec<LandmarkReading>) {
    let mesh = icosphere(1.0, 4);
    let places: Vec<DVec3> = mesh.positions.iter().map(|p| motion(*p)).collect();
    let moved = TriangleMesh { positions: places.clone(), triangles: mesh.triangles.clone() };
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let samples = sample_points(&moved, 3000, || random.random_range(0.0..1.0)).unwrap();
    let mut noise = ChaCha8Rng::seed_from_u64(seed + 1);
    let mut off = |sigma: f64| {
        let mut normal = || -> f64 { StandardNormal.sample(&mut noise) };
        sigma * DVec3::new(normal(), normal(), normal())
    };
    let points = (samples.iter())
        .map(|sample| PointReading {
            at: sample.position + off(SIGMA),
            covariance: SymmetricMatrix3::isotropic(SIGMA * SIGMA),
        })
        .collect();
    let step = mesh.positions.len() / COUNT;
    let landmarks = (0..COUNT)
        .map(|k| LandmarkReading {
            vertices: [(k * step) as u32; 3],
            weights: [1.0, 0.0, 0.0],
            at: places[k * step] + off(LANDMARK_SIGMA),
            covariance: SymmetricMatrix3::isotropic(LANDMARK_SIGMA * LANDMARK_SIGMA),
        })
        .collect();
    (mesh, places, points, landmarks)
}

fn fitted(mesh: &TriangleMesh, points: &[PointReading], landmarks: &[LandmarkReading]) -> ShellFit {
    let controls = automatic_controls(mesh, 30).unwrap();
    let k = stiffness(&controls.points, &controls.triangles, &controls.edges);
    let options = ShellFitOptions {
        rigidity: Some(Rigidity::new(&controls.points, &controls.edges, &k).unwrap()),
        stiffness: Some(stiffness_for_xyz(&k)),
        ..ShellFitOptions::default()
    };
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let readings = ShellReadings { points, landmarks, ..ShellReadings::default() };
    fit_shell(mesh, &deformation, &readings, &options).unwrap()
}

fn rms_error(fit: &ShellFit, places: &[DVec3]) -> f64 {
    rms(&fit.positions.iter().zip(places).map(|(a, b)| a.distance(*b)).collect::<Vec<_>>())
}

/// A ball that turns about its centre looks the same to points. Landmarks show the turn.
#[test]
fn landmarks_show_motions_along_the_surface() {
    for seed in [1, 2] {
        let turn = Pose::from_rotation_vector(DVec3::new(0.1, 0.3, -0.2), DVec3::ZERO);
        let (mesh, places, points, landmarks) = scene(&|p| turn.rotate(p), seed);
        let with = rms_error(&fitted(&mesh, &points, &landmarks), &places);
        let without = rms_error(&fitted(&mesh, &points, &[]), &places);
        assert!(with < LANDMARK_SIGMA && without > 0.2, "{with} {without}");
    }
}

/// A mesh far from its points and turned by 170° is brought to them, with points and without.
#[test]
fn landmarks_bring_a_mesh_to_far_points() {
    for seed in [3, 4] {
        let turn = Pose::from_rotation_vector(170_f64.to_radians() * DVec3::new(0.6, 0.0, 0.8), DVec3::ZERO);
        let motion = |p: DVec3| {
            let stretched = DVec3::new(1.3 * p.x, p.y, 0.8 * p.z + 0.2 * p.x * p.y);
            turn.rotate(stretched) + DVec3::new(5.0, -7.0, 9.0)
        };
        let (mesh, places, points, landmarks) = scene(&motion, seed);
        let [with, alone] = [&points[..], &[]].map(|p| fitted(&mesh, p, &landmarks));
        assert!(rms_error(&with, &places) < 0.05, "{}", rms_error(&with, &places));
        assert!(rms_error(&alone, &places) < 0.15, "{}", rms_error(&alone, &places));
        let inside = |v: &usize| {
            let off = with.positions[*v] - places[*v];
            off.dot(places[*v] - DVec3::new(5.0, -7.0, 9.0)).abs() < 0.05
        };
        assert!((0..places.len()).filter(inside).count() * 20 > 19 * places.len());
    }
}

/// Two landmarks that were confused with each other are rejected, and the others count.
#[test]
fn confused_landmarks_are_rejected() {
    for seed in [5, 6] {
        let turn = Pose::from_rotation_vector(DVec3::new(0.0, 0.2, 0.1), DVec3::ZERO);
        let (mesh, places, points, mut landmarks) = scene(&|p| turn.rotate(p), seed);
        let positions = [landmarks[2].at, landmarks[9].at];
        (landmarks[9].at, landmarks[2].at) = (positions[0], positions[1]);
        let fit = fitted(&mesh, &points, &landmarks);
        let rejected: Vec<usize> = (0..COUNT).filter(|k| fit.landmarks.outliers[*k]).collect();
        assert_eq!(rejected, [2, 9]);
        assert!(rms_error(&fit, &places) < 2.0 * LANDMARK_SIGMA, "{}", rms_error(&fit, &places));
    }
}
