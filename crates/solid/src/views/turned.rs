//! Candidate surfaces of revolution about the centres of drawn circles.
//!
//! Input: a grid. Output: walls. The centre of a circle in one view is an axis. A slanted line or an arc of a
//! view across this axis, turned about it, is a cone, sphere or torus. It becomes a candidate if the view
//! along the axis shows a circle with the radius at which the surface ends or is widest. A sphere must also
//! be outlined in every view across the axis.
//!
//! Limits: tori that touch or intersect themselves, and surfaces of revolution whose ends and outlines are
//! all cut away, are not found.

use super::candidate_surface::{Extent, Side, across};
use super::drawing_grid::{Carrier, DrawingGrid, Run, ViewGrid, stretches};
use super::profile::Profile;
use super::turned_wall::Turned;
use crate::drawing::distance;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Maximum difference of equal lengths, relative to the size of the drawing.
///
/// A larger value makes more false candidates; a smaller one loses those of inaccurate drawings.
const COINCIDENT: f64 = 1e-5;

/// A common centre of circles in a view, with their radii.
struct Axis {
    center: [f64; 2],
    radii: Vec<f64>,
}

/// All surfaces of revolution that a drawing may contain.
///
/// With `strict`, both views across the axis must show the profile. This excludes most of the false tori that
/// fillets make.
pub(crate) fn walls(plan: &DrawingGrid, strict: bool) -> Vec<Turned> {
    let mut found: Vec<Turned> = Vec::new();
    for shown in &plan.views {
        for axis in axes_of(shown, plan) {
            for view in &plan.views {
                if view.kind.axes()[..2].contains(&shown.kind.axes()[2]) {
                    for wall in walls_about(plan, shown, &axis, view, strict) {
                        add(&mut found, wall, plan);
                    }
                }
            }
        }
    }
    found
}

/// Adds a wall, or the extents of a wall that is known.
///
/// Spheres are compared by centre and radius, since they have a profile about each of their axes.
fn add(found: &mut Vec<Turned>, wall: Turned, plan: &DrawingGrid) {
    let same = COINCIDENT * plan.size;
    let sphere = |w: &Turned| match (w.is_sphere(), w.profile) {
        (true, Profile::Circle { center, radius }) => Some((w.point(0.0, [0.0, center[1]]), radius)),
        _ => None,
    };
    let is_same = |other: &Turned| match (sphere(other), sphere(&wall)) {
        (Some((c, r)), Some((d, s))) => (r - s).abs() < same && (0..3).all(|k| (c[k] - d[k]).abs() < same),
        (None, None) => other.same(&wall, same, plan.size),
        _ => false,
    };
    // One surface with several extents instead of several surfaces: coincident surfaces would leave slivers.
    match found.iter_mut().find(|w| is_same(w)) {
        Some(known) => known.extents.extend(wall.extents),
        None => found.push(wall),
    }
}

/// The centres of the circles of a view.
fn axes_of(view: &ViewGrid, plan: &DrawingGrid) -> Vec<Axis> {
    let mut found: Vec<Axis> = Vec::new();
    for carrier in &view.carriers {
        let Profile::Circle { center, radius } = carrier.profile else {
            continue;
        };
        match found.iter_mut().find(|a| distance(a.center, center) < COINCIDENT * plan.size) {
            Some(axis) => axis.radii.push(radius),
            None => found.push(Axis { center, radii: vec![radius] }),
        }
    }
    found
}

