//! Rectification of the images of two calibrated cameras, so that their rows correspond.
//!
//! In: two cameras with intrinsics, lens distortion and poses. Out: a [`Rectification`], which warps images
//! for matching and transforms the resulting points into the world frame.
//!
//! Both cameras are rotated about their centres until their x axes are parallel to the baseline; the lens
//! distortion is removed in the same step. The new optical axis is as close to the mean of the old ones as
//! that allows. Images that are already rectified remain unchanged.
//!
//! Not supported: cameras that look along the baseline. Their images contain an epipole and are rejected.
//!
//! # References
//! - Fusiello, Trucco and Verri, *A compact algorithm for rectification of stereo pairs*, Machine Vision
//!   and Applications 2000.
//! - Brown, *Decentering distortion of lenses*, Photogrammetric Engineering 1966, for the distortion.

use planish_core::matrix3::{from_columns, rows, times};
use planish_core::{BoundingBox, DVec3, Pinhole};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

use crate::{DisparityMap, Image, Pose, Scan, StereoCamera, StereoPoints, Viewing};

/// Maximum number of fixed-point iterations that invert a distortion. Convergence is linear; distortions that
/// need more are rejected.
const UNDISTORTIONS: usize = 50;
/// Points on each side of an image at which its outline is sampled.
const OUTLINE: usize = 33;
/// Maximum ratio of the columns and rows of a rectified image to those of the first image. It limits the
/// memory for strongly converging cameras.
const MAX_STRETCH: f64 = 3.0;
/// Positions closer than this to a pixel centre are snapped to it, so that rectified images are not
/// resampled.
const ROUNDING: f64 = 1e-6;

/// A camera with lens distortion (Brown's model): `x_d = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² +
/// 2x²)`, likewise
/// in y with `p1 (r² + 2y²) + 2 p2 x y`, at distance 1 along the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LensCamera {
    /// The camera without its lens.
    pub pinhole: Pinhole,
    /// `k1 k2 p1 p2 k3`.
    pub distortion: [f64; 5],
}

impl LensCamera {
    fn distorted(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.distortion;
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    }

    /// The pixel of a direction in the world; `None` behind the camera.
    #[must_use]
    pub fn pixel(&self, direction: DVec3) -> Option<[f64; 2]> {
        let DVec3 { x, y, z } = times(&self.pinhole.r, direction);
        if z <= 0.0 {
            return None;
        }
        let [x, y] = self.distorted([x / z, y / z]);
        let seen = times(&self.pinhole.k, DVec3::new(x, y, 1.0));
        Some([seen.x, seen.y])
    }

    /// The direction of a pixel's line of sight in the world; `None` if the distortion cannot be inverted
    /// there.
    #[must_use]
    pub fn direction(&self, pixel: [f64; 2]) -> Option<DVec3> {
        let ray = self.pinhole.ray_in_camera(pixel);
        let seen = [ray.x, ray.y];
        let mut straight = seen;
        // The polynomial has no closed inverse. The fixed point converges where the distortion grows slowly;
        // the result is checked below.
        for _ in 0..UNDISTORTIONS {
            let distorted = self.distorted(straight);
            straight = [0, 1].map(|k| straight[k] + seen[k] - distorted[k]);
        }
        let distorted = self.distorted(straight);
        let near = (0..2).all(|k| (distorted[k] - seen[k]).abs() < 1e-9);
        let r = rows(&self.pinhole.r);
        near.then(|| r[0] * straight[0] + r[1] * straight[1] + r[2])
    }
}

/// Two calibrated cameras.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoRig {
    /// The first camera, whose pixels get points, and the second.
    pub cameras: [LensCamera; 2],
    /// σ of disparities that is not from matching, in pixels.
    pub sigma_disparity: f64,
}

/// The mapping from the images of a rig to rectified images.
#[derive(Debug, Clone, PartialEq)]
pub struct Rectification {
    rig: StereoRig,
    /// Columns and rows of the original images.
    sizes: [[usize; 2]; 2],
    /// The rectified cameras, in the frame of the rectified images.
    camera: StereoCamera,
    /// Columns and rows of the rectified images.
    size: [usize; 2],
    world_from_rectified: Pose,
}

