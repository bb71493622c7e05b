//! The solid that explains a drawing after the least edit, if no solid explains it as it is.
//!
//! Input: a drawing. Output: [`Repair`], the solid and the edits: lines that are added, removed, moved, or
//! drawn in the other style.
//!
//! One view after the other is [`ViewContent::Doubtful`]: nothing follows from its missing lines, and one of
//! its lines may be left out. Every solid that explains the other views and the remaining lines is compared
//! with the drawing by [`disagreements`]; the differences are the edits. So their number does not depend on
//! how the solid was found. The solid with the smallest cost of edits wins.
//!
//! Limits: at most one line that contradicts others, in one view, and at most [`MAX_COST`] of edits. Sections
//! are kept as they are.

#[cfg(test)]
mod tests;

use crate::drawing::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewContent, ViewKind};
use crate::drawing::{distance, nearest_on_curve};
use crate::reprojection::{Difference, Disagreement, ReprojectionOptions, disagreements};
use crate::sheet::circles_across;
use crate::views::{Bodies, Solution, solve_doubtful};
use planish_contour::planar::circle_of_points;
use std::f64::consts::TAU;

/// Maximum cost of a repair. Every drawing shows a solid after enough edits, so more would prove nothing.
pub const MAX_COST: f64 = 2.0;
/// Cost of a moved line: more than one line that is added or removed, less than both.
const COST_OF_MOVE: f64 = 1.5;
/// Distance within which ends of lines meet, relative to the size of the drawing.
const ACCURACY: f64 = 1e-5;
/// Maximum number of curves of a drawing that is repaired. Each view is searched several times, which takes
/// more than a minute for some larger drawings.
const MAX_CURVES: usize = 120;
/// Distance within which a candidate is a drawn curve, in distances of ends that meet.
const COINCIDENT: f64 = 10.0;
/// Maximum number of open ends of a view that are joined by candidates. A missing line leaves two.
const MAX_OPEN_ENDS: usize = 6;
/// Maximum difference of the sizes of a line before and after it is moved, relative to the larger one. The
/// ends of a moved line often change.
const SIMILAR: f64 = 0.3;

/// What is done to a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EditKind {
    /// A missing line is added.
    Add,
    /// A line is removed, or the part of it that the solid does not show.
    Remove,
    /// A line is moved.
    Move,
    /// A visible line is drawn hidden, or a hidden one visible.
    Restyle,
}

impl EditKind {
    /// Its name in messages and JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Add => "add",
            Self::Remove => "remove",
            Self::Move => "move",
            Self::Restyle => "restyle",
        }
    }
}

/// An edit of a drawing.
#[derive(Debug, Clone, PartialEq)]
pub struct Edit {
    /// What is done.
    pub kind: EditKind,
    /// The view.
    pub view: ViewKind,
    /// The entity; none for an added line.
    pub entity: Option<String>,
    /// The style after the edit, or that of the removed line.
    pub style: LineStyle,
    /// Places along the line before the edit; those of the new line if it is added.
    pub places: Vec<[f64; 2]>,
    /// Places along the line after it is moved.
    pub moved_to: Vec<[f64; 2]>,
}

impl Edit {
    fn cost(&self) -> f64 {
        if self.kind == EditKind::Move { COST_OF_MOVE } else { 1.0 }
    }
}

/// The solid of a drawing after edits.
#[derive(Debug, Clone, PartialEq)]
pub struct Repair {
    /// The solid.
    pub solution: Solution,
    /// The edits, those of most places first.
    pub edits: Vec<Edit>,
    /// Number of other solids with edits of the same cost.
    pub others: usize,
}

impl Repair {
    /// The cost of all edits.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.edits.iter().map(Edit::cost).sum()
    }
}

/// Finds the solid with the least edit of a drawing; none if more edits are needed than [`MAX_COST`].
///
/// ```
/// use planish_solid::drawing::{Curve2, Drawing, DrawnCurve, LineStyle, View, ViewKind};
/// use planish_solid::repair::{EditKind, repair};
///
/// let line = |a: [f64; 2], b: [f64; 2]| DrawnCurve {
///     curve: Curve2::Segment(a, b),
///     style: LineStyle::Visible,
///     entity: format!("line from {a:?}"),
/// };
/// let rectangle = |w: f64, h: f64| {
///     let corners = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
///     (0..4).map(|k| line(corners[k], corners[(k + 1) % 4])).collect::<Vec<_>>()
/// };
/// // A block with a step: the top view lacks the line of the step.
/// let corners = [[0.0, 0.0], [40.0, 0.0], [40.0, 10.0], [15.0, 10.0], [15.0, 20.0], [0.0, 20.0]];
/// let front = (0..6).map(|k| line(corners[k], corners[(k + 1) % 6])).collect();
/// let mut side = rectangle(30.0, 20.0);
/// side.push(line([0.0, 10.0], [30.0, 10.0]));
/// let views = vec![
///     View::new(ViewKind::Front, front),
///     View::new(ViewKind::Top, rectangle(40.0, 30.0)),
///     View::new(ViewKind::Side, side),
/// ];
/// let found = repair(&Drawing { views }).unwrap();
/// assert_eq!((found.edits.len(), found.edits[0].kind), (1, EditKind::Add));
/// assert_eq!(found.edits[0].view, ViewKind::Top);
/// assert!((found.solution.measures.volume - 16_500.0).abs() < 1e-6);
/// ```
#[must_use]
pub fn repair(drawing: &Drawing) -> Option<Repair> {
    if drawing.views.iter().map(|view| view.curves.len()).sum::<usize>() > MAX_CURVES {
        return None;
    }
    let apart = repair_with(drawing, Bodies::Apart);
    if apart.as_ref().is_some_and(|repair| repair.cost() <= COST_OF_MOVE) {
        return apart;
    }
    // Two edits of one body may be one edit of bodies that touch.
    let touching = repair_with(drawing, Bodies::MayTouch);
    [apart, touching].into_iter().flatten().min_by(|a, b| a.cost().total_cmp(&b.cost()))
}

