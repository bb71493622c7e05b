//! One Gauss–Newton step of a surface whose vertices move along their normals, and across creases.

use super::feet::{Foot, along_normal, by_leaf};
use super::observations::Observations;
use super::scan_errors::Linearized;
use planish_core::DVec3;
use planish_core::vector3::coordinates;
use planish_estimate::sparse::{BlockInformation, Bordered, CholeskyFactor, stochastic_trace};
use planish_estimate::{Error, ErrorKind, Result};
use planish_spline::{Surface, SurfaceSystem};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

/// Random probes for degrees of freedom. The error is about 2 % of a thousand degrees, and less of more.
const PROBES: usize = 8;
/// Feet that one task takes: fixed, so that the number of threads does not change the sums.
const CHUNK: usize = 4096;
/// σ of the step of an unknown beside the readings and the prior, in sides of its cell, for surfaces with
/// creases. Where little determines an unknown, as at corners, longer steps fold the surface.
const STEP_SIGMA: f64 = 0.25;
/// Share of the mean diagonal that is added to it: rounding must not make the matrix indefinite.
const DIAGONAL_SHARE: f64 = 1e-10;

/// The equations of a step.
pub(crate) struct StepInput<'a> {
    pub system: &'a SurfaceSystem,
    pub surface: &'a Surface,
    /// The feet of the readings, and the information of each.
    pub feet: &'a [Foot],
    pub information: &'a [f64],
    /// Their channels.
    pub channels: &'a FootChannels<'a>,
    /// The prior's information, which counts `weight` times.
    pub prior: &'a BlockInformation,
    pub weight: f64,
    /// Information of three coordinates from other readings, if any.
    pub earlier: Option<&'a BlockInformation>,
    /// Share of [`STEP_SIGMA`]'s information that is added on surfaces with creases. It must fall to nothing
    /// before a fit ends: where cells are small, it holds a surface that is far from the solution.
    pub damping: f64,
}

/// The outcome of [`normal_step`].
pub(crate) struct NormalStep {
    pub surface: Surface,
    /// Effective degrees of freedom that the readings of each channel determine: `Σ_i w_i a_iᵀ Λ⁻¹ a_i` over
    /// its rows `a_i`.
    pub degrees: Vec<f64>,
    /// Newton's decrement `δᵀ Λ δ` over the degrees of freedom: the mean square of the step in variances of
    /// the surface.
    pub decrement: f64,
    /// The part of the decrement that the readings see, `δᵀ Λ_data δ`. Elsewhere the prior may have a long
    /// way to go.
    pub seen: f64,
    /// Changes of the poses and biases of scans; empty if there are none.
    pub scan_errors: Vec<f64>,
    /// The square of these changes in their covariance.
    pub scan_error_decrement: f64,
}

