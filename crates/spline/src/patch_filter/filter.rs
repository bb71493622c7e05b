//! The filter: construction, subdivision, reconciliation.
//!
//! Input: an initial surface, a prior, readings. Output: a filter whose surface and σ can be queried, and the
//! subdivisions with their reasons.
//!
//! Not guaranteed: continuity between single patches. [`PatchFilter::surface`] joins them and weighs copies
//! of a vertex by their variances (eq. 20 of the paper for single vertices).

use super::belief::{PatchBelief, Workspace};
use super::criterion::{InnovationSum, SubdivisionCriteria, SubdivisionReason};
use super::observe::ScalarReading;
use super::options::{PatchFilterOptions, StateLayout};
use super::prior::{PatchCovariances, SmoothnessPrior, positive_part};
use super::quadtree::{FilterPatch, Quadtree, VERTICES, quarter_matrix, vertex_of};
use super::reconcile::{PatchChange, spread};
use crate::hierarchy::{Hierarchy, MAX_LEVEL};
use crate::surface::{Surface, leaf_weights};
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use std::collections::HashMap;
use std::sync::Arc;

/// Result of an update with one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchUpdate {
    /// The updated patch.
    pub patch: FilterPatch,
    /// Number of scalar equations.
    pub equations: usize,
    /// `Σ e²/S`, distributed as χ² if the filter is consistent, with as many degrees of freedom as equations.
    pub normalized_squared: f64,
    /// True if the reading was used unchanged. A reading beyond the gate is rejected, or used with a larger
    /// variance if many of its neighbours are beyond it, too.
    pub within_gate: bool,
}

/// A subdivided patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Subdivision {
    /// The patch.
    pub patch: FilterPatch,
    /// The reason.
    pub reason: SubdivisionReason,
}

/// A patch with its state.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub belief: PatchBelief,
    /// The belief before readings that neighbours have not yet received; `None` if there are none.
    pub before: Option<PatchBelief>,
    /// Prior covariance of one coordinate.
    pub prior: DMatrix<f64>,
    pub innovations: [InnovationSum; 16],
    /// Coefficients of the initial surface.
    pub initial: Vec<DVec3>,
}

/// A surface as a quadtree of patches, each filtered separately and reconciled with its neighbours.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::{
///     Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, StateLayout, SurfaceReading,
///     parameter_plane,
/// };
/// # fn main() -> planish_spline::Result<()> {
/// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?.into();
/// let plane = parameter_plane(&space)?;
/// let prior = SmoothnessPrior { weight: 1.0, hold: 0.01 };
/// let options = PatchFilterOptions { layout: StateLayout::Height, ..PatchFilterOptions::default() };
/// let mut filter = PatchFilter::new(&plane, &plane, prior, options)?;
/// let before = filter.variance_along(2.0, 2.0, DVec3::Z);
/// let (parameters, point) = ([2.0, 2.0], DVec3::new(2.0, 2.0, 0.3));
/// filter.observe(&SurfaceReading::Position { parameters, point, variance: 1e-4 })?;
/// assert!((filter.surface()?.point(2.0, 2.0)[2] - 0.3).abs() < 0.01);
/// assert!(filter.variance_along(2.0, 2.0, DVec3::Z) < 1e-3 * before);
/// # Ok(())
/// # }
/// ```
///
/// # References
/// Wang, Wang 1994, sections 3.1 and 3.2.
#[derive(Debug, Clone)]
pub struct PatchFilter {
    pub(super) initial: Surface,
    pub(super) metric: Surface,
    pub(super) prior: SmoothnessPrior,
    pub(super) options: PatchFilterOptions,
    pub(super) quadtree: Quadtree,
    pub(super) members: Vec<Member>,
    pub(super) readings: u64,
    /// For each depth, the part of the prior variance that only deeper patches can represent.
    pub(super) detail_variance: Vec<f64>,
    pub(super) workspace: Workspace,
    pub(super) scalars: [ScalarReading; 3],
}

impl PatchFilter {
    /// A filter whose mean is the initial surface.
    ///
    /// Smoothness is measured in the metric of `metric`, which has the space of the initial surface. Use
    /// [`super::parameter_plane`] for the parametric energy of a sheet. Cost: the factor of the prior over
    /// the base grid.
    ///
    /// # Errors
    /// `Input` when the base grid is not a multiple of 4 × 4 cells, is refined, or differs from that of the
    /// metric, or when the prior is not proper.
    pub fn new(
        initial: &Surface,
        metric: &Surface,
        prior: SmoothnessPrior,
        options: PatchFilterOptions,
    ) -> Result<Self> {
        if initial.space().levels() > 1 {
            return Err(Error::input(
                "a patch filter needs an unrefined initial surface; it refines the surface itself",
            ));
        }
        Self::begin(initial, initial, metric, prior, options, None)
    }

