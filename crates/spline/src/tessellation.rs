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

use crate::hierarchy::{Cell, Shape};
use crate::surface::Surface;
use planish_estimate::vector3::{cross, distance, dot, norm, unit};
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
    pub positions: Vec<[f64; 3]>,
    /// Unit normals along `S_u × S_v`. Where the surface is degenerate, the normal of the nearest regular
    /// point; zero if the leaf has none.
    pub normals: Vec<[f64; 3]>,
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
/// use planish_spline::{BaseShape, TessellationOptions, tessellate};
/// let ball = BaseShape::sphere([0.0; 3], 10.0, [0.0, 0.0, 1.0]).surface([16, 8])?;
/// let mesh = tessellate(&ball, &TessellationOptions { tolerance: 0.01, ..Default::default() })?;
/// // Euler: a closed mesh of a ball has 2 V − 4 triangles.
/// assert_eq!(mesh.triangles.len(), 2 * mesh.positions.len() - 4);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn tessellate(surface: &Surface, options: &TessellationOptions) -> Result<Tessellation> {
    let divided = divide(surface, options)?;
    let count = divided.len();
    let least = triangles_of(&divided);
    if least > 1 << 31 {
        return Err(Error::input(format!(
            "a mesh tolerance of {} needs at least {least} triangles, more than the limit of 2^31: use a \
             larger tolerance",
            options.tolerance
        )));
    }
    let limited_leaves = divided.iter().filter(|(_, limited)| *limited).count();
    let lattice = Lattice::new(surface, divided.into_iter().map(|(n, _)| n).collect());
    let mut plans: Vec<LeafPlan> =
        (0..count).into_par_iter().with_min_len(CHUNK).map(|leaf| lattice.plan(leaf)).collect();
    let total = number_vertices(&mut plans)?;

    let vertices: Vec<Vec<Vertex>> = (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let leaves = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            leaves.flat_map(|leaf| plans[leaf].vertices(surface, leaf)).collect()
        })
        .collect();
    let mut mesh = Tessellation { limited_leaves, ..Tessellation::default() };
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
        .map(|chunk| {
            let mut out = Vec::new();
            for plan in chunk {
                plan.triangulate(&mesh.positions, &mut out);
            }
            out
        })
        .collect();
    mesh.triangles = triangles.concat();
    Ok(mesh)
}

/// Lower bound of the number of triangles of [`tessellate`]. It is a few per cent too low, because it does
/// not count fans between levels.
///
/// Use it to choose a tolerance; it is much cheaper than the mesh.
///
/// # Errors
/// `Input` when the tolerance is not positive or the divisions are not in 1 to 64.
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
    let most = options.max_divisions.ilog2();
    Ok((0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(CHUNK)
        .map(|leaf| divisions(surface.leaf_coefficients(leaf), options.tolerance, most))
        .collect())
}

/// Number of triangles: two per rectangle.
fn triangles_of(divided: &[([u32; 2], bool)]) -> u64 {
    divided.iter().map(|(n, _)| 2_u64 << (n[0] + n[1])).sum()
}

