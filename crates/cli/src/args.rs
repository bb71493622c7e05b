//! The command line, as clap reads it: every option, its unit, its default, and an example that runs.

use crate::contour_args::{ContourArgs, ReadingsArgs, ViewsArgs};
use crate::merge_args::MergeArgs;
use crate::progress::Audience;
use crate::shell_args::ShellArgs;
use crate::shell_scene::ShellSceneArgs;
use crate::view_args::ViewArgs;
use clap::builder::styling::{AnsiColor, Styles};
use clap::{Args, Parser, Subcommand, ValueEnum, ValueHint};
use planish::compare::ComparedPart;
use planish::complete::SymmetryChoice;
use planish::fit::{Filter, ObjectMotion, RefineBy};
use planish::next::Length;
use planish::report::ReportOutput;
use planish::solid::ViewKind;
use planish::{Shape, SymmetryKind, Unit};
use std::path::PathBuf;

/// More threads than this are a slip of the keyboard.
const MOST_THREADS: usize = 1024;

/// More levels than this have cells too small for any reading.
const MOST_DEPTH: u8 = 7;

const STYLES: Styles = Styles::styled()
    .header(AnsiColor::Green.on_default().bold())
    .usage(AnsiColor::Green.on_default().bold())
    .literal(AnsiColor::Cyan.on_default());

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    it ran, but the data do not determine the answer
  2    wrong use or input
  3    a file could not be read or written
  101  a bug in planish
  130  interrupted; nothing was written";

/// From measurements to a 3D model that says how well it is known.
#[derive(Debug, Parser)]
#[command(name = "planish", version, styles = STYLES, arg_required_else_help = true, after_help = EXIT_CODES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The jobs.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Fuse scans into a surface that carries its uncertainty
    Fit(FitArgs),
    /// Measure how far a model lies from a reference, and whether its σ tells the truth
    Compare(CompareArgs),
    /// Turn raw data of a sensor into points that state their covariance
    Sense(SenseArgs),
    /// Say which contour a ranging sensor of uncertain pose saw, with its dimensions and their σ
    Contour(ContourArgs),
    /// Say what a file holds
    Info(InfoArgs),
    /// Merge surface patches that overlap into one whole mesh
    Merge(MergeArgs),
    /// Say where to measure next, so that a model becomes better known
    Next(NextArgs),
    /// Wrap any mesh in an implicit shell and fit it to points and silhouettes
    Shell(ShellArgs),
    /// Turn two or three views of a drawing into solids
    Solid(SolidArgs),
    /// Make measurements whose truth is known
    Simulate(SimulateArgs),
    /// Show a file in the browser, or draw a picture of it
    View(ViewArgs),
    /// Print what a shell needs to complete commands, options and files
    Completions(CompletionsArgs),
    /// Print the manual, or write all of its pages
    Man(ManArgs),
}

/// Options that every command has.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Print one JSON object on stdout, and nothing else there
    #[arg(long)]
    pub json: bool,
    /// Print no summary, no progress and no warnings
    #[arg(long, short)]
    pub quiet: bool,
    /// How far the work is, on stderr: a bar where that is a terminal, one JSON object a line for programs,
    /// or nothing
    #[arg(long, value_name = "HOW", value_enum, default_value_t = ProgressName::Auto)]
    pub progress: ProgressName,
    /// Threads to work with [default: one for each core]; they change the time, never the result
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true)]
    pub threads: Option<usize>,
    /// Seed of every random choice: the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = seed, allow_negative_numbers = true)]
    pub seed: u64,
    /// Unit of lengths where no file names it [default: mm]
    #[arg(long, value_name = "UNIT", value_enum)]
    pub unit: Option<UnitName>,
}

impl CommonArgs {
    /// Who is told how far the work is.
    pub fn audience(&self) -> Audience {
        match self.progress {
            ProgressName::Json => Audience::Program,
            ProgressName::Auto if !self.quiet => Audience::People,
            ProgressName::Auto | ProgressName::None => Audience::Nobody,
        }
    }
}

/// How progress is told.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; `--progress` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgressName {
    Auto,
    Json,
    None,
}

/// The page that shows what a command found.
#[derive(Debug, Clone, Args)]
pub struct ReportArgs {
    /// Write a report: one page of HTML with the result in 3D, how good it is and what to do next
    #[arg(long, value_name = "FILE.html", help_heading = "Common options", value_hint = ValueHint::FilePath)]
    pub report: Option<PathBuf>,
}

impl ReportArgs {
    /// Where the report goes, with the command line that this process was started with.
    pub fn output(&self, common: &CommonArgs) -> Option<ReportOutput> {
        self.report.as_ref().map(|path| ReportOutput {
            path: path.clone(),
            command: command_line(),
            seed: common.seed,
        })
    }

    /// What the summary says of it.
    pub fn written(&self) -> Option<String> {
        (self.report.as_ref()).map(|path| format!("Wrote {}: the report, for any browser", path.display()))
    }
}

/// The command line as a shell takes it.
pub fn command_line() -> String {
    let quoted = |word: String| {
        let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
        if !word.is_empty() && word.chars().all(plain) {
            word
        } else {
            format!("'{}'", word.replace('\'', r"'\''"))
        }
    };
    let words = std::env::args_os().skip(1).map(|word| quoted(word.to_string_lossy().into_owned()));
    std::iter::once("planish".to_owned()).chain(words).collect::<Vec<_>>().join(" ")
}

/// A unit of length on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the units")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UnitName {
    Mm,
    M,
    In,
    Ft,
}

impl From<UnitName> for Unit {
    fn from(name: UnitName) -> Self {
        match name {
            UnitName::Mm => Self::Millimetre,
            UnitName::M => Self::Metre,
            UnitName::In => Self::Inch,
            UnitName::Ft => Self::Foot,
        }
    }
}

/// A topology on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; `--shape` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ShapeName {
    Sheet,
    Tube,
    Ball,
    Torus,
}

impl From<ShapeName> for Shape {
    fn from(name: ShapeName) -> Self {
        match name {
            ShapeName::Sheet => Self::Sheet,
            ShapeName::Tube => Self::Tube,
            ShapeName::Ball => Self::Ball,
            ShapeName::Torus => Self::Torus,
        }
    }
}

/// How a thing moves.
#[allow(missing_docs, reason = "as for `ShapeName`; `--motion` explains it")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MotionName {
    Rigid,
    Bend,
}

impl From<MotionName> for ObjectMotion {
    fn from(name: MotionName) -> Self {
        match name {
            MotionName::Rigid => Self::Rigid,
            MotionName::Bend => Self::Bend,
        }
    }
}

/// How gaps are completed.
#[allow(missing_docs, reason = "as for `ShapeName`; `--complete` explains it")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Completion {
    Smooth,
}

/// A part of a model on the command line.
#[allow(missing_docs, reason = "as for `ShapeName`; `--part` explains them")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PartName {
    Measured,
    Completed,
    Known,
    All,
}

