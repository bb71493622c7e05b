//! Repeatable random numbers and hashes that do not depend on the number of threads.
//!
//! In: a seed, or the index of a reading. Out: 64 well mixed bits, and numbers made of them.
//!
//! Work that is spread over threads draws by index ([`nth`]), not from a generator: a generator would give
//! numbers that depend on the order of the work. For normal or long sequences the crates use ChaCha.
//!
//! Not guaranteed: the bits are not safe against attackers, who can choose inputs that collide.
//!
//! # References
//! Steele, Lea and Flood, *Fast splittable pseudorandom number generators*, OOPSLA 2014 (SplitMix64).

/// Step between the states of [`SplitMix64`]: 2⁶⁴ divided by the golden ratio, made odd.
///
/// Multiples of this constant are spread evenly over all 64-bit numbers, so neighbouring seeds get distant
/// states.
pub const GOLDEN_GAMMA: u64 = 0x9E37_79B9_7F4A_7C15;

/// Mixes the bits of a number: a bijection in which each input bit affects about half of the output bits.
///
/// # Examples
/// ```
/// use planish_core::random::mix64;
/// let changed = (mix64(1) ^ mix64(2)).count_ones();
/// assert!((16..=48).contains(&changed));
/// assert_eq!(mix64(0), 0);
/// ```
#[inline]
#[must_use]
pub fn mix64(mut bits: u64) -> u64 {
    // The published shifts and factors of SplitMix64; others would need tests of their own.
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^ (bits >> 31)
}

/// Number `index` (from 0) that [`SplitMix64`] draws with seed 0, without drawing those before it.
///
/// # Examples
/// ```
/// use planish_core::random::{SplitMix64, nth};
/// let mut random = SplitMix64::new(0);
/// assert_eq!([random.next_u64(), random.next_u64()], [nth(0), nth(1)]);
/// ```
#[inline]
#[must_use]
pub fn nth(index: u64) -> u64 {
    // One more than the index, because the generator steps before it mixes.
    mix64(index.wrapping_add(1).wrapping_mul(GOLDEN_GAMMA))
}

/// A number in `[0, 1)` from the upper 53 of 64 random bits: all that an `f64` holds.
///
/// # Examples
/// ```
/// use planish_core::random::unit_interval;
/// assert_eq!([unit_interval(0), unit_interval(1 << 63)], [0.0, 0.5]);
/// assert!(unit_interval(u64::MAX) < 1.0);
/// ```
#[inline]
#[must_use]
pub fn unit_interval(bits: u64) -> f64 {
    // The lower bits are dropped before the conversion, which would round the largest numbers up to 1.
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

/// A number in `[−1, 1)` from the upper 53 of 64 random bits.
///
/// # Examples
/// ```
/// use planish_core::random::signed_unit_interval;
/// assert_eq!([signed_unit_interval(0), signed_unit_interval(1 << 63)], [-1.0, 0.0]);
/// ```
#[inline]
#[must_use]
pub fn signed_unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A small generator of random bits: equal seeds give equal sequences.
///
/// # Examples
/// ```
/// use planish_core::random::{SplitMix64, unit_interval};
/// let mut random = SplitMix64::new(7);
/// let mean = (0..1000).map(|_| unit_interval(random.next_u64())).sum::<f64>() / 1000.0;
/// assert!((mean - 0.5).abs() < 0.05);
/// ```
#[derive(Debug, Clone)]
pub struct SplitMix64 {
    state: u64,
}

impl SplitMix64 {
    /// Starts a sequence.
    ///
    /// Seeds that differ by a multiple of [`GOLDEN_GAMMA`] give the same sequence, shifted.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 64 bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN_GAMMA);
        mix64(self.state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first outputs of the published generator (S. Vigna, `splitmix64.c`) with seed 1234567.
    #[test]
    fn outputs_equal_those_of_the_published_generator() {
        let mut random = SplitMix64::new(1_234_567);
        let drawn = [random.next_u64(), random.next_u64(), random.next_u64()];
        assert_eq!(drawn, [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]);
    }
}
