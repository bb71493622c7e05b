//! Cells and vertices of the levels of a domain.
//!
//! At level `l` each quad has `n × n` cells, `n = 2^l`. Vertices are numbered: corners of quads first, then
//! those along edges, then those inside of quads. All is computed from the quads; nothing is stored, so
//! single cells of fine levels cost nothing.
//!
//! A cell beside a crease has no vertices of the other side among its sixteen. Its vertices beyond the crease
//! are weighted ones of its own side.
//!
//! Not guaranteed: vertices that are more than one cell beyond a border.

use super::QuadDomain;
use super::creases::VertexRule;
use super::extraordinary::{FanKind, FanShape, PLACES, VERTICES_PER_CELL};
use super::half_edges::HalfEdges;

/// A cell of a level: its quad, and its column and row there. Quads from [`QuadDomain::cells`] on lie beyond
/// borders.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LevelCell {
    pub(crate) quad: u32,
    pub(crate) at: [i64; 2],
}

/// Vertices with their weights.
pub(crate) type Weighted = Vec<(usize, f64)>;

/// The control vertices of a cell.
pub(crate) enum Neighbourhood {
    /// All corners have four quads: 4 × 4 vertices, row by row.
    Regular([usize; 16]),
    /// The same beside creases, with weighted vertices beyond them.
    Creased(Box<[Weighted; 16]>),
    /// This corner has no uniform spline: the vertices around it, in the order of
    /// [`leaf_weights`](super::extraordinary::leaf_weights), and the number of the cell in its fan.
    Around { corner: u32, shape: FanShape, cell: usize, vertices: Vec<Weighted> },
}

impl Neighbourhood {
    pub(crate) fn vertices(&self) -> Vec<usize> {
        let all = |weighted: &[Weighted]| weighted.iter().flatten().map(|&(vertex, _)| vertex).collect();
        match self {
            Self::Regular(vertices) => vertices.to_vec(),
            Self::Creased(weighted) => all(&weighted[..]),
            Self::Around { vertices, .. } => all(vertices),
        }
    }
}

/// A level of a domain.
pub(crate) struct Level<'a> {
    domain: &'a QuadDomain,
    edges: &'a HalfEdges,
    /// Cells along each side of a quad.
    n: i64,
}

/// Coordinates in a quad of side `last` in the frame of one of its edges: along the edge, and away from it.
pub(crate) fn to_edge<T: Copy + std::ops::Sub<Output = T>>(side: u32, [x, y]: [T; 2], last: T) -> [T; 2] {
    match side {
        0 => [x, y],
        1 => [y, last - x],
        2 => [last - x, last - y],
        _ => [last - y, x],
    }
}

/// The inverse of [`to_edge`].
pub(crate) fn from_edge<T: Copy + std::ops::Sub<Output = T>>(side: u32, [s, t]: [T; 2], last: T) -> [T; 2] {
    match side {
        0 => [s, t],
        1 => [last - t, s],
        2 => [last - s, last - t],
        _ => [t, last - s],
    }
}

/// The places of the vertices of a cell and of those around it in its frame, row by row.
const PLACES_OF_CELL: [[i64; 2]; 16] = {
    let mut places = [[0; 2]; 16];
    let mut k = 0;
    while k < 16 {
        places[k] = [k as i64 % 4 - 1, k as i64 / 4 - 1];
        k += 1;
    }
    places
};

impl<'a> Level<'a> {
    pub(crate) fn new(domain: &'a QuadDomain, level: usize) -> Self {
        Self { domain, edges: domain.edges(), n: 1 << level }
    }

    fn first_inside(&self) -> usize {
        self.edges.vertex_count() + self.edges.of_edges().len() * (self.n as usize - 1)
    }

    /// False for cells beyond borders.
    pub(crate) fn is_inner(&self, cell: LevelCell) -> bool {
        (cell.quad as usize) < self.domain.cells
    }

