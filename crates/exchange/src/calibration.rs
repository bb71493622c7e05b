//! Calibration files of sensors (TOML).
//!
//! **Input.** A TOML file.
//!
//! **Output.** A [`Calibration`] of a depth camera. Unknown keys are errors, so that a misspelt σ does not go
//! unnoticed.
//!
//! ```toml
//! unit = "m"                # unit of all lengths and of the points: mm, m, in or ft (optional)
//! fx = 525.0                # focal lengths, in pixels
//! fy = 525.0
//! cx = 319.5                # principal point; pixel centres are at integers
//! cy = 239.5
//! scale = 0.001             # length of one depth step (default 1)
//! sigma_a = 0.0015          # σ = a + b z² of a depth z (optional; without it, σ is estimated)
//! sigma_b = 0.0019
//! ```
//!
//! Other sensors have their own keys: [`read_stereo_calibration`], [`read_grid_calibration`], [`read_lights`]
//! and [`read_view_sensor`].
//!
//! **Limits.** Lens distortion is supported only for unrectified stereo views.

mod grid;
mod lights;
mod stereo;
mod view;

pub use grid::{GridCalibration, read_grid_calibration};
pub use lights::{LightSource, LightsCalibration, read_lights};
pub use stereo::{StereoCalibration, StereoCameras, read_stereo_calibration};
pub use view::{ViewCalibration, read_view_sensor};

use std::path::Path;

use planish_core::Budget;
use planish_estimate::{Error, Result};
use planish_sense::DepthCamera;
use serde::Deserialize;

use crate::Unit;
use crate::source::read_text;

/// A calibrated depth camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// The camera.
    pub camera: DepthCamera,
    /// The unit of its lengths, if stated.
    pub unit: Option<Unit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default = "one")]
    scale: f64,
    sigma_a: Option<f64>,
    sigma_b: Option<f64>,
}

fn one() -> f64 {
    1.0
}

/// Reads the calibration of a depth camera.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if the file is missing;
/// [`Input`](planish_estimate::ErrorKind::Input) for malformed TOML, missing or unknown keys, and numbers out
/// of range: with file, line and key.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("camera.toml");
/// std::fs::write(&path, "fx = 525\nfy = 525\ncx = 319.5\ncy = 239.5\nscale = 0.001\nunit = \"m\"\n")?;
/// let camera = planish_exchange::calibration::read_calibration(&path)?.camera;
/// // A reading of 2000 at the principal point is 2 m away.
/// assert_eq!(camera.point(319.5, 239.5, 2000.0), Some(2.0 * planish_core::DVec3::Z));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_calibration(path: &Path) -> Result<Calibration> {
    read_text(path).and_then(|text| parse(&text)).map_err(|e| e.in_context(path.display()))
}

/// Takes the memory of the tree of a TOML text, which is larger than that of any other input of its size.
///
/// # Errors
/// `Unsupported` if the tree takes more than a small input may.
pub(crate) fn take_tree(text: &str) -> Result<()> {
    /// Memory per byte of text: 424 MB were measured for 6.9 MB of cameras.
    const TREE_BYTES: u64 = 50;
    let length = text.len() as u64;
    Budget::of_compressed(length, 1).take_elements(length, TREE_BYTES, "bytes of TOML")
}

/// Parses a TOML table; an error gives the line, the reason and the `expected` keys.
pub(crate) fn table<T: serde::de::DeserializeOwned>(text: &str, expected: &str) -> Result<T> {
    take_tree(text)?;
    toml::from_str(text).map_err(|e| {
        let line =
            // Counted in bytes, because a span is in bytes and may follow characters of several bytes.
            e.span().map_or(1, |span| 1 + text.bytes().take(span.start).filter(|&b| b == b'\n').count());
        Error::input(format!("line {line}: {}; {expected}", e.message().trim_end()))
    })
}

