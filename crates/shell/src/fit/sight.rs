//! The nearest points of a line of sight to a shell: the minima of `D(o + t d)` over `t`.
//!
//! In: a line, the shell, and a search structure of the same mesh. Out: points with `D` and `∇D`.
//!
//! If normals point outwards, `D` is negative inside. The minimum over the line is positive if the line
//! misses, negative if it hits, and zero if it touches, which is the outline. The search covers the line from
//! the first hit to the last, or the whole line without hits. It uses the distance from the mesh, which is
//! 1-Lipschitz in `t`: intervals that cannot contain the minimum are skipped by branch and bound. The minimum
//! of `D` itself is then found from the sign of its slope.
//!
//! A line that touches one part and hits another behind it has several minima. [`Sight::minima`] returns all
//! of them, and the residuals select one.
//!
//! Not guaranteed: minima closer together than the stated width are merged.

use crate::field::{FacetShare, Shell, ShellDistance};
use planish_core::DVec3;
use planish_mesh::{BoundingBox, ClosestPoint, MeshSearch, RayHit};

/// Initial intervals of a line. More cost distance queries on every line; fewer leave more to the bounds.
const PIECES: usize = 8;
/// Intervals in which all minima of a line are searched.
const FINE_PIECES: usize = 64;
/// Resolution of minima: the mesh's size divided by this. Finer resolution needs more distance queries.
const RESOLUTION: f64 = 150.0;
/// Maximum number of distance queries on one line. It limits the time of lines that run along the surface,
/// where all bounds are similar.
const MAX_QUERIES: usize = 120;
/// Slope of `D` along the line below which a point is a minimum. The error of the minimum is half the square
/// of the slope divided by the curvature.
const SLOPE: f64 = 1e-3;
/// Maximum number of doublings of an interval that does not bracket the minimum.
const MAX_DOUBLINGS: u32 = 5;
/// The golden ratio's inverse.
const GOLDEN: f64 = 0.618_033_988_749_894_9;
/// Maximum number of steps towards a minimum.
const MAX_STEPS: usize = 24;

/// A point where a line of sight is nearest to the shell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Touch {
    pub at: DVec3,
    /// `D` there.
    pub distance: f64,
    /// `∇D` there.
    pub gradient: DVec3,
    pub source: DistanceSource,
}

/// The source of a distance, from which its derivatives are computed.
#[derive(Debug, Clone, Copy)]
pub(super) enum DistanceSource {
    /// The shell at the point, or on either side of it if the slope of `D` jumps: position, distance and
    /// share of each.
    Shell([(DVec3, ShellDistance, f64); 2]),
    /// One foot point on the mesh: beyond boundaries and at sharp edges, where heights over planes are not
    /// distances.
    Foot(ClosestPoint),
}

/// A shell, prepared for queries by lines of sight.
pub(super) struct Sight<'a> {
    pub shell: &'a Shell<'a>,
    pub search: &'a MeshSearch,
    center: DVec3,
    radius: f64,
    /// Minimum length of an interval.
    width: f64,
    softness: f64,
}

impl<'a> Sight<'a> {
    pub(super) fn new(
        shell: &'a Shell<'a>,
        search: &'a MeshSearch,
        bounds: &BoundingBox,
        softness: f64,
    ) -> Self {
        let diagonal = bounds.diagonal();
        Self {
            shell,
            search,
            center: bounds.center(),
            // The ball around the bounding box, slightly enlarged for rounding.
            radius: 0.51 * diagonal,
            width: softness.max(diagonal / RESOLUTION),
            softness,
        }
    }

    /// The range of `t ≥ 0` in which a line may be near the mesh.
    fn span(&self, origin: DVec3, direction: DVec3) -> (f64, f64) {
        let middle = (self.center - origin).dot(direction);
        let away = (origin + middle * direction - self.center).length();
        let half = (self.radius * self.radius - away * away).max(0.04 * self.radius * self.radius).sqrt();
        ((middle - half).max(0.0), (middle + half).max(self.width))
    }

    fn height(&self, at: DVec3, signs: bool) -> f64 {
        (self.search.closest(at)).map_or(f64::INFINITY, |foot| height_of(&foot, signs))
    }

    /// The hit farthest from the origin.
    pub(super) fn last_hit(&self, origin: DVec3, direction: DVec3) -> Option<RayHit> {
        let beyond = (self.center - origin).length() + 2.0 * self.radius;
        let back = (self.search).first_hit(origin + beyond * direction, -direction)?;
        Some(RayHit { distance: beyond - back.distance, ..back })
    }

