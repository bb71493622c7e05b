//! Strokes of a page as the curves that a draughtsman meant.
//!
//! Programs and scanners write what is seen: short lines instead of arcs, single dashes instead of dashed
//! lines, single lines instead of hatches. This module joins them again.

mod centres;
mod dashes;
mod dimensions;
mod hatching;
mod smoothing;
#[cfg(test)]
mod tests;

pub(crate) use centres::share_centres;
pub(crate) use dashes::join_dashes;
pub(crate) use dimensions::{add_dimensions_between, lengths_between};
pub(crate) use hatching::take_hatching;
pub(crate) use smoothing::smoothed;

use planish_solid::views::{Curve2, DrawnCurve};
use std::collections::HashMap;

/// A stroke.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stroke {
    pub(crate) drawn: DrawnCurve,
    /// Number of its pen.
    pub(crate) pen: u32,
}

/// How accurate strokes are, in their unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Accuracy {
    /// Maximum error of a coordinate.
    pub(crate) rounding: f64,
    /// Maximum distance of points that are the same.
    pub(crate) position: f64,
    /// Maximum gap between two dashes.
    pub(crate) longest_gap: f64,
}

/// Start and end of a curve.
fn ends(curve: &Curve2) -> [[f64; 2]; 2] {
    match curve {
        Curve2::Segment(a, b) => [*a, *b],
        Curve2::Arc { center, radius, start, sweep } => {
            let at = |angle: f64| [center[0] + radius * angle.cos(), center[1] + radius * angle.sin()];
            [at(*start), at(start + sweep)]
        }
        Curve2::Chain(points) => {
            [points.first().copied().unwrap_or_default(), points.last().copied().unwrap_or_default()]
        }
    }
}

/// Points in square cells, to find those near a place.
struct PointGrid {
    cell: f64,
    cells: HashMap<[i64; 2], Vec<(u32, [f64; 2])>>,
}

impl PointGrid {
    fn new(cell: f64, points: impl IntoIterator<Item = (u32, [f64; 2])>) -> Self {
        let mut cells: HashMap<[i64; 2], Vec<(u32, [f64; 2])>> = HashMap::new();
        for (id, p) in points {
            cells.entry(p.map(|c| (c / cell).floor() as i64)).or_default().push((id, p));
        }
        Self { cell, cells }
    }

    /// Points at most a distance away, with those of the same cells.
    fn around(&self, p: [f64; 2], reach: f64) -> impl Iterator<Item = (u32, [f64; 2])> + '_ {
        let [low, high] = [-reach, reach].map(|r| p.map(|c| ((c + r) / self.cell).floor() as i64));
        (low[0]..=high[0])
            .flat_map(move |x| (low[1]..=high[1]).map(move |y| [x, y]))
            .flat_map(|cell| self.cells.get(&cell).into_iter().flatten().copied())
    }
}