/// Binary logarithms of the divisions along u and v, and true if the limit was reached.
fn divisions(c: &[[f64; 3]; 16], tolerance: f64, most: u32) -> ([u32; 2], bool) {
    // Derivatives in leaf-local coordinates are convex combinations of these differences.
    let (mut uu, mut uv, mut vv) = (0.0_f64, 0.0_f64, 0.0_f64);
    for r in 0..4 {
        for k in 0..2 {
            let at = |a: usize, b: usize| -> [f64; 3] {
                [0, 1, 2].map(|d| c[a][d] - 2.0 * c[(a + b) / 2][d] + c[b][d])
            };
            uu = uu.max(norm(at(4 * r + k, 4 * r + k + 2)));
            vv = vv.max(norm(at(4 * k + r, 4 * (k + 2) + r)));
        }
    }
    for r in 0..3 {
        for k in 0..3 {
            let n = 4 * r + k;
            uv = uv.max(norm([0, 1, 2].map(|d| c[n][d] - c[n + 1][d] - c[n + 4][d] + c[n + 5][d])));
        }
    }
    let chord = |a: u32, b: u32| {
        let (hu, hv) = (0.5_f64.powi(a as i32), 0.5_f64.powi(b as i32));
        (hu * hu * uu + 2.0 * hu * hv * uv + hv * hv * vv) / 8.0
    };
    let mut best: Option<(u32, f64, [u32; 2])> = None;
    for a in 0..=most {
        if let Some(b) = (0..=most).find(|&b| chord(a, b) <= tolerance) {
            let found = (a + b, chord(a, b), [a, b]);
            if best.is_none_or(|b| (found.0, found.1) < (b.0, b.1)) {
                best = Some(found);
            }
        }
    }
    best.map_or(([most; 2], true), |(_, _, n)| (n, false))
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
        let steps = levels().map(|(level, n)| n.map(|n| 1 << (total - level - n))).collect();
        Self { surface, finest, depth: total - finest, steps }
    }

    /// Computes the border of a leaf: the union of its vertices and those of its neighbours.
    fn plan(&self, leaf: usize) -> LeafPlan {
        let space = self.surface.space();
        let cell = space.leaves()[leaf];
        let shift = self.finest - u32::from(cell.level);
        let length = 1_u32 << (shift + self.depth);
        let [columns, rows] = space.base().map(|n| (n as u64) << (self.finest + self.depth));
        let start = [cell.i, cell.j].map(|c| u64::from(c) * u64::from(length));
        let key = |x: u64, y: u64| {
            let x = if space.shape().periodic_u() { x % columns } else { x };
            let y = if space.shape().periodic_v() { y % rows } else { y };
            y * (columns + 1) + x
        };
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
            plan.polar[s] = space.shape() == Shape::Ball
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
        let [columns, rows] = space.base().map(|n| (n as i64) << self.finest);
        let [left, bottom] = [cell.i, cell.j].map(|c| i64::from(c) << shift);
        let width = 1_i64 << shift;
        let (along_u, across, limit, periodic) = match side {
            Side::Bottom => (true, bottom - 1, rows, space.shape().periodic_v()),
            Side::Top => (true, bottom + width, rows, space.shape().periodic_v()),
            Side::Left => (false, left - 1, columns, space.shape().periodic_u()),
            Side::Right => (false, left + width, columns, space.shape().periodic_u()),
        };
        let across = if periodic {
            Some(across.rem_euclid(limit))
        } else {
            (0..limit).contains(&across).then_some(across)
        };
        let start = if along_u { left } else { bottom };
        let direction = usize::from(!along_u);
        let own = self.steps[leaf][direction];
        let mut at = start;
        while at < start + width {
            let (mut end, mut step) = (start + width, own);
            if let Some(across) = across {
                let (i, j) = if along_u { (at, across) } else { (across, at) };
                let there = Cell { level: self.finest as u8, i: i as u32, j: j as u32 };
                if let Some(neighbour) = space.leaf_over(there) {
                    let s = self.finest - u32::from(space.leaves()[neighbour].level);
                    end = end.min(((at >> s) + 1) << s);
                    step = step.min(self.steps[neighbour][direction]);
                }
            }
            let from = ((at - start) << self.depth) as u32;
            let to = ((end - start) << self.depth) as u32;
            out.extend((from..to).step_by(step as usize));
            at = end;
        }
        out.push((width << self.depth) as u32);
    }
}

/// Vertices of a leaf in their order: border ring, inner points of the grid, centres of fans.
struct LeafPlan {
    /// Lattice steps along a side of the leaf.
    length: u32,
    /// Lattice steps between its own grid lines, along u and v.
    steps: [u32; 2],
    /// Distances along the sides in the order of [`SIDES`], each from its start in u or v, both ends
    /// included; a side that is a pole has one entry.
    offsets: Vec<u32>,
    ends: [u32; 4],
    polar: [bool; 4],
    /// Counter-clockwise from the lower left corner: lattice points at first, vertex numbers after
    /// [`number_vertices`].
    ring: Vec<u64>,
    /// Number of the first vertex owned by this leaf.
    first_own: u32,
    /// The vertices of the ring owned by this leaf.
    own_ring: Vec<u32>,
    middles: u32,
}

/// Lattice coordinates in the leaf of a vertex of the ring.
#[derive(Debug, Clone, Copy, Default)]
struct RingPlace {
    x: u32,
    y: u32,
    at_pole: bool,
}

/// An evaluated vertex.
struct Vertex {
    leaf: u32,
    local: [f64; 2],
    position: [f64; 3],
    normal: [f64; 3],
}

impl LeafPlan {
    /// Divisions along u and v.
    fn grid(&self) -> [u32; 2] {
        self.steps.map(|step| self.length / step)
    }

    fn side(&self, s: usize) -> &[u32] {
        let from = if s == 0 { 0 } else { self.ends[s - 1] as usize };
        &self.offsets[from..self.ends[s] as usize]
    }

