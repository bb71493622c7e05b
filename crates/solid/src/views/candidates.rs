//! Intersections of all candidate surfaces: those seen edge-on (extruded profiles) and walls.

use super::candidate_surface::{CandidateSurface, across};
use super::cells::Cells;
use super::column::SurfaceId;
use super::oblique_wall::{Form, Oblique};
use super::profile::Profile;
use super::quadrics::quadrics;
use super::surfaces::{Curve3, Extruded, Meeting, meet, meetings, triple};
use super::traced::traced;
use super::turned_wall::Turned;
use crate::brep::{FaceSurface, unit};
use planish_core::DVec3;
use std::f64::consts::TAU;
use std::rc::Rc;

/// Number of samples of a curve between which intersections are searched.
///
/// Two intersections between neighbouring samples are missed; more samples take more time.
const SAMPLES: usize = 288;
/// Number of steps of a traced curve around its wall, or around the tube of a torus.
///
/// Longer steps may jump to another branch of the curve; shorter ones take more time.
const STEPS_AROUND: f64 = 120.0;
/// Maximum number of steps around a wall. It bounds the time for tori with a thin tube.
const MAX_AROUND: f64 = 600.0;

/// A candidate surface.
#[derive(Clone)]
pub(super) enum Candidate {
    /// A surface that a view sees edge-on.
    Extruded(Extruded),
    /// A surface that no view sees edge-on.
    Wall(CandidateSurface),
}

impl Candidate {
    pub(super) fn new(cells: &Cells, id: SurfaceId) -> Self {
        match id {
            SurfaceId::Wall(index) => Self::Wall(cells.plan.walls[index].clone()),
            _ => Self::Extruded(Extruded::new(cells, id)),
        }
    }

    /// Signed distance.
    pub(super) fn value(&self, p: DVec3) -> f64 {
        match self {
            Self::Extruded(s) => s.value(p),
            Self::Wall(s) => s.value(p),
        }
    }

    /// The gradient of the signed distance.
    pub(super) fn normal(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Extruded(s) => s.normal(p),
            Self::Wall(s) => s.normal(p),
        }
    }

    /// The surface. Its normal is the direction of the gradient.
    pub(super) fn surface(&self) -> FaceSurface {
        match self {
            Self::Extruded(s) => s.surface(),
            Self::Wall(s) => s.surface(),
        }
    }
}

/// Intersection curves of two candidates of a drawing of the given size.
pub(super) fn curves(s: &Candidate, t: &Candidate, size: f64, tolerance: f64) -> Vec<Meeting> {
    // Closed forms first: they are exact, and STEP has entities for them. Other curves are traced.
    match (s, t) {
        (Candidate::Extruded(a), Candidate::Extruded(b)) => meetings(a, b, tolerance),
        (Candidate::Wall(CandidateSurface::Turned(wall)), other)
        | (other, Candidate::Wall(CandidateSurface::Turned(wall))) => {
            let curves = simple(wall, other, tolerance).unwrap_or_else(|| followed(wall, other, size));
            let ends = match wall.profile {
                // Lines of a cone end at its apex.
                Profile::Line { normal, offset } if normal[1].abs() > 1e-9 => {
                    vec![wall.point(0.0, [0.0, offset / normal[1]])]
                }
                _ => Vec::new(),
            };
            with_ends(curves, &ends)
        }
        (Candidate::Wall(CandidateSurface::Oblique(wall)), other)
        | (other, Candidate::Wall(CandidateSurface::Oblique(wall))) => {
            let curves = quadrics(&wall.surface(), &other.surface(), tolerance);
            with_ends(curves.unwrap_or_else(|| followed_around(wall, other, size)), &[])
        }
    }
}

/// Curves with points at which lines must be cut.
fn with_ends(curves: Vec<Curve3>, ends_of_lines: &[DVec3]) -> Vec<Meeting> {
    let meeting = |curve: Curve3| Meeting {
        ends: if matches!(curve, Curve3::Line { .. }) { ends_of_lines.to_vec() } else { Vec::new() },
        curve,
    };
    curves.into_iter().map(meeting).collect()
}

/// Points along a curve between which its intersections with other surfaces are searched.
pub(super) struct Samples {
    parameters: Vec<f64>,
    points: Vec<DVec3>,
    /// For each sample, the length along the curve to the farther neighbour, or more; infinite if it is
    /// unknown.
    lengths: Vec<f64>,
}

