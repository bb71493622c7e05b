use super::*;
use crate::controls::{Controls, automatic_controls, stiffness};
use crate::deformation::{Dirichlet, Lattice, LatticeBasis};
use crate::deformation::{PartMotion, RigidPart, RigidParts, displaced_positions, displacements};
use planish_core::SymmetricMatrix3;
use planish_mesh::{MeshSearch, icosphere, sample_points};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

mod growth;
mod landmarks;
mod outlines;
mod oversized_plate;
mod roundness;
mod sequence;

const SIGMA: f64 = 0.01;

/// A ball deformed by known controls, and noisy points of it, a tenth of them outliers.
struct Truth {
    mesh: TriangleMesh,
    deformed: TriangleMesh,
    deformation: Dirichlet,
    stiffness: DMatrix<f64>,
    readings: Vec<PointReading>,
    /// Facet and barycentric weights of each reading; `None` for outliers.
    sources: Vec<Option<(u32, [f64; 3])>>,
}

fn truth(points: usize, seed: u64) -> Truth {
    let mesh = icosphere(1.0, 4);
    let controls = automatic_controls(&mesh, 30).unwrap();
    let deformation = Dirichlet::new(&controls.points, &mesh.positions).unwrap();
    let stiffness = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    // A smooth displacement: an affine one and a wave.
    let affine: [f64; 9] = std::array::from_fn(|_| 0.06 * normal());
    let wave: [f64; 9] = std::array::from_fn(|_| normal());
    let q = DVector::from_iterator(
        deformation.parameters(),
        controls.points.iter().flat_map(|p| {
            let own: [f64; 3] = std::array::from_fn(|k| {
                let applied = |matrix: &[f64; 9]| (0..3).map(|j| matrix[3 * k + j] * p[j]).sum::<f64>();
                applied(&affine) + 0.05 * applied(&wave).sin()
            });
            own
        }),
    );
    let by = displacements(&deformation, &q);
    let deformed = TriangleMesh {
        positions: mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect(),
        triangles: mesh.triangles.clone(),
    };
    let mut random = ChaCha8Rng::seed_from_u64(seed + 1000);
    let (mut readings, mut sources) = (Vec::new(), Vec::new());
    let mut places = ChaCha8Rng::seed_from_u64(seed + 2000);
    for sample in sample_points(&deformed, points, || places.random_range(0.0..1.0)).unwrap() {
        let gross = random.random_range(0.0..1.0) < 0.1;
        let at = if gross {
            std::array::from_fn(|_| random.random_range(-1.5..1.5))
        } else {
            std::array::from_fn(|k| {
                let noise: f64 = StandardNormal.sample(&mut random);
                sample.position[k] + SIGMA * noise
            })
        };
        let v = SIGMA * SIGMA;
        readings.push(PointReading { at: DVec3::from_array(at), covariance: SymmetricMatrix3::isotropic(v) });
        sources.push((!gross).then_some((sample.triangle, sample.barycentric)));
    }
    Truth { mesh, deformed, deformation, stiffness, readings, sources }
}

/// The linear fit with known correspondences: either of each point along the true normal, as for a shell, or
/// of all three coordinates.
fn with_correspondences(truth: &Truth, weight: f64, normals_only: bool) -> Vec<DVec3> {
    let normals = truth.deformed.face_normals();
    let basis = truth.deformation.basis();
    let (mut information, mut vector) = (DMatrix::zeros(basis, basis), DVector::zeros(basis));
    for (reading, source) in truth.readings.iter().zip(&truth.sources) {
        let Some((facet, weights)) = source else { continue };
        let vertices = truth.mesh.triangles[*facet as usize];
        let rest =
            (0..3).fold(DVec3::ZERO, |sum, k| sum + weights[k] * truth.mesh.positions[vertices[k] as usize]);
        let axes = [DVec3::X, DVec3::Y, DVec3::Z];
        let normal = [normals[*facet as usize]];
        for &direction in if normals_only { &normal[..] } else { &axes[..] } {
            let mut row = DVector::zeros(basis);
            for (vertex, w) in vertices.iter().zip(weights) {
                truth.deformation.row(*vertex, direction, &mut |k, entry| row[k] += w * entry);
            }
            let residual = (reading.at - rest).dot(direction);
            vector.axpy(residual / (SIGMA * SIGMA), &row, 1.0);
            information.ger(1.0 / (SIGMA * SIGMA), &row, &row, 1.0);
        }
    }
    let r = truth.deformation.reduction().unwrap();
    let equations = r.tr_mul(&(information * r)) + weight * &truth.stiffness;
    let q = equations.cholesky().unwrap().solve(&r.tr_mul(&vector));
    let by = displacements(&truth.deformation, &q);
    truth.mesh.positions.iter().zip(by).map(|(p, by)| *p + by).collect()
}

