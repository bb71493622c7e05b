//! Merges overlapping surface patches into one mesh.
//!
//! Input: saved models, meshes and organised scans in one frame. Output: one manifold mesh with σ and
//! `observed`, and a [`MergeReport`].
//!
//! Stages: patches are checked and oriented; with [`MergeOptions::align`], small errors of their poses are
//! corrected. [`planish_mesh::Overlap`] finds common regions. These are fused by the information of all
//! patches, or refitted as R. Mohr, C. Zhao and G. Koscielny (1994) describe. Finally, the patches are
//! stitched.
//!
//! Not guaranteed: patches in unrelated frames are not registered.

mod align;
mod common_surface;
mod completion;
mod copies;
mod inspection;
mod outcome;
mod page;
mod patches;
mod ready;
mod sigma_check;
mod spline;

use crate::job::Job;
use crate::report::{ReportOutput, with_page};
pub use outcome::{
    CompletionReport, FillReport, MergeReport, Merged, PatchReport, RegionReport, TriangleQuality,
};
pub use patches::{NamedPatch, PatchSet, read_patches};
use planish_core::{Finding, FindingCode};
use planish_surface::saved::{Session, SessionInput};
use serde::Serialize;
use spline::write_spline;
pub use spline::{MergedSpline, SplineReport, merged_spline};

use crate::output::{OutputFormat, PlannedOutput, plan_outputs};
use common_surface::{Refit, refitted};
use completion::{completed, facing_findings};
use planish_core::Length;
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::{
    HoleLimit, MeshSearch, StitchOptions, StitchedMesh, TriangleMesh, fill_holes, fuse_patches,
    stitch_patches, vertex_curvature,
};
use planish_surface::export::{KnownMesh, write_known_mesh};
use ready::{MergeOutcome, Ready};
use std::path::{Path, PathBuf};

/// Patch number of vertices that fill holes. It is out of range of every list of patches, so they are never
/// counted as measured.
const NO_PATCH: u32 = u32::MAX;

/// Width, in edges, up to which holes are filled if nothing is specified: the width of a slit, half the
/// diameter of a round hole. The surface around such a gap determines it well: in simulated scans, 0.97 of
/// the vertices in them are within 1.96 σ (`docs/decisions/0151-narrow-gaps.md`).
pub const MAX_NARROW_WIDTH: f64 = 3.0;

/// How shared places are fused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MergeMethod {
    /// One spline through the overlap and its surroundings, weighted by information. The correction decreases
    /// to zero at the border of a patch.
    Information,
    /// One spline through the overlap with equal weights, as in the paper. σ is estimated from residuals.
    Refit,
    /// The mean by information, place by place, without a spline: it loses no shape, so its σ is true.
    #[default]
    Mean,
}

/// How patches are merged.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MergeOptions {
    /// How shared places are fused.
    pub method: MergeMethod,
    /// Unit of files that state none.
    pub unit: Option<Unit>,
    /// Chord error of the mesh of a model; half its median σ if none is given.
    pub mesh_tolerance: Option<Length>,
    /// ε: positions nearer than this are the same place. The default is 2.58 σ of their difference (99 %).
    pub epsilon: Option<Length>,
    /// θ in degrees: maximum angle between the normals of the same place.
    pub theta_deg: Option<f64>,
    /// Whether σ of patches are used as stated. Otherwise they are tested in the overlaps, and enlarged if
    /// the differences show that they are too small.
    pub believe_sigma: bool,
    /// Fill holes with at most this many edges, none if 0. If not specified, holes narrower than
    /// [`MAX_NARROW_WIDTH`] edges are filled.
    pub fill: Option<usize>,
    /// Whether the output contains curvature and the border of every vertex.
    pub curvature: bool,
    /// Whether the poses of patches are corrected relative to the first before merging.
    pub align: bool,
}

/// Files of patches, merged into one mesh.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MergeJob {
    /// Meshes and saved models; patches of one surface in one frame.
    pub patches: Vec<PathBuf>,
    /// File with a surface that contains the object. It completes regions without patches.
    pub bound: Option<PathBuf>,
    /// How patches are merged.
    pub options: MergeOptions,
    /// Meshes (`.ply`, `.glb`, `.obj`, `.stl`) and splines (`.step`, `.planish`) to write.
    pub outputs: Vec<PathBuf>,
    /// A page that shows the result.
    pub report: Option<ReportOutput>,
    /// Seed of every random choice.
    pub seed: u64,
    /// The arguments that decide the answer, for the provenance of a saved model.
    pub arguments: Vec<String>,
}

