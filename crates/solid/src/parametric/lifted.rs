//! Projects loops of mesh vertices to the parameters of a surface, point by point.

use super::surface::{Feet, Pole};
use crate::tessellation::polygon::Corner;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// Maximum distance of a point that counts as a pole, relative to the size of its loop.
///
/// Near a pole, one parameter has large errors; a smaller value would use it for inaccurate files.
const AT_POLE: f64 = 1e-6;
/// Maximum distance of edges from the surface, relative to the size of their loop.
///
/// A larger value accepts edges of another surface; a smaller one rejects faces of inaccurate files.
const MAX_OFF: f64 = 1e-3;

/// A loop of vertices, with the face on its left seen against the normal of the surface.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub(super) vertices: Vec<u32>,
    /// The edge from each vertex to the next.
    pub(super) along: Vec<usize>,
}

impl Ring {
    /// Reverses the direction of the loop.
    pub(super) fn reverse(&mut self) {
        self.vertices.reverse();
        // `along[k]` leads from vertex k to the next one, which is another one after the reversal.
        self.along.reverse();
        self.along.rotate_left(1);
    }

    /// Removes vertices that equal the next one, as edges without length leave them. At least one is kept.
    pub(super) fn remove_repeated(&mut self) {
        let n = self.vertices.len();
        let mut kept: Vec<usize> =
            (0..n).filter(|k| self.vertices[*k] != self.vertices[(k + 1) % n]).collect();
        if kept.is_empty() && n > 0 {
            kept.push(n - 1);
        }
        // Of many, in one pass: removing them one by one takes quadratic time.
        self.vertices = kept.iter().map(|k| self.vertices[*k]).collect();
        self.along = kept.iter().map(|k| self.along[*k]).collect();
    }

    /// True if the loop uses an edge twice, once in each direction.
    pub(super) fn has_seam(&self) -> bool {
        let mut edges = self.along.clone();
        edges.dedup();
        if edges.len() > 1 && edges.first() == edges.last() {
            edges.pop();
        }
        let n = edges.len();
        edges.sort_unstable();
        edges.dedup();
        edges.len() < n
    }
}

/// A loop in parameters, which are continuous: they do not jump by a period from corner to corner.
#[derive(Debug, Clone)]
pub(super) struct Lifted {
    pub(super) corners: Vec<Corner>,
    /// Number of periods by which the parameters differ after one round.
    pub(super) windings: [i32; 2],
}

/// Projects loops to the parameters of one surface.
pub(super) struct Lifter<'a> {
    pub(super) feet: Feet<'a>,
    pub(super) periods: [Option<f64>; 2],
    pub(super) poles: Vec<Pole>,
    /// Distance below which a foot point is accepted without a search of the whole surface.
    pub(super) close: f64,
}

impl Lifter<'_> {
    /// Projects a loop. Each point starts from the parameters of the previous one.
    ///
    /// # Errors
    /// `Unsupported` if the loop leaves the surface, or contains only poles.
    pub(super) fn lift(&mut self, ring: &Ring, positions: &[DVec3]) -> Result<Lifted> {
        let points: Vec<DVec3> = ring.vertices.iter().map(|v| positions[*v as usize]).collect();
        let n = points.len();
        let size = points.iter().map(|p| p.distance(points[0])).fold(0.0, f64::max);
        let pole_at = |p: DVec3| self.poles.iter().find(|pole| p.distance(pole.point) <= AT_POLE * size);
        let at_pole: Vec<Option<Pole>> = points.iter().map(|p| pole_at(*p).copied()).collect();
        // At a pole, one parameter is undetermined, so the loop begins at another point. A pole gets two
        // corners: with the parameter of the point before it, and with that of the point after it.
        let Some(start) = at_pole.iter().position(Option::is_none) else {
            return Err(Error::unsupported("a loop consists only of poles of the surface"));
        };
        // A search for the foot of a far point visits the whole surface, and a wrong control point makes a
        // loop of thousands of them. The farthest one alone shows that.
        let away = |k: &usize| points[*k].distance(points[start]);
        let farthest = (0..n).filter(|k| at_pole[*k].is_none()).max_by(|a, b| away(a).total_cmp(&away(b)));
        if let Some(farthest) = farthest {
            self.foot(points[farthest], None, size)?;
        }
        let mut corners: Vec<Corner> = Vec::with_capacity(n);
        let mut first = [0.0; 2];
        for step in 0..=n {
            let k = (start + step) % n;
            let vertex = ring.vertices[k];
            let last = corners.last().map(|c| c.at);
            if let Some(pole) = at_pole[k] {
                let mut at = last.unwrap_or_default();
                at[pole.constant] = pole.value;
                corners.push(Corner { vertex, at });
                continue;
            }
            // The previous parameters are the guess: on a surface that passes nearby twice, the loop then
            // stays on its part.
            let mut at = self.foot(points[k], last, size)?;
            let before = (k + n - 1) % n;
            if let (Some(pole), Some(last)) = (at_pole[before], last) {
                let is_seam = ring.along[before] == ring.along[(before + n - 1) % n];
                at[1 - pole.constant] = self.leaving_parameter(&pole, last, at, is_seam);
                let mut again = at;
                again[pole.constant] = pole.value;
                corners.push(Corner { vertex: ring.vertices[before], at: again });
            } else if let Some(last) = last {
                at = self.near(last, at);
            }
            match step {
                0 => first = at,
                _ if step == n => {
                    let windings = [0, 1].map(|c| match self.periods[c] {
                        Some(period) => ((at[c] - first[c]) / period).round() as i32,
                        None => 0,
                    });
                    return Ok(Lifted { corners, windings });
                }
                _ => {}
            }
            corners.push(Corner { vertex, at });
        }
        Err(Error::unsupported("a loop does not close"))
    }

    /// Parameters of the foot point of a point.
    fn foot(&mut self, p: DVec3, guess: Option<[f64; 2]>, size: f64) -> Result<[f64; 2]> {
        let at = self.feet.foot(p, guess, self.close);
        let off = p.distance(self.feet.surface().point(at));
        match off <= (MAX_OFF * size).max(100.0 * self.close) {
            true => Ok(at),
            false => Err(Error::unsupported(format!("a loop is {off:.3e} off its surface"))),
        }
    }

    /// Parameters shifted by whole periods to be nearest to others.
    fn near(&self, last: [f64; 2], at: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|c| match self.periods[c] {
            Some(period) => at[c] - period * ((at[c] - last[c]) / period).round(),
            None => at[c],
        })
    }

    /// The free parameter at which a loop leaves a pole.
    ///
    /// The face is on the left of the loop, which determines the direction along the pole. At a seam the loop
    /// goes along the whole pole; else, equal parameters mean that it does not move along it.
    fn leaving_parameter(&self, pole: &Pole, last: [f64; 2], at: [f64; 2], is_seam: bool) -> f64 {
        let k = 1 - pole.constant;
        let Some(period) = self.periods[k] else {
            return at[k];
        };
        let way = if pole.is_low == (k == 0) { 1.0 } else { -1.0 };
        let along = (way * (at[k] - last[k])).rem_euclid(period);
        let is_none = along < 1e-6 * period || along > (1.0 - 1e-6) * period;
        let along = match (is_none, is_seam) {
            (true, true) => period,
            (true, false) => 0.0,
            (false, _) => along,
        };
        last[k] + way * along
    }
}
