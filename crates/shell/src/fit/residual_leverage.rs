//! The effect of a fit on its residuals: `s − H s` of random signs `s`, with `H = A N⁻¹ Aᵀ` of the whitened
//! equations `A`.
//!
//! In: the final equations, and their information with priors. Out: the signs and their residuals after the
//! fit. It takes two passes over the rows and never forms the covariance of residuals.

use super::correlation::DRAWS;
use super::dense::Factor;
use super::equations::{Equation, EquationRow, Equations, SCALES};
use super::undetermined;
use crate::deformation::Deformation;
use nalgebra::{DMatrix, DVector};
use planish_estimate::Result;
use rayon::prelude::*;

/// Number of partial sums; fixed, so that the result does not depend on the number of threads.
const GROUPS: usize = 16;

/// Signs of an equation, and their residuals after the fit.
pub(super) type Signs = [[f64; DRAWS]; 2];

/// Computes the signs of every equation and their residuals after the fit. `slope` is `E[ψ']` of the loss,
/// `information` is that of all equations with the priors, and `counts` selects the equations with a weight.
pub(super) fn leverage_of_signs(
    equations: &[Equations],
    deformation: &dyn Deformation,
    (information, slope): (&DMatrix<f64>, f64),
    factors: &[f64; SCALES],
    counts: impl Fn(&Equation) -> bool + Sync,
) -> Result<Vec<Signs>> {
    let basis = deformation.basis();
    let parameters = deformation.parameters();
    let rest = information.nrows() - parameters;
    // Numbers of equations over all groups, from which their signs are hashed.
    let firsts: Vec<usize> = (equations.iter())
        .scan(0, |next, some| {
            let first = *next;
            *next += some.list.len();
            Some(first)
        })
        .collect();
    let sigma_of = |e: &Equation| e.sigma * factors[e.source.scale()];
    let row_of_equation = || EquationRow::new(deformation, rest / 6);
    let groups = equations.len().div_ceil(GROUPS).max(1);
    let sums: Vec<DMatrix<f64>> = (equations.par_chunks(groups).zip(firsts.par_chunks(groups)))
        .map(|(group, firsts)| {
            let mut sum = DMatrix::zeros(basis + rest, DRAWS);
            let mut row = row_of_equation();
            for (some, first) in group.iter().zip(firsts) {
                for (n, (equation, vertices, poses)) in some.iter().enumerate() {
                    if !counts(equation) {
                        continue;
                    }
                    let weight = slope * equation.chance.0 / sigma_of(equation);
                    // Random signs have independent components of unit variance, so products of `H s`
                    // estimate entries of H (Hutchinson). Hashed from the index, they need no memory and are
                    // the same in both passes, for any number of threads.
                    let signs = signs_of(first + n);
                    for &(k, entry) in row.of(vertices, poses) {
                        for (draw, sign) in signs.iter().enumerate() {
                            sum[(k, draw)] += weight * sign * entry;
                        }
                    }
                }
            }
            sum
        })
        .collect();
    let mut sum = DMatrix::zeros(basis + rest, DRAWS);
    sums.iter().for_each(|some| sum += some);
    // `H s = A N⁻¹ (Aᵀ s)`: the two passes apply `Aᵀ` and `A`, and `H` itself, as large as the square of the
    // readings, is never formed.
    let factor = Factor::new(information).ok_or_else(undetermined)?;
    let mut moved = DMatrix::zeros(basis + rest, DRAWS);
    for draw in 0..DRAWS {
        let own = sum.view((0, draw), (basis, 1));
        let mut right = DVector::zeros(parameters + rest);
        match deformation.reduction() {
            Some(r) => right.rows_mut(0, parameters).copy_from(&r.tr_mul(&own)),
            None => right.rows_mut(0, parameters).copy_from(&own),
        }
        (right.rows_mut(parameters, rest)).copy_from(&sum.view((basis, draw), (rest, 1)));
        let x = factor.solve(&right);
        let own = x.rows(0, parameters).into_owned();
        let in_basis = crate::deformation::in_basis(deformation, &own);
        moved.view_mut((0, draw), (basis, 1)).copy_from(&in_basis);
        moved.view_mut((basis, draw), (rest, 1)).copy_from(&x.rows(parameters, rest));
    }
    let left: Vec<Vec<Signs>> = (equations.par_iter().zip(&firsts))
        .map_init(row_of_equation, |row, (some, first)| {
            some.iter()
                .enumerate()
                .map(|(n, (equation, vertices, poses))| {
                    let signs = signs_of(first + n);
                    let mut left = signs;
                    if counts(equation) {
                        let by = 1.0 / sigma_of(equation);
                        for &(k, entry) in row.of(vertices, poses) {
                            for (draw, left) in left.iter_mut().enumerate() {
                                *left -= by * entry * moved[(k, draw)];
                            }
                        }
                    }
                    [signs, left]
                })
                .collect()
        })
        .collect();
    Ok(left.into_iter().flatten().collect())
}

/// Random signs of equation `i`, by a hash: independent of order and threads.
fn signs_of(i: usize) -> [f64; DRAWS] {
    let x = planish_core::random::nth(i as u64);
    std::array::from_fn(|draw| if x >> draw & 1 == 0 { 1.0 } else { -1.0 })
}
