//! Constraints between the contours of a file: found by tests, imposed, rounded to a grid, and counted.
//!
//! Input: the fitted parts and the user's constraints. Output: a [`ConstrainedReport`], the constrained
//! contours, and the graphs. Not guaranteed: a relation that is consistent with the data may still be
//! unintended; its p-value is reported.

use super::Part;
use super::lengths::in_unit;
use super::report::{ReportedValue, as_map, canonical};
use crate::graphs::{GraphsOfView, NamedStructure};
use nalgebra::DMatrix;
use planish_contour::constraint::{
    ConstrainOptions, Constrained, Constraint, Diagnosis, Dimension, Dimensioned, ParametricDrawing,
    ProposalOutcome, Snap, SnapOutcome, chi_square_tail, constrain, constrain_among, diagnose,
    dimension_scheme, implications, impose, snap,
};
use planish_contour::planar::ContourKind;
use planish_contour::sketch::{EstimatedContour, Sketch};
use planish_core::{Finding, FindingCode, Length, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use serde::Serialize;
use std::path::PathBuf;

/// Constraints to find and impose.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ConstrainJob {
    /// Whether relations are searched for.
    pub propose: bool,
    /// Significance level: the probability that a true relation is rejected.
    pub level: Option<f64>,
    /// Grid to which sizes are rounded if the statistics permit it.
    pub snap: Option<Length>,
    /// Constraints given by the user, as text.
    pub given: Vec<String>,
    /// Files for the graphs: `.json`, `.dot`.
    pub graphs: Vec<PathBuf>,
}

impl ConstrainJob {
    /// Whether there is anything to do.
    #[must_use]
    pub fn has_task(&self) -> bool {
        self.propose || self.snap.is_some() || !self.given.is_empty() || !self.graphs.is_empty()
    }
}

/// A contour that obeys the constraints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConstrainedContour {
    /// Its kind.
    pub kind: String,
    /// Parameters in the unit of the file, angles in degrees.
    #[serde(serialize_with = "as_map")]
    pub parameters: Vec<(String, ReportedValue)>,
    /// Names in the order of the covariance.
    pub order: Vec<String>,
    /// Covariance of the parameters. It is singular along imposed constraints.
    pub covariance: Vec<Vec<f64>>,
}

/// A point of the drawing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedPoint {
    /// Name in constraints.
    pub name: String,
    /// The contour, by its place in `contours`.
    pub contour: usize,
    /// Its place.
    pub position: [f64; 2],
    /// σ of both coordinates.
    pub sigma: [f64; 2],
}

/// A bar or circle of the drawing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedSize {
    /// Name in constraints.
    pub name: String,
    /// The contour, by its place in `contours`.
    pub contour: usize,
    /// Length or radius.
    pub value: f64,
    /// σ; zero if it is imposed.
    pub sigma: f64,
}

/// A relation that was tested.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedRelation {
    /// In words.
    pub text: String,
    /// `imposed`, `implied`, `rejected`, `refused` or `unclear`.
    pub outcome: &'static str,
    /// Its χ² under the estimate.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// Probability of a χ² at least as large if the relation is true.
    pub p_value: f64,
    /// Share of its range in which it would have been accepted by chance.
    pub chance: f64,
    /// For an implied relation, the smallest set that it follows from. For a refused one, the smallest set
    /// that it conflicts with.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub with: Vec<String>,
}

/// A constraint that was imposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImposedConstraint {
    /// In words.
    pub text: String,
    /// Origin: `kind` (of a contour), `given` (by the user), `relation` (found) or `grid` (rounded size).
    pub from: &'static str,
    /// The constraint.
    #[serde(flatten)]
    pub constraint: Constraint,
}

/// A constraint with others that it follows from or conflicts with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ReportedDependence {
    /// The constraint.
    pub text: String,
    /// The smallest set of others.
    pub with: Vec<String>,
}

