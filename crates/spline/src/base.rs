//! Base shapes: plane, cylinder, sphere or torus as the initial surface.
//!
//! Input: points, optionally with normals. Output: a [`BaseShape`] with its frame, and from it a [`Surface`]
//! or the parameters of a point. u runs around the axis and v along it (on a ball from the south pole
//! upwards). Normals point outwards.
//!
//! Not guaranteed: a suitable choice for shapes unlike any of the four. Callers let users override it.

use crate::hierarchy::{Hierarchy, Shape};
use crate::shape_choice::{axis_of_open_cylinder, perpendicular_axis, shape_from_normals};
use crate::surface::Surface;
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// A simple surface with natural parameters (u, v).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaseShape {
    /// The topology.
    pub shape: Shape,
    /// Centre of the plane or sphere, midpoint of the axis.
    pub centre: DVec3,
    /// Right-handed orthonormal frame. Sheet: u, v and normal; others: the third is the axis.
    pub frame: [DVec3; 3],
    /// Half extents along the frame: sheet `[half u, half v, 0]`; tube `[radius, radius, half length]`; ball
    /// `[radii]`; torus `[ring radius, ring radius, tube radius]`.
    pub size: [f64; 3],
}

impl BaseShape {
    /// A rectangle with the given centre, unit directions of u and v, and half sides.
    #[must_use]
    pub fn plane(centre: DVec3, directions: [DVec3; 2], half: [f64; 2]) -> Self {
        let frame = [directions[0], directions[1], directions[0].cross(directions[1])];
        Self { shape: Shape::Sheet, centre, frame, size: [half[0], half[1], 0.0] }
    }

    /// A sphere with its poles on the axis.
    #[must_use]
    pub fn sphere(centre: DVec3, radius: f64, axis: DVec3) -> Self {
        let (e1, e2) = tangents(axis);
        Self { shape: Shape::Ball, centre, frame: [e1, e2, axis], size: [radius; 3] }
    }

    /// A cylinder about an axis.
    #[must_use]
    pub fn cylinder(centre: DVec3, axis: DVec3, radius: f64, half_length: f64) -> Self {
        let (e1, e2) = tangents(axis);
        Self { shape: Shape::Tube, centre, frame: [e1, e2, axis], size: [radius, radius, half_length] }
    }

    /// A torus about an axis.
    #[must_use]
    pub fn torus(centre: DVec3, axis: DVec3, ring_radius: f64, tube_radius: f64) -> Self {
        let (e1, e2) = tangents(axis);
        Self {
            shape: Shape::Torus,
            centre,
            frame: [e1, e2, axis],
            size: [ring_radius, ring_radius, tube_radius],
        }
    }

