//! Overlaps between patches.
//!
//! In: patches with σ. Out: for every vertex, its foot points on other patches that agree in position and
//! normal (R. Mohr, C. Zhao, G. Koscielny 1994, eq. 1: `|a − b| ≤ ε`, `∠(N_a, N_b) ≤ θ`), and the common
//! regions. The paper uses the nearest vertex and one ε for all points. Here the foot point is the nearest
//! point of the other surface, and ε follows from both σ at this point, unless it is given.
//!
//! Not guaranteed: that overlapping patches belong to the same surface. The two sides of a sheet that is
//! thinner than ε are distinguished only by their normals.

use super::MergePatch;
use super::border::distance_to_border;
use super::consistency::{SigmaCheck, SigmaVerdict, check_sigma};
use crate::search::MeshSearch;
use planish_core::DisjointSets;
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Maximum difference of two measurements of one point, in σ of the difference.
///
/// 99 % of the differences are smaller (χ² with one degree of freedom, 6.63). Larger ones rarely affect all
/// three corners of a triangle, so almost no triangle is kept twice. With 3 σ, scans whose errors exceed
/// their σ are drawn together: the bunny scans have fewer open edges (765 instead of 1235), but are farther
/// from all points (rms 0.1878 mm instead of 0.1852 mm; see decision 0072).
pub(super) const GATE: f64 = 2.576;
/// Angle between the normals of two samplings of one surface that is due to shape, without noise.
///
/// A smaller angle separates patches at sharp edges; a larger one joins the sides of thin parts.
const SHAPE_ANGLE_RAD: f64 = 0.5;
/// Upper limit of θ, so that the two sides of a thin part are distinguished.
pub(super) const MAX_ANGLE_RAD: f64 = 1.2;
/// Maximum distance to a border, in edges, that is computed. Points farther inside are assigned to a patch by
/// other criteria.
pub(super) const MAX_BORDER_DISTANCE: f64 = 10.0;
/// Distance beyond a border, in edges, up to which a vertex counts as overlapping.
///
/// Triangles between the border and a nearer vertex would be slivers.
const BEYOND_BORDER: f64 = 0.5;

/// Conditions for two points to be the same point of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OverlapOptions {
    /// Maximum distance ε in the unit of the patches; by default 2.576 σ of the difference.
    pub epsilon: Option<f64>,
    /// Maximum angle θ between normals in radians; by default derived from σ and the edge length.
    pub theta_rad: Option<f64>,
    /// Whether stated σ are used unchanged, although differences may show that they are too small.
    pub believe_sigma: bool,
}

/// The foot point of a vertex on another patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OverlapFoot {
    /// The other patch.
    pub patch: u32,
    /// Triangle of the other patch.
    pub triangle: u32,
    /// Barycentric coordinates in the triangle.
    pub barycentric: [f64; 3],
    /// Height of the foot point along the normal of the vertex.
    pub height: f64,
    /// True if the vertex lies beyond the border of the other patch, by less than half an edge.
    pub beyond_border: bool,
}

/// One patch with its foot points on the others.
#[derive(Debug, Clone)]
pub struct PatchOverlap {
    /// Unit normals of the vertices.
    pub normals: Vec<DVec3>,
    /// σ of the vertices: as stated, or enlarged by the factor of `check`.
    pub sigma: Vec<f64>,
    /// Test of the stated σ; none without a stated σ or without enough differences.
    pub check: Option<SigmaCheck>,
    /// Share of the variance that counts as common to all patches, so that fusing does not reduce it.
    pub shared_variance: f64,
    /// Distance of the vertices to the border of the patch, limited to ten edges; infinite without a border.
    pub to_border: Vec<f64>,
    /// Mean length of the edges at each vertex.
    pub spacing: Vec<f64>,
    starts: Vec<u32>,
    feet: Vec<OverlapFoot>,
}

/// A common region of two patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommonRegion {
    /// Both patches, the lower number first.
    pub patches: [usize; 2],
    /// Number of vertices of either patch that lie on the other.
    pub points: usize,
    /// Root mean square distance between both patches in the region, along normals. Distances above ε are
    /// not part of the region.
    pub rms: f64,
    /// ε at these vertices, on average.
    pub epsilon: f64,
    /// θ between both patches.
    pub theta_rad: f64,
}

