//! Errors of Lambert's law and of the lights, as a part of the covariance of readings.
//!
//! The readings of a pixel of albedo ρ have errors `e ~ N(0, V)` with
//! `V = σ² I + ρ² (τ_i² I + τ² K + σ_a² 11ᵀ)`. σ is the noise of the camera. τ_i is the error of each light
//! (strength, direction, small shadows). `τ² K` is the deviation of the reflectance from Lambert's law, which
//! is similar for similar lights: `K` is a Matérn kernel (ν = 3/2) of the angle between two lights. σ_a is
//! the error of the ambient share. Residuals show only the part of e that no normal explains; the kernel
//! infers the rest, which shifts the normal, from that part.
//!
//! The variances maximise the restricted likelihood of a sample of pixels. The scale of each pixel has the
//! prior of some degrees of freedom, which are estimated as well. Its likelihood is a multivariate t
//! distribution, so that a few bad pixels do not enlarge σ of all others.
//!
//! With few or saturated readings, residuals show little of τ, and the maximum is often at zero. τ is
//! therefore averaged over its posterior: a uniform prior up to 0.3 (Gelman 2006) times the likelihood. All
//! pixels have the same deviation from Lambert's law, so the likelihood counts as that of
//! [`INDEPENDENT_PIXELS`].
//!
//! # References
//! - Gelman, *Prior distributions for variance parameters in hierarchical models*, Bayesian Analysis 2006.
//! - Kennedy and O'Hagan, *Bayesian calibration of computer models*, JRSS B 2001: model error as a Gaussian
//!   process.
//! - Harville, *Maximum likelihood approaches to variance component estimation*, JASA 1977.

use super::median;
use super::pixel::{Pixel, inverse};
use nalgebra::{DMatrix, DVector};
use planish_core::{DVec3, SymmetricMatrix3, vector3::tangents};
use rayon::prelude::*;

/// Length of the kernel in radians. Reflectance changes over the hemisphere; one radian makes coverage of
/// normals 0.8 for a camera with a gamma curve of 1.15, and three radians enlarge σ of glossy surfaces
/// threefold (test `normals_of_surfaces_that_are_not_matte_are_covered`).
const LENGTH: f64 = 2.0;
/// Eigenvalues of the kernel below this share of the largest one are neglected.
const NEGLECTED: f64 = 1e-5;
/// Limits of the degrees of freedom of the prior of a pixel's scale, and their start. At the upper limit all
/// pixels have one scale; at the lower one, each has its own.
const MIN_DEGREES: f64 = 3.0;
const MAX_DEGREES: f64 = 200.0;
const FIRST_DEGREES: f64 = 8.0;
/// σ of the ambient share before any reading. Rooms in which such images are taken are dark.
const PRIOR_AMBIENT: f64 = 0.1;
/// Smallest relative variance of model errors: 0.01 % of the brightness.
const LEAST: f64 = 1e-8;
/// Largest relative variance of the deviation from Lambert's law: 30 %, as of very rough or glossy surfaces.
const MAX_SMOOTH: f64 = 0.09;
/// Intervals of the grid of the logarithm of that variance, about one apart.
const SMOOTH_STEPS: usize = 16;
/// Number of pixels whose deviations from Lambert's law count as independent: about as many as there are
/// normals that differ by half a radian. With 10, σ of a real painted ball covers 0.87 to 1.00 for 4 to 12
/// lights and 0.91 to 0.98 with saturated readings; with 150 (all of them), 0.66 and 0.34. σ of an exactly
/// matte surface is up to twice too large.
const INDEPENDENT_PIXELS: f64 = 10.0;

/// The covariance of readings.
#[derive(Debug, Clone)]
pub(super) struct ModelError {
    /// Eigenvectors of the kernel times the roots of their eigenvalues: a row for each light.
    modes: DMatrix<f64>,
    /// Variance of the noise, and relative variances: of each light, and of the reflectance.
    variances: [f64; 3],
    /// Degrees of freedom of the prior of a pixel's scale.
    degrees: f64,
    /// Ambient share and its variance.
    pub ambient: f64,
    ambient_variance: f64,
}

/// The parts of one pixel's weighted equations.
struct Equations {
    /// `ln |V| + ln |Xᵀ V⁻¹ X|`.
    log_determinants: f64,
    /// `(Xᵀ V⁻¹ X)⁻¹`, and the step `(Xᵀ V⁻¹ X)⁻¹ Xᵀ V⁻¹ r`.
    covariance: SymmetricMatrix3,
    step: DVec3,
    /// The same step for a constant ρ instead of r.
    step_of_constant: DVec3,
    /// `rᵀ P r`, and its degrees of freedom.
    square: f64,
    freedom: f64,
    /// `P 1 ρ` for each reading used.
    constant: Vec<f64>,
}

