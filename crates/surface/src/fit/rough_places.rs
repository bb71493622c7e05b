//! Places where the posterior variance is no measure of the error: rough ones, and folds.
//!
//! Rough places are edges, corners and small features between readings.
//! The prior has one weight for the whole surface, so that the bending energy of all of it has the size that
//! the prior expects. Energy that is concentrated in few leaves shows that the prior smooths too much there.
//! Residuals do not, because the rounding of an edge is finer than the spacing of the readings.
//!
//! The posterior variance `v` contains the mean square of what the prior smooths away, which grows with the
//! energy of the place. Where the energy density is `F` times that of the surface, the mean square error is
//! at most `F v`, and the excess `(F − 1) v` is returned for places with a large `F`. At the edges of a box
//! with readings 0.46 mm apart, `F` is 4 to 7, and `√(F v)` is 0.08 mm of an error of 0.09 mm.
//!
//! # References
//! Nychka, *Bayesian confidence intervals for smoothing splines*, 1988 (squared bias and variance in the
//! posterior variance).

use super::leaves::{leaf_areas, neighbourhood};
use crate::model::Posterior;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_spline::{Surface, leaf_weights};
use rayon::prelude::*;

/// Energy density over that of the surface from which a place counts as rough. On balls with waves, 1 % of
/// the leaves have more than 2.5, and none 4.
const MIN_ROUGHNESS: f64 = 3.0;

/// Share of the variance of the vertices' motion that is along the normal of the surface, below which a place
/// is a fold. It is the square of a cosine: of 60°.
const MIN_ALONG_NORMAL: f64 = 0.25;
/// Places of a leaf where folds are looked for.
const FOLD_PLACES: [[f64; 2]; 5] = [[0.1, 0.1], [0.9, 0.1], [0.5, 0.5], [0.1, 0.9], [0.9, 0.9]];

/// For each leaf, the variance along the normal that the posterior variance lacks; 0 where it lacks none.
///
/// # Errors
/// As for [`Posterior::leaf`].
pub(super) fn lacking_variances(posterior: &Posterior<'_>) -> Result<Vec<f64>> {
    let (rough, folded) = (rough_variances(posterior)?, fold_variances(posterior)?);
    Ok(rough.into_iter().zip(folded).map(|(rough, folded)| rough.max(folded)).collect())
}

/// Variances of folds. Vertices move along the normal of the surface near them; in a fold these motions slide
/// the surface along itself, and their variance along the normal of the place vanishes. That of the whole
/// motion takes its place.
fn fold_variances(posterior: &Posterior<'_>) -> Result<Vec<f64>> {
    let surface = posterior.surface();
    (0..surface.space().leaves().len())
        .into_par_iter()
        .with_min_len(64)
        .map(|leaf| {
            let covariance = posterior.leaf(leaf)?;
            let lacking = FOLD_PLACES.map(|[s, t]| {
                let Some(normal) = surface.leaf_jet(leaf, s, t).normal() else { return 0.0 };
                let weights = leaf_weights(s, t);
                let along = covariance.variance_along(&weights, normal);
                let of_motion: f64 =
                    DVec3::AXES.iter().map(|axis| covariance.variance_along(&weights, *axis)).sum();
                if along < MIN_ALONG_NORMAL * of_motion { of_motion - along } else { 0.0 }
            });
            Ok(lacking.into_iter().fold(0.0, f64::max))
        })
        .collect()
}

/// For each leaf, the variance that its posterior variance lacks because its place is far rougher than the
/// surface; 0 where it is not.
///
/// # Errors
/// As for [`Posterior::leaf`].
fn rough_variances(posterior: &Posterior<'_>) -> Result<Vec<f64>> {
    let surface = posterior.surface();
    let areas = leaf_areas(surface);
    let density: Vec<f64> =
        (0..areas.len()).into_par_iter().with_min_len(64).map(|leaf| energy_density(surface, leaf)).collect();
    let mean_of = |leaves: &mut dyn Iterator<Item = usize>| {
        let (energy, area) =
            leaves.fold((0.0, 0.0), |(energy, area), k| (energy + areas[k] * density[k], area + areas[k]));
        if area > 0.0 { energy / area } else { 0.0 }
    };
    let of_surface = mean_of(&mut (0..areas.len()));
    (0..areas.len())
        .map(|leaf| {
            let own = mean_of(&mut neighbourhood(surface.space(), leaf).into_iter());
            if own <= MIN_ROUGHNESS * of_surface {
                return Ok(0.0);
            }
            let normal = surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap_or_default();
            let variance = posterior.leaf(leaf)?.variance_along(&leaf_weights(0.5, 0.5), normal);
            Ok((own / of_surface - 1.0) * variance.max(0.0))
        })
        .collect()
}

/// Mean of `κ1² + κ2²` at four places of a leaf.
pub(super) fn energy_density(surface: &Surface, leaf: usize) -> f64 {
    let at = |s: f64, t: f64| {
        surface
            .leaf_jet(leaf, s, t)
            .curvature()
            .map_or(0.0, |c| c.principal[0].powi(2) + c.principal[1].powi(2))
    };
    0.25 * (at(0.25, 0.25) + at(0.75, 0.25) + at(0.25, 0.75) + at(0.75, 0.75))
}
