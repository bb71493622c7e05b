//! Line styles by the dashes and the names of line types and layers.
//!
//! Hidden lines have dashes of one length. Centre lines, cutting lines and lines of movement alternate long
//! dashes with short ones or dots. The pattern in the table of line types decides, because names depend on
//! the language of the program; names decide where the table lacks the line type, and names of layers for
//! continuous lines.

use super::groups::Record;
use planish_estimate::Result;
use planish_solid::views::LineStyle;

/// Ratio of the longest to the shortest dash from which on a line alternates.
const ALTERNATING: f64 = 1.5;

/// Beginnings of words in names of centre lines, in English, German, French, Italian and Spanish.
const CENTRE_WORDS: [&str; 16] = [
    "CENTER",
    "CENTRE",
    "DASHDOT",
    "CHAIN",
    "PHANTOM",
    "DIVIDE",
    "STRICHPUNKT",
    "MITTELLINIE",
    "MIXTE",
    "ACHSE",
    "AXES",
    "AXIS",
    "CENTRO",
    "ASSI",
    "EJES",
    "CONSTRUCTION",
];
/// The same of hidden lines.
const HIDDEN_WORDS: [&str; 12] = [
    "HIDDEN",
    "DASH",
    "VERDECKT",
    "GESTRICHELT",
    "UNSICHTBAR",
    "CACH",
    "INTERROMPU",
    "NASCOST",
    "TRATTEGGI",
    "OCULT",
    "TRAZOS",
    "INVISIBLE",
];
/// Number after `ISO` of line types with dashes of one length (ISO 128-2: dashed, dashed spaced, dotted).
const ISO_HIDDEN: [&str; 3] = ["02", "03", "07"];

/// Style of lines with dashes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Dashes {
    Hidden,
    Centre,
}

impl Dashes {
    /// From a record of the table of line types; none for continuous lines.
    pub(super) fn of_pattern(record: &Record) -> Result<Option<Self>> {
        let elements: Vec<f64> =
            record.groups.iter().filter(|g| g.code == 49).map(|g| g.number()).collect::<Result<_>>()?;
        if !elements.iter().any(|e| *e < 0.0) {
            return Ok(None);
        }
        let dashes = || elements.iter().copied().filter(|e| *e >= 0.0);
        let (shortest, longest) = dashes().fold((f64::MAX, 0.0_f64), |(lo, hi), d| (lo.min(d), hi.max(d)));
        Ok(match longest > ALTERNATING * shortest {
            true => Some(Self::Centre),
            false => dashes().next().map(|_| Self::Hidden),
        })
    }

    /// From the name of a line type or layer.
    pub(super) fn of_name(name: &str) -> Option<Self> {
        let name = name.to_uppercase();
        if let Some((_, rest)) = name.split_once("ISO")
            && let Some(number) = rest.get(..2).filter(|n| n.bytes().all(|b| b.is_ascii_digit()))
        {
            return Some(match ISO_HIDDEN.contains(&number) {
                true => Self::Hidden,
                false => Self::Centre,
            });
        }
        let words = || name.split(|c: char| !c.is_alphabetic());
        let has = |list: &[&str]| words().any(|word| list.iter().any(|own| word.starts_with(own)));
        match (has(&CENTRE_WORDS), has(&HIDDEN_WORDS)) {
            (true, _) => Some(Self::Centre),
            (_, true) => Some(Self::Hidden),
            _ => None,
        }
    }

    /// The line style; none for centre lines, which draw no edges.
    pub(super) fn line_style(dashes: Option<Self>) -> Option<LineStyle> {
        match dashes {
            None => Some(LineStyle::Visible),
            Some(Self::Hidden) => Some(LineStyle::Hidden),
            Some(Self::Centre) => None,
        }
    }
}
