//! Fills the holes of a mesh.
//!
//! In: a mesh with manifold, oriented edges and vertices, and σ. Out: the same triangles, and new ones over
//! its holes that continue the surrounding surface. Each hole gets a cover of minimum area ([`cover`]), which
//! is refined to triangles like those around it ([`refinement`]) and faired ([`fairing`]). σ of the new
//! vertices is an estimate that grows with the distance to the border. Outer borders, as that of a sheet,
//! stay open.
//!
//! Not guaranteed: that a cover does not intersect the mesh, or that the real object is as smooth.

mod cover;
mod fairing;
mod loops;
mod refinement;

pub(crate) use loops::close_loops;

use crate::edges::edge;
use crate::mesh::TriangleMesh;
use cover::{Surroundings, minimal_cover};
use fairing::{Goal, fair};
use loops::border_loops;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use refinement::Lid;
use std::collections::{HashMap, HashSet};

/// Component of the mean normal of a border along its area vector above which the border is an outer one.
///
/// For the rim of a dome it is the cosine of the angle from the top, so rims up to 75° from the top stay
/// open. Rims beyond that are treated as holes.
const OUTWARDS: f64 = 0.25;

/// Number of fairing steps with the mean curvature of the surroundings; each uses the shape of the last.
const FAIRING_STEPS: usize = 6;

/// Maximum number of edges of a hole that is filled because it is narrow; bounds the cost of its cover.
const MAX_NARROW_EDGES: usize = 1000;

/// Which holes are filled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HoleLimit {
    /// Holes of up to this number of edges.
    Edges(usize),
    /// Holes that are at most this wide, in edges of their border. The width is twice the area of the cover
    /// over the length of the border: the width of a slit, half the diameter of a round hole.
    Width(f64),
}

/// A mesh with filled holes.
#[derive(Debug, Clone)]
pub struct Filled {
    /// The mesh: the original vertices and triangles, then the new ones.
    pub mesh: TriangleMesh,
    /// σ of each vertex along its normal.
    pub sigma: Vec<f64>,
    /// Number of filled holes.
    pub holes: usize,
    /// Number of outer borders, which stay open.
    pub outer_rims: usize,
    /// Number of holes with too many edges or too wide, which stay open.
    pub too_large: usize,
    /// Number of holes that cannot be covered without a non-manifold edge.
    pub uncovered: usize,
}

