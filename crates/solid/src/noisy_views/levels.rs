//! Coordinates of the views along the axes of space, and the groups of equal ones.

use super::NoisyView;
use planish_contour::constraint::{
    Axis, Candidate, CircleId, Constrained, Constraint, Offset, ParametricDrawing, Place, PointId,
    chi_square_tail, sigma,
};
use planish_contour::planar::ContourKind;
use planish_contour::sketch::SketchPart;
use planish_estimate::{Error, Result};
use serde::Serialize;
use std::f64::consts::{FRAC_PI_2, TAU};

/// A coordinate along an axis of space in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SpacePlace {
    /// Axis of space.
    pub(super) axis: usize,
    pub(super) view: usize,
    /// Point or circle in the drawing of all views.
    pub(super) place: Place,
}

/// A coordinate along an axis of space, with all places that share it.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisCoordinate {
    /// Value.
    pub value: f64,
    /// Standard deviation.
    pub sigma: f64,
    /// Places with this coordinate, in the drawing of all views.
    pub places: Vec<Place>,
}

/// Two coordinates that were compared.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceMatch {
    /// Axis of space: `x`, `y` or `z`.
    pub axis: &'static str,
    /// Indices of the two views.
    pub views: [usize; 2],
    /// Description of the two coordinates.
    pub text: String,
    /// χ² of their difference, with one degree of freedom, before the match is imposed.
    pub chi_square: f64,
    /// Probability of a χ² at least as large if the coordinates are equal.
    pub p_value: f64,
    /// Share of the extent within which a coordinate would have passed the test.
    pub chance: f64,
    /// `imposed`, `implied` by others, `refused` because of others, `unclear`, or `end` for common ends.
    pub outcome: &'static str,
}

/// Two coordinates are merged if σ of their difference is below this share of their own σ.
///
/// Imposing a constraint makes this σ zero except for rounding.
const MERGED_SHARE: f64 = 1e-6;

/// All coordinates of corners and extremes of circles in the views.
pub(super) fn places(
    views: &[NoisyView],
    offsets: &[Offset],
    drawing: &ParametricDrawing,
) -> Result<Vec<SpacePlace>> {
    let mut found = Vec::new();
    for (view, noisy) in views.iter().enumerate() {
        let before = found.len();
        for part in &noisy.sketch.parts {
            for (k, axis) in [Axis::X, Axis::Y].into_iter().enumerate() {
                let space = noisy.kind.axes()[k];
                found.extend(
                    of_part(part, offsets[view], axis, drawing).into_iter().map(|place| SpacePlace {
                        axis: space,
                        view,
                        place,
                    }),
                );
            }
        }
        if found.len() == before {
            return Err(Error::input(format!(
                "the {} view: expected corners or circles, found none",
                noisy.kind.name()
            )));
        }
    }
    Ok(found)
}

/// The coordinates of a contour along one axis of its view.
fn of_part(part: &SketchPart, offset: Offset, axis: Axis, drawing: &ParametricDrawing) -> Vec<Place> {
    let point = |i: u32| PointId(offset.points + part.first.points + i);
    let circle = |i: u32| CircleId(offset.circles + part.first.circles + i);
    let corner = |i: u32| Place::Point { point: point(i), axis };
    let extreme = |i: u32, upper: bool| Place::Extreme { circle: circle(i), axis, upper };
    match &part.kind {
        // A line has no ends of its own, and an ellipse is no outline of planes and cylinders along axes.
        ContourKind::Line | ContourKind::Ellipse => Vec::new(),
        ContourKind::Circle => vec![extreme(0, false), extreme(0, true)],
        ContourKind::Slot => {
            let centre = |i: u32| drawing.position(point(i))[axis as usize];
            let (low, high) = if centre(0) <= centre(1) { (0, 1) } else { (1, 0) };
            vec![extreme(low, false), extreme(high, true)]
        }
        ContourKind::Rectangle | ContourKind::RoundedRectangle => (0..4).map(corner).collect(),
        ContourKind::RegularPolygon(count) | ContourKind::Polygon(count) => {
            (0..*count as u32).map(corner).collect()
        }
        ContourKind::Chain { arcs, closed } => {
            let count = arcs.len() + usize::from(!closed);
            let mut places: Vec<Place> = (0..count as u32).map(corner).collect();
            for (i, (id, start, end)) in drawing.arcs().filter(|arc| in_part(part, offset, arc.0)).enumerate()
            {
                // An arc ends at corners, which are listed above; its extremes count only if they are on it.
                for upper in [false, true] {
                    if reaches(drawing, id, start, end, axis, upper) {
                        places.push(extreme(i as u32, upper));
                    }
                }
            }
            places
        }
    }
}

