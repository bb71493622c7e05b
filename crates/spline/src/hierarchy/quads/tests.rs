//! Laws of hierarchies over domains of quads.

mod creases;

use super::*;
use crate::foot::{FootPointSearch, ProjectionOptions};
use crate::quad_domain::test_meshes::{grid, two_holes, voxels};
use crate::surface::{Surface, leaf_weights as basis_values};
use nalgebra::{DMatrix, SymmetricEigen};
use planish_core::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

/// A domain that is divided once, and its control vertices, displaced at random.
fn divided(quads: &[[u32; 4]], positions: &[DVec3], noise: f64) -> Surface {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let division = QuadDomain::new(quads).unwrap().divided().unwrap();
    let mut vertices = division.apply(positions);
    for v in &mut vertices {
        *v += noise * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
    }
    over(division.domain, &vertices)
}

/// A surface over an unrefined domain, with a position for each of its vertices.
fn over(domain: QuadDomain, positions: &[DVec3]) -> Surface {
    let space = Hierarchy::over(Arc::new(domain)).unwrap();
    let mut vertices = vec![DVec3::ZERO; space.node_count()];
    for (&vertex, &node) in &space.quads().unwrap().nodes[0] {
        vertices[node as usize] = positions[vertex];
    }
    Surface::new(space.into(), vertices).unwrap()
}

/// Splits the leaves of some functions chosen at random, several times.
fn refined_at_random(space: &Hierarchy, rounds: usize, seed: u64) -> Hierarchy {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut made = space.clone();
    for _ in 0..rounds {
        let supports = made.support_leaves();
        let chosen = &supports[rng.random_range(0..supports.len())];
        made = made.refine(&chosen.iter().map(|&leaf| leaf as usize).collect::<Vec<_>>());
    }
    made
}

/// Place `t` of the way along side `k` of a quad, a little inside of it.
fn on_side(quad: u32, k: u32, t: f64) -> [f64; 2] {
    let [x, y] = match k {
        0 => [t, 0.0],
        1 => [1.0, t],
        2 => [1.0 - t, 1.0],
        _ => [0.0, 1.0 - t],
    };
    in_quad(quad, [x, y])
}

/// Over grids, hierarchies are those of sheets and tori: the same functions on the same leaves.
#[test]
fn grids_have_the_hierarchies_of_sheets_and_tori() {
    // The nodes are numbered otherwise, so each is known by its weights on all leaves.
    let signatures = |space: &Hierarchy, place: &dyn Fn([f64; 2]) -> [i64; 2]| {
        let mut of_node = vec![BTreeMap::new(); space.node_count()];
        for leaf in 0..space.leaves().len() {
            let middle = place(space.parameters(leaf, [0.5, 0.5]));
            let (nodes, weights) = space.extraction(leaf);
            for (&node, own) in nodes.iter().zip(weights) {
                of_node[node as usize].insert(middle, own.map(|w| (w * 1e9).round() as i64));
            }
        }
        of_node.sort_unstable();
        of_node
    };
    let rounded = |[u, v]: [f64; 2]| [u, v].map(|x| (x * 4096.0).round() as i64);
    for closed in [false, true] {
        let [columns, rows] = [6, 5];
        let in_grid = |[u, v]: [f64; 2]| {
            let quad = u.floor() as usize;
            [u.fract() + (quad % columns) as f64, v + (quad / columns) as f64]
        };
        let shape = if closed { super::super::Shape::Torus } else { super::super::Shape::Sheet };
        let quads = Arc::new(QuadDomain::new(&grid(columns, rows, closed)).unwrap());
        for seed in 0..4 {
            let space = refined_at_random(&Hierarchy::over(Arc::clone(&quads)).unwrap(), 3, seed);
            let cells = space.leaves().iter().map(|cell| {
                let side = cell.side();
                let [u, v] = in_grid([f64::from(cell.i) * side, f64::from(cell.j) * side]);
                Cell { level: cell.level, i: (u / side).round() as u32, j: (v / side).round() as u32 }
            });
            let uniform = Hierarchy::from_leaves(shape, [columns, rows], &cells.collect::<Vec<_>>()).unwrap();
            assert_eq!(space.node_count(), uniform.node_count());
            let own = signatures(&space, &|at| rounded(in_grid(at)));
            assert_eq!(own, signatures(&uniform, &rounded), "closed: {closed}, seed {seed}");
        }
    }
}

