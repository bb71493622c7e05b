//! Whole steps along the edges of a mesh, closed around its triangles.
//!
//! Around a triangle, quarter turns add up to zero, unless the field of directions is singular there. Where
//! they do, whole steps should add up to zero as well. If they do not, a row of squares ends in the triangle.
//! The missing step is then taken from a line of edges that leads to a triangle which lacks the opposite
//! step, or to a singular one, along the way on which the steps of edges change least from the field's. Steps
//! along creases have no part across them.
//!
//! # References
//! Huang, Zhou, Niessner, Shewchuk, Guibas, *QuadriFlow: a scalable and robust method for quadrangulation*,
//! Computer Graphics Forum 37, 2018: steps that close, there by a flow of least cost for all at once.

use super::creases::{CreaseEdges, VertexKind};
use super::lattice::{Lattice, Step, turned};
use planish_mesh::TriangleMesh;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

/// Cost of an edge on a way, besides the change of its step: ways are short.
const EDGE_COST: f64 = 0.05;
/// Additional cost of an edge of more than one step.
const LONG_COST: f64 = 3.0;
/// Largest cost of a way: about three squares. Over longer ways, whole rows of squares would be squeezed, and
/// a row that ends costs two extraordinary vertices instead.
pub(super) const MAX_COST: f64 = 20.0;
/// The same for meshes with creases, where a row can leave a face through the next one.
pub(super) const MAX_COST_FAR: f64 = 60.0;
/// Missing steps of a triangle that are moved away, at most.
const MAX_MISSING: usize = 6;

/// A missing step in a triangle, along the directions of its first corner.
type Missing = (u32, [i32; 2]);

/// The steps of all half edges `3 t + k`, from corner `k` of triangle `t` to the next.
pub(super) struct Steps<'a> {
    pub(super) steps: Vec<Step>,
    /// True steps less whole ones, along the directions of the start.
    left: Vec<[f64; 2]>,
    opposite: &'a [u32],
    /// For each half edge on a crease, which part of its step is along it. Empty without creases.
    along: Vec<Option<u8>>,
}

impl<'a> Steps<'a> {
    pub(super) fn new(mesh: &TriangleMesh, opposite: &'a [u32], lattices: &[Lattice]) -> Self {
        let steps = vec![Step { turn: 0, by: [0, 0] }; opposite.len()];
        let mut own = Self { steps, left: vec![[0.0; 2]; opposite.len()], opposite, along: Vec::new() };
        for half in (0..opposite.len()).filter(|&half| opposite[half] as usize > half) {
            let triangle = mesh.triangles[half / 3];
            let [a, b] = [half % 3, (half + 1) % 3].map(|k| triangle[k] as usize);
            let (step, left) = lattices[a].step_to(&lattices[b]);
            own.set(half, step, left);
        }
        own
    }

    /// Makes all steps of creases steps along them, and keeps them so.
    pub(super) fn keep_along(&mut self, mesh: &TriangleMesh, creases: &CreaseEdges, lattices: &[Lattice]) {
        if creases.is_empty() {
            return;
        }
        self.along = vec![None; self.opposite.len()];
        for half in 0..self.opposite.len() {
            let triangle = mesh.triangles[half / 3];
            let [a, b] = [half % 3, (half + 1) % 3].map(|k| triangle[k]);
            if !creases.has((a, b)) {
                continue;
            }
            let way = mesh.positions[b as usize] - mesh.positions[a as usize];
            let own = &lattices[a as usize];
            let axis = usize::from(way.dot(own.direction).abs() < way.dot(own.across()).abs());
            self.along[half] = Some(axis as u8);
            // Directions at corners are along one of their creases only.
            if !matches!(creases.kind(a), VertexKind::Corner(_)) {
                let (mut step, left) = (self.steps[half], self.left[half]);
                step.by[1 - axis] = 0;
                self.set(half, step, left);
            }
        }
    }

    fn set(&mut self, half: usize, step: Step, left: [f64; 2]) {
        let over = self.opposite[half] as usize;
        (self.steps[half], self.left[half]) = (step, left);
        self.steps[over] = step.reversed();
        self.left[over] = turned(left, self.steps[over].turn).map(|x| -x);
    }