impl From<PartName> for ComparedPart {
    fn from(name: PartName) -> Self {
        match name {
            PartName::Measured => Self::Measured,
            PartName::Completed => Self::Completed,
            PartName::Known => Self::Known,
            PartName::All => Self::All,
        }
    }
}

/// A filter on the command line.
#[allow(missing_docs, reason = "as for `ShapeName`")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FilterName {
    Global,
    Patch,
}

impl From<FilterName> for Filter {
    fn from(name: FilterName) -> Self {
        match name {
            FilterName::Global => Self::Global,
            FilterName::Patch => Self::Patch,
        }
    }
}

/// What asks for subdivision, on the command line.
#[allow(missing_docs, reason = "as for `ShapeName`")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RefineByName {
    Residuals,
    Curvature,
    Both,
    Roughness,
}

impl From<RefineByName> for RefineBy {
    fn from(name: RefineByName) -> Self {
        match name {
            RefineByName::Residuals => Self::Residuals,
            RefineByName::Curvature => Self::Curvature,
            RefineByName::Both => Self::Both,
            RefineByName::Roughness => Self::Roughness,
        }
    }
}

/// A topology of simulated things.
#[allow(missing_docs, reason = "as for `ShapeName`")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SceneShape {
    Sheet,
    Tube,
    Ball,
}

impl From<SceneShape> for Shape {
    fn from(name: SceneShape) -> Self {
        match name {
            SceneShape::Sheet => Self::Sheet,
            SceneShape::Tube => Self::Tube,
            SceneShape::Ball => Self::Ball,
        }
    }
}

const FIT_EXAMPLES: &str = "\
Examples:
  planish fit examples/data/pebble/job.toml -o part.step -o part.ply -o part.planish
  planish fit bun.conf --unit m -o bunny.step
  planish fit today.ply --update part.planish -o newer.planish
  planish fit tile.laz --ground -o ground.tif
  planish fit vessel/job.toml --symmetry rotation:full -o whole.ply
  planish fit examples/data/pebble/job.toml --filter patch --max-depth 3 -o part.planish
  planish fit bending/job.toml --motion bend -o sheet.planish
  planish fit examples/data/pebble/job.toml --animate pebble.glb

Scans are .ply, .pcd, .e57, .las, .laz, .obj, .stl, .glb, .npy, .npz, .xyz, .txt, .asc, .csv or .pts, and depth images .png or .tif with \
the camera's calibration in a .toml of the same name; lists of scans with their poses are .conf (VRIP) or .toml (a job, which also \
names the sensors and their σ). A σ that nobody states is estimated from the data; one that the data contradict is \
reported and replaced. All lengths are in the unit of the files.

Outputs, by extension:
  .step .stp   the exact surface, for CAD programs
  .ply .glb    a mesh; each vertex has its normal, σ along it, and whether it was measured (1), completed (2) or neither (0)
  .obj .stl    a mesh without σ
  .tif .tiff   heights and their σ on a grid, of a sheet over z (GeoTIFF)
  .planish     the model with its covariance, for `compare` and for `fit --update`";

/// Arguments of `planish fit`.
#[derive(Debug, Args)]
#[command(after_help = FIT_EXAMPLES)]
pub struct FitArgs {
    /// Scans (.ply, .pcd, .e57, .xyz, .npy, …) and lists of scans (.conf, .toml)
    #[arg(required = true, value_name = "SCAN", value_hint = ValueHint::FilePath)]
    pub scans: Vec<PathBuf>,
    /// Write the model; the extension says how (.step, .ply, .glb, .obj, .stl, .tif, .planish); may be given
    /// several times
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,

