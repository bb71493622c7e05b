//! Search for all facets that are nearly as near as the nearest one.
//!
//! It serves sums over facets whose terms vanish with the distance. In: facets, which are triangles with or
//! without area, or points (triangles with three equal corners). Out: for a point, all facets whose distance
//! exceeds that of the nearest one by at most a slack, and a few more.
//!
//! The facets of a leaf are processed together ([`crate::packet`]), in vectors as wide as the processor has.
//!
//! Not guaranteed: an order of the facets, or that none beyond the slack is visited.

use crate::bvh::{Bvh, MAX_DEPTH, Node, min_number, squared_distance_to_box};
use crate::packet::{Feet, LANES, Packet, PointPacket, TrianglePacket};
use planish_core::DVec3;
use pulp::{Simd, WithSimd};

/// Relative slack of squared distances, so that facets at the same distance within rounding are all visited.
const ROUNDING_SLACK: f64 = 1e-12;

/// A facet near a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearFacet {
    /// Index of the facet.
    pub facet: u32,
    /// Distance of the facet.
    pub distance: f64,
    /// Nearest point of the facet.
    pub point: DVec3,
    /// Barycentric coordinates of this point.
    pub barycentric: [f64; 3],
}

/// A bounding volume hierarchy over facets.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::{FacetTree, icosphere};
/// let ball = icosphere(1.0, 3);
/// let tree = FacetTree::new(ball.triangles.len(), |t| ball.corners(t));
/// let mut distances = Vec::new();
/// tree.visit_near(1.5 * DVec3::Z, 0.1, |near| distances.push(near.distance));
/// let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
/// assert!((nearest - 0.5).abs() < 0.01 && distances.len() > 10);
/// ```
#[derive(Debug, Clone)]
pub struct FacetTree {
    /// In leaves, `first` is the index of their packet.
    nodes: Vec<Node>,
    packets: Packets,
    simd: pulp::Arch,
}

/// Packets of leaves. Points alone have a packet of their own, with a seventh of the numbers.
#[derive(Debug, Clone)]
enum Packets {
    Triangles(Vec<TrianglePacket>),
    Points(Vec<PointPacket>),
}

impl FacetTree {
    /// Builds a tree over `count` facets, at least one, with finite corners. Cost O(n log n).
    #[must_use]
    pub fn new(count: usize, corners: impl Fn(usize) -> [DVec3; 3]) -> Self {
        Self::of_some(&(0..count as u32).collect::<Vec<u32>>(), corners)
    }

    /// Builds a tree over the facets with these indices.
    #[must_use]
    pub fn of_some(facets: &[u32], corners: impl Fn(usize) -> [DVec3; 3]) -> Self {
        let corners = |k: usize| corners(facets[k] as usize);
        let count = facets.len();
        // Points are tested once here and not in each visit: a tree is built once and visited often.
        let are_points = (0..count).all(|t| {
            let [a, b, c] = corners(t);
            a == b && b == c
        });
        let Bvh { mut nodes, corners, mut triangles } = Bvh::new(count, corners);
        triangles.iter_mut().for_each(|k| *k = facets[*k as usize]);
        let packets = if are_points {
            Packets::Points(build_packets(&mut nodes, &corners, &triangles))
        } else {
            Packets::Triangles(build_packets(&mut nodes, &corners, &triangles))
        };
        Self { nodes, packets, simd: pulp::Arch::new() }
    }

    /// Visits every facet whose distance from a point exceeds that of the nearest one by at most `slack`.
    ///
    /// A few more facets may be visited: nearer boxes are entered first, but the nearest facet is known only
    /// after its leaf. Nothing is visited for a point that is not finite.
    #[inline]
    pub fn visit_near(&self, at: DVec3, slack: f64, visit: impl FnMut(&NearFacet)) {
        if !at.is_finite() {
            return;
        }
        let nodes = &self.nodes;
        match &self.packets {
            Packets::Triangles(packets) => self.simd.dispatch(Visit { nodes, packets, at, slack, visit }),
            Packets::Points(packets) => self.simd.dispatch(Visit { nodes, packets, at, slack, visit }),
        }
    }
}

/// Builds a packet for each leaf and stores its index in the leaf.
fn build_packets<P: Packet>(nodes: &mut [Node], corners: &[[DVec3; 3]], triangles: &[u32]) -> Vec<P> {
    let mut packets = Vec::new();
    for leaf in nodes.iter_mut().filter(|node| node.count > 0) {
        let own = leaf.first as usize..(leaf.first + leaf.count) as usize;
        leaf.first = packets.len() as u32;
        packets.push(P::new(&corners[own.clone()], &triangles[own]));
    }
    packets
}

