//! Least-squares planes, spheres and cylinders, and classification of a patch of surface.
//!
//! Input: readings around a gap, with variances. Output: the most likely shape, its covariance, and the
//! alternatives; `None` if no shape fits.
//!
//! Residuals are distances along the normal. Among shapes that pass their χ² test, the one with the minimum
//! `BIC = χ² + p ln n` is chosen. The others have weight `exp(−BIC/2)`; the spread of their predictions is
//! part of the variance.
//!
//! Not guaranteed: that the surface inside a gap continues the surrounding shape.
//!
//! # References
//! Schwarz, *Estimating the dimension of a model*, Annals of Statistics 6 (1978), for the BIC.

use nalgebra::{Matrix3, Matrix4, SMatrix, SVector, Vector3, Vector4};
use planish_core::vector3::tangents;
use planish_core::{DVec3, SymmetricMatrix3};

/// Maximum number of parameters: a cylinder has five.
const MAX_PARAMETERS: usize = 5;
/// Minimum number of readings for a classification.
const MIN_READINGS: usize = 24;
/// Maximum number of Gauss–Newton steps.
const STEPS: usize = 25;
/// Maximum excess of the reduced χ² over 1, in standard deviations, for a shape to be accepted.
const MAX_EXCESS: f64 = 3.0;
/// Maximum radius relative to the size of the patch. A larger one cannot be distinguished from a plane.
const MAX_RELATIVE_RADIUS: f64 = 100.0;

/// A simple shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Primitive {
    /// A plane.
    Plane {
        /// A point of the plane.
        point: DVec3,
        /// Its unit normal.
        normal: DVec3,
    },
    /// A sphere.
    Sphere {
        /// Its centre.
        centre: DVec3,
        /// Its radius.
        radius: f64,
    },
    /// A cylinder.
    Cylinder {
        /// A point of the axis.
        point: DVec3,
        /// Its unit direction.
        direction: DVec3,
        /// Its radius.
        radius: f64,
    },
}

/// A shape with its covariance.
#[derive(Debug, Clone)]
pub struct FittedPrimitive {
    /// The shape.
    pub primitive: Primitive,
    covariance: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    /// Residual χ², and its degrees of freedom.
    pub chi_square: f64,
    /// See `chi_square`.
    pub degrees: f64,
    /// `χ² + p ln n`.
    pub bic: f64,
}

/// Classification of a patch, with alternatives.
#[derive(Debug, Clone)]
pub struct Classification {
    /// The accepted shapes, the most likely first.
    pub candidates: Vec<FittedPrimitive>,
    /// Their probabilities, given that one of them is true.
    pub probabilities: Vec<f64>,
    /// Variance of the deviation of the readings from the first shape beyond their noise; at least the
    /// smallest that could be detected.
    pub model_variance: f64,
}

/// Prediction of a surface point by a classified patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// The point of the most likely shape.
    pub point: DVec3,
    /// Its unit normal there.
    pub normal: DVec3,
    /// Variance along the normal, from the parameters, the classification, and the deviation from the shape.
    pub variance: f64,
}

impl Primitive {
    /// The name in reports.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Plane { .. } => "plane",
            Self::Sphere { .. } => "sphere",
            Self::Cylinder { .. } => "cylinder",
        }
    }

    /// Number of parameters.
    #[must_use]
    pub fn parameters(&self) -> usize {
        match self {
            Self::Plane { .. } => 3,
            Self::Sphere { .. } => 4,
            Self::Cylinder { .. } => 5,
        }
    }

    /// The radius, if it has one.
    #[must_use]
    pub fn radius(&self) -> Option<f64> {
        match *self {
            Self::Plane { .. } => None,
            Self::Sphere { radius, .. } | Self::Cylinder { radius, .. } => Some(radius),
        }
    }

    /// Distance of a point, its gradient, and the derivatives with respect to the parameters.
    fn distance(&self, p: DVec3) -> (f64, DVec3, SVector<f64, MAX_PARAMETERS>) {
        match *self {
            Self::Plane { point, normal } => {
                let (e1, e2) = tangents(normal);
                let r = p - point;
                let row = [-1.0, r.dot(e1), r.dot(e2), 0.0, 0.0];
                (r.dot(normal), normal, row.into())
            }
            Self::Sphere { centre, radius } => {
                let r = p - centre;
                // At the centre every direction is correct.
                let u = r.try_normalize().unwrap_or(DVec3::Z);
                (r.length() - radius, u, [-u[0], -u[1], -u[2], -1.0, 0.0].into())
            }
            Self::Cylinder { point, direction, radius } => {
                let (e1, e2) = tangents(direction);
                let w = p - point;
                let along = w.dot(direction);
                let r = w - along * direction;
                let u = r.try_normalize().unwrap_or(e1);
                let (a, b) = (u.dot(e1), u.dot(e2));
                (r.length() - radius, u, [-a, -b, -along * a, -along * b, -1.0].into())
            }
        }
    }

    fn moved(&self, by: &SVector<f64, MAX_PARAMETERS>) -> Self {
        let tilted = |d: DVec3, a: f64, b: f64| {
            let (e1, e2) = tangents(d);
            (d + a * e1 + b * e2).try_normalize().unwrap_or(d)
        };
        match *self {
            Self::Plane { point, normal } => Self::Plane {
                point: point + by[0] * normal,
                // Sign: a tilt of the normal increases the distance of points on that side.
                normal: tilted(normal, by[1], by[2]),
            },
            Self::Sphere { centre, radius } => {
                Self::Sphere { centre: centre + DVec3::new(by[0], by[1], by[2]), radius: radius + by[3] }
            }
            Self::Cylinder { point, direction, radius } => {
                let (e1, e2) = tangents(direction);
                Self::Cylinder {
                    point: point + by[0] * e1 + by[1] * e2,
                    direction: tilted(direction, by[2], by[3]),
                    radius: radius + by[4],
                }
            }
        }
    }
}

