//! Gaussian beliefs in information form, with prior and data kept apart.
//!
//! Input: means and covariances, rows of linear readings, linearised equations. Output: fused beliefs, their
//! means and covariances, marginals and conditionals. Information adds for readings with independent errors
//! that were linearised at the same state. Not guaranteed: the independence of the errors. Use
//! [`Belief::covariance_intersection`] if it is unknown.

use crate::dense::{
    ScaledCholesky, diagonal_scale, eigen, is_finite, rank_tolerance, require_covariance, require_vector,
    scaled_by, smallest_scaled_eigenvalue, symmetric_part,
};
use crate::line_search::maximize_between;
use crate::{Error, Linearization, Result};
use nalgebra::{DMatrix, DVector};

/// Gaussian information about a state: `Λ` and `η = Λ x̂`, possibly singular.
///
/// The log-density is `−½ xᵀΛx + ηᵀx` up to a constant. `Λ` is symmetric positive semidefinite, of shape
/// state × state.
#[derive(Debug, Clone, PartialEq)]
pub struct Information {
    /// The information matrix `Λ`.
    pub matrix: DMatrix<f64>,
    /// The information vector `η`.
    pub vector: DVector<f64>,
}

impl Information {
    /// No information about `n` unknowns.
    #[must_use]
    pub fn zero(n: usize) -> Self {
        Self { matrix: DMatrix::zeros(n, n), vector: DVector::zeros(n) }
    }

