//! Line styles of elements: visible, hidden, centre line, or not displayed.

use planish_solid::views::LineStyle;
use roxmltree::{Document, Node};

/// Minimum ratio of the longest to the shortest dash of a centre line. Hidden lines have equal dashes; centre
/// lines alternate long dashes with dots. Guarded by `dashes_are_hidden_lines_and_dash_dots_centre_lines`.
const CENTRE_LINE_RATIO: f64 = 1.5;

/// Class names of `<style>` sheets with their declarations.
pub(super) struct Sheet(Vec<(String, String)>);

impl Sheet {
    /// Collects the class rules of all `<style>` elements.
    pub(super) fn parse(document: &Document<'_>) -> Self {
        let texts =
            document.descendants().filter(|n| n.tag_name().name() == "style").filter_map(|n| n.text());
        let mut rules = Vec::new();
        for text in texts {
            for rule in text.split('}') {
                let Some((names, declarations)) = rule.split_once('{') else {
                    continue;
                };
                for name in names.split(',').filter_map(|n| n.trim().strip_prefix('.')) {
                    rules.push((name.trim().to_owned(), declarations.to_owned()));
                }
            }
        }
        Self(rules)
    }
}

/// The inherited part of an element's style.
#[derive(Clone, Copy)]
pub(super) struct Style {
    /// Style of lines; none for centre lines.
    pub(super) line: Option<LineStyle>,
    pub(super) is_shown: bool,
}

impl Default for Style {
    fn default() -> Self {
        Self { line: Some(LineStyle::Visible), is_shown: true }
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
                self.declare(attribute, value);
            }
        }
        // In the order of CSS precedence: attributes, then class rules, then the attribute `style`.
        for (name, declarations) in &sheet.0 {
            if classes.contains(&name.as_str()) {
                self.declare_all(declarations);
            }
        }
        self.declare_all(node.attribute("style").unwrap_or_default());
        self
    }

    fn declare_all(&mut self, declarations: &str) {
        for (name, value) in declarations.split(';').filter_map(|d| d.split_once(':')) {
            self.declare(name.trim(), value.trim());
        }
    }

    fn declare(&mut self, name: &str, value: &str) {
        match (name, value) {
            ("display", "none") | ("visibility", "hidden" | "collapse") => self.is_shown = false,
            ("visibility", "visible") => self.is_shown = true,
            ("stroke-dasharray", "inherit") => {}
            ("stroke-dasharray", _) => self.line = dashed(value),
            _ => {}
        }
    }
}

/// Line style of a pattern of dashes and gaps.
fn dashed(value: &str) -> Option<LineStyle> {
    let separates = |c: char| c.is_ascii_whitespace() || c == ',';
    let length = |text: &str| {
        let end = text.find(|c: char| c.is_ascii_alphabetic() || c == '%').unwrap_or(text.len());
        text[..end].parse::<f64>().ok()
    };
    let mut all: Vec<f64> = value.split(separates).filter(|t| !t.is_empty()).filter_map(length).collect();
    if all.iter().all(|x| *x <= 0.0) {
        return Some(LineStyle::Visible);
    }
    // A list of odd length is repeated, so that dashes and gaps alternate.
    if all.len() % 2 == 1 {
        all.extend(all.clone());
    }
    let dashes = all.iter().step_by(2);
    let (shortest, longest) = dashes.fold((f64::MAX, 0.0_f64), |(lo, hi), d| (lo.min(*d), hi.max(*d)));
    (longest <= CENTRE_LINE_RATIO * shortest).then_some(LineStyle::Hidden)
}
