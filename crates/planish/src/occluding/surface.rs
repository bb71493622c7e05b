//! The surface that agrees best with all masks.
//!
//! Input: views with silhouettes. Output: a closed mesh, and the masks that contradict it.
//!
//! Like the visual hull, the surface only bounds the object: it fills hollows and is too large between views.
//! Its vertices have no σ.

use planish_core::{Finding, FindingCode};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::mesh::{Column, MeshColumns, write_mesh};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_sense::occluding::{ConsistentRegion, ContourView, SilhouetteBound};
use planish_shell::large_parts;
use serde::Serialize;
use std::path::Path;

/// Maximum number of cells along the longest side. Time and memory grow with the cube.
const MAX_CELLS: f64 = 160.0;
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
    /// Masks that contradict it.
    pub masks: Vec<MaskContradiction>,
}

/// The surface with what is written of it.
pub(super) struct ConsistentSurface {
    pub mesh: TriangleMesh,
    pub report: ConsistentSurfaceReport,
    pub findings: Vec<Finding>,
}

/// Finds the surface within a box that contains the object, if one is stated.
pub(super) fn consistent_surface(
    path: &Path,
    views: &[ContourView],
    limits: Option<BoundingBox>,
) -> Result<ConsistentSurface> {
    let closed: Vec<&ContourView> = (views.iter())
        .filter(|view| !view.silhouette.is_empty() && view.silhouette.iter().all(|c| c.closed))
        .collect();
    let bound = SilhouetteBound::new(views)?.within(limits);
    let Some(bounds) = bound.bounds() else {
        return Err(Error::undetermined(format!(
            "{}: expected silhouettes that meet in space for a surface, found none",
            path.display()
        )));
    };
    let middle = 0.5 * (bounds.min + bounds.max);
    let mut pixels: Vec<f64> = (0..bound.count()).map(|view| bound.pixel_width(view, middle)).collect();
    pixels.sort_by(f64::total_cmp);
    // Cells of a pixel: finer ones cannot follow the masks better.
    let cell = pixels[pixels.len() / 2].max(bounds.longest_side() / MAX_CELLS);
    let region = ConsistentRegion::new(bound, &bounds, cell)?;
    let mesh = large_parts(&region.mesh(&bounds)?, MIN_PART);
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
        masks,
    };
    let findings = mask_findings(&closed, &report.masks);
    Ok(ConsistentSurface { mesh, report, findings })
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
    /// Writes the mesh. Silhouettes only bound the object, so `observed` is 2 at all vertices.
    pub fn write(&self, path: &Path, unit: Option<Unit>) -> Result<()> {
        let observed = vec![2; self.mesh.positions.len()];
        write_mesh(
            path,
            &MeshColumns {
                points: &self.mesh.positions,
                triangles: &self.mesh.triangles,
                columns: vec![("observed", Column::U8(&observed))],
                unit,
                ..MeshColumns::default()
            },
        )
    }
}
