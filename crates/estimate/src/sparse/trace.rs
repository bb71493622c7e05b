//! Trace of a covariance times a matrix by random probes, cheaper than a selected inverse.
//!
//! Input: a factor, a matrix, a seed. Output: an estimate with its standard error; the same seed gives the
//! same result.

use super::{BlockInformation, CholeskyFactor};
use crate::{Error, Result};
use planish_core::random::SplitMix64;

/// Number of probes solved together.
const BATCH: usize = 8;

/// Estimate of a trace by random probes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceEstimate {
    /// The mean over the probes; unbiased.
    pub value: f64,
    /// The standard error of the mean; NaN for a single probe.
    pub standard_error: f64,
    /// Number of probes.
    pub probes: usize,
}

/// `tr(Λ⁻¹ K)` as the mean of `(Λ⁻¹ z)ᵀ K z` over random `z` of independent ±1.
///
/// `matrix` has as many unknowns as the factor; its pattern may differ. Cost: one solution per probe.
///
/// # Errors
/// `Input` when the dimensions differ or `probes` is zero.
///
/// # Examples
/// A diagonal matrix has no cross terms, so a single probe is exact:
/// ```
/// use planish_estimate::sparse::{
///     BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SymbolicFactor, stochastic_trace,
/// };
/// use std::sync::Arc;
///
/// let pattern = Arc::new(BlockPattern::from_elements(3, [[0], [1], [2]])?);
/// let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(3), 1)?);
/// let mut information = BlockInformation::zeros(pattern, 1, 0)?;
/// information.add_diagonal(4.0);
/// let factor = CholeskyFactor::factorize(&symbolic, &information)?;
/// let trace = stochastic_trace(&factor, &information, 1, 42)?;
/// assert!((trace.value - 3.0).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Hutchinson, *A stochastic estimator of the trace of the influence matrix for Laplacian smoothing splines*,
/// 1989.
pub fn stochastic_trace(
    factor: &CholeskyFactor,
    matrix: &BlockInformation,
    probes: usize,
    seed: u64,
) -> Result<TraceEstimate> {
    let dimension = factor.symbolic().dimension();
    if matrix.dimension() != dimension || probes == 0 {
        return Err(Error::input(format!(
            "expected probes and a matrix of dimension {dimension} for a trace, found {probes} probes and \
             dimension {}",
            matrix.dimension()
        )));
    }
    // Signs have the smallest variance of all probes: their squares are 1, so diagonal entries contribute no
    // error.
    let mut signs = Signs { random: SplitMix64::new(seed), bits: 0, left: 0 };
    let mut samples: Vec<f64> = Vec::with_capacity(probes);
    while samples.len() < probes {
        // Together, because a solution is limited by reading the factor from memory, once per batch.
        let columns = BATCH.min(probes - samples.len());
        // Draw probe by probe, so that the first probes do not depend on the total number.
        let mut z = vec![0.0; dimension * columns];
        for column in 0..columns {
            for row in 0..dimension {
                z[row * columns + column] = signs.draw();
            }
        }
        let mut product = vec![0.0; z.len()];
        matrix.multiply(&z, &mut product)?;
        factor.solve_in_place(&mut product)?;
        for column in 0..columns {
            samples.push(
                (0..dimension).map(|row| z[row * columns + column] * product[row * columns + column]).sum(),
            );
        }
    }
    let count = probes as f64;
    let value = samples.iter().sum::<f64>() / count;
    let spread: f64 = samples.iter().map(|sample| (sample - value) * (sample - value)).sum();
    Ok(TraceEstimate { value, standard_error: (spread / (count - 1.0) / count).sqrt(), probes })
}

/// Random signs, 64 from each number drawn.
struct Signs {
    random: SplitMix64,
    bits: u64,
    left: u32,
}

impl Signs {
    fn draw(&mut self) -> f64 {
        if self.left == 0 {
            self.bits = self.random.next_u64();
            self.left = u64::BITS;
        }
        let sign = if self.bits & 1 == 0 { -1.0 } else { 1.0 };
        self.bits >>= 1;
        self.left -= 1;
        sign
    }
}
