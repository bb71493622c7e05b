//! Surfaces draped over points: a smooth surface over a base grid, with the parameters of the points on the
//! base shape held.
//!
//! Input: a [`BaseShape`] and points. Output: a surface on a grid of cells that follow the shape. Parameters
//! over the base are smooth. Cells that are divided later keep the parameters of the larger ones, whose error
//! also moves points along the surface, and smaller cells follow that less well than smooth shape: a tube of
//! 3 million readings was covered to 0.87 instead of 0.94 (decision 0107). So the grid is doubled while it
//! misses shape almost everywhere; places that need smaller cells than others are left to refinement.

use super::FitOptions;
use super::spline_error::{NOISE_SHARE, own_variances};
use planish_core::DVec3;
use planish_core::vector3::coordinates;
use planish_estimate::Result;
use planish_spline::{BaseShape, Shape, Surface, SurfaceSystem, leaf_weights};
use std::sync::Arc;

/// Weight of the plate over a draped surface with at most [`FEW_PER_CELL`] points for each cell, for cells of
/// side and density one. More points weigh more, so that their surface bends as they do.
const SMOOTHING: f64 = 0.05;
const FEW_PER_CELL: f64 = 20.0;
/// Starting surfaces have no leaves that would hold fewer readings than this on average: emptier ones would
/// follow noise. See decision 0007.
pub(super) const READINGS_PER_FIRST_LEAF: usize = 6;

/// Degrees of freedom that a leaf has, and that its four children have.
const DEGREES: f64 = 1.0;
const DEGREES_OF_CHILDREN: f64 = 4.0;
/// Share of leaves that have to miss shape before all are divided.
const MISSING_LEAVES: f64 = 0.5;
/// Squares of a leaf count up to this many times their median, which is that of normal errors of 3 σ: a
/// gross error would decide for its leaf, and a finer surface follows it farther.
const MAX_SQUARE: f64 = 20.0;

/// A surface draped over points, on cells that miss no more than σ of a surface of `whole` readings.
///
/// With `has_scan_errors`, poses or biases of scans are estimated.
///
/// # Errors
/// `Undetermined` if the points determine no surface.
pub(super) fn drape(
    base: &BaseShape,
    mut grid: [usize; 2],
    points: &[DVec3],
    whole: usize,
    has_scan_errors: bool,
    options: &FitOptions,
) -> Result<Surface> {
    let mut draped = draped_surface(base, grid, points)?;
    // What cells of a ball miss is common to the readings of a cell and turns scans against each other. With
    // cells that miss as much as σ of the surface, squared errors of poses over their covariance were 21
    // instead of 6; with smaller ones 4.5.
    let mut for_poses = has_scan_errors && base.shape == Shape::Ball;
    while options.tolerance.is_none() && options.max_depth.is_none() {
        grid = grid.map(|n| 2 * n);
        let cells = grid[0] * grid[1];
        if READINGS_PER_FIRST_LEAF * cells > points.len() || 2 * cells > options.max_coefficients {
            break;
        }
        let finer = draped_surface(base, grid, points)?;
        if !(draped.misses_shape(whole)
            || draped.misses_shape_of(&finer, base, points)
            || std::mem::take(&mut for_poses))
        {
            break;
        }
        draped = finer;
    }
    Ok(draped.surface)
}

/// A surface draped over points.
struct Draped {
    surface: Surface,
    /// Squared distances of the points along the normals.
    squares: Vec<f64>,
}

impl Draped {
    /// True if the cells miss more than σ of a surface of `whole` readings, by the changes of the third
    /// derivative between them.
    fn misses_shape(&self, whole: usize) -> bool {
        let (cells, points) = (self.surface.space().leaves().len() as f64, self.squares.len() as f64);
        let missed = own_variances(&self.surface).iter().sum::<f64>() / cells;
        let variance = self.squares.iter().sum::<f64>() / points;
        missed > variance * cells * (1.0 / whole as f64 + NOISE_SHARE / points)
    }

