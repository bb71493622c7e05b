//! The region that agrees best with all silhouettes, some of which have gross errors.
//!
//! In: views with closed silhouettes and a box. Out: a closed mesh, and the pixels of each view that
//! contradict it.
//!
//! The visual hull loses every place that one mask shows as background by mistake, for example a shadow on
//! the object. This module starts from the hull and restores places by maximum likelihood. If pixels of masks
//! are wrong independently and with equal probability, the most likely region has the fewest pixels at which
//! a mask and the region's silhouette differ. A restored place gains a pixel where a mask shows the object
//! and nothing covers it yet, and loses a pixel where the mask shows background. A part of an object is
//! missing in the hull's silhouettes of several views if one wrong mask removed it, so restoring it gains
//! more than it loses. Background that a mask includes by mistake gains pixels in that view only.
//!
//! Places are the corners of a grid. Each round restores those that gain most, then gains are computed again.
//! Restored places are bounded by the silhouettes that do not contradict them, with subpixel accuracy.
//!
//! Not guaranteed: the optimum is local. A place is restored only if at least two other masks show the object
//! there and nothing else covers it; on a convex body most places stay lost. Errors at the same place in many
//! views are not found. As for the visual hull, hollows that no silhouette shows are filled.

use super::hull::SilhouetteBound;
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use planish_mesh::{TriangleMesh, isosurface};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Maximum share of views that may contradict a restored place. More would be the object's true outline.
const MAX_CONTRADICTING: f64 = 1.0 / 3.0;
/// Minimum gain of a restored place, in whole pixels. It is above the rounding of border pixels.
const MIN_GAIN: usize = 1;
/// Maximum number of rounds with the same minimum gain. Later rounds restore few places.
const ROUNDS: usize = 3;
/// Side of the blocks of corners that [`ConsistentRegion::may_contain_boundary`] looks up.
const BLOCK: usize = 8;

/// A region that agrees best with all silhouettes.
pub struct ConsistentRegion {
    bound: SilhouetteBound,
    grid: Grid,
    /// Views that contradict a restored corner.
    restored: HashMap<usize, Vec<u16>>,
    /// Blocks with restored corners.
    blocks: HashSet<[usize; 3]>,
    /// For each view with a closed silhouette, the area of its background in front of restored places, in
    /// pixels.
    pub contradicted_px: Vec<f64>,
    /// For each of these views, the area of its silhouette that no part of the region covers, in pixels.
    pub uncovered_px: Vec<f64>,
}

/// Corners of cubes.
struct Grid {
    first: DVec3,
    cell: f64,
    counts: [usize; 3],
}

impl Grid {
    fn new(bounds: &BoundingBox, cell: f64) -> Self {
        let counts = [0, 1, 2].map(|k| ((bounds.max[k] - bounds.min[k]) / cell).ceil() as usize + 1);
        Self { first: bounds.min, cell, counts }
    }

    fn corners(&self) -> usize {
        self.counts.iter().product()
    }

