//! Pinhole cameras with poses that may be uncertain.
//!
//! In: intrinsics and poses, or projection matrices. Out: pixels of points, lines of sight of pixels, and
//! their derivatives by the pose.
//!
//! Frames and conventions are those of [`Pinhole`]. A pose changes by `X_camera ← exp(ω) X_camera + τ`: a
//! rotation `ω` about the camera's centre, then a translation `τ` of the world, both in the camera's frame.

use nalgebra::{Matrix2x3, Matrix3, Rotation3, Vector2, Vector3};
use planish_core::matrix3::{times, transposed_times};
use planish_core::{DVec3, Pinhole};
use planish_estimate::{Error, Result};

/// A calibrated camera whose pose can be estimated: a [`Pinhole`] with checked intrinsics and rotation, and
/// the derivatives of its projection.
///
/// # Examples
/// ```
/// use planish_core::{DVec3, matrix3::IDENTITY};
/// use planish_shell::Camera;
/// let k = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]];
/// let camera = Camera::new(k, IDENTITY, 2.0 * DVec3::Z)?;
/// let (pixel, depth) = camera.project(0.1 * DVec3::X).expect("in front of the camera");
/// assert_eq!((pixel, depth), ([345.0, 240.0], 2.0));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Intrinsics (upper triangular, the last entry one) and pose.
    pub pinhole: Pinhole,
}

fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| rows[i][j])
}

fn rows_of(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]))
}

/// Formats a matrix row by row, as in a file.
fn rows(matrix: &Matrix3<f64>) -> String {
    let row = |i: usize| format!("[{}, {}, {}]", matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]);
    format!("[{}, {}, {}]", row(0), row(1), row(2))
}

impl Camera {
    /// A camera from intrinsics, rotation and translation, row by row.
    ///
    /// # Errors
    /// `Input` if a number is not finite, `K` is not upper triangular with positive focal lengths, or `R`
    /// differs from a rotation by more than 1e-3. Smaller errors of `R` are removed.
    pub fn new(k: [[f64; 3]; 3], r: [[f64; 3]; 3], t: DVec3) -> Result<Self> {
        let (k, r) = (matrix(&k), matrix(&r));
        for (name, finite) in [("R", r.iter().all(|x| x.is_finite())), ("t", t.is_finite())] {
            if !finite {
                return Err(Error::input(format!("expected finite numbers in {name}, found another")));
            }
        }
        let finite = k.iter().all(|x| x.is_finite());
        let triangle = k[(1, 0)] == 0.0 && k[(2, 0)] == 0.0 && k[(2, 1)] == 0.0 && k[(2, 2)] == 1.0;
        if !(finite && triangle && k[(0, 0)] > 0.0 && k[(1, 1)] > 0.0) {
            return Err(Error::input(format!(
                "expected K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]] with focal lengths above 0, found K \
                = {}",
                rows(&k)
            )));
        }
        let off = (r * r.transpose() - Matrix3::identity()).amax();
        if off > 1e-3 || r.determinant() < 0.0 {
            return Err(Error::input(format!(
                "expected a rotation in R, with rows of length one at right angles and determinant 1, \
                 found {}",
                rows(&r)
            )));
        }
        // Files round their numbers. The nearest rotation keeps poses orthonormal, on which their derivatives
        // rely.
        let r = rows_of(Rotation3::from_matrix_eps(&r, 1e-15, 100, Rotation3::identity()).matrix());
        Ok(Self { pinhole: Pinhole { k: rows_of(&k), r, t } })
    }

