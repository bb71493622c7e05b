//! A bounding volume hierarchy over triangles.
//!
//! In: the corners of the triangles. Out: a flat array of nodes over triangles in leaf order. The tree
//! depends only on the triangles, not on the number of threads. Not guaranteed: balance, but the depth stays
//! below [`MAX_DEPTH`].

use planish_core::{BoundingBox, DVec3};

/// Maximum number of triangles of a leaf.
///
/// With 2, 4 and 8, closest points took the same time within noise on 70 k and 1.3 M triangles. 8 builds
/// fastest and needs the fewest nodes. It is also the width of a packet ([`crate::packet::LANES`]).
pub(crate) const LEAF: usize = 8;
/// Number of bins of the surface-area heuristic; more bins find slightly better planes and build slower.
const BINS: usize = 16;
/// Parts with at least this number of triangles are built in parallel; smaller ones do not repay a task.
const PARALLEL: usize = 1 << 14;
/// Depth from which triangles are halved by count.
///
/// The heuristic can split off single triangles, as of geometrically spaced ones. Halving bounds the depth to
/// `SAH_DEPTH + 32`.
const SAH_DEPTH: usize = 30;
/// Bound of the depth of any tree, and therefore the size of the stack of a traversal.
pub(crate) const MAX_DEPTH: usize = 64;

/// A box with its triangles or its children.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub min: DVec3,
    pub max: DVec3,
    /// First triangle of a leaf, or the left child; the right child follows the left.
    pub first: u32,
    /// Number of triangles of a leaf; 0 for an inner node.
    pub count: u32,
}

/// The tree: nodes, the root first, over triangles in leaf order.
#[derive(Debug, Clone)]
pub(crate) struct Bvh {
    pub nodes: Vec<Node>,
    /// Corners of the triangles in leaf order. The copy saves two indirections in every visit of a leaf.
    pub corners: Vec<[DVec3; 3]>,
    /// For each position in leaf order, the index of the triangle.
    pub triangles: Vec<u32>,
}

/// The box of one triangle.
#[derive(Clone, Copy)]
struct Item {
    bounds: BoundingBox,
    triangle: u32,
}

impl Item {
    /// Twice the centre of the box: halving would change neither order nor bins.
    fn center2(&self, axis: usize) -> f64 {
        self.bounds.min[axis] + self.bounds.max[axis]
    }
}

impl Bvh {
    /// Builds the tree over at least one triangle.
    pub fn new(count: usize, corners: impl Fn(usize) -> [DVec3; 3]) -> Self {
        let mut items: Vec<Item> = (0..count)
            .map(|t| {
                let [a, b, c] = corners(t);
                let mut bounds = BoundingBox { min: a, max: a };
                bounds.include(b);
                bounds.include(c);
                Item { bounds, triangle: t as u32 }
            })
            .collect();
        let nodes = build(&mut items, 0, 0);
        let triangles: Vec<u32> = items.iter().map(|item| item.triangle).collect();
        // The boxes are nearly as large as the corners that are copied next. Keeping both would raise the
        // peak memory.
        drop(items);
        Self { nodes, corners: triangles.iter().map(|&t| corners(t as usize)).collect(), triangles }
    }
}

/// Builds the tree over `items`, which start at position `first` of the leaf order.
///
/// Indices of children count from the root of this tree.
fn build(items: &mut [Item], first: usize, depth: usize) -> Vec<Node> {
    if items.len() < PARALLEL {
        let mut nodes = Vec::with_capacity(items.len());
        nodes.push(node_of(items, first));
        subdivide(&mut nodes, 0, items, first, depth);
        return nodes;
    }
    let root = node_of(items, first);
    let middle = split(items, depth);
    let (left, right) = items.split_at_mut(middle);
    let (left, right) =
        rayon::join(|| build(left, first, depth + 1), || build(right, first + middle, depth + 1));
    // Order: root, both children, the rest of the left tree, the rest of the right tree. Siblings must be
    // adjacent, because a node stores only its left child.
    let mut nodes = Vec::with_capacity(1 + left.len() + right.len());
    let moved = |mut node: Node, by: usize| {
        if node.count == 0 {
            node.first += by as u32;
        }
        node
    };
    let (left_by, right_by) = (2, left.len() + 1);
    nodes.push(Node { first: 1, count: 0, ..root });
    nodes.push(moved(left[0], left_by));
    nodes.push(moved(right[0], right_by));
    nodes.extend(left[1..].iter().map(|&n| moved(n, left_by)));
    nodes.extend(right[1..].iter().map(|&n| moved(n, right_by)));
    nodes
}

/// Splits a leaf, and its children in turn, until every leaf is small enough.
fn subdivide(nodes: &mut Vec<Node>, at: usize, items: &mut [Item], first: usize, depth: usize) {
    if items.len() <= LEAF {
        return;
    }
    let middle = split(items, depth);
    let (left, right) = items.split_at_mut(middle);
    let child = nodes.len();
    nodes[at].first = child as u32;
    nodes[at].count = 0;
    nodes.push(node_of(left, first));
    nodes.push(node_of(right, first + middle));
    subdivide(nodes, child, left, first, depth + 1);
    subdivide(nodes, child + 1, right, first + middle, depth + 1);
}

/// A leaf over all `items`.
fn node_of(items: &[Item], first: usize) -> Node {
    let mut grown = BoundingBox::EMPTY;
    for item in items {
        grown.include_box(&item.bounds);
    }
    Node { min: grown.min, max: grown.max, first: first as u32, count: items.len() as u32 }
}

