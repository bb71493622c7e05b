//! Characters of fonts, and texts from the strings that a page shows.
//!
//! # References
//! ISO 32000-1:2008, section 9 (text), 9.10 (extraction of text content).

use super::file::PdfFile;
use super::syntax::{Dictionary, Lexer, Object};
use planish_estimate::Result;
use planish_solid::sheet::SheetText;
use std::collections::HashMap;

/// Maximum number of characters of a font.
const MAX_CODES: usize = 1 << 16;
/// Width of characters whose width is unknown, relative to the size of the font.
const USUAL_WIDTH: f64 = 0.55;
/// Gaps along a line, relative to the size of the font: below the first, a string continues the word before
/// it; below the second, the line.
const GAPS: [f64; 2] = [0.2, 1.2];

/// Names of glyphs that numbers and dimensions consist of. Those of letters are the letters.
const GLYPHS: [(&str, char); 22] = [
    ("zero", '0'),
    ("one", '1'),
    ("two", '2'),
    ("three", '3'),
    ("four", '4'),
    ("five", '5'),
    ("six", '6'),
    ("seven", '7'),
    ("eight", '8'),
    ("nine", '9'),
    ("period", '.'),
    ("comma", ','),
    ("colon", ':'),
    ("hyphen", '-'),
    ("minus", '-'),
    ("slash", '/'),
    ("space", ' '),
    ("degree", '°'),
    ("plusminus", '±'),
    ("Oslash", 'Ø'),
    ("multiply", '×'),
    ("percent", '%'),
];

/// A font: what its codes mean, and how wide they are.
#[derive(Debug, Default)]
pub(super) struct Font {
    has_two_bytes: bool,
    texts: HashMap<u32, String>,
    first: usize,
    /// Relative to the size of the font.
    widths: Vec<f64>,
}

impl Font {
    pub(super) fn read(file: &PdfFile<'_>, entries: &Dictionary) -> Result<Self> {
        let name = |key: &str| entries.get(key).and_then(Object::name).unwrap_or_default();
        let mut font = Self { has_two_bytes: name("Subtype") == "Type0", ..Self::default() };
        if let Some(Object::Dictionary(encoding)) = file.value(entries, "Encoding")?
            && let Some(Object::Array(differences)) = file.value(&encoding, "Differences")?
        {
            font.add_differences(&differences);
        }
        if let Some(codes) = entries.get("ToUnicode")
            && let Some((_, content)) = file.stream(codes)?
        {
            font.add_codes(&content)?;
        }
        // Widths of a drawn font are in units of its own.
        let unit = match file.value(entries, "FontMatrix")? {
            Some(Object::Array(matrix)) => matrix.first().and_then(Object::number).unwrap_or(1e-3),
            _ => 1e-3,
        };
        if let Some(Object::Array(widths)) = file.value(entries, "Widths")? {
            font.first = file.value(entries, "FirstChar")?.and_then(|v| v.number()).unwrap_or(0.0) as usize;
            font.widths = widths.iter().map(|w| unit * w.number().unwrap_or(0.0)).collect();
        }
        Ok(font)
    }

    fn add_differences(&mut self, differences: &[Object]) {
        let mut code = 0;
        for item in differences {
            match item {
                Object::Number(first) => code = *first as u32,
                Object::Name(name) => {
                    let known = GLYPHS.iter().find(|(glyph, _)| glyph == name).map(|(_, c)| *c);
                    let single = || name.chars().next().filter(|_| name.chars().count() == 1);
                    let by_code = || char::from_u32(u32::from_str_radix(name.strip_prefix("uni")?, 16).ok()?);
                    if let Some(found) = known.or_else(single).or_else(by_code) {
                        self.texts.insert(code, found.to_string());
                    }
                    code = code.saturating_add(1);
                }
                _ => {}
            }
        }
    }

