//! `planish solid`: every solid that two or three views can mean, written as STEP.
//!
//! Comes in: DXF files, one a view, or one with all views; or contours with their covariance as `planish contour` writes them, one a view. Goes out: the solids, best first, each a STEP file with true planes and cylinders; and which lines none of
//! them explains.

mod noisy;

pub use noisy::{NoisyGeometry, ReportedView};

use crate::graphs::{check_graphs_name, write_graphs};
use crate::output::refuse_input_as_output;
use crate::progress::Progress;
use planish_estimate::{Error, Result};
use planish_exchange::dxf::read_dxf;
use planish_exchange::step::{StepOptions, write_solid};
use planish_exchange::{Unit, check_writable, extension};
use planish_solid::brep::Solid;
pub use planish_solid::noisy_views::{DimensionKind, SpaceDimension, SpaceMatch, SpaceVertex};
use planish_solid::views::{Drawing, View, solve, views_of_sheet};
pub use planish_solid::views::{Projection, ViewKind};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Vertices, edges and faces of a STEP file meet within this share of a millimetre.
const UNCERTAINTY_MM: f64 = 1e-5;

/// What to do.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidJob {
    /// DXF files, or `.json` files of contours, of the front, top and side view, in this order; the side view may be left out. One DXF file holds all views.
    pub views: Vec<PathBuf>,
    /// How the views of one file are placed.
    pub projection: Projection,
    /// Which views these are, where not front, top and side.
    pub kinds: Option<Vec<ViewKind>>,
    /// The probability with which true relations and matches of contours fail.
    pub level: f64,
    /// Of contours, the graphs of each view and the composite graph: `.json`, `.dot`.
    pub graphs: Vec<PathBuf>,
    /// STEP files to write; of contours also `.json`, what is known of the sizes.
    pub outputs: Vec<PathBuf>,
    /// Whether all solids are written, as `NAME.1.step`, `NAME.2.step` …
    pub all: bool,
    /// The unit where no file names it.
    pub unit: Option<Unit>,
}

/// Faces by the kind of their surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct FaceCounts {
    /// Planes.
    pub plane: usize,
    /// Cylinders.
    pub cylinder: usize,
    /// Cones.
    pub cone: usize,
    /// Spheres.
    pub sphere: usize,
    /// Tori.
    pub torus: usize,
    /// All others.
    pub freeform: usize,
}

/// A solid that the views can mean.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RankedSolid {
    /// From 1, best first.
    pub rank: usize,
    /// The first file that it was written to.
    pub file: Option<String>,
    /// Its volume, in the unit to the third power.
    pub volume: f64,
    /// The area of its faces.
    pub area: f64,
    /// Its faces.
    pub faces: FaceCounts,
    /// What it is ranked by.
    pub cost: f64,
}

/// A line that no solid explains.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct UnexplainedLine {
    /// `front`, `top` or `side`; `left` where a sheet shows the part from −x.
    pub view: &'static str,
    /// The entity by kind, handle and line of the file; none where a line is missing.
    pub entity: Option<String>,
    /// What is wrong, and where in the view.
    pub why: String,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolidReport {
    /// Solids, best first.
    pub solutions: Vec<RankedSolid>,
    /// Whether there are no others.
    pub complete: bool,
    /// Lines that no solid explains: where there are any, there are no solutions.
    pub unexplained: Vec<UnexplainedLine>,
    /// Of contours, how they were matched, and the best solid's sizes with σ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geometry: Option<NoisyGeometry>,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// The unit of all lengths.
    #[serde(skip)]
    pub unit: Unit,
    /// Files that were written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
}

