//! Solids from sections along one axis: slabs with steps, pockets and holes between flat faces.
//!
//! Input: [`Slab`]s, each a section that is constant between two heights. Output: a [`Solid`] of planes and
//! cylinders. Not guaranteed: walls of two slabs that continue each other stay two faces with an edge between
//! them. Curves of two sections that cross, or touch without being equal, are refused.
//!
//! ```text
//! Slab ─► Region (directed pieces, material on the left) ─► atoms at each interface ─► walls, flat faces
//! ```

mod plane;

use crate::brep::{Coedge, Edge, EdgeCurve, Face, FaceSurface, Solid};
use plane::{Atom, AtomCurve, Directed, Interface, Points, Region};
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A closed curve of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum SectionLoop {
    /// A circle.
    Circle {
        /// Its centre.
        center: [f64; 2],
        /// Its radius.
        radius: f64,
    },
    /// Lines and arcs.
    Outline {
        /// Vertices, in either direction.
        vertices: Vec<[f64; 2]>,
        /// Bulge of the piece from each vertex to the next: `tan(α/4)` of an arc of angle α, 0 of a line.
        bulges: Vec<f64>,
    },
}

/// A part of a solid with the same section everywhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Slab {
    /// Height of its lower end.
    pub bottom: f64,
    /// Height of its upper end: the lower end of the next slab.
    pub top: f64,
    /// Its section. Loops inside an odd number of others are holes.
    pub loops: Vec<SectionLoop>,
}

/// Distance, as a fraction of the extent, within which points are the same: rounding of an adjustment.
const COINCIDENCE: f64 = 1e-7;

/// The solid of slabs, in ascending order, from sections in x and y along z.
///
/// # Errors
/// `Input` if a slab is not above the one before or has no loop; `Unsupported` if curves of two sections
/// cross or nearly coincide; `Undetermined` if the slabs do not form one closed body.
///
/// # Examples
/// ```
/// use planish_solid::stack::{SectionLoop, Slab, stack_of};
///
/// let disc = |radius| vec![SectionLoop::Circle { center: [0.0, 0.0], radius }];
/// let shaft = stack_of(&[
///     Slab { bottom: 0.0, top: 10.0, loops: disc(5.0) },
///     Slab { bottom: 10.0, top: 30.0, loops: disc(3.0) },
/// ])?;
/// assert_eq!(shaft.faces.len(), 5); // two cylinders, two ends and the shoulder
/// let volume = std::f64::consts::PI * (250.0 + 180.0);
/// assert!((shaft.measures().volume - volume).abs() < 1e-9 * volume);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn stack_of(slabs: &[Slab]) -> Result<Solid> {
    let heights = heights(slabs)?;
    let all: BoundingBox<[f64; 2]> =
        slabs.iter().flat_map(|slab| &slab.loops).flat_map(plane::extremes).collect();
    let [width, depth] = all.extent();
    let size = width.max(depth).max(heights[heights.len() - 1] - heights[0]);
    let mut points = Points::new(COINCIDENCE * size);
    let mut regions = vec![Region::default()];
    for slab in slabs {
        regions.push(Region::new(&slab.loops, &mut points)?);
    }
    regions.push(Region::default());
    let mut builder = Builder::default();
    let mut interfaces = Vec::new();
    for (k, pair) in regions.windows(2).enumerate() {
        let interface = Interface::new(&pair[0], &pair[1], &mut points)
            .map_err(|e| e.in_context(format!("height {}", heights[k])))?;
        interfaces.push(interface);
    }
    for (k, interface) in interfaces.iter().enumerate() {
        builder.flat_faces(k, heights[k], interface, &points)?;
    }
    for k in 0..slabs.len() {
        builder.walls(
            k,
            [heights[k], heights[k + 1]],
            &regions[k + 1],
            [&interfaces[k], &interfaces[k + 1]],
            &points,
        );
    }
    let solid = builder.solid;
    solid.check(COINCIDENCE * size * 10.0).map_err(|e| {
        let text = "the sections form no closed solid: contours of one height cross or touch";
        Error::undetermined(format!("{text} ({e})")).with_source(e)
    })?;
    if solid.shells().len() != 1 {
        return Err(Error::undetermined(format!(
            "expected sections that form one body, found {} bodies: neighbouring sections must overlap",
            solid.shells().len()
        )));
    }
    Ok(solid)
}

/// Heights of all interfaces.
fn heights(slabs: &[Slab]) -> Result<Vec<f64>> {
    let mut heights: Vec<f64> = slabs.iter().map(|slab| slab.bottom).collect();
    heights.extend(slabs.last().map(|slab| slab.top));
    let is_stack = slabs.windows(2).all(|pair| pair[0].top == pair[1].bottom);
    let is_rising = heights.windows(2).all(|pair| pair[0] < pair[1]);
    if slabs.is_empty() || !is_stack || !is_rising || slabs.iter().any(|slab| slab.loops.is_empty()) {
        return Err(Error::input("expected slabs with sections, each on top of the one before"));
    }
    Ok(heights)
}

/// A solid under construction.
#[derive(Default)]
struct Builder {
    solid: Solid,
    /// Vertices by point and interface.
    vertices: BTreeMap<(usize, usize), usize>,
    /// Edges by interface and atom.
    edges: BTreeMap<(usize, usize), usize>,
    /// Vertical edges by slab and point.
    risers: BTreeMap<(usize, usize), usize>,
}

