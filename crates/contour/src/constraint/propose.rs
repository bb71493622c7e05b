//! Relations proposed by tests on the estimated covariance, and imposed as far as they agree.
//!
//! Comes in: an estimate of a drawing's parameters with its covariance. Goes out: what happened to every
//! candidate, and the estimate with the accepted ones imposed. Not guaranteed: that what is accepted is
//! meant; `expected_by_chance` says how many would come up among parts that have nothing to do with each
//! other.

use super::candidates::{Candidate, candidates};
use super::conflicts::Linearised;
use super::drawing::ParametricDrawing;
use super::evidence::{Level, State, Test, is_linear, test};
use super::impose::{Imposed, Start, chi_square_tail, impose, impose_from, square_root};
use super::minimal::quick_xplain;
use super::relation::Constraint;
use nalgebra::DMatrix;
use planish_estimate::{Error, Result};
use serde::Serialize;

/// The probability with which relations that are true are lost, where none is asked for.
pub const DEFAULT_LEVEL: f64 = 0.001;

/// How to propose relations.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstrainOptions {
    /// The probability with which true relations fail: any at all the tests of single ones, which share it,
    /// and all together the joint one.
    pub level: f64,
    /// The largest share of its range in which a relation would be accepted: where it is larger, agreement
    /// means too little.
    pub max_chance: f64,
    /// How truly relations hold: angles in radians, lengths as shares of the drawing's extent. Zero for
    /// exactly.
    pub sigma: f64,
    /// Constraints imposed without a test: anchors, ends of arcs on their circles, known dimensions.
    pub given: Vec<Constraint>,
}

impl Default for ConstrainOptions {
    /// A level of [`DEFAULT_LEVEL`], a chance of 0.05, exact, nothing given.
    fn default() -> Self {
        Self { level: DEFAULT_LEVEL, max_chance: 0.05, sigma: 0.0, given: Vec::new() }
    }
}

/// What became of a candidate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "outcome", rename_all = "snake_case")]
pub enum ProposalOutcome {
    /// It agrees with the estimate and with all accepted before it, and was imposed.
    Imposed,
    /// It follows from what was imposed before, or from the estimate itself.
    Implied,
    /// The estimate alone contradicts it.
    Rejected,
    /// It agrees with the estimate, but not together with these proposals, by index; none of them can be left
    /// out.
    Refused {
        /// The proposals it quarrels with; none where it fails the joint test with what was given alone.
        with: Vec<usize>,
    },
    /// The estimate is too uncertain for an agreement to mean anything, or accepted relations leave it to
    /// terms of second order.
    Unclear,
}

/// A relation that was looked at.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// The relation.
    pub constraint: Constraint,
    /// The relation in words.
    pub text: String,
    /// Its χ² under the estimate with what was given alone.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// The probability of a χ² at least as large when the relation is true.
    pub p_value: f64,
    /// The share of its range in which it would have been accepted: the probability of an accident. At the
    /// time of its last test.
    pub chance: f64,
    /// What became of it.
    #[serde(flatten)]
    pub outcome: ProposalOutcome,
}

/// An estimate with the relations that it agrees with imposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Constrained {
    /// The drawing.
    pub drawing: ParametricDrawing,
    /// The covariance of its parameters.
    #[serde(serialize_with = "as_rows")]
    pub covariance: DMatrix<f64>,
    /// Every relation that was looked at.
    pub proposals: Vec<Proposal>,
    /// All that was imposed: what was given, what was accepted, dimensions that were snapped; in this order.
    pub constraints: Vec<Constraint>,
    /// What all that cost the estimate.
    pub chi_square: f64,
    /// The degrees of freedom of that χ².
    pub degrees: usize,
    /// The probability of a χ² at least as large.
    pub p_value: f64,
    /// What is left free, motions of the whole included.
    pub freedoms: usize,
    /// How many relations would be accepted of parts that have nothing to do with each other.
    pub expected_by_chance: f64,
    #[serde(skip)]
    pub(super) search: Search,
}

fn as_rows<S: serde::Serializer>(
    matrix: &DMatrix<f64>,
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_seq(matrix.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>()))
}

/// Candidates whose evidence is less than the best one's by no more than this factor's logarithm are taken
/// with it.
const ALIKE: f64 = 1.0;

