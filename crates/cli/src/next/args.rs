//! Arguments of `planish next`.

use crate::common::{CommonArgs, ReportArgs, short_help};
use crate::values::{corners, count, length, positive_count};
use clap::{Args, ValueHint};
use planish::Length;
use std::path::PathBuf;

const EXAMPLES: &str = "\
Examples:
  planish fit examples/data/pebble/job.toml -o pebble.planish
  planish next pebble.planish --count 12 --sigma 0.004mm -o next.csv
  planish next pebble.planish --goal 0.02mm --count 200
  planish next pebble.planish --views 3 --sensor examples/data/camera.toml -o views.toml

Points are chosen one after the other; each is the best one, given that the previous ones are measured. The \
effect of a reading on σ does not depend on its value, so it can be computed in advance.

σ as reported by `info` and `fit` includes unresolved shape, which readings do not reduce; only a fit with \
smaller cells does. Here it counts neither in σ nor for --goal; a warning reports its size. The model must \
come from the global filter. Models of patches and of bending sheets lack the necessary covariance.

With --views, poses of a range sensor are chosen in the same way. A pose gets all readings in the field of \
view and range, up to the maximum incidence angle, that the model does not occlude. Normals point to the
outer side of the surface. The file of the sensor:

  unit = \"mm\"
  fov_deg = [40, 30]          # or fx fy cx cy and size = [width, height]
  rays = [320, 240]
  near = 200
  far = 800
  sigma_along = 0.05          # of ranges; optional: sigma_across, sigma_per_range2, sigma_over_cos,
                              # max_incidence_deg (60)";

/// Arguments of `planish next`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish next pebble.planish --count 12 -o next.csv"),
          after_long_help = EXAMPLES)]
pub struct NextArgs {
    /// Saved model
    #[arg(value_name = "MODEL.planish", value_hint = ValueHint::FilePath)]
    pub model: PathBuf,
    /// Output file: points (.csv, .ply) or poses (.toml, .csv, .ply); repeatable
    ///
    /// Points have their normals and σ before and after. A .toml file holds poses as the scans of a job.
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Maximum number of points
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = positive_count,
          allow_negative_numbers = true)]
    pub count: usize,
    /// σ of the planned readings, as a length [default: that of the model's best sensor]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true)]
    pub sigma: Option<Length>,
    /// Compare the chosen points with this many random sets of points
    #[arg(long, value_name = "DRAWS", default_value_t = 0, value_parser = count,
          allow_negative_numbers = true, hide_default_value = true, hide_short_help = true,
          help_heading = "Criterion")]
    pub against_random: usize,
    /// Propose at most this many poses of a sensor instead of points
    // Poses take their σ from the sensor's file, and only points are compared with random sets.
    #[arg(long, value_name = "N", value_parser = positive_count, allow_negative_numbers = true,
          requires = "sensor", conflicts_with_all = ["count", "sigma", "against_random"],
          help_heading = "Sensor poses")]
    pub views: Option<usize>,
    /// With --views: field of view, range and σ of the sensor
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath, requires = "views",
          help_heading = "Sensor poses")]
    pub sensor: Option<PathBuf>,
    /// Stop when the largest σ of the region is at most this length
    ///
    /// Unresolved shape does not count.
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true,
          help_heading = "Criterion")]
    pub goal: Option<Length>,
    /// Consider only this box, in the model's unit [default: everything]
    // The first coordinate may be negative and then looks like an option, hence `allow_hyphen_values`.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true,
          hide_short_help = true, help_heading = "Criterion")]
    pub region: Option<[[f64; 3]; 2]>,
    /// Consider only parts that are already measured
    #[arg(long, hide_short_help = true, help_heading = "Criterion")]
    pub measured_only: bool,
    /// Minimise the mean variance instead of the largest σ
    #[arg(long, hide_short_help = true, help_heading = "Criterion")]
    pub mean: bool,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}
