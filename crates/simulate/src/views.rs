//! The scene `views`: ranges to the outlines of a triangular prism in three views, by a sensor of uncertain
//! pose.
//!
//! Input: [`ViewsOptions`]. Output: a folder for each view with `readings.csv`, `exact.csv` and `truth.json`,
//! and the vertices of the prism in a common `truth.json`.
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*, figure 3.

use super::readings::{ReadingsSummary, all_met, default_sensor, parameters_json, write_table};
use super::truth::positive;
use planish_contour::planar::{ContourKind, ranges};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_exchange::contours::COLUMNS;
use planish_exchange::{Unit, make_folder, write_atomically};
use planish_solid::views::ViewKind;
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// Width (x), depth (y) and height (z) of the prism, in millimetres; the right angle is at the origin.
pub const PRISM_MM: [f64; 3] = [80.0, 100.0, 60.0];
/// σ of this scene relative to that of the scene `readings`.
const NOISE: f64 = 0.1;
/// Number of columns written: those of [`COLUMNS`] up to the time.
const WRITTEN_COLUMNS: usize = 10;

/// Settings of the scene `views`.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewsOptions {
    /// Number of readings of each view.
    pub readings: usize,
    /// Number of readings from each pose, which share the error of the pose.
    pub sweep: usize,
    /// Factor on the default σ: 0.2 mm and 0.2° for the pose, 0.1 % for the range.
    pub noise: f64,
    /// Seed of every error.
    pub seed: u64,
    /// Unit of every length.
    pub unit: Unit,
}

/// Simulates the scene and writes its files, as `planish simulate scene views` does.
///
/// # Errors
/// `Input` for options out of range; `Io` if a file cannot be written.
///
/// # Examples
/// ```
/// use planish_exchange::Unit;
/// use planish_simulate::{ViewsOptions, write_views_scene};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let folder = tempfile::tempdir()?;
/// let options = ViewsOptions { readings: 40, sweep: 1, noise: 1.0, seed: 1, unit: Unit::Millimetre };
/// let summary = write_views_scene(&options, folder.path())?;
/// assert_eq!(summary.rows, 3 * 40);
/// assert!(folder.path().join("front/readings.csv").is_file());
/// # Ok(())
/// # }
/// ```
pub fn write_views_scene(options: &ViewsOptions, folder: &Path) -> Result<ReadingsSummary> {
    positive("number of readings", options.readings as f64)?;
    positive("noise", options.noise)?;
    let millimetre = 1.0 / options.unit.millimetres();
    let size = PRISM_MM.map(|length| length * millimetre);
    let sensor = default_sensor(NOISE * options.noise, options.sweep, millimetre);
    make_folder(folder)?;
    let mut summary =
        ReadingsSummary { rows: 0, columns: COLUMNS[..WRITTEN_COLUMNS].to_vec(), files: Vec::new() };
    for (i, view) in ViewKind::ALL.into_iter().enumerate() {
        // Axes come from the reader of views, so that the scene cannot disagree with it about what a view
        // shows.
        let [right, up, _] = view.axes();
        let (kind, theta) = outline(view, size[right], size[up]);
        let middle = [0.5 * size[right], 0.5 * size[up]];
        // Each view needs errors of its own, as they are measured one after the other.
        let seed = options.seed.wrapping_mul(3).wrapping_add(i as u64);
        let made = ranges(&kind, &theta, middle, options.readings, &sensor, seed);
        all_met(made.exact.len(), options.readings)?;
        let own = folder.join(view.name());
        make_folder(&own)?;
        let paths = ["readings.csv", "exact.csv", "truth.json"].map(|name| own.join(name));
        write_table(&paths[0], &made.noisy)?;
        write_table(&paths[1], &made.exact)?;
        let truth = json!({
            "kind": kind.to_string(),
            "parameters": parameters_json(&kind, &theta),
            "unit": options.unit.name(),
        });
        write_atomically(&paths[2], |out| writeln!(out, "{truth:#}"))?;
        summary.rows += made.noisy.len();
        summary.files.extend(paths);
    }
    // The right angle of the front is at the origin, so the prism is half of its box.
    let [x, y, z] = size;
    let front = [[0.0, 0.0], [x, 0.0], [0.0, z]];
    let vertices: Vec<DVec3> =
        [0.0, y].iter().flat_map(|&depth| front.map(|[x, z]| DVec3::new(x, depth, z))).collect();
    let truth = json!({
        "size": size,
        "vertices": vertices,
        "volume": 0.5 * x * y * z,
        "unit": options.unit.name(),
    });
    let path = folder.join("truth.json");
    write_atomically(&path, |out| writeln!(out, "{truth:#}"))?;
    summary.files.push(path);
    Ok(summary)
}

/// The outline in a view of width `a` and height `b`: a triangle from the front, else a rectangle.
fn outline(view: ViewKind, a: f64, b: f64) -> (ContourKind, Vec<f64>) {
    match view {
        ViewKind::Front => (ContourKind::Polygon(3), vec![0.0, 0.0, a, 0.0, 0.0, b]),
        _ => (ContourKind::Polygon(4), vec![0.0, 0.0, a, 0.0, a, b, 0.0, b]),
    }
}