    /// Adds a table of codes and their characters (UTF-16).
    fn add_codes(&mut self, content: &[u8]) -> Result<()> {
        let number = |code: &[u8]| code.iter().take(4).fold(0_u32, |n, b| (n << 8) | u32::from(*b));
        let text = |code: &[u8], more: u32| {
            let mut units: Vec<u16> =
                code.chunks(2).map(|c| c.iter().fold(0, |n, b| (n << 8) | u16::from(*b))).collect();
            if let Some(last) = units.last_mut() {
                *last = last.wrapping_add(more as u16);
            }
            String::from_utf16_lossy(&units)
        };
        let mut lexer = Lexer::new(content, 0);
        let mut operands: Vec<Object> = Vec::new();
        while let Some(object) = lexer.object()? {
            let Object::Word(word) = object else {
                operands.push(object);
                continue;
            };
            match word.as_str() {
                "endbfchar" => {
                    for pair in operands.chunks_exact(2) {
                        if let [Object::Text(code), Object::Text(to)] = pair {
                            self.texts.insert(number(code), text(to, 0));
                        }
                    }
                }
                "endbfrange" => {
                    for range in operands.chunks_exact(3) {
                        let [Object::Text(from), Object::Text(to), target] = range else { continue };
                        let (from, to) = (number(from), number(to));
                        for code in (from..=to).take(MAX_CODES) {
                            let own = match target {
                                Object::Text(first) => text(first, code - from),
                                Object::Array(all) => match all.get((code - from) as usize) {
                                    Some(Object::Text(one)) => text(one, 0),
                                    _ => continue,
                                },
                                _ => continue,
                            };
                            self.texts.insert(code, own);
                        }
                    }
                }
                _ => {}
            }
            if self.texts.len() > MAX_CODES {
                return Ok(());
            }
            operands.clear();
        }
        Ok(())
    }

    /// The text of a string, and the width of each of its characters; true for a blank of one byte.
    pub(super) fn text(&self, string: &[u8]) -> (String, Vec<(f64, bool)>) {
        let codes: Vec<u32> = match self.has_two_bytes {
            true => string.chunks(2).map(|c| c.iter().fold(0, |n, b| (n << 8) | u32::from(*b))).collect(),
            false => string.iter().map(|b| u32::from(*b)).collect(),
        };
        let mut text = String::new();
        for code in &codes {
            match self.texts.get(code) {
                Some(known) => text.push_str(known),
                None if self.has_two_bytes => text.push(char::REPLACEMENT_CHARACTER),
                None => text.extend(char::from_u32(*code)),
            }
        }
        let width = |code: &u32| {
            let known = (*code as usize).checked_sub(self.first).and_then(|k| self.widths.get(k)).copied();
            (known.unwrap_or(USUAL_WIDTH), *code == 32 && !self.has_two_bytes)
        };
        (text, codes.iter().map(width).collect())
    }
}

/// A string on the page, from its begin to its end.
#[derive(Debug, Clone)]
pub(super) struct Run {
    pub(super) begin: [f64; 2],
    pub(super) end: [f64; 2],
    pub(super) height: f64,
    pub(super) text: String,
}

/// Joins strings that continue each other on a line: programs show words, or single characters.
pub(super) fn texts_of(runs: Vec<Run>) -> Vec<SheetText> {
    let mut joined: Vec<Run> = Vec::new();
    for run in runs {
        if run.text.trim().is_empty() {
            continue;
        }
        if let Some(last) = joined.last_mut() {
            let along = [0, 1].map(|k| last.end[k] - last.begin[k]);
            let length = along[0].hypot(along[1]);
            let step = [0, 1].map(|k| run.begin[k] - last.end[k]);
            let gap = (along[0] * step[0] + along[1] * step[1]) / length;
            let off = (along[0] * step[1] - along[1] * step[0]) / length;
            let size = last.height;
            if off.abs() < 0.3 * size && gap > -0.5 * size && gap < GAPS[1] * size {
                if gap > GAPS[0] * size {
                    last.text.push(' ');
                }
                last.text.push_str(&run.text);
                last.end = run.end;
                continue;
            }
        }
        joined.push(run);
    }
    let middle = |run: &Run| [0, 1].map(|k| 0.5 * (run.begin[k] + run.end[k]));
    joined.iter().map(|run| SheetText { at: middle(run), text: run.text.trim().to_owned() }).collect()
}
