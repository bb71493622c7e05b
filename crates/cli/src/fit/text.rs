//! The summary of `planish fit`.

use super::args::FitArgs;
use crate::lines::{Align, Lines, sensor_cells};
use crate::numbers::{count, counted, percent, significant};
use planish::FindingCode;
use planish::Unit;
use planish::animation::AnimationReport;
use planish::complete::{GapReport, SymmetryReport};
use planish::fit::{BendingReport, BodiesAndHandles, Filter, FitReport, FitTermination, FitVerdict};
use planish::fit_files::FitJobReport;
use planish::output::{OutputFormat, WrittenFile};

/// The summary of a fit.
pub fn text(args: &FitArgs, done: &FitJobReport) -> String {
    let FitJobReport { fit, unit, .. } = done;
    let mut lines = Lines::default();
    let verb = match args.update {
        None => "Fitted",
        Some(_) => "Updated",
    };
    lines.line(format!(
        "{verb} a {} of {} ({}, {}) with {}.",
        fit.topology,
        counted(fit.coefficients, "control vertex"),
        counted(fit.levels, "level"),
        counted(fit.cells, "cell"),
        counted(fit.observations, "reading"),
    ));
    lines.gap();
    facts(&mut lines, args, done);
    // σ of the surface, printed above, already contains this part; without the line it would look like noise.
    if let Some(left) = &fit.unresolved_shape {
        lines.line(format!(
            "Unresolved shape: on {} of the area the cells are too large ({} {unit} rms, included in σ)",
            percent(left.area_fraction),
            significant(left.rms, 3)
        ));
    }
    completion(&mut lines, fit, *unit);
    rejected(&mut lines, fit);
    sensors(&mut lines, fit, *unit);
    lines.poses(&fit.poses, *unit);
    lines.gap();
    written(&mut lines, args, done);
    lines.into_text()
}

/// Residuals, σ and the end of the fit.
fn facts(lines: &mut Lines, args: &FitArgs, done: &FitJobReport) {
    let FitJobReport { fit, unit, .. } = done;
    let length = |value: f64| format!("{} {unit}", significant(value, 3));
    // An empty text omits the line: only an update has readings of earlier sessions.
    let all_readings =
        args.update.as_ref().map_or(String::new(), |_| count(done.observations_of_all_sessions));
    let residuals = format!(
        "rms {}; normalised rms {} (reduced χ² {})",
        length(fit.rms),
        significant(fit.rms_normalised, 3),
        significant(fit.reduced_chi_square, 3)
    );
    let held_out = match fit.held_out.n {
        0 => "none".to_owned(),
        n => format!(
            "{}; normalised rms {} (1 if σ is correct)",
            counted(n, "reading"),
            significant(fit.held_out.rms_normalised, 3)
        ),
    };
    // An empty text omits the line: most surfaces are smooth.
    let edges = fit.creases.map_or(String::new(), |edges| {
        format!(
            "length {}; σ of their position median {}, largest {}",
            length(edges.length),
            length(edges.sigma_median),
            length(edges.sigma_max)
        )
    });
    let sigma = format!(
        "median {}, 95 % below {}, largest {}",
        length(fit.sigma.median),
        length(fit.sigma.p95),
        length(fit.sigma.max)
    );
    lines.facts([
        ("readings of all sessions", all_readings),
        // Residuals judge the fit by the readings it used; the held-out readings after them are independent
        // of it.
        ("residuals", residuals),
        ("held out", held_out),
        ("σ of the surface", sigma),
        ("topology", topology(fit, *unit)),
        ("sharp edges", edges),
        ("measured", format!("{} of the area", percent(fit.observed_area_fraction))),
        ("subdivided", subdivided(fit)),
        ("termination", termination(fit).to_owned()),
    ]);
}

/// How steadily the readings show the topology; empty if it does not come from them.
fn topology(fit: &FitReport, unit: Unit) -> String {
    let Some(margin) = &fit.topology_margin else { return String::new() };
    let other = |name: &str, other: Option<BodiesAndHandles>| {
        other.map_or(String::new(), |other| {
            let numbers = [counted(other.components, "body"), counted(other.genus, "handle")].join(" and ");
            format!("; {numbers} with {name} smoothing")
        })
    };
    let [from, to] = margin.smoothing;
    format!(
        "the same if the readings are smoothed over {} to {} {unit}{}{}",
        significant(from, 2),
        significant(to, 2),
        other("weaker", margin.weaker),
        other("stronger", margin.stronger)
    )
}

/// The files that were written.
fn written(lines: &mut Lines, args: &FitArgs, done: &FitJobReport) {
    if done.written.is_empty() && done.animation.is_none() && args.page.report.is_none() {
        lines.line(
            "Nothing was written: add -o part.step, -o part.ply or -o part.planish to keep the result.",
        );
    }
    for file in &done.written {
        lines.line(format!("Wrote {}: {}", file.file.display(), contents(file, done.unit)));
    }
    if let Some(AnimationReport { file, readings, .. }) = &done.animation {
        let [first, last] = [readings.first(), readings.last()].map(|n| count(n.copied().unwrap_or(0)));
        lines.line(format!(
            "Wrote {}: {} of the model forming, from {first} to {last} readings",
            file.display(),
            counted(readings.len(), "frame")
        ));
    }
    if let Some(written) = args.page.written() {
        lines.line(written);
    }
}