#[test]
fn refined_hierarchies_are_sound() {
    let (quads, positions) = two_holes();
    let surface = divided(&quads, &positions, 0.0);
    for seed in 0..5 {
        let space = refined_at_random(surface.space(), 4, seed);
        assert!(space.levels() > 3, "leaves at extraordinary vertices are two levels below their cells");
        space.sanity_check().unwrap();
        for (leaf, cell) in space.leaves().iter().enumerate() {
            let at = space.parameters(leaf, [0.25, 0.75]);
            assert_eq!(space.locate(at[0], at[1]).0, leaf);
            assert_eq!(space.leaf_over(*cell), Some(leaf));
            let child = Cell { level: cell.level + 1, i: 2 * cell.i + 1, j: 2 * cell.j };
            assert_eq!(space.leaf_over(child), Some(leaf));
            assert_eq!(space.leaf_over(Cell { level: 0, i: at[0] as u32, j: 0 }).is_some(), cell.level == 0);
        }
        assert_eq!(space.unrefined().leaves(), surface.space().leaves());
        let domain = || Arc::clone(space.domain().unwrap());
        let rebuilt = Hierarchy::over_leaves(domain(), space.leaves()).unwrap();
        assert_eq!(rebuilt.leaves(), space.leaves());
        assert_eq!(rebuilt.node_count(), space.node_count());
        assert!(Hierarchy::over_leaves(domain(), &space.leaves()[1..]).is_err());
    }
}

/// Points and normals agree across all edges and inside of quads, on refined hierarchies with control
/// vertices far from smooth ones.
#[test]
fn normals_are_continuous() {
    let mut cases: Vec<Surface> =
        [two_holes(), voxels(&[[0, 0, 0]])].iter().map(|(quads, at)| divided(quads, at, 0.2)).collect();
    for n in [6, 7, 8] {
        let quads: Vec<[u32; 4]> =
            (0..n).map(|k| [0, 1 + 2 * k, 2 + 2 * k, 1 + (2 * k + 2) % (2 * n)]).collect();
        let spoke = |k: u32| {
            let angle = std::f64::consts::PI * f64::from(k) / f64::from(n);
            DVec3::new(angle.cos(), angle.sin(), 0.0)
        };
        let mut all: Vec<DVec3> = std::iter::once(DVec3::ZERO).chain((0..2 * n).map(spoke)).collect();
        all.resize(QuadDomain::new(&quads).unwrap().vertex_count(), DVec3::new(2.0, 2.0, 1.0));
        cases.push(divided(&quads, &all, 0.2));
    }
    for (case, coarse) in cases.iter().enumerate() {
        let fine = refined_at_random(coarse.space(), 3, case as u64);
        let domain = Arc::clone(fine.domain().unwrap());
        for surface in [coarse.clone(), coarse.refined(fine.into()).unwrap()] {
            let agree = |at: [f64; 2], to: [f64; 2]| {
                let [a, b] = [at, to].map(|[u, v]| surface.jet(u, v));
                let distance = a.point.distance(b.point);
                assert!(distance < 1e-10, "case {case}, {at:?} and {to:?}: {distance:.1e}");
                let [m, n] = [&a, &b].map(|jet| jet.normal().unwrap());
                assert!(m.cross(n).length() < 1e-8 && m.dot(n) > 0.0, "{at:?}, {to:?}: {m:?}, {n:?}");
            };
            for quad in 0..domain.cells().len() as u32 {
                for step in 0..=32 {
                    let t = f64::from(step) / 32.0;
                    for side in 0..4 {
                        let place = on_side(0, side, t);
                        let Some((next, to, _)) = domain.across(quad, side, place, 1.0) else { continue };
                        if (next as usize) < domain.cells().len() {
                            agree(in_quad(quad, place), in_quad(next, to.map(|x| x.clamp(0.0, 1.0))));
                        }
                    }
                    // Across leaves inside of the quad.
                    let (x, e) = (f64::from(step.clamp(1, 31)) / 32.0, 1e-12);
                    agree(in_quad(quad, [x - e, 0.3]), in_quad(quad, [x + e, 0.3]));
                    agree(in_quad(quad, [0.61, x - e]), in_quad(quad, [0.61, x + e]));
                }
            }
        }
    }
}

