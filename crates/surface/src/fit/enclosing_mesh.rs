//! The closed mesh that oriented points enclose, with the topology that they show.
//!
//! Input: points with outward normals. Output: a level set of their indicator, its numbers of bodies and
//! handles, and over which blurs these stay the same.
//!
//! Strong blur closes holes and joins bodies, weak blur makes handles of noise. The topology that stays the
//! same from one blur to the next is taken, that of the weakest blur first.
//!
//! Not guaranteed: details smaller than a grid cell of the indicator.

use super::block_ranges::BlockRanges;
use super::indicator::{BlurredIndicator, CELLS, Indicator, MIN_BLUR_CELLS};
use super::options::Handles;
use crate::layout::mesh_of;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{TriangleMesh, isosurface};
use planish_sense::Neighbourhoods;
use rayon::prelude::*;
use serde::Serialize;

/// Most grid cells along each side. A complex grid then takes 113 MB.
const MAX_CELLS: usize = 192;
/// Steps of the number of cells, which are fast to transform.
const CELL_STEP: usize = 32;
/// Neighbours of which the spacing of a point is the distance.
const NEIGHBOURS: usize = 6;
/// Blurs, in units of the weakest that the grid can represent.
const BLURS: [f64; 4] = [1.0, 1.4, 2.0, 2.8];
// They are used in pairs.
const _: () = assert!(BLURS.len().is_multiple_of(2));
/// Smallest body, as a share of the volume of all.
const MIN_BODY: f64 = 0.01;

/// The closed mesh that readings enclose.
pub(super) struct EnclosingMesh {
    pub mesh: TriangleMesh,
    pub margin: TopologyMargin,
}

/// Numbers of bodies and handles of a closed surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct BodiesAndHandles {
    /// Separate bodies.
    pub components: usize,
    /// Handles of all of them.
    pub genus: usize,
}

/// How far readings can be smoothed until they show another topology.
///
/// The smoothing is that of the solid that they enclose: a Gaussian blur of its indicator, whose σ is a
/// length. Weak smoothing turns noise into handles; strong smoothing closes holes and joins bodies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TopologyMargin {
    /// Smallest and largest σ of the smoothing, of those tried, at which the topology is that of the surface.
    pub smoothing: [f64; 2],
    /// The topology at the next weaker smoothing that was tried, if another was seen there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weaker: Option<BodiesAndHandles>,
    /// The topology at the next stronger smoothing, if another was seen there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stronger: Option<BodiesAndHandles>,
}

/// The border of the solid that points with outward normals enclose: the level set of the weakest blur of
/// which the topology is the wanted one, or that of the next blur as well.
///
/// A wall that is thinner than three cells is gone at all blurs but the weakest, so a grid that shows no
/// topology is followed by one with half the cells.
///
/// # Errors
/// `Undetermined` if the topology depends on the blur, or is the wanted one at none.
pub(super) fn enclosing_mesh(points: &[DVec3], normals: &[DVec3], wanted: Handles) -> Result<EnclosingMesh> {
    let cells = grid_cells(points)?;
    let mut all_handles = match steady_level_set(points, normals, wanted, cells)? {
        LevelSets::Steady(found) => return Ok(found),
        LevelSets::Unsteady(handles) => handles,
    };
    if cells < MAX_CELLS {
        match steady_level_set(points, normals, wanted, (2 * cells).min(MAX_CELLS))? {
            LevelSets::Steady(found) => return Ok(found),
            LevelSets::Unsteady(handles) => all_handles = handles,
        }
    }
    let found = all_handles.join(", ");
    Err(Error::undetermined(match wanted {
        Handles::AsSeen => format!(
            "the number of bodies and handles of the object depends on how strongly its readings are \
             smoothed ({found} handles): they are too few or too noisy to show it"
        ),
        Handles::Exactly(number) => format!(
            "expected readings of a closed surface with {number} handles, found {found} at increasing \
             smoothness: add readings, or specify another genus"
        ),
    }))
}

/// What the level sets on one grid show.
enum LevelSets {
    Steady(EnclosingMesh),
    /// The numbers of handles from weak to strong blur.
    Unsteady(Vec<String>),
}

