//! Deviations of a model from a reference, and how often the model's stated σ covers them.
//!
//! Input: a model (`.planish`, or a mesh, maybe with columns `sigma` and `observed`) and a [`Reference`]:
//! a mesh, or points with or without σ. Output: a [`ComparisonReport`] in the model's unit.
//!
//! *Forward* deviations are measured from the vertices of the model's mesh to the reference's mesh.
//! *Backward* deviations are measured from the reference's points to the model's surface, with exact foot
//! points for a `.planish` file. Both are positive if the model is on the side to which the reference's
//! normal points (the model's normal if the reference has none). Only observed parts of the model are
//! compared. Points whose foot is on an open boundary are skipped, because the other surface ends there.
//!
//! Not guaranteed: deviations are not weighted by area, so finely meshed parts count more. Foot points may
//! not be the globally nearest ones. They start at the sample whose position and normal agree best, which
//! keeps the two sides of a thin part apart.

mod chord_gap;
mod effort;
mod findings;
mod inputs;
mod offset;
mod order;
pub(crate) mod page;

pub use inputs::{Compared, ComparedMesh, Reference};
pub use offset::CommonOffset;
use planish_core::finding::with_warnings;
use planish_core::{DVec3, Finding, FindingCode, Length};

use crate::assumed_unit::implausible_size;
use crate::job::Job;
use crate::report::{ReportOutput, with_page};
use crate::saved;
use chord_gap::mean_chord_gap;
use effort::closest_of_affordable;
use order::{Ordered, read_in_order};
use page::compare_page;
use planish_core::Progress;
use planish_estimate::{Error, Result};
use planish_exchange::mesh::{PolygonMesh, has_faces, read_mesh};
use planish_exchange::{ScanSet, Unit, read_inputs};
use planish_mesh::{BoundingBox, DeviationStatistics, MeshSearch, TriangleMesh};
use planish_spline::{
    FootPoint, FootPointSearch, ProjectionOptions, Surface, TessellationOptions, tessellate,
};
use planish_surface::export::{affordable_tolerance, median_sigma};
use planish_surface::model::sigmas_along;
use planish_surface::model::{Observed, SurfaceModel};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The 97.5 % quantile of the normal distribution: half the width of its central 95 %.
const QUANTILE_95: f64 = 1.959_963_984_540_054;
/// Maximum number of triangles of the model's mesh. It bounds time and memory; the chord error is enlarged to
/// meet it. More samples hardly change the statistics of deviations.
const MAX_FORWARD_TRIANGLES: u64 = 500_000;

/// Figures of one direction, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Deviations {
    /// Root mean square.
    pub rms: f64,
    /// Signed mean: a bias.
    pub mean: f64,
    /// Median of the absolute deviations.
    pub p50: f64,
    /// 95 % quantile of the absolute deviations.
    pub p95: f64,
    /// Greatest absolute deviation.
    pub max: f64,
    /// Number of compared points.
    pub n: usize,
    /// Common offset along the normals. Absent if the points are too few for its σ.
    pub offset: Option<CommonOffset>,
}

/// Points that were not compared, by cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Skipped {
    /// Vertices of the model where it was not measured.
    pub model_not_observed: usize,
    /// Vertices of the model beyond an open border of the reference.
    pub model_beyond_border: usize,
    /// Points of the reference near an unobserved part of the model.
    pub reference_not_observed: usize,
    /// Points of the reference beyond an open border of the model.
    pub reference_beyond_border: usize,
}

/// The figures of a comparison: keys of the JSON summary.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparisonReport {
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Unit,
    /// Deviations from the model to the reference. Absent if the reference has no triangles or if nothing can
    /// be compared.
    pub forward: Option<Deviations>,
    /// Deviations from the reference to the model. Absent if nothing can be compared.
    pub backward: Option<Deviations>,
    /// Share of the reference's points within 1.96 · √(σ_model² + σ_reference²); none where the model carries
    /// no σ.
    pub coverage95: Option<f64>,
    /// The same share after the subtraction of the common offset; none where either is unknown.
    pub coverage95_without_offset: Option<f64>,
    /// Numbers of skipped points.
    pub skipped: Skipped,
    /// Findings for the user.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

