//! Two rectified cameras.
//!
//! ```toml
//! unit = "mm"                 # of the baseline and of the points: mm, m, in or ft; may be left out
//! f = 3740.0                  # focal length of both, in pixels
//! cx = 641.0                  # the pixel of the left image on its axis; centres are at integers
//! cy = 555.0
//! baseline = 160.0            # the distance of the cameras
//! doffs = 0.0                 # cx of the right camera less that of the left; 0 where it is left out
//! sigma_disparity_px = 0.1    # σ that matching does not see, such as of the rectification; 0 where it is left out
//! ```

use std::path::Path;

use planish_estimate::Result;
use planish_sense::StereoCamera;
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Two calibrated cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCalibration {
    /// The cameras.
    pub camera: StereoCamera,
    /// The unit of their lengths, where it is named.
    pub unit: Option<Unit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    f: f64,
    cx: f64,
    cy: f64,
    baseline: f64,
    #[serde(default)]
    doffs: f64,
    #[serde(default)]
    sigma_disparity_px: f64,
}

/// Reads the calibration of two rectified cameras.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
pub fn read_stereo_calibration(path: &Path) -> Result<StereoCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<StereoCalibration> {
    let t: Table = table(
        text,
        "two rectified cameras need f cx cy baseline, and may have doffs, sigma_disparity_px and unit",
    )?;
    check_numbers(&[
        ("f", t.f, t.f > 0.0, "a finite number above 0"),
        ("cx", t.cx, true, "a finite number"),
        ("cy", t.cy, true, "a finite number"),
        ("baseline", t.baseline, t.baseline > 0.0, "a finite number above 0"),
        ("doffs", t.doffs, true, "a finite number"),
        (
            "sigma_disparity_px",
            t.sigma_disparity_px,
            t.sigma_disparity_px >= 0.0,
            "a finite number that is not negative",
        ),
    ])?;
    Ok(StereoCalibration {
        camera: StereoCamera {
            focal: t.f,
            center: [t.cx, t.cy],
            baseline: t.baseline,
            doffs: t.doffs,
            sigma_disparity: t.sigma_disparity_px,
        },
        unit: t.unit.map(|name| name.parse()).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_are_read_and_mistakes_are_named() {
        let text = "unit = \"mm\"\nf = 3740\ncx = 641\ncy = 555.0\nbaseline = 160\n";
        let found = parse(text).unwrap();
        assert_eq!(
            (found.camera.focal, found.camera.doffs, found.unit),
            (3740.0, 0.0, Some(Unit::Millimetre))
        );
        let e = parse(&format!("{text}dofs = 2\n")).unwrap_err().to_string();
        assert!(e.contains("line 6") && e.contains("doffs"), "{e}");
        let e = parse(&text.replace("160", "-160")).unwrap_err().to_string();
        assert!(e.contains("above 0 for baseline, found -160"), "{e}");
        let e = parse("f = 1\n").unwrap_err().to_string();
        assert!(
            e.contains("missing field `cx`") && e.contains("need f cx cy baseline"),
            "{e}"
        );
    }
}
