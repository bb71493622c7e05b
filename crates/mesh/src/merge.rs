//! Merges overlapping patches into one surface.
//!
//! In: triangle meshes in one frame, with or without σ along their normals. Out: one manifold mesh with σ,
//! the source patch of each vertex, and statistics of the seams.
//!
//! 1. [`Overlap`] finds the regions that patches share.
//! 2. [`fuse_patches`] moves shared vertices to the mean of all patches, weighted by information.
//! 3. [`stitch_patches`] assigns every region to one patch, removes the other triangles there, and closes the
//!    gaps with triangles between existing vertices.
//!
//! The last step is the zippering of R. Mohr, C. Zhao, G. Koscielny (*Fusion of 3D B-spline surface patches*,
//! 1994) and of G. Turk, M. Levoy (*Zippered polygon meshes*, 1994), without their clipping.
//!
//! Not guaranteed: watertightness where there is no patch. Patches that differ by more than ε stay separate.

mod border;
mod consistency;
mod front;
mod manifold;
mod overlap;
mod ownership;
mod shared_noise;
mod valence;

pub use consistency::{SigmaCheck, SigmaVerdict};
pub use overlap::{CommonRegion, Overlap, OverlapFoot, OverlapOptions, PatchOverlap, searches_of};
pub use shared_noise::{NoiseCorrelation, noise_correlation};

use crate::filling::close_loops;
use crate::mesh::TriangleMesh;
use front::{SeamInput, stitch};
use manifold::{manifold, one_fan_each};
use planish_core::{DVec3, DisjointSets};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Distance from its border, in edges, at which a patch has its full weight in a mean.
///
/// A smaller distance leaves steps where a patch ends. With a larger one, scans that see a place at a grazing
/// angle, and end close behind it, have too little weight there.
pub(crate) const TAPER: f64 = 2.5;
/// Maximum distance, in edges, between vertices that are joined across a gap.
///
/// A seam is one or two edges wide. A smaller reach leaves holes; a larger one bridges real gaps.
const REACH: f64 = 3.5;
/// Components with at most this number of triangles, or a tenth of the smallest patch if this is less, are
/// removed: they are remains of the cut or outliers.
const MAX_FRAGMENT: usize = 12;
/// Maximum number of edges of a hole in a seam that is closed.
///
/// Covers cost the cube of this number, and longer holes are rarely artefacts of the seam.
const MAX_SEAM_HOLE: usize = 60;

/// The manifold part of a mesh, with the origin of its vertices and triangles.
#[derive(Debug, Clone)]
pub struct ManifoldPatch {
    /// The patch.
    pub patch: MergePatch,
    /// For each vertex, its index in the original mesh.
    pub vertices: Vec<u32>,
    /// For each triangle, its index in the original mesh.
    pub triangles: Vec<u32>,
    /// Number of triangles that were removed.
    pub dropped: usize,
}

/// A patch to be merged: a mesh in the common frame, and its σ.
#[derive(Debug, Clone, Default)]
pub struct MergePatch {
    /// The surface, in the unit of the model.
    pub mesh: TriangleMesh,
    /// σ of each vertex along its normal; empty if it is not known.
    pub sigma: Vec<f64>,
}

