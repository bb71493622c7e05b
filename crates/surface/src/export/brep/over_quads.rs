//! Faces of a surface over quads: one for each rectangle of quads.
//!
//! A face has the knot lines of all leaves of its quads. Its control points are blossoms of the leaves, so
//! the surface is exact, and fine leaves add knot lines only where they are. Across most lines, second
//! derivatives are continuous; those of the pieces at an extraordinary vertex have continuous first
//! derivatives, so their knots are double. A rectangle is divided if fine leaves in some of its quads would
//! give it more than twice the control points that its quads have on their own.
//!
//! # References
//! Ramshaw, *Blossoms are polar forms*, CAGD 1989.

#[cfg(test)]
mod tests;

use super::encloses_positive_volume;
use super::rectangles::{Rectangle, rectangles};
use planish_core::DVec3;
use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineCurve, BsplineSurface};
use planish_spline::{Cell, Hierarchy, QuadDomain, Surface};
use std::collections::BTreeMap;

/// A rectangle may have this many times the control points of its quads on their own. With 1, fits of nine
/// objects had 1.6 to 3 times as many faces and 10 to 30 % fewer control points. With 3, they had the same as
/// with 2.
const MAX_GROWTH: usize = 2;

/// The faces of all rectangles of a domain.
pub(super) fn brep(surface: &Surface, domain: &QuadDomain) -> Brep {
    let closed = domain.borders() == 0;
    let outward = !closed || encloses_positive_volume(surface);
    let Rectangles { lines, all, .. } = Rectangles::new(surface, domain);
    let faces: Vec<Face> = all.iter().map(|own| Face::new(surface, &lines, own)).collect();
    // The first face with a corner at a vertex gives its place.
    let mut vertices = Vec::new();
    let mut numbers = vec![None; domain.inner_vertex_count()];
    for face in &faces {
        for side in 0..4 {
            let corner = face.rectangle.vertices(domain, side)[0] as usize;
            numbers[corner].get_or_insert_with(|| {
                vertices.push(face.corner(side));
                vertices.len() - 1
            });
        }
    }
    // An edge ends where a face has a corner, so its faces on both sides have the same edges.
    let mut runs: BTreeMap<[u32; 2], Vec<Run>> = BTreeMap::new();
    let mut loops: Vec<Vec<([u32; 2], usize)>> = Vec::with_capacity(faces.len());
    for (number, face) in faces.iter().enumerate() {
        let mut around = Vec::new();
        for side in 0..4 {
            let along = face.rectangle.vertices(domain, side);
            let ends: Vec<usize> =
                (0..along.len()).filter(|&k| numbers[along[k] as usize].is_some()).collect();
            for pair in ends.windows(2) {
                let [from, to] = [pair[0], pair[1]];
                let key = key(&along[from..=to]);
                let [start, end] = [from, to].map(|k| numbers[along[k] as usize].unwrap_or_default());
                around.push((key, start));
                // The last two sides run against the parameters.
                let (ends, range) = match side < 2 {
                    true => ([start, end], [from, to]),
                    false => ([end, start], [along.len() - 1 - to, along.len() - 1 - from]),
                };
                runs.entry(key).or_default().push(Run { face: number, side, range, ends });
            }
        }
        loops.push(around);
    }
    let mut edge_numbers = BTreeMap::new();
    let mut edges = Vec::with_capacity(runs.len());
    for (key, sides) in &runs {
        // Both faces have the same curve. The one with fewer knots along it has the shorter one.
        let curves = sides.iter().map(|run| (run, faces[run.face].knots_along(run)));
        let Some((run, knots)) = curves.min_by_key(|(_, knots)| knots.len()) else { continue };
        let mut curve = faces[run.face].curve(run, &knots);
        // Faces differ in the last digit, so ends are set to the shared vertices.
        let last = curve.poles.len() - 1;
        curve.poles[0] = vertices[run.ends[0]];
        curve.poles[last] = vertices[run.ends[1]];
        edge_numbers.insert(*key, edges.len());
        edges.push(BrepEdge { curve, start: run.ends[0], end: run.ends[1] });
    }
    let made = faces.iter().zip(loops).map(|(face, around)| {
        let around = around.into_iter().map(|(key, start)| {
            let edge: usize = edge_numbers[&key];
            (edge, (edges[edge].start == start) == outward)
        });
        let mut around: Vec<(usize, bool)> = around.collect();
        if !outward {
            around.reverse();
        }
        BrepFace { surface: face.surface(), edges: around, holes: Vec::new(), same_sense: outward }
    });
    let made = made.collect();
    Brep { vertices, edges, faces: made, closed }
}

