//! Intersections of rays with faces that are trimmed by loops.
//!
//! For planes and cylinders, the intersection of a ray with the surface has a closed form. For other surfaces
//! it is found by the signed distance. This changes by at most the distance along the ray, so if it exceeds
//! half of an interval at its middle, the interval contains no intersection. Whether a point of the surface
//! is in the face follows from the nearest loop along the second parameter, since loops have the face on
//! their left. On spheres and tori, the first parameter is used if no loop has the point's first parameter.

use super::{Coedge, Edge, EdgeCurve, Face, FaceSurface, Solid, unit};
use planish_core::DVec3;
use std::f64::consts::{PI, TAU};

/// Direction in which planes are scanned, in radians. It is unusual in drawings, so loops do not run along
/// it.
const SCAN_ANGLE: f64 = 0.617_31;
/// Length at which intervals of a ray are not divided further, relative to the first interval.
///
/// It is the accuracy of intersections; halving it costs one more step for each.
const MIN_STEP: f64 = 1e-7;

/// A point of a loop: parameter of the curve and scanned parameters of the surface.
#[derive(Clone, Copy)]
struct LoopPoint {
    t: f64,
    uv: [f64; 2],
}

/// A face, ready for rays.
pub(crate) struct TrimmedFace<'a> {
    solid: &'a Solid,
    face: &'a Face,
    /// Points along each coedge, in the direction of the loop.
    coedges: Vec<(Coedge, Vec<LoopPoint>)>,
    /// True if the second parameter is an angle, too.
    second_is_angle: bool,
    /// Minimum and maximum coordinates of the face.
    pub(crate) bounds: [DVec3; 2],
}

