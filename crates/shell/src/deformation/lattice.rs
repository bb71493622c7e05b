//! Free-form deformation by a lattice of control points (T. Sederberg, S. Parry 1986) with polynomials or
//! splines.
//!
//! In: vertices and the number of control points along each axis. Out: `V = V0 + Σ B_i(u) B_j(v) B_k(w)
//! ΔP_ijk`.
//!
//! The box of the lattice encloses the vertices, so none lies outside.

use super::Deformation;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::BoundingBox;

/// Basis functions of a lattice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LatticeBasis {
    /// Bernstein polynomials of a degree one below the number of points. Every point moves all vertices.
    Bernstein,
    /// Uniform cubic B-splines. A point moves the vertices within two lattice steps. Needs four points along
    /// each axis.
    CubicBSpline,
}

/// Vertices that follow a lattice of control points.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use nalgebra::DVector;
/// use planish_shell::{Deformation, Lattice, LatticeBasis, displacements};
/// let vertices = [DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0)];
/// let lattice = Lattice::new(&vertices, [2, 2, 2], LatticeBasis::Bernstein)?;
/// let q = DVector::from_element(lattice.parameters(), 0.5);
/// assert!(displacements(&lattice, &q).iter().all(|d| d.distance(DVec3::splat(0.5)) < 1e-12));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Lattice {
    points: [usize; 3],
    controls: Vec<DVec3>,
    /// For each vertex and axis the first function that is nonzero there, and the values from it on.
    values: Vec<[(u32, Vec<f64>); 3]>,
}

impl Lattice {
    /// A lattice with `points` along each axis, around the bounding box of the vertices.
    ///
    /// # Errors
    /// `Input` for fewer than two points along an axis (four for splines), more than 100 000 in total, no
    /// vertices, or vertices that are not finite.
    pub fn new(vertices: &[DVec3], points: [usize; 3], basis: LatticeBasis) -> Result<Self> {
        let minimum = match basis {
            LatticeBasis::Bernstein => 2,
            LatticeBasis::CubicBSpline => 4,
        };
        let count = points.iter().fold(1_usize, |product, n| product.saturating_mul(*n));
        if points.iter().any(|n| *n < minimum) || count > 100_000 {
            return Err(Error::input(format!(
                "expected at least {minimum} points of a lattice along each axis and at most 100000 in \
                 all, found {points:?}"
            )));
        }
        let bounds = BoundingBox::from_points(vertices)
            .filter(|b| b.min.is_finite() && b.max.is_finite() && vertices.iter().all(|v| v.is_finite()))
            .ok_or_else(|| Error::input("expected vertices with finite coordinates for a lattice"))?;
        let size = bounds.diagonal();
        // The box of a flat object gets a small thickness, so that coordinates stay finite.
        let min_extent = if size > 0.0 { 1e-3 * size } else { 1.0 };
        let extent = bounds.extent().map(|side| side.max(min_extent));
        let middle = bounds.center();
        let low = middle - 0.5 * extent;
        let place = |axis: usize, index: usize| {
            // Greville abscissae: with these, an affine motion of the controls moves all vertices by the same
            // one.
            let along = match basis {
                LatticeBasis::Bernstein => index as f64 / (points[axis] - 1) as f64,
                LatticeBasis::CubicBSpline => (index as f64 - 1.0) / (points[axis] - 3) as f64,
            };
            low[axis] + extent[axis] * along
        };
        let controls = (0..count)
            .map(|n| {
                let index = [n % points[0], n / points[0] % points[1], n / (points[0] * points[1])];
                DVec3::from_array(std::array::from_fn(|axis| place(axis, index[axis])))
            })
            .collect();
        let values = vertices
            .iter()
            .map(|v| {
                std::array::from_fn(|axis| {
                    let along = ((v[axis] - low[axis]) / extent[axis]).clamp(0.0, 1.0);
                    match basis {
                        LatticeBasis::Bernstein => (0, bernstein(points[axis] - 1, along)),
                        LatticeBasis::CubicBSpline => cubic_bspline(points[axis] - 3, along),
                    }
                })
            })
            .collect();
        Ok(Self { points, controls, values })
    }
}