    fn corner(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.counts;
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    fn place(&self, index: usize) -> DVec3 {
        self.first + self.cell * DVec3::from(self.corner(index).map(|i| i as f64))
    }

    /// The nearest corner within the grid.
    fn nearest(&self, at: DVec3) -> Option<usize> {
        let place = ((at - self.first) / self.cell).round();
        let within = (0..3).all(|k| place[k] >= 0.0 && place[k] < self.counts[k] as f64);
        let [x, y, z] = [0, 1, 2].map(|k| place[k] as usize);
        within.then(|| x + self.counts[0] * (y + self.counts[1] * z))
    }
}

/// A silhouette on a coarser raster: blocks of pixels that are at least as large as a cell.
struct Raster {
    columns: usize,
    /// For each block, the share of the object minus the share of the background.
    values: Vec<f32>,
    /// Pixels along the side of a block.
    side: usize,
}

/// A corner of the grid that some views show as background.
struct Candidate {
    corner: usize,
    contradicting: Vec<u16>,
    /// The block of each view; `u32::MAX` outside of the raster.
    blocks: Vec<u32>,
}

impl ConsistentRegion {
    /// Finds the region within a box on a grid of the given cells.
    ///
    /// Cost: one projection of each corner into each view; memory for one number per view and candidate.
    ///
    /// # Errors
    /// `Undetermined` if fewer than two views have closed silhouettes, or no corner is inside all of them.
    pub fn new(bound: SilhouetteBound, bounds: &BoundingBox, cell: f64) -> Result<Self> {
        let grid = Grid::new(bounds, cell);
        let views = bound.count();
        let middle = 0.5 * (bounds.min + bounds.max);
        let rasters: Vec<Raster> =
            (0..views).into_par_iter().map(|view| raster(&bound, view, middle, cell)).collect();
        let max_contradicting = ((MAX_CONTRADICTING * views as f64) as usize).max(1);
        let (inside, mut candidates) = classified(&bound, &grid, &rasters, max_contradicting);
        if inside.is_empty() {
            return Err(Error::undetermined("expected points inside all silhouettes, found none"));
        }
        let mut covered: Vec<Vec<bool>> = rasters.iter().map(|r| vec![false; r.values.len()]).collect();
        let cover = |blocks: &[u32], covered: &mut Vec<Vec<bool>>| {
            for (of_view, block) in covered.iter_mut().zip(blocks) {
                if let Some(of_block) = of_view.get_mut(*block as usize) {
                    *of_block = true;
                }
            }
        };
        inside.iter().for_each(|blocks| cover(blocks, &mut covered));
        let before = covered.clone();
        let mut restored = HashMap::new();
        for least in (MIN_GAIN..=views).rev() {
            for _ in 0..ROUNDS {
                let gains: Vec<bool> = (candidates.par_iter())
                    .map(|candidate| gain(candidate, &rasters, &covered) >= least as f64)
                    .collect();
                if !gains.contains(&true) {
                    break;
                }
                let mut rest = Vec::with_capacity(candidates.len());
                for (candidate, gains) in candidates.into_iter().zip(gains) {
                    if gains {
                        cover(&candidate.blocks, &mut covered);
                        restored.insert(candidate.corner, candidate.contradicting);
                    } else {
                        rest.push(candidate);
                    }
                }
                candidates = rest;
            }
        }
        let blocks = restored.keys().map(|corner| grid.corner(*corner).map(|i| i / BLOCK)).collect();
        let areas = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
            (rasters.iter().enumerate())
                .map(|(view, raster)| {
                    let sum: f64 = (0..raster.values.len()).map(|block| of(view, block)).sum();
                    sum * (raster.side * raster.side) as f64
                })
                .collect()
        };
        let object_share = |view: usize, block: usize| 0.5 * (1.0 + f64::from(rasters[view].values[block]));
        let contradicted_px = areas(&|view, block| match covered[view][block] && !before[view][block] {
            true => 1.0 - object_share(view, block),
            false => 0.0,
        });
        let uncovered_px = areas(&|view, block| match covered[view][block] {
            true => 0.0,
            false => object_share(view, block),
        });
        Ok(Self { bound, grid, restored, blocks, contradicted_px, uncovered_px })
    }

    /// The mesh of the region's surface, facing outwards.
    ///
    /// # Errors
    /// As [`isosurface`].
    pub fn mesh(&self, bounds: &BoundingBox) -> Result<TriangleMesh> {
        isosurface(
            bounds,
            self.grid.cell,
            |at| -self.depth(at),
            |at, reach| self.may_contain_boundary(at, reach),
        )
    }

    /// Signed depth of a point inside the region, as [`SilhouetteBound::depth`]. At restored places, it is
    /// the depth in the silhouettes that do not contradict them.
    #[must_use]
    pub fn depth(&self, at: DVec3) -> f64 {
        match self.contradicting(at) {
            Some(views) => self.bound.depth_except(at, views),
            None => self.bound.depth(at),
        }
    }

    /// Number of restored corners of the grid.
    #[must_use]
    pub fn restored(&self) -> usize {
        self.restored.len()
    }

    /// Volume of the cells of restored corners.
    #[must_use]
    pub fn restored_volume(&self) -> f64 {
        self.restored.len() as f64 * self.grid.cell.powi(3)
    }

