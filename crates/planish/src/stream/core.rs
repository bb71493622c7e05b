//! A patch filter over a surface whose parameters are found: foot point, equation along the normal, gate, and when to look for what to divide.
//!
//! Comes in: readings in the world frame, one at a time. Goes out: whether each was taken in. Memory is that of the patches.
//!
//! Not guaranteed: that a reading is searched for anew after the surface has moved under it; a stream sees every reading once.

use crate::fit::engine::{LEAST_COSINE, expected_lift};
use crate::fit::{RefineBy, RefinementLog, Rejection};
use planish_estimate::Result;
use planish_estimate::vector3::dot;
use planish_sense::variance_along;
use planish_spline::{
    FootPointSearch, PatchFilter, ProjectionOptions, SubdivisionCriteria, Surface, SurfaceReading, symmetric_eigen,
};

/// A look for what to divide comes after so many readings a patch at least, and after this share of all readings before.
const READINGS_PER_PATCH: u64 = 32;
const LEAST_READINGS: u64 = 256;
const SHARE_OF_EARLIER: u64 = 1;
/// Control vertices that a patch adds to a surface, about: its cells.
pub(crate) const VERTICES_PER_PATCH: usize = 16;

/// A reading in the world frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Incoming {
    /// Where it was taken.
    pub at: [f64; 3],
    /// A unit vector towards the side that was seen; zero where that is not known.
    pub facing: [f64; 3],
    /// What was read.
    pub what: What,
}

/// What a reading says.
#[derive(Debug, Clone, Copy)]
pub(crate) enum What {
    /// Its place, with this covariance `[xx, xy, xz, yy, yz, zz]`.
    Position([f64; 6]),
    /// A unit normal, and the variance of its tilt along either tangent.
    Normal([f64; 3], f64),
    /// A curvature tensor, and the variance of its diagonal components; of the others half of it.
    Curvature([f64; 6], f64),
}

/// When patches are divided and readings left out.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules {
    pub gate: f64,
    pub refine_by: RefineBy,
    pub max_coefficients: usize,
}

impl Rules {
    fn criteria(self) -> SubdivisionCriteria {
        let usual = SubdivisionCriteria::default();
        SubdivisionCriteria {
            curvature_variation: usual.curvature_variation.filter(|_| self.refine_by.curvature()),
            chi_square: usual.chi_square.filter(|_| self.refine_by.residuals()),
            most_patches: self.max_coefficients / VERTICES_PER_PATCH,
            ..usual
        }
    }
}

/// A filter that finds the parameters of its readings.
pub(crate) struct Core {
    pub filter: PatchFilter,
    search: FootPointSearch,
    rules: Rules,
    /// Readings of all kinds so far, and how many when to look for what to divide.
    seen: u64,
    next_look: u64,
    /// Levels of subdivision that the filter's base grid has already.
    pub base_level: usize,
    pub log: RefinementLog,
}

impl Core {
    /// A filter over its own surface; `base_level` is the level of its base grid.
    pub(crate) fn new(filter: PatchFilter, base_level: usize, rules: Rules) -> Result<Self> {
        let search = search_of(&filter.surface()?)?;
        let mut made = Self {
            seen: filter.readings(),
            next_look: 0,
            filter,
            search,
            rules,
            base_level,
            log: RefinementLog::default(),
        };
        made.plan_look();
        Ok(made)
    }

    /// How a resumed filter goes on as if it had never stopped: what is not in the filter itself.
    pub(crate) fn schedule(&self) -> [u64; 2] {
        [self.seen, self.next_look]
    }

    pub(crate) fn resume_schedule(&mut self, [seen, next_look]: [u64; 2]) {
        (self.seen, self.next_look) = (seen, next_look);
    }

    fn plan_look(&mut self) {
        let patches = self.filter.patches().len() as u64;
        let wait = (READINGS_PER_PATCH * patches).max(LEAST_READINGS);
        self.next_look = self.seen + wait.max(self.seen / SHARE_OF_EARLIER);
    }

    /// Takes a reading in, or says why not.
    ///
    /// # Errors
    /// `Input` for numbers that are none; what dividing reports.
    pub(crate) fn take(&mut self, reading: &Incoming) -> Result<Option<Rejection>> {
        let start = self.search.nearest(reading.at, reading.facing);
        let foot = self.filter.project(reading.at, start, &ProjectionOptions::default());
        let known = dot(reading.facing, reading.facing) > 0.5;
        if dot(foot.normal, foot.normal) < 0.5 || (known && dot(reading.facing, foot.normal) < LEAST_COSINE) {
            return Ok(Some(Rejection::NormalMismatch));
        }
        if foot.at_border {
            return Ok(Some(Rejection::BeyondBorder));
        }
        let parameters = self.filter.space().parameters(foot.leaf as usize, foot.local);
        let equation = match reading.what {
            What::Position(covariance) => {
                let height = foot.height - expected_lift(&foot.jet, &covariance, 1.0);
                SurfaceReading::Along {
                    parameters,
                    direction: foot.normal,
                    value: dot(foot.normal, foot.jet.point) + height,
                    variance: variance_along(&covariance, foot.normal),
                }
            }
            What::Normal(normal, variance) => SurfaceReading::Normal {
                parameters,
                normal,
                sigma_rad: variance.sqrt(),
            },
            What::Curvature(tensor, variance) => {
                let (mut directions, mut principal) = symmetric_eigen(tensor);
                // The third direction is the normal, along which a curvature tensor is nothing.
                let least = (0..3).min_by(|&a, &b| principal[a].abs().total_cmp(&principal[b].abs()));
                let last = least.unwrap_or(2);
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
        self.seen += 1;
        if self.seen >= self.next_look {
            self.look()?;
        }
        // What is beyond the gate, but taken in as shape that is missing, is no outlier.
        let taken = update.within_gate || update.normalized_squared > 0.0;
        Ok((!taken).then_some(Rejection::Outlier))
    }

    /// Tells neighbours what is new, and divides where the rules say so.
    fn look(&mut self) -> Result<()> {
        let divided = self.filter.refine(&self.rules.criteria())?;
        self.log.add_patches(self.base_level, &divided);
        self.search = search_of(&self.filter.surface()?)?;
        self.plan_look();
        Ok(())
    }

    /// How many patches of the deepest level would be divided if they could.
    pub(crate) fn held_back(&self) -> usize {
        self.filter.held_back(&self.rules.criteria())
    }
}

fn search_of(surface: &Surface) -> Result<FootPointSearch> {
    FootPointSearch::new(surface, 2, 0.1 * crate::fit::extent_of(surface))
}
