//! The first stage of a fit: a starting surface from the cloud alone.
//!
//! Input: [`Observations`] and the options. Output: a surface of the right topology near the points, over a
//! base grid that is as fine as smooth shape needs, or as it has grown.
//!
//! Not guaranteed: that the surface is within the noise of its readings; [`super::refine`] iterates until it
//! is.

use super::FitOptions;
use super::division::MIN_LEAF_SIGMAS;
use super::growth::{MAX_LEVELS, grow};
use super::indicator::Indicator;
use super::spline_error::{NOISE_SHARE, own_variances};
use crate::observe::{Observations, Quantity, ReadingColumns};
use planish_core::vector3::coordinates;
use planish_core::{DVec3, Progress};
use planish_estimate::{Error, Result};
use planish_spline::{BaseShape, Hierarchy, Shape, Surface, SurfaceSystem, choose_base_shape, leaf_weights};
use std::sync::Arc;

/// Approximate number of cells of the base grid, before it is adapted to many readings.
///
/// More cells would follow noise before refinement can judge it; fewer cost a round of refinement.
const BASE_CELLS: usize = 128;
/// Minimum number of cells around a tube, and around both circles of a torus.
///
/// A cubic spline of `n` uniform cells misses a circle of radius `r` by about `1.4 r n⁻⁴` (root mean square;
/// `√(2ζ(8)) n⁻⁴` of the best approximation). On seven cells that is `6e-4 r`, as much as σ of a surface of
/// thousands of readings and too little for the test of residuals: 95 % intervals of tori covered 83 %. On
/// sixteen it is `2e-5 r`. See decision 0096.
const CELLS_AROUND: usize = 12;
/// Weight of the plate over a draped surface with at most [`FEW_PER_CELL`] points for each cell, for cells of
/// side and density one. More points weigh more, so that their surface bends as they do.
const SMOOTHING: f64 = 0.05;
const FEW_PER_CELL: f64 = 20.0;
/// Points from which the base shape is chosen: more only take longer.
const SHAPE_SAMPLE: usize = 30_000;
/// With fewer readings on a surface, all readings choose the shape.
const MIN_SHAPE_SAMPLE: usize = 10;
/// A ball grows no leaves that would hold fewer readings than this on average: emptier ones would follow
/// the indicator's noise. See decision 0007.
const READINGS_PER_GROWN_LEAF: usize = 6;

/// Smallest cosine between the normal of a star-shaped surface and the direction from its centre, and largest
/// share of readings below it. They count where they are more than [`TURNED_BY_CHANCE`] of the readings in
/// their direction, because normals of noisy readings and of gross errors may be wrong.
const MIN_STAR_COSINE: f64 = 0.25;
const MAX_TURNED: f64 = 0.005;
const TURNED_BY_CHANCE: f64 = 0.2;
/// Directions from the centre, around the axis and along it.
const DIRECTIONS: [usize; 2] = [16, 8];

/// The starting surface, over a base grid whose sides are multiples of `multiple`.
///
/// A ball grows into the solid that the points enclose and is refined on the way, unless that is star-shaped;
/// other shapes are draped over the points.
///
/// # Errors
/// `Undetermined` if the readings determine no shape; `Input` if the shape takes more coefficients than
/// allowed.
pub(super) fn first_surface(
    observations: &Observations,
    options: &FitOptions,
    multiple: usize,
    progress: &dyn Progress,
) -> Result<Surface> {
    let sample = shape_sample(&observations.readings);
    let size = sample.count;
    let sample = sample.readings;
    let (points, normals) = positions_and_normals(&observations.readings, &sample);
    let base = choose_base_shape(&points, &normals, options.shape)?;
    // In a small cloud, more cells would hold fewer than six readings each.
    let grid = base_grid(&base, BASE_CELLS.min((size / 6).max(32)), multiple, options.max_coefficients)?;
    progress.check("first shape", 0.02)?;
    if base.shape == Shape::Ball && !is_star_shaped(&base, &points, &normals) {
        let indicator = Indicator::new(&points, &normals);
        let cells = |level: usize| (grid[0] * grid[1]) << (2 * level);
        // The area of a sphere with the mean squared half axis: rough, but a level changes the number of
        // leaves by a factor of four.
        let area = 4.0 * std::f64::consts::PI * base.size.iter().map(|s| s * s).sum::<f64>() / 3.0;
        let min_area = (MIN_LEAF_SIGMAS * typical_sigma(observations, &sample)).powi(2);
        let deepest = options.max_depth.map_or(MAX_LEVELS, |depth| MAX_LEVELS.min(depth.into()));
        let levels = (1..=deepest)
            .take_while(|&level| {
                cells(level) * READINGS_PER_GROWN_LEAF <= size
                    && area >= min_area * cells(level) as f64
                    && cells(level) <= options.max_coefficients
            })
            .count();
        grow(&base, grid, levels, &points, &indicator, &|share| {
            progress.check("growing", 0.05 + 0.35 * share)
        })
    } else {
        let whole = size * (1 + observations.intake.later_batches);
        draped_on_fitting_cells(&base, grid, &points, whole, !observations.scan_errors.is_empty(), options)
    }
}