/// The estimate, and what is imposed on it so far.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Search {
    pub(super) estimate: ParametricDrawing,
    pub(super) covariance: DMatrix<f64>,
    /// [`square_root`] of it.
    root: DMatrix<f64>,
    pub(super) options: ConstrainOptions,
    /// How many tests share the level.
    tests: usize,
    /// Each one's share.
    share: Level,
    /// χ² and degrees of what was given.
    given: (f64, usize),
}

/// Finds the relations that hold in a drawing, and imposes them.
///
/// 1. What is given is imposed. Every one of the [`candidates`] is then tested alone:
///    `χ² = fᵀ (H P Hᵀ)⁻¹ f`. Holm's procedure bounds the probability that *any* true one is lost by `level`.
/// 2. Of those left, the one with the strongest evidence is taken: the density of its residual if it
///    holds, over that of a residual anywhere in its range; with it all that have nearly as much and depend
///    on other parameters. One whose window of acceptance covers more than `max_chance` of that range has to
///    wait until others have made the estimate sharper, and is unclear in the end.
/// 3. It is imposed together with all before it, from the estimate anew. If it, given those, fails its
///    share of the level, or all of them fail the level together, it is refused, and the smallest set it
///    quarrels with is named. Of several taken together that fail, the best is tried alone. Repeat from 2.
///
/// Relations that follow from others are found at step 2, as nothing of their variance is left. One whose
/// variance is of second order has to wait too: near a rectangle, one pair of parallel sides leaves the
/// others equal to first order, though a trapezoid's are not. Cost: `c (c + m n²)` for `c` candidates, of
/// which there are about `2 b²` for `b` bars.
///
/// # Errors
/// `Input` when the covariance does not fit the drawing, an option is out of range, or what is given
/// contradicts itself.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::constraint::{BarId, ConstrainOptions, Constraint, ParametricDrawing, ProposalOutcome, constrain};
///
/// // A rectangle, known to 0.05 and somewhat turned: three right angles make the fourth and both parallels.
/// let seen = ParametricDrawing::polygon(&[[0.03, 0.0], [40.01, 3.46], [37.44, 33.36], [-2.58, 29.86]])?;
/// let found = constrain(&seen, &(DMatrix::identity(8, 8) * 0.0025), &ConstrainOptions::default())?;
/// assert_eq!(found.freedoms, 5);
/// let parallel = Constraint::Parallel { a: BarId(1), b: BarId(3) };
/// let last = found.proposals.iter().find(|p| p.constraint == parallel);
/// assert!(matches!(last.map(|p| &p.outcome), Some(ProposalOutcome::Imposed | ProposalOutcome::Implied)));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Holm 1979, *A simple sequentially rejective multiple test procedure*; Langbein, Marshall and Martin 2004,
/// *Choosing consistent constraints for beautification of reverse engineered geometric models*.
pub fn constrain(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    options: &ConstrainOptions,
) -> Result<Constrained> {
    constrain_among(drawing, covariance, &candidates(drawing), options)
}

/// [`constrain`] among relations of the caller's choice; with none, what is given is imposed and nothing
/// else.
///
/// # Errors
/// As [`constrain`]; also when a candidate names a part that is not there.
pub fn constrain_among(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    candidates: &[Candidate],
    options: &ConstrainOptions,
) -> Result<Constrained> {
    candidates.iter().try_for_each(|candidate| candidate.constraint.require_parts(drawing))?;
    for (name, value) in [("level", options.level), ("chance", options.max_chance)] {
        if !(value > 0.0 && value < 1.0) {
            return Err(Error::input(format!("the {name} must lie between 0 and 1, not at {value}")));
        }
    }
    let given = impose(drawing, covariance, &options.given, options.sigma)?;
    let search = Search {
        estimate: drawing.clone(),
        covariance: covariance.clone(),
        root: square_root(covariance),
        options: options.clone(),
        tests: candidates.len().max(1),
        share: Level::new(options.level / candidates.len().max(1) as f64),
        given: (given.chi_square, given.degrees),
    };
    let mut proposals = search.single_tests(candidates, &given)?;
    let expected_by_chance =
        proposals.iter().filter(|p| p.degrees > 0 && p.chance <= options.max_chance).map(|p| p.chance).sum();
    let state = search.accept(candidates, &mut proposals, given)?;
    Ok(Constrained {
        constraints: search.constraints(&proposals),
        freedoms: drawing.parameters() - state.degrees,
        drawing: state.drawing,
        covariance: state.covariance,
        chi_square: state.chi_square,
        degrees: state.degrees,
        p_value: state.p_value,
        expected_by_chance,
        proposals,
        search,
    })
}

