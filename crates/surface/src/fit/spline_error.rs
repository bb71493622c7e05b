//! What a spline of given cells misses of the smooth shape that it follows.
//!
//! Residuals do not show it: with hundreds of readings in a cell it can be as large as σ of the surface,
//! and far below the noise of a reading. It follows from the surface itself. The best cubic spline on cells
//! of side `h` misses a function `f` by the root mean square
//!
//! ```text
//! e = √(|B₈| / 8!) h⁴ |f⁗| = 9.09·10⁻⁴ h⁴ |f⁗|
//! ```
//!
//! with the Bernoulli number `B₈ = −1/30`, and the third derivative of the spline, which is constant along
//! a cell, changes by `h f⁗` from one cell to the next. Leaves that miss more than σ of the surface are
//! divided, and the rest of `e²` is a part of σ², multiplied by what is missed of short waves
//! ([`short_wave_factor`]). Noise of independent control vertices with a standard
//! deviation of `s` adds `√70 · 9.09·10⁻⁴ s` to `e`; less than a hundredth of σ. Of fits to samples it adds
//! more ([`NOISE_SHARE`]).
//!
//! Beside a crease the second derivative of the spline is zero across it. The best spline there misses a
//! function by `0.0166 h² |f″|` in the first cell (least squares, uniform cells), and its own second
//! derivative is `1.231 f″` at the first knot inside.
//!
//! Not guaranteed: shape finer than the cells, which the spline does not follow at all
//! ([`super::unresolved_shape`]).
//!
//! # References
//! de Boor, *A practical guide to splines*, 2001, chapter XII; the constant follows from the Bernoulli
//! monospline of degree four.

use super::division::{MIN_LEAF_SIGMAS, MIN_READINGS, Misfit, all_corners};
use super::leaves::{is_piece, leaf_areas, neighbourhood};
use crate::observe::{Foot, FootState, Quantity};
use crate::subdivision::Cause;
use planish_core::DVec3;
use planish_spline::{Hierarchy, Surface, leaf_weights};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// `√(|B₈| / 8!)`.
const SPLINE_CONSTANT: f64 = 9.09e-4;
/// What a spline misses in the cell beside a crease, by its second derivative at the other side of the cell.
const CREASE_CONSTANT: f64 = 0.0166 / 1.231;
/// Distance beyond a side of a leaf at which its neighbour is looked up, in sides.
const BEYOND: f64 = 1e-3;
/// Largest share of the variance of a surface that its noise adds to what a leaf seems to miss. For uniform
/// readings of smooth shapes, the mean over leaves was 0.006 to 0.025.
pub(super) const NOISE_SHARE: f64 = 0.1;
/// Longest phase over a cell that is ascribed to shape; noise has changes of all phases.
const MAX_PHASE: f64 = 2.2;
/// Smallest cosine between the parameter lines of neighbours. At seams of a ball they may turn.
const MIN_COSINE: f64 = 0.7;

/// For each leaf, the mean square along the normal of what its cells and those around them miss, short waves
/// included.
///
/// Cells beside larger ones share control vertices with them, so that part of their error reaches over.
pub(super) fn spline_variances(surface: &Surface) -> Vec<f64> {
    let changes = changes_of_leaves(surface);
    let factors = [0, 1].map(|axis| short_wave_factor(changes.iter().map(|of_leaf| &of_leaf[axis])));
    let own = weighted_variances(surface, &changes, factors);
    (0..own.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| neighbourhood(surface.space(), leaf).into_iter().map(|k| own[k]).fold(0.0, f64::max))
        .collect()
}

/// For each leaf, the mean square `e²` along the normal of what its own cells miss of long waves.
pub(super) fn own_variances(surface: &Surface) -> Vec<f64> {
    weighted_variances(surface, &changes_of_leaves(surface), [1.0; 2])
}

/// What every leaf misses along both parameters.
fn changes_of_leaves(surface: &Surface) -> Vec<[Changes; 2]> {
    (0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| [0, 1].map(|axis| Changes::along(surface, leaf, axis)))
        .collect()
}

