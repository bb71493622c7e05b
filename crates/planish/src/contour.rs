//! `planish contour`: identifies contours measured by a sensor with an uncertain pose.
//!
//! Input: a [`ContourJob`]. Output: a [`ContourReport`], also as JSON, DXF and SVG. Readings are separated by
//! level and by gaps. Several kinds of contour are fitted to each part. Not guaranteed: parts that are closer
//! to each other than neighbouring readings are not separated; use `gap` to set the distance.

mod constrained;
mod lengths;
mod levels;
mod page;
mod parts;
mod picture;
mod report;
mod shape_page;
mod sizes;
mod space;
mod unused;

pub use constrained::{
    ConstrainJob, ConstrainedContour, ConstrainedReport, ImposedConstraint, ReportedDependence,
    ReportedFreedoms, ReportedPoint, ReportedRelation, ReportedSize,
};
pub use levels::{LevelRelation, Relation};
use planish_core::{Finding, FindingCode, Setting};
pub use report::{
    ContourReport, PartReport, ReportedAlternative, ReportedCorner, ReportedValue, ReportedWallErrors,
};

use crate::graphs::{check_graphs_name, write_graphs};
use crate::job::Job;
use crate::report::{ReportOutput, with_page};
use page::contour_page;
use parts::{Part, Parts, parts_of};
pub use planish_contour::constraint::{DEFAULT_LEVEL, SnapOutcome};
pub use planish_contour::planar::{ContourFitOptions, ContourKind, Form, Method, PlanarMotion};
use planish_contour::planar::{ContourReading, ContourTarget};
pub use planish_contour::primitive::PrimitiveKind;
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
pub use planish_exchange::contours::{CarmenOptions, SigmaDefaults};
use planish_exchange::contours::{
    ContourReadings, DrawnContour, contours_svg, read_contour_readings, write_contours_dxf,
    write_contours_svg,
};
use planish_exchange::{Unit, extension, write_atomically};
use sizes::size_labels;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Minimum number of readings of a part. Smaller groups are counted as stray readings: with five and more
/// parameters, several kinds of contour would follow so few points nearly exactly.
const MIN_READINGS: usize = 8;

/// Settings of the job.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourJob {
    /// CSV of readings, a CARMEN log, or a picture (PNG or JPEG) whose edges are the readings.
    pub input: PathBuf,
    /// Kinds to try; empty for all, chains of lines and arcs included, unless `chains` asks for these alone.
    pub kinds: Vec<ContourKind>,
    /// Whether closed and open chains of lines and arcs are tried besides the given kinds.
    pub chains: bool,
    /// Whether the readings are searched for straight walls with gaps instead of contours.
    ///
    /// Without kinds, logs are searched for walls anyway, and so is any part that no contour explains.
    pub walls: bool,
    /// Shapes in space to try, for readings in space; none for contours.
    pub shapes: Vec<PrimitiveKind>,
    /// How to fit.
    pub fit: ContourFitOptions,
    /// σ for files that state none.
    pub sigma: SigmaDefaults,
    /// Selection of the scans of a log.
    pub carmen: CarmenOptions,
    /// Minimum distance between readings of different parts. Default: from the number of readings.
    pub gap: Option<f64>,
    /// `.json`, `.dxf`, `.svg`.
    pub outputs: Vec<PathBuf>,
    /// Constraints between the contours to find and impose.
    pub constrain: ConstrainJob,
    /// Side of a pixel, if the readings are the edges of a picture (default 1).
    pub pixel: Option<f64>,
    /// Unit of lengths if the file states none.
    pub unit: Option<Unit>,
    /// A page that shows the contours or shapes.
    pub report: Option<ReportOutput>,
}

impl Default for ContourJob {
    fn default() -> Self {
        Self {
            input: PathBuf::new(),
            kinds: Vec::new(),
            chains: false,
            walls: false,
            shapes: Vec::new(),
            fit: ContourFitOptions::default(),
            sigma: SigmaDefaults::default(),
            carmen: CarmenOptions::default(),
            gap: None,
            outputs: Vec::new(),
            constrain: ConstrainJob::default(),
            pixel: None,
            unit: None,
            report: None,
        }
    }
}

