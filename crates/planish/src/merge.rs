//! Surface patches that overlap, merged into one mesh.
//!
//! Comes in: saved models, meshes and organised scans in one frame. Goes out: one manifold mesh with σ and `observed`, and a [`MergeReport`].
//!
//! What is merged where is told by [`planish_mesh::Overlap`]; common regions are fused by the information of all patches there, or refitted as R. Mohr, C. Zhao and G. Koscielny (1994) do; then everything is sewn.
//!
//! Patches that stand a little off are brought together first where [`MergeOptions::align`] says so.
//!
//! Not guaranteed: that patches in frames of their own come together.

mod align;
mod common_surface;
mod completion;
mod inspection;
mod patches;
mod spline;

pub use patches::{NamedPatch, PatchSet, read_patches};
pub use spline::{MergedSpline, SplineReport, merged_spline, write_spline};

use crate::mesh_output::write_known_mesh;
use crate::model::{PoseReport, SigmaSummary};
use crate::next::Length;
use crate::output::{OutputFormat, PlannedOutput, plan_outputs};
use crate::progress::{Part, Progress, WRITING_STAGE};
use common_surface::{Refit, refitted};
use completion::{completed, facing_in_words};
use inspection::{crossings, leave_out_copies, nearest, turn_alike, unalike};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::{
    MeshSearch, Overlap, OverlapOptions, Patch, TriangleMesh, ZipOptions, Zipped, fused, quantile_of_sorted, zipped,
};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// How shared places are fused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MergeMethod {
    /// One spline by the information of all patches, and of what lies around; what moves goes to nothing where a patch ends.
    Information,
    /// One spline through the shared places, all alike, as the paper does; σ from what is left.
    Refit,
    /// The mean by information, place by place, without a spline.
    Mean,
}

/// How patches are merged.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MergeOptions {
    /// How shared places are fused; where nothing is said, by information if all patches state σ, and by a refit if not.
    pub method: Option<MergeMethod>,
    /// Unit of files that name none.
    pub unit: Option<Unit>,
    /// How far the mesh of a model may leave its surface; half its median σ where none is given.
    pub mesh_tolerance: Option<Length>,
    /// ε: places nearer than this are one; three σ of their difference where none is given.
    pub epsilon: Option<Length>,
    /// θ in degrees: normals of one place differ by less.
    pub theta_deg: Option<f64>,
    /// Holes of up to so many edges are closed.
    pub fill: usize,
    /// Whether patches stand a little off and are brought to the first before they are merged.
    pub align: bool,
}

/// A region that two patches share.
#[derive(Debug, Clone, Serialize, PartialEq)]
pub struct RegionReport {
    /// Both patches, counted from 0 in the order of [`MergeReport::patches`].
    pub patches: [usize; 2],
    /// Vertices of either that lie on the other.
    pub points: usize,
    /// Root mean square of the heights between both, before they were merged.
    pub rms: f64,
}

/// What was merged.
#[derive(Debug, Clone, Serialize)]
pub struct PatchReport {
    /// Its file or scan.
    pub name: String,
    /// Its triangles.
    pub triangles: usize,
    /// Vertices in the whole.
    pub vertices_kept: usize,
    /// Whether it was turned over, as it faced the other way than the patches that it lies on.
    pub turned_over: bool,
    /// Median of its σ; estimated where none was stated.
    pub sigma: f64,
}

/// The shapes of triangles.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct TriangleQuality {
    /// Median of their smallest angles, in degrees.
    pub smallest_angle_median_deg: f64,
    /// The smallest angle that 99 of 100 exceed, in degrees.
    pub smallest_angle_p1_deg: f64,
    /// Longest edge over height on it: the median, and what 99 of 100 stay below. 1.15 is best.
    pub aspect_median: f64,
    /// As above.
    pub aspect_p99: f64,
}

/// What a bound added to the patches.
#[derive(Debug, Clone, Serialize)]
pub struct CompletionReport {
    /// Its file.
    pub name: String,
    /// Its vertices in the whole, which `observed` gives as completed.
    pub vertices: usize,
    /// Triangles of the patches and of closed holes that were carved away, as they reached out of it.
    pub carved: usize,
}

