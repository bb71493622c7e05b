//! Contours with their covariance as views: read, constrained, matched, made one geometry; its sizes with σ.

use super::{SolidJob, SolidReport};
use crate::graphs::GraphsOfView;
use planish_contour::constraint::{
    ConstrainOptions, Constraint, ParametricDrawing, constrain, diagnose, dimension_scheme, sigma,
};
use planish_contour::graph::{Composite, SketchView, SpaceAxis, composite};
use planish_contour::sketch::Sketch;
use planish_core::{Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::contours::read_contour_json;
use planish_exchange::{Unit, write_atomically};
use planish_solid::brep::Solid;
use planish_solid::noisy_views::{
    ConsistentViews, MatchOptions, NoisyView, SpaceDimension, SpaceMatch, SpaceVertex, match_views,
};
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A view and its constraints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedView {
    /// `front`, `top` or `side`.
    pub view: &'static str,
    /// The file it was read from.
    pub file: String,
    /// Its contours by kind.
    pub contours: Vec<String>,
    /// Its constraints as text, without those of the contour kinds.
    pub constraints: Vec<String>,
    /// Whether the constraints come from the file. Otherwise they were found by tests.
    pub constraints_of_file: bool,
    /// Number of dimensions that determine the view together with the constraints.
    pub parameters: usize,
    /// The rank of constraints and dimensions at a witness.
    pub rank: usize,
}

/// The consistent geometry of noisy views, with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoisyGeometry {
    /// The views.
    pub views: Vec<ReportedView>,
    /// Coordinates of the views that are equal.
    pub matches: Vec<SpaceMatch>,
    /// χ² of the agreement between the views.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// Probability of a χ² at least as large.
    pub p_value: f64,
    /// The best solid's vertices.
    pub vertices: Vec<SpaceVertex>,
    /// Its sizes.
    pub dimensions: Vec<SpaceDimension>,
}

/// Views that were made consistent.
pub(super) struct Noisy {
    pub(super) consistent: ConsistentViews,
    pub(super) unit: Unit,
    views: Vec<NoisyView>,
    files: Vec<PathBuf>,
    of_file: Vec<bool>,
}

/// Maximum slope of a bar that is reported as nearly axis-parallel if no solid was found. Steeper bars (6°)
/// are meant to be oblique.
const MAX_LEAN: f64 = 0.1;
/// Distance within which points of exact views coincide, relative to the extent: rounding errors of the
/// estimation.
const COINCIDENCE_TOLERANCE: f64 = 1e-7;

/// Reads the views and makes them one geometry.
pub(super) fn read(job: &SolidJob, findings: &mut Vec<Finding>) -> Result<Noisy> {
    let mut unit: Option<(Unit, &Path)> = None;
    let (mut views, mut of_file) = (Vec::new(), Vec::new());
    for (path, kind) in job.views.iter().zip(super::kinds(job)) {
        let file = read_contour_json(path)?;
        let named = |e: Error| e.in_context(path.display());
        findings.extend(file.warnings.iter().map(|warning| warning.clone().in_context(path.display())));
        if let (Some((known, other)), Some(own)) = (unit, file.unit)
            && known != own
        {
            return Err(Error::input(format!(
                "{}: expected one unit for all contours, found {own}, while {} is in {known}",
                path.display(),
                other.display()
            )));
        }
        unit = unit.or(file.unit.map(|own| (own, path.as_path())));
        // Several levels are sections at different heights, which no single view shows.
        if let Some(level) = file.levels.iter().flatten().find(|level| Some(**level) != file.levels[0]) {
            return Err(named(Error::input(format!(
                "expected one outline with its holes, found contours of several levels, such as {level}"
            ))));
        }
        let sketch = Sketch::new(&file.contours).map_err(named)?;
        let constraints = match file.constraints {
            // Constraints of a file were imposed by the user or in an earlier run. Searching again could
            // contradict them.
            Some(constraints) => {
                for constraint in &constraints {
                    // A file may be edited by hand, so the parts that constraints name may not exist.
                    constraint.require_parts(&sketch.drawing).map_err(named)?;
                }
                of_file.push(true);
                constraints
            }
            None => {
                of_file.push(false);
                found(&sketch, job.level).map_err(named)?
            }
        };
        views.push(NoisyView { kind, sketch, constraints });
    }
    let options = MatchOptions { level: job.level, ..MatchOptions::default() };
    // Constraints of each view come first. They make coordinates equal within a view before views are
    // matched.
    let consistent = match_views(&views, &options)?;
    // A warning: the solid is still the best estimate, and the cause may be an optimistic σ.
    if consistent.p_value < job.level {
        findings.push(
            Finding::new(
                FindingCode::ViewsInconsistent,
                format!(
                    "the views are inconsistent (p = {:.1e}): check σ of their readings",
                    consistent.p_value
                ),
            )
            .with_setting(Setting::Level),
        );
    }
    Ok(Noisy {
        consistent,
        unit: unit.map_or(job.unit.unwrap_or(Unit::Millimetre), |(unit, _)| unit),
        views,
        files: job.views.clone(),
        of_file,
    })
}

/// The relations found in a view.
fn found(sketch: &Sketch, level: f64) -> Result<Vec<Constraint>> {
    let options = ConstrainOptions { level, given: sketch.given.clone(), ..ConstrainOptions::default() };
    let found = constrain(&sketch.drawing, &sketch.covariance, &options)?;
    Ok(found.accepted().map(|proposal| proposal.constraint).collect())
}

