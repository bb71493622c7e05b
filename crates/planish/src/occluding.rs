//! The job `planish sense contours`: reconstructs points on the occluding contours of an object, and patches
//! of its surface, from views.
//!
//! Input: an [`OccludingJob`]. Output: the files that it names and an [`OccludingReport`]. Outputs are
//! checked before anything is read.
//!
//! Points come from [`planish_sense::occluding`]. Connected points form a strip. Each strip becomes a patch:
//! a mesh that joins the contours of consecutive views and, for models and STEP, a sheet by
//! [`fit`](planish_surface::fit::fit).
//!
//! Not guaranteed: errors of camera poses are not modelled.

mod agreement;
mod patch;
mod surface;

use planish_core::finding::with_warnings;
use planish_core::{Finding, FindingCode, Setting};
pub use planish_sense::occluding::OccludingOptions;

pub use agreement::OutlineAgreement;
pub use surface::{ConsistentSurfaceReport, MaskContradiction};

use crate::job::Job;
use crate::output::{OutputFormat, WrittenFile, as_text, plan_outputs, refuse_input_as_output};
use crate::sense::SigmaSummary;
use planish_core::{Progress, ProgressPart, WRITING_STAGE};
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{MeshColumns, read_mesh, write_mesh};
use planish_exchange::ply::write_scan;
use planish_exchange::views::{ViewFile, read_views};
use planish_exchange::{Unit, extension};
use planish_mesh::{BoundingBox, TriangleMesh};
use planish_report::numbers::{percent, significant};
use planish_sense::SilhouetteOptions;
use planish_sense::occluding::{
    Contour, ContourView, OccludingContours, OccludingPoint, SilhouetteBound, VisualHull, occluding_contours,
    outlines,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Correlation length of the border of a smoothed mask, in σ of the smoothing: the integral of the
/// autocorrelation `exp(−x²/4)` of a Gaussian kernel, 2 √π.
const CORRELATION_LENGTH: f64 = 3.545;
/// Factors between the scatter of contours and their stated σ that are not reported, as for the fit of a
/// shell.
const ACCEPTED_FACTORS: [f64; 2] = [1.0 / 3.0, 1.5];
/// Margin of the hull's box around the points, relative to their size. Occluding contours miss hollow and
/// hidden parts, so the object may reach beyond its points.
const HULL_MARGIN: f64 = 0.15;
/// Cells along the longest side of the hull's box. Time and memory grow with the cube; coarser cells lose
/// thin parts.
const HULL_CELLS: usize = 96;

/// Views with contours, and the files to write.
#[derive(Debug, Clone)]
pub struct OccludingJob {
    /// The views, in the order in which the camera took them.
    pub views: PathBuf,
    /// Files of points (.ply).
    pub outputs: Vec<PathBuf>,
    /// Files of patches; each patch gets its number before the extension.
    pub patches: Vec<PathBuf>,
    /// Minimum number of points of a strip that becomes a patch.
    pub min_points: usize,
    /// File of the visual hull.
    pub hull: Option<PathBuf>,
    /// File of the surface that agrees best with all masks.
    pub surface: Option<PathBuf>,
    /// A mesh whose outlines are compared with all masks.
    pub judged: Option<PathBuf>,
    /// How contours are read.
    pub options: OccludingOptions,
    /// Unit if the views state none.
    pub unit: Option<Unit>,
    /// Seed of every random choice.
    pub seed: u64,
}

impl Default for OccludingJob {
    fn default() -> Self {
        Self {
            views: PathBuf::new(),
            outputs: Vec::new(),
            patches: Vec::new(),
            min_points: 200,
            hull: None,
            surface: None,
            judged: None,
            options: OccludingOptions::default(),
            unit: None,
            seed: 0,
        }
    }
}

/// A patch.
#[derive(Debug, Clone, Serialize)]
pub struct ContourPatch {
    /// Its files.
    pub files: Vec<WrittenFile>,
    /// Points of its strip.
    pub points: usize,
    /// Number of views that they come from.
    pub views: usize,
    /// Median σ along its normals.
    pub sigma: f64,
    /// Its area.
    pub area: f64,
    /// Fraction of skipped places along its contours, between the first and the last in each view.
    #[serde(rename = "left_out_share")]
    pub missing_share: f64,
}

/// The figures of a job.
#[derive(Debug, Clone, Serialize)]
pub struct OccludingReport {
    /// Views that were used.
    pub views: usize,
    /// Runs of views that follow one another.
    pub sequences: usize,
    /// Sampled places along contours.
    pub contour_points: usize,
    /// Those with a match in both neighbouring views.
    pub matched: usize,
    /// Those that became points.
    pub observations: usize,
    /// The others, by cause.
    #[serde(rename = "left_out")]
    pub rejected: BTreeMap<&'static str, usize>,
    /// χ² of the contours about local parabolas, over its degrees of freedom.
    pub chi2: f64,
    /// Number of connected strips of points.
    pub strips: usize,
    /// σ of the depths.
    pub sigma_depth: Option<SigmaSummary>,
    /// The part of it from the approximation of sections by circles.
    pub sigma_circle: Option<SigmaSummary>,
    /// σ along the normals.
    pub sigma: Option<SigmaSummary>,
    /// σ of the normals.
    pub sigma_n_deg: Option<SigmaSummary>,
    /// Share of the visual hull's surface without a contour nearby. Absent if silhouettes are unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unseen_share: Option<f64>,
    /// Patches, of the largest strip first.
    pub patches: Vec<ContourPatch>,
    /// The surface that agrees best with all masks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<ConsistentSurfaceReport>,
    /// Overlap of the meshes with the masks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub iou: Vec<OutlineAgreement>,
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Option<Unit>,
    /// Files that were read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Points and hull that were written.
    #[serde(serialize_with = "as_texts")]
    pub written: Vec<PathBuf>,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

fn as_texts<S: serde::Serializer>(paths: &[PathBuf], serializer: S) -> std::result::Result<S::Ok, S::Error> {
    struct Text<'a>(&'a Path);
    impl Serialize for Text<'_> {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
            as_text(self.0, serializer)
        }
    }
    serializer.collect_seq(paths.iter().map(|p| Text(p)))
}

