//! Sheets without the parts that nothing measured or implies: faces with trimming curves, and meshes.
//!
//! A sheet extends over a rectangle of parameters, beyond the rim of the data and over their holes. The parts
//! kept are cells of its [`Support`](crate::model::Support). Their rims run along lines of constant
//! parameters, on which a bicubic surface is a cubic curve: trimming curves are exact, with steps of a cell.
//!
//! Not guaranteed: that separate parts that touch in a corner are separate for every reader.

use super::brep::{BrepOptions, Patches, brep_from_surface};
use crate::model::{Observed, SurfaceModel};
use planish_core::DVec3;
use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineCurve};
use planish_spline::{Shape, Surface, Tessellation};
use std::collections::{BTreeMap, HashMap};

/// The surface of a model as B-spline faces. A sheet is trimmed to the parts that were measured or inferred;
/// holes and rims are stepped by cells of [`Support`](crate::model::Support).
#[must_use]
pub fn brep_from_model(model: &SurfaceModel, options: &BrepOptions) -> Brep {
    match KeptParts::new(model) {
        Some(kept) => kept.brep(&Patches::within(model.surface.space(), options)),
        None => brep_from_surface(&model.surface, options),
    }
}

/// The kept parts of a sheet, on the integer lattice of its smallest cells.
pub(super) struct KeptParts<'a> {
    model: &'a SurfaceModel,
    /// Lattice steps along the side of a cell of the base grid.
    scale: i64,
}

/// A point of the lattice.
type Corner = [i64; 2];

/// A piece of a rim: from and to; what is kept is on its left.
type Piece = (Corner, Corner);

impl<'a> KeptParts<'a> {
    /// The kept parts of a model; none if it is not a sheet, or if all or nothing would be kept.
    pub(super) fn new(model: &'a SurfaceModel) -> Option<Self> {
        let space = model.surface.space();
        if space.shape() != Some(Shape::Sheet) || model.support.is_empty() {
            return None;
        }
        let mut finest = 0;
        let (mut any, mut all) = (false, true);
        for (cell, (depth, parts)) in space.leaves().iter().zip(model.support.leaves()) {
            finest = finest.max(cell.level + depth);
            for part in parts {
                let keep = is_kept(part.observed);
                any |= keep;
                all &= keep;
            }
        }
        (any && !all).then_some(Self { model, scale: 1 << finest })
    }

    /// Halvings of a leaf's sides after which every square lies in one cell.
    pub(super) fn halvings(&self, leaf: usize) -> u8 {
        let mixed = [false, true]
            .map(|keep| self.model.support.cells(leaf).iter().any(|cell| is_kept(cell.observed) == keep));
        if mixed == [true, true] { self.model.support.depth(leaf) } else { 0 }
    }

    /// The triangles of a mesh that are kept, with their vertices.
    ///
    /// The mesh must have the halvings of [`KeptParts::halvings`].
    pub(super) fn trimmed(&self, mesh: &Tessellation) -> Tessellation {
        let space = self.model.surface.space();
        let is_inside = |corners: &&[u32; 3]| {
            let middle =
                [0, 1].map(|d| corners.iter().map(|&k| mesh.parameters[k as usize][d]).sum::<f64>() / 3.0);
            let (leaf, local) = space.locate(middle[0], middle[1]);
            is_kept(self.model.observed_at(leaf, local))
        };
        let mut triangles: Vec<[u32; 3]> = mesh.triangles.iter().filter(is_inside).copied().collect();
        let mut number = vec![u32::MAX; mesh.positions.len()];
        let mut before: Vec<usize> = Vec::new();
        for corner in triangles.iter_mut().flatten() {
            let new = &mut number[*corner as usize];
            if *new == u32::MAX {
                *new = before.len() as u32;
                before.push(*corner as usize);
            }
            *corner = *new;
        }
        Tessellation {
            positions: before.iter().map(|&k| mesh.positions[k]).collect(),
            normals: before.iter().map(|&k| mesh.normals[k]).collect(),
            parameters: before.iter().map(|&k| mesh.parameters[k]).collect(),
            leaf: before.iter().map(|&k| mesh.leaf[k]).collect(),
            local: before.iter().map(|&k| mesh.local[k]).collect(),
            triangles,
            limited_leaves: mesh.limited_leaves,
        }
    }

