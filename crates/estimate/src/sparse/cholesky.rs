//! The sparse Cholesky factor of an information matrix.
//!
//! Comes in: a symbolic analysis and numbers. Goes out: `P Λ Pᵀ = L Lᵀ`, solutions, samples and the log-determinant.
//! The method is multifrontal: each supernode's dense front takes up its children's updates, is factored by dense
//! kernels, and leaves an update to its parent. Not guaranteed: a factor of a matrix that is singular to working
//! precision; that is an error which names the node.

use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, MatMut, MatRef, Par};

use super::information::columns_of;
use super::symbolic::Run;
use super::{BlockInformation, BlockPattern, SymbolicFactor};
use crate::{Error, Result};

/// A pivot below this multiple of its diagonal entry counts as zero: cancellation alone leaves as much.
///
/// Seen on singular grids of differences: up to 20 ε.
const LEAST_PIVOT: f64 = 128.0 * f64::EPSILON;

/// The factor `L` of `P Λ Pᵀ = L Lᵀ`.
///
/// # Examples
/// ```
/// use std::sync::Arc;
/// use planish_estimate::sparse::{BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SymbolicFactor};
/// let pattern = Arc::new(BlockPattern::from_elements(2, [[0, 1]])?);
/// let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::natural(2), 1)?);
/// let mut information = BlockInformation::zeros(pattern, 1, 1)?;
/// information.add_element(&[0, 1], &[4.0, 2.0, 2.0, 3.0], &[8.0, 7.0])?;
/// let factor = CholeskyFactor::factorize(&symbolic, &information)?;
/// let mut x = information.vector().to_vec();
/// factor.solve_in_place(&mut x)?;
/// assert!((x[0] - 1.25).abs() < 1e-14 && (x[1] - 1.5).abs() < 1e-14);
/// assert!((factor.log_determinant() - 8.0_f64.ln()).abs() < 1e-14);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Clone)]
pub struct CholeskyFactor {
    symbolic: Arc<SymbolicFactor>,
    /// One column-major panel a supernode; the upper triangle of its diagonal block has no meaning.
    values: Vec<f64>,
}

impl CholeskyFactor {
    /// Factors an information matrix.
    ///
    /// Cost: [`SymbolicFactor::flops`], dense; memory: the factor, plus updates on their way to parents.
    ///
    /// # Errors
    /// `Undetermined` when the matrix is not positive definite, or singular to working precision; the message names the
    /// node at which elimination broke down. `Input` when the information has another pattern or block size than the
    /// analysis, or entries that are not finite.
    pub fn factorize(symbolic: &Arc<SymbolicFactor>, information: &BlockInformation) -> Result<Self> {
        Self {
            symbolic: Arc::clone(symbolic),
            values: Vec::new(),
        }
        .refactorize(information)
    }

    /// Factors other information of the same pattern in the memory of this factor. Gives the same bytes as
    /// [`Self::factorize`].
    ///
    /// # Errors
    /// As [`Self::factorize`].
    pub fn refactorize(mut self, information: &BlockInformation) -> Result<Self> {
        let symbolic = Arc::clone(&self.symbolic);
        if information.block_size() != symbolic.block_size()
            || !BlockPattern::same(information.pattern(), symbolic.pattern())
        {
            return Err(Error::input(
                "the information has another pattern or block size than the symbolic analysis",
            ));
        }
        self.values.resize(symbolic.stored_values(), 0.0);
        match eliminate(&symbolic, information, &mut self.values) {
            Ok(()) => Ok(self),
            Err(breakdown) => Err(breakdown.explain(&symbolic, information)),
        }
    }

    /// The analysis behind the factor.
    #[must_use]
    pub fn symbolic(&self) -> &Arc<SymbolicFactor> {
        &self.symbolic
    }

