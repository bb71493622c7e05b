//! Information of the measurements in one leaf about its sixteen coefficients, and its transfer to the nodes.
//!
//! Input: rows `Σ_k c_k a·P_k = z` with weights. Output: a dense symmetric element over the nodes of the
//! leaf. Accumulation uses only a block of fixed size, so observations can be streamed.
//!
//! Layout: one 16 × 16 matrix over pairs `(k, l)` of coefficients for each of the six entries
//! `xx xy xz yy yz zz` of a symmetric 3 × 3 block. The block of a pair is symmetric, because every row uses a
//! single direction for all coefficients. Each matrix is therefore symmetric, and row `k` is filled only up
//! to the SIMD group of four that contains the diagonal.

use crate::hierarchy::Hierarchy;
use planish_core::DVec3;

/// A symmetric matrix over the sixteen coefficients with the lower triangle filled in groups of four.
type Triangle = [[f64; 16]; 16];

/// Number of filled entries of row `k`.
#[inline(always)]
fn filled(k: usize) -> usize {
    // Complete rows would double the work; exact triangles would leave SIMD groups half empty.
    4 * (k / 4 + 1)
}

/// Adds `w · row` to row `k` of a symmetric matrix whose lower triangle is filled in groups of four.
#[inline(always)]
pub(crate) fn add_to_triangle(line: &mut [f64], k: usize, w: f64, row: &[f64]) {
    let filled = filled(k).min(row.len());
    for (entry, r) in line[..filled].iter_mut().zip(&row[..filled]) {
        *entry += w * r;
    }
}

/// Accumulated information `Λ`, `η` about the sixteen coefficients of one leaf.
#[derive(Debug, Clone)]
pub struct CellInformation {
    matrix: Box<[Triangle; 6]>,
    vector: [[f64; 3]; 16],
}

impl Default for CellInformation {
    fn default() -> Self {
        Self { matrix: Box::new([[[0.0; 16]; 16]; 6]), vector: [[0.0; 3]; 16] }
    }
}

impl CellInformation {
    /// Sets all information to zero.
    pub fn clear(&mut self) {
        *self.matrix = [[[0.0; 16]; 16]; 6];
        self.vector = [[0.0; 3]; 16];
    }

    /// Adds the scalar measurement `a · Σ_k c_k P_k = value` with the given information (1/variance).
    ///
    /// For the normal component of a position, `c` are the B-spline weights and `a` is the normal. For a
    /// measured normal, `c` are derivative weights. Cost: about 1,000 multiply-adds in SIMD groups of four.
    #[inline]
    pub fn add_scalar(&mut self, c: &[f64; 16], a: DVec3, value: f64, information: f64) {
        // The block `w a aᵀ` is the same for all pairs of coefficients, up to the factor `c_k c_l`.
        let w = information;
        let outer = [
            w * a[0] * a[0],
            w * a[0] * a[1],
            w * a[0] * a[2],
            w * a[1] * a[1],
            w * a[1] * a[2],
            w * a[2] * a[2],
        ];
        self.add_block(c, &outer);
        let z = w * value;
        for k in 0..16 {
            for d in 0..3 {
                self.vector[k][d] += c[k] * z * a[d];
            }
        }
    }

    /// Adds the vector measurement `Σ_k c_k P_k = value` with information matrix `xx xy xz yy yz zz`.
    #[inline]
    pub fn add_vector(&mut self, c: &[f64; 16], value: DVec3, information: &[f64; 6]) {
        self.add_block(c, information);
        let [xx, xy, xz, yy, yz, zz] = *information;
        let DVec3 { x, y, z } = value;
        // Once per reading, not once per coefficient.
        let weighted = [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z];
        for k in 0..16 {
            for d in 0..3 {
                self.vector[k][d] += c[k] * weighted[d];
            }
        }
    }

    #[inline]
    fn add_block(&mut self, c: &[f64; 16], block: &[f64; 6]) {
        for (triangle, x) in self.matrix.iter_mut().zip(block) {
            for k in 0..16 {
                add_to_triangle(&mut triangle[k], k, x * c[k], c);
            }
        }
    }

    /// Adds symmetric matrices over the sixteen coefficients for `xx xy xz yy yz zz`, and a vector.
    pub(crate) fn add_triangles(&mut self, matrices: &[[[f64; 16]; 16]; 6], vector: &[[f64; 3]; 16]) {
        for (triangle, matrix) in self.matrix.iter_mut().zip(matrices) {
            for (k, (line, row)) in triangle.iter_mut().zip(matrix).enumerate() {
                add_to_triangle(line, k, 1.0, row);
            }
        }
        for (own, more) in self.vector.as_flattened_mut().iter_mut().zip(vector.as_flattened()) {
            *own += more;
        }
    }

    /// Adds the information of another cell.
    pub fn add(&mut self, other: &Self) {
        for (a, b) in self.matrix.iter_mut().zip(&*other.matrix) {
            for (a, b) in a.as_flattened_mut().iter_mut().zip(b.as_flattened()) {
                *a += b;
            }
        }
        for k in 0..16 {
            for d in 0..3 {
                self.vector[k][d] += other.vector[k][d];
            }
        }
    }

