//! Every solid that two or three orthographic views can mean.
//!
//! Input: a [`Drawing`], curves with their style in the model's coordinates. Output: [`Solutions`],
//! solids with true planes, cylinders, cones, spheres and tori, best first, and the lines that none of them
//! explains.
//!
//! 0. `tidy`: circles that come in pieces or are fitted roughly become one circle.
//! 1. `drawing_grid`: a grid that all views share, and what is drawn on it. A plane or a cylinder along an axis is
//!    seen edge-on as a line or circle. `turned` adds walls: outlines of one view turned about the centre of
//!    a circle of another, which no view sees edge-on. `oblique` adds planes and cylinders oblique to all
//!    views, from points and edges that all three show (`wireframe`, `circles`).
//! 2. `cells`: space cut by all of these; cells between which no line is drawn are one.
//! 3. `sight`: at every line, and where one is missing, what two lines of sight beside it pass through.
//!    `wall_sight` does so along the outlines of walls and the curves in which they cross other candidates.
//! 4. `search`: satisfiability: which cells are solid, so that visible lines are seen, hidden ones are
//!    behind something, and others are not there. Smooth (tangent) edges are no edges here, as in drafting;
//!    where no solid is found so, a drawn line may be one. `preference` says what is tried first.
//! 5. `boundary`: the faces of what is solid, as large as they can be; `touching` where a hole touches a
//!    wall.
//!
//! [`views_of_sheet`] finds the views where one file holds all of them.
//!
//! Not guaranteed: cones, spheres and tori about other axes than lines of sight, or together with faces
//! oblique to all views; freeform faces.
//!
//! # References
//! Wesley and Markowsky 1981, *Fleshing out projections*; Eén and Sörensson 2003, *An extensible SAT-solver*.

#[cfg(test)]
mod body_tests;
mod boundary;
mod candidate_surface;
mod candidates;
mod cells;
mod circles;
mod column;
mod drawing_grid;
mod joined;
mod oblique;
mod oblique_sight;
#[cfg(test)]
mod oblique_tests;
mod oblique_wall;
mod preference;
mod profile;
mod quadrics;
#[cfg(test)]
mod ring_tests;
mod rings;
mod search;
mod sheet;
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
mod wall_sight;
mod wireframe;

use crate::brep::{Measures, Solid};
pub use crate::drawing::{
    Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind, distance, distance_to_segment, nearest_on_curve,
};
use crate::reprojection::{ReprojectionOptions, disagreements};
pub use joined::joined;
use planish_estimate::{Error, ErrorKind, Result};
use search::SmoothEdges;
pub use sheet::{Projection, views_of_sheet};
use std::cmp::Ordering;

/// Surfaces of revolution are tried where there are so many candidates at most.
const MAX_WALLS: usize = 24;

/// Drawings of these sizes are looked at as they are; others are brought to a size between 100 and 1000, as
/// some accuracies are fixed lengths.
const USUAL_SIZE: [f64; 2] = [0.1, 1e6];

/// Edges and vertices nearer to each other than this share of the drawing's size are in one place; vertices
/// of one place are one within this.
const TOUCHING: f64 = 2e-5;

/// Solids are made of so many assignments at most.
pub const MAX_SOLUTIONS: usize = 32;

/// A solid that the views can mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// The solid.
    pub solid: Solid,
    /// What it measures.
    pub measures: Measures,
    /// What it is ranked by: its number of faces, and 1000 for each part that hangs together with no other.
    /// Of equally cheap ones those with fewer edges come first.
    pub cost: f64,
    /// Where its boundary touches itself, in words: such a solid is among the answers only where none is that
    /// does not.
    pub touches: Option<Rejected>,
    /// Whether two of its bodies touch: no program takes that for a solid, or for two.
    bodies_touch: bool,
}

impl Solution {
    /// The better first: one that does not touch itself, then the cheaper one, of equally cheap ones that
    /// with fewer edges.
    fn compared(&self, other: &Self) -> Ordering {
        let edges = |s: &Self| s.solid.edges.len();
        let contact = |s: &Self| u8::from(s.touches.is_some()) + u8::from(s.bodies_touch);
        contact(self)
            .cmp(&contact(other))
            .then(self.cost.total_cmp(&other.cost))
            .then(edges(self).cmp(&edges(other)))
    }

