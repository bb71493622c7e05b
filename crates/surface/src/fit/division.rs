//! Division of leaves: which are divided within the limits, and the log of it.

use super::FitOptions;
use super::leaves::is_piece;
use crate::subdivision::{Cause, RefinementLog};
use planish_spline::{Cell, Hierarchy};
use std::collections::HashSet;

/// Minimum number of readings of a leaf that is divided: each quarter should keep two.
pub(super) const MIN_READINGS: u32 = 8;
/// Smallest side of a leaf that is divided, in σ of its readings.
///
/// On smaller leaves readings find a foot nearby however the surface wrinkles, and σ is underestimated: on a
/// sphere of 40 000 readings with σ of 5 % of its radius it came out as 3.6 %. See decision 0005.
pub(super) const MIN_LEAF_SIGMAS: f64 = 6.0;
/// Deepest level below the base grid: at most 16 384 leaves of it fit in one base cell.
const MAX_DEPTH: u8 = 7;

/// A leaf that should be divided.
pub(super) struct Misfit {
    pub leaf: usize,
    pub cause: Cause,
    /// How urgent it is, in the measure of its cause: the shape that its readings share, in standard
    /// deviations of noise; the variation of its curvature; or its stiffness over that of the prior.
    pub severity: f64,
    /// Signs of the corner at which it should be divided.
    pub corner: [f64; 2],
}

/// Signs of the four corners of a leaf.
pub(super) const CORNERS: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];

/// Misfits at all corners of some leaves, each with its severity, worst first.
pub(super) fn all_corners(mut leaves: Vec<(usize, f64)>, cause: Cause) -> Vec<Misfit> {
    leaves.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    (leaves.into_iter())
        .flat_map(|(leaf, severity)| CORNERS.map(|corner| Misfit { leaf, cause, severity, corner }))
        .collect()
}

/// Nodes that the division of a leaf adds, with those of leaves that grading divides. More are counted.
const NODES_OF_DIVISION: usize = 16;

/// The deepest level that is allowed.
pub(super) fn deepest(options: &FitOptions) -> u8 {
    options.max_depth.map_or(MAX_DEPTH, |depth| MAX_DEPTH.min(depth))
}

/// Number of misfits expected by chance (2 % of the leaves).
pub(super) fn chance_misfits(space: &Hierarchy) -> usize {
    space.leaves().len().div_ceil(50)
}

/// Divides as many of the misfits, worst first, as the limit of coefficients allows; returns the finer
/// hierarchy and their number.
pub(super) fn divided_within_budget(
    space: &Hierarchy,
    misfits: &[Misfit],
    max_nodes: usize,
) -> (Hierarchy, usize) {
    let marked = |count: usize| blocks(space, &misfits[..count]);
    let nodes = |count: usize| space.refined_node_count(&marked(count));
    let all = marked(misfits.len());
    // A hierarchy that is far from the limit needs no count before it is made.
    let is_near = space.node_count() + NODES_OF_DIVISION * all.len() > max_nodes;
    if !is_near || space.refined_node_count(&all) <= max_nodes {
        let finer = space.refine(&all);
        if finer.node_count() <= max_nodes {
            return (finer, misfits.len());
        }
    }
    // Bisection: grading adds leaves around divided ones, so the nodes of a refinement are only known by
    // counting.
    let (mut fits, mut too_many) = (0, misfits.len());
    // A few leaves more or less do not matter, and each step counts the nodes of a hierarchy.
    while too_many - fits > chance_misfits(space).div_ceil(8) {
        let middle = fits.midpoint(too_many);
        if nodes(middle) <= max_nodes {
            fits = middle;
        } else {
            too_many = middle;
        }
    }
    (space.refine(&marked(fits)), fits)
}

/// The divisions of a starting surface, counted in squares of `cells` cells.
pub(super) fn growth_log(space: &Hierarchy, cells: usize) -> RefinementLog {
    let mut log = RefinementLog::default();
    // In sixteenths, because a cell has one leaf or sixteen pieces.
    let mut sixteenths = vec![0; space.levels()];
    for leaf in 0..space.leaves().len() {
        let share = if is_piece(space, leaf) { 1 } else { 16 };
        sixteenths[usize::from(space.cell_of_leaf(leaf).level)] += share;
    }
    let mut divided = 0;
    for level in (1..sixteenths.len()).rev() {
        divided = (sixteenths[level] / 16 + divided) / 4;
        if divided >= cells {
            log.add(level - 1, Cause::Growth, divided / cells);
        }
    }
    log
}

/// Adds the divided leaves to the log, each with its cause.
pub(super) fn log_divisions(
    log: &mut RefinementLog,
    space: &Hierarchy,
    finer: &Hierarchy,
    misfits: &[Misfit],
) {
    let leaves_of = |cause: Cause| -> HashSet<usize> {
        let own = misfits.iter().filter(|m| m.cause == cause);
        blocks(space, own).into_iter().collect()
    };
    let causes = [Cause::Residuals, Cause::SplineError, Cause::Curvature, Cause::Roughness]
        .map(|cause| (cause, leaves_of(cause)));
    // Grading divides leaves that no misfit asked for, so the log compares the two hierarchies.
    let kept: HashSet<Cell> = finer.leaves().iter().copied().collect();
    for (leaf, cell) in space.leaves().iter().enumerate().filter(|(_, cell)| !kept.contains(cell)) {
        let own = causes.iter().find(|(_, leaves)| leaves.contains(&leaf));
        let cause = own.map_or(Cause::Grading, |(cause, _)| *cause);
        log.add(usize::from(cell.level), cause, 1);
    }
}

/// The leaves to refine for each misfit: the 2 × 2 block at its worst corner.
///
/// A bicubic function of the next level needs a whole block; refining a single cell would activate none.
pub(super) fn blocks<'a>(space: &Hierarchy, misfits: impl IntoIterator<Item = &'a Misfit>) -> Vec<usize> {
    let mut marked = Vec::new();
    for &Misfit { leaf, corner: [su, sv], .. } in misfits {
        for dv in [0.5, 0.5 + sv] {
            for du in [0.5, 0.5 + su] {
                let (other, _) = space.locate_near(leaf, [du, dv]);
                // A finer neighbour has the functions of the next level already.
                if space.cell_of_leaf(other).level <= space.cell_of_leaf(leaf).level {
                    marked.push(other);
                }
            }
        }
    }
    marked.sort_unstable();
    marked.dedup();
    marked
}
