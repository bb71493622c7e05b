//! `planish solid`: every solid that two or three views can mean, written as STEP.
//!
//! Input: DXF, SVG or PDF files or pictures, one a view, or one with all views; or contours with their
//! covariance as `planish contour` writes them, one a view. Output: the solids, best first, each a STEP file
//! with true planes and cylinders, or a watertight mesh; and which lines none of them explains. A solid is
//! written only where what it shows in its views agrees with the drawing ([`planish_solid::reprojection`]).

mod drawing;
mod misses;
mod nearby_curves;
mod nearest;
mod noisy;
mod page;
mod relaxed;
mod repaired;
mod search;
mod settings;
mod sheet;
mod silhouette;
mod stacked;
mod writing;

pub use noisy::{NoisyGeometry, ReportedView};
use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode, Length};
use planish_report::numbers::{counted, significant};
pub use repaired::ReportedEdit;
pub use sheet::{ReportedPicture, ReportedPlace, ReportedSheet, SetAsideEntity, ViewPlace};
pub use stacked::{ReportedHeight, ReportedSection, ReportedStack, SectionContour};

use crate::graphs::write_graphs;
use crate::job::Job;
use crate::report::{ReportOutput, with_page};
use page::solid_page;
use planish_core::Progress;
use planish_estimate::{Error, Result};
use planish_exchange::{Unit, extension};
use planish_solid::brep::Solid;
use planish_solid::drawing::View;
pub use planish_solid::noisy_views::{DimensionKind, SpaceDimension, SpaceMatch, SpaceVertex};
use planish_solid::reprojection::Disagreement;
pub use planish_solid::sheet::Projection;
pub use planish_solid::views::ViewKind;
use planish_solid::views::{CandidateRejection, Drawing, Rejected, Solution, Solutions};
use search::{Accuracy, SearchedReading, search_further, search_readings};
use serde::Serialize;
use settings::{check_settings, is_picture};
use sheet::ReadDrawing;
use std::path::PathBuf;

/// Settings of the job.
#[derive(Debug, Clone, PartialEq)]
pub struct SolidJob {
    /// DXF, SVG or PDF files, pictures, or `.json` files of contours, of the front, top and side view, in
    /// this order. The side view is optional. One drawing may contain all views.
    pub views: Vec<PathBuf>,
    /// How the views of one file are placed; found from the sheet if none is given.
    pub projection: Option<Projection>,
    /// The places of the views of one file; found if empty.
    pub places: Vec<ViewPlace>,
    /// For pictures: length of the part per pixel.
    pub scale: Option<f64>,
    /// Kinds of the views. The default is front, top and side.
    pub kinds: Option<Vec<ViewKind>>,
    /// Significance level: the probability that a true relation or match of contours is rejected.
    pub level: f64,
    /// For contours: files for the graphs of each view and the composite graph (`.json`, `.dot`).
    pub graphs: Vec<PathBuf>,
    /// STEP files and meshes (`.ply`, `.stl`, `.glb`, `.obj`) to write. For contours also `.json`: the
    /// dimensions with their σ.
    pub outputs: Vec<PathBuf>,
    /// Maximum chord error of a mesh; [`DEFAULT_CHORD`] times the size of the drawing if none is given.
    pub mesh_tolerance: Option<Length>,
    /// Coordinates of drawings at most this far apart are joined. By default, coordinates are used as drawn.
    pub tolerance: Option<Length>,
    /// Whether all solids are written, as `NAME.1.step`, `NAME.2.step` …
    pub all: bool,
    /// Whether the solid with the least edit of the drawing is written, if no solid explains it as it is.
    pub repair: bool,
    /// Unit if no file states one.
    pub unit: Option<Unit>,
    /// A page that shows the solids side by side, and their views.
    pub report: Option<ReportOutput>,
}

impl Default for SolidJob {
    fn default() -> Self {
        Self {
            views: Vec::new(),
            projection: None,
            places: Vec::new(),
            scale: None,
            kinds: None,
            level: planish_contour::constraint::DEFAULT_LEVEL,
            graphs: Vec::new(),
            outputs: Vec::new(),
            mesh_tolerance: None,
            tolerance: None,
            all: false,
            repair: false,
            unit: None,
            report: None,
        }
    }
}

