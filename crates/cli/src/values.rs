//! Parsers of option values that several commands share.
//!
//! Each parser gets the text of one value and returns the value, or a message that begins with `needed` and
//! names what was expected. clap prints the option and the text that was found in front of it.

use planish::Length;
use planish::Unit;

/// Largest number of threads that is accepted; larger numbers are typing errors.
const MAX_THREADS: usize = 1024;

/// A finite number for which `good` is true; `needed` describes it.
pub fn within(text: &str, needed: &str, good: impl Fn(f64) -> bool) -> Result<f64, String> {
    match text.parse::<f64>() {
        Err(_) => Err("expected a number".to_owned()),
        // Rust parses `inf` and `NaN` as numbers, but no option has a use for them.
        Ok(value) if value.is_finite() && good(value) => Ok(value),
        Ok(_) => Err(format!("expected {needed}")),
    }
}

/// A number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    within(text, "a number above 0", |v| v > 0.0)
}

/// A number that is at least 0.
pub fn not_negative(text: &str) -> Result<f64, String> {
    within(text, "a number that is not below 0", |v| v >= 0.0)
}

/// A share from 0 to 1, both included.
pub fn share(text: &str) -> Result<f64, String> {
    within(text, "a share from 0 to 1", |v| (0.0..=1.0).contains(&v))
}

/// A probability between 0 and 1, both excluded.
pub fn probability(text: &str) -> Result<f64, String> {
    within(text, "a probability above 0 and below 1", |v| v > 0.0 && v < 1.0)
}

/// An angle in degrees, above 0 and at most 90.
pub fn right_angle(text: &str) -> Result<f64, String> {
    within(text, "an angle above 0 and up to 90 degrees", |v| v > 0.0 && v <= 90.0)
}

/// A length above 0, with or without its unit.
pub fn length(text: &str) -> Result<Length, String> {
    // Only trailing letters are the unit, so that `1e-3mm` keeps its exponent.
    let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match text[number.len()..].trim() {
        "" => None,
        name => Some(name.parse::<Unit>().map_err(|e| e.to_string())?),
    };
    let value = positive(number.trim())?;
    Ok(Length { value, unit })
}

/// A whole number of at least 0.
pub fn count(text: &str) -> Result<usize, String> {
    text.parse().map_err(|_| "expected a whole number that is not below 0".to_owned())
}

/// A whole number of at least 1.
pub fn positive_count(text: &str) -> Result<usize, String> {
    match count(text) {
        // The message of `count` would allow 0, so both failures get the same message here.
        Ok(n @ 1..) => Ok(n),
        _ => Err("expected a whole number above 0".to_owned()),
    }
}

/// A step between pixels, from 1 to 1024.
pub fn pixel_step(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 1..=1024) => Ok(n),
        _ => Err("expected a whole number from 1 to 1024".to_owned()),
    }
}

/// A seed of random numbers.
// The message states the range because `u64` rejects both negative and larger numbers.
pub fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

/// A number of threads.
pub fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(threads @ 1..=MAX_THREADS) => Ok(threads),
        _ => Err(format!("expected a whole number from 1 to {MAX_THREADS}")),
    }
}

/// A size of memory in bytes, as in `8GB` or `512MiB`.
pub fn memory(text: &str) -> Result<u64, String> {
    // Below, the program itself does not fit, and a number without its unit is a typing error.
    const LEAST: f64 = 64e6;
    let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let factor = match text[number.len()..].to_ascii_lowercase().as_str() {
        "mb" => Some(1e6),
        "gb" => Some(1e9),
        "tb" => Some(1e12),
        "mib" => Some(1024.0_f64.powi(2)),
        "gib" => Some(1024.0_f64.powi(3)),
        "tib" => Some(1024.0_f64.powi(4)),
        _ => None,
    };
    let bytes = factor.zip(number.trim().parse::<f64>().ok()).map(|(factor, number)| factor * number);
    match bytes.filter(|bytes| bytes.is_finite() && *bytes >= LEAST) {
        Some(bytes) => Ok(bytes as u64),
        None => Err("expected a size of at least 64 MB with its unit, as in 8GB".to_owned()),
    }
}

/// Cells along u and v, as in `61x61`.
pub fn grid(text: &str) -> Result<[usize; 2], String> {
    // Larger numbers are typing errors. Commands have tighter limits by memory.
    let cells = |part: &str| part.trim().parse::<usize>().ok().filter(|n| (1..=1 << 14).contains(n));
    // Summaries print sizes with ×, so it is accepted as well.
    let parts: Vec<Option<usize>> = text.split(['x', 'X', '×']).map(cells).collect();
    match parts[..] {
        [Some(u), Some(v)] => Ok([u, v]),
        _ => Err("expected cells along u and v, each from 1 to 16384, as in 61x61".to_owned()),
    }
}

/// Columns and rows of an image, as in `640x480`.
pub fn pixels(text: &str) -> Result<[usize; 2], String> {
    grid(text).map_err(|_| {
        "expected a size in pixels, columns and rows, each from 1 to 16384, as in 640x480".to_owned()
    })
}

/// A range of disparities in pixels, as in `0..127`.
pub fn disparities(text: &str) -> Result<[i32; 2], String> {
    let ends: Vec<Option<i32>> = text.split("..").map(|end| end.trim().parse().ok()).collect();
    match ends[..] {
        [Some(first), Some(last)] if first < last => Ok([first, last]),
        _ => Err("expected the minimum and the maximum disparity, as in 0..127".to_owned()),
    }
}

/// Two opposite corners of a box, returned as its minimum and maximum corner.
pub fn corners(text: &str) -> Result<[[f64; 3]; 2], String> {
    // `numbers` would ask for six numbers without saying that they are two corners.
    let numbers: Option<Vec<f64>> =
        (text.split(',')).map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[a, b, c, d, e, f]) => Ok([[a.min(d), b.min(e), c.min(f)], [a.max(d), b.max(e), c.max(f)]]),
        _ => Err("expected six numbers: two opposite corners, as in 0,0,0,10,10,5".to_owned()),
    }
}

/// `N` finite numbers, separated by commas; `example` is quoted in the message.
pub fn numbers<const N: usize>(text: &str, example: &str) -> Result<[f64; N], String> {
    let found: Option<Vec<f64>> =
        text.split(',').map(|w| w.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    found
        .and_then(|v| <[f64; N]>::try_from(v).ok())
        .ok_or_else(|| format!("expected {N} numbers, as in {example}"))
}
