//! `planish sense grid`.

use crate::common::{CommonArgs, short_help};
use crate::values::positive;
use clap::{Args, ValueHint};
use planish::GridOptions;
use planish::sense::SenseKind;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene grid --out s --views 1 --size 640x480
  planish sense grid s/stripes-1.png --plain s/plain-1.png --calib s/grid.toml -o normals.ply

The image shows two crossing sets of bright stripes on a darker object. The calibration is TOML: [camera] \
and [projector] with K, R and t (x ~ K (R X + t)), and [stripes] with directions_deg, spacing, origin and \
range in the projector's image; sigma_px is the accuracy of the calibration. Stripes are identified by their \
crossings. They must not be parallel to the line between camera and projector, nor at 45° to it.

Each crossing gives a point with covariance and a normal with sigma_n_deg. If its neighbours are visible, it \
also gives the curvatures k1 k2 with sigma_k; otherwise their direction is 0. Curvatures are computed from \
the points of neighbours. In a job, set kind = \"curvature\" to use normals and curvatures, set kind = \
\"normal\", or fit the points; points and curvatures together would count the same measurements twice. \
Normals and curvatures alone do not determine a position: fit them with points, for example those of `sense \
stereo`.";

/// Arguments of `planish sense grid`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish sense grid stripes.png --calib grid.toml -o normals.ply"),
          after_long_help = EXAMPLES)]
pub struct GridArgs {
    /// Image of the stripes
    #[arg(value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    image: PathBuf,
    /// The same view without stripes; it removes the influence of the object's texture
    ///
    /// The brightness of the stripes is divided by the brightness of this image.
    #[arg(long, value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    plain: Option<PathBuf>,
    /// Calibration of camera, projector and stripes
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    calib: PathBuf,
    /// Write points with normals and curvatures (.ply); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Smoothing scale of the image: about half the width of a stripe
    #[arg(long, value_name = "PIXELS", default_value_t = 1.5, value_parser = positive,
          allow_negative_numbers = true, help_heading = "Stripes")]
    scale: f64,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The job of these arguments.
pub fn kind(args: &GridArgs) -> SenseKind {
    SenseKind::Grid {
        image: args.image.clone(),
        plain: args.plain.clone(),
        calibration: args.calib.clone(),
        // The spacing of the stripes is part of the calibration; only the scale depends on the image.
        options: GridOptions { scale_px: args.scale },
    }
}
