//! Finds all solids that match two or three orthographic views.
//!
//! Input: a [`Drawing`], curves with line styles in model coordinates. Output: [`Solutions`], solids bounded
//! by exact planes, cylinders, cones, spheres and tori, best first, and the lines that no solid explains.
//!
//! 0. `tidy`: merges the arcs and polygons of a circle into one exact circle.
//! 1. `drawing_grid`: a grid shared by all views, with the drawn curves on it. A plane or a cylinder along
//!    an axis appears edge-on, as a line or a circle. `turned` adds walls: outlines of one view turned about
//!    the centre of a circle of another, which no view sees edge-on. `oblique` adds planes and cylinders
//!    oblique to all views, from points and edges that all three show (`wireframe`, `circles`).
//! 2. `cells`: divides space by all candidate surfaces. Cells not separated by a drawn line are merged.
//! 3. `sight`: at each drawn line, and where a line could be missing, lists the cells along two adjacent
//!    rays. `wall_sight` does so along the outlines of walls and the curves in which they cross other
//!    candidates.
//! 4. `search`: a satisfiability problem with one variable per cell (solid or empty). Visible lines must
//!    be seen, hidden lines occluded, and no other line may appear. As in drafting, tangent edges are not
//!    drawn. If no solid is found, the search is repeated with tangent edges allowed, then with bodies that
//!    touch along faces. `preference` orders the search.
//!    Sections and views without hidden lines only forbid visible edges where nothing is drawn; in a section,
//!    cells in the cutting plane are solid where it is hatched (`hatched`).
//! 5. `boundary`: the maximal faces of the solid cells; `touching` handles holes tangent to a face.
//!
//! [`crate::sheet`] finds the views of a file that holds all of them.
//!
//! Limits: cones, spheres and tori must have an axis along a line of sight, and cannot be combined with
//! faces oblique to all views. Freeform faces are not supported.
//!
//! # References
//! Wesley and Markowsky 1981, *Fleshing out projections*; Eén and Sörensson 2003, *An extensible SAT-solver*.

mod adjacent;
#[cfg(test)]
mod body_tests;
mod boundary;
mod candidate_surface;
mod candidates;
mod cells;
mod circles;
mod column;
mod contradictions;
mod drawing_grid;
mod edge_splines;
mod hatched;
mod intersections;
mod joined;
mod limits;
mod nearest;
mod oblique;
mod oblique_sight;
#[cfg(test)]
mod oblique_tests;
mod oblique_wall;
mod preference;
mod profile;
mod quadrics;
mod relations;
#[cfg(test)]
mod ring_tests;
mod rings;
mod search;
mod sight;
#[cfg(test)]
mod smooth_tests;
mod surfaces;
#[cfg(test)]
mod tests;
mod tidy;
mod touching;
mod traced;
mod turned;
mod turned_rings;
#[cfg(test)]
mod turned_tests;
mod turned_wall;
mod unexplained;
mod wall_sight;
mod wireframe;

use crate::brep::{Measures, Solid};
use crate::drawing::ViewContent;
pub use crate::drawing::{
    Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, distance, distance_to_segment, nearest_on_curve,
};
use crate::reprojection::{ReprojectionOptions, disagreements};
use cells::UnseenFaces;
use intersections::Intersections;
pub use joined::{Unrounded, coordinate_mismatches, joined, unrounded};
use limits::{check, check_slanted};
pub use nearest::{NearestSolid, solve_nearest};
use planish_core::DVec3;
use planish_estimate::{Error, ErrorKind, Result};
pub(crate) use search::Bodies;
use search::{CellState, Conventions, Explained, Regularity, SmoothEdges};
use std::cmp::Ordering;
use unexplained::figure;

/// Maximum number of candidate surfaces of revolution.
///
/// Each candidate divides the cells further, so the limit bounds the run time. With more candidates, surfaces
/// of revolution are not tried.
const MAX_WALLS: usize = 24;

/// Range of drawing sizes that are processed without scaling.
///
/// Some tolerances are absolute lengths, such as the rounding of six decimals. Drawings outside of this range
/// are scaled to a size from 100 to 1000. Scaling rounds coordinates, so it is avoided where it is not
/// needed.
const TYPICAL_SIZE: [f64; 2] = [0.1, 1e6];

/// Distance below which edges and vertices touch, relative to the size of the drawing.
///
/// Larger: narrow gaps are contacts. Smaller: contacts of inaccurate drawings are missed.
const CONTACT_DISTANCE: f64 = 2e-5;

/// Maximum number of cell assignments that are turned into solids.
///
/// It bounds the run time of ambiguous drawings. [`Solutions::complete`] is false if it was reached.
pub const MAX_SOLUTIONS: usize = 32;

