//! Copies of the readings by a symmetry, where nothing was seen.
//!
//! A copy has the covariance of its reading, times the number of its copies, because `n` copies of one
//! reading are one measurement; and with all others it shares the error of the axis or plane, and the doubt
//! that the thing is as symmetric as the parts that were compared.

use super::measured_region::MeasuredRegion;
use crate::observe::{InferredReading, InferredVariance, Observations, Quantity};
use planish_estimate::{Error, Result};
use planish_spline::{Facets, FittedSymmetry, Symmetry, SymmetryKind, fit_symmetry, propose_symmetry};
use serde::Serialize;
use std::f64::consts::TAU;

/// Nothing is copied to where a reading lies nearer than this share of the side of a piece of the cloud.
const SEEN: f64 = 0.5;
/// Copies that are made, at most; of more readings only every so many-th is copied.
const MAX_COPIES: usize = 60_000;
/// Copies of one reading about an axis, at least and at most.
const FEWEST: usize = 2;
const MOST: usize = 24;

/// Which symmetry completes what nobody saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SymmetryChoice {
    /// This kind; that the readings do not bear it out is an error.
    Of(SymmetryKind),
    /// The one that the readings bear out, if any.
    Auto,
}

/// A symmetry and how well it is known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SymmetryReport {
    /// `rotation`, `mirror`, or `none` where none was found.
    pub kind: String,
    /// How many times a turn repeats the shape; none where any turn does, and of a mirror.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub order: Option<u32>,
    /// A point of the axis or plane.
    pub point: [f64; 3],
    /// The unit direction of the axis, or the normal of the plane.
    pub direction: [f64; 3],
    /// σ of the place: across an axis in two directions, along the normal of a plane.
    pub sigma_point: Vec<f64>,
    /// σ of the direction about two axes across it, in degrees.
    pub sigma_direction_deg: [f64; 2],
    /// How far parts that were compared depart from each other beyond their noise, as a standard deviation.
    pub departure: f64,
    /// Pieces of the cloud whose image met another piece, and how many of those agreed.
    pub compared: usize,
    /// See `compared`.
    pub agreeing: usize,
    /// Whether it was proposed by the program.
    pub proposed: bool,
    /// Copies of readings.
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

    /// That none was found.
    fn none() -> Self {
        Self {
            kind: "none".to_owned(),
            order: None,
            point: [0.0; 3],
            direction: [0.0; 3],
            sigma_point: Vec::new(),
            sigma_direction_deg: [0.0; 2],
            departure: 0.0,
            compared: 0,
            agreeing: 0,
            proposed: true,
            copies: 0,
        }
    }

    /// Whether there is one.
    #[must_use]
    pub fn is_found(&self) -> bool {
        self.kind != "none"
    }
}

/// The symmetry that was found, and the readings that were added by it.
#[derive(Debug, Clone, PartialEq)]
pub struct SymmetryCompletion {
    /// The symmetry that was fitted, or looked for.
    pub symmetry: SymmetryReport,
    /// Number of readings inferred from others.
    pub pseudo_readings: usize,
}

/// Fits the symmetry and adds copies of the readings.
///
/// # Errors
/// `Undetermined` where the readings do not bear out the symmetry that was asked for, or are too few for any.
pub fn complete_by_symmetry(
    observations: &mut Observations,
    choice: SymmetryChoice,
) -> Result<SymmetryCompletion> {
    let cloud = Cloud::new(observations)?;
    let found = match choice {
        SymmetryChoice::Of(kind) => Some(borne_out(fit_symmetry(&cloud.facets, kind), kind, &cloud.facets)?),
        SymmetryChoice::Auto => propose_symmetry(&cloud.facets),
    };
    let Some(found) = found else {
        return Ok(SymmetryCompletion { symmetry: SymmetryReport::none(), pseudo_readings: 0 });
    };
    let copies = cloud.copies(observations, &found);
    observations.add_inferred(&copies);
    Ok(SymmetryCompletion {
        symmetry: SymmetryReport::from_fitted(&found, choice == SymmetryChoice::Auto, copies.len()),
        pseudo_readings: copies.len(),
    })
}

