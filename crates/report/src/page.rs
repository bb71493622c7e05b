//! A page: its parts, and its HTML.

use crate::scene::Scene;
use askama::Template;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Level {
    /// As it should be.
    #[default]
    Good,
    /// Worth a look.
    Look,
    /// The result cannot be trusted until this is settled.
    Bad,
}

impl Level {
    fn class(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Look => "look",
            Self::Bad => "bad",
        }
    }

    /// What stands before the words, so that colour is not needed.
    fn sign(self) -> &'static str {
        match self {
            Self::Good => "✓",
            Self::Look => "!",
            Self::Bad => "✕",
        }
    }
}

/// A sentence of the verdict.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// How much it matters.
    pub level: Level,
    /// In plain words.
    pub text: String,
}

impl Finding {
    /// A finding.
    #[must_use]
    pub fn new(level: Level, text: impl Into<String>) -> Self {
        Self { level, text: text.into() }
    }
}

/// One of the few figures that stand on top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// Its value with its unit.
    pub value: String,
    /// What to compare it with; may be empty.
    pub note: String,
}

impl Figure {
    /// A figure.
    #[must_use]
    pub fn new(name: impl Into<String>, value: impl Into<String>, note: impl Into<String>) -> Self {
        Self { name: name.into(), value: value.into(), note: note.into() }
    }
}

/// A table; numbers stand right.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Its head.
    pub head: Vec<String>,
    /// Its rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
    /// For each row, whether it is to be noticed; may be shorter.
    pub marked: Vec<bool>,
}

impl Table {
    /// A table with this head.
    #[must_use]
    pub fn new<const N: usize>(head: [&str; N]) -> Self {
        Self { head: head.map(str::to_owned).to_vec(), ..Self::default() }
    }

    /// Adds a row.
    pub fn row<const N: usize>(&mut self, cells: [String; N], marked: bool) {
        self.rows.push(cells.to_vec());
        self.marked.push(marked);
    }

    fn is_marked(&self, row: &usize) -> bool {
        self.marked.get(*row).copied().unwrap_or(false)
    }
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Block {
    /// A paragraph.
    Text(String),
    /// A table.
    Table(Table),
    /// Lines as they are.
    Lines(String),
    /// A drawing: SVG that is trusted, made by [`crate::plot`] or by a writer of ours, and what it shows.
    Drawing {
        /// The SVG element.
        svg: String,
        /// What it shows.
        caption: String,
    },
}

/// A part of the page under a heading.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Section {
    /// The heading.
    pub title: String,
    /// What stands under it.
    pub blocks: Vec<Block>,
}

impl Section {
    /// A section.
    #[must_use]
    pub fn new(title: impl Into<String>, blocks: Vec<Block>) -> Self {
        Self { title: title.into(), blocks }
    }
}

/// A page.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
    /// The command: `fit`.
    pub job: String,
    /// What the page is of: names of files.
    pub title: String,
    /// One sentence that says it all.
    pub headline: String,
    /// The verdict; the worst stand first.
    pub findings: Vec<Finding>,
    /// Few figures.
    pub figures: Vec<Figure>,
    /// What is shown in 3D.
    pub scene: Option<Scene>,
    /// Drawings that stand where the 3D view does, or under it.
    pub drawings: Vec<Block>,
    /// Everything else.
    pub sections: Vec<Section>,
}

/// A text in whose numbers no line breaks: the spaces between thousands become narrow ones that hold.
pub(crate) fn glued(text: &str) -> String {
    let letters: Vec<char> = text.chars().collect();
    let is_digit = |k: usize| letters.get(k).is_some_and(char::is_ascii_digit);
    (letters.iter().enumerate())
        .map(|(k, &c)| {
            let thousands =
                c == ' ' && k > 0 && is_digit(k - 1) && (1..=3).all(|d| is_digit(k + d)) && !is_digit(k + 4);
            if thousands { '\u{202f}' } else { c }
        })
        .collect()
}

#[derive(Template)]
#[template(path = "page.html")]
struct Html<'a> {
    page: &'a Page,
    level: Level,
    findings: Vec<&'a Finding>,
    scene: Option<String>,
    style: &'static str,
    three: &'static str,
    viewer: &'static str,
}

