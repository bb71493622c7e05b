//! Assigns every region of an overlap to one patch.
//!
//! In: patches and their overlap. Out: the triangles of each patch that are kept. These are the triangles
//! whose corners have a higher score than the other patches at the same point, unless they lie on or beside a
//! kept triangle of an earlier patch. This leaves a gap of one or two edges along every seam.
//!
//! The score is the distance to the border of the patch, in its edges and at most [`MAX_BORDER_DISTANCE`], so
//! that a seam runs at equal distances from both borders. A patch that is finer than another by the factor
//! [`FINER_RATIO`] wins from [`TAPER`] edges inside its border on, because it shows detail between the
//! vertices of the other. Among almost equal scores the earlier patch wins by a fraction of an edge. The
//! score of a point does not depend on the patch that it is compared with, so that one of any three patches
//! always wins.

use super::overlap::{MAX_BORDER_DISTANCE, median};
use super::{MergePatch, Overlap, TAPER};

/// Ratio of edge lengths from which a patch counts as finer than another.
///
/// With a smaller ratio, patches of nearly equal detail would meet at a border instead of in the middle.
const FINER_RATIO: f64 = 1.8;
/// Advantage of the earlier of two patches, in edges; noise changes distances to the border by as much.
///
/// Without it, two scans from one viewpoint, which are equally far inside but for noise, become a patchwork
/// with holes (test `two_scans_from_one_viewpoint_leave_no_holes`).
const PRECEDENCE: f64 = 0.5;
/// Maximum advantage of the first patch over the last, in edges.
///
/// It limits the sum over many patches, so that the first one does not win at its own border.
const MAX_PRECEDENCE: f64 = 2.0;

/// Parameters of the score of a patch.
#[derive(Debug, Clone, Copy)]
struct Score {
    /// Median edge length.
    edge: f64,
    /// Advantage over later patches, in edges.
    earlier: f64,
    /// Advantage over coarser patches, in edges, away from the border.
    finer: f64,
}

impl Score {
    /// The scores of all patches.
    fn from_overlap(overlap: &Overlap) -> Vec<Self> {
        let edges: Vec<f64> = overlap.patches.iter().map(|p| median(&p.spacing)).collect();
        let mut order: Vec<usize> = (0..edges.len()).collect();
        order.sort_by(|i, j| edges[*j].total_cmp(&edges[*i]).then(i.cmp(j)));
        // Levels of resolution, from coarse to fine. Comparing each patch with the coarsest of its level
        // gives a transitive order; comparing pairs would not.
        let mut level = 0;
        let mut coarsest = f64::INFINITY;
        let mut levels = vec![0; edges.len()];
        for i in order {
            if coarsest.is_finite() && edges[i] * FINER_RATIO < coarsest {
                level += 1;
            }
            if !coarsest.is_finite() || edges[i] * FINER_RATIO < coarsest {
                coarsest = edges[i];
            }
            levels[i] = level;
        }
        let count = edges.len();
        let step = PRECEDENCE.min(MAX_PRECEDENCE / count.saturating_sub(1).max(1) as f64);
        (0..count)
            .map(|i| Self {
                edge: edges[i],
                earlier: step * (count - 1 - i) as f64,
                finer: 2.0 * MAX_BORDER_DISTANCE * f64::from(levels[i]),
            })
            .collect()
    }

    /// Score at a distance from the border. A patch without a border (infinite distance) wins over patches of
    /// the same resolution that have one.
    fn at(&self, to_border: f64) -> f64 {
        let within = to_border / self.edge;
        let finer = if within >= TAPER { self.finer } else { 0.0 };
        // Infinite or NaN: interpolation of infinite distances gives ∞ · 0.
        let without_border = !within.is_finite();
        if without_border {
            MAX_BORDER_DISTANCE + MAX_PRECEDENCE + 1.0 + self.finer + self.earlier
        } else {
            within.min(MAX_BORDER_DISTANCE) + finer + self.earlier
        }
    }
}

/// For each triangle of each patch, true if it is kept.
pub(super) fn kept_triangles(patches: &[MergePatch], overlap: &Overlap) -> Vec<Vec<bool>> {
    let scores = Score::from_overlap(overlap);
    // Vertices of kept triangles, and triangles under vertices of earlier patches that are kept.
    let mut in_kept: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.positions.len()]).collect();
    let mut covered: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.triangles.len()]).collect();
    let mut all = Vec::with_capacity(patches.len());
    // One patch after the other: what an earlier patch keeps, a later one must leave.
    for (i, patch) in patches.iter().enumerate() {
        let own_overlap = &overlap.patches[i];
        let owned: Vec<bool> = (0..patch.mesh.positions.len())
            .map(|v| {
                let own_score = scores[i].at(own_overlap.to_border[v]);
                own_overlap.feet(v).iter().all(|foot| {
                    let j = foot.patch as usize;
                    let corners = patches[j].mesh.triangles[foot.triangle as usize];
                    if j < i && corners.iter().any(|c| in_kept[j][*c as usize]) {
                        return false;
                    }
                    let other_border = patches[j].mesh.interpolate(
                        &overlap.patches[j].to_border,
                        foot.triangle as usize,
                        foot.barycentric,
                    );
                    foot.beyond_border || own_score > scores[j].at(other_border)
                })
            })
            .collect();
        let kept: Vec<bool> = patch
            .mesh
            .triangles
            .iter()
            .zip(&covered[i])
            .map(|(t, covered)| !covered && t.iter().all(|v| owned[*v as usize]))
            .collect();
        for (t, _) in patch.mesh.triangles.iter().zip(&kept).filter(|(_, k)| **k) {
            for v in t {
                in_kept[i][*v as usize] = true;
            }
        }
        // A fine patch can lie within a single triangle of a coarse one, whose corners are then all outside
        // it.
        for v in (0..patch.mesh.positions.len()).filter(|v| in_kept[i][*v]) {
            for foot in own_overlap.feet(v).iter().filter(|f| f.patch as usize > i && !f.beyond_border) {
                covered[foot.patch as usize][foot.triangle as usize] = true;
            }
        }
        all.push(kept);
    }
    all
}
