//! The filter itself: readings in, surface and σ out.
//!
//! Comes in: an initial surface, a prior, readings. Goes out: surfaces, variances, the list of what was
//! divided and why.
//!
//! Not guaranteed: a continuous surface from single patches; [`PatchFilter::surface`] joins them, weighing
//! copies of a vertex by their variances (eq. 20 of the paper for single vertices).

use super::belief::{PatchBelief, Workspace};
use super::criterion::{InnovationSum, SubdivisionCriteria, SubdivisionReason, gaussian_curvature};
use super::observe::ScalarReading;
use super::prior::{PatchCovariances, SmoothnessPrior, positive_part};
use super::quadtree::{Patch, Quadtree, SparseRow, VERTICES, quarter_matrix, vertex_of};
use super::reconcile::{News, spread};
use crate::basis::cubic;
use crate::hierarchy::{Cell, Hierarchy, MAX_LEVEL};
use crate::surface::{Jet, Surface, jet_of, leaf_weights};
use nalgebra::DMatrix;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use std::collections::HashMap;
use std::sync::Arc;

/// What the unknowns of a patch are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StateLayout {
    /// The third coordinate of every vertex; the first two stay those of the initial surface. 49 unknowns:
    /// heights over a plan.
    Height,
    /// Three coordinates that share one covariance of 49 unknowns: positions whose noise has no direction.
    Isotropic,
    /// Three coordinates that share one covariance of 49 unknowns: what is read along the surface's normal,
    /// where parameters are foot points. The mean takes every reading exactly; the covariance takes it as one
    /// of all directions, which is right along the normal (as far as the normal is the same all over a patch)
    /// and says nothing of motion within the surface, which only renames its points.
    Normal,
    /// 147 unknowns: every reading there is. Nine times the memory and work.
    Full,
}

impl StateLayout {
    /// Unknowns of a patch, and columns of its mean.
    pub(super) fn size(self) -> (usize, usize) {
        match self {
            Self::Height => (VERTICES, 1),
            Self::Isotropic | Self::Normal => (VERTICES, 3),
            Self::Full => (3 * VERTICES, 1),
        }
    }
}

/// How a patch filter works.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchFilterOptions {
    /// What the unknowns are.
    pub layout: StateLayout,
    /// How often a base patch may be divided at most.
    pub maximum_depth: u8,
    /// Neighbours are not told what lowers a variance by less than this share.
    pub least_gain: f64,
    /// Whether a patch that may yet be divided reckons with the detail that it cannot hold: positions then
    /// have the prior's variance of that detail besides their own. Without it a patch takes detail for shape
    /// of its own and may be too sure of it, and so may the children that inherit it; with it, patches that
    /// are never divided lose what the prior wrongly expects of detail. The global filter over the same cells
    /// expects none.
    pub expect_detail: bool,
    /// Whether normals and curvatures are linearised at the initial surface and not at the estimate. Then
    /// every equation is linear, and the order of readings makes no difference at all; but the surface must
    /// begin near its place.
    pub linearize_at_initial: bool,
}

impl Default for PatchFilterOptions {
    /// Isotropic, depth 3, a least gain of a millionth; detail is not expected, as the global filter does
    /// not.
    fn default() -> Self {
        Self {
            layout: StateLayout::Isotropic,
            maximum_depth: 3,
            least_gain: 1e-6,
            expect_detail: false,
            linearize_at_initial: false,
        }
    }
}

/// What a reading said to its patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchUpdate {
    /// The patch that took it in.
    pub patch: Patch,
    /// Scalar equations.
    pub equations: usize,
    /// `Σ e²/S`, distributed as χ² with as many degrees of freedom as equations where the filter is
    /// consistent.
    pub normalized_squared: f64,
    /// Whether it was taken in as it is: one beyond the gate is left out, or taken with doubt where most of
    /// its neighbours are beyond it, too.
    pub within_gate: bool,
}

