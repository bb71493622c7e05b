//! Bending without stretch: preserved lengths as measurements of the vertices of a surface.
//!
//! Input: a reference [`Surface`]. Output: its [`Metric`], the information of "all lengths are preserved"
//! about the vertices of another surface over the same hierarchy, and the change of the first fundamental
//! form. Equal parameters `(u, v)` denote the same material point.
//!
//! An isometry preserves `E, F, G`. It also preserves Gaussian curvature, but this is not sufficient: a
//! stretched plane stays flat. Every quadrature point has three strain gauges, a rosette: tangents `d_j` of
//! unit length in the metric of the reference, 60° apart. Each is one measurement,
//!
//! ```text
//! |d_j S|² = 1,      d_j S = a_j S_u + b_j S_v,      linearised: 2 d_jS · d_j(S + δS) = 1 + |d_jS|²
//! ```
//!
//! and the three are equivalent to E, F and G: `Σ_j (d_jᵀ ε d_j)² = 3/8 (2 tr ε² + (tr ε)²)` in any frame.
//!
//! Not guaranteed: an exact isometry, which a spline reaches only in the limit of small cells.
//! [`Metric::changes`] reports the remaining strain.
//!
//! # References
//! do Carmo, *Differential Geometry of Curves and Surfaces*, 1976, section 4.2 (isometries keep the first
//! fundamental form); Perry & Lissner, *The Strain Gage Primer*, 1955 (the delta rosette).

use crate::basis::cubic;
use crate::energy::{QuadraturePoint, quadrature};
use crate::surface::{Jet, Surface};
use crate::system::SurfaceSystem;
use planish_core::DVec3;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Number of quadrature points of a leaf.
const POINTS: usize = 16;
/// Directions of the gauges in an orthonormal frame.
const GAUGES: [[f64; 2]; 3] = [[1.0, 0.0], [0.5, 0.866_025_403_784_438_6], [-0.5, 0.866_025_403_784_438_6]];

/// The first fundamental form of a surface at the quadrature points of every leaf.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// `E, F, G` by leaf.
    forms: Vec<[[f64; 3]; POINTS]>,
}

/// Change of the first fundamental form of one leaf over its quadrature points: `δE/E, δF/√(EG), δG/G`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MetricChange {
    /// Mean absolute value of each.
    pub mean: [f64; 3],
    /// Maximum absolute value of each.
    pub largest: [f64; 3],
}

impl Metric {
    /// The metric of a surface.
    #[must_use]
    pub fn new(surface: &Surface) -> Self {
        let points = quadrature();
        let forms = (0..surface.space().leaves().len())
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| points.map(|q| surface.leaf_jet(leaf, q.local[0], q.local[1]).first_form()))
            .collect();
        Self { forms }
    }

    /// Copies the forms of one leaf from another metric over the same hierarchy.
    pub fn copy_leaf(&mut self, leaf: usize, from: &Self) {
        self.forms[leaf] = from.forms[leaf];
    }

    /// Change of the forms in another surface over the same hierarchy, by leaf.
    ///
    /// # Errors
    /// `Input` when the numbers of leaves differ.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{Hierarchy, Metric, Shape, fit_function};
    ///
    /// let space = Hierarchy::uniform(Shape::Sheet, [4, 4])?.into();
    /// let flat = fit_function(&space, |u, v| DVec3::new(u, v, 0.0))?;
    /// let stretched = fit_function(&space, |u, v| DVec3::new(1.01 * u, v, 0.0))?;
    /// let changes = Metric::new(&flat).changes(&stretched)?;
    /// assert!((changes[0].mean[0] - (1.01 * 1.01 - 1.0)).abs() < 1e-9); // δE/E
    /// assert!(changes[0].largest[2] < 1e-9); // δG/G
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn changes(&self, surface: &Surface) -> Result<Vec<MetricChange>> {
        let now = self.matching(surface)?;
        let leaf_change = |(then, now): (&[[f64; 3]; POINTS], &[[f64; 3]; POINTS])| {
            let mut change = MetricChange::default();
            for (q, ([e, f, g], [e1, f1, g1])) in quadrature().iter().zip(then.iter().zip(now)) {
                // Relative changes do not depend on the parametrisation of the leaf.
                let scale = [*e, (e * g).sqrt(), *g].map(|s| s.max(f64::MIN_POSITIVE));
                let sizes = [(e1 - e) / scale[0], (f1 - f) / scale[1], (g1 - g) / scale[2]].map(f64::abs);
                for d in 0..3 {
                    change.mean[d] += q.weight * sizes[d];
                    change.largest[d] = change.largest[d].max(sizes[d]);
                }
            }
            change
        };
        Ok(self.forms.iter().zip(&now.forms).map(leaf_change).collect())
    }

    fn matching(&self, surface: &Surface) -> Result<Self> {
        let leaves = surface.space().leaves().len();
        if leaves == self.forms.len() {
            return Ok(Self::new(surface));
        }
        Err(Error::input(format!(
            "cannot compare a metric of {} leaves with a surface of {leaves}",
            self.forms.len()
        )))
    }
}

