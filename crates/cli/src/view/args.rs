//! Arguments of `planish view`.

use crate::common::{CommonArgs, short_help};
use crate::compare::PartName;
use crate::values::pixels;
use clap::{Args, ValueEnum, ValueHint};
use planish::view::{CameraAngles, ColourBy, Up};
use std::path::PathBuf;

// The variants have no doc comments: the names are the quantities, and a doc comment would become help.
/// Value of `--color`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ColourName {
    Sigma,
    Deviation,
    Observed,
    Normal,
    Plain,
    Rgb,
    Level,
    MeanCurvature,
    GaussianCurvature,
    Scan,
    Height,
}

impl From<ColourName> for ColourBy {
    fn from(name: ColourName) -> Self {
        match name {
            ColourName::Sigma => Self::Field("sigma"),
            ColourName::Deviation => Self::Field("deviation"),
            ColourName::Observed => Self::Field("observed"),
            ColourName::Normal => Self::Normal,
            ColourName::Plain => Self::Plain,
            ColourName::Rgb => Self::Field("rgb"),
            ColourName::Level => Self::Field("level"),
            ColourName::MeanCurvature => Self::Field("mean_curvature"),
            ColourName::GaussianCurvature => Self::Field("gaussian_curvature"),
            ColourName::Scan => Self::Field("scan"),
            ColourName::Height => Self::Field("height"),
        }
    }
}

const EXAMPLES: &str = "\
Examples:
  planish view examples/data/pebble/truth.ply -o pebble.png --camera 30,20
  planish view part.planish -o part.png --reference examples/data/pebble/truth.ply
  planish view examples/data/pebble/job.toml -o scans.png --color scan
  planish view part.planish

Without -o, the browser shows an interactive page. The command serves it on this computer only, at a \
secret address, until Ctrl-C. Rendering an image needs neither a window nor a graphics card. Colours are \
those of reports; a legend names the quantity and its unit.";

/// Arguments of `planish view`.
#[derive(Debug, Args)]
#[command(after_help = short_help!("planish view examples/data/pebble/truth.ply -o pebble.png"),
          after_long_help = EXAMPLES)]
pub struct ViewArgs {
    /// Saved model, mesh, CAD faces (.step), points, or scans as for `planish fit`
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Write an image (.png) or the page (.html) instead of opening the browser
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Option<PathBuf>,

    /// Quantity shown by colour [default: deviation if there is a reference, else σ]
    ///
    /// If a file has no σ, another quantity of the file is shown. Models have a level and curvatures; points
    /// have a scan and a height. `rgb` are the colours of the file: the texture of an OBJ or GLB file, or
    /// red, green and blue of the vertices of a PLY file. Pages show a texture by its colours at the
    /// vertices.
    #[arg(
        long,
        // Both spellings: the library writes "colour", and most programs write "color".
        visible_alias = "colour",
        value_name = "WHAT",
        value_enum,
        help_heading = "Image",
        requires = "output"
    )]
    pub color: Option<ColourName>,
    /// View direction: AZIMUTH,ELEVATION in degrees, or front, top, iso, …
    ///
    /// 0,0 is the front and 90,0 the right side. Names are front, back, left, right, top, bottom and iso. A
    /// zoom factor may follow (30,20,1.5).
    // An azimuth may be negative and then looks like an option, hence `allow_hyphen_values`.
    #[arg(long, value_name = "CAMERA", value_parser = clap::value_parser!(CameraAngles),
          allow_hyphen_values = true, help_heading = "Image", requires = "output")]
    pub camera: Option<CameraAngles>,
    /// Upward axis: x, y, z, -x, -y or -z [default: z, or towards the front of a sheet]
    // `-x` looks like an option, hence `allow_hyphen_values`.
    #[arg(long, value_name = "AXIS", value_parser = clap::value_parser!(Up), allow_hyphen_values = true,
          help_heading = "Image", requires = "output", hide_short_help = true)]
    pub up: Option<Up>,
    /// Columns and rows [default: 1280x960]
    #[arg(long, value_name = "WxH", value_parser = pixels, help_heading = "Image", requires = "output")]
    pub size: Option<[usize; 2]>,

    /// Colour a model by its deviations from this mesh or these points
    ///
    /// The deviations are those of `planish compare`.
    #[arg(long, value_name = "REFERENCE", value_hint = ValueHint::FilePath, help_heading = "Deviations")]
    pub reference: Option<PathBuf>,
    /// Part of the model that is compared
    #[arg(long, value_name = "PART", value_enum, default_value_t = PartName::Measured,
          help_heading = "Deviations", requires = "reference", hide_short_help = true)]
    pub part: PartName,

    /// Port of the page on this computer [default: a free port]
    #[arg(
        long,
        value_name = "PORT",
        help_heading = "Page",
        conflicts_with = "output",
        hide_short_help = true
    )]
    pub port: Option<u16>,
    /// Print the address of the page without opening a browser
    #[arg(long, help_heading = "Page", conflicts_with = "output")]
    pub no_open: bool,

    /// Common options.
    #[command(flatten)]
    pub common: CommonArgs,
}