    /// Whether two solids have one volume, area and centroid, but for slivers.
    fn measures_the_same(&self, other: &Self) -> bool {
        let (a, b) = (&self.measures, &other.measures);
        let near = |x: f64, y: f64, size: f64| (x - y).abs() <= 1e-8 * size;
        near(a.volume, b.volume, a.volume)
            && near(a.area, b.area, a.area)
            && (0..3).all(|k| near(a.centroid[k], b.centroid[k], a.area.sqrt()))
    }

    /// Whether another solid has as many faces of each kind and vertices in the same places.
    fn has_vertices_of(&self, other: &Self) -> bool {
        let near = 1e-6 * self.measures.area.sqrt();
        let has = |solid: &Solid, p: [f64; 3]| {
            let mut vertices = solid.vertices.iter();
            vertices.any(|v| (0..3).all(|k| (v[k] - p[k]).abs() <= near))
        };
        self.solid.faces_by_kind() == other.solid.faces_by_kind()
            && self.solid.vertices.len() == other.solid.vertices.len()
            && self.solid.vertices.iter().all(|v| has(&other.solid, *v))
    }
}

/// A line that no solid explains.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Unexplained {
    /// The view.
    pub view: ViewKind,
    /// The entity; none where a line is missing.
    pub entity: Option<String>,
    /// What is wrong, and where.
    pub why: String,
}

/// What a drawing can mean.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solutions {
    /// Solids, best first.
    pub solutions: Vec<Solution>,
    /// Whether there are no others.
    pub complete: bool,
    /// Lines that no solid explains: where there are any, there are no solutions.
    pub unexplained: Vec<Unexplained>,
    /// Assignments of cells that explain all lines and give no solid.
    pub rejected: Vec<Rejected>,
}

/// Why an assignment of cells is no solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CandidateRejection {
    /// Its boundary touches itself along a line or at a point, where it is not manifold.
    Touches,
    /// Its boundary does not close, or its faces do not fit together.
    DoesNotClose,
}

/// An assignment of cells that is no solid.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// The reason.
    pub why: CandidateRejection,
    /// What is wrong, and where.
    pub message: String,
}

impl Solutions {
    /// Sorts the solutions, and moves those whose boundary touches itself to the rejected ones: all of them
    /// where there are others, else those of which bodies touch.
    fn keep_manifold(&mut self) {
        self.solutions.sort_by(Solution::compared);
        let any = self.solutions.iter().any(|s| s.touches.is_none());
        let (kept, touching): (Vec<_>, Vec<_>) = std::mem::take(&mut self.solutions)
            .into_iter()
            .partition(|s| s.touches.is_none() || !any && !s.bodies_touch);
        self.solutions = kept;
        self.rejected.extend(touching.into_iter().filter_map(|s| s.touches));
    }
}

/// Finds every solid whose views are the drawing, or names lines that none explains.
///
/// Where three views show planes or cylinders oblique to all of them, with these first: if that gives a
/// solid, it is the answer. Then with planes and cylinders along lines of sight only, then with surfaces of
/// revolution as well; the answer with the cheapest solid counts.
///
/// # Errors
/// `Input` where there are less than two views or nothing is drawn; `Unsupported` where the drawing is too
/// large; `Undetermined` where all lines can be explained, but no boundary of a solid closes.
pub fn solve(drawing: &Drawing) -> Result<Solutions> {
    check(drawing)?;
    let size = drawing.size();
    if !(size > 0.0 && size.is_finite()) || (USUAL_SIZE[0]..USUAL_SIZE[1]).contains(&size) {
        return solve_scaled(drawing, 1.0);
    }
    // By a power of ten, so that round coordinates stay round.
    let scale = 10_f64.powi(size.log10().floor() as i32 - 2);
    let mut found = solve_scaled(&drawing.scaled(1.0 / scale), scale).map_err(|e| {
        let in_what = format!("in units of {scale:e}");
        e.in_context(in_what)
    })?;
    for solution in &mut found.solutions {
        solution.solid = solution.solid.scaled(scale);
        solution.measures = solution.solid.measures();
    }
    Ok(found)
}

