//! Curves of edges: points, derivatives, nearest points, and division into chords.

use super::{Fineness, SplineCurve};
use planish_core::DVec3;
use std::f64::consts::{FRAC_PI_6, TAU};

/// Maximum number of halvings of a piece between two breaks. It bounds the number of chords.
const MAX_HALVINGS: usize = 14;
/// Number of samples on each piece of a spline, times its degree, from which the nearest point is searched.
///
/// A piece of degree p has few turns; more samples than turns make it unlikely that the nearest one is
/// missed.
const PLACES: usize = 4;

/// A curve in space.
#[derive(Debug, Clone, PartialEq)]
pub enum ParametricCurve {
    /// `origin + t along`.
    Line {
        /// The point at parameter 0.
        origin: DVec3,
        /// Derivative, of any length.
        along: DVec3,
    },
    /// `center + a cos t + b sin t`, the axes orthogonal.
    Ellipse {
        /// Centre.
        center: DVec3,
        /// Semi-axis at parameter 0.
        a: DVec3,
        /// Semi-axis at parameter π/2.
        b: DVec3,
    },
    /// `center + a cosh t + b sinh t`, the axes orthogonal.
    Hyperbola {
        /// Centre.
        center: DVec3,
        /// Semi-axis towards the vertex of the branch.
        a: DVec3,
        /// Semi-axis across it.
        b: DVec3,
    },
    /// `vertex + t² a + 2 t b`, the axes orthogonal and of the focal length.
    Parabola {
        /// Vertex.
        vertex: DVec3,
        /// Axis towards the focus.
        a: DVec3,
        /// Axis across it.
        b: DVec3,
    },
    /// A rational B-spline.
    Spline(SplineCurve),
}

impl ParametricCurve {
    /// The point at a parameter.
    #[must_use]
    pub fn point(&self, t: f64) -> DVec3 {
        self.at(t).0
    }

    /// The point and the derivative at a parameter. A closed spline continues periodically beyond its ends.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::ParametricCurve;
    ///
    /// let line = ParametricCurve::Line { origin: DVec3::X, along: 2.0 * DVec3::Y };
    /// assert_eq!(line.at(1.5), (DVec3::new(1.0, 3.0, 0.0), 2.0 * DVec3::Y));
    /// ```
    #[must_use]
    pub fn at(&self, t: f64) -> (DVec3, DVec3) {
        let pair = |p: DVec3, x: [f64; 2], a: DVec3, y: [f64; 2], b: DVec3| {
            (p + x[0] * a + y[0] * b, x[1] * a + y[1] * b)
        };
        match self {
            Self::Line { origin, along } => (*origin + t * *along, *along),
            Self::Ellipse { center, a, b } => {
                let (sin, cos) = t.sin_cos();
                pair(*center, [cos, -sin], *a, [sin, cos], *b)
            }
            Self::Hyperbola { center, a, b } => {
                let (sinh, cosh) = (t.sinh(), t.cosh());
                pair(*center, [cosh, sinh], *a, [sinh, cosh], *b)
            }
            Self::Parabola { vertex, a, b } => pair(*vertex, [t * t, 2.0 * t], *a, [2.0 * t, 2.0], *b),
            Self::Spline(spline) => spline.at(t),
        }
    }

    /// Period of the parameter of a closed curve.
    #[must_use]
    pub fn period(&self) -> Option<f64> {
        match self {
            Self::Ellipse { .. } => Some(TAU),
            Self::Spline(spline) => spline.period(),
            _ => None,
        }
    }

    /// Parameter of the point of the curve nearest to `p`. On a spline, `guess` is one more starting point.
    ///
    /// On conics, it is exact only for points of the curve: it follows from the coordinates along the axes.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::ParametricCurve;
    ///
    /// let line = ParametricCurve::Line { origin: DVec3::X, along: 2.0 * DVec3::Y };
    /// assert_eq!(line.parameter(DVec3::new(7.0, 3.0, 0.0), None), 1.5);
    /// ```
    #[must_use]
    pub fn parameter(&self, p: DVec3, guess: Option<f64>) -> f64 {
        let along =
            |center: &DVec3, a: &DVec3| (p - *center).dot(*a) / a.length_squared().max(f64::MIN_POSITIVE);
        match self {
            Self::Line { origin, along: d } => along(origin, d),
            Self::Ellipse { center, a, b } => along(center, b).atan2(along(center, a)),
            Self::Hyperbola { center, b, .. } => along(center, b).asinh(),
            Self::Parabola { vertex, b, .. } => 0.5 * along(vertex, b),
            Self::Spline(_) => self.nearest(&|q| q - p, &|d| d, guess),
        }
    }

