//! The sparse Cholesky factor of an information matrix.
//!
//! Input: a symbolic analysis and numbers. Output: `P Λ Pᵀ = L Lᵀ`, solutions, samples and the
//! log-determinant. The method is multifrontal: the dense front of a supernode adds the updates of its
//! children, is factored by dense kernels, and passes an update to its parent. Not guaranteed: a factor of a
//! matrix that is singular to working precision. This is an error that names the node.

use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, MatMut, MatRef, Par};

use super::information::columns_of;
use super::panel_vectors::{BackSubstitution, Elimination};
use super::symbolic::Run;
use super::tree::{Walk, by_columns};
use super::{BlockInformation, BlockPattern, SymbolicFactor};
use crate::{Error, Result};

/// A pivot below this multiple of its diagonal entry counts as zero: cancellation alone can leave as much.
///
/// Up to 20 ε were observed on singular grids of differences. A larger value would reject weak priors (tests
/// `singular_information_is_undetermined_although_rounding_leaves_a_pivot`, `weak_priors_are_accepted`).
const MIN_PIVOT: f64 = 128.0 * f64::EPSILON;

/// The factor `L` of `P Λ Pᵀ = L Lᵀ`.
///
/// # Examples
/// ```
/// use std::sync::Arc;
/// use planish_estimate::sparse::{
///     BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SymbolicFactor,
/// };
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
    /// One column-major panel per supernode; the upper triangle of its diagonal block is unspecified.
    values: Vec<f64>,
}

impl CholeskyFactor {
    /// Factors an information matrix.
    ///
    /// Cost: [`SymbolicFactor::flops`] in dense kernels. Memory: the factor, plus pending updates to parents.
    ///
    /// # Errors
    /// `Undetermined` when the matrix is not positive definite, or singular to working precision; the message
    /// names the node at which elimination broke down. `Input` when the information has another pattern or
    /// block size than the analysis, or entries that are not finite.
    pub fn factorize(symbolic: &Arc<SymbolicFactor>, information: &BlockInformation) -> Result<Self> {
        Self { symbolic: Arc::clone(symbolic), values: vec![0.0; symbolic.stored_values()] }
            .refactorize(information)
    }

