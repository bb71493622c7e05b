//! Surfaces of faces: elementary ones, B-splines, swept and offset surfaces; and foot points on them.

use super::{ParametricCurve, SplineSurface};
use crate::brep;
use planish_core::DVec3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Maximum size of a side of a spline that counts as a point, relative to the size of the spline.
///
/// A larger value takes short sides for poles; a smaller one misses poles in rounded files.
const CLOSED: f64 = 1e-7;
/// Maximum number of samples along u and v from which the nearest point of a spline is searched.
///
/// It bounds memory (160² samples); large splines may then have less than one sample for each piece.
const MAX_PLACES: usize = 160;

/// Samples from which the foot of a point is searched: the nearest ones, and minima of the distance.
const NEAREST_STARTS: usize = 6;
const MINIMA_STARTS: usize = 12;

/// A surface with two parameters.
#[derive(Debug, Clone, PartialEq)]
pub enum ParametricSurface {
    /// A plane, cylinder, cone, sphere or torus.
    Elementary(brep::FaceSurface),
    /// A rational B-spline.
    Spline(Box<SplineSurface>),
    /// `C(u) + v along`: a curve moved along a line.
    Extrusion {
        /// Curve.
        curve: ParametricCurve,
        /// Derivative along v.
        along: DVec3,
    },
    /// `C(v)` turned by the angle u about an axis.
    Revolution {
        /// Curve.
        curve: ParametricCurve,
        /// A point of the axis.
        origin: DVec3,
        /// Unit vector along the axis.
        axis: DVec3,
    },
    /// `S(u, v) + distance n(u, v)`.
    Offset {
        /// Base surface S.
        base: Box<ParametricSurface>,
        /// Distance along the normal n of the base surface.
        distance: f64,
    },
}

/// A pole: a line of constant parameter that is a single point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pole {
    /// The constant parameter: 0 for u, 1 for v.
    pub constant: usize,
    /// Value of this parameter.
    pub value: f64,
    /// True if the pole is at the lower end of this parameter.
    pub is_low: bool,
    /// Position of the pole.
    pub point: DVec3,
}

/// `p` turned about an axis through the origin (Rodrigues' formula).
fn turned(p: DVec3, axis: DVec3, angle: f64) -> DVec3 {
    let (sin, cos) = angle.sin_cos();
    let across = cos * p + sin * axis.cross(p);
    across + (1.0 - cos) * axis.dot(p) * axis
}

/// The angle about an axis from one point to another.
fn angle_between(from: DVec3, to: DVec3, axis: DVec3) -> f64 {
    let [a, b] = [from, to].map(|p| p - p.dot(axis) * axis);
    a.cross(b).dot(axis).atan2(a.dot(b))
}

impl ParametricSurface {
    /// The point at parameters (u, v).
    ///
    /// ```
    /// use planish_core::DVec3;
    /// use planish_solid::parametric::{ParametricCurve, ParametricSurface};
    ///
    /// let curve = ParametricCurve::Line { origin: DVec3::ZERO, along: DVec3::X };
    /// let plane = ParametricSurface::Extrusion { curve, along: 2.0 * DVec3::Z };
    /// assert_eq!(plane.point([3.0, 0.5]), DVec3::new(3.0, 0.0, 1.0));
    /// ```
    #[must_use]
    pub fn point(&self, [u, v]: [f64; 2]) -> DVec3 {
        match self {
            Self::Elementary(surface) => surface.point([u, v]),
            Self::Spline(spline) => spline.at([u, v]).0,
            Self::Extrusion { curve, along } => curve.point(u) + v * *along,
            Self::Revolution { curve, origin, axis } => *origin + turned(curve.point(v) - *origin, *axis, u),
            Self::Offset { base, distance } => {
                let p = base.point([u, v]);
                base.normal([u, v]).map_or(p, |n| p + *distance * n)
            }
        }
    }

