//! Unresolved shape of the whole surface, as a function of how far its leaves bend.
//!
//! Shape that is too weak to be found in a leaf is found in all of them together. It is not the same
//! everywhere: what cells and prior cannot follow is larger where the surface turns more within a leaf. Pairs
//! of readings are pooled over leaves of similar bending, and the mean square of the shape is the best
//! non-decreasing function of the bending (isotonic regression). No law of the shape is assumed. The bending
//! of a leaf is `∫ κ1² + κ2² dA`, about the square of the angle by which its normals turn.
//!
//! # References
//! Barlow, Bartholomew, Bremner, Brunk, *Statistical inference under order restrictions*, 1972 (the
//! pool-adjacent-violators algorithm).

use super::pair_sums::LagSums;

/// Groups of leaves of similar bending, at most, and the smallest number of their pairs: 2000 pairs show a
/// mean square of a fifteenth of the variance of a reading.
const MAX_GROUPS: usize = 12;
const MIN_PAIRS: f64 = 2000.0;

/// The mean square of unresolved shape by the bending of a leaf.
pub(super) struct MisfitByBending {
    /// Bending and mean square of groups, both increasing.
    points: Vec<[f64; 2]>,
}

/// Leaves of similar bending.
#[derive(Clone, Copy, Default)]
struct Group {
    sums: LagSums,
    /// `Σ q · bending`, with the weights `q` of the pairs.
    bending: f64,
}

impl Group {
    fn add(&mut self, other: &Self) {
        self.sums.add(&other.sums);
        self.bending += other.bending;
    }

    fn mean_square(&self) -> f64 {
        self.sums.at_zero().map_or(0.0, |(square, _)| square)
    }
}

impl MisfitByBending {
    /// From the bending of leaves and their pairs. None without pairs, or unless the leaves are known to have
    /// shape (`is_known`) or those that bend most show it at `significant` standard deviations.
    pub(super) fn new(
        leaves: impl Iterator<Item = (f64, LagSums)>,
        is_known: bool,
        significant: f64,
    ) -> Option<Self> {
        let mut leaves: Vec<(f64, LagSums)> = leaves.filter(|(_, sums)| sums.count > 0.0).collect();
        leaves.sort_by(|a, b| a.0.total_cmp(&b.0));
        let groups = groups(&leaves);
        let mut above = LagSums::default();
        let shows_shape = groups.iter().rev().any(|group| {
            above.add(&group.sums);
            above.at_zero().is_some_and(|(square, variance)| square > significant * variance.sqrt())
        });
        let points = (non_decreasing(groups).iter())
            .map(|group| [group.bending / group.sums.weight(), group.mean_square().max(0.0)])
            .collect();
        (is_known || shows_shape).then_some(Self { points })
    }

    /// The mean square for a leaf of the given bending: linear between groups, constant beyond them.
    pub(super) fn at(&self, bending: f64) -> f64 {
        let after = self.points.partition_point(|[x, _]| *x < bending);
        match (after.checked_sub(1).map(|before| self.points[before]), self.points.get(after)) {
            (Some([x0, y0]), Some(&[x1, y1])) => y0 + (y1 - y0) * (bending - x0) / (x1 - x0),
            (Some([_, y]), None) | (None, Some(&[_, y])) => y,
            (None, None) => 0.0,
        }
    }
}

/// Groups of leaves in order, each with about the same number of pairs.
fn groups(leaves: &[(f64, LagSums)]) -> Vec<Group> {
    let all: f64 = leaves.iter().map(|(_, sums)| sums.count).sum();
    let wanted = MIN_PAIRS.max(all / MAX_GROUPS as f64);
    let mut groups: Vec<Group> = Vec::new();
    let mut own = Group::default();
    for (bending, sums) in leaves {
        own.add(&Group { sums: *sums, bending: bending * sums.weight() });
        if own.sums.count >= wanted {
            groups.push(std::mem::take(&mut own));
        }
    }
    match groups.last_mut() {
        Some(last) => last.add(&own),
        None if own.sums.count > 0.0 => groups.push(own),
        None => {}
    }
    groups
}

/// The groups with those joined that would decrease.
fn non_decreasing(groups: Vec<Group>) -> Vec<Group> {
    let mut joined: Vec<Group> = Vec::new();
    for mut group in groups {
        while let Some(before) = joined.pop_if(|before| before.mean_square() >= group.mean_square()) {
            group.add(&before);
        }
        joined.push(group);
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::random::{SplitMix64, unit_interval};

    /// A pair of a leaf whose shape has the mean square `square` and is common to readings up to one spacing
    /// apart, with noise of variance 1.
    fn leaf(square: f64, random: &mut SplitMix64) -> LagSums {
        let mut draw = || (0..12).map(|_| unit_interval(random.next_u64())).sum::<f64>() - 6.0;
        let distance = 0.75 + 0.1 * draw();
        let [first, second] = [draw(), draw()];
        let share = 1.0 - distance;
        let other = share * first + (1.0 - share * share).max(0.0).sqrt() * second;
        let [a, b] = [square.sqrt() * first + draw(), square.sqrt() * other + draw()];
        let mut sums = LagSums::default();
        sums.add_pair(distance, a * b, 1.0);
        sums
    }

    /// Otherwise σ would be too large where a surface is flat, and too small where it bends.
    #[test]
    fn shape_that_grows_with_bending_is_found_at_each_bending() {
        let mut random = SplitMix64::new(3);
        let leaves: Vec<(f64, LagSums)> = (0..400_000)
            .map(|_| {
                let bending = unit_interval(random.next_u64());
                (bending, leaf(bending, &mut random))
            })
            .collect();
        let found = MisfitByBending::new(leaves.into_iter(), false, 3.0).unwrap();
        for bending in [0.1, 0.3, 0.5, 0.7, 0.9] {
            let square = found.at(bending);
            assert!((square - bending).abs() < 0.2, "{bending}: {square}");
        }
        assert!(found.at(-1.0) <= found.at(0.1) && found.at(2.0) >= found.at(0.9));
    }

    /// Otherwise σ would be too large by chance.
    #[test]
    fn noise_rarely_shows_shape() {
        let shows_shape = |seed: u64| {
            let mut random = SplitMix64::new(seed);
            let leaves: Vec<(f64, LagSums)> =
                (0..20_000).map(|k| (f64::from(k), leaf(0.0, &mut random))).collect();
            MisfitByBending::new(leaves.into_iter(), false, 3.0).is_some()
        };
        assert!((0..100).filter(|&seed| shows_shape(seed)).count() <= 3);
        assert!(MisfitByBending::new(std::iter::empty(), false, 3.0).is_none());
    }
}