/// [`solve`] for a drawing of usual size; places that are named are in units `scale` times smaller.
fn solve_scaled(drawing: &Drawing, scale: f64) -> Result<Solutions> {
    let plain = solve_with(drawing, SmoothEdges::NotDrawn, scale);
    let is_too_large = plain.as_ref().is_err_and(|e| e.kind() == ErrorKind::Unsupported);
    if is_too_large || best_agreeing(&plain, drawing).is_some() {
        return plain;
    }
    let smooth = solve_with(drawing, SmoothEdges::MayBeDrawn, scale);
    // Of two refusals the one that names fewer lines.
    let named = |found: &Result<Solutions>| found.as_ref().map_or(usize::MAX, |f| f.unexplained.len());
    match best_agreeing(&smooth, drawing).is_some()
        || best_cost(&plain).is_none() && named(&smooth) < named(&plain)
    {
        true => smooth,
        false => plain,
    }
}

/// [`solve_scaled`] with lines that may be tangent edges or not.
fn solve_with(drawing: &Drawing, smooth_edges: SmoothEdges, scale: f64) -> Result<Solutions> {
    let tidy = tidy::tidied(drawing);
    let plan = drawing_grid::DrawingGrid::new(&tidy);
    let oblique = (!cells::is_too_fine(&plan)).then(|| oblique::oblique(&tidy)).flatten();
    if let Some(found) = oblique {
        let plan = drawing_grid::DrawingGrid::without(&tidy, &found.explained).with_walls(found.walls);
        let solved = solve_grid(&tidy, &plan, smooth_edges, scale);
        if best_cost(&solved).is_some() {
            return solved;
        }
    }
    let mut best = solve_grid(&tidy, &plan, smooth_edges, scale);
    let mut cheapest = best_agreeing(&best, drawing);
    let mut tried = Vec::new();
    for strict in [true, false] {
        // A refusal with more candidates says more; what is solved is better where it has fewer faces.
        // Candidates that not all views show are tried last.
        let is_too_large = best.as_ref().is_err_and(|e| e.kind() == ErrorKind::Unsupported);
        // With tangent edges they are not tried: freeform parts would take twice as long to be refused.
        let are_tried = cheapest.is_none() && smooth_edges == SmoothEdges::NotDrawn;
        if is_too_large || !strict && !are_tried {
            break;
        }
        let walls: Vec<candidate_surface::CandidateSurface> = turned::walls(&plan, strict)
            .into_iter()
            .map(candidate_surface::CandidateSurface::Turned)
            .collect();
        if walls == tried || walls.len() > MAX_WALLS {
            continue;
        }
        let found = solve_grid(&tidy, &plan.clone().with_walls(walls.clone()), smooth_edges, scale);
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

/// The best solid that was found and that shows the lines of the drawing.
fn best_agreeing(found: &Result<Solutions>, drawing: &Drawing) -> Option<Solution> {
    let agrees = |s: &&Solution| disagreements(&s.solid, drawing, &ReprojectionOptions::default()).is_empty();
    found.as_ref().ok()?.solutions.iter().find(agrees).cloned()
}

/// Finds the solids whose faces are candidates of a plan.
fn solve_grid(
    drawing: &Drawing,
    plan: &drawing_grid::DrawingGrid,
    smooth_edges: SmoothEdges,
    scale: f64,
) -> Result<Solutions> {
    let cells = cells::Cells::new(plan)?;
    let sight_tests = sight::SightTests::at(&cells, drawing);
    let mut solutions = Solutions::default();
    let mut known: Vec<(search::Assignment, Solution)> = Vec::new();
    let found = search::search(
        &cells,
        &sight_tests,
        smooth_edges,
        &preference::preferences(&cells),
        MAX_SOLUTIONS,
        |assignment| {
            let solution = match solution(&cells, assignment, scale) {
                Ok(solution) => solution,
                Err(rejected) => {
                    solutions.rejected.push(rejected);
                    return Vec::new();
                }
            };
            for (first, same) in known.iter_mut().filter(|k| k.1.measures_the_same(&solution)) {
                let differs = |cell: &&u32| first.get(cell) != assignment.get(cell);
                let between: Vec<u32> = assignment.keys().filter(differs).copied().collect();
                let by_slivers = between.iter().all(|cell| cells.is_sliver_only(*cell));
                if by_slivers || same.has_vertices_of(&solution) {
                    // The one whose faces and edges are cut least often stands for both.
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
    solutions.unexplained = unexplained(drawing, &found.unexplained, scale);
    if !solutions.unexplained.is_empty() {
        return Ok(solutions);
    }
    solutions.keep_manifold();
    if solutions.solutions.is_empty() {
        let why = solutions.rejected.first().map_or("", |rejected| &rejected.message);
        return Err(Error::undetermined(format!("no solid has these views: {why}")));
    }
    Ok(solutions)
}

/// Each line that no solid explains once, with the first place and how many others there are.
fn unexplained(
    drawing: &Drawing,
    found: &[(Option<LineStyle>, sight::SightTestPlace)],
    scale: f64,
) -> Vec<Unexplained> {
    let mut places: Vec<(Option<LineStyle>, &sight::SightTestPlace, usize)> = Vec::new();
    for (style, place) in found {
        let same =
            places.iter_mut().find(|p| p.0 == *style && p.1.view == place.view && p.1.curve == place.curve);
        match same {
            Some(same) => same.2 += 1,
            None => places.push((*style, place, 0)),
        }
    }
    places
        .into_iter()
        .map(|(style, place, others)| {
            let view = &drawing.views[place.view];
            let what = match style {
                Some(LineStyle::Visible) => "no solid shows a visible line",
                Some(LineStyle::Hidden) => "no solid shows a hidden line",
                None => "every solid shows a line, and none is drawn,",
            };
            let more = match others {
                0 => String::new(),
                1 => " and at one more place".to_owned(),
                n => format!(" and at {n} more places"),
            };
            Unexplained {
                view: view.kind,
                entity: place.curve.map(|c| view.curves[c].entity.clone()),
                why: format!(
                    "{what} at {} {}{more}",
                    figure(scale * place.at[0]),
                    figure(scale * place.at[1])
                ),
            }
        })
        .collect()
}

/// A coordinate with four places behind the point; of very small and large drawings in powers of ten.
fn figure(value: f64) -> String {
    match value.abs() {
        size if size == 0.0 || (1e-3..1e9).contains(&size) => format!("{value:.4}"),
        _ => format!("{value:.4e}"),
    }
}

fn solution(
    cells: &cells::Cells,
    assignment: &search::Assignment,
    scale: f64,
) -> std::result::Result<Solution, Rejected> {
    let does_not_close = |message: String| Rejected { why: CandidateRejection::DoesNotClose, message };
    let solid = boundary::boundary(cells, assignment)
        .and_then(|solid| solid.check(1e-5 * cells.plan.size).map(|()| solid))
        .map_err(|e| does_not_close(e.to_string()))?;
    let contacts = solid.contacts(TOUCHING * cells.plan.size);
    let touches = contacts.first().map(|contact| {
        let what = match (contact.is_between_bodies, contact.is_line) {
            (true, true) => "two bodies only touch along a line through",
            (true, false) => "two bodies only touch at the point",
            (false, true) => "its boundary touches itself along a line through",
            (false, false) => "its boundary touches itself at the point",
        };
        let at = contact.at.map(|c| figure(scale * c)).join(" ");
        Rejected {
            why: CandidateRejection::Touches,
            message: format!("{what} {at}, where it is not manifold"),
        }
    });
    let measures = solid.measures();
    if measures.volume <= 0.0 {
        return Err(does_not_close(format!(
            "the boundary is turned inside out: its volume is {}",
            measures.volume
        )));
    }
    Ok(Solution {
        cost: solid.faces.len() as f64 + 1000.0 * solid.bodies().len().saturating_sub(1) as f64,
        solid,
        measures,
        bodies_touch: contacts.first().is_some_and(|c| c.is_between_bodies),
        touches,
    })
}

fn check(drawing: &Drawing) -> Result<()> {
    if drawing.views.len() < 2 {
        return Err(Error::input(format!(
            "needed two or three views, found {}: one view leaves the third dimension open",
            drawing.views.len()
        )));
    }
    match drawing.views.iter().find(|v| v.curves.is_empty()) {
        Some(view) => Err(Error::input(format!("the {} view: needed lines, found none", view.kind.name()))),
        None => Ok(()),
    }
}
