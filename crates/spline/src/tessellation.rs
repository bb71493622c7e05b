//! Triangle meshes of a surface with a bounded chord error.
//!
//! Input: a [`Surface`] and a tolerance. Output: vertices with their normals and parameters, and triangles
//! that run counter-clockwise around `S_u × S_v`. Every leaf is divided into a grid by powers of two.
//! Neighbours of any level share the vertices along their common side; rectangles next to a denser neighbour
//! become fans around their centre. Therefore the mesh has no cracks and no T-vertices, and a ball or torus
//! is watertight.
//!
//! Points are identified on an integer lattice, as fine as the finest leaf and wrapped in periodic
//! directions. Two leaves share a vertex if its lattice point is the same. A pole of a ball is one vertex.
//!
//! Not guaranteed: a mesh without self-intersections if the surface has folds.
//!
//! # References
//! Filip, Magedson, Markot, *Surface algorithms using bounds on derivatives*, CAGD 1986 (chord error).

mod leaf_plan;

use crate::hierarchy::{Cell, Shape};
use crate::surface::Surface;
use leaf_plan::{LeafPlan, Vertex};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;

/// Maximum of [`TessellationOptions::max_divisions`].
const MAX_DIVISIONS: u32 = 64;
/// Number of leaves per task.
const CHUNK: usize = 128;

/// Options of [`tessellate`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TessellationOptions {
    /// Maximum distance between the surface and its triangles, in the unit of the model.
    pub tolerance: f64,
    /// Maximum number of divisions along a side of a leaf, 1 to 64; rounded down to a power of two.
    pub max_divisions: u32,
}

impl Default for TessellationOptions {
    /// Tolerance 0.001 (1 µm if the unit is mm), at most 64 divisions.
    fn default() -> Self {
        Self { tolerance: 1e-3, max_divisions: MAX_DIVISIONS }
    }
}

/// A triangle mesh of a surface.
///
/// All lists except the triangles have one entry per vertex.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tessellation {
    /// Vertex positions in the model's unit.
    pub positions: Vec<DVec3>,
    /// Unit normals along `S_u × S_v`. Where the surface is degenerate, the normal of the nearest regular
    /// point; zero if the leaf has none.
    pub normals: Vec<DVec3>,
    /// `(u, v)` in base-grid units. A vertex on a seam has the parameters of the side that starts at zero.
    pub parameters: Vec<[f64; 2]>,
    /// A leaf that contains the vertex.
    pub leaf: Vec<u32>,
    /// Coordinates in that leaf, in `[0, 1]²`.
    pub local: Vec<[f64; 2]>,
    /// Vertex indices, counter-clockwise as seen from the side of the normals.
    pub triangles: Vec<[u32; 3]>,
    /// Number of leaves where [`TessellationOptions::max_divisions`] prevents the tolerance.
    pub limited_leaves: usize,
}

/// Computes a mesh whose distance from the surface is at most the tolerance.
///
/// In a rectangle of `h_u × h_v` the error of the linear interpolant over any triangle is at most
/// `(h_u² |S_uu| + 2 h_u h_v |S_uv| + h_v² |S_vv|)/8`, where differences of the coefficients bound the
/// derivatives over the leaf. Each leaf gets the smallest number of divisions that brings this below the
/// tolerance.
///
/// The result has the same bytes for any number of threads. Cost: one jet per vertex, one table look-up per
/// vertex on the border of a leaf.
///
/// # Errors
/// `Input` when the tolerance is not positive, the divisions are not in 1 to 64, or the mesh would have more
/// than 2³¹ triangles.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{BaseShape, TessellationOptions, tessellate};
/// let ball = BaseShape::sphere(DVec3::ZERO, 10.0, DVec3::Z).surface([16, 8])?;
/// let mesh = tessellate(&ball, &TessellationOptions { tolerance: 0.01, ..Default::default() })?;
/// // Euler: a closed mesh of a ball has 2 V − 4 triangles.
/// assert_eq!(mesh.triangles.len(), 2 * mesh.positions.len() - 4);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn tessellate(surface: &Surface, options: &TessellationOptions) -> Result<Tessellation> {
    tessellate_parts(surface, options, |_| 0, |_, _| true)
}

