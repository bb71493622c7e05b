//! The projected pattern: two sets of parallel stripes.

use planish_estimate::{Error, Result};

/// Two sets of parallel, evenly spaced stripes in the projector's image.
///
/// Stripe k of a set with the direction φ is the line of points p with `(p − origin) · (−sin φ, cos φ) = k ·
/// spacing`. Stripes 0 of both sets cross at the origin.
///
/// # Examples
/// ```
/// use planish_sense::stripes::StripePattern;
/// let pattern = StripePattern {
///     directions_rad: [0.0, std::f64::consts::FRAC_PI_2],
///     spacing: 10.0,
///     origin: [100.0, 100.0],
///     range: [[-5, 5], [-5, 5]],
/// };
/// let [x, y] = pattern.crossing([2.0, 0.0]);
/// assert!((x - 100.0).abs() < 1e-9 && (y - 120.0).abs() < 1e-9);
/// assert!(pattern.holds([2, 0]) && !pattern.holds([6, 0]));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StripePattern {
    /// Angles of both sets, from x (right) to y (down), in radians.
    pub directions_rad: [f64; 2],
    /// Distance of neighbouring stripes of a set, in the projector's pixels.
    pub spacing: f64,
    /// Where stripes 0 of both sets cross, in the projector's pixels.
    pub origin: [f64; 2],
    /// The first and the last stripe of each set.
    pub range: [[i32; 2]; 2],
}

impl StripePattern {
    /// Checks that the pattern has two sets of crossing stripes.
    ///
    /// # Errors
    /// `Input` for directions that differ by less than 10°, a spacing that is not positive, or a range with
    /// fewer than two stripes.
    pub fn sanity_check(&self) -> Result<()> {
        let [a, b] = self.directions_rad;
        let crossing = (b - a).sin().abs().asin().to_degrees();
        if crossing.is_nan() || crossing < 10.0 {
            return Err(Error::input(format!(
                "expected two sets of stripes that cross at 10° or more, found {crossing:.1}°"
            )));
        }
        if !(self.spacing > 0.0 && self.spacing.is_finite() && self.origin.iter().all(|c| c.is_finite())) {
            return Err(Error::input(format!(
                "expected a spacing of stripes above 0 and a finite origin, found {} and {:?}",
                self.spacing, self.origin
            )));
        }
        match self.range.iter().find(|[first, last]| last <= first) {
            Some([first, last]) => Err(Error::input(format!(
                "expected two stripes of each set or more, found {first} to {last}"
            ))),
            None => Ok(()),
        }
    }

    /// Unit vectors along the stripes of both sets.
    #[must_use]
    pub fn directions(&self) -> [[f64; 2]; 2] {
        self.directions_rad.map(|a| [a.cos(), a.sin()])
    }

    /// Fractional stripe indices of a point in both sets; they are integers on the stripes.
    #[must_use]
    pub fn indices(&self, place: [f64; 2]) -> [f64; 2] {
        let d = [place[0] - self.origin[0], place[1] - self.origin[1]];
        self.directions().map(|[x, y]| (x * d[1] - y * d[0]) / self.spacing)
    }

    /// The point where two stripes, one of each set, cross.
    #[must_use]
    pub fn crossing(&self, of: [f64; 2]) -> [f64; 2] {
        let [[ax, ay], [bx, by]] = self.directions();
        let [r, s] = of.map(|k| k * self.spacing);
        // −ay x + ax y = r, −by x + bx y = s.
        let determinant = ax * by - ay * bx;
        let x = (bx * r - ax * s) / determinant;
        let y = (by * r - ay * s) / determinant;
        [self.origin[0] + x, self.origin[1] + y]
    }

    /// True if both stripes are part of the pattern.
    #[must_use]
    pub fn holds(&self, of: [i32; 2]) -> bool {
        of.iter().zip(&self.range).all(|(k, [first, last])| k >= first && k <= last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crossings_have_integer_indices() {
        let pattern = StripePattern {
            directions_rad: [0.4, 2.1],
            spacing: 17.0,
            origin: [300.0, 200.0],
            range: [[-5, 5]; 2],
        };
        pattern.sanity_check().unwrap();
        for of in [[0.0, 0.0], [3.0, -4.0], [-5.0, 2.0]] {
            let found = pattern.indices(pattern.crossing(of));
            assert!((0..2).all(|k| (found[k] - of[k]).abs() < 1e-12), "{found:?}");
        }
        assert!(pattern.holds([5, -5]) && !pattern.holds([6, 0]));
        let same = StripePattern { directions_rad: [0.4, 0.4 + std::f64::consts::PI], ..pattern };
        assert!(same.sanity_check().unwrap_err().to_string().contains("cross at 10°"));
        assert!(StripePattern { range: [[0, 3], [1, 1]], ..pattern }.sanity_check().is_err());
    }
}
