//! Meshes a surface of a shell.
//!
//! In: a [`Shell`], the choice of the surface, and the cell size. Out: a manifold mesh, and its deviation
//! from the exact surface.
//!
//! - [`IsoLevel::Outer`]: all points at a distance from the mesh that can be reached from outside. One sheet,
//!   for any mesh; narrower gaps are closed, and cavities are left out.
//! - [`IsoLevel::Offset`]: the signed distance minus an offset, for closed meshes. An offset of 0 is the mesh
//!   itself, made manifold. The sign is that of the nearest facet, or if the mesh intersects itself, that of
//!   the winding number (G. Barill et al. 2018).
//! - [`IsoLevel::Shell`]: the zero of the paper's field. It has two sheets, one on either side of the mesh,
//!   which meet around its boundaries. It is thicker by up to `ln(n)/k` where `n` facets are near.
//!
//! The first two are exact distances, meshed by dual contouring ([`planish_mesh::dual_contour()`]), which
//! keeps sharp edges. The third is smooth and meshed by marching tetrahedra.
//!
//! Not guaranteed: parts thinner than a cell are lost.

use crate::field::Shell;
use planish_core::{BoundingBox, DVec3};
use planish_estimate::{Error, Result};
use planish_mesh::{
    DistanceField, MeshCheck, MeshSearch, TriangleMesh, WindingNumbers, dual_contour, isosurface,
};
use rayon::prelude::*;

/// Default number of cells along the diagonal of the mesh. More cells resolve more detail; time grows with
/// their square.
const DEFAULT_CELLS: f64 = 150.0;
/// Cells above this share of the size of an object may miss it altogether.
const MAX_CELL_SHARE: f64 = 0.25;
/// Distance from the mesh, relative to the coordinates, below which a point lies on it within rounding.
const ON_MESH: f64 = 1e-9;
/// Cells between the surface and the start of the grid, of no simple ratio.
const GRID_START: f64 = 2.381_966;
/// Step of the numerical gradient, as a share of a cell.
const STEP: f64 = 1e-3;
/// Largest number of facets at whose centroids the deviation from the paper's shell is evaluated: each costs
/// four sums over facets.
const MAX_DEVIATION_SAMPLES: usize = 20_000;
/// Largest number of facets over which lost parts are searched. With this number, a lost part of a thousandth
/// of the area has 50 places.
const MAX_LOSS_SAMPLES: usize = 50_000;

/// The surface of a shell to be meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum IsoLevel {
    /// `F = 0` of the paper's field, both sheets.
    Shell,
    /// Points at this distance from the mesh, above 0, that can be reached from outside.
    Outer(f64),
    /// Points at this signed distance from a closed mesh, negative inside.
    Offset(f64),
}

/// Options of [`iso_surface`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IsoOptions {
    /// Which surface.
    pub level: IsoLevel,
    /// Side of a cell in the unit of the mesh (default: 1/150 of the diagonal of its bounding box).
    pub cell: Option<f64>,
}

/// A meshed surface and its deviation from the exact one.
#[derive(Debug, Clone)]
pub struct IsoSurface {
    /// The mesh, facing outwards.
    pub mesh: TriangleMesh,
    /// Topological check of the mesh.
    pub check: MeshCheck,
    /// The side of its cells.
    pub cell: f64,
    /// Root mean square distance of facet centroids from the exact surface; for [`IsoLevel::Shell`] to first
    /// order, over at most 20 000 facets.
    pub deviation_rms: f64,
    /// The largest of these distances.
    pub deviation_max: f64,
    /// Number of pairs of triangles that intersect.
    pub self_intersections: usize,
    /// Number of triangles of the original that faced the other way than their neighbours and were reversed.
    pub reversed: usize,
    /// Number of closed sheets that cannot be reached from outside and were left out.
    pub enclosed: usize,
    /// Area of the mesh whose exact surface has no triangle within a cell, relative to all area that has an
    /// exact surface; not determined for [`IsoLevel::Shell`].
    pub lost_area_fraction: Option<f64>,
}

