//! Chooses control points on a mesh, triangulates them, and computes the energy of their displacements.
//!
//! In: a mesh and the number of controls. Out: vertices spread by distance along the mesh edges, denser where
//! the mesh bends; triangles where three of their regions meet; the stiffness `K` of C eq. 10.
//!
//! Not guaranteed: the control triangulation may be non-manifold or have holes, as the mesh may.

use nalgebra::DMatrix;
use planish_core::DVec3;
use planish_estimate::{Error, Result};
use planish_mesh::{BoundingBox, DisjointSets, TriangleMesh};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

/// Relative increase of the length of an edge per radian by which the normals turn along it. Larger values
/// place more controls where the mesh bends, at the expense of flat regions.
const BENDING: f64 = 2.0;
/// The finest cell of the grids by which disconnected parts are joined, as a share of the mesh's size.
const MIN_CELL: f64 = 1.0 / 2048.0;
/// Relative tolerance of equal distances, so that rounding does not decide which vertex is chosen.
const EQUAL_DISTANCE_TOLERANCE: f64 = 1e-9;
/// Upper limit of a cotangent, so that thin triangles of controls do not dominate the stiffness.
const MAX_COTANGENT: f64 = 10.0;

/// Control points on a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Controls {
    /// Vertices of the mesh that are controls.
    pub vertices: Vec<u32>,
    /// Their positions.
    pub points: Vec<DVec3>,
    /// Triangles of controls.
    pub triangles: Vec<[u32; 3]>,
    /// Pairs of controls whose regions touch, including the edges of the triangles; the lower index first.
    pub edges: Vec<[u32; 2]>,
}

/// The edge graph of a mesh with lengths, along which regions grow.
#[derive(Debug, Clone)]
pub(crate) struct EdgeGraph {
    start: Vec<usize>,
    to: Vec<(u32, f64)>,
    /// Pairs of vertices that join disconnected parts.
    bridges: Vec<[u32; 2]>,
}

impl EdgeGraph {
    fn new(mesh: &TriangleMesh) -> Self {
        Self::with_bending(mesh, BENDING)
    }

    /// The graph whose edges have their lengths in space.
    pub(crate) fn with_plain_lengths(mesh: &TriangleMesh) -> Self {
        Self::with_bending(mesh, 0.0)
    }

    /// Distances of all vertices from one of them; infinite for unused vertices.
    pub(crate) fn distances(&self, source: u32) -> Vec<f64> {
        let count = self.start.len() - 1;
        let (mut far, mut regions) = (vec![f64::INFINITY; count], vec![0; count]);
        self.grow(source, 0, &mut far, &mut regions);
        far
    }

    fn with_bending(mesh: &TriangleMesh, bending: f64) -> Self {
        let normals = mesh.vertex_normals();
        // Ordered sets throughout: the order of a hash table would change the controls from run to run.
        let mut pairs: BTreeSet<[u32; 2]> = BTreeSet::new();
        for t in &mesh.triangles {
            for k in 0..3 {
                let [a, b] = [t[k], t[(k + 1) % 3]];
                if a != b {
                    pairs.insert([a.min(b), a.max(b)]);
                }
            }
        }
        // Coincident vertices are joined, because meshes with texture seams duplicate vertices.
        let mut at: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        let of_triangles: BTreeSet<u32> = mesh.triangles.iter().flatten().copied().collect();
        for v in of_triangles {
            let p = mesh.positions[v as usize];
            let first = *at.entry(p.to_array().map(f64::to_bits)).or_insert(v);
            if first != v {
                pairs.insert([first, v]);
            }
        }
        let bridges = bridges(&mesh.positions, &pairs);
        pairs.extend(&bridges);
        let length = |[a, b]: [u32; 2]| {
            let [a, b] = [a as usize, b as usize];
            let turn = normals[a].dot(normals[b]).clamp(-1.0, 1.0).acos();
            mesh.positions[a].distance(mesh.positions[b]) * (1.0 + bending * turn)
        };
        let mut start = vec![0; mesh.positions.len() + 1];
        for [a, b] in &pairs {
            start[*a as usize + 1] += 1;
            start[*b as usize + 1] += 1;
        }
        for v in 1..start.len() {
            start[v] += start[v - 1];
        }
        let mut next = start.clone();
        let mut to = vec![(0, 0.0); 2 * pairs.len()];
        for pair in pairs {
            let length = length(pair);
            for [from, target] in [pair, [pair[1], pair[0]]] {
                to[next[from as usize]] = (target, length);
                next[from as usize] += 1;
            }
        }
        Self { start, to, bridges }
    }

