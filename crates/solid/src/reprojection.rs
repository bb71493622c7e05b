//! Independent check of a solid: its projected views are compared with a drawing.
//!
//! Input: a boundary representation and a drawing. Output: the lines in which they differ, none if they agree
//! within [`ReprojectionOptions`]. With the search in `views`, the check shares only the data model and the
//! geometry in [`brep`](crate::brep): no cells, no grid, no cleaned curves. An error of the search therefore
//! does not hide itself.
//!
//! 1. `outlines`: the drawable lines of a view: sharp edges, smooth edges where the boundary turns away
//!    from the viewer, and outlines within curved faces (`n · e = 0` for the normal n and the direction e to
//!    the viewer).
//! 2. `brep/trimmed`: intersections of a ray with a face, limited to the loops of the face.
//! 3. `scene`: a point is visible where the ray from the eye that passes it on one side or the other meets
//!    no face before it.
//! 4. `compare`: points along every drawn curve must lie on a line of the solid, a visible one where drawn
//!    visible; points along every line of the solid must lie on a drawn curve, on a visible one where seen.
//!
//! Of a section, only what is behind the cutting plane is compared, and faces before it hide nothing. A line
//! may also be the border of the material that is cut; this must be where the view is hatched (`cut`). Views
//! without hidden lines need to show visible lines only.
//!
//! Edges along which the boundary only touches itself (a cusp, or two coincident edges) are optional, because
//! drawing conventions differ.
//!
//! Limits: differences shorter than [`ReprojectionOptions::shortest`] or between sample points are not found.

mod compare;
mod cut;
mod nearby;
mod outlines;
mod scene;
#[cfg(test)]
mod tests;
mod unseen;

use crate::brep::Solid;
use crate::drawing::{Drawing, LineStyle, ViewKind};

/// Tolerances of the comparison; lengths are relative to the size of the drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReprojectionOptions {
    /// Maximum distance of matching lines (default 5e-4).
    pub near: f64,
    /// Differences shorter than this are ignored (default 4e-3).
    pub shortest: f64,
    /// Distance of sample points along curves (default 1e-2).
    pub spacing: f64,
}

impl Default for ReprojectionOptions {
    /// The default distance is 5e-4 because exported curves are often polygons that deviate from their curve
    /// by up to 3e-4 of the size.
    fn default() -> Self {
        Self { near: 5e-4, shortest: 4e-3, spacing: 1e-2 }
    }
}

/// How a view of a solid differs from the drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Difference {
    /// A line is drawn where the solid has none.
    NotShown(LineStyle),
    /// A line is drawn visible, but is hidden in the solid.
    IsHidden,
    /// A line is drawn hidden, but is visible in the solid.
    IsVisible,
    /// The solid has a line, but none is drawn.
    NotDrawn(LineStyle),
    /// A section is hatched where the solid has no material, or not hatched where it has.
    Hatching {
        /// Whether the section is hatched there.
        is_hatched: bool,
    },
}

impl Difference {
    /// Description of the difference.
    #[must_use]
    pub fn reason(self) -> &'static str {
        match self {
            Self::NotShown(LineStyle::Visible) => "a visible line is drawn, but the solid has no line there",
            Self::NotShown(LineStyle::Hidden) => "a hidden line is drawn, but the solid has no line there",
            Self::IsHidden => "a line is drawn visible, but it is hidden in the solid",
            Self::IsVisible => "the solid shows a visible line, but it is drawn hidden",
            Self::NotDrawn(LineStyle::Visible) => "the solid shows a visible line, but none is drawn",
            Self::NotDrawn(LineStyle::Hidden) => "the solid has a hidden line, but none is drawn",
            Self::Hatching { is_hatched: true } => {
                "the section is hatched, but the solid has no material there"
            }
            Self::Hatching { is_hatched: false } => {
                "the section is not hatched, but the solid has material there"
            }
        }
    }
}

/// A line in which a solid's view differs from the drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Disagreement {
    /// The view.
    pub view: ViewKind,
    /// Entity that the solid does not show; `None` if the solid shows a line that is not drawn.
    pub entity: Option<String>,
    /// Differing points along the line, in view coordinates.
    pub places: Vec<[f64; 2]>,
    /// The difference.
    pub difference: Difference,
}

/// Lists the lines in which the views of a solid differ from a drawing.
///
/// Each drawn entity and each line of the solid is listed once per view and reason. The cost is two rays per
/// sample point; sample points are [`ReprojectionOptions::spacing`] apart.
///
/// ```
/// use planish_solid::brep::Solid;
/// use planish_solid::reprojection::{ReprojectionOptions, disagreements};
/// use planish_solid::views::Drawing;
///
/// let found = disagreements(&Solid::default(), &Drawing::default(), &ReprojectionOptions::default());
/// assert!(found.is_empty());
/// ```
#[must_use]
pub fn disagreements(solid: &Solid, drawing: &Drawing, options: &ReprojectionOptions) -> Vec<Disagreement> {
    compare::disagreements(solid, drawing, options)
}

/// The indices of edges whose place follows from no view of a drawing without hidden lines.
///
/// No view shows it in front of all other lines, as the rim at which a hole leaves a part: the hole might end
/// before. Edges in the outer border of a face at an end of the part do not count.
///
/// ```
/// use planish_solid::brep::Solid;
/// use planish_solid::reprojection::{ReprojectionOptions, unseen_edges};
/// use planish_solid::views::Drawing;
///
/// let options = ReprojectionOptions::default();
/// assert!(unseen_edges(&Solid::default(), &Drawing::default(), &options).is_empty());
/// ```
#[must_use]
pub fn unseen_edges(solid: &Solid, drawing: &Drawing, options: &ReprojectionOptions) -> Vec<usize> {
    unseen::unseen_edges(solid, drawing, options)
}
