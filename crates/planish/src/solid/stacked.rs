//! Contours of several heights as sections of one solid: merged, adjusted together, and stacked.
//!
//! In: a file of contours with levels, seen from above, and outlines from the front or the side. Out: the
//! solid, its sections with sizes ± σ, and its heights: those of horizontal lines of the outlines ± σ, or the
//! interval between two levels where no outline shows the step. Not guaranteed: a feature between two
//! neighbouring levels, or one within their errors of both sections.
//!
//! | stage | method |
//! |---|---|
//! | merge | neighbouring sections that agree by χ² are one, with the information of both |
//! | adjust | relations within and between sections, found by χ² tests, hold exactly |
//! | heights | each step is at the horizontal line between its levels, or undecided |

use super::noisy::write_json;
use super::{FaceCounts, RankedSolid, SolidJob, SolidReport, counts, writing};
use crate::contour::ReportedValue;
use nalgebra::{DMatrix, DVector};
use planish_contour::constraint::{
    Axis, Candidate, ConstrainOptions, Constraint, Place, PointId, candidates, chi_square_tail,
    constrain_among,
};
use planish_contour::planar::ContourKind;
use planish_contour::sketch::{EstimatedContour, Sketch};
use planish_core::{Finding, FindingCode, Progress, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::contours::{ContourFile, read_contour_json};
use planish_exchange::{Unit, extension};
use planish_solid::stack::{SectionLoop, Slab, stack_of};
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// Horizontal lines of an outline are inclined by less than this (1°). Others are oblique.
const MAX_INCLINATION: f64 = 0.0175;
/// Heights of an outline that differ by less than this many σ are one: 1 in 1000 equal ones differ by more.
const SAME_HEIGHT_SIGMAS: f64 = 3.29;
/// Points per section from which coordinates are no longer compared: their pairs grow with the square.
const MAX_POINTS: usize = 60;

/// A height of the solid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedHeight {
    /// The height, or the middle of the interval.
    pub value: f64,
    /// Its σ; that of an even distribution over the interval.
    pub sigma: f64,
    /// The levels between which the step is, if no outline shows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between: Option<[f64; 2]>,
}

/// A contour of a section.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SectionContour {
    /// Its kind.
    pub kind: String,
    /// Its parameters, and lengths of its sides, after the adjustment. Angles are in degrees.
    pub sizes: BTreeMap<String, ReportedValue>,
}

/// A part of the solid with one section.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedSection {
    /// The levels that were measured in it.
    pub levels: Vec<f64>,
    /// Probability of a χ² of their differences at least as large; 1 for a single level.
    pub p_value: f64,
    /// Its lower end.
    pub bottom: ReportedHeight,
    /// Its upper end.
    pub top: ReportedHeight,
    /// Its contours.
    pub contours: Vec<SectionContour>,
}

/// A solid from sections.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedStack {
    /// Sections in ascending order.
    pub sections: Vec<ReportedSection>,
    /// Relations of contours that were imposed: their number.
    pub relations: usize,
    /// χ² of all relations.
    pub chi_square: f64,
    /// Degrees of freedom of that χ².
    pub degrees: usize,
}

/// Files of sections and outlines.
pub(super) struct Sections {
    sections: ContourFile,
    outlines: Vec<ContourFile>,
    /// Warnings of their estimation.
    warnings: Vec<Finding>,
}

/// The files, if one of them has contours of several levels; `None` for views.
pub(super) fn read(job: &SolidJob) -> Result<Option<Sections>> {
    if job.views.iter().any(|view| extension(view) != "json") {
        return Ok(None);
    }
    let mut files = Vec::new();
    for path in &job.views {
        files.push((path, read_contour_json(path)?));
    }
    let named = |(path, file): &(&PathBuf, ContourFile)| -> Vec<Finding> {
        file.warnings.iter().map(|warning| warning.clone().in_context(path.display())).collect()
    };
    let warnings = files.iter().flat_map(named).collect();
    let has_levels = |file: &ContourFile| {
        let mut levels = file.levels.iter().flatten();
        levels.next().is_some_and(|first| levels.any(|level| level != first))
    };
    let Some(index) = files.iter().position(|(_, file)| has_levels(file)) else { return Ok(None) };
    let (path, sections) = files.remove(index);
    if let Some((other, _)) = files.iter().find(|(_, file)| has_levels(file)) {
        return Err(Error::input(format!(
            "expected contours of several levels in one file, found them in {} and {}",
            path.display(),
            other.display()
        )));
    }
    for (other, file) in &files {
        check_unit(path, &sections, other, file)?;
    }
    Ok(Some(Sections { sections, outlines: files.into_iter().map(|(_, file)| file).collect(), warnings }))
}

