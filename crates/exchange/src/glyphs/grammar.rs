//! What texts of drawings look like: dimensions, scales, marks of sections, words.

use super::network::{CLASS_COUNT, CLASSES, NO_GLYPH};

/// Readings of a word that are compared.
const MAX_READINGS: usize = 24;
/// Characters of a glyph that are considered, and their minimum probability.
const MAX_CHARACTERS: usize = 4;
const MIN_CHANCE: f32 = 5e-4;
/// Prior weight of a reading by its kind. Dimensions and words differ by orders of magnitude from a random
/// mixture of characters; that of words is smaller, because titles are fewer than numbers.
const DIMENSION: f64 = 1.0;
const LETTERS: f64 = 0.3;
const MIXED: f64 = 0.01;

/// What a word reads, with the estimated probability that it is right; a comma for a point is right.
pub(super) struct ReadWord {
    pub(super) characters: Vec<char>,
    pub(super) probability: f64,
}

/// The most probable reading of the glyphs of a word.
pub(super) fn read(glyphs: &[[f32; CLASS_COUNT]]) -> ReadWord {
    let classes: Vec<char> = CLASSES.chars().collect();
    let mut readings: Vec<(Vec<char>, f64)> = vec![(Vec::new(), 1.0)];
    let mut covered = 1.0;
    for chances in glyphs {
        // The class of other shapes is left out here; it counts once, for the whole word.
        let total = f64::from(1.0 - chances[NO_GLYPH]).max(1e-6);
        let mut order: Vec<usize> = (0..NO_GLYPH).collect();
        order.sort_by(|a, b| chances[*b].total_cmp(&chances[*a]));
        order.truncate(MAX_CHARACTERS);
        let least = MIN_CHANCE.min(chances[order[0]]);
        order.retain(|k| chances[*k] >= least);
        let mut longer: Vec<(Vec<char>, f64)> = Vec::with_capacity(readings.len() * order.len());
        for (text, chance) in &readings {
            for k in &order {
                let text = text.iter().copied().chain([classes[*k]]).collect();
                longer.push((text, chance * f64::from(chances[*k]) / total));
            }
        }
        longer.sort_by(|a, b| b.1.total_cmp(&a.1));
        longer.truncate(MAX_READINGS);
        readings = longer;
        covered = readings.iter().map(|r| r.1).sum::<f64>().min(1.0);
    }
    let weighed = |(text, chance): &(Vec<char>, f64)| chance * prior(text);
    let total: f64 = readings.iter().map(weighed).sum::<f64>() + MIXED * (1.0 - covered);
    let best = readings.iter().max_by(|a, b| weighed(a).total_cmp(&weighed(b)));
    best.map_or(ReadWord { characters: Vec::new(), probability: 0.0 }, |(text, _)| {
        // A decimal comma and a point state the same number.
        let value =
            |text: &[char]| text.iter().map(|c| if *c == ',' { '.' } else { *c }).collect::<Vec<char>>();
        let same = readings.iter().filter(|r| value(&r.0) == value(text)).map(weighed).sum::<f64>();
        ReadWord { characters: text.clone(), probability: same / total }
    })
}

fn prior(text: &[char]) -> f64 {
    if is_dimension(text) || is_mark(text) {
        return DIMENSION;
    }
    let letters = text.iter().filter(|c| c.is_alphabetic() && **c != 'Ø').count();
    let inside = &text[1.min(text.len())..];
    let one_case = inside.iter().all(|c| !c.is_lowercase()) || inside.iter().all(|c| !c.is_uppercase());
    match letters {
        n if n == text.len() && one_case => LETTERS,
        // Words with a mark, such as `SCALE:`.
        n if n > 2 && n + 1 == text.len() && one_case => 0.3 * LETTERS,
        _ => MIXED,
    }
}

/// Marks of sections: `A-A`.
fn is_mark(text: &[char]) -> bool {
    matches!(text, [a, '-', b] if a == b && a.is_ascii_uppercase())
}

/// Numbers with what drawings add to them: `4×Ø6`, `R2,5`, `2×45°`, `12±0.1`, `M8`, `1:2`, `(20)`.
pub(super) fn is_dimension(text: &[char]) -> bool {
    let text = match text {
        ['(', inside @ .., ')'] => inside,
        _ => text,
    };
    let mut rest = text;
    if let Some(after) = whole(rest)
        && let [':', next @ ..] = after
    {
        return whole(next) == Some(&[]);
    }
    if let Some(['×', next @ ..]) = whole(rest) {
        rest = next;
    }
    let rest = match rest {
        ['Ø' | 'R' | 'M' | '±', next @ ..] | ['S', 'Ø' | 'R', next @ ..] => next,
        _ => rest,
    };
    let Some(mut rest) = number(rest) else { return false };
    loop {
        let next = match rest {
            [] => return true,
            ['°', next @ ..] | ['m', 'm', next @ ..] | ['%', next @ ..] => Some(next),
            ['×' | '±' | '+' | '-', next @ ..] => number(next),
            // Fits: `H7`, `g6`.
            [c, next @ ..] if "HhgfjkmnEFGJKNP".contains(*c) && next.len() == 1 => whole(next),
            _ => None,
        };
        match next {
            Some(next) => rest = next,
            None => return false,
        }
    }
}

/// What follows a whole number that does not begin with zero.
fn whole(text: &[char]) -> Option<&[char]> {
    let count = text.iter().take_while(|c| c.is_ascii_digit()).count();
    (1..=5).contains(&count).then(|| &text[count..]).filter(|_| count == 1 || text[0] != '0')
}

/// What follows a number with or without decimals. Some drawings omit a zero before the point.
fn number(text: &[char]) -> Option<&[char]> {
    let after = match text {
        ['.' | ',', ..] => text,
        _ => whole(text)?,
    };
    match after {
        ['.' | ',', next @ ..] => {
            let count = next.iter().take_while(|c| c.is_ascii_digit()).count();
            (1..=4).contains(&count).then(|| &next[count..])
        }
        _ => Some(after),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> bool {
        is_dimension(&text.chars().collect::<Vec<char>>())
    }

    #[test]
    fn numbers_of_drawings_are_dimensions_and_words_are_not() {
        let dimensions = [
            "12", "123.5", "12,5", "Ø12", "R5", "2×45°", "4×Ø6", "±0.02", "1:2", "12±0.1", "(20)", "M8",
            "20H7", "45°", ".5",
        ];
        for text in dimensions {
            assert!(parsed(text), "{text}");
        }
        for text in ["", "O12", "1l", "12.", "1.2.3", "FRONT", "R", "012", "1:2:3", "×", "12-", "A4"] {
            assert!(!parsed(text), "{text}");
        }
    }

    #[test]
    fn a_letter_among_digits_is_read_as_a_digit() {
        let class = |c: char| CLASSES.chars().position(|k| k == c).unwrap();
        let of = |list: &[(char, f32)]| {
            let mut chances = [0.0; CLASS_COUNT];
            list.iter().for_each(|(c, p)| chances[class(*c)] = *p);
            chances
        };
        let (one, letter) = (of(&[('1', 1.0)]), of(&[('O', 0.6), ('0', 0.4)]));
        let number = read(&[one, letter]);
        assert_eq!(number.characters, ['1', '0']);
        assert!(number.probability > 0.95);
        // Among letters it stays a letter, and a single one stays uncertain.
        assert_eq!(read(&[of(&[('N', 1.0)]), letter]).characters, ['N', 'O']);
        assert!(read(&[letter]).probability < 0.9);
    }
}