/// Reorders `items` into two non-empty parts and returns the size of the first.
///
/// The plane is that of the binned surface-area heuristic along the axis with the largest spread of centres.
/// If it finds none, the items are halved.
///
/// Reference: Wald, *On fast Construction of SAH-based Bounding Volume Hierarchies*, 2007.
fn split(items: &mut [Item], depth: usize) -> usize {
    let centers: BoundingBox =
        (items.iter().map(|item| DVec3::from_array([0, 1, 2].map(|k| item.center2(k))))).collect();
    let spread = centers.extent();
    let axis = (1..3).fold(0, |best, k| if spread[k] > spread[best] { k } else { best });
    // Centres without spread give an infinite factor, which the test below rejects.
    let per_unit = BINS as f64 / spread[axis];
    if depth < SAH_DEPTH && per_unit.is_finite() && per_unit > 0.0 {
        let bin =
            |item: &Item| (((item.center2(axis) - centers.min[axis]) * per_unit) as usize).min(BINS - 1);
        let mut bins = [(BoundingBox::EMPTY, 0_usize); BINS];
        for item in items.iter() {
            let (bounds, count) = &mut bins[bin(item)];
            bounds.include_box(&item.bounds);
            *count += 1;
        }
        // Cost of a plane: number of triangles times surface area, summed over both sides. A ray or a search
        // visits a box with a probability in proportion to its surface.
        // Two sweeps, from the left and from the right, give the cost of all planes in O(bins).
        let mut cost = [0.0; BINS];
        let (mut grown, mut count) = (BoundingBox::EMPTY, 0);
        for k in 0..BINS - 1 {
            grown.include_box(&bins[k].0);
            count += bins[k].1;
            cost[k + 1] = half_area(&grown) * count as f64;
        }
        let mut best = (f64::INFINITY, 0);
        let (mut grown, mut count) = (BoundingBox::EMPTY, 0);
        for k in (1..BINS).rev() {
            grown.include_box(&bins[k].0);
            count += bins[k].1;
            let total = cost[k] + half_area(&grown) * count as f64;
            if count > 0 && count < items.len() && total < best.0 {
                best = (total, k);
            }
        }
        if best.1 > 0 {
            return partition(items, |item| bin(item) < best.1);
        }
    }
    let middle = items.len() / 2;
    // The index breaks ties, so that equal centres cannot make the tree depend on the algorithm of selection.
    items.select_nth_unstable_by(middle, |a, b| {
        a.center2(axis).total_cmp(&b.center2(axis)).then(a.triangle.cmp(&b.triangle))
    });
    middle
}

/// Moves the items that are `left` to the front and returns their number.
fn partition(items: &mut [Item], left: impl Fn(&Item) -> bool) -> usize {
    let mut kept = 0;
    for k in 0..items.len() {
        if left(&items[k]) {
            items.swap(kept, k);
            kept += 1;
        }
    }
    kept
}

/// Half the area of a box; zero for the empty one.
fn half_area(bounds: &BoundingBox) -> f64 {
    if bounds.min[0] > bounds.max[0] {
        return 0.0;
    }
    let DVec3 { x, y, z } = bounds.extent();
    x * y + y * z + z * x
}

/// Squared distance from a point to a box, zero inside. NaN counts as inside.
#[inline(always)]
pub(crate) fn squared_distance_to_box(p: DVec3, node: &Node) -> f64 {
    let mut sum = 0.0;
    for k in 0..3 {
        let d = max_number(max_number(node.min[k] - p[k], p[k] - node.max[k]), 0.0);
        sum += d * d;
    }
    sum
}

/// The greater of two numbers, `b` if one is NaN: a single machine instruction, unlike `f64::max`.
#[inline(always)]
pub(crate) fn max_number(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The lesser of two numbers, `b` if one is NaN.
#[inline(always)]
pub(crate) fn min_number(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(bvh: &Bvh, at: usize, depth: usize, seen: &mut [bool]) {
        assert!(depth < MAX_DEPTH);
        let node = bvh.nodes[at];
        let inside = |p: DVec3| (0..3).all(|k| node.min[k] <= p[k] && p[k] <= node.max[k]);
        if node.count > 0 {
            assert!(node.count as usize <= LEAF);
            for slot in node.first as usize..(node.first + node.count) as usize {
                assert!(!std::mem::replace(&mut seen[slot], true));
                assert!(bvh.corners[slot].iter().all(|&p| inside(p)));
            }
        } else {
            for child in [node.first as usize, node.first as usize + 1] {
                assert!(child > at && inside(bvh.nodes[child].min) && inside(bvh.nodes[child].max));
                check(bvh, child, depth + 1, seen);
            }
        }
    }

    fn check_all(count: usize, corners: impl Fn(usize) -> [DVec3; 3]) {
        let bvh = Bvh::new(count, &corners);
        let mut seen = vec![false; count];
        check(&bvh, 0, 0, &mut seen);
        assert!(seen.iter().all(|&s| s));
        for (slot, &t) in bvh.triangles.iter().enumerate() {
            assert_eq!(bvh.corners[slot], corners(t as usize));
        }
    }

    #[test]
    fn every_triangle_is_in_one_leaf_inside_its_boxes() {
        // More triangles than the parallel limit, at hashed positions.
        let hashed = |t: usize| {
            let x = (t as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let p = DVec3::new((x >> 40) as f64, ((x >> 20) & 0xF_FFFF) as f64, (x & 0xF_FFFF) as f64);
            [p, p + DVec3::X, p + DVec3::Y]
        };
        check_all(50_000, hashed);
        check_all(1, hashed);
    }

    #[test]
    fn coincident_and_geometrically_spaced_triangles_do_not_deepen_the_tree() {
        check_all(20_000, |_| [DVec3::ONE; 3]);
        check_all(2_000, |t| [DVec3::splat(2.0_f64.powi(t as i32 % 1000 - 500)); 3]);
    }
}
