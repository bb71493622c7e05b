//! The surface that agrees best with all masks, with σ.
//!
//! Input: views with silhouettes, and the points of occluding contours. Output: a closed mesh with σ along its
//! normals, and the masks that contradict it.
//!
//! σ has two parts. One is the σ of the outlines. The other is the excess of a hull between views: a third of
//! the distance by which the surface would recede without the view of minimum depth, averaged over the
//! neighbourhood, as for rough starts of shells. Places near a contour point are observed; others are only
//! bounded by the silhouettes.

use super::box_of;
use crate::sense::{SigmaSummary, summary};
use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_sense::occluding::{
    ConsistentRegion, ContourView, OccludingContours, SilhouetteBound, near_contours,
};
use planish_shell::{large_parts, smooth_vertex_values};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Maximum number of cells along the longest side. Time and memory grow with the cube.
const MAX_CELLS: f64 = 256.0;
/// Ratio of the extra excess of a hull without one view to its excess with all views.
const EXCESS_RATIO: f64 = 3.0;
/// Number of diffusion steps of the local mean of the excess, over a radius of about ten edges.
const MEAN_STEPS: usize = 100;
/// Minimum volume of a part, relative to the largest. Smaller parts come from noise of the masks.
const MIN_PART: f64 = 0.002;
/// Minimum area of contradictions, as a share of the area of the mask, that is reported as a finding.
const MIN_CONTRADICTION: f64 = 0.005;

/// Pixels of a mask that contradict the surface.
#[derive(Debug, Clone, Serialize)]
pub struct MaskContradiction {
    /// The view.
    pub view: String,
    /// Area of its background that shows the object according to the other views, in pixels.
    pub missing_px: f64,
    /// Area of its mask that the surface does not cover, in pixels.
    pub uncovered_px: f64,
}

/// Figures of the surface.
#[derive(Debug, Clone, Serialize)]
pub struct ConsistentSurfaceReport {
    /// Number of its vertices.
    pub vertices: usize,
    /// Number of its facets.
    pub triangles: usize,
    /// Connected parts.
    pub parts: usize,
    /// Its volume.
    pub volume: Option<f64>,
    /// Volume that is outside of the visual hull.
    pub restored_volume: f64,
    /// Share of the vertices near a contour point.
    pub observed_share: f64,
    /// σ along normals.
    pub sigma: Option<SigmaSummary>,
    /// Masks that contradict it.
    pub masks: Vec<MaskContradiction>,
}

/// The surface with what is written of it.
pub(super) struct ConsistentSurface {
    pub mesh: TriangleMesh,
    sigma: Vec<f64>,
    observed: Vec<u8>,
    pub report: ConsistentSurfaceReport,
    pub findings: Vec<Finding>,
}

/// Finds the surface within a box around the points.
pub(super) fn consistent_surface(
    path: &Path,
    views: &[ContourView],
    found: &OccludingContours,
    limits: Option<BoundingBox>,
) -> Result<ConsistentSurface> {
    let closed: Vec<&ContourView> = (views.iter())
        .filter(|view| !view.silhouette.is_empty() && view.silhouette.iter().all(|c| c.closed))
        .collect();
    let (Some(bounds), true) = (box_of(found), closed.len() >= 2) else {
        return Err(Error::undetermined(format!(
            "{}: expected masks of the whole object in at least two views for a surface",
            path.display()
        )));
    };
    let bound = SilhouetteBound::new(views)?.within(limits);
    let middle = 0.5 * (bounds.min + bounds.max);
    let mut pixels: Vec<f64> = (0..bound.count()).map(|view| bound.pixel_width(view, middle)).collect();
    pixels.sort_by(f64::total_cmp);
    // Cells of a pixel: finer ones cannot follow the masks better.
    let cell = pixels[pixels.len() / 2].max(bounds.longest_side() / MAX_CELLS);
    let region = ConsistentRegion::new(bound, &bounds, cell)?;
    let mesh = large_parts(&region.mesh(&bounds)?, MIN_PART);
    let left: Vec<f64> =
        (mesh.positions.par_iter()).map(|at| region.depth_without_one(*at).max(0.0) / EXCESS_RATIO).collect();
    let mut of_outlines: Vec<f64> = (closed.iter())
        .map(|view| view.sigma_px * view.camera.center().distance(middle) / view.camera.focal_px())
        .collect();
    of_outlines.sort_by(f64::total_cmp);
    let of_outline = of_outlines[of_outlines.len() / 2];
    let excess = smooth_vertex_values(&mesh, &left, MEAN_STEPS);
    let sigma: Vec<f64> = excess.iter().map(|excess| excess.hypot(of_outline)).collect();
    let near = near_contours(&found.points, &mesh.positions, 2.0 * cell);
    let observed: Vec<u8> = near.into_iter().map(|near| if near { 1 } else { 2 }).collect();
    let masks: Vec<MaskContradiction> = (closed.iter().zip(&region.contradicted_px))
        .zip(&region.uncovered_px)
        .map(|((view, missing), uncovered)| MaskContradiction {
            view: view.name.clone(),
            missing_px: *missing,
            uncovered_px: *uncovered,
        })
        .collect();
    let report = ConsistentSurfaceReport {
        vertices: mesh.positions.len(),
        triangles: mesh.triangles.len(),
        parts: mesh.check().components,
        volume: mesh.signed_volume(),
        restored_volume: region.restored_volume(),
        observed_share: observed.iter().filter(|o| **o == 1).count() as f64 / observed.len().max(1) as f64,
        sigma: summary(sigma.clone()),
        masks,
    };
    let findings = mask_findings(&closed, &report.masks);
    Ok(ConsistentSurface { mesh, sigma, observed, report, findings })
}

/// A finding if masks show background where others show the object, or the reverse.
fn mask_findings(views: &[&ContourView], masks: &[MaskContradiction]) -> Vec<Finding> {
    let contradicting = |px: fn(&MaskContradiction) -> f64| -> Vec<String> {
        (views.iter().zip(masks))
            .filter(|(view, mask)| px(mask) > MIN_CONTRADICTION * area_px(view))
            .map(|(_, mask)| format!("{} ({:.0} pixels)", mask.view, px(mask)))
            .collect()
    };
    let missing = contradicting(|mask| mask.missing_px);
    let uncovered = contradicting(|mask| mask.uncovered_px);
    let mut findings = Vec::new();
    if !missing.is_empty() {
        findings.push(Finding::new(
            FindingCode::MasksContradictory,
            format!("masks show background where other views show the object: {}", missing.join(", ")),
        ));
    }
    if !uncovered.is_empty() {
        findings.push(Finding::new(
            FindingCode::MasksContradictory,
            format!("masks show the object where other views show background: {}", uncovered.join(", ")),
        ));
    }
    findings
}

/// The area of a silhouette by the shoelace formula; holes run the other way round.
fn area_px(view: &ContourView) -> f64 {
    let sum: f64 = (view.silhouette.iter())
        .flat_map(|c| c.places.iter().zip(c.places.iter().cycle().skip(1)))
        .map(|(p, q)| 0.5 * (p[0] * q[1] - p[1] * q[0]))
        .sum();
    sum.abs()
}

impl ConsistentSurface {
    /// Writes the mesh with σ and `observed`.
    pub fn write(&self, path: &Path, unit: Option<Unit>) -> Result<()> {
        write_mesh(
            path,
            &MeshColumns {
                points: &self.mesh.positions,
                triangles: &self.mesh.triangles,
                columns: vec![("sigma", Column::F64(&self.sigma)), ("observed", Column::U8(&self.observed))],
                unit,
                ..MeshColumns::default()
            },
        )
    }
}
