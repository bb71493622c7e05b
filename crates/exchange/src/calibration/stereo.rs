//! Calibration of two cameras: a rectified pair, or two views with any poses.
//!
//! ```toml
//! unit = "mm"                 # unit of the baseline and of the points: mm, m, in or ft (optional)
//! f = 3740.0                  # focal length of both, in pixels
//! cx = 641.0                  # principal point of the left image; pixel centres are at integers
//! cy = 555.0
//! baseline = 160.0            # distance of the cameras
//! doffs = 0.0                 # cx of the right camera minus cx of the left (default 0)
//! sigma_disparity_px = 0.1    # σ added to that of matching, such as of the rectification (default 0)
//! ```
//!
//! ```toml
//! unit = "mm"                 # unit of lengths
//! sigma_disparity_px = 0.1    # as above
//!
//! [[view]]                    # gives one point per pixel; x ~ K (R X + t), pixel centres at integers
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! distortion = [-0.2, 0.05, 0.001, -0.002, 0.0]   # k1 k2 p1 p2 k3 (default: none)
//!
//! [[view]]                    # R and t are optional: default is the frame of the world
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! R = [[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]
//! t = [-150, 0, 20]
//! ```

use std::path::Path;

use planish_estimate::{Error, Result};
use planish_sense::{LensCamera, StereoCamera, StereoRig};
use serde::Deserialize;

use super::grid::{View, pinhole};
use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Upper limit of sizes in pixels: beyond any image, it catches numbers in a wrong unit.
const MAX_PIXELS: f64 = 1e7;

/// Two calibrated cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one value per job")]
pub enum StereoCameras {
    /// Cameras of rectified images.
    Rectified(StereoCamera),
    /// Cameras of images that are rectified by Planish.
    Views(StereoRig),
}

/// Two calibrated cameras, and their unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCalibration {
    /// The cameras.
    pub cameras: StereoCameras,
    /// The unit of their lengths, if stated.
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewsTable {
    unit: Option<String>,
    #[serde(default)]
    sigma_disparity_px: f64,
    view: Vec<LensView>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LensView {
    #[serde(rename = "K")]
    k: [[f64; 3]; 3],
    #[serde(rename = "R")]
    r: Option<[[f64; 3]; 3]>,
    t: Option<[f64; 3]>,
    distortion: Option<Vec<f64>>,
}

impl LensView {
    fn camera(&self, name: &str) -> Result<LensCamera> {
        let view = View { k: self.k, r: self.r, t: self.t };
        let mut distortion = [0.0; 5];
        if let Some(stated) = &self.distortion {
            // Calibration programs write four coefficients if k3 is not estimated.
            if !(4..=5).contains(&stated.len()) || stated.iter().any(|k| !k.is_finite()) {
                return Err(Error::input(format!(
                    "expected {name}.distortion = [k1, k2, p1, p2, k3] (k3 is optional), found {stated:?}"
                )));
            }
            distortion.iter_mut().zip(stated).for_each(|(to, from)| *to = *from);
        }
        Ok(LensCamera { pinhole: pinhole(name, &view)?, distortion })
    }
}

/// Reads the calibration of two cameras.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
///
/// # Examples
/// ```
/// use planish_exchange::calibration::{StereoCameras, read_stereo_calibration};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("stereo.toml");
/// std::fs::write(&path, "f = 3740\ncx = 641\ncy = 555\nbaseline = 160\nunit = \"mm\"\n")?;
/// let StereoCameras::Rectified(camera) = read_stereo_calibration(&path)?.cameras else { panic!("views") };
/// assert_eq!((camera.baseline, camera.doffs), (160.0, 0.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_stereo_calibration(path: &Path) -> Result<StereoCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<StereoCalibration> {
    // Decided before parsing, so that an error lists the keys of the right kind of calibration.
    // Malformed TOML counts as rectified here; the second parse then reports the syntax error with its line.
    let views = text.parse::<toml::Table>().is_ok_and(|t| t.contains_key("view"));
    if views { parse_views(text) } else { parse_rectified(text) }
}

fn check_sigma(sigma: f64) -> Result<()> {
    let expected = "a finite number that is not negative";
    check_numbers(&[("sigma_disparity_px", sigma, sigma >= 0.0, expected)])
}

fn parse_views(text: &str) -> Result<StereoCalibration> {
    let t: ViewsTable = table(
        text,
        "expected two [[view]] with K, and optionally R, t and distortion; sigma_disparity_px and unit are \
         optional",
    )?;
    check_sigma(t.sigma_disparity_px)?;
    let [first, second] = t.view.as_slice() else {
        return Err(Error::input(format!("expected two [[view]], found {}", t.view.len())));
    };
    Ok(StereoCalibration {
        cameras: StereoCameras::Views(StereoRig {
            cameras: [first.camera("the first view")?, second.camera("the second view")?],
            sigma_disparity: t.sigma_disparity_px,
        }),
        unit: t.unit.map(|name| name.parse()).transpose()?,
    })
}

fn parse_rectified(text: &str) -> Result<StereoCalibration> {
    let t: Table = table(
        text,
        "expected f cx cy baseline of two rectified cameras, and optionally doffs, sigma_disparity_px and \
         unit; or two [[view]] with K, R and t",
    )?;
    check_numbers(&[
        ("f", t.f, t.f > 0.0 && t.f < MAX_PIXELS, "a finite number of pixels above 0 and below 1e7"),
        ("cx", t.cx, t.cx.abs() < MAX_PIXELS, "a finite number of pixels within ±1e7"),
        ("cy", t.cy, t.cy.abs() < MAX_PIXELS, "a finite number of pixels within ±1e7"),
        (
            "baseline",
            t.baseline,
            t.baseline > 0.0 && t.baseline < 1e12,
            "a finite number above 0 and below 1e12",
        ),
        ("doffs", t.doffs, t.doffs.abs() < MAX_PIXELS, "a finite number of pixels within ±1e7"),
    ])?;
    check_sigma(t.sigma_disparity_px)?;
    Ok(StereoCalibration {
        cameras: StereoCameras::Rectified(StereoCamera {
            focal: t.f,
            center: [t.cx, t.cy],
            baseline: t.baseline,
            doffs: t.doffs,
            sigma_disparity: t.sigma_disparity_px,
        }),
        unit: t.unit.map(|name| name.parse()).transpose()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;

    #[test]
    fn rectified_cameras_are_read_and_errors_name_line_or_key() {
        let text = "unit = \"mm\"\nf = 3740\ncx = 641\ncy = 555.0\nbaseline = 160\n";
        let found = parse(text).unwrap();
        let StereoCameras::Rectified(camera) = found.cameras else {
            panic!("{found:?}");
        };
        assert_eq!((camera.focal, camera.doffs, found.unit), (3740.0, 0.0, Some(Unit::Millimetre)));
        let e = parse(&format!("{text}dofs = 2\n")).unwrap_err().to_string();
        assert!(e.contains("line 6") && e.contains("doffs"), "{e}");
        let e = parse(&text.replace("160", "-160")).unwrap_err().to_string();
        assert!(e.contains("for baseline, found -160"), "{e}");
        let e = parse("f = 1\n").unwrap_err().to_string();
        assert!(e.contains("missing field `cx`") && e.contains("expected f cx cy baseline"), "{e}");
    }

    #[test]
    fn two_views_are_read_with_their_distortion() {
        let view = "[[view]]\nK = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]\n";
        let text = format!(
            "sigma_disparity_px = 0.2\n{view}distortion = [-0.2, 0.1, 0.001, 0.002]\n{view}t = [-150, 0, 0]\n"
        );
        let StereoCameras::Views(rig) = parse(&text).unwrap().cameras else {
            panic!("not two views");
        };
        assert_eq!(rig.cameras[0].distortion, [-0.2, 0.1, 0.001, 0.002, 0.0]);
        assert_eq!((rig.cameras[1].distortion, rig.sigma_disparity), ([0.0; 5], 0.2));
        assert_eq!(rig.cameras[1].pinhole.center(), DVec3::new(150.0, 0.0, 0.0));
        let e = |text: &str| parse(text).unwrap_err().to_string();
        assert!(e(view).contains("two [[view]], found 1"));
        assert!(e(&text.replace(", 0.002]", "]")).contains("the first view.distortion"));
        let e = e(&text.replace("t = ", "T = "));
        assert!(e.contains("line 7") && e.contains("expected two [[view]] with K"), "{e}");
    }
}
