//! Gaps in the measured part of a surface, and their completion by the simple shape around them.
//!
//! Input: a converged surface with its feet. Output: for each gap the readings inferred from the shape around
//! it, if that is simple, and a report.
//!
//! A point of the surface is in a gap if no reading on its side lies within three times the spacing of the
//! readings. Adjacent leaves with such points form one gap. Its shape is classified from the readings around
//! it: in a ring wider than the gap, or in narrower ones if the readings of that ring have no simple shape.

use super::leaves::{leaf_areas, neighbourhood};
use super::refine::ConvergedFit;
use super::weights::{Weighting, weights};
use crate::complete::{GapReport, MeasuredRegion};
use crate::observe::{InferredReading, InferredVariance, Observations, ReadingColumns};
use planish_core::DVec3;
use planish_spline::{Classification, classify};
use std::f64::consts::PI;

/// Points of a leaf that are tested, along each side.
const PLACES_PER_SIDE: usize = 5;
/// Distance to the nearest reading from which a point is in a gap, in spacings of the readings.
///
/// Among readings at random, exp(−π) = 4 % of the surface is farther than one spacing from all of them, and
/// exp(−4π) = 3e-6 farther than two. With two, large surfaces would have gaps by chance.
const MIN_GAP_SPACINGS: f64 = 3.0;
/// Widths of the rings around a gap, in radii of the gap. The widest ring whose readings have one simple
/// shape is used.
const RING_WIDTHS: [f64; 3] = [1.5, 0.8, 0.4];
/// Maximum number of readings of a ring, and of points of a gap. Every reading is compared with every such
/// point.
const MAX_READINGS: usize = 4000;
const MAX_PLACES: usize = 300;

/// A point of the surface in a gap.
#[derive(Clone, Copy)]
struct Place {
    point: DVec3,
    normal: DVec3,
    area: f64,
}

/// Readings that complete the gaps, and a report of each gap, the largest first.
pub(super) fn completed(
    observations: &Observations,
    converged: &ConvergedFit,
    gate: f64,
) -> (Vec<InferredReading>, Vec<GapReport>) {
    let information = weights(converged.readings(observations), &converged.noise, gate, Weighting::Gated);
    // A gross error within a gap must not close it, and inferred readings are no evidence.
    let used: Vec<usize> = (0..converged.subset.len())
        .filter(|&k| information[k] > 0.0 && observations.inferred(converged.subset[k] as usize).is_none())
        .collect();
    let mut readings = Vec::new();
    let mut reports = Vec::new();
    for gap in gaps(&observations.readings, converged, &used) {
        let (found, around) = surroundings(&observations.readings, converged, &used, &information, &gap);
        let before = readings.len();
        if let Some(found) = &found {
            readings.extend(inferred_readings(found, &gap, around.typical_variance));
        }
        let area = gap.iter().map(|p| p.area).sum();
        reports.push(GapReport::new(found.as_ref(), area, around.readings, readings.len() - before));
    }
    (readings, reports)
}

