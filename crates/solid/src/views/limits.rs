//! Drawings that are rejected before the search: too few views, empty views, too many slanted curves.

use crate::drawing::{Curve2, Drawing, View};
use planish_estimate::{Error, Result};

/// Maximum number of arcs, and of lines along no axis, in a view. Each is compared with all others, to find
/// parts of one curve.
const MAX_SLANTED: usize = 5000;

/// Rejects views with more than [`MAX_SLANTED`] arcs and lines along no axis, before they are compared with
/// each other.
pub(super) fn check_slanted(drawing: &Drawing) -> Result<()> {
    let is_slanted = |curve: &Curve2| match curve {
        Curve2::Segment(a, b) => a[0] != b[0] && a[1] != b[1],
        Curve2::Arc { .. } => true,
        Curve2::Chain(_) => false,
    };
    let count = |view: &View| view.curves.iter().filter(|c| is_slanted(&c.curve)).count();
    match drawing.views.iter().find(|view| count(view) > MAX_SLANTED) {
        Some(view) => Err(Error::unsupported(format!(
            "the {} view: expected at most {MAX_SLANTED} arcs and lines along no axis, found {}: draw curves \
             as splines or arcs instead of many short lines",
            view.kind.name(),
            count(view)
        ))),
        None => Ok(()),
    }
}

/// Rejects drawings with fewer than two views or with empty views.
pub(super) fn check(drawing: &Drawing) -> Result<()> {
    if drawing.views.len() < 2 {
        return Err(Error::input(format!(
            "expected two or three views, found {}: one view does not determine the third dimension",
            drawing.views.len()
        )));
    }
    match drawing.views.iter().find(|v| v.curves.is_empty()) {
        Some(view) => Err(Error::input(format!("the {} view: expected lines, found none", view.kind.name()))),
        None => Ok(()),
    }
}
