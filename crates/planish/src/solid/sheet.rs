//! Drawings of one file: the readings of the sheet that are tried, and what is reported about them.

use super::drawing::drop_repeated;
use super::{Projection, SolidJob, ViewKind};
use planish_core::{Finding, FindingCode, Setting};
use planish_estimate::Result;
use planish_exchange::Unit;
use planish_exchange::dxf::DxfDrawing;
use planish_report::numbers::counted;
use planish_solid::drawing::ViewContent;
use planish_solid::sheet::{
    ScaleSource, SetAsideReason, SheetOptions, SheetReading, read_sheet, scale_of_dimensions,
};
use planish_solid::views::{Drawing, View};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A drawing as it is searched for solids.
#[derive(Clone, Default)]
pub(super) struct ReadDrawing {
    pub drawing: Drawing,
    /// The sheet that it comes from; none if each view has its own file.
    pub sheet: Option<ReportedSheet>,
    /// What was noticed on reading.
    pub findings: Vec<Finding>,
    /// Maximum error of coordinates by the rounding of the format; zero if they are exact.
    pub rounding: f64,
    /// Whether the only two views show equal widths that may be round or flat.
    pub open_widths: bool,
    /// Whether a centre line crosses a view.
    pub has_centre_lines: bool,
    /// Entities that may be visible or hidden.
    pub open_styles: Vec<String>,
}

/// How a sheet was read.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedSheet {
    /// `first` or `third`.
    pub projection: &'static str,
    /// Length of the part per length of the drawing.
    pub scale: f64,
    /// The views that were used.
    pub views: Vec<ReportedPlace>,
    /// Entities that belong to no view.
    pub set_aside: Vec<SetAsideEntity>,
    /// How the sheet lies in a scan or a photograph, if it was straightened.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub picture: Option<ReportedPicture>,
}

/// How a sheet lies in its picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReportedPicture {
    /// Homography, row by row, from pixels of the picture (y down) to those of the straight sheet.
    pub sheet_from_picture: [[f64; 3]; 3],
    /// Clockwise rotation in the middle of the picture.
    pub rotation_deg: f64,
    /// σ of the rotation.
    pub sigma_deg: f64,
    /// `none`, `page-of-series-a` (the page is assumed to have the ratio √2), or `unknown-ratio`.
    pub perspective: &'static str,
}

/// A view on the sheet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportedPlace {
    /// `front`, `top`, `side` or `left`.
    pub view: &'static str,
    /// Left, bottom, right and top on the sheet.
    #[serde(rename = "box")]
    pub bounds: [f64; 4],
    /// Coordinate of the cutting plane along the line of sight, if the view is a section.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section_at: Option<f64>,
}

/// An entity that belongs to no view.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SetAsideEntity {
    /// The entity by kind, handle and line of the file.
    pub entity: String,
    /// What it is.
    #[serde(rename = "why")]
    pub reason: &'static str,
}

/// A place of a view on a sheet, given by the user.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewPlace {
    /// The direction from which the view is seen.
    pub kind: ViewKind,
    /// Left, bottom, right and top on the sheet.
    pub bounds: [f64; 4],
}

/// The readings of one file with all views, the most plausible first.
pub(super) fn readings(
    file: &DxfDrawing,
    path: &Path,
    unit: Unit,
    job: &SolidJob,
) -> Result<Vec<ReadDrawing>> {
    let options = SheetOptions {
        projection: job.projection,
        views: (job.places.iter())
            .map(|place| {
                let [left, bottom, right, top] = place.bounds;
                (place.kind, [[left, right], [bottom, top]])
            })
            .collect(),
        unit_mm: unit.millimetres(),
    };
    let read = read_sheet(&file.curves, &file.annotations, &options).map_err(|e| {
        let error = e.in_context(path.display());
        match job.projection {
            Some(_) => error.with_setting(Setting::Projection),
            None => error,
        }
    })?;
    let open_styles: Vec<String> = file.open_styles.iter().map(|k| file.curves[*k].entity.clone()).collect();
    let rounding = file.rounding.unwrap_or(0.0);
    let picture = file.placement.map(|placement| ReportedPicture {
        sheet_from_picture: placement.sheet_from_picture,
        rotation_deg: placement.rotation_rad.to_degrees(),
        sigma_deg: placement.sigma_rad.to_degrees(),
        perspective: placement.perspective,
    });
    let made = read.into_iter().map(|reading| {
        let mut made = candidate(reading, path, rounding);
        made.open_styles.clone_from(&open_styles);
        if let Some(sheet) = &mut made.sheet {
            sheet.picture = picture;
        }
        made
    });
    Ok(made.collect())
}

