//! A graph with labels, for output as DOT, or as JSON through serde.

use serde::Serialize;
use std::fmt::Write;

/// A node of a labelled graph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledNode {
    /// Label of the node.
    pub label: String,
    /// Group of the node, such as `parameter` or `constraint`; in a composite graph, the name of the view.
    pub group: String,
}

/// An arc of a labelled graph.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledArc {
    /// Index of the start node.
    pub from: usize,
    /// Index of the end node.
    pub to: usize,
    /// Its labels, such as the constraints that connect two parameters.
    pub labels: Vec<String>,
    /// True if it is highlighted, for example as a pair of a matching.
    pub strong: bool,
}

/// A graph with labels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LabelledGraph {
    /// Name of the graph; must be an identifier of DOT.
    pub name: String,
    /// True if arcs have a direction.
    pub directed: bool,
    /// The nodes.
    pub nodes: Vec<LabelledNode>,
    /// The arcs.
    pub arcs: Vec<LabelledArc>,
}

impl LabelledGraph {
    /// The arc between the nodes with two labels; in either direction if the graph is undirected.
    #[must_use]
    pub fn arc(&self, from: &str, to: &str) -> Option<&LabelledArc> {
        let called = |node: usize, label: &str| self.nodes[node].label == label;
        self.arcs.iter().find(|arc| {
            (called(arc.from, from) && called(arc.to, to))
                || (!self.directed && called(arc.from, to) && called(arc.to, from))
        })
    }

    /// The graph in the DOT language of Graphviz. Groups have different shapes; strong arcs are thick.
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
            // Shapes are assigned in the order in which groups first appear.
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

/// Text for a quoted string of DOT.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"")
}
