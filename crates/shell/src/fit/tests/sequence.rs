//! Tracking of moving shells.

use super::outlines::{around, borders};
use super::*;
use nalgebra::Vector3;
use planish_core::SymmetricMatrix3;

const CONTROLS: usize = 20;

/// Positions of the controls of a swaying, breathing ball at a time.
fn motion_at(controls: &[DVec3], time: f64) -> DVector<f64> {
    DVector::from_iterator(
        3 * controls.len(),
        controls.iter().flat_map(|p| {
            let p = Vector3::from(*p);
            let bend = 0.15 * (0.4 * time).sin() * p.z * p.z;
            let grow = 0.06 * (0.3 * time + 1.0).sin();
            [
                bend + grow * p.x + 0.02 * time,
                grow * p.y,
                -0.5 * grow * p.z + 0.05 * (0.5 * time + 2.0 * p.x).sin(),
            ]
        }),
    )
}

/// With points, tracking is about as accurate as separate fits of the frames, or better; from outlines
/// alone, it is up to 40 % less accurate. The stated covariance of the parameters is correct.
#[test]
#[ignore = "takes longer than five seconds"]
fn a_moving_object_is_tracked() {
    let mesh = icosphere(1.0, 3);
    let controls = automatic_controls(&mesh, CONTROLS).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let options = ShellFitOptions {
        stiffness: Some(stiffness_for_xyz(&stiffness(
            &controls.points,
            &controls.triangles,
            &controls.edges,
        ))),
        steps: 2,
        ..ShellFitOptions::default()
    };
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut noise = move || -> f64 { StandardNormal.sample(&mut random) };
    let mut places = ChaCha8Rng::seed_from_u64(4);
    for with_points in [false, true] {
        let mut tracker = ShellTracker::new(&mesh, &deformation, options.clone()).unwrap();
        let (mut alone, mut followed, mut predicted) = (Vec::new(), Vec::new(), Vec::new());
        let mut ratios = Vec::new();
        for frame in 0..8 {
            let q = motion_at(&controls.points, f64::from(frame));
            let by = displacements(&deformation, &q);
            let truth = TriangleMesh {
                positions: mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect(),
                triangles: mesh.triangles.clone(),
            };
            let views: Vec<ShellView> =
                (around(4, 5.0).iter()).map(|camera| borders(&truth, camera, 60, &mut noise)).collect();
            let points: Vec<PointReading> =
                (sample_points(&truth, 150, || places.random_range(0.0..1.0)).unwrap().iter())
                    .map(|place| PointReading {
                        at: place.position.map(|x| x + 0.01 * noise()),
                        covariance: SymmetricMatrix3::isotropic(1e-4),
                    })
                    .collect();
            let readings = ShellReadings {
                points: if with_points { &points } else { &[] },
                views: &views,
                ..ShellReadings::default()
            };
            let search = MeshSearch::try_new(&truth).unwrap();
            let off = |positions: &[DVec3]| {
                rms(&positions.iter().map(|p| search.closest(*p).unwrap().distance).collect::<Vec<_>>())
            };
            let single = fit_shell(&mesh, &deformation, &readings, &options).unwrap();
            let made = tracker.follow(&readings).unwrap();
            let error = &made.fit.parameters - &q;
            let stated = made.fit.covariance.diagonal().map(|v| v.max(0.0).sqrt());
            let size = |v: &DVector<f64>| v.norm() / (v.len() as f64).sqrt();
            let normals = truth.vertex_normals();
            let within = (0..normals.len())
                .filter(|&v| {
                    let height = search.closest(made.fit.positions[v]).unwrap().signed_distance;
                    height.abs() < 1.96 * made.fit.sigma_along(&deformation, v as u32, normals[v])
                })
                .count() as f64
                / normals.len() as f64;
            println!(
                "frame {frame}: controls {:.4} off, σ {:.4}; surface {:.4}, alone {:.4}, covered \
                {within:.3}; predicted {:.4}; c {:.2e}",
                size(&error),
                size(&stated),
                off(&made.fit.positions),
                off(&single.positions),
                made.predicted.as_ref().map_or(f64::NAN, |p| size(&(p - &q))),
                made.acceleration
            );
            alone.push(off(&single.positions));
            followed.push(off(&made.fit.positions));
            predicted.extend(made.predicted.map(|p| size(&(p - &q))));
            ratios.push(size(&error) / size(&stated));
        }
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        println!(
            "points {with_points}: surface {:.4} followed, {:.4} alone; errors over σ of controls \
            {ratios:.2?}",
            mean(&followed[3..]),
            mean(&alone[3..])
        );
        let most = if with_points { 1.2 } else { 1.4 };
        assert!(mean(&followed[3..]) < most * mean(&alone[3..]));
        assert!(ratios[3..].iter().all(|ratio| (0.3..2.5).contains(ratio)), "{ratios:?}");
    }
    let none = ShellFitOptions { stiffness: None, ..options };
    let message = ShellTracker::new(&mesh, &deformation, none).err().unwrap().to_string();
    assert!(message.contains("stiffness"));
}

