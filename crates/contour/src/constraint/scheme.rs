//! Dimensions that, with given relations, determine a drawing completely.
//!
//! In: a drawing and its relations. Out: a minimal set of dimensions for the remaining degrees of freedom,
//! each with its value and σ. Not guaranteed: the dimensions that a designer would choose.

use super::diagnose::ROW_TOLERANCE;
use super::drawing::ParametricDrawing;
use super::equations::ConstraintEquations;
use super::rank::{row_norms, row_rank};
use super::relation::{Axis, Constraint};
use nalgebra::DMatrix;
use serde::Serialize;

/// A dimension with its value and σ.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Dimensioned {
    /// The constraint with its value.
    #[serde(flatten)]
    pub constraint: Constraint,
    /// The constraint as text.
    pub text: String,
    /// σ of its value; of an anchor, the larger one of both coordinates.
    pub sigma: f64,
}

/// Dimensions that complete constraints to as many independent equations as there are parameters.
///
/// The scheme of the paper (section 3): an anchor point first, then lengths of bars and radii. Distances of
/// points from bars, distances from the first point, and coordinates follow for the rest. A dimension is
/// added if its gradient at the drawing does not depend on those before it. Cost: `(m + d)² n` for `d`
/// candidate dimensions, about the number of points times that of bars.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, diagnose, dimension_scheme};
///
/// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [0.0, 30.0]])?;
/// let mut all = vec![
///     Constraint::Horizontal { bar: BarId(0) },
///     Constraint::Perpendicular { a: BarId(0), b: BarId(2) },
/// ];
/// let scheme = dimension_scheme(&triangle, &(DMatrix::identity(6, 6) * 0.01), &all);
/// let texts: Vec<&str> = scheme.iter().map(|dimension| dimension.text.as_str()).collect();
/// assert_eq!(texts, ["P1 at (0, 0)", "P1P2 is 40 long", "P2P3 is 50 long"]);
/// all.extend(scheme.iter().map(|dimension| dimension.constraint));
/// assert_eq!(diagnose(&triangle, &all)?.freedoms, 0);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Weiss-Cohen, Bondarenko and Halevi 2009, section 3.
#[must_use]
pub fn dimension_scheme(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    constraints: &[Constraint],
) -> Vec<Dimensioned> {
    let x = drawing.values();
    let candidates: Vec<Constraint> = dimensions(drawing)
        .into_iter()
        .filter(|dimension| {
            let equations = dimension.equations(drawing, x.as_slice());
            equations.iter().all(super::equations::Equation::is_finite)
        })
        .collect();
    // Constraints first: `row_rank` keeps earlier rows, so a dimension that they imply is not added.
    let mut all = constraints.to_vec();
    all.extend(&candidates);
    let equations = ConstraintEquations::new(drawing, &all);
    let (_, jacobian) = equations.residuals_and_jacobian(&x);
    let independent = row_rank(&jacobian, &row_norms(&jacobian), ROW_TOLERANCE).independent;
    let owners = equations.owners();
    let mut selected: Vec<usize> =
        independent.iter().map(|&row| owners[row]).filter(|&owner| owner >= constraints.len()).collect();
    // An anchor has two equations. If one of its coordinates is already fixed, only the other one is a
    // dimension.
    let selected_rows: Vec<usize> = selected.clone();
    selected.dedup();
    selected
        .into_iter()
        .map(|owner| {
            let rows = selected_rows.iter().filter(|&&row_owner| row_owner == owner).count();
            let dimension = match all[owner] {
                Constraint::Anchor { point, at } if rows == 1 => {
                    let first = owners.iter().position(|&o| o == owner).unwrap_or_default();
                    let axis = if independent.contains(&first) { Axis::X } else { Axis::Y };
                    Constraint::Coordinate { point, axis, value: at[axis as usize] }
                }
                other => other,
            };
            Dimensioned {
                constraint: dimension,
                text: dimension.describe(drawing),
                sigma: sigma(&dimension, drawing, covariance),
            }
        })
        .collect()
}

/// σ of a constraint under a covariance: of a dimension, that of its value. For two equations, the larger σ.
#[must_use]
pub fn sigma(constraint: &Constraint, drawing: &ParametricDrawing, covariance: &DMatrix<f64>) -> f64 {
    let equations = constraint.equations(drawing, drawing.values().as_slice());
    let variance = |gradient: &[(usize, f64)]| -> f64 {
        let terms = gradient.iter().flat_map(|a| gradient.iter().map(move |b| (a, b)));
        terms.map(|(&(i, a), &(j, b))| a * b * covariance[(i, j)]).sum()
    };
    let largest = equations.iter().map(|equation| variance(&equation.gradient)).fold(0.0, f64::max);
    largest.sqrt()
}

/// Candidate dimensions in order of preference, with their values in the drawing.
fn dimensions(drawing: &ParametricDrawing) -> Vec<Constraint> {
    let mut found = Vec::new();
    let points: Vec<_> = drawing.points().collect();
    let Some(&first) = points.first() else {
        return found;
    };
    found.push(Constraint::Anchor { point: first, at: [0.0; 2] });
    for bar in drawing.bars() {
        let [a, b] = drawing.ends(bar);
        found.push(Constraint::Distance { a, b, value: 1.0 });
    }
    found.extend(drawing.circles().map(|circle| Constraint::Radius { circle, value: 1.0 }));
    for &point in &points {
        // A few bars per point are enough to fix it; all of them would make the table much larger.
        for bar in drawing.bars().filter(|&bar| !drawing.ends(bar).contains(&point)).take(4) {
            found.push(Constraint::PointLineDistance { point, bar, value: 1.0 });
        }
    }
    found.extend(points[1..].iter().map(|&b| Constraint::Distance { a: first, b, value: 1.0 }));
    for &point in &points {
        found.extend([Axis::Y, Axis::X].map(|axis| Constraint::Coordinate { point, axis, value: 0.0 }));
    }
    let x = drawing.values();
    found.iter().filter_map(|dimension| dimension.measured(drawing, x.as_slice())).collect()
}
