//! Adjustment of noisy views of one object: contours with covariance are matched by χ² tests.
//!
//! Input: two or three [`NoisyView`]s in one frame, each a sketch with what holds in it. Output: a
//! [`ConsistentViews`]: which coordinates of different views are one, with their p-values, and the most
//! likely geometry in which they are, with the covariance that all views give it; and from it exact views,
//! and sizes in space with σ. Not guaranteed: that coordinates which the errors hide are one; the p-value and
//! the share of the range that would pass are reported.
//!
//! ```text
//! NoisyView ─┐
//! NoisyView ─┼─► one drawing ─► Aligned candidates ─► constrain_among ─► ConsistentViews ─► exact views
//! NoisyView ─┘                                                                     └─► dimensions ± σ
//! ```
//!
//! # References
//! Weiss-Cohen, Bondarenko and Halevi 2009, section 5 (there, coordinates are compared as numbers);
//! Bar-Shalom, Li and Kirubarajan 2001, *Estimation with applications to tracking and navigation*, section
//! 8.4 (track-to-track association).

mod levels;
mod measure;
mod outlines;

pub use levels::{AxisCoordinate, SpaceMatch};
pub use measure::{DimensionKind, SpaceDimension, SpaceVertex};

use crate::views::ViewKind;
use nalgebra::DMatrix;
use planish_contour::constraint::{
    Candidate, ConstrainOptions, Constrained, Constraint, ParametricDrawing, ProposalOutcome,
    chi_square_tail, constrain_among,
};
use planish_contour::sketch::{Sketch, block_diagonal};
use planish_estimate::{Error, Result};

/// The contours of one view of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct NoisyView {
    /// From where it is seen; the first coordinate of its contours runs right, the second up.
    pub kind: ViewKind,
    /// Its contours.
    pub sketch: Sketch,
    /// Constraints between the contours, in addition to [`Sketch::given`].
    pub constraints: Vec<Constraint>,
}

/// Options of [`match_views`].
#[derive(Debug, Clone, PartialEq)]
pub struct MatchOptions {
    /// Probability that any equal coordinates are treated as different (family-wise level).
    pub level: f64,
    /// Maximum share of the extent of the object that would pass the test. Beyond it, agreement is no
    /// evidence, and coordinates are not matched.
    pub max_chance: f64,
}

impl Default for MatchOptions {
    /// A level of 0.01, a chance of 0.2.
    fn default() -> Self {
        Self { level: planish_contour::constraint::DEFAULT_LEVEL, max_chance: 0.2 }
    }
}

/// Views adjusted to one consistent geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ConsistentViews {
    /// The views' kinds, in their order.
    pub kinds: Vec<ViewKind>,
    /// All views' drawings one after the other, consistent.
    pub drawing: ParametricDrawing,
    /// The covariance of its parameters.
    pub covariance: DMatrix<f64>,
    /// All constraints: first within each view, then between views.
    pub constraints: Vec<Constraint>,
    /// Tested pairs of coordinates.
    pub matches: Vec<SpaceMatch>,
    /// The coordinates that are known along each axis of space, ascending.
    pub levels: [Vec<AxisCoordinate>; 3],
    /// χ² of the matches alone.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// The probability of a χ² at least as large.
    pub p_value: f64,
    sketches: Vec<Sketch>,
    /// Where each view's parameters begin.
    first: Vec<usize>,
}

/// Share of the level below which the p-value of common ends shows that views are of different objects.
///
/// A larger share rejects more views with underestimated σ; a smaller one accepts views of other objects.
const FOREIGN: f64 = 0.01;

