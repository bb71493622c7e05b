//! The secret in the address of the page.

use planish::{Error, Result};
use std::hint::black_box;

/// Size of a token. 128 bits cannot be guessed: at a million requests per second, half of the tokens take
/// more than 10^24 years.
const BYTES: usize = 16;

/// A random token, as hexadecimal digits.
pub(super) struct Token(String);

impl Token {
    /// A token from the random numbers of the operating system.
    ///
    /// # Errors
    /// `Io` if the system supplies none.
    pub fn random() -> Result<Self> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes).map_err(|e| {
            Error::io(format!(
                "the page needs a secret address, but the operating system supplies no random numbers ({e}); \
                 write the page to a file with --output"
            ))
        })?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// The digits.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// True if the digits are equal. The time does not depend on the place of the first difference, so that
    /// it cannot be used to guess digit by digit. The length is no secret.
    pub fn equals(&self, given: &str) -> bool {
        let (own, given) = (self.0.as_bytes(), given.as_bytes());
        // `black_box` keeps the compiler from ending the loop at the first difference.
        own.len() == given.len()
            && own.iter().zip(given).fold(0, |difference, (a, b)| black_box(difference | (a ^ b))) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_differ_and_equal_only_themselves() {
        let [a, b] = [(); 2].map(|()| Token::random().unwrap());
        assert_eq!(a.text().len(), 2 * BYTES);
        assert!(a.text().bytes().all(|c| c.is_ascii_hexdigit()));
        assert!(a.equals(a.text()) && !a.equals(b.text()) && !a.equals(""));
        assert!(!a.equals(&a.text()[1..]) && !a.equals(&format!("{}0", a.text())));
        for place in 0..a.text().len() {
            let mut other = a.text().to_owned();
            other.replace_range(place..=place, "x");
            assert!(!a.equals(&other), "digit {place}");
        }
    }
}
