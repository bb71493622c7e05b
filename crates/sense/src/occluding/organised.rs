//! A mesh of each strip: contours of consecutive views, joined by their matches.
//!
//! In: points with their successors along the contour and in the next view. Out: triangles over the points,
//! and positions with regularised depths.
//!
//! A point is known far worse along its line of sight than across it, and moving it there keeps it on the
//! surface to first order. So depths are relaxed: each is the information-weighted mean of the depth by the
//! circle and of the midpoints of its neighbours, in the adjacent views and along the contour. The variance
//! of a point about these midpoints is estimated from the strip, as the median over its points less the
//! contribution of σ (the spline of C. Zhao and R. Mohr, *Relative 3D regularized B-spline surface
//! reconstruction
//! through image sequences*, ECCV 1994, serves the same end). Covariances stay those of the measurements.
//!
//! Not guaranteed: triangles at sharp edges fold or degenerate, and are omitted.

use super::OccludingPoint;
use planish_core::DVec3;

/// Rounds of relaxation. Values spread by about one neighbour per round.
const ROUNDS: usize = 12;
/// Minimum σ of the midpoint of two neighbours, as a share of their distance. It limits the smoothing of
/// smooth strips.
const MIN_SHARE: f64 = 0.03;
/// Maximum number of points that a match may skip.
const MAX_STEPS: usize = 8;
/// Minimum cosine between the normal of a triangle and the normals of its corners: 73°. Triangles across a
/// fold face away from their corners.
const MIN_COSINE: f64 = 0.3;
/// Median square of a normal distribution divided by its variance.
const MEDIAN_SQUARE: f64 = 0.4549;

/// The successors of each point.
#[derive(Debug, Clone, Default)]
pub(super) struct Following {
    /// Along its contour.
    pub along: Vec<Option<usize>>,
    /// In the next view.
    pub across: Vec<Option<usize>>,
}

/// The predecessors of each point.
fn reversed(next: &[Option<usize>]) -> Vec<Option<usize>> {
    let mut before = vec![None; next.len()];
    for (k, to) in next.iter().enumerate() {
        if let Some(to) = to {
            before[*to] = Some(k);
        }
    }
    before
}

/// Positions with relaxed depths; `ways` are the lines of sight.
pub(super) fn relaxed(points: &[OccludingPoint], ways: &[DVec3], following: &Following) -> Vec<DVec3> {
    let mut positions: Vec<DVec3> = points.iter().map(|p| p.position).collect();
    let pairs: Vec<[Option<[usize; 2]>; 2]> = {
        let both = |next: &[Option<usize>]| -> Vec<Option<[usize; 2]>> {
            let before = reversed(next);
            (before.iter().zip(next)).map(|(a, b)| Some([(*a)?, (*b)?])).collect()
        };
        both(&following.across).into_iter().zip(both(&following.along)).map(|(a, b)| [a, b]).collect()
    };
    // Distance of the midpoint of two neighbours from a point, along its line of sight.
    let off = |positions: &[DVec3], k: usize, [a, b]: [usize; 2]| {
        let middle = 0.5 * (positions[a] + positions[b]);
        ways[k].dot(middle - positions[k])
    };
    let strips = points.iter().map(|p| p.strip + 1).max().unwrap_or(0);
    let mut spread = vec![[0.0; 2]; strips];
    for (strip, spread) in spread.iter_mut().enumerate() {
        for (kind, spread) in spread.iter_mut().enumerate() {
            let mut squares: Vec<f64> = (0..points.len())
                .filter(|k| points[*k].strip == strip)
                .filter_map(|k| {
                    let pair = pairs[k][kind]?;
                    let own = points[k].sigma_depth.powi(2);
                    let others: f64 = pair.iter().map(|j| points[*j].sigma_depth.powi(2)).sum();
                    Some(off(&positions, k, pair).powi(2) / MEDIAN_SQUARE - own - 0.25 * others)
                })
                .collect();
            // The median, because a few points at sharp edges deviate arbitrarily.
            squares.sort_by(f64::total_cmp);
            *spread = squares.get(squares.len() / 2).copied().unwrap_or(0.0).max(0.0);
        }
    }
    for _ in 0..ROUNDS {
        let next: Vec<DVec3> = (0..points.len())
            .map(|k| {
                let own = 1.0 / points[k].sigma_depth.powi(2).max(f64::MIN_POSITIVE);
                let moved = ways[k].dot(points[k].position - positions[k]);
                let (mut sum, mut information) = (own * moved, own);
                for kind in 0..2 {
                    if let Some(pair) = pairs[k][kind] {
                        let apart = (positions[pair[0]] - positions[pair[1]]).length();
                        let floor = (MIN_SHARE * apart).powi(2).max(f64::MIN_POSITIVE);
                        let weight = 1.0 / spread[points[k].strip][kind].max(floor);
                        sum += weight * off(&positions, k, pair);
                        information += weight;
                    }
                }
                // Half of the step; with full steps, neighbours would exchange their values for ever.
                positions[k] + 0.5 * sum / information * ways[k]
            })
            .collect();
        positions = next;
    }
    positions
}

/// Triangles between contours of consecutive views, facing outwards.
pub(super) fn triangles(
    points: &[OccludingPoint],
    positions: &[DVec3],
    following: &Following,
) -> Vec<[u32; 3]> {
    let mut found = Vec::new();
    for k in 0..points.len() {
        let corners = (|| {
            let next = following.along[k]?;
            Some((next, following.across[k]?, following.across[next]?))
        })();
        let Some((next, first, last)) = corners else {
            continue;
        };
        let mut chain = vec![first];
        while chain.last() != Some(&last) && chain.len() <= MAX_STEPS {
            match chain.last().and_then(|c| following.along[*c]) {
                Some(step) => chain.push(step),
                None => break,
            }
        }
        if chain.last() != Some(&last) {
            continue;
        }
        let fan = chain.windows(2).map(|pair| [k, pair[1], pair[0]]);
        for triangle in fan.chain([[k, next, last]]) {
            let [a, b, c] = triangle.map(|v| positions[v]);
            let out = triangle.iter().fold(DVec3::ZERO, |sum, v| sum + points[*v].normal);
            let (Some(facing), Some(out)) = ((b - a).cross(c - a).try_normalize(), out.try_normalize())
            else {
                continue;
            };
            let cosine = facing.dot(out);
            let [a, b, c] = triangle.map(|v| v as u32);
            if cosine > MIN_COSINE {
                found.push([a, b, c]);
            } else if cosine < -MIN_COSINE {
                found.push([a, c, b]);
            }
        }
    }
    found
}