/// [`tessellate`] for parts of a surface. The sides of each leaf are halved at least as often as stated, at
/// most six times. Of the squares, those are kept for whose leaf and middle in it `is_kept` is true.
///
/// # Errors
/// As for [`tessellate`].
pub fn tessellate_parts(
    surface: &Surface,
    options: &TessellationOptions,
    halvings: impl Fn(usize) -> u8,
    is_kept: impl Fn(usize, [f64; 2]) -> bool + Sync,
) -> Result<Tessellation> {
    let mut divided = divide(surface, options)?;
    for (leaf, (n, _)) in divided.iter_mut().enumerate() {
        *n = n.map(|n| n.max(u32::from(halvings(leaf)).min(MAX_DIVISIONS.ilog2())));
    }
    let count = divided.len();
    let minimum = triangles_of(&divided);
    if minimum > 1 << 31 {
        return Err(Error::input(format!(
            "a mesh tolerance of {} needs at least {minimum} triangles, more than the limit of 2^31: use a \
             larger tolerance",
            options.tolerance
        )));
    }
    let limited_leaves = divided.iter().filter(|(_, limited)| *limited).count();
    let lattice = Lattice::new(surface, divided.into_iter().map(|(n, _)| n).collect());
    let mut plans: Vec<LeafPlan> =
        (0..count).into_par_iter().with_min_len(CHUNK).map(|leaf| lattice.plan(leaf)).collect();
    let total = number_vertices(&mut plans)?;

    // Vertices and triangles are collected chunk by chunk in the order of the leaves, so the mesh does not
    // depend on the number of threads.
    let vertices: Vec<Vec<Vertex>> = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let leaves = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            leaves.flat_map(|leaf| plans[leaf].vertices(surface, leaf)).collect()
        })
        .collect();
    let mut mesh = Tessellation { limited_leaves, ..Tessellation::default() };
    // The number of vertices is known, so arrays are allocated once.
    mesh.positions.reserve_exact(total);
    mesh.normals.reserve_exact(total);
    mesh.parameters.reserve_exact(total);
    mesh.leaf.reserve_exact(total);
    mesh.local.reserve_exact(total);
    for vertex in vertices.iter().flatten() {
        mesh.positions.push(vertex.position);
        mesh.normals.push(vertex.normal);
        mesh.parameters.push(surface.space().parameters(vertex.leaf as usize, vertex.local));
        mesh.leaf.push(vertex.leaf);
        mesh.local.push(vertex.local);
    }
    let triangles: Vec<Vec<[u32; 3]>> = plans
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, plans)| {
            let mut out = Vec::new();
            for (leaf, plan) in (chunk * CHUNK..).zip(plans) {
                plan.triangulate(&mesh.positions, |middle| is_kept(leaf, middle), &mut out);
            }
            out
        })
        .collect();
    mesh.triangles = triangles.concat();
    mesh.drop_unused();
    Ok(mesh)
}

impl Tessellation {
    /// Drops vertices without triangles.
    fn drop_unused(&mut self) {
        let mut number = vec![u32::MAX; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
        let used: Vec<usize> = (0..number.len()).filter(|&v| number[v] == 0).collect();
        if used.len() == number.len() {
            return;
        }
        used.iter().zip(0..).for_each(|(&v, new)| number[v] = new);
        self.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        self.positions = used.iter().map(|&v| self.positions[v]).collect();
        self.normals = used.iter().map(|&v| self.normals[v]).collect();
        self.parameters = used.iter().map(|&v| self.parameters[v]).collect();
        self.leaf = used.iter().map(|&v| self.leaf[v]).collect();
        self.local = used.iter().map(|&v| self.local[v]).collect();
    }
}

/// Lower bound of the number of triangles of [`tessellate`]. It is a few per cent too low, because it does
/// not count fans between levels.
///
/// Use it to choose a tolerance; it is much cheaper than the mesh.
///
/// # Errors
/// `Input` when the tolerance is not positive or the divisions are not in 1 to 64.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{BaseShape, TessellationOptions, min_triangles};
///
/// let ball = BaseShape::sphere(DVec3::ZERO, 10.0, DVec3::Z).surface([16, 8])?;
/// let count = |tolerance| min_triangles(&ball, &TessellationOptions { tolerance, ..Default::default() });
/// assert!(count(0.01)? > 4 * count(0.1)?);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn min_triangles(surface: &Surface, options: &TessellationOptions) -> Result<u64> {
    divide(surface, options).map(|divided| triangles_of(&divided))
}

