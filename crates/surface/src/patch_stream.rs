//! The patch filter for readings without parameters: foot point, equation along the normal, gate,
//! subdivision.
//!
//! Input: readings in the world frame, one at a time. Output: whether each was accepted. Memory is that of
//! the patches.
//!
//! Not guaranteed: that a reading keeps its best foot point. The surface moves later, but every reading is
//! used once.

use crate::observe::{MIN_COSINE, RejectionCause, expected_lift, surface_extent};
use crate::subdivision::{RefineBy, RefinementLog};
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::Result;
use planish_spline::{
    FootPoint, FootPointSearch, PatchFilter, ProjectionOptions, SubdivisionCriteria, Surface, SurfaceReading,
};

/// Number of readings after which patches are first considered for division; afterwards at each doubling.
///
/// At a doubling there are as many new readings as old ones, and a resumed stream knows the moment from the
/// number alone (decision 0025).
const FIRST_REFINEMENT: u64 = 256;
/// Squares along each side of a base cell. Each has a mark that says whether anything was measured in it.
///
/// Patches are divided while readings arrive, so the record cannot be kept by leaf. More squares follow the
/// border of the measured part more closely.
const MARKS: usize = 4;
/// Control vertices that a patch adds to a surface, approximately: one for each of its cells.
pub(crate) const VERTICES_PER_PATCH: usize = 16;

/// A reading in the world frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IncomingReading {
    /// Position at which it was taken.
    pub at: DVec3,
    /// Unit vector towards the side that was seen; zero if unknown.
    pub facing: DVec3,
    /// The value.
    pub value: ReadingValue,
}

/// The value of a reading.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ReadingValue {
    /// A position, with its covariance.
    Position(SymmetricMatrix3),
    /// A unit normal, and the variance of its tilt along either tangent.
    Normal(DVec3, f64),
    /// A curvature tensor, and the variance of its diagonal components; off-diagonal ones have half of it.
    Curvature(SymmetricMatrix3, f64),
}

/// Limits by which patches are divided and readings rejected.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PatchRules {
    pub gate: f64,
    pub refine_by: RefineBy,
    pub max_coefficients: usize,
}

impl PatchRules {
    fn criteria(self) -> SubdivisionCriteria {
        let defaults = SubdivisionCriteria::default();
        SubdivisionCriteria {
            curvature_variation: defaults.curvature_variation.filter(|_| self.refine_by.curvature()),
            chi_square: defaults.chi_square.filter(|_| self.refine_by.residuals()),
            max_patches: self.max_coefficients / VERTICES_PER_PATCH,
            ..defaults
        }
    }
}

/// A patch filter that finds the parameters of its readings.
pub(crate) struct StreamingFilter {
    pub filter: PatchFilter,
    search: FootPointSearch,
    rules: PatchRules,
    /// Number of readings at which patches are next considered for division.
    next_refinement: u64,
    /// Measured squares over the base grid.
    marks: Vec<bool>,
    /// Level of the filter's base grid.
    pub base_level: usize,
    pub log: RefinementLog,
}

impl StreamingFilter {
    /// A filter over its own surface; `base_level` is the level of its base grid.
    pub(crate) fn new(filter: PatchFilter, base_level: usize, rules: PatchRules) -> Result<Self> {
        let search = search_of(&filter.surface()?)?;
        let cells: usize = filter.space().base().iter().product();
        let mut made = Self {
            next_refinement: 0,
            marks: vec![false; cells * MARKS * MARKS],
            filter,
            search,
            rules,
            base_level,
            log: RefinementLog::default(),
        };
        made.plan_refinement();
        Ok(made)
    }

    /// The next refinement depends on the number of readings alone, so that a resumed filter refines at the
    /// same moments as one without a pause.
    fn plan_refinement(&mut self) {
        self.next_refinement = FIRST_REFINEMENT.max((self.filter.readings() + 1).next_power_of_two());
    }

    /// Marks the square around the parameters as measured.
    pub(crate) fn mark(&mut self, [u, v]: [f64; 2]) {
        let [columns, rows] = self.filter.space().base().map(|n| n * MARKS);
        // The far end of the domain belongs to the last square.
        let at = |x: f64, n: usize| ((x * MARKS as f64) as usize).min(n - 1);
        self.marks[at(v, rows) * columns + at(u, columns)] = true;
    }