    /// A camera from its projection matrix `P ∝ K [R t]`, row by row, signed so that points in front of the
    /// camera have a positive third coordinate (R. Hartley, A. Zisserman, *Multiple view geometry in computer
    /// vision*, 2003, section 6.2.4). If the left part has a negative determinant, the image is mirrored and
    /// the first focal length is negative.
    ///
    /// # Errors
    /// `Input` if a number is not finite, or the left 3 × 3 part has no inverse.
    pub fn from_projection(p: [[f64; 4]; 3]) -> Result<Self> {
        let m = Matrix3::from_fn(|i, j| p[i][j]);
        let last = Vector3::from_fn(|i, _| p[i][3]);
        let determinant = m.determinant();
        let size = m.norm();
        if !(m.iter().chain(&last).all(|x| x.is_finite()) && determinant.abs() > 1e-12 * size.powi(3)) {
            // Rows may have very different lengths, so the test is repeated on normalised rows.
            let rows: f64 = (0..3).map(|i| m.row(i).norm()).product();
            if determinant.is_nan()
                || determinant.abs() <= 1e-12 * rows
                || !last.iter().all(|x| x.is_finite())
            {
                return Err(Error::input(format!(
                    "expected a projection matrix whose left 3 × 3 part has an inverse, found {p:?}"
                )));
            }
        }
        // M = K R: rows of R by Gram-Schmidt from the last one up.
        let [first, second, third] = [0, 1, 2].map(|i| m.row(i).transpose());
        let mut k = Matrix3::zeros();
        k[(2, 2)] = third.norm();
        let r3 = third / k[(2, 2)];
        k[(1, 2)] = second.dot(&r3);
        let rest = second - k[(1, 2)] * r3;
        k[(1, 1)] = rest.norm();
        let r2 = rest / k[(1, 1)];
        k[(0, 2)] = first.dot(&r3);
        k[(0, 1)] = first.dot(&r2);
        let r1 = r2.cross(&r3);
        // Negative for mirrored images, with x to the left or y upwards.
        k[(0, 0)] = first.dot(&r1);
        let r = Matrix3::from_rows(&[r1.transpose(), r2.transpose(), r3.transpose()]);
        let inverse = k
            .try_inverse()
            .ok_or_else(|| Error::input("expected a projection matrix with intrinsics, found one without"))?;
        let t = (inverse * last).into();
        Ok(Self { pinhole: Pinhole { k: rows_of(&(k / k[(2, 2)])), r: rows_of(&r), t } })
    }

    /// The centre of the camera in the world, `−Rᵀ t`.
    #[must_use]
    pub fn center(&self) -> DVec3 {
        self.pinhole.center()
    }

    /// The pixel of a point and its depth; `None` at or behind the camera.
    #[must_use]
    pub fn project(&self, at: DVec3) -> Option<([f64; 2], f64)> {
        let inside = self.pinhole.in_camera(at);
        Some((self.pinhole.pixel(inside)?, inside[2]))
    }

    /// The unit direction of the line of sight of a pixel, in the world.
    #[must_use]
    pub fn direction(&self, pixel: [f64; 2]) -> DVec3 {
        let direction = transposed_times(&self.pinhole.r, self.pinhole.ray_in_camera(pixel));
        let length = direction.length();
        direction / length
    }

    /// The rotation from the world.
    pub(crate) fn rotation(&self) -> Matrix3<f64> {
        matrix(&self.pinhole.r)
    }

    /// `∂x/∂X_camera` at a point in the camera's frame.
    pub(crate) fn pixel_by_place(&self, inside: DVec3) -> Matrix2x3<f64> {
        let k = &self.pinhole.k;
        let DVec3 { x, y, z } = times(k, inside);
        let pixel = [x / z, y / z];
        Matrix2x3::from_fn(|i, j| (k[i][j] - pixel[i] * k[2][j]) / z)
    }

    /// Derivative of the pixel of a point along an image direction, by the point: `∂(uᵀπ(x))/∂x`.
    pub(crate) fn by_place(&self, at: DVec3, along: [f64; 2]) -> DVec3 {
        let inside = self.pinhole.in_camera(at);
        let by_inside = self.pixel_by_place(inside).tr_mul(&Vector2::from(along));
        transposed_times(&self.pinhole.r, by_inside.into())
    }

    /// Derivative of `D` by the pixel, where the line of sight touches the shell: `∂D/∂(x, y)`.
    pub(crate) fn by_pixel(&self, at: DVec3, gradient: DVec3) -> [f64; 2] {
        let depth = self.pinhole.in_camera(at).z;
        let DVec3 { x, y, .. } = times(&self.pinhole.r, gradient);
        let k = &self.pinhole.k;
        let by_x = x * depth / k[0][0];
        // A step of y alone moves x by the skew.
        let by_y = (y - x * k[0][1] / k[0][0]) * depth / k[1][1];
        [by_x, by_y]
    }

    /// The width of a pixel at a point: the maximum of `∂D/∂(x, y)`, for a distance across the line of sight.
    pub(crate) fn pixel_width(&self, at: DVec3) -> f64 {
        self.pinhole.in_camera(at)[2].abs() / self.pinhole.focal_px()
    }

    /// Derivative of `D` at a point on a line of sight by the pose `(ω, τ)`, for a constant pixel:
    /// `−(x × g)`, `−g` with `x` and `g = ∇D` in the camera's frame.
    pub(crate) fn by_pose(&self, at: DVec3, gradient: DVec3) -> [f64; 6] {
        let inside = self.pinhole.in_camera(at);
        let g = times(&self.pinhole.r, gradient);
        let turn = inside.cross(g);
        [-turn[0], -turn[1], -turn[2], -g[0], -g[1], -g[2]]
    }

