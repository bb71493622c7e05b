//! Numbers that look random and are always the same.

use nalgebra::DVector;
use planish_core::random::{GOLDEN_GAMMA, SplitMix64, signed_unit_interval};

pub(super) struct Draws {
    random: SplitMix64,
}

impl Draws {
    pub(super) fn new(seed: u64) -> Self {
        Self { random: SplitMix64::new(seed.wrapping_add(1).wrapping_mul(GOLDEN_GAMMA)) }
    }

    /// Uniform from −1 to 1.
    pub(super) fn uniform(&mut self) -> f64 {
        signed_unit_interval(self.random.next_u64())
    }

    /// Of mean 0 and variance 1, near enough to normal: a sum of three uniform ones.
    pub(super) fn spread(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.uniform() + self.uniform() + self.uniform())
    }
}
