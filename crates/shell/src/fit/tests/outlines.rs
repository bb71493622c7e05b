//! Fits to outlines, with known and with estimated cameras.

use super::super::equations::{Equations, Source};
use super::super::problem::{Problem, State};
use super::*;
use crate::camera::Camera;
use crate::deformation::displaced_positions;
use crate::field::ShellOptions;
use nalgebra::Vector3;
use planish_core::SymmetricMatrix3;

pub(super) const FOCAL: f64 = 800.0;
const SIGMA_PX: f64 = 1.0;

/// A camera at `from` that looks at the origin, turned about its axis by `roll`.
pub(super) fn camera_at(from: DVec3, roll: f64) -> Camera {
    let from = Vector3::from(from);
    let z = -from.normalize();
    let x = Vector3::new(-from.y, from.x, 0.3).cross(&z).cross(&z).normalize();
    let y = z.cross(&x);
    let (sin, cos) = roll.sin_cos();
    let rows = [cos * x + sin * y, cos * y - sin * x, z];
    let t = DVec3::from_array(std::array::from_fn(|k| -rows[k].dot(&from)));
    let k = [[FOCAL, 2.0, 320.0], [0.0, 1.02 * FOCAL, 240.0], [0.0, 0.0, 1.0]];
    Camera::new(k, rows.map(Into::into), t).unwrap()
}

/// Cameras all around, at about `distance`.
pub(super) fn around(count: usize, distance: f64) -> Vec<Camera> {
    (0..count)
        .map(|k| {
            let z = 1.0 - (2 * k + 1) as f64 / count as f64;
            let (sin, cos) = (2.4 * k as f64).sin_cos();
            let r = (1.0 - z * z).sqrt();
            camera_at(DVec3::new(distance * r * cos, distance * r * sin, distance * z), 0.1 * k as f64)
        })
        .collect()
}

/// The outline of a star-shaped object around the origin in a camera, by bisection of ray intersections,
/// independently of the fitting code.
pub(super) fn borders(
    mesh: &TriangleMesh,
    camera: &Camera,
    count: usize,
    mut noise: impl FnMut() -> f64,
) -> ShellView {
    let search = MeshSearch::try_new(mesh).unwrap();
    let (middle, _) = camera.project(DVec3::ZERO).unwrap();
    let hits = |pixel: [f64; 2]| search.first_hit(camera.center(), camera.direction(pixel)).is_some();
    let outline = (0..count)
        .map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / count as f64).sin_cos();
            let at = |r: f64| [middle[0] + r * cos, middle[1] + r * sin];
            let (mut low, mut high) = (0.0, 2000.0);
            while high - low > 1e-6 {
                let r = 0.5 * (low + high);
                if hits(at(r)) { low = r } else { high = r }
            }
            OutlinePoint {
                pixel: at(low).map(|x| x + SIGMA_PX * noise()),
                sigma_px: SIGMA_PX,
                kind: OutlineKind::Border,
            }
        })
        .collect();
    let (mut inside, mut outside) = (Vec::new(), Vec::new());
    for row in 0..24 {
        for column in 0..32 {
            let pixel = [20.0 * f64::from(column), 20.0 * f64::from(row)];
            if hits(pixel) { &mut inside } else { &mut outside }.push(pixel);
        }
    }
    ShellView { camera: *camera, pose: None, outline, inside, outside }
}

fn normal_numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    move || StandardNormal.sample(&mut random)
}

/// A ball is fitted to the outlines of twelve views alone. Shape and σ agree with the truth.
#[test]
fn outlines_alone_determine_the_shape() {
    let truth = truth(10, 1);
    let mut noise = normal_numbers(9);
    let views: Vec<ShellView> =
        (around(12, 5.0).iter()).map(|camera| borders(&truth.deformed, camera, 60, &mut noise)).collect();
    let options = ShellFitOptions { stiffness: Some(truth.stiffness.clone()), ..ShellFitOptions::default() };
    let readings = ShellReadings { views: &views, ..ShellReadings::default() };
    let made = fit_shell(&truth.mesh, &truth.deformation, &readings, &options).unwrap();
    let before = rms(&heights(&truth, &truth.mesh.positions));
    let off = heights(&truth, &made.positions);
    let covered = covered(&truth, &made, &off);
    println!(
        "{before:.4} before, {:.4} after; covered {covered:.3}; factor {:.3}, rms {:.3} px, {:?} after {}",
        rms(&off),
        made.outlines.sigma_factor,
        made.outlines.rms,
        made.termination,
        made.iterations
    );
    assert!(rms(&off) < 0.05 * before);
    assert!((made.outlines.sigma_factor - 1.0).abs() < 0.15 && (0.85..0.995).contains(&covered));
}