/// Meshes a surface of a shell.
///
/// # Errors
/// `Input` for an invalid cell size or offset; `Undetermined` if the surface needs an inside and the mesh is
/// open or has one side only, or if the surface is empty; `Unsupported` for too many cells.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::{IsoLevel, IsoOptions, Metaball, Shell, ShellOptions, iso_surface};
/// let ball = icosphere(1.0, 3);
/// let shell = Shell::new(&ball, &ShellOptions::new(Metaball::Triangular, 50.0))?;
/// let made = iso_surface(&shell, &IsoOptions { level: IsoLevel::Offset(0.2), cell: Some(0.1) })?;
/// assert!(made.check.watertight && made.check.manifold && made.deviation_max < 0.01);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn iso_surface(shell: &Shell<'_>, options: &IsoOptions) -> Result<IsoSurface> {
    let bounds = shell
        .mesh()
        .surface_bounds()
        .ok_or_else(|| Error::undetermined("expected a mesh with vertices, found none"))?;
    if let Some(cell) = options.cell.filter(|cell| !(cell.is_finite() && *cell > 0.0)) {
        return Err(Error::input(format!("expected a cell size > 0, found {cell}")));
    }
    let cell = options.cell.unwrap_or(bounds.diagonal() / DEFAULT_CELLS);
    match options.level {
        IsoLevel::Shell => {
            let [low, high] = shell.band();
            let may_pass = |at: DVec3, reach: f64| {
                let nearest = shell.nearest(at);
                nearest - reach <= high && nearest + reach >= low
            };
            let value = |at: DVec3| shell.level(at);
            let mesh = isosurface(&bounds.grown(high.max(0.0) + 2.0 * cell), cell, value, may_pass)?;
            if mesh.triangles.is_empty() {
                let cause = "the thickness of the shell is below ln(T)/k (T: threshold, 1/k: softness): use \
                             a larger thickness, a smaller threshold or a smaller softness";
                return Err(empty(cell, &bounds, cause));
            }
            measured(mesh, cell, &|at| deviation(at, cell, &value), MAX_DEVIATION_SAMPLES)
        }
        IsoLevel::Outer(distance) if !(distance.is_finite() && distance > 0.0) => {
            Err(Error::input(format!("expected a distance of the outer surface above 0, found {distance}")))
        }
        IsoLevel::Offset(offset) if !offset.is_finite() => {
            Err(Error::input(format!("expected a finite offset, found {offset}")))
        }
        IsoLevel::Outer(offset) | IsoLevel::Offset(offset) => {
            let is_outer = matches!(options.level, IsoLevel::Outer(_));
            let field = ExactDistance::new(shell.mesh(), offset, is_outer)?;
            // Around an open mesh, the surface encloses a sheet that is two distances thick.
            let thinnest = if field.sides.is_none() { offset } else { f64::INFINITY };
            let cell = match options.cell {
                None => cell.min(thinnest),
                Some(cell) if cell > thinnest => {
                    return Err(Error::input(format!(
                        "expected cells of at most the distance from an open mesh, {offset}, found {cell}"
                    )));
                }
                Some(cell) => cell,
            };
            // The box begins at a share of a cell, because planes of a mesh through corners of the grid would
            // make triangles without area.
            let around = offset.max(0.0) + GRID_START * cell;
            let mesh = dual_contour(&bounds.grown(around), cell, &field)?;
            if mesh.triangles.is_empty() {
                let cause = format!(
                    "the offset {offset} is more than half of the thickness inwards, or parts are thinner \
                     than a cell ({cell}): use a smaller offset or smaller cells"
                );
                return Err(empty(cell, &bounds, &cause));
            }
            // Before enclosed parts are left out, which are no loss.
            let lost = lost_area_fraction(shell.mesh(), &mesh, &field, cell)?;
            let (mesh, enclosed) = if is_outer { reachable_parts(mesh) } else { (mesh, 0) };
            let found = measured(mesh, cell, &|at| field.distance(at).abs(), usize::MAX)?;
            Ok(IsoSurface { enclosed, reversed: field.reversed, lost_area_fraction: Some(lost), ..found })
        }
    }
}

/// Error about an empty surface: cells that are too large, or another cause.
fn empty(cell: f64, bounds: &BoundingBox, cause: &str) -> Error {
    let size = bounds.longest_side();
    let cause = match cell > MAX_CELL_SHARE * size {
        true => format!(
            "the cells ({cell}) are too large for an object of size {size}: use cells of at most {}",
            size / 10.0
        ),
        false => cause.to_owned(),
    };
    Error::undetermined(format!("the surface is empty: {cause}"))
}