/// What came of a merge.
#[derive(Debug, Clone, Serialize)]
pub struct MergeReport {
    /// How shared places were fused.
    pub method: MergeMethod,
    /// Vertices of the whole.
    pub vertices: usize,
    /// Its triangles.
    pub triangles: usize,
    /// Edges of one triangle.
    pub boundary_edges: usize,
    /// Edges of three and more: none, by construction.
    pub nonmanifold_edges: usize,
    /// Whether nothing is open.
    pub watertight: bool,
    /// Connected parts.
    pub parts: usize,
    /// Common regions, largest first.
    pub regions: Vec<RegionReport>,
    /// What was merged.
    pub patches: Vec<PatchReport>,
    /// How patches were moved onto the first, where they were aligned.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub poses: Vec<PoseReport>,
    /// What stands where no patch is, where a bound was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub completed: Option<CompletionReport>,
    /// Whether σ was told from how patches differ where none was stated.
    pub sigma_estimated: bool,
    /// Quantiles of σ of the whole, over its vertices.
    pub sigma: SigmaSummary,
    /// Triangles that sew patches together.
    pub stitched_triangles: usize,
    /// Holes closed.
    pub holes_closed: usize,
    /// `valence[n]`: vertices of seams where n edges meet.
    pub valence: Vec<usize>,
    /// The shapes of all triangles.
    pub quality: Option<TriangleQuality>,
    /// Files read.
    #[serde(skip)]
    pub inputs: Vec<PathBuf>,
    /// Unit of every length.
    #[serde(skip)]
    pub unit: Unit,
    /// What a user should know.
    pub warnings: Vec<String>,
}

/// A merged mesh.
#[derive(Debug, Clone)]
pub struct Merged {
    /// Positions and triangles.
    pub mesh: TriangleMesh,
    /// Unit normals of the vertices.
    pub normals: Vec<[f64; 3]>,
    /// σ along them.
    pub sigma: Vec<f64>,
    /// 1 where it was measured, 2 where it was completed.
    pub observed: Vec<u8>,
    /// What came of it.
    pub report: MergeReport,
}

/// Merges files: [`read_patches`], then [`merge`]. `bound` is a file of a surface that the thing lies within, taken where no patch is.
///
/// # Errors
/// As both.
pub fn merge_files(
    paths: &[PathBuf],
    bound: Option<&PathBuf>,
    options: &MergeOptions,
    progress: &dyn Progress,
) -> Result<Merged> {
    progress.check("reading", 0.0)?;
    let set = read_patches(paths, bound, options.unit, options.mesh_tolerance)?;
    merge(set, options, progress)
}

