//! Reproducible pseudorandom numbers for perturbed drawings.
//!
//! A generator of its own keeps results independent of versions of the `rand` crate.

use nalgebra::DVector;
use planish_core::random::{GOLDEN_GAMMA, SplitMix64, signed_unit_interval};

pub(super) struct Draws {
    random: SplitMix64,
}

impl Draws {
    /// A generator; different seeds give unrelated sequences.
    pub(super) fn new(seed: u64) -> Self {
        Self { random: SplitMix64::new(seed.wrapping_add(1).wrapping_mul(GOLDEN_GAMMA)) }
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