    /// Information of linear readings `z = H x + v` with weight `W = R⁻¹`: `Λ = HᵀWH`, `η = HᵀWz`.
    ///
    /// `H` is readings × state, `W` readings × readings.
    ///
    /// # Errors
    /// `Input` when shapes differ, a value is not finite, or `W` is not symmetric positive semidefinite.
    ///
    /// # Examples
    /// ```
    /// use nalgebra::{DMatrix, DVector};
    /// use planish_estimate::Information;
    ///
    /// // Two readings of one unknown: 2 with variance 1, and 5 with variance 0.5.
    /// let design = DMatrix::from_element(2, 1, 1.0);
    /// let weight = DMatrix::from_diagonal(&DVector::from_vec(vec![1.0, 2.0]));
    /// let information = Information::from_rows(&design, &weight, &DVector::from_vec(vec![2.0, 5.0]))?;
    /// assert!((information.mean()?[0] - 4.0).abs() < 1e-12);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn from_rows(design: &DMatrix<f64>, weight: &DMatrix<f64>, reading: &DVector<f64>) -> Result<Self> {
        require_vector("the reading", reading, design.nrows())?;
        require_covariance("the weight", weight, design.nrows())?;
        if !is_finite(design) {
            return Err(Error::input("expected finite values in the design matrix, found another"));
        }
        // The triple product is symmetric only up to rounding. Factors read one triangle and sums use both,
        // so both must agree.
        let weighted = weight * design;
        Ok(Self {
            matrix: symmetric_part(&(design.transpose() * &weighted)),
            vector: weighted.transpose() * reading,
        })
    }

    /// Information of a Gaussian with the given mean and covariance: `Λ = Σ⁻¹`, `η = Σ⁻¹ x̂`.
    ///
    /// # Errors
    /// `Input` when shapes differ or the covariance is not symmetric positive definite.
    pub fn from_covariance(mean: &DVector<f64>, covariance: &DMatrix<f64>) -> Result<Self> {
        require_vector("the mean", mean, mean.len())?;
        require_covariance("the covariance", covariance, mean.len())?;
        let factor = ScaledCholesky::new(covariance).map_err(|null| {
            Error::input(format!(
                "the covariance is singular: component {} is known exactly along one direction; remove it \
                 from the state, or specify a variance",
                null.component()
            ))
        })?;
        Ok(Self { matrix: factor.inverse(), vector: factor.solve(mean) })
    }

    /// Number of unknowns.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.vector.len()
    }

    /// Adds independent information: `Λ += Λ'`, `η += η'`.
    ///
    /// # Errors
    /// `Input` when the dimensions differ.
    pub fn add(&mut self, other: &Self) -> Result<()> {
        self.add_scaled(1.0, other)
    }

    /// Adds a multiple of other information: `Λ += s Λ'`, `η += s η'`; `s = −1` removes it again.
    ///
    /// # Errors
    /// `Input` when the dimensions differ.
    pub fn add_scaled(&mut self, factor: f64, other: &Self) -> Result<()> {
        require_same_dimension(self.dimension(), other.dimension())?;
        self.matrix.zip_apply(&other.matrix, |a, b| *a += factor * b);
        self.vector.axpy(factor, &other.vector, 1.0);
        Ok(())
    }

    /// Multiplies `Λ` and `η` by `s`: the mean stays, the covariance is divided by `s`.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { matrix: &self.matrix * factor, vector: &self.vector * factor }
    }

    /// The mean `x̂ = Λ⁻¹ η`. Cost: `n³/3`.
    ///
    /// # Errors
    /// `Undetermined` when `Λ` is singular; the message names the largest component of the null direction.
    pub fn mean(&self) -> Result<DVector<f64>> {
        Ok(self.factor()?.solve(&self.vector))
    }

    /// The covariance `Σ = Λ⁻¹`. Cost: `n³`.
    ///
    /// # Errors
    /// `Undetermined` when `Λ` is singular; the message names the largest component of the null direction.
    pub fn covariance(&self) -> Result<DMatrix<f64>> {
        Ok(self.factor()?.inverse())
    }

    fn factor(&self) -> Result<ScaledCholesky> {
        ScaledCholesky::new(&self.matrix).map_err(|null| null.into_error("the state"))
    }

    fn require_valid(&self, what: &str) -> Result<()> {
        let n = self.dimension();
        require_vector(&format!("the vector of {what}"), &self.vector, n)?;
        require_covariance(&format!("the matrix of {what}"), &self.matrix, n)
    }

    /// Marginal information about the unknowns `kept`: the Schur complement with respect to `dropped`.
    fn marginal(&self, kept: &[usize], dropped: &[usize]) -> Result<Self> {
        let matrix = |rows: &[usize], columns: &[usize]| {
            DMatrix::from_fn(rows.len(), columns.len(), |i, j| self.matrix[(rows[i], columns[j])])
        };
        let vector = |rows: &[usize]| DVector::from_fn(rows.len(), |i, _| self.vector[rows[i]]);
        if dropped.is_empty() {
            return Ok(Self { matrix: matrix(kept, kept), vector: vector(kept) });
        }
        let (coupling, inner) = (matrix(dropped, kept), matrix(dropped, dropped));
        // A singular block is legitimate: a prior may leave the dropped unknowns free. The complement exists
        // all the same.
        let (solved_coupling, solved_vector) = match ScaledCholesky::new(&inner) {
            Ok(factor) => (factor.solve_matrix(&coupling), factor.solve(&vector(dropped))),
            Err(_) => {
                let inverse = pseudo_inverse(&inner)?;
                (&inverse * &coupling, inverse * vector(dropped))
            }
        };
        Ok(Self {
            matrix: symmetric_part(&(matrix(kept, kept) - coupling.transpose() * solved_coupling)),
            vector: vector(kept) - coupling.transpose() * solved_vector,
        })
    }

    /// Conditional information about the unknowns `free`, given that the others equal `values`.
    fn conditional(&self, free: &[usize], known: &[usize], values: &DVector<f64>) -> Self {
        // Conditioning in information form selects rows and needs no factor. In covariance form it is the
        // other way round: there the marginal selects and conditioning solves.
        let matrix = DMatrix::from_fn(free.len(), free.len(), |i, j| self.matrix[(free[i], free[j])]);
        let vector = DVector::from_fn(free.len(), |i, _| {
            let explained: f64 =
                known.iter().zip(values.iter()).map(|(&k, x)| self.matrix[(free[i], k)] * x).sum();
            self.vector[free[i]] - explained
        });
        Self { matrix, vector }
    }
}

