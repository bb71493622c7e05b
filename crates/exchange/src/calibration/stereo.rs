//! Two cameras: rectified ones, or two views that stand anyhow.
//!
//! ```toml
//! unit = "mm"                 # of the baseline and of the points: mm, m, in or ft; may be left out
//! f = 3740.0                  # focal length of both, in pixels
//! cx = 641.0                  # the pixel of the left image on its axis; centres are at integers
//! cy = 555.0
//! baseline = 160.0            # the distance of the cameras
//! doffs = 0.0                 # cx of the right camera less that of the left; 0 where it is left out
//! sigma_disparity_px = 0.1    # σ beside that of matching, such as of the rectification (default 0)
//! ```
//!
//! ```toml
//! unit = "mm"                 # of lengths
//! sigma_disparity_px = 0.1    # as above
//!
//! [[view]]                    # its pixels get points; x ~ K (R X + t), pixel centres at integers
//! K = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]
//! distortion = [-0.2, 0.05, 0.001, -0.002, 0.0]   # k1 k2 p1 p2 k3; none where it is left out
//!
//! [[view]]                    # R and t may be left out of one: its frame then is the world's
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

/// No picture has so many columns.
const MOST_PIXELS: f64 = 1e7;

/// Two calibrated cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "one a job")]
pub enum StereoCameras {
    /// Whose pictures are rectified.
    Rectified(StereoCamera),
    /// Whose pictures are to be.
    Views(StereoRig),
}

/// Two calibrated cameras, and their unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCalibration {
    /// The cameras.
    pub cameras: StereoCameras,
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
            if !(4..=5).contains(&stated.len()) || stated.iter().any(|k| !k.is_finite()) {
                return Err(Error::input(format!(
                    "needed {name}.distortion = [k1, k2, p1, p2, k3] (k3 may be left out), found {stated:?}"
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
pub fn read_stereo_calibration(path: &Path) -> Result<StereoCalibration> {
    let read = || parse(&read_text(path)?);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<StereoCalibration> {
    let views = text.parse::<toml::Table>().is_ok_and(|t| t.contains_key("view"));
    if views { parse_views(text) } else { parse_rectified(text) }
}

fn check_sigma(sigma: f64) -> Result<()> {
    let needed = "a finite number that is not negative";
    check_numbers(&[("sigma_disparity_px", sigma, sigma >= 0.0, needed)])
}

fn parse_views(text: &str) -> Result<StereoCalibration> {
    let t: ViewsTable = table(
        text,
        "two views need K each, and may have R, t and distortion; beside them there may be \
         sigma_disparity_px and unit",
    )?;
    check_sigma(t.sigma_disparity_px)?;
    let [first, second] = t.view.as_slice() else {
        return Err(Error::input(format!("needed two [[view]], found {}", t.view.len())));
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
        "two rectified cameras need f cx cy baseline, and may have doffs, sigma_disparity_px and unit; \
         others need two [[view]] with K, R and t",
    )?;
    check_numbers(&[
        ("f", t.f, t.f > 0.0 && t.f < MOST_PIXELS, "a finite number of pixels above 0 and below 1e7"),
        ("cx", t.cx, t.cx.abs() < MOST_PIXELS, "a finite number of pixels within ±1e7"),
        ("cy", t.cy, t.cy.abs() < MOST_PIXELS, "a finite number of pixels within ±1e7"),
        (
            "baseline",
            t.baseline,
            t.baseline > 0.0 && t.baseline < 1e12,
            "a finite number above 0 and below 1e12",
        ),
        ("doffs", t.doffs, t.doffs.abs() < MOST_PIXELS, "a finite number of pixels within ±1e7"),
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

    #[test]
    fn cameras_are_read_and_mistakes_are_named() {
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
        assert!(e.contains("missing field `cx`") && e.contains("need f cx cy baseline"), "{e}");
    }

    #[test]
    fn two_views_are_read_with_their_lenses() {
        let view = "[[view]]\nK = [[1200, 0, 320], [0, 1200, 240], [0, 0, 1]]\n";
        let text = format!(
            "sigma_disparity_px = 0.2\n{view}distortion = [-0.2, 0.1, 0.001, 0.002]\n{view}t = [-150, 0, 0]\n"
        );
        let StereoCameras::Views(rig) = parse(&text).unwrap().cameras else {
            panic!("not two views");
        };
        assert_eq!(rig.cameras[0].distortion, [-0.2, 0.1, 0.001, 0.002, 0.0]);
        assert_eq!((rig.cameras[1].distortion, rig.sigma_disparity), ([0.0; 5], 0.2));
        assert_eq!(rig.cameras[1].pinhole.center(), [150.0, 0.0, 0.0]);
        let e = |text: &str| parse(text).unwrap_err().to_string();
        assert!(e(view).contains("two [[view]], found 1"));
        assert!(e(&text.replace(", 0.002]", "]")).contains("the first view.distortion"));
        let e = e(&text.replace("t = ", "T = "));
        assert!(e.contains("line 7") && e.contains("two views need K"), "{e}");
    }
}
