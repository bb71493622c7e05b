//! Cylinders oblique to all views, from their ends.
//!
//! A curve of a view is lifted into a plane. If it is a circle seen along an axis, and the other views show
//! its points as well, it is the end of a cylinder.

use super::candidate_surface::{Extent, Side};
use super::oblique::bounds_of;
use super::oblique_wall::{Form, Oblique, Sector};
use super::wireframe::Wireframe;
use crate::brep::unit;
use crate::drawing::{Curve2, Drawing, distance_to_segment};
use nalgebra::{DMatrix, DVector};
use planish_contour::planar::circle_of_points;
use planish_core::{DVec3, vector3::tangents};
use std::f64::consts::TAU;

/// Minimum component of a plane's normal along the line of sight for curves to be lifted into the plane.
///
/// Lifting divides errors by it.
const MIN_LEAN: f64 = 1e-3;
/// Maximum error of exported curves, relative to the size of the drawing.
///
/// A larger value accepts curves that are not circles; a smaller one rejects coarse polygons.
const MAX_ERROR: f64 = 1e-3;
/// Maximum error of a circle that is used without measuring it by straight lines, relative to the size.
const MAX_UNMEASURED_ERROR: f64 = 1e-6;
/// Minimum number of points of a curve. Three always lie on a circle; two more can contradict it.
const MIN_POINTS: usize = 5;
/// Directions are equal below this sine of the angle between them.
const PARALLEL: f64 = 1e-4;
/// Minimum cosine of the angle between an axis and the normal of a plane that ends the cylinder.
///
/// Flatter cuts make long ellipses, whose circles along the axis are inaccurate.
const MIN_STEEP: f64 = 0.2;
/// Maximum half width of a sector, in radians. Wider ones use the whole cylinder: the tangent planes at the
/// ends of a sector must meet on its outer side, which needs less than π/2.
const WIDEST: f64 = 1.5;
/// Steps of Newton's method. Its start is within [`MAX_ERROR`] of the solution, so few suffice.
const STEPS: usize = 8;

/// A plane in which ends of cylinders may lie.
struct Plane {
    normal: DVec3,
    offset: f64,
}

/// A circle across an axis on which a curve lies, seen along it.
struct Circle {
    axis: DVec3,
    center: DVec3,
    radius: f64,
    /// Maximum distance of the points from the circle.
    off: f64,
    /// Index of the plane of the points.
    plane: usize,
    points: Vec<DVec3>,
}

/// Cylinders with ends in oblique planes, or in planes that one view sees edge-on as slanted lines.
pub(super) fn circles(drawing: &Drawing, frame: &Wireframe, oblique: &[Oblique], near: f64) -> Vec<Oblique> {
    let size = drawing.size();
    let mut planes: Vec<Plane> = oblique
        .iter()
        .filter_map(|wall| match wall.form {
            Form::Plane { normal, offset } => Some(Plane { normal, offset }),
            Form::Cylinder { .. } => None,
        })
        .collect();
    for view in &drawing.views {
        let axes = view.kind.axes();
        for drawn in &view.curves {
            let Curve2::Segment(a, b) = drawn.curve else {
                continue;
            };
            if (0..2).any(|k| (a[k] - b[k]).abs() <= near) {
                continue;
            }
            let mut normal = DVec3::ZERO;
            (normal[axes[0]], normal[axes[1]]) = (a[1] - b[1], b[0] - a[0]);
            let normal = unit(normal);
            let offset = normal[axes[0]] * a[0] + normal[axes[1]] * a[1];
            // Compared over the size of the drawing, as an angle has no unit of length.
            let same =
                |p: &Plane| p.normal.cross(normal).length() * size < near && (p.offset - offset).abs() < near;
            if !planes.iter().any(same) {
                planes.push(Plane { normal, offset });
            }
        }
    }
    let mut groups: Vec<Vec<Circle>> = Vec::new();
    let axes = axes(frame);
    for circle in (0..planes.len()).flat_map(|k| circles_in(drawing, &planes[k], k, &axes)) {
        // Ends of one cylinder have parallel axes, equal radii, and centres on one line along the axis.
        let same = |group: &Vec<Circle>| {
            let known = &group[0];
            let d = circle.center - known.center;
            let across = d - d.dot(known.axis) * known.axis;
            known.axis.cross(circle.axis).length() < MAX_ERROR
                && (known.radius - circle.radius).abs() < 2.0 * MAX_ERROR * size
                && across.length() < 2.0 * MAX_ERROR * size
        };
        match groups.iter_mut().find(|g| same(g)) {
            Some(group) => group.push(circle),
            None => groups.push(vec![circle]),
        }
    }
    groups.iter().filter_map(|group| cylinder(drawing, frame, group, near)).collect()
}

