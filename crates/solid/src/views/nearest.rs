//! The solid that explains most of a drawing, if none explains all of it.
//!
//! Input: a drawing with errors, such as lines that are missing, false, or in the wrong style. Output:
//! [`NearestSolid`], a solid whose views differ from the drawing as little as was found, and the differences.
//!
//! The search drops sight tests that contradict others, those with the fewest places first, until the rest
//! holds together. Cells that no test decides are solid. The solids that follow are compared with the drawing
//! by [`disagreements`], and the one with the greatest agreement is returned.
//!
//! Limits: the set of tests that are dropped is not always the smallest one, and no solid is returned if no
//! boundary closes.

use super::search::{Conventions, Explained};
use super::{MAX_WALLS, Solution, candidate_surface, cells, check_slanted, drawing_grid, in_usual_size};
use super::{Solutions, solve_grid, tidy, turned};
use crate::drawing::Drawing;
use crate::reprojection::{Disagreement, ReprojectionOptions, disagreements};
use planish_estimate::Result;

/// Maximum number of solids of a set of candidate surfaces that are compared with the drawing.
const MAX_COMPARED: usize = 4;

/// A solid that explains most of a drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct NearestSolid {
    /// The solid.
    pub solution: Solution,
    /// The lines in which it differs from the drawing.
    pub differences: Vec<Disagreement>,
    /// Common length of the lines, divided by that of all lines: 1 if the views agree.
    pub agreement: f64,
}

/// Finds a solid that explains most of a drawing; none if no boundary closes.
///
/// The agreement is (L − d) / (L + n): L is the length of all drawn lines, d that of the drawn lines that the
/// solid does not show, and n that of the lines of the solid that are not drawn.
///
/// ```
/// use planish_solid::drawing::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind};
/// use planish_solid::reprojection::ReprojectionOptions;
/// use planish_solid::views::solve_nearest;
///
/// let rectangle = |w: f64, h: f64| {
///     let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
///     let line = |k: usize| DrawnCurve {
///         curve: Curve2::Segment(corners[k], corners[(k + 1) % 4]),
///         style: LineStyle::Visible,
///         entity: format!("side {k}"),
///     };
///     (0..4).map(line).collect::<Vec<_>>()
/// };
/// let mut views = vec![
///     View::new(ViewKind::Front, rectangle(40.0, 20.0)),
///     View::new(ViewKind::Top, rectangle(40.0, 30.0)),
///     View::new(ViewKind::Side, rectangle(30.0, 20.0)),
/// ];
/// // A line of the top view that no other view explains.
/// let stray = Curve2::Segment([12.0, 4.0], [17.0, 4.0]);
/// views[1].curves.push(DrawnCurve { curve: stray, style: LineStyle::Visible, entity: "stray".into() });
/// let found = solve_nearest(&Drawing { views }, &ReprojectionOptions::default())?.unwrap();
/// assert!((found.solution.measures.volume - 24_000.0).abs() < 1e-6);
/// assert_eq!(found.differences[0].entity.as_deref(), Some("stray"));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # Errors
/// `Input` if there are fewer than two views or a view is empty; `Unsupported` if the drawing has too many
/// cells.
pub fn solve_nearest(drawing: &Drawing, options: &ReprojectionOptions) -> Result<Option<NearestSolid>> {
    let found = in_usual_size(drawing, most_explained)?;
    let compared = found.solutions.into_iter().map(|solution| NearestSolid::new(solution, drawing, options));
    Ok(compared.max_by(|a, b| a.agreement.total_cmp(&b.agreement)))
}

impl NearestSolid {
    /// Compares a solid with a drawing.
    #[must_use]
    pub fn new(solution: Solution, drawing: &Drawing, options: &ReprojectionOptions) -> Self {
        let differences = disagreements(&solution.solid, drawing, options);
        let agreement = agreement(drawing, &differences, options);
        Self { solution, differences, agreement }
    }
}

/// Solids without surfaces of revolution, and with those that all views support.
fn most_explained(drawing: &Drawing, scale: f64) -> Result<Solutions> {
    check_slanted(drawing)?;
    let conventions = Conventions { explained: Explained::Most, ..Conventions::USUAL };
    let tidy = tidy::tidied(drawing);
    cells::check_size(&tidy)?;
    let plan = drawing_grid::DrawingGrid::new(&tidy);
    let walls: Vec<_> =
        turned::walls(&plan, true).into_iter().map(candidate_surface::CandidateSurface::Turned).collect();
    let has_walls = (1..=MAX_WALLS).contains(&walls.len());
    let plain = solve_grid(&tidy, &plan, conventions, scale);
    if !has_walls {
        return plain.or_else(|_| Ok(Solutions::default()));
    }
    let turned = solve_grid(&tidy, &plan.with_walls(walls), conventions, scale);
    let solutions = [plain, turned].into_iter().flatten();
    let solutions = solutions.flat_map(|f| f.solutions.into_iter().take(MAX_COMPARED)).collect();
    Ok(Solutions { solutions, ..Solutions::default() })
}

/// Common length of the lines of a drawing and of a solid, divided by that of all lines.
fn agreement(drawing: &Drawing, differences: &[Disagreement], options: &ReprojectionOptions) -> f64 {
    let spacing = options.spacing * drawing.size();
    let drawn: f64 = drawing.views.iter().flat_map(|v| &v.curves).map(|c| c.curve.length()).sum();
    let (mut unexplained, mut undrawn) = (0.0, 0.0);
    for difference in differences {
        let length = spacing * difference.places.len() as f64;
        match difference.entity {
            Some(_) => unexplained += length,
            None => undrawn += length,
        }
    }
    ((drawn - unexplained) / (drawn + undrawn)).max(0.0)
}
