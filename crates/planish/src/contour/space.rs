//! Planes, spheres, cylinders and boxes from readings in space.

use super::report::{judge, part_findings};
use super::shape_page::shape_page;
use super::unused;
use super::{ContourJob, ContourReport, PartReport, ReportedAlternative, ReportedValue, write_json};
use planish_contour::planar::{Form, PlanarMotion};
use planish_contour::primitive::choose;
use planish_core::Setting;
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::contours::read_ray_readings;
use planish_exchange::extension;

/// Fits the job's shapes to its readings and writes its outputs, which must be JSON.
///
/// # Errors
/// Those of the reader; `Unsupported` for motion, the product form, and outputs that are drawings;
/// `Undetermined` when no shape can be fitted.
pub(super) fn find_shapes(job: &ContourJob, progress: &dyn Progress) -> Result<ContourReport> {
    // Drawings are planar. The check is here, because planar contours accept them.
    if let Some(output) = job.outputs.iter().find(|output| extension(output) != "json") {
        return Err(Error::unsupported(format!(
            "{}: cannot write this format: expected .json for a shape in space",
            output.display()
        )));
    }
    // An error, because an ignored motion would look like a resting object.
    if job.fit.motion != PlanarMotion::Still || job.fit.form != Form::ActiveFacet {
        return Err(Error::unsupported(
            "shapes in space support neither motion nor the product form: omit both",
        )
        .with_setting(Setting::Motion)
        .with_setting(Setting::Product));
    }
    unused::refuse_unused(job, unused::Readings::Space)?;
    progress.check("reading", 0.0)?;
    let rays = read_ray_readings(&job.input, &job.sigma)?;
    progress.check("fitting", 0.1)?;
    let (fit, others) =
        choose(&job.shapes, &rays, &job.fit).map_err(|e| e.in_context(job.input.display()))?;
    let best = fit.bic();
    let order: Vec<String> = fit.shape.names().iter().map(|&name| name.to_owned()).collect();
    let value =
        |k: usize| ReportedValue { value: fit.parameters[k], sigma: fit.covariance[(k, k)].max(0.0).sqrt() };
    let part = PartReport {
        kind: fit.shape.to_string(),
        parameters: order.iter().cloned().zip((0..order.len()).map(value)).collect(),
        sides: Vec::new(),
        covariance: fit.covariance.row_iter().map(|row| row.iter().copied().collect()).collect(),
        order,
        log_likelihood: fit.log_likelihood,
        bic_margin: others.first().map(|o| o.1 - best),
        alternatives: others
            .iter()
            .map(|(shape, bic)| ReportedAlternative { kind: shape.to_string(), bic_difference: bic - best })
            .collect(),
        readings: rays.len(),
        rejected: fit.used.iter().filter(|used| !**used).count(),
        reduced_chi_square: fit.reduced_chi_square(),
        level: None,
        hole_of: None,
        closed: None,
        ends: None,
        spans: Vec::new(),
        sigma_across: None,
    };
    let mut report = ContourReport {
        findings: part_findings(&part, 0),
        // The only shape is also the largest, whose keys are at the top level of the JSON.
        main: part.clone(),
        contours: vec![part],
        constrained: None,
        levels: None,
        corners: Vec::new(),
        sigma_range: None,
        wall_errors: None,
        readings_on_no_wall: Vec::new(),
        samples_per_pixel: None,
        unit: job.unit,
        // Readings in space are not separated into groups, so none is a stray.
        ignored: 0,
    };
    report.findings.extend(judge(&report));
    progress.check(WRITING_STAGE, 0.95)?;
    for output in &job.outputs {
        write_json(output, &report)?;
    }
    if let Some(page) = &job.report {
        let points = rays.iter().map(|ray| ray.point()).collect();
        let made = shape_page(&report, &fit, points, &job.input, job.fit.gate)?;
        page.write(made, &[(job.input.clone(), format!("{} readings", rays.len()))])?;
    }
    progress.advance("done", 1.0);
    Ok(report)
}
