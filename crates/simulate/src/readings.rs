//! The scene `readings`: a contour of some 100 mm, ranged from all around by a sensor of uncertain pose.
//!
//! Input: [`ReadingsOptions`]. Output: `readings.csv`, `exact.csv` and `truth.json` in a folder.

use super::truth::positive;
use planish_contour::planar::{ContourKind, ContourReading, ContourTarget, SensorOptions, ranges};
use planish_estimate::{Error, Result};
use planish_exchange::contours::COLUMNS;
use planish_exchange::{Unit, make_folder, write_atomically};
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

/// How many of the columns that readings may have are written: up to the time.
const WRITTEN_COLUMNS: usize = 10;

/// Settings of the scene `readings`.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingsOptions {
    /// What is seen.
    pub kind: ContourKind,
    /// How many readings.
    pub readings: usize,
    /// Readings from each pose.
    pub sweep: usize,
    /// Errors over the usual ones: 2 mm, 2°, 1 % of the range.
    pub noise: f64,
    /// Share of wild readings.
    pub outlier_share: f64,
    /// Velocity of the object, `vx vy ω` in lengths and radians a second.
    pub velocity: [f64; 3],
    /// Seed of every error.
    pub seed: u64,
    /// Unit of every length.
    pub unit: Unit,
}

/// Files that were written.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingsSummary {
    /// Readings.
    pub rows: usize,
    /// Columns of the tables.
    pub columns: Vec<&'static str>,
    /// Files.
    pub files: Vec<PathBuf>,
}

/// Parameters of the object, some 100 mm long, not at the origin and not upright.
fn truth_of(kind: &ContourKind) -> Result<Vec<f64>> {
    let (x, y, angle) = (12.0, -7.0, 25f64.to_radians());
    Ok(match kind {
        ContourKind::Circle => vec![x, y, 50.0],
        ContourKind::Ellipse => vec![x, y, 55.0, 33.0, angle],
        ContourKind::Rectangle => vec![x, y, 90.0, 55.0, angle],
        ContourKind::RoundedRectangle => vec![x, y, 95.0, 60.0, angle, 14.0],
        ContourKind::Slot => vec![x, y, 100.0, 44.0, angle],
        ContourKind::RegularPolygon(_) => vec![x, y, 52.0, 0.2],
        // An L.
        ContourKind::Polygon(6) => {
            vec![-40.0, -45.0, 50.0, -45.0, 50.0, -5.0, 10.0, -5.0, 10.0, 45.0, -40.0, 45.0]
        }
        _ => {
            return Err(Error::unsupported(format!(
                "a scene of a {kind}: there are circle, ellipse, rectangle, rounded-rectangle, slot, \
                 regular-polygon-N, polygon-6"
            )));
        }
    })
}

/// Simulates the scene and writes it: what `planish simulate scene readings` does.
///
/// # Errors
/// `Input` and `Unsupported` for options that make no sense; `Io` when a file cannot be written.
pub fn write_readings_scene(options: &ReadingsOptions, folder: &Path) -> Result<ReadingsSummary> {
    positive("number of readings", options.readings as f64)?;
    positive("noise", options.noise)?;
    let millimetre = 1.0 / options.unit.millimetres();
    let mut theta = truth_of(&options.kind)?;
    for (value, (name, _)) in theta.iter_mut().zip(options.kind.names()) {
        if !name.ends_with("_deg") {
            *value *= millimetre;
        }
    }
    let sensor = SensorOptions {
        outlier_share: options.outlier_share,
        velocity: options.velocity,
        ..usual_sensor(options.noise, options.sweep, millimetre)
    };
    let middle = if options.kind == ContourKind::Polygon(6) { [0.0; 2] } else { [theta[0], theta[1]] };
    let made = ranges(&options.kind, &theta, middle, options.readings, &sensor, options.seed);
    make_folder(folder)?;
    let paths = ["readings.csv", "exact.csv", "truth.json"].map(|name| folder.join(name));
    write_table(&paths[0], &made.noisy)?;
    write_table(&paths[1], &made.exact)?;
    let parameters = named(&options.kind, &theta);
    let [vx, vy, turn] = options.velocity;
    let truth = json!({
        "kind": options.kind.to_string(),
        "parameters": parameters,
        "velocity": { "x": vx, "y": vy, "rotation_deg_per_s": turn.to_degrees() },
        "unit": options.unit.name(),
    });
    write_atomically(&paths[2], |out| writeln!(out, "{truth:#}"))?;
    Ok(ReadingsSummary {
        rows: made.noisy.len(),
        columns: COLUMNS[..WRITTEN_COLUMNS].to_vec(),
        files: paths.to_vec(),
    })
}

/// A sensor 300 mm away that knows its place to 2 mm and its heading to 2°, and reads to 1 %, all times
/// `noise`.
pub(super) fn usual_sensor(noise: f64, sweep: usize, millimetre: f64) -> SensorOptions {
    SensorOptions {
        standoff: 300.0 * millimetre,
        sigma: [2.0 * millimetre * noise, 2.0 * millimetre * noise, 2f64.to_radians() * noise, 0.0],
        sigma_range_share: 0.01 * noise,
        sweep: sweep.max(1),
        outlier_share: 0.0,
        velocity: [0.0; 3],
        rate_hz: 100.0,
    }
}

/// True parameters as contour.json has them.
pub(super) fn named(kind: &ContourKind, theta: &[f64]) -> serde_json::Map<String, serde_json::Value> {
    let (canonical, _) = kind.canonical(theta);
    let names = kind.names().into_iter().zip(canonical);
    names.map(|((name, factor), value)| (name, json!({ "value": value * factor, "sigma": 0.0 }))).collect()
}

pub(super) fn write_table(path: &Path, sightings: &[ContourReading]) -> Result<()> {
    write_atomically(path, |out| {
        writeln!(out, "{}", COLUMNS[..WRITTEN_COLUMNS].join(","))?;
        for (i, sighting) in sightings.iter().enumerate() {
            let ContourTarget::Range { origin, heading_rad, range, sigma } = sighting.target else {
                continue;
            };
            writeln!(
                out,
                "{},{},{},{range},{},{},{},{},{},{}",
                origin[0],
                origin[1],
                heading_rad.to_degrees(),
                sigma[0],
                sigma[1],
                sigma[2].to_degrees(),
                sigma[3],
                sighting.pose.unwrap_or(i),
                sighting.time_s
            )?;
        }
        Ok(())
    })
}
