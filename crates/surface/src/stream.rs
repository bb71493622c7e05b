//! A surface from readings that arrive one at a time: the patch filter for a live sensor.
//!
//! Input: some hundred first readings, then positions, normals and curvatures in any order. Output: the
//! surface and its σ at any time, and snapshots from which a later program continues. Memory is that of the
//! patches, whatever the number of readings.
//!
//! Parameters are not known: every reading gets a foot point on the current surface and acts along the normal
//! there. Readings far from the expected value are rejected. If most readings of a place are far, they are
//! shape, and its patch is divided.
//!
//! Not guaranteed: the accuracy of [`crate::fit::fit`], which uses every reading repeatedly. Readings
//! filtered into a coarse patch carry no information about finer detail. The first readings must roughly
//! cover a closed shape, since its topology and base are chosen from them.

use crate::fit::{FirstFit, FitOptions, first_fit_of, with_neighbours};
use crate::model::{Knowledge, Observed, SensorReport, Support, SurfaceModel};
use crate::observe::{ObservationOptions, Observations, RejectionCause};
use crate::patch_stream::{IncomingReading, PatchRules, ReadingValue, StreamingFilter};
use crate::saved::{Session, load_with_provenance, save};
use crate::subdivision::{LevelRefinement, RefineBy};
use planish_core::Silent;
use planish_core::SymmetricMatrix3;
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_sense::{Scan, Sensor};
use planish_spline::{Shape, Surface, curvature_tensor};
use std::path::Path;
use std::sync::Arc;

/// Settings of a stream.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamOptions {
    /// Topology; if none is given, it is chosen from the first readings.
    pub shape: Option<Shape>,
    /// Unit of every length.
    pub unit: Unit,
    /// Maximum subdivision depth beyond the base grid (default 3).
    pub max_depth: Option<u8>,
    /// Criterion for subdivision.
    pub refine_by: RefineBy,
    /// Reject readings more than this many σ from the expected value.
    pub gate: f64,
    /// Approximate maximum of control vertices.
    pub max_coefficients: usize,
}

impl Default for StreamOptions {
    fn default() -> Self {
        let FitOptions { shape, max_depth, refine_by, gate, max_coefficients, .. } = FitOptions::default();
        Self { shape, unit: Unit::Millimetre, max_depth, refine_by, gate, max_coefficients }
    }
}

/// One reading, in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// A position.
    Position {
        /// The point.
        point: DVec3,
        /// Its covariance.
        covariance: SymmetricMatrix3,
        /// Unit vector from the surface towards the sensor, if known. It separates the two sides of a thin
        /// part.
        facing: Option<DVec3>,
    },
    /// A unit normal.
    Normal {
        /// Approximate position, good enough to find the foot point.
        at: DVec3,
        /// The measured unit normal.
        normal: DVec3,
        /// σ of its tilt in any direction, in radians.
        sigma_rad: f64,
    },
    /// Principal curvatures, positive where the surface bends towards the normal.
    Curvature {
        /// Approximate position, good enough to find the foot point.
        at: DVec3,
        /// The unit normal.
        normal: DVec3,
        /// The direction of the first curvature.
        direction: DVec3,
        /// κ1 and κ2, in one over the unit.
        principal: [f64; 2],
        /// σ of either.
        sigma: f64,
    },
}

impl Reading {
    /// A position with isotropic noise.
    #[must_use]
    pub fn position(point: DVec3, sigma: f64) -> Self {
        Self::Position { point, covariance: SymmetricMatrix3::isotropic(sigma * sigma), facing: None }
    }

    fn incoming(&self) -> Result<IncomingReading> {
        let made = match *self {
            Self::Position { point, covariance, facing } => IncomingReading {
                at: point,
                facing: facing.unwrap_or(DVec3::ZERO),
                value: ReadingValue::Position(covariance),
            },
            // A measured normal states the side as well.
            Self::Normal { at, normal, sigma_rad } => IncomingReading {
                at,
                facing: normal,
                value: ReadingValue::Normal(normal, sigma_rad * sigma_rad),
            },
            Self::Curvature { at, normal, direction, principal, sigma } => IncomingReading {
                at,
                facing: normal,
                value: ReadingValue::Curvature(
                    curvature_tensor(principal, direction, normal).ok_or_else(|| {
                        Error::input("expected a direction of curvature that differs from the normal")
                    })?,
                    sigma * sigma,
                ),
            },
        };
        if made.at.is_finite() && made.facing.is_finite() {
            Ok(made)
        } else {
            Err(Error::input("expected a finite position and direction of a reading"))
        }
    }
}

/// The point of the surface nearest to a position, with its σ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearestPoint {
    /// Parameters, in units of the base grid.
    pub parameters: [f64; 2],
    /// Position.
    pub position: DVec3,
    /// Unit normal.
    pub normal: DVec3,
    /// σ of the surface along its normal.
    pub sigma: f64,
}

