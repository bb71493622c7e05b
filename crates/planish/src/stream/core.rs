//! A patch filter over a surface whose parameters are found: foot point, equation along the normal, gate, and
//! when to look for what to divide.
//!
//! Comes in: readings in the world frame, one at a time. Goes out: whether each was taken in. Memory is that
//! of the patches.
//!
//! Not guaranteed: that a reading is searched for anew after the surface has moved under it; a stream sees
//! every reading once.

use crate::fit::engine::{LEAST_COSINE, expected_lift};
use crate::fit::{RefineBy, RefinementLog, Rejection};
use planish_estimate::Result;
use planish_estimate::vector3::dot;
use planish_sense::variance_along;
use planish_spline::{
    FootPoint, FootPointSearch, PatchFilter, ProjectionOptions, SubdivisionCriteria, Surface, SurfaceReading,
    symmetric_eigen,
};

/// The first look for what to divide comes after so many readings, every other after twice as many.
const FIRST_LOOK: u64 = 256;
/// Squares along each side of a base cell in which it is kept whether anything was measured.
const MARKS: usize = 4;
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
            max_patches: self.max_coefficients / VERTICES_PER_PATCH,
            ..usual
        }
    }
}

/// A filter that finds the parameters of its readings.
pub(crate) struct Core {
    pub filter: PatchFilter,
    search: FootPointSearch,
    rules: Rules,
    /// How many readings the filter has when it is time to look for what to divide.
    next_look: u64,
    /// Where something was measured, over the base grid.
    marks: Vec<bool>,
    /// Levels of subdivision that the filter's base grid has already.
    pub base_level: usize,
    pub log: RefinementLog,
}

impl Core {
    /// A filter over its own surface; `base_level` is the level of its base grid.
    pub(crate) fn new(filter: PatchFilter, base_level: usize, rules: Rules) -> Result<Self> {
        let search = search_of(&filter.surface()?)?;
        let cells: usize = filter.space().base().iter().product();
        let mut made = Self {
            next_look: 0,
            marks: vec![false; cells * MARKS * MARKS],
            filter,
            search,
            rules,
            base_level,
            log: RefinementLog::default(),
        };
        made.plan_look();
        Ok(made)
    }

    /// The next look follows from the number of readings alone, so that a resumed filter looks when it would
    /// have looked.
    fn plan_look(&mut self) {
        self.next_look = FIRST_LOOK.max((self.filter.readings() + 1).next_power_of_two());
    }

    /// Marks a place as measured.
    pub(crate) fn mark(&mut self, [u, v]: [f64; 2]) {
        let [columns, rows] = self.filter.space().base().map(|n| n * MARKS);
        let at = |x: f64, n: usize| ((x * MARKS as f64) as usize).min(n - 1);
        self.marks[at(v, rows) * columns + at(u, columns)] = true;
    }

    /// For each leaf whether anything was measured in it.
    pub(crate) fn measured(&self) -> Vec<bool> {
        let space = self.filter.space();
        let [columns, rows] = space.base().map(|n| n * MARKS);
        (space.leaves().iter())
            .map(|cell| {
                let side = cell.side() * MARKS as f64;
                let range = |k: u32, n: usize| {
                    let first = (f64::from(k) * side) as usize;
                    first..((f64::from(k + 1) * side).ceil() as usize).min(n)
                };
                range(cell.j, rows).any(|j| range(cell.i, columns).any(|i| self.marks[j * columns + i]))
            })
            .collect()
    }

    /// Tells neighbours what is new, and follows the surface with the search for foot points.
    pub(crate) fn reconcile(&mut self) -> Result<Surface> {
        self.filter.reconcile()?;
        let surface = self.filter.surface()?;
        self.search = search_of(&surface)?;
        Ok(surface)
    }

    /// The foot point of a place on the surface as it is known.
    pub(crate) fn foot_point(&self, at: [f64; 3], facing: [f64; 3]) -> FootPoint {
        let start = self.search.nearest(at, facing);
        self.filter.project(at, start, &ProjectionOptions::default())
    }

    /// Takes a reading in, or says why not.
    ///
    /// # Errors
    /// `Input` for numbers that are none; what dividing reports.
    pub(crate) fn take(&mut self, reading: &Incoming) -> Result<Option<Rejection>> {
        let foot = self.foot_point(reading.at, reading.facing);
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
            What::Normal(normal, variance) => {
                SurfaceReading::Normal { parameters, normal, sigma_rad: variance.sqrt() }
            }
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
        // What is beyond the gate, but taken in as shape that is missing, is no outlier.
        if !update.within_gate && update.normalized_squared == 0.0 {
            return Ok(Some(Rejection::Outlier));
        }
        self.mark(parameters);
        if self.filter.readings() >= self.next_look {
            self.look()?;
        }
        Ok(None)
    }

    /// Tells neighbours what is new, and divides where the rules say so.
    fn look(&mut self) -> Result<()> {
        let divided = self.filter.refine(&self.rules.criteria())?;
        self.log.add_patches(self.base_level, &divided);
        self.reconcile()?;
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