impl SurfaceSystem {
    /// The information that a surface has this metric, linearised at `surface`: each gauge is a measurement
    /// of `|d_j S|²`. All points of a leaf together have the relative standard deviation `sigma[leaf]`. (A
    /// stretch of 0.1 % changes `|d_j S|²` by 0.002.)
    ///
    /// Cost: about 50,000 multiply-adds per leaf.
    ///
    /// # Errors
    /// `Input` when the numbers of leaves differ, or the matrix would be too large.
    pub fn isometry(&self, surface: &Surface, metric: &Metric, sigma: &[f64]) -> Result<BlockInformation> {
        let leaves = self.space().leaves().len();
        if metric.forms.len() != leaves || sigma.len() != leaves {
            return Err(Error::input(format!(
                "expected a metric and σ of {leaves} leaves, found {} and {}",
                metric.forms.len(),
                sigma.len()
            )));
        }
        let points = quadrature().map(|q| (q, slopes(&q)));
        self.accumulate(|leaf, cell| {
            let side = self.space().leaves()[leaf].side();
            let mut any = false;
            for ((q, [du, dv]), form) in points.iter().zip(&metric.forms[leaf]) {
                let Some(gauges) = rosette(form) else { continue };
                let jet = surface.leaf_jet(leaf, q.local[0], q.local[1]);
                // Lengths instead of E, F and G: a row of the sparse equations weighs its vertices along one
                // direction, and F couples two.
                for [a, b] in gauges {
                    let row: [f64; 16] = std::array::from_fn(|k| (a * du[k] + b * dv[k]) / side);
                    let along = directional(&jet, a, b);
                    let square = along.length_squared();
                    // The quadrature weights of a leaf sum to one, so all its gauges together have the stated
                    // σ.
                    cell.add_scalar(&row, 2.0 * along, 1.0 + square, q.weight / sigma[leaf].powi(2));
                }
                any = true;
            }
            any
        })
    }
}

/// `a S_u + b S_v`.
fn directional(jet: &Jet, a: f64, b: f64) -> DVec3 {
    a * jet.du + b * jet.dv
}

/// Derivatives of the sixteen functions of a leaf with respect to local coordinates.
fn slopes(q: &QuadraturePoint) -> [[f64; 16]; 2] {
    let [bu, bv] = q.local.map(cubic);
    [
        std::array::from_fn(|k| bu[1][k % 4] * bv[0][k / 4]),
        std::array::from_fn(|k| bu[0][k % 4] * bv[1][k / 4]),
    ]
}

