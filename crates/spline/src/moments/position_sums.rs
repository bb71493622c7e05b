//! Sums of positions over a hierarchy.
//!
//! Input: a stream of readings in any order. Output: the moments of every leaf. Readings are sorted by leaf
//! in batches of fixed size, so that each cell sums its readings in a fixed order on any number of threads.

use super::{CellMoments, Reading};
use crate::hierarchy::{Hierarchy, Shape};
use crate::system::SurfaceSystem;
use planish_core::DVec3;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Number of positions of one cell that are gathered before summation.
const RUN: usize = 64;
/// Number of positions sorted by cell together, and number of such parts per batch. Fixed, so that sums do
/// not depend on the number of threads.
pub(super) const PART: usize = 1 << 14;
pub(super) const PARTS: usize = 16;
/// The leaf of an index without a reading.
const NO_READING: u32 = u32::MAX;
/// Number of cells per task. Trades balanced threads against the cost of tasks.
const CELLS_AT_ONCE: usize = 64;

/// Sums of positions with known parameters over a hierarchy. Only moments are stored.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{Hierarchy, PositionSums, Shape, SurfaceSystem};
/// use std::sync::Arc;
///
/// let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4])?);
/// let mut sums = PositionSums::new(&space);
/// sums.add(&[[0.5, 0.5], [3.2, 1.0]], &[DVec3::new(0.5, 0.5, 1.0), DVec3::new(3.2, 1.0, 1.1)], None)?;
/// assert_eq!(sums.count(), 2);
/// let information = sums.information(&SurfaceSystem::new(&space)?)?;
/// // Weights sum to one, so each reading adds one.
/// assert!((information.quadratic_form(&vec![1.0; information.dimension()])? - 2.0).abs() < 1e-12);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct PositionSums {
    space: Arc<Hierarchy>,
    pub(super) cells: Vec<CellMoments>,
    /// Sums are relative to the first position: squares of large coordinates would cancel the differences.
    origin: Option<DVec3>,
    count: usize,
    parts: Vec<Part>,
}

/// An affine map of the parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AffineMap {
    /// `o`, `a` and `b` of `z = o + u a + v b`.
    pub map: [DVec3; 3],
    /// For each coordinate, the fraction of its variance that the map does not explain. Its accuracy is
    /// limited by the squares of the coordinates.
    pub unexplained_share: [f64; 3],
}

/// A part of a batch: readings sorted by leaf.
#[derive(Debug, Clone, Default)]
struct Part {
    /// The leaf of each index in the order of arrival; [`NO_READING`] if there is no reading.
    leaves: Vec<u32>,
    /// Start of the readings of each leaf in `sorted`.
    start: Vec<u32>,
    sorted: Vec<Reading>,
}

/// A position on a surface, at known parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionReading {
    /// `(u, v)`, in the units of the base grid.
    pub parameters: [f64; 2],
    /// The measured position.
    pub position: DVec3,
    /// 1/variance of each coordinate.
    pub information: f64,
}

impl Part {
    /// Reads and checks a range of readings, and sorts them by leaf.
    fn sort(
        &mut self,
        space: &Hierarchy,
        origin: DVec3,
        numbers: Range<usize>,
        read: &impl Fn(usize) -> Option<PositionReading>,
    ) -> Result<()> {
        let [nu, nv] = space.extent();
        // In a periodic direction every finite parameter is valid.
        let range = |n: f64, closed: bool| if closed { f64::MIN..=f64::MAX } else { 0.0..=n };
        let (inside_u, inside_v) = (range(nu, space.periodic_u()), range(nv, space.periodic_v()));
        // Counting sort by leaf: first count, then fill. It is stable, so the order of arrival is kept.
        self.leaves.clear();
        self.start.clear();
        self.start.resize(space.leaves().len() + 1, 0);
        for k in numbers.clone() {
            let Some(reading) = read(k) else {
                self.leaves.push(NO_READING);
                continue;
            };
            let ([u, v], z) = (reading.parameters, reading.position);
            let is_weight = (0.0..=f64::MAX).contains(&reading.information);
            if !(inside_u.contains(&u)
                && inside_v.contains(&v)
                // One test for three coordinates: a sum with NaN or infinity is not finite.
                && (z[0] + z[1] + z[2]).is_finite()
                && is_weight)
            {
                return Err(unusable(k, [nu, nv], &reading));
            }
            let (leaf, _) = space.locate(u, v);
            self.leaves.push(leaf as u32);
            self.start[leaf + 1] += 1;
        }
        let mut sum = 0;
        for start in &mut self.start {
            sum += *start;
            *start = sum;
        }
        self.sorted.resize(sum as usize, Reading::default());
        // Filling moves every start to that of the next leaf; shifting by one restores them. Calling `read`
        // twice is cheaper than storing its results.
        for (&leaf, k) in self.leaves.iter().zip(numbers) {
            if leaf == NO_READING {
                continue;
            }
            let Some(reading) = read(k) else { continue };
            let ([u, v], z) = (reading.parameters, reading.position);
            let (_, [x, y]) = space.locate(u, v);
            let place = &mut self.start[leaf as usize];
            self.sorted[*place as usize] = Reading {
                local: [2.0 * x - 1.0, 2.0 * y - 1.0],
                position: DVec3::new(z[0] - origin[0], z[1] - origin[1], z[2] - origin[2]),
                information: reading.information,
            };
            *place += 1;
        }
        self.start.rotate_right(1);
        self.start[0] = 0;
        Ok(())
    }

