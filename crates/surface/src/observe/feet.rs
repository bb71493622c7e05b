//! Foot points of readings on a surface: projection, residuals, and sums of their equations.

use super::observations::Observations;
use super::quantity::{Measured, Quantity};
use super::rejection::RejectionCause;
use crate::model::order_by_leaf;
use planish_core::{DVec3, SymmetricMatrix3};
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_spline::{
    DirectedSums, FootPointSearch, Jet, ProjectionOptions, Surface, SurfaceSystem, leaf_weights,
};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;

/// The state of a projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FootState {
    /// Usable.
    Good,
    /// The normals of scan and surface disagree.
    NormalMismatch,
    /// The foot is held at an open border.
    BeyondBorder,
}

/// The foot of a reading on a surface, with its residuals.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Foot {
    pub leaf: u32,
    pub state: FootState,
    pub local: [f64; 2],
    pub normal: DVec3,
    pub quantity: Quantity,
    /// Measured minus predicted value, component by component; all components have the same variance.
    ///
    /// For a position, the signed distance from the surface less the expected lift by tangential noise. For a
    /// normal, the tilts of the two tangents towards it. For a curvature, `11`, `√2·12` and `22` of the
    /// second fundamental form.
    pub(crate) residuals: [f64; 3],
    /// Stated variance of each residual; for a position `nᵀRn`.
    pub variance: f64,
}

/// Readings with their feet on a surface.
#[derive(Clone, Copy)]
pub(crate) struct ProjectedReadings<'a> {
    pub observations: &'a Observations,
    /// The readings that take part, by their index in `observations`.
    pub subset: &'a [u32],
    /// The foot of each of them.
    pub feet: &'a [Foot],
}

impl ProjectedReadings<'_> {
    /// The channel of foot `k`.
    pub(crate) fn channel(&self, k: usize) -> usize {
        self.observations.channel(self.subset[k] as usize)
    }
}

impl Foot {
    /// Signed distance of a position from the surface.
    #[inline]
    pub(crate) fn height(&self) -> f64 {
        self.residuals[0]
    }

    /// The residuals that the quantity has.
    #[inline]
    pub(crate) fn residuals(&self) -> &[f64] {
        &self.residuals[..self.quantity.rows()]
    }

    /// Largest absolute residual, and the sum of squares.
    #[inline]
    pub(crate) fn extremes(&self) -> (f64, f64) {
        self.residuals()
            .iter()
            .fold((0.0, 0.0), |(largest, squares): (f64, f64), r| (largest.max(r.abs()), squares + r * r))
    }

    /// The residuals of a normal or a curvature at this foot; none if the surface has no tangent plane there.
    pub(crate) fn directional(&self, surface: &Surface, measured: &Measured) -> Option<[f64; 3]> {
        let frame = surface.tangent_rows(self.leaf as usize, self.local)?;
        Some(match measured {
            Measured::Position => self.residuals,
            Measured::Normal(normal) => {
                let [a, b] = frame.tilt(*normal);
                [-a, -b, 0.0]
            }
            Measured::Curvature(tensor) => {
                let bend = frame.bend(tensor);
                std::array::from_fn(|r| CURVATURE_SCALE[r] * bend[r])
            }
        })
    }

    /// The rows of its equations: the change of each predicted component with the motion of the leaf's
    /// sixteen coefficients along the foot's normal.
    pub(crate) fn rows(&self, surface: &Surface, mut each: impl FnMut(usize, &[f64; 16])) {
        if self.quantity == Quantity::Position {
            each(0, &leaf_weights(self.local[0], self.local[1]));
            return;
        }
        let Some(rows) = surface.tangent_rows(self.leaf as usize, self.local) else {
            return;
        };
        match self.quantity {
            Quantity::Position => {}
            Quantity::Normal => (0..).zip(&rows.slopes).for_each(|(r, row)| each(r, row)),
            Quantity::Curvature => {
                for (r, row) in (0..).zip(&rows.bends_along_normals) {
                    each(r, &row.map(|c| CURVATURE_SCALE[r] * c));
                }
            }
        }
    }
}

/// The off-diagonal component of a symmetric tensor with isotropic noise has half the variance of the others.
const CURVATURE_SCALE: [f64; 3] = [1.0, SQRT_2, 1.0];

/// Smallest cosine between the normals of scan and surface. Points that differ by more than about 70° lie on
/// another side of the object.
pub(crate) const MIN_COSINE: f64 = 0.35;

