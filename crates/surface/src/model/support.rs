//! How each place of a surface is known, finer than its leaves.
//!
//! A leaf may be much larger than the spacing of readings, and hold a hole or the rim of the data. Its
//! parameter square is therefore divided into `2ᵈ × 2ᵈ` equal cells, each with an [`Observed`] and the
//! distance to the nearest reading. Leaves that are known in one way everywhere have one cell.
//!
//! Not guaranteed: borders finer than a cell. Cells are about as large as the spacing of the readings, or
//! 1/32 of the leaf's side.

use super::Observed;
use planish_estimate::{Error, Result};

/// Largest number of divisions of a leaf. A leaf of 32 × 32 cells can tell a hole of ten spacings from
/// measured surface if it holds up to some 10,000 readings.
pub const MAX_SUPPORT_DEPTH: u8 = 5;
/// Divisions of a leaf of one cell before a part of it is marked.
const DEPTH_OF_PARTS: u8 = 3;

/// One cell: how it is known, and the distance of its middle to the nearest reading in the model's unit; 0
/// where it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SupportCell {
    /// How it is known.
    pub observed: Observed,
    /// Distance to the nearest reading.
    pub distance: f64,
}

/// The cells of one leaf, row by row.
#[derive(Debug, Clone, PartialEq)]
struct LeafSupport {
    depth: u8,
    cells: Vec<SupportCell>,
}

/// Number of the cell at leaf-local coordinates.
fn cell_index(depth: u8, local: [f64; 2]) -> usize {
    let side = 1_usize << depth;
    // Rounding may place a point just outside of its leaf.
    let [i, j] = local.map(|x| ((x * side as f64).max(0.0) as usize).min(side - 1));
    j * side + i
}

/// How each place of a surface is known. Empty for models that only know it by leaf.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Support {
    leaves: Vec<LeafSupport>,
}

/// The middles of the cells of a leaf divided `depth` times, in leaf-local coordinates, row by row.
pub(crate) fn middles(depth: u8) -> impl Iterator<Item = [f64; 2]> {
    let side = 1_usize << depth;
    (0..side * side).map(move |k| [k % side, k / side].map(|c| (c as f64 + 0.5) / side as f64))
}

impl Support {
    /// From the cells of each leaf: the number of divisions and the cells, row by row.
    ///
    /// # Errors
    /// `Input` if a leaf is divided too often, has another number of cells, or a distance is negative or not
    /// finite.
    ///
    /// # Examples
    /// ```
    /// use planish_surface::model::{Observed, Support, SupportCell};
    /// let measured = SupportCell { observed: Observed::Measured, distance: 0.0 };
    /// let hole = SupportCell { observed: Observed::PriorOnly, distance: 2.5 };
    /// let support = Support::new(vec![(1, vec![measured, measured, measured, hole])])?;
    /// assert_eq!(support.at(0, [0.9, 0.9]), hole);
    /// assert_eq!(support.share(0, Observed::Measured), 0.75);
    /// # Ok::<(), planish_core::Error>(())
    /// ```
    pub fn new(leaves: Vec<(u8, Vec<SupportCell>)>) -> Result<Self> {
        let leaves = leaves
            .into_iter()
            .map(|(depth, cells)| {
                if depth > MAX_SUPPORT_DEPTH || cells.len() != 1 << (2 * depth) {
                    return Err(Error::input(format!(
                        "expected 4ᵈ cells of a leaf divided d ≤ {MAX_SUPPORT_DEPTH} times, found {} with \
                         d = {depth}",
                        cells.len()
                    )));
                }
                match cells.iter().find(|c| !(c.distance >= 0.0 && c.distance.is_finite())) {
                    None => Ok(LeafSupport { depth, cells }),
                    Some(cell) => Err(Error::input(format!(
                        "expected distances ≥ 0 to the nearest reading, found {}",
                        cell.distance
                    ))),
                }
            })
            .collect::<Result<_>>()?;
        Ok(Self { leaves })
    }