    fn contradicting(&self, at: DVec3) -> Option<&[u16]> {
        self.restored.get(&self.grid.nearest(at)?).map(Vec::as_slice)
    }

    /// True if the depth may be zero within `reach` of a point, as [`SilhouetteBound::may_contain_boundary`].
    #[must_use]
    pub fn may_contain_boundary(&self, at: DVec3, reach: f64) -> bool {
        if self.bound.may_contain_boundary(at, reach) {
            return true;
        }
        let around = reach + self.grid.cell;
        let limit = |sign: f64, k: usize| {
            let corner = (at[k] + sign * around - self.grid.first[k]) / self.grid.cell;
            (corner.clamp(0.0, self.grid.counts[k] as f64)) as usize / BLOCK
        };
        let [first, last] = [-1.0, 1.0].map(|sign| [0, 1, 2].map(|k| limit(sign, k)));
        (first[2]..=last[2]).any(|z| {
            (first[1]..=last[1]).any(|y| (first[0]..=last[0]).any(|x| self.blocks.contains(&[x, y, z])))
        })
    }
}

/// The raster of a view in blocks that no cell near `middle` exceeds.
fn raster(bound: &SilhouetteBound, view: usize, middle: DVec3, cell: f64) -> Raster {
    let (values, columns) = bound.signed_distances(view);
    let side = (cell / bound.pixel_width(view, middle)).ceil().max(1.0) as usize;
    let rows = values.len() / columns;
    let blocks = [columns, rows].map(|n| n.div_ceil(side));
    let mut sums = vec![0.0_f32; blocks[0] * blocks[1]];
    for (k, value) in values.iter().enumerate() {
        let block = k / columns / side * blocks[0] + k % columns / side;
        sums[block] += if *value > 0.0 { 1.0 } else { 0.0 };
    }
    // Pixels beyond the raster are background.
    let share = |sum: f32| 2.0 * sum / (side * side) as f32 - 1.0;
    Raster { columns: blocks[0], values: sums.into_iter().map(share).collect(), side }
}

/// Blocks of the corners inside all silhouettes, and the corners that few views show as background.
fn classified(
    bound: &SilhouetteBound,
    grid: &Grid,
    rasters: &[Raster],
    max_contradicting: usize,
) -> (Vec<Vec<u32>>, Vec<Candidate>) {
    let made: Vec<Candidate> = (0..grid.corners())
        .into_par_iter()
        .filter_map(|corner| {
            let at = grid.place(corner);
            if bound.depth_in_limits(at) <= 0.0 {
                return None;
            }
            let mut contradicting = Vec::new();
            for view in 0..rasters.len() {
                if !bound.is_inside(view, at) {
                    contradicting.push(view as u16);
                }
                if contradicting.len() > max_contradicting {
                    return None;
                }
            }
            let blocks = (rasters.iter().enumerate())
                .map(|(view, raster)| {
                    bound.raster_pixel(view, at).map_or(u32::MAX, |[x, y]| {
                        (y / raster.side * raster.columns + x / raster.side) as u32
                    })
                })
                .collect();
            Some(Candidate { corner, contradicting, blocks })
        })
        .collect();
    let (inside, candidates): (Vec<_>, Vec<_>) = made.into_iter().partition(|c| c.contradicting.is_empty());
    (inside.into_iter().map(|c| c.blocks).collect(), candidates)
}

