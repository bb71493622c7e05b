//! How far the surface bulges over the flat facets of a mesh, estimated from the points.
//!
//! In: the equations of a converged fit. Out: the share of the bulge of a smooth surface through the
//! vertices, its σ, and the change of the parameters by it.
//!
//! A mesh is a polyhedron, or its vertices are samples of a smooth surface. In the second case points
//! over a facet lie above it by up to its sagitta, and a fit of flat facets moves the vertices out of the
//! surface by three quarters of it. With normals `n_i` of the vertices `p_i`, a smooth surface is above
//! the facet by
//!
//! `b = ½ Σ_{i<j} λ_i λ_j (n_j − n_i)·(p_j − p_i)`
//!
//! at barycentric coordinates `λ`: a quadratic patch with the sagitta `L²/8R` over a side of length `L`.
//! The height of a point is `r b` plus noise, with an unknown `r` that all facets share: 0 for a
//! polyhedron, 1 for samples of a smooth surface, between them for simplified meshes. Its prior is `½ ±
//! ½`. Only the variation of `b` within facets tells `r`: `b` less its mean `b̄` over the facet. The mean
//! also follows changes of shape that the parameters cannot represent. With `u = A⁻¹ Jᵀ W b`, the change
//! of the parameters for `r = 1`,
//!
//! `r = (Σ w (b − b̄) h + ½ p) / (Σ w (b − b̄)(b − J u) + p)`, `p = 4`,
//!
//! and the covariance of the parameters grows by `σ_r² u uᵀ`.
//!
//! Edges sharper than [`SHARP_COSINE`] separate faces, whose normals at a common vertex differ.
//!
//! Not guaranteed: one `r` for a mesh with flat facets in one place and round ones in another. Changes of
//! the equations by `b` are of first order, so sagittas of several σ of a point are underestimated.
//!
//! Source of the patch: A. Vlachos, J. Peters, C. Boyd, J. Mitchell, *Curved PN triangles*, 2001, here with
//! quadratic heights.

use super::dense::Factor;
use super::equations::{ByPose, ByVertex, Equation, EquationRow, Equations, SCALES, Source};
use super::undetermined;
use crate::deformation::{Deformation, in_basis};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::{Loss, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use rayon::prelude::*;

/// Minimum cosine between the normals of facets of one smooth face: 40°. Neighbouring facets of a ball of 80
/// facets are at 22°, and edges of machined parts are rarely below 45°.
const SHARP_COSINE: f64 = 0.766;
/// Mean and variance of the share `r` before points are seen.
const PRIOR: (f64, f64) = (0.5, 0.25);
/// Heights of points, in σ, for which feet near edges are not used, and the smallest inner part of a
/// facet's sides that is.
const MARGIN: f64 = 4.0;
const MIN_INNER: f64 = 0.3;
/// Number of partial sums; fixed, so that the result does not depend on the number of threads.
const GROUPS: usize = 16;

/// How far the surface bulges over flat facets: `share` times as far as a smooth surface through the
/// vertices.
///
/// It is 0 for polyhedra and 1 for meshes whose vertices are samples of a smooth surface, as estimated
/// from the points; without information, `½ ± ½`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FacetRoundness {
    /// The share.
    pub share: f64,
    /// Its σ.
    pub sigma: f64,
}

/// The estimated share with what it changes.
pub(super) struct Roundness {
    pub found: FacetRoundness,
    /// `u`, the change of the parameters and poses for `r = 1`.
    pub change: DVector<f64>,
    /// `Jᵀ W b` of the parameters and poses.
    mixed: DVector<f64>,
    /// `bᵀ W b`, and `bᵀ W D` of the corrected residuals.
    own: [f64; 2],
}

impl Roundness {
    /// Takes the uncertain share into account in information and vector of the readings at the corrected
    /// parameters, which are `scale` times those of the estimate: the share is marginalised.
    pub(super) fn marginalise(&self, scale: f64, information: &mut DMatrix<f64>, vector: &mut DVector<f64>) {
        let mixed = scale * self.mixed.rows(0, vector.len());
        let [own, slope] = self.own.map(|x| scale * x);
        let all = own + 1.0 / PRIOR.1;
        information.ger(-1.0 / all, &mixed, &mixed, 1.0);
        *vector += (slope + (PRIOR.0 - self.found.share) / PRIOR.1) / all * mixed;
    }
}

