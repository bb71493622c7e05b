//! Pairs of cells on both sides of each candidate surface.
//!
//! Input: the cells of a grid. Output: for each surface, the pairs of different cells that it separates
//! somewhere. They are found once; the surfaces that bound a solid then follow from the states of its cells.
//!
//! Only sample points are tested. A used surface that no sample finds leaves loops of its neighbours open,
//! which is reported as an error.

use super::candidate_surface::{Side, across};
use super::cells::{Cells, is_plain, pieces_in};
use super::column::SurfaceId;
use planish_core::DVec3;
use std::collections::{BTreeMap, BTreeSet};

/// Shares of a box at which its walls are sampled.
const WALL_SAMPLES: [f64; 7] = [0.02, 0.13, 0.33, 0.52, 0.71, 0.88, 0.97];
/// Shares of a box at which its other surfaces are sampled, and those along a piece of a drawn curve.
const SAMPLES: [f64; 5] = [0.03, 0.21, 0.47, 0.79, 0.96];
const PIECE_SAMPLES: [f64; 5] = [0.07, 0.31, 0.53, 0.71, 0.94];

/// The different cells on both sides of each surface.
pub(super) struct AdjacentCells {
    pairs: BTreeMap<SurfaceId, BTreeSet<[u32; 2]>>,
}

impl AdjacentCells {
    /// Finds the pairs of all surfaces.
    pub(super) fn new(cells: &Cells) -> Self {
        // The step across a surface: above rounding, and small against the details of a drawing.
        let step = 1e-6 * cells.plan.size;
        let mut search = Search { cells, step, pairs: BTreeMap::new() };
        let n = [0, 1, 2].map(|a| cells.plan.intervals(a));
        for place in 0..n[0] * n[1] * n[2] {
            let cell = [place / (n[1] * n[2]), place / n[2] % n[1], place % n[2]];
            search.add_grid_planes(cell);
            for &wall in cells.plan.walls_in(cell) {
                search.add_wall(cell, wall);
            }
            for view in 0..cells.plan.views.len() {
                search.add_pieces(cell, view);
            }
        }
        Self { pairs: search.pairs }
    }

    /// The surfaces with a cell on one side that is solid, and one on the other side that is not; ascending.
    pub(super) fn used(&self, is_solid: impl Fn(u32) -> bool) -> Vec<SurfaceId> {
        let is_used = |pairs: &BTreeSet<[u32; 2]>| pairs.iter().any(|[a, b]| is_solid(*a) != is_solid(*b));
        self.pairs.iter().filter(|(_, pairs)| is_used(pairs)).map(|(id, _)| *id).collect()
    }
}

/// The pairs found so far.
struct Search<'a> {
    cells: &'a Cells<'a>,
    /// Distance of the two points of a pair from the surface.
    step: f64,
    pairs: BTreeMap<SurfaceId, BTreeSet<[u32; 2]>>,
}

