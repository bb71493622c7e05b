//! Lengths with units in the sentences of `--given`.

use planish_core::Length;
use planish_estimate::{Error, Result};
use planish_exchange::Unit;

/// A sentence whose lengths have units, as `P1P2 is 100mm long` or `P1 at (0 mm, 1 in)`, with the numbers
/// that these are in the drawing's unit.
pub(super) fn in_unit(sentence: &str, unit: Unit) -> Result<String> {
    let mut words: Vec<String> = Vec::new();
    for word in sentence.split_whitespace() {
        // A number may follow a parenthesis or `=`, and may be followed by a comma or parenthesis.
        let start = word.rfind(['(', '=']).map_or(0, |k| k + 1);
        let end = word.trim_end_matches([',', ')']).len().max(start);
        let inner = &word[start..end];
        if let (Ok(own), Some(number)) = (inner.parse::<Unit>(), words.last().and_then(|w| as_number(w)))
            && let Some(last) = words.last_mut()
        {
            let value = Length { value: number.1, unit: Some(own) };
            *last = format!("{}{}{}", &last[..number.0], value.in_unit(unit), &word[end..]);
            continue;
        }
        let number = inner.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let name = &inner[number.len()..];
        match number.parse::<f64>() {
            Ok(value) if !name.is_empty() && name != "deg" => {
                let own: Unit = name
                    .parse()
                    .map_err(|e: Error| e.in_context(format!("constraint `{}`", sentence.trim())))?;
                let value = Length { value, unit: Some(own) }.in_unit(unit);
                words.push(format!("{}{value}{}", &word[..start], &word[end..]));
            }
            _ => words.push(word.to_owned()),
        }
    }
    Ok(words.join(" "))
}

/// The number at the end of a word, with its start.
fn as_number(word: &str) -> Option<(usize, f64)> {
    let start = word.rfind(['(', '=']).map_or(0, |k| k + 1);
    word[start..].parse().ok().map(|value| (start, value))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_sentences_may_have_units() {
        let read = |sentence: &str| in_unit(sentence, Unit::Millimetre).unwrap();
        assert_eq!(read("P1P2 is 100mm long"), "P1P2 is 100 long");
        assert_eq!(read("P1P2 is 0.5 m long"), "P1P2 is 500 long");
        assert_eq!(read("P1 at (1in, 2 in)"), "P1 at (25.4, 50.8)");
        assert_eq!(read("x1 = 2in"), "x1 = 50.8");
        assert_eq!(read("P1P2 to P2P3 is 60deg"), "P1P2 to P2P3 is 60deg");
        assert_eq!(read("circle 1 has the radius of circle 2"), "circle 1 has the radius of circle 2");
        let message = in_unit("P1P2 is 100km long", Unit::Millimetre).unwrap_err().to_string();
        assert!(
            message.contains("constraint `P1P2 is 100km long`") && message.contains("expected `mm`"),
            "{message}"
        );
    }
}
