//! Surfaces as boundary representations, for CAD programs.
//!
//! Input: a [`Surface`] over any hierarchy. Output: a [`Brep`] of bicubic B-spline faces that equal this
//! surface exactly. A hierarchical spline is a tensor spline on a face of one level, and clamping the ends of
//! the knots changes the outermost two control points only. Inner knots stay simple, so faces are C² inside.
//!
//! A small surface is written in as few faces as closing allows (a sheet in one, a tube or ball in two
//! halves, a torus in four quarters); a large one in a face for each cell of the base grid, each at its own
//! finest level. Neighbours share edges, whose curves come from the finer side. A surface over quads has a
//! face for each rectangle of quads between extraordinary vertices.
//!
//! Not guaranteed: that faces do not cross each other where the surface folds.
//!
//! # References
//! Boehm, *Inserting new knots into B-spline curves*, CAD 1980 (clamping); Ramshaw, *Blossoms are polar
//! forms*, CAGD 1989.

mod over_quads;
mod planes;
mod rectangles;

pub(super) use planes::FacePlanes;
use planish_core::DVec3;
use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineCurve, BsplineSurface};
use planish_spline::{Cell, Hierarchy, Surface, quadrature};

/// Settings of the export as a boundary representation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BrepOptions {
    /// Largest number of control points with which the surface is written in as few faces as closing allows.
    pub max_control_points: usize,
}

impl Default for BrepOptions {
    /// 60,000 control points: a file of about 4 MB.
    fn default() -> Self {
        Self { max_control_points: 60_000 }
    }
}

/// The exact surface as B-spline faces; closed for a ball and a torus, and then with its faces turned
/// outward.
///
/// Several bodies are several closed sets of faces. A face's parameters are the surface's, in base-grid
/// units; over quads, they begin with 0 at a corner of the face. Cost: linear in the control points written.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_surface::export::{BrepOptions, brep_from_surface};
/// use planish_spline::BaseShape;
/// let ball = BaseShape::sphere(DVec3::ZERO, 10.0, DVec3::Z).surface([16, 8])?;
/// let brep = brep_from_surface(&ball, &BrepOptions::default());
/// assert_eq!((brep.faces.len(), brep.edges.len(), brep.vertices.len()), (2, 2, 2));
/// brep.check(1e-9)?;
/// # Ok::<(), planish_spline::Error>(())
/// ```
#[must_use]
pub fn brep_from_surface(surface: &Surface, options: &BrepOptions) -> Brep {
    if let Some(domain) = surface.space().domain() {
        return over_quads::brep(surface, domain);
    }
    Patches::within(surface.space(), options).brep(surface)
}

/// The base grid, divided into a coarser grid of patches.
struct Patches {
    /// For u and v.
    periodic: [bool; 2],
    polar: bool,
    /// Borders of patches along u and v, in base cells, including both ends of the domain.
    cuts: [Vec<u32>; 2],
    /// For each patch, row by row, the level of its finest leaf.
    levels: Vec<u8>,
}

impl Patches {
    /// As few patches as closing and the options allow.
    fn within(space: &Hierarchy, options: &BrepOptions) -> Self {
        let [columns, rows] = space.base().map(|n| n as u32);
        let halves = |n: u32, periodic: bool| if periodic { vec![0, n / 2, n] } else { vec![0, n] };
        // A closed direction is cut into two faces, so that no face closes on itself.
        let few = Self::new(space, [halves(columns, space.periodic_u()), halves(rows, space.periodic_v())]);
        match few.control_points() <= options.max_control_points {
            true => few,
            false => Self::new(space, [(0..=columns).collect(), (0..=rows).collect()]),
        }
    }

    /// Number of the patch that contains a cell.
    fn of_cell(&self, cell: Cell) -> usize {
        self.at([cell.i, cell.j].map(|index| i64::from(index >> cell.level)))
    }

    /// Number of the patch that contains a cell of the base grid.
    fn at(&self, cell: [i64; 2]) -> usize {
        let [a, b] =
            [0, 1].map(|d| self.cuts[d].partition_point(|&cut| i64::from(cut) <= cell[d]).max(1) - 1);
        b * self.count()[0] + a
    }

