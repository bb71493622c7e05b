//! σ at many surface points, with one covariance for each leaf.

use crate::model::Posterior;
use planish_core::DVec3;
use planish_estimate::Result;
use rayon::prelude::*;

/// Leaves of one parallel task: fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 64;

/// Indices of points sorted by leaf, as `(start, order)`: leaf `l` has `order[start[l] .. start[l + 1]]`,
/// ascending.
pub(crate) fn order_by_leaf(
    leaf: impl ExactSizeIterator<Item = u32> + Clone,
    leaves: usize,
) -> (Vec<u32>, Vec<u32>) {
    // A counting sort: linear in the points, and points of a leaf keep their order.
    let mut start = vec![0_u32; leaves + 1];
    for leaf in leaf.clone() {
        start[leaf as usize + 1] += 1;
    }
    for leaf in 0..leaves {
        start[leaf + 1] += start[leaf];
    }
    let mut next = start.clone();
    let mut order = vec![0_u32; leaf.len()];
    for (point, leaf) in leaf.enumerate() {
        let slot = &mut next[leaf as usize];
        order[*slot as usize] = point as u32;
        *slot += 1;
    }
    (start, order)
}

/// σ along `normals[k]` at the coordinates `local[k]` of `leaf[k]`, for every k.
///
/// The points may come in any order; each leaf's covariance is computed once.
///
/// # Errors
/// What [`Posterior::leaf`] reports.
pub fn sigmas_along(
    posterior: &Posterior<'_>,
    leaf: &[u32],
    local: &[[f64; 2]],
    normals: &[DVec3],
) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    let (start, points) = order_by_leaf(leaf.iter().copied(), leaves);
    let chunks: Vec<Vec<f64>> = (0..leaves.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut sigmas = Vec::new();
            for leaf in chunk * CHUNK..leaves.min((chunk + 1) * CHUNK) {
                let own = &points[start[leaf] as usize..start[leaf + 1] as usize];
                if own.is_empty() {
                    continue;
                }
                let covariance = posterior.leaf(leaf)?;
                sigmas.extend(own.iter().map(|&point| {
                    let point = point as usize;
                    Posterior::sigma_along(&covariance, local[point], normals[point])
                }));
            }
            Ok(sigmas)
        })
        .collect::<Result<_>>()?;
    // Chunks come in the order of leaves, as `points` do, so that values and points correspond.
    let mut sigma = vec![0.0; leaf.len()];
    for (&point, value) in points.iter().zip(chunks.into_iter().flatten()) {
        sigma[point as usize] = value;
    }
    Ok(sigma)
}