/// A patch that was divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Subdivision {
    /// Which.
    pub patch: Patch,
    /// Why.
    pub reason: SubdivisionReason,
}

/// One patch and all that is kept of it.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub belief: PatchBelief,
    /// What it believed before the readings that its neighbours have not heard of; none where there are none.
    pub before: Option<PatchBelief>,
    /// Prior covariance of one coordinate.
    pub prior: DMatrix<f64>,
    pub innovations: [InnovationSum; 16],
    /// Coefficients of the initial surface.
    pub initial: Vec<[f64; 3]>,
}

/// A surface as a quadtree of patches, each filtered by itself and reconciled with its neighbours.
///
/// # Examples
/// ```
/// use planish_spline::{Hierarchy, PatchFilter, PatchFilterOptions, Shape, SmoothnessPrior, StateLayout, SurfaceReading, parameter_plane};
/// # fn main() -> planish_spline::Result<()> {
/// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?.into();
/// let plane = parameter_plane(&space)?;
/// let prior = SmoothnessPrior { weight: 1.0, hold: 0.01 };
/// let options = PatchFilterOptions { layout: StateLayout::Height, ..PatchFilterOptions::default() };
/// let mut filter = PatchFilter::new(&plane, &plane, prior, options)?;
/// let before = filter.variance_along(2.0, 2.0, [0.0, 0.0, 1.0]);
/// filter.observe(&SurfaceReading::Position { parameters: [2.0, 2.0], point: [2.0, 2.0, 0.3], variance: 1e-4 })?;
/// assert!((filter.surface()?.point(2.0, 2.0)[2] - 0.3).abs() < 0.01);
/// assert!(filter.variance_along(2.0, 2.0, [0.0, 0.0, 1.0]) < 1e-3 * before);
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
    /// By depth: how much of the prior's variance only deeper patches can hold.
    pub(super) detail_variance: Vec<f64>,
    pub(super) workspace: Workspace,
    pub(super) scalars: [ScalarReading; 3],
}

impl PatchFilter {
    /// A filter whose mean is the initial surface.
    ///
    /// Smoothness is meant in the metric of `metric`, which has the initial surface's space:
    /// [`super::parameter_plane`] for the plain parametric energy of a sheet. Cost: the factor of the prior
    /// over the base grid.
    ///
    /// # Errors
    /// `Input` when the base grid is no multiple of 4 × 4 cells, is refined, or differs from that of the
    /// metric, or when the prior is not proper.
    pub fn new(
        initial: &Surface,
        metric: &Surface,
        prior: SmoothnessPrior,
        options: PatchFilterOptions,
    ) -> Result<Self> {
        if initial.space().levels() > 1 {
            return Err(Error::input(
                "a patch filter starts from an unrefined surface; it refines by itself",
            ));
        }
        Self::begin(initial, initial, metric, prior, options, None)
    }

    /// A filter that goes on from a first fit: its mean is that surface, its covariance the inverse of
    /// `information`.
    ///
    /// The surface's cells come in whole patches ([`super::patch_hierarchy`]), over the base grid of
    /// `metric`; `information` is that of one coordinate over its nodes, prior and first readings together.
    /// Those readings must not come again. Every patch gets its part of the one joint belief, so neighbours
    /// agree and have nothing to tell each other. Cost: one factor, and a solve for 49 columns a patch.
    ///
    /// # Errors
    /// As for [`Self::new`], and `Input` for cells that are no whole patches or deeper than the maximum
    /// depth, and heights, whose plan would be that of the metric; `Undetermined` when the information is
    /// singular.
    pub fn from_first_fit(
        fitted: &Surface,
        metric: &Surface,
        prior: SmoothnessPrior,
        information: &BlockInformation,
        options: PatchFilterOptions,
    ) -> Result<Self> {
        if options.layout == StateLayout::Height {
            return Err(Error::input(
                "a first fit has three coordinates: needed another layout than heights",
            ));
        }
        if fitted.space().levels() > usize::from(options.maximum_depth) + 1 {
            return Err(Error::input(format!(
                "the first fit has {} levels, more than a maximum depth of {} allows",
                fitted.space().levels(),
                options.maximum_depth
            )));
        }
        Self::begin(fitted, metric, metric, prior, options, Some(information))
    }

