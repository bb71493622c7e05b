//! Quadratic patches: heights over a plane, fitted to positions and normals of readings.
//!
//! Input: weighted readings around a place. Output: a quadratic function of two coordinates of a plane, with
//! signed distances, feet, and points where two or three patches meet.
//!
//! Each reading gives its height and two slopes. The slopes show the shape where noise hides it, as long as
//! the normals are better than the noise over the spacing; weights decide between both.
//!
//! Not guaranteed: anything farther from the place than the radius of the readings.

use nalgebra::{Matrix3, SMatrix, SVector};
use planish_core::DVec3;
use planish_core::vector3::tangents;

/// Coefficients of a quadratic height.
const COEFFICIENTS: usize = 6;
/// Least cosine between the normal of a reading and that of the plane: beyond it, slopes are too steep.
const MIN_COSINE: f64 = 0.25;
/// σ that second derivatives have without readings, in inverse radii. It keeps readings on a line from giving
/// any shape.
const CURVATURE_SIGMA: f64 = 1.0;
/// Steps to a foot and to a point where patches meet. Patches are nearly flat, so Newton's method converges
/// fast.
const FOOT_STEPS: usize = 3;
const MEETING_STEPS: usize = 6;

/// σ of heights, as a length, and of slopes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scales {
    pub(super) height: f64,
    pub(super) slope: f64,
}

/// A reading with its weight.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weighted {
    pub(super) point: DVec3,
    pub(super) normal: DVec3,
    pub(super) weight: f64,
}

/// Heights `c · (1, x, y, x², xy, y²)` over a plane, all in units of the radius.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Patch {
    pub(super) origin: DVec3,
    frame: [DVec3; 3],
    radius: f64,
    heights: [f64; COEFFICIENTS],
}

/// A fitted patch and the covariance of its coefficients.
pub(super) struct FittedPatch {
    pub(super) patch: Patch,
    covariance: SMatrix<f64, COEFFICIENTS, COEFFICIENTS>,
}

impl Patch {
    /// The patch of least squares over the plane at `origin` with a unit normal; none if the readings do not
    /// determine it.
    pub(super) fn fit(
        origin: DVec3,
        normal: DVec3,
        radius: f64,
        readings: &[Weighted],
        scales: Scales,
    ) -> Option<FittedPatch> {
        let (e1, e2) = tangents(normal);
        let frame = [e1, e2, normal];
        let mut information = SMatrix::<f64, COEFFICIENTS, COEFFICIENTS>::zeros();
        for k in 3..COEFFICIENTS {
            information[(k, k)] = CURVATURE_SIGMA.powi(-2);
        }
        let mut right = SVector::<f64, COEFFICIENTS>::zeros();
        let mut add = |row: [f64; COEFFICIENTS], value: f64, weight: f64| {
            for i in 0..COEFFICIENTS {
                let scaled = weight * row[i];
                right[i] += scaled * value;
                for j in 0..=i {
                    information[(i, j)] += scaled * row[j];
                }
            }
        };
        let height_weight = (radius / scales.height).powi(2);
        for reading in readings {
            let d = (reading.point - origin) / radius;
            let [x, y, z] = frame.map(|axis| axis.dot(d));
            let [nx, ny, nz] = frame.map(|axis| axis.dot(reading.normal));
            // Heights over an inclined part are farther from the plane than the noise.
            let steepness = nz.max(MIN_COSINE);
            add(monomials(x, y), z, reading.weight * height_weight * steepness * steepness);
            if nz > MIN_COSINE {
                let weight = reading.weight * (nz * nz / scales.slope).powi(2);
                add([0.0, 1.0, 0.0, 2.0 * x, y, 0.0], -nx / nz, weight);
                add([0.0, 0.0, 1.0, 0.0, x, 2.0 * y], -ny / nz, weight);
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        let factor = information.cholesky()?;
        let solved = factor.solve(&right);
        let heights: [f64; COEFFICIENTS] = solved.into();
        heights.iter().all(|c| c.is_finite()).then(|| FittedPatch {
            patch: Self { origin, frame, radius, heights },
            covariance: factor.inverse(),
        })
    }

    /// Signed distance, to first order, and the unit normal above or below a point.
    pub(super) fn distance(&self, p: DVec3) -> (f64, DVec3) {
        let d = (p - self.origin) / self.radius;
        let [x, y, z] = self.frame.map(|axis| axis.dot(d));
        let height: f64 = self.heights.iter().zip(monomials(x, y)).map(|(c, m)| c * m).sum();
        let [_, cx, cy, xx, xy, yy] = self.heights;
        let (dx, dy) = (cx + 2.0 * xx * x + xy * y, cy + xy * x + 2.0 * yy * y);
        let length = (1.0 + dx * dx + dy * dy).sqrt();
        let normal = (self.frame[2] - dx * self.frame[0] - dy * self.frame[1]) / length;
        (self.radius * (z - height) / length, normal)
    }

    /// The point of the patch near `p`.
    pub(super) fn foot(&self, mut p: DVec3) -> DVec3 {
        for _ in 0..FOOT_STEPS {
            let (distance, normal) = self.distance(p);
            p -= distance * normal;
        }
        p
    }
}

impl FittedPatch {
    /// σ of the slope at a point, in a direction along the plane.
    pub(super) fn slope_sigma(&self, at: DVec3, direction: DVec3) -> f64 {
        let d = (at - self.patch.origin) / self.patch.radius;
        let [x, y, _] = self.patch.frame.map(|axis| axis.dot(d));
        let [a, b, _] = self.patch.frame.map(|axis| axis.dot(direction));
        let row = SVector::from([0.0, a, b, 2.0 * x * a, y * a + x * b, 2.0 * y * b]);
        (row.transpose() * self.covariance * row)[0].max(0.0).sqrt()
    }
}

fn monomials(x: f64, y: f64) -> [f64; COEFFICIENTS] {
    [1.0, x, y, x * x, x * y, y * y]
}

/// The point near `start` where two or three patches meet, by the shortest steps; none if two are nearly
/// parallel.
pub(super) fn meeting(patches: &[Patch], start: DVec3) -> Option<DVec3> {
    let mut p = start;
    for _ in 0..MEETING_STEPS {
        let on: Vec<(f64, DVec3)> = patches.iter().map(|patch| patch.distance(p)).collect();
        match on[..] {
            [(f, m), (g, n)] => {
                let c = m.dot(n);
                let determinant = 1.0 - c * c;
                if determinant < 1e-3 {
                    return None;
                }
                p -= ((f - c * g) * m + (g - c * f) * n) / determinant;
            }
            [(f, l), (g, m), (h, n)] => {
                let rows = Matrix3::from_rows(
                    &[l, m, n].map(|v| v.to_array().into()).map(|v: SVector<f64, 3>| v.transpose()),
                );
                if rows.determinant().abs() < 0.02 {
                    return None;
                }
                let step = rows.lu().solve(&SVector::from([f, g, h]))?;
                p -= DVec3::new(step[0], step[1], step[2]);
            }
            _ => return None,
        }
    }
    p.is_finite().then_some(p)
}