fn check_unit(path: &Path, sections: &ContourFile, other: &Path, file: &ContourFile) -> Result<()> {
    match (sections.unit, file.unit) {
        (Some(a), Some(b)) if a != b => Err(Error::input(format!(
            "{}: expected one unit for all contours, found {b}, while {} is in {a}",
            other.display(),
            path.display()
        ))),
        _ => Ok(()),
    }
}

/// Contours of one section, of one or more levels that agree.
struct Section {
    levels: Vec<f64>,
    contours: Vec<EstimatedContour>,
    p_value: f64,
}

/// Makes the solid and writes it.
pub(super) fn solve(job: &SolidJob, files: &Sections, progress: &dyn Progress) -> Result<SolidReport> {
    if job.report.is_some() || !job.graphs.is_empty() {
        return Err(Error::unsupported(
            "expected views for a page or graphs, found sections of several levels",
        )
        .with_setting(Setting::Graphs));
    }
    let unit = files.sections.unit.or(job.unit).unwrap_or(Unit::Millimetre);
    let mut sections = merged(&files.sections, job.level)?;
    progress.check("adjusting", 0.2)?;
    let adjusted = adjust(&mut sections, job.level)?;
    let heights = heights(&sections, &measured_heights(&files.outlines)?)?;
    let mut slabs = Vec::new();
    for (k, section) in sections.iter().enumerate() {
        let loops = section.contours.iter().map(section_loop).collect::<Result<Vec<_>>>()?;
        slabs.push(Slab { bottom: heights[k].value, top: heights[k + 1].value, loops });
    }
    let solid = stack_of(&slabs)?;
    progress.check(planish_core::WRITING_STAGE, 0.8)?;
    let measures = solid.measures();
    let chord = super::DEFAULT_CHORD * measures.volume.cbrt();
    let tolerance = job.mesh_tolerance.map_or(chord, |length| length.in_unit(unit));
    let prepared = writing::prepare(job, &[&solid], tolerance)?;
    let (written_as, mut written) = writing::write(job, &prepared, unit)?;
    let faces: FaceCounts = counts(&solid);
    let mut findings = files.warnings.clone();
    for between in heights.iter().filter_map(|height| height.between) {
        let text = format!(
            "a step lies between the levels {} and {}, and no outline shows where: its height is the middle, \
             with the σ of that interval",
            between[0], between[1]
        );
        findings.push(Finding::new(FindingCode::StepUndecided, text));
    }
    let report = SolidReport {
        solutions: vec![RankedSolid {
            rank: 1,
            file: written_as.first().cloned().flatten(),
            volume: measures.volume,
            area: measures.area,
            faces,
            cost: solid.faces.len() as f64,
        }],
        complete: true,
        edits: Vec::new(),
        unexplained: Vec::new(),
        refused: Vec::new(),
        dropped: Vec::new(),
        sheet: None,
        geometry: None,
        stack: Some(reported(&sections, &heights, &adjusted)),
        findings,
        unit,
        written: Vec::new(),
    };
    for path in job.outputs.iter().filter(|output| extension(output) == "json") {
        write_json(path, &report)?;
        written.push(path.clone());
    }
    Ok(SolidReport { written, ..report })
}

/// Sections in ascending order; neighbouring levels that agree are one.
fn merged(file: &ContourFile, level: f64) -> Result<Vec<Section>> {
    let mut by_level: Vec<(f64, Vec<EstimatedContour>)> = Vec::new();
    for (contour, height) in file.contours.iter().zip(&file.levels) {
        let Some(height) = *height else {
            return Err(Error::input(
                "expected a level for each contour of sections, found a contour without",
            ));
        };
        match by_level.iter_mut().find(|(known, _)| *known == height) {
            Some((_, contours)) => contours.push(contour.clone()),
            None => by_level.push((height, vec![contour.clone()])),
        }
    }
    by_level.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sections: Vec<Section> = Vec::new();
    for (height, contours) in by_level {
        let joined = sections.last().and_then(|last| joined(&last.contours, &contours, level));
        match (sections.last_mut(), joined) {
            (Some(last), Some((both, p_value))) => {
                last.levels.push(height);
                last.contours = both;
                last.p_value = last.p_value.min(p_value);
            }
            _ => sections.push(Section { levels: vec![height], contours, p_value: 1.0 }),
        }
    }
    Ok(sections)
}