impl MergePatch {
    /// Makes a mesh manifold: removes triangles beyond the second at an edge and splits vertices with several
    /// fans.
    ///
    /// # Errors
    /// `Input` if the numbers of σ and vertices differ, or if the mesh fails [`TriangleMesh::sanity_check`].
    ///
    /// # Examples
    /// ```
    /// use planish_mesh::{MergePatch, icosphere};
    /// let mut mesh = icosphere(1.0, 1);
    /// // A third triangle at an edge.
    /// mesh.triangles.push(mesh.triangles[0]);
    /// let patch = MergePatch::make_manifold(&mesh, &[])?;
    /// assert_eq!(patch.dropped, 1);
    /// assert!(patch.patch.mesh.check().manifold);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn make_manifold(mesh: &TriangleMesh, sigma: &[f64]) -> Result<ManifoldPatch> {
        mesh.sanity_check()?;
        if !sigma.is_empty() && sigma.len() != mesh.positions.len() {
            return Err(Error::input(format!(
                "expected one value of sigma for each of the {} vertices, found {}",
                mesh.positions.len(),
                sigma.len()
            )));
        }
        let kept = manifold(mesh);
        let sigma = if sigma.is_empty() {
            Vec::new()
        } else {
            kept.source.iter().map(|v| sigma[*v as usize]).collect()
        };
        Ok(ManifoldPatch {
            patch: Self { mesh: kept.mesh, sigma },
            dropped: mesh.triangles.len() - kept.triangles.len(),
            vertices: kept.source,
            triangles: kept.triangles,
        })
    }
}

/// Fused positions of the vertices of a patch, and their σ.
#[derive(Debug, Clone, Default)]
pub struct FusedVertices {
    /// New position of each vertex.
    pub positions: Vec<DVec3>,
    /// σ of each vertex along its normal.
    pub sigma: Vec<f64>,
}

/// Options of [`stitch_patches`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StitchOptions {
    /// Maximum number of edges of holes that are closed without new vertices, including holes of the patches.
    ///
    /// Default: 0, which closes only holes of the seams.
    pub notches: usize,
}

/// Patches stitched into one mesh.
#[derive(Debug, Clone)]
pub struct StitchedMesh {
    /// The mesh.
    pub mesh: TriangleMesh,
    /// σ of each vertex along its normal.
    pub sigma: Vec<f64>,
    /// For each vertex, its patch and its index there.
    pub source: Vec<(u32, u32)>,
    /// For each vertex, true if it belongs to a triangle of a seam.
    pub stitched: Vec<bool>,
    /// Number of triangles from the patches; they come first. The others belong to the seams.
    pub kept: usize,
    /// Number of closed holes, in seams and (if requested) in patches.
    pub holes_closed: usize,
    /// Number of small components that were removed.
    pub fragments: usize,
    /// Number of edges that were flipped to even out the valence.
    pub turned: usize,
    /// Histogram of the valence of seam vertices: entry `n` counts vertices with `n` edges.
    pub valence: Vec<usize>,
}

