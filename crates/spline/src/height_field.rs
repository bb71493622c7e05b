//! Bicubic height fields over scattered points, with smoothness estimated from the data.
//!
//! Input: heights at points of a plane, each with its information. Output: a uniform bicubic B-spline (R.
//! Mohr, C. Zhao, G. Koscielny, *Fusion of 3D B-spline surface patches*, 1994, eq. 3)
//!
//! `F(x, y) = Σ_ij α_ij B_i(x) B_j(y)`, the minimum of
//! `Σ w_k (F(x_k, y_k) − z_k)² + τ ∫∫ (∂⁶F/∂x³∂y³)² + ε (F_xx² + 2 F_xy² + F_yy²)` (their eq. 4, plus a term
//! of second order), lengths in cells,
//!
//! with its covariance. Their energy alone is zero for `3 (m + 3) + 3 (n + 3) − 9` functions: all quadratics
//! in x with splines of y as coefficients, and vice versa. Gaps in the data then make the system singular.
//! With the second term only planes have zero energy. τ is estimated by REML.
//!
//! Not guaranteed: values outside the bounding box of the points; cells that are small enough for the shape.

use crate::basis::cubic;
use planish_core::BoundingBox;
use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, ElementScatter, NodeOrdering, SelectedInverse,
    SymbolicFactor,
};
use planish_estimate::{
    Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch,
    maximize_restricted_likelihood,
};
use std::sync::Arc;

/// `ε`: weight of the second-order term relative to the sixth-order term. A small value closes the null
/// space; a large one flattens the field (tests `only_planes_have_zero_energy` and
/// `heights_are_recovered_with_a_correct_sigma`).
const SECOND_ORDER: f64 = 1e-2;
/// Maximum number of control heights. More indicate a cell size that is too small by mistake.
const MAX_CELLS: usize = 250_000;
/// Gauss–Legendre points and weights on `[0, 1]`, exact to degree 7; products of cubics have degree 6.
const NODES: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_93),
    (0.330_009_478_207_571_87, 0.326_072_577_431_273_07),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_07),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_93),
];

/// A measured height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeightReading {
    /// The point in the plane.
    pub place: [f64; 2],
    /// The height at the point.
    pub height: f64,
    /// Inverse of its variance.
    pub information: f64,
}

/// A height with its slopes and variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Height {
    /// `F(x, y)`.
    pub height: f64,
    /// `∂F/∂x`, `∂F/∂y`.
    pub slope: [f64; 2],
    /// The posterior variance of the height.
    pub variance: f64,
}

/// A bicubic height field with its covariance.
#[derive(Debug, Clone)]
pub struct HeightField {
    grid: Grid,
    coefficients: Vec<f64>,
    covariance: SelectedInverse,
    /// τ, in cells.
    pub weight: f64,
    /// The scale of all covariances; 1 if it was given as known.
    pub dispersion: f64,
}

