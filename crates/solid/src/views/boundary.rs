//! Boundary representation of the solid cells.
//!
//! A surface is *used* if a solid cell lies on exactly one of its sides. Two used surfaces intersect along
//! curves, which other surfaces divide at vertices. Half-surfaces surround the middle of each curve segment.
//! Those between a solid and an empty sector belong to the boundary. An edge exists where two different
//! surfaces bound a solid sector. Edges are chained to loops on each surface, and loops bound maximal faces.

use super::candidates::Candidate;
use super::cells::Cells;
use super::column::SurfaceId;
use super::edge_splines::{SPLINE_PIECES, TRACED_PIECES, spline, traced_spline};
use super::intersections::{CurveId, Intersections};
use super::rings::faces;
use super::search::{Assignment, CellState};
use super::surfaces::Curve3;
use super::turned_rings::{turned_faces, with_free_poles};
use crate::brep::{Coedge, Edge, EdgeCurve, Face, FaceSurface, Solid, unit};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::{PI, TAU};
use std::rc::Rc;

/// A boundary under construction.
pub(super) struct BoundaryBuilder<'a, 'b> {
    pub(super) cells: &'a Cells<'a>,
    intersections: &'b mut Intersections<'a>,
    assignment: &'b Assignment,
    state: CellState,
    ids: Vec<SurfaceId>,
    pub(super) surfaces: Vec<Rc<Candidate>>,
    pub(super) solid: Solid,
    /// Coedges by surface, and by whether the face's outward normal is the surface's normal.
    ///
    /// A surface may bound the solid on either side in different places; these are different faces.
    pub(super) coedges: BTreeMap<(usize, bool), Vec<Coedge>>,
    /// Distance below which points are equal.
    pub(super) tolerance: f64,
}

/// Distance below which points are equal: five times that of the grid, as intersections amplify rounding.
pub(super) fn tolerance(cells: &Cells) -> f64 {
    5.0 * cells.plan.tolerance
}

/// Builds the boundary of the cells that have a state.
///
/// # Errors
/// `Input` if the boundary does not close.
pub(super) fn boundary<'a>(
    cells: &'a Cells<'a>,
    intersections: &mut Intersections<'a>,
    assignment: &Assignment,
    state: CellState,
) -> Result<Solid> {
    let mut builder = BoundaryBuilder {
        cells,
        intersections,
        assignment,
        state,
        ids: Vec::new(),
        surfaces: Vec::new(),
        solid: Solid::default(),
        coedges: BTreeMap::new(),
        tolerance: tolerance(cells),
    };
    builder.ids = builder.intersections.used(|cell| assignment.get(&cell) == Some(&state));
    builder.surfaces = builder.ids.iter().map(|id| builder.intersections.surface(*id)).collect();
    builder.make_edges();
    // Before faces are made: lines along which faces touch must be cut into the loops first.
    builder.part_touching_faces()?;
    builder.make_faces()?;
    builder.solid.drop_unused_edges();
    builder.solid.part_vertices();
    Ok(builder.solid)
}

impl BoundaryBuilder<'_, '_> {
    pub(super) fn is_solid(&self, p: DVec3) -> bool {
        self.assignment.get(&self.cells.at(p)) == Some(&self.state)
    }

    /// Intersects all pairs of used surfaces and cuts the curves at all third surfaces.
    fn make_edges(&mut self) {
        let n = self.surfaces.len();
        for s in 0..n {
            for t in s + 1..n {
                let ids = [self.ids[s], self.ids[t]];
                for (index, meeting) in self.intersections.curves(ids).iter().enumerate() {
                    let id = (ids, index);
                    let mut cuts = self.intersections.cuts(id, meeting, None).to_vec();
                    for u in (0..n).filter(|u| *u != s && *u != t) {
                        cuts.extend_from_slice(&self.intersections.cuts(id, meeting, Some(self.ids[u])));
                    }
                    self.cut(id, &meeting.curve, cuts, [s, t]);
                }
            }
        }
    }