/// One Gauss–Newton step in which every vertex moves along its own normal: one unknown for each node instead
/// of three. Only vertices on creases have more ([`Surface::directions`]).
///
/// Foot points slide freely, so motion along the surface gains nothing while the shape is still being found;
/// the factorisation costs a twenty-seventh of the full one. `memory` keeps the factor's memory from step to
/// step.
///
/// # Errors
/// `Undetermined` if the readings near the surface leave its shape open.
pub(crate) fn normal_step(input: &StepInput<'_>, memory: &mut Option<CholeskyFactor>) -> Result<NormalStep> {
    let StepInput { system, surface, feet, information, channels, prior, weight, earlier, damping } = *input;
    let directions = surface.directions();
    let (start, order) = by_leaf(feet, system.space().leaves().len());
    let data = || {
        system.accumulate_along(&directions, |leaf, add| {
            for &k in &order[start[leaf] as usize..start[leaf + 1] as usize] {
                let (foot, w) = (&feet[k as usize], information[k as usize]);
                if w > 0.0 {
                    foot.rows(surface, |r, row| add(row, foot.normal, foot.residuals[r], w));
                }
            }
        })
    };
    let of_prior = || -> Result<_> { Ok((pull_of_prior(input)?, system.contract(prior, &directions)?)) };
    let (data, of_prior) = rayon::join(data, of_prior);
    let (mut data, (pull, mut matrix)) = (data?, of_prior?);
    // Degrees of freedom and the part that readings see are those of the new readings alone.
    let readings = earlier.map(|_| data.clone());
    if let Some(earlier) = earlier {
        data.add_scaled(&system.contract(earlier, &directions)?, 1.0)?;
    }
    for value in matrix.values_mut() {
        *value *= weight;
    }
    matrix.add_scaled(&data, 1.0)?;
    let ridge = DIAGONAL_SHARE * matrix.diagonal().iter().sum::<f64>() / matrix.dimension() as f64;
    matrix.add_diagonal(ridge.max(f64::MIN_POSITIVE));
    if surface.space().has_creases() && damping > 0.0 {
        damp(&mut matrix, surface, directions.len(), damping)?;
    }
    let factor = system.refactorize_scalar(memory.take(), &matrix).map_err(|e| match e.kind() {
        ErrorKind::Undetermined => Error::undetermined(format!(
            "{} readings near the surface do not determine its shape",
            information.iter().filter(|&&w| w > 0.0).count()
        ))
        .with_source(e),
        _ => e,
    })?;

    // The step, together with the poses and biases of scans where these are unknown.
    let readings = readings.as_ref().unwrap_or(&data);
    // Only the new readings have residuals at this surface; earlier data act through `pull`.
    let mut gradient: Vec<f64> = readings.vector().to_vec();
    for (unknown, (s, d)) in gradient.iter_mut().zip(&directions).enumerate() {
        let p = &pull[3 * system.space().node_of_unknown(unknown)..][..3];
        *s += p[0] * d[0] + p[1] * d[1] + p[2] * d[2];
    }
    let (step, scan_errors, scan_error_decrement) = solve(input, &factor, &directions, &gradient)?;

    // How far it goes, and how many degrees of freedom the readings determine.
    // With one channel, products with the assembled matrix are enough; rows of readings cost more.
    let degrees = if channels.count == 1 {
        vec![stochastic_trace(&factor, readings, PROBES, 1)?.value]
    } else {
        degrees_by_channel(input, &factor, &directions)?
    };
    let total: f64 = degrees.iter().sum();
    // Λ δ is the gradient, so δᵀ Λ δ needs no product with the matrix.
    let decrement = step.iter().zip(&gradient).map(|(s, g)| s * g).sum::<f64>() / total.max(1.0);
    let mut data_step = vec![0.0; step.len()];
    readings.multiply(&step, &mut data_step)?;
    let seen = step.iter().zip(&data_step).map(|(s, g)| s * g).sum::<f64>() / total.max(1.0);
    // The step goes along the normals at which it was linearised.
    *memory = Some(factor);
    Ok(NormalStep {
        surface: surface.displaced(&directions, &step)?,
        degrees,
        decrement,
        seen,
        scan_errors,
        scan_error_decrement,
    })
}

/// Adds a share of the information of a step of zero with [`STEP_SIGMA`] to each unknown (Levenberg 1944,
/// Marquardt 1963).
fn damp(matrix: &mut BlockInformation, surface: &Surface, unknowns: usize, share: f64) -> Result<()> {
    let space = surface.space();
    let anchors = space.node_anchors();
    for unknown in 0..unknowns {
        let [u, v] = anchors[space.node_of_unknown(unknown)];
        let area = surface.leaf_area(space.locate(u, v).0).max(f64::MIN_POSITIVE);
        matrix.add_to_diagonal_block(unknown as u32, &[share / (STEP_SIGMA * STEP_SIGMA * area)])?;
    }
    Ok(())
}

/// What pulls the vertices besides the readings: `w (η − K x)` of the prior, and `η − Λ x` of earlier data.
fn pull_of_prior(input: &StepInput<'_>) -> Result<Vec<f64>> {
    let StepInput { surface, prior, weight, earlier, .. } = *input;
    let x: Vec<f64> = coordinates(surface.vertices()).to_vec();
    let mut pull = vec![0.0; x.len()];
    prior.multiply(&x, &mut pull)?;
    for (p, eta) in pull.iter_mut().zip(prior.vector()) {
        *p = weight * (eta - *p);
    }
    if let Some(earlier) = earlier {
        let mut product = vec![0.0; x.len()];
        earlier.multiply(&x, &mut product)?;
        for ((p, eta), t) in pull.iter_mut().zip(earlier.vector()).zip(&product) {
            *p += eta - t;
        }
    }
    Ok(pull)
}

