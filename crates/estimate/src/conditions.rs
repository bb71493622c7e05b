//! Adjustment of values by conditions: the smallest weighted change of values x so that c(x) = 0.
//!
//! Each step solves the linearised conditions J d = −c with the smallest Σ dᵢ²/σᵢ², which is
//! d = −S Jᵀ (J S Jᵀ)⁻¹ c with S = diag(σ²).
//!
//! Not guaranteed: conditions that contradict others are left out by the size of their residuals; this is not
//! a smallest set.
//!
//! # References
//! Mikhail and Ackermann 1976, *Observations and least squares*, chapter 9 (adjustment of observations only).

use nalgebra::{DMatrix, DVector};

/// Maximum number of steps of Newton's method.
const STEPS: usize = 30;
/// Maximum number of conditions; the effort grows with its cube.
const MAX_CONDITIONS: usize = 1000;
/// Maximum number of times that contradicting conditions are left out.
const MAX_REPEATS: usize = 8;
/// Added to the diagonal of the normal matrix, whose entries there are 1: conditions may follow from others.
const RIDGE: f64 = 1e-9;

/// A condition: its residual at some values, and its derivatives by them. An index may occur twice; its
/// derivatives are then added.
pub type Condition<'a> = Box<dyn Fn(&[f64]) -> (f64, Vec<(usize, f64)>) + 'a>;

/// Variance of the residual of a condition at values with independent errors, in the squared unit of the
/// residual.
///
/// ```
/// use planish_estimate::{Condition, residual_variance};
///
/// let equal: Condition = Box::new(|x| (x[0] - x[1], vec![(0, 1.0), (1, -1.0)]));
/// assert_eq!(residual_variance(&equal, &[2.0, 2.1], |_| 0.1), 0.1 * 0.1 + 0.1 * 0.1);
/// ```
#[must_use]
pub fn residual_variance(condition: &Condition, values: &[f64], sigma: impl Fn(usize) -> f64) -> f64 {
    let mut slopes = condition(values).1;
    slopes.sort_by_key(|slope| slope.0);
    let sums = slopes.chunk_by(|a, b| a.0 == b.0);
    sums.map(|same| (same.iter().map(|s| s.1).sum::<f64>() * sigma(same[0].0)).powi(2)).sum()
}