    fn new(space: &Hierarchy, cuts: [Vec<u32>; 2]) -> Self {
        let mut levels = vec![0; (cuts[0].len() - 1) * (cuts[1].len() - 1)];
        let mut patches = Self {
            periodic: [space.periodic_u(), space.periodic_v()],
            polar: space.polar(),
            cuts,
            levels: Vec::new(),
        };
        for &cell in space.leaves() {
            let at = patches.of_cell(cell);
            // A coarse leaf has an exact representation at a finer level, but not the reverse.
            levels[at] = cell.level.max(levels[at]);
        }
        patches.levels = levels;
        patches
    }

    fn is_closed(&self) -> bool {
        self.periodic[0] && (self.periodic[1] || self.polar)
    }

    /// Patches along u and v.
    fn count(&self) -> [usize; 2] {
        [self.cuts[0].len() - 1, self.cuts[1].len() - 1]
    }

    fn level(&self, [a, b]: [usize; 2]) -> u8 {
        self.levels[b * self.count()[0] + a]
    }

    /// Spans of a patch at its level, along a direction.
    fn spans(&self, patch: [usize; 2], d: usize) -> usize {
        let cuts = &self.cuts[d][patch[d]..];
        ((cuts[1] - cuts[0]) as usize) << self.level(patch)
    }

    fn control_points(&self) -> usize {
        self.all().map(|patch| (self.spans(patch, 0) + 3) * (self.spans(patch, 1) + 3)).sum()
    }

    fn all(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let [nu, nv] = self.count();
        (0..nv).flat_map(move |b| (0..nu).map(move |a| [a, b]))
    }

    /// Clamped knots of a patch along a direction.
    fn knots(&self, patch: [usize; 2], d: usize) -> Vec<(f64, usize)> {
        let spans = self.spans(patch, d);
        let side = 0.5_f64.powi(i32::from(self.level(patch)));
        let start = f64::from(self.cuts[d][patch[d]]);
        // Four equal knots at each end: the outermost control points are then those of the border curve, on
        // which the edges of neighbouring faces rely.
        (0..=spans).map(|k| (start + k as f64 * side, if k == 0 || k == spans { 4 } else { 1 })).collect()
    }

    /// The tensor surface on a patch. Rows at a pole equal the pole exactly.
    fn surface(&self, surface: &Surface, patch: [usize; 2]) -> BsplineSurface {
        let level = self.level(patch);
        let [nu, nv] = [0, 1].map(|d| self.spans(patch, d));
        let [i0, j0] = [0, 1].map(|d| self.cuts[d][patch[d]] << level);
        let (n_u, n_v) = (nu + 3, nv + 3);
        // Windows of neighbouring cells overlap. Their coefficients agree at the level of the patch, so the
        // order of writing does not matter.
        let mut poles = vec![DVec3::ZERO; n_u * n_v];
        for j in 0..nv {
            for i in 0..nu {
                let cell = Cell { level, i: i0 + i as u32, j: j0 + j as u32 };
                let c = surface.cell_coefficients(cell).expect("no leaf of a patch is finer than its level");
                for k in 0..16 {
                    poles[(i + k % 4) * n_v + j + k / 4] = c[k];
                }
            }
        }
        // Clamping acts along one direction at a time, as the tensor product allows.
        for row in 0..n_v {
            clamp_ends(&mut poles, row, n_v, n_u);
        }
        for column in 0..n_u {
            clamp_ends(&mut poles, column * n_v, 1, n_v);
        }
        // After clamping, the control points of a row at a pole agree up to rounding only. A pole is one
        // vertex, so they must be equal.
        if self.polar {
            for (at_pole, row, v) in [
                (patch[1] == 0, 0, 0.0),
                (patch[1] + 1 == self.count()[1], n_v - 1, surface.space().extent()[1]),
            ] {
                if at_pole {
                    let pole = surface.point(0.0, v);
                    for column in 0..n_u {
                        poles[column * n_v + row] = pole;
                    }
                }
            }
        }
        BsplineSurface {
            degree_u: 3,
            degree_v: 3,
            knots_u: self.knots(patch, 0),
            knots_v: self.knots(patch, 1),
            n_u,
            n_v,
            poles,
        }
    }