    /// Writes the element over the nodes of the leaf to the buffers: dense symmetric `3n × 3n` (row-major)
    /// and `3n`.
    ///
    /// With the extraction `P = Eᵀ V` it is `E Λ Eᵀ` and `E η`. Cost: 96 multiply-adds per nonzero weight,
    /// and six per pair of nodes.
    pub fn element(&self, space: &Hierarchy, leaf: usize, matrix: &mut Vec<f64>, vector: &mut Vec<f64>) {
        let (nodes, weights) = space.extraction(leaf);
        let n = nodes.len();
        matrix.clear();
        matrix.resize(9 * n * n, 0.0);
        vector.clear();
        vector.resize(3 * n, 0.0);
        // Skip zero weights: away from changes of level each node is one coefficient.
        let sparse: Vec<Vec<(usize, f64)>> = weights
            .iter()
            .map(|w| w.iter().copied().enumerate().filter(|(_, w)| *w != 0.0).collect())
            .collect();
        for a in 0..n {
            // In two steps, first `E Λ` and then `(E Λ) Eᵀ`: fewer products than over all pairs at once.
            let mut half = [[0.0; 16]; 6];
            for &(k, w) in &sparse[a] {
                let filled = filled(k);
                for (half, triangle) in half.iter_mut().zip(&*self.matrix) {
                    for (h, m) in half[..filled].iter_mut().zip(&triangle[k][..filled]) {
                        *h += w * m;
                    }
                    // Only the lower triangle is filled, so the rest of the row is a column.
                    for (h, row) in half[filled..].iter_mut().zip(&triangle[filled..]) {
                        *h += w * row[k];
                    }
                }
            }
            for b in 0..=a {
                let mut block = [0.0; 6];
                for &(l, w) in &sparse[b] {
                    for (block, half) in block.iter_mut().zip(&half) {
                        *block += w * half[l];
                    }
                }
                let full = [
                    [block[0], block[1], block[2]],
                    [block[1], block[3], block[4]],
                    [block[2], block[4], block[5]],
                ];
                for i in 0..3 {
                    for j in 0..3 {
                        matrix[(3 * a + i) * 3 * n + 3 * b + j] = full[i][j];
                        matrix[(3 * b + j) * 3 * n + 3 * a + i] = full[i][j];
                    }
                }
            }
            for &(k, w) in &sparse[a] {
                for d in 0..3 {
                    vector[3 * a + d] += w * self.vector[k][d];
                }
            }
        }
    }
}

/// The scalar element `E K Eᵀ` over the nodes of a leaf, dense row-major, for a symmetric form `K` on its
/// coefficients.
#[must_use]
pub fn scalar_element(space: &Hierarchy, leaf: usize, form: &[[f64; 16]; 16]) -> Vec<f64> {
    let (nodes, weights) = space.extraction(leaf);
    let n = nodes.len();
    // Skip zero weights: away from changes of level each node is one coefficient.
    let mut sparse = Vec::with_capacity(2 * n);
    let mut start = Vec::with_capacity(n + 1);
    for w in weights {
        start.push(sparse.len());
        sparse.extend(w.iter().copied().enumerate().filter(|(_, w)| *w != 0.0));
    }
    start.push(sparse.len());
    let mut matrix = vec![0.0; n * n];
    if sparse.len() == n && start.windows(2).all(|pair| pair[1] == pair[0] + 1) {
        // Fast path: each node is one coefficient.
        for (line, &(k, w)) in matrix.chunks_exact_mut(n).zip(&sparse) {
            for (value, &(l, x)) in line.iter_mut().zip(&sparse) {
                *value = w * x * form[k][l];
            }
        }
        return matrix;
    }
    for a in 0..n {
        let mut half = [0.0; 16];
        for &(k, w) in &sparse[start[a]..start[a + 1]] {
            for (half, f) in half.iter_mut().zip(&form[k]) {
                *half += w * f;
            }
        }
        for b in 0..=a {
            let value = (sparse[start[b]..start[b + 1]].iter()).map(|&(l, w)| w * half[l]).sum();
            matrix[a * n + b] = value;
            matrix[b * n + a] = value;
        }
    }
    matrix
}

/// Covariance of the point `Σ_k c_k P_k` of a leaf along a direction, from the dense covariance (`3n × 3n`)
/// of its nodes.
#[must_use]
pub fn variance_along(
    space: &Hierarchy,
    leaf: usize,
    covariance: &[f64],
    c: &[f64; 16],
    direction: DVec3,
) -> f64 {
    let (nodes, weights) = space.extraction(leaf);
    let n = nodes.len();
    // Weights of the nodes first: the double sum then has n² terms instead of 256 n².
    let row: Vec<f64> = weights.iter().map(|w| (0..16).map(|k| w[k] * c[k]).sum()).collect();
    let mut variance = 0.0;
    for a in 0..n {
        for b in 0..n {
            let mut along = 0.0;
            for i in 0..3 {
                let line = &covariance[(3 * a + i) * 3 * n + 3 * b..][..3];
                along +=
                    direction[i] * (line[0] * direction[0] + line[1] * direction[1] + line[2] * direction[2]);
            }
            variance += row[a] * row[b] * along;
        }
    }
    variance
}