    /// Add the scans to this saved model; its grid stays, its smoothness prior counts once
    #[arg(long, value_name = "MODEL.planish", help_heading = "Surface", value_hint = ValueHint::FilePath,
          conflicts_with_all = ["shape", "tolerance", "max_coefficients", "max_depth"])]
    pub update: Option<PathBuf>,
    /// Topology: a sheet has one border, a tube is open at both ends, a ball is closed, a torus has a hole
    /// through it [default: sheet, tube or ball, as the points say]
    #[arg(long, value_name = "SHAPE", value_enum, help_heading = "Surface")]
    pub shape: Option<ShapeName>,
    /// The columns u and v of the files, in [0, 1], are the readings' parameters: fit a grid of so many cells
    /// to them, in one step (61x61 cells of a sheet have 64x64 control vertices; a sheet unless --shape says
    /// otherwise: balls and tori take 4x4 cells at least; of σ only the column sigma, or one of a sensor; no
    /// more than 3000 readings are held out)
    #[arg(long, value_name = "NxM", value_parser = grid, help_heading = "Surface",
          conflicts_with_all = ["update", "tolerance", "max_coefficients", "max_depth", "refine_by", "filter", "ground"])]
    pub known_uv: Option<[usize; 2]>,
    /// Stop refining where the surface is this close to the points, as a length [default: where only their
    /// noise is left]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true, help_heading = "Surface")]
    pub tolerance: Option<Length>,
    /// How readings are fused: `global` all at once, the most accurate; `patch` one at a time into small
    /// patches, in memory that does not grow with the readings, as the filter of a live sensor would
    #[arg(long, value_name = "FILTER", value_enum, help_heading = "Surface")]
    pub filter: Option<FilterName>,
    /// No more levels of subdivision beyond the base grid than this [default: as many as the readings fill;
    /// of the patch filter 3]
    #[arg(long, value_name = "N", value_parser = depth, allow_negative_numbers = true, help_heading = "Surface")]
    pub max_depth: Option<u8>,
    /// What asks for subdivision: readings that err together where the surface cannot follow them, Gaussian
    /// curvature that varies, sd(K)/max(|K|, σ_K) > 0.5 beyond what σ_K explains, either, or also cells too
    /// wide for the roughness found (true σ for surfaces that are rough at every scale; slower)
    #[arg(long, value_name = "CAUSE", value_enum, default_value_t = RefineByName::Residuals, help_heading = "Surface")]
    pub refine_by: RefineByName,
    /// No more control vertices than this
    #[arg(
        long,
        value_name = "N",
        default_value_t = 12_000, value_parser = coefficients,
        allow_negative_numbers = true,
        help_heading = "Surface"
    )]
    pub max_coefficients: usize,
    /// Most that chords of a mesh leave the surface, as a length [default: half the median σ]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Surface")]
    pub mesh_tolerance: Option<f64>,

    /// Side of the cells of a .tif raster, as a length [default: about the spacing of the readings]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Surface")]
    pub cell_size: Option<f64>,

    /// Fit the bare earth under points from above (z up): leave out what stands on it and is no wider than
    /// WIDTH, as a length [default width: 36 m]; classes of the file that tell the ground are believed
    #[arg(long, value_name = "WIDTH", value_parser = positive, num_args = 0..=1, require_equals = true,
          help_heading = "Readings")]
    #[allow(clippy::option_option, reason = "clap's way of an option whose value is optional")]
    pub ground: Option<Option<f64>>,
    /// Complete what nobody saw by a symmetry whose axis or plane is fitted to the readings: rotation:full (a
    /// surface of revolution), rotation:N, mirror, or auto (the one that the readings bear out, if any). A
    /// coarse direction may follow, as rotation:full:z or mirror:0,1,0.2. Parts known through it alone have
    /// `observed` = 2; measurements overrule
    #[arg(long, value_name = "SYMMETRY", value_parser = symmetry, help_heading = "Completion",
          conflicts_with_all = ["update", "known_uv"])]
    pub symmetry: Option<SymmetryChoice>,

    /// The thing moved while its scans were taken, at the times that the job states (`time`, in seconds).
    /// rigid finds its poses and its velocity; the model is the thing as the first scan met it. bend follows
    /// a sheet that bends without stretch from state to state (scans of one time are one state; without
    /// times, files in order): lengths along it stay, what a scan missed is carried there from other times
    /// (`observed` = 2), and the model is the sheet at the last time; a sheet that stretched is told
    #[arg(long, value_name = "HOW", value_enum, help_heading = "Completion",
          conflicts_with_all = ["update", "known_uv", "ground"])]
    pub motion: Option<MotionName>,
    /// With --motion bend: write the sheet at every time to this folder, as state-1.planish and state-1.ply,
    /// and so on
    #[arg(long, value_name = "DIR", requires = "motion", help_heading = "Completion", value_hint = ValueHint::DirPath)]
    pub states: Option<PathBuf>,
    /// Show the model forming, reading by reading: a .glb file with an animation, or a new folder of pictures
    /// frame_0001.png and so on. Colours are σ, from dark violet (small) to yellow (large); in the pictures
    /// orange dots are the readings so far
    #[arg(long, value_name = "OUT.glb|DIR", conflicts_with_all = ["update", "known_uv", "ground"], value_hint = ValueHint::AnyPath)]
    pub animate: Option<PathBuf>,
    /// Complete gaps by the plane, sphere or cylinder that the readings around them are of, if they are; with
    /// its uncertainty, and that of which it is
    #[arg(long, value_name = "HOW", value_enum, help_heading = "Completion", conflicts_with_all = ["update", "known_uv"])]
    pub complete: Option<Completion>,

    /// Find where the scans stand: every scan but the first may be off by a few percent of the thing's size
    /// and a few degrees. Poses whose σ a job states are part of the answer without this
    #[arg(long, help_heading = "Readings", conflicts_with = "known_uv")]
    pub align: bool,
    /// Set readings aside that lie farther from the surface than this many σ
    #[arg(long, value_name = "SIGMAS", default_value_t = 4.0, value_parser = gate, allow_negative_numbers = true,
          help_heading = "Readings")]
    pub gate: f64,
    /// Share of the readings that takes no part and judges the fit, from 0 to below 0.9
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = held_out, allow_negative_numbers = true,
          help_heading = "Readings")]
    pub held_out: f64,

    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const COMPARE_EXAMPLES: &str = "\
Examples:
  planish compare part.planish examples/data/pebble/truth.ply
  planish compare part.ply other-scan.xyz --unit mm

Deviations are signed: positive where the model lies on the side that the reference's normal points to. Only what the \
model counts as measured is compared (see --part), and nothing beyond an open border. Coverage is the share of the reference's points \
that lie within 1.96 √(σ_model² + σ_reference²): 0.95 where the stated σ is true.";

/// Arguments of `planish compare`.
#[derive(Debug, Args)]
#[command(after_help = COMPARE_EXAMPLES)]
pub struct CompareArgs {
    /// A saved model (.planish), a mesh (.ply, .obj, .stl, .off, .glb), with or without σ, or CAD faces
    /// (.step)
    #[arg(value_name = "MODEL", value_hint = ValueHint::FilePath)]
    pub model: PathBuf,
    /// A mesh, points, or scans as `planish fit` reads them
    #[arg(value_name = "REFERENCE", value_hint = ValueHint::FilePath)]
    pub reference: PathBuf,
    /// Which part of the model is compared: what was measured, what `fit` completed by symmetry or
    /// smoothness, both, or all of it
    #[arg(long, value_name = "PART", value_enum, default_value_t = PartName::Measured)]
    pub part: PartName,
    /// Most that chords leave the model's surface while measuring from it, as a length [default: half the
    /// median σ]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub mesh_tolerance: Option<f64>,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const SOLID_EXAMPLES: &str = "\
Examples:
  planish solid examples/data/bracket/front.dxf examples/data/bracket/top.dxf examples/data/bracket/side.dxf -o bracket.step
  planish solid front.dxf top.dxf -o part.step --all --json
  planish solid sheet.dxf --projection third -o part.step
  planish solid front.svg top.svg side.svg -o part.glb --mesh-tolerance 0.01
  planish solid front.json side.json --as front,side -o part.step -o part.json --graphs graphs.json

The front view is seen from -y and shows x and z, the top view from +z and shows x and y, the side view from +x and shows y and z; all
in one frame, to one scale. On a sheet with all views, each stands apart from the others and in line with the front view, which is found
by that; its left lower corner becomes the origin. Hidden lines are on layers or have line types named HIDDEN or DASHED; centre lines are
left out. Faces are planes along a line of sight and cylinders along an axis; smooth edges may be drawn or not. Of SVG files hidden lines are
dashed, and the left lower corner of each view is its origin. A solid is written only where the lines that it shows are those of the drawing.

Contours that planish contour wrote (.json) are views, too: relations in each are found by χ² tests (or taken from the file, where --constrain or
--given was asked for there), coordinates that views share are matched by χ² and made one geometry by all views' information; a part.json then
holds vertices and sizes in space with σ.";

/// How views are placed on a sheet.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are those of drafting")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProjectionName {
    First,
    Third,
}