    /// Number of edges of the border.
    fn ring_length(&self) -> usize {
        self.offsets.len() - 4
    }

    /// Index in the ring of the `k`-th vertex of a side, counted in the direction of u or v.
    fn ring_index(&self, s: usize, k: usize) -> usize {
        let edges = |s: usize| self.side(s).len() - 1;
        let index = match SIDES[s] {
            Side::Bottom => k,
            Side::Right => edges(0) + k,
            Side::Top => edges(0) + edges(1) + edges(2) - k,
            Side::Left => self.ring_length() - k,
        };
        index % self.ring_length()
    }

    /// Positions of the vertices of the ring.
    fn ring_places(&self) -> Vec<RingPlace> {
        let mut places = vec![RingPlace::default(); self.ring_length()];
        for (s, side) in SIDES.into_iter().enumerate() {
            for (k, &offset) in self.side(s).iter().enumerate() {
                let place = &mut places[self.ring_index(s, k)];
                if place.at_pole {
                    continue;
                }
                let [x, y] = match side {
                    Side::Bottom => [offset, 0],
                    Side::Right => [self.length, offset],
                    Side::Top => [offset, self.length],
                    Side::Left => [0, offset],
                };
                let at_pole = self.polar[s];
                *place = RingPlace { x, y, at_pole };
            }
        }
        places
    }

    /// True if a rectangle of the grid does not touch the border.
    fn is_inside(&self, a: u32, b: u32) -> bool {
        let [nu, nv] = self.grid();
        a > 0 && b > 0 && a + 1 < nu && b + 1 < nv
    }

    fn inner_count(&self) -> u32 {
        let [nu, nv] = self.grid();
        (nu - 1) * (nv - 1)
    }

    fn inner(&self, a: u32, b: u32) -> u32 {
        self.ring_length() as u32 + (b - 1) * (self.grid()[0] - 1) + a - 1
    }

    /// Index in the ring of a distance along a side; at a pole, the index of the pole.
    fn on_side(&self, s: usize, offset: u32) -> u32 {
        let k = self.side(s).partition_point(|&o| o < offset);
        self.ring_index(s, k.min(self.side(s).len() - 1)) as u32
    }

    fn grid_point(&self, a: u32, b: u32) -> u32 {
        let [nu, nv] = self.grid();
        let (x, y) = (a * self.steps[0], b * self.steps[1]);
        if b == 0 {
            self.on_side(0, x)
        } else if b == nv {
            self.on_side(2, x)
        } else if a == nu {
            self.on_side(1, y)
        } else if a == 0 {
            self.on_side(3, y)
        } else {
            self.inner(a, b)
        }
    }

    /// All vertices around a rectangle of the grid, counter-clockwise; a side at a pole is one vertex.
    fn polygon(&self, a: u32, b: u32, out: &mut Vec<u32>) {
        let [nu, nv] = self.grid();
        let [x, y] = [a * self.steps[0], b * self.steps[1]];
        out.clear();
        // Vertices strictly between two points of a border side.
        let between = |s: usize, from: u32, to: u32| {
            let offsets = self.side(s);
            let first = offsets.partition_point(|&o| o <= from);
            let last = offsets.partition_point(|&o| o < to);
            (first..last.max(first)).map(move |k| self.ring_index(s, k) as u32)
        };
        out.push(self.grid_point(a, b));
        if b == 0 && !self.polar[0] {
            out.extend(between(0, x, x + self.steps[0]));
        }
        out.push(self.grid_point(a + 1, b));
        if a + 1 == nu {
            out.extend(between(1, y, y + self.steps[1]));
        }
        out.push(self.grid_point(a + 1, b + 1));
        if b + 1 == nv && !self.polar[2] {
            out.extend(between(2, x, x + self.steps[0]).rev());
        }
        out.push(self.grid_point(a, b + 1));
        if a == 0 {
            out.extend(between(3, y, y + self.steps[1]).rev());
        }
        out.dedup();
        if out.first() == out.last() {
            out.pop();
        }
    }

    /// True if a polygon in row `b` of the grid has more corners than two triangles (at a pole: one).
    fn needs_middle(&self, b: u32, polygon: &[u32]) -> bool {
        let at_pole = self.polar[0] && b == 0 || self.polar[2] && b + 1 == self.grid()[1];
        polygon.len() > if at_pole { 3 } else { 4 }
    }

