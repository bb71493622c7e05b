//! Sight tests along the outlines of walls, and along the curves in which they intersect other candidates.
//!
//! These are all places where a wall can cause a line. At each of them, either a line is drawn or there is no
//! edge.

use super::candidate_surface::{CandidateSurface, Side, across};
use super::cells::{Cells, pieces_in};
use super::profile::Profile;
use super::sight::{SightTestPlace, SightTests, style_near};
use super::turned_wall::Turned;
use crate::drawing::Drawing;
use planish_core::DVec3;
use std::f64::consts::TAU;

/// Positions of tests along an interval, as shares of it. Unequal, so that symmetric parts are not tested at
/// their planes of symmetry.
const SHARES: [f64; 3] = [0.13, 0.47, 0.86];
/// Number of tests around a circle. More find shorter missing lines and take more time.
const TESTS_AROUND: usize = 24;

impl SightTests {
    /// Adds the tests of all walls in a view.
    pub(super) fn at_walls(&mut self, cells: &Cells, drawing: &Drawing, view: usize) {
        for wall in &cells.plan.walls {
            match wall {
                CandidateSurface::Turned(wall) => self.outlines(cells, drawing, view, wall),
                CandidateSurface::Oblique(wall) => self.oblique_outlines(cells, drawing, view, wall),
            }
        }
        self.oblique_crossings(cells, drawing, view);
        let n = [0, 1, 2].map(|a| cells.plan.intervals(a));
        for i in 0..n[0] {
            for j in 0..n[1] {
                for k in 0..n[2] {
                    for &(wall, side) in cells.plan.walls_in([i, j, k]) {
                        self.wall_crossings(cells, drawing, view, [i, j, k], (wall as usize, side));
                    }
                }
            }
        }
    }

    /// Adds a test at a point of an edge in space with a given tangent.
    pub(super) fn at_point(
        &mut self,
        cells: &Cells,
        drawing: &Drawing,
        view: usize,
        p: DVec3,
        tangent: DVec3,
    ) {
        let axes = cells.plan.views[view].kind.axes();
        let at = [p[axes[0]], p[axes[1]]];
        let across = [-tangent[axes[1]], tangent[axes[0]]];
        // Along the line of sight, an edge is a point in the view and no line can be drawn for it.
        let length = across[0].hypot(across[1]);
        if length < 1e-6 * tangent.length() || length == 0.0 {
            return;
        }
        let normal = across.map(|c| c / length);
        let Some(style) = style_near(cells, drawing, view, at, Some(normal)) else {
            return;
        };
        let place = SightTestPlace { view, at, curve: style.map(|s| s.1) };
        self.add(cells, place, style.map(|s| s.0), normal, 1e-5 * cells.plan.size);
    }

    /// Adds tests along the outlines of a surface of revolution.
    fn outlines(&mut self, cells: &Cells, drawing: &Drawing, view: usize, wall: &Turned) {
        let axes = cells.plan.views[view].kind.axes();
        if axes[2] == wall.axis {
            // Seen along its axis, a torus or sphere has its widest and narrowest circles as outlines. A cone
            // has none: it ends at edges.
            let Profile::Circle { center, radius } = wall.profile else {
                return;
            };
            for distance in [center[0] - radius, center[0] + radius].into_iter().filter(|r| *r > 0.0) {
                for k in 0..TESTS_AROUND {
                    let angle = TAU * (k as f64 + 0.37) / TESTS_AROUND as f64;
                    let p = wall.point(angle, [distance, center[1]]);
                    let further = wall.point(angle + TAU / 4.0, [distance, center[1]]);
                    let middle = wall.point(0.0, [0.0, center[1]]);
                    let tangent = further - middle;
                    self.at_point(cells, drawing, view, p, tangent);
                }
            }
            return;
        }
        // Seen across its axis, the outline is the profile on both sides of the axis.
        let sideways = if axes[0] == wall.axis { axes[1] } else { axes[0] };
        let angle = if across(wall.axis)[0] == sideways { 0.0 } else { TAU / 4.0 };
        let grid = &cells.plan.grid[wall.axis];
        let mut heights: Vec<f64> = Vec::new();
        for ends in grid.windows(2) {
            let inside = |e: &super::candidate_surface::Extent| {
                e.bounds[wall.axis][0] < (ends[0] + ends[1]) / 2.0
                    && (ends[0] + ends[1]) / 2.0 < e.bounds[wall.axis][1]
            };
            if wall.extents.iter().any(inside) {
                heights.extend(SHARES.map(|s| ends[0] + s * (ends[1] - ends[0])));
            }
        }
        for height in heights {
            for distance in wall.profile.crossings(1, height, 0.0).into_iter().filter(|r| *r > 0.0) {
                let n = wall.profile.normal([distance, height]);
                for turn in [angle, angle + TAU / 2.0] {
                    let p = wall.point(turn, [distance, height]);
                    let sign = if turn == angle { 1.0 } else { -1.0 };
                    let mut tangent = DVec3::ZERO;
                    (tangent[sideways], tangent[wall.axis]) = (-n[1] * sign, n[0]);
                    self.at_point(cells, drawing, view, p, tangent);
                }
            }
        }
    }

