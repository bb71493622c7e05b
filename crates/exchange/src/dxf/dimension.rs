//! Finds dimensions that conflict with the drawing.
//!
//! **Input.** `DIMENSION` entities (linear, aligned, diameter and radius) and the curves of the drawing.
//!
//! **Output.** One message per dimension whose number differs from the distance of its points, and one per
//! dimension whose points lie on no line (the drawing was changed later). Messages name the entity.
//!
//! **Limits.** Angles, ordinates and texts without a number are not checked. A dimension style that scales
//! lengths is accepted if the file contains the measurement beside the text.

use super::groups::Record;
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_solid::views::{Curve2, DrawnCurve};

/// Tolerance of the distance of a dimension's points from lines, as a share of the size of the drawing. Too
/// small a value reports rounded coordinates, too large a value overlooks small changes of the drawing.
const ON_LINE_SHARE: f64 = 2e-3;

/// Describes each dimension that conflicts with the drawing.
pub(super) fn conflicts(dimensions: &[&Record], curves: &[DrawnCurve]) -> Result<Vec<Finding>> {
    let points = || curves.iter().flat_map(|c| c.curve.points());
    let extent = |k: usize| {
        let (lo, hi) = points().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[k]), hi.max(p[k])));
        hi - lo
    };
    // Relative to the drawing, because the unit of a DXF file may be unknown.
    let near = ON_LINE_SHARE * extent(0).max(extent(1));
    let mut found = Vec::new();
    for record in dimensions {
        // Incomplete dimensions are skipped: they only check the drawing and must not prevent reading it.
        let Some(measured) = Measured::from_record(record)? else {
            continue;
        };
        let name = record.name();
        let exact = measured.length();
        let text = stated(record.text(1).unwrap_or_default());
        let kept = record.number(42)?.filter(|m| *m > 0.0).map(|m| (m, 1e-6 * m));
        // An explicit text is what people read, so it takes precedence over the stored measurement.
        if let Some((value, rounding)) = text.or(kept)
            && (value - exact).abs() > rounding + 1e-6 * exact
        {
            let text = format!("{name} states {value}, but {} {exact:.6}", measured.what);
            found.push(Finding::new(FindingCode::DimensionMismatch, text));
            continue;
        }
        let loose = measured
            .touching()
            .into_iter()
            .find(|p| !curves.iter().any(|c| distance_to(&c.curve, *p) <= near));
        if let Some([x, y]) = loose {
            let text = format!(
                "{name} measures from ({x:.4}, {y:.4}), where the drawing has no line: it was probably \
                 changed later"
            );
            found.push(Finding::new(FindingCode::DimensionMismatch, text));
        }
    }
    Ok(found)
}

/// Geometry that a dimension measures.
struct Measured {
    points: [[f64; 2]; 2],
    /// Direction of the measurement; none for the distance of the points.
    along: Option<[f64; 2]>,
    /// True if both points lie on lines; false if only the second does (a radius starts at the centre).
    both: bool,
    what: &'static str,
}

impl Measured {
    /// Reads the geometry of a `DIMENSION`; none for an unsupported kind.
    fn from_record(record: &Record) -> Result<Option<Self>> {
        let point = |code: i32| {
            Ok::<_, planish_estimate::Error>(match (record.number(code)?, record.number(code + 10)?) {
                (Some(x), Some(y)) => Some([x, y]),
                _ => None,
            })
        };
        // The lower three bits of group 70 are the kind; higher bits are flags.
        let kind = record.number(70)?.unwrap_or(0.0) as i64 & 7;
        let (first, second, along, both, what) = match kind {
            0 | 1 => {
                let angle = record.number(50)?.unwrap_or(0.0).to_radians();
                // A linear dimension (0) measures along its own direction, an aligned one (1) the distance
                // itself.
                let along = (kind == 0).then(|| [angle.cos(), angle.sin()]);
                (point(13)?, point(14)?, along, true, "the distance of its points is")
            }
            3 => (point(10)?, point(15)?, None, true, "the distance of its points on the circle is"),
            4 => (point(10)?, point(15)?, None, false, "the distance of its point from the centre is"),
            _ => return Ok(None),
        };
        Ok(first.zip(second).map(|(a, b)| Self { points: [a, b], along, both, what }))
    }

    fn length(&self) -> f64 {
        let [a, b] = self.points;
        let d = [b[0] - a[0], b[1] - a[1]];
        match self.along {
            Some(along) => (d[0] * along[0] + d[1] * along[1]).abs(),
            None => d[0].hypot(d[1]),
        }
    }

    /// Points that must lie on lines.
    fn touching(&self) -> Vec<[f64; 2]> {
        self.points[usize::from(!self.both)..].to_vec()
    }
}

/// Number in the text of a dimension, and half of its last digit; none if the text has no number of its own.
fn stated(text: &str) -> Option<(f64, f64)> {
    // `<>` is replaced by the measurement, so numbers around it are additions such as tolerances. Codes such
    // as `\\A1;` format the text.
    if text.contains("<>") {
        return None;
    }
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
    let plain = plain
        .replace("%%c", " ")
        .replace("%%C", " ")
        .replace("%%p", "±")
        .replace("%%P", "±")
        .replace(',', ".");
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

fn distance_to(curve: &Curve2, p: [f64; 2]) -> f64 {
    if let Curve2::Arc { center, radius, .. } = curve {
        // The whole circle counts: the diameter of an arc has its other end on the part that is not drawn.
        return ((p[0] - center[0]).hypot(p[1] - center[1]) - radius).abs();
    }
    let to_piece = |q: &[[f64; 2]]| {
        let d = [q[1][0] - q[0][0], q[1][1] - q[0][1]];
        let square = d[0] * d[0] + d[1] * d[1];
        let share = if square > 0.0 {
            (((p[0] - q[0][0]) * d[0] + (p[1] - q[0][1]) * d[1]) / square).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (q[0][0] + share * d[0] - p[0]).hypot(q[0][1] + share * d[1] - p[1])
    };
    curve.points().windows(2).map(to_piece).fold(f64::MAX, f64::min)
}
