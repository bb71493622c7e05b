//! From strips of points to patches of surface.
//!
//! Comes in: points in strips. Goes out: a fitted sheet of each strip, and its files.
//!
//! Not guaranteed: strips of which no sheet can be made are named and left out.

use super::{ContourPatch, OccludingJob};
use crate::fit::{Fit, FitOptions, fit};
use crate::output::{OutputOptions, plan_outputs, prepare};
use crate::progress::{Part, Progress};
use crate::saved::Session;
use planish_estimate::{ErrorKind, Result};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_sense::occluding::OccludingContours;
use planish_sense::{Sensor, SensorKind};
use planish_spline::Shape;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A strip and what was fitted to it.
pub(super) struct Fitted {
    fit: Fit,
    points: usize,
    views: usize,
}

pub(super) fn fitted(
    job: &OccludingJob,
    found: &OccludingContours,
    unit: Option<Unit>,
    progress: &dyn Progress,
    warnings: &mut Vec<String>,
) -> Result<Vec<Fitted>> {
    let mut fits = Vec::new();
    for strip in 0..found.strips {
        let share = strip as f64 / found.strips as f64;
        let part = Part::new(progress, share, (strip + 1) as f64 / found.strips as f64);
        let of_strip: Vec<_> = found.points.iter().filter(|p| p.strip == strip).collect();
        if of_strip.len() < job.least_points {
            break;
        }
        let scan = found.scan(Some(strip), &format!("strip {}", strip + 1));
        let set = ScanSet {
            unit,
            sensors: vec![Sensor {
                name: "contours".to_owned(),
                kind: SensorKind::Range,
                ..Sensor::default()
            }],
            scans: vec![PosedScan {
                scan,
                sensor: 0,
                sigma_translation: None,
                sigma_rotation_deg: None,
            }],
            ..ScanSet::default()
        };
        let options = FitOptions {
            shape: Some(Shape::Sheet),
            seed: job.seed,
            ..FitOptions::default()
        };
        match fit(&set, &options, &part) {
            Ok(fit) => {
                warnings.extend(
                    fit.report
                        .warnings
                        .iter()
                        .map(|w| format!("patch {}: {w}", fits.len() + 1)),
                );
                fits.push(Fitted {
                    fit,
                    points: of_strip.len(),
                    views: of_strip.iter().map(|p| p.view).collect::<BTreeSet<_>>().len(),
                });
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => return Err(e),
            Err(e) => warnings.push(format!(
                "strip {} of {} points made no patch: {e}",
                strip + 1,
                of_strip.len()
            )),
        }
    }
    Ok(fits)
}

/// `name.ply` to `name.1.ply`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    path.with_extension(format!("{number}.{extension}"))
}

pub(super) fn written(job: &OccludingJob, fits: &[Fitted], inputs: &[PathBuf]) -> Result<Vec<ContourPatch>> {
    let mut patches = Vec::new();
    for (k, fitted) in fits.iter().enumerate() {
        let paths: Vec<PathBuf> = job.patches.iter().map(|path| numbered(path, k + 1)).collect();
        let outputs = plan_outputs(&paths, inputs)?;
        let fit = &fitted.fit;
        let prepared = prepare(&fit.model, &fit.posterior(), &outputs, &OutputOptions::default())?;
        let session = Session {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            arguments: vec!["sense".to_owned(), "contours".to_owned()],
            seed: job.seed,
            inputs: Vec::new(),
        };
        patches.push(ContourPatch {
            files: prepared.write(&[session])?,
            points: fitted.points,
            views: fitted.views,
            sigma: fit.report.sigma.median,
            rms_normalised: fit.report.rms_normalised,
            observed_area_fraction: fit.report.observed_area_fraction,
        });
    }
    Ok(patches)
}