impl Constrained {
    /// The relations that were accepted.
    pub fn accepted(&self) -> impl Iterator<Item = &Proposal> {
        self.proposals.iter().filter(|p| p.outcome == ProposalOutcome::Imposed)
    }
}

impl Search {
    /// Tests every candidate under the estimate with what was given; those that Holm's procedure rejects are
    /// marked, all others unclear for now.
    fn single_tests(&self, candidates: &[Candidate], given: &Imposed) -> Result<Vec<Proposal>> {
        let mut proposals = Vec::with_capacity(candidates.len());
        let alone = State::unconstrained(&given.drawing, &given.covariance);
        for candidate in candidates {
            let test = self.test(candidate, &alone);
            let known = if test.holds { ProposalOutcome::Implied } else { ProposalOutcome::Rejected };
            proposals.push(Proposal {
                constraint: candidate.constraint,
                text: candidate.constraint.describe(&self.estimate),
                chi_square: test.chi_square,
                degrees: test.degrees,
                p_value: test.p_value,
                chance: test.chance,
                outcome: if test.degrees > 0 { ProposalOutcome::Unclear } else { known },
            });
        }
        let mut order: Vec<usize> = (0..proposals.len()).filter(|&i| proposals[i].degrees > 0).collect();
        order.sort_by(|&a, &b| proposals[a].p_value.total_cmp(&proposals[b].p_value));
        for (k, &i) in order.iter().enumerate() {
            if proposals[i].p_value >= self.options.level / (order.len() - k) as f64 {
                break;
            }
            proposals[i].outcome = ProposalOutcome::Rejected;
        }
        Ok(proposals)
    }

    /// Takes the best candidates again and again, until none is left that means anything.
    fn accept(
        &self,
        candidates: &[Candidate],
        proposals: &mut [Proposal],
        given: Imposed,
    ) -> Result<Imposed> {
        let mut state = given;
        loop {
            let now = State::new(&state, &self.constraints(proposals));
            let best = self.best(candidates, proposals, &now, &state.drawing);
            let Some(&first) = best.first() else {
                return Ok(state);
            };
            for &i in &best {
                proposals[i].outcome = ProposalOutcome::Imposed;
            }
            let mut next = self.tried(&self.constraints(proposals), &state);
            if next.is_none() && best.len() > 1 {
                for &i in &best[1..] {
                    proposals[i].outcome = ProposalOutcome::Unclear;
                }
                next = self.tried(&self.constraints(proposals), &state);
            }
            match next {
                Some(next) => {
                    self.mark_implied(proposals, &next);
                    state = next;
                }
                None => {
                    proposals[first].outcome = ProposalOutcome::Unclear;
                    proposals[first].outcome = self.refusal(proposals, first, &state.drawing);
                }
            }
        }
    }

    /// The candidate with the strongest evidence, and others with nearly as much that depend on other
    /// parameters; those of which nothing is left are marked.
    fn best(
        &self,
        candidates: &[Candidate],
        proposals: &mut [Proposal],
        now: &State,
        at: &ParametricDrawing,
    ) -> Vec<usize> {
        let mut tests: Vec<(usize, Test)> = Vec::new();
        for i in 0..candidates.len() {
            if proposals[i].outcome != ProposalOutcome::Unclear {
                continue;
            }
            let test = self.test(&candidates[i], now);
            proposals[i].chance = test.chance;
            if test.degrees > 0 {
                if test.chance <= self.options.max_chance && test.is_defined {
                    tests.push((i, test));
                }
            } else if is_linear(&candidates[i], now, &self.covariance) {
                proposals[i].outcome = match test.holds {
                    true => ProposalOutcome::Implied,
                    false => self.refusal(proposals, i, at),
                };
            }
        }
        tests.sort_by(|a, b| b.1.log_evidence.total_cmp(&a.1.log_evidence).then(a.0.cmp(&b.0)));
        let mut best: Vec<usize> = Vec::new();
        let mut taken = vec![false; self.estimate.parameters()];
        let mut least = f64::NEG_INFINITY;
        for (i, test) in tests {
            if test.log_evidence < least {
                break;
            }
            let parameters = candidates[i].constraint.parameters(&self.estimate);
            let is_apart = parameters.iter().all(|&parameter| !taken[parameter]);
            let passes = best.is_empty() || test.p_value >= self.options.level / self.tests as f64;
            if is_apart && passes && is_linear(&candidates[i], now, &self.covariance) {
                if best.is_empty() {
                    least = test.log_evidence - ALIKE;
                }
                parameters.iter().for_each(|&parameter| taken[parameter] = true);
                best.push(i);
            }
        }
        best
    }