    /// Factors other information of the same pattern and reuses the memory. The result has the same bytes as
    /// that of [`Self::factorize`].
    ///
    /// # Errors
    /// As [`Self::factorize`].
    pub fn refactorize(mut self, information: &BlockInformation) -> Result<Self> {
        let symbolic = Arc::clone(&self.symbolic);
        if information.block_size() != symbolic.block_size()
            || !BlockPattern::same(information.pattern(), symbolic.pattern())
        {
            return Err(Error::input(
                "pattern or block size of the information differ from the symbolic analysis",
            ));
        }
        self.values.resize(symbolic.stored_values(), 0.0);
        match eliminate(&symbolic, information, &mut self.values) {
            Ok(()) => Ok(self),
            Err(breakdown) => Err(breakdown.explain(&symbolic, information)),
        }
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

    /// `ln det Λ = 2 Σ ln L_ii`.
    #[must_use]
    pub fn log_determinant(&self) -> f64 {
        // Serial, because the order of a sum decides its last digits.
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
        // The vectors are copied to the order of the supernodes. Each subtree then owns a contiguous range,
        // so threads need no locks and kernels read memory in order.
        let mut parts = SupernodeVectors::from_rows(&self.symbolic, x, |row| self.place_of(row))?;
        self.forward(&mut parts);
        self.backward(&mut parts);
        parts.copy_to(x, |row| self.place_of(row));
        Ok(())
    }

    /// `x ← L⁻¹ P x`: whitens a vector, so that `|L⁻¹ P η|² = ηᵀ Λ⁻¹ η`. The result is in elimination order.
    ///
    /// # Errors
    /// `Input` when the length of `x` is no multiple of the dimension.
    pub fn solve_lower_in_place(&self, x: &mut [f64]) -> Result<()> {
        let mut parts = SupernodeVectors::from_rows(&self.symbolic, x, |row| self.place_of(row))?;
        self.forward(&mut parts);
        parts.copy_to(x, |row| row);
        Ok(())
    }

    /// `z ← Pᵀ L⁻ᵀ z`: for `z` of independent standard normals the result has covariance `Λ⁻¹`.
    ///
    /// `z` is in elimination order, the result in node order.
    ///
    /// # Errors
    /// `Input` when the length of `z` is no multiple of the dimension.
    ///
    /// # References
    /// Rue and Held, *Gaussian Markov Random Fields*, 2005, algorithm 2.4.
    pub fn solve_lower_transpose_in_place(&self, z: &mut [f64]) -> Result<()> {
        let mut parts = SupernodeVectors::from_rows(&self.symbolic, z, |row| row)?;
        self.backward(&mut parts);
        parts.copy_to(z, |row| self.place_of(row));
        Ok(())
    }

    /// The diagonal block and the rows below it of one supernode.
    pub(super) fn panel(&self, s: usize) -> (MatRef<'_, f64>, MatRef<'_, f64>) {
        let (columns, height) = (self.symbolic.columns(s), self.symbolic.height(s));
        MatRef::from_column_major_slice(self.panel_values(s), columns + height, columns).split_at_row(columns)
    }

    fn panel_values(&self, s: usize) -> &[f64] {
        &self.values[self.symbolic.value_start[s]..self.symbolic.value_start[s + 1]]
    }

    /// Index in node order of an unknown given in elimination order.
    fn place_of(&self, unknown: usize) -> usize {
        let b = self.symbolic.block_size();
        self.symbolic.old_from_new[unknown / b] as usize * b + unknown % b
    }

    fn forward(&self, x: &mut SupernodeVectors) {
        let (symbolic, vectors) = (&*self.symbolic, x.vectors);
        let work = |s: usize| 2.0 * (symbolic.tree_values(s) * vectors) as f64;
        let simd = pulp::Arch::new();
        let done: std::result::Result<(), std::convert::Infallible> = Walk::new(symbolic, &x.start, &work)
            .ascend(&mut x.values, &|s, own, parts, spare| {
                let (columns, height) = (symbolic.columns(s), symbolic.height(s));
                // `take` returns old contents. The updates of the children are summed here before the own
                // columns are applied.
                let mut below = spare.take(height * vectors);
                below[..height * vectors].fill(0.0);
                // The children are added in a fixed order, so the sum has the same bytes for any number of
                // threads.
                for (part, &child) in parts.iter().zip(symbolic.children(s)) {
                    let size = symbolic.height(child as usize);
                    for v in 0..vectors {
                        let (own, below) = (
                            &mut own[v * columns..(v + 1) * columns],
                            &mut below[v * height..(v + 1) * height],
                        );
                        let part = &part[v * size..(v + 1) * size];
                        for &run in symbolic.runs(child as usize) {
                            let [(from, to, n), (rest, on, m)] = run.split(columns);
                            add(&mut own[to..to + n], &part[from..from + n]);
                            add(&mut below[on..on + m], &part[rest..rest + m]);
                        }
                    }
                }
                let (panel, below_own) = (self.panel_values(s), &mut below[..height * vectors]);
                simd.dispatch(Elimination {
                    panel,
                    stride: columns + height,
                    vectors,
                    own,
                    below: below_own,
                });
                Ok(below)
            });
        let Ok(()) = done;
    }

    fn backward(&self, x: &mut SupernodeVectors) {
        let (symbolic, vectors) = (&*self.symbolic, x.vectors);
        let work = |s: usize| 2.0 * (symbolic.tree_values(s) * vectors) as f64;
        let simd = pulp::Arch::new();
        Walk::new(symbolic, &x.start, &work).descend(&mut x.values, &|s, own, known, spare| {
            let (columns, height) = (symbolic.columns(s), symbolic.height(s));
            let (panel, known_own) = (self.panel_values(s), &known[..height * vectors]);
            simd.dispatch(BackSubstitution {
                panel,
                stride: columns + height,
                vectors,
                own,
                known: known_own,
            });
            let children = symbolic.children(s).iter();
            children
                .map(|&child| {
                    let size = symbolic.height(child as usize);
                    let mut part = spare.take(size * vectors);
                    for v in 0..vectors {
                        let (own, known) =
                            (&own[v * columns..(v + 1) * columns], &known[v * height..(v + 1) * height]);
                        let part = &mut part[v * size..(v + 1) * size];
                        for &run in symbolic.runs(child as usize) {
                            let [(from, to, n), (rest, on, m)] = run.split(columns);
                            // Every row of a child is a column or a row of its parent, so its values come
                            // from both.
                            part[from..from + n].copy_from_slice(&own[to..to + n]);
                            part[rest..rest + m].copy_from_slice(&known[on..on + m]);
                        }
                    }
                    part
                })
                .collect()
        });
    }
}

/// Vectors split by supernodes; the vectors of one supernode are contiguous.
struct SupernodeVectors {
    vectors: usize,
    /// Start of the part of each supernode, and the end.
    start: Vec<usize>,
    values: Vec<f64>,
}

impl SupernodeVectors {
    /// Copies rows of `x` with one value per vector. Unknown `i` in elimination order is row `row_of(i)`.
    fn from_rows(symbolic: &SymbolicFactor, x: &[f64], row_of: impl Fn(usize) -> usize) -> Result<Self> {
        let vectors = columns_of("a vector", symbolic.dimension(), x.len())?;
        let b = symbolic.block_size();
        let start: Vec<usize> =
            symbolic.supernode_start.iter().map(|&first| first as usize * b * vectors).collect();
        let mut values = vec![0.0; x.len()];
        Self::each_place(&start, vectors, |unknown, vector, place| {
            values[place] = x[row_of(unknown) * vectors + vector];
        });
        Ok(Self { vectors, start, values })
    }

