//! A camera that measures a depth at every pixel.

use planish_core::{DVec3, SymmetricMatrix3};

/// A pinhole camera that measures depth along its axis.
///
/// The point of pixel (u, v), centres at integers, with the reading d is at `z = scale d` and
/// `p = z ((u − cx)/fx, (v − cy)/fy, 1)`: x right, y down, z forward, from the camera's centre.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::DepthCamera;
/// let camera = DepthCamera { focal: [500.0; 2], center: [320.0, 240.0], scale: 0.001, sigma: None };
/// assert_eq!(camera.point(320.0, 240.0, 1500.0), Some(1.5 * DVec3::Z));
/// assert_eq!(camera.point(320.0, 240.0, 0.0), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthCamera {
    /// Focal lengths `fx fy`, in pixels.
    pub focal: [f64; 2],
    /// The pixel `cx cy` on the axis.
    pub center: [f64; 2],
    /// Length of a reading of 1, in the model's unit.
    pub scale: f64,
    /// `a` and `b` of σ_z = a + b z², in the model's unit and its inverse; `None` if unknown.
    pub sigma: Option<[f64; 2]>,
}

impl DepthCamera {
    /// The point of a reading; `None` if the reading is 0, negative or not finite.
    #[inline]
    #[must_use]
    pub fn point(&self, u: f64, v: f64, reading: f64) -> Option<DVec3> {
        let z = self.scale * reading;
        (z > 0.0 && z.is_finite()).then(|| self.ray(u, v).map(|c| z * c))
    }

    /// The ray of a pixel, of length 1 along the axis.
    fn ray(&self, u: f64, v: f64) -> DVec3 {
        DVec3::new((u - self.center[0]) / self.focal[0], (v - self.center[1]) / self.focal[1], 1.0)
    }

    /// The covariance of the point of a pixel at depth z, if σ is known.
    ///
    /// An error of the depth moves the point along its ray d: `(a + b z²)² d dᵀ`. Across the ray the point is
    /// uniformly distributed over the pixel, with variance `(z/f)²/12`.
    #[inline]
    #[must_use]
    pub fn covariance(&self, u: f64, v: f64, z: f64) -> Option<SymmetricMatrix3> {
        let [a, b] = self.sigma?;
        let along = (a + b * z * z).powi(2);
        let across = z * z / (self.focal[0] * self.focal[1]).abs() / 12.0;
        Some(ray_covariance(self.ray(u, v), along, across))
    }
}

/// The covariance of a point on the ray `d`, of length 1 along the axis, whose
/// depth has the variance `along`: `along d dᵀ`, and `across` in each direction across it.
pub(crate) fn ray_covariance(d: DVec3, along: f64, across: f64) -> SymmetricMatrix3 {
    let square = d.length_squared();
    // The isotropic part already contains `across` along the ray, so it is subtracted there.
    let extra = along - across / square;
    SymmetricMatrix3::from_entries(|i, j| extra * d[i] * d[j] + if i == j { across } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: DepthCamera = DepthCamera {
        focal: [500.0, 520.0],
        center: [319.5, 239.5],
        scale: 0.001,
        sigma: Some([0.001, 0.002]),
    };

    #[test]
    fn a_reading_lies_on_the_ray_of_its_pixel() {
        let p = CAMERA.point(419.5, 135.5, 2000.0).unwrap();
        assert!(p.abs_diff_eq(DVec3::new(0.4, -0.4, 2.0), 1e-15), "{p:?}");
        for depth in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(CAMERA.point(0.0, 0.0, depth), None);
        }
    }

    #[test]
    fn depth_errors_move_points_along_their_rays() {
        let c = CAMERA.covariance(719.5, 239.5, 2.0).unwrap();
        // σ_z is 9 mm, the ray is (0.8, 0, 1).
        let length = 1.64_f64.sqrt();
        let ray = DVec3::new(0.8 / length, 0.0, 1.0 / length);
        assert!((c.along(ray).sqrt() - 0.009 * length).abs() < 1e-12);
        let pixel = 2.0 / (500.0_f64 * 520.0).sqrt() / 12.0_f64.sqrt();
        for across in [DVec3::Y, DVec3::new(1.0 / length, 0.0, -0.8 / length)] {
            assert!((c.along(across).sqrt() - pixel).abs() < 1e-12);
        }
        assert_eq!(DepthCamera { sigma: None, ..CAMERA }.covariance(0.0, 0.0, 1.0), None);
    }
}
