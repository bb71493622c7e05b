//! Arguments of `planish view`.

use crate::args::{CommonArgs, PartName, pixels};
use clap::{Args, ValueEnum, ValueHint};
use planish::view::{CameraAngles, ColourBy, Up};
use std::path::PathBuf;

/// What a picture is coloured by, on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; `--color` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ColourName {
    Sigma,
    Deviation,
    Observed,
    Normal,
    Plain,
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
            ColourName::Level => Self::Field("level"),
            ColourName::MeanCurvature => Self::Field("mean_curvature"),
            ColourName::GaussianCurvature => Self::Field("gaussian_curvature"),
            ColourName::Scan => Self::Field("scan"),
            ColourName::Height => Self::Field("height"),
        }
    }
}

const VIEW_EXAMPLES: &str = "\
Examples:
  planish view examples/data/pebble/truth.ply -o pebble.png --camera 30,20
  planish view part.planish -o part.png --reference examples/data/pebble/truth.ply
  planish view examples/data/pebble/job.toml -o scans.png --color scan
  planish view part.planish

Without -o the page of a report is shown in the browser: this command serves it on this computer alone, until Ctrl-C. Pictures need neither a window
nor a graphics card. Colours of values are those of reports; a legend names the quantity and its unit.";

/// Arguments of `planish view`.
#[derive(Debug, Args)]
#[command(after_help = VIEW_EXAMPLES)]
pub struct ViewArgs {
    /// A saved model (.planish), a mesh (.ply, .obj, .off, .stl, .glb), CAD faces (.step), points, or scans
    /// as `planish fit` reads them
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Write a picture (.png), or the page as a file (.html), in place of showing it
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Option<PathBuf>,

    /// Colour by this (level and curvatures of models, scan and height of points) [default: the deviation
    /// where there is a reference, else σ, else what the file has]
    #[arg(
        long,
        visible_alias = "colour",
        value_name = "WHAT",
        value_enum,
        help_heading = "Picture",
        requires = "output"
    )]
    pub color: Option<ColourName>,
    /// From where: AZIMUTH,ELEVATION in degrees (0,0 is the front, 90,0 the right side), or front, back,
    /// left, right, top, bottom or iso; each maybe with a zoom behind (30,20,1.5)
    #[arg(long, value_name = "CAMERA", value_parser = clap::value_parser!(CameraAngles), allow_hyphen_values = true,
          help_heading = "Picture", requires = "output")]
    pub camera: Option<CameraAngles>,
    /// What is up: x, y, z, -x, -y or -z [default: z, or towards the front of a sheet]
    #[arg(long, value_name = "AXIS", value_parser = clap::value_parser!(Up), allow_hyphen_values = true, help_heading = "Picture",
          requires = "output")]
    pub up: Option<Up>,
    /// Columns and rows [default: 1280x960]
    #[arg(long, value_name = "WxH", value_parser = pixels, help_heading = "Picture", requires = "output")]
    pub size: Option<[usize; 2]>,

    /// Colour a model by its deviations from this mesh or these points, as `planish compare` finds them
    #[arg(long, value_name = "REFERENCE", value_hint = ValueHint::FilePath, help_heading = "Deviations")]
    pub reference: Option<PathBuf>,
    /// Which part of the model is compared
    #[arg(long, value_name = "PART", value_enum, default_value_t = PartName::Measured, help_heading = "Deviations",
          requires = "reference")]
    pub part: PartName,

    /// Port of the page on this computer [default: one that is free]
    #[arg(long, value_name = "PORT", help_heading = "Page", conflicts_with = "output")]
    pub port: Option<u16>,
    /// Open no browser: only say where the page is
    #[arg(long, help_heading = "Page", conflicts_with = "output")]
    pub no_open: bool,

    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}
