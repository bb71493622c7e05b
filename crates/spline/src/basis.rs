//! Uniform B-spline bases in one direction.
//!
//! Input: a degree, a number of unit cells, an end condition. Output: values and derivatives of the functions
//! of a cell, the two-scale relation, knots and Greville points. All cells have length one; for another
//! spacing, scale the derivatives.

use planish_estimate::{Error, Result};

/// Maximum degree. Values fit arrays of fixed length on the stack; a larger maximum makes each of them
/// larger.
pub const MAX_DEGREE: usize = 9;

/// Condition at the ends of the domain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum End {
    /// Uniform knots continue past the domain: `cells + degree` functions.
    Open,
    /// The last cell joins the first: `cells` functions.
    Periodic,
}

/// Uniform B-splines `B_i(t) = B(t − i + p)` of degree `p` over `cells` unit cells.
///
/// The support of function `i` is the cells `i − p ..= i`. The functions of cell `c` are `c ..= c + p`
/// (modulo `cells` if periodic).
///
/// # Examples
/// ```
/// use planish_spline::{End, UniformBasis};
/// let basis = UniformBasis::new(3, 4, End::Open)?;
/// assert_eq!(basis.functions(), 7); // the 7 × 7 patch of 4 × 4 cells, in one direction
/// let values = basis.values(0.25);
/// assert!((values[..4].iter().sum::<f64>() - 1.0).abs() < 1e-15);
/// # Ok::<(), planish_spline::Error>(())
/// ```
///
/// # References
/// de Boor, *A Practical Guide to Splines*, 1978; Riesenfeld, *Homogeneous coordinates and projective
/// planes*, 1981 (two-scale relation).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UniformBasis {
    degree: usize,
    cells: usize,
    end: End,
}

impl UniformBasis {
    /// A basis of the given degree over `cells` cells.
    ///
    /// # Errors
    /// `Input` when the degree is above [`MAX_DEGREE`], there is no cell, or a periodic basis has fewer than
    /// `degree + 1` cells, because a function would overlap itself.
    pub fn new(degree: usize, cells: usize, end: End) -> Result<Self> {
        if degree > MAX_DEGREE {
            return Err(Error::input(format!("degree {degree} is above the maximum of {MAX_DEGREE}")));
        }
        let minimum = if end == End::Periodic { degree + 1 } else { 1 };
        if cells < minimum {
            return Err(Error::input(format!(
                "degree {degree} needs at minimum {minimum} cells here, found {cells}"
            )));
        }
        Ok(Self { degree, cells, end })
    }

    /// The degree `p`.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// The number of unit cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// The number of functions.
    #[must_use]
    pub fn functions(&self) -> usize {
        match self.end {
            End::Open => self.cells + self.degree,
            End::Periodic => self.cells,
        }
    }

    /// Index of the `k`-th function on a cell, `k` in `0 ..= degree`.
    #[must_use]
    pub fn function_on_cell(&self, cell: usize, k: usize) -> usize {
        match self.end {
            End::Open => cell + k,
            End::Periodic => (cell + k) % self.cells,
        }
    }

    /// Values at cell-local `t ∈ [0, 1]` of the `degree + 1` functions of any cell; the other entries are
    /// zero.
    ///
    /// Cost: `O(degree²)`; closed form for cubics.
    #[must_use]
    pub fn values(&self, t: f64) -> [f64; MAX_DEGREE + 1] {
        let mut values = [0.0; MAX_DEGREE + 1];
        if self.degree == 3 {
            values[..4].copy_from_slice(&cubic(t)[0]);
        } else {
            uniform_values(self.degree, t, &mut values);
        }
        values
    }

    /// Derivatives of the given order at cell-local `t`: `B⁽ʳ⁾_p = Δʳ B_{p−r}` (backward differences of
    /// lower-degree values).
    #[must_use]
    pub fn derivatives(&self, t: f64, order: usize) -> [f64; MAX_DEGREE + 1] {
        let mut values = [0.0; MAX_DEGREE + 1];
        if order > self.degree {
            return values;
        }
        uniform_values(self.degree - order, t, &mut values);
        for r in 0..order {
            // Raise the degree by one: the k-th derivative piece is w[k−1] − w[k] of the lower degree.
            let top = self.degree - order + r;
            // In place from the last piece down: each one needs the old value of its left neighbour.
            let mut above = 0.0;
            for k in (0..=top + 1).rev() {
                let below = if k == 0 { 0.0 } else { values[k - 1] };
                let own = if k > top { 0.0 } else { above };
                above = below;
                values[k] = below - own;
            }
        }
        values
    }

