//! The graphs of constraints as files: JSON or DOT.
//!
//! Input: [`ViewGraphs`] of one view or several with their structure and tours, and the composite graph of
//! several. Output: one file with all of them.

use planish_contour::constraint::{BarId, Constraint, Decomposition, Diagnosis, ParametricDrawing, PointId};
use planish_contour::graph::{Composite, Tour, TourEdge, ViewGraphs, postman_tour};
use planish_estimate::{Error, Result};
use planish_exchange::{extension, write_atomically};
use serde::Serialize;
use std::io::Write;
use std::path::Path;

/// A route through the bars of a view, or the edges in space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NamedTour {
    /// The vertices by name, the first again at the end.
    pub vertices: Vec<String>,
    /// Edges that are traversed again, by the names of their ends.
    pub repeated: Vec<String>,
    /// Length of the tour.
    pub length: f64,
    /// Whether no shorter route exists.
    pub is_shortest: bool,
}

/// Equations and parameters by name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NamedPart {
    /// Equations, `f1` and so on.
    pub equations: Vec<String>,
    /// Parameters.
    pub parameters: Vec<String>,
}

/// The Dulmage–Mendelsohn decomposition by name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NamedStructure {
    /// The structural rank.
    pub rank: usize,
    /// More equations than parameters.
    pub over: NamedPart,
    /// As many equations as parameters.
    pub well: NamedPart,
    /// Fewer equations than parameters.
    pub under: NamedPart,
    /// Blocks of the well-determined part, in the order in which they can be solved.
    pub blocks: Vec<NamedPart>,
}

/// Constraint graphs of one view.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GraphsOfView {
    /// The view's name.
    pub name: String,
    /// Parameters of its drawing.
    pub parameters: usize,
    /// The rank of the Jacobian at a witness.
    pub rank: usize,
    /// Full, bipartite, matching, minimal and pair.
    #[serde(flatten)]
    pub graphs: ViewGraphs,
    /// The parts of the structure.
    pub structure: NamedStructure,
    /// A tour through the bars of every part of the drawing.
    pub tours: Vec<NamedTour>,
}

impl GraphsOfView {
    /// The graphs of constraints that were diagnosed.
    #[must_use]
    pub fn new(
        name: &str,
        drawing: &ParametricDrawing,
        constraints: &[Constraint],
        diagnosis: &Diagnosis,
    ) -> Self {
        Self {
            name: name.to_owned(),
            parameters: diagnosis.parameters,
            rank: diagnosis.rank,
            graphs: ViewGraphs::new(drawing, constraints),
            structure: NamedStructure::new(&diagnosis.structure, drawing),
            tours: tours(drawing),
        }
    }
}

impl NamedStructure {
    /// A decomposition of constraints between the parts of a drawing.
    #[must_use]
    pub fn new(structure: &Decomposition, drawing: &ParametricDrawing) -> Self {
        let named = |part: &planish_contour::constraint::EquationBlock| NamedPart {
            // Counted from 1, as in the graphs.
            equations: part.equations.iter().map(|f| format!("f{}", f + 1)).collect(),
            parameters: part.parameters.iter().map(|&p| drawing.parameter_name(p).to_owned()).collect(),
        };
        Self {
            rank: structure.rank,
            over: named(&structure.over),
            well: named(&structure.well),
            under: named(&structure.under),
            blocks: structure.blocks.iter().map(named).collect(),
        }
    }
}

impl NamedTour {
    /// A tour with the names of its vertices.
    #[must_use]
    pub fn new(tour: &Tour, edges: &[TourEdge], name: impl Fn(usize) -> String) -> Self {
        Self {
            vertices: tour.vertices.iter().map(|&vertex| name(vertex)).collect(),
            repeated: tour
                .repeated
                .iter()
                .map(|&edge| format!("{} {}", name(edges[edge].a), name(edges[edge].b)))
                .collect(),
            length: tour.length,
            is_shortest: tour.is_shortest,
        }
    }
}

