//! Laws of the domain and its splines.

use super::*;
use crate::hierarchy::{Hierarchy, Shape};
use crate::surface::{Jet, Surface, jet_of, leaf_weights};
use nalgebra::{DMatrix, SymmetricEigen};
use planish_core::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::sync::Arc;

/// A grid of quads, with vertex `j · columns + i` at (i, j).
fn grid(columns: usize, rows: usize, periodic: bool) -> Vec<[u32; 4]> {
    let (width, height) = if periodic { (columns, rows) } else { (columns + 1, rows + 1) };
    let at = |i: usize, j: usize| (j % height * width + i % width) as u32;
    let cell = |k: usize| (k % columns, k / columns);
    (0..columns * rows)
        .map(cell)
        .map(|(i, j)| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)])
        .collect()
}

/// The faces of a set of unit cubes, and the positions of their vertices.
fn voxels(cubes: &[[i32; 3]]) -> (Vec<[u32; 4]>, Vec<DVec3>) {
    let all: BTreeSet<[i32; 3]> = cubes.iter().copied().collect();
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let mut quads = Vec::new();
    for &cube in &all {
        for axis in 0..3 {
            for side in [0, 1] {
                let mut beyond = cube;
                beyond[axis] += 2 * side - 1;
                if all.contains(&beyond) {
                    continue;
                }
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let mut turns = [[0, 0], [1, 0], [1, 1], [0, 1]];
                if side == 0 {
                    turns.reverse();
                }
                quads.push(turns.map(|[p, q]| {
                    let mut corner = cube;
                    corner[axis] += side;
                    corner[b] += p;
                    corner[c] += q;
                    let next = numbers.len() as u32;
                    *numbers.entry(corner).or_insert(next)
                }));
            }
        }
    }
    let mut positions = vec![DVec3::ZERO; numbers.len()];
    for (corner, number) in numbers {
        positions[number as usize] = DVec3::from_array(corner.map(f64::from));
    }
    (quads, positions)
}

/// A plate with two holes.
fn two_holes() -> (Vec<[u32; 4]>, Vec<DVec3>) {
    let cubes = (0..15).map(|k| [k % 5, k / 5, 0]).filter(|c| c[1] != 1 || c[0] % 2 == 0);
    voxels(&cubes.collect::<Vec<_>>())
}

/// A domain whose cells have at most one corner without four quads, and random control vertices near smooth
/// ones.
fn divided(quads: &[[u32; 4]], positions: &[DVec3], noise: f64) -> (QuadSpace, Vec<DVec3>) {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let first = QuadDomain::new(quads).unwrap().divided().unwrap();
    let mut vertices = first.apply(positions);
    for v in &mut vertices {
        *v += noise * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
    }
    (QuadSpace::new(Arc::new(first.domain)).unwrap(), vertices)
}

fn jet(space: &QuadSpace, vertices: &[DVec3], cell: u32, at: [f64; 2]) -> Jet {
    let (leaf, [s, t]) = space.locate(cell, at);
    jet_of(&space.leaf_coefficients(vertices, leaf), 1.0 / space.leaves()[leaf].side, s, t)
}

/// Place `t` of the way along side `k` of a cell.
fn on_side(k: u32, t: f64) -> [f64; 2] {
    match k {
        0 => [t, 0.0],
        1 => [1.0, t],
        2 => [1.0 - t, 1.0],
        _ => [0.0, 1.0 - t],
    }
}

#[test]
fn components_borders_and_genus_are_counted() {
    let count = |quads: &[[u32; 4]]| {
        let domain = QuadDomain::new(quads).unwrap();
        (domain.components(), domain.borders(), domain.genus())
    };
    assert_eq!(count(&grid(3, 4, false)), (1, 1, 0));
    assert_eq!(count(&grid(4, 5, true)), (1, 0, 1));
    assert_eq!(count(&two_holes().0), (1, 0, 2));
    let (two, _) = voxels(&[[0, 0, 0], [2, 0, 0]]);
    assert_eq!(count(&two), (2, 0, 0));
    // A plate with a hole is an annulus on each side: without its walls there are two, with two borders each.
    let annulus: Vec<_> = grid(3, 3, false).into_iter().enumerate().filter(|(k, _)| *k != 4).collect();
    assert_eq!(count(&annulus.into_iter().map(|(_, quad)| quad).collect::<Vec<_>>()), (1, 2, 0));
}

