//! The quadtree of cells over a base grid: which cells are split, and the leaf at each place.
//!
//! Memory and time are proportional to the number of cells, at any depth. A table for each level would have
//! four times the entries of the one above it: cells of level 8 along one edge of a part took 10 s each time
//! its hierarchy was built.
//!
//! Not guaranteed: the order of cells in memory, which depends on the order of splits. Nothing else does.

use super::{Cell, grid};

/// Marks the entry of an unsplit cell; the rest of it is the number of its leaf.
const UNSPLIT: u32 = 1 << 31;
/// Marks the entry of an unsplit cell that has several leaves; the rest of it is the number of the first.
const PIECES: u32 = 1 << 30;

/// The leaves of a cell that is not split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unsplit {
    /// It is this leaf.
    Leaf(usize),
    /// It lies at an extraordinary vertex and has several leaves, row by row from this one on.
    Pieces(usize),
}

impl Unsplit {
    /// From the entry of an unsplit cell.
    #[inline(always)]
    fn of(entry: u32) -> Self {
        let first = (entry & !(UNSPLIT | PIECES)) as usize;
        if entry & PIECES == 0 { Self::Leaf(first) } else { Self::Pieces(first) }
    }
}

/// Split cells over a base grid.
#[derive(Debug, Clone)]
pub(super) struct CellTree {
    base: [usize; 2],
    /// For each cell, the place of its first child, after which the others follow, or the number of its leaf
    /// with a mark. The cells of the base come first, row by row.
    entries: Vec<u32>,
    /// For each level that has any, the split cells in the order in which they were split.
    split: Vec<Vec<Cell>>,
}

impl CellTree {
    /// The cells of a base grid, none of them split.
    pub(super) fn new(base: [usize; 2]) -> Self {
        Self { base, entries: vec![UNSPLIT; base[0] * base[1]], split: Vec::new() }
    }

    /// Number of levels that have cells.
    pub(super) fn levels(&self) -> usize {
        self.split.len() + 1
    }

    /// Number of split cells.
    pub(super) fn split_count(&self) -> usize {
        self.split.iter().map(Vec::len).sum()
    }

    /// The split cells of a level, in no particular order.
    pub(super) fn split_cells(&self, level: usize) -> &[Cell] {
        self.split.get(level).map_or(&[], Vec::as_slice)
    }

    /// All cells of a level, in no particular order.
    pub(super) fn cells(&self, level: usize) -> Vec<Cell> {
        let Some(above) = level.checked_sub(1) else {
            let [columns, rows] = self.base.map(|n| n as u32);
            let row = |j| (0..columns).map(move |i| Cell { level: 0, i, j });
            return (0..rows).flat_map(row).collect();
        };
        self.split_cells(above).iter().flat_map(|&cell| children(cell)).collect()
    }

    /// The place of a cell, or of the unsplit one that contains it, and the level of that one.
    fn find(&self, cell: Cell) -> (usize, u8) {
        let mut place = (cell.j >> cell.level) as usize * self.base[0] + (cell.i >> cell.level) as usize;
        for above in (0..cell.level).rev() {
            let entry = self.entries[place];
            if entry & UNSPLIT != 0 {
                return (place, cell.level - above - 1);
            }
            place = (entry + 2 * (cell.j >> above & 1) + (cell.i >> above & 1)) as usize;
        }
        (place, cell.level)
    }

    /// True if the parent of a cell is split.
    pub(super) fn contains(&self, cell: Cell) -> bool {
        self.find(cell).1 == cell.level
    }

    /// True if a cell exists and is split.
    pub(super) fn is_split(&self, cell: Cell) -> bool {
        self.entries[self.find(cell).0] & UNSPLIT == 0
    }

    /// The cell that equals a given one, or the unsplit one that contains it; and its leaves if it is not
    /// split.
    pub(super) fn over(&self, cell: Cell) -> (Cell, Option<Unsplit>) {
        let (place, level) = self.find(cell);
        let up = cell.level - level;
        let entry = self.entries[place];
        let unsplit = (entry & UNSPLIT != 0).then(|| Unsplit::of(entry));
        (Cell { level, i: cell.i >> up, j: cell.j >> up }, unsplit)
    }