/// True if the readings see a ball's solid as star-shaped: their normals face away from its centre.
///
/// The parameters over the base are then unique and smooth. Those of a grown surface are uneven by the noise
/// of what it grew into, and cells follow smooth shape less well over uneven parameters: 95 % intervals of
/// balls of 1000 readings covered 0.82 to 0.93, and errors were up to three times those of a draped surface
/// (decision 0109).
fn is_star_shaped(base: &BaseShape, points: &[DVec3], normals: &[DVec3]) -> bool {
    // In coordinates in which the base is the unit ball.
    let is_turned = |(point, normal): (DVec3, DVec3)| {
        let (from_centre, normal): ([f64; 3], [f64; 3]) = (
            std::array::from_fn(|d| base.frame[d].dot(point - base.centre) / base.size[d]),
            std::array::from_fn(|d| base.frame[d].dot(normal) * base.size[d]),
        );
        let (from_centre, normal) = (DVec3::from(from_centre), DVec3::from(normal));
        from_centre.dot(normal) < MIN_STAR_COSINE * from_centre.length() * normal.length()
    };
    // Readings, and turned ones, by directions from the centre.
    let mut counts = vec![[0_usize; 2]; DIRECTIONS[0] * DIRECTIONS[1]];
    for (point, normal) in points.iter().zip(normals) {
        let [u, v] = base.parameters(*point);
        let at = |share: f64, cells: usize| ((share * cells as f64) as usize).min(cells - 1);
        let count = &mut counts[at(u, DIRECTIONS[0]) + DIRECTIONS[0] * at(v, DIRECTIONS[1])];
        count[0] += 1;
        count[1] += usize::from(is_turned((*point, *normal)));
    }
    let turned: usize = (counts.iter())
        .filter(|[all, turned]| *turned as f64 > TURNED_BY_CHANCE * *all as f64)
        .map(|[_, turned]| turned)
        .sum();
    turned as f64 <= MAX_TURNED * points.len() as f64
}

/// A surface draped over points, on cells that miss no more than σ if `whole` readings are fitted.
///
/// Parameters over the base are smooth. Cells that are divided later keep the parameters of the larger ones,
/// whose error also moves points along the surface, and smaller cells follow that less well than smooth
/// shape: a tube of 3 million readings was covered to 0.87 instead of 0.94 (decision 0107).
fn draped_on_fitting_cells(
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
        if !draped.misses_shape(points.len(), whole) && !std::mem::take(&mut for_poses) {
            break;
        }
        grid = grid.map(|n| 2 * n);
        let cells = grid[0] * grid[1];
        if READINGS_PER_GROWN_LEAF * cells > points.len() || 2 * cells > options.max_coefficients {
            break;
        }
        draped = draped_surface(base, grid, points)?;
    }
    Ok(draped.surface)
}

/// A surface draped over points.
struct Draped {
    surface: Surface,
    /// Mean square of the distances of the points along the normals.
    variance: f64,
}

