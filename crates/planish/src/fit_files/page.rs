//! The report of a fit.

use super::findings::{misfit, share_rejected};
use crate::next::page::{next_marks, next_table};
use crate::next::{NextOptions, NextReport, next_points};
use crate::report::scenes::model_scene;
use crate::report::title_of;
use crate::report::words::{SmallUnit, with_article};
use planish_core::Silent;
use planish_estimate::{ErrorKind, Result};
use planish_report::colour::KNOWN_BY;
use planish_report::numbers::{count, counted, percent, significant};
use planish_report::{Block, Figure, Page, Section, Table, plot};
use planish_surface::fit::{Fit, FitReport, ScanSummary};
use planish_surface::model::SensorReport;
use std::path::PathBuf;

/// Number of points to measure next that a report names. More would hide the first ones in the view.
const NEXT_POINTS: usize = 5;

/// The page of a fit. `named` are the files that the command names; `report` holds the findings of the whole
/// job; readings beyond `gate` σ were rejected.
pub(crate) fn fit_page(
    fit: &Fit,
    report: &FitReport,
    named: &[PathBuf],
    mesh_tolerance: Option<f64>,
    gate: f64,
    verb: &str,
) -> Result<Page> {
    let model_unit = fit.model.unit.name();
    // One unit for the whole page, so that figures can be compared by eye.
    let unit = SmallUnit::for_length(model_unit, report.rms.max(report.sigma.median));
    let length = |value: f64| unit.text(value);
    let (mut scene, tolerance) =
        model_scene(&fit.model, &fit.posterior(), mesh_tolerance, fit.readings.as_ref())?;
    // The plan is made from the model as it is written, so it agrees with `planish next`.
    let next = next_points_for(fit)?;
    if let Some(next) = &next {
        scene.marks = next_marks(&next.points, unit);
        "next measurements".clone_into(&mut scene.marks_name);
    }
    let scans = fit.readings.as_ref().map_or(&[][..], |readings| &readings.scans);
    let mut sections = vec![input_section(report, scans, unit), quality_section(fit, report, gate, unit)];
    // Findings come first on the page; the sections give their evidence in the order of the work.
    sections.extend(completion_section(report));
    sections.push(advice_section(report, next.as_ref(), model_unit, unit));
    sections.push(Section::new(
        "About the 3D view",
        vec![Block::Text(format!(
            "The triangles lie within {} of the surface; their vertices have its exact position and σ. \
             Click a point to see the values of the nearest vertex. At most 20 000 readings are drawn, \
             evenly sampled.",
            length(tolerance)
        ))],
    ));
    Ok(Page {
        job: "fit".to_owned(),
        title: title_of(named),
        headline: format!(
            "{verb} a {} of {} with {}. Median σ of the measured surface: {}.",
            report.topology,
            counted(report.coefficients, "control vertex"),
            counted(report.observations, "reading"),
            length(report.sigma.median),
        ),
        findings: report.findings.clone(),
        figures: vec![
            Figure::new(
                "σ of the surface, median",
                length(report.sigma.median),
                format!("95 % below {}", length(report.sigma.p95)),
            ),
            Figure::new(
                "residuals, rms",
                length(report.rms),
                format!("normalised rms {}", significant(report.rms_normalised, 3)),
            ),
            Figure::new("reduced χ²", significant(report.reduced_chi_square, 3), "1 if all σ are correct"),
            Figure::new(
                "held-out readings",
                match report.held_out.n {
                    0 => "none".to_owned(),
                    _ => significant(report.held_out.rms_normalised, 3),
                },
                match report.held_out.n {
                    0 => String::new(),
                    // A narrow no-break space keeps the number on one line.
                    n => format!("normalised rms of {} readings", count(n).replace(' ', "\u{202f}")),
                },
            ),
            Figure::new("measured", percent(report.observed_area_fraction), "of the area"),
        ],
        scene: Some(scene),
        drawings: Vec::new(),
        sections,
    })
}

/// The stated σ of a sensor, if residuals contradict it.
fn false_sigma(sensor: &SensorReport) -> Option<f64> {
    sensor.sigma_stated.filter(|_| sensor.sigma_used_is_estimated)
}

