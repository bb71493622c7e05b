//! Reads texts in pictures of drawings: numbers, symbols of dimensions and titles of views.
//!
//! **Input.** The brightness of a picture with dark lines on light paper (or the inverse). Capitals are 8 to
//! 60 pixels high. Texts are horizontal or read upwards (ISO 129), tilted by up to 2°.
//!
//! **Output.** [`PictureText`]: words with their corners and the probability that they are right, and the
//! pixels that belong to them.
//!
//! **Method.** Connected strokes beside each other are a word. A small network classifies glyphs; touching
//! glyphs are cut where little ink is, and the most probable sequence of parts wins. Words that look like
//! dimensions or like words are more probable than random characters (`O` or `0`). Long lines through texts
//! are removed first.
//!
//! **Limits.** Texts at other angles, texts that touch curves, and handwriting are not read. A letter alone,
//! such as `O`, may be a circle of the drawing; its probability says so. Characters are Latin letters, `ä`,
//! `ö`, `ü`, `é`, digits and `. , : - + ± ° Ø × / % ( ) =`; `×` is written as `x`, all diameter signs as `Ø`.
//!
//! # References
//! - LeCun, Bottou, Bengio and Haffner, *Gradient-based learning applied to document recognition*, 1998: the
//!   network (section II) and the choice of cuts by the best path (section V).
//! - Guo, Pleiss, Sun and Weinberger, *On calibration of modern neural networks*, 2017: temperature.

mod arrows;
mod grammar;
mod ink;
mod lines;
mod network;
mod shape;
#[cfg(test)]
mod tests;
mod words;

use crate::strokes::lengths_between;
use arrows::Head;
use grammar::is_dimension;
use ink::Ink;
use lines::LineWork;
use network::Network;
use planish_sense::Image;
use planish_solid::sheet::{SheetDimension, SheetText};
use shape::{Reading, Run, Shape, connected};
use std::collections::HashMap;
use words::{FoundWord, WordFinder};

/// Texts of a picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PictureText {
    /// Words, from the most to the least clear one.
    pub words: Vec<Word>,
    /// Arrowheads of horizontal and vertical lines: their corners in pixels, the tip first.
    pub arrowheads: Vec<[[f64; 2]; 3]>,
    /// Whether a pixel belongs to a word, row by row. Pixels of lines that cross a word are left out, as are
    /// single letters and words with a confidence below 0.3, which may be line work.
    pub mask: Vec<bool>,
}

/// A word or a number.
#[derive(Debug, Clone, PartialEq)]
pub struct Word {
    /// What it reads, without spaces.
    pub text: String,
    /// Corners in pixels (x to the right, y down, the middle of the first pixel is the origin): as one reads
    /// it, lower left, lower right, upper right, upper left.
    pub corners: [[f64; 2]; 4],
    /// Direction of reading in radians, with y down: about 0, or about −π/2 for texts that are read upwards.
    pub angle_rad: f64,
    /// Height of capitals and digits in pixels.
    pub height: f64,
    /// Probability that the text is right, calibrated on fonts that were not used for training.
    pub confidence: f64,
}

impl Word {
    /// The middle of the word in pixels.
    #[must_use]
    pub fn middle(&self) -> [f64; 2] {
        [0, 1].map(|k| 0.25 * self.corners.iter().map(|c| c[k]).sum::<f64>())
    }

    fn sheet_text(&self, rows: usize) -> SheetText {
        SheetText { at: upwards(self.middle(), rows), text: self.text.clone() }
    }

    /// Whether it reads like a number of a drawing: `12.5`, `Ø8`, `2x45°`, `1:2`.
    #[must_use]
    pub fn is_dimension(&self) -> bool {
        is_dimension(&self.text.replace('x', "×").chars().collect::<Vec<char>>())
    }
}

impl PictureText {
    /// The words of at least a confidence, as texts of a drawing in pixels with y up.
    ///
    /// `rows`: height of the picture in pixels.
    #[must_use]
    pub fn sheet_texts(&self, rows: usize, confidence: f64) -> Vec<SheetText> {
        let sure = self.words.iter().filter(|w| w.confidence >= confidence);
        sure.map(|word| word.sheet_text(rows)).collect()
    }

