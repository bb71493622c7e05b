//! Which patch has which place.
//!
//! Comes in: patches and where they lie on one another. Goes out: the triangles of each that are kept: those
//! whose corners have a higher score than what they lie on has there, and of these none that lies on a kept
//! one of an earlier patch or beside it. So a gap of an edge or two is left along every seam.
//!
//! The score is how far a place is within its patch, in edges of that patch and up to [`FAR`] of them, so
//! that a seam runs where both are as far within. Where vertices of a patch are nearer together than
//! another's by [`FINER`] the finer one has what is within it by the edges over which it gains its weight in
//! a mean: what it shows between the other's vertices stays. Of scores that are all but equal the earlier
//! patch has the higher one, by a share of an edge; a score is a number of its own, so that of three patches
//! one always has a place.

use super::overlap::{FAR, median};
use super::{Overlap, Patch, TAPER};

/// By so much the edges of a patch are shorter than those of a coarser one.
const FINER: f64 = 1.8;
/// What the earlier of two patches has more, in edges; noise makes borders longer by as much.
const EARLIER: f64 = 0.5;
/// What the first of many patches has more than the last, at most.
const FIRST: f64 = 2.0;

/// How a patch scores.
#[derive(Debug, Clone, Copy)]
struct Score {
    /// One edge.
    edge: f64,
    /// What being earlier is worth.
    earlier: f64,
    /// What being finer than others is worth, well within.
    finer: f64,
}

impl Score {
    fn of_patches(overlap: &Overlap) -> Vec<Self> {
        let edges: Vec<f64> = overlap.patches.iter().map(|p| median(&p.spacing)).collect();
        let mut order: Vec<usize> = (0..edges.len()).collect();
        order.sort_by(|i, j| edges[*j].total_cmp(&edges[*i]).then(i.cmp(j)));
        let mut level = 0;
        let mut coarsest = f64::INFINITY;
        let mut levels = vec![0; edges.len()];
        for i in order {
            if coarsest.is_finite() && edges[i] * FINER < coarsest {
                level += 1;
            }
            if !coarsest.is_finite() || edges[i] * FINER < coarsest {
                coarsest = edges[i];
            }
            levels[i] = level;
        }
        let count = edges.len();
        let step = EARLIER.min(FIRST / count.saturating_sub(1).max(1) as f64);
        (0..count)
            .map(|i| Self {
                edge: edges[i],
                earlier: step * (count - 1 - i) as f64,
                finer: 2.0 * FAR * f64::from(levels[i]),
            })
            .collect()
    }

    /// The score at a distance from the border; that of a patch without a border, at an infinite one, is
    /// above those of its kind that have one.
    fn at(&self, to_border: f64) -> f64 {
        let within = to_border / self.edge;
        let finer = if within >= TAPER { self.finer } else { 0.0 };
        // Infinite times nothing is no number.
        let without_border = !within.is_finite();
        if without_border {
            FAR + FIRST + 1.0 + self.finer + self.earlier
        } else {
            within.min(FAR) + finer + self.earlier
        }
    }
}

/// For each patch, whether its triangles are kept.
pub(super) fn kept_triangles(patches: &[Patch], overlap: &Overlap) -> Vec<Vec<bool>> {
    let scores = Score::of_patches(overlap);
    // Vertices of kept triangles, and triangles under vertices of earlier patches that are kept.
    let mut in_kept: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.positions.len()]).collect();
    let mut covered: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.triangles.len()]).collect();
    let mut all = Vec::with_capacity(patches.len());
    for (i, patch) in patches.iter().enumerate() {
        let mine = &overlap.patches[i];
        let owned: Vec<bool> = (0..patch.mesh.positions.len())
            .map(|v| {
                let here = scores[i].at(mine.to_border[v]);
                mine.feet(v).iter().all(|foot| {
                    let j = foot.patch as usize;
                    let corners = patches[j].mesh.triangles[foot.triangle as usize];
                    if j < i && corners.iter().any(|c| in_kept[j][*c as usize]) {
                        return false;
                    }
                    let there = patches[j].mesh.interpolate(
                        &overlap.patches[j].to_border,
                        foot.triangle as usize,
                        foot.barycentric,
                    );
                    foot.beside || here > scores[j].at(there)
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
        for v in (0..patch.mesh.positions.len()).filter(|v| in_kept[i][*v]) {
            for foot in mine.feet(v).iter().filter(|f| f.patch as usize > i && !f.beside) {
                covered[foot.patch as usize][foot.triangle as usize] = true;
            }
        }
        all.push(kept);
    }
    all
}