/// Remaining degrees of freedom.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedFreedoms {
    /// Parameters of the drawing.
    pub parameters: usize,
    /// Equations that were imposed.
    pub equations: usize,
    /// The rank of their Jacobian at a witness.
    pub rank: usize,
    /// The structural rank: the size of a maximum matching.
    pub structural_rank: usize,
    /// Parameters less rank.
    pub free: usize,
    /// Number of these that are rigid motions of the whole drawing.
    pub rigid_motions: usize,
    /// Whether the witness is in general position.
    pub is_generic: bool,
}

/// Constraints between the contours of a file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConstrainedReport {
    /// The contours, in the order of `contours` above.
    pub contours: Vec<ConstrainedContour>,
    /// Points of the drawing.
    pub points: Vec<ReportedPoint>,
    /// Bars with their lengths.
    pub bars: Vec<ReportedSize>,
    /// Circles with their radii.
    pub circles: Vec<ReportedSize>,
    /// All tested relations.
    pub relations: Vec<ReportedRelation>,
    /// Sizes and the grid.
    pub sizes: Vec<Snap>,
    /// All imposed constraints.
    pub constraints: Vec<ImposedConstraint>,
    /// Dimensions that determine the contours together with the constraints.
    pub dimensions: Vec<Dimensioned>,
    /// χ² of all imposed constraints: the increase over the unconstrained estimate.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// Probability of a χ² at least as large.
    pub p_value: f64,
    /// Expected number of accepted relations between unrelated parts.
    pub expected_by_chance: f64,
    /// Remaining degrees of freedom.
    pub freedoms: ReportedFreedoms,
    /// The parts of the structure.
    pub structure: NamedStructure,
    /// Constraints that follow from others: given constraints and found relations.
    pub redundant: Vec<ReportedDependence>,
    /// Relations that agree with the readings, but not together with others.
    pub conflicting: Vec<ReportedDependence>,
}

/// The kind and parameters of a contour to draw.
type DrawnKind = (ContourKind, Vec<f64>);

/// Result of [`constrained`]: the report, the contours to draw, the graphs to write, and warnings.
pub(super) struct ConstrainedParts {
    pub(super) report: ConstrainedReport,
    pub(super) drawn: Vec<DrawnKind>,
    pub(super) graphs: GraphsOfView,
    pub(super) findings: Vec<Finding>,
}

/// Finds and imposes constraints between the parts.
pub(super) fn constrained(
    job: &ConstrainJob,
    parts: &[Part],
    seen: &[Option<[[f64; 2]; 2]>],
    unit: Option<Unit>,
) -> Result<ConstrainedParts> {
    let contours: Vec<EstimatedContour> =
        parts.iter().zip(seen).map(|(part, seen)| estimated(part, *seen)).collect();
    let sketch = Sketch::new(&contours)?;
    let given = given(job, &sketch, unit.unwrap_or(Unit::Millimetre))?;
    let mut options = ConstrainOptions { given, ..ConstrainOptions::default() };
    if let Some(level) = job.level {
        options.level = level;
    }
    let mut findings = Vec::new();
    // Given constraints are tested alone first. Afterwards, found relations would blur which of them
    // disagrees.
    let held = impose(&sketch.drawing, &sketch.covariance, &options.given, 0.0)?;
    // Constraints of the kinds (right angles of a rectangle) remove no degrees of freedom from the estimate,
    // so they are subtracted.
    let own = impose(&sketch.drawing, &sketch.covariance, &sketch.given, 0.0)?.degrees;
    let p_value = chi_square_tail(held.chi_square, held.degrees - own);
    // A warning: the user may know the part better than the stated σ allows.
    if p_value < options.level {
        let text = format!(
            "the given constraints conflict with the readings: χ² {:.3} of {} degrees, p = {p_value:.2e}",
            held.chi_square,
            held.degrees - own
        );
        findings.push(Finding::new(FindingCode::GivenInconsistent, text).with_setting(Setting::Given));
    }
    let found = if job.propose {
        constrain(&sketch.drawing, &sketch.covariance, &options)?
    } else {
        // No proposals: only the given constraints are imposed.
        constrain_among(&sketch.drawing, &sketch.covariance, &[], &options)?
    };
    let (found, sizes) = match job.snap {
        None => (found, Vec::new()),
        Some(grid) => {
            let grid = grid.in_unit(unit.unwrap_or(Unit::Millimetre));
            // After the relations: they make σ of the sizes smaller, so fewer multiples of the grid are
            // possible.
            snap(&found, grid, &Dimension::all(&sketch.drawing))?
        }
    };
    // Dimensions come last: they fill the degrees of freedom that constraints and rounded sizes leave.
    let dimensions = dimension_scheme(&found.drawing, &found.covariance, &found.constraints);
    let diagnosis = diagnose(&found.drawing, &found.constraints)?;
    // The graphs describe the drawing with all its dimensions, so that nothing in them is free.
    let complete: Vec<Constraint> = found
        .constraints
        .iter()
        .copied()
        .chain(dimensions.iter().map(|dimension| dimension.constraint))
        .collect();
    let graphs =
        GraphsOfView::new("contour", &found.drawing, &complete, &diagnose(&found.drawing, &complete)?);
    let (contours, drawn) = contours_of(&sketch, &found)?;
    let parts = ReportParts { own, sizes, dimensions, contours };
    Ok(ConstrainedParts { report: report(&sketch, &found, &diagnosis, parts)?, drawn, graphs, findings })
}

