//! Degrees of freedom, redundancy and conflicts of constraints.
//!
//! In: a drawing and constraints, in order of preference. Out: ranks at a witness, smallest redundant and
//! smallest conflicting sets, and the over-, well- and under-determined parts of the structure. Not
//! guaranteed: that a conflict is real if the drawing is far from its dimensions, because the search for a
//! solution starts at the drawing (decision record 0046).

use super::drawing::ParametricDrawing;
use super::draws::Draws;
use super::equations::ConstraintEquations;
use super::minimal::quick_xplain;
use super::rank::{RowRank, row_norms, row_rank};
use super::relation::Constraint;
use super::solve::{ConstraintSolution, solve};
use super::{Decomposition, Incidence};
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result};
use serde::Serialize;

/// A constraint that others imply or contradict.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dependence {
    /// Index of the constraint.
    pub constraint: usize,
    /// Indices of the constraints that together imply or contradict it. The set is minimal.
    pub with: Vec<usize>,
    /// Number of its equations that are implied or contradicted.
    pub equations: usize,
}

/// Degrees of freedom, redundancies and conflicts of a set of constraints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Number of parameters of the drawing.
    pub parameters: usize,
    /// Number of equations of all constraints.
    pub equations: usize,
    /// Rank of the Jacobian of the consistent constraints at the witness.
    pub rank: usize,
    /// The same rank at the solved drawing; smaller if it is in a special position.
    pub rank_at_solution: usize,
    /// Remaining degrees of freedom: parameters minus rank.
    pub freedoms: usize,
    /// Number of those that are rigid motions of the whole drawing, at most three.
    pub rigid_motions: usize,
    /// Redundant constraints, each with the smallest set that implies it.
    pub redundant: Vec<Dependence>,
    /// Conflicting constraints, each with the smallest set that it contradicts.
    pub conflicting: Vec<Dependence>,
    /// Structural decomposition, conflicting constraints included.
    pub structure: Decomposition,
    /// True if a witness in general position was found; otherwise the ranks are those of the solution.
    pub is_generic: bool,
}

/// Relative length of the remainder of a row below which it is a combination of others.
///
/// Solved drawings satisfy constraints to about 1e-10; their gradients then depend on each other to that
/// accuracy, not to rounding.
pub(crate) const ROW_TOLERANCE: f64 = 1e-7;
/// Number of perturbed starts after the search from the drawing has failed.
const STARTS: u64 = 3;