/// How to compare.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CompareOptions {
    /// Unit of files that state none. The default is the unit of the other file, else millimetres.
    pub unit: Option<Unit>,
    /// Chord error of the model's mesh; half the median σ if none is given. Without a unit, it is in that of
    /// the model.
    pub mesh_tolerance: Option<Length>,
    /// The part of the model that is compared.
    pub part: ComparedPart,
}

/// A part of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ComparedPart {
    /// Measured parts.
    #[default]
    Measured,
    /// Parts that were completed by symmetry or smoothness.
    Completed,
    /// Both.
    Known,
    /// Also parts that are determined by the prior alone.
    All,
}

impl ComparedPart {
    pub(crate) fn holds(self, observed: Observed) -> bool {
        match self {
            Self::Measured => observed.is_measured(),
            Self::Completed => observed == Observed::Inferred,
            Self::Known => observed != Observed::PriorOnly,
            Self::All => true,
        }
    }
}

/// Meaning of a value of a mesh's column `observed`.
fn observed_of(mark: f64) -> Observed {
    (0..=u8::MAX).find(|m| f64::from(*m) == mark).and_then(Observed::from_mark).unwrap_or_default()
}

/// Compares a model with a reference.
///
/// If both have a unit, the reference is converted to the model's.
///
/// # Errors
/// `Undetermined` if nothing can be compared; `Input` for meshes that cannot be searched;
/// `Interrupted` on request.
pub fn compare(
    model: &Compared,
    reference: Reference,
    options: &CompareOptions,
    progress: &dyn Progress,
) -> Result<ComparisonReport> {
    compared(model, reference, options, progress).map(|(report, _)| report)
}

/// The reference as a report shows it.
pub(crate) struct ShownReference {
    /// Its points that were compared, in the model's unit.
    pub points: Vec<DVec3>,
    /// The model's signed deviation from each.
    pub deviations: Vec<f64>,
    /// The same over its σ; not finite if none is known.
    pub normalised: Vec<f64>,
    /// Its triangles, if it has any.
    pub mesh: Option<TriangleMesh>,
}

/// [`compare`], with the data for the report page.
pub(crate) fn compared(
    model: &Compared,
    reference: Reference,
    options: &CompareOptions,
    progress: &dyn Progress,
) -> Result<(ComparisonReport, ShownReference)> {
    let unit = model.unit().or(options.unit).or(reference.unit).unwrap_or(Unit::Millimetre);
    let of_reference = reference.unit.or(options.unit).unwrap_or(unit);
    let mut report = ComparisonReport {
        unit,
        forward: None,
        backward: None,
        coverage95: None,
        coverage95_without_offset: None,
        skipped: Skipped::default(),
        findings: Vec::new(),
    };
    if of_reference != unit {
        report.findings.push(Finding::new(
            FindingCode::UnitConverted,
            format!("the reference is in {of_reference}, the model in {unit}: the reference was converted"),
        ));
    }
    if model.unit().or(options.unit).or(reference.unit).is_none() {
        let size = BoundingBox::from_points(&reference.points).map_or(0.0, |b| b.longest_side());
        report.findings.extend(implausible_size(size, unit));
    }
    // The reference is converted, not the model: σ, tolerances and the report are in the model's unit.
    let reference = reference.scaled(of_reference.millimetres() / unit.millimetres());
    // Backward first: it needs the reference's points, which the mesh of the forward direction consumes.
    progress.check("backward", 0.0)?;
    let pairs = match model {
        Compared::Surface(model) => surface_pairs(model, &reference, options.part, &mut report.skipped)?,
        Compared::Mesh(mesh) => mesh_pairs(mesh, &reference, options.part, &mut report)?,
    };
    let mut shown = summarise_backward(&pairs, &reference, &mut report)?;
    if reference.triangles.is_empty()
        && let (Compared::Mesh(model), Some(backward)) = (model, &mut report.backward)
    {
        // Points allow one direction only, so no second one shows that an offset is the chord error.
        let gap = mean_chord_gap(&model.mesh, &pairs);
        backward.offset = backward.offset.map(|offset| offset.with_chord_gap(gap));
    }
    progress.check("forward", 0.6)?;
    if reference.triangles.is_empty() {
        report.findings.push(Finding::new(
            FindingCode::ReferenceWithoutFaces,
            "the reference has no faces: deviations of the model from it were not computed",
        ));
    } else {
        let vertices = observed_vertices(model, options, &mut report.skipped)?;
        progress.check("forward", 0.7)?;
        let mesh = TriangleMesh::try_new(reference.points, reference.triangles)?;
        let search = MeshSearch::try_new(&mesh)?;
        let feet = closest_of_affordable(&search, &vertices, "vertices of the model", &mut report.findings);
        let all = feet.iter().flatten().count();
        let (mut places, mut normals, mut signed) = (Vec::new(), Vec::new(), Vec::new());
        for (vertex, foot) in vertices.iter().zip(feet) {
            // A foot on the boundary measures the distance to an edge, not the deviation of two surfaces.
            let Some(foot) = foot.filter(|foot| !foot.on_boundary) else { continue };
            places.push(*vertex);
            normals.push(foot.normal);
            signed.push(foot.signed_distance);
        }
        report.skipped.model_beyond_border = all - signed.len();
        report.forward = deviations(&places, &signed, &normals)?;
        shown.mesh = Some(mesh);
    }
    // An error, because empty figures would pass every check of a script.
    if report.forward.is_none() && report.backward.is_none() {
        return Err(Error::undetermined(
            "expected a model and a reference that overlap, found no point of either near a compared part \
             of the other",
        ));
    }
    progress.advance("done", 1.0);
    Ok((report, shown))
}

