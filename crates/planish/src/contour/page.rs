//! The report of contours.

use crate::contour::{ConstrainedReport, ContourReport, PartReport};
use crate::report::title_of;
use crate::report::words::{head, with_article};
use planish_report::numbers::{count, counted, significant};
use planish_report::{Block, Figure, Page, Section, Table};
use std::path::{Path, PathBuf};

/// The page of contours, with their drawing.
pub(crate) fn contour_page(report: &ContourReport, svg: &str, input: &Path) -> Page {
    let unit = report.unit.map_or("", |unit| unit.name());
    let mut sections = Vec::new();
    for (k, part) in report.contours.iter().enumerate() {
        let title = match report.contours.len() {
            1 => with_article(&part.kind),
            _ => format!("Contour {}: {}", k + 1, part.kind),
        };
        sections.push(Section::new(title, part_blocks(part, unit)));
    }
    if let Some(constrained) = &report.constrained {
        sections.extend(constrained_sections(constrained, unit));
    }
    Page {
        job: "contour".to_owned(),
        title: title_of(&[PathBuf::from(input)]),
        headline: headline(report),
        findings: report.findings.clone(),
        figures: figures(report, unit),
        scene: None,
        drawings: vec![Block::Drawing {
            svg: svg.to_owned(),
            caption:
                "Contours (lines) and readings (dots; open red dots were rejected), with dimensions ± σ."
                    .to_owned(),
        }],
        sections,
    }
}

/// The kinds of the contours and the number of readings.
pub(crate) fn headline(report: &ContourReport) -> String {
    let readings = report.contours.iter().map(|p| p.readings).sum();
    format!("{} in {}.", kinds_of(report), counted(readings, "reading"))
}

fn kinds_of(report: &ContourReport) -> String {
    // A list keeps the order of the contours, the largest first.
    let mut kinds: Vec<(String, usize)> = Vec::new();
    for part in &report.contours {
        match kinds.iter_mut().find(|(kind, _)| *kind == part.kind) {
            Some((_, n)) => *n += 1,
            None => kinds.push((part.kind.clone(), 1)),
        }
    }
    let names: Vec<String> = kinds
        .into_iter()
        .map(|(kind, n)| if n == 1 { format!("One {kind}") } else { format!("{n} × {kind}") })
        .collect();
    names.join(", ")
}

pub(crate) fn figures(report: &ContourReport, unit: &str) -> Vec<Figure> {
    let main = &report.main;
    // For contours given by vertices, lengths of sides are more informative than coordinates.
    let vertices = main.parameters.first().is_some_and(|(name, _)| name == "x0");
    let sizes = if vertices && !main.sides.is_empty() { &main.sides } else { &main.parameters };
    let mut figures: Vec<Figure> = (sizes.iter().take(4))
        .map(|(name, value)| {
            Figure::new(words(name), with_sigma(value.value, value.sigma), unit_of(name, unit))
        })
        .collect();
    figures.push(Figure::new("reduced χ²", significant(main.reduced_chi_square, 3), "1 if σ is correct"));
    figures
}

fn unit_of<'a>(name: &str, unit: &'a str) -> &'a str {
    // Names of parameters are keys of the JSON, so they can be relied on.
    let is_angle = ["angle", "heading", "direction", "rotation"].iter().any(|word| name.contains(word));
    if is_angle { "°" } else { unit }
}

/// A parameter's name in words.
fn words(name: &str) -> String {
    name.trim_end_matches("_deg").replace('_', " ")
}

/// A value with its σ. The number of digits follows from σ.
pub(crate) fn with_sigma(value: f64, sigma: f64) -> String {
    if !(sigma > 0.0 && sigma.is_finite()) {
        return significant(value, 6);
    }
    // Two digits of σ: one would round 0.014 to 0.01, which is 30 % less.
    let decimals = (1 - sigma.log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.decimals$}");
    // What rounds to zero has no sign.
    let text = match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| c == '0' || c == '.') => digits,
        _ => &text,
    };
    format!("{text} ± {sigma:.decimals$}")
}

pub(crate) fn part_blocks(part: &PartReport, unit: &str) -> Vec<Block> {
    let mut table = Table::new(["parameter", "value", "σ"]);
    for (name, value) in part.parameters.iter().chain(&part.sides) {
        // Parameters of one contour mix lengths and angles.
        let unit = unit_of(name, unit);
        let name = head(name, unit);
        let decimals = with_sigma(value.value, value.sigma);
        // Both columns with the same decimals.
        let (value_text, sigma_text) = decimals.split_once(" ± ").unwrap_or((&decimals, "–"));
        table.row([name, value_text.to_owned(), sigma_text.to_owned()], false);
    }
    let mut text = format!(
        "{}, {} rejected; reduced χ² {}.",
        counted(part.readings, "reading"),
        count(part.rejected),
        significant(part.reduced_chi_square, 3)
    );
    if let (Some(margin), Some(next)) = (part.bic_margin, part.alternatives.first()) {
        text += &format!(" Next best: {} (BIC larger by {}).", next.kind, significant(margin, 3));
    }
    if let Some(hole) = part.hole_of {
        text += &format!(" It is a hole of contour {}.", hole + 1);
    }
    vec![Block::Table(table), Block::Text(text)]
}

fn constrained_sections(found: &ConstrainedReport, unit: &str) -> Vec<Section> {
    let mut sections = Vec::new();
    if !found.constraints.is_empty() {
        let mut table = Table::new(["constraint", "source"]);
        for constraint in &found.constraints {
            table.row([constraint.text.clone(), constraint.from.to_owned()], false);
        }
        sections.push(Section::new(
            "Constraints",
            vec![
                Block::Table(table),
                Block::Text(format!(
                    "All constraints: χ² {} with {} degrees of freedom, p = {}.",
                    significant(found.chi_square, 3),
                    found.degrees,
                    significant(found.p_value, 2)
                )),
            ],
        ));
    }
    if !found.dimensions.is_empty() {
        let mut table = Table::new(["dimension", &head("σ", unit)]);
        for dimension in &found.dimensions {
            table.row([dimension.text.clone(), significant(dimension.sigma, 2)], false);
        }
        sections.push(Section::new("Dimensions", vec![Block::Table(table)]));
    }
    let freedoms = &found.freedoms;
    sections.push(Section::new(
        "Degrees of freedom",
        vec![Block::Text(format!(
            "{} parameters, {} equations of rank {}: {} are free.",
            freedoms.parameters, freedoms.equations, freedoms.rank, freedoms.free
        ))],
    ));
    sections
}

#[cfg(test)]
mod tests {
    use super::with_sigma;

    #[test]
    fn digits_of_values_follow_from_sigma() {
        assert_eq!(with_sigma(12.3456, 0.0123), "12.346 ± 0.012");
        assert_eq!(with_sigma(-0.000_001, 0.02), "0.000 ± 0.020");
        assert_eq!(with_sigma(-0.5, 0.02), "-0.500 ± 0.020");
        assert_eq!(with_sigma(2.0, 0.0), "2.00000");
    }
}