    /// Assigns to a new source all vertices that are nearer to it than to the sources before (Dijkstra).
    fn grow(&self, source: u32, region: u32, far: &mut [f64], regions: &mut [u32]) {
        // `far` keeps the distances from earlier sources, so the search visits only the region of the new
        // one.
        let mut heap = BinaryHeap::from([Reverse((0_u64, source))]);
        far[source as usize] = 0.0;
        regions[source as usize] = region;
        while let Some(Reverse((bits, vertex))) = heap.pop() {
            // The bits of positive numbers are in the order of the numbers, and integers have a total order.
            let reached = f64::from_bits(bits);
            if reached > far[vertex as usize] {
                continue;
            }
            for &(to, length) in &self.to[self.start[vertex as usize]..self.start[vertex as usize + 1]] {
                let distance = reached + length;
                if distance < (1.0 - EQUAL_DISTANCE_TOLERANCE) * far[to as usize] {
                    far[to as usize] = distance;
                    regions[to as usize] = region;
                    heap.push(Reverse((distance.to_bits(), to)));
                }
            }
        }
    }
}

/// Pairs of vertices that join all parts of a mesh into one, each about as short as can be: parts that share
/// a cell of a grid are joined in it, and cells double until all is one.
///
/// Cost: some thirty passes over the vertices, and none where there is one part.
fn bridges(positions: &[DVec3], pairs: &BTreeSet<[u32; 2]>) -> Vec<[u32; 2]> {
    let mut parts = DisjointSets::new(positions.len());
    let mut used: Vec<u32> = pairs.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let mut count = used.len();
    for [a, b] in pairs {
        count -= usize::from(parts.join(*a, *b));
    }
    let mut found = Vec::new();
    let Some(bounds) = BoundingBox::around(used.iter().map(|v| positions[*v as usize])) else {
        return found;
    };
    let mut cell = (bounds.diagonal() * MIN_CELL).max(f64::MIN_POSITIVE);
    while count > 1 {
        // Cells instead of exact nearest pairs: a bridge that is a little too long only changes distances
        // along it.
        let mut first: BTreeMap<[u64; 3], u32> = BTreeMap::new();
        for &v in &used {
            let at = positions[v as usize];
            let key = [0, 1, 2].map(|k| ((at[k] - bounds.min[k]) / cell) as u64);
            let other = *first.entry(key).or_insert(v);
            if parts.join(other, v) {
                found.push([other.min(v), other.max(v)]);
                count -= 1;
            }
        }
        cell *= 2.0;
    }
    found
}

/// Chooses control points by farthest-point sampling along the mesh. Disconnected parts are joined where they
/// are near each other.
///
/// # Errors
/// `Input` for a count of zero, or a mesh without triangles.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::automatic_controls;
/// let controls = automatic_controls(&icosphere(1.0, 3), 20)?;
/// assert_eq!(controls.points.len(), 20);
/// assert!(!controls.triangles.is_empty());
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn automatic_controls(mesh: &TriangleMesh, count: usize) -> Result<Controls> {
    automatic_controls_skipping(mesh, count, 0)
}

/// [`automatic_controls`] with another first control: the used vertex with index `skipped`. It gives a
/// different, equally spread set.
///
/// # Errors
/// As [`automatic_controls`].
pub fn automatic_controls_skipping(mesh: &TriangleMesh, count: usize, skipped: usize) -> Result<Controls> {
    Ok(ControlSampling::new(mesh, count, skipped)?.controls())
}