/// Cost of each body after the first. It exceeds the number of faces of any solid that the search finds, so
/// that one body is preferred to two.
const COST_OF_BODY: f64 = 1000.0;

/// A solid that matches the views.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The solid.
    pub solid: Solid,
    /// Volume, area and centroid.
    pub measures: Measures,
    /// Cost by which solutions are ranked: the number of faces, plus 1000 for each body after the first.
    /// Ties are ordered by the number of edges.
    pub cost: f64,
    /// First place where the boundary touches itself. Such a solid is returned only if there is no manifold
    /// one.
    pub touches: Option<Rejected>,
    /// True if two of its bodies touch. CAD programs accept this neither as one solid nor as two.
    bodies_touch: bool,
    /// Whether equal circles are equal features.
    regularity: Regularity,
}

impl Solution {
    /// Orders solutions: first those without contacts, then by the number of bodies, those with equal
    /// features, by cost, and by the number of edges.
    fn compared(&self, other: &Self) -> Ordering {
        let edges = |s: &Self| s.solid.edges.len();
        let contact = |s: &Self| u8::from(s.touches.is_some()) + u8::from(s.bodies_touch);
        let more_bodies = |s: &Self| (s.cost / COST_OF_BODY) as u64;
        contact(self)
            .cmp(&contact(other))
            .then(more_bodies(self).cmp(&more_bodies(other)))
            .then(self.regularity.cmp(&other.regularity))
            .then(self.cost.total_cmp(&other.cost))
            .then(edges(self).cmp(&edges(other)))
    }

    /// True if volume, area and centroid agree to a relative 1e-8, which ignores slivers.
    ///
    /// Equal measures do not prove equal solids: a hole may be in two places (see `solve_grid`).
    fn measures_the_same(&self, other: &Self) -> bool {
        let (a, b) = (&self.measures, &other.measures);
        let near = |x: f64, y: f64, size: f64| (x - y).abs() <= 1e-8 * size;
        // Each is compared relative to a size of its own unit; a centroid may be at the origin.
        near(a.volume, b.volume, a.volume)
            && near(a.area, b.area, a.area)
            && (0..3).all(|k| near(a.centroid[k], b.centroid[k], a.area.sqrt()))
    }

    /// True if both are the same solid, within rounding.
    pub(crate) fn is_same_solid(&self, other: &Self) -> bool {
        self.measures_the_same(other) && self.has_vertices_of(other)
    }

    /// True if the other solid has the same vertices and the same number of faces of each kind.
    fn has_vertices_of(&self, other: &Self) -> bool {
        let near = 1e-6 * self.measures.area.sqrt();
        let has = |solid: &Solid, p: DVec3| {
            let mut vertices = solid.vertices.iter();
            vertices.any(|v| (0..3).all(|k| (v[k] - p[k]).abs() <= near))
        };
        self.solid.faces_by_kind() == other.solid.faces_by_kind()
            && self.solid.vertices.len() == other.solid.vertices.len()
            && self.solid.vertices.iter().all(|v| has(&other.solid, *v))
    }
}

/// A drawn or missing line that no solid explains.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unexplained {
    /// The view.
    pub view: ViewKind,
    /// Name of the drawn entity; `None` if a line is missing from the drawing.
    pub entity: Option<String>,
    /// Description of the problem, with its position.
    pub reason: String,
}

/// The result of [`solve`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solutions {
    /// Solids, best first.
    pub solutions: Vec<Solution>,
    /// True if the list contains all solids.
    pub complete: bool,
    /// Lines that no solid explains. If there are any, `solutions` is empty.
    pub unexplained: Vec<Unexplained>,
    /// Assignments of cells that explain all lines but do not bound a valid solid.
    pub rejected: Vec<Rejected>,
    /// True if views omit hidden lines, and the visible lines can be explained only by faces at depths that
    /// no line shows.
    pub has_unseen_faces: bool,
}

/// Reason why an assignment of cells is not a valid solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CandidateRejection {
    /// Its boundary touches itself along a line or at a point, where it is not manifold.
    Touches,
    /// Its boundary does not close, or its faces do not fit together.
    DoesNotClose,
}

/// An assignment of cells that is not a valid solid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// The reason.
    pub reason: CandidateRejection,
    /// Description of the problem, with its position.
    pub message: String,
}