    /// The two-scale weights: a function equals `Σ_m w[m] · fine(2 i − p + m)`, `w[m] = C(p + 1, m) / 2^p`,
    /// with fine functions of half the cell length.
    #[must_use]
    pub fn two_scale(&self) -> Vec<f64> {
        let scale = 0.5_f64.powi(self.degree as i32);
        let mut weight = scale;
        (0..=self.degree + 1)
            .map(|m| {
                let own = weight;
                weight *= (self.degree + 1 - m) as f64 / (m + 1) as f64;
                own
            })
            .collect()
    }

    /// Coefficients of the refined basis (twice the cells) that give the same spline.
    ///
    /// # Panics
    /// When the numbers of coefficients and functions differ.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{End, UniformBasis};
    ///
    /// let coarse = UniformBasis::new(3, 1, End::Open)?;
    /// // Greville points are the coefficients of x = t; on halved cells they are half as far apart.
    /// let fine = coarse.refine(&[-1.0, 0.0, 1.0, 2.0]);
    /// assert_eq!(fine, [-0.5, 0.0, 0.5, 1.0, 1.5]);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn refine(&self, coefficients: &[f64]) -> Vec<f64> {
        assert_eq!(coefficients.len(), self.functions(), "one coefficient per function");
        let fine = Self { cells: 2 * self.cells, ..*self };
        let mut out = vec![0.0; fine.functions()];
        for (i, &c) in coefficients.iter().enumerate() {
            for (m, w) in self.two_scale().iter().enumerate() {
                let j = 2 * i as i64 - self.degree as i64 + m as i64;
                match self.end {
                    // Fine functions outside an open domain vanish on it.
                    End::Open if (0..out.len() as i64).contains(&j) => out[j as usize] += w * c,
                    End::Open => {}
                    End::Periodic => out[j.rem_euclid(fine.cells as i64) as usize] += w * c,
                }
            }
        }
        out
    }

    /// The Greville point of function `i`, where it has its maximum: the mean of its inner knots.
    #[must_use]
    pub fn greville(&self, i: usize) -> f64 {
        i as f64 - (self.degree as f64 - 1.0) / 2.0
    }
}

/// Values of the uniform B-spline pieces of degree `p` at `t ∈ [0, 1]`, by raising the degree.
fn uniform_values(degree: usize, t: f64, values: &mut [f64; MAX_DEGREE + 1]) {
    values.fill(0.0);
    values[0] = 1.0;
    for p in 1..=degree {
        let pf = p as f64;
        // In place from the last piece down, so that each piece still finds the values of the lower degree.
        for k in (0..=p).rev() {
            let left = if k == 0 { 0.0 } else { values[k - 1] };
            let own = if k == p { 0.0 } else { values[k] };
            // The support of piece k of degree p is the knots k−p ..= k+1 around the cell [0, 1].
            values[k] = ((t + pf - k as f64) * left + (k as f64 + 1.0 - t) * own) / pf;
        }
    }
}

/// Values and first to third derivatives of the four cubic pieces at `t ∈ [0, 1]`: `out[order][piece]`.
///
/// # Examples
/// ```
/// use planish_spline::cubic;
///
/// let [values, slopes, ..] = cubic(0.0);
/// // At a knot three functions are nonzero.
/// assert_eq!(values, [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0, 0.0]);
/// assert_eq!(slopes, [-0.5, 0.0, 0.5, 0.0]);
/// ```
#[inline]
#[must_use]
pub fn cubic(t: f64) -> [[f64; 4]; 4] {
    // Mirrored pieces are written in `s`: near t = 1 the same polynomials in `t` would lose digits by
    // cancellation.
    let s = 1.0 - t;
    let (t2, s2) = (t * t, s * s);
    [
        [
            s2 * s / 6.0,
            (3.0 * t2 * t - 6.0 * t2 + 4.0) / 6.0,
            (3.0 * s2 * s - 6.0 * s2 + 4.0) / 6.0,
            t2 * t / 6.0,
        ],
        [-0.5 * s2, 1.5 * t2 - 2.0 * t, 2.0 * s - 1.5 * s2, 0.5 * t2],
        [s, 3.0 * t - 2.0, 3.0 * s - 2.0, t],
        [-1.0, 3.0, -3.0, 1.0],
    ]
}

/// Cubic coefficients of the first (`half = 0`) or second half of a cell from those of the cell (exact, de
/// Casteljau–Boehm).
#[inline]
#[must_use]
pub fn cubic_half(c: [f64; 4], half: usize) -> [f64; 4] {
    let edge = [(c[0] + c[1]) / 2.0, (c[1] + c[2]) / 2.0, (c[2] + c[3]) / 2.0];
    let vertex = [(c[0] + 6.0 * c[1] + c[2]) / 8.0, (c[1] + 6.0 * c[2] + c[3]) / 8.0];
    if half == 0 {
        [edge[0], vertex[0], edge[1], vertex[1]]
    } else {
        [vertex[0], edge[1], vertex[1], edge[2]]
    }
}