/// Share of vertices whose distance from the truth is within 1.96 σ.
fn covered(truth: &Truth, made: &ShellFit, off: &[f64]) -> f64 {
    let normals = truth.deformed.vertex_normals();
    let within = |v: usize| off[v].abs() < 1.96 * made.sigma_along(&truth.deformation, v as u32, normals[v]);
    (0..off.len()).filter(|&v| within(v)).count() as f64 / off.len() as f64
}

/// Mean rotation error in degrees and mean position error of the cameras after removal of a common motion,
/// which the readings do not determine.
fn poses_off(found: &[Camera], truth: &[Camera]) -> (f64, f64) {
    let changes: Vec<[f64; 6]> = found.iter().zip(truth).map(|(a, b)| a.change_from(b)).collect();
    let size = |range: std::ops::Range<usize>| {
        let squares: f64 = changes.iter().map(|c| range.clone().map(|k| c[k] * c[k]).sum::<f64>()).sum();
        (squares / changes.len() as f64).sqrt()
    };
    (size(0..3).to_degrees(), size(3..6))
}

/// Cameras perturbed by 1° and 1 % of their distance are recovered from outlines, features and a rough model;
/// the first two are fixed. Their σ is correct.
#[test]
#[ignore = "takes longer than five seconds"]
fn perturbed_camera_poses_are_estimated_with_the_shape() {
    let truth = truth(10, 2);
    let mut noise = normal_numbers(21);
    let cameras = around(8, 5.0);
    let perturbation = PoseNoise { sigma_rotation: 1_f64.to_radians(), sigma_translation: 0.05 };
    let mut views: Vec<ShellView> =
        (cameras.iter()).map(|camera| borders(&truth.deformed, camera, 60, &mut noise)).collect();
    for view in &mut views[2..] {
        view.camera = (view.camera).moved(std::array::from_fn(|k| {
            noise() * if k < 3 { perturbation.sigma_rotation } else { perturbation.sigma_translation }
        }));
        view.pose = Some(perturbation);
    }
    let mut random = ChaCha8Rng::seed_from_u64(77);
    let search = MeshSearch::try_new(&truth.deformed).unwrap();
    let tracks: Vec<FeatureTrack> =
        (sample_points(&truth.deformed, 80, || random.random_range(0.0..1.0)).unwrap().iter())
            .filter_map(|place| {
                let observations: Vec<FeatureObservation> = (cameras.iter().enumerate())
                    .filter(|(_, camera)| search.is_unobstructed(camera.center(), place.position, 1e-3))
                    .map(|(v, camera)| FeatureObservation {
                        view: v as u32,
                        pixel: camera.project(place.position).unwrap().0.map(|x| x + 0.5 * noise()),
                        sigma_px: 0.5,
                    })
                    .collect();
                (observations.len() >= 2).then_some(FeatureTrack { observations, sigma_surface: 0.001 })
            })
            .collect();
    let options = ShellFitOptions { stiffness: Some(truth.stiffness.clone()), ..ShellFitOptions::default() };
    let given: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let before = poses_off(&given[2..], &cameras[2..]);
    for tracks in [&[][..], &tracks] {
        let readings = ShellReadings { views: &views, tracks, ..ShellReadings::default() };
        let made = fit_shell(&truth.mesh, &truth.deformation, &readings, &options).unwrap();
        let off = heights(&truth, &made.positions);
        let after = poses_off(&made.cameras[2..], &cameras[2..]);
        let mut squares = 0.0;
        for v in 2..cameras.len() {
            let change = DVector::from_row_slice(&made.cameras[v].change_from(&cameras[v]));
            let covariance = made.pose_covariances[v].clone().unwrap();
            squares +=
                change.dot(&covariance.cholesky().unwrap().solve(&change)) / 6.0 / (cameras.len() - 2) as f64;
        }
        println!(
            "{} tracks: poses {before:?} before, {after:?} after, χ² of each number {squares:.2}; surface \
            {:.4}, covered {:.3}; {:?} after {}",
            tracks.len(),
            rms(&off),
            covered(&truth, &made, &off),
            made.termination,
            made.iterations
        );
        assert!(made.pose_covariances[0].is_none() && made.cameras[0] == cameras[0]);
        // The outlines of an almost round object hardly determine the rotation of a camera about its axis.
        let left = if tracks.is_empty() { 0.8 } else { 0.25 };
        assert!(after.0 < left * before.0 && after.1 < left * before.1, "{before:?} {after:?}");
        assert!((0.4..2.0).contains(&squares), "{squares}");
        assert!(rms(&off) < 0.01);
    }
}

