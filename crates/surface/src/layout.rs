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
//! | creases | creases of faces that change |
//! | network | curves, corners and regions of a mesh with creases |
//! | simplification | coarser meshes, on which large squares are found faster |
//! | lattice, field | lattices that agree |
//! | closure | whole steps along edges |
//! | faces, decimation | one vertex for each lattice position |
//! | quads | quads from triangles, and fewer extraordinary vertices |
//! | relaxation | even quads on the mesh |
//! | quality | which of several layouts is best |
//!
//! Creases of the mesh become creases of the domain. Lattices at them point along their curves, with
//! positions on them. No change removes a crease or a corner, and vertices move within their curves and
//! between them.
//! See decision 0118.
//!
//! Not guaranteed: the number of quads and of extraordinary vertices, and quads in parts that are thinner
//! than they are.
//!
//! # References
//! Jakob, Tarini, Panozzo, Sorkine-Hornung, *Instant field-aligned meshes*, 2015; Huang, Zhou, Niessner,
//! Shewchuk, Guibas, *QuadriFlow: a scalable and robust method for quadrangulation*, 2018.

mod closure;
#[cfg(test)]
mod crease_tests;
mod creases;
mod decimation;
mod faces;
mod field;
mod lattice;
mod network;
mod quads;
mod quality;
mod relaxation;
mod simplification;
#[cfg(test)]
mod test_shapes;
#[cfg(test)]
mod tests;

use closure::{MAX_COST, MAX_COST_FAR, Steps};
use creases::CreaseEdges;
use decimation::Decimation;
use faces::{renumbered, renumbered_with_numbers};
use field::DirectionField;
pub use network::CreasedMesh;
use network::{CreaseNetwork, Place};
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::QuadDomain;
use quality::Defects;
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

/// How a layout of a mesh with creases is tried.
struct Attempt {
    /// Side of squares, in units of the wanted one: a crease is a whole number of squares long.
    scale: f64,
    /// Cost of ways on which steps are closed.
    max_cost: f64,
    /// Rings of quads beside round creases. They do not fit narrow strips.
    adds_rings: bool,
}

/// Quads up to which all attempts are made, those with long ways among them: the time of their search grows
/// with the square of the number of quads.
const MAX_TRIED_QUADS: f64 = 600.0;

/// The best of these is taken. Of many quads, it is the first in which none fold, and without creases the
/// first.
const ATTEMPTS: [Attempt; 8] = [
    Attempt { scale: 1.0, max_cost: MAX_COST, adds_rings: true },
    Attempt { scale: 1.0, max_cost: MAX_COST_FAR, adds_rings: true },
    Attempt { scale: 0.94, max_cost: MAX_COST, adds_rings: true },
    Attempt { scale: 0.94, max_cost: MAX_COST_FAR, adds_rings: true },
    Attempt { scale: 1.06, max_cost: MAX_COST, adds_rings: true },
    Attempt { scale: 1.06, max_cost: MAX_COST_FAR, adds_rings: true },
    Attempt { scale: 1.0, max_cost: MAX_COST, adds_rings: false },
    Attempt { scale: 1.0, max_cost: MAX_COST_FAR, adds_rings: false },
];

/// A closed mesh on which layouts are made.
pub struct LayoutMesh {
    /// One for each component.
    parts: Vec<Part>,
    area: f64,
    most: usize,
    creased: CreasedMesh,
    search: MeshSearch,
    network: CreaseNetwork,
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
    creases: CreaseEdges,
    /// No edge is shorter, where that is possible.
    shortest: f64,
    /// Directions, and opposite half edges, as soon as a layout needs them: several layouts use one mesh.
    prepared: OnceLock<(DirectionField, Vec<u32>)>,
}

impl PartMesh {
    fn new((mesh, creases): (TriangleMesh, CreaseEdges), shortest: f64) -> Self {
        Self { mesh, creases, shortest, prepared: OnceLock::new() }
    }
}

impl LayoutMesh {
    /// Prepares a mesh for layouts of `most` quads or fewer.
    ///
    /// # Errors
    /// `Input` for meshes with borders or of other than manifold topology.
    pub fn new(mesh: TriangleMesh, most: usize) -> Result<Self> {
        Self::with_creases(CreasedMesh::smooth(mesh), most)
    }

