//! Which base shape a cloud has.
//!
//! Input: points with normals. Output: sheet, tube or ball, first from the distribution of the normals. A
//! ball is what is left, and closed on all sides. Normals from neighbours are wrong where readings lie on
//! lines or on a coarse grid, so the points must also be no open cylinder.
//!
//! Not guaranteed: a suitable choice for shapes unlike any of the four; callers let users override it. Bent
//! pipes are no cylinder, and taken for balls with closed ends.

use crate::base::BaseShape;
use crate::base_fit::{fit_base_shape, scatter_about};
use crate::hierarchy::Shape;
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
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

/// Ratio of the variances of a cloud below which it counts as round.
const NEARLY_ROUND: f64 = 1.3;
/// Radius about the axis of a torus that is empty, as a share of the largest; smallest number and share of
/// points within it that contradict a torus. A ball has 0.5 % there, a torus of radii 4 : 3 none.
const HOLE_OF_TORUS: f64 = 0.1;
const MIN_AT_AXIS: usize = 3;
const MAX_AT_AXIS: f64 = 0.002;
/// Share of the points at each end that the bounds of a torus leave out.
const BEYOND_BOUNDS: f64 = 0.005;

/// Chooses and fits a base shape to points with optional outward unit normals.
///
/// If all normals face one side, the cloud is a sheet. If they are nearly perpendicular to an axis, and
/// neither end narrows to a tip, or if the points lie on an open cylinder, it is a tube. Otherwise it is a
/// ball. `wanted` overrides the choice. The shape encloses all points, but a torus
/// leaves out half a percent at each end.
///
/// # Errors
/// `Undetermined` for fewer than 4 points, coincident or collinear points, and coplanar points if `wanted` is
/// not a sheet, and for points near the axis of a torus.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{Shape, choose_base_shape};
///
/// let points: Vec<DVec3> =
///     (0..100).map(|k| DVec3::new(f64::from(k % 10), f64::from(k / 10), 0.01 * f64::from(k % 3))).collect();
/// let base = choose_base_shape(&points, &[], None)?;
/// assert_eq!(base.shape, Shape::Sheet);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn choose_base_shape(points: &[DVec3], normals: &[DVec3], wanted: Option<Shape>) -> Result<BaseShape> {
    if points.len() < 4 {
        return Err(Error::undetermined(format!(
            "expected at least 4 points for a surface, found {}",
            points.len()
        )));
    }
    let (mean, axes, variances) = principal_axes(points);
    if variances[0] <= 0.0 {
        return Err(Error::undetermined("expected points that span an area, found all at one position"));
    }
    // A ratio of variances of 1e-12 is a ratio of lengths of 1e-6, far below the noise of any sensor.
    if variances[1] <= 1e-12 * variances[0] {
        return Err(Error::undetermined("expected points that span an area, found all on one line"));
    }
    let is_known = |(_, normal): &(&DVec3, &DVec3)| normal.length_squared() > 0.5;
    let (at, known): (Vec<DVec3>, Vec<DVec3>) = points.iter().zip(normals).filter(is_known).unzip();
    let by_normals = wanted.unwrap_or_else(|| shape_from_normals(&at, &known, variances));
    let is_guess = wanted.is_none() && by_normals == Shape::Ball;
    let axis_of_tube = if is_guess { axis_of_open_cylinder(points) } else { None };
    let shape = if axis_of_tube.is_some() { Shape::Tube } else { by_normals };
    if shape != Shape::Sheet && variances[2] <= 1e-12 * variances[0] {
        return Err(Error::undetermined(format!(
            "expected points that are not in one plane for a {}: these determine only a sheet",
            shape.name()
        )));
    }
    match shape {
        Shape::Sheet => Ok(rectangle_around(points, &known, mean, axes, variances[0].sqrt())),
        Shape::Tube => {
            let axis = axis_of_tube.or_else(|| perpendicular_axis(&known)).unwrap_or(axes[0]);
            let (e1, e2) = tangents(axis);
            let centre2 = circle_centre(points, e1, e2);
            let (lo, hi) = bounds(points, [axis, e1]);
            let along = 0.5 * (lo[0] + hi[0]);
            let centre = along * axis + (centre2[0] * e1 + centre2[1] * e2);
            let radius = points
                .iter()
                .map(|p| {
                    let d = *p - centre;
                    d.dot(e1).hypot(d.dot(e2))
                })
                .sum::<f64>()
                / points.len() as f64;
            Ok(BaseShape::cylinder(centre, axis, radius, 0.505 * (hi[0] - lo[0])))
        }
        Shape::Ball => {
            // The principal axes of a nearly round cloud turn with its noise, and the grid with them.
            let axes = if variances[0] < NEARLY_ROUND * variances[2] { DVec3::AXES } else { axes };
            let (lo, hi) = bounds3(points, axes);
            let centre = (0..3).fold(DVec3::ZERO, |c, d| c + 0.5 * (lo[d] + hi[d]) * axes[d]);
            // Place poles in the flattest direction, because features (ears, handles) tend to lie along the
            // longer ones.
            let frame = [axes[0], axes[1], axes[0].cross(axes[1])];
            let size = [0, 1, 2].map(|d| 0.5 * (hi[d] - lo[d]));
            let largest = size[0].max(size[1]).max(size[2]);
            // A flatter ball would have two sides so close that foot points confuse them.
            Ok(BaseShape { shape, centre, frame, size: size.map(|s| s.max(0.2 * largest)) })
        }
        Shape::Torus => {
            let axis = axes[2];
            let centre = axes.iter().fold(DVec3::ZERO, |c, e| {
                let [lo, hi] = bounds_of_most(points.iter().map(|p| p.dot(*e)).collect());
                c + 0.5 * (lo + hi) * *e
            });
            let from_axis = |p: &DVec3| {
                let d = *p - centre;
                (d - d.dot(axis) * axis).length()
            };
            let [near, far] = bounds_of_most(points.iter().map(from_axis).collect());
            let filled = points.iter().filter(|p| from_axis(p) < HOLE_OF_TORUS * far).count();
            if filled >= MIN_AT_AXIS && filled as f64 > MAX_AT_AXIS * points.len() as f64 {
                return Err(Error::undetermined(format!(
                    "expected points of a torus, whose hole is empty, found {filled} of {} near the axis: \
                     the object has another shape",
                    points.len()
                )));
            }
            Ok(BaseShape::torus(centre, axis, 0.5 * (near + far), 0.5 * (far - near).max(0.05 * far)))
        }
    }
}

