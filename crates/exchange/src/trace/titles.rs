//! Titles of views: words such as `Front` or `Draufsicht` below or above a view.
//!
//! Sizes alone do not always show which view is which: of a part with a square face, two views are equal.

use super::marks::PixelBox;
use crate::glyphs::PictureText;
use planish_solid::drawing::ViewKind;

/// Words of titles in English, German, French, Spanish and Italian.
const TITLES: [(ViewKind, &[&str]); 4] = [
    (ViewKind::Front, &["front", "vorderansicht", "face", "alzado", "frontale"]),
    (ViewKind::Top, &["top", "plan", "draufsicht", "dessus", "planta", "pianta"]),
    (ViewKind::Side, &["side", "right", "seitenansicht", "droite", "perfil", "laterale"]),
    (ViewKind::Left, &["left", "gauche"]),
];
/// Maximum share of wrong letters of a word: long words are recognised although letters are misread.
const MAX_WRONG: f64 = 0.25;
/// Minimum confidence of a word. Those of the list are rare, so that a low one is enough.
const READ: f64 = 0.1;
/// Maximum distance of a title from its view, relative to the picture.
const MAX_DISTANCE: f64 = 0.15;

/// The kind that a title states for each view; none if no title is read, or two differ.
///
/// Boxes have y upwards; `size` is that of the picture, with its number of rows second.
pub(super) fn kinds_by_title(
    text: &PictureText,
    boxes: &[PixelBox],
    size: [usize; 2],
) -> Vec<Option<ViewKind>> {
    let reach = MAX_DISTANCE * size[0].max(size[1]) as f64;
    let mut found: Vec<Vec<ViewKind>> = vec![Vec::new(); boxes.len()];
    for word in text.words.iter().filter(|w| w.confidence >= READ) {
        let Some(kind) = kind_of(&word.text) else { continue };
        let [x, y] = word.middle();
        let at = [x, size[1] as f64 - 1.0 - y];
        // Words of one title are beside its middle.
        let off = |b: &PixelBox| {
            let beside = (b[0][0] - at[0]).max(at[0] - b[0][1]).max(0.0);
            (b[1][0] - at[1]).max(at[1] - b[1][1]).max(0.0) + 2.0 * beside
        };
        let nearest = (0..boxes.len()).min_by(|a, b| off(&boxes[*a]).total_cmp(&off(&boxes[*b])));
        if let Some(k) = nearest.filter(|k| off(&boxes[*k]) <= reach) {
            found[k].push(kind);
        }
    }
    let one = |kinds: Vec<ViewKind>| {
        let first = *kinds.first()?;
        kinds.iter().all(|k| *k == first).then_some(first)
    };
    found.into_iter().map(one).collect()
}

/// The kind of view that a word states.
fn kind_of(word: &str) -> Option<ViewKind> {
    let letters: Vec<char> = word.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
    let mut best: Option<(f64, ViewKind)> = None;
    for (kind, words) in TITLES {
        for title in words {
            let wrong = edit_distance(&letters, &title.chars().collect::<Vec<char>>());
            let share = wrong as f64 / title.len() as f64;
            if share <= MAX_WRONG && best.is_none_or(|b| share < b.0) {
                best = Some((share, kind));
            }
        }
    }
    best.map(|(_, kind)| kind)
}

/// Minimum number of letters that are inserted, deleted or replaced (Levenshtein 1966).
fn edit_distance(a: &[char], b: &[char]) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, c) in a.iter().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, d) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(c != d);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(row[j + 1] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::glyphs::Word;

    #[test]
    fn titles_below_views_state_their_kinds() {
        let word = |text: &str, x: f64, y: f64| Word {
            text: text.into(),
            corners: [[x, y]; 4],
            angle_rad: 0.0,
            height: 10.0,
            confidence: 0.5,
        };
        // One letter is misread; `10.5` is no title.
        let titles = [word("Vorderansioht", 100.0, 330.0), word("TOP", 340.0, 330.0)];
        let words = titles.into_iter().chain([word("10.5", 100.0, 320.0)]).collect();
        let text = PictureText { words, arrowheads: Vec::new(), mask: Vec::new() };
        let boxes = [[[50.0, 150.0], [100.0, 200.0]], [[300.0, 400.0], [100.0, 200.0]]];
        let kinds = kinds_by_title(&text, &boxes, [400, 400]);
        assert_eq!(kinds, [Some(ViewKind::Front), Some(ViewKind::Top)]);
        assert_eq!(kind_of("Stop-1"), None);
    }
}
