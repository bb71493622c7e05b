//! Sparse information: patterns, orderings, Cholesky factors and selected inverses.
//!
//! Input: small dense matrices of information, each over the nodes of one element. Output: solutions,
//! samples, log-determinants, and covariances between nodes that share an element.
//!
//! ```text
//! elements ─► BlockPattern ─┬─► BlockInformation ─────────────┐
//!                           └─► NodeOrdering ─► SymbolicFactor ─┴─► CholeskyFactor ─► SelectedInverse
//! ```
//!
//! A *node* has `b` unknowns (`b` = 3 if the coordinates are coupled, otherwise 1). Pattern, ordering and
//! symbolic analysis refer to nodes. Vectors are node-major: `x[(node·b + k)·columns + column]`, so three
//! right-hand sides for `b = 1` have the same memory layout as one right-hand side for `b = 3`.
//!
//! Independent subtrees of the elimination tree are processed in parallel; the same input gives the same
//! bytes for any number of threads. Not guaranteed: accuracy beyond the condition number of the information.
//! A pivot without correct digits is reported as undetermined.
//!
//! # Example
//! A chain of three unknowns with known differences and one known end:
//! ```
//! use planish_estimate::sparse::{
//!     BlockInformation, BlockPattern, CholeskyFactor, NodeOrdering, SelectedInverse, SymbolicFactor,
//! };
//! use std::sync::Arc;
//!
//! let pattern = Arc::new(BlockPattern::from_elements(3, [[0, 1], [1, 2]])?);
//! let ordering = NodeOrdering::amd(&pattern)?;
//! let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &ordering, 1)?);
//!
//! let mut information = BlockInformation::zeros(pattern, 1, 1)?;
//! information.add_element(&[0], &[1.0], &[10.0])?; // x0 = 10, σ = 1
//! for i in 0..2 {
//!     // x(i+1) − x(i) = 2, σ = 1
//!     information.add_element(&[i, i + 1], &[1.0, -1.0, -1.0, 1.0], &[-2.0, 2.0])?;
//! }
//! let factor = CholeskyFactor::factorize(&symbolic, &information)?;
//! let mut x = information.vector().to_vec();
//! factor.solve_in_place(&mut x)?;
//! assert!((x[2] - 14.0).abs() < 1e-12);
//! // Variances add up along the chain.
//! let variances = SelectedInverse::new(&factor).diagonal();
//! assert!((variances[2] - 3.0).abs() < 1e-12);
//! # Ok::<(), planish_estimate::Error>(())
//! ```

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