    /// The point at parameters and the derivatives along u and v. Those of elementary and offset surfaces are
    /// computed by differences.
    #[must_use]
    pub fn at(&self, [u, v]: [f64; 2]) -> (DVec3, [DVec3; 2]) {
        match self {
            Self::Spline(spline) => spline.at([u, v]),
            Self::Extrusion { curve, along } => {
                let (p, d) = curve.at(u);
                (p + v * *along, [d, *along])
            }
            Self::Revolution { curve, origin, axis } => {
                let (p, d) = curve.at(v);
                let arm = turned(p - *origin, *axis, u);
                (*origin + arm, [axis.cross(arm), turned(d, *axis, u)])
            }
            Self::Elementary(_) | Self::Offset { .. } => {
                let domain = self.domain();
                let slope = |k: usize| {
                    let [lo, hi] = domain[k].unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
                    // One-sided at the ends of the domain, beyond which an offset surface may not exist.
                    let h = match hi - lo {
                        width if width.is_finite() => 1e-6 * width,
                        _ => 1e-6,
                    };
                    let x = [u, v][k];
                    let ends = [(x - h).max(lo), (x + h).min(hi)].map(|x| {
                        let mut at = [u, v];
                        at[k] = x;
                        (x, self.point(at))
                    });
                    1.0 / (ends[1].0 - ends[0].0) * (ends[1].1 - ends[0].1)
                };
                (self.point([u, v]), [slope(0), slope(1)])
            }
        }
    }

    /// The unit normal `S_u × S_v`; at a pole, where a derivative vanishes, that of a point beside it.
    fn normal(&self, at: [f64; 2]) -> Option<DVec3> {
        // Nearly parallel derivatives give a normal that is only rounding, so they count as a pole, too.
        let normal_at = |at: [f64; 2]| {
            let (_, [u, v]) = self.at(at);
            u.cross(v)
                .try_normalize()
                .filter(|_| u.cross(v).length() > 1e-9 * (u.length_squared() + v.length_squared()))
        };
        let domain = self.domain();
        let inward = |k: usize| domain[k].map_or(at[k], |[lo, hi]| at[k] + 1e-5 * (0.5 * (lo + hi) - at[k]));
        normal_at(at).or_else(|| normal_at([inward(0), inward(1)]))
    }

    /// Period of each parameter; `None` if it is not periodic.
    #[must_use]
    pub fn periods(&self) -> [Option<f64>; 2] {
        match self {
            Self::Elementary(surface) => surface.periods(),
            Self::Spline(spline) => spline.periods(),
            Self::Extrusion { curve, .. } => [curve.period(), None],
            Self::Revolution { curve, .. } => [Some(TAU), curve.period()],
            Self::Offset { base, .. } => base.periods(),
        }
    }

    /// Range of each parameter; `None` if it is unbounded.
    #[must_use]
    pub fn domain(&self) -> [Option<[f64; 2]>; 2] {
        let domain_of = |curve: &ParametricCurve| match curve {
            ParametricCurve::Spline(spline) => Some(spline.domain()),
            ParametricCurve::Ellipse { .. } => Some(curve.domain()),
            _ => None,
        };
        match self {
            Self::Elementary(surface) => match surface {
                brep::FaceSurface::Plane { .. } => [None, None],
                brep::FaceSurface::Sphere { .. } => [Some([0.0, TAU]), Some([-FRAC_PI_2, FRAC_PI_2])],
                brep::FaceSurface::Torus { .. } => [Some([0.0, TAU]), Some([0.0, TAU])],
                _ => [Some([0.0, TAU]), None],
            },
            Self::Spline(spline) => spline.domain().map(Some),
            Self::Extrusion { curve, .. } => [domain_of(curve), None],
            Self::Revolution { curve, .. } => [Some([0.0, TAU]), domain_of(curve)],
            Self::Offset { base, .. } => base.domain(),
        }
    }