/// The step of the vertices, that of the scans' unknowns, and the square of the latter in its covariance.
fn solve(
    input: &StepInput<'_>,
    factor: &CholeskyFactor,
    directions: &[DVec3],
    gradient: &[f64],
) -> Result<(Vec<f64>, Vec<f64>, f64)> {
    let StepInput { surface, feet, information, channels, .. } = *input;
    let mut step = gradient.to_vec();
    let errors = &channels.observations.scan_errors;
    if !channels.with_scan_errors || errors.is_empty() {
        factor.solve_in_place(&mut step)?;
        return Ok((step, Vec::new(), 0.0));
    }
    let equations = errors.equations(&Linearized { surface, directions, feet, information, channels });
    for (s, pull) in step.iter_mut().zip(&equations.pull) {
        *s += pull;
    }
    // Vertices and scans are solved together: alternating between them creeps (decision 0014).
    let bordered = Bordered::new(factor, &equations.coupling, &equations.corner)?;
    let mut of_scans = equations.gradient.clone();
    bordered.solve_in_place(factor, &equations.coupling, &mut step, &mut of_scans)?;
    let length2 = bordered.shared_length2(&of_scans)?;
    Ok((step, of_scans, length2))
}

/// The channels of feet.
pub(crate) struct FootChannels<'a> {
    pub observations: &'a Observations,
    pub subset: &'a [u32],
    /// Number of channels.
    pub count: usize,
    /// True if poses and biases of scans are unknowns of the step.
    pub with_scan_errors: bool,
}

impl<'a> FootChannels<'a> {
    pub(crate) fn new(observations: &'a Observations, subset: &'a [u32]) -> Self {
        Self { observations, subset, count: observations.channels.len(), with_scan_errors: true }
    }

    /// The same with the poses and biases of scans held.
    pub(crate) fn in_place(self) -> Self {
        Self { with_scan_errors: false, ..self }
    }

    /// The channel of foot `k`.
    pub(crate) fn channel(&self, k: usize) -> usize {
        self.observations.channel(self.subset[k] as usize)
    }
}

/// Degrees of freedom of each channel, by random probes `z` of independent ±1 (Hutchinson 1989): the mean of
/// `Σ_i w_i (a_iᵀ z)(a_iᵀ Λ⁻¹ z)` over its rows.
///
/// `a_iᵀ z` is how much the reading sees of the surface whose vertices move by `z` along their normals.
fn degrees_by_channel(
    input: &StepInput<'_>,
    factor: &CholeskyFactor,
    directions: &[DVec3],
) -> Result<Vec<f64>> {
    let StepInput { surface, feet, information, channels, .. } = *input;
    // A fixed seed: σ follows from these degrees, and must be the same in every run.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut degrees = vec![0.0; channels.count];
    for _ in 0..PROBES {
        let z: Vec<f64> = directions.iter().map(|_| if rng.random::<bool>() { 1.0 } else { -1.0 }).collect();
        let mut y = z.clone();
        factor.solve_in_place(&mut y)?;
        let moved = |by: &[f64]| surface.with_vertices(surface.displacements(directions, by));
        let (z, y) = (moved(&z)?, moved(&y)?);
        let parts: Vec<Vec<f64>> = (0..feet.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let mut part = vec![0.0; channels.count];
                for k in chunk * CHUNK..feet.len().min((chunk + 1) * CHUNK) {
                    if information[k] > 0.0 {
                        let foot = &feet[k];
                        foot.rows(surface, |_, row| {
                            part[channels.channel(k)] +=
                                information[k] * along_normal(&z, foot, row) * along_normal(&y, foot, row);
                        });
                    }
                }
                part
            })
            .collect();
        for part in parts {
            for (d, p) in degrees.iter_mut().zip(part) {
                *d += p / PROBES as f64;
            }
        }
    }
    for d in &mut degrees {
        // Random probes of a channel with few readings may give a small negative trace.
        *d = d.max(0.0);
    }
    Ok(degrees)
}
