//! A closed mesh of triangles and quads that changes and stays a manifold.

use planish_core::DVec3;
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

/// A triangle or quad, with counter-clockwise corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Face {
    corners: [u32; 4],
    count: usize,
}

impl Face {
    pub(super) fn triangle([a, b, c]: [u32; 3]) -> Self {
        Self { corners: [a, b, c, u32::MAX], count: 3 }
    }

    pub(super) fn quad(corners: [u32; 4]) -> Self {
        Self { corners, count: 4 }
    }

    pub(super) fn corners(&self) -> &[u32] {
        &self.corners[..self.count]
    }

    pub(super) fn is_triangle(&self) -> bool {
        self.count == 3
    }

    /// Directed edges.
    pub(super) fn edges(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        (0..self.count).map(|k| (self.corners[k], self.corners[(k + 1) % self.count]))
    }

    /// The corners in order from a given one on.
    pub(super) fn corners_from(&self, first: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.corners().iter().position(|&v| v == first).unwrap_or(0);
        (0..self.count).map(move |k| self.corners[(start + k) % self.count])
    }

    /// The face with one vertex in the place of another.
    pub(super) fn renamed(mut self, old: u32, new: u32) -> Self {
        self.corners = self.corners.map(|v| if v == old { new } else { v });
        self
    }

    fn is_proper(&self) -> bool {
        let corners = self.corners();
        (0..self.count).all(|k| !corners[..k].contains(&corners[k]))
    }
}

/// A map from directed edges.
pub(super) type EdgeMap<T> = HashMap<(u32, u32), T, BuildHasherDefault<EdgeHasher>>;

/// Hashes pairs of numbers of vertices. They come from no one who could choose them to collide.
#[derive(Default)]
pub(super) struct EdgeHasher(u64);

impl Hasher for EdgeHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u32(byte.into()));
    }

    fn write_u32(&mut self, number: u32) {
        // An odd factor near 2⁶⁴ divided by the golden ratio spreads numbers over the upper bits.
        self.0 = (self.0.rotate_left(26) ^ u64::from(number)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }
}

/// Faces whose vertices are numbered anew in the order of their use, and the positions of those in use.
/// Numbers without a position become [`u32::MAX`].
pub(super) fn renumbered<const N: usize>(
    faces: impl Iterator<Item = [u32; N]>,
    positions: &[DVec3],
) -> (Vec<[u32; N]>, Vec<DVec3>) {
    let (faces, positions, _) = renumbered_with_numbers(faces, positions);
    (faces, positions)
}

/// The same, and the new number of each vertex: [`u32::MAX`] if it is not used.
pub(super) fn renumbered_with_numbers<const N: usize>(
    faces: impl Iterator<Item = [u32; N]>,
    positions: &[DVec3],
) -> (Vec<[u32; N]>, Vec<DVec3>, Vec<u32>) {
    let mut number = vec![u32::MAX; positions.len()];
    let mut used = Vec::new();
    let mut new = |v: u32| {
        let Some(own) = number.get_mut(v as usize) else { return u32::MAX };
        if *own == u32::MAX {
            *own = used.len() as u32;
            used.push(positions[v as usize]);
        }
        *own
    };
    let faces = faces.map(|corners| corners.map(&mut new)).collect();
    (faces, used, number)
}

/// The faces of a closed manifold.
#[derive(Clone)]
pub(super) struct Faces {
    faces: Vec<Option<Face>>,
    count: usize,
    /// Neighbours of each vertex. They are few, so a search among them is faster than a map of edges.
    around: Vec<Vec<u32>>,
    /// The face at the left of the edge to each neighbour, in the same order.
    left: Vec<Vec<u32>>,
}