impl Solutions {
    /// Sorts the solutions and rejects those whose boundary touches itself.
    ///
    /// If no solution is manifold, only those with touching bodies are rejected.
    fn keep_manifold(&mut self) {
        self.solutions.sort_by(Solution::compared);
        // Some parts have only solids that touch themselves, for example two pockets that meet at a corner;
        // CAD programs read these. They do not read bodies that only touch.
        let any = self.solutions.iter().any(|s| s.touches.is_none());
        let (kept, touching): (Vec<_>, Vec<_>) = std::mem::take(&mut self.solutions)
            .into_iter()
            .partition(|s| s.touches.is_none() || !any && !s.bodies_touch);
        self.solutions = kept;
        self.rejected.extend(touching.into_iter().filter_map(|s| s.touches));
    }
}

/// Finds all solids that match the drawing, or lists the lines that no solid explains.
///
/// Candidate surfaces are added in stages. If three views show planes or cylinders oblique to all of them,
/// these are tried first, and a solid found with them is the result. Next come planes and cylinders along
/// lines of sight, then surfaces of revolution. The stage with the cheapest solid wins.
///
/// ```
/// use planish_solid::views::{Drawing, solve};
///
/// // At least two views are needed.
/// assert!(solve(&Drawing::default()).is_err());
/// ```
///
/// # Errors
/// `Input` if there are fewer than two views or a view is empty; `Unsupported` if the drawing has too many
/// cells; `Undetermined` if all lines can be explained, but no boundary of a solid closes.
pub fn solve(drawing: &Drawing) -> Result<Solutions> {
    in_usual_size(drawing, solve_scaled)
}

/// Finds solids of a drawing with a doubtful view, without tangent edges.
pub(crate) fn solve_doubtful(drawing: &Drawing, bodies: Bodies) -> Result<Solutions> {
    let conventions = Conventions { bodies, ..Conventions::USUAL };
    in_usual_size(drawing, |drawing, scale| solve_with(drawing, conventions, scale))
}

/// Scales a drawing to a typical size, solves it, and scales the solids back.
fn in_usual_size(drawing: &Drawing, solve: impl Fn(&Drawing, f64) -> Result<Solutions>) -> Result<Solutions> {
    check(drawing)?;
    let size = drawing.size();
    // A drawing without a size cannot be scaled; the search reports what is wrong with it.
    if !(size > 0.0 && size.is_finite()) || (TYPICAL_SIZE[0]..TYPICAL_SIZE[1]).contains(&size) {
        return solve(drawing, 1.0);
    }
    // By a power of ten, so that round coordinates stay round: `representative` prefers round values.
    let scale = 10_f64.powi(size.log10().floor() as i32 - 2);
    let mut found = solve(&drawing.scaled(1.0 / scale), scale).map_err(|e| {
        let in_what = format!("in units of {scale:e}");
        e.in_context(in_what)
    })?;
    // Measures are computed again instead of scaled by three powers of the factor.
    for solution in &mut found.solutions {
        solution.solid = solution.solid.scaled(scale);
        solution.measures = solution.solid.measures();
    }
    Ok(found)
}

/// Runs [`solve`] on a scaled drawing. Positions in messages are multiplied by `scale`.
fn solve_scaled(drawing: &Drawing, scale: f64) -> Result<Solutions> {
    // Drafting does not draw tangent edges, so drawings are first read without them. With them, each tangent
    // line would be one more explanation of a line that is really a sharp edge.
    let conventions = Conventions::USUAL;
    if drawing.views.iter().any(|view| view.content == ViewContent::VisibleEdges) {
        let seen = Conventions { unseen_faces: UnseenFaces::Excluded, ..conventions };
        let found = solve_with(drawing, seen, scale);
        // A hole with a counterbore of unknown depth would be an annular hole around a separate pin.
        if best_agreeing(&found, drawing).is_some_and(|best| best.cost < COST_OF_BODY) {
            return found;
        }
    }
    let plain = solve_with(drawing, conventions, scale);
    let is_too_large = plain.as_ref().is_err_and(|e| e.kind() == ErrorKind::Unsupported);
    if is_too_large || best_agreeing(&plain, drawing).is_some() {
        return plain;
    }
    let smooth_edges = SmoothEdges::MayBeDrawn;
    let smooth = solve_with(drawing, Conventions { smooth_edges, ..conventions }, scale);
    // Bodies that touch come last: each boss may be a body of its own, which only adds solids.
    if best_agreeing(&smooth, drawing).is_none() {
        let touching = solve_with(drawing, Conventions { bodies: Bodies::MayTouch, ..conventions }, scale);
        if best_agreeing(&touching, drawing).is_some() {
            return touching;
        }
    }
    // If both fail: the result with fewer unexplained lines.
    let named = |found: &Result<Solutions>| found.as_ref().map_or(usize::MAX, |f| f.unexplained.len());
    match best_agreeing(&smooth, drawing).is_some()
        || best_cost(&plain).is_none() && named(&smooth) < named(&plain)
    {
        true => smooth,
        false => plain,
    }
}

