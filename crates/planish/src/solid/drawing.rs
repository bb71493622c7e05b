//! Reads the files of a drawing as views in one frame, and checks them for errors.

use super::misses::{nearly_equal_extents, nearly_meeting_ends};
use super::nearby_curves::NearbyCurves;
use super::settings::is_picture;
use super::sheet::{self, ReadDrawing};
use super::{SolidJob, kinds};
use planish_core::{Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::dxf::DxfDrawing;
use planish_exchange::{Unit, extension, read_drawing};
use planish_report::numbers::significant;
use planish_solid::drawing::ViewContent;
use planish_solid::views::{
    Curve2, Drawing, DrawnCurve, LineStyle, View, distance, distance_to_segment, joined, unrounded,
};
use std::collections::HashMap;
use std::path::PathBuf;

/// Maximum number of lines of one kind that a message names. Others are counted.
const MAX_NAMED: usize = 3;
/// Distance within which ends of lines meet, relative to the drawing's size. It only selects what a message
/// names; the search has limits of its own.
const MEETING_TOLERANCE: f64 = 1e-4;
/// Distance within which ends and middles of repeated lines agree, relative to the drawing's size: the
/// rounding of files. A larger value would merge distinct lines.
const REPEATED_LINE_TOLERANCE: f64 = 1e-7;

/// Coordinates that are rounded differ by at most this many rounding errors: two lines, each from the corner
/// of its view, by 4. The centre of a quarter of a circle has 3.4 times the error of its points.
const JOINED_ROUNDINGS: f64 = 8.0;

/// Sizes of parts that can be written, in millimetres: Open Cascade 7.9 finds a box with a hole valid from
/// 0.004 mm to 4e8 mm, and not of 4e9 mm.
const SIZES_MM: [f64; 2] = [1e-3, 1e9];

/// Reads the files. A sheet may have several readings, the most plausible first.
pub(super) fn read(job: &SolidJob) -> Result<(Vec<ReadDrawing>, Unit)> {
    let mut unit = None;
    let mut files: Vec<DxfDrawing> = Vec::new();
    let mut findings = Vec::new();
    for (path, kind) in job.views.iter().zip(kinds(job)) {
        let name = path.display();
        let mut file = read_drawing(path)?;
        if let Some(scale) = job.scale.or(file.pixel_length) {
            scale_file(&mut file, scale);
        }
        if let Some(length) = file.pixel_length.filter(|_| job.scale.is_none()) {
            let text = format!("{name}: a pixel is {} long by the dimensions", significant(length, 4));
            findings.push(Finding::new(FindingCode::ScaleApplied, text));
        }
        if file.curves.is_empty() {
            return Err(Error::input(format!(
                "{name}: expected lines, arcs or circles of {}, found none{}",
                match job.views.len() {
                    1 => "two or three views".to_owned(),
                    _ => format!("the {} view", kind.name()),
                },
                match file.findings.first() {
                    Some(warning) => format!(" ({warning})"),
                    None => String::new(),
                }
            )));
        }
        if let (Some(a), Some(b)) = (unit, file.unit)
            && a != b
        {
            return Err(Error::input(format!(
                "{name}: expected the unit of the previous views, {a}, found {b}"
            )));
        }
        unit = unit.or(file.unit);
        findings.extend(file.findings.drain(..).map(|f| f.in_context(&name)));
        files.push(file);
    }
    let unit = unit.or(job.unit).unwrap_or(Unit::Millimetre);
    // One file holds all views: they are found among what else is drawn.
    let mut readings = match (&job.views[..], &files[..]) {
        ([path], [file]) => sheet::readings(file, path, unit, job)?,
        _ => vec![separate_views(job, files)],
    };
    let mut failed = None;
    readings.retain_mut(|reading| match finish(reading, unit, job) {
        Ok(()) => true,
        // Of several readings of a sheet, others may be consistent.
        Err(error) => {
            failed.get_or_insert(error);
            false
        }
    });
    if let Some(error) = failed.filter(|_| readings.is_empty()) {
        return Err(error);
    }
    for reading in &mut readings {
        reading.findings.splice(0..0, findings.iter().cloned());
    }
    Ok((readings, unit))
}

/// Multiplies the lengths of a picture by a given scale, which then is the only one.
fn scale_file(file: &mut DxfDrawing, scale: f64) {
    let view = View::new(planish_solid::views::ViewKind::Front, std::mem::take(&mut file.curves));
    file.curves = Drawing { views: vec![view] }.scaled(scale).views.remove(0).curves;
    file.rounding = file.rounding.map(|rounding| scale * rounding);
    file.findings.retain(|finding| finding.code != FindingCode::ScaleUnknown);
    file.annotations.dimensions.clear();
    let at = |p: &mut [f64; 2]| *p = p.map(|c| scale * c);
    file.annotations.texts.iter_mut().for_each(|text| at(&mut text.at));
    file.annotations.hatches.iter_mut().flatten().for_each(at);
    file.annotations.arrowheads.iter_mut().flatten().for_each(at);
    file.annotations.centre_lines.iter_mut().flatten().for_each(at);
}

/// Views of one file each.
fn separate_views(job: &SolidJob, files: Vec<DxfDrawing>) -> ReadDrawing {
    let mut made = ReadDrawing::default();
    for ((path, kind), mut file) in job.views.iter().zip(kinds(job)).zip(files) {
        let name = path.display();
        made.open_styles.extend(file.open_styles.iter().map(|k| file.curves[*k].entity.clone()));
        // A second copy would have to be explained by a second edge.
        let twice = drop_repeated(&mut file.curves);
        made.findings.extend(twice.into_iter().map(|f| f.in_context(&name)));
        // DXF views share a frame; every page of SVG and PDF, and every picture, has an origin of its own.
        if ["svg", "pdf"].contains(&extension(path).as_str()) || is_picture(path) {
            place_at_origin(&mut file.curves);
        }
        let mut view = View::new(kind, std::mem::take(&mut file.curves));
        let scale = sheet::scale_view(&mut view, &file);
        made.rounding = made.rounding.max(file.rounding.unwrap_or(0.0) * scale.as_ref().map_or(1.0, |s| s.0));
        made.findings.extend(scale.map(|(_, finding)| finding.in_context(&name)));
        made.drawing.views.push(view);
    }
    made
}

/// Joins coordinates and checks the views.
fn finish(reading: &mut ReadDrawing, unit: Unit, job: &SolidJob) -> Result<()> {
    // Joining comes before the check of extents, because it can make them equal.
    let given = job.tolerance.map(|length| length.in_unit(unit));
    if given.is_none() && reading.rounding > 0.0 {
        let tolerance = JOINED_ROUNDINGS * reading.rounding;
        for view in &mut reading.drawing.views {
            view.curves.retain(|c| c.curve.length() > tolerance);
        }
        reading.drawing = joined(&reading.drawing, tolerance)?;
    }
    // Rounded coordinates of a format that could hold more digits.
    if given.is_none()
        && reading.rounding == 0.0
        && let Some(found) = unrounded(&reading.drawing)
    {
        let text = format!(
            "coordinates are rounded to multiples of {}: lines and circles were moved by up to {}, so that \
             they meet and touch",
            significant(found.step, 2),
            significant(found.change, 2)
        );
        let finding = Finding::new(FindingCode::ToleranceEstimated, text);
        reading.findings.push(finding.with_setting(Setting::Tolerance));
        reading.drawing = found.drawing;
    }
    if let Some(tolerance) = given {
        reading.drawing = joined(&reading.drawing, tolerance)
            .map_err(|e| e.in_context(format!("tolerance {tolerance:e}")).with_setting(Setting::Tolerance))?;
    }
    check_extents(&reading.drawing, &job.views)?;
    check_size(&reading.drawing, unit, job)
}

/// Refuses drawings of a size at which no STEP file is valid.
fn check_size(drawing: &Drawing, unit: Unit, job: &SolidJob) -> Result<()> {
    let size = drawing.size();
    if (SIZES_MM[0]..=SIZES_MM[1]).contains(&(size * unit.millimetres())) {
        return Ok(());
    }
    Err(Error::input(format!(
        "{}: expected a drawing of 0.001 mm to 1e9 mm, because readers of STEP have fixed accuracies, \
         found {size:e} {unit}: check the unit ($INSUNITS of a DXF) and the scale",
        job.views.first().map(|v| v.display().to_string()).unwrap_or_default()
    ))
    .with_setting(Setting::Unit))
}

/// The first few items, and the number of the others.
fn summary(all: Vec<Finding>) -> impl Iterator<Item = Finding> {
    let more = match (all.len().saturating_sub(MAX_NAMED), all.first()) {
        (0, _) | (_, None) => None,
        (n, Some(first)) => Some(Finding::new(first.code, format!("and {n} more such lines"))),
    };
    all.into_iter().take(MAX_NAMED).chain(more)
}

/// Removes repeated lines and reports the first of them. If one is visible and the other hidden, the visible
/// one is kept.
pub(super) fn drop_repeated(curves: &mut Vec<DrawnCurve>) -> Vec<Finding> {
    let all = Drawing { views: vec![View::new(planish_solid::views::ViewKind::Front, curves.clone())] };
    let step = (REPEATED_LINE_TOLERANCE * all.size()).max(f64::MIN_POSITIVE);
    let key = |curve: &Curve2| {
        let points = curve.points();
        let mut at: Vec<[i64; 2]> = [0, points.len() / 2, points.len() - 1]
            .map(|k| points[k].map(|c| (c / step).round() as i64))
            .to_vec();
        if let Curve2::Segment(..) = curve {
            at.remove(1);
        }
        // A line and its reverse are the same line.
        if at[0] > at[at.len() - 1] {
            at.reverse();
        }
        (std::mem::discriminant(curve), at)
    };
    let mut seen: HashMap<_, usize> = HashMap::new();
    let mut kept: Vec<DrawnCurve> = Vec::with_capacity(curves.len());
    let mut repeated = Vec::new();
    for drawn in curves.drain(..) {
        let next = kept.len();
        let at = *seen.entry(key(&drawn.curve)).or_insert(next);
        if at == next {
            kept.push(drawn);
            continue;
        }
        let first = &mut kept[at];
        let text = match (first.style, drawn.style) {
            (a, b) if a == b => {
                format!("{} repeats {}: the line counts once", first.entity, drawn.entity)
            }
            _ => format!(
                "{} repeats {}, one visible and one hidden: the line counts as visible",
                first.entity, drawn.entity
            ),
        };
        repeated.push(Finding::new(FindingCode::LineRepeated, text));
        // A visible line hides a hidden one in the same place.
        if drawn.style == LineStyle::Visible {
            first.style = LineStyle::Visible;
        }
    }
    *curves = kept;
    summary(repeated).collect()
}

/// Moves the lower left corner of a view to the origin.
fn place_at_origin(curves: &mut [DrawnCurve]) {
    let corner = [0, 1].map(|k| curves.iter().map(|c| c.curve.bounds()[k][0]).fold(f64::MAX, f64::min));
    for drawn in curves {
        drawn.curve = drawn.curve.moved(|p| [p[0] - corner[0], p[1] - corner[1]], false);
    }
}

/// Possible reasons why no solid was found: sizes and ends that nearly agree, and open outlines.
pub(super) fn misses(drawing: &Drawing, paths: &[PathBuf]) -> Vec<Finding> {
    let mut found = nearly_equal_extents(drawing, paths);
    found.extend(summary(nearly_meeting_ends(drawing, paths)));
    if found.is_empty() {
        // Only if nothing else was found: drawings without smooth edges have open ends as well.
        found = open_ends(drawing, paths);
    }
    found
}

/// Why no solid was found, with the first of these.
pub(super) fn explain(error: Error, drawing: &Drawing, paths: &[PathBuf]) -> Error {
    match misses(drawing, paths).into_iter().next() {
        Some(open) => open.settings.iter().fold(error.in_context(&open), |e, s| e.with_setting(*s)),
        None => error,
    }
}

/// Names the ends of visible lines at which no other line ends. If no solid was found, an open outline is a
/// likely reason. (Drawings that omit smooth edges have such ends as well.)
fn open_ends(drawing: &Drawing, paths: &[PathBuf]) -> Vec<Finding> {
    let near = MEETING_TOLERANCE * drawing.size();
    let mut found = Vec::new();
    for (index, view) in drawing.views.iter().enumerate() {
        let Some(nearby) = NearbyCurves::new(view, near) else { continue };
        let chains: Vec<Vec<[f64; 2]>> = view.curves.iter().map(|c| c.curve.points()).collect();
        for (k, chain) in
            chains.iter().enumerate().filter(|(k, _)| view.curves[*k].style == LineStyle::Visible)
        {
            let ends = [chain[0], chain[chain.len() - 1]];
            if distance(ends[0], ends[1]) <= near {
                continue;
            }
            for end in ends {
                let touches = |other: &usize| {
                    let (other, points) = (*other, &chains[*other]);
                    // An arc's points are apart: its chords miss it by up to a thousandth of its radius.
                    let reach = match &view.curves[other].curve {
                        Curve2::Arc { radius, .. } => near + 1e-3 * radius,
                        _ => near,
                    };
                    points.windows(2).any(|p| distance_to_segment(end, p[0], p[1]) <= reach)
                };
                let Some(others) = nearby.around(end, k) else { return summary(found).collect() };
                if !others.iter().any(touches) {
                    let text = format!(
                        "{}: {} of the {} view ends at {:.4} {:.4}, where no other line is: check whether \
                         the outline is open",
                        paths[index.min(paths.len() - 1)].display(),
                        view.curves[k].entity,
                        view.kind.name(),
                        end[0],
                        end[1]
                    );
                    found.push(Finding::new(FindingCode::DrawingInexact, text));
                }
            }
        }
    }
    summary(found).collect()
}

/// Views that share an axis must span the same range of it.
fn check_extents(drawing: &Drawing, paths: &[PathBuf]) -> Result<()> {
    let mut seen: [Option<([f64; 2], usize)>; 3] = [None; 3];
    for (index, view) in drawing.views.iter().enumerate() {
        for k in 0..2 {
            let axis = view.kind.axes()[k];
            let mut range = [f64::MAX, f64::MIN];
            let mut ends = ["", ""];
            for drawn in &view.curves {
                let own = drawn.curve.bounds()[k];
                if own[0] < range[0] {
                    (range[0], ends[0]) = (own[0], &drawn.entity);
                }
                if own[1] > range[1] {
                    (range[1], ends[1]) = (own[1], &drawn.entity);
                }
            }
            let Some((first, other)) = seen[axis] else {
                seen[axis] = Some((range, index));
                continue;
            };
            let size = (first[1] - first[0]).max(range[1] - range[0]);
            // An error before the search, whose message could not name the cause. Smaller differences are
            // left to the search and to the hints for near misses.
            // A section may show less than the whole part.
            let is_part = |v: usize| {
                matches!(drawing.views[v].content, ViewContent::Section(_) | ViewContent::Candidates)
            };
            if is_part(index) || is_part(other) {
                continue;
            }
            if let Some(end) = (0..2).find(|e| (first[*e] - range[*e]).abs() > 2e-3 * size) {
                let ratio = (range[1] - range[0]) / (first[1] - first[0]);
                let scale = match (ratio - 1.0).abs() > 2e-3 && ratio.is_finite() {
                    true => format!(" (it is {ratio:.4} times as long)"),
                    false => String::new(),
                };
                return Err(Error::input(format!(
                    "{}: expected views of one scale in one frame, but {} reaches {} = {:.6}, and the {} \
                     view ({}) ends at {:.6}{scale}",
                    paths[index.min(paths.len() - 1)].display(),
                    ends[end],
                    ["x", "y", "z"][axis],
                    range[end],
                    drawing.views[other].kind.name(),
                    paths[other.min(paths.len() - 1)].display(),
                    first[end]
                )));
            }
        }
    }
    Ok(())
}