/// A Gaussian belief that stores prior and data information separately: `Λ = Λ_prior + Λ_data`.
///
/// Laws: [`Self::merge`] is commutative and associative, equals one update with all data, and counts the
/// prior once.
///
/// # Examples
/// Two sessions that started from the same prior:
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use planish_estimate::{Belief, Linear, MeasurementEquation};
///
/// let (one, zero) = (DMatrix::identity(1, 1), DVector::zeros(1));
/// let prior = Belief::from_covariance(zero.clone(), one.clone())?;
/// let read = |value: f64| {
///     Linear::new(one.clone(), DVector::from_element(1, value))?.linearized(&zero, &zero)
/// };
/// let (mut monday, mut tuesday) = (prior.clone(), prior);
/// monday.update(&read(3.0)?, &one)?;
/// tuesday.update(&read(6.0)?, &one)?;
///
/// let both = monday.merge(&tuesday)?;
/// assert!((both.mean()?[0] - 3.0).abs() < 1e-12); // (0 + 3 + 6) / 3: the prior counts once
/// assert!((both.covariance()?[(0, 0)] - 1.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    prior: Information,
    data: Information,
}

impl Belief {
    /// A prior with the given mean and covariance, and no data.
    ///
    /// # Errors
    /// `Input` when shapes differ or the covariance is not symmetric positive definite.
    pub fn from_covariance(mean: DVector<f64>, covariance: DMatrix<f64>) -> Result<Self> {
        let prior = Information::from_covariance(&mean, &covariance)?;
        Ok(Self { data: Information::zero(prior.dimension()), prior })
    }

    /// A belief from prior and data information. Either may be singular or zero.
    ///
    /// # Errors
    /// `Input` when the dimensions differ, or when one is not finite, symmetric and positive semidefinite.
    pub fn from_information(prior: Information, data: Information) -> Result<Self> {
        require_same_dimension(prior.dimension(), data.dimension())?;
        prior.require_valid("the prior information")?;
        data.require_valid("the data information")?;
        Ok(Self { prior, data })
    }

    /// Information of the prior.
    #[must_use]
    pub fn prior(&self) -> &Information {
        &self.prior
    }

    /// Information of the data.
    #[must_use]
    pub fn data(&self) -> &Information {
        &self.data
    }

