//! Checks the settings of the job before the work.

use super::{SolidJob, is_contours, writing};
use crate::graphs::check_graphs_name;
use planish_core::{Length, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::extension;
use std::path::Path;

/// Whether a file is a picture, which has pixels instead of lengths.
pub(super) fn is_picture(path: &Path) -> bool {
    ["png", "jpg", "jpeg", "tif", "tiff"].contains(&extension(path).as_str())
}

/// Refuses settings that contradict each other.
pub(super) fn check_settings(job: &SolidJob) -> Result<()> {
    if !(1..=3).contains(&job.views.len()) {
        return Err(Error::input(format!(
            "expected drawings (.dxf, .svg, .pdf) of the front, top and side view, in this order (the side \
             view is optional), or one file with all of them, found {}",
            job.views.len()
        )));
    }
    if !job.places.is_empty() && job.views.len() != 1 {
        return Err(Error::input(format!(
            "expected places of views for one file with all views, found {} files",
            job.views.len()
        ))
        .with_setting(Setting::ViewPlaces));
    }
    if let Some(kinds) = &job.kinds {
        let repeated = kinds.iter().enumerate().find(|(i, kind)| kinds[..*i].contains(kind));
        if kinds.len() != job.views.len() || repeated.is_some() {
            let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
            return Err(Error::input(format!(
                "expected one name for each of the {} views, each once, found {}",
                job.views.len(),
                names.join(",")
            )));
        }
    }
    if let Some(drawn) = job.views.iter().find(|view| extension(view) != "json")
        && is_contours(job)
    {
        return Err(Error::input(format!(
            "{}: expected a contour (.json) like the other views, found a drawing, which has no σ for the \
             matching",
            drawn.display()
        )));
    }
    check_lengths(job)?;
    check_outputs(job)
}

/// Scale, tolerances, and graphs.
fn check_lengths(job: &SolidJob) -> Result<()> {
    if let Some(drawn) = job.views.iter().find(|view| !is_picture(view))
        && job.scale.is_some()
    {
        return Err(Error::input(format!(
            "{}: expected a picture for a scale, found a drawing, which has lengths: omit the scale",
            drawn.display()
        )));
    }
    for graphs in &job.graphs {
        if !is_contours(job) {
            return Err(Error::input(format!(
                "{}: expected contours with their covariance (.json) for graphs, found a drawing",
                graphs.display()
            )));
        }
        check_graphs_name(graphs)?;
    }
    // An error and not a warning: the user would believe that the tolerance had an effect.
    if job.tolerance.is_some()
        && let Some(view) = job.views.first().filter(|_| is_contours(job))
    {
        return Err(Error::input(format!(
            "{}: expected a drawing for a tolerance, found a contour, for which the covariance decides \
             which coordinates are equal: omit the tolerance, and use the significance level",
            view.display()
        ))
        .with_setting(Setting::Tolerance)
        .with_setting(Setting::Level));
    }
    if let Some(Length { value: tolerance, .. }) = job.mesh_tolerance
        && !(tolerance > 0.0 && tolerance.is_finite())
    {
        return Err(Error::input(format!("expected a mesh tolerance > 0, found {tolerance}")));
    }
    Ok(())
}

/// Names of the solids and meshes to write.
fn check_outputs(job: &SolidJob) -> Result<()> {
    for output in &job.outputs {
        // Dimensions with σ exist only for contours, so `.json` is refused for drawings.
        let may_be_json = is_contours(job) && extension(output) == "json";
        if !may_be_json && !writing::is_solid_file(output) {
            let json = if is_contours(job) { ", and their dimensions with σ as .json" } else { "" };
            return Err(Error::unsupported(format!(
                "{}: cannot write this format: expected .step or .stp for solids, .ply, .stl, .glb or .obj \
                 for their meshes{json}",
                output.display()
            )));
        }
    }
    Ok(())
}
