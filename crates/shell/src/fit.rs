//! A shell fitted to points: control points moved until the mesh goes through noisy readings of the real thing.
//!
//! Comes in: a mesh, a deformation, points with their covariance. Goes out: the parameters, their covariance, how far the stated σ are to be believed, and which points are gross errors.
//!
//! Every point is an equation `D(x_i; V0 + W q) = 0` (C eq. 9) with `D` of [`Shell::distance`], and nothing is searched for. Its variance is `nᵀ Σ_i n` along the gradient. The sum that is minimised is
//!
//! `Σ ρ(D_i/σ_i) + λ/2 · qᵀ K q`
//!
//! with a redescending loss `ρ` (the paper's field saturates far away and so drops outliers by itself; a distance does not), and `λ` by marginal likelihood (S. Wood, M. Fasiolo 2017). The sharpness `k` rises
//! step by step: coarse fields see over gaps and thin parts, sharp ones are exact.
//!
//! Not guaranteed: the global optimum; a mesh that starts more than a tenth of its size away may be drawn to the wrong side of a thin part.

use crate::deformation::{Deformation, displacements};
use crate::field::{Metaball, Share, Shell, ShellOptions, subdivided};
use nalgebra::{DMatrix, DVector};
use planish_estimate::vector3::add;
use planish_estimate::{Error, Loss, Result, SmoothnessEvaluation, SmoothnessModel, Termination, gated_scale};
use planish_mesh::TriangleMesh;
use rayon::prelude::*;

/// Points that one thread sums up at a time: fixed, so that sums do not depend on the threads.
const CHUNK: usize = 512;
/// Parameters at most: equations are dense.
const MOST_PARAMETERS: usize = 6000;
/// Metaballs that give less than `exp(−9)` of the largest are left out: on a surface all of them together give 0.1 %.
const REACH: f64 = 9.0;
/// Gate of the scale of residuals, in standard deviations.
const GATE: f64 = 3.0;

/// A point with its noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointReading {
    /// Where.
    pub at: [f64; 3],
    /// Its covariance `[xx, xy, xz, yy, yz, zz]`.
    pub covariance: [f64; 6],
}

/// How a shell is fitted.
#[derive(Debug, Clone)]
pub struct ShellFitOptions {
    /// What metaballs are built around.
    pub metaball: Metaball,
    /// Thickness `1/k` of the field at first, as a share of the mesh's size, and at last.
    pub softness: (f64, f64),
    /// Steps of sharpness from the first to the last.
    pub steps: usize,
    /// Iterations at each.
    pub iterations: usize,
    /// What residuals cost.
    pub loss: Loss,
    /// Whether σ of the points are what they are, or stated up to a common factor.
    pub believe_sigma: bool,
    /// `K`, of all parameters: what is smooth. Nothing is asked for where none is given.
    pub stiffness: Option<DMatrix<f64>>,
    /// Facets that spherical shells are subdivided into, at most.
    pub most_facets: usize,
}

impl Default for ShellFitOptions {
    fn default() -> Self {
        Self {
            metaball: Metaball::Triangular,
            softness: (0.01, 0.001),
            steps: 3,
            iterations: 12,
            loss: Loss::tukey(),
            believe_sigma: false,
            stiffness: None,
            most_facets: 200_000,
        }
    }
}

/// A fitted shell.
#[derive(Debug, Clone)]
pub struct ShellFit {
    /// The parameters.
    pub parameters: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Vertices of the deformed mesh.
    pub positions: Vec<[f64; 3]>,
    /// By how much σ of the points are larger than stated.
    pub sigma_factor: f64,
    /// `λ`.
    pub smoothness_weight: f64,
    /// Root mean square of the distances of points that are no gross errors.
    pub rms: f64,
    /// Points that the loss ignores all but altogether.
    pub outliers: Vec<bool>,
    /// How it ended.
    pub termination: Termination,
    /// Iterations in all.
    pub iterations: usize,
}

/// One pass over all points.
struct Pass {
    information: DMatrix<f64>,
    vector: DVector<f64>,
    /// Sum of the loss.
    cost: f64,
}

