//! Faces within their loops, for rays.
//!
//! A ray meets a surface in closed form for planes and cylinders; for any other by its signed distance, which
//! changes by at most the way gone: where it is larger than half an interval, the ray meets nothing
//! there. Whether a point of the surface is in the face is told by the nearest loop along the second
//! parameter, of spheres and tori else along the first: loops have their face to the left.

use super::{Coedge, Edge, EdgeCurve, Face, FaceSurface, Solid, along, unit};
use planish_estimate::vector3::{cross, dot, norm, sub};
use std::f64::consts::{PI, TAU};

/// Planes are scanned along a direction that no drawing has: loops do not run along it.
const SCAN_ANGLE: f64 = 0.617_31;
/// Signed distances are followed down to this share of the first interval.
const FINEST: f64 = 1e-7;

/// A point of a loop: the curve's parameter and the surface's.
#[derive(Clone, Copy)]
struct LoopPoint {
    t: f64,
    uv: [f64; 2],
}

/// A face, ready for rays.
pub(crate) struct TrimmedFace<'a> {
    solid: &'a Solid,
    face: &'a Face,
    /// Points along each coedge, as the loop runs.
    coedges: Vec<(Coedge, Vec<LoopPoint>)>,
    /// Whether the second parameter is an angle, too.
    second_is_angle: bool,
    /// A box around the face: least and largest coordinates.
    pub(crate) bounds: [[f64; 3]; 2],
}

/// The difference of two angles in (−π, π].
fn turn(angle: f64) -> f64 {
    angle - TAU * (angle / TAU).round()
}

impl<'a> TrimmedFace<'a> {
    /// Prepares a face; one whose surface may bulge beyond its loops is bounded by `reach` alone.
    pub(crate) fn new(solid: &'a Solid, face: &'a Face, reach: [[f64; 3]; 2]) -> Self {
        let scanned = |p: [f64; 3]| scan_parameters(&face.surface, p);
        let mut bounds = [[f64::MAX; 3], [f64::MIN; 3]];
        let coedges = face
            .loops
            .iter()
            .flatten()
            // An edge that the face has on both sides bounds nothing: a seam, or where a hole touches a wall
            // from behind.
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
            // Loops are known at points only: between them they bulge by less than a hundredth.
            true => {
                let more = 0.01 * norm(sub(bounds[1], bounds[0]));
                bounds = [bounds[0].map(|c| c - more), bounds[1].map(|c| c + more)];
            }
            false => bounds = reach,
        }
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
    pub(crate) fn outward(&self, p: [f64; 3]) -> [f64; 3] {
        let n = self.face.surface.normal(p);
        if self.face.outward { n } else { n.map(|c| -c) }
    }

    /// Whether the second parameter is an angle as well as the first.
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

    /// Whether a point of the surface lies in the face.
    pub(crate) fn contains(&self, p: [f64; 3]) -> bool {
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
        // Of spheres and tori no loop may have the point's first parameter. All places that do are in the
        // face, then, or none is: one beside which a loop runs is looked at along the first parameter, with
        // the axes turned by a right angle.
        let beside = (self.second_is_angle).then(|| self.steepest());
        let across = beside.flatten().and_then(|level| {
            let from_level = |uv: [f64; 2]| turn(uv[1] - level);
            self.by_scan(true, &from_level, &|uv| -first(uv))
        });
        across.unwrap_or_else(|| self.is_left_of_nearest(p))
    }

    /// The second parameter in the middle of the piece of a loop along which it changes most.
    fn steepest(&self) -> Option<f64> {
        let pieces = self.coedges.iter().flat_map(|(_, points)| points.windows(2));
        let middles = pieces.map(|pair| {
            let step = turn(pair[1].uv[1] - pair[0].uv[1]);
            (step.abs(), pair[0].uv[1] + 0.5 * step)
        });
        let steepest = middles.filter(|(step, _)| *step > 1e-6).max_by(|a, b| a.0.total_cmp(&b.0));
        steepest.map(|(_, middle)| middle)
    }

