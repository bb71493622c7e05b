//! Line styles of elements: visible, hidden, centre line, or not displayed.

use crate::dash_pattern::style_of_pattern;
use planish_solid::views::LineStyle;
use roxmltree::{Document, Node};
use std::collections::HashMap;

/// The classes of `<style>` sheets.
///
/// Rules are parsed once, not for each element: a long sheet times many elements would take hours.
pub(super) struct Sheet(HashMap<String, Declared>);

/// What rules declare, each with the number of its rule: of several rules, the last one counts.
#[derive(Clone, Copy, Default)]
struct Declared {
    is_displayed: Option<(usize, bool)>,
    is_visible: Option<(usize, bool)>,
    line: Option<(usize, Option<LineStyle>)>,
}

impl Declared {
    /// The declarations of a rule or attribute; `number` is its position among those that may apply.
    fn parse(declarations: &str, number: usize) -> Self {
        let mut declared = Self::default();
        for (name, value) in declarations.split(';').filter_map(|d| d.split_once(':')) {
            declared = declared.followed_by(Self::parse_one(name.trim(), value.trim(), number));
        }
        declared
    }

    fn parse_one(name: &str, value: &str, number: usize) -> Self {
        match (name, value) {
            ("display", value) => Self { is_displayed: Some((number, value != "none")), ..Self::default() },
            ("visibility", "hidden" | "collapse") => {
                Self { is_visible: Some((number, false)), ..Self::default() }
            }
            ("visibility", "visible") => Self { is_visible: Some((number, true)), ..Self::default() },
            ("stroke-dasharray", "inherit") => Self::default(),
            ("stroke-dasharray", _) => Self { line: Some((number, dashed(value))), ..Self::default() },
            _ => Self::default(),
        }
    }

    /// Both together. Of two values, the one of the later rule counts, and of one rule that of `other`.
    fn followed_by(self, other: Self) -> Self {
        Self {
            is_displayed: later(self.is_displayed, other.is_displayed),
            is_visible: later(self.is_visible, other.is_visible),
            line: later(self.line, other.line),
        }
    }
}

fn later<T>(first: Option<(usize, T)>, second: Option<(usize, T)>) -> Option<(usize, T)> {
    match (first, second) {
        (Some(a), Some(b)) => Some(if b.0 >= a.0 { b } else { a }),
        (a, b) => b.or(a),
    }
}

impl Sheet {
    /// Collects the class rules of all `<style>` elements.
    pub(super) fn parse(document: &Document<'_>) -> Self {
        let texts =
            document.descendants().filter(|n| n.tag_name().name() == "style").filter_map(|n| n.text());
        let mut classes: HashMap<String, Declared> = HashMap::new();
        for (number, rule) in texts.flat_map(|text| text.split('}')).enumerate() {
            let Some((names, declarations)) = rule.split_once('{') else {
                continue;
            };
            let declared = Declared::parse(declarations, number);
            for name in names.split(',').filter_map(|n| n.trim().strip_prefix('.')) {
                let class = classes.entry(name.trim().to_owned()).or_default();
                *class = class.followed_by(declared);
            }
        }
        Self(classes)
    }
}

/// The inherited part of an element's style.
#[derive(Clone, Copy)]
pub(super) struct Style {
    /// Style of lines; none for centre lines.
    pub(super) line: Option<LineStyle>,
    /// False if the element and everything in it are left out (`display`).
    pub(super) is_displayed: bool,
    /// False if the element is not drawn (`visibility`). Children may be visible again.
    pub(super) is_visible: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self { line: Some(LineStyle::Visible), is_displayed: true, is_visible: true }
    }
}

impl Style {
    /// The style of an element whose parent has this style.
    pub(super) fn of_child(mut self, node: &Node<'_, '_>, sheet: &Sheet) -> Self {
        let classes: Vec<&str> =
            node.attribute("class").unwrap_or_default().split_ascii_whitespace().collect();
        // Names of groups and layers (Inkscape stores these in `label`) count as layer names of DXF do.
        let label = node.attributes().find(|a| a.name() == "label").map_or("", |a| a.value());
        let names =
            [node.attribute("id").unwrap_or_default(), label].into_iter().chain(classes.iter().copied());
        // Names come first, so that a stated pattern of dashes overrides them.
        for name in names {
            let name = name.to_uppercase();
            let mentions = |words: &[&str]| words.iter().any(|w| name.contains(w));
            if mentions(&["CENTER", "CENTRE", "DASHDOT", "PHANTOM"]) {
                self.line = None;
            } else if mentions(&["HIDDEN", "DASHED"]) {
                self.line = Some(LineStyle::Hidden);
            } else if mentions(&["VISIBLE"]) {
                self.line = Some(LineStyle::Visible);
            }
        }
        for attribute in ["stroke-dasharray", "display", "visibility"] {
            if let Some(value) = node.attribute(attribute) {
                self.declare(Declared::parse_one(attribute, value, 0));
            }
        }
        // In the order of CSS precedence: attributes, then class rules, then the attribute `style`.
        let of_classes = classes.iter().filter_map(|name| sheet.0.get(*name));
        self.declare(of_classes.fold(Declared::default(), |all, class| all.followed_by(*class)));
        self.declare(Declared::parse(node.attribute("style").unwrap_or_default(), 0));
        self
    }

    fn declare(&mut self, declared: Declared) {
        self.is_displayed = declared.is_displayed.map_or(self.is_displayed, |(_, displayed)| displayed);
        self.is_visible = declared.is_visible.map_or(self.is_visible, |(_, visible)| visible);
        self.line = declared.line.map_or(self.line, |(_, line)| line);
    }
}

/// Line style of a pattern of dashes and gaps.
fn dashed(value: &str) -> Option<LineStyle> {
    let separates = |c: char| c.is_ascii_whitespace() || c == ',';
    let length = |text: &str| {
        let end = text.find(|c: char| c.is_ascii_alphabetic() || c == '%').unwrap_or(text.len());
        text[..end].parse::<f64>().ok()
    };
    let all = value.split(separates).filter(|t| !t.is_empty()).filter_map(length).collect();
    style_of_pattern(all)
}
