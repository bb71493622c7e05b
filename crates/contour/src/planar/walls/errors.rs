//! Errors of readings about their walls: scale of σ, error of the heading, deviation of walls from lines.
//!
//! In: walls with their readings. Out: [`WallErrors`], and the covariance of each wall that follows from
//! them. A distance from the line of a wall has the covariance
//!
//! `V_ij = s² ((v_i + h² r_i² sin² β_i) δ_ij + λ v̄ exp(−|t_i − t_j| / ℓ))`
//!
//! with the stated variance `v_i` across the wall and its mean `v̄`, the range `r_i`, the angle `β_i` between
//! ray and normal, and the place `t_i` along the wall. The last term is correlated: the form of the wall,
//! rounded ranges, and motion of the sensor during a scan. `λ`, `ℓ` and `h` are averaged over a grid,
//! weighted by the restricted likelihood of all walls; `s` has its maximum for each. Not guaranteed:
//! deviations that are longer than half of the longest wall leave hardly any residual.

use super::super::reading::ContourTarget;
use super::line::WallLine;
use super::{Wall, WallReadings};
use nalgebra::{DMatrix, Matrix2, Matrix3, Vector2, Vector3};

/// Variance of the correlated deviation relative to the mean stated variance.
const FORM_SHARES: [f64; 6] = [0.01, 0.03, 0.1, 0.3, 0.7, 1.5];
/// Number of correlation lengths, in a geometric series.
const LENGTHS: usize = 4;
/// The shortest correlation length in spacings of the readings, and the longest as a share of the longest
/// wall. With a quarter instead of a half, walls of real scans agreed less often with σ.
const LENGTH_LIMITS: [f64; 2] = [2.0, 0.5];
/// σ of the heading beyond what the readings state, in radians. Beams of scanners are 0.25° to 0.5° (4 to
/// 9 mrad) wide.
const HEADING_SIGMAS: [f64; 4] = [0.0, 1.5e-3, 3e-3, 6e-3];
/// σ of the logarithm of the scale of the stated σ before the readings are seen.
const SCALE_SIGMA: f64 = 0.25;
/// Smallest number of residuals less parameters that determine the errors.
const MIN_REDUNDANCY: usize = 30;

/// Errors of the readings of walls beyond those stated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallErrors {
    /// Factor of the stated σ.
    pub scale: f64,
    /// σ of the heading in radians, in addition to the stated one.
    pub heading_rad: f64,
    /// σ of the correlated deviation of readings from the line of their wall.
    pub form: f64,
    /// Most likely correlation length of that deviation along a wall.
    pub length: f64,
}

/// The errors of independent readings with exact σ.
const INDEPENDENT: WallErrors = WallErrors { scale: 1.0, heading_rad: 0.0, form: 0.0, length: 0.0 };

/// A reading of a wall, in order along it.
#[derive(Debug, Clone, Copy)]
struct Deviation {
    /// Place along the wall from the middle of its readings.
    t: f64,
    distance: f64,
    /// Stated variance across the wall.
    stated: f64,
    /// Variance across the wall for a heading error of 1 rad.
    per_heading: f64,
}

/// The readings of a wall, and the middle from which they count.
struct WallDeviations {
    all: Vec<Deviation>,
    middle: f64,
}

/// A point of the grid.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    heading: f64,
    /// Variance of the correlated deviation at scale 1.
    form: f64,
    length: f64,
}