impl Builder {
    fn vertex(&mut self, point: usize, interface: usize, height: f64, points: &Points) -> usize {
        let [x, y] = points.at(point);
        *self.vertices.entry((point, interface)).or_insert_with(|| {
            self.solid.vertices.push(DVec3::new(x, y, height));
            self.solid.vertices.len() - 1
        })
    }

    /// The edge of an atom at an interface.
    fn edge(&mut self, interface: usize, index: usize, atom: &Atom, height: f64, points: &Points) -> usize {
        if let Some(&edge) = self.edges.get(&(interface, index)) {
            return edge;
        }
        let [start, end] = [atom.from, atom.to].map(|p| self.vertex(p, interface, height, points));
        let at = |p: [f64; 2]| DVec3::new(p[0], p[1], height);
        let (curve, range) = match atom.curve {
            AtomCurve::Line => {
                let (a, b) = (at(points.at(atom.from)), at(points.at(atom.to)));
                let length = (b - a).length();
                (EdgeCurve::Line { origin: a, direction: 1.0 / length * (b - a) }, [0.0, length])
            }
            AtomCurve::Arc { center, radius, from_rad, sweep_rad } => {
                let (sin, cos) = from_rad.sin_cos();
                let a = DVec3::new(radius * cos, radius * sin, 0.0);
                let b = DVec3::new(-radius * sin, radius * cos, 0.0);
                (EdgeCurve::Ellipse { center: at(center), a, b }, [0.0, sweep_rad.min(TAU)])
            }
        };
        self.solid.edges.push(Edge { curve, range, start, end });
        self.edges.insert((interface, index), self.solid.edges.len() - 1);
        self.solid.edges.len() - 1
    }

    fn chain(
        &mut self,
        k: usize,
        height: f64,
        chain: &[Directed],
        interface: &Interface,
        points: &Points,
    ) -> Vec<Coedge> {
        let one = |d: &Directed| {
            let edge = self.edge(k, d.atom, &interface.atoms[d.atom], height, points);
            Coedge { edge, forward: d.forward }
        };
        chain.iter().map(one).collect()
    }

    /// Faces at an interface: where only one side has material.
    fn flat_faces(&mut self, k: usize, height: f64, interface: &Interface, points: &Points) -> Result<()> {
        for (is_up, directed) in [(true, &interface.above_free), (false, &interface.below_free)] {
            for loops in plane::faces(directed, &interface.atoms, points)? {
                let loops = loops.iter().map(|one| {
                    let mut coedges = self.chain(k, height, one, interface, points);
                    if !is_up {
                        // Loops run with the face on their left seen from outside, here from below.
                        coedges.reverse();
                        coedges.iter_mut().for_each(|c| c.forward = !c.forward);
                    }
                    coedges
                });
                let loops: Vec<Vec<Coedge>> = loops.collect();
                let normal = if is_up { DVec3::Z } else { -DVec3::Z };
                let surface =
                    FaceSurface::Plane { origin: DVec3::new(0.0, 0.0, height), normal, x: DVec3::X };
                self.solid.faces.push(Face { surface, outward: true, loops });
            }
        }
        Ok(())
    }

    /// The vertical walls of a slab.
    fn walls(
        &mut self,
        slab: usize,
        [bottom, top]: [f64; 2],
        region: &Region,
        [below, above]: [&Interface; 2],
        points: &Points,
    ) {
        for (index, piece) in region.pieces.iter().enumerate() {
            let low = self.chain(slab, bottom, &below.upper[index], below, points);
            let mut high = self.chain(slab + 1, top, &above.lower[index], above, points);
            high.reverse();
            high.iter_mut().for_each(|c| c.forward = !c.forward);
            let base = |p: [f64; 2]| DVec3::new(p[0], p[1], bottom);
            let (surface, outward) = match piece.curve {
                AtomCurve::Line => {
                    let (a, b) = (base(points.at(piece.from)), base(points.at(piece.to)));
                    let x = 1.0 / (b - a).length() * (b - a);
                    // Material is on the left of the piece, so that the outside is on its right.
                    (FaceSurface::Plane { origin: a, normal: x.cross(DVec3::Z), x }, true)
                }
                AtomCurve::Arc { center, radius, .. } => {
                    let origin = base(center);
                    (FaceSurface::Cylinder { origin, axis: DVec3::Z, x: DVec3::X, radius }, piece.forward)
                }
            };
            let loops = if piece.from == piece.to {
                vec![low, high]
            } else {
                let [up, down] =
                    [piece.end(), piece.start()].map(|p| self.riser(slab, p, [bottom, top], points));
                let mut outline = low;
                outline.push(Coedge { edge: up, forward: true });
                outline.extend(high);
                outline.push(Coedge { edge: down, forward: false });
                vec![outline]
            };
            self.solid.faces.push(Face { surface, outward, loops });
        }
    }

    /// The vertical edge of a slab at a point.
    fn riser(&mut self, slab: usize, point: usize, [bottom, top]: [f64; 2], points: &Points) -> usize {
        if let Some(&edge) = self.risers.get(&(slab, point)) {
            return edge;
        }
        let start = self.vertex(point, slab, bottom, points);
        let end = self.vertex(point, slab + 1, top, points);
        let [x, y] = points.at(point);
        let curve = EdgeCurve::Line { origin: DVec3::new(x, y, bottom), direction: DVec3::Z };
        self.solid.edges.push(Edge { curve, range: [0.0, top - bottom], start, end });
        self.risers.insert((slab, point), self.solid.edges.len() - 1);
        self.solid.edges.len() - 1
    }
}

#[cfg(test)]
mod tests;