    /// Poles: those of a sphere, the apex of a cone, collapsed sides of a spline, and ends of a rotated
    /// spline on its axis.
    #[must_use]
    pub fn poles(&self) -> Vec<Pole> {
        // All values of the free parameter give the same point, so any value within the domain serves.
        let pole = |constant: usize, value: f64, is_low: bool| {
            let mut at = [0, 1].map(|k| self.domain()[k].map_or(0.0, |d| d[0]));
            at[constant] = value;
            Pole { constant, value, is_low, point: self.point(at) }
        };
        match self {
            Self::Elementary(brep::FaceSurface::Sphere { .. }) => {
                vec![pole(1, -FRAC_PI_2, true), pole(1, FRAC_PI_2, false)]
            }
            Self::Elementary(surface @ brep::FaceSurface::Cone { .. }) => {
                vec![pole(1, surface.range_v()[0], true)]
            }
            Self::Elementary(_) | Self::Extrusion { .. } => Vec::new(),
            Self::Spline(_) => self.collapsed_sides().map(|(k, x, low)| pole(k, x, low)).collect(),
            Self::Offset { base, .. } => {
                base.poles().into_iter().map(|p| pole(p.constant, p.value, p.is_low)).collect()
            }
            Self::Revolution { curve, origin, axis } => {
                let ParametricCurve::Spline(spline) = curve else {
                    // Rotated lines and circles that reach their axis are not supported.
                    return Vec::new();
                };
                let [lo, hi] = spline.domain();
                let size = curve.point(lo).distance(curve.point(0.5 * (lo + hi)));
                [(lo, true), (hi, false)]
                    .into_iter()
                    .filter(|(t, _)| {
                        let d = curve.point(*t) - *origin;
                        (d - d.dot(*axis) * *axis).length() <= CLOSED * size
                    })
                    .map(|(t, low)| pole(1, t, low))
                    .collect()
            }
        }
    }

    /// Sides of the domain that are points: the constant parameter, its value, and whether it is the lower
    /// end.
    fn collapsed_sides(&self) -> impl Iterator<Item = (usize, f64, bool)> {
        let domain = self.domain();
        let periods = self.periods();
        // The size is a distance to the middle of the surface: a corner may coincide with another corner.
        let size = match domain {
            [Some(u), Some(v)] => {
                self.point([u[0], v[0]]).distance(self.point([0.5 * (u[0] + u[1]), 0.5 * (v[0] + v[1])]))
            }
            _ => 0.0,
        };
        // A periodic parameter has no ends at which a side could collapse.
        (0..2)
            .filter_map(move |k| match (domain[k], domain[1 - k], periods[k]) {
                (Some(d), Some(across), None) => Some((k, d, across)),
                _ => None,
            })
            .flat_map(|(k, d, across)| [(k, d[0], true, across), (k, d[1], false, across)])
            .filter(move |(k, value, _, [lo, hi])| {
                let at = |share: f64| {
                    let mut at = [*value; 2];
                    at[1 - k] = lo + share * (hi - lo);
                    self.point(at)
                };
                let first = at(0.0);
                (1..=8).all(|i| first.distance(at(f64::from(i) / 8.0)) <= CLOSED * size)
            })
            .map(|(k, value, low, _)| (k, value, low))
            .collect::<Vec<_>>()
            .into_iter()
    }

    /// Name of the kind of surface.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Elementary(surface) => surface.kind(),
            Self::Spline(_) => "B-spline",
            Self::Extrusion { .. } => "extrusion",
            Self::Revolution { .. } => "revolution",
            Self::Offset { .. } => "offset surface",
        }
    }

    /// True for a plane, where triangles in parameters are exact.
    pub(super) fn is_plane(&self) -> bool {
        matches!(self, Self::Elementary(brep::FaceSurface::Plane { .. }))
    }

    /// Values of one parameter at which pieces meet, within its domain.
    pub(super) fn breaks(&self, direction: usize) -> Vec<f64> {
        match (self, direction) {
            (Self::Spline(spline), k) => spline.breaks(k),
            (Self::Extrusion { curve, .. }, 0) | (Self::Revolution { curve, .. }, 1) => {
                curve.breaks(curve.domain())
            }
            (Self::Offset { base, .. }, k) => base.breaks(k),
            _ => Vec::new(),
        }
    }
}

