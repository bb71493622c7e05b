//! The first stage of a fit: a starting surface from the cloud alone.
//!
//! Input: [`Observations`] and the options. Output: a surface of the right topology near the points, over a
//! base grid that is as fine as smooth shape needs, or as it has grown.
//!
//! Not guaranteed: that the surface is within the noise of its readings; [`super::refine`] iterates until it
//! is.

use super::creases::{SharpEdges, Sphere, may_have_creases, with_creases};
use super::division::MIN_LEAF_SIGMAS;
use super::drape::{READINGS_PER_FIRST_LEAF, drape};
use super::enclosing_mesh::{EnclosingMesh, TopologyMargin, enclosing_mesh};
use super::growth::{MAX_LEVELS, grow};
use super::indicator::Indicator;
use super::options::{FitOptions, Handles};
use super::over_quads::{MOST_WITH_CREASES, surface_over_quads};
use crate::layout::CreasedMesh;
use crate::observe::{Observations, Quantity, ReadingColumns};
use planish_core::{DVec3, ErrorKind, Progress};
use planish_estimate::{Error, Result};
use planish_mesh::TriangleMesh;
use planish_sense::Neighbourhoods;
use planish_spline::{BaseShape, Hierarchy, Shape, Surface, choose_base_shape};
use rayon::prelude::*;
use std::ops::RangeInclusive;

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
/// Fewer readings show no handles.
const MIN_FOR_HANDLES: usize = 1000;
/// Points from which the base shape is chosen: more only take longer.
const SHAPE_SAMPLE: usize = 30_000;
/// With fewer readings on a surface, all readings choose the shape.
const MIN_SHAPE_SAMPLE: usize = 10;
/// Smallest cosine between the normal of a star-shaped surface and the direction from its centre, and largest
/// share of readings below it. They count where they are more than [`TURNED_BY_CHANCE`] of the readings in
/// their direction, or more than [`TURNED_TOGETHER`] of their nearest readings, because normals of noisy
/// readings and of gross errors may be wrong. The wall of a hole through a plate is a small part of all
/// readings in each direction.
const MIN_STAR_COSINE: f64 = 0.25;
const MAX_TURNED: f64 = 0.005;
const TURNED_BY_CHANCE: f64 = 0.2;
const TURNED_TOGETHER: f64 = 0.5;
/// Rounds in which edges are left out where layouts fold, within so many sides of a quad, and the least share
/// of their length that is kept.
const SMOOTHING_ROUNDS: usize = 5;
pub(super) const SMOOTHED_QUADS: f64 = 1.5;
const QUADS_BESIDE_SMOOTHED: usize = 512;
const MIN_KEPT: f64 = 0.4;
/// Mean of `(p − c)·n`, as a share of that of lengths, from which normals face inwards. Of a cup with a wall
/// of a twelfth of its radius it is 0.12, with outward normals.
const MIN_INWARD: f64 = 0.05;
/// Nearest readings, more than those from which normals are estimated.
const NEAREST: usize = 24;
/// Directions from the centre, around the axis and along it.
const DIRECTIONS: [usize; 2] = [16, 8];

/// Which sharp edges a starting surface follows, and over how many quads.
#[derive(Debug, Clone)]
pub(super) struct CreaseChoice {
    /// Numbers of quads of its layout.
    pub quads: RangeInclusive<usize>,
    /// Where the surface is smooth although there are edges, because layouts with them fold there.
    pub smooth: Vec<Sphere>,
}

impl Default for CreaseChoice {
    fn default() -> Self {
        Self { quads: 0..=MOST_WITH_CREASES, smooth: Vec::new() }
    }
}

/// What readings show before a fit follows them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ShownShape {
    /// How steadily they show their topology; none if it was not taken from them.
    pub topology_margin: Option<TopologyMargin>,
    /// Length of the sharp edges.
    pub edge_length: f64,
}

/// What readings show of their surface: a solid of any topology with its sharp edges, or a base shape.
pub(super) struct FirstShape {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    sigma: f64,
    /// Number of readings that the points are a sample of, and the same with later batches.
    size: usize,
    whole: usize,
    has_scan_errors: bool,
    options: FitOptions,
    /// The border of the solid, if the surface may lie over quads.
    solid: Option<EnclosingMesh>,
    /// The same with its sharp edges, if there are any and the fit may follow them.
    creased: Option<SharpEdges>,
    /// The base shape and its grid; none if the number of handles is given.
    base: Option<(BaseShape, [usize; 2])>,
    /// True for a ball that the readings see as no star-shaped solid.
    is_grown: bool,
    /// True if normals face into the volume that the readings of a closed surface enclose. Nothing else is
    /// known then.
    pub(super) faces_inwards: bool,
}

