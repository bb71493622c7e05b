//! Rational B-spline curves and surfaces of any degree: points and first derivatives.
//!
//! Input: degree, knots, control points and weights. Output: points and derivatives at parameters, which are
//! clamped to the domain. Not guaranteed: continuity, because knots may be repeated.
//!
//! # References
//! de Boor 1972, *On calculating with B-splines* (recurrence); Piegl and Tiller 1997, *The NURBS Book*, eqs.
//! 2.5 and 2.7 (basis and its derivative), 4.1 and 4.11 (rational curves and surfaces).

use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Maximum degree. Values of the basis functions are in arrays of this size, without allocation.
pub const MAX_DEGREE: usize = 25;

/// Maximum distance between the ends of a closed curve, relative to its size.
///
/// A larger value closes curves with a real gap; a smaller one leaves curves of rounded files open.
const CLOSED: f64 = 1e-7;

/// The basis functions that are not zero on a span, and their derivatives.
struct Basis {
    first: usize,
    value: [f64; MAX_DEGREE + 1],
    slope: [f64; MAX_DEGREE + 1],
}

/// Degree and knots of one direction.
#[derive(Debug, Clone, PartialEq)]
struct Knots {
    degree: usize,
    /// Ascending; multiple knots are repeated.
    at: Vec<f64>,
    /// Number of control points.
    n: usize,
}

impl Knots {
    fn try_new(degree: usize, at: Vec<f64>, n: usize) -> Result<Self> {
        if !(1..=MAX_DEGREE).contains(&degree) {
            return Err(Error::input(format!("expected a degree from 1 to {MAX_DEGREE}, found {degree}")));
        }
        if n <= degree || at.len() != n + degree + 1 {
            return Err(Error::input(format!(
                "expected more than {degree} control points and {degree} + 1 knots more than these, found \
                 {n} and {}",
                at.len()
            )));
        }
        if at.iter().any(|k| !k.is_finite()) || at.windows(2).any(|k| k[0] > k[1]) {
            return Err(Error::input("expected finite ascending knots"));
        }
        if at[degree] >= at[n] {
            return Err(Error::input("expected knots that enclose a range, found equal ones"));
        }
        Ok(Self { degree, at, n })
    }

    fn domain(&self) -> [f64; 2] {
        [self.at[self.degree], self.at[self.n]]
    }

    /// Knots within the domain where pieces meet, including both ends.
    fn breaks(&self) -> Vec<f64> {
        let mut found = self.at[self.degree..=self.n].to_vec();
        found.dedup();
        found
    }

    /// A parameter, shifted into the domain by whole periods if the curve is closed.
    fn wrapped(&self, t: f64, is_closed: bool) -> f64 {
        let [lo, hi] = self.domain();
        match is_closed && !(lo..=hi).contains(&t) {
            true => lo + (t - lo).rem_euclid(hi - lo),
            false => t,
        }
    }

    /// Values and derivatives of the basis functions at a parameter (The NURBS Book, algorithm A2.2 and
    /// eq. 2.7).
    fn basis(&self, t: f64) -> Basis {
        let (p, k) = (self.degree, &self.at);
        let [lo, hi] = self.domain();
        let t = t.clamp(lo, hi);
        // At the end of the domain, the span search finds an empty span; the last one with a width is used.
        // Binary search instead of a guess from the parameter: knots may be very uneven.
        let mut span = k[..self.n].partition_point(|x| *x <= t).max(p + 1) - 1;
        while span > p && k[span] >= k[span + 1] {
            span -= 1;
        }
        // The triangular scheme of de Boor and Cox: sums of positive terms only, so nothing cancels.
        let mut value = [0.0; MAX_DEGREE + 1];
        let mut lower = [0.0; MAX_DEGREE + 1];
        value[0] = 1.0;
        for d in 1..=p {
            // The derivative needs the functions of the degree below.
            if d == p {
                lower = value;
            }
            let mut saved = 0.0;
            for r in 0..d {
                let (right, left) = (k[span + r + 1], k[span + 1 + r - d]);
                let share = value[r] / (right - left);
                value[r] = saved + (right - t) * share;
                saved = (t - left) * share;
            }
            value[d] = saved;
        }
        let mut slope = [0.0; MAX_DEGREE + 1];
        for r in 0..=p {
            let i = span + r - p;
            // By convention 0/0 = 0: over an empty span, the lower function is zero.
            let part = |n: f64, width: f64| if width > 0.0 { p as f64 * n / width } else { 0.0 };
            if r > 0 {
                slope[r] += part(lower[r - 1], k[i + p] - k[i]);
            }
            if r < p {
                slope[r] -= part(lower[r], k[i + p + 1] - k[i + 1]);
            }
        }
        Basis { first: span - p, value, slope }
    }
}

