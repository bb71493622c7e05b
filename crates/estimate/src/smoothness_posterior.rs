//! Posterior of few readings with a smoothness prior: σ and the weight of the prior are integrated out.
//!
//! Input: whitened readings of a linear model, the penalty of the prior, and what is known of σ. Output: mean
//! and variances of the unknowns as a mixture over the weight.
//!
//! Few readings determine neither σ nor the weight, and one that is read off a maximum of the likelihood is
//! often far from the true one. Intervals with it are then too short. Here every weight counts by its
//! probability. σ is integrated in closed form, which makes each member of the mixture a Student t
//! distribution.
//!
//! Not guaranteed: the exact quantiles of the mixture. Its variance is that of normal variables with the same
//! 95 % intervals as the members, plus the variance of their means.

use crate::dense::eigen;
use crate::{Dispersion, Error, Result};
use nalgebra::{Cholesky, DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Range of `log w` about the typical weight, and the step of the quadrature.
///
/// Below, the surface passes through its readings, above, it is a member of the null space: neither end
/// changes with the weight. The posterior of `log w` is rarely narrower than 1, so a step of 0.5 integrates
/// it to better than 1 %.
const LOWEST: f64 = -46.0;
const HIGHEST: f64 = 16.0;
const STEP: f64 = 0.5;
/// Decay of the prior density of `log w` on both sides of the typical weight: `w^±0.25`.
///
/// At both ends the likelihood is constant, so a flat prior has no finite integral. A quarter is weak: ten
/// powers of ten away it weighs as much as three readings. With a half (a half-Cauchy prior of `√w`), σ of 20
/// readings of a paraboloid came out three times larger than with a quarter, coverage being equal.
const PRIOR_DECAY: f64 = 0.25;
/// Weights with less than this share of the probability are dropped.
const NEGLIGIBLE: f64 = 1e-7;
/// Share of the information below which readings do not determine a direction, apart from rounding.
const NO_INFORMATION: f64 = 1e-13;
/// Half the width of the central 95 % of a normal variable, in σ.
const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Readings `z = H x + v`, `v ~ N(0, φ I)`, and a prior of `x` with the information `w K / φ`.
#[derive(Debug, Clone, Copy)]
pub struct PenalizedReadings<'a> {
    /// `H`, each row over its stated σ.
    pub rows: &'a DMatrix<f64>,
    /// `z`, each over its stated σ.
    pub values: &'a DVector<f64>,
    /// `K`, symmetric and positive semidefinite.
    pub penalty: &'a DMatrix<f64>,
    /// Dimension of the null space of `K`.
    pub null: usize,
    /// A weight of the right order, as one that smooths over the distance of the readings.
    pub typical_weight: f64,
}

/// The posterior of [`PenalizedReadings`].
///
/// With `φ` unknown, prior `1/φ`, the members of the mixture have `ν = n − M` degrees of freedom, `M` the
/// dimension of the null space:
///
/// `p(w | z) ∝ p(w) w^(r/2) |HᵀH + wK|^(−1/2) S(w)^(−ν/2)`, `S(w) = min |z − Hx|² + w xᵀKx`
///
/// and `x | w, z` is Student t about the minimum with the scale `S/ν (HᵀH + wK)⁻¹`. With `φ` known, the last
/// factor is `exp(−S/2φ)`, and `x | w, z` is normal.
///
/// Cost: one eigenvalue problem of the size of `x`.
///
/// # Examples
/// The mean of ten readings, with no prior but for its place: the interval is that of Student.
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::{Dispersion, PenalizedReadings, SmoothnessPosterior};
///
/// // Two unknowns: the mean, and a deviation of the last reading that the prior keeps small.
/// let rows = DMatrix::from_fn(10, 2, |i, j| if j == 0 || i == 9 { 1.0 } else { 0.0 });
/// let values = DVector::from_fn(10, |i, _| if i % 2 == 0 { 4.0 } else { 6.0 });
/// let penalty = DMatrix::from_diagonal(&DVector::from_vec(vec![0.0, 1.0]));
/// let readings = PenalizedReadings {
///     rows: &rows,
///     values: &values,
///     penalty: &penalty,
///     null: 1,
///     typical_weight: 1e6,
/// };
/// let posterior = SmoothnessPosterior::new(&readings, Dispersion::Estimated)?;
/// assert!((posterior.mean()[0] - 5.0).abs() < 0.05);
/// // s = √(10/9), s/√10 = 0.33, and the quantile of 9 degrees of freedom is 2.26 instead of 1.96.
/// let sigma = posterior.variance(&DVector::from_vec(vec![1.0, 0.0])).sqrt();
/// assert!((sigma - 0.385).abs() < 0.03, "{sigma}");
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Rue, Martino, Chopin, *Approximate Bayesian inference for latent Gaussian models by using integrated
/// nested Laplace approximations*, 2009, section 3.1; Kitanidis, *Parameter uncertainty in estimation of
/// spatial functions: Bayesian analysis*, 1986, eq. 30; Gelman, *Prior distributions for variance parameters
/// in hierarchical models*, 2006.
#[derive(Debug, Clone)]
pub struct SmoothnessPosterior {
    /// `V` with `Vᵀ HᵀH V = diag(μ)` and `w₀ Vᵀ K V = I − diag(μ)`: in this basis every weight is diagonal.
    basis: DMatrix<f64>,
    shares: Vec<f64>,
    members: Vec<Member>,
    /// The factor by which Student t intervals of 95 % are longer than normal ones.
    margin: f64,
    mean_in_basis: Vec<f64>,
    mean: DVector<f64>,
    /// `Σ p φ margin² / a` of each direction of the basis.
    within: Vec<f64>,
}

