//! Converts paths (the attribute `d`) to curves.

use super::{number, unit_arc};
use crate::affine::Affine;
use crate::bezier::bezier;
use planish_estimate::{Error, Result};
use planish_solid::views::Curve2;
use std::f64::consts::TAU;

/// Minimum angle of an arc in radians; shorter ones become their chord. The arc leaves the chord by 1e-25 of
/// the radius, and rounding moves the ends of an arc by 1e-16 of it, which is 1e-4 of such a chord.
const MIN_SWEEP: f64 = 1e-12;

/// Tokens of a path: letters, numbers and flags.
struct Words<'a> {
    left: &'a str,
}

impl<'a> Words<'a> {
    fn skip(&mut self) {
        self.left = self.left.trim_start_matches(|c: char| c.is_ascii_whitespace() || c == ',');
    }

    fn letter(&mut self) -> Option<char> {
        self.skip();
        let letter = self.left.chars().next().filter(char::is_ascii_alphabetic)?;
        self.left = &self.left[1..];
        Some(letter)
    }

    fn is_at_number(&mut self) -> bool {
        self.skip();
        self.left.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.'))
    }

    /// Parses a number. Numbers may follow each other without a separator: `1-2`, `.5.5`.
    fn number(&mut self) -> Result<f64> {
        self.skip();
        let bytes = self.left.as_bytes();
        let mut end = 0;
        let (mut has_point, mut has_exponent) = (false, false);
        while let Some(byte) = bytes.get(end) {
            let continues = match byte {
                b'0'..=b'9' => true,
                b'+' | b'-' => end == 0 || matches!(bytes[end - 1], b'e' | b'E'),
                b'.' => !std::mem::replace(&mut has_point, true) && !has_exponent,
                b'e' | b'E' => !std::mem::replace(&mut has_exponent, true),
                _ => false,
            };
            if !continues {
                break;
            }
            end += 1;
        }
        if end == 0 {
            let found: String = self.left.chars().take(20).collect();
            return Err(Error::input(format!("expected a number in the path, found `{found}`")));
        }
        let (text, left): (&'a str, &'a str) = self.left.split_at(end);
        self.left = left;
        number(text)
    }

    /// Parses a flag, 0 or 1, which needs no separator after it.
    fn flag(&mut self) -> Result<bool> {
        self.skip();
        let flag = self.left.chars().next().filter(|c| matches!(c, '0' | '1'));
        let flag = flag.ok_or_else(|| {
            Error::input("expected 0 or 1 as a flag of an arc in the path, found another character")
        })?;
        self.left = &self.left[1..];
        Ok(flag == '1')
    }
}

/// Converts a path to curves.
pub(super) fn path_curves(d: &str) -> Result<Vec<Curve2>> {
    let mut words = Words { left: d };
    let mut curves = Vec::new();
    let (mut at, mut begun) = ([0.0; 2], [0.0; 2]);
    // Last control point and kind of the previous curve, which S and T mirror.
    let mut handle: Option<(char, [f64; 2])> = None;
    let mut letter = match words.letter() {
        Some(letter @ ('M' | 'm')) => letter,
        None if words.left.is_empty() => return Ok(curves),
        _ => return Err(Error::input("expected a path that begins with M or m")),
    };
    loop {
        let is_relative = letter.is_ascii_lowercase();
        let from = if is_relative { at } else { [0.0; 2] };
        let point =
            |words: &mut Words<'_>| Ok::<_, Error>([words.number()? + from[0], words.number()? + from[1]]);
        // Only a curve of the same kind has a control point to mirror.
        let mirrored = |kind: char| match handle {
            Some((last, h)) if last == kind => [2.0 * at[0] - h[0], 2.0 * at[1] - h[1]],
            _ => at,
        };
        let mut next_handle = None;
        let end = match letter.to_ascii_uppercase() {
            'M' => {
                let end = point(&mut words)?;
                begun = end;
                // Further pairs of numbers after M are lines.
                letter = if is_relative { 'l' } else { 'L' };
                end
            }
            'Z' => {
                // The next command may omit M; the path then continues from its start.
                add_line(&mut curves, at, begun);
                begun
            }
            'L' => line_to(&mut curves, at, point(&mut words)?),
            'H' => line_to(&mut curves, at, [words.number()? + from[0], at[1]]),
            'V' => line_to(&mut curves, at, [at[0], words.number()? + from[1]]),
            kind @ ('C' | 'S') => {
                let first = if kind == 'C' { point(&mut words)? } else { mirrored('C') };
                let (second, end) = (point(&mut words)?, point(&mut words)?);
                curves.push(bezier(&[at, first, second, end]));
                next_handle = Some(('C', second));
                end
            }
            kind @ ('Q' | 'T') => {
                let middle = if kind == 'Q' { point(&mut words)? } else { mirrored('Q') };
                let end = point(&mut words)?;
                curves.push(bezier(&[at, middle, end]));
                next_handle = Some(('Q', middle));
                end
            }
            'A' => {
                // Negative radii count as positive, and radii of 0 give a line (SVG 1.1, F.6.6).
                let radii = [words.number()?.abs(), words.number()?.abs()];
                let angle = words.number()?.to_radians();
                let (is_large, is_clockwise) = (words.flag()?, words.flag()?);
                let end = point(&mut words)?;
                curves.extend(arc(at, end, radii, angle, is_large, is_clockwise));
                end
            }
            other => {
                return Err(Error::input(format!(
                    "expected a path command (one of MLHVCSQTAZ), found `{other}`"
                )));
            }
        };
        at = end;
        handle = next_handle;
        match words.letter() {
            // A letter may be omitted if the command is repeated.
            Some(next) => letter = next,
            None if words.left.is_empty() => return Ok(curves),
            None if letter.eq_ignore_ascii_case(&'Z') || !words.is_at_number() => {
                let found: String = words.left.chars().take(20).collect();
                return Err(Error::input(format!("expected a command in the path, found `{found}`")));
            }
            None => {}
        }
    }
}