/// Controls on a mesh that are chosen one after the other, each as far as possible from those before. More
/// can be added in some of their regions.
///
/// The region of a control contains the vertices that are nearer to it than to others, along the edges of the
/// mesh.
///
/// # Examples
/// ```
/// use planish_mesh::icosphere;
/// use planish_shell::ControlSampling;
/// let mut sampling = ControlSampling::new(&icosphere(1.0, 4), 20, 0)?;
/// // Controls at half of the distance in the region of the first control.
/// let mut radii = sampling.radii();
/// radii[0] *= 0.5;
/// let added = sampling.refine(&radii, 100);
/// assert!(added > 0 && added < 10);
/// assert_eq!(sampling.controls().points.len(), 20 + added);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct ControlSampling {
    graph: EdgeGraph,
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Distance of each vertex from its control; negative for unused vertices.
    distances: Vec<f64>,
    /// Index of the control of each vertex; `u32::MAX` for unused vertices.
    regions: Vec<u32>,
    vertices: Vec<u32>,
}

impl ControlSampling {
    /// Chooses `count` controls. The first one is the used vertex with index `skipped`.
    ///
    /// # Errors
    /// As [`automatic_controls`].
    pub fn new(mesh: &TriangleMesh, count: usize, skipped: usize) -> Result<Self> {
        if count == 0 || mesh.triangles.is_empty() {
            return Err(Error::input(
                "expected a mesh with faces and a count of at least one for the controls",
            ));
        }
        let mut made = Self::without_controls(mesh);
        let in_use: Vec<usize> = (0..made.distances.len()).filter(|v| made.distances[*v] > 0.0).collect();
        let first = in_use[skipped % in_use.len()];
        made.add(first);
        while made.vertices.len() < count {
            let far = &made.distances;
            let farther = |v: usize, best: usize| far[v] > far[best] * (1.0 + EQUAL_DISTANCE_TOLERANCE);
            let farthest = (0..far.len()).fold(first, |best, v| if farther(v, best) { v } else { best });
            // All vertices are controls already.
            if far[farthest] <= 0.0 {
                break;
            }
            made.add(farthest);
        }
        Ok(made)
    }

    /// The sampling with the given vertices as controls.
    pub(crate) fn of_vertices(mesh: &TriangleMesh, vertices: &[u32]) -> Self {
        let mut made = Self::without_controls(mesh);
        for v in vertices {
            // A vertex that is listed twice, or that no triangle uses, has no region.
            if made.distances[*v as usize] > 0.0 {
                made.add(*v as usize);
            }
        }
        made
    }

    fn without_controls(mesh: &TriangleMesh) -> Self {
        let mut used = vec![false; mesh.positions.len()];
        for &v in mesh.triangles.iter().flatten() {
            used[v as usize] = true;
        }
        Self {
            graph: EdgeGraph::new(mesh),
            positions: mesh.positions.clone(),
            triangles: mesh.triangles.clone(),
            distances: used.iter().map(|used| if *used { f64::INFINITY } else { -1.0 }).collect(),
            regions: vec![u32::MAX; mesh.positions.len()],
            vertices: Vec::new(),
        }
    }

    fn add(&mut self, vertex: usize) {
        let region = self.vertices.len() as u32;
        self.graph.grow(vertex as u32, region, &mut self.distances, &mut self.regions);
        self.vertices.push(vertex as u32);
    }

    /// Index of the control of each vertex; `u32::MAX` for unused vertices.
    #[must_use]
    pub fn regions(&self) -> &[u32] {
        &self.regions
    }

    /// Number of controls.
    #[must_use]
    pub fn count(&self) -> usize {
        self.vertices.len()
    }

    /// Largest distance of a vertex from its control, in each region. Distances are along edges, and longer
    /// where the mesh bends.
    #[must_use]
    pub fn radii(&self) -> Vec<f64> {
        let mut radii = vec![0.0_f64; self.vertices.len()];
        for (region, distance) in self.regions.iter().zip(&self.distances) {
            if let Some(radius) = radii.get_mut(*region as usize) {
                *radius = radius.max(*distance);
            }
        }
        radii
    }