impl Job for OccludingJob {
    type Report = OccludingReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.views.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        if let Some(path) = self.outputs.iter().find(|path| extension(path) != "ply") {
            return Err(Error::unsupported(format!(
                "{}: cannot write this format: expected .ply for points; patches have an option of their \
                 own",
                path.display()
            ))
            .with_setting(Setting::Patch));
        }
        plan_outputs(&self.patches)?;
        for (path, name) in [(&self.hull, "the visual hull"), (&self.surface, "the surface")] {
            if let Some(path) = path
                && !OutputFormat::from_path(path)?.is_mesh()
            {
                return Err(Error::unsupported(format!(
                    "{}: expected the format of a mesh for {name}",
                    path.display()
                )));
            }
        }
        let meshes = self.hull.iter().chain(&self.surface);
        Ok(self.outputs.iter().chain(&self.patches).chain(meshes).cloned().collect())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<OccludingReport> {
        sense_contours(self, progress)
    }
}

/// Reads views, matches their contours, and writes points, patches and the visual hull.
fn sense_contours(job: &OccludingJob, progress: &dyn Progress) -> Result<OccludingReport> {
    progress.check("reading", 0.0)?;
    let file = read_views(&job.views)?;
    // Read before the work, so that a damaged mesh does not cost it.
    let judged = job.judged.as_deref().map(read_judged).transpose()?;
    let mut inputs = vec![job.views.clone()];
    inputs.extend(file.files.iter().cloned());
    inputs.extend(file.views.iter().filter_map(|v| v.mask.clone()));
    inputs.extend(job.judged.clone());
    // The list of views names masks that the job does not know, so outputs are compared again.
    for output in job.outputs.iter().chain(&job.hull).chain(&job.surface) {
        refuse_input_as_output(output, &inputs)?;
    }
    let unit = file.unit.or(job.unit);
    let mut findings = Vec::new();
    // Points without a unit are still useful for their shape, so this is a warning.
    if unit.is_none() {
        findings.push(
            Finding::new(
                FindingCode::UnitAssumed,
                "expected a unit of length in the views, found none: add `unit` to them, or specify the \
                 unit (mm, m, in or ft)",
            )
            .with_setting(Setting::Unit),
        );
    }
    let views = views_taking_part(&file.views, &job.views)?;
    let matching = ProgressPart::new(progress, 0.1, 0.4);
    let found =
        occluding_contours(&views, &job.options, &mut |share| matching.check("matching contours", share))
            .map_err(|e| e.in_context(job.views.display()))?;
    progress.check("visual hull", 0.4)?;
    // The hull is always made if possible: it also shows how much of the surface has no contour.
    let object_box = file.views.first().and_then(|view| view.object_box);
    let hull = hull_of(&views, &found, object_box)?;
    let surface = match &job.surface {
        Some(path) => {
            progress.check("surface", 0.45)?;
            Some(surface::consistent_surface(path, &views, object_box)?)
        }
        None => None,
    };
    // With all views of the file, held-out ones included.
    let meshes = agreement::Compared {
        hull: hull.as_ref().map(|hull| &hull.mesh),
        surface: surface.as_ref().map(|surface| &surface.mesh),
        judged: judged.as_ref(),
    };
    let iou = agreement::agreements(&file.views, &meshes)?;
    findings.extend(agreement::hull_findings(&iou));
    findings.extend(surface.iter().flat_map(|surface| surface.findings.clone()));
    let unseen_share = hull.as_ref().map(|hull| hull.unseen_share(&found.points));
    let fitting = ProgressPart::new(progress, 0.5, 0.9);
    // Patches may fail. They are made before the first file is written.
    let patches = patch::patches(job, &found, unit, &fitting, &mut findings)?;
    progress.check(WRITING_STAGE, 0.95)?;
    let mut written = Vec::new();
    for path in &job.outputs {
        write_scan(path, &found.scan(None, "contours"), unit)?;
        written.push(path.clone());
    }
    if let Some(path) = &job.hull {
        let hull = hull.as_ref().ok_or_else(|| {
            Error::undetermined(format!(
                "{}: expected masks of the whole object in at least two views for a visual hull",
                path.display()
            ))
        })?;
        write_hull(path, &hull.mesh, unit)?;
        written.push(path.clone());
    }
    if let (Some(path), Some(surface)) = (&job.surface, &surface) {
        surface.write(path, unit)?;
        written.push(path.clone());
    }
    let patches = patch::written(job, patches, unit, &inputs)?;
    progress.advance("done", 1.0);
    Ok(OccludingReport {
        views: views.len(),
        sequences: found.sequences,
        contour_points: found.asked,
        matched: found.matched,
        observations: found.points.len(),
        chi2: found.reduced_chi_square,
        strips: found.strips,
        sigma_depth: of_points(&found, |p| p.sigma_depth),
        sigma_circle: of_points(&found, |p| p.sigma_circle),
        sigma: of_points(&found, OccludingPoint::sigma_along_normal),
        sigma_n_deg: of_points(&found, |p| p.sigma_normal_deg),
        rejected: found.rejected,
        unseen_share,
        patches,
        surface: surface.map(|surface| surface.report),
        iou,
        unit,
        inputs,
        written,
        findings: findings.into_iter().chain(sigma_finding(found.reduced_chi_square)).collect(),
    })
}

