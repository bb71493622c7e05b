//! A shape fitted to rays, by the batch or a filter, and the choice among shapes.

use super::ray::{Ray, ShapeReading};
use super::shape::{Chart, PrimitiveKind};
use super::start::starts;
use crate::planar::{ContourFitOptions, GatedResiduals, Method};
use nalgebra::{DMatrix, DVector};
use planish_estimate::implicit::{ImplicitOptions, ImplicitUpdate, fit_implicit};
use planish_estimate::{Error, KalmanFilter, Loss, Result, Termination};

/// Readings a side from which a filter of several sides starts.
const SEED_PER_SIDE: usize = 24;
/// Spacing of the differences that carry a covariance to reported parameters, in σ.
const SPACING: f64 = 1e-3;

/// A shape with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct PrimitiveFit {
    /// The shape.
    pub shape: PrimitiveKind,
    /// Its parameters, in the order of [`PrimitiveKind::names`].
    pub parameters: Vec<f64>,
    /// Their covariance: of the rank of the shape's unknowns, which are fewer where directions are among
    /// them.
    pub covariance: DMatrix<f64>,
    /// Distance of each reading in standard deviations; NaN where it has none.
    pub distances: Vec<f64>,
    /// Whether each reading counted.
    pub used: Vec<bool>,
    /// `−½ Σ s²`, less what a gate costs for each reading beyond it; up to a constant.
    pub log_likelihood: f64,
    /// `Σ s²` over the readings that counted.
    pub squares: f64,
    /// How it ended.
    pub termination: Termination,
}

impl PrimitiveFit {
    /// `−2 ln L + k ln n`.
    #[must_use]
    pub fn bic(&self) -> f64 {
        self.shape.unknowns() as f64 * (self.distances.len().max(2) as f64).ln() - 2.0 * self.log_likelihood
    }

    /// Mean squared distance over its degrees of freedom; one is expected.
    #[must_use]
    pub fn reduced_chi_square(&self) -> f64 {
        let count = self.used.iter().filter(|used| **used).count() as f64;
        self.squares / (count - self.shape.unknowns() as f64).max(1.0)
    }
}

/// Fits a shape to rays, their poses in their noise: from each start a robust batch (Tukey), then on what
/// passes the gate the batch proper, or a filter after readings enough. Form, motion and start of the options
/// are those of contours, and not used.
///
/// # Errors
/// `Undetermined` when the readings do not determine the parameters, or when no start leads anywhere.
pub fn fit(shape: PrimitiveKind, rays: &[Ray], options: &ContourFitOptions) -> Result<PrimitiveFit> {
    if rays.len() < shape.unknowns() {
        return Err(Error::undetermined(format!(
            "{} readings cannot determine the {} unknowns of a {shape}: give more readings",
            rays.len(),
            shape.unknowns()
        )));
    }
    let points: Vec<[f64; 3]> = rays.iter().map(Ray::point).collect();
    let mut best: Option<PrimitiveFit> = None;
    for (chart, start) in starts(shape, &points) {
        let Ok(found) = fit_from(shape, &chart, rays, &start, options) else {
            continue;
        };
        if best.as_ref().is_none_or(|b| found.log_likelihood > b.log_likelihood) {
            best = Some(found);
        }
    }
    best.ok_or_else(|| {
        Error::undetermined(format!(
            "the readings do not determine a {shape}: they may see too little of it, or be of something else"
        ))
    })
}

/// The shape of the least BIC, and the BIC of the others that could be fitted, best first.
///
/// # Errors
/// `Undetermined` when none could be fitted.
pub fn choose(
    shapes: &[PrimitiveKind],
    rays: &[Ray],
    options: &ContourFitOptions,
) -> Result<(PrimitiveFit, Vec<(PrimitiveKind, f64)>)> {
    let mut found = Vec::new();
    let mut last = None;
    for &shape in shapes {
        match fit(shape, rays, options) {
            Ok(one) => found.push(one),
            Err(e) => last = Some(e),
        }
    }
    found.sort_by(|a: &PrimitiveFit, b| a.bic().total_cmp(&b.bic()));
    let mut found = found.into_iter();
    let Some(best) = found.next() else {
        return Err(last.unwrap_or_else(|| Error::undetermined("no shape was tried")));
    };
    Ok((best, found.map(|one| (one.shape, one.bic())).collect()))
}

fn readings<'a>(
    shape: PrimitiveKind,
    chart: &'a Chart,
    rays: impl Iterator<Item = &'a Ray>,
) -> Vec<ShapeReading<'a>> {
    rays.map(|ray| ShapeReading { shape, chart, ray }).collect()
}

