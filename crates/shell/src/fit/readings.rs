//! The readings that a shell is fitted to: points, outlines in views, and features tracked over views.

use crate::camera::Camera;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::{Error, Result};

/// A measured point with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointReading {
    /// Position, in the unit of the mesh.
    pub at: DVec3,
    /// Its covariance.
    pub covariance: SymmetricMatrix3,
}

impl PointReading {
    /// σ along a direction that need not be a unit vector.
    pub(super) fn sigma(&self, along: DVec3) -> f64 {
        let SymmetricMatrix3 { xx, xy, xz, yy, yz, zz } = self.covariance;
        let DVec3 { x, y, z } = along;
        let variance = xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
        // Gradients of the field are shorter than one near edges; the σ belongs to the unit direction.
        let length = (x * x + y * y + z * z).sqrt();
        // A covariance may be singular; the floor keeps the weight of the equation finite.
        let floor = 1e-12 * (xx + yy + zz);
        if length > 1e-6 {
            variance.max(floor * length * length).sqrt() / length
        } else {
            ((xx + yy + zz) / 3.0).sqrt()
        }
    }
}

/// How the line of sight of an outline pixel meets the object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutlineKind {
    /// It touches the object and hits nothing: a point on the border of a mask.
    Border,
    /// It touches the object and may hit other parts in front or behind: a point on a contour inside the
    /// mask.
    Contour,
}

/// A point on an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlinePoint {
    /// Image position in pixels; pixel centres are at integers.
    pub pixel: [f64; 2],
    /// σ across the outline, in pixels.
    pub sigma_px: f64,
    /// The kind of outline.
    pub kind: OutlineKind,
}

/// Prior σ of a camera pose, with independent errors of rotation and position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseNoise {
    /// σ of the rotation about each axis, in radians.
    pub sigma_rotation: f64,
    /// σ of the position along each axis, in the unit of the mesh.
    pub sigma_translation: f64,
}

/// A camera and what its image shows of the object.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellView {
    /// The camera.
    pub camera: Camera,
    /// σ of its pose; `None` if the pose is known exactly.
    pub pose: Option<PoseNoise>,
    /// Points on outlines.
    pub outline: Vec<OutlinePoint>,
    /// Pixels that show the object.
    pub inside: Vec<[f64; 2]>,
    /// Pixels that do not.
    pub outside: Vec<[f64; 2]>,
}

/// Position of a feature in the image of one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureObservation {
    /// Index of the view.
    pub view: u32,
    /// Image position in pixels; pixel centres are at integers.
    pub pixel: [f64; 2],
    /// σ along x and along y, in pixels.
    pub sigma_px: f64,
}

/// A feature of the surface, seen in several views.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureTrack {
    /// Its observations, at least two.
    pub observations: Vec<FeatureObservation>,
    /// σ of its distance from the surface: shape that the deformation cannot represent.
    pub sigma_surface: f64,
}

/// A place of the mesh and its measured position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkReading {
    /// Vertices of the mesh around the place.
    pub vertices: [u32; 3],
    /// Their weights, with the sum 1.
    pub weights: [f64; 3],
    /// The measured position.
    pub at: DVec3,
    /// Its covariance.
    pub covariance: SymmetricMatrix3,
}

/// All readings of a fit.
#[derive(Debug, Clone, Copy, Default)]
pub struct ShellReadings<'a> {
    /// Points in space.
    pub points: &'a [PointReading],
    /// Views.
    pub views: &'a [ShellView],
    /// Features tracked over views.
    pub tracks: &'a [FeatureTrack],
    /// Places of the mesh with measured positions.
    pub landmarks: &'a [LandmarkReading],
}

impl ShellReadings<'_> {
    /// Checks the readings of a mesh with a number of vertices.
    pub(super) fn check(&self, vertices: usize) -> Result<()> {
        let outlines: usize = self.views.iter().map(|view| view.outline.len()).sum();
        let without_outlines = self.points.is_empty() && self.tracks.is_empty() && self.landmarks.is_empty();
        if without_outlines && outlines == 0 {
            return Err(Error::undetermined(
                "expected points, outlines, tracks or landmarks for a shell fit, found none",
            ));
        }
        for (i, landmark) in self.landmarks.iter().enumerate() {
            let SymmetricMatrix3 { xx, yy, zz, .. } = landmark.covariance;
            let is_finite = landmark.at.is_finite() && landmark.covariance.is_finite();
            let is_on_mesh = landmark.vertices.iter().all(|v| (*v as usize) < vertices)
                && (landmark.weights.iter().sum::<f64>() - 1.0).abs() < 1e-6;
            if !is_finite || !is_on_mesh || xx.min(yy).min(zz) < 0.0 || xx + yy + zz <= 0.0 {
                return Err(Error::input(format!(
                    "landmark {i}: expected a place on the mesh, a finite position and a positive variance, \
                     found {landmark:?}"
                )));
            }
        }
        // Single directions may be exact, such as heights of a grid; a point without any error would have
        // infinite weight.
        for (i, point) in self.points.iter().enumerate() {
            let SymmetricMatrix3 { xx, yy, zz, .. } = point.covariance;
            let finite = point.at.is_finite() && point.covariance.is_finite();
            if !finite || xx + yy + zz <= 0.0 || xx.min(yy).min(zz) < 0.0 {
                return Err(Error::input(format!(
                    "point {i}: expected finite coordinates and a positive variance, found {:?} and {:?}",
                    point.at.to_array(),
                    point.covariance.to_array()
                )));
            }
        }
        let good = |sigma: f64| sigma.is_finite() && sigma > 0.0;
        for (v, view) in self.views.iter().enumerate() {
            if let Some(i) = (view.outline.iter())
                .position(|p| !(good(p.sigma_px) && p.pixel.iter().all(|x| x.is_finite())))
            {
                return Err(Error::input(format!(
                    "view {v}: outline point {i}: expected finite coordinates and σ > 0, found {:?}",
                    view.outline[i]
                )));
            }
            if let Some(noise) = view.pose.filter(|n| !(good(n.sigma_rotation) && good(n.sigma_translation)))
            {
                return Err(Error::input(format!(
                    "view {v}: expected positive σ of an uncertain pose, found {noise:?}"
                )));
            }
            if (view.inside.iter().chain(&view.outside).flatten()).any(|x| !x.is_finite()) {
                return Err(Error::input(format!(
                    "view {v}: expected finite coordinates of the pixels inside and outside"
                )));
            }
        }
        for (i, track) in self.tracks.iter().enumerate() {
            let bad = (track.observations.iter()).find(|s| {
                s.view as usize >= self.views.len()
                    || !good(s.sigma_px)
                    || s.pixel.iter().any(|x| !x.is_finite())
            });
            if let Some(bad) = bad {
                return Err(Error::input(format!(
                    "track {i}: expected a view below {}, a finite pixel and a positive σ, found {bad:?}",
                    self.views.len()
                )));
            }
            if track.observations.len() < 2 || !good(track.sigma_surface) {
                return Err(Error::input(format!(
                    "track {i}: expected at least two observations and σ > 0 of the surface, found {} and \
                     {}",
                    track.observations.len(),
                    track.sigma_surface
                )));
            }
        }
        Ok(())
    }
}
