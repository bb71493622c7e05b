//! Bending without stretch: a surface that keeps the lengths of another one, as measurements of its vertices.
//!
//! Comes in: a reference [`Surface`]. Goes out: its [`Metric`], the information that "lengths are as they
//! were" gives about the vertices of another surface over the same hierarchy, and how far that one's first
//! fundamental form has changed. Points with the same `(u, v)` are the same point of the sheet.
//!
//! An isometry keeps `E, F, G`; that it keeps Gaussian curvature follows, and is not enough: a plane that is
//! stretched stays flat. At every quadrature point stand three strain gauges, a rosette: tangents `d_j` of
//! unit length in the reference's metric, 60° apart. Each is one measurement,
//!
//! ```text
//! |d_j S|² = 1,      d_j S = a_j S_u + b_j S_v,      linearised: 2 d_jS · d_j(S + δS) = 1 + |d_jS|²
//! ```
//!
//! and the three know as much as E, F and G: `Σ_j (d_jᵀ ε d_j)² = 3/8 (2 tr ε² + (tr ε)²)` in any frame.
//!
//! Not guaranteed: an exact isometry. A spline is one only in the limit of small cells; what is left shows in
//! [`Metric::changes`].
//!
//! # References
//! do Carmo, *Differential Geometry of Curves and Surfaces*, 1976, section 4.2 (isometries keep the first
//! fundamental form); Perry & Lissner, *The Strain Gage Primer*, 1955 (the delta rosette).

use crate::basis::cubic;
use crate::energy::{QuadraturePoint, quadrature};
use crate::surface::{Jet, Surface};
use crate::system::SurfaceSystem;
use planish_estimate::sparse::BlockInformation;
use planish_estimate::vector3::{add_scaled, dot, scale};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Quadrature points of a leaf.
const POINTS: usize = 16;
/// Directions of the gauges in an orthonormal frame.
const GAUGES: [[f64; 2]; 3] = [[1.0, 0.0], [0.5, 0.866_025_403_784_438_6], [-0.5, 0.866_025_403_784_438_6]];

/// The first fundamental form of a surface at the quadrature points of every leaf.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// `E, F, G` leaf by leaf.
    forms: Vec<[[f64; 3]; POINTS]>,
}

/// How far the first fundamental form of one leaf has changed, over its quadrature points:
/// `δE/E, δF/√(EG), δG/G`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MetricChange {
    /// The mean of each size.
    pub mean: [f64; 3],
    /// The largest of each.
    pub largest: [f64; 3],
}

impl Metric {
    /// That of a surface.
    #[must_use]
    pub fn of(surface: &Surface) -> Self {
        let points = quadrature();
        let forms = (0..surface.space().leaves().len())
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| points.map(|q| surface.leaf_jet(leaf, q.local[0], q.local[1]).first_form()))
            .collect();
        Self { forms }
    }

    /// Takes the forms of one leaf from another metric over the same hierarchy.
    pub fn take_leaf(&mut self, leaf: usize, from: &Self) {
        self.forms[leaf] = from.forms[leaf];
    }

    /// How far the form of another surface over the same hierarchy differs, leaf by leaf.
    ///
    /// # Errors
    /// `Input` when the other has another number of leaves.
    pub fn changes(&self, surface: &Surface) -> Result<Vec<MetricChange>> {
        let now = self.matching(surface)?;
        let leaf_change = |(then, now): (&[[f64; 3]; POINTS], &[[f64; 3]; POINTS])| {
            let mut change = MetricChange::default();
            for (q, ([e, f, g], [e1, f1, g1])) in quadrature().iter().zip(then.iter().zip(now)) {
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
            return Ok(Self::of(surface));
        }
        Err(Error::input(format!(
            "a metric of {} leaves cannot be compared with a surface of {leaves}",
            self.forms.len()
        )))
    }
}