impl Job for SolidJob {
    type Report = SolidReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(self.views.clone())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        check_settings(self)?;
        with_page([&self.outputs[..], &self.graphs].concat(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<SolidReport> {
        find_solids(self, progress)
    }
}

/// Default chord error of meshes, relative to the size of the drawing. It trades the number of triangles for
/// smoothness; STEP files contain exact surfaces and do not depend on it.
pub const DEFAULT_CHORD: f64 = 5e-4;

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

/// A solid with these views.
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
    /// Cost by which solutions are ranked.
    pub cost: f64,
}

/// A line that no solid explains.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct UnexplainedLine {
    /// `front`, `top` or `side`; `left` where a sheet shows the part from −x.
    pub view: &'static str,
    /// The entity by kind, handle and line of the file; none where a line is missing.
    pub entity: Option<String>,
    /// The problem, and its position in the view.
    #[serde(rename = "why")]
    pub reason: String,
}

/// A solid whose lines differ from those of the drawing. It is not written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RefusedSolid {
    /// Its volume, in the unit to the third power.
    pub volume: f64,
    /// Its faces.
    pub faces: FaceCounts,
    /// The lines in which it differs.
    pub differences: Vec<UnexplainedLine>,
}

/// Candidates that show the lines of the drawing, but are not valid solids. They are not written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DroppedCandidates {
    /// `touches` where parts only touch along a line or at a point, `does_not_close` where faces do not fit
    /// together.
    #[serde(rename = "why")]
    pub reason: &'static str,
    /// Number of candidates.
    pub count: usize,
    /// The problem of the first of them, and its position.
    pub first: String,
}

/// The result of a [`SolidJob`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SolidReport {
    /// Solids, best first.
    pub solutions: Vec<RankedSolid>,
    /// Whether the search was complete, so that no other solid has these views.
    pub complete: bool,
    /// The edits after which the drawing shows a solid, if it shows none as it is and few are enough.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub edits: Vec<ReportedEdit>,
    /// Lines that no solid explains. If there are any, there are no solutions.
    pub unexplained: Vec<UnexplainedLine>,
    /// Solids that were found, but whose views are not the drawing.
    pub refused: Vec<RefusedSolid>,
    /// Candidates that are not solids, by reason.
    pub dropped: Vec<DroppedCandidates>,
    /// For one file with all views: how it was read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sheet: Option<ReportedSheet>,
    /// For contours: how they were matched, and the dimensions of the best solid with σ.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub geometry: Option<NoisyGeometry>,
    /// For contours of several levels: the sections and heights of the solid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stack: Option<ReportedStack>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
    /// The unit of all lengths.
    #[serde(skip)]
    pub unit: Unit,
    /// Files that were written.
    #[serde(skip)]
    pub written: Vec<PathBuf>,
}

