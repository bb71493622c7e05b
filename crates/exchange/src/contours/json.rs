//! Reads `contour.json`: contours with their covariance and constraints.
//!
//! **Input.** The output of `planish contour -o contour.json`, or `kind`, `parameters`, `order` and
//! `covariance` alone.
//!
//! **Output.** Kinds, parameters (radians and the unit of the file), covariances and constraints.
//!
//! **Limits.** This module does not check that covariances are positive definite; estimators do.

use crate::source::read_text;
use nalgebra::DMatrix;
use planish_contour::constraint::Constraint;
use planish_contour::planar::ContourKind;
use planish_contour::sketch::EstimatedContour;
use planish_core::{Finding, FindingCode, FindingLevel, Unit};
use planish_estimate::{Error, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Maximum number of contours of a view; bounds the size of the joint covariance, which grows with its
/// square.
const MAX_CONTOURS: usize = 200;
/// Maximum number of corners of a contour, which bounds the memory that a name such as `polygon-99999`
/// requests.
const MAX_CORNERS: usize = 500;

/// Content of a file of contours.
#[derive(Debug, Clone, PartialEq)]
pub struct ContourFile {
    /// The estimated contours.
    pub contours: Vec<EstimatedContour>,
    /// For each hole, the index of the contour that contains it.
    pub hole_of: Vec<Option<usize>>,
    /// Level (height of the cut) of each contour.
    pub levels: Vec<Option<f64>>,
    /// Constraints imposed on the contours beyond their kinds; none if no constraints were requested.
    pub constraints: Option<Vec<Constraint>>,
    /// The unit of lengths, if stated.
    pub unit: Option<Unit>,
    /// Warnings of the estimation.
    pub warnings: Vec<Finding>,
}

#[derive(Deserialize)]
struct Written {
    #[serde(flatten)]
    main: Option<WrittenContour>,
    contours: Option<Vec<WrittenContour>>,
    constrained: Option<WrittenConstraints>,
    unit: Option<String>,
    #[serde(default)]
    findings: Vec<WrittenFinding>,
}

#[derive(Deserialize)]
struct WrittenFinding {
    code: String,
    text: String,
}

#[derive(Deserialize)]
struct WrittenContour {
    kind: String,
    parameters: BTreeMap<String, WrittenValue>,
    order: Vec<String>,
    covariance: Vec<Vec<f64>>,
    level: Option<f64>,
    hole_of: Option<usize>,
    /// Whether a chain is closed (default).
    closed: Option<bool>,
    ends: Option<[[f64; 2]; 2]>,
}

#[derive(Deserialize)]
struct WrittenValue {
    value: f64,
}

#[derive(Deserialize)]
struct WrittenConstraints {
    constraints: Vec<WrittenConstraint>,
}

#[derive(Deserialize)]
struct WrittenConstraint {
    from: String,
    #[serde(flatten)]
    constraint: Constraint,
}

/// Reads contours with their covariance.
///
/// # Errors
/// `Io` when the file cannot be read; `Input`, naming the contour, for JSON without contours, an unknown
/// kind, and parameters or a covariance that do not match it.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("contour.json");
/// std::fs::write(&path, r#"{ "kind": "circle", "order": ["center_x", "center_y", "radius"],
///     "parameters": { "center_x": { "value": 1 }, "center_y": { "value": 2 }, "radius": { "value": 3 } },
///     "covariance": [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.04]] }"#)?;
/// let file = planish_exchange::contours::read_contour_json(&path)?;
/// assert_eq!(file.contours[0].theta, [1.0, 2.0, 3.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_contour_json(path: &Path) -> Result<ContourFile> {
    read_text(path).and_then(|text| parse(&text)).map_err(|e| e.in_context(path.display()))
}

fn parse(text: &str) -> Result<ContourFile> {
    let expected = "expected contours as `planish contour -o contour.json` writes them (kind, parameters, \
        order, covariance)";
    let written: Written = serde_json::from_str(text)
        .map_err(|e| Error::input(format!("{expected}, found: {e}")).with_source(e))?;
    let contours = match (written.contours, written.main) {
        (Some(contours), _) if !contours.is_empty() => contours,
        (_, Some(main)) => vec![main],
        _ => return Err(Error::input(format!("{expected}, found none"))),
    };
    if contours.len() > MAX_CONTOURS {
        return Err(Error::unsupported(format!(
            "expected at most {MAX_CONTOURS} contours, which form one view, found {}",
            contours.len()
        )));
    }
    let estimates = contours.iter().enumerate().map(|(i, contour)| {
        estimate(contour).map_err(|e| e.in_context(format!("contour {} ({})", i + 1, contour.kind)))
    });
    let unit = written.unit.as_deref().map(str::parse).transpose()?;
    Ok(ContourFile {
        contours: estimates.collect::<Result<_>>()?,
        hole_of: contours.iter().map(|contour| contour.hole_of).collect(),
        levels: contours.iter().map(|contour| contour.level).collect(),
        constraints: written.constrained.map(|constrained| {
            // Constraints that follow from the kinds are implied by them.
            let own = constrained.constraints.into_iter().filter(|written| written.from != "kind");
            own.map(|written| written.constraint).collect()
        }),
        unit,
        warnings: written.findings.iter().filter_map(warning).collect(),
    })
}

/// A finding of level warning or error, if its code is known.
fn warning(written: &WrittenFinding) -> Option<Finding> {
    let code = FindingCode::ALL.iter().find(|code| code.as_str() == written.code)?;
    (code.level() != FindingLevel::Info).then(|| Finding::new(*code, written.text.clone()))
}