/// A ball that is much too large shrinks; one that is much too small grows.
#[test]
#[ignore = "takes longer than five seconds"]
fn too_large_meshes_shrink_and_too_small_ones_grow() {
    let truth = truth(10, 4);
    let views: Vec<ShellView> =
        (around(8, 5.0).iter()).map(|camera| borders(&truth.deformed, camera, 80, || 0.0)).collect();
    for size in [0.5, 1.6] {
        let start = TriangleMesh {
            positions: truth.mesh.positions.iter().map(|p| p.map(|x| size * x)).collect(),
            triangles: truth.mesh.triangles.clone(),
        };
        let controls = automatic_controls(&start, 30).unwrap();
        let deformation = Dirichlet::new(&controls.points, &start.positions).unwrap();
        let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
        let options = ShellFitOptions { stiffness: Some(k), ..ShellFitOptions::default() };
        let readings = ShellReadings { views: &views, ..ShellReadings::default() };
        let made = fit_shell(&start, &deformation, &readings, &options).unwrap();
        let off = rms(&heights(&truth, &made.positions));
        println!(
            "from {size}: {off:.4}, rms {:.3} px, {:?} after {}",
            made.outlines.rms, made.termination, made.iterations
        );
        assert!(off < 0.02, "{size}: {off}");
    }
}

