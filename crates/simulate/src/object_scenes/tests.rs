use super::*;
use planish_estimate::ErrorKind;
use planish_exchange::read_inputs;
use planish_mesh::MeshSearch;
use planish_sense::ray_at;
use std::collections::HashMap;

const OBJECTS: [ObjectKind; 4] = [
    ObjectKind::Handles { genus: 2 },
    ObjectKind::Plate { holes: 2 },
    ObjectKind::Cup { wall: None },
    ObjectKind::Bracket { fillet: None },
];

fn small(object: ObjectKind) -> ObjectSceneOptions {
    ObjectSceneOptions { object, seed: 3, readings: 6_000, ..ObjectSceneOptions::default() }
}

#[test]
fn errors_of_readings_agree_with_the_stated_sigma() {
    for object in OBJECTS {
        let scene = object_scene(&small(object)).unwrap();
        let stated = scene.set.sensors[0].noise.unwrap();
        let (mut chi2, mut n) = (0.0, 0.0);
        let (mut normal_chi2, mut outliers) = (0.0, 0.0);
        for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
            let scan = &posed.scan;
            let (normals, sigma_deg) =
                (scan.normals.as_ref().unwrap(), scan.sigma_normal_deg.as_ref().unwrap());
            for (i, (&z, reading)) in scan.points.iter().zip(readings).enumerate() {
                // The tangent of the angle between two unit vectors, in σ.
                let normal = scan.world_from_scanner.rotate(normals[i]);
                let sine = normal.cross(reading.point.normal).length() / normal.dot(reading.point.normal);
                normal_chi2 += (sine / sigma_deg[i].to_radians()).powi(2);
                let to_scanner = scan.world_from_scanner.inverse();
                let error = z - to_scanner.apply(reading.point.position);
                if reading.outlier {
                    outliers += 1.0;
                    assert!(error.length() > 0.5 && error.length() < 11.0, "{}", error.length());
                    continue;
                }
                let ray = ray_at(scan.viewing, to_scanner.apply(reading.point.position));
                let variance = stated.covariance(ray).along(to_scanner.rotate(reading.point.normal));
                chi2 += error.dot(to_scanner.rotate(reading.point.normal)).powi(2) / variance;
                n += 1.0;
            }
        }
        let all: f64 = n + outliers;
        assert!((all / 6_000.0 - 1.0).abs() < 0.1, "{object:?} {all}");
        assert!((chi2 / n - 1.0).abs() < 4.0 * (2.0 / n).sqrt(), "{object:?} {}", chi2 / n);
        assert!((normal_chi2 / all / 2.0 - 1.0).abs() < 4.0 / all.sqrt(), "{object:?} {normal_chi2} {all}");
        assert!((outliers / all - 0.01).abs() < 4.0 * (0.01 * 0.99 / all).sqrt(), "{object:?} {outliers}");
    }
}

/// Independent of the rays of the scanner: the mesh does not hide any reading.
#[test]
fn readings_are_visible_and_lie_near_the_mesh() {
    for object in OBJECTS {
        let scene = object_scene(&small(object)).unwrap();
        let truth = scene.object.mesh().unwrap();
        let search = MeshSearch::try_new(&truth.mesh).unwrap();
        for (posed, readings) in scene.set.scans.iter().zip(&scene.readings) {
            let pose = posed.scan.world_from_scanner;
            let mut hidden = 0;
            for (&z, reading) in posed.scan.points.iter().zip(readings) {
                let p = reading.point.position;
                let ray = (p - pose.translation).try_normalize().unwrap();
                assert!(-ray.dot(reading.point.normal) > 75_f64.to_radians().cos() - 1e-9);
                let hit = search.first_hit(pose.translation, ray);
                // Within the chord error, which is longer along a grazing ray.
                let slack = 8.0 * truth.chord_error + 1e-6;
                hidden += usize::from(hit.is_some_and(|hit| hit.point.distance(p) > slack));
                let distance = search.closest(pose.apply(z)).unwrap().signed_distance.abs();
                assert!(
                    reading.outlier || distance < 6.0 * scene.sensor.sigma_along,
                    "{object:?} {distance}"
                );
            }
            // Chords of a round edge hide a few points that are seen just beyond it.
            assert!(50 * hidden <= readings.len(), "{object:?} {hidden} of {}", readings.len());
        }
    }
}

