//! Places: the leaf over parameters, parameters of a leaf, and steps from one place to another.
//!
//! Over quads, `u` is the number of the quad plus the place along its first side. A step across an edge
//! continues in the frame of the next quad.

use super::cell_tree::Unsplit;
use super::quads::PIECE_LEVELS;
use super::{Cell, Hierarchy, Topology, grid};
use crate::quad_domain::{Level, PIECES, from_edge, to_edge};

/// Maximum number of edges that a step crosses.
const MAX_CROSSINGS: usize = 16;

/// Moves a parameter into `[0, n]`. The test comes first, because almost all are inside and a remainder is
/// slow.
#[inline]
fn wrap_or_clamp(x: f64, n: f64, periodic: bool) -> f64 {
    if (0.0..n).contains(&x) {
        x
    } else if periodic {
        x.rem_euclid(n)
    } else {
        x.clamp(0.0, n)
    }
}

impl Hierarchy {
    /// The leaf that contains `(u, v)`, and the local coordinates in it. Periodic parameters are wrapped,
    /// others are clamped.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, Shape};
    ///
    /// let space = Hierarchy::uniform(Shape::Tube, [8, 4])?;
    /// let (leaf, local) = space.locate(9.25, 0.5); // u is periodic: 9.25 is 1.25
    /// assert_eq!(space.parameters(leaf, local), [1.25, 0.5]);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[inline]
    #[must_use]
    pub fn locate(&self, u: f64, v: f64) -> (usize, [f64; 2]) {
        let (cell, local) = self.cells.at(self.wrap(u, v));
        match cell {
            Unsplit::Leaf(leaf) => (leaf, local),
            Unsplit::Pieces(first) => {
                let [x, y] = local.map(|x| x * PIECES as f64);
                let [column, row] = [x, y].map(|x| (x as usize).min(PIECES - 1));
                (first + row * PIECES + column, [x - column as f64, y - row as f64])
            }
        }
    }

    /// Moves parameters into the domain: wraps periodic directions, clamps open ones, and continues across
    /// the pole of a ball. To step across the edge of a quad, see [`Hierarchy::moved`].
    #[inline]
    #[must_use]
    pub fn wrap(&self, mut u: f64, mut v: f64) -> [f64; 2] {
        let [nu, nv] = self.extent();
        if self.polar() {
            if v < 0.0 {
                v = -v;
                u += nu / 2.0;
            } else if v > nv {
                v = 2.0 * nv - v;
                u += nu / 2.0;
            }
        }
        [wrap_or_clamp(u, nu, self.periodic_u()), wrap_or_clamp(v, nv, self.periodic_v())]
    }

    /// Parameters of a leaf-local point.
    #[must_use]
    pub fn parameters(&self, leaf: usize, local: [f64; 2]) -> [f64; 2] {
        let cell = self.leaves[leaf];
        let side = cell.side();
        let [u, v] = [(f64::from(cell.i) + local[0]) * side, (f64::from(cell.j) + local[1]) * side];
        match self.topology {
            Topology::Grid(_) => [u, v],
            Topology::Quads(_) => {
                let quad = (f64::from(cell.i) * side).floor();
                in_quad(quad as u32, [u - quad, v])
            }
        }
    }

    /// The leaf that equals or contains a cell; `None` if the cell is split.
    #[must_use]
    pub fn leaf_over(&self, cell: Cell) -> Option<usize> {
        let (own, unsplit) = self.cells.over(cell);
        match unsplit? {
            Unsplit::Leaf(leaf) => Some(leaf),
            Unsplit::Pieces(first) => {
                let finer = (cell.level - own.level).checked_sub(PIECE_LEVELS)?;
                let [column, row] = [cell.i, cell.j].map(|x| (x >> finer) as usize % PIECES);
                Some(first + row * PIECES + column)
            }
        }
    }

    /// The unsplit cell at an extraordinary vertex that contains a leaf.
    pub(super) fn cell_of_piece(&self, leaf: Cell) -> Option<Cell> {
        let (own, unsplit) = self.cells.over(leaf);
        matches!(unsplit, Some(Unsplit::Pieces(_))).then_some(own)
    }

