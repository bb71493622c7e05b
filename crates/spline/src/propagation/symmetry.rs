//! Symmetry of a cloud: a least-squares axis or plane with its covariance, and a test of whether it exists.
//!
//! A symmetry maps facets of the surface onto each other. The residual of a pair is the height of the image
//! of one facet over the quadric of the other, `r = n·(g(p) − q)`. The axis or plane minimises `Σ w r²`
//! (Gauss–Newton, with Tukey's weights, because parts may break the symmetry). Starts are the axis nearest to
//! all normals (a linear line complex), principal axes, and the maps of random pairs. The mean of the cloud
//! is not used: if an object is seen from one side, its mean is not on the axis.
//!
//! Normals of facets are noisy, and noise in `J` would look like information. Therefore the derivative with
//! the normal of the image is used as an instrument `Z`; its error is independent of those of `r` and `J`. A
//! facet belongs to many pairs. With `r = J θ + Σ_f M_f ε_f` and independent errors `ε_f` of the facets, the
//! estimate `θ̂ = −N⁻¹ Zᵀ W r`, `N = Zᵀ W J`, has the covariance `N⁻¹ (Σ_f Zᵀ W M_f C_f M_fᵀ W Z) N⁻ᵀ` for
//! any weights.
//!
//! Not guaranteed: the best one of several symmetries of a kind.
//!
//! # References
//! Pottmann & Randrup, *Rotational and helical surface approximation for reverse engineering*, Computing 60
//! (1998), for the line complex.

use super::facets::{COEFFICIENTS, Facets};
use super::maps::{MAX_PARAMETERS, Symmetry};
use super::pairs::{Pair, pairs};
use super::starts::starts;
use nalgebra::{SMatrix, SVector};
use planish_core::DVec3;
use rayon::prelude::*;

/// Reach of pairs relative to the side of the facets: initial and final value. A wide reach tolerates poor
/// starts; a narrow one compares only overlapping facets.
const FIRST_REACH: f64 = 2.0;
const LAST_REACH: f64 = 0.9;
/// Number of Gauss–Newton steps for a start, and for the final refinement.
const START_STEPS: usize = 6;
const STEPS: usize = 16;
/// Number of facets used to refine starts.
const START_SOURCES: usize = 160;
/// Maximum deviation from symmetry beyond noise, relative to the size of the cloud. A larger value accepts
/// shapes that are only nearly symmetric, a smaller one rejects facets that are not quite quadrics (test
/// `proposed_symmetries_exist_and_a_freeform_surface_has_none`).
const MAX_DEPARTURE: f64 = 0.001;
/// Initial deviation, relative to the size.
const FIRST_DEPARTURE: f64 = 0.03;
/// Tukey's constant (95 % efficiency), and the number of σ within which a facet agrees.
const TUKEY: f64 = 4.685;
const AGREEMENT_SIGMAS: f64 = 3.5;
/// Minimum fraction of agreeing facets, in a one-sided test at 5 %. The remaining fifth may be attachments
/// and damage (tests `a_handle_does_not_belong_to_the_revolution` and
/// `proposed_symmetries_exist_and_a_freeform_surface_has_none`).
const MIN_AGREEMENT: f64 = 0.8;
const ONE_SIDED: f64 = 1.645;
/// Minimum number and fraction of compared facets.
const MIN_COMPARED: usize = 20;
const MIN_COMPARED_SHARE: f64 = 0.15;
/// Maximum σ of the position of a symmetry, relative to the size of the cloud.
const MAX_SHIFT_SIGMA: f64 = 0.02;
/// Maximum σ of the tilt of a plane in radians: 2.9°. Less certain planes do not predict unobserved parts.
const MAX_TILT_SIGMA: f64 = 0.05;
/// Factor from the median absolute value of a Gaussian to its σ.
const FROM_MEDIAN: f64 = 1.4826;
/// Orders of rotation to test.
const PROPOSED_ORDERS: [u32; 5] = [6, 5, 4, 3, 2];

