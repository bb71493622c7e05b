//! Curves, corners and regions of a mesh with creases.
//!
//! A curve is a chain of creases between two corners, or a closed one. A corner is a vertex where other than
//! two creases meet, or that is marked. A region is a part of the surface that creases separate from others.

use super::creases::{CreaseEdges, CurveSide, Fan, FanTargets, VertexKind};
use super::faces::{EdgeMap, Faces};
use super::{Layout, mesh_of};
use planish_core::{DVec3, DisjointSets};
use planish_estimate::{Error, Result};
use planish_mesh::{MeshSearch, TriangleMesh};
use planish_spline::{Division, QuadDomain};
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::{FRAC_PI_2, PI};

/// A closed mesh of which some edges are creases.
#[derive(Debug, Clone)]
pub struct CreasedMesh {
    /// The mesh.
    pub mesh: TriangleMesh,
    /// Pairs of vertices joined by an edge.
    pub creases: Vec<[u32; 2]>,
    /// Vertices where a crease turns sharply, besides those where it ends or where three or more meet.
    pub corners: Vec<u32>,
}

impl CreasedMesh {
    /// A mesh without creases.
    #[must_use]
    pub fn smooth(mesh: TriangleMesh) -> Self {
        Self { mesh, creases: Vec::new(), corners: Vec::new() }
    }
}

/// Two of three creases at a vertex are one curve if they turn by less than this angle.
const MAX_TURN: f64 = PI / 6.0;
/// Faces of a region that are tested to find the region of the mesh on which it lies.
const TESTED_FACES: usize = 25;
/// Points of a chain that are tested to find its curve.
const TESTED_POINTS: usize = 25;

/// A chain of creases.
#[derive(Debug)]
pub(super) struct Curve {
    points: Vec<DVec3>,
}

impl Curve {
    /// The nearest point, with the direction of the curve there.
    pub(super) fn nearest(&self, p: DVec3) -> (DVec3, DVec3) {
        let mut best = (f64::INFINITY, self.points[0], DVec3::X);
        for pair in self.points.windows(2) {
            let on = on_segment(p, pair[0], pair[1]);
            let squared = p.distance_squared(on);
            if squared < best.0 {
                best = (squared, on, pair[1] - pair[0]);
            }
        }
        (best.1, best.2.normalize_or_zero())
    }
}

