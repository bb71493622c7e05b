//! Openings of the readings: connected parts of a closed surface without any.

use crate::fit::leaves::{leaf_areas, neighbourhood};
use crate::model::{Observed, SurfaceModel, is_closed, middles};
use crate::observe::RejectionCause;
use planish_core::numbers::significant;
use planish_core::{BoundingBox, DVec3, Finding, FindingCode, Setting, connected_groups};
use std::collections::BTreeMap;

/// Smallest share of a closed surface in openings that is reported. A gap of 10 mm in one of three joined
/// rings is 3 %.
const MIN_SHARE: f64 = 0.02;
/// Openings with less than this share of the surface are not counted: readings of a whole object leave small
/// ones by chance, and beside sharp edges.
const MIN_OPENING: f64 = 0.003;
/// Isolated readings that are mentioned.
const MIN_ISOLATED: usize = 20;
/// Largest number of openings that are listed.
const MAX_LISTED: usize = 3;

/// A place without readings.
pub(super) struct UnobservedCell {
    pub leaf: usize,
    pub place: DVec3,
    /// Distance to the nearest reading.
    pub distance: f64,
    pub area: f64,
}

/// The cells without readings.
pub(super) fn unobserved_cells(model: &SurfaceModel, areas: &[f64]) -> Vec<UnobservedCell> {
    (model.support.leaves().enumerate())
        .flat_map(|(leaf, (depth, cells))| {
            let area = areas[leaf] / cells.len() as f64;
            (cells.iter().zip(middles(depth))).filter(|(cell, _)| cell.observed == Observed::PriorOnly).map(
                move |(cell, [s, t])| UnobservedCell {
                    leaf,
                    place: model.surface.leaf_point(leaf, s, t),
                    distance: cell.distance,
                    area,
                },
            )
        })
        .collect()
}

/// The connected leaves with cells without readings: for each opening, its cells.
pub(super) fn openings<'a>(
    model: &SurfaceModel,
    cells: &'a [UnobservedCell],
) -> Vec<Vec<&'a UnobservedCell>> {
    let space = model.surface.space();
    let mut is_open = vec![false; space.leaves().len()];
    cells.iter().for_each(|cell| is_open[cell.leaf] = true);
    let groups = connected_groups(&is_open, |leaf| neighbourhood(space, leaf));
    let mut number = vec![0; is_open.len()];
    for (k, group) in groups.iter().enumerate() {
        group.iter().for_each(|&leaf| number[leaf] = k);
    }
    let mut found = vec![Vec::new(); groups.len()];
    cells.iter().for_each(|cell| found[number[cell.leaf]].push(cell));
    found
}

/// The openings of at least [`MIN_OPENING`], each with its share of the area.
fn large_openings<'a>(
    model: &SurfaceModel,
    cells: &'a [UnobservedCell],
    areas: &[f64],
) -> Vec<(f64, Vec<&'a UnobservedCell>)> {
    let total: f64 = areas.iter().sum();
    (openings(model, cells).into_iter())
        .map(|opening| (opening.iter().map(|cell| cell.area).sum::<f64>() / total, opening))
        .filter(|(share, _)| *share >= MIN_OPENING)
        .collect()
}

/// For each leaf of a model, true if it has a part of an opening that is no chance gap between readings.
pub(crate) fn open_leaves(model: &SurfaceModel) -> Vec<bool> {
    let areas = leaf_areas(&model.surface);
    let cells = unobserved_cells(model, &areas);
    let mut is_open = vec![false; areas.len()];
    for (_, opening) in large_openings(model, &cells, &areas) {
        opening.iter().for_each(|cell| is_open[cell.leaf] = true);
    }
    is_open
}

/// The finding about a closed surface of which much was closed without readings; none for other surfaces.
/// `origin` is the world position of the origin of the surface's coordinates.
///
/// `rejected` counts readings by cause. Those of a part that was measured too sparsely are isolated.
pub(super) fn closed_openings(
    model: &SurfaceModel,
    areas: &[f64],
    origin: DVec3,
    rejected: &BTreeMap<String, usize>,
) -> Option<Finding> {
    if !is_closed(model.surface.space()) {
        return None;
    }
    let cells = unobserved_cells(model, areas);
    let mut found = large_openings(model, &cells, areas);
    let all: f64 = found.iter().map(|(share, _)| share).sum();
    if all < MIN_SHARE {
        return None;
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let described: Vec<String> = (found.iter().take(MAX_LISTED))
        .filter_map(|(_, opening)| place_and_size(opening))
        .map(|(middle, size)| {
            let [x, y, z] = (middle + origin).to_array().map(|c| significant(c, 4));
            format!("({x}, {y}, {z}) {unit}, of size {} {unit}", significant(size, 2), unit = model.unit)
        })
        .collect();
    let places = match found.len() {
        1 => format!("in one opening near {}", described[0]),
        n if n <= MAX_LISTED => format!("in {n} openings near {}", described.join("; ")),
        n => format!("in {n} openings, the largest near {}", described.join("; ")),
    };
    let isolated = match rejected.get(RejectionCause::Isolated.name()) {
        Some(&count) if count >= MIN_ISOLATED => format!(
            "; {count} isolated readings were rejected, which may belong to parts that were measured sparsely"
        ),
        _ => String::new(),
    };
    let text = format!(
        "{} % of the surface was closed without readings, {places}: its shape there \
         follows from the smoothness prior alone, and σ allows for edges{isolated}; specify \"never\" to \
         leave it open",
        significant(100.0 * all, 2)
    );
    Some(Finding::new(FindingCode::OpeningsClosed, text).with_setting(Setting::Close))
}

/// The middle of an opening, on the surface, and the diagonal of its bounding box; none without cells.
fn place_and_size(opening: &[&UnobservedCell]) -> Option<(DVec3, f64)> {
    let places = || opening.iter().map(|cell| cell.place);
    let bounds = BoundingBox::around(places())?;
    let middle = bounds.center();
    // The middle of the box may be far from the surface.
    let nearest = places().min_by(|a, b| a.distance(middle).total_cmp(&b.distance(middle)))?;
    Some((nearest, bounds.diagonal()))
}
