//! A graph with labels, as it is written: DOT, or JSON through serde.

use serde::Serialize;
use std::fmt::Write;

/// A node of a written graph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledNode {
    /// What it is called.
    pub label: String,
    /// What kind of node it is, such as `parameter` or `constraint`; the name of the view in a composite
    /// graph.
    pub group: String,
}

/// An arc of a written graph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledArc {
    /// The node it starts from.
    pub from: usize,
    /// The node it leads to.
    pub to: usize,
    /// Its labels, such as the constraints that connect two parameters.
    pub labels: Vec<String>,
    /// Whether it stands out, such as the pairs of a matching.
    pub strong: bool,
}

/// A graph with labels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledGraph {
    /// What it is called; an identifier of DOT.
    pub name: String,
    /// Whether arcs have a direction.
    pub directed: bool,
    /// The nodes.
    pub nodes: Vec<LabelledNode>,
    /// The arcs.
    pub arcs: Vec<LabelledArc>,
}

impl LabelledGraph {
    /// The arc between two nodes; either way round where arcs have no direction.
    #[must_use]
    pub fn arc(&self, from: &str, to: &str) -> Option<&LabelledArc> {
        let called = |node: usize, label: &str| self.nodes[node].label == label;
        self.arcs.iter().find(|arc| {
            (called(arc.from, from) && called(arc.to, to))
                || (!self.directed && called(arc.from, to) && called(arc.to, from))
        })
    }

    /// The graph in the DOT language of Graphviz. Groups have different shapes, and what stands out is drawn
    /// thick.
    ///
    /// # Examples
    /// ```
    /// use planish_contour::constraint::{BarId, Constraint, ParametricDrawing};
    /// use planish_contour::graph::ViewGraphs;
    ///
    /// let triangle = ParametricDrawing::polygon(&[[0.0, 0.0], [4.0, 0.0], [0.0, 3.0]])?;
    /// let graphs = ViewGraphs::new(&triangle, &[Constraint::Horizontal { bar: BarId(0) }]);
    /// assert!(graphs.full.to_dot().contains("n1 -- n3 [label=\"f1\"]"));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    #[must_use]
    pub fn to_dot(&self) -> String {
        const SHAPES: [&str; 4] = ["ellipse", "box", "hexagon", "diamond"];
        let (keyword, arrow) = if self.directed { ("digraph", "->") } else { ("graph", "--") };
        let mut groups: Vec<&str> = Vec::new();
        // Writing to a string does not fail.
        let mut dot = format!("{keyword} {} {{\n", self.name);
        for (i, node) in self.nodes.iter().enumerate() {
            let known = groups.iter().position(|group| *group == node.group);
            let group = known.unwrap_or_else(|| {
                groups.push(&node.group);
                groups.len() - 1
            });
            let shape = SHAPES[group % SHAPES.len()];
            let _ = writeln!(dot, "  n{i} [label=\"{}\", shape={shape}];", escaped(&node.label));
        }
        for arc in &self.arcs {
            let width = if arc.strong { ", penwidth=3" } else { "" };
            let label = escaped(&arc.labels.join(", "));
            let _ = writeln!(dot, "  n{} {arrow} n{} [label=\"{label}\"{width}];", arc.from, arc.to);
        }
        dot.push_str("}\n");
        dot
    }
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}
