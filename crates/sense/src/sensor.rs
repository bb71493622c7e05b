//! Sensor error models: the covariance of one reading.

use planish_core::{DVec3, SymmetricMatrix3};

/// Kind of instrument.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SensorKind {
    /// Range along rays: scanners, depth cameras.
    #[default]
    Range,
    /// A touch probe.
    Touch,
    /// Positions from two cameras, each reading with its own covariance.
    Stereo,
    /// Normals: photometric stereo, crossed stripes. Positions only locate the normals.
    Normal,
    /// Principal curvatures with normals. Positions only locate them.
    Curvature,
}

impl SensorKind {
    /// The name used in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Range => "range",
            Self::Touch => "touch",
            Self::Stereo => "stereo",
            Self::Normal => "normal",
            Self::Curvature => "curvature",
        }
    }

    /// Every kind.
    pub const ALL: [Self; 5] = [Self::Range, Self::Touch, Self::Stereo, Self::Normal, Self::Curvature];

    /// True if the positions of its readings are measurements.
    #[must_use]
    pub fn measures_positions(self) -> bool {
        !matches!(self, Self::Normal | Self::Curvature)
    }
}

/// Standard deviations of a position reading, in the model's unit.
///
/// # Examples
/// ```
/// use planish_sense::Noise;
/// let noise = Noise::Isotropic { sigma: 0.2 };
/// assert_eq!(noise.sigma(), 0.2);
/// assert!((noise.covariance(None).xx - 0.04).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Noise {
    /// The same in every direction.
    Isotropic {
        /// Standard deviation of each coordinate.
        sigma: f64,
    },
    /// Along the ray and across it.
    Ray {
        /// Standard deviation of the range.
        sigma_along: f64,
        /// Standard deviation of each of the two coordinates across the ray.
        sigma_across: f64,
    },
}

impl Noise {
    /// Covariance of a reading along the unit vector `ray`. If the ray is unknown, the σ along the ray is
    /// used in all directions.
    #[must_use]
    pub fn covariance(&self, ray: Option<DVec3>) -> SymmetricMatrix3 {
        let isotropic = |s: f64| SymmetricMatrix3::isotropic(s * s);
        match (*self, ray) {
            (Self::Isotropic { sigma }, _) => isotropic(sigma),
            // Without a viewpoint the direction of the ray is unknown. The larger σ, usually that along the
            // ray, is used everywhere, so that no direction is too certain.
            (Self::Ray { sigma_along, .. }, None) => isotropic(sigma_along),
            (Self::Ray { sigma_along, sigma_across }, Some(r)) => {
                // A sphere of σ across plus a rank-one term along the ray: no axes perpendicular to the ray
                // have to be chosen.
                let extra = sigma_along * sigma_along - sigma_across * sigma_across;
                let mut c = isotropic(sigma_across);
                c.add_outer(extra, r);
                c
            }
        }
    }

    /// The standard deviation along the ray, as the one number for messages and reports.
    #[must_use]
    pub fn sigma(&self) -> f64 {
        match *self {
            Self::Isotropic { sigma } | Self::Ray { sigma_along: sigma, .. } => sigma,
        }
    }
}

/// A sensor that scans refer to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sensor {
    /// Its name in jobs and reports.
    pub name: String,
    /// What it is.
    pub kind: SensorKind,
    /// Its stated noise; `None` if it is to be estimated.
    pub noise: Option<Noise>,
    /// Standard deviation of its normals about each axis in the tangent plane, in degrees, if stated.
    pub sigma_normal_deg: Option<f64>,
    /// Standard deviation of its principal curvatures, in one over the model's unit, if stated.
    pub sigma_curvature: Option<f64>,
    /// Standard deviation of the bias common to all readings of one scan; `None` for no bias. The bias acts
    /// along the rays if they are known, otherwise along the surface normal.
    pub sigma_bias: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ray_noise_has_two_sigmas_along_and_across_the_ray() {
        let noise = Noise::Ray { sigma_along: 3.0, sigma_across: 0.5 };
        let c = noise.covariance(Some(DVec3::new(0.6, 0.0, 0.8)));
        assert!((c.along(DVec3::new(0.6, 0.0, 0.8)) - 9.0).abs() < 1e-12);
        assert!((c.along(DVec3::new(0.8, 0.0, -0.6)) - 0.25).abs() < 1e-12);
        assert!((c.along(DVec3::Y) - 0.25).abs() < 1e-12);
    }
}