/// True if a circle belongs to a contour.
fn in_part(part: &SketchPart, offset: Offset, circle: CircleId) -> bool {
    let first = offset.circles + part.first.circles;
    (first..first + part.count.circles).contains(&circle.0)
}

/// True if an arc contains the point of its circle with the maximum (`upper`) or minimum coordinate.
fn reaches(
    drawing: &ParametricDrawing,
    circle: CircleId,
    start: PointId,
    end: PointId,
    axis: Axis,
    upper: bool,
) -> bool {
    let centre = drawing.position(drawing.centre(circle));
    let angle = |point: PointId| {
        let p = drawing.position(point);
        (p[1] - centre[1]).atan2(p[0] - centre[0])
    };
    // The extreme lies at a multiple of 90° and is part of the arc if the counter-clockwise angle from the
    // start is below the sweep.
    let quarter = match (axis, upper) {
        (Axis::X, true) => 0.0,
        (Axis::Y, true) => 1.0,
        (Axis::X, false) => 2.0,
        (Axis::Y, false) => 3.0,
    };
    let from = angle(start);
    let sweep = (angle(end) - from).rem_euclid(TAU);
    (quarter * FRAC_PI_2 - from).rem_euclid(TAU) < sweep
}

/// Pairs of coordinates along one axis that are not merged already.
pub(super) fn candidates(places: &[SpacePlace], alone: &Constrained) -> Vec<Candidate> {
    // One pair for each two groups: all members of a group are equal already, so further pairs would repeat
    // the test and weaken the family-wise level.
    let groups = groups(places, alone);
    let mut found = Vec::new();
    for axis in 0..3 {
        let own: Vec<&Vec<usize>> = groups.iter().filter(|group| places[group[0]].axis == axis).collect();
        let values = own
            .iter()
            .map(|group| places[group[0]].place.value(&alone.drawing, alone.drawing.values().as_slice()));
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        for (i, a) in own.iter().enumerate() {
            for b in &own[i + 1..] {
                found.push(Candidate {
                    constraint: Constraint::Aligned { a: places[a[0]].place, b: places[b[0]].place },
                    range: (high - low).max(f64::MIN_POSITIVE),
                });
            }
        }
    }
    found
}

/// Groups of merged places. Groups and their members are in the order of the places.
fn groups(places: &[SpacePlace], state: &Constrained) -> Vec<Vec<usize>> {
    let values = state.drawing.values();
    // Merging is transitive, so one member of each group is enough for the comparison.
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, new) in places.iter().enumerate() {
        let same = |group: &Vec<usize>| {
            let known = &places[group[0]];
            known.axis == new.axis && is_known_equal(known.place, new.place, state, values.as_slice())
        };
        match groups.iter_mut().find(|group| same(group)) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}

/// True if two coordinates are equal, and known to be equal: not only by chance.
fn is_known_equal(a: Place, b: Place, state: &Constrained, x: &[f64]) -> bool {
    // Equal values alone may be a coincidence of estimates. σ of the difference is zero only if a constraint
    // makes them equal.
    let apart = (a.value(&state.drawing, x) - b.value(&state.drawing, x)).abs();
    let together = sigma(&Constraint::Aligned { a, b }, &state.drawing, &state.covariance);
    let each = [a, b].map(|place| place_sigma(place, state));
    apart <= 1e-8 * state.drawing.extent()
        && together <= MERGED_SHARE * each[0].max(each[1]).max(MERGED_SHARE * state.drawing.extent())
}

/// σ of a coordinate.
fn place_sigma(place: Place, state: &Constrained) -> f64 {
    let terms = place.terms(&state.drawing);
    let products = terms.iter().flat_map(|a| terms.iter().map(move |b| (a, b)));
    let variance: f64 = products.map(|(&(i, a), &(j, b))| a * b * state.covariance[(i, j)]).sum();
    variance.max(0.0).sqrt()
}

