//! Quads from triangles, with as few extraordinary vertices as local changes reach.
//!
//! Pairs of triangles become quads. The triangles that are left are moved through quads until two meet: a
//! triangle and a quad are a pentagon, which can be divided into a quad and a triangle at any other side. A
//! closed surface has an even number of them. Then vertices of two quads are removed, quads are collapsed and
//! edges are turned where that brings the numbers of quads at vertices nearer to four. Creases stay as they
//! are, and at vertices on them the numbers of quads between two creases count.
//!
//! # References
//! Tarini, Pietroni, Cignoni, Panozzo, Puppo, *Practical quad mesh simplification*, Computer Graphics Forum
//! 29, 2010: the local changes.

use super::creases::{CreaseEdges, CurveSide, Fan, FanTargets, STRAIGHT_QUAD, VertexKind};
use super::decimation::Decimation;
use super::faces::{Face, Faces};
use planish_core::DVec3;
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::f64::consts::{FRAC_PI_2, PI};

/// Largest deviation of a corner of a quad from a right angle.
const MAX_SKEW: f64 = 1.2;
/// The same for quads beside a turned edge.
const MAX_SKEW_TURNED: f64 = 1.5;
/// Smallest angle at which a corner of a quad on a smooth crease is straight.
const MIN_STRAIGHT: f64 = 5.0 / 6.0 * PI;
/// Faces of all trials to remove straight corners, at most: each trial passes over all faces.
const MAX_TRIED_FACES: usize = 40_000;

type Edge = (u32, u32);
/// For each face, the triangle from which it was reached, and the face and edge before it.
type Reached = HashMap<u32, (u32, Option<(u32, Edge)>)>;

/// Turns all triangles into quads. False if some are left.
pub(super) fn pair(coarse: &mut Decimation, targets: &FanTargets, at: &mut Vec<DVec3>) -> bool {
    let faces = &coarse.faces;
    let mut pairs: Vec<(bool, f64, Edge)> = Vec::new();
    for edge in faces.edges().into_iter().filter(|&edge| !coarse.creases.has(edge)) {
        let Some(both) = faces.sides(edge) else { continue };
        let own = skew(&both.corners, at);
        let is_diagonal = coarse.is_diagonal(edge);
        if is_diagonal || own < MAX_SKEW {
            pairs.push((!is_diagonal, own, edge));
        }
    }
    pairs.sort_unstable_by(|x, y| (x.0.cmp(&y.0)).then(x.1.total_cmp(&y.1)).then(x.2.cmp(&y.2)));
    let faces = &mut coarse.faces;
    for (_, _, edge) in pairs {
        join(faces, edge);
    }
    Quads { faces, creases: &mut coarse.creases, targets }.meet(at)
}

/// Makes a quad of two triangles at an edge.
fn join(faces: &mut Faces, edge: Edge) -> bool {
    let Some(both) = faces.sides(edge) else { return false };
    let Ok(corners) = both.corners.try_into() else { return false };
    faces.replace(&both.faces, &[Face::quad(corners)]).is_some()
}

/// Largest deviation of the four corners of a quad from right angles.
fn skew(corners: &[u32], at: &[DVec3]) -> f64 {
    let [a, b, c, d] = [0, 1, 2, 3].map(|k| at[corners[k] as usize]);
    let normal = (c - a).cross(d - b).normalize_or_zero();
    let angle = |before: DVec3, own: DVec3, after: DVec3| {
        let (x, y) = (after - own, before - own);
        (x.cross(y).dot(normal).atan2(x.dot(y)) - FRAC_PI_2).abs()
    };
    angle(d, a, b).max(angle(a, b, c)).max(angle(b, c, d)).max(angle(c, d, a))
}

