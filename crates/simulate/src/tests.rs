use super::*;
use planish_core::DVec3;
use planish_core::Silent;
use planish_estimate::ErrorKind;
use planish_exchange::{Unit, read_inputs};
use planish_sense::{Noise, Pose, SensorKind, ray_at};
use planish_spline::{Hierarchy, Jet, Shape, SurfaceSystem, leaf_weights, quadrature};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const SHAPES: [Shape; 3] = [Shape::Sheet, Shape::Tube, Shape::Ball];
const SIZE: f64 = 100.0;

fn truths() -> Vec<Truth> {
    let mut truths: Vec<Truth> =
        SHAPES.iter().map(|&shape| Truth::freeform(shape, SIZE, 5).unwrap()).collect();
    for (shape, base) in
        [(Shape::Sheet, [6, 5]), (Shape::Tube, [8, 6]), (Shape::Ball, [10, 8]), (Shape::Torus, [10, 6])]
    {
        let space = Hierarchy::uniform(shape, base).unwrap();
        truths.push(Truth::in_space(&Arc::new(space.refine(&[20, 21, 22, 23])), SIZE, 5).unwrap());
    }
    truths
}

fn near(a: DVec3, b: DVec3, within: f64) -> bool {
    a.distance(b) <= within
}

#[test]
fn derivatives_of_every_closed_form_match_differences() {
    for shape in SHAPES {
        for seed in 0..4 {
            let form = ClosedForm::random(shape, SIZE, seed).unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            for _ in 0..40 {
                let (u, v): (f64, f64) = (0.05 + 0.9 * rng.random::<f64>(), 0.05 + 0.9 * rng.random::<f64>());
                let h = 1e-5;
                let [jet, u1, u0, v1, v0] =
                    [[u, v], [u + h, v], [u - h, v], [u, v + h], [u, v - h]].map(|[u, v]| form.jet(u, v));
                let slope = |f: fn(&Jet) -> DVec3, a: &Jet, b: &Jet| 0.5 / h * (f(a) - f(b));
                let point = |j: &Jet| j.point;
                assert!(near(slope(point, &u1, &u0), jet.du, 1e-5 * SIZE));
                assert!(near(slope(point, &v1, &v0), jet.dv, 1e-5 * SIZE));
                assert!(near(slope(|j| j.du, &u1, &u0), jet.duu, 1e-4 * SIZE));
                assert!(near(slope(|j| j.du, &v1, &v0), jet.duv, 1e-4 * SIZE));
                assert!(near(slope(|j| j.dv, &v1, &v0), jet.dvv, 1e-4 * SIZE));
            }
        }
    }
}

#[test]
fn normals_are_exact_and_point_outwards_poles_included() {
    for truth in truths() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for _ in 0..100 {
            let (u, v): (f64, f64) = (0.02 + 0.96 * rng.random::<f64>(), 0.02 + 0.96 * rng.random::<f64>());
            let h = 1e-6;
            let differences = (truth.point(u + h, v) - truth.point(u - h, v))
                .cross(truth.point(u, v + h) - truth.point(u, v - h));
            let expected = differences.try_normalize().unwrap();
            assert!(near(truth.normal(u, v), expected, 1e-6), "{:?} {u} {v}", truth.shape());
        }
        // All triangles face outwards: closed meshes enclose a positive volume.
        let (mesh, normals) = truth.mesh(6_000);
        assert!(mesh.triangles.len() <= 6_000 && mesh.triangles.len() > 3_000);
        let check = mesh.check();
        let closed = matches!(truth.shape(), Shape::Ball | Shape::Torus);
        assert!(check.manifold && check.oriented && check.watertight == closed, "{check:?}");
        assert!(mesh.signed_volume().is_none_or(|v| v > 0.0) && mesh.signed_volume().is_some() == closed);
        let agree = mesh.vertex_normals().iter().zip(&normals).filter(|(a, b)| a.dot(**b) > 0.98).count();
        assert!(
            agree as f64 > 0.99 * normals.len() as f64,
            "{:?} {agree} of {}",
            truth.shape(),
            normals.len()
        );
    }
    let ball = Truth::freeform(Shape::Ball, SIZE, 5).unwrap();
    for v in [0.0, 1.0] {
        // At the pole, all meridians have the same normal, and it is close to that of the neighbourhood.
        let pole = ball.normal(0.0, v);
        let inwards = if v > 0.5 { -1e-6 } else { 1e-6 };
        for u in [0.0, 0.3, 0.7] {
            assert!(near(ball.normal(u, v), pole, 1e-12));
            assert!(near(ball.normal(u, v + inwards), pole, 1e-4));
        }
        assert!(ball.curvature(0.0, v).is_some());
    }
}