#[test]
fn defects_are_named() {
    let message = |quads: &[[u32; 4]]| QuadDomain::new(quads).unwrap_err().to_string();
    assert!(message(&[[0, 1, 1, 2]]).contains("quad 0 has corner 1 twice"));
    assert!(message(&[[0, 1, 2, 3], [0, 1, 4, 5]]).contains("quads 0 and 1 both have the edge"));
    assert!(message(&[[0, 1, 2, 4]]).contains("vertex 3 has no quad"));
    assert!(message(&[[0, 1, 2, 3], [2, 4, 5, 6]]).contains("at vertex 2 several fans"));
    let corners = QuadDomain::new(&two_holes().0).unwrap();
    let error = QuadSpace::new(Arc::new(corners)).unwrap_err().to_string();
    assert!(error.contains("divide the domain once"), "{error}");
}

/// Over grids the splines are the uniform ones, control vertices beyond borders included.
#[test]
fn grids_have_uniform_splines() {
    let f = |u: f64, v: f64| DVec3::new(u.sin(), (1.3 * v).cos(), (0.7 * u * v).sin());
    let tau = std::f64::consts::TAU;
    let periodic = |u: f64, v: f64| {
        let (a, b) = (tau * u / 6.0, tau * v / 5.0);
        DVec3::new(a.sin(), b.cos(), (a + b).sin())
    };
    for closed in [false, true] {
        let size = if closed { [6, 5] } else { [4, 3] };
        let value = |u: f64, v: f64| if closed { periodic(u, v) } else { f(u, v) };
        let space =
            QuadSpace::new(Arc::new(QuadDomain::new(&grid(size[0], size[1], closed)).unwrap())).unwrap();
        let mut vertices = vec![None; space.domain().vertex_count()];
        for (cell, leaf) in space.leaves().iter().enumerate() {
            let (nodes, _) = space.extraction(cell);
            assert_eq!((leaf.cell as usize, nodes.len()), (cell, 16));
            for (k, &node) in nodes.iter().enumerate() {
                let [i, j] = [cell % size[0] + k % 4, cell / size[0] + k / 4].map(|x| x as f64 - 1.0);
                let p = *vertices[node as usize].get_or_insert(value(i, j));
                assert!(p.distance(value(i, j)) < 1e-12, "node {node} has two places");
            }
        }
        let vertices: Vec<DVec3> = vertices.into_iter().map(Option::unwrap).collect();
        let shape = if closed { Shape::Torus } else { Shape::Sheet };
        let uniform = Arc::new(Hierarchy::uniform(shape, size).unwrap());
        let known = uniform.node_anchors().iter().map(|a| value(a[0], a[1])).collect();
        let known = Surface::new(uniform, known).unwrap();
        for (cell, [s, t]) in [(0, [0.2, 0.9]), (5, [0.0, 0.4]), (11, [1.0, 0.5])] {
            let found = space.point(&vertices, cell, [s, t]);
            let [i, j] = [cell as usize % size[0], cell as usize / size[0]].map(|x| x as f64);
            assert!(found.distance(known.point(i + s, j + t)) < 1e-12, "{found:?}");
        }
    }
}

