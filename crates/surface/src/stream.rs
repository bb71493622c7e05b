//! A surface from readings that come one at a time: the patch filter for a live sensor.
//!
//! Comes in: some hundred first readings, then one after the other, positions, normals and curvatures in any
//! order. Goes out: the surface and its σ at any time; a snapshot that a later program goes on from. Memory
//! is that of the patches, whatever the number of readings.
//!
//! Parameters are not known: every reading gets a foot point on the surface as it is then, and says what it
//! says along the normal there. Readings far beyond what is expected are left out, unless most of a place
//! are: then they are shape, and its patch is divided.
//!
//! Not guaranteed: the accuracy of [`crate::fit::fit`], which looks at every reading again and again; what a
//! coarse patch took in says nothing of finer detail. The first readings have to show the whole of a closed
//! shape, roughly: its topology and base are chosen by them.

use crate::fit::{FirstFit, FitOptions, first_fit_of, with_neighbours};
use crate::model::{Observed, SensorReport, SurfaceModel};
use crate::observe::{ObservationOptions, Observations, RejectionCause};
use crate::patch_stream::{IncomingReading, PatchRules, ReadingValue, StreamingFilter};
use crate::saved::{Session, load_with_provenance, save};
use crate::subdivision::{LevelRefinement, RefineBy};
use planish_core::Silent;
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_sense::{Scan, Sensor};
use planish_spline::{Shape, Surface, SurfaceSystem, curvature_tensor};
use std::path::Path;
use std::sync::Arc;

/// How a stream works.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamOptions {
    /// The topology; chosen from the first readings where none is given.
    pub shape: Option<Shape>,
    /// Unit of every length.
    pub unit: Unit,
    /// No more levels of subdivision beyond the base grid than this; three where none is given.
    pub max_depth: Option<u8>,
    /// What asks for subdivision.
    pub refine_by: RefineBy,
    /// Readings farther than this many standard deviations from what is expected are left out.
    pub gate: f64,
    /// No more control vertices than about this.
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
        /// Where.
        point: [f64; 3],
        /// Its covariance `[xx, xy, xz, yy, yz, zz]`.
        covariance: [f64; 6],
        /// A unit vector from the surface to where it was seen from, where that is known: it tells two sides
        /// of a thin part apart.
        facing: Option<[f64; 3]>,
    },
    /// A unit normal.
    Normal {
        /// Where, well enough to find the place on the surface.
        at: [f64; 3],
        /// What was measured.
        normal: [f64; 3],
        /// σ of its tilt in any direction, in radians.
        sigma_rad: f64,
    },
    /// Principal curvatures, positive where the surface bends towards the normal.
    Curvature {
        /// Where, well enough to find the place on the surface.
        at: [f64; 3],
        /// The unit normal, and the direction of the first curvature.
        normal: [f64; 3],
        /// The direction of the first curvature.
        direction: [f64; 3],
        /// κ1 and κ2, in one over the unit.
        principal: [f64; 2],
        /// σ of either.
        sigma: f64,
    },
}

impl Reading {
    /// A position whose noise is alike in all directions.
    #[must_use]
    pub fn position(point: [f64; 3], sigma: f64) -> Self {
        let v = sigma * sigma;
        Self::Position { point, covariance: [v, 0.0, 0.0, v, 0.0, v], facing: None }
    }

    fn incoming(&self) -> Result<IncomingReading> {
        let made = match *self {
            Self::Position { point, covariance, facing } => IncomingReading {
                at: point,
                facing: facing.unwrap_or([0.0; 3]),
                what: ReadingValue::Position(covariance),
            },
            Self::Normal { at, normal, sigma_rad } => IncomingReading {
                at,
                facing: normal,
                what: ReadingValue::Normal(normal, sigma_rad * sigma_rad),
            },
            Self::Curvature { at, normal, direction, principal, sigma } => IncomingReading {
                at,
                facing: normal,
                what: ReadingValue::Curvature(
                    curvature_tensor(principal, direction, normal)
                        .ok_or_else(|| Error::input("a curvature's direction is its normal, or none"))?,
                    sigma * sigma,
                ),
            },
        };
        if (made.at.iter().chain(&made.facing)).all(|x| x.is_finite()) {
            Ok(made)
        } else {
            Err(Error::input("a reading's place or direction is not finite"))
        }
    }
}

