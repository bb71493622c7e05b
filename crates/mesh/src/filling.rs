//! Holes filled.
//!
//! Comes in: a mesh whose edges and vertices are manifold and oriented, with σ. Goes out: the same triangles
//! and more over its holes, which carry on the surface around them: a cover of least area ([`cover`]), cut
//! into triangles like those beside it ([`refinement`]), faired ([`fairing`]); and σ of the new vertices, a
//! guess that grows with the way from the border. Borders that look outwards, as that of a sheet does, are no
//! holes and stay.
//!
//! Not guaranteed: that a lid crosses nothing; that the thing is as smooth as the lid.

mod cover;
mod fairing;
mod loops;
mod refinement;

pub(crate) use loops::close_loops;

use crate::edges::edge;
use crate::mesh::TriangleMesh;
use cover::{Surroundings, least_cover};
use fairing::{Goal, fair};
use loops::border_loops;
use planish_estimate::vector3::{add, add_scaled, cross, distance, dot, norm, scale, sub};
use planish_estimate::{Error, Result};
use refinement::Lid;
use std::collections::{HashMap, HashSet};

/// A border looks outwards where its area, times the mean of the normals along it, is more than this: that of
/// a dome up to 75° from its top.
const OUTWARDS: f64 = 0.25;

/// Times that a lid is solved for by its own shape.
const BENT: usize = 6;

/// A mesh whose holes are filled.
#[derive(Debug, Clone)]
pub struct Filled {
    /// The mesh: vertices and triangles as they were, then those of the lids.
    pub mesh: TriangleMesh,
    /// σ along the normal.
    pub sigma: Vec<f64>,
    /// Holes that were filled.
    pub holes: usize,
    /// Borders that look outwards, which were left open.
    pub rims: usize,
    /// Holes with more edges than were allowed, which were left open.
    pub larger: usize,
    /// Holes that could not be covered without an edge of three triangles.
    pub uncovered: usize,
}

/// Fills the holes of up to `longest` edges. `watch` is told the share that is done, and may say to stop.
///
/// The lid's mean curvature is to be that across the hole, the mean of
/// `−(n_i − n_j)·(p_i − p_j) / |p_i − p_j|²` over vertices half and a quarter of the way round from one
/// another.
///
/// σ of a new vertex is a guess: `σ² = σ_r² (1 + d²/ℓ²) + (κ d (d + ℓ) / 2)²` with `σ_r` the mean σ along the
/// hole and `ℓ` that of its edges, `d` the distance to the nearest vertex of its border, and `κ` the root
/// mean square of `|n_i − n_j| / |p_i − p_j|` over the same pairs: how well the tangent is known that is
/// carried on, and what a surface that bends as this one does leaves it by.
///
/// # Errors
/// `Input` for σ of another number than vertices, or a mesh that fails [`TriangleMesh::sanity_check`]; what
/// `watch` says.
///
/// # References
/// P. Liepa, *Filling holes in meshes*, Symposium on Geometry Processing 2003.
pub fn fill_holes(
    mesh: &TriangleMesh,
    sigma: &[f64],
    longest: usize,
    watch: &mut dyn FnMut(f64) -> Result<()>,
) -> Result<Filled> {
    mesh.sanity_check()?;
    if sigma.len() != mesh.positions.len() {
        return Err(Error::input(format!(
            "{} vertices and {} values of sigma: one for each is needed",
            mesh.positions.len(),
            sigma.len()
        )));
    }
    let normals = mesh.vertex_normals();
    let mut filled =
        Filled { mesh: mesh.clone(), sigma: sigma.to_vec(), holes: 0, rims: 0, larger: 0, uncovered: 0 };
    let mut loops = Vec::new();
    for border in border_loops(&mesh.triangles) {
        if looks_outwards(&border, &mesh.positions, &normals) {
            filled.rims += 1;
        } else if border.len() > longest {
            filled.larger += 1;
        } else {
            loops.push(border);
        }
    }
    let mut neighbourhood = HoleNeighbourhood::new(mesh, &loops);
    let total: usize = loops.iter().map(Vec::len).sum();
    let mut done = 0;
    for hole in &loops {
        watch(done as f64 / total as f64)?;
        done += hole.len();
        if fill(&mut filled, hole, &normals, &mut neighbourhood)? {
            filled.holes += 1;
        } else {
            filled.uncovered += 1;
        }
    }
    Ok(filled)
}

/// What of a mesh meets its holes.
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

    /// The mean length of the edges at a vertex.
    fn length_at(&self, v: u32, positions: &[[f64; 3]]) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        for t in self.triangles.get(&v).into_iter().flatten() {
            for w in t.iter().filter(|w| **w != v) {
                sum += distance(positions[v as usize], positions[*w as usize]);
                count += 1;
            }
        }
        sum / f64::from(count.max(1))
    }
}