    /// Cuts a curve at points and keeps the intervals that are edges.
    fn cut(&mut self, id: CurveId, curve: &Curve3, points: Vec<(f64, DVec3)>, pair: [usize; 2]) {
        let near = self.tolerance;
        let mut cuts: Vec<(f64, DVec3)> = Vec::new();
        for (t, p) in points {
            // Several surfaces may pass through one vertex, and each finds it with its own rounding.
            if !cuts.iter().any(|c| (c.1 - p).length() < 20.0 * near) {
                cuts.push((t, p));
            }
        }
        cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
        let period = curve.period();
        if let (Some(period), true) = (period, cuts.is_empty()) {
            self.add_stretch((id, curve), [0.0, period], None, pair);
            return;
        }
        for k in 0..cuts.len() {
            let (from, p) = cuts[k];
            match cuts.get(k + 1) {
                Some((to, q)) => self.add_stretch((id, curve), [from, *to], Some([p, *q]), pair),
                None => {
                    if let Some(period) = period {
                        let range = [from, cuts[0].0 + period];
                        self.add_stretch((id, curve), range, Some([p, cuts[0].1]), pair);
                    }
                }
            }
        }
    }

    /// Adds an interval of a curve as an edge for each solid wedge around it between the two surfaces.
    ///
    /// The states around the middle decide: no other surface crosses an interval between two cuts. Several
    /// wedges (where the solid touches itself) give several coincident edges.
    fn add_stretch(
        &mut self,
        (id, curve): (CurveId, &Curve3),
        range: [f64; 2],
        ends: Option<[DVec3; 2]>,
        pair: [usize; 2],
    ) {
        let middle = (range[0] + range[1]) / 2.0;
        let m = curve.point(middle);
        // By central differences, as curves of all kinds have points but not all have derivatives.
        let h = 1e-4 * (range[1] - range[0]);
        let tangent = unit(curve.point(middle + h) - curve.point(middle - h));
        // A surface that passes beside the curve must not come between the points around it: near a tangent
        // plane, a cylinder is as close as the square of the distance from the contact.
        let clear = self.surfaces.iter().map(|s| s.value(m).abs()).filter(|far| *far > 2.0 * self.tolerance);
        let step = clear.fold(1e-5 * self.cells.plan.size, |step, far| step.min(0.3 * far));
        let halves = self.halves(m, tangent, step);
        let count = halves.len();
        if count < 2 {
            return;
        }
        // Angles run counter-clockwise about the tangent, in the same frame as those of `halves`.
        let (e1, e2) = planish_core::vector3::tangents(tangent);
        let (e1, e2) = match e1.cross(e2).dot(tangent) > 0.0 {
            true => (e1, e2),
            false => (e2, e1),
        };
        let at = |angle: f64| m + step * angle.cos() * e1 + step * angle.sin() * e2;
        let states: Vec<bool> = (0..count)
            .map(|k| {
                let next = halves[(k + 1) % count].0 + if k + 1 == count { TAU } else { 0.0 };
                self.is_solid(at((halves[k].0 + next) / 2.0))
            })
            .collect();
        // Runs of solid sectors, each between two half-surfaces. Surfaces with the same state on both sides
        // do not divide a run.
        for first in 0..count {
            if !states[first] || states[(first + count - 1) % count] {
                continue;
            }
            let mut last = first;
            while states[(last + 1) % count] {
                last += 1;
            }
            let (a, b) = (halves[first], halves[(last + 1) % count]);
            // Other pairs of surfaces through this curve add this edge themselves. One surface on both sides
            // is no edge: the boundary passes through smoothly.
            let is_pair = [a.1, b.1] == pair || [b.1, a.1] == pair;
            if a.1 == b.1 || !is_pair {
                continue;
            }
            let edge = self.add_edge((id, curve), range, ends);
            for (half, begins) in [(a, true), (b, false)] {
                let (sin, cos) = half.0.sin_cos();
                let w = DVec3::ZERO + cos * e1 + sin * e2;
                let outward = if begins { w.cross(tangent) } else { tangent.cross(w) };
                let same = outward.dot(self.surfaces[half.1].normal(m)) > 0.0;
                self.coedges.entry((half.1, same)).or_default().push(Coedge { edge, forward: !begins });
            }
        }
    }

