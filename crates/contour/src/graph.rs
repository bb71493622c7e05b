//! The graphs of a drawing's constraints, as the paper defines them, and tours through them.
//!
//! Comes in: a drawing with constraints, or several views of one thing. Goes out: the full undirected graph
//! of the parameters, the bipartite graph with its maximum matching, the minimal and the pair graph
//! ([`ViewGraphs`]), the parts of the structure ([`Decomposition`](crate::constraint::Decomposition)), the
//! composite graph of several views ([`Composite`]), Euler and postman tours ([`postman_tour`]); all as DOT
//! and, through serde, as JSON. Not guaranteed: that a composite's vertices and edges belong to a solid; the
//! crate `planish-solid` finds those.
//!
//! # The paper's prism, and its misprints
//! Eq. 4.1 as printed names a point `P6` and an `f5: x1 = e`. With the text's three points of the front view
//! (P6 is P3), and an anchor that holds both coordinates of P1 (f5 is `y1 = e`), its Jacobian has the stated
//! rank of 6. In eq. 4.2 P8 is P3, the perpendicular is f5, and the last three are f6, f7, f8; the rank is 8.
//! The published matching is valid, but two of its entries, `∂f2/∂x3` and `∂f3/∂y3`, vanish at the prism: its
//! term of the determinant is zero. There are two maximum matchings;
//! [`Incidence::matching`](crate::constraint::Incidence::matching) prefers entries that do not vanish, and
//! finds the other.
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
