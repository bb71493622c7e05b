//! Sparse information matrix and vectors over the nodes of a pattern.
//!
//! Input: dense information of single elements, or other sparse information to merge. Output: `Λ` and `η` of
//! `p(x) ∝ exp(−½ xᵀΛx + ηᵀx)`. Not guaranteed: that `Λ` is positive definite; [`super::CholeskyFactor`]
//! checks this.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::BlockPattern;
use crate::{Error, Result};

/// Positions of the entries of the dense matrix of an element, computed once and used for every accumulation.
///
/// For `k` nodes it holds `k(k+1)/2` positions of four bytes each.
#[derive(Debug, Clone)]
pub struct ElementScatter {
    nodes: Box<[u32]>,
    /// Position of each pair `(a, c)`, `c ≤ a`, with the flags [`TRANSPOSED`] and [`REPEATED`] in the two
    /// upper bits.
    slots: Box<[u32]>,
    repeats: bool,
    pattern_nodes: usize,
    pattern_entries: usize,
}

/// The dense block `(a, c)` belongs to the upper triangle, so its transpose is stored.
const TRANSPOSED: u32 = 1 << 31;
/// The element contains a node twice: block and transposed block are both added to its diagonal.
const REPEATED: u32 = 1 << 30;
const POSITION: u32 = REPEATED - 1;

impl ElementScatter {
    /// The scatter map of one element.
    ///
    /// Cost: O(k² log m) for columns of m entries.
    ///
    /// # Errors
    /// `Input` when two of the nodes are not coupled in the pattern.
    pub fn new(pattern: &BlockPattern, nodes: &[u32]) -> Result<Self> {
        let mut slots = Vec::with_capacity(nodes.len() * (nodes.len() + 1) / 2);
        let mut repeats = false;
        for (a, &row) in nodes.iter().enumerate() {
            for (c, &column) in nodes[..=a].iter().enumerate() {
                let position = pattern.position(row, column).ok_or_else(|| not_coupled(row, column))? as u32;
                // A surface that is closed with few columns uses a node more than once per element.
                let repeated = a != c && row == column;
                repeats |= repeated;
                slots.push(
                    position
                        | if row < column { TRANSPOSED } else { 0 }
                        | if repeated { REPEATED } else { 0 },
                );
            }
        }
        Ok(Self {
            nodes: nodes.into(),
            slots: slots.into(),
            repeats,
            pattern_nodes: pattern.nodes(),
            pattern_entries: pattern.entries(),
        })
    }

    /// The element's nodes, in the order of the dense matrix.
    #[must_use]
    pub fn nodes(&self) -> &[u32] {
        &self.nodes
    }
}

fn not_coupled(i: u32, j: u32) -> Error {
    Error::input(format!(
        "nodes {i} and {j} are not coupled in the pattern: build the pattern with this element"
    ))
}

/// Information over the nodes of a shared pattern: the matrix `Λ` in `b × b` blocks and the vectors `η`.
///
/// Shapes: `Λ` is `n·b × n·b` for n nodes; `η` is `n·b × columns`, node-major (row-major). With `b = 1` and
/// three columns, the coordinates x, y, z share one matrix; with `b = 3` and one column they are coupled.
/// Both have the same layout of `η`.
///
/// # Examples
/// ```
/// use std::sync::Arc;
/// use planish_estimate::sparse::{BlockInformation, BlockPattern};
/// let pattern = Arc::new(BlockPattern::from_elements(3, [[0, 1], [1, 2]])?);
/// let mut information = BlockInformation::zeros(pattern, 1, 1)?;
/// // One reading z = 5 of (x0 + x1)/2 with variance 0.25.
/// let (w, z) = (1.0 / 0.25, 5.0);
/// information.add_element(&[0, 1], &[0.25 * w, 0.25 * w, 0.25 * w, 0.25 * w], &[0.5 * w * z, 0.5 * w * z])?;
/// assert_eq!(information.quadratic_form(&[1.0, 1.0, 0.0])?, 4.0);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct BlockInformation {
    pattern: Arc<BlockPattern>,
    block: usize,
    columns: usize,
    /// Block `(i, j)`, `i ≥ j`, row-major, at `position(i, j)·b²`; diagonal blocks are stored completely.
    values: Vec<f64>,
    vector: Vec<f64>,
}

