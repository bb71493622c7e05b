//! Faces over quads: rectangles, equality with the surface, and numbers of faces.

use super::super::brep_from_surface;
use super::super::rectangles::{Rectangle, rectangles};
use super::KnotLines;
use crate::export::BrepOptions;
use planish_core::DVec3;
use planish_exchange::step::{Brep, BsplineSurface};
use planish_spline::test_meshes::open_voxels;
use planish_spline::{Hierarchy, QuadDomain, Surface};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;

/// A mesh of quads with positions.
struct Quads {
    name: &'static str,
    domain: QuadDomain,
    positions: Vec<DVec3>,
}

impl Quads {
    fn new(name: &'static str, quads: &[[u32; 4]], positions: Vec<DVec3>, divisions: usize) -> Self {
        Self { name, domain: QuadDomain::new(quads).unwrap(), positions }.divided(divisions)
    }

    /// The same mesh with creases along some of its edges between faces in different planes.
    fn creased(self, name: &'static str, divisions: usize, is_chosen: impl Fn(DVec3, DVec3) -> bool) -> Self {
        let at = |v: u32| self.positions[v as usize];
        let normal = |q: u32| {
            let [a, b, c, _] = self.domain.cells()[q as usize].map(at);
            (b - a).cross(c - b)
        };
        let mut creases = Vec::new();
        for (q, quad) in (0..).zip(self.domain.cells()) {
            for k in 0..4 {
                let (other, _) = self.domain.neighbour(q, k).unwrap();
                let ends = [quad[k as usize], quad[(k as usize + 1) % 4]];
                if normal(q).dot(normal(other)) < 0.5 && is_chosen(at(ends[0]), at(ends[1])) {
                    creases.push(ends);
                }
            }
        }
        let domain = QuadDomain::with_creases(self.domain.cells(), &creases, &[]).unwrap();
        Self { name, domain, positions: self.positions }.divided(divisions)
    }

    fn divided(mut self, divisions: usize) -> Self {
        for _ in 0..divisions {
            let division = self.domain.divided().unwrap();
            self.positions = division.apply(&self.positions);
            self.domain = division.domain;
        }
        self.continue_beyond_borders();
        self
    }

    /// Mirrors inner vertices at the borders.
    fn continue_beyond_borders(&mut self) {
        if self.domain.borders() == 0 {
            return;
        }
        let space = Hierarchy::over(Arc::new(self.domain.clone())).unwrap();
        let anchors = &space.node_anchors()[self.positions.len()..];
        let is_border = |v: u32| {
            let beside = |quad: usize, k: usize| self.domain.neighbour(quad as u32, k as u32).is_none();
            let cells = self.domain.cells().iter().enumerate();
            cells
                .flat_map(|(q, c)| (0..4).map(move |k| (q, k, [c[k], c[(k + 1) % 4]])))
                .any(|(q, k, ends)| ends.contains(&v) && beside(q, k))
        };
        let beyond = anchors.iter().map(|&[u, v]| {
            let quad = (u as usize).min(self.domain.cells().len() - 1);
            let corners = self.domain.cells()[quad];
            let k = match [u - quad as f64 > 0.5, v > 0.5] {
                [false, false] => 0,
                [true, false] => 1,
                [true, true] => 2,
                [false, true] => 3,
            };
            let inner = [1, 3, 2].map(|step| corners[(k + step) % 4]).into_iter().find(|&v| !is_border(v));
            let [on, inner] = [corners[k], inner.unwrap_or(corners[(k + 2) % 4])].map(|v| v as usize);
            2.0 * self.positions[on] - self.positions[inner]
        });
        let beyond: Vec<DVec3> = beyond.collect();
        self.positions.extend(beyond);
    }

    /// The faces of unit cubes, without those that are open.
    fn voxels(
        name: &'static str,
        cubes: impl Iterator<Item = [i32; 3]>,
        is_open: impl Fn([i32; 3], usize) -> bool,
        divisions: usize,
    ) -> Self {
        let (quads, positions) = open_voxels(&cubes.collect::<Vec<_>>(), is_open);
        Self::new(name, &quads, positions, divisions)
    }