/// Weight of a point of a patch, by its distance to the border: 0 at the border, 1 from 2.5 edges on, and
/// smooth (3t² − 2t³) between. A patch without a border (NaN or infinite distance) has the weight 1.
///
/// `to_border` and `spacing` (mean edge length) are in the unit of the model.
///
/// # Examples
/// ```
/// assert_eq!(planish_mesh::taper(0.0, 1.0), 0.0);
/// assert_eq!(planish_mesh::taper(2.5, 1.0), 1.0);
/// assert_eq!(planish_mesh::taper(f64::INFINITY, 1.0), 1.0);
/// ```
#[must_use]
pub fn taper(to_border: f64, spacing: f64) -> f64 {
    // Interpolation of infinite distances gives NaN (∞ · 0): no border.
    if to_border.is_nan() {
        return 1.0;
    }
    let t = (to_border / (TAPER * spacing).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Moves shared vertices along their normals to the weighted mean of all patches.
///
/// `h = Σ_k w_k h_k / Σ_k w_k` with `w_k = t_k / σ_k²`, where `h` is the height over the vertex. The factor
/// `t` ([`taper`]) rises from 0 at the border of a patch to 1 inside, so that no step remains where a patch
/// ends. Errors of different patches are assumed to be independent: `σ² = Σ w_k² σ_k² / (Σ w_k)²`. Of errors
/// that count as shared ([`PatchOverlap::shared_variance`]), the mean of σ is added. The result does not
/// depend on the order of the patches.
#[must_use]
pub fn fuse_patches(patches: &[MergePatch], overlap: &Overlap) -> Vec<FusedVertices> {
    patches
        .iter()
        .zip(&overlap.patches)
        .map(|(patch, own_overlap)| {
            let at = |v: usize| {
                let variance = own_overlap.sigma[v] * own_overlap.sigma[v];
                // Not zero at the border: without another patch, the mean would be 0/0.
                let own = taper(own_overlap.to_border[v], own_overlap.spacing[v]).max(1e-6);
                let (mut weight, mut squares, mut sum) = (own / variance, own * own / variance, 0.0);
                // Weighted sums of the variances of own errors and of the σ of errors that patches share.
                let mut shared = own / variance * (own_overlap.shared_variance * variance).sqrt();
                squares *= 1.0 - own_overlap.shared_variance;
                // Feet beyond a border would extrapolate the other patch.
                for foot in own_overlap.feet(v).iter().filter(|f| !f.beyond_border) {
                    let (other, other_overlap) =
                        (&patches[foot.patch as usize].mesh, &overlap.patches[foot.patch as usize]);
                    let read =
                        |values: &[f64]| other.interpolate(values, foot.triangle as usize, foot.barycentric);
                    let sigma = read(&other_overlap.sigma);
                    let t = taper(read(&other_overlap.to_border), read(&other_overlap.spacing));
                    let w = t / (sigma * sigma);
                    weight += w;
                    squares += t * w * (1.0 - other_overlap.shared_variance);
                    shared += w * sigma * other_overlap.shared_variance.sqrt();
                    // Heights are relative to this vertex, so its own height is zero and adds nothing to
                    // the sum.
                    sum += w * foot.height;
                }
                let position = patch.mesh.positions[v] + sum / weight * own_overlap.normals[v];
                (position, squares.sqrt().hypot(shared) / weight)
            };
            let (positions, sigma) = (0..patch.mesh.positions.len()).into_par_iter().map(at).unzip();
            FusedVertices { positions, sigma }
        })
        .collect()
}

/// Stitches fused patches into one mesh with manifold edges and vertices.
///
/// Every region is assigned to the patch whose border is farthest away; among equals, to the first.
///
/// # Errors
/// `Input` if `fused` does not have one position and one σ for each vertex of each patch.
///
/// # Examples
/// ```
/// use planish_mesh::{
///     MergePatch, Overlap, OverlapOptions, StitchOptions, fuse_patches, grid_sheet, stitch_patches,
/// };
///
/// // Two sheets that overlap by a quarter of their width.
/// let left = grid_sheet(8.0, 8.0, 16, 16);
/// let mut right = left.clone();
/// right.positions.iter_mut().for_each(|p| p[0] += 6.2);
/// let patches = [left, right].map(|mesh| {
///     let sigma = vec![0.01; mesh.positions.len()];
///     MergePatch { mesh, sigma }
/// });
/// let overlap = Overlap::find(&patches, &OverlapOptions::default())?;
/// let fused = fuse_patches(&patches, &overlap);
/// let stitched = stitch_patches(&patches, &overlap, &fused, &StitchOptions::default())?;
/// let check = stitched.mesh.check();
/// assert!(check.manifold && check.components == 1);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn stitch_patches(
    patches: &[MergePatch],
    overlap: &Overlap,
    fused: &[FusedVertices],
    options: &StitchOptions,
) -> Result<StitchedMesh> {
    check_fused(patches, fused)?;
    let mut seams = CutPatches::new(patches, overlap, fused);
    let kept = seams.triangles.len();
    seams.stitch();
    let holes_closed = seams.close_holes(options.notches);
    let CutPatches { triangles, source, positions, .. } = seams;
    // The cut and the holes can leave several fans at a vertex. They are split only now: a seam may have
    // joined them again, and a hole between two copies of one vertex would get triangles without area.
    let (mut triangles, again) = one_fan_each(triangles, positions.len());
    let smallest = patches.iter().map(|p| p.mesh.triangles.len()).min().unwrap_or(0);
    // The limit shrinks with the smallest patch, which would otherwise be removed as a fragment itself.
    let (kept, fragments) =
        drop_fragments(&mut triangles, kept, again.len(), (smallest / 10).min(MAX_FRAGMENT));
    let left = renumber(&mut triangles, again.len());
    let of_old: Vec<u32> = left.into_iter().map(|v| again[v as usize]).collect();
    let positions: Vec<DVec3> = of_old.iter().map(|v| positions[*v as usize]).collect();
    let source: Vec<(u32, u32)> = of_old.iter().map(|v| source[*v as usize]).collect();
    let mut stitched = vec![false; positions.len()];
    for t in &triangles[kept..] {
        for v in t {
            stitched[*v as usize] = true;
        }
    }
    // Valence is last, because fragments and split fans would still change it. Patches have vertices of their
    // own with too many edges, mostly at the borders of scans, so the whole mesh is evened out.
    let (turned, valence) = valence::even_out(&positions, &mut triangles, &stitched);
    let sigma = source.iter().map(|&(patch, v)| fused[patch as usize].sigma[v as usize]).collect();
    Ok(StitchedMesh {
        mesh: TriangleMesh::try_new(positions, triangles)?,
        sigma,
        source,
        valence: histogram(&valence, &stitched),
        stitched,
        kept,
        holes_closed,
        fragments,
        turned,
    })
}

/// Rejects fused vertices that do not match the patches.
fn check_fused(patches: &[MergePatch], fused: &[FusedVertices]) -> Result<()> {
    let matches = fused.len() == patches.len()
        && fused
            .iter()
            .zip(patches)
            .all(|(f, p)| f.positions.len() == p.mesh.positions.len() && f.sigma.len() == f.positions.len());
    if !matches {
        return Err(Error::input("expected one fused position and one sigma for each vertex of each patch"));
    }
    Ok(())
}

/// The patches after the cut as one mesh, with gaps where seams will be.
struct CutPatches {
    triangles: Vec<[u32; 3]>,
    /// For each vertex, its patch and its index there.
    source: Vec<(u32, u32)>,
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    /// Maximum length of the new edges at a vertex.
    reach: Vec<f64>,
    /// True for vertices that were on the border of their patch before the cut.
    was_border: Vec<bool>,
}

impl CutPatches {
    /// Keeps the triangles of one patch in every region.
    fn new(patches: &[MergePatch], overlap: &Overlap, fused: &[FusedVertices]) -> Self {
        let kept = ownership::kept_triangles(patches, overlap);
        let starts: Vec<u32> = patches
            .iter()
            .scan(0, |sum, p| {
                let start = *sum;
                *sum += p.mesh.positions.len() as u32;
                Some(start)
            })
            .collect();
        let mut triangles: Vec<[u32; 3]> = Vec::new();
        for ((patch, kept), start) in patches.iter().zip(&kept).zip(&starts) {
            let of_patch = patch.mesh.triangles.iter().zip(kept);
            triangles.extend(of_patch.filter(|(_, k)| **k).map(|(t, _)| t.map(|v| v + start)));
        }
        // Vertices of all patches are numbered in one row, so the patch follows from the start indices.
        let patch_of = |v: u32| starts.partition_point(|s| *s <= v) - 1;
        let count: usize = patches.iter().map(|p| p.mesh.positions.len()).sum();
        let source: Vec<(u32, u32)> = renumber(&mut triangles, count)
            .iter()
            .map(|&v| {
                let patch = patch_of(v);
                (patch as u32, v - starts[patch])
            })
            .collect();
        let each = || source.iter().map(|of| (of.0 as usize, of.1 as usize));
        Self {
            positions: each().map(|(p, v)| fused[p].positions[v]).collect(),
            normals: each().map(|(p, v)| overlap.patches[p].normals[v]).collect(),
            reach: each().map(|(p, v)| REACH * overlap.patches[p].spacing[v]).collect(),
            was_border: each().map(|(p, v)| overlap.patches[p].to_border[v] == 0.0).collect(),
            triangles,
            source,
        }
    }

    /// Adds triangles between different patches, and along edges that the cut has opened.
    fn stitch(&mut self) {
        let Self { triangles, source, positions, normals, reach, was_border } = self;
        // Three vertices on the original border of one patch enclose a real notch, which must stay open.
        let may_join = |t: [u32; 3]| {
            let [a, b, c] = t.map(|v| v as usize);
            !(was_border[a] && was_border[b] && was_border[c])
                || source[a].0 != source[b].0
                || source[b].0 != source[c].0
        };
        stitch(&SeamInput { positions, normals, reach, may_join: &may_join }, triangles);
    }

    /// Closes the holes that the front left in seams, and all holes of up to `notches` edges. Returns their
    /// number.
    fn close_holes(&mut self, notches: usize) -> usize {
        let Self { triangles, source, positions, normals, reach, was_border } = self;
        let of_seam = |hole: &[u32]| {
            let [first, rest @ ..] = hole else { return false };
            let cut = hole.iter().any(|v| !was_border[*v as usize])
                || rest.iter().any(|v| source[*v as usize].0 != source[*first as usize].0);
            let edges = (0..hole.len()).map(|k| [hole[k], hole[(k + 1) % hole.len()]]);
            let length: f64 = edges.map(|[a, b]| positions[a as usize].distance(positions[b as usize])).sum();
            let longest_reach = hole.iter().map(|v| reach[*v as usize]).fold(0.0, f64::max);
            // A hole that could have been stitched across has a circumference of at most four reaches. A
            // longer one is a gap between the patches.
            hole.len() <= notches || cut && length <= 4.0 * longest_reach
        };
        close_loops(positions, normals, triangles, MAX_SEAM_HOLE.max(notches), of_seam)
    }
}

/// The number of stitched vertices with each valence.
fn histogram(valence: &[u32], stitched: &[bool]) -> Vec<usize> {
    let mut histogram = Vec::new();
    for (v, n) in valence.iter().enumerate() {
        if stitched[v] {
            histogram.resize(histogram.len().max(*n as usize + 1), 0);
            histogram[*n as usize] += 1;
        }
    }
    histogram
}

/// Renumbers the used vertices in their order and returns the old index of each.
fn renumber(triangles: &mut [[u32; 3]], count: usize) -> Vec<u32> {
    let mut used = vec![false; count];
    for v in triangles.iter().flatten() {
        used[*v as usize] = true;
    }
    let old: Vec<u32> = (0..count as u32).filter(|v| used[*v as usize]).collect();
    let mut new = vec![0; count];
    for (n, &v) in old.iter().enumerate() {
        new[v as usize] = n as u32;
    }
    for t in triangles {
        *t = t.map(|v| new[v as usize]);
    }
    old
}

/// Removes components of at most `smallest` triangles: remains of the cut, or single outliers.
///
/// Returns how many of the first `kept` triangles remain, and how many components were removed.
fn drop_fragments(
    triangles: &mut Vec<[u32; 3]>,
    kept: usize,
    vertices: usize,
    smallest: usize,
) -> (usize, usize) {
    let mut parts = DisjointSets::new(vertices);
    for t in triangles.iter() {
        parts.join(t[0], t[1]);
        parts.join(t[0], t[2]);
    }
    let mut size = vec![0_usize; vertices];
    for t in triangles.iter() {
        size[parts.root(t[0]) as usize] += 1;
    }
    // Sizes stand at the roots only. All other entries are zero and must not count as fragments.
    let fragments = size.iter().filter(|n| (1..=smallest).contains(*n)).count();
    let mut stays = |t: &[u32; 3]| size[parts.root(t[0]) as usize] > smallest;
    let left = triangles[..kept].iter().filter(|t| stays(t)).count();
    triangles.retain(stays);
    (left, fragments)
}

#[cfg(test)]
mod tests;
