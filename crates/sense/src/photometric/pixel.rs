//! The readings of one pixel that follow Lambert's law, and the plain least-squares fit of them.
//!
//! A reading is excluded if it is missing (saturated), if its light lies below the pixel's horizon (attached
//! shadow), or if its residual is an outlier (highlight, cast shadow).

use super::median;
use planish_core::{DVec3, SymmetricMatrix3};

/// Residual, in scales, at which a reading has weight ¼. Smaller values reject highlights better and use
/// fewer readings.
const CUT: f64 = 2.5;
/// Rounds with the absolute value as loss. They start without an estimate of the scale.
const ABSOLUTE_ROUNDS: usize = 15;
/// Rounds of reweighting; the weights of the last one are 0 or 1.
const ROUNDS: usize = 8;
/// Gate of the last round, in scales of the residuals: it keeps 99.7 % of normally distributed readings.
const GATE: f64 = 3.0;
/// Readings whose light is less than this cosine (3.4°) above the horizon of the pixel are in shadow.
const SHADOW: f64 = 0.06;
/// Residuals below this share of the brightness are never outliers, because no surface is completely matte.
const MATTE: f64 = 0.005;

/// One pixel's fit.
pub(super) struct Pixel {
    /// Albedo times normal.
    pub b: DVec3,
    /// Readings that take part, by their lights.
    pub used: Vec<usize>,
    /// Residual of every light; NaN for missing readings.
    pub residuals: Vec<f64>,
    /// Number of readings in attached shadow.
    pub shadowed: usize,
    /// Readings rejected by their residuals, by their lights.
    pub outliers: Vec<usize>,
}

impl Pixel {
    /// `readings` are NaN where missing. `sigma` is σ of brightness: residuals of its size are never
    /// outliers. None if fewer than three readings remain, or the normal faces away from the camera.
    pub fn fit(readings: &[f64], lights: &[DVec3], ambient: f64, sigma: f64) -> Option<Self> {
        let valid: Vec<bool> = readings.iter().map(|i| i.is_finite()).collect();
        let mut weights: Vec<f64> = valid.iter().map(|v| f64::from(*v)).collect();
        let mut b = solve(readings, lights, &weights, ambient, DVec3::ZERO)?;
        let mut residuals = residuals_of(readings, lights, ambient, b);
        // The sum of absolute residuals tolerates highlights of any strength, so it gives the start.
        for _ in 0..ABSOLUTE_ROUNDS {
            let lit = lit(&valid, lights, b);
            let scale = median_of(&residuals, &lit).max(1e-3 * b.length());
            for (k, w) in weights.iter_mut().enumerate() {
                *w = if lit[k] { (1.0 + (residuals[k] / scale).powi(2)).sqrt().recip() } else { 0.0 };
            }
            b = solve(readings, lights, &weights, ambient, b)?;
            residuals = residuals_of(readings, lights, ambient, b);
        }
        for round in 1..ROUNDS {
            let lit = lit(&valid, lights, b);
            let count = lit.iter().filter(|l| **l).count() as f64;
            // The fit uses three degrees of freedom of the residuals. With four readings or fewer there is a
            // single residual direction, so no outlier can be found.
            let spread = 1.4826 * median_of(&residuals, &lit) * (count / (count - 3.0).max(1.0)).sqrt();
            let scale = spread.max(sigma).max(MATTE * b.length());
            for (k, w) in weights.iter_mut().enumerate() {
                let away = residuals[k].abs() / scale;
                *w = match () {
                    () if !lit[k] => 0.0,
                    () if count < 5.0 => 1.0,
                    // Smooth weights first, so that the selection does not depend on a bad first fit; at the
                    // end full or zero weight, so that the covariance is that of plain least squares.
                    () if round + 1 < ROUNDS => (1.0 + (away / CUT).powi(2)).powi(-2),
                    () => f64::from(away < GATE),
                };
            }
            b = solve(readings, lights, &weights, ambient, b)?;
            residuals = residuals_of(readings, lights, ambient, b);
        }
        let used: Vec<usize> = (0..lights.len()).filter(|k| weights[*k] > 0.0).collect();
        let n = b.try_normalize().filter(|n| n.z < 0.0)?;
        let horizon = |k: &usize| lights[*k].dot(n) > SHADOW;
        let (above, below): (Vec<usize>, Vec<usize>) =
            (0..lights.len()).filter(|k| valid[*k]).partition(horizon);
        (used.iter().filter(|k| horizon(k)).count() >= 3).then(|| Self {
            b,
            shadowed: below.len(),
            outliers: above.into_iter().filter(|k| !used.contains(k)).collect(),
            used,
            residuals,
        })
    }

    /// Mean square of the residuals of the readings used, over their degrees of freedom.
    pub fn variance(&self) -> Option<f64> {
        let squares: f64 = self.used.iter().map(|k| self.residuals[*k].powi(2)).sum();
        (self.used.len() > 3).then(|| squares / (self.used.len() - 3) as f64)
    }
}

/// The readings whose lights are above the horizon of the pixel; all that are valid if these are too few for
/// a fit, because then the normal is still a poor one.
fn lit(valid: &[bool], lights: &[DVec3], b: DVec3) -> Vec<bool> {
    let horizon = SHADOW * b.length();
    let lit: Vec<bool> = valid.iter().zip(lights).map(|(v, l)| *v && l.dot(b) > horizon).collect();
    if lit.iter().filter(|l| **l).count() < 3 { valid.to_vec() } else { lit }
}

/// Least squares of `I = b·l + a |b|`, with `|b|` from the previous round.
fn solve(readings: &[f64], lights: &[DVec3], weights: &[f64], ambient: f64, before: DVec3) -> Option<DVec3> {
    let (mut m, mut r) = (SymmetricMatrix3::ZERO, DVec3::ZERO);
    let mut ones = DVec3::ZERO;
    for ((l, i), w) in lights.iter().zip(readings).zip(weights).filter(|(_, w)| **w > 0.0) {
        m.add_outer(*w, *l);
        r += w * i * *l;
        ones += *w * *l;
    }
    let inverse = inverse(&m)?;
    let mut b = before;
    // `|b|` enters weakly, so that a few steps suffice.
    for _ in 0..4 {
        b = inverse.times(r - ambient * b.length() * ones);
    }
    Some(b)
}

fn residuals_of(readings: &[f64], lights: &[DVec3], ambient: f64, b: DVec3) -> Vec<f64> {
    let brightness = ambient * b.length();
    readings.iter().zip(lights).map(|(i, l)| i - b.dot(*l) - brightness).collect()
}

fn median_of(residuals: &[f64], among: &[bool]) -> f64 {
    median(residuals.iter().zip(among).filter(|(_, a)| **a).map(|(r, _)| r.abs()).collect())
}

/// The inverse, unless the matrix is nearly singular.
pub(super) fn inverse(m: &SymmetricMatrix3) -> Option<SymmetricMatrix3> {
    let [a, b, c, d, e, f] = m.to_array();
    let cofactors =
        [d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b];
    let determinant = a * cofactors[0] + b * cofactors[1] + c * cofactors[2];
    // Relative to the trace, so that the unit of the lights does not matter.
    let trace = a + d + f;
    (determinant > 1e-7 * trace.powi(3))
        .then(|| SymmetricMatrix3::from_array(cofactors.map(|c| c / determinant)))
}
