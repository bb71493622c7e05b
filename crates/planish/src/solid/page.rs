//! The report of the solids that a drawing describes.

use crate::report::title_of;
use crate::report::words::head;
use crate::solid::{DimensionKind, FaceCounts, ReportedEdit, SolidReport, UnexplainedLine};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_mesh::BoundingBox;
use planish_report::numbers::{counted, significant};
use planish_report::{Block, Figure, LineSet, Mark, Page, Scene, Section, SurfaceShown, Table, plot};
use planish_solid::brep::Solid;
use planish_solid::tessellation::tessellate;
use planish_solid::views::{Drawing, LineStyle, View};
use std::f64::consts::TAU;
use std::path::PathBuf;

/// Maximum number of solids that are shown side by side.
const MAX_SOLIDS: usize = 6;
/// Distance from one solid to the next, relative to the width of the first.
const SPACING_RATIO: f64 = 1.35;
/// Height of the labels above the solutions, relative to the diagonal of their box.
const LABEL_HEIGHT_RATIO: f64 = 0.06;
/// Maximum number of unexplained lines that are listed.
const MAX_LINES: usize = 20;
/// Radius of the rings around edits, relative to the size of the drawing.
const RING_RATIO: f64 = 0.02;
/// Minimum angle between faces, in degrees, for an edge to be drawn. Facets of round faces meet at smaller
/// angles, edges of usual parts at larger ones.
const SMOOTH_DEG: f64 = 20.0;

/// The page of solids, best first.
pub(crate) fn solid_page(
    report: &SolidReport,
    drawing: &Drawing,
    solids: &[&Solid],
    tolerance: f64,
    views: &[PathBuf],
) -> Result<Page> {
    let unit = report.unit.name();
    let mut scene = Scene { unit: unit.to_owned(), ..Scene::default() };
    let mut across = 0.0;
    for (k, solid) in solids.iter().take(MAX_SOLIDS).enumerate() {
        // STEP output needs no mesh, so a solid that cannot be meshed is only missing in the view.
        let Ok(mut mesh) = tessellate(solid, tolerance) else {
            continue;
        };
        if let Some(bounds) = BoundingBox::from_points(&mesh.positions)
            && across == 0.0
        {
            // All solids of a drawing have the same extents, so the width of the first serves for all.
            across = SPACING_RATIO * (bounds.max[0] - bounds.min[0]);
        }
        for p in &mut mesh.positions {
            p[0] += across * k as f64;
        }
        let name = format!("solution {}", k + 1);
        if let Some(bounds) = BoundingBox::from_points(&mesh.positions).filter(|_| solids.len() > 1) {
            let DVec3 { x, y, .. } = bounds.center();
            let text = (report.solutions.get(k)).map_or(String::new(), |s| {
                format!("volume {} {unit}³, {}", significant(s.volume, 5), faces(&s.faces))
            });
            scene.marks.push(Mark {
                at: DVec3::new(x, y, bounds.max[2] + LABEL_HEIGHT_RATIO * bounds.diagonal()),
                label: (k + 1).to_string(),
                text,
                normal: DVec3::Z,
            });
        }
        scene.lines.push(LineSet {
            name: format!("edges of {name}"),
            segments: mesh_edges(&mesh.positions, &mesh.triangles),
            ..LineSet::default()
        });
        scene.surfaces.push(SurfaceShown {
            name,
            positions: mesh.positions,
            triangles: mesh.triangles,
            // Averaged normals would round off the edges.
            flat: true,
            ..SurfaceShown::default()
        });
    }
    "solution".clone_into(&mut scene.marks_name);
    let drawings = (drawing.views.iter())
        .map(|view| Block::Drawing {
            svg: plot::lines(
                &(view.curves.iter())
                    .map(|curve| (curve.curve.points(), curve.style == LineStyle::Hidden))
                    .chain(edit_marks(report, view, drawing.size()))
                    .collect::<Vec<_>>(),
            ),
            caption: format!(
                "The {} view as read from the file; dashed lines are hidden.{}",
                view.kind.name(),
                if edits_in(report, view).count() > 0 { " Rings are edits." } else { "" }
            ),
        })
        .collect();
    let headline = match report.solutions.len() {
        0 => "No solid has these views.".to_owned(),
        1 if !report.edits.is_empty() => "One solid has these views after edits of the drawing.".to_owned(),
        1 => "One solid has these views.".to_owned(),
        n => format!("{n} solids have these views; they are shown side by side, the best on the left."),
    };
    let figures = (report.solutions.first()).map_or_else(Vec::new, |best| {
        vec![
            Figure::new("volume", format!("{} {unit}³", significant(best.volume, 5)), ""),
            Figure::new("area", format!("{} {unit}²", significant(best.area, 5)), ""),
            Figure::new("faces", faces(&best.faces), ""),
        ]
    });
    Ok(Page {
        job: "solid".to_owned(),
        title: title_of(views),
        headline,
        findings: report.findings.clone(),
        figures,
        // Without a solid, the page shows only the views and the unexplained lines.
        scene: (!scene.surfaces.is_empty()).then_some(scene),
        drawings: Vec::new(),
        sections: sections(report, drawings, unit),
    })
}

fn edits_in<'a>(report: &'a SolidReport, view: &'a View) -> impl Iterator<Item = &'a ReportedEdit> {
    report.edits.iter().filter(|edit| edit.line.view == view.kind.name())
}