/// Reads views, finds solids and writes them. If no solid has these views, the report has no solutions and
/// lists the lines that no solid explains.
fn find_solids(job: &SolidJob, progress: &dyn Progress) -> Result<SolidReport> {
    progress.check("reading", 0.0)?;
    if let Some(sections) = stacked::read(job)? {
        return stacked::solve(job, &sections, progress);
    }
    let mut findings = Vec::new();
    let noisy = match is_contours(job) {
        true => Some(noisy::read(job, &mut findings)?),
        false => None,
    };
    // From here on, contours are exact views: estimation and matching made their coordinates equal, so both
    // inputs share one search.
    let (readings, unit) = match &noisy {
        Some(noisy) => {
            let drawing = noisy.consistent.exact_views()?;
            (vec![ReadDrawing { drawing, ..ReadDrawing::default() }], noisy.unit)
        }
        None => drawing::read(job)?,
    };
    progress.check("searching", 0.1)?;
    let explain = |error: Error, drawing: &Drawing| match &noisy {
        Some(noisy) => noisy.explain(error),
        None => drawing::explain(error, drawing, &job.views),
    };
    let accuracy = accuracy_of(job, noisy.is_some());
    let strict = search_readings(readings.clone(), progress, explain);
    let (searched, edits) = search_further(strict, &readings, accuracy, job.repair, progress)?;
    let SearchedReading {
        reading: ReadDrawing { drawing, sheet, findings: noticed, .. },
        found,
        differences,
        undecided,
    } = searched;
    findings.extend(noticed);
    let (mut accepted, mut refused) = split_by(&differences, &found.solutions);
    if undecided.is_some() {
        refused.splice(..0, accepted.drain(..).map(|solution| refused_solid(solution, &[])));
    }
    let geometry = match (&noisy, accepted.first()) {
        (Some(noisy), Some(best)) => Some(noisy.geometry(&best.solid)?),
        _ => None,
    };
    let is_nearest = findings.iter().any(|finding| finding.code == FindingCode::LinesUnexplained);
    findings.extend(search_incomplete(&found).filter(|_| !is_nearest));
    // Coordinates that nearly agree are the usual reason. In contours, σ has decided already which are equal.
    if accepted.is_empty() && noisy.is_none() && undecided.is_none() {
        findings.extend(drawing::misses(&drawing, &job.views));
    }
    progress.check(planish_core::WRITING_STAGE, 0.9)?;
    // Only the best solid goes to the given name; several would need a number in the name.
    let wanted = if job.all { accepted.len() } else { accepted.len().min(1) };
    let tolerance = job.mesh_tolerance.map_or(DEFAULT_CHORD * drawing.size(), |length| length.in_unit(unit));
    // All files are made in memory before the first is written.
    let best: Vec<&Solid> = accepted[..wanted].iter().map(|solution| &solution.solid).collect();
    let prepared = writing::prepare(job, &best, tolerance)?;
    let (files, written) = writing::write(job, &prepared, unit)?;
    let mut report = SolidReport {
        solutions: ranked(&accepted, &files),
        sheet,
        geometry,
        stack: None,
        complete: found.complete,
        edits,
        unexplained: found
            .unexplained
            .into_iter()
            .map(|u| UnexplainedLine { view: u.view.name(), entity: u.entity, reason: u.reason })
            .collect(),
        refused,
        dropped: dropped(&found.rejected),
        findings,
        unit,
        written,
    };
    // If only refused solids remain, the lines of the best one show where the drawing is inconsistent.
    if let (true, Some(first)) = (report.solutions.is_empty(), report.refused.first()) {
        report.unexplained.extend(first.differences.iter().cloned());
    }
    let draws_hidden = noisy.is_some() || drawing.views.iter().any(View::has_hidden_lines);
    report.findings.extend(judge(&report, drawing.whole_views(), draws_hidden, undecided));
    if let Some(noisy) = &noisy {
        for path in &job.graphs {
            write_graphs(path, &noisy.graphs()?, noisy.composite(&mut report.findings)?.as_ref())?;
            report.written.push(path.clone());
        }
        for path in job.outputs.iter().filter(|output| extension(output) == "json") {
            noisy::write_json(path, &report)?;
            report.written.push(path.clone());
        }
    }
    if let Some(page) = &job.report {
        let solids: Vec<&Solid> = accepted.iter().map(|solution| &solution.solid).collect();
        let made = solid_page(&report, &drawing, &solids, tolerance, &job.views)?;
        page.write(made, &job.views.iter().map(|v| (v.clone(), "views".to_owned())).collect::<Vec<_>>())?;
        report.written.push(page.path.clone());
    }
    Ok(report)
}

/// How accurate the drawing of a job is.
fn accuracy_of(job: &SolidJob, is_measured: bool) -> Accuracy {
    // Contours are consistent within their σ already, and a given tolerance was applied on reading.
    match is_measured || job.tolerance.is_some() {
        true => Accuracy::Consistent,
        false if job.views.iter().any(|path| is_picture(path)) => Accuracy::Traced,
        false => Accuracy::Drawn,
    }
}

/// A finding if the search was cut off. Not an error: the solids that were found are correct.
fn search_incomplete(found: &Solutions) -> Option<Finding> {
    let text = format!(
        "the search was cut off after {}, and there may be more: add a view or hidden lines to distinguish \
         them",
        counted(found.solutions.len(), "solid")
    );
    (!found.complete).then(|| Finding::new(FindingCode::SearchIncomplete, text))
}

/// Splits solutions into those that show exactly the lines of the drawing and those that are refused.
fn split_by<'a>(
    differences: &[Vec<Disagreement>],
    solutions: &'a [Solution],
) -> (Vec<&'a Solution>, Vec<RefusedSolid>) {
    let mut refused = Vec::new();
    let mut accepted: Vec<&Solution> = Vec::new();
    for (solution, differences) in solutions.iter().zip(differences) {
        match differences.is_empty() {
            true => accepted.push(solution),
            false => refused.push(refused_solid(solution, differences)),
        }
    }
    (accepted, refused)
}

fn refused_solid(solution: &Solution, differences: &[Disagreement]) -> RefusedSolid {
    RefusedSolid {
        volume: solution.measures.volume,
        faces: counts(&solution.solid),
        differences: differences.iter().map(line_of).collect(),
    }
}