/// A weight with its probability.
#[derive(Debug, Clone)]
struct Member {
    /// Over the typical weight.
    relative_weight: f64,
    probability: f64,
    dispersion: f64,
    /// The mean in the basis.
    mean: Vec<f64>,
}

impl SmoothnessPosterior {
    /// Integrates over the weight, and over `φ` unless it is known.
    ///
    /// # Errors
    /// `Undetermined` if readings and prior leave a direction open, or if fewer than three readings more than
    /// the dimension of the null space are given; `Input` for values that are not finite.
    pub fn new(readings: &PenalizedReadings<'_>, dispersion: Dispersion) -> Result<Self> {
        let PenalizedReadings { rows, values, penalty, null, typical_weight } = *readings;
        let (n, unknowns) = rows.shape();
        if n < null + 3 {
            return Err(Error::undetermined(format!(
                "expected at least {} readings for a prior with {null} free directions, found {n}",
                null + 3
            )));
        }
        let open = || Error::undetermined("readings and prior do not determine all unknowns");
        let total = rows.tr_mul(rows) + penalty * typical_weight;
        let factor = Cholesky::new(total).ok_or_else(open)?;
        let half = factor.l_dirty().solve_lower_triangular(&rows.transpose()).ok_or_else(open)?;
        let eigen = eigen(&half * half.transpose()).ok_or_else(open)?;
        // n readings determine no more than n directions; the information of the others is rounding.
        let mut order: Vec<usize> = (0..unknowns).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        let mut shares = vec![0.0; unknowns];
        for &j in &order[..unknowns.min(n)] {
            let share = eigen.eigenvalues[j].min(1.0);
            shares[j] = if share > NO_INFORMATION { share } else { 0.0 };
        }
        let basis = factor.l_dirty().tr_solve_lower_triangular(&eigen.eigenvectors).ok_or_else(open)?;
        // Rows of the readings in the basis; those of undetermined directions are rounding.
        let mut whitened = half.tr_mul(&eigen.eigenvectors);
        for (j, _) in shares.iter().enumerate().filter(|(_, share)| **share == 0.0) {
            whitened.column_mut(j).fill(0.0);
        }
        let degrees = (n - null) as f64;
        let margin = match dispersion {
            Dispersion::Known(_) => 1.0,
            Dispersion::Estimated => student_95(degrees)? / NORMAL_95,
        };
        let members = members(&whitened, values, &shares, unknowns - null, degrees, dispersion)?;
        Ok(Self::from_members(basis, shares, members, margin))
    }

    fn from_members(basis: DMatrix<f64>, shares: Vec<f64>, members: Vec<Member>, margin: f64) -> Self {
        let mut mean = vec![0.0; shares.len()];
        let mut within = vec![0.0; shares.len()];
        for member in &members {
            for (j, &share) in shares.iter().enumerate() {
                mean[j] += member.probability * member.mean[j];
                within[j] += member.probability * margin * margin * member.dispersion
                    / information(share, member.relative_weight);
            }
        }
        let full = &basis * DVector::from_column_slice(&mean);
        Self { basis, shares, members, margin, mean_in_basis: mean, mean: full, within }
    }

    /// The mean of `x`.
    #[must_use]
    pub fn mean(&self) -> &DVector<f64> {
        &self.mean
    }