/// Constraints of the kinds, followed by those of the user. Conflicts are reported as minimal sets.
fn given(job: &ConstrainJob, sketch: &Sketch, unit: Unit) -> Result<Vec<Constraint>> {
    let mut all = sketch.given.clone();
    for sentence in &job.given {
        let constraint = Constraint::parse(&in_unit(sentence, unit)?, &sketch.drawing)?;
        constraint.require_parts(&sketch.drawing)?;
        all.push(constraint);
    }
    if job.given.is_empty() {
        return Ok(all);
    }
    // Conflicts among given constraints are errors. No estimate satisfies them, and dropping one silently
    // would choose for the user.
    let found = diagnose(&sketch.drawing, &all)?;
    if found.conflicting.is_empty() {
        return Ok(all);
    }
    let words = |i: usize| all[i].describe(&sketch.drawing);
    let sets: Vec<String> = found
        .conflicting
        .iter()
        .map(|conflict| {
            let others: Vec<String> = conflict.with.iter().map(|&i| words(i)).collect();
            if others.is_empty() {
                return format!("`{}` cannot be satisfied by these contours", words(conflict.constraint));
            }
            format!("`{}` conflicts with {}", words(conflict.constraint), quoted(&others))
        })
        .collect();
    let advice = match found.conflicting.iter().all(|conflict| conflict.with.is_empty()) {
        true => "omit it, or specify another size",
        false => "omit one of each set",
    };
    Err(Error::input(format!("{}: {advice}", sets.join("; "))))
}

fn quoted(names: &[String]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    quoted.join(", ")
}

/// A part's estimate in canonical parameters, angles in radians.
fn estimated(part: &Part, seen: Option<[[f64; 2]; 2]>) -> EstimatedContour {
    let kind = part.choice.fit.kind.clone();
    let (_, values, covariance) = canonical(&part.choice.fit);
    let factors: Vec<f64> = kind.names().into_iter().map(|(_, factor)| factor).collect();
    let n = factors.len();
    EstimatedContour {
        // Back from reported units (degrees) to those of the equations (radians).
        theta: (0..n).map(|i| values[i] / factors[i]).collect(),
        covariance: DMatrix::from_fn(n, n, |i, j| covariance[(i, j)] / (factors[i] * factors[j])),
        kind,
        observed_ends: seen,
    }
}