/// The distance of a point from a surface at an offset from a mesh.
struct ExactDistance {
    search: MeshSearch,
    offset: f64,
    /// How inside and outside differ; `None` if the distance has no sign.
    sides: Option<Sides>,
    /// Number of triangles that were reversed to face the same way as their neighbours.
    reversed: usize,
}

/// How points inside of a closed mesh are recognised.
enum Sides {
    /// By the normal at the nearest point, times this sign: exact if facets do not intersect.
    ByNormal(f64),
    /// By the winding number.
    ByWinding(WindingNumbers),
}

impl ExactDistance {
    /// The distance has a sign if the mesh is closed. With `may_be_open`, it may be open.
    fn new(mesh: &TriangleMesh, offset: f64, may_be_open: bool) -> Result<Self> {
        let welded = mesh.welded();
        let check = welded.check();
        if check.boundary_edges > 0 && may_be_open {
            return Ok(Self { search: MeshSearch::try_new(mesh)?, offset, sides: None, reversed: 0 });
        }
        if check.boundary_edges > 0 {
            return Err(Error::undetermined(format!(
                "expected a closed mesh, found {} boundary edges: mesh the outer surface at a distance \
                 above 0, or close it",
                check.boundary_edges
            )));
        }
        // Signs follow from the side that faces outwards, by normals as well as by winding numbers.
        let (oriented, reversed) = match check.misoriented_edges {
            0 => (welded, 0),
            _ => welded.consistently_oriented()?,
        };
        let search = MeshSearch::try_new(&oriented)?;
        let clean = check.manifold && check.components == 1 && search.self_crossings().pairs == 0;
        let sides = match oriented.signed_volume() {
            Some(volume) if clean && volume != 0.0 => Sides::ByNormal(volume.signum()),
            _ => Sides::ByWinding(WindingNumbers::new(&oriented)),
        };
        Ok(Self { search, offset, sides: Some(sides), reversed })
    }
}

impl DistanceField for ExactDistance {
    fn distance(&self, at: DVec3) -> f64 {
        self.distance_and_gradient(at).0
    }

    fn distance_and_gradient(&self, at: DVec3) -> (f64, DVec3) {
        let Some(foot) = self.search.closest(at) else { return (f64::INFINITY, DVec3::ZERO) };
        let (sign, outwards) = match &self.sides {
            None => (1.0, 1.0),
            Some(Sides::ByNormal(outwards)) => (outwards * foot.signed_distance.signum(), *outwards),
            Some(Sides::ByWinding(winding)) => {
                let sign = if winding.at(at).abs() > 0.5 { -1.0 } else { 1.0 };
                // Facets may face either way, so the normal is only used where the sign of both is known.
                (sign, sign * foot.signed_distance.signum())
            }
        };
        // On the mesh itself, the direction from the nearest point is undetermined.
        let direction = (at - foot.point).try_normalize().filter(|_| foot.distance > ON_MESH * at.length());
        let gradient = direction.map_or(outwards * foot.normal, |direction| sign * direction);
        (sign * foot.distance - self.offset, gradient)
    }

    fn may_pass(&self, at: DVec3, reach: f64) -> bool {
        // Both sides of the mesh: the sign costs more than the corners of the cells that it would exclude.
        (self.search).closest(at).is_none_or(|foot| (foot.distance - self.offset.abs()).abs() <= reach)
    }
}

