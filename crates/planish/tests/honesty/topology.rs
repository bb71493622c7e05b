//! Objects that the fit cannot represent, without a stated shape: each is refused, or the surface is marked
//! where it does not follow the readings. The reason is in the message or in a finding, and no sensor is
//! blamed for it.

use crate::measure::{Measures, Outcome, Reference, TrueError, run};
use crate::readings::single_scan;
use crate::settings::{TableSettings, write_readings};
use crate::solids::{self, MeshSolid};
use crate::truth::{Distances, Placement, TrueSurface, rng_of, sample_surface};
use planish::DVec3;
use planish_exchange::ScanSet;
use planish_sense::{Noise, Scan, Sensor};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::path::PathBuf;

/// σ of the readings over the half size of the object: a good scanner.
const SIGMA: f64 = 0.001;

/// Words of which a refusal or a finding about wrong surface names at least one.
const REASONS: &[&str] = &[
    "handle",
    "hole",
    "topolog",
    "separate",
    "parts",
    "bodies",
    "thin",
    "edge",
    "face away",
    "layer",
    "follow",
    "wrong shape",
];

type MakeSurface = fn(&mut ChaCha8Rng) -> Box<dyn TrueSurface>;

const OBJECTS: [(&str, MakeSurface); 7] = [
    ("torus", solids::torus),
    ("genus-2", solids::genus_two),
    ("plate-with-hole", solids::plate_with_hole),
    ("cup", solids::cup),
    ("box", solids::sharp_box),
    ("two-bodies", solids::two_bodies),
    ("bent-pipe", solids::bent_pipe),
];

const MESHES: [(&str, &str); 2] = [("fandisk", "fandisk.obj"), ("fertility", "fertility.off")];

fn data_folder() -> PathBuf {
    std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    )
}

/// Noisy readings of points, some seeds with a stated σ and with normals.
fn scan_of(points: &[(DVec3, DVec3)], placement: &Placement, seed: u64, rng: &mut ChaCha8Rng) -> ScanSet {
    let mut error =
        || DVec3::from_array([0; 3].map(|_| SIGMA * Distribution::<f64>::sample(&StandardNormal, rng)));
    let scan = Scan {
        name: "readings".to_owned(),
        points: points.iter().map(|(p, _)| placement.place(*p + error())).collect(),
        normals: (seed % 4 >= 2).then(|| points.iter().map(|(_, n)| placement.rotate(*n)).collect()),
        ..Scan::default()
    };
    let noise = seed.is_multiple_of(2).then_some(Noise::Isotropic { sigma: SIGMA * placement.scale });
    single_scan(scan, Sensor { name: "sensor".to_owned(), noise, ..Sensor::default() })
}

/// Simulates, fits and measures an analytic object.
fn run_solid(name: &str, make: MakeSurface, seed: u64, settings: &TableSettings) -> Outcome {
    let mut rng = rng_of(name, seed);
    let surface = make(&mut rng);
    let sample = sample_surface(surface.as_ref(), settings.readings, |_| 1.0, &mut rng);
    let points: Vec<_> = sample.points.iter().map(|p| (*p, surface.normal(*p))).collect();
    let distances = Distances::new(surface.as_ref(), &mut rng);
    let distance = |p| distances.of(p).0.abs();
    run_points(name, &points, sample.area, &distance, seed, settings, &mut rng)
}

/// Simulates, fits and measures the object of a mesh.
fn run_mesh(name: &str, mesh: &MeshSolid, seed: u64, settings: &TableSettings) -> Outcome {
    let mut rng = rng_of(name, seed);
    let points: Vec<_> = (0..settings.readings).map(|_| mesh.draw(&mut rng)).collect();
    run_points(name, &points, mesh.area(), &|p| mesh.distance(p), seed, settings, &mut rng)
}