/// A postman's tour of each connected set of bars.
fn tours(drawing: &ParametricDrawing) -> Vec<NamedTour> {
    let mut left: Vec<BarId> = drawing.bars().collect();
    let mut found = Vec::new();
    while let Some(&first) = left.first() {
        let mut points: Vec<PointId> = drawing.ends(first).to_vec();
        let mut edges: Vec<TourEdge> = Vec::new();
        // Bars join as long as one of their ends is known.
        while let Some(at) =
            // Quadratic, but drawings have at most some hundred bars, and the order stays that of the
            // drawing.
            left.iter().position(|&bar| drawing.ends(bar).iter().any(|end| points.contains(end)))
        {
            let bar = left.remove(at);
            let ends = drawing.ends(bar);
            for end in ends {
                if !points.contains(&end) {
                    points.push(end);
                }
            }
            let [a, b] = ends.map(|end| points.iter().position(|&point| point == end).unwrap_or_default());
            edges.push(TourEdge { a, b, length: drawing.length(bar) });
        }
        // A drawing without a tour still has its other graphs.
        if let Ok(tour) = postman_tour(&edges, 0) {
            found.push(NamedTour::new(&tour, &edges, |vertex| drawing.point_name(points[vertex]).to_owned()));
        }
    }
    found
}

/// The composite graph with its tour.
#[derive(Serialize)]
struct WrittenComposite<'a> {
    #[serde(flatten)]
    composite: &'a Composite,
    graph: &'a planish_contour::graph::LabelledGraph,
    tour: Option<NamedTour>,
}

#[derive(Serialize)]
struct Written<'a> {
    views: &'a [GraphsOfView],
    #[serde(skip_serializing_if = "Option::is_none")]
    composite: Option<WrittenComposite<'a>>,
}

/// Checks that graphs can be written under a name.
///
/// # Errors
/// `Unsupported` for an extension other than `.json` and `.dot`.
pub fn check_graphs_name(path: &Path) -> Result<()> {
    match extension(path).as_str() {
        "json" | "dot" => Ok(()),
        _ => Err(Error::unsupported(format!(
            "{}: cannot write this format: expected .json or .dot for graphs",
            path.display()
        ))),
    }
}

/// Writes the graphs of views, and the composite graph of several, to a `.json` or `.dot` file.
///
/// A DOT file contains one graph after the other, named by view and kind.
///
/// # Errors
/// `Io` if the file cannot be written.
pub fn write_graphs(path: &Path, views: &[GraphsOfView], composite: Option<&Composite>) -> Result<()> {
    let text = if extension(path) == "dot" {
        dot(views, composite)
    } else {
        let composite = composite.map(|composite| WrittenComposite {
            composite,
            graph: composite.graph(),
            // A composite graph without a tour is written as well.
            tour: composite.tour().ok().map(|tour| {
                let edges: Vec<TourEdge> = composite
                    .edges
                    .iter()
                    // Its edges have no lengths, so a tour counts them.
                    .map(|edge| TourEdge { a: edge.a, b: edge.b, length: 1.0 })
                    .collect();
                NamedTour::new(&tour, &edges, |vertex| format!("V{}", vertex + 1))
            }),
        });
        let mut text = serde_json::to_string_pretty(&Written { views, composite }).map_err(|e| {
            Error::io(format!("{}: the graphs could not be written as JSON", path.display())).with_source(e)
        })?;
        text.push('\n');
        text
    };
    write_atomically(path, |out| out.write_all(text.as_bytes()))
}

fn dot(views: &[GraphsOfView], composite: Option<&Composite>) -> String {
    let mut text = String::new();
    for view in views {
        let graphs = &view.graphs;
        // The matching is drawn in the bipartite graph and needs no graph of its own.
        for graph in [&graphs.full, &graphs.bipartite, &graphs.minimal, &graphs.pair] {
            let mut graph = graph.clone();
            // DOT tools address graphs of a file by their names, which must differ.
            graph.name = format!("{}_{}", view.name, graph.name);
            text.push_str(&graph.to_dot());
        }
    }
    if let Some(composite) = composite {
        text.push_str(&composite.graph().to_dot());
    }
    text
}