/// The contours of two levels as one section, and the p-value of their differences; `None` if they differ.
fn joined(
    a: &[EstimatedContour],
    b: &[EstimatedContour],
    level: f64,
) -> Option<(Vec<EstimatedContour>, f64)> {
    if a.len() != b.len() {
        return None;
    }
    let mut left: Vec<&EstimatedContour> = b.iter().collect();
    let (mut both, mut chi_square, mut degrees) = (Vec::new(), 0.0, 0);
    for own in a {
        // The counterpart is the one that differs least.
        let (k, (mean, squares)) = (left.iter().enumerate())
            .filter_map(|(k, other)| Some((k, mean_of(own, other)?)))
            .min_by(|x, y| x.1.1.total_cmp(&y.1.1))?;
        left.swap_remove(k);
        degrees += mean.theta.len();
        chi_square += squares;
        both.push(mean);
    }
    let p_value = chi_square_tail(chi_square, degrees);
    (p_value > level).then_some((both, p_value))
}

/// The mean of two estimates of a contour, weighted by information, and the χ² of their difference.
fn mean_of(a: &EstimatedContour, b: &EstimatedContour) -> Option<(EstimatedContour, f64)> {
    if a.kind != b.kind || matches!(a.kind, ContourKind::Line | ContourKind::Chain { closed: false, .. }) {
        return None;
    }
    let theta = DVector::from_column_slice(&a.theta);
    let compared = |order: Vec<usize>| {
        let mut off = DVector::from_iterator(theta.len(), order.iter().map(|&i| b.theta[i])) - &theta;
        // An angle just below its period is close to one just above zero.
        if let Some((i, period)) = period_of_angle(&a.kind) {
            off[i] -= period * (off[i] / period).round();
        }
        let own = |i: usize, j: usize| b.covariance[(order[i], order[j])];
        let both = &a.covariance + DMatrix::from_fn(theta.len(), theta.len(), own);
        let both = both.cholesky()?;
        Some((off.dot(&both.solve(&off)), off, both))
    };
    let (squares, off, both) =
        renumbered(b).into_iter().filter_map(compared).min_by(|x, y| x.0.total_cmp(&y.0))?;
    // With C = A + B, the mean is a + A C⁻¹ (b − a), and its covariance A − A C⁻¹ A.
    let mean = theta.clone() + &a.covariance * both.solve(&off);
    let covariance = &a.covariance - &a.covariance * both.solve(&a.covariance);
    let covariance = 0.5 * (&covariance + covariance.transpose());
    Some((EstimatedContour { theta: mean.as_slice().to_vec(), covariance, ..a.clone() }, squares))
}

/// Index of the angle of a kind, and its period in radians.
fn period_of_angle(kind: &ContourKind) -> Option<(usize, f64)> {
    match kind {
        ContourKind::Ellipse | ContourKind::Rectangle | ContourKind::RoundedRectangle | ContourKind::Slot => {
            Some((4, PI))
        }
        ContourKind::RegularPolygon(sides) => Some((3, 2.0 * PI / *sides as f64)),
        _ => None,
    }
}

/// The orders of the parameters of a contour that mean the same contour.
///
/// Of two equally low corners of a polygon, chance decides which is first.
fn renumbered(contour: &EstimatedContour) -> Vec<Vec<usize>> {
    let n = contour.theta.len();
    let shifts = if let ContourKind::Polygon(corners) = contour.kind { corners } else { 1 };
    (0..shifts).map(|shift| (0..n).map(|i| (i + 2 * shift) % n).collect()).collect()
}

/// The result of the adjustment of all sections.
struct Adjusted {
    relations: usize,
    chi_square: f64,
    degrees: usize,
}

