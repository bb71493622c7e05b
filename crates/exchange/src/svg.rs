//! Reads the curves of drawings from SVG files (Scalable Vector Graphics).
//!
//! **Input.** `line`, `polyline`, `polygon`, `rect`, `circle`, `ellipse` and `path`, in groups with
//! transforms. Hidden lines are dashed strokes (`stroke-dasharray`, as an attribute, in `style` or by a class
//! of a `<style>` sheet) and everything in a group or layer named `hidden` or `dashed`. Centre lines are
//! dash-dot strokes and names with `center` or `centre`; they are ignored.
//!
//! **Output.** The same as for a DXF file. y points up, and lengths are in millimetres if `width` and
//! `viewBox` define them. Cubic curves that follow a circle within [`ARC_TOLERANCE`] of its radius become
//! arcs.
//!
//! **Limits.** Texts, pictures, clones (`use`) and clips give no edges. Fills without a stroke are read as
//! outlines.
//!
//! # References
//! W3C, *Scalable Vector Graphics (SVG) 2* (paths, units); *SVG 1.1*, appendix F.6 (arcs).

mod entities;
mod path;
mod style;
#[cfg(test)]
mod tests;

use crate::Unit;
use crate::affine::Affine;
pub use crate::bezier::ARC_TOLERANCE;
use crate::dxf::DxfDrawing;
use crate::source::{MAX_TEXT_BYTES, read_text};
use path::path_curves;
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_solid::views::{Curve2, DrawnCurve, LineStyle};
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use style::{Sheet, Style};

/// Maximum number of nodes of the document, which bounds the memory of the XML parser.
const MAX_ELEMENTS: u32 = 500_000;
/// Maximum number of curves; far above the drawing of a part.
const MAX_CURVES: usize = 200_000;
/// Maximum nesting of groups, which bounds the recursion.
const MAX_DEPTH: usize = 64;

/// Reads an SVG file.
///
/// # Errors
/// [`Io`](planish_estimate::ErrorKind::Io) if it cannot be read;
/// [`Input`](planish_estimate::ErrorKind::Input), naming element and line, if it is not an SVG file or an
/// element is invalid.
///
/// # Examples
/// ```
/// # let folder = tempfile::tempdir()?;
/// let path = folder.path().join("plate.svg");
/// std::fs::write(&path, r#"<svg xmlns="http://www.w3.org/2000/svg" width="40mm" viewBox="0 0 20 20">
///     <rect width="10" height="5"/></svg>"#)?;
/// let drawing = planish_exchange::svg::read_svg(&path)?;
/// // One user unit is 2 mm.
/// assert_eq!((drawing.curves.len(), drawing.curves[0].curve.length()), (4, 20.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn read_svg(path: &Path) -> Result<DxfDrawing> {
    read_text(path).and_then(|text| read(&text)).map_err(|e| e.in_context(path.display()))
}

fn read(text: &str) -> Result<DxfDrawing> {
    entities::check(text, MAX_TEXT_BYTES)?;
    // Drawing programs write a document type. Entities in it are expanded; the parser stops at entity loops.
    let options = ParsingOptions { allow_dtd: true, nodes_limit: MAX_ELEMENTS, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options)
        .map_err(|e| Error::input(format!("expected an SVG file: {e}")))?;
    let root = document.root_element();
    if root.tag_name().name() != "svg" {
        return Err(Error::input(format!(
            "expected an SVG file, found the element `{}`",
            root.tag_name().name()
        )));
    }
    // The scale of the page is applied first, so that all further lengths are user units.
    let (scale, unit) = scale(&root)?;
    let lines = text.match_indices('\n').map(|(at, _)| at).collect();
    let mut reader = Reader {
        lines,
        sheet: Sheet::parse(&document),
        drawing: DxfDrawing { unit, ..DxfDrawing::default() },
        ignored: BTreeMap::new(),
    };
    // y of SVG points down, y of a drawing up.
    let page = Affine { columns: [[scale, 0.0], [0.0, -scale]], origin: [0.0; 2] };
    reader.children(&root, &page, Style::default(), 0)?;
    let mut drawing = reader.drawing;
    for (kind, (count, first)) in reader.ignored {
        drawing.findings.push(Finding::new(
            FindingCode::EntitiesSkipped,
            format!("ignored {count} × {kind}, which draws no edges; the first is {first}"),
        ));
        drawing.ignored.insert(kind, count);
    }
    Ok(drawing)
}

