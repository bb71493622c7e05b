//! Damages valid files the way that disks, editors, other programs and attackers do.
//!
//! In: valid files of one format, words of that format, and a random generator. Out: the bytes of a mostly
//! valid file. Not guaranteed: that a change matters to the reader.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Maximum growth of a file in bytes. Larger files cost time, and bugs of readers show in small files, too.
const MAX_GROWTH: usize = 1 << 16;

/// Numbers in text that are special to parsers: limits of integer types, NaN, infinities, decimal commas.
const NUMBERS: [&str; 26] = [
    "0",
    "1",
    "-1",
    "2",
    "3",
    "7",
    "255",
    "256",
    "65535",
    "65536",
    "2147483647",
    "2147483648",
    "-2147483648",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "99999999999999999999999",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "1e-320",
    "0.1",
    "1,5",
];

/// Integers in binary, at and beside the limits of their types.
const INTEGERS: [u64; 20] = [
    0,
    1,
    2,
    3,
    4,
    16,
    127,
    128,
    255,
    256,
    32767,
    65535,
    65536,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    u64::MAX,
];

/// Floating point values that no sensor reports.
const FLOATS: [f64; 10] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1e308, -1e308, 1e-320, -1.0, 0.5];

/// One of the `valid` files, changed one, two, four or eight times.
pub fn damaged(valid: &[Vec<u8>], words: &[&str], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = valid[random.random_range(0..valid.len())].clone();
    let longest = bytes.len() + MAX_GROWTH;
    // A single change tests one check. Several together reach code that expects two values to agree.
    for _ in 0..1 << random.random_range(0..4) {
        change(&mut bytes, valid, words, random);
        bytes.truncate(longest);
    }
    bytes
}

/// A random position in `0..=length`. Half of them are near the beginning, because headers are short.
fn place(length: usize, random: &mut ChaCha8Rng) -> usize {
    let last = match random.random_range(0..4) {
        0 => length.min(64),
        1 => length.min(400),
        _ => length,
    };
    random.random_range(0..=last)
}

/// A random range of bytes; short ranges are more frequent.
fn run(length: usize, random: &mut ChaCha8Rng) -> std::ops::Range<usize> {
    let start = place(length, random);
    // A power of two that is drawn first: short and long runs are both frequent, whatever the length of
    // the file.
    let longest = 1_usize << random.random_range(0..12);
    start..length.min(start + random.random_range(0..=longest))
}

/// The range of the word at a position: between blanks, separators, quotes and brackets.
fn token(bytes: &[u8], at: usize) -> std::ops::Range<usize> {
    // One set of separators for all formats: words of text, TOML and JSON alike are replaced as a whole.
    let ends = |b: &u8| b.is_ascii_whitespace() || b",;=:\"[]{}".contains(b);
    let at = at.min(bytes.len());
    let start = bytes[..at].iter().rposition(ends).map_or(0, |k| k + 1);
    let end = bytes[at..].iter().position(ends).map_or(bytes.len(), |k| at + k);
    start..end
}

/// Overwrites bytes from a position on, as far as the file reaches.
fn overwrite(bytes: &mut [u8], at: usize, with: &[u8]) {
    for (to, from) in bytes.iter_mut().skip(at).zip(with) {
        *to = *from;
    }
}

/// Applies one random change. The weights of the kinds of damage are the numbers of their cases.
pub fn change(bytes: &mut Vec<u8>, valid: &[Vec<u8>], words: &[&str], random: &mut ChaCha8Rng) {
    let length = bytes.len();
    match random.random_range(0..16) {
        0 => {
            let at = place(length, random);
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.random_range(0..8);
            }
        }
        1 => {
            let at = place(length, random);
            overwrite(bytes, at, &[random.random()]);
        }
        2 | 3 => {
            let integer = INTEGERS[random.random_range(0..INTEGERS.len())];
            let size = 1 << random.random_range(0..4);
            let mut written = integer.to_le_bytes()[..size].to_vec();
            // Most formats are little-endian, some big-endian.
            if random.random_range(0..4) == 0 {
                written.reverse();
            }
            // Fields of binary headers mostly start at even offsets.
            let at = place(length, random) & !random.random_range(0..2_usize);
            overwrite(bytes, at, &written);
        }
        4 => {
            let value = FLOATS[random.random_range(0..FLOATS.len())];
            let at = place(length, random);
            if random.random() {
                overwrite(bytes, at, &value.to_le_bytes());
            } else {
                overwrite(bytes, at, &(value as f32).to_le_bytes());
            }
        }
        5 => bytes.truncate(random.random_range(0..=length)),
        6 => drop(bytes.drain(run(length, random))),
        7 => {
            // Repetition also tests nesting and long lists, where recursion or doubling would show.
            let copied = bytes[run(length, random)].repeat(1 << random.random_range(0..5));
            let at = place(length, random);
            bytes.splice(at..at, copied);
        }
        8 => {
            let other = &valid[random.random_range(0..valid.len())];
            let copied = other[run(other.len(), random)].to_vec();
            let replaced = run(length, random);
            bytes.splice(replaced, copied);
        }
        9 => {
            // Joins the head of one file to the tail of another.
            let other = &valid[random.random_range(0..valid.len())];
            let (head, tail) = (place(length, random), place(other.len(), random));
            bytes.truncate(head);
            bytes.extend_from_slice(&other[tail..]);
        }
        10 | 11 => {
            let number = NUMBERS[random.random_range(0..NUMBERS.len())];
            let digits: Vec<usize> = (0..length.min(4096)).filter(|&k| bytes[k].is_ascii_digit()).collect();
            if !digits.is_empty() {
                let replaced = token(bytes, digits[random.random_range(0..digits.len())]);
                bytes.splice(replaced, number.bytes());
            }
        }
        12 => {
            // Replacing a digit by a digit keeps the lengths and offsets in the rest of the file valid.
            let digits: Vec<usize> = (0..length.min(8192)).filter(|&k| bytes[k].is_ascii_digit()).collect();
            if !digits.is_empty() {
                bytes[digits[random.random_range(0..digits.len())]] = b'0' + random.random_range(0..10_u8);
            }
        }
        13 if !words.is_empty() => {
            let word = words[random.random_range(0..words.len())];
            let replaced = match place(length, random) {
                at if random.random() => at..at,
                at => token(bytes, at),
            };
            bytes.splice(replaced, word.bytes());
        }
        14 => {
            // Order matters in headers. Only the first lines are touched: bodies have equal lines.
            let mut lines: Vec<&[u8]> = bytes.split_inclusive(|&b| b == b'\n').take(64).collect();
            let rest = bytes[lines.iter().map(|line| line.len()).sum::<usize>()..].to_vec();
            if lines.len() > 1 {
                let (from, to) = (random.random_range(0..lines.len()), random.random_range(0..lines.len()));
                match random.random_range(0..3) {
                    0 => lines.swap(from, to),
                    1 => drop(lines.remove(from)),
                    _ => lines.insert(to, lines[from]),
                }
            }
            *bytes = [lines.concat(), rest].concat();
        }
        _ => {
            let range = run(length, random);
            let fill = [0, 0xff, b' ', b'0', b'\n'][random.random_range(0..5_usize)];
            bytes[range].fill(fill);
        }
    }
}