impl Samples {
    /// Samples of the part of a curve within bounds.
    pub(super) fn new(curve: &Curve3, bounds: [[f64; 2]; 3]) -> Self {
        let [from, to] = match curve {
            Curve3::Line { origin, .. } => {
                let far =
                    [0, 1, 2].map(|k| (bounds[k][0] - origin[k]).abs().max((bounds[k][1] - origin[k]).abs()));
                let far = DVec3::from_array(far).length();
                [-far, far]
            }
            Curve3::Ellipse { .. } => [0.0, TAU],
            Curve3::Branch { .. } => [0.0, std::f64::consts::PI],
            Curve3::Traced(traced) => [0.0, traced.end()],
        };
        // A traced curve is sampled at its own points. Samples of other curves are shifted, because regular
        // ones often lie on grid lines, where values are zero and have no sign.
        let count = match curve {
            Curve3::Traced(_) => to as usize,
            _ => SAMPLES,
        };
        let shift = |k: usize| match curve {
            Curve3::Traced(_) => 0.0,
            _ if k == 0 || k == count => 0.0,
            _ => 0.137,
        };
        let at = |k: usize| from + (to - from) * (k as f64 + shift(k)) / count as f64;
        let parameters: Vec<f64> = (0..=count).map(at).collect();
        let points: Vec<DVec3> = (0..=count)
            .map(|k| match curve {
                Curve3::Traced(traced) => traced.points[k % traced.points.len()],
                _ => curve.point(parameters[k]),
            })
            .collect();
        let lengths = (0..=count).map(|k| length_near(curve, &parameters, k)).collect();
        Self { parameters, points, lengths }
    }
}

/// The length along a curve from a sample to its farther neighbour, or more; infinite if it is unknown.
fn length_near(curve: &Curve3, parameters: &[f64], k: usize) -> f64 {
    let last = parameters.len() - 1;
    let step =
        (parameters[(k + 1).min(last)] - parameters[k]).max(parameters[k] - parameters[k.saturating_sub(1)]);
    match curve {
        Curve3::Line { .. } => step,
        Curve3::Ellipse { a, b, .. } => step * a.length().max(b.length()),
        // At its ends, the coordinates of a branch are square roots of the parameter.
        Curve3::Branch { .. } => f64::INFINITY,
        Curve3::Traced(traced) => {
            let n = traced.points.len();
            let length = |a: usize, b: usize| (traced.points[a % n] - traced.points[b % n]).length();
            // Twice the chords covers the curvature of a step.
            2.0 * length(k + 1, k).max(length(k + n - 1, k))
        }
    }
}

/// Points at which an intersection curve of two candidates meets a third one. The samples of the curve are
/// made when they are needed.
pub(super) fn corners(
    three: [&Candidate; 3],
    curve: &Curve3,
    samples: impl FnOnce() -> Rc<Samples>,
    tolerance: f64,
) -> Vec<DVec3> {
    match three {
        [Candidate::Extruded(s), Candidate::Extruded(t), Candidate::Extruded(u)] => {
            triple([s, t, u], tolerance)
        }
        [_, _, third] => crossings(curve, third, &samples(), tolerance),
    }
}

/// Points of a curve that lie on a candidate; none if all of the curve does.
fn crossings(curve: &Curve3, third: &Candidate, samples: &Samples, tolerance: f64) -> Vec<DVec3> {
    let at = &samples.parameters;
    let count = at.len() - 1;
    let value = |t: f64| third.value(curve.point(t));
    let values: Vec<f64> = samples.points.iter().map(|p| third.value(*p)).collect();
    // The third surface contains the curve, so it does not divide it.
    if values.iter().all(|v| v.abs() <= 2.0 * tolerance) {
        return Vec::new();
    }
    let mut found = Vec::new();
    for k in 0..count {
        let (mut lo, mut hi) = (at[k], at[k + 1]);
        let first = values[k];
        if (first > 0.0) != (values[k + 1] > 0.0) {
            for _ in 0..60 {
                let middle = (lo + hi) / 2.0;
                // Neighbouring numbers.
                if middle <= lo || middle >= hi {
                    break;
                }
                match (value(middle) > 0.0) == (first > 0.0) {
                    true => lo = middle,
                    false => hi = middle,
                }
            }
            found.push(curve.point((lo + hi) / 2.0));
        }
    }
    // Contacts: a minimum of the distance without a change of sign, or the end of a curve. Points found above
    // may be found again; vertices merge them. Golden-section search finds the minimum.
    for k in 0..=count {
        let distance = values[k].abs();
        let is_minimum =
            (k == 0 || distance <= values[k - 1].abs()) && (k == count || distance <= values[k + 1].abs());
        // A signed distance changes at most by the way. Points between samples take time.
        if !is_minimum || distance > samples.lengths[k] + 2.0 * tolerance {
            continue;
        }
        let (mut lo, mut hi) = (at[k.saturating_sub(1)], at[(k + 1).min(count)]);
        for _ in 0..60 {
            let (a, b) = (lo + (hi - lo) * 0.382, lo + (hi - lo) * 0.618);
            match value(a).abs() < value(b).abs() {
                true => hi = b,
                false => lo = a,
            }
        }
        let t = (lo + hi) / 2.0;
        if value(t).abs() <= tolerance {
            found.push(curve.point(t));
        }
    }
    found
}