    /// The reverse of [`Self::from_rows`].
    fn copy_to(&self, x: &mut [f64], row_of: impl Fn(usize) -> usize) {
        Self::each_place(&self.start, self.vectors, |unknown, vector, place| {
            x[row_of(unknown) * self.vectors + vector] = self.values[place];
        });
    }

    fn each_place(start: &[usize], vectors: usize, mut visit: impl FnMut(usize, usize, usize)) {
        for bounds in start.windows(2) {
            let columns = (bounds[1] - bounds[0]) / vectors.max(1);
            for vector in 0..vectors {
                for k in 0..columns {
                    visit(bounds[0] / vectors + k, vector, bounds[0] + vector * columns + k);
                }
            }
        }
    }
}

impl std::fmt::Debug for CholeskyFactor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CholeskyFactor").field("symbolic", &self.symbolic).finish_non_exhaustive()
    }
}

/// Writes the information of one supernode into its panel.
fn assemble(symbolic: &SymbolicFactor, s: usize, information: &BlockInformation, panel: &mut [f64]) {
    let (b, start) = (symbolic.block_size(), symbolic.value_start[s]);
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
                *to = if slot.transposed() { values[column * b + row] } else { values[row * b + column] };
            }
        }
    }
}

/// The unknown, in elimination order, at which elimination broke down.
struct Breakdown {
    unknown: usize,
}