    /// The point at `(u, v)` in `[0, 1]²`.
    #[must_use]
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        let [e1, e2, e3] = self.frame;
        let (sin, cos) = (TAU * u).sin_cos();
        // All four shapes in their own frame; the frame is applied once below.
        let local = match self.shape {
            Shape::Sheet => [(2.0 * u - 1.0) * self.size[0], (2.0 * v - 1.0) * self.size[1], 0.0],
            Shape::Tube => [self.size[0] * cos, self.size[1] * sin, (2.0 * v - 1.0) * self.size[2]],
            Shape::Ball => {
                let (s, c) = (PI * v).sin_cos();
                [self.size[0] * s * cos, self.size[1] * s * sin, -self.size[2] * c]
            }
            Shape::Torus => {
                let (s, c) = (TAU * v).sin_cos();
                let r = self.size[0] + self.size[2] * c;
                [r * cos, r * sin, self.size[2] * s]
            }
        };
        let mut p = self.centre;
        for (e, x) in [e1, e2, e3].into_iter().zip(local) {
            p += x * e;
        }
        p
    }

    /// Parameters `(u, v)` of the base point below a point, from its direction from the axis or centre.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// let ball = BaseShape::sphere(DVec3::ZERO, 2.0, DVec3::Z);
    /// let [_, v] = ball.parameters(5.0 * DVec3::Z);
    /// assert_eq!(v, 1.0); // above the north pole
    /// ```
    #[must_use]
    pub fn parameters(&self, p: DVec3) -> [f64; 2] {
        let d = p - self.centre;
        let [x, y, z] = self.frame.map(|e| e.dot(d));
        let around = (y / self.size[1]).atan2(x / self.size[0]).rem_euclid(TAU) / TAU;
        match self.shape {
            Shape::Sheet => [0.5 + 0.5 * x / self.size[0], 0.5 + 0.5 * y / self.size[1]],
            Shape::Tube => [around, 0.5 + 0.5 * z / self.size[2]],
            Shape::Ball => {
                let r = (x / self.size[0]).hypot(y / self.size[1]);
                [around, r.atan2(-z / self.size[2]) / PI]
            }
            Shape::Torus => [around, z.atan2(x.hypot(y) - self.size[0]).rem_euclid(TAU) / TAU],
        }
    }

    /// A base grid with nearly square cells, about `cells` in total.
    #[must_use]
    pub fn grid(&self, cells: usize) -> [usize; 2] {
        let lengths = match self.shape {
            Shape::Sheet => [2.0 * self.size[0], 2.0 * self.size[1]],
            Shape::Tube => [TAU * self.size[0], 2.0 * self.size[2]],
            // Meridians of an elongated ball are longer than half its equator.
            Shape::Ball => [
                PI * (self.size[0] + self.size[1]),
                0.5 * PI * (self.size[2] + 0.5 * (self.size[0] + self.size[1])),
            ],
            Shape::Torus => [TAU * self.size[0], TAU * self.size[2]],
        };
        let side = (lengths[0] * lengths[1] / cells as f64).sqrt();
        let round = |length: f64, minimum: usize| {
            ((length / side).round() as usize).clamp(minimum, cells.max(minimum))
        };
        match self.shape {
            Shape::Sheet => [round(lengths[0], 2), round(lengths[1], 2)],
            Shape::Tube => [round(lengths[0], 6), round(lengths[1], 2)],
            // The splines of cosine and sine around a pole need at least eight columns.
            Shape::Ball => [round(lengths[0], 8) & !1, round(lengths[1], 4)],
            Shape::Torus => [round(lengths[0], 6), round(lengths[1], 6)],
        }
    }

    /// A spline surface over a base grid that approximates this shape.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::BaseShape;
    ///
    /// let shape = BaseShape::cylinder(DVec3::ZERO, DVec3::Z, 1.0, 2.0);
    /// let tube = shape.surface(shape.grid(200))?;
    /// let p = tube.point(3.0, 2.0);
    /// assert!((p[0].hypot(p[1]) - 1.0).abs() < 1e-3);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    ///
    /// # Errors
    /// As for [`Hierarchy::uniform`].
    pub fn surface(&self, grid: [usize; 2]) -> Result<Surface> {
        let space = Arc::new(Hierarchy::uniform(self.shape, grid)?);
        fit_function(&space, |u, v| self.point(u / grid[0] as f64, v / grid[1] as f64))
    }
}