    fn brep(&self, surface: &Surface) -> Brep {
        let surfaces: Vec<BsplineSurface> = self.all().map(|patch| self.surface(surface, patch)).collect();
        let closed = self.is_closed();
        // The parametrisation may be inside out, which the sign of the enclosed volume shows.
        let outward = !closed || encloses_positive_volume(surface);
        let mut builder = BrepBuilder {
            patches: self,
            surfaces: &surfaces,
            brep: Brep { closed, ..Brep::default() },
            vertices: Vec::new(),
            edges: [Vec::new(), Vec::new()],
        };
        builder.add_vertices();
        builder.add_edges(0);
        builder.add_edges(1);
        let loops: Vec<_> = self.all().map(|patch| builder.face_loop(patch, outward)).collect();
        let mut brep = builder.brep;
        brep.faces = surfaces
            .into_iter()
            .zip(loops)
            .map(|(surface, edges)| BrepFace { surface, edges, holes: Vec::new(), same_sense: outward })
            .collect();
        brep
    }
}

/// Shared vertices and edges of the patches.
///
/// Grid lines are numbered like the patches that start there, and one more where a direction is open; line
/// `n` of a closed direction is line 0.
struct BrepBuilder<'a> {
    patches: &'a Patches,
    surfaces: &'a [BsplineSurface],
    brep: Brep,
    /// For each crossing of grid lines, row by row.
    vertices: Vec<usize>,
    /// Edges along u and along v that start at each crossing; none along a pole.
    edges: [Vec<Option<usize>>; 2],
}

impl BrepBuilder<'_> {
    fn lines(&self) -> [usize; 2] {
        let [nu, nv] = self.patches.count();
        let periodic = self.patches.periodic;
        [nu + usize::from(!periodic[0]), nv + usize::from(!periodic[1])]
    }

    fn crossing(&self, a: usize, b: usize) -> usize {
        let [lu, lv] = self.lines();
        (b % lv) * lu + a % lu
    }

    fn is_pole(&self, b: usize) -> bool {
        self.patches.polar && (b == 0 || b == self.patches.count()[1])
    }

    fn patch_surface(&self, [a, b]: [usize; 2]) -> &BsplineSurface {
        &self.surfaces[b * self.patches.count()[0] + a]
    }

    fn add_vertices(&mut self) {
        let [lu, lv] = self.lines();
        let [nu, nv] = self.patches.count();
        for b in 0..lv {
            for a in 0..lu {
                // All grid lines along v meet in one vertex at a pole.
                if self.is_pole(b) && a > 0 {
                    self.vertices.push(self.vertices[b * lu]);
                    continue;
                }
                let patch = [a.min(nu - 1), b.min(nv - 1)];
                let s = self.patch_surface(patch);
                let i = if a == nu { s.n_u - 1 } else { 0 };
                let j = if b == nv { s.n_v - 1 } else { 0 };
                // A clamped surface passes through the control points of its corners.
                let position = s.poles[i * s.n_v + j];
                self.vertices.push(self.brep.vertices.len());
                self.brep.vertices.push(position);
            }
        }
    }

    /// Edges along a direction.
    fn add_edges(&mut self, d: usize) {
        let (lines, count) = (self.lines(), self.patches.count());
        let mut edges = vec![None; lines[0] * lines[1]];
        for b in 0..lines[1].min(if d == 1 { count[1] } else { usize::MAX }) {
            for a in 0..lines[0].min(if d == 0 { count[0] } else { usize::MAX }) {
                if d == 0 && self.is_pole(b) {
                    continue;
                }
                // The patches on both sides: the line is the first side of one and the last of the other.
                let across = 1 - d;
                let line = [a, b][across];
                let closed = lines[across] == count[across];
                let mut sides = Vec::new();
                for (ahead, present, index) in [
                    (true, line < count[across], line),
                    (false, line > 0 || closed, (line + count[across] - 1) % count[across]),
                ] {
                    if present {
                        let mut patch = [a, b];
                        patch[across] = index;
                        sides.push((self.patches.level(patch), ahead, patch));
                    }
                }
                // The finer side; for equal levels, the patch that starts at the line.
                let Some(&(_, ahead, patch)) = sides.iter().max_by_key(|(level, ahead, _)| (*level, *ahead))
                else {
                    continue;
                };
                let mut curve = border_curve(self.patch_surface(patch), d, ahead);
                let next = if d == 0 { (a + 1, b) } else { (a, b + 1) };
                let [start, end] = [(a, b), next].map(|(a, b)| self.vertices[self.crossing(a, b)]);
                // Patches of different levels differ in the last digit, so ends are set to the shared
                // vertices.
                let last = curve.poles.len() - 1;
                curve.poles[0] = self.brep.vertices[start];
                curve.poles[last] = self.brep.vertices[end];
                edges[b * lines[0] + a] = Some(self.brep.edges.len());
                self.brep.edges.push(BrepEdge { curve, start, end });
            }
        }
        self.edges[d] = edges;
    }

    /// A face's edges, counter-clockwise seen from its outer side.
    fn face_loop(&self, [a, b]: [usize; 2], outward: bool) -> Vec<(usize, bool)> {
        let edge = |d: usize, a: usize, b: usize| self.edges[d][self.crossing(a, b)];
        let around = [
            (edge(0, a, b), true),
            (edge(1, a + 1, b), true),
            (edge(0, a, b + 1), false),
            (edge(1, a, b), false),
        ];
        // An edge along a pole would have no length: there is none, and the loop has fewer than four edges.
        let mut out: Vec<(usize, bool)> = around
            .into_iter()
            .filter_map(|(edge, forward)| edge.map(|edge| (edge, forward == outward)))
            .collect();
        if !outward {
            // Order and directions are both reversed: the loop then runs counter-clockwise about the opposite
            // normal.
            out.reverse();
        }
        out
    }
}

