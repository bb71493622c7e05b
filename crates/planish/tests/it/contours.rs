//! Contours end to end: files of readings in, reports out.

use planish::Job;
use planish::contour::{ContourJob, ContourKind, ContourReport, Form, PlanarMotion, PrimitiveKind, Relation};
use planish::progress::Silent;
use planish::simulate::{ReadingsOptions, write_readings_scene};
use planish_contour::planar::{ContourReading, ContourTarget, points};
use planish_contour::primitive::{RayTarget, SimulatedPrimitive, SpaceSensor, rays};
use planish_core::DVec3;
use planish_exchange::Unit;
use planish_exchange::contours::read_contour_json;
use planish_exchange::picture::write_grey_png;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

fn job(input: PathBuf, kinds: &[ContourKind]) -> ContourJob {
    ContourJob { input, kinds: kinds.to_vec(), unit: Some(Unit::Millimetre), ..ContourJob::default() }
}

fn write_points(path: &Path, parts: &[(f64, Vec<ContourReading>)]) {
    let mut text = String::from("x,y,sigma,level\n");
    for (level, sightings) in parts {
        for sighting in sightings {
            if let ContourTarget::Point { position, sigma } = sighting.target {
                writeln!(text, "{},{},{sigma},{level}", position[0], position[1]).unwrap();
            }
        }
    }
    std::fs::write(path, text).unwrap();
}

/// Whether a parameter is within four of its σ.
fn is_near(report: &ContourReport, contour: usize, name: &str, truth: f64) {
    let found = &report.contours[contour].parameters;
    let (_, value) = found.iter().find(|(n, _)| n == name).unwrap();
    assert!(
        (value.value - truth).abs() < 4.0 * value.sigma,
        "{name}: {} ± {} for {truth}",
        value.value,
        value.sigma
    );
}

#[test]
fn equal_levels_form_a_prism_and_coaxial_circles_a_revolution() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("levels.csv");
    let rectangle = [10.0, 5.0, 40.0, 25.0, 0.3];
    let level = |k: u64| points(&ContourKind::Rectangle, &rectangle, 150, 0.2, k).noisy;
    write_points(&path, &[(0.0, level(1)), (10.0, level(2)), (20.0, level(3))]);
    let report = job(path.clone(), &[ContourKind::Rectangle]).run(&Silent).unwrap();
    let levels = report.levels.as_ref().unwrap();
    assert_eq!((levels.relation, levels.levels.len()), (Relation::Prism, 3));
    let circle = |radius: f64, seed| points(&ContourKind::Circle, &[3.0, -2.0, radius], 150, 0.2, seed).noisy;
    write_points(&path, &[(0.0, circle(20.0, 1)), (10.0, circle(15.0, 2))]);
    let report = job(path.clone(), &[ContourKind::Circle]).run(&Silent).unwrap();
    assert_eq!(report.levels.unwrap().relation, Relation::Revolution);
    let shifted = points(&ContourKind::Circle, &[5.0, -2.0, 15.0], 150, 0.2, 4).noisy;
    write_points(&path, &[(0.0, circle(20.0, 1)), (10.0, shifted)]);
    let report = job(path, &[ContourKind::Circle]).run(&Silent).unwrap();
    assert_eq!(report.levels.unwrap().relation, Relation::None);
}

#[test]
fn a_plate_with_holes_is_recognised() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plate.csv");
    let plate = points(&ContourKind::Rectangle, &[0.0, 0.0, 80.0, 50.0, 0.2], 500, 0.1, 1).noisy;
    let left = points(&ContourKind::Circle, &[-20.0, 0.0, 6.0], 120, 0.1, 2).noisy;
    let right = points(&ContourKind::Slot, &[18.0, 4.0, 24.0, 10.0, 0.2], 200, 0.1, 3).noisy;
    write_points(&path, &[(0.0, [plate, left, right].concat())]);
    let report = ContourJob { gap: Some(5.0), ..job(path, &[]) }.run(&Silent).unwrap();
    let kinds: Vec<(&str, Option<usize>)> =
        report.contours.iter().map(|c| (c.kind.as_str(), c.hole_of)).collect();
    assert_eq!(kinds, [("rectangle", None), ("slot", Some(0)), ("circle", Some(0))]);
    is_near(&report, 0, "width", 80.0);
    is_near(&report, 2, "radius", 6.0);
}

fn scene(kind: ContourKind, velocity: DVec3, noise: f64, folder: &Path) -> PathBuf {
    let options = ReadingsOptions {
        kind,
        readings: 300,
        sweep: 1,
        noise,
        outlier_share: 0.0,
        velocity: velocity.to_array(),
        seed: 3,
        unit: Unit::Millimetre,
    };
    write_readings_scene(&options, folder).unwrap();
    folder.join("readings.csv")
}