/// Homogeneous control points: coordinates times weight, and the weight.
fn homogeneous(poles: &[DVec3], weights: Option<&[f64]>) -> Result<Vec<[f64; 4]>> {
    if weights.is_some_and(|w| w.len() != poles.len()) {
        return Err(Error::input(format!(
            "expected a weight for each of {} control points, found {}",
            poles.len(),
            weights.map_or(0, <[f64]>::len)
        )));
    }
    poles
        .iter()
        .enumerate()
        .map(|(k, p)| {
            let w = weights.map_or(1.0, |w| w[k]);
            // With weights of zero or below, the denominator may vanish.
            if !(w > 0.0 && w.is_finite() && p.is_finite()) {
                return Err(Error::input(format!(
                    "control point {k}: expected finite coordinates and a weight > 0, found {:?} and {w}",
                    p.to_array()
                )));
            }
            Ok([p[0] * w, p[1] * w, p[2] * w, w])
        })
        .collect()
}

/// Point and derivatives from homogeneous ones, by the quotient rule.
fn projected<const N: usize>(value: [f64; 4], slopes: [[f64; 4]; N]) -> (DVec3, [DVec3; N]) {
    let w = value[3];
    let coordinates = |h: [f64; 4]| DVec3::new(h[0], h[1], h[2]);
    let point = coordinates(value) / w;
    (point, slopes.map(|s| (coordinates(s) - s[3] * point) / w))
}

/// A rational B-spline curve `C(t) = Σ Nᵢ(t) wᵢ Pᵢ / Σ Nᵢ(t) wᵢ`.
#[derive(Debug, Clone, PartialEq)]
pub struct SplineCurve {
    knots: Knots,
    poles: Vec<[f64; 4]>,
    is_closed: bool,
}

impl SplineCurve {
    /// Creates a curve from its degree, knots (multiple ones repeated), control points, and weights if it is
    /// rational.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::SplineCurve;
    ///
    /// // A quarter of the unit circle.
    /// let poles = [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
    /// let weights = [1.0, 0.5_f64.sqrt(), 1.0];
    /// let knots = vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    /// let arc = SplineCurve::try_new(2, knots, &poles, Some(&weights))?;
    /// let (p, _) = arc.at(0.5);
    /// assert!((p[0].hypot(p[1]) - 1.0).abs() < 1e-12);
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) if the numbers of knots, control points and weights do
    /// not fit together, or values are not valid.
    pub fn try_new(degree: usize, knots: Vec<f64>, poles: &[DVec3], weights: Option<&[f64]>) -> Result<Self> {
        let mut made = Self {
            knots: Knots::try_new(degree, knots, poles.len())?,
            poles: homogeneous(poles, weights)?,
            is_closed: false,
        };
        let [lo, hi] = made.domain();
        let [from, to, one, other] = [lo, hi, 0.5 * (lo + hi), lo + 0.3 * (hi - lo)].map(|t| made.at(t).0);
        // The size comes from two inner points: at a symmetric one alone, a closed curve may pass its start.
        made.is_closed = from.distance(to) <= CLOSED * from.distance(one).max(from.distance(other));
        Ok(made)
    }

    /// A polygon through points, with one side for each unit of the parameter.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::SplineCurve;
    ///
    /// let line = SplineCurve::polyline(&[DVec3::ZERO, DVec3::X, DVec3::new(1.0, 2.0, 0.0)])?;
    /// assert_eq!(line.at(1.5).0, DVec3::new(1.0, 1.0, 0.0));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) for fewer than two points.
    pub fn polyline(points: &[DVec3]) -> Result<Self> {
        let last = points.len().saturating_sub(1);
        let ends = (0..=last).map(|k| k as f64);
        let knots = std::iter::once(0.0).chain(ends).chain([last as f64]).collect();
        Self::try_new(1, knots, points, None)
    }

    /// Minimum and maximum parameter.
    #[must_use]
    pub fn domain(&self) -> [f64; 2] {
        self.knots.domain()
    }

    /// Width of the domain if the curve is closed.
    #[must_use]
    pub fn period(&self) -> Option<f64> {
        let [lo, hi] = self.domain();
        self.is_closed.then_some(hi - lo)
    }

    /// Parameters where pieces meet, including both ends.
    #[must_use]
    pub fn breaks(&self) -> Vec<f64> {
        self.knots.breaks()
    }

    /// The degree.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.knots.degree
    }

    /// The point and the derivative at a parameter. A closed curve continues periodically beyond its ends.
    #[must_use]
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let basis = self.knots.basis(self.knots.wrapped(t, self.is_closed));
        let (mut value, mut slope) = ([0.0; 4], [0.0; 4]);
        for r in 0..=self.knots.degree {
            let pole = self.poles[basis.first + r];
            for c in 0..4 {
                value[c] += basis.value[r] * pole[c];
                slope[c] += basis.slope[r] * pole[c];
            }
        }
        let (point, [derivative]) = projected(value, [slope]);
        (point, derivative)
    }
}