    /// Lengths between two arrowheads, in pixels, with the number of at least a confidence beside them.
    ///
    /// Tips are accurate to about a pixel; `rounding` knows the digits only.
    #[must_use]
    pub fn dimensions(&self, rows: usize, confidence: f64) -> Vec<SheetDimension> {
        let heads: Vec<[[f64; 2]; 3]> =
            self.arrowheads.iter().map(|corners| corners.map(|p| upwards(p, rows))).collect();
        let sure = self.words.iter().filter(|w| w.confidence >= confidence && w.is_dimension());
        let texts: Vec<SheetText> = sure.map(|word| word.sheet_text(rows)).collect();
        lengths_between(&heads, &texts).into_iter().map(|length| length.dimension).collect()
    }
}

/// A place in a picture as one in a drawing.
fn upwards([x, y]: [f64; 2], rows: usize) -> [f64; 2] {
    [x, rows as f64 - 1.0 - y]
}

/// Longest side of the shapes that may be glyphs, in pixels; larger ones are line work.
const LARGEST_GLYPH: f32 = 110.0;
/// Maximum number of shapes of a picture. A densely written A3 sheet has a tenth.
const MAX_SHAPES: usize = 50_000;
/// Probability of being glyphs below which shapes are line work.
const IS_TEXT: f64 = 0.5;
/// Confidence from which the pixels of a word are no line work. What is erased wrongly is lost for views.
const MASKED: f64 = 0.3;

/// Reads the texts of a picture.
///
/// # Examples
/// A picture without ink has no words.
/// ```
/// use planish_exchange::glyphs::read_words;
/// use planish_sense::Image;
/// let found = read_words(&Image::try_new(40, 30, vec![255.0; 1200])?);
/// assert!(found.words.is_empty() && found.mask.iter().all(|pixel| !pixel));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn read_words(image: &Image) -> PictureText {
    let ink = Ink::of(image);
    let network = Network::new();
    let strokes = ink.strokes();
    let lines = LineWork::of(&ink, &strokes);
    let shapes = glyph_shapes(&ink, strokes, &lines);
    let finder = WordFinder { ink: &ink, network: &network, shapes: &shapes };
    let mut found = finder.find(Reading::Rightwards);
    found.extend(finder.find(Reading::Upwards));
    let found = without_overlaps(found, shapes.len());
    let mut mask = vec![false; ink.values.len()];
    let is_sure = |w: &&FoundWord| !is_lone(w) && confidence(w) >= MASKED;
    for shape in found.iter().filter(is_sure).flat_map(|w| &w.shapes) {
        paint(&shapes[*shape], &ink, &mut mask);
    }
    let mut words: Vec<Word> = found.iter().map(|w| placed(w, ink.rows)).collect();
    words.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    // Corners of a `4` look like an open arrowhead.
    let is_free = |corners: &[[f64; 2]; 3]| {
        let [x, y] = middle(corners).map(|c| c.round().max(0.0) as usize);
        !mask.get(y * ink.columns + x).is_some_and(|marked| *marked)
    };
    let arrowheads = lines.arrowheads.into_iter().map(|(corners, _)| corners).filter(is_free).collect();
    PictureText { words, arrowheads, mask }
}

/// The middle of a triangle.
fn middle(corners: &[[f64; 2]; 3]) -> [f64; 2] {
    [0, 1].map(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0)
}

/// What may be a glyph or a part of one: small shapes, also those that long lines connect, and faint points.
fn glyph_shapes(ink: &Ink, mut mask: Vec<bool>, lines: &LineWork) -> Vec<Shape> {
    mask.iter_mut().zip(&lines.long).for_each(|(pixel, line)| *pixel &= !line);
    let filled = lines.arrowheads.iter().filter(|(_, head)| *head == Head::Filled);
    let middles = filled.map(|(corners, _)| middle(corners));
    let mut heads: HashMap<u32, Vec<u32>> = HashMap::new();
    for [x, y] in middles.map(|p| p.map(|c| c.round().max(0.0) as u32)) {
        heads.entry(y).or_default().push(x);
    }
    let is_head = |run: &Run| {
        heads.get(&run.row).is_some_and(|row| row.iter().any(|x| (run.first..=run.last).contains(x)))
    };
    let is_glyph =
        |s: &Shape| s.bounds.size(0).max(s.bounds.size(1)) <= LARGEST_GLYPH && !s.runs.iter().any(is_head);
    let mut shapes: Vec<Shape> = connected(&mask, ink.columns).into_iter().filter(is_glyph).collect();
    let points = ink.faint_points();
    if shapes.len() + points.len() <= MAX_SHAPES {
        shapes.extend(points);
    }
    // Noise: neighbours would be compared for hours.
    if shapes.len() > MAX_SHAPES {
        shapes.clear();
    }
    shapes
}