/// Derivatives of all kinds of equations with respect to parameters, poses and positions agree with finite
/// differences at random states.
#[test]
fn derivatives_agree_with_differences() {
    let mesh = icosphere(1.0, 2);
    let controls = automatic_controls(&mesh, 12).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(17);
    let mut normal = normal_numbers(5);
    let views: Vec<ShellView> = (around(4, 5.0).iter())
        .map(|camera| ShellView {
            camera: *camera,
            pose: Some(PoseNoise { sigma_rotation: 0.02, sigma_translation: 0.05 }),
            outline: Vec::new(),
            inside: Vec::new(),
            outside: Vec::new(),
        })
        .collect();
    let slots: Vec<Option<u32>> = (0..4).map(Some).collect();
    let (mut compared, mut worse) = ([0; 3], [0; 3]);
    for _ in 0..1000 {
        let q = DVector::from_fn(deformation.parameters(), |_, _| 0.03 * normal());
        let cameras: Vec<Camera> =
            (views.iter()).map(|view| view.camera.moved(std::array::from_fn(|_| 0.01 * normal()))).collect();
        let state = State { q, cameras };
        let mut own = views.clone();
        let at: DVec3 = DVec3::from_array(std::array::from_fn(|_| random.random_range(-0.6..0.6)));
        let mut tracked = Vec::new();
        for (v, view) in own.iter_mut().enumerate() {
            let angle: f64 = random.random_range(0.0..6.3);
            let r = random.random_range(145.0..175.0);
            view.outline.push(OutlinePoint {
                pixel: [320.0 + r * angle.cos(), 240.0 + r * angle.sin()],
                sigma_px: 1.0,
                kind: if v == 0 { OutlineKind::Contour } else { OutlineKind::Border },
            });
            let (pixel, _) = state.cameras[v].project(at).unwrap();
            tracked.push(FeatureObservation {
                view: v as u32,
                pixel: pixel.map(|x| x + normal()),
                sigma_px: 1.0,
            });
        }
        let points: Vec<PointReading> = (0..3)
            .map(|_| PointReading {
                at: Vector3::from_fn(|_, _| normal()).normalize().scale(1.0 + 0.05 * normal()).into(),
                covariance: SymmetricMatrix3::isotropic(1.0),
            })
            .collect();
        let tracks = [FeatureTrack { observations: tracked, sigma_surface: 0.01 }];
        let readings = ShellReadings { points: &points, views: &own, tracks: &tracks, landmarks: &[] };
        let problem = Problem {
            mesh: &mesh,
            origins: None,
            triangles: &mesh.triangles,
            deformation: &deformation,
            readings: &readings,
            shell: ShellOptions { oriented: true, ..ShellOptions::new(Metaball::Triangular, 10.0) },
            slots: &slots,
            chosen: &[0, 1, 2],
            by_sheets: false,
        };
        let way = DVector::from_fn(state.q.len() + 24, |_, _| normal());
        let step = 1e-5;
        let along = |by: f64| {
            let cameras = (state.cameras.iter().enumerate())
                .map(|(v, camera)| camera.moved(std::array::from_fn(|k| by * way[state.q.len() + 6 * v + k])))
                .collect();
            problem
                .equations(&State { q: &state.q + by * way.rows(0, state.q.len()), cameras }, None)
                .unwrap()
        };
        let at_state = problem.equations(&state, None).unwrap();
        let [before, after] = [along(-step), along(step)];
        let basis = crate::deformation::in_basis(&deformation, &way.rows(0, state.q.len()).into_owned());
        for ((at_state, before), after) in at_state.iter().zip(&before).zip(&after) {
            compare(
                at_state,
                before,
                after,
                &|vertices, poses| {
                    let mut sum = 0.0;
                    for (vertex, by) in vertices {
                        deformation.row(*vertex, *by, &mut |k, entry| sum += entry * basis[k]);
                    }
                    for (slot, by) in poses {
                        sum +=
                            (0..6).map(|k| by[k] * way[state.q.len() + 6 * *slot as usize + k]).sum::<f64>();
                    }
                    sum
                },
                step,
                &mut compared,
                &mut worse,
            );
        }
    }
    println!("compared {compared:?} of points, outlines, tracks; farther than 1 %: {worse:?}");
    assert!(compared[0] >= 3000 && compared[1] >= 4000 && compared[2] >= 1000, "{compared:?}");
    for (worse, compared) in worse.iter().zip(compared) {
        // Positions whose nearest facet changes between the differences.
        assert!(worse * 50 <= compared, "{worse} of {compared}");
    }
}

type Slope<'a> = &'a dyn Fn(&[(u32, DVec3)], &[(u32, [f64; 6])]) -> f64;

fn compare(
    at_state: &Equations,
    before: &Equations,
    after: &Equations,
    slope: Slope<'_>,
    step: f64,
    compared: &mut [usize; 3],
    worse: &mut [usize; 3],
) {
    // The basis of the equations that remain of a track depends on the state; half the sum of their squares
    // does not.
    let half_squares =
        |equations: &Equations| 0.5 * equations.list.iter().map(|e| e.distance * e.distance).sum::<f64>();
    if at_state.list.iter().any(|e| e.source == Source::Track) {
        let difference = (half_squares(after) - half_squares(before)) / (2.0 * step);
        let stated: f64 = (at_state.iter())
            .map(|(equation, vertices, poses)| equation.distance * slope(vertices, poses))
            .sum();
        compared[2] += 1;
        worse[2] += usize::from((difference - stated).abs() > 1e-3 * (stated.abs() + 1.0));
        return;
    }
    for (k, (equation, vertices, poses)) in at_state.iter().enumerate() {
        let difference = (after.list[k].distance - before.list[k].distance) / (2.0 * step);
        let stated = slope(vertices, poses);
        let kind = usize::from(equation.source != Source::Point);
        compared[kind] += 1;
        let off = (difference - stated).abs() / (stated.abs() + 0.1);
        if off > 1e-2 {
            worse[kind] += 1;
        }
    }
}

