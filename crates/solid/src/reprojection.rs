//! What a finished solid shows in its views, compared with a drawing: an independent check.
//!
//! Input: a solid by its boundary, and the drawing that it should mean. Output: the lines in which the
//! two differ, none where they agree within [`ReprojectionOptions`]. Nothing here is shared with the search in
//! the module `views`: no cells, no grid, no tidied curves.
//!
//! 1. `outlines`: what can be drawn of the solid in a view: edges where faces meet at an angle, smooth
//!    edges at which the boundary turns away from the eye, and the lines within curved faces along which the
//!    line of sight touches (`n · e = 0`).
//! 2. Where a ray meets a face: its surface, and whether the point lies within the face's loops
//!    (`brep/trimmed`).
//! 3. `scene`: a point is visible where the ray from the eye that passes it on one side or the other meets
//!    no face before it.
//! 4. `compare`: points along every drawn curve must lie on a line of the solid, a visible one where drawn
//!    visible; points along every line of the solid must lie on a drawn curve, on a visible one where seen.
//!
//! Optional are edges along which the boundary only touches itself (a cusp, or two edges in one place): some
//! drawings show them.
//!
//! Not guaranteed: differences shorter than [`ReprojectionOptions::shortest`] or between sample points are not
//! found.

mod compare;
mod nearby;
mod outlines;
mod scene;
#[cfg(test)]
mod tests;

use crate::brep::Solid;
use crate::drawing::{Drawing, ViewKind};

/// When a solid and a drawing agree; lengths as shares of the drawing's size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReprojectionOptions {
    /// Lines this close to each other are one.
    pub near: f64,
    /// Differences along less than this are none.
    pub shortest: f64,
    /// Points along curves are this far apart.
    pub spacing: f64,
}

impl Default for ReprojectionOptions {
    /// Lines within 5e-4 are one: exported curves are polygons that miss their curve by up to 3e-4 of the
    /// size.
    fn default() -> Self {
        Self { near: 5e-4, shortest: 4e-3, spacing: 1e-2 }
    }
}

/// A line in which a solid's view differs from the drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Disagreement {
    /// The view.
    pub view: ViewKind,
    /// The entity that the solid does not show; none where the solid shows a line that is not drawn.
    pub entity: Option<String>,
    /// Where, in the view: the first such point.
    pub at: [f64; 2],
    /// What differs, in words.
    pub why: &'static str,
    /// At how many of the points looked at along this line it differs.
    pub places: usize,
}

/// The lines in which a solid's views differ from a drawing; each drawn entity and each line of the solid
/// once a view and reason.
///
/// Cost: a ray for every point looked at and side of it; points are [`ReprojectionOptions::spacing`] apart.
#[must_use]
pub fn disagreements(solid: &Solid, drawing: &Drawing, options: &ReprojectionOptions) -> Vec<Disagreement> {
    compare::disagreements(solid, drawing, options)
}
