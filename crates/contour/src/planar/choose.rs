//! Choice of the kind of a contour by the Bayesian information criterion (BIC).
//!
//! In: candidate kinds and readings. Out: a [`Choice`] with the fit of the chosen kind and the BIC of the
//! others. Among kinds with practically equal BIC, the one with the fewest unknowns is chosen (decision
//! record 0053).

use super::fit::{ContourFit, RoughFit, finish, fit, polish, reading_count, rough};
use super::kind::ContourKind;
use super::options::ContourFitOptions;
use super::reading::ContourReading;
use super::start::chain_starts;
use planish_core::BoundingBox;
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Maximum number of sides of a polygon in the automatic choice.
///
/// Each further side adds a kind to fit; larger polygons can be requested by name.
const MAX_SIDES: usize = 8;

/// Kinds whose rough BIC exceeds the best by more than this are not fitted to convergence.
///
/// A rough fit can be wrong by more than a real difference of BIC, so the limit is three times what counts as
/// very strong evidence (10). A larger one costs time: the complete fits dominate it.
const FINISH_WITHIN_BIC: f64 = 30.0;

/// Differences of BIC up to this are no evidence (Kass and Raftery 1995): the simplest kind within it is
/// chosen.
const NEGLIGIBLE_BIC: f64 = 2.0;

/// Smallest observed fraction of every side for which a kind is preferred to kinds below it.
///
/// A triangle explains the readings of an open angle with a side that nothing supports. A higher value would
/// exclude sides that are half hidden.
const MIN_SIDE_COVERAGE: f64 = 0.4;

/// A kind that was considered but not chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// The kind.
    pub kind: ContourKind,
    /// Its BIC; an approximation from a rough fit if the kind is far behind the best.
    pub bic: f64,
}

/// The chosen kind with its fit, and the alternatives.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Fit of the chosen kind.
    pub fit: ContourFit,
    /// BIC of the best alternative minus that of the chosen kind; `None` if there is no alternative.
    ///
    /// A margin of 10 is very strong evidence. It can be as low as −2, if a simpler kind is about as likely.
    pub bic_margin: Option<f64>,
    /// All other kinds that could be fitted, best first.
    pub alternatives: Vec<Alternative>,
}

/// The kinds of an automatic choice: all except chains, with polygons of up to eight corners.
#[must_use]
pub fn auto_kinds() -> Vec<ContourKind> {
    let mut kinds = vec![
        ContourKind::Line,
        ContourKind::Circle,
        ContourKind::Ellipse,
        ContourKind::Rectangle,
        ContourKind::Slot,
        ContourKind::RoundedRectangle,
    ];
    // A regular polygon of four sides is a rectangle.
    kinds.extend([3, 5, 6, 8].map(ContourKind::RegularPolygon));
    kinds.extend((3..=MAX_SIDES).map(ContourKind::Polygon));
    kinds
}

