//! Converts disparities to points with covariances.

use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};

use crate::depth_camera::ray_covariance;
use crate::{DisparityMap, RangeGrid, Scan, Viewing};

/// Variance of a position that is uniformly distributed over its pixel, in pixels squared.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// Two rectified cameras: rows correspond, and `x_right = x_left − d`.
///
/// The point of pixel (u, v) of the left image, centres at integers, with the disparity d is at
/// `z = f B / (d + doffs)` and `p = z ((u − cx)/f, (v − cy)/f, 1)`: x right, y down, z forward, from the left
/// camera's centre.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::StereoCamera;
/// let camera = StereoCamera {
///     focal: 1000.0,
///     center: [320.0, 240.0],
///     baseline: 0.2,
///     doffs: 0.0,
///     sigma_disparity: 0.1,
/// };
/// assert_eq!(camera.point(320.0, 240.0, 100.0), Some(2.0 * DVec3::Z));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoCamera {
    /// Focal length `f` of both, in pixels.
    pub focal: f64,
    /// The pixel `cx cy` of the left image on its axis.
    pub center: [f64; 2],
    /// Distance `B` between the cameras, in the model's unit.
    pub baseline: f64,
    /// `cx_right − cx_left`, in pixels.
    pub doffs: f64,
    /// σ of disparities that is not from matching, such as an error of the rectification, in pixels.
    pub sigma_disparity: f64,
}

/// Selects the disparities that become points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoPoints {
    /// Every `step`-th column and row is used. Matching windows are 9 × 9 pixels and overlap, so errors of
    /// close pixels are correlated.
    pub step: usize,
    /// Maximum σ of a disparity, in pixels. At depth edges σ is large, and the errors are gross and of one
    /// sign.
    pub max_sigma_px: f64,
}

impl Default for StereoPoints {
    fn default() -> Self {
        Self { step: 1, max_sigma_px: f64::INFINITY }
    }
}

impl StereoCamera {
    /// The point of a disparity; `None` if it is not finite or not in front of the cameras.
    #[inline]
    #[must_use]
    pub fn point(&self, u: f64, v: f64, disparity: f64) -> Option<DVec3> {
        let z = self.focal * self.baseline / (disparity + self.doffs);
        (z > 0.0 && z.is_finite()).then(|| self.ray(u, v).map(|c| z * c))
    }

    fn ray(&self, u: f64, v: f64) -> DVec3 {
        DVec3::new((u - self.center[0]) / self.focal, (v - self.center[1]) / self.focal, 1.0)
    }

    /// The covariance of the point of a disparity with the given σ, in pixels.
    ///
    /// To first order an error of the disparity moves the point along its ray d: `σ_z² d dᵀ`,
    /// `σ_z = z² σ_d / (f B)`, with `σ_d² = sigma² + sigma_disparity²`. Across it, the point may be anywhere
    /// on the pixel: `(z/f)²/12`.
    ///
    /// # References
    /// Matthies and Shafer, *Error modeling in stereo navigation*, 1987.
    #[inline]
    #[must_use]
    pub fn covariance(&self, u: f64, v: f64, disparity: f64, sigma: f64) -> Option<SymmetricMatrix3> {
        let z = self.point(u, v, disparity)?.z;
        // The derivative of `z = f b / d` is `−z²/(f b)`: errors of depth grow with the square of the
        // distance.
        let by_disparity = z * z / (self.focal * self.baseline);
        let along = by_disparity.powi(2) * (sigma.powi(2) + self.sigma_disparity.powi(2));
        // A pixel is an area: the position of the matched surface point in it is uniformly distributed.
        let across = (z / self.focal).powi(2) * PIXEL_VARIANCE;
        Some(ray_covariance(self.ray(u, v), along, across))
    }