    #[inline(always)]
    fn readings(&self, leaf: usize) -> &[Reading] {
        &self.sorted[self.start[leaf] as usize..self.start[leaf + 1] as usize]
    }
}

impl PositionSums {
    /// Empty sums. Memory: 850 bytes per leaf, and a buffer of 10 MB after the first call of [`Self::add`].
    #[must_use]
    pub fn new(space: &Arc<Hierarchy>) -> Self {
        Self {
            space: Arc::clone(space),
            cells: vec![CellMoments::default(); space.leaves().len()],
            origin: None,
            count: 0,
            parts: Vec::new(),
        }
    }

    /// Number of positions.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Adds positions at parameters `u ∈ [0, extent]`, each with information (1/variance) about every
    /// coordinate (default 1).
    ///
    /// Call it for successive pieces of a stream: only the sums are stored. It runs in parallel on the
    /// current rayon pool. Pieces whose length is a multiple of 262,144 give the same bytes as one call, for
    /// any number of threads.
    ///
    /// # Errors
    /// `Input`, with the number of the reading, when parameters lie outside the domain of an open direction,
    /// an information is negative, anything is not finite, or the slices differ in length. Readings of
    /// complete batches before it are added in this case.
    pub fn add(
        &mut self,
        parameters: &[[f64; 2]],
        positions: &[DVec3],
        information: Option<&[f64]>,
    ) -> Result<()> {
        if positions.len() != parameters.len() || information.is_some_and(|w| w.len() != parameters.len()) {
            return Err(Error::input(format!(
                "expected equal numbers, found {} parameters, {} positions and {} weights",
                parameters.len(),
                positions.len(),
                information.map_or(parameters.len(), <[f64]>::len)
            )));
        }
        self.add_from(parameters.len(), |k| {
            Some(PositionReading {
                parameters: parameters[k],
                position: positions[k],
                information: information.map_or(1.0, |w| w[k]),
            })
        })
    }

    /// [`Self::add`] for readings from a function, called on any thread: `read(k)` for `k` below `size`;
    /// `None` skips a reading. It is called twice per reading and must return the same value.
    ///
    /// # Errors
    /// As for [`Self::add`]; the number in messages is `k`.
    pub fn add_from(
        &mut self,
        size: usize,
        read: impl Fn(usize) -> Option<PositionReading> + Sync,
    ) -> Result<()> {
        let origin = match self.origin {
            Some(origin) => origin,
            None => match (0..size).find_map(|k| Some((k, read(k)?))) {
                None => return Ok(()),
                Some((k, first)) if !first.position.is_finite() => {
                    return Err(unusable(k, self.space.extent(), &first));
                }
                // Sums are relative to the first position: with map coordinates, squares of the raw values
                // would lose the digits of the residuals.
                Some((_, first)) => *self.origin.insert(first.position),
            },
        };
        // In batches, so that the memory of the sorted readings is bounded.
        for start in (0..size).step_by(PART * PARTS) {
            self.add_batch(start..size.min(start + PART * PARTS), origin, &read)?;
        }
        Ok(())
    }

    fn add_batch(
        &mut self,
        numbers: Range<usize>,
        origin: DVec3,
        read: &(impl Fn(usize) -> Option<PositionReading> + Sync),
    ) -> Result<()> {
        let space = &*self.space;
        let parts = numbers.len().div_ceil(PART);
        if self.parts.len() < parts {
            self.parts.resize_with(parts, Part::default);
        }
        let parts = &mut self.parts[..parts];
        // Two phases: sort the parts in parallel, then let each cell sum its readings in the order of the
        // parts. No cell is written by two threads.
        (parts.par_iter_mut().enumerate()).try_for_each(|(p, part)| {
            let first = numbers.start + p * PART;
            part.sort(space, origin, first..numbers.end.min(first + PART), read)
        })?;
        let parts = &*parts;
        let arch = pulp::Arch::new();
        (self.cells.par_chunks_mut(CELLS_AT_ONCE).enumerate()).for_each(|(chunk, cells)| {
            arch.dispatch(CellsOfBatch { parts, first_leaf: chunk * CELLS_AT_ONCE, cells });
        });
        self.count += parts.iter().map(|part| part.sorted.len()).sum::<usize>();
        Ok(())
    }