impl Faces {
    /// Triangles of a closed oriented manifold.
    pub(super) fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut own = Self {
            faces: Vec::with_capacity(triangles.len()),
            count: 0,
            around: vec![Vec::new(); vertices],
            left: vec![Vec::new(); vertices],
        };
        triangles.iter().for_each(|&triangle| {
            own.add(Face::triangle(triangle));
        });
        own
    }

    fn add(&mut self, face: Face) -> u32 {
        let number = self.faces.len() as u32;
        for (a, b) in face.edges() {
            self.around[a as usize].push(b);
            self.left[a as usize].push(number);
        }
        self.faces.push(Some(face));
        self.count += 1;
        number
    }

    /// The place of a neighbour among those of a vertex.
    fn place(&self, a: u32, b: u32) -> Option<usize> {
        self.around[a as usize].iter().position(|&w| w == b)
    }

    fn remove(&mut self, number: u32) {
        let Some(face) = self.faces[number as usize].take() else { return };
        self.count -= 1;
        for (a, b) in face.edges() {
            if let Some(place) = self.place(a, b) {
                self.around[a as usize].remove(place);
                self.left[a as usize].remove(place);
            }
        }
    }

    /// Puts faces in the place of others and returns the number of the first. None, without a change, if the
    /// border would not be the same, an edge had more than two faces, or a face a corner twice.
    pub(super) fn replace(&mut self, old: &[u32], new: &[Face]) -> Option<u32> {
        let sorted = |mut all: Vec<(u32, u32)>| {
            all.sort_unstable();
            all
        };
        let mut before = Vec::with_capacity(4 * old.len());
        old.iter().filter_map(|&f| self.face(f)).for_each(|face| before.extend(face.edges()));
        let before = sorted(before);
        let after = sorted(new.iter().flat_map(Face::edges).collect());
        let has = |all: &[(u32, u32)], edge| all.binary_search(&edge).is_ok();
        let on_border = |all: &[(u32, u32)], &(a, b): &(u32, u32)| !has(all, (b, a));
        let is_manifold = new.iter().all(Face::is_proper)
            && after.windows(2).all(|pair| pair[0] != pair[1])
            && after.iter().all(|edge| has(&before, *edge) || !self.are_joined(edge.0, edge.1))
            && (before.iter().filter(|edge| on_border(&before, edge)))
                .eq(after.iter().filter(|edge| on_border(&after, edge)));
        if !is_manifold {
            return None;
        }
        old.iter().for_each(|&f| self.remove(f));
        new.iter().map(|face| self.add(*face)).min()
    }

    pub(super) fn face(&self, number: u32) -> Option<Face> {
        self.faces[number as usize]
    }

    /// All faces with their numbers.
    pub(super) fn all(&self) -> impl Iterator<Item = (u32, Face)> + '_ {
        (0..).zip(&self.faces).filter_map(|(number, face)| face.map(|face| (number, face)))
    }

    pub(super) fn count(&self) -> usize {
        self.count
    }

    pub(super) fn has_triangles(&self) -> bool {
        self.all().any(|(_, face)| face.is_triangle())
    }

    /// The corners of all faces and the positions of their vertices, numbered anew. Triangles have
    /// [`u32::MAX`] as their fourth corner.
    /// The third list has the new number of each vertex.
    pub(super) fn numbered(&self, positions: &[DVec3]) -> (Vec<[u32; 4]>, Vec<DVec3>, Vec<u32>) {
        renumbered_with_numbers(self.all().map(|(_, face)| face.corners), positions)
    }

    /// A new vertex without faces.
    pub(super) fn add_vertex(&mut self) -> u32 {
        self.around.push(Vec::new());
        self.left.push(Vec::new());
        self.around.len() as u32 - 1
    }

    /// The faces around a vertex, with their numbers.
    pub(super) fn around(&self, v: u32) -> impl Iterator<Item = (u32, Face)> + '_ {
        self.left[v as usize].iter().filter_map(move |&number| Some((number, self.face(number)?)))
    }

    /// The face at the left of an edge, with its number.
    pub(super) fn left_of(&self, a: u32, b: u32) -> Option<(u32, Face)> {
        let number = self.left[a as usize][self.place(a, b)?];
        self.face(number).map(|face| (number, face))
    }

    pub(super) fn are_joined(&self, a: u32, b: u32) -> bool {
        self.around[a as usize].contains(&b)
    }

    /// Edges in ascending order, from the smaller end to the larger one.
    pub(super) fn edges(&self) -> Vec<(u32, u32)> {
        let mut all = Vec::with_capacity(self.count * 2);
        for (a, neighbours) in (0_u32..).zip(&self.around) {
            let first = all.len();
            all.extend(neighbours.iter().filter(|b| a < **b).map(|&b| (a, b)));
            all[first..].sort_unstable();
        }
        all
    }

    /// Neighbours of a vertex, in no particular order.
    pub(super) fn neighbours(&self, v: u32) -> &[u32] {
        &self.around[v as usize]
    }

    /// Neighbours of a vertex counter-clockwise from one of them on.
    pub(super) fn neighbours_in_order(&self, v: u32, first: u32) -> Vec<u32> {
        let after = |w: &u32| self.left_of(v, *w).and_then(|(_, face)| face.corners_from(v).last());
        let all = std::iter::successors(Some(first), |w| after(w).filter(|next| *next != first));
        all.take(self.valence(v)).collect()
    }

    pub(super) fn valence(&self, v: u32) -> usize {
        self.around[v as usize].len()
    }

    /// Vertices that are neighbours of both.
    pub(super) fn common_neighbours(&self, a: u32, b: u32) -> Vec<u32> {
        self.neighbours(a).iter().copied().filter(|&w| self.are_joined(b, w)).collect()
    }

    /// Moves all faces of a vertex to another one. Faces that contain both vanish.
    ///
    /// The caller ensures that both have no other common neighbours than the faces between them.
    pub(super) fn merge_into(&mut self, kept: u32, gone: u32) -> bool {
        let star: Vec<(u32, Face)> = self.around(gone).collect();
        let old: Vec<u32> = star.iter().map(|(number, _)| *number).collect();
        let rest = star.iter().filter(|(_, face)| !face.corners().contains(&kept));
        let new: Vec<Face> = rest.map(|(_, face)| face.renamed(gone, kept)).collect();
        !new.is_empty() && self.replace(&old, &new).is_some()
    }

    /// Both faces at an edge. None if there is no such edge.
    pub(super) fn sides(&self, (a, b): (u32, u32)) -> Option<Sides> {
        let (Some((left, first)), Some((right, second))) = (self.left_of(a, b), self.left_of(b, a)) else {
            return None;
        };
        let others = second.corners_from(a).skip(1).take(second.count - 2);
        Some(Sides { faces: [left, right], corners: first.corners_from(b).chain(others).collect() })
    }
}

