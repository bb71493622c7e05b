//! σ where nothing was measured: what the smoothness prior predicts, corrected by how well it predicts
//! left-out parts of the same data.
//!
//! A covariance that contains the prior is right for surfaces drawn from that prior. Objects are not: their
//! large-scale shape deviates more than the fine detail suggests, from which the weight of the prior is
//! estimated. With the distance `d` to the nearest reading,
//!
//! ```text
//! σ²(place) = max(f(d)² v, r(d)²)
//! ```
//!
//! where `v` is the posterior variance, and `f` and `r` were found by leaving out whole regions: `f²` is the
//! mean square of prediction errors over `v`, and `r` their root mean square. Both grow with `d` or stay.
//! Beyond the largest tested distance `f` follows the power law of the tested ones, and `r` stays.
//!
//! Left-out regions are surrounded by surface that is like them. Openings of closed surfaces are not: an
//! object on a table has its edges where readings end. Their σ is at least that of a [`Departure`].
//!
//! Not guaranteed: that unmeasured parts are like the measured ones. Steps, handles and whole features that
//! nothing shows are not covered.

use super::Departure;
use planish_estimate::{Error, Result};

/// What leaving out regions has shown at one distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictionError {
    /// Distance to the nearest reading, in the model's unit.
    pub distance: f64,
    /// Errors in σ of the posterior, at least 1.
    pub factor: f64,
    /// Smallest σ, in the model's unit.
    pub floor: f64,
}

/// Errors of predicted surface by its distance to the nearest reading.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictiveSigma {
    errors: Vec<PredictionError>,
    growth: f64,
    largest: f64,
    departure: Option<Departure>,
}

impl PredictiveSigma {
    /// From errors at increasing distances; `growth` is the power of the distance with which σ grows
    /// beyond the last, and `largest` bounds σ.
    ///
    /// # Errors
    /// `Input` without errors, for distances that do not increase, and for numbers that are negative or not
    /// finite.
    ///
    /// # Examples
    /// ```
    /// use planish_surface::model::{PredictionError, PredictiveSigma};
    /// let near = PredictionError { distance: 1.0, factor: 1.0, floor: 0.1 };
    /// let far = PredictionError { distance: 4.0, factor: 4.0, floor: 0.1 };
    /// let law = PredictiveSigma::new(vec![near, far], 1.0, 50.0)?;
    /// // Variance 1 of the posterior: σ = 2 at distance 2, and 8 at distance 8.
    /// assert!((law.variance(1.0, 2.0) - 4.0).abs() < 1e-12);
    /// assert!((law.variance(1.0, 8.0) - 64.0).abs() < 1e-12);
    /// # Ok::<(), planish_core::Error>(())
    /// ```
    pub fn new(errors: Vec<PredictionError>, growth: f64, largest: f64) -> Result<Self> {
        let valid = |e: &PredictionError| {
            e.distance > 0.0
                && e.factor >= 1.0
                && e.floor >= 0.0
                && [e.distance, e.factor, e.floor].iter().all(|x| x.is_finite())
        };
        let increasing = errors.windows(2).all(|pair| pair[0].distance < pair[1].distance);
        let bounded = growth >= 0.0 && growth.is_finite() && largest > 0.0 && largest.is_finite();
        if errors.is_empty() || !errors.iter().all(valid) || !increasing || !bounded {
            return Err(Error::input(
                "expected prediction errors at increasing distances > 0, with factors ≥ 1, floors ≥ 0 and a \
                 growth ≥ 0, found others",
            ));
        }
        Ok(Self { errors, growth, largest, departure: None })
    }

    /// The same with a smallest σ of places in openings of closed surfaces.
    #[must_use]
    pub fn with_departure(self, departure: Departure) -> Self {
        Self { departure: Some(departure), ..self }
    }

    /// The smallest σ of places in openings of closed surfaces, if there is one.
    #[must_use]
    pub fn departure(&self) -> Option<&Departure> {
        self.departure.as_ref()
    }

    /// The errors, by increasing distance.
    #[must_use]
    pub fn errors(&self) -> &[PredictionError] {
        &self.errors
    }

    /// The power of the distance with which σ grows beyond the last error.
    #[must_use]
    pub fn growth(&self) -> f64 {
        self.growth
    }

    /// The largest σ, in the model's unit.
    #[must_use]
    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// Variance of a place at a distance from the nearest reading with posterior variance `posterior`.
    #[must_use]
    pub fn variance(&self, posterior: f64, distance: f64) -> f64 {
        let (factor, floor) = self.at(distance);
        let predicted = (factor * factor * posterior).max(floor * floor);
        // The bound holds for the correction only: a posterior may state more.
        predicted.min(self.largest * self.largest).max(posterior)
    }

    /// Variance of a place of a leaf, with its departure.
    #[must_use]
    pub fn variance_in(&self, leaf: usize, posterior: f64, distance: f64) -> f64 {
        let departure = self.departure.as_ref().map_or(0.0, |departure| departure.sigma(leaf, distance));
        self.variance(posterior, distance).max(departure * departure)
    }

    /// Factor and floor, linear in the logarithms between the tested distances.
    fn at(&self, distance: f64) -> (f64, f64) {
        let after = self.errors.partition_point(|e| e.distance < distance);
        match (self.errors.get(after.wrapping_sub(1)), self.errors.get(after)) {
            (Some(a), Some(b)) => {
                let t = (distance / a.distance).ln() / (b.distance / a.distance).ln();
                (a.factor * (b.factor / a.factor).powf(t), a.floor + t * (b.floor - a.floor))
            }
            (Some(last), None) => {
                let grown = (distance / last.distance).powf(self.growth);
                (last.factor * grown, last.floor * grown)
            }
            (None, Some(first)) => (first.factor, first.floor),
            (None, None) => (1.0, 0.0),
        }
    }
}