/// Computes foot points of many points on one surface.
pub(super) struct Feet<'a> {
    surface: &'a ParametricSurface,
    periods: [Option<f64>; 2],
    /// Samples of a spline, row by row: parameters and points. Made when the first search needs them.
    places: Vec<([f64; 2], DVec3)>,
    /// Number of samples in a row.
    row: usize,
}

impl<'a> Feet<'a> {
    pub(super) fn surface(&self) -> &ParametricSurface {
        self.surface
    }

    pub(super) fn new(surface: &'a ParametricSurface) -> Self {
        Self { surface, periods: surface.periods(), places: Vec::new(), row: 0 }
    }

    /// Parameters of the point nearest to `p`. A foot near `guess` is accepted if it is within `close`.
    ///
    /// The foot on an offset surface is that on its base, since both have the same normals.
    pub(super) fn foot(&mut self, p: DVec3, guess: Option<[f64; 2]>, close: f64) -> [f64; 2] {
        let mut base = self.surface;
        while let ParametricSurface::Offset { base: inner, .. } = base {
            base = inner;
        }
        match base {
            ParametricSurface::Elementary(surface) => elementary(surface, p),
            ParametricSurface::Extrusion { curve, along } => {
                let n = along.try_normalize().unwrap_or(DVec3::Z);
                // Projected along the direction of extrusion, the surface is the curve.
                let across = |d: DVec3| d - d.dot(n) * n;
                let u = curve.nearest(&|q| across(q - p), &across, guess.map(|g| g[0]));
                let v = (p - curve.point(u)).dot(*along) / along.length_squared().max(f64::MIN_POSITIVE);
                [u, v]
            }
            ParametricSurface::Revolution { curve, origin, axis } => {
                // In the plane of radius and height, the surface is its profile.
                let place = |q: DVec3| {
                    let d = q - *origin;
                    let h = d.dot(*axis);
                    [(d - h * *axis).length(), h]
                };
                let [r, h] = place(p);
                let residual = |q: DVec3| {
                    let [a, b] = place(q);
                    DVec3::new(a - r, b - h, 0.0)
                };
                let v = on_profile(curve, &residual, guess.map(|g| g[1]));
                let u = angle_between(curve.point(v) - *origin, p - *origin, *axis);
                [u, v]
            }
            ParametricSurface::Spline(_) | ParametricSurface::Offset { .. } => {
                self.on_spline(base, p, guess, close)
            }
        }
    }

    /// Foot on a spline: from the guess if it is close enough, else from samples as well: the nearest, and
    /// those that are nearer than all beside them.
    ///
    /// The nearest samples may all belong to another part of a folded or thin surface.
    fn on_spline(
        &mut self,
        surface: &ParametricSurface,
        p: DVec3,
        guess: Option<[f64; 2]>,
        close: f64,
    ) -> [f64; 2] {
        // Along a loop, the previous foot is nearly always close, and the samples are never made.
        let near = guess.map(|g| foot(surface, p, g, &self.periods));
        if let Some((off, at)) = near
            && off <= close
        {
            return at;
        }
        if self.places.is_empty() {
            (self.places, self.row) = places(surface);
        }
        let away: Vec<f64> = self.places.iter().map(|(_, q)| p.distance(*q)).collect();
        let nearest = |mut starts: Vec<usize>, few: usize| {
            let few = starts.len().min(few);
            // A selection instead of a sort: there are up to 25,921 samples.
            if few > 0 {
                starts.select_nth_unstable_by(few - 1, |a, b| away[*a].total_cmp(&away[*b]));
            }
            starts.truncate(few);
            starts
        };
        let mut starts = nearest((0..away.len()).collect(), NEAREST_STARTS);
        starts.extend(nearest(local_minima(&away, self.row), MINIMA_STARTS));
        starts.sort_unstable();
        starts.dedup();
        let found = starts.iter().map(|k| foot(surface, p, self.places[*k].0, &self.periods));
        let best = found.chain(near).min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or([0.0; 2], |(_, at)| at)
    }
}