    /// The cell that contains a lattice square, as its lower left corner and its side; none outside.
    fn cell(&self, [x, y]: Corner) -> Option<(Corner, i64, bool)> {
        let space = self.model.surface.space();
        let at = [x, y].map(|c| (c as f64 + 0.5) / self.scale as f64);
        if (0..2).any(|d| at[d] < 0.0 || at[d] > space.extent()[d]) {
            return None;
        }
        let (leaf, local) = space.locate(at[0], at[1]);
        let cell = space.leaves()[leaf];
        let depth = self.model.support.depth(leaf);
        let side = self.scale >> (cell.level + depth);
        Some(([x, y].map(|c| c - c.rem_euclid(side)), side, is_kept(self.model.observed_at(leaf, local))))
    }

    /// The faces over patches of the base grid, trimmed.
    pub(super) fn brep(&self, patches: &Patches) -> Brep {
        let rims = self.rims(patches);
        let mut builder = TrimmedBuilder::new(&self.model.surface, self.scale, &rims);
        for (number, patch) in patches.all().enumerate() {
            let Some(pieces) = rims.get(&number) else { continue };
            let loops = traced(pieces);
            let (outer, holes): (Vec<_>, Vec<_>) = loops.into_iter().partition(|ring| area2(ring) > 0);
            for ring in &outer {
                let own = holes.iter().filter(|hole| is_within(hole, ring, &outer));
                let holes = own.map(|hole| builder.edges_of(hole)).collect();
                let edges = builder.edges_of(ring);
                let surface = patches.surface(&self.model.surface, patch);
                builder.brep.faces.push(BrepFace { surface, edges, holes, same_sense: true });
            }
        }
        builder.brep
    }

    /// For each patch, the directed pieces of the rims of its kept part, which is on their left.
    fn rims(&self, patches: &Patches) -> BTreeMap<usize, Vec<Piece>> {
        let mut rims = BTreeMap::<usize, Vec<Piece>>::new();
        let space = self.model.surface.space();
        for (leaf, cell) in space.leaves().iter().enumerate() {
            let side = self.scale >> cell.level;
            let parts = 1_i64 << self.model.support.depth(leaf);
            let step = side / parts;
            let patch = patches.of_cell(*cell);
            for (number, part) in self.model.support.cells(leaf).iter().enumerate() {
                if !is_kept(part.observed) {
                    continue;
                }
                let from = [i64::from(cell.i) * side, i64::from(cell.j) * side];
                let corner = [from[0] + number as i64 % parts * step, from[1] + number as i64 / parts * step];
                self.rim_of_cell(corner, step, patch, patches, rims.entry(patch).or_default());
            }
        }
        rims
    }

    /// Adds the sides of a kept cell beyond which is nothing kept, or another patch.
    fn rim_of_cell(&self, [x, y]: Corner, side: i64, patch: usize, patches: &Patches, rim: &mut Vec<Piece>) {
        // Counter-clockwise: the start of each side, its direction, and the square across.
        let sides = [
            ([x, y], [1, 0], [0, -1]),
            ([x + side, y], [0, 1], [0, 0]),
            ([x + side, y + side], [-1, 0], [-1, 0]),
            ([x, y + side], [0, -1], [-1, -1]),
        ];
        for (start, direction, across) in sides {
            let at = |along: i64| [0, 1].map(|d| start[d] + along * direction[d]);
            let mut along = 0;
            while along < side {
                let from = at(along);
                let square = [0, 1].map(|d| from[d] + across[d]);
                let (length, open) = match self.cell(square) {
                    None => (side - along, true),
                    Some((corner, width, kept)) => {
                        // Up to the end of the neighbour, so that both have the same pieces.
                        let axis = usize::from(direction[0] == 0);
                        let inside = square[axis] - corner[axis];
                        let rest = if direction[axis] > 0 { width - inside } else { inside + 1 };
                        let same = patches.at(square.map(|c| c.div_euclid(self.scale))) == patch;
                        (rest.min(side - along), !(kept && same))
                    }
                };
                if open {
                    rim.push((from, at(along + length)));
                }
                along += length;
            }
        }
    }
}

