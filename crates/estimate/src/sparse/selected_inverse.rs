//! Entries of the covariance on the pattern of the factor.
//!
//! Input: a Cholesky factor. Output: the entries of `Λ⁻¹` on the pattern of `L + Lᵀ`, which contains every
//! pair of nodes that share an element. Not guaranteed: covariances of distant nodes; solve for those.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, MatMut, MatRef, Par};

use super::symbolic::Run;
use super::tree::{Spare, Walk, by_columns};
use super::{BlockInformation, BlockPattern, CholeskyFactor, SymbolicFactor};
use crate::{Error, Result};

/// Columns of a product computed together. Fixed, so that results do not depend on the number of threads.
const BLOCK_COLUMNS: usize = 64;

/// Selected entries of the covariance `Z = Λ⁻¹`, exact up to rounding.
///
/// For a supernode with columns C and rows R below, `Y = L_RC L_CC⁻¹`, from the last supernode to the first:
///
/// ```text
/// Z_RC = −Z_RR Y        Z_CC = L_CC⁻ᵀ L_CC⁻¹ − Yᵀ Z_RC
/// ```
///
/// `Z_RR` is already known, because R is part of the front of the parent. Cost: about twice the operations of
/// the factorisation.
///
/// # References
/// Takahashi, Fagan, Chin, *Formation of a sparse bus impedance matrix*, 1973; Erisman and Tinney, *On
/// computing certain elements of the inverse of a sparse matrix*, 1975; Rue and Martino, *Approximate
/// Bayesian inference for hierarchical Gaussian Markov random field models*, 2007.
#[derive(Clone)]
pub struct SelectedInverse {
    symbolic: Arc<SymbolicFactor>,
    /// Panels as in the factor, with complete diagonal blocks.
    values: Vec<f64>,
}

impl SelectedInverse {
    /// Computes the selected inverse from a factor.
    ///
    /// # Examples
    /// ```
    /// use planish_estimate::sparse::{
    ///     BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SelectedInverse, SymbolicFactor,
    /// };
    /// use std::sync::Arc;
    ///
    /// let pattern = Arc::new(BlockPattern::from_elements(2, [[0, 1]])?);
    /// let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(2), 1)?);
    /// let mut information = BlockInformation::zeros(pattern, 1, 0)?;
    /// information.add_element(&[0, 1], &[2.0, 1.0, 1.0, 2.0], &[])?;
    /// let covariance = SelectedInverse::new(&CholeskyFactor::factorize(&symbolic, &information)?);
    /// let block = covariance.dense(&[0, 1]).expect("both nodes share an element");
    /// for (found, expected) in block.iter().zip([2.0, -1.0, -1.0, 2.0]) {
    ///     assert!((found - expected / 3.0).abs() < 1e-15);
    /// }
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn new(factor: &CholeskyFactor) -> Self {
        Self { symbolic: Arc::clone(factor.symbolic()), values: vec![0.0; factor.symbolic().stored_values()] }
            .refresh(factor)
    }

    /// Computes the selected inverse from another factor and reuses the memory. The result has the same bytes
    /// as that of [`Self::new`].
    #[must_use]
    pub fn refresh(self, factor: &CholeskyFactor) -> Self {
        let symbolic = factor.symbolic();
        let mut values = self.values;
        // Every value is overwritten below, so old values need no clearing.
        values.resize(symbolic.stored_values(), 0.0);
        // About twice the operations of the factorisation, for the balance between threads.
        let work = |s: usize| 2.0 * symbolic.tree_flops(s);
        Walk::new(symbolic, &symbolic.value_start, &work).descend(&mut values, &|s, panel, z_rows, spare| {
            let (columns, height) = (symbolic.columns(s), symbolic.height(s));
            invert_panel(factor, s, panel, z_rows, spare);
            let children = symbolic.children(s).iter();
            children
                .map(|&child| {
                    let size = symbolic.height(child as usize);
                    // A contiguous copy per child: dense kernels need one stride, and children can run in
                    // parallel without a reference to the panel of their parent.
                    let mut part = spare.take(size * size);
                    gather(
                        symbolic.runs(child as usize),
                        size,
                        panel,
                        columns,
                        height,
                        z_rows,
                        &mut part[..size * size],
                    );
                    part
                })
                .collect()
        });
        Self { symbolic: Arc::clone(symbolic), values }
    }

