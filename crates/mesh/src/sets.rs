//! Disjoint sets.
//!
//! Comes in: numbers from 0, and pairs of them that belong together. Goes out: sets, each named by its least
//! member. Cost: next to constant for each step (R. Tarjan, *Efficiency of a good but not linear set union
//! algorithm*, 1975, with paths halved). Not guaranteed: anything for numbers beyond the count, for which
//! steps panic.

/// Disjoint sets of numbers; the root of a set is its least member.
///
/// # Examples
/// ```
/// let mut sets = planish_mesh::DisjointSets::new(4);
/// assert!(sets.join(3, 1) && sets.join(1, 2) && !sets.join(2, 3));
/// assert_eq!([0, 1, 2, 3].map(|k| sets.root(k)), [0, 1, 1, 1]);
/// ```
#[derive(Debug, Clone)]
pub struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// Each number alone.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The least member of a number's set.
    ///
    /// # Panics
    /// Where there is no such number.
    pub fn root(&mut self, mut of: u32) -> u32 {
        while self.parent[of as usize] != of {
            let above = self.parent[self.parent[of as usize] as usize];
            self.parent[of as usize] = above;
            of = above;
        }
        of
    }

    /// Makes the sets of two numbers one; whether they were two.
    ///
    /// # Panics
    /// Where there is no such number.
    pub fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
        a != b
    }
}
