//! A mesh whose edges run along creases.
//!
//! Input: a mesh, the sides of its vertices, and the crossings of its edges. Output: the mesh with a vertex
//! at each crossing, of which short edges are collapsed and poor ones flipped.
//!
//! A triangle of which two edges cross gets an edge between the crossings; one of which three cross gets a
//! vertex where three sides meet. So creases become chains of edges, and the topology stays. Vertices of
//! creases then move along their line until they are even, the others on their side.
//!
//! Not guaranteed: that no triangle is turned over; [`SharpMesh::turned_over`] counts them.

use super::crossings::{Crossings, NONE};
use super::patch::{Patch, meeting};
use crate::layout::CreasedMesh;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::TriangleMesh;
use std::collections::{BTreeSet, HashMap};

/// Vertices of creases closer than this are merged, as a share of the spacing, and others with them.
const SHORT_CREASE: f64 = 0.55;
const SHORT: f64 = 0.35;
/// Rounds in which vertices of creases are made even, and rounds of flips, collapses and moves.
const CREASE_ROUNDS: usize = 6;
const ROUNDS: usize = 5;
/// Quality that a collapse or a move may not lower, and least gain of a flip. An even triangle has 1.
const MIN_QUALITY: f64 = 0.12;
const MIN_GAIN: f64 = 0.03;
/// Edges of faces that are turned over are collapsed if they are shorter than this many spacings.
const UNTANGLED: f64 = 1.5;
/// A face changes its side if the cosine between that of its corners and the new one is larger by this.
const MIN_AGREEMENT_GAIN: f64 = 0.1;
/// Rounds in which faces that are turned over are repaired.
const UNTANGLING_ROUNDS: usize = 6;
/// A vertex moves at most this many spacings to its patch.
const MAX_MOVE: f64 = 1.2;
/// Where three sides meet at most this far from the crossings, in spacings, there is a corner.
const MAX_CORNER_MOVE: f64 = 2.0;

/// The sides that a vertex or face lies on, as numbers of patches: one, two on a crease, three at a corner.
pub(super) type Sides = [u32; 3];

/// A mesh that changes, with sides.
pub(super) struct SharpMesh {
    patches: Vec<Patch>,
    spacing: f64,
    pub(super) at: Vec<DVec3>,
    sides: Vec<Sides>,
    /// Faces; those that are gone have [`NONE`] as first corner.
    faces: Vec<[u32; 3]>,
    side_of_face: Vec<u32>,
    /// Faces of each vertex.
    around: Vec<Vec<u32>>,
    /// Neighbours along creases.
    creases: Vec<BTreeSet<u32>>,
}

impl SharpMesh {
    /// Inserts vertices at crossings. `own` holds the patch of each vertex, or [`NONE`].
    pub(super) fn new(
        mesh: &TriangleMesh,
        own: &[u32],
        mut patches: Vec<Patch>,
        crossings: &Crossings,
        spacing: f64,
    ) -> Self {
        let mut at = mesh.positions.clone();
        let mut sides: Vec<Sides> = own.iter().map(|&i| [i, NONE, NONE]).collect();
        let mut keys: Vec<[u32; 2]> = crossings.keys().copied().collect();
        keys.sort_unstable();
        let mut inserted: HashMap<[u32; 2], u32> = HashMap::new();
        for key in keys {
            let crossing = &crossings[&key];
            inserted.insert(key, at.len() as u32);
            at.push(crossing.point);
            let first = patches.len() as u32;
            patches.extend(crossing.patches);
            sides.push([first, first + 1, NONE]);
        }
        let vertices = at.len();
        let mut made = Self {
            patches,
            spacing,
            at,
            sides,
            faces: Vec::new(),
            side_of_face: Vec::new(),
            around: vec![Vec::new(); vertices],
            creases: vec![BTreeSet::new(); vertices],
        };
        for &triangle in &mesh.triangles {
            let middle = |k: usize| {
                let [a, b] = [triangle[k], triangle[(k + 1) % 3]];
                inserted.get(&[a.min(b), a.max(b)]).copied()
            };
            made.insert(triangle, [middle(0), middle(1), middle(2)]);
        }
        made
    }

    fn add(&mut self, face: [u32; 3], side: u32) {
        let number = self.faces.len() as u32;
        face.iter().for_each(|&v| self.around[v as usize].push(number));
        self.faces.push(face);
        self.side_of_face.push(side);
    }

    /// Makes an edge a crease.
    pub(super) fn join(&mut self, a: u32, b: u32) {
        self.creases[a as usize].insert(b);
        self.creases[b as usize].insert(a);
    }

