//! Starts that outliers do not affect: the least median of distances over curves through a few readings.
//!
//! # References
//! Rousseeuw 1984, *Least median of squares regression*; Fischler and Bolles 1981, *Random sample consensus*.

use planish_core::random::SplitMix64;

/// Number of random samples.
///
/// With five readings per sample and a fifth of outliers, about a hundred samples contain no outlier.
const SAMPLES: usize = 300;
/// Maximum number of points used; from more, an evenly spaced subset is taken.
const MAX_POINTS: usize = 400;
/// Ratio of the standard deviation to the median absolute value of a normal distribution.
const NORMAL: f64 = 1.4826;
/// Points within this many standard deviations take part in the final fit.
const INLIER_SIGMAS: f64 = 2.5;

/// Fits a curve to points; `None` if it cannot.
type Fit<'a> = dyn Fn(&[[f64; 2]]) -> Option<Vec<f64>> + 'a;

/// A kind of curve: how to fit one and how to measure distances to it.
pub(super) struct Curve<'a> {
    /// Number of points that determine the curve.
    pub(super) needed: usize,
    /// Fits a curve to points.
    pub(super) fit: &'a Fit<'a>,
    /// Signed distance of a point from a curve.
    pub(super) distance: &'a dyn Fn(&[f64], [f64; 2]) -> f64,
}

impl Curve<'_> {
    /// Median absolute distance of the points; infinite if any distance is not finite.
    pub(super) fn median(&self, curve: &[f64], points: &[[f64; 2]]) -> f64 {
        let mut distances: Vec<f64> = points.iter().map(|p| (self.distance)(curve, *p).abs()).collect();
        if distances.iter().any(|d| !d.is_finite()) {
            return f64::INFINITY;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The curve with the least median distance among random samples, refitted to all points near it.
    ///
    /// The random numbers are seeded with the number of points: the same points give the same curve.
    pub(super) fn least_median_curve(&self, points: &[[f64; 2]]) -> Option<Vec<f64>> {
        let subset: Vec<[f64; 2]> =
            points.iter().copied().step_by(points.len().div_ceil(MAX_POINTS).max(1)).collect();
        if subset.len() < 2 * self.needed {
            return None;
        }
        // A local generator: starts must not depend on the order in which kinds are fitted in parallel.
        let mut random = SplitMix64::new(subset.len() as u64);
        let mut best: Option<(f64, Vec<f64>)> = None;
        for _ in 0..SAMPLES {
            let mut drawn: Vec<usize> = Vec::with_capacity(self.needed);
            while drawn.len() < self.needed {
                let next = (random.next_u64() % subset.len() as u64) as usize;
                if !drawn.contains(&next) {
                    drawn.push(next);
                }
            }
            let sample: Vec<[f64; 2]> = drawn.into_iter().map(|k| subset[k]).collect();
            let Some(curve) = (self.fit)(&sample) else {
                continue;
            };
            let median = self.median(&curve, &subset);
            if best.as_ref().is_none_or(|b| median < b.0) && median.is_finite() {
                best = Some((median, curve));
            }
        }
        let (median, curve) = best?;
        let near: Vec<[f64; 2]> = points
            .iter()
            .copied()
            .filter(|p| (self.distance)(&curve, *p).abs() <= INLIER_SIGMAS * NORMAL * median)
            .collect();
        // Refitting reduces the scatter of a curve through few points. It is dropped if it fits half of the
        // points worse, as when structured outliers were included.
        let again = (self.fit)(&near).filter(|again| self.median(again, &subset) <= 1.5 * median);
        Some(again.unwrap_or(curve))
    }
}