    /// The unsplit cell at a place of the base grid, and the place in it. Places at the upper ends of the
    /// grid belong to the last cells.
    #[inline(always)]
    pub(super) fn at(&self, [u, v]: [f64; 2]) -> (Unsplit, [f64; 2]) {
        let i = (u as usize).min(self.base[0] - 1);
        let j = (v as usize).min(self.base[1] - 1);
        let (mut x, mut y) = (u - i as f64, v - j as f64);
        let mut place = j * self.base[0] + i;
        while self.entries[place] & UNSPLIT == 0 {
            (x, y) = (2.0 * x, 2.0 * y);
            let (right, upper) = (x >= 1.0, y >= 1.0);
            x -= f64::from(u8::from(right));
            y -= f64::from(u8::from(upper));
            place = self.entries[place] as usize + 2 * usize::from(upper) + usize::from(right);
        }
        (Unsplit::of(self.entries[place]), [x, y])
    }

    /// Splits a cell, and those that contain it.
    pub(super) fn split(&mut self, cell: Cell) {
        loop {
            let (place, level) = self.find(cell);
            if self.entries[place] & UNSPLIT == 0 {
                return;
            }
            let up = cell.level - level;
            self.entries[place] = self.entries.len() as u32;
            self.entries.extend([UNSPLIT; 4]);
            if self.split.len() <= usize::from(level) {
                self.split.push(Vec::new());
            }
            self.split[usize::from(level)].push(Cell { level, i: cell.i >> up, j: cell.j >> up });
        }
    }

    /// Splits cells until `required` adds none, from the finest level to the coarsest. It gets a split cell
    /// and names others that must be split, of its own level or the one above.
    pub(super) fn close(&mut self, mut required: impl FnMut(Cell, &mut Vec<Cell>)) {
        let mut also = Vec::new();
        for level in (0..self.split.len()).rev() {
            let mut next = 0;
            // The list grows while its cells are examined.
            while next < self.split[level].len() {
                required(self.split[level][next], &mut also);
                also.drain(..).for_each(|cell| self.split(cell));
                next += 1;
            }
        }
    }

    /// Numbers the leaf that an unsplit cell is, or the first of its pieces.
    pub(super) fn number(&mut self, cell: Cell, first: u32, has_pieces: bool) {
        let (place, _) = self.find(cell);
        self.entries[place] = UNSPLIT | first | if has_pieces { PIECES } else { 0 };
    }

    /// True if a cell lies in the grid of its level.
    pub(super) fn is_inside(&self, cell: Cell) -> bool {
        let [columns, rows] = grid(self.base, usize::from(cell.level));
        (cell.i as usize) < columns && (cell.j as usize) < rows
    }
}

/// The children of a cell, row by row.
pub(super) fn children(Cell { level, i, j }: Cell) -> [Cell; 4] {
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| Cell { level: level + 1, i: 2 * i + x, j: 2 * j + y })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_cells_are_found_at_any_depth() {
        let mut tree = CellTree::new([3, 2]);
        let deep = Cell { level: 11, i: 2 << 11, j: (2 << 11) - 1 };
        tree.split(deep);
        assert_eq!((tree.levels(), tree.split_count()), (13, 12));
        assert!(tree.is_split(deep) && tree.contains(children(deep)[3]));
        let beside = Cell { level: 4, i: 0, j: 0 };
        assert!(!tree.contains(beside) && !tree.is_split(beside));
        for level in 0..13 {
            let all = tree.cells(level).into_iter();
            let unsplit: Vec<Cell> = all.filter(|&cell| !tree.is_split(cell)).collect();
            for cell in unsplit {
                let number = 100 * u32::from(cell.level) + cell.i % 2 + 2 * (cell.j % 2);
                tree.number(cell, number, false);
                let side = cell.side();
                let at = [(f64::from(cell.i) + 0.25) * side, (f64::from(cell.j) + 0.5) * side];
                let leaf = tree.over(cell).1.expect("the cell is not split");
                assert_eq!(tree.at(at), (leaf, [0.25, 0.5]));
            }
        }
        assert_eq!(tree.at([3.0, 2.0]).1, [1.0, 1.0], "the upper ends belong to the last cell");
        assert_eq!(tree.over(Cell { level: 5, i: 40, j: 3 }).0, Cell { level: 0, i: 1, j: 0 });
    }

    #[test]
    fn closing_reaches_all_required_cells() {
        let mut tree = CellTree::new([8, 1]);
        tree.split(Cell { level: 2, i: 0, j: 0 });
        // Each split cell requires its right neighbour, up to the sixth of level 0.
        tree.close(|cell, also| {
            if cell.level == 0 && cell.i < 5 {
                also.push(Cell { i: cell.i + 1, ..cell });
            }
        });
        let mut split: Vec<u32> = tree.split_cells(0).iter().map(|cell| cell.i).collect();
        split.sort_unstable();
        assert_eq!(split, [0, 1, 2, 3, 4, 5]);
    }
}
