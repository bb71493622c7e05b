//! Surfaces seen edge-on: the curves in which two of them intersect, and the points that three share.
//!
//! Every surface is a profile of a view, extruded along the line of sight. A grid plane has a profile in
//! every view that sees it edge-on. All axes are parallel to axes of the frame, so most intersections need
//! only square roots.

use super::cells::Cells;
use super::column::SurfaceId;
use super::profile::Profile;
use super::traced::Traced;
use crate::brep::FaceSurface;
use planish_core::DVec3;
use std::f64::consts::TAU;

/// A surface extruded along an axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extruded {
    /// The axes of the profile's coordinates, and the one along which it is extruded.
    axes: [usize; 3],
    profile: Profile,
    /// The axis and value of a grid plane.
    plane: Option<(usize, f64)>,
}

impl Extruded {
    pub(super) fn new(cells: &Cells, id: SurfaceId) -> Self {
        match id {
            SurfaceId::Grid(axis, index) => {
                let offset = cells.plan.grid[axis][index];
                Self {
                    axes: [axis, (axis + 1) % 3, (axis + 2) % 3],
                    profile: Profile::Line { normal: [1.0, 0.0], offset },
                    plane: Some((axis, offset)),
                }
            }
            SurfaceId::Wall(_) | SurfaceId::Cut => unreachable!("neither a wall nor a cut is extruded"),
            SurfaceId::Carrier(view, carrier) => {
                let view = &cells.plan.views[view];
                Self { axes: view.kind.axes(), profile: view.carriers[carrier].profile, plane: None }
            }
        }
    }

    fn in_view(&self, p: DVec3) -> [f64; 2] {
        [p[self.axes[0]], p[self.axes[1]]]
    }

    /// Signed distance.
    pub(super) fn value(&self, p: DVec3) -> f64 {
        self.profile.value(self.in_view(p))
    }

    /// The gradient of the signed distance.
    pub(super) fn normal(&self, p: DVec3) -> DVec3 {
        let n = self.profile.normal(self.in_view(p));
        let mut normal = DVec3::ZERO;
        (normal[self.axes[0]], normal[self.axes[1]]) = (n[0], n[1]);
        normal
    }

    /// The surface. Its normal is the direction of the gradient.
    pub(super) fn surface(&self) -> FaceSurface {
        let axis_of = |k: usize| {
            let mut axis = DVec3::ZERO;
            axis[self.axes[k]] = 1.0;
            axis
        };
        match self.profile {
            Profile::Line { normal, offset } => {
                let normal = DVec3::ZERO + normal[0] * axis_of(0) + normal[1] * axis_of(1);
                FaceSurface::Plane { origin: DVec3::ZERO + offset * normal, normal, x: axis_of(2) }
            }
            Profile::Circle { center, radius } => FaceSurface::Cylinder {
                origin: DVec3::ZERO + center[0] * axis_of(0) + center[1] * axis_of(1),
                axis: axis_of(2),
                // The seam is at +z, on upright cylinders at +x. A fixed rule makes solids of equal drawings
                // identical.
                x: axis_of((0..2).find(|k| self.axes[*k] == 2).unwrap_or(0)),
                radius,
            },
        }
    }

    /// Which coordinate of the profile an axis is; `None` for the axis of extrusion.
    fn position(&self, axis: usize) -> Option<usize> {
        (0..2).find(|&k| self.axes[k] == axis)
    }
}

