//! Positions with known parameters, accumulated by cell as moments.
//!
//! Input: a stream of `(u, v)`, positions and their information. Output: the information about the
//! coefficients, or about the nodes of a hierarchy. Memory does not grow with the number of positions.
//!
//! On one cell every product `b_k b_l` of two cubic weights is a polynomial of degree six in the local
//! coordinate. Therefore the 16 × 16 information of the sixteen weights is a linear function of the 7 × 7
//! moments `Σ w sⁱ tʲ`, and its vector of the 4 × 4 moments `Σ w z sⁱ tʲ`: 97 sums instead of 184. With
//! `s, t ∈ [−1, 1]` the function is well conditioned.
//!
//! Not guaranteed: the same last digit on machines with other SIMD instructions.

use planish_core::DVec3;

mod position_sums;

pub use position_sums::{AffineMap, PositionReading, PositionSums};

/// The B-spline weights of a cell as polynomials in `s = 2 x − 1`: coefficient of `sⁱ` in weight `k`, times
/// 48.
const WEIGHTS_48: [[f64; 4]; 4] =
    [[1.0, -3.0, 3.0, -1.0], [23.0, -15.0, -3.0, 3.0], [23.0, 15.0, -3.0, -3.0], [1.0, 3.0, 3.0, 1.0]];

/// Weights of `sᵏ` in `((s ∓ 1)/2)ⁱ` at `[i][k]`, for the lower and the upper half of a cell.
const POWERS_OF_HALF: [[[f64; 7]; 7]; 2] = [powers_of_half(-1.0), powers_of_half(1.0)];

const fn powers_of_half(end: f64) -> [[f64; 7]; 7] {
    let mut powers = [[0.0; 7]; 7];
    powers[0][0] = 1.0;
    let mut i = 1;
    while i < 7 {
        let mut k = 0;
        while k <= i {
            let risen = if k > 0 { powers[i - 1][k - 1] } else { 0.0 };
            powers[i][k] = 0.5 * (risen + end * powers[i - 1][k]);
            k += 1;
        }
        i += 1;
    }
    powers
}

/// Moments of the positions on one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellMoments {
    /// `Σ w sⁱ tʲ` at `[j][i]`, `i, j ≤ 6`. The eighth column completes a SIMD group of four and is not used.
    gram: [[f64; 8]; 7],
    /// `Σ w z sⁱ tʲ` at `[d][j][i]`, `i, j ≤ 3`, for the three coordinates of the positions.
    values: [[[f64; 4]; 4]; 3],
    /// `Σ w z²` of the three coordinates, and the number of positions.
    squares: [f64; 4],
}

/// A position on a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Reading {
    /// Local coordinates in `[−1, 1]²`.
    local: [f64; 2],
    /// Position relative to the origin of the sums.
    position: DVec3,
    information: f64,
}

/// `a b + c`, as a fused operation if the machine has one.
#[inline(always)]
fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

impl Default for CellMoments {
    fn default() -> Self {
        Self { gram: [[0.0; 8]; 7], values: [[[0.0; 4]; 4]; 3], squares: [0.0; 4] }
    }
}

impl CellMoments {
    /// Adds the position `Σ_k b_k P_k = z` at cell-local coordinates in `[0, 1]²`, with information `w` about
    /// each coordinate.
    pub fn add(&mut self, local: [f64; 2], position: DVec3, information: f64) {
        let local = local.map(|x| 2.0 * x - 1.0);
        self.add_run::<false>(&[Reading { local, position, information }]);
    }

    /// Adds the moments of another cell, with its information multiplied by a factor.
    pub fn merge(&mut self, other: &Self, factor: f64) {
        for (a, b) in self.gram.as_flattened_mut().iter_mut().zip(other.gram.as_flattened()) {
            *a += factor * b;
        }
        for (own, other) in self.values.iter_mut().zip(&other.values) {
            for (a, b) in own.as_flattened_mut().iter_mut().zip(other.as_flattened()) {
                *a += factor * b;
            }
        }
        for d in 0..3 {
            self.squares[d] += factor * other.squares[d];
        }
        // The count is a number of positions, not information.
        self.squares[3] += other.squares[3];
    }

    /// Adds the moments of one quarter of this cell, whose sides are half as long; `quarter` selects it along
    /// each direction.
    ///
    /// With `S = (s ± 1)/2` the moments of `S` are binomial sums of those of `s`.
    fn add_quarter(&mut self, fine: &Self, quarter: [usize; 2]) {
        let [along_u, along_v] = quarter.map(|half| &POWERS_OF_HALF[half]);
        for j in 0..7 {
            // Separable: 7 × 7 sums along v and then along u, instead of one sum over all pairs.
            let mut row = [0.0; 7];
            for (l, weight) in along_v[j][..=j].iter().enumerate() {
                for (sum, m) in row.iter_mut().zip(&fine.gram[l]) {
                    *sum += weight * m;
                }
            }
            for i in 0..7 {
                self.gram[j][i] += (0..=i).map(|k| along_u[i][k] * row[k]).sum::<f64>();
            }
        }
        for (own, fine) in self.values.iter_mut().zip(&fine.values) {
            for j in 0..4 {
                for i in 0..4 {
                    own[j][i] += (0..=j)
                        .map(|l| along_v[j][l] * (0..=i).map(|k| along_u[i][k] * fine[l][k]).sum::<f64>())
                        .sum::<f64>();
                }
            }
        }
        for (own, fine) in self.squares.iter_mut().zip(fine.squares) {
            *own += fine;
        }
    }