fn is_kept(observed: Observed) -> bool {
    observed != Observed::PriorOnly
}

/// The vertices of closed loops of directed pieces.
fn traced(pieces: &[Piece]) -> Vec<Vec<Corner>> {
    let mut from: BTreeMap<Corner, Vec<usize>> = BTreeMap::new();
    for (k, piece) in pieces.iter().enumerate() {
        from.entry(piece.0).or_default().push(k);
    }
    let mut used = vec![false; pieces.len()];
    let mut loops = Vec::new();
    for first in 0..pieces.len() {
        let mut ring = Vec::new();
        let mut at = first;
        while !used[at] {
            used[at] = true;
            let (start, end) = pieces[at];
            ring.push(start);
            let direction = [0, 1].map(|d| (end[d] - start[d]).signum());
            // Where two parts touch in a corner, the left turn stays on the same part.
            let turn = |k: &usize| {
                let next = [0, 1].map(|d| (pieces[*k].1[d] - pieces[*k].0[d]).signum());
                direction[0] * next[1] - direction[1] * next[0]
            };
            let next = from.get(&end).into_iter().flatten().copied().filter(|&k| !used[k]);
            match next.max_by_key(turn) {
                Some(next) => at = next,
                None => break,
            }
        }
        if !ring.is_empty() {
            loops.push(ring);
        }
    }
    loops
}

/// Twice the signed area.
fn area2(ring: &[Corner]) -> i64 {
    let ends = ring.iter().skip(1).chain(ring.first());
    ring.iter().zip(ends).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum()
}

/// True if a hole lies in a loop and in no smaller one that lies in it.
fn is_within(hole: &[Corner], ring: &[Corner], outer: &[Vec<Corner>]) -> bool {
    let smallest = outer.iter().filter(|ring| contains(ring, hole)).min_by_key(|ring| area2(ring));
    smallest.is_some_and(|smallest| smallest.as_slice() == ring)
}

/// True if a hole lies in a loop: a point next to its first piece, by the parity of crossings.
fn contains(ring: &[Corner], hole: &[Corner]) -> bool {
    let (Some(&[x, y]), Some(next)) = (hole.first(), hole.get(1)) else { return false };
    // Twice the coordinates, so that the middle of the lattice square on the left of the piece has integers.
    let [dx, dy] = [(next[0] - x).signum(), (next[1] - y).signum()];
    let at = [2 * x + dx - dy, 2 * y + dy + dx];
    let ends = ring.iter().skip(1).chain(ring.first());
    let crossings = ring.iter().zip(ends).filter(|(a, b)| {
        let [low, high] = [a[1].min(b[1]), a[1].max(b[1])];
        a[0] == b[0] && 2 * a[0] > at[0] && 2 * low < at[1] && at[1] < 2 * high
    });
    crossings.count() % 2 == 1
}

/// Vertices and edges that faces share.
struct TrimmedBuilder<'a> {
    surface: &'a Surface,
    scale: i64,
    brep: Brep,
    /// True at the ends of edges: corners, and where the faces beside a rim change.
    is_end: HashMap<Corner, bool>,
    vertices: HashMap<Corner, usize>,
    edges: HashMap<(Corner, Corner), usize>,
}

