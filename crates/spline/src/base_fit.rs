//! Least-squares cylinder, sphere or torus of few points.
//!
//! Input: points and a [`BaseShape`] near them. Output: the shape with the smallest sum of squared distances,
//! by Levenberg's and Marquardt's method with derivatives by differences. Ellipsoids become spheres.
//!
//! Not guaranteed: the global minimum. Gross errors count as any other point.

use crate::base::BaseShape;
use crate::hierarchy::Shape;
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;

/// Iterations; from a start of the right kind ten are enough.
const ITERATIONS: usize = 60;
/// Relative step of the differences: their error is then about 1e-8 of the size.
const DIFFERENCE: f64 = 1e-6;
/// The fit has converged when a step is this share of the size.
const CONVERGED: f64 = 1e-12;

/// Number of parameters of a shape without its extent: plane 3, sphere 4, circular cylinder 5, torus 7.
#[must_use]
pub fn shape_parameters(shape: Shape) -> usize {
    match shape {
        Shape::Sheet => 3,
        Shape::Ball => 4,
        Shape::Tube => 5,
        Shape::Torus => 7,
    }
}

/// The cylinder, sphere or torus with the smallest sum of squared distances from the points, near `start`; a
/// plane is returned as it is.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{BaseShape, fit_base_shape};
///
/// let ball = BaseShape::sphere(DVec3::new(1.0, 2.0, 3.0), 5.0, DVec3::Z);
/// let points: Vec<DVec3> = (0..20)
///     .map(|k| ball.point(f64::from(k * 7 % 20) / 20.0, (f64::from(k) + 0.5) / 40.0))
///     .collect();
/// // Only the lower half was measured, so the start is too small.
/// let start = BaseShape::sphere(DVec3::new(1.0, 2.0, 1.0), 3.0, DVec3::Z);
/// let found = fit_base_shape(&start, &points);
/// assert!(found.centre.distance(ball.centre) < 1e-6 && (found.size[0] - 5.0).abs() < 1e-6);
/// ```
#[must_use]
pub fn fit_base_shape(start: &BaseShape, points: &[DVec3]) -> BaseShape {
    if start.shape == Shape::Sheet || points.len() <= shape_parameters(start.shape) {
        return *start;
    }
    let mut best = *start;
    if best.shape == Shape::Ball {
        best.size = [best.size.iter().sum::<f64>() / 3.0; 3];
    }
    let size = points.iter().map(|p| p.distance(best.centre)).fold(0.0, f64::max);
    let mut residuals = distances(&best, points);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let jacobian = derivatives(&best, points, &residuals, size);
        let gradient = jacobian.tr_mul(&residuals);
        let normal = jacobian.tr_mul(&jacobian);
        let mut damped = normal.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += damping * (normal[(k, k)] + 1e-9 * normal.trace());
        }
        let Some(factor) = damped.cholesky() else { break };
        let step = -factor.solve(&gradient);
        let moved = moved(&best, step.as_slice(), size);
        let trial = distances(&moved, points);
        if trial.norm_squared() < residuals.norm_squared() && moved.size.iter().all(|s| *s > 0.0) {
            (best, residuals) = (moved, trial);
            damping *= 0.2;
            if step.amax() < CONVERGED {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e12 {
                break;
            }
        }
    }
    with_extent(best, points)
}

/// Signed distance of every point from the shape, its ends left out.
fn distances(base: &BaseShape, points: &[DVec3]) -> DVector<f64> {
    DVector::from_iterator(
        points.len(),
        points.iter().map(|p| {
            let [x, y, z] = base.frame.map(|e| e.dot(*p - base.centre));
            match base.shape {
                Shape::Sheet => z,
                Shape::Tube => x.hypot(y) - base.size[0],
                Shape::Ball => x.hypot(y).hypot(z) - base.size[0],
                Shape::Torus => (x.hypot(y) - base.size[0]).hypot(z) - base.size[2],
            }
        }),
    )
}

/// Root mean square distance of the points from the shape, with as many degrees of freedom as its parameters
/// leave.
#[must_use]
pub fn scatter_about(base: &BaseShape, points: &[DVec3]) -> f64 {
    let freedom = points.len().saturating_sub(shape_parameters(base.shape)).max(1);
    (distances(base, points).norm_squared() / freedom as f64).sqrt()
}

fn derivatives(base: &BaseShape, points: &[DVec3], at: &DVector<f64>, size: f64) -> DMatrix<f64> {
    let count = match base.shape {
        Shape::Sheet => 0,
        shape => shape_parameters(shape),
    };
    let mut jacobian = DMatrix::zeros(points.len(), count);
    for k in 0..count {
        let mut step = vec![0.0; count];
        step[k] = DIFFERENCE;
        jacobian.set_column(k, &((distances(&moved(base, &step, size), points) - at) / DIFFERENCE));
    }
    jacobian
}

/// The shape after a step: shifts, turns about the first two axes and changes of radii, all relative to
/// `size`.
fn moved(base: &BaseShape, step: &[f64], size: f64) -> BaseShape {
    let [e1, e2, e3] = base.frame;
    let turned = |a: f64, b: f64| {
        let axis = (e3 + a * e1 + b * e2).normalize();
        let first = (e1 - e1.dot(axis) * axis).normalize();
        [first, axis.cross(first), axis]
    };
    let mut moved = *base;
    match (base.shape, step) {
        (Shape::Ball, [x, y, z, r]) => {
            moved.centre += size * (*x * e1 + *y * e2 + *z * e3);
            moved.size = [base.size[0] + size * r; 3];
        }
        (Shape::Tube, [x, y, a, b, r]) => {
            moved.centre += size * (*x * e1 + *y * e2);
            moved.frame = turned(*a, *b);
            let radius = base.size[0] + size * r;
            moved.size = [radius, radius, base.size[2]];
        }
        (Shape::Torus, [x, y, z, a, b, ring, tube]) => {
            moved.centre += size * (*x * e1 + *y * e2 + *z * e3);
            moved.frame = turned(*a, *b);
            let ring = base.size[0] + size * ring;
            moved.size = [ring, ring, base.size[2] + size * tube];
        }
        // A plane has no step.
        _ => {}
    }
    moved
}

/// A cylinder moved and lengthened along its axis until it encloses the points.
fn with_extent(mut base: BaseShape, points: &[DVec3]) -> BaseShape {
    if base.shape == Shape::Tube {
        let axis = base.frame[2];
        let along = |p: &DVec3| axis.dot(*p - base.centre);
        let (low, high) = points
            .iter()
            .map(along)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
        base.centre += 0.5 * (low + high) * axis;
        // The margin of 0.5 % of other open shapes.
        base.size[2] = 0.505 * (high - low);
    }
    base
}