fn contours_of(sketch: &Sketch, found: &Constrained) -> Result<(Vec<ConstrainedContour>, Vec<DrawnKind>)> {
    let (mut contours, mut drawn) = (Vec::new(), Vec::new());
    for i in 0..sketch.parts.len() {
        let kind = sketch.parts[i].kind.clone();
        let (theta, covariance) = sketch.contour(i, &found.drawing, &found.covariance)?;
        let names = kind.names();
        // Equations have radians and reports have degrees, so both factors apply to a covariance.
        let at = |k: usize, l: usize| names[k].1 * names[l].1 * covariance[(k, l)];
        contours.push(ConstrainedContour {
            kind: kind.to_string(),
            parameters: (0..names.len())
                .map(|k| {
                    let value =
                        // The covariance is singular along imposed constraints, and rounding can make a
                        // variance slightly negative.
                        ReportedValue { value: theta[k] * names[k].1, sigma: at(k, k).max(0.0).sqrt() };
                    (names[k].0.clone(), value)
                })
                .collect(),
            order: names.iter().map(|(name, _)| name.clone()).collect(),
            covariance: (0..names.len()).map(|k| (0..names.len()).map(|l| at(k, l)).collect()).collect(),
        });
        drawn.push((kind, theta));
    }
    Ok((contours, drawn))
}

/// Parts of a report that exist before it.
struct ReportParts {
    /// Degrees of freedom of the constraints of the kinds alone.
    own: usize,
    sizes: Vec<Snap>,
    dimensions: Vec<Dimensioned>,
    contours: Vec<ConstrainedContour>,
}

fn report(
    sketch: &Sketch,
    found: &Constrained,
    diagnosis: &Diagnosis,
    ReportParts { own, sizes, dimensions, contours }: ReportParts,
) -> Result<ConstrainedReport> {
    let drawing = &found.drawing;
    let words = |constraint: &Constraint| constraint.describe(drawing);
    let implied: Vec<usize> = (0..found.proposals.len())
        .filter(|&i| found.proposals[i].outcome == ProposalOutcome::Implied)
        .collect();
    let relations: Vec<Constraint> = implied.iter().map(|&i| found.proposals[i].constraint).collect();
    // In one call, so that the Jacobian of all constraints is ranked only once.
    let follows = implications(drawing, &found.constraints, &relations)?;
    let from = |i: usize| -> Vec<String> {
        // Indices in `follows` count the implied relations only.
        let set = follows.iter().find(|dependence| implied[dependence.constraint] == i);
        set.map_or_else(Vec::new, |set| set.with.iter().map(|&k| words(&found.constraints[k])).collect())
    };
    let reported: Vec<ReportedRelation> = (0..found.proposals.len())
        .map(|i| {
            let proposal = &found.proposals[i];
            let (outcome, with) = match &proposal.outcome {
                ProposalOutcome::Imposed => ("imposed", Vec::new()),
                ProposalOutcome::Implied => ("implied", from(i)),
                ProposalOutcome::Rejected => ("rejected", Vec::new()),
                ProposalOutcome::Unclear => ("unclear", Vec::new()),
                ProposalOutcome::Refused { with } => {
                    ("refused", with.iter().map(|&k| found.proposals[k].text.clone()).collect())
                }
            };
            ReportedRelation {
                text: proposal.text.clone(),
                outcome,
                chi_square: proposal.chi_square,
                degrees: proposal.degrees,
                p_value: proposal.p_value,
                chance: proposal.chance,
                with,
            }
        })
        .collect();
    let dependence = |relation: &ReportedRelation| ReportedDependence {
        text: relation.text.clone(),
        with: relation.with.clone(),
    };
    let pick = |outcome: &str| -> Vec<ReportedDependence> {
        // A given constraint that is found again is not information about others.
        let is_new = |r: &&ReportedRelation| !r.with.is_empty() && r.with != [r.text.clone()];
        let chosen = reported.iter().filter(|r| r.outcome == outcome).filter(is_new);
        chosen.map(dependence).collect()
    };
    // Redundant given constraints come first.
    let mut redundant: Vec<ReportedDependence> = diagnosis
        .redundant
        .iter()
        .map(|dependence| ReportedDependence {
            text: words(&found.constraints[dependence.constraint]),
            with: dependence.with.iter().map(|&k| words(&found.constraints[k])).collect(),
        })
        .collect();
    redundant.extend(pick("implied"));
    Ok(ConstrainedReport {
        contours,
        points: points(sketch, drawing, &found.covariance),
        bars: sizes_of(sketch, drawing, &found.covariance, true),
        circles: sizes_of(sketch, drawing, &found.covariance, false),
        conflicting: pick("refused"),
        redundant,
        constraints: imposed(sketch, found, &sizes),
        dimensions,
        chi_square: found.chi_square,
        degrees: found.degrees - own,
        p_value: chi_square_tail(found.chi_square, found.degrees - own),
        expected_by_chance: found.expected_by_chance,
        freedoms: ReportedFreedoms {
            parameters: diagnosis.parameters,
            equations: diagnosis.equations,
            rank: diagnosis.rank,
            structural_rank: diagnosis.structure.rank,
            free: diagnosis.freedoms,
            rigid_motions: diagnosis.rigid_motions,
            is_generic: diagnosis.is_generic,
        },
        structure: NamedStructure::new(&diagnosis.structure, drawing),
        relations: reported,
        sizes,
    })
}

