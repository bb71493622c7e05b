//! A range sensor with a field of view, for `planish next --sensor`.
//!
//! ```toml
//! unit = "mm"                 # of lengths: mm, m, in or ft; the model's where it is left out
//! fov_deg = [40, 30]          # angles of view, horizontal and vertical; or fx fy cx cy and size (px)
//! rays = [640, 480]           # along x and along y; `size` where it is left out and fx is stated
//! near = 200                  # nearest and farthest range
//! far = 800
//! max_incidence_deg = 60      # largest angle between ray and normal; 60 where it is left out
//! sigma_along = 0.05          # along the ray
//! sigma_across = 0.02         # across it; as along it where it is left out
//! sigma_per_range2 = 1e-7     # growth of σ along the ray with range², 1/unit (default 0)
//! sigma_over_cos = false      # whether σ along the ray grows as one over the cosine of incidence
//! ```

use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::ViewSensor;
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// The largest angle of incidence of a sensor that states none.
const DEFAULT_INCIDENCE_DEG: f64 = 60.0;

/// A sensor with its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewCalibration {
    /// The sensor.
    pub sensor: ViewSensor,
    /// The unit of its lengths, where it is named.
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
pub fn read_view_sensor(path: &Path) -> Result<ViewCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<ViewCalibration> {
    let t: Table = table(
        text,
        "a sensor needs fov_deg and rays (or fx fy cx cy and size), near, far and sigma_along, and may have \
         max_incidence_deg, sigma_across, sigma_per_range2, sigma_over_cos and unit",
    )?;
    let sensor = ViewSensor {
        borders: borders(&t)?,
        rays: (t.rays.or(t.size)).ok_or_else(|| {
            Error::input("expected rays = [along x, along y]: with fov_deg nothing else says how many")
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
            // Pixels reach half a pixel beyond their centres.
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
    fn angles_and_intrinsics_say_the_same() {
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
    fn mistakes_are_named() {
        let with = |from: &str, to: &str| parse(&GOOD.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(with("near", "nearest").contains("line 3"));
        assert!(with("rays = [64, 48]\n", "").contains("expected rays"));
        assert!(with("[90, 60]", "[90, 180]").contains("below 180 for fov_deg, found 180"));
        assert!(with("fov_deg = [90, 60]", "fx = 3").contains("fov_deg = [horizontal, vertical]"));
        assert!(with("far = 800", "far = 100").contains("nearest < farthest"));
        assert!(with("0.05", "-1").contains("along the ray above 0"));
    }
}