impl Rectification {
    /// Rectifies a rig whose images have the given columns and rows.
    ///
    /// # Errors
    /// `Input` for cameras at one position, cameras that look along the baseline or away from each other, and
    /// distortions that cannot be inverted.
    pub fn new(rig: &StereoRig, sizes: [[usize; 2]; 2]) -> Result<Self> {
        let centres = rig.cameras.map(|c| c.pinhole.center());
        let baseline = centres[1] - centres[0];
        let x = baseline
            .try_normalize()
            .ok_or_else(|| Error::input("expected two cameras at different positions, found both at one"))?;
        for (camera, (size, which)) in rig.cameras.iter().zip(sizes.iter().zip(["first", "second"])) {
            refuse_epipole(camera, *size, x, which)?;
        }
        let axes = rig.cameras.map(|c| DVec3::from_array(c.pinhole.r[2]));
        let ahead = axes[0] + axes[1];
        // Perpendicular to the baseline and to the mean axis: among the axes that the baseline permits, the
        // nearest to both cameras.
        let across = ahead.cross(x).try_normalize().filter(|_| axes[0].dot(axes[1]) > 0.0);
        let y = across.ok_or_else(|| {
            Error::input(
                "expected two cameras that view the same object, found \
            axes more than 90° apart or along the baseline",
            )
        })?;
        let rotation = [x, y, x.cross(y)];
        let focals = rig.cameras.map(|c| c.pinhole.k[0][0]);
        // Equal focal lengths are kept exactly, so that images that are rectified already are not resampled.
        let focal = if focals[0] == focals[1] { focals[0] } else { 0.5 * (focals[0] + focals[1]) };
        let boxes = [
            outline(&rig.cameras[0], sizes[0], &rotation, focal)?,
            outline(&rig.cameras[1], sizes[1], &rotation, focal)?,
        ];
        let [low, high] = boxes[0];
        let size = [0, 1].map(|k| {
            let pixels = (high[k] - low[k] - ROUNDING).ceil();
            // Rectifying strongly converging cameras stretches a border without limit.
            pixels.min(MAX_STRETCH * sizes[0][k] as f64) as usize
        });
        // Pixel centres have integer coordinates, so the corner of an image is at −0.5.
        let first = [-0.5 - low[0], -0.5 - low[1]];
        // Both images start at their own left border. The difference of their principal points is `doffs`; a
        // common origin would leave empty columns in one image. Rows are shared, because they must
        // correspond.
        let second = -0.5 - boxes[1][0][0];
        Ok(Self {
            rig: *rig,
            sizes,
            camera: StereoCamera {
                focal,
                center: first,
                baseline: baseline.length(),
                doffs: second - first[0],
                sigma_disparity: rig.sigma_disparity,
            },
            size,
            world_from_rectified: Pose { rotation: from_columns(rotation), translation: centres[0] },
        })
    }

    /// The rectified cameras, in their own frame.
    #[must_use]
    pub fn camera(&self) -> &StereoCamera {
        &self.camera
    }

    /// Pose of the rectified frame, that of the first camera, in the world.
    #[must_use]
    pub fn world_from_rectified(&self) -> &Pose {
        &self.world_from_rectified
    }

    /// The position in the original image of the first (0) or second (1) camera of a position in its
    /// rectified image; `None` outside.
    fn source(&self, which: usize, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
        let doffs = if which == 0 { 0.0 } else { self.camera.doffs };
        let [cx, cy] = self.camera.center;
        let ray = DVec3::new((u - cx - doffs) / self.camera.focal, (v - cy) / self.camera.focal, 1.0);
        let pixel = self.rig.cameras[which].pixel(self.world_from_rectified.rotate(ray))?;
        let [columns, rows] = self.sizes[which];
        // Without snapping, rounding would resample images that are rectified already.
        let snapped = pixel.map(|c| if (c - c.round()).abs() < ROUNDING { c.round() } else { c });
        let inside = |c: f64, n: usize| (0.0..=(n - 1) as f64).contains(&c);
        (inside(snapped[0], columns) && inside(snapped[1], rows)).then_some(snapped)
    }

