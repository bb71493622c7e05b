//! Copies of readings by a symmetry, in regions that were not measured.
//!
//! A copy has the covariance of its reading times the number of its copies, because `n` copies of one reading
//! are one measurement. All copies share the error of the axis or plane, and the deviation from symmetry of
//! the parts that were compared.

use super::measured_region::MeasuredRegion;
use crate::observe::{InferredReading, InferredVariance, Observations, Quantity};
use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_spline::{Facets, FittedSymmetry, Symmetry, SymmetryKind, fit_symmetry, propose_symmetry};
use serde::Serialize;
use std::f64::consts::TAU;

/// No copies are made within this distance of a reading, in sides of a facet of the cloud. See decision 0017.
const MEASURED_REACH: f64 = 0.5;
/// Maximum number of copies; beyond it, only every Nth reading is copied. Fewer leave unobserved parts
/// sparse, more cost time in every iteration of the fit.
const MAX_COPIES: usize = 60_000;
/// Minimum and maximum number of copies of one reading about an axis. A part that was seen over less than
/// about 15° would need more; its copies are then sparser than its readings.
const MIN_TURNS: usize = 2;
const MAX_TURNS: usize = 24;

/// The symmetry by which unobserved parts are completed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SymmetryChoice {
    /// This kind; it is an error if the readings do not support it.
    Of(SymmetryKind),
    /// The symmetry that the readings support, if any.
    Auto,
}

/// A symmetry with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SymmetryReport {
    /// `rotation`, `mirror`, or `none` if none was found.
    pub kind: String,
    /// Order of the rotation; none for a surface of revolution, and for a mirror.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<u32>,
    /// Point on the axis or plane.
    pub point: DVec3,
    /// Unit direction of the axis, or normal of the plane.
    pub direction: DVec3,
    /// σ of the position: in two directions across an axis, or along the normal of a plane.
    pub sigma_point: Vec<f64>,
    /// σ of the direction about two axes across it, in degrees.
    pub sigma_direction_deg: [f64; 2],
    /// Standard deviation of the differences between compared parts, beyond their noise.
    pub departure: f64,
    /// Number of facets of the cloud whose image lies on another facet.
    pub compared: usize,
    /// Number of these that agree with the other facet.
    pub agreeing: usize,
    /// True if it was proposed by the program.
    pub proposed: bool,
    /// Number of copies of readings.
    pub copies: usize,
}

impl SymmetryReport {
    fn from_fitted(found: &FittedSymmetry, proposed: bool, copies: usize) -> Self {
        let (kind, order) = match found.symmetry {
            Symmetry::Rotation { order, .. } => ("rotation", order),
            Symmetry::Mirror { .. } => ("mirror", None),
        };
        let (sigma_point, tilts) = found.sigmas();
        Self {
            kind: kind.to_owned(),
            order,
            point: found.symmetry.point(),
            direction: found.symmetry.direction(),
            sigma_point,
            sigma_direction_deg: tilts.map(f64::to_degrees),
            departure: found.departure,
            compared: found.compared,
            agreeing: found.agreeing,
            proposed,
            copies,
        }
    }

    /// The report if none was found.
    fn none() -> Self {
        Self {
            kind: "none".to_owned(),
            order: None,
            point: DVec3::ZERO,
            direction: DVec3::ZERO,
            sigma_point: Vec::new(),
            sigma_direction_deg: [0.0; 2],
            departure: 0.0,
            compared: 0,
            agreeing: 0,
            proposed: true,
            copies: 0,
        }
    }

    /// True if a symmetry was found.
    #[must_use]
    pub fn is_found(&self) -> bool {
        self.kind != "none"
    }
}

/// A symmetry, and the number of readings added by it.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetryCompletion {
    /// The symmetry, or the report that none was found.
    pub symmetry: SymmetryReport,
    /// Number of readings inferred from others.
    pub pseudo_readings: usize,
}

/// Fits the symmetry and adds copies of the readings.
///
/// # Errors
/// `Undetermined` if the readings do not support the requested symmetry, or are too few for any.
pub fn complete_by_symmetry(
    observations: &mut Observations,
    choice: SymmetryChoice,
) -> Result<SymmetryCompletion> {
    let cloud = Cloud::new(observations)?;
    let found = match choice {
        SymmetryChoice::Of(kind) => Some(supported(fit_symmetry(&cloud.facets, kind), kind, &cloud.facets)?),
        SymmetryChoice::Auto => propose_symmetry(&cloud.facets),
    };
    let Some(found) = found else {
        return Ok(SymmetryCompletion { symmetry: SymmetryReport::none(), pseudo_readings: 0 });
    };
    // Copies come before the first fit, so that the starting surface is chosen for the completed object.
    let copies = cloud.copies(observations, &found);
    observations.add_inferred(&copies);
    Ok(SymmetryCompletion {
        symmetry: SymmetryReport::from_fitted(&found, choice == SymmetryChoice::Auto, copies.len()),
        pseudo_readings: copies.len(),
    })
}