/// The starting surface, over a base grid whose sides are multiples of `multiple`, without sharp edges.
///
/// # Errors
/// As for [`FirstShape::of`] and [`FirstShape::surface`].
pub(super) fn first_surface(
    observations: &Observations,
    options: &FitOptions,
    multiple: usize,
    progress: &dyn Progress,
) -> Result<Surface> {
    let shape = FirstShape::of(observations, options, multiple, progress)?;
    if shape.faces_inwards {
        return Err(inward_normals());
    }
    shape.surface(None, progress)
}

/// Refuses normals that face inwards where they cannot be turned.
pub(super) fn inward_normals() -> Error {
    Error::undetermined(
        "expected normals that face outwards, found normals that face into the volume that the readings \
         enclose: turn them around",
    )
}

impl FirstShape {
    /// # Errors
    /// `Undetermined` if the readings determine no shape; `Input` if it takes more coefficients than allowed.
    pub(super) fn of(
        observations: &Observations,
        options: &FitOptions,
        multiple: usize,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let sample = shape_sample(&observations.readings);
        let (points, normals) = positions_and_normals(&observations.readings, &sample.readings);
        let mut own = Self {
            sigma: typical_sigma(observations, &sample.readings),
            size: sample.count,
            whole: sample.count * (1 + observations.intake.later_batches),
            has_scan_errors: !observations.scan_errors.is_empty(),
            options: options.clone(),
            points,
            normals,
            solid: None,
            creased: None,
            base: None,
            is_grown: false,
            faces_inwards: false,
        };
        let exact = options.handles().filter(|handles| matches!(handles, Handles::Exactly(_)));
        let base = match exact {
            Some(_) => None,
            None => Some(choose_base_shape(&own.points, &own.normals, options.shape)?),
        };
        let is_closed = base.as_ref().is_none_or(|base| base.shape == Shape::Ball);
        own.faces_inwards = is_closed && face_inwards(&own.points, &own.normals);
        if own.faces_inwards {
            return Ok(own);
        }
        if let Some(handles) = exact {
            progress.check("topology", 0.02)?;
            own.solid = Some(enclosing_mesh(&own.points, &own.normals, handles)?);
        }
        if let Some(base) = base {
            own.find_solid(base, multiple, progress)?;
        }
        if let Some(solid) = own.solid.as_ref().filter(|_| options.follows_creases()) {
            let found = with_creases(solid.mesh.clone(), &own.points, &own.normals, own.sigma)?;
            own.creased = Some(found).filter(|found| !found.is_empty());
        }
        Ok(own)
    }

    /// Finds the grid of a base shape, and the solid that the readings enclose if a ball may lie over quads.
    fn find_solid(&mut self, base: BaseShape, multiple: usize, progress: &dyn Progress) -> Result<()> {
        let (points, normals, options) = (&self.points, &self.normals, &self.options);
        // In a small cloud, more cells would hold fewer than six readings each.
        let cells = BASE_CELLS.min((self.size / 6).max(32));
        let grid = base_grid(&base, cells, multiple, options.max_coefficients)?;
        progress.check("first shape", 0.02)?;
        self.is_grown = base.shape == Shape::Ball && !is_star_shaped(&base, points, normals)?;
        // Splines over a ball are smooth, and cannot follow sharp edges.
        let may_lie_over_quads = base.shape == Shape::Ball && self.size >= MIN_FOR_HANDLES;
        if let Some(handles) = options.handles().filter(|_| may_lie_over_quads)
            && (self.is_grown || options.follows_creases() && may_have_creases(points, normals, self.sigma)?)
        {
            progress.check("topology", 0.04)?;
            self.solid = if_determined(enclosing_mesh(points, normals, handles))?;
        }
        self.base = Some((base, grid));
        Ok(())
    }

