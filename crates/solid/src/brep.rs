//! Solids as faces on analytic surfaces.