/// The bulge of a smooth surface over the facets of a mesh.
pub(super) struct Bulge {
    /// For each facet `½ (n_j − n_i)·(p_j − p_i)` of its sides (0, 1), (1, 2) and (2, 0).
    sides: Vec<[f64; 3]>,
    /// For each facet the tangent of half of its largest angle to a neighbour, over its smallest height.
    edges: Vec<f64>,
}

impl Bulge {
    pub(super) fn new(mesh: &TriangleMesh) -> Self {
        let normals = mesh.face_normals();
        let mut around = vec![Vec::new(); mesh.positions.len()];
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for (k, v) in corners.iter().enumerate() {
                around[*v as usize].push((t, angle(&mesh.corners(t), k)));
            }
        }
        let of_corner = |t: usize, v: u32| {
            let smooth =
                around[v as usize].iter().filter(|(n, _)| normals[*n].dot(normals[t]) > SHARP_COSINE);
            let sum = smooth.fold(DVec3::ZERO, |sum, (n, angle)| sum + *angle * normals[*n]);
            let length = sum.length();
            if length > 0.0 { sum / length } else { DVec3::ZERO }
        };
        let edges = (mesh.triangles.par_iter().enumerate())
            .map(|(t, corners)| {
                let near = corners.iter().flat_map(|v| &around[*v as usize]);
                let cosine = near.fold(1.0, |least: f64, (n, _)| least.min(normals[*n].dot(normals[t])));
                let [a, b, c] = mesh.corners(t);
                let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
                ((1.0 - cosine) / (1.0 + cosine)).max(0.0).sqrt() * longest / (b - a).cross(c - a).length()
            })
            .collect();
        let sides = (mesh.triangles.par_iter().enumerate())
            .map(|(t, corners)| {
                let (p, n) = (mesh.corners(t), corners.map(|v| of_corner(t, v)));
                [[0, 1], [1, 2], [2, 0]].map(|[i, j]| 0.5 * (n[j] - n[i]).dot(p[j] - p[i]))
            })
            .collect();
        Self { sides, edges }
    }

    /// Height at barycentric coordinates of a facet, along its normal.
    fn at(&self, facet: u32, [a, b, c]: [f64; 3]) -> f64 {
        let [first, second, third] = self.sides[facet as usize];
        a * b * first + b * c * second + c * a * third
    }

    /// Height at barycentric coordinates less its mean over a facet; zero near its sides.
    ///
    /// Points outside of a convex edge have their feet on it, and inside of it the feet of neighbours
    /// overlap: near an edge feet depend on the noise of heights. With `λ > ε`, the mean of `λ_i λ_j` is
    /// `ε² + ⅔ ε (1 − 3ε) + (1 − 3ε)²/12`.
    fn varying(&self, facet: u32, barycentric: [f64; 3], sigma: f64) -> f64 {
        let beyond = MARGIN * sigma * self.edges[facet as usize];
        let inner = 1.0 - 3.0 * beyond;
        if !(inner > MIN_INNER && barycentric.iter().all(|l| *l >= beyond)) {
            return 0.0;
        }
        let mean = beyond * beyond + 2.0 / 3.0 * beyond * inner + inner * inner / 12.0;
        self.at(facet, barycentric) - mean * self.sides[facet as usize].iter().sum::<f64>()
    }
}

fn angle(corners: &[DVec3; 3], k: usize) -> f64 {
    let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
    a.cross(b).length().atan2(a.dot(b))
}

