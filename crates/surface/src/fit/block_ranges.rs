//! Ranges of the values of an indicator in blocks of grid cells.
//!
//! Input: a [`BlurredIndicator`]. Output: whether a level can occur in a cube. Interpolated values lie
//! between those at the corners of their grid cell, so no cube that holds the level is excluded. A bound of
//! the slope alone would leave most of the solid and its surroundings to be searched for a level set.
//!
//! Not guaranteed: that a cube holds the level, since its whole blocks are tested.

use super::indicator::BlurredIndicator;
use planish_core::DVec3;
use rayon::prelude::*;

/// Grid cells along each side of a block.
const BLOCK: usize = 6;
/// Blocks that a cube may overlap along each side. Larger cubes are not tested.
const MAX_BLOCKS: usize = 3;

/// The smallest and the largest value in each block.
pub(super) struct BlockRanges {
    origin: DVec3,
    /// Side of a block, and number of blocks along each side of the grid.
    side: f64,
    blocks: usize,
    ranges: Vec<[f64; 2]>,
}

impl BlockRanges {
    pub(super) fn new(field: &BlurredIndicator) -> Self {
        let (values, n) = field.grid_values();
        let blocks = (n - 1).div_ceil(BLOCK);
        let range = |block: usize| {
            let along = |k: usize| k * BLOCK..=((k + 1) * BLOCK).min(n - 1);
            let [a, b, c] = [block % blocks, block / blocks % blocks, block / blocks / blocks].map(along);
            let mut range = [f64::INFINITY, f64::NEG_INFINITY];
            for z in c {
                for y in b.clone() {
                    let row = (z * n + y) * n;
                    for value in &values[row + a.start()..=row + a.end()] {
                        range = [range[0].min(*value), range[1].max(*value)];
                    }
                }
            }
            range
        };
        Self {
            origin: field.origin(),
            side: BLOCK as f64 * field.cell(),
            blocks,
            ranges: (0..blocks.pow(3)).into_par_iter().map(range).collect(),
        }
    }

    /// False if no value within a cube is `level`. The corners of the cube are within `reach` of its middle.
    pub(super) fn may_hold(&self, level: f64, middle: DVec3, reach: f64) -> bool {
        // Rounding errors of the corners are far smaller than the margin.
        let half = reach / 3.0_f64.sqrt() + 1e-6 * self.side;
        let at = |p: f64| (p.max(0.0) as usize).min(self.blocks - 1);
        let along = [0, 1, 2].map(|d| {
            let place = |p: f64| at((p - self.origin[d]) / self.side);
            (place(middle[d] - half), place(middle[d] + half))
        });
        if along.iter().any(|(first, last)| last - first >= MAX_BLOCKS) {
            return true;
        }
        let [a, b, c] = along.map(|(first, last)| first..=last);
        c.flat_map(|z| b.clone().map(move |y| (z * self.blocks + y) * self.blocks)).any(|row| {
            a.clone().any(|x| {
                let [low, high] = self.ranges[row + x];
                (low..=high).contains(&level)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::indicator::Indicator;
    use super::*;

    /// A sphere: cubes on both sides of it are excluded, and none that its level set passes through.
    #[test]
    fn only_blocks_away_from_the_level_are_excluded() {
        let normals: Vec<DVec3> = (0..4000)
            .map(|i| {
                let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
                let (sine, cosine) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
                let r = (1.0 - z * z).sqrt();
                DVec3::new(r * cosine, r * sine, z)
            })
            .collect();
        let indicator = Indicator::new(&normals, &normals);
        let field = indicator.blurred(indicator.cell());
        let (level, ranges) = (field.level(&normals), BlockRanges::new(&field));
        let reach = 0.87 * field.cell();
        let middles: Vec<DVec3> =
            (0..20).flat_map(|k| normals.iter().map(move |n| 0.075 * f64::from(k) * *n)).collect();
        let may_hold = |p: &&DVec3| ranges.may_hold(level, **p, reach);
        let passes = |p: &&DVec3| {
            let corner = |c: usize| {
                let sign = |k: usize| if c >> k & 1 == 0 { -0.5 } else { 0.5 };
                field.sample(**p + field.cell() * DVec3::from([0, 1, 2].map(sign))).0 < level
            };
            (1..8).any(|c| corner(c) != corner(0))
        };
        assert!(middles.iter().filter(passes).all(|p| may_hold(&p)));
        let kept = middles.iter().filter(may_hold).count();
        assert!(kept < middles.len() / 2, "{kept} of {}", middles.len());
    }
}