impl HeightField {
    /// Fits a field with cells of a given side.
    ///
    /// Cost: about twenty sparse factorisations of `(m + 3)(n + 3)` unknowns.
    ///
    /// # Errors
    /// `Input` for fewer than four readings, values that are not finite or not positive, or more than 250,000
    /// cells; `Undetermined` if all points are collinear.
    ///
    /// # Examples
    /// ```
    /// use planish_estimate::Dispersion;
    /// use planish_spline::{HeightField, HeightReading};
    /// let readings: Vec<HeightReading> = (0..400)
    ///     .map(|k| {
    ///         let (x, y) = (f64::from(k % 20), f64::from(k / 20));
    ///         HeightReading { place: [x, y], height: 0.02 * x * x - 0.1 * y, information: 1e4 }
    ///     })
    ///     .collect();
    /// let field = HeightField::fit(&readings, 2.5, Dispersion::Known(1.0))?;
    /// let middle = field.at([9.3, 8.1]).expect("a point inside the grid");
    /// assert!((middle.height - (0.02 * 9.3 * 9.3 - 0.81)).abs() < 0.01 && middle.variance < 1e-4);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn fit(readings: &[HeightReading], cell: f64, dispersion: Dispersion) -> Result<Self> {
        if !(cell > 0.0 && cell.is_finite()) {
            return Err(Error::input(format!("the side of a cell must be positive, found {cell}")));
        }
        if readings.len() < 4 {
            return Err(Error::input(format!(
                "a height field needs at least four heights, found {}",
                readings.len()
            )));
        }
        let bad = |r: &HeightReading| {
            !(r.place.iter().all(|x| x.is_finite())
                && r.height.is_finite()
                && r.information > 0.0
                && r.information.is_finite())
        };
        if let Some(at) = readings.iter().position(bad) {
            return Err(Error::input(format!(
                "height {at}: expected a finite point and height and a positive information, found {:?}",
                readings[at]
            )));
        }
        let bounds: BoundingBox<[f64; 2]> = readings.iter().map(|r| r.place).collect();
        let sides: [f64; 2] = std::array::from_fn(|k| (bounds.extent()[k] / cell).ceil().max(1.0));
        // In floating point: for a tiny cell the product does not fit an integer.
        if sides[0] * sides[1] > MAX_CELLS as f64 {
            return Err(Error::input(format!(
                "a cell size of {cell} gives {} × {} cells: expected at most {MAX_CELLS}",
                sides[0], sides[1]
            )));
        }
        let cells = sides.map(|s| s as usize);
        let mut field = Grid { origin: bounds.min, cell, cells };
        // Centre the grid, so that the points at both ends are inside.
        for k in 0..2 {
            field.origin[k] -= 0.5 * (cells[k] as f64 * cell - bounds.extent()[k]);
        }
        field.solve(readings, dispersion)
    }

    /// The height at a point; `None` outside the cells.
    #[must_use]
    pub fn at(&self, place: [f64; 2]) -> Option<Height> {
        let (first, local) = self.grid.locate(place);
        let nodes = self.grid.nodes(first);
        if !inside(local) {
            return None;
        }
        Some(self.within(&nodes, local, &self.covariance.dense(&nodes)?))
    }

    /// [`HeightField::at`] for many points: the covariance of a cell is looked up once for all of its points.
    #[must_use]
    pub fn at_all(&self, places: &[[f64; 2]]) -> Vec<Option<Height>> {
        let located: Vec<([usize; 2], [f64; 2])> = places.iter().map(|p| self.grid.locate(*p)).collect();
        let mut order: Vec<usize> = (0..places.len()).filter(|k| inside(located[*k].1)).collect();
        // Sorted by cell: the covariance of its sixteen nodes is the expensive part. The sort is stable, so
        // results do not depend on it.
        order.sort_by_key(|k| located[*k].0);
        let mut all = vec![None; places.len()];
        let mut covariance = Vec::new();
        for of_cell in order.chunk_by(|a, b| located[*a].0 == located[*b].0) {
            // One look-up for all points of the cell.
            let nodes = self.grid.nodes(located[of_cell[0]].0);
            if !self.covariance.dense_into(&nodes, &mut covariance) {
                continue;
            }
            for k in of_cell {
                all[*k] = Some(self.within(&nodes, located[*k].1, &covariance));
            }
        }
        all
    }

    /// The height at a point of a cell, given the covariance of its control heights.
    fn within(&self, nodes: &[u32; 16], local: [f64; 2], covariance: &[f64]) -> Height {
        let Grid { cell, .. } = self.grid;
        let [x, y] = local.map(cubic);
        let weights =
            |ox: usize, oy: usize| -> [f64; 16] { std::array::from_fn(|k| x[ox][k % 4] * y[oy][k / 4]) };
        let sum = |w: &[f64; 16]| -> f64 {
            nodes.iter().zip(w).map(|(n, w)| w * self.coefficients[*n as usize]).sum()
        };
        let value = weights(0, 0);
        let variance: f64 = (value.iter().zip(covariance.chunks_exact(16)))
            .map(|(w, row)| w * row.iter().zip(&value).map(|(c, v)| c * v).sum::<f64>())
            .sum();
        Height {
            height: sum(&value),
            slope: [sum(&weights(1, 0)) / cell, sum(&weights(0, 1)) / cell],
            variance: self.dispersion * variance.max(0.0),
        }
    }
}

