use super::*;
use planish_core::Silent;
use planish_core::SymmetricMatrix3;
use planish_estimate::ErrorKind;
use planish_mesh::{grid_sheet, icosphere};
use planish_spline::{Shape, Surface, SurfaceSystem, leaf_weights};
use planish_surface::test_support::{SIGMA, model_of, refined_surface};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn compared(model: &Compared, reference: Reference) -> ComparisonReport {
    compare(model, reference, &CompareOptions::default(), &Silent).unwrap()
}

/// A model of a unit ball, or of a plane of 2 × 1.6 at z = 0 that looks up.
fn measured(shape: Shape) -> Compared {
    Compared::Surface(Box::new(model_of(refined_surface(shape), |_| true)))
}

fn mesh_reference(mesh: TriangleMesh) -> Reference {
    Reference {
        normals: Some(mesh.vertex_normals()),
        points: mesh.positions,
        triangles: mesh.triangles,
        ..Reference::default()
    }
}

fn points(points: Vec<DVec3>) -> Reference {
    Reference { points, ..Reference::default() }
}

fn standard_normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

#[test]
fn a_model_outside_its_reference_is_positive_in_both_directions() {
    let small = icosphere(0.9, 4);
    for model in [
        measured(Shape::Ball),
        Compared::Mesh(ComparedMesh { mesh: icosphere(1.0, 5), ..ComparedMesh::default() }),
    ] {
        let report = compared(&model, mesh_reference(small.clone()));
        for found in [report.forward.unwrap(), report.backward.unwrap()] {
            assert!((found.mean - 0.1).abs() < 3e-3 && (found.rms - 0.1).abs() < 3e-3, "{found:?}");
        }
        let large = compared(&model, mesh_reference(icosphere(1.1, 4)));
        assert!(large.forward.unwrap().mean < -0.09 && large.backward.unwrap().mean < -0.09);
        assert!(report.findings.is_empty());
    }
}

#[test]
fn the_chord_error_of_a_mesh_is_in_the_offset_of_points() {
    // Vertices of the mesh lie on the unit sphere, as do the points but for their noise.
    for (seed, level) in [(1, 3), (2, 4), (3, 4), (4, 5)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let cloud = (0..4_000).map(|_| {
            let n = DVec3::from_array([(); 3].map(|()| standard_normal(&mut rng))).normalize();
            (1.0 + 0.005 * standard_normal(&mut rng)) * n
        });
        let reference = points(cloud.collect());
        let mesh = ComparedMesh { mesh: icosphere(1.0, level), ..ComparedMesh::default() };
        let offset = compared(&Compared::Mesh(mesh), reference).backward.unwrap().offset.unwrap();
        println!("level {level}: {offset:?}");
        assert!(offset.value.abs() < 3.0 * offset.sigma, "level {level}: {offset:?}");
        // It is no excuse for more than that.
        assert!(offset.sigma < 1.2 * offset.value.abs() + 3e-4, "level {level}: {offset:?}");
    }
}

#[test]
fn signs_follow_the_normals_of_the_reference_then_of_the_model() {
    let model = measured(Shape::Ball);
    let small = icosphere(0.9, 3);
    let inward: Vec<DVec3> = small.vertex_normals().into_iter().map(|n| -n).collect();
    let turned = Reference { normals: Some(inward), ..points(small.positions.clone()) };
    let report = compared(&model, turned);
    assert!(report.backward.unwrap().mean < -0.09);
    assert!(report.findings.iter().any(|f| f.text.contains("opposite")), "{:?}", report.findings);
    let report = compared(&model, points(small.positions));
    assert!(report.backward.unwrap().mean > 0.09);
    assert!(report.forward.is_none());
    assert!(report.findings.iter().any(|f| f.text.contains("no faces")), "{:?}", report.findings);
}

/// A plane fitted to readings with errors of `SIGMA`, whose information counts them as `stated` times that.
fn noisy_plane(seed: u64, stated: f64) -> Compared {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let plane: Surface = refined_surface(Shape::Sheet);
    let mut model = model_of(plane.clone(), |_| true);
    let system = SurfaceSystem::new(plane.space()).unwrap();
    let errors: Vec<[f64; 16]> = (0..plane.space().leaves().len())
        .map(|_| [0; 16].map(|_| SIGMA * standard_normal(&mut rng)))
        .collect();
    let w = (stated * SIGMA).powi(-2);
    let information = model.known.information_mut().unwrap();
    information.data = system
        .accumulate(|leaf, cell| {
            for n in 0..16 {
                let local = [n % 4, n / 4].map(|k| (f64::from(k as u32) + 0.5) / 4.0);
                let mut point = plane.leaf_point(leaf, local[0], local[1]);
                point[2] += errors[leaf][n];
                cell.add_vector(&leaf_weights(local[0], local[1]), point, &[w, 0.0, 0.0, w, 0.0, w]);
            }
            true
        })
        .unwrap();
    let mut total = information.data.clone();
    total.add_scaled(&information.prior, 1.0).unwrap();
    let mut mean = total.vector().to_vec();
    system.factorize(&total).unwrap().solve_in_place(&mut mean).unwrap();
    model.surface = system.surface(&mean).unwrap();
    Compared::Surface(Box::new(model))
}

