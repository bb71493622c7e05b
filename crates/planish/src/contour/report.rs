//! Report of contours: the keys of `contour.json`.

use super::constrained::ConstrainedReport;
use super::levels::{LevelRelation, relation};
use super::parts::{CONSISTENT, MAX_SKIPPED_SHARE, Part};
use nalgebra::DMatrix;
use planish_contour::planar::{ContourFit, ContourKind, Wall, WallErrors, contains, wall_corners};
use planish_core::{Finding, FindingCode, Setting};
use planish_exchange::Unit;
use planish_exchange::contours::ContourReadings;
use serde::Serialize;
use serde::ser::SerializeMap;

/// A number with its σ.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReportedValue {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// A kind that was not chosen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedAlternative {
    /// Which.
    pub kind: String,
    /// By how much its BIC is larger than the best.
    pub bic_difference: f64,
}

/// One contour.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PartReport {
    /// `circle`, `rectangle`, `polygon-5` …
    pub kind: String,
    /// Parameters in the unit of the file, angles in degrees.
    #[serde(serialize_with = "as_map")]
    pub parameters: Vec<(String, ReportedValue)>,
    /// Names in the order of the covariance.
    pub order: Vec<String>,
    /// What no parameter states: the length of each straight side of a polygon or a chain, `side0` from the
    /// first vertex to the next, and the radius of each arc, `radius1`.
    #[serde(serialize_with = "as_map", skip_serializing_if = "Vec::is_empty")]
    pub sides: Vec<(String, ReportedValue)>,
    /// Covariance of the parameters, in those units.
    pub covariance: Vec<Vec<f64>>,
    /// Logarithm of the likelihood of the readings, each anywhere on the outline, up to a constant that all
    /// kinds share; where readings share poses, and in space, `−½ Σ s²`.
    pub log_likelihood: f64,
    /// By how much the BIC of the next kind is larger.
    pub bic_margin: Option<f64>,
    /// The other kinds.
    pub alternatives: Vec<ReportedAlternative>,
    /// Number of readings.
    pub readings: usize,
    /// Number of readings beyond the gate.
    pub rejected: usize,
    /// Sum of squared distances in σ, divided by the degrees of freedom. Expected: 1.
    pub reduced_chi_square: f64,
    /// Its level, if the file has levels.
    pub level: Option<f64>,
    /// Index in `contours` of the part that contains this one as a hole.
    pub hole_of: Option<usize>,
    /// For a chain: whether it is closed. An open chain ends at its first and last vertex, as far as it was
    /// measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub closed: Option<bool>,
    /// For a line: the ends of the measured part.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ends: Option<[[f64; 2]; 2]>,
    /// For a wall: the ends of each measured span, in order along the wall.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub spans: Vec<[[f64; 2]; 2]>,
    /// For a wall: σ of its position across it, in the middle of its readings. σ of the offset is that of
    /// the nearest point to the origin, which may be far away.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_across: Option<f64>,
}

/// A corner of two walls.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedCorner {
    /// Indices of both walls in `contours`.
    pub contours: [usize; 2],
    /// Its coordinates.
    pub x: ReportedValue,
    /// Its coordinates.
    pub y: ReportedValue,
    /// Covariance of the coordinates, without the correlation of the two walls.
    pub covariance: [[f64; 2]; 2],
}

/// Errors of readings about walls, beyond those stated; σ of walls and corners includes them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReportedWallErrors {
    /// Factor of σ of the readings.
    pub sigma_factor: f64,
    /// σ of the heading of each reading, in addition to that stated.
    pub heading_deg: f64,
    /// σ of the deviation of readings from straight walls that neighbours share: the form of the wall,
    /// rounded ranges, motion during a scan.
    pub deviation: f64,
    /// Correlation length of that deviation along a wall.
    pub correlation_length: f64,
}

impl From<WallErrors> for ReportedWallErrors {
    fn from(errors: WallErrors) -> Self {
        Self {
            sigma_factor: errors.scale,
            heading_deg: errors.heading_rad.to_degrees(),
            deviation: errors.form,
            correlation_length: errors.length,
        }
    }
}

/// All contours of a file. The keys of the largest contour are at the top level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ContourReport {
    /// The part with the most readings.
    #[serde(flatten)]
    pub main: PartReport,
    /// All parts, that one first.
    pub contours: Vec<PartReport>,
    /// The solid formed by the levels, if there are several.
    pub levels: Option<LevelRelation>,
    /// Points where walls meet.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub corners: Vec<ReportedCorner>,
    /// σ of ranges estimated from the residuals of walls, for a log if none was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sigma_range: Option<f64>,
    /// Errors of readings about walls.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall_errors: Option<ReportedWallErrors>,
    /// Indices, from 0, of the readings on no wall, among those that were read.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub readings_on_no_wall: Vec<usize>,
    /// Number of samples per pixel and axis of a picture, if so few that they displace its edges. σ includes
    /// that displacement.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub samples_per_pixel: Option<usize>,
    /// Constraints between the contours, and the constrained contours, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub constrained: Option<ConstrainedReport>,
    /// Unit of lengths.
    #[serde(serialize_with = "unit_name")]
    pub unit: Option<Unit>,
    /// Number of readings that were skipped before the fit.
    #[serde(rename = "left_out")]
    pub ignored: usize,
    /// What a user should know; files that hold the contours leave it out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

