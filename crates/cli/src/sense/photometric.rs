//! `planish sense photometric`.

use crate::common::{CommonArgs, short_help};
use crate::values::positive;
use clap::{Args, ValueHint};
use planish::sense::SenseKind;
use planish::{Error, Result};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish sense photometric a.png b.png c.png d.png --calib lights.toml -o normals.ply
  planish sense photometric normals.png --normal-map 3 -o normals.ply

The calibration is TOML with pixel_size, sigma_brightness, sigma_light_deg, and the lights: `lights` has the \
direction towards each light in the order of the images (x right, y down, z away from the camera; or with \
frame = \"viewer\" y up, z towards it). Alternatively, [ball] has images and mask of a mirror ball. \
`intensities` has the strength of each light, one number or [red, green, blue]. \
Saturated readings are excluded; \
`saturation` states their least value if it is not white.

A point of the .ply file is the position of a normal. Its z is 0 with a σ as large as the image, because \
depth is not measured. A .tif or .npy file has nx, ny, nz and σ in degrees.";

/// Arguments of `planish sense photometric`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish sense photometric a.png b.png c.png --calib l.toml -o n.ply"),
          after_long_help = EXAMPLES)]
pub struct PhotometricArgs {
    /// One image per light, or a normal map
    #[arg(required = true, value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    images: Vec<PathBuf>,
    /// Calibration of the lights
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    calib: Option<PathBuf>,
    /// Image that is white inside the object [default: all pixels that are not dark]
    #[arg(long, value_name = "IMAGE", requires = "calib", value_hint = ValueHint::FilePath)]
    mask: Option<PathBuf>,
    /// The image is a normal map with this σ in degrees
    #[arg(long, value_name = "SIGMA_DEG", conflicts_with = "calib", value_parser = positive,
          allow_negative_numbers = true)]
    normal_map: Option<f64>,
    /// Write normals as points (.ply) or as an image (.tif, .npy); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The job of these arguments.
pub fn kind(args: &PhotometricArgs) -> Result<SenseKind> {
    // clap excludes both options together, but not the absence of both, and it does not count the images.
    match (&args.calib, args.normal_map, &args.images[..]) {
        // The number of images is compared with the lights when the calibration has been read.
        (Some(calibration), None, images) => Ok(SenseKind::Photometric {
            images: images.to_vec(),
            mask: args.mask.clone(),
            calibration: calibration.clone(),
        }),
        (None, Some(sigma_deg), [image]) => Ok(SenseKind::NormalMap { image: image.clone(), sigma_deg }),
        (None, Some(_), images) => Err(Error::input(format!(
            "expected one normal map with --normal-map, found {} images",
            images.len()
        ))),
        _ => Err(Error::input(
            "expected --calib with the lights, or --normal-map with σ of a normal map, found neither",
        )),
    }
}
