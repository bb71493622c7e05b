//! What a report shows of the readings: some of them with their residuals, and what every scan amounts to.
//!
//! Comes in: the readings that a fit ends with. Goes out: [`ResidualSample`]. Nothing is computed anew: these
//! are the residuals that the fit judged.
//!
//! Not guaranteed: readings of a large cloud beyond those that found the surface; readings of other things
//! than positions.

use super::leaves::with_neighbours;
use super::noise::SensorNoise;
use crate::observe::{ProjectedReadings, Quantity};
use planish_estimate::vector3::add;
use planish_exchange::ScanSet;
use planish_spline::Surface;

/// So many readings are residual_sample at most: dots that lie apart on a screen.
const MAX_SHOWN: usize = 20_000;

/// What a scan amounts to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ScanSummary {
    /// Its name.
    pub name: String,
    /// Its sensor.
    pub sensor: String,
    /// Positions that took part.
    pub used: usize,
    /// Positions that were found to be of something else, or wrong.
    pub rejected: usize,
    /// Root mean square of the residuals of those that took part.
    pub rms: f64,
    /// Their mean: how far the scan lies from all others together.
    pub mean: f64,
    /// Root mean square of residual over σ.
    pub rms_normalised: f64,
}

/// Some readings of position, as the fit judged them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ResidualSample {
    /// Where.
    pub places: Vec<[f64; 3]>,
    /// Signed distance from the surface.
    pub residuals: Vec<f64>,
    /// The same over its σ.
    pub normalised: Vec<f64>,
    /// Index of the scan.
    pub scan: Vec<u16>,
    /// Whether the reading took part.
    pub used: Vec<bool>,
    /// Scan by scan, in the order of the scans.
    pub scans: Vec<ScanSummary>,
    /// For each leaf, the scans that have a reading in it or in a neighbour of it.
    pub seen_by: Vec<Vec<u16>>,
}

impl ResidualSample {
    /// From feet and the information that each was given.
    pub(super) fn new(
        set: &ScanSet,
        surface: &Surface,
        readings: ProjectedReadings<'_>,
        information: &[f64],
        noise: &SensorNoise,
    ) -> Self {
        let ProjectedReadings { observations, subset, feet } = readings;
        let mut residual_sample = Self {
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
        let mut holds: Vec<Vec<bool>> = vec![Vec::new(); residual_sample.scans.len()];
        let positions: Vec<usize> = (0..feet.len())
            .filter(|&k| {
                let channel = &observations.channels[observations.channel(subset[k] as usize)];
                feet[k].quantity == Quantity::Position && !channel.inferred
            })
            .collect();
        let step = positions.len().div_ceil(MAX_SHOWN).max(1);
        for (n, &k) in positions.iter().enumerate() {
            let (i, foot) = (subset[k] as usize, &feet[k]);
            let scan = observations.scan[i] as usize;
            let (Some(figures), Some(holds)) = (residual_sample.scans.get_mut(scan), holds.get_mut(scan))
            else {
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
                if holds.is_empty() {
                    holds.resize(leaves, false);
                }
                holds[foot.leaf as usize] = true;
            } else {
                figures.rejected += 1;
            }
            if n % step == 0 {
                residual_sample.places.push(observations.points[i]);
                residual_sample.residuals.push(residual);
                residual_sample.normalised.push(normalised);
                residual_sample.scan.push(scan as u16);
                residual_sample.used.push(used);
            }
        }
        for figures in &mut residual_sample.scans {
            let n = figures.used.max(1) as f64;
            figures.rms = (figures.rms / n).sqrt();
            figures.mean /= n;
            figures.rms_normalised = (figures.rms_normalised / n).sqrt();
        }
        residual_sample.seen_by = vec![Vec::new(); leaves];
        for (scan, holds) in holds.iter().enumerate().filter(|(_, holds)| !holds.is_empty()) {
            for (leaf, seen) in with_neighbours(surface.space(), holds).into_iter().enumerate() {
                if seen {
                    residual_sample.seen_by[leaf].push(scan as u16);
                }
            }
        }
        residual_sample
    }

    /// The same with every place moved.
    pub(super) fn translated(mut self, by: [f64; 3]) -> Self {
        for place in &mut self.places {
            *place = add(*place, by);
        }
        self
    }
}
