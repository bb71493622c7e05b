//! Composite graph of several views: the points of different views that are the same vertex in space.
//!
//! In: drawings in planes of one coordinate system, with constraints and covariances. Out: vertices in space,
//! each a point of every view, and edges between them. Not guaranteed: that all of them belong to a solid. A
//! diagonal of a flat face that two views see edge-on is kept, and a line with further vertices between its
//! ends is one bar.

use super::labelled::{LabelledArc, LabelledGraph, LabelledNode};
use super::tour::{Tour, TourEdge, postman_tour};
use crate::constraint::{Constraint, ParametricDrawing, PointId};
use nalgebra::DMatrix;
use planish_estimate::{Error, Result};
use serde::Serialize;
use std::collections::VecDeque;

/// An axis of space.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SpaceAxis {
    /// To the right in front and top views.
    X,
    /// Away from the viewer of a front view.
    Y,
    /// Up in front and side views.
    Z,
}

/// A drawing as a view of an object in space.
#[derive(Debug, Clone)]
pub struct SketchView<'a> {
    /// Name of the view, such as `front`.
    pub name: &'a str,
    /// Axes of space of its first and second coordinate.
    pub axes: [SpaceAxis; 2],
    /// The drawing.
    pub drawing: &'a ParametricDrawing,
    /// Its constraints. Bars with a given distance are followed first.
    pub constraints: &'a [Constraint],
    /// Covariance of its parameters; `None` means zero.
    pub covariance: Option<&'a DMatrix<f64>>,
}

/// A vertex in space: a point of every view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CompositeVertex {
    /// Position; each coordinate is the mean of the views that show it, weighted by information.
    pub position: [f64; 3],
    /// σ of the coordinates, if the views are independent.
    pub sigma: [f64; 3],
    /// Index of the point in each view.
    pub points: Vec<PointId>,
}

/// An edge in space: every view shows it as a bar or as a point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CompositeEdge {
    /// Index of one vertex.
    pub a: usize,
    /// Index of the other vertex.
    pub b: usize,
    /// True if some view has a distance constraint between its ends.
    pub has_distance: bool,
}

/// Vertices and edges in space, matched between views.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Composite {
    /// Names of the views.
    pub views: Vec<String>,
    /// Vertices in the order of matching; the first is the initial matching.
    pub vertices: Vec<CompositeVertex>,
    /// Edges in the order of the search; from each vertex, those with a distance come first.
    pub edges: Vec<CompositeEdge>,
    /// Points that belong to no vertex, with the index of their view.
    pub unmatched: Vec<(usize, PointId)>,
    graph: LabelledGraph,
}

/// Maximum number of combinations of points. More mean a tolerance too wide to match views; the search for
/// edges costs the square of it.
const MAX_COMBINATIONS: usize = 100_000;