/// What is known of a place on the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearestPoint {
    /// Its parameters, in units of the base grid.
    pub parameters: [f64; 2],
    /// Where it is.
    pub position: [f64; 3],
    /// The unit normal.
    pub normal: [f64; 3],
    /// σ of the surface along its normal.
    pub sigma: f64,
}

/// A surface that readings stream into.
///
/// # Examples
/// ```
/// use planish::stream::{Reading, StreamOptions, SurfaceStream};
/// // A sensor that reads a wavy sheet of 8 by 6 mm to 0.02 mm.
/// let read = |k: u32| {
///     let [x, y] = [8.0 * f64::from(k * 7919 % 1009) / 1009.0, 6.0 * f64::from(k * 104_729 % 997) / 997.0];
///     let error = 0.02 * (f64::from(k) * 12.9898).sin();
///     Reading::position([x, y, 0.3 * x.sin() + error], 0.02)
/// };
/// let first: Vec<Reading> = (0..400).map(read).collect();
/// let mut stream = SurfaceStream::start(&first, &StreamOptions::default())?;
/// let before = stream.nearest([4.0, 3.0, 0.0]).sigma;
/// for k in 400..1200 {
///     stream.push(&read(k))?;
/// }
/// let now = stream.nearest([4.0, 3.0, 0.0]);
/// assert!((now.position[2] - 0.3 * now.position[0].sin()).abs() < 0.05 && now.sigma < before);
///
/// // A snapshot is a saved model: `planish compare` reads it, and another day goes on from it.
/// # let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("sheet.planish");
/// stream.save(&path)?;
/// let mut resumed = SurfaceStream::resume(&path, &StreamOptions::default())?;
/// assert_eq!(resumed.readings(), stream.readings());
/// assert!(resumed.push(&read(1200))?.is_none());
/// # Ok::<(), planish::Error>(())
/// ```
pub struct SurfaceStream {
    core: StreamingFilter,
    unit: Unit,
    /// Readings of sessions before, and of the first fit.
    earlier: usize,
    /// Readings that the filter had then.
    counted: u64,
    sigma_factor: f64,
    smoothness_weight: f64,
    sensors: Vec<SensorReport>,
    poses: Vec<crate::model::ScanPoseReport>,
    provenance: Vec<Session>,
}

impl SurfaceStream {
    /// Finds the shape, its base and how smooth it is from first readings, which are filtered all at once and
    /// are not to be pushed again.
    ///
    /// Some hundred positions are enough; of more than some ten thousand the time is felt. Cost: that of a
    /// small fit.
    ///
    /// # Errors
    /// `Undetermined` when the positions do not determine a surface; `Input` for numbers that make no sense.
    pub fn start(first: &[Reading], options: &StreamOptions) -> Result<Self> {
        let mut scan = Scan::default();
        let (mut covariance, mut normals) = (Vec::new(), Vec::new());
        for reading in first {
            reading.incoming()?;
            if let Reading::Position { point, covariance: own, facing } = reading {
                scan.points.push(*point);
                covariance.push(*own);
                normals.push(facing.unwrap_or([0.0; 3]));
            }
        }
        scan.normals = normals.iter().any(|n| *n != [0.0; 3]).then_some(normals);
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
        for reading in first.iter().filter(|r| !matches!(r, Reading::Position { .. })) {
            made.push(reading)?;
        }
        Ok(made)
    }

    /// Takes in one reading; why not, where it is left out.
    ///
    /// Cost: a search, a few evaluations and one update of a 49 × 49 covariance, some 10 µs. Every time the
    /// number of readings has doubled, patches tell each other what is new and are divided where the options
    /// ask for it, which takes seconds for hundreds of patches.
    ///
    /// # Errors
    /// `Input` for numbers that are not finite or negative variances.
    pub fn push(&mut self, reading: &Reading) -> Result<Option<RejectionCause>> {
        self.core.filter_reading(&reading.incoming()?)
    }

