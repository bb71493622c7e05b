//! `planish sense stereo`.

use crate::common::{CommonArgs, short_help};
use crate::values::{disparities, pixel_step, positive};
use clap::{Args, ValueHint};
use planish::sense::SenseKind;
use planish::{Error, Result, StereoOptions, StereoPoints};
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish sense stereo left.png right.png --calib cameras.toml -o points.ply
  planish sense stereo left.png right.png --disparities 0..127 -o disparity.tif

Images are .png, .tif, .jpg, .tga, .pgm or .ppm. They are rectified: rows correspond, and x_right = x_left - \
d. The calibration is TOML: f, cx, cy in pixels and baseline, and doffs and sigma_disparity_px unless they \
are 0. It may name the unit.

Images of cameras in general position are rectified first. Their calibration has two [[view]] with K, R and \
t (x ~ K (R X + t)), and distortion = [k1, k2, p1, p2, k3] if the lenses distort. Points are then in the \
frame of R and t, and disparities are those of the rectified images. They are about 0 where the optical axes \
meet, so negative disparities occur, too (--disparities=-64..63).

A .tif or .npy file has the disparity of each pixel of the left image and its σ, or NaN without a match.";

/// Arguments of `planish sense stereo`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish sense stereo left.png right.png --calib cameras.toml -o p.ply"),
          after_long_help = EXAMPLES)]
pub struct StereoArgs {
    /// Left image; its pixels get points
    #[arg(value_name = "LEFT", value_hint = ValueHint::FilePath)]
    left: PathBuf,
    /// Right image
    #[arg(value_name = "RIGHT", value_hint = ValueHint::FilePath)]
    right: PathBuf,
    /// Calibration of the cameras; not needed if only disparities are written
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    calib: Option<PathBuf>,
    /// Write points (.ply) or disparities with σ (.tif, .npy); repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Maximum σ of the disparity of a point [default: unlimited]; σ is large near depth edges
    #[arg(long, value_name = "PIXELS", value_parser = positive, allow_negative_numbers = true)]
    max_sigma: Option<f64>,
    /// Write every Nth row and column; errors of pixels closer than 9 px are correlated
    #[arg(long, value_name = "N", default_value = "1", value_parser = pixel_step)]
    step: usize,
    /// Range of disparities to search, in pixels; memory and time grow with it
    #[arg(long, value_name = "FROM..TO", default_value = "0..127", value_parser = disparities,
          allow_hyphen_values = true, help_heading = "Matching")]
    disparities: [i32; 2],
    /// P1: cost of a disparity change of 1; each differing bit of the census costs 2
    #[arg(
        long,
        value_name = "COST",
        default_value_t = 45,
        help_heading = "Matching",
        hide_short_help = true
    )]
    p1: u16,
    /// P2: cost of a larger disparity change where the brightness is constant
    #[arg(
        long,
        value_name = "COST",
        default_value_t = 300,
        help_heading = "Matching",
        hide_short_help = true
    )]
    p2: u16,
    /// Minimum cost difference of the second-best match, in percent
    #[arg(
        long,
        value_name = "PERCENT",
        default_value_t = 3,
        help_heading = "Matching",
        hide_short_help = true
    )]
    uniqueness: u32,
    /// Maximum difference from the match of the right image, in pixels
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = 1,
        help_heading = "Matching",
        hide_short_help = true
    )]
    left_right: u32,
    /// Remove regions of fewer pixels
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = 100,
        help_heading = "Matching",
        hide_short_help = true
    )]
    speckle: u32,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The job of these arguments.
pub fn kind(args: &StereoArgs) -> Result<SenseKind> {
    let [first, last] = args.disparities;
    // The difference of two i32 can overflow i32.
    let disparities = usize::try_from(i64::from(last) - i64::from(first) + 1);
    let disparities = disparities
        .map_err(|_| Error::input(format!("expected disparities from low to high, found {first}..{last}")))?;
    Ok(SenseKind::Stereo {
        left: args.left.clone(),
        right: args.right.clone(),
        calibration: args.calib.clone(),
        options: StereoOptions {
            // The library counts disparities from the lowest one; on the command line a range is easier to
            // state.
            min_disparity: first,
            disparities,
            small_step: args.p1,
            large_step: args.p2,
            uniqueness: args.uniqueness,
            left_right: args.left_right,
            speckle: args.speckle,
        },
        // Without a limit every pixel with a disparity is kept: a fit weights by σ, so uncertain points do no
        // harm.
        points: StereoPoints { step: args.step, max_sigma_px: args.max_sigma.unwrap_or(f64::INFINITY) },
    })
}
