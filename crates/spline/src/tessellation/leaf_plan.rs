//! The vertices and triangles of one leaf of a mesh.

use super::{SIDES, Side};
use crate::surface::Surface;
use planish_core::DVec3;

/// Vertices of a leaf in their order: border ring, inner points of the grid, centres of fans.
pub(super) struct LeafPlan {
    /// Lattice steps along a side of the leaf.
    pub length: u32,
    /// Lattice steps between its own grid lines, along u and v.
    pub steps: [u32; 2],
    /// Distances along the sides in the order of [`SIDES`], each from its start in u or v, both ends
    /// included; a side that is a pole has one entry.
    pub offsets: Vec<u32>,
    pub ends: [u32; 4],
    pub polar: [bool; 4],
    /// Counter-clockwise from the lower left corner: lattice points at first, vertex numbers after
    /// [`number_vertices`].
    pub ring: Vec<u64>,
    /// Number of the first vertex owned by this leaf.
    pub first_own: u32,
    /// The vertices of the ring owned by this leaf.
    pub own_ring: Vec<u32>,
    pub middles: u32,
}

/// Lattice coordinates in the leaf of a vertex of the ring.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RingPlace {
    pub x: u32,
    pub y: u32,
    pub at_pole: bool,
}

/// An evaluated vertex.
pub(super) struct Vertex {
    pub leaf: u32,
    pub local: [f64; 2],
    pub position: DVec3,
    pub normal: DVec3,
}

impl LeafPlan {
    /// Divisions along u and v.
    pub(super) fn grid(&self) -> [u32; 2] {
        self.steps.map(|step| self.length / step)
    }

    pub(super) fn side(&self, s: usize) -> &[u32] {
        let from = if s == 0 { 0 } else { self.ends[s - 1] as usize };
        &self.offsets[from..self.ends[s] as usize]
    }

    /// Number of edges of the border.
    pub(super) fn ring_length(&self) -> usize {
        self.offsets.len() - 4
    }

    /// Index in the ring of the `k`-th vertex of a side, counted in the direction of u or v.
    pub(super) fn ring_index(&self, s: usize, k: usize) -> usize {
        let edges = |s: usize| self.side(s).len() - 1;
        let index = match SIDES[s] {
            Side::Bottom => k,
            Side::Right => edges(0) + k,
            Side::Top => edges(0) + edges(1) + edges(2) - k,
            Side::Left => self.ring_length() - k,
        };
        index % self.ring_length()
    }

    /// Positions of the vertices of the ring.
    pub(super) fn ring_places(&self) -> Vec<RingPlace> {
        let mut places = vec![RingPlace::default(); self.ring_length()];
        for (s, side) in SIDES.into_iter().enumerate() {
            for (k, &offset) in self.side(s).iter().enumerate() {
                let place = &mut places[self.ring_index(s, k)];
                if place.at_pole {
                    continue;
                }
                let [x, y] = match side {
                    Side::Bottom => [offset, 0],
                    Side::Right => [self.length, offset],
                    Side::Top => [offset, self.length],
                    Side::Left => [0, offset],
                };
                let at_pole = self.polar[s];
                *place = RingPlace { x, y, at_pole };
            }
        }
        places
    }

    /// True if a rectangle of the grid does not touch the border.
    pub(super) fn is_inside(&self, a: u32, b: u32) -> bool {
        let [nu, nv] = self.grid();
        a > 0 && b > 0 && a + 1 < nu && b + 1 < nv
    }

    pub(super) fn inner_count(&self) -> u32 {
        let [nu, nv] = self.grid();
        (nu - 1) * (nv - 1)
    }

    pub(super) fn inner(&self, a: u32, b: u32) -> u32 {
        self.ring_length() as u32 + (b - 1) * (self.grid()[0] - 1) + a - 1
    }