impl<'a> TrimmedBuilder<'a> {
    fn new(surface: &'a Surface, scale: i64, rims: &BTreeMap<usize, Vec<Piece>>) -> Self {
        // The pieces at each corner without direction, with the patches beside them.
        let mut at = HashMap::<Corner, BTreeMap<Corner, Vec<usize>>>::new();
        for (&patch, pieces) in rims {
            for &(from, to) in pieces {
                for (here, there) in [(from, to), (to, from)] {
                    at.entry(here).or_default().entry(there).or_default().push(patch);
                }
            }
        }
        let ends = |(here, around): (&Corner, &BTreeMap<Corner, Vec<usize>>)| {
            let mut others = around.iter();
            let is_end = match (others.next(), others.next(), others.next()) {
                (Some((a, beside_a)), Some((b, beside_b)), None) => {
                    let straight = (0..2).any(|d| a[d] == here[d] && b[d] == here[d]);
                    !straight || beside_a != beside_b
                }
                _ => true,
            };
            (*here, is_end)
        };
        let is_end = at.iter().map(ends).collect();
        Self {
            surface,
            scale,
            brep: Brep::default(),
            is_end,
            vertices: HashMap::new(),
            edges: HashMap::new(),
        }
    }

    /// The edges of a loop, each with its direction.
    fn edges_of(&mut self, ring: &[Corner]) -> Vec<(usize, bool)> {
        let Some(first) = ring.iter().position(|corner| self.is_end[corner]) else { return Vec::new() };
        let mut edges = Vec::new();
        let mut run = vec![ring[first]];
        for k in 1..=ring.len() {
            let corner = ring[(first + k) % ring.len()];
            run.push(corner);
            if self.is_end[&corner] {
                edges.push(self.edge(&run));
                run = vec![corner];
            }
        }
        edges
    }

    /// The edge along the corners of a straight run, and whether it was made in this direction.
    fn edge(&mut self, run: &[Corner]) -> (usize, bool) {
        let (from, to) = (run[0], run[run.len() - 1]);
        // Each edge runs towards larger parameters, so that both faces make the same.
        let forward = from < to;
        let key = (from.min(to), from.max(to));
        if let Some(&edge) = self.edges.get(&key) {
            return (edge, forward);
        }
        let mut corners = run.to_vec();
        corners.sort_unstable();
        let curve = self.curve(&corners);
        let [start, end] = [key.0, key.1].map(|corner| self.vertex(corner));
        self.brep.edges.push(BrepEdge { curve, start, end });
        self.edges.insert(key, self.brep.edges.len() - 1);
        (self.brep.edges.len() - 1, forward)
    }

    fn vertex(&mut self, corner: Corner) -> usize {
        let position = self.point(corner);
        *self.vertices.entry(corner).or_insert_with(|| {
            self.brep.vertices.push(position);
            self.brep.vertices.len() - 1
        })
    }

    fn parameters(&self, corner: Corner) -> [f64; 2] {
        corner.map(|c| c as f64 / self.scale as f64)
    }

    fn point(&self, corner: Corner) -> DVec3 {
        let [u, v] = self.parameters(corner);
        self.surface.point(u, v)
    }

