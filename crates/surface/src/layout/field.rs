//! A field of lattices that varies smoothly over a mesh.
//!
//! Each vertex in turn takes the mean of the directions of its neighbours, then that of their positions, in
//! the quarter turn and whole step nearest to its own. Agreement over long distances comes from levels with
//! half as many vertices each, the coarsest first.
//!
//! Lattices on a crease have a direction along it and a position on it. Those at corners have a position
//! there.
//!
//! # References
//! Jakob, Tarini, Panozzo, Sorkine-Hornung, *Instant field-aligned meshes*, ACM Transactions on Graphics 34,
//! 2015: the means, the levels and the sharp edges.

use super::creases::{CreaseEdges, VertexKind};
use super::lattice::Lattice;
use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_mesh::{Neighbours, TriangleMesh};
use rayon::prelude::*;

/// Rounds over the vertices of each level.
const ROUNDS: usize = 6;
/// Vertices of the coarsest level.
const COARSEST: usize = 8;

/// Directions on all levels, from which lattices with squares of any side follow.
pub(super) struct DirectionField {
    /// The mesh first.
    levels: Vec<Level>,
    /// Directions of the places of each level.
    directions: Vec<Vec<DVec3>>,
}

impl DirectionField {
    pub(super) fn on_mesh(mesh: &TriangleMesh, creases: &CreaseEdges) -> Self {
        let mut levels = vec![Level::of_mesh(mesh, creases)];
        loop {
            let last = levels.len() - 1;
            let before = levels[last].places.len();
            if before <= COARSEST {
                break;
            }
            let next = levels[last].coarser();
            // Few pairs are left where many places have a single neighbour.
            if 10 * next.places.len() > 9 * before {
                break;
            }
            levels.push(next);
        }
        let mut directions: Vec<Vec<DVec3>> = Vec::new();
        for level in levels.iter().rev() {
            let mut own = level.lattices(1.0);
            if let Some(coarse) = directions.last() {
                for (lattice, &parent) in own.iter_mut().zip(&level.parents) {
                    lattice.point_along(coarse[parent as usize]);
                }
                level.fix_directions(&mut own);
            }
            level.smooth_directions(&mut own);
            directions.push(own.iter().map(|lattice| lattice.direction).collect());
        }
        directions.reverse();
        Self { levels, directions }
    }

    /// Lattices with squares of a side, for all vertices of the mesh.
    pub(super) fn lattices(&self, side: f64) -> Vec<Lattice> {
        let mut coarse: Vec<Lattice> = Vec::new();
        for (level, directions) in self.levels.iter().zip(&self.directions).rev() {
            let mut own = level.lattices(side);
            own.iter_mut().zip(directions).for_each(|(lattice, direction)| lattice.direction = *direction);
            if !coarse.is_empty() {
                for (lattice, &parent) in own.iter_mut().zip(&level.parents) {
                    lattice.position = lattice.on_plane(coarse[parent as usize].position);
                    *lattice = lattice.nearest();
                }
                level.fix_positions(&mut own);
            }
            level.smooth_positions(&mut own);
            coarse = own;
        }
        coarse
    }
}

/// The position of a lattice on a crease, and its direction, which a corner of the mesh has not.
#[derive(Debug, Clone, Copy)]
struct Fixed {
    at: DVec3,
    direction: Option<DVec3>,
    is_corner: bool,
}

impl Fixed {
    fn of_mesh(mesh: &TriangleMesh, creases: &CreaseEdges, around: &Neighbours, v: u32) -> Option<Self> {
        let at = mesh.positions[v as usize];
        let ways = || {
            let near = around.of_vertex(v).iter().filter(|&&w| creases.has((v, w)));
            let mut ends: Vec<u32> = near.copied().collect();
            ends.sort_unstable();
            ends.dedup();
            ends.into_iter().map(|w| mesh.positions[w as usize] - at).collect::<Vec<_>>()
        };
        match creases.kind(v) {
            VertexKind::Free => None,
            VertexKind::Corner(_) => Some(Self { at, direction: None, is_corner: true }),
            VertexKind::OnCurve(_) => {
                let direction = match ways()[..] {
                    [a, b] => (b.normalize_or_zero() - a.normalize_or_zero()).try_normalize(),
                    _ => None,
                };
                Some(Self { at, direction, is_corner: false })
            }
        }
    }

    /// What is fixed at the place of two members of a coarser level.
    fn both(first: Option<Self>, second: Option<Self>) -> Option<Self> {
        let (Some(a), Some(b)) = (first, second) else { return first.or(second) };
        let direction = a.direction.or(b.direction);
        let at = match (a.is_corner, b.is_corner) {
            (true, _) => a.at,
            (_, true) => b.at,
            _ => 0.5 * (a.at + b.at),
        };
        Some(Self { at, direction, is_corner: a.is_corner || b.is_corner })
    }