/// Arguments of `planish solid`.
#[derive(Debug, Args)]
#[command(after_help = SOLID_EXAMPLES)]
pub struct SolidArgs {
    /// The front, top and side view as drawings (.dxf, .svg) or as contours (.json), in this order; the side
    /// view may be left out. Or one drawing with all views
    #[arg(value_name = "VIEW", value_hint = ValueHint::FilePath, num_args = 1..=3, required = true)]
    pub views: Vec<PathBuf>,
    /// Which views these are, where not front, top and side: such as `front,side`
    #[arg(long = "as", value_name = "VIEWS", value_delimiter = ',', value_enum)]
    pub kinds: Vec<ViewName>,
    /// Of contours: the probability with which relations and matches that are true are lost
    #[arg(long, value_name = "PROBABILITY", default_value_t = planish::contour::DEFAULT_LEVEL, value_parser = probability, allow_negative_numbers = true)]
    pub level: f64,
    /// Of contours: write the graphs of each view's constraints and the composite graph, .json or .dot
    /// (repeatable)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub graphs: Vec<PathBuf>,
    /// Write the best solid: .step or .stp, or its mesh as .ply, .stl, .glb or .obj (repeatable); of contours
    /// also .json, its vertices and sizes with σ
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// How far triangles of a mesh miss the solid at most [default: 1/2000 of the drawing's size]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub mesh_tolerance: Option<f64>,
    /// Coordinates of drawings that are no farther apart than this are one: joins ends that miss each other
    /// by little, and views of nearly one scale
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub tolerance: Option<f64>,
    /// Write every solid that has these views, best first: NAME.1.step, NAME.2.step, ...
    #[arg(long)]
    pub all: bool,
    /// How the views of one file are placed: first angle (Europe, the view from above stands below) or third
    /// angle (America)
    #[arg(long, value_enum, default_value_t = ProjectionName::First)]
    pub projection: ProjectionName,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// A view on the command line.
#[allow(missing_docs, reason = "a doc comment becomes a paragraph of help; the names are the views")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ViewName {
    Front,
    Top,
    Side,
}

impl From<ViewName> for ViewKind {
    fn from(name: ViewName) -> Self {
        match name {
            ViewName::Front => Self::Front,
            ViewName::Top => Self::Top,
            ViewName::Side => Self::Side,
        }
    }
}

const NEXT_EXAMPLES: &str = "\
Examples:
  planish fit examples/data/pebble/job.toml -o pebble.planish
  planish next pebble.planish --count 12 --sigma 0.004mm -o next.csv
  planish next pebble.planish --goal 0.02mm --count 200
  planish next pebble.planish --views 3 --sensor examples/data/camera.toml -o views.toml

Points are chosen one after the other, each the best once those before it are measured. What a reading will do to σ does not depend
on what it will say, so nothing need be measured to know it. What cells are too large to follow of the shape is a part of the σ that `info`
and `fit` state, but no reading makes it smaller, only a fit with smaller cells: it counts neither in σ here nor for --goal, and a warning says how
large it is. The model is one of the global filter: models of patches, and of sheets that bend,
do not keep what is needed.

With --views, poses of a range sensor are chosen in the same way, each with all the readings that it would take from there: in its field of view and range, under no
more than its largest incidence, with nothing of the model in between. The outer side of a surface is the one to which its normals point. A sensor's file:

  unit = \"mm\"
  fov_deg = [40, 30]          # or fx fy cx cy and size = [width, height]
  rays = [320, 240]
  near = 200
  far = 800
  sigma_along = 0.05          # of ranges; and, if you like, sigma_across, sigma_per_range2, sigma_over_cos, max_incidence_deg (60)";

/// Arguments of `planish next`.
#[derive(Debug, Args)]
#[command(after_help = NEXT_EXAMPLES)]
pub struct NextArgs {
    /// A saved model
    #[arg(value_name = "MODEL.planish", value_hint = ValueHint::FilePath)]
    pub model: PathBuf,
    /// Write the points, with normals and σ before and after: .csv or .ply; or the poses: .toml (scans of a
    /// job), .csv or .ply (repeatable)
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// No more points than this
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = some, allow_negative_numbers = true)]
    pub count: usize,
    /// σ of the readings to come, as a length [default: that of the model's best sensor]
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true)]
    pub sigma: Option<Length>,
    /// Judge so many sets of points drawn at random beside the chosen ones
    #[arg(long, value_name = "DRAWS", default_value_t = 0, value_parser = whole, allow_negative_numbers = true, hide_default_value = true)]
    pub against_random: usize,
    /// Propose no more than so many poses of a sensor, instead of points
    #[arg(long, value_name = "N", value_parser = some, allow_negative_numbers = true, requires = "sensor", conflicts_with_all = ["count", "sigma", "against_random"])]
    pub views: Option<usize>,
    /// The sensor's field of view, range and σ, for --views
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath, requires = "views")]
    pub sensor: Option<PathBuf>,
    /// Stop where no σ of the region is larger, as a length; without what cells are too large to follow
    #[arg(long, value_name = "LENGTH", value_parser = length, allow_negative_numbers = true)]
    pub goal: Option<Length>,
    /// Only what lies in this box counts, in the model's unit [default: everything]
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    pub region: Option<[[f64; 3]; 2]>,
    /// Only what was measured already counts
    #[arg(long)]
    pub measured_only: bool,
    /// Make the mean variance small instead of the largest σ
    #[arg(long)]
    pub mean: bool,
    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Arguments of `planish sense`.
#[derive(Debug, Args)]
pub struct SenseArgs {
    /// What sort of sensor.
    #[command(subcommand)]
    pub kind: Sensed,
}

/// The sensors.
#[derive(Debug, Subcommand)]
pub enum Sensed {
    /// Two pictures, matched densely: points with covariance, or disparities with σ
    Stereo(StereoArgs),
    /// A picture of crossed stripes from a projector: points, normals and curvatures, each with σ
    Grid(GridArgs),
    /// Pictures of one view under three lights or more, or a picture of normals: normals with σ
    Photometric(PhotometricArgs),
    /// A depth image: points with covariance
    Depth(DepthArgs),
    /// Views of a thing from a camera that moves around it: points on its occluding contours, and patches of
    /// its surface
    Contours(crate::occluding::OccludingArgs),
}

const STEREO_EXAMPLES: &str = "\
Examples:
  planish sense stereo left.png right.png --calib cameras.toml -o points.ply
  planish sense stereo left.png right.png --disparities 0..127 -o disparity.tif

Pictures are .png, .tif, .jpg, .tga, .pgm or .ppm, rectified: rows correspond, and x_right = x_left - d. The calibration is TOML: \
f cx cy baseline (pixels, and the unit that it may name), and doffs and sigma_disparity_px where they are not 0. \
Pictures of two cameras that stand anyhow are rectified first: their calibration has two [[view]] with K, R and t (x ~ K (R X + t)), and distortion = [k1, k2, p1, p2, k3] \
where the lenses distort. Points are then in the frame of R and t, disparities those of the rectified pictures: about 0 where the axes meet, so look below 0, too (--disparities=-64..63). \
A .tif or .npy holds the disparity of every pixel of the left picture and its σ, NaN where none is believed.";