#[test]
fn curvature_does_not_depend_on_the_chart() {
    let ball = Truth::freeform(Shape::Ball, SIZE, 3).unwrap();
    for (u, v) in [(0.1, 0.2), (0.6, 0.5), (0.9, 0.85)] {
        let (a, b) = (ball.curvature(u, v).unwrap(), ball.jet(u, v).curvature().unwrap());
        assert!((a.gaussian() - b.gaussian()).abs() < 1e-10 && (a.mean() - b.mean()).abs() < 1e-10);
        assert!(a.mean() < 0.0, "outward normals of a blob: mean curvature is mostly negative");
    }
}

#[test]
fn distances_of_points_moved_along_normals_are_exact() {
    for truth in truths() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for point in truth.sample_area_uniform(200, &mut rng) {
            let height = 1.2 * (rng.random::<f64>() - 0.5);
            let foot = truth.foot(point.position + height * point.normal).unwrap();
            let [u, v] = point.parameters.unwrap();
            let inside = [u, v].iter().all(|&c| c > 0.02 && c < 0.98);
            if !inside {
                continue;
            }
            assert!(
                (foot.signed_distance - height).abs() < 1e-8,
                "{:?} {point:?} {height} {foot:?}",
                truth.shape()
            );
            assert!(near(foot.point.position, point.position, 1e-6) && !foot.at_border);
        }
    }
    let sheet = Truth::freeform(Shape::Sheet, SIZE, 5).unwrap();
    let beyond = sheet.point(1.0, 0.5) + 3.0 * DVec3::X;
    let foot = sheet.foot(beyond).unwrap();
    assert!(foot.at_border && foot.signed_distance.abs() <= 3.0 && foot.signed_distance.abs() > 2.5);
    assert!(sheet.foot(DVec3::splat(f64::NAN)).is_none());
}

#[test]
fn samples_are_uniform_per_area() {
    let (columns, rows, count) = (4, 4, 20_000);
    for truth in truths() {
        // Areas of the parameter cells by a midpoint rule.
        let fine = 24;
        let mut areas = vec![0.0; columns * rows];
        for j in 0..fine * rows {
            for i in 0..fine * columns {
                let [u, v] = [(i, columns), (j, rows)].map(|(k, n)| (k as f64 + 0.5) / (fine * n) as f64);
                areas[(j / fine) * columns + i / fine] += truth.area_element(u, v);
            }
        }
        let total: f64 = areas.iter().sum();
        let mut counts = vec![0.0; columns * rows];
        for point in truth.sample_area_uniform(count, &mut ChaCha8Rng::seed_from_u64(3)) {
            let [u, v] = point.parameters.unwrap();
            let cell = |x: f64, n: usize| ((x * n as f64) as usize).min(n - 1);
            counts[cell(v, rows) * columns + cell(u, columns)] += 1.0;
        }
        let chi2: f64 = areas
            .iter()
            .zip(&counts)
            .map(|(a, n)| {
                let expected = count as f64 * a / total;
                (n - expected) * (n - expected) / expected
            })
            .sum();
        // 15 degrees of freedom: the 99.9 % quantile is 37.7.
        assert!(chi2 < 37.7, "{:?} {chi2} {counts:?}", truth.shape());
    }
}

