//! Places where the surface does not follow the readings, for findings and reports.
//!
//! Input: the misfit of each leaf. Output: the connected regions of leaves whose misfit is larger than the
//! noise, the largest first.

use super::leaves::{leaf_areas, neighbourhood};
use super::local_misfit::LeafMisfit;
use planish_core::numbers::significant;
use planish_core::{DVec3, Finding, FindingCode, SmallUnit, Unit, connected_groups};
use planish_spline::Surface;
use serde::Serialize;

/// Smallest number of leaves of a region. Leaves with few readings are judged with their neighbours.
const MIN_LEAVES: usize = 4;
/// Smallest number of readings of a region. Leaves are small near the poles of a ball, where the surface of a
/// smooth body may be rough over the spacing of a few readings.
const MIN_READINGS: usize = 24;
/// Largest share of the surface for regions that are places.
const MAX_SHARE: f64 = 0.5;
/// Largest number of places in a report.
const MAX_PLACES: usize = 5;

/// A part of the surface that does not follow its readings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MisfitPlace {
    /// Its middle, in world coordinates.
    pub place: DVec3,
    /// Diagonal of its bounding box, in the model's unit.
    pub size: f64,
    /// Root mean square of the residuals beyond the noise, in the model's unit.
    pub rms: f64,
    /// Share of the surface's area.
    pub area_fraction: f64,
}

/// What the surface does not follow.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct MisfitReport {
    /// Share of the surface's area.
    pub area_fraction: f64,
    /// Share of the position readings beyond the gate of their own σ.
    pub readings_fraction: f64,
    /// The largest places, the largest first.
    pub places: Vec<MisfitPlace>,
    /// Number of places.
    pub count: usize,
}

impl MisfitReport {
    /// From the misfit of each leaf and its regions; none if the surface follows its readings. `origin` is
    /// the world position of the origin of the surface.
    pub(super) fn from_leaves(
        surface: &Surface,
        misfits: &[LeafMisfit],
        regions: &[Vec<usize>],
        origin: DVec3,
    ) -> Option<Self> {
        let areas = leaf_areas(surface);
        let total: f64 = areas.iter().sum();
        let mut places: Vec<MisfitPlace> =
            (regions.iter()).map(|leaves| place(surface, misfits, &areas, total, leaves, origin)).collect();
        places.sort_by(|a, b| b.area_fraction.total_cmp(&a.area_fraction));
        let readings: usize = misfits.iter().map(|own| own.readings).sum();
        let not_followed: usize = misfits.iter().map(|own| own.not_followed).sum();
        let (count, area_fraction) = (places.len(), places.iter().map(|own| own.area_fraction).sum());
        places.truncate(MAX_PLACES);
        (count > 0).then(|| Self {
            area_fraction,
            readings_fraction: not_followed as f64 / readings.max(1) as f64,
            places,
            count,
        })
    }

    /// The finding; none without a place.
    pub(super) fn finding(&self, unit: Unit) -> Option<Finding> {
        let largest = self.places.first()?;
        let lengths = SmallUnit::for_length(unit.name(), largest.rms);
        let [x, y, z] = largest.place.to_array().map(|c| lengths.number(c, 4));
        let what = match self.count {
            1 => "at one place".to_owned(),
            n => format!("at {n} places, the largest"),
        };
        let text = format!(
            "the surface does not follow the readings {what} near ({x}, {y}, {z}) {}, of size {}: an edge, a \
             handle, a thin part, bodies closer to each other than their readings, or a wrong shape; {} % of \
             the surface, rms {} beyond the noise, which σ includes",
            lengths.name,
            lengths.text(largest.size),
            significant(100.0 * self.area_fraction, 2),
            lengths.text(largest.rms)
        );
        Some(Finding::new(FindingCode::SurfaceNotFollowing, text))
    }
}

/// The connected regions of leaves whose misfit is larger than the noise, without small ones.
pub(super) fn misfit_regions(surface: &Surface, misfits: &[LeafMisfit]) -> Vec<Vec<usize>> {
    let exceed: Vec<bool> = misfits.iter().map(LeafMisfit::exceeds_noise).collect();
    let regions = connected_groups(&exceed, |leaf| neighbourhood(surface.space(), leaf));
    let areas = leaf_areas(surface);
    let total: f64 = areas.iter().sum();
    let is_place = |leaves: &Vec<usize>| {
        let readings: usize = leaves.iter().map(|&leaf| misfits[leaf].readings).sum();
        leaves.len() >= MIN_LEAVES && readings >= MIN_READINGS
    };
    let found: Vec<Vec<usize>> = regions.into_iter().filter(is_place).collect();
    let of_regions: f64 = found.iter().flatten().map(|&leaf| areas[leaf]).sum();
    // What is the same everywhere, as differences between scans are, is no matter of places.
    if of_regions > MAX_SHARE * total { Vec::new() } else { found }
}

/// The place of a region of leaves.
fn place(
    surface: &Surface,
    misfits: &[LeafMisfit],
    areas: &[f64],
    total: f64,
    leaves: &[usize],
    origin: DVec3,
) -> MisfitPlace {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (mut square, mut area) = (0.0, 0.0);
    for &leaf in leaves {
        let middle = surface.leaf_point(leaf, 0.5, 0.5);
        (low, high) = (low.min(middle), high.max(middle));
        square += areas[leaf] * misfits[leaf].variance;
        area += areas[leaf];
    }
    // A region along an edge may surround its own middle, so the nearest of its leaves stands for it.
    let middle = 0.5 * (low + high);
    let nearest = (leaves.iter().map(|&leaf| surface.leaf_point(leaf, 0.5, 0.5)))
        .min_by(|a, b| a.distance(middle).total_cmp(&b.distance(middle)))
        .unwrap_or(middle);
    MisfitPlace {
        place: nearest + origin,
        // Middles of leaves leave out half a leaf on each side.
        size: (high - low).length() + (area / leaves.len() as f64).sqrt(),
        rms: (square / area).sqrt(),
        area_fraction: area / total,
    }
}