#[test]
fn the_product_of_the_sides_also_identifies_the_rectangle() {
    let folder = tempfile::tempdir().unwrap();
    let path = scene(ContourKind::Rectangle, DVec3::ZERO, 0.2, folder.path());
    let mut job = job(path, &[ContourKind::Rectangle]);
    job.fit.form = Form::Product;
    let report = job.run(&Silent).unwrap();
    is_near(&report, 0, "width", 90.0);
    is_near(&report, 0, "height", 55.0);
}

#[test]
fn a_moving_and_turning_object_is_found_with_its_motion() {
    let folder = tempfile::tempdir().unwrap();
    let turn = 8f64.to_radians();
    let path = scene(ContourKind::Rectangle, DVec3::new(6.0, -3.0, turn), 0.3, folder.path());
    let mut job = job(path, &[ContourKind::Rectangle]);
    job.fit.motion = PlanarMotion::Rigid;
    let report = job.run(&Silent).unwrap();
    is_near(&report, 0, "width", 90.0);
    is_near(&report, 0, "height", 55.0);
    is_near(&report, 0, "rotation_deg_per_s", 8.0);
    // Without the motion the readings do not fit.
    job.fit.motion = PlanarMotion::Still;
    let still = job.run(&Silent).unwrap();
    assert!(still.main.reduced_chi_square > 2.0 * report.main.reduced_chi_square);
}

/// A bright disc on a dark ground, with noise of four grey levels that a hash makes.
fn disc(path: &Path, center: [f64; 2], radius: f64, seed: u64) {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut values = Vec::new();
    for k in 0..160 * 120 {
        let (x, y) = (f64::from(k % 160) - center[0], f64::from(k / 160) - center[1]);
        let off = x.hypot(y) - radius;
        let share = if off.abs() > 1.0 {
            f64::from(off < 0.0)
        } else {
            let step = |s: i32| (f64::from(s) + 0.5) / 16.0 - 0.5;
            let inside = |s: &i32| (x + step(s % 16)).hypot(y + step(s / 16)) < radius;
            (0..256).filter(inside).count() as f64 / 256.0
        };
        // The sum of twelve is nearly normal.
        let noise: f64 = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
        values.push((40.0 + 160.0 * share + 4.0 * noise).round() as u8);
    }
    write_grey_png(path, 160, 120, &values).unwrap();
}

#[test]
fn the_edge_of_a_disc_in_a_picture_is_a_circle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("disc.png");
    let (runs, pixel) = (100, 0.05);
    let (mut within, mut squares) = (0, 0.0);
    for seed in 0..runs {
        let center = [70.0 + 0.13 * seed as f64, 60.0 - 0.07 * seed as f64];
        disc(&path, center, 35.0, seed + 1);
        let report = ContourJob { pixel: Some(pixel), ..job(path.clone(), &[ContourKind::Circle]) }
            .run(&Silent)
            .unwrap();
        let truth = [center[0] * pixel, (119.0 - center[1]) * pixel, 35.0 * pixel];
        for ((_, found), truth) in report.main.parameters.iter().zip(truth) {
            let error = (found.value - truth) / found.sigma;
            squares += error * error;
            within += usize::from(error.abs() < 1.96);
        }
    }
    let count = 3.0 * runs as f64;
    println!("coverage {:.3}, rms {:.2} σ", within as f64 / count, (squares / count).sqrt());
    assert!(within as f64 > 0.88 * count, "{within} of {count}");
}

