//! Formatting of numbers in messages.

/// Formats a number with the given number of significant digits.
///
/// Numbers from 1e-4 to below 1e6 have no exponent. A value that is not finite gives "–".
///
/// # Examples
/// ```
/// use planish_core::numbers::significant;
/// assert_eq!(significant(0.012_345, 3), "0.0123");
/// assert_eq!(significant(3e7, 2), "3.0e7");
/// assert_eq!(significant(f64::NAN, 3), "–");
/// ```
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    if value == 0.0 {
        return "0".to_owned();
    }
    // Rounding can carry into another digit (9.996 gives "10.00"), which costs a digit too many but no
    // accuracy.
    let exponent = value.abs().log10().floor() as i32;
    if !(-4..6).contains(&exponent) {
        return format!("{value:.*e}", digits - 1);
    }
    let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
    format!("{value:.decimals$}")
}