impl Breakdown {
    fn explain(&self, symbolic: &SymbolicFactor, information: &BlockInformation) -> Error {
        if !information.values().iter().all(|value| value.is_finite()) {
            return Error::input("expected finite entries of the information, found others");
        }
        let b = symbolic.block_size();
        let node = symbolic.old_from_new[self.unknown / b];
        let unknown_text =
            if b == 1 { String::new() } else { format!(" (unknown {} of {b})", self.unknown % b) };
        Error::undetermined(format!(
            "the information is not positive definite: elimination breaks down at node {node}{unknown_text}. \
             Data and prior do not determine it: add data there or use a stronger prior"
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
    let work = |s: usize| symbolic.tree_flops(s);
    Walk::new(symbolic, &symbolic.value_start, &work).ascend(panels, &|s, panel, updates, spare| {
        let (columns, height) = (symbolic.columns(s), symbolic.height(s));
        // Columns of the front: entries of the matrix, then updates of the children, then the dense
        // factorisation.
        assemble(symbolic, s, information, panel);
        let children = || updates.iter().zip(symbolic.children(s).iter().map(|&child| child as usize));
        for (update, child) in children() {
            let selected = |to| to < columns;
            extend_add(
                update,
                symbolic.height(child),
                symbolic.runs(child),
                selected,
                panel,
                columns + height,
                0,
            );
        }

        let first = symbolic.supernode_start[s] as usize * b;
        let front = MatMut::from_column_major_slice_mut(panel, columns + height, columns);
        let (mut top, mut below) = front.split_at_row_mut(columns);
        let params = faer::Spec::default();
        let mut scratch = MemBuffer::new(cholesky_in_place_scratch::<f64>(columns, Par::Seq, params));
        // Sequential: the tree supplies the parallelism, and a fixed order of operations gives the same
        // bytes.
        cholesky_in_place(top.rb_mut(), Default::default(), Par::Seq, MemStack::new(&mut scratch), params)
            .map_err(|LltError::NonPositivePivot { index }| Breakdown { unknown: first + index })?;
        // The kernel rejects only pivots that are not positive. Rounding can leave a small positive pivot of
        // a singular matrix, so each one is compared with its entry before elimination. The ratio has no
        // unit.
        for k in 0..columns {
            let unknown = first + k;
            let old = symbolic.old_from_new[unknown / b] as usize * b + unknown % b;
            let enough = top[(k, k)] * top[(k, k)] > MIN_PIVOT * diagonal[old];
            if !enough {
                return Err(Breakdown { unknown });
            }
        }
        let mut update = spare.take(height * height);
        if height > 0 {
            // The update: product first, because it replaces the contents of its buffer and saves a pass of
            // zeros. The remaining updates of the children are added to it.
            solve_rows(top.rb(), below.rb_mut());
            let square = &mut update[..height * height];
            minus_square(below.rb(), square);
            for (update, child) in children() {
                let selected = |to| to >= columns;
                extend_add(
                    update,
                    symbolic.height(child),
                    symbolic.runs(child),
                    selected,
                    square,
                    height,
                    columns,
                );
            }
        }
        Ok(update)
    })
}

/// Columns of an update computed together. On bicubic grids, values from 32 to 128 differ by less than 15 %
/// in time.
const SQUARE_COLUMNS: usize = 64;
/// Rows of a panel solved together. Fixed, so that results do not depend on the number of threads.
const SOLVED_ROWS: usize = 192;

/// `B ← B L⁻ᵀ`, in parallel over blocks of rows.
fn solve_rows(top: MatRef<'_, f64>, mut below: MatMut<'_, f64>) {
    if below.nrows() > SOLVED_ROWS {
        // The cut depends on the size only, not on the number of threads. A multiple of 8 keeps both parts on
        // full SIMD widths.
        let half = (below.nrows() / 2).next_multiple_of(8);
        let (upper, lower) = below.split_at_row_mut(half);
        rayon::join(|| solve_rows(top, upper), || solve_rows(top, lower));
    } else {
        solve_lower_triangular_in_place(top, below.rb_mut().transpose_mut(), Par::Seq);
    }
}

/// `U ← −B Bᵀ` in the lower triangle. Diagonal blocks are computed completely: this is faster than computing
/// only half of them.
fn minus_square(below: MatRef<'_, f64>, update: &mut [f64]) {
    let height = below.nrows();
    by_columns(update, height, SQUARE_COLUMNS, |from, columns| {
        let width = columns.len() / height;
        let part =
            MatMut::from_column_major_slice_mut(columns, height, width).subrows_mut(from, height - from);
        matmul(
            part,
            Accum::Replace,
            below.subrows(from, height - from),
            below.subrows(from, width).transpose(),
            -1.0,
            Par::Seq,
        );
    });
}

/// Adds the lower triangle of the update of a child to the front of its parent, in the columns that
/// `selected` accepts.
///
/// `shift` is the first column and row of the target within the front.
fn extend_add(
    child: &[f64],
    size: usize,
    runs: &[Run],
    selected: impl Fn(usize) -> bool,
    target: &mut [f64],
    stride: usize,
    shift: usize,
) {
    for (at, run) in runs.iter().enumerate() {
        let (from, to, length) = (run.from as usize, run.to as usize, run.length as usize);
        for k in 0..length {
            if !selected(to + k) {
                continue;
            }
            let source = &child[(from + k) * size..(from + k + 1) * size];
            let target = &mut target[(to + k - shift) * stride..(to + k - shift + 1) * stride];
            add(&mut target[to + k - shift..to + length - shift], &source[from + k..from + length]);
            // Runs ascend, so the later ones lie below this one: together they cover the lower triangle.
            for below in &runs[at + 1..] {
                let (from, to, length) = (below.from as usize, below.to as usize, below.length as usize);
                add(&mut target[to - shift..to + length - shift], &source[from..from + length]);
            }
        }
    }
}

fn add(target: &mut [f64], source: &[f64]) {
    for (to, &from) in target.iter_mut().zip(source) {
        *to += from;
    }
}