impl Equations {
    /// Twice the negative logarithm of the restricted likelihood of a pixel.
    fn cost(&self, degrees: f64) -> f64 {
        let both = self.freedom + degrees;
        self.log_determinants + both * (self.square / degrees).ln_1p() + self.freedom * degrees.ln()
            - 2.0 * (ln_gamma(0.5 * both) - ln_gamma(0.5 * degrees))
    }
}

/// The least cost, and its place, near a start: a pattern search along the free coordinates with these steps.
fn pattern_search(
    start: [f64; 4],
    free: &[usize],
    steps: &[f64],
    cost: impl Fn(&[f64; 4]) -> f64,
) -> (f64, [f64; 4]) {
    let (mut least, mut at) = (cost(&start), start);
    for step in steps {
        // The limit only guards against endless small gains.
        for _ in 0..20 {
            let before = least;
            for &k in free {
                for by in [-step, *step] {
                    let mut next = at;
                    next[k] += by;
                    next[3] = next[3].clamp(MIN_DEGREES.ln(), MAX_DEGREES.ln());
                    // Below the least variance a change has no effect.
                    if (1..3).contains(&k) && next[k] < LEAST.ln() - 1.0 {
                        continue;
                    }
                    let value = cost(&next);
                    if value < least {
                        (least, at) = (value, next);
                    }
                }
            }
            if before - least < 1e-3 {
                break;
            }
        }
    }
    (least, at)
}

/// The variances `[σ², τ_i², τ²]` and the degrees of freedom, averaged over the posterior of τ.
///
/// `at` has the maximum likelihood. For each τ, the `free` coordinates are those of maximum likelihood. τ² is
/// at least that of the maximum, because an average shrinks it where the deviation is large and obvious.
fn averaged_over_smooth(
    at: [f64; 4],
    free: &[usize],
    pixels: usize,
    cost: impl Fn(&[f64; 4]) -> f64,
) -> ([f64; 3], f64) {
    let (low, high) = (LEAST.ln(), MAX_SMOOTH.ln());
    let grid: Vec<f64> =
        (0..=SMOOTH_STEPS).map(|k| low + (high - low) * k as f64 / SMOOTH_STEPS as f64).collect();
    let middle = grid.partition_point(|s| *s < at[2]);
    // Outwards from the maximum, so that each search starts near its result.
    let outwards = |grid: &mut dyn Iterator<Item = &f64>| -> Vec<(f64, [f64; 4])> {
        let mut from = at;
        let search = |s: &f64| {
            from[2] = *s;
            let found = pattern_search(from, free, &[0.7, 0.3], &cost);
            from = found.1;
            found
        };
        grid.map(search).collect()
    };
    let mut found = outwards(&mut grid[middle..].iter());
    found.extend(outwards(&mut grid[..middle].iter().rev()));
    let least = found.iter().map(|(cost, _)| *cost).fold(f64::INFINITY, f64::min);
    let power = (INDEPENDENT_PIXELS / pixels as f64).min(1.0);
    let (mut sum, mut variances, mut degrees) = (0.0, [0.0; 3], 0.0);
    for (cost, place) in &found {
        // A uniform prior of τ is proportional to τ on the grid of its logarithm.
        let weight = (0.5 * (place[2] - high) - 0.5 * power * (cost - least)).exp();
        sum += weight;
        (0..3).for_each(|k| variances[k] += weight * place[k].exp());
        degrees += weight * place[3];
    }
    let [noise, light, smooth] = variances.map(|v| v / sum);
    ([noise, light, smooth.max(at[2].exp())], (degrees / sum).exp())
}

/// `ln Γ(x)` for `x > 0`: Stirling's series beyond 7, the recurrence below.
fn ln_gamma(x: f64) -> f64 {
    let (mut y, mut product) = (x, 1.0);
    while y < 7.0 {
        product *= y;
        y += 1.0;
    }
    (y - 0.5) * y.ln() - y + 0.5 * std::f64::consts::TAU.ln() + (1.0 - 1.0 / (30.0 * y * y)) / (12.0 * y)
        - product.ln()
}