/// Number of blocks that agree with their mask only if the candidate belongs to the region, minus those that
/// agree only if it does not.
fn gain(candidate: &Candidate, rasters: &[Raster], covered: &[Vec<bool>]) -> f64 {
    (candidate.blocks.iter().zip(rasters).zip(covered))
        .map(|((block, raster), covered)| match covered.get(*block as usize) {
            Some(true) => 0.0,
            Some(false) => f64::from(raster.values[*block as usize]),
            // Beyond the raster, a view shows background.
            None => -1.0,
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::super::{Contour, ContourView};
    use super::*;
    use planish_core::Pinhole;
    use planish_core::matrix3::{from_rows, times};
    use std::f64::consts::TAU;

    const RADIUS: f64 = 1.0;
    const VIEWS: usize = 14;

    /// Views of a ball from two heights. `radius_px(view, angle)` changes the radius of its outline.
    fn views_of_a_ball(radius_px: impl Fn(usize, f64, f64) -> f64) -> Vec<ContourView> {
        (0..VIEWS)
            .map(|k| {
                let a = TAU * k as f64 / VIEWS as f64;
                let from = DVec3::new(8.0 * a.cos(), 8.0 * a.sin(), if k % 2 == 0 { 2.0 } else { -3.0 });
                let forward = -from.normalize();
                let right = forward.cross(DVec3::Z).normalize();
                let r = from_rows([right, forward.cross(right), forward]);
                let k_matrix = [[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]];
                let camera = Pinhole { k: k_matrix, r, t: -times(&r, from) };
                let exact = 400.0 * RADIUS / (from.length_squared() - RADIUS * RADIUS).sqrt();
                let corners: Vec<[f64; 2]> = (0..600)
                    .map(|i| {
                        let angle = TAU * f64::from(i) / 600.0;
                        let radius = radius_px(k, angle, exact);
                        [160.0 + radius * angle.cos(), 120.0 + radius * angle.sin()]
                    })
                    .collect();
                // Places at most a pixel apart, also at steps of the radius.
                let places = (corners.iter().zip(corners.iter().cycle().skip(1)))
                    .flat_map(|(p, q)| {
                        let count = (q[0] - p[0]).hypot(q[1] - p[1]).ceil().max(1.0) as usize;
                        let at = move |i: usize, k: usize| p[k] + (q[k] - p[k]) * i as f64 / count as f64;
                        (0..count).map(move |i| [at(i, 0), at(i, 1)])
                    })
                    .collect();
                let outline = vec![Contour { places, closed: true }];
                ContourView {
                    name: format!("v{k}"),
                    camera,
                    contours: outline.clone(),
                    silhouette: outline,
                    sigma_px: 0.3,
                    apart_px: 0.0,
                }
            })
            .collect()
    }

    fn region(views: &[ContourView]) -> (ConsistentRegion, f64, f64) {
        let bounds = BoundingBox { min: DVec3::splat(-1.6), max: DVec3::splat(1.6) };
        let hull = super::super::VisualHull::new(views, &bounds, 80).unwrap().mesh.signed_volume().unwrap();
        let found = ConsistentRegion::new(SilhouetteBound::new(views).unwrap(), &bounds, 0.03).unwrap();
        let volume = found.mesh(&bounds).unwrap().signed_volume().unwrap();
        (found, hull, volume)
    }

    /// Masks without errors give the visual hull.
    #[test]
    fn consistent_masks_give_the_hull() {
        let (found, hull, volume) = region(&views_of_a_ball(|_, _, exact| exact));
        assert!((volume / hull - 1.0).abs() < 0.01, "{volume} {hull}");
        assert!(found.contradicted_px.iter().all(|px| *px < 40.0), "{:?}", found.contradicted_px);
    }

    /// A notch in one mask is restored in part, an outgrowth of another is not, and both views are reported.
    #[test]
    fn gross_errors_of_single_masks_are_reported() {
        let (_, exact, _) = region(&views_of_a_ball(|_, _, exact| exact));
        for (notched, grown, at) in [(3, 9, 1.0), (6, 0, 4.0), (11, 4, 2.5)] {
            let views = views_of_a_ball(|k, angle, radius| match (angle - at).abs() < 0.35 {
                true if k == notched => 0.5 * radius,
                true if k == grown => 1.4 * radius,
                _ => radius,
            });
            let (found, hull, volume) = region(&views);
            assert!(hull < 0.97 * exact, "{hull} {exact}");
            // On a ball, most of what the notch removes is in front of the ball in all other views, so that
            // nothing shows that it is missing.
            assert!(hull + 0.002 * exact < volume && volume < 1.005 * exact, "{volume} {hull} {exact}");
            let largest =
                |values: &[f64]| (0..VIEWS).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap();
            assert_eq!(largest(&found.contradicted_px), notched, "{:?}", found.contradicted_px);
            assert_eq!(largest(&found.uncovered_px), grown, "{:?}", found.uncovered_px);
        }
    }
}