/// Determines degrees of freedom, redundant constraints and conflicting constraints of a drawing.
///
/// - *Conflicts*: while the remaining constraints have no solution, QuickXplain finds a smallest set without
///   one. Its last member in the given order is reported and removed.
/// - *Redundancies*: among the rest, rows of the Jacobian at a [`witness`] that are combinations of earlier
///   rows. The combination gives the set.
/// - *Structure*: [`Incidence::decomposition`]. It uses no numbers and cannot see redundancies that follow
///   from geometry.
///
/// The later of two dependent constraints is reported, so list the certain ones first. Cost: about `k log m`
/// solutions for a conflict of `k` among `m` constraints, and `m² n`.
///
/// # Errors
/// `Input` if a constraint refers to a part that the drawing does not have; `Undetermined` if a constraint
/// has no value at the drawing (for example a bar without length).
///
/// # Examples
/// ```
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, PointId, diagnose};
///
/// let drawing = ParametricDrawing::polygon(&[[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])?;
/// let [bottom, right, top, left] = [0, 1, 2, 3].map(BarId);
/// let constraints = [
///     Constraint::Anchor { point: PointId(0), at: [0.0, 0.0] },
///     Constraint::Horizontal { bar: bottom },
///     Constraint::Vertical { bar: right },
///     Constraint::Horizontal { bar: top },
///     Constraint::Vertical { bar: left },
///     Constraint::Parallel { a: bottom, b: top },
/// ];
/// let diagnosis = diagnose(&drawing, &constraints)?;
/// assert_eq!((diagnosis.freedoms, diagnosis.rigid_motions), (2, 0));
/// let redundant = &diagnosis.redundant[0];
/// assert_eq!((redundant.constraint, redundant.with.as_slice()), (5, [1, 3].as_slice()));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Michelucci and Foufou 2006, *Geometric constraint solving: the witness configuration method*; Junker 2004,
/// *QuickXplain*; Dulmage and Mendelsohn 1958, *Coverings of bipartite graphs*.
pub fn diagnose(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Result<Diagnosis> {
    constraints.iter().try_for_each(|constraint| constraint.require_parts(drawing))?;
    let all = ConstraintEquations::new(drawing, constraints);
    let finite = |x: &DVector<f64>| all.residuals_and_jacobian(x).1.iter().all(|slope| slope.is_finite());
    if !finite(&drawing.values()) {
        return Err(Error::undetermined(
            "expected constraints that are defined for this drawing, found a bar without length, or a \
             distance between coincident points",
        ));
    }
    // Conflicting constraints come out first: ranks do not show them, since the lengths 1, 1 and 5 of a
    // triangle are independent.
    let (kept, conflicting) = without_conflicts(drawing, constraints);
    let consistent: Vec<Constraint> = kept.iter().map(|&i| constraints[i]).collect();
    let solution = satisfy(drawing, &consistent);
    let solved = drawing.with_values(&solution.values)?;
    // Ranks are judged at the witness: the drawing itself may be a special position, where rows depend on
    // each other by accident.
    let generic = witness(&solved, &consistent);
    let equations = ConstraintEquations::new(&solved, &consistent);
    let (_, at_solution) = equations.residuals_and_jacobian(&solved.values());
    let at_witness = match &generic {
        Some(values) => equations.residuals_and_jacobian(values).1,
        None => at_solution.clone(),
    };
    let rank = ranked(&at_witness);
    let place = generic.clone().unwrap_or_else(|| solved.values());
    Ok(Diagnosis {
        parameters: drawing.parameters(),
        equations: all.len(),
        rank: rank.independent.len(),
        rank_at_solution: ranked(&at_solution).independent.len(),
        freedoms: drawing.parameters() - rank.independent.len(),
        rigid_motions: free_motions(&at_witness, &rigid_motions(drawing, &place)),
        redundant: redundancies(&rank, &equations.owners(), &kept),
        conflicting,
        structure: Incidence::new(drawing, constraints).decomposition(),
        is_generic: generic.is_some(),
    })
}

/// Relations that follow from constraints, each with the smallest set that implies it.
///
/// The drawing must satisfy all of them. A relation follows if its gradient is a combination of the gradients
/// of constraints; the combination gives the set. In the result, `constraint` is an index into `relations`
/// and `with` holds indices into `constraints`. Cost: `(m + r) m n` for `r` relations.
///
/// # Errors
/// `Input` if one refers to a part that the drawing does not have.
///
/// # Examples
/// ```
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, implications};
///
/// let plate = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])?;
/// let [bottom, right, top] = [0, 1, 2].map(BarId);
/// let known = [
///     Constraint::Horizontal { bar: bottom },
///     Constraint::Vertical { bar: right },
///     Constraint::Horizontal { bar: top },
/// ];
/// let found = implications(&plate, &known, &[Constraint::Parallel { a: bottom, b: top }])?;
/// assert_eq!((found[0].constraint, found[0].with.as_slice()), (0, [0, 2].as_slice()));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn implications(
    drawing: &ParametricDrawing,
    constraints: &[Constraint],
    relations: &[Constraint],
) -> Result<Vec<Dependence>> {
    let all: Vec<Constraint> = constraints.iter().chain(relations).copied().collect();
    all.iter().try_for_each(|constraint| constraint.require_parts(drawing))?;
    let equations = ConstraintEquations::new(drawing, &all);
    let (_, mut jacobian) = equations.residuals_and_jacobian(&drawing.values());
    // A relation that is undefined at the drawing follows from nothing; NaN would spread to all later rows.
    for mut row in jacobian.row_iter_mut() {
        if row.iter().any(|slope| !slope.is_finite()) {
            row.fill(0.0);
        }
    }
    // Constraints come before relations, so every relation is expressed by constraints where that is
    // possible.
    let owners = equations.owners();
    let numbers: Vec<usize> = (0..all.len()).collect();
    let mut found = redundancies(&ranked(&jacobian), &owners, &numbers);
    // Keep relations of which all equations follow, and from constraints alone.
    found.retain(|dependence| {
        dependence.constraint >= constraints.len()
            && dependence.equations == all[dependence.constraint].equation_count()
            && !dependence.with.is_empty()
            && dependence.with.iter().all(|&other| other < constraints.len())
    });
    for dependence in &mut found {
        dependence.constraint -= constraints.len();
    }
    Ok(found)
}

