//! Text of summaries: aligned tables and lists of facts, and phrases that several commands share.

use crate::numbers::{count, significant};
use planish::Unit;
use planish::model::{ScanPoseReport, SensorReport};
use planish::sense::SigmaSummary;

/// Quantiles of σ, or an empty text if there are none.
pub fn sigma_quantiles(sigma: Option<SigmaSummary>, unit: &str) -> String {
    sigma.map_or(String::new(), |s| {
        format!(
            "median {} {unit}, 95 % below {}, largest {}",
            significant(s.median, 3),
            significant(s.p95, 3),
            significant(s.max, 3)
        )
    })
}

/// Cells of a sensor that several tables share: name, readings, stated σ, estimated σ, and which σ was used.
pub fn sensor_cells(sensor: &SensorReport) -> [String; 5] {
    // The fit decides which σ it uses; the table must not repeat that decision.
    let used = if sensor.sigma_used_is_estimated { "estimated" } else { "stated" };
    // Normals and curvatures are not lengths, but the heading of the table states the unit of lengths.
    let name = match sensor.quantity.as_str() {
        "normal" => format!("{} (normals, °)", sensor.name),
        "curvature" => format!("{} (curvatures)", sensor.name),
        _ => sensor.name.clone(),
    };
    [
        name,
        count(sensor.observations),
        sensor.sigma_stated.map_or("–".to_owned(), |s| significant(s, 3)),
        significant(sensor.sigma_estimated, 3),
        used.to_owned(),
    ]
}

/// Text of a summary, built line by line; tables are aligned.
#[derive(Default)]
pub struct Lines {
    text: String,
}

/// Alignment of a column.
#[derive(Clone, Copy)]
pub enum Align {
    /// For words.
    Left,
    /// For numbers.
    Right,
}

impl Lines {
    /// Adds one line.
    pub fn line(&mut self, text: impl AsRef<str>) {
        // Rows are padded to their width, which would leave blanks at the end of a line.
        self.text.push_str(text.as_ref().trim_end());
        self.text.push('\n');
    }

    /// Adds an empty line.
    pub fn gap(&mut self) {
        self.text.push('\n');
    }

    /// Adds names with their values, one pair per line. Pairs with an empty value are left out.
    pub fn facts<const N: usize>(&mut self, facts: [(&str, String); N]) {
        let rows: Vec<Vec<String>> = facts
            .into_iter()
            // With empty values, a caller keeps one list for all cases, in a fixed order.
            .filter(|(_, value)| !value.is_empty())
            .map(|(name, value)| vec![name.to_owned(), value])
            .collect();
        self.rows(&[Align::Left, Align::Left], &rows);
    }

    /// Adds a table of the poses that were estimated, if there are any.
    pub fn poses(&mut self, poses: &[ScanPoseReport], unit: Unit) {
        // A pose without σ was fixed during the fit, so there is nothing to report about it.
        let uncertain = |p: &&ScanPoseReport| p.sigma_translation.is_some() || p.sigma_rotation_deg.is_some();
        let rows: Vec<Vec<String>> = poses
            .iter()
            .filter(uncertain)
            .map(|pose| {
                let known = |sigma: Option<f64>| sigma.map_or("exact".to_owned(), |s| significant(s, 3));
                vec![
                    pose.scan.clone(),
                    known(pose.sigma_translation),
                    known(pose.sigma_rotation_deg),
                    pose.moved.map_or("as stated".to_owned(), |moved| significant(moved, 3)),
                    pose.turned_deg.map_or(String::new(), |turned| significant(turned, 3)),
                ]
            })
            .collect();
        if !rows.is_empty() {
            self.gap();
            self.table(
                &[
                    ("pose", Align::Left),
                    (&format!("σ of translation / {unit}"), Align::Right),
                    ("σ of rotation / °", Align::Right),
                    (&format!("moved / {unit}"), Align::Right),
                    ("rotated / °", Align::Right),
                ],
                &rows,
            );
        }
    }

    /// Adds a table with a heading row.
    pub fn table(&mut self, head: &[(&str, Align)], rows: &[Vec<String>]) {
        // The heading is a row like any other, so that it counts for the widths.
        let titles = head.iter().map(|(title, _)| (*title).to_owned()).collect();
        let align: Vec<Align> = head.iter().map(|(_, align)| *align).collect();
        let mut all: Vec<Vec<String>> = vec![titles];
        all.extend_from_slice(rows);
        self.rows(&align, &all);
    }

    fn rows(&mut self, align: &[Align], rows: &[Vec<String>]) {
        // Characters, not bytes: `σ` and `χ²` take several bytes.
        let width = |column: usize| rows.iter().map(|r| r[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..align.len()).map(width).collect();
        for row in rows {
            let mut line = String::from("  ");
            for ((cell, &width), align) in row.iter().zip(&widths).zip(align) {
                let pad = " ".repeat(width - cell.chars().count());
                match align {
                    Align::Left => line.push_str(&format!("{cell}{pad}   ")),
                    Align::Right => line.push_str(&format!("{pad}{cell}   ")),
                }
            }
            self.line(line);
        }
    }

    /// The finished text.
    pub fn into_text(self) -> String {
        self.text
    }
}
