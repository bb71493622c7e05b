//! Fits from a first shape that may have sharp edges.
//!
//! Input: observations and their [`FirstShape`]. Output: a [`ConvergedFit`] that follows the edges, if it
//! does not fold at them.
//!
//! Layouts differ in the corners at which a fit folds, so several are tried, all edges first. If all fold,
//! the one is taken that leaves least unresolved: folded, far from readings, or not within their noise. A
//! smooth surface follows few readings beside edges (decision 0129).
//!
//! Not guaranteed: that any of the layouts gives a fit without folds.

use super::FitOptions;
use super::creases::Sphere;
use super::first::{CreaseChoice, FirstShape, SMOOTHED_QUADS};
use super::folds::Folds;
use super::leaves::leaf_areas;
use super::over_quads::MOST_WITH_CREASES;
use super::refine::{ConvergedFit, refine_to_noise};
use super::surface_misfit::{SurfaceMisfit, UnresolvedPlace, surface_misfit};
use super::verdict::{MAX_FOLDED, MAX_UNRESOLVED};
use crate::observe::Observations;
use planish_core::{DVec3, Progress};
use planish_estimate::{ErrorKind, Result};

/// Fits with creases before one without.
const MAX_CREASED_FITS: usize = 3;
/// Fits in which all edges are kept, unless no layout is sound with them.
const FITS_WITH_ALL_EDGES: usize = 2;
/// Factors of the number of quads from one fit to the next, up to the most and then down from it.
const MORE_QUADS: f64 = 1.5;
const FEWER_QUADS: f64 = 0.85;
/// Share of the area that folds, share of the measured area that is unresolved, and misfit in σ of the
/// readings, up to which a fit needs no comparison with a smooth one.
const FEW_FOLDS: f64 = 0.0005;
const FEW_UNRESOLVED: f64 = 0.002;
const SMALL_MISFIT: f64 = 1.0;

/// Fits the first shape, with its sharp edges if that leaves less unresolved.
///
/// # Errors
/// As for [`FirstShape::surface`] and [`refine_to_noise`].
pub(super) fn fit_first_shape(
    observations: &mut Observations,
    options: &FitOptions,
    shape: &FirstShape,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let mut fit = best_fit(observations, options, shape, progress)?;
    if fit.surface.space().domain().is_some() && fit.shown.topology_margin.is_none() {
        fit.shown = shape.shown();
    }
    Ok(fit)
}

fn best_fit(
    observations: &mut Observations,
    options: &FitOptions,
    shape: &FirstShape,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    let mut choice = CreaseChoice::default();
    let mut best: Option<(Defects, ConvergedFit)> = None;
    for attempt in 1..=MAX_CREASED_FITS {
        let surface = shape.surface(Some(&mut choice), progress)?;
        // Each quad of the layout was divided into four.
        let divided = surface.space().domain().filter(|_| surface.space().has_creases());
        let quads = divided.map(|domain| domain.cells().len() / 4);
        let subset = observations.fitted();
        let fit = refine_to_noise(observations, surface, subset, options, progress);
        let Some(quads) = quads else {
            let fit = least_unresolved(best, fit, observations, options);
            return or_over_quads(fit, observations, options, shape, progress);
        };
        match fit {
            Ok(fit) => {
                let own = Defects::of(&fit, observations, options)?;
                if own.folded_places.is_empty() && own.are_few() {
                    return Ok(fit);
                }
                if attempt >= FITS_WITH_ALL_EDGES {
                    let side = (leaf_areas(&fit.surface).iter().sum::<f64>() / quads as f64).sqrt();
                    choice.smooth.extend(own.spheres(SMOOTHED_QUADS * side));
                }
                // Each fit moves the scans, so with poses only the last one belongs to its scans.
                if observations.scan_errors.is_empty()
                    && best.as_ref().is_none_or(|(least, _)| own.total() < least.total())
                {
                    best = Some((own, fit));
                }
            }
            Err(error) if error.kind() == ErrorKind::Undetermined => {}
            Err(error) => return Err(error),
        }
        choice.quads = other_numbers(quads);
    }
    if let Some((_, fit)) = best.take_if(|(own, _)| own.are_few()) {
        return Ok(fit);
    }
    let surface = shape.surface(None, progress)?;
    let subset = observations.fitted();
    let smooth = refine_to_noise(observations, surface, subset, options, progress);
    least_unresolved(best, smooth, observations, options)
}

/// What is wrong with a fit.
struct Defects {
    /// Share of the area that passes through itself, and where.
    folded: f64,
    folded_places: Vec<DVec3>,
    /// Where readings are farther away than noise and their spacing explain.
    unresolved: SurfaceMisfit,
    /// Root mean square of what the surface misses, in σ of the readings.
    misfit: f64,
}

