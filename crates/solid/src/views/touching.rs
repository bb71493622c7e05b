//! Cylinders that touch other faces along a line.
//!
//! Where a hole touches a flat face, the solid on each side of the line has an edge there. On the cylinder,
//! these two coincident edges form a slit. Input: coedges of every surface. Output: coedges without slits:
//! - a slit that ends within the face of the cylinder is removed from it, and the faces beside the line share
//!   one edge;
//! - along a slit from end to end, the face borders itself. This line becomes the seam of the cylinder, or
//!   the face is divided at its seam.

use super::boundary::BoundaryBuilder;
use crate::brep::{Coedge, Edge, EdgeCurve, FaceSurface, unit};
use planish_core::DVec3;
use planish_estimate::Result;
use std::f64::consts::PI;

/// Number of intervals of an edge that are searched for a change of sign.
///
/// Two intersections within one interval are missed; more intervals take more time.
const STEPS: usize = 64;

impl BoundaryBuilder<'_, '_> {
    /// Removes slits from the loops of cylinders.
    ///
    /// # Errors
    /// `Input` if a boundary does not close.
    pub(super) fn part_touching_faces(&mut self) -> Result<()> {
        let cylinders: Vec<(usize, bool)> = self
            .coedges
            .keys()
            .copied()
            .filter(|(s, _)| matches!(self.surfaces[*s].surface(), FaceSurface::Cylinder { .. }))
            .collect();
        for key in cylinders {
            let uses = self.coedges[&key].clone();
            if !uses.iter().any(|a| uses.iter().any(|b| self.is_slit(*a, *b))) {
                continue;
            }
            let surface = self.surfaces[key.0].surface();
            let mut rings = self.loops(&surface, key.1, uses)?;
            for ring in &mut rings {
                self.close_slits(ring);
            }
            let left: Vec<Coedge> = rings.iter().flatten().copied().collect();
            self.coedges.insert(key, left);
            let through = rings
                .iter()
                .find_map(|ring| ring.iter().find(|a| ring.iter().any(|b| self.is_slit(**a, *b))));
            if let Some(coedge) = through {
                let edge = &self.solid.edges[coedge.edge];
                let at = surface.parameters(edge.curve.point(edge.range[0]))[0];
                if at.abs() > 1e-6 {
                    self.cut_along(key, &surface, 0.0);
                }
            }
        }
        Ok(())
    }

    /// True if two coedges are straight, coincident and opposite.
    fn is_slit(&self, a: Coedge, b: Coedge) -> bool {
        let line = |c: Coedge| matches!(self.solid.edges[c.edge].curve, EdgeCurve::Line { .. });
        let [from, to] = self.solid.ends(a);
        a.edge != b.edge && line(a) && line(b) && self.solid.ends(b) == [to, from]
    }

    /// Removes coincident opposite neighbours from a loop. The faces beside them then share one edge.
    fn close_slits(&mut self, ring: &mut Vec<Coedge>) {
        // Removing one pair may make its neighbours a pair, so this repeats.
        while let Some(k) = (0..ring.len()).find(|&k| self.is_slit(ring[k], ring[(k + 1) % ring.len()])) {
            let next = (k + 1) % ring.len();
            let (kept, removed) = (ring[k], ring[next]);
            ring.remove(k.max(next));
            ring.remove(k.min(next));
            for coedge in self.coedges.values_mut().flatten() {
                if coedge.edge == removed.edge {
                    let along = coedge.forward == removed.forward;
                    *coedge = Coedge { edge: kept.edge, forward: kept.forward != along };
                }
            }
        }
    }

