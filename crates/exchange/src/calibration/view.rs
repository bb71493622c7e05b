//! Range sensor with a field of view, for which `planish next` plans views.
//!
//! ```toml
//! unit = "mm"                 # unit of lengths: mm, m, in or ft (default: that of the model)
//! fov_deg = [40, 30]          # angles of view, horizontal and vertical; or fx fy cx cy and size (px)
//! rays = [640, 480]           # number of rays along x and y (default with fx: `size`)
//! near = 200                  # minimum range
//! far = 800                   # maximum range
//! max_incidence_deg = 60      # maximum angle between ray and normal (default 60)
//! sigma_along = 0.05          # σ along the ray
//! sigma_across = 0.02         # σ across the ray (default: sigma_along)
//! sigma_per_range2 = 1e-7     # growth of σ along the ray with range², 1/unit (default 0)
//! sigma_over_cos = false      # whether σ along the ray is divided by the cosine of incidence
//! ```

use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::ViewSensor;
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Default maximum angle of incidence. Range sensors fail on grazing surfaces; a larger angle plans views
/// whose readings are missing, a smaller one more views than necessary.
const DEFAULT_INCIDENCE_DEG: f64 = 60.0;

/// A range sensor with the unit of its lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewCalibration {
    /// The sensor.
    pub sensor: ViewSensor,
    /// The unit of its lengths, if stated.
    pub unit: Option<Unit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    fov_deg: Option<[f64; 2]>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    size: Option<[usize; 2]>,
    rays: Option<[usize; 2]>,
    near: f64,
    far: f64,
    max_incidence_deg: Option<f64>,
    sigma_along: f64,
    sigma_across: Option<f64>,
    #[serde(default)]
    sigma_per_range2: f64,
    #[serde(default)]
    sigma_over_cos: bool,
}

/// Reads a range sensor with a field of view.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("sensor.toml");
/// let text = "fov_deg = [90, 60]\nrays = [64, 48]\nnear = 200\nfar = 800\nsigma_along = 0.05\n";
/// std::fs::write(&path, text)?;
/// let sensor = planish_exchange::calibration::read_view_sensor(&path)?.sensor;
/// assert_eq!((sensor.rays, sensor.range), ([64, 48], [200.0, 800.0]));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_view_sensor(path: &Path) -> Result<ViewCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<ViewCalibration> {
    let t: Table = table(
        text,
        "expected fov_deg and rays (or fx fy cx cy and size), near, far and sigma_along, and optionally \
         max_incidence_deg, sigma_across, sigma_per_range2, sigma_over_cos and unit",
    )?;
    let sensor = ViewSensor {
        borders: borders(&t)?,
        // A camera has one ray per pixel, unless `rays` states another number.
        rays: (t.rays.or(t.size)).ok_or_else(|| {
            Error::input("expected rays = [along x, along y], because fov_deg does not define their number")
        })?,
        range: [t.near, t.far],
        max_incidence_rad: t.max_incidence_deg.unwrap_or(DEFAULT_INCIDENCE_DEG).to_radians(),
        sigma_along: t.sigma_along,
        sigma_across: t.sigma_across.unwrap_or(t.sigma_along),
        sigma_per_range2: t.sigma_per_range2,
        over_cosine: t.sigma_over_cos,
    };
    sensor.sanity_check()?;
    Ok(ViewCalibration { sensor, unit: t.unit.map(|name| name.parse()).transpose()? })
}

fn borders(t: &Table) -> Result<[[f64; 2]; 2]> {
    // Both forms together could conflict.
    match (t.fov_deg, t.fx, t.fy, t.cx, t.cy, t.size) {
        (Some(angles), None, None, None, None, None) => {
            let good = |angle: f64| angle > 0.0 && angle < 180.0;
            let expected = "an angle above 0 and below 180";
            check_numbers(&angles.map(|angle| ("fov_deg", angle, good(angle), expected)))?;
            Ok(ViewSensor::borders_of_angles(angles.map(f64::to_radians)))
        }
        (None, Some(fx), Some(fy), Some(cx), Some(cy), Some([width, height])) => {
            check_numbers(&[
                ("fx", fx, fx > 0.0, "a finite number above 0"),
                ("fy", fy, fy > 0.0, "a finite number above 0"),
                ("cx", cx, true, "a finite number"),
                ("cy", cy, true, "a finite number"),
            ])?;
            // Centres are at integers, so the image extends half a pixel beyond the outer ones.
            let side = |f: f64, c: f64, n: usize| [(-0.5 - c) / f, (n as f64 - 0.5 - c) / f];
            Ok([side(fx, cx, width), side(fy, cy, height)])
        }
        _ => Err(Error::input(
            "expected either fov_deg = [horizontal, vertical], or all of fx fy cx cy and size = [width, \
             height]",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "fov_deg = [90, 60]\nrays = [64, 48]\nnear = 200\nfar = 800\nsigma_along = 0.05\n";

    #[test]
    fn angles_and_intrinsics_give_the_same_field_of_view() {
        let found = parse(GOOD).unwrap().sensor;
        assert!((found.borders[0][1] - 1.0).abs() < 1e-12 && found.sigma_across == 0.05);
        let text = GOOD.replace(
            "fov_deg = [90, 60]",
            "fx = 50\nfy = 86.60254037844386\ncx = 49.5\ncy = 49.5\nsize = [100, 100]",
        );
        let same = parse(&text).unwrap().sensor;
        for (a, b) in found.borders.iter().flatten().zip(same.borders.iter().flatten()) {
            assert!((a - b).abs() < 1e-12);
        }
        assert_eq!(same.rays, [64, 48]);
    }

    #[test]
    fn errors_name_line_or_key() {
        let with = |from: &str, to: &str| parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(with("near", "nearest").contains("line 3"));
        assert!(with("rays = [64, 48]\n", "").contains("expected rays"));
        assert!(with("[90, 60]", "[90, 180]").contains("below 180 for fov_deg, found 180"));
        assert!(with("fov_deg = [90, 60]", "fx = 3").contains("fov_deg = [horizontal, vertical]"));
        assert!(with("far = 800", "far = 100").contains("nearest < farthest"));
        assert!(with("0.05", "-1").contains("along the ray above 0"));
    }
}
