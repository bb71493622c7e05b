//! Copies among patches: files with the same vertices, up to the rounding of their formats.
//!
//! Input: patches as they were read. Output: patches without copies. A patch is a copy if its vertices can be
//! paired with those of an earlier patch, in any order, so that no coordinate differs by more than rounding.
//! The rounding follows from the digits of the coordinates.
//!
//! Not guaranteed: a copy that was moved, thinned or smoothed is not recognised here. If its σ is stated, the
//! differences in the overlap show that its errors are shared.

use super::patches::NamedPatch;
use planish_core::{DVec3, Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, MergePatch};
use std::collections::HashMap;

/// Maximum rounding of a copy, relative to the median edge. Coarser rounding moves vertices to their
/// neighbours, and the vertices of two measurements on one grid would be equal, too.
const MAX_ROUNDING_PER_EDGE: f64 = 0.1;
/// Maximum probability that all vertices of two independent measurements agree within the rounding.
const MAX_CHANCE: f64 = 1e-9;
/// Largest number of decimals that is tried.
const MAX_DECIMALS: i32 = 9;

/// Removes patches with the same vertices as an earlier patch.
///
/// Fusing a file with its own copy would halve the variance without new information.
///
/// # Errors
/// `Input` if fewer than two patches remain.
pub(super) fn drop_copies(named: Vec<NamedPatch>, findings: &mut Vec<Finding>) -> Result<Vec<NamedPatch>> {
    let mut kept: Vec<(NamedPatch, Rounded)> = Vec::with_capacity(named.len());
    let mut copies = Vec::new();
    for patch in named {
        let rounded = Rounded::new(&patch.tidied.patch);
        let same = kept.iter_mut().find_map(|(other, of_other)| {
            let rounding = rounded.agrees(&patch.tidied.patch, of_other, &other.tidied.patch)?;
            Some((other, of_other, rounding))
        });
        match same {
            Some((other, of_other, rounding)) => {
                let (mut copy, mut original) = (patch.name.clone(), other.name.clone());
                // The file with more digits stays.
                if rounded.resolution < of_other.resolution {
                    (*other, *of_other) = (patch, rounded);
                    std::mem::swap(&mut copy, &mut original);
                }
                let but = if rounding > 0.0 { " up to rounding" } else { "" };
                copies.push(format!("{copy} has the same vertices as {original}{but}"));
            }
            None => kept.push((patch, rounded)),
        }
    }
    if kept.len() < 2 {
        let copied: String = copies.iter().map(|copy| format!(" ({copy} and counts once)")).collect();
        return Err(Error::input(format!("expected at least two patches, found {}{copied}", kept.len())));
    }
    findings.extend(copies.into_iter().map(|copy| {
        let text = format!("{copy}: it was ignored, because it adds no information");
        Finding::new(FindingCode::PatchDuplicate, text)
    }));
    Ok(kept.into_iter().map(|(patch, _)| patch).collect())
}

/// The digits of the coordinates of a patch.
struct Rounded {
    bounds: Option<BoundingBox>,
    /// Distance of neighbouring numbers with the digits of the coordinates.
    resolution: f64,
}

impl Rounded {
    fn new(patch: &MergePatch) -> Self {
        let positions = &patch.mesh.positions;
        let bounds = patch.mesh.bounding_box();
        let largest = positions.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        Self { bounds, resolution: resolution(positions, largest) }
    }

    /// The largest difference of paired coordinates if both patches are copies; `None` if they are not.
    fn agrees(&self, patch: &MergePatch, other: &Self, of_other: &MergePatch) -> Option<f64> {
        let (own, others) = (&patch.mesh.positions, &of_other.mesh.positions);
        let ([a, b], true) = ([self.bounds?, other.bounds?], own.len() == others.len()) else { return None };
        // Both files may be rounded; the last digit may be off by one after a conversion of units.
        let rounding = 1.01 * self.resolution.max(other.resolution);
        let apart = |p: DVec3, q: DVec3| (p - q).abs().max_element();
        // Boxes are compared first, because pairing all vertices is expensive.
        if apart(a.min, b.min) > rounding || apart(a.max, b.max) > rounding {
            return None;
        }
        let largest = paired(own, others, rounding)?;
        // Equal to the last digit is a copy, however coarse the digits are.
        (largest == 0.0 || is_no_chance(patch, rounding)).then_some(largest)
    }
}

/// Whether vertices of two measurements cannot all agree within a rounding by chance.
fn is_no_chance(patch: &MergePatch, rounding: f64) -> bool {
    let mesh = &patch.mesh;
    let edge = (mesh.area() / mesh.triangles.len().max(1) as f64).sqrt();
    if rounding > MAX_ROUNDING_PER_EDGE * edge {
        return false;
    }
    if patch.sigma.is_empty() {
        return true;
    }
    // The density of a normal difference with the standard deviation √2 σ, times the width of the interval.
    let log: f64 =
        patch.sigma.iter().map(|s| (rounding / (s * std::f64::consts::PI.sqrt())).min(1.0).ln()).sum();
    log < MAX_CHANCE.ln()
}

/// The distance of neighbouring numbers: 10⁻ᵈ for coordinates with d decimals, otherwise that of single or
/// double precision.
fn resolution(positions: &[DVec3], largest: f64) -> f64 {
    let numbers = || positions.iter().flat_map(|p| p.to_array());
    // Decimals in a file of single precision are rounded again.
    let single = f64::from(f32::EPSILON) * largest;
    for decimals in 0..=MAX_DECIMALS {
        let step = 10_f64.powi(-decimals);
        if step <= single {
            break;
        }
        if numbers().all(|x| (x - (x / step).round() * step).abs() <= 0.5 * single.min(0.1 * step)) {
            return step;
        }
    }
    // Texts of single precision have as many digits as tell the numbers apart.
    let is_single = |x: f64| f64::from(x as f32) == x || (x as f32).to_string().parse() == Ok(x);
    match numbers().all(is_single) {
        true => single,
        false => f64::EPSILON * largest,
    }
}

/// The largest difference of coordinates if every point has a partner within `reach`, each a different one.
fn paired(points: &[DVec3], others: &[DVec3], reach: f64) -> Option<f64> {
    let apart = |p: DVec3, q: DVec3| (p - q).abs().max_element();
    let in_order = points.iter().zip(others).map(|(p, q)| apart(*p, *q)).fold(0.0, f64::max);
    if in_order <= reach {
        return Some(in_order);
    }
    // A grid of cells of the reach: partners are in the same or a neighbouring cell.
    let side = reach.max(f64::MIN_POSITIVE);
    let cell = |p: DVec3| p.to_array().map(|x| (x / side).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<DVec3>> = HashMap::with_capacity(others.len());
    for q in others {
        cells.entry(cell(*q)).or_default().push(*q);
    }
    let mut largest = 0.0_f64;
    for p in points {
        let [x, y, z] = cell(*p);
        let around = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [i, j, k])));
        let mut best: Option<(f64, [i64; 3], usize)> = None;
        for [i, j, k] in around {
            let key = [x.saturating_add(i), y.saturating_add(j), z.saturating_add(k)];
            for (at, q) in cells.get(&key).into_iter().flatten().enumerate() {
                let far = apart(*p, *q);
                if far <= reach && best.is_none_or(|(nearest, ..)| far < nearest) {
                    best = Some((far, key, at));
                }
            }
        }
        let (far, key, at) = best?;
        cells.get_mut(&key)?.swap_remove(at);
        largest = largest.max(far);
    }
    Some(largest)
}