fn repair_with(drawing: &Drawing, bodies: Bodies) -> Option<Repair> {
    let mut best: Option<Repair> = None;
    // Sections repeat surfaces of views, which makes the search fail where lines are missing; the comparison
    // below includes them.
    let views = drawing.without_sections().unwrap_or_else(|| drawing.clone());
    for v in 0..views.views.len() {
        if views.views[v].content != ViewContent::AllEdges {
            continue;
        }
        let mut doubtful = views.clone();
        doubtful.views[v].content = ViewContent::Doubtful;
        let curves = missing_candidates(&doubtful, v);
        if !curves.is_empty() {
            let kind = views.views[v].kind;
            doubtful.views.push(View { kind, curves, content: ViewContent::Candidates });
        }
        // A view that no solid explains without one of its lines has another error.
        let Ok(found) = solve_doubtful(&doubtful, bodies) else { continue };
        for solution in found.solutions {
            let found = disagreements(&solution.solid, drawing, &ReprojectionOptions::default());
            let edits = edits(drawing, &found);
            let candidate = Repair { solution, edits, others: 0 };
            let cost = candidate.cost();
            if cost > MAX_COST {
                continue;
            }
            match &mut best {
                Some(known) if known.solution.is_same_solid(&candidate.solution) => {}
                Some(known) if cost > known.cost() => {}
                Some(known) if cost == known.cost() => known.others += 1,
                _ => best = Some(candidate),
            }
        }
    }
    best
}

/// The edits that make a drawing show the lines of a solid.
fn edits(drawing: &Drawing, found: &[Disagreement]) -> Vec<Edit> {
    let mut edits: Vec<Edit> = Vec::new();
    for difference in found {
        let shown = drawing.views.iter().find(|view| view.kind == difference.view);
        let Some(edit) = shown.and_then(|view| edit(view, difference)) else { continue };
        // Edges behind each other have one image.
        let near = ReprojectionOptions::default().near * drawing.size();
        let same = |known: &&mut Edit| known.view == edit.view && is_same_line(known, &edit, near);
        match edits.iter_mut().find(same) {
            // The line in front decides the style.
            Some(known) => {
                if edit.style == LineStyle::Visible && edit.kind == EditKind::Add {
                    known.style = LineStyle::Visible;
                }
                if edit.places.len() > known.places.len() {
                    known.places = edit.places;
                }
            }
            None => edits.push(edit),
        }
    }
    let mut edits = with_moves(drawing, edits);
    edits.sort_by_key(|edit| std::cmp::Reverse(edit.places.len()));
    edits
}

/// The edit for a difference; none for hatches, which have no line.
fn edit(view: &View, found: &Disagreement) -> Option<Edit> {
    let drawn = |entity: &Option<String>| {
        let named = view.curves.iter().find(|c| Some(&c.entity) == entity.as_ref());
        named.map_or(LineStyle::Visible, |c| c.style)
    };
    let (kind, style, entity) = match found.difference {
        Difference::NotShown(style) => (EditKind::Remove, style, found.entity.clone()),
        Difference::IsHidden => (EditKind::Restyle, LineStyle::Hidden, found.entity.clone()),
        Difference::IsVisible => {
            let at = *found.places.first()?;
            let entity = nearest(view, at, LineStyle::Hidden).map(|c| c.entity.clone());
            (EditKind::Restyle, LineStyle::Visible, entity)
        }
        Difference::NotDrawn(style) => (EditKind::Add, style, None),
        Difference::Hatching { .. } => (EditKind::Remove, drawn(&found.entity), None),
    };
    Some(Edit { kind, view: view.kind, entity, style, places: found.places.clone(), moved_to: Vec::new() })
}

/// The curve of a style that is nearest to a point.
fn nearest(view: &View, at: [f64; 2], style: LineStyle) -> Option<&DrawnCurve> {
    let off = |c: &DrawnCurve| distance(nearest_on_curve(&c.curve, at), at);
    view.curves.iter().filter(|c| c.style == style).min_by(|a, b| off(a).total_cmp(&off(b)))
}