/// The circle of a wall through a point of its profile; `None` on the axis.
fn circle(wall: &Turned, [distance, height]: [f64; 2]) -> Option<Curve3> {
    let center = wall.point(0.0, [0.0, height]);
    (distance > 1e-9).then(|| Curve3::Ellipse {
        center,
        a: wall.point(0.0, [distance, height]) - center,
        b: wall.point(TAU / 4.0, [distance, height]) - center,
    })
}

/// Circles and lines in which a wall intersects another candidate; `None` if the intersection has no such
/// form.
fn simple(wall: &Turned, other: &Candidate, tolerance: f64) -> Option<Vec<Curve3>> {
    let circles = |at: Vec<[f64; 2]>| Some(at.into_iter().filter_map(|p| circle(wall, p)).collect());
    match (other, other.surface()) {
        (Candidate::Wall(CandidateSurface::Turned(second)), _) => {
            // A sphere is a surface of revolution about any line through its centre.
            let [turned, other_turned] =
                [sphere_about(wall, second, tolerance), sphere_about(second, wall, tolerance)];
            let wall = turned.as_ref().unwrap_or(wall);
            let second = if turned.is_some() { second } else { other_turned.as_ref().unwrap_or(second) };
            // Surfaces about one axis meet in circles, at the common points of their profiles.
            let coaxial =
                second.axis == wall.axis && crate::drawing::distance(second.center, wall.center) < tolerance;
            match coaxial {
                true => circles(meet(&wall.profile, &second.profile, tolerance)),
                false if wall.is_sphere() && second.is_sphere() => Some(two_spheres(wall, second, tolerance)),
                false => None,
            }
        }
        (_, FaceSurface::Cylinder { origin, axis, radius, .. }) => {
            if wall.is_sphere() {
                return sphere_and_cylinder(wall, origin, axis, radius, tolerance);
            }
            let ends = across(wall.axis);
            let coaxial = axis[wall.axis].abs() > 1.0 - 1e-12
                && (0..2).all(|k| (origin[ends[k]] - wall.center[k]).abs() < tolerance);
            if !coaxial {
                return None;
            }
            let heights = wall.profile.crossings(0, radius, tolerance);
            circles(heights.into_iter().map(|h| [radius, h]).collect())
        }
        (_, FaceSurface::Plane { origin, normal, .. }) => {
            if normal[wall.axis].abs() > 1.0 - 1e-12 {
                let height = origin[wall.axis];
                let radii = wall.profile.crossings(1, height, tolerance);
                return circles(radii.into_iter().map(|r| [r, height]).collect());
            }
            if wall.is_sphere() {
                return Some(sphere_and_plane(wall, origin, normal, tolerance));
            }
            let middle = wall.point(0.0, [0.0, 0.0]);
            let holds_axis =
                normal[wall.axis].abs() < 1e-9 && (middle - origin).dot(normal).abs() < tolerance;
            holds_axis.then(|| meridians(wall, normal))
        }
        _ => None,
    }
}

/// A sphere as a surface of revolution about the axis of another wall; `None` if the axis does not pass
/// through its centre, or if the wall is no sphere.
fn sphere_about(wall: &Turned, other: &Turned, tolerance: f64) -> Option<Turned> {
    let (center, radius) = wall.is_sphere().then(|| sphere_of(wall))?;
    let at = other.on_profile(center);
    (at[0] < tolerance && !other.is_sphere()).then(|| Turned {
        axis: other.axis,
        center: other.center,
        profile: Profile::Circle { center: [0.0, at[1]], radius },
        extents: wall.extents.clone(),
    })
}

