//! Dirichlet free-form deformation (L. Moccozet, N. Magnenat-Thalmann 1997; C eq. 1): vertices follow the
//! control points that are their natural neighbours.
//!
//! In: vertices and control points, the latter in any arrangement (few, on a grid, coplanar, coincident).
//! Out: `V_v = V0_v + Σ_j w_vj ΔP_j` with Sibson's coordinates, exact at controls.
//!
//! Outside the controls the corners of a bounding box are natural neighbours too. They move by the affine
//! motion that best fits the displacements of the controls; fixed corners would break rigid motions. If all
//! controls lie in a plane, on a line or at a point, displacements are constant away from it.
//!
//! Not guaranteed: a vertex off the plane of coplanar controls does not rotate with them; no linear map of
//! their displacements can do that.

use super::{Deformation, SparseRow};
use crate::natural_neighbour::{BOX_CORNERS, NaturalNeighbours};
use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Controls are degenerate in directions where their spread is below this share of the largest. The threshold
/// is above rounding only.
const FLAT: f64 = 1e-9;
/// Number of affine functions: `1, x, y, z`.
const AFFINE: usize = 4;

/// Vertices that follow control points by natural-neighbour coordinates.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use nalgebra::DVector;
/// use planish_shell::{Deformation, Dirichlet, displacements};
/// let controls = [DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y, 2.0 * DVec3::Z, DVec3::splat(2.0)];
/// let vertices = [DVec3::splat(0.5), 2.0 * DVec3::X, DVec3::splat(9.0)];
/// let made = Dirichlet::new(&controls, &vertices)?;
/// // A translation of all controls translates all vertices, inside and outside of the controls.
/// let q = DVector::from_fn(made.parameters(), |k, _| if k % 3 == 0 { 1.0 } else { 0.0 });
/// for moved in displacements(&made, &q) {
///     assert!((moved[0] - 1.0).abs() < 1e-12 && moved[1].abs() < 1e-12);
/// }
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Dirichlet {
    controls: Vec<DVec3>,
    /// First weight of each vertex. Handles are the controls, then the four of an affine motion.
    start: Vec<u32>,
    weights: Vec<(u32, f64)>,
    reduction: DMatrix<f64>,
}

impl Dirichlet {
    /// Computes the weights of `vertices` with respect to `controls`. Cost: about 10 µs per vertex.
    ///
    /// # Errors
    /// `Input` for controls or vertices that are not finite, or no controls.
    pub fn new(controls: &[DVec3], vertices: &[DVec3]) -> Result<Self> {
        if let Some(v) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(Error::input(format!(
                "vertex {v}: expected finite coordinates, found {:?}",
                vertices[v].to_array()
            )));
        }
        let neighbours = NaturalNeighbours::new(controls, vertices)?;
        let (center, size, fit) = affine_fit(controls);
        let mut of_site = vec![Vec::new(); controls.len() + BOX_CORNERS];
        for (control, &site) in neighbours.site_of().iter().enumerate() {
            of_site[site as usize].push(control as u32);
        }
        let mut start = vec![0_u32];
        let mut weights = Vec::new();
        for found in neighbours.weights_of_all(vertices)? {
            let mut affine = [0.0; AFFINE];
            for w in found {
                if (w.site as usize) < BOX_CORNERS {
                    // A corner of the box contributes through four affine functions, not through the controls
                    // themselves: rows stay short, and the dependence on all controls is in the reduction.
                    let DVec3 { x, y, z } = 1.0 / size * (neighbours.site(w.site) - center);
                    for (sum, value) in affine.iter_mut().zip([1.0, x, y, z]) {
                        *sum += w.weight * value;
                    }
                } else {
                    // Coincident controls share the weight of their site.
                    let own = &of_site[w.site as usize];
                    weights.extend(own.iter().map(|&control| (control, w.weight / own.len() as f64)));
                }
            }
            if affine != [0.0; AFFINE] {
                weights.extend((controls.len() as u32..).zip(affine));
            }
            start.push(weights.len() as u32);
        }
        let count = controls.len();
        let mut reduction = DMatrix::zeros(3 * (count + AFFINE), 3 * count);
        for axis in 0..3 {
            for control in 0..count {
                reduction[(3 * control + axis, 3 * control + axis)] = 1.0;
                for k in 0..AFFINE {
                    reduction[(3 * (count + k) + axis, 3 * control + axis)] = fit[(k, control)];
                }
            }
        }
        Ok(Self { controls: controls.to_vec(), start, weights, reduction })
    }

    /// Handles that move a vertex, and by how much: controls by index, then the four of the affine motion.
    fn of_vertex(&self, vertex: u32) -> &[(u32, f64)] {
        let vertex = vertex as usize;
        &self.weights[self.start[vertex] as usize..self.start[vertex + 1] as usize]
    }
}

impl Deformation for Dirichlet {
    fn parameters(&self) -> usize {
        3 * self.controls.len()
    }

    fn basis(&self) -> usize {
        3 * (self.controls.len() + AFFINE)
    }

    fn vertices(&self) -> usize {
        self.start.len() - 1
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        for &(handle, weight) in self.of_vertex(vertex) {
            for (axis, d) in direction.to_array().into_iter().enumerate() {
                if d != 0.0 {
                    visit(3 * handle as usize + axis, weight * d);
                }
            }
        }
    }