    /// The range of a line that contains its minimum, and whether distances have a sign there. Signs are used
    /// only between the first hit and the last, because an open mesh has no inside far away.
    fn within(&self, origin: DVec3, direction: DVec3) -> ((f64, f64), bool) {
        let Some(first) = self.search.first_hit(origin, direction) else {
            return (self.span(origin, direction), false);
        };
        let last = (self.last_hit(origin, direction)).map_or(first.distance, |hit| hit.distance);
        let from = (first.distance - self.width).max(0.0);
        ((from, last.max(first.distance) + self.width), true)
    }

    /// The minimum of `D` on a line; `None` if no value is finite.
    pub(super) fn minimum(
        &self,
        origin: DVec3,
        direction: DVec3,
        shares: &mut Vec<FacetShare>,
    ) -> Option<Touch> {
        let ((from, to), signs) = self.within(origin, direction);
        let along = |t: f64| self.height(origin + t * direction, signs);
        // Lower bound over an interval from the values at its ends, as the distance is 1-Lipschitz.
        let bound = |a: f64, b: f64, at_a: f64, at_b: f64| 0.5 * (at_a + at_b - (b - a));
        let mut open: Vec<[f64; 5]> = Vec::with_capacity(32);
        let mut best = (f64::INFINITY, from);
        // A coarse scan first: a good minimum early on excludes most intervals by their bounds.
        let mut last = (from, along(from));
        for k in 1..=PIECES {
            let t = from + (to - from) * k as f64 / PIECES as f64;
            let distance = along(t);
            for (t, d) in [last, (t, distance)] {
                if d < best.0 {
                    best = (d, t);
                }
            }
            open.push([bound(last.0, t, last.1, distance), last.0, t, last.1, distance]);
            last = (t, distance);
        }
        let mut queries = PIECES + 1;
        while queries < MAX_QUERIES {
            let Some(next) = (0..open.len()).min_by(|&i, &j| open[i][0].total_cmp(&open[j][0])) else {
                break;
            };
            let [lower, a, b, at_a, at_b] = open.swap_remove(next);
            // The interval with the smallest bound comes first (branch and bound). If even that cannot
            // contain a lower minimum, none can.
            if lower >= best.0 - 0.1 * self.width {
                break;
            }
            if b - a <= self.width {
                continue;
            }
            let middle = 0.5 * (a + b);
            let distance = along(middle);
            queries += 1;
            if distance < best.0 {
                best = (distance, middle);
            }
            open.push([bound(a, middle, at_a, distance), a, middle, at_a, distance]);
            open.push([bound(middle, b, distance, at_b), middle, b, distance, at_b]);
        }
        best.0.is_finite().then_some(())?;
        self.refined(origin, direction, (best.1, self.width), signs, shares)
    }

    /// All minima of `D` on a line.
    pub(super) fn minima(&self, origin: DVec3, direction: DVec3, shares: &mut Vec<FacetShare>) -> Vec<Touch> {
        let (from, to) = self.span(origin, direction);
        let step = (to - from) / FINE_PIECES as f64;
        let heights: Vec<f64> = (0..=FINE_PIECES)
            .map(|k| self.height(origin + (from + step * k as f64) * direction, true))
            .collect();
        (0..=FINE_PIECES)
            .filter(|&k| {
                let before = k.checked_sub(1).map_or(f64::INFINITY, |k| heights[k]);
                let after = heights.get(k + 1).copied().unwrap_or(f64::INFINITY);
                heights[k].is_finite() && heights[k] < before && heights[k] <= after
            })
            .filter_map(|k| self.refined(origin, direction, (from + step * k as f64, step), true, shares))
            .collect()
    }