    fn fix_position(&self, lattice: &mut Lattice) {
        lattice.position = match self.direction.filter(|_| !self.is_corner) {
            Some(along) => self.at + (lattice.position - self.at).dot(along) * along,
            None => self.at,
        };
    }
}

/// A graph of places on a surface.
struct Level {
    places: Vec<DVec3>,
    normals: Vec<DVec3>,
    areas: Vec<f64>,
    /// For each place on a crease, what is fixed there. Empty without creases.
    fixed: Vec<Option<Fixed>>,
    starts: Vec<u32>,
    /// Neighbours of each place, with weights.
    neighbours: Vec<(u32, f64)>,
    /// Places that are replaced together.
    groups: Vec<Vec<u32>>,
    /// For each place, that of the next coarser level.
    parents: Vec<u32>,
}

impl Level {
    fn of_mesh(mesh: &TriangleMesh, creases: &CreaseEdges) -> Self {
        let mut areas = vec![0.0; mesh.positions.len()];
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            let [a, b, c] = mesh.corners(index);
            let area = 0.5 * (b - a).cross(c - a).length();
            triangle.iter().for_each(|&v| areas[v as usize] += area / 3.0);
        }
        let around = Neighbours::from_mesh(mesh);
        // Each neighbour occurs in two triangles.
        let links = (0..mesh.positions.len() as u32)
            .flat_map(|v| around.of_vertex(v).iter().map(move |&w| (v, w, 0.5)))
            .collect();
        let fixed = if creases.is_empty() { 0 } else { mesh.positions.len() as u32 };
        let fixed = (0..fixed).map(|v| Fixed::of_mesh(mesh, creases, &around, v)).collect();
        Self::new(mesh.positions.clone(), mesh.vertex_normals(), areas, fixed, links)
    }

    fn new(
        places: Vec<DVec3>,
        normals: Vec<DVec3>,
        areas: Vec<f64>,
        fixed: Vec<Option<Fixed>>,
        mut links: Vec<(u32, u32, f64)>,
    ) -> Self {
        links.sort_unstable_by_key(|&(from, to, _)| (from, to));
        let mut starts = vec![0_u32; places.len() + 1];
        let mut neighbours: Vec<(u32, f64)> = Vec::with_capacity(links.len());
        for same in links.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let weight = same.iter().map(|link| link.2).sum();
            neighbours.push((same[0].1, weight));
            starts[same[0].0 as usize + 1] += 1;
        }
        for v in 0..places.len() {
            starts[v + 1] += starts[v];
        }
        let mut made = Self {
            places,
            normals,
            areas,
            fixed,
            starts,
            neighbours,
            groups: Vec::new(),
            parents: Vec::new(),
        };
        made.groups = groups(made.places.len(), |v| made.of_place(v).iter().map(|&(w, _)| w).collect());
        made
    }

    fn of_place(&self, v: usize) -> &[(u32, f64)] {
        &self.neighbours[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// The next level, in which pairs of neighbours with similar normals and areas are one place.
    fn coarser(&mut self) -> Self {
        let mut parents = vec![u32::MAX; self.places.len()];
        let (mut places, mut normals, mut areas) = (Vec::new(), Vec::new(), Vec::new());
        let mut fixed = Vec::new();
        let mut add = |members: &[usize]| {
            let area: f64 = members.iter().map(|&v| self.areas[v]).sum();
            let mean = |of: &[DVec3]| members.iter().map(|&v| self.areas[v] * of[v]).sum::<DVec3>();
            places.push(mean(&self.places) / area.max(f64::MIN_POSITIVE));
            normals.push(mean(&self.normals).try_normalize().unwrap_or(self.normals[members[0]]));
            areas.push(area);
            if !self.fixed.is_empty() {
                fixed.push(members.iter().map(|&v| self.fixed[v]).fold(None, Fixed::both));
            }
            areas.len() as u32 - 1
        };
        for [v, w] in self.pairs() {
            if parents[v] == u32::MAX && parents[w] == u32::MAX {
                parents[v] = add(&[v, w]);
                parents[w] = parents[v];
            }
        }
        for v in 0..parents.len() {
            if parents[v] == u32::MAX {
                parents[v] = add(&[v]);
            }
        }
        let links = (0..self.places.len())
            .flat_map(|v| self.of_place(v).iter().map(move |&(w, weight)| (v, w, weight)))
            .map(|(v, w, weight)| (parents[v], parents[w as usize], weight))
            .filter(|(v, w, _)| v != w)
            .collect();
        self.parents = parents;
        Self::new(places, normals, areas, fixed, links)
    }

    /// Pairs of neighbours, the most similar ones first.
    fn pairs(&self) -> Vec<[usize; 2]> {
        let similarity = |v: usize, w: usize| {
            let [small, large] = [self.areas[v].min(self.areas[w]), self.areas[v].max(self.areas[w])];
            self.normals[v].dot(self.normals[w]) * small / large.max(f64::MIN_POSITIVE)
        };
        let mut pairs: Vec<(f64, [usize; 2])> = (0..self.places.len())
            .flat_map(|v| self.of_place(v).iter().map(move |&(w, _)| [v, w as usize]))
            .filter(|[v, w]| v < w)
            .map(|[v, w]| (similarity(v, w), [v, w]))
            .collect();
        pairs.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        pairs.into_iter().map(|(_, pair)| pair).collect()
    }

    fn lattices(&self, side: f64) -> Vec<Lattice> {
        let lattice = |v: usize| {
            let (at, normal) = (self.places[v], self.normals[v]);
            Lattice { at, normal, direction: tangents(normal).0, position: at, side }
        };
        let mut made: Vec<Lattice> = (0..self.places.len()).map(lattice).collect();
        self.fix_directions(&mut made);
        self.fix_positions(&mut made);
        made
    }

    fn fixed(&self, v: usize) -> Option<Fixed> {
        self.fixed.get(v).copied().flatten()
    }

    fn fix_directions(&self, lattices: &mut [Lattice]) {
        for (lattice, fixed) in lattices.iter_mut().zip(&self.fixed) {
            if let Some(along) = fixed.and_then(|fixed| fixed.direction) {
                lattice.point_along(along);
            }
        }
    }

    fn fix_positions(&self, lattices: &mut [Lattice]) {
        for (lattice, fixed) in lattices.iter_mut().zip(&self.fixed) {
            if let Some(fixed) = fixed {
                fixed.fix_position(lattice);
            }
        }
    }

    fn smooth_directions(&self, lattices: &mut [Lattice]) {
        self.smooth(lattices, |lattices, v| {
            let mut own = lattices[v];
            let mut total = 0.0;
            if self.fixed(v).is_some_and(|fixed| fixed.direction.is_some()) {
                return own;
            }
            for &(w, weight) in self.of_place(v) {
                // At a corner, creases have no direction in common.
                if self.fixed(w as usize).is_some_and(|fixed| fixed.direction.is_none()) {
                    continue;
                }
                let [a, b] = own.agreeing_directions(&lattices[w as usize]);
                own.point_along(total * a + weight * b);
                total += weight;
            }
            own
        });
    }

    fn smooth_positions(&self, lattices: &mut [Lattice]) {
        self.smooth(lattices, |lattices, v| {
            let mut own = lattices[v];
            let mut total = 0.0;
            let fixed = self.fixed(v);
            if fixed.is_some_and(|fixed| fixed.is_corner) {
                return own;
            }
            for &(w, weight) in self.of_place(v) {
                let other = &lattices[w as usize];
                let [here, there] = own.coinciding(other);
                let [a, b] = [own.position_at(here), other.position_at(there)];
                own.position = own.on_plane((total * a + weight * b) / (total + weight));
                total += weight;
            }
            if let Some(fixed) = fixed {
                fixed.fix_position(&mut own);
            }
            own.nearest()
        });
    }

    /// Replaces each lattice in turn. Those that are no neighbours go together, so the result does not
    /// depend on the number of threads.
    fn smooth(&self, lattices: &mut [Lattice], replaced: impl Fn(&[Lattice], usize) -> Lattice + Sync) {
        for _ in 0..ROUNDS {
            for group in &self.groups {
                let new: Vec<Lattice> =
                    group.par_iter().with_min_len(256).map(|&v| replaced(lattices, v as usize)).collect();
                group.iter().zip(new).for_each(|(&v, lattice)| lattices[v as usize] = lattice);
            }
        }
    }
}

/// Groups of places of which no two are neighbours, the first that is possible for each in turn.
fn groups(count: usize, neighbours: impl Fn(usize) -> Vec<u32>) -> Vec<Vec<u32>> {
    let mut group_of = vec![usize::MAX; count];
    let mut groups: Vec<Vec<u32>> = Vec::new();
    for v in 0..count {
        let taken: Vec<usize> = neighbours(v).into_iter().map(|w| group_of[w as usize]).collect();
        let own = (0..groups.len()).find(|group| !taken.contains(group)).unwrap_or(groups.len());
        if own == groups.len() {
            groups.push(Vec::new());
        }
        groups[own].push(v as u32);
        group_of[v] = own;
    }
    groups
}