/// Solves in one reading of the drawing.
fn solve_with(drawing: &Drawing, conventions: Conventions, scale: f64) -> Result<Solutions> {
    check_slanted(drawing)?;
    let tidy = tidy::tidied(drawing);
    cells::check_size(&tidy)?;
    let plan = drawing_grid::DrawingGrid::new(&tidy);
    let oblique = (!cells::is_too_fine(&plan)).then(|| oblique::oblique(&tidy)).flatten();
    // Lines explained by oblique faces are left out of the grid. Otherwise a block in general position would
    // have thousands of cells, each cut by prisms that bound nothing.
    if let Some(found) = oblique {
        let plan = drawing_grid::DrawingGrid::without(&tidy, &found.explained).with_walls(found.walls);
        let solved = solve_grid(&tidy, &plan, conventions, scale);
        if best_cost(&solved).is_some() {
            return solved;
        }
    }
    let mut best = solve_grid(&tidy, &plan, conventions, scale);
    let mut cheapest = best_agreeing(&best, drawing);
    let mut tried = Vec::new();
    for strict in [true, false] {
        // Candidates that not all views support are tried last. A failure with more candidates is more
        // informative; of two solved drawings, the solid with fewer faces is better.
        let is_too_large = best.as_ref().is_err_and(|e| e.kind() == ErrorKind::Unsupported);
        // Not tried with tangent edges: freeform parts would take twice as long to be rejected.
        // Strict candidates come first because the centre of every fillet also makes a false torus.
        // Nor for doubtful views: each of them is searched once.
        let is_doubtful = drawing.views.iter().any(|view| view.content == ViewContent::Doubtful);
        let is_usual = Conventions { unseen_faces: UnseenFaces::Allowed, ..conventions };
        let is_first = is_usual == Conventions::USUAL && !is_doubtful;
        let are_tried = cheapest.is_none() && is_first;
        if is_too_large || !strict && !are_tried {
            break;
        }
        let walls: Vec<candidate_surface::CandidateSurface> = turned::walls(&plan, strict)
            .into_iter()
            .map(candidate_surface::CandidateSurface::Turned)
            .collect();
        // The same candidates as in the strict pass would give the same result again.
        if walls == tried || walls.len() > MAX_WALLS {
            continue;
        }
        let found = solve_grid(&tidy, &plan.clone().with_walls(walls.clone()), conventions, scale);
        tried = walls;
        let found_cheapest = best_agreeing(&found, drawing);
        let is_better = match (&found_cheapest, &cheapest) {
            (Some(found), Some(best)) => found.compared(best).is_lt(),
            (None, Some(_)) => false,
            (Some(_), None) => true,
            (None, None) => best_cost(&found).is_some() || best_cost(&best).is_none(),
        };
        if is_better {
            (best, cheapest) = (found, found_cheapest);
        }
    }
    best
}

/// The cost of the best solid that was found.
fn best_cost(found: &Result<Solutions>) -> Option<f64> {
    found.as_ref().ok()?.solutions.first().map(|s| s.cost)
}

/// The best solid whose reprojection agrees with the drawing.
///
/// The search tests sampled positions and can miss a line, so its solids are checked before they compete.
fn best_agreeing(found: &Result<Solutions>, drawing: &Drawing) -> Option<Solution> {
    let agrees = |s: &&Solution| disagreements(&s.solid, drawing, &ReprojectionOptions::default()).is_empty();
    found.as_ref().ok()?.solutions.iter().find(agrees).cloned()
}