    /// Divides the face of a cylinder along the straight line at an angle.
    fn cut_along(&mut self, key: (usize, bool), surface: &FaceSurface, angle: f64) {
        let mut at: Vec<(f64, usize)> = Vec::new();
        let mut edges: Vec<usize> = self.coedges[&key].iter().map(|c| c.edge).collect();
        // A seam occurs twice and must be cut once.
        edges.sort_unstable();
        edges.dedup();
        for index in edges {
            for (t, p) in self.crossings(index, surface, angle) {
                let ends = [self.solid.edges[index].start, self.solid.edges[index].end];
                let vertex = self.vertex(p);
                if !ends.contains(&vertex) {
                    self.cut_edge(index, t, vertex);
                }
                at.push((surface.parameters(p)[1], vertex));
            }
        }
        // Between two crossings, the line lies in the face only where the boundary is: solid on the inner
        // side and empty on the outer one.
        at.sort_by(|a, b| a.0.total_cmp(&b.0));
        at.dedup_by_key(|c| c.1);
        for pair in at.windows(2) {
            let middle = surface.point([angle, (pair[0].0 + pair[1].0) / 2.0]);
            let normal = surface.normal(middle);
            let step = 1e-5 * self.cells.plan.size;
            let [inside, outside] = [-step, step].map(|s| self.is_solid(middle + s * normal));
            if [inside, outside] != [key.1, !key.1] {
                continue;
            }
            let origin = self.solid.vertices[pair[0].1];
            let span = self.solid.vertices[pair[1].1] - origin;
            self.solid.edges.push(Edge {
                curve: EdgeCurve::Line { origin, direction: unit(span) },
                range: [0.0, span.length()],
                start: pair[0].1,
                end: pair[1].1,
            });

            let edge = self.solid.edges.len() - 1;
            // The new edge is a seam: the face is on both of its sides.
            let both = [true, false].map(|forward| Coedge { edge, forward });
            self.coedges.entry(key).or_default().extend(both);
        }
    }

    /// Intersections of an edge on a cylinder with the straight line at an angle: parameters and points.
    fn crossings(&self, index: usize, surface: &FaceSurface, angle: f64) -> Vec<(f64, DVec3)> {
        let edge = &self.solid.edges[index];
        if matches!(edge.curve, EdgeCurve::Line { .. }) {
            return Vec::new();
        }
        let off = |t: f64| {
            let turn = surface.parameters(edge.curve.point(t))[0] - angle;
            turn - 2.0 * PI * (turn / (2.0 * PI)).round()
        };
        let [from, to] = edge.range;
        let parameter = |k: usize| from + (to - from) * k as f64 / STEPS as f64;
        let mut found = Vec::new();
        for k in 0..STEPS {
            let (mut lo, mut hi) = (parameter(k), parameter(k + 1));
            let (first, last) = (off(lo), off(hi));
            // Differences of angles above 1 rad change their sign at the opposite side, by the jump of a
            // turn.
            let ends = first.abs().max(last.abs()) > 1.0;
            if ends || (first > 0.0) == (last > 0.0) && first.abs().min(last.abs()) > 1e-9 {
                continue;
            }
            for _ in 0..60 {
                let middle = (lo + hi) / 2.0;
                match (off(middle) > 0.0) == (first > 0.0) {
                    true => lo = middle,
                    false => hi = middle,
                }
            }
            let t = if first.abs() <= 1e-9 { parameter(k) } else { (lo + hi) / 2.0 };
            found.push((t, edge.curve.point(t)));
        }
        found
    }

    /// Divides an edge at a parameter. Every loop that used it then uses both parts.
    fn cut_edge(&mut self, index: usize, t: f64, vertex: usize) {
        let mut second = self.solid.edges[index].clone();
        second.range[0] = t;
        second.start = vertex;
        self.solid.edges.push(second);
        let first = &mut self.solid.edges[index];
        first.range[1] = t;
        first.end = vertex;
        let new = self.solid.edges.len() - 1;
        for uses in self.coedges.values_mut() {
            let added: Vec<Coedge> =
                uses.iter().filter(|c| c.edge == index).map(|c| Coedge { edge: new, ..*c }).collect();
            uses.extend(added);
        }
    }
}