    /// A grid, closed along its columns and rows if the number of vertices is that of the quads.
    fn grid(name: &'static str, [columns, rows]: [u32; 2], closed: [bool; 2]) -> Self {
        let [width, height] = [columns + u32::from(!closed[0]), rows + u32::from(!closed[1])];
        let at = |i: u32, j: u32| j % height * width + i % width;
        let quads = (0..columns * rows).map(|k| (k % columns, k / columns));
        let quads: Vec<[u32; 4]> =
            quads.map(|(i, j)| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]).collect();
        let place = |k: u32| {
            let [a, b] = [f64::from(k % width) / f64::from(columns), f64::from(k / width) / f64::from(rows)];
            let [a, b] = [a, b].map(|x| x * std::f64::consts::TAU);
            let out = 3.0 + b.cos();
            match closed {
                [true, true] => DVec3::new(out * a.cos(), out * a.sin(), b.sin()),
                [true, false] => DVec3::new(a.cos(), a.sin(), b),
                _ => DVec3::new(a, b, 0.0),
            }
        };
        Self::new(name, &quads, (0..width * height).map(place).collect(), 0)
    }

    /// A surface whose control vertices are moved at random, with `rounds` of random splits.
    fn surface(&self, rounds: usize) -> Surface {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut shift = |size: f64| size * DVec3::from_array([0; 3].map(|_| random.random_range(-1.0..1.0)));
        let mut space = Hierarchy::over(Arc::new(self.domain.clone())).unwrap();
        let vertices = self.positions.iter().map(|p| *p + shift(0.05)).collect();
        let mut surface = Surface::new(space.into(), vertices).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(6);
        for _ in 0..rounds {
            let supports = surface.space().support_leaves();
            let marked = supports.iter().filter(|_| random.random_bool(0.03)).flatten();
            let marked: Vec<usize> = marked.map(|&leaf| leaf as usize).collect();
            space = surface.space().refine(&marked);
            surface = surface.refined(space.into()).unwrap();
            let vertices = surface.vertices().iter();
            let moved = vertices
                .map(|p| *p + 0.02 * DVec3::from_array([0; 3].map(|_| random.random_range(-1.0..1.0))));
            let moved = moved.collect();
            surface = surface.with_vertices(moved).unwrap();
        }
        surface
    }
}

/// Meshes of genus 0, 1 and 2, with borders, and of two bodies.
fn meshes() -> Vec<Quads> {
    let closed = |_, _| false;
    let cube = || (0..27).map(|k| [k % 3, k / 3 % 3, k / 9]);
    let plate = |k: i32| [k % 7, k / 7, 0];
    let ring = (0..9).filter(|&k| k != 4).map(|k| [k % 3, k / 3, 0]);
    let two_holes = (0..35).map(plate).filter(|c| c[1] != 2 || c[0] != 2 && c[0] != 4);
    // Two pipes that cross, open at their four ends.
    let along = |d: usize| {
        (0..32).map(move |k| {
            let mut cube = [k % 2, k / 2 % 2, k % 2];
            cube[d] = k / 4 - 3;
            cube[1 - d] = k / 2 % 2;
            cube
        })
    };
    let cross = along(0).chain(along(1));
    let at_end = |cube: [i32; 3], axis: usize| axis < 2 && (cube[axis] == -3 || cube[axis] == 4);
    let solid = |name, cubes: &mut dyn Iterator<Item = [i32; 3]>| Quads::voxels(name, cubes, closed, 0);
    let step = || (0..12).map(|k| [k % 3, k / 3 % 2, k / 6]).filter(|c| c[0] < 2 || c[2] == 0);
    let below = |a: DVec3, b: DVec3| a.z.max(b.z) < 1.5;
    let apart = cube().chain(cube().map(|c| [c[0] + 9, c[1], c[2]]));
    vec![
        Quads::voxels("cube", cube(), closed, 1),
        Quads::voxels("ring", ring, closed, 1),
        Quads::voxels("plate with two holes", two_holes, closed, 2),
        Quads::voxels("crossing pipes", cross, at_end, 0),
        Quads::voxels("two cubes", apart, closed, 1),
        Quads::grid("torus", [7, 5], [true, true]),
        Quads::grid("tube", [6, 4], [true, false]),
        Quads::grid("sheet", [5, 3], [false, false]),
        solid("", &mut cube()).creased("sharp cube", 0, |_, _| true),
        solid("", &mut step()).creased("step", 1, |_, _| true),
        // Creases end halfway up the vertical edges.
        solid("", &mut cube()).creased("half sharp cube", 1, below),
        solid("", &mut (0..9).filter(|&k| k != 4).map(|k| [k % 3, k / 3, 0])).creased(
            "sharp ring",
            1,
            |_, _| true,
        ),
    ]
}

/// Rectangles that are never divided for their control points.
fn partition(mesh: &Quads) -> Vec<Rectangle> {
    rectangles(&mesh.domain, |_| None)
}