    /// Prepares a mesh for layouts of `most` quads or fewer, the creases of which are those of the mesh.
    ///
    /// # Errors
    /// `Input` for meshes with borders or of other than manifold topology, for creases that are no edges of
    /// the mesh, and for corners without a crease.
    ///
    /// # Examples
    /// A box with sharp edges. Each corner has three quads, and the faces are planes:
    /// ```
    /// use planish_core::DVec3;
    /// use planish_mesh::parallelepiped;
    /// use planish_surface::layout::{CreasedMesh, LayoutMesh};
    /// let mesh = parallelepiped(DVec3::ZERO, [2.0 * DVec3::X, 2.0 * DVec3::Y, 2.0 * DVec3::Z]).welded();
    /// // Edges of the box are parallel to an axis; diagonals of its faces are not.
    /// let is_sharp = |[a, b]: &[u32; 2]| {
    ///     let way = mesh.positions[*a as usize] - mesh.positions[*b as usize];
    ///     way.abs().max_element() > 0.9 * way.length()
    /// };
    /// let edges = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    /// let creases = edges.filter(|[a, b]| a < b).filter(is_sharp).collect();
    /// let creased = CreasedMesh { mesh, creases, corners: vec![] };
    /// let layout = LayoutMesh::with_creases(creased, 100)?.layout(96)?;
    /// assert_eq!(layout.domain.extraordinary_vertices().len(), 8);
    /// assert!(layout.positions.iter().all(|p| (p.abs().max_element() - 1.0).abs() < 1e-9));
    /// # Ok::<(), planish_estimate::Error>(())
    /// ```
    pub fn with_creases(creased: CreasedMesh, most: usize) -> Result<Self> {
        let mesh = &creased.mesh;
        let check = mesh.check();
        if !(check.watertight && check.manifold && check.oriented) {
            return Err(Error::input("a layout needs a closed manifold mesh with one orientation"));
        }
        let network = CreaseNetwork::new(&creased)?;
        let (numbers, area, most) = (mesh.parts(), mesh.area(), most.max(1));
        let finest = (area / most as f64).sqrt();
        let part = |number: u32| {
            let chosen = (0..mesh.triangles.len()).filter(|&index| numbers[index] == number);
            let (triangles, positions, numbers) =
                renumbered_with_numbers(chosen.map(|index| mesh.triangles[index]), &mesh.positions);
            Part::new(
                TriangleMesh::try_new(positions, triangles)?,
                network.edges.renumbered(&numbers),
                finest,
            )
        };
        let parts = (0..check.components as u32).map(part).collect::<Result<_>>()?;
        Ok(Self { parts, area, most, search: MeshSearch::try_new(mesh)?, network, creased })
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> &TriangleMesh {
        &self.creased.mesh
    }

    /// The mesh alone, of which others can be prepared.
    pub(crate) fn into_mesh(self) -> CreasedMesh {
        self.creased
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

    /// Mean side of that many quads, or of the most.
    pub(crate) fn side(&self, quads: usize) -> f64 {
        (self.area / quads.clamp(1, self.most) as f64).sqrt()
    }

    /// A layout of about the wanted number of quads.
    ///
    /// # Errors
    /// `Undetermined` if triangles are left that no change of the mesh turns into quads. More quads may help
    /// between creases that are nearer to each other than a quad's side.
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
        let side = self.side(quads);
        let (mut cells, mut positions) = (Vec::new(), Vec::new());
        let (mut creases, mut corners) = (Vec::new(), Vec::new());
        for part in &self.parts {
            let own = part.layout(side, &self.search, &self.network)?;
            let first = positions.len() as u32;
            cells.extend(own.domain.cells().iter().map(|quad| quad.map(|v| v + first)));
            creases.extend(own.domain.creases().iter().map(|edge| edge.map(|v| v + first)));
            corners.extend(own.domain.corners().iter().map(|v| v + first));
            positions.extend(own.positions);
        }
        Ok(Layout { domain: QuadDomain::with_creases(&cells, &creases, &corners)?, positions })
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
        let mut positions: Vec<DVec3> = division.apply(&layout.positions);
        let edges = self.network.divided(layout, &division, &mut positions);
        let places = places(&division.domain, &edges, &positions, &self.search, &self.network);
        relaxation::relax(&division.domain, &mut positions, &places, rounds);
        Ok(Layout { domain: division.domain, positions })
    }
}

/// Where the vertices of a domain may move.
fn places<'a>(
    domain: &QuadDomain,
    edges: &CreaseEdges,
    positions: &[DVec3],
    search: &'a MeshSearch,
    network: &'a CreaseNetwork,
) -> Vec<Place<'a>> {
    let faces: Vec<&[u32]> = domain.cells().iter().map(|quad| &quad[..]).collect();
    network.places(&faces, edges, positions, search)
}