    /// Adds up to `count` controls until no vertex of a present region is farther from a control than the
    /// radius of this region. The vertex that exceeds its radius by the largest factor is next. Returns the
    /// number of new controls.
    ///
    /// Cost: one pass over the vertices for each control.
    pub fn refine(&mut self, radii: &[f64], count: usize) -> usize {
        let limits: Vec<f64> = (self.regions.iter())
            .map(|region| radii.get(*region as usize).copied().unwrap_or(f64::INFINITY))
            .collect();
        let before = self.vertices.len();
        while self.vertices.len() < before + count {
            let excess = |v: usize| self.distances[v] / limits[v];
            let next = (0..limits.len()).fold((1.0 + EQUAL_DISTANCE_TOLERANCE, None), |best, v| {
                let found = excess(v);
                if found > best.0 * (1.0 + EQUAL_DISTANCE_TOLERANCE) { (found, Some(v)) } else { best }
            });
            let (_, Some(vertex)) = next else { break };
            self.add(vertex);
        }
        self.vertices.len() - before
    }

    /// The controls, and their triangles where three regions meet.
    #[must_use]
    pub fn controls(&self) -> Controls {
        let (mut triangles, mut edges) = (BTreeSet::new(), BTreeSet::new());
        for t in &self.triangles {
            let mut regions_of_corners = t.map(|v| self.regions[v as usize]);
            for k in 0..3 {
                let [a, b] = [regions_of_corners[k], regions_of_corners[(k + 1) % 3]];
                if a != b {
                    edges.insert([a.min(b), a.max(b)]);
                }
            }
            // A triangle whose corners belong to three regions is dual to a triangle of their controls.
            regions_of_corners.sort_unstable();
            if regions_of_corners[0] != regions_of_corners[1]
                && regions_of_corners[1] != regions_of_corners[2]
            {
                triangles.insert(regions_of_corners);
            }
        }
        for [a, b] in &self.graph.bridges {
            let [a, b] = [a, b].map(|v| self.regions[*v as usize]);
            if a != b {
                edges.insert([a.min(b), a.max(b)]);
            }
        }
        Controls {
            points: self.vertices.iter().map(|&v| self.positions[v as usize]).collect(),
            vertices: self.vertices.clone(),
            triangles: triangles.into_iter().collect(),
            edges: edges.into_iter().collect(),
        }
    }
}

/// The stiffness `K` of C eq. 10 for one coordinate of the displacements: `ΔᵀKΔ = ∫ |∇Δ|²` over linear
/// elements on the triangles.
///
/// Its entries are cotangents; edges without a triangle are springs of stiffness one. `K` is positive
/// semidefinite because cotangents of obtuse angles are set to zero; large ones are limited to ten.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::stiffness;
/// let k = stiffness(&[DVec3::ZERO, DVec3::X], &[], &[[0, 1]]);
/// assert_eq!((k[(0, 0)], k[(0, 1)]), (1.0, -1.0));
/// ```
#[must_use]
pub fn stiffness(points: &[DVec3], triangles: &[[u32; 3]], edges: &[[u32; 2]]) -> DMatrix<f64> {
    let mut joined: BTreeMap<[u32; 2], f64> = BTreeMap::new();
    for t in triangles {
        for k in 0..3 {
            let [a, b, c] = [t[k], t[(k + 1) % 3], t[(k + 2) % 3]];
            let [u, v] = [b, c].map(|to| points[to as usize] - points[a as usize]);
            let area = u.cross(v).length();
            let cotangent = if area > 0.0 { u.dot(v) / area } else { 0.0 };
            *joined.entry([b.min(c), b.max(c)]).or_insert(0.0) += 0.5 * cotangent.clamp(0.0, MAX_COTANGENT);
        }
    }
    for edge in edges {
        joined.entry(*edge).or_insert(1.0);
    }
    let mut made = DMatrix::zeros(points.len(), points.len());
    for ([a, b], spring) in joined {
        let [a, b] = [a as usize, b as usize];
        made[(a, a)] += spring;
        made[(b, b)] += spring;
        made[(a, b)] -= spring;
        made[(b, a)] -= spring;
    }
    made
}