impl FittedPrimitive {
    /// Gauss–Newton from a start; `None` if the readings do not determine the shape.
    fn from_start(start: Primitive, points: &[DVec3], variance: &[f64], size: f64) -> Option<Self> {
        let mut primitive = start;
        let p = start.parameters();
        let normal_equations = |primitive: &Primitive| {
            let mut matrix = SMatrix::<f64, MAX_PARAMETERS, MAX_PARAMETERS>::zeros();
            let mut right = SVector::<f64, MAX_PARAMETERS>::zeros();
            let mut chi_square = 0.0;
            for (z, v) in points.iter().zip(variance) {
                let (d, _, row) = primitive.distance(*z);
                matrix += row * row.transpose() / *v;
                right -= row * (d / v);
                chi_square += d * d / v;
            }
            // Unused parameters get a unit diagonal, so that one matrix size serves all shapes.
            for k in p..MAX_PARAMETERS {
                matrix[(k, k)] = 1.0;
            }
            (matrix, right, chi_square)
        };
        for _ in 0..STEPS {
            let (matrix, right, before) = normal_equations(&primitive);
            let by = matrix.cholesky()?.solve(&right);
            let mut share = 1.0;
            let mut next = primitive.moved(&by);
            // Distances to a curved shape are not linear, so a full step from an algebraic start can
            // overshoot.
            while share > 1e-3 && normal_equations(&next).2 > before * (1.0 + 1e-12) {
                share *= 0.5;
                next = primitive.moved(&(by * share));
            }
            primitive = next;
            if primitive.radius().is_some_and(|r| !(r > 0.0 && r < MAX_RELATIVE_RADIUS * size)) {
                return None;
            }
            // The expected decrease of χ², far below its own scatter.
            if (by.transpose() * right)[(0, 0)] < 1e-6 {
                break;
            }
        }
        let (matrix, _, chi_square) = normal_equations(&primitive);
        let mut covariance = matrix.cholesky()?.inverse();
        for k in p..MAX_PARAMETERS {
            covariance[(k, k)] = 0.0;
        }
        let n = points.len() as f64;
        Some(Self {
            primitive,
            covariance,
            chi_square,
            degrees: n - p as f64,
            // A sphere or cylinder of large radius fits a plane as well; the information criterion prefers
            // the shape with fewer parameters.
            bic: chi_square + p as f64 * n.ln(),
        })
    }

    /// True if the residuals are consistent with the noise of the readings.
    fn passes(&self) -> bool {
        self.chi_square <= self.degrees + MAX_EXCESS * (2.0 * self.degrees).sqrt()
    }

    /// σ of the parameters: of a plane its shift and tilts, of a sphere centre and radius, of a cylinder
    /// shifts and tilts of the axis and radius.
    #[must_use]
    pub fn sigmas(&self) -> Vec<f64> {
        (0..self.primitive.parameters()).map(|k| self.covariance[(k, k)].max(0.0).sqrt()).collect()
    }
}

