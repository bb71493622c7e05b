//! Drawings of parts with faces oblique to all views.