impl Quads<'_> {
    /// Moves triangles until they meet in pairs. False if some are left.
    ///
    /// They cross creases only if they can not meet otherwise: a region between creases has an odd number of
    /// them if its border has an odd number of edges.
    fn meet(&mut self, at: &mut Vec<DVec3>) -> bool {
        for crosses_creases in [false, true] {
            if crosses_creases && self.creases.is_empty() {
                break;
            }
            let mut blocked: HashSet<Edge> = HashSet::new();
            if !crosses_creases {
                blocked.extend(self.creases.sides.keys());
            }
            while let Some(mut path) = shortest_path(self.faces, &blocked) {
                for k in 0..path.len() {
                    let (edge, next) = (path[k], path.get(k + 1).copied());
                    let is_moved = match next {
                        _ if self.creases.has(edge) => self.cross_crease(at, edge, &mut path[k + 1..]),
                        None => join(self.faces, edge),
                        Some(next) => move_triangle(self.faces, at, edge, next),
                    };
                    if !is_moved {
                        // Another path avoids this edge.
                        blocked.insert(edge);
                        break;
                    }
                }
            }
        }
        !self.faces.has_triangles()
    }

    /// Moves a triangle across a crease: with one vertex less or one more on it, whichever makes numbers of
    /// quads better.
    fn cross_crease(&mut self, at: &mut Vec<DVec3>, edge: Edge, rest: &mut [Edge]) -> bool {
        let Some(both) = self.faces.sides(edge) else { return false };
        let fans = |v: u32| both.faces.map(|face| self.fan(v, face));
        let ([first, second], [a, b]) = (both.faces, [edge.0, edge.1].map(fans));
        // Of two faces that vanish, or one that becomes a triangle.
        let lost = [2, if both.corners.len() == 4 { 2 } else { 1 }];
        let merged: i64 = (0..2)
            .map(|side| {
                let (x, y) = (a[side], b[side]);
                let (kept, other) = if matches!(y.kind, VertexKind::Corner(_)) { (y, x) } else { (x, y) };
                kept.defect(other.quads as i64 - lost[side]) - x.defect(0) - y.defect(0)
            })
            .sum();
        let apex = |v: u32, face: u32| self.fan(v, face).defect(-1) - self.fan(v, face).defect(0);
        let mut less = merged + apex(both.corners[1], first);
        let mut more = STRAIGHT_QUAD;
        if both.corners.len() == 4 {
            less += apex(both.corners[3], second);
            more += STRAIGHT_QUAD;
        }
        let next = rest.first().copied();
        // If one way is not possible, the other is taken.
        (more < less && self.insert_across(at, edge, next))
            || self.merge_across(at, edge, rest)
            || self.insert_across(at, edge, next)
    }

    /// Makes one vertex of the ends of a crease. Beside it, triangles vanish and quads become triangles.
    fn merge_across(&mut self, at: &mut [DVec3], edge: Edge, rest: &mut [Edge]) -> bool {
        let (a, b) = edge;
        let [kept, gone] = if self.creases.allows_merge(self.faces, a, b) {
            [a, b]
        } else if self.creases.allows_merge(self.faces, b, a) {
            [b, a]
        } else {
            return false;
        };
        let near = self.faces.neighbours(gone).to_vec();
        let star: Vec<(u32, Face)> = self.faces.around(gone).collect();
        let old: Vec<u32> = star.iter().map(|(number, _)| *number).collect();
        let left = star.iter().filter_map(|(_, face)| {
            let others: Vec<u32> = face.corners_from(gone).skip(1).collect();
            match (face.corners().contains(&kept), &others[..]) {
                (false, _) => Some(face.renamed(gone, kept)),
                (true, &[x, y, z]) => Some(Face::triangle([x, y, z])),
                (true, _) => None,
            }
        });
        let new: Vec<Face> = left.collect();
        if new.is_empty() || self.faces.replace(&old, &new).is_none() {
            return false;
        }
        self.creases.merged(kept, gone, &near);
        if matches!(self.creases.kind(kept), VertexKind::OnCurve(_)) {
            at[kept as usize] = 0.5 * (at[a as usize] + at[b as usize]);
        }
        let renamed = |v: u32| if v == gone { kept } else { v };
        rest.iter_mut().for_each(|(p, q)| (*p, *q) = (renamed(*p), renamed(*q)));
        true
    }

    /// Puts a new vertex on a crease: the triangle at its left becomes a quad, and a quad beyond the crease
    /// becomes a triangle at the next edge and a quad. Two triangles become two quads.
    fn insert_across(&mut self, at: &mut Vec<DVec3>, edge: Edge, next: Option<Edge>) -> bool {
        let Some(both) = self.faces.sides(edge) else { return false };
        let (a, b) = edge;
        let middle = self.faces.add_vertex();
        at.resize(middle as usize + 1, DVec3::ZERO);
        at[middle as usize] = 0.5 * (at[a as usize] + at[b as usize]);
        let is_replaced = match (&both.corners[..], next) {
            (&[_, c, _, d], None) => {
                let quads = [Face::quad([a, middle, b, c]), Face::quad([b, middle, a, d])];
                self.faces.replace(&both.faces, &quads).is_some()
            }
            (&[_, c, _, d, e], Some(next)) => {
                let first = Face::quad([a, middle, b, c]);
                pentagon_ways([b, middle, a, d, e], next, at).into_iter().flatten().any(|(triangle, quad)| {
                    let new = [first, Face::triangle(triangle), Face::quad(quad)];
                    self.faces.replace(&both.faces, &new).is_some()
                })
            }
            _ => false,
        };
        if is_replaced {
            self.creases.insert_vertex(edge, middle);
        }
        is_replaced
    }
}