    /// Half-surfaces around a point of a curve: angle about the tangent and surface, ascending.
    fn halves(&self, m: DVec3, tangent: DVec3, step: f64) -> Vec<(f64, usize)> {
        let (e1, e2) = planish_core::vector3::tangents(tangent);
        let (e1, e2) = match e1.cross(e2).dot(tangent) > 0.0 {
            true => (e1, e2),
            false => (e2, e1),
        };
        let mut halves = Vec::new();
        for (index, surface) in self.surfaces.iter().enumerate() {
            if surface.value(m).abs() > 2.0 * self.tolerance {
                continue;
            }
            // On an apex or an axis, a surface has no normal.
            let across = tangent.cross(surface.normal(m));
            if across.length() < 1e-6 {
                continue;
            }
            // A step along the tangent plane, then Newton's method back to the surface: curved surfaces leave
            // their tangent planes, and two that touch differ only by this.
            for sign in [-1.0, 1.0] {
                let mut p = m + sign * step * unit(across);
                for _ in 0..3 {
                    p -= surface.value(p) * surface.normal(p);
                }
                let d = p - m;
                halves.push((d.dot(e2).atan2(d.dot(e1)), index));
            }
        }
        halves.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        halves
    }

    /// The vertex at a point, added if there is none yet.
    ///
    /// The distance is twice that of distinct cuts, so that cuts of several curves at one vertex agree.
    pub(super) fn vertex(&mut self, p: DVec3) -> usize {
        let near = 40.0 * self.tolerance;
        match self.solid.vertices.iter().position(|v| (*v - p).length() < near) {
            Some(found) => found,
            None => {
                self.solid.vertices.push(p);
                self.solid.vertices.len() - 1
            }
        }
    }

    fn add_edge(
        &mut self,
        (id, curve): (CurveId, &Curve3),
        range: [f64; 2],
        ends: Option<[DVec3; 2]>,
    ) -> usize {
        let [start, end] = match ends {
            Some([p, q]) => [self.vertex(p), self.vertex(q)],
            None => [self.vertex(curve.point(range[0])); 2],
        };
        let (curve, range) = match curve {
            Curve3::Line { origin, direction } => {
                (EdgeCurve::Line { origin: *origin, direction: *direction }, range)
            }
            // The first semi-axis of an edge is not the shorter one (see `EdgeCurve::Ellipse`).
            Curve3::Ellipse { center, a, b } => match a.length() >= b.length() * (1.0 - 1e-12) {
                true => (EdgeCurve::Ellipse { center: *center, a: *a, b: *b }, range),
                // t = s + π/2 turns (a, b) into (b, −a).
                false => (
                    EdgeCurve::Ellipse { center: *center, a: *b, b: a.map(|c| -c) },
                    range.map(|t| t - PI / 2.0),
                ),
            },
            Curve3::Branch { .. } => {
                let curve = self.intersections.edge(id, range, ends, || spline(curve, range));
                (curve, [0.0, SPLINE_PIECES as f64])
            }
            Curve3::Traced(traced) => {
                let curve = self.intersections.edge(id, range, ends, || traced_spline(traced, range, ends));
                (curve, [0.0, TRACED_PIECES as f64])
            }
        };
        self.solid.edges.push(Edge { curve, range, start, end });
        self.solid.edges.len() - 1
    }

    fn make_faces(&mut self) -> Result<()> {
        let coedges = std::mem::take(&mut self.coedges);
        let edged: BTreeSet<usize> = coedges.keys().map(|key| key.0).collect();
        for ((index, outward), uses) in coedges {
            let surface = self.surfaces[index].surface();
            let loops = self.loops(&surface, outward, uses)?;
            let is_extruded = matches!(surface, FaceSurface::Plane { .. } | FaceSurface::Cylinder { .. });
            let grouped = match is_extruded {
                true => faces(&self.solid, &surface, outward, loops),
                false => turned_faces(&self.solid, &surface, outward, loops),
            };
            for loops in grouped {
                let surface = with_free_poles(&self.solid, surface, &loops);
                self.solid.faces.push(Face { surface, outward, loops });
            }
        }
        self.add_untrimmed_faces(&edged);
        Ok(())
    }

