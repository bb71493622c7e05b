//! Lights of photometric stereo.
//!
//! ```toml
//! unit = "mm"                 # of pixel_size and of the points; may be left out
//! frame = "viewer"            # "viewer": x right, y up, z to the camera; "camera" (default): y down
//! lights = [[0.40, 0.48, 0.78], [-0.33, 0.49, 0.81], [0.03, 0.34, 0.94]]   # towards the lights
//! pixel_size = 0.2            # side of a pixel on the object; 1 where it is left out
//! sigma_brightness = 1.5      # σ of a pixel's brightness (default: estimated from four lights)
//! sigma_light_deg = 1.0       # σ of the lights' directions, which all normals share; 0 where it is left out
//! ```
//!
//! Instead of `lights` there may be pictures of a mirror ball, under the same lights in the same order:
//!
//! ```toml
//! [ball]
//! images = ["chrome.0.tga", "chrome.1.tga", "chrome.2.tga"]
//! mask = "chrome.mask.tga"    # white where the ball is
//! ```

use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Where the directions of the lights come from.
#[derive(Debug, Clone, PartialEq)]
pub enum LightSource {
    /// Unit vectors towards the lights, in the camera's frame (x right, y down, z away).
    Directions(Vec<[f64; 3]>),
    /// Pictures of a mirror ball.
    Ball {
        /// One for each light.
        images: Vec<PathBuf>,
        /// White where the ball is.
        mask: PathBuf,
    },
}

/// What is known of the lights.
#[derive(Debug, Clone, PartialEq)]
pub struct LightsCalibration {
    /// Their directions.
    pub source: LightSource,
    /// Side of a pixel on the object.
    pub pixel_size: f64,
    /// σ of a pixel's brightness, in the images' scale; none where it is to be estimated.
    pub sigma_brightness: Option<f64>,
    /// σ of the lights' directions, in degrees.
    pub sigma_light_deg: f64,
    /// The unit of lengths, where it is named.
    pub unit: Option<Unit>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    unit: Option<String>,
    #[serde(default)]
    frame: Frame,
    lights: Option<Vec<[f64; 3]>>,
    #[serde(default = "super::one")]
    pixel_size: f64,
    sigma_brightness: Option<f64>,
    #[serde(default)]
    sigma_light_deg: f64,
    ball: Option<Ball>,
}

#[derive(Deserialize, Default, Clone, Copy)]
#[serde(rename_all = "lowercase")]
enum Frame {
    #[default]
    Camera,
    Viewer,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Ball {
    images: Vec<PathBuf>,
    mask: PathBuf,
}

/// Reads what is known of the lights. Pictures are looked for beside the file.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
pub fn read_lights(path: &Path) -> Result<LightsCalibration> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = || parse(&read_text(path)?, folder);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str, folder: &Path) -> Result<LightsCalibration> {
    let t: Table = table(
        text,
        "lights need `lights` (a direction for each image) or [ball] with images and mask, and may have \
         frame, pixel_size, sigma_brightness, sigma_light_deg and unit",
    )?;
    let sigma = t.sigma_brightness;
    check_numbers(&[
        ("pixel_size", t.pixel_size, t.pixel_size > 0.0, "a finite number above 0"),
        ("sigma_brightness", sigma.unwrap_or(1.0), sigma.is_none_or(|s| s > 0.0), "a finite number above 0"),
        (
            "sigma_light_deg",
            t.sigma_light_deg,
            (0.0..90.0).contains(&t.sigma_light_deg),
            "an angle from 0 to less than 90 degrees",
        ),
    ])?;
    let source = match (t.lights, t.ball) {
        (Some(lights), None) => LightSource::Directions(directions(&lights, t.frame)?),
        (None, Some(ball)) => {
            check_count(ball.images.len(), "images of the ball")?;
            LightSource::Ball {
                images: ball.images.iter().map(|p| folder.join(p)).collect(),
                mask: folder.join(ball.mask),
            }
        }
        (found, _) => {
            let found = if found.is_some() { "both" } else { "neither" };
            return Err(Error::input(format!("expected `lights` or [ball], found {found}")));
        }
    };
    Ok(LightsCalibration {
        source,
        pixel_size: t.pixel_size,
        sigma_brightness: sigma,
        sigma_light_deg: t.sigma_light_deg,
        unit: t.unit.map(|name| name.parse()).transpose()?,
    })
}

fn check_count(found: usize, what: &str) -> Result<()> {
    match found < 3 {
        true => Err(Error::input(format!("expected three {what} or more, found {found}"))),
        false => Ok(()),
    }
}

fn directions(lights: &[[f64; 3]], frame: Frame) -> Result<Vec<[f64; 3]>> {
    check_count(lights.len(), "directions in `lights`")?;
    let unit = |(k, light): (usize, &[f64; 3])| {
        planish_estimate::vector3::unit(*light)
            .map(|[x, y, z]| match frame {
                Frame::Camera => [x, y, z],
                Frame::Viewer => [x, -y, -z],
            })
            .ok_or_else(|| {
                Error::input(format!("expected a direction for light {k} of `lights`, found {light:?}"))
            })
    };
    lights.iter().enumerate().map(unit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_turned_into_the_cameras_frame() {
        let text = "frame = \"viewer\"\nlights = [[0, 0, 2], [0.6, 0, 0.8], [0, 0.6, 0.8]]\n";
        let found = parse(text, Path::new("")).unwrap();
        let LightSource::Directions(lights) = found.source else { panic!("expected directions") };
        assert_eq!(lights[0], [0.0, -0.0, -1.0]);
        assert_eq!(lights[2], [0.0, -0.6, -0.8]);
        assert_eq!((found.pixel_size, found.sigma_brightness), (1.0, None));
    }

    #[test]
    fn mistakes_are_named() {
        let error = |text: &str| parse(text, Path::new("")).unwrap_err().to_string();
        assert!(error("").contains("found neither"));
        assert!(
            error("lights = [[0, 0, 1], [1, 0, 0]]")
                .contains("three directions in `lights` or more, found 2")
        );
        assert!(error("lights = [[0, 0, 1], [1, 0, 0], [0, 0, 0]]").contains("light 2"));
        assert!(error("ligths = 3").contains("line 1"));
        assert!(error("frame = \"up\"").contains("viewer"));
    }
}
