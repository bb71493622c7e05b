//! Numbers that look random and are always the same.

use nalgebra::DVector;

/// SplitMix64.
///
/// # References
/// Steele, Lea and Flood 2014, *Fast splittable pseudorandom number generators*.
pub(super) struct Draws {
    state: u64,
}

impl Draws {
    pub(super) fn new(seed: u64) -> Self {
        Self { state: seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) }
    }

    /// Uniform from −1 to 1.
    pub(super) fn uniform(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        (mixed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Of mean 0 and variance 1, near enough to normal: a sum of three uniform ones.
    pub(super) fn spread(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.uniform() + self.uniform() + self.uniform())
    }
}