/// The problem at one sharpness.
struct Problem<'a> {
    mesh: &'a TriangleMesh,
    /// For vertices of a subdivided mesh where they lie on that of the deformation.
    origins: Option<&'a [[(u32, f64); 3]]>,
    triangles: &'a [[u32; 3]],
    deformation: &'a dyn Deformation,
    points: &'a [PointReading],
    options: &'a ShellFitOptions,
    shell: ShellOptions,
}

impl Problem<'_> {
    /// The mesh that is wrapped, deformed.
    fn moved(&self, q: &DVector<f64>) -> TriangleMesh {
        let by = displacements(self.deformation, q);
        let own: Vec<[f64; 3]> = self.mesh.positions.iter().zip(by).map(|(p, by)| add(*p, by)).collect();
        let positions = match self.origins {
            None => own,
            Some(origins) => (origins.iter())
                .map(|origin| std::array::from_fn(|k| origin.iter().map(|(v, w)| w * own[*v as usize][k]).sum()))
                .collect(),
        };
        TriangleMesh {
            positions,
            triangles: self.triangles.to_vec(),
        }
    }

    /// Distances over their stated σ, by point.
    fn residuals(&self, shell: &Shell<'_>) -> Vec<f64> {
        self.points
            .par_chunks(CHUNK)
            .flat_map_iter(|points| {
                let mut shares = Vec::new();
                let residuals: Vec<f64> = (points.iter())
                    .map(|point| {
                        shell
                            .distance(point.at, &mut shares)
                            .map_or(0.0, |d| d.distance / sigma(point, d.gradient))
                    })
                    .collect();
                residuals
            })
            .collect()
    }

    /// The sum of the loss, σ being `factor` times what is stated.
    fn cost(&self, shell: &Shell<'_>, factor: f64) -> f64 {
        (self.residuals(shell).iter())
            .map(|r| self.options.loss.rho(r / factor))
            .sum()
    }

    /// Equations of all points over the basis of the deformation, residuals weighed as if σ were `factor` times what is stated.
    fn pass(&self, shell: &Shell<'_>, factor: f64) -> Pass {
        let basis = self.deformation.basis();
        let sums: Vec<Pass> = self
            .points
            .par_chunks(CHUNK.max(self.points.len() / 64))
            .map(|points| {
                let mut pass = Pass {
                    information: DMatrix::zeros(basis, basis),
                    vector: DVector::zeros(basis),
                    cost: 0.0,
                };
                let (mut shares, mut row, mut touched) = (Vec::new(), vec![0.0; basis], Vec::new());
                for point in points {
                    self.add(shell, point, factor, &mut pass, &mut shares, &mut row, &mut touched);
                }
                pass
            })
            .collect();
        let mut all = Pass {
            information: DMatrix::zeros(basis, basis),
            vector: DVector::zeros(basis),
            cost: 0.0,
        };
        for pass in sums {
            all.information += pass.information;
            all.vector += pass.vector;
            all.cost += pass.cost;
        }
        all.information.fill_upper_triangle_with_lower_triangle();
        match self.deformation.reduction() {
            None => all,
            Some(r) => Pass {
                information: r.tr_mul(&(all.information * r)),
                vector: r.tr_mul(&all.vector),
                cost: all.cost,
            },
        }
    }

    fn add(
        &self,
        shell: &Shell<'_>,
        point: &PointReading,
        factor: f64,
        pass: &mut Pass,
        shares: &mut Vec<Share>,
        row: &mut [f64],
        touched: &mut Vec<usize>,
    ) {
        let Some(found) = shell.distance(point.at, shares) else {
            return;
        };
        let sigma = factor * sigma(point, found.gradient);
        let residual = found.distance / sigma;
        pass.cost += self.options.loss.rho(residual);
        let weight = self.options.loss.weight(residual) / (sigma * sigma);
        if weight <= 0.0 {
            return;
        }
        let mut give = |vertex: u32, by: [f64; 3]| {
            self.deformation.row(vertex, by, &mut |k, entry| {
                if row[k] == 0.0 {
                    touched.push(k);
                }
                row[k] += entry;
            });
        };
        shell.by_vertices(point.at, shares, &found, |vertex, by| match self.origins {
            None => give(vertex, by),
            Some(origins) => {
                for (v, w) in origins[vertex as usize] {
                    if w != 0.0 {
                        give(v, by.map(|x| w * x));
                    }
                }
            }
        });
        touched.sort_unstable();
        touched.dedup();
        for (n, &i) in touched.iter().enumerate() {
            let scaled = weight * row[i];
            pass.vector[i] -= scaled * found.distance;
            for &j in &touched[n..] {
                pass.information[(j, i)] += scaled * row[j];
            }
        }
        for k in touched.drain(..) {
            row[k] = 0.0;
        }
    }
}