/// The covariance of a leaf reduced to its sixteen coefficients, for cheap variances at many points of the
/// leaf.
#[derive(Debug, Clone)]
pub struct CellCovariance {
    /// `Cov(P_k, P_l)` as 3 × 3 blocks, `16 · k + l`.
    blocks: Vec<[f64; 9]>,
}

impl CellCovariance {
    /// Computes `Eᵀ Σ E` from the dense covariance of the nodes of the leaf.
    #[must_use]
    pub fn new(space: &Hierarchy, leaf: usize, covariance: &[f64]) -> Self {
        let (nodes, weights) = space.extraction(leaf);
        let n = nodes.len();
        // Blocks of different coefficients are not symmetric (the transpose belongs to the mirrored pair), so
        // all nine entries are stored.
        let mut half = vec![[0.0; 9]; n * 16];
        for a in 0..n {
            for b in 0..n {
                let mut block = [0.0; 9];
                for i in 0..3 {
                    block[3 * i..3 * i + 3].copy_from_slice(&covariance[(3 * a + i) * 3 * n + 3 * b..][..3]);
                }
                for l in 0..16 {
                    let w = weights[b][l];
                    if w != 0.0 {
                        for e in 0..9 {
                            half[16 * a + l][e] += w * block[e];
                        }
                    }
                }
            }
        }
        let mut blocks = vec![[0.0; 9]; 256];
        for a in 0..n {
            for k in 0..16 {
                let w = weights[a][k];
                if w != 0.0 {
                    for l in 0..16 {
                        for e in 0..9 {
                            blocks[16 * k + l][e] += w * half[16 * a + l][e];
                        }
                    }
                }
            }
        }
        Self { blocks }
    }

    /// Variance of `a · Σ_k c_k P_k`.
    #[must_use]
    pub fn variance_along(&self, c: &[f64; 16], a: DVec3) -> f64 {
        let mut variance = 0.0;
        for k in 0..16 {
            let mut row = 0.0;
            for l in 0..16 {
                let m = &self.blocks[16 * k + l];
                let along = a[0] * (m[0] * a[0] + m[1] * a[1] + m[2] * a[2])
                    + a[1] * (m[3] * a[0] + m[4] * a[1] + m[5] * a[2])
                    + a[2] * (m[6] * a[0] + m[7] * a[1] + m[8] * a[2]);
                row += c[l] * along;
            }
            variance += c[k] * row;
        }
        variance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::Shape;
    use crate::surface::leaf_weights;

    /// Compares the information of one row with the explicit product over nodes.
    #[test]
    fn element_equals_the_outer_product_of_the_row_over_the_nodes() {
        let uniform = Hierarchy::uniform(Shape::Ball, [8, 6]).unwrap();
        let block: Vec<usize> =
            [(2.5, 2.5), (3.5, 2.5), (2.5, 3.5), (3.5, 3.5)].map(|(u, v)| uniform.locate(u, v).0).to_vec();
        let space = uniform.refine(&block);
        for (leaf, _) in space.leaves().iter().enumerate().step_by(3) {
            let c = leaf_weights(0.3, 0.8);
            let (a, value, information) = (DVec3::new(0.6, -0.48, 0.64), 1.7, 4.0);
            let mut cell = CellInformation::default();
            cell.add_scalar(&c, a, value, information);
            let (mut matrix, mut vector) = (Vec::new(), Vec::new());
            cell.element(&space, leaf, &mut matrix, &mut vector);
            let (nodes, weights) = space.extraction(leaf);
            let n = 3 * nodes.len();
            let row: Vec<f64> = weights
                .iter()
                .flat_map(|w| {
                    let s: f64 = (0..16).map(|k| w[k] * c[k]).sum();
                    (s * a).to_array()
                })
                .collect();
            for i in 0..n {
                assert!((vector[i] - information * value * row[i]).abs() < 1e-12);
                for j in 0..n {
                    assert!((matrix[i * n + j] - information * row[i] * row[j]).abs() < 1e-12);
                }
            }
            // The variance along the row from an arbitrary covariance, computed in both ways.
            let covariance: Vec<f64> = (0..n * n).map(|e| if e % (n + 1) == 0 { 2.0 } else { 0.1 }).collect();
            let direct: f64 =
                (0..n).map(|i| (0..n).map(|j| row[i] * covariance[i * n + j] * row[j]).sum::<f64>()).sum();
            assert!((variance_along(&space, leaf, &covariance, &c, a) - direct).abs() < 1e-12);
            let reduced = CellCovariance::new(&space, leaf, &covariance);
            assert!((reduced.variance_along(&c, a) - direct).abs() < 1e-11);
        }
    }
}
