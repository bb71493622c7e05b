//! Relations proposed by tests on the estimated covariance, and imposed if they agree with the estimate.
//!
//! In: an estimate of the parameters of a drawing with its covariance. Out: the outcome of every candidate,
//! and the estimate with the accepted ones imposed. Not guaranteed: that an accepted relation was intended;
//! `expected_by_chance` is the number expected among unrelated parts (decision record 0045).

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

/// Default probability of rejecting any true relation.
///
/// A larger level loses true relations more often; a smaller one widens the windows of acceptance, and more
/// relations remain unclear.
pub const DEFAULT_LEVEL: f64 = 0.001;

/// Options of the search for relations.
#[derive(Debug, Clone, PartialEq)]
pub struct ConstrainOptions {
    /// Probability of rejecting any true relation: shared by the tests of single relations, and also the
    /// level of the joint test.
    pub level: f64,
    /// Maximum fraction of its range over which a relation may be accepted (default 0.05).
    ///
    /// Above it, unrelated parts would agree too often for the agreement to be evidence.
    pub max_chance: f64,
    /// σ with which relations hold: angles in radians, lengths as fractions of the extent of the drawing.
    /// Zero means exactly.
    pub sigma: f64,
    /// Constraints imposed without a test, for example anchors, ends of arcs, known dimensions.
    pub given: Vec<Constraint>,
}

impl Default for ConstrainOptions {
    /// [`DEFAULT_LEVEL`], a chance of at most 0.05, exact relations, no given constraints.
    fn default() -> Self {
        Self { level: DEFAULT_LEVEL, max_chance: 0.05, sigma: 0.0, given: Vec::new() }
    }
}

/// Outcome of a candidate relation.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "outcome", rename_all = "snake_case")]
pub enum ProposalOutcome {
    /// It agrees with the estimate and all relations accepted before, and was imposed.
    Imposed,
    /// It follows from imposed relations, or from the estimate itself.
    Implied,
    /// It contradicts the estimate alone.
    Rejected,
    /// It agrees with the estimate, but not together with a minimal set of accepted proposals.
    Refused {
        /// Indices of the conflicting proposals; empty if it fails with the given constraints alone.
        with: Vec<usize>,
    },
    /// The estimate is too uncertain for an agreement to be evidence, or the accepted relations leave only
    /// second-order variance.
    Unclear,
}

/// A tested relation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// The relation.
    pub constraint: Constraint,
    /// The relation as text.
    pub text: String,
    /// Its χ² under the estimate with only the given constraints imposed.
    pub chi_square: f64,
    /// Degrees of freedom of `chi_square`.
    pub degrees: usize,
    /// Probability of a χ² at least as large if the relation is true.
    pub p_value: f64,
    /// Fraction of its range over which it would be accepted at its last test: the probability that unrelated
    /// parts agree.
    pub chance: f64,
    /// Outcome of the relation.
    #[serde(flatten)]
    pub outcome: ProposalOutcome,
}

/// An estimate with the accepted relations imposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Constrained {
    /// The constrained drawing.
    pub drawing: ParametricDrawing,
    /// Covariance of its parameters.
    #[serde(serialize_with = "as_rows")]
    pub covariance: DMatrix<f64>,
    /// All tested relations.
    pub proposals: Vec<Proposal>,
    /// All imposed constraints: given ones, accepted relations, snapped dimensions, in this order.
    pub constraints: Vec<Constraint>,
    /// χ² of all imposed constraints.
    pub chi_square: f64,
    /// Degrees of freedom of `chi_square`.
    pub degrees: usize,
    /// Probability of a χ² at least as large if all constraints are true.
    pub p_value: f64,
    /// Remaining degrees of freedom, rigid motions included.
    pub freedoms: usize,
    /// Expected number of accepted relations among unrelated parts.
    pub expected_by_chance: f64,
    #[serde(skip)]
    pub(super) search: Search,
}

/// Serialises a matrix as a list of rows.
fn as_rows<S: serde::Serializer>(
    matrix: &DMatrix<f64>,
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    serializer.collect_seq(matrix.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>()))
}

/// Candidates whose log-evidence is within this of the best are imposed in the same step.
///
/// Zero imposes one relation per step, which is slow for many equal ones. A larger value imposes weaker
/// relations before the stronger ones have sharpened the estimate.
const EVIDENCE_TOLERANCE: f64 = 1.0;