/// Matches the vertices of two or three views.
///
/// Points belong to the same vertex if the shared coordinates of their views agree to `tolerance`, or to
/// `gate` times the σ of the difference. *Initial matching*: the first point of the first view that agrees
/// with a point of every other view. *Complete matching*: from there along bars, in each view one or none,
/// those with a distance first. Cost: the square of the number of combinations of points that agree.
///
/// # Errors
/// `Input` if there are not two or three views, two views show the same axes, a view shows an axis twice, a
/// covariance has the wrong size, or `tolerance` or `gate` is negative. `Undetermined` if no points agree, or
/// far too many.
///
/// # Examples
/// ```
/// use planish_contour::constraint::ParametricDrawing;
/// use planish_contour::graph::{SketchView, SpaceAxis, composite};
///
/// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])?;
/// let rectangle = ParametricDrawing::polygon(&[[0.0, 0.0], [7.0, 0.0], [7.0, 3.0], [0.0, 3.0]])?;
/// let view = |name, axes, drawing| SketchView { name, axes, drawing, constraints: &[], covariance: None };
/// let prism = composite(&[
///     view("front", [SpaceAxis::X, SpaceAxis::Z], &triangle),
///     view("side", [SpaceAxis::Y, SpaceAxis::Z], &rectangle),
/// ], 1e-9, 0.0)?;
/// assert_eq!(prism.vertices.len(), 6);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Weiss-Cohen, Bondarenko and Halevi 2009, section 5.
pub fn composite(views: &[SketchView<'_>], tolerance: f64, gate: f64) -> Result<Composite> {
    check(views, tolerance, gate)?;
    // All vertices that the coordinates allow; the search below keeps those connected to the first one.
    let candidates = agreeing(views, tolerance, gate)?;
    if candidates.is_empty() {
        return Err(Error::undetermined(
            "expected points that agree in the shared coordinates of all views, found none: check that the \
             views show the same object, at one scale and in one coordinate system",
        ));
    }
    // Breadth-first search over vertices. A linear scan for neighbours suffices for the few dozen vertices of
    // a drawing.
    let mut order = vec![0];
    let mut seen = vec![false; candidates.len()];
    seen[0] = true;
    let mut edges: Vec<CompositeEdge> = Vec::new();
    let mut queue = VecDeque::from([0]);
    while let Some(current) = queue.pop_front() {
        let mut steps: Vec<(bool, usize)> = (0..candidates.len())
            .filter(|&neighbour| neighbour != current)
            .filter_map(|neighbour| {
                Some((step(views, &candidates[current], &candidates[neighbour])?, neighbour))
            })
            .collect();
        // Dimensioned edges first, as in the paper.
        steps.sort_by_key(|&(has_distance, neighbour)| (!has_distance, neighbour));
        for (has_distance, neighbour) in steps {
            if !std::mem::replace(&mut seen[neighbour], true) {
                order.push(neighbour);
                queue.push_back(neighbour);
            }
            // Every edge is found from both of its ends.
            if !edges.iter().any(|edge| (edge.a, edge.b) == (neighbour, current)) {
                edges.push(CompositeEdge { a: current, b: neighbour, has_distance });
            }
        }
    }
    // Renumber in the order of the search: vertices that it did not reach are no part of the composite.
    let mut new_index = vec![0; candidates.len()];
    order.iter().enumerate().for_each(|(new, &old)| new_index[old] = new);
    for edge in &mut edges {
        (edge.a, edge.b) = (new_index[edge.a], new_index[edge.b]);
    }
    let vertices: Vec<CompositeVertex> = order.iter().map(|&old| candidates[old].clone()).collect();
    Ok(Composite {
        views: views.iter().map(|view| view.name.to_owned()).collect(),
        unmatched: unmatched(views, &vertices),
        graph: graph_of(views, &vertices),
        vertices,
        edges,
    })
}

impl Composite {
    /// The composite graph of the paper: points and bars of all views, with strong links between points of
    /// the same vertex.
    ///
    /// Links of the initial matching are labelled `initial`, the others by their vertex.
    #[must_use]
    pub fn graph(&self) -> &LabelledGraph {
        &self.graph
    }

    /// The postman tour of the edges in space, starting at the initial matching.
    ///
    /// # Errors
    /// `Input` if there is no edge.
    pub fn tour(&self) -> Result<Tour> {
        let edges: Vec<TourEdge> = self
            .edges
            .iter()
            .map(|edge| {
                let (p, q) = (self.vertices[edge.a].position, self.vertices[edge.b].position);
                let square: f64 = p.iter().zip(&q).map(|(p, q)| (p - q).powi(2)).sum();
                TourEdge { a: edge.a, b: edge.b, length: square.sqrt() }
            })
            .collect();
        postman_tour(&edges, 0)
    }
}

/// Checks the input of [`composite`].
fn check(views: &[SketchView<'_>], tolerance: f64, gate: f64) -> Result<()> {
    if !(2..=3).contains(&views.len()) {
        return Err(Error::input(format!(
            "expected two or three views for a composite graph, found {}",
            views.len()
        )));
    }
    if !(tolerance >= 0.0 && gate >= 0.0 && tolerance.is_finite() && gate.is_finite()) {
        return Err(Error::input(format!(
            "expected a tolerance and a gate of at least 0, found {tolerance} and {gate}"
        )));
    }
    for (i, view) in views.iter().enumerate() {
        if view.axes[0] == view.axes[1] {
            return Err(Error::input(format!(
                "the {} view: expected different axes, found {:?} twice",
                view.name, view.axes[0]
            )));
        }
        let n = view.drawing.parameters();
        if let Some(covariance) = view.covariance.filter(|covariance| covariance.shape() != (n, n)) {
            return Err(Error::input(format!(
                "the {} view: expected a covariance of {n} × {n}, found {} × {}",
                view.name,
                covariance.nrows(),
                covariance.ncols()
            )));
        }
        if let Some(other) =
            views[..i].iter().find(|other| view.axes.iter().all(|axis| other.axes.contains(axis)))
        {
            return Err(Error::input(format!(
                "the {} and the {} view: expected different axes, found the same",
                other.name, view.name
            )));
        }
    }
    Ok(())
}

/// Mean and variance of one coordinate, if a view shows it.
type Known = Option<(f64, f64)>;

/// Combinations of one point per view that agree, in the order of the points.
fn agreeing(views: &[SketchView<'_>], tolerance: f64, gate: f64) -> Result<Vec<CompositeVertex>> {
    let mut partial: Vec<(Vec<PointId>, [Known; 3])> = vec![(Vec::new(), [None; 3])];
    // View by view, so that combinations which disagree in two views are never extended to a third.
    for view in views {
        let mut grown = Vec::new();
        for (points, known) in &partial {
            for point in view.drawing.points() {
                if let Some(known) = fused(view, point, *known, tolerance, gate) {
                    let mut points = points.clone();
                    points.push(point);
                    grown.push((points, known));
                }
            }
            if grown.len() > MAX_COMBINATIONS {
                return Err(Error::undetermined(format!(
                    "expected at most {MAX_COMBINATIONS} combinations of points that agree, found more: \
                     reduce the tolerance"
                )));
            }
        }
        partial = grown;
    }
    // Two views with different axes cover all three coordinates, so that none is unknown.
    let coordinate = |known: Known| known.unwrap_or((f64::NAN, f64::NAN));
    Ok(partial
        .into_iter()
        .map(|(points, known)| CompositeVertex {
            position: known.map(|known| coordinate(known).0),
            sigma: known.map(|known| coordinate(known).1.sqrt()),
            points,
        })
        .collect())
}

/// Coordinates fused with one more view; `None` if it disagrees.
fn fused(
    view: &SketchView<'_>,
    point: PointId,
    mut known: [Known; 3],
    tolerance: f64,
    gate: f64,
) -> Option<[Known; 3]> {
    let position = view.drawing.position(point);
    for (k, parameter) in view.drawing.coordinates(point).into_iter().enumerate() {
        let variance = view.covariance.map_or(0.0, |covariance| covariance[(parameter, parameter)].max(0.0));
        let axis = &mut known[view.axes[k] as usize];
        *axis = match *axis {
            None => Some((position[k], variance)),
            Some((mean, of_mean)) => {
                let sum = of_mean + variance;
                // Exact drawings have no σ; the tolerance then absorbs rounding.
                if (position[k] - mean).abs() > tolerance.max(gate * sum.sqrt()) {
                    return None;
                }
                // Both have the same weight if neither has an error.
                let share = if sum > 0.0 { of_mean / sum } else { 0.5 };
                Some((mean + share * (position[k] - mean), of_mean * (1.0 - share)))
            }
        };
    }
    Some(known)
}

/// Returns `None` if some view shows neither one point nor a bar between two vertices; otherwise, whether a
/// view has a distance constraint between them.
fn step(views: &[SketchView<'_>], from: &CompositeVertex, to: &CompositeVertex) -> Option<bool> {
    let mut has_distance = false;
    for (view, (&p, &q)) in views.iter().zip(from.points.iter().zip(&to.points)) {
        // An edge parallel to the line of sight appears as a point.
        if p == q {
            continue;
        }
        let joins = |ends: [PointId; 2]| ends == [p, q] || ends == [q, p];
        if !view.drawing.bars().any(|bar| joins(view.drawing.ends(bar))) {
            return None;
        }
        has_distance |= view
            .constraints
            .iter()
            .any(|constraint| matches!(constraint, Constraint::Distance { a, b, .. } if joins([*a, *b])));
    }
    Some(has_distance)
}

/// Points that belong to no vertex.
fn unmatched(views: &[SketchView<'_>], vertices: &[CompositeVertex]) -> Vec<(usize, PointId)> {
    let mut alone = Vec::new();
    for (i, view) in views.iter().enumerate() {
        let is_alone = |point: &PointId| !vertices.iter().any(|vertex| vertex.points[i] == *point);
        alone.extend(view.drawing.points().filter(is_alone).map(|point| (i, point)));
    }
    alone
}

/// The composite graph with points, bars and links.
fn graph_of(views: &[SketchView<'_>], vertices: &[CompositeVertex]) -> LabelledGraph {
    let mut graph =
        LabelledGraph { name: "composite".to_owned(), directed: false, nodes: Vec::new(), arcs: Vec::new() };
    let mut first = Vec::new();
    for view in views {
        let offset = graph.nodes.len();
        first.push(offset);
        graph.nodes.extend(view.drawing.points().map(|point| LabelledNode {
            label: format!("{} P{}", view.name, point.0 + 1),
            group: view.name.to_owned(),
        }));
        graph.arcs.extend(view.drawing.bars().map(|bar| {
            let [a, b] = view.drawing.ends(bar).map(|end| offset + end.0 as usize);
            LabelledArc { from: a, to: b, labels: Vec::new(), strong: false }
        }));
    }
    for (i, vertex) in vertices.iter().enumerate() {
        let label = if i == 0 { "initial".to_owned() } else { format!("V{}", i + 1) };
        // Links between successive views suffice: with three views, the chain joins all of them.
        for view in 1..views.len() {
            graph.arcs.push(LabelledArc {
                from: first[view - 1] + vertex.points[view - 1].0 as usize,
                to: first[view] + vertex.points[view].0 as usize,
                labels: vec![label.clone()],
                strong: true,
            });
        }
    }
    graph
}
