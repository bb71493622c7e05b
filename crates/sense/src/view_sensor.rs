//! A range sensor with a field of view: its rays, and the covariance of one reading.

use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// A range sensor with a field of view, in the pinhole frame: x right, y down, z forward.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewSensor {
    /// Borders of its image at distance 1 along the axis (tangents of angles): left and right, top and
    /// bottom.
    pub borders: [[f64; 2]; 2],
    /// Number of rays along x and along y, evenly spaced over the image.
    pub rays: [usize; 2],
    /// Minimum and maximum range, along the ray.
    pub range: [f64; 2],
    /// The largest angle between a ray and the surface's normal.
    pub max_incidence_rad: f64,
    /// σ of a range at distance zero, along the ray.
    pub sigma_along: f64,
    /// σ of each of the two coordinates across the ray.
    pub sigma_across: f64,
    /// Increase of σ along the ray with the square of the range, in one over the unit.
    pub sigma_per_range2: f64,
    /// True if σ along the ray is divided by the cosine of incidence.
    pub over_cosine: bool,
}

impl ViewSensor {
    /// Borders of an image symmetric about the axis, from the full angles of view.
    ///
    /// # Examples
    /// ```
    /// use planish_sense::ViewSensor;
    /// let borders = ViewSensor::borders_of_angles([std::f64::consts::FRAC_PI_2; 2]);
    /// assert!((borders[0][1] - 1.0).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn borders_of_angles(angles_rad: [f64; 2]) -> [[f64; 2]; 2] {
        angles_rad.map(|angle| [-(0.5 * angle).tan(), (0.5 * angle).tan()])
    }

    /// Checks that all values are in range.
    ///
    /// # Errors
    /// `Input` for numbers that are not finite or out of range, with their names.
    pub fn sanity_check(&self) -> Result<()> {
        let [near, far] = self.range;
        let spans = self.borders.iter().all(|[low, high]| low < high && low.is_finite() && high.is_finite());
        // Saturating, so that absurd numbers from a file are reported instead of overflowing.
        let rays: usize = self.rays[0].saturating_mul(self.rays[1]);
        let complaint = if !spans {
            format!("a field of view with left < right and top < bottom, found {:?}", self.borders)
        } else if !(1..=1 << 28).contains(&rays) {
            format!("from 1 to 2^28 rays, found {} × {}", self.rays[0], self.rays[1])
        } else if !(near > 0.0 && far > near && far.is_finite()) {
            format!("0 < nearest < farthest range, found {near} and {far}")
        } else if !(self.max_incidence_rad > 0.0 && self.max_incidence_rad < std::f64::consts::FRAC_PI_2) {
            format!(
                "a largest incidence above 0° and below 90°, found {}°",
                self.max_incidence_rad.to_degrees()
            )
        } else if !(self.sigma_along > 0.0 && self.sigma_along.is_finite()) {
            format!("σ along the ray above 0, found {}", self.sigma_along)
        } else if !(self.sigma_across > 0.0 && self.sigma_across.is_finite()) {
            format!("σ across the ray above 0, found {}", self.sigma_across)
        } else if !(self.sigma_per_range2 >= 0.0 && self.sigma_per_range2.is_finite()) {
            format!("a growth of σ that is not negative, found {}", self.sigma_per_range2)
        } else {
            return Ok(());
        };
        Err(Error::input(format!("expected {complaint}")))
    }

    /// The same sensor in a unit of which `factor` make one old unit.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            range: self.range.map(|r| factor * r),
            sigma_along: factor * self.sigma_along,
            sigma_across: factor * self.sigma_across,
            // σ per squared range has the unit of an inverse length.
            sigma_per_range2: self.sigma_per_range2 / factor,
            ..*self
        }
    }

    /// The unit direction of an image position, given as shares of the width and height.
    #[must_use]
    pub fn direction(&self, share: [f64; 2]) -> DVec3 {
        let at = |k: usize| self.borders[k][0] + share[k] * (self.borders[k][1] - self.borders[k][0]);
        DVec3::new(at(0), at(1), 1.0).try_normalize().unwrap_or(DVec3::Z)
    }

    /// True if a point in the sensor's frame is within the field of view and the range.
    #[must_use]
    pub fn reaches(&self, DVec3 { x, y, z }: DVec3) -> bool {
        let range = (x * x + y * y + z * z).sqrt();
        let inside = |value: f64, [low, high]: [f64; 2]| value >= low * z && value <= high * z;
        // Points behind the sensor would satisfy the proportions of the borders with both signs exchanged.
        z > 0.0
            && inside(x, self.borders[0])
            && inside(y, self.borders[1])
            && range >= self.range[0]
            && range <= self.range[1]
    }

    /// Number of rays that hit a small area at a point in the sensor's frame: `n A cos θ / (d² cos³ φ)`, with
    /// the incidence θ, the angle φ to the axis, and `n` rays per unit area of the image at distance 1.
    #[must_use]
    pub fn rays_on(&self, DVec3 { x, y, z }: DVec3, area: f64, incidence_cosine: f64) -> f64 {
        let distance2 = x * x + y * y + z * z;
        let off_axis = z / distance2.sqrt();
        let picture: f64 = self.borders.iter().map(|[low, high]| high - low).product();
        let density = self.rays[0] as f64 * self.rays[1] as f64 / picture;
        // Rays are evenly spaced on the image plane. Its element of area is larger than that of solid angle
        // by `1/cos³` of the angle from the axis.
        density * area * incidence_cosine / (distance2 * off_axis.powi(3))
    }

    /// True if a surface with this cosine of incidence gives a reading.
    #[must_use]
    pub fn accepts(&self, incidence_cosine: f64) -> bool {
        incidence_cosine >= self.max_incidence_rad.cos()
    }

    /// The variance of a reading along the surface normal, `nᵀ R n = σ_along² cos² θ + σ_across² sin² θ` with
    /// `σ_along = σ + k d²`, divided by `cos θ` if `over_cosine` is set.
    #[must_use]
    pub fn variance_along_normal(&self, range: f64, incidence_cosine: f64) -> f64 {
        let square = incidence_cosine * incidence_cosine;
        let [along, across] = [self.noise(range, incidence_cosine), self.sigma_across].map(|s| s * s);
        along * square + across * (1.0 - square).max(0.0)
    }

    /// σ along the ray of a reading.
    #[must_use]
    pub fn noise(&self, range: f64, incidence_cosine: f64) -> f64 {
        let straight = self.sigma_along + self.sigma_per_range2 * range * range;
        if self.over_cosine { straight / incidence_cosine } else { straight }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor() -> ViewSensor {
        ViewSensor {
            borders: ViewSensor::borders_of_angles([0.8, 0.6]),
            rays: [640, 480],
            range: [2.0, 9.0],
            max_incidence_rad: 1.0,
            sigma_along: 0.1,
            sigma_across: 0.02,
            sigma_per_range2: 0.01,
            over_cosine: false,
        }
    }

    #[test]
    fn variance_equals_the_covariance_along_the_normal() {
        let sensor = sensor();
        for (range, tilt) in [(3.0_f64, 0.0_f64), (5.0, 0.7)] {
            let ray = DVec3::new(0.0, 0.6, 0.8);
            let normal = DVec3::new(tilt.sin(), 0.6 * tilt.cos(), 0.8 * tilt.cos());
            let noise = crate::Noise::Ray { sigma_along: 0.1 + 0.01 * range * range, sigma_across: 0.02 };
            let expected = noise.covariance(Some(ray)).along(normal);
            let found = sensor.variance_along_normal(range, ray.dot(normal));
            assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
        }
    }

    #[test]
    fn ray_density_agrees_with_a_count() {
        let sensor = sensor();
        // A square of side 0.5 about (0.6, -0.4, 4), square to the axis.
        let (middle, half) = (DVec3::new(0.6, -0.4, 4.0), 0.25);
        let hits = (0..640 * 480)
            .map(|k| {
                let d = sensor
                    .direction([(f64::from(k % 640) + 0.5) / 640.0, (f64::from(k / 640) + 0.5) / 480.0]);
                4.0 / d[2] * d
            })
            .filter(|p| (p[0] - middle[0]).abs() < half && (p[1] - middle[1]).abs() < half)
            .count();
        let cosine = 4.0 / middle.length();
        let expected = sensor.rays_on(middle, 0.25, cosine);
        assert!((expected / hits as f64 - 1.0).abs() < 0.02, "{expected} {hits}");
        assert!(
            sensor.reaches(middle)
                && !sensor.reaches(DVec3::new(0.6, -0.4, -4.0))
                && !sensor.reaches(DVec3::new(0.6, -0.4, 1.0))
        );
        assert!(!sensor.reaches(DVec3::new(0.0, 1.4, 4.0)) && !sensor.reaches(DVec3::new(0.0, 0.0, 9.1)));
    }

    #[test]
    fn readings_scale_with_the_unit() {
        let (mm, m) = (sensor().scaled(1000.0), sensor());
        let [a, b] = [mm.variance_along_normal(4000.0, 0.8), m.variance_along_normal(4.0, 0.8)];
        assert!((a / b / 1e6 - 1.0).abs() < 1e-12);
        assert_eq!(mm.borders, m.borders);
    }

    #[test]
    fn messages_name_the_invalid_value() {
        let with = |change: fn(&mut ViewSensor)| {
            let mut sensor = sensor();
            change(&mut sensor);
            sensor.sanity_check().unwrap_err().to_string()
        };
        assert!(sensor().sanity_check().is_ok());
        assert!(with(|s| s.range = [3.0, 2.0]).contains("nearest < farthest"));
        assert!(with(|s| s.max_incidence_rad = 1.6).contains("below 90°"));
        assert!(with(|s| s.sigma_along = 0.0).contains("along the ray above 0"));
        assert!(with(|s| s.rays = [0, 4]).contains("0 × 4"));
        assert!(with(|s| s.borders[1] = [0.1, 0.1]).contains("field of view"));
    }
}