/// Fills the holes within a limit. `watch` receives the completed fraction and may cancel by an error.
///
/// The cover gets the mean curvature across the hole, which is the mean of
/// `−(n_i − n_j)·(p_i − p_j) / |p_i − p_j|²` over pairs of border vertices that are half or a
/// quarter of the border apart.
///
/// σ of a new vertex is an estimate: `σ² = σ_r² (1 + d²/ℓ²) + (κ d (d + ℓ) / 2)²`. Here `σ_r` is the mean σ
/// along the border, `ℓ` the mean edge length, and `d` the distance to the nearest border vertex. `κ` is the
/// root mean square of `|n_i − n_j| / |p_i − p_j|` over the same pairs. The first term is the uncertainty of
/// the extrapolated tangent; the second is the deviation from it due to curvature.
///
/// # Errors
/// `Input` if the numbers of σ and vertices differ, or if the mesh fails [`TriangleMesh::sanity_check`];
/// errors of `watch`.
///
/// # Examples
/// ```
/// use planish_mesh::{HoleLimit, fill_holes, icosphere};
/// let mut ball = icosphere(1.0, 2);
/// ball.triangles.pop();
/// let sigma = vec![0.01; ball.positions.len()];
/// let filled = fill_holes(&ball, &sigma, HoleLimit::Edges(10), &mut |_| Ok(()))?;
/// assert_eq!(filled.holes, 1);
/// assert!(filled.mesh.check().watertight);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// P. Liepa, *Filling holes in meshes*, Symposium on Geometry Processing 2003.
pub fn fill_holes(
    mesh: &TriangleMesh,
    sigma: &[f64],
    limit: HoleLimit,
    watch: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<Filled> {
    mesh.sanity_check()?;
    if sigma.len() != mesh.positions.len() {
        return Err(Error::input(format!(
            "expected one value of sigma for each of the {} vertices, found {}",
            mesh.positions.len(),
            sigma.len()
        )));
    }
    let normals = mesh.vertex_normals();
    let mut filled = Filled {
        mesh: mesh.clone(),
        sigma: sigma.to_vec(),
        holes: 0,
        outer_rims: 0,
        too_large: 0,
        uncovered: 0,
    };
    let mut loops = Vec::new();
    // Which borders are holes is decided on the original mesh, before covers change its edges.
    for border in border_loops(&mesh.triangles) {
        if is_outer_border(&border, &mesh.positions, &normals) {
            filled.outer_rims += 1;
        } else if limit.excludes(&border, &mesh.positions) {
            filled.too_large += 1;
        } else {
            loops.push(border);
        }
    }
    let mut neighbourhood = HoleNeighbourhood::new(mesh, &loops);
    // Progress counts edges, not holes: the cost of a hole grows with its edges.
    let total: usize = loops.iter().map(Vec::len).sum();
    let mut done = 0;
    for hole in &loops {
        watch(done as f64 / total as f64)?;
        done += hole.len();
        match fill(&mut filled, hole, &normals, &mut neighbourhood, limit)? {
            Fate::Filled => filled.holes += 1,
            Fate::TooWide => filled.too_large += 1,
            Fate::Uncovered => filled.uncovered += 1,
        }
    }
    Ok(filled)
}

impl HoleLimit {
    /// True if a hole is certainly beyond the limit. Its cover is not known yet, but it has at least the area
    /// that the border encloses in projection.
    fn excludes(self, border: &[u32], positions: &[DVec3]) -> bool {
        match self {
            Self::Edges(longest) => border.len() > longest,
            Self::Width(widest) => {
                let at = |k: usize| positions[border[k % border.len()] as usize];
                let area: DVec3 =
                    (0..border.len()).map(|k| 0.5 * (at(k) - at(0)).cross(at(k + 1) - at(0))).sum();
                border.len() > MAX_NARROW_EDGES || width_in_edges(border, positions, area.length()) > widest
            }
        }
    }

    /// True if a cover is within the limit.
    fn permits(self, border: &[u32], positions: &[DVec3], cover: &[[u32; 3]]) -> bool {
        let of_triangle = |t: &[u32; 3]| crate::triangle::area(&t.map(|v| positions[v as usize]));
        match self {
            Self::Edges(_) => true,
            Self::Width(widest) => {
                width_in_edges(border, positions, cover.iter().map(of_triangle).sum()) <= widest
            }
        }
    }
}

/// Width of a hole with this area, in edges of its border.
fn width_in_edges(border: &[u32], positions: &[DVec3], area: f64) -> f64 {
    let at = |k: usize| positions[border[k % border.len()] as usize];
    let length: f64 = (0..border.len()).map(|k| at(k).distance(at(k + 1))).sum();
    2.0 * area * border.len() as f64 / (length * length).max(f64::MIN_POSITIVE)
}

/// What became of a hole.
enum Fate {
    Filled,
    TooWide,
    Uncovered,
}

/// The edges and triangles of a mesh at its holes.
struct HoleNeighbourhood {
    /// Edges between vertices of loops.
    edges: HashSet<[u32; 2]>,
    /// Triangles at each vertex of a loop.
    triangles: HashMap<u32, Vec<[u32; 3]>>,
}

impl HoleNeighbourhood {
    fn new(mesh: &TriangleMesh, loops: &[Vec<u32>]) -> Self {
        let mut on_loop = vec![false; mesh.positions.len()];
        for v in loops.iter().flatten() {
            on_loop[*v as usize] = true;
        }
        let mut neighbourhood = Self { edges: HashSet::new(), triangles: HashMap::new() };
        for t in mesh.triangles.iter().filter(|t| t.iter().any(|v| on_loop[*v as usize])) {
            neighbourhood.add(*t, &on_loop);
        }
        neighbourhood
    }

    /// Adds a triangle.
    fn add(&mut self, t: [u32; 3], on_loop: &[bool]) {
        let is = |v: u32| on_loop.get(v as usize).copied().unwrap_or(false);
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            if is(a) && is(b) {
                self.edges.insert(edge(a, b));
            }
            if is(a) {
                self.triangles.entry(a).or_default().push(t);
            }
        }
    }

    /// Mean length of the edges at a vertex.
    fn length_at(&self, v: u32, positions: &[DVec3]) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for t in self.triangles.get(&v).into_iter().flatten() {
            for w in t.iter().filter(|w| **w != v) {
                sum += positions[v as usize].distance(positions[*w as usize]);
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }
}

/// Fills one hole if its cover is within the limit.
fn fill(
    filled: &mut Filled,
    hole: &[u32],
    normals: &[DVec3],
    neighbourhood: &mut HoleNeighbourhood,
    limit: HoleLimit,
) -> Result<Fate> {
    let positions = &filled.mesh.positions;
    // The border of a single triangle has three edges too, but covering it would double the triangle.
    let is_single_triangle = neighbourhood
        .triangles
        .get(&hole[0])
        .is_some_and(|all| hole.len() == 3 && all.len() == 1 && all[0].iter().all(|v| hole.contains(v)));
    // A cover must not repeat an edge of the mesh, or that edge would get three triangles.
    let surroundings = Surroundings { positions, normals, edges: &neighbourhood.edges };
    let Some(cover) = minimal_cover(&surroundings, hole).filter(|_| !is_single_triangle) else {
        return Ok(Fate::Uncovered);
    };
    if !limit.permits(hole, positions, &cover) {
        return Ok(Fate::TooWide);
    }
    // Local numbers: the border first, then the vertices of adjacent triangles. Each hole is then a small
    // problem of its own.
    let mut number: HashMap<u32, u32> = (0..).zip(hole).map(|(k, v)| (*v, k)).collect();
    let local = |t: &[u32; 3]| t.map(|v| number[&v]);
    let existing_edges = (neighbourhood.edges.iter())
        .filter_map(|[a, b]| Some(edge(*number.get(a)?, *number.get(b)?)))
        .collect();
    let mut lid = Lid::new(
        cover.iter().map(local).collect(),
        hole.iter().map(|v| positions[*v as usize]).collect(),
        existing_edges,
    );
    // Edge lengths at the rim, so that a cover is as dense as what surrounds it.
    let lengths: Vec<f64> = hole.iter().map(|v| neighbourhood.length_at(*v, positions)).collect();
    lid.refine(&lengths);
    let mut others: Vec<u32> = hole.to_vec();
    let mut ring: HashSet<[u32; 3]> = HashSet::new();
    for t in hole.iter().filter_map(|v| neighbourhood.triangles.get(v)).flatten() {
        if ring.insert(*t) {
            for v in t {
                number.entry(*v).or_insert_with(|| {
                    others.push(*v);
                    others.len() as u32 - 1
                });
            }
        }
    }
    let mut around: Vec<[u32; 3]> = ring.iter().map(|t| t.map(|v| number[&v])).collect();
    // Sets have no fixed order, and the order of triangles is that of the sums.
    around.sort_unstable();
    let extrapolation = Extrapolation::new(hole, filled, normals);
    smooth(&mut lid, hole.len(), &others, positions, &around, extrapolation.mean_curvature)?;
    let start = filled.mesh.positions.len() as u32;
    let inner = &lid.positions[hole.len()..];
    let sigmas: Vec<f64> = inner.iter().map(|p| extrapolation.sigma(*p)).collect();
    filled.sigma.extend(sigmas);
    filled.mesh.positions.extend_from_slice(inner);
    let global = |v: u32| hole.get(v as usize).copied().unwrap_or_else(|| start + v - hole.len() as u32);
    // Later holes may share vertices with this one and must not repeat its edges.
    let made: Vec<[u32; 3]> = lid.triangles.iter().map(|t| t.map(global)).collect();
    let mut on_loop = vec![false; normals.len()];
    for v in neighbourhood.triangles.keys() {
        on_loop[*v as usize] = true;
    }
    for t in &made {
        neighbourhood.add(*t, &on_loop);
    }
    filled.mesh.triangles.extend(made);
    Ok(Fate::Filled)
}

/// Fairs a cover: first to even triangles, then to the mean curvature of the surroundings, with regular
/// triangles in between. `others` are the vertices of the border and of the adjacent triangles `around`.
fn smooth(
    lid: &mut Lid,
    rim: usize,
    others: &[u32],
    positions: &[DVec3],
    around: &[[u32; 3]],
    mean_curvature: f64,
) -> Result<()> {
    let first = others.len();
    let vertices: Vec<u32> = (0..rim as u32).collect();
    // The first step only needs even triangles: cotangent weights of the slivers of a flat cover are useless.
    let curved = std::iter::repeat_n(Goal::MeanCurvature(mean_curvature), FAIRING_STEPS);
    for (step, goal) in std::iter::once(Goal::Even).chain(curved).enumerate() {
        let mut all: Vec<DVec3> = others.iter().map(|v| positions[*v as usize]).collect();
        all.extend_from_slice(&lid.positions[rim..]);
        let shifted = |v: u32| {
            if (v as usize) < rim { v } else { v + (first - rim) as u32 }
        };
        let mut triangles: Vec<[u32; 3]> = lid.triangles.iter().map(|t| t.map(shifted)).collect();
        triangles.extend_from_slice(around);
        fair(&mut all, &triangles, &vertices, first, goal)?;
        lid.positions[rim..].copy_from_slice(&all[first..]);
        if step < FAIRING_STEPS {
            lid.spread(rim);
            lid.relax();
        }
    }
    Ok(())
}

/// Returns true if a border is the outer border of a sheet: it is counter-clockwise, seen against the normals
/// along it.
fn is_outer_border(border: &[u32], positions: &[DVec3], normals: &[DVec3]) -> bool {
    let at = |k: usize| positions[border[k % border.len()] as usize];
    let middle = 1.0 / border.len() as f64 * border.iter().map(|v| positions[*v as usize]).sum::<DVec3>();
    let (mut area, mut normal, mut length) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for k in 0..border.len() {
        area += (at(k) - middle).cross(at(k + 1) - middle);
        // Weighted by length: many short edges in a corner must not decide the direction.
        let long = at(k).distance(at(k + 1));
        normal += long * normals[border[k] as usize];
        length += long;
    }
    area.dot(normal) > OUTWARDS * area.length() * length
}

/// Parameters of the estimated σ and curvature of a cover.
struct Extrapolation {
    border: Vec<DVec3>,
    sigma: f64,
    /// Mean edge length of the border.
    edge: f64,
    /// Root mean square change of normals per length across the hole.
    curvature: f64,
    /// Mean of the same with its sign: negative on a ball.
    mean_curvature: f64,
}

impl Extrapolation {
    fn new(hole: &[u32], filled: &Filled, normals: &[DVec3]) -> Self {
        let n = hole.len();
        let at = |k: usize| filled.mesh.positions[hole[k % n] as usize];
        let (mut squares, mut sum, mut count) = (0.0, 0.0, 0);
        for k in 0..n {
            // Opposite vertices: the noise of the normals is divided by the distance, which is largest across
            // the hole.
            for across in [hole[(k + n / 2) % n], hole[(k + n / 4) % n]] {
                let (i, j) = (hole[k] as usize, across as usize);
                let apart = filled.mesh.positions[i].distance(filled.mesh.positions[j]);
                if apart > 0.0 {
                    let turned = normals[i] - normals[j];
                    squares += (turned.length() / apart).powi(2);
                    sum -= turned.dot(filled.mesh.positions[i] - filled.mesh.positions[j]) / (apart * apart);
                    count += 1;
                }
            }
        }
        Self {
            border: (0..n).map(at).collect(),
            edge: (0..n).map(|k| at(k).distance(at(k + 1))).sum::<f64>() / n as f64,
            mean_curvature: sum / f64::from(count.max(1)),
            sigma: hole.iter().map(|v| filled.sigma[*v as usize]).sum::<f64>() / n as f64,
            curvature: (squares / f64::from(count.max(1))).sqrt(),
        }
    }

    /// Estimated σ at a point of the cover; see [`fill_holes`].
    fn sigma(&self, p: DVec3) -> f64 {
        let far = self.border.iter().map(|q| p.distance(*q)).fold(f64::INFINITY, f64::min);
        let tangent = far * self.sigma / self.edge.max(f64::MIN_POSITIVE);
        let bend = 0.5 * self.curvature * far * (far + self.edge);
        self.sigma.hypot(tangent).hypot(bend)
    }
}

#[cfg(test)]
mod tests;
