//! Places where the surface does not follow its readings.
//!
//! Input: readings with their feet on a converged surface. Output: the readings that it does not follow, in
//! clusters, and the share of the measured area that they stand for.
//!
//! The σ that a fit estimates contains what its surface misses, so it cannot judge the surface. Here the
//! distance of a reading counts against the noise that the sensor states or that neighbouring readings
//! show, whichever is larger, and against the spacing of the readings. Gross errors are single, or as sparse
//! as errors in a volume are; shape that the surface misses is dense, and neighbours miss it together.
//!
//! Not guaranteed: shape smaller than about one spacing of 40,000 readings, which is part of σ instead
//! ([`super::unresolved_shape`]).

use super::noise::SensorNoise;
use crate::observe::{FootState, ProjectedReadings, Quantity};
use planish_core::random::{nth, unit_interval};
use planish_core::{DVec3, connected_groups};
use planish_estimate::Result;
use planish_mesh::BoundingBox;
use planish_sense::Neighbourhoods;
use serde::Serialize;

/// Readings that are judged; more would only take longer.
const MAX_JUDGED: usize = 40_000;
/// Fewer readings cannot show a cluster.
const MIN_JUDGED: usize = 200;
/// Neighbours of a reading, the share of them that is not followed either in a cluster, and the smallest
/// cluster.
const NEIGHBOURS: usize = 10;
const MIN_SHARE: f64 = 0.6;
const MIN_CLUSTER: usize = 12;
/// A reading is not followed if it is farther from the surface than this many spacings. Closer, the shape is
/// below what the readings resolve well, and part of σ.
const FAR_SPACINGS: f64 = 1.5;
/// Readings of a missed part are at most this many times as far apart as followed ones; those that agree on
/// no surface with their neighbours must be denser.
const SPARSE: f64 = 3.0;
const SPARSE_OFF_SURFACE: f64 = 1.3;

/// A place where the surface does not follow its readings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnresolvedPlace {
    /// Mean position of the readings, in world coordinates.
    pub centre: [f64; 3],
    /// Diagonal of their bounding box.
    pub size: f64,
    /// Median distance of the readings from the surface.
    pub distance: f64,
    /// Share of the measured area.
    pub area_fraction: f64,
}

/// What the surface does not follow.
#[derive(Debug, Clone, Default)]
pub(super) struct SurfaceMisfit {
    /// Share of the measured area.
    pub area_fraction: f64,
    /// Places, largest first.
    pub places: Vec<UnresolvedPlace>,
    /// Typical spacing of the readings that were judged; 0 if they were too few.
    pub spacing: f64,
    /// Leaf and place in it of the feet of the readings that are not followed.
    pub feet: Vec<(usize, [f64; 2])>,
}

impl SurfaceMisfit {
    /// The same, with more places at which the surface is not followed.
    pub(super) fn with_feet(mut self, places: Vec<(usize, [f64; 2])>) -> Self {
        self.feet.extend(places);
        self
    }
}

/// A reading that is judged.
struct JudgedReading {
    foot: (usize, [f64; 2]),
    point: DVec3,
    /// Distance from the surface, and whether noise cannot explain it.
    distance: f64,
    beyond_noise: bool,
    wrong_side: bool,
    on_surface: bool,
}

