//! Equations `D = 0` of readings, and their sum.
//!
//! In: for each reading its distance, σ and derivatives by the vertices of the mesh and the poses of cameras.
//! Out: information and vector over the parameters.
//!
//! Derivatives are stored by vertex until they are summed. An accepted step therefore reuses the evaluation
//! that tested it.

use crate::deformation::{Deformation, SparseRow};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::Loss;
use rayon::prelude::*;
use std::sync::Arc;

/// A vertex, and the derivative by its position.
pub(super) type ByVertex = (u32, DVec3);
/// An index of a pose in the state, and the derivative by its six parameters.
pub(super) type ByPose = (u32, [f64; 6]);

/// Maximum total size of the partial sums of one pass, in numbers: a memory limit of about 320 MB.
const MAX_SUM_NUMBERS: usize = 40_000_000;
/// Total size of the partial sums above which there are only as many as threads need: clearing and adding
/// them takes longer than the equations.
const LARGE_SUM_NUMBERS: usize = 4_000_000;
/// Numbers of partial sums: of large ones at least, and of small ones at most.
const SUMS: (usize, usize) = (8, 32);

/// The kind of reading of an equation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Source {
    /// A point in space.
    Point,
    /// A point of an outline or of a contour.
    Outline,
    /// A line of sight on the wrong side of an outline; an equation only while it is violated.
    Region,
    /// A feature seen in several views.
    Track,
    /// A place of the mesh with a measured position.
    Landmark,
    /// The same in a coarse stage, where the mesh may still be far from it.
    DistantLandmark,
}

/// Number of kinds with their own factor of σ; regions share that of outlines.
pub(super) const SCALES: usize = 4;

impl Source {
    pub(super) fn scale(self) -> usize {
        match self {
            Self::Point => 0,
            Self::Outline | Self::Region => 1,
            Self::Track => 2,
            Self::Landmark | Self::DistantLandmark => 3,
        }
    }

    /// The loss of this kind. Regions and distant landmarks use one that never rejects: a part far outside of
    /// a mask is no outlier of the mask.
    pub(super) fn loss(self, default: &Loss) -> Loss {
        match self {
            Self::Region | Self::DistantLandmark => Loss::huber(),
            _ => *default,
        }
    }
}

/// One equation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Equation {
    pub source: Source,
    /// Index of the reading within its kind.
    pub reading: u32,
    /// The residual.
    pub distance: f64,
    /// Its σ as stated.
    pub sigma: f64,
    /// The probability that it is the correct equation of its reading, and the cost added for that.
    pub chance: (f64, f64),
    /// Ends of its entries by vertices and by poses.
    vertices_end: u32,
    poses_end: u32,
    /// True if derivatives were omitted because the weight is zero.
    lacks_derivatives: bool,
}

impl Equation {
    pub(super) fn normalized(&self) -> f64 {
        self.distance / self.sigma
    }

    /// True if it is more likely than all other equations of its reading together.
    pub(super) fn is_likely(&self) -> bool {
        self.chance.0 > 0.5
    }
}

/// Equations of some readings.
#[derive(Debug, Clone, Default)]
pub(super) struct Equations {
    pub list: Vec<Equation>,
    // Shared, so that copies with other residuals need little memory.
    by_vertices: Arc<Vec<ByVertex>>,
    by_poses: Arc<Vec<ByPose>>,
}

impl Equations {
    /// Adds an equation; entries of the same vertex are summed.
    pub(super) fn push(
        &mut self,
        source: Source,
        reading: u32,
        residual: (f64, f64),
        vertices: &mut Vec<ByVertex>,
        poses: &[ByPose],
    ) {
        // The sort is stable, so that sums have a fixed order.
        vertices.sort_by_key(|(vertex, _)| *vertex);
        vertices.dedup_by(|(next, by), (vertex, sum)| {
            let same = next == vertex;
            if same {
                *sum += *by;
            }
            same
        });
        self.push_distinct(source, reading, residual, vertices, poses);
    }

    /// Adds an equation whose entries are of distinct vertices, in any order.
    pub(super) fn push_distinct(
        &mut self,
        source: Source,
        reading: u32,
        (distance, sigma): (f64, f64),
        vertices: &mut Vec<ByVertex>,
        poses: &[ByPose],
    ) {
        Arc::make_mut(&mut self.by_vertices).append(vertices);
        if !poses.is_empty() {
            Arc::make_mut(&mut self.by_poses).extend_from_slice(poses);
        }
        self.list.push(Equation {
            source,
            reading,
            distance,
            sigma,
            // By default a reading belongs to one sheet for certain.
            chance: (1.0, 0.0),
            vertices_end: self.by_vertices.len() as u32,
            poses_end: self.by_poses.len() as u32,
            lacks_derivatives: false,
        });
    }

    /// Sets the probability that the last equation is the correct one of its reading.
    pub(super) fn set_last_probability(&mut self, probability: f64, log_ratio: f64) {
        if let Some(last) = self.list.last_mut() {
            last.chance = (probability, log_ratio);
        }
    }

