//! Graphs of the constraints of drawings, as defined by Weiss-Cohen et al. 2009, and tours through them.
//!
//! In: a drawing with constraints, or several views of one object. Out: the full undirected graph of the
//! parameters, the bipartite graph with its maximum matching, the minimal graph and the pair graph
//! ([`ViewGraphs`]); the composite graph of several views ([`Composite`]); Euler and postman tours
//! ([`postman_tour`]). All can be written as DOT and, through serde, as JSON. Not guaranteed: that the
//! vertices and edges of a composite belong to a solid; the crate `planish-solid` finds solids.
//!
//! # Corrections to the paper's example, a prism
//! Eq. 4.1 is printed with a point `P6` and with `f5: x1 = e`. The Jacobian has the stated rank of 6 if P6 is
//! read as P3, since the text has three points, and f5 as `y1 = e`, so that the anchor fixes both coordinates
//! of P1. In eq. 4.2, P8 is P3, the perpendicularity is f5, and the last three equations are f6, f7 and f8;
//! the rank is 8.
//!
//! The published matching is one of two maximum matchings. Two of its entries, `∂f2/∂x3` and `∂f3/∂y3`,
//! vanish at the prism, so that its term of the determinant is zero.
//! [`Incidence::matching`](crate::constraint::Incidence::matching) prefers entries that do not vanish and
//! finds the other one (decision record 0048).
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, *Reconstruction of 3D models from measurements obtained by a
//! moving sensor*, sections 4 and 5; Serrano and Gossard 1988, *Constraint management in MCAE*.

mod composite;
mod labelled;
mod tour;
mod view_graphs;

pub use composite::{Composite, CompositeEdge, CompositeVertex, SketchView, SpaceAxis, composite};
pub use labelled::{LabelledArc, LabelledGraph, LabelledNode};
pub use tour::{Tour, TourEdge, euler_tour, postman_tour};
pub use view_graphs::ViewGraphs;

#[cfg(test)]
mod tests;
