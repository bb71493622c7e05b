//! Curvature at the vertices of a mesh.
//!
//! In: a mesh with normals and σ. Out: mean and Gaussian curvature of every vertex, σ of the mean curvature,
//! and border flags.
//!
//! A quadric is fitted to the vertices around ([`MIN_NEIGHBOURS`], two rings of a regular mesh). Sums of
//! angles and cotangents (Meyer and others) use only one ring, where noise exceeds the curvature, and give no
//! σ (see `docs/decisions/0074-vertex-curvature.md`).
//!
//! Not guaranteed: curvature of features smaller than two rings; σ if the errors of neighbours are
//! correlated.
//!
//! # References
//! F. Cazals, M. Pouget, *Estimating differential quantities using polynomial fitting of osculating jets*,
//! 2005, with jets of degree 2.

use crate::half_edges::{NONE, next_in_triangle, opposites};
use crate::mesh::TriangleMesh;
use crate::neighbours::Neighbours;
use nalgebra::{SMatrix, SVector};
use planish_core::{DVec3, vector3::tangents};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Rings are added until there are this many neighbours: two rings of a regular mesh.
///
/// More neighbours reduce σ but smooth the curvature over a larger area.
const MIN_NEIGHBOURS: usize = 18;
/// Maximum number of rings; bounds the area where vertices have few neighbours.
const MAX_RINGS: usize = 4;
/// Number of coefficients of a quadric.
const UNKNOWNS: usize = 6;

/// Curvature at the vertices of a mesh, in 1/unit.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexCurvature {
    /// Mean curvature `(κ₁ + κ₂) / 2`, positive if the surface bends towards its normal.
    ///
    /// A ball with outward normals has −1/r.
    pub mean: Vec<f64>,
    /// Gaussian curvature `κ₁ κ₂`, in 1/unit².
    pub gaussian: Vec<f64>,
    /// σ of the mean curvature.
    pub sigma_mean: Vec<f64>,
    /// 1 for a vertex on the border, else 0.
    pub border: Vec<u8>,
}

/// The curvature of a mesh at every vertex.
///
/// Heights `h` along the normal are fitted by `h = c + p u + q v + ½ (a u² + 2 b u v + d v²)` with weights
/// `1/σ²`; then `H = ((1 + q²) a − 2 p q b + (1 + p²) d) / (2 g³)` and `K = (a d − b²) / g⁴` with
/// `g² = 1 + p² + q²`. The covariance of the fit gives `σ_H`. It is enlarged if the residuals exceed `σ`.
/// Vertices with too few neighbours for a quadric have curvature 0, with σ the inverse of their longest edge.
///
/// # Errors
/// `Input` if the number of normals or σ differs from that of the vertices, or if the mesh fails
/// [`TriangleMesh::sanity_check`].
///
/// # Examples
/// ```
/// let ball = planish_mesh::icosphere(2.0, 4);
/// let sigma = vec![1e-3; ball.positions.len()];
/// let curvature = planish_mesh::vertex_curvature(&ball, &ball.vertex_normals(), &sigma)?;
/// assert!((curvature.mean[0] + 0.5).abs() < 1e-2 && (curvature.gaussian[0] - 0.25).abs() < 1e-2);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn vertex_curvature(mesh: &TriangleMesh, normals: &[DVec3], sigma: &[f64]) -> Result<VertexCurvature> {
    mesh.sanity_check()?;
    let count = mesh.positions.len();
    if normals.len() != count || sigma.len() != count {
        return Err(Error::input(format!(
            "expected one normal and one sigma for each of the {count} vertices, found {} and {}",
            normals.len(),
            sigma.len()
        )));
    }
    let neighbours = Neighbours::from_mesh(mesh);
    let mut mean = vec![0.0; count];
    let mut gaussian = vec![0.0; count];
    let mut sigma_mean = vec![0.0; count];
    (&mut mean, &mut gaussian, &mut sigma_mean).into_par_iter().enumerate().for_each_init(
        Vec::new,
        |around, (v, (h, k, s))| {
            gather(v as u32, &neighbours, around);
            let found = quadric(v, around, mesh, normals[v], sigma);
            [*h, *k, *s] = found.unwrap_or_else(|| {
                let to = |w: &u32| mesh.positions[v].distance(mesh.positions[*w as usize]);
                let edge = around.iter().skip(1).map(to).fold(0.0, f64::max);
                [0.0, 0.0, if edge > 0.0 { 1.0 / edge } else { f64::MAX }]
            });
        },
    );
    let mut border = vec![0; count];
    for (half, _) in (0_u32..).zip(opposites(&mesh.triangles)).filter(|(_, over)| *over == NONE) {
        for h in [half, next_in_triangle(half)] {
            border[mesh.triangles[h as usize / 3][h as usize % 3] as usize] = 1;
        }
    }
    Ok(VertexCurvature { mean, gaussian, sigma_mean, border })
}

/// Collects a vertex and the rings around it into `around`, until there are enough neighbours.
fn gather(vertex: u32, neighbours: &Neighbours, around: &mut Vec<u32>) {
    around.clear();
    around.push(vertex);
    let mut ring = 0;
    for _ in 0..MAX_RINGS {
        let end = around.len();
        for k in ring..end {
            for w in neighbours.of_vertex(around[k]) {
                if !around.contains(w) {
                    around.push(*w);
                }
            }
        }
        ring = end;
        if around.len() > MIN_NEIGHBOURS || around.len() == end {
            break;
        }
    }
}