    /// The vertex at a place of a quad, or near it: places beyond its sides are found across its edges, first
    /// to the left or right. `None` beyond the quads outside of borders.
    pub(crate) fn vertex(&self, quad: u32, at: [i64; 2]) -> Option<usize> {
        let (mut quad, mut at) = (quad, at);
        loop {
            let side = match at {
                [x, _] if x < 0 => 3,
                [x, _] if x > self.n => 1,
                [_, y] if y < 0 => 0,
                [_, y] if y > self.n => 2,
                _ => break,
            };
            (quad, at, _) = self.domain.across(quad, side, at, self.n)?;
        }
        Some(self.number(quad, at))
    }

    /// The number of the vertex at a place in or on the sides of a quad.
    fn number(&self, quad: u32, [x, y]: [i64; 2]) -> usize {
        let n = self.n;
        let corner = |k: u32| self.edges.start(4 * quad + k) as usize;
        let side = match [x, y] {
            [0, 0] => return corner(0),
            [_, 0] if x == n => return corner(1),
            [0, _] if y == n => return corner(3),
            _ if x == n && y == n => return corner(2),
            [_, 0] => 0,
            [0, _] => 3,
            _ if x == n => 1,
            _ if y == n => 2,
            _ => {
                let inside = (n - 1) * ((n - 1) * i64::from(quad) + y - 1) + x - 1;
                return self.first_inside() + inside as usize;
            }
        };
        let h = 4 * quad + side;
        let edge = self.edges.edge(h) as usize;
        let along = to_edge(side, [x, y], n)[0];
        let along = if self.edges.of_edges()[edge] == h { along } else { n - along };
        self.edges.vertex_count() + edge * (n as usize - 1) + along as usize - 1
    }

    /// The vertex in the middle of a side of a quad, from level 1 on.
    pub(crate) fn middle_of(&self, h: u32) -> usize {
        self.number(h / 4, from_edge(h % 4, [self.n / 2, 0], self.n))
    }

    /// A place of a vertex.
    pub(crate) fn place(&self, vertex: usize) -> (u32, [i64; 2]) {
        let along = self.n as usize - 1;
        let corners = self.edges.vertex_count();
        if vertex < corners {
            let h = self.edges.around(vertex as u32).next().unwrap_or_default();
            (h / 4, from_edge(h % 4, [0, 0], self.n))
        } else if vertex < self.first_inside() {
            let (edge, s) = ((vertex - corners) / along, (vertex - corners) % along);
            let h = self.edges.of_edges()[edge];
            (h / 4, from_edge(h % 4, [s as i64 + 1, 0], self.n))
        } else {
            let inside = vertex - self.first_inside();
            let (quad, k) = (inside / along.pow(2), inside % along.pow(2));
            (quad as u32, [(k % along) as i64 + 1, (k / along) as i64 + 1])
        }
    }