/// Where a vertex of a layout may move.
pub(super) enum Place<'a> {
    /// On a surface.
    On(&'a MeshSearch),
    /// Along a curve.
    Along(&'a Curve),
    Fixed,
}

/// The creases of a mesh.
#[derive(Default)]
pub(super) struct CreaseNetwork {
    pub(super) edges: CreaseEdges,
    pub(super) curves: Vec<Curve>,
    /// Target numbers of quads of the fans at each corner.
    pub(super) targets: FanTargets,
    /// For each corner, true if it has to be marked, so that its curves end there.
    ends_curves: Vec<bool>,
    /// The numbers of corners by the coordinates of their vertices.
    corner_at: HashMap<[u64; 3], u32>,
    /// The region of each triangle.
    region_of: Vec<u32>,
    regions: Vec<MeshSearch>,
    /// The region of each side of each curve.
    region_at: HashMap<CurveSide, u32>,
}

impl CreaseNetwork {
    /// # Errors
    /// `Input` for creases that are no edges, and for corners without a crease.
    pub(super) fn new(creased: &CreasedMesh) -> Result<Self> {
        let mesh = &creased.mesh;
        if creased.creases.is_empty() && creased.corners.is_empty() {
            return Ok(Self::default());
        }
        let ends = |[a, b, c]: [u32; 3]| [(a, b), (b, c), (c, a)];
        let left: EdgeMap<u32> = (0..)
            .zip(&mesh.triangles)
            .flat_map(|(t, &triangle)| ends(triangle).map(|edge| (edge, t)))
            .collect();
        let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for &[a, b] in &creased.creases {
            if !left.contains_key(&(a, b)) {
                return Err(Error::input(format!(
                    "the crease from vertex {a} to {b} is no edge of the mesh"
                )));
            }
            around.entry(a).or_default().push(b);
            around.entry(b).or_default().push(a);
        }
        around.values_mut().for_each(|near| {
            near.sort_unstable();
            near.dedup();
        });
        if let Some(corner) = creased.corners.iter().find(|v| !around.contains_key(v)) {
            return Err(Error::input(format!("the corner at vertex {corner} has no crease")));
        }
        let mut own = Self::default();
        own.edges.kinds = vec![VertexKind::Free; mesh.positions.len()];
        let mut corners: Vec<u32> =
            around.iter().filter(|(_, near)| near.len() != 2).map(|(v, _)| *v).collect();
        corners.extend(creased.corners.iter().filter(|v| around[v].len() == 2));
        corners.sort_unstable();
        corners.dedup();
        for (number, &v) in (0..).zip(&corners) {
            own.edges.kinds[v as usize] = VertexKind::Corner(number);
        }
        own.add_curves(mesh, &around, &corners);
        own.add_targets(mesh, &left, &around, &corners, &creased.corners);
        own.add_regions(mesh, &left)?;
        Ok(own)
    }

    fn add_curves(&mut self, mesh: &TriangleMesh, around: &BTreeMap<u32, Vec<u32>>, corners: &[u32]) {
        // Chains from corners first. What is left are closed curves.
        let starts: Vec<u32> = corners.iter().copied().chain(around.keys().copied()).collect();
        for start in starts {
            for &first in &around[&start] {
                if self.edges.has((start, first)) {
                    continue;
                }
                let mut chain = vec![start, first];
                while let [.., before, at] = chain[..]
                    && at != start
                    && !matches!(self.edges.kind(at), VertexKind::Corner(_))
                    && let Some(&next) = around[&at].iter().find(|&&w| w != before)
                {
                    chain.push(next);
                }
                self.add_curve(mesh, &chain);
            }
        }
    }

    fn add_curve(&mut self, mesh: &TriangleMesh, chain: &[u32]) {
        let number = self.curves.len() as u32;
        for pair in chain.windows(2) {
            self.edges.set((pair[0], pair[1]), 2 * number);
        }
        for &v in
            chain.iter().filter(|&&v| self.edges.kinds[v as usize] == VertexKind::Free).collect::<Vec<_>>()
        {
            self.edges.kinds[v as usize] = VertexKind::OnCurve(number);
        }
        self.curves.push(Curve { points: chain.iter().map(|&v| mesh.positions[v as usize]).collect() });
    }

    /// Numbers of quads by the angles between creases, and whether curves end at corners.
    fn add_targets(
        &mut self,
        mesh: &TriangleMesh,
        left: &EdgeMap<u32>,
        around: &BTreeMap<u32, Vec<u32>>,
        corners: &[u32],
        marked: &[u32],
    ) {
        for (number, &v) in (0..).zip(corners) {
            let at = mesh.positions[v as usize];
            self.corner_at.insert(bits(at), number);
            let way = |w: u32| mesh.positions[w as usize] - at;
            let mut fans: Vec<(u32, f64)> = Vec::new();
            for &start in &around[&v] {
                let (mut w, mut angle) = (start, 0.0);
                while let Some(&t) = left.get(&(v, w)) {
                    let triangle = mesh.triangles[t as usize];
                    let Some(k) = triangle.iter().position(|&u| u == v) else { break };
                    let next = triangle[(k + 2) % 3];
                    angle += way(w).angle_between(way(next));
                    w = next;
                    if w == start || self.edges.has((v, w)) {
                        break;
                    }
                }
                fans.extend(self.edges.side((v, start)).map(|side| (side, angle)));
            }
            let targets = targets_of(&fans);
            self.targets.push(targets);
            let turns = |near: &[u32]| {
                let ways: Vec<DVec3> = near.iter().map(|&w| way(w)).collect();
                let mut pairs = (0..ways.len()).flat_map(|k| (0..k).map(move |j| (j, k)));
                !pairs.any(|(j, k)| ways[j].angle_between(ways[k]) > PI - MAX_TURN)
            };
            let near = &around[&v];
            self.ends_curves.push(match near.len() {
                1 => false,
                3 => marked.contains(&v) || turns(near),
                _ => true,
            });
        }
    }

    fn add_regions(&mut self, mesh: &TriangleMesh, left: &EdgeMap<u32>) -> Result<()> {
        let faces: Vec<&[u32]> = mesh.triangles.iter().map(|t| &t[..]).collect();
        self.region_of = regions(&faces, &self.edges, left);
        let at_creases =
            self.edges.sides.iter().map(|(edge, &side)| (side, self.region_of[left[edge] as usize]));
        self.region_at = at_creases.collect();
        let count = self.region_of.iter().max().map_or(0, |last| last + 1);
        for region in 0..count {
            let own = mesh_of(mesh, |t| self.region_of[t] == region)?;
            self.regions.push(MeshSearch::try_new(&own)?);
        }
        Ok(())
    }

    /// The domain of faces that all are quads. `numbers` are the new numbers of their vertices.
    pub(super) fn domain(
        &self,
        cells: &[[u32; 4]],
        faces: &Faces,
        creases: &CreaseEdges,
        numbers: &[u32],
    ) -> Result<QuadDomain> {
        let is_marked = |v: u32, corner: u32| {
            let near = faces.neighbours(v).iter().filter(|&&w| creases.has((v, w)));
            let fans = near
                .filter_map(|&w| faces.left_of(v, w))
                .map(|(face, _)| Fan::new(faces, creases, &self.targets, v, face).quads);
            // With as many quads on both sides of two creases, the curve has to pass.
            let fans: Vec<usize> = fans.collect();
            self.ends_curves[corner as usize] && !matches!(fans[..], [a, b] if a == b && a > 1)
        };
        let new = |v: u32| numbers[v as usize];
        let mut corners = Vec::new();
        for (v, kind) in (0..).zip(&creases.kinds) {
            if let VertexKind::Corner(corner) = kind
                && faces.valence(v) > 0
                && is_marked(v, *corner)
            {
                corners.push(new(v));
            }
        }
        let edges: Vec<[u32; 2]> = creases.sorted().into_iter().map(|(a, b)| [new(a), new(b)]).collect();
        QuadDomain::with_creases(cells, &edges, &corners)
    }

    /// The creases of a layout. Corners of the mesh are found by their positions, and the curve of a chain by
    /// its distance.
    fn edges_of(&self, layout: &Layout) -> CreaseEdges {
        let mut edges = CreaseEdges::default();
        if self.edges.is_empty() {
            return edges;
        }
        let mut around: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for &[a, b] in layout.domain.creases() {
            around.entry(a).or_default().push(b);
            around.entry(b).or_default().push(a);
        }
        let at = |v: u32| layout.positions[v as usize];
        edges.kinds = vec![VertexKind::Free; layout.positions.len()];
        for &v in around.keys() {
            if let Some(&corner) = self.corner_at.get(&bits(at(v))) {
                edges.kinds[v as usize] = VertexKind::Corner(corner);
            }
        }
        let is_corner = |edges: &CreaseEdges, v: u32| matches!(edges.kind(v), VertexKind::Corner(_));
        let corners: Vec<u32> = around.keys().copied().filter(|&v| is_corner(&edges, v)).collect();
        for start in corners.into_iter().chain(around.keys().copied()) {
            for &first in &around[&start] {
                if edges.has((start, first)) {
                    continue;
                }
                let mut chain = vec![start, first];
                while let [.., before, last] = chain[..]
                    && last != start
                    && !is_corner(&edges, last)
                    && let Some(&next) = around[&last].iter().find(|&&w| w != before)
                {
                    chain.push(next);
                }
                let points: Vec<DVec3> = chain.iter().map(|&v| at(v)).collect();
                let curve = self.curve_near(&points);
                let ways = points.windows(2).map(|pair| {
                    let along = self.curves[curve as usize].nearest(0.5 * (pair[0] + pair[1])).1;
                    along.dot((pair[1] - pair[0]).normalize_or_zero())
                });
                let is_reversed = ways.sum::<f64>() < 0.0;
                for pair in chain.windows(2) {
                    edges.set((pair[0], pair[1]), 2 * curve + u32::from(is_reversed));
                }
                for &v in chain
                    .iter()
                    .filter(|&&v| !matches!(edges.kinds[v as usize], VertexKind::Corner(_)))
                    .collect::<Vec<_>>()
                {
                    edges.kinds[v as usize] = VertexKind::OnCurve(curve);
                }
            }
        }
        edges
    }

    /// Largest distance from a curve to its creases in a layout of a part of the mesh.
    pub(super) fn largest_gap(&self, layout: &Layout) -> f64 {
        let mut of_curve: BTreeMap<u32, Vec<[DVec3; 2]>> = BTreeMap::new();
        for (edge, side) in self.edges_of(layout).sides {
            let ends = [edge.0, edge.1].map(|v| layout.positions[v as usize]);
            of_curve.entry(side / 2).or_default().push(ends);
        }
        let gap = |(curve, edges): (u32, Vec<[DVec3; 2]>)| {
            let points = &self.curves[curve as usize].points;
            let tested = points.iter().step_by(points.len().div_ceil(TESTED_POINTS).max(1));
            let distance = |p: &DVec3| {
                edges.iter().map(|&[a, b]| p.distance(on_segment(*p, a, b))).fold(f64::INFINITY, f64::min)
            };
            tested.map(distance).fold(0.0, f64::max)
        };
        of_curve.into_iter().map(gap).fold(0.0, f64::max)
    }

    /// The curve nearest to a chain of points and to the middles between them.
    fn curve_near(&self, chain: &[DVec3]) -> u32 {
        let middles = chain.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let tested: Vec<DVec3> = chain.iter().copied().chain(middles).collect();
        let step = tested.len().div_ceil(TESTED_POINTS).max(1);
        let distance = |curve: &Curve| -> f64 {
            tested.iter().step_by(step).map(|&p| curve.nearest(p).0.distance(p)).sum()
        };
        let all = (0..).zip(self.curves.iter().map(distance));
        all.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(number, _)| number)
    }

    /// The creases of a divided layout. Corners are put back to their places.
    pub(super) fn divided(
        &self,
        layout: &Layout,
        division: &Division,
        positions: &mut [DVec3],
    ) -> CreaseEdges {
        let coarse = self.edges_of(layout);
        let mut fine = CreaseEdges::default();
        if coarse.is_empty() {
            return fine;
        }
        fine.kinds = vec![VertexKind::Free; positions.len()];
        let quarters = division.domain.cells();
        for (c, cell) in layout.domain.cells().iter().enumerate() {
            for k in 0..4 {
                let (own, middle) = (quarters[4 * c + k][k], quarters[4 * c + k][(k + 1) % 4]);
                fine.kinds[own as usize] = coarse.kind(cell[k]);
                if matches!(coarse.kind(cell[k]), VertexKind::Corner(_)) {
                    positions[own as usize] = layout.positions[cell[k] as usize];
                }
                if let Some(side) = coarse.side((cell[k], cell[(k + 1) % 4])) {
                    fine.kinds[middle as usize] = VertexKind::OnCurve(side / 2);
                    fine.set((own, middle), side);
                    fine.set((middle, quarters[4 * c + (k + 1) % 4][(k + 1) % 4]), side);
                }
            }
        }
        fine
    }

    /// Where each vertex of faces may move. `search` is that of the whole mesh.
    pub(super) fn places<'a>(
        &'a self,
        faces: &[&[u32]],
        edges: &CreaseEdges,
        positions: &[DVec3],
        search: &'a MeshSearch,
    ) -> Vec<Place<'a>> {
        if self.edges.is_empty() {
            return (0..positions.len()).map(|_| Place::On(search)).collect();
        }
        let mut left = EdgeMap::default();
        for (f, face) in (0..).zip(faces) {
            (0..face.len()).for_each(|k| {
                left.insert((face[k], face[(k + 1) % face.len()]), f);
            });
        }
        let region_of = regions(faces, edges, &left);
        let on = self.regions_on_mesh(faces, edges, &region_of, positions, search);
        let mut places: Vec<Place> = (0..positions.len()).map(|_| Place::On(search)).collect();
        for (face, &region) in faces.iter().zip(&region_of) {
            for &v in *face {
                places[v as usize] = match edges.kind(v) {
                    VertexKind::Free => Place::On(&self.regions[on[region as usize]]),
                    VertexKind::OnCurve(curve) => Place::Along(&self.curves[curve as usize]),
                    VertexKind::Corner(_) => Place::Fixed,
                };
            }
        }
        places
    }

    /// For each region of faces, that of the mesh beside the same curves. A region without creases is the one
    /// on which most of its tested faces lie.
    fn regions_on_mesh(
        &self,
        faces: &[&[u32]],
        edges: &CreaseEdges,
        region_of: &[u32],
        positions: &[DVec3],
        search: &MeshSearch,
    ) -> Vec<usize> {
        let count = region_of.iter().max().map_or(0, |last| *last as usize + 1);
        let mut members: Vec<Vec<&[u32]>> = vec![Vec::new(); count];
        for (face, &region) in faces.iter().zip(region_of) {
            members[region as usize].push(face);
        }
        let region_near = |face: &[u32]| {
            let corners: Vec<DVec3> = face.iter().map(|&v| positions[v as usize]).collect();
            let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let last = corners[corners.len() - 1];
            let normal = (corners[1] - corners[0]).cross(last - corners[0])
                + (corners[2] - corners[1]).cross(last - corners[1]);
            let on = search.closest_compatible(middle, normal, FRAC_PI_2).or_else(|| search.closest(middle));
            on.map_or(0, |on| self.region_of[on.triangle as usize])
        };
        let at_creases = |face: &[u32]| {
            let sides = (0..face.len()).filter_map(|k| edges.side((face[k], face[(k + 1) % face.len()])));
            sides.filter_map(|side| self.region_at.get(&side).copied()).collect::<Vec<_>>()
        };
        let found = members.iter().map(|own| {
            let mut votes: HashMap<u32, usize> = HashMap::new();
            for region in own.iter().flat_map(|face| at_creases(face)) {
                *votes.entry(region).or_default() += 1;
            }
            if let Some((&region, _)) =
                votes.iter().max_by_key(|(region, count)| (**count, u32::MAX - **region))
            {
                return region;
            }
            for face in own.iter().step_by(own.len().div_ceil(TESTED_FACES).max(1)) {
                *votes.entry(region_near(face)).or_default() += 1;
            }
            votes
                .into_iter()
                .max_by_key(|(region, count)| (*count, u32::MAX - region))
                .map_or(0, |best| best.0)
        });
        found.map(|region| region as usize).collect()
    }
}