/// σ of a point along a direction that need not be a unit vector.
fn sigma(point: &PointReading, along: [f64; 3]) -> f64 {
    let [xx, xy, xz, yy, yz, zz] = point.covariance;
    let [x, y, z] = along;
    let variance = xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
    let length = (x * x + y * y + z * z).sqrt();
    if length > 1e-6 {
        variance.max(0.0).sqrt() / length
    } else {
        ((xx + yy + zz) / 3.0).sqrt()
    }
}

/// Fits a mesh to points.
///
/// # Errors
/// `Input` for a mesh and a deformation of different sizes, points or covariances that make no sense, or a stiffness of another size than the parameters; `Undetermined` for no points, or parameters on which
/// neither points nor smoothness say anything.
pub fn fit_points(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    points: &[PointReading],
    options: &ShellFitOptions,
) -> Result<ShellFit> {
    check(mesh, deformation, points, options)?;
    let size = planish_mesh::BoundingBox::of(&mesh.positions).map_or(0.0, |b| b.diagonal());
    let parameters = deformation.parameters();
    let stiffness = options
        .stiffness
        .clone()
        .unwrap_or_else(|| DMatrix::zeros(parameters, parameters));
    let mut smooth = Smoothness::new(stiffness)?;
    let mut q = DVector::zeros(parameters);
    let (mut factor, mut iterations) = (1.0, 0);
    let mut last = None;
    let (first, finest) = options.softness;
    for step in 0..options.steps.max(1) {
        let share = if options.steps > 1 {
            step as f64 / (options.steps - 1) as f64
        } else {
            1.0
        };
        let softness = size * first * (finest / first).powf(share);
        let sharpness = 1.0 / softness;
        let fine = match options.metaball {
            Metaball::Triangular => None,
            Metaball::Spherical => Some(subdivided(mesh, 1.5 * softness, options.most_facets)),
        };
        let problem = Problem {
            mesh,
            origins: fine.as_ref().map(|(_, origins)| &origins[..]),
            triangles: fine.as_ref().map_or(&mesh.triangles, |(fine, _)| &fine.triangles),
            deformation,
            points,
            options,
            shell: ShellOptions {
                reach: Some(REACH),
                ..ShellOptions::new(options.metaball, sharpness)
            },
        };
        let mut damping = 1e-6;
        let mut termination = Termination::Limit;
        let mut moved = problem.moved(&q);
        for _ in 0..options.iterations {
            iterations += 1;
            let shell = Shell::new(&moved, &problem.shell)?;
            if !options.believe_sigma {
                let residuals = problem.residuals(&shell);
                let scale = gated_scale(&residuals, GATE)?.sigma;
                // While the mesh is far away, residuals are shape; σ falls to that of the noise as it comes near.
                factor = if scale > 0.0 { scale } else { factor };
            }
            let pass = problem.pass(&shell, factor);
            let weight = smooth.weight(&pass, &q)?;
            let wanted = &pass.information + weight * &smooth.stiffness;
            let slope = &pass.vector - weight * (&smooth.stiffness * &q);
            let before = pass.cost + 0.5 * weight * smooth.roughness(&q);
            let mut shorter = false;
            let mut accepted = None;
            for _ in 0..8 {
                let change = solve(&wanted, damping, &slope)?;
                let next = &q + &change;
                let tried = problem.moved(&next);
                let cost = problem.cost(&Shell::new(&tried, &problem.shell)?, factor);
                let after = cost + 0.5 * weight * smooth.roughness(&next);
                if after <= before * (1.0 + 1e-12) {
                    let length = (change.dot(&(&wanted * &change)) / parameters as f64).sqrt();
                    shorter = length < 0.02;
                    accepted = Some((next, tried));
                    damping = (damping * 0.1).max(1e-9);
                    break;
                }
                damping = (damping * 10.0).max(1e-6);
            }
            last = Some((pass.information, weight));
            let Some((next, tried)) = accepted else {
                termination = Termination::ReachedTolerance;
                break;
            };
            q = next;
            moved = tried;
            if shorter {
                termination = Termination::Converged;
                break;
            }
        }
        if step + 1 == options.steps.max(1) {
            let shell = Shell::new(&moved, &problem.shell)?;
            let residuals = problem.residuals(&shell);
            let stated: Vec<f64> = points.iter().map(|point| sigma(point, [1.0, 0.0, 0.0])).collect();
            let outliers: Vec<bool> = residuals
                .iter()
                .map(|r| options.loss.weight(r / factor) < 0.05)
                .collect();
            let kept = outliers.iter().filter(|outlier| !**outlier).count();
            let sum: f64 = (residuals.iter().zip(&stated).zip(&outliers))
                .filter(|(_, outlier)| !**outlier)
                .map(|((r, sigma), _)| (r * sigma).powi(2))
                .sum();
            let (information, weight) = last.ok_or_else(|| Error::input("a fit needs at least one iteration"))?;
            let moments = options.loss.moments(1)?;
            // Reweighted equations are mean-weight times those of the data; an M-estimate's covariance is ψ²/ψ'² of these.
            let per_weight = moments.slope * moments.slope / (moments.influence_squared * moments.weight);
            let inverse = (per_weight * information + weight * &smooth.stiffness)
                .cholesky()
                .ok_or_else(undetermined)?
                .inverse();
            let by = displacements(deformation, &q);
            return Ok(ShellFit {
                positions: mesh.positions.iter().zip(by).map(|(p, by)| add(*p, by)).collect(),
                parameters: q,
                covariance: inverse,
                sigma_factor: factor,
                smoothness_weight: weight,
                rms: (sum / kept.max(1) as f64).sqrt(),
                outliers,
                termination,
                iterations,
            });
        }
    }
    Err(Error::input("a fit needs at least one step of sharpness"))
}

