//! Repairs of damaged files: lengths, counts and checksums are made consistent again.
//!
//! Most damage changes a length or breaks a checksum, so that a reader rejects the file at once. Repaired
//! files reach the code behind these checks. A part of the files stays unrepaired, to test the checks.

use crate::valid;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Leaves the bytes as they are: formats without checksums or stored lengths.
pub(super) fn unchanged(_: &mut Vec<u8>, _: &mut ChaCha8Rng) {}

/// Compresses the bytes. In half of the cases, damages the compressed bytes too.
pub(super) fn pack_gzip(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    *bytes = valid::packed(bytes);
    if random.random() {
        damage_packed(bytes, random);
    }
}

/// Sets the header length to the length of the JSON object that follows, in half of the cases.
#[allow(clippy::ptr_arg, reason = "all repairs have one type")]
fn repair_safetensors_length(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 8 || random.random() {
        return;
    }
    // The tensors begin after the last brace of the header. Only the first 8 KiB are searched, because bytes
    // of tensors can look like braces.
    let near = bytes.len().min(8192);
    if let Some(end) = bytes[8..near].windows(2).rposition(|pair| pair == b"}}") {
        let length = (end + 2) as u64;
        bytes[..8].copy_from_slice(&length.to_le_bytes());
    }
}

/// Makes a saved model one of the first version, which had no checksums, in half of the cases: its numbers
/// then reach the checks of their ranges. Also repairs the length of the header.
pub(super) fn repair_model(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if random.random() {
        // Names of the same length keep the places of the tensors. Unknown keys are ignored.
        for (from, to) in [
            (br#"\"schema\":2"#.as_slice(), br#"\"schema\":1"#.as_slice()),
            (br#"\"sha256\""#, br#"\"sha000\""#),
            (br#"\"tensors\""#, br#"\"tensor0\""#),
            (br#"\"mean_residual\""#, br#"\"mean_residua0\""#),
        ] {
            // The header of a small model is shorter than this.
            let end = bytes.len().min(16_384);
            let places: Vec<usize> = (bytes[..end].windows(from.len()).enumerate())
                .filter(|(_, w)| *w == from)
                .map(|(at, _)| at)
                .collect();
            for at in places {
                bytes[at..at + to.len()].copy_from_slice(to);
            }
        }
    }
    repair_safetensors_length(bytes, random);
}

/// Damages compressed bytes in one to three places.
fn damage_packed(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    // Few changes: a decompressor stops at the first error.
    for _ in 0..random.random_range(1..4) {
        if bytes.is_empty() {
            return;
        }
        let at = random.random_range(0..bytes.len());
        match random.random_range(0..3) {
            0 => bytes[at] = random.random(),
            1 => bytes.truncate(at.max(1)),
            _ => drop(bytes.drain(at..bytes.len().min(at + 4))),
        }
    }
}

/// Sets the triangle count of a binary STL to match its length, in half of the cases.
pub(super) fn repair_stl_count(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 84 || bytes.starts_with(b"solid ") || random.random() {
        return;
    }
    // A header of 80 bytes, the count, and 50 bytes for each triangle.
    let count = (bytes.len() - 84) / 50;
    bytes.truncate(84 + 50 * count);
    bytes[80..84].copy_from_slice(&(count as u32).to_le_bytes());
}

/// Corrects the lengths of the file and of its first chunk, in half of the cases.
#[allow(clippy::ptr_arg, reason = "all repairs have one type")]
pub(super) fn repair_glb_lengths(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if bytes.len() < 28 || random.random() {
        return;
    }
    let length = (bytes.len() as u32).to_le_bytes();
    bytes[8..12].copy_from_slice(&length);
    if let Some(at) = bytes.windows(4).position(|w| w == b"BIN\0").filter(|&at| at >= 24) {
        bytes[12..16].copy_from_slice(&((at - 24) as u32).to_le_bytes());
    }
}

/// Puts the bytes into an archive. In half of the cases, damages the archive too.
pub(super) fn pack_npz(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    *bytes = valid::archive(bytes, random.random());
    if random.random() {
        damage_packed(bytes, random);
    }
}

/// Corrects the checksums of the pages, in three of four cases.
#[allow(clippy::ptr_arg, reason = "all repairs have one type")]
pub(super) fn repair_e57_checksums(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if random.random_range(0..4) == 0 {
        return;
    }
    for page in bytes.as_chunks_mut::<1024>().0 {
        let (body, sum) = page.split_at_mut(1020);
        // CRC-32C (Castagnoli polynomial, reflected), bit by bit.
        let crc = body.iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0x82f6_3b78 * (crc & 1)))
        });
        sum.copy_from_slice(&(!crc).to_be_bytes());
    }
}

/// Corrects the checksums of the chunks, in half of the cases.
#[allow(clippy::ptr_arg, reason = "all repairs have one type")]
pub(super) fn repair_png_checksums(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if random.random() {
        return;
    }
    let mut rest = bytes.get_mut(8..).unwrap_or_default();
    // A chunk is length, type, data and checksum; the checksum covers type and data. The walk ends at the
    // first length that damage has made too long.
    while let Some((&length, _)) = rest.split_first_chunk::<4>() {
        let end = (u32::from_be_bytes(length) as usize).saturating_add(8);
        let Some((chunk, after)) = rest.split_at_mut_checked(end) else {
            return;
        };
        let Some((sum, next)) = after.split_first_chunk_mut::<4>() else {
            return;
        };
        let mut crc = flate2::Crc::new();
        crc.update(&chunk[4..]);
        *sum = crc.sum().to_be_bytes();
        rest = next;
    }
}
