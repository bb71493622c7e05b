//! Which kind of contour: several hypotheses and the one of the least BIC.

use super::fit::{ContourFit, FitOptions, fit};
use super::kind::Kind;
use super::sighting::Sighting;
use super::start::chain_start;
use planish_estimate::{Error, Result};

/// Most sides of a polygon that is looked for without being asked.
const MOST_SIDES: usize = 8;

/// A kind that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Alternative {
    /// Which.
    pub kind: Kind,
    /// Its BIC.
    pub bic: f64,
}

/// The kind of the least BIC, and the others.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The best.
    pub fit: ContourFit,
    /// By how much the BIC of the next kind is larger; `None` where only one was tried. Ten is very strong evidence.
    pub bic_margin: Option<f64>,
    /// All others that could be fitted, best first.
    pub alternatives: Vec<Alternative>,
}

/// The kinds that `--kind auto` tries.
#[must_use]
pub fn auto_kinds() -> Vec<Kind> {
    let mut kinds = vec![
        Kind::Line,
        Kind::Circle,
        Kind::Ellipse,
        Kind::Rectangle,
        Kind::Slot,
        Kind::RoundedRectangle,
    ];
    kinds.extend([3, 5, 6, 8].map(Kind::RegularPolygon));
    kinds.extend((3..=MOST_SIDES).map(Kind::Polygon));
    kinds
}

/// Fits all kinds, and a chain of lines and arcs where `chains` asks for one, and chooses by the Bayesian information
/// criterion `−2 ln L + k ln n`. A reading that a kind cannot explain costs as much as one at the gate.
///
/// # Errors
/// `Undetermined` when none could be fitted.
///
/// # References
/// Schwarz 1978, *Estimating the dimension of a model*; Kass and Raftery 1995, *Bayes factors* (what margins mean).
pub fn choose(kinds: &[Kind], chains: bool, sightings: &[Sighting], options: &FitOptions) -> Result<Choice> {
    let mut found: Vec<ContourFit> = Vec::new();
    let mut last = None;
    for kind in kinds {
        match fit(kind, sightings, options) {
            Ok(one) => found.push(one),
            Err(e) => last = Some(e),
        }
    }
    if let Some((kind, start)) = chains.then(|| chain_start(sightings)).flatten() {
        let mut start = start;
        start.resize(kind.parameters() + options.motion.unknowns(), 0.0);
        let options = FitOptions {
            start: Some(start),
            ..options.clone()
        };
        match fit(&kind, sightings, &options) {
            Ok(one) => found.push(one),
            Err(e) => last = Some(e),
        }
    }
    found.sort_by(|a, b| a.bic().total_cmp(&b.bic()));
    let mut found = found.into_iter();
    let Some(best) = found.next() else {
        return Err(last.unwrap_or_else(|| Error::undetermined("no kind of contour was tried")));
    };
    let alternatives: Vec<Alternative> = found
        .map(|one| Alternative {
            bic: one.bic(),
            kind: one.kind,
        })
        .collect();
    Ok(Choice {
        bic_margin: alternatives.first().map(|a| a.bic - best.bic()),
        fit: best,
        alternatives,
    })
}