/// Merges patches.
///
/// # Errors
/// `Input` for fewer than two patches, copies not counted, and for options that are not positive; `Undetermined` where no two patches overlap, or a patch to be aligned lies on nothing as a part of it would; `Interrupted` when told to stop.
pub fn merge(set: PatchSet, options: &MergeOptions, progress: &dyn Progress) -> Result<Merged> {
    let PatchSet {
        patches: named,
        bound,
        unit,
        inputs,
        mut warnings,
    } = set;
    for named in named.iter().filter(|p| p.tidied.dropped > 0) {
        warnings.push(format!(
            "{}: {} triangles were left out, as other triangles have their edges already",
            named.name, named.tidied.dropped
        ));
    }
    let named = leave_out_copies(named, &mut warnings)?;
    let names: Vec<String> = named.iter().map(|p| p.name.clone()).collect();
    let observed: Vec<Vec<u8>> = named.iter().map(|p| p.observed.clone()).collect();
    let (mut patches, numbers): (Vec<Patch>, Vec<Vec<u32>>) =
        named.into_iter().map(|p| (p.tidied.patch, p.tidied.triangles)).unzip();
    progress.check("finding what patches share", 0.1)?;
    let (turned, mut searches) = turn_alike(&mut patches, options.align)?;
    let crossed = crossings(&searches, &names, &numbers);
    let crosses = !crossed.is_empty();
    warnings.extend(crossed);
    for (name, _) in names.iter().zip(&turned).filter(|(_, t)| **t) {
        warnings.push(format!(
            "{name} faced the other way than the patches that it lies on: it was turned over"
        ));
    }
    let poses = match options.align {
        true => {
            let part = Part::new(progress, 0.1, 0.3);
            let (poses, told) = align::align(&mut patches, &mut searches, &names, &part)?;
            warnings.extend(told);
            poses
        }
        false => Vec::new(),
    };
    let unit = unit.unwrap_or(Unit::Millimetre);
    // From here to the report, patches stand in an order that does not hang on that of the files.
    let order = order_in_space(&patches);
    let patches = in_order(patches, &order);
    let searches = in_order(searches, &order);
    let overlap = Overlap::find_with(
        &patches,
        &searches,
        &OverlapOptions {
            epsilon: options.epsilon.map(|epsilon| epsilon.in_unit(unit)),
            theta_rad: options.theta_deg.map(f64::to_radians),
        },
    )?;
    if overlap.regions.is_empty() {
        return Err(Error::undetermined(format!(
            "no two of the {} patches overlap: {}; check that they share one frame and unit, try --align, or give a larger --epsilon",
            patches.len(),
            nearest(&patches, &searches, &in_order(names, &order), unit)
        )));
    }
    for (k, name) in names.iter().enumerate() {
        if !overlap.regions.iter().any(|r| r.patches.iter().any(|p| order[*p] == k)) {
            warnings.push(format!("{name} overlaps no other patch: it stays a part of its own"));
        }
    }
    if options.epsilon.is_none() {
        let names = in_order(names.clone(), &order);
        warnings.extend(unalike(&patches, &overlap, &names, unit));
    }
    progress.check("fusing", 0.4)?;
    let mean = fused(&patches, &overlap);
    let part = Part::new(progress, 0.4, 0.7);
    let method = options.method.unwrap_or(match overlap.sigma_estimated {
        false => MergeMethod::Information,
        true => MergeMethod::Refit,
    });
    let fused = match method {
        MergeMethod::Information => refitted(&patches, &overlap, mean, Refit::Information, &part)?,
        MergeMethod::Refit => refitted(&patches, &overlap, mean, Refit::Shared, &part)?,
        MergeMethod::Mean => mean,
    };
    progress.check("sewing", 0.7)?;
    // Holes that are filled are not completed.
    let fill = if bound.is_some() { 0 } else { options.fill };
    let mut sewn = zipped(&patches, &overlap, &fused, &ZipOptions { fill })?;
    let completed = match &bound {
        Some(bound) => {
            let completed = completed(&sewn, &bound.tidied.patch, options.fill)?;
            warnings.extend(facing_in_words(completed.facing, &bound.name));
            sewn = joined(&sewn, completed.whole, patches.len() as u32);
            Some(CompletionReport {
                name: bound.name.clone(),
                vertices: completed.vertices,
                carved: completed.carved,
            })
        }
        None => None,
    };
    progress.check("checking", 0.95)?;
    let check = sewn.mesh.check();
    if crosses {
        let left = MeshSearch::try_new(&sewn.mesh)?.self_crossings().pairs;
        warnings.push(match left {
            0 => "the merged mesh crosses itself nowhere".to_owned(),
            pairs => format!("the merged mesh crosses itself, too: {pairs} pairs of its triangles"),
        });
    }
    let mut kept = vec![0; patches.len() + 1];
    for (patch, _) in &sewn.source {
        kept[*patch as usize] += 1;
    }
    for (at, k) in order.iter().enumerate().filter(|(at, _)| kept[*at] == 0) {
        let has_feet = (0..patches[at].mesh.positions.len()).any(|v| !overlap.patches[at].feet(v).is_empty());
        if has_feet {
            warnings.push(format!(
                "{}: none of its vertices is one of the mesh, as others lie farther within their patches or nearer together; what it says counts where these are put",
                names[*k]
            ));
        }
    }
    // Where each patch of the files stands.
    let mut stands = vec![0; order.len()];
    for (at, k) in order.iter().enumerate() {
        stands[*k] = at;
    }
    let report = MergeReport {
        method,
        vertices: check.vertices,
        triangles: check.triangles,
        boundary_edges: check.boundary_edges,
        nonmanifold_edges: check.nonmanifold_edges,
        watertight: check.watertight,
        parts: check.components,
        regions: overlap
            .regions
            .iter()
            .map(|r| RegionReport {
                patches: {
                    let [a, b] = r.patches.map(|p| order[p]);
                    [a.min(b), a.max(b)]
                },
                points: r.points,
                rms: r.rms,
            })
            .collect(),
        patches: (0..patches.len())
            .map(|k| PatchReport {
                name: names[k].clone(),
                triangles: patches[stands[k]].mesh.triangles.len(),
                vertices_kept: kept[stands[k]],
                turned_over: turned[k],
                sigma: SigmaSummary::of(overlap.patches[stands[k]].sigma.clone()).median,
            })
            .collect(),
        poses,
        completed,
        sigma_estimated: overlap.sigma_estimated,
        sigma: SigmaSummary::of(sewn.sigma.clone()),
        stitched_triangles: check.triangles - sewn.kept,
        holes_closed: sewn.holes_closed,
        valence: sewn.valence.clone(),
        quality: quality(&sewn.mesh),
        inputs,
        unit,
        warnings,
    };
    let observed = sewn
        .source
        .iter()
        .map(|(p, v)| match order.get(*p as usize).map(|k| &observed[*k]) {
            Some(of_patch) => of_patch.get(*v as usize).copied().unwrap_or(1),
            // Of the bound.
            None => 2,
        })
        .collect();
    Ok(Merged {
        normals: sewn.mesh.vertex_normals(),
        sigma: sewn.sigma,
        observed,
        mesh: sewn.mesh,
        report,
    })
}

