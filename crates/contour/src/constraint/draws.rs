//! Reproducible pseudorandom numbers for perturbed drawings.
//!
//! A generator of its own keeps results independent of versions of the `rand` crate.

use nalgebra::DVector;
use planish_core::random::{SplitMix64, mix64, signed_unit_interval};

pub(super) struct Draws {
    random: SplitMix64,
}

impl Draws {
    /// A generator; different seeds give unrelated sequences.
    pub(super) fn new(seed: u64) -> Self {
        // Mixed, because seeds that differ by a multiple of the generator's step give one sequence, shifted.
        Self { random: SplitMix64::new(mix64(seed.wrapping_add(1))) }
    }

    /// A number uniform in [−1, 1).
    pub(super) fn uniform(&mut self) -> f64 {
        signed_unit_interval(self.random.next_u64())
    }

    /// Numbers of mean 0 and variance 1, approximately normal: each is the sum of three uniform ones, whose
    /// variance is 1/3.
    pub(super) fn spread(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.uniform() + self.uniform() + self.uniform())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_seeds_share_no_numbers() {
        let drawn = |seed: u64| {
            let mut draws = Draws::new(seed);
            (0..64).map(|_| draws.uniform().to_bits()).collect::<std::collections::HashSet<u64>>()
        };
        let all: Vec<_> = (0..8).map(drawn).collect();
        for (k, first) in all.iter().enumerate() {
            for second in &all[k + 1..] {
                assert_eq!(first.intersection(second).count(), 0, "{k}");
            }
        }
    }
}
