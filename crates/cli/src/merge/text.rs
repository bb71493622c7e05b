//! The summary of `planish merge`.

use super::args::MergeArgs;
use crate::lines::{Align, Lines};
use crate::numbers::{count, counted, significant};
use planish::merge::{FillReport, MergeReport, SplineReport};

/// Number of overlaps that are listed; the JSON object has all.
const REGIONS_SHOWN: usize = 10;

/// The summary of a merge.
pub fn text(args: &MergeArgs, report: &MergeReport, spline: Option<&SplineReport>) -> String {
    let mut lines = Lines::default();
    let unit = report.unit;
    lines.line(format!(
        "Merged {} patches into {} triangles and {} vertices{}.",
        report.patches.len(),
        count(report.triangles),
        count(report.vertices),
        if report.watertight { ", watertight" } else { "" }
    ));
    lines.gap();
    facts(&mut lines, report);
    lines.gap();
    patches(&mut lines, report);
    // Parts from the bounding mesh are no measurements, so they are never counted without a line of their
    // own.
    if let Some(completed) = &report.completed {
        lines.gap();
        lines.line(format!(
            "{} vertices are from {}, where there is no patch (`observed` 2); {} triangles outside of it \
             were removed.",
            count(completed.vertices),
            completed.name,
            count(completed.carved)
        ));
    }
    if let Some(filled) = report.filled.as_ref().filter(|filled| filled.holes > 0 || args.fill.is_some()) {
        lines.gap();
        lines.line(filled_line(filled));
    }
    // Removed triangles are reported, because a user may miss a small part of the object.
    if report.removed_fragments > 0 {
        lines.gap();
        lines.line(format!(
            "{} of a few triangles {} removed.",
            counted(report.removed_fragments, "fragment"),
            if report.removed_fragments == 1 { "was" } else { "were" }
        ));
    }
    lines.poses(&report.poses, unit);
    lines.gap();
    regions(&mut lines, report);
    lines.gap();
    if let Some(spline) = spline {
        lines.line(format!(
            "Spline: a {} with {} control vertices ({} levels), {} {unit} rms from the vertices of the mesh; \
             median σ {} {unit}",
            spline.topology,
            count(spline.coefficients),
            spline.levels,
            significant(spline.rms, 3),
            significant(spline.sigma.median, 3)
        ));
        lines.gap();
    }
    if args.output.is_empty() {
        lines.line("Nothing was written: add -o FILE.");
    }
    for path in &args.output {
        lines.line(format!("Wrote {}", path.display()));
    }
    lines.into_text()
}

/// σ, topology, seams and quality of the triangles.
fn facts(lines: &mut Lines, report: &MergeReport) {
    let unit = report.unit;
    let sigma = &report.sigma;
    // Entry k counts the seam vertices with k edges; a vertex of a regular mesh has six.
    let above_six = report.valence.iter().skip(7).sum::<usize>();
    lines.facts([
        (
            "σ",
            format!(
                "median {} {unit}, 95 % below {} {unit}, largest {} {unit}{}",
                significant(sigma.median, 3),
                significant(sigma.p95, 3),
                significant(sigma.max, 3),
                if report.sigma_estimated { " (estimated from the differences between patches)" } else { "" }
            ),
        ),
        (
            "topology",
            format!(
                "{} {}, {} boundary edges, {} edges with more than two triangles",
                report.parts,
                if report.parts == 1 { "part" } else { "parts" },
                count(report.boundary_edges),
                report.nonmanifold_edges
            ),
        ),
        (
            "seams",
            format!(
                "{} triangles, {} holes closed; {} of {} seam vertices have more than six edges",
                count(report.stitched_triangles),
                count(report.holes_closed),
                count(above_six),
                count(report.valence.iter().sum())
            ),
        ),
        (
            "triangles",
            report.quality.as_ref().map_or_else(String::new, |q| {
                format!(
                    "smallest angle: median {:.1}°, 99 % above {:.1}°; longest edge / height: median {:.2}, \
                     99 % below {}",
                    q.smallest_angle_median_deg,
                    // The worst triangle alone would say little about a mesh of thousands, so a quantile is
                    // shown.
                    q.smallest_angle_p1_deg,
                    q.aspect_median,
                    significant(q.aspect_p99, 3)
                )
            }),
        ),
    ]);
}

/// A table of the patches.
fn patches(lines: &mut Lines, report: &MergeReport) {
    let rows: Vec<Vec<String>> = report
        .patches
        .iter()
        .enumerate()
        .map(|(k, p)| {
            vec![
                // Patches are counted from 0, as in the table of overlaps and in the JSON object.
                k.to_string(),
                p.name.clone(),
                count(p.triangles),
                count(p.vertices_kept),
                significant(p.sigma, 3),
                p.sigma_factor.map_or_else(String::new, |factor| significant(factor, 2)),
            ]
        })
        .collect();
    lines.table(
        &[
            ("patch", Align::Right),
            ("from", Align::Left),
            ("triangles", Align::Right),
            ("vertices kept", Align::Right),
            ("σ used", Align::Right),
            ("differences / σ stated", Align::Right),
        ],
        &rows,
    );
}

/// A table of the largest overlaps.
fn regions(lines: &mut Lines, report: &MergeReport) {
    let rows: Vec<Vec<String>> = report
        .regions
        .iter()
        .take(REGIONS_SHOWN)
        .map(|r| {
            vec![
                format!("{} and {}", r.patches[0], r.patches[1]),
                count(r.points),
                significant(r.rms, 3),
                significant(r.epsilon, 3),
            ]
        })
        .collect();
    lines.table(
        &[
            ("overlap of", Align::Left),
            ("points", Align::Right),
            ("rms difference", Align::Right),
            ("below ε", Align::Right),
        ],
        &rows,
    );
    if report.regions.len() > REGIONS_SHOWN {
        lines.line(format!(
            "and {} smaller ones (--json lists all)",
            count(report.regions.len() - REGIONS_SHOWN)
        ));
    }
}

/// A line about the holes that were filled or left open.
fn filled_line(filled: &FillReport) -> String {
    let mut words = format!(
        "{} filled with {} vertices (`observed` 2, σ is a rough estimate)",
        counted(filled.holes, "hole"),
        count(filled.vertices)
    );
    // A hole that stays open is a reason to raise `--fill`, so the line names the option.
    if filled.unfilled > 0 {
        words += &format!("; {} left open: larger than --fill allows", counted(filled.unfilled, "hole"));
    }
    // The outer rim of a sheet is no hole; filling it would close the sheet.
    if filled.outer_rims > 0 {
        words += &format!("; {} left open", counted(filled.outer_rims, "outer rim"));
    }
    words + "."
}