    /// The symbolic analysis.
    #[must_use]
    pub fn symbolic(&self) -> &Arc<SymbolicFactor> {
        &self.symbolic
    }

    /// Memory of the values in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.values.len() * size_of::<f64>()
    }

    /// The `b × b` covariance of the unknowns of node `i` (rows) with those of node `j` (columns), row-major.
    ///
    /// `None` if the pair is not in the factor or a node does not exist.
    #[must_use]
    pub fn block(&self, i: u32, j: u32) -> Option<Vec<f64>> {
        let b = self.symbolic.block_size();
        let mut block = vec![0.0; b * b];
        self.copy_block(i, j, &mut block, b).then_some(block)
    }

    /// Copies block `(i, j)` to a row-major target with the given `stride` of rows. Returns false if the pair
    /// is not in the factor.
    fn copy_block(&self, i: u32, j: u32, target: &mut [f64], stride: usize) -> bool {
        let symbolic = &*self.symbolic;
        let nodes = symbolic.new_from_old.len() as u32;
        if i >= nodes || j >= nodes {
            return false;
        }
        let (row, column) = (symbolic.new_from_old[i as usize], symbolic.new_from_old[j as usize]);
        let Some(slot) = symbolic.locate(row.max(column), row.min(column)) else {
            return false;
        };
        let b = symbolic.block_size();
        for r in 0..b {
            for s in 0..b {
                // The ordering may exchange the nodes of a pair; the stored block is then the transposed one.
                let (down, across) = if row >= column { (r, s) } else { (s, r) };
                target[r * stride + s] = self.values[slot.offset + across * slot.stride + down];
            }
        }
        true
    }

    /// The variances of all unknowns, node-major.
    #[must_use]
    pub fn diagonal(&self) -> Vec<f64> {
        let symbolic = &*self.symbolic;
        let b = symbolic.block_size();
        let mut diagonal = vec![0.0; symbolic.dimension()];
        for s in 0..symbolic.supernodes() {
            let stride = symbolic.columns(s) + symbolic.height(s);
            for k in 0..symbolic.columns(s) {
                let node = symbolic.old_from_new[symbolic.supernode_start[s] as usize + k / b] as usize;
                diagonal[node * b + k % b] = self.values[symbolic.value_start[s] + k * stride + k];
            }
        }
        diagonal
    }

    /// The dense `k·b × k·b` covariance of k nodes, row-major.
    ///
    /// Always available for the nodes of one element of the pattern. `None` if some pair is not in the
    /// factor.
    #[must_use]
    pub fn dense(&self, nodes: &[u32]) -> Option<Vec<f64>> {
        let mut covariance = Vec::new();
        self.dense_into(nodes, &mut covariance).then_some(covariance)
    }

    /// [`Self::dense`] into a reused buffer. Returns false if some pair is not in the factor.
    pub fn dense_into(&self, nodes: &[u32], covariance: &mut Vec<f64>) -> bool {
        let symbolic = &*self.symbolic;
        let b = symbolic.block_size();
        let stride = nodes.len() * b;
        covariance.clear();
        covariance.resize(stride * stride, 0.0);
        if nodes.iter().any(|&node| node as usize >= symbolic.new_from_old.len()) {
            return false;
        }
        let mut order: Vec<(u32, usize)> =
            (nodes.iter().enumerate()).map(|(a, &node)| (symbolic.new_from_old[node as usize], a)).collect();
        // In elimination order, the entries below the diagonal lie in the column of the earlier node.
        order.sort_unstable();
        // Columns of one supernode share their rows, so the search for rows is done once.
        let mut places = vec![0; order.len()];
        let mut supernode = usize::MAX;
        for (c, &(column, across)) in order.iter().enumerate() {
            let s = symbolic.supernode_of[column as usize] as usize;
            let (begin, end) = (symbolic.supernode_start[s], symbolic.supernode_start[s + 1]);
            let rows = symbolic.rows(s);
            let own = (end - begin) as usize;
            if s != supernode {
                supernode = s;
                for (place, &(row, _)) in places[c..].iter_mut().zip(&order[c..]) {
                    *place = if row < end {
                        (row - begin) as usize
                    } else {
                        match rows.binary_search(&row) {
                            Ok(found) => own + found,
                            Err(_) => return false,
                        }
                    };
                }
            }
            let height = (own + rows.len()) * b;
            let offset = symbolic.value_start[s] + (column - begin) as usize * b * height;
            for (&place, &(_, down)) in places[c..].iter().zip(&order[c..]) {
                let block = offset + place * b;
                for r in 0..b {
                    for q in 0..b {
                        let value = self.values[block + q * height + r];
                        covariance[(down * b + r) * stride + across * b + q] = value;
                        covariance[(across * b + q) * stride + down * b + r] = value;
                    }
                }
            }
        }
        true
    }

    /// `tr(Λ⁻¹ K)` for a matrix `K` on the same pattern.
    ///
    /// If `K` has one unknown per node and `Λ` has b, `K ⊗ I_b` is used. Cost: O(entries of K).
    ///
    /// # Errors
    /// `Input` when `K` has another pattern or block size.
    pub fn trace_with(&self, matrix: &BlockInformation) -> Result<f64> {
        let symbolic = &*self.symbolic;
        let b = symbolic.block_size();
        let own = matrix.block_size();
        if !BlockPattern::same(matrix.pattern(), symbolic.pattern()) || (own != b && own != 1) {
            return Err(Error::input("pattern or block size of the matrix differ from the covariance"));
        }
        let pattern = symbolic.pattern();
        // Marked once, instead of a comparison of nodes per entry.
        let mut is_diagonal = vec![false; pattern.entries()];
        for node in 0..pattern.nodes() {
            is_diagonal[pattern.column_range(node).start] = true;
        }
        let mut trace = 0.0;
        for slot in symbolic.all_slots() {
            let covariance = |row: usize, column: usize| {
                let (row, column) = if slot.transposed() { (column, row) } else { (row, column) };
                self.values[slot.offset + column * slot.stride() + row]
            };
            let values = &matrix.values()[slot.entry() * own * own..(slot.entry() + 1) * own * own];
            let mut part = 0.0;
            if own == b {
                for row in 0..b {
                    for column in 0..b {
                        part += covariance(row, column) * values[row * b + column];
                    }
                }
            } else {
                for k in 0..b {
                    part += covariance(k, k) * values[0];
                }
            }
            // An off-diagonal pair represents both triangles.
            trace += if is_diagonal[slot.entry()] { part } else { 2.0 * part };
        }
        Ok(trace)
    }
}