/// The points of each gap, the largest gap first.
fn gaps(readings: &ReadingColumns, converged: &ConvergedFit, used: &[usize]) -> Vec<Vec<Place>> {
    let (surface, space) = (&converged.surface, converged.surface.space());
    let areas = leaf_areas(surface);
    let mut own = vec![false; areas.len()];
    for &k in used {
        own[converged.feet[k].leaf as usize] = true;
    }
    let seen_area: f64 = areas.iter().zip(&own).filter(|(_, o)| **o).map(|(a, _)| a).sum();
    // The spacing comes from leaves with readings alone, or gaps would enlarge it.
    let spacing = (seen_area / used.len().max(1) as f64).sqrt();
    let measured = MeasuredRegion::new(readings, MIN_GAP_SPACINGS * spacing);
    // A grid of points on each leaf, because a large leaf may have readings at one end only.
    let places: Vec<Vec<Place>> = (0..areas.len())
        .map(|leaf| {
            let grid = (0..PLACES_PER_SIDE * PLACES_PER_SIDE).map(|k| {
                [k % PLACES_PER_SIDE, k / PLACES_PER_SIDE].map(|c| (c as f64 + 0.5) / PLACES_PER_SIDE as f64)
            });
            let all = grid.filter_map(|[s, t]| {
                let jet = surface.leaf_jet(leaf, s, t);
                Some(Place {
                    point: jet.point,
                    normal: jet.normal()?,
                    area: areas[leaf] / (PLACES_PER_SIDE * PLACES_PER_SIDE) as f64,
                })
            });
            all.filter(|p| !measured.contains(p.point, p.normal)).collect()
        })
        .collect();
    let mut met = vec![false; areas.len()];
    let mut found = Vec::new();
    for first in 0..areas.len() {
        if met[first] || places[first].is_empty() {
            continue;
        }
        met[first] = true;
        // Depth-first search over adjacent leaves with gap points.
        let (mut stack, mut gap) = (vec![first], Vec::new());
        while let Some(leaf) = stack.pop() {
            gap.extend_from_slice(&places[leaf]);
            for other in neighbourhood(space, leaf) {
                if !met[other] && !places[other].is_empty() {
                    met[other] = true;
                    stack.push(other);
                }
            }
        }
        found.push(gap);
    }
    let size = |gap: &[Place]| gap.iter().map(|p| p.area).sum::<f64>();
    found.sort_by(|a, b| size(b).total_cmp(&size(a)));
    found
}

/// The readings around a gap.
struct Surroundings {
    readings: usize,
    typical_variance: f64,
}

/// Classifies the readings around a gap.
fn surroundings(
    readings: &ReadingColumns,
    converged: &ConvergedFit,
    used: &[usize],
    information: &[f64],
    gap: &[Place],
) -> (Option<Classification>, Surroundings) {
    // The radius of a disc of the same area.
    let radius = (gap.iter().map(|p| p.area).sum::<f64>() / PI).sqrt();
    let sample: Vec<&Place> = gap.iter().step_by(gap.len().div_ceil(MAX_PLACES)).collect();
    // Distance of each reading from the nearest point of the gap.
    let away: Vec<f64> = used
        .iter()
        .map(|&k| {
            let z = readings.points[converged.subset[k] as usize];
            sample.iter().map(|p| p.point.distance(z)).fold(f64::INFINITY, f64::min)
        })
        .collect();
    let nearest = away.iter().copied().fold(f64::INFINITY, f64::min);
    let mut around = Surroundings { readings: 0, typical_variance: 0.0 };
    // The widest ring with one simple shape has the most readings, hence the smallest σ of the shape.
    for ring in RING_WIDTHS {
        let near: Vec<usize> = (used.iter().zip(&away))
            .filter(|(_, d)| **d <= nearest + ring * radius)
            .map(|(&k, _)| k)
            .collect();
        let near: Vec<usize> =
            near.iter().copied().step_by(near.len().div_ceil(MAX_READINGS).max(1)).collect();
        let points: Vec<DVec3> =
            near.iter().map(|&k| readings.points[converged.subset[k] as usize]).collect();
        let normals: Vec<DVec3> = near.iter().map(|&k| converged.feet[k].normal).collect();
        let variance: Vec<f64> = near.iter().map(|&k| 1.0 / information[k]).collect();
        around.readings = near.len();
        around.typical_variance = variance.iter().sum::<f64>() / near.len().max(1) as f64;
        if let Some(found) = classify(&points, &normals, &variance) {
            return (Some(found), around);
        }
    }
    (None, around)
}

/// Readings inferred from the shape, one near every point of a gap.
fn inferred_readings(found: &Classification, gap: &[Place], own: f64) -> Vec<InferredReading> {
    let radius = (gap.iter().map(|p| p.area).sum::<f64>() / PI).sqrt();
    gap.iter()
        .filter_map(|place| {
            let predicted = found.predict(place.point, place.normal);
            let off = predicted.point - place.point;
            // A point farther away than the gap is wide belongs to another part of the shape.
            (off.length_squared() < radius * radius).then_some(InferredReading {
                point: predicted.point,
                normal: predicted.normal,
                variance: InferredVariance { own, shared: predicted.variance },
            })
        })
        .collect()
}