/// The rectangles of a domain, and where its quads lie in them.
pub(super) struct Rectangles<'a> {
    surface: &'a Surface,
    domain: &'a QuadDomain,
    lines: KnotLines,
    all: Vec<Rectangle>,
    /// For each quad, its rectangle and its number in it.
    of_quads: Vec<(usize, usize)>,
}

impl<'a> Rectangles<'a> {
    pub(super) fn new(surface: &'a Surface, domain: &'a QuadDomain) -> Self {
        let lines = KnotLines::new(surface.space(), domain);
        let all = rectangles(domain, |rectangle| lines.division(rectangle));
        let mut of_quads = vec![(0, 0); domain.cells().len()];
        for (number, rectangle) in all.iter().enumerate() {
            for (k, &bottom) in rectangle.bottoms.iter().enumerate() {
                of_quads[(bottom / 4) as usize] = (number, k);
            }
        }
        Self { surface, domain, lines, all, of_quads }
    }

    pub(super) fn is_closed(&self) -> bool {
        self.domain.borders() == 0
    }

    /// The rectangle of a quad, and a point of the quad in its frame, for `last` steps along a side of quads.
    pub(super) fn place(&self, quad: u32, at: [i64; 2], last: i64) -> (usize, [i64; 2]) {
        let (number, k) = self.of_quads[quad as usize];
        let rectangle = &self.all[number];
        let [x, y] = to_side(rectangle.bottoms[k] % 4, at, last);
        let [column, row] = [k % rectangle.columns, k / rectangle.columns];
        (number, [column as i64 * last + x, row as i64 * last + y])
    }

    pub(super) fn surface(&self, number: usize) -> BsplineSurface {
        Face::new(self.surface, &self.lines, &self.all[number]).surface()
    }
}

/// Identifies a run of vertices, the same in both directions.
fn key(run: &[u32]) -> [u32; 2] {
    let last = run.len() - 1;
    [run[0], run[1]].min([run[last], run[last - 1]])
}

/// A part of a side of a face.
struct Run {
    face: usize,
    side: usize,
    /// From and to, in quads along the parameter.
    range: [usize; 2],
    /// The vertices there.
    ends: [usize; 2],
}

/// Knots of a direction: their places, and whether they are double.
type Lines = BTreeMap<i64, bool>;

/// Lines between the leaves of each quad, in units of the smallest leaf.
struct KnotLines {
    /// Units along the side of a quad.
    side: i64,
    /// For each quad, across `u` and across `v`.
    of_quads: Vec<[Lines; 2]>,
}

impl KnotLines {
    fn new(space: &Hierarchy, domain: &QuadDomain) -> Self {
        let finest = space.leaves().iter().map(|cell| cell.level).max().unwrap_or(0);
        let mut of_quads = vec![[Lines::new(), Lines::new()]; domain.cells().len()];
        for (leaf, &cell) in space.leaves().iter().enumerate() {
            let is_special = space.cell_of_leaf(leaf) != cell;
            let quad = cell.i >> cell.level;
            for (d, first) in [cell.i - (quad << cell.level), cell.j].into_iter().enumerate() {
                for end in [first, first + 1] {
                    let line = i64::from(end) << (finest - cell.level);
                    *of_quads[quad as usize][d].entry(line).or_default() |= is_special;
                }
            }
        }
        Self { side: 1 << finest, of_quads }
    }

    /// The lines of a rectangle across a direction.
    fn of_rectangle(&self, rectangle: &Rectangle, direction: usize) -> Lines {
        let mut all = Lines::new();
        for (k, &bottom) in rectangle.bottoms.iter().enumerate() {
            let first = self.side * [k % rectangle.columns, k / rectangle.columns][direction] as i64;
            let turns = bottom % 4;
            let lines = &self.of_quads[(bottom / 4) as usize][(direction + turns as usize) % 2];
            for (&line, &is_double) in lines {
                let along = to_side(turns, [line; 2], self.side)[direction];
                *all.entry(first + along).or_default() |= is_double;
            }
        }
        all
    }

