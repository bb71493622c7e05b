//! Domains of quads for closed surfaces of any genus.
//!
//! Input: a closed triangle mesh. Output: a [`QuadDomain`] with a position on the mesh for each vertex.
//!
//! Each vertex of the mesh gets a square lattice in its tangent plane, and lattices of neighbours are made to
//! agree. Edges of the mesh then are whole steps from one lattice to the next, which are closed around
//! triangles. Where edges have no steps, vertices become one; what is left are halves of squares. All changes
//! keep a closed manifold of the same topology, so the layout has the genus of the mesh whatever the field of
//! lattices is like. It decides how square and how regular the quads are.
//!
//! | module | purpose |
//! |---|---|
//! | simplification | coarser meshes, on which large squares are found faster |
//! | lattice, field | lattices that agree |
//! | closure | whole steps along edges |
//! | faces, decimation | one vertex for each lattice position |
//! | quads | quads from triangles, and fewer extraordinary vertices |
//! | relaxation | even quads on the mesh |
//!
//! Not guaranteed: the number of quads and of extraordinary vertices, and quads in parts that are thinner
//! than they are.
//!
//! # References
//! Jakob, Tarini, Panozzo, Sorkine-Hornung, *Instant field-aligned meshes*, 2015; Huang, Zhou, Niessner,
//! Shewchuk, Guibas, *QuadriFlow: a scalable and robust method for quadrangulation*, 2018.

mod closure;
mod decimation;
mod faces;
mod field;
mod lattice;
mod quads;
mod relaxation;
mod simplification;
#[cfg(test)]
mod tests;

use closure::Steps;
use decimation::Decimation;
use faces::renumbered;
use field::DirectionField;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::QuadDomain;
use simplification::simplified;
use std::collections::HashMap;
use std::sync::OnceLock;

/// A domain with the positions of its vertices.
#[derive(Debug, Clone)]
pub struct Layout {
    /// The domain.
    pub domain: QuadDomain,
    /// A position on the mesh for each vertex.
    pub positions: Vec<DVec3>,
}

/// Edges of the mesh on which squares are found, in units of their side.
const SHORTEST_EDGE: f64 = 0.25;
const LONGEST_EDGE: f64 = 0.5;
/// Vertices of the coarsest mesh, at most.
const COARSEST: usize = 400;
/// Quads of a component, at least.
const MIN_QUADS: usize = 24;

/// A closed mesh on which layouts are made.
pub struct LayoutMesh {
    /// One for each component.
    parts: Vec<Part>,
    area: f64,
    most: usize,
    mesh: TriangleMesh,
    search: MeshSearch,
}

/// A component of the mesh.
struct Part {
    area: f64,
    /// From fine to coarse.
    meshes: Vec<PartMesh>,
}

/// A mesh of a component.
struct PartMesh {
    mesh: TriangleMesh,
    /// No edge is shorter, where that is possible.
    shortest: f64,
    /// Directions, and opposite half edges, as soon as a layout needs them: several layouts use one mesh.
    prepared: OnceLock<(DirectionField, Vec<u32>)>,
}

impl PartMesh {
    fn new(mesh: TriangleMesh, shortest: f64) -> Self {
        Self { mesh, shortest, prepared: OnceLock::new() }
    }
}

impl LayoutMesh {
    /// Prepares a mesh for layouts of `most` quads or fewer.
    ///
    /// # Errors
    /// `Input` for meshes with borders or of other than manifold topology.
    pub fn new(mesh: TriangleMesh, most: usize) -> Result<Self> {
        let check = mesh.check();
        if !(check.watertight && check.manifold && check.oriented) {
            return Err(Error::input("a layout needs a closed manifold mesh with one orientation"));
        }
        let (numbers, area, most) = (mesh.parts(), mesh.area(), most.max(1));
        let finest = (area / most as f64).sqrt();
        let part = |number: u32| Part::new(mesh_of(&mesh, |index| numbers[index] == number)?, finest);
        let parts = (0..check.components as u32).map(part).collect::<Result<_>>()?;
        Ok(Self { parts, area, most, search: MeshSearch::try_new(&mesh)?, mesh })
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &TriangleMesh {
        &self.mesh
    }

    /// The mesh alone, of which others can be prepared.
    pub(crate) fn into_mesh(self) -> TriangleMesh {
        self.mesh
    }

    /// The search for its nearest points.
    pub(crate) fn search(&self) -> &MeshSearch {
        &self.search
    }

    /// Largest number of quads.
    #[must_use]
    pub fn most(&self) -> usize {
        self.most
    }

    /// A layout of about the wanted number of quads.
    ///
    /// # Errors
    /// `Undetermined` if triangles are left that no change of the mesh turns into quads.
    ///
    /// # Examples
    /// ```
    /// use planish_mesh::icosphere;
    /// use planish_surface::layout::LayoutMesh;
    /// let layout = LayoutMesh::new(icosphere(10.0, 4), 200)?.layout(100)?;
    /// assert_eq!(layout.domain.genus(), 0);
    /// assert!((80..130).contains(&layout.domain.cells().len()));
    /// assert!(layout.positions.iter().all(|p| (p.length() - 10.0).abs() < 0.1));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn layout(&self, quads: usize) -> Result<Layout> {
        let side = (self.area / quads.clamp(1, self.most) as f64).sqrt();
        let (mut cells, mut positions) = (Vec::new(), Vec::new());
        for part in &self.parts {
            let own = part.layout(side, &self.search)?;
            let first = positions.len() as u32;
            cells.extend(own.domain.cells().iter().map(|quad| quad.map(|v| v + first)));
            positions.extend(own.positions);
        }
        Ok(Layout { domain: QuadDomain::new(&cells)?, positions })
    }