/// The symmetry, if the readings support it.
fn borne_out(found: Option<FittedSymmetry>, kind: SymmetryKind, facets: &Facets) -> Result<FittedSymmetry> {
    let what = match kind {
        SymmetryKind::Rotation { order: None, .. } => "a surface of revolution".to_owned(),
        SymmetryKind::Rotation { order: Some(n), .. } => format!("a rotation of order {n}"),
        SymmetryKind::Mirror { .. } => "a mirror plane".to_owned(),
    };
    let advice = "leave --symmetry out, try another, or let --symmetry auto look for one";
    let Some(found) = found else {
        return Err(Error::undetermined(format!(
            "the readings do not place {what}: no part of them meets the image of another; {advice}"
        )));
    };
    if found.supported {
        return Ok(found);
    }
    let (shifts, _) = found.sigmas();
    Err(Error::undetermined(format!(
        "the readings do not bear out {what}: of {} pieces of the cloud {} meet the image of another and {} agree with it, and its place is known \
         to ±{:.2e}; more than 80 % have to agree, and the place to be known within 2 % of the size: {advice}",
        facets.all.len(),
        found.compared,
        found.agreeing,
        shifts.into_iter().fold(0.0, f64::max)
    )))
}

/// A cloud in pieces, with the readings that they are made of.
pub(crate) struct Cloud {
    pub(crate) facets: Facets,
    /// The reading behind each point of the pieces.
    readings: Vec<u32>,
    /// Variance of each of them along its normal.
    variance: Vec<f64>,
}

impl Cloud {
    /// The positions among observations.
    pub(crate) fn new(observations: &Observations) -> Result<Self> {
        let readings: Vec<u32> = (0..observations.len() as u32)
            .filter(|&i| {
                let i = i as usize;
                let channel = observations.channels[observations.channel(i)];
                channel.quantity == Quantity::Position && !channel.inferred && !observations.held_out[i]
            })
            .collect();
        let points: Vec<[f64; 3]> = readings.iter().map(|&i| observations.points[i as usize]).collect();
        let normals: Vec<[f64; 3]> = readings.iter().map(|&i| observations.normal(i as usize)).collect();
        let mut variance: Vec<f64> = (readings.iter().zip(&normals))
            .map(|(&i, n)| observations.variance(i as usize, *n).max(f64::MIN_POSITIVE))
            .collect();
        let believed = observations.stated.iter().all(|&s| s);
        let facets = Facets::new(&points, &normals, &variance, believed)?;
        for v in &mut variance {
            *v *= facets.variance_factor;
        }
        Ok(Self { facets, readings, variance })
    }

    /// The images of readings that obey the symmetry, where nothing was seen.
    fn copies(&self, observations: &Observations, found: &FittedSymmetry) -> Vec<InferredReading> {
        let seen = MeasuredRegion::new(observations, SEEN * self.facets.side);
        let sources: Vec<usize> = (0..self.readings.len())
            .filter(|&k| self.facets.of_point[k].is_some_and(|f| found.obeys[f as usize]))
            .collect();
        let turns = self.turns(found);
        let stride = (sources.len() * turns).div_ceil(MAX_COPIES).max(1);
        let doubt = found.departure * found.departure;
        let mut copies = Vec::new();
        for &k in sources.iter().step_by(stride) {
            let i = self.readings[k] as usize;
            let (p, n) = (observations.points[i], observations.normal(i));
            for angle in angles(&found.symmetry, turns, k) {
                let (point, normal) = found.symmetry.image(angle, p, n);
                if seen.near(point, normal) {
                    continue;
                }
                let variance = InferredVariance {
                    own: turns as f64 * self.variance[k],
                    shared: found.image_variance(angle, p, normal) + doubt,
                };
                copies.push(InferredReading { point, normal, variance });
            }
        }
        copies
    }

    /// How many copies of a reading there are: as many as the symmetry has maps; about an axis so many that
    /// what was not seen is covered as densely as what was.
    fn turns(&self, found: &FittedSymmetry) -> usize {
        /// Sectors in which an axis is looked for readings.
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
                SECTORS.div_ceil(seen).clamp(FEWEST, MOST)
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