/// Directions of edges between ends of curves. These may run along a cylinder from end to end.
fn axes(frame: &Wireframe) -> Vec<DVec3> {
    let mut found: Vec<DVec3> = Vec::new();
    for [i, j] in &frame.edges {
        if frame.ends_curve[*i] && frame.ends_curve[*j] {
            let d = frame.points[*j] - frame.points[*i];
            match found.iter_mut().find(|f| unit(**f).cross(d).length() < PARALLEL * d.length()) {
                // The sum of the edges weights each direction by its length: errors of the ends turn a long
                // edge less.
                Some(known) => *known += known.dot(d).signum() * d,
                None => found.push(d),
            }
        }
    }
    found.into_iter().map(unit).collect()
}

/// The curves of all views that are circles, seen along the normal of a plane or along an axis, when lifted
/// into the plane. Every other view must draw something at their points.
fn circles_in(drawing: &Drawing, plane: &Plane, index: usize, axes: &[DVec3]) -> Vec<Circle> {
    let size = drawing.size();
    let steep = axes.iter().copied().filter(|a| {
        let cosine = a.dot(plane.normal).abs();
        cosine > MIN_STEEP && cosine < 1.0 - PARALLEL * PARALLEL
    });
    let axes: Vec<DVec3> = std::iter::once(plane.normal).chain(steep).collect();
    let mut found = Vec::new();
    for (v, view) in drawing.views.iter().enumerate() {
        let [right, up, sight] = view.kind.axes();
        let lean = plane.normal[sight];
        if lean.abs() < MIN_LEAN {
            continue;
        }
        for drawn in &view.curves {
            let Curve2::Chain(chain) = &drawn.curve else {
                continue;
            };
            if chain.len() < MIN_POINTS {
                continue;
            }
            let lifted = |q: &[f64; 2]| {
                let mut p = DVec3::ZERO;
                (p[right], p[up]) = (q[0], q[1]);
                p[sight] = (plane.offset - plane.normal.dot(p)) / lean;
                p
            };
            let points: Vec<DVec3> = chain.iter().map(lifted).collect();
            let mut is_seen = None;
            for axis in &axes {
                let (e1, e2) = tangents(*axis);
                let flat: Vec<[f64; 2]> = points.iter().map(|p| [p.dot(e1), p.dot(e2)]).collect();
                let Some(&[x, y, radius]) = circle_of_points(&flat).as_deref() else {
                    continue;
                };
                let center = [x, y];
                let off = flat
                    .iter()
                    .map(|p| (crate::drawing::distance(*p, center) - radius).abs())
                    .fold(0.0, f64::max);
                // A flat arc fits circles of any large radius, so the radius must be smaller than the drawing
                // and ten times its error.
                let is_circle = off < MAX_ERROR * size && radius < size && radius > 10.0 * off;
                if !is_circle || !*is_seen.get_or_insert_with(|| is_shown(drawing, v, &points, size)) {
                    continue;
                }
                found.push(Circle {
                    axis: *axis,
                    center: center[0] * e1 + center[1] * e2,
                    radius,
                    off,
                    plane: index,
                    points: points.clone(),
                });
            }
        }
    }
    found
}

/// True if every other view draws something at the images of some points.
fn is_shown(drawing: &Drawing, of: usize, points: &[DVec3], size: f64) -> bool {
    let others = drawing.views.iter().enumerate().filter(|(v, _)| *v != of);
    others.into_iter().all(|(_, view)| {
        let [right, up, _] = view.kind.axes();
        let chains: Vec<Vec<[f64; 2]>> = view.curves.iter().map(|c| c.curve.points()).collect();
        points.iter().all(|p| {
            let q = [p[right], p[up]];
            chains
                .iter()
                .flat_map(|c| c.windows(2))
                .any(|pair| distance_to_segment(q, pair[0], pair[1]) < 2.0 * MAX_ERROR * size)
        })
    })
}

/// The cylinder through circles about one axis; `None` if all circles are in one plane, or if its position
/// cannot be measured exactly.
fn cylinder(drawing: &Drawing, frame: &Wireframe, group: &[Circle], near: f64) -> Option<Oblique> {
    let size = drawing.size();
    let best = group.iter().min_by(|a, b| a.off.total_cmp(&b.off))?;
    let axis = best.axis;
    if group.iter().all(|c| c.plane == best.plane) {
        return None;
    }
    let (origin, radius) = match best.off < MAX_UNMEASURED_ERROR * size {
        true => (best.center, best.radius),
        false => measured(drawing, frame, group, best, near)?,
    };
    // Designed radii are usually round.
    let round = (radius * 1e4).round() / 1e4;
    let radius = if (radius - round).abs() < MAX_UNMEASURED_ERROR * size { round } else { radius };
    let points: Vec<DVec3> = group.iter().flat_map(|c| c.points.iter().copied()).collect();
    let form = Form::Cylinder { origin, axis, radius };
    Some(Oblique {
        form,
        sector: sector(axis, origin, &points),
        extents: vec![Extent { bounds: bounds_of(&points), side: Side::Both }],
    })
}