impl Draped {
    /// True if the cells miss more than σ of a surface of `whole` readings, of which `points` were draped.
    fn misses_shape(&self, points: usize, whole: usize) -> bool {
        let cells = self.surface.space().leaves().len() as f64;
        let missed = own_variances(&self.surface).iter().sum::<f64>() / cells;
        missed > self.variance * cells * (1.0 / whole as f64 + NOISE_SHARE / points as f64)
    }
}

/// The base shape of the starting surface alone.
///
/// # Errors
/// `Undetermined` if the readings determine no shape.
pub(super) fn base_shape(readings: &ReadingColumns, shape: Option<Shape>) -> Result<BaseShape> {
    let (points, normals) = positions_and_normals(readings, &shape_sample(readings).readings);
    choose_base_shape(&points, &normals, shape)
}

/// Readings from which the shape is found.
struct ShapeSample {
    readings: Vec<u32>,
    /// Number of readings that the sample was drawn from.
    count: usize,
}

/// A sample of the readings that is large enough to find the shape, without those that lie on no surface with
/// their neighbours and those held out, unless no others are left.
fn shape_sample(readings: &ReadingColumns) -> ShapeSample {
    let usable = |i: &u32| readings.on_surface[*i as usize] && !readings.held_out[*i as usize];
    let mut all: Vec<u32> = (0..readings.len() as u32).filter(usable).collect();
    if all.len() < MIN_SHAPE_SAMPLE {
        all = (0..readings.len() as u32).collect();
    }
    let count = all.len();
    ShapeSample { readings: all.into_iter().step_by(count.div_ceil(SHAPE_SAMPLE).max(1)).collect(), count }
}

/// Positions and normals of the readings in `sample`.
fn positions_and_normals(readings: &ReadingColumns, sample: &[u32]) -> (Vec<DVec3>, Vec<DVec3>) {
    sample.iter().map(|&i| (readings.points[i as usize], readings.normal(i as usize))).unzip()
}

/// A base grid of about `cells` cells whose sides are multiples of `multiple`; fewer cells if it would have
/// more than `max_nodes` nodes.
pub(super) fn base_grid(
    base: &BaseShape,
    cells: usize,
    multiple: usize,
    max_nodes: usize,
) -> Result<[usize; 2]> {
    let mut cells = cells;
    let mut around = match base.shape {
        Shape::Sheet | Shape::Ball => [0, 0],
        Shape::Tube => [CELLS_AROUND, 0],
        Shape::Torus => [CELLS_AROUND; 2],
    };
    loop {
        let grid = base.grid(cells);
        let grid = [0, 1]
            .map(|d| grid[d].max(around[d]))
            .map(|n| (n + multiple / 2).max(multiple) / multiple * multiple);
        let nodes = Hierarchy::uniform(base.shape, grid)?.node_count();
        if nodes <= max_nodes {
            return Ok(grid);
        }
        if cells == 1 {
            return Err(Error::input(format!(
                "expected a limit of at least {nodes} coefficients for a {}, found {max_nodes}",
                base.shape.name()
            )));
        }
        around = [0, 0];
        // Sides are rounded to multiples, so the number of nodes does not fall in proportion: small steps
        // lose less.
        cells = (cells * 4 / 5).max(1);
    }
}

/// Root mean square of the stated σ of positions; zero if none is stated.
fn typical_sigma(observations: &Observations, sample: &[u32]) -> f64 {
    let sum: f64 = sample
        .iter()
        .map(|&i| i as usize)
        .filter(|&i| {
            observations.quantity(i) == Quantity::Position
                && observations.channels[observations.channel(i)].stated
        })
        .map(|i| observations.covariance(i).trace() / 3.0)
        .sum();
    (sum / sample.len().max(1) as f64).sqrt()
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
    let weight = points.len() as f64 / area * cell.powi(4) * SMOOTHING * (FEW_PER_CELL / per_cell).min(1.0);
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
    let squares = lists.iter().enumerate().flat_map(|(leaf, own)| own.iter().map(move |p| square(leaf, p)));
    let sum: f64 = squares.sum();
    Ok(Draped { surface, variance: sum / points.len() as f64 })
}
