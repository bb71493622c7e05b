//! Which base shape a cloud has.
//!
//! Input: points with normals. Output: sheet, tube or ball, first from the distribution of the normals. A
//! ball is what is left, and closed on all sides. Normals from neighbours are wrong where readings lie on
//! lines or on a coarse grid, so the points must also be no open cylinder.
//!
//! Not guaranteed: bent pipes. They are no cylinder, and taken for balls with closed ends.

use crate::base::{BaseShape, circle_centre, principal_axes};
use crate::base_fit::{fit_base_shape, scatter_about};
use crate::hierarchy::Shape;
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use std::collections::HashMap;

/// Sections along the axis of a cloud, and the smallest number of points in one.
const SECTIONS: usize = 50;
const MIN_SECTION: usize = 8;
/// A section at a tip has a radius below this share of the typical one, and normals that are turned towards
/// the tip by this cosine in the mean. Ellipsoids up to 6 : 1 have less than 0.5 and more than 0.4; a cone
/// that is open at half its radius has 0.67.
const TIP_RADIUS: f64 = 0.6;
const TIP_TURN: f64 = 0.3;

/// Points from which normals are smoothed, points in a cell, and smallest length of their mean normal.
const MIN_SMOOTHED: usize = 1000;
const PER_CELL: f64 = 8.0;
const MIN_AGREEMENT: f64 = 0.5;
/// Points that are compared with a cylinder and a sphere.
const MAX_COMPARED: usize = 2000;
/// Largest scatter of an open cylinder about a circular one, as a share of its radius and of the scatter
/// about a sphere. A square tube has 0.11 of its radius, an ellipsoid of 5 : 1 has 0.28.
const MAX_SCATTER: f64 = 0.15;
const MAX_SHARE_OF_BALL: f64 = 0.5;
/// Points nearer to the axis than this share of the radius are of caps; largest share of them. The caps of a
/// cylinder as long as wide are a third of it.
const CAP_RADIUS: f64 = 0.6;
const MAX_CAPS: f64 = 0.01;

/// Sheet, tube or ball from the distribution of known normals at some points.
pub(crate) fn shape_from_normals(points: &[DVec3], normals: &[DVec3], variances: [f64; 3]) -> Shape {
    if normals.is_empty() {
        // Without normals, flat clouds are sheets.
        return if variances[2] < 0.05 * variances[1] { Shape::Sheet } else { Shape::Ball };
    }
    let smoothed = smoothed_normals(points, normals, variances);
    let normals = smoothed.as_slice();
    let count = normals.len() as f64;
    let mean = 1.0 / count * normals.iter().sum::<DVec3>();
    if let Some(direction) = mean.try_normalize() {
        // A few normals may face away: outliers, and noise at the edges of a scan.
        let behind = normals.iter().filter(|n| n.dot(direction) < 0.1).count() as f64;
        if mean.length() > 0.5 && behind < 0.03 * count {
            return Shape::Sheet;
        }
    }
    if let Some(axis) = perpendicular_axis(normals) {
        let along = normals.iter().map(|n| n.dot(axis).powi(2)).sum::<f64>() / count;
        // Normals along the axis are caps; a capped cylinder is closed and therefore a ball.
        let caps = normals.iter().filter(|n| n.dot(axis).abs() > 0.8).count() as f64;
        if along < 0.12 && caps < 0.02 * count && !narrows_to_a_tip(points, normals, axis) {
            return Shape::Tube;
        }
    }
    Shape::Ball
}

/// The normals, each the mean of those in its cell of a grid, so that noise does not turn some of them to
/// the other side of a sheet. Normals in a cell that do not agree, as those of both sides of a thin part,
/// stay as they are.
fn smoothed_normals(points: &[DVec3], normals: &[DVec3], variances: [f64; 3]) -> Vec<DVec3> {
    if normals.len() < MIN_SMOOTHED {
        return normals.to_vec();
    }
    // A rectangle of the sides a and b has the variances a²/12 and b²/12.
    let area = 12.0 * (variances[0] * variances[1].max(0.0)).sqrt();
    let side = (area * PER_CELL / normals.len() as f64).sqrt().max(f64::MIN_POSITIVE);
    let cell_of = |p: &DVec3| p.to_array().map(|c| (c / side).floor() as i64);
    let mut sums: HashMap<[i64; 3], (DVec3, f64)> = HashMap::new();
    for (p, n) in points.iter().zip(normals) {
        let (sum, count) = sums.entry(cell_of(p)).or_default();
        *sum += *n;
        *count += 1.0;
    }
    (points.iter().zip(normals))
        .map(|(p, n)| match sums.get(&cell_of(p)) {
            Some((sum, count)) if sum.length() > MIN_AGREEMENT * count => sum.normalize(),
            _ => *n,
        })
        .collect()
}

