//! Sparse information: patterns, orderings, Cholesky factors and selected inverses.
//!
//! Input: small dense pieces of information, each over the few nodes of one element. Output: solutions,
//! samples, log-determinants, and the entries of the covariance between nodes that share an element.
//!
//! ```text
//! elements ─► BlockPattern ─┬─► BlockInformation ─────────────┐
//!                           └─► NodeOrdering ─► SymbolicFactor ─┴─► CholeskyFactor ─► SelectedInverse
//! ```
//!
//! A *node* carries `b` unknowns (`b` = 1 when the coordinates do not couple, 3 when they do). The pattern,
//! the ordering and the symbolic analysis know nodes only. Vectors are node-major:
//! `x[(node·b + k)·columns + column]`, so that three right-hand sides of a matrix with `b = 1` lie in memory
//! as one right-hand side of its expansion to `b = 3`.
//!
//! Independent subtrees of the elimination tree are worked on side by side: the same input gives the same
//! bytes whatever the number of threads. Not guaranteed: accuracy beyond what the condition of the
//! information allows. A pivot that keeps no correct digit is reported as undetermined.

mod bordered;
mod cholesky;
mod information;
mod ordering;
mod panel_vectors;
mod pattern;
mod selected_inverse;
mod symbolic;
mod trace;
mod tree;

pub use bordered::Bordered;
pub use cholesky::CholeskyFactor;
pub use information::{BlockInformation, ElementScatter};
pub use ordering::NodeOrdering;
pub use pattern::BlockPattern;
pub use selected_inverse::SelectedInverse;
pub use symbolic::SymbolicFactor;
pub use trace::{TraceEstimate, stochastic_trace};

#[cfg(test)]
mod tests;
