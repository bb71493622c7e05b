//! Reproducible pseudorandom numbers for perturbed drawings.
//!
//! A generator of its own keeps results independent of versions of the `rand` crate.

use nalgebra::DVector;

/// SplitMix64 generator.
///
/// # References
/// Steele, Lea and Flood 2014, *Fast splittable pseudorandom number generators*.
pub(super) struct Draws {
    state: u64,
}

impl Draws {
    /// A generator; different seeds give unrelated sequences.
    pub(super) fn new(seed: u64) -> Self {
        Self { state: seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15) }
    }

    /// A number uniform in [−1, 1).
    pub(super) fn uniform(&mut self) -> f64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.state;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        (mixed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Numbers of mean 0 and variance 1, approximately normal: each is the sum of three uniform ones, whose
    /// variance is 1/3.
    pub(super) fn spread(&mut self, n: usize) -> DVector<f64> {
        DVector::from_fn(n, |_, _| self.uniform() + self.uniform() + self.uniform())
    }
}