    /// A place of a vertex in a quad that is a cell; of a vertex beyond a border, the nearest place on it.
    pub(crate) fn nearest_inner_place(&self, vertex: usize) -> (u32, [i64; 2]) {
        let is_inner = |cell: &LevelCell| self.is_inner(*cell);
        let place_in = |cell: LevelCell, vertex: usize| {
            let k = self.corners(cell).iter().position(|&v| v == vertex).unwrap_or_default();
            let [x, y] = cell.at;
            (cell.quad, [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]][k])
        };
        let own = self.around(vertex);
        if let Some(&cell) = own.iter().find(|cell| is_inner(cell)) {
            return place_in(cell, vertex);
        }
        // A corner beyond a border shares an edge with a border vertex, or a quad beyond the corner of one.
        let neighbours = own.iter().flat_map(|&cell| {
            let corners = self.corners(cell);
            let k = corners.iter().position(|&v| v == vertex).unwrap_or_default();
            [1, 3, 2].map(|step| (step % 2 == 0, corners[(k + step) % 4]))
        });
        let mut neighbours: Vec<(bool, usize)> = neighbours.collect();
        neighbours.sort_unstable();
        let on_border = neighbours.into_iter().find_map(|(_, near)| {
            self.around(near).into_iter().find(|cell| self.is_inner(*cell)).map(|cell| place_in(cell, near))
        });
        on_border.unwrap_or_else(|| self.place(vertex))
    }

    pub(crate) fn corners(&self, LevelCell { quad, at: [x, y] }: LevelCell) -> [usize; 4] {
        [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]].map(|at| self.number(quad, at))
    }

    /// The cells around a vertex, those beyond borders included.
    pub(crate) fn around(&self, vertex: usize) -> Vec<LevelCell> {
        let cell =
            |h: u32, along: i64| LevelCell { quad: h / 4, at: from_edge(h % 4, [along, 0], self.n - 1) };
        if vertex < self.edges.vertex_count() {
            return self.edges.around(vertex as u32).map(|h| cell(h, 0)).collect();
        }
        let (quad, [x, y]) = self.place(vertex);
        if vertex >= self.first_inside() {
            return [[x, y], [x - 1, y], [x - 1, y - 1], [x, y - 1]]
                .map(|at| LevelCell { quad, at })
                .to_vec();
        }
        let edge = (vertex - self.edges.vertex_count()) / (self.n as usize - 1);
        let h = self.edges.of_edges()[edge];
        let s = to_edge(h % 4, [x, y], self.n)[0];
        let own = [cell(h, s), cell(h, s - 1)];
        let beyond = self.edges.opposite(h).map(|o| [cell(o, self.n - s), cell(o, self.n - s - 1)]);
        own.into_iter().chain(beyond.into_iter().flatten()).collect()
    }

    /// The corner of a cell at which it has no uniform spline.
    pub(crate) fn extraordinary_corner(&self, cell: LevelCell) -> Option<u32> {
        (0..4).find(|&k| {
            let [s, t] = to_edge(k, cell.at, self.n - 1);
            s == 0 && t == 0 && self.domain.is_special_corner(4 * cell.quad + k)
        })
    }

    /// The control vertices of a cell. Its other corners must have uniform splines.
    pub(crate) fn neighbourhood(&self, cell: LevelCell) -> Neighbourhood {
        let Some(corner) = self.extraordinary_corner(cell) else {
            return if self.touches_crease(cell) {
                Neighbourhood::Creased(Box::new(PLACES_OF_CELL.map(|place| self.coefficient(cell, place))))
            } else {
                Neighbourhood::Regular(self.plain_neighbourhood(cell))
            };
        };
        let fan = self.domain.fan(4 * cell.quad + corner);
        let vertex = self.edges.start(fan.first) as usize;
        let mut vertices = Vec::with_capacity(1 + VERTICES_PER_CELL * fan.shape.quads + 4);
        vertices.push(vec![(vertex, 1.0)]);
        let sides: Vec<u32> = self.edges.around_from(fan.first).take(fan.shape.quads).collect();
        let place = |h: u32, [s, t]: [i8; 2]| {
            let cell = LevelCell { quad: h / 4, at: from_edge(h % 4, [0, 0], self.n - 1) };
            self.coefficient(cell, from_edge(h % 4, [s.into(), t.into()], 1))
        };
        for &h in &sides {
            vertices.extend(PLACES.map(|at| place(h, at)));
        }
        if let (true, Some(&last)) = (fan.shape.is_open(), sides.last()) {
            vertices.extend([[0, 1], [0, 2]].map(|at| place(last, at)));
        }
        if let (FanKind::Through, Some(curve)) = (fan.shape.kind, self.along_curve(vertex)) {
            vertices.extend(curve.map(|v| vec![(v, 1.0)]));
        }
        Neighbourhood::Around { corner, shape: fan.shape, cell: fan.cell, vertices }
    }

    /// The 4 × 4 vertices of a cell and those around it, whether edges are creases or not.
    pub(crate) fn plain_neighbourhood(&self, LevelCell { quad, at: [x, y] }: LevelCell) -> [usize; 16] {
        // The domain was checked: control vertices of its cells exist.
        PLACES_OF_CELL.map(|[i, j]| self.vertex(quad, [x + i, y + j]).unwrap_or_default())
    }

    /// The coefficient at a place in the frame of a cell, at most one beyond its sides.
    fn coefficient(&self, cell: LevelCell, [i, j]: [i64; 2]) -> Weighted {
        let beyond = [(3, i < 0), (1, i > 1), (0, j < 0), (2, j > 1)];
        let crease = beyond.into_iter().find(|&(side, is_beyond)| is_beyond && self.is_crease(cell, side));
        let Some((side, _)) = crease else {
            let [x, y] = cell.at;
            return vec![(self.vertex(cell.quad, [x + i, y + j]).unwrap_or_default(), 1.0)];
        };
        // Without a second derivative across the crease, three vertices are evenly spaced.
        let [s, _] = to_edge(side, [i, j], 1);
        let mut sum: Weighted = Vec::with_capacity(4);
        for (t, weight) in [(0, 2.0), (1, -1.0)] {
            for (vertex, w) in self.coefficient(cell, from_edge(side, [s, t], 1)) {
                match sum.iter_mut().find(|(v, _)| *v == vertex) {
                    Some((_, own)) => *own += weight * w,
                    None => sum.push((vertex, weight * w)),
                }
            }
        }
        sum
    }

    /// True if a side of a cell lies on a crease.
    fn is_crease(&self, cell: LevelCell, side: u32) -> bool {
        to_edge(side, cell.at, self.n - 1)[1] == 0 && self.domain.is_crease_side(cell.quad, side)
    }

    fn touches_crease(&self, cell: LevelCell) -> bool {
        (0..4).any(|side| self.is_crease(cell, side))
    }

    /// True for vertices along creases that are no corners of quads.
    fn is_inside_crease(&self, vertex: usize) -> bool {
        (self.edges.vertex_count()..self.first_inside()).contains(&vertex) && {
            let edge = (vertex - self.edges.vertex_count()) / (self.n as usize - 1);
            self.domain.creases.has(self.edges, self.edges.of_edges()[edge])
        }
    }

    /// The neighbours of a vertex on the curve of creases that passes through it.
    fn along_curve(&self, vertex: usize) -> Option<[usize; 2]> {
        let on = |h: u32, s: i64| self.number(h / 4, from_edge(h % 4, [s, 0], self.n));
        if vertex < self.edges.vertex_count() {
            return match self.domain.creases.rule(vertex as u32) {
                VertexRule::Through(curve) => Some(curve.map(|h| on(h, 1))),
                _ => None,
            };
        }
        self.is_inside_crease(vertex).then(|| {
            let along = self.n as usize - 1;
            let (edge, s) =
                ((vertex - self.edges.vertex_count()) / along, vertex - self.edges.vertex_count());
            let (h, s) = (self.edges.of_edges()[edge], (s % along) as i64 + 1);
            [on(h, s - 1), on(h, s + 1)]
        })
    }

    fn is_corner(&self, vertex: usize) -> bool {
        vertex < self.edges.vertex_count() && self.domain.creases.rule(vertex as u32) == VertexRule::Corner
    }

    /// True if a quad at a vertex has no uniform spline because of it.
    fn is_extraordinary(&self, vertex: usize) -> bool {
        vertex < self.domain.inner_vertices
            && match self.domain.creases.rule(vertex as u32) {
                VertexRule::Smooth => self.domain.valence(vertex as u32) != 4,
                VertexRule::Dart => true,
                _ => self.edges.around(vertex as u32).any(|h| self.domain.is_special_corner(h)),
            }
    }

    /// The cells, not beyond borders, whose splines depend on a vertex.
    pub(crate) fn users(&self, vertex: usize) -> Vec<LevelCell> {
        if vertex >= self.first_inside() {
            let (quad, [x, y]) = self.place(vertex);
            // Most vertices of fine levels are far from the sides of their quads, where all is regular.
            if [x, y].iter().all(|&c| 3 <= c && c <= self.n - 3) {
                let column = |x| (y - 2..y + 2).map(move |y| LevelCell { quad, at: [x, y] });
                return if self.is_inner(LevelCell { quad, at: [x, y] }) {
                    (x - 2..x + 2).flat_map(column).collect()
                } else {
                    Vec::new()
                };
            }
        }
        let mut cells: Vec<LevelCell> = Vec::with_capacity(16);
        let near = self.around(vertex).into_iter().flat_map(|cell| self.corners(cell));
        let ring = |vertices: &mut dyn Iterator<Item = usize>, cells: &mut Vec<LevelCell>| {
            vertices.for_each(|v| cells.extend(self.around(v)));
            cells.sort_unstable();
            cells.dedup();
        };
        ring(&mut near.collect::<Vec<_>>().into_iter(), &mut cells);
        // All cells around an extraordinary vertex depend on all vertices of their neighbours.
        let special: Vec<usize> = (cells.iter().flat_map(|&cell| self.corners(cell)))
            .filter(|&v| self.is_extraordinary(v))
            .collect();
        ring(&mut special.into_iter(), &mut cells);
        // Cells across a crease do not depend on the vertex.
        let depends = |cell: LevelCell| {
            let is_uniform = !self.touches_crease(cell) && self.extraordinary_corner(cell).is_none();
            is_uniform || self.neighbourhood(cell).vertices().contains(&vertex)
        };
        cells.retain(|&cell| self.is_inner(cell) && (self.domain.creases().is_empty() || depends(cell)));
        cells
    }

    /// A vertex as a weighted sum of those of the coarser level, `coarse`, by the rules of Catmull and Clark.
    /// Vertices on creases follow the spline of the crease.
    pub(crate) fn parents(&self, coarse: &Self, vertex: usize) -> Weighted {
        let (quad, [x, y]) = self.place(vertex);
        let mut sum: Weighted = Vec::with_capacity(9);
        let mut add = |vertex: usize, weight: f64| match sum.iter_mut().find(|(v, _)| *v == vertex) {
            Some((_, w)) => *w += weight,
            None => sum.push((vertex, weight)),
        };
        let [a, b] = [[x / 2, y / 2], [(x + 1) / 2, (y + 1) / 2]].map(|at| coarse.number(quad, at));
        match [x % 2, y % 2] {
            [0, 0] if coarse.is_corner(a) => add(a, 1.0),
            [0, 0] if coarse.along_curve(a).is_some() => {
                add(a, 0.75);
                coarse.along_curve(a).into_iter().flatten().for_each(|v| add(v, 0.125));
            }
            [0, 0] => {
                let cells = coarse.around(a);
                let n = cells.len() as f64;
                add(a, (n - 3.0) / n);
                for cell in cells {
                    let corners = coarse.corners(cell);
                    let k = corners.iter().position(|&v| v == a).unwrap_or_default();
                    corners.into_iter().for_each(|v| add(v, 0.25 / (n * n)));
                    add(a, 1.0 / (n * n));
                    add(corners[(k + 1) % 4], 1.0 / (n * n));
                }
            }
            [1, 1] => {
                let cell = LevelCell { quad, at: [x / 2, y / 2] };
                coarse.corners(cell).into_iter().for_each(|v| add(v, 0.25));
            }
            _ if self.is_inside_crease(vertex) => [a, b].into_iter().for_each(|v| add(v, 0.5)),
            _ => {
                [a, b].into_iter().for_each(|v| add(v, 0.25));
                let corners = coarse.around(a).into_iter().map(|cell| coarse.corners(cell));
                for own in corners.filter(|own| own.contains(&b)) {
                    own.into_iter().for_each(|v| add(v, 0.0625));
                }
            }
        }
        sum.sort_unstable_by_key(|(vertex, _)| *vertex);
        sum
    }
}

impl QuadDomain {
    /// A place of a quad of side `last` in the frame of the quad across one of its sides, with that quad and
    /// its own side there. `None` at a border.
    pub(crate) fn across<T: Copy + std::ops::Sub<Output = T> + Default>(
        &self,
        quad: u32,
        side: u32,
        at: [T; 2],
        last: T,
    ) -> Option<(u32, [T; 2], u32)> {
        let opposite = self.edges.opposite(4 * quad + side)?;
        let [s, t] = to_edge(side, at, last);
        let of_next = opposite % 4;
        Some((opposite / 4, from_edge(of_next, [last - s, T::default() - t], last), of_next))
    }
}