/// Mean and Gaussian curvature, and σ of the mean curvature; `None` if the neighbours do not determine them.
fn quadric(
    vertex: usize,
    around: &[u32],
    mesh: &TriangleMesh,
    normal: DVec3,
    sigma: &[f64],
) -> Option<[f64; 3]> {
    if around.len() < UNKNOWNS {
        return None;
    }
    let normal = normal.try_normalize()?;
    let (e1, e2) = tangents(normal);
    let at = mesh.positions[vertex];
    // All lengths are divided by the size of the neighbourhood: the normal matrix would otherwise mix powers
    // of the unit up to the fourth.
    let size = around.iter().map(|w| at.distance(mesh.positions[*w as usize])).fold(0.0, f64::max);
    if size <= 0.0 {
        return None;
    }
    let row = |w: u32| {
        let way = mesh.positions[w as usize] - at;
        let (u, v) = (way.dot(e1) / size, way.dot(e2) / size);
        let terms = SVector::<f64, UNKNOWNS>::from([1.0, u, v, 0.5 * u * u, u * v, 0.5 * v * v]);
        (terms, way.dot(normal) / size, (sigma[w as usize] / size).powi(-2))
    };
    let mut matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let mut vector = SVector::<f64, UNKNOWNS>::zeros();
    for w in around {
        let (terms, height, weight) = row(*w);
        matrix += weight * terms * terms.transpose();
        vector += weight * height * terms;
    }
    let inverse = matrix.cholesky()?;
    let x = inverse.solve(&vector);
    let covariance = inverse.inverse();
    let squares: f64 = around
        .iter()
        .map(|w| {
            let (terms, height, weight) = row(*w);
            weight * (height - terms.dot(&x)).powi(2)
        })
        .sum();
    // Residuals larger than σ show shape that a quadric cannot follow, or a σ that is too small. Smaller ones
    // are chance and do not reduce σ.
    let dispersion = (squares / (around.len() - UNKNOWNS).max(1) as f64).max(1.0);
    let [_, p, q, a, b, d] = [x[0], x[1], x[2], x[3], x[4], x[5]];
    let g2 = 1.0 + p * p + q * q;
    let factor = 0.5 / (g2 * g2.sqrt());
    let gradient = [factor * (1.0 + q * q), -2.0 * factor * p * q, factor * (1.0 + p * p)];
    // The slopes p and q are taken as exact: they only enter in second order, since the normal is nearly that
    // of the surface.
    let mut variance = 0.0;
    for i in 0..3 {
        for j in 0..3 {
            variance += gradient[i] * gradient[j] * covariance[(3 + i, 3 + j)];
        }
    }
    let mean = gradient[0] * a + gradient[1] * b + gradient[2] * d;
    let found =
        [mean / size, (a * d - b * b) / (g2 * g2) / (size * size), (variance * dispersion).sqrt() / size];
    found.iter().all(|value| value.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::primitives::{cylinder, grid_sheet, icosphere};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A ball of radius r has H = −1/r and K = 1/r², a cylinder −1/2r and 0, the saddle z = xy in its middle
    /// 0 and −1.
    #[test]
    fn curvature_matches_known_surfaces() {
        let curvature_of = |mesh: &TriangleMesh| {
            let sigma = vec![1e-4; mesh.positions.len()];
            vertex_curvature(mesh, &mesh.vertex_normals(), &sigma).unwrap()
        };
        let ball = curvature_of(&icosphere(2.0, 4));
        assert!(ball.mean.iter().all(|h| (h + 0.5).abs() < 0.01));
        assert!(ball.gaussian.iter().all(|k| (k - 0.25).abs() < 0.01));
        assert!(ball.border.iter().all(|b| *b == 0));
        let tube = cylinder(0.5, 4.0, 60, 60, false);
        let found = curvature_of(&tube);
        for (v, p) in tube.positions.iter().enumerate().filter(|(_, p)| p[2].abs() < 1.5) {
            assert!((found.mean[v] + 1.0).abs() < 0.03 && found.gaussian[v].abs() < 0.05, "{p:?}");
        }
        assert_eq!(found.border.iter().filter(|b| **b == 1).count(), 120);
        let mut saddle = grid_sheet(1.0, 1.0, 40, 40);
        saddle.positions.iter_mut().for_each(|p| p[2] = p[0] * p[1]);
        let middle = saddle.positions.iter().position(|p| p[0].abs() + p[1].abs() < 1e-9).unwrap();
        let found = curvature_of(&saddle);
        assert!(found.mean[middle].abs() < 1e-3 && (found.gaussian[middle] + 1.0).abs() < 0.01);
        assert!(vertex_curvature(&saddle, &[], &[]).is_err());
    }

    /// The errors of the mean curvature agree with σ for independent noise.
    #[test]
    fn sigma_of_the_mean_curvature_matches_its_errors() {
        const SIGMA: f64 = 2e-3;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut ball = icosphere(1.0, 4);
        let normals = ball.vertex_normals();
        for p in &mut ball.positions {
            let off = SIGMA * 12_f64.sqrt() * (rng.random::<f64>() - 0.5);
            *p = (1.0 + off) * *p;
        }
        let sigma = vec![SIGMA; ball.positions.len()];
        let found = vertex_curvature(&ball, &normals, &sigma).unwrap();
        let squares: f64 =
            (found.mean.iter().zip(&found.sigma_mean)).map(|(h, s)| ((h + 1.0) / s).powi(2)).sum();
        let normalized = (squares / found.mean.len() as f64).sqrt();
        assert!((0.75..1.15).contains(&normalized), "{normalized}");
    }
}