/// The divisions of every leaf; see [`divisions`].
fn divide(surface: &Surface, options: &TessellationOptions) -> Result<Vec<([u32; 2], bool)>> {
    if !(options.tolerance > 0.0 && options.tolerance.is_finite()) {
        return Err(Error::input(format!("expected a mesh tolerance > 0, found {}", options.tolerance)));
    }
    if !(1..=MAX_DIVISIONS).contains(&options.max_divisions) {
        return Err(Error::input(format!(
            "expected a maximum of 1 to {MAX_DIVISIONS} divisions of a leaf, found {}",
            options.max_divisions
        )));
    }
    let max_log2 = options.max_divisions.ilog2();
    Ok((0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|leaf| divisions(surface.leaf_coefficients(leaf), options.tolerance, max_log2))
        .collect())
}

/// Number of triangles: two per rectangle.
fn triangles_of(divided: &[([u32; 2], bool)]) -> u64 {
    divided.iter().map(|(n, _)| 2_u64 << (n[0] + n[1])).sum()
}

/// Binary logarithms of the divisions along u and v, and true if the limit was reached.
fn divisions(c: &[DVec3; 16], tolerance: f64, max_log2: u32) -> ([u32; 2], bool) {
    // Derivatives in leaf-local coordinates are convex combinations of these differences.
    let (mut uu, mut uv, mut vv) = (0.0_f64, 0.0_f64, 0.0_f64);
    for r in 0..4 {
        for k in 0..2 {
            let at = |a: usize, b: usize| -> DVec3 { c[a] - 2.0 * c[(a + b) / 2] + c[b] };
            uu = uu.max(at(4 * r + k, 4 * r + k + 2).length());
            vv = vv.max(at(4 * k + r, 4 * (k + 2) + r).length());
        }
    }
    for r in 0..3 {
        for k in 0..3 {
            let n = 4 * r + k;
            uv = uv.max((c[n] - c[n + 1] - c[n + 4] + c[n + 5]).length());
        }
    }
    let chord = |a: u32, b: u32| {
        let (hu, hv) = (0.5_f64.powi(a as i32), 0.5_f64.powi(b as i32));
        (hu * hu * uu + 2.0 * hu * hv * uv + hv * hv * vv) / 8.0
    };
    // Fewest rectangles first, then the smaller error. Dividing both directions alike would waste triangles
    // on surfaces curved in one direction only.
    let mut best: Option<(u32, f64, [u32; 2])> = None;
    for a in 0..=max_log2 {
        // For each division along u, the smallest sufficient one along v: the bound decreases with both.
        if let Some(b) = (0..=max_log2).find(|&b| chord(a, b) <= tolerance) {
            let found = (a + b, chord(a, b), [a, b]);
            if best.is_none_or(|b| (found.0, found.1) < (b.0, b.1)) {
                best = Some(found);
            }
        }
    }
    best.map_or(([max_log2; 2], true), |(_, _, n)| (n, false))
}

/// The sides of a leaf, counter-clockwise from v = 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Bottom,
    Right,
    Top,
    Left,
}

const SIDES: [Side; 4] = [Side::Bottom, Side::Right, Side::Top, Side::Left];

/// The integer lattice of all vertices.
struct Lattice<'a> {
    surface: &'a Surface,
    /// Level of the finest leaf.
    finest: u32,
    /// Lattice steps along the side of a cell of the finest level, as a binary logarithm.
    depth: u32,
    /// For each leaf, lattice steps between its grid lines along u and v.
    steps: Vec<[u32; 2]>,
}

impl<'a> Lattice<'a> {
    fn new(surface: &'a Surface, divisions: Vec<[u32; 2]>) -> Self {
        let space = surface.space();
        let finest = (space.levels() - 1) as u32;
        let levels = || space.leaves().iter().map(|cell| u32::from(cell.level)).zip(&divisions);
        let total = levels().map(|(level, n)| level + n[0].max(n[1])).max().unwrap_or(0);
        let total = total.max(finest);
        // Numbers of divisions are powers of two: vertices of adjacent leaves then lie on one integer
        // lattice.
        let steps = levels().map(|(level, n)| n.map(|n| 1 << (total - level - n))).collect();
        Self { surface, finest, depth: total - finest, steps }
    }