/// Finds the solids whose faces lie on the candidate surfaces of a grid.
fn solve_grid(
    drawing: &Drawing,
    plan: &drawing_grid::DrawingGrid,
    conventions: Conventions,
    scale: f64,
) -> Result<Solutions> {
    let cells = cells::Cells::new(plan, conventions.unseen_faces)?;
    let sight_tests = sight::SightTests::at(&cells, drawing);
    let mut solutions = Solutions::default();
    let mut intersections = Intersections::new(&cells);
    let mut known: Vec<(search::Assignment, Solution)> = Vec::new();
    let found = search::search(
        &cells,
        &sight_tests,
        conventions,
        &preference::Preferences::of_cells(&cells),
        MAX_SOLUTIONS,
        |assignment, regularity| {
            if !search::seconds_share_faces(assignment, &sight_tests) {
                return Vec::new();
            }
            let solution = match solution(&cells, &mut intersections, assignment, scale) {
                Ok(solution) => Solution { regularity, ..solution },
                Err(rejected) => {
                    solutions.rejected.push(rejected);
                    return Vec::new();
                }
            };
            // Two assignments may differ only in slivers and then give one solid. Cells alone do not show
            // this, because samples miss small cells; measures alone do not, because a hole may be in two
            // places with the same volume, area and centroid. Both are required.
            for (first, same) in known.iter_mut().filter(|k| k.1.measures_the_same(&solution)) {
                let differs = |cell: &&u32| first.get(cell) != assignment.get(cell);
                let between: Vec<u32> = assignment.keys().filter(differs).copied().collect();
                let by_slivers = between.iter().all(|cell| cells.is_sliver_only(*cell));
                if by_slivers || same.has_vertices_of(&solution) {
                    // Keep the solution with the fewest faces and edges.
                    if solution.compared(same).is_lt() {
                        (*first, *same) = (assignment.clone(), solution);
                    }
                    return if by_slivers { between } else { Vec::new() };
                }
            }
            known.push((assignment.clone(), solution));
            Vec::new()
        },
    );
    solutions.solutions = known.into_iter().map(|k| k.1).collect();
    solutions.complete = found.complete;
    let omits_hidden = |view: &View| view.content == ViewContent::VisibleEdges;
    solutions.has_unseen_faces =
        conventions.unseen_faces == UnseenFaces::Allowed && drawing.views.iter().any(omits_hidden);
    solutions.unexplained = unexplained::unexplained(drawing, &found.unexplained, scale);
    if conventions.explained == Explained::All && !solutions.unexplained.is_empty() {
        // Not an error: the caller reports the lines.
        return Ok(solutions);
    }
    let is_empty = solutions.solutions.is_empty();
    if is_empty && solutions.rejected.is_empty() && !found.complete {
        return Err(Error::unsupported(
            "the search ended at its limit before it found a solid: fewer lines, or more views and hidden \
             lines, make it smaller",
        ));
    }
    solutions.keep_manifold();
    if solutions.solutions.is_empty() {
        let reason = solutions.rejected.first().map_or("", |rejected| &rejected.message);
        return Err(Error::undetermined(format!("no solid has these views: {reason}")));
    }
    Ok(solutions)
}

/// Builds and checks the solid of an assignment. Positions in messages are multiplied by `scale`.
fn solution<'a>(
    cells: &'a cells::Cells<'a>,
    intersections: &mut Intersections<'a>,
    assignment: &search::Assignment,
    scale: f64,
) -> std::result::Result<Solution, Rejected> {
    let does_not_close = |message: String| Rejected { reason: CandidateRejection::DoesNotClose, message };
    let mut solid = Solid::default();
    let mut contacts = Vec::new();
    for state in [CellState::First, CellState::Second] {
        if !assignment.values().any(|s| *s == state) {
            continue;
        }
        let part = boundary::boundary(cells, intersections, assignment, state)
            .and_then(|solid| solid.check(1e-5 * cells.plan.size).map(|()| solid))
            .map_err(|e| does_not_close(e.to_string()))?;
        // The check accepts a boundary that touches itself, since each part closes; contacts are found
        // separately. Bodies of different states may share faces.
        contacts.extend(part.contacts(CONTACT_DISTANCE * cells.plan.size));
        solid.append(part);
    }
    contacts.sort_by_key(|contact| !contact.is_between_bodies);
    let touches = contacts.first().map(|contact| {
        let what = match (contact.is_between_bodies, contact.is_line) {
            (true, true) => "two bodies only touch along a line through",
            (true, false) => "two bodies only touch at the point",
            (false, true) => "its boundary touches itself along a line through",
            (false, false) => "its boundary touches itself at the point",
        };
        let at = contact.at.to_array().map(|c| figure(scale * c)).join(" ");
        Rejected {
            reason: CandidateRejection::Touches,
            message: format!("{what} {at}, where it is not manifold"),
        }
    });
    let measures = solid.measures();
    // The volume is an integral over outward faces, so a negative one means that the loops are reversed.
    if measures.volume <= 0.0 {
        return Err(does_not_close(format!(
            "the boundary is turned inside out: its volume is {}",
            measures.volume
        )));
    }
    Ok(Solution {
        // Any solid of one body is preferred to two bodies, whatever its number of faces.
        cost: solid.faces.len() as f64 + COST_OF_BODY * solid.bodies().len().saturating_sub(1) as f64,
        solid,
        measures,
        bodies_touch: contacts.first().is_some_and(|c| c.is_between_bodies),
        regularity: Regularity::Any,
        touches,
    })
}