/// A file compared with a reference.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CompareJob {
    /// A saved model, a mesh or a STEP file. Points are exchanged with the reference if that has a surface.
    pub model: PathBuf,
    /// File of the reference.
    pub reference: PathBuf,
    /// How they are compared.
    pub options: CompareOptions,
    /// A page that shows the result.
    pub report: Option<ReportOutput>,
}

impl Job for CompareJob {
    type Report = ComparisonReport;

    fn inputs(&self) -> Result<Vec<PathBuf>> {
        Ok(vec![self.model.clone(), self.reference.clone()])
    }

    fn outputs(&self) -> Result<Vec<PathBuf>> {
        with_page(Vec::new(), self.report.as_ref())
    }

    fn execute(&self, progress: &dyn Progress) -> Result<ComparisonReport> {
        let Ordered { model: read, reference, paths, finding } = read_in_order(&self.model, &self.reference)?;
        let read = read.with_unit_if_unstated(self.options.unit.or(reference.unit));
        let (mut report, shown) = compared(&read, reference, &self.options, progress)?;
        report.findings.splice(0..0, finding);
        // The judgement comes first in the report; conversions and assumptions follow.
        report.findings.splice(0..0, findings::judge(&report));
        if let Some(page) = &self.report {
            let made = compare_page(&read, &report, shown, &self.options, paths)?;
            let inputs = [(paths[0], "the model"), (paths[1], "the reference")];
            page.write(made, &inputs.map(|(path, role)| (path.to_owned(), role.to_owned())))?;
        }
        Ok(report)
    }
}

/// Figures of signed deviations at `points`, and their common offset along `directions`.
fn deviations(points: &[DVec3], signed: &[f64], directions: &[DVec3]) -> Result<Option<Deviations>> {
    if signed.is_empty() {
        return Ok(None);
    }
    let DeviationStatistics { rms, mean, p50, p95, max, n } = DeviationStatistics::from_signed(signed)?;
    let offset = CommonOffset::estimate(points, signed, directions);
    Ok(Some(Deviations { rms, mean, p50, p95, max, n, offset }))
}

/// A point of the reference and its foot on the model.
struct Pair {
    point: usize,
    foot: DVec3,
    /// The model's normal there.
    normal: DVec3,
    /// The model's σ along it.
    sigma: Option<f64>,
    /// The triangle of the foot, and the foot's barycentric weights there; none on a spline.
    facet: Option<(u32, [f64; 3])>,
}