    /// Adds a run of positions. Sums of the matrix and then of the vector stay in registers.
    #[inline(always)]
    fn add_run<const FUSED: bool>(&mut self, run: &[Reading]) {
        // Local copies stay in registers during a run. Through the reference, each addition would be a store.
        let mut gram = self.gram;
        for reading in run {
            let ([s, t], w) = (reading.local, reading.information);
            let s2 = s * s;
            let low = [w, w * s, w * s2, w * (s2 * s)];
            // Powers 4 to 7 are s⁴ times the first four, so that both halves of a row are one SIMD operation
            // each.
            let s4 = s2 * s2;
            let mut power = 1.0;
            for row in &mut gram {
                let across = power * s4;
                for i in 0..4 {
                    row[i] = multiply_add::<FUSED>(low[i], power, row[i]);
                }
                for i in 0..4 {
                    row[4 + i] = multiply_add::<FUSED>(low[i], across, row[4 + i]);
                }
                power *= t;
            }
        }
        self.gram = gram;
        let (mut values, mut squares) = (self.values, self.squares);
        for reading in run {
            let ([s, t], w) = (reading.local, reading.information);
            let s2 = s * s;
            let low = [w, w * s, w * s2, w * (s2 * s)];
            let DVec3 { x, y, z } = reading.position;
            let z = [x, y, z, 1.0];
            let powers = [1.0, t, t * t, t * t * t];
            for (d, sums) in values.iter_mut().enumerate() {
                let weighted = low.map(|a| a * z[d]);
                for (row, power) in sums.iter_mut().zip(powers) {
                    for i in 0..4 {
                        row[i] = multiply_add::<FUSED>(weighted[i], power, row[i]);
                    }
                }
            }
            let scale = [w, w, w, 1.0];
            for d in 0..4 {
                squares[d] = multiply_add::<FUSED>(scale[d] * z[d], z[d], squares[d]);
            }
        }
        (self.values, self.squares) = (values, squares);
    }

    /// Number of positions.
    #[must_use]
    pub fn count(&self) -> usize {
        self.squares[3] as usize
    }

    /// The information about the sixteen coefficients: the matrix of each coordinate, and the vectors of all
    /// three.
    ///
    /// `Λ_kl = Σ w b_k b_l`, `η_k = Σ w b_k z`. Cost: about 1,500 multiply-adds.
    #[must_use]
    pub fn information(&self) -> ([[f64; 16]; 16], [[f64; 3]; 16]) {
        (matrix_of_moments(&self.gram), vector_of_moments(&self.values))
    }
}

/// `Σ w b_k b_l` over the sixteen weights of a cell from `Σ w sⁱ tʲ` at `[j][i]`.
pub(crate) fn matrix_of_moments(gram: &[[f64; 8]; 7]) -> [[f64; 16]; 16] {
    let products = weight_products();
    let mut matrix = [[0.0; 16]; 16];
    for k in 0..4 {
        for l in 0..=k {
            // Over powers of s first: the seven sums serve all products along the other direction.
            let mut along = [0.0; 7];
            for (sum, row) in along.iter_mut().zip(gram) {
                *sum = (0..7).map(|i| products[k][l][i] * row[i]).sum();
            }
            for r in 0..4 {
                for q in 0..=r {
                    let sum: f64 = (0..7).map(|j| products[r][q][j] * along[j]).sum();
                    // Products of weights are symmetric in both directions, so one sum gives four entries.
                    for (r, q) in [(r, q), (q, r)] {
                        matrix[4 * r + k][4 * q + l] = sum;
                        matrix[4 * r + l][4 * q + k] = sum;
                    }
                }
            }
        }
    }
    matrix
}

/// `Σ w b_k z` of three coordinates from `Σ w z sⁱ tʲ` at `[d][j][i]`.
pub(crate) fn vector_of_moments(values: &[[[f64; 4]; 4]; 3]) -> [[f64; 3]; 16] {
    let mut vector = [[0.0; 3]; 16];
    for d in 0..3 {
        for k in 0..4 {
            let mut along = [0.0; 4];
            for (sum, row) in along.iter_mut().zip(&values[d]) {
                *sum = (0..4).map(|i| WEIGHTS_48[k][i] / 48.0 * row[i]).sum();
            }
            for r in 0..4 {
                vector[4 * r + k][d] = (0..4).map(|j| WEIGHTS_48[r][j] / 48.0 * along[j]).sum();
            }
        }
    }
    vector
}

/// Coefficients of the products of two weights, as polynomials of degree six.
fn weight_products() -> [[[f64; 7]; 4]; 4] {
    let mut products = [[[0.0; 7]; 4]; 4];
    for k in 0..4 {
        for l in 0..4 {
            for i in 0..4 {
                for j in 0..4 {
                    products[k][l][i + j] += WEIGHTS_48[k][i] * WEIGHTS_48[l][j] / (48.0 * 48.0);
                }
            }
        }
    }
    products
}

impl CellMoments {
    /// The moments of the positions after a translation.
    fn moved(&self, by: DVec3) -> Self {
        let mut moved = *self;
        for d in 0..3 {
            moved.squares[d] += by[d] * (2.0 * self.values[d][0][0] + by[d] * self.gram[0][0]);
            for j in 0..4 {
                for i in 0..4 {
                    moved.values[d][j][i] += by[d] * self.gram[j][i];
                }
            }
        }
        moved
    }
}

#[cfg(test)]
mod tests;