    /// Memory of the numbers, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.values.len() * size_of::<f64>()
    }

    /// `ln det Λ = 2 Σ ln L_ii`.
    #[must_use]
    pub fn log_determinant(&self) -> f64 {
        let mut sum = 0.0;
        for s in 0..self.symbolic.supernodes() {
            let (top, _) = self.panel(s);
            for k in 0..top.ncols() {
                sum += top[(k, k)].ln();
            }
        }
        2.0 * sum
    }

    /// `x ← Λ⁻¹ x` for one or more columns, `n·b × columns`, node-major.
    ///
    /// Cost: 4 operations per entry of the factor and column.
    ///
    /// # Errors
    /// `Input` when the length of `x` is no multiple of the dimension.
    pub fn solve_in_place(&self, x: &mut [f64]) -> Result<()> {
        let mut work = self.permuted(x)?;
        self.forward(work.as_mut());
        self.backward(work.as_mut());
        self.restore(work.as_ref(), x);
        Ok(())
    }

    /// `x ← L⁻¹ P x`: whitens. `|L⁻¹ P η|² = ηᵀ Λ⁻¹ η`. The result is in the order of elimination.
    ///
    /// # Errors
    /// `Input` when the length of `x` is no multiple of the dimension.
    pub fn solve_lower_in_place(&self, x: &mut [f64]) -> Result<()> {
        let mut work = self.permuted(x)?;
        self.forward(work.as_mut());
        let columns = work.ncols();
        for (at, row) in x.chunks_exact_mut(columns.max(1)).enumerate() {
            for (column, value) in row.iter_mut().enumerate() {
                *value = work[(at, column)];
            }
        }
        Ok(())
    }

    /// `z ← Pᵀ L⁻ᵀ z`: for `z` of independent standard normals the result has covariance `Λ⁻¹`.
    ///
    /// `z` is in the order of elimination, the result in that of the nodes.
    ///
    /// # Errors
    /// `Input` when the length of `z` is no multiple of the dimension.
    ///
    /// # References
    /// Rue and Held, *Gaussian Markov Random Fields*, 2005, algorithm 2.4.
    pub fn solve_lower_transpose_in_place(&self, z: &mut [f64]) -> Result<()> {
        let columns = columns_of("a vector", self.symbolic.dimension(), z.len())?;
        let mut work = faer::Mat::from_fn(self.symbolic.dimension(), columns, |row, column| {
            z[row * columns + column]
        });
        self.backward(work.as_mut());
        self.restore(work.as_ref(), z);
        Ok(())
    }

    /// The diagonal block and the rows below it of one supernode.
    pub(super) fn panel(&self, s: usize) -> (MatRef<'_, f64>, MatRef<'_, f64>) {
        let (columns, height) = (self.symbolic.columns(s), self.symbolic.height(s));
        let values = &self.values[self.symbolic.value_start[s]..self.symbolic.value_start[s + 1]];
        MatRef::from_column_major_slice(values, columns + height, columns).split_at_row(columns)
    }

    fn permuted(&self, x: &[f64]) -> Result<faer::Mat<f64>> {
        let columns = columns_of("a vector", self.symbolic.dimension(), x.len())?;
        let b = self.symbolic.block_size();
        let mut work = faer::Mat::zeros(self.symbolic.dimension(), columns);
        for (new, &old) in self.symbolic.old_from_new.iter().enumerate() {
            for k in 0..b {
                for column in 0..columns {
                    work[(new * b + k, column)] = x[(old as usize * b + k) * columns + column];
                }
            }
        }
        Ok(work)
    }

    fn restore(&self, work: MatRef<'_, f64>, x: &mut [f64]) {
        let (b, columns) = (self.symbolic.block_size(), work.ncols());
        for (new, &old) in self.symbolic.old_from_new.iter().enumerate() {
            for k in 0..b {
                for column in 0..columns {
                    x[(old as usize * b + k) * columns + column] = work[(new * b + k, column)];
                }
            }
        }
    }

    fn forward(&self, mut x: MatMut<'_, f64>) {
        let (symbolic, columns) = (&*self.symbolic, x.ncols());
        let mut buffer = Vec::new();
        for s in 0..symbolic.supernodes() {
            let (top, below) = self.panel(s);
            let first = symbolic.supernode_start[s] as usize * symbolic.block_size();
            let mut own = x.rb_mut().subrows_mut(first, top.ncols());
            solve_lower_triangular_in_place(top, own.rb_mut(), Par::Seq);
            if below.nrows() == 0 {
                continue;
            }
            buffer.resize(below.nrows() * columns, 0.0);
            let mut update = MatMut::from_column_major_slice_mut(&mut buffer, below.nrows(), columns);
            matmul(update.rb_mut(), Accum::Replace, below, own.rb(), 1.0, Par::Seq);
            for column in 0..columns {
                for_each_row(symbolic, s, |place, row| x[(row, column)] -= update[(place, column)]);
            }
            buffer.clear();
        }
    }

    fn backward(&self, mut x: MatMut<'_, f64>) {
        let (symbolic, columns) = (&*self.symbolic, x.ncols());
        let mut buffer = Vec::new();
        for s in (0..symbolic.supernodes()).rev() {
            let (top, below) = self.panel(s);
            let first = symbolic.supernode_start[s] as usize * symbolic.block_size();
            if below.nrows() > 0 {
                buffer.resize(below.nrows() * columns, 0.0);
                let mut known = MatMut::from_column_major_slice_mut(&mut buffer, below.nrows(), columns);
                for column in 0..columns {
                    for_each_row(symbolic, s, |place, row| known[(place, column)] = x[(row, column)]);
                }
                let own = x.rb_mut().subrows_mut(first, top.ncols());
                matmul(own, Accum::Add, below.transpose(), known.rb(), -1.0, Par::Seq);
                buffer.clear();
            }
            let own = x.rb_mut().subrows_mut(first, top.ncols());
            solve_upper_triangular_in_place(top.transpose(), own, Par::Seq);
        }
    }
}

