//! Triangulation of all faces.

use super::lifted::Ring;
use super::outline::Outliner;
use super::seeds::seeds;
use super::{Fineness, ParametricCurve, ParametricEdge, ParametricFace, ParametricShape};
use crate::tessellation::fill::{Filling, too_many_points};
use planish_core::{Budget, DVec3};
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;

/// Maximum number of points of a face. It bounds time and memory; faces that need more are skipped.
///
/// A point takes about 250 bytes while its face is triangulated, and some microseconds. Faces of parts need a
/// few thousand at the default chord error. Those that need more have a damaged coordinate.
const MAX_POINTS: usize = 500_000;
/// Memory of a point of the result: its position, its index and two triangles, each in the face and in the
/// part.
const POINT_BYTES: u64 = 2 * (size_of::<DVec3>() + size_of::<u32>() + 2 * size_of::<[u32; 3]>()) as u64;
/// Number of faces that are triangulated before their points are taken from the budget.
const FACES_AT_ONCE: usize = 256;
/// Maximum number of times that the edges of a face are divided into finer chords if it cannot be filled.
///
/// Coarse chords of neighbouring edges may cross. Each attempt costs a triangulation of the faces concerned.
const MAX_ATTEMPTS: u8 = 3;

/// The triangles of faces that are connected by edges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// Positions.
    pub positions: Vec<DVec3>,
    /// Triangles, counter-clockwise as seen from the outer side.
    pub triangles: Vec<[u32; 3]>,
    /// Indices of its faces, ascending.
    pub faces: Vec<usize>,
}

/// A face without triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct SkippedFace {
    /// Index of the face.
    pub face: usize,
    /// The reason, as a message.
    pub reason: String,
}

/// The triangles of all faces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Meshed {
    /// Faces that share edges, in the order of their first face.
    pub parts: Vec<Part>,
    /// Faces that could not be filled.
    pub skipped: Vec<SkippedFace>,
}

/// Bit that marks indices of the inner points of a face; indices without it are points of edges.
///
/// Faces are triangulated in parallel, so indices of their inner points are not known before all are done.
const INNER_POINT: u32 = 1 << 31;

/// Triangles of one face. Corners are indices of points of edges or, with [`INNER_POINT`], of inner points.
#[derive(Debug, Clone, Default)]
struct Filled {
    own: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Points along edges; the vertices come first.
struct EdgePoints {
    positions: Vec<DVec3>,
    of_edge: Vec<Vec<u32>>,
}

impl EdgePoints {
    /// Divides an edge into chords. Points of an earlier division stay unused.
    fn cut(&mut self, shape: &ParametricShape, index: usize, fineness: &Fineness) {
        let edge = &shape.edges[index];
        let mut points = vec![edge.ends[0] as u32];
        let inner = inner_points(shape, edge, fineness);
        for p in inner {
            points.push(self.positions.len() as u32);
            self.positions.push(p);
        }
        points.push(edge.ends[1] as u32);
        self.of_edge[index] = points;
    }

