//! Dimensions: two arrowheads that point away from or towards each other, and the number between them.

use crate::dimension_text::{has_diameter_sign, stated_length};
use planish_solid::sheet::{Annotations, SheetDimension, SheetText};
use planish_solid::views::distance;

/// Maximum number of arrowheads, which are compared in pairs.
const MAX_ARROWS: usize = 4000;
/// Tolerance of directions of arrowheads.
const OPPOSITE: f64 = 0.01;
/// Maximum distance of the number from the dimension line, in lengths of an arrowhead.
const BESIDE: f64 = 3.0;

struct Arrow {
    tip: [f64; 2],
    /// Unit vector towards the tip.
    towards: [f64; 2],
    length: f64,
}

/// A length between two arrowheads.
pub(crate) struct LengthBetween {
    /// The tips of the arrowheads.
    pub(crate) ends: [[f64; 2]; 2],
    pub(crate) dimension: SheetDimension,
    /// Whether its text has the sign of a diameter (Ø).
    pub(crate) is_diameter: bool,
}

/// Adds the dimensions and diameters that arrowheads and texts of a drawing show.
pub(crate) fn add_dimensions_between(annotations: &mut Annotations) {
    for length in lengths_between(&annotations.arrowheads, &annotations.texts) {
        annotations.dimensions.push(length.dimension);
        annotations.diameters.extend(length.is_diameter.then_some(length.ends));
    }
}

/// The dimensions that arrowheads and texts show.
pub(crate) fn lengths_between(triangles: &[[[f64; 2]; 3]], texts: &[SheetText]) -> Vec<LengthBetween> {
    let arrows: Vec<Arrow> = triangles.iter().take(MAX_ARROWS).filter_map(arrow).collect();
    let stated: Vec<(&SheetText, (f64, f64))> =
        texts.iter().filter_map(|text| Some((text, stated_length(&text.text)?))).collect();
    let mut candidates = Vec::new();
    for (k, own) in arrows.iter().enumerate() {
        for (j, other) in arrows.iter().enumerate().skip(k + 1) {
            let Some(drawn) = own.distance_to_partner(other) else { continue };
            let middle = [0, 1].map(|c| 0.5 * (own.tip[c] + other.tip[c]));
            for (number, (text, _)) in stated.iter().enumerate() {
                let at = text.at;
                let off = [at[0] - middle[0], at[1] - middle[1]];
                let [along, across] = [
                    off[0] * own.towards[0] + off[1] * own.towards[1],
                    off[0] * own.towards[1] - off[1] * own.towards[0],
                ];
                if along.abs() <= 0.5 * drawn && across.abs() <= BESIDE * own.length {
                    // Of equal dimensions in a row, outer arrowheads have the same middle as inner ones.
                    let cost = distance(at, middle) + 1e-3 * drawn;
                    candidates.push((cost, [k, j], number, drawn));
                }
            }
        }
    }
    // Arrowheads of dimensions in a row face those of their neighbours, too: numbers show which are pairs.
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut used = vec![false; arrows.len()];
    let mut used_numbers = vec![false; stated.len()];
    let mut found = Vec::new();
    for (_, [k, j], number, drawn) in candidates {
        if !used[k] && !used[j] && !used_numbers[number] {
            [used[k], used[j], used_numbers[number]] = [true; 3];
            let (text, (stated, rounding)) = stated[number];
            found.push(LengthBetween {
                ends: [arrows[k].tip, arrows[j].tip],
                dimension: SheetDimension { drawn, stated, rounding },
                is_diameter: has_diameter_sign(&text.text),
            });
        }
    }
    found
}

impl Arrow {
    /// The distance of the tips, if both arrows are on one line and point in opposite directions.
    fn distance_to_partner(&self, other: &Self) -> Option<f64> {
        let step = [other.tip[0] - self.tip[0], other.tip[1] - self.tip[1]];
        let along = (step[0] * self.towards[0] + step[1] * self.towards[1]).abs();
        let across = (step[0] * self.towards[1] - step[1] * self.towards[0]).abs();
        let faces = self.towards[0] * other.towards[0] + self.towards[1] * other.towards[1];
        (faces < OPPOSITE - 1.0 && across <= OPPOSITE * along && along > self.length).then_some(along)
    }
}

/// The arrow of a triangle: its tip is opposite to the shortest side.
fn arrow(corners: &[[f64; 2]; 3]) -> Option<Arrow> {
    let side = |k: usize| distance(corners[(k + 1) % 3], corners[(k + 2) % 3]);
    let at = (0..3).min_by(|a, b| side(*a).total_cmp(&side(*b)))?;
    let foot = [0, 1].map(|c| 0.5 * (corners[(at + 1) % 3][c] + corners[(at + 2) % 3][c]));
    let (tip, length) = (corners[at], distance(corners[at], foot));
    (length > 0.0).then(|| Arrow { tip, towards: [0, 1].map(|c| (tip[c] - foot[c]) / length), length })
}