struct Reader {
    /// Positions of the line ends. The parser counts them anew for each element, which takes quadratic time.
    lines: Vec<usize>,
    sheet: Sheet,
    drawing: DxfDrawing,
    ignored: BTreeMap<String, (usize, String)>,
}

impl Reader {
    fn children(&mut self, node: &Node<'_, '_>, outer: &Affine, style: Style, depth: usize) -> Result<()> {
        if depth > MAX_DEPTH {
            return Err(Error::input(format!(
                "{}: expected at most {MAX_DEPTH} nested groups, found more",
                self.name(node)
            )));
        }
        node.children().filter(Node::is_element).try_for_each(|child| {
            // Groups add no context: naming the element is enough, and nested groups would make long
            // messages.
            self.element(&child, outer, style, depth).map_err(|e| match child.tag_name().name() {
                "g" | "svg" | "a" | "switch" => e,
                _ => e.in_context(self.name(&child)),
            })
        })
    }

    fn element(&mut self, node: &Node<'_, '_>, outer: &Affine, style: Style, depth: usize) -> Result<()> {
        let style = style.of_child(node, &self.sheet);
        // An element that is not displayed leaves out its children, too.
        if !style.is_displayed {
            return Ok(());
        }
        let own = match node.attribute("transform") {
            Some(text) => transform(text)?,
            None => Affine::IDENTITY,
        };
        let place = outer.after(&own);
        if !place.is_finite() {
            return Err(Error::input("expected a transform with numbers below 1e15, found larger ones"));
        }
        let kind = node.tag_name().name();
        let curves = match kind {
            "g" | "a" | "switch" => return self.children(node, &place, style, depth + 1),
            "svg" => {
                let moved =
                    Affine { origin: [length(node, "x", 0.0)?, length(node, "y", 0.0)?], ..Affine::IDENTITY };
                return self.children(node, &place.after(&moved), style, depth + 1);
            }
            "line" => {
                let [a, b, c, d] = [
                    length(node, "x1", 0.0)?,
                    length(node, "y1", 0.0)?,
                    length(node, "x2", 0.0)?,
                    length(node, "y2", 0.0)?,
                ];
                vec![Curve2::Segment([a, b], [c, d])]
            }
            "polyline" | "polygon" => {
                polygon(node.attribute("points").unwrap_or_default(), kind == "polygon")?
            }
            "rect" => rectangle(node)?,
            "circle" => {
                let r = length(node, "r", 0.0)?;
                ellipse([length(node, "cx", 0.0)?, length(node, "cy", 0.0)?], [r, r])?
            }
            "ellipse" => ellipse(
                [length(node, "cx", 0.0)?, length(node, "cy", 0.0)?],
                [length(node, "rx", 0.0)?, length(node, "ry", 0.0)?],
            )?,
            "path" => path_curves(node.attribute("d").unwrap_or_default())?,
            // Definitions for other elements, and metadata: they draw nothing themselves.
            "defs" | "symbol" | "clipPath" | "mask" | "pattern" | "marker" | "style" | "title" | "desc"
            | "metadata" | "namedview" | "script" => return Ok(()),
            _ => {
                self.ignore(kind, self.name(node));
                return Ok(());
            }
        };
        if !style.is_visible {
            return Ok(());
        }
        // Decided after the geometry is parsed, so that errors in centre lines are reported as well.
        let Some(line_style) = style.line else {
            self.ignore("centre line", self.name(node));
            return Ok(());
        };
        self.add(&curves, line_style, &place, self.name(node))
    }

    fn add(&mut self, curves: &[Curve2], style: LineStyle, place: &Affine, entity: String) -> Result<()> {
        if self.drawing.curves.len() + curves.len() > MAX_CURVES {
            return Err(Error::input(format!("expected at most {MAX_CURVES} curves, found more")));
        }
        for curve in curves {
            let curve = place.curve(curve);
            if curve.length() <= 0.0 {
                self.drawing.findings.push(Finding::new(
                    FindingCode::EntityWithoutLength,
                    format!("{entity} has no length and is ignored"),
                ));
                continue;
            }
            self.drawing.curves.push(DrawnCurve { curve, style, entity: entity.clone() });
        }
        Ok(())
    }

