//! The cells of a regular grid that a surface may pass through.
//!
//! In: a box, the size of a cell, and a test that excludes cells without the surface. Out: the cells and
//! their corners, in a fixed order. A box is halved recursively where the surface may pass, so the cost
//! follows the area of the surface and not the volume of the box.
//!
//! Not guaranteed: that the surface passes through each of the cells.

use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use rayon::prelude::*;

/// Maximum number of cells; bounds memory (each has up to eight corners with a key and a value).
const MAX_CELLS: usize = 40_000_000;
/// Number of bits of a coordinate in a key; three coordinates fit into 64 bits.
const BITS: u32 = 20;

/// A grid of cubes in a box.
pub(crate) struct Grid {
    pub low: DVec3,
    pub cell: f64,
}

impl Grid {
    /// The position of a corner.
    pub fn place(&self, corner: [u32; 3]) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|k| self.low[k] + self.cell * f64::from(corner[k])))
    }
}

/// Packs a corner into one number, by which corners are sorted and found.
pub(crate) fn key([x, y, z]: [u32; 3]) -> u64 {
    u64::from(x) | u64::from(y) << BITS | u64::from(z) << (2 * BITS)
}

/// The corner of a key.
pub(crate) fn corner_of(key: u64) -> [u32; 3] {
    let mask = (1_u64 << BITS) - 1;
    [0, 1, 2].map(|k| (key >> (k * BITS) & mask) as u32)
}

/// The numbers of the eight corners of a cube. Corner `c` has the offset of the bits of `c`, x first.
pub(crate) fn corner_numbers(corners: &[u64], cube: [u32; 3]) -> [u32; 8] {
    std::array::from_fn(|c| {
        let corner = [0, 1, 2].map(|k| cube[k] + (c as u32 >> k & 1));
        corners.binary_search(&key(corner)).unwrap_or(0) as u32
    })
}

/// The cells that a surface may pass through, and their corners.
pub(crate) struct SurfaceCells {
    pub grid: Grid,
    /// The lowest corner of each cube.
    pub cubes: Vec<[u32; 3]>,
    /// The keys of all corners of the cubes, in ascending order.
    pub corners: Vec<u64>,
}

impl SurfaceCells {
    /// Finds the cells. `may_pass(middle, reach)` returns whether the surface may pass within `reach` of a
    /// point; where it returns false, cells are excluded.
    ///
    /// # Errors
    /// `Input` for a cell size that is not positive or an empty box; `Unsupported` for more than 40 million
    /// cells, or a million along a side.
    pub fn find(
        bounds: &BoundingBox,
        cell: f64,
        may_pass: impl Fn(DVec3, f64) -> bool + Sync,
    ) -> Result<Self> {
        let extent = bounds.longest_side();
        if !(cell > 0.0 && cell.is_finite() && extent >= 0.0 && extent.is_finite()) {
            return Err(Error::input(format!(
                "expected a box and cells of positive size for an isosurface, found an extent of {extent} \
                 and cells of {cell}"
            )));
        }
        let levels = ((extent / cell).max(1.0).log2().ceil() as u32).max(1);
        if levels >= BITS {
            return Err(Error::unsupported(format!(
                "expected at most a million cells along a side, found cells of {cell} in a box of {extent}"
            )));
        }
        let grid = Grid { low: bounds.min, cell };
        // From coarse to fine, only children of cubes through which the surface may pass. Cubes stay in
        // order.
        let mut cubes: Vec<[u32; 3]> = vec![[0; 3]];
        for level in (0..=levels).rev() {
            let side = cell * f64::from(1_u32 << level);
            let reach = 0.5 * side * 3_f64.sqrt();
            let within =
                |cube: &[u32; 3]| (0..3).all(|k| grid.low[k] + side * f64::from(cube[k]) <= bounds.max[k]);
            cubes = (cubes.into_par_iter())
                .filter(within)
                .filter(|cube| {
                    let middle = std::array::from_fn(|k| grid.low[k] + side * (f64::from(cube[k]) + 0.5));
                    may_pass(DVec3::from_array(middle), reach)
                })
                .flat_map_iter(|cube| {
                    let children = if level > 0 { 0..8_u32 } else { 0..1 };
                    children.map(move |child| match level {
                        0 => cube,
                        _ => std::array::from_fn(|k| 2 * cube[k] + (child >> k & 1)),
                    })
                })
                .collect();
            if cubes.len() > MAX_CELLS {
                return Err(Error::unsupported(format!(
                    "expected at most {MAX_CELLS} cells at the surface, found more: use cells larger than \
                     {cell}"
                )));
            }
        }
        // Each corner is listed once although up to eight cubes share it.
        let mut corners: Vec<u64> = (cubes.par_iter())
            .flat_map_iter(|cube| (0..8_u32).map(move |c| key([0, 1, 2].map(|k| cube[k] + (c >> k & 1)))))
            .collect();
        corners.par_sort_unstable();
        corners.dedup();
        Ok(Self { grid, cubes, corners })
    }
}
