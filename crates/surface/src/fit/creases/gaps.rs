//! Gaps in chains of creases are closed along edges of the mesh.
//!
//! Input: a mesh with creases of which some end. Output: the same mesh with paths from ends to other creases
//! ahead of them, where both sides of the end go on.
//!
//! Not guaranteed: that a crease which does end near another one is not prolonged to it.

use super::crossings::NONE;
use super::sharpened::SharpMesh;
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
                let last = path[path.len() - 1];
                if self.creases(last).len() == 3 {
                    self.place_corner(last, sides);
                }
            }
        }
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