impl std::fmt::Debug for SelectedInverse {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SelectedInverse").field("symbolic", &self.symbolic).finish_non_exhaustive()
    }
}

/// Computes `Z_CC` and `Z_RC` of a supernode from its `Z_RR` and stores them in its panel.
fn invert_panel(factor: &CholeskyFactor, s: usize, panel: &mut [f64], z_rows: &[f64], spare: &mut Spare) {
    let symbolic = factor.symbolic();
    let (columns, height) = (symbolic.columns(s), symbolic.height(s));
    let (top, below) = factor.panel(s);
    let mut inverse_values = spare.take(columns * columns);
    inverse_values[..columns * columns].fill(0.0);
    let mut inverse =
        MatMut::from_column_major_slice_mut(&mut inverse_values[..columns * columns], columns, columns);
    // An explicit inverse, because `Z_CC` needs `L_CC⁻ᵀ L_CC⁻¹`. With it, `Y` is a plain product.
    invert_lower_triangular(inverse.rb_mut(), top, Par::Seq);
    let inverse = inverse.rb();
    let (mut z_own, mut z_below) =
        MatMut::from_column_major_slice_mut(panel, columns + height, columns).split_at_row_mut(columns);
    triangular_matmul(
        z_own.rb_mut(),
        BlockStructure::TriangularLower,
        Accum::Replace,
        inverse.transpose(),
        BlockStructure::TriangularUpper,
        inverse,
        BlockStructure::TriangularLower,
        1.0,
        Par::Seq,
    );
    if height > 0 {
        let z_rows = MatRef::from_column_major_slice(&z_rows[..height * height], height, height);
        let mut gain = spare.take(height * columns);
        by_columns(&mut gain[..height * columns], height, BLOCK_COLUMNS, |from, part| {
            // The inverse of a lower triangle is zero above its diagonal.
            let width = part.len() / height;
            matmul(
                MatMut::from_column_major_slice_mut(part, height, width),
                Accum::Replace,
                below.subcols(from, columns - from),
                inverse.submatrix(from, from, columns - from, width),
                1.0,
                Par::Seq,
            );
        });
        let gain_matrix = MatRef::from_column_major_slice(&gain[..height * columns], height, columns);
        minus_product(z_rows, gain_matrix, z_below.rb_mut());
        triangular_matmul(
            z_own.rb_mut(),
            BlockStructure::TriangularLower,
            Accum::Add,
            gain_matrix.transpose(),
            BlockStructure::Rectangular,
            z_below.rb(),
            BlockStructure::Rectangular,
            -1.0,
            Par::Seq,
        );
        spare.give_back(gain);
    }
    spare.give_back(inverse_values);
    // Kernels compute lower triangles only. Children gather columns from the panel and need both.
    mirror(panel, columns + height, columns);
}