/// Divides the pentagon of a triangle and a quad at an edge into a triangle at the next edge, and a quad.
fn move_triangle(faces: &mut Faces, at: &[DVec3], edge: Edge, next: Edge) -> bool {
    let Some(both) = faces.sides(edge) else { return false };
    let Ok(corners) = <[u32; 5]>::try_from(&both.corners[..]) else { return false };
    pentagon_ways(corners, next, at).into_iter().flatten().any(|(triangle, quad)| {
        faces.replace(&both.faces, &[Face::triangle(triangle), Face::quad(quad)]).is_some()
    })
}

/// Both divisions of a pentagon into a triangle at an edge and a quad, that with the better quad first. None
/// if it has no such edge.
fn pentagon_ways(corners: [u32; 5], edge: Edge, at: &[DVec3]) -> Option<[([u32; 3], [u32; 4]); 2]> {
    let start = corners.iter().position(|&v| v == edge.0)?;
    let [p, q, r, s, t] = [0, 1, 2, 3, 4].map(|k| corners[(start + k) % 5]);
    let mut ways = [([p, q, r], [p, r, s, t]), ([p, q, t], [q, r, s, t])];
    if skew(&ways[1].1, at) < skew(&ways[0].1, at) {
        ways.swap(0, 1);
    }
    (q == edge.1).then_some(ways)
}

/// Edges across which the shortest path leads from one triangle to another.
fn shortest_path(faces: &Faces, blocked: &HashSet<Edge>) -> Option<Vec<Edge>> {
    let mut reached = Reached::new();
    let mut queue: VecDeque<u32> = VecDeque::new();
    for (number, _) in faces.all().filter(|(_, face)| face.is_triangle()) {
        reached.insert(number, (number, None));
        queue.push_back(number);
    }
    let back = |reached: &Reached, mut f: u32| {
        let mut edges = Vec::new();
        while let Some((before, edge)) = reached[&f].1 {
            edges.push(edge);
            f = before;
        }
        edges
    };
    while let Some(f) = queue.pop_front() {
        let (source, _) = reached[&f];
        for edge @ (a, b) in faces.face(f)?.edges() {
            if blocked.contains(&edge) || blocked.contains(&(b, a)) {
                continue;
            }
            let (g, _) = faces.left_of(b, a)?;
            match reached.get(&g) {
                Some((other, _)) if *other != source => {
                    let mut path = back(&reached, f);
                    path.reverse();
                    path.push(edge);
                    path.extend(back(&reached, g).into_iter().map(|(a, b)| (b, a)));
                    return Some(path);
                }
                Some(_) => {}
                None => {
                    reached.insert(g, (source, Some((f, edge))));
                    queue.push_back(g);
                }
            }
        }
    }
    None
}