/// The smallest rectangle around points, perpendicular to the mean of the known normals or to the direction
/// of least variance. `spread` is the standard deviation of the cloud along its longest axis.
fn rectangle_around(
    points: &[DVec3],
    known: &[DVec3],
    mean: DVec3,
    axes: [DVec3; 3],
    spread: f64,
) -> BaseShape {
    let mut normal = axes[2];
    let sum = known.iter().sum::<DVec3>();
    if let Some(direction) = sum.try_normalize()
        && sum.length() > 0.5 * known.len() as f64
    {
        // Use the mean normal: a folded sheet overlaps less along it than along the direction of
        // least variance.
        normal = direction;
    }
    // The principal axis is perpendicular to the third axis but not to the mean normal.
    let u = (axes[0] - axes[0].dot(normal) * normal).try_normalize().unwrap_or(tangents(normal).0);
    // Rotate the frame so that the sides of the sheet are those of the smallest box around the
    // points.
    let (u, v) = smallest_box(points, u, normal.cross(u));
    let (lo, hi) = bounds(points, [u, v]);
    let centre = mean + (0.5 * (lo[0] + hi[0]) - mean.dot(u)) * u + (0.5 * (lo[1] + hi[1]) - mean.dot(v)) * v;
    // A margin of 0.5 % keeps the outermost points inside.
    BaseShape::plane(centre, [u, v], [0, 1].map(|d| (0.505 * (hi[d] - lo[d])).max(1e-9 * spread)))
}