/// A surface that is updated with every reading.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_surface::stream::{Reading, StreamOptions, SurfaceStream};
/// // A sensor that reads a wavy sheet of 8 by 6 mm to 0.02 mm.
/// let read = |k: u32| {
///     let [x, y] = [8.0 * f64::from(k * 7919 % 1009) / 1009.0, 6.0 * f64::from(k * 104_729 % 997) / 997.0];
///     let error = 0.02 * (f64::from(k) * 12.9898).sin();
///     Reading::position(DVec3::new(x, y, 0.3 * x.sin() + error), 0.02)
/// };
/// let first: Vec<Reading> = (0..400).map(read).collect();
/// let mut stream = SurfaceStream::start(&first, &StreamOptions::default())?;
/// let before = stream.nearest(DVec3::new(4.0, 3.0, 0.0)).sigma;
/// for k in 400..1200 {
///     stream.push(&read(k))?;
/// }
/// let now = stream.nearest(DVec3::new(4.0, 3.0, 0.0));
/// assert!((now.position[2] - 0.3 * now.position[0].sin()).abs() < 0.05 && now.sigma < before);
///
/// // A snapshot is a saved model: `planish compare` reads it, and another day goes on from it.
/// # let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("sheet.planish");
/// stream.save(&path)?;
/// let mut resumed = SurfaceStream::resume(&path, &StreamOptions::default())?;
/// assert_eq!(resumed.readings(), stream.readings());
/// assert!(resumed.push(&read(1200))?.is_none());
/// # Ok::<(), planish_core::Error>(())
/// ```
pub struct SurfaceStream {
    core: StreamingFilter,
    unit: Unit,
    /// Readings of earlier sessions, and of the first fit.
    earlier: usize,
    /// Readings of the filter at that moment.
    counted: u64,
    sigma_factor: f64,
    smoothness_weight: f64,
    sensors: Vec<SensorReport>,
    poses: Vec<crate::model::ScanPoseReport>,
    provenance: Vec<Session>,
}

impl SurfaceStream {
    /// Finds the shape, its base and the smoothness weight from first readings. They are included in the
    /// surface, so they must not be pushed again.
    ///
    /// Some hundred positions are enough. Cost: that of a small fit; more than some ten thousand positions
    /// take noticeable time.
    ///
    /// # Errors
    /// `Undetermined` if the positions do not determine a surface; `Input` for numbers out of range.
    pub fn start(first: &[Reading], options: &StreamOptions) -> Result<Self> {
        let mut scan = Scan::default();
        let (mut covariance, mut normals) = (Vec::new(), Vec::new());
        for reading in first {
            // Every reading is checked before the fit, also those that follow after it.
            reading.incoming()?;
            if let Reading::Position { point, covariance: own, facing } = reading {
                scan.points.push(*point);
                covariance.push(*own);
                normals.push(facing.unwrap_or(DVec3::ZERO));
            }
        }
        scan.normals = normals.iter().any(|n| *n != DVec3::ZERO).then_some(normals);
        scan.covariance = Some(covariance);
        let fit = FitOptions {
            shape: options.shape,
            max_depth: options.max_depth,
            refine_by: options.refine_by,
            gate: options.gate,
            max_coefficients: options.max_coefficients,
            ..FitOptions::default()
        };
        let mut observations = Observations::new(
            &[&scan],
            &[0],
            &[Sensor::default()],
            &ObservationOptions {
                held_out_share: 0.0,
                seed: 0,
                checks: fit.checks,
                sheet: false,
                unprocessed: false,
                ground: None,
            },
        )?;
        // A stream holds no readings out: the next ones judge it.
        let all = (0..observations.len() as u32).collect();
        let found = first_fit_of(&mut observations, all, &fit, &Silent)?;
        let (sigma_factor, smoothness_weight) = (found.sigma_factor(), found.smoothness_weight());
        let earlier = found.readings();
        let FirstFit { core, .. } = found;
        let mut made = Self {
            core,
            unit: options.unit,
            earlier,
            counted: 0,
            sigma_factor,
            smoothness_weight,
            sensors: Vec::new(),
            poses: Vec::new(),
            provenance: Vec::new(),
        };
        // Normals and curvatures need a surface to act on, so they follow the first fit.
        for reading in first.iter().filter(|r| !matches!(r, Reading::Position { .. })) {
            made.push(reading)?;
        }
        Ok(made)
    }

    /// Adds one reading; returns why it was rejected, if it was.
    ///
    /// Cost: a search, a few evaluations and one update of a 49 × 49 covariance, some 10 µs. Whenever the
    /// number of readings has doubled, patches are reconciled and divided as the options ask, which takes
    /// seconds for hundreds of patches.
    ///
    /// # Errors
    /// `Input` for numbers that are not finite or negative variances.
    pub fn push(&mut self, reading: &Reading) -> Result<Option<RejectionCause>> {
        self.core.filter_reading(&reading.incoming()?)
    }