#[test]
fn rectangles_cover_each_quad_once_and_touch_no_vertex_twice() {
    for mesh in meshes() {
        let all = partition(&mesh);
        let mut quads: Vec<u32> = all.iter().flat_map(|r| &r.bottoms).map(|bottom| bottom / 4).collect();
        quads.sort_unstable();
        assert_eq!(quads, (0..mesh.domain.cells().len() as u32).collect::<Vec<_>>(), "{}", mesh.name);
        for rectangle in &all {
            let around = (0..4).flat_map(|side| rectangle.vertices(&mesh.domain, side).split_off(1));
            let around: Vec<u32> = around.collect();
            let distinct: HashSet<u32> = around.iter().copied().collect();
            assert_eq!(distinct.len(), around.len(), "{}", mesh.name);
            // Extraordinary vertices are corners only: then all inner vertices are regular.
            let corners: Vec<u32> = (0..4).map(|side| rectangle.vertices(&mesh.domain, side)[0]).collect();
            let all = rectangle.bottoms.iter().flat_map(|&bottom| mesh.domain.cells()[bottom as usize / 4]);
            for vertex in all.filter(|v| mesh.domain.valence(*v) != 4) {
                assert!(corners.contains(&vertex), "{}: vertex {vertex}", mesh.name);
            }
            // Creases are on the boundary only.
            for (k, &bottom) in rectangle.bottoms.iter().enumerate() {
                let quad = mesh.domain.cells()[bottom as usize / 4];
                let [right, top] = [1, 2].map(|side| {
                    let k = (bottom as usize + side) % 4;
                    mesh.domain.is_crease([quad[k], quad[(k + 1) % 4]])
                });
                let [column, row] = [k % rectangle.columns, k / rectangle.columns];
                assert!(!right || column + 1 == rectangle.columns, "{}: column {column}", mesh.name);
                assert!(!top || row + 1 == rectangle.rows(), "{}: row {row}", mesh.name);
            }
        }
    }
}

#[test]
fn rectangles_are_few() {
    let count = |mesh: &Quads| partition(mesh).len();
    let found: Vec<usize> = meshes().iter().map(count).collect();
    println!("{found:?} of {:?}", meshes().iter().map(|m| m.domain.cells().len()).collect::<Vec<_>>());
    for (mesh, found) in meshes().iter().zip(&found) {
        // Each line from an extraordinary vertex ends at a new corner of two rectangles at most.
        let cells = mesh.domain.cells().iter().enumerate();
        let special = cells.flat_map(|(q, quad)| {
            (0..4).filter(move |&k| mesh.domain.is_extraordinary_corner(q, k)).map(move |k| quad[k])
        });
        let special: BTreeSet<u32> = special.chain(mesh.domain.extraordinary_vertices()).collect();
        let corners: usize = special.iter().map(|&v| mesh.domain.valence(v)).sum();
        let bound = (3 * corners).div_ceil(4) + 4;
        assert!(*found <= bound, "{}: {found} of at most {bound}", mesh.name);
    }
    // A cube has its six sides; a torus is cut twice in each direction; a sheet is one.
    assert_eq!([found[0], found[4], found[5], found[6], found[7]], [6, 12, 4, 2, 1]);
    assert_eq!(found[8], 6);
}

/// Weights of four control points, by the algorithm of de Boor.
fn spline_point(knots: &[(f64, usize)], poles: &[DVec3], t: f64) -> DVec3 {
    let knots: Vec<f64> = knots.iter().flat_map(|&(knot, times)| std::iter::repeat_n(knot, times)).collect();
    let span = (3..poles.len()).rev().find(|&k| knots[k] <= t && knots[k] < knots[k + 1]).unwrap_or(3);
    let mut d: [DVec3; 4] = std::array::from_fn(|k| poles[span - 3 + k]);
    for r in 1..=3 {
        for k in (r..=3).rev() {
            let (low, high) = (knots[span - 3 + k], knots[span + 1 + k - r]);
            d[k] = d[k - 1].lerp(d[k], (t - low) / (high - low));
        }
    }
    d[3]
}

fn surface_point(surface: &BsplineSurface, [u, v]: [f64; 2]) -> DVec3 {
    let rows = surface.poles.chunks(surface.n_v).map(|row| spline_point(&surface.knots_v, row, v));
    spline_point(&surface.knots_u, &rows.collect::<Vec<_>>(), u)
}

/// Points of a quad, in the coordinates of a rectangle and in those of the surface.
fn places(rectangle: &Rectangle) -> Vec<([f64; 2], [f64; 2])> {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut made = Vec::new();
    for (k, &bottom) in rectangle.bottoms.iter().enumerate() {
        for _ in 0..8 {
            let [s, t]: [f64; 2] = [random.random(), random.random()];
            let [x, y] = [[s, t], [1.0 - t, s], [1.0 - s, 1.0 - t], [t, 1.0 - s]][(bottom % 4) as usize];
            let from = [k % rectangle.columns, k / rectangle.columns].map(|n| n as f64);
            made.push(([from[0] + s, from[1] + t], [f64::from(bottom / 4) + x, y]));
        }
    }
    made
}