/// The distinct coordinates along each axis, ascending.
pub(super) fn levels(places: &[SpacePlace], state: &Constrained) -> [Vec<AxisCoordinate>; 3] {
    let values = state.drawing.values();
    let mut levels: [Vec<AxisCoordinate>; 3] = Default::default();
    for group in groups(places, state) {
        let first = &places[group[0]];
        levels[first.axis].push(AxisCoordinate {
            value: first.place.value(&state.drawing, values.as_slice()),
            sigma: place_sigma(first.place, state),
            places: group.iter().map(|&i| places[i].place).collect(),
        });
    }
    for of_axis in &mut levels {
        of_axis.sort_by(|a, b| a.value.total_cmp(&b.value));
    }
    levels
}

/// A common end of two views that share an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct End {
    a: SpacePlace,
    b: SpacePlace,
}

impl End {
    /// The constraint that both ends are equal.
    pub(super) fn constraint(&self) -> Constraint {
        Constraint::Aligned { a: self.a.place, b: self.b.place }
    }

    /// χ² of the difference of the two ends.
    fn chi_square(&self, alone: &Constrained) -> f64 {
        let values = alone.drawing.values();
        let [a, b] = [self.a, self.b].map(|end| end.place.value(&alone.drawing, values.as_slice()));
        let spread = sigma(&self.constraint(), &alone.drawing, &alone.covariance);
        ((a - b) / spread.max(f64::MIN_POSITIVE)).powi(2)
    }

    /// The end as a tested match.
    pub(super) fn tested_match(&self, alone: &Constrained) -> SpaceMatch {
        let chi_square = self.chi_square(alone);
        SpaceMatch {
            axis: ["x", "y", "z"][self.a.axis],
            views: [self.a.view, self.b.view],
            text: self.constraint().describe(&alone.drawing),
            chi_square,
            p_value: chi_square_tail(chi_square, 1),
            chance: 0.0,
            outcome: "end",
        }
    }
}

/// The common ends of views that share an axis, for each two consecutive views.
pub(super) fn ends(places: &[SpacePlace], alone: &Constrained, views: usize) -> Vec<End> {
    let values = alone.drawing.values();
    let value = |end: &SpacePlace| end.place.value(&alone.drawing, values.as_slice());
    let mut found = Vec::new();
    // Consecutive pairs are enough: three equal ends need two equations, and a third would be redundant.
    for axis in 0..3 {
        for upper in [false, true] {
            let last = |view: usize| {
                let own = places.iter().filter(|place| place.axis == axis && place.view == view);
                own.copied().max_by(|a, b| {
                    let order = value(a).total_cmp(&value(b));
                    if upper { order } else { order.reverse() }
                })
            };
            let ends: Vec<SpacePlace> = (0..views).filter_map(last).collect();
            found.extend(ends.windows(2).map(|pair| End { a: pair[0], b: pair[1] }));
        }
    }
    found
}

/// The error for views of different objects, with the ends that differ most.
pub(super) fn different_objects(ends: &[End], alone: &Constrained, views: &[NoisyView]) -> Error {
    let worst = ends.iter().max_by(|a, b| a.chi_square(alone).total_cmp(&b.chi_square(alone)));
    let Some(worst) = worst else {
        return Error::undetermined("expected views with a common axis, found none");
    };
    let values = alone.drawing.values();
    let describe = |end: &SpacePlace| {
        format!(
            "the {} view ends at {} = {:.6} ± {:.2e} ({})",
            views[end.view].kind.name(),
            ["x", "y", "z"][end.axis],
            end.place.value(&alone.drawing, values.as_slice()),
            place_sigma(end.place, alone),
            end.place.describe(&alone.drawing)
        )
    };
    let chi_square = worst.chi_square(alone);
    Error::input(format!(
        "{}, but {}: χ² = {chi_square:.4} of 1 degree, p = {:.1e}; expected views of one object, at one \
         scale, in one frame",
        describe(&worst.a),
        describe(&worst.b),
        chi_square_tail(chi_square, 1)
    ))
}