/// The symmetry, if the readings support it.
fn supported(found: Option<FittedSymmetry>, kind: SymmetryKind, facets: &Facets) -> Result<FittedSymmetry> {
    let what = match kind {
        SymmetryKind::Rotation { order: None, .. } => "a surface of revolution".to_owned(),
        SymmetryKind::Rotation { order: Some(n), .. } => format!("a rotation of order {n}"),
        SymmetryKind::Mirror { .. } => "a mirror plane".to_owned(),
    };
    let advice = "omit the symmetry, specify another, or let it be detected";
    // A requested symmetry that the readings do not support is an error: a vessel with a wrong half looks
    // as good as a right one (decision 0016).
    let Some(found) = found else {
        return Err(Error::undetermined(format!(
            "the readings do not determine {what}: no part of the cloud coincides with the image of \
             another; {advice}"
        ))
        .with_setting(Setting::Symmetry));
    };
    if found.supported {
        return Ok(found);
    }
    let (shifts, _) = found.sigmas();
    Err(Error::undetermined(format!(
        "the readings do not support {what}: of {} pieces of the cloud, {} coincide with the image of \
         another and {} agree with it, and σ of its position is {:.2e}; expected more than 80 % in \
         agreement, and a position within 2 % of the size: {advice}",
        facets.all.len(),
        found.compared,
        found.agreeing,
        shifts.into_iter().fold(0.0, f64::max)
    ))
    .with_setting(Setting::Symmetry))
}

/// A cloud in facets, with the readings that form them.
pub(crate) struct Cloud {
    pub(crate) facets: Facets,
    /// The reading of each point of the facets.
    readings: Vec<u32>,
    /// Variance of each reading along its normal.
    variance: Vec<f64>,
}

impl Cloud {
    /// The positions among observations.
    pub(crate) fn new(observations: &Observations) -> Result<Self> {
        let readings: Vec<u32> = (0..observations.len() as u32)
            .filter(|&i| {
                let i = i as usize;
                let channel = observations.channels[observations.channel(i)];
                channel.quantity == Quantity::Position
                    && !channel.inferred
                    // Held-out readings judge the fit, so they must not shape it through their copies.
                    && !observations.readings.held_out[i]
            })
            .collect();
        let points: Vec<DVec3> = readings.iter().map(|&i| observations.readings.points[i as usize]).collect();
        let normals: Vec<DVec3> = readings.iter().map(|&i| observations.normal(i as usize)).collect();
        let mut variance: Vec<f64> = (readings.iter().zip(&normals))
            // An exact sensor states a σ of zero, which would make the weights infinite.
            .map(|(&i, n)| observations.variance(i as usize, *n).max(f64::MIN_POSITIVE))
            .collect();
        // The residuals of facets may enlarge a stated σ. They set it only if a channel states none.
        let is_stated = observations.channels.iter().all(|c| c.stated);
        let facets = Facets::new(&points, &normals, &variance, is_stated)?;
        for v in &mut variance {
            *v *= facets.variance_factor;
        }
        Ok(Self { facets, readings, variance })
    }

    /// Images of readings that obey the symmetry, where nothing was measured.
    fn copies(&self, observations: &Observations, found: &FittedSymmetry) -> Vec<InferredReading> {
        let measured = MeasuredRegion::new(&observations.readings, MEASURED_REACH * self.facets.side);
        let sources: Vec<usize> = (0..self.readings.len())
            // Facets that do not obey the symmetry, such as those of a handle, are not copied (decision
            // 0017).
            .filter(|&k| self.facets.of_point[k].is_some_and(|f| found.is_symmetric[f as usize]))
            .collect();
        let turns = self.turns(found);
        // Evenly spread over the readings, so that all parts are completed.
        let stride = (sources.len() * turns).div_ceil(MAX_COPIES).max(1);
        // Unmeasured parts may depart from the symmetry as much as the compared ones.
        let model_variance = found.departure * found.departure;
        let mut copies = Vec::new();
        for &k in sources.iter().step_by(stride) {
            let i = self.readings[k] as usize;
            let (p, n) = (observations.readings.points[i], observations.normal(i));
            for angle in angles(&found.symmetry, turns, k) {
                let (point, normal) = found.symmetry.image(angle, p, n);
                if measured.contains(point, normal) {
                    continue;
                }
                let variance = InferredVariance {
                    // `n` copies of one reading are one measurement, so each weighs 1/n (decision 0017).
                    own: turns as f64 * self.variance[k],
                    shared: found.image_variance(angle, p, normal) + model_variance,
                };
                copies.push(InferredReading { point, normal, variance });
            }
        }
        copies
    }

    /// Number of copies of a reading: one for each map of the symmetry. About an axis, as many as cover the
    /// unmeasured part as densely as the measured one.
    fn turns(&self, found: &FittedSymmetry) -> usize {
        /// Sectors about an axis in which readings are counted.
        const SECTORS: usize = 72;
        match found.symmetry {
            Symmetry::Mirror { .. } => 1,
            Symmetry::Rotation { order: Some(n), .. } => n as usize - 1,
            Symmetry::Rotation { order: None, .. } => {
                let mut hit = [false; SECTORS];
                for facet in &self.facets.all {
                    let angle = found.symmetry.angle(facet.point);
                    hit[((angle / TAU).rem_euclid(1.0) * SECTORS as f64) as usize % SECTORS] = true;
                }
                let seen = hit.iter().filter(|h| **h).count().max(1);
                SECTORS.div_ceil(seen).clamp(MIN_TURNS, MAX_TURNS)
            }
        }
    }
}

/// The angles of a reading's images; a reflection has none.
fn angles(symmetry: &Symmetry, turns: usize, reading: usize) -> Vec<Option<f64>> {
    match symmetry {
        Symmetry::Mirror { .. } => vec![None],
        Symmetry::Rotation { order: Some(n), .. } => {
            (1..*n).map(|k| Some(TAU * f64::from(k) / f64::from(*n))).collect()
        }
        Symmetry::Rotation { order: None, .. } => {
            // The golden ratio spreads the images of neighbours evenly over the angles.
            let phase = (reading as f64 * 0.618_033_988_749_894_9).fract();
            (0..turns).map(|k| Some(TAU * (k as f64 + phase) / turns as f64)).collect()
        }
    }
}