    /// Number of unknowns.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.prior.dimension()
    }

    /// Sum of the information of prior and data.
    #[must_use]
    pub fn information(&self) -> Information {
        Information {
            matrix: &self.prior.matrix + &self.data.matrix,
            vector: &self.prior.vector + &self.data.vector,
        }
    }

    /// The mean. Cost: `n³/3`.
    ///
    /// # Errors
    /// `Undetermined` when neither prior nor data have information along some direction; the message names
    /// its largest component.
    pub fn mean(&self) -> Result<DVector<f64>> {
        self.information().mean()
    }

    /// The covariance. Cost: `n³`.
    ///
    /// # Errors
    /// `Undetermined` when neither prior nor data have information along some direction; the message names
    /// its largest component.
    pub fn covariance(&self) -> Result<DMatrix<f64>> {
        self.information().covariance()
    }

    /// Adds the information of a linearised measurement whose noise has covariance `R`.
    ///
    /// # Errors
    /// Those of [`Linearization::information`], and `Input` when the state has another dimension.
    pub fn update(&mut self, measurement: &Linearization, noise_covariance: &DMatrix<f64>) -> Result<()> {
        require_same_dimension(self.dimension(), measurement.state.len())?;
        self.data.add(&measurement.information(noise_covariance)?)
    }

    /// Merges two beliefs with the same prior and independent data: `Λ_prior + Λ_a + Λ_b`.
    ///
    /// # Errors
    /// `Input` when the dimensions or the priors differ.
    pub fn merge(&self, other: &Self) -> Result<Self> {
        require_same_dimension(self.dimension(), other.dimension())?;
        if !self.has_same_prior(other) {
            return Err(Error::input(
                "beliefs with different priors cannot be merged, because their common part is unknown: \
                 specify one prior for both, or use covariance intersection",
            ));
        }
        let mut merged = self.clone();
        merged.data.add(&other.data)?;
        Ok(merged)
    }

    /// True if both priors agree to 1e-12 of their largest entries.
    #[must_use]
    pub fn has_same_prior(&self, other: &Self) -> bool {
        fn close(a: &[f64], b: &[f64]) -> bool {
            let largest = a.iter().chain(b).fold(0.0_f64, |largest, value| largest.max(value.abs()));
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-12 * largest)
        }
        close(self.prior.matrix.as_slice(), other.prior.matrix.as_slice())
            && close(self.prior.vector.as_slice(), other.prior.vector.as_slice())
    }

    /// Removes data information that this belief shares with another, as a channel filter does.
    ///
    /// Two children of one parent both hold the data of the parent.
    /// `a.merge(&b.subtract_common(parent.data())?)` counts these data once:
    /// `Λ = Λ_prior + Λ_a + Λ_b − Λ_common`.
    ///
    /// # Errors
    /// `Input` when the dimensions differ, or when the belief does not contain that information: the
    /// difference must be positive semidefinite to 1e-9 of the information of the data.
    ///
    /// # References
    /// Grime, Durrant-Whyte, *Data fusion in decentralized sensor networks*, 1994.
    pub fn subtract_common(&self, common: &Information) -> Result<Self> {
        let mut rest = self.clone();
        rest.data.add_scaled(-1.0, common)?;
        match smallest_scaled_eigenvalue(&rest.data.matrix, &self.data.matrix) {
            Some(smallest) if smallest >= -1e-9 => Ok(rest),
            _ => Err(Error::input("cannot subtract information that the data of the belief do not contain")),
        }
    }

    /// Merges two beliefs whose data overlap to an unknown extent: `ω Λ_a + (1 − ω) Λ_b`. The result is never
    /// overconfident.
    ///
    /// Returns the belief and `ω`, which minimises the determinant of the covariance. Priors and data are
    /// combined separately, so a common prior keeps its full weight. Cost: about forty factorisations.
    ///
    /// # Errors
    /// `Input` when the dimensions differ; `Undetermined` when neither belief has information along some
    /// direction.
    ///
    /// # Examples
    /// Two beliefs that each know one unknown well. The result does not claim more than both together.
    /// ```
    /// use nalgebra::{DMatrix, DVector};
    /// use planish_estimate::Belief;
    ///
    /// let belief = |x: f64, y: f64| {
    ///     Belief::from_covariance(DVector::zeros(2), DMatrix::from_row_slice(2, 2, &[x, 0.0, 0.0, y]))
    /// };
    /// let (fused, weight) = belief(1.0, 4.0)?.covariance_intersection(&belief(4.0, 1.0)?)?;
    /// assert!((weight - 0.5).abs() < 1e-4);
    /// assert!((fused.covariance()?[(0, 0)] - 1.6).abs() < 1e-4); // independent data would give 0.8
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # References
    /// Julier, Uhlmann, *A non-divergent estimation algorithm in the presence of unknown correlations*, 1997.
    pub fn covariance_intersection(&self, other: &Self) -> Result<(Self, f64)> {
        require_same_dimension(self.dimension(), other.dimension())?;
        let mixed = |weight: f64| -> Result<Self> {
            let mut belief = Self { prior: self.prior.scaled(weight), data: self.data.scaled(weight) };
            belief.prior.add_scaled(1.0 - weight, &other.prior)?;
            belief.data.add_scaled(1.0 - weight, &other.data)?;
            Ok(belief)
        };
        // The logarithm of the determinant is concave in the weight, so a local search finds the global
        // maximum.
        let log_determinant = |weight: f64| -> Result<f64> {
            Ok(match ScaledCholesky::new(&mixed(weight)?.information().matrix) {
                Ok(factor) => factor.ln_determinant(),
                Err(_) => f64::NEG_INFINITY,
            })
        };
        let inner = maximize_between(0.0, 1.0, 1e-7, 60, log_determinant)?.best;
        let mut best = inner;
        // The search never evaluates the ends. If one belief contains all information of the other, the
        // optimum is at an end.
        for at in [0.0, 1.0] {
            let value = log_determinant(at)?;
            if value >= best.value {
                (best.at, best.value) = (at, value);
            }
        }
        let fused = mixed(best.at)?;
        // No weight gives a regular matrix: factoring it once more creates the error that names the
        // direction.
        if best.value == f64::NEG_INFINITY {
            fused.information().factor()?;
        }
        Ok((fused, best.at))
    }

    /// The marginal belief about the unknowns at `indices`, in that order.
    ///
    /// The prior of the result is the marginal of the prior; the data hold the remaining information.
    /// Marginals of two beliefs that share dropped unknowns are not independent: merge first, then take the
    /// marginal. Cost: `n³/3`.
    ///
    /// # Errors
    /// `Input` when an index is out of range or given twice.
    pub fn marginal(&self, indices: &[usize]) -> Result<Self> {
        let others = complement(self.dimension(), indices)?;
        let prior = self.prior.marginal(indices, &others)?;
        // Schur complements are not additive: marginalising prior and data separately would lose what both
        // know together.
        let mut data = self.information().marginal(indices, &others)?;
        data.add_scaled(-1.0, &prior)?;
        Ok(Self { prior, data })
    }

    /// The belief about the other unknowns in ascending order, given that those at `indices` equal `values`.
    ///
    /// # Errors
    /// `Input` when an index is out of range or given twice, or when the numbers of values and indices
    /// differ.
    ///
    /// # Examples
    /// ```
    /// use nalgebra::{DMatrix, DVector};
    /// use planish_estimate::Belief;
    ///
    /// let covariance = DMatrix::from_row_slice(2, 2, &[1.0, 0.8, 0.8, 1.0]);
    /// let belief = Belief::from_covariance(DVector::zeros(2), covariance)?;
    /// let rest = belief.condition(&[0], &DVector::from_element(1, 1.0))?;
    /// assert!((rest.mean()?[0] - 0.8).abs() < 1e-12);
    /// assert!((rest.covariance()?[(0, 0)] - 0.36).abs() < 1e-12);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn condition(&self, indices: &[usize], values: &DVector<f64>) -> Result<Self> {
        require_vector("the known values", values, indices.len())?;
        let free = complement(self.dimension(), indices)?;
        Ok(Self {
            prior: self.prior.conditional(&free, indices, values),
            data: self.data.conditional(&free, indices, values),
        })
    }
}

