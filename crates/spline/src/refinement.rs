//! Refinement of a belief: vertices by the two-scale relation, covariance with the uncertainty of detail.
//!
//! Input: the covariance of coarse vertices and the smoothness prior of the fine ones. Output: the covariance
//! of the fine vertices, `Σ_f = α Σ αᵀ + Q`.
//!
//! `α Σ αᵀ` alone (Wang et al., eq. 18) has the rank of the coarse patch: it excludes any detail. Under the
//! fine prior with precision `K_f`, split the fine vertices into their energy projection on the coarse space,
//! `c = P f`, `P = (αᵀ K_f α)⁻¹ αᵀ K_f`, and the rest, which is independent of `c`. Coarse data measure only
//! `c`, so the rest keeps its prior covariance
//!
//! ```text
//! Q = K_f⁻¹ − α (αᵀ K_f α)⁻¹ αᵀ,        P Q Pᵀ = 0,      P Σ_f Pᵀ = Σ.
//! ```

use crate::hierarchy::Hierarchy;
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// The dense two-scale matrix `α`: fine vertices = `α` · coarse vertices (one coordinate).
///
/// # Errors
/// `Input` when `fine` does not refine `coarse`.
///
/// # Examples
/// ```
/// use planish_spline::{Hierarchy, Shape, two_scale_matrix};
///
/// let coarse = Hierarchy::uniform(Shape::Sheet, [4, 4])?;
/// let alpha = two_scale_matrix(&coarse, &coarse.refine_all())?;
/// assert_eq!((alpha.nrows(), alpha.ncols()), (11 * 11, 7 * 7));
/// assert!(alpha.row_iter().all(|row| (row.sum() - 1.0).abs() < 1e-12)); // partition of unity
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn two_scale_matrix(coarse: &Hierarchy, fine: &Hierarchy) -> Result<DMatrix<f64>> {
    if !fine.same_base(coarse) {
        return Err(Error::input("refinement needs the same shape and base grid"));
    }
    if let Some(cell) = fine.coarser_than(coarse) {
        return Err(Error::input(format!("the other hierarchy is coarser at {cell:?}")));
    }
    let (rows, columns) = (fine.node_count(), coarse.node_count());
    let mut alpha = DMatrix::zeros(rows, columns);
    if let Some(nodes) = coarse.refined_nodes(fine) {
        for (row, own) in nodes.iter().enumerate() {
            own.iter().for_each(|&(node, w)| alpha[(row, node as usize)] = w);
        }
        return Ok(alpha);
    }
    // Compute three columns at a time, as the three coordinates of a vertex.
    for first in (0..columns).step_by(3) {
        let mut unit = vec![DVec3::ZERO; columns];
        for d in 0..3.min(columns - first) {
            unit[first + d][d] = 1.0;
        }
        let local = coarse.leaf_coefficients(&unit);
        let vertices = fine.vertices_from(|cell| {
            let Some(leaf) = coarse.leaf_over(cell) else {
                return [DVec3::ZERO; 16];
            };
            let mut c = local[leaf];
            for d in (0..cell.level - coarse.leaves()[leaf].level).rev() {
                c = crate::hierarchy::quarter3(&c, (cell.i >> d) as usize & 1, (cell.j >> d) as usize & 1);
            }
            c
        });
        for (row, vertex) in vertices.iter().enumerate() {
            for d in 0..3.min(columns - first) {
                alpha[(row, first + d)] = vertex[d];
            }
        }
    }
    Ok(alpha)
}

/// `Q`: the covariance of the fine prior, given the coarse projection.
///
/// `prior_fine` is the fine precision `K_f`; the coarse space must contain its null space (constants,
/// polynomials), as for every smoothness energy here. The null space gets a unit precision, which cancels in
/// the difference. Cost: `O(n³)` dense.
///
/// # Errors
/// `Undetermined` when `prior_fine` has a null space beyond that of the coarse vertices.
///
/// # Examples
/// ```
/// use nalgebra::DMatrix;
/// use planish_spline::{detail_covariance, energy_projection};
///
/// // Two fine values from one coarse value; the energy is the square of their difference.
/// let alpha = DMatrix::from_row_slice(2, 1, &[1.0, 1.0]);
/// let energy = DMatrix::from_row_slice(2, 2, &[1.0, -1.0, -1.0, 1.0]);
/// let null_space = DMatrix::from_element(2, 1, 0.5_f64.sqrt());
/// let detail = detail_covariance(&alpha, &energy, &null_space)?;
/// // The difference has variance 1; the coarse projection has none.
/// assert!((detail[(0, 0)] - 2.0 * detail[(0, 1)] + detail[(1, 1)] - 1.0).abs() < 1e-12);
/// let projection = energy_projection(&alpha, &energy, &null_space)?;
/// assert!((&projection * &detail * projection.transpose()).amax() < 1e-12);
/// # Ok::<(), planish_spline::Error>(())
/// ```
pub fn detail_covariance(
    alpha: &DMatrix<f64>,
    prior_fine: &DMatrix<f64>,
    null_space: &DMatrix<f64>,
) -> Result<DMatrix<f64>> {
    // K + N Nᵀ is proper. N is in the coarse space, so the added term affects only c.
    let scale = prior_fine.diagonal().mean();
    // Scaled to the size of the energy, so that the sum stays well conditioned.
    let proper = prior_fine + scale * null_space * null_space.transpose();
    let inverse = proper
        .clone()
        .cholesky()
        .ok_or_else(|| Error::undetermined("the fine prior has a larger null space than the given one"))?
        .inverse();
    let coarse = (alpha.transpose() * &proper * alpha)
        .cholesky()
        .ok_or_else(|| Error::undetermined("the coarse vertices are linearly dependent in the fine space"))?
        .inverse();
    let q = inverse - alpha * coarse * alpha.transpose();
    Ok(0.5 * (&q + q.transpose()))
}

