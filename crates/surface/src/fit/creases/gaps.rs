//! Gaps in chains of creases are closed along edges of the mesh.
//!
//! Input: a mesh with creases of which some end. Output: the same mesh with paths from ends to other creases
//! ahead of them, where both sides of the end go on.
//!
//! Not guaranteed: that a crease which does end near another one is not prolonged to it.

use super::crossings::NONE;
use super::sharpened::{SharpMesh, Sides};
use planish_core::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Longest gap, in spacings. Chains that are nearer to each other than that have creases between their ends
/// more often than not.
const MAX_GAP: f64 = 3.5;
/// Length over which the direction of an end is taken, and length of its own chain that is no target, in
/// spacings.
const DIRECTION: f64 = 2.0;
const OWN_CHAIN: f64 = 10.0;
/// A vertex of a path moves at most this many spacings to the line of the end: beside a corner, the mesh is
/// rounded by more than along an edge.
const MAX_PATH_MOVE: f64 = 3.0;
/// Length over which creases are straightened at a corner, in spacings.
const CORNER_LENGTH: f64 = 3.0;
/// Least cosine between the direction of an end and that to its target.
const MIN_AHEAD: f64 = 0.4;
/// What each spacing from the line of the end costs, beside the length of a path. What a target that is no
/// end costs, in spacings.
const OFF_COST: f64 = 2.0;
const BRANCH_COST: f64 = 1.0;

impl SharpMesh {
    /// Joins ends of creases with others ahead of them.
    pub(super) fn close_gaps(&mut self) {
        let ends: Vec<u32> = (0..self.at.len() as u32).filter(|&v| self.creases(v).len() == 1).collect();
        for end in ends {
            if self.creases(end).len() == 1
                && let Some(path) = self.path_ahead(end)
            {
                let sides = self.sides(end);
                for pair in path.windows(2) {
                    if self.creases(pair[1]).is_empty() {
                        self.put_on(pair[1], sides, MAX_PATH_MOVE);
                    }
                    self.join(pair[0], pair[1]);
                }
            }
        }
    }

    /// Moves vertices where three creases meet to where their sides do, and straightens the creases there.
    ///
    /// The mesh is rounder at a corner than along edges, so crossings next to it may cut it off.
    pub(super) fn place_corners(&mut self) {
        for v in (0..self.at.len() as u32).filter(|&v| self.creases(v).len() == 3).collect::<Vec<_>>() {
            let branches: Vec<Vec<u32>> = self.creases(v).iter().map(|&w| self.branch([v, w])).collect();
            let ends: Vec<Sides> = branches.iter().map(|path| self.sides(path[path.len() - 1])).collect();
            let first = [ends[0][0], ends[0][1]];
            let others = ends[1..].iter().flat_map(|sides| [sides[0], sides[1]]);
            let Some(corner) = self.corner_of(first, others, self.at[v as usize]) else { continue };
            let Some(placed) = self.on_sides(corner, self.at[v as usize], MAX_PATH_MOVE) else { continue };
            self.move_to(v, placed, corner);
            for (path, sides) in branches.iter().zip(ends) {
                let far = self.at[path[path.len() - 1] as usize];
                let inner = &path[1..path.len() - 1];
                for (k, &w) in inner.iter().enumerate() {
                    self.move_to(w, placed.lerp(far, (k + 1) as f64 / (inner.len() + 1) as f64), sides);
                }
            }
        }
    }

    /// The vertices of a chain from its first two on, over a length, or up to where it ends or branches.
    fn branch(&self, [first, second]: [u32; 2]) -> Vec<u32> {
        let mut path = vec![first, second];
        while self.at[first as usize].distance(self.at[path[path.len() - 1] as usize])
            < CORNER_LENGTH * self.spacing()
        {
            let [before, last] = [path[path.len() - 2], path[path.len() - 1]];
            let (Some(&next), 2) =
                (self.creases(last).iter().find(|w| **w != before), self.creases(last).len())
            else {
                break;
            };
            path.push(next);
        }
        path
    }

    /// Vertices of the same chain within a length, from an end on.
    fn own_chain(&self, end: u32, longest: f64) -> Vec<u32> {
        let (mut chain, mut length) = (vec![end], 0.0);
        while length < longest {
            let last = chain[chain.len() - 1];
            let Some(&next) = self.creases(last).iter().find(|w| !chain.contains(w)) else { break };
            length += self.at[last as usize].distance(self.at[next as usize]);
            chain.push(next);
        }
        chain
    }

    /// The cheapest path from an end over vertices without creases to another crease ahead.
    fn path_ahead(&self, end: u32) -> Option<Vec<u32>> {
        let spacing = self.spacing();
        let at = |v: u32| self.at[v as usize];
        let back = self.own_chain(end, DIRECTION * spacing);
        let ahead = (at(end) - at(back[back.len() - 1])).try_normalize()?;
        let own: BTreeSet<u32> = self.own_chain(end, OWN_CHAIN * spacing).into_iter().collect();
        let is_ahead = |p: DVec3| (p - at(end)).dot(ahead) > MIN_AHEAD * p.distance(at(end));
        let mut open: BTreeMap<u32, (f64, u32)> = BTreeMap::from([(end, (0.0, NONE))]);
        let mut done: BTreeMap<u32, u32> = BTreeMap::new();
        while let Some((&v, &(cost, before))) = open.iter().min_by(|a, b| a.1.0.total_cmp(&b.1.0)) {
            open.remove(&v);
            done.insert(v, before);
            if v != end && !self.creases(v).is_empty() {
                let mut path = vec![v];
                while let Some(&before) = done.get(&path[path.len() - 1]).filter(|w| **w != NONE) {
                    path.push(before);
                }
                path.reverse();
                return Some(path);
            }
            for w in self.neighbours(v) {
                let is_target = !self.creases(w).is_empty();
                if done.contains_key(&w)
                    || own.contains(&w)
                    || at(w).distance(at(end)) > MAX_GAP * spacing
                    || is_target && !is_ahead(at(w))
                {
                    continue;
                }
                let extra = if is_target {
                    if self.creases(w).len() == 1 { 0.0 } else { BRANCH_COST * spacing }
                } else {
                    let on_line = self.on_sides(self.sides(end), at(w), MAX_PATH_MOVE);
                    let Some(on_line) = on_line else { continue };
                    OFF_COST * on_line.distance(at(w))
                };
                let through = (cost + at(v).distance(at(w)) + extra, v);
                let known = open.entry(w).or_insert(through);
                if through.0 < known.0 {
                    *known = through;
                }
            }
        }
        None
    }
}
