//! Sparse information: patterns, ordering, Cholesky factors and selected inverses.
