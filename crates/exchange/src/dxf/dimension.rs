//! Finds dimensions that conflict with the drawing.
//!
//! **Input.** `DIMENSION` entities (linear, aligned, diameter and radius) and the curves of the drawing.
//!
//! **Output.** One message per dimension whose number differs from the distance of its points, and one per
//! dimension whose points lie on no line (the drawing was changed later). Messages name the entity.
//!
//! The length that a dimension states is the number of its text, or the distance of its points times the
//! factor of its style (`DIMLFAC`). Drawings at a scale state lengths that differ from the distances by one
//! factor.
//!
//! **Limits.** Angles, ordinates and texts without a number are not checked.

use super::DxfDrawing;
use super::groups::Record;
use crate::dimension_text::{has_diameter_sign, stated_length};
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_solid::sheet::{SheetDimension, scale_of_dimensions};
use planish_solid::views::Curve2;
use std::collections::{HashMap, HashSet};

/// Tolerance of the distance of a dimension's points from lines, as a share of the size of the drawing. Too
/// small a value reports rounded coordinates, too large a value overlooks small changes of the drawing.
const ON_LINE_SHARE: f64 = 2e-3;

/// Factors from distances to the lengths that dimensions show.
#[derive(Default)]
pub(super) struct DimensionLengths {
    /// Of the header, for dimensions without a style of the table.
    factor: Option<f64>,
    by_style: HashMap<String, f64>,
    /// Styles that write Ø before each length.
    of_diameters: HashSet<String>,
}

impl DimensionLengths {
    /// Reads `$DIMLFAC`.
    pub(super) fn read_header(&mut self, header: &Record) {
        let at = header.groups.iter().position(|g| g.code == 9 && g.value == "$DIMLFAC");
        let value = at.and_then(|at| header.groups.get(at + 1)).and_then(|g| g.number().ok());
        self.factor = value.filter(|f| *f > 0.0);
    }

    /// Reads a record of the table of dimension styles.
    pub(super) fn read_style(&mut self, style: &Record) -> Result<()> {
        // A negative factor is that of layouts only.
        if let (Some(name), Some(factor)) = (style.text(2), style.number(144)?.filter(|f| *f > 0.0)) {
            self.by_style.insert(name.to_uppercase(), factor);
        }
        // DIMPOST: what precedes and follows the length.
        if let Some(name) = style.text(2).filter(|_| style.text(3).is_some_and(has_diameter_sign)) {
            self.of_diameters.insert(name.to_uppercase());
        }
        Ok(())
    }

    /// Ends of the lengths that dimensions state as diameters.
    pub(super) fn diameters(&self, dimensions: &[&Record]) -> Result<Vec<[[f64; 2]; 2]>> {
        let mut found = Vec::new();
        for record in dimensions {
            let text = record.text(1).unwrap_or_default();
            // A text of its own replaces what the style writes.
            let by_style = (text.is_empty() || text.contains("<>"))
                && self.of_diameters.contains(&record.text(3).unwrap_or("STANDARD").to_uppercase());
            if has_diameter_sign(text) || by_style {
                found.extend(Measured::from_record(record)?.map(|measured| measured.ends()));
            }
        }
        Ok(found)
    }

    /// The lengths that dimensions measure and state.
    pub(super) fn of(&self, dimensions: &[&Record]) -> Result<Vec<SheetDimension>> {
        let mut found = Vec::new();
        for record in dimensions {
            let Some(drawn) = Measured::from_record(record)?.map(|m| m.length()).filter(|d| *d > 0.0) else {
                continue;
            };
            let (stated, rounding) = match stated_length(record.text(1).unwrap_or_default()) {
                Some(stated) => stated,
                None => (drawn * self.factor_of(record)?, 0.0),
            };
            found.push(SheetDimension { drawn, stated, rounding });
        }
        Ok(found)
    }

    /// The factor other than 1 of the header or of a style, if there is only one: templates have styles for
    /// many scales.
    pub(super) fn only_factor(&self) -> Option<f64> {
        let all = self.factor.into_iter().chain(self.by_style.values().copied());
        let mut factors: Vec<f64> = all.filter(|factor| *factor != 1.0).collect();
        factors.sort_by(f64::total_cmp);
        factors.dedup();
        (factors.len() == 1).then(|| factors[0])
    }

    /// The factor of a dimension: its own, that of its style, or that of the header.
    fn factor_of(&self, record: &Record) -> Result<f64> {
        // Extended data: the number of the variable (144), and its value.
        let own =
            record.groups.windows(2).find(|g| g[0].code == 1070 && g[0].value == "144" && g[1].code == 1040);
        if let Some(groups) = own {
            return groups[1].number();
        }
        let style = record.text(3).unwrap_or("STANDARD").to_uppercase();
        Ok(self.by_style.get(&style).copied().or(self.factor).unwrap_or(1.0))
    }
}

/// Describes each dimension that conflicts with the drawing.
pub(super) fn conflicts(dimensions: &[&Record], drawing: &DxfDrawing) -> Result<Vec<Finding>> {
    let curves = &drawing.curves;
    let scale = scale_of_dimensions(&drawing.annotations.dimensions).unwrap_or(1.0);
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
        let drawn = measured.length();
        let exact = scale * drawn;
        let text = stated_length(record.text(1).unwrap_or_default());
        let kept = record.number(42)?.filter(|m| *m > 0.0).map(|m| (m, 1e-6 * m));
        // An explicit text is what people read, so it takes precedence over the stored measurement.
        if let Some((value, rounding)) = text.or(kept)
            && [drawn, exact].iter().all(|length| (value - length).abs() > rounding + 1e-6 * length)
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

    /// The ends of the measured length: the second is moved into the direction of the measurement.
    fn ends(&self) -> [[f64; 2]; 2] {
        let [a, b] = self.points;
        let Some(along) = self.along else { return [a, b] };
        let length = (b[0] - a[0]) * along[0] + (b[1] - a[1]) * along[1];
        [a, [0, 1].map(|k| a[k] + length * along[k])]
    }

    /// Points that must lie on lines.
    fn touching(&self) -> Vec<[f64; 2]> {
        self.points[usize::from(!self.both)..].to_vec()
    }
}

fn distance_to(curve: &Curve2, p: [f64; 2]) -> f64 {
    if let Curve2::Arc { center, radius, .. } = curve {
        // The whole circle counts: the diameter of an arc has its other end on the part that is not drawn. So
        // does the centre, from which places of holes are measured.
        let off = (p[0] - center[0]).hypot(p[1] - center[1]);
        return off.min((off - radius).abs());
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