    /// A filter that continues from a first fit: its mean is that surface, its covariance the inverse of
    /// `information`.
    ///
    /// The cells of the surface form whole patches ([`super::patch_hierarchy`]) over the base grid of
    /// `metric`. `information` is that of one coordinate over its nodes, with the prior and the first
    /// readings. Do not observe these readings again. Every patch gets its marginal of the joint belief, so
    /// neighbours agree at the start. Cost: one factor and a selected inverse.
    ///
    /// # Errors
    /// As for [`Self::new`], and `Input` for cells that do not form whole patches or exceed the maximum
    /// depth, and for the layout of heights; `Undetermined` when the information is singular.
    pub fn from_first_fit(
        fitted: &Surface,
        metric: &Surface,
        prior: SmoothnessPrior,
        information: &BlockInformation,
        options: PatchFilterOptions,
    ) -> Result<Self> {
        if options.layout == StateLayout::Height {
            return Err(Error::input("a first fit has three coordinates: use a layout other than heights"));
        }
        if fitted.space().levels() > usize::from(options.maximum_depth) + 1 {
            return Err(Error::input(format!(
                "the first fit has {} levels, more than the maximum depth of {} allows",
                fitted.space().levels(),
                options.maximum_depth
            )));
        }
        Self::begin(fitted, metric, metric, prior, options, Some(information))
    }

    /// Builds a filter. `fitted` is the mean; `initial` is the surface over the base grid that provides the
    /// fixed coordinates of the layout of heights.
    fn begin(
        fitted: &Surface,
        initial: &Surface,
        metric: &Surface,
        prior: SmoothnessPrior,
        options: PatchFilterOptions,
        information: Option<&BlockInformation>,
    ) -> Result<Self> {
        prior.validate()?;
        let space = fitted.space();
        // Patches that are divided later have the same metric, so it must not depend on present divisions.
        if !metric.space().same_base(space) || metric.space().levels() > 1 {
            return Err(Error::input("the metric and the initial surface need the same base grid"));
        }
        if usize::from(options.maximum_depth) > MAX_LEVEL {
            return Err(Error::input(format!(
                "a maximum depth of {} exceeds the limit of {MAX_LEVEL}",
                options.maximum_depth
            )));
        }
        if !(0.0..1.0).contains(&options.min_gain) {
            return Err(Error::input(format!(
                "the minimum gain must be at least 0 and below 1, found {}",
                options.min_gain
            )));
        }
        let quadtree = Quadtree::new(Arc::clone(space))?;
        let start = initial.refined(Arc::clone(space))?;
        let priors = PatchCovariances::of_prior(&quadtree, metric, prior.hold)?;
        let known = information
            .map(|information| PatchCovariances::of_information(&quadtree, information))
            .transpose()?;
        let members = (0..quadtree.patches.len())
            .map(|p| {
                // The prior is computed for weight 1 and scaled, because a weight only divides a covariance.
                let covariance = priors.covariance(&quadtree, p)? / prior.weight;
                let known = match &known {
                    Some(known) => known.covariance(&quadtree, p)?,
                    None => covariance.clone(),
                };
                let mean = quadtree.coefficients(p, |leaf| *fitted.leaf_coefficients(leaf));
                let mean = match options.layout {
                    StateLayout::Height => DMatrix::from_fn(VERTICES, 1, |k, _| mean[k][2]),
                    StateLayout::Isotropic | StateLayout::Normal => {
                        DMatrix::from_fn(VERTICES, 3, |k, d| mean[k][d])
                    }
                    StateLayout::Full => DMatrix::from_fn(3 * VERTICES, 1, |k, _| mean[k / 3][k % 3]),
                };
                Ok(Member {
                    belief: PatchBelief::from_matrices(&mean, &expanded(&known, options.layout)),
                    before: None,
                    prior: covariance,
                    innovations: [InnovationSum::default(); 16],
                    initial: quadtree.coefficients(p, |leaf| *start.leaf_coefficients(leaf)),
                })
            })
            .collect::<Result<_>>()?;
        Self::assemble(initial.clone(), metric.clone(), prior, options, quadtree, members, 0)
    }