    /// Adds the parts of a triangle with crossings of some of its edges.
    fn insert(&mut self, [a, b, c]: [u32; 3], crossings: [Option<u32>; 3]) {
        let side = |v: u32, own: &[Sides]| own[v as usize][0];
        let [of_a, of_b, of_c] = [a, b, c].map(|v| side(v, &self.sides));
        match crossings {
            [None, None, None] => self.add([a, b, c], of_a),
            [Some(x), None, None] => {
                self.add([a, x, c], of_a);
                self.add([x, b, c], of_b);
            }
            [Some(x), Some(y), None] => {
                self.add([x, b, y], of_b);
                let length = |p: u32, q: u32| self.at[p as usize].distance(self.at[q as usize]);
                if length(a, y) < length(x, c) {
                    self.add([a, x, y], of_a);
                    self.add([a, y, c], of_a);
                } else {
                    self.add([a, x, c], of_a);
                    self.add([x, y, c], of_c);
                }
                self.join(x, y);
            }
            [Some(x), Some(y), Some(z)] => {
                let center = self.add_corner([a, b, c], [x, y, z]);
                for (corner, before, after, own) in [(a, z, x, of_a), (b, x, y, of_b), (c, y, z, of_c)] {
                    self.add([corner, after, center], own);
                    self.add([corner, center, before], own);
                    self.join(after, center);
                }
            }
            // The others are these, with another first corner.
            [x, y, z] => self.insert([b, c, a], [y, z, x]),
        }
    }

    fn add_corner(&mut self, corners: [u32; 3], crossings: [u32; 3]) -> u32 {
        let middle = crossings.map(|v| self.at[v as usize]).iter().sum::<DVec3>() / 3.0;
        // Patches that were fitted again at the crossings are better than those of the corners.
        let of_crossing = |k: usize| {
            let [x, before] = [crossings[k], crossings[(k + 2) % 3]];
            let own = self.sides[corners[k] as usize][0];
            let normal = self.patches[own as usize].distance(self.at[corners[k] as usize]).1;
            let towards = |i: &u32| self.patches[*i as usize].distance(middle).1.dot(normal);
            let mut all: Vec<u32> =
                [x, before].iter().flat_map(|&v| self.sides[v as usize][..2].to_vec()).collect();
            all.sort_by(|i, j| towards(j).total_cmp(&towards(i)));
            all[0]
        };
        let sides = [0, 1, 2].map(of_crossing);
        let patches = sides.map(|i| self.patches[i as usize]);
        let found = meeting(&patches, middle).filter(|p| p.distance(middle) < MAX_CORNER_MOVE * self.spacing);
        let number = self.at.len() as u32;
        self.at.push(found.unwrap_or(middle));
        self.sides.push(if found.is_some() { sides } else { [NONE; 3] });
        self.around.push(Vec::new());
        self.creases.push(BTreeSet::new());
        number
    }

    /// Moves vertices to their sides, and makes the mesh even.
    pub(super) fn improve(&mut self) {
        for v in 0..self.at.len() {
            if self.creases[v].is_empty()
                && let Some(placed) = self.placed(v, self.at[v])
            {
                self.at[v] = placed;
            }
        }
        self.close_gaps();
        self.place_corners();
        for _ in 0..CREASE_ROUNDS {
            self.even_out_creases();
        }
        self.correct_sides();
        for _ in 0..ROUNDS {
            self.flip_all();
            self.collapse_all();
            self.move_all();
            self.untangle();
        }
        for _ in 0..UNTANGLING_ROUNDS {
            if self.turned_over() == 0 {
                break;
            }
            self.smooth_turned();
            self.flip_all();
            self.untangle();
        }
    }

