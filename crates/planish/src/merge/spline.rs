//! Fits one spline surface to a merged mesh.
//!
//! Input: a merged mesh with one large part. Output: a hierarchical spline through its vertices, with the σ
//! of the mesh. Not guaranteed: detail finer than σ of the mesh; the report contains the deviations of the
//! surface from the vertices.
//!
//! Errors of neighbouring vertices are correlated, because they come from the same readings. Fused as
//! independent readings, they would make σ of the surface far too small. The information of the fit is
//! therefore divided by the median of `σ_mesh² / σ_fit²`, which does not change the mean. The rest of a
//! cell's variance is stored as the variance of that cell.

use super::Merged;
use crate::compare::feet_on;
use crate::output::{OutputOptions, PlannedOutput, WrittenFile, prepare};
use planish_core::{DVec3, Finding, FindingCode};
use planish_core::{Progress, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::{PosedScan, ScanSet};
use planish_mesh::{TriangleMesh, quantile_of_sorted};
use planish_sense::{Scan, Sensor, SensorKind};
use planish_surface::fit::{FitOptions, fit};
use planish_surface::model::sigmas_along;
use planish_surface::model::{SigmaSummary, SurfaceModel, SurfaceTopology};
use planish_surface::saved::Session;
use serde::Serialize;

/// The figures of a spline through a merged mesh.
#[derive(Debug, Clone, Serialize, PartialEq)]
pub struct SplineReport {
    /// The topology.
    #[serde(flatten)]
    pub topology: SurfaceTopology,
    /// Control vertices.
    pub coefficients: usize,
    /// Levels of the hierarchy.
    pub levels: usize,
    /// Root mean square of the distances of the mesh's vertices from the surface.
    pub rms: f64,
    /// Quantiles of σ of the surface at the mesh's vertices.
    pub sigma: SigmaSummary,
    /// Factor by which the variances of a fit of independent vertices were multiplied.
    pub variance_factor: f64,
}

/// A merged surface as a model.
#[derive(Debug, Clone)]
pub struct MergedSpline {
    /// The model, with the σ of the mesh.
    pub model: SurfaceModel,
    /// Its figures.
    pub report: SplineReport,
    /// Warnings for the user.
    pub findings: Vec<Finding>,
}

/// Maximum share of the triangles in a part that is ignored. Small parts are fragments of scanning. Dropping
/// a larger one would lose a part of the object, so it is an error.
const MAX_IGNORED_PART: f64 = 0.01;

/// The largest part of a mesh, a mask of its vertices, and the number of ignored parts.
fn largest_part(mesh: &TriangleMesh) -> Result<(TriangleMesh, Vec<bool>, usize)> {
    let parts = mesh.parts();
    let count = parts.iter().max().map_or(0, |last| *last as usize + 1);
    let second = parts.iter().filter(|part| **part == 1).count();
    if second as f64 > MAX_IGNORED_PART * parts.len() as f64 {
        return Err(Error::unsupported(format!(
            "expected a merged surface of one part for a spline, found {count} (the second has {second} of \
             {} triangles): write a mesh, or merge the patches of one part only",
            parts.len()
        )));
    }
    let mut largest = mesh.clone();
    let mut part_of = parts.iter();
    largest.triangles.retain(|_| part_of.next() == Some(&0));
    let mut in_part = vec![false; mesh.positions.len()];
    for v in largest.triangles.iter().flatten() {
        in_part[*v as usize] = true;
    }
    Ok((largest, in_part, count.saturating_sub(1)))
}

/// One hierarchical surface through the vertices of a merged mesh: a sheet, a tube or a closed surface with
/// as many handles as its vertices show. Small parts beside the largest are omitted, with a finding; another
/// one reports handles of the mesh that the surface does not have.
///
/// # Errors
/// `Unsupported` for a mesh of several parts; otherwise those of [`fit`].
pub fn merged_spline(merged: &Merged, seed: u64, progress: &dyn Progress) -> Result<MergedSpline> {
    let (largest, in_part, other_parts) = largest_part(&merged.mesh)?;
    let mut findings = Vec::new();
    if other_parts > 0 {
        findings.push(Finding::new(
            FindingCode::SplinePartsOmitted,
            format!("the spline omits {other_parts} small parts of the merged surface"),
        ));
    }
    let check = largest.check();
    // χ = 2 − 2g − b.
    let handles = (2 - check.euler_characteristic - check.boundary_loops as i64) / 2;
    let vertices = Vertices::new(merged, &in_part);
    let fitted = fit(&vertices.as_scan(merged), &spline_options(seed), progress)?;
    let own = fitted.report.topology.genus;
    if own as i64 != handles {
        let text = format!(
            "the merged surface has {handles} handles (or tunnels between its seams), but the spline has \
             {own}: compare it with the mesh there"
        );
        findings.push(Finding::new(FindingCode::SplineHandlesOmitted, text));
    }
    let mut model = fitted.model;
    let carried = carry_sigma(&mut model, &vertices)?;
    findings.extend(fitted.report.findings);
    Ok(MergedSpline {
        model,
        report: SplineReport {
            topology: fitted.report.topology,
            coefficients: fitted.report.coefficients,
            levels: fitted.report.levels,
            rms: carried.rms,
            sigma: carried.sigma,
            variance_factor: carried.factor,
        },
        findings,
    })
}

fn spline_options(seed: u64) -> FitOptions {
    // Nothing is held out: vertices are not independent readings and cannot judge σ.
    FitOptions { seed, held_out_share: 0.0, ..FitOptions::default() }
}

/// The vertices of a mesh that were measured.
struct Vertices {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    sigma: Vec<f64>,
}

impl Vertices {
    fn new(merged: &Merged, in_part: &[bool]) -> Self {
        let measured: Vec<usize> =
            // Filled holes are not data. The spline closes them by its own smoothness.
            (0..in_part.len()).filter(|&v| in_part[v] && merged.observed[v] == 1).collect();
        let selected = |values: &[DVec3]| measured.iter().map(|&v| values[v]).collect();
        Self {
            points: selected(&merged.mesh.positions),
            normals: selected(&merged.normals),
            sigma: measured.iter().map(|&v| merged.sigma[v]).collect(),
        }
    }

    fn as_scan(&self, merged: &Merged) -> ScanSet {
        ScanSet {
            unit: Some(merged.report.unit),
            sensors: vec![Sensor {
                name: "merged patches".to_owned(),
                kind: SensorKind::Range,
                ..Sensor::default()
            }],
            scans: vec![PosedScan {
                scan: Scan {
                    name: "merged mesh".to_owned(),
                    points: self.points.clone(),
                    sigma: Some(self.sigma.clone()),
                    normals: Some(self.normals.clone()),
                    ..Scan::default()
                },
                sensor: 0,
                sigma_translation: None,
                sigma_rotation_deg: None,
            }],
            ..ScanSet::default()
        }
    }
}

/// Result of [`carry_sigma`].
struct CarriedSigma {
    /// Root mean square distance of the vertices from the surface.
    rms: f64,
    /// σ of the resulting surface at the vertices.
    sigma: SigmaSummary,
    /// Factor of the variances of the fit.
    factor: f64,
}

/// Gives a model that was fitted with independent vertices the σ of the vertices.
fn carry_sigma(model: &mut SurfaceModel, vertices: &Vertices) -> Result<CarriedSigma> {
    let Vertices { points, normals, sigma } = vertices;
    // It was estimated from residuals of vertices taken as independent. Below, it is replaced by the excess
    // of σ of the mesh.
    model.excess_variance.clear();
    let feet = feet_on(&model.surface, points, |k| normals[k])?;
    let inside: Vec<usize> = (0..feet.len()).filter(|&k| !feet[k].at_border).collect();
    let leaf: Vec<u32> = inside.iter().map(|&k| feet[k].leaf).collect();
    let local: Vec<[f64; 2]> = inside.iter().map(|&k| feet[k].local).collect();
    let along: Vec<DVec3> = inside.iter().map(|&k| feet[k].normal).collect();
    let of_fit = sigmas_along(&model.posterior()?, &leaf, &local, &along)?;
    let mut ratios: Vec<f64> = (inside.iter().zip(&of_fit))
        .map(|(&k, own)| (sigma[k] / own).powi(2))
        .filter(|ratio| ratio.is_finite())
        .collect();
    if ratios.is_empty() {
        return Err(Error::undetermined(
            "expected vertices of the merged mesh near the spline, found none: write a mesh",
        ));
    }
    ratios.sort_by(f64::total_cmp);
    // The median ignores borders and seams. It is never below 1: the fit must not claim more information than
    // it has.
    let factor = quantile_of_sorted(&ratios, 0.5).max(1.0);
    let known = model.known.information_mut();
    // Information and right-hand side are divided alike, so the surface stays where it is.
    for information in known.into_iter().flat_map(|known| [&mut known.prior, &mut known.data]) {
        for value in information.values_mut() {
            *value /= factor;
        }
        for value in information.vector_mut() {
            *value /= factor;
        }
    }
    model.smoothness_weight /= factor;
    // Per cell: squared distances, and the variance of the mesh beyond that of the fit.
    let mut beyond = vec![[0.0; 2]; model.observed.len()];
    let mut square = 0.0;
    for (j, &k) in inside.iter().enumerate() {
        let off = (points[k] - feet[k].jet.point).dot(along[j]);
        square += off * off;
        let sums = &mut beyond[leaf[j] as usize];
        sums[0] += sigma[k] * sigma[k] + off * off - factor * of_fit[j] * of_fit[j];
        sums[1] += 1.0;
    }
    model.excess_variance = beyond.iter().map(|[sum, n]| (sum / n.max(1.0)).max(0.0)).collect();
    // All variances of the coefficients are the fit's times the factor; each cell adds its own.
    let now = (of_fit.iter().zip(&leaf))
        .map(|(own, leaf)| (factor * own * own + model.excess_variance[*leaf as usize]).sqrt());
    Ok(CarriedSigma {
        rms: (square / inside.len() as f64).sqrt(),
        sigma: SigmaSummary::from_values(now.collect()),
        factor,
    })
}

/// Writes the model as STEP or as a saved model.
pub(super) fn write_spline(
    spline: &MergedSpline,
    outputs: &[PlannedOutput],
    provenance: &[Session],
    progress: &dyn Progress,
) -> Result<Vec<WrittenFile>> {
    let posterior = spline.model.posterior()?;
    let prepared = prepare(&spline.model, &posterior, outputs, &OutputOptions::default())?;
    progress.check(WRITING_STAGE, 0.97)?;
    prepared.write(provenance)
}