/// The unconstrained estimate with everything that the tests need.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Search {
    pub(super) estimate: ParametricDrawing,
    pub(super) covariance: DMatrix<f64>,
    /// [`square_root`] of the covariance, computed once for all steps.
    root: DMatrix<f64>,
    pub(super) options: ConstrainOptions,
    /// Number of tests that share the level.
    tests: usize,
    /// Level of a single test.
    share: Level,
    /// χ² and degrees of freedom of the given constraints.
    given: (f64, usize),
}

/// Finds the relations that hold in a drawing and imposes them.
///
/// 1. Impose the given constraints. Test each of the [`candidates`] alone: `χ² = fᵀ (H P Hᵀ)⁻¹ f`. Holm's
///    procedure bounds the probability of rejecting *any* true relation by `level`.
/// 2. Select the remaining candidate with the strongest evidence: the density of its residual if it holds,
///    divided by that of a residual anywhere in its range. Add those with nearly as much evidence that depend
///    on other parameters. A candidate whose window of acceptance covers more than `max_chance` of its range
///    waits until others have made the estimate sharper; if it waits to the end, it is unclear.
/// 3. Impose the selection together with all accepted relations, starting from the unconstrained estimate. A
///    candidate is refused if it fails its share of the level given those before, or if all together fail the
///    level; a minimal conflicting set is reported. If several were selected, the best is tried alone
///    first. Repeat from 2.
///
/// Step 2 also finds relations that follow from others: they have no variance left. A candidate whose
/// variance is of second order waits, too. Near a rectangle, for example, one pair of parallel sides makes
/// the other two sides equal to first order, though those of a trapezoid are not. Cost: `c (c + m n²)` for
/// `c` candidates; `b` bars have about `2 b²`.
///
/// # Errors
/// `Input` if the covariance does not fit the drawing, an option is out of range, or the given constraints
/// conflict.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_contour::constraint::{
///     BarId, ConstrainOptions, Constraint, ParametricDrawing, ProposalOutcome, constrain,
/// };
///
/// // A rotated rectangle with σ = 0.05: three right angles imply the fourth and both parallel pairs.
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