    /// Knots of a rectangle along a direction, with their multiplicities.
    fn knots(&self, rectangle: &Rectangle, direction: usize) -> Vec<(i64, usize)> {
        let lines = self.of_rectangle(rectangle, direction);
        clamped(lines.into_iter().map(|(line, is_double)| (line, 1 + usize::from(is_double))).collect())
    }

    fn control_points(&self, rectangle: &Rectangle) -> usize {
        [0, 1].map(|d| pole_count(&self.knots(rectangle, d))).into_iter().product()
    }

    /// Where to divide a rectangle that has too many control points.
    fn division(&self, rectangle: &Rectangle) -> Option<(usize, usize)> {
        let alone = |&bottom: &u32| self.control_points(&Rectangle { columns: 1, bottoms: vec![bottom] });
        let of_quads: usize = rectangle.bottoms.iter().map(alone).sum();
        if self.control_points(rectangle) <= MAX_GROWTH * of_quads {
            return None;
        }
        let lines = [0, 1].into_iter().flat_map(|d| (1..rectangle.size()[d]).map(move |at| (d, at)));
        lines.min_by_key(|&(d, at)| {
            rectangle.divided(d, at).iter().map(|part| self.control_points(part)).sum::<usize>()
        })
    }
}

/// Coordinates in a quad in the frame of one of its sides: along the side, and away from it.
fn to_side<T: Copy + std::ops::Sub<Output = T>>(side: u32, [x, y]: [T; 2], last: T) -> [T; 2] {
    match side {
        0 => [x, y],
        1 => [y, last - x],
        2 => [last - x, last - y],
        _ => [last - y, x],
    }
}

/// Knots with four at each end: the outermost control points are then those of the boundary.
fn clamped(mut knots: Vec<(i64, usize)>) -> Vec<(i64, usize)> {
    let last = knots.len() - 1;
    knots[0].1 = 4;
    knots[last].1 = 4;
    knots
}

fn pole_count(knots: &[(i64, usize)]) -> usize {
    knots.iter().map(|(_, times)| times).sum::<usize>() - 4
}

/// For each control point, the knots of its blossom, and a place in the support at which to take it.
fn blossoms(knots: &[(i64, usize)]) -> Vec<([i64; 3], f64)> {
    let all: Vec<i64> = knots.iter().flat_map(|&(knot, times)| std::iter::repeat_n(knot, times)).collect();
    let support = |first: usize| &all[first..first + 5];
    (0..all.len() - 4)
        .map(|first| {
            let own = support(first);
            // A blossom far beyond a small leaf would magnify its rounding, so the largest is taken, and of
            // equal ones the one in the middle.
            let largest =
                [1, 2, 0, 3].into_iter().rev().max_by_key(|&k: &usize| own[k + 1] - own[k]).unwrap_or(1);
            ([own[1], own[2], own[3]], 0.5 * (own[largest] + own[largest + 1]) as f64)
        })
        .collect()
}

/// Weights of the uniform coefficients of a cubic in its blossom; the cell is `[0, 1]`.
fn blossom_weights([a, b, c]: [f64; 3]) -> [f64; 4] {
    // The last two steps of the algorithm of de Boor, then its first.
    let first = 0.5 * (1.0 - c) * (1.0 - b);
    let middle = 0.5 * ((1.0 - c) * (1.0 + b) + c * (2.0 - b));
    let last = 0.5 * c * b;
    [
        first * (1.0 - a) / 3.0,
        (first * (2.0 + a) + middle * (2.0 - a)) / 3.0,
        (middle * (1.0 + a) + last * (3.0 - a)) / 3.0,
        last * a / 3.0,
    ]
}

/// The surface over a rectangle.
struct Face<'a> {
    surface: &'a Surface,
    rectangle: &'a Rectangle,
    /// Units along the side of a quad.
    side: i64,
    knots: [Vec<(i64, usize)>; 2],
    poles: Vec<DVec3>,
}