/// Candidates about an axis with a profile in one view across it.
fn walls_about(
    plan: &DrawingGrid,
    shown: &ViewGrid,
    axis: &Axis,
    view: &ViewGrid,
    strict: bool,
) -> Vec<Turned> {
    let same = COINCIDENT * plan.size;
    let along = shown.kind.axes()[2];
    let axes = view.kind.axes();
    let up = usize::from(axes[1] == along);
    let middle = axis.center[usize::from(shown.kind.axes()[1] == axes[1 - up])];
    let axis_at = across(along).map(|a| axis.center[usize::from(shown.kind.axes()[1] == a)]);
    let has = |radius: f64| axis.radii.iter().any(|r| (r - radius).abs() < same);
    let mut found = Vec::new();
    for carrier in &view.carriers {
        // Both sides of the axis show the same profile, so distances are absolute.
        let from_axis = |p: [f64; 2]| [(p[1 - up] - middle).abs(), p[up]];
        for (from, to) in parts(carrier, middle, 1 - up, plan) {
            let (p, q) = (carrier.profile.point(from), carrier.profile.point(to));
            let ends = [from_axis(p), from_axis(q)];
            let ends_on_circle = ends.iter().any(|e| e[0] > same && has(e[0]));
            let ends_known = ends.iter().all(|e| e[0] <= same || has(e[0]));
            // A line parallel to the axis makes a cylinder, which a view sees edge-on already. A circle is a
            // sphere if its centre is on the axis, else a torus, half of whose tube is on each side.
            let (profile, side) = match carrier.profile {
                Profile::Line { .. } => {
                    if !ends_on_circle || strict && !ends_known || (ends[0][0] - ends[1][0]).abs() < same {
                        continue;
                    }
                    (Profile::line(ends[0], ends[1]), Side::Both)
                }
                Profile::Circle { center, radius } => {
                    let major = (center[1 - up] - middle).abs();
                    let at = |major: f64| Profile::Circle { center: [major, center[up]], radius };
                    if major < same {
                        if !(ends_on_circle || has(radius))
                            || !is_outlined(plan, along, axis_at, center[up], radius)
                        {
                            continue;
                        }
                        (at(0.0), Side::Both)
                    } else {
                        let is_inner = from_axis(carrier.profile.point((from + to) / 2.0))[0] < major;
                        // Tori whose tube reaches the axis are excluded: they touch or cross themselves.
                        let widest = has(if is_inner { major - radius } else { major + radius });
                        if major <= radius + same || !(ends_on_circle || widest) {
                            continue;
                        }
                        (at(major), if is_inner { Side::Inner } else { Side::Outer })
                    }
                }
            };
            // The extent is that of the drawn part, turned. Beyond it the wall would divide cells without
            // need.
            let reach = ends[0][0].max(ends[1][0]);
            let mut bounds = [[0.0; 2]; 3];
            for (k, a) in across(along).into_iter().enumerate() {
                bounds[a] = [axis_at[k] - reach, axis_at[k] + reach];
            }
            bounds[along] = [ends[0][1].min(ends[1][1]), ends[0][1].max(ends[1][1])];
            let wall =
                Turned { axis: along, center: axis_at, profile, extents: vec![Extent { bounds, side }] };
            if !strict || is_mirrored(plan, &wall, view, ends, side) {
                found.push(wall);
            }
        }
    }
    found
}

/// True if every view across an axis draws the circle of a sphere.
fn is_outlined(plan: &DrawingGrid, along: usize, center: [f64; 2], height: f64, radius: f64) -> bool {
    let same = COINCIDENT * plan.size;
    let mut views = plan.views.iter().filter(|v| v.kind.axes()[..2].contains(&along));
    views.all(|view| {
        let at = view.kind.axes().map(|a| match across(along).iter().position(|b| *b == a) {
            Some(k) => center[k],
            None => height,
        });
        view.carriers.iter().any(|carrier| match carrier.profile {
            Profile::Circle { center, radius: r } => {
                (r - radius).abs() < same && distance(center, [at[0], at[1]]) < same
            }
            Profile::Line { .. } => false,
        })
    })
}