    /// Description of an element for messages: kind, id and line.
    fn name(&self, node: &Node<'_, '_>) -> String {
        let line = 1 + self.lines.partition_point(|end| *end < node.range().start);
        match node.attribute("id") {
            Some(id) => format!("{} {id} (line {line})", node.tag_name().name()),
            None => format!("{} (line {line})", node.tag_name().name()),
        }
    }

    fn ignore(&mut self, kind: &str, name: String) {
        self.ignored.entry(kind.to_owned()).or_insert((0, name)).0 += 1;
    }
}

/// Parses a number below 1e12 in size, so that products cannot overflow.
fn number(text: &str) -> Result<f64> {
    text.trim().parse().ok().filter(|x: &f64| x.is_finite() && x.abs() < 1e12).ok_or_else(|| {
        let found: String = text.chars().take(40).collect();
        Error::input(format!("expected a number, found `{found}`"))
    })
}

/// Length of a unit in millimetres; none for relative units such as `px`, `%` and `em`.
fn millimetres(unit: &str) -> Option<f64> {
    match unit {
        "mm" => Some(1.0),
        "cm" => Some(10.0),
        "in" => Some(25.4),
        "pt" => Some(25.4 / 72.0),
        "pc" => Some(25.4 / 6.0),
        _ => None,
    }
}

/// Length attribute in user units (96 per inch, CSS), or its default.
fn length(node: &Node<'_, '_>, attribute: &str, default: f64) -> Result<f64> {
    let Some(text) = node.attribute(attribute) else {
        return Ok(default);
    };
    let text = text.trim();
    // `e` may belong to an exponent.
    let end = text.find(|c: char| c.is_ascii_alphabetic() && c != 'e' && c != 'E').unwrap_or(text.len());
    let value = number(&text[..end]).map_err(|e| e.in_context(attribute))?;
    match (&text[end..], millimetres(&text[end..])) {
        ("" | "px", _) => Ok(value),
        (_, Some(mm)) => Ok(value * mm / 25.4 * 96.0),
        (unit, None) => Err(Error::input(format!("{attribute}: expected a length, found the unit `{unit}`"))),
    }
}

/// Length of a user unit in millimetres, if the file defines it; else 1 and no unit.
fn scale(root: &Node<'_, '_>) -> Result<(f64, Option<Unit>)> {
    let Some(width) = root.attribute("width") else {
        return Ok((1.0, None));
    };
    let width = width.trim();
    let end = width.find(|c: char| c.is_ascii_alphabetic() || c == '%').unwrap_or(width.len());
    // Pixels and percentages have no size on paper, so the drawing has no unit.
    let Some(mm) = millimetres(&width[end..]) else {
        return Ok((1.0, None));
    };
    let value = number(&width[..end]).map_err(|e| e.in_context("width"))?;
    let units = match root.attribute("viewBox") {
        Some(text) => *numbers(text)?.get(2).ok_or_else(|| Error::input("viewBox: expected four numbers"))?,
        // Without a view box, a user unit is a CSS pixel, 1/96 inch.
        None => value * mm / 25.4 * 96.0,
    };
    // The scale divides by the size of the view box.
    match value > 0.0 && units > 0.0 {
        true => Ok((value * mm / units, Some(Unit::Millimetre))),
        false => Err(Error::input(format!("expected a width and a viewBox > 0, found {value} and {units}"))),
    }
}

/// Parses numbers separated by blanks and commas.
fn numbers(text: &str) -> Result<Vec<f64>> {
    text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|t| !t.is_empty()).map(number).collect()
}

fn polygon(text: &str, is_closed: bool) -> Result<Vec<Curve2>> {
    let values = numbers(text)?;
    // An odd last number is dropped, as SVG prescribes.
    let mut corners: Vec<[f64; 2]> = values.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
    if is_closed && let Some(first) = corners.first().copied() {
        corners.push(first);
    }
    Ok(corners.windows(2).map(|p| Curve2::Segment(p[0], p[1])).collect())
}

fn ellipse([x, y]: [f64; 2], [rx, ry]: [f64; 2]) -> Result<Vec<Curve2>> {
    if rx < 0.0 || ry < 0.0 {
        return Err(Error::input(format!("expected radii of at least 0, found {rx} and {ry}")));
    }
    // A radius of zero draws nothing (SVG 2, section 10.4).
    if rx == 0.0 || ry == 0.0 {
        return Ok(Vec::new());
    }
    let place = Affine { columns: [[rx, 0.0], [0.0, ry]], origin: [x, y] };
    Ok(vec![place.curve(&unit_arc(0.0, TAU))])
}

