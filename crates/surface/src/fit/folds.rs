//! Places where a surface passes through itself.
//!
//! Input: a surface. Output: where a triangle of its mesh intersects another. The border of a solid never
//! does that, so one of the sides is wrong there, however small the residuals are.
//!
//! Not guaranteed: folds that are as thin as the chord error of the mesh.

use super::leaves::leaf_areas;
use crate::model::middles;
use crate::observe::Foot;
use planish_core::DVec3;
use planish_core::numbers::significant;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::{Surface, TessellationOptions, tessellate};

/// Chord error of the mesh, as a share of the side of a square with the mean area of the leaves, and most
/// divisions along a side of a leaf.
const TOLERANCE: f64 = 0.05;
const MAX_DIVISIONS: u32 = 4;
/// Divisions of a leaf into the squares that are marked around each place.
const MARKS_DEPTH: u8 = 2;

/// Share of the area that passes through itself above which a surface with creases is given up.
const MAX_FOLDED_AT_CREASES: f64 = 0.01;

/// Gives a surface with creases up if it folds: further rounds fold more of it.
///
/// # Errors
/// `Undetermined` if more than 1 % of its area passes through itself.
pub(super) fn refuse_folds_at_creases(surface: &Surface) -> Result<()> {
    if surface.space().has_creases() && Folds::of(surface, None)?.area_fraction > MAX_FOLDED_AT_CREASES {
        return Err(Error::undetermined("the surface passes through itself at sharp edges"));
    }
    Ok(())
}

/// Where a surface passes through itself.
#[derive(Debug, Clone, Default)]
pub(super) struct Folds {
    /// Corners of the triangles, and middles of the marks of their leaves: leaves, and places in them. Other
    /// meshes of the surface cross at other places of these leaves.
    pub places: Vec<(usize, [f64; 2])>,
    /// Share of the area of the leaves, of those pairs of which at least one is measured.
    pub area_fraction: f64,
    /// A corner of the first of the triangles.
    pub example: DVec3,
}

impl Folds {
    /// A leaf is measured if it holds one of the feet; without feet, all leaves are.
    ///
    /// # Errors
    /// As for [`tessellate`].
    pub(super) fn of(surface: &Surface, feet: Option<&[Foot]>) -> Result<Self> {
        let areas = leaf_areas(surface);
        let all: f64 = areas.iter().sum();
        let tolerance = TOLERANCE * (all / areas.len() as f64).sqrt();
        let made = tessellate(surface, &TessellationOptions { tolerance, max_divisions: MAX_DIVISIONS })?;
        let mesh = TriangleMesh::try_new(made.positions, made.triangles)?;
        let pairs = MeshSearch::try_new(&mesh)?.crossing_pairs();
        let Some(&[first, _]) = pairs.first() else {
            return Ok(Self::default());
        };
        let leaf_of = |triangle: u32| made.leaf[mesh.triangles[triangle as usize][0] as usize] as usize;
        let mut is_measured = vec![feet.is_none(); areas.len()];
        feet.into_iter().flatten().for_each(|foot| is_measured[foot.leaf as usize] = true);
        // Sides that nothing was measured on are marked as such, wherever they run.
        let contradict =
            pairs.iter().map(|pair| pair.map(leaf_of)).filter(|[a, b]| is_measured[*a] || is_measured[*b]);
        let mut leaves: Vec<usize> = contradict.flatten().collect();
        leaves.sort_unstable();
        leaves.dedup();
        let mut vertices: Vec<u32> =
            pairs.iter().flatten().flat_map(|&t| mesh.triangles[t as usize]).collect();
        let mut crossing: Vec<usize> = pairs.iter().flatten().map(|&t| leaf_of(t)).collect();
        crossing.sort_unstable();
        crossing.dedup();
        vertices.sort_unstable();
        vertices.dedup();
        Ok(Self {
            places: (vertices.iter().map(|&v| v as usize))
                .map(|v| (made.leaf[v] as usize, made.local[v]))
                .chain(crossing.iter().flat_map(|&leaf| middles(MARKS_DEPTH).map(move |at| (leaf, at))))
                .collect(),
            area_fraction: leaves.iter().map(|&leaf| areas[leaf]).sum::<f64>() / all,
            example: mesh.corners(first as usize)[0],
        })
    }

    /// All places in space.
    pub(super) fn points(&self, surface: &Surface) -> Vec<DVec3> {
        self.places.iter().map(|&(leaf, [s, t])| surface.leaf_point(leaf, s, t)).collect()
    }

    /// What a user should know, up to the reason; none without folds. Places are relative to `origin`.
    pub(super) fn text(&self, origin: DVec3) -> Option<String> {
        let place = (self.example + origin).to_array().map(|c| significant(c, 4)).join(", ");
        (!self.places.is_empty()).then(|| {
            let part = if self.area_fraction > 0.0 {
                format!("on {} % of its area", significant(100.0 * self.area_fraction, 2))
            } else {
                "where nothing was measured".to_owned()
            };
            format!("the surface passes through itself {part}, for example near ({place})")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_spline::BaseShape;

    #[test]
    fn a_surface_that_passes_through_itself_is_found() {
        let ball = BaseShape::sphere(DVec3::ZERO, 10.0, DVec3::Z).surface([16, 8]).unwrap();
        assert!(Folds::of(&ball, Some(&[])).unwrap().places.is_empty());
        // One side is pushed through the other.
        let pushed: Vec<DVec3> =
            ball.vertices().iter().map(|p| if p.x > 8.0 { *p - 22.0 * DVec3::X } else { *p }).collect();
        let pushed = ball.with_vertices(pushed).unwrap();
        let folds = Folds::of(&pushed, Some(&[])).unwrap();
        assert!(folds.places.len() > 10 && folds.example.x < 0.0, "{folds:?}");
        assert_eq!(folds.area_fraction, 0.0, "nothing was measured");
        assert!(Folds::of(&pushed, None).unwrap().area_fraction > 0.01);
    }
}
