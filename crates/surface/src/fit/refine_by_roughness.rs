//! Subdivision by roughness: cells wider than the length over which the prior smooths.
//!
//! Residuals without structure do not prove that cells are small enough. On a surface as rough as its thin
//! plate allows, most of the error is detail below the cells, each piece too weak to be detected. The
//! readings determine shape down to the length `ℓ` over which the prior smooths. A grid of much wider cells
//! is stiffer than the prior, and σ does not contain what it cannot represent.

use super::division::{Misfit, all_corners};
use super::leaves::leaf_areas;
use super::weights::smoothing_information;
use crate::observe::{Foot, FootState};
use crate::subdivision::Cause;
use planish_spline::Surface;

/// Widest cell, in smoothing lengths.
///
/// For surfaces drawn from a thin plate over much finer cells, 95 % intervals of positions cover 81 % without
/// this rule and 95 % with it. For surfaces without such detail they cover 99 %, so the rule is optional.
/// See decision 0007.
const MAX_WIDTH: f64 = 3.0;
/// Minimum number of readings of a leaf that is divided: one for each quarter.
const MIN_READINGS: usize = 4;

/// All corners of the leaves wider than [`MAX_WIDTH`] smoothing lengths, widest first.
pub(super) fn leaves_coarser_than_smoothing(
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
    weight: f64,
    deepest: u8,
) -> Vec<Misfit> {
    let space = surface.space();
    let areas = leaf_areas(surface);
    let mut sums = vec![(0.0, 0_usize); areas.len()];
    for (foot, &w) in feet.iter().zip(information) {
        if foot.state == FootState::Good && w > 0.0 {
            let leaf = foot.leaf as usize;
            // Instead of ℓ = (w/ρ)^{1/4}, the test compares ρ (side/3)⁴ with w: the information then adds
            // over quantities of different units.
            let length = areas[leaf].sqrt() / MAX_WIDTH;
            sums[leaf].0 += smoothing_information(foot.quantity, w, length) / areas[leaf];
            sums[leaf].1 += 1;
        }
    }
    let wide: Vec<(usize, f64)> = (sums.iter().enumerate())
        .filter(|(leaf, (stiffness, readings))| {
            *stiffness > weight && *readings >= MIN_READINGS && space.leaves()[*leaf].level < deepest
        })
        .map(|(leaf, (stiffness, _))| (leaf, stiffness / weight))
        .collect();
    all_corners(wide, Cause::Roughness)
}