    /// The variance of `qᵀ x`: that of a normal variable whose 95 % interval holds 95 % of the posterior.
    #[must_use]
    pub fn variance(&self, q: &DVector<f64>) -> f64 {
        let y = self.basis.tr_mul(q);
        let within: f64 = y.iter().zip(&self.within).map(|(y, v)| y * y * v).sum();
        let between: f64 = (self.members.iter())
            .map(|member| {
                let means = member.mean.iter().zip(&self.mean_in_basis);
                let off: f64 = y.iter().zip(means).map(|(y, (own, mean))| y * (own - mean)).sum();
                member.probability * off * off
            })
            .sum();
        within + between
    }

    /// The mean of `log w`, as a factor on the typical weight.
    #[must_use]
    pub fn relative_weight(&self) -> f64 {
        self.mean_of(|member| member.relative_weight.ln()).exp()
    }

    /// The mean of `φ`.
    #[must_use]
    pub fn dispersion(&self) -> f64 {
        self.mean_of(|member| member.dispersion)
    }

    /// The factor by which intervals are longer because `φ` is estimated; 1 if it is known.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.margin
    }

    /// Degrees of freedom that a reading with this row of `H` determines: `hᵀ (HᵀH + wK)⁻¹ h`, the mean over
    /// the weights.
    #[must_use]
    pub fn degrees(&self, row: &DVector<f64>) -> f64 {
        let y = self.basis.tr_mul(row);
        self.mean_of(|member| {
            let determined = self.shares.iter().zip(y.iter());
            determined.map(|(&share, y)| y * y / information(share, member.relative_weight)).sum()
        })
    }

    fn mean_of(&self, value: impl Fn(&Member) -> f64) -> f64 {
        self.members.iter().map(|member| member.probability * value(member)).sum()
    }
}

/// Information of a direction of the basis, of which the readings have the given share at the typical weight.
fn information(share: f64, relative_weight: f64) -> f64 {
    share + relative_weight * (1.0 - share).max(f64::EPSILON)
}

/// All weights with their probabilities; `rank` is that of the penalty.
fn members(
    whitened: &DMatrix<f64>,
    values: &DVector<f64>,
    shares: &[f64],
    rank: usize,
    degrees: f64,
    dispersion: Dispersion,
) -> Result<Vec<Member>> {
    let projected = whitened.tr_mul(values);
    let count = ((HIGHEST - LOWEST) / STEP).round() as usize + 1;
    let mut logs = Vec::with_capacity(count);
    let mut members = Vec::with_capacity(count);
    for k in 0..count {
        let log_weight = LOWEST + STEP * k as f64;
        let w = log_weight.exp();
        let mean: Vec<f64> =
            shares.iter().zip(projected.iter()).map(|(&share, c)| c / information(share, w)).collect();
        let residual = values - whitened * DVector::from_column_slice(&mean);
        let roughness: f64 = shares.iter().zip(&mean).map(|(&share, x)| (1.0 - share).max(0.0) * x * x).sum();
        // A sum of squares: the difference zᵀz − ηᵀA⁻¹η would be rounding for exact data.
        let penalized = (residual.norm_squared() + w * roughness).max(f64::MIN_POSITIVE);
        let log_determinant: f64 = shares.iter().map(|&share| information(share, w).ln()).sum();
        let (fit, dispersion) = match dispersion {
            Dispersion::Known(scale) => (-0.5 * penalized / scale, scale),
            Dispersion::Estimated => (-0.5 * degrees * penalized.ln(), penalized / degrees),
        };
        // cosh overflows far out, where its logarithm is |x| − log 2.
        let from_typical = (PRIOR_DECAY * log_weight).abs();
        let prior = -(from_typical + (-2.0 * from_typical).exp().ln_1p());
        logs.push(prior + 0.5 * (rank as f64 * log_weight - log_determinant) + fit);
        members.push(Member { relative_weight: w, probability: 0.0, dispersion, mean });
    }
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if !largest.is_finite() {
        return Err(Error::input("expected finite readings for the posterior of a smoothness weight"));
    }
    let total: f64 = logs.iter().map(|log| (log - largest).exp()).sum();
    for (member, log) in members.iter_mut().zip(&logs) {
        member.probability = (log - largest).exp() / total;
    }
    members.retain(|member| member.probability > NEGLIGIBLE);
    Ok(members)
}

/// Half the width of the central 95 % of Student's t distribution.
fn student_95(degrees: f64) -> Result<f64> {
    let distribution = StudentsT::new(0.0, 1.0, degrees)
        .map_err(|e| Error::input("expected positive degrees of freedom").with_source(e))?;
    Ok(distribution.inverse_cdf(0.975))
}

#[cfg(test)]
mod tests;
