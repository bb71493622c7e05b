//! How far surface without readings may be from the object, by its distance to the readings.
//!
//! The object passes through the nearest reading, at a distance `d`. How far it departs from a continuation
//! of the readings depends on the object: little if it is smooth, and up to `d` beyond a right-angled edge.
//! With the share `k` of `d` that the object departs,
//!
//! ```text
//! σ = min(1.6 k, 1) d / √3
//! ```
//!
//! the standard deviation of a uniform distribution within the departure. `k` is the larger of two shares:
//! that of the measured surface, by distance, and that by which the surface that closes an opening departs
//! from the continuation of its rim.
//!
//! Not guaranteed: shape within an opening of which neither the measured surface nor the closing one shows
//! any sign.

use planish_estimate::{Error, Result};

/// Ratio of the departure at a right-angled edge to the share that is measured there. Places are at all
/// distances from edges, and directions at all angles to them: the share is 0.6 to 0.85 for boxes, prisms,
/// brackets and cylinders (98 % quantile).
const AT_RIGHT_ANGLES: f64 = 1.6;

/// Shares of the distance to the nearest reading by which unobserved surface may depart.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Departure {
    by_distance: Vec<[f64; 2]>,
    of_leaf: Vec<f64>,
}

impl Departure {
    /// From shares of the measured surface at increasing distances (distance, share), and from shares of
    /// each leaf.
    ///
    /// # Errors
    /// `Input` for distances that do not increase from 0, and for shares outside of 0 to 1.
    ///
    /// # Examples
    /// ```
    /// use planish_surface::model::Departure;
    /// let departure = Departure::new(vec![[1.0, 0.1], [4.0, 0.4]], vec![0.0, 1.0])?;
    /// // Between distances, shares follow the logarithm of the distance: 0.25 at 2.
    /// assert!((departure.sigma(0, 2.0) - 1.6 * 0.25 * 2.0 / 3_f64.sqrt()).abs() < 1e-12);
    /// // Leaf 1 may be anywhere within the distance.
    /// assert!((departure.sigma(1, 2.0) - 2.0 / 3_f64.sqrt()).abs() < 1e-12);
    /// # Ok::<(), planish_core::Error>(())
    /// ```
    pub fn new(by_distance: Vec<[f64; 2]>, of_leaf: Vec<f64>) -> Result<Self> {
        let is_share = |share: &f64| (0.0..=1.0).contains(share);
        let increasing = by_distance.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        let valid = |[distance, share]: &[f64; 2]| *distance > 0.0 && distance.is_finite() && is_share(share);
        if !increasing || !by_distance.iter().all(valid) || !of_leaf.iter().all(is_share) {
            return Err(Error::input(
                "expected departures at increasing distances > 0, with shares from 0 to 1, found others",
            ));
        }
        Ok(Self { by_distance, of_leaf })
    }

    /// Distances and shares of the measured surface.
    #[must_use]
    pub fn by_distance(&self) -> &[[f64; 2]] {
        &self.by_distance
    }

    /// Shares of each leaf.
    #[must_use]
    pub fn of_leaf(&self) -> &[f64] {
        &self.of_leaf
    }

    /// The same for other leaves of the same surface; `former` gives the leaf in which each of them lay.
    pub(crate) fn for_leaves(&self, former: impl Iterator<Item = usize>) -> Self {
        let of_leaf = former.map(|leaf| self.of_leaf.get(leaf).copied().unwrap_or(0.0)).collect();
        Self { by_distance: self.by_distance.clone(), of_leaf }
    }

    /// The smallest σ of a place of a leaf without readings, at a distance from the nearest one.
    #[must_use]
    pub fn sigma(&self, leaf: usize, distance: f64) -> f64 {
        let share = self.share(distance).max(self.of_leaf.get(leaf).copied().unwrap_or(0.0));
        (AT_RIGHT_ANGLES * share).min(1.0) * distance / 3_f64.sqrt()
    }

    /// The share of the measured surface: linear in the logarithm of the distance. Beyond the last one it
    /// grows with the distance, as that of a surface with constant change of curvature.
    fn share(&self, distance: f64) -> f64 {
        let after = self.by_distance.partition_point(|[at, _]| *at < distance);
        match (self.by_distance.get(after.wrapping_sub(1)), self.by_distance.get(after)) {
            (Some([near, a]), Some([far, b])) => a + (b - a) * (distance / near).ln() / (far / near).ln(),
            (Some([last, share]), None) => share * distance / last,
            (None, Some([_, share])) => *share,
            (None, None) => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_grow_with_the_distance_and_sigma_never_exceeds_a_uniform_distribution() {
        let departure = Departure::new(vec![[1.0, 0.2], [2.0, 0.3]], vec![0.0]).unwrap();
        let mut last = 0.0;
        for k in 1..100 {
            let distance = 0.1 * f64::from(k);
            let sigma = departure.sigma(0, distance);
            assert!(sigma > last && sigma <= distance / 3_f64.sqrt() + 1e-12, "{distance}: {sigma}");
            last = sigma;
        }
        assert_eq!(Departure::default().sigma(7, 3.0), 0.0);
    }

    #[test]
    fn shares_above_one_and_distances_that_decrease_are_refused() {
        assert!(Departure::new(vec![[1.0, 1.1]], Vec::new()).is_err());
        assert!(Departure::new(vec![[2.0, 0.1], [1.0, 0.1]], Vec::new()).is_err());
        assert!(Departure::new(Vec::new(), vec![f64::NAN]).is_err());
    }
}