    /// Computes the border of a leaf: the union of its vertices and those of its neighbours.
    fn plan(&self, leaf: usize) -> LeafPlan {
        let space = self.surface.space();
        let cell = space.leaves()[leaf];
        let shift = self.finest - u32::from(cell.level);
        let length = 1_u32 << (shift + self.depth);
        let rows = (space.base()[1] as u64) << (self.finest + self.depth);
        let start = [cell.i, cell.j].map(|c| u64::from(c) * u64::from(length));
        // Integers instead of coordinates: vertices of neighbours are identified exactly, without a
        // tolerance.
        let level = (self.finest + self.depth) as usize;
        let key = |x: u64, y: u64| space.point_number(level, cell, [x, y]);
        let mut plan = LeafPlan {
            length,
            steps: self.steps[leaf],
            offsets: Vec::new(),
            ends: [0; 4],
            polar: [false; 4],
            ring: Vec::new(),
            first_own: 0,
            own_ring: Vec::new(),
            middles: 0,
        };
        for (s, side) in SIDES.into_iter().enumerate() {
            plan.polar[s] = space.shape() == Some(Shape::Ball)
                && match side {
                    Side::Bottom => cell.j == 0,
                    Side::Top => start[1] + u64::from(length) == rows,
                    _ => false,
                };
            if plan.polar[s] {
                plan.offsets.push(0);
            } else {
                self.side_offsets(cell, leaf, side, &mut plan.offsets);
            }
            plan.ends[s] = plan.offsets.len() as u32;
        }
        plan.ring = plan
            .ring_places()
            .into_iter()
            .map(|place| {
                // A pole is one lattice point for all columns.
                let x = if place.at_pole { 0 } else { start[0] + u64::from(place.x) };
                key(x, start[1] + u64::from(place.y))
            })
            .collect();
        let mut middles = 0;
        plan.for_each_polygon(|_, _, _, has_middle| middles += u32::from(has_middle));
        plan.middles = middles;
        plan
    }

    /// Collects the distances of all vertices of a side from its start.
    fn side_offsets(&self, cell: Cell, leaf: usize, side: Side, out: &mut Vec<u32>) {
        let space = self.surface.space();
        let shift = self.finest - u32::from(cell.level);
        let [left, bottom] = [cell.i, cell.j].map(|c| c << shift);
        let width = 1_u32 << shift;
        let far = width - 1;
        // The finest cells along the side: the number of the side, the first of them, and its direction.
        let (number, [i, j], along_u) = match side {
            Side::Bottom => (0, [left, bottom], true),
            Side::Right => (1, [left + far, bottom], false),
            Side::Top => (2, [left, bottom + far], true),
            Side::Left => (3, [left, bottom], false),
        };
        let start = if along_u { left } else { bottom };
        let own = self.steps[leaf][usize::from(!along_u)];
        let mut at = start;
        while at < start + width {
            let (mut end, mut step) = (start + width, own);
            let [i, j] = if along_u { [at, j] } else { [i, at] };
            let across = space.across_side(Cell { level: self.finest as u8, i, j }, number);
            if let Some((across, neighbour)) = across.and_then(|a| space.leaf_over(a.cell).map(|n| (a, n))) {
                let s = self.finest - u32::from(space.leaves()[neighbour].level);
                let before = (if across.along_u { across.cell.i } else { across.cell.j }) & ((1 << s) - 1);
                // A side can have several finer neighbours, each with its own steps.
                let left = if across.reversed { before + 1 } else { (1 << s) - before };
                end = end.min(at + left);
                // The finer of both leaves determines the vertices on a common side, which leaves no gaps.
                step = step.min(self.steps[neighbour][usize::from(!across.along_u)]);
            }
            let from = (at - start) << self.depth;
            let to = (end - start) << self.depth;
            out.extend((from..to).step_by(step as usize));
            at = end;
        }
        out.push(width << self.depth);
    }
}

/// Numbers all vertices in the order of the leaves: lattice points on borders once, then inner vertices.
fn number_vertices(plans: &mut [LeafPlan]) -> Result<usize> {
    let ring: usize = plans.iter().map(|plan| plan.ring.len()).sum();
    // Numbers follow the order of the leaves; the table is only searched, so its own order does not matter.
    let mut known: HashMap<u64, u32> = HashMap::with_capacity(ring / 2);
    let mut next = 0_u32;
    let full = || Error::input("the mesh has more than 2^32 vertices: use a larger mesh tolerance");
    for plan in plans {
        plan.first_own = next;
        for index in 0..plan.ring.len() {
            let number = *known.entry(plan.ring[index]).or_insert_with(|| {
                plan.own_ring.push(index as u32);
                next += 1;
                next - 1
            });
            plan.ring[index] = u64::from(number);
        }
        next = next
            .checked_add(plan.inner_count() + plan.middles)
            .filter(|&next| next < u32::MAX - (1 << 20))
            .ok_or_else(full)?;
    }
    Ok(next as usize)
}

#[cfg(test)]
mod tests;
