//! `planish sense depth`.

use crate::common::{CommonArgs, short_help};
use clap::{Args, ValueHint};
use planish::sense::SenseKind;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish sense depth frame.png --calib camera.toml -o points.ply

A depth image is a 16-bit .png, .tif or .npy file. The calibration is TOML: fx fy cx cy scale, and sigma_a
sigma_b for σ = a + b z². Depth is the value of the pixel times `scale`, in the unit of the calibration:
0.001 if the image has millimetres and unit = \"m\".";

/// Arguments of `planish sense depth`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish sense depth frame.png --calib camera.toml -o points.ply"),
          after_long_help = EXAMPLES)]
pub struct DepthArgs {
    /// Depth image
    #[arg(value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    image: PathBuf,
    /// Calibration of the camera [default: name of the image with .toml]
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    calib: Option<PathBuf>,
    /// Write points (.ply); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The job of these arguments.
pub fn kind(args: &DepthArgs) -> SenseKind {
    // Without a calibration the library looks for one beside the image, as `fit` does for depth images.
    SenseKind::Depth { image: args.image.clone(), calibration: args.calib.clone() }
}
