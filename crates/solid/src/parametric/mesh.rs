//! Triangles of all faces.

use super::lifted::Ring;
use super::outline::Outliner;
use super::seeds::seeds;
use super::{Fineness, ParametricCurve, ParametricEdge, ParametricFace, ParametricShape};
use crate::tessellation::fill::Filling;
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;

/// A face that needs more points than this is left out.
const MAX_POINTS: usize = 2_000_000;
/// How often edges of a face that cannot be filled are cut finer.
const TRIES: u8 = 3;

/// Faces that hang together, as triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Part {
    /// Positions.
    pub positions: Vec<[f64; 3]>,
    /// Triangles, counter-clockwise as seen from the outer side.
    pub triangles: Vec<[u32; 3]>,
    /// The faces that it is of, ascending.
    pub faces: Vec<usize>,
}

/// A face without triangles.
#[derive(Debug, Clone, PartialEq)]
pub struct SkippedFace {
    /// The face's index.
    pub face: usize,
    /// Why, for people.
    pub reason: String,
}

/// All faces as triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Meshed {
    /// Faces that share edges, in the order of their first face.
    pub parts: Vec<Part>,
    /// Faces that could not be filled.
    pub skipped: Vec<SkippedFace>,
}

/// Numbers of a face's own points begin here, those of edges' points at 0.
const OWN: u32 = 1 << 31;

/// Triangles of one face, corners numbered among the points of edges and its own.
#[derive(Debug, Clone, Default)]
struct Filled {
    own: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

/// Points along edges: those of vertices come first.
struct EdgePoints {
    positions: Vec<[f64; 3]>,
    of_edge: Vec<Vec<u32>>,
}

impl EdgePoints {
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

    /// A loop with the face to its left along the surface's normal.
    fn ring(&self, coedges: &[(usize, bool)], is_outward: bool) -> Ring {
        let mut ring = Ring { vertices: Vec::new(), along: Vec::new() };
        let mut end = None;
        for &(edge, forward) in coedges {
            let mut points = self.of_edge[edge].clone();
            if !forward {
                points.reverse();
            }
            // Where the edge before ended elsewhere, its end is a corner of its own.
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
        let mut k = 0;
        while k < ring.vertices.len() && ring.vertices.len() > 1 {
            let next = ring.vertices[(k + 1) % ring.vertices.len()];
            if next == ring.vertices[k] {
                ring.vertices.remove(k);
                ring.along.remove(k);
            } else {
                k += 1;
            }
        }
        if !is_outward {
            ring.reverse();
        }
        ring
    }
}

/// Points of an edge between its ends, as it runs.
fn inner_points(shape: &ParametricShape, edge: &ParametricEdge, fineness: &Fineness) -> Vec<[f64; 3]> {
    let [a, b] = edge.ends.map(|v| shape.vertices[v]);
    let is_closed = edge.ends[0] == edge.ends[1];
    if is_closed && matches!(edge.curve, ParametricCurve::Line { .. }) {
        return Vec::new();
    }
    let range = edge.curve.range(if edge.is_forward { [a, b] } else { [b, a] }, is_closed);
    let at = edge.curve.chords(range, fineness);
    let mut points: Vec<[f64; 3]> = at.into_iter().map(|t| edge.curve.point(t)).collect();
    if !edge.is_forward {
        points.reverse();
    }
    points
}

impl ParametricShape {
    /// Triangles of every face that can be filled.
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) for a fineness that is not positive, and for indices
    /// that do not exist.
    pub fn triangles(&self, fineness: &Fineness) -> Result<Meshed> {
        self.check(fineness)?;
        let mut points =
            EdgePoints { positions: self.vertices.clone(), of_edge: vec![Vec::new(); self.edges.len()] };
        let mut cuts = vec![0_u8; self.edges.len()];
        let mut filled: Vec<Option<Result<Filled>>> = (0..self.faces.len()).map(|_| None).collect();
        let mut stale: Vec<usize> = (0..self.edges.len()).collect();
        for attempt in 0..=TRIES {
            for edge in std::mem::take(&mut stale) {
                let finer = 0.25_f64.powi(i32::from(cuts[edge]));
                let chord = finer * fineness.chord;
                points.cut(self, edge, &Fineness { chord, ..*fineness });
            }
            let made: Vec<(usize, Result<Filled>)> = (0..self.faces.len())
                .into_par_iter()
                .filter(|face| filled[*face].is_none())
                .map(|face| (face, self.fill(&self.faces[face], &points, fineness)))
                .collect();
            for (face, result) in made {
                if result.is_err() && attempt < TRIES {
                    stale.extend(self.faces[face].loops.iter().flatten().map(|(edge, _)| *edge));
                }
                filled[face] = Some(result);
            }
            stale.sort_unstable();
            stale.dedup();
            if stale.is_empty() {
                break;
            }
            for edge in &stale {
                cuts[*edge] += 1;
            }
            for (face, result) in self.faces.iter().zip(&mut filled) {
                if face.loops.iter().flatten().any(|(e, _)| stale.binary_search(e).is_ok()) {
                    *result = None;
                }
            }
        }
        Ok(self.gather(filled, &points))
    }

    fn check(&self, fineness: &Fineness) -> Result<()> {
        if !(fineness.chord > 0.0 && fineness.chord.is_finite() && fineness.longest > 0.0) {
            return Err(Error::input(format!(
                "needed a chord error and a longest side > 0, found {} and {}",
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

    /// The triangles of one face.
    fn fill(&self, face: &ParametricFace, points: &EdgePoints, fineness: &Fineness) -> Result<Filled> {
        let mut rings: Vec<Ring> = face
            .loops
            .iter()
            .map(|l| points.ring(l, face.is_outward))
            .filter(|ring| !ring.vertices.is_empty())
            .collect();
        // A loop of one vertex marks a pole, and one of two has nothing in it.
        rings.retain(|ring| {
            ring.vertices.len() > 2 || ring.vertices.len() == 2 && ring.along[0] != ring.along[1]
        });
        if rings.is_empty() && face.loops.iter().any(|l| !l.is_empty()) && face.surface.poles().is_empty() {
            return Err(Error::unsupported("its loops have less than three points"));
        }
        let mut local_of: HashMap<u32, u32> = HashMap::new();
        let mut global = Vec::new();
        for v in rings.iter_mut().flat_map(|r| &mut r.vertices) {
            *v = *local_of.entry(*v).or_insert_with(|| {
                global.push(*v);
                (global.len() - 1) as u32
            });
        }
        let mut positions: Vec<[f64; 3]> = global.iter().map(|v| points.positions[*v as usize]).collect();
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
        // At a pole some have two corners in it.
        triangles.retain(|[a, b, c]| a != b && b != c && c != a);
        if triangles.is_empty() {
            return Err(Error::unsupported("its loops enclose nothing"));
        }
        let shared = global.len();
        for t in &mut triangles {
            *t = t.map(|v| match global.get(v as usize) {
                Some(of_edge) => *of_edge,
                None => OWN | (v - shared as u32),
            });
            if !face.is_outward {
                t.swap(1, 2);
            }
        }
        let own = positions.split_off(shared);
        Ok(Filled { own, triangles })
    }

    /// Faces that share edges put together, each with the vertices that it uses.
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
                new_of.retain(|v, _| v & OWN == 0);
                for t in filled.triangles {
                    part.triangles.push(t.map(|v| {
                        *new_of.entry(v).or_insert_with(|| {
                            part.positions.push(match v & OWN {
                                0 => points.positions[v as usize],
                                _ => filled.own[(v ^ OWN) as usize],
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

    /// Faces that have triangles, by what shares an edge.
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