    /// Visits the rectangles of the grid in order, with column, row, corners, and true for a fan around its
    /// centre.
    fn for_each_polygon(&self, mut visit: impl FnMut(u32, u32, &[u32], bool)) {
        let [nu, nv] = self.grid();
        let mut polygon = Vec::new();
        for b in 0..nv {
            for a in 0..nu {
                if self.is_inside(a, b) {
                    let corners = [
                        self.inner(a, b),
                        self.inner(a + 1, b),
                        self.inner(a + 1, b + 1),
                        self.inner(a, b + 1),
                    ];
                    visit(a, b, &corners, false);
                } else {
                    self.polygon(a, b, &mut polygon);
                    visit(a, b, &polygon, self.needs_middle(b, &polygon));
                }
            }
        }
    }

    /// The vertices owned by this leaf, in the order of their numbers.
    fn vertices(&self, surface: &Surface, leaf: usize) -> Vec<Vertex> {
        let mut out = Vec::with_capacity(self.own_ring.len() + (self.inner_count() + self.middles) as usize);
        let scale = 1.0 / f64::from(self.length);
        let mut add = |x: f64, y: f64, at_pole: bool| {
            let local = [x * scale, y * scale];
            let jet = surface.leaf_jet(leaf, local[0], local[1]);
            out.push(Vertex {
                leaf: leaf as u32,
                local,
                position: jet.point,
                normal: normal(surface, leaf, local, at_pole),
            });
        };
        let places = self.ring_places();
        for &index in &self.own_ring {
            let place = places[index as usize];
            add(f64::from(place.x), f64::from(place.y), place.at_pole);
        }
        let [nu, nv] = self.grid();
        let [hu, hv] = self.steps.map(f64::from);
        for b in 1..nv {
            for a in 1..nu {
                add(f64::from(a) * hu, f64::from(b) * hv, false);
            }
        }
        if self.middles > 0 {
            self.for_each_polygon(|a, b, _, middle| {
                if middle {
                    add((f64::from(a) + 0.5) * hu, (f64::from(b) + 0.5) * hv, false);
                }
            });
        }
        out
    }

    fn triangulate(&self, positions: &[[f64; 3]], out: &mut Vec<[u32; 3]>) {
        let ring = self.ring_length() as u32;
        let first_inner = self.first_own + self.own_ring.len() as u32;
        let number = |index: u32| {
            if index < ring { self.ring[index as usize] as u32 } else { first_inner + (index - ring) }
        };
        let mut middle = first_inner + self.inner_count();
        self.for_each_polygon(|_, _, polygon, has_middle| {
            if has_middle {
                for k in 0..polygon.len() {
                    let next = polygon[(k + 1) % polygon.len()];
                    out.push([middle, number(polygon[k]), number(next)]);
                }
                middle += 1;
            } else if let [a, b, c, d] = *polygon {
                let [a, b, c, d] = [a, b, c, d].map(number);
                let length = |p: u32, q: u32| distance(positions[p as usize], positions[q as usize]);
                if length(a, c) <= length(b, d) {
                    out.extend([[a, b, c], [a, c, d]]);
                } else {
                    out.extend([[a, b, d], [b, c, d]]);
                }
            } else if let [a, b, c] = *polygon {
                out.push([a, b, c].map(number));
            }
        });
    }
}

/// Numbers all vertices in the order of the leaves: lattice points on borders once, then inner vertices.
fn number_vertices(plans: &mut [LeafPlan]) -> Result<usize> {
    let ring: usize = plans.iter().map(|plan| plan.ring.len()).sum();
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

/// The unit normal at a leaf-local point, or that of the nearest regular point towards the centre of the
/// leaf.
fn normal(surface: &Surface, leaf: usize, local: [f64; 2], at_pole: bool) -> [f64; 3] {
    if at_pole {
        let [u, v] = surface.space().parameters(leaf, local);
        if let Some(normal) = surface.normal(u, v) {
            return normal;
        }
    }
    for towards in [0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.5, 1.0] {
        let [s, t] = local.map(|x| x + towards * (0.5 - x));
        let jet = surface.leaf_jet(leaf, s, t);
        let n = cross(jet.du, jet.dv);
        // Below this threshold the direction of S_u × S_v is dominated by rounding.
        if dot(n, n) > 1e-24 * dot(jet.du, jet.du) * dot(jet.dv, jet.dv)
            && let Some(normal) = unit(n)
        {
            return normal;
        }
    }
    [0.0; 3]
}

#[cfg(test)]
mod tests;