/// Arguments of `planish sense stereo`.
#[derive(Debug, Args)]
#[command(after_help = STEREO_EXAMPLES)]
pub struct StereoArgs {
    /// The left picture, whose pixels get points
    #[arg(value_name = "LEFT", value_hint = ValueHint::FilePath)]
    pub left: PathBuf,
    /// The right picture
    #[arg(value_name = "RIGHT", value_hint = ValueHint::FilePath)]
    pub right: PathBuf,
    /// Calibration of the two cameras; not needed for disparities alone
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    pub calib: Option<PathBuf>,
    /// Write points (.ply) or disparities with σ (.tif, .npy); may be given several times
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Write no points whose disparity has a larger σ [default: all]; beside depth edges it is large
    #[arg(long, value_name = "PIXELS", value_parser = positive, allow_negative_numbers = true)]
    pub max_sigma: Option<f64>,
    /// Write points of every so manieth column and row: neighbours less than 9 pixels apart err alike
    #[arg(long, value_name = "PIXELS", default_value = "1", value_parser = step)]
    pub step: usize,
    /// Disparities that are looked for, in pixels; memory and time grow with them
    #[arg(long, value_name = "FROM..TO", default_value = "0..127", value_parser = disparities, allow_hyphen_values = true,
          help_heading = "Matching")]
    pub disparities: [i32; 2],
    /// P1: what a disparity that changes by one costs; a bit of the census that differs costs 2
    #[arg(long, value_name = "COST", default_value_t = 45, help_heading = "Matching")]
    pub p1: u16,
    /// P2: what one that changes by more costs, where brightness does not change
    #[arg(long, value_name = "COST", default_value_t = 300, help_heading = "Matching")]
    pub p2: u16,
    /// How many per cent more than the best the next match must cost
    #[arg(long, value_name = "PERCENT", default_value_t = 3, help_heading = "Matching")]
    pub uniqueness: u32,
    /// The match from the right picture may differ by so many pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 1, help_heading = "Matching")]
    pub left_right: u32,
    /// Regions of fewer pixels are left out
    #[arg(long, value_name = "PIXELS", default_value_t = 100, help_heading = "Matching")]
    pub speckle: u32,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const GRID_EXAMPLES: &str = "\
Examples:
  planish simulate scene grid --out s --views 1 --size 640x480
  planish sense grid s/stripes-1.png --plain s/plain-1.png --calib s/grid.toml -o normals.ply

Bright stripes of two sets that cross, on a darker object. The calibration is TOML: [camera] and [projector] with K, R and t (x ~ K (R X + t)), and \
[stripes] with directions_deg, spacing, origin and range in the projector's picture; sigma_px says how well all of that is known. Which stripe is which is found \
from where stripes cross; that takes stripes that do not run along the line between camera and projector, or at 45° to it.
Each crossing gives a point with covariance, a normal with sigma_n_deg, and where its neighbours are seen too the curvatures k1 k2 with sigma_k (else their direction is 0). \
Curvatures are made of the points of neighbours: in a job, say kind = \"curvature\" to use normals and curvatures, or kind = \"normal\", or fit the points; \
points and curvatures together would count the same light twice. Normals and curvatures alone hold no surface in place: fit them with points, as of `sense stereo`.";

/// Arguments of `planish sense grid`.
#[derive(Debug, Args)]
#[command(after_help = GRID_EXAMPLES)]
pub struct GridArgs {
    /// The picture of the stripes
    #[arg(value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    pub image: PathBuf,
    /// The same view under plain light: brightness is divided by its, so that the object's texture moves no
    /// stripe
    #[arg(long, value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    pub plain: Option<PathBuf>,
    /// Calibration of camera, projector and stripes
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    pub calib: PathBuf,
    /// Write points with normals and curvatures (.ply); may be given several times
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Scale that the picture is smoothed with: about half the width of a stripe
    #[arg(long, value_name = "PIXELS", default_value_t = 1.5, value_parser = positive, allow_negative_numbers = true,
          help_heading = "Stripes")]
    pub scale: f64,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const PHOTOMETRIC_EXAMPLES: &str = "\
Examples:
  planish sense photometric a.png b.png c.png d.png --calib lights.toml -o normals.ply
  planish sense photometric normals.png --normal-map 3 -o normals.ply

