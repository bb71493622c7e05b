//! What no patch covers, taken from a surface that bounds the thing.
//!
//! Comes in: a merged surface, and a mesh that the thing lies within, such as the visual hull of its silhouettes (A. Laurentini 1994). Goes out: one mesh, in which the bound stands where no patch is. Not guaranteed: that the thing is as large there as what bounds it.

use planish_estimate::Result;
use planish_estimate::vector3::dot;
use planish_mesh::{Fused, MeshSearch, Overlap, OverlapOptions, Patch, ZipOptions, Zipped, zipped};
use rayon::prelude::*;

/// Under patches and over them, the bound is left out up to so many of its edges away.
const OVER: f64 = 6.0;
/// Beyond the border of a patch it is left out up to so many edges away, so that there is room to sew.
const BESIDE: f64 = 1.0;
/// Normals of one side of a thing differ by less.
const LARGEST_ANGLE_RAD: f64 = 1.2;
/// What is left of the bound lies on no patch: ε, in edges.
const EPSILON: f64 = 0.01;

/// A whole and how much of it is the bound's.
pub(super) struct Completed {
    /// The whole; patch 0 of its sources is what was merged, 1 the bound.
    pub whole: Zipped,
    /// Vertices that are the bound's.
    pub vertices: usize,
}

/// Sews a bound to what was merged, where that has nothing. σ of the bound is its own, or the length of its edges: what a hull from few views is known to is not stated by it.
pub(super) fn completed(merged: &Zipped, bound: &Patch, fill: usize) -> Result<Completed> {
    let search = MeshSearch::try_new(&merged.mesh)?;
    let mut mesh = bound.mesh.clone();
    // Of an equilateral triangle with the mean area.
    let edge = (mesh.area() / mesh.triangles.len() as f64 * 4.0 / 3.0_f64.sqrt()).sqrt();
    let mut normals = mesh.vertex_normals();
    let agreement: f64 = (mesh.positions.par_iter().zip(&normals))
        .filter_map(|(p, n)| Some(dot(*n, search.closest_within(*p, OVER * edge)?.normal)))
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    if agreement < 0.0 {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        normals = mesh.vertex_normals();
    }
    let covered: Vec<bool> = (mesh.positions.par_iter().zip(&normals))
        .map(|(p, n)| {
            let foot = search.closest_compatible_within(*p, *n, LARGEST_ANGLE_RAD, OVER * edge);
            foot.is_some_and(|foot| !foot.on_boundary || foot.distance <= BESIDE * edge)
        })
        .collect();
    mesh.triangles.retain(|t| t.iter().all(|v| !covered[*v as usize]));
    let sigma = match bound.sigma.is_empty() {
        true => vec![edge; mesh.positions.len()],
        false => bound.sigma.clone(),
    };
    let rest = Patch::tidy(&mesh, &sigma)?.patch;
    let first = Patch {
        mesh: merged.mesh.clone(),
        sigma: merged.sigma.clone(),
    };
    if rest.mesh.triangles.is_empty() {
        return Ok(Completed {
            whole: Zipped {
                source: (0..merged.source.len() as u32).map(|v| (0, v)).collect(),
                ..merged.clone()
            },
            vertices: 0,
        });
    }
    let patches = [first, rest];
    let options = OverlapOptions {
        epsilon: Some(EPSILON * edge),
        theta_rad: None,
    };
    let overlap = Overlap::find(&patches, &options)?;
    let places = patches.each_ref().map(|patch| Fused {
        positions: patch.mesh.positions.clone(),
        sigma: patch.sigma.clone(),
    });
    let whole = zipped(&patches, &overlap, &places, &ZipOptions { fill })?;
    let vertices = whole.source.iter().filter(|(patch, _)| *patch == 1).count();
    Ok(Completed { whole, vertices })
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_estimate::vector3::norm;
    use planish_mesh::icosphere;

    /// A ball of which two patches leave the poles open, in a bound that is a little larger and faces inwards.
    #[test]
    fn holes_are_closed_by_the_bound_and_patches_stay() {
        let mut ball = icosphere(10.0, 4);
        ball.triangles
            .retain(|t| t.iter().all(|v| ball.positions[*v as usize][2].abs() < 7.0));
        let patch = Patch::tidy(&ball, &vec![0.02; ball.positions.len()]).unwrap().patch;
        let mut bound = icosphere(10.3, 4);
        bound.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        let count = patch.mesh.positions.len();
        let merged = Zipped {
            source: vec![(0, 0); count],
            stitched: vec![false; count],
            kept: patch.mesh.triangles.len(),
            holes_closed: 0,
            turned: 0,
            valence: Vec::new(),
            mesh: patch.mesh,
            sigma: patch.sigma,
        };
        let done = completed(
            &merged,
            &Patch {
                mesh: bound,
                sigma: Vec::new(),
            },
            0,
        )
        .unwrap();
        let check = done.whole.mesh.check();
        assert!(check.watertight && check.oriented && check.components == 1, "{check:?}");
        assert!(done.vertices > 100);
        for (p, (source, _)) in done.whole.mesh.positions.iter().zip(&done.whole.source) {
            let radius = if *source == 0 { 10.0 } else { 10.3 };
            assert!((norm(*p) - radius).abs() < 1e-9, "{p:?}");
        }
        let kept = done.whole.source.iter().filter(|(source, _)| *source == 0).count();
        assert_eq!(kept, count);
    }
}