/// Fills one hole; whether it could be covered.
fn fill(
    filled: &mut Filled,
    hole: &[u32],
    normals: &[[f64; 3]],
    neighbourhood: &mut HoleNeighbourhood,
) -> Result<bool> {
    let positions = &filled.mesh.positions;
    let lone = neighbourhood
        .triangles
        .get(&hole[0])
        .is_some_and(|all| hole.len() == 3 && all.len() == 1 && all[0].iter().all(|v| hole.contains(v)));
    let surroundings = Surroundings { positions, normals, edges: &neighbourhood.edges };
    let Some(cover) = least_cover(&surroundings, hole).filter(|_| !lone) else {
        return Ok(false);
    };
    // Of the loop first, then what meets it, so that lids are small problems of their own.
    let mut number: HashMap<u32, u32> = (0..).zip(hole).map(|(k, v)| (*v, k)).collect();
    let local = |t: &[u32; 3]| t.map(|v| number[&v]);
    let taken = (neighbourhood.edges.iter())
        .filter_map(|[a, b]| Some(edge(*number.get(a)?, *number.get(b)?)))
        .collect();
    let mut lid = Lid::new(
        cover.iter().map(local).collect(),
        hole.iter().map(|v| positions[*v as usize]).collect(),
        taken,
    );
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
    around.sort_unstable();
    let guess = Guess::new(hole, filled, normals);
    smooth(&mut lid, hole.len(), &others, positions, &around, guess.mean_curvature)?;
    let start = filled.mesh.positions.len() as u32;
    let inner = &lid.positions[hole.len()..];
    let sigmas: Vec<f64> = inner.iter().map(|p| guess.sigma(*p)).collect();
    filled.sigma.extend(sigmas);
    filled.mesh.positions.extend_from_slice(inner);
    let global = |v: u32| hole.get(v as usize).copied().unwrap_or_else(|| start + v - hole.len() as u32);
    let made: Vec<[u32; 3]> = lid.triangles.iter().map(|t| t.map(global)).collect();
    let mut on_loop = vec![false; normals.len()];
    for v in neighbourhood.triangles.keys() {
        on_loop[*v as usize] = true;
    }
    for t in &made {
        neighbourhood.add(*t, &on_loop);
    }
    filled.mesh.triangles.extend(made);
    Ok(true)
}

/// Fairs a lid: first to be even, then to bend as what lies around it, its triangles made even in between.
/// `others` are the vertices of the loop and of the triangles that meet it, `around`.
fn smooth(
    lid: &mut Lid,
    rim: usize,
    others: &[u32],
    positions: &[[f64; 3]],
    around: &[[u32; 3]],
    mean_curvature: f64,
) -> Result<()> {
    let first = others.len();
    let vertices: Vec<u32> = (0..rim as u32).collect();
    let bent = std::iter::repeat_n(Goal::MeanCurvature(mean_curvature), BENT);
    for (step, goal) in std::iter::once(Goal::Even).chain(bent).enumerate() {
        let mut all: Vec<[f64; 3]> = others.iter().map(|v| positions[*v as usize]).collect();
        all.extend_from_slice(&lid.positions[rim..]);
        let shifted = |v: u32| {
            if (v as usize) < rim { v } else { v + (first - rim) as u32 }
        };
        let mut triangles: Vec<[u32; 3]> = lid.triangles.iter().map(|t| t.map(shifted)).collect();
        triangles.extend_from_slice(around);
        fair(&mut all, &triangles, &vertices, first, goal)?;
        lid.positions[rim..].copy_from_slice(&all[first..]);
        if step < BENT {
            lid.spread(rim);
            lid.relax();
        }
    }
    Ok(())
}

/// Whether a border is the outer one of a sheet: it goes round counter-clockwise, seen from where the normals
/// along it point to.
fn looks_outwards(border: &[u32], positions: &[[f64; 3]], normals: &[[f64; 3]]) -> bool {
    let at = |k: usize| positions[border[k % border.len()] as usize];
    let middle = scale(
        1.0 / border.len() as f64,
        border.iter().fold([0.0; 3], |sum, v| add(sum, positions[*v as usize])),
    );
    let (mut area, mut normal, mut length) = ([0.0; 3], [0.0; 3], 0.0);
    for k in 0..border.len() {
        area = add(area, cross(sub(at(k), middle), sub(at(k + 1), middle)));
        let long = distance(at(k), at(k + 1));
        normal = add_scaled(normal, long, normals[border[k] as usize]);
        length += long;
    }
    dot(area, normal) > OUTWARDS * norm(area) * length
}

/// How well a lid is known.
struct Guess {
    border: Vec<[f64; 3]>,
    sigma: f64,
    /// The mean length of its edges.
    edge: f64,
    /// Root mean square of how normals turn across the hole.
    curvature: f64,
    /// The mean of the same with its sign, negative on a ball.
    mean_curvature: f64,
}

impl Guess {
    fn new(hole: &[u32], filled: &Filled, normals: &[[f64; 3]]) -> Self {
        let n = hole.len();
        let at = |k: usize| filled.mesh.positions[hole[k % n] as usize];
        let (mut squares, mut sum, mut count) = (0.0, 0.0, 0);
        for k in 0..n {
            for across in [hole[(k + n / 2) % n], hole[(k + n / 4) % n]] {
                let (i, j) = (hole[k] as usize, across as usize);
                let apart = distance(filled.mesh.positions[i], filled.mesh.positions[j]);
                if apart > 0.0 {
                    let turned = sub(normals[i], normals[j]);
                    squares += (norm(turned) / apart).powi(2);
                    sum -= dot(turned, sub(filled.mesh.positions[i], filled.mesh.positions[j]))
                        / (apart * apart);
                    count += 1;
                }
            }
        }
        Self {
            border: (0..n).map(at).collect(),
            edge: (0..n).map(|k| distance(at(k), at(k + 1))).sum::<f64>() / n as f64,
            mean_curvature: sum / f64::from(count.max(1)),
            sigma: hole.iter().map(|v| filled.sigma[*v as usize]).sum::<f64>() / n as f64,
            curvature: (squares / f64::from(count.max(1))).sqrt(),
        }
    }

    fn sigma(&self, p: [f64; 3]) -> f64 {
        let far = self.border.iter().map(|q| distance(p, *q)).fold(f64::INFINITY, f64::min);
        let tangent = far * self.sigma / self.edge.max(f64::MIN_POSITIVE);
        let bend = 0.5 * self.curvature * far * (far + self.edge);
        self.sigma.hypot(tangent).hypot(bend)
    }
}

#[cfg(test)]
mod tests;