/// Mean, principal axes (right-handed, largest variance first) and variances of a cloud.
#[must_use]
pub fn principal_axes(points: &[DVec3]) -> (DVec3, [DVec3; 3], [f64; 3]) {
    let count = points.len() as f64;
    let mean = 1.0 / count * points.iter().sum::<DVec3>();
    let mut moments = SymmetricMatrix3::ZERO;
    for p in points {
        moments.add_outer(1.0, *p - mean);
    }
    let covariance = SymmetricMatrix3::from_array(moments.to_array().map(|x| x / count));
    // The signs of eigenvectors are arbitrary and could give a left-handed frame.
    let (mut axes, values) = covariance.eigen();
    axes[2] = axes[0].cross(axes[1]);
    (mean, axes, values)
}

fn bounds(points: &[DVec3], directions: [DVec3; 2]) -> ([f64; 2], [f64; 2]) {
    points.iter().fold(([f64::MAX; 2], [f64::MIN; 2]), |(lo, hi), p| {
        let x = directions.map(|e| e.dot(*p));
        ([0, 1].map(|d| lo[d].min(x[d])), [0, 1].map(|d| hi[d].max(x[d])))
    })
}

/// Bounds of some numbers, without half a percent of them at each end: a single gross error would make the
/// tube of a torus as thick as its ring.
fn bounds_of_most(mut numbers: Vec<f64>) -> [f64; 2] {
    numbers.sort_unstable_by(f64::total_cmp);
    let beyond = (BEYOND_BOUNDS * numbers.len() as f64) as usize;
    [numbers[beyond], numbers[numbers.len() - 1 - beyond]]
}

fn bounds3(points: &[DVec3], directions: [DVec3; 3]) -> ([f64; 3], [f64; 3]) {
    points.iter().fold(([f64::MAX; 3], [f64::MIN; 3]), |(lo, hi), p| {
        let x = directions.map(|e| e.dot(*p));
        ([0, 1, 2].map(|d| lo[d].min(x[d])), [0, 1, 2].map(|d| hi[d].max(x[d])))
    })
}

/// Rotates u and v within their plane to the box of minimum area, in steps of 3°.
fn smallest_box(points: &[DVec3], u: DVec3, v: DVec3) -> (DVec3, DVec3) {
    // A sample is enough for a frame in steps of 3°.
    let stride = points.len().div_ceil(4000);
    let some: Vec<DVec3> = points.iter().copied().step_by(stride).collect();
    let turned = |degrees: f64| {
        let (s, c) = degrees.to_radians().sin_cos();
        (c * u + s * v, -s * u + c * v)
    };
    let area = |degrees: f64| {
        let (a, b) = turned(degrees);
        let (lo, hi) = bounds(&some, [a, b]);
        (hi[0] - lo[0]) * (hi[1] - lo[1])
    };
    let best =
        (-14..=15).map(|k| 3.0 * f64::from(k)).min_by(|a, b| area(*a).total_cmp(&area(*b))).unwrap_or(0.0);
    turned(best)
}

/// Centre of the circle fitted to the projected points (Kåsa's linear fit), in coordinates of e1 and e2.
fn circle_centre(points: &[DVec3], e1: DVec3, e2: DVec3) -> [f64; 2] {
    let count = points.len() as f64;
    // About the mean: third powers of large coordinates would cancel.
    let mean = points.iter().fold([0.0; 2], |m, p| [m[0] + p.dot(e1) / count, m[1] + p.dot(e2) / count]);
    let (mut xx, mut xy, mut yy, mut xr, mut yr) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let (x, y) = (p.dot(e1) - mean[0], p.dot(e2) - mean[1]);
        let r = x * x + y * y;
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xr += x * r;
        yr += y * r;
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= 1e-12 * xx * yy {
        return mean;
    }
    [mean[0] + 0.5 * (yy * xr - xy * yr) / determinant, mean[1] + 0.5 * (xx * yr - xy * xr) / determinant]
}

/// Sheet, tube or ball from the distribution of known normals at some points.
fn shape_from_normals(points: &[DVec3], normals: &[DVec3], variances: [f64; 3]) -> Shape {
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
fn perpendicular_axis(normals: &[DVec3]) -> Option<DVec3> {
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
fn axis_of_open_cylinder(points: &[DVec3]) -> Option<DVec3> {
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

#[cfg(test)]
mod tests;
