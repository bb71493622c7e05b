//! The report of a simulated sphere: the curves, and the rows behind them.

use crate::simulate::{SphereOptions, SphereRow};
use planish_report::numbers::{count, counted, significant};
use planish_report::{Block, Figure, Page, Section, Table};

/// The page of a simulated sphere, with its figure.
pub(crate) fn sphere_page(options: &SphereOptions, rows: &[SphereRow], svg: String) -> Page {
    let mut table = Table::new([
        "readings",
        "noise / %",
        "orientations / °",
        "depth",
        "patches",
        "patch filter / %",
        "global filter / %",
        "bound / %",
    ]);
    for row in rows {
        table.row(
            [
                count(row.readings),
                significant(row.noise_percent, 2),
                row.orientation_deg.map_or("–".to_owned(), |t| significant(t, 2)),
                row.depth.to_string(),
                significant(row.leaf_patches, 3),
                significant(row.patch_percent, 3),
                significant(row.global_percent, 3),
                significant(row.bound_percent, 3),
            ],
            false,
        );
    }
    let finest = rows.iter().filter(|row| row.depth == options.depth);
    let ratios: Vec<f64> = finest.map(|row| row.patch_percent / row.global_percent).collect();
    // A ratio of each row and not of the means, because errors grow with the noise.
    let mean = ratios.iter().sum::<f64>() / ratios.len().max(1) as f64;
    Page {
        job: "simulate sphere".to_owned(),
        title: "Fits of a simulated sphere".to_owned(),
        headline: format!(
            "Mean errors in % of the radius, over {} for each point of a curve.",
            counted(options.sets, "set")
        ),
        figures: vec![
            Figure::new("rows", count(rows.len()), ""),
            Figure::new(
                "patch filter / global filter",
                significant(mean, 3),
                "mean ratio of errors at the maximum depth",
            ),
        ],
        drawings: vec![Block::Drawing {
            svg,
            caption: "Mean error against noise. Solid: patch filter; dashed: global filter; dotted: \
                expected from the global posterior."
                .to_owned(),
        }],
        sections: vec![Section::new("Results", vec![Block::Table(table)])],
        // No scene: a row is a mean over many fitted spheres.
        ..Page::default()
    }
}