/// The level set on one grid, if one has the topology.
fn steady_level_set(points: &[DVec3], normals: &[DVec3], wanted: Handles, cells: usize) -> Result<LevelSets> {
    let indicator = Indicator::on_grid(points, normals, cells);
    let blurs = BLURS.map(|blur| MIN_BLUR_CELLS * blur * indicator.cell());
    // Coarser cells join the sides of thin walls: that of a cup of two cells had 7 to 11 handles, not 1.
    let level_set_of = |field: BlurredIndicator| -> Result<(TriangleMesh, Option<BodiesAndHandles>)> {
        let mesh = level_set(&field, field.level(points), field.cell())?;
        let own = bodies_and_handles(&mesh);
        Ok((mesh, own))
    };
    // In pairs: parts of a level set are found by one thread, and those of both at a time.
    let pair_from = |k: usize| -> Result<[(TriangleMesh, Option<BodiesAndHandles>); 2]> {
        let [first, second] = [k, k + 1].map(|k| indicator.blurred(blurs[k]));
        let (first, second) = rayon::join(|| level_set_of(first), || level_set_of(second));
        Ok([first?, second?])
    };
    let (mut meshes, mut seen): (Vec<TriangleMesh>, Vec<Option<BodiesAndHandles>>) = (Vec::new(), Vec::new());
    let is_wanted = |own: Option<BodiesAndHandles>, before: Option<BodiesAndHandles>| match wanted {
        Handles::Exactly(number) => own.is_some_and(|own| own.genus == number),
        Handles::AsSeen => own.is_some() && own == before,
    };
    for k in 0..blurs.len() {
        if k == seen.len() {
            for (mesh, own) in pair_from(k)? {
                meshes.push(mesh);
                seen.push(own);
            }
        }
        let own = seen[k];
        if is_wanted(own, k.checked_sub(1).and_then(|before| seen[before])) {
            let first = match wanted {
                Handles::AsSeen => k.saturating_sub(1),
                Handles::Exactly(_) => k,
            };
            let mesh = meshes.swap_remove(first);
            drop(meshes);
            let mut until = k;
            while until + 1 < blurs.len() {
                if until + 1 == seen.len() {
                    seen.extend(pair_from(until + 1)?.map(|(_, own)| own));
                }
                if seen[until + 1] != own {
                    break;
                }
                until += 1;
            }
            let weaker = first.checked_sub(1).and_then(|before| seen[before]);
            let stronger = seen.get(until + 1).copied().flatten();
            let margin = TopologyMargin { smoothing: [blurs[first], blurs[until]], weaker, stronger };
            return Ok(LevelSets::Steady(EnclosingMesh { mesh, margin }));
        }
    }
    let text = |own: &Option<BodiesAndHandles>| own.map_or("unknown".to_owned(), |own| own.genus.to_string());
    Ok(LevelSets::Unsteady(seen.iter().map(text).collect()))
}

/// Grid cells along each side: about one for the median spacing of points.
fn grid_cells(points: &[DVec3]) -> Result<usize> {
    let near = Neighbourhoods::new(points, NEIGHBOURS)?;
    let mut spacings: Vec<f64> = (0..points.len()).into_par_iter().map(|i| near.spacing(i)).collect();
    let middle = spacings.len() / 2;
    let spacing = *spacings.select_nth_unstable_by(middle, f64::total_cmp).1;
    let cells = Indicator::grid_side(points) / spacing.max(f64::MIN_POSITIVE);
    Ok(((cells / CELL_STEP as f64) as usize * CELL_STEP).clamp(CELLS, MAX_CELLS))
}

/// Numbers of bodies and handles; none if the mesh is not closed, as a level set that leaves the grid.
pub(super) fn bodies_and_handles(mesh: &TriangleMesh) -> Option<BodiesAndHandles> {
    let check = mesh.check();
    let is_closed = check.watertight && check.manifold && check.oriented && check.components > 0;
    let handles = (2 * check.components as i64 - check.euler_characteristic) / 2;
    is_closed.then_some(BodiesAndHandles { components: check.components, genus: handles.max(0) as usize })
}

/// The closed surface on which an indicator has a level, without cavities and small bodies.
fn level_set(field: &BlurredIndicator, level: f64, cell: f64) -> Result<TriangleMesh> {
    let height = |p: DVec3| level - field.sample(p).0;
    let slope = field.largest_slope();
    let ranges = BlockRanges::new(field);
    let near = |p: DVec3, reach: f64| ranges.may_hold(level, p, reach) && height(p).abs() <= slope * reach;
    let mesh = isosurface(&field.bounds(), cell, height, near)?;
    let parts = mesh.parts();
    let mut volumes = vec![0.0; parts.iter().max().map_or(0, |last| *last as usize + 1)];
    for (index, &part) in parts.iter().enumerate() {
        let [a, b, c] = mesh.corners(index);
        volumes[part as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let all: f64 = volumes.iter().map(|v| v.max(0.0)).sum();
    mesh_of(&mesh, |index| volumes[parts[index] as usize] >= MIN_BODY * all)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points all over spheres of radius 10 with centres on a line.
    fn spheres(centres: &[f64], count: usize) -> (Vec<DVec3>, Vec<DVec3>) {
        let on_sphere = |k: usize| {
            let z = 1.0 - (2.0 * k as f64 + 1.0) / count as f64;
            let (angle, across) = (2.399_963 * k as f64, (1.0 - z * z).sqrt());
            DVec3::new(across * angle.cos(), across * angle.sin(), z)
        };
        let all = centres.iter().flat_map(|x| (0..count).map(move |k| (*x, on_sphere(k))));
        all.map(|(x, n)| (DVec3::X * x + 10.0 * n, n)).unzip()
    }

    #[test]
    fn a_narrow_gap_between_bodies_has_a_small_margin() {
        let margin_of = |gap: f64| {
            let (points, normals) = spheres(&[0.0, 20.0 + gap], 4000);
            enclosing_mesh(&points, &normals, Handles::AsSeen).unwrap().margin
        };
        let [narrow, wide] = [1.6, 8.0].map(margin_of);
        let one_body = BodiesAndHandles { components: 1, genus: 0 };
        assert_eq!((narrow.stronger, wide.stronger), (Some(one_body), None), "{narrow:?} {wide:?}");
        assert!(narrow.smoothing[1] < wide.smoothing[1] && wide.weaker.is_none());
    }

    #[test]
    fn an_exact_number_of_handles_must_be_seen() {
        let (points, normals) = spheres(&[0.0], 4000);
        let found = enclosing_mesh(&points, &normals, Handles::Exactly(0)).unwrap();
        assert_eq!(bodies_and_handles(&found.mesh).map(|own| own.genus), Some(0));
        assert!(found.margin.smoothing[0] < found.margin.smoothing[1] && found.margin.stronger.is_none());
        assert!(enclosing_mesh(&points, &normals, Handles::Exactly(2)).is_err());
    }
}
