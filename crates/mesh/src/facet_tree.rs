//! Everything that is nearly as near as the nearest: for sums over facets whose terms die away with distance.
//!
//! Comes in: facets, triangles with or without area (a point is a triangle of three equal corners). Goes out: for a place all facets that are at most so
//! much farther than the nearest one, and a few more.
//!
//! Not guaranteed: an order; that nothing beyond the slack is visited.

use crate::bvh::{Bvh, MAX_DEPTH, squared_distance_to_box};
use crate::triangle::closest_on_triangle;

/// A facet that is near a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearFacet {
    /// Its index.
    pub facet: u32,
    /// Its distance.
    pub distance: f64,
    /// Its nearest point.
    pub point: [f64; 3],
    /// Weights of its corners there.
    pub barycentric: [f64; 3],
}

/// A tree of boxes over facets.
#[derive(Debug, Clone)]
pub struct FacetTree {
    bvh: Bvh,
}

impl FacetTree {
    /// A tree over `count` facets, at least one, with finite corners. Cost O(n log n).
    #[must_use]
    pub fn new(count: usize, corners: impl Fn(usize) -> [[f64; 3]; 3]) -> Self {
        Self {
            bvh: Bvh::of(count, corners),
        }
    }

    /// Visits every facet that is at most `slack` farther from a place than the nearest one.
    ///
    /// Nearer boxes are looked into first, so that little is visited before the nearest facet is known. Nothing is visited for a place that is
    /// not finite.
    pub fn visit_near(&self, at: [f64; 3], slack: f64, mut visit: impl FnMut(&NearFacet)) {
        if !at.iter().all(|x| x.is_finite()) {
            return;
        }
        let Bvh {
            nodes,
            corners,
            triangles,
        } = &self.bvh;
        let mut nearest = f64::INFINITY;
        let mut limit = f64::INFINITY;
        let mut stack = [(0_u32, 0.0_f64); MAX_DEPTH + 1];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (mut here, to_here) = stack[height];
            if to_here > limit {
                continue;
            }
            loop {
                let node = &nodes[here as usize];
                if node.count > 0 {
                    for slot in node.first as usize..(node.first + node.count) as usize {
                        let Some(foot) = closest_on_triangle(at, &corners[slot], limit) else {
                            continue;
                        };
                        if foot.squared_distance > limit {
                            continue;
                        }
                        let distance = foot.squared_distance.sqrt();
                        if distance < nearest {
                            nearest = distance;
                            limit = (nearest + slack) * (nearest + slack);
                        }
                        visit(&NearFacet {
                            facet: triangles[slot],
                            distance,
                            point: foot.point,
                            barycentric: foot.barycentric,
                        });
                    }
                    break;
                }
                let [left, right] = [node.first, node.first + 1];
                let [to_left, to_right] =
                    [left, right].map(|child| squared_distance_to_box(at, &nodes[child as usize]));
                let (near, to_near, far, to_far) = if to_left <= to_right {
                    (left, to_left, right, to_right)
                } else {
                    (right, to_right, left, to_left)
                };
                if to_near > limit {
                    break;
                }
                if to_far <= limit {
                    stack[height] = (far, to_far);
                    height += 1;
                }
                here = near;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::icosphere;

    /// Everything within the slack is visited once, with its distance; points as well as triangles.
    #[test]
    fn all_that_is_near_is_visited_once() {
        let ball = icosphere(1.0, 3);
        for as_points in [false, true] {
            let corners = |t: usize| {
                let corners = ball.corners(t);
                if as_points { [corners[0]; 3] } else { corners }
            };
            let tree = FacetTree::new(ball.triangles.len(), corners);
            for at in [[0.1, 0.2, 0.3], [1.5, 0.0, -0.2], [0.0, 0.6, 0.8], [30.0, 40.0, 0.0]] {
                let all: Vec<f64> = (0..ball.triangles.len())
                    .map(|t| {
                        closest_on_triangle(at, &corners(t), f64::INFINITY)
                            .unwrap()
                            .squared_distance
                            .sqrt()
                    })
                    .collect();
                let least = all.iter().copied().fold(f64::INFINITY, f64::min);
                for slack in [0.0, 0.05, 0.5, 100.0] {
                    let mut count = vec![0; all.len()];
                    tree.visit_near(at, slack, |near| {
                        count[near.facet as usize] += 1;
                        assert!((near.distance - all[near.facet as usize]).abs() < 1e-12);
                    });
                    for (distance, count) in all.iter().zip(count) {
                        let wanted = *distance <= least + slack;
                        assert!(
                            count <= 1 && (count == 1 || !wanted),
                            "{distance} {least} {slack} {count}"
                        );
                    }
                }
            }
            let mut any = false;
            tree.visit_near([f64::NAN, 0.0, 0.0], 1.0, |_| any = true);
            assert!(!any);
        }
    }
}