/// Reads views, finds solids, writes them.
///
/// # Errors
/// `Input` for files that are no drawings, views of other extents, or too few; `Undetermined` where all lines can be explained, but no boundary
/// closes; `Io` for file trouble. That no solid has these views is an answer: no solutions, and the lines that none explains.
pub fn solid_files(job: &SolidJob, progress: &dyn Progress) -> Result<SolidReport> {
    plan(job)?;
    progress.check("reading", 0.0)?;
    let mut warnings = Vec::new();
    let noisy = match is_contours(job) {
        true => Some(noisy::read(job, &mut warnings)?),
        false => None,
    };
    let (drawing, unit) = match &noisy {
        Some(noisy) => (noisy.consistent.exact_views()?, noisy.unit),
        None => read(job, &mut warnings)?,
    };
    progress.check("searching", 0.1)?;
    let found = solve(&drawing).map_err(|e| match &noisy {
        Some(noisy) => noisy.explain(e),
        None => e,
    })?;
    let geometry = match (&noisy, found.solutions.first()) {
        (Some(noisy), Some(best)) => Some(noisy.geometry(&best.solid)?),
        _ => None,
    };
    if !found.complete {
        warnings.push(format!(
            "there may be more solids than the {} that were looked at: a further view or hidden lines would tell them apart",
            found.solutions.len()
        ));
    }
    let mut solutions = Vec::new();
    let mut written = Vec::new();
    for (index, solution) in found.solutions.iter().enumerate() {
        progress.check(crate::progress::WRITING_STAGE, 0.9)?;
        let mut file = None;
        let solids = job.outputs.iter().filter(|output| extension(output) != "json");
        for output in solids.filter(|_| index == 0 || job.all) {
            let path = if job.all {
                numbered(output, index + 1)
            } else {
                output.clone()
            };
            write_solid(&path, &solution.solid, &options(output, unit))?;
            file.get_or_insert(path.display().to_string());
            written.push(path);
        }
        solutions.push(RankedSolid {
            rank: index + 1,
            file,
            volume: solution.measures.volume,
            area: solution.measures.area,
            faces: counts(&solution.solid),
            cost: solution.cost,
        });
    }
    let mut report = SolidReport {
        solutions,
        geometry,
        complete: found.complete,
        unexplained: found
            .unexplained
            .into_iter()
            .map(|u| UnexplainedLine {
                view: u.view.name(),
                entity: u.entity,
                why: u.why,
            })
            .collect(),
        warnings,
        unit,
        written,
    };
    if let Some(noisy) = &noisy {
        for path in &job.graphs {
            write_graphs(path, &noisy.graphs()?, noisy.composite(&mut report.warnings)?.as_ref())?;
            report.written.push(path.clone());
        }
        for path in job.outputs.iter().filter(|output| extension(output) == "json") {
            noisy::write_json(path, &report)?;
            report.written.push(path.clone());
        }
    }
    Ok(report)
}

/// Which views the files are.
fn kinds(job: &SolidJob) -> Vec<ViewKind> {
    job.kinds.clone().unwrap_or_else(|| ViewKind::ALL.to_vec())
}

/// Whether the views are contours with their covariance.
fn is_contours(job: &SolidJob) -> bool {
    job.views.iter().any(|view| extension(view) == "json")
}

fn options(output: &Path, unit: Unit) -> StepOptions {
    StepOptions {
        name: output.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        unit,
        uncertainty: UNCERTAINTY_MM / unit.millimetres(),
        ..StepOptions::default()
    }
}

fn counts(solid: &Solid) -> FaceCounts {
    let [plane, cylinder, cone, sphere, torus] = solid.faces_by_kind();
    FaceCounts {
        plane,
        cylinder,
        cone,
        sphere,
        torus,
        freeform: 0,
    }
}

/// `part.step` becomes `part.2.step`.
fn numbered(path: &Path, rank: usize) -> PathBuf {
    path.with_extension(format!("{rank}.{}", extension(path)))
}