/// Whether two edits are of one line: of one entity, or along one line or circle. A line that is missing may
/// be the image of several edges, behind or after each other.
fn is_same_line(a: &Edit, b: &Edit, near: f64) -> bool {
    if a.kind != b.kind || a.entity != b.entity {
        return false;
    }
    if a.entity.is_some() {
        return true;
    }
    let (few, many) = if a.places.len() <= b.places.len() { (a, b) } else { (b, a) };
    let (first, last) = (many.places[0], many.places[many.places.len() - 1]);
    let is_near = |curve: Curve2, places: &[[f64; 2]]| {
        places.iter().all(|p| distance(nearest_on_curve(&curve, *p), *p) <= near)
    };
    // Beyond its ends as well.
    let far = [0, 1].map(|k| 1e3 * (last[k] - first[k]));
    let line = Curve2::Segment([0, 1].map(|k| first[k] - far[k]), [0, 1].map(|k| last[k] + far[k]));
    if first != last && is_near(line.clone(), &many.places) {
        return is_near(line, &few.places);
    }
    let middle = many.places[many.places.len() / 2];
    circle_of_points(&[first, middle, last]).is_some_and(|c| {
        let circle = Curve2::Arc { center: [c[0], c[1]], radius: c[2], start: 0.0, sweep: TAU };
        is_near(circle.clone(), &many.places) && is_near(circle, &few.places)
    })
}

/// Curves that may be missing in a view and that no other view sees edge-on: circles, by pairs of lines in
/// the other views, and lines between open ends.
fn missing_candidates(drawing: &Drawing, v: usize) -> Vec<DrawnCurve> {
    let near = ACCURACY * drawing.size();
    let view = &drawing.views[v];
    let mut found = circles_across(drawing, view.kind, near);
    let ends: Vec<[f64; 2]> = (view.curves.iter().enumerate())
        .filter(|(_, drawn)| drawn.style == LineStyle::Visible)
        .flat_map(|(k, drawn)| {
            let points = drawn.curve.points();
            let ends = [points[0], points[points.len() - 1]];
            let is_closed = distance(ends[0], ends[1]) <= near;
            ends.into_iter().filter(move |_| !is_closed).map(move |end| (k, end))
        })
        .filter(|(k, end)| {
            let mut others = view.curves.iter().enumerate().filter(|(other, _)| other != k);
            !others.any(|(_, other)| distance(nearest_on_curve(&other.curve, *end), *end) <= near)
        })
        .map(|(_, end)| end)
        .collect();
    let open = if ends.len() > MAX_OPEN_ENDS { &[][..] } else { &ends[..] };
    for (k, a) in open.iter().enumerate() {
        found.extend(open[k + 1..].iter().filter(|b| distance(*a, **b) > near).map(|b| DrawnCurve {
            curve: Curve2::Segment(*a, *b),
            style: LineStyle::Visible,
            entity: "candidate line".to_owned(),
        }));
    }
    // A surface that is drawn already would be there twice.
    let is_drawn = |candidate: &DrawnCurve| {
        let mut places = candidate.curve.points();
        if let [a, b] = places[..] {
            places = vec![[0, 1].map(|k| (a[k] + b[k]) / 2.0)];
        }
        let is_on = |p: &[f64; 2]| {
            view.curves.iter().any(|c| distance(nearest_on_curve(&c.curve, *p), *p) <= COINCIDENT * near)
        };
        places.iter().all(is_on)
    };
    found.retain(|candidate| !is_drawn(candidate));
    found
}

/// Joins the removal of a line and the addition of a similar one in the same view to a move.
fn with_moves(drawing: &Drawing, edits: Vec<Edit>) -> Vec<Edit> {
    let (mut added, mut found): (Vec<Edit>, Vec<Edit>) =
        edits.into_iter().partition(|edit| edit.kind == EditKind::Add);
    for removed in found.iter_mut().filter(|edit| edit.kind == EditKind::Remove) {
        let view = drawing.views.iter().find(|view| view.kind == removed.view);
        let curve = view.and_then(|v| v.curves.iter().find(|c| Some(&c.entity) == removed.entity.as_ref()));
        let Some(curve) = curve else { continue };
        let similar = |edit: &Edit| {
            edit.view == removed.view
                && edit.style == removed.style
                && is_similar(
                    &curve.curve,
                    &edit.places,
                    ReprojectionOptions::default().spacing * drawing.size(),
                )
        };
        if let Some(at) = added.iter().position(similar) {
            removed.kind = EditKind::Move;
            removed.moved_to = added.remove(at).places;
        }
    }
    found.extend(added);
    found
}

/// Whether places are along a curve of the same direction and nearly the same size.
fn is_similar(curve: &Curve2, places: &[[f64; 2]], spacing: f64) -> bool {
    let extent = |points: &[[f64; 2]]| {
        [0, 1].map(|k| {
            let (lo, hi) =
                points.iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[k]), hi.max(p[k])));
            hi - lo
        })
    };
    let (own, other) = (extent(&curve.points()), extent(places));
    // Places are samples: they end up to their distance before the ends of the line.
    (0..2).all(|k| (own[k] - other[k]).abs() <= SIMILAR * own[k].max(other[k]) + 2.0 * spacing)
}