impl Job for ContourJob {
    type Report = ContourReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.input.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        for output in &self.outputs {
            if !["json", "dxf", "svg"].contains(&extension(output).as_str()) {
                return Err(Error::unsupported(format!(
                    "{}: cannot write this format: expected .json, .dxf or .svg for a contour",
                    output.display()
                )));
            }
        }
        for graphs in &self.constrain.graphs {
            check_graphs_name(graphs)?;
        }
        with_page([&self.outputs[..], &self.constrain.graphs].concat(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ContourReport> {
        match self.shapes.is_empty() {
            true => find_contours(self, progress),
            false if self.constrain.has_task() => Err(Error::unsupported(
                "expected contours in a plane for constraints, rounded lengths and graphs, found shapes in \
                 space",
            )
            .with_setting(Setting::Constrain)
            .with_setting(Setting::Snap)
            .with_setting(Setting::Given)
            .with_setting(Setting::Graphs)),
            false => space::find_shapes(self, progress),
        }
    }
}

/// The kind of readings in the file.
fn readings_of(job: &ContourJob, read: &ContourReadings) -> unused::Readings {
    let is_range = |s: &ContourReading| matches!(s.target, ContourTarget::Range { .. });
    match (picture::is_picture(&job.input), read.in_metres) {
        (true, _) => unused::Readings::Picture,
        (false, true) => unused::Readings::Log,
        (false, false) if read.sightings.iter().any(is_range) => unused::Readings::Ranges,
        (false, false) => unused::Readings::Points,
    }
}

/// Finds planar contours and writes the outputs.
fn find_contours(job: &ContourJob, progress: &dyn Progress) -> Result<ContourReport> {
    progress.check("reading", 0.0)?;
    let mut findings = Vec::new();
    let mut sampling = None;
    let mut read = if picture::is_picture(&job.input) {
        if job.pixel.is_none() {
            findings.push(
                Finding::new(
                    FindingCode::LengthsInPixels,
                    "lengths are in pixels: specify the size of a pixel to get another unit",
                )
                .with_setting(Setting::PixelSize),
            );
        }
        let edges = picture::edges_of(&job.input, job.pixel.unwrap_or(1.0))?;
        sampling = Some(edges.sampling);
        edges.readings
    } else {
        read_contour_readings(&job.input, &job.sigma, &job.carmen)?
    };
    // After reading, because the kind of readings decides which options have an effect.
    unused::refuse_unused(job, readings_of(job, &read))?;
    // Logs are in metres by definition.
    let unit = if read.in_metres { Some(Unit::Metre) } else { job.unit };
    let Parts { mut parts, sigma_range, on_no_wall, wall_errors } =
        parts_of(&mut read, job, progress, &mut findings).map_err(|e| e.in_context(job.input.display()))?;
    if let Some(sampling) = &sampling {
        parts.iter_mut().for_each(|part| sampling.add_to(part, &read.sightings));
    }
    let seen: Vec<_> = parts.iter().map(|part| measured_ends(part, &read.sightings)).collect();
    let mut report = report::report(&read, &parts, &seen, unit, findings);
    report.sigma_range = sigma_range;
    report.readings_on_no_wall = on_no_wall;
    report.wall_errors = wall_errors.map(ReportedWallErrors::from);
    report.samples_per_pixel = sampling.and_then(|sampling| sampling.samples());
    let mut drawn: Vec<DrawnContour> =
        parts.iter().zip(&seen).map(|(part, seen)| drawn(part, *seen)).collect();
    // Constraints come after all contours, because they relate several of them.
    let mut graphs = None;
    if job.constrain.has_task() {
        progress.check("constraining", 0.9)?;
        let found = constrained::constrained(&job.constrain, &parts, &seen, unit)
            .map_err(|e| e.in_context(job.input.display()))?;
        for (contour, (kind, theta)) in drawn.iter_mut().zip(found.drawn) {
            // Drawings show the constrained contours if there are any.
            (contour.kind, contour.theta) = (kind, theta);
        }
        report.findings.extend(found.findings);
        report.constrained = Some(found.report);
        graphs = Some(found.graphs);
    }
    report.findings.extend(report::judge(&report));
    let walls: Vec<DrawnContour> =
        (drawn.iter_mut().zip(&parts)).flat_map(|(wall, part)| spans(wall, part)).collect();
    drawn.extend(walls);
    progress.check(WRITING_STAGE, 0.95)?;
    for output in &job.outputs {
        write(output, &report, &drawn, &parts, &read)?;
    }
    // The cycle is empty if no graphs were made, so nothing is written.
    for (path, graphs) in job.constrain.graphs.iter().zip(graphs.iter().cycle()) {
        write_graphs(path, std::slice::from_ref(graphs), None)?;
    }
    if let Some(page) = &job.report {
        let sizes = size_labels(&report, &drawn);
        let svg = contours_svg(&drawn, &points_of(&parts, &read), &sizes);
        let made = contour_page(&report, &svg, &job.input);
        page.write(made, &[(job.input.clone(), format!("{} readings", read.sightings.len()))])?;
    }
    progress.advance("done", 1.0);
    Ok(report)
}

/// Every reading of each part, and whether it was used.
fn points_of(parts: &[Part], read: &ContourReadings) -> Vec<([f64; 2], bool)> {
    parts
        .iter()
        .flat_map(|part| part.members.iter().zip(&part.choice.fit.used))
        .map(|(&i, &used)| (read.sightings[i].point(), used))
        .collect()
}

/// Ends of the measured part of a line.
fn measured_ends(part: &Part, sightings: &[ContourReading]) -> Option<[[f64; 2]; 2]> {
    let fit = &part.choice.fit;
    if fit.kind != ContourKind::Line {
        return None;
    }
    let theta = fit.state.as_slice();
    let (sin, cos) = theta[0].sin_cos();
    let along = part.members.iter().map(|&i| {
        let p = sightings[i].point();
        cos * p[0] + sin * p[1]
    });
    // A line has no ends. A drawing needs them, so the outermost readings are used.
    let (from, to) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
    Some([from, to].map(|t| [t * cos - theta[1] * sin, t * sin + theta[1] * cos]))
}

/// Draws the first span of a wall as its line, and returns the others.
fn spans(wall: &mut DrawnContour, part: &Part) -> Vec<DrawnContour> {
    let line = wall.theta.clone();
    // The constrained line may differ from the fitted one, on which the spans end.
    let onto = |p: [f64; 2]| {
        let (sin, cos) = line[0].sin_cos();
        let off = cos * p[1] - sin * p[0] - line[1];
        [p[0] + off * sin, p[1] - off * cos]
    };
    let mut each = part.spans.iter().map(|span| DrawnContour { seen: Some(span.map(onto)), ..wall.clone() });
    let Some(first) = each.next() else { return Vec::new() };
    let others = each.collect();
    *wall = first;
    others
}

fn drawn(part: &Part, seen: Option<[[f64; 2]; 2]>) -> DrawnContour {
    let fit = &part.choice.fit;
    // The state may continue with the motion, which is not drawn.
    let (theta, _) = fit.kind.canonical(&fit.state.as_slice()[..fit.kind.parameters()]);
    DrawnContour { kind: fit.kind.clone(), theta, seen }
}

fn write(
    path: &Path,
    report: &ContourReport,
    drawn: &[DrawnContour],
    parts: &[Part],
    read: &ContourReadings,
) -> Result<()> {
    match extension(path).as_str() {
        "dxf" => write_contours_dxf(path, drawn, report.unit),
        "svg" => write_contours_svg(path, drawn, &points_of(parts, read)),
        _ => write_json(path, report),
    }
}

fn write_json(path: &Path, report: &ContourReport) -> Result<()> {
    let text = serde_json::to_string_pretty(report).map_err(|e| {
        Error::io(format!("{}: the contour could not be written as JSON", path.display())).with_source(e)
    })?;
    write_atomically(path, |out| writeln!(out, "{text}"))
}