    /// Parameters after a step, across edges of quads too. Steps end at borders.
    ///
    /// After an edge is crossed, directions are those of the next quad.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, QuadDomain, Shape};
    /// let tube = Hierarchy::uniform(Shape::Tube, [8, 4])?;
    /// assert_eq!(tube.moved([7.5, 1.0], [1.0, 9.0]), [0.5, 4.0]);
    ///
    /// // Two quads; `u` of the first leads into `v` of the second.
    /// let strip = Hierarchy::over(QuadDomain::new(&[[0, 1, 4, 3], [4, 1, 2, 5]])?.into())?;
    /// assert_eq!(strip.moved([0.75, 0.25], [0.5, 0.0]), [1.75, 0.25]);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn moved(&self, at: [f64; 2], step: [f64; 2]) -> [f64; 2] {
        self.moved_until(at, step, |_, _| false)
    }

    /// The same for a step that ends at creases as at borders.
    pub(crate) fn moved_to_crease(&self, at: [f64; 2], step: [f64; 2]) -> [f64; 2] {
        let domain = self.domain();
        self.moved_until(at, step, |quad, side| {
            domain.is_some_and(|domain| domain.is_crease_side(quad, side))
        })
    }

    /// The same for a step that ends at the sides of quads for which `stops` is true.
    fn moved_until(&self, at: [f64; 2], step: [f64; 2], stops: impl Fn(u32, u32) -> bool) -> [f64; 2] {
        let to = [at[0] + step[0], at[1] + step[1]];
        let Some(over) = self.quads() else { return self.wrap(to[0], to[1]) };
        let mut quad = at[0].clamp(0.0, (self.base[0] - 1) as f64) as u32;
        let mut place = [to[0] - f64::from(quad), to[1]];
        // Each crossing brings the place nearer to the quad. Around an extraordinary vertex it can turn for
        // ever, so the number is limited.
        for _ in 0..MAX_CROSSINGS {
            let beyond = [-place[1], place[0] - 1.0, place[1] - 1.0, -place[0]];
            let farthest = (0..4).max_by(|&a, &b| beyond[a].total_cmp(&beyond[b])).unwrap_or(0);
            if beyond[farthest] <= 0.0 {
                break;
            }
            match over.domain.across(quad, farthest as u32, place, 1.0) {
                Some((next, moved, _)) if (next as usize) < self.base[0] && !stops(quad, farthest as u32) => {
                    (quad, place) = (next, moved);
                }
                _ => place[1 - farthest % 2] = place[1 - farthest % 2].clamp(0.0, 1.0),
            }
        }
        in_quad(quad, place.map(|x| x.clamp(0.0, 1.0)))
    }

    /// The leaf at a place that may lie outside of a given leaf, and the local coordinates there.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, Shape};
    /// let sheet = Hierarchy::uniform(Shape::Sheet, [4, 4])?;
    /// assert_eq!(sheet.locate_near(5, [1.25, 0.5]), (6, [0.25, 0.5]));
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn locate_near(&self, leaf: usize, local: [f64; 2]) -> (usize, [f64; 2]) {
        let [u, v] = match self.topology {
            Topology::Grid(_) => self.parameters(leaf, local),
            Topology::Quads(_) => {
                let side = self.leaves[leaf].side();
                self.moved(self.parameters(leaf, [0.5; 2]), local.map(|x| (x - 0.5) * side))
            }
        };
        self.locate(u, v)
    }

    /// The cell of the same size across a side (0 bottom, 1 right, 2 top, 3 left) of a cell; none at a
    /// border.
    pub(crate) fn across_side(&self, cell: Cell, side: u32) -> Option<CellAcross> {
        let Cell { level, i, j } = cell;
        let along_u = side.is_multiple_of(2);
        let [di, dj] = [[0, -1], [1, 0], [0, 1], [-1, 0]][side as usize];
        let [columns, rows] = grid(self.base, usize::from(level)).map(|n| n as i64);
        let to = [i64::from(i) + di, i64::from(j) + dj];
        let (to, along_u, reversed) = match &self.topology {
            Topology::Grid(_) => {
                let inside = |x: i64, n: i64, periodic: bool| match periodic {
                    true => Some(x.rem_euclid(n)),
                    false => (0..n).contains(&x).then_some(x),
                };
                let i = inside(to[0], columns, self.periodic_u())?;
                ([i, inside(to[1], rows, self.periodic_v())?], along_u, false)
            }
            Topology::Quads(over) => {
                let n = 1_i64 << level;
                let quad = i >> level;
                let first = i64::from(quad) << level;
                if (0..n).contains(&(to[0] - first)) && (0..n).contains(&to[1]) {
                    (to, along_u, false)
                } else {
                    let middle = [to[0] - first, to[1]].map(|x| x as f64 + 0.5);
                    let (next, at, of_next) = over.domain.across(quad, side, middle, n as f64)?;
                    if next as usize >= self.base[0] {
                        return None;
                    }
                    let to = [(i64::from(next) << level) + at[0] as i64, at[1] as i64];
                    // Both quads pass their common side counter-clockwise, so in opposite directions; along
                    // the last two sides, parameters run against that.
                    (to, of_next.is_multiple_of(2), (side < 2) == (of_next < 2))
                }
            }
        };
        Some(CellAcross { cell: Cell { level, i: to[0] as u32, j: to[1] as u32 }, along_u, reversed })
    }

    /// A number for the point at a place of the grid of a level, the same in all cells that share it. A point
    /// at a pole has a number for each column.
    #[must_use]
    pub fn point_number(&self, level: usize, cell: Cell, [x, y]: [u64; 2]) -> u64 {
        match &self.topology {
            Topology::Grid(_) => {
                let [columns, rows] = grid(self.base, level).map(|n| n as u64);
                let x = if self.periodic_u() { x % columns } else { x };
                let y = if self.periodic_v() { y % rows } else { y };
                y * (columns + 1) + x
            }
            Topology::Quads(over) => {
                let quad = cell.i >> cell.level;
                let first = u64::from(quad) << level;
                let at = [(x - first) as i64, y as i64];
                Level::new(&over.domain, level).vertex(quad, at).unwrap_or_default() as u64
            }
        }
    }

    /// For each side of the leaf in which parameters lie, in the order left, right, bottom, top: true if they
    /// lie on a border there.
    pub(crate) fn on_border(&self, at: [f64; 2]) -> [bool; 4] {
        let Some(over) = self.quads() else {
            let open = [!self.periodic_u(), !self.periodic_v() && !self.polar()];
            let extent = self.extent();
            return [
                open[0] && at[0] <= 0.0,
                open[0] && at[0] >= extent[0],
                open[1] && at[1] <= 0.0,
                open[1] && at[1] >= extent[1],
            ];
        };
        let (quad, touches) = self.touched_sides(at);
        let beyond = SIDES.map(|side| over.domain.across(quad, side, [0.0; 2], 1.0));
        std::array::from_fn(|k| {
            touches[k] && beyond[k].is_none_or(|(next, ..)| next as usize >= self.base[0])
        })
    }

    /// The same for creases.
    pub(crate) fn on_crease(&self, at: [f64; 2]) -> [bool; 4] {
        let Some(domain) = self.domain().filter(|domain| !domain.creases().is_empty()) else {
            return [false; 4];
        };
        let (quad, touches) = self.touched_sides(at);
        std::array::from_fn(|k| touches[k] && domain.is_crease_side(quad, SIDES[k]))
    }

    /// True if a side of a leaf lies on a crease: the one at which its local coordinate `axis` is 0, or 1 if
    /// `at_end`.
    ///
    /// # Examples
    /// ```
    /// use planish_spline::{Hierarchy, QuadDomain};
    /// let cells = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6]];
    /// let space = Hierarchy::over(QuadDomain::with_creases(&cells, &[[1, 5]], &[])?.into())?;
    /// assert!(space.is_at_crease(0, 0, true) && space.is_at_crease(1, 0, false));
    /// assert!(!space.is_at_crease(0, 0, false) && !space.is_at_crease(2, 0, false));
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    #[must_use]
    pub fn is_at_crease(&self, leaf: usize, axis: usize, at_end: bool) -> bool {
        let Some(domain) = self.domain().filter(|domain| !domain.creases().is_empty()) else {
            return false;
        };
        let Cell { level, i, j } = self.leaves[leaf];
        let in_quad = [i & ((1 << level) - 1), j][axis];
        let is_outer = if at_end { in_quad + 1 == 1 << level } else { in_quad == 0 };
        is_outer && domain.is_crease_side(i >> level, SIDES[2 * axis + usize::from(at_end)])
    }

    /// The quad in which parameters lie, and which of its sides they touch, in the order of [`SIDES`].
    fn touched_sides(&self, at: [f64; 2]) -> (u32, [bool; 4]) {
        let quad = (at[0] as u32).min(self.base[0] as u32 - 1);
        let end = in_quad(quad, [1.0, 0.0])[0];
        (quad, [at[0] <= f64::from(quad), at[0] >= end, at[1] <= 0.0, at[1] >= 1.0])
    }

    /// For each crease on a side of the quad in which parameters lie: the nearest parameters on it, and the
    /// same place in the quad across it.
    pub(crate) fn across_creases(&self, at: [f64; 2]) -> Vec<[[f64; 2]; 2]> {
        let Some(domain) = self.domain() else { return Vec::new() };
        let (quad, _) = self.touched_sides(at);
        let place = [(at[0] - f64::from(quad)).clamp(0.0, 1.0), at[1]];
        let creases = (0..4).filter(|&side| domain.is_crease_side(quad, side));
        creases
            .filter_map(|side| {
                let on = from_edge(side, [to_edge(side, place, 1.0)[0], 0.0], 1.0);
                let (next, to, _) = domain.across(quad, side, on, 1.0)?;
                Some([in_quad(quad, on), in_quad(next, to.map(|x| x.clamp(0.0, 1.0)))])
            })
            .collect()
    }
}

/// The sides of a quad in the order left, right, bottom, top.
const SIDES: [u32; 4] = [3, 1, 0, 2];

/// A cell across a side of another one.
pub(crate) struct CellAcross {
    pub(crate) cell: Cell,
    /// True if its u runs along the common side.
    pub(crate) along_u: bool,
    /// True if its parameter along the common side runs against that of the first cell.
    pub(crate) reversed: bool,
}

/// Parameters of a place in a quad. The right side of a quad belongs to it, not to the next one.
pub(super) fn in_quad(quad: u32, [x, y]: [f64; 2]) -> [f64; 2] {
    let end = f64::from(quad + 1).next_down();
    [(f64::from(quad) + x).min(end), y]
}