    /// Whether a point is in the face by the nearest loop along the second of two parameters, each from the
    /// point's own; none where no loop has its first one.
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
        crossed.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        // Where a loop runs back on itself, two crossings in one place bound nothing.
        let mut k = 0;
        while let Some(&(off, runs_on)) = crossed.get(k) {
            match crossed.get(k + 1) {
                Some(&(next, runs_next)) if (next - off).abs() < 1e-7 && runs_next != runs_on => k += 2,
                // Above a point in the face the loop runs back, below it on.
                _ => return Some((runs_on == (off < 0.0)) == self.face.outward),
            }
        }
        None
    }

    /// The second parameter, from the point's own, where a loop has the point's first one: between two
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
        // Regula falsi, with a halved end where one end stays (Illinois).
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

    /// Whether every point of the face lies on a straight line of the surface between points of its loops.
    fn is_ruled(&self) -> bool {
        matches!(self.face.surface, FaceSurface::Plane { .. } | FaceSurface::Cylinder { .. })
    }

    /// For a point that no loop passes above or below: whether it lies to the left of the loops' nearest
    /// point. A ball's cap and a cone's tip do; on planes and cylinders such a point is outside.
    fn is_left_of_nearest(&self, p: [f64; 3]) -> bool {
        if self.is_ruled() {
            return false;
        }
        let mut nearest = (f64::MAX, 0.0_f64);
        for (coedge, points) in &self.coedges {
            let curve = &self.solid.edges[coedge.edge].curve;
            for pair in points.windows(2) {
                let [a, b] = [curve.point(pair[0].t), curve.point(pair[1].t)];
                let d = sub(b, a);
                let share = (dot(sub(p, a), d) / dot(d, d).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                let q = along(a, share, d);
                let far = norm(sub(p, q));
                let side = dot(unit(cross(self.outward(q), d)), sub(p, q));
                // At a corner two pieces are as near: the one across which the point lies tells.
                let is_tie = (far - nearest.0).abs() < 1e-9 * far;
                if far < nearest.0 && !is_tie || is_tie && side.abs() > nearest.1.abs() {
                    nearest = (far, side);
                }
            }
        }
        nearest.1 > 0.0
    }

    /// How far along a ray the surface is met, between two distances; within the face or not.
    pub(crate) fn met(&self, origin: [f64; 3], direction: [f64; 3], range: [f64; 2]) -> Vec<f64> {
        match &self.face.surface {
            FaceSurface::Plane { normal, .. } => {
                let speed = dot(*normal, direction);
                if speed.abs() < 1e-9 {
                    return Vec::new();
                }
                vec![-self.face.surface.distance(origin) / speed]
            }
            FaceSurface::Cylinder { origin: at, axis, radius, .. } => {
                let across = |a: [f64; 3]| along(a, -dot(a, *axis), *axis);
                let (d, o) = (across(direction), across(sub(origin, *at)));
                let square = dot(d, d);
                if square < 1e-18 {
                    return Vec::new();
                }
                let middle = -dot(o, d) / square;
                let off = along(o, middle, d);
                let left = (radius * radius - dot(off, off)) / square;
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

/// Where a ray meets a surface of which only the signed distance is known; places where it only touches are
/// left out.
pub(crate) fn met_by_distance(
    surface: &FaceSurface,
    origin: [f64; 3],
    direction: [f64; 3],
    [from, to]: [f64; 2],
) -> Vec<f64> {
    let value = |t: f64| surface.distance(along(origin, t, direction));
    let finest = FINEST * (to - from);
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

/// An edge's parameters at the ends of its pieces, and where its first scanned parameter turns back: between
/// them it runs one way.
fn turning_points(edge: &Edge, pieces: usize, scanned: &dyn Fn(f64) -> [f64; 2]) -> Vec<f64> {
    let [from, to] = edge.range;
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

/// A surface's parameters as they are scanned: those of planes turned.
fn scan_parameters(surface: &FaceSurface, p: [f64; 3]) -> [f64; 2] {
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
    /// Pieces in which the edge turns by little: straight ones in one, others every 15° or at each of a
    /// spline's points.
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