    /// A loop as vertices, with the face on its left seen against the normal of the surface.
    fn ring(&self, coedges: &[(usize, bool)], is_outward: bool) -> Ring {
        let mut ring = Ring { vertices: Vec::new(), along: Vec::new() };
        let mut end = None;
        for &(edge, forward) in coedges {
            let mut points = self.of_edge[edge].clone();
            if !forward {
                points.reverse();
            }
            // If the previous edge ended at another vertex, the file has a gap there. Both ends become
            // corners, which closes the gap by a straight side.
            if let Some(end) = end.filter(|e| Some(e) != points.first()) {
                ring.vertices.push(end);
                ring.along.push(edge);
            }
            end = points.pop();
            ring.along.extend(points.iter().map(|_| edge));
            ring.vertices.extend(points);
        }
        if let (Some(end), Some(first)) = (end, ring.vertices.first())
            && end != *first
        {
            ring.vertices.push(end);
            ring.along.push(usize::MAX);
        }
        ring.remove_repeated();
        if !is_outward {
            ring.reverse();
        }
        ring
    }
}

/// Points of an edge between its ends, in its direction.
fn inner_points(shape: &ParametricShape, edge: &ParametricEdge, fineness: &Fineness) -> Vec<DVec3> {
    let [a, b] = edge.ends.map(|v| shape.vertices[v]);
    let is_closed = edge.ends[0] == edge.ends[1];
    if is_closed && matches!(edge.curve, ParametricCurve::Line { .. }) {
        return Vec::new();
    }
    let range = edge.curve.range(if edge.is_forward { [a, b] } else { [b, a] }, is_closed);
    let at = edge.curve.chords(range, fineness);
    let mut points: Vec<DVec3> = at.into_iter().map(|t| edge.curve.point(t)).collect();
    if !edge.is_forward {
        points.reverse();
    }
    points
}

impl ParametricShape {
    /// Triangulates every face that can be filled. Other faces are listed with the reason.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::brep::FaceSurface;
    /// use planish_solid::parametric::{
    ///     Fineness, ParametricCurve, ParametricEdge, ParametricFace, ParametricShape, ParametricSurface,
    /// };
    ///
    /// // A unit square in the plane z = 0.
    /// let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
    /// let edge = |k: usize| {
    ///     let (a, b) = (vertices[k], vertices[(k + 1) % 4]);
    ///     let curve = ParametricCurve::Line { origin: a, along: b - a };
    ///     ParametricEdge { curve, ends: [k, (k + 1) % 4], is_forward: true }
    /// };
    /// let (normal, x) = (DVec3::Z, DVec3::X);
    /// let face = ParametricFace {
    ///     name: "square".to_owned(),
    ///     surface: ParametricSurface::Elementary(FaceSurface::Plane { origin: DVec3::ZERO, normal, x }),
    ///     is_outward: true,
    ///     loops: vec![(0..4).map(|k| (k, true)).collect()],
    /// };
    /// let edges = (0..4).map(edge).collect();
    /// let shape = ParametricShape { vertices: vertices.clone(), edges, faces: vec![face] };
    /// let meshed = shape.triangles(&Fineness { chord: 0.01, longest: f64::INFINITY })?;
    /// assert!(meshed.skipped.is_empty());
    /// assert_eq!(meshed.parts[0].triangles.len(), 2);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) if the fineness is not positive, or an index does not
    /// exist.
    pub fn triangles(&self, fineness: &Fineness) -> Result<Meshed> {
        self.triangles_within(fineness, &Budget::of_process())
    }