impl Defects {
    fn of(fit: &ConvergedFit, observations: &Observations, options: &FitOptions) -> Result<Self> {
        let folds = Folds::of(&fit.surface, Some(&fit.feet))?;
        let readings = fit.readings(observations);
        let (missed, noise) = (0..fit.feet.len()).fold((0.0, 0.0), |(missed, noise), k| {
            let own = fit.noise.misfit_variance(&fit.feet[k]);
            (missed + own, noise + fit.noise.variance(readings, k) - own)
        });
        Ok(Self {
            folded: folds.area_fraction,
            folded_places: folds.points(&fit.surface),
            unresolved: surface_misfit(readings, options.gate, DVec3::ZERO)?,
            misfit: (missed / noise.max(f64::MIN_POSITIVE)).sqrt(),
        })
    }

    /// Up to 1, the fit is not refused.
    fn most(&self) -> f64 {
        (self.folded / MAX_FOLDED).max(self.unresolved.area_fraction / MAX_UNRESOLVED)
    }

    fn total(&self) -> f64 {
        self.folded / MAX_FOLDED + self.unresolved.area_fraction / MAX_UNRESOLVED + self.misfit
    }

    fn are_few(&self) -> bool {
        self.folded < FEW_FOLDS
            && self.unresolved.area_fraction < FEW_UNRESOLVED
            && self.misfit < SMALL_MISFIT
    }

    /// Spheres around all places: of one radius where the surface folds, of their size elsewhere.
    fn spheres(&self, radius: f64) -> Vec<Sphere> {
        let folded = self.folded_places.iter().map(|&center| Sphere { center, radius });
        let of_place = |place: &UnresolvedPlace| Sphere {
            center: place.centre.into(),
            radius: radius.max(0.5 * place.size),
        };
        folded.chain(self.unresolved.places.iter().map(of_place)).collect()
    }
}

/// The fit with creases, or the smooth one if it leaves less of the area unresolved.
fn least_unresolved(
    creased: Option<(Defects, ConvergedFit)>,
    smooth: Result<ConvergedFit>,
    observations: &Observations,
    options: &FitOptions,
) -> Result<ConvergedFit> {
    let Some((of_creased, creased)) = creased else { return smooth };
    match smooth {
        Ok(smooth) => {
            let of_smooth = Defects::of(&smooth, observations, options)?;
            let is_creased_better =
                of_creased.most() <= of_smooth.most().max(1.0) && of_creased.total() < of_smooth.total();
            Ok(if is_creased_better { creased } else { smooth })
        }
        Err(error) if error.kind() == ErrorKind::Undetermined => Ok(creased),
        Err(error) => Err(error),
    }
}

/// The fit, or one over quads if that of a base shape would be refused and the other leaves less unresolved.
///
/// A spring looks like a tube, and several rings like a ball.
fn or_over_quads(
    fit: Result<ConvergedFit>,
    observations: &mut Observations,
    options: &FitOptions,
    shape: &FirstShape,
    progress: &dyn Progress,
) -> Result<ConvergedFit> {
    // Each fit moves the scans, so with poses only the last one belongs to its scans.
    if !shape.may_lie_over_quads_instead() || !observations.scan_errors.is_empty() {
        return fit;
    }
    let of_base = match &fit {
        Ok(fit) => Defects::of(fit, observations, options)?.most(),
        Err(error) if error.kind() == ErrorKind::Undetermined => f64::INFINITY,
        Err(_) => return fit,
    };
    if of_base <= 1.0 {
        return fit;
    }
    let Some((surface, margin)) = shape.over_quads_instead(progress)? else { return fit };
    let subset = observations.fitted();
    match refine_to_noise(observations, surface, subset, options, progress) {
        Ok(mut other) if Defects::of(&other, observations, options)?.most() < of_base => {
            other.shown.topology_margin = Some(margin);
            Ok(other)
        }
        Err(error) if error.kind() != ErrorKind::Undetermined => Err(error),
        _ => fit,
    }
}

/// Numbers of quads of a layout that is to differ from one of `quads`.
fn other_numbers(quads: usize) -> std::ops::RangeInclusive<usize> {
    let scaled = |factor: f64| (factor * quads as f64) as usize;
    if scaled(MORE_QUADS) <= MOST_WITH_CREASES {
        scaled(MORE_QUADS)..=MOST_WITH_CREASES
    } else {
        scaled(FEWER_QUADS)..=scaled(FEWER_QUADS)
    }
}
