//! Crossings of two stripes in an image, with their directions and covariance.
//!
//! In: an image and its [`Ridges`]. Out: [`Crossing`]s.
//!
//! A first estimate is a point where the tangents of many ridge points nearby meet. Close to it the two
//! stripes merge and ridge points are biased. So each stripe is a parabola `v = a + b t + c t²` through
//! points farther away, on both sides, and the crossing is the intersection of the parabolas. Without the
//! second-order term, curved stripes would shift the crossing; with it σ is 50 % larger. Errors of
//! neighbouring points are correlated, so the covariance of a, b and c is `(XᵀX)⁻¹ Xᵀ C X (XᵀX)⁻¹`.
//!
//! Not guaranteed: the crossing lines may not be stripes of the pattern; indexing decides.

use super::ridges::{Ridge, Ridges, smoothed};
use crate::Image;
use planish_core::DVec3;
use planish_core::matrix3::{inverse, times};

/// Maximum distance of two ridge points that vote for a crossing, in scales, and the minimum number of votes.
const VOTING_SCALES: f64 = 8.0;
const MIN_VOTES: f32 = 24.0;
/// Distance to the other stripe below which points are excluded, in scales: there the stripes merge.
const MIN_OTHER_DISTANCE: f64 = 2.6;
/// Distance to which a stripe is followed from its crossing, as a share of the spacing of crossings.
const REACH: f64 = 0.48;
const MIN_REACH_SCALES: f64 = 6.0;
/// Minimum number of points of a stripe on either side of a crossing: three on each side determine a parabola
/// with degrees of freedom left.
const MIN_PLACES: usize = 3;
/// Gate of points before the parabola is known: distance from the straight line in pixels, and cosine to its
/// direction.
const OFF_LINE: f64 = 2.5;
const TURNED_COS: f64 = 0.85;
/// Minimum sine of the angle between two stripes: 14.5°. At smaller angles the crossing is uncertain along
/// both.
const MIN_CROSSING: f64 = 0.25;

/// Two stripes that cross.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crossing {
    /// Where, in pixels.
    pub image: [f64; 2],
    /// The angles of both stripes there, from x to y; the second is a positive turn of less than half from
    /// the first.
    pub angles_rad: [f64; 2],
    /// Covariance of x, y and both angles, if ridge points of strength one have σ 1.
    pub covariance: [[f64; 4]; 4],
}

impl Crossing {
    /// The unit vector along a stripe.
    pub fn direction(&self, stripe: usize) -> [f64; 2] {
        let (sin, cos) = self.angles_rad[stripe].sin_cos();
        [cos, sin]
    }
}

/// All crossings of an image.
pub(super) struct Crossings {
    pub found: Vec<Crossing>,
    /// Median distance of neighbours, in pixels.
    pub spacing: f64,
    /// Number of candidates that are not crossings.
    pub no_crossing: usize,
}

impl Crossings {
    /// Finds them.
    pub fn new(image: &Image, ridges: &Ridges) -> Self {
        let spots = meeting_places(image, ridges);
        let min_reach = MIN_REACH_SCALES * ridges.scale;
        // Twice: the first pass gives the spacing, which limits how far stripes are followed in the second.
        let first =
            different(spots.iter().filter_map(|spot| crossing_at(ridges, *spot, min_reach)), min_reach);
        let spacing = typical_distance(&first.iter().map(|c| c.image).collect::<Vec<_>>());
        // The median spacing limits the distance to which stripes are followed.
        let reach = (REACH * spacing).max(min_reach);
        let found = different(first.iter().filter_map(|c| crossing_at(ridges, c.image, reach)), min_reach);
        let no_crossing = spots.len() - found.len();
        Self { found, spacing, no_crossing }
    }
}

/// Drops crossings that coincide with an earlier one.
fn different(all: impl Iterator<Item = Crossing>, min_reach: f64) -> Vec<Crossing> {
    let mut found: Vec<Crossing> = Vec::new();
    for new in all {
        if found.iter().all(|old| apart(old.image, new.image) > 0.4 * min_reach) {
            found.push(new);
        }
    }
    found
}