    /// The selected points of a map as a scan, with covariances and the grid of the image, viewed from the
    /// left camera's centre.
    ///
    /// # Errors
    /// `Undetermined` if no disparity gives a point; `Input` for a step of 0.
    pub fn scan(&self, map: &DisparityMap, choice: &StereoPoints, name: &str) -> Result<Scan> {
        let step = choice.step;
        if step == 0 {
            return Err(Error::input("expected a step of 1 pixel or more, found 0"));
        }
        let (mut points, mut covariances) = (Vec::new(), Vec::new());
        let (columns, rows) = (map.columns.div_ceil(step), map.rows.div_ceil(step));
        let mut cells = Vec::with_capacity(columns * rows);
        let places =
            (0..map.rows).step_by(step).flat_map(|v| (0..map.columns).step_by(step).map(move |u| (u, v)));
        for (u, v) in places {
            let k = v * map.columns + u;
            let (disparity, sigma) = (f64::from(map.disparity[k]), map.sigma[k]);
            let (u, v) = (u as f64, v as f64);
            // NaN, the σ of rejected pixels, fails this comparison.
            let known = f64::from(sigma) <= choice.max_sigma_px;
            let point = if known { self.point(u, v, disparity) } else { None };
            let found = point.zip(self.covariance(u, v, disparity, f64::from(sigma)));
            // Empty cells stay in the grid, so that neighbours in it are neighbours in the image.
            cells.push(match found {
                Some(_) => points.len() as u32,
                None => RangeGrid::EMPTY,
            });
            if let Some((point, covariance)) = found {
                points.push(point);
                covariances.push(covariance);
            }
        }
        if points.is_empty() {
            return Err(Error::undetermined(format!(
                "expected points in front of the cameras, found none for {} pixels: check that left and \
                 right are not exchanged, and that the disparities are within the search range",
                cells.len()
            )));
        }
        Ok(Scan {
            name: name.to_owned(),
            points,
            covariance: Some(covariances),
            grid: Some(RangeGrid { columns, rows, cells }),
            viewing: Viewing::Origin(DVec3::ZERO),
            ..Scan::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const CAMERA: StereoCamera = StereoCamera {
        focal: 800.0,
        center: [320.0, 240.0],
        baseline: 120.0,
        doffs: 5.0,
        sigma_disparity: 0.3,
    };

    #[test]
    fn points_project_to_their_pixels_in_both_cameras() {
        let p = CAMERA.point(420.0, 200.0, 43.0).unwrap();
        let left = [800.0 * p[0] / p[2] + 320.0, 800.0 * p[1] / p[2] + 240.0];
        // The right camera's axis is at cx + doffs.
        let right = 800.0 * (p[0] - 120.0) / p[2] + 325.0;
        assert!((left[0] - 420.0).abs() < 1e-9 && (left[1] - 200.0).abs() < 1e-9);
        assert!((left[0] - right - 43.0).abs() < 1e-9);
        assert_eq!(CAMERA.point(0.0, 0.0, -5.0), None);
        assert_eq!(CAMERA.point(0.0, 0.0, f64::NAN), None);
    }

    /// A normal number from uniform ones (Box and Muller 1958).
    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        let (a, b): (f64, f64) = (rng.random(), rng.random());
        (-2.0 * (1.0 - a).ln()).sqrt() * (std::f64::consts::TAU * b).cos()
    }

    #[test]
    fn covariance_matches_a_simulation() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (u, v, d, sigma) = (500.0, 100.0, 40.0, 0.4);
        let stated = CAMERA.covariance(u, v, d, sigma).unwrap().to_array();
        let truth = CAMERA.point(u, v, d).unwrap();
        let n = 40_000;
        let mut sums = [0.0; 6];
        for _ in 0..n {
            let mut off = || rng.random::<f64>() - 0.5;
            let (du, dv) = (off(), off());
            let d = d + normal(&mut rng) * 0.3_f64.hypot(sigma);
            let p = CAMERA.point(u + du, v + dv, d).unwrap();
            let e = p - truth;
            let square = SymmetricMatrix3::from_entries(|i, j| e[i] * e[j]).to_array();
            sums.iter_mut().zip(square).for_each(|(s, q)| *s += q / f64::from(n));
        }
        let scale = |i: usize, j: usize| (stated[[0, 3, 5][i]] * stated[[0, 3, 5][j]]).sqrt();
        for (k, (i, j)) in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].into_iter().enumerate() {
            // The standard error of a variance from 40 000 draws is 0.7 %.
            assert!((sums[k] - stated[k]).abs() < 0.03 * scale(i, j), "{k}: {} {}", sums[k], stated[k]);
        }
    }
}