    fn add_to(&self, vertices: &[(u32, DVec3)], row: &mut SparseRow) {
        for (vertex, direction) in vertices {
            for &(handle, weight) in self.of_vertex(*vertex) {
                row.add_vector(3 * handle as usize, weight * *direction);
            }
        }
    }

    fn reduction(&self) -> Option<&DMatrix<f64>> {
        Some(&self.reduction)
    }

    fn controls(&self) -> Option<&[DVec3]> {
        Some(&self.controls)
    }
}

/// The affine motion `a0 + A (x − center)/size` that best fits displacements of the controls, as four rows to
/// be multiplied by the displacements. If several motions fit equally well, that of minimum norm.
fn affine_fit(controls: &[DVec3]) -> (DVec3, f64, DMatrix<f64>) {
    let count = controls.len();
    let center = 1.0 / count as f64 * controls.iter().sum::<DVec3>();
    let reach = controls.iter().map(|p| (*p - center).length()).fold(0.0, f64::max);
    let size = if reach > 0.0 { reach } else { 1.0 };
    let off = DMatrix::from_fn(count, 3, |row, axis| (controls[row][axis] - center[axis]) / size);
    // The pseudo-inverse leaves directions in which the controls have no extent at zero; normal equations
    // would be singular there.
    let svd = off.svd(true, true);
    let threshold = FLAT * svd.singular_values.max();
    let inverse =
        svd.pseudo_inverse(threshold.max(f64::MIN_POSITIVE)).unwrap_or_else(|_| DMatrix::zeros(3, count));
    let mut fit = DMatrix::from_element(AFFINE, count, 1.0 / count as f64);
    fit.rows_mut(1, 3).copy_from(&inverse);
    (center, size, fit)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacements;
    use nalgebra::{DVector, Rotation3, Vector3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random_points(count: usize, seed: u64, size: f64) -> Vec<DVec3> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| DVec3::from_array(std::array::from_fn(|_| random.random_range(-size..size))))
            .collect()
    }

    /// A rigid motion of all controls moves every vertex by the same motion, inside the hull of the controls
    /// and far outside.
    #[test]
    fn rigid_motions_of_all_controls_move_every_vertex_rigidly() {
        let grid: Vec<DVec3> = (0..64)
            .map(|k| DVec3::from_array([k % 4, k / 4 % 4, k / 16].map(|i| f64::from(i) - 1.5)))
            .collect();
        let mut twice = random_points(20, 2, 1.0);
        twice.extend(twice.clone());
        let rotation = Rotation3::from_euler_angles(0.4, -1.1, 2.0);
        let turned =
            |p: DVec3| -> DVec3 { (rotation * Vector3::from(p) + Vector3::new(3.0, -1.0, 0.5)).into() };
        let vertices = random_points(2000, 3, 4.0);
        for controls in [random_points(200, 1, 1.0), grid, twice, random_points(4, 5, 1.0)] {
            let made = Dirichlet::new(&controls, &vertices).unwrap();
            let q = DVector::from_iterator(
                made.parameters(),
                controls.iter().flat_map(|p| (turned(*p) - *p).to_array()),
            );
            for (vertex, by) in vertices.iter().zip(displacements(&made, &q)) {
                let off = (*vertex + by).distance(turned(*vertex));
                assert!(off < 1e-9, "{vertex:?}: {off:e}");
            }
        }
        // In the plane of coplanar controls, and on the line of collinear ones, too.
        let flat: Vec<DVec3> = random_points(30, 6, 1.0).iter().map(|p| DVec3::new(p.x, p.y, 0.25)).collect();
        let line: Vec<DVec3> =
            random_points(5, 7, 1.0).iter().map(|p| DVec3::new(p.x, 2.0 * p.x, -p.x)).collect();
        let on_flat: Vec<DVec3> = vertices.iter().map(|p| DVec3::new(p.x, p.y, 0.25)).collect();
        let on_line: Vec<DVec3> = vertices.iter().map(|p| DVec3::new(p.x, 2.0 * p.x, -p.x)).collect();
        for (controls, vertices) in [(flat, on_flat), (line, on_line)] {
            let made = Dirichlet::new(&controls, &vertices).unwrap();
            let q = DVector::from_iterator(
                made.parameters(),
                controls.iter().flat_map(|p| (turned(*p) - *p).to_array()),
            );
            for (vertex, by) in vertices.iter().zip(displacements(&made, &q)) {
                let off = (*vertex + by).distance(turned(*vertex));
                assert!(off < 1e-8, "{vertex:?}: {off:e}");
            }
        }
    }

    /// A moved control moves a vertex at its position by the same displacement, and no distant vertex.
    #[test]
    fn deformations_are_exact_at_controls_and_local() {
        let controls = random_points(100, 9, 1.0);
        let made = Dirichlet::new(&controls, &controls).unwrap();
        let mut q = DVector::zeros(made.parameters());
        q[3 * 17 + 1] = 1.0;
        for (control, by) in displacements(&made, &q).into_iter().enumerate() {
            let wanted = if control == 17 { DVec3::Y } else { DVec3::ZERO };
            assert!(by.distance(wanted) < 1e-12, "control {control}: {by:?}");
        }
    }
}