impl Search<'_> {
    /// Adds a pair of cells if they are different and if no other surface is near their place, whose states
    /// would differ because of that surface. The latter takes longer and is tested for new pairs only.
    fn add(&mut self, id: SurfaceId, [a, b]: [u32; 2], is_touched: impl FnOnce(&Self) -> bool) {
        let pair = [a.min(b), a.max(b)];
        if a != b && !self.pairs.get(&id).is_some_and(|known| known.contains(&pair)) && !is_touched(self) {
            self.pairs.entry(id).or_default().insert(pair);
        }
    }

    /// True if a wall, or a piece other than `but`, is nearer to a point of a box than `near`.
    fn touched(&self, p: DVec3, cell: [usize; 3], near: f64, but: Option<(usize, u32)>) -> bool {
        let plan = self.cells.plan;
        let by_piece = plan.views.iter().enumerate().any(|(v, view)| {
            let axes = view.kind.axes();
            let is_near = |n: u32| view.profile(n).value([p[axes[0]], p[axes[1]]]).abs() < near;
            pieces_in(plan, v, cell).iter().any(|&n| but != Some((v, n)) && is_near(n))
        });
        by_piece || self.touched_by_wall(p, cell, near, None)
    }

    /// True if a wall other than `but` is nearer to a point of a box than `near`.
    fn touched_by_wall(&self, p: DVec3, cell: [usize; 3], near: f64, but: Option<u16>) -> bool {
        let plan = self.cells.plan;
        let mut walls = plan.walls_in(cell).iter().filter(|w| Some(w.0) != but);
        walls.any(|&(wall, side)| plan.walls[wall as usize].is_near(side, p, near))
    }

    /// True if a piece, or a wall other than `wall`, is nearer to a point of a box than `near`.
    fn touched_but(&self, p: DVec3, cell: [usize; 3], near: f64, wall: u16) -> bool {
        let plan = self.cells.plan;
        let by_piece = plan.views.iter().enumerate().any(|(v, view)| {
            let axes = view.kind.axes();
            let at = [p[axes[0]], p[axes[1]]];
            pieces_in(plan, v, cell).iter().any(|&n| view.profile(n).value(at).abs() < near)
        });
        by_piece || self.touched_by_wall(p, cell, near, Some(wall))
    }

    /// Adds the cells on both sides of the grid planes before a box.
    fn add_grid_planes(&mut self, cell: [usize; 3]) {
        let (plan, step) = (self.cells.plan, self.step);
        let (lo, hi) = plan.bounds(cell);
        let samples = samples(self.cells, cell);
        for axis in (0..3).filter(|a| cell[*a] > 0) {
            let id = SurfaceId::Grid(axis, cell[axis]);
            let mut before = cell;
            before[axis] -= 1;
            // Not farther than a tenth of a thin box, to stay within it.
            let back = step.min(0.1 * (lo[axis] - plan.grid[axis][before[axis]]));
            let ahead = step.min(0.1 * (hi[axis] - lo[axis]));
            for s in samples {
                for t in samples {
                    let mut shares = [*s; 3];
                    shares[(axis + 1) % 3] = *t;
                    shares[axis] = 0.0;
                    let p = lo + (hi - lo) * DVec3::from_array(shares);
                    let (mut inside, mut outside) = (p, p);
                    inside[axis] += ahead;
                    outside[axis] -= back;
                    let pair = [self.cells.at_in(cell, inside), self.cells.at_in(before, outside)];
                    self.add(id, pair, |search| {
                        search.touched(p, cell, 3.0 * step, None)
                            || search.touched(p, before, 3.0 * step, None)
                    });
                }
            }
        }
    }

    /// Adds the cells on both sides of a wall in a box.
    fn add_wall(&mut self, cell: [usize; 3], (index, side): (u16, Side)) {
        let (cells, step) = (self.cells, self.step);
        let wall = &cells.plan.walls[index as usize];
        let id = SurfaceId::Wall(index as usize);
        let (lo, hi) = cells.plan.bounds(cell);
        for along_axis in 0..3 {
            let [a, b] = across(along_axis);
            for s in WALL_SAMPLES {
                for t in WALL_SAMPLES {
                    let mut p = DVec3::ZERO;
                    p[a] = lo[a] + s * (hi[a] - lo[a]);
                    p[b] = lo[b] + t * (hi[b] - lo[b]);
                    for depth in wall.crossings(side, along_axis, p, 0.0) {
                        p[along_axis] = depth;
                        // Points near the side of the box are skipped: the cells may differ because of it.
                        if !(0..3).all(|k| p[k] > lo[k] + 2.0 * step && p[k] < hi[k] - 2.0 * step) {
                            continue;
                        }
                        let n = wall.normal(p);
                        let pair = [cells.at(p + step * n), cells.at(p - step * n)];
                        self.add(id, pair, |search| search.touched_but(p, cell, 3.0 * step, index));
                    }
                }
            }
        }
    }

    /// Adds the cells on both sides of the pieces of a view in a box.
    fn add_pieces(&mut self, cell: [usize; 3], view: usize) {
        let (cells, step) = (self.cells, self.step);
        let (lo, hi) = cells.plan.bounds(cell);
        let samples = samples(cells, cell);
        let axes = cells.plan.views[view].kind.axes();
        for &piece in pieces_in(cells.plan, view, cell) {
            let found = &cells.plan.views[view].pieces[piece as usize];
            let id = SurfaceId::Carrier(view, found.carrier);
            let profile = cells.plan.views[view].profile(piece);
            for s in PIECE_SAMPLES {
                let m = profile.point(found.from + (found.to - found.from) * s);
                let normal = profile.normal(m);
                // Near a side of the box, the point across the piece may be in another box.
                let is_adjacent = (0..2).any(|k| {
                    let a = axes[k];
                    let room = (m[k] - lo[a]).min(hi[a] - m[k]);
                    room < 2.0 * step * normal[k].abs() && hi[a] - lo[a] > 20.0 * step
                });
                for t in samples.iter().filter(|_| !is_adjacent) {
                    let mut on = lo + (hi - lo) * DVec3::from_array([*t; 3]);
                    (on[axes[0]], on[axes[1]]) = (m[0], m[1]);
                    let side = |sign: f64| {
                        let mut p = on;
                        p[axes[0]] = m[0] + sign * step * normal[0];
                        p[axes[1]] = m[1] + sign * step * normal[1];
                        cells.at(p)
                    };
                    let pair = [side(1.0), side(-1.0)];
                    self.add(id, pair, |search| search.touched(on, cell, 3.0 * step, Some((view, piece))));
                }
            }
        }
    }
}

/// Shares at which surfaces in a box are sampled. In a box without drawn curves, one place is enough.
fn samples(cells: &Cells, cell: [usize; 3]) -> &'static [f64] {
    if is_plain(cells.plan, cell) { &SAMPLES[2..3] } else { &SAMPLES }
}