    /// Of candidates that were taken together, those that the others left nothing to say.
    fn mark_implied(&self, proposals: &mut [Proposal], next: &Imposed) {
        let given = self.options.given.len();
        let imposed: Vec<usize> =
            (0..proposals.len()).filter(|&i| proposals[i].outcome == ProposalOutcome::Imposed).collect();
        for &implied in next.implied.iter().filter(|&&implied| implied >= given) {
            proposals[imposed[implied - given]].outcome = ProposalOutcome::Implied;
        }
    }

    /// What was given, then what was accepted.
    fn constraints(&self, proposals: &[Proposal]) -> Vec<Constraint> {
        let accepted = proposals.iter().filter(|p| p.outcome == ProposalOutcome::Imposed);
        self.options.given.iter().copied().chain(accepted.map(|p| p.constraint)).collect()
    }

    /// The estimate with constraints imposed, if what they add to a state passes its share of the level, and
    /// all pass it together.
    pub(super) fn tried(&self, constraints: &[Constraint], before: &Imposed) -> Option<Imposed> {
        let start = Start { root: &self.root, near: Some(&before.drawing) };
        let next =
            impose_from(&self.estimate, &self.covariance, constraints, self.options.sigma, start).ok()?;
        let passes = self.passes((before.chi_square, before.degrees), (next.chi_square, next.degrees));
        passes.then_some(next)
    }

    /// Whether what is added to a χ² with its degrees passes its share of the level, and all of it the level.
    fn passes(&self, before: (f64, usize), after: (f64, usize)) -> bool {
        let tail =
            |from: (f64, usize)| chi_square_tail((after.0 - from.0).max(0.0), after.1.saturating_sub(from.1));
        tail(before) >= self.options.level / self.tests as f64 && tail(self.given) >= self.options.level
    }

    /// The smallest set of accepted proposals that a candidate cannot be accepted after: to first order where
    /// the accepted ones hold, and only where that sees no quarrel with all equations anew.
    fn refusal(&self, proposals: &[Proposal], candidate: usize, at: &ParametricDrawing) -> ProposalOutcome {
        let accepted: Vec<usize> =
            (0..proposals.len()).filter(|&i| proposals[i].outcome == ProposalOutcome::Imposed).collect();
        let given = self.options.given.len();
        let mut all = self.options.given.clone();
        all.extend(accepted.iter().map(|&i| proposals[i].constraint));
        all.push(proposals[candidate].constraint);
        let linear = Linearised::new(&self.estimate, at, &self.root, &self.covariance, &all);
        let first_order = quick_xplain(accepted.len(), |chosen| {
            let known = || (0..given).chain(chosen.iter().map(|&i| given + i));
            let before = linear.cost(known());
            let after = linear.cost(known().chain([all.len() - 1]));
            self.passes((before.chi_square, before.degrees), (after.chi_square, after.degrees))
        });
        if !first_order.is_empty() {
            return ProposalOutcome::Refused { with: first_order.into_iter().map(|i| accepted[i]).collect() };
        }
        let found = quick_xplain(accepted.len(), |chosen| {
            let mut constraints = self.options.given.clone();
            constraints.extend(chosen.iter().map(|&i| proposals[accepted[i]].constraint));
            let start = Start { root: &self.root, near: None };
            let before =
                impose_from(&self.estimate, &self.covariance, &constraints, self.options.sigma, start);
            constraints.push(proposals[candidate].constraint);
            before.is_ok_and(|before| self.tried(&constraints, &before).is_some())
        });
        ProposalOutcome::Refused { with: found.into_iter().map(|i| accepted[i]).collect() }
    }

    pub(super) fn test(&self, candidate: &Candidate, state: &State) -> Test {
        test(candidate, state, &self.covariance, self.share)
    }
}