/// The first frame shows the mesh itself: its likelihood grows with the smoothness weight without bound.
/// Later frames are followed all the same.
#[test]
fn an_object_at_rest_in_the_first_frame_is_followed() {
    const SIGMA: f64 = 0.004;
    let mesh = icosphere(1.0, 3);
    let controls = automatic_controls(&mesh, CONTROLS).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let options = ShellFitOptions { stiffness: Some(k), steps: 2, ..ShellFitOptions::default() };
    let mut tracker = ShellTracker::new(&mesh, &deformation, options).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(8);
    for frame in 0..4_u64 {
        let bend = 0.05 * frame as f64;
        let positions = mesh.positions.iter().map(|p| *p + DVec3::X * (bend * p.z * p.z)).collect();
        let truth = TriangleMesh { positions, triangles: mesh.triangles.clone() };
        let points = noisy_points(&truth, 600, SIGMA, frame, &mut random);
        let readings = ShellReadings { points: &points, ..ShellReadings::default() };
        let made = tracker.follow(&readings).unwrap();
        let search = MeshSearch::try_new(&truth).unwrap();
        let off: Vec<f64> = made.fit.positions.iter().map(|p| search.closest(*p).unwrap().distance).collect();
        // Vertices of both meshes are on the same facets only where nothing slides along the surface.
        assert!(rms(&off) < 2.0 * SIGMA, "frame {frame}: {}", rms(&off));
    }
}

/// Given all frames, earlier ones are nearer to the truth than given those before, and σ is correct: of an
/// object that is at rest first, of one that pauses, and of one that starts at once.
#[test]
fn later_frames_improve_earlier_ones() {
    const SIGMA: f64 = 0.01;
    const FRAMES: u64 = 7;
    let mesh = icosphere(1.0, 3);
    let controls = automatic_controls(&mesh, CONTROLS).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let options = ShellFitOptions { stiffness: Some(k), steps: 2, ..ShellFitOptions::default() };
    let rest_first = |t: f64| 0.05 * (t - 2.0).max(0.0);
    let pause = |t: f64| 0.05 * (t - (t - 2.0).clamp(0.0, 2.0));
    let motions: [&dyn Fn(f64) -> f64; 3] = [&|t| 0.04 * t, &rest_first, &pause];
    for (number, bend) in (0_u64..).zip(motions) {
        let mut tracker = ShellTracker::new(&mesh, &deformation, options.clone()).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(60 + number);
        let frames: Vec<(TriangleMesh, Vec<PointReading>)> = (0..FRAMES)
            .map(|frame| {
                let bend = bend(frame as f64);
                let moved = controls.points.iter().flat_map(|p| [bend * p.z * p.z, 0.5 * bend * p.y, 0.0]);
                let q = DVector::from_iterator(3 * controls.points.len(), moved);
                let by = displacements(&deformation, &q);
                let positions = mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect();
                let truth = TriangleMesh { positions, triangles: mesh.triangles.clone() };
                let points = noisy_points(&truth, 60, SIGMA, frame + 100 * number, &mut random);
                (truth, points)
            })
            .collect();
        let followed: Vec<ShellFit> = (frames.iter())
            .map(|(_, points)| {
                tracker.follow(&ShellReadings { points, ..ShellReadings::default() }).unwrap().fit
            })
            .collect();
        let smoothed = tracker.smoothed().unwrap();
        // Errors and σ along the normals, over all frames but the last, which has no later ones.
        let mut sums = [[0.0; 2]; 2];
        for (frame, (truth, points)) in frames.iter().enumerate().take(FRAMES as usize - 1) {
            let readings = ShellReadings { points, ..ShellReadings::default() };
            let again = smoothed.fit(frame, &readings, &mut |_| Ok(())).unwrap().unwrap();
            let normals = truth.vertex_normals();
            for (fit, [error, variance]) in [&followed[frame], &again].into_iter().zip(&mut sums) {
                for (v, p) in fit.positions.iter().enumerate() {
                    *error += (*p - truth.positions[v]).dot(normals[v]).powi(2);
                    *variance += fit.sigma_along(&deformation, v as u32, normals[v]).powi(2);
                }
            }
        }
        let [[before, before_stated], [after, after_stated]] = sums;
        let ratios = [before / before_stated, after / after_stated].map(f64::sqrt);
        println!(
            "motion {number}: error {:.3} of the filtered one; over σ {ratios:.2?}",
            (after / before).sqrt()
        );
        assert!(after < before, "motion {number}");
        assert!((0.7..1.3).contains(&ratios[1]), "motion {number}: {ratios:?}");
    }
}
