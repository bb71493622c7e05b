//! Which kind of contour: several hypotheses and the one of the least BIC, the simplest of those that are as
//! good.

use super::fit::{ContourFit, ContourFitOptions, RoughFit, finish, fit, polish, reading_count, rough};
use super::kind::ContourKind;
use super::reading::ContourReading;
use super::start::chain_starts;
use planish_core::BoundingBox;
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Most sides of a polygon that is looked for without being asked.
const MAX_SIDES: usize = 8;

/// Kinds whose criterion is so far behind after a few steps are not fitted to the end.
const FINISH_WITHIN_BIC: f64 = 30.0;

/// Of kinds whose criteria are so near to the least one the one of the fewest unknowns is chosen: a smaller
/// difference is no evidence (Kass and Raftery 1995).
const NEGLIGIBLE_BIC: f64 = 2.0;

/// A kind with a side of which less than this was seen is not chosen where another has none.
const MIN_SIDE_COVERAGE: f64 = 0.4;

/// A kind that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// Which.
    pub kind: ContourKind,
    /// Its BIC; of a kind far behind, that of a rough fit.
    pub bic: f64,
}

/// The kind of the least BIC, or a simpler one that is as good, and the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The best.
    pub fit: ContourFit,
    /// By how much the BIC of the next kind is larger; `None` where only one was tried. Ten is very strong
    /// evidence; down to −2 where a simpler kind is as likely.
    pub bic_margin: Option<f64>,
    /// All others that could be fitted, best first.
    pub alternatives: Vec<Alternative>,
}

/// The kinds that `--kind auto` tries.
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
    kinds.extend([3, 5, 6, 8].map(ContourKind::RegularPolygon));
    kinds.extend((3..=MAX_SIDES).map(ContourKind::Polygon));
    kinds
}

/// Fits kinds, and chains of lines and arcs where `chains` asks for them, and chooses by the Bayesian
/// information criterion `−2 ln L + k ln n`. A reading that a kind cannot explain costs as much as one at the
/// gate.
///
/// All kinds are fitted roughly first, and those whose criterion is then less than 30 from the best are
/// fitted to the end. Of the others [`Alternative::bic`] is the rough one. What has a side that was hardly
/// seen explains readings with less than it says, as a triangle does an open angle: it is left out where
/// another kind has no such side.
///
/// # Errors
/// `Undetermined` when none could be fitted.
///
/// # References
/// Schwarz 1978, *Estimating the dimension of a model*; Kass and Raftery 1995, *Bayes factors* (what margins
/// mean).
pub fn choose(
    kinds: &[ContourKind],
    chains: bool,
    sightings: &[ContourReading],
    options: &ContourFitOptions,
) -> Result<Choice> {
    let mut tried: Vec<(ContourKind, ContourFitOptions)> =
        kinds.iter().map(|kind| (kind.clone(), options.clone())).collect();
    for (kind, mut start) in chains.then(|| chain_starts(sightings)).into_iter().flatten() {
        start.resize(kind.parameters() + options.motion.unknowns(), 0.0);
        let options = ContourFitOptions { start: Some(start), ..options.clone() };
        tried.push((kind, options));
    }
    if tried.is_empty() {
        return Err(Error::undetermined(
            "the readings suggest no chain of lines and arcs: they may be of a line, or of a polygon",
        ));
    }
    let unknowns = |kind: &ContourKind| kind.parameters() + options.motion.unknowns();
    if let Some((simplest, _)) = tried.iter().min_by_key(|(kind, _)| unknowns(kind))
        && tried.len() > 1
        && sightings.len() < unknowns(simplest)
    {
        return Err(Error::undetermined(format!(
            "{} cannot determine any of these kinds: the simplest, a {simplest}, needs at least {}",
            reading_count(sightings.len()),
            unknowns(simplest)
        )));
    }
    refuse_one_place(sightings)?;
    if let [(kind, options)] = &tried[..] {
        let fit = fit(kind, sightings, options)?;
        return Ok(Choice { fit, bic_margin: None, alternatives: Vec::new() });
    }
    let begun: Vec<Result<RoughFit>> = tried.par_iter().map(|(kind, o)| rough(kind, sightings, o)).collect();
    let mut last = None;
    let mut order: Vec<(&ContourKind, RoughFit)> = Vec::new();
    for ((kind, _), one) in tried.iter().zip(begun) {
        match one {
            Ok(one) => order.push((kind, one)),
            Err(e) => last = Some(e),
        }
    }
    order.sort_by(|a, b| a.1.bic.total_cmp(&b.1.bic));
    let finish_one = |(kind, rough): &(&ContourKind, RoughFit)| {
        let options = ContourFitOptions { start: Some(rough.state.clone()), ..options.clone() };
        finish(kind, sightings, &options)
    };
    let mut found: Vec<ContourFit> = Vec::new();
    let mut done = 0;
    // Those near the best, as far as is known: a rough fit may promise more than is kept, or come to nothing.
    while done < order.len() {
        let best = (found.iter().map(ContourFit::bic)).fold(f64::INFINITY, f64::min);
        let limit = if found.is_empty() { order[done].1.bic } else { best } + FINISH_WITHIN_BIC;
        let near = order.partition_point(|o| o.1.bic <= limit);
        if near <= done {
            break;
        }
        let finished: Vec<Result<ContourFit>> = order[done..near].par_iter().map(finish_one).collect();
        done = near;
        for one in finished {
            match one {
                Ok(one) => found.push(one),
                Err(e) => last = Some(e),
            }
        }
    }
    let rest = &order[done..];
    if found.iter().any(|one| one.min_side_coverage >= MIN_SIDE_COVERAGE) {
        found.retain(|one| one.min_side_coverage >= MIN_SIDE_COVERAGE);
    }
    let least = found.iter().map(ContourFit::bic).fold(f64::INFINITY, f64::min);
    let simplest = (0..found.len()).filter(|&k| found[k].bic() < least + NEGLIGIBLE_BIC).min_by(|&a, &b| {
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
        rest.iter().map(|(kind, rough)| Alternative { bic: rough.bic.max(least), kind: (*kind).clone() }),
    );
    alternatives.sort_by(|a, b| a.bic.total_cmp(&b.bic));
    Ok(Choice {
        bic_margin: alternatives.first().map(|a| a.bic - chosen.bic()),
        fit: polish(chosen, sightings, options)?,
        alternatives,
    })
}

/// Many kinds were tried: the one that failed last is nobody's concern.
fn none_fits(last: Option<Error>) -> Error {
    let text =
        "no kind of contour fits the readings: they may see too little of one, or be of something else";
    match last {
        Some(last) => Error::undetermined(text).with_source(last),
        None => Error::undetermined(text),
    }
}

/// Readings that lie no farther apart than their noise are of a spot.
fn refuse_one_place(sightings: &[ContourReading]) -> Result<()> {
    let mut bounds = BoundingBox::EMPTY;
    let mut variance = 0.0;
    for sighting in sightings {
        bounds.include(sighting.point());
        let [xx, _, yy] = sighting.covariance();
        variance += 0.5 * (xx + yy);
    }
    let sigma = (variance / sightings.len().max(1) as f64).sqrt();
    let [width, height] = bounds.extent();
    let extent = width.hypot(height);
    if sightings.len() > 1 && extent <= sigma {
        return Err(Error::undetermined(format!(
            "all {} readings lie nearer together than their σ: they show no outline",
            sightings.len()
        )));
    }
    Ok(())
}