/// Checks, before any work, that outputs can be written, in other files than the inputs: meshes, and what needs a [`MergedSpline`].
///
/// # Errors
/// `Unsupported` for other formats; `Input` for one name twice or that of an input; `Io` where nothing can be written.
pub fn plan_merged(outputs: &[PathBuf], inputs: &[PathBuf]) -> Result<MergedOutputs> {
    let mut planned = MergedOutputs::default();
    for output in plan_outputs(outputs, inputs)? {
        match output.format {
            format if format.is_mesh() => planned.meshes.push(output.path),
            OutputFormat::Step | OutputFormat::Planish => planned.splines.push(output),
            _ => {
                return Err(Error::unsupported(format!(
                    "{}: a merged surface is a mesh or a spline: needed .ply, .glb, .obj, .stl, .step or .planish",
                    output.path.display()
                )));
            }
        }
    }
    Ok(planned)
}

/// What is to be written of a merged surface.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MergedOutputs {
    /// Meshes.
    pub meshes: Vec<PathBuf>,
    /// STEP files and saved models, which need a spline.
    pub splines: Vec<PlannedOutput>,
}

/// Writes a merged mesh in the format of the path's extension.
///
/// # Errors
/// `Io` where the file cannot be written; `Input` for numbers that its format cannot hold.
pub fn write_merged(merged: &Merged, path: &Path, progress: &dyn Progress) -> Result<()> {
    progress.check(WRITING_STAGE, 0.97)?;
    write_known_mesh(
        path,
        &merged.mesh,
        &merged.normals,
        &merged.sigma,
        &merged.observed,
        merged.report.unit,
    )
}

/// The numbers of patches in the order of their first places in space.
fn order_in_space(patches: &[Patch]) -> Vec<usize> {
    let by = |a: &[f64; 3], b: &[f64; 3]| {
        let by = |k: usize| a[k].total_cmp(&b[k]);
        by(0).then(by(1)).then(by(2))
    };
    let first = |patch: &Patch| patch.mesh.positions.iter().copied().min_by(by);
    let firsts: Vec<Option<[f64; 3]>> = patches.iter().map(first).collect();
    let sorted = |k: usize| {
        let mut all = patches[k].mesh.positions.clone();
        all.sort_unstable_by(by);
        all
    };
    let mut order: Vec<usize> = (0..patches.len()).collect();
    order.sort_by(|i, j| match (&firsts[*i], &firsts[*j]) {
        // Patches that begin at one place differ later on.
        (Some(a), Some(b)) => by(a, b).then_with(|| {
            let (a, b) = (sorted(*i), sorted(*j));
            let differing = a.iter().zip(&b).map(|(a, b)| by(a, b)).find(|order| order.is_ne());
            differing.unwrap_or(a.len().cmp(&b.len()))
        }),
        (a, b) => a.is_some().cmp(&b.is_some()),
    });
    order
}

fn in_order<T>(of: Vec<T>, order: &[usize]) -> Vec<T> {
    let mut of: Vec<Option<T>> = of.into_iter().map(Some).collect();
    order.iter().filter_map(|k| of[*k].take()).collect()
}

/// A whole that was completed, with the sources of what was merged before; vertices of the bound are of patch `bound`.
fn joined(merged: &Zipped, mut whole: Zipped, bound: u32) -> Zipped {
    for source in &mut whole.source {
        *source = match *source {
            (0, v) => merged.source[v as usize],
            (_, v) => (bound, v),
        };
    }
    // Triangles that sewed before are among those kept now.
    whole.kept = whole.kept.saturating_sub(merged.mesh.triangles.len() - merged.kept);
    whole.holes_closed += merged.holes_closed;
    let longest = whole.valence.len().max(merged.valence.len());
    whole.valence.resize(longest, 0);
    for (n, count) in merged.valence.iter().enumerate() {
        whole.valence[n] += count;
    }
    whole
}

fn quality(mesh: &TriangleMesh) -> Option<TriangleQuality> {
    let (mut angles, mut aspects): (Vec<f64>, Vec<f64>) = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| planish_mesh::triangle_shape(&mesh.corners(t)))
        .unzip();
    angles.par_sort_unstable_by(f64::total_cmp);
    aspects.par_sort_unstable_by(f64::total_cmp);
    (!angles.is_empty()).then(|| TriangleQuality {
        smallest_angle_median_deg: quantile_of_sorted(&angles, 0.5).to_degrees(),
        smallest_angle_p1_deg: quantile_of_sorted(&angles, 0.01).to_degrees(),
        aspect_median: quantile_of_sorted(&aspects, 0.5),
        aspect_p99: quantile_of_sorted(&aspects, 0.99),
    })
}