/// A ball that is open at the bottom, beyond the image, and faces inwards, with a loose collar around it that
/// faces outwards.
fn head_mesh() -> TriangleMesh {
    let mut mesh = icosphere(1.0, 4);
    let positions = mesh.positions.clone();
    mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    (mesh.triangles).retain(|t| t.iter().all(|v| positions[*v as usize][2] > -0.45));
    let (first, around) = (mesh.positions.len() as u32, 48);
    for ring in 0..6 {
        let up = 0.6 - 0.06 * f64::from(ring);
        let r = (1.0 - up * up).sqrt() + 0.04 * f64::from(ring);
        for k in 0..around {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(around)).sin_cos();
            mesh.positions.push(DVec3::new(r * cos, r * sin, up));
            if ring > 0 {
                let at = |ring: u32, k: u32| first + ring * around + k % around;
                let [a, b] = [at(ring as u32 - 1, k), at(ring as u32 - 1, k + 1)];
                let [c, d] = [at(ring as u32, k), at(ring as u32, k + 1)];
                mesh.triangles.extend([[a, c, d], [a, d, b]]);
            }
        }
    }
    mesh
}

/// An object that extends beyond all images, is open there and contains a loose sheet is fitted to its
/// outlines. The border of an image is not a reading, and the orientation of a part does not matter.
#[test]
fn objects_beyond_the_images_are_fitted() {
    let mesh = head_mesh();
    let controls = automatic_controls(&mesh, 30).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let q = DVector::from_iterator(
        deformation.parameters(),
        (controls.points.iter())
            .flat_map(|p| [0.1 * p[0] + 0.06 * p[2], 0.05 * (2.0 * p[0]).sin() - 0.04, 0.08 * p[1]]),
    );
    let deformed = TriangleMesh {
        positions: displaced_positions(&mesh.positions, &deformation, &q),
        triangles: mesh.triangles.clone(),
    };
    let mut noise = normal_numbers(5);
    let views: Vec<ShellView> = (0..8)
        .map(|k| {
            let (sin, cos) = (0.7 * f64::from(k)).sin_cos();
            let mut view =
                borders(&deformed, &camera_at(DVec3::new(5.0 * cos, 5.0 * sin, 0.6), 0.0), 90, &mut noise);
            let camera = view.camera;
            // The border of the image: lines of sight there meet the axis at this depth.
            let shown = |pixel: [f64; 2]| {
                let [origin, direction] = [camera.center(), camera.direction(pixel)];
                let along = -(origin[0] * direction[0] + origin[1] * direction[1])
                    / (direction[0] * direction[0] + direction[1] * direction[1]);
                origin[2] + along * direction[2] > -0.15
            };
            view.outline.retain(|place| shown(place.pixel));
            view.inside.retain(|pixel| shown(*pixel));
            view.outside.retain(|pixel| shown(*pixel));
            view
        })
        .collect();
    let options = ShellFitOptions {
        stiffness: Some(stiffness_for_xyz(&stiffness(
            &controls.points,
            &controls.triangles,
            &controls.edges,
        ))),
        ..ShellFitOptions::default()
    };
    let readings = ShellReadings { views: &views, ..ShellReadings::default() };
    let made = fit_shell(&mesh, &deformation, &readings, &options).unwrap();
    let search = MeshSearch::try_new(&deformed).unwrap();
    let off = |positions: &[DVec3]| {
        let seen = (0..positions.len()).filter(|v| mesh.positions[*v][2] > 0.0);
        rms(&seen.map(|v| search.closest(positions[v]).unwrap().distance).collect::<Vec<_>>())
    };
    let (before, after) = (off(&mesh.positions), off(&made.positions));
    println!(
        "{before:.4} before, {after:.4} after; factor {:.3}, rms {:.3} px, {:?} after {}",
        made.outlines.sigma_factor, made.outlines.rms, made.termination, made.iterations
    );
    assert!(after < 0.25 * before, "{before} {after}");
    assert!(made.outlines.sigma_factor < 1.5, "{}", made.outlines.sigma_factor);
}
