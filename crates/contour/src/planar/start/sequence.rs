//! Order of points along an outline, and sums over runs of them.
//!
//! In: readings in any order. Out: a [`Sequence`] whose runs of bins can be fitted by a line or an arc in
//! constant time, which the dynamic program needs. Not guaranteed: the right order for outlines that cross
//! themselves or come near themselves.

use super::super::parts::typical_gap;
use super::super::reading::{ContourReading, ContourTarget};
use super::{circle, mean, tour};
use planish_core::BoundingBox;

/// Maximum number of bins of a sequence. The tables over runs grow with its square, and the resolution of
/// cuts with it.
const MAX_BINS: usize = 120;
/// Maximum number of readings of a general tour, whose cost grows with its square.
const MAX_TOUR: usize = 240;
/// A general tour is used only if it is shorter than the others by this factor: noise alone makes it slightly
/// shorter.
const CLEARLY_SHORTER: f64 = 0.97;
/// Number of view points per axis from which an order by direction is tried.
const GRID: usize = 6;

/// Sums over points: number, moments up to fourth order about the centre of the sequence, and covariances.
///
/// Moments about a distant origin would lose the residuals to cancellation.
#[derive(Debug, Clone, Copy, Default)]
pub(in super::super) struct Sums([f64; 13]);

impl Sums {
    pub(in super::super) fn add(&mut self, p: [f64; 2], covariance: [f64; 3]) {
        let [x, y] = p;
        let z = x * x + y * y;
        let [xx, xy, yy] = covariance;
        let values = [1.0, x, y, x * x, x * y, y * y, x * z, y * z, z * z, z, xx, xy, yy];
        for (sum, value) in self.0.iter_mut().zip(values) {
            *sum += value;
        }
    }

    pub(in super::super) fn minus(&self, other: &Self) -> Self {
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

    /// Line of total least squares as `(normal, offset)`, and its sum of squared residuals divided by their
    /// variance.
    pub(in super::super) fn line(&self) -> ([f64; 2], f64, f64) {
        let m = self.count();
        let c = [self.0[1] / m, self.0[2] / m];
        let (xx, xy, yy) =
            (self.0[3] - m * c[0] * c[0], self.0[4] - m * c[0] * c[1], self.0[5] - m * c[1] * c[1]);
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let normal = [-angle.sin(), angle.cos()];
        // The smaller eigenvalue of the scatter matrix is the sum of squared distances.
        let left = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let offset = normal[0] * c[0] + normal[1] * c[1];
        (normal, offset, left.max(0.0) / self.variance_along(normal))
    }

    /// Sum of squared residuals of Kåsa's circle divided by their variance.
    ///
    /// Kåsa's fit is linear, so that sums suffice. Its bias does not matter for a comparison of
    /// segmentations.
    pub(super) fn arc(&self) -> f64 {
        let m = self.count();
        // A circle through so few points has almost no residuals.
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
        // Collinear points have no circle; the line explains them anyway.
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
        // The algebraic residual |p − c|² − r² is 2 r times the distance.
        left / (4.0 * squared * self.variance_along([towards[0] / length, towards[1] / length]))
    }
}

/// Points in their order along an outline, counter-clockwise if closed.
pub(super) struct Sequence {
    pub(super) origin: [f64; 2],
    pub(super) points: Vec<[f64; 2]>,
    /// Cumulated sums of the bins over two rounds, so that a run may wrap around.
    cumulated: Vec<Sums>,
    pub(super) bins: usize,
    /// Index of the first point of each bin.
    pub(super) first: Vec<usize>,
    /// True if the first point follows the last.
    pub(super) is_closed: bool,
}

impl Sequence {
    /// Closed sequences, each a guess of the order along the outline.
    ///
    /// The first is the shortest tour among the orders by direction from the centre, by direction from a grid
    /// of view points, and that of the file. For a non-convex outline, some view point often sees all of it.
    /// If a general tour is shorter still, as for a U or an outline whose arms hide each other, it follows.
    pub(super) fn closed(readings: &[ContourReading]) -> Vec<Self> {
        let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
        let origin = middle(&points);
        let mut best = around(&points, origin);
        for from in view_points(&points) {
            let one = around(&points, from);
            // Another view point has to be clearly better: noise alone makes small differences.
            if one.0 < 0.9 * best.0 {
                best = one;
            }
        }
        let filed: Vec<usize> = (0..points.len()).collect();
        // The order of the file is often that of the scan; keep it if it is clearly shorter.
        let order = if tour::length(&points, &filed) < 0.95 * best.0 { filed } else { best.1 };
        let mut orders = vec![order];
        // A part of many readings suffices for a start. They are compared with the same part.
        let step = points.len().div_ceil(MAX_TOUR).max(1);
        let part: Vec<usize> = orders[0].iter().copied().filter(|k| k % step == 0).collect();
        let length = tour::length(&points, &part);
        let short = tour::shortened(&points, part);
        if tour::length(&points, &short) < CLEARLY_SHORTER * length {
            orders.push(short);
        }
        let counter_clockwise = |mut order: Vec<usize>| {
            let area: f64 = (0..order.len())
                .map(|k| {
                    let (a, b) = (points[order[k]], points[order[(k + 1) % order.len()]]);
                    a[0] * b[1] - a[1] * b[0]
                })
                .sum();
            // Counter-clockwise, as outlines are.
            if area < 0.0 {
                order.reverse();
            }
            Self::new(readings, &points, &order, origin, true)
        };
        orders.into_iter().map(counter_clockwise).collect()
    }

