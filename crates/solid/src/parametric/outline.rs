//! The region of a face in the parameters of its surface, as polygons without jumps.
//!
//! Input: loops in parameters. Output: polygons; a point in an odd number of them is in the face. Two loops
//! that wind around are joined by a bridge, whose two sides have the same vertices. If the face contains a
//! pole, or all of a closed surface, loops are added for these.

use super::lifted::{Lifted, Lifter, Ring};
use super::surface::{Feet, ParametricSurface};
use super::{Fineness, ParametricFace};
use crate::tessellation::polygon::{Corner, part_touching, segments_cross, shift_into_outer, signed_area};
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Number of corners of the loop that represents a pole; all of them are one vertex.
const AROUND_POLE: usize = 24;
/// Maximum number of sides of a line of one parameter. It bounds the number of points.
const MAX_SIDES: usize = 4096;
/// Maximum number of sides that are tested to find a bridge, about a second.
const MAX_BRIDGE_TESTS: usize = 50_000_000;

/// The polygons of a face.
pub(super) struct Outline {
    /// Polygons in lengths: parameters times `steps`.
    pub(super) polygons: Vec<Vec<Corner>>,
    /// Mean lengths of the derivatives of the surface along its parameters.
    ///
    /// Triangulated in plain parameters, a long thin cylinder would get long thin triangles.
    pub(super) steps: [f64; 2],
}

/// Makes the polygons of a face. Added points are appended to the positions.
pub(super) struct Outliner<'a> {
    surface: &'a ParametricSurface,
    lifter: Lifter<'a>,
    fineness: Fineness,
    positions: &'a mut Vec<DVec3>,
}

impl<'a> Outliner<'a> {
    pub(super) fn new(face: &'a ParametricFace, positions: &'a mut Vec<DVec3>, fineness: Fineness) -> Self {
        let surface = &face.surface;
        let lifter = Lifter {
            feet: Feet::new(surface),
            periods: surface.periods(),
            poles: surface.poles(),
            close: 0.1 * fineness.chord,
        };
        Self { surface, lifter, fineness, positions }
    }

    /// The polygons of a face from loops that have it on their left.
    pub(super) fn outline(&mut self, rings: &[Ring]) -> Result<Outline> {
        let lifted: Result<Vec<Lifted>> =
            rings.iter().map(|ring| self.lifter.lift(ring, self.positions)).collect();
        // A loop along both sides of a seam encloses the face, whatever its direction. Some files state the
        // wrong one.
        let is_seamed = rings.iter().any(Ring::has_seam);
        let mut polygons = self.polygons(lifted?, is_seamed)?;
        let periods = self.lifter.periods;
        if periods != [None; 2] {
            shift_into_outer(&mut polygons, periods);
        }
        let steps = self.steps(&polygons);
        for corner in polygons.iter_mut().flatten() {
            corner.at = [corner.at[0] * steps[0], corner.at[1] * steps[1]];
        }
        part_touching(&mut polygons, 1.0);
        Ok(Outline { polygons, steps })
    }

    /// The polygons, by the number of loops that wind around.
    fn polygons(&mut self, loops: Vec<Lifted>, is_seamed: bool) -> Result<Vec<Vec<Corner>>> {
        if loops.iter().any(|l| l.windings[0] != 0 && l.windings[1] != 0) {
            return Err(Error::unsupported("a loop winds around along both parameters"));
        }
        // Loops that wind around both parameters of a torus would need a cut along both, which is not
        // supported.
        // `k` is the parameter around which loops wind.
        let along = [0, 1].into_iter().find(|k| loops.iter().any(|l| l.windings[*k] != 0));
        let Some(k) = along else {
            return self.unwound(loops.into_iter().map(|l| l.corners).collect(), is_seamed);
        };
        let (winding, others): (Vec<Lifted>, Vec<Lifted>) =
            loops.into_iter().partition(|l| l.windings[k] != 0);
        let mut around: Vec<(bool, Vec<Corner>)> =
            winding.into_iter().map(|l| (l.windings[k] > 0, l.corners)).collect();
        let n = around.len();
        if n == 1 {
            let pole = self.adjacent_pole(k, around[0].0)?;
            around.push((!around[0].0, pole));
        } else if n != 2 {
            return Err(Error::unsupported(format!(
                "{n} loops run around the surface: expected none, one or two"
            )));
        }
        let pair = self.upright(k, around)?;
        let mut polygons: Vec<Vec<Corner>> = others.into_iter().map(|l| l.corners).collect();
        let joined = self.joined(k, pair, &polygons)?;
        polygons.insert(0, joined);
        Ok(polygons)
    }