fn plan(job: &SolidJob) -> Result<()> {
    if !(1..=3).contains(&job.views.len()) {
        return Err(Error::input(format!(
            "needed DXF files of the front, top and side view, in this order (the side may be left out), or one file with all of them, found {}",
            job.views.len()
        )));
    }
    if let Some(kinds) = &job.kinds {
        let repeated = kinds.iter().enumerate().find(|(i, kind)| kinds[..*i].contains(kind));
        if kinds.len() != job.views.len() || repeated.is_some() {
            let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            return Err(Error::input(format!(
                "needed one name for each of the {} views, each once, found {}",
                job.views.len(),
                names.join(",")
            )));
        }
    }
    if let Some(drawn) = job.views.iter().find(|view| extension(view) != "json")
        && is_contours(job)
    {
        return Err(Error::input(format!(
            "{}: is no contour (.json), as other views are: needed all views of one sort, for an exact drawing has no σ to match by",
            drawn.display()
        )));
    }
    for graphs in &job.graphs {
        if !is_contours(job) {
            return Err(Error::input(format!(
                "{}: graphs are made of contours with their covariance (.json), not of drawings",
                graphs.display()
            )));
        }
        check_graphs_name(graphs)?;
        refuse_input_as_output(graphs, &job.views)?;
        check_writable(graphs)?;
    }
    for output in &job.outputs {
        let may_be_json = is_contours(job) && extension(output) == "json";
        if !may_be_json && !matches!(extension(output).as_str(), "step" | "stp") {
            let json = if is_contours(job) {
                ", what is known of their sizes as .json"
            } else {
                ""
            };
            return Err(Error::unsupported(format!(
                "{}: solids are written as .step or .stp{json}",
                output.display()
            )));
        }
        refuse_input_as_output(output, &job.views)?;
        check_writable(output)?;
    }
    Ok(())
}

fn read(job: &SolidJob, warnings: &mut Vec<String>) -> Result<(Drawing, Unit)> {
    let mut drawing = Drawing::default();
    let mut unit = None;
    for (path, kind) in job.views.iter().zip(kinds(job)) {
        let found = read_dxf(path)?;
        let name = path.display();
        if found.curves.is_empty() {
            return Err(Error::input(format!(
                "{name}: needed lines, arcs or circles of {}, found none",
                match job.views.len() {
                    1 => "two or three views".to_owned(),
                    _ => format!("the {} view", kind.name()),
                }
            )));
        }
        if let (Some(a), Some(b)) = (unit, found.unit)
            && a != b
        {
            return Err(Error::input(format!(
                "{name}: is in {b}, and a view before it in {a}: needed one unit"
            )));
        }
        unit = unit.or(found.unit);
        for (kind, count) in &found.passed_over {
            warnings.push(format!("{name}: passed over {count} of {kind}: it draws no edges"));
        }
        warnings.extend(found.warnings.iter().map(|w| format!("{name}: {w}")));
        drawing.views.push(View {
            kind,
            curves: found.curves,
        });
    }
    if let [path] = &job.views[..] {
        let curves = drawing.views.pop().map(|v| v.curves).unwrap_or_default();
        drawing = views_of_sheet(&curves, job.projection).map_err(|e| e.in_context(path.display().to_string()))?;
    }
    check_extents(&drawing, &job.views)?;
    Ok((drawing, unit.or(job.unit).unwrap_or(Unit::Millimetre)))
}

/// Views that share an axis must span the same range of it.
fn check_extents(drawing: &Drawing, paths: &[PathBuf]) -> Result<()> {
    let mut seen: [Option<([f64; 2], usize)>; 3] = [None; 3];
    for (index, view) in drawing.views.iter().enumerate() {
        for k in 0..2 {
            let axis = view.kind.axes()[k];
            let mut range = [f64::MAX, f64::MIN];
            let mut ends = ["", ""];
            for drawn in &view.curves {
                for p in drawn.curve.points() {
                    if p[k] < range[0] {
                        (range[0], ends[0]) = (p[k], &drawn.entity);
                    }
                    if p[k] > range[1] {
                        (range[1], ends[1]) = (p[k], &drawn.entity);
                    }
                }
            }
            let Some((first, other)) = seen[axis] else {
                seen[axis] = Some((range, index));
                continue;
            };
            let size = (first[1] - first[0]).max(range[1] - range[0]);
            if let Some(end) = (0..2).find(|e| (first[*e] - range[*e]).abs() > 2e-3 * size) {
                return Err(Error::input(format!(
                    "{}: {} reaches {} = {:.6}, but the {} view ({}) ends at {:.6}: needed views of one scale in one frame",
                    paths[index.min(paths.len() - 1)].display(),
                    ends[end],
                    ["x", "y", "z"][axis],
                    range[end],
                    drawing.views[other].kind.name(),
                    paths[other.min(paths.len() - 1)].display(),
                    first[end]
                )));
            }
        }
    }
    Ok(())
}