impl Noisy {
    /// The drawing of a view, consistent with the others, and its constraints including dimensions.
    fn complete(&self, view: usize) -> Result<(ParametricDrawing, Vec<Constraint>)> {
        // The view as adjusted to the others, so that dimensions of all views agree.
        let (drawing, covariance) = self.consistent.view(view)?;
        let own = &self.views[view];
        let mut all: Vec<Constraint> = own.sketch.given.iter().chain(&own.constraints).copied().collect();
        let scheme = dimension_scheme(&drawing, &covariance, &all);
        all.extend(scheme.iter().map(|dimension| dimension.constraint));
        Ok((drawing, all))
    }

    /// The graphs of every view.
    pub(super) fn graphs(&self) -> Result<Vec<GraphsOfView>> {
        let each = (0..self.views.len()).map(|view| {
            let (drawing, all) = self.complete(view)?;
            let diagnosis = diagnose(&drawing, &all)?;
            Ok(GraphsOfView::new(self.views[view].kind.name(), &drawing, &all, &diagnosis))
        });
        each.collect()
    }

    /// The composite graph; none, and a finding, where the views have no point in common.
    pub(super) fn composite(&self, findings: &mut Vec<Finding>) -> Result<Option<Composite>> {
        let complete = (0..self.views.len()).map(|view| self.complete(view)).collect::<Result<Vec<_>>>()?;
        let axis = |k: usize| [SpaceAxis::X, SpaceAxis::Y, SpaceAxis::Z][k];
        let sketches: Vec<SketchView> = self
            .views
            .iter()
            .zip(&complete)
            .map(|(view, (drawing, constraints))| SketchView {
                name: view.kind.name(),
                axes: [axis(view.kind.axes()[0]), axis(view.kind.axes()[1])],
                drawing,
                constraints,
                // The graph needs the structure only.
                covariance: None,
            })
            .collect();
        match composite(&sketches, COINCIDENCE_TOLERANCE * self.consistent.drawing.extent(), 0.0) {
            Ok(composite) => Ok(Some(composite)),
            // A missing graph must not discard the solid.
            Err(e) => {
                findings.push(Finding::new(
                    FindingCode::GraphNotWritten,
                    format!("no composite graph was written: {e}"),
                ));
                Ok(None)
            }
        }
    }

    /// Dimensions and σ of a solid made from the views.
    pub(super) fn geometry(&self, solid: &Solid) -> Result<NoisyGeometry> {
        let views = (0..self.views.len()).map(|i| {
            let view = &self.views[i];
            let (drawing, all) = self.complete(i)?;
            let words = |constraint: &Constraint| constraint.describe(&drawing);
            Ok(ReportedView {
                view: view.kind.name(),
                file: self.files[i].display().to_string(),
                contours: view.sketch.parts.iter().map(|part| part.kind.to_string()).collect(),
                constraints: view.constraints.iter().map(words).collect(),
                constraints_of_file: self.of_file[i],
                parameters: drawing.parameters(),
                rank: diagnose(&drawing, &all)?.rank,
            })
        });
        Ok(NoisyGeometry {
            views: views.collect::<Result<_>>()?,
            matches: self.consistent.matches.clone(),
            chi_square: self.consistent.chi_square,
            degrees: self.consistent.degrees,
            p_value: self.consistent.p_value,
            vertices: self.consistent.vertices(solid),
            dimensions: self.consistent.dimensions(solid),
        })
    }

    /// Why no solid was found, with the bars that lean a little: a relation that was lost is the usual
    /// reason.
    pub(super) fn explain(&self, error: Error) -> Error {
        let drawing = &self.consistent.drawing;
        let x = drawing.values();
        let tilted_bars = drawing.bars().filter_map(|bar| {
            let each = [Constraint::Horizontal { bar }, Constraint::Vertical { bar }];
            let off =
                each.map(|c| c.equations(drawing, x.as_slice())[0].residual.abs() / drawing.length(bar));
            // A leaning bar is compared with the axis that it nearly follows.
            let nearest = usize::from(off[1] < off[0]);
            let spread = sigma(&each[nearest], drawing, &self.consistent.covariance) / drawing.length(bar);
            // Exactly parallel bars are fine, and steeper ones are meant to be oblique.
            (off[nearest] > COINCIDENCE_TOLERANCE && off[nearest] < MAX_LEAN).then(|| {
                format!(
                    "{} leans by {:.3}° ± {:.3}°",
                    drawing.bar_name(bar),
                    off[nearest].to_degrees(),
                    spread.to_degrees()
                )
            })
        });
        let tilted_bars: Vec<String> = tilted_bars.collect();
        // Without a leaning bar, the usual reason is that contours lack inner edges.
        if tilted_bars.is_empty() {
            return error.in_context(
                "contours are outlines without inner edges: the views of a solid that has inner edges \
                 differ from them",
            );
        }
        error
            .in_context(format!(
                "{}: if a side is upright, specify it as a constraint of its contour, or lower the \
                 significance level",
                tilted_bars.join(", ")
            ))
            .with_setting(Setting::Given)
            .with_setting(Setting::Level)
    }
}

/// Writes the solids' dimensions with their σ.
pub(super) fn write_json(path: &Path, report: &SolidReport) -> Result<()> {
    #[derive(Serialize)]
    struct Written<'a> {
        unit: &'a str,
        #[serde(flatten)]
        report: &'a SolidReport,
    }
    let written = Written { unit: report.unit.name(), report };
    let text = serde_json::to_string_pretty(&written)
        .map_err(|e| Error::io(format!("{}: could not be written as JSON", path.display())).with_source(e))?;
    write_atomically(path, |out| writeln!(out, "{text}"))
}
