//! Which patch has which place.
//!
//! Comes in: patches and where they lie on one another. Goes out: the triangles of each that are kept: those whose corners are farther from the border of their patch than what they lie on is from its own, and of these none that
//! lies on a kept one of an earlier patch or beside it. So a gap of an edge or two is left along every seam, whatever is rounded where.

use super::{Overlap, Patch};

/// For each patch, whether its triangles are kept.
pub(super) fn kept_triangles(patches: &[Patch], overlap: &Overlap) -> Vec<Vec<bool>> {
    // Vertices of kept triangles, and triangles under vertices of earlier patches that are kept.
    let mut in_kept: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.positions.len()]).collect();
    let mut covered: Vec<Vec<bool>> = patches.iter().map(|p| vec![false; p.mesh.triangles.len()]).collect();
    let mut all = Vec::with_capacity(patches.len());
    for (i, patch) in patches.iter().enumerate() {
        let mine = &overlap.patches[i];
        let owned: Vec<bool> = (0..patch.mesh.positions.len())
            .map(|v| {
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
                    // Infinite times nothing is no number: a patch without a border, which loses to none but itself.
                    let there = if there.is_nan() { f64::INFINITY } else { there };
                    foot.beside || mine.to_border[v] > there || mine.to_border[v] == there && i < j
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
