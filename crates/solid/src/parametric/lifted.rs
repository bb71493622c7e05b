//! Loops of mesh vertices, brought to the parameters of a surface point by point.

use super::surface::{Feet, Pole};
use crate::tessellation::polygon::Corner;
use planish_estimate::vector3::distance;
use planish_estimate::{Error, Result};

/// A point this near to a pole, of its loop's size, is it.
const AT_POLE: f64 = 1e-6;
/// Edges may be off the surface by this much of their loop's size.
const MAX_OFF: f64 = 1e-3;

/// A loop of vertices, the face to its left along the surface's normal.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub(super) vertices: Vec<u32>,
    /// The edge from each vertex to the next.
    pub(super) along: Vec<usize>,
}

impl Ring {
    /// The other way round.
    pub(super) fn reverse(&mut self) {
        self.vertices.reverse();
        self.along.reverse();
        self.along.rotate_left(1);
    }

    /// Whether it runs along an edge twice, once each way.
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

/// A loop in parameters, which do not jump by a period from corner to corner.
#[derive(Debug, Clone)]
pub(super) struct Lifted {
    pub(super) corners: Vec<Corner>,
    /// Periods between the last corner's successor and the first.
    pub(super) windings: [i32; 2],
}

/// What loops are lifted to.
pub(super) struct Lifter<'a> {
    pub(super) feet: Feet<'a>,
    pub(super) periods: [Option<f64>; 2],
    pub(super) poles: Vec<Pole>,
    /// A foot that is this near is that of its point.
    pub(super) close: f64,
}

impl Lifter<'_> {
    /// A loop in parameters.
    ///
    /// # Errors
    /// `Unsupported` where it leaves the surface, or is at poles alone.
    pub(super) fn lift(&mut self, ring: &Ring, positions: &[[f64; 3]]) -> Result<Lifted> {
        let points: Vec<[f64; 3]> = ring.vertices.iter().map(|v| positions[*v as usize]).collect();
        let n = points.len();
        let size = points.iter().map(|p| distance(*p, points[0])).fold(0.0, f64::max);
        let pole_at = |p: [f64; 3]| self.poles.iter().find(|pole| distance(p, pole.point) <= AT_POLE * size);
        let at_pole: Vec<Option<Pole>> = points.iter().map(|p| pole_at(*p).copied()).collect();
        let Some(start) = at_pole.iter().position(Option::is_none) else {
            return Err(Error::unsupported("a loop of it has no point off the surface's poles"));
        };
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
            let mut at = self.foot(points[k], last, size)?;
            let before = (k + n - 1) % n;
            if let (Some(pole), Some(last)) = (at_pole[before], last) {
                let is_seam = ring.along[before] == ring.along[(before + n - 1) % n];
                at[1 - pole.constant] = self.past(&pole, last, at, is_seam);
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
        Err(Error::unsupported("a loop of it does not close"))
    }

    fn foot(&mut self, p: [f64; 3], guess: Option<[f64; 2]>, size: f64) -> Result<[f64; 2]> {
        let at = self.feet.foot(p, guess, self.close);
        let off = distance(p, self.feet.surface().point(at));
        match off <= (MAX_OFF * size).max(100.0 * self.close) {
            true => Ok(at),
            false => Err(Error::unsupported(format!("a loop of it is {off:.3e} off its surface"))),
        }
    }

    /// Parameters by whole periods nearest to others.
    fn near(&self, last: [f64; 2], at: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|c| match self.periods[c] {
            Some(period) => at[c] - period * ((at[c] - last[c]) / period).round(),
            None => at[c],
        })
    }

    /// Where a loop that went into a pole comes out of it: the face to its left says which way it went along
    /// the pole.
    fn past(&self, pole: &Pole, last: [f64; 2], at: [f64; 2], is_seam: bool) -> f64 {
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