/// The fraction of the exact surface that a mesh lacks, by places over the facets of the original.
///
/// The exact surface over a facet is at the offset along its normal, unless another facet is nearer to that
/// place.
fn lost_area_fraction(
    original: &TriangleMesh,
    made: &TriangleMesh,
    field: &ExactDistance,
    cell: f64,
) -> Result<f64> {
    // An empty mesh is reported by the caller.
    if made.triangles.is_empty() {
        return Ok(0.0);
    }
    let search = MeshSearch::try_new(made)?;
    let normals = original.face_normals();
    let every = original.triangles.len().div_ceil(MAX_LOSS_SAMPLES).max(1);
    let sums = (0..original.triangles.len()).into_par_iter().step_by(every).map(|t| {
        let [a, b, c] = original.corners(t);
        let area = 0.5 * (b - a).cross(c - a).length();
        let place = |side: f64| original.point_at(t, [1.0 / 3.0; 3]) + side * field.offset * normals[t];
        let places = [1.0, -1.0].map(place).into_iter().filter(|p| field.distance(*p).abs() < 1e-3 * cell);
        places.fold([0.0; 2], |[lost, all], p| {
            let is_lost = search.closest_within(p, cell).is_none();
            [lost + if is_lost { area } else { 0.0 }, all + area]
        })
    });
    // Collected first: sums in a fixed order do not depend on the number of threads.
    let sums: Vec<[f64; 2]> = sums.collect();
    let [lost, all] = sums.iter().fold([0.0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    Ok(if all > 0.0 { lost / all } else { 0.0 })
}

/// The parts of closed surfaces that can be reached from outside, and the number of the others.
///
/// A part that encloses a cavity faces inwards, so its volume is negative. A part within a cavity lies inside
/// of another part.
fn reachable_parts(mesh: TriangleMesh) -> (TriangleMesh, usize) {
    let parts = mesh.parts();
    let count = parts.iter().max().map_or(0, |last| *last as usize + 1);
    if count <= 1 {
        return (mesh, 0);
    }
    let mut volumes = vec![0.0; count];
    let mut first = vec![DVec3::ZERO; count];
    let origin = mesh.positions[0];
    for (t, part) in parts.iter().enumerate() {
        let [a, b, c] = mesh.corners(t).map(|p| p - origin);
        volumes[*part as usize] += a.dot(b.cross(c)) / 6.0;
        first[*part as usize] = mesh.corners(t)[0];
    }
    let of_part = |n: usize| TriangleMesh {
        positions: mesh.positions.clone(),
        triangles: (mesh.triangles.iter().zip(&parts))
            .filter(|(_, part)| **part as usize == n)
            .map(|(t, _)| *t)
            .collect(),
    };
    let mut order: Vec<usize> = (0..count).filter(|&n| volumes[n] > 0.0).collect();
    order.sort_by(|&a, &b| volumes[b].total_cmp(&volumes[a]));
    let mut kept: Vec<(usize, WindingNumbers)> = Vec::new();
    for n in order {
        if kept.iter().all(|(_, other)| other.at(first[n]) < 0.5) {
            kept.push((n, WindingNumbers::new(&of_part(n))));
        }
    }
    let is_kept = |part: u32| kept.iter().any(|(n, _)| *n == part as usize);
    let triangles: Vec<[u32; 3]> =
        (mesh.triangles.iter().zip(&parts)).filter(|(_, part)| is_kept(**part)).map(|(t, _)| *t).collect();
    let enclosed = count - kept.len();
    (used_vertices(&TriangleMesh { positions: mesh.positions, triangles }), enclosed)
}

/// A mesh without unused vertices.
fn used_vertices(mesh: &TriangleMesh) -> TriangleMesh {
    let mut new_from_old = vec![u32::MAX; mesh.positions.len()];
    let mut positions = Vec::new();
    let triangles = (mesh.triangles.iter())
        .map(|t| {
            t.map(|v| {
                let new = &mut new_from_old[v as usize];
                if *new == u32::MAX {
                    *new = positions.len() as u32;
                    positions.push(mesh.positions[v as usize]);
                }
                *new
            })
        })
        .collect();
    TriangleMesh { positions, triangles }
}

/// The mesh with its check, and with the deviations of the centroids of at most `samples` of its triangles.
fn measured(
    mesh: TriangleMesh,
    cell: f64,
    deviation: &(impl Fn(DVec3) -> f64 + Sync),
    samples: usize,
) -> Result<IsoSurface> {
    let every = mesh.triangles.len().div_ceil(samples).max(1);
    let deviations: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .step_by(every)
        .map(|t| deviation(mesh.point_at(t, [1.0 / 3.0; 3])))
        .collect();
    Ok(IsoSurface {
        check: mesh.check(),
        self_intersections: MeshSearch::try_new(&mesh)?.self_crossings().pairs,
        cell,
        deviation_rms: (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt(),
        deviation_max: deviations.iter().copied().fold(0.0, f64::max),
        enclosed: 0,
        reversed: 0,
        lost_area_fraction: None,
        mesh,
    })
}

/// Distance of a point from the zero surface nearby, to first order: value divided by slope.
fn deviation(at: DVec3, cell: f64, value: &(impl Fn(DVec3) -> f64 + Sync)) -> f64 {
    let at_point = value(at);
    let step = STEP * cell;
    // One-sided differences: the estimate is of first order anyway, and each value costs a search.
    let slope: DVec3 = DVec3::from_array(std::array::from_fn(|k| {
        let mut at = at;
        at[k] += step;
        (value(at) - at_point) / step
    }));
    // The value is a distance, whose slope is 1. On a ridge between two facets the difference is smaller.
    at_point.abs() / slope.length().clamp(0.5, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Metaball, ShellOptions};
    use planish_mesh::{grid_sheet, icosphere};

    fn made(mesh: &TriangleMesh, shell: &ShellOptions, level: IsoLevel, cell: f64) -> IsoSurface {
        let shell = Shell::new(mesh, shell).unwrap();
        let made = iso_surface(&shell, &IsoOptions { level, cell: Some(cell) }).unwrap();
        assert!(made.check.watertight && made.check.manifold && made.check.oriented, "{:?}", made.check);
        made
    }

    /// Offsets of a ball are balls of the requested radii: both sheets, and the outer one alone.
    #[test]
    fn surfaces_of_a_ball_are_balls() {
        let ball = icosphere(1.0, 3);
        let shell = ShellOptions { thickness: 0.1, ..ShellOptions::new(Metaball::Triangular, 100.0) };
        for (level, offset) in [
            (IsoLevel::Offset(0.15), 0.15),
            (IsoLevel::Offset(-0.2), -0.2),
            (IsoLevel::Offset(0.0), 0.0),
            (IsoLevel::Outer(0.1), 0.1),
        ] {
            let found = made(&ball, &shell, level, 0.1);
            assert_eq!(found.check.euler_characteristic, 2);
            for p in &found.mesh.positions {
                assert!((p.length() - 1.0 - offset).abs() < 0.03, "{offset}: {}", p.length());
            }
            assert!(found.deviation_rms <= found.deviation_max && found.deviation_max < 0.02);
        }
        let both = made(&ball, &shell, IsoLevel::Shell, 0.06);
        assert_eq!((both.check.components, both.check.euler_characteristic), (2, 4));
        let shell = Shell::new(&ball, &shell).unwrap();
        for p in &both.mesh.positions {
            // The bulge: the fields of several facets add up.
            assert!((0.09..0.2).contains(&(p.length() - 1.0).abs()), "{}", p.length());
            assert!(shell.level(*p).abs() < 1e-5 && shell.field(*p).abs() < 1e-2);
        }
    }

    /// An open mesh has no inside, but a shell all around.
    #[test]
    fn open_meshes_have_a_closed_shell_but_no_offset() {
        let mut sheet = grid_sheet(1.0, 1.0, 8, 8);
        sheet.positions.iter_mut().for_each(|p| p[2] = 0.1 * (3.0 * p[0]).sin());
        let options = ShellOptions { thickness: 0.12, ..ShellOptions::new(Metaball::Triangular, 60.0) };
        assert_eq!(made(&sheet, &options, IsoLevel::Shell, 0.05).check.euler_characteristic, 2);
        let shell = Shell::new(&sheet, &options).unwrap();
        let asked =
            |level| iso_surface(&shell, &IsoOptions { level, cell: Some(0.05) }).unwrap_err().to_string();
        assert!(asked(IsoLevel::Offset(0.1)).contains("boundary edges"));
        let thin = ShellOptions { threshold: 1e9, ..options };
        let thin = Shell::new(&sheet, &thin).unwrap();
        let empty = iso_surface(&thin, &IsoOptions { level: IsoLevel::Shell, cell: Some(0.05) });
        assert!(empty.unwrap_err().to_string().contains("empty"));
    }

    /// Triangles that face the wrong way do not change the surface: they are reversed first.
    #[test]
    fn reversed_triangles_do_not_change_an_offset() {
        let ball = icosphere(1.0, 3);
        let options = ShellOptions::new(Metaball::Triangular, 60.0);
        for (offset, every) in [(0.0, 3), (0.2, 4), (-0.1, 7)] {
            let right = made(&ball, &options, IsoLevel::Offset(offset), 0.1);
            let mut mixed = ball.clone();
            mixed.triangles.iter_mut().step_by(every).for_each(|t| t.swap(0, 1));
            let found = made(&mixed, &options, IsoLevel::Offset(offset), 0.1);
            assert_eq!(found.reversed, ball.triangles.len().div_ceil(every));
            assert_eq!(right.reversed, 0);
            let volume = |made: &IsoSurface| made.mesh.signed_volume().unwrap();
            assert!((volume(&found) / volume(&right) - 1.0).abs() < 1e-9, "{offset}");
            assert!(found.deviation_max < 0.05);
        }
    }

    /// Cells that are larger than the object are named as the cause.
    #[test]
    fn cells_larger_than_the_object_are_named() {
        let ball = icosphere(1.0, 2);
        let shell = Shell::new(&ball, &ShellOptions::new(Metaball::Triangular, 60.0)).unwrap();
        for level in [IsoLevel::Offset(0.0), IsoLevel::Shell, IsoLevel::Outer(0.1)] {
            if let Err(e) = iso_surface(&shell, &IsoOptions { level, cell: Some(50.0) }) {
                assert!(e.to_string().contains("use cells of at most 0.2"), "{e}");
            }
        }
    }

    /// The outer surface of an open sheet goes around it at exactly the distance, and cells that cannot
    /// resolve the sheet are rejected. The cavity of a hollow ball is left out.
    #[test]
    fn outer_surfaces_are_one_sheet_at_the_distance() {
        let sheet = grid_sheet(1.0, 1.0, 8, 8);
        let options = ShellOptions::new(Metaball::Triangular, 60.0);
        let found = made(&sheet, &options, IsoLevel::Outer(0.06), 0.03);
        assert_eq!((found.check.components, found.check.euler_characteristic), (1, 2));
        let search = MeshSearch::try_new(&sheet).unwrap();
        for p in &found.mesh.positions {
            assert!((search.closest(*p).unwrap().distance - 0.06).abs() < 1e-3);
        }
        let shell = Shell::new(&sheet, &options).unwrap();
        let coarse = iso_surface(&shell, &IsoOptions { level: IsoLevel::Outer(0.06), cell: Some(0.1) });
        assert!(coarse.unwrap_err().to_string().contains("open mesh"));
        let mut hollow = icosphere(1.0, 3);
        let first = hollow.positions.len() as u32;
        let inner = icosphere(0.6, 3);
        hollow.positions.extend(inner.positions);
        hollow.triangles.extend(inner.triangles.iter().map(|[a, b, c]| [a, c, b].map(|v| v + first)));
        let outer = made(&hollow, &options, IsoLevel::Outer(0.1), 0.1);
        assert_eq!((outer.check.components, outer.enclosed), (1, 1));
        assert_eq!(made(&hollow, &options, IsoLevel::Offset(0.1), 0.1).check.components, 2);
    }

    /// A plate thinner than a cell is lost in part, which is reported; with smaller cells nothing is lost.
    #[test]
    fn lost_parts_are_reported() {
        let plate =
            planish_mesh::parallelepiped(DVec3::ZERO, [DVec3::X, DVec3::Y, 0.02 * DVec3::new(0.1, 0.2, 1.0)]);
        let options = ShellOptions::new(Metaball::Triangular, 60.0);
        let shell = Shell::new(&plate, &options).unwrap();
        let lost = |cell: f64| {
            let options = IsoOptions { level: IsoLevel::Offset(0.0), cell: Some(cell) };
            iso_surface(&shell, &options).map_or(1.0, |made| made.lost_area_fraction.unwrap())
        };
        assert!(lost(0.1) > 0.1 && lost(0.01) < 1e-3, "{} {}", lost(0.1), lost(0.01));
    }

    /// Facets with inconsistent orientation, nested and intersecting parts: generalised winding numbers
    /// determine the inside.
    #[test]
    fn crossing_balls_have_one_outer_surface() {
        let mut two = icosphere(1.0, 3);
        let first = two.positions.len() as u32;
        let other = icosphere(1.0, 3);
        two.positions.extend(other.positions.iter().map(|p| DVec3::new(p.x + 1.1, p.y, p.z)));
        two.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
        let options = ShellOptions::new(Metaball::Triangular, 60.0);
        let found = made(&two, &options, IsoLevel::Offset(0.1), 0.08);
        assert_eq!((found.check.components, found.check.euler_characteristic), (1, 2));
    }
}