/// The fit needs readings on every part: also on the inner side of handles and in holes.
#[test]
fn nearly_all_of_the_surface_is_measured() {
    for object in OBJECTS {
        let scene = object_scene(&ObjectSceneOptions { readings: 40_000, ..small(object) }).unwrap();
        let truth = scene.object.mesh().unwrap();
        let cell = |p: DVec3| (p / 2.5).map(f64::floor).to_array().map(|c| c as i64);
        let mut cells = HashMap::<[i64; 3], Vec<(DVec3, DVec3)>>::new();
        for reading in scene.readings.iter().flatten() {
            let (p, n) = (reading.point.position, reading.point.normal);
            cells.entry(cell(p)).or_default().push((p, n));
        }
        // A point is measured if a reading within 2.5 mm is on the same side of a wall.
        let is_measured = |k: usize| {
            let (p, n) = (truth.mesh.positions[k], truth.normals[k]);
            let near = |q: &(DVec3, DVec3)| q.0.distance(p) < 2.5 && q.1.dot(n) > 0.3;
            let [x, y, z] = cell(p);
            (0..27).any(|i| {
                let at = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
                cells.get(&at).is_some_and(|readings| readings.iter().any(near))
            })
        };
        let tried = (0..truth.mesh.positions.len()).step_by(29);
        let share = tried.clone().filter(|&k| is_measured(k)).count() as f64 / tried.len() as f64;
        assert!(share > 0.99, "{object:?} {share}");
    }
}

#[test]
fn one_seed_gives_the_same_bytes_at_any_number_of_threads() {
    for object in OBJECTS {
        let options = ObjectSceneOptions { readings: 1_500, ..small(object) };
        let write = |threads: usize| {
            let folder = tempfile::tempdir().unwrap();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let made = pool.install(|| write_object_scene(&options, folder.path(), &Silent)).unwrap();
            let bytes: Vec<Vec<u8>> = made.files.iter().map(|file| std::fs::read(file).unwrap()).collect();
            (made.truth, bytes)
        };
        let (first, second) = (write(1), write(3));
        // A job, 12 scans, truth.ply and truth.json.
        assert_eq!(first.1.len(), 15);
        assert!(first == second, "{object:?}");
        let other = object_scene(&ObjectSceneOptions { seed: 4, ..options }).unwrap();
        assert_ne!(other.set.scans[0].scan.points, object_scene(&options).unwrap().set.scans[0].scan.points);
    }
}

#[test]
fn a_written_scene_reads_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let options = ObjectSceneOptions {
        unit: Unit::Metre,
        sigma: Some(2e-4),
        object: ObjectKind::Bracket { fillet: Some(4e-3) },
        ..small(ObjectKind::Cup { wall: None })
    };
    let scene = object_scene(&options).unwrap();
    let summary = write_object_scene(&options, folder.path(), &Silent).unwrap();
    let set = read_inputs(&[folder.path().join("job.toml")], None).unwrap();
    assert_eq!((set.unit, &set.sensors), (scene.set.unit, &scene.set.sensors));
    for (read, made) in set.scans.iter().zip(&scene.set.scans) {
        assert_eq!((&read.scan.points, &read.scan.grid), (&made.scan.points, &made.scan.grid));
        assert_eq!(read.scan.normals, made.scan.normals);
        assert_eq!(read.scan.sigma_normal_deg, made.scan.sigma_normal_deg);
    }
    assert_eq!(summary.columns, ["x", "y", "z", "nx", "ny", "nz", "sigma_n_deg"]);
    let mesh = planish_exchange::ply::read_mesh(&folder.path().join("truth.ply")).unwrap();
    assert_eq!(mesh.points.len(), summary.truth.mesh_vertices);
    let text = std::fs::read_to_string(folder.path().join("truth.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&json["shape"], &json["object"]["genus"]), (&"bracket".into(), &3.into()));
    assert_eq!(json["object"]["form"]["fillet_radius"], 4e-3);
    assert_eq!(json["object"]["holes"].as_array().unwrap().len(), 3);
    assert_eq!(json["object"]["fillets"][0]["radius"], 4e-3);
    assert_eq!(json["object"]["edges"].as_array().unwrap().len(), 25);
}

#[test]
fn options_out_of_range_are_rejected() {
    let good = small(OBJECTS[0]);
    for options in [
        ObjectSceneOptions { readings: 0, ..good.clone() },
        ObjectSceneOptions { views: 0, ..good.clone() },
        ObjectSceneOptions { sigma: Some(20.0), ..good.clone() },
        ObjectSceneOptions { sigma_normal_deg: Some(0.0), ..good.clone() },
        ObjectSceneOptions { sigma_normal_deg: Some(f64::NAN), ..good.clone() },
        ObjectSceneOptions { outlier_share: 1.0, ..good.clone() },
        ObjectSceneOptions { object: ObjectKind::Handles { genus: 0 }, ..good.clone() },
    ] {
        assert_eq!(object_scene(&options).unwrap_err().kind(), ErrorKind::Input, "{options:?}");
    }
    // Without normals, no other number changes.
    let plain = object_scene(&ObjectSceneOptions { sigma_normal_deg: None, ..good.clone() }).unwrap();
    assert_eq!(plain.set.scans[0].scan.points, object_scene(&good).unwrap().set.scans[0].scan.points);
    assert!(plain.set.scans[0].scan.normals.is_none());
}