    /// The hierarchy.
    #[must_use]
    pub fn space(&self) -> &Arc<Hierarchy> {
        &self.space
    }

    /// `Σ w`.
    #[must_use]
    pub fn weight(&self) -> f64 {
        self.cells.iter().map(|cell| cell.gram[0][0]).sum()
    }

    /// Adds other sums over the same hierarchy, with their information multiplied by a factor.
    ///
    /// # Errors
    /// `Input` when the hierarchies differ in their leaves.
    pub fn merge(&mut self, other: &Self, factor: f64) -> Result<()> {
        if self.space.shape() != other.space.shape() || self.space.leaves() != other.space.leaves() {
            return Err(Error::input("cannot add sums over different hierarchies"));
        }
        let Some(from) = other.origin else {
            return Ok(());
        };
        // Sums about different origins cannot be added; moving them is exact in the moments.
        let to = *self.origin.get_or_insert(from);
        let by = from - to;
        (self.cells.par_iter_mut().zip(&other.cells))
            .with_min_len(CELLS_AT_ONCE)
            .for_each(|(own, other)| own.merge(&other.moved(by), factor));
        self.count += other.count;
        Ok(())
    }

    /// The same positions accumulated over cells twice as long and wide. The last row or column may extend
    /// beyond the domain.
    ///
    /// Parameters of the result are half of the original ones. Exact up to rounding.
    ///
    /// # Errors
    /// `Input` when the shape is closed or the grid is not uniform.
    pub fn coarsened(&self) -> Result<Self> {
        let [nu, nv] = self.space.base();
        if self.space.shape() != Some(Shape::Sheet) || self.space.leaves().len() != nu * nv {
            return Err(Error::input("only sums over a uniform grid of a sheet can be coarsened"));
        }
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [nu.div_ceil(2), nv.div_ceil(2)])?);
        let mut coarse = Self::new(&space);
        (coarse.cells.par_iter_mut().zip(space.leaves())).with_min_len(16).for_each(|(cell, leaf)| {
            for quarter in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                let [i, j] = [2 * leaf.i as usize + quarter[0], 2 * leaf.j as usize + quarter[1]];
                if i < nu && j < nv {
                    let (fine, _) = self.space.locate(i as f64, j as f64);
                    // Moments of a quarter are polynomials in its own coordinates, so the change of
                    // coordinates is exact.
                    cell.add_quarter(&self.cells[fine], quarter);
                }
            }
        });
        (coarse.origin, coarse.count) = (self.origin, self.count);
        Ok(coarse)
    }

    /// Origin of the positions in [`Self::information`]; solutions are relative to it.
    #[must_use]
    pub fn origin(&self) -> DVec3 {
        self.origin.unwrap_or(DVec3::ZERO)
    }

    /// `Σ w z²` of each coordinate, relative to the origin.
    #[must_use]
    pub fn squares(&self) -> [f64; 3] {
        std::array::from_fn(|d| self.cells.iter().map(|cell| cell.squares[d]).sum())
    }

    /// For each leaf, true if it has readings.
    #[must_use]
    pub fn observed(&self) -> Vec<bool> {
        self.cells.iter().map(|cell| cell.count() > 0).collect()
    }

    /// The least-squares affine map from parameters to positions; `None` if the parameters lie on a line.
    ///
    /// Solves the normal equations of `z ≈ o + u a + v b` about the mean, from the lowest moments of the
    /// cells.
    #[must_use]
    pub fn affine(&self) -> Option<AffineMap> {
        // Sums of w (1, u, v)ᵀ(1, u, v) and of w (1, u, v) z, with u = (i + (s + 1)/2) side on each cell.
        let (mut gram, mut values) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
        for (cell, leaf) in self.cells.iter().zip(self.space.leaves()) {
            let side = leaf.side();
            let half = 0.5 * side;
            let (u0, v0) = ((f64::from(leaf.i) + 0.5) * side, (f64::from(leaf.j) + 0.5) * side);
            // (1, u, v) as combinations of (1, s, t).
            let rows = [[1.0, 0.0, 0.0], [u0, half, 0.0], [v0, 0.0, half]];
            let m = &cell.gram;
            let of_cell =
                [[m[0][0], m[0][1], m[1][0]], [m[0][1], m[0][2], m[1][1]], [m[1][0], m[1][1], m[2][0]]];
            for a in 0..3 {
                for b in 0..3 {
                    gram[a][b] += (0..3)
                        .map(|i| rows[a][i] * (0..3).map(|j| of_cell[i][j] * rows[b][j]).sum::<f64>())
                        .sum::<f64>();
                }
                for d in 0..3 {
                    let z = &cell.values[d];
                    values[a][d] += rows[a][0] * z[0][0] + rows[a][1] * z[0][1] + rows[a][2] * z[1][0];
                }
            }
        }
        let weight = gram[0][0];
        // About the mean: far from the origin, the raw normal equations are nearly singular.
        let mean = [gram[0][1] / weight, gram[0][2] / weight];
        let spread = |a: usize, b: usize| gram[a][b] - weight * mean[a - 1] * mean[b - 1];
        let (uu, uv, vv) = (spread(1, 1), spread(1, 2), spread(2, 2));
        let determinant = uu * vv - uv * uv;
        if determinant <= 1e-12 * uu * vv || determinant.is_nan() {
            return None;
        }
        let mut map = [DVec3::ZERO; 3];
        let mut unexplained_share = [0.0; 3];
        let squares = self.squares();
        for d in 0..3 {
            let middle = values[0][d] / weight;
            let (uz, vz) = (values[1][d] - values[0][d] * mean[0], values[2][d] - values[0][d] * mean[1]);
            let (a, b) = ((vv * uz - uv * vz) / determinant, (uu * vz - uv * uz) / determinant);
            map[0][d] = self.origin()[d] + middle - a * mean[0] - b * mean[1];
            (map[1][d], map[2][d]) = (a, b);
            let total = squares[d] - weight * middle * middle;
            unexplained_share[d] = if total > 0.0 { (total - a * uz - b * vz) / total } else { 0.0 };
        }
        Some(AffineMap { map, unexplained_share })
    }

    /// The information about the nodes: one matrix for each coordinate, three vectors, relative to the
    /// origin.
    ///
    /// # Errors
    /// `Input` when the system belongs to another hierarchy.
    pub fn information(&self, system: &SurfaceSystem) -> Result<BlockInformation> {
        if system.space().leaves() != self.space.leaves() {
            return Err(Error::input("the system belongs to another hierarchy"));
        }
        system.assemble_scalar(|leaf| {
            let cell = &self.cells[leaf];
            (cell.count() > 0).then(|| cell.information())
        })
    }
}

