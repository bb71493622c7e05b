//! Vertices and edges that trimmed faces share.

use super::rims::{Piece, Rims, Ring};
use crate::export::brep::FacePlanes;
use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineCurve};
use planish_spline::Surface;
use std::collections::{BTreeMap, HashMap, HashSet};

/// Builds the faces of a trimmed surface.
pub(super) struct TrimmedBuilder<'a> {
    surface: &'a Surface,
    brep: Brep,
    /// Lattice points at which edges end: corners, and where the faces beside a rim change.
    ends: HashSet<u64>,
    vertices: HashMap<u64, usize>,
    /// Edges by the lattice points along them.
    edges: HashMap<[u64; 3], usize>,
}

impl<'a> TrimmedBuilder<'a> {
    pub(super) fn new(surface: &'a Surface, rims: &Rims) -> Self {
        // The pieces at each point without direction, with the faces beside them.
        let mut at = HashMap::<u64, BTreeMap<u64, Vec<usize>>>::new();
        let mut ends = HashSet::new();
        for (face, ring) in rims.rings() {
            for (piece, next) in ring.iter().zip(ring.iter().cycle().skip(1)) {
                let [from, to] = piece.ends;
                for (here, there) in [(from, to), (to, from)] {
                    at.entry(here).or_default().entry(there).or_default().push(face);
                }
                if piece.direction() != next.direction() {
                    ends.insert(to);
                }
            }
        }
        ends.extend(at.iter().filter_map(|(&here, around)| {
            let mut others = around.values();
            let is_end = match (others.next(), others.next(), others.next()) {
                (Some(beside_a), Some(beside_b), None) => beside_a != beside_b,
                _ => true,
            };
            is_end.then_some(here)
        }));
        Self { surface, brep: Brep::default(), ends, vertices: HashMap::new(), edges: HashMap::new() }
    }

    /// The faces; `outward` as for whole surfaces.
    pub(super) fn brep(mut self, rims: &Rims, planes: &FacePlanes<'_>) -> Brep {
        let outward = planes.is_outward();
        for (&face, parts) in &rims.of_faces {
            for (ring, holes) in parts {
                let edges = self.edges_of(ring, outward);
                let holes = holes.iter().map(|hole| self.edges_of(hole, outward)).collect();
                let surface = planes.surface(face);
                self.brep.faces.push(BrepFace { surface, edges, holes, same_sense: outward });
            }
        }
        self.brep
    }

    /// The edges of a ring, each with its direction, counter-clockwise seen from the outer side.
    fn edges_of(&mut self, ring: &Ring, outward: bool) -> Vec<(usize, bool)> {
        let Some(first) = ring.iter().position(|piece| self.ends.contains(&piece.ends[0])) else {
            return Vec::new();
        };
        let mut edges = Vec::new();
        let mut run = Vec::new();
        for k in 0..ring.len() {
            let piece = ring[(first + k) % ring.len()];
            run.push(piece);
            if self.ends.contains(&piece.ends[1]) {
                edges.push(self.edge(&run));
                run.clear();
            }
        }
        if !outward {
            edges.reverse();
            edges.iter_mut().for_each(|(_, forward)| *forward = !*forward);
        }
        edges
    }

    /// The edge along a straight run, and true if it was made in this direction.
    fn edge(&mut self, run: &[Piece]) -> (usize, bool) {
        let (first, last) = (run[0], run[run.len() - 1]);
        let ways =
            [[first.ends[0], first.ends[1], last.ends[1]], [last.ends[1], last.ends[0], first.ends[0]]];
        if let Some((forward, &edge)) = [true, false]
            .into_iter()
            .zip(ways)
            .find_map(|(forward, way)| Some((forward, self.edges.get(&way)?)))
        {
            return (edge, forward);
        }
        let mut curve = self.curve(run);
        let last_pole = curve.poles.len() - 1;
        let [start, end] = [(first.ends[0], 0), (last.ends[1], last_pole)].map(|(point, pole)| {
            let position = curve.poles[pole];
            *self.vertices.entry(point).or_insert_with(|| {
                self.brep.vertices.push(position);
                self.brep.vertices.len() - 1
            })
        });
        // Leaves differ in the last digit, so ends are set to the shared vertices.
        curve.poles[0] = self.brep.vertices[start];
        curve.poles[last_pole] = self.brep.vertices[end];
        self.brep.edges.push(BrepEdge { curve, start, end });
        self.edges.insert(ways[0], self.brep.edges.len() - 1);
        (self.brep.edges.len() - 1, true)
    }

    /// The curve of the surface along a straight run: a cubic for each leaf.
    fn curve(&self, run: &[Piece]) -> BsplineCurve {
        let mut poles = Vec::new();
        let mut knots = vec![(0.0, 4)];
        for of_leaf in run.chunk_by(|a, b| a.leaf == b.leaf) {
            let leaf = of_leaf[0].leaf;
            let [from, to] = [of_leaf[0].local[0], of_leaf[of_leaf.len() - 1].local[1]];
            let side = self.surface.space().leaves()[leaf].side();
            let way = [0, 1].map(|d| side * (to[d] - from[d]));
            let jets = [from, to].map(|[s, t]| self.surface.leaf_jet(leaf, s, t));
            let slopes = jets.map(|jet| (way[0] * jet.du + way[1] * jet.dv) / 3.0);
            if poles.is_empty() {
                poles.push(jets[0].point);
            }
            poles.extend([jets[0].point + slopes[0], jets[1].point - slopes[1], jets[1].point]);
            let last = knots[knots.len() - 1].0;
            knots.push((last + way[0].abs() + way[1].abs(), 3));
        }
        let last = knots.len() - 1;
        knots[last].1 = 4;
        BsplineCurve { degree: 3, knots, poles }
    }
}
