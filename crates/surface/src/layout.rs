//! Domains of quads for closed surfaces of any genus.
//!
//! Input: a closed triangle mesh. Output: a [`QuadDomain`] with a position on the mesh for each vertex.
//!
//! A harmonic function between two far points of a component has no other extremum and `2 g` saddles. Its
//! contours are rings; between critical values they form cylinders (the arcs of the Reeb graph). Each
//! cylinder has a number of columns that stays the same from one end to the other. At a saddle one ring
//! becomes two, or two become one. The three rings meet along a line through the saddle, both ends of which
//! have six quads. A square grid of quads closes each end of the function, with four corners that have
//! three quads. So there are `8 + 4 g` extraordinary vertices.
//!
//! | module | purpose |
//! |---|---|
//! | contours | the function, its critical points and rings |
//! | rings | vertices and quads |
//! | relaxation | even quads on the mesh |
//!
//! Not guaranteed: quads that are about square. Long thin parts away from both ends have few, long ones.
//!
//! # References
//! Dong, Kircher, Garland, *Harmonic functions for quadrilateral remeshing of arbitrary manifolds*, CAGD
//! 2005.

mod contours;
mod relaxation;
mod rings;
#[cfg(test)]
mod tests;

use contours::Contours;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::QuadDomain;

/// A domain with the positions of its vertices.
#[derive(Debug, Clone)]
pub struct Layout {
    /// The domain.
    pub domain: QuadDomain,
    /// A position on the mesh for each vertex.
    pub positions: Vec<DVec3>,
}

/// Edges from the middle of a cap to its sides in the finest layout.
const FINEST_CAP: usize = 4;
/// Attempts with different ends of the function, if it has critical points that are no simple saddles.
const ATTEMPTS: usize = 8;

impl Layout {
    /// A domain that covers a closed mesh, with about `max_quads` at most where that is possible.
    ///
    /// # Errors
    /// `Input` for meshes with borders or of other than manifold topology; `Undetermined` if no harmonic
    /// function with simple saddles was found.
    ///
    /// # Examples
    /// ```
    /// use planish_mesh::icosphere;
    /// use planish_surface::layout::Layout;
    /// let layout = Layout::on_mesh(&icosphere(10.0, 4), 500)?;
    /// assert_eq!((layout.domain.genus(), layout.domain.extraordinary_vertices().len()), (0, 8));
    /// assert!(layout.positions.iter().all(|p| (p.length() - 10.0).abs() < 0.1));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn on_mesh(mesh: &TriangleMesh, max_quads: usize) -> Result<Self> {
        let check = mesh.check();
        if !(check.watertight && check.manifold && check.oriented) {
            return Err(Error::input("a layout needs a closed manifold mesh with one orientation"));
        }
        let (parts, area) = (mesh.parts(), mesh.area());
        let (mut quads, mut positions) = (Vec::new(), Vec::new());
        for part in 0..check.components as u32 {
            let own = mesh_of(mesh, |index| parts[index] == part)?;
            let made = (0..ATTEMPTS).find_map(|attempt| Contours::of_harmonic(&own, attempt).transpose());
            let contours = made.transpose()?.ok_or_else(|| {
                Error::undetermined("no function with simple saddles was found on the surface")
            })?;
            let most = own.area() / area * max_quads as f64;
            let along = rings::lengths(&contours);
            let mut cap = FINEST_CAP;
            let (own_quads, mut own_positions) = loop {
                let made = rings::quads_along(&contours, &along, cap)?;
                if cap == 1 || made.0.len() as f64 <= most {
                    break made;
                }
                cap -= 1;
            };
            let domain = QuadDomain::new(&own_quads)?;
            relaxation::relax(&domain, &mut own_positions, &MeshSearch::try_new(&own)?);
            let first = positions.len() as u32;
            quads.extend(own_quads.iter().map(|quad| quad.map(|v| v + first)));
            positions.extend(own_positions);
        }
        Ok(Self { domain: QuadDomain::new(&quads)?, positions })
    }

    /// The layout with each quad divided into four, and its vertices on the mesh.
    ///
    /// # Errors
    /// As for [`QuadDomain::divided`].
    pub fn divided(&self, mesh: &MeshSearch) -> Result<Self> {
        let division = self.domain.divided()?;
        let mut positions = division.apply(&self.positions);
        relaxation::relax(&division.domain, &mut positions, mesh);
        Ok(Self { domain: division.domain, positions })
    }
}

/// The mesh of some triangles, chosen by their numbers, without the vertices of others.
pub(crate) fn mesh_of(mesh: &TriangleMesh, is_chosen: impl Fn(usize) -> bool) -> Result<TriangleMesh> {
    let mut number = vec![u32::MAX; mesh.positions.len()];
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for index in (0..mesh.triangles.len()).filter(|&index| is_chosen(index)) {
        triangles.push(mesh.triangles[index].map(|v| {
            let own = &mut number[v as usize];
            if *own == u32::MAX {
                *own = positions.len() as u32;
                positions.push(mesh.positions[v as usize]);
            }
            *own
        }));
    }
    TriangleMesh::try_new(positions, triangles)
}