/// True if a cloud is closed at an end of its axis: the last points lie in a narrow section, and their
/// normals turn towards the end. A long ellipsoid has hardly any normals along its axis, but is no tube.
fn narrows_to_a_tip(points: &[DVec3], normals: &[DVec3], axis: DVec3) -> bool {
    let mut order: Vec<(f64, usize)> = points.iter().map(|p| p.dot(axis)).zip(0..).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let size = (points.len() / SECTIONS).max(MIN_SECTION);
    let sections: Vec<&[(f64, usize)]> = order.chunks_exact(size).collect();
    // About the middle of each section: tubes may be bent.
    let radius = |section: &[(f64, usize)]| {
        let away = |&(along, i): &(f64, usize)| points[i] - along * axis;
        let middle = section.iter().map(away).sum::<DVec3>() / section.len() as f64;
        (section.iter().map(|at| (away(at) - middle).length_squared()).sum::<f64>() / section.len() as f64)
            .sqrt()
    };
    let turned = |section: &[(f64, usize)], outwards: DVec3| {
        section.iter().map(|&(_, i)| normals[i].dot(outwards)).sum::<f64>() / section.len() as f64
    };
    let mut radii: Vec<f64> = sections.iter().map(|section| radius(section)).collect();
    radii.sort_by(f64::total_cmp);
    let (Some(first), Some(typical)) = (sections.first(), radii.get(radii.len() / 2)) else {
        return false;
    };
    let last = &order[order.len() - size..];
    [(*first, -axis), (last, axis)].into_iter().any(|(section, outwards)| {
        radius(section) < TIP_RADIUS * typical && turned(section, outwards) > TIP_TURN
    })
}

/// The unit vector most nearly perpendicular to all normals.
pub(crate) fn perpendicular_axis(normals: &[DVec3]) -> Option<DVec3> {
    if normals.len() < 3 {
        return None;
    }
    // Moments about zero, not about the mean: the axis is perpendicular to the normals themselves.
    let mut moments = SymmetricMatrix3::ZERO;
    for n in normals {
        moments.add_outer(1.0, *n);
    }
    let (axes, _) = moments.eigen();
    Some(axes[2])
}

/// The axis of points that lie on a cylinder with open ends; none if they do not.
pub(crate) fn axis_of_open_cylinder(points: &[DVec3]) -> Option<DVec3> {
    let sample: Vec<DVec3> =
        points.iter().step_by(points.len().div_ceil(MAX_COMPARED).max(1)).copied().collect();
    let (mean, axes, variances) = principal_axes(&sample);
    let radius = (2.0 * variances[1]).sqrt();
    let sphere = fit_base_shape(&BaseShape::sphere(mean, variances[0].sqrt(), axes[0]), &sample);
    let cylinder = (axes.into_iter())
        .map(|axis| {
            let (e1, e2) = tangents(axis);
            let [x, y] = circle_centre(&sample, e1, e2);
            let centre = mean.dot(axis) * axis + (x * e1 + y * e2);
            fit_base_shape(&BaseShape::cylinder(centre, axis, radius, radius), &sample)
        })
        .min_by(|a, b| scatter_about(a, &sample).total_cmp(&scatter_about(b, &sample)))?;
    let (radius, axis) = (cylinder.size[0], cylinder.frame[2]);
    let from_axis = |p: &DVec3| (*p - cylinder.centre).cross(axis).length();
    let caps = sample.iter().filter(|p| from_axis(p) < CAP_RADIUS * radius).count() as f64;
    let scatter = scatter_about(&cylinder, &sample);
    let is_open = scatter < MAX_SCATTER * radius
        && scatter < MAX_SHARE_OF_BALL * scatter_about(&sphere, &sample)
        && caps < MAX_CAPS * sample.len() as f64;
    is_open.then_some(axis)
}
