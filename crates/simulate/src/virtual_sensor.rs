//! Sensors that measure a known surface.
//!
//! Input: a [`Truth`], the pose of the sensor and its noise. Output: a [`Scan`] in the frame of the sensor,
//! and the true value of each reading. Every reading has its own stream of random numbers. Dropping one
//! changes no other, and the result does not depend on the number of threads.
//!
//! Not modelled: mixed readings at depth edges and correlated errors.

use super::truth::{Truth, TruthPoint, positive};
use planish_core::{DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use planish_sense::{Noise, Pose, RangeGrid, Scan, Viewing, ray_at};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;

/// The true value of a simulated reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueReading {
    /// The measured point of the true surface, in the world frame.
    pub point: TruthPoint,
    /// True if the reading is an outlier.
    pub outlier: bool,
    /// True σ of the reading divided by that of the sensor; 1 unless the σ of the sensor is uneven.
    pub noise_factor: f64,
}

/// A scan with the true value of each reading.
#[derive(Debug, Clone)]
pub struct VirtualScan {
    /// The readings, in the frame of the sensor.
    pub scan: Scan,
    /// True values, in the order of the points.
    pub truth: Vec<TrueReading>,
}

/// A surface that a range scanner can measure.
pub trait ScannedSurface: Sync {
    /// The first point where a ray meets the surface; `direction` is a unit vector.
    fn first_point(&self, origin: DVec3, direction: DVec3) -> Option<TruthPoint>;
}

impl ScannedSurface for Truth {
    fn first_point(&self, origin: DVec3, direction: DVec3) -> Option<TruthPoint> {
        self.first_hit(origin, direction).map(|(point, _)| point)
    }
}

/// The rays of a range scanner, in its own frame.
///
/// It looks along −z. Columns run along x, rows along y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optics {
    /// Parallel rays from a rectangle around the origin.
    Parallel {
        /// Half the sides of the rectangle, in the model's unit.
        half: [f64; 2],
    },
    /// Rays from the origin through a rectangle at distance 1.
    Central {
        /// Half the sides of the rectangle: tangents of half the field of view.
        tangents: [f64; 2],
    },
}

/// A range scanner: a grid of rays that measures visible points, except at grazing angles.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::{Noise, Pose};
/// use planish_simulate::{Optics, Truth, VirtualScanner};
/// use planish_spline::Shape;
/// # fn main() -> planish_estimate::Result<()> {
/// let truth = Truth::freeform(Shape::Ball, 100.0, 2)?;
/// let pose = Pose { translation: DVec3::new(0.0, 0.0, 300.0), ..Pose::identity() };
/// let optics = Optics::Central { tangents: [0.25; 2] };
/// let scanner = VirtualScanner {
///     outlier_share: 0.05,
///     outlier_size: 10.0,
///     ..VirtualScanner::new("front", pose, optics, [30, 30], Noise::Isotropic { sigma: 0.1 })
/// };
/// let measured = scanner.scan(&truth, 1)?;
/// assert_eq!(measured.scan.points.len(), scanner.count(&truth));
/// assert!(measured.truth.iter().any(|reading| reading.outlier));
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct VirtualScanner {
    /// Name of the scan.
    pub name: String,
    /// Pose of the scanner.
    pub world_from_scanner: Pose,
    /// The rays.
    pub optics: Optics,
    /// Columns and rows of the grid.
    pub grid: [usize; 2],
    /// True noise in the middle of the field of view.
    pub noise: Noise,
    /// Relative increase of σ from the middle of the field of view to its corners, with the square of the
    /// distance.
    pub unevenness: f64,
    /// True σ divided by the σ that readings state; only readings of a scanner with uneven σ state one.
    pub misstatement: f64,
    /// Maximum angle between ray and normal, in degrees; grazing readings are dropped.
    pub grazing_deg: f64,
    /// Share of readings that are outliers along the ray.
    pub outlier_share: f64,
    /// Largest error of an outlier, in the unit of the model; the smallest is a tenth of it and at least 10
    /// σ.
    pub outlier_size: f64,
    /// True if the scan keeps its grid.
    pub organised: bool,
    /// σ of measured normals about each of two tangents, in degrees; `None` if no normals are measured.
    pub sigma_normal_deg: Option<f64>,
}