    /// True if places are known by leaf only.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.leaves.is_empty()
    }

    /// Number of leaves.
    #[must_use]
    pub fn len(&self) -> usize {
        self.leaves.len()
    }

    /// Number of divisions and cells of each leaf.
    pub fn leaves(&self) -> impl ExactSizeIterator<Item = (u8, &[SupportCell])> {
        self.leaves.iter().map(|leaf| (leaf.depth, &leaf.cells[..]))
    }

    /// The cell at leaf-local coordinates.
    #[must_use]
    pub fn at(&self, leaf: usize, local: [f64; 2]) -> SupportCell {
        self.leaves
            .get(leaf)
            .map_or_else(SupportCell::default, |leaf| Self::cell_of(leaf.depth, &leaf.cells, local))
    }

    /// The cells of a leaf, row by row.
    #[must_use]
    pub fn cells(&self, leaf: usize) -> &[SupportCell] {
        self.leaves.get(leaf).map_or(&[], |leaf| &leaf.cells)
    }

    /// Number of divisions of a leaf.
    pub(crate) fn depth(&self, leaf: usize) -> u8 {
        self.leaves.get(leaf).map_or(0, |leaf| leaf.depth)
    }

    /// The cell at leaf-local coordinates among the cells of a leaf divided `depth` times.
    pub(crate) fn cell_of(depth: u8, cells: &[SupportCell], local: [f64; 2]) -> SupportCell {
        cells.get(cell_index(depth, local)).copied().unwrap_or_default()
    }

    /// Share of a leaf's parameter square that is known in the given way.
    #[must_use]
    pub fn share(&self, leaf: usize, kind: Observed) -> f64 {
        let Some(leaf) = self.leaves.get(leaf) else { return 0.0 };
        leaf.cells.iter().filter(|c| c.observed == kind).count() as f64 / leaf.cells.len() as f64
    }

    /// How most of a leaf is known.
    #[must_use]
    pub fn of_leaf(&self, leaf: usize) -> Observed {
        let mut best = (0.0, Observed::PriorOnly);
        // Measured comes first, so that it wins a draw.
        for kind in [Observed::Measured, Observed::Inferred, Observed::NotFollowed, Observed::PriorOnly] {
            let share = self.share(leaf, kind);
            if share > best.0 {
                best = (share, kind);
            }
        }
        best.1
    }

    /// Marks the places of a leaf that were not measured as inferred.
    pub(crate) fn set_inferred(&mut self, leaf: usize) {
        let cells = self.leaves.get_mut(leaf).into_iter().flat_map(|leaf| &mut leaf.cells);
        for cell in cells.filter(|cell| cell.observed == Observed::PriorOnly) {
            cell.observed = Observed::Inferred;
        }
    }

    /// Marks the measured places of a leaf in a rectangle of leaf-local coordinates (from, to) as not
    /// followed by the surface. A leaf of one cell is divided first.
    pub fn set_not_followed(&mut self, leaf: usize, [from, to]: [[f64; 2]; 2]) {
        let Some(leaf) = self.leaves.get_mut(leaf) else { return };
        let whole = (0..2).all(|d| from[d] <= 0.0 && to[d] >= 1.0);
        if leaf.depth == 0 && !whole {
            *leaf =
                LeafSupport { depth: DEPTH_OF_PARTS, cells: vec![leaf.cells[0]; 1 << (2 * DEPTH_OF_PARTS)] };
        }
        for (cell, at) in leaf.cells.iter_mut().zip(middles(leaf.depth)) {
            if cell.observed.is_measured() && (0..2).all(|d| (from[d]..=to[d]).contains(&at[d])) {
                cell.observed = Observed::NotFollowed;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MEASURED: SupportCell = SupportCell { observed: Observed::Measured, distance: 0.0 };

    #[test]
    fn a_part_that_is_not_followed_leaves_the_rest_as_it_was() {
        let unknown = SupportCell { observed: Observed::PriorOnly, distance: 1.0 };
        let mut support =
            Support::new(vec![(0, vec![MEASURED]), (0, vec![unknown]), (1, vec![MEASURED; 4])]).unwrap();
        for leaf in 0..3 {
            support.set_not_followed(leaf, [[0.0, 0.0], [0.5, 0.5]]);
        }
        assert_eq!(support.share(0, Observed::NotFollowed), 0.25);
        assert_eq!(support.at(0, [0.1, 0.4]).observed, Observed::NotFollowed);
        assert_eq!(support.at(0, [0.6, 0.4]), MEASURED);
        // What was not measured cannot be measured and not followed.
        assert_eq!(support.at(1, [0.1, 0.1]), unknown);
        assert_eq!(support.share(2, Observed::NotFollowed), 0.25);
        assert_eq!(
            [0, 1, 2].map(|leaf| support.of_leaf(leaf)),
            [Observed::Measured, Observed::PriorOnly, Observed::Measured]
        );
        support.set_not_followed(2, [[0.0; 2], [1.0; 2]]);
        assert_eq!(support.of_leaf(2), Observed::NotFollowed);
    }

    #[test]
    fn cells_that_do_not_fill_a_leaf_are_refused() {
        assert!(Support::new(vec![(1, vec![MEASURED; 3])]).is_err());
        assert!(Support::new(vec![(9, vec![MEASURED; 1 << 18])]).is_err());
        let bad = SupportCell { observed: Observed::PriorOnly, distance: f64::NAN };
        assert!(Support::new(vec![(0, vec![bad])]).is_err());
    }
}
