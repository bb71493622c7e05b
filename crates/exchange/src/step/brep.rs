//! Boundary representations made of B-spline faces: plain data and their consistency check.
//!
//! **Input.** Vertices, edges with curves, faces with surfaces and loops.
//!
//! **Output.** [`Brep::check`] reports whether they are consistent.
//!
//! **Limits.** It is not checked that curves lie on surfaces.

use planish_core::{DVec3, DisjointSets};
use std::collections::{BTreeMap, HashMap};
use std::fmt::Display;

use planish_estimate::{Error, Result};

/// A polynomial (not rational) B-spline curve.
#[derive(Debug, Clone, PartialEq)]
pub struct BsplineCurve {
    /// Polynomial degree, at least 1.
    pub degree: usize,
    /// Knots in ascending order, each with its multiplicity; the multiplicities sum to
    /// `poles.len() + degree + 1`.
    pub knots: Vec<(f64, usize)>,
    /// Control points.
    pub poles: Vec<DVec3>,
}

/// A polynomial (not rational) tensor-product B-spline surface.
#[derive(Debug, Clone, PartialEq)]
pub struct BsplineSurface {
    /// Polynomial degree along u, at least 1.
    pub degree_u: usize,
    /// Polynomial degree along v, at least 1.
    pub degree_v: usize,
    /// Knots along u with their multiplicities, which sum to `n_u + degree_u + 1`.
    pub knots_u: Vec<(f64, usize)>,
    /// Knots along v with their multiplicities, which sum to `n_v + degree_v + 1`.
    pub knots_v: Vec<(f64, usize)>,
    /// Number of control points along u.
    pub n_u: usize,
    /// Number of control points along v.
    pub n_v: usize,
    /// Control points, v fastest: the one at (i, j) is `poles[i * n_v + j]`.
    pub poles: Vec<DVec3>,
}

/// An edge: a curve from one vertex to another or back to the same.
#[derive(Debug, Clone, PartialEq)]
pub struct BrepEdge {
    /// Curve from the start to the end.
    pub curve: BsplineCurve,
    /// Index of the vertex where the curve starts.
    pub start: usize,
    /// Index of the vertex where it ends.
    pub end: usize,
}

/// A face: a surface within one loop of edges, without the holes inside of it.
#[derive(Debug, Clone, PartialEq)]
pub struct BrepFace {
    /// Surface.
    pub surface: BsplineSurface,
    /// The loop: edges by index, and whether each is traversed forward; counter-clockwise seen from the outer
    /// side of the face. Sides that collapse to a point are omitted.
    pub edges: Vec<(usize, bool)>,
    /// The loops of holes, clockwise seen from the outer side of the face.
    pub holes: Vec<Vec<(usize, bool)>>,
    /// True if `S_u × S_v` points to the outer side of the face.
    pub same_sense: bool,
}

/// B-spline faces, which form one or several shells.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Brep {
    /// Vertices.
    pub vertices: Vec<DVec3>,
    /// Edges between them.
    pub edges: Vec<BrepEdge>,
    /// Faces between the edges.
    pub faces: Vec<BrepFace>,
    /// True if each shell encloses a solid.
    pub closed: bool,
}

fn finite(points: &[DVec3]) -> Result<()> {
    match points.iter().position(|p| !p.is_finite()) {
        Some(at) => Err(Error::input(format!(
            "expected finite coordinates, found {:?} at point {at}",
            points[at].to_array()
        ))),
        None => Ok(()),
    }
}

fn check_knots(degree: usize, knots: &[(f64, usize)], poles: usize) -> Result<()> {
    let ascending = knots.windows(2).all(|k| k[0].0 < k[1].0) && knots.iter().all(|k| k.0.is_finite());
    // More than degree + 1 equal knots would give a basis function that is zero everywhere.
    let multiplicities_valid = knots.iter().all(|k| (1..=degree + 1).contains(&k.1));
    let sum: usize = knots.iter().map(|k| k.1).sum();
    if degree == 0 || knots.len() < 2 || !ascending || !multiplicities_valid || sum != poles + degree + 1 {
        return Err(Error::input(format!(
            "expected ascending knots whose multiplicities (1 to degree + 1) sum to poles + degree + 1, \
             found degree {degree}, {poles} poles, {} knots with multiplicities that sum to {sum}",
            knots.len()
        )));
    }
    Ok(())
}

/// True if the knots are clamped, so that a curve starts and ends at its first and last pole.
fn is_clamped(degree: usize, knots: &[(f64, usize)]) -> bool {
    let full = |k: Option<&(f64, usize)>| k.is_some_and(|k| k.1 == degree + 1);
    full(knots.first()) && full(knots.last())
}

impl BsplineCurve {
    fn check(&self) -> Result<()> {
        check_knots(self.degree, &self.knots, self.poles.len())?;
        finite(&self.poles)
    }
}

impl BsplineSurface {
    fn check(&self) -> Result<()> {
        check_knots(self.degree_u, &self.knots_u, self.n_u).map_err(|e| e.in_context("along u"))?;
        check_knots(self.degree_v, &self.knots_v, self.n_v).map_err(|e| e.in_context("along v"))?;
        if self.n_u.checked_mul(self.n_v) != Some(self.poles.len()) {
            return Err(Error::input(format!(
                "expected {} x {} poles, found {}",
                self.n_u,
                self.n_v,
                self.poles.len()
            )));
        }
        finite(&self.poles)
    }
}