/// The circles in which a sphere intersects a cylinder whose axis passes through its centre (one if they
/// touch); `None` if the axis does not.
fn sphere_and_cylinder(
    wall: &Turned,
    origin: DVec3,
    axis: DVec3,
    radius: f64,
    tolerance: f64,
) -> Option<Vec<Curve3>> {
    let (center, of_sphere) = sphere_of(wall);
    let from = center - origin;
    if (from - from.dot(axis) * axis).length() > tolerance {
        return None;
    }
    let heights = match of_sphere - radius {
        less if less.abs() <= tolerance => vec![0.0],
        less if less > 0.0 => {
            let height = (of_sphere * of_sphere - radius * radius).sqrt();
            vec![-height, height]
        }
        _ => Vec::new(),
    };
    let circles =
        heights.into_iter().flat_map(|h| sphere_and_plane(wall, center + h * axis, axis, tolerance));
    Some(circles.collect())
}

/// Centre and radius of a wall that is a sphere.
fn sphere_of(wall: &Turned) -> (DVec3, f64) {
    match wall.profile {
        Profile::Circle { center, radius } => (wall.point(0.0, [0.0, center[1]]), radius),
        Profile::Line { .. } => (DVec3::ZERO, 0.0),
    }
}

/// The circle in which a sphere intersects a plane; none if they only touch, as a point is no edge.
fn sphere_and_plane(wall: &Turned, origin: DVec3, normal: DVec3, tolerance: f64) -> Vec<Curve3> {
    let (center, radius) = sphere_of(wall);
    let off = (center - origin).dot(normal);
    if off.abs() >= radius - tolerance {
        return Vec::new();
    }
    // Any direction in the plane serves as the start of the circle; the axis least parallel to the normal
    // gives the most accurate one.
    let distance = (radius * radius - off * off).sqrt();
    let x = unit(normal.cross(if normal[0].abs() < 0.9 { DVec3::X } else { DVec3::Y }));
    vec![Curve3::Ellipse { center: center - off * normal, a: distance * x, b: distance * normal.cross(x) }]
}

/// The circle in which two spheres intersect. It lies in the plane of equal power.
fn two_spheres(first: &Turned, second: &Turned, tolerance: f64) -> Vec<Curve3> {
    let ((a, r), (b, s)) = (sphere_of(first), sphere_of(second));
    let apart = (b - a).length();
    if apart < tolerance {
        return Vec::new();
    }
    let normal = unit(b - a);
    // Subtracting both equations leaves a plane at this distance from the first centre.
    let off = (apart * apart + r * r - s * s) / (2.0 * apart);
    sphere_and_plane(first, a + off * normal, normal, tolerance)
}

/// Intersection of a wall with a plane through its axis: the profile on both sides.
fn meridians(wall: &Turned, normal: DVec3) -> Vec<Curve3> {
    let [a, b] = across(wall.axis);
    let angle = normal[b].atan2(normal[a]) + TAU / 4.0;
    [angle, angle + TAU / 2.0]
        .into_iter()
        .map(|angle| {
            let at = |p: [f64; 2]| wall.point(angle, p);
            match wall.profile {
                Profile::Circle { center, radius } => {
                    let middle = at(center);
                    Curve3::Ellipse {
                        center: middle,
                        a: at([center[0] + radius, center[1]]) - middle,
                        b: at([center[0], center[1] + radius]) - middle,
                    }
                }
                Profile::Line { .. } => {
                    let p = at(wall.profile.point(0.0));
                    Curve3::Line { origin: p, direction: unit(at(wall.profile.point(1.0)) - p) }
                }
            }
        })
        .collect()
}