/// Matches the coordinates of noisy views and adjusts them to one geometry.
///
/// What holds in each view is imposed on all views together, block by block, and that views which share an
/// axis end together. Coordinates along an axis of space that then are not one already are candidates, in one
/// view or in two; [`constrain_among`] tests and imposes them, the strongest evidence first, with the range
/// of a coordinate the object's extent. What comes out is the maximum of the joint likelihood of all views
/// under everything imposed, with its covariance. Cost: that of `constrain_among` with the squares of the
/// numbers of coordinates.
///
/// # Errors
/// `Input` when there are fewer than two views or two of one kind, a view has no corner or circle to match,
/// or views that share an axis do not end together (which and by how much is named); as [`constrain_among`]
/// otherwise.
pub fn match_views(views: &[NoisyView], options: &MatchOptions) -> Result<ConsistentViews> {
    check(views)?;
    let mut drawing = ParametricDrawing::default();
    let mut offsets = Vec::new();
    let mut first = Vec::new();
    let mut given = Vec::new();
    for view in views {
        first.push(drawing.parameters());
        let offset = drawing.append(&view.sketch.drawing, Some(&format!("{} ", view.kind.name())));
        let own = view.sketch.given.iter().chain(&view.constraints);
        given.extend(own.map(|constraint| constraint.shifted(offset)));
        offsets.push(offset);
    }
    let blocks: Vec<DMatrix<f64>> = views.iter().map(|view| view.sketch.covariance.clone()).collect();
    let covariance = block_diagonal(&blocks);
    let base = ConstrainOptions {
        level: options.level,
        max_chance: options.max_chance,
        given: given.clone(),
        ..ConstrainOptions::default()
    };
    let alone = constrain_among(&drawing, &covariance, &[], &base)?;
    let places = levels::places(views, &offsets, &alone.drawing)?;
    // Views of one object end together: this is no finding, but it is tested.
    let ends = levels::ends(&places, &alone, views.len());
    given.extend(ends.iter().map(|end| end.constraint()));
    let base = ConstrainOptions { given, ..base };
    let ended = constrain_among(&drawing, &covariance, &[], &base)?;
    let p_value = chi_square_tail(
        (ended.chi_square - alone.chi_square).max(0.0),
        ended.degrees.saturating_sub(alone.degrees),
    );
    if p_value < FOREIGN * options.level {
        return Err(levels::not_one_thing(&ends, &alone, views));
    }
    let candidates: Vec<Candidate> = levels::candidates(&places, &ended);
    let found = constrain_among(&drawing, &covariance, &candidates, &base)?;
    let levels = levels::levels(&places, &found);
    let degrees = found.degrees - alone.degrees;
    let chi_square = (found.chi_square - alone.chi_square).max(0.0);
    Ok(ConsistentViews {
        kinds: views.iter().map(|view| view.kind).collect(),
        matches: matches(&ends, &alone, &found, &places),
        constraints: found.constraints.clone(),
        p_value: chi_square_tail(chi_square, degrees),
        drawing: found.drawing,
        covariance: found.covariance,
        levels,
        chi_square,
        degrees,
        sketches: views.iter().map(|view| view.sketch.clone()).collect(),
        first,
    })
}

fn check(views: &[NoisyView]) -> Result<()> {
    if !(2..=3).contains(&views.len()) {
        return Err(Error::input(format!(
            "needed two or three views, found {}: one view leaves the third dimension open",
            views.len()
        )));
    }
    for (i, view) in views.iter().enumerate() {
        if views[..i].iter().any(|other| other.kind == view.kind) {
            return Err(Error::input(format!(
                "there are two {} views: needed one of each",
                view.kind.name()
            )));
        }
    }
    Ok(())
}

/// The ends, then what became of the pairs that say something: all but those that were rejected.
fn matches(
    ends: &[levels::End],
    alone: &Constrained,
    found: &Constrained,
    places: &[levels::SpacePlace],
) -> Vec<SpaceMatch> {
    let said = found.proposals.iter().filter(|p| p.outcome != ProposalOutcome::Rejected);
    let tested = said.filter_map(|proposal| {
        let Constraint::Aligned { a, b } = proposal.constraint else {
            return None;
        };
        let known = |place| places.iter().find(|known| known.place == place);
        let (first, second) = (known(a)?, known(b)?);
        Some(SpaceMatch {
            axis: ["x", "y", "z"][first.axis],
            views: [first.view, second.view],
            text: proposal.text.clone(),
            chi_square: proposal.chi_square,
            p_value: proposal.p_value,
            chance: proposal.chance,
            outcome: match proposal.outcome {
                ProposalOutcome::Imposed => "imposed",
                ProposalOutcome::Implied => "implied",
                ProposalOutcome::Refused { .. } => "refused",
                ProposalOutcome::Unclear | ProposalOutcome::Rejected => "unclear",
            },
        })
    });
    ends.iter().map(|end| end.said(alone)).chain(tested).collect()
}

impl ConsistentViews {
    /// A view's drawing, consistent with the others, and its covariance.
    ///
    /// # Errors
    /// `Input` only where numbers are not finite, which [`match_views`] excludes.
    ///
    /// # Panics
    /// When there is no such view.
    pub fn view(&self, view: usize) -> Result<(ParametricDrawing, DMatrix<f64>)> {
        let from = self.first[view];
        let count = self.sketches[view].drawing.parameters();
        let values = self.drawing.values().rows(from, count).into_owned();
        let block = self.covariance.view((from, from), (count, count)).into_owned();
        Ok((self.sketches[view].drawing.with_values(&values)?, block))
    }
}

#[cfg(test)]
mod tests;