/// Estimates the errors of all walls, and replaces their covariances by those that follow.
pub(super) fn apply(data: &WallReadings<'_>, walls: &mut [Wall]) -> WallErrors {
    let each: Vec<WallDeviations> = walls.iter().map(|wall| deviations(data, wall)).collect();
    let count: usize = each.iter().map(|wall| wall.all.len()).sum();
    if count < 2 * each.len() + MIN_REDUNDANCY {
        return INDEPENDENT;
    }
    let mean = each.iter().flat_map(|wall| &wall.all).map(|one| one.stated).sum::<f64>() / count as f64;
    let lengths = lengths(&each);
    let mut grid: Vec<(Hypothesis, f64, f64)> = Vec::new();
    for heading in HEADING_SIGMAS {
        let none = Hypothesis { heading, form: 0.0, length: lengths[0] };
        // The absence of each error has the same weight as all its values together.
        let others = (HEADING_SIGMAS.len() - 1) as f64;
        let weight = if heading > 0.0 { 0.0 } else { others.ln() };
        let correlated = (FORM_SHARES.len() * lengths.len()) as f64;
        grid.push((none, weight + correlated.ln(), 0.0));
        for share in FORM_SHARES {
            for &length in &lengths {
                grid.push((Hypothesis { heading, form: share * mean, length }, weight, 0.0));
            }
        }
    }
    for (hypothesis, weight, scale) in &mut grid {
        let (log_likelihood, squared) = restricted_likelihood(&each, hypothesis);
        *weight += log_likelihood;
        *scale = squared;
    }
    let best = grid.iter().map(|one| one.1).fold(f64::NEG_INFINITY, f64::max);
    grid.iter_mut().for_each(|one| one.1 = (one.1 - best).exp());
    let total: f64 = grid.iter().map(|one| one.1).sum();
    grid.iter_mut().for_each(|one| one.1 /= total);
    // What has hardly any weight costs as much as the rest.
    grid.retain(|one| one.1 > 1e-4);
    for (wall, own) in walls.iter_mut().zip(&each) {
        wall.fit.covariance = covariance(own, &grid, &wall.fit.covariance);
    }
    let average = |of: fn(&Hypothesis) -> f64| {
        grid.iter().map(|(one, weight, scale)| weight * scale * of(one)).sum::<f64>().sqrt()
    };
    let likely = grid.iter().filter(|one| one.0.form > 0.0).max_by(|a, b| a.1.total_cmp(&b.1));
    WallErrors {
        scale: average(|_| 1.0),
        heading_rad: average(|one| one.heading * one.heading),
        form: average(|one| one.form),
        length: likely.map_or(0.0, |one| one.0.length),
    }
}

/// The readings that the fit of a wall used, along it.
fn deviations(data: &WallReadings<'_>, wall: &Wall) -> WallDeviations {
    let line = WallLine::new(wall.fit.state[0], wall.fit.state[1]);
    let used = wall.members.iter().zip(&wall.fit.used).filter(|(_, used)| **used);
    let mut all: Vec<Deviation> = used
        .map(|(&i, _)| {
            let normal = line.normal();
            let per_heading = match data.readings[i].target {
                ContourTarget::Range { heading_rad, range, .. } => {
                    let (sin, cos) = heading_rad.sin_cos();
                    // A turn moves the point across its ray.
                    (range * (normal[1] * cos - normal[0] * sin)).powi(2)
                }
                ContourTarget::Point { .. } => 0.0,
            };
            Deviation {
                t: line.along(data.points[i]),
                distance: line.distance(data.points[i]),
                stated: line.sigma_across(data.covariances[i]).powi(2),
                per_heading,
            }
        })
        .collect();
    all.sort_by(|a, b| a.t.total_cmp(&b.t));
    let middle = all.iter().map(|one| one.t).sum::<f64>() / all.len().max(1) as f64;
    all.iter_mut().for_each(|one| one.t -= middle);
    WallDeviations { all, middle }
}

/// Correlation lengths to try.
fn lengths(walls: &[WallDeviations]) -> Vec<f64> {
    let steps =
        |wall: &WallDeviations| -> Vec<f64> { wall.all.windows(2).map(|p| p[1].t - p[0].t).collect() };
    let mut spacings: Vec<f64> = walls.iter().flat_map(steps).filter(|step| *step > 0.0).collect();
    spacings.sort_by(f64::total_cmp);
    let spacing = spacings.get(spacings.len() / 2).copied().unwrap_or(1.0);
    let longest = walls.iter().map(|wall| match (wall.all.first(), wall.all.last()) {
        (Some(first), Some(last)) => last.t - first.t,
        _ => 0.0,
    });
    let shortest = LENGTH_LIMITS[0] * spacing;
    let longest = (LENGTH_LIMITS[1] * longest.fold(0.0, f64::max)).max(shortest);
    let ratio = (longest / shortest).powf(1.0 / (LENGTHS - 1) as f64);
    (0..LENGTHS).map(|k| shortest * ratio.powi(k as i32)).collect()
}