impl VirtualScanner {
    /// A scanner with default settings: even and correctly stated σ, no outliers, readings up to 75°,
    /// organised, no normals.
    #[must_use]
    pub fn new(name: &str, world_from_scanner: Pose, optics: Optics, grid: [usize; 2], noise: Noise) -> Self {
        Self {
            name: name.to_owned(),
            world_from_scanner,
            optics,
            grid,
            noise,
            unevenness: 0.0,
            misstatement: 1.0,
            grazing_deg: 75.0,
            outlier_share: 0.0,
            outlier_size: 0.0,
            organised: true,
            sigma_normal_deg: None,
        }
    }

    /// The direction or the centre of its rays, in its own frame.
    #[must_use]
    pub fn viewing(&self) -> Viewing {
        match self.optics {
            Optics::Parallel { .. } => Viewing::Direction(DVec3::new(0.0, 0.0, -1.0)),
            Optics::Central { .. } => Viewing::Origin(DVec3::ZERO),
        }
    }

    /// Rejects settings out of range.
    ///
    /// # Errors
    /// `Input` for an empty grid, sizes or σ that are not positive, a share outside [0, 1).
    pub fn sanity_check(&self) -> Result<()> {
        check_noise(self.noise)?;
        let (Optics::Parallel { half: sides } | Optics::Central { tangents: sides }) = self.optics;
        for side in sides {
            positive("sides of the field of view", side)?;
        }
        positive("misstatement", self.misstatement)?;
        if self.grid[0].checked_mul(self.grid[1]).is_none_or(|cells| cells == 0 || cells >= u32::MAX as usize)
        {
            return Err(Error::input(format!(
                "expected a grid of 1 to {} cells, found {:?}",
                u32::MAX - 1,
                self.grid
            )));
        }
        // Written with a negation, so that NaN is rejected, too.
        if !(self.unevenness >= 0.0 && self.unevenness.is_finite()) {
            return Err(Error::input(format!(
                "expected unevenness of at least 0, found {}",
                self.unevenness
            )));
        }
        if !(0.0..1.0).contains(&self.outlier_share) {
            return Err(Error::input(format!(
                "expected an outlier share in [0, 1), found {}",
                self.outlier_share
            )));
        }
        if self.outlier_share > 0.0 {
            positive("outlier size", self.outlier_size)?;
        }
        if let Some(sigma) = self.sigma_normal_deg {
            positive("the σ of normals", sigma)?;
        }
        Ok(())
    }

    /// Origin and unit direction of the ray of a cell in the frame of the scanner, and the square of its
    /// distance from the middle of the field of view, which is 1 at the corners.
    fn ray(&self, cell: usize) -> (DVec3, DVec3, f64) {
        let index = [cell % self.grid[0], cell / self.grid[0]];
        // Centres of the cells, from −1 to 1, so that no ray lies on the edge of the field of view.
        let [a, b] = [0, 1].map(|k| (2 * index[k] + 1) as f64 / self.grid[k] as f64 - 1.0);
        let rho2 = 0.5 * (a * a + b * b);
        match self.optics {
            Optics::Parallel { half } => {
                (DVec3::new(a * half[0], b * half[1], 0.0), DVec3::new(0.0, 0.0, -1.0), rho2)
            }
            Optics::Central { tangents } => {
                let d = DVec3::new(a * tangents[0], b * tangents[1], -1.0);
                (DVec3::ZERO, d.try_normalize().unwrap_or(DVec3::new(0.0, 0.0, -1.0)), rho2)
            }
        }
    }

    /// The point that the ray of a cell measures, if it meets the surface from the front and not grazing.
    fn measured_point(&self, surface: &impl ScannedSurface, cell: usize) -> Option<TruthPoint> {
        let (origin, direction, _) = self.ray(cell);
        let direction = self.world_from_scanner.rotate(direction);
        let point = surface.first_point(self.world_from_scanner.apply(origin), direction)?;
        (-point.normal.dot(direction) > self.grazing_deg.to_radians().cos()).then_some(point)
    }