fn point_count(brep: &Brep) -> usize {
    brep.faces.iter().map(|face| face.surface.poles.len()).sum()
}

#[test]
fn faces_equal_the_surface_and_are_bounded_by_their_edges() {
    for mesh in meshes() {
        for rounds in [0, 2] {
            let surface = mesh.surface(rounds);
            let lines = KnotLines::new(surface.space(), &mesh.domain);
            let all = rectangles(&mesh.domain, |rectangle| lines.division(rectangle));
            let brep = brep_from_surface(&surface, &BrepOptions::default());
            brep.check(1e-9).unwrap();
            assert_eq!((brep.faces.len(), brep.closed), (all.len(), mesh.domain.borders() == 0));
            let mut largest = 0.0_f64;
            for (face, rectangle) in brep.faces.iter().zip(&all) {
                for (at, [u, v]) in places(rectangle) {
                    largest = largest.max(surface_point(&face.surface, at).distance(surface.point(u, v)));
                }
                let [last_u, last_v] = rectangle.size().map(|n| n as f64);
                for &(edge, _) in &face.edges {
                    let curve = &brep.edges[edge].curve;
                    // Curves run along the parameters of one of their faces, so any side may fit.
                    let [from, to] = [curve.knots[0].0, curve.knots[curve.knots.len() - 1].0];
                    let p = spline_point(&curve.knots, &curve.poles, 0.3 * from + 0.7 * to);
                    let steps = (0..=(last_u.max(last_v) * 10.0) as usize).map(|k| 0.1 * k as f64);
                    let sides = steps.flat_map(|x| [[x, 0.0], [x, last_v], [0.0, x], [last_u, x]]);
                    let inside = sides.filter(|at| at[0] <= last_u + 1e-9 && at[1] <= last_v + 1e-9);
                    let nearest = inside
                        .map(|at| {
                            surface_point(&face.surface, [at[0].min(last_u), at[1].min(last_v)]).distance(p)
                        })
                        .fold(f64::INFINITY, f64::min);
                    largest = largest.max(nearest);
                }
            }
            println!(
                "{} {rounds}: {} faces, {} points, {largest:.1e}",
                mesh.name,
                all.len(),
                point_count(&brep)
            );
            assert!(largest < 1e-9, "{} after {rounds} splits: {largest}", mesh.name);
        }
    }
}

#[test]
fn numbers_of_vertices_edges_and_faces_match_the_topology() {
    for mesh in meshes() {
        let brep = brep_from_surface(&mesh.surface(2), &BrepOptions::default());
        let [v, e, f] = [brep.vertices.len(), brep.edges.len(), brep.faces.len()].map(|n| n as i64);
        let domain = &mesh.domain;
        let expected = 2 * (domain.components() as i64 - domain.genus() as i64) - domain.borders() as i64;
        assert_eq!(v - e + f, expected, "{}", mesh.name);
        assert_eq!(brep.shells().len(), domain.components(), "{}", mesh.name);
    }
}

/// Fine leaves on a diagonal would put fine knots across all of a large face.
#[test]
fn faces_with_few_fine_leaves_are_divided() {
    let sheet = Quads::grid("sheet", [16, 16], [false, false]);
    let mut surface = sheet.surface(0);
    for _ in 0..4 {
        let space = surface.space();
        let on_diagonal = |k: &usize| {
            let cell = space.leaves()[*k];
            let quad = cell.i >> cell.level;
            quad % 16 == quad / 16
        };
        let marked: Vec<usize> = (0..space.leaves().len()).filter(on_diagonal).collect();
        surface = surface.refined(space.refine(&marked).into()).unwrap();
    }
    let brep = brep_from_surface(&surface, &BrepOptions::default());
    brep.check(1e-9).unwrap();
    let lines = KnotLines::new(surface.space(), &sheet.domain);
    let whole = partition(&sheet);
    let [points, undivided] = [point_count(&brep), lines.control_points(&whole[0])];
    assert_eq!(whole.len(), 1);
    assert!(brep.faces.len() > 1 && 2 * points < undivided, "{} faces, {points} points", brep.faces.len());
}

#[test]
fn large_faces_need_at_most_twice_the_points_of_small_ones() {
    for mesh in meshes() {
        let surface = mesh.surface(3);
        let lines = KnotLines::new(surface.space(), &mesh.domain);
        let quads = (0..mesh.domain.cells().len() as u32).map(|quad| 4 * quad);
        let alone =
            quads.map(|bottom| lines.control_points(&Rectangle { columns: 1, bottoms: vec![bottom] }));
        let brep = brep_from_surface(&surface, &BrepOptions::default());
        assert!(point_count(&brep) <= 2 * alone.sum::<usize>(), "{}", mesh.name);
    }
}