impl ModelError {
    pub fn new(lights: &[DVec3], ambient: f64, noise: f64) -> Self {
        let kernel = DMatrix::from_fn(lights.len(), lights.len(), |i, j| {
            let angle = lights[i].dot(lights[j]).clamp(-1.0, 1.0).acos();
            let x = 3.0_f64.sqrt() * angle / LENGTH;
            (1.0 + x) * (-x).exp()
        });
        let eigen = kernel.symmetric_eigen();
        let largest = eigen.eigenvalues.max();
        let kept: Vec<usize> =
            (0..lights.len()).filter(|k| eigen.eigenvalues[*k] > NEGLECTED * largest).collect();
        let modes = DMatrix::from_fn(lights.len(), kept.len(), |i, m| {
            eigen.eigenvalues[kept[m]].sqrt() * eigen.eigenvectors[(i, kept[m])]
        });
        Self { modes, variances: [noise, 0.0, 0.0], degrees: MAX_DEGREES, ambient, ambient_variance: 0.0 }
    }

    /// σ of the brightness without the model errors.
    pub fn sigma_noise(&self) -> f64 {
        self.variances[0].sqrt()
    }

    /// σ of the model errors of one reading, relative to the brightness under a light along the normal.
    pub fn share(&self) -> f64 {
        (self.variances[1] + self.variances[2]).sqrt()
    }

    /// Estimates variances and ambient share from pixels that `fit` selects readings of, given the ambient
    /// share and σ.
    pub fn estimate(
        &mut self,
        lights: &[DVec3],
        noise: Option<f64>,
        ambient: Option<f64>,
        fit: impl Fn(f64, f64) -> Vec<Pixel>,
    ) {
        // The ambient share changes which readings are outliers, and these change the variances.
        let rounds = if ambient.is_some() { 2 } else { 4 };
        self.ambient = ambient.unwrap_or(0.0);
        for _ in 0..rounds {
            let pixels: Vec<Pixel> =
                fit(self.ambient, self.sigma_noise()).into_iter().filter(|p| p.used.len() > 3).collect();
            if pixels.is_empty() {
                return;
            }
            self.ambient_variance = 0.0;
            self.maximise(lights, &pixels, noise);
            if ambient.is_none() {
                self.update_ambient(lights, &pixels);
            }
        }
    }