/// The difference of two angles in (−π, π].
fn turn(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

impl<'a> TrimmedFace<'a> {
    /// Prepares a face. If its surface may bulge beyond its loops, `reach` is its bounding box.
    pub(crate) fn new(solid: &'a Solid, face: &'a Face, reach: [DVec3; 2]) -> Self {
        let scanned = |p: DVec3| scan_parameters(&face.surface, p);
        let mut bounds = [DVec3::splat(f64::MAX), DVec3::splat(f64::MIN)];
        let coedges = face
            .loops
            .iter()
            .flatten()
            // An edge with the face on both sides bounds nothing: a seam, or a line along which a hole
            // touches a wall from behind.
            .filter(|c| face.loops.iter().flatten().filter(|d| d.edge == c.edge).count() == 1)
            .map(|&coedge| {
                let edge = &solid.edges[coedge.edge];
                let pieces = edge.pieces();
                let parameters = turning_points(edge, pieces, &|t| scanned(edge.curve.point(t)));
                let mut points: Vec<LoopPoint> = parameters
                    .into_iter()
                    .map(|t| {
                        let p = edge.curve.point(t);
                        for c in 0..3 {
                            bounds[0][c] = bounds[0][c].min(p[c]);
                            bounds[1][c] = bounds[1][c].max(p[c]);
                        }
                        LoopPoint { t, uv: scanned(p) }
                    })
                    .collect();
                if !coedge.forward {
                    points.reverse();
                }
                (coedge, points)
            })
            .collect::<Vec<_>>();
        match matches!(face.surface, FaceSurface::Plane { .. } | FaceSurface::Cylinder { .. }) {
            // The box is that of sample points. Between these, at most 15° apart, an arc of radius r bulges
            // by less than r (1 − cos 7.5°) = 0.009 r.
            true => {
                let more = 0.01 * (bounds[1] - bounds[0]).length();
                bounds = [bounds[0] - more, bounds[1] + more];
            }
            false => bounds = reach,
        }
        // Found by a test instead of the kind of surface, so that other kinds need no code here: a whole turn
        // of an angle gives the same point.
        let probe = [0.3, 0.2];
        let second_is_angle =
            (face.surface.parameters(face.surface.point([probe[0], probe[1] + TAU]))[1] - probe[1]).abs()
                < 1e-9;
        Self { solid, face, coedges, second_is_angle, bounds }
    }

    pub(crate) fn surface(&self) -> &FaceSurface {
        &self.face.surface
    }

    /// The normal that points out of the solid.
    pub(crate) fn outward(&self, p: DVec3) -> DVec3 {
        let n = self.face.surface.normal(p);
        if self.face.outward { n } else { n.map(|c| -c) }
    }

    /// True if the second parameter is an angle as well as the first.
    pub(crate) fn second_is_angle(&self) -> bool {
        self.second_is_angle
    }

    /// Parameters of points along the loops.
    pub(crate) fn loop_parameters(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.coedges
            .iter()
            .flat_map(|(coedge, points)| points.iter().map(move |p| (coedge, p.t)))
            .map(|(coedge, t)| self.face.surface.parameters(self.solid.edges[coedge.edge].curve.point(t)))
    }

    /// True if a point of the surface lies in the face.
    pub(crate) fn contains(&self, p: DVec3) -> bool {
        if self.coedges.is_empty() {
            return true;
        }
        let is_plane = matches!(self.face.surface, FaceSurface::Plane { .. });
        let at = scan_parameters(&self.face.surface, p);
        let first = |uv: [f64; 2]| {
            if is_plane { uv[0] - at[0] } else { turn(uv[0] - at[0]) }
        };
        let second = |uv: [f64; 2]| match self.second_is_angle {
            true => turn(uv[1] - at[1]),
            false => uv[1] - at[1],
        };
        if let Some(is_in) = self.by_scan(!is_plane, &first, &second) {
            return is_in;
        }
        // On spheres and tori, possibly no loop has the point's first parameter. Then either all points with
        // this parameter are in the face, or none is. One of them is tested whose second parameter some loop
        // has, along the first parameter: the roles of both are exchanged.
        let angular = (self.second_is_angle).then(|| self.steepest());
        let across = angular.flatten().and_then(|level| {
            let from_level = |uv: [f64; 2]| turn(uv[1] - level);
            self.by_scan(true, &from_level, &|uv| -first(uv))
        });
        across.unwrap_or_else(|| self.is_left_of_nearest(p))
    }

    /// The second parameter in the middle of the piece of a loop along which it changes most: there, a scan
    /// along the first parameter crosses the loop at the largest angle.
    fn steepest(&self) -> Option<f64> {
        let pieces = self.coedges.iter().flat_map(|(_, points)| points.windows(2));
        let middles = pieces.map(|pair| {
            let step = turn(pair[1].uv[1] - pair[0].uv[1]);
            (step.abs(), pair[0].uv[1] + 0.5 * step)
        });
        let steepest = middles.filter(|(step, _)| *step > 1e-6).max_by(|a, b| a.0.total_cmp(&b.0));
        steepest.map(|(_, middle)| middle)
    }

    /// Whether a point is in the face, by the nearest loop along the second of two parameters, both relative
    /// to the point; `None` if no loop has its first parameter.
    fn by_scan(
        &self,
        first_is_angle: bool,
        first: &dyn Fn([f64; 2]) -> f64,
        second: &dyn Fn([f64; 2]) -> f64,
    ) -> Option<bool> {
        let mut crossed: Vec<(f64, bool)> = Vec::new();
        for (coedge, points) in &self.coedges {
            for pair in points.windows(2) {
                let [from, to] = [pair[0], pair[1]];
                let a = first(from.uv);
                let step = first(to.uv) - a;
                let b = a + if first_is_angle { turn(step) } else { step };
                if (a > 0.0) != (b > 0.0) {
                    crossed.push((self.second_at(*coedge, [from.t, to.t], [a, b], first, second), b > a));
                }
            }
        }
        // Nearest first: the sides of farther loops follow from it.
        crossed.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        // Where a loop runs back on itself, two opposite crossings at one place bound nothing.
        let mut k = 0;
        while let Some(&(off, runs_on)) = crossed.get(k) {
            match crossed.get(k + 1) {
                Some(&(next, runs_next)) if (next - off).abs() < 1e-7 && runs_next != runs_on => k += 2,
                // Above a point of the face, the loop runs in the direction of a decreasing first parameter;
                // below it, of an increasing one.
                _ => return Some((runs_on == (off < 0.0)) == self.face.outward),
            }
        }
        None
    }

    /// The second parameter, relative to the point, where a loop has the point's first parameter, between two
    /// parameters of its curve.
    fn second_at(
        &self,
        coedge: Coedge,
        [mut from, mut to]: [f64; 2],
        [mut a, mut b]: [f64; 2],
        first: &dyn Fn([f64; 2]) -> f64,
        second: &dyn Fn([f64; 2]) -> f64,
    ) -> f64 {
        let curve = &self.solid.edges[coedge.edge].curve;
        let at = |t: f64| scan_parameters(&self.face.surface, curve.point(t));
        let mut found = at((from + to) / 2.0);
        let small = 1e-13 * (a.abs() + b.abs());
        // Regula falsi with the Illinois modification: if one end stays, its value is halved. Without it,
        // convergence on convex functions is only linear.
        let mut stays = 0;
        for _ in 0..60 {
            let t = if a == b { (from + to) / 2.0 } else { from - a * (to - from) / (b - a) };
            found = at(t);
            let value = first(found);
            if value.abs() <= small {
                break;
            }
            if (value > 0.0) == (b > 0.0) {
                (to, b) = (t, value);
                a *= if stays == 1 { 0.5 } else { 1.0 };
                stays = 1;
            } else {
                (from, a) = (t, value);
                b *= if stays == 2 { 0.5 } else { 1.0 };
                stays = 2;
            }
        }
        second(found)
    }

    /// True if every point of the face lies on a straight line of the surface between points of its loops.
    fn is_ruled(&self) -> bool {
        matches!(self.face.surface, FaceSurface::Plane { .. } | FaceSurface::Cylinder { .. })
    }

    /// For a point without a loop above or below it: true if it is on the left of the nearest point of the
    /// loops. This is so for the cap of a ball and the apex of a cone. On planes and cylinders such a point
    /// is outside of the face.
    fn is_left_of_nearest(&self, p: DVec3) -> bool {
        if self.is_ruled() {
            return false;
        }
        let mut nearest = (f64::MAX, 0.0_f64);
        for (coedge, points) in &self.coedges {
            let curve = &self.solid.edges[coedge.edge].curve;
            for pair in points.windows(2) {
                let [a, b] = [curve.point(pair[0].t), curve.point(pair[1].t)];
                let d = b - a;
                let share = ((p - a).dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                let q = a + share * d;
                let far = (p - q).length();
                let side = unit(self.outward(q).cross(d)).dot(p - q);
                // At a corner, two pieces are equally near. The one to which the point is more nearly
                // perpendicular decides; the other one would give the sign of rounding.
                let is_tie = (far - nearest.0).abs() < 1e-9 * far;
                if far < nearest.0 && !is_tie || is_tie && side.abs() > nearest.1.abs() {
                    nearest = (far, side);
                }
            }
        }
        nearest.1 > 0.0
    }

    /// Distances along a ray at which it meets the surface, within the face or not.
    ///
    /// `range` limits the search on surfaces without a closed form.
    pub(crate) fn met(&self, origin: DVec3, direction: DVec3, range: [f64; 2]) -> Vec<f64> {
        match &self.face.surface {
            FaceSurface::Plane { normal, .. } => {
                let speed = normal.dot(direction);
                if speed.abs() < 1e-9 {
                    return Vec::new();
                }
                vec![-self.face.surface.distance(origin) / speed]
            }
            FaceSurface::Cylinder { origin: at, axis, radius, .. } => {
                let across = |a: DVec3| a - a.dot(*axis) * *axis;
                let (d, o) = (across(direction), across(origin - *at));
                let square = d.length_squared();
                if square < 1e-18 {
                    return Vec::new();
                }
                let middle = -o.dot(d) / square;
                let off = o + middle * d;
                let left = (radius * radius - off.length_squared()) / square;
                if left <= 0.0 {
                    return Vec::new();
                }
                vec![middle - left.sqrt(), middle + left.sqrt()]
            }
            #[allow(
                unreachable_patterns,
                reason = "surfaces of other kinds are met by their signed distance"
            )]
            _ => met_by_distance(&self.face.surface, origin, direction, range),
        }
    }
}