    /// The parameter at which `residual` of the point is shortest. `turned` maps a derivative of the point to
    /// that of the residual.
    ///
    /// Gauss–Newton steps start at all local minima among the samples, because a curve may pass a point
    /// several times.
    pub(super) fn nearest(
        &self,
        residual: &dyn Fn(DVec3) -> DVec3,
        turned: &dyn Fn(DVec3) -> DVec3,
        guess: Option<f64>,
    ) -> f64 {
        let period = self.period();
        let [lo, hi] = self.domain();
        let square = |t: f64| {
            let r = residual(self.point(t));
            r.length_squared()
        };
        let inside = |t: f64| if period.is_some() { t } else { t.clamp(lo, hi) };
        let refine = |mut t: f64| {
            let mut value = square(t);
            // Gauss–Newton without second derivatives: it converges quadratically for points on the curve,
            // which is the usual case for ends of edges.
            for _ in 0..40 {
                let (q, d) = self.at(t);
                let (r, d) = (residual(q), turned(d));
                let mut step = -r.dot(d) / d.length_squared().max(f64::MIN_POSITIVE);
                let mut next = inside(t + step);
                // A step that does not come nearer is halved.
                while square(next) > value && (next - t).abs() > 1e-15 * (hi - lo) {
                    step *= 0.5;
                    next = inside(t + step);
                }
                let moved = (next - t).abs();
                let better = square(next);
                if better >= value {
                    break;
                }
                (t, value) = (next, better);
                if moved <= 1e-14 * (hi - lo) {
                    break;
                }
            }
            (value, t)
        };
        // The guess is refined first. The best result is taken, so a wrong guess does no harm.
        let mut starts: Vec<f64> = guess.into_iter().collect();
        let places = self.places();
        let values: Vec<f64> = places.iter().map(|t| square(*t)).collect();
        for k in 0..places.len() {
            let is_lower = |other: Option<&f64>| other.is_none_or(|o| values[k] <= *o);
            if is_lower(k.checked_sub(1).and_then(|k| values.get(k))) && is_lower(values.get(k + 1)) {
                starts.push(places[k]);
            }
        }
        let best = starts.into_iter().map(refine).min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or(lo, |(_, t)| t)
    }

    /// Range of the parameter. Unbounded curves have a nominal range, used only for samples.
    #[must_use]
    pub fn domain(&self) -> [f64; 2] {
        match self {
            Self::Line { .. } => [0.0, 1.0],
            Self::Ellipse { .. } => [0.0, TAU],
            Self::Hyperbola { .. } | Self::Parabola { .. } => [-8.0, 8.0],
            Self::Spline(spline) => spline.domain(),
        }
    }

    /// Parameters of samples along the domain.
    fn places(&self) -> Vec<f64> {
        let breaks = self.breaks(self.domain());
        let each = match self {
            Self::Spline(spline) => PLACES * spline.degree(),
            _ => PLACES,
        };
        let mut found: Vec<f64> = breaks
            .windows(2)
            .flat_map(|b| (0..each).map(move |k| b[0] + (b[1] - b[0]) * k as f64 / each as f64))
            .collect();
        found.extend(breaks.last());
        found
    }

    /// Parameters that divide a range before any error is tested, including both ends: where pieces of a
    /// spline meet, and every 30° of an ellipse.
    ///
    /// Tests at a few points of a long range could miss a bend, or find a symmetric curve straight.
    pub(super) fn breaks(&self, [from, to]: [f64; 2]) -> Vec<f64> {
        let even =
            |n: usize| -> Vec<f64> { (0..=n).map(|k| from + (to - from) * k as f64 / n as f64).collect() };
        match self {
            Self::Line { .. } => vec![from, to],
            // The bound keeps ranges of many turns, which damaged files may contain, from using all memory.
            Self::Ellipse { .. } => even((((to - from) / FRAC_PI_6).ceil() as usize).clamp(2, 1000)),
            Self::Hyperbola { .. } | Self::Parabola { .. } => even(8),
            Self::Spline(spline) => {
                let own = spline.breaks();
                // A range of a closed spline may begin anywhere and cross the seam, so its knots are
                // repeated.
                let shifts: Vec<f64> = match self.period() {
                    Some(period) => {
                        let first = ((from - own[0]) / period).floor();
                        let turns = ((to - from) / period).ceil().clamp(0.0, 4.0) as usize + 1;
                        (0..turns).map(|k| (first + k as f64) * period).collect()
                    }
                    None => vec![0.0],
                };
                let small = 1e-9 * (to - from);
                let inner = shifts.iter().flat_map(|s| own.iter().map(move |t| t + s));
                let mut found = vec![from];
                for t in inner {
                    if t > found[found.len() - 1] + small && t < to - small {
                        found.push(t);
                    }
                }
                found.push(to);
                found
            }
        }
    }

    /// Range of the parameter between two points; with `is_closed`, both are the same point.
    ///
    /// On a periodic curve it is ascending. On others, the ends are the parameters of the points, in this
    /// order.
    #[must_use]
    pub fn range(&self, [from, to]: [DVec3; 2], is_closed: bool) -> [f64; 2] {
        let first = self.parameter(from, None);
        // Equal ends of an open periodic range mean a whole turn, not none.
        match self.period() {
            Some(period) if is_closed => [first, first + period],
            Some(period) => {
                let more = (self.parameter(to, None) - first).rem_euclid(period);
                [first, first + if more < 1e-12 * period { period } else { more }]
            }
            None if is_closed => self.domain(),
            None => [first, self.parameter(to, None)],
        }
    }

