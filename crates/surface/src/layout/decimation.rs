//! A coarse mesh of triangles with one vertex for each lattice position.
//!
//! Edges of no steps are collapsed, where that keeps the topology of the mesh. Triangles between three
//! lattice positions are halves of squares. Where the lattice is folded, edges are flipped if that makes
//! their steps shorter, and collapse when nothing is left of them.
//!
//! Creases keep their curves and corners: a vertex on a curve becomes another one along it only.
//!
//! Not guaranteed: that all folds go away. Some are left where the steps of a whole area do not fit.

use super::closure::Steps;
use super::creases::{CreaseEdges, VertexKind};
use super::faces::{EdgeMap, Face, Faces};
use super::lattice::{Lattice, Step, turned};
use super::network::Place;
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use std::collections::HashSet;

/// Rounds of collapses and flips.
const PASSES: usize = 40;
/// Faces of a disc that is removed, at most, and the same as a share of all. A loop on a sphere has discs on
/// both sides.
const MAX_DISC: usize = 400;
const MAX_DISC_SHARE: f64 = 0.1;
/// Rounds of even spacing, and the share of the way to the mean in each.
const SPACING_ROUNDS: usize = 60;
const SPACING_STEP: f64 = 0.8;

/// The coarse mesh.
pub(super) struct Decimation {
    pub(super) faces: Faces,
    pub(super) creases: CreaseEdges,
    /// A lattice for each vertex. Those without faces are not used.
    lattices: Vec<Lattice>,
    weights: Vec<f64>,
    steps: EdgeMap<Step>,
}

impl Decimation {
    pub(super) fn new(
        mesh: &TriangleMesh,
        creases: CreaseEdges,
        lattices: Vec<Lattice>,
        steps: &Steps,
    ) -> Self {
        let faces = Faces::new(&mesh.triangles, mesh.positions.len());
        let ends = mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
        let steps = ends.zip(steps.steps.iter().copied()).collect();
        let weights = vec![1.0; lattices.len()];
        let mut own = Self { faces, creases, lattices, weights, steps };
        for _ in 0..PASSES {
            if own.collapse_all() == 0 {
                break;
            }
        }
        for _ in 0..PASSES {
            if own.flip_all() + own.collapse_all() == 0 {
                break;
            }
        }
        own
    }

    pub(super) fn positions(&self) -> Vec<DVec3> {
        self.lattices.iter().map(|lattice| lattice.position).collect()
    }

    /// True for an edge across a square.
    pub(super) fn is_diagonal(&self, edge: (u32, u32)) -> bool {
        self.steps.get(&edge).is_some_and(|step| step.by.map(i32::abs) == [1, 1])
    }

    fn collapse_all(&mut self) -> usize {
        let gap = |&(a, b): &(u32, u32)| {
            let [a, b] = [a, b].map(|v| self.lattices[v as usize].position);
            a.distance_squared(b)
        };
        let mut empty: Vec<(f64, (u32, u32))> = (self.faces.edges().into_iter())
            .filter(|edge| self.steps[edge].is_zero())
            .map(|edge| (gap(&edge), edge))
            .collect();
        empty.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let is_left = |own: &Self, edge| own.steps.get(edge).is_some_and(|step: &Step| step.is_zero());
        empty.iter().filter(|(_, edge)| is_left(self, edge) && self.collapse(*edge)).count()
    }

    /// Makes one vertex of the ends of an edge, or removes what is between them and a common neighbour.
    fn collapse(&mut self, (a, b): (u32, u32)) -> bool {
        let common = self.faces.common_neighbours(a, b);
        if common.len() != 2 {
            // Loops of three edges that are no triangle.
            return common.into_iter().filter(|&c| self.remove_disc([a, b, c])).count() > 0;
        }
        // Of a tetrahedron, two triangles without volume would be left.
        if self.faces.valence(a) + self.faces.valence(b) <= 7 {
            return false;
        }
        let (a, b) = if self.creases.allows_merge(&self.faces, a, b) {
            (a, b)
        } else if self.creases.allows_merge(&self.faces, b, a) {
            (b, a)
        } else {
            return false;
        };
        let near = self.faces.neighbours(b).to_vec();
        let is_new: Vec<bool> = near.iter().map(|&w| w != a && !self.faces.are_joined(a, w)).collect();
        if !self.faces.merge_into(a, b) {
            return false;
        }
        self.creases.merged(a, b, &near);
        let link = self.steps[&(a, b)];
        for (&w, is_new) in near.iter().zip(is_new) {
            let onward = self.forget((b, w));
            if is_new {
                self.set((a, w), link.then(onward));
            }
        }
        let [x, y] = [a, b].map(|v| (self.weights[v as usize], self.lattices[v as usize]));
        self.weights[a as usize] = x.0 + y.0;
        let kinds = [a, b].map(|v| self.creases.kind(v));
        // A vertex on a crease stays on it.
        if matches!(kinds, [VertexKind::Corner(_), _] | [VertexKind::OnCurve(_), VertexKind::Free]) {
            return true;
        }
        let position = (x.0 * x.1.position + y.0 * y.1.position) / (x.0 + y.0);
        // Directions stay those of the vertex, since its steps are given along them.
        self.lattices[a as usize].position = position;
        true
    }