impl Deformation for Lattice {
    fn parameters(&self) -> usize {
        3 * self.controls.len()
    }

    fn vertices(&self) -> usize {
        self.values.len()
    }

    fn row(&self, vertex: u32, direction: DVec3, visit: &mut dyn FnMut(usize, f64)) {
        let [u, v, w] = &self.values[vertex as usize];
        for (k, c) in w.1.iter().enumerate() {
            for (j, b) in v.1.iter().enumerate() {
                for (i, a) in u.1.iter().enumerate() {
                    let [i, j, k] = [(u.0, i), (v.0, j), (w.0, k)].map(|(first, n)| first as usize + n);
                    let control = i + self.points[0] * (j + self.points[1] * k);
                    for (axis, d) in direction.to_array().into_iter().enumerate() {
                        if d != 0.0 {
                            visit(3 * control + axis, a * b * c * d);
                        }
                    }
                }
            }
        }
    }

    fn controls(&self) -> Option<&[DVec3]> {
        Some(&self.controls)
    }
}

/// Bernstein polynomials of a degree, by de Casteljau's triangle.
fn bernstein(degree: usize, t: f64) -> Vec<f64> {
    // Sums of nonnegative terms, unlike powers of `t`, which cancel for higher degrees.
    let mut values = vec![0.0; degree + 1];
    values[0] = 1.0;
    for raised in 1..=degree {
        for k in (0..=raised).rev() {
            let below = if k > 0 { values[k - 1] } else { 0.0 };
            values[k] = (1.0 - t) * values[k] + t * below;
        }
    }
    values
}

/// The four uniform cubic B-splines over one of `spans` spans.
fn cubic_bspline(spans: usize, along: f64) -> (u32, Vec<f64>) {
    let at = along * spans as f64;
    let span = (at as usize).min(spans - 1);
    let t = at - span as f64;
    let s = 1.0 - t;
    let values = vec![
        s * s * s / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t * t * t / 6.0,
    ];
    (span as u32, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacements;
    use nalgebra::DVector;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// An affine motion of the controls moves every vertex by the same motion.
    #[test]
    fn affine_motions_are_reproduced() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let vertices: Vec<DVec3> = (0..500)
            .map(|_| DVec3::from_array([1.0, 2.0, 0.5].map(|size| size * random.random_range(-1.0..1.0))))
            .collect();
        let moved =
            |DVec3 { x, y, z }: DVec3| DVec3::new(0.3 + 0.2 * y - z, 0.1 * x, 1.0 - 0.5 * x + 0.25 * y);
        for (basis, points) in [(LatticeBasis::Bernstein, [3, 4, 2]), (LatticeBasis::CubicBSpline, [4, 7, 5])]
        {
            let made = Lattice::new(&vertices, points, basis).unwrap();
            let q = DVector::from_iterator(
                made.parameters(),
                made.controls.iter().flat_map(|p| moved(*p).to_array()),
            );
            for (vertex, by) in vertices.iter().zip(displacements(&made, &q)) {
                assert!(by.distance(moved(*vertex)) < 1e-12, "{vertex:?} {by:?}");
            }
        }
    }

    #[test]
    fn too_few_points_are_rejected() {
        let vertices = [DVec3::ZERO, DVec3::splat(1.0)];
        for (basis, points) in [(LatticeBasis::Bernstein, [1, 4, 2]), (LatticeBasis::CubicBSpline, [3, 7, 5])]
        {
            assert!(
                Lattice::new(&vertices, points, basis).unwrap_err().to_string().contains("along each axis")
            );
        }
        assert!(Lattice::new(&[], [2; 3], LatticeBasis::Bernstein).is_err());
        // A flat mesh is valid.
        assert!(
            Lattice::new(&[DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)], [2; 3], LatticeBasis::Bernstein).is_ok()
        );
    }
}