/// Components of the gauges along `S_u` and `S_v`; `None` if the surface has no tangent plane.
fn rosette([e, f, g]: &[f64; 3]) -> Option<[[f64; 2]; 3]> {
    let area2 = e * g - f * f;
    if !(*e > 0.0 && area2 > 1e-12 * (e + g) * (e + g)) {
        return None;
    }
    // Orthonormal: e1 = ∂u/√E, e2 = (∂v − F/E ∂u) √(E/area²).
    let (first, second) = (1.0 / e.sqrt(), (e / area2).sqrt());
    Some(GAUGES.map(|[x, y]| [x * first - y * second * f / e, y * second]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::fit_function;
    use crate::hierarchy::{Hierarchy, Shape};
    use planish_core::vector3::coordinates;
    use std::sync::Arc;

    /// A skew 3 × 2 grid of the plane, and the same grid rolled onto a cylinder along a slanted line.
    fn flat_and_rolled(space: &Arc<Hierarchy>, radius: f64) -> [Surface; 2] {
        let material = |u: f64, v: f64| [u / 4.0 + 0.1 * v / 4.0, v / 4.0];
        let flat = fit_function(space, |u, v| {
            let [x, y] = material(u, v);
            DVec3::new(x, y, 0.0)
        });
        let rolled = fit_function(space, |u, v| {
            let [x, y] = material(u, v);
            let (s, t) = (0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x);
            DVec3::new(radius * (s / radius).sin(), t, radius * (1.0 - (s / radius).cos()))
        });
        [flat.unwrap(), rolled.unwrap()]
    }

    #[test]
    fn a_rolled_sheet_keeps_the_metric_and_a_stretched_one_does_not() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [12, 8]).unwrap());
        let [flat, rolled] = flat_and_rolled(&space, 1.5);
        let metric = Metric::new(&flat);
        let worst = |surface: &Surface| {
            let all = metric.changes(surface).unwrap();
            all.iter().flat_map(|c| c.largest).fold(0.0, f64::max)
        };
        // The error of a rolled spline is of third order in cell size over radius.
        assert!(worst(&rolled) < 2e-4, "{}", worst(&rolled));
        let longer = flat.vertices().iter().map(|p| DVec3::new(1.02 * p.x, p.y, p.z)).collect();
        let longer = flat.with_vertices(longer).unwrap();
        assert!((worst(&longer) - (1.02_f64.powi(2) - 1.0)).abs() < 0.01);
    }

    #[test]
    fn the_equations_hold_at_an_isometry_and_lead_back_to_it() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [12, 8]).unwrap());
        let [flat, rolled] = flat_and_rolled(&space, 1.5);
        let system = SurfaceSystem::new(&space).unwrap();
        let metric = Metric::new(&flat);
        let sigma = vec![1e-3; space.leaves().len()];
        let misfit = |surface: &Surface| {
            let information = system.isometry(surface, &metric, &sigma).unwrap();
            let x = coordinates(surface.vertices());
            let mut product = vec![0.0; x.len()];
            information.multiply(x, &mut product).unwrap();
            let gradient: Vec<f64> = information.vector().iter().zip(&product).map(|(a, b)| a - b).collect();
            (information, gradient)
        };
        let size = |g: &[f64]| g.iter().map(|x| x * x).sum::<f64>().sqrt();
        let wider = rolled.vertices().iter().map(|p| 1.01 * p).collect();
        let wider = rolled.with_vertices(wider).unwrap();
        let (at_rest, stretched) = (misfit(&rolled).1, misfit(&wider).1);
        assert!(size(&at_rest) < 0.02 * size(&stretched), "{} {}", size(&at_rest), size(&stretched));
        // One Gauss–Newton step removes the stretch; a small prior fixes bending and rigid motions.
        let mut information = misfit(&wider).0;
        let hold = 1e-9 * information.diagonal().iter().sum::<f64>() / information.dimension() as f64;
        information.add_diagonal(hold);
        let x = coordinates(wider.vertices());
        for (v, c) in information.vector_mut().iter_mut().zip(x) {
            *v += hold * c;
        }
        let mut solution = information.vector().to_vec();
        system.factorize(&information).unwrap().solve_in_place(&mut solution).unwrap();
        let back = system.surface(&solution).unwrap();
        let mean = |surface: &Surface| {
            let all = metric.changes(surface).unwrap();
            all.iter().map(|c| c.mean[0]).sum::<f64>() / all.len() as f64
        };
        assert!(mean(&back) < 0.05 * mean(&wider), "{} {}", mean(&back), mean(&wider));
    }
}