/// Two faces at an edge from `a` to `b`.
pub(super) struct Sides {
    /// The face at the left of the edge, and the other one.
    pub(super) faces: [u32; 2],
    /// The corners of both, counter-clockwise from `b` on. Those of the left face come first, up to `a`.
    pub(super) corners: Vec<u32>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::icosphere;

    /// A change that would give an edge three faces, or open the surface, is refused and changes nothing.
    #[test]
    fn changes_keep_a_closed_manifold() {
        let mesh = icosphere(1.0, 2);
        let mut faces = Faces::new(&mesh.triangles, mesh.positions.len());
        let count = faces.all().count();
        let [a, b, c] = mesh.triangles[0];
        assert_eq!(faces.replace(&[0], &[]), None);
        assert_eq!(faces.replace(&[0], &[Face::triangle([a, c, b])]), None);
        assert_eq!(faces.all().count(), count);
        let both = faces.sides((a, b)).unwrap();
        let new = Face::quad(both.corners.try_into().unwrap());
        assert!(faces.replace(&both.faces, &[new]).is_some());
        assert_eq!(faces.all().count(), count - 1);
        let gone = faces.neighbours(c)[0];
        if faces.common_neighbours(c, gone).len() == 2 {
            assert!(faces.merge_into(c, gone));
            assert_eq!(faces.valence(gone), 0);
        }
    }
}
