//! The report of a fit.

use crate::next::page::{next_marks, next_table};
use crate::next::{NextOptions, NextReport, next_points};
use crate::report::scenes::model_scene;
use crate::report::title_of;
use crate::report::words::{SmallUnit, sentence, with_article};
use planish_core::Silent;
use planish_estimate::{ErrorKind, Result};
use planish_report::colour::KNOWN_BY;
use planish_report::numbers::{count, counted, percent, significant};
use planish_report::{Block, Figure, Finding, FindingLevel, Page, Section, Table, plot};
use planish_surface::fit::{Fit, FitReport, FitTermination, ScanSummary};
use planish_surface::model::SensorReport;
use std::path::PathBuf;

/// Points to measure next that a report names.
const NEXT_POINTS: usize = 5;
/// Maximum normalised rms of a consistent scan.
const MAX_NORMALISED_RMS: f64 = 1.5;
/// Maximum mean residual of a scan, in σ of a reading. Beyond it, the scan is offset from the others.
const MAX_OFFSET: f64 = 0.5;
/// Maximum fraction of rejected readings of a scan. A scan is reported if it is also more than three times
/// the fraction of all scans.
const MAX_REJECTED: f64 = 0.1;
/// Fewer readings judge no scan.
const LEAST_JUDGED: usize = 30;
/// Maximum normalised rms of held-out readings for a consistent σ; its inverse is the minimum.
const MAX_HELD_OUT_RMS: f64 = 1.25;