/// The overlaps of a set of patches.
///
/// # Examples
/// ```
/// use planish_mesh::{MergePatch, Overlap, OverlapOptions, grid_sheet};
/// let below = grid_sheet(4.0, 4.0, 8, 8);
/// let mut above = below.clone();
/// above.positions.iter_mut().for_each(|p| p[2] += 0.01);
/// let patches = [below, above].map(|mesh| {
///     let sigma = vec![0.01; mesh.positions.len()];
///     MergePatch { mesh, sigma }
/// });
/// let overlap = Overlap::find(&patches, &OverlapOptions::default())?;
/// assert_eq!(overlap.regions.len(), 1);
/// assert!((overlap.regions[0].rms - 0.01).abs() < 1e-9);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Overlap {
    /// One entry for each patch.
    pub patches: Vec<PatchOverlap>,
    /// Connected regions shared by two patches, largest first.
    pub regions: Vec<CommonRegion>,
    /// True if a patch had no σ, so that it was estimated from the differences between patches.
    pub sigma_estimated: bool,
}

impl PatchOverlap {
    /// The foot points of a vertex, at most one on each other patch.
    #[must_use]
    pub fn feet(&self, vertex: usize) -> &[OverlapFoot] {
        &self.feet[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

impl Overlap {
    /// Finds the overlaps. Cost O(n log n) for a total of n vertices.
    ///
    /// # Errors
    /// `Input` for fewer than two patches, a patch without triangles, or σ that is not positive and finite
    /// for each vertex.
    pub fn find(patches: &[MergePatch], options: &OverlapOptions) -> Result<Self> {
        check(patches, options)?;
        Self::find_with(patches, &searches_of(patches)?, options)
    }

    /// [`Overlap::find`] with existing searches, one for each patch.
    ///
    /// # Errors
    /// As [`Overlap::find`]; `Input` if the numbers of searches and patches differ.
    pub fn find_with(
        patches: &[MergePatch],
        searches: &[MeshSearch],
        options: &OverlapOptions,
    ) -> Result<Self> {
        check(patches, options)?;
        if searches.len() != patches.len() {
            return Err(Error::input(format!(
                "expected one search for each of the {} patches, found {}",
                patches.len(),
                searches.len()
            )));
        }
        let mut known: Vec<PatchOverlap> = patches.par_iter().map(Self::alone).collect();
        let estimated = patches.iter().any(|p| p.sigma.is_empty());
        let checks = check_sigma(patches, searches, &known);
        for (known, check) in known.iter_mut().zip(checks) {
            known.check = check;
            let Some(check) = check.filter(|_| !options.believe_sigma) else { continue };
            match check.verdict {
                SigmaVerdict::Consistent => {}
                SigmaVerdict::TooSmall => known.sigma.iter_mut().for_each(|s| *s *= check.factor),
                SigmaVerdict::Shared => known.shared_variance = 1.0 - check.factor * check.factor,
            }
        }
        if estimated {
            estimate_sigma(patches, searches, &mut known);
        }
        // Noise of the vertices tilts the normals by about 2σ over an edge, which θ has to allow for.
        let theta = |overlap: &PatchOverlap| {
            options.theta_rad.unwrap_or_else(|| {
                let (sigma, spacing) = (median(&overlap.sigma), median(&overlap.spacing));
                (SHAPE_ANGLE_RAD + GATE * (2.0 * sigma / spacing).atan()).min(MAX_ANGLE_RAD)
            })
        };
        let thetas: Vec<f64> = known.iter().map(theta).collect();
        let found: Vec<(Vec<u32>, Vec<OverlapFoot>)> =
            (0..patches.len()).map(|i| feet_of(i, patches, searches, &known, &thetas, options)).collect();
        for (known, (starts, feet)) in known.iter_mut().zip(found) {
            known.starts = starts;
            known.feet = feet;
        }
        let regions = common_regions(patches, &known, &thetas, options);
        Ok(Self { patches: known, regions, sigma_estimated: estimated })
    }

    /// Quantities of a patch that do not depend on the others.
    fn alone(patch: &MergePatch) -> PatchOverlap {
        let mesh = &patch.mesh;
        let (mut sum, mut count) = (vec![0.0; mesh.positions.len()], vec![0_u32; mesh.positions.len()]);
        for t in &mesh.triangles {
            for k in 0..3 {
                let (a, b) = (t[k] as usize, t[(k + 1) % 3] as usize);
                let length = mesh.positions[a].distance(mesh.positions[b]);
                for v in [a, b] {
                    sum[v] += length;
                    count[v] += 1;
                }
            }
        }
        let spacing: Vec<f64> = sum.iter().zip(&count).map(|(s, n)| s / f64::from((*n).max(1))).collect();
        let limit = MAX_BORDER_DISTANCE * median(&spacing);
        PatchOverlap {
            normals: mesh.vertex_normals(),
            sigma: patch.sigma.clone(),
            check: None,
            shared_variance: 0.0,
            to_border: distance_to_border(mesh, limit),
            spacing,
            starts: vec![0; mesh.positions.len() + 1],
            feet: Vec::new(),
        }
    }
}

/// Prepares the closest-point search of each patch.
///
/// # Errors
/// As [`MeshSearch::try_new`].
pub fn searches_of(patches: &[MergePatch]) -> Result<Vec<MeshSearch>> {
    patches.par_iter().map(|p| MeshSearch::try_new(&p.mesh)).collect()
}

/// Rejects invalid patches and options.
fn check(patches: &[MergePatch], options: &OverlapOptions) -> Result<()> {
    if patches.len() < 2 {
        return Err(Error::input(format!("expected at least two patches to merge, found {}", patches.len())));
    }
    for (at, patch) in patches.iter().enumerate() {
        patch.mesh.sanity_check().map_err(|e| Error::input(format!("patch {at}: {e}")))?;
        if patch.mesh.triangles.is_empty() {
            return Err(Error::input(format!("patch {at}: expected triangles, found none")));
        }
        if !patch.sigma.is_empty() && patch.sigma.len() != patch.mesh.positions.len() {
            return Err(Error::input(format!(
                "patch {at}: expected one sigma per vertex, found {} vertices and {} values",
                patch.mesh.positions.len(),
                patch.sigma.len()
            )));
        }
        if let Some(v) = patch.sigma.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
            return Err(Error::input(format!(
                "patch {at}, vertex {v}: expected sigma > 0 and finite, found {}",
                patch.sigma[v]
            )));
        }
    }
    for (name, value, largest) in
        [("epsilon", options.epsilon, f64::MAX), ("theta", options.theta_rad, std::f64::consts::FRAC_PI_2)]
    {
        if value.is_some_and(|x| !(x > 0.0 && x <= largest)) {
            return Err(Error::input(format!("expected {name} > 0 (theta at most 90 degrees)")));
        }
    }
    Ok(())
}

/// Estimates one common σ for each patch without σ, from the heights between patches.
///
/// A foot point interpolates three corners with weights `b`, so that the variance of a height is `σ² + Σ b²
/// σ_k²`. σ_k is that of the other patch if known, otherwise the same as σ. The estimate is the σ for which
/// the median of the normalised heights is 0.6745, as for a normal distribution; outliers hardly affect it.
fn estimate_sigma(patches: &[MergePatch], searches: &[MeshSearch], known: &mut [PatchOverlap]) {
    // More samples cost time and hardly change the median.
    const MAX_SAMPLES: usize = 20_000;
    const MEDIAN: f64 = 0.6745;
    for i in 0..patches.len() {
        if !patches[i].sigma.is_empty() {
            continue;
        }
        let spacing = median(&known[i].spacing);
        let step = (patches[i].mesh.positions.len() / MAX_SAMPLES).max(1);
        // |h|, the factor of σ², and the known variance.
        let heights: Vec<[f64; 3]> = (0..patches[i].mesh.positions.len())
            .into_par_iter()
            .step_by(step)
            .flat_map_iter(|v| {
                let (own, p) = (&known[i], patches[i].mesh.positions[v]);
                (0..patches.len()).filter(move |j| *j != i).filter_map(move |j| {
                    let foot = searches[j].closest_compatible_within(
                        p,
                        own.normals[v],
                        SHAPE_ANGLE_RAD,
                        2.0 * spacing,
                    )?;
                    // Beyond a border, the height contains slope and curvature up to the border, not only
                    // noise.
                    if foot.on_boundary {
                        return None;
                    }
                    let height = (foot.point - p).dot(own.normals[v]).abs();
                    let corners = patches[j].mesh.triangles[foot.triangle as usize];
                    let squares = foot.barycentric.map(|b| b * b);
                    Some(match patches[j].sigma.is_empty() {
                        true => [height, 1.0 + squares.iter().sum::<f64>(), 0.0],
                        false => {
                            let variances = corners.map(|c| patches[j].sigma[c as usize].powi(2));
                            [height, 1.0, (0..3).map(|k| squares[k] * variances[k]).sum()]
                        }
                    })
                })
            })
            .collect();
        let size = patches[i].mesh.bounding_box().map_or(1.0, |b| b.diagonal());
        // Lower limits keep σ positive: 1e-8 of the size (rounding of single precision), and a tenth of the
        // known σ of the others.
        let of_others: Vec<f64> = heights.iter().map(|[.., known]| known.sqrt()).collect();
        let min_sigma = (1e-8 * size).max(if heights.is_empty() { 0.0 } else { 0.1 * median(&of_others) });
        let sigma = if heights.is_empty() {
            0.1 * spacing / 2.0_f64.sqrt()
        } else {
            let too_small = |sigma: f64| {
                let normalized: Vec<f64> = (heights.iter())
                    .map(|[h, factor, known]| h / (factor * sigma * sigma + known).sqrt())
                    .collect();
                median(&normalized) > MEDIAN
            };
            let (mut low, mut high) = (0.0, 4.0 * spacing);
            // The median of normalised heights falls as σ grows, so bisection applies even though σ_k of the
            // others differ. 40 halvings reach about 1e-12 of the interval.
            for _ in 0..40 {
                let middle = 0.5 * (low + high);
                if too_small(middle) {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            0.5 * (low + high)
        };
        known[i].sigma = vec![sigma.max(min_sigma); patches[i].mesh.positions.len()];
    }
}

/// Foot points of the vertices of patch `i`, as start indices and a flat list.
fn feet_of(
    i: usize,
    patches: &[MergePatch],
    searches: &[MeshSearch],
    known: &[PatchOverlap],
    thetas: &[f64],
    options: &OverlapOptions,
) -> (Vec<u32>, Vec<OverlapFoot>) {
    let largest: Vec<f64> = known.iter().map(|k| k.sigma.iter().copied().fold(0.0, f64::max)).collect();
    let boxes: Vec<Option<BoundingBox>> = patches.iter().map(|p| p.mesh.bounding_box()).collect();
    let own = &known[i];
    let of_vertex = |v: usize| -> Vec<OverlapFoot> {
        let (p, n, sigma) = (patches[i].mesh.positions[v], own.normals[v], own.sigma[v]);
        let mut feet = Vec::new();
        for j in (0..patches.len()).filter(|j| *j != i) {
            // The search distance uses the largest σ of the other patch; the σ at the foot decides
            // afterwards.
            let beyond_border = BEYOND_BORDER * own.spacing[v];
            let max_epsilon = options.epsilon.unwrap_or(GATE * sigma.hypot(largest[j]));
            let reach = max_epsilon.max(beyond_border);
            // The box rejects most vertices of partly overlapping patches before a search starts.
            let inside = boxes[j]
                .is_some_and(|b| (0..3).all(|k| p[k] >= b.min[k] - reach && p[k] <= b.max[k] + reach));
            if !inside {
                continue;
            }
            let theta = thetas[i].max(thetas[j]);
            let Some(foot) =
                searches[j].closest_compatible_within(p, n, theta, max_epsilon.hypot(beyond_border))
            else {
                continue;
            };
            let other_sigma =
                patches[j].mesh.interpolate(&known[j].sigma, foot.triangle as usize, foot.barycentric);
            let epsilon = options.epsilon.unwrap_or(GATE * sigma.hypot(other_sigma));
            let to = foot.point - p;
            let height = to.dot(n);
            let lateral = to.cross(n).length();
            // At a border, the distance has a part along the surface, which says nothing about the fit of
            // both surfaces: height and lateral distance have limits of their own.
            let found = if foot.on_boundary {
                height.abs() <= epsilon && lateral <= beyond_border
            } else {
                foot.distance <= epsilon
            };
            if found {
                feet.push(OverlapFoot {
                    patch: j as u32,
                    triangle: foot.triangle,
                    barycentric: foot.barycentric,
                    height,
                    beyond_border: foot.on_boundary && lateral > 1e-6 * own.spacing[v],
                });
            }
        }
        feet
    };
    // Collected in the order of the vertices, so that results do not depend on the number of threads.
    let all: Vec<Vec<OverlapFoot>> =
        (0..patches[i].mesh.positions.len()).into_par_iter().map(of_vertex).collect();
    let mut starts = Vec::with_capacity(all.len() + 1);
    let mut feet = Vec::with_capacity(all.iter().map(Vec::len).sum());
    starts.push(0);
    for of_vertex in all {
        feet.extend(of_vertex);
        starts.push(feet.len() as u32);
    }
    (starts, feet)
}

/// Regions shared by two patches, connected along edges of the first patch.
///
/// The region contains the vertices of the first patch that lie on the second, and the corners of triangles
/// on which vertices of the second lie.
fn common_regions(
    patches: &[MergePatch],
    known: &[PatchOverlap],
    thetas: &[f64],
    options: &OverlapOptions,
) -> Vec<CommonRegion> {
    let epsilon = |k: usize, v: usize, foot: &OverlapFoot| {
        let other = foot.patch as usize;
        let read =
            || patches[other].mesh.interpolate(&known[other].sigma, foot.triangle as usize, foot.barycentric);
        options.epsilon.unwrap_or_else(|| GATE * known[k].sigma[v].hypot(read()))
    };
    let mut regions = Vec::new();
    for i in 0..patches.len() {
        for j in i + 1..patches.len() {
            let on = |k: usize, other: usize, v: usize| {
                let feet = known[k].feet(v).iter();
                feet.copied().find(|f| f.patch as usize == other && !f.beyond_border)
            };
            let of_patch = |k: usize, other: usize| -> Vec<(usize, OverlapFoot)> {
                (0..patches[k].mesh.positions.len())
                    .filter_map(|v| on(k, other, v).map(|foot| (v, foot)))
                    .collect()
            };
            let (own_feet, feet_on_this) = (of_patch(i, j), of_patch(j, i));
            if own_feet.is_empty() && feet_on_this.is_empty() {
                continue;
            }
            let mesh = &patches[i].mesh;
            let corners = |foot: &OverlapFoot| mesh.triangles[foot.triangle as usize];
            let mut shared = vec![false; mesh.positions.len()];
            for (v, _) in &own_feet {
                shared[*v] = true;
            }
            for (_, foot) in &feet_on_this {
                for c in corners(foot) {
                    shared[c as usize] = true;
                }
            }
            // Connected along edges whose both ends are shared: two regions that only meet beyond the overlap
            // stay separate.
            let mut label = DisjointSets::new(shared.len());
            for t in &mesh.triangles {
                for k in 0..3 {
                    let (a, b) = (t[k], t[(k + 1) % 3]);
                    if shared[a as usize] && shared[b as usize] {
                        label.join(a, b);
                    }
                }
            }
            // Ordered by label, so that sums and results have a fixed order.
            let mut sums: std::collections::BTreeMap<u32, (usize, f64, f64)> =
                std::collections::BTreeMap::new();
            let own_heights = own_feet.iter().map(|(v, foot)| (*v as u32, foot.height, epsilon(i, *v, foot)));
            let heights_on_this =
                feet_on_this.iter().map(|(v, foot)| (corners(foot)[0], foot.height, epsilon(j, *v, foot)));
            for (vertex, height, epsilon) in own_heights.chain(heights_on_this) {
                let sum = sums.entry(label.root(vertex)).or_default();
                sum.0 += 1;
                sum.1 += height * height;
                sum.2 += epsilon;
            }
            regions.extend(sums.into_values().map(|(points, squares, epsilons)| CommonRegion {
                patches: [i, j],
                points,
                rms: (squares / points as f64).sqrt(),
                epsilon: epsilons / points as f64,
                theta_rad: thetas[i].max(thetas[j]),
            }));
        }
    }
    regions.sort_by(|a, b| b.points.cmp(&a.points).then(a.patches.cmp(&b.patches)));
    regions
}

/// Median of the finite values; infinite without values.
pub(super) fn median(values: &[f64]) -> f64 {
    let mut finite: Vec<f64> = values.iter().copied().filter(|x| x.is_finite()).collect();
    if finite.is_empty() {
        return f64::INFINITY;
    }
    let middle = finite.len() / 2;
    *finite.select_nth_unstable_by(middle, f64::total_cmp).1
}
