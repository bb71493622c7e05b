//! Patches that overlap, merged into one surface.
//!
//! Comes in: triangle meshes in one frame, with σ along their normals or without. Goes out: one mesh,
//! manifold whatever came in, with σ, the patch each vertex is of, and how it was sewn.
//!
//! Places that patches share ([`Overlap`]) are put where all of them say, weighed with their information
//! ([`fused`]); then every place is given to one patch ([`zipped`]), what lies under it is cut away, and the
//! gaps are sewn with the vertices that are there, which is the zipper of R. Mohr, C. Zhao, G. Koscielny
//! (*Fusion of 3D B-spline surface patches*, 1994) and of G. Turk, M. Levoy (*Zippered polygon meshes*,
//! 1994), without their clipping.
//!
//! Not guaranteed: watertightness where no patch is; that patches that differ by more than ε become one.

mod border;
mod front;
mod manifold;
mod overlap;
mod ownership;
mod shared_noise;
mod valence;

pub use overlap::{CommonRegion, Overlap, OverlapFoot, OverlapOptions, PatchOverlap, searches_of};
pub use shared_noise::{NoiseLikeness, noise_likeness};

use crate::filling::close_loops;
use crate::mesh::TriangleMesh;
use crate::sets::DisjointSets;
use front::{SeamInput, sew};
use manifold::{manifold, one_fan_each};
use planish_estimate::vector3::{add_scaled, distance};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Over so many edges from its border a patch gains its whole weight in a mean. Over more of them scans that
/// see a place at a slant, and end soon behind it, count for too little there.
pub(crate) const TAPER: f64 = 2.5;
/// Vertices are sewn to others up to so many edges away.
const REACH: f64 = 3.5;
/// Edges so many steps from the seams may be turned.
const BESIDE_SEAMS: usize = 3;
/// Parts of no more triangles are left out.
const SMALLEST_PART: usize = 12;
/// Holes of the seam with more edges are not closed.
const LONGEST_SEAM_HOLE: usize = 60;

/// A patch made manifold, and what it is of.
#[derive(Debug, Clone)]
pub struct Tidied {
    /// The patch.
    pub patch: Patch,
    /// The vertex that each of its vertices was.
    pub vertices: Vec<u32>,
    /// The triangle that each of its triangles was.
    pub triangles: Vec<u32>,
    /// Triangles left out.
    pub dropped: usize,
}

/// A patch to be merged.
#[derive(Debug, Clone, Default)]
pub struct Patch {
    /// Its surface.
    pub mesh: TriangleMesh,
    /// σ along the normal, one of each vertex; none where it is not known.
    pub sigma: Vec<f64>,
}