fn unit_name<S: serde::Serializer>(unit: &Option<Unit>, serializer: S) -> Result<S::Ok, S::Error> {
    unit.map(Unit::name).serialize(serializer)
}

pub(super) fn as_map<S: serde::Serializer>(
    values: &[(String, ReportedValue)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(Some(values.len()))?;
    for (name, value) in values {
        map.serialize_entry(name, value)?;
    }
    map.end()
}

/// The state and covariance of a fit in canonical parameters and the units of files, motion at the end.
pub(super) fn canonical(fit: &ContourFit) -> (Vec<String>, Vec<f64>, DMatrix<f64>) {
    let k = fit.kind.parameters();
    // Different states can describe the same contour (sides exchanged, an angle turned by a period).
    // Canonical parameters make reports comparable.
    let (mut values, mut from) = fit.kind.canonical(&fit.state.as_slice()[..k]);
    let mut names = fit.kind.names();
    let motion = [("velocity_x", 1.0), ("velocity_y", 1.0), ("rotation_deg_per_s", 1f64.to_degrees())];
    for (i, (name, factor)) in motion.into_iter().take(fit.state.len() - k).enumerate() {
        names.push((name.to_owned(), factor));
        values.push(fit.state[k + i]);
        // The motion is unique, so it is not changed.
        from.push((k + i, 1.0));
    }
    // A change of sign or unit per parameter, so the covariance needs no full Jacobian.
    let factor = |i: usize| names[i].1 * from[i].1;
    let covariance = DMatrix::from_fn(values.len(), values.len(), |i, j| {
        factor(i) * factor(j) * fit.covariance[(from[i].0, from[j].0)]
    });
    let values = values.iter().zip(&names).map(|(value, (_, factor))| value * factor).collect();
    (names.into_iter().map(|(name, _)| name).collect(), values, covariance)
}

pub(super) fn report(
    read: &ContourReadings,
    parts: &[Part],
    seen: &[Option<[[f64; 2]; 2]>],
    unit: Option<Unit>,
    mut findings: Vec<Finding>,
) -> ContourReport {
    let contours: Vec<PartReport> = (0..parts.len()).map(|i| part_report(parts, seen, i)).collect();
    for (i, part) in contours.iter().enumerate() {
        findings.extend(part_findings(part, i));
    }
    ContourReport {
        // Parts are sorted by size, and there is at least one.
        main: contours[0].clone(),
        levels: relation(parts),
        corners: corners(parts),
        sigma_range: None,
        wall_errors: None,
        readings_on_no_wall: Vec::new(),
        samples_per_pixel: None,
        constrained: None,
        contours,
        unit,
        ignored: read.ignored,
        findings,
    }
}

/// Findings about the contour at a place of the report.
pub(super) fn part_findings(part: &PartReport, index: usize) -> Vec<Finding> {
    let mut findings = Vec::new();
    let name = format!("contour {} ({}, {} readings)", index + 1, part.kind, part.readings);
    // A BIC difference of 6 to 10 is strong evidence, below 6 it is not (R. Kass, A. Raftery 1995).
    if let Some(margin) = part.bic_margin.filter(|margin| *margin < 6.0) {
        let other = part.alternatives.first().map_or("another", |a| a.kind.as_str());
        findings.push(Finding::new(
            FindingCode::KindAmbiguous,
            format!("{name}: {other} explains the readings nearly as well (BIC margin {margin:.1})"),
        ));
    }
    if !CONSISTENT.contains(&part.reduced_chi_square) {
        findings.push(Finding::new(
            FindingCode::ResidualsInconsistent,
            format!(
                "{name}: residuals are {:.2} times the stated σ: check σ or the kind",
                part.reduced_chi_square.sqrt()
            ),
        ));
    }
    if part.rejected as f64 > MAX_SKIPPED_SHARE * part.readings as f64 {
        let text = format!(
            "{name}: {} of its readings are beyond the gate and were rejected: the kind or σ may be wrong",
            part.rejected
        );
        findings.push(Finding::new(FindingCode::BeyondGate, text).with_setting(Setting::Kind));
    }
    findings
}

/// The findings that follow from all others and from the constraints.
pub(super) fn judge(report: &ContourReport) -> Vec<Finding> {
    let conflicting = report.constrained.as_ref().is_some_and(|found| !found.conflicting.is_empty());
    if conflicting {
        let text = "some of the given constraints conflict";
        vec![Finding::new(FindingCode::ConstraintsConflict, text)]
    } else if report.findings.is_empty() {
        // Only without any finding. Otherwise this sentence would contradict it.
        let text = "the readings agree with the contours within their σ";
        vec![Finding::new(FindingCode::ReadingsConsistent, text)]
    } else {
        Vec::new()
    }
}

fn part_report(parts: &[Part], seen: &[Option<[[f64; 2]; 2]>], index: usize) -> PartReport {
    let part = &parts[index];
    let fit = &part.choice.fit;
    let (order, values, covariance) = canonical(fit);
    let best = fit.bic();
    let sigma = |i: usize| covariance[(i, i)].sqrt();
    PartReport {
        kind: fit.kind.to_string(),
        parameters: (0..order.len())
            .map(|i| {
                let value = ReportedValue { value: values[i], sigma: sigma(i) };
                (order[i].clone(), value)
            })
            .collect(),
        sides: (fit.kind.sides(&values, &covariance).iter())
            .map(|side| {
                let what = if side.is_arc { "radius" } else { "side" };
                let size = ReportedValue { value: side.size, sigma: side.sigma };
                (format!("{what}{}", side.piece), size)
            })
            .collect(),
        covariance: covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
        order,
        log_likelihood: fit.log_likelihood,
        bic_margin: part.choice.bic_margin,
        alternatives: part
            .choice
            .alternatives
            .iter()
            .map(|a| ReportedAlternative { kind: a.kind.to_string(), bic_difference: a.bic - best })
            .collect(),
        readings: part.members.len(),
        rejected: fit.used.iter().filter(|used| !**used).count(),
        reduced_chi_square: fit.reduced_chi_square(),
        level: part.level,
        hole_of: hole_of(parts, index),
        closed: match fit.kind {
            ContourKind::Chain { closed, .. } => Some(closed),
            _ => None,
        },
        ends: seen[index],
        spans: part.spans.clone(),
        sigma_across: sigma_across(part),
    }
}

/// σ of a wall across it, in the middle between the ends of its spans.
fn sigma_across(part: &Part) -> Option<f64> {
    let ([a, _], [_, b]) = (part.spans.first()?, part.spans.last()?);
    let fit = &part.choice.fit;
    let (sin, cos) = fit.state[0].sin_cos();
    let along = 0.5 * (cos * (a[0] + b[0]) + sin * (a[1] + b[1]));
    // The offset at `along` is that at the foot of the origin plus `along` times the change of direction.
    let c = &fit.covariance;
    Some((c[(1, 1)] + 2.0 * along * c[(0, 1)] + along * along * c[(0, 0)]).max(0.0).sqrt())
}

/// The corners of walls of one level.
fn corners(parts: &[Part]) -> Vec<ReportedCorner> {
    let is_wall = |i: &usize| !parts[*i].spans.is_empty();
    let indices: Vec<usize> = (0..parts.len()).filter(is_wall).collect();
    let walls: Vec<Wall> = (indices.iter())
        .map(|&i| {
            let Part { members, choice, spans, end_spacings, .. } = &parts[i];
            let (members, spans) = (members.clone(), spans.clone());
            Wall { fit: choice.fit.clone(), members, spans, end_spacings: end_spacings.clone() }
        })
        .collect();
    let reported = wall_corners(&walls).into_iter().map(|corner| {
        let [xx, xy, yy] = corner.covariance;
        ReportedCorner {
            contours: corner.walls.map(|k| indices[k]),
            x: ReportedValue { value: corner.position[0], sigma: xx.sqrt() },
            y: ReportedValue { value: corner.position[1], sigma: yy.sqrt() },
            covariance: [[xx, xy], [xy, yy]],
        }
    });
    reported.filter(|corner| parts[corner.contours[0]].level == parts[corner.contours[1]].level).collect()
}

/// The smallest part of the same level that contains all vertices of this one.
fn hole_of(parts: &[Part], index: usize) -> Option<usize> {
    let outline = |part: &Part| {
        let fit = &part.choice.fit;
        fit.kind.outline(&fit.state.as_slice()[..fit.kind.parameters()])
    };
    let inner = outline(&parts[index])?;
    let others = (0..parts.len()).filter(|&i| i != index && parts[i].level == parts[index].level);
    // All vertices must be inside: outlines of different parts that cross are no holes.
    let around = others
        .filter(|&i| outline(&parts[i]).is_some_and(|o| inner.vertices.iter().all(|&v| contains(&o, v))));
    // Of nested outlines, the innermost one. It usually has the fewest readings.
    around.min_by_key(|&i| parts[i].members.len())
}
