//! A sample of readings with their residuals for reports, and a summary of every scan.
//!
//! Input: the readings of a finished fit. Output: a [`ResidualSample`] with the residuals that the fit itself
//! used.
//!
//! Not guaranteed: readings of further batches of a large cloud; readings of normals and curvatures.

use super::leaves::with_neighbours;
use super::noise::SensorNoise;
use super::scan_differences::{ScanDifference, scan_differences};
use crate::observe::{ProjectedReadings, Quantity};
use planish_core::DVec3;
use planish_exchange::ScanSet;
use planish_spline::Surface;

/// Largest size of the sample: more dots would overlap on a screen.
const MAX_SAMPLE: usize = 20_000;

/// The figures of one scan.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanSummary {
    /// Name of the scan.
    pub name: String,
    /// Name of its sensor.
    pub sensor: String,
    /// Positions used.
    pub used: usize,
    /// Positions rejected by the fit.
    pub rejected: usize,
    /// Root mean square of the residuals of positions used.
    pub rms: f64,
    /// Mean of these residuals: the offset of the scan from all others.
    pub mean: f64,
    /// Root mean square of residual over σ.
    pub rms_normalised: f64,
    /// How far it lies from the others where they overlap; none if that is not significant.
    pub difference: Option<ScanDifference>,
}

/// A sample of the positions, as the fit judged them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ResidualSample {
    /// Position of each reading.
    pub places: Vec<DVec3>,
    /// Signed distance from the surface.
    pub residuals: Vec<f64>,
    /// Residual over its σ.
    pub normalised: Vec<f64>,
    /// Index of the scan.
    pub scan: Vec<u32>,
    /// Normalised residual beyond which readings are rejected.
    pub gate: f64,
    /// True if the reading was used.
    pub used: Vec<bool>,
    /// One entry for each scan, in their order.
    pub scans: Vec<ScanSummary>,
    /// For each leaf, the scans with a reading in it or in one of its neighbours.
    pub seen_by: Vec<Vec<u32>>,
}

impl ResidualSample {
    /// From projected readings and the information of each.
    pub(super) fn new(
        set: &ScanSet,
        surface: &Surface,
        readings: ProjectedReadings<'_>,
        information: &[f64],
        noise: &SensorNoise,
        gate: f64,
    ) -> Self {
        let ProjectedReadings { observations, subset, feet } = readings;
        let mut sample = Self {
            gate,
            scans: (set.scans.iter())
                .map(|posed| ScanSummary {
                    name: posed.scan.name.clone(),
                    sensor: set.sensors[posed.sensor].name.clone(),
                    ..ScanSummary::default()
                })
                .collect(),
            ..Self::default()
        };
        let leaves = surface.space().leaves().len();
        let mut holds: Vec<Vec<bool>> = vec![Vec::new(); sample.scans.len()];
        let positions: Vec<usize> = (0..feet.len())
            .filter(|&k| {
                let channel = &observations.channels[observations.channel(subset[k] as usize)];
                feet[k].quantity == Quantity::Position && !channel.inferred
            })
            .collect();
        // Every Nth reading, so that each scan keeps its share of the sample.
        let step = positions.len().div_ceil(MAX_SAMPLE).max(1);
        for (n, &k) in positions.iter().enumerate() {
            let (i, foot) = (subset[k] as usize, &feet[k]);
            let scan = observations.readings.scan[i] as usize;
            let (Some(figures), Some(holds)) = (sample.scans.get_mut(scan), holds.get_mut(scan)) else {
                continue;
            };
            let residual = foot.height();
            let normalised = residual / noise.variance(readings, k).sqrt();
            let used = information[k] > 0.0;
            if used {
                figures.used += 1;
                figures.rms += residual * residual;
                figures.mean += residual;
                figures.rms_normalised += normalised * normalised;
                // Marks take a byte for each leaf and scan, so only scans with readings get any.
                if holds.is_empty() {
                    holds.resize(leaves, false);
                }
                holds[foot.leaf as usize] = true;
            } else {
                figures.rejected += 1;
            }
            // The figures of scans count every reading; only the points to be displayed are a sample.
            if n % step == 0 {
                sample.places.push(observations.readings.points[i]);
                sample.residuals.push(residual);
                sample.normalised.push(normalised);
                sample.scan.push(scan as u32);
                sample.used.push(used);
            }
        }
        // Until here the figures hold sums; means are formed once all readings are counted.
        for figures in &mut sample.scans {
            let n = figures.used.max(1) as f64;
            figures.rms = (figures.rms / n).sqrt();
            figures.mean /= n;
            figures.rms_normalised = (figures.rms_normalised / n).sqrt();
        }
        let differences = scan_differences(readings, information, noise, sample.scans.len());
        for (figures, difference) in sample.scans.iter_mut().zip(differences) {
            figures.difference = difference;
        }
        sample.seen_by = vec![Vec::new(); leaves];
        for (scan, holds) in holds.iter().enumerate().filter(|(_, holds)| !holds.is_empty()) {
            for (leaf, seen) in with_neighbours(surface.space(), holds).into_iter().enumerate() {
                if seen {
                    sample.seen_by[leaf].push(scan as u32);
                }
            }
        }
        sample
    }

    /// The same with every position moved.
    pub(super) fn translated(mut self, by: DVec3) -> Self {
        for place in &mut self.places {
            *place += by;
        }
        self
    }
}
