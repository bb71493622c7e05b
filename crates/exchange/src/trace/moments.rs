//! Sums over points, from which lines and circles follow without the points.
//!
//! # References
//! Chernov, *Circular and linear regression*, 2010: Taubin's circle by Newton's method (section 5.8).

use planish_contour::planar::circle_of_moments;
use planish_solid::views::{Curve2, distance};

/// Sums of powers of coordinates.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    xz: f64,
    yz: f64,
    zz: f64,
}

/// A line or a circle, and the sum of squared distances of the points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub(super) shape: Shape,
    pub(super) squares: f64,
}

/// An unbounded curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    /// A point of the line and its direction.
    Line([f64; 2], [f64; 2]),
    /// Centre and radius.
    Circle([f64; 2], f64),
}

impl Shape {
    /// Signed distance of a point: to the left of a line, outside of a circle.
    pub(super) fn off(&self, p: [f64; 2]) -> f64 {
        match self {
            Self::Line(at, along) => along[0] * (p[1] - at[1]) - along[1] * (p[0] - at[0]),
            Self::Circle(center, radius) => distance(p, *center) - radius,
        }
    }

    /// Direction in which the distance grows.
    pub(super) fn normal(&self, p: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Line(_, along) => [-along[1], along[0]],
            Self::Circle(center, _) => {
                let length = distance(p, *center).max(1e-9);
                [(p[0] - center[0]) / length, (p[1] - center[1]) / length]
            }
        }
    }

    /// The nearest point.
    pub(super) fn nearest(&self, p: [f64; 2]) -> [f64; 2] {
        let (off, normal) = (self.off(p), self.normal(p));
        [p[0] - off * normal[0], p[1] - off * normal[1]]
    }

    /// The part of the curve from one place past another one to a third.
    pub(super) fn between(&self, from: [f64; 2], by: [f64; 2], to: [f64; 2]) -> Curve2 {
        match self {
            Self::Line(..) => Curve2::Segment(from, to),
            Self::Circle(center, radius) => {
                let angle = |p: [f64; 2]| (p[1] - center[1]).atan2(p[0] - center[0]);
                let turn = |a: f64, b: f64| (b - a).rem_euclid(std::f64::consts::TAU);
                let (a, m, b) = (angle(from), angle(by), angle(to));
                let (start, sweep) = match turn(a, m) <= turn(a, b) {
                    true => (a, turn(a, b)),
                    false => (b, turn(b, a)),
                };
                Curve2::Arc { center: *center, radius: *radius, start, sweep }
            }
        }
    }
}

impl Moments {
    pub(super) fn add(&mut self, [x, y]: [f64; 2]) {
        let z = x * x + y * y;
        *self = self.plus(&Self {
            n: 1.0,
            x,
            y,
            xx: x * x,
            xy: x * y,
            yy: y * y,
            xz: x * z,
            yz: y * z,
            zz: z * z,
        });
    }

    fn combined(&self, o: &Self, s: f64) -> Self {
        Self {
            n: self.n + s * o.n,
            x: self.x + s * o.x,
            y: self.y + s * o.y,
            xx: self.xx + s * o.xx,
            xy: self.xy + s * o.xy,
            yy: self.yy + s * o.yy,
            xz: self.xz + s * o.xz,
            yz: self.yz + s * o.yz,
            zz: self.zz + s * o.zz,
        }
    }

    pub(super) fn plus(&self, other: &Self) -> Self {
        self.combined(other, 1.0)
    }

    pub(super) fn minus(&self, other: &Self) -> Self {
        self.combined(other, -1.0)
    }

    /// Mean, and second moments about it per point.
    fn centred(&self) -> ([f64; 2], [f64; 3]) {
        let mean = [self.x / self.n, self.y / self.n];
        let xx = self.xx / self.n - mean[0] * mean[0];
        let xy = self.xy / self.n - mean[0] * mean[1];
        let yy = self.yy / self.n - mean[1] * mean[1];
        (mean, [xx.max(0.0), xy, yy.max(0.0)])
    }

    /// The line with the smallest sum of squared distances.
    pub(super) fn line(&self) -> Option<Fit> {
        if self.n < 2.0 {
            return None;
        }
        let (mean, [xx, xy, yy]) = self.centred();
        let half = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (sin, cos) = half.sin_cos();
        let across = sin * sin * xx - 2.0 * sin * cos * xy + cos * cos * yy;
        Some(Fit { shape: Shape::Line(mean, [cos, sin]), squares: self.n * across.max(0.0) })
    }

    /// Taubin's circle.
    pub(super) fn circle(&self) -> Option<Fit> {
        if self.n < 4.0 {
            return None;
        }
        let n = self.n;
        let ([cx, cy], [mxx, mxy, myy]) = self.centred();
        let (z, cc) = (self.xx + self.yy, cx * cx + cy * cy);
        let xz = self.xz - 2.0 * cx * self.xx - 2.0 * cy * self.xy + cc * self.x;
        let mxz = (xz - cx * (z - 2.0 * cx * self.x - 2.0 * cy * self.y + cc * n)) / n;
        let yz = self.yz - 2.0 * cx * self.xy - 2.0 * cy * self.yy + cc * self.y;
        let myz = (yz - cy * (z - 2.0 * cx * self.x - 2.0 * cy * self.y + cc * n)) / n;
        let zz = self.zz + 4.0 * cx * cx * self.xx + 4.0 * cy * cy * self.yy + cc * cc * n
            - 4.0 * cx * self.xz
            - 4.0 * cy * self.yz
            + 2.0 * cc * z
            + 8.0 * cx * cy * self.xy
            - 4.0 * cc * (cx * self.x + cy * self.y);
        let mzz = zz / n;
        let mz = mxx + myy;
        let ([a, b], radius) = circle_of_moments([mxx, mxy, myy, mxz, myz, mzz])?;
        if !(0.5..1e5).contains(&radius) {
            return None;
        }
        let sum = mzz + 4.0 * a * a * mxx + 4.0 * b * b * myy + mz * mz
            - 4.0 * a * mxz
            - 4.0 * b * myz
            - 2.0 * mz * mz
            + 8.0 * a * b * mxy;
        let squares = n * sum.max(0.0) / (4.0 * radius * radius);
        Some(Fit { shape: Shape::Circle([a + cx, b + cy], radius), squares })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circle_of_a_short_arc_is_found_with_its_residuals() {
        // 0.05 px of noise along the radius, alternating.
        let mut moments = Moments::default();
        for k in 0..60 {
            let (angle, radius) = (1.0 + 0.02 * f64::from(k), 80.0 + if k % 2 == 0 { 0.05 } else { -0.05 });
            moments.add([300.0 + radius * angle.cos(), 200.0 + radius * angle.sin()]);
        }
        let fit = moments.circle().unwrap();
        let Shape::Circle(center, radius) = fit.shape else { panic!() };
        assert!((center[0] - 300.0).abs() < 0.3 && (radius - 80.0).abs() < 0.3, "{fit:?}");
        assert!((fit.squares / 60.0 - 0.0025).abs() < 3e-4, "{fit:?}");
        assert!(moments.line().unwrap().squares > 60.0);
    }
}
