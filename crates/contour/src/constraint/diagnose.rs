//! How many freedoms constraints leave, which are redundant, and which contradict each other.
//!
//! Comes in: a drawing and constraints, in order of preference. Goes out: ranks at a witness, smallest
//! redundant and smallest conflicting sets, and the structure's over-, well- and under-determined parts. Not
//! guaranteed: that a conflict is real where the drawing is far from what its dimensions say; the search for
//! a solution starts there.

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

/// A constraint that others make needless, or impossible.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dependence {
    /// The constraint, by its index.
    pub constraint: usize,
    /// The constraints, all before it, that together imply or contradict it; none can be left out.
    pub with: Vec<usize>,
    /// How many of its equations are concerned.
    pub equations: usize,
}

/// What constraints leave free, and what is wrong with them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Diagnosis {
    /// Parameters of the drawing.
    pub parameters: usize,
    /// Equations, of all constraints.
    pub equations: usize,
    /// The rank of the Jacobian of those that hold together, at the witness.
    pub rank: usize,
    /// The same at the drawing that obeys them; less where it is a special position.
    pub rank_at_solution: usize,
    /// Parameters less rank: what is still free.
    pub freedoms: usize,
    /// How many of those freedoms are motions of the whole, at most three.
    pub rigid_motions: usize,
    /// Constraints that say nothing new, each with the smallest set that implies it.
    pub redundant: Vec<Dependence>,
    /// Constraints that cannot hold, each with the smallest set that it contradicts.
    pub conflicting: Vec<Dependence>,
    /// The parts of the structure, conflicting constraints included.
    pub structure: Decomposition,
    /// Whether the witness is in general position; else the ranks are those of the solution.
    pub is_generic: bool,
}

/// Relative length of what is left of a row that is taken for a combination of others.
pub(crate) const ROW_TOLERANCE: f64 = 1e-7;
const STARTS: u64 = 3;

/// Freedoms, redundant and conflicting constraints of a drawing.
///
/// *Conflicting*: as long as all that is left has no solution, the smallest set without one is found
/// (QuickXplain) and its last member, in the order given, is set aside. *Redundant*: of the rest, rows of the
/// Jacobian at a [`witness`] that are combinations of earlier ones; the combination names the set. So both
/// name the later of two that exclude each other: state what is sure first. *Structure*:
/// [`Incidence::decomposition`], which sees no numbers, and takes a redundancy that geometry makes for a
/// constraint. Cost: some `k log m` solutions for a conflict of `k` among `m`, and `m² n`.
///
/// # Errors
/// `Input` when a constraint names a part that is not there; `Undetermined` when constraints have no numbers
/// at the drawing (a bar without length).
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
            "a constraint is not defined where the drawing is: a bar has no length, or two points of a \
             distance coincide",
        ));
    }
    let (kept, conflicting) = without_conflicts(drawing, constraints);
    let consistent: Vec<Constraint> = kept.iter().map(|&i| constraints[i]).collect();
    let solution = satisfy(drawing, &consistent);
    let solved = drawing.with_values(&solution.values)?;
    let generic = witness(&solved, &consistent);
    let equations = ConstraintEquations::new(&solved, &consistent);
    let (_, here) = equations.residuals_and_jacobian(&solved.values());
    let at_witness = match &generic {
        Some(values) => equations.residuals_and_jacobian(values).1,
        None => here.clone(),
    };
    let rank = ranked(&at_witness);
    let place = generic.clone().unwrap_or_else(|| solved.values());
    Ok(Diagnosis {
        parameters: drawing.parameters(),
        equations: all.len(),
        rank: rank.independent.len(),
        rank_at_solution: ranked(&here).independent.len(),
        freedoms: drawing.parameters() - rank.independent.len(),
        rigid_motions: free_motions(&at_witness, &rigid_motions(drawing, &place)),
        redundant: redundancies(&rank, &equations.owners(), &kept),
        conflicting,
        structure: Incidence::new(drawing, constraints).decomposition(),
        is_generic: generic.is_some(),
    })
}