/// Fits several kinds and chooses one by the Bayesian information criterion `−2 ln L + k ln n`.
///
/// With `chains`, chains of lines and arcs that the readings suggest are also tried. An outlier costs as much
/// as a reading at the gate.
///
/// All kinds get a rough fit first. Those within 30 of the best BIC are then fitted to convergence; for the
/// others, [`Alternative::bic`] is the rough value. A kind with a hardly observed side is excluded if another
/// kind has none: a triangle, for example, also explains the readings of an open angle.
///
/// # Errors
/// `Undetermined` if no kind could be fitted.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourFitOptions, ContourKind, auto_kinds, choose, points};
///
/// let rectangle = [0.0, 0.0, 40.0, 20.0, 0.3];
/// let simulated = points(&ContourKind::Rectangle, &rectangle, 300, 0.05, 7);
/// let choice = choose(&auto_kinds(), false, &simulated.noisy, &ContourFitOptions::default())?;
/// assert_eq!(choice.fit.kind, ContourKind::Rectangle);
/// assert!(choice.bic_margin.is_some_and(|margin| margin > 10.0));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Schwarz 1978, *Estimating the dimension of a model*; Kass and Raftery 1995, *Bayes factors*
/// (interpretation of margins).
pub fn choose(
    kinds: &[ContourKind],
    chains: bool,
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<Choice> {
    let mut tried: Vec<(ContourKind, ContourFitOptions)> =
        kinds.iter().map(|kind| (kind.clone(), options.clone())).collect();
    // A pattern of lines and arcs comes with its own start; other kinds derive their starts from the
    // readings.
    for (kind, mut start) in chains.then(|| chain_starts(readings)).into_iter().flatten() {
        start.resize(kind.parameters() + options.motion.unknowns(), 0.0);
        let options = ContourFitOptions { start: Some(start), ..options.clone() };
        tried.push((kind, options));
    }
    if tried.is_empty() {
        return Err(Error::undetermined(
            "the readings suggest no chain of lines and arcs; they may show a line or a polygon",
        ));
    }
    let unknowns = |kind: &ContourKind| kind.parameters() + options.motion.unknowns();
    // One message about all kinds is clearer than that of whichever kind fails last.
    if let Some((simplest, _)) = tried.iter().min_by_key(|(kind, _)| unknowns(kind))
        && tried.len() > 1
        && readings.len() < unknowns(simplest)
    {
        return Err(Error::undetermined(format!(
            "{} cannot determine any of these kinds: the simplest, a {simplest}, needs at least {}",
            reading_count(readings.len()),
            unknowns(simplest)
        )));
    }
    reject_coincident_readings(readings)?;
    if let [(kind, options)] = &tried[..] {
        let fit = fit(kind, readings, options)?;
        return Ok(Choice { fit, bic_margin: None, alternatives: Vec::new() });
    }
    // Stage 1: rough fits of all kinds, ranked.
    let begun: Vec<Result<RoughFit>> = tried.par_iter().map(|(kind, o)| rough(kind, readings, o)).collect();
    let mut last = None;
    let mut order: Vec<(&ContourKind, RoughFit)> = Vec::new();
    for ((kind, _), one) in tried.iter().zip(begun) {
        match one {
            Ok(one) => order.push((kind, one)),
            Err(e) => last = Some(e),
        }
    }
    order.sort_by(|a, b| a.1.bic.total_cmp(&b.1.bic));
    // Stage 2: complete fits of the kinds near the best.
    let Finished { mut found, done, error } = finish_near_best(&order, readings, options);
    last = error.or(last);
    // Stage 3: the simplest of the kinds with practically the best BIC.
    let rest = &order[done..];
    if found.iter().any(|one| one.min_side_coverage >= MIN_SIDE_COVERAGE) {
        found.retain(|one| one.min_side_coverage >= MIN_SIDE_COVERAGE);
    }
    let min_bic = found.iter().map(ContourFit::bic).fold(f64::INFINITY, f64::min);
    // Equal numbers of unknowns are decided by BIC.
    let simplest =
        (0..found.len()).filter(|&k| found[k].bic() < min_bic + NEGLIGIBLE_BIC).min_by(|&a, &b| {
            let unknowns = |k: usize| found[k].state.len();
            (unknowns(a).cmp(&unknowns(b))).then(found[a].bic().total_cmp(&found[b].bic()))
        });
    let Some(simplest) = simplest else {
        return Err(none_fits(last));
    };
    let chosen = found.swap_remove(simplest);
    let mut alternatives: Vec<Alternative> =
        found.into_iter().map(|one| Alternative { bic: one.bic(), kind: one.kind }).collect();
    alternatives.extend(
        // A rough BIC can be smaller than the best complete one, but an unfinished kind must not rank first.
        rest.iter().map(|(kind, rough)| Alternative { bic: rough.bic.max(min_bic), kind: (*kind).clone() }),
    );
    alternatives.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    Ok(Choice {
        bic_margin: alternatives.first().map(|a| a.bic - chosen.bic()),
        fit: polish(chosen, readings, options)?,
        alternatives,
    })
}

/// Complete fits of the kinds near the best.
struct Finished {
    found: Vec<ContourFit>,
    /// Number of ranked kinds that were fitted.
    done: usize,
    /// The last error, if a fit failed.
    error: Option<Error>,
}

/// Fits ranked kinds to convergence as long as they are within [`FINISH_WITHIN_BIC`] of the best.
fn finish_near_best(
    order: &[(&ContourKind, RoughFit)],
    readings: &[ContourReading],
    options: &ContourFitOptions,
) -> Finished {
    let mut error = None;
    // The rough state is a better start than those from the readings: only one fit is needed.
    let finish_one = |(kind, rough): &(&ContourKind, RoughFit)| {
        let options = ContourFitOptions { start: Some(rough.state.clone()), ..options.clone() };
        finish(kind, readings, &options)
    };
    let mut found: Vec<ContourFit> = Vec::new();
    let mut done = 0;
    // A rough fit may promise more than the complete one keeps, or the complete one may fail. The limit is
    // then recomputed and more kinds are fitted.
    while done < order.len() {
        let best = (found.iter().map(ContourFit::bic)).fold(f64::INFINITY, f64::min);
        let limit = if found.is_empty() { order[done].1.bic } else { best } + FINISH_WITHIN_BIC;
        let near = order.partition_point(|o| o.1.bic <= limit);
        if near <= done {
            break;
        }
        // Results keep the order of the kinds, whatever the number of threads.
        let finished: Vec<Result<ContourFit>> = order[done..near].par_iter().map(finish_one).collect();
        done = near;
        for one in finished {
            match one {
                Ok(one) => found.push(one),
                Err(e) => error = Some(e),
            }
        }
    }
    Finished { found, done, error }
}

/// Error if no kind could be fitted. The message concerns all kinds; that of the last one is only its source.
fn none_fits(last: Option<Error>) -> Error {
    let text = "no kind of contour fits the readings: they may cover too little of the contour, or show \
                another shape";
    match last {
        Some(last) => Error::undetermined(text).with_source(last),
        None => Error::undetermined(text),
    }
}

/// Rejects readings whose extent is not larger than their noise: every kind would fit them.
fn reject_coincident_readings(readings: &[ContourReading]) -> Result<()> {
    let mut bounds = BoundingBox::EMPTY;
    let mut variance = 0.0;
    for reading in readings {
        bounds.include(reading.point());
        let [xx, _, yy] = reading.covariance();
        variance += 0.5 * (xx + yy);
    }
    let sigma = (variance / readings.len().max(1) as f64).sqrt();
    let [width, height] = bounds.extent();
    let extent = width.hypot(height);
    if readings.len() > 1 && extent <= sigma {
        return Err(Error::undetermined(format!(
            "expected readings that are farther apart than their σ, found all {} closer together",
            readings.len()
        )));
    }
    Ok(())
}