/// True if the other views across the axis of a wall draw a part of its profile between two ends, on either
/// side of the axis.
///
/// It is also true if both sides are beyond what such a view shows: the part was cut away there.
fn is_mirrored(
    plan: &DrawingGrid,
    wall: &Turned,
    seen_in: &ViewGrid,
    ends: [[f64; 2]; 2],
    side: Side,
) -> bool {
    let same = COINCIDENT * plan.size;
    let mut others =
        plan.views.iter().filter(|v| v.kind != seen_in.kind && v.kind.axes()[..2].contains(&wall.axis));
    others.all(|view| {
        let axes = view.kind.axes();
        let up = usize::from(axes[1] == wall.axis);
        let sideways = axes[1 - up];
        let center = wall.center[usize::from(across(wall.axis)[1] == sideways)];
        let heights = [ends[0][1], ends[1][1]];
        let middle = (heights[0] + heights[1]) / 2.0;
        let radii = wall.profile.crossings(1, middle, 0.0);
        // At one height a tube has two radii; this is the one of its half.
        let radius = if side == Side::Inner { radii.first() } else { radii.last() };
        let Some(radius) = radius else { return true };
        let grid = &plan.grid[sideways];
        let shown = [grid[1], grid[grid.len() - 2]];
        let images = [-1.0, 1.0].map(|sign| {
            let mut at = [0.0; 2];
            (at[1 - up], at[up]) = (center + sign * radius, middle);
            let n = wall.profile.normal([*radius, middle]);
            let mut normal = [0.0; 2];
            (normal[1 - up], normal[up]) = (sign * n[0], n[1]);
            // Tested at the middle of the profile: its ends may lie on the border of the view.
            let beyond = at[1 - up] < shown[0] - same || at[1 - up] > shown[1] + same;
            (is_drawn_at(view, at, normal, same, heights, up), beyond)
        });
        images.iter().any(|i| i.0) || images.iter().all(|i| i.1)
    })
}

/// True if a carrier passes through a point with a given normal, and a part of it between two heights is
/// drawn.
fn is_drawn_at(
    view: &ViewGrid,
    at: [f64; 2],
    normal: [f64; 2],
    same: f64,
    heights: [f64; 2],
    up: usize,
) -> bool {
    let (lo, hi) = (heights[0].min(heights[1]), heights[0].max(heights[1]));
    view.carriers.iter().any(|carrier| {
        let n = carrier.profile.normal(at);
        let along = (n[0] * normal[0] + n[1] * normal[1]).abs() > 1.0 - 1e-6;
        let drawn = |run: &Run| {
            [0.02, 0.25, 0.5, 0.75, 0.98].iter().any(|share| {
                let p = carrier.profile.point(run.from + share * (run.to - run.from));
                p[up] > lo - same && p[up] < hi + same
            })
        };
        carrier.profile.value(at).abs() < same && along && carrier.runs.iter().any(drawn)
    })
}

/// The drawn parts of a carrier, cut at the axis and, for circles, at the extremes.
///
/// Each part then has one distance from the axis for each height.
fn parts(carrier: &Carrier, middle: f64, across: usize, plan: &DrawingGrid) -> Vec<(f64, f64)> {
    let circle = matches!(carrier.profile, Profile::Circle { .. });
    let turn = match carrier.profile {
        Profile::Circle { radius, .. } => radius,
        Profile::Line { .. } => 1.0,
    };
    let gap = COINCIDENT * plan.size / turn;
    let mut found = Vec::new();
    for [from, to] in stretches(&carrier.runs, gap) {
        let mut cuts = vec![from, to];
        for other in carrier.profile.crossings(across, middle, plan.tolerance) {
            let mut p = [0.0; 2];
            (p[across], p[1 - across]) = (middle, other);
            let t = carrier.profile.parameter(p);
            cuts.push(if circle { t.rem_euclid(TAU) } else { t });
        }
        if circle {
            cuts.extend((0..=4).map(|q| f64::from(q) * FRAC_PI_2));
        }
        // An arc often ends at an extreme or on the axis, which gives two cuts that differ by rounding.
        cuts.retain(|t| *t >= from && *t <= to);
        cuts.sort_by(f64::total_cmp);
        cuts.dedup_by(|b, a| *b - *a < gap);
        found.extend(cuts.windows(2).map(|c| (c[0], c[1])));
    }
    found
}