    /// Adds an equation of zero weight, without derivatives.
    pub(super) fn push_without_derivatives(&mut self, source: Source, reading: u32, residual: (f64, f64)) {
        self.push(source, reading, residual, &mut Vec::new(), &[]);
        if let Some(last) = self.list.last_mut() {
            last.lacks_derivatives = true;
        }
    }

    /// True if an equation without derivatives has a positive weight by these factors.
    pub(super) fn lack_derivatives(all: &[Self], loss: &Loss, factors: &[f64; SCALES]) -> bool {
        (all.iter().flat_map(|some| &some.list)).any(|e| {
            let factor = factors[e.source.scale()];
            e.lacks_derivatives && e.source.loss(loss).weight(e.normalized() / factor) > 0.0
        })
    }

    /// The same equations, with their residuals reduced by `share` times the given numbers.
    pub(super) fn corrected(&self, share: f64, by: &[f64]) -> Self {
        let mut made = self.clone();
        made.list.iter_mut().zip(by).for_each(|(e, by)| e.distance -= share * by);
        made
    }

    /// Each equation with its entries.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&Equation, &[ByVertex], &[ByPose])> {
        let (mut vertices, mut poses) = (0, 0);
        self.list.iter().map(move |equation| {
            // Only ends are stored: equations are always visited in order, and this halves the indices.
            let own = &self.by_vertices[vertices..equation.vertices_end as usize];
            let pose = &self.by_poses[poses..equation.poses_end as usize];
            (vertices, poses) = (equation.vertices_end as usize, equation.poses_end as usize);
            (equation, own, pose)
        })
    }
}

/// The sum of equations: the information `N` and the vector `−Jᵀ W D`.
#[derive(Debug, Clone)]
pub(super) struct NormalEquations {
    pub information: DMatrix<f64>,
    pub vector: DVector<f64>,
}

/// The total cost of all equations.
pub(super) fn cost(all: &[Equations], loss: &Loss, factors: &[f64; SCALES]) -> f64 {
    (all.iter().flat_map(|some| &some.list))
        // Summed over the sheets of a point, this is the negative logarithm of their mixture: `log_ratio`
        // contains that of the probabilities, as in expectation maximisation.
        .map(|e| {
            let (probability, log_ratio) = e.chance;
            probability * (e.source.loss(loss).rho(e.normalized() / factors[e.source.scale()]) + log_ratio)
        })
        .sum()
}

/// Sums equations over the parameters and six numbers for every pose. Regions are included only with
/// `with_regions`. `together` is, for each kind, the number of correlated readings that have the weight of
/// one.
pub(super) fn sum(
    all: &[Equations],
    deformation: &dyn Deformation,
    poses: usize,
    loss: &Loss,
    (factors, together): (&[f64; SCALES], &[f64; SCALES]),
    with_regions: bool,
) -> NormalEquations {
    let basis = deformation.basis();
    let size = basis + 6 * poses;
    // Groups do not depend on the number of threads, so that sums have a fixed order.
    // Each group has a matrix of its own, so memory limits their number.
    let numbers = (size * size).max(1);
    let groups = (LARGE_SUM_NUMBERS / numbers).clamp(SUMS.0, SUMS.1).min((MAX_SUM_NUMBERS / numbers).max(2));
    let per_group = all.len().div_ceil(groups).max(1);
    let sums: Vec<NormalEquations> = (all.par_chunks(per_group))
        .map(|group| {
            let mut pass =
                NormalEquations { information: DMatrix::zeros(size, size), vector: DVector::zeros(size) };
            let mut row = EquationRow::new(deformation, poses);
            for (equation, vertices, own_poses) in group.iter().flat_map(Equations::iter) {
                if equation.source == Source::Region && !with_regions {
                    continue;
                }
                let sigma = equation.sigma * factors[equation.source.scale()];
                // Correlated readings count less in the covariance, but outliers are judged by the σ of one
                // reading.
                let variance = sigma * sigma * together[equation.source.scale()];
                let weight = equation.chance.0 * equation.source.loss(loss).weight(equation.distance / sigma)
                    / variance;
                // Redescending losses give most outliers zero weight; their rows are not needed.
                if weight <= 0.0 {
                    continue;
                }
                let entries = row.of(vertices, own_poses);
                for (n, &(i, entry)) in entries.iter().enumerate() {
                    let scaled = weight * entry;
                    pass.vector[i] -= scaled * equation.distance;
                    // Only the lower triangle is summed; it is mirrored once at the end.
                    let column = &mut pass.information.as_mut_slice()[i * size..(i + 1) * size];
                    for &(j, entry) in &entries[n..] {
                        column[j] += scaled * entry;
                    }
                }
            }
            pass
        })
        .collect();
    let mut total = NormalEquations { information: DMatrix::zeros(size, size), vector: DVector::zeros(size) };
    // In the order of the groups.
    for pass in sums {
        total.information += pass.information;
        total.vector += pass.vector;
    }
    total.information.fill_upper_triangle_with_lower_triangle();
    reduced(total, deformation, poses)
}