The calibration is TOML: `lights`, a direction towards each light in the order of the pictures (x right, y down, z away from the camera, or \
frame = \"viewer\": y up, z towards it), or [ball] with images and mask of a mirror ball; and pixel_size, sigma_brightness, sigma_light_deg. \
A point of the .ply says where its normal is; its z is 0 with a σ as large as the picture, because depth is not measured. \
A .tif or .npy holds nx, ny, nz and σ in degrees.";

/// Arguments of `planish sense photometric`.
#[derive(Debug, Args)]
#[command(after_help = PHOTOMETRIC_EXAMPLES)]
pub struct PhotometricArgs {
    /// One picture for each light, or a picture of normals
    #[arg(required = true, value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    pub images: Vec<PathBuf>,
    /// Calibration of the lights
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    pub calib: Option<PathBuf>,
    /// A picture that is white where the object is [default: all that is not dark]
    #[arg(long, value_name = "IMAGE", requires = "calib", value_hint = ValueHint::FilePath)]
    pub mask: Option<PathBuf>,
    /// The picture's colours are normals, with this σ in degrees
    #[arg(long, value_name = "SIGMA_DEG", conflicts_with = "calib", value_parser = positive, allow_negative_numbers = true)]
    pub normal_map: Option<f64>,
    /// Write normals at their pixels (.ply) or as an image (.tif, .npy); may be given several times
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const DEPTH_EXAMPLES: &str = "\
Examples:
  planish sense depth frame.png --calib camera.toml -o points.ply

A depth image is .png of 16 bits, .tif or .npy; the calibration is TOML: fx fy cx cy scale, and sigma_a sigma_b for σ = a + b z². \
Depth is the pixel's number times `scale`, in the calibration's unit: 0.001 where an image holds millimetres and unit = \"m\".";

/// Arguments of `planish sense depth`.
#[derive(Debug, Args)]
#[command(after_help = DEPTH_EXAMPLES)]
pub struct DepthArgs {
    /// The depth image
    #[arg(value_name = "IMAGE", value_hint = ValueHint::FilePath)]
    pub image: PathBuf,
    /// Calibration of the camera [default: the image's name with .toml]
    #[arg(long, value_name = "FILE.toml", value_hint = ValueHint::FilePath)]
    pub calib: Option<PathBuf>,
    /// Write points (.ply); may be given several times
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Vec<PathBuf>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const INFO_EXAMPLES: &str = "\
Examples:
  planish info examples/data/pebble/job.toml
  planish info examples/data/pebble/truth.ply
  planish info part.planish --json

Reads scans, lists of scans, meshes and saved models. Lengths are in the unit of the file.";

/// Arguments of `planish info`.
#[derive(Debug, Args)]
#[command(after_help = INFO_EXAMPLES)]
pub struct InfoArgs {
    /// A scan, a list of scans, a mesh or a saved model
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const COMPLETIONS_EXAMPLES: &str = "\
Examples:
  planish completions bash
  planish completions zsh
  planish completions fish

The script goes to stdout; keep it where the shell looks for such scripts: ~/.local/share/bash-completion/completions/planish, a folder of zsh's
fpath as _planish, or ~/.config/fish/completions/planish.fish.";

/// Arguments of `planish completions`.
#[derive(Debug, Args)]
#[command(after_help = COMPLETIONS_EXAMPLES)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_name = "SHELL", value_enum)]
    pub shell: clap_complete::Shell,
}

const MAN_EXAMPLES: &str = "\
Examples:
  planish man
  planish man --out man1

With --out every command has a page of its own: planish.1, planish-fit.1 and so on. In ~/.local/share/man/man1 the command man finds them.";

/// Arguments of `planish man`.
#[derive(Debug, Args)]
#[command(after_help = MAN_EXAMPLES)]
pub struct ManArgs {
    /// Write all pages into this folder
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: Option<PathBuf>,
}

/// Arguments of `planish simulate`.
#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// What to simulate.
    #[command(subcommand)]
    pub what: Simulated,
}

/// What can be simulated.
#[derive(Debug, Subcommand)]
pub enum Simulated {
    /// A scene: readings for a job, and the truth beside them
    Scene(SceneArgs),
    /// How well a sphere is found again: error over noise, for the patch filter and the global one
    Sphere(SphereArgs),
}

const SPHERE_EXAMPLES: &str = "\
Examples:
  planish simulate sphere -o figure2.svg -o figure2.csv --sets 1 --depth 1
  planish simulate sphere --sets 1 --depth 0 --readings 100 --orientation-deg 5 -o normals.csv

The sphere's front is measured at 50, 100 and 150 places with known parameters, with noise along the normal up to 0 to 12 % of the \
radius; then orientations are added. Curves are means over the sets: the patch filter for every depth of subdivision, the global \
filter, and what the posterior lets expect. With all of its 20 sets and depth 3 it takes some minutes.";

/// Arguments of `planish simulate sphere`.
#[derive(Debug, Args)]
#[command(after_help = SPHERE_EXAMPLES)]
pub struct SphereArgs {
    /// File to write; may be repeated: .svg (the figures), .csv (the numbers)
    #[arg(long, short, value_name = "FILE", required = true, value_hint = ValueHint::FilePath)]
    pub out: Vec<PathBuf>,

    /// Sets of readings that are averaged
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole, allow_negative_numbers = true,
          help_heading = "Sphere")]
    pub sets: usize,
    /// Readings of a set, instead of 50, 100 and 150; may be repeated
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, help_heading = "Sphere")]
    pub readings: Vec<usize>,
    /// The deepest subdivision, from 0 to 4; every depth up to it is computed
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=4),
          allow_negative_numbers = true, help_heading = "Sphere")]
    pub depth: u8,
    /// Divide patches for curvature that varies within its own σ too
    #[arg(long, help_heading = "Sphere")]
    pub noise_divides: bool,
    /// Maximum error of the orientations, in degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 2.0, value_parser = not_negative, allow_negative_numbers = true,
          help_heading = "Sphere")]
    pub orientation_deg: f64,
    /// Show the sphere forming from a cylinder, reading by reading, by the patch filter: a .glb file with an
    /// animation, or a new folder of pictures
    #[arg(long, value_name = "OUT.glb|DIR", help_heading = "Sphere", value_hint = ValueHint::AnyPath)]
    pub animate: Option<PathBuf>,

    /// The report.
    #[command(flatten)]
    pub page: ReportArgs,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Arguments of `planish simulate scene`.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// Which scene.
    #[command(subcommand)]
    pub scene: Scene,
}

/// The scenes.
#[derive(Debug, Subcommand)]
pub enum Scene {
    /// A freeform thing of 100 mm, scanned by several sensors, one of which understates its σ
    Scans(ScansArgs),
    /// Pairs of pictures of a textured thing from several views, for `sense stereo`
    Stereo(PictureArgs),
    /// Pictures of a thing under crossed stripes from the same views, for `sense grid`
    Grid(PictureArgs),
    /// A vessel of revolution, 100 mm high, seen from one side only: what nobody saw follows from its
    /// symmetry
    Vessel(VesselArgs),
    /// A contour of 100 mm, ranged from uncertain poses, for `contour`
    Readings(ReadingsArgs),
    /// The outlines of a triangular prism in three views, ranged from uncertain poses, for `contour` and
    /// `solid`
    Views(ViewsArgs),
    /// A mesh deformed by known controls, as points and masks, for `shell`
    Shell(ShellSceneArgs),
    /// A hyperboloid or a carafe, 100 mm high, as its occluding contours from two motions of a camera, for
    /// `sense contours`
    Contours(crate::occluding::ContoursSceneArgs),
    /// A thing of 100 mm on a turntable, scanned by a laser at known times while it turns
    Turning(TurningArgs),
    /// A sheet of 100 mm x 70 mm that is bent without stretch, scanned in every state, the last scan with a
    /// hole
    Bending(BendingArgs),
}

const PICTURE_EXAMPLES: &str = "\
Examples:
  planish simulate scene stereo --out scene --views 1 --size 640x480
  planish simulate scene grid --out stripes --shape tube --views 1 --size 640x480

The folder then holds the pictures of every view (left-1.png and right-1.png, or stripes-1.png and plain-1.png), their calibration (cameras.toml or grid.toml), \
job.toml with the poses of stereo-1.ply or grid-1.ply and so on, which `planish sense` is to write there, view-1.toml and so on for each view alone, truth.ply and truth.json. \
Both scenes see the same thing from the same places: `planish fit scene/job.toml stripes/job.toml` fuses them.";

/// Arguments of `planish simulate scene stereo` and `grid`.
#[derive(Debug, Args)]
#[command(after_help = PICTURE_EXAMPLES)]
pub struct PictureArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,

    /// The thing: a mesh (.ply, .obj, .stl, .off or .glb) or CAD faces (.step) [default: a freeform of 100
    /// mm]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Scene")]
    pub mesh: Option<PathBuf>,
    /// Smooth subdivisions (Loop) of the mesh, from 0 to 5; what is seen, and truth.ply, is the finer one
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole, allow_negative_numbers = true, requires = "mesh",
          help_heading = "Scene")]
    pub subdivide: usize,
    /// The axis that stands upright
    #[arg(long, value_name = "AXIS", value_enum, default_value_t = Axis::Z, help_heading = "Scene")]
    pub up: Axis,
    /// Topology of the freeform
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = SceneShape::Ball, conflicts_with = "mesh", help_heading = "Scene")]
    pub shape: SceneShape,
    /// Contrast of the thing's texture, from 0 (plain) to below 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.7, value_parser = not_negative, allow_negative_numbers = true,
          help_heading = "Scene")]
    pub texture: f64,
    /// Views around the thing
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = whole, allow_negative_numbers = true, help_heading = "Cameras")]
    pub views: usize,
    /// Columns and rows of the pictures
    #[arg(long, value_name = "NxM", default_value = "960x720", value_parser = pixels, help_heading = "Cameras")]
    pub size: [usize; 2],
    /// σ of a pixel's brightness, of 255
    #[arg(long, value_name = "GREYS", default_value_t = 1.0, value_parser = not_negative, allow_negative_numbers = true,
          help_heading = "Cameras")]
    pub sigma_brightness: f64,
    /// Distance of the stripes, in pixels; `stereo` has none
    #[arg(long, value_name = "PIXELS", default_value_t = 18.0, value_parser = positive, allow_negative_numbers = true,
          help_heading = "Cameras")]
    pub stripe_spacing: f64,

    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// An axis on the command line.