impl Patch {
    /// A patch whose edges and vertices are manifold: triangles beyond the second at an edge are left out,
    /// and fans taken apart.
    ///
    /// # Errors
    /// `Input` for σ of another number than vertices, or a mesh that fails [`TriangleMesh::sanity_check`].
    pub fn tidy(mesh: &TriangleMesh, sigma: &[f64]) -> Result<Tidied> {
        mesh.sanity_check()?;
        if !sigma.is_empty() && sigma.len() != mesh.positions.len() {
            return Err(Error::input(format!(
                "{} vertices and {} values of sigma: one for each is needed",
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
        Ok(Tidied {
            patch: Self { mesh: kept.mesh, sigma },
            dropped: mesh.triangles.len() - kept.triangles.len(),
            vertices: kept.source,
            triangles: kept.triangles,
        })
    }
}

/// Where the vertices of a patch come to lie, and σ there.
#[derive(Debug, Clone, Default)]
pub struct Fused {
    /// New places.
    pub positions: Vec<[f64; 3]>,
    /// σ along the normals.
    pub sigma: Vec<f64>,
}

/// How patches are sewn.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ZipOptions {
    /// Holes of up to so many edges are closed without new vertices, those of the patches too. None are where
    /// it is zero.
    pub notches: usize,
}

/// Patches sewn into one mesh.
#[derive(Debug, Clone)]
pub struct Zipped {
    /// The mesh.
    pub mesh: TriangleMesh,
    /// σ along the normal.
    pub sigma: Vec<f64>,
    /// The patch each vertex is of, and its number there.
    pub source: Vec<(u32, u32)>,
    /// Whether a triangle of the seams meets the vertex.
    pub stitched: Vec<bool>,
    /// Triangles of the patches that were kept; the others are the seams'.
    pub kept: usize,
    /// Holes of the seams, and of the patches where asked for, that were closed.
    pub holes_closed: usize,
    /// Parts of a few triangles that were left out.
    pub fragments: usize,
    /// Edges that were turned to even out how many meet at a vertex.
    pub turned: usize,
    /// How many vertices of the seams have how many edges.
    pub valence: Vec<usize>,
}

/// The weight of a place of a patch: nothing at the border, one from 2.5 edges on, smooth between; one where
/// there is no border.
#[must_use]
pub fn taper(to_border: f64, spacing: f64) -> f64 {
    // Infinitely far times no weight of a corner is no number.
    if to_border.is_nan() {
        return 1.0;
    }
    let t = (to_border / (TAPER * spacing).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Vertices moved along their normals to where all patches together see the surface.
///
/// `h = Σ_k w_k h_k / Σ_k w_k` with `w_k = t_k / σ_k²`, `h` the height over the vertex, and `t` from nothing
/// at the border of a patch to one in its middle, so that no step is left where a patch ends. Errors of
/// different patches are taken as independent: `σ² = Σ w_k² σ_k² / (Σ w_k)²`. The order of the patches does
/// not matter.
#[must_use]
pub fn fused(patches: &[Patch], overlap: &Overlap) -> Vec<Fused> {
    patches
        .iter()
        .zip(&overlap.patches)
        .map(|(patch, mine)| {
            let at = |v: usize| {
                let variance = mine.sigma[v] * mine.sigma[v];
                let own = taper(mine.to_border[v], mine.spacing[v]).max(1e-6);
                let (mut weight, mut squares, mut sum) = (own / variance, own * own / variance, 0.0);
                for foot in mine.feet(v).iter().filter(|f| !f.beside) {
                    let (other, theirs) =
                        (&patches[foot.patch as usize].mesh, &overlap.patches[foot.patch as usize]);
                    let read =
                        |values: &[f64]| other.interpolate(values, foot.triangle as usize, foot.barycentric);
                    let sigma = read(&theirs.sigma);
                    let t = taper(read(&theirs.to_border), read(&theirs.spacing));
                    let w = t / (sigma * sigma);
                    weight += w;
                    squares += t * w;
                    sum += w * foot.height;
                }
                let position = add_scaled(patch.mesh.positions[v], sum / weight, mine.normals[v]);
                (position, squares.sqrt() / weight)
            };
            let (positions, sigma) = (0..patch.mesh.positions.len()).into_par_iter().map(at).unzip();
            Fused { positions, sigma }
        })
        .collect()
}

/// Patches whose common places agree, sewn into one mesh.
///
/// Every place is given to the patch whose border is farthest, the first of several. Edges and vertices of
/// the result are manifold.
///
/// # Errors
/// `Input` where the vertices of `fused` are not those of the patches.
pub fn zipped(patches: &[Patch], overlap: &Overlap, fused: &[Fused], options: &ZipOptions) -> Result<Zipped> {
    let same = fused.len() == patches.len()
        && fused
            .iter()
            .zip(patches)
            .all(|(f, p)| f.positions.len() == p.mesh.positions.len() && f.sigma.len() == f.positions.len());
    if !same {
        return Err(Error::input("a place and a sigma are needed for each vertex of each patch"));
    }
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
    let patch_of = |v: u32| starts.partition_point(|s| *s <= v) - 1;
    let count: usize = patches.iter().map(|p| p.mesh.positions.len()).sum();
    // Fans that meet in a vertex after cutting may be sewn together again: they are taken apart last.
    let vertex = renumber(&mut triangles, count);
    let source: Vec<(u32, u32)> = vertex
        .iter()
        .map(|&v| {
            let patch = patch_of(v);
            (patch as u32, v - starts[patch])
        })
        .collect();
    let read = |of: &(u32, u32)| (of.0 as usize, of.1 as usize);
    let positions: Vec<[f64; 3]> = source.iter().map(read).map(|(p, v)| fused[p].positions[v]).collect();
    let normals: Vec<[f64; 3]> =
        source.iter().map(read).map(|(p, v)| overlap.patches[p].normals[v]).collect();
    let reach: Vec<f64> =
        source.iter().map(read).map(|(p, v)| REACH * overlap.patches[p].spacing[v]).collect();
    let was_border: Vec<bool> =
        source.iter().map(read).map(|(p, v)| overlap.patches[p].to_border[v] == 0.0).collect();
    let kept = triangles.len();
    let may_join = |t: [u32; 3]| {
        let [a, b, c] = t.map(|v| v as usize);
        !(was_border[a] && was_border[b] && was_border[c])
            || source[a].0 != source[b].0
            || source[b].0 != source[c].0
    };
    sew(
        &SeamInput { positions: &positions, normals: &normals, reach: &reach, may_join: &may_join },
        &mut triangles,
    );
    let of_seam = |hole: &[u32]| {
        let [first, rest @ ..] = hole else { return false };
        let cut = hole.iter().any(|v| !was_border[*v as usize])
            || rest.iter().any(|v| source[*v as usize].0 != source[*first as usize].0);
        let edges = (0..hole.len()).map(|k| [hole[k], hole[(k + 1) % hole.len()]]);
        let length: f64 = edges.map(|[a, b]| distance(positions[a as usize], positions[b as usize])).sum();
        let most = hole.iter().map(|v| reach[*v as usize]).fold(0.0, f64::max);
        // Once round a hole that could have been sewn across.
        hole.len() <= options.notches || cut && length <= 4.0 * most
    };
    let longest = LONGEST_SEAM_HOLE.max(options.notches);
    let holes_closed = close_loops(&positions, &normals, &mut triangles, longest, of_seam);
    let (mut triangles, again) = one_fan_each(triangles, positions.len());
    let smallest = patches.iter().map(|p| p.mesh.triangles.len()).min().unwrap_or(0);
    let (kept, fragments) =
        drop_fragments(&mut triangles, kept, again.len(), (smallest / 10).min(SMALLEST_PART));
    let left = renumber(&mut triangles, again.len());
    let of_old: Vec<u32> = left.into_iter().map(|v| again[v as usize]).collect();
    let positions: Vec<[f64; 3]> = of_old.iter().map(|v| positions[*v as usize]).collect();
    let source: Vec<(u32, u32)> = of_old.iter().map(|v| source[*v as usize]).collect();
    let mut stitched = vec![false; positions.len()];
    for t in &triangles[kept..] {
        for v in t {
            stitched[*v as usize] = true;
        }
    }
    let (turned, valence) = valence::even_out(&positions, &mut triangles, &stitched, BESIDE_SEAMS);
    let mut histogram = Vec::new();
    for (v, n) in valence.into_iter().enumerate() {
        if stitched[v] {
            histogram.resize(histogram.len().max(n as usize + 1), 0);
            histogram[n as usize] += 1;
        }
    }
    let sigma = source.iter().map(read).map(|(p, v)| fused[p].sigma[v]).collect();
    Ok(Zipped {
        mesh: TriangleMesh::try_new(positions, triangles)?,
        sigma,
        source,
        stitched,
        kept,
        holes_closed,
        fragments,
        turned,
        valence: histogram,
    })
}

/// Numbers the vertices in use anew, in their order; gives the old number of each.
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

/// Leaves out parts of at most `smallest` triangles: what was left over where patches lie on one another, or
/// single wrong readings. Gives how many of the first `kept` triangles are left, and how many parts are not.
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
    let fragments = size.iter().filter(|n| (1..=smallest).contains(*n)).count();
    let mut stays = |t: &[u32; 3]| size[parts.root(t[0]) as usize] > smallest;
    let left = triangles[..kept].iter().filter(|t| stays(t)).count();
    triangles.retain(stays);
    (left, fragments)
}

#[cfg(test)]
mod tests;