/// Parameters of a point on an elementary surface, including parts that have crossed its axis: beyond the
/// apex of a cone, and the inner part of a torus whose minor radius exceeds the major one.
fn elementary(surface: &brep::FaceSurface, p: DVec3) -> [f64; 2] {
    let [u, v] = surface.parameters(p);
    let beyond = match *surface {
        brep::FaceSurface::Cone { .. } => (v < surface.range_v()[0]).then_some([u + PI, v]),
        brep::FaceSurface::Torus { center, axis, major, minor, .. } if minor > major => {
            let d = p - center;
            let h = d.dot(axis);
            let across = (d - h * axis).length();
            Some([u + PI, h.atan2(-across - major)])
        }
        _ => None,
    };
    let off = |at: [f64; 2]| p.distance(surface.point(at));
    beyond.filter(|b| off(*b) < off([u, v])).unwrap_or([u, v])
}

/// The parameter of a rotated curve at which the residual in radius and height is shortest, by Gauss–Newton
/// steps from the best starting points.
///
/// Derivatives are differences, because the radius has no derivative on the axis.
fn on_profile(curve: &ParametricCurve, residual: &dyn Fn(DVec3) -> DVec3, guess: Option<f64>) -> f64 {
    let mut best = (f64::MAX, 0.0);
    let ends = match curve {
        ParametricCurve::Line { .. } => {
            // The radius along a line is a hyperbola, so there may be two points of equal radius. Starts on
            // both sides find both.
            vec![guess.unwrap_or(0.0), -1.0, 1.0]
        }
        _ => {
            let [lo, hi] = curve.domain();
            let n = 8 * curve.breaks([lo, hi]).len();
            guess.into_iter().chain((0..=n).map(|k| lo + (hi - lo) * k as f64 / n as f64)).collect()
        }
    };
    let square = |t: f64| {
        let r = residual(curve.point(t));
        r.length_squared()
    };
    let mut order: Vec<(f64, f64)> = ends.into_iter().map(|t| (square(t), t)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [lo, hi] = match (curve, curve.period()) {
        (ParametricCurve::Spline(spline), None) => spline.domain(),
        _ => [f64::NEG_INFINITY, f64::INFINITY],
    };
    for (_, start) in order.into_iter().take(4) {
        let mut t = start;
        let mut value = square(t);
        for _ in 0..40 {
            // A step of 1e-6 balances truncation and rounding of the difference for parameters near 1.
            let h = 1e-6 * (1.0 + t.abs());
            let (a, b) = ((t - h).max(lo), (t + h).min(hi));
            let r = residual(curve.point(t));
            let d = 1.0 / (b - a) * (residual(curve.point(b)) - residual(curve.point(a)));
            let mut step = -r.dot(d) / d.length_squared().max(f64::MIN_POSITIVE);
            let mut next = (t + step).clamp(lo, hi);
            for _ in 0..30 {
                if square(next) <= value {
                    break;
                }
                step *= 0.5;
                next = (t + step).clamp(lo, hi);
            }
            let better = square(next);
            if better >= value {
                break;
            }
            let is_still = (next - t).abs() <= 1e-14 * (1.0 + t.abs());
            (t, value) = (next, better);
            if is_still {
                break;
            }
        }
        if value < best.0 {
            best = (value, t);
        }
    }
    best.1
}

/// The samples in rows of `row` whose distances are smaller than those of all samples beside them. Of equal
/// ones, as at a pole, the last.
fn local_minima(away: &[f64], row: usize) -> Vec<usize> {
    let rows = away.len() / row.max(1);
    let is_minimum = |k: &usize| {
        let (i, j) = (k / row, k % row);
        (i.saturating_sub(1)..(i + 2).min(rows)).all(|i| {
            (j.saturating_sub(1)..(j + 2).min(row)).all(|j| {
                let other = i * row + j;
                away[*k] < away[other] || (away[*k] == away[other] && *k >= other)
            })
        })
    };
    (0..away.len()).filter(is_minimum).collect()
}

/// Samples of a spline, and the number in a row.
fn places(surface: &ParametricSurface) -> (Vec<([f64; 2], DVec3)>, usize) {
    let ParametricSurface::Spline(spline) = surface else {
        return (Vec::new(), 0);
    };
    let lines = [0, 1].map(|k| {
        let breaks = spline.breaks(k);
        let wanted = (breaks.len() - 1) * 2 * spline.degrees()[k];
        let [lo, hi] = spline.domain()[k];
        let n = wanted.clamp(4, MAX_PLACES);
        (0..=n).map(|i| lo + (hi - lo) * i as f64 / n as f64).collect::<Vec<f64>>()
    });
    let mut found = Vec::with_capacity(lines[0].len() * lines[1].len());
    for u in &lines[0] {
        for v in &lines[1] {
            found.push(([*u, *v], spline.at([*u, *v]).0));
        }
    }
    (found, lines[1].len())
}

/// The foot of a point near given parameters, by damped Gauss–Newton (Levenberg–Marquardt) steps: its
/// distance and its parameters.
fn foot(
    surface: &ParametricSurface,
    p: DVec3,
    start: [f64; 2],
    periods: &[Option<f64>; 2],
) -> (f64, [f64; 2]) {
    let domain = surface.domain();
    // Clamped to the domain, so the foot of a point beyond a side is on that side. Periodic parameters are
    // not clamped, or steps could not cross the seam.
    let inside = |at: [f64; 2]| {
        [0, 1].map(|k| match (periods[k], domain[k]) {
            (None, Some([lo, hi])) => at[k].clamp(lo, hi),
            _ => at[k],
        })
    };
    let mut at = inside(start);
    let (mut q, mut slopes) = surface.at(at);
    let mut value = p.distance(q);
    let mut damping = 1e-9;
    for _ in 0..60 {
        let r = p - q;
        let [a, b] = slopes;
        let (aa, ab, bb) = (a.length_squared(), a.dot(b), b.length_squared());
        let (m, n) = (aa * (1.0 + damping) + 1e-300, bb * (1.0 + damping) + 1e-300);
        let determinant = m * n - ab * ab;
        // Where both derivatives are nearly parallel, as near a pole, the system is singular. Half of the
        // gradient step in each parameter is used there.
        let (x, y) = (r.dot(a), r.dot(b));
        let step = match determinant > 1e-14 * m * n {
            true => [(x * n - y * ab) / determinant, (y * m - x * ab) / determinant],
            false => [x / (2.0 * m), y / (2.0 * n)],
        };
        let next = inside([at[0] + step[0], at[1] + step[1]]);
        let moved = [0, 1].map(|k| (next[k] - at[k]).abs());
        let (to, to_slopes) = surface.at(next);
        let off = p.distance(to);
        // Converged if the last step moved the point by rounding only, measured in space: lengths of
        // parameters are arbitrary. A worse step is repeated with more damping.
        if off <= value {
            let is_still = moved[0] * aa.sqrt() + moved[1] * bb.sqrt() <= 1e-13 * (1.0 + q.length());
            (at, q, slopes, value) = (next, to, to_slopes, off);
            damping = (damping * 0.1).max(1e-12);
            if is_still {
                break;
            }
        } else {
            damping = (damping * 10.0).max(1e-6);
            if damping > 1e8 {
                break;
            }
        }
    }
    (value, at)
}