#[allow(missing_docs, reason = "as for `ShapeName`")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Axis {
    X,
    Y,
    Z,
}

const VESSEL_EXAMPLES: &str = "\
Examples:
  planish simulate scene vessel --readings 20000 --out vessel
  planish fit vessel/job.toml --symmetry rotation:full -o vessel.planish
  planish compare vessel.planish vessel/truth.ply --part completed

The folder then holds job.toml (for `planish fit`), laser-1.ply, truth.ply (a mesh of the whole vessel, for `planish compare`) and truth.json.";

/// Arguments of `planish simulate scene vessel`.
#[derive(Debug, Args)]
#[command(after_help = VESSEL_EXAMPLES)]
pub struct VesselArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// Readings, about
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = whole, allow_negative_numbers = true)]
    pub readings: usize,
    /// True σ of the laser along its rays, in --unit; half of it holds across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub sigma: Option<f64>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const TURNING_EXAMPLES: &str = "\
Examples:
  planish simulate scene turning --views 6 --rate 6 --out turning
  planish fit turning/job.toml --motion rigid -o thing.planish
  planish compare thing.planish turning/truth.ply

The folder then holds job.toml (with the time of each scan), a .ply file for each, truth.ply (the thing as the first scan met it) and truth.json (axis and rate).";

/// Arguments of `planish simulate scene turning`.
#[derive(Debug, Args)]
#[command(after_help = TURNING_EXAMPLES)]
pub struct TurningArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// Readings of all scans together, about
    #[arg(long, value_name = "N", default_value_t = 60_000, value_parser = whole, allow_negative_numbers = true)]
    pub readings: usize,
    /// Scans, one a second
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = whole, allow_negative_numbers = true)]
    pub views: usize,
    /// Degrees by which the table turns in a second
    #[arg(long, value_name = "DEG", default_value_t = 6.0, value_parser = positive, allow_negative_numbers = true)]
    pub rate: f64,
    /// True σ of the laser along its rays, in --unit; half of it holds across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub sigma: Option<f64>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const BENDING_EXAMPLES: &str = "\
Examples:
  planish simulate scene bending --states 4 --out bending
  planish fit bending/job.toml --motion bend -o sheet.planish
  planish compare sheet.planish bending/truth.ply
  planish compare sheet.planish bending/truth.ply --part completed

The folder then holds job.toml (with the time of each scan), a .ply file for each, truth.ply (the sheet at the last time), truth-1.ply and so on (at each) and \
truth.json (the formulas). The last scan misses a disc of the sheet, which the others saw. With --stretch the sheet does stretch, and `fit` says so.";

/// Arguments of `planish simulate scene bending`.
#[derive(Debug, Args)]
#[command(after_help = BENDING_EXAMPLES)]
pub struct BendingArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,
    /// Readings of all scans together, about
    #[arg(long, value_name = "N", default_value_t = 40_000, value_parser = whole, allow_negative_numbers = true)]
    pub readings: usize,
    /// States of the sheet, one a second; the first is flat
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = whole, allow_negative_numbers = true)]
    pub states: usize,
    /// Largest share by which lengths along the sheet grow in a bulge, from 0 (it only bends) to 0.2
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true)]
    pub stretch: f64,
    /// True σ of the laser along its rays, in --unit; half of it holds across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    pub sigma: Option<f64>,
    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

const SCANS_EXAMPLES: &str = "\
Examples:
  planish simulate scene scans --out scene
  planish simulate scene scans --shape tube --seed 7 --readings 12000 --outliers 0.05 --out pipe

The folder then holds job.toml (for `planish fit`), a .ply file for each scan, truth.ply (a mesh of the true surface, for \
`planish compare`) and truth.json (the true σ, the outliers, the formula of the surface). The thing is 100 mm long, \
whatever --unit the files are in.";

/// Arguments of `planish simulate scene scans`.
#[derive(Debug, Args)]
#[command(after_help = SCANS_EXAMPLES)]
pub struct ScansArgs {
    /// Folder to write to; made where it is missing
    #[arg(long, short, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub out: PathBuf,

    /// Topology of the surface
    #[arg(long, value_name = "SHAPE", value_enum, default_value_t = SceneShape::Ball, help_heading = "Scene")]
    pub shape: SceneShape,
    /// Readings of all scanners together, about
    #[arg(
        long,
        value_name = "N",
        default_value_t = 100_000, value_parser = whole,
        allow_negative_numbers = true,
        help_heading = "Scene"
    )]
    pub readings: usize,
    /// Triangles of truth.ply, at most [default: half the readings, from 5120 to 80000]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, help_heading = "Scene")]
    pub truth_triangles: Option<usize>,

    /// True σ of the laser along its rays, in --unit; half of it holds across [default: 0.1 mm]
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true, help_heading = "Sensors")]
    pub sigma: Option<f64>,
    /// Views of the laser
    #[arg(
        long,
        value_name = "N",
        default_value_t = 3, value_parser = whole,
        allow_negative_numbers = true,
        help_heading = "Sensors"
    )]
    pub views: usize,
    /// Leave out the old scanner
    #[arg(long, help_heading = "Sensors")]
    pub no_old_scanner: bool,
    /// True σ over stated σ of the old scanner; 1 is honest
    #[arg(long, value_name = "FACTOR", default_value_t = 3.0, value_parser = positive, allow_negative_numbers = true,
          help_heading = "Sensors")]
    pub misstated: f64,
    /// Points of the touch probe; 0 for no probe
    #[arg(
        long,
        value_name = "N",
        default_value_t = 60, value_parser = whole,
        allow_negative_numbers = true,
        help_heading = "Sensors"
    )]
    pub probe_points: usize,
    /// Share of the scanners' readings with a gross error, from 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.01, value_parser = share, allow_negative_numbers = true,
          help_heading = "Sensors")]
    pub outliers: f64,
    /// Growth of σ from the middle of a scanner's field of view to its corners, as a share; each reading then
    /// states its own
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = not_negative, allow_negative_numbers = true,
          help_heading = "Sensors")]
    pub unevenness: f64,
    /// Write plain points instead of organised grids
    #[arg(long, help_heading = "Sensors")]
    pub no_grids: bool,

    /// Options that every command has.
    #[command(flatten)]
    pub common: CommonArgs,
}