/// Distance of each vertex from the true surface. (Not from the true vertex, because readings do not
/// determine tangential positions.)
fn heights(truth: &Truth, positions: &[DVec3]) -> Vec<f64> {
    let search = MeshSearch::try_new(&truth.deformed).unwrap();
    positions.iter().map(|p| search.closest(*p).unwrap().signed_distance).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

/// Noise of points that are denser than σ. Of the points at one height above the mesh, the nearest ones have
/// the same height; that is not unresolved shape.
#[test]
fn dense_noise_is_not_unresolved_shape() {
    let truth = truth(20_000, 5);
    let options = ShellFitOptions { stiffness: Some(truth.stiffness.clone()), ..ShellFitOptions::default() };
    let made = fit_points(&truth.mesh, &truth.deformation, &truth.readings, &options).unwrap();
    assert!(made.unresolved_shape < 0.1 * SIGMA, "{} of {SIGMA}", made.unresolved_shape);
}

/// Compared with a fit with known correspondences, the error of the surface is at most a fifth larger, and
/// its σ is correct, for both kinds of metaballs.
#[test]
fn shells_are_as_accurate_as_fits_with_true_correspondences() {
    for metaball in [Metaball::Triangular, Metaball::Spherical] {
        let (mut fitted, mut with_normals, mut with_coordinates) = (Vec::new(), Vec::new(), Vec::new());
        let (mut covered, mut count) = (0, 0);
        let mut counts = [0; 4];
        for seed in 0..2 {
            let truth = truth(3000, seed);
            let options = ShellFitOptions {
                metaball,
                stiffness: Some(truth.stiffness.clone()),
                ..ShellFitOptions::default()
            };
            let made = fit_points(&truth.mesh, &truth.deformation, &truth.readings, &options).unwrap();
            let off = heights(&truth, &made.positions);
            let normals = truth.deformed.vertex_normals();
            for (v, (height, normal)) in off.iter().zip(&normals).enumerate() {
                let sigma = made.sigma_along(&truth.deformation, v as u32, *normal);
                covered += usize::from(height.abs() < 1.96 * sigma);
                count += 1;
            }
            for (outlier, source) in made.points.outliers.iter().zip(&truth.sources) {
                counts[usize::from(*outlier) + 2 * usize::from(source.is_none())] += 1;
            }
            println!(
                "{metaball:?}: σ factor {:.3}, λ {:.3e}, rms {:.5}, {:?} after {}",
                made.points.sigma_factor,
                made.smoothness_weight,
                made.points.rms,
                made.termination,
                made.iterations
            );
            assert!((made.points.sigma_factor - 1.0).abs() < 0.1);
            fitted.extend(off);
            let errors_of = |normals_only| {
                heights(&truth, &with_correspondences(&truth, made.smoothness_weight, normals_only))
            };
            with_normals.extend(errors_of(true));
            with_coordinates.extend(errors_of(false));
        }
        let share = f64::from(covered as u32) / f64::from(count as u32);
        println!(
            "{metaball:?}: {:.5} from the truth, {:.5} with true correspondences along normals, {:.5} \
            with those of all coordinates, {:.3} covered, {counts:?}",
            rms(&fitted),
            rms(&with_normals),
            rms(&with_coordinates),
            share
        );
        assert!(rms(&fitted) < 1.2 * rms(&with_normals), "{metaball:?}");
        // The controls follow this motion exactly, but σ allows for interpolation between them.
        assert!((0.9..0.985).contains(&share), "{metaball:?}: {share}");
        // Almost no inlier is rejected.
        assert!(counts[1] * 50 < counts[0], "{counts:?}");
    }
}

/// Another kind of deformation is fitted by the same code.
#[test]
fn a_lattice_is_fitted() {
    let truth = truth(2000, 5);
    let lattice = Lattice::new(&truth.mesh.positions, [4, 4, 4], LatticeBasis::Bernstein).unwrap();
    let controls = lattice.controls().unwrap();
    let pairs = crate::controls::nearest_pairs(controls, 6);
    let options = ShellFitOptions {
        stiffness: Some(stiffness_for_xyz(&stiffness(controls, &[], &pairs))),
        ..ShellFitOptions::default()
    };
    let made = fit_points(&truth.mesh, &lattice, &truth.readings, &options).unwrap();
    let before = rms(&heights(&truth, &truth.mesh.positions));
    let after = rms(&heights(&truth, &made.positions));
    assert!(after < 0.25 * before, "{before} {after}");
}

#[test]
fn messages_name_the_invalid_value() {
    let mesh = icosphere(1.0, 1);
    let deformation = Dirichlet::new(&mesh.positions[..4], &mesh.positions).unwrap();
    let good = PointReading { at: DVec3::X, covariance: SymmetricMatrix3::isotropic(1.0) };
    let refused = |points: &[PointReading], options: &ShellFitOptions| {
        fit_points(&mesh, &deformation, points, options).unwrap_err().to_string()
    };
    let defaults = ShellFitOptions::default();
    assert!(refused(&[], &defaults).contains("expected points"));
    let bad = PointReading { at: DVec3::new(f64::NAN, 0.0, 0.0), ..good };
    assert!(refused(&[good, bad], &defaults).contains("point 1"));
    let small = ShellFitOptions { stiffness: Some(DMatrix::identity(2, 2)), ..defaults.clone() };
    assert!(refused(&[good], &small).contains("2 × 2"));
    // One point does not determine most controls.
    assert!(refused(&[good], &defaults).contains("controls"));
}

/// Points of a mesh at random places, with noise of σ.
fn noisy_points(
    mesh: &TriangleMesh,
    count: usize,
    sigma: f64,
    places_seed: u64,
    random: &mut ChaCha8Rng,
) -> Vec<PointReading> {
    let mut places = ChaCha8Rng::seed_from_u64(places_seed);
    let sampled = sample_points(mesh, count, || places.random_range(0.0..1.0)).unwrap();
    let reading = |at: DVec3| PointReading {
        at: at.map(|x| {
            let noise: f64 = StandardNormal.sample(random);
            x + sigma * noise
        }),
        covariance: SymmetricMatrix3::isotropic(sigma * sigma),
    };
    sampled.iter().map(|place| place.position).map(reading).collect()
}

/// A part that turned by 35° is found with its size. Linearised at rest, it was found turned by half of that.
#[test]
fn a_part_that_turns_keeps_its_size() {
    const SIGMA: f64 = 0.004;
    let mut mesh = icosphere(1.0, 3);
    for p in &mut mesh.positions {
        let nose = 0.25 * (-8.0 * p.distance_squared(DVec3::new(0.8, 0.0, 0.6))).exp();
        *p = (1.0 + nose) * *p * DVec3::new(0.9, 0.7, 1.6);
    }
    let head: Vec<u32> =
        (0..mesh.positions.len() as u32).filter(|v| mesh.positions[*v as usize].z > 0.2).collect();
    let controls = automatic_controls(&mesh, 20).unwrap();
    let inner = Box::new(Dirichlet::new(&controls.points, &mesh.positions).unwrap());
    let part = RigidPart { vertices: head, motion: PartMotion::Free };
    let made = RigidParts::new(&mesh, inner, &[part], 0.8).unwrap();
    let k = stiffness_for_xyz(&stiffness(&controls.points, &controls.triangles, &controls.edges));
    let count = made.parameters();
    // The rotation times the radius of the part follows its translation.
    let turned = |size: f64| {
        let mut q = DVector::zeros(count);
        q[count - 1] = size;
        q
    };
    let radius = {
        let by = displacements(&made, &turned(1e-6));
        let v = (0..by.len()).max_by(|a, b| by[*a].length().total_cmp(&by[*b].length())).unwrap();
        let p = mesh.positions[v];
        1e-6 * p.x.hypot(p.y) / by[v].length()
    };
    let angle = 35.0_f64.to_radians();
    let truth = TriangleMesh {
        positions: displaced_positions(&mesh.positions, &made, &turned(angle * radius)),
        triangles: mesh.triangles.clone(),
    };
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let points = noisy_points(&truth, 1500, SIGMA, 6, &mut random);
    let options = ShellFitOptions { stiffness: Some(made.stiffness(&k)), ..ShellFitOptions::default() };
    let fit = fit_points(&mesh, &made, &points, &options).unwrap();
    let found = fit.parameters.rows(count - 3, 3).norm() / radius;
    assert!((found - angle).abs() < 0.01, "{} of 35°", found.to_degrees());
    assert!(fit.points.rms < 1.3 * SIGMA, "{}", fit.points.rms);
}
