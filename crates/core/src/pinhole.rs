//! Pinhole cameras and projectors.
//!
//! In: intrinsics and a pose. Out: pixels of points, and lines of sight of pixels.
//!
//! `X_camera = R X + t` and `x ~ K X_camera`. In the camera's frame x points right, y down and z forward.
//! Pixel centres are at integers.
//!
//! Not guaranteed: fields are public and not checked. Readers of files check that K is upper triangular with
//! positive focal lengths and that R is a rotation. Lens distortion is not modelled.
//!
//! # References
//! Hartley and Zisserman, *Multiple View Geometry in Computer Vision*, 2003, chapter 6.

use crate::Pose;
use crate::matrix3::{inverse, times, transposed_times};
use glam::DVec3;

/// A pinhole camera or projector: `x ~ K (R X + t)`.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, Pinhole, Pose};
/// let k = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]];
/// let world_from_camera = Pose { translation: DVec3::new(0.0, 0.0, -2.0), ..Pose::identity() };
/// let camera = Pinhole::new(k, &world_from_camera);
/// assert_eq!(camera.center(), DVec3::new(0.0, 0.0, -2.0));
/// assert_eq!(camera.project(DVec3::new(0.1, 0.0, 0.0)), Some([345.0, 240.0]));
/// assert_eq!(camera.project(DVec3::new(0.0, 0.0, -3.0)), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Intrinsics `[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]` in pixels, row by row.
    pub k: [[f64; 3]; 3],
    /// Rotation from the world, row by row.
    pub r: [[f64; 3]; 3],
    /// Translation from the world.
    pub t: DVec3,
}

impl Pinhole {
    /// A camera from its intrinsics and its pose.
    #[must_use]
    pub fn new(k: [[f64; 3]; 3], world_from_camera: &Pose) -> Self {
        let camera_from_world = world_from_camera.inverse();
        Self { k, r: camera_from_world.rotation, t: camera_from_world.translation }
    }

    /// The centre in the world, `−Rᵀ t`.
    #[must_use]
    pub fn center(&self) -> DVec3 {
        -transposed_times(&self.r, self.t)
    }

    /// The geometric mean of the two focal lengths, in pixels: an object of size s at depth z covers about
    /// `s · focal / z` pixels.
    #[must_use]
    pub fn focal_px(&self) -> f64 {
        (self.k[0][0] * self.k[1][1]).abs().sqrt()
    }

    /// A world point in the camera's frame, `R X + t`.
    #[inline]
    #[must_use]
    pub fn in_camera(&self, point: DVec3) -> DVec3 {
        times(&self.r, point) + self.t
    }

    /// The pixel of a point in the camera's frame; `None` at or behind the camera.
    #[inline]
    #[must_use]
    pub fn pixel(&self, in_camera: DVec3) -> Option<[f64; 2]> {
        // The last row of K is (0, 0, 1), so the third coordinate is the depth.
        let seen = times(&self.k, in_camera);
        (seen[2] > 0.0).then(|| [seen[0] / seen[2], seen[1] / seen[2]])
    }

    /// The pixel of a world point; `None` at or behind the camera.
    #[inline]
    #[must_use]
    pub fn project(&self, point: DVec3) -> Option<[f64; 2]> {
        self.pixel(self.in_camera(point))
    }

    /// The direction of a pixel's line of sight in the camera's frame, `K⁻¹ (x, y, 1)`, by back-substitution.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, Pinhole, Pose};
    /// let k = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]];
    /// let camera = Pinhole::new(k, &Pose::identity());
    /// assert_eq!(camera.ray_in_camera([345.0, 240.0]), DVec3::new(0.05, 0.0, 1.0));
    /// ```
    #[inline]
    #[must_use]
    pub fn ray_in_camera(&self, [x, y]: [f64; 2]) -> DVec3 {
        // K is upper triangular: y first, then x, without an inverse for each pixel.
        let [first, second, _] = self.k;
        let y = (y - second[2]) / second[1];
        DVec3::new((x - first[2] - first[1] * y) / first[0], y, 1.0)
    }

    /// The direction of a pixel's line of sight in the world, `Rᵀ K⁻¹ (x, y, 1)`; `None` if K is singular.
    ///
    /// # Examples
    /// ```
    /// use planish_core::{DVec3, Pinhole, Pose};
    /// let k = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]];
    /// let camera = Pinhole::new(k, &Pose::identity());
    /// let direction = camera.direction([345.0, 240.0]).expect("K has an inverse");
    /// assert!((direction[0] / direction[2] - 0.05).abs() < 1e-15);
    /// ```
    #[must_use]
    pub fn direction(&self, pixel: [f64; 2]) -> Option<DVec3> {
        Some(transposed_times(&self.r, times(&inverse(&self.k)?, DVec3::new(pixel[0], pixel[1], 1.0))))
    }

    /// The normal of the plane through the centre and a line of the image, `Rᵀ Kᵀ l`, `l = p × d`.
    #[must_use]
    pub fn plane_of_line(&self, at: [f64; 2], direction: [f64; 2]) -> DVec3 {
        // A point X of the plane has `l · K (R X + t) = 0`, hence the normal `Rᵀ Kᵀ l`.
        let line = DVec3::new(at[0], at[1], 1.0).cross(DVec3::new(direction[0], direction[1], 0.0));
        transposed_times(&self.r, transposed_times(&self.k, line))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Pinhole {
        let k = [[900.0, 3.0, 320.0], [0.0, 950.0, 240.0], [0.0, 0.0, 1.0]];
        Pinhole::new(k, &Pose::from_rotation_vector(DVec3::new(0.3, -0.2, 0.1), DVec3::new(0.2, -0.1, -6.0)))
    }

    #[test]
    fn lines_of_sight_pass_through_projected_points() {
        let camera = camera();
        let point = DVec3::new(0.3, -0.4, 0.5);
        let pixel = camera.project(point).unwrap();
        let direction = camera.direction(pixel).unwrap();
        // In the camera's frame the ray has depth 1, so the depth of the point is its parameter.
        let depth = camera.in_camera(point)[2];
        assert!((camera.center() + depth * direction).distance(point) < 1e-12);
        assert!(camera.ray_in_camera(pixel).distance(times(&camera.r, direction)) < 1e-14);
    }

    #[test]
    fn planes_of_image_lines_contain_what_projects_to_them() {
        let camera = camera();
        let [a, b] = [DVec3::new(0.3, -0.4, 0.5), DVec3::new(-0.2, 0.1, 0.9)];
        let [p, q] = [a, b].map(|x| camera.project(x).unwrap());
        let normal = camera.plane_of_line(p, [q[0] - p[0], q[1] - p[1]]);
        for x in [a, b] {
            assert!(normal.dot(x - camera.center()).abs() < 1e-6 * normal.length());
        }
    }
}