/// True if local coordinates lie in the cell, up to rounding at the ends. False if they are not finite.
fn inside(local: [f64; 2]) -> bool {
    local.iter().all(|t| (-1e-9..=1.0 + 1e-9).contains(t))
}

/// The cells of a field.
#[derive(Debug, Clone, Copy)]
struct Grid {
    origin: [f64; 2],
    cell: f64,
    cells: [usize; 2],
}

impl Grid {
    /// The cell of a point (or the nearest one), and the local coordinates.
    fn locate(&self, place: [f64; 2]) -> ([usize; 2], [f64; 2]) {
        let t: [f64; 2] = std::array::from_fn(|k| (place[k] - self.origin[k]) / self.cell);
        let first: [usize; 2] = std::array::from_fn(|k| (t[k].max(0.0) as usize).min(self.cells[k] - 1));
        (first, std::array::from_fn(|k| t[k] - first[k] as f64))
    }

    /// The sixteen control heights of a cell.
    fn nodes(&self, first: [usize; 2]) -> [u32; 16] {
        std::array::from_fn(|k| ((first[1] + k / 4) * (self.cells[0] + 3) + first[0] + k % 4) as u32)
    }

    fn solve(&self, readings: &[HeightReading], dispersion: Dispersion) -> Result<HeightField> {
        let unknowns = (self.cells[0] + 3) * (self.cells[1] + 3);
        let elements =
            || (0..self.cells[0] * self.cells[1]).map(|k| self.nodes([k % self.cells[0], k / self.cells[0]]));
        let pattern = Arc::new(BlockPattern::from_elements(unknowns, elements())?);
        let places: Vec<[f64; 2]> = (0..unknowns)
            .map(|k| [(k % (self.cells[0] + 3)) as f64, (k / (self.cells[0] + 3)) as f64])
            .collect();
        // Few fill entries on a grid, and independent subtrees for the threads.
        let ordering = NodeOrdering::nested_dissection(&pattern, &places)?;
        let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &ordering, 1)?);

        let scatters: Vec<ElementScatter> =
            elements().map(|nodes| ElementScatter::new(&pattern, &nodes)).collect::<Result<_>>()?;
        let mut energy = BlockInformation::zeros(pattern.clone(), 1, 1)?;
        let element = energy_of_cell();
        for scatter in &scatters {
            energy.add_scattered(scatter, &element, &[0.0; 16])?;
        }
        let mut data = BlockInformation::zeros(pattern, 1, 1)?;
        let mut squares = 0.0;
        let mut of_cell: Vec<Vec<(&HeightReading, [f64; 2])>> =
            vec![Vec::new(); self.cells[0] * self.cells[1]];
        for r in readings {
            let (first, local) = self.locate(r.place);
            // Sum the readings of a cell in a dense element first: one scatter per cell instead of one per
            // reading.
            of_cell[first[1] * self.cells[0] + first[0]].push((r, local));
        }
        for (at, members) in of_cell.iter().enumerate().filter(|(_, m)| !m.is_empty()) {
            let (mut matrix, mut vector) = ([0.0; 256], [0.0; 16]);
            for (r, local) in members {
                let [x, y] = local.map(|t| cubic(t)[0]);
                let w: [f64; 16] = std::array::from_fn(|k| x[k % 4] * y[k / 4]);
                for i in 0..16 {
                    let scaled = r.information * w[i];
                    vector[i] += scaled * r.height;
                    for j in 0..16 {
                        matrix[16 * i + j] += scaled * w[j];
                    }
                }
                squares += r.information * r.height * r.height;
            }
            data.add_scattered(&scatters[at], &matrix, &vector)?;
        }

        let at_weight = |weight: f64| -> Result<(CholeskyFactor, Vec<f64>)> {
            let mut both = data.clone();
            both.add_scaled(&energy, weight)?;
            let factor = CholeskyFactor::factorize(&symbolic, &both)?;
            let mut x = data.vector().to_vec();
            factor.solve_in_place(&mut x)?;
            Ok((factor, x))
        };
        let model = SmoothnessModel {
            // Planes have no energy, so the prior leaves three unknowns free.
            rank: unknowns - 3,
            unknowns,
            equations: readings.len(),
            log_pseudo_determinant: 0.0,
            dispersion,
        };
        let evaluate = |weight: f64| -> Result<SmoothnessEvaluation> {
            let (factor, x) = at_weight(weight)?;
            let along: f64 = x.iter().zip(data.vector()).map(|(x, y)| x * y).sum();
            let roughness = energy.quadratic_form(&x)?;
            Ok(SmoothnessEvaluation {
                log_determinant: factor.log_determinant(),
                // x solves (D + τ E) x = b, so xᵀ D x = xᵀ b − τ xᵀ E x saves a product with D.
                residual: (squares - along - weight * roughness).max(0.0),
                roughness,
                trace: None,
            })
        };
        // Start where data and prior have equal traces.
        let total = |of: &BlockInformation| of.diagonal().iter().sum::<f64>();
        let search = SmoothnessSearch {
            // The likelihood is flat at its maximum, so a finer weight hardly changes heights or variances.
            tolerance: 0.05,
            ..SmoothnessSearch::from_start(total(&data) / total(&energy))
        };
        let found = maximize_restricted_likelihood(&model, &search, evaluate)?;
        // Factorised again: storing the factor of every weight would need more memory than one factorisation
        // costs time.
        let (factor, coefficients) = at_weight(found.weight)?;
        Ok(HeightField {
            grid: *self,
            coefficients,
            covariance: SelectedInverse::new(&factor),
            weight: found.weight,
            dispersion: found.dispersion,
        })
    }
}

