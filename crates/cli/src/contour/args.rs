//! Arguments of `planish contour`.

use super::values::{KindChoice, kind, pair, rectangle};
use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::values::{count, length, not_negative, positive, probability};
use clap::{Args, ValueEnum, ValueHint};
use planish::Length;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish simulate scene readings --shape rectangle --out seen
  planish contour seen/readings.csv --kind auto -o contour.json -o contour.dxf -o contour.svg
  planish contour seen/readings.csv --constrain --snap 0.5mm -o contour.json --graphs graphs.dot
  planish contour rays.csv --kind cylinder --kind box -o shape.json
  planish contour part.png --pixel-size 0.05 --kind circle -o hole.json
  planish contour robot.log.gz --scan 40 --region 0,0,4,3 --gap 0.3 -o room.dxf

Readings are CSV files with a header:
  ranges in the plane   x,y,heading_deg,range; optional sigma_x,sigma_y,sigma_heading_deg,
                        sigma_range,pose_id,time,level
  points in the plane   x,y,sigma
  ranges in space       x,y,z,azimuth_deg,elevation_deg,range; optional sigma_x,sigma_y,sigma_z,
                        sigma_azimuth_deg,sigma_elevation_deg,sigma_range
  points in space       x,y,z,sigma
Headings and azimuths are counter-clockwise from +x, elevations upwards. Rows with the same pose_id share \
one pose error. Each level is a separate contour. The readings of an image are its edges, with x to the \
right and y upwards. CARMEN logs (FLASER) are in metres.

The .json output has the kind, the parameters with σ and covariance, the margin by which the kind was \
chosen, and all parts and holes.";

/// Arguments of `planish contour`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish contour seen/readings.csv -o contour.dxf"),
          after_long_help = EXAMPLES)]
