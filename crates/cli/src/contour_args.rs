//! Arguments of `planish contour` and of the scene that makes readings for it.

use crate::args::{CommonArgs, ReportArgs, length, not_negative, positive, probability, share, whole};
use clap::{Args, ValueEnum, ValueHint};
use planish::contour::{Kind, Shape};
use planish::next::Length;
use std::path::PathBuf;

/// More corners than this are not fitted.
const MOST_CORNERS: usize = 40;

const CONTOUR_EXAMPLES: &str = "\
Examples:
  planish simulate scene readings --shape rectangle --out seen
  planish contour seen/readings.csv --kind auto -o contour.json -o contour.dxf -o contour.svg
  planish contour seen/readings.csv --constrain --snap 0.5mm -o contour.json --graphs graphs.dot
  planish contour rays.csv --kind cylinder --kind box -o shape.json
  planish contour part.png --pixel-size 0.05 --kind circle -o hole.json
  planish contour robot.log.gz --scan 40 --region 0,0,4,3 --gap 0.3 -o room.dxf

Readings are CSV with a header: x,y,heading_deg,range (a pose, its heading counter-clockwise from +x, what the sensor read) and \
optionally sigma_x,sigma_y,sigma_heading_deg,sigma_range,pose_id,time,level; rows of one pose_id share the error of one pose, and each level is a contour of its own. \
Points from overhead are x,y and sigma. Readings in space have x,y,z,azimuth_deg,elevation_deg,range (the azimuth counter-clockwise from +x, the elevation upwards), optionally with \
sigma_x,sigma_y,sigma_z,sigma_azimuth_deg,sigma_elevation_deg,sigma_range; or x,y,z and sigma. Of a picture the readings are its edges, x to the right and y upwards. CARMEN logs (FLASER) are read as they are, in metres. \
The .json holds kind, parameters with σ and covariance, the margin by which the kind was chosen, and all parts and holes.";

/// Arguments of `planish contour`.
#[derive(Debug, Args)]
#[command(after_help = CONTOUR_EXAMPLES)]
pub struct ContourArgs {
    /// CSV of readings, or a CARMEN log, either of which may be compressed by gzip; or a picture (.png, .jpg)
    /// of the thing
    #[arg(value_name = "READINGS", value_hint = ValueHint::FilePath)]
    pub readings: PathBuf,
    /// File to write; may be repeated: .json, .dxf, .svg
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// auto, line, circle, ellipse, rectangle, rounded-rectangle, slot, chain (lines and arcs, closed or
    /// open), regular-polygon-N or polygon-N with N corners; in space plane3, sphere, cylinder, box; may be
    /// repeated: then the best of these
    #[arg(long, value_name = "KIND", default_value = "auto", value_parser = kind)]
    pub kind: Vec<KindChoice>,
    /// How: all readings at once, then the most likely contour where it is not known from which place on it
    /// each is (auto); only all at once (batch); or one after the other, linearised once (ekf), anew in the
    /// state (iekf), anew in state and noise (nuiekf)
    #[arg(long, value_enum, default_value_t = ContourFilter::Auto)]
    pub filter: ContourFilter,
    /// Readings farther than this many σ from the contour are left out; 0 keeps all
    #[arg(long, value_name = "SIGMAS", default_value_t = 4.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub gate: f64,
    /// With batch and the filters, readings nearer to a corner of a rectangle or polygon than this many σ do
    /// not count: which side they are of is not sure; 0 keeps all
    #[arg(long, value_name = "SIGMAS", default_value_t = 2.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub corner_margin: f64,
    /// Readings farther apart than this belong to different parts [default: from their number and extent]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub gap: Option<f64>,
    /// The thing moves while it is measured: its velocity is found from column time, with its turning or
    /// without
    #[arg(long, value_enum, default_value_t = ContourMotion::None)]
    pub motion: ContourMotion,
    /// One equation for all sides (their product) instead of one for the side that was hit
    #[arg(long)]
    pub product: bool,
    /// Find what holds between the parts (parallel, perpendicular, horizontal, equal, tangent, concentric,
    /// ...) by χ² tests on the estimated covariance, and impose it
    #[arg(long, help_heading = "Constraints")]
    pub constrain: bool,
    /// Put lengths and diameters on multiples of this where the statistics allow it and no other multiple
    /// agrees, as `0.5mm`; implies --constrain
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true, help_heading = "Constraints")]
    pub snap: Option<Length>,
    /// What is known beforehand, such as `P1P2 is 40 long` or `P1P2 parallel to P3P4`, in the words and names
    /// of the report; may be repeated
    #[arg(long, value_name = "CONSTRAINT", help_heading = "Constraints")]
    pub given: Vec<String>,
    /// The probability with which relations that are true are lost
    #[arg(long, value_name = "PROBABILITY", default_value_t = planish::contour::DEFAULT_LEVEL, value_parser = probability, allow_negative_numbers = true,
          help_heading = "Constraints")]
    pub level: f64,
    /// Write the graphs of the constraints: .json or .dot (repeatable); implies --constrain
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Constraints")]
    pub graphs: Vec<PathBuf>,
    /// σ of x and y of the sensor, where the file has none [default: known exactly]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensor")]
    pub sigma_position: Option<f64>,
    /// σ of its heading, in degrees [default: known exactly]
    #[arg(long, value_name = "DEGREES", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensor")]
    pub sigma_heading_deg: Option<f64>,
    /// σ of its range [default: of logs 0.03 m; else it must be in the file]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensor")]
    pub sigma_range: Option<f64>,
    /// Side of a pixel, where the file is a picture taken squarely [default: lengths are in pixels]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensor")]
    pub pixel_size: Option<f64>,
    /// σ of points, in x and in y
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensor")]
    pub sigma_point: Option<f64>,
    /// First scan of a log, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole, help_heading = "Logs")]
    pub scan: usize,
    /// How many scans of a log
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole, help_heading = "Logs")]
    pub scans: usize,
    /// Ranges of a log from this to that, in metres; what reads its maximum saw nothing
    #[arg(long, value_name = "FROM,TO", default_value = "0.05,20", value_parser = pair, help_heading = "Logs")]
    pub range_gate: [f64; 2],
    /// Only what a log saw in this box of its map, in metres
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = rectangle, allow_hyphen_values = true, help_heading = "Logs")]
    pub region: Option<[f64; 4]>,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// A kind, or the choice of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum KindChoice {
    /// All kinds.
    Auto,
    /// This one.
    Of(Kind),
    /// A chain of lines and arcs, closed or open.
    Chain,
    /// This one, in space.
    InSpace(Shape),
}