#[test]
fn rays_meet_the_exact_surface_not_its_facets() {
    for truth in truths() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut hits = 0;
        for target in truth.sample_area_uniform(100, &mut rng) {
            let origin = target.position
                + 3.0 * SIZE * (target.normal + 0.3 * DVec3::new(0.6, 0.0, 0.8)).try_normalize().unwrap();
            let direction = (target.position - origin).try_normalize().unwrap();
            let Some((point, along)) = truth.first_hit(origin, direction) else {
                continue;
            };
            hits += 1;
            assert!(near(point.position, origin + along * direction, 1e-8));
            let [u, v] = point.parameters.unwrap();
            assert!(near(truth.point(u, v), point.position, 1e-9));
            assert!(
                along < origin.distance(target.position) + 1e-6,
                "the target itself is no farther than the first hit"
            );
        }
        assert!(hits > 90, "{:?} {hits}", truth.shape());
    }
}

#[test]
fn a_random_surface_of_a_space_has_that_space_and_its_seed() {
    let space = Arc::new(Hierarchy::uniform(Shape::Ball, [10, 8]).unwrap().refine(&[30, 31, 32, 33]));
    let truth = Truth::in_space(&space, SIZE, 1).unwrap();
    let surface = truth.surface().unwrap();
    assert!(Arc::ptr_eq(surface.space(), &space));
    let again = Truth::in_space(&space, SIZE, 1).unwrap();
    assert_eq!(surface.vertices(), again.surface().unwrap().vertices());
    let other = Truth::in_space(&space, SIZE, 2).unwrap();
    assert_ne!(surface.vertices(), other.surface().unwrap().vertices());
    let (a, b) = (truth.point(0.3, 0.6), surface.point(3.0, 4.8));
    assert!(near(a, b, 1e-12));
}

#[test]
fn draws_from_a_prior_have_its_information() {
    let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 3]).unwrap());
    let mean = Truth::in_space(&space, SIZE, 1).unwrap();
    let mean = mean.surface().unwrap();
    let system = SurfaceSystem::new(&space).unwrap();
    let information = system
        .accumulate(|_, cell| {
            for q in quadrature() {
                cell.add_vector(
                    &leaf_weights(q.local[0], q.local[1]),
                    DVec3::ZERO,
                    &[2.0, 0.5, 0.0, 1.0, 0.0, 3.0],
                );
            }
            true
        })
        .unwrap();
    let factor = system.factorize(&information).unwrap();
    let (n, runs) = (3 * space.node_count(), 400);
    let mut sum = 0.0;
    for seed in 0..runs {
        let drawn = Truth::drawn(mean, &factor, seed).unwrap();
        let drawn = drawn.surface().unwrap().vertices();
        let d: Vec<f64> = drawn.iter().zip(mean.vertices()).flat_map(|(a, b)| (*a - *b).to_array()).collect();
        sum += information.quadratic_form(&d).unwrap();
    }
    // dᵀ Λ d is χ² with n degrees of freedom.
    let (mean, sigma) = (sum / runs as f64, (2.0 * n as f64 / runs as f64).sqrt());
    assert!((mean - n as f64).abs() < 4.0 * sigma, "{mean} {n} {sigma}");
}

fn small(shape: Shape) -> ScanSceneOptions {
    ScanSceneOptions { shape, seed: 11, readings: 6_000, probe_points: 200, ..ScanSceneOptions::default() }
}