pub struct ContourArgs {
    /// CSV of readings, CARMEN log (either may be gzipped), or image of the object
    #[arg(value_name = "READINGS", value_hint = ValueHint::FilePath)]
    pub readings: PathBuf,
    /// Output file: .json, .dxf or .svg; repeatable
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Kind of the contour; repeatable: the best of the given kinds is chosen
    ///
    /// Kinds are auto, line, circle, ellipse, rectangle, rounded-rectangle, slot, chain (lines and arcs,
    /// closed or open), walls (straight walls with gaps, as of a room), regular-polygon-N and polygon-N
    /// with N corners; in space plane3, sphere, cylinder and box.
    // A custom parser instead of a value enum, because some kinds contain a number of corners.
    #[arg(long, value_name = "KIND", default_value = "auto", value_parser = kind,
          help_heading = "Estimation")]
    pub kind: Vec<KindChoice>,
    /// Estimation method
    #[arg(long, value_enum, default_value_t = ContourFilter::Auto, hide_short_help = true,
          help_heading = "Estimation")]
    pub filter: ContourFilter,
    /// Reject readings more than this many σ from the contour (0: none)
    // 0 switches the gate off: an option with a default cannot be left out.
    #[arg(long, value_name = "SIGMAS", default_value_t = 4.0, value_parser = not_negative,
          allow_negative_numbers = true, help_heading = "Estimation")]
    pub gate: f64,
    /// Ignore readings within this many σ of a corner; 0 keeps all
    ///
    /// Near a corner it is uncertain which side was hit. Applies to rectangles and polygons, for `batch` and
    /// the filters.
    // Assigning such readings to the nearer side would make the object grow
    // (docs/decisions/0052-readings-near-corners.md).
    #[arg(long, value_name = "SIGMAS", default_value_t = 2.0, value_parser = not_negative,
          allow_negative_numbers = true, hide_short_help = true, help_heading = "Estimation")]
    pub corner_margin: f64,
    /// Minimum distance between different parts [default: from the number of readings and their extent]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          hide_short_help = true, help_heading = "Estimation")]
    pub gap: Option<f64>,
    /// Motion of the object; its velocity is estimated from the column `time`
    #[arg(long, value_enum, default_value_t = ContourMotion::None, hide_short_help = true,
          help_heading = "Estimation")]
    pub motion: ContourMotion,
    /// Use one equation for all sides (their product) instead of the equation of the side that was hit
    #[arg(long, hide_short_help = true, help_heading = "Estimation")]
    pub product: bool,
    /// Find relations between parts by χ² tests and impose them
    ///
    /// Relations are parallel, perpendicular, horizontal, equal, tangent, concentric and others. The tests
    /// use the estimated covariance.
    #[arg(long, help_heading = "Constraints")]
    pub constrain: bool,
    /// Snap lengths and diameters to multiples of this, as `0.5mm`; implies --constrain
    ///
    /// A dimension is snapped if the statistics allow exactly one multiple.
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Constraints")]
    pub snap: Option<Length>,
    /// A known constraint, such as `P1P2 is 40 long`; repeatable
    ///
    /// Constraints use the phrases and names of the report, as in `P1P2 parallel to P3P4`.
    // Any text: the phrases need the names of the parts, which are known only after the fit.
    #[arg(long, value_name = "CONSTRAINT", help_heading = "Constraints")]
    pub given: Vec<String>,
    /// Probability that a true relation is rejected
    #[arg(long, value_name = "PROBABILITY", default_value_t = planish::contour::DEFAULT_LEVEL,
          value_parser = probability, allow_negative_numbers = true, help_heading = "Constraints",
          hide_short_help = true)]
    pub level: f64,
    /// Write the constraint graphs: .json or .dot; repeatable; implies --constrain
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Constraints",
          hide_short_help = true)]
    pub graphs: Vec<PathBuf>,
    /// σ of the sensor's x and y if the file has none [default: exact]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensor", hide_short_help = true)]
    pub sigma_position: Option<f64>,
    /// σ of the sensor's heading, in degrees [default: exact]
    #[arg(long, value_name = "DEGREES", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensor", hide_short_help = true)]
    pub sigma_heading_deg: Option<f64>,
    /// σ of ranges if the file has none [default for logs: 0.03 m]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensor")]
    pub sigma_range: Option<f64>,
    /// Side of a pixel of an image taken perpendicularly [default: lengths are in pixels]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensor", hide_short_help = true)]
    pub pixel_size: Option<f64>,
    /// σ of points, in x and in y
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensor", hide_short_help = true)]
    pub sigma_point: Option<f64>,
    /// First scan of a log, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = count, help_heading = "Logs",
          hide_short_help = true)]
    pub scan: usize,
    /// Number of scans of a log
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = count, help_heading = "Logs",
          hide_short_help = true)]
    pub scans: usize,
    /// Minimum and maximum range of a log, in metres; longer ranges have hit nothing
    // Logs are in metres, so the default differs in unit from other lengths.
    #[arg(long, value_name = "FROM,TO", default_value = "0.05,20", value_parser = pair, help_heading = "Logs",
          hide_short_help = true)]
    pub range_gate: [f64; 2],
    /// Consider only this box of the map of a log, in metres
    #[arg(long, value_name = "X0,Y0,X1,Y1", value_parser = rectangle, allow_hyphen_values = true,
          help_heading = "Logs", hide_short_help = true)]
    pub region: Option<[f64; 4]>,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Value of `--filter`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContourFilter {
    /// All readings at once, then the maximum likelihood contour with unknown hit points
    Auto,
    /// All readings at once
    Batch,
    /// Extended Kalman filter
    Ekf,
    /// Iterated extended Kalman filter: relinearised in the state
    Iekf,
    /// Noise-updated iterated filter: relinearised in state and noise
    Nuiekf,
}

/// Value of `--motion`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ContourMotion {
    /// The object does not move
    None,
    /// Constant velocity without rotation
    Linear,
    /// Constant velocity and rotation
    Rigid,
}