/// Classifies readings by shape; `None` if there are too few or no shape fits.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{Primitive, classify};
///
/// // A ring of readings around a hole in a plane.
/// let points: Vec<DVec3> = (0..60)
///     .map(|k| (f64::from(k) * 0.1 * std::f64::consts::PI, 1.0 + 0.1 * f64::from(k % 5)))
///     .map(|(angle, radius)| DVec3::new(radius * angle.cos(), radius * angle.sin(), 0.0))
///     .collect();
/// let normals = vec![DVec3::Z; points.len()];
/// let found = classify(&points, &normals, &vec![1e-4; points.len()]).expect("a simple shape");
/// assert!(matches!(found.best().primitive, Primitive::Plane { .. }));
/// let prediction = found.predict(0.1 * DVec3::Z, DVec3::Z);
/// assert!(prediction.point[2].abs() < 1e-6);
/// ```
#[must_use]
pub fn classify(points: &[DVec3], normals: &[DVec3], variance: &[f64]) -> Option<Classification> {
    if points.len() < MIN_READINGS {
        return None;
    }
    let middle = mean(points);
    let size = points.iter().map(|p| (*p - middle).length()).fold(0.0, f64::max);
    let mut candidates: Vec<FittedPrimitive> = starts(points, normals, middle)
        .into_iter()
        .filter_map(|start| FittedPrimitive::from_start(start, points, variance, size))
        .filter(FittedPrimitive::passes)
        .collect();
    candidates.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    // Several starts may converge to the same shape.
    let mut kinds = Vec::new();
    candidates.retain(|c| {
        let new = !kinds.contains(&c.primitive.name());
        kinds.push(c.primitive.name());
        new
    });
    let best = candidates.first()?;
    let weights: Vec<f64> = candidates.iter().map(|c| (-0.5 * (c.bic - best.bic)).exp()).collect();
    let total: f64 = weights.iter().sum();
    // A deviation smaller than one standard deviation of the reduced χ² cannot be detected, so it remains
    // possible.
    let typical = variance.iter().sum::<f64>() / variance.len() as f64;
    let excess = (best.chi_square / best.degrees - 1.0).max(0.0);
    let model_variance = typical * (excess + (2.0 / best.degrees).sqrt());
    Some(Classification {
        probabilities: weights.into_iter().map(|w| w / total).collect(),
        candidates,
        model_variance,
    })
}

impl Classification {
    /// The most likely shape.
    #[must_use]
    pub fn best(&self) -> &FittedPrimitive {
        &self.candidates[0]
    }

    /// Predicts the surface near a point, given an approximate normal.
    #[must_use]
    pub fn predict(&self, place: DVec3, facing: DVec3) -> Prediction {
        let best = self.best();
        let (d, away, _) = best.primitive.distance(place);
        let point = place - d * away;
        let (_, _, row) = best.primitive.distance(point);
        let of_place = (row.transpose() * best.covariance * row)[(0, 0)];
        // The scatter between candidate shapes, weighted by their probabilities: far from the readings it
        // dominates.
        let of_kind: f64 = (self.candidates.iter().zip(&self.probabilities))
            .map(|(other, p)| p * other.primitive.distance(point).0.powi(2))
            .sum();
        Prediction {
            point,
            normal: if away.dot(facing) < 0.0 { -away } else { away },
            variance: of_place + of_kind + self.model_variance,
        }
    }
}

fn mean(points: &[DVec3]) -> DVec3 {
    1.0 / points.len() as f64 * points.iter().sum::<DVec3>()
}

/// Initial values: the least-squares plane, the algebraic sphere, and cylinders along directions
/// perpendicular to most normals.
fn starts(points: &[DVec3], normals: &[DVec3], middle: DVec3) -> Vec<Primitive> {
    let moments = |vectors: &[DVec3], centre: DVec3| {
        SymmetricMatrix3::from_entries(|i, j| {
            vectors.iter().map(|p| (p[i] - centre[i]) * (p[j] - centre[j])).sum()
        })
    };
    let (axes, _) = moments(points, middle).eigen();
    let mut all = vec![Primitive::Plane { point: middle, normal: axes[2] }];
    all.extend(algebraic_sphere(points, middle));
    let (of_normals, _) = moments(normals, DVec3::ZERO).eigen();
    let directions = [of_normals[2], of_normals[1], axes[0], axes[1]];
    // Normals of a cylinder are perpendicular to its axis, so the axis has the smallest moment of the
    // normals. The other directions serve noisy normals and short cylinders.
    all.extend(directions.into_iter().filter_map(|d| algebraic_cylinder(points, middle, d)));
    all
}