impl Page {
    /// The gravest finding.
    #[must_use]
    pub fn level(&self) -> Level {
        self.findings.iter().map(|f| f.level).max().unwrap_or_default()
    }

    /// The page as HTML.
    ///
    /// # Errors
    /// What the template reports; nothing, unless memory runs out.
    pub fn html(&self) -> Result<String, askama::Error> {
        let mut findings: Vec<&Finding> = self.findings.iter().collect();
        findings.sort_by_key(|finding| std::cmp::Reverse(finding.level));
        // A name must not end the script that holds it.
        let scene = self.scene.as_ref().and_then(Scene::packed);
        let scene = scene.map(|packed| packed.to_string().replace('<', "\\u003c"));
        Html {
            page: self,
            level: self.level(),
            findings,
            scene,
            style: include_str!("../assets/page.css"),
            three: include_str!("../assets/three.min.js"),
            viewer: include_str!("../assets/viewer.js"),
        }
        .render()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Cloud, LineSet, Mark, SurfaceShown};

    fn page() -> Page {
        Page {
            job: "fit".to_owned(),
            title: "<b>&\"'".to_owned(),
            findings: vec![
                Finding::new(Level::Good, "good <i>"),
                Finding::new(Level::Bad, "bad"),
                Finding::new(Level::Look, "look"),
            ],
            ..Page::default()
        }
    }

    #[test]
    fn names_stay_text_wherever_they_stand() {
        let mut page = page();
        page.scene = Some(Scene {
            surfaces: vec![SurfaceShown {
                name: "</script><script>alert(1)".to_owned(),
                positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                triangles: vec![[0, 1, 2]],
                ..SurfaceShown::default()
            }],
            ..Scene::default()
        });
        let html = page.html().unwrap();
        assert!(!html.contains("<b>&") && !html.contains("good <i>") && !html.contains("<script>alert"));
        assert_eq!(html.matches("<script").count(), html.matches("</script>").count());
    }

    #[test]
    fn the_gravest_finding_stands_first() {
        let html = page().html().unwrap();
        let at = |text: &str| html.find(&format!("<span>{text}")).unwrap();
        assert!(at("bad") < at("look") && at("look") < at("good"));
        assert_eq!(page().level(), Level::Bad);
        assert!(html.contains("class=\"verdict bad\""));
        // Nothing to draw: no viewer.
        assert!(!html.contains("<script"));
    }

    #[test]
    fn thousands_hold_together_and_lists_do_not() {
        assert_eq!(glued("10 607 readings, 1 of 234 567"), "10\u{202f}607 readings, 1 of 234\u{202f}567");
        assert_eq!(glued("1, 234 and 12 3456"), "1, 234 and 12 3456");
    }

    #[test]
    fn what_lies_far_out_is_packed_and_not_looked_at() {
        let scene = Scene {
            surfaces: vec![SurfaceShown {
                positions: vec![[1e6, 0.0, 0.0], [1e6 + 2.0, 0.0, 0.0], [1e6, 4.0, 0.0]],
                triangles: vec![[0, 1, 2]],
                ..SurfaceShown::default()
            }],
            clouds: vec![Cloud { positions: vec![[1e6 - 99.0, 0.0, 0.0]], ..Cloud::default() }],
            lines: vec![LineSet { segments: vec![[[1e6, 0.0, 0.0], [1e6, 4.0, 0.0]]], ..LineSet::default() }],
            marks: vec![Mark {
                at: [1e6 + 1.0, 2.0, 0.0],
                label: "1".to_owned(),
                text: String::new(),
                normal: [0.0, 0.0, 1.0],
            }],
            ..Scene::default()
        };
        let packed = scene.packed().unwrap();
        assert_eq!(packed["centre"], serde_json::json!([1e6 + 1.0, 2.0, 0.0]));
        assert_eq!(packed["low"], serde_json::json!([-1.0, -2.0, 0.0]));
        assert_eq!(packed["steps"][0], serde_json::json!([-100.0, -2.0, 0.0]));
        assert_eq!(packed["marks"][0]["at"], serde_json::json!([0.0, 0.0, 0.0]));
        assert!(Scene::default().packed().is_none());
    }
}