    /// The minimum of `D` within `reach` of a position on a line.
    fn refined(
        &self,
        origin: DVec3,
        direction: DVec3,
        (near, reach): (f64, f64),
        signs: bool,
        shares: &mut Vec<FacetShare>,
    ) -> Option<Touch> {
        let mut evaluate = |t: f64| {
            let at = origin + t * direction;
            let found = self.shell.distance(at, shares)?;
            Some((t, found.gradient.dot(direction), found))
        };
        let (mut low, mut high) = (evaluate((near - reach).max(0.0))?, evaluate(near + reach)?);
        let mut best = evaluate(near)?;
        // The minimum of a soft shell may differ from that of the mesh, so the bracket moves downhill in
        // growing steps.
        for double in 0..MAX_DOUBLINGS {
            let step = reach * f64::from(1_u32 << double);
            if low.1 >= 0.0 && low.0 > 0.0 && low.2.distance <= best.2.distance {
                (high, best) = (best, low);
                low = evaluate((best.0 - step).max(0.0))?;
            } else if high.1 <= 0.0 && high.2.distance <= best.2.distance {
                (low, best) = (best, high);
                high = evaluate(best.0 + step)?;
            } else {
                break;
            }
        }
        let bracketed = low.1 < 0.0 && high.1 > 0.0;
        if bracketed {
            // The slope changes its sign in the bracket: secant steps, alternating with bisection in case the
            // slope jumps.
            for step in 0..MAX_STEPS {
                if best.1 < 0.0 {
                    low = best
                } else {
                    high = best
                }
                let width = high.0 - low.0;
                if best.1.abs() < SLOPE || width < 1e-3 * self.softness {
                    break;
                }
                // Regula falsi alternates with bisection: the first is fast where the slope is smooth, the
                // second bounds the number of steps at kinks.
                let share = -low.1 / (high.1 - low.1);
                let t = if step % 2 == 1 {
                    0.5 * (low.0 + high.0)
                } else {
                    low.0 + share.clamp(0.02, 0.98) * width
                };
                best = evaluate(t)?;
            }
        } else {
            for other in [low, high] {
                if other.2.distance < best.2.distance {
                    best = other;
                }
            }
        }
        // If the slope jumps through zero, the minimum moves with the kink. Its derivative is the mean of
        // both sides whose slope along the line is zero.
        let share = if bracketed && best.1.abs() >= SLOPE && high.0 - low.0 < 0.01 * self.softness {
            high.1 / (high.1 - low.1)
        } else {
            low = best;
            1.0
        };
        let at = origin + best.0 * direction;
        let found = best.2;
        let foot = self.search.closest(at)?;
        let sharp = height_of(&foot, signs);
        // Far from an open mesh, heights over planes decrease without bound and may lead away from the
        // object.
        let nearest = self.height(origin + near * direction, signs);
        let implausible = (found.distance - sharp).abs() > 2.0 * self.softness + 0.5 * sharp.abs()
            || sharp > nearest + 2.0 * self.softness;
        if foot.on_boundary || implausible {
            return self.sharp_minimum(origin, direction, (near, reach), signs);
        }
        let sides = [(low, share), (high, 1.0 - share)];
        Some(Touch {
            at,
            distance: found.distance,
            gradient: (sides.iter()).fold(DVec3::ZERO, |sum, (side, share)| sum + *share * side.2.gradient),
            source: DistanceSource::Shell(
                sides.map(|(side, share)| (origin + side.0 * direction, side.2, share)),
            ),
        })
    }

    /// The minimum of the mesh's signed distance within `reach` of a position on a line, by golden section.
    fn sharp_minimum(
        &self,
        origin: DVec3,
        direction: DVec3,
        (near, reach): (f64, f64),
        signs: bool,
    ) -> Option<Touch> {
        let along = |t: f64| self.height(origin + t * direction, signs);
        let (mut low, mut high) = ((near - reach).max(0.0), near + reach);
        let mut best = (along(near), near);
        let inner = |low: f64, high: f64| [GOLDEN, 1.0 - GOLDEN].map(|share| high - share * (high - low));
        let mut at = inner(low, high);
        let mut distances = at.map(along);
        while high - low > 1e-2 * self.softness {
            for (d, t) in distances.into_iter().zip(at) {
                if d < best.0 {
                    best = (d, t);
                }
            }
            if distances[0] < distances[1] {
                high = at[1];
                at = inner(low, high);
                // The golden section reuses one of two inner points, so each step costs one query.
                distances = [along(at[0]), distances[0]];
            } else {
                low = at[0];
                at = inner(low, high);
                distances = [distances[1], along(at[1])];
            }
        }
        let at = origin + best.1 * direction;
        let foot = self.search.closest(at)?;
        let distance = height_of(&foot, signs);
        Some(Touch {
            at,
            distance,
            gradient: if foot.distance > 0.0 { 1.0 / distance * (at - foot.point) } else { foot.normal },
            source: DistanceSource::Foot(foot),
        })
    }
}

/// The distance from the mesh, signed if `signs` is set and the foot point is not on a boundary, where a mesh
/// has no sides.
fn height_of(foot: &ClosestPoint, signs: bool) -> f64 {
    if signs && !foot.on_boundary { foot.signed_distance } else { foot.distance }
}