    /// Puts faces on the side that all of their corners have.
    ///
    /// A face between two crossings of one edge of the mesh may have got the side beyond the crease. If it is
    /// turned over, it does not seem to be, because the wrong side is nearly across it.
    fn correct_sides(&mut self) {
        for f in 0..self.faces.len() {
            let face = self.faces[f];
            if face[0] == NONE {
                continue;
            }
            let middle = face.map(|v| self.at[v as usize]).iter().sum::<DVec3>() / 3.0;
            let normal = |i: u32| self.patches[i as usize].distance(middle).1;
            let corners: Vec<Vec<DVec3>> = face
                .iter()
                .map(|&v| self.sides[v as usize].iter().filter(|i| **i != NONE).map(|&i| normal(i)).collect())
                .filter(|own: &Vec<DVec3>| !own.is_empty())
                .collect();
            // The least agreement of all corners with a side.
            let agreement = |i: u32| {
                let own = normal(i);
                let of_corner = |sides: &Vec<DVec3>| sides.iter().map(|n| n.dot(own)).fold(-1.0, f64::max);
                corners.iter().map(of_corner).fold(1.0, f64::min)
            };
            let candidates = face.iter().flat_map(|&v| self.sides[v as usize]).filter(|i| *i != NONE);
            let best = candidates.map(|i| (agreement(i), i)).max_by(|x, y| x.0.total_cmp(&y.0));
            let side = self.side_of_face[f];
            let now = if side == NONE { -1.0 } else { agreement(side) };
            if let Some((most, best)) = best.filter(|(most, _)| *most > now + MIN_AGREEMENT_GAIN)
                && most > 0.0
            {
                self.side_of_face[f] = best;
            }
        }
    }

    /// Moves vertices of creases towards the middle of their neighbours, along their line.
    ///
    /// Crossings of edges that are close to each other may follow on the line in the wrong order.
    fn even_out_creases(&mut self) {
        for v in 0..self.at.len() {
            if let Some(placed) = self.middle_on_crease(v) {
                self.at[v] = placed;
            }
        }
    }

    fn middle_on_crease(&self, v: usize) -> Option<DVec3> {
        let near: Vec<DVec3> = self.creases[v].iter().map(|&w| self.at[w as usize]).collect();
        match near[..] {
            [a, b] => self.placed(v, 0.5 * self.at[v] + 0.25 * (a + b)),
            _ => None,
        }
    }

    /// The point on the sides of a vertex near `p`, if it is not far.
    fn placed(&self, v: usize, p: DVec3) -> Option<DVec3> {
        self.on_sides(self.sides[v], p, MAX_MOVE)
    }

    /// The point near `p` on some sides, if it is at most so many spacings away.
    pub(super) fn on_sides(&self, sides: Sides, p: DVec3, longest: f64) -> Option<DVec3> {
        let numbers = sides.iter().filter(|i| **i != NONE);
        let patches: Vec<Patch> = numbers.map(|&i| self.patches[i as usize]).collect();
        let placed = match patches[..] {
            [] => return None,
            [patch] => patch.foot(p),
            _ => meeting(&patches, p)?,
        };
        (placed.is_finite() && placed.distance(p) < longest * self.spacing).then_some(placed)
    }

    /// Neighbours of a vertex along creases.
    pub(super) fn creases(&self, v: u32) -> &BTreeSet<u32> {
        &self.creases[v as usize]
    }

    /// The sides of a vertex.
    pub(super) fn sides(&self, v: u32) -> Sides {
        self.sides[v as usize]
    }

    /// Moves a vertex to other sides, at most so many spacings away.
    pub(super) fn put_on(&mut self, v: u32, sides: Sides, longest: f64) {
        if let Some(placed) = self.on_sides(sides, self.at[v as usize], longest) {
            (self.at[v as usize], self.sides[v as usize]) = (placed, sides);
        }
    }

    /// Moves a vertex to a point of some sides.
    pub(super) fn move_to(&mut self, v: u32, point: DVec3, sides: Sides) {
        (self.at[v as usize], self.sides[v as usize]) = (point, sides);
    }