/// A finding if the residuals of the contours contradict their stated σ.
///
/// Points depend on σ alone, so no factor is applied: low residuals do not show whether σ is too large or the
/// errors of neighbours are equal, which the residuals about a curve do not contain.
fn sigma_finding(chi_square: f64) -> Option<Finding> {
    let factor = chi_square.sqrt();
    if !factor.is_finite() || (ACCEPTED_FACTORS[0]..=ACCEPTED_FACTORS[1]).contains(&factor) {
        return None;
    }
    let cause = match factor > 1.0 {
        true => "σ of the contours is too small, or they have more detail than the window",
        false => "σ of the contours is too large, or the errors of neighbouring points are equal",
    };
    let text = format!(
        "the contours scatter about smooth curves by {} of their stated σ (χ² {}): {cause}; the stated σ was \
         used",
        percent(factor),
        significant(chi_square, 2)
    );
    Some(Finding::new(FindingCode::ResidualsInconsistent, text))
}

/// Views that shape the result; held-out ones only judge it.
fn views_taking_part(views: &[ViewFile], path: &Path) -> Result<Vec<ContourView>> {
    let taking_part: Vec<&ViewFile> = views.iter().filter(|v| !v.held_out).collect();
    let read = |view: &&ViewFile| {
        contour_view(view).map_err(|e| e.in_context(format!("{}: view `{}`", path.display(), view.name)))
    };
    taking_part.par_iter().map(read).collect()
}