/// Rejects the first number that is not finite or out of range. Entries: key, value, whether it is in range,
/// and a description of the range.
fn check_numbers(numbers: &[(&str, f64, bool, &str)]) -> Result<()> {
    // Finite in any case, because TOML has `nan` and `inf`, and the range of some keys is unlimited.
    match numbers.iter().find(|(_, value, good, _)| !(*good && value.is_finite())) {
        Some((key, value, _, expected)) => {
            Err(Error::input(format!("expected {expected} for {key}, found {value}")))
        }
        None => Ok(()),
    }
}

fn parse(text: &str) -> Result<Calibration> {
    let table: Table = table(
        text,
        "expected fx fy cx cy of a depth camera, and optionally scale, sigma_a, sigma_b and unit",
    )?;
    let numbers = [
        ("fx", Some(table.fx), table.fx > 0.0),
        ("fy", Some(table.fy), table.fy > 0.0),
        ("cx", Some(table.cx), true),
        ("cy", Some(table.cy), true),
        ("scale", Some(table.scale), table.scale > 0.0),
        ("sigma_a", table.sigma_a, table.sigma_a.is_none_or(|a| a >= 0.0)),
        ("sigma_b", table.sigma_b, table.sigma_b.is_none_or(|b| b >= 0.0)),
    ];
    for (key, value, good) in numbers {
        if let Some(value) = value.filter(|v| !(good && v.is_finite())) {
            let expected = match key {
                "cx" | "cy" => "a finite number",
                "sigma_a" | "sigma_b" => "a finite number that is not negative",
                _ => "a finite number above 0",
            };
            return Err(Error::input(format!("expected {expected} for {key}, found {value}")));
        }
    }
    // One of the two is enough: the other is then 0.
    let sigma = match (table.sigma_a, table.sigma_b) {
        (None, None) => None,
        (a, b) => Some([a.unwrap_or(0.0), b.unwrap_or(0.0)]),
    };
    // σ = 0 would give every reading infinite weight; it must not be taken for "unknown".
    if sigma == Some([0.0; 2]) {
        return Err(Error::input(
            "expected sigma_a or sigma_b above 0, found 0 for both: omit them to estimate σ",
        ));
    }
    Ok(Calibration {
        camera: DepthCamera {
            focal: [table.fx, table.fy],
            center: [table.cx, table.cy],
            scale: table.scale,
            sigma,
        },
        unit: table.unit.map(|name| name.parse()).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_keys_of_a_camera_have_defaults() {
        let text = "fx = 525\nfy = 520.5\ncx = 319.5\ncy = 239.5\n";
        let found = parse(text).unwrap();
        assert_eq!((found.camera.focal, found.camera.scale, found.unit), ([525.0, 520.5], 1.0, None));
        assert_eq!(found.camera.sigma, None);
        let found = parse(&format!("unit = \"m\"\nscale = 0.001\nsigma_b = 0.002\n{text}")).unwrap();
        assert_eq!((found.camera.sigma, found.unit), (Some([0.0, 0.002]), Some(Unit::Metre)));
    }

    #[test]
    fn errors_name_line_or_key() {
        let with = |line: &str| {
            parse(&format!("fx = 525\nfy = 525\ncx = 319.5\ncy = 239.5\n{line}\n")).unwrap_err().to_string()
        };
        assert!(with("sigm_a = 1").contains("line 5"));
        assert!(with("scale = 0").contains("above 0 for scale, found 0"));
        assert!(with("sigma_a = -1").contains("sigma_a, found -1"));
        assert!(with("sigma_a = 0").contains("above 0"));
        assert!(with("unit = \"cm\"").contains("`cm`"));
        let e = parse("fx = 525\n").unwrap_err().to_string();
        assert!(e.contains("missing field `fy`") && e.contains("expected fx fy cx cy"), "{e}");
        let e = parse("fx = inf\nfy = 1\ncx = 0\ncy = nan\n").unwrap_err().to_string();
        assert!(e.contains("fx, found inf"), "{e}");
    }
}