/// The values that meet all conditions, and the residuals that are left; those of conditions that contradict
/// each other are not small. `None` if there are more than 1000 conditions, or if a value is not finite.
///
/// `sigmas` are the weights of the changes; a residual below `solved` is met. The effort grows with the cube
/// of the number of conditions.
///
/// ```
/// use planish_estimate::{Condition, adjusted};
///
/// // Two lengths and their sum; the sum is known better.
/// let sum: Condition = Box::new(|x| (x[0] + x[1] - x[2], vec![(0, 1.0), (1, 1.0), (2, -1.0)]));
/// let (values, residuals) = adjusted(&[1.0, 2.0, 3.3], &[0.1, 0.1, 0.01], &[&sum], 1e-12).unwrap();
/// assert!((values[0] - 1.149).abs() < 1e-3 && residuals[0] < 1e-12);
/// ```
#[must_use]
pub fn adjusted(
    start: &[f64],
    sigmas: &[f64],
    conditions: &[&Condition<'_>],
    solved: f64,
) -> Option<(Vec<f64>, Vec<f64>)> {
    if conditions.len() > MAX_CONDITIONS {
        return None;
    }
    let mut x = start.to_vec();
    for _ in 0..STEPS {
        let Some((residuals, rows)) = linearised(&x, sigmas, conditions, solved) else { break };
        let weights = normal_matrix(&rows, x.len()).cholesky()?.solve(&residuals);
        for (row, weight) in rows.iter().zip(weights.iter()) {
            row.iter().for_each(|(k, slope)| x[*k] -= sigmas[*k] * slope * weight);
        }
        if x.iter().any(|v| !v.is_finite()) {
            return None;
        }
    }
    let residuals = conditions.iter().map(|c| c(&x).0.abs()).collect();
    Some((x, residuals))
}

/// Residuals, and rows of derivatives by values over their σ. Each row has length 1. `None` if all conditions
/// are met.
fn linearised(
    x: &[f64],
    sigmas: &[f64],
    conditions: &[&Condition<'_>],
    solved: f64,
) -> Option<(DVector<f64>, Vec<Row>)> {
    let mut is_met = true;
    let mut residuals = DVector::zeros(conditions.len());
    let mut rows = Vec::with_capacity(conditions.len());
    for (at, condition) in conditions.iter().enumerate() {
        let (residual, mut slopes) = condition(x);
        is_met &= residual.abs() < solved;
        slopes.sort_by_key(|slope| slope.0);
        let sums = slopes.chunk_by(|a, b| a.0 == b.0);
        let mut row: Row =
            sums.map(|s| (s[0].0, s.iter().map(|s| s.1).sum::<f64>() * sigmas[s[0].0])).collect();
        let length = row.iter().map(|s| s.1 * s.1).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        row.iter_mut().for_each(|s| s.1 /= length);
        residuals[at] = residual / length;
        rows.push(row);
    }
    (!is_met).then_some((residuals, rows))
}

/// Nonzero derivatives of a condition, by index.
type Row = Vec<(usize, f64)>;

/// J S Jᵀ of rows of J S^½.
fn normal_matrix(rows: &[Row], count: usize) -> DMatrix<f64> {
    let mut normal: DMatrix<f64> = DMatrix::zeros(rows.len(), rows.len());
    let mut of_value: Vec<Vec<(usize, f64)>> = vec![Vec::new(); count];
    for (at, row) in rows.iter().enumerate() {
        row.iter().for_each(|(k, slope)| of_value[*k].push((at, *slope)));
        normal[(at, at)] += RIDGE;
    }
    for uses in of_value {
        for (a, first) in &uses {
            uses.iter().for_each(|(b, second)| normal[(*a, *b)] += first * second);
        }
    }
    normal
}

/// The values that meet as many conditions as are compatible: those that contradict others, and those that
/// change a value by more than its limit, are left out. Returns the start values if no set is found.
///
/// `max_change` is the limit of a value.
#[must_use]
pub fn adjusted_without_conflicts(
    start: &[f64],
    sigmas: &[f64],
    mut conditions: Vec<Condition<'_>>,
    solved: f64,
    max_change: impl Fn(usize) -> f64,
) -> Vec<f64> {
    for _ in 0..MAX_REPEATS {
        let before = conditions.len();
        let all: Vec<&Condition<'_>> = conditions.iter().collect();
        let Some((found, residuals)) = adjusted(start, sigmas, &all, solved) else { break };
        let largest = residuals.iter().copied().fold(0.0, f64::max);
        let is_moved: Vec<bool> =
            (0..found.len()).map(|k| (found[k] - start[k]).abs() > max_change(k)).collect();
        // Dependent conditions converge slowly, to a residual that is not quite met.
        let met = 1e3 * solved;
        if largest < met && !is_moved.contains(&true) {
            return found;
        }
        // Those that contradict others have large residuals.
        let mut left = residuals.iter();
        conditions.retain(|condition| {
            let is_met = left.next().is_some_and(|r| *r < (0.5 * largest).max(met));
            is_met && (largest >= met || condition(start).1.iter().all(|(k, _)| !is_moved[*k]))
        });
        if conditions.len() == before {
            break;
        }
    }
    start.to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_moves_onto_a_circle_and_dependent_conditions_do_no_harm() {
        // A point, and the radius of a circle around the origin, which is less accurate.
        let on_circle = |x: &[f64]| {
            let length = x[0].hypot(x[1]);
            (length - x[2], vec![(0, x[0] / length), (1, x[1] / length), (2, -1.0)])
        };
        let on_circle: Condition<'_> = Box::new(on_circle);
        let twice = [&on_circle, &on_circle];
        let (found, _) = adjusted(&[3.0, 4.0, 6.0], &[0.1, 0.1, 1.0], &twice, 1e-9).unwrap();
        assert!((found[0].hypot(found[1]) - found[2]).abs() < 1e-8, "{found:?}");
        assert!((found[2] - 5.0).abs() < 0.05, "{found:?}");
        let contradiction: Vec<Condition<'_>> =
            vec![Box::new(|x| (x[0] - 1.0, vec![(0, 1.0)])), Box::new(|x| (x[0] - 2.0, vec![(0, 1.0)]))];
        let (_, residuals) =
            adjusted(&[1.0], &[1.0], &contradiction.iter().collect::<Vec<_>>(), 1e-9).unwrap();
        assert!(residuals.iter().all(|r| (r - 0.5).abs() < 1e-3), "{residuals:?}");
    }

    #[test]
    fn a_condition_that_contradicts_others_is_left_out() {
        let equal = |a: usize, b: usize, by: f64| -> Condition<'static> {
            Box::new(move |x| (x[a] - x[b] - by, vec![(a, 1.0), (b, -1.0)]))
        };
        // Three conditions agree that x₁ = x₀ + 1; one states 1.4.
        let all = vec![equal(1, 0, 1.0), equal(1, 0, 1.0), equal(1, 0, 1.4), equal(1, 0, 1.0)];
        let found = adjusted_without_conflicts(&[0.0, 1.02], &[1.0, 1.0], all, 1e-12, |_| 0.1);
        assert!((found[1] - found[0] - 1.0).abs() < 1e-9, "{found:?}");
        // A change beyond the limit is not made.
        let far =
            adjusted_without_conflicts(&[0.0, 1.5], &[1.0, 1.0], vec![equal(1, 0, 1.0)], 1e-12, |_| 0.1);
        assert_eq!(far, [0.0, 1.5]);
    }
}
