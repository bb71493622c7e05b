//! The rims of the kept part of each face, on the integer lattice of the smallest cells.

use super::KeptParts;
use crate::export::brep::FacePlanes;
use planish_spline::{Cell, Shape, Surface};
use std::collections::{BTreeMap, HashMap, HashSet};

/// A place in the plane of the parameters of a face, in steps of the lattice.
pub(super) type Corner = [i64; 2];

/// A piece of a rim in one leaf; what is kept is on its left.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// Numbers of the lattice points at both ends, the same in all faces.
    pub(super) ends: [u64; 2],
    /// Both ends in the plane of the face.
    pub(super) plane: [Corner; 2],
    /// The leaf, and both ends in it.
    pub(super) leaf: usize,
    pub(super) local: [[f64; 2]; 2],
}

impl Piece {
    /// Direction in the plane of the face.
    pub(super) fn direction(&self) -> Corner {
        let [from, to] = self.plane;
        [0, 1].map(|d| (to[d] - from[d]).signum())
    }
}

/// A closed chain of pieces.
pub(super) type Ring = Vec<Piece>;

/// The rims of all faces.
pub(super) struct Rims {
    /// For each face with a kept part: rings around parts, each with its holes.
    pub(super) of_faces: BTreeMap<usize, Vec<(Ring, Vec<Ring>)>>,
}

impl Rims {
    pub(super) fn new(kept: &KeptParts<'_>, planes: &FacePlanes<'_>) -> Self {
        let lattice = Lattice::new(kept);
        let mut of_faces: BTreeMap<usize, Vec<Piece>> = BTreeMap::new();
        for leaf in 0..lattice.surface.space().leaves().len() {
            let cell = lattice.surface.space().leaves()[leaf];
            let (face, _) = planes.place(cell, lattice.corner(cell, [0, 0]), lattice.scale);
            for [from, to] in lattice.rim_of_leaf(kept, leaf) {
                lattice.add_pieces(planes, leaf, [from, to], of_faces.entry(face).or_default());
            }
        }
        let rings = |pieces: Vec<Piece>| {
            // Neighbours of one face pass their common side in opposite directions.
            let all: HashSet<[u64; 2]> = pieces.iter().map(|piece| piece.ends).collect();
            let is_rim = |piece: &Piece| {
                let [from, to] = piece.ends;
                // Sides at a pole have no length.
                from != to && !all.contains(&[to, from])
            };
            let rim: Vec<Piece> = pieces.into_iter().filter(is_rim).collect();
            let (outer, holes): (Vec<Ring>, Vec<Ring>) =
                traced(&rim).into_iter().partition(|ring| area2(ring) > 0);
            let own_of = |ring: &Ring| {
                holes.iter().filter(|hole| is_within(hole, ring, &outer)).cloned().collect::<Vec<_>>()
            };
            outer.iter().map(|ring| (ring.clone(), own_of(ring))).collect::<Vec<_>>()
        };
        Self { of_faces: of_faces.into_iter().map(|(face, pieces)| (face, rings(pieces))).collect() }
    }

    /// All rings, each with the number of its face.
    pub(super) fn rings(&self) -> impl Iterator<Item = (usize, &Ring)> {
        let of_part = |(ring, holes)| std::iter::once(ring).chain(holes);
        self.of_faces.iter().flat_map(move |(&face, parts)| {
            let parts = parts.iter().map(|(ring, holes)| (ring, holes.iter()));
            parts.flat_map(of_part).map(move |ring| (face, ring))
        })
    }
}

/// The lattice on which all cells have whole coordinates.
struct Lattice<'a> {
    surface: &'a Surface,
    /// Steps along the side of a cell of the base grid, and the level of which they are the sides of cells.
    scale: i64,
    level: usize,
    /// Rows of the lattice of a ball, whose first and last are one point each.
    rows: Option<i64>,
    /// Points at which pieces end.
    points: HashSet<u64>,
}

impl<'a> Lattice<'a> {
    fn new(kept: &KeptParts<'a>) -> Self {
        let surface = &kept.model.surface;
        let space = surface.space();
        let support = &kept.model.support;
        let depths = (0..space.leaves().len()).map(|leaf| space.leaves()[leaf].level + support.depth(leaf));
        let level = usize::from(depths.max().unwrap_or(0));
        let scale = 1_i64 << level;
        let rows = (space.shape() == Some(Shape::Ball)).then_some(space.base()[1] as i64 * scale);
        let mut own = Self { surface, scale, level, rows, points: HashSet::new() };
        for (leaf, &cell) in space.leaves().iter().enumerate() {
            // Kept or not: a piece is then halved wherever a part of it is the side of a smaller cell.
            let (side, step) = own.sides(cell, support.depth(leaf));
            for along in (0..=side).step_by(step as usize) {
                for local in [[along, 0], [along, side], [0, along], [side, along]] {
                    let point = own.point(cell, own.corner(cell, local));
                    own.points.insert(point);
                }
            }
        }
        own
    }

    /// Steps along the side of a leaf, and of one of its cells.
    fn sides(&self, cell: Cell, depth: u8) -> (i64, i64) {
        let side = self.scale >> cell.level;
        (side, side >> depth)
    }

    /// The lattice point at a place in a leaf.
    fn corner(&self, cell: Cell, local: Corner) -> Corner {
        let side = self.scale >> cell.level;
        [i64::from(cell.i) * side + local[0], i64::from(cell.j) * side + local[1]]
    }

