//! Points within a face: a lattice of parameters with a spacing that follows from the curvature and the
//! maximum side length.
//!
//! A triangulation of the boundary alone needs many refinements on curved faces, and its triangles are long.

use super::outline::Outline;
use super::{Fineness, ParametricSurface};
use crate::tessellation::fill::too_many_points;
use crate::tessellation::polygon::Corner;
use planish_core::{BoundingBox, DVec3, Setting};
use planish_estimate::{Error, Result};

/// Number of intervals along each parameter at which second differences are taken.
const PROBES: usize = 24;
/// Minimum distance of lattice points from the boundary, relative to the spacing.
///
/// A smaller value makes slivers along the boundary; a larger one leaves wide triangles there.
const MIN_BORDER_DISTANCE: f64 = 0.4;
/// Share of the samples whose curvature the lattice resolves. Triangles in the remaining, more curved places
/// are refined.
///
/// With 1, a single sharp fillet would make the whole lattice fine.
const RESOLVED_SHARE: f64 = 0.75;

/// Points on a lattice within an outline. New vertices are appended to the positions.
///
/// # Errors
/// `Unsupported` if there would be more than `limit` points.
pub(super) fn seeds(
    surface: &ParametricSurface,
    outline: &Outline,
    fineness: &Fineness,
    limit: usize,
    positions: &mut Vec<DVec3>,
) -> Result<Vec<Corner>> {
    let steps = outline.steps;
    let bounds: BoundingBox<[f64; 2]> = outline.polygons.iter().flatten().map(|corner| corner.at).collect();
    let (BoundingBox { min: lo, max: hi }, width) = (bounds, bounds.extent());
    let spacing = spacings(surface, lo, hi, steps, fineness);
    let n = [0, 1].map(|c| (width[c] / spacing[c]).ceil().clamp(1.0, 1e6) as usize);
    if n[0].saturating_mul(n[1]) > limit {
        return Err(too_many_points(n[0].saturating_mul(n[1])));
    }
    let cell = [0, 1].map(|c| width[c] / n[c] as f64);
    let apart = MIN_BORDER_DISTANCE * cell[0].min(cell[1]);
    let mut found = Vec::new();
    let mut rows = Rows::new(&outline.polygons, apart);
    for j in 1..n[1] {
        let y = lo[1] + cell[1] * j as f64;
        let row = rows.next(y, lo[0], cell[0], n[0])?;
        for i in 1..n[0] {
            let at = [lo[0] + cell[0] * i as f64, y];
            // Inside if an odd number of sides lies to the right.
            let is_inside = (row.crossings.len() - row.crossings.partition_point(|x| *x <= at[0])) % 2 == 1;
            if is_inside && !row.is_near[i] {
                let vertex = positions.len() as u32;
                positions.push(surface.point([at[0] / steps[0], at[1] / steps[1]]));
                found.push(Corner { vertex, at });
            }
        }
    }
    Ok(found)
}

/// Spacings of the lattice, as lengths: the error of a chord of length h is |S''| h²/8.
fn spacings(
    surface: &ParametricSurface,
    lo: [f64; 2],
    hi: [f64; 2],
    steps: [f64; 2],
    fineness: &Fineness,
) -> [f64; 2] {
    [0, 1].map(|c| {
        let width = hi[c] - lo[c];
        let mut allowed = fineness.longest.min(width);
        if surface.is_plane() || width <= 0.0 {
            return allowed.max(f64::MIN_POSITIVE);
        }
        let h = width / PROBES as f64;
        let at = |along: f64, across: f64| {
            let mut at = [0.0; 2];
            at[c] = lo[c] + along;
            at[1 - c] = lo[1 - c] + (hi[1 - c] - lo[1 - c]) * across;
            surface.point([at[0] / steps[0], at[1] / steps[1]])
        };
        let mut bends = Vec::with_capacity(5 * PROBES);
        // Not at 0 and 1, where poles have no curvature.
        for across in [0.03, 0.25, 0.5, 0.75, 0.97] {
            let line: Vec<DVec3> = (0..=PROBES).map(|k| at(h * k as f64, across)).collect();
            for t in line.windows(3) {
                bends.push((t[0] - 2.0 * t[1] + t[2]).length() / (h * h));
            }
        }
        bends.sort_by(f64::total_cmp);
        let bend = bends[(RESOLVED_SHARE * (bends.len() - 1) as f64) as usize];
        if bend > 0.0 {
            // Half of the chord error for each direction, as both errors add up.
            allowed = allowed.min((8.0 * 0.5 * fineness.chord / bend).sqrt());
        }
        // At least one lattice line for each polynomial piece: second differences may miss a short piece.
        let pieces = surface.breaks(c).len().saturating_sub(1).max(1);
        let extent = surface.domain()[c].map_or(width, |d| (d[1] - d[0]) * steps[c]);
        if bend > 0.0 && pieces > 1 {
            allowed = allowed.min(extent / pieces as f64);
        }
        allowed.max(1e-6 * width)
    })
}