    /// All steps around a triangle, from its first corner.
    fn around(&self, triangle: u32) -> Step {
        let first = 3 * triangle as usize;
        self.steps[first].then(self.steps[first + 1]).then(self.steps[first + 2])
    }

    /// Quarter turns from the directions of a corner to those of the first corner of its triangle.
    fn turn_of_corner(&self, half: usize) -> u8 {
        (half / 3 * 3..half).map(|h| self.steps[h].turn).sum::<u8>() % 4
    }

    /// Closes the steps around all triangles that are not singular, as far as ways of a cost reach.
    pub(super) fn close(&mut self, max_cost: f64) {
        for triangle in 0..self.steps.len() as u32 / 3 {
            for _ in 0..MAX_MISSING {
                let Step { turn, by } = self.around(triangle);
                if turn != 0 || by == [0, 0] {
                    break;
                }
                let unit = if by[0] == 0 { [0, by[1].signum()] } else { [by[0].signum(), 0] };
                if !self.move_away((triangle, unit), max_cost) {
                    break;
                }
            }
        }
    }

    /// Moves a missing step to the triangle that can be reached at the least cost. False if there is none
    /// nearby.
    fn move_away(&mut self, start: Missing, max_cost: f64) -> bool {
        // The cheapest way to each state: its cost, and the state and half edge before it.
        let mut best: HashMap<Missing, (f64, Option<(Missing, usize)>)> =
            HashMap::from([(start, (0.0, None))]);
        let mut open = BinaryHeap::from([(Reverse(0_u64), start)]);
        let mut end = None;
        while let Some((Reverse(bits), state)) = open.pop() {
            // Costs are not negative, so their bits have the same order.
            let cost = f64::from_bits(bits);
            if cost > max_cost {
                return false;
            }
            if best[&state].0 < cost {
                continue;
            }
            let (triangle, [x, y]) = state;
            let own = self.around(triangle);
            if triangle != start.0 && (own.turn != 0 || own.by[0] * x + own.by[1] * y < 0) {
                end = Some(state);
                break;
            }
            for half in 3 * triangle as usize..3 * triangle as usize + 3 {
                let (next, price) = self.across(state, half);
                let total = cost + price;
                if best.get(&next).is_none_or(|known| known.0 > total) {
                    best.insert(next, (total, Some((state, half))));
                    open.push((Reverse(total.to_bits()), next));
                }
            }
        }
        let Some(mut at) = end else { return false };
        while let Some((before, half)) = best[&at].1 {
            let [x, y] = self.at_corner(before, half);
            let (mut step, mut left) = (self.steps[half], self.left[half]);
            step.by = [step.by[0] - x, step.by[1] - y];
            left = [left[0] + f64::from(x), left[1] + f64::from(y)];
            self.set(half, step, left);
            at = before;
        }
        true
    }

    /// A missing step along the directions of the start of a half edge of its triangle.
    fn at_corner(&self, (_, by): Missing, half: usize) -> [i32; 2] {
        turned(by, 4 - self.turn_of_corner(half))
    }

    /// The state beyond a half edge whose step is reduced by what is missing, and the cost of the change.
    fn across(&self, state: Missing, half: usize) -> (Missing, f64) {
        let [x, y] = self.at_corner(state, half);
        let over = self.opposite[half] as usize;
        let there = turned(turned([x, y], self.steps[over].turn), self.turn_of_corner(over));
        let [left, by] = [self.left[half], self.steps[half].by.map(f64::from)];
        // |l + m|² − |l|² for a unit vector m.
        let change = 1.0 + 2.0 * (left[0] * f64::from(x) + left[1] * f64::from(y));
        let is_long = (by[0] - f64::from(x)).abs().max((by[1] - f64::from(y)).abs()) > 1.0;
        let is_across = match self.along.get(half) {
            Some(Some(axis)) => [y, x][usize::from(*axis)] != 0,
            _ => false,
        };
        if is_across {
            return ((over as u32 / 3, there), f64::INFINITY);
        }
        let cost = change.max(0.0) + EDGE_COST + if is_long { LONG_COST } else { 0.0 };
        ((over as u32 / 3, there), cost)
    }
}