/// Logarithm of the restricted likelihood with its best squared scale, and that scale.
///
/// The correlated deviation is a first-order Markov process along the wall: a Kalman filter whitens the
/// distances and both columns of the line in time proportional to the readings.
fn restricted_likelihood(walls: &[WallDeviations], hypothesis: &Hypothesis) -> (f64, f64) {
    let (mut logarithms, mut squares, mut redundancy) = (0.0, 0.0, 0.0);
    for wall in walls {
        let (products, log_determinant) = whitened(wall, hypothesis);
        let line = products.fixed_view::<2, 2>(1, 1).into_owned();
        let right = Vector2::new(products[(0, 1)], products[(0, 2)]);
        let Some(inverse) = line.try_inverse() else { continue };
        squares += (products[(0, 0)] - (right.transpose() * inverse * right)[(0, 0)]).max(0.0);
        logarithms += log_determinant + line.determinant().max(f64::MIN_POSITIVE).ln();
        redundancy += wall.all.len() as f64 - 2.0;
    }
    // Maximum of −½ (redundancy ln s² + squares / s²) − ½ (½ ln s² / σ)² by Newton's method in ln s².
    let mut log_scale = 0.0;
    let curvature = 1.0 / (4.0 * SCALE_SIGMA * SCALE_SIGMA);
    for _ in 0..20 {
        let ratio = squares * f64::exp(-log_scale);
        let slope = redundancy - ratio + 2.0 * curvature * log_scale;
        let step = slope / (ratio + 2.0 * curvature);
        log_scale -= step.clamp(-1.0, 1.0);
    }
    let scale = log_scale.exp();
    let prior = curvature * log_scale * log_scale;
    (-0.5 * (logarithms + redundancy * log_scale + squares / scale) - 0.5 * prior, scale)
}

/// Sums of products of distance, 1 and `t`, whitened, and the logarithm of the determinant of `V`.
fn whitened(wall: &WallDeviations, hypothesis: &Hypothesis) -> (Matrix3<f64>, f64) {
    let (mut products, mut log_determinant) = (Matrix3::zeros(), 0.0);
    let (mut mean, mut variance) = (Vector3::zeros(), hypothesis.form);
    let mut before = None;
    for one in &wall.all {
        let kept = before.map_or(0.0, |t: f64| (-(one.t - t) / hypothesis.length).exp());
        before = Some(one.t);
        mean *= kept;
        variance = kept * kept * variance + (1.0 - kept * kept) * hypothesis.form;
        let total = variance + one.stated + hypothesis.heading.powi(2) * one.per_heading;
        let innovation = Vector3::new(one.distance, 1.0, one.t) - mean;
        products += innovation * innovation.transpose() / total;
        log_determinant += total.ln();
        mean += innovation * (variance / total);
        variance -= variance * variance / total;
    }
    (products, log_determinant)
}

/// Covariance of angle and offset of a wall that was fitted with the stated variances.
fn covariance(wall: &WallDeviations, grid: &[(Hypothesis, f64, f64)], stated: &DMatrix<f64>) -> DMatrix<f64> {
    // Rows of A = (XᵀWX)⁻¹ XᵀW for the line through readings with weights W.
    let mut information = Matrix2::zeros();
    let row = |one: &Deviation| Vector2::new(one.t, 1.0) / one.stated;
    for one in &wall.all {
        information += row(one) * Vector2::new(one.t, 1.0).transpose();
    }
    let Some(inverse) = information.try_inverse() else { return stated.clone() };
    let gains: Vec<Vector2<f64>> = wall.all.iter().map(|one| inverse * row(one)).collect();
    let mut added = Matrix2::zeros();
    let mut scale = 0.0;
    for (hypothesis, weight, squared) in grid {
        let mut own = Matrix2::zeros();
        let mut sum = Vector2::zeros();
        let mut before = 0.0;
        for (one, gain) in wall.all.iter().zip(&gains) {
            let scaled = if *squared > 1.0 { one.stated * (1.0 - 1.0 / squared) } else { 0.0 };
            let single = scaled + hypothesis.heading.powi(2) * one.per_heading + hypothesis.form;
            own += gain * gain.transpose() * single;
            sum *= (-(one.t - before) / hypothesis.length).exp().min(1.0);
            own += (gain * sum.transpose() + sum * gain.transpose()) * hypothesis.form;
            sum += gain;
            before = one.t;
        }
        added += own * (weight * squared);
        // Only σ of readings is scaled up: the stated covariance may include the errors of a shared pose.
        scale += weight * squared.min(1.0);
    }
    // The offset counts from the origin: that at the middle less the middle times the change of direction.
    let moved = Matrix2::new(1.0, 0.0, -wall.middle, 1.0);
    let added = moved * added * moved.transpose();
    stated * scale + DMatrix::from_fn(2, 2, |i, j| added[(i, j)])
}