impl SurfaceSystem {
    /// The information that a surface has this metric, linearised at `surface`: each gauge is a measurement
    /// of `|d_j S|²`, all points of a leaf together with the standard deviation `sigma[leaf]`, a share. (A
    /// sheet that stretches by 0.1 % changes it by 0.002.)
    ///
    /// Cost: about 50,000 multiply-adds a leaf.
    ///
    /// # Errors
    /// `Input` when metric or σ are of another number of leaves, or the matrix would be too large.
    pub fn isometry(&self, surface: &Surface, metric: &Metric, sigma: &[f64]) -> Result<BlockInformation> {
        let leaves = self.space().leaves().len();
        if metric.forms.len() != leaves || sigma.len() != leaves {
            return Err(Error::input(format!(
                "needed a metric and σ of {leaves} leaves, found {} and {}",
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
                for [a, b] in gauges {
                    let row: [f64; 16] = std::array::from_fn(|k| (a * du[k] + b * dv[k]) / side);
                    let along = directional(&jet, a, b);
                    let square = dot(along, along);
                    cell.add_scalar(&row, scale(2.0, along), 1.0 + square, q.weight / sigma[leaf].powi(2));
                }
                any = true;
            }
            any
        })
    }
}

/// `a S_u + b S_v`.
fn directional(jet: &Jet, a: f64, b: f64) -> [f64; 3] {
    add_scaled(scale(a, jet.du), b, jet.dv)
}

/// The derivatives of a leaf's sixteen functions by local coordinates.
fn slopes(q: &QuadraturePoint) -> [[f64; 16]; 2] {
    let [bu, bv] = q.local.map(cubic);
    [
        std::array::from_fn(|k| bu[1][k % 4] * bv[0][k / 4]),
        std::array::from_fn(|k| bu[0][k % 4] * bv[1][k / 4]),
    ]
}

/// The gauges by their components along `S_u` and `S_v`; none where the surface has no tangent plane.
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
    use std::sync::Arc;

    /// A skew grid of the plane, 3 × 2 long, and the same rolled onto a cylinder along a slanted line.
    fn flat_and_rolled(space: &Arc<Hierarchy>, radius: f64) -> [Surface; 2] {
        let material = |u: f64, v: f64| [u / 4.0 + 0.1 * v / 4.0, v / 4.0];
        let flat = fit_function(space, |u, v| {
            let [x, y] = material(u, v);
            [x, y, 0.0]
        });
        let rolled = fit_function(space, |u, v| {
            let [x, y] = material(u, v);
            let (s, t) = (0.8 * x + 0.6 * y, 0.8 * y - 0.6 * x);
            [radius * (s / radius).sin(), t, radius * (1.0 - (s / radius).cos())]
        });
        [flat.unwrap(), rolled.unwrap()]
    }

    #[test]
    fn a_rolled_sheet_keeps_the_metric_and_a_stretched_one_does_not() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [12, 8]).unwrap());
        let [flat, rolled] = flat_and_rolled(&space, 1.5);
        let metric = Metric::of(&flat);
        let worst = |surface: &Surface| {
            let all = metric.changes(surface).unwrap();
            all.iter().flat_map(|c| c.largest).fold(0.0, f64::max)
        };
        // Splines roll to the third order of cell over radius.
        assert!(worst(&rolled) < 2e-4, "{}", worst(&rolled));
        let longer = flat.vertices().iter().map(|[x, y, z]| [1.02 * x, *y, *z]).collect();
        let longer = flat.with_vertices(longer).unwrap();
        assert!((worst(&longer) - (1.02_f64.powi(2) - 1.0)).abs() < 0.01);
    }

    #[test]
    fn the_equations_hold_at_an_isometry_and_point_back_to_it() {
        let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [12, 8]).unwrap());
        let [flat, rolled] = flat_and_rolled(&space, 1.5);
        let system = SurfaceSystem::new(&space).unwrap();
        let metric = Metric::of(&flat);
        let sigma = vec![1e-3; space.leaves().len()];
        let misfit = |surface: &Surface| {
            let information = system.isometry(surface, &metric, &sigma).unwrap();
            let x: Vec<f64> = surface.vertices().iter().flatten().copied().collect();
            let mut there = vec![0.0; x.len()];
            information.multiply(&x, &mut there).unwrap();
            let gradient: Vec<f64> = information.vector().iter().zip(&there).map(|(a, b)| a - b).collect();
            (information, gradient)
        };
        let size = |g: &[f64]| g.iter().map(|x| x * x).sum::<f64>().sqrt();
        let wider = rolled.vertices().iter().map(|p| p.map(|c| 1.01 * c)).collect();
        let wider = rolled.with_vertices(wider).unwrap();
        let (at_rest, stretched) = (misfit(&rolled).1, misfit(&wider).1);
        assert!(size(&at_rest) < 0.02 * size(&stretched), "{} {}", size(&at_rest), size(&stretched));
        // One Gauss–Newton step takes the stretch back, bends and rigid motions held by a trace.
        let mut information = misfit(&wider).0;
        let hold = 1e-9 * information.diagonal().iter().sum::<f64>() / information.dimension() as f64;
        information.add_diagonal(hold);
        let x: Vec<f64> = wider.vertices().iter().flatten().copied().collect();
        for (v, c) in information.vector_mut().iter_mut().zip(&x) {
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