#[test]
fn weights_sum_to_one_and_are_hardly_negative() {
    for valence in [3, 5, 6, 7, 8, 12] {
        let leaves = extraordinary::leaf_weights_around(valence);
        // The basis functions at a grid of places on each leaf.
        let mut least = f64::INFINITY;
        for leaf in &leaves {
            for at in 0..25 {
                let values = leaf_weights(f64::from(at % 5) / 4.0, f64::from(at / 5) / 4.0);
                let of = |w: &[f64; 16]| w.iter().zip(values).map(|(w, b)| w * b).sum::<f64>();
                let functions: Vec<f64> = leaf.iter().map(of).collect();
                assert!((functions.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                least = functions.into_iter().fold(least, f64::min);
            }
        }
        assert!(least > -1.5e-3, "valence {valence}: {least}");
    }
}

/// Points and normals agree across all edges, with control vertices far from smooth ones.
#[test]
fn normals_are_continuous() {
    let fan = |n: u32| -> Vec<[u32; 4]> {
        (0..n).map(|k| [0, 1 + 2 * k, 2 + 2 * k, 1 + (2 * k + 2) % (2 * n)]).collect()
    };
    let mut cases = vec![two_holes(), voxels(&[[0, 0, 0]])];
    for n in [6, 7, 8] {
        let spoke = |k: u32, n: u32| {
            let angle = std::f64::consts::PI * f64::from(k) / f64::from(n);
            DVec3::new(angle.cos(), angle.sin(), 0.0)
        };
        let positions = (0..2 * n).map(|k| spoke(k, n));
        let inner = QuadDomain::new(&fan(n)).unwrap();
        let mut all: Vec<DVec3> = std::iter::once(DVec3::ZERO).chain(positions).collect();
        all.resize(inner.vertex_count(), DVec3::new(2.0, 2.0, 1.0));
        cases.push((fan(n), all));
    }
    for (quads, positions) in cases {
        let (space, vertices) = divided(&quads, &positions, 0.2);
        let edges = space.domain().edges();
        let cells = space.domain().cells().len() as u32;
        for h in 0..4 * cells {
            let Some(o) = edges.opposite(h).filter(|&o| o / 4 < cells && o > h) else { continue };
            for step in 0..=16 {
                let t = f64::from(step) / 16.0;
                let a = jet(&space, &vertices, h / 4, on_side(h % 4, t));
                let b = jet(&space, &vertices, o / 4, on_side(o % 4, 1.0 - t));
                let distance = a.point.distance(b.point);
                assert!(distance < 1e-12, "half edge {h} at {t}: {distance:.1e}");
                let [m, n] = [&a, &b].map(|jet| jet.normal().unwrap());
                assert!(m.cross(n).length() < 1e-10 && m.dot(n) > 0.0, "half edge {h} at {t}: {m:?}, {n:?}");
            }
        }
        for cell in 0..cells {
            for step in 1..4 {
                let (x, e) = (f64::from(step) / 4.0, 1e-12);
                for [at, to] in [[[x - e, 0.3], [x + e, 0.3]], [[0.6, x - e], [0.6, x + e]]] {
                    let [a, b] = [at, to].map(|at| jet(&space, &vertices, cell, at));
                    assert!(a.point.distance(b.point) < 1e-10 && a.du.distance(b.du) < 1e-8);
                    assert!(a.dv.distance(b.dv) < 1e-8);
                }
            }
        }
    }
}

/// The Gram matrix is regular: no function is a combination of others.
#[test]
fn functions_are_independent() {
    let (quads, positions) = two_holes();
    let (space, _) = divided(&quads, &positions, 0.0);
    let n = space.domain().vertex_count();
    let mut gram = DMatrix::<f64>::zeros(n, n);
    for (leaf, QuadLeaf { side, .. }) in space.leaves().iter().enumerate() {
        let (nodes, weights) = space.extraction(leaf);
        for at in 0..16 {
            let values = leaf_weights((f64::from(at % 4) + 0.5) / 4.0, (f64::from(at / 4) + 0.5) / 4.0);
            let functions: Vec<f64> =
                weights.iter().map(|w| w.iter().zip(values).map(|(w, b)| w * b).sum()).collect();
            for (i, a) in nodes.iter().zip(&functions) {
                for (j, b) in nodes.iter().zip(&functions) {
                    gram[(*i as usize, *j as usize)] += side * side / 16.0 * a * b;
                }
            }
        }
    }
    let values = SymmetricEigen::new(gram).eigenvalues;
    // Uniform bicubic splines have a condition of about 400.
    assert!(values.max() / values.min() < 4000.0, "{} to {}", values.min(), values.max());
}

/// Division keeps surfaces of uniform splines, and changes others less the finer they are.
#[test]
fn division_keeps_the_surface() {
    let change = |coarse: &QuadSpace, vertices: &[DVec3]| -> f64 {
        let division = coarse.domain().divided().unwrap();
        let finer_vertices = division.apply(vertices);
        let finer = QuadSpace::new(Arc::new(division.domain)).unwrap();
        let mut largest = 0.0_f64;
        for cell in 0..coarse.domain().cells().len() as u32 {
            for (k, offset) in [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]].into_iter().enumerate() {
                for at in 0..9 {
                    let [s, t] = [f64::from(at % 3) / 2.0, f64::from(at / 3) / 2.0];
                    let coarse_at = [offset[0] + 0.5 * s, offset[1] + 0.5 * t];
                    let a = coarse.point(vertices, cell, coarse_at);
                    let b = finer.point(&finer_vertices, 4 * cell + k as u32, [s, t]);
                    largest = largest.max(a.distance(b));
                }
            }
        }
        largest
    };
    for closed in [false, true] {
        let domain = QuadDomain::new(&grid(5, 4, closed)).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let vertices: Vec<DVec3> = (0..domain.vertex_count())
            .map(|_| DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0))))
            .collect();
        assert!(change(&QuadSpace::new(Arc::new(domain)).unwrap(), &vertices) < 1e-13);
    }
    let (quads, positions) = two_holes();
    let (space, vertices) = divided(&quads, &positions, 0.0);
    let first = change(&space, &vertices);
    let division = space.domain().divided().unwrap();
    let finer_vertices = division.apply(&vertices);
    let second = change(&QuadSpace::new(Arc::new(division.domain)).unwrap(), &finer_vertices);
    println!("change by division: {first:.2e} of an edge, then {second:.2e}");
    assert!(first < 0.02 && second < 0.6 * first, "{first}, {second}");
}

