//! The report of a merge.

use crate::merge::{MergeReport, Merged};
use crate::report::scenes::{numbers, observed_field};
use crate::report::words::SmallUnit;
use crate::report::{ReportOutput, file_name, title_of};
use planish_estimate::Result;
use planish_report::numbers::{count, counted, percent, significant};
use planish_report::{Block, FieldKind, Figure, Page, Scene, Section, SurfaceShown, Table};
use std::path::Path;

/// Writes a page that shows a merged mesh.
///
/// # Errors
/// `Io` if the page cannot be written or an input cannot be read again.
pub(super) fn write_merge_report(merged: &Merged, output: &ReportOutput) -> Result<()> {
    let inputs: Vec<_> =
        (merged.report.inputs.iter()).map(|path| (path.clone(), "a patch".to_owned())).collect();
    output.write(merge_page(merged), &inputs)
}

/// A patch by the name of its file.
fn short(name: &str) -> String {
    // Folders would make the columns wide; the page lists full paths with its inputs.
    file_name(Path::new(name))
}

fn merge_page(merged: &Merged) -> Page {
    let report = &merged.report;
    // One unit for the page, chosen by σ, which is the smallest length on it.
    let unit = SmallUnit::for_length(report.unit.name(), report.sigma.median);
    // A vertex of a regular triangle mesh has six edges. `valence` counts the vertices of the seams only.
    let regular = report.valence.get(6).copied().unwrap_or(0) as f64
        / report.valence.iter().sum::<usize>().max(1) as f64;
    Page {
        job: "merge".to_owned(),
        title: title_of(&report.inputs),
        headline: format!(
            "Merged {} into a mesh of {}.",
            counted(report.patches.len(), "patch"),
            counted(report.triangles, "triangle")
        ),
        findings: report.findings.clone(),
        figures: vec![
            Figure::new(
                "σ, median",
                unit.text(report.sigma.median),
                format!("95 % below {}", unit.text(report.sigma.p95)),
            ),
            Figure::new(
                "boundary edges",
                count(report.boundary_edges),
                if report.watertight { "watertight" } else { "" },
            ),
            Figure::new(
                "vertices",
                count(report.vertices),
                format!("{} of seam vertices regular", percent(regular)),
            ),
        ],
        scene: Some(scene(merged)),
        drawings: Vec::new(),
        sections: [
            Some(Section::new("Inputs", vec![Block::Table(patches(report, unit))])),
            (!report.poses.is_empty()).then(|| Section::new("Alignment", alignment(report))),
            Some(Section::new("Overlaps", vec![Block::Table(regions(report, unit))])),
            Some(Section::new("Merged mesh", vec![Block::Text(mesh_text(report, regular))])),
        ]
        .into_iter()
        .flatten()
        .collect(),
    }
}

/// Size and σ of each patch.
fn patches(report: &MergeReport, unit: SmallUnit<'_>) -> Table {
    let sigma = unit.head("σ");
    let mut patches = Table::new(["patch", "triangles", "vertices kept", &sigma, "reversed"]);
    for patch in &report.patches {
        patches.row(
            [
                short(&patch.name),
                count(patch.triangles),
                count(patch.vertices_kept),
                unit.number(patch.sigma, 3),
                if patch.reversed { "yes" } else { "no" }.to_owned(),
            ],
            patch.reversed,
        );
    }
    patches
}

/// Points and differences of each overlap.
fn regions(report: &MergeReport, unit: SmallUnit<'_>) -> Table {
    let rms = unit.head("rms");
    let mut regions = Table::new(["patches", "points", &rms]);
    for region in &report.regions {
        // Numbers of patches mean nothing to a reader of the page.
        let [a, b] = region.patches.map(|k| short(&report.patches[k].name));
        regions.row([format!("{a} – {b}"), count(region.points), unit.number(region.rms, 3)], false);
    }
    regions
}

/// The merged mesh in words; `regular` is the share of the seam vertices with six edges.
fn mesh_text(report: &MergeReport, regular: f64) -> String {
    let mut mesh_text = format!(
        "{}, {}. The seams consist of {}; {} of their vertices are regular (six edges). {} closed.",
        counted(report.triangles, "triangle"),
        counted(report.parts, "part"),
        counted(report.stitched_triangles, "triangle"),
        percent(regular),
        counted(report.holes_closed, "hole"),
    );
    if let Some(completed) = &report.completed {
        mesh_text += &format!(
            " {} are from {}, where there is no patch; {} outside of it were removed.",
            counted(completed.vertices, "vertex"),
            short(&completed.name),
            counted(completed.carved, "triangle")
        );
    }
    if let Some(filled) = &report.filled {
        mesh_text += &format!(
            " {} {} filled smoothly with {}, whose σ is a rough estimate.",
            counted(filled.holes, "hole"),
            if filled.holes == 1 { "was" } else { "were" },
            counted(filled.vertices, "vertex")
        );
    }
    if let Some(quality) = &report.quality {
        mesh_text += &format!(
            " Smallest angle of a triangle: median {}°, 99 % above {}°.",
            significant(quality.smallest_angle_median_deg, 3),
            significant(quality.smallest_angle_p1_deg, 3)
        );
    }
    mesh_text
}

/// The merged surface with its σ.
fn scene(merged: &Merged) -> Scene {
    let report = &merged.report;
    Scene {
        unit: report.unit.name().to_owned(),
        surfaces: vec![SurfaceShown {
            name: "merged surface".to_owned(),
            positions: merged.mesh.positions.clone(),
            triangles: merged.mesh.triangles.clone(),
            fields: vec![
                numbers(
                    "sigma",
                    "σ along the normal",
                    report.unit.name(),
                    FieldKind::Sequential,
                    merged.sigma.clone(),
                ),
                observed_field(&merged.observed),
            ],
            ..SurfaceShown::default()
        }],
        ..Scene::default()
    }
}

/// The motion of every patch, with its σ.
fn alignment(report: &MergeReport) -> Vec<Block> {
    // The unit follows from σ and not from the motion: σ is what must be readable.
    let sigmas = report.poses.iter().filter_map(|p| p.sigma_translation);
    let unit = SmallUnit::for_length(report.unit.name(), sigmas.fold(0.0, f64::max));
    let mut table = Table::new([
        "patch",
        &unit.head("moved"),
        "rotated / °",
        &unit.head("σ of translation"),
        "σ of rotation / °",
        "undetermined",
    ]);
    for (k, pose) in report.poses.iter().enumerate() {
        let number = |value: Option<f64>| value.map_or_else(String::new, |x| significant(x, 3));
        let length = |value: Option<f64>| value.map_or_else(String::new, |x| unit.number(x, 3));
        table.row(
            [
                short(&pose.scan),
                // The first patch defines the frame.
                if k == 0 { "fixed".to_owned() } else { length(pose.moved) },
                number(pose.turned_deg),
                length(pose.sigma_translation),
                number(pose.sigma_rotation_deg),
                match (k, pose.covariance) {
                    (0, _) => String::new(),
                    (_, None) => "not aligned".to_owned(),
                    // A motion has three translations and three rotations.
                    _ => format!("{} of 6", pose.undetermined.len()),
                },
            ],
            // Marked if the position along some direction is only that of the file.
            k > 0 && (pose.covariance.is_none() || !pose.undetermined.is_empty()),
        );
    }
    vec![
        Block::Text(
            "Each patch was registered to the others; the first patch is fixed. σ of translation and of \
             rotation are root mean squares over three axes. A patch is not moved along directions that \
             the overlaps do not determine."
                .to_owned(),
        ),
        Block::Table(table),
    ]
}
