//! A reading in space as an implicit equation `g(z − v, x) = 0`.

use super::shape::{Chart, PrimitiveKind, distance, overshoot, within};
use nalgebra::{Matrix3, Vector3};
use planish_core::DVec3;
use planish_estimate::implicit::{ImplicitReading, MAX_STATE};

/// The measured values of a reading in space with their σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RayTarget {
    /// A range from an uncertain pose; the point is `origin + range (cos e cos a, cos e sin a, sin e)`.
    Range {
        /// Measured position of the sensor.
        origin: DVec3,
        /// Measured direction of the ray: azimuth `a` (counter-clockwise from +x about +z) and elevation `e`.
        direction_rad: [f64; 2],
        /// Measured distance along the ray.
        range: f64,
        /// σ of `x`, `y`, `z`, azimuth and elevation (radians), and the range.
        sigma: [f64; 6],
    },
    /// A point.
    Point {
        /// Measured coordinates.
        position: DVec3,
        /// σ of each coordinate.
        sigma: f64,
    },
}

/// A reading in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// The measured values.
    pub target: RayTarget,
    /// Line in the file of origin, or index of the reading.
    pub line: usize,
}

impl Ray {
    /// The measured point, without any correction.
    #[must_use]
    pub fn point(&self) -> DVec3 {
        self.place(&[0.0; 6]).0.into()
    }

    /// Number of measured values.
    fn noises(&self) -> usize {
        match self.target {
            RayTarget::Range { .. } => 6,
            RayTarget::Point { .. } => 3,
        }
    }

    /// The point corrected by the whitened noise `u`, and its derivatives by `u`.
    fn place(&self, u: &[f64]) -> (Vector3<f64>, [Vector3<f64>; 6]) {
        let mut by_noise = [Vector3::zeros(); 6];
        match self.target {
            RayTarget::Point { position, sigma } => {
                for (k, column) in by_noise.iter_mut().enumerate().take(3) {
                    column[k] = -sigma;
                }
                (Vector3::from(position) - Vector3::new(u[0], u[1], u[2]) * sigma, by_noise)
            }
            RayTarget::Range { origin, direction_rad, range, sigma } => {
                let (sa, ca) = (direction_rad[0] - sigma[3] * u[3]).sin_cos();
                let (se, ce) = (direction_rad[1] - sigma[4] * u[4]).sin_cos();
                let length = range - sigma[5] * u[5];
                // Each error is subtracted from its measured value, hence the signs of the derivatives below.
                let towards = Vector3::new(ce * ca, ce * sa, se);
                for k in 0..3 {
                    by_noise[k][k] = -sigma[k];
                }
                by_noise[3] = Vector3::new(ce * sa, -ce * ca, 0.0) * (sigma[3] * length);
                by_noise[4] = Vector3::new(se * ca, se * sa, -ce) * (sigma[4] * length);
                by_noise[5] = towards * -sigma[5];
                let moved = Vector3::new(sigma[0] * u[0], sigma[1] * u[1], sigma[2] * u[2]);
                (Vector3::from(origin) - moved + towards * length, by_noise)
            }
        }
    }

    /// Covariance of the point to first order.
    pub(crate) fn covariance(&self) -> Matrix3<f64> {
        let (_, by_noise) = self.place(&[0.0; 6]);
        by_noise.iter().map(|column| column * column.transpose()).sum()
    }
}

/// The equation of one ray: the distance of its corrected point to a piece of the shape is zero.
pub(crate) struct ShapeReading<'a> {
    pub(crate) shape: PrimitiveKind,
    pub(crate) chart: &'a Chart,
    pub(crate) ray: &'a Ray,
}

impl ShapeReading<'_> {
    /// `dᵀ Q⁻¹ d` of a displacement `d` within a side, `Q` being the covariance of a point that lies on it.
    fn squared_along(&self, x: &[f64], branch: usize, p: &Vector3<f64>, d: &Vector3<f64>) -> f64 {
        let mut by_state = [0.0; MAX_STATE];
        let (_, n) = distance(self.shape, self.chart, x, branch, p, &mut by_state[..x.len()]);
        let covariance = self.ray.covariance();
        let pull = covariance * n;
        let conditional = covariance - pull * pull.transpose() / n.dot(&pull);
        // It is singular along n, where d has no component: any variance added there makes it invertible
        // and does not change the result.
        let regular = conditional + n * n.transpose() * conditional.trace();
        regular.try_inverse().map_or(0.0, |inverse| d.dot(&(inverse * d)))
    }
}

impl ImplicitReading for ShapeReading<'_> {
    fn state(&self) -> usize {
        self.shape.unknowns()
    }

    fn noise(&self) -> usize {
        self.ray.noises()
    }

    fn branches(&self) -> usize {
        self.shape.pieces()
    }

    fn gradient(
        &self,
        branch: usize,
        x: &[f64],
        u: &[f64],
        by_state: &mut [f64],
        by_noise: &mut [f64],
    ) -> f64 {
        let (p, columns) = self.ray.place(u);
        let (value, by_point) = distance(self.shape, self.chart, x, branch, &p, by_state);
        for (out, column) in by_noise.iter_mut().zip(columns) {
            *out = by_point.dot(&column);
        }
        value
    }

    fn beyond_end_penalty(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let (p, _) = self.ray.place(u);
        let over = overshoot(self.chart, x, branch, &p);
        if over == Vector3::zeros() {
            return 0.0;
        }
        self.squared_along(x, branch, &p, &over)
    }

    fn margin(&self, branch: usize, x: &[f64], u: &[f64]) -> f64 {
        let (p, _) = self.ray.place(u);
        let length = within(self.shape, self.chart, x, branch, &p);
        if length.is_infinite() {
            return length;
        }
        // The largest eigenvalue bounds the variance in every direction within the side, so the margin in σ
        // is a lower bound.
        let covariance = self.ray.covariance();
        length / covariance.symmetric_eigenvalues().max().sqrt()
    }
}
