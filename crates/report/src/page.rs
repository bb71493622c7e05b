//! The parts of a page, and its HTML.

use crate::policy::{ASSETS, content_policy};
use crate::scene::Scene;
use askama::Template;
use planish_core::{Finding, FindingLevel};

/// The CSS class of a level.
pub(crate) fn class(level: &FindingLevel) -> &'static str {
    match level {
        FindingLevel::Info => "good",
        FindingLevel::Warning => "look",
        FindingLevel::Error => "bad",
    }
}

/// A symbol before the text, so that the level does not depend on colour alone.
pub(crate) fn sign(level: &FindingLevel) -> &'static str {
    match level {
        FindingLevel::Info => "✓",
        FindingLevel::Warning => "!",
        FindingLevel::Error => "✕",
    }
}

/// A finding as a sentence: with a capital and a full stop. Names of files and symbols stay as they are.
pub(crate) fn sentence(text: &str) -> String {
    let end = if text.ends_with(['.', '!', '?']) { "" } else { "." };
    // A first word with a dot is the name of a file, whose case matters.
    let names_file = text.split([':', ' ']).next().is_some_and(|word| word.contains('.'));
    let mut letters = text.chars();
    match letters.next().filter(|first| first.is_ascii_lowercase() && !names_file) {
        Some(first) => format!("{}{}{end}", first.to_ascii_uppercase(), letters.as_str()),
        None => format!("{text}{end}"),
    }
}

/// One of the key figures at the top of the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Name of the quantity.
    pub name: String,
    /// Value with unit.
    pub value: String,
    /// A reference for comparison; may be empty.
    pub note: String,
}

impl Figure {
    /// Creates a figure.
    #[must_use]
    pub fn new(name: impl Into<String>, value: impl Into<String>, note: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into(), note: note.into() }
    }
}

/// A table; numbers are right-aligned.
///
/// # Examples
/// ```
/// let mut table = planish_report::Table::new(["name", "value"]);
/// table.row(["a".to_owned(), "1".to_owned()], true);
/// assert_eq!((table.head.len(), table.rows.len(), table.marked[0]), (2, 1, true));
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Column titles.
    pub head: Vec<String>,
    /// Rows, each with one cell for each column.
    pub rows: Vec<Vec<String>>,
    /// For each row, true if it is highlighted; missing entries count as false.
    pub marked: Vec<bool>,
}

impl Table {
    /// Creates an empty table with these column titles.
    #[must_use]
    pub fn new<const N: usize>(head: [&str; N]) -> Self {
        Self { head: head.map(str::to_owned).to_vec(), ..Self::default() }
    }

    /// Adds a row; `marked` highlights it.
    pub fn row<const N: usize>(&mut self, cells: [String; N], marked: bool) {
        self.rows.push(cells.to_vec());
        self.marked.push(marked);
    }

    /// True if a row is highlighted. The template passes references.
    fn is_marked(&self, row: &usize) -> bool {
        self.marked.get(*row).copied().unwrap_or(false)
    }
}

/// A block of a section.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Block {
    /// A paragraph.
    Text(String),
    /// A table.
    Table(Table),
    /// Preformatted lines.
    Lines(String),
    /// A drawing with a caption.
    ///
    /// The SVG is inserted without escaping. It must come from [`crate::plot`] or another writer of Planish.
    Drawing {
        /// The SVG element.
        svg: String,
        /// Description below the drawing.
        caption: String,
    },
}

/// A section of the page with a heading.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// The content.
    pub blocks: Vec<Block>,
}

impl Section {
    /// Creates a section.
    #[must_use]
    pub fn new(title: impl Into<String>, blocks: Vec<Block>) -> Self {
        Self { title: title.into(), blocks }
    }
}

/// A report page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// Name of the command, such as `fit`.
    pub job: String,
    /// Subject of the page: the names of the files.
    pub title: String,
    /// One sentence that summarises the result.
    pub headline: String,
    /// The verdict; shown with the most serious finding first.
    pub findings: Vec<Finding>,
    /// Key figures.
    pub figures: Vec<Figure>,
    /// Content of the 3D view.
    pub scene: Option<Scene>,
    /// Drawings in place of the 3D view, or below it.
    pub drawings: Vec<Block>,
    /// All other content.
    pub sections: Vec<Section>,
}

/// Replaces spaces between thousands by narrow no-break spaces, so that numbers are not broken across lines.
pub(crate) fn with_unbroken_numbers(text: &str) -> String {
    let letters: Vec<char> = text.chars().collect();
    let is_digit = |k: usize| letters.get(k).is_some_and(char::is_ascii_digit);
    (letters.iter().enumerate())
        .map(|(k, &c)| {
            // Exactly three digits follow: other numbers may stand side by side, as in lists.
            let thousands =
                c == ' ' && k > 0 && is_digit(k - 1) && (1..=3).all(|d| is_digit(k + d)) && !is_digit(k + 4);
            if thousands { '\u{202f}' } else { c }
        })
        .collect()
}

/// The values of the template `page.html`.
#[derive(Template)]
#[template(path = "page.html")]
struct Html<'a> {
    page: &'a Page,
    level: FindingLevel,
    findings: Vec<&'a Finding>,
    scene: Option<String>,
    policy: &'static str,
    style: &'static str,
    scripts: &'static [String],
}

impl Page {
    /// Severity of the most serious finding; [`FindingLevel::Info`] without findings.
    #[must_use]
    pub fn level(&self) -> FindingLevel {
        self.findings.iter().map(|f| f.level).max().unwrap_or_default()
    }