/// Pairs of points for [`stiffness`] without a triangulation: each point with its `count` nearest ones.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_shell::nearest_pairs;
/// let points = [DVec3::ZERO, DVec3::X, 3.0 * DVec3::X];
/// assert_eq!(nearest_pairs(&points, 1), [[0, 1], [1, 2]]);
/// ```
#[must_use]
pub fn nearest_pairs(points: &[DVec3], count: usize) -> Vec<[u32; 2]> {
    let mut pairs = BTreeSet::new();
    for (a, p) in points.iter().enumerate() {
        let mut others: Vec<(f64, u32)> = (points.iter().enumerate())
            .filter(|(b, _)| *b != a)
            .map(|(b, q)| (p.distance(*q), b as u32))
            .collect();
        others.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
        for &(_, b) in others.iter().take(count) {
            pairs.insert([(a as u32).min(b), (a as u32).max(b)]);
        }
    }
    pairs.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_mesh::{cylinder, icosphere};

    #[test]
    fn controls_are_spread_and_joined() {
        let ball = icosphere(2.0, 4);
        let made = automatic_controls(&ball, 60).unwrap();
        assert_eq!(made.points.len(), 60);
        let nearest = |a: usize| {
            (0..60)
                .filter(|&b| b != a)
                .map(|b| made.points[a].distance(made.points[b]))
                .fold(f64::INFINITY, f64::min)
        };
        let spread: Vec<f64> = (0..60).map(nearest).collect();
        let (low, high) = (
            spread.iter().copied().fold(f64::INFINITY, f64::min),
            spread.iter().copied().fold(0.0, f64::max),
        );
        assert!(high < 2.5 * low, "{low} {high}");
        // A closed triangulation of 60 points has 116 triangles and 174 edges.
        assert!(
            made.triangles.len() > 100 && made.edges.len() > 160,
            "{} {}",
            made.triangles.len(),
            made.edges.len()
        );
        // Constant displacements have zero energy, others do not.
        let k = stiffness(&made.points, &made.triangles, &made.edges);
        let ones = nalgebra::DVector::from_element(60, 1.0);
        assert!((&k * &ones).amax() < 1e-9);
        let eigen = k.symmetric_eigen().eigenvalues;
        assert_eq!(eigen.iter().filter(|e| **e < 1e-6).count(), 1);
    }

    /// Every disconnected part has controls, duplicate vertices at seams are one vertex, and there are at
    /// most as many controls as vertices.
    #[test]
    fn parts_and_seams() {
        let mut two = icosphere(1.0, 2);
        let other = cylinder(1.0, 2.0, 24, 4, true);
        let first = two.positions.len() as u32;
        two.positions.extend(other.positions.iter().map(|p| DVec3::new(p.x + 9.0, p.y, p.z)));
        two.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
        let made = automatic_controls(&two, 8).unwrap();
        assert!(made.vertices.iter().any(|v| *v < first) && made.vertices.iter().any(|v| *v >= first));
        // Only constant displacements have zero energy, so both parts are joined.
        let eigen = stiffness(&made.points, &made.triangles, &made.edges).symmetric_eigen().eigenvalues;
        assert_eq!(eigen.iter().filter(|e| **e < 1e-6).count(), 1);
        // Forty small parts next to a ball leave most controls to the ball.
        let mut mesh = icosphere(1.0, 3);
        for k in 0..40 {
            let first = mesh.positions.len() as u32;
            let at = DVec3::new(1.01, 0.01 * f64::from(k), 0.0);
            (mesh.positions).extend([at, at.with_x(1.015), at.with_z(0.005)]);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        let ball = icosphere(1.0, 3).positions.len() as u32;
        let made = automatic_controls(&mesh, 30).unwrap();
        let of_ball = made.vertices.iter().filter(|v| **v < ball).count();
        assert!(of_ball > 20, "{of_ball}");
        let soup = TriangleMesh {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
        };
        let made = automatic_controls(&soup, 50).unwrap();
        assert_eq!(made.points.len(), 4);
        // Seams of vertices without triangles (of a rigid part) are ignored.
        let mut rest = soup.clone();
        (rest.positions).extend([5.0, 5.0, 6.0, 6.0].map(DVec3::splat));
        let of_rest = automatic_controls(&rest, 50).unwrap();
        assert_eq!(of_rest, made);
        assert!(automatic_controls(&TriangleMesh::default(), 3).is_err());
        assert!(automatic_controls(&soup, 0).is_err());
    }
}
