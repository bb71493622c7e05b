//! Rules for split cells: nesting, grading and poles.
//!
//! Input: split cells. Output: the smallest superset that satisfies all rules. Not guaranteed: few additional
//! cells; a single fine cell can require many coarse ones.

use super::cell_tree::CellTree;
use super::{Cell, Shape, grid};

/// Splits further cells until all rules of nesting and grading are satisfied.
pub(super) fn close(shape: Shape, base: [usize; 2], split: &mut CellTree) {
    split.close(|cell, also| {
        if shape.polar() {
            // The two rings of cells at a pole are split together.
            let [columns, rows] = grid(base, usize::from(cell.level)).map(|n| n as u32);
            let pair = [[0, 1], [rows - 1, rows - 2]].into_iter().find(|pair| pair.contains(&cell.j));
            // Once around is sufficient: from the first cell of each ring.
            let ring = |j| (0..columns).map(move |i| Cell { i, j, ..cell });
            match pair {
                Some(pair) if cell.i == 0 && cell.j == pair[0] => {
                    also.extend(pair.into_iter().flat_map(ring))
                }
                Some(pair) => also.push(Cell { i: 0, j: pair[0], ..cell }),
                None => {}
            }
        }
        let Some(level) = cell.level.checked_sub(1) else { return };
        // A split cell requires its parent and the eight neighbours of the parent to be split.
        let [columns, rows] = grid(base, level.into());
        for dj in -1..=1 {
            for di in -1..=1 {
                let i = neighbour(cell.i as usize / 2, di, columns, shape.periodic_u());
                let j = neighbour(cell.j as usize / 2, dj, rows, shape.periodic_v());
                if let (Some(i), Some(j)) = (i, j) {
                    also.push(Cell { level, i: i as u32, j: j as u32 });
                }
            }
        }
    });
}

fn neighbour(c: usize, d: i64, cells: usize, periodic: bool) -> Option<usize> {
    let n = c as i64 + d;
    if periodic {
        Some(n.rem_euclid(cells as i64) as usize)
    } else {
        (0..cells as i64).contains(&n).then_some(n as usize)
    }
}