#[test]
fn errors_of_readings_agree_with_the_true_sigma() {
    for shape in SHAPES {
        for unevenness in [0.0, 0.8] {
            let scene = scans(&ScanSceneOptions { unevenness, ..small(shape) }).unwrap();
            assert_eq!(
                scene.sensors.iter().map(|s| s.name.as_str()).collect::<Vec<_>>(),
                ["laser", "old", "probe"]
            );
            for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
                let (scan, sensor) = (&posed.scan, &scene.sensors[posed.sensor]);
                let stated = scene.set.sensors[posed.sensor].noise.unwrap();
                assert_eq!(scan.points.len(), readings.len());
                let pose = scan.world_from_scanner;
                let (mut vector, mut normal, mut n, mut counted) = (0.0, 0.0, 0.0, 0.0);
                for (i, (&z, reading)) in scan.points.iter().zip(readings).enumerate() {
                    if reading.outlier {
                        continue;
                    }
                    let true_local = pose.inverse().apply(reading.point.position);
                    let error = z - true_local;
                    let ray = ray_at(scan.viewing, true_local);
                    let noise =
                        Noise::Ray { sigma_along: sensor.sigma_along, sigma_across: sensor.sigma_across };
                    let factor2 = reading.noise_factor * reading.noise_factor;
                    let covariance = noise.covariance(ray).scaled(factor2);
                    let along = ray.map_or(0.0, |r| error.dot(r));
                    let across2 = error.length_squared() - along * along;
                    vector += (along / sensor.sigma_along).powi(2) / factor2
                        + across2 / sensor.sigma_across.powi(2) / factor2;
                    n += 3.0;
                    let foot = scene.truth.foot(pose.apply(z)).unwrap();
                    if !foot.at_border {
                        let local_normal = pose.inverse().rotate(reading.point.normal);
                        normal += foot.signed_distance.powi(2) / covariance.along(local_normal);
                        counted += 1.0;
                    }
                    // The σ that the sensor or the reading states is the true one divided by the
                    // misstatement.
                    let stated = match (&scan.sigma, &scan.covariance) {
                        (Some(sigma), _) => sigma[i].powi(2),
                        (_, Some(c)) => c[i].along(ray_at(scan.viewing, z).unwrap()),
                        _ => stated.sigma().powi(2),
                    };
                    let claimed = factor2 * (sensor.sigma_along / sensor.misstatement).powi(2);
                    assert!((stated / claimed - 1.0).abs() < 1e-9, "{stated} {claimed}");
                }
                let band = |n: f64| 4.0 * (2.0 / n).sqrt();
                assert!((vector / n - 1.0).abs() < band(n), "{} {}", scan.name, vector / n);
                // The distance from a curved surface is not exactly linear in the error.
                assert!(
                    (normal / counted - 1.0).abs() < band(counted) + 0.02,
                    "{} {}",
                    scan.name,
                    normal / counted
                );
            }
        }
    }
}

#[test]
fn readings_are_neither_hidden_nor_grazing() {
    for shape in SHAPES {
        let scene = scans(&small(shape)).unwrap();
        for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
            let scan = &posed.scan;
            for reading in readings.iter().step_by(17) {
                let local = scan.world_from_scanner.inverse().apply(reading.point.position);
                let Some(ray) = ray_at(scan.viewing, local) else {
                    continue;
                };
                let ray = scan.world_from_scanner.rotate(ray);
                let facing = -reading.point.normal.dot(ray);
                assert!(facing > 75.0_f64.to_radians().cos() - 1e-9, "{facing}");
                // Independent of hits on the mesh: between sensor and reading, the sign of the exact distance
                // never changes.
                for back in [2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0] {
                    let before = reading.point.position - back * ray;
                    let foot = scene.truth.foot(before).unwrap();
                    assert!(foot.at_border || foot.signed_distance > 0.0, "{shape:?} {back} {foot:?}");
                }
            }
        }
    }
    // A parallel scanner measures nothing on the far side of a ball.
    let truth = Truth::freeform(Shape::Ball, SIZE, 2).unwrap();
    let pose = Pose { translation: DVec3::new(0.0, 0.0, 300.0), ..Pose::identity() };
    let noise = Noise::Isotropic { sigma: 0.01 };
    let scanner = VirtualScanner::new("top", pose, Optics::Parallel { half: [70.0; 2] }, [40, 30], noise);
    let seen = scanner.scan(&truth, 1).unwrap();
    assert!(seen.truth.len() > 100 && seen.truth.iter().all(|r| r.point.normal[2] > 0.25));
    let grid = seen.scan.grid.as_ref().unwrap();
    assert_eq!((grid.columns, grid.rows, grid.cells.len()), (40, 30, 1200));
    assert_eq!(scanner.count(&truth), seen.truth.len());
    for row in 0..30 {
        for column in 0..40 {
            // Columns run along x, rows along y.
            if let Some(i) = grid.point(column, row) {
                let expected =
                    [(2 * column + 1) as f64 / 40.0, (2 * row + 1) as f64 / 30.0].map(|c| 70.0 * (c - 1.0));
                let p = seen.scan.points[i];
                assert!((p[0] - expected[0]).hypot(p[1] - expected[1]) < 0.1);
            }
        }
    }
}