    fn set(&mut self, (a, b): (u32, u32), step: Step) {
        self.steps.insert((a, b), step);
        self.steps.insert((b, a), step.reversed());
    }

    /// Removes the step of an edge and returns it.
    fn forget(&mut self, (a, b): (u32, u32)) -> Step {
        self.steps.remove(&(b, a));
        self.steps.remove(&(a, b)).unwrap_or(Step { turn: 0, by: [0, 0] })
    }

    /// Replaces a small disc within a loop of three edges by a triangle. The lattice is folded in it.
    fn remove_disc(&mut self, [a, b, c]: [u32; 3]) -> bool {
        [[a, b, c], [b, a, c]].into_iter().any(|loop_of| {
            let Some(disc) = self.disc_within(loop_of) else { return false };
            let inner: Vec<(u32, u32)> = (disc.iter().filter_map(|&f| self.faces.face(f)))
                .flat_map(|face| face.edges().collect::<Vec<_>>())
                .filter(|(p, q)| !(loop_of.contains(p) && loop_of.contains(q)))
                .collect();
            let is_removed = self.faces.replace(&disc, &[Face::triangle(loop_of)]).is_some();
            if is_removed {
                inner.into_iter().for_each(|edge| {
                    self.forget(edge);
                });
            }
            is_removed
        })
    }

    /// The faces at the left of a loop of three edges, if they are a small disc of several.
    fn disc_within(&self, corners: [u32; 3]) -> Option<Vec<u32>> {
        let border = Face::triangle(corners);
        let (first, _) = self.faces.left_of(corners[0], corners[1])?;
        let (mut found, mut inner) = (vec![first], HashSet::new());
        let mut seen = HashSet::from([first]);
        let most = MAX_DISC.min((MAX_DISC_SHARE * self.faces.count() as f64) as usize);
        let mut next = 0;
        while next < found.len() {
            let face = self.faces.face(found[next])?;
            next += 1;
            inner.extend(face.corners().iter().copied().filter(|v| !corners.contains(v)));
            for (p, q) in face.edges().filter(|edge| border.edges().all(|other| other != *edge)) {
                if self.creases.has((p, q)) {
                    return None;
                }
                let (over, _) = self.faces.left_of(q, p)?;
                if seen.insert(over) {
                    found.push(over);
                }
            }
            if found.len() > most {
                return None;
            }
        }
        // Of a disc with three vertices on its border, V − E + F = 1.
        (found.len() > 1 && found.len() == 2 * inner.len() + 1).then_some(found)
    }

    /// Flips edges if that makes their steps shorter.
    fn flip_all(&mut self) -> usize {
        self.faces.edges().into_iter().filter(|&edge| self.flip(edge)).count()
    }

    fn flip(&mut self, (a, b): (u32, u32)) -> bool {
        let Some(both) = self.faces.sides((a, b)).filter(|_| !self.creases.has((a, b))) else { return false };
        let [b, c, a, d] = both.corners[..] else { return false };
        if c == d || self.faces.are_joined(c, d) || self.faces.valence(a).min(self.faces.valence(b)) <= 3 {
            return false;
        }
        let by = |p: u32, q: u32, r: u32| self.steps[&(p, q)].then(self.steps[&(q, r)]);
        let step = by(c, a, d);
        // Around a singular triangle, both ways differ.
        let is_shorter = step.length_squared() < self.steps[&(a, b)].length_squared();
        if !is_shorter || step != by(c, b, d) {
            return false;
        }
        if self.faces.replace(&both.faces, &[Face::triangle([a, d, c]), Face::triangle([d, b, c])]).is_none()
        {
            return false;
        }
        self.forget((a, b));
        self.set((c, d), step);
        if step.is_zero() {
            self.collapse((c, d));
        }
        true
    }

    /// Moves vertices along the surface to where the steps of all edges agree best.
    pub(super) fn space_evenly(&mut self, places: &[Place]) {
        let used = (0..self.lattices.len() as u32).filter(|&v| self.faces.valence(v) > 0);
        let used: Vec<u32> = used.collect();
        for &v in (0..SPACING_ROUNDS).flat_map(|_| &used) {
            let mut own = self.lattices[v as usize];
            let near = self.faces.neighbours(v);
            let wanted = |&w: &u32| {
                let (other, step) = (&self.lattices[w as usize], self.steps[&(v, w)]);
                let seen = turned(step.by, 4 - step.turn);
                // Half of the way in the tangent plane of each.
                let way = own.vector(step.by.map(f64::from)) + other.vector(seen.map(f64::from));
                other.position - 0.5 * own.side * way
            };
            let mean = near.iter().map(wanted).sum::<DVec3>() / near.len() as f64;
            let step = SPACING_STEP * (mean - own.position);
            match places[v as usize] {
                Place::Fixed => continue,
                Place::Along(curve) => {
                    let (on, way) = curve.nearest(own.position + step.dot(own.direction) * own.direction);
                    (own.at, own.position) = (on, on);
                    own.point_along(way.dot(own.direction).signum() * way);
                }
                Place::On(search) => {
                    let on = search.closest(own.position + step - step.dot(own.normal) * own.normal);
                    let Some(on) = on else { continue };
                    (own.at, own.position, own.normal) = (on.point, on.point, on.normal);
                    own.point_along(own.direction);
                }
            }
            self.lattices[v as usize] = own;
        }
    }
}