/// Intersection points of two profiles of one view. Profiles that touch within the tolerance share one point.
pub(super) fn meet(a: &Profile, b: &Profile, tolerance: f64) -> Vec<[f64; 2]> {
    match (a, b) {
        (Profile::Line { normal: n, offset: d }, Profile::Line { normal: m, offset: e }) => {
            let det = n[0] * m[1] - n[1] * m[0];
            match det.abs() > 1e-9 {
                true => vec![[(d * m[1] - e * n[1]) / det, (e * n[0] - d * m[0]) / det]],
                false => Vec::new(),
            }
        }
        (Profile::Circle { center, radius }, line @ Profile::Line { normal, .. })
        | (line @ Profile::Line { normal, .. }, Profile::Circle { center, radius }) => {
            let off = line.value(*center);
            let foot = [center[0] - off * normal[0], center[1] - off * normal[1]];
            chord_ends(foot, [-normal[1], normal[0]], off.abs(), *radius, tolerance)
        }
        (Profile::Circle { center, radius }, Profile::Circle { center: other, radius: r2 }) => {
            let d = crate::drawing::distance(*center, *other);
            if d < tolerance {
                return Vec::new();
            }
            let to = [(other[0] - center[0]) / d, (other[1] - center[1]) / d];
            // Distance of the common chord from the first centre: x² + y² = r², (x − d)² + y² = r₂².
            let off = (d * d + radius * radius - r2 * r2) / (2.0 * d);
            let foot = [center[0] + off * to[0], center[1] + off * to[1]];
            chord_ends(foot, [-to[1], to[0]], off.abs(), *radius, tolerance)
        }
    }
}

/// The ends of a chord of a circle, by its middle, its direction and its distance from the centre.
fn chord_ends(foot: [f64; 2], direction: [f64; 2], off: f64, radius: f64, tolerance: f64) -> Vec<[f64; 2]> {
    if (off - radius).abs() <= tolerance {
        return vec![foot];
    }
    let square = radius * radius - off * off;
    if square <= 0.0 {
        return Vec::new();
    }
    let h = square.sqrt();
    [-h, h].map(|h| [foot[0] + h * direction[0], foot[1] + h * direction[1]]).to_vec()
}

/// The point with given values of the three axes, in any order.
fn point_of(values: [(usize, f64); 3]) -> DVec3 {
    let mut p = DVec3::ZERO;
    for (axis, value) in values {
        p[axis] = value;
    }
    p
}

/// Intersection of a surface with a plane across an axis.
enum Trace {
    /// Lines at some values of an axis.
    Values(usize, Vec<f64>),
    /// The profile itself, if the plane is across the axis of extrusion.
    Profile([usize; 2], Profile),
}

/// Intersection of a surface with the plane at a value of an axis; `None` for a parallel grid plane.
fn trace(s: &Extruded, axis: usize, value: f64, tolerance: f64) -> Option<Trace> {
    if let Some((own, at)) = s.plane {
        return (own != axis).then(|| Trace::Values(own, vec![at]));
    }
    Some(match s.position(axis) {
        Some(known) => Trace::Values(s.axes[1 - known], s.profile.crossings(known, value, tolerance)),
        None => Trace::Profile([s.axes[0], s.axes[1]], s.profile),
    })
}

