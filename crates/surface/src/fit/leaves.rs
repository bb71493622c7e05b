//! Leaves of a hierarchy: neighbourhoods, areas, and which of them hold readings.

use crate::observe::Foot;
use planish_spline::{Hierarchy, Surface};
use rayon::prelude::*;

/// A leaf and those around it, each once.
pub(super) fn neighbourhood(space: &Hierarchy, leaf: usize) -> Vec<usize> {
    // Points half a leaf beyond each side and corner lie in a neighbour, whatever its level.
    let mut found: Vec<usize> = [-0.5, 0.5, 1.5]
        .into_iter()
        .flat_map(|dv| [-0.5, 0.5, 1.5].map(|du| [du, dv]))
        .map(|local| space.locate_near(leaf, local).0)
        .collect();
    // Several of the nine points may lie in one coarser neighbour.
    found.sort_unstable();
    found.dedup();
    found
}

/// For each leaf, whether it holds an ungated foot of those that count, by their number.
pub(super) fn leaves_with_feet(
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
    counts: impl Fn(usize) -> bool,
) -> Vec<bool> {
    let space = surface.space();
    let mut own = vec![false; space.leaves().len()];
    for (k, (foot, &w)) in feet.iter().zip(information).enumerate() {
        own[foot.leaf as usize] |= w > 0.0 && counts(k);
    }
    own
}

/// The marked leaves and the neighbours of each.
pub(crate) fn with_neighbours(space: &Hierarchy, own: &[bool]) -> Vec<bool> {
    // The functions of a leaf extend over its neighbours, so its readings determine the surface there as
    // well.
    let mut observed = own.to_vec();
    for leaf in 0..own.len() {
        if own[leaf] {
            for other in neighbourhood(space, leaf) {
                observed[other] = true;
            }
        }
    }
    observed
}

/// True for a leaf that is one of the pieces of a cell at an extraordinary vertex.
pub(super) fn is_piece(space: &Hierarchy, leaf: usize) -> bool {
    space.cell_of_leaf(leaf) != space.leaves()[leaf]
}

/// Area of each leaf.
pub(super) fn leaf_areas(surface: &Surface) -> Vec<f64> {
    // Areas are collected in the order of leaves, so sums over them do not depend on the threads.
    (0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| surface.leaf_area(leaf))
        .collect()
}