    pub(super) fn assemble(
        initial: Surface,
        metric: Surface,
        prior: SmoothnessPrior,
        options: PatchFilterOptions,
        quadtree: Quadtree,
        members: Vec<Member>,
        readings: u64,
    ) -> Result<Self> {
        let detail_variance = detail_variances(&metric, prior, &options)?;
        Ok(Self {
            initial,
            metric,
            prior,
            options,
            quadtree,
            members,
            readings,
            detail_variance,
            workspace: Workspace::default(),
            scalars: Default::default(),
        })
    }

    /// Converts to the full layout, which accepts every kind of reading. The estimate stays, and the three
    /// coordinates get separate covariances.
    ///
    /// # Errors
    /// `Unsupported` for filters of heights or along normals, which have no covariance in the other
    /// directions.
    pub fn with_full_layout(mut self) -> Result<Self> {
        match self.options.layout {
            StateLayout::Full => return Ok(self),
            StateLayout::Isotropic => {}
            StateLayout::Normal => {
                return Err(Error::unsupported(
                    "a filter along normals has no covariance in the other directions: start with the \
                     isotropic or the full layout",
                ));
            }
            StateLayout::Height => {
                return Err(Error::unsupported(
                    "a filter of heights has no covariance in the plane: start with the isotropic or the \
                     full layout",
                ));
            }
        }
        let widen = |belief: &PatchBelief| {
            // A row-major matrix of vertices by coordinates is already in the order of the full layout.
            let mean = DMatrix::from_row_slice(3 * VERTICES, 1, belief.mean());
            PatchBelief::from_matrices(&mean, &expanded(&belief.covariance_matrix(), StateLayout::Full))
        };
        for member in &mut self.members {
            member.belief = widen(&member.belief);
            member.before = member.before.as_ref().map(widen);
        }
        self.options.layout = StateLayout::Full;
        Ok(self)
    }

    /// The leaf patches.
    #[must_use]
    pub fn patches(&self) -> &[FilterPatch] {
        &self.quadtree.patches
    }

    /// The hierarchy; the patches consist of its leaf cells.
    #[must_use]
    pub fn space(&self) -> &Arc<Hierarchy> {
        &self.quadtree.space
    }

    /// The belief of a leaf patch, by its index in [`Self::patches`].
    #[must_use]
    pub fn belief(&self, patch: usize) -> &PatchBelief {
        &self.members[patch].belief
    }

    /// The options.
    #[must_use]
    pub fn options(&self) -> &PatchFilterOptions {
        &self.options
    }

    /// The prior.
    #[must_use]
    pub fn prior(&self) -> SmoothnessPrior {
        self.prior
    }