/// Interpolation of a sphere from a cube: the error of the radius falls with the size of the cells.
#[test]
fn errors_fall_with_the_size_of_the_cells() {
    let (quads, positions) = voxels(&[[0, 0, 0]]);
    let on_sphere = |p: DVec3| (p - DVec3::splat(0.5)).normalize_or_zero();
    let mut division = QuadDomain::new(&quads).unwrap().divided().unwrap();
    let mut vertices: Vec<DVec3> = division.apply(&positions).into_iter().map(on_sphere).collect();
    let mut errors = Vec::new();
    for _ in 0..4 {
        let space = QuadSpace::new(Arc::new(division.domain)).unwrap();
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        for _ in 0..40 {
            let mut moved = vertices.clone();
            for (cell, quad) in (0..).zip(space.domain().cells()) {
                for (k, at) in corners.into_iter().enumerate() {
                    let p = space.point(&vertices, cell, at);
                    let v = quad[k] as usize;
                    moved[v] = vertices[v] + (1.0 / p.length() - 1.0) * p;
                }
            }
            vertices = moved;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for cell in 0..space.domain().cells().len() as u32 {
            for at in 0..64 {
                let at = [at % 8, at / 8].map(|k| (f64::from(k) + 0.5) / 8.0);
                sum += (space.point(&vertices, cell, at).length() - 1.0).powi(2);
                count += 1.0;
            }
        }
        errors.push((sum / count).sqrt());
        division = space.domain().divided().unwrap();
        vertices = division.apply(&vertices);
    }
    println!("rms error of the radius: {errors:?}");
    assert!(errors.windows(2).all(|pair| pair[1] < 0.25 * pair[0]), "{errors:?}");
}