/// Kind of symmetry to search for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SymmetryKind {
    /// Rotation about an axis.
    Rotation {
        /// Number of repetitions of the shape in a full turn; `None` for any angle.
        order: Option<u32>,
        /// Approximate direction of the axis, used only as a start.
        towards: Option<DVec3>,
    },
    /// Reflection in a plane.
    Mirror {
        /// Approximate direction of the normal, used only as a start.
        towards: Option<DVec3>,
    },
}

/// An estimated symmetry.
#[derive(Debug, Clone)]
pub struct FittedSymmetry {
    /// The symmetry.
    pub symmetry: Symmetry,
    /// Covariance of its shifts (unit of length squared) and tilts (radians squared): along the tangents of
    /// an axis, along the normal of a plane.
    pub covariance: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    /// Deviation of images from their partners beyond the noise of both, as a standard deviation.
    pub departure: f64,
    /// Number of facets with a partner; `agreeing` of them agree with it.
    pub compared: usize,
    /// See `compared`.
    pub agreeing: usize,
    /// For each facet, true if its images may be used as readings.
    pub is_symmetric: Vec<bool>,
    /// True if the cloud supports the symmetry: enough facets were compared, more than 80 % of them agree,
    /// and its position is determined.
    pub supported: bool,
}

impl FittedSymmetry {
    /// Strength of the evidence, for comparison of symmetries.
    fn evidence(&self) -> f64 {
        self.agreeing as f64 - MIN_AGREEMENT * self.compared as f64
    }

    /// Variance of the image of a point along a direction, due to the error of the symmetry.
    #[must_use]
    pub fn image_variance(&self, angle: Option<f64>, point: DVec3, along: DVec3) -> f64 {
        let map = angle.map_or(super::maps::Map::Reflect, super::maps::Map::turn);
        let derivatives = self.symmetry.derivatives(map, point);
        let row = SVector::<f64, MAX_PARAMETERS>::from_fn(|k, _| along.dot(derivatives[k]));
        (row.transpose() * self.covariance * row)[(0, 0)].max(0.0)
    }

    /// σ of its position along each determined direction, and of its direction in radians.
    #[must_use]
    pub fn sigmas(&self) -> (Vec<f64>, [f64; 2]) {
        let sigma = |k: usize| self.covariance[(k, k)].max(0.0).sqrt();
        let shifts = self.symmetry.parameters() - 2;
        ((0..shifts).map(sigma).collect(), [sigma(shifts), sigma(shifts + 1)])
    }
}

/// The best symmetry of a kind, supported or not; `None` if no facets have partners.
#[must_use]
pub fn fit_symmetry(facets: &Facets, kind: SymmetryKind) -> Option<FittedSymmetry> {
    let count = facets.all.len();
    let middle = 1.0 / count as f64 * facets.all.iter().fold(DVec3::ZERO, |s, f| s + f.point);
    let stride = count.div_ceil(START_SOURCES);
    // Before they are refined, starts cannot be compared: a wrong plane through the middle of a smooth body
    // maps more facets near others than a true plane of which one side was hardly seen.
    let followed: Vec<(f64, Symmetry)> = starts(facets, kind, middle)
        .into_par_iter()
        .map(|start| {
            let found = refine(facets, start, middle, START_STEPS, stride);
            let met = pairs(facets, &found, FIRST_REACH * facets.side, stride);
            (agreement(&met, MAX_DEPARTURE * facets.size), found)
        })
        .collect();
    let (_, best) = followed.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    let best = refine(facets, best, middle, STEPS, 1);
    evaluate(facets, best)
}

