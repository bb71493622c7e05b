//! Base shapes: plane, cylinder, sphere or torus as the initial surface.
//!
//! Input: a [`BaseShape`] with its frame. Output: a [`Surface`], or the parameters of a point. u runs
//! around the axis and v along it (on a ball from the south pole upwards). Normals point outwards.

use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::Surface;
use planish_core::DVec3;
use planish_core::vector3::tangents;
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
    if space.shape() == Some(Shape::Ball) {
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
    surface.leaf_point(leaf, s + (if space.periodic_u() { 0.0 } else { u - u0 }) / side, t + (v - v0) / side)
}

#[cfg(test)]
mod tests;