    /// The camera after a change `[ω, τ]` of its pose (radians, then the unit of the mesh).
    #[must_use]
    pub fn moved(&self, by: [f64; 6]) -> Self {
        let turn = Rotation3::new(Vector3::new(by[0], by[1], by[2]));
        let r = turn.matrix() * self.rotation();
        // Products of rotations stay rotations.
        let r = Rotation3::from_matrix_eps(&r, 1e-15, 10, Rotation3::from_matrix_unchecked(r));
        let t = turn * Vector3::from(self.pinhole.t) + Vector3::new(by[3], by[4], by[5]);
        Self { pinhole: Pinhole { k: self.pinhole.k, r: rows_of(r.matrix()), t: t.into() } }
    }

    /// The change `[ω, τ]` of pose that turns `other` into this camera.
    #[must_use]
    pub fn change_from(&self, other: &Self) -> [f64; 6] {
        let turn = Rotation3::from_matrix_unchecked(self.rotation() * other.rotation().transpose());
        let step = Vector3::from(self.pinhole.t) - turn * Vector3::from(other.pinhole.t);
        let axis = turn.scaled_axis();
        [axis.x, axis.y, axis.z, step.x, step.y, step.z]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        let r = Rotation3::from_euler_angles(0.3, -0.8, 2.1);
        let k = [[900.0, 3.0, 320.0], [0.0, 950.0, 240.0], [0.0, 0.0, 1.0]];
        Camera::new(k, rows_of(r.matrix()), DVec3::new(0.2, -0.1, 6.0)).unwrap()
    }

    /// `K R` and `K t`.
    fn projection(camera: &Camera) -> (Matrix3<f64>, Vector3<f64>) {
        let k = matrix(&camera.pinhole.k);
        (k * camera.rotation(), k * Vector3::from(camera.pinhole.t))
    }

    #[test]
    fn projection_matrices_decompose_at_any_scale_and_mirrored() {
        let camera = camera();
        for factor in [1.0, 0.03, 50.0] {
            let p: [[f64; 4]; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|j| {
                    let (m, last) = projection(&camera);
                    factor * if j < 3 { m[(i, j)] } else { last[i] }
                })
            });
            let same = Camera::from_projection(p).unwrap();
            assert!((matrix(&same.pinhole.k) - matrix(&camera.pinhole.k)).amax() < 1e-9);
            assert!((same.rotation() - camera.rotation()).amax() < 1e-12);
            assert!((Vector3::from(same.pinhole.t) - Vector3::from(camera.pinhole.t)).amax() < 1e-9);
        }
        // The same with mirrored images: points project to mirrored pixels.
        let mirrored: [[f64; 4]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (m, last) = projection(&camera);
                let sign = if i == 0 { -1.0 } else { 1.0 };
                sign * if j < 3 { m[(i, j)] } else { last[i] }
            })
        });
        let other = Camera::from_projection(mirrored).unwrap();
        let at = DVec3::new(0.3, -0.4, 0.5);
        let ([x, y], depth) = camera.project(at).unwrap();
        let ([u, v], same) = other.project(at).unwrap();
        assert!((x + u).abs() < 1e-9 && (y - v).abs() < 1e-9 && (depth - same).abs() < 1e-9);
        let way = Vector3::from(other.direction([u, v]));
        assert!((way - Vector3::from(camera.direction([x, y]))).norm() < 1e-9);
        assert!(Camera::from_projection([[1.0, 2.0, 3.0, 4.0]; 3]).is_err());
        assert!(Camera::new([[1.0, 0.0, 0.0]; 3], [[1.0, 0.0, 0.0]; 3], DVec3::ZERO).is_err());
    }

    #[test]
    fn projections_invert_and_pose_changes_round_trip() {
        let camera = camera();
        let at = DVec3::new(0.3, -0.4, 0.5);
        let (pixel, depth) = camera.project(at).unwrap();
        let way = Vector3::from(camera.direction(pixel));
        let off = Vector3::from(at) - Vector3::from(camera.center());
        assert!(off.cross(&way).norm() < 1e-12 && (camera.rotation() * off).z - depth < 1e-12);
        let change = [0.02, -0.01, 0.03, 0.1, -0.2, 0.05];
        let back = camera.moved(change).change_from(&camera);
        assert!(change.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