    /// Two sides and the one of others that is most unlike them; none if a side is not known.
    pub(super) fn corner_of(
        &self,
        [a, b]: [u32; 2],
        others: impl Iterator<Item = u32>,
        near: DVec3,
    ) -> Option<Sides> {
        let normal = |i: u32| self.patches[i as usize].distance(near).1;
        let agreement = |i: u32| [a, b].iter().map(|&j| normal(i).dot(normal(j))).fold(-1.0, f64::max);
        if a == NONE || b == NONE {
            return None;
        }
        let third = others.filter(|i| *i != NONE).map(|i| (agreement(i), i));
        third.min_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, third)| [a, b, third])
    }

    /// Spacing of the readings, or more where noise is strong.
    pub(super) fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Twice the area over that of an even triangle with edges of the same squared length, negative if the
    /// triangle is turned over.
    fn quality(&self, face: [u32; 3], side: u32) -> f64 {
        let [a, b, c] = face.map(|v| self.at[v as usize]);
        let area = (b - a).cross(c - a);
        let signed = match side {
            NONE => area.length(),
            side => {
                let normal = self.patches[side as usize].distance((a + b + c) / 3.0).1;
                area.dot(normal)
            }
        };
        let squares = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
        2.0 * 3.0_f64.sqrt() * signed / squares.max(f64::MIN_POSITIVE)
    }

    fn star(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        self.around[v as usize].iter().copied()
    }

    /// Neighbours of a vertex.
    pub(super) fn neighbours(&self, v: u32) -> Vec<u32> {
        // The face after each neighbour has another one, so each occurs once as the next corner.
        self.star(v).map(|f| self.after(f, v)).collect()
    }

    /// The corner after `v` in a face.
    fn after(&self, f: u32, v: u32) -> u32 {
        let face = self.faces[f as usize];
        let k = face.iter().position(|&w| w == v).unwrap_or(0);
        face[(k + 1) % 3]
    }

    fn edges(&self) -> Vec<(u32, u32)> {
        let mut all: Vec<(u32, u32)> = self
            .faces
            .iter()
            .filter(|face| face[0] != NONE)
            .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
            .filter(|(a, b)| a < b)
            .collect();
        all.sort_unstable();
        all
    }

    /// The face at the left of a directed edge.
    fn left(&self, a: u32, b: u32) -> Option<u32> {
        self.star(a).find(|&f| self.after(f, a) == b)
    }

    fn worst(&self, faces: impl Iterator<Item = u32>) -> f64 {
        faces.map(|f| self.quality(self.faces[f as usize], self.side_of_face[f as usize])).fold(1.0, f64::min)
    }

    fn flip_all(&mut self) {
        for (a, b) in self.edges() {
            self.flip(a, b);
        }
    }

    fn flip(&mut self, a: u32, b: u32) {
        if self.creases[a as usize].contains(&b) {
            return;
        }
        let (Some(f), Some(g)) = (self.left(a, b), self.left(b, a)) else { return };
        let (c, d) = (self.after(f, b), self.after(g, a));
        if c == d || self.left(c, d).is_some() || self.left(d, c).is_some() {
            return;
        }
        // (a, b, c) and (b, a, d) become (c, a, d) and (d, b, c).
        let [of_f, of_g] = [f, g].map(|f| self.side_of_face[f as usize]);
        let before = self.worst([f, g].into_iter());
        let after = self.quality([c, a, d], of_g).min(self.quality([d, b, c], of_f));
        if after < before + MIN_GAIN {
            return;
        }
        self.faces[f as usize] = [d, b, c];
        self.faces[g as usize] = [c, a, d];
        self.around[a as usize].retain(|&x| x != f);
        self.around[b as usize].retain(|&x| x != g);
        self.around[c as usize].push(g);
        self.around[d as usize].push(f);
    }

    fn collapse_all(&mut self) {
        let length = |own: &Self, (a, b): (u32, u32)| own.at[a as usize].distance(own.at[b as usize]);
        let mut short: Vec<(f64, (u32, u32))> =
            self.edges().into_iter().map(|edge| (length(self, edge), edge)).collect();
        short.retain(|(own, _)| *own < SHORT_CREASE * self.spacing);
        short.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        for (_, (a, b)) in short {
            let _ = self.collapse_short(a, b) || self.collapse_short(b, a);
        }
    }

    /// Moves vertices of faces that are turned over to the mean of their neighbours, where that helps.
    fn smooth_turned(&mut self) {
        for f in 0..self.faces.len() {
            let face = self.faces[f];
            if face[0] == NONE || self.quality(face, self.side_of_face[f]) > 0.0 {
                continue;
            }
            for v in face {
                let near: Vec<u32> = match self.creases[v as usize].len() {
                    0 => self.neighbours(v),
                    2 => self.creases[v as usize].iter().copied().collect(),
                    _ => continue,
                };
                let sum = near.iter().map(|&w| self.at[w as usize]).sum::<DVec3>();
                let before = self.worst(self.star(v));
                let old = std::mem::replace(&mut self.at[v as usize], sum / near.len().max(1) as f64);
                if self.worst(self.star(v)) <= before {
                    self.at[v as usize] = old;
                }
            }
        }
    }

    fn collapse_short(&mut self, kept: u32, gone: u32) -> bool {
        let before = self.worst(self.star(gone));
        self.collapse(kept, gone, SHORT, MIN_QUALITY.min(before))
    }

    /// Collapses edges of faces that are turned over, where no face is turned over afterwards.
    fn untangle(&mut self) {
        for f in 0..self.faces.len() {
            let [a, b, c] = self.faces[f];
            if a == NONE || self.quality([a, b, c], self.side_of_face[f]) > 0.0 {
                continue;
            }
            let edges = [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)];
            let _ = edges.into_iter().any(|(kept, gone)| {
                let length = self.at[kept as usize].distance(self.at[gone as usize]);
                length < UNTANGLED * self.spacing && self.collapse(kept, gone, UNTANGLED, MIN_QUALITY)
            });
        }
    }

    /// Moves the vertex `gone` into `kept` if topology, creases and shape allow it. Vertices beside creases
    /// move at most `longest` spacings. Faces keep their quality, or have `least`.
    fn collapse(&mut self, kept: u32, gone: u32, longest: f64, least: f64) -> bool {
        let (Some(f), Some(g)) = (self.left(kept, gone), self.left(gone, kept)) else { return false };
        let length = self.at[kept as usize].distance(self.at[gone as usize]);
        let along = self.creases[gone as usize].contains(&kept);
        let is_on_crease = !self.creases[gone as usize].is_empty();
        if is_on_crease && (!along || self.creases[gone as usize].len() != 2) {
            return false;
        }
        let apexes = [self.after(f, gone), self.after(g, kept)];
        if apexes.iter().any(|x| self.creases[gone as usize].contains(x)) {
            return false;
        }
        if !is_on_crease && length > longest * self.spacing {
            return false;
        }
        let (mine, other) = (self.neighbours(gone), self.neighbours(kept));
        let common = mine.iter().filter(|w| other.contains(w)).count();
        if common != 2
            || mine.len() + other.len() <= 7
            || apexes.iter().any(|&x| self.around[x as usize].len() <= 3)
        {
            return false;
        }
        let moved: Vec<u32> = self.star(gone).filter(|&h| h != f && h != g).collect();
        let renamed = |own: &Self, h: u32| own.faces[h as usize].map(|v| if v == gone { kept } else { v });
        let after = moved
            .iter()
            .map(|&h| self.quality(renamed(self, h), self.side_of_face[h as usize]))
            .fold(1.0, f64::min);
        if after < least {
            return false;
        }
        for &h in &moved {
            self.faces[h as usize] = renamed(self, h);
            self.around[kept as usize].push(h);
        }
        for h in [f, g] {
            for v in self.faces[h as usize] {
                self.around[v as usize].retain(|&x| x != h);
            }
            self.faces[h as usize] = [NONE; 3];
        }
        self.around[gone as usize].clear();
        for w in std::mem::take(&mut self.creases[gone as usize]) {
            self.creases[w as usize].remove(&gone);
            if w != kept {
                self.join(w, kept);
            }
        }
        true
    }

    /// Vertices of creases move along them, then the others on their sides.
    fn move_all(&mut self) {
        for v in 0..self.at.len() {
            let placed = if self.creases[v].is_empty() {
                let near = self.neighbours(v as u32);
                let mean =
                    near.iter().map(|&w| self.at[w as usize]).sum::<DVec3>() / near.len().max(1) as f64;
                if near.is_empty() { None } else { self.placed(v, 0.5 * (self.at[v] + mean)) }
            } else {
                self.middle_on_crease(v)
            };
            let Some(placed) = placed else { continue };
            let before = self.worst(self.star(v as u32));
            let old = std::mem::replace(&mut self.at[v], placed);
            if self.worst(self.star(v as u32)) < MIN_QUALITY.min(before) {
                self.at[v] = old;
            }
        }
    }

    /// Faces that are turned against their side.
    pub(super) fn turned_over(&self) -> usize {
        let faces = self.faces.iter().zip(&self.side_of_face);
        faces
            .filter(|(face, _)| face[0] != NONE)
            .filter(|(face, side)| self.quality(**face, **side) <= 0.0)
            .count()
    }

    /// The mesh and its creases, numbered anew.
    ///
    /// # Errors
    /// As for [`TriangleMesh::try_new`].
    pub(super) fn into_mesh(self) -> Result<CreasedMesh> {
        let mut number = vec![NONE; self.at.len()];
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for face in self.faces.iter().filter(|face| face[0] != NONE) {
            triangles.push(face.map(|v| {
                let own = &mut number[v as usize];
                if *own == NONE {
                    *own = positions.len() as u32;
                    positions.push(self.at[v as usize]);
                }
                *own
            }));
        }
        let mut creases: Vec<[u32; 2]> = Vec::new();
        for (&from, others) in number.iter().zip(&self.creases) {
            creases.extend(others.iter().map(|&w| [from, number[w as usize]]).filter(|[a, b]| a < b));
        }
        creases.sort_unstable();
        Ok(CreasedMesh { mesh: TriangleMesh::try_new(positions, triangles)?, creases, corners: Vec::new() })
    }
}