#[test]
fn the_share_of_outliers_is_that_of_the_options() {
    let options = ScanSceneOptions { outlier_share: 0.05, ..small(Shape::Ball) };
    let scene = scans(&options).unwrap();
    let (mut outliers, mut all) = (0.0, 0.0);
    for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
        if scene.set.sensors[posed.sensor].kind == SensorKind::Touch {
            assert!(readings.iter().all(|r| !r.outlier));
            continue;
        }
        for (&z, reading) in posed.scan.points.iter().zip(readings) {
            all += 1.0;
            if reading.outlier {
                outliers += 1.0;
                let error = posed.scan.world_from_scanner.apply(z).distance(reading.point.position);
                assert!(error > 0.5 && error < 15.0, "{error}");
            }
        }
    }
    assert!((outliers / all - 0.05_f64).abs() < 4.0 * (0.05 * 0.95 / all).sqrt(), "{outliers} of {all}");
    assert!((all / 6000.0 - 1.0).abs() < 0.1, "{all}");
    // Outliers change no other reading.
    let clean = scans(&ScanSceneOptions { outlier_share: 0.0, ..options }).unwrap();
    for (a, (b, readings)) in clean.set.scans.iter().zip(scene.set.scans.iter().zip(&scene.readings)) {
        for (i, _) in readings.iter().enumerate().filter(|(_, r)| !r.outlier) {
            assert_eq!(a.scan.points[i], b.scan.points[i]);
        }
    }
}

#[test]
fn one_seed_gives_the_same_bytes_at_any_number_of_threads() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let options = ScanSceneOptions { readings: 2_000, ..small(Shape::Tube) };
    let write = |threads: usize, folder: &std::path::Path| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write_scans_scene(&options, folder, &Silent)).unwrap()
    };
    let (first, second) = (write(1, a.path()), write(3, b.path()));
    assert_eq!(first.truth, second.truth);
    assert_eq!(first.files.len(), 8);
    for (x, y) in first.files.iter().zip(&second.files) {
        assert_eq!(x.file_name(), y.file_name());
        assert_eq!(std::fs::read(x).unwrap(), std::fs::read(y).unwrap(), "{}", x.display());
    }
    let other = scans(&ScanSceneOptions { seed: 12, ..options.clone() }).unwrap();
    let same = scans(&options).unwrap();
    assert_ne!(other.set.scans[0].scan.points, same.set.scans[0].scan.points);
}