    /// Index in the ring of a distance along a side; at a pole, the index of the pole.
    pub(super) fn on_side(&self, s: usize, offset: u32) -> u32 {
        // Offsets are ascending. The minimum handles poles, whose side has one vertex.
        let k = self.side(s).partition_point(|&o| o < offset);
        self.ring_index(s, k.min(self.side(s).len() - 1)) as u32
    }

    pub(super) fn grid_point(&self, a: u32, b: u32) -> u32 {
        let [nu, nv] = self.grid();
        let (x, y) = (a * self.steps[0], b * self.steps[1]);
        if b == 0 {
            self.on_side(0, x)
        } else if b == nv {
            self.on_side(2, x)
        } else if a == nu {
            self.on_side(1, y)
        } else if a == 0 {
            self.on_side(3, y)
        } else {
            self.inner(a, b)
        }
    }

    /// All vertices around a rectangle of the grid, counter-clockwise; a side at a pole is one vertex.
    pub(super) fn polygon(&self, a: u32, b: u32, out: &mut Vec<u32>) {
        let [nu, nv] = self.grid();
        let [x, y] = [a * self.steps[0], b * self.steps[1]];
        out.clear();
        // Vertices strictly between two points of a border side.
        let between = |s: usize, from: u32, to: u32| {
            let offsets = self.side(s);
            let first = offsets.partition_point(|&o| o <= from);
            let last = offsets.partition_point(|&o| o < to);
            (first..last.max(first)).map(move |k| self.ring_index(s, k) as u32)
        };
        out.push(self.grid_point(a, b));
        if b == 0 && !self.polar[0] {
            out.extend(between(0, x, x + self.steps[0]));
        }
        out.push(self.grid_point(a + 1, b));
        if a + 1 == nu {
            out.extend(between(1, y, y + self.steps[1]));
        }
        out.push(self.grid_point(a + 1, b + 1));
        if b + 1 == nv && !self.polar[2] {
            out.extend(between(2, x, x + self.steps[0]).rev());
        }
        out.push(self.grid_point(a, b + 1));
        if a == 0 {
            out.extend(between(3, y, y + self.steps[1]).rev());
        }
        // At a pole two corners of the rectangle are one vertex.
        out.dedup();
        if out.first() == out.last() {
            out.pop();
        }
    }

    /// True if a polygon in row `b` of the grid has more corners than two triangles (at a pole: one).
    pub(super) fn needs_middle(&self, b: u32, polygon: &[u32]) -> bool {
        // A rectangle at a pole is a triangle. More corners than that mean vertices of a finer neighbour; a
        // fan around the centre connects them without slivers.
        let at_pole = self.polar[0] && b == 0 || self.polar[2] && b + 1 == self.grid()[1];
        polygon.len() > if at_pole { 3 } else { 4 }
    }

    /// Visits the rectangles of the grid in order, with column, row, corners, and true for a fan around its
    /// centre.
    pub(super) fn for_each_polygon(&self, mut visit: impl FnMut(u32, u32, &[u32], bool)) {
        let [nu, nv] = self.grid();
        // Numbering and triangulation visit the same rectangles, so both use this function and cannot
        // disagree.
        let mut polygon = Vec::new();
        for b in 0..nv {
            for a in 0..nu {
                if self.is_inside(a, b) {
                    let corners = [
                        self.inner(a, b),
                        self.inner(a + 1, b),
                        self.inner(a + 1, b + 1),
                        self.inner(a, b + 1),
                    ];
                    visit(a, b, &corners, false);
                } else {
                    self.polygon(a, b, &mut polygon);
                    visit(a, b, &polygon, self.needs_middle(b, &polygon));
                }
            }
        }
    }