/// Points of the true plane, well inside, with errors of `sigma` along z that are stated.
fn points_of_plane(rng: &mut ChaCha8Rng, sigma: f64) -> Reference {
    let on_grid = |k: usize| [-0.85 + 0.1 * (k % 18) as f64, -0.65 + 0.1 * (k / 18) as f64];
    let made: Vec<DVec3> = (0..18 * 14)
        .map(|k| {
            let [x, y] = on_grid(k);
            DVec3::new(x, y, sigma * standard_normal(rng))
        })
        .collect();
    Reference {
        covariance: (sigma > 0.0).then(|| vec![SymmetricMatrix3::isotropic(sigma * sigma); made.len()]),
        ..points(made)
    }
}

/// Mean coverage of many fits.
fn coverage(stated: f64, reference_sigma: f64) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(99);
    let runs = 60;
    let sum: f64 = (0..runs)
        .map(|seed| {
            let reference = points_of_plane(&mut rng, reference_sigma);
            compared(&noisy_plane(seed, stated), reference).coverage95.unwrap()
        })
        .sum();
    sum / f64::from(runs as u32)
}

#[test]
fn a_correct_sigma_covers_ninety_five_per_cent() {
    // Sixty fits of some forty degrees of freedom each: the mean is known to half a per cent.
    let found = coverage(1.0, 0.0);
    assert!((0.94..0.97).contains(&found), "{found}");
    // A reference with errors of its own that it states.
    let found = coverage(1.0, SIGMA);
    assert!((0.94..0.96).contains(&found), "{found}");
}

#[test]
fn a_sigma_three_times_too_small_covers_half() {
    // Φ(1.96/3) − Φ(−1.96/3) = 0.486.
    let found = coverage(1.0 / 3.0, 0.0);
    assert!((0.45..0.53).contains(&found), "{found}");
}

#[test]
fn coverage_of_a_mesh_uses_the_sigma_of_its_vertices() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let truth = grid_sheet(10.0, 10.0, 100, 100);
    let heights: Vec<f64> = truth.positions.iter().map(|_| 1e-3 * standard_normal(&mut rng)).collect();
    let mut mesh = truth.clone();
    for (p, h) in mesh.positions.iter_mut().zip(&heights) {
        p[2] += h;
    }
    for (sigma, low, high) in [(1e-3, 0.94, 0.96), (1e-3 / 3.0, 0.46, 0.51)] {
        let model = Compared::Mesh(ComparedMesh {
            sigma: Some(vec![sigma; heights.len()]),
            mesh: mesh.clone(),
            ..ComparedMesh::default()
        });
        let found = compared(&model, points(truth.positions.clone())).coverage95.unwrap();
        assert!((low..high).contains(&found), "{sigma}: {found}");
    }
}

#[test]
fn points_beyond_a_border_are_not_compared() {
    let model = measured(Shape::Sheet);
    // Three points over the sheet, two outside of it.
    let shifted = vec![
        DVec3::new(0.0, 0.0, 0.1),
        DVec3::new(0.5, 0.2, 0.1),
        DVec3::new(-0.5, 0.2, 0.1),
        DVec3::new(1.5, 0.0, 0.1),
        DVec3::new(0.0, -2.0, 0.1),
    ];
    let report = compared(&model, points(shifted));
    let backward = report.backward.unwrap();
    assert_eq!((backward.n, report.skipped.reference_beyond_border), (3, 2));
    // The model is below them, and its normal points up.
    assert!((backward.mean + 0.1).abs() < 1e-9 && (backward.max - 0.1).abs() < 1e-9, "{backward:?}");
    // A reference of half the size: the rest of the model has no counterpart.
    let report = compared(&model, mesh_reference(grid_sheet(1.0, 0.8, 8, 8)));
    let forward = report.forward.unwrap();
    assert!(report.skipped.model_beyond_border > forward.n && forward.n > 0, "{report:?}");
    assert!(forward.max < 1e-9);
}

