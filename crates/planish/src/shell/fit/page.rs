//! The report of a fitted shell.

use super::inspection::{ACCEPTED_FACTORS, MIN_OVERLAP};
use crate::report::scenes::{numbers, observed_field};
use crate::report::words::SmallUnit;
use crate::shell::fit::{ReadingsReport, ShellFitReport};
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use planish_report::numbers::{count, counted, percent, significant};
use planish_report::{Block, Cloud, FieldKind, Figure, Page, Scene, Section, SurfaceShown, Table};
use std::path::PathBuf;

/// Maximum number of points that are drawn.
const MAX_POINTS: usize = 20_000;

/// A fitted shell, prepared for display.
pub(crate) struct ShownShell<'a> {
    /// The mesh that was found.
    pub found: &'a TriangleMesh,
    /// The mesh that was given, with the same vertices.
    pub given: &'a TriangleMesh,
    /// σ of vertices along normals.
    pub sigma: &'a [f64],
    /// Whether readings determine the vertices more than the prior.
    pub observed: &'a [u8],
    /// Points that were read; of a sequence those of the last frame.
    pub points: Vec<DVec3>,
}

/// The page of a fitted shell.
pub(crate) fn shell_page(report: &ShellFitReport, shown: &ShownShell<'_>, named: &[PathBuf]) -> Page {
    // One unit for the whole page, chosen by σ: it is the smallest length that has to be readable.
    let unit = SmallUnit::for_length(report.unit.name(), report.sigma.median);
    let mut figures = vec![Figure::new(
        "σ, median",
        unit.text(report.sigma.median),
        format!("95 % below {}", unit.text(report.sigma.p95)),
    )];
    if let Some(rms) = report.rms_points {
        figures.push(Figure::new("points, rms", unit.text(rms), "distance from the mesh"));
    }
    if let Some(rms) = report.rms_silhouettes_px {
        figures.push(Figure::new(
            "outlines, rms",
            format!("{} px", significant(rms, 3)),
            "distance from the outlines",
        ));
    }
    // Figures of sources that were not used would read as zero errors, so they are omitted.
    if !report.iou.is_empty() {
        figures.push(Figure::new(
            "overlap with masks",
            percent(mean(report.iou.values())),
            "mean of intersection over union",
        ));
    }
    figures.push(Figure::new("measured", percent(report.observed_fraction), "of the vertices"));
    let mut sections = vec![input_section(report, unit)];
    sections.extend(overlaps(report));
    sections.extend(poses(report, unit));
    sections.extend(frames(report, unit));
    Page {
        job: "shell fit".to_owned(),
        title: crate::report::title_of(named),
        headline: format!(
            "A mesh of {}, deformed by {}.",
            counted(shown.found.triangles.len(), "triangle"),
            counted(report.controls, "control")
        ),
        findings: report.findings.clone(),
        figures,
        scene: Some(scene(report, shown)),
        drawings: Vec::new(),
        sections,
    }
}

fn mean<'a>(values: impl ExactSizeIterator<Item = &'a f64>) -> f64 {
    // No views would give 0/0.
    let n = values.len().max(1) as f64;
    values.sum::<f64>() / n
}