#[test]
fn readings_in_space_are_a_cylinder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rays.csv");
    let solid = SimulatedPrimitive {
        shape: PrimitiveKind::Cylinder,
        center: DVec3::new(30.0, -20.0, 50.0),
        turn: DVec3::new(0.3, -0.5, 0.7),
        size: [25.0, 80.0, 0.0],
    };
    let sensor =
        SpaceSensor { standoff: 150.0, sigma_position: 0.5, sigma_angle_rad: 0.01, sigma_range_share: 0.004 };
    let mut text = String::from("x,y,z,azimuth_deg,elevation_deg,range,sigma_range\n");
    for ray in rays(&solid, 300, &sensor, 4).noisy {
        if let RayTarget::Range { origin: DVec3 { x, y, z }, direction_rad: [a, e], range, sigma } =
            ray.target
        {
            let (a, e) = (a.to_degrees(), e.to_degrees());
            writeln!(text, "{x},{y},{z},{a},{e},{range},{}", sigma[5]).unwrap();
        }
    }
    std::fs::write(&path, text).unwrap();
    let mut job = job(path.clone(), &[]);
    job.shapes = PrimitiveKind::ALL.to_vec();
    job.sigma.position = Some(0.5);
    job.sigma.heading_deg = Some(0.01f64.to_degrees());
    let report = job.run(&Silent).unwrap();
    assert_eq!(report.main.kind, "cylinder", "{:?}", report.main.alternatives);
    is_near(&report, 0, "radius", 25.0);
    is_near(&report, 0, "axis_x", solid.parameters()[3]);
    // The same file without a kind in space, and a kind in space without σ.
    job.shapes.clear();
    let refused = job.run(&Silent).unwrap_err().to_string();
    assert!(refused.contains("line 1") && refused.contains("state their kind of shape (plane3"), "{refused}");
    std::fs::write(&path, "x,y,z\n1,2,3\n").unwrap();
    job.shapes = vec![PrimitiveKind::Plane];
    let refused = job.run(&Silent).unwrap_err();
    assert_eq!(refused.settings(), [planish::Setting::SigmaPoint]);
    assert!(refused.to_string().contains("line 2"), "{refused}");
}

#[test]
fn a_room_of_a_carmen_log_has_walls() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.log");
    // A sensor in the middle of a room of 6 m by 4 m: 180 beams over half a turn, a whole turn by two scans.
    let mut text = String::from("# a room\n");
    for facing in [0.0, std::f64::consts::PI] {
        let ranges = (0..180).map(|k| {
            let angle = facing + (f64::from(k) - 90.0).to_radians();
            let (sin, cos) = angle.sin_cos();
            let noise = 0.01 * (f64::from(k) * 12.9898).sin();
            (3.0 / cos.abs()).min(2.0 / sin.abs()) + noise
        });
        let ranges: Vec<String> = ranges.map(|r| format!("{r:.4}")).collect();
        writeln!(text, "FLASER 180 {} 0 0 {facing} 0 0 {facing} 0 host 0", ranges.join(" ")).unwrap();
    }
    std::fs::write(&path, text).unwrap();
    let mut job = job(path, &[ContourKind::Rectangle]);
    job.carmen.count = 2;
    job.gap = Some(0.5);
    let report = job.run(&Silent).unwrap();
    assert_eq!(report.unit, Some(Unit::Metre));
    is_near(&report, 0, "width", 6.0);
    is_near(&report, 0, "height", 4.0);
}

#[test]
fn an_open_outline_is_a_chain_with_two_ends() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bracket.csv");
    // A bracket, of which one side is seen.
    let kind = ContourKind::Chain { arcs: vec![false, false], closed: false };
    let theta = [0.0, 10.0, 50.0, 0.0, 60.0, 40.0];
    let names = ["x0", "y0", "x1", "y1", "x2", "y2"];
    let (runs, mut within) = (20, 0);
    for seed in 0..runs {
        write_points(&path, &[(0.0, points(&kind, &theta, 300, 0.2, seed).noisy)]);
        let output = folder.path().join("bracket.json");
        let job = ContourJob { outputs: vec![output.clone()], ..job(path.clone(), &[]) };
        let report = job.run(&Silent).unwrap();
        assert_eq!(report.main.kind, "chain", "seed {seed}: {:?}", report.main.alternatives);
        assert_eq!(report.main.closed, Some(false));
        for (name, truth) in names.iter().zip(theta) {
            let (_, found) = report.main.parameters.iter().find(|(n, _)| n == name).unwrap();
            within += usize::from((found.value - truth).abs() < 1.96 * found.sigma);
        }
        let read = read_contour_json(&output).unwrap();
        assert_eq!(read.contours[0].kind, kind);
    }
    let share = within as f64 / (runs as f64 * theta.len() as f64);
    println!("an open chain: coverage {share:.3}");
    assert!(share > 0.88, "{share}");
}

#[test]
fn the_section_of_several_levels_is_covered() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("levels.csv");
    let truth = [10.0, 5.0, 40.0, 25.0, 0.3];
    let (runs, mut prisms, mut within, mut squares) = (60, 0, 0, 0.0);
    for seed in 0..runs {
        let level = |k: u64| points(&ContourKind::Rectangle, &truth, 150, 0.2, 3 * seed + k).noisy;
        write_points(&path, &[(0.0, level(0)), (10.0, level(1)), (20.0, level(2))]);
        let levels = job(path.clone(), &[ContourKind::Rectangle]).run(&Silent).unwrap().levels.unwrap();
        prisms += u32::from(levels.relation == Relation::Prism);
        for ((_, value, sigma), truth) in
            levels.mean.iter().zip([10.0, 5.0, 40.0, 25.0, 0.3_f64.to_degrees()])
        {
            within += u32::from((value - truth).abs() < 1.96 * sigma);
            squares += ((value - truth) / sigma).powi(2);
        }
    }
    let count = 5.0 * runs as f64;
    println!(
        "levels: {prisms} of {runs} prisms, coverage {:.3}, rms {:.2} σ",
        f64::from(within) / count,
        (squares / count).sqrt()
    );
    assert!(prisms >= 56 && f64::from(within) > 0.9 * count, "{prisms} prisms, {within} of {count}");
}