#[test]
fn only_measured_parts_are_compared() {
    let surface = refined_surface(Shape::Sheet);
    let left = |leaf: usize| surface.leaf_point(leaf, 0.5, 0.5)[0] < 0.0;
    let model = Compared::Surface(Box::new(model_of(surface.clone(), left)));
    let report = compared(
        &model,
        points(vec![DVec3::new(-0.5, 0.0, 0.1), DVec3::new(-0.4, 0.1, 0.1), DVec3::new(0.5, 0.0, 0.1)]),
    );
    assert_eq!((report.backward.unwrap().n, report.skipped.reference_not_observed), (2, 1));
    let report = compared(&model, mesh_reference(grid_sheet(4.0, 4.0, 8, 8)));
    assert!(report.skipped.model_not_observed > 0);
    let mesh = grid_sheet(2.0, 2.0, 4, 4);
    let observed = mesh.positions.iter().map(|p| Observed::from_measured(p[0] < 0.1)).collect();
    let model = Compared::Mesh(ComparedMesh { mesh, observed: Some(observed), ..ComparedMesh::default() });
    let report = compared(&model, points(vec![DVec3::new(-0.5, 0.0, 0.1), DVec3::new(0.5, 0.0, 0.1)]));
    assert_eq!((report.backward.unwrap().n, report.skipped.reference_not_observed), (1, 1));
    assert_eq!(report.coverage95, None);
}

#[test]
fn a_reference_in_another_unit_is_converted() {
    let model = measured(Shape::Ball);
    let in_unit = |unit: Option<Unit>, factor: f64| {
        let mut reference = mesh_reference(icosphere(0.9, 3));
        reference.points.iter_mut().for_each(|p| *p = factor * *p);
        reference.covariance =
            Some(vec![SymmetricMatrix3::isotropic((0.05 * factor).powi(2)); reference.points.len()]);
        Reference { unit, ..reference }
    };
    let plain = compared(&model, in_unit(Some(Unit::Millimetre), 1.0));
    let metres = compared(&model, in_unit(Some(Unit::Metre), 1e-3));
    assert!(plain.findings.is_empty());
    assert!(metres.findings.iter().any(|f| f.text.contains("was converted")), "{:?}", metres.findings);
    for (a, b) in [(plain.forward, metres.forward), (plain.backward, metres.backward)] {
        let (a, b) = (a.unwrap(), b.unwrap());
        assert!((a.rms - b.rms).abs() < 1e-12 && (a.mean - b.mean).abs() < 1e-12);
    }
    assert_eq!(plain.coverage95, metres.coverage95);
    // A file that names no unit is in that of the option, or of the other file.
    let options = CompareOptions { unit: Some(Unit::Metre), ..CompareOptions::default() };
    let scaled = compare(&model, in_unit(None, 1e-3), &options, &Silent).unwrap();
    assert_eq!((scaled.unit, scaled.backward.unwrap().n), (Unit::Millimetre, metres.backward.unwrap().n));
    assert!((scaled.backward.unwrap().rms - plain.backward.unwrap().rms).abs() < 1e-12);
    assert_eq!(compared(&model, in_unit(None, 1.0)).backward, plain.backward);
}

#[test]
fn objects_without_overlap_cannot_be_compared() {
    let model = measured(Shape::Sheet);
    let e = compare(&model, points(vec![DVec3::new(50.0, 0.0, 0.0)]), &CompareOptions::default(), &Silent)
        .unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Undetermined);
    assert!(e.to_string().contains("reference that overlap"), "{e}");
}

#[test]
fn impossible_columns_are_rejected_with_their_vertex() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, columns: &str, values: &str| {
        let properties: String = columns.split(' ').map(|c| format!("property double {c}\n")).collect();
        let path = folder.path().join(name);
        let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n{values}\n");
        std::fs::write(&path, text).unwrap();
        path
    };
    for (columns, values, words) in [
        ("x y z sigma", "0 0 0 -1", "vertex 0: expected sigma ≥ 0, found -1"),
        ("x y z cxx cxy cxz cyy cyz czz", "0 0 0 1 0 0 -1 0 1", "vertex 0: expected a covariance"),
        ("x y z cxx cxy cxz cyy cyz czz", "0 0 0 1 0 0 nan 0 1", "vertex 0: expected a covariance"),
    ] {
        let e = Reference::read(&write("a.ply", columns, values)).unwrap_err();
        assert!(e.kind() == ErrorKind::Input && e.to_string().contains(words), "{e}");
    }
    let e = Compared::read(&write("b.ply", "x y z", "0 0 0")).unwrap_err();
    assert!(e.to_string().contains("found points only"), "{e}");
    assert_eq!(Compared::read(Path::new("a.3mf")).unwrap_err().kind(), ErrorKind::Unsupported);
}
