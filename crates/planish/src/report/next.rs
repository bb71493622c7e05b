//! The report of a plan where to measure next.

use super::fit::next_table;
use super::model::{SmallUnit, model_scene, next_marks};
use crate::model::SurfaceModel;
use crate::next::NextReport;
use planish_estimate::Result;
use planish_report::numbers::{counted, percent, significant};
use planish_report::{Block, Figure, Finding, Level, Page, Section};
use std::path::Path;

/// The page of points to measure.
pub(crate) fn next_page(model: &SurfaceModel, next: &NextReport, name: &Path) -> Result<Page> {
    let model_unit = model.unit.name();
    let unit = SmallUnit::of(model_unit, next.worst_sigma.before);
    let (mut scene, _) = model_scene(model, &model.posterior()?, None, None)?;
    scene.marks = next_marks(&next.points, unit);
    "where to measure next".clone_into(&mut scene.marks_name);
    let mut findings = Vec::new();
    match next.reached_goal {
        Some(true) => findings.push(Finding::new(Level::Good, "These points reach the goal.")),
        Some(false) => findings.push(Finding::new(
            Level::Look,
            "These points do not reach the goal: plan more of them, or measure with a smaller σ.",
        )),
        None => {}
    }
    if let Some(left) = &next.shape_left {
        findings.push(Finding::new(
            Level::Look,
            format!(
                "On {} of the region's area σ holds shape that cells are too large to follow, up to {}: no reading makes it smaller, finer cells do.",
                percent(left.area_fraction),
                unit.text(left.largest)
            ),
        ));
    }
    let mut blocks = vec![
        Block::Text(format!(
            "Each of these readings has σ {} along the normal. σ now is what is known once all points before are measured.",
            unit.text(next.sigma)
        )),
        Block::Table(next_table(next, model_unit, unit)),
    ];
    if let Some(median) = next.random.as_ref().and_then(|random| random.worst_sigma_median.last()) {
        blocks.push(Block::Text(format!(
            "As many points drawn at random bring the largest σ to {} (median).",
            unit.text(*median)
        )));
    }
    let change = |c: crate::next::Change| format!("from {}", unit.text(c.before));
    Ok(Page {
        job: "next".to_owned(),
        title: super::file_name(name),
        headline: format!(
            "Where {} make the surface known better: largest σ {} to {}.",
            counted(next.points.len(), "reading"),
            unit.text(next.worst_sigma.before),
            unit.text(next.worst_sigma.after)
        ),
        findings,
        figures: vec![
            Figure::new(
                "largest σ then",
                unit.text(next.worst_sigma.after),
                change(next.worst_sigma),
            ),
            Figure::new("mean σ then", unit.text(next.mean_sigma.after), change(next.mean_sigma)),
            Figure::new(
                "gain",
                format!("{} ×", significant(next.worst_sigma.before / next.worst_sigma.after, 3)),
                "of the largest σ",
            ),
        ],
        scene: Some(scene),
        drawings: Vec::new(),
        sections: vec![Section::new("Points to measure, in this order", blocks)],
    })
}