/// A ring around the first place of each edit of a view, and the lines that are added or moved.
fn edit_marks<'a>(
    report: &'a SolidReport,
    view: &'a View,
    size: f64,
) -> impl Iterator<Item = (Vec<[f64; 2]>, bool)> + 'a {
    edits_in(report, view).flat_map(move |edit| {
        let ring = edit.places.first().map(|at| {
            let angles = (0..=24).map(|k| f64::from(k) * TAU / 24.0);
            angles.map(|a| [0, 1].map(|c| at[c] + RING_RATIO * size * [a.cos(), a.sin()][c])).collect()
        });
        let new = if edit.edit == "add" { &edit.places } else { &edit.moved_to };
        let line = (new.len() > 1).then(|| new.clone());
        ring.into_iter().chain(line).map(|points| (points, false)).collect::<Vec<_>>()
    })
}

/// Edges of a mesh at which its facets bend.
fn mesh_edges(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<[DVec3; 2]> {
    use std::collections::BTreeMap;
    // A sorted map, so that the page has the same bytes in every run.
    let mut sides: BTreeMap<[u32; 2], Vec<DVec3>> = BTreeMap::new();
    for t in triangles {
        let [a, b, c] = t.map(|k| positions[k as usize]);
        let Some(normal) = (b - a).cross(c - a).try_normalize() else {
            continue;
        };
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            sides.entry([a.min(b), a.max(b)]).or_default().push(normal);
        }
    }
    // An edge with one triangle or with three is a defect of the mesh and is always drawn.
    let smooth = SMOOTH_DEG.to_radians().cos();
    (sides.into_iter())
        // Edges of chords on a round face are not edges of the solid.
        .filter(|(_, normals)| normals.len() != 2 || normals[0].dot(normals[1]) < smooth)
        .map(|(ends, _)| ends.map(|k| positions[k as usize]))
        .collect()
}

fn faces(counts: &FaceCounts) -> String {
    let all = [
        (counts.plane, "plane", "planes"),
        (counts.cylinder, "cylinder", "cylinders"),
        (counts.cone, "cone", "cones"),
        (counts.sphere, "sphere", "spheres"),
        (counts.torus, "torus", "tori"),
        (counts.freeform, "free form", "free forms"),
    ];
    let some: Vec<String> = (all.iter().filter(|(n, ..)| *n > 0))
        .map(|(n, one, many)| format!("{n} {}", if *n == 1 { one } else { many }))
        .collect();
    some.join(", ")
}

fn edits_table(edits: &[ReportedEdit]) -> Table {
    let mut table = Table::new(["view", "entity", "edit"]);
    for edit in edits {
        let entity = edit.line.entity.clone().unwrap_or_else(|| "a missing line".to_owned());
        table.row([edit.line.view.to_owned(), entity, edit.line.reason.clone()], false);
    }
    table
}

fn lines_table(lines: &[UnexplainedLine]) -> Table {
    let mut table = Table::new(["view", "entity", "reason"]);
    for line in lines.iter().take(MAX_LINES) {
        let entity = line.entity.clone().unwrap_or_else(|| "a missing line".to_owned());
        table.row([line.view.to_owned(), entity, line.reason.clone()], false);
    }
    table
}

fn sections(report: &SolidReport, drawings: Vec<Block>, unit: &str) -> Vec<Section> {
    // Sections without content are omitted: exact drawings have no sizes with σ.
    let mut sections = Vec::new();
    if !report.edits.is_empty() {
        sections.push(Section::new("Edits of the drawing", vec![Block::Table(edits_table(&report.edits))]));
    }
    if !report.solutions.is_empty() {
        let volume = head("volume", &format!("{unit}³"));
        let area = head("area", &format!("{unit}²"));
        let mut table = Table::new(["solution", &volume, &area, "faces", "cost"]);
        for s in &report.solutions {
            table.row(
                [
                    s.rank.to_string(),
                    significant(s.volume, 6),
                    significant(s.area, 6),
                    faces(&s.faces),
                    significant(s.cost, 4),
                ],
                false,
            );
        }
        sections.push(Section::new("Solutions", vec![Block::Table(table)]));
    }
    if let Some(geometry) = &report.geometry {
        let sigma = head("σ", unit);
        let value = head("value", unit);
        let mut table = Table::new(["dimension", &value, &sigma]);
        for dimension in &geometry.dimensions {
            let name = match dimension.kind {
                DimensionKind::Extent => format!("extent along {}", dimension.name),
                DimensionKind::Length => format!("length {}", dimension.name),
                DimensionKind::Diameter => format!("diameter {}", dimension.name),
            };
            table.row(
                [
                    name,
                    significant(dimension.value, 6),
                    dimension.sigma.map_or("unknown".to_owned(), |s| significant(s, 2)),
                ],
                // Dimensions without σ follow from no estimate and are marked.
                dimension.sigma.is_none(),
            );
        }
        sections.push(Section::new("Dimensions", vec![Block::Table(table)]));
        for view in &geometry.views {
            if !view.constraints.is_empty() {
                sections.push(Section::new(
                    format!("Constraints of the {} view", view.view),
                    vec![Block::Lines(view.constraints.join("\n"))],
                ));
            }
        }
    }
    sections.push(Section::new("Views", drawings));
    if !report.unexplained.is_empty() {
        sections
            .push(Section::new("Unexplained lines", vec![Block::Table(lines_table(&report.unexplained))]));
    }
    // The first few are enough to show what is wrong.
    for refused in report.refused.iter().take(3) {
        sections.push(Section::new(
            format!("Rejected solid, volume {} {unit}³", significant(refused.volume, 5)),
            vec![
                Block::Text(format!(
                    "Differences from the drawing: {}.",
                    counted(refused.differences.len(), "line")
                )),
                Block::Table(lines_table(&refused.differences)),
            ],
        ));
    }
    sections
}