    /// Adds the spheres and tori that are faces as a whole, without any edge on them.
    ///
    /// The states are compared at a lattice of points; all must agree, since a surface without edges lies
    /// either completely on the boundary or not at all.
    fn add_untrimmed_faces(&mut self, edged: &BTreeSet<usize>) {
        const PLACES: usize = 12;
        let step = 1e-5 * self.cells.plan.size;
        for index in (0..self.surfaces.len()).filter(|k| !edged.contains(k)) {
            let surface = self.surfaces[index].surface();
            let height = match surface {
                FaceSurface::Sphere { .. } => PI,
                FaceSurface::Torus { .. } => TAU,
                _ => continue,
            };
            let share = |k: usize| (k as f64 + 0.37) / PLACES as f64;
            let places = (0..PLACES).flat_map(|i| (0..PLACES).map(move |j| [i, j]));
            let mut states = places.map(|[i, j]| {
                let p = surface.point([TAU * share(i), height * (share(j) - 0.5)]);
                let n = surface.normal(p);
                [-step, step].map(|s| self.is_solid(p + s * n))
            });
            let Some(first) = states.next().filter(|s| s[0] != s[1]) else {
                continue;
            };
            if states.all(|s| s == first) {
                self.solid.add_untrimmed(surface, first[0]);
            }
        }
    }

    /// Chains coedges to loops.
    ///
    /// If several coedges start at a vertex, the loop continues with the one that leaves the narrowest corner
    /// of the face. Faces that touch at a vertex then get loops of their own, which do not cross.
    ///
    /// # Errors
    /// `Input` if a loop does not close.
    pub(super) fn loops(
        &self,
        surface: &FaceSurface,
        outward: bool,
        mut uses: Vec<Coedge>,
    ) -> Result<Vec<Vec<Coedge>>> {
        let mut loops = Vec::new();
        while let Some(first) = uses.pop() {
            let mut ring = vec![first];
            loop {
                let last = ring[ring.len() - 1];
                let at = self.solid.ends(last)[1];
                if at == self.solid.ends(first)[0]
                    && self.next(surface, outward, last, at, &uses, Some(first)).is_none()
                {
                    break;
                }
                let Some(next) = self.next(surface, outward, last, at, &uses, None) else {
                    let p = self.solid.vertices[at];
                    return Err(Error::input(format!(
                        "the boundary does not close at {:.4} {:.4} {:.4} on a {}",
                        p[0],
                        p[1],
                        p[2],
                        surface.kind()
                    )));
                };
                ring.push(uses.swap_remove(next));
            }
            loops.push(ring);
        }
        Ok(loops)
    }

    /// The best continuation at a vertex; `None` if `closing` is at least as good.
    fn next(
        &self,
        surface: &FaceSurface,
        outward: bool,
        last: Coedge,
        at: usize,
        uses: &[Coedge],
        closing: Option<Coedge>,
    ) -> Option<usize> {
        let p = self.solid.vertices[at];
        let n = surface.normal(p).map(|c| if outward { c } else { -c });
        // Direction of an edge near the vertex: a chord over 1 % of its parameter range. Tangents at the
        // vertex itself would be equal for edges that touch there.
        let away = |coedge: Coedge, from_start: bool| {
            let edge = &self.solid.edges[coedge.edge];
            let [lo, hi] = edge.range;
            let near_lo = coedge.forward == from_start;
            let t = if near_lo { lo + 0.01 * (hi - lo) } else { hi - 0.01 * (hi - lo) };
            unit(edge.curve.point(t) - p)
        };
        let back = away(last, false);
        let side = n.cross(back);
        // Angle clockwise from the direction in which the loop came. Back along the same way is a whole turn,
        // the last choice.
        let turn = |coedge: Coedge| {
            let d = away(coedge, true);
            let angle = -d.dot(side).atan2(d.dot(back));
            if angle <= 1e-9 { angle + TAU } else { angle }
        };
        let limit = closing.map_or(f64::MAX, turn);
        (0..uses.len())
            .filter(|&k| self.solid.ends(uses[k])[0] == at)
            .map(|k| (turn(uses[k]), k))
            .filter(|(angle, _)| *angle < limit)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, k)| k)
    }
}