/// The first (`at_start`) or last border of a surface that runs along a direction.
fn border_curve(surface: &BsplineSurface, d: usize, at_start: bool) -> BsplineCurve {
    let (n_u, n_v) = (surface.n_u, surface.n_v);
    let poles = if d == 0 {
        let j = if at_start { 0 } else { n_v - 1 };
        (0..n_u).map(|i| surface.poles[i * n_v + j]).collect()
    } else {
        let i = if at_start { 0 } else { n_u - 1 };
        surface.poles[i * n_v..(i + 1) * n_v].to_vec()
    };
    let knots = if d == 0 { &surface.knots_u } else { &surface.knots_v };
    BsplineCurve { degree: 3, knots: knots.clone(), poles }
}

/// Turns the uniform coefficients of a cubic spline (`count` of them from `first` on, `stride` apart) into
/// those over clamped knots.
///
/// By blossoms, with knots 0, 1, … from the end on: `f(0,0,0) = (c0 + 4 c1 + c2)/6`,
/// `f(0,0,1) = (2 c1 + c2)/3`, and `f(0,1,2) = c2` as before.
fn clamp_ends(c: &mut [DVec3], first: usize, stride: usize, count: usize) {
    let at = |k: usize| first + k * stride;
    // All values are computed before any is written, because the two ends of a single span share
    // coefficients.
    let ends = [[0, 1, 2], [count - 1, count - 2, count - 3]].map(|[k0, k1, k2]| {
        let (c0, c1, c2) = (c[at(k0)], c[at(k1)], c[at(k2)]);
        [(k0, (c0 + 4.0 * c1 + c2) / 6.0), (k1, (2.0 * c1 + c2) / 3.0)]
    });
    for (k, value) in ends.into_iter().flatten() {
        c[at(k)] = value;
    }
}

/// Whether `S_u × S_v` of a closed surface points outward: `∫ (S − p)·(S_u × S_v) du dv > 0`.
fn encloses_positive_volume(surface: &Surface) -> bool {
    let space = surface.space();
    // About a point of the surface: far from the world's origin, large terms of both signs would cancel.
    let origin = surface.leaf_point(0, 0.5, 0.5);
    let mut volume = 0.0;
    for (leaf, cell) in space.leaves().iter().enumerate() {
        let area = cell.side() * cell.side();
        for q in quadrature() {
            let jet = surface.leaf_jet(leaf, q.local[0], q.local[1]);
            volume += area * q.weight * (jet.point - origin).dot(jet.du.cross(jet.dv));
        }
    }
    volume >= 0.0
}
