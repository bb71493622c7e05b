//! Calibration of the lights of photometric stereo.
//!
//! ```toml
//! unit = "mm"                 # unit of pixel_size and of the points (optional)
//! frame = "viewer"            # "viewer": x right, y up, z to the camera; "camera" (default): y down
//! lights = [[0.40, 0.48, 0.78], [-0.33, 0.49, 0.81], [0.03, 0.34, 0.94]]   # directions to the lights
//! pixel_size = 0.2            # side of a pixel on the object (default 1)
//! sigma_brightness = 1.5      # σ of the brightness of a pixel (default: estimated from four lights or more)
//! sigma_light_deg = 1.0       # σ of the directions of the lights, common to all normals (default 0)
//! intensities = [1.0, 0.92, 1.05]   # strength of each light, or [red, green, blue] of each (default 1)
//! saturation = 250            # readings from this value on are saturated (default: found in the images)
//! ```
//!
//! Pictures of a mirror ball, under the same lights in the same order, can replace `lights`:
//!
//! ```toml
//! [ball]
//! images = ["chrome.0.tga", "chrome.1.tga", "chrome.2.tga"]
//! mask = "chrome.mask.tga"    # white inside the ball
//! ```

use planish_core::DVec3;
use std::path::{Path, PathBuf};

use planish_estimate::{Error, Result};
use serde::Deserialize;

use super::{check_numbers, table};
use crate::Unit;
use crate::source::read_text;

/// Source of the directions of the lights.
#[derive(Debug, Clone, PartialEq)]
pub enum LightSource {
    /// Unit vectors towards the lights, in the camera's frame (x right, y down, z away).
    Directions(Vec<[f64; 3]>),
    /// Pictures of a mirror ball.
    Ball {
        /// One picture per light.
        images: Vec<PathBuf>,
        /// Mask that is white inside the ball.
        mask: PathBuf,
    },
}

/// Calibration of the lights.
#[derive(Debug, Clone, PartialEq)]
pub struct LightsCalibration {
    /// Directions of the lights.
    pub source: LightSource,
    /// Side of a pixel on the object.
    pub pixel_size: f64,
    /// σ of the brightness of a pixel, in the scale of the images; none to estimate it.
    pub sigma_brightness: Option<f64>,
    /// σ of the directions of the lights, in degrees.
    pub sigma_light_deg: f64,
    /// Strength of each light in red, green and blue, with a mean of 1; empty if all are equal.
    pub intensities: Vec<[f64; 3]>,
    /// Value from which readings are saturated, if stated.
    pub saturation: Option<f64>,
    /// The unit of lengths, if stated.
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
    #[serde(default)]
    intensities: Vec<Intensity>,
    saturation: Option<f64>,
    ball: Option<Ball>,
}