    /// Number of readings used so far.
    #[must_use]
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Memory of means and covariances in bytes. It grows with the patches, not with the readings.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let belief_bytes = |b: &PatchBelief| 8 * (b.mean().len() + b.covariance().len());
        self.members
            .iter()
            .map(|m| {
                belief_bytes(&m.belief)
                    + m.before.as_ref().map_or(0, belief_bytes)
                    + 8 * m.prior.len()
                    + 24 * m.initial.len()
            })
            .sum()
    }

    /// Sends new information of each patch since the last call to all others, by the channel filter.
    ///
    /// Cost: about 100,000 multiply-adds per pair of a patch with new readings and a patch that receives
    /// information. It does not depend on the number of readings.
    ///
    /// # Errors
    /// `Undetermined` when noise-free readings are inconsistent.
    pub fn reconcile(&mut self) -> Result<()> {
        // All messages start from the state before any of them arrives. Otherwise a patch would forward what
        // it has just received as its own.
        let changes: Vec<PatchChange> = self
            .members
            .iter_mut()
            .enumerate()
            .filter_map(|(patch, member)| {
                Some(PatchChange { patch, before: member.before.take()?, after: member.belief.clone() })
            })
            .collect();
        let mut beliefs: Vec<&mut PatchBelief> = self.members.iter_mut().map(|m| &mut m.belief).collect();
        spread(
            &self.quadtree,
            &mut beliefs,
            &changes,
            self.options.layout == StateLayout::Full,
            self.options.min_gain,
        )
    }

    /// Subdivides the patches that the criteria select, up to the maximum depth, and returns them with
    /// reasons. Reconciles neighbours first.
    ///
    /// # Errors
    /// As for [`Self::reconcile`].
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{
    ///     Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, StateLayout,
    ///     SubdivisionCriteria, SurfaceReading, parameter_plane,
    /// };
    ///
    /// let plane = parameter_plane(&Hierarchy::uniform(Shape::Sheet, [4, 4])?.into())?;
    /// let prior = SmoothnessPrior { weight: 1.0, hold: 0.01 };
    /// let options = PatchFilterOptions { layout: StateLayout::Height, ..PatchFilterOptions::default() };
    /// let mut filter = PatchFilter::new(&plane, &plane, prior, options)?;
    /// // Waves that one patch cannot follow, read with σ = 0.001.
    /// for k in 0..400 {
    ///     let parameters = [0.2 * f64::from(k % 20), 0.2 * f64::from(k / 20)];
    ///     let point = DVec3::new(parameters[0], parameters[1], 0.1 * (6.0 * parameters[0]).sin());
    ///     filter.observe(&SurfaceReading::Position { parameters, point, variance: 1e-6 })?;
    /// }
    /// assert_eq!(filter.refine(&SubdivisionCriteria::default())?.len(), 1);
    /// assert_eq!(filter.patches().len(), 4);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn refine(&mut self, criteria: &SubdivisionCriteria) -> Result<Vec<Subdivision>> {
        self.reconcile()?;
        let deepest = self.options.maximum_depth;
        let mut reasons: Vec<Option<SubdivisionReason>> = (0..self.members.len())
            .map(|p| {
                let may = self.quadtree.patches[p].depth < deepest;
                may.then(|| self.reason(p, criteria)).flatten()
            })
            .collect();
        // A subdivision adds three patches. If there is not enough room, the strongest reasons come first.
        let room = criteria.max_patches.saturating_sub(self.members.len()) / 3;
        let mut wanted: Vec<usize> = (0..reasons.len()).filter(|&p| reasons[p].is_some()).collect();
        if wanted.len() > room {
            let strength = |p: usize| reasons[p].map_or((0, 0.0), SubdivisionReason::strength);
            wanted.sort_by(|&a, &b| {
                let (a, b) = (strength(a), strength(b));
                b.0.cmp(&a.0).then(b.1.total_cmp(&a.1))
            });
            for &p in &wanted[room..] {
                reasons[p] = None;
            }
        }
        self.subdivide_for(reasons)
    }

    /// Subdivides the given patches and those that grading requires, and returns them with reasons.
    ///
    /// # Errors
    /// `Input` for a patch that is not a leaf or has the maximum depth; otherwise as for [`Self::reconcile`].
    pub fn subdivide(&mut self, patches: &[FilterPatch]) -> Result<Vec<Subdivision>> {
        let mut reasons = vec![None; self.members.len()];
        for patch in patches {
            let at = self
                .quadtree
                .patches
                .binary_search(patch)
                .map_err(|_| Error::input(format!("{patch:?} is not a leaf patch")))?;
            if patch.depth >= self.options.maximum_depth {
                return Err(Error::input(format!("{patch:?} already has the maximum depth")));
            }
            reasons[at] = Some(SubdivisionReason::Requested);
        }
        self.reconcile()?;
        self.subdivide_for(reasons)
    }

    /// Subdivides patches. Children inherit `α Σ αᵀ + Q`, which contains all readings. The prior of other
    /// patches grows, too: neighbours gain detail that grading had excluded, and the energy projection of new
    /// detail reaches beyond the divided patches.
    fn subdivide_for(&mut self, reasons: Vec<Option<SubdivisionReason>>) -> Result<Vec<Subdivision>> {
        let marked: Vec<bool> = reasons.iter().map(Option::is_some).collect();
        if !marked.contains(&true) {
            return Ok(Vec::new());
        }
        // New quadtree with its priors.
        let quadtree = self.quadtree.subdivided(&marked)?;
        let priors = PatchCovariances::of_prior(&quadtree, &self.metric, self.prior.hold)?;
        let old: HashMap<FilterPatch, usize> =
            (0..).zip(&self.quadtree.patches).map(|(n, &p)| (p, n)).collect();
        let initial = self.initial.refined(Arc::clone(&quadtree.space))?;
        let layout = self.options.layout;
        // Carry every belief over: the same patch by the identity, a child by the two-scale relation.
        let members = quadtree
            .patches
            .iter()
            .enumerate()
            .map(|(p, patch)| {
                let known = old.get(patch);
                let prior = priors.covariance(&quadtree, p)? / self.prior.weight;
                let (from, alpha) = match (known, patch.parent().and_then(|parent| old.get(&parent))) {
                    (Some(&at), _) => (at, DMatrix::identity(VERTICES, VERTICES)),
                    (None, Some(&at)) => (at, quarter_matrix([patch.i as usize % 2, patch.j as usize % 2])),
                    (None, None) => return Err(Error::input(format!("{patch:?} has no parent"))),
                };
                let from = &self.members[from];
                // The difference is positive semidefinite only for a plane. In other metrics the quadrature
                // of fine leaves differs from that of coarse ones.
                let detail = positive_part(&prior - &alpha * &from.prior * alpha.transpose());
                // The belief about the coarse functions is exact on the finer grid; `detail` adds the prior
                // variance of what only the finer grid can represent.
                let carry = expanded(&alpha, layout);
                let covariance =
                    &carry * from.belief.covariance_matrix() * carry.transpose() + expanded(&detail, layout);
                Ok(Member {
                    belief: PatchBelief::from_matrices(&(carry * from.belief.mean_matrix()), &covariance),
                    before: None,
                    prior,
                    // Children start with empty sums: the innovations of the parent contain the misfit that
                    // caused the subdivision.
                    innovations: known.map_or([InnovationSum::default(); 16], |_| from.innovations),
                    initial: quadtree.coefficients(p, |leaf| *initial.leaf_coefficients(leaf)),
                })
            })
            .collect::<Result<Vec<Member>>>()?;
        // Patches that disappeared were subdivided, on request or for grading.
        let kept: std::collections::HashSet<FilterPatch> = quadtree.patches.iter().copied().collect();
        let divided = self
            .quadtree
            .patches
            .iter()
            .zip(reasons)
            .filter(|(patch, _)| !kept.contains(patch))
            .map(|(&patch, reason)| Subdivision {
                patch,
                reason: reason.unwrap_or(SubdivisionReason::Grading),
            })
            .collect();
        self.quadtree = quadtree;
        self.members = members;
        Ok(divided)
    }
}

