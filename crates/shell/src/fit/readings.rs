//! What a shell is fitted to: points, outlines in views, and features tracked over views.

use crate::camera::Camera;
use planish_estimate::{Error, Result};

/// A point with its noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointReading {
    /// Where.
    pub at: [f64; 3],
    /// Its covariance `[xx, xy, xz, yy, yz, zz]`.
    pub covariance: [f64; 6],
}

impl PointReading {
    /// σ along a direction that need not be a unit vector.
    pub(super) fn sigma(&self, along: [f64; 3]) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.covariance;
        let [x, y, z] = along;
        let variance = xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
        let length = (x * x + y * y + z * z).sqrt();
        // A covariance may be flat, and know a place better than any distance needs.
        let least = 1e-12 * (xx + yy + zz);
        if length > 1e-6 {
            variance.max(least * length * length).sqrt() / length
        } else {
            ((xx + yy + zz) / 3.0).sqrt()
        }
    }
}

/// What the line of sight of a pixel does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutlineKind {
    /// It touches the thing and hits nothing: a place on the border of a mask.
    Border,
    /// It touches the thing somewhere, and may hit other parts before or behind: a place on a contour inside
    /// of the mask.
    Contour,
}

/// A place on an outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlinePoint {
    /// Where, pixel centres at integers.
    pub pixel: [f64; 2],
    /// σ across the outline, in pixels.
    pub sigma_px: f64,
    /// Which kind of outline.
    pub kind: OutlineKind,
}

/// How well a pose is known before: independent errors of its turn and of its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseNoise {
    /// σ of the turn about each axis, in radians.
    pub sigma_rotation: f64,
    /// σ of the place along each axis, in the unit of the mesh.
    pub sigma_translation: f64,
}

/// A view: a camera, and what it sees of the thing.
#[derive(Debug, Clone, PartialEq)]
pub struct ShellView {
    /// The camera.
    pub camera: Camera,
    /// How uncertain its pose is; `None` where it is known.
    pub pose: Option<PoseNoise>,
    /// Places on outlines.
    pub outline: Vec<OutlinePoint>,
    /// Pixels that show the thing.
    pub inside: Vec<[f64; 2]>,
    /// Pixels that do not.
    pub outside: Vec<[f64; 2]>,
}

/// Where a feature is seen in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureObservation {
    /// Index of the view.
    pub view: u32,
    /// Where, pixel centres at integers.
    pub pixel: [f64; 2],
    /// σ along x and along y, in pixels.
    pub sigma_px: f64,
}

/// A feature of the surface, seen in several views.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureTrack {
    /// Where it is seen, at least twice.
    pub observations: Vec<FeatureObservation>,
    /// σ of its distance from the surface: what the deformation cannot follow.
    pub sigma_surface: f64,
}

/// All that a shell is fitted to.
#[derive(Debug, Clone, Copy, Default)]
pub struct ShellReadings<'a> {
    /// Points in space.
    pub points: &'a [PointReading],
    /// Views.
    pub views: &'a [ShellView],
    /// Features tracked over views.
    pub tracks: &'a [FeatureTrack],
}

impl ShellReadings<'_> {
    pub(super) fn check(&self) -> Result<()> {
        let outlines: usize = self.views.iter().map(|view| view.outline.len()).sum();
        if self.points.is_empty() && outlines == 0 && self.tracks.is_empty() {
            return Err(Error::undetermined(
                "a shell cannot be fitted to nothing: no points, no outlines and no tracks were given",
            ));
        }
        for (i, point) in self.points.iter().enumerate() {
            let [xx, _, _, yy, _, zz] = point.covariance;
            let finite = point.at.iter().chain(&point.covariance).all(|x| x.is_finite());
            if !finite || xx + yy + zz <= 0.0 || xx.min(yy).min(zz) < 0.0 {
                return Err(Error::input(format!(
                    "point {i} is not finite or has no positive variance: {:?}, {:?}",
                    point.at, point.covariance
                )));
            }
        }
        let good = |sigma: f64| sigma.is_finite() && sigma > 0.0;
        for (v, view) in self.views.iter().enumerate() {
            if let Some(i) = (view.outline.iter())
                .position(|p| !(good(p.sigma_px) && p.pixel.iter().all(|x| x.is_finite())))
            {
                return Err(Error::input(format!(
                    "view {v}: outline point {i} is not finite or has no positive σ: {:?}",
                    view.outline[i]
                )));
            }
            if let Some(noise) = view.pose.filter(|n| !(good(n.sigma_rotation) && good(n.sigma_translation)))
            {
                return Err(Error::input(format!(
                    "view {v}: needed positive σ of an uncertain pose, found {noise:?}"
                )));
            }
            if (view.inside.iter().chain(&view.outside).flatten()).any(|x| !x.is_finite()) {
                return Err(Error::input(format!("view {v}: a pixel inside or outside is not finite")));
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
                    "track {i}: needed a view below {}, a finite pixel and a positive σ, found {bad:?}",
                    self.views.len()
                )));
            }
            if track.observations.len() < 2 || !good(track.sigma_surface) {
                return Err(Error::input(format!(
                    "track {i} needs two observations and a positive σ of the surface, found {} and {}",
                    track.observations.len(),
                    track.sigma_surface
                )));
            }
        }
        Ok(())
    }
}