fn input_section(report: &FitReport, scans: &[ScanSummary], unit: SmallUnit<'_>) -> Section {
    let mut blocks = Vec::new();
    let share = share_rejected(scans);
    if !scans.is_empty() {
        let off = unit.head("mean");
        let rms = unit.head("rms");
        let mut table = Table::new(["scan", "sensor", "used", "rejected", &rms, &off, "rms / σ"]);
        for scan in scans {
            table.row(
                [
                    scan.name.clone(),
                    scan.sensor.clone(),
                    count(scan.used),
                    count(scan.rejected),
                    unit.number(scan.rms, 3),
                    unit.number(scan.mean, 2),
                    significant(scan.rms_normalised, 3),
                ],
                // The table marks exactly the scans that have a finding.
                misfit(scan, share, unit).is_some(),
            );
        }
        blocks.push(Block::Table(table));
    }
    let total: usize = report.rejected.values().sum();
    blocks.push(Block::Text(if total == 0 {
        "No reading was rejected.".to_owned()
    } else {
        let causes: Vec<String> = (report.rejected.iter())
            .map(|(cause, n)| format!("{} {}", count(*n), cause_text(cause)))
            .collect();
        format!("{} rejected: {}.", counted(total, "reading"), causes.join(", "))
    }));
    Section::new("Inputs", blocks)
}

/// Causes in words.
fn cause_text(cause: &str) -> String {
    match cause {
        // Keys of the summary, in words. A new key is shown as it is.
        "depth_edge" => "at depth edges".to_owned(),
        "grazing" => "at a grazing angle".to_owned(),
        "isolated" => "far from all others".to_owned(),
        "normal_mismatch" => "with normals that disagree with the surface".to_owned(),
        "outlier" => "outliers".to_owned(),
        "beyond_border" => "beyond the boundary".to_owned(),
        "class" => "of other classes".to_owned(),
        "above_ground" => "above the ground".to_owned(),
        "not_finite" => "that are not finite numbers".to_owned(),
        other => other.replace('_', " "),
    }
}

fn quality_section(fit: &Fit, report: &FitReport, gate: f64, unit: SmallUnit<'_>) -> Section {
    let mut blocks = Vec::new();
    let positions: Vec<&SensorReport> = report.sensors.iter().filter(|s| s.quantity == "position").collect();
    // Without a stated σ there is nothing to compare.
    if positions.iter().any(|s| s.sigma_stated.is_some()) {
        let rows: Vec<(String, Option<f64>, f64)> = (positions.iter())
            .map(|s| {
                (s.name.clone(), s.sigma_stated.map(|s| unit.factor * s), unit.factor * s.sigma_estimated)
            })
            .collect();
        blocks.push(Block::Drawing {
            svg: plot::stated_and_found(&rows, unit.name),
            caption:
                "Each sensor's σ along the normal, as stated and as estimated from its residuals. A line \
                 that extends to the right marks a stated σ that is too small."
                    .to_owned(),
        });
    }
    let mut table = Table::new(["sensor", "readings", "σ stated", "σ estimated", "rms", "used"]);
    for sensor in &report.sensors {
        let (name, factor) = match sensor.quantity.as_str() {
            // Angles and curvatures are not lengths, so the unit of the page does not apply to them.
            "normal" => (format!("{} (normals, °)", sensor.name), 1.0),
            "curvature" => (format!("{} (curvatures)", sensor.name), 1.0),
            _ => (format!("{} / {}", sensor.name, unit.name), unit.factor),
        };
        let cell = |value: f64| significant(factor * value, 3);
        table.row(
            [
                name,
                count(sensor.observations),
                sensor.sigma_stated.map_or("–".to_owned(), cell),
                cell(sensor.sigma_estimated),
                cell(sensor.rms),
                if sensor.sigma_used_is_estimated { "estimated" } else { "stated" }.to_owned(),
            ],
            false_sigma(sensor).is_some(),
        );
    }
    blocks.push(Block::Table(table));
    if let Some(readings) = fit.readings.as_ref().filter(|r| !r.normalised.is_empty()) {
        blocks.push(Block::Drawing {
            svg: plot::normalised_residuals(&readings.normalised),
            caption: format!(
                "Normalised residuals of the readings (bars), and the normal distribution (line). Readings \
                 beyond ±{gate} were rejected."
            ),
        });
    }
    // Poses that were used as stated have no motion to show.
    let moved: Vec<_> = report.poses.iter().filter(|p| p.moved.is_some()).collect();
    if !moved.is_empty() {
        let by = unit.head("moved");
        let sigma = unit.head("σ");
        let mut table = Table::new(["pose", &by, "rotated / °", &sigma, "σ / °"]);
        for pose in moved {
            let cell =
                |v: Option<f64>, factor: f64| v.map_or("–".to_owned(), |v| significant(factor * v, 3));
            let [a, b, c, d] = [
                cell(pose.moved, unit.factor),
                cell(pose.turned_deg, 1.0),
                cell(pose.sigma_translation, unit.factor),
                cell(pose.sigma_rotation_deg, 1.0),
            ];
            table.row([pose.scan.clone(), a, b, c, d], false);
        }
        blocks.push(Block::Table(table));
    }
    let completed = report.propagation.as_ref().map_or(0.0, |p| p.inferred_area_fraction);
    let measured = report.observed_area_fraction;
    let [grey, blue, orange, _] = KNOWN_BY.map(|colour| format!("#{colour:06x}"));
    blocks.push(Block::Drawing {
        svg: plot::shares(&[
            ("measured", measured, blue),
            ("completed", completed, orange),
            // The three shares add up to 1 but for rounding.
            ("smoothness alone", (1.0 - measured - completed).max(0.0), grey),
        ]),
        caption: "Shares of the area that were measured, completed, or follow from smoothness alone."
            .to_owned(),
    });
    if let Some(left) = &report.unresolved_shape {
        blocks.push(Block::Text(format!(
            "Unresolved shape: on {} of the area the cells are too large ({} rms, included in σ).",
            percent(left.area_fraction),
            unit.text(left.rms)
        )));
    }
    Section::new("Quality", blocks)
}