#[test]
fn a_written_scene_reads_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    for (k, options) in [
        small(Shape::Ball),
        ScanSceneOptions { unevenness: 0.5, unit: Unit::Metre, organised: false, ..small(Shape::Sheet) },
        ScanSceneOptions {
            old_scanner: false,
            probe_points: 0,
            views: 2,
            sigma: Some(0.2),
            ..small(Shape::Tube)
        },
    ]
    .into_iter()
    .enumerate()
    {
        let folder = folder.path().join(format!("{k}/deep"));
        let scene = scans(&options).unwrap();
        let summary = write_scan_scene(&scene, &folder).unwrap();
        let set = read_inputs(&[folder.join("job.toml")], None).unwrap();
        assert_eq!((set.unit, &set.sensors), (scene.set.unit, &scene.set.sensors));
        assert_eq!(set.scans.len(), scene.set.scans.len());
        for (read, made) in set.scans.iter().zip(&scene.set.scans) {
            assert_eq!(read.sensor, made.sensor);
            assert_eq!((&read.scan.name, &read.scan.points), (&made.scan.name, &made.scan.points));
            assert_eq!((&read.scan.sigma, &read.scan.covariance), (&made.scan.sigma, &made.scan.covariance));
            assert_eq!((&read.scan.grid, read.scan.viewing), (&made.scan.grid, made.scan.viewing));
            let (p, q) = (read.scan.world_from_scanner, made.scan.world_from_scanner);
            assert!(near(p.apply(made.scan.points[0]), q.apply(made.scan.points[0]), 1e-12 * options.size()));
        }
        assert_eq!(summary.rows, set.scans.iter().map(|s| s.scan.points.len()).sum::<usize>());
        assert!(summary.files.iter().all(|f| f.is_file()) && summary.files[0].ends_with("job.toml"));
        let truth = planish_exchange::ply::read_mesh(&folder.join("truth.ply")).unwrap();
        assert_eq!(
            (truth.points.len(), truth.triangles.len()),
            (summary.truth.mesh_vertices, summary.truth.mesh_triangles)
        );
        let (nx, ny, nz) =
            (truth.column("nx").unwrap(), truth.column("ny").unwrap(), truth.column("nz").unwrap());
        for i in (0..truth.points.len()).step_by(97) {
            let foot = scene.truth.foot(truth.points[i]).unwrap();
            assert!(foot.signed_distance.abs() < 1e-9 * options.size());
            assert!((DVec3::new(nx[i], ny[i], nz[i]) - foot.point.normal).length() < 1e-6);
        }
        assert!(summary.truth.mesh_chord_error < 2e-3 * options.size(), "{}", summary.truth.mesh_chord_error);
        let json: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(folder.join("truth.json")).unwrap()).unwrap();
        assert_eq!(json["seed"], 11);
        assert_eq!(json["surface"]["kind"], options.shape.name());
        assert_eq!(json["sensors"].as_array().unwrap().len(), scene.sensors.len());
    }
}

#[test]
fn invalid_options_are_rejected() {
    let good = small(Shape::Ball);
    for (options, kind) in [
        (ScanSceneOptions { readings: 0, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { views: 0, old_scanner: false, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { sigma: Some(-1.0), ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { sigma: Some(0.1), unit: Unit::Metre, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { misstated: 0.0, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { outlier_share: 1.0, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { unevenness: f64::NAN, ..good.clone() }, ErrorKind::Input),
        (ScanSceneOptions { shape: Shape::Torus, ..good.clone() }, ErrorKind::Unsupported),
    ] {
        assert_eq!(scans(&options).unwrap_err().kind(), kind, "{options:?}");
    }
    let file = tempfile::NamedTempFile::new().unwrap();
    assert_eq!(write_scans_scene(&good, file.path(), &Silent).unwrap_err().kind(), ErrorKind::Io);
}

#[test]
fn the_pebble_example_is_made_by_the_options_in_its_readme() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/data/pebble");
    let shipped = read_inputs(&[folder.join("job.toml")], None).unwrap();
    let made = scans(&ScanSceneOptions { seed: 7, readings: 12_000, ..ScanSceneOptions::default() }).unwrap();
    assert_eq!(shipped.sensors, made.set.sensors);
    for (a, b) in shipped.scans.iter().zip(&made.set.scans) {
        assert_eq!((&a.scan.name, a.scan.points.len()), (&b.scan.name, b.scan.points.len()));
        // Sine and exponential differ in their last digits between systems.
        let pairs = a.scan.points.iter().zip(&b.scan.points);
        assert!(pairs.into_iter().all(|(p, q)| near(*p, *q, 1e-6)));
    }
}