/// `Σ_f = α Σ αᵀ + Q`.
#[must_use]
pub fn refine_covariance(alpha: &DMatrix<f64>, sigma: &DMatrix<f64>, q: &DMatrix<f64>) -> DMatrix<f64> {
    alpha * sigma * alpha.transpose() + q
}

/// The energy projection `P = (αᵀ K α)⁻¹ αᵀ K` of fine vertices on coarse ones.
///
/// # Errors
/// `Undetermined` when `αᵀ K α` is singular.
pub fn energy_projection(
    alpha: &DMatrix<f64>,
    prior_fine: &DMatrix<f64>,
    null_space: &DMatrix<f64>,
) -> Result<DMatrix<f64>> {
    let scale = prior_fine.diagonal().mean();
    let proper = prior_fine + scale * null_space * null_space.transpose();
    let right = alpha.transpose() * &proper;
    (&right * alpha)
        .cholesky()
        .map(|c| c.solve(&right))
        .ok_or_else(|| Error::undetermined("the coarse vertices are linearly dependent in the fine space"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fit_function;
    use crate::cell_information::scalar_element;
    use crate::hierarchy::Shape;
    use std::sync::Arc;

    fn dense_energy(space: &Arc<Hierarchy>) -> (DMatrix<f64>, DMatrix<f64>) {
        let plane = fit_function(space, |u, v| DVec3::new(u, v, 0.0)).unwrap();
        let n = space.node_count();
        let mut k = DMatrix::zeros(n, n);
        for (leaf, energy) in plane.thin_plate(space).iter().enumerate() {
            let element = scalar_element(space, leaf, &energy.thin_plate);
            let nodes = space.extraction(leaf).0;
            for (a, &i) in nodes.iter().enumerate() {
                for (b, &j) in nodes.iter().enumerate() {
                    k[(i as usize, j as usize)] += element[a * nodes.len() + b];
                }
            }
        }
        let null = DMatrix::from_fn(n, 3, |i, c| if c == 0 { 1.0 } else { plane.vertices()[i][c - 1] });
        (k, null.qr().q())
    }

    #[test]
    fn refined_covariance_keeps_the_coarse_projection_and_adds_the_detail() {
        let coarse = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4]).unwrap());
        let fine = Arc::new(coarse.refine_all());
        let alpha = two_scale_matrix(&coarse, &fine).unwrap();
        let (k_fine, null) = dense_energy(&fine);
        let (k_coarse, _) = dense_energy(&coarse);
        // The same continuous energy: αᵀ K_f α = K_c.
        assert!((alpha.transpose() * &k_fine * &alpha - &k_coarse).amax() < 1e-10 * k_coarse.amax());

        let n = coarse.node_count();
        let a = DMatrix::from_fn(n, n, |i, j| ((i * 31 + j * 17) as f64).sin());
        let sigma = &a * a.transpose() + DMatrix::identity(n, n);
        let q = detail_covariance(&alpha, &k_fine, &null).unwrap();
        let printed = &alpha * &sigma * alpha.transpose();
        let carried = refine_covariance(&alpha, &sigma, &q);
        let rank = |m: &DMatrix<f64>| {
            let values = m.clone().symmetric_eigen().eigenvalues;
            let largest = values.amax();
            assert!(values.min() > -1e-9 * largest, "a covariance must be positive semidefinite");
            values.iter().filter(|&&v| v > 1e-11 * largest).count()
        };
        assert_eq!(rank(&printed), n, "α Σ αᵀ alone has the rank of the coarse patch");
        assert_eq!(rank(&carried), fine.node_count(), "with Q all detail is possible");
        let p = energy_projection(&alpha, &k_fine, &null).unwrap();
        assert!((&p * &alpha - DMatrix::identity(n, n)).amax() < 1e-9);
        assert!(
            (&p * &carried * p.transpose() - &sigma).amax() < 1e-8 * sigma.amax(),
            "the coarse covariance must not change"
        );
    }

    /// Refining a belief from coarse data equals adding these data to the fine prior through the projection.
    #[test]
    fn refining_a_belief_equals_conditioning_the_fine_prior_on_the_coarse_data() {
        let coarse = Arc::new(Hierarchy::uniform(Shape::Sheet, [3, 3]).unwrap());
        let fine = Arc::new(coarse.refine_all());
        let alpha = two_scale_matrix(&coarse, &fine).unwrap();
        let (k_fine, null) = dense_energy(&fine);
        let (k_coarse, _) = dense_energy(&coarse);
        let n = coarse.node_count();
        let h = DMatrix::from_fn(20, n, |i, j| (0.37 * ((i + 1) * (2 * j + 1)) as f64).cos());
        let data = 50.0 * h.transpose() * &h;
        let sigma = (&k_coarse + &data).cholesky().unwrap().inverse();
        let q = detail_covariance(&alpha, &k_fine, &null).unwrap();
        let carried = refine_covariance(&alpha, &sigma, &q);
        // In the fine space: data act through P, and K_f restricted to the detail is unchanged.
        let p = energy_projection(&alpha, &k_fine, &null).unwrap();
        let direct = (&k_fine + p.transpose() * &data * &p).cholesky().unwrap().inverse();
        assert!((&carried - &direct).amax() < 1e-6 * direct.amax());
    }
}