/// `∫∫ (∂⁶F/∂x³∂y³)² + ε (F_xx² + 2 F_xy² + F_yy²)` of a cell of unit side (exact).
fn energy_of_cell() -> [f64; 256] {
    let gram: [[[f64; 4]; 4]; 4] = std::array::from_fn(|order| {
        let mut sum = [[0.0; 4]; 4];
        for (t, w) in NODES {
            let b = cubic(t)[order];
            for i in 0..4 {
                for j in 0..4 {
                    sum[i][j] += w * b[i] * b[j];
                }
            }
        }
        sum
    });
    let product = |x: usize, y: usize, i: usize, j: usize| gram[x][i % 4][j % 4] * gram[y][i / 4][j / 4];
    std::array::from_fn(|k| {
        let (i, j) = (k / 16, k % 16);
        // The null space of the sixth-order term contains all sums of functions whose third derivative
        // vanishes in one direction. The small second-order term leaves only planes.
        product(3, 3, i, j)
            + SECOND_ORDER * (product(2, 0, i, j) + 2.0 * product(1, 1, i, j) + product(0, 2, i, j))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
    }

    fn noisy(count: usize, sigma: f64, seed: u64, gap: bool) -> Vec<HeightReading> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut readings = Vec::new();
        while readings.len() < count {
            let place = [20.0 * rng.random::<f64>(), 14.0 * rng.random::<f64>()];
            if gap && (place[0] - 10.0).hypot(place[1] - 7.0) < 4.0 {
                continue;
            }
            readings.push(HeightReading {
                place,
                height: truth(place) + sigma * normal(&mut rng),
                information: 1.0 / (sigma * sigma),
            });
        }
        readings
    }

    fn truth([x, y]: [f64; 2]) -> f64 {
        0.8 * (0.35 * x).sin() * (0.3 * y).cos() + 0.05 * x
    }

    #[test]
    fn the_energy_of_polynomials_is_analytic() {
        // Spline coefficients of x³y³ on one cell: the energy is 36² plus the second-order term.
        let cube: Vec<f64> = (0..4)
            .map(|i| {
                let g = i as f64 - 1.0;
                g * g * g - g
            })
            .collect();
        let x: Vec<f64> = (0..16).map(|k| cube[k % 4] * cube[k / 4]).collect();
        let element = energy_of_cell();
        let energy: f64 = (0..256).map(|k| x[k / 16] * element[k] * x[k % 16]).sum();
        // F_xx = 6x y³, F_xy = 9x²y²: ∫∫ 36x²y⁶ = 12/7, ∫∫ 81x⁴y⁴ = 81/25.
        let second = 2.0 * 12.0 / 7.0 + 2.0 * 81.0 / 25.0;
        let exact = 36.0 * 36.0 + SECOND_ORDER * second;
        assert!((energy / exact - 1.0).abs() < 1e-12, "{energy}, {exact}");
    }

    #[test]
    fn only_planes_have_zero_energy() {
        // The energy as printed is zero for 3 (m + 3) + 3 (n + 3) − 9 functions: 15 of 16 on a single cell.
        let element = DMatrix::from_row_slice(16, 16, &energy_of_cell());
        let eigen = element.symmetric_eigen().eigenvalues;
        let largest = eigen.iter().copied().fold(0.0, f64::max);
        assert_eq!(eigen.iter().filter(|e| **e < 1e-12 * largest).count(), 3, "{eigen}");
    }

    #[test]
    fn heights_are_recovered_with_a_correct_sigma() {
        let (mut squares, mut covered, mut count) = (0.0, 0, 0);
        for seed in 0..6 {
            let field =
                HeightField::fit(&noisy(1500, 0.05, seed, false), 1.0, Dispersion::Known(1.0)).unwrap();
            for k in 0..400 {
                let place = [1.0 + 18.0 * f64::from(k % 20) / 19.0, 1.0 + 12.0 * f64::from(k / 20) / 19.0];
                let found = field.at(place).unwrap();
                let off = (found.height - truth(place)) / found.variance.sqrt();
                squares += off * off;
                covered += usize::from(off.abs() < 1.96);
                count += 1;
            }
        }
        let share = f64::from(covered as u32) / f64::from(count);
        assert!((0.92..0.99).contains(&share), "{share}, {}", squares / f64::from(count));
    }

    #[test]
    fn an_unknown_sigma_is_estimated_and_gaps_have_a_larger_sigma() {
        let mut readings = noisy(1500, 0.05, 9, true);
        for r in &mut readings {
            r.information = 1.0;
        }
        let field = HeightField::fit(&readings, 1.0, Dispersion::Estimated).unwrap();
        assert!((field.dispersion.sqrt() / 0.05 - 1.0).abs() < 0.1, "{}", field.dispersion.sqrt());
        let (gap, seen) = (field.at([10.0, 7.0]).unwrap(), field.at([3.0, 3.0]).unwrap());
        assert!(gap.variance > 9.0 * seen.variance, "{gap:?} {seen:?}");
        assert!((gap.height - truth([10.0, 7.0])).abs() < 4.0 * gap.variance.sqrt());
        assert!(field.at([30.0, 7.0]).is_none());
        let places = [[3.0, 3.0], [30.0, 7.0], [10.0, 7.0], [3.1, 3.0], [f64::NAN, 1.0]];
        assert_eq!(field.at_all(&places), places.map(|p| field.at(p)));
        let step = 1e-6;
        let [along, across] = [[3.0 + step, 3.0], [3.0, 3.0 + step]]
            .map(|p| (field.at(p).unwrap().height - seen.height) / step);
        assert!((along - seen.slope[0]).abs() < 1e-5 && (across - seen.slope[1]).abs() < 1e-5);
    }

    #[test]
    fn messages_name_the_invalid_value() {
        let readings = noisy(10, 0.1, 1, false);
        let message = |readings: &[HeightReading], cell: f64| {
            HeightField::fit(readings, cell, Dispersion::Known(1.0)).unwrap_err().to_string()
        };
        assert!(message(&readings, 0.0).contains("positive"));
        assert!(message(&readings, 1e-6).contains("at most"));
        assert!(message(&readings[..3], 1.0).contains("four"));
        let mut bad = readings;
        bad[7].information = 0.0;
        assert!(message(&bad, 1.0).contains("height 7"));
    }
}