/// The error for an invalid reading.
#[cold]
fn unusable(number: usize, [nu, nv]: [f64; 2], reading: &PositionReading) -> Error {
    let PositionReading { parameters: [u, v], position, information } = *reading;
    Error::input(if !(0.0..=f64::MAX).contains(&information) {
        format!(
            "reading {number}: expected an information (1/variance) that is finite and not negative, found \
             {information}"
        )
    } else if position.is_finite() {
        format!("reading {number}: expected parameters in [0, {nu}] × [0, {nv}], found ({u}, {v})")
    } else {
        format!("reading {number}: expected finite coordinates, found {:?}", position.to_array())
    })
}

/// A range of cells, and the parts of a batch.
struct CellsOfBatch<'a> {
    parts: &'a [Part],
    first_leaf: usize,
    cells: &'a mut [CellMoments],
}

impl WithSimd for CellsOfBatch<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // Without vector hardware, `mul_add` would be a library call. Results differ in the last digits
        // between machines, not between runs.
        if S::IS_SCALAR {
            self.add::<false>();
        } else {
            self.add::<true>();
        }
    }
}

impl CellsOfBatch<'_> {
    /// Adds the parts in order, in runs long enough to amortise loading the sums.
    #[inline(always)]
    fn add<const FUSED: bool>(self) {
        let mut run = [Reading::default(); RUN];
        for (offset, cell) in self.cells.iter_mut().enumerate() {
            let mut len = 0;
            for part in self.parts {
                let mut own = part.readings(self.first_leaf + offset);
                // Long runs are summed where they are; short ones are collected from several parts first. The
                // order depends on the parts only, not on threads.
                if own.len() >= RUN {
                    cell.add_run::<FUSED>(own);
                    continue;
                }
                while !own.is_empty() {
                    let (now, later) = own.split_at(own.len().min(RUN - len));
                    run[len..len + now.len()].copy_from_slice(now);
                    len += now.len();
                    own = later;
                    if len == RUN {
                        cell.add_run::<FUSED>(&run);
                        len = 0;
                    }
                }
            }
            cell.add_run::<FUSED>(&run[..len]);
        }
    }
}
