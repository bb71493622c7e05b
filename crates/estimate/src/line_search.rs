//! Maximum of a function of one variable by golden section with parabolic steps.
//!
//! Input: an interval and an expensive function. Output: the best evaluated point. Not guaranteed: the global
//! maximum if there are several.

use crate::Result;

/// An evaluated point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Evaluated {
    pub(crate) at: f64,
    pub(crate) value: f64,
}

impl Evaluated {
    /// A point that was not evaluated. Its value is below all others.
    fn unknown(at: f64) -> Self {
        Self { at, value: f64::NEG_INFINITY }
    }
}

/// Result of a search.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Maximum {
    pub(crate) best: Evaluated,
    pub(crate) evaluations: usize,
    pub(crate) converged: bool,
}

/// `(3 − √5)/2`, the fraction of golden section.
const GOLDEN: f64 = 0.381_966_011_250_105_1;

/// Maximises over `[low, high]` to `tolerance` in the argument, with at most `limit` evaluations.
pub(crate) fn maximize_between(
    low: f64,
    high: f64,
    tolerance: f64,
    limit: usize,
    mut value_at: impl FnMut(f64) -> Result<f64>,
) -> Result<Maximum> {
    let at = low + GOLDEN * (high - low);
    let inner = Evaluated { at, value: value_at(at)? };
    let [low, high] = [low, high].map(Evaluated::unknown);
    let found = maximize_bracketed([low, inner, high], tolerance, limit.saturating_sub(1), value_at)?;
    Ok(Maximum { evaluations: found.evaluations + 1, ..found })
}

/// Brent's search between two points, starting from a third with a higher value. It also stops when two
/// successive parabolas agree on their vertex.
///
/// Brent, *Algorithms for minimization without derivatives*, 1973, chapter 5.
pub(crate) fn maximize_bracketed(
    [below, inner, above]: [Evaluated; 3],
    tolerance: f64,
    limit: usize,
    mut value_at: impl FnMut(f64) -> Result<f64>,
) -> Result<Maximum> {
    let (mut low, mut high) = (below.at, above.at);
    let mut best = inner;
    // Three best points so far define the parabola. Ends that were not evaluated have value −∞ and yield no
    // step.
    let (mut second, mut third) = if below.value > above.value { (below, above) } else { (above, below) };
    let (mut step, mut step_before_last) = (0.0_f64, high - low);
    let mut follows_parabola = false;
    for evaluations in 0..limit {
        let middle = 0.5 * (low + high);
        // Both ends are within two tolerances of the best point.
        if (best.at - middle).abs() <= 2.0 * tolerance - 0.5 * (high - low) {
            return Ok(Maximum { best, evaluations, converged: true });
        }
        let candidate = parabolic_step(best, second, third);
        // The last step went to the vertex of a parabola, and the new vertex is closer than the tolerance.
        // Without this test the search would continue until the bracket itself is small.
        if follows_parabola && candidate.is_some_and(|candidate| candidate.abs() < tolerance) {
            return Ok(Maximum { best, evaluations, converged: true });
        }
        let parabola = candidate.filter(|&candidate| {
            let target = best.at + candidate;
            // Brent's safeguard: parabolas must at least halve the step every second time, otherwise golden
            // section takes over. This bounds the number of evaluations for functions far from a parabola.
            candidate.abs() < 0.5 * step_before_last.abs() && target > low && target < high
        });
        follows_parabola = parabola.is_some();
        step_before_last = step;
        step = match parabola {
            Some(candidate) => {
                let target = best.at + candidate;
                // So close to an end, one tolerance towards the middle is enough to close the bracket from
                // the other side.
                if target - low < 2.0 * tolerance || high - target < 2.0 * tolerance {
                    tolerance.copysign(middle - best.at)
                } else {
                    candidate
                }
            }
            None => {
                step_before_last = if best.at < middle { high - best.at } else { low - best.at };
                GOLDEN * step_before_last
            }
        };
        // Values closer than the tolerance differ by rounding only, so a shorter step would compare noise.
        let at = best.at + if step.abs() >= tolerance { step } else { tolerance.copysign(step) };
        let trial = Evaluated { at, value: value_at(at)? };
        if trial.value >= best.value {
            if trial.at < best.at {
                high = best.at;
            } else {
                low = best.at;
            }
            (third, second, best) = (second, best, trial);
        } else {
            if trial.at < best.at {
                low = trial.at;
            } else {
                high = trial.at;
            }
            // The points keep their order of value, also while some of them still coincide at the start.
            if trial.value >= second.value || second.at == best.at {
                (third, second) = (second, trial);
            } else if trial.value >= third.value || third.at == best.at || third.at == second.at {
                third = trial;
            }
        }
    }
    Ok(Maximum { best, evaluations: limit, converged: false })
}

/// Step from `best` to the vertex of the parabola through three points; `None` if they are collinear.
fn parabolic_step(best: Evaluated, second: Evaluated, third: Evaluated) -> Option<f64> {
    let r = (best.at - second.at) * (best.value - third.value);
    let q = (best.at - third.at) * (best.value - second.value);
    let numerator = (best.at - third.at) * q - (best.at - second.at) * r;
    let denominator = 2.0 * (q - r);
    let step = -numerator / denominator;
    step.is_finite().then_some(step)
}