    /// Number of rays that give a reading. Cost: one ray per cell.
    #[must_use]
    pub fn count(&self, surface: &impl ScannedSurface) -> usize {
        let cells = self.grid[0] * self.grid[1];
        (0..cells).into_par_iter().filter(|&cell| self.measured_point(surface, cell).is_some()).count()
    }

    /// Scans a surface. The same seed gives the same bytes. Cost: one ray per cell, in parallel.
    ///
    /// # Errors
    /// As [`VirtualScanner::sanity_check`].
    pub fn scan(&self, surface: &impl ScannedSurface, seed: u64) -> Result<VirtualScan> {
        self.sanity_check()?;
        let scanner_from_world = self.world_from_scanner.inverse();
        let cells = self.grid[0] * self.grid[1];
        let read = |cell: usize| -> Option<(DVec3, DVec3, DVec3, TrueReading)> {
            let point = self.measured_point(surface, cell)?;
            let (_, ray, rho2) = self.ray(cell);
            let noise_factor = 1.0 + self.unevenness * rho2;
            // One stream of random numbers per cell, and outliers drawn after the noise: other options for
            // outliers leave the noise of all readings as it was.
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(cell as u64);
            let mut z =
                scanner_from_world.apply(point.position) + draw(self.noise, ray, noise_factor, &mut rng);
            let outlier = rng.random::<f64>() < self.outlier_share;
            if outlier {
                // At least 10 σ: a smaller outlier is hardly an outlier, and a gate could not be judged
                // by it.
                let smallest = (0.1 * self.outlier_size).max(10.0 * noise_factor * self.noise.sigma());
                let largest = self.outlier_size.max(2.0 * smallest);
                let size = smallest + (largest - smallest) * rng.random::<f64>();
                let side = if rng.random::<bool>() { 1.0 } else { -1.0 };
                z += side * size * ray;
            }
            // Drawn last, so that normals leave all other numbers as they were.
            let normal = self.sigma_normal_deg.map_or(DVec3::ZERO, |sigma_deg| {
                scanner_from_world.rotate(turned(point.normal, sigma_deg.to_radians(), &mut rng))
            });
            Some((z, ray, normal, TrueReading { point, outlier, noise_factor }))
        };
        // Collected in the order of the cells. A single ray is too short for a parallel task.
        let readings: Vec<_> = (0..cells).into_par_iter().with_min_len(256).map(read).collect();

        let viewing = self.viewing();
        let mut scan = Scan {
            name: self.name.clone(),
            viewing,
            world_from_scanner: self.world_from_scanner,
            ..Scan::default()
        };
        let mut grid = Vec::with_capacity(cells);
        let mut seen = Vec::new();
        let mut normals = Vec::new();
        let (mut sigma, mut covariance) = (Vec::new(), Vec::new());
        for reading in readings {
            grid.push(reading.map_or(RangeGrid::EMPTY, |_| scan.points.len() as u32));
            // The grid has an entry for every cell, the points only for readings.
            let Some((z, ray, normal, reading)) = reading else {
                continue;
            };
            let stated = scaled(self.noise, reading.noise_factor / self.misstatement);
            match stated {
                Noise::Isotropic { sigma: s } => sigma.push(s),
                Noise::Ray { .. } => {
                    // A real scanner knows the ray only from its noisy point; a fit computes it in this way,
                    // too.
                    covariance.push(stated.covariance(Some(ray_at(viewing, z).unwrap_or(ray))))
                }
            }
            scan.points.push(z);
            normals.push(normal);
            seen.push(reading);
        }
        if let Some(sigma_deg) = self.sigma_normal_deg {
            scan.sigma_normal_deg = Some(vec![sigma_deg; normals.len()]);
            scan.normals = Some(normals);
        }
        // With even σ, the value of the sensor in the job suffices.
        if self.unevenness > 0.0 {
            scan.sigma = Some(sigma).filter(|s| !s.is_empty());
            scan.covariance = Some(covariance).filter(|c| !c.is_empty());
        }
        if self.organised {
            scan.grid = Some(RangeGrid { columns: self.grid[0], rows: self.grid[1], cells: grid });
        }
        Ok(VirtualScan { scan, truth: seen })
    }
}

