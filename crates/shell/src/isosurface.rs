//! Meshes a surface of a shell.
//!
//! In: a [`Shell`], the choice of the surface, and the cell size. Out: a manifold mesh, and its deviation
//! from the exact surface.
//!
//! - [`IsoLevel::Shell`]: the zero of the paper's field. It has two sheets, one on either side of the mesh,
//!   which meet around its boundaries.
//! - [`IsoLevel::Outer`]: the outer sheet of that field, for closed meshes.
//! - [`IsoLevel::Offset`]: the smooth distance minus an offset, with the sign of the winding number (G.
//!   Barill et al. 2018). An offset of 0 is the mesh itself, made manifold.
//!
//! The distance of the nearest facet shows which cells cannot contain the surface; these are not evaluated.
//!
//! Not guaranteed: parts thinner than a cell are lost, and sharp edges are cut off by chords.

use crate::field::Shell;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshCheck, TriangleMesh, WindingNumbers, isosurface};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Default number of cells along the diagonal of the mesh. More cells resolve more detail; time grows with
/// their square.
const DEFAULT_CELLS: f64 = 150.0;
/// Step of the numerical gradient, as a share of a cell.
const STEP: f64 = 1e-3;
/// Largest number of facets at whose centroids the deviation is evaluated.
const MAX_DEVIATION_SAMPLES: usize = 20_000;

/// The surface of a shell to be meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum IsoLevel {
    /// `F = 0` of the paper's field, both sheets.
    Shell,
    /// The outer sheet of `F = 0`, for closed meshes.
    Outer,
    /// Points at this smooth distance from the mesh, negative inside; for closed meshes.
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
    /// Root mean square distance of facet centroids from the exact surface, to first order, over at most 20
    /// 000 facets. Vertices lie on the surface to within a millionth of a cell.
    pub deviation_rms: f64,
    /// The largest of these distances.
    pub deviation_max: f64,
}

/// Meshes a surface of a shell.
///
/// # Errors
/// `Input` for an invalid cell size or offset; `Undetermined` if the surface needs an inside and the mesh is
/// open, or if the surface is empty; `Unsupported` for too many cells.
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
    let cell = options.cell.unwrap_or(bounds.diagonal() / DEFAULT_CELLS);
    if !(cell.is_finite() && cell > 0.0) {
        return Err(Error::input(format!("expected a cell size > 0, found {cell}")));
    }
    let winding = match options.level {
        IsoLevel::Shell => None,
        IsoLevel::Outer | IsoLevel::Offset(_) => {
            let open = welded(shell.mesh()).check().boundary_edges;
            if open > 0 {
                return Err(Error::undetermined(format!(
                    "expected a closed mesh, found {open} boundary edges: mesh both sheets of its shell, \
                     or close it"
                )));
            }
            Some(WindingNumbers::new(shell.mesh()))
        }
    };
    let is_inside = |at: DVec3| winding.as_ref().is_some_and(|w| w.at(at) > 0.5);
    // Distances of the nearest facet between which the surface may pass.
    let [low, high] = match options.level {
        IsoLevel::Shell | IsoLevel::Outer => shell.band(),
        IsoLevel::Offset(offset) if offset.is_finite() => [offset.abs() - shell.slack(), offset.abs()],
        IsoLevel::Offset(offset) => {
            return Err(Error::input(format!("expected a finite offset, found {offset}")));
        }
    };
    let value = |at: DVec3| match options.level {
        IsoLevel::Shell => shell.level(at),
        IsoLevel::Outer => match (shell.level(at), is_inside(at)) {
            (level, true) => -level.abs(),
            (level, false) => level,
        },
        IsoLevel::Offset(offset) => match (shell.unsigned_distance(at), is_inside(at)) {
            (far, true) => -far - offset,
            (far, false) => far - offset,
        },
    };
    // Where the sign flips in the mesh itself, values on both sides of it matter.
    let flips = winding.is_some();
    let radius = shell.largest_radius();
    let may_pass = |at: DVec3, reach: f64| {
        let nearest = shell.nearest(at);
        nearest - reach <= high && (nearest + reach >= low || (flips && nearest <= reach + radius))
    };
    let around = high.max(0.0) + 2.0 * cell;
    let bounds = bounds.grown(around);
    let mesh = isosurface(&bounds, cell, value, may_pass)?;
    if mesh.triangles.is_empty() {
        return Err(Error::undetermined(
            "the surface is empty: expected a thickness above ln(T)/k, an inner offset below half the \
             thickness of the object, and cells smaller than either",
        ));
    }
    // A sample is enough for a root mean square.
    let every = mesh.triangles.len().div_ceil(MAX_DEVIATION_SAMPLES).max(1);
    let places: Vec<DVec3> =
        (0..mesh.triangles.len()).step_by(every).map(|t| mesh.point_at(t, [1.0 / 3.0; 3])).collect();
    let deviations: Vec<f64> = (places.par_iter()).map(|at| deviation(*at, cell, &value)).collect();
    Ok(IsoSurface {
        check: mesh.check(),
        mesh,
        cell,
        deviation_rms: (deviations.iter().map(|d| d * d).sum::<f64>() / deviations.len() as f64).sqrt(),
        deviation_max: deviations.iter().copied().fold(0.0, f64::max),
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

/// A mesh with coincident vertices merged.
fn welded(mesh: &TriangleMesh) -> TriangleMesh {
    let mut first: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    let merged_into: Vec<u32> = (mesh.positions.iter().enumerate())
        // Adding zero turns −0 into 0, whose bits differ.
        .map(|(v, p)| *first.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert(v as u32))
        .collect();
    TriangleMesh {
        positions: mesh.positions.clone(),
        triangles: mesh.triangles.iter().map(|t| t.map(|v| merged_into[v as usize])).collect(),
    }
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
        for offset in [0.15, -0.2, 0.0] {
            let found = made(&ball, &shell, IsoLevel::Offset(offset), 0.1);
            assert_eq!(found.check.euler_characteristic, 2);
            for p in &found.mesh.positions {
                assert!((p.length() - 1.0 - offset).abs() < 0.03, "{offset}: {}", p.length());
            }
            assert!(found.deviation_rms <= found.deviation_max && found.deviation_max < 0.02);
        }
        let both = made(&ball, &shell, IsoLevel::Shell, 0.06);
        assert_eq!((both.check.components, both.check.euler_characteristic), (2, 4));
        let outer = made(&ball, &shell, IsoLevel::Outer, 0.06);
        assert_eq!((outer.check.components, outer.check.euler_characteristic), (1, 2));
        // The bulge: the fields of several facets add up.
        for p in &outer.mesh.positions {
            assert!((0.09..0.2).contains(&(p.length() - 1.0)), "{}", p.length());
        }
        let shell = Shell::new(&ball, &shell).unwrap();
        for p in &outer.mesh.positions {
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
