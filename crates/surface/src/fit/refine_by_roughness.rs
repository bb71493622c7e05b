//! Where the smoothness that was found leaves shape finer than the cells.
//!
//! Residuals that say nothing are no proof that a cell holds all there is: of a surface as rough as its thin
//! plate allows, most of the error is then detail below the cells, each piece of it too weak to be seen. What
//! the readings determine ends at the length `ℓ` over which the prior smooths; a grid of cells far wider than
//! that is the stiffer of the two, and the stated σ knows nothing of what it leaves out.

use super::division::Misfit;
use super::leaves::leaf_areas;
use super::weights::smoothing_information;
use crate::observe::{Foot, FootState};
use crate::subdivision::Cause;
use planish_spline::Surface;

/// Widest cell, in smoothing lengths. Of surfaces drawn from a thin plate over cells far finer than the
/// fit's, 95 % intervals of positions cover 81 % without this rule and 95 % with it; those of surfaces
/// without such detail cover 99 %, which is why it has to be asked for.
const WIDEST: f64 = 3.0;
/// A leaf is divided for its readings' sake: each quarter wants one.
const MIN_READINGS: usize = 4;

/// The leaves wider than three smoothing lengths, widest first; every corner of each.
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
            let length = areas[leaf].sqrt() / WIDEST;
            sums[leaf].0 += smoothing_information(foot.quantity, w, length) / areas[leaf];
            sums[leaf].1 += 1;
        }
    }
    let mut wide: Vec<(usize, f64)> = (sums.iter().enumerate())
        .filter(|(leaf, (stiffness, readings))| {
            *stiffness > weight && *readings >= MIN_READINGS && space.leaves()[*leaf].level < deepest
        })
        .map(|(leaf, (stiffness, _))| (leaf, stiffness / weight))
        .collect();
    wide.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    (wide.into_iter())
        .flat_map(|(leaf, severity)| {
            [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]].map(|corner| Misfit {
                leaf,
                cause: Cause::Roughness,
                severity,
                corner,
            })
        })
        .collect()
}
