//! Repeatable hashes of coordinates and point numbers.

use planish_core::random::{GOLDEN_GAMMA, mix64, unit_interval};
use std::hash::Hasher;

/// Hashes the bits of coordinates.
///
/// The standard hasher is safe against attackers, but would take a tenth of the time of reading a large
/// cloud.
#[derive(Default)]
pub(crate) struct BitsHasher(u64);

impl Hasher for BitsHasher {
    fn write(&mut self, bytes: &[u8]) {
        for part in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..part.len()].copy_from_slice(part);
            self.0 = (self.0.rotate_left(23) ^ u64::from_le_bytes(word)).wrapping_mul(GOLDEN_GAMMA);
        }
    }

    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 32)
    }
}

/// A repeatable number in [0, 1) for a point of a scan, uniform over points.
pub(crate) fn hash01(seed: u64, scan: u64, point: u64) -> f64 {
    // 40 bits for the point leave 24 for the scan.
    unit_interval(mix64(mix64(seed.wrapping_mul(GOLDEN_GAMMA) ^ (scan << 40) ^ point)))
}
