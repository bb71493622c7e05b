//! Which of two fits to the same points agrees better with them.

use super::ShellFit;
use super::support::VertexResiduals;

/// Squared residual, in σ, that a rejected point contributes to χ²: the gate of the outliers.
const REJECTED_SQUARE: f64 = 17.0;

/// True if χ² is smaller by more than twice the number of additional unknowns (H. Akaike, *Information theory
/// and an extension of the maximum likelihood principle*, 1973). Its σ is that of the noise alone.
pub(super) fn is_better(fit: &ShellFit, before: &ShellFit, unknowns: usize) -> bool {
    let total = |fit: &ShellFit| {
        fit.residuals_at.iter().fold(VertexResiduals::default(), |mut sum, own| {
            sum.add(own);
            sum
        })
    };
    let [own, other] = [fit, before].map(total);
    let noise = (own.squares - own.products) / f64::from(own.points.max(1));
    let all = fit.points.outliers.len() as f64;
    let chi_squared = |sum: &VertexResiduals| {
        sum.squares / noise.max(f64::MIN_POSITIVE) + REJECTED_SQUARE * (all - f64::from(sum.points))
    };
    chi_squared(&own) + 2.0 * (unknowns as f64) < chi_squared(&other)
}