/// The figures of a [`MergeJob`].
#[derive(Debug, Clone, Serialize)]
pub struct MergeJobReport {
    /// The figures of the merge, with the findings of the whole job.
    #[serde(flatten)]
    pub merge: MergeReport,
    /// The spline through the merged mesh, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spline: Option<SplineReport>,
}

impl Job for MergeJob {
    type Report = MergeJobReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(self.patches.iter().chain(&self.bound).cloned().collect())
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        let is_written = |format: OutputFormat| {
            format.is_mesh() || matches!(format, OutputFormat::Step | OutputFormat::Planish)
        };
        if let Some(output) = plan_outputs(&self.outputs)?.iter().find(|output| !is_written(output.format)) {
            return Err(Error::unsupported(format!(
                "{}: cannot write this format: expected .ply, .glb, .obj, .stl, .step or .planish for a \
                 merged surface",
                output.path.display()
            )));
        }
        with_page(self.outputs.clone(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<MergeJobReport> {
        let (meshes, splines): (Vec<PlannedOutput>, Vec<PlannedOutput>) =
            plan_outputs(&self.outputs)?.into_iter().partition(|output| output.format.is_mesh());
        progress.check("reading", 0.0)?;
        let bound = self.bound.as_ref();
        let set = read_patches(&self.patches, bound, self.options.unit, self.options.mesh_tolerance)?;
        let mut merged = merge(set, &self.options, progress)?;
        // The spline is fitted before the first file is written, so that a failure leaves no partial output.
        let spline = match splines.is_empty() {
            true => None,
            false => Some(merged_spline(&merged, self.seed, progress)?),
        };
        for output in &meshes {
            write_merged(&merged, &output.path, progress)?;
        }
        if let Some(spline) = &spline {
            write_spline(spline, &splines, &[self.session(&merged.report)], progress)?;
        }
        merged.report.findings.extend(spline.iter().flat_map(|spline| spline.findings.iter().cloned()));
        if let Some(page) = &self.report {
            page::write_merge_report(&merged, page)?;
        }
        Ok(MergeJobReport { merge: merged.report, spline: spline.map(|spline| spline.report) })
    }
}

impl MergeJob {
    /// The session for the provenance of a saved model.
    fn session(&self, report: &MergeReport) -> Session {
        let input =
            |path: &PathBuf| SessionInput { name: path.display().to_string(), points: 0, points_hash: None };
        Session {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            arguments: self.arguments.clone(),
            seed: self.seed,
            inputs: report.inputs.iter().map(input).collect(),
        }
    }
}

/// Merges patches.
///
/// # Errors
/// `Input` for fewer than two patches (copies count once) and for options that are not positive;
/// `Undetermined` if no two patches overlap, or if a patch cannot be aligned; `Interrupted` on request.
pub fn merge(set: PatchSet, options: &MergeOptions, progress: &dyn Progress) -> Result<Merged> {
    progress.check("finding overlaps", 0.1)?;
    let bound = set.bound.clone();
    let inputs = set.inputs.clone();
    // Copies must go and orientations must agree before overlaps are searched, because overlaps pair only
    // surfaces that face the same way.
    let mut ready = Ready::new(set, options, progress)?;
    let overlap = ready.overlap(options)?;
    progress.check("fusing", 0.4)?;
    // Every method needs the mean: refits keep it at borders and where a piece cannot be fitted.
    let mean = fuse_patches(&ready.patches, &overlap);
    let part = ProgressPart::new(progress, 0.4, 0.7);
    let places = match options.method {
        MergeMethod::Information => refitted(&ready.patches, &overlap, mean, Refit::Information, &part)?,
        MergeMethod::Refit => refitted(&ready.patches, &overlap, mean, Refit::Shared, &part)?,
        MergeMethod::Mean => mean,
    };
    progress.check("sewing", 0.7)?;
    let mut stitched_mesh = stitch_patches(&ready.patches, &overlap, &places, &StitchOptions::default())?;
    // The bound is sewn in before holes are filled: a lid is a guess, and the hull is evidence.
    let completed = match &bound {
        Some(bound) => Some(complete(&mut stitched_mesh, bound, &mut ready)?),
        None => None,
    };
    let stitched = stitched_mesh.mesh.triangles.len() - stitched_mesh.kept;
    let limit = options.fill.map_or(HoleLimit::Width(MAX_NARROW_WIDTH), HoleLimit::Edges);
    let filled = match limit {
        HoleLimit::Edges(0) => None,
        limit => Some(fill(&mut stitched_mesh, limit, &ProgressPart::new(progress, 0.75, 0.95))?),
    };
    progress.check("checking", 0.95)?;
    let kept = ready.kept(&stitched_mesh, &overlap);
    // Fusing may resolve a crossing, so the user learns whether it is still there.
    if ready.crosses {
        ready.findings.push(crossing_finding(&stitched_mesh.mesh)?);
    }
    let outcome = MergeOutcome { method: options.method, completed, filled, stitched, kept, inputs };
    let report = ready.report(&stitched_mesh, &overlap, outcome);
    // Normals and curvature are those of the final mesh, after completion and filling.
    let normals = stitched_mesh.mesh.vertex_normals();
    let curvature = match options.curvature {
        true => Some(vertex_curvature(&stitched_mesh.mesh, &normals, &stitched_mesh.sigma)?),
        false => None,
    };
    Ok(Merged {
        normals,
        curvature,
        observed: ready.observed(&stitched_mesh),
        sigma: stitched_mesh.sigma,
        mesh: stitched_mesh.mesh,
        report,
    })
}

/// Stitches the bound to the merged surface where there is no patch.
fn complete(
    stitched_mesh: &mut StitchedMesh,
    bound: &NamedPatch,
    ready: &mut Ready,
) -> Result<CompletionReport> {
    let completed = completed(stitched_mesh, &bound.tidied.patch)?;
    ready.findings.extend(facing_findings(completed.facing, &bound.name));
    // The number after the last patch stands for the bound.
    *stitched_mesh = joined(stitched_mesh, completed.merged, ready.patches.len() as u32);
    Ok(CompletionReport { name: bound.name.clone(), vertices: completed.vertices, carved: completed.carved })
}

/// Finding about whether crossings of the patches remain in the merged mesh.
fn crossing_finding(mesh: &TriangleMesh) -> Result<Finding> {
    let text = match MeshSearch::try_new(mesh)?.self_crossings().pairs {
        0 => "the merged mesh does not intersect itself".to_owned(),
        pairs => format!("the merged mesh intersects itself as well, in {pairs} pairs of triangles"),
    };
    Ok(Finding::new(FindingCode::SelfCrossing, text))
}

/// Writes a merged mesh in the format of the path's extension.
///
/// # Errors
/// `Io` if the file cannot be written; `Input` for numbers that its format cannot represent.
pub fn write_merged(merged: &Merged, path: &Path, progress: &dyn Progress) -> Result<()> {
    progress.check(WRITING_STAGE, 0.97)?;
    let Merged { mesh, normals, sigma, observed, .. } = merged;
    let (curvature, unit) = (merged.curvature.as_ref(), merged.report.unit);
    write_known_mesh(path, &KnownMesh { mesh, normals, sigma, observed, curvature, unit })
}

/// Restores the sources of the merged vertices in a completed mesh. Vertices of the bound get the patch
/// number `bound`.
fn joined(merged: &StitchedMesh, mut completed: StitchedMesh, bound: u32) -> StitchedMesh {
    for source in &mut completed.source {
        *source = match *source {
            (0, v) => merged.source[v as usize],
            (_, v) => (bound, v),
        };
    }
    // Triangles that sewed before are among those kept now.
    completed.kept = completed.kept.saturating_sub(merged.mesh.triangles.len() - merged.kept);
    completed.holes_closed += merged.holes_closed;
    completed.fragments += merged.fragments;
    let longest = completed.valence.len().max(merged.valence.len());
    completed.valence.resize(longest, 0);
    for (n, count) in merged.valence.iter().enumerate() {
        completed.valence[n] += count;
    }
    completed
}

/// Fills holes of the stitched mesh. The new vertices belong to no patch.
fn fill(stitched_mesh: &mut StitchedMesh, limit: HoleLimit, progress: &dyn Progress) -> Result<FillReport> {
    let before = stitched_mesh.mesh.positions.len();
    let triangles = stitched_mesh.mesh.triangles.len();
    let watch = &mut |share: f64| progress.check("filling holes", share);
    let filled = fill_holes(&stitched_mesh.mesh, &stitched_mesh.sigma, limit, watch)?;
    let vertices = filled.mesh.positions.len() - before;
    let report = FillReport {
        holes: filled.holes,
        vertices,
        triangles: filled.mesh.triangles.len() - triangles,
        outer_rims: filled.outer_rims,
        unfilled: filled.too_large + filled.uncovered,
    };
    stitched_mesh.source.extend((0..vertices as u32).map(|v| (NO_PATCH, v)));
    stitched_mesh.stitched.resize(before + vertices, false);
    stitched_mesh.mesh = filled.mesh;
    stitched_mesh.sigma = filled.sigma;
    Ok(report)
}