fn of_points(found: &OccludingContours, value: impl Fn(&OccludingPoint) -> f64) -> Option<SigmaSummary> {
    crate::sense::summary(found.points.iter().map(value).collect())
}

fn mask_options(view: &ViewFile) -> SilhouetteOptions {
    let defaults = SilhouetteOptions::default();
    SilhouetteOptions {
        threshold: view.mask_threshold,
        min_share: view.mask_min_share.unwrap_or(defaults.min_share),
        sigma_px: view.sigma_px,
        ..defaults
    }
}

/// Contours of a view in a file.
pub(crate) fn contour_view(view: &ViewFile) -> Result<ContourView> {
    let options = mask_options(view);
    let outline = match (&view.mask, view.read_mask()?) {
        (Some(path), Some(picture)) => {
            outlines(&picture, &options).map_err(|e| e.in_context(path.display()))?
        }
        _ => Vec::new(),
    };
    let camera = view.camera.pinhole;
    let measured = !view.contours.is_empty();
    // A view without contours would interrupt the sequence silently.
    if !measured && outline.is_empty() {
        return Err(Error::input("expected a mask, or contours with ordered points, found none"));
    }
    let (contours, sigma_px, apart_px) = match measured {
        // Neighbouring places of a smoothed border share their noise. Denser sampling would count it several
        // times.
        false => (outline.clone(), view.sigma_px, CORRELATION_LENGTH * options.smoothing_px),
        true => {
            let mut sigmas: Vec<f64> = view.contours.iter().map(|(_, sigma)| *sigma).collect();
            sigmas.sort_by(f64::total_cmp);
            // Points of a file are taken as independent. The median σ ignores a few bad ones.
            (pieces(view, &outline), sigmas[sigmas.len() / 2], 0.0)
        }
    };
    Ok(ContourView { name: view.name.clone(), camera, contours, silhouette: outline, sigma_px, apart_px })
}

/// Contours of a file, oriented so that the object is on their right if a mask shows the side.
fn pieces(view: &ViewFile, outline: &[Contour]) -> Vec<Contour> {
    let ends = view.contour_starts.iter().skip(1).copied().chain([view.contours.len()]);
    (view.contour_starts.iter().zip(ends))
        .map(|(&start, end)| {
            let places = view.contours[start..end].iter().map(|(p, _)| *p).collect();
            let mut contour = Contour { places, closed: false };
            contour.close();
            // Files do not state on which side the object is; the mask does.
            contour.face(outline);
            contour
        })
        .collect()
}

/// A box around the points, with a margin.
fn box_of(found: &OccludingContours) -> Option<BoundingBox> {
    let bounds = BoundingBox::around(found.points.iter().map(|p| p.position))?;
    Some(bounds.grown(HULL_MARGIN * bounds.diagonal()))
}

/// The hull of all silhouettes, if known.
fn hull_of(
    views: &[ContourView],
    found: &OccludingContours,
    limits: Option<BoundingBox>,
) -> Result<Option<VisualHull>> {
    let closed =
        // An open silhouette leaves the picture, and the hull would be cut at its edge.
        |view: &&ContourView| !view.silhouette.is_empty() && view.silhouette.iter().all(|c| c.closed);
    if views.iter().filter(closed).count() < 2 {
        return Ok(None);
    }
    // Without any point, nothing shows where in space the hull should be sought.
    let Some(bounds) = box_of(found) else {
        return Ok(None);
    };
    VisualHull::of(SilhouetteBound::new(views)?.within(limits), &bounds, HULL_CELLS).map(Some)
}

fn read_judged(path: &Path) -> Result<TriangleMesh> {
    let file = read_mesh(path)?;
    TriangleMesh::try_new(file.points, file.triangles).map_err(|e| e.in_context(path.display()))
}

fn write_hull(path: &Path, mesh: &TriangleMesh, unit: Option<Unit>) -> Result<()> {
    write_mesh(
        path,
        &MeshColumns { points: &mesh.positions, triangles: &mesh.triangles, unit, ..MeshColumns::default() },
    )
}