fn run_points(
    name: &str,
    points: &[(DVec3, DVec3)],
    area: f64,
    distance: &dyn Fn(DVec3) -> f64,
    seed: u64,
    settings: &TableSettings,
    rng: &mut ChaCha8Rng,
) -> Outcome {
    let placement = Placement::random(rng);
    let set = scan_of(points, &placement, seed, rng);
    if let Some(folder) = &settings.readings_folder {
        write_readings(folder, &format!("{name} {seed}"), &set);
    }
    let scale = placement.scale;
    let error_of =
        |p: DVec3| TrueError { distance: scale * distance(placement.back(p)), beyond_rim: f64::NEG_INFINITY };
    let reference = Reference {
        error_of: &error_of,
        seen: points.iter().map(|(p, _)| placement.place(*p)).collect(),
        spacing: scale * (area / points.len() as f64).sqrt(),
        sigma: scale * SIGMA,
    };
    run(&set, None, settings.time_limit, &reference, rng)
}

/// What is wrong with an outcome; none if it is honest.
fn defect(outcome: &Outcome) -> Option<String> {
    let names_reason = |text: &str| {
        let text = text.to_lowercase();
        REASONS.iter().any(|word| text.contains(word))
    };
    match outcome {
        Outcome::Failed(text) => Some(format!("failed: {text}")),
        Outcome::Refused(text) => {
            (!names_reason(text)).then(|| format!("refused without a right reason: {text}"))
        }
        Outcome::Fitted(found) => {
            if found.blames_sensor {
                return Some("blames the sensor".to_owned());
            }
            // Half of the error budget of an honest surface: the coverage of one object varies by chance.
            let Measures { coverage_measured, missed, rms_normalised, .. } = *found;
            let is_wrong = coverage_measured < 0.9 || missed > 0.05 || rms_normalised > 2.0;
            if is_wrong {
                return Some("wrong where marked as measured".to_owned());
            }
            let is_marked = found.shares[3] > 0.0;
            (is_marked && !found.texts.iter().any(|text| names_reason(text)))
                .then(|| "surface is marked 3 without a reason".to_owned())
        }
    }
}

/// Runs the selected objects and returns what is wrong.
fn run_objects(settings: &TableSettings) -> Vec<String> {
    let folder = data_folder().join("meshes");
    let meshes = MESHES.map(|(name, file)| {
        (name, settings.selects(name).then(|| MeshSolid::read(&folder.join(file))).flatten())
    });
    let mut wrong = Vec::new();
    for seed in settings.seeds.clone() {
        let solids = OBJECTS.iter().filter(|(name, _)| settings.selects(name));
        let solids = solids.map(|&(name, make)| (name, run_solid(name, make, seed, settings)));
        let meshes = meshes.iter().filter_map(|(name, mesh)| {
            mesh.as_ref().map(|mesh| (*name, run_mesh(name, mesh, seed, settings)))
        });
        for (name, outcome) in solids.chain(meshes) {
            let text = match &outcome {
                Outcome::Fitted(m) => format!(
                    "{}, covered {:.3}, rms/σ {:.1}, error/noise {:.1}, marked {:.2?}, missed {:.2}: {}",
                    m.shape,
                    m.coverage_measured,
                    m.rms_normalised,
                    m.rms,
                    m.shares,
                    m.missed,
                    m.texts.join(" | ")
                ),
                Outcome::Refused(text) => format!("refused: {text}"),
                Outcome::Failed(text) => text.clone(),
            };
            let defect = defect(&outcome);
            let mark = defect.as_ref().map_or(String::new(), |d| format!(" ✗ {d}"));
            println!("{name} seed {seed}: {text}{mark}");
            wrong.extend(defect.map(|d| format!("{name} seed {seed}: {d}")));
        }
    }
    wrong
}

#[test]
#[ignore = "nine objects a seed: run by `just nightly`"]
fn objects_beyond_the_known_shapes_are_refused_or_marked() {
    let mut settings = TableSettings::from_environment();
    if std::env::var_os("PLANISH_HONESTY_SEEDS").is_none() {
        settings.seeds = settings.seeds.start..settings.seeds.start + 8;
    }
    if std::env::var_os("PLANISH_HONESTY_READINGS").is_none() {
        settings.readings = 10_000;
    }
    let wrong = run_objects(&settings);
    assert!(wrong.is_empty(), "objects with a wrong outcome:\n{}", wrong.join("\n"));
}