#[test]
fn corridors_of_a_measured_log_have_walls() {
    let data = std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    );
    let log = data.join("laser2d/intel-corrected.log.gz");
    if !log.is_file() {
        println!("skipped: the log is not at {}", log.display());
        return;
    }
    let mut job = job(log, &[ContourKind::Line]);
    job.chains = true;
    job.carmen.range = [0.05, 8.0];
    job.gap = Some(0.4);
    let report = job.run(&Silent).unwrap();
    assert_eq!(report.unit, Some(Unit::Metre));
    assert!(!report.contours.is_empty() && report.main.readings >= 20);
    for contour in &report.contours {
        println!("{}: {} readings, {:.2}", contour.kind, contour.readings, contour.reduced_chi_square);
        assert!(["line", "chain"].contains(&contour.kind.as_str()));
        assert!(contour.parameters.iter().all(|(_, p)| p.value.is_finite() && p.sigma > 0.0));
    }
}

#[test]
fn bad_readings_are_refused_with_file_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text, expected) in [
        ("empty.csv", "", "the file is empty"),
        ("blank.csv", "\n\n", "expected a header `x,y,heading_deg,range` or `x,y`, found no readings"),
        ("header.csv", "x,y,sigma\n", "expected readings after the header, found none"),
        ("no_range.csv", "x,y,heading_deg\n1,2,3\n", "line 1: expected a header with"),
        ("no_columns.csv", "a,b\n1,2\n", "without `x,y`"),
        ("twice.csv", "x,x,y\n1,1,2\n", "line 1: the column `x` is named twice"),
        ("short.csv", "x,y,sigma\n1,2\n", "line 2: expected 3 fields as in the header, found 2"),
        ("word.csv", "x,y,sigma\n1,2,0.1\n1,two,0.1\n", "line 3: expected a number in column `y`"),
        ("nan.csv", "x,y,sigma\nnan,1,0.1\n", "line 2: expected a number in column `x`"),
        ("infinite.csv", "x,y,sigma,level\n1,1,0.1,inf\n", "line 2: expected a number in column `level`"),
        ("zero_sigma.csv", "x,y,sigma\n1,2,0\n", "line 2: expected a positive σ in column `sigma`, found 0"),
        ("no_sigma.csv", "x,y\n1,2\n", "line 2: σ of the readings is unknown"),
        (
            "behind.csv",
            "x,y,heading_deg,range,sigma_range\n0,0,0,-1,0.1\n",
            "line 2: expected a positive range, found -1",
        ),
        (
            "no_sigma_range.csv",
            "x,y,heading_deg,range\n0,0,0,1\n",
            "expected a column `sigma_range`, or a default",
        ),
        ("two.csv", "x,y,sigma\n1,2,0.1\n2,2,0.1\n", "2 readings cannot determine the 3"),
        (
            "same.csv",
            &("x,y,sigma\n".to_owned() + &"1,2,0.1\n".repeat(30)),
            "farther apart than their σ, found all 30 closer",
        ),
        (
            "cut.log",
            "# a log\nFLASER 180 1 2 3\n",
            "line 2: expected `FLASER n` with n ranges and a pose, found 5 words",
        ),
        (
            "word.log",
            "# a log\nFLASER 2 1 x 0 0 0 0 0 0 1 host 1\n",
            "line 2: expected a finite number as word 4, found `x`",
        ),
        ("blind.log", "# a log\nFLASER 1 81.9 0 0 0 0 0 0 1 host 1\n", "found none in a log of 1 scans"),
        ("picture.png", "no picture", "picture.png"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let output = folder.path().join("out.json");
        let job = ContourJob { outputs: vec![output.clone()], ..job(path, &[ContourKind::Circle]) };
        let refused = job.run(&Silent).unwrap_err().to_string();
        assert!(refused.contains(expected) && refused.contains(name), "{name}: {refused}");
        assert!(!output.exists(), "{name}: an output was left behind");
    }
}
