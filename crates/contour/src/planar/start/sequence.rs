//! Points put in the order in which they lie on an outline, and sums over runs of them.

use super::super::parts::usual_gap;
use super::super::reading::{ContourReading, ContourTarget};
use super::{circle, mean};
use planish_core::BoundingBox;

/// Points are put into at most so many bins: tables over runs have the square of it.
const MAX_BINS: usize = 120;
/// So many places each way are tried to look around from.
const GRID: usize = 6;

/// Sums over points: number, coordinates, their products to fourth order about the sequence's middle, and
/// covariances.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums([f64; 13]);

impl Sums {
    fn add(&mut self, p: [f64; 2], covariance: [f64; 3]) {
        let [x, y] = p;
        let z = x * x + y * y;
        let [xx, xy, yy] = covariance;
        let values = [1.0, x, y, x * x, x * y, y * y, x * z, y * z, z * z, z, xx, xy, yy];
        for (sum, value) in self.0.iter_mut().zip(values) {
            *sum += value;
        }
    }

    fn minus(&self, other: &Self) -> Self {
        let mut rest = *self;
        for (sum, value) in rest.0.iter_mut().zip(other.0) {
            *sum -= value;
        }
        rest
    }

    fn plus(&self, other: &Self) -> Self {
        let mut both = *self;
        for (sum, value) in both.0.iter_mut().zip(other.0) {
            *sum += value;
        }
        both
    }

    pub(super) fn count(&self) -> f64 {
        self.0[0]
    }

    fn variance_along(&self, n: [f64; 2]) -> f64 {
        let [xx, xy, yy] = [self.0[10], self.0[11], self.0[12]].map(|c| c / self.count());
        (n[0] * n[0] * xx + 2.0 * n[0] * n[1] * xy + n[1] * n[1] * yy).max(f64::MIN_POSITIVE)
    }

    /// The line of least squares `(normal, offset)` and its squared residuals over their variance.
    pub(super) fn line(&self) -> ([f64; 2], f64, f64) {
        let m = self.count();
        let c = [self.0[1] / m, self.0[2] / m];
        let (xx, xy, yy) =
            (self.0[3] - m * c[0] * c[0], self.0[4] - m * c[0] * c[1], self.0[5] - m * c[1] * c[1]);
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let normal = [-angle.sin(), angle.cos()];
        let left = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let offset = normal[0] * c[0] + normal[1] * c[1];
        (normal, offset, left.max(0.0) / self.variance_along(normal))
    }

    /// Squared residuals of Kåsa's circle over their variance, in units of a point of its middle.
    pub(super) fn arc(&self) -> f64 {
        let m = self.count();
        if m < 5.0 {
            return f64::INFINITY;
        }
        let c = [self.0[1] / m, self.0[2] / m];
        let z = self.0[9] / m;
        let xx = self.0[3] / m - c[0] * c[0];
        let xy = self.0[4] / m - c[0] * c[1];
        let yy = self.0[5] / m - c[1] * c[1];
        let xz = self.0[6] / m - c[0] * z;
        let yz = self.0[7] / m - c[1] * z;
        let zz = self.0[8] / m - z * z;
        let determinant = xx * yy - xy * xy;
        if determinant <= 1e-12 * (xx + yy) * (xx + yy) {
            return f64::INFINITY;
        }
        let b = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
        let left = (zz - b[0] * xz - b[1] * yz).max(0.0) * m;
        let center = [0.5 * b[0], 0.5 * b[1]];
        let squared = z - b[0] * c[0] - b[1] * c[1] + center[0] * center[0] + center[1] * center[1];
        if squared <= 0.0 {
            return f64::INFINITY;
        }
        let towards = [c[0] - center[0], c[1] - center[1]];
        let length = towards[0].hypot(towards[1]);
        if length <= 0.0 {
            return f64::INFINITY;
        }
        left / (4.0 * squared * self.variance_along([towards[0] / length, towards[1] / length]))
    }
}

/// Points in the order in which they lie on an outline.
pub(super) struct Sequence {
    pub(super) origin: [f64; 2],
    pub(super) points: Vec<[f64; 2]>,
    /// Sums of each bin, of two rounds, cumulated.
    cumulated: Vec<Sums>,
    pub(super) bins: usize,
    /// The first point of each bin.
    pub(super) first: Vec<usize>,
    /// Whether the last point is followed by the first.
    pub(super) is_closed: bool,
}

impl Sequence {
    /// Ordered by direction from the middle, or from that place among the points from which the way around is
    /// shortest: within an outline that is bent inwards there is often a place that sees all of it. Where the
    /// file's own order is shorter, that is kept.
    pub(super) fn closed(sightings: &[ContourReading]) -> Self {
        let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
        let origin = middle(&points);
        let mut best = around(&points, origin);
        for from in places(&points) {
            let one = around(&points, from);
            if one.0 < 0.9 * best.0 {
                best = one;
            }
        }
        let filed: Vec<usize> = (0..points.len()).collect();
        let mut order = if way(&points, &filed) < 0.95 * best.0 { filed } else { best.1 };
        let area: f64 = (0..order.len())
            .map(|k| {
                let (a, b) = (points[order[k]], points[order[(k + 1) % order.len()]]);
                a[0] * b[1] - a[1] * b[0]
            })
            .sum();
        if area < 0.0 {
            order.reverse();
        }
        Self::new(sightings, &points, &order, origin, true)
    }