    /// The rectified image of the first (0) or second (1) camera, by bicubic interpolation; black outside the
    /// original.
    ///
    /// # Errors
    /// `Input` for an image of a different size.
    pub fn picture(&self, which: usize, image: &Image) -> Result<Image> {
        if [image.columns, image.rows] != self.sizes[which] {
            let [columns, rows] = self.sizes[which];
            return Err(Error::input(format!(
                "expected an image of {columns} × {rows} pixels, found {} × {}",
                image.columns, image.rows
            )));
        }
        let [columns, rows] = self.size;
        let mut values = vec![0.0; columns * rows];
        values.par_chunks_mut(columns).enumerate().for_each(|(v, row)| {
            for (u, value) in row.iter_mut().enumerate() {
                let place = self.source(which, [u as f64, v as f64]);
                *value = place.and_then(|[x, y]| image.smoothly_between(x, y)).unwrap_or(0.0);
            }
        });
        Image::try_new(columns, rows, values)
    }

    /// Removes disparities whose pixel in either image lies outside the original, and returns their number.
    #[must_use]
    pub fn without_outside(&self, map: &mut DisparityMap) -> usize {
        let mut outside = 0;
        for k in 0..map.disparity.len() {
            let d = f64::from(map.disparity[k]);
            let place = [(k % map.columns) as f64, (k / map.columns) as f64];
            let seen = self.source(0, place).is_some() && self.source(1, [place[0] - d, place[1]]).is_some();
            if d.is_finite() && !seen {
                (map.disparity[k], map.sigma[k]) = (f32::NAN, f32::NAN);
                outside += 1;
            }
        }
        outside
    }

    /// The selected points of a map of the rectified images as a scan in the world frame: `p = R p_r + c` and
    /// `R C Rᵀ`.
    ///
    /// # Errors
    /// As for [`StereoCamera::scan`].
    pub fn scan(&self, map: &DisparityMap, choice: &StereoPoints, name: &str) -> Result<Scan> {
        let mut scan = self.camera.scan(map, choice, name)?;
        for p in &mut scan.points {
            *p = self.world_from_rectified.apply(*p);
        }
        for c in scan.covariance.iter_mut().flatten() {
            *c = c.rotated(&self.world_from_rectified.rotation);
        }
        scan.viewing = Viewing::Origin(self.world_from_rectified.translation);
        Ok(scan)
    }
}

/// Rejects an image that contains the epipole, or the opposite point: around it rows cannot
/// correspond.
fn refuse_epipole(camera: &LensCamera, [columns, rows]: [usize; 2], along: DVec3, which: &str) -> Result<()> {
    // The other camera may be ahead or behind; `pixel` is `None` for the direction behind this camera.
    for towards in [along, -along] {
        if let Some([u, v]) = camera.pixel(towards) {
            let inside = |c: f64, n: usize| (-0.5..=n as f64 - 0.5).contains(&c);
            if inside(u, columns) && inside(v, rows) {
                return Err(Error::input(format!(
                    "expected cameras that do not look along the line between them, found an epipole \
                     inside the image of the {which} camera, at ({u:.0}, {v:.0})"
                )));
            }
        }
    }
    Ok(())
}

/// The bounding box of an image's outline on the rectified plane, in pixels from the axis.
fn outline(
    camera: &LensCamera,
    [columns, rows]: [usize; 2],
    rotation: &[DVec3; 3],
    focal: f64,
) -> Result<[[f64; 2]; 2]> {
    let mut bounds = BoundingBox::EMPTY;
    let ends = [columns as f64, rows as f64];
    for k in 0..OUTLINE {
        let share = k as f64 / (OUTLINE - 1) as f64;
        // Distortion and projection are continuous, so the extremes of the image lie on its border.
        for place in [[share, 0.0], [share, 1.0], [0.0, share], [1.0, share]] {
            let pixel = [0, 1].map(|d| ends[d] * place[d] - 0.5);
            let direction = camera.direction(pixel).ok_or_else(|| {
                Error::input(format!(
                    "the distortion cannot be inverted at the pixel ({:.0}, {:.0}): expected coefficients \
                     for which it grows along every ray of the image, found {:?}",
                    pixel[0], pixel[1], camera.distortion
                ))
            })?;
            let [x, y, z] = rotation.map(|row| row.dot(direction));
            // About 87° from the rectified axis.
            if z <= 0.05 * direction.length() {
                return Err(Error::input(
                    "expected cameras with similar directions, found ones for which the border of a \
                     rectified image is at infinity",
                ));
            }
            bounds.include([focal * x / z, focal * y / z]);
        }
    }
    Ok([bounds.min, bounds.max])
}

#[cfg(test)]
mod tests;