/// The cells that were subdivided, by level and cause.
fn subdivided(fit: &FitReport) -> String {
    let what = match fit.filter {
        Filter::Global => "cell",
        Filter::Patch => "patch",
    };
    let levels: Vec<String> = (fit.refined.iter())
        .map(|level| {
            let causes: Vec<String> = level.causes.iter().map(|(cause, n)| format!("{n} {cause}")).collect();
            let number = counted(level.divided, what);
            format!("{number} of level {} ({})", level.level, causes.join(", "))
        })
        .collect();
    if levels.is_empty() { "nothing".to_owned() } else { levels.join("; ") }
}

/// The reason why the fit ended.
fn termination(fit: &FitReport) -> &'static str {
    match (fit.verdict, fit.termination) {
        (FitVerdict::Refused, _) => "kept by --force: the surface does not follow much of its readings",
        (FitVerdict::Unresolved, _) => "the surface does not follow its readings everywhere",
        _ => limit_or_noise(fit),
    }
}

/// The reason why a fit ended whose surface follows its readings.
fn limit_or_noise(fit: &FitReport) -> &'static str {
    match fit.termination {
        // The job has judged the number of rejected readings; a second threshold here could disagree with its
        // warning.
        FitTermination::Converged
            if fit.findings.iter().any(|finding| finding.code == FindingCode::ManyRejected) =>
        {
            "converged, but many readings were rejected"
        }
        FitTermination::Converged => "converged: only noise remains",
        FitTermination::ReachedTolerance => "reached the tolerance",
        FitTermination::Limit => "limit of control vertices or iterations reached",
    }
}

/// What was completed, and how.
fn completion(lines: &mut Lines, fit: &FitReport, unit: Unit) {
    let Some(found) = &fit.propagation else { return };
    lines.gap();
    if let Some(symmetry) = &found.symmetry {
        lines.line(symmetry_line(symmetry, unit));
    }
    if let Some(motion) = &found.motion {
        let pair =
            |[value, sigma]: [f64; 2]| format!("{} ± {}", significant(value, 5), significant(sigma, 2));
        lines.line(format!(
            "Motion: rotation {}°/s, velocity of the centre {} {unit}/s, from {}.",
            pair(motion.rate_deg_per_s),
            pair(motion.speed),
            counted(motion.poses.len(), "scan")
        ));
        // Without a symmetry and without gaps, nothing was completed.
        if found.symmetry.is_none() && found.gaps.is_empty() {
            return;
        }
    }
    if let Some(bending) = &found.bending {
        // `--motion bend` excludes symmetries and filled gaps, so nothing of what follows can apply.
        return bending_states(lines, bending, unit);
    }
    for gap in found.gaps.iter().take(GAPS_SHOWN) {
        lines.line(gap_line(gap, unit));
    }
    if found.gaps.len() > GAPS_SHOWN {
        lines.line(format!("Gaps: {} more, see --json.", found.gaps.len() - GAPS_SHOWN));
    }
    lines.line(format!(
        "Completed: {} of the area, from {} inferred from others.",
        percent(found.inferred_area_fraction),
        counted(found.pseudo_readings, "reading")
    ));
}

/// A table of the states of a bending sheet: residuals, and how well lengths were kept.
fn bending_states(lines: &mut Lines, bending: &BendingReport, unit: Unit) {
    let rows: Vec<Vec<String>> = (bending.states.iter().enumerate())
        .map(|(k, state)| {
            // E, F and G are the coefficients of the first fundamental form. An isometry changes none of
            // them.
            let [e, f, g] = state.largest_change.map(|change| significant(100.0 * change, 2));
            vec![
                state.time_s.map_or((k + 1).to_string(), |time| format!("{time} s")),
                count(state.observations),
                significant(state.rms, 3),
                significant(state.sigma, 3),
                // Changes are measured from the first state, so it has none.
                if k == 0 { "reference".to_owned() } else { format!("{e}, {f}, {g}") },
                percent(state.carried_area_fraction),
                if state.isometric { "yes" } else { "no" }.to_owned(),
            ]
        })
        .collect();
    lines.table(
        &[
            ("state", Align::Left),
            ("readings", Align::Right),
            (&format!("rms / {unit}"), Align::Right),
            ("σ", Align::Right),
            ("max change of E, F, G / %", Align::Right),
            ("transferred", Align::Right),
            ("isometric", Align::Left),
        ],
        &rows,
    );
}

/// Number of gaps that are listed; the JSON object has all.
const GAPS_SHOWN: usize = 6;