/// Bézier ordinates of a cubic cell from its four B-spline coefficients.
///
/// # Examples
/// ```
/// use planish_spline::cubic_bezier;
///
/// // Coefficients of the straight line x = t on the cell [0, 1]: the Greville points.
/// let ordinates = cubic_bezier([-1.0, 0.0, 1.0, 2.0]);
/// for (found, expected) in ordinates.iter().zip([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]) {
///     assert!((found - expected).abs() < 1e-15);
/// }
/// ```
#[inline]
#[must_use]
pub fn cubic_bezier(c: [f64; 4]) -> [f64; 4] {
    [
        (c[0] + 4.0 * c[1] + c[2]) / 6.0,
        (2.0 * c[1] + c[2]) / 3.0,
        (c[1] + 2.0 * c[2]) / 3.0,
        (c[1] + 4.0 * c[2] + c[3]) / 6.0,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_sum_to_one_and_are_not_negative_for_every_degree() {
        for degree in 0..=MAX_DEGREE {
            let basis = UniformBasis::new(degree, degree + 1, End::Periodic).unwrap();
            for step in 0..=20 {
                let values = basis.values(step as f64 / 20.0);
                assert!((values.iter().sum::<f64>() - 1.0).abs() < 1e-14, "degree {degree}");
                assert!(values.iter().all(|&v| v >= 0.0));
            }
        }
    }

    #[test]
    fn derivatives_agree_with_differences_of_the_order_below() {
        let h = 1e-5;
        for degree in 1..=MAX_DEGREE {
            let basis = UniformBasis::new(degree, degree + 1, End::Periodic).unwrap();
            for order in 1..=3.min(degree) {
                for t in [0.2, 0.5, 0.9] {
                    let exact = basis.derivatives(t, order);
                    let (a, b) = (basis.derivatives(t - h, order - 1), basis.derivatives(t + h, order - 1));
                    for k in 0..=degree {
                        assert!(
                            (exact[k] - (b[k] - a[k]) / (2.0 * h)).abs() < 1e-6,
                            "degree {degree} order {order}"
                        );
                    }
                    assert!(exact.iter().sum::<f64>().abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn cubic_fast_path_equals_the_general_one() {
        let basis = UniformBasis::new(3, 4, End::Open).unwrap();
        for step in 0..=10 {
            let t = step as f64 / 10.0;
            let fast = cubic(t);
            for order in 0..4 {
                let general = basis.derivatives(t, order);
                for k in 0..4 {
                    assert!((fast[order][k] - general[k]).abs() < 1e-14, "order {order} piece {k}");
                }
            }
        }
    }

    #[test]
    fn refinement_is_exact_for_every_degree_and_end() {
        for end in [End::Open, End::Periodic] {
            for degree in 1..=5 {
                let basis = UniformBasis::new(degree, 6, end).unwrap();
                let fine = UniformBasis::new(degree, 12, end).unwrap();
                let coefficients: Vec<f64> = (0..basis.functions()).map(|i| ((i * i) as f64).sin()).collect();
                let refined = basis.refine(&coefficients);
                let at = |b: &UniformBasis, c: &[f64], cell: usize, t: f64| -> f64 {
                    (0..=degree).map(|k| b.values(t)[k] * c[b.function_on_cell(cell, k)]).sum()
                };
                for cell in 0..6 {
                    for (half, t) in [(0, 0.3), (1, 0.8)] {
                        let coarse = at(&basis, &coefficients, cell, (t + half as f64) / 2.0);
                        assert!((coarse - at(&fine, &refined, 2 * cell + half, t)).abs() < 1e-12);
                    }
                }
            }
        }
    }

    #[test]
    fn halves_and_bezier_ordinates_are_the_same_polynomial() {
        let c = [0.3, -1.2, 2.0, 0.7];
        let value = |c: [f64; 4], t: f64| (0..4).map(|k| cubic(t)[0][k] * c[k]).sum::<f64>();
        for t in [0.0, 0.25, 0.7, 1.0] {
            assert!((value(cubic_half(c, 0), t) - value(c, t / 2.0)).abs() < 1e-14);
            assert!((value(cubic_half(c, 1), t) - value(c, (t + 1.0) / 2.0)).abs() < 1e-14);
            let (s, b) = (1.0 - t, cubic_bezier(c));
            let bezier =
                b[0] * s * s * s + 3.0 * b[1] * s * s * t + 3.0 * b[2] * s * t * t + b[3] * t * t * t;
            assert!((bezier - value(c, t)).abs() < 1e-14);
        }
    }
}