/// The points that lie on three surfaces; none if there are infinitely many.
pub(super) fn triple(three: [&Extruded; 3], tolerance: f64) -> Vec<DVec3> {
    // With a grid plane, the other two leave curves in this plane, which are intersected there.
    if let Some(at) = three.iter().position(|s| s.plane.is_some()) {
        let (axis, value) = three[at].plane.unwrap_or_default();
        let others: Vec<&Extruded> = (0..3).filter(|k| *k != at).map(|k| three[k]).collect();
        let traces = others.iter().map(|s| trace(s, axis, value, tolerance)).collect::<Option<Vec<_>>>();
        let Some(traces) = traces else { return Vec::new() };
        return match (&traces[0], &traces[1]) {
            (Trace::Values(a, first), Trace::Values(b, second)) if a != b => first
                .iter()
                .flat_map(|x| second.iter().map(move |y| point_of([(axis, value), (*a, *x), (*b, *y)])))
                .collect(),
            (Trace::Values(..), Trace::Values(..)) => Vec::new(),
            (Trace::Values(a, values), Trace::Profile(axes, profile))
            | (Trace::Profile(axes, profile), Trace::Values(a, values)) => {
                let known = usize::from(axes[1] == *a);
                let on = |x: &f64| {
                    let x = *x;
                    let other = axes[1 - known];
                    let found = profile.crossings(known, x, tolerance);
                    found.into_iter().map(move |y| point_of([(axis, value), (*a, x), (other, y)]))
                };
                values.iter().flat_map(on).collect()
            }
            (Trace::Profile(axes, p), Trace::Profile(_, q)) => meet(p, q, tolerance)
                .into_iter()
                .map(|m| point_of([(axis, value), (axes[0], m[0]), (axes[1], m[1])]))
                .collect(),
        };
    }
    // Two surfaces of one view share lines along its sight, at the points where their profiles meet.
    for [i, j, k] in [[0, 1, 2], [0, 2, 1], [1, 2, 0]] {
        let (s, t, u) = (three[i], three[j], three[k]);
        if s.axes != t.axes {
            continue;
        }
        // Three surfaces of one view share no point, or a whole line.
        if u.axes == s.axes {
            return Vec::new();
        }
        let mut found = Vec::new();
        for m in meet(&s.profile, &t.profile, tolerance) {
            for known in 0..2 {
                if let Some(place) = s.position(u.axes[known]) {
                    for depth in u.profile.crossings(known, m[place], tolerance) {
                        found.push(point_of([(s.axes[0], m[0]), (s.axes[1], m[1]), (s.axes[2], depth)]));
                    }
                }
            }
        }
        return found;
    }
    numeric(three)
}

/// Common points of three surfaces of three views, none of them a grid plane.
///
/// Their equations are of a degree up to eight, so points are searched: along the intersection of the first
/// two, where the signed distance to the third changes its sign. Points where the third only touches are not
/// found. A circle gives the parameter; three planes are solved directly.
fn numeric([s, t, u]: [&Extruded; 3]) -> Vec<DVec3> {
    let Profile::Circle { .. } = s.profile else {
        return match (t.profile, u.profile) {
            (Profile::Circle { .. }, _) => numeric([t, u, s]),
            (_, Profile::Circle { .. }) => numeric([u, s, t]),
            _ => corner([s, t, u]),
        };
    };
    const STEPS: usize = 720;
    let Some(known) = (0..2).find(|&k| s.position(t.axes[k]).is_some()) else {
        return Vec::new();
    };
    let place = s.position(t.axes[known]).unwrap_or(0);
    let mut found = Vec::new();
    for branch in 0..2 {
        let at = |angle: f64| {
            let m = s.profile.point(angle);
            let depth = *t.profile.crossings(known, m[place], 0.0).get(branch)?;
            let p = point_of([(s.axes[0], m[0]), (s.axes[1], m[1]), (s.axes[2], depth)]);
            Some((p, u.value(p)))
        };
        // Shifted, so that no sample lies on a symmetry axis of the part, where values are often zero.
        let angle = |k: usize| TAU * (k as f64 + 0.123) / STEPS as f64;
        for k in 0..STEPS {
            let (mut lo, mut hi) = (angle(k), angle(k + 1));
            let (Some(a), Some(b)) = (at(lo), at(hi)) else {
                continue;
            };
            // 60 halvings reduce the interval below the spacing of f64 values.
            if a.1 * b.1 > 0.0 {
                continue;
            }
            for _ in 0..60 {
                let middle = (lo + hi) / 2.0;
                match at(middle) {
                    Some(m) if m.1 * a.1 > 0.0 => lo = middle,
                    _ => hi = middle,
                }
            }
            found.extend(at((lo + hi) / 2.0).map(|m| m.0));
        }
    }
    found
}

