//! Curves in which the candidate surfaces of a grid intersect, and the points at which others cut them.
//!
//! Input: the surfaces of a grid. Output: each intersection, computed when it is first asked for. The search
//! makes boundaries of up to 32 solids from the same candidates, and most of their surfaces are the same.

use super::adjacent::AdjacentCells;
use super::boundary::tolerance;
use super::candidates::{Candidate, Samples, corners, curves};
use super::cells::Cells;
use super::column::SurfaceId;
use super::surfaces::Meeting;
use crate::brep::EdgeCurve;
use planish_core::DVec3;
use std::collections::HashMap;
use std::rc::Rc;

/// A curve of two surfaces: their numbers, and its index among their curves.
pub(super) type CurveId = ([SurfaceId; 2], usize);

/// Points of a curve with their parameters.
pub(super) type Cuts = Rc<[(f64, DVec3)]>;

/// An interval of a curve: its parameters, and its ends if they are vertices, bit by bit.
type IntervalKey = ([u64; 2], Option<[[u64; 3]; 2]>);

/// Intersections of the candidate surfaces of a grid.
pub(super) struct Intersections<'a> {
    cells: &'a Cells<'a>,
    /// Distance below which points are equal.
    tolerance: f64,
    bounds: [[f64; 2]; 3],
    adjacent: Option<AdjacentCells>,
    surfaces: HashMap<SurfaceId, Rc<Candidate>>,
    curves: HashMap<[SurfaceId; 2], Rc<[Meeting]>>,
    samples: HashMap<CurveId, Rc<Samples>>,
    cuts: HashMap<(CurveId, Option<SurfaceId>), Cuts>,
    edges: HashMap<(CurveId, IntervalKey), EdgeCurve>,
}

impl<'a> Intersections<'a> {
    pub(super) fn new(cells: &'a Cells<'a>) -> Self {
        let bounds = [0, 1, 2].map(|a| {
            let grid = &cells.plan.grid[a];
            [grid[0], grid[grid.len() - 1]]
        });
        let (surfaces, curves, samples, cuts, edges) = Default::default();
        Self {
            cells,
            tolerance: tolerance(cells),
            bounds,
            adjacent: None,
            surfaces,
            curves,
            samples,
            cuts,
            edges,
        }
    }

    /// The surfaces with a cell on one side that is solid, and one on the other side that is not; ascending.
    pub(super) fn used(&mut self, is_solid: impl Fn(u32) -> bool) -> Vec<SurfaceId> {
        let cells = self.cells;
        self.adjacent.get_or_insert_with(|| AdjacentCells::new(cells)).used(is_solid)
    }

    /// A candidate surface.
    pub(super) fn surface(&mut self, id: SurfaceId) -> Rc<Candidate> {
        let cells = self.cells;
        self.surfaces.entry(id).or_insert_with(|| Rc::new(Candidate::new(cells, id))).clone()
    }

    /// The curves in which two surfaces intersect.
    pub(super) fn curves(&mut self, pair: [SurfaceId; 2]) -> Rc<[Meeting]> {
        if let Some(known) = self.curves.get(&pair) {
            return known.clone();
        }
        let [s, t] = pair.map(|id| self.surface(id));
        let found: Rc<[Meeting]> = curves(&s, &t, self.cells.plan.size, self.tolerance).into();
        self.curves.insert(pair, found.clone());
        found
    }

    /// The points of a curve at which a third surface cuts it, or else those at which it ends.
    pub(super) fn cuts(
        &mut self,
        (pair, index): CurveId,
        meeting: &Meeting,
        third: Option<SurfaceId>,
    ) -> Cuts {
        let key = ((pair, index), third);
        if let Some(known) = self.cuts.get(&key) {
            return known.clone();
        }
        let points = match third {
            None => meeting.ends.clone(),
            Some(third) => {
                let three = [pair[0], pair[1], third].map(|id| self.surface(id));
                let (curve, bounds) = (&meeting.curve, self.bounds);
                let known = self.samples.entry((pair, index));
                let samples = || known.or_insert_with(|| Rc::new(Samples::new(curve, bounds))).clone();
                corners([&three[0], &three[1], &three[2]], curve, samples, self.tolerance)
            }
        };
        // Surfaces are unbounded, so most points lie outside of the drawing, where all is empty.
        let is_inside = |p: &DVec3| (0..3).all(|a| p[a] > self.bounds[a][0] && p[a] < self.bounds[a][1]);
        let found: Cuts = (points.into_iter().filter(is_inside))
            .filter_map(|p| Some((meeting.curve.parameter(p, self.tolerance)?, p)))
            .collect();
        self.cuts.insert(key, found.clone());
        found
    }

    /// The edge curve of an interval of a curve, made at first use.
    pub(super) fn edge(
        &mut self,
        id: CurveId,
        range: [f64; 2],
        ends: Option<[DVec3; 2]>,
        make: impl FnOnce() -> EdgeCurve,
    ) -> EdgeCurve {
        let bits = |p: DVec3| p.to_array().map(f64::to_bits);
        let key = (id, (range.map(f64::to_bits), ends.map(|ends| ends.map(bits))));
        self.edges.entry(key).or_insert_with(make).clone()
    }
}