fn number(text: &str) -> Result<f64, String> {
    text.parse::<f64>().map_err(|_| "needed a number".to_owned())
}

pub fn within(text: &str, needed: &str, good: impl Fn(f64) -> bool) -> Result<f64, String> {
    match number(text)? {
        value if value.is_finite() && good(value) => Ok(value),
        _ => Err(format!("needed {needed}")),
    }
}

/// A number as its refusal says.
pub fn positive(text: &str) -> Result<f64, String> {
    within(text, "a number above 0", |v| v > 0.0)
}

/// A number as its refusal says.
pub fn not_negative(text: &str) -> Result<f64, String> {
    within(text, "a number that is not below 0", |v| v >= 0.0)
}

/// A number as its refusal says.
pub fn share(text: &str) -> Result<f64, String> {
    within(text, "a share from 0 to 1", |v| (0.0..=1.0).contains(&v))
}

/// A probability between 0 and 1, both excluded.
pub fn probability(text: &str) -> Result<f64, String> {
    within(text, "a probability above 0 and below 1", |v| v > 0.0 && v < 1.0)
}

/// A length above zero, with or without its unit.
pub fn length(text: &str) -> Result<Length, String> {
    let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match text[number.len()..].trim() {
        "" => None,
        name => Some(name.parse::<Unit>().map_err(|e| e.to_string())?),
    };
    let value = positive(number.trim())?;
    Ok(Length { value, unit })
}

/// `auto`, `rotation:ORDER[:DIRECTION]` or `mirror[:DIRECTION]`; a direction is an axis or three numbers.
fn symmetry(text: &str) -> Result<SymmetryChoice, String> {
    const NEEDED: &str = "needed auto, rotation:full, rotation:N (N from 2) or mirror, with a direction after it if you like \
                          (rotation:full:z, mirror:0,1,0.2)";
    let mut parts = text.split(':');
    let kind = parts.next().unwrap_or_default();
    let order = match kind {
        "rotation" => Some(match parts.next().ok_or(NEEDED)? {
            "full" => None,
            number => match number.parse::<u32>() {
                Ok(order) if (2..=1000).contains(&order) => Some(order),
                _ => return Err(format!("{NEEDED}; found the order {number:?}")),
            },
        }),
        _ => None,
    };
    let towards = parts.next().map(direction).transpose()?;
    match (kind, order, parts.next()) {
        ("rotation", Some(order), None) => Ok(SymmetryChoice::Of(SymmetryKind::Rotation { order, towards })),
        ("mirror", None, None) => Ok(SymmetryChoice::Of(SymmetryKind::Mirror { towards })),
        ("auto", None, None) if towards.is_none() => Ok(SymmetryChoice::Auto),
        _ => Err(NEEDED.to_owned()),
    }
}

/// `x`, `y`, `z`, or three numbers with commas.
fn direction(text: &str) -> Result<[f64; 3], String> {
    let needed = || format!("needed a direction: x, y, z or three numbers like 0,0.1,1; found {text:?}");
    match text {
        "x" => return Ok([1.0, 0.0, 0.0]),
        "y" => return Ok([0.0, 1.0, 0.0]),
        "z" => return Ok([0.0, 0.0, 1.0]),
        _ => {}
    }
    let numbers: Vec<f64> =
        (text.split(',').map(|n| n.trim().parse().map_err(|_| needed()))).collect::<Result<_, _>>()?;
    let all: [f64; 3] = numbers.try_into().map_err(|_| needed())?;
    if all.iter().all(|c: &f64| c.is_finite()) && all.iter().any(|c| *c != 0.0) {
        Ok(all)
    } else {
        Err(needed())
    }
}

/// Two opposite corners of a box.
fn corners(text: &str) -> Result<[[f64; 3]; 2], String> {
    let numbers: Option<Vec<f64>> =
        (text.split(',')).map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[a, b, c, d, e, f]) => Ok([[a.min(d), b.min(e), c.min(f)], [a.max(d), b.max(e), c.max(f)]]),
        _ => Err("needed six numbers: two opposite corners, as in 0,0,0,10,10,5".to_owned()),
    }
}

fn held_out(text: &str) -> Result<f64, String> {
    within(text, "a share from 0 to below 0.9", |v| (0.0..0.9).contains(&v))
}

fn gate(text: &str) -> Result<f64, String> {
    within(text, "at least 1 σ (4 is usual)", |v| v >= 1.0)
}

/// A whole number.
pub fn whole(text: &str) -> Result<usize, String> {
    text.parse().map_err(|_| "needed a whole number that is not below 0".to_owned())
}

fn some(text: &str) -> Result<usize, String> {
    match whole(text) {
        Ok(n @ 1..) => Ok(n),
        _ => Err("needed a whole number above 0".to_owned()),
    }
}

fn step(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err("needed a whole number from 1 to 1024".to_owned()),
    }
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("needed a whole number from 0 to {}", u64::MAX))
}

fn grid(text: &str) -> Result<[usize; 2], String> {
    let cells = |part: &str| part.trim().parse::<usize>().ok().filter(|n| (1..=1 << 14).contains(n));
    let parts: Vec<Option<usize>> = text.split(['x', 'X', '×']).map(cells).collect();
    match parts[..] {
        [Some(u), Some(v)] => Ok([u, v]),
        _ => Err("needed cells along u and v, each from 1 to 16384, as in 61x61".to_owned()),
    }
}

/// Columns and rows of a picture.
pub fn pixels(text: &str) -> Result<[usize; 2], String> {
    grid(text).map_err(|_| {
        "needed a size in pixels, columns and rows, each from 1 to 16384, as in 640x480".to_owned()
    })
}

fn disparities(text: &str) -> Result<[i32; 2], String> {
    let ends: Vec<Option<i32>> = text.split("..").map(|end| end.trim().parse().ok()).collect();
    match ends[..] {
        [Some(first), Some(last)] if first < last => Ok([first, last]),
        _ => Err("needed the least and the greatest disparity, as in 0..127".to_owned()),
    }
}

fn depth(text: &str) -> Result<u8, String> {
    match text.parse() {
        Ok(depth) if depth <= MOST_DEPTH => Ok(depth),
        _ => Err(format!("needed a whole number of levels from 0 to {MOST_DEPTH}")),
    }
}

fn coefficients(text: &str) -> Result<usize, String> {
    let least = planish::fit_files::LEAST_COEFFICIENTS;
    match text.parse() {
        Ok(n) if n >= least => Ok(n),
        _ => Err(format!("needed a whole number of at least {least}")),
    }
}

fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(threads @ 1..=MOST_THREADS) => Ok(threads),
        _ => Err(format!("needed a whole number from 1 to {MOST_THREADS}")),
    }
}

#[cfg(test)]
mod tests {
    use super::Cli;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_does_not_contradict_itself() {
        Cli::command().debug_assert();
    }
}