/// `|p|² = 2 c·p + k`, linear in `c` and `k`.
fn algebraic_sphere(points: &[DVec3], middle: DVec3) -> Option<Primitive> {
    let (mut matrix, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for p in points {
        // Relative to the middle: fourth powers of large coordinates would cancel.
        let r = *p - middle;
        let row = Vector4::new(2.0 * r[0], 2.0 * r[1], 2.0 * r[2], 1.0);
        matrix += row * row.transpose();
        right += row * r.length_squared();
    }
    let x = matrix.cholesky()?.solve(&right);
    let centre = DVec3::new(x[0], x[1], x[2]);
    let square = x[3] + centre.length_squared();
    (square > 0.0).then(|| Primitive::Sphere { centre: middle + centre, radius: square.sqrt() })
}

/// The algebraic fit of a circle in the projection along a direction.
fn algebraic_cylinder(points: &[DVec3], middle: DVec3, direction: DVec3) -> Option<Primitive> {
    let (e1, e2) = tangents(direction);
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let r = *p - middle;
        let (x, y) = (r.dot(e1), r.dot(e2));
        let row = Vector3::new(2.0 * x, 2.0 * y, 1.0);
        matrix += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let x = matrix.cholesky()?.solve(&right);
    let square = x[2] + x[0] * x[0] + x[1] * x[1];
    (square > 0.0).then(|| Primitive::Cylinder {
        point: middle + x[0] * e1 + x[1] * e2,
        direction,
        radius: square.sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    const SIGMA: f64 = 0.02;

    /// Readings of a surface around a gap: where `1 < |(x, y)| < 2` of its own parameters.
    fn ring(seed: u64, surface: impl Fn(f64, f64) -> (DVec3, DVec3)) -> (Vec<DVec3>, Vec<DVec3>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        while points.len() < 800 {
            let [x, y] = [0; 2].map(|_| 4.0 * rng.random::<f64>() - 2.0);
            if !(1.0..2.0).contains(&x.hypot(y)) {
                continue;
            }
            let (p, n) = surface(x, y);
            points.push(p + SIGMA * rng.sample::<f64, _>(StandardNormal) * n);
            normals.push(n);
        }
        (points, normals)
    }

    fn ball(x: f64, y: f64) -> (DVec3, DVec3) {
        let n = DVec3::new(x, y, 3.0).try_normalize().unwrap();
        (DVec3::new(5.0, 1.0, 0.0) + 4.0 * n, n)
    }

    fn pipe(x: f64, y: f64) -> (DVec3, DVec3) {
        let (sin, cos) = (x / 3.0).sin_cos();
        (DVec3::new(3.0 * sin, y + 0.1, 3.0 * cos), DVec3::new(sin, 0.0, cos))
    }

    fn table(x: f64, y: f64) -> (DVec3, DVec3) {
        let n = DVec3::new(0.2, -0.1, 1.0).try_normalize().unwrap();
        let (e1, e2) = tangents(n);
        (DVec3::new(1.0, 2.0, 3.0) + x * e1 + y * e2, n)
    }

    #[test]
    fn plane_sphere_and_cylinder_are_distinguished_and_predict_the_gap_within_their_sigma() {
        type Surface = fn(f64, f64) -> (DVec3, DVec3);
        for (name, surface) in [("sphere", ball as Surface), ("cylinder", pipe), ("plane", table)] {
            let mut squares = 0.0;
            let runs = 40;
            for seed in 0..runs {
                let (points, normals) = ring(seed, surface);
                let found = classify(&points, &normals, &vec![SIGMA * SIGMA; points.len()]).unwrap();
                assert_eq!(found.best().primitive.name(), name);
                let (p, n) = surface(0.1, -0.2);
                let predicted = found.predict(p, n);
                // These shapes are exact, so `model_variance` is not part of their error.
                let variance = predicted.variance - found.model_variance;
                squares += (p - predicted.point).dot(n).powi(2) / variance / runs as f64;
                assert!(predicted.normal.dot(n) > 0.999);
            }
            // The mean of forty squares: 1 ± 0.22.
            assert!((0.45..1.7).contains(&squares), "{name}: {squares}");
        }
    }

    #[test]
    fn a_freeform_surface_is_not_classified() {
        let with_waves = |x: f64, y: f64| {
            let z = 0.2 * (2.0 * x).sin() * (1.5 * y).cos();
            (DVec3::new(x, y, z), DVec3::Z)
        };
        let (points, normals) = ring(3, with_waves);
        assert!(classify(&points, &normals, &vec![SIGMA * SIGMA; points.len()]).is_none());
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let d = DVec3::new(0.3, -0.5, 0.8).try_normalize().unwrap();
        let point = DVec3::new(0.4, 0.1, -0.2);
        let shapes = [
            Primitive::Plane { point, normal: d },
            Primitive::Sphere { centre: point, radius: 0.7 },
            Primitive::Cylinder { point, direction: d, radius: 0.6 },
        ];
        for shape in shapes {
            let z = DVec3::new(1.0, -0.6, 0.9);
            let (_, _, row) = shape.distance(z);
            for k in 0..shape.parameters() {
                let step = |h: f64| {
                    let mut by = SVector::zeros();
                    by[k] = h;
                    shape.moved(&by).distance(z).0
                };
                let h = 1e-6;
                assert!(((step(h) - step(-h)) / (2.0 * h) - row[k]).abs() < 1e-8, "{} {k}", shape.name());
            }
        }
    }
}