    /// From one end to the other, the one with the least y (then x) first; `None` where the ends are so near
    /// to each other that the outline may be closed.
    ///
    /// The order is that of the file, or the directions from where the sensor was on average, from far away
    /// on either side, or from places among the points, cut at the widest step: whichever is the shortest
    /// way.
    pub(super) fn open(sightings: &[ContourReading]) -> Option<Self> {
        let points: Vec<[f64; 2]> = sightings.iter().map(ContourReading::point).collect();
        let origin = middle(&points);
        let cut = |(length, mut order): (f64, Vec<usize>)| {
            let count = order.len();
            let step = |k: usize| {
                let (a, b) = (points[order[k]], points[order[(k + 1) % count]]);
                (a[0] - b[0]).hypot(a[1] - b[1])
            };
            let widest = (0..count).max_by(|&a, &b| step(a).total_cmp(&step(b))).unwrap_or(0);
            let gap = step(widest);
            order.rotate_left((widest + 1) % count);
            (length - gap, gap, order)
        };
        let sensors: Vec<[f64; 2]> = (sightings.iter())
            .filter_map(|s| match s.target {
                ContourTarget::Range { origin, .. } => Some(origin),
                ContourTarget::Point { .. } => None,
            })
            .collect();
        let center = mean(&points);
        let reach =
            1e3 * points.iter().map(|p| (p[0] - center[0]).hypot(p[1] - center[1])).fold(0.0, f64::max);
        let angle = super::line(&points)[0];
        let far = [-1.0, 1.0]
            .map(|side| [center[0] - side * reach * angle.sin(), center[1] + side * reach * angle.cos()]);
        let seen_from = (!sensors.is_empty()).then(|| mean(&sensors));
        let filed: Vec<usize> = (0..points.len()).collect();
        let mut best = cut((way(&points, &filed), filed));
        for from in seen_from.into_iter().chain(far).chain([origin]).chain(places(&points)) {
            let one = cut(around(&points, from));
            if one.0 < best.0 {
                best = one;
            }
        }
        let (_, gap, mut order) = best;
        if gap <= usual_gap(sightings) {
            return None;
        }
        let (first, last) = (points[*order.first()?], points[*order.last()?]);
        if (last[1], last[0]) < (first[1], first[0]) {
            order.reverse();
        }
        Some(Self::new(sightings, &points, &order, origin, false))
    }

    fn new(
        sightings: &[ContourReading],
        points: &[[f64; 2]],
        order: &[usize],
        origin: [f64; 2],
        is_closed: bool,
    ) -> Self {
        let count = order.len();
        let bins = count.min(MAX_BINS);
        let first: Vec<usize> = (0..bins).map(|b| b * count / bins).collect();
        let mut each = vec![Sums::default(); bins];
        for (b, sums) in each.iter_mut().enumerate() {
            let end = if b + 1 < bins { first[b + 1] } else { count };
            for &i in &order[first[b]..end] {
                let p = [points[i][0] - origin[0], points[i][1] - origin[1]];
                sums.add(p, sightings[i].covariance());
            }
        }
        let mut cumulated = vec![Sums::default()];
        for k in 0..2 * bins {
            cumulated.push(cumulated[k].plus(&each[k % bins]));
        }
        Self { origin, points: order.iter().map(|&i| points[i]).collect(), cumulated, bins, first, is_closed }
    }

    /// Sums over the bins from one to before another, which may be of the next round.
    pub(super) fn sums(&self, from: usize, to: usize) -> Sums {
        self.cumulated[to].minus(&self.cumulated[from])
    }

    pub(super) fn count(&self) -> usize {
        self.points.len()
    }
}

/// The middle of the circle about the points, or their mean where that is far away: they are nearly straight
/// then.
fn middle(points: &[[f64; 2]]) -> [f64; 2] {
    let m = mean(points);
    circle(points).map_or(m, |c| if (c[0] - m[0]).hypot(c[1] - m[1]) < c[2] { [c[0], c[1]] } else { m })
}

/// The length of the closed way through the points in an order.
fn way(points: &[[f64; 2]], order: &[usize]) -> f64 {
    let step = |k: usize| {
        let (a, b) = (points[order[k]], points[order[(k + 1) % order.len()]]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    (0..order.len()).map(step).sum()
}

/// The points by their direction from a place, and the length of the way.
fn around(points: &[[f64; 2]], from: [f64; 2]) -> (f64, Vec<usize>) {
    let mut turns: Vec<(f64, usize)> =
        (points.iter().enumerate()).map(|(i, p)| ((p[1] - from[1]).atan2(p[0] - from[0]), i)).collect();
    turns.sort_by(|a, b| a.0.total_cmp(&b.0));
    let order: Vec<usize> = turns.into_iter().map(|(_, i)| i).collect();
    (way(points, &order), order)
}

/// A grid of places within the points' box.
fn places(points: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let bounds: BoundingBox<2> = points.iter().copied().collect();
    let (low, sides) = (bounds.min, bounds.extent());
    (0..GRID * GRID).map(move |k| {
        let share = |i: usize| (i as f64 + 0.5) / GRID as f64;
        [low[0] + share(k % GRID) * sides[0], low[1] + share(k / GRID) * sides[1]]
    })
}
