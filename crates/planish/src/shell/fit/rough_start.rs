//! A rough start made ready for a fit to masks: it flows out where they are not covered, and is cut where
//! they show nothing.
//!
//! Input: a closed mesh and views with masks. Output: a closed mesh within all silhouettes that covers
//! them as far as cells can, and σ of its vertices.
//!
//! A deformation keeps what hangs together: a ball that is to become a body with a tail beside it is left
//! with a web between them, which outlines pull to both sides. So topology is not kept here: round after
//! round the mesh is made anew ([`remesh`]), within all silhouettes, and as far out as some mask shows more
//! than it covers; at last it fills the domain that silhouettes leave about it. Only then it is fitted.
//!
//! What no line of sight touches stays where silhouettes end. Without the view that holds it back a vertex
//! would be farther out by some `δ`; of views at even angles what they leave grows with the square of the
//! angle, which is twice as wide there, so that `δ` is three times what all views leave. The mean of `δ`
//! about a vertex over three is σ of the start there.
//!
//! Not guaranteed: what is thinner than a cell, and what masks with gross errors cut away; that the mesh
//! stays in one piece; σ in hollows, of which no silhouette tells anything.

use super::input::{Frame, FrameFiles, Units};
use super::{FlowReport, ShellFitJob, overlap};
use crate::occluding::contour_view;
use planish_core::{Finding, FindingCode};
use planish_estimate::Result;
use planish_exchange::textured::TexturedMesh;
use planish_exchange::views::ViewFile;
use planish_mesh::TriangleMesh;
use planish_sense::occluding::{ContourView, SilhouetteBound, outlines};
use planish_sense::{Image, SilhouetteOptions};
use planish_shell::covered_pixels;
use planish_shell::{Region, RemeshOptions, ShellFitOptions, remesh, smooth_vertex_values};
use rayon::prelude::*;

/// Cells along the mesh's diagonal.
const CELLS: f64 = 100.0;
/// How far it flows in one round, in cells.
const FARTHEST: f64 = 10.0;
/// What lies so many cells beyond what is covered is not covered.
const BEYOND: f64 = 0.5;
/// Parts of less than this share of the largest one's volume are crumbs.
const LEAST_PART: f64 = 0.002;
/// Rounds at most.
const MOST_ROUNDS: usize = 30;
/// The flow ends where a round adds less than this to the mean agreement with the masks.
const LEAST_GAIN: f64 = 1e-3;
/// How far it fills the domain in the end, in cells.
const FILLED: f64 = 8.0;
/// Smoothings after each round: they take away the steps that rounds leave.
const SMOOTHINGS: usize = 20;
/// Steps over which the mean about a vertex is taken: so many edges reach as far as their square root.
const MEAN_STEPS: usize = 100;
/// Without one view of several at even angles as much more is left than all of them leave.
const LEFT_WITHOUT_ONE: f64 = 3.0;
/// Thickness of the field of the fit, at first, as a share of the mesh's size: coarser ones draw thin parts
/// together.
const SOFTNESS: f64 = 0.003;

/// A bound that is so much wider than silhouettes are.
struct Wider {
    silhouettes: SilhouetteBound,
    by: f64,
}

impl Region for Wider {
    fn depth(&self, at: [f64; 3]) -> f64 {
        self.silhouettes.depth(at) + self.by
    }

    fn may_contain_boundary(&self, at: [f64; 3], reach: f64) -> bool {
        self.silhouettes.may_contain_boundary(at, reach + self.by)
    }
}

/// Nothing is covered anywhere.
struct Nothing;

impl Region for Nothing {
    fn depth(&self, _at: [f64; 3]) -> f64 {
        f64::NEG_INFINITY
    }

    fn may_contain_boundary(&self, _at: [f64; 3], _reach: f64) -> bool {
        false
    }
}

