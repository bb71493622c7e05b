//! The pieces of one iteration of a fit: project, weigh, accumulate, solve.

use super::observations::Observations;
use planish_estimate::Result;
use planish_estimate::sparse::{BlockInformation, stochastic_trace};
use planish_estimate::vector3::{add_scaled, dot};
use planish_sense::variance_along;
use planish_spline::{FootPointSearch, ProjectionOptions, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;

/// What became of a point's projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FootState {
    /// Usable.
    Good,
    /// The scan's normal and the surface's disagree.
    NormalMismatch,
    /// Held at an open border.
    BeyondBorder,
}

/// A projected point: what accumulation and statistics need of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    pub leaf: u32,
    pub state: FootState,
    pub local: [f64; 2],
    pub normal: [f64; 3],
    /// Signed distance from the surface, the expected lift by tangential noise taken off.
    pub height: f64,
    /// `nᵀRn` of the point as stated.
    pub variance: f64,
}

/// Points whose scan normal differs from the surface's by more than about 70° lie on another sheet.
const LEAST_COSINE: f64 = 0.35;

/// Projects the points `subset` of the observations; `at` holds their parameters, before and after.
///
/// `factors` scale the stated variances sensor by sensor. Where the curvature is known, `tr(II R_t)/2` is taken off the height:
/// noise along the tangent plane lifts points off a curved surface by that much on average.
pub(super) fn project(
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
            let z = observations.points[i];
            let scan_normal = observations.normal(i);
            let start = search.map_or(before[i], |s| s.nearest(z, scan_normal));
            let foot = surface.project(z, start, &options);
            let known = dot(scan_normal, scan_normal) > 0.5;
            let state = if known && dot(scan_normal, foot.normal) < LEAST_COSINE {
                FootState::NormalMismatch
            } else if foot.at_border {
                FootState::BeyondBorder
            } else {
                FootState::Good
            };
            let covariance = observations.covariance(i);
            let factor = factors[observations.sensor(i)];
            let mut height = foot.height;
            if let Some(curvature) = foot.jet.curvature() {
                let lift = -factor * foot.jet.tangential_bias(&curvature, &covariance);
                // The expansion holds where noise is well below the radius of curvature; elsewhere it is not trusted far.
                let sigma = (factor * (covariance[0] + covariance[3] + covariance[5]) / 3.0).sqrt();
                height -= lift.clamp(-0.5 * sigma, 0.5 * sigma);
            }
            let parameters = space.parameters(foot.leaf as usize, foot.local);
            let variance = variance_along(&covariance, foot.normal);
            (
                Foot {
                    leaf: foot.leaf,
                    state,
                    local: foot.local,
                    normal: foot.normal,
                    height,
                    variance,
                },
                parameters,
            )
        })
        .collect_into_vec(&mut feet);
    for (&i, (_, parameters)) in subset.iter().zip(&feet) {
        at[i as usize] = *parameters;
    }
    feet.into_iter().map(|(foot, _)| foot).collect()
}

/// Positions in `feet` sorted by leaf: leaf `l` has `order[start[l] .. start[l + 1]]`.
pub(super) fn by_leaf(feet: &[Foot], leaves: usize) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0_u32; leaves + 1];
    for foot in feet {
        start[foot.leaf as usize + 1] += 1;
    }
    for leaf in 0..leaves {
        start[leaf + 1] += start[leaf];
    }
    let mut next = start.clone();
    let mut order = vec![0_u32; feet.len()];
    for (k, foot) in feet.iter().enumerate() {
        let slot = &mut next[foot.leaf as usize];
        order[*slot as usize] = k as u32;
        *slot += 1;
    }
    (start, order)
}

/// Data information of projected points, each with its own weight (information of its height; zero leaves it out).
pub(super) fn accumulate(
    system: &SurfaceSystem,
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
) -> Result<BlockInformation> {
    let (start, order) = by_leaf(feet, system.space().leaves().len());
    system.accumulate(|leaf, cell| {
        let mut any = false;
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            if w > 0.0 {
                let c = leaf_weights(foot.local[0], foot.local[1]);
                let on_surface = surface.leaf_point(leaf, foot.local[0], foot.local[1]);
                cell.add_scalar(&c, foot.normal, dot(foot.normal, on_surface) + foot.height, w);
                any = true;
            }
        }
        any
    })
}

/// The outcome of [`normal_step`].
pub(super) struct NormalStep {
    pub surface: Surface,
    /// Effective degrees of freedom that the data determine.
    pub degrees: f64,
}

/// One Gauss–Newton step in which every vertex moves along its own normal: one unknown a node instead of three.
///
/// Foot points slide freely, so motion along the surface gains nothing while the shape is still being found; the factor costs
/// a twenty-seventh of the full one. `information` weighs the feet; `earlier` is information of three coordinates that is there already.
pub(super) fn normal_step(
    system: &SurfaceSystem,
    surface: &Surface,
    feet: &[Foot],
    information: &[f64],
    prior: &BlockInformation,
    weight: f64,
    earlier: Option<&BlockInformation>,
) -> Result<NormalStep> {
    let space = system.space();
    let directions = system.node_normals(surface);
    let (start, order) = by_leaf(feet, space.leaves().len());
    let mut data = system.accumulate_along(&directions, |leaf, add| {
        for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            if w > 0.0 {
                add(&leaf_weights(foot.local[0], foot.local[1]), foot.normal, foot.height, w);
            }
        }
    })?;
    let x: Vec<f64> = surface.vertices().iter().flatten().copied().collect();
    // What pulls the vertices already: −w K x of the prior, η − Λ x of earlier data.
    let mut pull = vec![0.0; x.len()];
    prior.multiply(&x, &mut pull)?;
    for (p, eta) in pull.iter_mut().zip(prior.vector()) {
        *p = weight * (eta - *p);
    }
    if let Some(earlier) = earlier {
        let mut there = vec![0.0; x.len()];
        earlier.multiply(&x, &mut there)?;
        for ((p, eta), t) in pull.iter_mut().zip(earlier.vector()).zip(&there) {
            *p += eta - t;
        }
        data.add_scaled(&system.contract(earlier, &directions)?, 1.0)?;
    }
    let mut matrix = system.contract(prior, &directions)?;
    for value in matrix.values_mut() {
        *value *= weight;
    }
    matrix.add_scaled(&data, 1.0)?;
    let ridge = 1e-10 * matrix.diagonal().iter().sum::<f64>() / matrix.dimension() as f64;
    matrix.add_diagonal(ridge.max(f64::MIN_POSITIVE));
    let factor = system.factorize_scalar(&matrix)?;
    let mut step: Vec<f64> = data.vector().to_vec();
    for ((s, p), d) in step.iter_mut().zip(pull.chunks_exact(3)).zip(&directions) {
        *s += p[0] * d[0] + p[1] * d[1] + p[2] * d[2];
    }
    factor.solve_in_place(&mut step)?;
    let degrees = stochastic_trace(&factor, &data, 8, 1)?.value;
    let vertices = surface
        .vertices()
        .iter()
        .zip(&directions)
        .zip(&step)
        .map(|((p, d), s)| add_scaled(*p, *s, *d));
    Ok(NormalStep {
        surface: surface.with_vertices(vertices.collect())?,
        degrees,
    })
}