/// Every constraint with its origin.
fn imposed(sketch: &Sketch, found: &Constrained, sizes: &[Snap]) -> Vec<ImposedConstraint> {
    let snapped = sizes.iter().filter(|size| size.outcome == SnapOutcome::Snapped).count();
    let accepted = found.accepted().count();
    let count = found.constraints.len();
    // The list is in the order in which constraints were imposed: kinds, given, relations, rounded sizes.
    let from = |i: usize| match i {
        i if i < sketch.given.len() => "kind",
        i if i >= count - snapped => "grid",
        i if i >= count - snapped - accepted => "relation",
        _ => "given",
    };
    let all = found.constraints.iter().enumerate();
    all.map(|(i, constraint)| ImposedConstraint {
        text: constraint.describe(&found.drawing),
        from: from(i),
        constraint: *constraint,
    })
    .collect()
}

fn points(sketch: &Sketch, drawing: &ParametricDrawing, covariance: &DMatrix<f64>) -> Vec<ReportedPoint> {
    let all = drawing.points().map(|point| ReportedPoint {
        name: drawing.point_name(point).to_owned(),
        contour: part_of(sketch, |part| part.first.points, point.0),
        position: drawing.position(point),
        sigma: drawing.coordinates(point).map(|i| covariance[(i, i)].max(0.0).sqrt()),
    });
    all.collect()
}

/// Lengths of bars, or radii of circles.
fn sizes_of(
    sketch: &Sketch,
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    bars: bool,
) -> Vec<ReportedSize> {
    let size = |name: String, contour: usize, value: f64, constraint: Constraint| ReportedSize {
        name,
        contour,
        value,
        // σ of a size is that of the constraint that would fix it. This avoids a second set of derivatives.
        sigma: planish_contour::constraint::sigma(&constraint, drawing, covariance),
    };
    if bars {
        let all = drawing.bars().map(|bar| {
            let ([a, b], value) = (drawing.ends(bar), drawing.length(bar));
            let contour = part_of(sketch, |part| part.first.bars, bar.0);
            size(drawing.bar_name(bar), contour, value, Constraint::Distance { a, b, value })
        });
        return all.collect();
    }
    let all = drawing.circles().map(|circle| {
        let value = drawing.radius(circle);
        let contour = part_of(sketch, |part| part.first.circles, circle.0);
        size(drawing.circle_name(circle).to_owned(), contour, value, Constraint::Radius { circle, value })
    });
    all.collect()
}

/// The last part whose numbers begin no later.
fn part_of(sketch: &Sketch, first: impl Fn(&planish_contour::sketch::SketchPart) -> u32, id: u32) -> usize {
    // Numbers of points, bars and circles are consecutive from part to part.
    sketch.parts.iter().rposition(|part| first(part) <= id).unwrap_or_default()
}