/// Finds relations of all contours by χ² tests, and imposes them on all together.
fn adjust(sections: &mut [Section], level: f64) -> Result<Adjusted> {
    let all: Vec<EstimatedContour> = sections.iter().flat_map(|s| s.contours.iter().cloned()).collect();
    let sketch = Sketch::new(&all)?;
    let mut tested = candidates(&sketch.drawing);
    let extent = sketch.drawing.extent();
    // Walls of two sections in line have equal coordinates; points of one contour have other relations.
    let points: Vec<(usize, PointId)> = (sketch.parts.iter().enumerate())
        .flat_map(|(k, part)| (0..part.count.points).map(move |i| (k, part.first.points + i)))
        .map(|(k, i)| (k, PointId(i)))
        .collect();
    if points.len() <= MAX_POINTS {
        for (i, &(k, a)) in points.iter().enumerate() {
            for &(_, b) in points[i + 1..].iter().filter(|(other, _)| *other != k) {
                for axis in [Axis::X, Axis::Y] {
                    let place = |point| Place::Point { point, axis };
                    tested.push(Candidate {
                        constraint: Constraint::Aligned { a: place(a), b: place(b) },
                        range: extent,
                    });
                }
            }
        }
    }
    let options = ConstrainOptions { level, given: sketch.given.clone(), ..ConstrainOptions::default() };
    let found = constrain_among(&sketch.drawing, &sketch.covariance, &tested, &options)?;
    for (k, contour) in sections.iter_mut().flat_map(|s| s.contours.iter_mut()).enumerate() {
        (contour.theta, contour.covariance) = sketch.contour(k, &found.drawing, &found.covariance)?;
    }
    Ok(Adjusted {
        relations: found.constraints.len() - sketch.given.len(),
        chi_square: found.chi_square,
        degrees: found.degrees,
    })
}

/// The curve of a contour in a section.
fn section_loop(contour: &EstimatedContour) -> Result<SectionLoop> {
    let EstimatedContour { kind, theta, .. } = contour;
    match (kind, kind.outline(theta)) {
        (ContourKind::Circle, _) => {
            Ok(SectionLoop::Circle { center: [theta[0], theta[1]], radius: theta[2] })
        }
        (ContourKind::Ellipse, _) | (_, None) => Err(Error::unsupported(format!(
            "expected circles and closed outlines of lines and arcs for sections, found: {kind}"
        ))),
        (_, Some(outline)) if outline.closed => {
            Ok(SectionLoop::Outline { vertices: outline.vertices, bulges: outline.bulges })
        }
        _ => Err(Error::unsupported("expected closed outlines for sections, found an open chain")),
    }
}

/// Heights of the horizontal lines of outlines, ascending: values and variances.
fn measured_heights(outlines: &[ContourFile]) -> Result<Vec<[f64; 2]>> {
    let mut found: Vec<[f64; 2]> = Vec::new();
    for outline in outlines {
        for contour in &outline.contours {
            found.extend(horizontal_lines(contour)?);
        }
    }
    found.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut heights: Vec<[f64; 2]> = Vec::new();
    for [y, variance] in found {
        match heights.last_mut() {
            Some([z, known]) if (y - *z).abs() < SAME_HEIGHT_SIGMAS * (*known + variance).sqrt() => {
                let weight = *known / (*known + variance);
                *z += weight * (y - *z);
                *known *= 1.0 - weight;
            }
            _ => heights.push([y, variance]),
        }
    }
    Ok(heights)
}

