//! Solids from their orthographic views.