    /// The vertices owned by this leaf, in the order of their numbers.
    pub(super) fn vertices(&self, surface: &Surface, leaf: usize) -> Vec<Vertex> {
        let mut out = Vec::with_capacity(self.own_ring.len() + (self.inner_count() + self.middles) as usize);
        let scale = 1.0 / f64::from(self.length);
        let mut add = |x: f64, y: f64, at_pole: bool| {
            let local = [x * scale, y * scale];
            let jet = surface.leaf_jet(leaf, local[0], local[1]);
            out.push(Vertex {
                leaf: leaf as u32,
                local,
                position: jet.point,
                normal: normal(surface, leaf, local, at_pole),
            });
        };
        // In the order in which `number_vertices` counted: own points of the ring, inner points, centres.
        let places = self.ring_places();
        for &index in &self.own_ring {
            let place = places[index as usize];
            add(f64::from(place.x), f64::from(place.y), place.at_pole);
        }
        let [nu, nv] = self.grid();
        let [hu, hv] = self.steps.map(f64::from);
        for b in 1..nv {
            for a in 1..nu {
                add(f64::from(a) * hu, f64::from(b) * hv, false);
            }
        }
        if self.middles > 0 {
            self.for_each_polygon(|a, b, _, middle| {
                if middle {
                    add((f64::from(a) + 0.5) * hu, (f64::from(b) + 0.5) * hv, false);
                }
            });
        }
        out
    }

    /// Adds the triangles of the squares for whose middles, in the leaf, `is_kept` is true.
    pub(super) fn triangulate(
        &self,
        positions: &[DVec3],
        is_kept: impl Fn([f64; 2]) -> bool,
        out: &mut Vec<[u32; 3]>,
    ) {
        let ring = self.ring_length() as u32;
        let first_inner = self.first_own + self.own_ring.len() as u32;
        let number = |index: u32| {
            if index < ring { self.ring[index as usize] as u32 } else { first_inner + (index - ring) }
        };
        // The order of `vertices`.
        let mut middle = first_inner + self.inner_count();
        let [hu, hv] = self.steps.map(|step| f64::from(step) / f64::from(self.length));
        self.for_each_polygon(|a, b, polygon, has_middle| {
            if !is_kept([(f64::from(a) + 0.5) * hu, (f64::from(b) + 0.5) * hv]) {
                middle += u32::from(has_middle);
            } else if has_middle {
                for k in 0..polygon.len() {
                    let next = polygon[(k + 1) % polygon.len()];
                    out.push([middle, number(polygon[k]), number(next)]);
                }
                middle += 1;
            } else if let [a, b, c, d] = *polygon {
                let [a, b, c, d] = [a, b, c, d].map(number);
                let length = |p: u32, q: u32| positions[p as usize].distance(positions[q as usize]);
                // The shorter diagonal gives the rounder triangles.
                if length(a, c) <= length(b, d) {
                    out.extend([[a, b, c], [a, c, d]]);
                } else {
                    out.extend([[a, b, d], [b, c, d]]);
                }
            } else if let [a, b, c] = *polygon {
                out.push([a, b, c].map(number));
            }
        });
    }
}

/// The unit normal at a leaf-local point, or that of the nearest regular point towards the centre of the
/// leaf.
fn normal(surface: &Surface, leaf: usize, local: [f64; 2], at_pole: bool) -> DVec3 {
    if at_pole {
        let [u, v] = surface.space().parameters(leaf, local);
        if let Some(normal) = surface.normal(u, v) {
            return normal;
        }
    }
    // Where derivatives vanish, a point slightly inside has a normal that differs by the order of the
    // distance.
    for towards in [0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.5, 1.0] {
        let [s, t] = local.map(|x| x + towards * (0.5 - x));
        let jet = surface.leaf_jet(leaf, s, t);
        let n = jet.du.cross(jet.dv);
        // Below this threshold the direction of S_u × S_v is dominated by rounding.
        if n.length_squared() > 1e-24 * jet.du.length_squared() * jet.dv.length_squared()
            && let Some(normal) = n.try_normalize()
        {
            return normal;
        }
    }
    DVec3::ZERO
}