impl std::fmt::Debug for CholeskyFactor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CholeskyFactor")
            .field("symbolic", &self.symbolic)
            .finish_non_exhaustive()
    }
}

/// Calls `visit(place, row)` for the unknowns below the diagonal block of a supernode.
fn for_each_row(symbolic: &SymbolicFactor, s: usize, mut visit: impl FnMut(usize, usize)) {
    let b = symbolic.block_size();
    for (at, &row) in symbolic.rows(s).iter().enumerate() {
        for k in 0..b {
            visit(at * b + k, row as usize * b + k);
        }
    }
}

/// Writes the information of one supernode into its panel, which starts at `start` in the values of the factor.
fn assemble(symbolic: &SymbolicFactor, s: usize, information: &BlockInformation, panel: &mut [f64], start: usize) {
    let b = symbolic.block_size();
    panel.fill(0.0);
    if b == 1 {
        for slot in symbolic.slots(s) {
            panel[slot.offset - start] = information.values()[slot.entry()];
        }
        return;
    }
    for slot in symbolic.slots(s) {
        let values = &information.values()[slot.entry() * b * b..(slot.entry() + 1) * b * b];
        for column in 0..b {
            let target = &mut panel[slot.offset - start + column * slot.stride()..][..b];
            for (row, to) in target.iter_mut().enumerate() {
                *to = if slot.transposed() {
                    values[column * b + row]
                } else {
                    values[row * b + column]
                };
            }
        }
    }
}

/// Where elimination broke down: the unknown, in the order of elimination.
struct Breakdown {
    unknown: usize,
}

impl Breakdown {
    fn explain(&self, symbolic: &SymbolicFactor, information: &BlockInformation) -> Error {
        if !information.values().iter().all(|value| value.is_finite()) {
            return Error::input("the information has entries that are not finite numbers");
        }
        let b = symbolic.block_size();
        let node = symbolic.old_from_new[self.unknown / b];
        let of = if b == 1 {
            String::new()
        } else {
            format!(" (unknown {} of {b})", self.unknown % b)
        };
        Error::undetermined(format!(
            "the information is not positive definite: elimination breaks down at node {node}{of}, which the data and the \
             prior leave undetermined; add data there or a stronger prior"
        ))
    }
}