/// How readings are taken in.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; `--filter` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContourFilter {
    Auto,
    Batch,
    Ekf,
    Iekf,
    Nuiekf,
}

/// How the thing moves.
#[allow(missing_docs, reason = "as for `ContourFilter`; `--motion` explains it")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContourMotion {
    None,
    Linear,
    Rigid,
}

const READINGS_EXAMPLES: &str = "\
Examples:
  planish simulate scene readings --shape ellipse --readings 300 --out seen
  planish contour seen/readings.csv -o contour.json

The folder then holds readings.csv, exact.csv (the same without errors) and truth.json (kind and parameters as in contour.json). \
Things are about 100 mm; by default the sensor is 300 mm away, knows its place to 2 mm and its heading to 2°, and reads to 1 %.";

/// Arguments of `planish simulate scene readings`.
#[derive(Debug, Args)]
#[command(after_help = READINGS_EXAMPLES)]
pub struct ReadingsArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// circle, ellipse, rectangle, rounded-rectangle, slot, regular-polygon-N, or polygon-6 (an L)
    #[arg(long, value_name = "KIND", default_value = "rectangle", value_parser = kind)]
    pub shape: KindChoice,
    /// How many readings
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = whole, allow_negative_numbers = true)]
    pub readings: usize,
    /// Readings from each pose; those of one pose share its error
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole, allow_negative_numbers = true)]
    pub sweep: usize,
    /// Errors over the usual ones
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true)]
    pub noise: f64,
    /// Share of readings that are wild
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share, allow_negative_numbers = true)]
    pub outliers: f64,
    /// Velocity of the thing, in lengths and degrees a second; a hundred readings are taken in a second
    #[arg(long, value_name = "VX,VY,DEG", value_parser = triple, allow_hyphen_values = true)]
    pub velocity: Option<[f64; 3]>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const VIEWS_EXAMPLES: &str = "\
Examples:
  planish simulate scene views --out prism
  planish contour prism/front/readings.csv -o front.json
  planish solid front.json top.json side.json -o prism.step -o prism.json

The folders front, top and side then hold readings.csv, exact.csv (the same without errors) and truth.json (as of contour.json); truth.json beside them has \
the prism's vertices. It is 80 mm wide (x), 100 mm deep (y) and 60 mm high (z), its right angle at the origin: the prism of Weiss-Cohen, Bondarenko and Halevi 2009, figure 3. \
The sensor is 300 mm away, knows its place to 0.2 mm and its heading to 0.2°, and reads to 0.1 %.";

/// Arguments of `planish simulate scene views`.
#[derive(Debug, Args)]
#[command(after_help = VIEWS_EXAMPLES)]
pub struct ViewsArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// How many readings of each view
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = whole, allow_negative_numbers = true)]
    pub readings: usize,
    /// Readings from each pose; those of one pose share its error
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole, allow_negative_numbers = true)]
    pub sweep: usize,
    /// Errors over the usual ones
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = positive, allow_negative_numbers = true)]
    pub noise: f64,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn kind(text: &str) -> Result<KindChoice, String> {
    if text == "auto" {
        return Ok(KindChoice::Auto);
    }
    if text == "chain" {
        return Ok(KindChoice::Chain);
    }
    if let Some(shape) = Shape::ALL.into_iter().find(|shape| shape.to_string() == text) {
        return Ok(KindChoice::InSpace(shape));
    }
    Kind::of_name(text, MOST_CORNERS).map(KindChoice::Of).ok_or_else(|| {
        format!(
            "needed auto, line, circle, ellipse, rectangle, rounded-rectangle, slot, chain, regular-polygon-N or polygon-N with N from 3 to {MOST_CORNERS}; \
             or in space plane3, sphere, cylinder, box"
        )
    })
}

fn numbers<const N: usize>(text: &str, example: &str) -> Result<[f64; N], String> {
    let found: Option<Vec<f64>> =
        text.split(',').map(|w| w.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    found
        .and_then(|v| <[f64; N]>::try_from(v).ok())
        .ok_or_else(|| format!("needed {N} numbers, as in {example}"))
}

fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text, "0.05,20")
}

fn triple(text: &str) -> Result<[f64; 3], String> {
    numbers(text, "10,-5,20")
}

fn rectangle(text: &str) -> Result<[f64; 4], String> {
    let [a, b, c, d] = numbers(text, "0,0,4,3")?;
    Ok([f64::min(a, c), f64::min(b, d), f64::max(a, c), f64::max(b, d)])
}
