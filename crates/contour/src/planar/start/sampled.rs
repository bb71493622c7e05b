//! Starts that wild readings do not pull away: the least median of distances over curves through few
//! readings.
//!
//! # References
//! Rousseeuw 1984, *Least median of squares regression*; Fischler and Bolles 1981, *Random sample consensus*.

use planish_core::random::SplitMix64;

/// Curves that are tried: of samples of five readings, a fifth of them wild, a hundred are free of wild ones.
const SAMPLES: usize = 300;
/// Of more points than this every so manieth is looked at.
const MAX_POINTS: usize = 400;
/// A standard deviation over the median of absolute values, of a normal distribution.
const NORMAL: f64 = 1.4826;
/// Points within so many standard deviations are of the curve.
const NEAR: f64 = 2.5;

/// Fits a curve to points, where it can.
type Fit<'a> = dyn Fn(&[[f64; 2]]) -> Option<Vec<f64>> + 'a;

/// A kind of curve by what it takes to fit one.
pub(super) struct Curve<'a> {
    /// How many points determine it.
    pub(super) needed: usize,
    /// The curve of points, if there is one.
    pub(super) fit: &'a Fit<'a>,
    /// The distance of a point from it.
    pub(super) distance: &'a dyn Fn(&[f64], [f64; 2]) -> f64,
}

impl Curve<'_> {
    /// The median distance of points.
    pub(super) fn median(&self, curve: &[f64], points: &[[f64; 2]]) -> f64 {
        let mut distances: Vec<f64> = points.iter().map(|p| (self.distance)(curve, *p).abs()).collect();
        if distances.iter().any(|d| !d.is_finite()) {
            return f64::INFINITY;
        }
        let middle = distances.len() / 2;
        *distances.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The curve of the least median distance through few of the points, fitted again to all that are near
    /// it; the same points give the same curve.
    pub(super) fn of_least_median(&self, points: &[[f64; 2]]) -> Option<Vec<f64>> {
        let some: Vec<[f64; 2]> =
            points.iter().copied().step_by(points.len().div_ceil(MAX_POINTS).max(1)).collect();
        if some.len() < 2 * self.needed {
            return None;
        }
        let mut random = SplitMix64::new(some.len() as u64);
        let mut best: Option<(f64, Vec<f64>)> = None;
        for _ in 0..SAMPLES {
            let mut drawn: Vec<usize> = Vec::with_capacity(self.needed);
            while drawn.len() < self.needed {
                let next = (random.next_u64() % some.len() as u64) as usize;
                if !drawn.contains(&next) {
                    drawn.push(next);
                }
            }
            let sample: Vec<[f64; 2]> = drawn.into_iter().map(|k| some[k]).collect();
            let Some(curve) = (self.fit)(&sample) else {
                continue;
            };
            let median = self.median(&curve, &some);
            if best.as_ref().is_none_or(|b| median < b.0) && median.is_finite() {
                best = Some((median, curve));
            }
        }
        let (median, curve) = best?;
        let near: Vec<[f64; 2]> = points
            .iter()
            .copied()
            .filter(|p| (self.distance)(&curve, *p).abs() <= NEAR * NORMAL * median)
            .collect();
        let again = (self.fit)(&near).filter(|again| self.median(again, &some) <= 1.5 * median);
        Some(again.unwrap_or(curve))
    }
}