/// Strength of a light.
#[derive(Deserialize, Clone, Copy)]
#[serde(untagged)]
enum Intensity {
    Grey(f64),
    Colours([f64; 3]),
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

/// Reads the calibration of the lights. Paths of pictures are relative to the file.
///
/// # Errors
/// As [`read_calibration`](super::read_calibration).
///
/// # Examples
/// ```
/// use planish_exchange::calibration::{LightSource, read_lights};
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("lights.toml");
/// std::fs::write(&path, "frame = \"viewer\"\nlights = [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]]\n")?;
/// // The viewer's z points to the camera, the camera's z away from it.
/// let LightSource::Directions(lights) = read_lights(&path)?.source else { panic!("no directions") };
/// assert_eq!(lights[1], [0.6, 0.0, -0.8]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_lights(path: &Path) -> Result<LightsCalibration> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = || parse(&read_text(path)?, folder);
    read().map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str, folder: &Path) -> Result<LightsCalibration> {
    let t: Table = table(
        text,
        "expected `lights` (a direction per image) or [ball] with images and mask, and optionally frame, \
         pixel_size, sigma_brightness, sigma_light_deg, intensities, saturation and unit",
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
        (
            "saturation",
            t.saturation.unwrap_or(1.0),
            t.saturation.is_none_or(|s| s > 0.0),
            "a finite number above 0",
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
    let lights = match &source {
        LightSource::Directions(lights) => lights.len(),
        LightSource::Ball { images, .. } => images.len(),
    };
    Ok(LightsCalibration {
        intensities: intensities(&t.intensities, lights)?,
        saturation: t.saturation,
        source,
        pixel_size: t.pixel_size,
        sigma_brightness: sigma,
        sigma_light_deg: t.sigma_light_deg,
        unit: t.unit.map(|name| name.parse()).transpose()?,
    })
}

fn check_count(found: usize, what: &str) -> Result<()> {
    // Each pixel has three unknowns: the direction of its normal and its albedo.
    match found < 3 {
        true => Err(Error::input(format!("expected at least three {what}, found {found}"))),
        false => Ok(()),
    }
}

/// The strengths with a mean of 1, so that the scale of the images stays.
fn intensities(found: &[Intensity], lights: usize) -> Result<Vec<[f64; 3]>> {
    if found.is_empty() {
        return Ok(Vec::new());
    }
    if found.len() != lights {
        return Err(Error::input(format!(
            "expected one entry of `intensities` per light, found {} and {lights} lights",
            found.len()
        )));
    }
    let colours: Vec<[f64; 3]> = (found.iter())
        .map(|i| match *i {
            Intensity::Grey(i) => [i; 3],
            Intensity::Colours(i) => i,
        })
        .collect();
    if let Some(k) = colours.iter().position(|c| c.iter().any(|i| !(*i > 0.0 && i.is_finite()))) {
        return Err(Error::input(format!(
            "expected finite numbers above 0 in `intensities`, found {:?} for light {k}",
            colours[k]
        )));
    }
    let mean = colours.iter().flatten().sum::<f64>() / (3 * colours.len()) as f64;
    Ok(colours.into_iter().map(|c| c.map(|i| i / mean)).collect())
}

fn directions(lights: &[[f64; 3]], frame: Frame) -> Result<Vec<[f64; 3]>> {
    check_count(lights.len(), "directions in `lights`")?;
    let unit = |(k, light): (usize, &[f64; 3])| {
        DVec3::from_array(*light)
            // Directions of any length are accepted, because only the direction is used.
            .try_normalize()
            .map(|d| d.to_array())
            .map(|[x, y, z]| match frame {
                Frame::Camera => [x, y, z],
                // Half a turn about x.
                Frame::Viewer => [x, -y, -z],
            })
            .ok_or_else(|| {
                Error::input(format!(
                    "expected a direction other than zero for light {k} of `lights`, found {light:?}"
                ))
            })
    };
    lights.iter().enumerate().map(unit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_converted_to_the_camera_frame() {
        let text = "frame = \"viewer\"\nlights = [[0, 0, 2], [0.6, 0, 0.8], [0, 0.6, 0.8]]\n";
        let found = parse(text, Path::new("")).unwrap();
        let LightSource::Directions(lights) = found.source else { panic!("expected directions") };
        assert_eq!(lights[0], [0.0, -0.0, -1.0]);
        assert_eq!(lights[2], [0.0, -0.6, -0.8]);
        assert_eq!((found.pixel_size, found.sigma_brightness), (1.0, None));
    }

    #[test]
    fn intensities_have_a_mean_of_one() {
        let lights = "lights = [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]]\n";
        let found = |text: &str| parse(&format!("{lights}{text}"), Path::new("")).map(|c| c.intensities);
        assert_eq!(found("intensities = [1, 2, 3]").unwrap(), [[0.5; 3], [1.0; 3], [1.5; 3]]);
        let colours = found("intensities = [[1, 2, 3], 2, [3, 2, 1]]").unwrap();
        assert_eq!(colours, [[0.5, 1.0, 1.5], [1.0; 3], [1.5, 1.0, 0.5]]);
        assert_eq!(found("").unwrap(), Vec::<[f64; 3]>::new());
        assert!(found("intensities = [1, 2]").unwrap_err().to_string().contains("found 2 and 3 lights"));
        assert!(found("intensities = [1, 0, 2]").unwrap_err().to_string().contains("for light 1"));
    }

    #[test]
    fn errors_name_line_or_key() {
        let error = |text: &str| parse(text, Path::new("")).unwrap_err().to_string();
        assert!(error("").contains("found neither"));
        assert!(
            error("lights = [[0, 0, 1], [1, 0, 0]]")
                .contains("at least three directions in `lights`, found 2")
        );
        assert!(error("lights = [[0, 0, 1], [1, 0, 0], [0, 0, 0]]").contains("light 2"));
        assert!(error("ligths = 3").contains("line 1"));
        assert!(error("frame = \"up\"").contains("viewer"));
    }
}