/// Intersections of a ray with a surface given by its signed distance. Contacts without a crossing are
/// omitted.
pub(crate) fn met_by_distance(
    surface: &FaceSurface,
    origin: DVec3,
    direction: DVec3,
    [from, to]: [f64; 2],
) -> Vec<f64> {
    let value = |t: f64| surface.distance(origin + t * direction);
    let finest = MIN_STEP * (to - from);
    let mut open = vec![[from, to]];
    let mut found = Vec::new();
    while let Some([lo, hi]) = open.pop() {
        let middle = (lo + hi) / 2.0;
        let half = (hi - lo) / 2.0;
        if value(middle).abs() > half {
            continue;
        }
        if half > finest {
            open.push([middle, hi]);
            open.push([lo, middle]);
        } else if (value(lo) > 0.0) != (value(hi) > 0.0) {
            found.push(middle);
        }
    }
    found
}

/// Parameters at the ends of the pieces of an edge, and at the extremes of its first scanned parameter.
/// Between two of them this parameter is monotonic, so a scan line crosses at most once.
fn turning_points(edge: &Edge, pieces: usize, scanned: &dyn Fn(f64) -> [f64; 2]) -> Vec<f64> {
    let [from, to] = edge.range;
    // The sign of a small difference, as the derivative of the parameters has no common formula.
    let step = 1e-6 * (to - from);
    let rises = |t: f64| turn(scanned(t + step)[0] - scanned(t - step)[0]) > 0.0;
    let mut found = vec![from];
    for k in 0..pieces {
        let at = |k: usize| from + (to - from) * k as f64 / pieces as f64;
        let (mut lo, mut hi) = (at(k), at(k + 1));
        let first = rises(lo + step);
        if pieces > 1 && first != rises(hi - step) {
            for _ in 0..40 {
                let middle = (lo + hi) / 2.0;
                *(if rises(middle) == first { &mut lo } else { &mut hi }) = middle;
            }
            found.push((lo + hi) / 2.0);
        }
        found.push(at(k + 1));
    }
    found
}

/// The parameters of a surface in which faces are scanned; those of planes are rotated.
fn scan_parameters(surface: &FaceSurface, p: DVec3) -> [f64; 2] {
    let [u, v] = surface.parameters(p);
    match surface {
        FaceSurface::Plane { .. } => {
            let (sin, cos) = SCAN_ANGLE.sin_cos();
            [cos * u + sin * v, cos * v - sin * u]
        }
        _ => [u, v],
    }
}

impl Edge {
    /// Number of pieces in which the edge turns by little: one if it is straight, one for each 15° of an
    /// ellipse, and one for each piece of a spline.
    pub(crate) fn pieces(&self) -> usize {
        match &self.curve {
            EdgeCurve::Line { .. } => 1,
            EdgeCurve::Ellipse { .. } => {
                (((self.range[1] - self.range[0]) / (PI / 12.0)).ceil() as usize).max(2)
            }
            EdgeCurve::Spline { points, .. } => points.len().max(2) - 1,
        }
    }
}