fn line_to(curves: &mut Vec<Curve2>, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
    curves.push(Curve2::Segment(from, to));
    to
}

/// Adds the line that closes a path, unless its last curve already ends at the start.
fn add_line(curves: &mut Vec<Curve2>, from: [f64; 2], to: [f64; 2]) {
    if from != to {
        curves.push(Curve2::Segment(from, to));
    }
}

/// Elliptical arc between two points: computes the centre (SVG 1.1, F.6.5) and enlarges radii that are too
/// short (F.6.6).
fn arc(
    from: [f64; 2],
    to: [f64; 2],
    [rx, ry]: [f64; 2],
    angle: f64,
    is_large: bool,
    is_clockwise: bool,
) -> Option<Curve2> {
    // Equal ends leave the arc undefined; SVG omits it (F.6.2).
    if from == to {
        return None;
    }
    if rx == 0.0 || ry == 0.0 {
        return Some(Curve2::Segment(from, to));
    }
    let (sin, cos) = angle.sin_cos();
    let half = [(from[0] - to[0]) / 2.0, (from[1] - to[1]) / 2.0];
    // Map to the frame in which the ellipse is a unit circle.
    let into =
        |p: [f64; 2], s: f64| [(cos * p[0] + sin * p[1]) / (s * rx), (cos * p[1] - sin * p[0]) / (s * ry)];
    let p = into(half, 1.0);
    let length = p[0].hypot(p[1]);
    let enlarged = length.max(1.0);
    let p = into(half, enlarged);
    // Rounding may make the radicand slightly negative.
    let root = (1.0 / (p[0] * p[0] + p[1] * p[1]) - 1.0).max(0.0).sqrt();
    // Two circles pass through both ends; the flags select one.
    let sign = if is_large == is_clockwise { -1.0 } else { 1.0 };
    let center = [sign * root * p[1], -sign * root * p[0]];
    let begin = (p[1] - center[1]).atan2(p[0] - center[0]);
    let end = (-p[1] - center[1]).atan2(-p[0] - center[0]);
    // From the chord: the difference of both angles is lost in rounding where the ends are close.
    let short = 2.0 * (length / enlarged).min(1.0).asin();
    let sweep = if is_large { TAU - short } else { short };
    // Shorter arcs cannot be told from their chord, but their centre would move their ends.
    if sweep < MIN_SWEEP {
        return Some(Curve2::Segment(from, to));
    }
    let scale = [rx * enlarged, ry * enlarged];
    let columns = [[cos * scale[0], sin * scale[0]], [-sin * scale[1], cos * scale[1]]];
    let place = Affine { columns, origin: [0.0; 2] };
    let off = place.point(center);
    let place =
        Affine { columns, origin: [(from[0] + to[0]) / 2.0 + off[0], (from[1] + to[1]) / 2.0 + off[1]] };
    Some(place.curve(&unit_arc(if is_clockwise { begin } else { end }, sweep)))
}