fn fit_from(
    shape: PrimitiveKind,
    chart: &Chart,
    rays: &[Ray],
    start: &[f64],
    options: &ContourFitOptions,
) -> Result<PrimitiveFit> {
    let all = readings(shape, chart, rays.iter());
    let mut at = DVector::from_column_slice(start);
    let settings = ImplicitOptions { correct_bias: false, ..ImplicitOptions::default() };
    for threshold in [20.0, 6.0] {
        let robust = ImplicitOptions {
            loss: Loss::Tukey { threshold },
            max_iterations: 30,
            step_tolerance: 1e-2,
            ..settings
        };
        at = fit_implicit(&all, None, &at, &robust)?.state;
    }
    let look = ImplicitOptions { max_iterations: 0, ..settings };
    let near =
        GatedResiduals::from_distances(&fit_implicit(&all, None, &at, &look)?.distances, options.gate).used;
    let kept = readings(shape, chart, rays.iter().zip(&near).filter(|(_, u)| **u).map(|(ray, _)| ray));
    if kept.len() < shape.unknowns() {
        return Err(Error::undetermined("too few readings lie near the shape"));
    }
    let last = ImplicitOptions {
        correct_bias: options.correct_bias,
        margin: options.corner_margin,
        ..ImplicitOptions::default()
    };
    let undetermined = || Error::undetermined("the readings leave a parameter of the shape free");
    let (state, covariance, termination) = if matches!(options.method, Method::Batch | Method::Combined) {
        let found = fit_implicit(&kept, None, &at, &last)?;
        (found.state, found.covariance.ok_or_else(undetermined)?, found.termination)
    } else {
        // Readings enough on every side: a filter decides once which side a reading is of, and does not find
        // back from an edge that was taken to be elsewhere.
        let wanted = ((4 * shape.unknowns()).max(12))
            .max(SEED_PER_SIDE * shape.pieces().saturating_sub(1))
            .min(kept.len());
        let stride = (kept.len() / wanted).max(1);
        let (seed, rest): (Vec<_>, Vec<_>) = kept.into_iter().enumerate().partition(|(i, _)| i % stride == 0);
        let seed: Vec<ShapeReading<'_>> = seed.into_iter().map(|(_, reading)| reading).collect();
        let first = fit_implicit(&seed, None, &at, &last)?;
        let mut filter = KalmanFilter::new(first.state, first.covariance.ok_or_else(undetermined)?)?;
        let mut update = match options.method {
            Method::Extended => ImplicitUpdate::extended(),
            Method::Iterated => ImplicitUpdate::iterated(),
            _ => ImplicitUpdate::noise_updated(),
        };
        update.gate = options.gate;
        update.margin = options.corner_margin;
        update.correct_bias &= options.correct_bias;
        for (_, reading) in &rest {
            // An equation without a value at the prediction says nothing: the reading is left out.
            let _ = filter.update_implicit(reading, &update);
        }
        (filter.mean().clone(), filter.covariance().clone(), Termination::Converged)
    };
    if !shape.is_valid(state.as_slice()) {
        return Err(Error::undetermined("a size is not positive"));
    }
    if shape == PrimitiveKind::Box && sides_are_one(rays, state.as_slice()) {
        return Err(Error::undetermined("the box is so thin that noise does not tell its two sides apart"));
    }
    let distances = fit_implicit(&all, None, &state, &look)?.distances;
    let GatedResiduals { used, squares, log_likelihood } =
        GatedResiduals::from_distances(&distances, options.gate);
    Ok(PrimitiveFit {
        shape,
        parameters: chart.reported(shape, state.as_slice()),
        covariance: reported_covariance(shape, chart, &state, &covariance),
        log_likelihood,
        distances,
        used,
        squares,
        termination,
    })
}

/// Whether a size of a box is less than four σ of a reading: two sides so near would explain noise, each what
/// is nearer to it.
fn sides_are_one(rays: &[Ray], x: &[f64]) -> bool {
    let variance = rays.iter().map(|ray| ray.covariance().trace() / 3.0).sum::<f64>() / rays.len() as f64;
    x[6..9].iter().any(|size| size * size < 16.0 * variance)
}

fn reported_covariance(
    shape: PrimitiveKind,
    chart: &Chart,
    state: &DVector<f64>,
    covariance: &DMatrix<f64>,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..state.len())
        .map(|k| {
            let step = SPACING * covariance[(k, k)].sqrt();
            let moved = |sign: f64| {
                let mut x = state.clone();
                x[k] += sign * step;
                DVector::from_vec(chart.reported(shape, x.as_slice()))
            };
            (moved(1.0) - moved(-1.0)) / (2.0 * step)
        })
        .collect();
    let jacobian = DMatrix::from_columns(&columns);
    &jacobian * covariance * jacobian.transpose()
}