/// The supported symmetry, if any: revolution has priority, then the one with the most evidence.
#[must_use]
pub fn propose_symmetry(facets: &Facets) -> Option<FittedSymmetry> {
    let rotation = |order| SymmetryKind::Rotation { order, towards: None };
    let supported = |kind| fit_symmetry(facets, kind).filter(|found| found.supported);
    supported(rotation(None)).or_else(|| {
        let mirror = supported(SymmetryKind::Mirror { towards: None });
        let turns = PROPOSED_ORDERS.map(|order| supported(rotation(Some(order))));
        // A rotation of order four is also one of order two, so the higher order comes first at equal
        // evidence.
        let all = turns.into_iter().chain([mirror]).flatten();
        all.fold(None, |best: Option<FittedSymmetry>, next| match best {
            Some(best) if best.evidence() >= next.evidence() => Some(best),
            _ => Some(next),
        })
    })
}

/// Weighted number of agreeing pairs: closer pairs count more.
fn agreement(found: &[Pair], within: f64) -> f64 {
    let (mut score, mut last, mut best) = (0.0, u32::MAX, 0.0_f64);
    for pair in found {
        if pair.from != last {
            score += best;
            (last, best) = (pair.from, 0.0);
        }
        best = best.max(1.0 - (pair.residual / within).powi(2));
    }
    score + best
}

/// Gauss–Newton from a start.
fn refine(facets: &Facets, start: Symmetry, middle: DVec3, steps: usize, stride: usize) -> Symmetry {
    let mut symmetry = start.near(middle);
    for step in 0..steps {
        // Reach and expected deviation shrink during the first 60 % of the steps; the rest converges with the
        // final values.
        let share = (step as f64 / (steps as f64 * 0.6)).min(1.0);
        let reach = facets.side * (FIRST_REACH + share * (LAST_REACH - FIRST_REACH));
        let found = pairs(facets, &symmetry, reach, stride);
        let limit = FIRST_DEPARTURE * facets.size * (0.02_f64).powf(share);
        let departure = departure_of(&found).clamp(0.0, limit.max(MAX_DEPARTURE * facets.size));
        let normal = Normal::new(&symmetry, &found, departure, facets.size);
        let Some(by) = normal.step() else { break };
        symmetry = symmetry.moved(by.as_slice()).near(middle);
    }
    symmetry
}

/// Robust standard deviation of the residuals beyond the noise of the facets.
fn departure_of(found: &[Pair]) -> f64 {
    if found.is_empty() {
        return 0.0;
    }
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let spread = FROM_MEDIAN * median(found.iter().map(|p| p.residual.abs()).collect());
    let noise = median(found.iter().map(|p| p.variance).collect());
    (spread * spread - noise).max(0.0).sqrt()
}

/// The normal equations of one step.
struct Normal {
    matrix: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    right: SVector<f64, MAX_PARAMETERS>,
    /// Weak prior: the position within the size, the direction within a radian.
    before: SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>,
    weights: Vec<f64>,
}

impl Normal {
    fn new(symmetry: &Symmetry, found: &[Pair], departure: f64, size: f64) -> Self {
        let shifts = symmetry.parameters() - 2;
        let before =
            SMatrix::from_diagonal(&SVector::from_fn(|k, _| if k < shifts { size.powi(-2) } else { 1.0 }));
        let mut made = Self {
            matrix: before,
            right: SVector::zeros(),
            before,
            weights: Vec::with_capacity(found.len()),
        };
        for pair in found {
            let variance = pair.variance + departure * departure;
            let far = pair.residual / (TUKEY * variance.sqrt());
            let w = pair.weight * (1.0 - far * far).max(0.0).powi(2) / variance;
            // The product with an instrument is not symmetric. Its symmetric part has the same expectation,
            // and Cholesky needs it.
            let product = pair.instrument * pair.by_symmetry.transpose() * (0.5 * w);
            made.matrix += product + product.transpose();
            made.right -= pair.instrument * (w * pair.residual);
            made.weights.push(w);
        }
        made
    }

    fn step(&self) -> Option<SVector<f64, MAX_PARAMETERS>> {
        Some(self.matrix.cholesky()?.solve(&self.right))
    }