/// A mesh that has flown.
pub(super) struct Flown {
    pub mesh: TriangleMesh,
    /// σ of its vertices, along normals.
    pub sigma: Vec<f64>,
    pub report: FlowReport,
}

/// Options of the fit of a mesh of some size that has flown: it is near, and its agreement with the masks of
/// which it was made is no proof of it.
pub(super) fn options(size: f64) -> ShellFitOptions {
    let usual = ShellFitOptions::default();
    ShellFitOptions {
        softness: (SOFTNESS, usual.softness.1),
        steps: 2,
        start_sigma: Some(size / CELLS),
        ..usual
    }
}

/// The mesh that the fit starts from; `watch` is told how many rounds are done before the next.
///
/// # Errors
/// What `watch` says; `Input` for views whose masks cannot be read; `Undetermined` for fewer than two masks
/// that the object does not reach out of, an open mesh, or one that lies outside of some mask.
pub(super) fn flown(
    job: &ShellFitJob,
    mut mesh: TriangleMesh,
    units: &mut Units,
    watch: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Flown> {
    let files = FrameFiles { silhouettes: job.silhouettes.clone(), ..FrameFiles::default() };
    let frame = Frame::read(job, &files, size(&mesh), units, &mut Vec::new())?;
    let (views, files) = views_of(&frame)?;
    let domain = Wider { silhouettes: SilhouetteBound::new(&views)?, by: 0.0 };
    let cameras: Vec<_> = frame.views.iter().map(|view| view.camera).collect();
    let agreement = |mesh: &TriangleMesh| {
        let iou = overlap(&frame, mesh, &cameras);
        let fitted = files.iter().filter_map(|view| iou.get(&view.name)).sum::<f64>();
        (fitted / files.len().max(1) as f64, iou)
    };
    let anew = |mesh: &TriangleMesh, flow: Option<(&dyn Region, f64)>, cell: f64| {
        let options = RemeshOptions {
            domain: &domain,
            flow: flow.map(|(covered, cells)| (covered, cells * cell)),
            cell,
            min_part_volume_ratio: LEAST_PART,
            smoothing_passes: SMOOTHINGS,
        };
        remesh(mesh, &options).map_err(|e| e.in_context(job.mesh.display()))
    };
    let mut cell = size(&mesh) / CELLS;
    mesh = anew(&mesh, None, cell)?;
    let (mut mean, _) = agreement(&mesh);
    let mut rounds = 1;
    while rounds < MOST_ROUNDS {
        watch(rounds)?;
        cell = cell.max(size(&mesh) / CELLS);
        let covered = Wider {
            silhouettes: SilhouetteBound::new(&covers(&mesh, &views, &files, &frame)?)?,
            by: BEYOND * cell,
        };
        let next = anew(&mesh, Some((&covered, FARTHEST)), cell)?;
        let (after, _) = agreement(&next);
        rounds += 1;
        let gain = after - mean;
        if gain > 0.0 {
            (mesh, mean) = (next, after);
        }
        if gain < LEAST_GAIN {
            break;
        }
    }
    mesh = anew(&mesh, Some((&Nothing, FILLED)), cell)?;
    let left: Vec<f64> = (mesh.positions.par_iter())
        .map(|at| domain.silhouettes.depth_without_one(*at).max(0.0) / LEFT_WITHOUT_ONE)
        .collect();
    Ok(Flown {
        report: FlowReport {
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

/// What views show of a mesh, as silhouettes.
fn covers(
    mesh: &TriangleMesh,
    views: &[ContourView],
    files: &[&ViewFile],
    frame: &Frame,
) -> Result<Vec<ContourView>> {
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
            let options = SilhouetteOptions { least_share: 0.0, ..SilhouetteOptions::default() };
            Ok(ContourView {
                silhouette: outlines(&picture, &options).map_err(|e| e.in_context(&view.name))?,
                ..(*view).clone()
            })
        })
        .collect()
}

/// A mesh that was made anew has neither texture nor parts.
pub(super) fn without_looks(
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