fn gap_line(gap: &GapReport, unit: Unit) -> String {
    let area = format!("Gap of {} {unit}²", significant(gap.area, 3));
    let shape = match (gap.kind.as_str(), gap.radius) {
        ("none", _) => {
            return format!(
                "{area}: its surroundings fit no plane, sphere or cylinder; filled by the smoothness prior."
            );
        }
        (kind, Some([r, sigma])) => {
            format!("a {kind} of radius {} ± {} {unit}", significant(r, 4), significant(sigma, 2))
        }
        (kind, None) => format!("a {kind}"),
    };
    format!(
        "{area}: {shape}, from {} around it (reduced χ² {}, probability {}).",
        counted(gap.readings, "reading"),
        // A gap with a shape always has these figures; NaN would make a missing one visible.
        significant(gap.reduced_chi_square.unwrap_or(f64::NAN), 3),
        significant(gap.probability.unwrap_or(f64::NAN), 2)
    )
}

fn symmetry_line(found: &SymmetryReport, unit: Unit) -> String {
    if !found.is_found() {
        return "Symmetry: none supported by the readings.".to_owned();
    }
    let what = match (found.kind.as_str(), found.order) {
        ("mirror", _) => "a mirror plane".to_owned(),
        (_, Some(order)) => format!("a rotation of order {order}"),
        (_, None) => "a surface of revolution".to_owned(),
    };
    let proposed = if found.proposed { ", proposed" } else { "" };
    // The largest σ of the axes: a mean would promise too much for the worst direction.
    let largest = |values: &[f64]| values.iter().fold(0.0, |a: f64, b| a.max(*b));
    format!(
        "Symmetry: {what}{proposed}; {} of {} pieces of the cloud agree; σ of its position {} {unit}, of its \
         direction {}°.",
        count(found.agreeing),
        count(found.compared),
        significant(largest(&found.sigma_point), 2),
        significant(largest(&found.sigma_direction_deg), 2)
    )
}

/// A table of the rejected readings by cause.
fn rejected(lines: &mut Lines, fit: &FitReport) {
    let total: usize = fit.rejected.values().sum();
    lines.gap();
    if total == 0 {
        lines.line("Rejected: no readings.");
        return;
    }
    // Held-out readings are neither used nor rejected.
    let all = (total + fit.observations + fit.held_out.n) as f64;
    let mut causes: Vec<(&String, usize)> = fit.rejected.iter().map(|(cause, n)| (cause, *n)).collect();
    // The sort is stable: causes with equal counts keep their alphabetical order.
    causes.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
    let rows: Vec<Vec<String>> = causes
        .into_iter()
        .map(|(cause, n)| vec![cause.replace('_', " "), count(n), percent(n as f64 / all)])
        .collect();
    lines.table(&[("rejected", Align::Left), ("readings", Align::Right), ("share", Align::Right)], &rows);
}

/// A table of the sensors and their σ.
fn sensors(lines: &mut Lines, fit: &FitReport, unit: Unit) {
    lines.gap();
    lines.line(format!("Sensors, along the surface normals, in {unit}:"));
    let rows: Vec<Vec<String>> = fit
        .sensors
        .iter()
        .map(|sensor| {
            let mut cells = sensor_cells(sensor).to_vec();
            cells.push(significant(sensor.rms, 3));
            cells
        })
        .collect();
    lines.table(
        &[
            ("sensor", Align::Left),
            ("readings", Align::Right),
            ("σ stated", Align::Right),
            ("estimated", Align::Right),
            ("used", Align::Left),
            ("rms residual", Align::Right),
        ],
        &rows,
    );
}

/// A description of a written file.
fn contents(file: &WrittenFile, unit: Unit) -> String {
    match file.format {
        // STEP holds the B-spline itself, so there is no chord error to report.
        OutputFormat::Step => {
            format!("the exact surface in {}", counted(file.faces.unwrap_or(0), "B-spline face"))
        }
        OutputFormat::Ply | OutputFormat::Obj | OutputFormat::Stl | OutputFormat::Glb => {
            // OBJ and STL have no place for values of vertices.
            let with = match file.format {
                OutputFormat::Ply | OutputFormat::Glb => ", with σ",
                _ => "",
            };
            format!(
                "{} within {} {unit} of the surface{with}",
                counted(file.triangles.unwrap_or(0), "triangle"),
                significant(file.tolerance.unwrap_or(f64::NAN), 2)
            )
        }
        OutputFormat::Tiff => {
            let [columns, rows, known] = file.cells.unwrap_or_default();
            format!(
                "heights and their σ in {columns} × {rows} cells of {} {unit}, {} known",
                significant(file.cell_size.unwrap_or(f64::NAN), 3),
                // The divisor is at least 1, because the cells are zero if the file reports none.
                percent(known as f64 / (columns * rows).max(1) as f64)
            )
        }
        OutputFormat::Planish => "the model with its covariance".to_owned(),
    }
}