    /// True if the mean square of most leaves, for each degree of freedom, is smaller on a surface of cells
    /// of half the side. Noise alone makes it larger, because the plate takes some of their freedom.
    ///
    /// Shape that a leaf does not follow at all is not in its derivatives, so this test and
    /// [`Self::misses_shape`] complement each other.
    fn misses_shape_of(&self, finer: &Self, base: &BaseShape, points: &[DVec3]) -> bool {
        let space = self.surface.space();
        let extent = space.extent();
        // Squares of the points of each leaf, here and on the finer surface.
        let mut squares: Vec<Vec<[f64; 2]>> = vec![Vec::new(); space.leaves().len()];
        for (i, p) in points.iter().enumerate() {
            let [u, v] = base.parameters(*p);
            let leaf = space.locate(u * extent[0], v * extent[1]).0;
            squares[leaf].push([self.squares[i], finer.squares[i]]);
        }
        squares.retain(|own| own.len() as f64 > DEGREES_OF_CHILDREN);
        let misses = |own: &mut Vec<[f64; 2]>| {
            let middle = own.len() / 2;
            let typical = own.select_nth_unstable_by(middle, |a, b| a[0].total_cmp(&b[0])).1[0];
            let [coarse, fine] =
                [0, 1].map(|k| own.iter().map(|square| square[k].min(MAX_SQUARE * typical)).sum::<f64>());
            let count = own.len() as f64;
            coarse / (count - DEGREES) > fine / (count - DEGREES_OF_CHILDREN)
        };
        let all = squares.len() as f64;
        let missing = squares.iter_mut().map(misses).filter(|misses| *misses).count();
        missing as f64 > MISSING_LEAVES * all
    }
}

/// A smooth surface over the base grid, fitted to the points with their parameters on the base shape held.
fn draped_surface(base: &BaseShape, grid: [usize; 2], points: &[DVec3]) -> Result<Draped> {
    let reference = base.surface(grid)?;
    let space = Arc::clone(reference.space());
    let extent = space.extent();
    let system = SurfaceSystem::new(&space)?;
    // Each reading keeps its parameters over the base. Without foot points the equations are linear, and
    // one solution is enough.
    let mut lists: Vec<Vec<(u32, [f64; 2])>> = vec![Vec::new(); space.leaves().len()];
    for (i, p) in points.iter().enumerate() {
        let q = base.parameters(*p);
        let (leaf, local) = space.locate(q[0] * extent[0], q[1] * extent[1]);
        lists[leaf].push((i as u32, local));
    }
    // All readings weigh alike: their noise is not estimated yet, and the weight of the plate follows their
    // number.
    let data = system.accumulate(|leaf, cell| {
        for &(i, local) in &lists[leaf] {
            cell.add_vector(
                &leaf_weights(local[0], local[1]),
                points[i as usize],
                &[1.0, 0.0, 0.0, 1.0, 0.0, 1.0],
            );
        }
        !lists[leaf].is_empty()
    })?;
    // Few points are smoothed over one cell: finer shape is found by refinement. The energy is that of the
    // departure from the base, so that unseen parts of a tube stay round.
    let area: f64 = reference.thin_plate(&space).iter().map(|l| l.area).sum();
    let cell = (area / space.leaves().len() as f64).sqrt();
    let per_cell = points.len() as f64 / space.leaves().len() as f64;
    let weight =
        points.len() as f64 / area * cell.powi(4) * SMOOTHING * (FEW_PER_CELL / per_cell).min(1.0).powi(2);
    let energy = system.thin_plate(&reference)?.expanded(3)?;
    let x: Vec<f64> = coordinates(reference.vertices()).to_vec();
    let mut pull = vec![0.0; x.len()];
    energy.multiply(&x, &mut pull)?;
    let mut total = data;
    total.add_scaled(&energy, weight)?;
    for (v, p) in total.vector_mut().iter_mut().zip(&pull) {
        *v += weight * p;
    }
    // A trace of the base keeps the matrix regular where neither data nor energy reach.
    let hold = 1e-6 * total.diagonal().iter().sum::<f64>() / total.dimension() as f64;
    total.add_diagonal(hold);
    for (v, c) in total.vector_mut().iter_mut().zip(&x) {
        *v += hold * c;
    }
    let factor = system.factorize(&total)?;
    let mut solution = total.vector().to_vec();
    factor.solve_in_place(&mut solution)?;
    let surface = system.surface(&solution)?;
    let square = |leaf: usize, &(i, [u, v]): &(u32, [f64; 2])| {
        let jet = surface.leaf_jet(leaf, u, v);
        jet.normal().map_or(0.0, |normal| (points[i as usize] - jet.point).dot(normal).powi(2))
    };
    let mut squares = vec![0.0; points.len()];
    for (leaf, own) in lists.iter().enumerate() {
        for reading in own {
            squares[reading.0 as usize] = square(leaf, reading);
        }
    }
    Ok(Draped { surface, squares })
}