    /// As [`Self::triangles`], with the memory of a budget.
    ///
    /// # Errors
    /// As [`Self::triangles`]; `Unsupported`, naming the face, if the triangles take more than the budget.
    pub fn triangles_within(&self, fineness: &Fineness, budget: &Budget) -> Result<Meshed> {
        self.check(fineness)?;
        let mut points =
            EdgePoints { positions: self.vertices.clone(), of_edge: vec![Vec::new(); self.edges.len()] };
        let mut cuts = vec![0_u8; self.edges.len()];
        let mut filled: Vec<Option<Result<Filled>>> = (0..self.faces.len()).map(|_| None).collect();
        // If a face cannot be filled, all of its edges get finer chords. Its neighbours share these edges and
        // are filled again, so that their triangles still match.
        let mut outdated: Vec<usize> = (0..self.edges.len()).collect();
        for attempt in 0..=MAX_ATTEMPTS {
            for edge in std::mem::take(&mut outdated) {
                let finer = 0.25_f64.powi(i32::from(cuts[edge]));
                let chord = finer * fineness.chord;
                points.cut(self, edge, &Fineness { chord, ..*fineness });
            }
            let open: Vec<usize> = (0..self.faces.len()).filter(|face| filled[*face].is_none()).collect();
            let mut made: Vec<(usize, Result<Filled>)> = Vec::with_capacity(open.len());
            for some in open.chunks(FACES_AT_ONCE) {
                made.par_extend(
                    some.par_iter().map(|face| (*face, self.fill(&self.faces[*face], &points, fineness))),
                );
                // Taken face by face in their order, so that the budget ends at the same face in every run.
                for (face, filled) in made[made.len() - some.len()..].iter() {
                    let count = filled.as_ref().map_or(0, |filled| filled.triangles.len() as u64 / 2 + 1);
                    let named = |e: Error| e.in_context(format_args!("face {}", self.faces[*face].name));
                    budget.take_elements(count, POINT_BYTES, "points of triangles").map_err(named)?;
                }
            }
            for (face, result) in made {
                // Finer chords do not help if there are too many points: only such errors name a setting.
                let is_coarse = result.as_ref().is_err_and(|e| e.settings().is_empty());
                if is_coarse && attempt < MAX_ATTEMPTS {
                    outdated.extend(self.faces[face].loops.iter().flatten().map(|(edge, _)| *edge));
                }
                filled[face] = Some(result);
            }
            // Sorted, so that new points have the same numbers in every run.
            outdated.sort_unstable();
            outdated.dedup();
            if outdated.is_empty() {
                break;
            }
            for edge in &outdated {
                cuts[*edge] += 1;
            }
            for (face, result) in self.faces.iter().zip(&mut filled) {
                if face.loops.iter().flatten().any(|(e, _)| outdated.binary_search(e).is_ok()) {
                    *result = None;
                }
            }
        }
        Ok(self.gather(filled, &points))
    }

    /// Tests the fineness and all indices.
    fn check(&self, fineness: &Fineness) -> Result<()> {
        if !(fineness.chord > 0.0 && fineness.chord.is_finite() && fineness.longest > 0.0) {
            return Err(Error::input(format!(
                "expected a chord error and a longest side > 0, found {} and {}",
                fineness.chord, fineness.longest
            )));
        }
        let ends = self.edges.iter().flat_map(|e| e.ends);
        if let Some(v) = ends.into_iter().find(|v| *v >= self.vertices.len()) {
            return Err(Error::input(format!("there is no vertex {v}")));
        }
        let used = self.faces.iter().flat_map(|f| f.loops.iter().flatten());
        match used.map(|(e, _)| *e).find(|e| *e >= self.edges.len()) {
            Some(edge) => Err(Error::input(format!("there is no edge {edge}"))),
            None => Ok(()),
        }
    }

    /// Triangulates one face.
    fn fill(&self, face: &ParametricFace, points: &EdgePoints, fineness: &Fineness) -> Result<Filled> {
        let mut rings: Vec<Ring> = face
            .loops
            .iter()
            .map(|l| points.ring(l, face.is_outward))
            .filter(|ring| !ring.vertices.is_empty())
            .collect();
        // Loops that enclose nothing: one vertex, as some programs write at a pole, or one edge back and
        // forth.
        rings.retain(|ring| {
            ring.vertices.len() > 2 || ring.vertices.len() == 2 && ring.along[0] != ring.along[1]
        });
        if rings.is_empty() && face.loops.iter().any(|l| !l.is_empty()) && face.surface.poles().is_empty() {
            return Err(Error::unsupported("its loops have fewer than three points"));
        }
        let corners: usize = rings.iter().map(|ring| ring.vertices.len()).sum();
        if corners > MAX_POINTS {
            return Err(too_many_points(corners));
        }
        // A numbering of its own for each face, so that the triangulation does not depend on the other faces
        // and faces can be filled in parallel.
        let mut local_of: HashMap<u32, u32> = HashMap::new();
        let mut global = Vec::new();
        for v in rings.iter_mut().flat_map(|r| &mut r.vertices) {
            *v = *local_of.entry(*v).or_insert_with(|| {
                global.push(*v);
                (global.len() - 1) as u32
            });
        }
        let mut positions: Vec<DVec3> = global.iter().map(|v| points.positions[*v as usize]).collect();
        let outline = Outliner::new(face, &mut positions, *fineness).outline(&rings)?;
        let inner = seeds(&face.surface, &outline, fineness, MAX_POINTS, &mut positions)?;
        let steps = outline.steps;
        let filling = Filling {
            polygons: &outline.polygons,
            inner: &inner,
            on_surface: &|at| face.surface.point([at[0] / steps[0], at[1] / steps[1]]),
            is_flat: face.surface.is_plane(),
            tolerance: fineness.chord,
            max_points: MAX_POINTS,
        };
        let mut triangles = filling.triangles(&mut positions)?;
        // At a pole, several corners are one vertex, and triangles between these are degenerate.
        triangles.retain(|[a, b, c]| a != b && b != c && c != a);
        if triangles.is_empty() {
            return Err(Error::unsupported("its loops enclose no area"));
        }
        let shared = global.len();
        for t in &mut triangles {
            *t = t.map(|v| match global.get(v as usize) {
                Some(of_edge) => *of_edge,
                None => INNER_POINT | (v - shared as u32),
            });
            if !face.is_outward {
                t.swap(1, 2);
            }
        }
        let own = positions.split_off(shared);
        Ok(Filled { own, triangles })
    }