/// The common point of three planes by Cramer's rule; none if they are nearly parallel to one line.
fn corner(planes: [&Extruded; 3]) -> Vec<DVec3> {
    let normals = planes.map(|p| p.normal(DVec3::ZERO));
    // The normals have unit length, so that the determinant is the sine of the smallest angles.
    let offsets = planes.map(|p| -p.value(DVec3::ZERO));
    let products = [(1, 2), (2, 0), (0, 1)].map(|(a, b)| normals[a].cross(normals[b]));
    let determinant = normals[0].dot(products[0]);
    if determinant.abs() < 1e-9 {
        return Vec::new();
    }
    let sum: DVec3 = products.iter().zip(offsets).map(|(product, offset)| offset * *product).sum();
    vec![sum / determinant]
}

/// A curve along which two surfaces intersect.
pub(super) struct Meeting {
    pub(super) curve: Curve3,
    /// Points that must be vertices: where the curve crosses another one of the pair, or ends.
    pub(super) ends: Vec<DVec3>,
}

/// A parametric curve in space.
pub(super) enum Curve3 {
    Line {
        origin: DVec3,
        direction: DVec3,
    },
    Ellipse {
        center: DVec3,
        a: DVec3,
        b: DVec3,
    },
    /// A part of the intersection of two cylinders: a function of the coordinate that both profiles share,
    /// with one sign of each square root. Its parameter runs from 0 to π.
    Branch {
        first: Extruded,
        second: Extruded,
        shared: usize,
        signs: [f64; 2],
        range: [f64; 2],
    },
    /// Any other curve, by points along it.
    Traced(Traced),
}

/// Centre and radius of a cylinder's profile.
fn circle(s: &Extruded) -> Option<([f64; 2], f64)> {
    match s.profile {
        Profile::Circle { center, radius } => Some((center, radius)),
        Profile::Line { .. } => None,
    }
}

/// The curves along which two surfaces intersect.
pub(super) fn meetings(s: &Extruded, t: &Extruded, tolerance: f64) -> Vec<Meeting> {
    let unit_of = |axis: usize| {
        let mut e = DVec3::ZERO;
        e[axis] = 1.0;
        e
    };
    let line = |origin: DVec3, direction: DVec3| Meeting {
        curve: Curve3::Line { origin, direction },
        ends: Vec::new(),
    };
    // A grid plane comes first, which halves the number of cases.
    let (s, t) = if s.plane.is_none() && t.plane.is_some() { (t, s) } else { (s, t) };
    if let Some((axis, value)) = s.plane {
        return match trace(t, axis, value, tolerance) {
            None => Vec::new(),
            Some(Trace::Values(other, values)) => values
                .into_iter()
                .map(|v| {
                    line(
                        point_of([(axis, value), (other, v), (3 - axis - other, 0.0)]),
                        unit_of(3 - axis - other),
                    )
                })
                .collect(),
            Some(Trace::Profile(axes, Profile::Line { normal, offset })) => {
                let origin =
                    point_of([(axis, value), (axes[0], offset * normal[0]), (axes[1], offset * normal[1])]);
                vec![line(origin, point_of([(axis, 0.0), (axes[0], -normal[1]), (axes[1], normal[0])]))]
            }
            Some(Trace::Profile(axes, Profile::Circle { center, radius })) => vec![Meeting {
                curve: Curve3::Ellipse {
                    center: point_of([(axis, value), (axes[0], center[0]), (axes[1], center[1])]),
                    a: unit_of(axes[0]).map(|c| radius * c),
                    b: unit_of(axes[1]).map(|c| radius * c),
                },
                ends: Vec::new(),
            }],
        };
    }
    if s.axes == t.axes {
        return meet(&s.profile, &t.profile, tolerance)
            .into_iter()
            .map(|m| {
                line(point_of([(s.axes[0], m[0]), (s.axes[1], m[1]), (s.axes[2], 0.0)]), unit_of(s.axes[2]))
            })
            .collect();
    }
    let Some(shared) = (0..3).find(|a| s.position(*a).is_some() && t.position(*a).is_some()) else {
        return Vec::new();
    };
    oblique(s, t, shared, tolerance)
}