/// Faces that change, with their creases.
struct Quads<'a> {
    faces: &'a mut Faces,
    creases: &'a mut CreaseEdges,
    targets: &'a FanTargets,
}

/// Evens out the numbers of quads at vertices and in fans between creases, until no change makes them better.
pub(super) fn even_out(
    faces: &mut Faces,
    creases: &mut CreaseEdges,
    targets: &FanTargets,
    at: &mut Vec<DVec3>,
    adds_rings: bool,
) {
    let mut own = Quads { faces, creases, targets };
    own.change_while_better(at);
    if own.creases.is_empty() {
        return;
    }
    if adds_rings && own.add_rings(at) > 0 {
        own.change_while_better(at);
    }
    own.remove_straight(at);
    let quads: Vec<u32> = own.faces.all().map(|(number, _)| number).collect();
    if quads.into_iter().filter(|&quad| own.surround(at, quad, false)).count() > 0 {
        own.change_while_better(at);
    }
    // No spline is regular at a straight corner; irregular vertices are the lesser evil.
    let quads: Vec<u32> = own.faces.all().map(|(number, _)| number).collect();
    quads.into_iter().for_each(|quad| {
        own.surround(at, quad, true);
    });
}

impl Quads<'_> {
    fn change_while_better(&mut self, at: &mut Vec<DVec3>) {
        loop {
            let mut changes = 0;
            for v in 0..at.len() as u32 {
                changes += usize::from(self.faces.valence(v) == 2 && self.remove_vertex(v));
            }
            let quads: Vec<u32> = self.faces.all().map(|(number, _)| number).collect();
            changes += quads.into_iter().filter(|&quad| self.collapse(at, quad)).count();
            changes += self.faces.edges().into_iter().filter(|&edge| self.turn(at, edge)).count();
            if !self.creases.is_empty() {
                changes += (0..at.len() as u32).filter(|&v| self.open(at, v)).count();
            }
            if changes == 0 {
                return;
            }
        }
    }

    /// True if a crease passes a quad at its corner, so that the quad has nearly 180° there.
    fn is_straight(&self, at: &[DVec3], v: u32, quad: u32) -> bool {
        let fan = self.fan(v, quad);
        let Some(face) = self.faces.face(quad) else { return false };
        let corners: Vec<u32> = face.corners_from(v).collect();
        let way = |w: u32| at[w as usize] - at[v as usize];
        matches!(fan.kind, VertexKind::OnCurve(_))
            && fan.quads == 1
            && way(corners[1]).angle_between(way(corners[3])) > MIN_STRAIGHT
    }

    /// Removes vertices on creases at which quads have straight corners, as far as that is better after all
    /// that follows from it: the two triangles that are left move to others.
    fn remove_straight(&mut self, at: &mut Vec<DVec3>) {
        let quads: Vec<(u32, Face)> = self.faces.all().collect();
        let corners = quads.iter().flat_map(|(quad, face)| face.corners().iter().map(|&v| (v, *quad)));
        let straight: Vec<u32> =
            corners.filter(|&(v, quad)| self.is_straight(at, v, quad)).map(|(v, _)| v).collect();
        let most = MAX_TRIED_FACES / self.faces.count().max(1);
        let mut own = self.defect(at);
        for v in straight.into_iter().take(most) {
            let is_left = self.faces.around(v).any(|(face, _)| self.is_straight(at, v, face));
            let on_crease = self.faces.neighbours(v).iter().copied().filter(|&w| self.creases.has((v, w)));
            for w in on_crease.collect::<Vec<_>>().into_iter().filter(|_| is_left) {
                let (mut faces, mut creases, mut moved) =
                    (self.faces.clone(), self.creases.clone(), at.clone());
                let mut tried = Quads { faces: &mut faces, creases: &mut creases, targets: self.targets };
                if !tried.merge_across(&mut moved, (w, v), &mut []) || !tried.meet(&mut moved) {
                    continue;
                }
                tried.change_while_better(&mut moved);
                let then = tried.defect(&moved);
                if then < own {
                    own = then;
                    (*self.faces, *self.creases, *at) = (faces, creases, moved);
                    break;
                }
            }
        }
    }

    /// The sum of the defects of all fans, with more for straight corners.
    fn defect(&self, at: &[DVec3]) -> f64 {
        let mut total = 0.0;
        for (quad, face) in self.faces.all() {
            for &v in face.corners() {
                let fan = self.fan(v, quad);
                total += fan.defect(0) as f64 / fan.quads.max(1) as f64;
                total += if self.is_straight(at, v, quad) { STRAIGHT_QUAD as f64 } else { 0.0 };
            }
        }
        total
    }

    /// Adds rings of quads beside closed creases at which quads have straight corners: these corners become
    /// vertices with three quads. Returns the number of rings.
    fn add_rings(&mut self, at: &mut Vec<DVec3>) -> usize {
        let mut sides: BTreeMap<CurveSide, BTreeMap<u32, u32>> = BTreeMap::new();
        for (&(a, b), &side) in &self.creases.sides {
            sides.entry(side).or_default().insert(a, b);
        }
        sides.values().filter(|next| self.add_ring(at, next)).count()
    }

    /// Adds a ring at the left of a closed chain of creases, given by the next vertex of each.
    fn add_ring(&mut self, at: &mut Vec<DVec3>, next: &BTreeMap<u32, u32>) -> bool {
        if next.keys().any(|&v| !matches!(self.creases.kind(v), VertexKind::OnCurve(_))) {
            return false;
        }
        // The faces at the left, with their corners on the chain.
        let mut beside: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        let mut has_straight = false;
        for (&v, &w) in next {
            let mut start = Some(w);
            while let Some((number, face)) = start.and_then(|w| self.faces.left_of(v, w)) {
                beside.entry(number).or_default().push(v);
                has_straight |= self.is_straight(at, v, number);
                start = face.corners_from(v).last().filter(|&w| !self.creases.has((v, w)));
            }
        }
        let touches_both_sides = beside.iter().any(|(&number, own)| {
            let corners = self.faces.face(number);
            corners.is_none_or(|face| face.corners().iter().any(|v| next.contains_key(v) && !own.contains(v)))
        });
        if !has_straight || touches_both_sides {
            return false;
        }
        let mut inner: BTreeMap<u32, u32> = BTreeMap::new();
        for &v in next.keys() {
            let new = self.faces.add_vertex();
            at.resize(new as usize + 1, DVec3::ZERO);
            let own = beside.iter().filter(|(_, corners)| corners.contains(&v));
            let others = own.filter_map(|(&number, _)| self.faces.face(number));
            let others: Vec<DVec3> =
                others.flat_map(|face| face.corners().to_vec()).map(|w| at[w as usize]).collect();
            let middle = others.iter().sum::<DVec3>() / others.len().max(1) as f64;
            at[new as usize] = 0.5 * (at[v as usize] + middle);
            inner.insert(v, new);
        }
        let moved = beside.keys().filter_map(|&number| self.faces.face(number)).map(|face| {
            face.corners()
                .iter()
                .fold(face, |face, v| inner.get(v).map_or(face, |&new| face.renamed(*v, new)))
        });
        let mut new: Vec<Face> = moved.collect();
        new.extend(next.iter().map(|(v, w)| Face::quad([*v, *w, inner[w], inner[v]])));
        let old: Vec<u32> = beside.keys().copied().collect();
        self.faces.replace(&old, &new).is_some()
    }

    fn fan(&self, v: u32, face: u32) -> Fan {
        Fan::new(self.faces, self.creases, self.targets, v, face)
    }

    /// Makes one quad of the two around a vertex.
    fn remove_vertex(&mut self, v: u32) -> bool {
        let [a, b] = *self.faces.neighbours(v) else { return false };
        let (Some((f, first)), Some((g, second))) = (self.faces.left_of(v, a), self.faces.left_of(v, b))
        else {
            return false;
        };
        let beyond = |face: Face| face.corners().iter().copied().find(|w| ![v, a, b].contains(w));
        let (Some(c), Some(d)) = (beyond(first), beyond(second)) else { return false };
        self.creases.is_free(v) && self.faces.replace(&[f, g], &[Face::quad([a, c, b, d])]).is_some()
    }

    /// Merges opposite corners of a quad, if that makes valences better.
    fn collapse(&mut self, at: &mut [DVec3], quad: u32) -> bool {
        let Some(face) = self.faces.face(quad) else { return false };
        let [a, b, c, d] = *face.corners() else { return false };
        [[a, b, c, d], [b, c, d, a]].into_iter().any(|[a, left, b, right]| {
            // A vertex on a crease is kept, and two can not become one.
            let (kept, gone) = if self.creases.is_free(b) { (a, b) } else { (b, a) };
            if !self.creases.is_free(gone) {
                return false;
            }
            let [n, l, m, r] = [kept, left, gone, right].map(|v| self.fan(v, quad));
            let now = n.defect(0) + l.defect(0) + m.defect(0) + r.defect(0);
            let then = n.defect(m.quads as i64 - 2) + l.defect(-1) + r.defect(-1);
            if then >= now
                || self.faces.are_joined(kept, gone)
                || self.faces.common_neighbours(kept, gone).len() != 2
            {
                return false;
            }
            let is_merged = self.faces.merge_into(kept, gone);
            if is_merged && self.creases.is_free(kept) {
                at[kept as usize] = 0.5 * (at[kept as usize] + at[gone as usize]);
            }
            is_merged
        })
    }

    /// Makes five quads of one that has a straight corner on a crease, with a smaller one in its middle: if
    /// that makes valences better, or in any case. The straight corner is divided.
    fn surround(&mut self, at: &mut Vec<DVec3>, quad: u32, in_any_case: bool) -> bool {
        let Some(face) = self.faces.face(quad) else { return false };
        let [a, b, c, d] = *face.corners() else { return false };
        let outer = [a, b, c, d];
        let gain: i64 =
            (outer.iter().map(|&v| self.fan(v, quad))).map(|fan| fan.defect(0) - fan.defect(1)).sum();
        // The four new vertices have three quads.
        let is_better = in_any_case || gain > 4;
        if !is_better || !outer.iter().any(|&v| self.is_straight(at, v, quad)) {
            return false;
        }
        let middle = outer.iter().map(|&v| at[v as usize]).sum::<DVec3>() / 4.0;
        let inner = outer.map(|v| {
            let new = self.faces.add_vertex();
            at.resize(new as usize + 1, DVec3::ZERO);
            at[new as usize] = 0.5 * (at[v as usize] + middle);
            new
        });
        let mut quads = vec![Face::quad(inner)];
        quads.extend((0..4).map(|k| {
            let next = (k + 1) % 4;
            Face::quad([outer[k], outer[next], inner[next], inner[k]])
        }));
        self.faces.replace(&[quad], &quads).is_some()
    }

    /// Opens the way from a vertex over a neighbour to one beyond it into a quad, if that makes numbers of
    /// quads better: both ends get a quad more, and the neighbour becomes two vertices.
    ///
    /// A corner of 270° may have two quads that no turn of an edge makes three.
    fn open(&mut self, at: &mut Vec<DVec3>, v: u32) -> bool {
        let mut best: Option<(i64, u32, usize)> = None;
        for &w in self.faces.neighbours(v) {
            let Some((face, _)) = self.faces.left_of(w, v) else { continue };
            let near = self.faces.neighbours_in_order(w, v);
            if !self.creases.is_free(w) || near.len() != self.faces.valence(w) {
                continue;
            }
            let gain = |fan: Fan| fan.defect(0) - fan.defect(1);
            let of_ends = gain(self.fan(v, face)) + self.fan(w, face).defect(0);
            for (k, &x) in near.iter().enumerate().skip(2).take(near.len().saturating_sub(3)) {
                let Some((beyond, _)) = self.faces.left_of(w, x) else { continue };
                let halves = [k, near.len() - k].map(|quads| (quads as i64 + 1 - 4).pow(2));
                let own = of_ends + gain(self.fan(x, beyond)) - halves[0] - halves[1];
                if own > best.map_or(0, |(most, ..)| most) {
                    best = Some((own, w, k));
                }
            }
        }
        best.is_some_and(|(_, w, k)| self.divide_vertex(at, [v, w], k))
    }

    /// Makes two vertices of `w` with a quad between them, from `v` to the `k`th neighbour after it.
    fn divide_vertex(&mut self, at: &mut Vec<DVec3>, [v, w]: [u32; 2], k: usize) -> bool {
        let near = self.faces.neighbours_in_order(w, v);
        let new = self.faces.add_vertex();
        at.resize(new as usize + 1, DVec3::ZERO);
        let mut old = Vec::new();
        let mut made = vec![Face::quad([v, w, near[k], new])];
        for (j, &x) in near.iter().enumerate() {
            let Some((number, face)) = self.faces.left_of(w, x) else { return false };
            old.push(number);
            made.push(if j < k { face } else { face.renamed(w, new) });
        }
        if self.faces.replace(&old, &made).is_none() {
            return false;
        }
        let towards = |side: &[u32]| {
            let mean = side.iter().map(|&x| at[x as usize]).sum::<DVec3>() / side.len().max(1) as f64;
            at[w as usize].lerp(mean, 1.0 / 3.0)
        };
        let moved = [towards(&near[1..k]), towards(&near[k + 1..])];
        (at[w as usize], at[new as usize]) = (moved[0], moved[1]);
        true
    }

    /// Turns the edge between two quads within their hexagon, if that makes valences better.
    fn turn(&mut self, at: &[DVec3], edge: Edge) -> bool {
        let Some(both) = self.faces.sides(edge).filter(|_| !self.creases.has(edge)) else { return false };
        let hexagon = both.corners;
        if both.faces[0] == both.faces[1] || hexagon.len() != 6 {
            return false;
        }
        let fans: Vec<Fan> = (0..6).map(|k| self.fan(hexagon[k], both.faces[k / 4])).collect();
        // The edge joins corners 0 and 3.
        let gain = |start: usize| {
            let changes = [(0, -1), (3, -1), (start, 1), (start + 3, 1)];
            changes.iter().map(|&(k, change)| fans[k].defect(0) - fans[k].defect(change)).sum::<i64>()
        };
        let quads = |start: usize| [0, 3].map(|k| [0, 1, 2, 3].map(|j| hexagon[(start + k + j) % 6]));
        let is_square = |&start: &usize| quads(start).iter().all(|quad| skew(quad, at) < MAX_SKEW_TURNED);
        let best = [1, 2].into_iter().filter(is_square).max_by_key(|&start| gain(start));
        let Some(start) = best.filter(|&start| gain(start) > 0) else { return false };
        self.faces.replace(&both.faces, &quads(start).map(Face::quad)).is_some()
    }
}
