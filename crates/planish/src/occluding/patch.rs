//! Converts strips of points to surface patches.
//!
//! Input: points in strips. Output: a mesh of each strip, a fitted sheet if a spline is requested, and their
//! files.
//!
//! Not guaranteed: a strip that winds around an object is not a sheet. Strips that cannot be fitted are named
//! and skipped.

use super::{ContourPatch, OccludingJob};
use crate::output::{
    OutputFormat, OutputOptions, PlannedOutput, WrittenFile, check_outputs, plan_outputs, prepare,
};
use planish_core::{Finding, FindingCode};
use planish_core::{Progress, ProgressPart};
use planish_estimate::{ErrorKind, Result};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_mesh::TriangleMesh;
use planish_sense::occluding::{OccludingContours, OccludingPoint};
use planish_sense::{Sensor, SensorKind};
use planish_spline::Shape;
use planish_surface::export::{KnownMesh, write_known_mesh};
use planish_surface::fit::{Fit, FitOptions, fit};
use planish_surface::saved::Session;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A strip with its mesh and spline.
pub(super) struct Patch {
    mesh: TriangleMesh,
    sigma: Vec<f64>,
    spline: Option<Fit>,
    report: ContourPatch,
}

pub(super) fn patches(
    job: &OccludingJob,
    found: &OccludingContours,
    unit: Option<Unit>,
    progress: &dyn Progress,
    findings: &mut Vec<Finding>,
) -> Result<Vec<Patch>> {
    // Fits take most of the time, so meshes alone do without them.
    let splines = plan_outputs(&job.patches)?.iter().any(|p| !p.format.is_mesh());
    let mut patches: Vec<Patch> = Vec::new();
    if job.patches.is_empty() {
        return Ok(patches);
    }
    for strip in 0..found.strips {
        let of_strip: Vec<&OccludingPoint> = found.points.iter().filter(|p| p.strip == strip).collect();
        // Strips are sorted by size: all that follow are smaller.
        if of_strip.len() < job.min_points {
            break;
        }
        let Ok((mesh, sigma)) = found.patch(strip) else {
            findings.push(Finding::new(
                FindingCode::StripWithoutMesh,
                format!("strip {} of {} points has no triangles", strip + 1, of_strip.len()),
            ));
            continue;
        };
        let spline = match splines {
            false => None,
            true => {
                let [from, to] = [strip, strip + 1].map(|k| k as f64 / found.strips as f64);
                match fit(&set_of(found, strip, unit), &options(job), &ProgressPart::new(progress, from, to))
                {
                    Ok(fit) => {
                        let of = patches.len() + 1;
                        findings.extend(
                            fit.report.findings.iter().map(|f| f.clone().in_context(format!("patch {of}"))),
                        );
                        Some(fit)
                    }
                    // A strip that cannot be fitted must not discard the others.
                    Err(e) if e.kind() == ErrorKind::Interrupted => return Err(e),
                    Err(e) => {
                        findings.push(Finding::new(
                            FindingCode::StripWithoutSpline,
                            format!("strip {} of {} points has no spline: {e}", strip + 1, of_strip.len()),
                        ));
                        None
                    }
                }
            }
        };
        let mut sorted = sigma.clone();
        sorted.sort_by(f64::total_cmp);
        patches.push(Patch {
            report: ContourPatch {
                files: Vec::new(),
                points: of_strip.len(),
                views: of_strip.iter().map(|p| p.view).collect::<BTreeSet<_>>().len(),
                sigma: sorted[sorted.len() / 2],
                area: mesh.area(),
                missing_share: missing_share_of(&of_strip),
            },
            mesh,
            sigma,
            spline,
        });
    }
    Ok(patches)
}

/// Share of missing places along the contours, between the first and the last place of the strip in each.
fn missing_share_of(points: &[&OccludingPoint]) -> f64 {
    // For each contour of a view: first place, last place, and number of points.
    let mut runs: BTreeMap<(usize, usize), (usize, usize, usize)> = BTreeMap::new();
    for p in points {
        let run = runs.entry((p.view, p.contour)).or_insert((p.place, p.place, 0));
        *run = (run.0.min(p.place), run.1.max(p.place), run.2 + 1);
    }
    let all: usize = runs.values().map(|(first, last, _)| last - first + 1).sum();
    let present: usize = runs.values().map(|run| run.2).sum();
    1.0 - present as f64 / all.max(1) as f64
}

fn set_of(found: &OccludingContours, strip: usize, unit: Option<Unit>) -> ScanSet {
    ScanSet {
        unit,
        // The points have their own covariances, so the sensor states no σ.
        sensors: vec![Sensor { name: "contours".to_owned(), kind: SensorKind::Range, ..Sensor::default() }],
        scans: vec![PosedScan {
            scan: found.scan(Some(strip), &format!("strip {}", strip + 1)),
            sensor: 0,
            sigma_translation: None,
            sigma_rotation_deg: None,
        }],
        ..ScanSet::default()
    }
}

fn options(job: &OccludingJob) -> FitOptions {
    // A strip is an open band of the surface, so its topology is known.
    FitOptions { shape: Some(Shape::Sheet), seed: job.seed, ..FitOptions::default() }
}

/// `name.ply` to `name.1.ply`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let extension = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    path.with_extension(format!("{number}.{extension}"))
}

pub(super) fn written(
    job: &OccludingJob,
    patches: Vec<Patch>,
    unit: Option<Unit>,
    inputs: &[PathBuf],
) -> Result<Vec<ContourPatch>> {
    let mut reports = Vec::new();
    for (k, mut patch) in patches.into_iter().enumerate() {
        let paths: Vec<PathBuf> = job.patches.iter().map(|path| numbered(path, k + 1)).collect();
        // The number of patches was not known when outputs were checked.
        check_outputs(&paths, inputs)?;
        let (meshes, splines): (Vec<PlannedOutput>, Vec<PlannedOutput>) =
            plan_outputs(&paths)?.into_iter().partition(|p| p.format.is_mesh());
        for output in meshes {
            let mesh = &patch.mesh;
            // Every vertex is a measured point of a contour.
            let seen = vec![1; mesh.positions.len()];
            let unit = unit.unwrap_or(Unit::Millimetre);
            let (normals, sigma) = (&mesh.vertex_normals(), &patch.sigma);
            let known = KnownMesh { mesh, normals, sigma, observed: &seen, curvature: None, unit };
            write_known_mesh(&output.path, &known)?;
            patch.report.files.push(written_mesh(output.path, output.format, mesh));
        }
        if let (Some(fit), false) = (&patch.spline, splines.is_empty()) {
            let prepared = prepare(&fit.model, &fit.posterior(), &splines, &OutputOptions::default())?;
            let session = Session {
                version: env!("CARGO_PKG_VERSION").to_owned(),
                arguments: vec!["sense".to_owned(), "contours".to_owned()],
                seed: job.seed,
                inputs: Vec::new(),
            };
            patch.report.files.extend(prepared.write(&[session])?);
        }
        reports.push(patch.report);
    }
    Ok(reports)
}

fn written_mesh(file: PathBuf, format: OutputFormat, mesh: &TriangleMesh) -> WrittenFile {
    WrittenFile {
        file,
        format,
        faces: None,
        vertices: Some(mesh.positions.len()),
        triangles: Some(mesh.triangles.len()),
        // The mesh joins measured points. It approximates no surface, so it has no chord error.
        tolerance: None,
        cells: None,
        cell_size: None,
    }
}