/// Gathers `Z_RR` of a child, both triangles, from the front of its parent.
fn gather(
    runs: &[Run],
    size: usize,
    panel: &[f64],
    columns: usize,
    height: usize,
    z_rows: &[f64],
    part: &mut [f64],
) {
    for (at, run) in runs.iter().enumerate() {
        let (from, to, length) = (run.from as usize, run.to as usize, run.length as usize);
        for k in 0..length {
            let (source, shift) = if to + k < columns {
                (&panel[(to + k) * (columns + height)..(to + k + 1) * (columns + height)], 0)
            } else {
                (&z_rows[(to + k - columns) * height..(to + k - columns + 1) * height], columns)
            };
            let target = &mut part[(from + k) * size..(from + k + 1) * size];
            target[from + k..from + length].copy_from_slice(&source[to + k - shift..to + length - shift]);
            // Only the lower triangle is copied here. Runs are contiguous, so each is one copy.
            for below in &runs[at + 1..] {
                let (from, to, length) = (below.from as usize, below.to as usize, below.length as usize);
                target[from..from + length].copy_from_slice(&source[to - shift..to + length - shift]);
            }
        }
    }
    mirror(part, size, size);
}

/// `C ← −A B`, in parallel over blocks of columns.
fn minus_product(a: MatRef<'_, f64>, b: MatRef<'_, f64>, c: MatMut<'_, f64>) {
    if c.ncols() > BLOCK_COLUMNS {
        // Halves of a fixed size, whatever the number of threads, so that the result has the same bytes.
        // Multiples of four columns fill the registers of the kernel.
        let half = (c.ncols() / 2).next_multiple_of(4);
        let (left, right) = c.split_at_col_mut(half);
        let (b_left, b_right) = b.split_at_col(half);
        rayon::join(|| minus_product(a, b_left, left), || minus_product(a, b_right, right));
    } else {
        matmul(c, Accum::Replace, a, b, -1.0, Par::Seq);
    }
}

/// Copies the lower triangle of the first `columns` rows and columns to the upper one, in tiles that fit the
/// cache.
fn mirror(values: &mut [f64], stride: usize, columns: usize) {
    const TILE: usize = 16;
    for left in (0..columns).step_by(TILE) {
        for top in (left..columns).step_by(TILE) {
            for j in left..(left + TILE).min(columns) {
                for i in top.max(j + 1)..(top + TILE).min(columns) {
                    values[i * stride + j] = values[j * stride + i];
                }
            }
        }
    }
}