/// A configuration in general position that satisfies all relations of a drawing, but not its dimensions.
///
/// The drawing is perturbed by a few percent of its extent, and relations without a size (parallel, tangent,
/// …) are restored. Dimensions and anchors take the values that result. Ranks at the witness are those of
/// almost all dimensions, and no coincidence of the drawn sizes affects them. Returns `None` if the relations
/// could not be restored.
#[must_use]
pub fn witness(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Option<DVector<f64>> {
    let values = drawing.values();
    let relations: Vec<Constraint> = constraints
        .iter()
        .filter(|constraint| constraint.measured(drawing, values.as_slice()).is_none())
        .copied()
        .collect();
    // A large perturbation leaves special positions most clearly, but relations may then not be restored.
    [0.05, 0.02, 0.005]
        .iter()
        .enumerate()
        .filter_map(|(seed, &share)| {
            drawing.with_values(&perturbed(&values, share * drawing.extent(), seed as u64)).ok()
        })
        .map(|moved| solve(&moved, &relations))
        .find(|solution| solution.holds)
        .map(|solution| solution.values)
}

/// Indices of a consistent subset of the constraints, and the conflicts that were removed.
fn without_conflicts(
    drawing: &ParametricDrawing,
    constraints: &[Constraint],
) -> (Vec<usize>, Vec<Dependence>) {
    let mut kept: Vec<usize> = (0..constraints.len()).collect();
    let mut conflicting = Vec::new();
    loop {
        let found = quick_xplain(kept.len(), |chosen| {
            let chosen: Vec<Constraint> = chosen.iter().map(|&i| constraints[kept[i]]).collect();
            satisfy(drawing, &chosen).holds
        });
        // The last member is the least preferred one.
        let Some((&last, others)) = found.split_last() else {
            break;
        };
        conflicting.push(Dependence {
            constraint: kept[last],
            with: others.iter().map(|&i| kept[i]).collect(),
            equations: constraints[kept[last]].equation_count(),
        });
        kept.remove(last);
    }
    conflicting.sort_by_key(|dependence| dependence.constraint);
    (kept, conflicting)
}

/// [`solve`] from the drawing, and if that fails, from perturbed drawings: a start in a special position can
/// have a singular Jacobian from which no step leads to a solution.
pub(crate) fn satisfy(drawing: &ParametricDrawing, constraints: &[Constraint]) -> ConstraintSolution {
    let first = solve(drawing, constraints);
    if first.holds {
        return first;
    }
    (0..STARTS)
        .filter_map(|seed| {
            let start = perturbed(&drawing.values(), 0.1 * drawing.extent(), 100 + seed);
            Some(solve(&drawing.with_values(&start).ok()?, constraints))
        })
        .find(|solution| solution.holds)
        .unwrap_or(first)
}

/// Independent and dependent rows of a Jacobian.
fn ranked(jacobian: &DMatrix<f64>) -> RowRank {
    row_rank(jacobian, &row_norms(jacobian), ROW_TOLERANCE)
}

/// Number of independent combinations of motions that change no equation.
fn free_motions(jacobian: &DMatrix<f64>, motions: &DMatrix<f64>) -> usize {
    let changes = (jacobian * motions).transpose();
    // Changes by a motion are compared with the size of the Jacobian: those of free motions are rounding.
    let size = jacobian.norm() * motions.amax();
    motions.ncols() - row_rank(&changes, &[size; 3], ROW_TOLERANCE).independent.len()
}

/// Dependent rows grouped by constraint, with indices into the original list.
fn redundancies(rank: &RowRank, owners: &[usize], kept: &[usize]) -> Vec<Dependence> {
    let mut found: Vec<Dependence> = Vec::new();
    for dependent in &rank.dependent {
        let constraint = kept[owners[dependent.row]];
        let mut with: Vec<usize> = dependent.combination.iter().map(|&row| kept[owners[row]]).collect();
        if let Some(known) = found.iter_mut().find(|known| known.constraint == constraint) {
            known.equations += 1;
            with.append(&mut known.with);
            known.with = with;
        } else {
            found.push(Dependence { constraint, with, equations: 1 });
        }
    }
    for dependence in &mut found {
        dependence.with.retain(|&other| other != dependence.constraint);
        dependence.with.sort_unstable();
        dependence.with.dedup();
    }
    found
}

/// Derivatives of the parameters by both translations and the rotation about the origin, as columns.
fn rigid_motions(drawing: &ParametricDrawing, x: &DVector<f64>) -> DMatrix<f64> {
    let mut motions = DMatrix::zeros(x.len(), 3);
    let size = drawing.extent();
    for point in drawing.points() {
        let [i, j] = drawing.coordinates(point);
        motions[(i, 0)] = 1.0;
        motions[(j, 1)] = 1.0;
        // Divided by the extent, a rotation changes parameters as much as a translation does.
        motions[(i, 2)] = -x[j] / size;
        motions[(j, 2)] = x[i] / size;
    }
    motions
}

/// The values, each changed by a random amount up to ±`reach`.
fn perturbed(values: &DVector<f64>, reach: f64, seed: u64) -> DVector<f64> {
    let mut draws = Draws::new(seed);
    values.map(|value| value + reach * draws.uniform())
}