/// Estimates the roundness of the facets. `mesh` is where the equations are, `information` that of all
/// equations with the priors and `scale` the factor of it by the loss. Also returns `b − J u` of every
/// equation, the change of its residual for `r = 1`, with the opposite sign; zero for other kinds than
/// points.
///
/// # Errors
/// As [`MeshSearch::try_new`].
pub(super) fn roundness(
    mesh: &TriangleMesh,
    equations: &[Equations],
    deformation: &dyn Deformation,
    (information, scale): (&DMatrix<f64>, f64),
    (loss, factors): (&Loss, &[f64; SCALES]),
    foot: impl Fn(&Equation, &[ByVertex]) -> DVec3 + Sync,
) -> Result<(Roundness, Vec<Vec<f64>>)> {
    let (search, bulge) = (MeshSearch::try_new(mesh)?, Bulge::new(mesh));
    let normals = mesh.face_normals();
    let weight = |e: &Equation| {
        let sigma = e.sigma * factors[e.source.scale()];
        scale * e.chance.0 * e.source.loss(loss).weight(e.distance / sigma) / (sigma * sigma)
    };
    // Of each equation the bulge at its foot, and the same less its mean over the facet.
    let bulges: Vec<Vec<[f64; 2]>> = (equations.par_iter())
        .map(|some| {
            let own = |(e, vertices, _): (&Equation, &[ByVertex], &[ByPose])| {
                if e.source != Source::Point || vertices.is_empty() {
                    return [0.0; 2];
                }
                search.closest(foot(e, vertices)).map_or([0.0; 2], |foot| {
                    // Heights of inconsistently oriented facets may have the opposite sign.
                    let against = vertices.iter().fold(DVec3::ZERO, |sum, (_, by)| sum - *by);
                    let sign = normals[foot.triangle as usize].dot(against).signum();
                    let height = bulge.at(foot.triangle, foot.barycentric);
                    let sigma = e.sigma * factors[e.source.scale()];
                    [sign * height, sign * bulge.varying(foot.triangle, foot.barycentric, sigma)]
                })
            };
            some.iter().map(own).collect()
        })
        .collect();
    let (basis, parameters) = (deformation.basis(), deformation.parameters());
    let rest = information.nrows() - parameters;
    let row_of_equation = || EquationRow::new(deformation, rest / 6);
    let per_group = equations.len().div_ceil(GROUPS).max(1);
    let sums: Vec<DVector<f64>> = (equations.par_chunks(per_group).zip(bulges.par_chunks(per_group)))
        .map(|(group, bulges)| {
            let mut sum = DVector::zeros(basis + rest);
            let mut row = row_of_equation();
            for (some, bulges) in group.iter().zip(bulges) {
                for ((e, vertices, poses), [height, _]) in some.iter().zip(bulges) {
                    let by = weight(e) * height;
                    if by != 0.0 {
                        row.of(vertices, poses).iter().for_each(|(k, entry)| sum[*k] += by * entry);
                    }
                }
            }
            sum
        })
        .collect();
    let sum = sums.iter().fold(DVector::zeros(basis + rest), |sum, own| sum + own);
    let mut right = DVector::zeros(parameters + rest);
    let own = sum.rows(0, basis).into_owned();
    match deformation.reduction() {
        Some(r) => right.rows_mut(0, parameters).copy_from(&r.tr_mul(&own)),
        None => right.rows_mut(0, parameters).copy_from(&own),
    }
    right.rows_mut(parameters, rest).copy_from(&sum.rows(basis, rest));
    let change = Factor::new(information).ok_or_else(undetermined)?.solve(&right);
    let mut moved = DVector::zeros(basis + rest);
    moved.rows_mut(0, basis).copy_from(&in_basis(deformation, &change.rows(0, parameters).into_owned()));
    moved.rows_mut(basis, rest).copy_from(&change.rows(parameters, rest));
    let changes: Vec<(Vec<f64>, [f64; 5])> = (equations.par_iter().zip(&bulges))
        .map_init(row_of_equation, |row, (some, bulges)| {
            let mut sums = [0.0; 5];
            let changes = (some.iter().zip(bulges))
                .map(|((e, vertices, poses), [height, varying])| {
                    let change: f64 =
                        row.of(vertices, poses).iter().map(|(k, entry)| entry * moved[*k]).sum();
                    let left = height - change;
                    let terms = [varying * e.distance, varying * left, height * height];
                    let terms = [terms[0], terms[1], terms[2], height * e.distance, height * left];
                    sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight(e) * term);
                    left
                })
                .collect();
            (changes, sums)
        })
        .collect();
    let [product, square, own, slope, left] =
        (changes.iter()).fold([0.0; 5], |sum, (_, own)| std::array::from_fn(|k| sum[k] + own[k]));
    let square = square.max(0.0) + 1.0 / PRIOR.1;
    // The expectation of `ψ(D)` is its mean slope, not its mean weight, times the change of `D`.
    let share = (product / scale + PRIOR.0 / PRIOR.1) / square;
    let found = Roundness {
        found: FacetRoundness { share, sigma: square.recip().sqrt() },
        change,
        mixed: right,
        own: [own, slope - share * left],
    };
    Ok((found, changes.into_iter().map(|(changes, _)| changes).collect()))
}
