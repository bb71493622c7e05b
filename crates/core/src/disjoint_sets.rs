//! Disjoint sets (union-find).
//!
//! In: numbers from 0, and pairs that belong together. Out: sets, each identified by its smallest member.
//! Cost: almost constant for each step (R. Tarjan, *Efficiency of a good but not linear set union algorithm*,
//! 1975, with path halving).

use std::collections::BTreeMap;

/// Disjoint sets of numbers; the root of a set is its smallest member.
///
/// # Examples
/// ```
/// let mut sets = planish_core::DisjointSets::new(4);
/// assert!(sets.join(3, 1) && sets.join(1, 2) && !sets.join(2, 3));
/// assert_eq!(sets.root(3), 1);
/// assert_eq!(sets.into_roots(), [0, 1, 1, 1]);
/// ```
#[derive(Debug, Clone)]
pub struct DisjointSets {
    parent: Vec<u32>,
}

/// The connected groups of marked numbers, by smallest member; each in ascending order.
///
/// `neighbours` of a number may contain numbers that are not marked.
///
/// # Panics
/// If a neighbour is not below the count.
///
/// # Examples
/// ```
/// // A row of five, of which the third is not marked.
/// let beside = |n: usize| [n.saturating_sub(1), (n + 1).min(4)];
/// let groups = planish_core::connected_groups(&[true, true, false, true, true], beside);
/// assert_eq!(groups, [[0, 1], [3, 4]]);
/// ```
#[must_use]
pub fn connected_groups<N: IntoIterator<Item = usize>>(
    marked: &[bool],
    neighbours: impl Fn(usize) -> N,
) -> Vec<Vec<usize>> {
    let all_marked = || (0..marked.len()).filter(|&n| marked[n]);
    let mut sets = DisjointSets::new(marked.len());
    for n in all_marked() {
        for other in neighbours(n).into_iter().filter(|&other| marked[other]) {
            sets.join(n as u32, other as u32);
        }
    }
    let roots = sets.into_roots();
    let mut groups: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    all_marked().for_each(|n| groups.entry(roots[n]).or_default().push(n));
    groups.into_values().collect()
}

impl DisjointSets {
    /// Creates one set for each number below `count`, which is at most 2³².
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The smallest member of the set of a number.
    ///
    /// # Panics
    /// If a number is not below the count.
    pub fn root(&mut self, mut number: u32) -> u32 {
        while self.parent[number as usize] != number {
            let above = self.parent[self.parent[number as usize] as usize];
            self.parent[number as usize] = above;
            number = above;
        }
        number
    }

    /// Joins the sets of two numbers; returns false if they were joined already.
    ///
    /// # Panics
    /// If a number is not below the count.
    pub fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        // The smaller root stays, so that the result does not depend on the order of the pairs.
        self.parent[a.max(b) as usize] = a.min(b);
        a != b
    }

    /// The root of every number.
    #[must_use]
    pub fn into_roots(mut self) -> Vec<u32> {
        // Parents have smaller numbers, so those before a number already point to their root.
        for number in 0..self.parent.len() {
            self.parent[number] = self.parent[self.parent[number] as usize];
        }
        self.parent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::nth;

    #[test]
    fn roots_do_not_depend_on_the_order_of_the_pairs() {
        let pairs: Vec<[u32; 2]> =
            (0..60).map(|k| [nth(2 * k), nth(2 * k + 1)].map(|bits| (bits % 100) as u32)).collect();
        let joined = |pairs: &mut dyn Iterator<Item = &[u32; 2]>| {
            let mut sets = DisjointSets::new(100);
            pairs.for_each(|[a, b]| {
                sets.join(*a, *b);
            });
            sets
        };
        let mut forwards = joined(&mut pairs.iter());
        let one_by_one: Vec<u32> = (0..100).map(|k| forwards.root(k)).collect();
        assert_eq!(joined(&mut pairs.iter().rev()).into_roots(), one_by_one);
        assert!(pairs.iter().all(|[a, b]| one_by_one[*a as usize] == one_by_one[*b as usize]));
    }
}