/// Intersection of two surfaces of two views, none of them a grid plane.
///
/// `shared` is the axis that both profiles have. The other coordinate of each profile is a function of it.
fn oblique(s: &Extruded, t: &Extruded, shared: usize, tolerance: f64) -> Vec<Meeting> {
    let places = [s, t].map(|d| d.position(shared).unwrap_or(0));
    let other = [s.axes[1 - places[0]], t.axes[1 - places[1]]];
    match (circle(s), circle(t)) {
        (None, None) => {
            let at = |x: f64| {
                let first = s.profile.crossings(places[0], x, 0.0).first().copied()?;
                let second = t.profile.crossings(places[1], x, 0.0).first().copied()?;
                Some(point_of([(shared, x), (other[0], first), (other[1], second)]))
            };
            let (Some(origin), Some(end)) = (at(0.0), at(1.0)) else {
                return Vec::new();
            };
            let d = end - origin;
            vec![Meeting {
                curve: Curve3::Line { origin, direction: crate::brep::unit(d) },
                ends: Vec::new(),
            }]
        }
        (None, Some(_)) => oblique(t, s, shared, tolerance),
        (Some((center, radius)), None) => {
            // A slanted plane maps the circle of the cylinder to an ellipse: one semi-axis keeps the radius,
            // and the other one is stretched by the slope.
            let slope = |x: f64| t.profile.crossings(places[1], x, 0.0).first().copied();
            let c = center[places[0]];
            let (Some(at), Some(next)) = (slope(c), slope(c + 1.0)) else {
                return Vec::new();
            };
            let tilted = point_of([(shared, radius), (other[1], radius * (next - at)), (other[0], 0.0)]);
            let flat = point_of([(shared, 0.0), (other[1], 0.0), (other[0], radius)]);
            vec![Meeting {
                curve: Curve3::Ellipse {
                    center: point_of([(shared, c), (other[0], center[1 - places[0]]), (other[1], at)]),
                    a: tilted,
                    b: flat,
                },
                ends: Vec::new(),
            }]
        }
        (Some((c1, r1)), Some((c2, r2))) => {
            let (a, b) = (c1[places[0]], c2[places[1]]);
            let center =
                point_of([(shared, a), (other[0], c1[1 - places[0]]), (other[1], c2[1 - places[1]])]);
            // Equal cylinders whose axes cross intersect in two ellipses, which cross at two points. As
            // branches, they would be singular there.
            if (a - b).abs() < tolerance && (r1 - r2).abs() < tolerance {
                let flat = point_of([(shared, r1), (other[0], 0.0), (other[1], 0.0)]);
                return [-1.0, 1.0]
                    .map(|sign| Meeting {
                        curve: Curve3::Ellipse {
                            center,
                            a: point_of([(shared, 0.0), (other[0], r1), (other[1], sign * r1)]),
                            b: flat,
                        },
                        ends: vec![center + flat, center - flat],
                    })
                    .into();
            }
            // The interval of the shared coordinate in which both cylinders have points. Each has two sheets
            // over it, so there are four branches, which meet at the ends of the interval.
            let range = [(a - r1).max(b - r2), (a + r1).min(b + r2)];
            if range[1] - range[0] < tolerance {
                return Vec::new();
            }
            let mut found = Vec::new();
            for first in [-1.0, 1.0] {
                for second in [-1.0, 1.0] {
                    let curve =
                        Curve3::Branch { first: *s, second: *t, shared, signs: [first, second], range };
                    let ends = [0.0, std::f64::consts::PI].map(|t| curve.point(t)).to_vec();
                    found.push(Meeting { curve, ends });
                }
            }
            found
        }
    }
}

impl Curve3 {
    /// Period of the parameter of a closed curve; `None` if it has ends.
    pub(super) fn period(&self) -> Option<f64> {
        match self {
            Self::Ellipse { .. } => Some(TAU),
            Self::Traced(traced) if traced.closed => Some(traced.end()),
            _ => None,
        }
    }