    /// The starting surface; with the chosen sharp edges, if there are any.
    ///
    /// Points around solids that are not star-shaped get a surface over quads, with as many handles and
    /// bodies as they show. If they are too few to show that, a ball grows into the solid and is refined on
    /// the way. Other shapes, star-shaped balls among them, are draped over the points.
    ///
    /// # Errors
    /// `Undetermined` if no surface of the number of handles that is asked for was found; that of an
    /// interrupted `progress`.
    pub(super) fn surface(
        &self,
        choice: Option<&mut CreaseChoice>,
        progress: &dyn Progress,
    ) -> Result<Surface> {
        if let (Some(choice), Some(edges)) = (choice, &self.creased)
            && let Some(surface) = self.creased_surface(edges, choice, progress)?
        {
            return Ok(surface);
        }
        let smooth = |solid: &EnclosingMesh| self.smooth_surface(solid.mesh.clone(), progress);
        let Some((base, grid)) = &self.base else {
            return self.solid.as_ref().map_or_else(|| Err(Error::undetermined("no solid")), smooth);
        };
        if self.is_grown {
            if let Some(solid) = &self.solid
                && let Some(surface) = if_determined(smooth(solid))?
            {
                return Ok(surface);
            }
            return self.grown(base, *grid, progress);
        }
        drape(base, *grid, &self.points, self.whole, self.has_scan_errors, &self.options)
    }

    /// A surface of the topology that the readings show, for a base shape that does not follow them; none for
    /// sheets, which enclose nothing, for few readings, and if the shape or its topology is given.
    ///
    /// # Errors
    /// That of an interrupted `progress`.
    pub(super) fn over_quads_instead(
        &self,
        progress: &dyn Progress,
    ) -> Result<Option<(Surface, TopologyMargin)>> {
        let Some(handles) = self.handles_instead() else { return Ok(None) };
        match if_determined(enclosing_mesh(&self.points, &self.normals, handles))? {
            Some(EnclosingMesh { mesh, margin }) => {
                Ok(if_determined(self.smooth_surface(mesh, progress))?.map(|surface| (surface, margin)))
            }
            None => Ok(None),
        }
    }

    /// What the readings show, by which a fit is judged.
    pub(super) fn shown(&self) -> ShownShape {
        ShownShape {
            topology_margin: self.solid.as_ref().map(|solid| solid.margin),
            edge_length: self.creased.as_ref().map_or(0.0, SharpEdges::length),
        }
    }

    /// True if [`Self::over_quads_instead`] may find a surface.
    pub(super) fn may_lie_over_quads_instead(&self) -> bool {
        self.handles_instead().is_some()
    }

    /// The handles of a surface over quads instead of one over a base shape, if there may be one.
    fn handles_instead(&self) -> Option<Handles> {
        let encloses = self.base.as_ref().is_some_and(|(base, _)| base.shape != Shape::Sheet);
        let is_possible = encloses && self.solid.is_none() && self.size >= MIN_FOR_HANDLES;
        self.options.handles().filter(|_| is_possible)
    }

    /// A surface over quads without sharp edges.
    fn smooth_surface(&self, solid: TriangleMesh, progress: &dyn Progress) -> Result<Surface> {
        let (mesh, any) = (CreasedMesh::smooth(solid), 0..=usize::MAX);
        Ok(surface_over_quads(mesh, self.size, self.options.max_coefficients, any, progress)?.surface)
    }

    /// A surface over a layout that follows sharp edges. Where layouts fold, it is smooth, and the choice
    /// contains these places. None if it were smooth at most edges.
    fn creased_surface(
        &self,
        edges: &SharpEdges,
        choice: &mut CreaseChoice,
        progress: &dyn Progress,
    ) -> Result<Option<Surface>> {
        let mut quads = choice.quads.clone();
        for round in 0..SMOOTHING_ROUNDS {
            let left = edges.without(&choice.smooth);
            if left.length() < MIN_KEPT * edges.length() {
                return Ok(None);
            }
            let most = self.options.max_coefficients;
            let found = surface_over_quads(left.mesh, self.size, most, quads.clone(), progress);
            let Some(found) = if_determined(found)? else { return Ok(None) };
            if found.defect.is_sound() {
                return Ok(Some(found.surface));
            }
            // Less is left out where quads are small.
            quads = (*quads.start()).max(QUADS_BESIDE_SMOOTHED.min(*quads.end()))..=*quads.end();
            let clusters = if round == 0 && choice.smooth.is_empty() { edges.clusters() } else { Vec::new() };
            if clusters.is_empty() {
                choice.smooth.extend(found.defect.spheres(SMOOTHED_QUADS * found.side));
            } else {
                choice.smooth = clusters;
            }
        }
        Ok(None)
    }