/// Refinement keeps the surface, except at extraordinary vertices that are split.
#[test]
fn refinement_keeps_the_surface() {
    let (quads, positions) = two_holes();
    let coarse = divided(&quads, &positions, 0.05);
    let coarse = coarse.refined(coarse.space().refine_all().into()).unwrap();
    // Splitting everything keeps all cells that are regular on the coarser level.
    let fine = coarse.refined(coarse.space().refine_all().into()).unwrap();
    let domain = coarse.space().domain().unwrap();
    let (mut kept, mut changed) = (0.0_f64, 0.0_f64);
    for quad in 0..domain.cells().len() as u32 {
        for k in 0..256 {
            let at = [k % 16, k / 16].map(|x| (f64::from(x) + 0.5) / 16.0);
            let cell = LevelCell { quad, at: at.map(|x| (2.0 * x) as i64) };
            let [u, v] = in_quad(quad, at);
            let distance = coarse.point(u, v).distance(fine.point(u, v));
            match Level::new(domain, 1).extraordinary_corner(cell) {
                None => kept = kept.max(distance),
                Some(_) => changed = changed.max(distance),
            }
        }
    }
    println!("change of regular cells {kept:.1e}, of others {changed:.1e} of an edge");
    assert!(kept < 1e-13 && changed < 0.02, "{kept}, {changed}");
}

/// The condition of the Gram matrix of functions that are scaled to the same norm.
fn gram_condition(space: &Hierarchy) -> f64 {
    let n = space.node_count();
    let mut gram = DMatrix::<f64>::zeros(n, n);
    for (leaf, cell) in space.leaves().iter().enumerate() {
        let (nodes, weights) = space.extraction(leaf);
        for at in 0..16 {
            let values = basis_values((f64::from(at % 4) + 0.5) / 4.0, (f64::from(at / 4) + 0.5) / 4.0);
            let functions: Vec<f64> =
                weights.iter().map(|w| w.iter().zip(values).map(|(w, b)| w * b).sum()).collect();
            for (i, a) in nodes.iter().zip(&functions) {
                for (j, b) in nodes.iter().zip(&functions) {
                    gram[(*i as usize, *j as usize)] += cell.side().powi(2) / 16.0 * a * b;
                }
            }
        }
    }
    // Functions of finer levels have smaller squares.
    let scale: Vec<f64> = gram.diagonal().iter().map(|x| x.sqrt().recip()).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| scale[i] * gram[(i, j)] * scale[j]);
    let values = SymmetricEigen::new(scaled).eigenvalues;
    values.max() / values.min()
}

/// The Gram matrix is regular: no function is a combination of others.
#[test]
fn functions_are_independent() {
    let (quads, positions) = two_holes();
    let surface = divided(&quads, &positions, 0.0);
    for rounds in [0, 2] {
        let space = refined_at_random(surface.space(), rounds, 5);
        let condition = gram_condition(&space);
        println!("{} functions: condition {condition:.0}", space.node_count());
        // A dependent function would have an eigenvalue of zero, or a negative one.
        assert!(condition > 0.0 && condition < 4000.0, "{condition}");
    }
}