    /// The point at a parameter.
    pub(super) fn point(&self, t: f64) -> DVec3 {
        match self {
            Self::Line { origin, direction } => *origin + t * *direction,
            Self::Ellipse { center, a, b } => *center + t.cos() * *a + t.sin() * *b,
            Self::Traced(traced) => traced.point(t),
            Self::Branch { first, second, shared, signs, range } => {
                let half = (range[1] - range[0]) / 2.0;
                // The shared coordinate is `lo + half (1 − cos t)`: at the ends of a branch, its square roots
                // have infinite slope over the coordinate but not over t. The distances from both ends are
                // computed by half angles, as 1 ∓ cos t cancels.
                let (from_lo, from_hi) =
                    (2.0 * half * (t / 2.0).sin().powi(2), 2.0 * half * (t / 2.0).cos().powi(2));
                let x = if from_lo < from_hi { range[0] + from_lo } else { range[1] - from_hi };
                let mut p = DVec3::ZERO;
                p[*shared] = x;
                for (drawn, sign) in [(first, signs[0]), (second, signs[1])] {
                    let place = drawn.position(*shared).unwrap_or(0);
                    if let Some((center, radius)) = circle(drawn) {
                        let d = x - center[place];
                        // √(r² − d²) = √((r − d)(r + d)), both factors from the distances to the ends. With
                        // r² − d², all digits cancel where the root is small.
                        let above = range[1] - (center[place] + radius);
                        let below = range[0] - (center[place] - radius);
                        let root = ((from_hi - above).max(0.0) * (from_lo + below).max(0.0)).sqrt();
                        debug_assert!(d.abs() < 2.0 * radius);
                        p[drawn.axes[1 - place]] = center[1 - place] + sign * root;
                    }
                }
                p
            }
        }
    }

    /// The parameter of a point; `None` if the point is not on the curve.
    pub(super) fn parameter(&self, p: DVec3, tolerance: f64) -> Option<f64> {
        let t = match self {
            Self::Line { origin, direction } => (p - *origin).dot(*direction),
            Self::Ellipse { center, a, b } => {
                let d = p - *center;
                (d.dot(*b) / b.length_squared()).atan2(d.dot(*a) / a.length_squared()).rem_euclid(TAU)
            }
            Self::Traced(traced) => traced.parameter(p),
            Self::Branch { shared, range, .. } => {
                let half = (range[1] - range[0]) / 2.0;
                let share = ((p[*shared] - range[0]) / half).clamp(0.0, 2.0);
                2.0 * (share / 2.0).sqrt().min(1.0).asin()
            }
        };
        // Near its ends, a branch is nearly perpendicular to the shared coordinate, and an error of the
        // coordinate moves the point by more. Hence the larger distance.
        ((self.point(t) - p).length() < 20.0 * tolerance).then_some(t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_slanted_planes_of_three_views_share_a_corner() {
        let slanted = |axes: [usize; 3], normal: [f64; 2], offset: f64| Extruded {
            axes,
            profile: Profile::Line { normal, offset },
            plane: None,
        };
        let planes = [
            slanted([0, 1, 2], [0.6, 0.8], 2.0),
            slanted([1, 2, 0], [0.8, 0.6], 1.0),
            slanted([2, 0, 1], [-0.28, 0.96], 0.5),
        ];
        let found = triple([&planes[0], &planes[1], &planes[2]], 1e-9);
        assert_eq!(found.len(), 1);
        assert!(planes.iter().all(|p| p.value(found[0]).abs() < 1e-12), "{found:?}");
        // Planes parallel to one line share no point.
        let parallel = [
            slanted([0, 1, 2], [0.6, 0.8], 2.0),
            slanted([1, 2, 0], [1.0, 0.0], 1.0),
            slanted([2, 0, 1], [0.0, 1.0], 0.5),
        ];
        assert!(triple([&parallel[0], &parallel[1], &parallel[2]], 1e-9).is_empty());
    }
}
