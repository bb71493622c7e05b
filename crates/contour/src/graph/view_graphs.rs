//! Graphs of one view: full, bipartite, minimal and pair graph.

use super::labelled::{LabelledArc, LabelledGraph, LabelledNode};
use crate::constraint::{Constraint, Incidence, ParametricDrawing};
use serde::Serialize;
use std::collections::BTreeMap;

/// Graphs of the constraints of one view.
///
/// - *Full*: parameters, joined if an equation depends on both, and labelled with all such equations.
/// - *Bipartite*: parameters and equations; the pairs of the matching are strong.
/// - *Minimal*: a parameter `v` matched to `f` depends on the other parameters of `f` only.
/// - *Pair*: the minimal graph with `x_i` and `y_i` in one node.
///
/// The rule of the paper for the minimal graph is: "for a matching pair (v, f) all arcs labelled other than f
/// and incident on v are removed". Read literally, it removes every arc, because an arc `u v` labelled `f`
/// would have to be matched to `f` at both ends. Fig. 6 shows the directed dependency of Serrano and Gossard:
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
    /// Full graph: parameters, and the equations that connect them.
    pub full: LabelledGraph,
    /// Bipartite graph: parameters and equations.
    pub bipartite: LabelledGraph,
    /// Maximum matching as pairs of a parameter and an equation.
    pub matching: Vec<(String, String)>,
    /// Minimal graph: the parameters from which each one is determined.
    pub minimal: LabelledGraph,
    /// Pair graph: the minimal graph between points; radii keep nodes of their own.
    pub pair: LabelledGraph,
    /// Texts of the equations, in the order of their labels `f1`, `f2`, ….
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

/// Label of an equation, counted from 1 as in the paper.
fn label(equation: usize) -> String {
    format!("f{}", equation + 1)
}

fn parameter_nodes(incidence: &Incidence) -> Vec<LabelledNode> {
    incidence.parameters.iter().map(|name| node(name, "parameter")).collect()
}

fn node(label: &str, group: &str) -> LabelledNode {
    LabelledNode { label: label.to_owned(), group: group.to_owned() }
}

/// Arcs from a map of ends to labels, in the order of the ends. The ordered map makes the output
/// reproducible.
fn arcs(labels: BTreeMap<(usize, usize), Vec<String>>) -> Vec<LabelledArc> {
    labels.into_iter().map(|((from, to), labels)| LabelledArc { from, to, labels, strong: false }).collect()
}

/// The full graph.
fn full(incidence: &Incidence) -> LabelledGraph {
    let mut labels: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
    for (equation, parameters) in incidence.parameters_of_equations().iter().enumerate() {
        for (k, &a) in parameters.iter().enumerate() {
            for &b in &parameters[k + 1..] {
                // Undirected: one arc for both orders.
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

/// The bipartite graph.
fn bipartite(incidence: &Incidence, matching: &[(usize, usize)]) -> LabelledGraph {
    let mut nodes = parameter_nodes(incidence);
    // Equations follow the parameters in one list of nodes.
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

/// The minimal graph: arcs from the other parameters of an equation to the one matched to it.
fn minimal(incidence: &Incidence, matching: &[(usize, usize)]) -> LabelledGraph {
    let parameters_of = incidence.parameters_of_equations();
    let mut labels: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
    // An unmatched parameter gets no arc that enters: nothing determines it.
    for &(parameter, equation) in matching {
        for &other in parameters_of[equation].iter().filter(|&&other| other != parameter) {
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

/// The pair graph: both coordinates of a point become one node, and arcs within a node are removed.
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
            // Several parameters of two points can depend on each other by one equation: list it once.
            let known = labels.entry((from, to)).or_default();
            known.extend(arc.labels.iter().cloned());
            known.sort_unstable();
            known.dedup();
        }
    }
    LabelledGraph { name: "pair".to_owned(), directed: true, nodes, arcs: arcs(labels) }
}
