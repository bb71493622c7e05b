//! Prepares a rough start for a fit to masks: the mesh grows where masks are not covered, and is cut where
//! they show background.
//!
//! Input: a closed mesh and views with masks. Output: a closed mesh within all silhouettes that covers them
//! as far as the cell size permits, and σ of its vertices.
//!
//! A deformation cannot change the topology. A ball that is deformed into a body with a tail keeps a web
//! between them, which outlines pull to both sides. This module therefore rebuilds the mesh in several rounds
//! ([`remesh`]): within all silhouettes, and larger where a mask is not covered. Finally it fills the
//! surrounding domain that the silhouettes leave. The fit starts from the result.
//!
//! Surface that no line of sight touches is at the limit of the silhouettes. Without the view that limits it,
//! a vertex would be farther out by `δ`. For views at equal angles, the excess of the visual hull grows with
//! the square of the angle between views. Without one view this angle doubles, so the excess is four times as
//! large, and `δ` is three times the original excess. σ of the start is the local mean of `δ / 3`.
//!
//! Not guaranteed: parts thinner than a cell, and parts that are cut by masks with gross errors, are lost.
//! The mesh may fall apart. σ does not cover hollows, which silhouettes cannot show.

use super::input::{Frame, FrameFiles, Units};
use super::{FlowReport, ShellFitJob, overlap};
use crate::occluding::contour_view;
use planish_core::{DVec3, Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::textured::TexturedMesh;
use planish_exchange::views::ViewFile;
use planish_mesh::TriangleMesh;
use planish_sense::occluding::{ContourView, SilhouetteBound, outlines};
use planish_sense::{Image, SilhouetteOptions};
use planish_shell::covered_pixels;
use planish_shell::{Region, RemeshOptions, ShellFitOptions, remesh, smooth_vertex_values};
use rayon::prelude::*;

/// Cells along the mesh's diagonal. Finer cells keep thinner parts; time and memory grow with their number
/// squared and more. The test `rough_start` guards these settings with a bow that a deformed ball cannot
/// reach.
const CELLS: f64 = 100.0;
/// Growth of the mesh in one round, in cells. Larger steps need fewer rounds, but overshoot into room that
/// only other views exclude.
const FLOW_CELLS: f64 = 10.0;
/// Distance from the covered region, in cells, beyond which a place counts as uncovered.
const UNCOVERED_CELLS: f64 = 0.5;
/// Minimum volume of a part, relative to the largest. Smaller parts are artefacts of the cuts.
const MIN_PART: f64 = 0.002;
/// Maximum number of rounds.
const MAX_ROUNDS: usize = 30;
/// Minimum gain of a round in the mean overlap with the masks. The flow ends below it, because further rounds
/// change hardly any pixel.
const MIN_GAIN: f64 = 1e-3;
/// Final growth into the domain that the silhouettes leave, in cells.
const FILL_CELLS: f64 = 8.0;
/// Smoothing passes after each round. They remove the steps that rounds leave.
const SMOOTHINGS: usize = 20;
/// Number of diffusion steps of the local mean. n steps average over a radius of about √n edges.
const MEAN_STEPS: usize = 100;
/// Ratio of the extra excess without one view to the excess with all views (derived in the module
/// documentation).
const EXCESS_RATIO: f64 = 3.0;
/// Initial softness of the field of the fit, relative to the mesh's size. Coarser fields pull thin parts
/// together.
const SOFTNESS: f64 = 0.003;

/// Silhouettes widened by a distance.
struct WidenedSilhouettes {
    silhouettes: SilhouetteBound,
    by: f64,
}

impl Region for WidenedSilhouettes {
    fn depth(&self, at: DVec3) -> f64 {
        self.silhouettes.depth(at) + self.by
    }

    fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool {
        self.silhouettes.may_contain_boundary(at, reach + self.by)
    }
}

/// A mask in which nothing is covered.
struct EmptyMask;

impl Region for EmptyMask {
    fn depth(&self, _at: DVec3) -> f64 {
        f64::NEG_INFINITY
    }

    fn may_contain_boundary(&self, _at: DVec3, _reach: f64) -> bool {
        false
    }
}

/// The result of the flow.
pub(super) struct RoughStartMesh {
    pub mesh: TriangleMesh,
    /// σ of its vertices, along normals.
    pub sigma: Vec<f64>,
    pub report: FlowReport,
}

/// Options for fitting a prepared mesh of a given size. The mesh is already close, and its agreement with the
/// masks is no evidence, because it was made from them.
pub(super) fn options(size: f64) -> ShellFitOptions {
    let defaults = ShellFitOptions::default();
    ShellFitOptions {
        softness: (SOFTNESS, defaults.softness.1),
        // Few steps, because the start is near: coarse fields only serve to find a distant object.
        steps: 2,
        start_sigma: Some(size / CELLS),
        ..defaults
    }
}

/// The starting mesh of the fit. `watch` is called with the number of finished rounds before each round.
///
/// # Errors
/// Errors of `watch`; `Input` for views whose masks cannot be read; `Undetermined` for fewer than two masks
/// that contain the whole object, for an open mesh, and for a mesh outside of a mask.
pub(super) fn rough_start_mesh(
    job: &ShellFitJob,
    mut mesh: TriangleMesh,
    units: &mut Units,
    watch: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<RoughStartMesh> {
    let files = FrameFiles { silhouettes: job.silhouettes.clone(), ..FrameFiles::default() };
    // The findings of this reading are dropped, because the fit reads the views again.
    let frame = Frame::read(job, &files, &mesh, units, &mut Vec::new())?;
    let (views, files) = views_of(&frame)?;
    let domain = WidenedSilhouettes { silhouettes: SilhouetteBound::new(&views)?, by: 0.0 };
    let cameras: Vec<_> = frame.views.iter().map(|view| view.camera).collect();
    let agreement = |mesh: &TriangleMesh| {
        let iou = overlap(&frame, mesh, &cameras);
        let fitted = files.iter().filter_map(|view| iou.get(&view.name)).sum::<f64>();
        (fitted / files.len().max(1) as f64, iou)
    };
    let remeshed = |mesh: &TriangleMesh, flow: Option<(&dyn Region, f64)>, cell: f64| {
        let options = RemeshOptions {
            domain: &domain,
            flow: flow.map(|(covered, cells)| (covered, cells * cell)),
            cell,
            min_part_volume_ratio: MIN_PART,
            smoothing_passes: SMOOTHINGS,
        };
        remesh(mesh, &options).map_err(|e| e.in_context(job.mesh.display()))
    };
    let mut cell = size(&mesh) / CELLS;
    // First cut to the silhouettes. Only then does a gain in overlap mean growth.
    mesh = remeshed(&mesh, None, cell)?;
    let (mut mean, _) = agreement(&mesh);
    let mut rounds = 1;
    while rounds < MAX_ROUNDS {
        watch(rounds)?;
        // The mesh may grow. Cells grow with it, so that the cost of a round stays bounded.
        cell = cell.max(size(&mesh) / CELLS);
        let covered = WidenedSilhouettes {
            silhouettes: SilhouetteBound::new(&covers(&mesh, &views, &files, &frame)?)?,
            by: UNCOVERED_CELLS * cell,
        };
        let next = remeshed(&mesh, Some((&covered, FLOW_CELLS)), cell)?;
        let (after, _) = agreement(&next);
        rounds += 1;
        let gain = after - mean;
        // A round that loses overlap is discarded.
        if gain > 0.0 {
            (mesh, mean) = (next, after);
        }
        if gain < MIN_GAIN {
            break;
        }
    }
    // Partly covered places end in steps. Filling removes them.
    mesh = remeshed(&mesh, Some((&EmptyMask, FILL_CELLS)), cell)?;
    let left: Vec<f64> = (mesh.positions.par_iter())
        .map(|at| domain.silhouettes.depth_without_one(*at).max(0.0) / EXCESS_RATIO)
        .collect();
    Ok(RoughStartMesh {
        report: FlowReport {
            // The final filling is a round as well.
            rounds: rounds + 1,
            facets: mesh.triangles.len(),
            parts: mesh.check().components,
            iou: agreement(&mesh).1,
        },
        sigma: smooth_vertex_values(&mesh, &left, MEAN_STEPS),
        mesh,
    })
}

fn size(mesh: &TriangleMesh) -> f64 {
    mesh.surface_bounds().map_or(0.0, |bounds| bounds.diagonal())
}

/// The views that are fitted, as silhouettes and as files.
fn views_of(frame: &Frame) -> Result<(Vec<ContourView>, Vec<&ViewFile>)> {
    let made: Vec<(ContourView, &ViewFile)> = (frame.views.par_iter())
        .filter(|view| !view.held_out && view.mask.is_some())
        .map(|view| contour_view(view).map(|made| (made, view)))
        .collect::<Result<_>>()?;
    Ok(made.into_iter().unzip())
}

/// The silhouettes of a mesh in the views.
fn covers(
    mesh: &TriangleMesh,
    views: &[ContourView],
    files: &[&ViewFile],
    frame: &Frame,
) -> Result<Vec<ContourView>> {
    // The same selection as in `views_of`, so that each view is paired with its own mask.
    let masks = (frame.views.iter().zip(&frame.masks))
        .filter(|(view, _)| !view.held_out)
        .filter_map(|(_, mask)| mask.as_ref());
    let all: Vec<_> = views.iter().zip(files).zip(masks).collect();
    (all.par_iter())
        .map(|((view, file), mask)| {
            let shown = covered_pixels(mesh, &file.camera, mask.columns, mask.rows);
            let picture = Image {
                columns: mask.columns,
                rows: mask.rows,
                values: shown.iter().map(|shown| f32::from(u8::from(*shown))).collect(),
            };
            // Also small parts of the mesh cover the mask.
            let options = SilhouetteOptions { min_share: 0.0, ..SilhouetteOptions::default() };
            Ok(ContourView {
                silhouette: outlines(&picture, &options).map_err(|e| e.in_context(&view.name))?,
                ..(*view).clone()
            })
        })
        .collect()
}

/// The appearance of a rebuilt mesh, which has neither texture nor parts.
pub(super) fn without_appearance(
    appearance: TexturedMesh,
    mesh: &TriangleMesh,
    findings: &mut Vec<Finding>,
) -> TexturedMesh {
    if !appearance.uv_triangles.is_empty() {
        let text = "the mesh was remeshed: its texture is dropped";
        findings.push(Finding::new(FindingCode::TextureDropped, text));
    }
    TexturedMesh {
        points: mesh.positions.clone(),
        triangles: mesh.triangles.clone(),
        unit: appearance.unit,
        ..TexturedMesh::default()
    }
}