/// The sum of the mean squares along both parameters, times the squares of `factors`.
///
/// The pieces of a cell at an extraordinary vertex miss about as much as the worst of the cells around it.
fn weighted_variances(surface: &Surface, changes: &[[Changes; 2]], factors: [f64; 2]) -> Vec<f64> {
    let mut variances: Vec<f64> = (0..changes.len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let normal = surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap_or_default();
            let square = |axis: usize| factors[axis].powi(2) * changes[leaf][axis].mean_square(normal);
            square(0) + square(1) + square_beside_creases(surface, leaf, normal)
        })
        .collect();
    let first = first_leaves(surface.space());
    let pieces = || (0..first.len()).filter(|&leaf| is_piece(surface.space(), leaf));
    for leaf in pieces() {
        let around = neighbourhood(surface.space(), leaf).into_iter().map(|k| variances[k]);
        variances[first[leaf]] = around.fold(variances[first[leaf]], f64::max);
    }
    pieces().for_each(|leaf| variances[leaf] = variances[first[leaf]]);
    variances
}

/// The mean square along the normal of what a leaf misses because it lies beside creases.
fn square_beside_creases(surface: &Surface, leaf: usize, normal: DVec3) -> f64 {
    let space = surface.space();
    let mut sum = 0.0;
    for axis in 0..2 {
        for at_end in [false, true].into_iter().filter(|&at_end| space.is_at_crease(leaf, axis, at_end)) {
            let mut local = [0.5; 2];
            local[axis] = if at_end { 0.0 } else { 1.0 };
            let jet = surface.leaf_jet(leaf, local[0], local[1]);
            let second = [jet.duu, jet.dvv][axis].dot(normal);
            sum += (CREASE_CONSTANT * space.cell_of_leaf(leaf).side().powi(2) * second).powi(2);
        }
    }
    sum
}

/// For each leaf the number of the first leaf of its cell. Cells at extraordinary vertices have several.
fn first_leaves(space: &Hierarchy) -> Vec<usize> {
    if space.domain().is_none() {
        return (0..space.leaves().len()).collect();
    }
    let mut first = BTreeMap::new();
    (0..space.leaves().len()).map(|leaf| *first.entry(space.cell_of_leaf(leaf)).or_insert(leaf)).collect()
}

/// Leaves that miss more than σ of the surface there, worst first.
///
/// With `k` degrees of freedom in a leaf and readings of the information `Σ w`, σ² of the surface is
/// `k / Σ w` on average. Each foot stands for `per_sampled` readings of the whole cloud, and `degrees` are
/// those of all feet. All corners of a leaf are divided, because the error is that of the whole leaf.
pub(super) fn leaves_missing_shape(
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
    degrees: f64,
    per_sampled: f64,
    deepest: u8,
) -> Vec<Misfit> {
    let space = surface.space();
    // Information, number of readings and area of each cell, at its first leaf.
    let first = first_leaves(space);
    let mut sums = vec![(0.0, 0_u32); first.len()];
    for (foot, &w) in feet.iter().zip(information) {
        if foot.state == FootState::Good && foot.quantity == Quantity::Position && w > 0.0 {
            let (sum, count) = &mut sums[first[foot.leaf as usize]];
            *sum += w;
            *count += 1;
        }
    }
    let mut areas = vec![0.0; first.len()];
    leaf_areas(surface).iter().zip(&first).for_each(|(area, &cell)| areas[cell] += area);
    let measured = sums.iter().filter(|(_, count)| *count > 0).count();
    let degrees_per_cell = degrees / measured.max(1) as f64;
    let missing: Vec<(usize, f64)> = (own_variances(surface).into_iter().enumerate())
        .filter(|&(leaf, _)| {
            let (sum, count) = sums[first[leaf]];
            let variance_of_reading = f64::from(count) / sum;
            count >= MIN_READINGS
                && space.cell_of_leaf(leaf).level < deepest
                && areas[first[leaf]] > MIN_LEAF_SIGMAS.powi(2) * variance_of_reading
        })
        .map(|(leaf, missed)| {
            let sum = sums[first[leaf]].0;
            (leaf, missed / (degrees_per_cell / sum * (1.0 / per_sampled + NOISE_SHARE)))
        })
        .filter(|(_, ratio)| *ratio > 1.0)
        .collect();
    all_corners(missing, Cause::SplineError)
}

/// What a leaf misses, by the changes of the third derivative along one parameter at its two sides: none
/// at open borders, and at seams of a ball where parameter lines turn.
struct Changes([Option<DVec3>; 2]);