impl ShellFit {
    /// σ of a vertex along a direction: `√(dᵀ W_v Σ W_vᵀ d)`.
    #[must_use]
    pub fn sigma_along(&self, deformation: &dyn Deformation, vertex: u32, direction: [f64; 3]) -> f64 {
        let mut row = DVector::zeros(deformation.basis());
        deformation.row(vertex, direction, &mut |k, entry| row[k] += entry);
        let row = match deformation.reduction() {
            Some(reduction) => reduction.tr_mul(&row),
            None => row,
        };
        row.dot(&(&self.covariance * &row)).max(0.0).sqrt()
    }
}

/// The prior of smooth displacements and its weight.
struct Smoothness {
    stiffness: DMatrix<f64>,
    rank: usize,
    log_pseudo_determinant: f64,
    weight: f64,
}

impl Smoothness {
    fn new(stiffness: DMatrix<f64>) -> Result<Self> {
        let eigen = stiffness.clone().symmetric_eigen().eigenvalues;
        let largest = eigen.iter().copied().fold(0.0, f64::max);
        let positive: Vec<f64> = eigen.iter().copied().filter(|e| *e > 1e-10 * largest).collect();
        if eigen.iter().any(|e| *e < -1e-8 * largest) {
            return Err(Error::input("the stiffness of controls is not positive semidefinite"));
        }
        Ok(Self {
            rank: positive.len(),
            log_pseudo_determinant: positive.iter().map(|e| e.ln()).sum(),
            stiffness,
            weight: 0.0,
        })
    }

    fn roughness(&self, q: &DVector<f64>) -> f64 {
        q.dot(&(&self.stiffness * q))
    }