/// The point of a segment nearest to a point.
fn on_segment(p: DVec3, a: DVec3, b: DVec3) -> DVec3 {
    let way = b - a;
    a + ((p - a).dot(way) / way.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0) * way
}

/// A position as a key.
fn bits(p: DVec3) -> [u64; 3] {
    // Adding zero turns −0 into 0.
    p.to_array().map(|x| (x + 0.0).to_bits())
}

/// Numbers of quads of the fans at a corner, from the curves where they start and their angles.
fn targets_of(fans: &[(u32, f64)]) -> HashMap<u32, usize> {
    if let [(curve, _)] = fans {
        return HashMap::from([(*curve, 4)]);
    }
    // With less than 180°, a fan of three quads folds; with more, one of two does.
    let target = |angle: f64| {
        let rounded = (angle / FRAC_PI_2).round() as usize;
        if angle > PI { rounded.max(3) } else { rounded.clamp(1, 2) }
    };
    let mut targets: Vec<(u32, f64, usize)> =
        fans.iter().map(|&(curve, angle)| (curve, angle, target(angle))).collect();
    // Of two fans, the one with fewer quads has less than 180°.
    if let [first, second] = &mut targets[..]
        && first.2 == second.2
    {
        let (small, large) = if first.1 <= second.1 { (first, second) } else { (second, first) };
        if small.2 > 1 {
            small.2 -= 1;
        } else {
            large.2 += 1;
        }
    }
    targets.into_iter().map(|(curve, _, target)| (curve, target)).collect()
}

/// The region of each face: faces that share edges without a crease.
fn regions(faces: &[&[u32]], edges: &CreaseEdges, left: &EdgeMap<u32>) -> Vec<u32> {
    let mut sets = DisjointSets::new(faces.len());
    for (f, face) in (0..).zip(faces) {
        for k in 0..face.len() {
            let (a, b) = (face[k], face[(k + 1) % face.len()]);
            if let Some(&over) = left.get(&(b, a)).filter(|_| !edges.has((a, b))) {
                sets.join(f, over);
            }
        }
    }
    let mut numbers: HashMap<u32, u32> = HashMap::new();
    (0..faces.len() as u32)
        .map(|f| {
            let next = numbers.len() as u32;
            *numbers.entry(sets.root(f)).or_insert(next)
        })
        .collect()
}