/// Of relations that a drawing obeys anyway, those that follow from constraints, each with the smallest set
/// it follows from.
///
/// Judged at the drawing, which must obey all of them: the gradient of one that follows is a combination of
/// theirs, and the combination names the set. `constraint` counts the relations, `with` the constraints.
/// Cost: `(m + r) m n` for `r` relations.
///
/// # Errors
/// `Input` when one names a part that is not there.
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
    // One without a value where the drawing is follows from nothing.
    for mut row in jacobian.row_iter_mut() {
        if row.iter().any(|slope| !slope.is_finite()) {
            row.fill(0.0);
        }
    }
    let owners = equations.owners();
    let numbers: Vec<usize> = (0..all.len()).collect();
    let mut found = redundancies(&ranked(&jacobian), &owners, &numbers);
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

/// A configuration in general position that obeys every relation of a drawing, whatever its dimensions.
///
/// The drawing is shaken by some percent of its extent, and relations without a size (parallel, tangent, …)
/// are restored; dimensions and anchors are then taken as they came out. Ranks there are those of almost all
/// dimensions: no accident of the drawing counts. `None` where relations could not be restored.
#[must_use]
pub fn witness(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Option<DVector<f64>> {
    let values = drawing.values();
    let relations: Vec<Constraint> = constraints
        .iter()
        .filter(|constraint| constraint.measured(drawing, values.as_slice()).is_none())
        .copied()
        .collect();
    [0.05, 0.02, 0.005]
        .iter()
        .enumerate()
        .filter_map(|(seed, &share)| {
            drawing.with_values(&shaken(&values, share * drawing.extent(), seed as u64)).ok()
        })
        .map(|moved| solve(&moved, &relations))
        .find(|solution| solution.holds)
        .map(|solution| solution.values)
}

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

/// [`solve`] from the drawing, and where that fails from shaken ones.
pub(crate) fn satisfy(drawing: &ParametricDrawing, constraints: &[Constraint]) -> ConstraintSolution {
    let first = solve(drawing, constraints);
    if first.holds {
        return first;
    }
    (0..STARTS)
        .filter_map(|seed| {
            let start = shaken(&drawing.values(), 0.1 * drawing.extent(), 100 + seed);
            Some(solve(&drawing.with_values(&start).ok()?, constraints))
        })
        .find(|solution| solution.holds)
        .unwrap_or(first)
}

fn ranked(jacobian: &DMatrix<f64>) -> RowRank {
    row_rank(jacobian, &row_norms(jacobian), ROW_TOLERANCE)
}

/// How many combinations of motions change no equation.
fn free_motions(jacobian: &DMatrix<f64>, motions: &DMatrix<f64>) -> usize {
    let changes = (jacobian * motions).transpose();
    let size = jacobian.norm() * motions.amax();
    motions.ncols() - row_rank(&changes, &[size; 3], ROW_TOLERANCE).independent.len()
}

fn redundancies(rank: &RowRank, owners: &[usize], kept: &[usize]) -> Vec<Dependence> {
    let mut found: Vec<Dependence> = Vec::new();
    for dependent in &rank.dependent {
        let constraint = kept[owners[dependent.row]];
        let mut with: Vec<usize> = dependent.of.iter().map(|&row| kept[owners[row]]).collect();
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

/// Both translations and the rotation about the origin, as changes of the parameters; columns.
fn rigid_motions(drawing: &ParametricDrawing, x: &DVector<f64>) -> DMatrix<f64> {
    let mut motions = DMatrix::zeros(x.len(), 3);
    let size = drawing.extent();
    for point in drawing.points() {
        let [i, j] = drawing.coordinates(point);
        motions[(i, 0)] = 1.0;
        motions[(j, 1)] = 1.0;
        motions[(i, 2)] = -x[j] / size;
        motions[(j, 2)] = x[i] / size;
    }
    motions
}

/// The values, each moved by up to `reach` either way.
fn shaken(values: &DVector<f64>, reach: f64, seed: u64) -> DVector<f64> {
    let mut draws = Draws::new(seed);
    values.map(|value| value + reach * draws.uniform())
}