    /// Two loops around, the first with an increasing and the second with a decreasing parameter, so that the
    /// face between them is on their left.
    fn upright(&self, k: usize, around: Vec<(bool, Vec<Corner>)>) -> Result<[Vec<Corner>; 2]> {
        let across = 1 - k;
        let mean = |l: &Vec<Corner>| l.iter().map(|c| c.at[across]).sum::<f64>() / l.len() as f64;
        let mut sorted = around;
        if self.lifter.periods[across].is_some() {
            if sorted[0].0 == sorted[1].0 {
                return Err(Error::unsupported("two loops run around the surface in the same direction"));
            }
            sorted.sort_by_key(|(is_on, _)| !is_on);
        } else {
            // Only one region lies between the two loops, so their direction adds no information. Some files
            // state the wrong one; it is derived from the order.
            sorted.sort_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)));
            if k == 1 {
                sorted.reverse();
            }
            for (place, (is_on, corners)) in sorted.iter_mut().enumerate() {
                if *is_on != (place == 0) {
                    corners.reverse();
                }
            }
        }
        let mut rest = sorted.into_iter().map(|(_, corners)| corners);
        match (rest.next(), rest.next()) {
            (Some(on), Some(mut back)) => {
                // On a torus, the second loop is moved by whole periods to be the next one on the left.
                if let Some(period) = self.lifter.periods[across] {
                    let up = if k == 0 { 1.0 } else { -1.0 };
                    let apart = up * (mean(&back) - mean(&on));
                    let shift = up * (apart.rem_euclid(period) - apart);
                    for corner in &mut back {
                        corner.at[across] += shift;
                    }
                }
                Ok([on, back])
            }
            _ => Err(Error::unsupported("expected two loops around the surface")),
        }
    }

    /// The loop that represents the pole beside a loop around; if there are two poles, the one on its left.
    fn adjacent_pole(&mut self, k: usize, is_on: bool) -> Result<Vec<Corner>> {
        let is_above = is_on == (k == 0);
        let pole_with = |low: bool| self.lifter.poles.iter().find(|p| p.constant == 1 - k && p.is_low == low);
        // A cone has only one pole, so the stated direction of its loop is not needed to choose it.
        match pole_with(!is_above).or(pole_with(is_above)).copied() {
            Some(pole) => {
                let vertex = self.positions.len() as u32;
                self.positions.push(pole.point);
                Ok(self.around(k, pole.value, AROUND_POLE, |_, _| vertex))
            }
            None => Err(Error::unsupported(
                "one loop runs around the surface, which has no pole where the face could end",
            )),
        }
    }

    /// Corners along a period of one parameter, ascending; the other parameter is constant.
    fn around(
        &mut self,
        k: usize,
        value: f64,
        n: usize,
        mut vertex: impl FnMut(&mut Self, [f64; 2]) -> u32,
    ) -> Vec<Corner> {
        let lo = self.surface.domain()[k].map_or(0.0, |d| d[0]);
        let period = self.lifter.periods[k].unwrap_or(1.0);
        (0..n)
            .map(|i| {
                let mut at = [value; 2];
                at[k] = lo + period * i as f64 / n as f64;
                Corner { vertex: vertex(self, at), at }
            })
            .collect()
    }

    /// The polygons of a face without loops that wind around: the inside of the outer loop, or a closed
    /// surface without its holes, or all of the surface.
    fn unwound(&mut self, loops: Vec<Vec<Corner>>, is_seamed: bool) -> Result<Vec<Vec<Corner>>> {
        let periods = self.lifter.periods;
        // A surface is closed if one parameter is periodic, and the other one is periodic or ends at poles.
        let low =
            |k: usize, low: bool| self.lifter.poles.iter().any(|p| p.constant == 1 - k && p.is_low == low);
        let closes =
            |k: usize| periods[k].is_some() && (periods[1 - k].is_some() || low(k, true) && low(k, false));
        let closed = [0, 1].into_iter().find(|k| closes(*k));
        if let Some(k) = closed
            && (loops.is_empty() || !is_seamed && signed_area(&loops) < 0.0)
        {
            // A negative area: the loops are holes, and the face is the rest of the surface.
            return self.complement(k, loops);
        }
        match loops.is_empty() {
            false => Ok(loops),
            true => self.complete_domain(),
        }
    }

    /// The polygons of a closed surface without some holes.
    ///
    /// Two loops around are added: at both poles, or along a line without holes and the same line a period
    /// further.
    fn complement(&mut self, k: usize, holes: Vec<Vec<Corner>>) -> Result<Vec<Vec<Corner>>> {
        let across = 1 - k;
        let pair = match self.lifter.periods[across] {
            None => {
                let domain = self.surface.domain()[across].unwrap_or_default();
                let low = self.pole_at(k, domain[0])?;
                let mut high = self.pole_at(k, domain[1])?;
                high.reverse();
                if k == 0 { [low, high] } else { reversed_pair(low, high) }
            }
            Some(period) => {
                let lo = self.surface.domain()[across].map_or(0.0, |d| d[0]);
                // The added line must not cross a hole: it is a side of the polygon.
                let is_free = |x: f64| {
                    holes.iter().all(|hole| {
                        let (a, b) = extent(hole, across);
                        (x - a).rem_euclid(period) > b - a
                    })
                };
                let Some(x) = (0..64).map(|i| lo + period * f64::from(i) / 64.0).find(|x| is_free(*x)) else {
                    return Err(Error::unsupported("no line around the surface avoids its loops"));
                };
                let n = self.sides(k, x);
                let first = self.around(k, x, n, |this, at| this.add(at));
                let mut second = first.clone();
                for corner in &mut second {
                    corner.at[across] += period;
                }
                second.reverse();
                if k == 0 { [first, second] } else { reversed_pair(first, second) }
            }
        };
        let joined = self.joined(k, pair, &holes)?;
        let mut polygons = vec![joined];
        polygons.extend(holes);
        Ok(polygons)
    }

    /// The loop that represents the pole at a value of the other parameter.
    fn pole_at(&mut self, k: usize, value: f64) -> Result<Vec<Corner>> {
        let pole = self.lifter.poles.iter().find(|p| p.constant == 1 - k && p.value == value);
        let Some(point) = pole.map(|p| p.point) else {
            return Err(Error::unsupported("the surface has no pole where it should end"));
        };
        let vertex = self.positions.len() as u32;
        self.positions.push(point);
        Ok(self.around(k, value, AROUND_POLE, |_, _| vertex))
    }

    /// The polygon of a whole surface with boundaries of its own.
    fn complete_domain(&mut self) -> Result<Vec<Vec<Corner>>> {
        let domain = self.surface.domain();
        let [Some(u), Some(v)] = domain else {
            return Err(Error::unsupported("the face has no loops and its surface is unbounded"));
        };
        let periods = self.lifter.periods;
        if let Some(k) = [0, 1].into_iter().find(|k| periods[*k].is_some()) {
            let ends = domain[1 - k].unwrap_or_default();
            let mut low = self.circle(k, ends[0]);
            let mut high = self.circle(k, ends[1]);
            if k == 0 {
                high.reverse();
            } else {
                low.reverse();
                std::mem::swap(&mut low, &mut high);
            }
            return Ok(vec![self.joined(k, [low, high], &[])?]);
        }
        // Counter-clockwise around the domain; a collapsed side needs only one point.
        let corners = [[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]];
        let mut polygon: Vec<Corner> = Vec::new();
        for side in 0..4 {
            let (from, to) = (corners[side], corners[(side + 1) % 4]);
            let k = side % 2;
            let pole = self
                .lifter
                .poles
                .iter()
                .find(|p| p.constant == 1 - k && p.value == from[1 - k])
                .map(|p| p.point);
            let n = if pole.is_some() { 1 } else { self.sides(k, from[1 - k]) };
            for i in 0..n {
                let at = [0, 1].map(|c| from[c] + (to[c] - from[c]) * i as f64 / n as f64);
                let vertex = self.add(at);
                polygon.push(Corner { vertex, at });
            }
        }
        Ok(vec![self.merged(polygon)])
    }

    /// The boundary at a value of the other parameter: a pole, or points of the surface.
    fn circle(&mut self, k: usize, value: f64) -> Vec<Corner> {
        if let Ok(pole) = self.pole_at(k, value) {
            return pole;
        }
        let n = self.sides(k, value);
        self.around(k, value, n, |this, at| this.add(at))
    }

    /// Merges corners at one position into one vertex, as at a collapsed side.
    fn merged(&self, mut polygon: Vec<Corner>) -> Vec<Corner> {
        for i in 1..polygon.len() {
            let place = |c: &Corner| self.positions[c.vertex as usize];
            let (position, last, first) = (place(&polygon[i]), polygon[i - 1], polygon[0]);
            for other in [last, first] {
                if position.distance(place(&other)) <= 1e-9 * position.length() {
                    polygon[i].vertex = other.vertex;
                }
            }
        }
        polygon
    }

    /// Adds the point of the surface at parameters.
    fn add(&mut self, at: [f64; 2]) -> u32 {
        self.positions.push(self.surface.point(at));
        (self.positions.len() - 1) as u32
    }

    /// Number of sides along the whole range of one parameter that satisfies the fineness.
    fn sides(&self, k: usize, value: f64) -> usize {
        let [lo, hi] = self.surface.domain()[k].unwrap_or([0.0, 1.0]);
        let at = |x: f64| {
            let mut at = [value; 2];
            at[k] = x;
            at
        };
        self.pieces(at(lo), at(hi), 4)
    }

    /// Number of equal pieces of a straight line of parameters whose chords satisfy the fineness.
    ///
    /// Doubling keeps the test cheap; up to twice the needed number is made.
    fn pieces(&self, from: [f64; 2], to: [f64; 2], min: usize) -> usize {
        let point = |share: f64| self.surface.point([0, 1].map(|c| from[c] + share * (to[c] - from[c])));
        let mut n = min;
        while n < MAX_SIDES {
            let is_fine = (0..n).all(|i| {
                let [a, m, b] = [0.0, 0.5, 1.0].map(|h| point((i as f64 + h) / n as f64));
                let flat = 0.5 * (a + b);
                m.distance(flat) <= self.fineness.chord && a.distance(b) <= self.fineness.longest
            });
            if is_fine {
                break;
            }
            n *= 2;
        }
        n
    }

    /// One polygon from two loops around, joined by a bridge that crosses no loop. The first loop is
    /// ascending and the second descending.
    fn joined(
        &mut self,
        k: usize,
        [on, back]: [Vec<Corner>; 2],
        others: &[Vec<Corner>],
    ) -> Result<Vec<Corner>> {
        let period = self.lifter.periods[k].unwrap_or(1.0);
        let near = |x: f64, to: f64| x - period * ((x - to) / period).round();
        let across = 1 - k;
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        // All pairs of corners would be too many for long loops; about 400 of each are enough to choose from.
        let (stride_on, stride_back) = (on.len().div_ceil(400), back.len().div_ceil(400));
        for i in (0..on.len()).step_by(stride_on) {
            for j in (0..back.len()).step_by(stride_back) {
                // Bridges with little change of the periodic parameter come first, then short ones.
                let lean = (near(back[j].at[k], on[i].at[k]) - on[i].at[k]) / period;
                let up = (back[j].at[across] - on[i].at[across]).abs();
                pairs.push((lean.abs() + 1e-3 * up / (1.0 + up), i, j));
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let loops: Vec<&Vec<Corner>> = [&on, &back].into_iter().chain(others).collect();
        let is_free = |from: &Corner, to: &Corner| {
            let mut end = to.at;
            end[k] = near(end[k], from.at[k]);
            let ends = [from.vertex, to.vertex];
            !loops.iter().any(|l| {
                (0..l.len()).any(|i| {
                    let (p, q) = (&l[i], &l[(i + 1) % l.len()]);
                    // Sides at the ends of the bridge touch it, which is no crossing.
                    if ends.contains(&p.vertex) || ends.contains(&q.vertex) {
                        return false;
                    }
                    let mut a = p.at;
                    a[k] = near(a[k], from.at[k]);
                    let mut b = q.at;
                    b[k] = near(b[k], a[k]);
                    [-period, 0.0, period].into_iter().any(|s| {
                        let moved = |mut x: [f64; 2]| {
                            x[k] += s;
                            x
                        };
                        segments_cross(from.at, end, moved(a), moved(b))
                    })
                })
            })
        };
        // Each test visits all sides, so there are fewer tests for long loops.
        let sides: usize = loops.iter().map(|l| l.len()).sum();
        let tests = (MAX_BRIDGE_TESTS / sides.max(1)).clamp(1, 20_000);
        let bridge = pairs.iter().take(tests).find(|(_, i, j)| is_free(&on[*i], &back[*j]));
        let Some(&(_, i, j)) = bridge else {
            return Err(Error::unsupported("no bridge between the loops around the surface was found"));
        };
        // Along the first loop for one period, over the bridge, back along the second loop, and over the
        // bridge again. Both sides of the bridge have the same vertices, a period apart.
        let unrolled = |ring: &[Corner], from: usize, start: f64, way: f64| {
            let mut last = start;
            let mut found = Vec::with_capacity(ring.len() + 1);
            for step in 0..=ring.len() {
                let mut corner = ring[(from + step) % ring.len()];
                corner.at[k] = match step {
                    0 => start,
                    _ if step == ring.len() => start + way * period,
                    _ => near(corner.at[k], last),
                };
                last = corner.at[k];
                found.push(corner);
            }
            found
        };
        let from = on[i].at;
        let mut to = back[j].at;
        to[k] = near(to[k], from[k]);
        let n = self.pieces(from, to, 1);
        let between: Vec<Corner> = (1..n)
            .map(|step| {
                let at = [0, 1].map(|c| from[c] + (to[c] - from[c]) * step as f64 / n as f64);
                let vertex = self.add(at);
                Corner { vertex, at }
            })
            .collect();
        let mut polygon = unrolled(&on, i, from[k], 1.0);
        polygon.extend(between.iter().map(|c| {
            let mut shifted = *c;
            shifted.at[k] += period;
            shifted
        }));
        polygon.extend(unrolled(&back, j, to[k] + period, -1.0));
        polygon.extend(between.iter().rev());
        Ok(polygon)
    }

    /// Mean lengths of the derivatives of the surface along the polygons.
    fn steps(&self, polygons: &[Vec<Corner>]) -> [f64; 2] {
        let corners: Vec<&Corner> = polygons.iter().flatten().collect();
        let mut sums = [0.0; 2];
        let mut counts = [0.0_f64; 2];
        for corner in corners.iter().step_by(corners.len().div_ceil(100).max(1)) {
            // At a pole, a derivative is zero and says nothing about the size of the face.
            let (_, slopes) = self.surface.at(corner.at);
            for c in 0..2 {
                let length = slopes[c].length();
                if length > 1e-12 {
                    sums[c] += length;
                    counts[c] += 1.0;
                }
            }
        }
        [0, 1].map(|c| if sums[c] > 0.0 { sums[c] / counts[c] } else { 1.0 })
    }
}

/// Minimum and maximum of a parameter along a loop.
fn extent(corners: &[Corner], k: usize) -> (f64, f64) {
    corners.iter().fold((f64::MAX, f64::MIN), |(lo, hi), c| (lo.min(c.at[k]), hi.max(c.at[k])))
}

/// For loops around v: an ascending high loop and a descending low one, so that the face is on their left.
fn reversed_pair(mut low: Vec<Corner>, mut high: Vec<Corner>) -> [Vec<Corner>; 2] {
    low.reverse();
    high.reverse();
    [high, low]
}