    /// `fitted` is the mean; `initial` the surface over the base grid whose plan heights keep.
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
        if metric.space().shape() != space.shape()
            || metric.space().base() != space.base()
            || metric.space().levels() > 1
        {
            return Err(Error::input(
                "the surface whose metric is used needs the initial surface's base grid",
            ));
        }
        if usize::from(options.maximum_depth) > MAX_LEVEL {
            return Err(Error::input(format!(
                "a depth of {} is beyond {MAX_LEVEL}, the most there is",
                options.maximum_depth
            )));
        }
        if !(0.0..1.0).contains(&options.least_gain) {
            return Err(Error::input(format!(
                "the least gain is a share from 0 to below 1, got {}",
                options.least_gain
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

    /// The same filter with the full layout, which takes every kind of reading: what was learned stays,
    /// coordinates begin to be told apart.
    ///
    /// # Errors
    /// `Unsupported` for a filter of heights, whose plan has no covariance.
    pub fn with_full_layout(mut self) -> Result<Self> {
        match self.options.layout {
            StateLayout::Full => return Ok(self),
            StateLayout::Isotropic => {}
            StateLayout::Normal => {
                return Err(Error::unsupported(
                    "a filter along normals knows nothing of the other directions: begin with the isotropic \
                     or the full layout",
                ));
            }
            StateLayout::Height => {
                return Err(Error::unsupported(
                    "a filter of heights takes its plan as known: begin with the isotropic or the full \
                     layout",
                ));
            }
        }
        let widen = |belief: &PatchBelief| {
            // Row-major vertices by coordinates are the unknowns of the full layout, in their order.
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
    pub fn patches(&self) -> &[Patch] {
        &self.quadtree.patches
    }

    /// The hierarchy whose leaf cells the patches are made of.
    #[must_use]
    pub fn space(&self) -> &Arc<Hierarchy> {
        &self.quadtree.space
    }

    /// The belief of a leaf patch, by its place in [`Self::patches`].
    #[must_use]
    pub fn belief(&self, patch: usize) -> &PatchBelief {
        &self.members[patch].belief
    }

    /// How it works.
    #[must_use]
    pub fn options(&self) -> &PatchFilterOptions {
        &self.options
    }

    /// The prior.
    #[must_use]
    pub fn prior(&self) -> SmoothnessPrior {
        self.prior
    }

    /// Readings taken in so far.
    #[must_use]
    pub fn readings(&self) -> u64 {
        self.readings
    }

    /// Memory of means and covariances in bytes: it grows with the patches and not with the readings.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let of = |b: &PatchBelief| 8 * (b.mean().len() + b.covariance().len());
        self.members
            .iter()
            .map(|m| {
                of(&m.belief) + m.before.as_ref().map_or(0, of) + 8 * m.prior.len() + 24 * m.initial.len()
            })
            .sum()
    }

    /// Tells all patches what each has learned of its own since the last time, by the channel filter.
    ///
    /// Cost: for each patch with new readings and each that it has something to tell, about a hundred
    /// thousand multiply-adds; it does not depend on the number of readings.
    ///
    /// # Errors
    /// `Undetermined` when readings without noise contradict each other.
    pub fn reconcile(&mut self) -> Result<()> {
        let news: Vec<News> = self
            .members
            .iter_mut()
            .enumerate()
            .filter_map(|(patch, member)| {
                Some(News { patch, before: member.before.take()?, after: member.belief.clone() })
            })
            .collect();
        let mut beliefs: Vec<&mut PatchBelief> = self.members.iter_mut().map(|m| &mut m.belief).collect();
        spread(
            &self.quadtree,
            &mut beliefs,
            &news,
            self.options.layout == StateLayout::Full,
            self.options.least_gain,
        )
    }

    /// Divides the patches that the criteria find, where they may be divided; says which and why. Neighbours
    /// are reconciled first.
    ///
    /// # Errors
    /// As for [`Self::reconcile`].
    pub fn refine(&mut self, criteria: &SubdivisionCriteria) -> Result<Vec<Subdivision>> {
        self.reconcile()?;
        let deepest = self.options.maximum_depth;
        let mut reasons: Vec<Option<SubdivisionReason>> = (0..self.members.len())
            .map(|p| {
                let may = self.quadtree.patches[p].depth < deepest;
                may.then(|| self.reason(p, criteria)).flatten()
            })
            .collect();
        // A division makes three patches more; the strongest reasons go first where there is no room for all.
        let room = criteria.most_patches.saturating_sub(self.members.len()) / 3;
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
        self.divide_for(reasons)
    }

    /// Divides these patches, and those that grading needs; says which and why.
    ///
    /// # Errors
    /// `Input` for a patch that is no leaf, or has the maximum depth; else as for [`Self::reconcile`].
    pub fn divide(&mut self, patches: &[Patch]) -> Result<Vec<Subdivision>> {
        let mut reasons = vec![None; self.members.len()];
        for patch in patches {
            let at = self
                .quadtree
                .patches
                .binary_search(patch)
                .map_err(|_| Error::input(format!("{patch:?} is no leaf patch")))?;
            if patch.depth >= self.options.maximum_depth {
                return Err(Error::input(format!("{patch:?} has the maximum depth already")));
            }
            reasons[at] = Some(SubdivisionReason::Requested);
        }
        self.reconcile()?;
        self.divide_for(reasons)
    }

    /// Children inherit `α Σ αᵀ + Q` with all the readings in it. The other patches gain too: those beside
    /// them the detail that grading had forbidden, and all a little, because the energy projection of new
    /// detail on coarse vertices reaches beyond it.
    fn divide_for(&mut self, reasons: Vec<Option<SubdivisionReason>>) -> Result<Vec<Subdivision>> {
        let marked: Vec<bool> = reasons.iter().map(Option::is_some).collect();
        if !marked.contains(&true) {
            return Ok(Vec::new());
        }
        let quadtree = self.quadtree.divided(&marked)?;
        let priors = PatchCovariances::of_prior(&quadtree, &self.metric, self.prior.hold)?;
        let old: HashMap<Patch, usize> = (0..).zip(&self.quadtree.patches).map(|(n, &p)| (p, n)).collect();
        let initial = self.initial.refined(Arc::clone(&quadtree.space))?;
        let layout = self.options.layout;
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
                let detail = positive_part(&prior - &alpha * &from.prior * alpha.transpose());
                let carry = expanded(&alpha, layout);
                let covariance =
                    &carry * from.belief.covariance_matrix() * carry.transpose() + expanded(&detail, layout);
                Ok(Member {
                    belief: PatchBelief::from_matrices(&(carry * from.belief.mean_matrix()), &covariance),
                    before: None,
                    prior,
                    innovations: known.map_or([InnovationSum::default(); 16], |_| from.innovations),
                    initial: quadtree.coefficients(p, |leaf| *initial.leaf_coefficients(leaf)),
                })
            })
            .collect::<Result<Vec<Member>>>()?;
        let kept: std::collections::HashSet<Patch> = quadtree.patches.iter().copied().collect();
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

    /// Gaussian curvature and its σ at the middles of the sixteen cells of a leaf patch; none where the
    /// surface is singular.
    #[must_use]
    pub fn curvatures(&self, patch: usize) -> Option<[[f64; 2]; 16]> {
        let h = f64::from(1_u32 << self.quadtree.patches[patch].depth);
        let orders = [[1, 0], [0, 1], [2, 0], [1, 1], [0, 2]];
        let basis = cubic(0.5);
        let mut out = [[0.0; 2]; 16];
        for (cell, to) in out.iter_mut().enumerate() {
            let jet = jet_of(&self.cell_coefficients(patch, cell), h, 0.5, 0.5);
            let (value, gradient) = gaussian_curvature(&jet)?;
            // dK = Σ_o ∂K/∂S_o · Σ_k c_ok P_k
            let mut form = [[0.0; 3]; 16];
            for (order, slope) in orders.iter().zip(&gradient) {
                let scale = h.powi((order[0] + order[1]) as i32);
                for (k, f) in form.iter_mut().enumerate() {
                    let w = scale * basis[order[0]][k % 4] * basis[order[1]][k / 4];
                    for d in 0..3 {
                        f[d] += w * slope[d];
                    }
                }
            }
            *to = [value, self.variance_of_form(patch, cell, &form).sqrt()];
        }
        Some(out)
    }

    /// The variance of `direction · S(u, v)`, as the patch at `(u, v)` knows it.
    #[must_use]
    pub fn variance_along(&self, u: f64, v: f64, direction: [f64; 3]) -> f64 {
        let (leaf, [s, t]) = self.quadtree.space.locate(u, v);
        let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
        let form = leaf_weights(s, t).map(|w| direction.map(|a| w * a));
        self.variance_of_form(patch as usize, usize::from(cell), &form)
    }

    /// The covariance that the sixteen coefficients of a leaf cell have, `16 × 16`, the same for every
    /// coordinate that is an unknown; none in the full layout, where coordinates differ.
    #[must_use]
    pub fn leaf_covariance(&self, leaf: usize) -> Option<Vec<f64>> {
        if self.options.layout == StateLayout::Full {
            return None;
        }
        let &(patch, cell) = self.quadtree.patch_of_leaf.get(leaf)?;
        let belief = &self.members[patch as usize].belief;
        let at = |k: usize| vertex_of(usize::from(cell), k);
        let entry = |k: usize| belief.covariance()[at(k / 16) * VERTICES + at(k % 16)];
        Some((0..256).map(entry).collect())
    }

    /// How many leaf patches of the maximum depth the criteria would have divided further.
    #[must_use]
    pub fn held_back(&self, criteria: &SubdivisionCriteria) -> usize {
        let deepest = self.options.maximum_depth;
        (0..self.members.len())
            .filter(|&p| self.quadtree.patches[p].depth >= deepest && self.reason(p, criteria).is_some())
            .count()
    }

    fn reason(&self, patch: usize, criteria: &SubdivisionCriteria) -> Option<SubdivisionReason> {
        criteria.reason(&self.members[patch].innovations, || self.curvatures(patch))
    }

    /// σ of the surface along its normal at `(u, v)`; none where it has no normal.
    #[must_use]
    pub fn sigma(&self, u: f64, v: f64) -> Option<f64> {
        let normal = self.jet(u, v).normal()?;
        Some(self.variance_along(u, v, normal).sqrt())
    }

    /// Point and derivatives at `(u, v)`, as the patch there knows them.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        let (leaf, [s, t]) = self.quadtree.space.locate(u, v);
        let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
        let side = self.quadtree.space.leaves()[leaf].side();
        jet_of(&self.cell_coefficients(patch as usize, usize::from(cell)), 1.0 / side, s, t)
    }

    /// The surface of all patches: copies of a vertex are weighed by one over their variances, so it is
    /// continuous to the second derivative at any time, reconciled or not.
    ///
    /// # Errors
    /// `Input` when a vertex is not finite.
    pub fn surface(&self) -> Result<Surface> {
        let mut sums: HashMap<Cell, [[f64; 2]; 3]> = HashMap::new();
        for (p, patch) in self.quadtree.patches.iter().enumerate() {
            for vertex in 0..VERTICES {
                let sum = sums.entry(self.quadtree.function(*patch, vertex)).or_default();
                let point = self.vertex(p, vertex);
                for d in 0..3 {
                    let weight = 1.0 / self.vertex_variance(p, vertex, d).max(1e-200);
                    sum[d][0] += weight;
                    sum[d][1] += weight * point[d];
                }
            }
        }
        let space = &self.quadtree.space;
        let vertices = space.vertices_from(|cell| {
            let (patch, number) = self.quadtree.patch_of_leaf[space.leaf_over(cell).unwrap_or(0)];
            let patch = self.quadtree.patches[patch as usize];
            std::array::from_fn(|k| {
                let function = self.quadtree.function(patch, vertex_of(usize::from(number), k));
                sums.get(&function).map_or([0.0; 3], |s| s.map(|[w, wx]| wx / w))
            })
        });
        Surface::new(Arc::clone(space), vertices)
    }

    /// A vertex of a patch as it is known.
    fn vertex(&self, patch: usize, vertex: usize) -> [f64; 3] {
        let member = &self.members[patch];
        let mean = member.belief.mean();
        match self.options.layout {
            StateLayout::Height => {
                let at = member.initial[vertex];
                [at[0], at[1], mean[vertex]]
            }
            _ => [mean[3 * vertex], mean[3 * vertex + 1], mean[3 * vertex + 2]],
        }
    }

    fn vertex_variance(&self, patch: usize, vertex: usize, coordinate: usize) -> f64 {
        let belief = &self.members[patch].belief;
        let at = match self.options.layout {
            StateLayout::Full => 3 * vertex + coordinate,
            _ => vertex,
        };
        belief.covariance()[at * belief.dimension() + at]
    }

    pub(super) fn cell_coefficients(&self, patch: usize, cell: usize) -> [[f64; 3]; 16] {
        std::array::from_fn(|k| self.vertex(patch, vertex_of(cell, k)))
    }

    /// The variance of `Σ_k f_k · P_k` over the sixteen coefficients of a cell.
    fn variance_of_form(&self, patch: usize, cell: usize, form: &[[f64; 3]; 16]) -> f64 {
        let belief = &self.members[patch].belief;
        let of = |d: usize| -> SparseRow {
            form.iter().enumerate().map(|(k, f)| (vertex_of(cell, k) as u16, f[d])).collect()
        };
        let variance = match self.options.layout {
            StateLayout::Height => belief.variance_of(&of(2)),
            StateLayout::Isotropic | StateLayout::Normal => (0..3).map(|d| belief.variance_of(&of(d))).sum(),
            StateLayout::Full => {
                let row: SparseRow = (0..3)
                    .flat_map(|d| of(usize::from(d)).into_iter().map(move |(k, w)| (3 * k + d, w)))
                    .collect();
                belief.variance_of(&row)
            }
        };
        variance.max(0.0)
    }
}

/// A matrix over vertices as one over the unknowns of a layout.
fn expanded(matrix: &DMatrix<f64>, layout: StateLayout) -> DMatrix<f64> {
    match layout {
        StateLayout::Full => matrix.kronecker(&DMatrix::<f64>::identity(3, 3)),
        _ => matrix.clone(),
    }
}

/// For every depth the prior's variance, of one coordinate at a point, that patches of that depth cannot hold
/// and those of the maximum depth can: a mean over the first base patch.
///
/// It is measured where that patch is divided once; with every level it falls to a quarter, as thin plates in
/// the plane have it.
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
    marked[0] = true;
    let fine = coarse.divided(&marked)?;
    let (before, after) = (
        PatchCovariances::of_prior(&coarse, metric, prior.hold)?.covariance(&coarse, 0)?,
        PatchCovariances::of_prior(&fine, metric, prior.hold)?,
    );
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
        below[depth] = below[depth + 1] + first * 0.25_f64.powi(depth as i32);
    }
    Ok(below)
}