/// Maximum number of tests of a side against a row or a lattice point, about two seconds.
///
/// Only a polygon of very many sides that all run along a long and thin face needs more.
const MAX_TESTS: usize = 200_000_000;

/// Sweeps rows of a lattice over the sides of polygons, so that each row visits only sides near it.
struct Rows {
    /// Sides that no row has reached, by descending lower end.
    waiting: Vec<[[f64; 2]; 2]>,
    /// Sides near the current row.
    near: Vec<[[f64; 2]; 2]>,
    apart: f64,
    tests: usize,
}

/// The sides at one row.
struct Row {
    /// Where sides cross the row, ascending.
    crossings: Vec<f64>,
    /// For each lattice point of the row, true if a side is nearer than allowed.
    is_near: Vec<bool>,
}

impl Rows {
    fn new(polygons: &[Vec<Corner>], apart: f64) -> Self {
        let sides =
            polygons.iter().flat_map(|p| (0..p.len()).map(move |k| [p[k].at, p[(k + 1) % p.len()].at]));
        let mut waiting: Vec<[[f64; 2]; 2]> = sides.collect();
        waiting.sort_by(|[a, b], [c, d]| c[1].min(d[1]).total_cmp(&a[1].min(b[1])));
        Self { waiting, near: Vec::new(), apart, tests: 0 }
    }

    /// The row at `y`, which must not decrease; its lattice points are `count` steps apart from `start`.
    fn next(&mut self, y: f64, start: f64, step: f64, count: usize) -> Result<Row> {
        let (low, high) = (y - self.apart, y + self.apart);
        while let Some([a, b]) = self.waiting.pop_if(|[a, b]| a[1].min(b[1]) <= high) {
            self.near.push([a, b]);
        }
        self.near.retain(|[a, b]| a[1].max(b[1]) >= low);
        let mut row = Row { crossings: Vec::new(), is_near: vec![false; count] };
        for side in &self.near {
            let [a, b] = *side;
            if (a[1] > y) != (b[1] > y) {
                row.crossings.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
            // Only the part of the side near the row can be near its points.
            let share = |level: f64| ((level - a[1]) / (b[1] - a[1])).clamp(0.0, 1.0);
            let ends = if a[1] == b[1] { [0.0, 1.0] } else { [share(low), share(high)] };
            let [p, q] = ends.map(|share| a[0] + share * (b[0] - a[0]));
            let index = |x: f64| (x - start) / step;
            let first = index(p.min(q) - self.apart).floor().max(1.0) as usize;
            let last = (index(p.max(q) + self.apart).ceil().max(0.0) as usize).min(count - 1);
            self.tests += 1 + (last + 1).saturating_sub(first);
            for i in first..=last {
                row.is_near[i] |= off(*side, [start + step * i as f64, y]) <= self.apart;
            }
        }
        row.crossings.sort_by(f64::total_cmp);
        match self.tests > MAX_TESTS {
            true => Err(Error::unsupported("its loops have too many sides for its shape")
                .with_setting(Setting::MeshTolerance)),
            false => Ok(row),
        }
    }
}

/// Distance of a point from a side.
fn off([a, b]: [[f64; 2]; 2], p: [f64; 2]) -> f64 {
    let d = [b[0] - a[0], b[1] - a[1]];
    let r = [p[0] - a[0], p[1] - a[1]];
    let square = (d[0] * d[0] + d[1] * d[1]).max(f64::MIN_POSITIVE);
    let share = ((r[0] * d[0] + r[1] * d[1]) / square).clamp(0.0, 1.0);
    (r[0] - share * d[0]).hypot(r[1] - share * d[1])
}
