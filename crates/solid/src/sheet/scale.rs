//! The scale of a drawing: length of the part per length in the file.
//!
//! Dimensions tell it exactly: what they state over what they measure. A title block only says at which scale
//! the sheet is plotted. If the frame has the size of a paper, lengths are those on the paper; if it is
//! larger or smaller by the scale, they are those of the part.

use super::annotations::{Annotations, SheetDimension};
use super::frame::FoundFrame;

/// Share of the dimensions that must agree.
const MAJORITY: f64 = 0.6;
/// Scales of ISO 5455 and others in use, as lengths of the part per length on paper.
const SCALES: [f64; 17] =
    [0.01, 0.02, 0.05, 0.1, 0.2, 0.25, 0.4, 0.5, 1.0, 2.0, 2.5, 4.0, 5.0, 10.0, 20.0, 50.0, 100.0];
/// Sides of papers in mm: A4 to A0 of ISO 216, and A to E of ANSI/ASME Y14.1.
const PAPERS: [[f64; 2]; 10] = [
    [210.0, 297.0],
    [297.0, 420.0],
    [420.0, 594.0],
    [594.0, 841.0],
    [841.0, 1189.0],
    [215.9, 279.4],
    [279.4, 431.8],
    [431.8, 558.8],
    [558.8, 863.6],
    [863.6, 1117.6],
];
/// Tolerance of sizes of papers, in mm.
const PAPER_TOLERANCE: f64 = 1.0;

/// From what the scale is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScaleSource {
    /// Dimensions state it.
    Dimensions,
    /// The title block states it, and the size of the frame, or the factor of dimensions that the file sets,
    /// shows that lengths are those on paper, or those of the part.
    TitleBlock,
    /// The title block states another scale than 1:1, and nothing shows whether lengths are those on paper.
    Unknown,
    /// Nothing states another scale than 1:1.
    Unstated,
}

pub(super) fn scale_of(
    annotations: &Annotations,
    frame: Option<&FoundFrame>,
    unit_mm: f64,
) -> (f64, ScaleSource) {
    if let Some(scale) = scale_of_dimensions(&annotations.dimensions) {
        return (scale, ScaleSource::Dimensions);
    }
    let Some(stated) = stated_scale(annotations).filter(|scale| (scale - 1.0).abs() > 1e-9) else {
        return (1.0, ScaleSource::Unstated);
    };
    let sizes = || frame.into_iter().flat_map(|f| &f.sizes).map(|size| size.map(|s| s * unit_mm));
    if sizes().any(is_paper) {
        return (stated, ScaleSource::TitleBlock);
    }
    // The file would multiply lengths by the stated scale if it had dimensions.
    if annotations.length_factor.is_some_and(|factor| (factor - stated).abs() < 1e-6 * stated) {
        return (stated, ScaleSource::TitleBlock);
    }
    // A sheet at 1:2 that is drawn in the part's size has a frame of twice the paper's size.
    if sizes().any(|size| is_paper(size.map(|s| s / stated))) {
        return (1.0, ScaleSource::TitleBlock);
    }
    (1.0, ScaleSource::Unknown)
}

/// The scale on which most dimensions agree: length of the part per length of the drawing.
///
/// ```
/// use planish_solid::sheet::{SheetDimension, scale_of_dimensions};
///
/// let stated = |drawn, stated| SheetDimension { drawn, stated, rounding: 0.05 };
/// assert_eq!(scale_of_dimensions(&[stated(10.0, 20.0), stated(33.34, 66.7), stated(5.0, 5.0)]), Some(2.0));
/// assert_eq!(scale_of_dimensions(&[stated(10.0, 37.0)]), None);
/// ```
#[must_use]
pub fn scale_of_dimensions(dimensions: &[SheetDimension]) -> Option<f64> {
    let agrees = |scale: f64| {
        let own =
            dimensions.iter().filter(|d| (scale * d.drawn - d.stated).abs() <= d.rounding + 1e-3 * d.stated);
        own.count()
    };
    let (count, scale) = SCALES.iter().map(|scale| (agrees(*scale), *scale)).max_by(|a, b| {
        // Of equal counts, the scale nearest to 1.
        a.0.cmp(&b.0).then(b.1.ln().abs().total_cmp(&a.1.ln().abs()))
    })?;
    (count > 0 && count as f64 >= MAJORITY * dimensions.len() as f64).then_some(scale)
}

/// The scale in a text of its own such as `1:2`, or in the text behind a label.
fn stated_scale(annotations: &Annotations) -> Option<f64> {
    let mut stated: Vec<f64> = Vec::new();
    for text in &annotations.texts {
        let words: Vec<&str> = text.text.split_whitespace().collect();
        // `A-A (2:1)` and `Z 5:1` are scales of sections and details.
        let is_label = |word: &str| {
            let word = word.trim_end_matches(':').to_lowercase();
            ["scale", "maßstab", "massstab", "echelle", "échelle", "scala", "escala", "schaal"]
                .contains(&word.as_str())
        };
        match words[..] {
            [own] => stated.extend(ratio(own)),
            [label, own] if is_label(label) => stated.extend(ratio(own)),
            _ => {}
        }
    }
    let first = *stated.first()?;
    stated.iter().all(|other| (other - first).abs() < 1e-9).then_some(first)
}

/// Length of the part per length on paper of `1:2`.
fn ratio(text: &str) -> Option<f64> {
    let (paper, part) = text.split_once([':', '/'])?;
    let number = |text: &str| text.trim().replace(',', ".").parse().ok().filter(|x: &f64| *x > 0.0);
    let scale = number(part)? / number(paper)?;
    SCALES.iter().find(|known| (*known - scale).abs() < 1e-3 * scale).copied()
}

fn is_paper(size: [f64; 2]) -> bool {
    let (short, long) = (size[0].min(size[1]), size[0].max(size[1]));
    PAPERS.iter().any(|[a, b]| (short - a).abs() < PAPER_TOLERANCE && (long - b).abs() < PAPER_TOLERANCE)
}
