//! The graphs of one view: full, bipartite, minimal, pair.

use super::labelled::{LabelledArc, LabelledGraph, LabelledNode};
use crate::constraint::{Constraint, Incidence, ParametricDrawing};
use serde::Serialize;
use std::collections::BTreeMap;

/// The graphs of one view's constraints.
///
/// *full*: parameters, joined where an equation depends on both, labelled with all such equations.
/// *bipartite*: parameters and equations, with the matching thick. *minimal*: parameter `v` matched to `f`
/// depends on the other parameters of `f`, and on nothing else. *pair*: the same with `x_i` and `y_i` in one
/// node.
///
/// The paper's rule for the minimal graph, "for a matching pair (v, f) all arcs labelled other than f and
/// incident on v are removed", leaves no arc at all when read literally: an arc `u v` labelled `f` would have
/// to be matched to `f` at both ends. What Fig. 6 needs is the directed dependency of Serrano and Gossard:
/// the rule removes arcs that *enter* `v`.
///
/// # Examples
/// ```
/// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing, PointId};
/// use planish_contour::graph::ViewGraphs;
///
/// let square = ParametricDrawing::polygon(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])?;
/// let graphs = ViewGraphs::new(&square, &[
///     Constraint::Anchor { point: PointId(0), at: [0.0, 0.0] },
///     Constraint::Horizontal { bar: BarId(0) },
/// ]);
/// let pairs = [("x1", "f1"), ("y1", "f2"), ("y2", "f3")].map(|(a, b)| (a.to_owned(), b.to_owned()));
/// assert_eq!(graphs.matching, pairs);
/// assert!(graphs.minimal.arc("y1", "y2").is_some() && graphs.minimal.arc("y2", "y1").is_none());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ViewGraphs {
    /// Parameters, and the equations that connect them.
    pub full: LabelledGraph,
    /// Parameters and equations.
    pub bipartite: LabelledGraph,
    /// A maximum matching, parameter and equation.
    pub matching: Vec<(String, String)>,
    /// What each parameter is determined from.
    pub minimal: LabelledGraph,
    /// The same between points; radii stay alone.
    pub pair: LabelledGraph,
    /// The equations in words, in the order of their labels `f1`, `f2`, ….
    pub equations: Vec<String>,
}

impl ViewGraphs {
    /// The graphs of constraints between the parts of a drawing.
    #[must_use]
    pub fn new(drawing: &ParametricDrawing, constraints: &[Constraint]) -> Self {
        let incidence = Incidence::new(drawing, constraints);
        let matching = incidence.matching();
        let minimal = minimal(&incidence, &matching);
        Self {
            full: full(&incidence),
            bipartite: bipartite(&incidence, &matching),
            pair: pair(drawing, &minimal),
            minimal,
            matching: matching
                .iter()
                .map(|&(parameter, equation)| (incidence.parameters[parameter].clone(), label(equation)))
                .collect(),
            equations: incidence.owners.iter().map(|&owner| constraints[owner].describe(drawing)).collect(),
        }
    }

    /// All four graphs in the DOT language, one after the other.
    #[must_use]
    pub fn to_dot(&self) -> String {
        [&self.full, &self.bipartite, &self.minimal, &self.pair].map(LabelledGraph::to_dot).concat()
    }
}

fn label(equation: usize) -> String {
    format!("f{}", equation + 1)
}

fn parameter_nodes(incidence: &Incidence) -> Vec<LabelledNode> {
    incidence.parameters.iter().map(|name| node(name, "parameter")).collect()
}

fn node(label: &str, group: &str) -> LabelledNode {
    LabelledNode { label: label.to_owned(), group: group.to_owned() }
}

/// Arcs from a map of ends to labels, in the order of the ends.
fn arcs(labels: BTreeMap<(usize, usize), Vec<String>>) -> Vec<LabelledArc> {
    labels.into_iter().map(|((from, to), labels)| LabelledArc { from, to, labels, strong: false }).collect()
}

fn full(incidence: &Incidence) -> LabelledGraph {
    let mut labels: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
    for (equation, parameters) in incidence.parameters_of_equations().iter().enumerate() {
        for (k, &a) in parameters.iter().enumerate() {
            for &b in &parameters[k + 1..] {
                labels.entry((a.min(b), a.max(b))).or_default().push(label(equation));
            }
        }
    }
    LabelledGraph {
        name: "full".to_owned(),
        directed: false,
        nodes: parameter_nodes(incidence),
        arcs: arcs(labels),
    }
}

fn bipartite(incidence: &Incidence, matching: &[(usize, usize)]) -> LabelledGraph {
    let mut nodes = parameter_nodes(incidence);
    let first = nodes.len();
    nodes.extend((0..incidence.equations()).map(|equation| node(&label(equation), "constraint")));
    let arcs = incidence
        .entries
        .iter()
        .map(|entry| LabelledArc {
            from: entry.parameter,
            to: first + entry.equation,
            labels: Vec::new(),
            strong: matching.contains(&(entry.parameter, entry.equation)),
        })
        .collect();
    LabelledGraph { name: "bipartite".to_owned(), directed: false, nodes, arcs }
}

fn minimal(incidence: &Incidence, matching: &[(usize, usize)]) -> LabelledGraph {
    let of = incidence.parameters_of_equations();
    let mut labels: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
    for &(parameter, equation) in matching {
        for &other in of[equation].iter().filter(|&&other| other != parameter) {
            labels.entry((other, parameter)).or_default().push(label(equation));
        }
    }
    LabelledGraph {
        name: "minimal".to_owned(),
        directed: true,
        nodes: parameter_nodes(incidence),
        arcs: arcs(labels),
    }
}

/// Coordinates of a point become one node; arcs within a node go.
fn pair(drawing: &ParametricDrawing, minimal: &LabelledGraph) -> LabelledGraph {
    let mut nodes = Vec::new();
    let mut node_of = vec![usize::MAX; drawing.parameters()];
    for point in drawing.points() {
        let [x, y] = drawing.coordinates(point);
        (node_of[x], node_of[y]) = (nodes.len(), nodes.len());
        let label = format!("{{{}, {}}}", drawing.parameter_name(x), drawing.parameter_name(y));
        nodes.push(node(&label, "point"));
    }
    for circle in drawing.circles() {
        let parameter = drawing.radius_parameter(circle);
        node_of[parameter] = nodes.len();
        nodes.push(node(drawing.parameter_name(parameter), "radius"));
    }
    let mut labels: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
    for arc in &minimal.arcs {
        let (from, to) = (node_of[arc.from], node_of[arc.to]);
        if from != to {
            let known = labels.entry((from, to)).or_default();
            known.extend(arc.labels.iter().cloned());
            known.sort_unstable();
            known.dedup();
        }
    }
    LabelledGraph { name: "pair".to_owned(), directed: true, nodes, arcs: arcs(labels) }
}