    /// An open sequence that begins at the end with the smaller y (then x).
    ///
    /// Returns `None` if the gap between the ends is not larger than usual gaps: the outline may be closed.
    ///
    /// It is the shortest path among the order of the file and the orders by direction from the mean sensor
    /// position, from far away on either side, and from view points among the readings. Each tour is cut at
    /// its widest step.
    pub(super) fn open(readings: &[ContourReading]) -> Option<Self> {
        let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
        let origin = middle(&points);
        // An open path is a closed tour without its widest step.
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
        let sensors: Vec<[f64; 2]> = (readings.iter())
            .filter_map(|s| match s.target {
                ContourTarget::Range { origin, .. } => Some(origin),
                ContourTarget::Point { .. } => None,
            })
            .collect();
        let center = mean(&points);
        // From far away on the normal of the main direction, the order is that of the coordinate along it.
        let reach =
            1e3 * points.iter().map(|p| (p[0] - center[0]).hypot(p[1] - center[1])).fold(0.0, f64::max);
        let angle = super::line(&points)[0];
        let far = [-1.0, 1.0]
            .map(|side| [center[0] - side * reach * angle.sin(), center[1] + side * reach * angle.cos()]);
        let seen_from = (!sensors.is_empty()).then(|| mean(&sensors));
        let filed: Vec<usize> = (0..points.len()).collect();
        let mut best = cut((tour::length(&points, &filed), filed));
        for from in seen_from.into_iter().chain(far).chain([origin]).chain(view_points(&points)) {
            let one = cut(around(&points, from));
            if one.0 < best.0 {
                best = one;
            }
        }
        let (_, gap, mut order) = best;
        if gap <= typical_gap(readings) {
            return None;
        }
        let (first, last) = (points[*order.first()?], points[*order.last()?]);
        if (last[1], last[0]) < (first[1], first[0]) {
            order.reverse();
        }
        Some(Self::new(readings, &points, &order, origin, false))
    }

    fn new(
        readings: &[ContourReading],
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
                sums.add(p, readings[i].covariance());
            }
        }
        let mut cumulated = vec![Sums::default()];
        // Two rounds, so that runs across the start of a closed sequence are differences as well.
        for k in 0..2 * bins {
            cumulated.push(cumulated[k].plus(&each[k % bins]));
        }
        Self { origin, points: order.iter().map(|&i| points[i]).collect(), cumulated, bins, first, is_closed }
    }

    /// Sums over the bins `from..to`, where `to` may lie in the second round.
    pub(super) fn sums(&self, from: usize, to: usize) -> Sums {
        self.cumulated[to].minus(&self.cumulated[from])
    }

    pub(super) fn count(&self) -> usize {
        self.points.len()
    }
}

/// Centre of Taubin's circle, or the centroid if the former is more than a radius away from it.
///
/// The centre of the circle does not move towards densely read parts, but it is far away for nearly straight
/// points.
fn middle(points: &[[f64; 2]]) -> [f64; 2] {
    let m = mean(points);
    circle(points).map_or(m, |c| if (c[0] - m[0]).hypot(c[1] - m[1]) < c[2] { [c[0], c[1]] } else { m })
}

/// The points ordered by direction from a view point, and the length of that tour.
fn around(points: &[[f64; 2]], from: [f64; 2]) -> (f64, Vec<usize>) {
    let mut turns: Vec<(f64, usize)> =
        (points.iter().enumerate()).map(|(i, p)| ((p[1] - from[1]).atan2(p[0] - from[0]), i)).collect();
    turns.sort_by(|a, b| a.0.total_cmp(&b.0));
    let order: Vec<usize> = turns.into_iter().map(|(_, i)| i).collect();
    (tour::length(points, &order), order)
}

/// A grid of view points within the bounding box of the points.
fn view_points(points: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let bounds: BoundingBox<[f64; 2]> = points.iter().copied().collect();
    let (low, sides) = (bounds.min, bounds.extent());
    (0..GRID * GRID).map(move |k| {
        let share = |i: usize| (i as f64 + 0.5) / GRID as f64;
        [low[0] + share(k % GRID) * sides[0], low[1] + share(k / GRID) * sides[1]]
    })
}