    /// The weight that makes the equations most likely, linearised where they are.
    fn weight(&mut self, pass: &Pass, q: &DVector<f64>) -> Result<f64> {
        if self.rank == 0 {
            return Ok(0.0);
        }
        let natural = pass.information.trace() / self.stiffness.trace();
        if natural <= 0.0 {
            return Err(undetermined());
        }
        if self.weight == 0.0 {
            self.weight = 0.01 * natural;
        }
        // The data say N x = N q + b of the whole displacement x.
        let target = &pass.information * q + &pass.vector;
        let model = SmoothnessModel {
            equations: q.len() + 1,
            unknowns: q.len(),
            rank: self.rank,
            log_pseudo_determinant: self.log_pseudo_determinant,
            dispersion: planish_estimate::Dispersion::Known(1.0),
        };
        for _ in 0..20 {
            let equations = &pass.information + self.weight * &self.stiffness;
            let Some(factor) = equations.cholesky() else {
                return Err(undetermined());
            };
            let x = factor.solve(&target);
            let evaluation = SmoothnessEvaluation {
                residual: 0.0,
                roughness: self.roughness(&x),
                log_determinant: 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>(),
                trace: Some(factor.solve(&self.stiffness).trace()),
            };
            let next = (model.fellner_schall_update(self.weight, &evaluation)?).clamp(1e-8 * natural, 1e8 * natural);
            let change = (next / self.weight).ln().abs();
            self.weight = next;
            if change < 0.02 {
                break;
            }
        }
        Ok(self.weight)
    }
}

fn undetermined() -> Error {
    Error::undetermined(
        "neither the points nor smoothness say where some controls are: give points all over the thing, fewer controls, or a stiffness that joins them",
    )
}

/// `(N + μ diag N) x = b`.
fn solve(equations: &DMatrix<f64>, damping: f64, right: &DVector<f64>) -> Result<DVector<f64>> {
    let mut damped = equations.clone();
    let mean = equations.trace() / equations.nrows() as f64;
    for k in 0..damped.nrows() {
        let own = damped[(k, k)];
        damped[(k, k)] += damping * own.max(1e-12 * mean);
    }
    Ok(damped.cholesky().ok_or_else(undetermined)?.solve(right))
}

fn check(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    points: &[PointReading],
    options: &ShellFitOptions,
) -> Result<()> {
    mesh.sanity_check()?;
    options.loss.validate()?;
    if deformation.vertices() != mesh.positions.len() {
        return Err(Error::input(format!(
            "the deformation moves {} vertices, the mesh has {}",
            deformation.vertices(),
            mesh.positions.len()
        )));
    }
    let parameters = deformation.parameters();
    if parameters == 0 || parameters > MOST_PARAMETERS {
        return Err(Error::unsupported(format!(
            "{parameters} parameters: needed between 1 and {MOST_PARAMETERS}, as a third as many control points"
        )));
    }
    if let Some(k) = options
        .stiffness
        .as_ref()
        .filter(|k| k.shape() != (parameters, parameters))
    {
        return Err(Error::input(format!(
            "the stiffness is {} × {}, and there are {parameters} parameters",
            k.nrows(),
            k.ncols()
        )));
    }
    let (first, finest) = options.softness;
    if !(first >= finest && finest > 0.0 && first.is_finite()) {
        return Err(Error::input(format!(
            "the softness of a shell falls from one positive share of its size to another, got {first} and {finest}"
        )));
    }
    if points.is_empty() {
        return Err(Error::undetermined("a shell cannot be fitted to no points"));
    }
    for (i, point) in points.iter().enumerate() {
        let [xx, _, _, yy, _, zz] = point.covariance;
        let finite = point.at.iter().chain(&point.covariance).all(|x| x.is_finite());
        if !finite || xx + yy + zz <= 0.0 || xx.min(yy).min(zz) < 0.0 {
            return Err(Error::input(format!(
                "point {i} is not finite or has no positive variance: {:?}, {:?}",
                point.at, point.covariance
            )));
        }
    }
    Ok(())
}

/// The stiffness of one coordinate for all three of every control.
#[must_use]
pub fn of_three_coordinates(stiffness: &DMatrix<f64>) -> DMatrix<f64> {
    stiffness.kronecker(&DMatrix::identity(3, 3))
}

#[cfg(test)]
mod tests;