/// The sector of some points about an axis: the complement of the widest gap. `None` if it is too wide.
fn sector(axis: DVec3, origin: DVec3, points: &[DVec3]) -> Option<Sector> {
    let (e1, e2) = tangents(axis);
    let angle = |p: &DVec3| {
        let d = *p - origin;
        d.dot(e2).atan2(d.dot(e1))
    };
    let mut angles: Vec<f64> = points.iter().map(angle).collect();
    angles.sort_by(f64::total_cmp);
    angles.push(angles[0] + TAU);
    // The first angle again, a turn later, so that the gap across the start is compared as well.
    let (gap, after) = angles.windows(2).map(|a| (a[1] - a[0], a[1])).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let half_width = (TAU - gap) / 2.0;
    let (sin, cos) = (after + half_width).sin_cos();
    (half_width < WIDEST).then(|| Sector { middle: cos * e1 + sin * e2, half_width })
}

/// Axis and radius of a cylinder from straight lines, which exporters write exactly.
///
/// Points of the wireframe have the distance `|p − c| = r` across the axis, and straight outlines have the
/// distance r from the image of the axis. Least squares for the two coordinates of the axis and the radius.
fn measured(
    drawing: &Drawing,
    frame: &Wireframe,
    group: &[Circle],
    best: &Circle,
    near: f64,
) -> Option<(DVec3, f64)> {
    let size = drawing.size();
    let axis = best.axis;
    let bounds = bounds_of(&group.iter().flat_map(|c| c.points.iter().copied()).collect::<Vec<_>>());
    let across = |d: DVec3| d - d.dot(axis) * axis;
    let is_near = |far: f64| (far - best.radius).abs() < 2.0 * MAX_ERROR * size;
    let mut points: Vec<DVec3> = (0..frame.points.len())
        .filter(|k| frame.ends_curve[*k])
        .map(|k| frame.points[k])
        .filter(|p| (0..3).all(|k| p[k] > bounds[k][0] - near && p[k] < bounds[k][1] + near))
        .filter(|p| is_near(across(*p - best.center).length()))
        .collect();
    // Outlines: unit vectors across the axis and the line of sight, and the coordinate of the outline along
    // them.
    let mut lines: Vec<(DVec3, f64)> = Vec::new();
    for view in &drawing.views {
        let [right, up, sight] = view.kind.axes();
        let mut e = DVec3::ZERO;
        e[sight] = 1.0;
        let radial = unit(axis.cross(e));
        for drawn in &view.curves {
            let Curve2::Segment(a, b) = drawn.curve else {
                continue;
            };
            let at = |p: [f64; 2]| radial[right] * p[0] + radial[up] * p[1];
            let far = at(a) - radial.dot(best.center);
            if (at(a) - at(b)).abs() < near && is_near(far.abs()) {
                lines.push((far.signum() * radial, far.signum() * at(a)));
            }
        }
    }
    // Other edges may lie close to an outline. The worst equation is removed until all agree, as long as the
    // others determine the cylinder.
    loop {
        let found = adjusted(axis, (best.center, best.radius), &points, &lines)?;
        let off = &found.residuals;
        let worst = (0..off.len()).max_by(|a, b| off[*a].total_cmp(&off[*b]))?;
        if off[worst] < near {
            return Some((found.center, found.radius));
        }
        match worst < points.len() {
            true => points.remove(worst),
            false => {
                lines.remove(worst - points.len());
                continue;
            }
        };
    }
}

/// Adjusted position and radius of a cylinder, with the absolute residuals of all equations.
struct Adjusted {
    center: DVec3,
    radius: f64,
    residuals: Vec<f64>,
}

/// Position of the axis and radius by least squares; `None` if points and outlines do not determine them, or
/// if there is no redundancy (fewer than four equations for three unknowns).
fn adjusted(
    axis: DVec3,
    (mut center, mut radius): (DVec3, f64),
    points: &[DVec3],
    lines: &[(DVec3, f64)],
) -> Option<Adjusted> {
    let (e1, e2) = tangents(axis);
    let count = points.len() + lines.len();
    if count < 4 {
        return None;
    }
    let mut residuals = Vec::new();
    for _ in 0..STEPS {
        let mut rows = Vec::new();
        for p in points {
            let d = *p - center;
            let d = d - d.dot(axis) * axis;
            let n = unit(d);
            rows.push(([-n.dot(e1), -n.dot(e2), -1.0], d.length() - radius));
        }
        for (n, at) in lines {
            rows.push(([-n.dot(e1), -n.dot(e2), -1.0], at - n.dot(center) - radius));
        }
        residuals = rows.iter().map(|r| r.1.abs()).collect();
        let jacobian = DMatrix::from_fn(count, 3, |i, j| rows[i].0[j]);
        let misclosure = DVector::from_fn(count, |i, _| -rows[i].1);
        // Nearly parallel normals determine the position and the radius only together, as a short arc does.
        let svd = jacobian.svd(true, true);
        if svd.singular_values.min() < 1e-3 * svd.singular_values.max() {
            return None;
        }
        let step = svd.solve(&misclosure, 1e-12).ok()?;
        center = center + step[0] * e1 + step[1] * e2;
        radius += step[2];
    }
    Some(Adjusted { center, radius, residuals })
}