    /// Renders the page as one HTML document.
    ///
    /// # Errors
    /// The error of the template engine; rendering fails only without memory.
    pub fn html(&self) -> Result<String, askama::Error> {
        let mut findings: Vec<&Finding> = self.findings.iter().collect();
        // A stable sort: findings of equal severity keep the order of the job.
        findings.sort_by_key(|finding| std::cmp::Reverse(finding.level));
        // `</script>` in a name would end the script element, so `<` is escaped.
        let scene = self.scene.as_ref().and_then(Scene::packed);
        let scene = scene.map(|packed| packed.to_string().replace('<', "\\u003c"));
        Html {
            page: self,
            level: self.level(),
            findings,
            scene,
            policy: content_policy(),
            style: &ASSETS.style,
            scripts: &ASSETS.scripts,
        }
        .render()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Cloud, LineSet, Mark, SurfaceShown};
    use planish_core::DVec3;
    use planish_core::FindingCode;

    fn page() -> Page {
        Page {
            job: "fit".to_owned(),
            title: "<b>&\"'".to_owned(),
            findings: vec![
                Finding::new(FindingCode::Converged, "good <i>"),
                Finding::new(FindingCode::NoSolid, "bad"),
                Finding::new(FindingCode::DepthLimit, "look"),
            ],
            ..Page::default()
        }
    }

    #[test]
    fn names_are_escaped_everywhere() {
        let mut page = page();
        page.scene = Some(Scene {
            surfaces: vec![SurfaceShown {
                name: "</script><script>alert(1)".to_owned(),
                positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
                triangles: vec![[0, 1, 2]],
                ..SurfaceShown::default()
            }],
            ..Scene::default()
        });
        let html = page.html().unwrap();
        assert!(!html.contains("<b>&") && !html.contains("ood <i>") && !html.contains("<script>alert"));
        assert_eq!(html.matches("<script").count(), html.matches("</script>").count());
    }

    #[test]
    fn the_policy_permits_the_scripts_and_styles_of_the_page_only() {
        let mut page = page();
        page.scene = Some(Scene {
            surfaces: vec![SurfaceShown {
                positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
                triangles: vec![[0, 1, 2]],
                ..SurfaceShown::default()
            }],
            ..Scene::default()
        });
        for html in [page.html().unwrap(), Page::default().html().unwrap()] {
            let policy = html.split("Content-Security-Policy\" content=\"").nth(1).unwrap();
            let policy = policy.split('"').next().unwrap();
            assert_eq!(policy, content_policy());
            // The text that a browser hashes: everything between the tags. Data are not run.
            let inside = |element: &str| -> Vec<String> {
                let [begin, end] = [format!("<{element}>"), format!("</{element}>")];
                html.split(&begin).skip(1).map(|part| part.split(&end).next().unwrap().to_owned()).collect()
            };
            for text in inside("style").into_iter().chain(inside("script")) {
                assert!(
                    policy.contains(&crate::policy::hash_source(&text)),
                    "{}",
                    &text[..40.min(text.len())]
                );
            }
            assert_eq!(html.matches("<script").count(), if html.contains("id=\"scene\"") { 3 } else { 0 });
            assert_eq!(html.matches("<style").count(), 1);
            assert!(html.find("Content-Security-Policy") < html.find("<style"));
        }
    }

    #[test]
    fn the_most_serious_finding_comes_first() {
        let html = page().html().unwrap();
        let at = |text: &str| html.find(&format!("<span>{text}")).unwrap();
        assert!(at("Bad") < at("Look") && at("Look") < at("Good"));
        assert_eq!(page().level(), FindingLevel::Error);
        assert!(html.contains("class=\"verdict bad\""));
        // Without a scene, the page has no script.
        assert!(!html.contains("<script"));
    }

    #[test]
    fn findings_are_sentences() {
        assert_eq!(sentence("the mesh is open"), "The mesh is open.");
        assert_eq!(sentence("a.ply: no unit."), "a.ply: no unit.");
        assert_eq!(sentence("σ is too small"), "σ is too small.");
    }

    #[test]
    fn thousands_are_joined_but_lists_are_not() {
        assert_eq!(
            with_unbroken_numbers("10 607 readings, 1 of 234 567"),
            "10\u{202f}607 readings, 1 of 234\u{202f}567"
        );
        assert_eq!(with_unbroken_numbers("1, 234 and 12 3456"), "1, 234 and 12 3456");
    }

    #[test]
    fn outliers_are_packed_but_do_not_determine_the_view() {
        let scene = Scene {
            surfaces: vec![SurfaceShown {
                positions: vec![
                    DVec3::new(1e6, 0.0, 0.0),
                    DVec3::new(1e6 + 2.0, 0.0, 0.0),
                    DVec3::new(1e6, 4.0, 0.0),
                ],
                triangles: vec![[0, 1, 2]],
                ..SurfaceShown::default()
            }],
            clouds: vec![Cloud { positions: vec![DVec3::new(1e6 - 99.0, 0.0, 0.0)], ..Cloud::default() }],
            lines: vec![LineSet {
                segments: vec![[DVec3::new(1e6, 0.0, 0.0), DVec3::new(1e6, 4.0, 0.0)]],
                ..LineSet::default()
            }],
            marks: vec![Mark {
                at: DVec3::new(1e6 + 1.0, 2.0, 0.0),
                label: "1".to_owned(),
                text: String::new(),
                normal: DVec3::Z,
            }],
            ..Scene::default()
        };
        let packed = scene.packed().unwrap();
        assert_eq!(packed["centre"], serde_json::json!([1e6 + 1.0, 2.0, 0.0]));
        assert_eq!(packed["low"], serde_json::json!([-1.0, -2.0, 0.0]));
        assert_eq!(packed["steps"][0], serde_json::json!([-100.0, -2.0, 0.0]));
        assert_eq!(packed["marks"][0]["at"], serde_json::json!(DVec3::ZERO));
        assert!(Scene::default().packed().is_none());
    }
}