    /// The variances of maximum restricted likelihood.
    fn maximise(&mut self, lights: &[DVec3], pixels: &[Pixel], noise: Option<f64>) {
        let typical = median(pixels.iter().filter_map(Pixel::variance).collect());
        let relative =
            median(pixels.iter().filter_map(|p| Some(p.variance()? / p.b.length_squared())).collect());
        let floor = self.variances[0].min(typical).max(f64::MIN_POSITIVE);
        let cost = |logarithms: &[f64; 4]| -> f64 {
            let [noise, light, smooth, degrees] = logarithms.map(f64::exp);
            let tried = Self { variances: [noise, light, smooth], degrees, ..self.clone() };
            let of_pixel = |p: &Pixel| tried.equations(lights, p).map_or(0.0, |e| e.cost(degrees));
            // Summed in order, so that the result does not depend on the number of threads.
            pixels.par_iter().map(of_pixel).collect::<Vec<f64>>().iter().sum()
        };
        let noises = match noise {
            Some(variance) => vec![variance.ln()],
            None => [1.0, 0.1, 0.01].map(|f| (f * typical).max(1e-6 * floor).ln()).to_vec(),
        };
        // Several starts, because camera noise and errors of lights can explain the same residuals.
        let starts = noises.iter().flat_map(|n| {
            [LEAST, relative].into_iter().flat_map(move |i| {
                [LEAST, relative, 10.0 * relative, 100.0 * relative]
                    .map(|smooth| [*n, i.max(LEAST).ln(), smooth.max(LEAST).ln(), FIRST_DEGREES.ln()])
            })
        });
        let best = starts.map(|s| (cost(&s), s)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, start)) = best else { return };
        let free: &[usize] = if noise.is_some() { &[1, 2, 3] } else { &[0, 1, 2, 3] };
        let at = pattern_search(start, free, &[1.5, 0.7, 0.3, 0.1], cost).1;
        let free: Vec<usize> = free.iter().copied().filter(|k| *k != 2).collect();
        (self.variances, self.degrees) = averaged_over_smooth(at, &free, pixels.len(), cost);
    }

    /// The ambient share by generalised least squares over the pixels.
    ///
    /// All pixels share the errors of the lights and of the reflectance, so these do not average out: those
    /// of each light are judged by its sum over the pixels, those of the reflectance as if it were the same
    /// at all pixels.
    fn update_ambient(&mut self, lights: &[DVec3], pixels: &[Pixel]) {
        let (mut information, mut pull, mut smooth) = (0.0, 0.0, 0.0);
        let solved: Vec<(&Pixel, Equations)> =
            pixels.iter().filter_map(|p| Some((p, self.equations(lights, p)?))).collect();
        for (p, e) in &solved {
            let size = p.b.length();
            let mut along = DVector::zeros(self.modes.ncols());
            for (c, &k) in e.constant.iter().zip(&p.used) {
                information += c * size;
                pull += c * p.residuals[k];
                along += self.modes.row(k).transpose() * (*c * size);
            }
            smooth += (self.variances[2]).sqrt() * along.norm();
        }
        if information <= 0.0 {
            return;
        }
        let change = pull / information;
        let mut by_light = vec![0.0; lights.len()];
        for (p, e) in &solved {
            let step = e.step - change * e.step_of_constant;
            let towards = p.b.normalize();
            for (c, &k) in e.constant.iter().zip(&p.used) {
                let row = lights[k] + self.ambient * towards;
                by_light[k] += c * (p.residuals[k] - change * p.b.length() - row.dot(step));
            }
        }
        let count = lights.len() as f64;
        // Four unknowns (normal, albedo, ambient share) reduce the residuals.
        let of_lights = by_light.iter().map(|sum| sum * sum).sum::<f64>() * count / (count - 4.0).max(1.0);
        let variance = (smooth * smooth + of_lights) / (information * information) + 1.0 / information;
        let found = self.ambient + change;
        let prior = PRIOR_AMBIENT * PRIOR_AMBIENT;
        self.ambient = found * prior / (prior + variance);
        self.ambient_variance = variance * prior / (prior + variance);
    }

    /// The equations of a pixel. `V` is a diagonal matrix plus one of the kernel's rank, which is inverted by
    /// Woodbury's identity.
    fn equations(&self, lights: &[DVec3], p: &Pixel) -> Option<Equations> {
        let size = p.b.length();
        let towards = p.b.try_normalize()?;
        let n = p.used.len();
        let [noise, light, smooth] = self.variances;
        let diagonal = noise + size * size * light;
        let modes = self.modes.ncols();
        let root = size * smooth.sqrt();
        let u = DMatrix::from_fn(n, modes + 1, |i, m| match m {
            m if m < modes => root * self.modes[(p.used[i], m)],
            _ => size * self.ambient_variance.sqrt(),
        });
        let inner = DMatrix::identity(modes + 1, modes + 1) + u.tr_mul(&u) / diagonal;
        let factor = inner.cholesky()?;
        // X, the residuals, and a constant.
        let columns = DMatrix::from_fn(n, 5, |i, c| match c {
            3 => p.residuals[p.used[i]],
            4 => size,
            _ => lights[p.used[i]][c] + self.ambient * towards[c],
        });
        let weighted = (&columns - &u * factor.solve(&u.tr_mul(&columns)) / diagonal) / diagonal;
        let products = columns.tr_mul(&weighted);
        let normal = SymmetricMatrix3::from_entries(|i, j| products[(i, j)]);
        let covariance = inverse(&normal)?;
        let gradient = DVec3::new(products[(0, 3)], products[(1, 3)], products[(2, 3)]);
        let step = covariance.times(gradient);
        let of_constant = covariance.times(DVec3::new(products[(0, 4)], products[(1, 4)], products[(2, 4)]));
        let constant =
            (0..n).map(|i| weighted[(i, 4)] - (0..3).map(|c| weighted[(i, c)] * of_constant[c]).sum::<f64>());
        let log_inner: f64 = factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        let [a, b, c, d, e, f] = covariance.to_array();
        let determinant = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
        Some(Equations {
            log_determinants: n as f64 * diagonal.ln() + 2.0 * log_inner - determinant.ln(),
            step,
            step_of_constant: of_constant,
            square: (products[(3, 3)] - gradient.dot(step)).max(0.0),
            freedom: (n - 3) as f64,
            constant: constant.collect(),
            covariance,
        })
    }

    /// The normal by generalised least squares, and σ of a tangential component in radians. `known` is true
    /// if readings have exactly the stated σ: then the residuals of the pixel do not change it.
    pub fn normal(&self, lights: &[DVec3], p: &Pixel, known: bool) -> Option<(DVec3, f64)> {
        let e = self.equations(lights, p)?;
        let b = p.b + e.step;
        let n = b.try_normalize().filter(|n| n.z < 0.0)?;
        let freedom = e.freedom + self.degrees;
        let scale = if known { 1.0 } else { (e.square + self.degrees) / freedom };
        // The scale is uncertain, so errors have a t distribution. σ is that of the normal distribution with
        // the same 95 % interval (Cornish and Fisher 1937, at 1.96).
        let tail = if known { 1.0 } else { 1.0 + 1.21 / freedom + 1.44 / (freedom * freedom) };
        let (e1, e2) = tangents(n);
        let variance = 0.5 * (e.covariance.along(e1) + e.covariance.along(e2)) / b.length_squared();
        let sigma = (scale * variance).sqrt() * tail;
        sigma.is_finite().then_some((n, sigma))
    }
}
