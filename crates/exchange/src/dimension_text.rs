//! Texts of dimensions: the length that they state, and the sign of a diameter.

/// Signs of a diameter in texts: the code of DXF, and characters in use.
const DIAMETER_SIGNS: [&str; 7] = ["%%c", "%%C", "Ø", "ø", "⌀", "∅", "\\U+2205"];

pub(crate) fn has_diameter_sign(text: &str) -> bool {
    DIAMETER_SIGNS.iter().any(|sign| text.contains(sign))
}

/// The text without codes for its format.
pub(crate) fn plain_text(text: &str) -> String {
    let mut plain = String::new();
    let mut left = text;
    while let Some(at) = left.find('\\') {
        plain.push_str(&left[..at]);
        let code = &left[at + 1..];
        left = match (code.chars().next(), code.find(';')) {
            (Some('P' | '~' | 'L' | 'l' | 'O' | 'o' | 'K' | 'k'), _) => &code[1..],
            (Some(_), Some(end)) => &code[end + 1..],
            _ => "",
        };
        plain.push(' ');
    }
    plain.push_str(left);
    let braces: &[char] = &['{', '}'];
    let plain = plain.replace(braces, "").replace("%%c", "Ø").replace("%%C", "Ø");
    plain.replace("%%p", "±").replace("%%P", "±").trim().to_owned()
}

/// Number in the text of a dimension, and half of its last digit; none if the text has no number of its own.
pub(crate) fn stated_length(text: &str) -> Option<(f64, f64)> {
    // `<>` is replaced by the measurement, so numbers around it are additions such as tolerances. Codes such
    // as `\\A1;` format the text.
    if text.contains("<>") {
        return None;
    }
    let plain = plain_text(text).replace(',', ".");
    let begin = plain.find(|c: char| c.is_ascii_digit())?;
    let number: String = plain[begin..].chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
    let number = number.trim_end_matches('.');
    // Counts (`4x 5`), fractions, angles and threads (`M8`) are not lengths.
    let behind = plain[begin + number.len()..].trim_start();
    let before = plain[..begin].trim_end();
    if behind.starts_with(['x', 'X', '/', '°', '×', '%']) || before.ends_with(['M', '/', '-']) {
        return None;
    }
    let decimals = number.split_once('.').map_or(0, |(_, d)| d.len() as i32);
    // Slightly more than half a digit, so that a length exactly between two roundings is accepted.
    Some((number.parse().ok()?, 0.5 * 10_f64.powi(-decimals) * 1.001))
}
