//! Columns: the sequence of cells along a line of sight.

use super::cells::Cells;
use planish_core::DVec3;

/// A place at which a line of sight passes from one cell into another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Break {
    /// Coordinate along the line of sight, ascending away from the eye (negated if the axis points to it).
    pub(crate) depth: f64,
    pub(crate) surface: SurfaceId,
    /// The cell behind.
    pub(crate) cell: u32,
}

/// A surface that may bound the solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum SurfaceId {
    /// The plane of a grid line: axis and index.
    Grid(usize, usize),
    /// The surface seen edge-on along a carrier: index of the view and of the carrier.
    Carrier(usize, usize),
    /// A wall, by its index.
    Wall(usize),
    /// The cutting plane of a section.
    Cut,
}

/// The cells along a line of sight. The first is `start`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Column {
    pub(crate) start: u32,
    pub(crate) breaks: Vec<Break>,
}

impl Cells<'_> {
    /// Follows the line of sight of a view through a point of it.
    pub(crate) fn column(&self, view: usize, q: [f64; 2]) -> Column {
        let plan = self.plan;
        let kind = plan.views[view].kind;
        let [right, up, along] = kind.axes();
        let mut cell = [0; 3];
        cell[right] = plan.interval(right, q[0]);
        cell[up] = plan.interval(up, q[1]);
        let mut p = DVec3::ZERO;
        (p[right], p[up]) = (q[0], q[1]);
        let count = plan.intervals(along);
        let mut sequence: Vec<(f64, SurfaceId, u32)> = Vec::new();
        for k in 0..count {
            cell[along] = k;
            let (lo, hi) = (plan.grid[along][k], plan.grid[along][k + 1]);
            let mut cuts = self.cuts(cell, along, p);
            cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut from = (lo, SurfaceId::Grid(along, k));
            for n in 0..=cuts.len() {
                let to = cuts.get(n).map_or(hi, |c| c.0);
                // The cell is that of the middle, because the ends lie on surfaces.
                p[along] = (from.0 + to) / 2.0;
                let atom = self.at_in(cell, p);
                if !self.is_sliver(cell, to - from.0, atom) {
                    sequence.push((from.0, from.1, atom));
                }
                if let Some(cut) = cuts.get(n) {
                    from = *cut;
                }
            }
        }
        if !kind.depth_increases_away() {
            // Seen from the other end, a cell begins where it ended before.
            let mut turned = Vec::with_capacity(sequence.len());
            for n in (0..sequence.len()).rev() {
                let (depth, surface) = match sequence.get(n + 1) {
                    Some(next) => (-next.0, next.1),
                    None => (f64::MIN, SurfaceId::Grid(along, count)),
                };
                turned.push((depth, surface, sequence[n].2));
            }
            sequence = turned;
        }
        if let Some((at, _)) = &plan.views[view].cut {
            self.cut_away(&mut sequence, if kind.depth_increases_away() { *at } else { -at });
        }
        let start = sequence[0].2;
        let mut last = start;
        let mut breaks = Vec::new();
        // Neighbouring intervals of one cell are not separated: a surface between them is no boundary here.
        for (depth, surface, cell) in sequence.into_iter().skip(1) {
            if cell != last {
                breaks.push(Break { depth, surface, cell });
                last = cell;
            }
        }
        Column { start, breaks }
    }

    /// Replaces the cells before a cutting plane by the cell around the part.
    fn cut_away(&self, sequence: &mut Vec<(f64, SurfaceId, u32)>, at: f64) {
        // An interval that ends at the plane is before it, although rounding may put its end behind.
        let near = 5.0 * self.plan.tolerance;
        let first = (1..sequence.len()).find(|n| sequence[*n].0 > at + near).unwrap_or(sequence.len()) - 1;
        sequence.drain(..first);
        (sequence[0].0, sequence[0].1) = (at, SurfaceId::Cut);
        sequence.insert(0, (f64::MIN, SurfaceId::Cut, self.outside()));
    }
}