    /// For each leaf, true if anything was measured in it.
    pub(crate) fn measured(&self) -> Vec<bool> {
        let space = self.filter.space();
        let [columns, rows] = space.base().map(|n| n * MARKS);
        (space.leaves().iter())
            .map(|cell| {
                // A leaf smaller than a square shares its mark; a larger one is measured if any of its
                // squares is.
                let side = cell.side() * MARKS as f64;
                let range = |k: u32, n: usize| {
                    let first = (f64::from(k) * side) as usize;
                    first..((f64::from(k + 1) * side).ceil() as usize).min(n)
                };
                range(cell.j, rows).any(|j| range(cell.i, columns).any(|i| self.marks[j * columns + i]))
            })
            .collect()
    }

    /// Reconciles neighbouring patches and rebuilds the search for foot points.
    pub(crate) fn reconcile(&mut self) -> Result<Surface> {
        self.filter.reconcile()?;
        let surface = self.filter.surface()?;
        self.search = search_of(&surface)?;
        Ok(surface)
    }

    /// The foot point of a position on the current surface.
    pub(crate) fn foot_point(&self, at: DVec3, facing: DVec3) -> FootPoint {
        let start = self.search.nearest(at, facing);
        self.filter.project(at, start, &ProjectionOptions::default())
    }

    /// Filters a reading; returns why it was rejected, if it was.
    ///
    /// # Errors
    /// `Input` for numbers that are not finite; what dividing reports.
    pub(crate) fn filter_reading(&mut self, reading: &IncomingReading) -> Result<Option<RejectionCause>> {
        let foot = self.foot_point(reading.at, reading.facing);
        // A unit vector or zero: zero means that the side is unknown.
        let known = reading.facing.length_squared() > 0.5;
        if foot.normal.length_squared() < 0.5 || (known && reading.facing.dot(foot.normal) < MIN_COSINE) {
            return Ok(Some(RejectionCause::NormalMismatch));
        }
        if foot.at_border {
            return Ok(Some(RejectionCause::BeyondBorder));
        }
        let parameters = self.filter.space().parameters(foot.leaf as usize, foot.local);
        let equation = match reading.value {
            ReadingValue::Position(covariance) => {
                // Where σ was estimated, the caller has scaled the covariance already.
                let height = foot.height - expected_lift(&foot.jet, &covariance, 1.0);
                SurfaceReading::Along {
                    parameters,
                    direction: foot.normal,
                    value: foot.normal.dot(foot.jet.point) + height,
                    variance: covariance.along(foot.normal),
                }
            }
            ReadingValue::Normal(normal, variance) => {
                SurfaceReading::Normal { parameters, normal, sigma_rad: variance.sqrt() }
            }
            ReadingValue::Curvature(tensor, variance) => {
                let (mut directions, mut principal) = tensor.eigen();
                // The third direction is the normal, along which a curvature tensor is zero.
                let smallest = (0..3).min_by(|&a, &b| principal[a].abs().total_cmp(&principal[b].abs()));
                let last = smallest.unwrap_or(2);
                directions.swap(last, 2);
                principal.swap(last, 2);
                SurfaceReading::Curvature {
                    parameters,
                    normal: foot.normal,
                    principal: [principal[0], principal[1]],
                    directions: [directions[0], directions[1]],
                    sigma: variance.sqrt(),
                }
            }
        };
        let update = self.filter.observe_within(&equation, self.rules.gate)?;
        // A reading beyond the gate that was accepted as missing shape is no outlier.
        if !update.within_gate && update.normalized_squared == 0.0 {
            return Ok(Some(RejectionCause::Outlier));
        }
        self.mark(parameters);
        if self.filter.readings() >= self.next_refinement {
            self.refine()?;
        }
        Ok(None)
    }

    /// Divides patches by the rules, then reconciles neighbours.
    fn refine(&mut self) -> Result<()> {
        let divided = self.filter.refine(&self.rules.criteria())?;
        self.log.add_patches(self.base_level, &divided);
        // Later foot points must be searched for on the divided patches.
        self.reconcile()?;
        self.plan_refinement();
        Ok(())
    }

    /// Number of patches at the deepest level that would be divided without the limit.
    pub(crate) fn held_back(&self) -> usize {
        self.filter.held_back(&self.rules.criteria())
    }
}

fn search_of(surface: &Surface) -> Result<FootPointSearch> {
    FootPointSearch::new(surface, 2, 0.1 * surface_extent(surface))
}