/// Projects the readings in `subset` on the surface.
///
/// `at` holds the parameters of all observations. They are the start of each projection unless `search` finds
/// one, and its result afterwards. `factors` scale the stated variances of each channel. The expected lift by
/// tangential noise is subtracted from heights.
pub(crate) fn project(
    surface: &Surface,
    observations: &Observations,
    subset: &[u32],
    at: &mut [[f64; 2]],
    search: Option<&FootPointSearch>,
    factors: &[f64],
) -> Vec<Foot> {
    let space = surface.space();
    let options = ProjectionOptions::default();
    let mut feet: Vec<(Foot, [f64; 2])> = Vec::with_capacity(subset.len());
    let before = &*at;
    subset
        .par_iter()
        .with_min_len(512)
        .map(|&i| {
            let i = i as usize;
            let z = observations.readings.points[i];
            let scan_normal = observations.normal(i);
            // A foot is followed from its last parameters; a search is only needed for new readings.
            let start = search.map_or(before[i], |s| s.nearest(z, scan_normal));
            let foot = surface.project(z, start, &options);
            // A scan normal is a unit vector, or zero if the side is unknown.
            let has_normal = scan_normal.length_squared() > 0.5;
            let state = if has_normal && scan_normal.dot(foot.normal) < MIN_COSINE {
                FootState::NormalMismatch
            } else if foot.at_border {
                FootState::BeyondBorder
            } else {
                FootState::Good
            };
            let parameters = space.parameters(foot.leaf as usize, foot.local);
            let mut made = Foot {
                leaf: foot.leaf,
                state,
                local: foot.local,
                normal: foot.normal,
                quantity: observations.quantity(i),
                residuals: [0.0; 3],
                variance: observations.variance(i, foot.normal),
            };
            match observations.measured(i) {
                Measured::Position => {
                    let covariance = observations.covariance(i);
                    let factor = factors[observations.channel(i)];
                    made.residuals[0] = foot.height
                        - observations.scan_errors.bias_along(observations.readings.scan[i], z, foot.normal);
                    made.residuals[0] -= expected_lift(&foot.jet, &covariance, factor);
                }
                directional => match made.directional(surface, &directional) {
                    Some(residuals) => made.residuals = residuals,
                    // The surface has no tangent plane there, hence the reading has no equation: it takes no
                    // part.
                    None => made.state = FootState::NormalMismatch,
                },
            }
            (made, parameters)
        })
        .collect_into_vec(&mut feet);
    // Parameters are written after the parallel loop, which only reads them.
    for (&i, (_, parameters)) in subset.iter().zip(&feet) {
        at[i as usize] = *parameters;
    }
    feet.into_iter().map(|(foot, _)| foot).collect()
}

/// Mean distance `tr(II R_t)/2` by which noise along the tangent plane lifts a reading off a curved surface.
/// The covariance of the reading is `factor` times `covariance`.
pub(crate) fn expected_lift(jet: &Jet, covariance: &SymmetricMatrix3, factor: f64) -> f64 {
    let Some(bias) = jet.tangential_bias(covariance) else {
        return 0.0;
    };
    // The expansion holds for noise well below the radius of curvature; elsewhere it is bounded by σ/2.
    let sigma = (factor * covariance.trace() / 3.0).sqrt();
    (-factor * bias).clamp(-0.5 * sigma, 0.5 * sigma)
}

impl Foot {
    /// Why the reading is rejected, given its information; none if it is used.
    pub(crate) fn rejection(&self, information: f64) -> Option<RejectionCause> {
        match self.state {
            FootState::NormalMismatch => Some(RejectionCause::NormalMismatch),
            FootState::BeyondBorder => Some(RejectionCause::BeyondBorder),
            FootState::Good if information == 0.0 => Some(RejectionCause::Outlier),
            FootState::Good => None,
        }
    }
}

/// Indices into `feet` sorted by leaf, as `(start, order)`: leaf `l` has `order[start[l] .. start[l + 1]]`.
pub(crate) fn by_leaf(feet: &[Foot], leaves: usize) -> (Vec<u32>, Vec<u32>) {
    order_by_leaf(feet.iter().map(|foot| foot.leaf), leaves)
}

/// Data information of projected readings, each with its own information; zero excludes it.
pub(crate) fn accumulate(
    system: &SurfaceSystem,
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
) -> Result<BlockInformation> {
    let (start, order) = by_leaf(feet, system.space().leaves().len());
    system.accumulate(|leaf, cell| {
        // Readings of a leaf are added in their order, so the sums do not depend on the threads (decision
        // 0027).
        let mut any = false;
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            if w > 0.0 {
                foot.rows(surface, |r, row| {
                    // The equation is one for the vertices, not for a step: information of different
                    // surfaces then adds.
                    let on_surface = along_normal(surface, foot, row);
                    cell.add_scalar(row, foot.normal, on_surface + foot.residuals[r], w);
                });
                any = true;
            }
        }
        any
    })
}

/// A row applied to the coefficients of a surface, projected on the foot's normal.
pub(super) fn along_normal(surface: &Surface, foot: &Foot, row: &[f64; 16]) -> f64 {
    let coefficients = surface.leaf_coefficients(foot.leaf as usize);
    row.iter().zip(coefficients).map(|(w, c)| w * foot.normal.dot(*c)).sum()
}

/// [`accumulate`] of positions into sums over several batches; other quantities are skipped.
pub(crate) fn add_up(sums: &mut DirectedSums, surface: &Surface, feet: &[Foot], information: &[f64]) {
    let (start, order) = by_leaf(feet, surface.space().leaves().len());
    sums.add(|leaf, moments| {
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            if w > 0.0 && foot.quantity == Quantity::Position {
                // As in `accumulate`, the equation is one for the vertices and not for a step.
                let on_surface = surface.leaf_point(leaf, foot.local[0], foot.local[1]);
                moments.add(foot.local, foot.normal, foot.normal.dot(on_surface) + foot.height(), w);
            }
        }
    });
}

/// Size of a surface: the longest side of the bounding box of its control vertices.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_spline::BaseShape;
/// let ball = BaseShape::sphere(DVec3::ZERO, 10.0, DVec3::Z).surface([16, 8])?;
/// assert!((20.0..24.0).contains(&planish_surface::observe::surface_extent(&ball)));
/// # Ok::<(), planish_core::Error>(())
/// ```
#[must_use]
pub fn surface_extent(surface: &Surface) -> f64 {
    let (lo, hi) = surface.vertices().iter().fold(([f64::MAX; 3], [f64::MIN; 3]), |(lo, hi), p| {
        ([0, 1, 2].map(|d| lo[d].min(p[d])), [0, 1, 2].map(|d| hi[d].max(p[d])))
    });
    (0..3).map(|d| hi[d] - lo[d]).fold(0.0, f64::max)
}