/// [`constrain`] with candidates chosen by the caller. Without candidates, only the given constraints are
/// imposed.
///
/// # Errors
/// As [`constrain`]; also `Input` if a candidate refers to a part that the drawing does not have.
pub fn constrain_among(
    drawing: &ParametricDrawing,
    covariance: &DMatrix<f64>,
    candidates: &[Candidate],
    options: &ConstrainOptions,
) -> Result<Constrained> {
    candidates.iter().try_for_each(|candidate| candidate.constraint.require_parts(drawing))?;
    for (name, value) in [("level", options.level), ("chance", options.max_chance)] {
        if !(value > 0.0 && value < 1.0) {
            return Err(Error::input(format!("expected a {name} between 0 and 1, found {value}")));
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
    // Before anything is accepted: afterwards, the windows are narrower and correlated.
    let mut proposals = search.single_tests(candidates, &given)?;
    // Over all relations that are sharp enough to be accepted, whether they hold or not.
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
    /// Tests every candidate under the estimate with the given constraints. Those that Holm's procedure
    /// rejects are marked; all others are unclear for now.
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
        // Holm: compare the k-th smallest p-value with level / (n − k), and stop at the first that passes.
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

    /// Imposes the best candidates step by step until none with enough evidence remains.
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
            let mut next = self.impose_if_accepted(&self.constraints(proposals), &state);
            // The candidates selected together were tested one by one only. If they fail jointly, the best
            // one is tried alone, and the others wait for the next step.
            if next.is_none() && best.len() > 1 {
                for &i in &best[1..] {
                    proposals[i].outcome = ProposalOutcome::Unclear;
                }
                next = self.impose_if_accepted(&self.constraints(proposals), &state);
            }
            match next {
                Some(next) => {
                    self.mark_implied(proposals, &next);
                    state = next;
                }
                None => {
                    // `refusal` reads the accepted set from the outcomes: the candidate must not be in it.
                    proposals[first].outcome = ProposalOutcome::Unclear;
                    proposals[first].outcome = self.refusal(proposals, first, &state.drawing);
                }
            }
        }
    }

    /// The candidate with the strongest evidence, and others with nearly as much that depend on other
    /// parameters.
    ///
    /// Marks candidates without remaining variance as implied or refused.
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
            // Tested anew in each step, because accepted relations change the estimate and sharpen its
            // covariance.
            let test = self.test(&candidates[i], now);
            proposals[i].chance = test.chance;
            if test.degrees > 0 {
                if test.chance <= self.options.max_chance && test.is_defined {
                    tests.push((i, test));
                }
            // No variance left: implied, or in conflict. If only the linear part vanishes, it has to wait.
            } else if is_linear(&candidates[i], now, &self.covariance) {
                proposals[i].outcome = match test.holds {
                    true => ProposalOutcome::Implied,
                    false => self.refusal(proposals, i, at),
                };
            }
        }
        // Candidates that share no parameter hardly change each other's tests: one step can impose all of
        // them.
        tests.sort_by(|a, b| b.1.log_evidence.total_cmp(&a.1.log_evidence).then(a.0.cmp(&b.0)));
        let mut best: Vec<usize> = Vec::new();
        let mut used = vec![false; self.estimate.parameters()];
        let mut min_evidence = f64::NEG_INFINITY;
        for (i, test) in tests {
            if test.log_evidence < min_evidence {
                break;
            }
            let parameters = candidates[i].constraint.parameters(&self.estimate);
            let is_apart = parameters.iter().all(|&parameter| !used[parameter]);
            // The best candidate may fail its test: it is then refused with the conflicting set. Others must
            // pass here.
            let passes = best.is_empty() || test.p_value >= self.options.level / self.tests as f64;
            if is_apart && passes && is_linear(&candidates[i], now, &self.covariance) {
                if best.is_empty() {
                    min_evidence = test.log_evidence - EVIDENCE_TOLERANCE;
                }
                parameters.iter().for_each(|&parameter| used[parameter] = true);
                best.push(i);
            }
        }
        best
    }

    /// Marks candidates of one step that follow from the others of that step.
    fn mark_implied(&self, proposals: &mut [Proposal], next: &Imposed) {
        let given = self.options.given.len();
        let imposed: Vec<usize> =
            (0..proposals.len()).filter(|&i| proposals[i].outcome == ProposalOutcome::Imposed).collect();
        for &implied in next.implied.iter().filter(|&&implied| implied >= given) {
            proposals[imposed[implied - given]].outcome = ProposalOutcome::Implied;
        }
    }

    /// The given constraints, followed by the accepted relations.
    fn constraints(&self, proposals: &[Proposal]) -> Vec<Constraint> {
        let accepted = proposals.iter().filter(|p| p.outcome == ProposalOutcome::Imposed);
        self.options.given.iter().copied().chain(accepted.map(|p| p.constraint)).collect()
    }

    /// The estimate with constraints imposed, or `None` if they fail the tests of [`Self::passes`].
    ///
    /// It starts from the unconstrained estimate: constraints on a constrained one would break earlier ones
    /// at second order. The state before only provides a drawing near the solution.
    pub(super) fn impose_if_accepted(&self, constraints: &[Constraint], before: &Imposed) -> Option<Imposed> {
        let start = Start { root: &self.root, near: Some(&before.drawing) };
        let next =
            impose_from(&self.estimate, &self.covariance, constraints, self.options.sigma, start).ok()?;
        let passes = self.passes((before.chi_square, before.degrees), (next.chi_square, next.degrees));
        passes.then_some(next)
    }

    /// True if the increase of χ² passes the level of a single test, and the whole χ² passes the level.
    fn passes(&self, before: (f64, usize), after: (f64, usize)) -> bool {
        let tail =
            |from: (f64, usize)| chi_square_tail((after.0 - from.0).max(0.0), after.1.saturating_sub(from.1));
        tail(before) >= self.options.level / self.tests as f64 && tail(self.given) >= self.options.level
    }

    /// A minimal set of accepted proposals with which a candidate conflicts.
    ///
    /// The search asks for the χ² of many subsets, so it first uses equations linearised where the accepted
    /// relations hold. If it finds no conflict there, it repeats with the exact equations.
    fn refusal(&self, proposals: &[Proposal], candidate: usize, at: &ParametricDrawing) -> ProposalOutcome {
        let accepted: Vec<usize> =
            (0..proposals.len()).filter(|&i| proposals[i].outcome == ProposalOutcome::Imposed).collect();
        let given = self.options.given.len();
        let mut all = self.options.given.clone();
        all.extend(accepted.iter().map(|&i| proposals[i].constraint));
        all.push(proposals[candidate].constraint);
        // Given constraints are part of every subset and never blamed.
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
            before.is_ok_and(|before| self.impose_if_accepted(&constraints, &before).is_some())
        });
        ProposalOutcome::Refused { with: found.into_iter().map(|i| accepted[i]).collect() }
    }

    pub(super) fn test(&self, candidate: &Candidate, state: &State) -> Test {
        test(candidate, state, &self.covariance, self.share)
    }
}
