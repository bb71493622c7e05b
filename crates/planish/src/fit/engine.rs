//! One iteration of a fit: project, weigh, accumulate, solve.

use super::observations::Observations;
use planish_estimate::sparse::{BlockInformation, CholeskyFactor};
use planish_estimate::vector3::dot;
use planish_estimate::Result;
use planish_sense::variance_along;
use planish_spline::{FootPointSearch, ProjectionOptions, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;

/// What became of a point's projection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FootState {
    /// Usable.
    Good,
    /// The scan's normal and the surface's disagree.
    NormalMismatch,
    /// Held at an open border.
    BeyondBorder,
}

/// A projected point: what accumulation and statistics need of it.
#[derive(Debug, Clone, Copy)]
pub struct Foot {
    pub leaf: u32,
    pub state: FootState,
    pub local: [f64; 2],
    pub normal: [f64; 3],
    /// Signed distance from the surface, the expected lift by tangential noise taken off.
    pub height: f64,
    /// `nᵀRn` of the point as stated.
    pub variance: f64,
}

/// How points are projected.
#[derive(Debug, Clone, Copy)]
pub(super) struct ProjectionPass {
    /// Points whose scan normal differs by more than this angle's cosine are set aside.
    pub least_cosine: f64,
    /// Whether to take off `tr(II R_t)/2`.
    pub correct_bias: bool,
    pub newton: ProjectionOptions,
}

/// Projects the points `subset` of the observations; `at` holds their parameters, before and after.
///
/// `factors` scale the stated variances sensor by sensor.
pub(super) fn project(
    surface: &Surface,
    observations: &Observations,
    subset: &[u32],
    at: &mut [[f64; 2]],
    search: Option<&FootPointSearch>,
    factors: &[f64],
    pass: &ProjectionPass,
) -> Vec<Foot> {
    let space = surface.space();
    let polar_margin = 0.0;
    let _ = polar_margin;
    let mut feet: Vec<(Foot, [f64; 2])> = Vec::with_capacity(subset.len());
    let at_read = &*at;
    subset
        .par_iter()
        .with_min_len(512)
        .map(|&i| {
            let i = i as usize;
            let z = observations.points[i];
            let scan_normal = observations.normal(i);
            let start = search.map_or(at_read[i], |s| s.nearest(z, scan_normal));
            let foot = surface.project(z, start, &pass.newton);
            let known = dot(scan_normal, scan_normal) > 0.5;
            let state = if known && dot(scan_normal, foot.normal) < pass.least_cosine {
                FootState::NormalMismatch
            } else if foot.at_border {
                FootState::BeyondBorder
            } else {
                FootState::Good
            };
            let covariance = observations.covariance(i);
            let factor = factors[observations.sensor(i)];
            let mut height = foot.height;
            if pass.correct_bias
                && let Some(curvature) = foot.jet.curvature()
            {
                // Only where the expansion holds: noise well below the radius of curvature.
                let lift = -factor * foot.jet.tangential_bias(&curvature, &covariance);
                let sigma = (factor * (covariance[0] + covariance[3] + covariance[5]) / 3.0).sqrt();
                height -= lift.clamp(-sigma, sigma);
            }
            let parameters = space.parameters(foot.leaf as usize, foot.local);
            let variance = variance_along(&covariance, foot.normal);
            (Foot { leaf: foot.leaf, state, local: foot.local, normal: foot.normal, height, variance }, parameters)
        })
        .collect_into_vec(&mut feet);
    for (&i, (_, parameters)) in subset.iter().zip(&feet) {
        at[i as usize] = *parameters;
    }
    feet.into_iter().map(|(foot, _)| foot).collect()
}

/// Positions in `feet` sorted by leaf: `order[start[leaf] .. start[leaf + 1]]`.
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
pub(super) fn accumulate(system: &SurfaceSystem, surface: &Surface, feet: &[Foot], information: &[f64]) -> Result<BlockInformation> {
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

/// Prior, data and their factor at one point of linearisation.
pub(super) struct Solved {
    pub factor: CholeskyFactor,
    pub surface: Surface,
}

/// Solves `(Λ_data + w K ⊗ I + Λ_hold) x = η`.
pub(super) fn solve(
    system: &SurfaceSystem,
    data: &BlockInformation,
    energy: &BlockInformation,
    weight: f64,
    hold: &BlockInformation,
) -> Result<Solved> {
    let mut total = data.clone();
    total.add_scaled(energy, weight)?;
    total.add_scaled(hold, 1.0)?;
    let factor = system.factorize(&total)?;
    let mut x = total.vector().to_vec();
    factor.solve_in_place(&mut x)?;
    Ok(Solved { factor, surface: system.surface(&x)? })
}