/// The accepted solids, best first, with the files that they were written to.
fn ranked(accepted: &[&Solution], files: &[Option<String>]) -> Vec<RankedSolid> {
    accepted
        .iter()
        .enumerate()
        .map(|(index, solution)| RankedSolid {
            rank: index + 1,
            // Unless all are requested, only the first solid is written.
            file: files.get(index).cloned().flatten(),
            volume: solution.measures.volume,
            area: solution.measures.area,
            faces: counts(&solution.solid),
            cost: solution.cost,
        })
        .collect()
}

/// The findings that follow from the solids and from the agreement of the views.
fn judge(report: &SolidReport, views: usize, draws_hidden: bool, undecided: Option<String>) -> Vec<Finding> {
    let mut found = Vec::new();
    let has = |code: FindingCode| report.findings.iter().any(|finding| finding.code == code);
    match report.solutions.len() {
        _ if undecided.is_some() => {
            found.extend(undecided.map(|text| Finding::new(FindingCode::SolidsUndecided, text)));
        }
        0 => {
            let text = "no solid explains all lines: the unexplained lines are listed";
            found.push(Finding::new(FindingCode::NoSolid, text));
        }
        // A hole seen from two sides may be round or square, and a bar may be round or flat.
        _ if !report.edits.is_empty() => {}
        // The finding that lists what is unexplained says what the solid is.
        _ if has(FindingCode::LinesUnexplained) => {}
        1 if views < 3 => {
            let text = "one solid of the simplest faces has these views; two views leave open whether what \
                        runs along the missing direction is flat or round: add the third view";
            found.push(Finding::new(FindingCode::TwoViews, text));
        }
        // That finding states already that hidden lines would determine more.
        1 if has(FindingCode::HiddenLinesOmitted) => {}
        1 if report.complete && draws_hidden => {
            let text = "exactly one solid has these views, and its lines are those of the drawing";
            found.push(Finding::new(FindingCode::SolidUnique, text));
        }
        // A pocket that no view sees has no visible line.
        1 if report.complete => {
            let text = "exactly one solid has these views if they omit no hidden lines: none of them draws \
                        any, and what all views hide would be missing";
            found.push(Finding::new(FindingCode::HiddenLinesOmitted, text));
        }
        1 => {}
        n => {
            let text = format!("{n} solids have these views: add a view to distinguish them");
            found.push(Finding::new(FindingCode::SolidsAmbiguous, text));
        }
    }
    // A report must not state that views agree beside the finding that they do not.
    let disagree = has(FindingCode::ViewsInconsistent);
    if let Some(geometry) = report.geometry.as_ref().filter(|_| !disagree) {
        let text = format!(
            "the views agree: χ² {} with {} degrees of freedom (p = {})",
            significant(geometry.chi_square, 3),
            geometry.degrees,
            significant(geometry.p_value, 2)
        );
        found.push(Finding::new(FindingCode::ViewsConsistent, text));
    }
    found
}

/// The kinds of the views, in the order of the files.
fn kinds(job: &SolidJob) -> Vec<ViewKind> {
    job.kinds.clone().unwrap_or_else(|| ViewKind::ALL.to_vec())
}

/// Whether the views are contours with their covariance.
fn is_contours(job: &SolidJob) -> bool {
    job.views.iter().any(|view| extension(view) == "json")
}

/// Rejected candidates by reason, each with the message of the first.
fn dropped(rejected: &[Rejected]) -> Vec<DroppedCandidates> {
    // Fixed order, so that reports can be compared.
    let reasons =
        [(CandidateRejection::Touches, "touches"), (CandidateRejection::DoesNotClose, "does_not_close")];
    let summary = |(rejection, reason): (CandidateRejection, &'static str)| {
        let mut all = rejected.iter().filter(|r| r.reason == rejection);
        all.next().map(|first| DroppedCandidates {
            reason,
            count: 1 + all.count(),
            first: first.message.clone(),
        })
    };
    reasons.into_iter().filter_map(summary).collect()
}

fn line_of(found: &Disagreement) -> UnexplainedLine {
    let more = match found.places.len() {
        0 | 1 => String::new(),
        n => format!(" and at {} more places", n - 1),
    };
    let at = found.places.first().map_or(String::new(), |at| format!(" at {:.4} {:.4}", at[0], at[1]));
    UnexplainedLine {
        view: found.view.name(),
        entity: found.entity.clone(),
        reason: format!("{}{at}{more}", found.difference.reason()),
    }
}

fn counts(solid: &Solid) -> FaceCounts {
    let [plane, cylinder, cone, sphere, torus] = solid.faces_by_kind();
    // Candidates consist of these five kinds only. The key `freeform` stays for programs that read it.
    FaceCounts { plane, cylinder, cone, sphere, torus, freeform: 0 }
}