/// A unit sphere over the faces of a cube, divided several times: control vertices by interpolation.
fn sphere(divisions: usize) -> Surface {
    let (quads, positions) = voxels(&[[0, 0, 0]]);
    let mut surface = divided(&quads, &positions, 0.0);
    for _ in 1..divisions {
        surface = surface.refined(surface.space().refine_all().into()).unwrap();
    }
    let centred = |p: &DVec3| (*p - DVec3::splat(0.5)).normalize_or_zero();
    surface = surface.with_vertices(surface.vertices().iter().map(centred).collect()).unwrap();
    let anchors = surface.space().node_anchors().to_vec();
    for _ in 0..40 {
        let moved = surface.vertices().iter().zip(&anchors).map(|(v, &[a, b])| {
            let p = surface.point(a, b);
            *v + (1.0 / p.length() - 1.0) * p
        });
        surface = surface.with_vertices(moved.collect()).unwrap();
    }
    surface
}

/// Interpolation of a sphere from a cube: the error of the radius falls with the size of the cells.
#[test]
fn errors_fall_with_the_size_of_the_cells() {
    let errors = [1, 2, 3, 4].map(|divisions| {
        let surface = sphere(divisions);
        let leaves = 0..surface.space().leaves().len();
        let places = leaves.flat_map(|leaf| (0..16).map(move |k| (leaf, k)));
        let (mut sum, mut area) = (0.0, 0.0);
        for (leaf, k) in places {
            let [s, t] = [k % 4, k / 4].map(|k| (f64::from(k) + 0.5) / 4.0);
            let weight = surface.space().leaves()[leaf].side().powi(2);
            sum += weight * (surface.leaf_point(leaf, s, t).length() - 1.0).powi(2);
            area += weight;
        }
        f64::sqrt(sum / area)
    });
    println!("rms error of the radius: {errors:?}");
    assert!(errors.windows(2).all(|pair| pair[1] < 0.25 * pair[0]), "{errors:?}");
}

/// Foot points are found across edges and extraordinary vertices, from starts in other quads.
#[test]
fn foot_points_cross_edges() {
    let surface = sphere(2);
    let search = FootPointSearch::new(&surface, 2, 0.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..300 {
        let p = DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0))).normalize_or(DVec3::X);
        // A start up to 0.7 away.
        let near = p + 0.4 * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
        for start in [search.nearest(p, DVec3::ZERO), search.nearest(near, DVec3::ZERO)] {
            let foot = surface.project(1.1 * p, start, &ProjectionOptions::default());
            assert!(foot.converged && (foot.height - 0.1).abs() < 2e-3 && foot.slip < 1e-4, "{p:?} {foot:?}");
        }
    }
}

/// On an open domain, foot points beyond the border stay on it.
#[test]
fn foot_points_stay_on_borders() {
    let domain = QuadDomain::new(&grid(3, 2, false)).unwrap();
    let space = Arc::new(Hierarchy::over(Arc::new(domain)).unwrap());
    let sheet = Arc::new(Hierarchy::uniform(super::super::Shape::Sheet, [3, 2]).unwrap());
    let mut vertices = vec![DVec3::ZERO; space.node_count()];
    for quad in 0..6 {
        let nodes = Level::new(space.domain().unwrap(), 0).neighbourhood(LevelCell { quad, at: [0, 0] });
        for (k, vertex) in nodes.vertices().iter().enumerate() {
            let [x, y] = [quad as usize % 3 + k % 4, quad as usize / 3 + k / 4].map(|x| x as f64 - 1.0);
            vertices[space.quads().unwrap().nodes[0][vertex] as usize] = DVec3::new(x, y, 0.1 * x * y);
        }
    }
    let plane = Surface::new(space, vertices).unwrap();
    let known = sheet.node_anchors().iter().map(|a| DVec3::new(a[0], a[1], 0.1 * a[0] * a[1])).collect();
    let known = Surface::new(sheet, known).unwrap();
    for z in [DVec3::new(-0.5, 1.3, 0.2), DVec3::new(3.4, 2.2, 0.0), DVec3::new(1.2, 0.7, 0.5)] {
        let a = plane.project(z, [1.5, 0.5], &ProjectionOptions::default());
        let b = known.project(z, [1.5, 0.5], &ProjectionOptions::default());
        assert!(a.jet.point.distance(b.jet.point) < 1e-6 && a.at_border == b.at_border, "{a:?} {b:?}");
    }
}