    /// Covariance of the estimate from those of the facets, each with its contribution to `departure`.
    fn covariance(
        &self,
        facets: &Facets,
        found: &[Pair],
        departure: f64,
    ) -> Option<SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>> {
        let inverse = self.matrix.cholesky()?.inverse();
        let mut by_facet = vec![SMatrix::<f64, MAX_PARAMETERS, COEFFICIENTS>::zeros(); facets.all.len()];
        for (pair, &w) in found.iter().zip(&self.weights) {
            let gain = inverse * pair.instrument * w;
            by_facet[pair.from as usize] += gain * pair.by_from.transpose();
            by_facet[pair.to as usize] += gain * pair.by_to.transpose();
        }
        let mut covariance = inverse * self.before * inverse;
        for (facet, gain) in facets.all.iter().zip(&by_facet) {
            let mut own = *facet.covariance();
            // Half for each of the two facets of a pair.
            own[(0, 0)] += 0.5 * departure * departure;
            covariance += gain * own * gain.transpose();
        }
        Some(covariance)
    }
}

/// Tests a refined symmetry against the cloud.
fn evaluate(facets: &Facets, symmetry: Symmetry) -> Option<FittedSymmetry> {
    let found = pairs(facets, &symmetry, LAST_REACH * facets.side, 1);
    let departure = departure_of(&found);
    let allowed = departure.min(MAX_DEPARTURE * facets.size);
    let normal = Normal::new(&symmetry, &found, allowed, facets.size);
    let covariance = normal.covariance(facets, &found, allowed)?;
    // The residuals of each facet, as image and as partner, in σ of their mean.
    let mut means = vec![(0.0, 0.0, 0.0); facets.all.len()];
    for pair in &found {
        for facet in [pair.from, pair.to] {
            let (sum, squares, weight): &mut (f64, f64, f64) = &mut means[facet as usize];
            *sum += pair.weight * pair.residual.abs();
            *squares += pair.weight * (pair.variance + allowed * allowed);
            *weight += pair.weight;
        }
    }
    let agrees = |&(sum, squares, weight): &(f64, f64, f64)| {
        sum / weight <= AGREEMENT_SIGMAS * (squares / weight).sqrt()
    };
    let met = |m: &&(f64, f64, f64)| m.2 > 0.0;
    let compared = means.iter().filter(met).count();
    let agreeing = means.iter().filter(met).filter(|m| agrees(m)).count();
    let ring = matches!(symmetry, Symmetry::Rotation { order: None, .. });
    // A finite symmetry may map a facet to an unobserved place, which is to be completed. On a ring, a facet
    // without a partner is an attachment such as a handle, and must not be copied.
    let is_symmetric = means.iter().map(|m| if m.2 > 0.0 { agrees(m) } else { !ring }).collect();
    let mut made = FittedSymmetry {
        symmetry,
        covariance,
        departure: departure + allowed * 0.5 / (compared.max(1) as f64).sqrt(),
        compared,
        agreeing,
        is_symmetric,
        supported: false,
    };
    let (shifts, tilts) = made.sigmas();
    let n = compared as f64;
    let enough = compared >= MIN_COMPARED && n >= MIN_COMPARED_SHARE * facets.all.len() as f64;
    let more_than_chance = made.evidence() > ONE_SIDED * (n * MIN_AGREEMENT * (1.0 - MIN_AGREEMENT)).sqrt();
    let placed = shifts.iter().all(|s| *s < MAX_SHIFT_SIGMA * facets.size);
    let mirror = matches!(symmetry, Symmetry::Mirror { .. });
    let turned = !mirror || tilts.iter().all(|t| *t < MAX_TILT_SIGMA);
    made.supported = enough && more_than_chance && placed && turned;
    Some(made)
}

#[cfg(test)]
mod acceptance;
#[cfg(test)]
mod tests;