/// The words that explain their shapes best; each shape belongs to one word.
fn without_overlaps(mut found: Vec<FoundWord>, shapes: usize) -> Vec<FoundWord> {
    found.retain(|w| w.glyph_chance >= IS_TEXT && has_letter_or_digit(w));
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut used = vec![false; shapes];
    found.retain(|word| {
        let free = word.shapes.iter().all(|k| !used[*k]);
        if free {
            word.shapes.iter().for_each(|k| used[*k] = true);
        }
        free
    });
    found
}

/// Whether a word has more than what lines and points of a drawing look like.
fn has_letter_or_digit(word: &FoundWord) -> bool {
    let characters = &word.read.characters;
    characters.iter().any(|c| c.is_alphanumeric() && !"lIi1".contains(*c)) || characters[..] == ['1', '1']
}

/// Marks the pixels of a shape and its antialiased rim.
fn paint(shape: &Shape, ink: &Ink, mask: &mut [bool]) {
    for run in &shape.runs {
        let [first, last] =
            [(run.first as usize).saturating_sub(1), (run.last as usize + 1).min(ink.columns - 1)];
        let row = run.row as usize;
        for y in row.saturating_sub(1)..=(row + 1).min(ink.rows - 1) {
            mask[y * ink.columns + first..=y * ink.columns + last].fill(true);
        }
    }
}

/// The word in the frame of the picture.
fn placed(found: &FoundWord, rows: usize) -> Word {
    let line = &found.line;
    let left = found.glyphs.iter().map(|b| b.low[0] - 0.5).fold(f32::MAX, f32::min);
    let right = found.glyphs.iter().map(|b| b.high[0] + 0.5).fold(f32::MIN, f32::max);
    let corner = |x: f32, up: f32| {
        let y = f64::from(line.base_at(x) - up * line.height);
        match found.reading {
            Reading::Rightwards => [f64::from(x), y],
            Reading::Upwards => [y, rows as f64 - 1.0 - f64::from(x)],
        }
    };
    let tilt = f64::from(line.base[1]).atan();
    let angle_rad = match found.reading {
        Reading::Rightwards => tilt,
        Reading::Upwards => tilt - std::f64::consts::FRAC_PI_2,
    };
    Word {
        text: found.read.characters.iter().map(|c| if *c == '×' { 'x' } else { *c }).collect(),
        corners: [corner(left, 0.0), corner(right, 0.0), corner(right, 1.0), corner(left, 1.0)],
        angle_rad,
        height: f64::from(line.height),
        confidence: confidence(found),
    }
}

/// Probability that a word is right.
///
/// Words in fonts that were not used for training fitted the two logistic curves: 1315 words of 100 pictures
/// of `benches/peers/glyphs/words.py`. Ink beside or between glyphs may be an unread digit or point.
fn confidence(found: &FoundWord) -> f64 {
    let raw = (found.read.probability * found.glyph_chance).clamp(1e-4, 1.0 - 1e-5);
    let odds = (raw / (1.0 - raw)).ln();
    let odds = if found.has_unread { 0.373 * odds - 1.908 } else { 0.915 * odds - 0.933 };
    // Half of the characters that look like line work are.
    let lone = if is_lone(found) { 0.5 } else { 1.0 };
    // A part of a number can be as clear as can be: of numbers with the highest odds 0.75 were complete.
    let most: f64 = if found.has_unread { 0.75 } else { 1.0 };
    lone * most.min(1.0 / (1.0 + (-odds).exp()))
}

/// Whether a word is a single character that line work looks like: corners and crossings like `T`, `L` and
/// `H`, holes like `0`.
fn is_lone(found: &FoundWord) -> bool {
    matches!(found.read.characters[..], [c] if c == '0' || !c.is_ascii_digit())
}