    /// A layout with each quad divided into four, with its vertices on the mesh and as even as in a new
    /// layout.
    ///
    /// # Errors
    /// As for [`QuadDomain::divided`].
    pub fn divided(&self, layout: &Layout) -> Result<Layout> {
        self.divided_and_relaxed(layout, relaxation::ROUNDS)
    }

    /// The same for a layout that was divided before. Its vertices are nearly as even as it has them.
    ///
    /// # Errors
    /// As for [`QuadDomain::divided`].
    pub fn divided_again(&self, layout: &Layout) -> Result<Layout> {
        self.divided_and_relaxed(layout, relaxation::FEW_ROUNDS)
    }

    fn divided_and_relaxed(&self, layout: &Layout, rounds: usize) -> Result<Layout> {
        let division = layout.domain.divided()?;
        let mut positions = division.apply(&layout.positions);
        relaxation::relax(&division.domain, &mut positions, &self.search, rounds);
        Ok(Layout { domain: division.domain, positions })
    }
}

impl Part {
    fn new(mesh: TriangleMesh, finest: f64) -> Result<Self> {
        let area = mesh.area();
        let mut shortest = SHORTEST_EDGE * finest;
        let first = simplified(&with_short_edges(mesh, LONGEST_EDGE * finest)?, shortest)?;
        let mut meshes = vec![PartMesh::new(first, shortest)];
        loop {
            let finer = &meshes[meshes.len() - 1].mesh;
            shortest *= 2.0;
            let mesh = simplified(finer, shortest)?;
            // Where edges can not be collapsed any more, the topology would change.
            if mesh.positions.len() < COARSEST || 2 * mesh.positions.len() > finer.positions.len() {
                break;
            }
            meshes.push(PartMesh::new(mesh, shortest));
        }
        Ok(Self { area, meshes })
    }

    fn layout(&self, side: f64, search: &MeshSearch) -> Result<Layout> {
        // A small component would collapse under large squares.
        let side = side.min((self.area / MIN_QUADS as f64).sqrt());
        let is_fine = |made: &&PartMesh| made.shortest <= SHORTEST_EDGE * side;
        let PartMesh { mesh, prepared, .. } =
            self.meshes.iter().rev().find(is_fine).unwrap_or(&self.meshes[0]);
        let (field, opposite) =
            prepared.get_or_init(|| (DirectionField::on_mesh(mesh), mesh.opposite_half_edges()));
        let lattices = field.lattices(side);
        let mut steps = Steps::new(mesh, opposite, &lattices);
        steps.close();
        let mut coarse = Decimation::new(mesh, lattices, &steps);
        coarse.space_evenly(search);
        let mut positions = coarse.positions();
        if !quads::pair(&mut coarse, &positions) {
            return Err(Error::undetermined("no mesh of quads was found on the surface"));
        }
        quads::even_out(&mut coarse.faces, &mut positions);
        let (cells, mut positions) = coarse.faces.numbered(&positions);
        let domain = QuadDomain::new(&cells)?;
        relaxation::relax(&domain, &mut positions, search, relaxation::ROUNDS);
        Ok(Layout { domain, positions })
    }
}

/// The mesh with its long edges halved until all are short.
fn with_short_edges(mut mesh: TriangleMesh, longest: f64) -> Result<TriangleMesh> {
    loop {
        let is_long = |a: u32, b: u32| {
            mesh.positions[a as usize].distance_squared(mesh.positions[b as usize]) > longest * longest
        };
        let mut positions = mesh.positions.clone();
        let mut middles: HashMap<(u32, u32), u32> = HashMap::new();
        let mut triangles = Vec::with_capacity(mesh.triangles.len());
        for &[a, b, c] in &mesh.triangles {
            let middle = [(a, b), (b, c), (c, a)].map(|(a, b)| {
                is_long(a, b).then(|| {
                    *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                        positions.push(0.5 * (mesh.positions[a as usize] + mesh.positions[b as usize]));
                        positions.len() as u32 - 1
                    })
                })
            });
            divide([a, b, c], middle, &mut triangles);
        }
        if middles.is_empty() {
            return Ok(mesh);
        }
        mesh = TriangleMesh::try_new(positions, triangles)?;
    }
}

/// Adds the parts of a triangle with the middles of some of its edges.
fn divide([a, b, c]: [u32; 3], middles: [Option<u32>; 3], triangles: &mut Vec<[u32; 3]>) {
    match middles {
        [None, None, None] => triangles.push([a, b, c]),
        [Some(x), Some(y), Some(z)] => triangles.extend([[a, x, z], [x, b, y], [z, y, c], [x, y, z]]),
        [Some(x), None, None] => triangles.extend([[a, x, c], [x, b, c]]),
        [Some(x), Some(y), None] => triangles.extend([[x, b, y], [a, x, y], [a, y, c]]),
        // The others are these, with another first corner.
        [x, y, z] => divide([b, c, a], [y, z, x], triangles),
    }
}

/// The mesh of some triangles, chosen by their numbers, without the vertices of others.
pub(crate) fn mesh_of(mesh: &TriangleMesh, is_chosen: impl Fn(usize) -> bool) -> Result<TriangleMesh> {
    let chosen = (0..mesh.triangles.len()).filter(|&index| is_chosen(index));
    let (triangles, positions) = renumbered(chosen.map(|index| mesh.triangles[index]), &mesh.positions);
    TriangleMesh::try_new(positions, triangles)
}