/// The arguments of a visit. `pulp` compiles the traversal once for each instruction set, so it has to be one
/// function without calls that are not inlined.
struct Visit<'a, P, F> {
    nodes: &'a [Node],
    packets: &'a [P],
    at: DVec3,
    slack: f64,
    visit: F,
}

impl<P: Packet, F: FnMut(&NearFacet)> WithSimd for Visit<'_, P, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { nodes, packets, at, slack, mut visit } = self;
        // Distances stay squared as long as possible. The slack is on the distance itself, so a new
        // nearest facet needs one square root.
        let mut nearest = f64::INFINITY;
        let mut limit = f64::INFINITY;
        let mut feet = Feet::default();
        let mut stack = [(0_u32, 0.0_f64); MAX_DEPTH + 1];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (mut index, distance) = stack[height];
            if distance > limit {
                continue;
            }
            loop {
                let node = &nodes[index as usize];
                if node.count > 0 {
                    let packet = &packets[node.first as usize];
                    packet.feet(simd, at, &mut feet);
                    let mut smallest = feet.squared_distance[0];
                    for lane in 1..LANES {
                        smallest = min_number(feet.squared_distance[lane], smallest);
                    }
                    // One comparison skips the whole packet if nothing in it is near.
                    if smallest > limit {
                        break;
                    }
                    if smallest < nearest * nearest {
                        nearest = smallest.sqrt();
                        limit = (nearest + slack) * (nearest + slack) * (1.0 + ROUNDING_SLACK);
                    }
                    // Lanes beyond the count repeat the first facet and must not be visited again.
                    for lane in 0..(node.count as usize).min(LANES) {
                        if feet.squared_distance[lane] <= limit {
                            visit(&NearFacet {
                                facet: packet.facet(lane),
                                distance: feet.squared_distance[lane].sqrt(),
                                point: DVec3::new(
                                    feet.point[0][lane],
                                    feet.point[1][lane],
                                    feet.point[2][lane],
                                ),
                                barycentric: [
                                    feet.barycentric[0][lane],
                                    feet.barycentric[1][lane],
                                    feet.barycentric[2][lane],
                                ],
                            });
                        }
                    }
                    break;
                }
                let [left, right] = [node.first, node.first + 1];
                let to_left = squared_distance_to_box(at, &nodes[left as usize]);
                let to_right = squared_distance_to_box(at, &nodes[right as usize]);
                let (near, to_near, far, to_far) = if to_left <= to_right {
                    (left, to_left, right, to_right)
                } else {
                    (right, to_right, left, to_left)
                };
                if to_near > limit {
                    break;
                }
                // The farther child waits with its distance: the limit may have shrunk below it when its
                // turn comes.
                if to_far <= limit {
                    stack[height] = (far, to_far);
                    height += 1;
                }
                index = near;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::icosphere;
    use crate::triangle::closest_on_triangle;

    /// All facets within the slack are visited once with their distance, for triangles and for points.
    #[test]
    fn all_facets_within_the_slack_are_visited_once() {
        let ball = icosphere(1.0, 3);
        for as_points in [false, true] {
            let corners = |t: usize| {
                let corners = ball.corners(t);
                if as_points { [corners[0]; 3] } else { corners }
            };
            let tree = FacetTree::new(ball.triangles.len(), corners);
            for at in [[0.1, 0.2, 0.3], [1.5, 0.0, -0.2], [0.0, 0.6, 0.8], [30.0, 40.0, 0.0]] {
                let at = DVec3::from_array(at);
                let all: Vec<f64> = (0..ball.triangles.len())
                    .map(|t| {
                        closest_on_triangle(at, &corners(t), f64::INFINITY).unwrap().squared_distance.sqrt()
                    })
                    .collect();
                let smallest = all.iter().copied().fold(f64::INFINITY, f64::min);
                for slack in [0.0, 0.05, 0.5, 100.0] {
                    let mut count = vec![0; all.len()];
                    tree.visit_near(at, slack, |near| {
                        count[near.facet as usize] += 1;
                        assert!((near.distance - all[near.facet as usize]).abs() < 1e-12);
                    });
                    for (distance, count) in all.iter().zip(count) {
                        let wanted = *distance <= smallest + slack;
                        assert!(
                            count <= 1 && (count == 1 || !wanted),
                            "{distance} {smallest} {slack} {count}"
                        );
                    }
                }
            }
            let mut any = false;
            tree.visit_near(DVec3::new(f64::NAN, 0.0, 0.0), 1.0, |_| any = true);
            assert!(!any);
        }
    }
}