    /// A ball that has grown into the solid.
    fn grown(&self, base: &BaseShape, grid: [usize; 2], progress: &dyn Progress) -> Result<Surface> {
        let indicator = Indicator::new(&self.points, &self.normals);
        let cells = |level: usize| (grid[0] * grid[1]) << (2 * level);
        // The area of a sphere with the mean squared half axis: rough, but a level changes the number of
        // leaves by a factor of four.
        let area = 4.0 * std::f64::consts::PI * base.size.iter().map(|s| s * s).sum::<f64>() / 3.0;
        let min_area = (MIN_LEAF_SIGMAS * self.sigma).powi(2);
        let deepest = self.options.max_depth.map_or(MAX_LEVELS, |depth| MAX_LEVELS.min(depth.into()));
        let levels = (1..=deepest)
            .take_while(|&level| {
                cells(level) * READINGS_PER_FIRST_LEAF <= self.size
                    && area >= min_area * cells(level) as f64
                    && cells(level) <= self.options.max_coefficients
            })
            .count();
        grow(base, grid, levels, &self.points, &indicator, &|share| {
            progress.check("growing", 0.05 + 0.35 * share)
        })
    }
}

/// The value, or none if the readings do not determine it: the verdict then says whether a ball follows them.
fn if_determined<T>(found: Result<T>) -> Result<Option<T>> {
    match found {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == ErrorKind::Undetermined => Ok(None),
        Err(error) => Err(error),
    }
}

/// True if normals of a closed surface face inwards.
///
/// Over the whole surface, the integral of `(p − c)·n` is three times the volume, with outward normals `n`
/// and any centre `c` (divergence theorem).
fn face_inwards(points: &[DVec3], normals: &[DVec3]) -> bool {
    let center = points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let (outward, all) = points.iter().zip(normals).fold((0.0, 0.0), |(outward, all), (p, n)| {
        let from_center = *p - center;
        (outward + from_center.dot(*n), all + from_center.length() * n.length())
    });
    outward < -MIN_INWARD * all
}

/// True if the readings see a ball's solid as star-shaped: their normals face away from its centre.
///
/// The parameters over the base are then unique and smooth. Those of a grown surface are uneven by the noise
/// of what it grew into, and cells follow smooth shape less well over uneven parameters: 95 % intervals of
/// balls of 1000 readings covered 0.82 to 0.93, and errors were up to three times those of a draped surface
/// (decision 0109).
fn is_star_shaped(base: &BaseShape, points: &[DVec3], normals: &[DVec3]) -> Result<bool> {
    // In coordinates in which the base is the unit ball.
    let is_turned = |(point, normal): (DVec3, DVec3)| {
        let (from_centre, normal): ([f64; 3], [f64; 3]) = (
            std::array::from_fn(|d| base.frame[d].dot(point - base.centre) / base.size[d]),
            std::array::from_fn(|d| base.frame[d].dot(normal) * base.size[d]),
        );
        let (from_centre, normal) = (DVec3::from(from_centre), DVec3::from(normal));
        from_centre.dot(normal) < MIN_STAR_COSINE * from_centre.length() * normal.length()
    };
    let turned: Vec<bool> = points.par_iter().zip(normals).map(|(p, n)| is_turned((*p, *n))).collect();
    let most = MAX_TURNED * points.len() as f64;
    let count =
        |counts: &dyn Fn(usize) -> bool| (0..points.len()).filter(|&i| turned[i] && counts(i)).count() as f64;
    if count(&|_| true) <= most {
        return Ok(true);
    }
    let near = Neighbourhoods::new(points, NEAREST)?;
    // Readings, and turned ones, by directions from the centre.
    let at = |share: f64, cells: usize| ((share * cells as f64) as usize).min(cells - 1);
    let direction = |i: usize| {
        let [u, v] = base.parameters(points[i]);
        at(u, DIRECTIONS[0]) + DIRECTIONS[0] * at(v, DIRECTIONS[1])
    };
    let mut counts = vec![[0_usize; 2]; DIRECTIONS[0] * DIRECTIONS[1]];
    for (i, turned) in turned.iter().enumerate() {
        let count = &mut counts[direction(i)];
        count[0] += 1;
        count[1] += usize::from(*turned);
    }
    let is_no_chance = |i: usize| {
        let [all, own] = counts[direction(i)];
        own as f64 > TURNED_BY_CHANCE * all as f64
            || near.share(i, |j| Some(turned[j])).is_some_and(|share| share > TURNED_TOGETHER)
    };
    Ok(count(&is_no_chance) <= most)
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