    /// The place on the surface that is nearest to a point, as its patch knows it: at any time, at the cost
    /// of a search. Neighbouring patches may not have heard of each other's last readings yet;
    /// [`Self::surface`] makes them.
    #[must_use]
    pub fn nearest(&self, point: [f64; 3]) -> NearestPoint {
        let foot = self.core.foot_point(point, [0.0; 3]);
        let parameters = self.core.filter.space().parameters(foot.leaf as usize, foot.local);
        let [u, v] = parameters;
        NearestPoint {
            parameters,
            position: foot.jet.point,
            normal: foot.normal,
            sigma: self.core.filter.variance_along(u, v, foot.normal).sqrt(),
        }
    }

    /// The surface of all readings so far, C² everywhere, after patches have told each other what they know.
    ///
    /// # Errors
    /// `Undetermined` when readings without noise contradict each other.
    pub fn surface(&mut self) -> Result<Surface> {
        self.core.reconcile()
    }

    /// The surface with its covariance, to be compared, written and saved like any other model.
    ///
    /// # Errors
    /// As for [`Self::surface`].
    pub fn model(&mut self) -> Result<SurfaceModel> {
        let surface = self.surface()?;
        let nothing = SurfaceSystem::new(surface.space())?.nothing()?;
        Ok(SurfaceModel {
            unit: self.unit,
            prior: nothing.clone(),
            data: nothing,
            observed: (with_neighbours(surface.space(), &self.core.measured()).into_iter())
                .map(|measured| if measured { Observed::Measured } else { Observed::PriorOnly })
                .collect(),
            sensors: self.sensors.clone(),
            poses: self.poses.clone(),
            smoothness_weight: self.smoothness_weight,
            observations: self.readings(),
            measured_coordinates: None,
            unresolved_shape: Vec::new(),
            moves_freely: false,
            scan_errors: None,
            patches: Some(Arc::new(self.core.filter.clone())),
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

    /// Goes on from a snapshot as if there had been no pause: the same readings give the same numbers to the
    /// last bit.
    ///
    /// Topology, unit and depth are those of the file; the other options hold from now on.
    ///
    /// # Errors
    /// As for [`crate::saved::load`]; `Unsupported` for a model of the global filter.
    pub fn resume(path: &Path, options: &StreamOptions) -> Result<Self> {
        let saved = load_with_provenance(path)?;
        let model = saved.model;
        let Some(filter) = &model.patches else {
            return Err(Error::unsupported(format!(
                "{}: the model is one of the global filter: needed one of `fit --filter patch` or of a stream",
                path.display()
            )));
        };
        let rules = PatchRules {
            gate: options.gate,
            refine_by: options.refine_by,
            max_coefficients: options.max_coefficients,
        };
        let counted = filter.readings();
        let mut core = StreamingFilter::new(filter.as_ref().clone(), 0, rules)?;
        let space = model.surface.space();
        // A model counts the neighbours of what was measured as observed; they are not to spread with every
        // snapshot.
        let unseen: Vec<bool> = model.observed.iter().map(|o| !o.is_measured()).collect();
        let near_unseen = with_neighbours(space, &unseen);
        for leaf in (0..near_unseen.len()).filter(|&leaf| !near_unseen[leaf]) {
            core.mark(space.parameters(leaf, [0.5, 0.5]));
        }
        Ok(Self {
            core,
            unit: model.unit,
            earlier: model.observations,
            counted,
            sigma_factor: 1.0,
            smoothness_weight: model.smoothness_weight,
            sensors: model.sensors,
            poses: model.poses,
            provenance: saved.provenance,
        })
    }

    /// Readings taken in so far, those of the snapshot that it goes on from among them.
    #[must_use]
    pub fn readings(&self) -> usize {
        self.earlier + (self.core.filter.readings() - self.counted) as usize
    }

    /// By how much the first readings' σ is larger than they state; 1 where they are believed. Readings that
    /// are pushed are taken at their word.
    #[must_use]
    pub fn sigma_factor(&self) -> f64 {
        self.sigma_factor
    }

    /// Leaf patches.
    #[must_use]
    pub fn patches(&self) -> usize {
        self.core.filter.patches().len()
    }

    /// Memory of what the patches know, in bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.core.filter.bytes()
    }

    /// What was divided since the start or the resumption, and why.
    #[must_use]
    pub fn refined(&self) -> Vec<LevelRefinement> {
        self.core.log.levels()
    }
}

#[cfg(test)]
mod tests;