impl Brep {
    /// Checks the consistency of the representation.
    ///
    /// Indices exist; knots fit their poles; numbers are finite; clamped curves end at their vertices within
    /// `uncertainty`; every loop is connected; no edge is used more than twice or twice in the same
    /// direction, and in a closed shell every edge is used twice.
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input), naming the first inconsistent face or edge.
    pub fn check(&self, uncertainty: f64) -> Result<()> {
        fn named<T>(result: Result<T>, what: &str, index: impl Display) -> Result<T> {
            result.map_err(|e| e.in_context(format_args!("{what} {index}")))
        }
        if self.faces.is_empty() {
            return Err(Error::input("expected at least one face, found none"));
        }
        named(finite(&self.vertices), "vertices", "")?;
        for (index, edge) in self.edges.iter().enumerate() {
            named(edge.curve.check(), "edge", index)?;
            let ends = [(edge.start, edge.curve.poles.first()), (edge.end, edge.curve.poles.last())];
            for (vertex, pole) in ends {
                let Some(vertex_at) = self.vertices.get(vertex) else {
                    return named(
                        Err(Error::input(format!(
                            "expected a vertex below {}, found {vertex}",
                            self.vertices.len()
                        ))),
                        "edge",
                        index,
                    );
                };
                let apart = pole.map_or(0.0, |p| p.distance(*vertex_at));
                // Curves that are not clamped do not end at their first and last pole.
                if is_clamped(edge.curve.degree, &edge.curve.knots) && apart > uncertainty {
                    let message =
                        format!("expected its curve to end at vertex {vertex}, found a distance of {apart}");
                    return named(Err(Error::input(message)), "edge", index);
                }
            }
        }
        let mut used = vec![[false; 2]; self.edges.len()];
        for (index, face) in self.faces.iter().enumerate() {
            named(face.surface.check(), "face", index)?;
            for edges in std::iter::once(&face.edges).chain(&face.holes) {
                named(self.check_loop(edges, &mut used), "face", index)?;
            }
        }
        match used.iter().position(|directions| *directions != [true, true]) {
            Some(edge) if self.closed => Err(Error::input(format!(
                "edge {edge}: expected one use in each direction in a closed shell, found {}",
                used[edge].iter().filter(|u| **u).count()
            ))),
            _ => Ok(()),
        }
    }

    /// The shells: the faces of each set of faces that share edges, by index.
    ///
    /// # Panics
    /// If an edge of a face does not exist, which [`Brep::check`] reports.
    #[must_use]
    pub fn shells(&self) -> Vec<Vec<usize>> {
        let mut sets = DisjointSets::new(self.faces.len());
        let mut first = vec![None; self.edges.len()];
        for (number, face) in self.faces.iter().enumerate() {
            for &(edge, _) in face.edges.iter().chain(face.holes.iter().flatten()) {
                let other = *first[edge].get_or_insert(number);
                sets.join(other as u32, number as u32);
            }
        }
        let mut shells: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        let mut first = HashMap::new();
        for (number, root) in sets.into_roots().into_iter().enumerate() {
            // Ordered by the first face of each.
            shells.entry(*first.entry(root).or_insert(number)).or_default().push(number);
        }
        shells.into_values().collect()
    }

    /// True if every edge of some faces is used twice by them.
    pub(super) fn is_closed(&self, faces: &[usize]) -> bool {
        let mut uses = HashMap::new();
        let faces = faces.iter().map(|&face| &self.faces[face]);
        for (edge, _) in faces.flat_map(|face| face.edges.iter().chain(face.holes.iter().flatten())) {
            *uses.entry(edge).or_insert(0) += 1;
        }
        uses.values().all(|&uses| uses == 2)
    }

    fn check_loop(&self, edges: &[(usize, bool)], used: &mut [[bool; 2]]) -> Result<()> {
        let ends = |&(edge, forward): &(usize, bool)| {
            let found = self.edges.get(edge).ok_or_else(|| {
                Error::input(format!("expected an edge below {}, found {edge}", self.edges.len()))
            })?;
            Ok(if forward { (found.start, found.end) } else { (found.end, found.start) })
        };
        let Some(last) = edges.last() else {
            return Err(Error::input("expected a loop of edges, found none"));
        };
        // Begins at the end of the last edge, so that the closing of the loop is checked like every other
        // joint.
        let mut at = ends(last)?.1;
        for oriented in edges {
            let (start, end) = ends(oriented)?;
            let (edge, forward) = *oriented;
            if start != at {
                return Err(Error::input(format!(
                    "expected edge {edge} to start at vertex {at}, where the previous one ends, found vertex \
                     {start}"
                )));
            }
            at = end;
            // Loops are stated as seen from the outer side, also for faces of reversed sense, so the
            // direction is compared as it is.
            if std::mem::replace(&mut used[edge][usize::from(forward)], true) {
                return Err(Error::input(format!(
                    "expected edge {edge} once in each direction, found it twice in the same: neighbouring \
                     faces disagree on the outer side"
                )));
            }
        }
        Ok(())
    }
}