fn candidate(mut reading: SheetReading, path: &Path, rounding: f64) -> ReadDrawing {
    let name = path.display();
    let mut findings: Vec<Finding> = Vec::new();
    for view in &mut reading.drawing.views {
        findings.extend(drop_repeated(&mut view.curves).into_iter().map(|f| f.in_context(&name)));
    }
    findings.extend(described(&reading).into_iter().map(|f| f.in_context(&name)));
    let sheet = ReportedSheet {
        projection: reading.projection.name(),
        scale: reading.scale,
        views: (reading.views.iter())
            .map(|view| {
                let [[left, right], [bottom, top]] = view.bounds;
                ReportedPlace {
                    view: view.kind.name(),
                    bounds: [left, bottom, right, top],
                    section_at: view.section_at,
                }
            })
            .collect(),
        set_aside: (reading.set_aside.iter())
            .map(|(entity, reason)| SetAsideEntity { entity: entity.clone(), reason: reason.name() })
            .collect(),
        picture: None,
    };
    let rounding = rounding * reading.scale;
    let SheetReading { open_widths, has_centre_lines, .. } = reading;
    ReadDrawing {
        drawing: reading.drawing,
        sheet: Some(sheet),
        findings,
        rounding,
        open_widths,
        has_centre_lines,
        open_styles: Vec::new(),
    }
}

/// What a user should know about the reading of a sheet.
fn described(reading: &SheetReading) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut counts: BTreeMap<SetAsideReason, usize> = BTreeMap::new();
    reading.set_aside.iter().for_each(|(_, reason)| *counts.entry(*reason).or_default() += 1);
    if !counts.is_empty() {
        let list: Vec<String> =
            counts.iter().map(|(reason, count)| format!("{count} × {}", reason.name())).collect();
        let text = format!("left out as no part of a view: {}", list.join(", "));
        findings.push(Finding::new(FindingCode::SheetSetAside, text));
    }
    for view in &reading.drawing.views {
        if let Some(section) = view.section() {
            let axis = ["x", "y", "z"][view.kind.axes()[2]];
            let text = format!("the {} view is a section at {axis} = {:.4}", view.kind.name(), section.at);
            findings.push(Finding::new(FindingCode::SectionUsed, text));
        }
    }
    if let Some(view) = reading.drawing.views.iter().find(|view| view.content == ViewContent::Candidates) {
        let text = format!(
            "{} that no view shows follow from diameters, centre lines or hidden lines",
            counted(view.curves.len(), "circle")
        );
        findings.push(Finding::new(FindingCode::DiametersUsed, text));
    }
    match reading.scale_source {
        ScaleSource::Unknown => {
            let text = "the sheet states another scale than 1:1, and neither dimensions nor the frame show \
                        whether lengths are those of the part: they are used as drawn";
            findings.push(Finding::new(FindingCode::ScaleUnknown, text));
        }
        _ if reading.scale != 1.0 => {
            let text = format!("lengths are {} times those of the drawing", reading.scale);
            findings.push(Finding::new(FindingCode::ScaleApplied, text));
        }
        _ => {}
    }
    findings
}

/// Scales a view of a file of its own by its dimensions; returns the scale, if it is not 1.
pub(super) fn scale_view(view: &mut View, file: &DxfDrawing) -> Option<(f64, Finding)> {
    let scale = scale_of_dimensions(&file.annotations.dimensions).filter(|scale| *scale != 1.0)?;
    let drawing = Drawing { views: vec![std::mem::replace(view, View::new(view.kind, Vec::new()))] };
    view.curves = drawing.scaled(scale).views.remove(0).curves;
    let text = format!("lengths are {scale} times those of the drawing, as its dimensions state");
    Some((scale, Finding::new(FindingCode::ScaleApplied, text)))
}

/// That a sheet shows different solids in both conventions.
pub(super) fn open_convention(used: &ReportedSheet) -> Finding {
    let (used, other) = match used.projection {
        "first" => (Projection::FirstAngle, Projection::ThirdAngle),
        _ => (Projection::ThirdAngle, Projection::FirstAngle),
    };
    let text = format!(
        "the views are those of a solid in the {}-angle and in the {}-angle convention, and nothing on the \
         sheet decides: the first is used; specify the projection",
        used.name(),
        other.name()
    );
    Finding::new(FindingCode::ProjectionOpen, text).with_setting(Setting::Projection)
}
