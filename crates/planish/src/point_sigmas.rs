//! σ at many surface points: one covariance for each leaf, however the points are ordered.

use crate::model::Posterior;
use planish_estimate::Result;
use rayon::prelude::*;

/// Leaves whose covariances one task takes: fixed, so that threads change nothing.
const CHUNK: usize = 64;

/// σ along `normals[k]` at the coordinates `local[k]` of `leaf[k]`, for every k.
pub(crate) fn sigmas_along(
    posterior: &Posterior<'_>,
    leaf: &[u32],
    local: &[[f64; 2]],
    normals: &[[f64; 3]],
) -> Result<Vec<f64>> {
    let leaves = posterior.surface().space().leaves().len();
    // Counting sort of the points by leaf.
    let mut start = vec![0_usize; leaves + 1];
    for &leaf in leaf {
        start[leaf as usize + 1] += 1;
    }
    for leaf in 0..leaves {
        start[leaf + 1] += start[leaf];
    }
    let mut fill = start.clone();
    let mut points = vec![0_u32; leaf.len()];
    for (point, &leaf) in leaf.iter().enumerate() {
        points[fill[leaf as usize]] = point as u32;
        fill[leaf as usize] += 1;
    }
    let chunks: Vec<Vec<f64>> = (0..leaves.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut sigmas = Vec::new();
            for leaf in chunk * CHUNK..leaves.min((chunk + 1) * CHUNK) {
                let own = &points[start[leaf]..start[leaf + 1]];
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
    let mut sigma = vec![0.0; leaf.len()];
    for (&point, value) in points.iter().zip(chunks.into_iter().flatten()) {
        sigma[point as usize] = value;
    }
    Ok(sigma)
}