/// Intersection curves of a wall that have no simple form, traced step by step.
///
/// Seeds are the changes of sign of the other surface's distance over a lattice on the wall. A closed curve
/// smaller than a cell of the lattice is missed.
fn followed(wall: &Turned, other: &Candidate, size: f64) -> Vec<Curve3> {
    let surfaces = [Candidate::Wall(CandidateSurface::Turned(wall.clone())), other.clone()];
    let span = |k: usize| {
        wall.extents
            .iter()
            .map(|e| e.bounds[k])
            .fold([f64::MAX, f64::MIN], |m, e| [m[0].min(e[0]), m[1].max(e[1])])
    };
    let bounds = [span(0), span(1), span(2)];
    let reach = (bounds[across(wall.axis)[0]][1] - bounds[across(wall.axis)[0]][0]) / 2.0;
    let height = bounds[wall.axis];
    let smallest = match wall.profile {
        Profile::Circle { radius, .. } => radius.min(reach),
        Profile::Line { .. } => reach,
    };
    // The step follows the smaller radius, so that the curve stays on its branch. It is bounded from below by
    // the number of steps, and from above by the height, so that short walls get several points.
    let step =
        (TAU * smallest / STEPS_AROUND).max(TAU * reach / MAX_AROUND).min((height[1] - height[0]) / 8.0);
    // Curves are followed a few steps beyond the wall, so that its end cuts them between two points.
    let margin = 3.0 * step + 1e-3 * size;
    let inside = |p: DVec3| (0..3).all(|k| p[k] > bounds[k][0] - margin && p[k] < bounds[k][1] + margin);
    // The lattice extends one step beyond both ends, as curves may begin just there. It is shifted by odd
    // shares, so that no point lies on a plane of symmetry.
    let mut profile: Vec<Vec<[f64; 2]>> = Vec::new();
    const ALONG: usize = 40;
    for k in 0..=ALONG {
        let h = height[0] - step
            + (height[1] - height[0] + 2.0 * step) * (k as f64 + 0.031) / (ALONG as f64 + 0.07);
        profile.push(
            wall.profile.crossings(1, h, 0.0).into_iter().filter(|r| *r > 0.0).map(|r| [r, h]).collect(),
        );
    }
    const TURNS: usize = 120;
    let mut seeds = Vec::new();
    let value = |k: usize, at: [f64; 2]| other.value(wall.point(TAU * (k as f64 + 0.213) / TURNS as f64, at));
    let mut seed = |a: (usize, [f64; 2]), b: (usize, [f64; 2])| {
        if (value(a.0, a.1) > 0.0) != (value(b.0, b.1) > 0.0) {
            seeds.push(wall.point(
                TAU * ((a.0 + b.0) as f64 / 2.0 + 0.213) / TURNS as f64,
                [0, 1].map(|c| (a.1[c] + b.1[c]) / 2.0),
            ));
        }
    };
    for turn in 0..TURNS {
        for (k, row) in profile.iter().enumerate() {
            for (branch, at) in row.iter().enumerate() {
                seed((turn, *at), (turn + 1, *at));
                if let Some(next) = profile.get(k + 1).and_then(|r| r.get(branch)) {
                    seed((turn, *at), (turn, *next));
                }
            }
        }
    }
    traced(&surfaces, &seeds, step, inside).into_iter().map(Curve3::Traced).collect()
}

/// Intersection curves of a cylinder oblique to all views that have no simple form, traced step by step.
fn followed_around(wall: &Oblique, other: &Candidate, size: f64) -> Vec<Curve3> {
    const ROWS: usize = 40;
    let Form::Cylinder { radius, .. } = wall.form else {
        return Vec::new();
    };
    let surface = CandidateSurface::Oblique(wall.clone());
    let bounds = surface.bounds();
    let surfaces = [Candidate::Wall(surface), other.clone()];
    let step = TAU * radius / STEPS_AROUND;
    let margin = 3.0 * step + 1e-3 * size;
    let inside = |p: DVec3| (0..3).all(|k| p[k] > bounds[k][0] - margin && p[k] < bounds[k][1] + margin);
    let lattice = wall.lattice(ROWS, STEPS_AROUND as usize);
    let mut seeds = Vec::new();
    let mut seed = |p: DVec3, q: DVec3| {
        if (other.value(p) > 0.0) != (other.value(q) > 0.0) {
            seeds.push(0.5 * (p + q));
        }
    };
    for (k, row) in lattice.iter().enumerate() {
        for (turn, p) in row.iter().enumerate() {
            seed(*p, row[(turn + 1) % row.len()]);
            if let Some(next) = lattice.get(k + 1) {
                seed(*p, next[turn]);
            }
        }
    }
    traced(&surfaces, &seeds, step, inside).into_iter().map(Curve3::Traced).collect()
}