impl BlockInformation {
    /// Zero information with blocks of `block × block` and `columns` right-hand sides.
    ///
    /// # Errors
    /// `Input` when `block` is zero.
    pub fn zeros(pattern: Arc<BlockPattern>, block: usize, columns: usize) -> Result<Self> {
        if block == 0 {
            return Err(Error::input("expected at least one unknown per node"));
        }
        // One allocation for all blocks: they are added and factorised in the order of memory.
        let values = vec![0.0; pattern.entries() * block * block];
        let vector = vec![0.0; pattern.nodes() * block * columns];
        Ok(Self { pattern, block, columns, values, vector })
    }

    /// The pattern.
    #[must_use]
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    /// Number of unknowns per node.
    #[must_use]
    pub fn block_size(&self) -> usize {
        self.block
    }

    /// Number of right-hand sides.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of unknowns: nodes times block size.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.pattern.nodes() * self.block
    }

    /// The blocks of the lower triangle in the order of the pattern, each row-major.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Mutable access to the blocks, for example to restore a saved model. Diagonal blocks must stay
    /// symmetric.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// The information vectors `η`, node-major.
    #[must_use]
    pub fn vector(&self) -> &[f64] {
        &self.vector
    }

    /// Mutable access to the information vectors.
    pub fn vector_mut(&mut self) -> &mut [f64] {
        &mut self.vector
    }

    /// Sets all information to zero, without freeing memory.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
        self.vector.fill(0.0);
    }

    /// The block that couples nodes `i` and `j` (rows of `i`), row-major; `None` when they are not coupled.
    #[must_use]
    pub fn block(&self, i: u32, j: u32) -> Option<Vec<f64>> {
        let b = self.block;
        let position = self.pattern.position(i, j)?;
        let stored = &self.values[position * b * b..(position + 1) * b * b];
        Some(if i >= j {
            stored.to_vec()
        } else {
            (0..b * b).map(|at| stored[at % b * b + at / b]).collect()
        })
    }

    /// Adds the information of one element. Searches for its entries.
    ///
    /// `matrix` is the dense symmetric `k·b × k·b` information, row-major; its lower triangle and its
    /// diagonal blocks are read. `vector` is `k·b × columns`, node-major. Prefer [`Self::add_scattered`] for
    /// elements that are added repeatedly.
    ///
    /// # Errors
    /// `Input` when nodes are not coupled in the pattern or when a length is wrong. Nothing is added then.
    pub fn add_element(&mut self, nodes: &[u32], matrix: &[f64], vector: &[f64]) -> Result<()> {
        let scatter = ElementScatter::new(&self.pattern, nodes)?;
        self.add_scattered(&scatter, matrix, vector)
    }

    /// Adds the information of one element by its scatter map; shapes as in [`Self::add_element`].
    ///
    /// Cost: k(k+1)/2 · b² additions.
    ///
    /// # Errors
    /// `Input` when the map belongs to another pattern or when a length is wrong. Nothing is added then.
    pub fn add_scattered(&mut self, scatter: &ElementScatter, matrix: &[f64], vector: &[f64]) -> Result<()> {
        let (b, columns, k) = (self.block, self.columns, scatter.nodes.len());
        if scatter.pattern_nodes != self.pattern.nodes() || scatter.pattern_entries != self.pattern.entries()
        {
            return Err(Error::input("the element's scatter map was made for another pattern"));
        }
        expect_length("an element's matrix", k * b * k * b, matrix.len())?;
        expect_length("an element's vector", k * b * columns, vector.len())?;

        let mut slots = scatter.slots.iter();
        // The usual case of a fit: no flags to test in the innermost loop.
        if b == 1 && !scatter.repeats {
            for a in 0..k {
                let row = &matrix[a * k..a * k + a + 1];
                for (&value, &slot) in row.iter().zip(&mut slots) {
                    self.values[(slot & POSITION) as usize] += value;
                }
            }
        } else {
            let stride = k * b;
            for a in 0..k {
                for (c, &slot) in (0..=a).zip(&mut slots) {
                    let at = (slot & POSITION) as usize * b * b;
                    // Only blocks with `c ≤ a` are read. The matrix is symmetric, so the others contain the
                    // same values.
                    let target = &mut self.values[at..at + b * b];
                    let source = &matrix[a * b * stride + c * b..];
                    if slot & TRANSPOSED == 0 {
                        for r in 0..b {
                            for s in 0..b {
                                target[r * b + s] += source[r * stride + s];
                            }
                        }
                    }
                    // A repeated node maps the pair and its mirror image to one diagonal block, so both are
                    // added there.
                    if slot & (TRANSPOSED | REPEATED) != 0 {
                        for r in 0..b {
                            for s in 0..b {
                                target[s * b + r] += source[r * stride + s];
                            }
                        }
                    }
                }
            }
        }
        let width = b * columns;
        if width > 0 {
            for (&node, part) in scatter.nodes.iter().zip(vector.chunks_exact(width)) {
                let target = &mut self.vector[node as usize * width..(node as usize + 1) * width];
                for (to, &from) in target.iter_mut().zip(part) {
                    *to += from;
                }
            }
        }
        Ok(())
    }

    /// Adds `weight · other`: matrix and vectors. With weight 1 this merges independent information.
    ///
    /// # Errors
    /// `Input` when patterns, block sizes or numbers of columns differ.
    pub fn add_scaled(&mut self, other: &Self, weight: f64) -> Result<()> {
        // Entries are added by position. Different patterns would add unrelated entries.
        if !BlockPattern::same(&self.pattern, &other.pattern) {
            return Err(Error::input(
                "cannot add information over different patterns: use the union of both patterns",
            ));
        }
        if self.block != other.block || self.columns != other.columns {
            return Err(Error::input(format!(
                "cannot add information in blocks of {} with {} columns to blocks of {} with {} columns",
                other.block, other.columns, self.block, self.columns
            )));
        }
        for (to, &from) in self.values.iter_mut().zip(&other.values) {
            *to += weight * from;
        }
        for (to, &from) in self.vector.iter_mut().zip(&other.vector) {
            *to += weight * from;
        }
        Ok(())
    }

    /// The same information on a larger pattern.
    ///
    /// # Errors
    /// `Input` when the wider pattern lacks an entry of this one.
    pub fn on_pattern(&self, wider: &Arc<BlockPattern>) -> Result<Self> {
        if BlockPattern::same(&self.pattern, wider) {
            return Ok(Self { pattern: Arc::clone(wider), ..self.clone() });
        }
        expect_length("a wider pattern", self.pattern.nodes(), wider.nodes())?;
        // Copied entry by entry, because a wider column has further rows between those of this one.
        let mut spread = Self::zeros(Arc::clone(wider), self.block, self.columns)?;
        let size = self.block * self.block;
        for node in 0..self.pattern.nodes() {
            for (from, &row) in self.pattern.column_range(node).zip(self.pattern.column(node)) {
                let to = wider.position(row, node as u32).ok_or_else(|| not_coupled(row, node as u32))?;
                spread.values[to * size..(to + 1) * size]
                    .copy_from_slice(&self.values[from * size..(from + 1) * size]);
            }
        }
        spread.vector.copy_from_slice(&self.vector);
        Ok(spread)
    }

    /// Adds `weight` to every diagonal entry: `Λ += weight · I`.
    pub fn add_diagonal(&mut self, weight: f64) {
        let b = self.block;
        for node in 0..self.pattern.nodes() {
            // The diagonal block is the first of its column.
            let at = self.pattern.column_range(node).start * b * b;
            for k in 0..b {
                self.values[at + k * b + k] += weight;
            }
        }
    }

    /// Adds a `b × b` row-major symmetric block to the diagonal block of one node.
    ///
    /// # Errors
    /// `Input` when the node does not exist or when the block has another size.
    pub fn add_to_diagonal_block(&mut self, node: u32, matrix: &[f64]) -> Result<()> {
        let b = self.block;
        expect_length("a diagonal block", b * b, matrix.len())?;
        let at = self.pattern.position(node, node).ok_or_else(|| {
            Error::input(format!(
                "node {node} does not exist: the pattern has {} nodes",
                self.pattern.nodes()
            ))
        })? * b
            * b;
        for (to, &from) in self.values[at..at + b * b].iter_mut().zip(matrix) {
            *to += from;
        }
        Ok(())
    }

    /// The diagonal of `Λ`, node-major.
    #[must_use]
    pub fn diagonal(&self) -> Vec<f64> {
        let b = self.block;
        (0..self.pattern.nodes())
            .flat_map(|node| {
                let at = self.pattern.column_range(node).start * b * b;
                (0..b).map(move |k| self.values[at + k * b + k])
            })
            .collect()
    }

    /// `y = Λ x` for one or more columns, both `n·b × columns`, node-major.
    ///
    /// # Errors
    /// `Input` when the length of `x` is no multiple of the dimension, or when `y` has another length.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) -> Result<()> {
        let b = self.block;
        let columns = columns_of("a vector", self.dimension(), x.len())?;
        expect_length("the product", x.len(), y.len())?;
        y.fill(0.0);
        // The case of iterative solvers and quadratic forms, which multiply many times.
        if b == 1 && columns == 1 {
            self.multiply_scalars(x, y);
            return Ok(());
        }
        for node in 0..self.pattern.nodes() {
            for (position, &row) in self.pattern.column_range(node).zip(self.pattern.column(node)) {
                let row = row as usize;
                let values = &self.values[position * b * b..(position + 1) * b * b];
                for r in 0..b {
                    for s in 0..b {
                        let value = values[r * b + s];
                        let (i, j) = ((row * b + r) * columns, (node * b + s) * columns);
                        for c in 0..columns {
                            y[i + c] += value * x[j + c];
                        }
                        if row != node {
                            for c in 0..columns {
                                y[j + c] += value * x[i + c];
                            }
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// `y += Λ x` for one unknown per node.
    fn multiply_scalars(&self, x: &[f64], y: &mut [f64]) {
        for (node, &of_node) in x.iter().enumerate() {
            let range = self.pattern.column_range(node);
            // Each stored entry is read once for both triangles. The sum of the column stays in a register,
            // instead of a store per entry.
            let mut sum = 0.0;
            for (&value, &row) in self.values[range].iter().zip(self.pattern.column(node)) {
                let row = row as usize;
                y[row] += value * of_node;
                if row != node {
                    sum += value * x[row];
                }
            }
            y[node] += sum;
        }
    }

    /// Transforms to information about `x + by`: `η ← η + Λ by`. `by` is node-major, as long as `η`.
    ///
    /// Information about a step becomes information about the state in this way, without a new accumulation.
    ///
    /// # Errors
    /// `Input` when `by` has another length.
    pub fn translate(&mut self, by: &[f64]) -> Result<()> {
        expect_length("the translation", self.vector.len(), by.len())?;
        let mut product = vec![0.0; by.len()];
        self.multiply(by, &mut product)?;
        for (eta, p) in self.vector.iter_mut().zip(&product) {
            *eta += p;
        }
        Ok(())
    }

    /// `Σ_c x_cᵀ Λ x_c` over the columns of `x` (`n·b × columns`, node-major).
    ///
    /// # Errors
    /// `Input` when the length of `x` is no multiple of the dimension.
    pub fn quadratic_form(&self, x: &[f64]) -> Result<f64> {
        let mut product = vec![0.0; x.len()];
        self.multiply(x, &mut product)?;
        Ok(x.iter().zip(&product).map(|(a, b)| a * b).sum())
    }

    /// `Λ ⊗ I_b` on the same pattern: one unknown per node becomes `block` independent ones.
    ///
    /// The layout of the vectors does not change, so `columns` must be a multiple of `block`: 3 columns
    /// become 1 column of 3.
    ///
    /// # Errors
    /// `Input` when this information already has more than one unknown per node, or when `columns` is not a
    /// multiple of `block`.
    pub fn expanded(&self, block: usize) -> Result<Self> {
        if self.block != 1 || block == 0 || !self.columns.is_multiple_of(block) {
            return Err(Error::input(format!(
                "cannot expand blocks of {} with {} columns to blocks of {block}",
                self.block, self.columns
            )));
        }
        let mut expanded = Self::zeros(Arc::clone(&self.pattern), block, self.columns / block)?;
        for (target, &value) in expanded.values.chunks_exact_mut(block * block).zip(&self.values) {
            // Coordinates stay independent, so only the diagonal of each block is filled.
            for k in 0..block {
                target[k * block + k] = value;
            }
        }
        expanded.vector.copy_from_slice(&self.vector);
        Ok(expanded)
    }

    /// The dense matrix, for small problems and tests.
    #[must_use]
    pub fn to_dense(&self) -> DMatrix<f64> {
        let b = self.block;
        let mut dense = DMatrix::zeros(self.dimension(), self.dimension());
        for node in 0..self.pattern.nodes() {
            for (position, &row) in self.pattern.column_range(node).zip(self.pattern.column(node)) {
                for r in 0..b {
                    for s in 0..b {
                        let value = self.values[(position * b + r) * b + s];
                        dense[(row as usize * b + r, node * b + s)] = value;
                        dense[(node * b + s, row as usize * b + r)] = value;
                    }
                }
            }
        }
        dense
    }
}

pub(super) fn expect_length(what: &str, expected: usize, found: usize) -> Result<()> {
    if expected == found {
        Ok(())
    } else {
        Err(Error::input(format!("{what}: expected {expected} entries, found {found}")))
    }
}

/// Number of columns of a node-major array over `dimension` unknowns.
pub(super) fn columns_of(what: &str, dimension: usize, length: usize) -> Result<usize> {
    if dimension == 0 && length == 0 {
        Ok(0)
    } else if dimension > 0 && length.is_multiple_of(dimension) {
        Ok(length / dimension)
    } else {
        Err(Error::input(format!("{what}: expected a multiple of {dimension} entries, found {length}")))
    }
}