/// An arc of the unit circle.
fn unit_arc(start: f64, sweep: f64) -> Curve2 {
    Curve2::Arc { center: [0.0; 2], radius: 1.0, start, sweep }
}

fn rectangle(node: &Node<'_, '_>) -> Result<Vec<Curve2>> {
    let (x, y) = (length(node, "x", 0.0)?, length(node, "y", 0.0)?);
    let (w, h) = (length(node, "width", 0.0)?, length(node, "height", 0.0)?);
    if w < 0.0 || h < 0.0 {
        return Err(Error::input(format!("expected a width and a height of at least 0, found {w} and {h}")));
    }
    // A missing radius equals the other one (SVG 2, section 10.2).
    let given = [node.attribute("rx"), node.attribute("ry")].map(|r| r.is_some_and(|r| r != "auto"));
    let radius = |k: usize| length(node, ["rx", "ry"][if given[k] { k } else { 1 - k }], 0.0);
    let any = given[0] || given[1];
    let (rx, ry) =
        if any { (radius(0)?.clamp(0.0, w / 2.0), radius(1)?.clamp(0.0, h / 2.0)) } else { (0.0, 0.0) };
    let mut curves = vec![
        Curve2::Segment([x + rx, y], [x + w - rx, y]),
        Curve2::Segment([x + w, y + ry], [x + w, y + h - ry]),
        Curve2::Segment([x + w - rx, y + h], [x + rx, y + h]),
        Curve2::Segment([x, y + h - ry], [x, y + ry]),
    ];
    // Radii of half a side leave no straight part.
    curves.retain(|c| c.length() > 0.0);
    if rx > 0.0 && ry > 0.0 {
        for (center, start) in [
            ([x + w - rx, y + h - ry], 0.0),
            ([x + rx, y + h - ry], PI / 2.0),
            ([x + rx, y + ry], PI),
            ([x + w - rx, y + ry], 1.5 * PI),
        ] {
            let place = Affine { columns: [[rx, 0.0], [0.0, ry]], origin: center };
            curves.push(place.curve(&unit_arc(start, PI / 2.0)));
        }
    }
    Ok(curves)
}

/// Parses a list of transforms; the last is applied first.
fn transform(text: &str) -> Result<Affine> {
    let mut all = Affine::IDENTITY;
    let mut left = text.trim_matches(|c: char| c.is_ascii_whitespace() || c == ',');
    while !left.is_empty() {
        let wrong = || {
            let found: String = text.chars().take(60).collect();
            Error::input(format!("expected a list of transforms, found `{found}`"))
        };
        let (kind, rest) = left.split_once('(').ok_or_else(wrong)?;
        let (inside, rest) = rest.split_once(')').ok_or_else(wrong)?;
        let v = numbers(inside)?;
        let with = |columns: [[f64; 2]; 2], origin: [f64; 2]| Affine { columns, origin };
        let identity = Affine::IDENTITY.columns;
        let one = match (kind.trim(), &v[..]) {
            ("matrix", [a, b, c, d, e, f]) => with([[*a, *b], [*c, *d]], [*e, *f]),
            ("translate", [x]) => with(identity, [*x, 0.0]),
            ("translate", [x, y]) => with(identity, [*x, *y]),
            ("scale", [s]) => with([[*s, 0.0], [0.0, *s]], [0.0; 2]),
            ("scale", [x, y]) => with([[*x, 0.0], [0.0, *y]], [0.0; 2]),
            ("rotate", [angle]) => rotation(*angle, [0.0; 2]),
            ("rotate", [angle, x, y]) => rotation(*angle, [*x, *y]),
            ("skewX", [angle]) => with([[1.0, 0.0], [angle.to_radians().tan(), 1.0]], [0.0; 2]),
            ("skewY", [angle]) => with([[1.0, angle.to_radians().tan()], [0.0, 1.0]], [0.0; 2]),
            _ => return Err(wrong()),
        };
        all = all.after(&one);
        left = rest.trim_start_matches(|c: char| c.is_ascii_whitespace() || c == ',');
    }
    Ok(all)
}

/// Rotation about a point by an angle in degrees.
fn rotation(angle: f64, [x, y]: [f64; 2]) -> Affine {
    let (sin, cos) = angle.to_radians().sin_cos();
    Affine { columns: [[cos, sin], [-sin, cos]], origin: [x - cos * x + sin * y, y - sin * x - cos * y] }
}