/// A rational tensor-product B-spline surface.
#[derive(Debug, Clone, PartialEq)]
pub struct SplineSurface {
    knots: [Knots; 2],
    /// Homogeneous control points, v fastest.
    poles: Vec<[f64; 4]>,
    is_closed: [bool; 2],
}

impl SplineSurface {
    /// Creates a surface from degrees and knots along u and v, control points (v fastest), and weights if it
    /// is rational.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::SplineSurface;
    ///
    /// // A bilinear patch over the unit square.
    /// let poles = [DVec3::ZERO, DVec3::Y, DVec3::X, DVec3::new(1.0, 1.0, 1.0)];
    /// let knots = vec![0.0, 0.0, 1.0, 1.0];
    /// let patch = SplineSurface::try_new([1, 1], [knots.clone(), knots], &poles, None)?;
    /// assert_eq!(patch.at([0.5, 0.5]).0, DVec3::new(0.5, 0.5, 0.25));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Input`](planish_estimate::ErrorKind::Input) if the numbers of knots, control points and weights do
    /// not fit together, or values are not valid.
    pub fn try_new(
        degrees: [usize; 2],
        [knots_u, knots_v]: [Vec<f64>; 2],
        poles: &[DVec3],
        weights: Option<&[f64]>,
    ) -> Result<Self> {
        // The numbers of control points follow from the knots, and their product is checked against the list.
        let count = |knots: &Vec<f64>, degree: usize| knots.len().saturating_sub(degree + 1);
        let (n_u, n_v) = (count(&knots_u, degrees[0]), count(&knots_v, degrees[1]));
        if n_u.checked_mul(n_v) != Some(poles.len()) {
            return Err(Error::input(format!(
                "its knots are those of {n_u} x {n_v} control points, found {}",
                poles.len()
            )));
        }
        let mut made = Self {
            knots: [
                Knots::try_new(degrees[0], knots_u, n_u).map_err(|e| e.in_context("along u"))?,
                Knots::try_new(degrees[1], knots_v, n_v).map_err(|e| e.in_context("along v"))?,
            ],
            poles: homogeneous(poles, weights)?,
            is_closed: [false; 2],
        };
        // Found by comparing points: files do not state it reliably, and seams may be only nearly closed.
        made.is_closed = [0, 1].map(|k| made.closes(k));
        Ok(made)
    }

    /// True if the two sides across a direction coincide.
    fn closes(&self, k: usize) -> bool {
        let [lo, hi] = self.knots[k].domain();
        let [from, to] = self.knots[1 - k].domain();
        let at = |x: f64, share: f64| {
            let mut at = [x; 2];
            at[1 - k] = from + share * (to - from);
            self.at(at).0
        };
        // The size is the largest distance from the side to the middle. A surface without extent along this
        // direction is not closed.
        let shares = || (0..=16).map(|i| f64::from(i) / 16.0);
        let size = shares().map(|s| at(lo, s).distance(at(0.5 * (lo + hi), s))).fold(0.0, f64::max);
        size > 0.0 && shares().all(|s| at(lo, s).distance(at(hi, s)) <= CLOSED * size)
    }

    /// Period of each parameter; `None` if the surface is not closed along it.
    #[must_use]
    pub fn periods(&self) -> [Option<f64>; 2] {
        [0, 1].map(|k| {
            let [lo, hi] = self.knots[k].domain();
            self.is_closed[k].then_some(hi - lo)
        })
    }

    /// Ranges of u and v.
    #[must_use]
    pub fn domain(&self) -> [[f64; 2]; 2] {
        [self.knots[0].domain(), self.knots[1].domain()]
    }

    /// Parameters along u (0) or v (1) where pieces meet, including both ends.
    #[must_use]
    pub fn breaks(&self, direction: usize) -> Vec<f64> {
        self.knots[direction].breaks()
    }

    /// The degrees along u and v.
    #[must_use]
    pub fn degrees(&self) -> [usize; 2] {
        [self.knots[0].degree, self.knots[1].degree]
    }