/// Heights of the horizontal sides of an outline, with variances.
fn horizontal_lines(contour: &EstimatedContour) -> Result<Vec<[f64; 2]>> {
    let EstimatedContour { kind, theta, covariance, .. } = contour;
    // Relations of the outline first: its horizontal sides then have one height.
    let sketch = Sketch::new(std::slice::from_ref(contour))?;
    let options = ConstrainOptions { given: sketch.given.clone(), ..ConstrainOptions::default() };
    let found = constrain_among(&sketch.drawing, &sketch.covariance, &candidates(&sketch.drawing), &options)?;
    let (theta, covariance) = sketch
        .contour(0, &found.drawing, &found.covariance)
        .unwrap_or_else(|_| (theta.clone(), covariance.clone()));
    let Some(outline) = kind.outline(&theta).filter(|outline| outline.bulges.len() < 100) else {
        return Ok(Vec::new());
    };
    let n = outline.vertices.len();
    let height = |theta: &[f64], i: usize| -> f64 {
        let vertices = kind.outline(theta).map(|outline| outline.vertices).unwrap_or_default();
        0.5 * (vertices[i][1] + vertices[(i + 1) % n][1])
    };
    let mut heights = Vec::new();
    for i in (0..n).filter(|&i| outline.bulges.get(i) == Some(&0.0)) {
        let (a, b) = (outline.vertices[i], outline.vertices[(i + 1) % n]);
        if (b[1] - a[1]).abs() > MAX_INCLINATION * (b[0] - a[0]).abs() {
            continue;
        }
        let gradient = DVector::from_fn(theta.len(), |k, _| {
            let step = 1e-3 * covariance[(k, k)].max(1e-12).sqrt();
            let at = |by: f64| {
                let mut moved = theta.clone();
                moved[k] += by;
                height(&moved, i)
            };
            (at(step) - at(-step)) / (2.0 * step)
        });
        heights.push([height(&theta, i), gradient.dot(&(&covariance * &gradient)).max(0.0)]);
    }
    Ok(heights)
}

/// The heights of all ends and steps of the sections.
fn heights(sections: &[Section], measured: &[[f64; 2]]) -> Result<Vec<ReportedHeight>> {
    let mut limits = vec![[f64::NEG_INFINITY, sections[0].levels[0]]];
    for pair in sections.windows(2) {
        limits.push([pair[0].levels[pair[0].levels.len() - 1], pair[1].levels[0]]);
    }
    let last = &sections[sections.len() - 1].levels;
    limits.push([last[last.len() - 1], f64::INFINITY]);
    let mut used = 0;
    let mut heights = Vec::new();
    for [from, to] in limits {
        let inside: Vec<&[f64; 2]> = measured.iter().filter(|[z, _]| *z > from && *z < to).collect();
        used += inside.len();
        heights.push(match (&inside[..], from.is_finite() && to.is_finite()) {
            ([[value, variance]], _) => {
                ReportedHeight { value: *value, sigma: variance.sqrt(), between: None }
            }
            ([], true) => ReportedHeight {
                value: 0.5 * (from + to),
                sigma: (to - from) / 12f64.sqrt(),
                between: Some([from, to]),
            },
            ([], false) => {
                return Err(Error::undetermined(
                    "sections give no height of the bottom and the top: add an outline from the front or the \
                     side, a contour of kind polygon-N",
                ));
            }
            (several, _) => {
                return Err(Error::undetermined(format!(
                    "expected one step between the levels {from} and {to}, found {} horizontal lines of the \
                     outlines there: measure a section between them",
                    several.len()
                )));
            }
        });
    }
    match measured.len() - used {
        0 => Ok(heights),
        n => Err(Error::undetermined(format!(
            "the outlines have {n} more horizontal lines within sections that agree: the object has a step \
             that the sections do not show, or σ is too large to see it"
        ))),
    }
}

fn reported(sections: &[Section], heights: &[ReportedHeight], adjusted: &Adjusted) -> ReportedStack {
    let contour = |contour: &EstimatedContour| {
        let EstimatedContour { kind, theta, covariance, .. } = contour;
        let mut sizes = BTreeMap::new();
        for (k, (name, factor)) in kind.names().into_iter().enumerate() {
            let sigma = factor * covariance[(k, k)].max(0.0).sqrt();
            sizes.insert(name, ReportedValue { value: factor * theta[k], sigma });
        }
        for side in kind.sides(theta, covariance) {
            let what = if side.is_arc { "radius" } else { "side" };
            sizes.insert(
                format!("{what}{}", side.piece),
                ReportedValue { value: side.size, sigma: side.sigma },
            );
        }
        SectionContour { kind: kind.to_string(), sizes }
    };
    let section = |(k, section): (usize, &Section)| ReportedSection {
        levels: section.levels.clone(),
        p_value: section.p_value,
        bottom: heights[k].clone(),
        top: heights[k + 1].clone(),
        contours: section.contours.iter().map(contour).collect(),
    };
    ReportedStack {
        sections: sections.iter().enumerate().map(section).collect(),
        relations: adjusted.relations,
        chi_square: adjusted.chi_square,
        degrees: adjusted.degrees,
    }
}