/// Finds what the surface does not follow; nothing if the readings are too few to show it.
///
/// # Errors
/// `Undetermined` if the readings cannot be searched.
pub(super) fn surface_misfit(
    readings: ProjectedReadings<'_>,
    gate: f64,
    origin: DVec3,
) -> Result<SurfaceMisfit> {
    let judged = judged_readings(readings, gate);
    if judged.len() < MIN_JUDGED {
        return Ok(SurfaceMisfit::default());
    }
    let points: Vec<DVec3> = judged.iter().map(|r| r.point).collect();
    let near = Neighbourhoods::new(&points, NEIGHBOURS)?;
    let spacing: Vec<f64> = (0..points.len()).map(|i| near.spacing(i)).collect();
    let missed: Vec<bool> = (judged.iter().zip(&spacing))
        .map(|(r, spacing)| {
            // The distance to a surface that faces the other way says nothing, however small it is.
            r.distance > FAR_SPACINGS * spacing && (r.beyond_noise || r.wrong_side)
        })
        .collect();
    let typical = median(
        judged
            .iter()
            .zip(&missed)
            .zip(&spacing)
            .filter(|((r, missed), _)| r.on_surface && !**missed)
            .map(|(_, s)| *s),
    );
    let dense = |i: usize| {
        let bound = if judged[i].on_surface { SPARSE } else { SPARSE_OFF_SURFACE };
        // Without any reading that is followed there is nothing to compare with.
        typical.is_none_or(|typical| spacing[i] <= bound * typical)
    };
    let candidates: Vec<bool> = (0..judged.len()).map(|i| missed[i] && dense(i)).collect();
    let share = |i: usize| near.share(i, |j| Some(candidates[j])).unwrap_or(0.0);
    let clustered: Vec<bool> = (0..judged.len()).map(|i| candidates[i] && share(i) >= MIN_SHARE).collect();
    let clusters = clusters(&near, &clustered);
    let area = |i: usize| spacing[i] * spacing[i];
    let followed: f64 = (0..judged.len()).filter(|&i| judged[i].on_surface && !missed[i]).map(area).sum();
    let lost = clusters.iter().flatten().fold(0.0, |sum, &i| sum + area(i));
    let total = (followed + lost).max(f64::MIN_POSITIVE);
    let mut places: Vec<UnresolvedPlace> = clusters
        .iter()
        .map(|cluster| {
            let of_cluster: Vec<DVec3> = cluster.iter().map(|&i| points[i]).collect();
            let middle = of_cluster.iter().sum::<DVec3>() / cluster.len() as f64;
            UnresolvedPlace {
                centre: (middle + origin).to_array(),
                size: BoundingBox::from_points(&of_cluster).map_or(0.0, |b| b.diagonal()),
                distance: median(cluster.iter().map(|&i| judged[i].distance)).unwrap_or(0.0),
                area_fraction: cluster.iter().map(|&i| area(i)).sum::<f64>() / total,
            }
        })
        .collect();
    places.sort_by(|a, b| b.area_fraction.total_cmp(&a.area_fraction));
    let feet = clusters.iter().flatten().map(|&i| judged[i].foot).collect();
    Ok(SurfaceMisfit { area_fraction: lost / total, places, spacing: typical.unwrap_or(0.0), feet })
}

/// The positions that are judged, with their distances.
fn judged_readings(readings: ProjectedReadings<'_>, gate: f64) -> Vec<JudgedReading> {
    let ProjectedReadings { observations, subset, feet } = readings;
    let bounds = noise_bounds(readings);
    let share = MAX_JUDGED as f64 / subset.len() as f64;
    (0..subset.len())
        // By a hash of the number: every n-th reading of a grid would be a row.
        .filter(|&k| share >= 1.0 || unit_interval(nth(k as u64)) < share)
        .filter_map(|k| {
            let (i, foot) = (subset[k] as usize, &feet[k]);
            if foot.quantity != Quantity::Position || observations.inferred(i).is_some() {
                return None;
            }
            let variance = bounds[observations.channel(i)] * foot.variance;
            Some(JudgedReading {
                foot: (foot.leaf as usize, foot.local),
                point: observations.readings.points[i],
                distance: foot.height().abs(),
                beyond_noise: foot.height().abs() > gate * variance.sqrt(),
                wrong_side: foot.state == FootState::NormalMismatch,
                on_surface: observations.readings.on_surface[i],
            })
        })
        .collect()
}

/// For each channel, the variance of its noise over the stated one, from what is independent of the surface:
/// the statement, and the scatter of readings about the planes of their neighbours.
fn noise_bounds(readings: ProjectedReadings<'_>) -> Vec<f64> {
    let stated = SensorNoise::stated(&readings.observations.channels);
    (readings.observations.channels.iter().zip(&stated.factor_bounds))
        .map(|(channel, bound)| match (channel.roughness, channel.stated) {
            (Some(roughness), true) => roughness.max(1.0),
            (Some(roughness), false) => roughness,
            (None, true) => 1.0,
            (None, false) => *bound,
        })
        .collect()
}

/// Groups of marked readings that are neighbours, without small ones.
fn clusters(near: &Neighbourhoods, marked: &[bool]) -> Vec<Vec<usize>> {
    let mut all = connected_groups(marked, |i| near.neighbours(i).iter().map(|&j| j as usize));
    all.retain(|cluster| cluster.len() >= MIN_CLUSTER);
    all
}

/// The middle of some numbers; none of no numbers.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