    /// The point and the derivatives along u and v at parameters. A closed surface continues beyond its seam.
    #[must_use]
    pub fn at(&self, at: [f64; 2]) -> (DVec3, [DVec3; 2]) {
        let [a, b] = [0, 1].map(|k| self.knots[k].basis(self.knots[k].wrapped(at[k], self.is_closed[k])));
        let n_v = self.knots[1].n;
        let (mut value, mut slopes) = ([0.0; 4], [[0.0; 4]; 2]);
        for i in 0..=self.knots[0].degree {
            let row = &self.poles[(a.first + i) * n_v + b.first..];
            for (j, pole) in row[..=self.knots[1].degree].iter().enumerate() {
                for c in 0..4 {
                    value[c] += a.value[i] * b.value[j] * pole[c];
                    slopes[0][c] += a.slope[i] * b.value[j] * pole[c];
                    slopes[1][c] += a.value[i] * b.slope[j] * pole[c];
                }
            }
        }
        projected(value, slopes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rational_quadratic_is_a_circle_and_its_derivative_agrees_with_differences() {
        let h = 0.5_f64.sqrt();
        let poles = [
            DVec3::X,
            DVec3::new(1.0, 1.0, 0.0),
            DVec3::Y,
            DVec3::new(-1.0, 1.0, 0.0),
            DVec3::new(-1.0, 0.0, 0.0),
        ];
        let weights = [1.0, h, 1.0, h, 1.0];
        let knots = vec![0.0, 0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 2.0];
        let half = SplineCurve::try_new(2, knots, &poles, Some(&weights)).unwrap();
        for k in 0..=40 {
            let t = f64::from(k) / 20.0;
            let (p, d) = half.at(t);
            assert!((p.length() - 1.0).abs() < 1e-14, "{p:?}");
            if k % 20 != 0 {
                let step = 1e-6;
                let by = (half.at(t + step).0 - half.at(t - step).0).map(|x| x / (2.0 * step));
                assert!((by - d).length() < 1e-8, "{by:?} is not {d:?}");
            }
        }
        assert_eq!(half.breaks(), [0.0, 1.0, 2.0]);
        assert_eq!(half.at(2.0).0, DVec3::new(-1.0, 0.0, 0.0));
    }

    #[test]
    fn a_surface_reproduces_planes_and_its_slopes() {
        // Greville's abscissae as control points give the identity.
        let knots = vec![0.0, 0.0, 0.0, 0.0, 1.0, 2.5, 3.0, 3.0, 3.0, 3.0];
        let greville: Vec<f64> = (0..6).map(|i| knots[i + 1..i + 4].iter().sum::<f64>() / 3.0).collect();
        let poles: Vec<DVec3> = greville
            .iter()
            .flat_map(|u| greville.iter().map(move |v| DVec3::new(*u, *v, 2.0 * u - 3.0 * v)))
            .collect();
        let plane = SplineSurface::try_new([3, 3], [knots.clone(), knots], &poles, None).unwrap();
        for at in [[0.0, 0.0], [0.3, 2.9], [1.0, 2.5], [3.0, 3.0]] {
            let (p, [u, v]) = plane.at(at);
            let miss = (p - DVec3::new(at[0], at[1], 2.0 * at[0] - 3.0 * at[1])).length();
            assert!(miss < 1e-14, "{p:?} at {at:?}");
            assert!(
                (u - DVec3::new(1.0, 0.0, 2.0)).length() < 1e-13
                    && (v - DVec3::new(0.0, 1.0, -3.0)).length() < 1e-13
            );
        }
    }

    #[test]
    fn inconsistent_knots_poles_and_weights_are_errors() {
        let line = [DVec3::ZERO, DVec3::splat(1.0)];
        for (degree, knots, weights) in [
            (0, vec![0.0, 1.0], None),
            (1, vec![0.0, 1.0, 1.0], None),
            (1, vec![0.0, 1.0, 0.5, 2.0], None),
            (1, vec![0.0; 4], None),
            (1, vec![0.0, 0.0, 1.0, 1.0], Some(vec![1.0])),
            (1, vec![0.0, 0.0, 1.0, 1.0], Some(vec![1.0, 0.0])),
            (1, vec![0.0, 0.0, 1.0, f64::NAN], None),
            (26, vec![0.0, 0.0, 1.0, 1.0], None),
        ] {
            assert!(SplineCurve::try_new(degree, knots, &line, weights.as_deref()).is_err());
        }
        assert!(SplineCurve::polyline(&line[..1]).is_err());
        assert_eq!(SplineCurve::polyline(&line).unwrap().at(0.25).0, DVec3::splat(0.25));
    }
}