impl Part {
    fn new(mesh: TriangleMesh, creases: CreaseEdges, finest: f64) -> Result<Self> {
        let area = mesh.area();
        let mut shortest = SHORTEST_EDGE * finest;
        let (mesh, creases) = with_short_edges(mesh, creases, LONGEST_EDGE * finest)?;
        let first = simplified(&mesh, &creases, shortest)?;
        let mut meshes = vec![PartMesh::new(first, shortest)];
        loop {
            let PartMesh { mesh: finer, creases, .. } = &meshes[meshes.len() - 1];
            shortest *= 2.0;
            let coarser = simplified(finer, creases, shortest)?;
            let count = coarser.0.positions.len();
            // Where edges can not be collapsed any more, the topology would change.
            if count < COARSEST || 2 * count > finer.positions.len() {
                break;
            }
            meshes.push(PartMesh::new(coarser, shortest));
        }
        Ok(Self { area, meshes })
    }

    fn layout(&self, side: f64, search: &MeshSearch, network: &CreaseNetwork) -> Result<Layout> {
        // A small component would collapse under large squares.
        let side = side.min((self.area / MIN_QUADS as f64).sqrt());
        let has_many = self.area > MAX_TRIED_QUADS * side * side;
        let mut best: Option<(Defects, Layout)> = None;
        let mut error = None;
        for attempt in ATTEMPTS {
            if attempt.max_cost > MAX_COST && has_many {
                continue;
            }
            match self.attempt(side, &attempt, search, network) {
                // Without creases, the first attempt is as good as others.
                Ok(made) if network.edges.is_empty() => return Ok(made),
                Ok(made) => {
                    let own = quality::defects(&made, network, side);
                    if best.as_ref().is_none_or(|(least, _)| own.is_better_than(least)) {
                        best = Some((own, made));
                    }
                    if own.is_regular() || has_many && !own.has_folds() {
                        break;
                    }
                }
                Err(own) if network.edges.is_empty() => return Err(own),
                Err(own) => error = Some(own),
            }
        }
        let unresolved = || Error::undetermined("creases are nearer to each other than quads are large");
        match best {
            Some((defects, made)) if !defects.loses_creases => Ok(made),
            Some(_) => Err(unresolved()),
            None => Err(error.unwrap_or_else(unresolved)),
        }
    }

    fn attempt(
        &self,
        side: f64,
        attempt: &Attempt,
        search: &MeshSearch,
        network: &CreaseNetwork,
    ) -> Result<Layout> {
        let side = attempt.scale * side;
        let is_fine = |made: &&PartMesh| made.shortest <= SHORTEST_EDGE * side;
        let PartMesh { mesh, creases, prepared, .. } =
            self.meshes.iter().rev().find(is_fine).unwrap_or(&self.meshes[0]);
        let (field, opposite) =
            prepared.get_or_init(|| (DirectionField::on_mesh(mesh, creases), mesh.opposite_half_edges()));
        let lattices = field.lattices(side);
        let mut steps = Steps::new(mesh, opposite, &lattices);
        steps.keep_along(mesh, creases, &lattices);
        steps.close(attempt.max_cost);
        let faces: Vec<&[u32]> = mesh.triangles.iter().map(|t| &t[..]).collect();
        let places = network.places(&faces, creases, &mesh.positions, search);
        let mut coarse = Decimation::new(mesh, creases.clone(), lattices, &steps);
        coarse.space_evenly(&places);
        let mut positions = coarse.positions();
        if !quads::pair(&mut coarse, &network.targets, &mut positions) {
            return Err(Error::undetermined("no mesh of quads was found on the surface"));
        }
        quads::even_out(
            &mut coarse.faces,
            &mut coarse.creases,
            &network.targets,
            &mut positions,
            attempt.adds_rings,
        );
        let (cells, mut positions, numbers) = coarse.faces.numbered(&positions);
        let domain = network.domain(&cells, &coarse.faces, &coarse.creases, &numbers)?;
        let creases = coarse.creases.renumbered(&numbers);
        let places = self::places(&domain, &creases, &positions, search, network);
        relaxation::relax(&domain, &mut positions, &places, relaxation::ROUNDS);
        Ok(Layout { domain, positions })
    }
}

/// The mesh without edges shorter than a length, where its topology and shape allow that.
pub(crate) fn without_short_edges(mesh: &TriangleMesh, shortest: f64) -> Result<TriangleMesh> {
    Ok(simplified(mesh, &CreaseEdges::default(), shortest)?.0)
}

/// The mesh with its long edges halved until all are short.
fn with_short_edges(
    mut mesh: TriangleMesh,
    mut creases: CreaseEdges,
    longest: f64,
) -> Result<(TriangleMesh, CreaseEdges)> {
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
            return Ok((mesh, creases));
        }
        for (&edge, &middle) in &middles {
            creases.insert_vertex(edge, middle);
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