/// A touch probe: few points, uniform over the surface, with a small error.
#[derive(Debug, Clone, PartialEq)]
pub struct VirtualProbe {
    /// Name of the scan.
    pub name: String,
    /// Pose of its frame.
    pub world_from_probe: Pose,
    /// Number of points.
    pub points: usize,
    /// True σ in every direction.
    pub sigma: f64,
}

impl VirtualProbe {
    /// Measures a surface at random points, uniform per area.
    ///
    /// # Errors
    /// `Input` for a σ that is not positive.
    ///
    /// # Examples
    /// ```
    /// use planish_sense::Pose;
    /// use planish_simulate::{Truth, VirtualProbe};
    /// use planish_spline::Shape;
    /// # fn main() -> planish_estimate::Result<()> {
    /// let truth = Truth::freeform(Shape::Sheet, 100.0, 2)?;
    /// let world_from_probe = Pose::identity();
    /// let probe = VirtualProbe { name: "probe".to_owned(), world_from_probe, points: 20, sigma: 0.004 };
    /// let measured = probe.scan(&truth, 1)?;
    /// let foot = truth.foot(measured.scan.points[0]).expect("readings are finite");
    /// assert!(measured.scan.points.len() == 20 && foot.signed_distance.abs() < 0.04);
    /// # Ok(())
    /// # }
    /// ```
    pub fn scan(&self, truth: &Truth, seed: u64) -> Result<VirtualScan> {
        positive("sigma", self.sigma)?;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let probe_from_world = self.world_from_probe.inverse();
        // Points first, errors afterwards: another σ touches the same points.
        let touched = truth.sample_area_uniform(self.points, &mut rng);
        let mut scan =
            Scan { name: self.name.clone(), world_from_scanner: self.world_from_probe, ..Scan::default() };
        let noise = Noise::Isotropic { sigma: self.sigma };
        let mut seen = Vec::with_capacity(touched.len());
        for point in touched {
            let error = draw(noise, DVec3::Z, 1.0, &mut rng);
            scan.points.push(probe_from_world.apply(point.position) + error);
            seen.push(TrueReading { point, outlier: false, noise_factor: 1.0 });
        }
        Ok(VirtualScan { scan, truth: seen })
    }
}

/// The noise with every σ multiplied by a factor.
pub(super) fn scaled(noise: Noise, factor: f64) -> Noise {
    match noise {
        Noise::Isotropic { sigma } => Noise::Isotropic { sigma: factor * sigma },
        Noise::Ray { sigma_along, sigma_across } => {
            Noise::Ray { sigma_along: factor * sigma_along, sigma_across: factor * sigma_across }
        }
    }
}

/// A random Gaussian error of a reading on this unit ray, with σ multiplied by a factor.
fn draw(noise: Noise, ray: DVec3, factor: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    let [a, b, c] = [0; 3].map(|_| factor * rng.sample::<f64, _>(StandardNormal));
    match noise {
        Noise::Isotropic { sigma } => sigma * DVec3::new(a, b, c),
        Noise::Ray { sigma_along, sigma_across } => {
            let (e1, e2) = tangents(ray);
            sigma_along * a * ray + sigma_across * b * e1 + sigma_across * c * e2
        }
    }
}

/// A unit vector that is turned by Gaussian angles about two tangents.
fn turned(normal: DVec3, sigma_rad: f64, rng: &mut ChaCha8Rng) -> DVec3 {
    let (e1, e2) = tangents(normal);
    let [a, b] = [0; 2].map(|_| sigma_rad * rng.sample::<f64, _>(StandardNormal));
    (normal + a * e1 + b * e2).try_normalize().unwrap_or(normal)
}

/// Rejects a σ that is not positive and finite.
fn check_noise(noise: Noise) -> Result<()> {
    match noise {
        Noise::Isotropic { sigma } => positive("sigma", sigma)?,
        Noise::Ray { sigma_along, sigma_across } => {
            positive("sigma_along", sigma_along)?;
            positive("sigma_across", sigma_across)?
        }
    };
    Ok(())
}
