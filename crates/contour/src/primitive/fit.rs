//! Fit of a shape to rays by a batch or a filter, and choice among shapes.

use super::ray::{Ray, ShapeReading};
use super::shape::{Chart, PrimitiveKind};
use super::start::starts;
use crate::planar::{ContourFitOptions, GatedResiduals, Method};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::implicit::{ImplicitOptions, ImplicitUpdate, fit_implicit};
use planish_estimate::{Error, KalmanFilter, Loss, Result, Termination};

/// Readings per further side in the batch that initialises a filter.
///
/// A filter assigns each reading to a side once and does not recover from a wrong edge; more readings in the
/// seed leave fewer to the filter.
const SEED_PER_SIDE: usize = 24;
/// Spacing in σ of the differences that propagate a covariance to the reported parameters.
///
/// Small enough for the change of parameters to be linear, and large compared with rounding.
const SPACING: f64 = 1e-3;

/// A fitted shape with its covariance.
#[derive(Debug, Clone, PartialEq)]
pub struct PrimitiveFit {
    /// Kind of the shape.
    pub shape: PrimitiveKind,
    /// Parameters in the order of [`PrimitiveKind::names`].
    pub parameters: Vec<f64>,
    /// Covariance of `parameters`. It is singular if they contain directions, because a unit vector has three
    /// components but two degrees of freedom.
    pub covariance: DMatrix<f64>,
    /// Distance of each reading from the shape in σ; NaN for a reading without a value.
    pub distances: Vec<f64>,
    /// For each reading, true if it was used and false if it was rejected.
    pub used: Vec<bool>,
    /// `−½ Σ s²` over the used readings, minus half the squared gate for each rejected one.
    pub log_likelihood: f64,
    /// `Σ s²` over the used readings.
    pub squares: f64,
    /// How the iteration ended.
    pub termination: Termination,
}

impl PrimitiveFit {
    /// Bayesian information criterion `−2 ln L + k ln n`.
    #[must_use]
    pub fn bic(&self) -> f64 {
        self.shape.unknowns() as f64 * (self.distances.len().max(2) as f64).ln() - 2.0 * self.log_likelihood
    }

    /// χ² of the used readings per degree of freedom; 1 is expected.
    #[must_use]
    pub fn reduced_chi_square(&self) -> f64 {
        let count = self.used.iter().filter(|used| **used).count() as f64;
        self.squares / (count - self.shape.unknowns() as f64).max(1.0)
    }
}

/// Fits a shape to rays. Errors of poses are part of the noise of each ray.
///
/// From each start, a robust batch (Tukey's loss) precedes the gate. A batch of the accepted readings
/// follows, or a filter initialised by a batch of some of them. The options `form`, `motion` and `start` are
/// ignored.
///
/// # Errors
/// `Undetermined` if the readings do not determine the parameters, or if the fit fails from every start.
pub fn fit(shape: PrimitiveKind, rays: &[Ray], options: &ContourFitOptions) -> Result<PrimitiveFit> {
    if rays.len() < shape.unknowns() {
        return Err(Error::undetermined(format!(
            "{} readings cannot determine the {} unknowns of a {shape}: provide more readings",
            rays.len(),
            shape.unknowns()
        )));
    }
    let points: Vec<DVec3> = rays.iter().map(Ray::point).collect();
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
            "the readings do not determine a {shape}: they may cover too little of it, or show another \
             shape"
        ))
    })
}

/// The fit of the shape with the smallest BIC, and the BIC of the other shapes, best first.
///
/// # Errors
/// `Undetermined` if no shape could be fitted.
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
    // Four kinds only: all are fitted completely, unlike contours.
    found.sort_by(|a: &PrimitiveFit, b| a.bic().total_cmp(&b.bic()));
    let mut found = found.into_iter();
    let Some(best) = found.next() else {
        return Err(last.unwrap_or_else(|| Error::undetermined("no shape was tried")));
    };
    Ok((best, found.map(|one| (one.shape, one.bic())).collect()))
}

/// One equation per ray.
fn readings<'a>(
    shape: PrimitiveKind,
    chart: &'a Chart,
    rays: impl Iterator<Item = &'a Ray>,
) -> Vec<ShapeReading<'a>> {
    rays.map(|ray| ShapeReading { shape, chart, ray }).collect()
}

/// Fits from one start.
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
    // Stage 1: robust batches, first with a wide threshold, because a rough start may be many σ from half of
    // the readings.
    for threshold in [20.0, 6.0] {
        let robust = ImplicitOptions {
            loss: Loss::Tukey { threshold },
            max_iterations: 30,
            step_tolerance: 1e-2,
            ..settings
        };
        at = fit_implicit(&all, None, &at, &robust)?.state;
    }
    // Stage 2: the gate. Zero iterations evaluate the distances only.
    let evaluate_only = ImplicitOptions { max_iterations: 0, ..settings };
    let near = GatedResiduals::from_distances(
        &fit_implicit(&all, None, &at, &evaluate_only)?.distances,
        options.gate,
    )
    .used;
    let kept = readings(shape, chart, rays.iter().zip(&near).filter(|(_, u)| **u).map(|(ray, _)| ray));
    if kept.len() < shape.unknowns() {
        return Err(Error::undetermined("too few readings lie near the shape"));
    }
    // Stage 3: the estimate from the accepted readings.
    let last = ImplicitOptions {
        correct_bias: options.correct_bias,
        margin: options.corner_margin,
        ..ImplicitOptions::default()
    };
    let undetermined = || Error::undetermined("the readings leave a parameter of the shape undetermined");
    let (state, covariance, termination) = if matches!(options.method, Method::Batch | Method::Combined) {
        let found = fit_implicit(&kept, None, &at, &last)?;
        (found.state, found.covariance.ok_or_else(undetermined)?, found.termination)
    } else {
        // The seed needs several readings on every side (see [`SEED_PER_SIDE`]).
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
            // An error means that the equation has no value at the prediction; the reading is skipped.
            let _ = filter.update_implicit(reading, &update);
        }
        (filter.mean().clone(), filter.covariance().clone(), Termination::Converged)
    };
    if !shape.is_valid(state.as_slice()) {
        return Err(Error::undetermined("a size of the fitted shape is not positive"));
    }
    if shape == PrimitiveKind::Box && sides_are_indistinguishable(rays, state.as_slice()) {
        return Err(Error::undetermined(
            "the box is too thin: the noise hides which of two sides a reading belongs to",
        ));
    }
    let distances = fit_implicit(&all, None, &state, &evaluate_only)?.distances;
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

/// True if a size of a box is less than four σ of a reading. Two sides that close would share the noise of
/// one side between them.
fn sides_are_indistinguishable(rays: &[Ray], x: &[f64]) -> bool {
    let variance = rays.iter().map(|ray| ray.covariance().trace() / 3.0).sum::<f64>() / rays.len() as f64;
    x[6..9].iter().any(|size| size * size < 16.0 * variance)
}

/// Covariance of the reported parameters, `J Σ Jᵀ` with `J` by central differences.
fn reported_covariance(
    shape: PrimitiveKind,
    chart: &Chart,
    state: &DVector<f64>,
    covariance: &DMatrix<f64>,
) -> DMatrix<f64> {
    let columns: Vec<DVector<f64>> = (0..state.len())
        .map(|k| {
            // Steps in σ suit lengths and angles alike.
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