impl Changes {
    fn along(surface: &Surface, leaf: usize, axis: usize) -> Self {
        let space = surface.space();
        let side = space.leaves()[leaf].side();
        let (first, third) = derivatives(surface, leaf, axis, [0.5; 2]);
        Self([-BEYOND, 1.0 + BEYOND].map(|at| {
            if space.is_at_crease(leaf, axis, at > 0.5) {
                return None;
            }
            let mut local = [0.5; 2];
            local[axis] = at;
            let (other, at_other) = space.locate_near(leaf, local);
            // Beyond an open border is the leaf itself. Third derivatives of the leaves at an extraordinary
            // vertex change in any case.
            if other == leaf || [leaf, other].iter().any(|&own| is_piece(space, own)) {
                return None;
            }
            // The parameters of another quad may run along other directions.
            let (cosine, other_third) = [0, 1]
                .map(|other_axis| {
                    let (along, third) = derivatives(surface, other, other_axis, at_other);
                    let cosine = first.normalize_or_zero().dot(along.normalize_or_zero());
                    (cosine.abs(), cosine.signum() * third)
                })
                .into_iter()
                .max_by(|a, b| a.0.total_cmp(&b.0))?;
            if cosine < MIN_COSINE {
                return None;
            }
            let towards = if at < 0.0 { -1.0 } else { 1.0 };
            let distance = 0.5 * (side + space.leaves()[other].side());
            Some(towards * SPLINE_CONSTANT * side.powi(4) / distance * (other_third - third))
        }))
    }

    fn mean_square(&self, normal: DVec3) -> f64 {
        let known = || self.0.iter().flatten();
        known().map(|change| change.dot(normal).powi(2)).sum::<f64>() / known().count().max(1) as f64
    }
}

/// The factor by which waves as short as those of the changes are missed by more than `e`.
///
/// Changes on both sides of a leaf differ by `4 sin²(ω/2)` of their mean square, where `ω` is the phase of a
/// wave over a cell. A cubic spline misses a wave by the root of the sum over `k = ±1, ±2, …` of
/// `(ω/(ω + 2πk))⁸`, which is `e` for small `ω` and three times that for waves over three cells.
fn short_wave_factor<'a>(changes: impl Iterator<Item = &'a Changes>) -> f64 {
    let (mut differences, mut squares) = (0.0, 0.0);
    for Changes(sides) in changes {
        if let [Some(before), Some(after)] = sides {
            differences += (*after - *before).length_squared();
            squares += before.length_squared() + after.length_squared();
        }
    }
    if squares <= 0.0 {
        return 1.0;
    }
    let phase = (2.0 * (0.5 * differences / squares).sqrt().min(1.0).asin()).min(MAX_PHASE);
    let alias = |k: f64| (TAU / (phase + TAU * k)).powi(8);
    (0.5 * (alias(-1.0) + alias(1.0))).sqrt()
}

/// First and third derivative of a leaf along one parameter, in units of the base grid.
fn derivatives(surface: &Surface, leaf: usize, axis: usize, local: [f64; 2]) -> (DVec3, DVec3) {
    let coefficients = surface.leaf_coefficients(leaf);
    let side = surface.space().leaves()[leaf].side();
    // Weights across the axis, from those at a corner of the cell along it.
    let mut place = local;
    place[axis] = 0.0;
    let weights = leaf_weights(place[0], place[1]);
    let (step, row) = if axis == 0 { (1, 4) } else { (4, 1) };
    let mut third = DVec3::ZERO;
    for k in 0..4 {
        let across: f64 = (0..4).map(|i| weights[k * row + i * step]).sum();
        let c = |i: usize| coefficients[k * row + i * step];
        third += across * (c(3) - 3.0 * c(2) + 3.0 * c(1) - c(0));
    }
    let jet = surface.leaf_jet(leaf, local[0], local[1]);
    (if axis == 0 { jet.du } else { jet.dv }, third / side.powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_spline::{BaseShape, Shape};

    /// A tube of radius 1, interpolated at the knots: its radius departs from 1 by the spline's error.
    #[test]
    fn the_error_of_a_circle_is_that_of_its_spline() {
        for cells in [8_usize, 12, 24] {
            let base = BaseShape {
                shape: Shape::Tube,
                centre: DVec3::ZERO,
                frame: DVec3::AXES,
                size: [1.0, 1.0, 2.0],
            };
            let surface = base.surface([cells, 4]).unwrap();
            let found = spline_variances(&surface);
            let expected = SPLINE_CONSTANT * (TAU / cells as f64).powi(4);
            let mean = (found.iter().sum::<f64>() / found.len() as f64).sqrt();
            assert!((mean / expected - 1.0).abs() < 0.2, "{cells}: {mean} instead of {expected}");
        }
    }
}