pub(super) fn apart(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Candidates for crossings: each pair of nearby ridge points whose tangents intersect votes for the
/// intersection.
fn meeting_places(image: &Image, ridges: &Ridges) -> Vec<[f64; 2]> {
    let (columns, rows) = (image.columns, image.rows);
    let reach = VOTING_SCALES * ridges.scale;
    let mut votes = vec![0.0_f32; columns * rows];
    for a in ridges.all() {
        for b in ridges.near(a.place, reach) {
            let crossing = a.direction[0] * b.direction[1] - a.direction[1] * b.direction[0];
            if crossing.abs() < MIN_CROSSING {
                continue;
            }
            let d = [b.place[0] - a.place[0], b.place[1] - a.place[1]];
            let along = (d[0] * b.direction[1] - d[1] * b.direction[0]) / crossing;
            let back = (d[0] * a.direction[1] - d[1] * a.direction[0]) / crossing;
            if along.abs() > reach || back.abs() > reach {
                continue;
            }
            let [x, y] = [0, 1].map(|k| (a.place[k] + along * a.direction[k]).round());
            if x >= 0.0 && y >= 0.0 && (x as usize) < columns && (y as usize) < rows {
                votes[y as usize * columns + x as usize] += 1.0;
            }
        }
    }
    // Votes are rounded to pixels; smoothing joins those of one crossing.
    let height = smoothed(votes, columns, 1.0);
    let minimum = MIN_VOTES / std::f32::consts::TAU;
    let mut found = Vec::new();
    for y in 2..rows.saturating_sub(2) {
        for x in 2..columns.saturating_sub(2) {
            let value = height[y * columns + x];
            if value <= 0.0 || value < minimum {
                continue;
            }
            let around = (y - 2..=y + 2).flat_map(|j| (x - 2..=x + 2).map(move |i| (i, j)));
            // Of equal neighbours only the first is a maximum.
            let top = around.into_iter().all(|(i, j)| {
                let other = height[j * columns + i];
                other < value || other == value && (j, i) >= (y, x)
            });
            if top {
                found.push([x as f64, y as f64]);
            }
        }
    }
    found
}

/// The median distance to the nearest neighbour.
fn typical_distance(spots: &[[f64; 2]]) -> f64 {
    let mut nearest: Vec<f64> = (spots.iter().enumerate())
        .filter_map(|(k, spot)| {
            let others = spots.iter().enumerate().filter(|(other, _)| *other != k);
            others.map(|(_, other)| apart(*spot, *other)).min_by(f64::total_cmp)
        })
        .collect();
    nearest.sort_by(f64::total_cmp);
    nearest.get(nearest.len() / 2).copied().unwrap_or(0.0)
}

/// A parabola over its own axis through a centre.
struct Stripe {
    centre: [f64; 2],
    /// Unit vector along the stripe.
    axis: [f64; 2],
    /// `a`, `b`, `c`, and their covariance if ridge points of strength one have σ 1.
    curve: [f64; 3],
    covariance: [[f64; 3]; 3],
}

impl Stripe {
    fn at(&self, t: f64) -> [f64; 2] {
        let v = self.curve[0] + t * (self.curve[1] + t * self.curve[2]);
        let [x, y] = self.axis;
        [self.centre[0] + t * x - v * y, self.centre[1] + t * y + v * x]
    }

    fn slope(&self, t: f64) -> f64 {
        self.curve[1] + 2.0 * self.curve[2] * t
    }

    fn tangent(&self, t: f64) -> [f64; 2] {
        let slope = self.slope(t);
        let [x, y] = self.axis;
        [x - slope * y, y + slope * x]
    }

    /// The parabola through the ridge points of a line near a centre.
    fn through(ridges: &Ridges, places: &[&Ridge], centre: [f64; 2], axis: [f64; 2]) -> Option<Self> {
        let mut own: Vec<[f64; 3]> = (places.iter())
            .map(|r| {
                let d = [r.place[0] - centre[0], r.place[1] - centre[1]];
                let (t, v) = (d[0] * axis[0] + d[1] * axis[1], d[1] * axis[0] - d[0] * axis[1]);
                [t, v, r.strength]
            })
            .collect();
        // Along the stripe, for the thinning and for the count on each side.
        own.sort_by(|a, b| a[0].total_cmp(&b[0]));
        // Two adjacent pixels may both contain the line: keep one point per step.
        own.dedup_by(|b, a| b[0] - a[0] < 0.4);
        for last in [false, true] {
            let sides = own.iter().filter(|p| p[0] < 0.0).count();
            if sides < MIN_PLACES || own.len() - sides < MIN_PLACES {
                return None;
            }
            let (curve, inverse) = parabola(&own)?;
            if last {
                return Some(Self { centre, axis, curve, covariance: sandwich(ridges, &own, &inverse) });
            }
            // Points of other lines are far from the parabola.
            let off = |p: &[f64; 3]| (p[1] - curve[0] - p[0] * (curve[1] + p[0] * curve[2])).abs();
            let mut sizes: Vec<f64> = own.iter().map(off).collect();
            sizes.sort_by(f64::total_cmp);
            let limit = (5.0 * sizes[sizes.len() / 2]).max(0.3);
            own.retain(|p| off(p) <= limit);
        }
        None
    }
}

/// The least-squares parabola and `(XᵀX)⁻¹`.
fn parabola(places: &[[f64; 3]]) -> Option<([f64; 3], [[f64; 3]; 3])> {
    let (mut m, mut r) = ([[0.0; 3]; 3], [0.0; 3]);
    for [t, v, _] in places {
        let row = [1.0, *t, t * t];
        for i in 0..3 {
            (0..3).for_each(|j| m[i][j] += row[i] * row[j]);
            r[i] += row[i] * v;
        }
    }
    let inverse = inverse(&m)?;
    Some((times(&inverse, DVec3::from_array(r)).to_array(), inverse))
}

/// `(XᵀX)⁻¹ Xᵀ C X (XᵀX)⁻¹` with the correlated errors of points on one line.
fn sandwich(ridges: &Ridges, places: &[[f64; 3]], inverse: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    // Errors of neighbouring points are correlated. Treated as independent, they would make σ too small by
    // the number of points per correlation length.
    let gains: Vec<[f64; 3]> = (places.iter())
        .map(|[t, _, strength]| (times(inverse, DVec3::new(1.0, *t, t * t)) / *strength).to_array())
        .collect();
    let mut sum = [[0.0; 3]; 3];
    for (p, g) in places.iter().zip(&gains) {
        for (q, h) in places.iter().zip(&gains) {
            let rho = ridges.correlation(p[0] - q[0]);
            for (row, gi) in sum.iter_mut().zip(g) {
                row.iter_mut().zip(h).for_each(|(s, hj)| *s += rho * gi * hj);
            }
        }
    }
    sum
}

/// The crossing near a candidate, if two stripes pass through it.
fn crossing_at(ridges: &Ridges, spot: [f64; 2], reach: f64) -> Option<Crossing> {
    let mut centre = spot;
    let mut axes: Option<[[f64; 2]; 2]> = None;
    let mut made = None;
    // The centre and the directions decide which points belong to a stripe, and these determine centre and
    // directions.
    for _ in 0..3 {
        let around: Vec<&Ridge> = (ridges.near(centre, reach))
            .filter(|r| (2.0..=reach).contains(&apart(r.place, centre)) && passes(r, centre))
            .collect();
        let two = match axes {
            Some(two) => two,
            None => two_directions(&around)?,
        };
        let stripes = [0, 1].map(|k| {
            let (own, other) = (two[k], two[1 - k]);
            let places: Vec<&Ridge> = (around.iter().copied())
                .filter(|r| {
                    let d = [r.place[0] - centre[0], r.place[1] - centre[1]];
                    let from_other = (d[1] * other[0] - d[0] * other[1]).abs();
                    aligned(r, own) >= TURNED_COS
                        && aligned(r, own) > aligned(r, other)
                        && from_other >= MIN_OTHER_DISTANCE * ridges.scale
                })
                .collect();
            Stripe::through(ridges, &places, centre, own)
        });
        let [Some(a), Some(b)] = stripes else { return None };
        let found = meet(&a, &b)?;
        if apart(found.image, spot) > reach {
            return None;
        }
        centre = found.image;
        axes = Some([0, 1].map(|k| found.direction(k)));
        made = Some(found);
    }
    made
}

/// True if the tangent of a ridge point passes near a centre.
fn passes(ridge: &Ridge, centre: [f64; 2]) -> bool {
    let d = [ridge.place[0] - centre[0], ridge.place[1] - centre[1]];
    (d[1] * ridge.direction[0] - d[0] * ridge.direction[1]).abs() <= OFF_LINE
}

fn aligned(ridge: &Ridge, axis: [f64; 2]) -> f64 {
    (ridge.direction[0] * axis[0] + ridge.direction[1] * axis[1]).abs()
}

/// The two main directions of ridge points, by 2-means clustering of doubled angles: lines have no sign.
fn two_directions(around: &[&Ridge]) -> Option<[[f64; 2]; 2]> {
    // Doubled angles: a direction and its opposite are the same line.
    let doubled: Vec<[f64; 2]> = (around.iter())
        .map(|r| {
            let [x, y] = r.direction;
            [x * x - y * y, 2.0 * x * y]
        })
        .collect();
    let dot = |a: [f64; 2], b: [f64; 2]| a[0] * b[0] + a[1] * b[1];
    let first = *doubled.first()?;
    let far =
        |from: [f64; 2]| (doubled.iter().copied()).min_by(|a, b| dot(*a, from).total_cmp(&dot(*b, from)));
    let a = far(first)?;
    let mut means = [a, far(a)?];
    for _ in 0..6 {
        let mut sums = [[0.0; 2]; 2];
        for d in &doubled {
            let sum = &mut sums[usize::from(dot(*d, means[1]) > dot(*d, means[0]))];
            (0..2).for_each(|k| sum[k] += d[k]);
        }
        for (mean, sum) in means.iter_mut().zip(sums) {
            let length = sum[0].hypot(sum[1]);
            if length <= 0.0 {
                return None;
            }
            *mean = sum.map(|s| s / length);
        }
    }
    let axes = means.map(|m| {
        let angle = 0.5 * m[1].atan2(m[0]);
        [angle.cos(), angle.sin()]
    });
    let crossing = axes[0][0] * axes[1][1] - axes[0][1] * axes[1][0];
    (crossing.abs() >= MIN_CROSSING).then_some(axes)
}

/// The intersection of two parabolas, by Newton's method, with the covariance of position and angles.
fn meet(a: &Stripe, b: &Stripe) -> Option<Crossing> {
    let (mut s, mut t) = (0.0, 0.0);
    let mut determinant = 0.0;
    // Newton's method on two parabolas, which are almost straight: it converges in a few steps.
    for _ in 0..8 {
        let (p, q) = (a.at(s), b.at(t));
        let (u, v) = (a.tangent(s), b.tangent(t));
        let d = [q[0] - p[0], q[1] - p[1]];
        determinant = u[0] * v[1] - u[1] * v[0];
        if determinant.abs() < MIN_CROSSING {
            return None;
        }
        s += (d[0] * v[1] - d[1] * v[0]) / determinant;
        t += (d[0] * u[1] - d[1] * u[0]) / determinant;
    }
    let image = a.at(s);
    if apart(image, b.at(t)).is_nan() || apart(image, b.at(t)) >= 1e-6 {
        return None;
    }
    let (u, v) = (a.tangent(s), b.tangent(t));
    let angles = [u, v].map(|d| d[1].atan2(d[0]));
    // Derivatives by the six numbers: moving a's curve up by 1 at s moves the crossing along b.
    let mut jacobian = [[0.0; 6]; 4];
    for (k, (own, along, at)) in [(a, v, s), (b, u, t)].into_iter().enumerate() {
        let up = [-own.axis[1], own.axis[0]];
        // own.at(at) + up δ + own' ds lies on the other curve: ds · (own' × along) = −(up × along) δ.
        let own_tangent = own.tangent(at);
        let across = own_tangent[0] * along[1] - own_tangent[1] * along[0];
        let ds = -(up[0] * along[1] - up[1] * along[0]) / across;
        let moved = [up[0] + ds * own_tangent[0], up[1] + ds * own_tangent[1]];
        let d_other = {
            let length = along[0] * along[0] + along[1] * along[1];
            (moved[0] * along[0] + moved[1] * along[1]) / length
        };
        let turn = |stripe: &Stripe, at: f64| 1.0 / (1.0 + stripe.slope(at).powi(2));
        let (other_stripe, other_at) = if k == 0 { (b, t) } else { (a, s) };
        for (n, basis) in [1.0, at, at * at].into_iter().enumerate() {
            let column = 3 * k + n;
            jacobian[0][column] = moved[0] * basis;
            jacobian[1][column] = moved[1] * basis;
            let own_slope = [0.0, 1.0, 2.0 * at][n] + 2.0 * own.curve[2] * ds * basis;
            jacobian[2 + k][column] = own_slope * turn(own, at);
            jacobian[3 - k][column] =
                2.0 * other_stripe.curve[2] * d_other * basis * turn(other_stripe, other_at);
        }
    }
    let mut covariance = [[0.0; 4]; 4];
    for (i, row) in covariance.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            for (k, stripe) in [a, b].into_iter().enumerate() {
                for m in 0..3 {
                    for n in 0..3 {
                        *entry += jacobian[i][3 * k + m] * stripe.covariance[m][n] * jacobian[j][3 * k + n];
                    }
                }
            }
        }
    }
    // The second direction is a positive turn from the first.
    let mut second = angles[1];
    if determinant < 0.0 {
        second += std::f64::consts::PI;
    }
    Some(Crossing { image, angles_rad: [angles[0], second], covariance })
}

#[cfg(test)]
mod tests;