fn require_same_dimension(expected: usize, found: usize) -> Result<()> {
    if expected == found {
        Ok(())
    } else {
        Err(Error::input(format!("expected information about {expected} unknowns, found {found}")))
    }
}

/// The indices below `n` that are not among `indices`.
fn complement(n: usize, indices: &[usize]) -> Result<Vec<usize>> {
    let mut used = vec![false; n];
    for &index in indices {
        match used.get_mut(index) {
            Some(seen) if !*seen => *seen = true,
            Some(_) => {
                return Err(Error::input(format!(
                    "expected each component once, found component {index} twice"
                )));
            }
            None => {
                return Err(Error::input(format!("expected components below {n}, found {index}")));
            }
        }
    }
    Ok((0..n).filter(|&i| !used[i]).collect())
}

/// Pseudo-inverse of a symmetric positive semidefinite matrix. The rank is decided after scaling to unit
/// diagonal.
///
/// The pseudo-inverse depends on this scaling. The Schur complement built from it does not, because the
/// coupling lies in the range of the matrix.
fn pseudo_inverse(matrix: &DMatrix<f64>) -> Result<DMatrix<f64>> {
    let scale = diagonal_scale(matrix);
    let eigen = eigen(scaled_by(matrix, &scale))
        .ok_or_else(|| Error::input("expected finite values in the information, found another"))?;
    let tolerance = rank_tolerance(matrix.nrows());
    let inverted = eigen.eigenvalues.map(|value| if value > tolerance { 1.0 / value } else { 0.0 });
    let vectors = &eigen.eigenvectors;
    Ok(scaled_by(&(vectors * DMatrix::from_diagonal(&inverted) * vectors.transpose()), &scale))
}

#[cfg(test)]
mod tests;