fn eliminate(
    symbolic: &SymbolicFactor,
    information: &BlockInformation,
    panels: &mut [f64],
) -> std::result::Result<(), Breakdown> {
    let b = symbolic.block_size();
    let diagonal = information.diagonal();
    let widest = (0..symbolic.supernodes())
        .map(|s| symbolic.columns(s))
        .max()
        .unwrap_or(0);
    let params = faer::Spec::default();
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(widest, Par::Seq, params));
    let stack = MemStack::new(&mut memory);
    let mut updates: Vec<Vec<f64>> = vec![Vec::new(); symbolic.supernodes()];
    // Memory of updates that were taken up, with whatever numbers are in it.
    let mut spare: Vec<Vec<f64>> = Vec::new();

    for s in 0..symbolic.supernodes() {
        let (columns, height) = (symbolic.columns(s), symbolic.height(s));
        let start = symbolic.value_start[s];
        let panel = &mut panels[start..symbolic.value_start[s + 1]];
        assemble(symbolic, s, information, panel, start);
        for &child in symbolic.children(s) {
            let runs = symbolic.runs(child as usize);
            let size = symbolic.height(child as usize);
            extend_add(
                &updates[child as usize],
                size,
                runs,
                |to| to < columns,
                panel,
                columns + height,
                0,
            );
        }

        let first = symbolic.supernode_start[s] as usize * b;
        let front = MatMut::from_column_major_slice_mut(panel, columns + height, columns);
        let (mut top, mut below) = front.split_at_row_mut(columns);
        cholesky_in_place(top.rb_mut(), Default::default(), Par::Seq, stack, params)
            .map_err(|LltError::NonPositivePivot { index }| Breakdown { unknown: first + index })?;
        for k in 0..columns {
            let unknown = first + k;
            let old = symbolic.old_from_new[unknown / b] as usize * b + unknown % b;
            let enough = top[(k, k)] * top[(k, k)] > LEAST_PIVOT * diagonal[old];
            if !enough {
                return Err(Breakdown { unknown });
            }
        }
        if height > 0 {
            solve_lower_triangular_in_place(top.rb(), below.rb_mut().transpose_mut(), Par::Seq);
            let mut update = spare.pop().unwrap_or_default();
            if update.len() < height * height {
                update.resize(height * height, 0.0);
            }
            minus_square(
                below.rb(),
                MatMut::from_column_major_slice_mut(&mut update[..height * height], height, height),
            );
            for &child in symbolic.children(s) {
                let runs = symbolic.runs(child as usize);
                let size = symbolic.height(child as usize);
                extend_add(
                    &updates[child as usize],
                    size,
                    runs,
                    |to| to >= columns,
                    &mut update,
                    height,
                    columns,
                );
            }
            updates[s] = update;
        }
        for &child in symbolic.children(s) {
            spare.push(std::mem::take(&mut updates[child as usize]));
        }
    }
    Ok(())
}

/// Columns of an update that are computed together. On bicubic grids 32 to 128 differ by less than 15 % in time.
const SQUARE_COLUMNS: usize = 64;

/// `U ← −B Bᵀ` in the lower triangle. Blocks on the diagonal are computed whole: that is faster than to spare half.
fn minus_square(below: MatRef<'_, f64>, mut update: MatMut<'_, f64>) {
    let height = below.nrows();
    let mut from = 0;
    while from < height {
        let width = SQUARE_COLUMNS.min(height - from);
        matmul(
            update.rb_mut().submatrix_mut(from, from, height - from, width),
            Accum::Replace,
            below.subrows(from, height - from),
            below.subrows(from, width).transpose(),
            -1.0,
            Par::Seq,
        );
        from += width;
    }
}

/// Adds the lower triangle of a child's update to its parent's front, in the columns that `here` selects.
///
/// The target's columns and rows count from `shift` in the front.
fn extend_add(
    child: &[f64],
    size: usize,
    runs: &[Run],
    here: impl Fn(usize) -> bool,
    target: &mut [f64],
    stride: usize,
    shift: usize,
) {
    for (at, run) in runs.iter().enumerate() {
        let (from, to, length) = (run.from as usize, run.to as usize, run.length as usize);
        for k in 0..length {
            if !here(to + k) {
                continue;
            }
            let source = &child[(from + k) * size..(from + k + 1) * size];
            let target = &mut target[(to + k - shift) * stride..(to + k - shift + 1) * stride];
            add(
                &mut target[to + k - shift..to + length - shift],
                &source[from + k..from + length],
            );
            for below in &runs[at + 1..] {
                let (from, to, length) = (below.from as usize, below.to as usize, below.length as usize);
                add(
                    &mut target[to - shift..to + length - shift],
                    &source[from..from + length],
                );
            }
        }
    }
}

fn add(target: &mut [f64], source: &[f64]) {
    for (to, &from) in target.iter_mut().zip(source) {
        *to += from;
    }
}