    /// The curve of the surface through ascending corners on a line of constant u or v, as cubic pieces.
    fn curve(&self, corners: &[Corner]) -> BsplineCurve {
        let axis = usize::from(corners[0][0] == corners[1][0]);
        let mut poles = vec![self.point(corners[0])];
        for pair in corners.windows(2) {
            let [from, to] = [pair[0], pair[1]].map(|corner| self.parameters(corner));
            let length = to[axis] - from[axis];
            // First derivatives are continuous between leaves, so those of a neighbour serve as well.
            let jets = [from, to].map(|[u, v]| self.surface.jet(u, v));
            let slopes = jets.map(|jet| length / 3.0 * if axis == 0 { jet.du } else { jet.dv });
            let end = self.point(pair[1]);
            poles.extend([jets[0].point + slopes[0], jets[1].point - slopes[1], end]);
        }
        let last = corners.len() - 1;
        let knots = (corners.iter().enumerate())
            .map(|(k, corner)| (self.parameters(*corner)[axis], if k == 0 || k == last { 4 } else { 3 }))
            .collect();
        BsplineCurve { degree: 3, knots, poles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::{BrepOptions, brep_from_model, mesh_from_model, trimmed_mesh_from_model};
    use crate::model::{Support, SupportCell};
    use crate::test_support::{model_of, refined_surface};

    /// A curved sheet of which `keep` selects the measured places, in shares of the extent.
    fn sheet(depth: u8, keep: impl Fn([f64; 2]) -> bool) -> SurfaceModel {
        let flat = refined_surface(Shape::Sheet);
        let bent = flat.vertices().iter().map(|p| DVec3::new(p[0], p[1], 0.2 * (3.0 * p[0]).sin() * p[1]));
        let mut model = model_of(flat.with_vertices(bent.collect()).unwrap(), |_| true);
        let space = model.surface.space().clone();
        let cells = |leaf: usize| {
            let cell = |local: [f64; 2]| {
                let at = space.parameters(leaf, local);
                let kept = keep([0, 1].map(|d| at[d] / space.extent()[d]));
                SupportCell { observed: Observed::from_measured(kept), distance: f64::from(u8::from(!kept)) }
            };
            (depth, crate::model::middles(depth).map(cell).collect())
        };
        model.support = Support::new((0..space.leaves().len()).map(cells).collect()).unwrap();
        model
    }

    /// Faces over few and over many patches, and the mesh, hold the same part of the sheet.
    #[test]
    fn a_sheet_with_a_hole_keeps_its_outline_and_its_hole() {
        let model = sheet(3, |[u, v]| (0.1..0.9).contains(&u) && (u - 0.5).hypot(v - 0.5) > 0.2);
        for max_control_points in [usize::MAX, 0] {
            let brep = brep_from_model(&model, &BrepOptions { max_control_points });
            brep.check(1e-9).unwrap();
            assert!(!brep.closed && !brep.faces.is_empty());
            if max_control_points > 0 {
                assert_eq!((brep.faces.len(), brep.faces[0].holes.len()), (1, 1));
            }
            // Every edge lies on the surface: its middle has the height of the surface there.
            for edge in &brep.edges {
                for p in &edge.curve.poles[..1] {
                    assert!((p[2] - 0.2 * (3.0 * p[0]).sin() * p[1]).abs() < 0.05, "{p:?}");
                }
            }
        }
        let posterior = model.posterior().unwrap();
        let [whole, trimmed] = [mesh_from_model, trimmed_mesh_from_model]
            .map(|made| made(&model, &posterior, Some(1e-3)).unwrap().mesh);
        let share = trimmed.area() / whole.area();
        let expected = 0.8 - std::f64::consts::PI * 0.04;
        assert!((share - expected).abs() < 0.05, "{share} {expected}");
        assert!(trimmed.check().manifold && trimmed.check().components == 1);
    }

    #[test]
    fn parts_that_touch_in_a_corner_are_separate_faces() {
        let model = sheet(2, |[u, v]| (u < 0.5) == (v < 0.5));
        let brep = brep_from_model(&model, &BrepOptions::default());
        brep.check(1e-9).unwrap();
        assert_eq!(brep.faces.len(), 2);
        assert!(brep.faces.iter().all(|face| face.edges.len() == 4 && face.holes.is_empty()));
    }

    #[test]
    fn an_island_in_a_hole_is_a_face_of_its_own() {
        let ring = |[u, v]: [f64; 2]| (u - 0.5).abs().max((v - 0.5).abs());
        let model = sheet(4, |at| ring(at) > 0.3 || ring(at) < 0.1);
        let brep = brep_from_model(&model, &BrepOptions::default());
        brep.check(1e-9).unwrap();
        let mut holes: Vec<usize> = brep.faces.iter().map(|face| face.holes.len()).collect();
        holes.sort_unstable();
        assert_eq!(holes, [0, 1]);
    }

    #[test]
    fn sheets_that_are_known_everywhere_stay_whole() {
        for model in [sheet(2, |_| true), sheet(2, |_| false)] {
            assert!(KeptParts::new(&model).is_none());
            let brep = brep_from_model(&model, &BrepOptions::default());
            assert_eq!((brep.faces.len(), brep.edges.len()), (1, 4));
        }
    }
}