/// The section about parts that were completed from measured parts.
fn completion_section(report: &FitReport) -> Option<Section> {
    let found = report.propagation.as_ref()?;
    let mut blocks = Vec::new();
    if let Some(symmetry) = &found.symmetry {
        blocks.push(Block::Text(match symmetry.is_found() {
            true => format!(
                "{} was found: {} of {} pieces of the cloud agree.",
                with_article(&symmetry.kind.to_string()),
                count(symmetry.agreeing),
                count(symmetry.compared)
            ),
            false => "The readings support no symmetry.".to_owned(),
        }));
    }
    if !found.gaps.is_empty() {
        blocks.push(Block::Text(format!("{} examined.", counted(found.gaps.len(), "gap"))));
    }
    blocks.push(Block::Text(format!(
        "{} of the area was completed from {} inferred from others.",
        percent(found.inferred_area_fraction),
        counted(found.pseudo_readings, "reading")
    )));
    Some(Section::new("Completed parts", blocks))
}

/// The best next points to measure, or none for a model that does not support it.
fn next_points_for(fit: &Fit) -> Result<Option<NextReport>> {
    let options = NextOptions { count: NEXT_POINTS, ..NextOptions::default() };
    match next_points(&fit.model, &options, &Silent) {
        Ok(next) => Ok(Some(next)),
        // A report without this section is better than none. Interruptions and failures are passed on.
        Err(e) if matches!(e.kind(), ErrorKind::Unsupported | ErrorKind::Input) => Ok(None),
        Err(e) => Err(e),
    }
}

fn advice_section(
    report: &FitReport,
    next: Option<&NextReport>,
    model_unit: &str,
    unit: SmallUnit<'_>,
) -> Section {
    let mut blocks = Vec::new();
    // Corrections of the input come before new measurements: they cost nothing.
    if report.sensors.iter().any(|sensor| false_sigma(sensor).is_some()) {
        blocks.push(Block::Text(
            "Correct σ of the highlighted sensors, or omit it so that it is estimated.".to_owned(),
        ));
    }
    match next {
        Some(next) if !next.points.is_empty() => {
            blocks.push(Block::Text(format!(
                "Next measurements: {} with σ {} would reduce the largest σ of the surface from {} to {}. \
                 They are marked in the 3D view. The command planish next plans more.",
                counted(next.points.len(), "reading"),
                unit.text(next.sigma),
                unit.text(next.worst_sigma.before),
                unit.text(next.worst_sigma.after),
            )));
            blocks.push(Block::Table(next_table(next, model_unit, unit)));
        }
        _ => blocks.push(Block::Text(
            "The next measurements cannot be planned: this requires a model of the global filter.".to_owned(),
        )),
    }
    Section::new("Next steps", blocks)
}