fn kinds(report: &ShellFitReport) -> [(&'static str, &Option<ReadingsReport>); 4] {
    // `input_section` selects the unit of a row by these names.
    [
        ("points", &report.points),
        ("outlines", &report.outlines),
        ("tracks", &report.tracks),
        ("landmarks", &report.landmarks),
    ]
}

fn scene(report: &ShellFitReport, shown: &ShownShell<'_>) -> Scene {
    let name = report.unit.name();
    let moved =
        (shown.found.positions.iter().zip(&shown.given.positions)).map(|(a, b)| a.distance(*b)).collect();
    // Every nth point, so that the selection is the same in every run.
    let step = shown.points.len().div_ceil(MAX_POINTS).max(1);
    let clouds = if shown.points.is_empty() {
        Vec::new()
    } else {
        vec![Cloud {
            // Hidden at first, because many thousand dots would cover the mesh.
            name: "input points".to_owned(),
            positions: shown.points.iter().copied().step_by(step).collect(),
            hidden: true,
            width: 3,
            ..Cloud::default()
        }]
    };
    Scene {
        unit: name.to_owned(),
        surfaces: vec![
            SurfaceShown {
                name: "fitted mesh".to_owned(),
                positions: shown.found.positions.clone(),
                triangles: shown.found.triangles.clone(),
                fields: vec![
                    numbers("sigma", "σ along the normal", name, FieldKind::Sequential, shown.sigma.to_vec()),
                    observed_field(shown.observed),
                    // Distances and not only normal components: a mesh that slides along itself should show.
                    numbers("moved", "displacement", name, FieldKind::Sequential, moved),
                ],
                ..SurfaceShown::default()
            },
            SurfaceShown {
                name: "input mesh".to_owned(),
                positions: shown.given.positions.clone(),
                triangles: shown.given.triangles.clone(),
                hidden: true,
                // Translucent, so that the fitted mesh inside it remains visible.
                translucent: true,
                ..SurfaceShown::default()
            },
        ],
        clouds,
        ..Scene::default()
    }
}

fn input_section(report: &ShellFitReport, unit: SmallUnit<'_>) -> Section {
    let mut table = Table::new(["readings", "count", "outliers", "rms", "σ estimated/stated"]);
    for (what, of) in kinds(report) {
        let Some(of) = of else { continue };
        table.row(
            [
                what.to_owned(),
                count(of.count),
                count(of.outliers),
                match what {
                    "points" | "landmarks" => unit.text(of.rms),
                    "outlines" => format!("{} px", significant(of.rms, 3)),
                    _ => format!("{} σ", significant(of.rms, 3)),
                },
                significant(of.sigma_factor, 3),
            ],
            // The same limits as those of the findings.
            of.sigma_factor > ACCEPTED_FACTORS[1] || 3 * of.outliers > of.count,
        );
    }
    Section::new(
        "Inputs",
        vec![
            Block::Table(table),
            Block::Text(format!(
                "Weight of smoothness: {}, chosen by marginal likelihood. A vertex counts as measured if \
                 points are near it on its side of the surface, or if outlines give more than half of its \
                 information.",
                significant(report.smoothness_weight, 3)
            )),
        ],
    )
}

/// Overlap of views with their masks.
fn overlaps(report: &ShellFitReport) -> Option<Section> {
    if report.iou.is_empty() {
        return None;
    }
    let mut table = Table::new(["view", "overlap", "overlap before", "used"]);
    for (view, share) in &report.iou {
        // Held-out views judge the fit, so a small overlap is marked for them as well.
        let held_out = report.held_out.contains(view);
        table.row(
            [
                view.clone(),
                percent(*share),
                report.iou_before.get(view).map_or("–".to_owned(), |b| percent(*b)),
                if held_out { "no (held out)" } else { "yes" }.to_owned(),
            ],
            *share < MIN_OVERLAP,
        );
    }
    Some(Section::new("Overlap with masks", vec![Block::Table(table)]))
}

/// Poses that were uncertain.
fn poses(report: &ShellFitReport, unit: SmallUnit<'_>) -> Option<Section> {
    if report.poses.is_empty() {
        return None;
    }
    let [moved, sigma] = ["moved", "largest σ"].map(|what| unit.head(what));
    let mut table = Table::new(["view", "rotated / °", &moved, "largest σ / °", &sigma]);
    // The worst axis: a camera is rarely uncertain along all three.
    let largest = |values: &[f64; 3]| values.iter().copied().fold(0.0, f64::max);
    for pose in &report.poses {
        table.row(
            [
                pose.view.clone(),
                significant(pose.turned_deg, 3),
                unit.number(pose.moved, 3),
                significant(largest(&pose.sigma_rotation_deg), 3),
                unit.number(largest(&pose.sigma_translation), 3),
            ],
            false,
        );
    }
    Some(Section::new("Estimated camera poses", vec![Block::Table(table)]))
}

/// Frames of a sequence.
fn frames(report: &ShellFitReport, unit: SmallUnit<'_>) -> Option<Section> {
    if report.frames.is_empty() {
        return None;
    }
    let [points, sigma] = ["points, rms", "median σ"].map(|what| unit.head(what));
    let mut table = Table::new(["frame", &points, "outlines, rms / px", "overlap", "deviation/σ", &sigma]);
    let cell = |value: Option<f64>, text: &dyn Fn(f64) -> String| value.map_or("–".to_owned(), text);
    for frame in &report.frames {
        table.row(
            [
                frame.frame.clone(),
                cell(frame.rms_points, &|v| unit.number(v, 3)),
                cell(frame.rms_silhouettes_px, &|v| significant(v, 3)),
                cell(frame.iou, &percent),
                cell(frame.prediction_error, &|v| significant(v, 3)),
                unit.number(frame.sigma, 3),
            ],
            // Above 3 σ, the object moved otherwise than predicted, or the frame belongs elsewhere.
            frame.prediction_error.is_some_and(|error| error > 3.0),
        );
    }
    Some(Section::new(
        "Frames",
        vec![
            Block::Text(
                "The sections above describe the last frame. Deviation/σ is the normalised rms difference \
                 between the estimated and the predicted parameters."
                    .to_owned(),
            ),
            Block::Table(table),
        ],
    ))
}