    /// Adds tests where a wall intersects other candidates in a box.
    fn wall_crossings(
        &mut self,
        cells: &Cells,
        drawing: &Drawing,
        view: usize,
        cell: [usize; 3],
        of: (usize, Side),
    ) {
        let plan = cells.plan;
        let wall = &plan.walls[of.0];
        let (lo, hi) = plan.bounds(cell);
        let inside =
            |p: &DVec3| (0..3).all(|a| p[a] >= lo[a] - plan.tolerance && p[a] <= hi[a] + plan.tolerance);
        let sight = plan.views[view].kind.axes()[2];
        // With the grid planes across the line of sight: other views see these edge-on, this one does not.
        for value in [lo[sight], hi[sight]] {
            for (along, other) in [(0, 1), (1, 0)].map(|(i, j)| (across(sight)[i], across(sight)[j])) {
                for share in SHARES {
                    let mut p = DVec3::ZERO;
                    p[sight] = value;
                    p[other] = lo[other] + share * (hi[other] - lo[other]);
                    for at in wall.crossings(of.1, along, p, 0.0) {
                        let mut p = p;
                        p[along] = at;
                        if inside(&p) {
                            let mut normal = DVec3::ZERO;
                            normal[sight] = 1.0;
                            self.at_point(cells, drawing, view, p, wall.normal(p).cross(normal));
                        }
                    }
                }
            }
        }
        // With the surfaces that other views see edge-on.
        for (v, other) in plan.views.iter().enumerate().filter(|(v, _)| *v != view) {
            let axes = other.kind.axes();
            for &piece in pieces_in(plan, v, cell) {
                let found = &other.pieces[piece as usize];
                let profile = other.profile(piece);
                for share in SHARES {
                    let m = profile.point(found.from + share * (found.to - found.from));
                    let n = profile.normal(m);
                    let (mut p, mut normal) = (DVec3::ZERO, DVec3::ZERO);
                    for k in 0..2 {
                        p[axes[k]] = m[k];
                        normal[axes[k]] = n[k];
                    }
                    for at in wall.crossings(of.1, axes[2], p, 0.0) {
                        let mut p = p;
                        p[axes[2]] = at;
                        if inside(&p) {
                            self.at_point(cells, drawing, view, p, wall.normal(p).cross(normal));
                        }
                    }
                }
            }
        }
        // With other walls, by Newton's method from several starting points: these curves have no simple
        // form.
        for &(index, _) in plan.walls_in(cell).iter().filter(|w| (w.0 as usize) > of.0) {
            let second = &plan.walls[index as usize];
            for shares in [
                DVec3::new(0.1, 0.3, 0.5),
                DVec3::new(0.5, 0.9, 0.3),
                DVec3::new(0.9, 0.5, 0.7),
                DVec3::new(0.4, 0.2, 0.9),
                DVec3::new(0.7, 0.7, 0.1),
            ] {
                let start = lo + shares * (hi - lo);
                if let Some(p) = on_both(wall, second, start, plan.tolerance)
                    && inside(&p)
                {
                    let tangent = wall.normal(p).cross(second.normal(p));
                    self.at_point(cells, drawing, view, p, tangent);
                }
            }
        }
    }
}

/// A point on two walls near a starting point; `None` if Newton's method does not converge.
fn on_both(a: &CandidateSurface, b: &CandidateSurface, mut p: DVec3, tolerance: f64) -> Option<DVec3> {
    for _ in 0..20 {
        let (u, v) = (a.value(p), b.value(p));
        if u.abs().max(v.abs()) < 0.01 * tolerance {
            return Some(p);
        }
        let (n, m) = (a.normal(p), b.normal(p));
        // The shortest step onto both tangent planes.
        let c = n.dot(m);
        let det = 1.0 - c * c;
        if det < 1e-9 {
            return None;
        }
        let (s, t) = ((u - c * v) / det, (v - c * u) / det);
        p = p - s * n - t * m;
    }
    None
}