    /// Parameters that divide a range into chords, without its ends.
    ///
    /// The error of a chord is at most half of the tolerance, because the triangles at the edge add theirs.
    /// Its length is at most the maximum side.
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::{Fineness, ParametricCurve};
    ///
    /// let line = ParametricCurve::Line { origin: DVec3::ZERO, along: DVec3::X };
    /// let fineness = Fineness { chord: 0.1, longest: 3.0 };
    /// assert_eq!(line.chords([0.0, 4.0], &fineness), [2.0]);
    /// ```
    #[must_use]
    pub fn chords(&self, range: [f64; 2], fineness: &Fineness) -> Vec<f64> {
        let [from, to] = range;
        let is_back = to < from;
        let breaks = self.breaks(if is_back { [to, from] } else { range });
        let mut found = Vec::new();
        for pair in breaks.windows(2) {
            self.halve([pair[0], pair[1]], fineness, MAX_HALVINGS, &mut found);
            found.push(pair[1]);
        }
        found.pop();
        // Divided in the ascending direction, so that an edge has the same points in both directions.
        if is_back {
            found.reverse();
        }
        found
    }

    /// Halves a range until its chord is short and accurate, and collects the parameters.
    fn halve(&self, [from, to]: [f64; 2], fineness: &Fineness, depth: usize, found: &mut Vec<f64>) {
        let (a, b) = (self.point(from), self.point(to));
        let chord = b - a;
        let square = chord.length_squared().max(f64::MIN_POSITIVE);
        let misses = |share: f64| {
            let d = self.point(from + share * (to - from)) - a;
            let along = (d.dot(chord) / square).clamp(0.0, 1.0);
            (d - along * chord).length() > 0.5 * fineness.chord
        };
        // Three points are tested: the middle alone would find an S-shaped piece straight.
        let is_long = square.sqrt() > fineness.longest;
        let is_line = matches!(self, Self::Line { .. });
        if depth > 0 && (is_long || !is_line && [0.25, 0.5, 0.75].into_iter().any(misses)) {
            let middle = 0.5 * (from + to);
            self.halve([from, middle], fineness, depth - 1, found);
            found.push(middle);
            self.halve([middle, to], fineness, depth - 1, found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave() -> ParametricCurve {
        let poles: Vec<DVec3> = (0..12)
            .map(|k| {
                let t = f64::from(k) / 11.0 * TAU;
                DVec3::new(t.cos() * (2.0 + (3.0 * t).sin()), t.sin() * 3.0, 0.5 * (2.0 * t).cos())
            })
            .collect();
        let knots: Vec<f64> = [0.0; 3].into_iter().chain((0..=9).map(f64::from)).chain([9.0; 3]).collect();
        ParametricCurve::Spline(SplineCurve::try_new(3, knots, &poles, None).unwrap())
    }

    #[test]
    fn parameters_of_points_on_curves_are_recovered() {
        let shapes = [
            ParametricCurve::Line { origin: DVec3::new(1.0, 2.0, 3.0), along: DVec3::new(0.5, -2.0, 0.25) },
            ParametricCurve::Ellipse { center: DVec3::X, a: 3.0 * DVec3::X, b: 2.0 * DVec3::Z },
            ParametricCurve::Hyperbola { center: DVec3::ZERO, a: DVec3::X, b: 2.0 * DVec3::Y },
            ParametricCurve::Parabola { vertex: DVec3::ZERO, a: DVec3::X, b: DVec3::Y },
            wave(),
        ];
        for curve in shapes {
            for k in 1..20 {
                let t = 0.15 * f64::from(k);
                let (p, d) = curve.at(t);
                let h = 1e-6;
                let by = (curve.point(t + h) - curve.point(t - h)).map(|x| x / (2.0 * h));
                assert!((by - d).length() < 1e-7 * d.length().max(1.0), "{curve:?} at {t}");
                assert!((curve.parameter(p, None) - t).abs() < 1e-7, "{curve:?} at {t}");
            }
        }
    }

    #[test]
    fn chords_satisfy_the_tolerance_and_the_maximum_length() {
        let fineness = Fineness { chord: 1e-3, longest: 0.2 };
        let curve = wave();
        let period = curve.period().expect("closed");
        assert_eq!(period, 9.0);
        // Across the place where it closes, and backwards.
        for range in [[0.0, 9.0], [7.5, 7.5 + 4.0], [6.0, 1.0]] {
            let mut at = vec![range[0]];
            at.extend(curve.chords(range, &fineness));
            at.push(range[1]);
            for pair in at.windows(2) {
                let (a, b) = (curve.point(pair[0]), curve.point(pair[1]));
                assert!(a.distance(b) <= 0.2);
                let m = curve.point(0.5 * (pair[0] + pair[1]));
                let d = b - a;
                let off = (m - a - (m - a).dot(d) / d.length_squared() * d).length();
                assert!(off <= 0.5e-3, "{off}");
                assert!((pair[1] > pair[0]) == (range[1] > range[0]));
            }
        }
    }
}