fn summarise_backward(
    pairs: &[Pair],
    reference: &Reference,
    report: &mut ComparisonReport,
) -> Result<ShownReference> {
    let mut signed = Vec::with_capacity(pairs.len());
    let mut directions = Vec::with_capacity(pairs.len());
    let mut sigmas = Vec::with_capacity(pairs.len());
    let mut against = 0_usize;
    for pair in pairs {
        let offset = pair.foot - reference.points[pair.point];
        let own = reference.normal(pair.point);
        // The sign is that of the reference if it has normals, so that both directions agree on what
        // "outside" is.
        let direction = if own == DVec3::ZERO { pair.normal } else { own };
        against += usize::from(own.dot(pair.normal) < 0.0);
        let size = offset.length();
        signed.push(if offset.dot(direction) < 0.0 { -size } else { size });
        directions.push(direction);
        // The errors of model and reference are independent, so their variances add. NaN keeps the lists
        // parallel, and pages draw it as unknown.
        sigmas.push(
            pair.sigma.map_or(f64::NAN, |sigma| {
                (sigma * sigma + reference.variance(pair.point, pair.normal)).sqrt()
            }),
        );
    }
    // A few opposed normals are usual at thin parts. A majority means that the reference is inside out, which
    // flips every sign.
    if 2 * against > pairs.len() {
        report.findings.push(Finding::new(
            FindingCode::ReferenceNormalsOpposed,
            "most normals of the reference are opposite to those of the model: signs follow the normals of \
             the reference",
        ));
    }
    let points: Vec<DVec3> = pairs.iter().map(|pair| reference.points[pair.point]).collect();
    report.backward = deviations(&points, &signed, &directions)?;
    let coverage = |offset: f64| {
        let known = sigmas.iter().filter(|sigma| !sigma.is_nan()).count();
        let within =
            signed.iter().zip(&sigmas).filter(|(d, sigma)| (*d - offset).abs() <= QUANTILE_95 * **sigma);
        (known > 0).then(|| within.count() as f64 / known as f64)
    };
    report.coverage95 = coverage(0.0);
    report.coverage95_without_offset =
        report.backward.and_then(|d| d.offset).and_then(|offset| coverage(offset.value));
    let normalised = signed.iter().zip(&sigmas).map(|(d, sigma)| d / sigma).collect();
    Ok(ShownReference { points, deviations: signed, normalised, mesh: None })
}

/// Exact foot points of the reference on a spline.
fn surface_pairs(
    model: &SurfaceModel,
    reference: &Reference,
    part: ComparedPart,
    skipped: &mut Skipped,
) -> Result<Vec<Pair>> {
    let feet = feet_on(&model.surface, &reference.points, |k| reference.normal(k))?;
    let (mut points, mut leaf, mut local, mut normals) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (k, foot) in feet.iter().enumerate() {
        if foot.at_border {
            skipped.reference_beyond_border += 1;
        } else if !part.holds(model.observed_at(foot.leaf as usize, foot.local)) {
            skipped.reference_not_observed += 1;
        } else {
            points.push(k);
            leaf.push(foot.leaf);
            local.push(foot.local);
            normals.push(foot.normal);
        }
    }
    // σ of all feet at once: cells that share columns of the covariance are solved together.
    let sigmas = sigmas_along(&model.posterior()?, &leaf, &local, &normals)?;
    Ok(points
        .into_iter()
        .zip(sigmas)
        .map(|(point, sigma)| Pair {
            point,
            foot: feet[point].jet.point,
            normal: feet[point].normal,
            sigma: Some(sigma),
            facet: None,
        })
        .collect())
}