fn estimate(contour: &WrittenContour) -> Result<EstimatedContour> {
    let kind = kind_of(&contour.kind, &contour.order, contour.closed.unwrap_or(true))?;
    let names = kind.names();
    let count = names.len();
    // A moving contour has further parameters, its velocity, after those of its kind.
    if contour.order.len() < count || contour.order.iter().zip(&names).any(|(order, (name, _))| order != name)
    {
        let wanted: Vec<&str> = names.iter().map(|(name, _)| name.as_str()).collect();
        return Err(Error::input(format!(
            "expected the order {}, found {}",
            wanted.join(" "),
            contour.order.join(" ")
        )));
    }
    let is_square = contour.covariance.iter().all(|row| row.len() == contour.order.len());
    if contour.covariance.len() != contour.order.len() || !is_square {
        return Err(Error::input(format!(
            "expected a covariance of {0} × {0}, found {1} rows",
            contour.order.len(),
            contour.covariance.len()
        )));
    }
    let values = names.iter().map(|(name, factor)| match contour.parameters.get(name) {
        // Files state angles in degrees for people; `theta` has radians.
        Some(written) => Ok(written.value / factor),
        None => Err(Error::input(format!("expected the parameter `{name}`, found none"))),
    });
    Ok(EstimatedContour {
        theta: values.collect::<Result<_>>()?,
        // The leading block is the marginal covariance: a velocity behind it is marginalised.
        covariance: DMatrix::from_fn(count, count, |i, j| {
            // The file is rounded to decimals, so symmetric entries may differ in the last digit.
            0.5 * (contour.covariance[i][j] + contour.covariance[j][i]) / (names[i].1 * names[j].1)
        }),
        kind,
        observed_ends: contour.ends,
    })
}

/// Kind by its name. For a chain, the names of its parameters (`bulgeN`) state which pieces are arcs.
fn kind_of(name: &str, order: &[String], closed: bool) -> Result<ContourKind> {
    if name == "chain" {
        // Unlike `polygon-N`, the name `chain` states no number of corners, so the parameters are counted.
        let corners = order.iter().filter(|name| name.starts_with('x')).count().min(MAX_CORNERS);
        let bulges: Vec<&str> = order.iter().filter_map(|name| name.strip_prefix("bulge")).collect();
        let pieces = corners.saturating_sub(usize::from(!closed));
        return Ok(ContourKind::Chain {
            arcs: (0..pieces).map(|i| bulges.contains(&i.to_string().as_str())).collect(),
            closed,
        });
    }
    ContourKind::from_name(name, MAX_CORNERS).ok_or_else(|| {
        Error::input(format!(
            "kind `{name}`: expected line, circle, ellipse, rectangle, rounded-rectangle, slot, \
             regular-polygon-N, polygon-N or chain"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CIRCLE: &str = r#"{ "kind": "circle", "order": ["center_x", "center_y", "radius"], "unit": "mm",
        "parameters": { "center_x": { "value": 1 }, "center_y": { "value": 2 },
            "radius": { "value": 3, "sigma": 0.2 } },
        "covariance": [[0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.04]] }"#;

    #[test]
    fn a_single_contour_is_read() {
        let file = parse(CIRCLE).unwrap();
        assert_eq!(file.contours[0].theta, [1.0, 2.0, 3.0]);
        assert_eq!((file.contours[0].covariance[(2, 2)], file.unit), (0.04, Some(Unit::Millimetre)));
        assert!(file.constraints.is_none());
    }

    #[test]
    fn an_open_chain_has_one_piece_less_than_corners() {
        let names = ["x0", "y0", "x1", "y1", "x2", "y2", "bulge1"];
        let order = names.map(|name| format!("\"{name}\"")).join(",");
        let parameters = names.map(|name| format!("\"{name}\": {{ \"value\": 0.5 }}")).join(",");
        let row = format!("[{}]", ["0.1"; 7].join(","));
        let covariance = vec![row; 7].join(",");
        let text = format!(
            r#"{{ "kind": "chain", "closed": false, "order": [{order}],
                "parameters": {{ {parameters} }}, "covariance": [{covariance}] }}"#
        );
        let kind = parse(&text).unwrap().contours[0].kind.clone();
        let arcs = vec![false, true];
        assert_eq!(kind, ContourKind::Chain { arcs, closed: false });
        // A closed chain has one more piece, but the same parameters.
        let closed = parse(&text.replace("\"closed\": false,", "")).unwrap();
        assert_eq!(closed.contours[0].kind.pieces(), 3);
    }

    #[test]
    fn errors_name_the_mismatch() {
        for (from, to, expected) in [
            ("\"circle\"", "\"blob\"", "kind `blob`"),
            ("\"circle\"", "\"polygon-2\"", "kind `polygon-2`"),
            ("\"circle\"", "\"ellipse\"", "expected the order center_x center_y semi_major"),
            ("[0, 0.01, 0], ", "", "expected a covariance of 3 × 3, found 2 rows"),
            ("\"radius\": {", "\"size\": {", "expected the parameter `radius`"),
            ("\"mm\"", "\"cubit\"", "unit `cubit`"),
            ("\"kind\"", "\"sort\"", "found none"),
            ("}", "", "expected contours as"),
        ] {
            let error = parse(&CIRCLE.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(expected), "{from} → {to}: {error}");
        }
    }
}