/// The report page of a fit. `named` are the files given by the user; `report` contains the warnings of the
/// whole job.
pub(crate) fn fit_page(
    fit: &Fit,
    report: &FitReport,
    named: &[PathBuf],
    mesh_tolerance: Option<f64>,
    verb: &str,
) -> Result<Page> {
    let model_unit = fit.model.unit.name();
    let unit = SmallUnit::for_length(model_unit, report.rms.max(report.sigma.median));
    let length = |value: f64| unit.text(value);
    let (mut scene, tolerance) =
        model_scene(&fit.model, &fit.posterior(), mesh_tolerance, fit.readings.as_ref())?;
    let next = what_next(fit)?;
    if let Some(next) = &next {
        scene.marks = next_marks(&next.points, unit);
        "where to measure next".clone_into(&mut scene.marks_name);
    }
    let scans = fit.readings.as_ref().map_or(&[][..], |readings| &readings.scans);
    let mut sections = vec![went_in(report, scans, unit), how_good(fit, report, unit)];
    sections.extend(concluded(report));
    sections.push(to_do(report, next.as_ref(), model_unit, unit));
    sections.push(Section::new(
        "What is shown",
        vec![Block::Text(format!(
            "The triangles lie within {} of the surface; their vertices carry its exact position and σ. A \
             click reads the nearest of them. \
             Of the readings at most 20 000 are drawn, evenly chosen.",
            length(tolerance)
        ))],
    ));
    Ok(Page {
        job: "fit".to_owned(),
        title: title_of(named),
        headline: format!(
            "{verb} a {} of {} with {}. Half of what was measured is known to better than {}.",
            report.shape,
            counted(report.coefficients, "control vertex"),
            counted(report.observations, "reading"),
            length(report.sigma.median),
        ),
        findings: findings(report, scans, unit),
        figures: vec![
            Figure::new(
                "σ of the surface, median",
                length(report.sigma.median),
                format!("95 % below {}", length(report.sigma.p95)),
            ),
            Figure::new(
                "residuals, rms",
                length(report.rms),
                format!("{} of their σ", significant(report.rms_normalised, 3)),
            ),
            Figure::new("reduced χ²", significant(report.reduced_chi_square, 3), "1 where all σ are true"),
            Figure::new(
                "held-out readings",
                match report.held_out.n {
                    0 => "none".to_owned(),
                    _ => significant(report.held_out.rms_normalised, 3),
                },
                match report.held_out.n {
                    0 => String::new(),
                    n => format!("rms over predicted σ, of {}", count(n).replace(' ', "\u{202f}")),
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

/// Whether a scan does not fit the others, and how that shows.
fn misfit(scan: &ScanSummary, share_of_all: f64, unit: SmallUnit<'_>) -> Option<String> {
    let total = scan.used + scan.rejected;
    if total < LEAST_JUDGED {
        return None;
    }
    let share = scan.rejected as f64 / total as f64;
    let sigma = scan.rms / scan.rms_normalised.max(f64::MIN_POSITIVE);
    if share > MAX_REJECTED && share > 3.0 * share_of_all {
        Some(format!(
            "Scan {} does not fit the others: {} of its readings were rejected, {} of all. Its pose or σ \
             may be wrong, or those of the scans around it; or the thing moved.",
            scan.name,
            percent(share),
            percent(share_of_all)
        ))
    } else if scan.mean.abs() > MAX_OFFSET * sigma {
        Some(format!(
            "Scan {} lies {} off the others on average ({} σ of a reading): its pose may be off; --align \
             estimates it.",
            scan.name,
            unit.text(scan.mean),
            significant(scan.mean.abs() / sigma, 2)
        ))
    } else if scan.rms_normalised > MAX_NORMALISED_RMS {
        Some(format!(
            "Scan {} does not fit: its residuals are {} times their σ.",
            scan.name,
            significant(scan.rms_normalised, 2)
        ))
    } else {
        None
    }
}

fn share_set_aside(scans: &[ScanSummary]) -> f64 {
    let aside: usize = scans.iter().map(|scan| scan.rejected).sum();
    let all: usize = aside + scans.iter().map(|scan| scan.used).sum::<usize>();
    aside as f64 / all.max(1) as f64
}

fn findings(report: &FitReport, scans: &[ScanSummary], unit: SmallUnit<'_>) -> Vec<Finding> {
    let mut found = Vec::new();
    for sensor in &report.sensors {
        if let Some(stated) = false_sigma(sensor) {
            let text = |value: f64| match sensor.quantity.as_str() {
                "normal" => format!("{}°", significant(value, 3)),
                "curvature" => significant(value, 3),
                _ => unit.text(value),
            };
            let factor = sensor.sigma_estimated / stated;
            let times = if factor > 1.0 {
                format!("{} times as much", significant(factor, 2))
            } else {
                format!("{} of it", percent(factor))
            };
            found.push(Finding::new(
                FindingLevel::Look,
                format!(
                    "The σ of sensor “{}” is false: it states {}, its residuals say {}, {times}. The \
                     estimate was used.",
                    sensor.name,
                    text(stated),
                    text(sensor.sigma_estimated),
                ),
            ));
        }
    }
    let share = share_set_aside(scans);
    let misfits = scans.iter().filter_map(|scan| misfit(scan, share, unit));
    found.extend(misfits.map(|text| Finding::new(FindingLevel::Bad, text)));
    let held = report.held_out;
    if held.n > 0 {
        let ratio = held.rms_normalised;
        let (level, text) = if ratio > MAX_HELD_OUT_RMS {
            (
                FindingLevel::Look,
                format!(
                    "σ is too small: readings that took no part are off by {} times what it predicts.",
                    significant(ratio, 3)
                ),
            )
        } else if ratio < 1.0 / MAX_HELD_OUT_RMS {
            (
                FindingLevel::Look,
                format!(
                    "σ is too large: readings that took no part are off by only {} of what it predicts.",
                    percent(ratio)
                ),
            )
        } else {
            (
                FindingLevel::Good,
                format!(
                    "σ holds: {} that took no part are off by {} times what it predicts.",
                    counted(held.n, "reading"),
                    significant(ratio, 3)
                ),
            )
        };
        found.push(Finding::new(level, text));
    }
    // Sensors whose σ is false have been named already.
    let said = |warning: &str| warning.starts_with("sensor ") && warning.contains("states σ");
    for warning in report.warnings.iter().filter(|w| !said(w)) {
        found.push(Finding::new(FindingLevel::Look, sentence(warning)));
    }
    if report.termination == FitTermination::Converged {
        found.push(Finding::new(
            FindingLevel::Good,
            "The fit converged: only noise is left in the residuals.",
        ));
    }
    found
}

fn went_in(report: &FitReport, scans: &[ScanSummary], unit: SmallUnit<'_>) -> Section {
    let mut blocks = Vec::new();
    let share = share_set_aside(scans);
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
                misfit(scan, share, unit).is_some(),
            );
        }
        blocks.push(Block::Table(table));
    }
    let total: usize = report.rejected.values().sum();
    blocks.push(Block::Text(if total == 0 {
        "No reading was rejected.".to_owned()
    } else {
        let causes: Vec<String> =
            (report.rejected.iter()).map(|(cause, n)| format!("{} {}", count(*n), why(cause))).collect();
        format!("{} rejected: {}.", counted(total, "reading"), causes.join(", "))
    }));
    Section::new("What went in", blocks)
}

/// Causes in words.
fn why(cause: &str) -> String {
    match cause {
        "depth_edge" => "at depth edges".to_owned(),
        "grazing" => "seen at a grazing angle".to_owned(),
        "isolated" => "far from all others".to_owned(),
        "normal_mismatch" => "facing another way than the surface".to_owned(),
        "outlier" => "outliers".to_owned(),
        "beyond_border" => "beyond the border".to_owned(),
        "class" => "of other classes".to_owned(),
        "above_ground" => "above the ground".to_owned(),
        "not_finite" => "that are not finite numbers".to_owned(),
        other => other.replace('_', " "),
    }
}

fn how_good(fit: &Fit, report: &FitReport, unit: SmallUnit<'_>) -> Section {
    let mut blocks = Vec::new();
    let positions: Vec<&SensorReport> = report.sensors.iter().filter(|s| s.quantity == "position").collect();
    if positions.iter().any(|s| s.sigma_stated.is_some()) {
        let rows: Vec<(String, Option<f64>, f64)> = (positions.iter())
            .map(|s| {
                (s.name.clone(), s.sigma_stated.map(|s| unit.factor * s), unit.factor * s.sigma_estimated)
            })
            .collect();
        blocks.push(Block::Drawing {
            svg: plot::stated_and_found(&rows, unit.name),
            caption: "Each sensor's σ along the normal, as stated and as its residuals say. A line to the \
                right is a σ that is too small."
                .to_owned(),
        });
    }
    let mut table = Table::new(["sensor", "readings", "σ stated", "σ found", "rms", "used"]);
    for sensor in &report.sensors {
        let (name, factor) = match sensor.quantity.as_str() {
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
                if sensor.sigma_used_is_estimated { "found" } else { "stated" }.to_owned(),
            ],
            false_sigma(sensor).is_some(),
        );
    }
    blocks.push(Block::Table(table));
    if let Some(readings) = fit.readings.as_ref().filter(|r| !r.normalised.is_empty()) {
        blocks.push(Block::Drawing {
            svg: plot::normalised_residuals(&readings.normalised),
            caption: "Residuals of the readings over their σ (bars), and the normal distribution (line). \
                Readings beyond ±4 were rejected."
                .to_owned(),
        });
    }
    let moved: Vec<_> = report.poses.iter().filter(|p| p.moved.is_some()).collect();
    if !moved.is_empty() {
        let by = unit.head("moved");
        let sigma = unit.head("σ");
        let mut table = Table::new(["pose", &by, "turned / °", &sigma, "σ / °"]);
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
    let [grey, blue, orange] = KNOWN_BY.map(|colour| format!("#{colour:06x}"));
    blocks.push(Block::Drawing {
        svg: plot::shares(&[
            ("measured", measured, blue),
            ("completed", completed, orange),
            ("smoothness alone", (1.0 - measured - completed).max(0.0), grey),
        ]),
        caption: "What the surface is known by, of its area.".to_owned(),
    });
    if let Some(left) = &report.unresolved_shape {
        blocks.push(Block::Text(format!(
            "On {} of the area cells are too large to follow the shape: {} rms, which σ takes in.",
            percent(left.area_fraction),
            unit.text(left.rms)
        )));
    }
    Section::new("How good it is", blocks)
}

/// What was completed by what was measured elsewhere.
fn concluded(report: &FitReport) -> Option<Section> {
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
        blocks.push(Block::Text(format!("{} looked at.", counted(found.gaps.len(), "gap"))));
    }
    blocks.push(Block::Text(format!(
        "{} of the area was completed, by {} inferred from others.",
        percent(found.inferred_area_fraction),
        counted(found.pseudo_readings, "reading")
    )));
    Some(Section::new("What was completed", blocks))
}

/// The best next points to measure, or none for a model that does not support it.
fn what_next(fit: &Fit) -> Result<Option<NextReport>> {
    let options = NextOptions { count: NEXT_POINTS, ..NextOptions::default() };
    match next_points(&fit.model, &options, &Silent) {
        Ok(next) => Ok(Some(next)),
        Err(e) if matches!(e.kind(), ErrorKind::Unsupported | ErrorKind::Input) => Ok(None),
        Err(e) => Err(e),
    }
}

fn to_do(report: &FitReport, next: Option<&NextReport>, model_unit: &str, unit: SmallUnit<'_>) -> Section {
    let mut blocks = Vec::new();
    if report.sensors.iter().any(|sensor| false_sigma(sensor).is_some()) {
        blocks.push(Block::Text(
            "Correct the σ of the sensors that are marked, or leave it out so that it is estimated."
                .to_owned(),
        ));
    }
    match next {
        Some(next) if !next.points.is_empty() => {
            blocks.push(Block::Text(format!(
                "Measure here next: {} with σ {} bring the largest σ of the surface from {} to {}. \
                 They are marked in the view; the command planish next plans more.",
                counted(next.points.len(), "reading"),
                unit.text(next.sigma),
                unit.text(next.worst_sigma.before),
                unit.text(next.worst_sigma.after),
            )));
            blocks.push(Block::Table(next_table(next, model_unit, unit)));
        }
        _ => blocks.push(Block::Text(
            "This model cannot plan the next measurement: that needs a model of fit --filter global."
                .to_owned(),
        )),
    }
    Section::new("What to do next", blocks)
}
