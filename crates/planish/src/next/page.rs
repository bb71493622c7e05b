//! Reports of planned measurements: points and sensor poses.

use crate::next::{Change, NextPoint, NextReport, ViewsReport};
use crate::report::scenes::model_scene;
use crate::report::words::{SmallUnit, head};
use planish_core::{DVec3, Finding};
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh};
use planish_report::numbers::{count, counted, percent, significant};
use planish_report::{Block, Figure, LineSet, Mark, Page, Scene, Section, Table};
use planish_sense::{Pose, ViewSensor};
use planish_surface::model::SurfaceModel;
use std::path::Path;

/// Length of a drawn line of sight, relative to the diagonal of the model's box.
const SIGHT_LENGTH: f64 = 0.3;

/// A σ before and after the measurements.
fn change(what: &str, sigma: Change, unit: SmallUnit<'_>) -> Figure {
    Figure::new(what, unit.text(sigma.after), format!("from {}", unit.text(sigma.before)))
}

/// The page of points to measure.
pub(crate) fn next_page(
    model: &SurfaceModel,
    next: &NextReport,
    findings: Vec<Finding>,
    name: &Path,
) -> Result<Page> {
    let model_unit = model.unit.name();
    // The largest σ before the plan sets the unit, so that both states are shown in the same one.
    let unit = SmallUnit::for_length(model_unit, next.worst_sigma.before);
    // A saved model has no readings to show.
    let (mut scene, _) = model_scene(model, &model.posterior()?, None, None)?;
    scene.marks = next_marks(&next.points, unit);
    "next measurements".clone_into(&mut scene.marks_name);
    let mut blocks = vec![
        Block::Text(format!(
            "Each reading has σ {} along the normal. σ before and after it assume that all points \
             above are measured.",
            unit.text(next.sigma)
        )),
        Block::Table(next_table(next, model_unit, unit)),
    ];
    // The last entry has as many points as the plan.
    if let Some(median) = next.random.as_ref().and_then(|random| random.worst_sigma_median.last()) {
        blocks.push(Block::Text(format!(
            "With as many random points, the median of the largest σ is {}.",
            unit.text(*median)
        )));
    }
    Ok(Page {
        job: "next".to_owned(),
        title: crate::report::file_name(name),
        headline: format!(
            "Plan of {}: the largest σ falls from {} to {}.",
            counted(next.points.len(), "reading"),
            unit.text(next.worst_sigma.before),
            unit.text(next.worst_sigma.after)
        ),
        findings,
        figures: vec![
            change("largest σ after", next.worst_sigma, unit),
            change("rms σ after", next.mean_sigma, unit),
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

/// The page of planned sensor poses.
pub(crate) fn views_page(
    model: &SurfaceModel,
    next: &ViewsReport,
    sensor: &ViewSensor,
    findings: Vec<Finding>,
    name: &Path,
) -> Result<Page> {
    // As on the page of points: the largest σ before the plan sets the unit.
    let unit = SmallUnit::for_length(model.unit.name(), next.worst_sigma.before);
    let (mut scene, _) = model_scene(model, &model.posterior()?, None, None)?;
    show_views(&mut scene, next, sensor, unit)?;
    let place = head("x, y, z", model.unit.name());
    let [worst, mean] = ["largest σ after", "rms σ after"].map(|what| unit.head(what));
    let mut table = Table::new(["view", &place, "readings", "visible", "visible so far", &worst, &mean]);
    let mut turns = Vec::new();
    for (k, view) in next.views.iter().enumerate() {
        let turn = view.quaternion_xyzw.map(|c| format!("{c:9.6}")).join(" ");
        // Quaternions are too wide for the table and are meant to be copied.
        turns.push(format!("view {}: {turn}", k + 1));
        table.row(
            [
                (k + 1).to_string(),
                view.translation.to_array().map(|c| significant(c, 4)).join(", "),
                count(view.readings),
                percent(view.seen),
                percent(view.seen_so_far),
                unit.number(view.worst_sigma_after, 3),
                unit.number(view.mean_sigma_after, 3),
            ],
            false,
        );
    }
    Ok(Page {
        job: "next".to_owned(),
        title: crate::report::file_name(name),
        headline: format!(
            "Plan of {}: the largest σ falls from {} to {}.",
            counted(next.views.len(), "view"),
            unit.text(next.worst_sigma.before),
            unit.text(next.worst_sigma.after)
        ),
        findings,
        figures: vec![
            change("largest σ after", next.worst_sigma, unit),
            change("rms σ after", next.mean_sigma, unit),
            Figure::new(
                "visible",
                percent(next.views.last().map_or(0.0, |view| view.seen_so_far)),
                "of the area, from all views",
            ),
        ],
        scene: Some(scene),
        drawings: Vec::new(),
        sections: vec![Section::new(
            "Views to take, in this order",
            vec![
                Block::Text(
                    "x, y, z is the position of the sensor, which looks along its z axis, with x right and \
                     y down. In the 3D view, a number marks the point where its axis meets the surface, \
                     and a line points towards it. Select “fields of view” to see its position and \
                     field of view."
                        .to_owned(),
                ),
                Block::Table(table),
                Block::Text("Orientations, world from sensor, as quaternions x, y, z, w:".to_owned()),
                Block::Lines(turns.join("\n")),
            ],
        )],
    })
}

/// Marks where the sensor's axis meets the surface, lines towards the sensor, and its fields of view.
fn show_views(scene: &mut Scene, next: &ViewsReport, sensor: &ViewSensor, unit: SmallUnit<'_>) -> Result<()> {
    let Some(surface) = scene.surfaces.first() else {
        return Ok(());
    };
    let mesh = TriangleMesh::try_new(surface.positions.clone(), surface.triangles.clone())?;
    let bounds = BoundingBox::from_points(&mesh.positions)
        .ok_or_else(|| Error::input("expected a model with a surface, found one without area"))?;
    let search = MeshSearch::try_new(&mesh)?;
    let (mut sights, mut fields) = (Vec::new(), Vec::new());
    for (k, view) in next.views.iter().enumerate() {
        let pose = Pose::from_quaternion_xyzw(view.quaternion_xyzw, view.translation).unwrap_or_default();
        let at = view.translation;
        let axis = pose.rotate(DVec3::Z);
        // An axis may miss the model if only the border of the field of view sees it.
        let met = search.first_hit(at, axis).map_or_else(|| bounds.center(), |hit| hit.point);
        // A short line is enough to show the direction. The sensor itself may be far away.
        sights.push([met, met - SIGHT_LENGTH * bounds.diagonal() * axis]);
        let far = at.distance(met);
        let [[left, right], [top, bottom]] = sensor.borders;
        let corners = [[left, top], [right, top], [right, bottom], [left, bottom]]
            // A quarter of the distance keeps the pyramids apart from the model and from each other.
            .map(|[x, y]| at + 0.25 * far * pose.rotate(DVec3::new(x, y, 1.0)));
        for (c, corner) in corners.iter().enumerate() {
            fields.push([at, *corner]);
            fields.push([*corner, corners[(c + 1) % 4]]);
        }
        scene.marks.push(Mark {
            at: met,
            label: (k + 1).to_string(),
            normal: -axis,
            text: format!("view {}; largest σ after it {}", k + 1, unit.text(view.worst_sigma_after)),
        });
    }
    "viewed points".clone_into(&mut scene.marks_name);
    scene.lines.push(LineSet {
        name: "lines to the sensor".to_owned(),
        segments: sights,
        colour: "#b34700".to_owned(),
        hidden: false,
    });
    scene.lines.push(LineSet {
        name: "fields of view".to_owned(),
        segments: fields,
        colour: "#b34700".to_owned(),
        // Hidden at first: the fields of several views overlap.
        hidden: true,
    });
    Ok(())
}

/// A table of points to measure.
pub(crate) fn next_table(next: &NextReport, model_unit: &str, unit: SmallUnit<'_>) -> Table {
    let place = format!("x, y, z / {model_unit}");
    let [now, then] = ["before", "after"].map(|when| unit.head(&format!("σ {when}")));
    let mut table = Table::new(["", &place, &now, &then]);
    for (k, point) in next.points.iter().enumerate() {
        table.row(
            [
                (k + 1).to_string(),
                point.position.to_array().map(|c| significant(c, 5)).join(", "),
                unit.number(point.sigma_before, 3),
                unit.number(point.sigma_after, 3),
            ],
            false,
        );
    }
    table
}

/// Places to measure, numbered in their order.
pub(crate) fn next_marks(points: &[NextPoint], unit: SmallUnit<'_>) -> Vec<Mark> {
    (points.iter().enumerate())
        .map(|(k, point)| Mark {
            at: point.position,
            label: (k + 1).to_string(),
            normal: point.normal,
            text: format!(
                "σ before {}, after {}",
                unit.text(point.sigma_before),
                unit.text(point.sigma_after)
            ),
        })
        .collect()
}