/// The surface of a uniform space that interpolates a smooth function of `(u, v)` at its anchors.
///
/// `f` takes base-grid units and must be defined one cell past open borders and poles. The collocation
/// equations at the anchors are solved by Richardson iteration `c ← c + f(ξ) − S(ξ)`, which converges because
/// their matrix (1/6, 4/6, 1/6 in each direction) has its spectrum in (0, 1]. A ball is first interpolated as
/// a tube; its poles are then the nearest polar surface.
///
/// # Errors
/// `Undetermined` when a value is not finite.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{Hierarchy, Shape, fit_function};
///
/// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?.into();
/// let surface = fit_function(&space, |u, v| DVec3::new(u, v, u * v))?;
/// assert!((surface.point(1.5, 2.5)[2] - 3.75).abs() < 1e-9);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn fit_function(space: &Arc<Hierarchy>, f: impl Fn(f64, f64) -> DVec3) -> Result<Surface> {
    if space.shape() == Shape::Ball {
        // The three anchors of a pole are one point, so collocation on the ball itself is singular.
        let tube = fit_function(&Arc::new(Hierarchy::uniform(Shape::Tube, space.base())?), f)?;
        let vertices = space.vertices_from(|cell| tube.cell_coefficients(cell).unwrap_or([DVec3::ZERO; 16]));
        return Surface::new(Arc::clone(space), vertices);
    }
    let anchors = space.node_anchors();
    let target: Vec<DVec3> = anchors.iter().map(|a| f(a[0], a[1])).collect();
    if target.iter().any(|p| !p.is_finite()) {
        return Err(Error::undetermined("expected a function with finite values"));
    }
    let mut surface = Surface::new(Arc::clone(space), target.clone())?;
    for _ in 0..80 {
        let mut largest = 0.0_f64;
        let vertices = (0..anchors.len())
            .map(|n| {
                let correction = target[n] - extrapolate(&surface, anchors[n]);
                largest = largest.max(correction.length());
                surface.vertices()[n] + correction
            })
            .collect();
        surface = Surface::new(Arc::clone(space), vertices)?;
        // Corrections at the level of rounding cannot get smaller.
        if largest < 1e-15 * target[0].length().max(1e-300) {
            break;
        }
    }
    Ok(surface)
}

/// The surface at any parameters, continued beyond an open border by its polynomial.
fn extrapolate(surface: &Surface, [u, v]: [f64; 2]) -> DVec3 {
    let space = surface.space();
    let [u0, v0] = space.wrap(u, v);
    let (leaf, [s, t]) = space.locate(u0, v0);
    let side = space.leaves()[leaf].side();
    surface.leaf_point(
        leaf,
        s + (if space.shape().periodic_u() { 0.0 } else { u - u0 }) / side,
        t + (v - v0) / side,
    )
}

/// Ratio of the variances of a cloud below which it counts as round.
const NEARLY_ROUND: f64 = 1.3;
/// Radius about the axis of a torus that is empty, as a share of the largest; smallest number and share of
/// points within it that contradict a torus. A ball has 0.5 % there, a torus of radii 4 : 3 none.
const HOLE_OF_TORUS: f64 = 0.1;
const MIN_AT_AXIS: usize = 3;
const MAX_AT_AXIS: f64 = 0.002;

/// Chooses and fits a base shape to points with optional outward unit normals.
///
/// If all normals face one side, the cloud is a sheet. If they are nearly perpendicular to an axis and
/// surround it, and neither end narrows to a tip, it is a tube. Otherwise it is a ball. `wanted` overrides
/// the choice. The shape encloses all points.
///
/// # Errors
/// `Undetermined` for fewer than 4 points, coincident or collinear points, and coplanar points if `wanted` is
/// not a sheet.
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
    let mut shape = wanted.unwrap_or_else(|| shape_from_normals(&at, &known, variances));
    let mut axis_of_tube = None;
    if wanted.is_none() && shape == Shape::Ball {
        axis_of_tube = axis_of_open_cylinder(points);
        shape = if axis_of_tube.is_some() { Shape::Tube } else { Shape::Ball };
    }
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
            let centre = (0..3).fold(DVec3::ZERO, |c, d| {
                let (lo, hi) = bounds3(points, axes);
                c + 0.5 * (lo[d] + hi[d]) * axes[d]
            });
            let from_axis = |p: &DVec3| {
                let d = *p - centre;
                (d - d.dot(axis) * axis).length()
            };
            let at_axis = |far: f64| points.iter().filter(|p| from_axis(p) < HOLE_OF_TORUS * far).count();
            let (near, far) =
                points.iter().map(from_axis).fold((f64::MAX, 0.0_f64), |(a, b), r| (a.min(r), b.max(r)));
            let filled = at_axis(far);
            if filled >= MIN_AT_AXIS && filled as f64 > MAX_AT_AXIS * points.len() as f64 {
                return Err(Error::undetermined(format!(
                    "expected points of a torus, whose hole is empty, found {filled} of {} near the axis: the \
                     object has another shape",
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
pub(crate) fn circle_centre(points: &[DVec3], e1: DVec3, e2: DVec3) -> [f64; 2] {
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

#[cfg(test)]
mod tests;