/// The row of an equation: over the basis of a deformation, then over six numbers of every pose.
pub(super) struct EquationRow<'a> {
    deformation: &'a dyn Deformation,
    row: SparseRow,
    entries: Vec<(usize, f64)>,
}

impl<'a> EquationRow<'a> {
    pub(super) fn new(deformation: &'a dyn Deformation, poses: usize) -> Self {
        let row = SparseRow::new(deformation.basis() + 6 * poses);
        Self { deformation, row, entries: Vec::new() }
    }

    /// Entries that are not zero, in the order of their indices.
    pub(super) fn of(&mut self, vertices: &[ByVertex], poses: &[ByPose]) -> &[(usize, f64)] {
        self.deformation.add_to(vertices, &mut self.row);
        let basis = self.deformation.basis();
        for (pose, by) in poses {
            for (k, entry) in by.iter().enumerate() {
                self.row.add(basis + 6 * *pose as usize + k, *entry);
            }
        }
        self.row.take(&mut self.entries);
        &self.entries
    }
}

/// Transforms a sum from the basis of the rows to the parameters; poses are unchanged.
fn reduced(pass: NormalEquations, deformation: &dyn Deformation, poses: usize) -> NormalEquations {
    // Once for the whole sum: `Rᵀ N R` for each equation would make its short row dense.
    let Some(r) = deformation.reduction() else {
        return pass;
    };
    let (basis, parameters, rest) = (deformation.basis(), deformation.parameters(), 6 * poses);
    let n = &pass.information;
    let size = parameters + rest;
    let reduction = Reduction::new(r);
    let mut information = DMatrix::zeros(size, size);
    // `Rᵀ (N R) = Rᵀ (Rᵀ N)ᵀ` for a symmetric `N`.
    let own = reduction.transposed_product(&n.view((0, 0), (basis, basis)).into_owned());
    let own = reduction.transposed_product(&own.transpose());
    let mixed = reduction.transposed_product(&n.view((0, basis), (basis, rest)).into_owned());
    information.view_mut((0, 0), (parameters, parameters)).copy_from(&own);
    information.view_mut((0, parameters), (parameters, rest)).copy_from(&mixed);
    information.view_mut((parameters, 0), (rest, parameters)).copy_from(&mixed.transpose());
    (information.view_mut((parameters, parameters), (rest, rest)))
        .copy_from(&n.view((basis, basis), (rest, rest)));
    let mut vector = DVector::zeros(size);
    vector.rows_mut(0, parameters).copy_from(&r.tr_mul(&pass.vector.rows(0, basis)));
    vector.rows_mut(parameters, rest).copy_from(&pass.vector.rows(basis, rest));
    NormalEquations { information, vector }
}

/// A matrix `R` from parameters to the basis of the rows, most of whose rows have a single entry.
struct Reduction {
    /// Row, column and value of each row with one entry.
    single: Vec<(usize, usize, f64)>,
    /// Rows with more entries, and their numbers.
    dense: DMatrix<f64>,
    dense_rows: Vec<usize>,
}

impl Reduction {
    fn new(matrix: &DMatrix<f64>) -> Self {
        let mut entries = vec![(0_usize, 0_usize); matrix.nrows()];
        for (column, values) in matrix.column_iter().enumerate() {
            for (entry, value) in entries.iter_mut().zip(values) {
                if *value != 0.0 {
                    *entry = (entry.0 + 1, column);
                }
            }
        }
        let single = (entries.iter().enumerate())
            .filter(|(_, (count, _))| *count == 1)
            .map(|(row, (_, column))| (row, *column, matrix[(row, *column)]))
            .collect();
        let dense_rows: Vec<usize> = (0..matrix.nrows()).filter(|row| entries[*row].0 > 1).collect();
        Self { single, dense: matrix.select_rows(&dense_rows), dense_rows }
    }

    /// `Rᵀ A`, in `n` multiplications for each dense row and column of `A`.
    fn transposed_product(&self, a: &DMatrix<f64>) -> DMatrix<f64> {
        let mut made = self.dense.tr_mul(&a.select_rows(&self.dense_rows));
        for column in 0..a.ncols() {
            for &(row, parameter, value) in &self.single {
                made[(parameter, column)] += value * a[(row, column)];
            }
        }
        made
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The product with a sparse matrix is that with the dense one.
    #[test]
    fn reductions_multiply_as_their_matrix() {
        let matrix = DMatrix::from_fn(9, 5, |i, j| match i {
            0..5 => f64::from(u8::from(i == 4 - j)) * 2.0,
            5 => 0.0,
            _ => (i * 5 + j) as f64 - 30.0,
        });
        let a = DMatrix::from_fn(9, 7, |i, j| ((3 * i + 5 * j) % 11) as f64);
        let found = Reduction::new(&matrix).transposed_product(&a);
        assert!((found - matrix.tr_mul(&a)).amax() < 1e-12);
    }
}