impl<'a> Face<'a> {
    fn new(surface: &'a Surface, lines: &KnotLines, rectangle: &'a Rectangle) -> Self {
        let knots = [0, 1].map(|d| lines.knots(rectangle, d));
        let mut face = Self { surface, rectangle, side: lines.side, knots, poles: Vec::new() };
        let [along_u, along_v] = [0, 1].map(|d| blossoms(&face.knots[d]));
        let poles = along_u.iter().flat_map(|u| along_v.iter().map(|v| face.blossom(*u, *v)));
        face.poles = poles.collect();
        face
    }

    /// The blossom of the leaf at a place.
    fn blossom(&self, (knots_u, u): ([i64; 3], f64), (knots_v, v): ([i64; 3], f64)) -> DVec3 {
        let units = self.side as f64;
        let at = [u, v].map(|x| x / units);
        let [column, row] = at.map(f64::floor);
        let bottom = self.rectangle.bottoms[row as usize * self.rectangle.columns + column as usize];
        // The rotation by as many sides in the other direction leads into the frame of the quad.
        let in_quad = |[x, y]: [f64; 2]| to_side((4 - bottom % 4) % 4, [x - column, y - row], 1.0);
        let [x, y] = in_quad(at);
        let quad = bottom / 4;
        let (leaf, _) = self.surface.space().locate(f64::from(quad) + x, y);
        let Cell { level, i, j } = self.surface.space().leaves()[leaf];
        let scale = f64::from(1_u32 << level);
        let first = [i - (quad << level), j].map(f64::from);
        let knots: [[f64; 2]; 3] = std::array::from_fn(|k| {
            let at = in_quad([knots_u[k], knots_v[k]].map(|knot| knot as f64 / units));
            [0, 1].map(|d| at[d] * scale - first[d])
        });
        let [wu, wv] = [0, 1].map(|d| blossom_weights(knots.map(|knot| knot[d])));
        let coefficients = self.surface.leaf_coefficients(leaf).iter().enumerate();
        coefficients.map(|(k, c)| wu[k % 4] * wv[k / 4] * *c).sum()
    }

    /// The control point at the corner where a side starts.
    fn corner(&self, side: usize) -> DVec3 {
        let [n_u, n_v] = [0, 1].map(|d| pole_count(&self.knots[d]));
        let [i, j] = [[0, 0], [1, 0], [1, 1], [0, 1]][side];
        self.poles[i * (n_u - 1) * n_v + j * (n_v - 1)]
    }

    /// The knots along a part of a side.
    fn knots_along(&self, run: &Run) -> Vec<(i64, usize)> {
        let [from, to] = run.range.map(|k| k as i64 * self.side);
        let knots = self.knots[run.side % 2].iter().copied();
        clamped(knots.filter(|(knot, _)| (from..=to).contains(knot)).collect())
    }

    /// The curve along a part of a side.
    fn curve(&self, run: &Run, knots: &[(i64, usize)]) -> BsplineCurve {
        let across = &self.knots[1 - run.side % 2];
        // Halfway into the outermost cells.
        let [end, next] = match run.side {
            0 | 3 => [across[0].0, across[1].0],
            _ => [across[across.len() - 1].0, across[across.len() - 2].0],
        };
        let fixed = ([end; 3], 0.5 * (end + next) as f64);
        let poles = blossoms(knots).into_iter().map(|along| match run.side % 2 {
            0 => self.blossom(along, fixed),
            _ => self.blossom(fixed, along),
        });
        BsplineCurve { degree: 3, knots: self.parameters(knots), poles: poles.collect() }
    }

    fn surface(&self) -> BsplineSurface {
        let [knots_u, knots_v] = [0, 1].map(|d| self.parameters(&self.knots[d]));
        let [n_u, n_v] = [0, 1].map(|d| pole_count(&self.knots[d]));
        BsplineSurface { degree_u: 3, degree_v: 3, knots_u, knots_v, n_u, n_v, poles: self.poles.clone() }
    }

    /// Knots in quads.
    fn parameters(&self, knots: &[(i64, usize)]) -> Vec<(f64, usize)> {
        knots.iter().map(|&(knot, times)| (knot as f64 / self.side as f64, times)).collect()
    }
}