    fn point(&self, cell: Cell, [x, y]: Corner) -> u64 {
        let at_pole = self.rows.is_some_and(|rows| y == 0 || y == rows);
        let at = [if at_pole { 0 } else { x as u64 }, y as u64];
        self.surface.space().point_number(self.level, cell, at)
    }

    /// The sides of the kept cells of a leaf beyond which is no other one, counter-clockwise.
    fn rim_of_leaf(&self, kept: &KeptParts<'_>, leaf: usize) -> Vec<[Corner; 2]> {
        let cell = self.surface.space().leaves()[leaf];
        let parts = kept.model.support.cells(leaf);
        let depth = kept.model.support.depth(leaf);
        let (_, step) = self.sides(cell, depth);
        let count = 1_i64 << depth;
        let has = |[x, y]: Corner| {
            let is_inside = (0..count).contains(&x) && (0..count).contains(&y);
            is_inside && kept.keeps(leaf, parts[(y * count + x) as usize].observed)
        };
        let mut rim = Vec::new();
        for [x, y] in (0..count * count).map(|k| [k % count, k / count]).filter(|&at| has(at)) {
            // The start of each side, its direction, and the cell across.
            let sides = [
                ([x, y], [1, 0], [x, y - 1]),
                ([x + 1, y], [0, 1], [x + 1, y]),
                ([x + 1, y + 1], [-1, 0], [x, y + 1]),
                ([x, y + 1], [0, -1], [x - 1, y]),
            ];
            for (start, direction, across) in sides {
                if !has(across) {
                    let end = [start[0] + direction[0], start[1] + direction[1]];
                    rim.push([start, end].map(|at| self.corner(cell, at.map(|c| c * step))));
                }
            }
        }
        rim
    }

    /// Adds the pieces of a side of a cell, which end at all points that end others.
    fn add_pieces(
        &self,
        planes: &FacePlanes<'_>,
        leaf: usize,
        [from, to]: [Corner; 2],
        out: &mut Vec<Piece>,
    ) {
        let cell = self.surface.space().leaves()[leaf];
        let length = (to[0] - from[0]).abs() + (to[1] - from[1]).abs();
        let middle = [0, 1].map(|d| (from[d] + to[d]) / 2);
        if length > 1 && self.points.contains(&self.point(cell, middle)) {
            self.add_pieces(planes, leaf, [from, middle], out);
            self.add_pieces(planes, leaf, [middle, to], out);
            return;
        }
        let side = (self.scale >> cell.level) as f64;
        let first = self.corner(cell, [0, 0]);
        out.push(Piece {
            ends: [from, to].map(|corner| self.point(cell, corner)),
            plane: [from, to].map(|corner| planes.place(cell, corner, self.scale).1),
            leaf,
            local: [from, to].map(|corner| [0, 1].map(|d| (corner[d] - first[d]) as f64 / side)),
        });
    }
}

/// Closed rings of pieces.
fn traced(pieces: &[Piece]) -> Vec<Ring> {
    let mut from: HashMap<u64, Vec<usize>> = HashMap::new();
    for (k, piece) in pieces.iter().enumerate() {
        from.entry(piece.ends[0]).or_default().push(k);
    }
    let mut used = vec![false; pieces.len()];
    let mut rings = Vec::new();
    for first in 0..pieces.len() {
        let mut ring = Ring::new();
        let mut at = first;
        while !used[at] {
            used[at] = true;
            let piece = pieces[at];
            ring.push(piece);
            let direction = piece.direction();
            // Where two parts touch in a corner, the left turn stays on the same part.
            let turn = |k: &usize| {
                let next = pieces[*k].direction();
                direction[0] * next[1] - direction[1] * next[0]
            };
            let next = from.get(&piece.ends[1]).into_iter().flatten().copied().filter(|&k| !used[k]);
            match next.max_by_key(turn) {
                Some(next) => at = next,
                None => break,
            }
        }
        if !ring.is_empty() {
            rings.push(ring);
        }
    }
    rings
}

/// Twice the signed area. At poles, rings leave out a side of the plane.
fn area2(ring: &[Piece]) -> i64 {
    let corners: Vec<Corner> = ring.iter().flat_map(|piece| piece.plane).collect();
    let ends = corners.iter().skip(1).chain(corners.first());
    corners.iter().zip(ends).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
}

/// True if a hole lies in a ring and in no smaller one that lies in it.
fn is_within(hole: &[Piece], ring: &[Piece], outer: &[Ring]) -> bool {
    let smallest = outer.iter().filter(|ring| contains(ring, hole)).min_by_key(|ring| area2(ring));
    smallest.is_some_and(|smallest| smallest[0].ends == ring[0].ends)
}

/// True if a hole lies in a ring: a point next to its first piece, by the parity of crossings.
fn contains(ring: &[Piece], hole: &[Piece]) -> bool {
    let [x, y] = hole[0].plane[0];
    // Twice the coordinates, so that the middle of the lattice square on the left of the piece has integers.
    let [dx, dy] = hole[0].direction();
    let at = [2 * x + dx - dy, 2 * y + dy + dx];
    let crossings = ring.iter().filter(|piece| {
        let [a, b] = piece.plane;
        let [low, high] = [a[1].min(b[1]), a[1].max(b[1])];
        a[0] == b[0] && 2 * a[0] > at[0] && 2 * low < at[1] && at[1] < 2 * high
    });
    crossings.count() % 2 == 1
}
