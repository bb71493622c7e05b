//! Nearest points, by a balanced k-d tree.
//!
//! In: points. Out: for a place, its nearest ones with their distances, nearest first; equal distances in the
//! order of the points. Cost: `n log n` to build, about `log n` for each neighbour.

use planish_core::DVec3;

/// Points per leaf.
const LEAF: usize = 8;

/// Points that can be searched.
pub(crate) struct PointTree {
    points: Vec<DVec3>,
    /// Indices of the points; each node is the middle of its range, which splits the rest by x, y and z in
    /// turn.
    order: Vec<u32>,
}

impl PointTree {
    pub(crate) fn new(points: Vec<DVec3>) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        split(&points, &mut order, 0);
        Self { points, order }
    }

    /// The `count` nearest points with their distances; fewer if there are fewer.
    pub(crate) fn nearest(&self, at: DVec3, count: usize) -> Vec<(f64, u32)> {
        let mut found: Vec<(f64, u32)> = Vec::with_capacity(count + 1);
        self.search(&self.order, 0, at, count, &mut found);
        found.iter_mut().for_each(|(square, _)| *square = square.sqrt());
        found
    }

    fn search(&self, range: &[u32], axis: usize, at: DVec3, count: usize, found: &mut Vec<(f64, u32)>) {
        if range.len() <= LEAF {
            range.iter().for_each(|i| self.consider(*i, at, count, found));
            return;
        }
        let middle = range.len() / 2;
        let off = at[axis] - self.points[range[middle] as usize][axis];
        let (below, above) = (&range[..middle], &range[middle + 1..]);
        let (near, far) = if off < 0.0 { (below, above) } else { (above, below) };
        self.search(near, (axis + 1) % 3, at, count, found);
        self.consider(range[middle], at, count, found);
        if found.len() < count || found.last().is_some_and(|(worst, _)| off * off <= *worst) {
            self.search(far, (axis + 1) % 3, at, count, found);
        }
    }

    fn consider(&self, i: u32, at: DVec3, count: usize, found: &mut Vec<(f64, u32)>) {
        let key = (at.distance_squared(self.points[i as usize]), i);
        let before = |other: &(f64, u32)| other.0.total_cmp(&key.0).then(other.1.cmp(&key.1)).is_lt();
        let place = found.partition_point(before);
        if place < count {
            found.insert(place, key);
            found.truncate(count);
        }
    }
}

/// Sorts a range of points into a tree whose levels split by x, y and z in turn.
fn split(points: &[DVec3], range: &mut [u32], axis: usize) {
    if range.len() <= LEAF {
        return;
    }
    let middle = range.len() / 2;
    let order =
        |a: &u32, b: &u32| points[*a as usize][axis].total_cmp(&points[*b as usize][axis]).then(a.cmp(b));
    range.select_nth_unstable_by(middle, order);
    let (below, above) = range.split_at_mut(middle);
    split(points, below, (axis + 1) % 3);
    split(points, &mut above[1..], (axis + 1) % 3);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The nearest points are those of an exhaustive search, also among equal ones and beyond their number.
    #[test]
    fn nearest_points_agree_with_a_full_search() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut number = || f64::from(random.random_range(0..12_u32));
        let points: Vec<DVec3> = (0..500).map(|_| DVec3::new(number(), number(), number())).collect();
        let tree = PointTree::new(points.clone());
        for _ in 0..50 {
            let at = 0.7 * DVec3::new(number(), number(), number());
            let mut all: Vec<(f64, u32)> =
                (points.iter().enumerate()).map(|(i, p)| (p.distance_squared(at), i as u32)).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let expected: Vec<u32> = all.iter().take(9).map(|(_, i)| *i).collect();
            let found: Vec<u32> = tree.nearest(at, 9).into_iter().map(|(_, i)| i).collect();
            assert_eq!(found, expected);
        }
        assert_eq!(tree.nearest(DVec3::ZERO, 900).len(), 500);
        assert!(PointTree::new(Vec::new()).nearest(DVec3::ZERO, 3).is_empty());
    }
}
