//! Adjustment of noisy views of one object: contours with covariance are matched by χ² tests.
//!
//! Input: two or three [`NoisyView`]s in one frame, each a sketch with its constraints. Output:
//! [`ConsistentViews`]: the coordinates of different views that are equal, with p-values, and the most likely
//! geometry in which they are, with the joint covariance. From this follow exact views, and dimensions in
//! space with σ.
//!
//! Not guaranteed: coordinates that differ by less than their errors may be treated as equal. The p-value and
//! the share of the range that would pass the test are reported.
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
    /// Viewing direction. The first coordinate of the contours runs right, the second up.
    pub kind: ViewKind,
    /// Contours with their covariance.
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
    /// Viewing directions, in the order of the input.
    pub kinds: Vec<ViewKind>,
    /// The adjusted drawings of all views, one after the other.
    pub drawing: ParametricDrawing,
    /// Covariance of the parameters of `drawing`.
    pub covariance: DMatrix<f64>,
    /// All constraints: first within each view, then between views.
    pub constraints: Vec<Constraint>,
    /// Tested pairs of coordinates.
    pub matches: Vec<SpaceMatch>,
    /// Coordinates along each axis of space, ascending.
    pub levels: [Vec<AxisCoordinate>; 3],
    /// χ² of the matches, without that of the constraints within views.
    pub chi_square: f64,
    /// Degrees of freedom of `chi_square`.
    pub degrees: usize,
    /// Probability of a χ² at least as large.
    pub p_value: f64,
    sketches: Vec<Sketch>,
    /// Index of the first parameter of each view.
    first: Vec<usize>,
}

/// Share of the level below which the p-value of common ends shows that views are of different objects.
///
/// A larger share rejects more views with underestimated σ; a smaller one accepts views of other objects.
const DIFFERENT_OBJECTS: f64 = 0.01;

/// Matches the coordinates of noisy views and adjusts them to one geometry.
///
/// The constraints of each view are imposed on all views together. Views that share an axis must also have
/// the same ends along it. Pairs of coordinates along an axis that are not equal already are candidates,
/// within a view or between two. [`constrain_among`] tests and imposes them, strongest evidence first; the
/// range of a coordinate is the extent of the object. The result is the maximum of the joint likelihood of
/// all views under all imposed constraints, with its covariance. The cost is that of `constrain_among` with a
/// number of candidates that grows with the square of the number of coordinates.
///
/// ```
/// use planish_solid::noisy_views::{MatchOptions, match_views};
///
/// // At least two views are needed.
/// assert!(match_views(&[], &MatchOptions::default()).is_err());
/// ```
///
/// # Errors
/// `Input` if there are fewer than two views or two of one kind, if a view has no corner or circle to match,
/// or if views that share an axis have different ends (the message names them and their difference).
/// Otherwise as [`constrain_among`].
pub fn match_views(views: &[NoisyView], options: &MatchOptions) -> Result<ConsistentViews> {
    check(views)?;
    let mut drawing = ParametricDrawing::default();
    let mut offsets = Vec::new();
    let mut first = Vec::new();
    let mut given = Vec::new();
    for view in views {
        first.push(drawing.parameters());
        let offset = drawing.append(&view.sketch.drawing, Some(&format!("{} ", view.kind.name())));
        // Identifiers of points and circles are numbered within a view; in the common drawing they are
        // shifted.
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
    // Three adjustments: with the constraints of the views alone, with common ends, and with all matches. The
    // differences of their χ² test what each step added.
    let alone = constrain_among(&drawing, &covariance, &[], &base)?;
    let places = levels::places(views, &offsets, &alone.drawing)?;
    // Views of one object have common ends. This is an assumption and imposed without evidence, so it is
    // tested at a stricter level than a match.
    let ends = levels::ends(&places, &alone, views.len());
    given.extend(ends.iter().map(|end| end.constraint()));
    let base = ConstrainOptions { given, ..base };
    let ended = constrain_among(&drawing, &covariance, &[], &base)?;
    let p_value = chi_square_tail(
        (ended.chi_square - alone.chi_square).max(0.0),
        ended.degrees.saturating_sub(alone.degrees),
    );
    if p_value < DIFFERENT_OBJECTS * options.level {
        return Err(levels::different_objects(&ends, &alone, views));
    }
    let candidates: Vec<Candidate> = levels::candidates(&places, &ended);
    let found = constrain_among(&drawing, &covariance, &candidates, &base)?;
    let levels = levels::levels(&places, &found);
    // Without the share of the constraints within views, which says nothing about their agreement. Rounding
    // can make the difference slightly negative.
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

/// Rejects a wrong number of views, and two views of one kind.
fn check(views: &[NoisyView]) -> Result<()> {
    if !(2..=3).contains(&views.len()) {
        return Err(Error::input(format!(
            "expected two or three views, found {}: one view does not determine the third dimension",
            views.len()
        )));
    }
    for (i, view) in views.iter().enumerate() {
        if views[..i].iter().any(|other| other.kind == view.kind) {
            return Err(Error::input(format!(
                "expected one view of each kind, found two {} views",
                view.kind.name()
            )));
        }
    }
    Ok(())
}

/// The common ends, then all tested pairs except the rejected ones, which are nearly all pairs.
fn matches(
    ends: &[levels::End],
    alone: &Constrained,
    found: &Constrained,
    places: &[levels::SpacePlace],
) -> Vec<SpaceMatch> {
    let relevant = found.proposals.iter().filter(|p| p.outcome != ProposalOutcome::Rejected);
    let tested = relevant.filter_map(|proposal| {
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
    ends.iter().map(|end| end.tested_match(alone)).chain(tested).collect()
}

impl ConsistentViews {
    /// The adjusted drawing of one view, and its covariance.
    ///
    /// # Errors
    /// `Input` if values are not finite, which [`match_views`] excludes.
    ///
    /// # Panics
    /// If there is no such view.
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
