//! Formatting of numbers for the command line and for reports.

pub use planish_core::numbers::significant;

/// Formats a count, with spaces between thousands from five digits on.
///
/// # Examples
/// ```
/// use planish_report::numbers::count;
/// assert_eq!([count(1234), count(1_234_567)], ["1234", "1 234 567"]);
/// ```
#[must_use]
pub fn count(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            // Four digits are readable without a separator.
            if digits.len() > 4 {
                text.push(' ');
            }
        }
        text.push(digit);
    }
    text
}

/// Formats a fraction in per cent, with one decimal.
///
/// # Examples
/// ```
/// assert_eq!(planish_report::numbers::percent(0.123), "12.3 %");
/// ```
#[must_use]
pub fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// A count with its noun in singular or plural; plurals of nouns in -ch and -ex are formed correctly.
///
/// # Examples
/// ```
/// use planish_report::numbers::counted;
/// assert_eq!([counted(1, "scan"), counted(2, "scan")], ["1 scan", "2 scans"]);
/// assert_eq!([counted(2, "patch"), counted(2, "vertex")], ["2 patches", "2 vertices"]);
/// ```
#[must_use]
pub fn counted(n: usize, what: &str) -> String {
    let noun = match what.strip_suffix("ex") {
        _ if n == 1 => what.to_owned(),
        Some(stem) => format!("{stem}ices"),
        None if what.ends_with("ch") => format!("{what}es"),
        None if what.ends_with("dy") => what.replacen("dy", "dies", 1),
        None => format!("{what}s"),
    };
    format!("{} {noun}", count(n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_leading_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1234.567, "1235"),
            (-0.012_345, "-0.01235"),
            (1.0, "1.000"),
            (1.5e-9, "1.500e-9"),
            (3e7, "3.000e7"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(significant(value, 4), text);
        }
        assert_eq!(
            [count(7), count(1234), count(12345), count(1_234_567)],
            ["7", "1234", "12 345", "1 234 567"]
        );
        assert_eq!([counted(1, "face"), counted(2, "face")], ["1 face", "2 faces"]);
        assert_eq!(
            [counted(1, "patch"), counted(2, "patch"), counted(2, "control vertex")],
            ["1 patch", "2 patches", "2 control vertices"]
        );
    }
}