    /// Combines the faces of each connected set into a part, with the vertices that it uses.
    fn gather(&self, filled: Vec<Option<Result<Filled>>>, points: &EdgePoints) -> Meshed {
        let mut meshed = Meshed::default();
        let mut good: Vec<Option<Filled>> = Vec::with_capacity(filled.len());
        for (face, result) in filled.into_iter().enumerate() {
            good.push(match result {
                Some(Ok(filled)) => Some(filled),
                Some(Err(e)) => {
                    let reason = e.to_string();
                    meshed.skipped.push(SkippedFace { face, reason });
                    None
                }
                None => None,
            });
        }
        for faces in self.together(&good) {
            let mut part = Part::default();
            let mut new_of: HashMap<u32, u32> = HashMap::new();
            for face in faces {
                let Some(filled) = good[face].take() else {
                    continue;
                };
                // Inner points of the previous face have the same indices as those of this one.
                new_of.retain(|v, _| v & INNER_POINT == 0);
                for t in filled.triangles {
                    part.triangles.push(t.map(|v| {
                        *new_of.entry(v).or_insert_with(|| {
                            part.positions.push(match v & INNER_POINT {
                                0 => points.positions[v as usize],
                                _ => filled.own[(v ^ INNER_POINT) as usize],
                            });
                            (part.positions.len() - 1) as u32
                        })
                    }));
                }
                part.faces.push(face);
            }
            meshed.parts.push(part);
        }
        meshed
    }

    /// Sets of faces with triangles that are connected by edges, in the order of their first face.
    fn together(&self, good: &[Option<Filled>]) -> Vec<Vec<usize>> {
        let mut faces_of: Vec<Vec<usize>> = vec![Vec::new(); self.edges.len()];
        for (index, face) in self.faces.iter().enumerate().filter(|(k, _)| good[*k].is_some()) {
            for (edge, _) in face.loops.iter().flatten() {
                faces_of[*edge].push(index);
            }
        }
        let mut is_seen = vec![false; self.faces.len()];
        let mut found = Vec::new();
        for first in 0..self.faces.len() {
            if good[first].is_none() || std::mem::replace(&mut is_seen[first], true) {
                continue;
            }
            let mut open = vec![first];
            let mut together = Vec::new();
            while let Some(face) = open.pop() {
                together.push(face);
                for (edge, _) in self.faces[face].loops.iter().flatten() {
                    for next in &faces_of[*edge] {
                        if !std::mem::replace(&mut is_seen[*next], true) {
                            open.push(*next);
                        }
                    }
                }
            }
            together.sort_unstable();
            found.push(together);
        }
        found
    }
}
