//! The scene `readings`: ranges to a contour of about 100 mm, from all sides, by a sensor of uncertain pose.
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

/// Number of columns written: those of [`COLUMNS`] up to the time.
const WRITTEN_COLUMNS: usize = 10;

/// Settings of the scene `readings`.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingsOptions {
    /// Shape of the object.
    pub kind: ContourKind,
    /// Number of readings.
    pub readings: usize,
    /// Number of readings from each pose, which share the error of the pose.
    pub sweep: usize,
    /// Factor on the default σ: 2 mm and 2° for the pose, 1 % for the range.
    pub noise: f64,
    /// Share of readings that are outliers.
    pub outlier_share: f64,
    /// Velocity of the object, `[vx, vy, ω]` in lengths and radians per second.
    pub velocity: [f64; 3],
    /// Seed of every error.
    pub seed: u64,
    /// Unit of every length.
    pub unit: Unit,
}

/// The number of readings and the files written.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingsSummary {
    /// Number of readings.
    pub rows: usize,
    /// Columns of the files of readings.
    pub columns: Vec<&'static str>,
    /// All files written.
    pub files: Vec<PathBuf>,
}

/// Refuses a scene in which most beams miss the object.
pub(super) fn all_met(made: usize, wanted: usize) -> Result<()> {
    if made == wanted {
        return Ok(());
    }
    Err(Error::undetermined(format!(
        "expected {wanted} readings, found {made}: all further beams miss the object; specify fewer readings \
         or a slower object"
    )))
}

/// True parameters of the object, in millimetres and radians.
///
/// The object is neither at the origin nor aligned with the axes, where wrong signs and angles cancel.
fn true_parameters(kind: &ContourKind) -> Result<Vec<f64>> {
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
                "expected a circle, ellipse, rectangle, rounded-rectangle, slot, regular-polygon-N or \
                 polygon-6, found {kind}"
            )));
        }
    })
}

/// Simulates the scene and writes its files, as `planish simulate scene readings` does.
///
/// # Errors
/// `Input` for options out of range; `Unsupported` for a kind without a scene; `Io` if a file cannot be
/// written.
///
/// # Examples
/// ```
/// use planish_contour::planar::ContourKind;
/// use planish_exchange::Unit;
/// use planish_simulate::{ReadingsOptions, write_readings_scene};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let options = ReadingsOptions {
///     kind: ContourKind::Circle,
///     readings: 50,
///     sweep: 1,
///     noise: 1.0,
///     outlier_share: 0.0,
///     velocity: [0.0; 3],
///     seed: 1,
///     unit: Unit::Millimetre,
/// };
/// let summary = write_readings_scene(&options, folder.path())?;
/// assert_eq!(summary.rows, 50);
/// assert!(folder.path().join("truth.json").is_file());
/// # Ok(())
/// # }
/// ```
pub fn write_readings_scene(options: &ReadingsOptions, folder: &Path) -> Result<ReadingsSummary> {
    positive("number of readings", options.readings as f64)?;
    positive("noise", options.noise)?;
    let millimetre = 1.0 / options.unit.millimetres();
    let mut theta = true_parameters(&options.kind)?;
    // Only lengths depend on the unit.
    for (value, (name, _)) in theta.iter_mut().zip(options.kind.names()) {
        if !name.ends_with("_deg") {
            *value *= millimetre;
        }
    }
    let sensor = SensorOptions {
        outlier_share: options.outlier_share,
        velocity: options.velocity,
        ..default_sensor(options.noise, options.sweep, millimetre)
    };
    // The sensor moves around this point. The vertices of the L lie around the origin; the parameters of all
    // other kinds begin with their centre.
    let middle = if options.kind == ContourKind::Polygon(6) { [0.0; 2] } else { [theta[0], theta[1]] };
    // One call gives both files, so that row k of `exact.csv` is the true value of row k of
    // `readings.csv`.
    let made = ranges(&options.kind, &theta, middle, options.readings, &sensor, options.seed);
    all_met(made.exact.len(), options.readings)?;
    make_folder(folder)?;
    let paths = ["readings.csv", "exact.csv", "truth.json"].map(|name| folder.join(name));
    write_table(&paths[0], &made.noisy)?;
    write_table(&paths[1], &made.exact)?;
    let parameters = parameters_json(&options.kind, &theta);
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

/// A sensor at a distance of 300 mm with σ of 2 mm for its position, 2° for its heading and 1 % for its
/// range, each times `noise`.
pub(super) fn default_sensor(noise: f64, sweep: usize, millimetre: f64) -> SensorOptions {
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

/// True parameters by name, in the form of `contour.json`.
pub(super) fn parameters_json(
    kind: &ContourKind,
    theta: &[f64],
) -> serde_json::Map<String, serde_json::Value> {
    // Canonical, as a fit reports them: an ellipse has a second set of parameters, with its axes swapped.
    let (canonical, _) = kind.canonical(theta);
    let names = kind.names().into_iter().zip(canonical);
    names.map(|((name, factor), value)| (name, json!({ "value": value * factor, "sigma": 0.0 }))).collect()
}

/// Writes ranges as CSV: sensor pose, range, their σ, and which pose and time they belong to.
pub(super) fn write_table(path: &Path, readings: &[ContourReading]) -> Result<()> {
    write_atomically(path, |out| {
        writeln!(out, "{}", COLUMNS[..WRITTEN_COLUMNS].join(","))?;
        for (i, reading) in readings.iter().enumerate() {
            let ContourTarget::Range { origin, heading_rad, range, sigma } = reading.target else {
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
                reading.pose.unwrap_or(i),
                reading.time_s
            )?;
        }
        Ok(())
    })
}