/// The nearest points of a surface to points with normals (zero if unknown).
pub(crate) fn feet_on(
    surface: &Surface,
    points: &[DVec3],
    normal: impl Fn(usize) -> DVec3 + Sync,
) -> Result<Vec<FootPoint>> {
    let extent = BoundingBox::from_points(surface.vertices()).map_or(0.0, |b| b.diagonal());
    // Opposite normals count like a distance of a fifth of the size. This keeps the points of one side of a
    // thin plate from finding the other side.
    let search = FootPointSearch::new(surface, 3, 0.1 * extent)?;
    let options = ProjectionOptions::default();
    Ok((0..points.len())
        .into_par_iter()
        .with_min_len(256)
        .map(|k| {
            let z = points[k];
            let away = |foot: &FootPoint| foot.jet.point.distance(z);
            let first = surface.project(z, search.nearest(z, normal(k)), &options);
            // No foot of a perpendicular: the iteration got stuck, or the normal misled it.
            if first.at_border || first.converged && first.slip <= 0.05 * away(&first) + 1e-6 * extent {
                return first;
            }
            let second = surface.project(z, search.nearest(z, DVec3::ZERO), &options);
            // The second start ignores the normal. It replaces the first only if it is nearer, so a good
            // normal is never overruled without gain.
            if away(&second) < away(&first) { second } else { first }
        })
        .collect())
}

/// Closest points of the reference on a mesh.
fn mesh_pairs(
    model: &ComparedMesh,
    reference: &Reference,
    part: ComparedPart,
    report: &mut ComparisonReport,
) -> Result<Vec<Pair>> {
    let search = MeshSearch::try_new(&model.mesh)?;
    let name = "points of the reference";
    let feet = closest_of_affordable(&search, &reference.points, name, &mut report.findings);
    let skipped = &mut report.skipped;
    let mut pairs = Vec::with_capacity(feet.len());
    for (point, foot) in feet.into_iter().enumerate() {
        let Some(foot) = foot else { continue };
        let corners = model.mesh.triangles[foot.triangle as usize];
        let measured = model
            .observed
            .as_ref()
            // All corners must belong to the part: a triangle at its border is already extrapolated.
            .is_none_or(|observed| corners.iter().all(|&v| part.holds(observed[v as usize])));
        if foot.on_boundary {
            skipped.reference_beyond_border += 1;
        } else if !measured {
            skipped.reference_not_observed += 1;
        } else {
            let interpolate =
                |sigma: &Vec<f64>| model.mesh.interpolate(sigma, foot.triangle as usize, foot.barycentric);
            pairs.push(Pair {
                point,
                foot: foot.point,
                normal: foot.normal,
                sigma: model.sigma.as_ref().map(interpolate),
                facet: Some((foot.triangle, foot.barycentric)),
            });
        }
    }
    Ok(pairs)
}

/// The vertices of a model's mesh that are of the part that is compared.
fn observed_vertices(
    model: &Compared,
    options: &CompareOptions,
    skipped: &mut Skipped,
) -> Result<Vec<DVec3>> {
    let (positions, observed): (_, Vec<Observed>) = match model {
        Compared::Surface(model) => {
            let tolerance = match options.mesh_tolerance {
                Some(tolerance) => tolerance.in_unit(model.unit),
                None => {
                    // A chord error of half the median σ is smaller than the deviations of interest.
                    let wanted = 0.5 * median_sigma(model, &model.posterior()?)?;
                    affordable_tolerance(&model.surface, wanted, MAX_FORWARD_TRIANGLES)?
                }
            };
            let options = TessellationOptions { tolerance, ..TessellationOptions::default() };
            let made = tessellate(&model.surface, &options)?;
            let observed = (made.leaf.iter().zip(&made.local))
                .map(|(&leaf, &local)| model.observed_at(leaf as usize, local))
                .collect();
            (made.positions, observed)
        }
        Compared::Mesh(mesh) => {
            // A mesh without the column was not made by a fit: all of it counts as measured.
            let all = || vec![Observed::Measured; mesh.mesh.positions.len()];
            (mesh.mesh.positions.clone(), mesh.observed.clone().unwrap_or_else(all))
        }
    };
    let all = positions.len();
    let kept: Vec<DVec3> = positions
        .into_iter()
        .zip(&observed)
        .filter(|(_, observed)| options.part.holds(**observed))
        .map(|(p, _)| p)
        .collect();
    skipped.model_not_observed = all - kept.len();
    Ok(kept)
}

#[cfg(test)]
mod tests;