/// Expands a matrix over vertices to the unknowns of a layout.
fn expanded(matrix: &DMatrix<f64>, layout: StateLayout) -> DMatrix<f64> {
    match layout {
        StateLayout::Full => matrix.kronecker(&DMatrix::<f64>::identity(3, 3)),
        _ => matrix.clone(),
    }
}

/// For every depth, the prior variance of one coordinate at a point that patches of this depth cannot
/// represent and those of the maximum depth can.
///
/// It is a mean over the first base patch, computed for one subdivision. For a thin plate in the plane it
/// decreases to a quarter per level.
fn detail_variances(
    metric: &Surface,
    prior: SmoothnessPrior,
    options: &PatchFilterOptions,
) -> Result<Vec<f64>> {
    let depths = usize::from(options.maximum_depth);
    if !options.expect_detail || depths == 0 {
        return Ok(vec![0.0; depths + 1]);
    }
    let coarse = Quadtree::new(Arc::clone(metric.space()))?;
    let mut marked = vec![false; coarse.patches.len()];
    // One patch is representative: on a uniform metric all of one depth have the same prior.
    marked[0] = true;
    let fine = coarse.subdivided(&marked)?;
    let (before, after) = (
        PatchCovariances::of_prior(&coarse, metric, prior.hold)?.covariance(&coarse, 0)?,
        PatchCovariances::of_prior(&fine, metric, prior.hold)?,
    );
    // Two points per cell are enough for a mean over a whole patch.
    let (mut sum, mut points) = (0.0, 0.0);
    for (p, patch) in fine.patches.iter().enumerate() {
        if patch.parent() != Some(coarse.patches[0]) {
            continue;
        }
        let alpha = quarter_matrix([patch.i as usize % 2, patch.j as usize % 2]);
        let detail = after.covariance(&fine, p)? - &alpha * &before * alpha.transpose();
        for cell in 0..16 {
            for weights in [leaf_weights(0.25, 0.25), leaf_weights(0.75, 0.75)] {
                points += 1.0;
                for (k, a) in weights.iter().enumerate() {
                    for (l, b) in weights.iter().enumerate() {
                        sum += a * b * detail[(vertex_of(cell, k), vertex_of(cell, l))];
                    }
                }
            }
        }
    }
    let first = (sum / points).max(0.0) / prior.weight;
    let mut below = vec![0.0; depths + 1];
    for depth in (0..depths).rev() {
        // The sum over all deeper levels. The variance falls to a quarter per level, as for a thin plate in
        // the plane.
        below[depth] = below[depth + 1] + first * 0.25_f64.powi(depth as i32);
    }
    Ok(below)
}