    /// The point of the surface nearest to `point`, from the state of its patch. Cost: one search.
    ///
    /// Neighbouring patches may not contain each other's last readings yet; [`Self::surface`] reconciles
    /// them.
    #[must_use]
    pub fn nearest(&self, point: DVec3) -> NearestPoint {
        let foot = self.core.foot_point(point, DVec3::ZERO);
        let parameters = self.core.filter.space().parameters(foot.leaf as usize, foot.local);
        let [u, v] = parameters;
        NearestPoint {
            parameters,
            position: foot.jet.point,
            normal: foot.normal,
            sigma: self.core.filter.variance_along(u, v, foot.normal).sqrt(),
        }
    }

    /// The surface of all readings so far, C² everywhere, after reconciliation of the patches.
    ///
    /// # Errors
    /// `Undetermined` if readings without noise are inconsistent.
    pub fn surface(&mut self) -> Result<Surface> {
        self.core.reconcile()
    }

    /// The surface with its covariance, as a model that can be compared, exported and saved.
    ///
    /// # Errors
    /// As for [`Self::surface`].
    pub fn model(&mut self) -> Result<SurfaceModel> {
        let surface = self.surface()?;
        Ok(SurfaceModel {
            unit: self.unit,
            unit_assumed: false,
            // Neighbours of measured leaves count as measured, as in a fit.
            observed: (with_neighbours(surface.space(), &self.core.measured()).into_iter())
                .map(|measured| if measured { Observed::Measured } else { Observed::PriorOnly })
                .collect(),
            sensors: self.sensors.clone(),
            poses: self.poses.clone(),
            smoothness_weight: self.smoothness_weight,
            observations: self.readings(),
            // It would follow from residuals, which a stream does not keep.
            excess_variance: Vec::new(),
            support: Support::default(),
            predictive: None,
            known: Knowledge::Patches(Arc::new(self.core.filter.clone())),
            surface,
        })
    }

    /// Writes a snapshot: a `.planish` file that [`Self::resume`], `planish compare` and
    /// `planish fit --update` read.
    ///
    /// # Errors
    /// As for [`Self::model`] and [`save`].
    pub fn save(&mut self, path: &Path) -> Result<()> {
        let model = self.model()?;
        save(&model, &self.provenance, path)
    }

    /// Continues from a snapshot. The same readings give the same numbers to the last bit as without a pause.
    ///
    /// Topology, unit and depth come from the file; the other options apply from now on.
    ///
    /// # Errors
    /// As for [`crate::saved::load`]; `Unsupported` for a model of the global filter.
    pub fn resume(path: &Path, options: &StreamOptions) -> Result<Self> {
        let saved = load_with_provenance(path)?;
        let model = saved.model;
        let Some(filter) = model.known.filter() else {
            return Err(Error::unsupported(format!(
                "{}: expected a model of the patch filter or of a stream, found one of the global filter",
                path.display()
            ))
            .with_setting(Setting::Filter));
        };
        let rules = PatchRules {
            gate: options.gate,
            refine_by: options.refine_by,
            max_coefficients: options.max_coefficients,
        };
        let counted = filter.readings();
        let mut core = StreamingFilter::new(filter.as_ref().clone(), 0, rules)?;
        let space = model.surface.space();
        // A model counts neighbours of measured leaves as observed. Without this step the observed part would
        // grow with every snapshot.
        let unobserved: Vec<bool> = model.observed.iter().map(|o| !o.is_measured()).collect();
        let near_unobserved = with_neighbours(space, &unobserved);
        for leaf in (0..near_unobserved.len()).filter(|&leaf| !near_unobserved[leaf]) {
            core.mark(space.parameters(leaf, [0.5, 0.5]));
        }
        Ok(Self {
            core,
            unit: model.unit,
            earlier: model.observations,
            counted,
            // The factor belongs to the first fit; pushed readings count with their stated σ.
            sigma_factor: 1.0,
            smoothness_weight: model.smoothness_weight,
            sensors: model.sensors,
            poses: model.poses,
            provenance: saved.provenance,
        })
    }

    /// Readings accepted so far, including those of the snapshot.
    #[must_use]
    pub fn readings(&self) -> usize {
        // The filter does not count the readings of the first fit.
        self.earlier + (self.core.filter.readings() - self.counted) as usize
    }

    /// Estimated over stated σ of the first readings; 1 if their stated σ is used. Readings that are pushed
    /// always count with their stated σ.
    #[must_use]
    pub fn sigma_factor(&self) -> f64 {
        self.sigma_factor
    }

    /// Number of leaf patches.
    #[must_use]
    pub fn patches(&self) -> usize {
        self.core.filter.patches().len()
    }

    /// Memory of the patches, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.core.filter.bytes()
    }

    /// Divisions since the start or the resumption, by level and cause.
    #[must_use]
    pub fn refined(&self) -> Vec<LevelRefinement> {
        self.core.log.levels()
    }
}

#[cfg(test)]
mod tests;
