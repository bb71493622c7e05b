//! Rules for split cells: nesting, grading and poles.
//!
//! Input: split cells per level. Output: the smallest superset that satisfies all rules. Not guaranteed: few
//! additional cells; a single fine cell can require many coarse ones.

use super::{MAX_LEVEL, Shape, grid};

/// Splits further cells until all rules of nesting and grading are satisfied.
pub(super) fn close(shape: Shape, base: [usize; 2], split: &mut Vec<Vec<bool>>, max_level: usize) {
    // Requirements propagate from fine to coarse levels, so one sweep is sufficient for grading. Poles can
    // then require further splits, hence the loop.
    loop {
        let mut changed = false;
        for level in (0..split.len()).rev() {
            let [columns, rows] = grid(base, level);
            if shape.polar() {
                for pair in [[0, 1], [rows - 1, rows - 2]] {
                    let any =
                        pair.iter().any(|&j| split[level][j * columns..(j + 1) * columns].iter().any(|&s| s));
                    if any {
                        for j in pair {
                            for s in &mut split[level][j * columns..(j + 1) * columns] {
                                changed |= !*s;
                                *s = true;
                            }
                        }
                    }
                }
            }
            if level == 0 {
                continue;
            }
            // A split cell requires its parent and the eight neighbours of the parent to be split.
            let [parent_columns, parent_rows] = grid(base, level - 1);
            for j in 0..rows {
                for i in 0..columns {
                    if !split[level][j * columns + i] {
                        continue;
                    }
                    for dj in -1..=1_i64 {
                        for di in -1..=1_i64 {
                            let ci = neighbour(i / 2, di, parent_columns, shape.periodic_u());
                            let cj = neighbour(j / 2, dj, parent_rows, shape.periodic_v());
                            if let (Some(ci), Some(cj)) = (ci, cj) {
                                let s = &mut split[level - 1][cj * parent_columns + ci];
                                changed |= !*s;
                                *s = true;
                            }
                        }
                    }
                }
            }
        }
        // Cells split at the last level need a level for their children.
        if split.last().is_some_and(|level| level.iter().any(|&s| s))
            && split.len() <= max_level.min(MAX_LEVEL)
        {
            let level = split.len();
            split.push(vec![false; grid(base, level).iter().product()]);
        }
        if !changed {
            break;
        }
    }
}

fn neighbour(c: usize, d: i64, cells: usize, periodic: bool) -> Option<usize> {
    let n = c as i64 + d;
    if periodic {
        Some(n.rem_euclid(cells as i64) as usize)
    } else {
        (0..cells as i64).contains(&n).then_some(n as usize)
    }
}
