//! Laws of hierarchies over domains with creases.

use super::*;
use crate::tessellation::{TessellationOptions, tessellate};

/// A mesh with creases, its vertices, and marked corners.
type Creased = (Vec<[u32; 4]>, Vec<DVec3>, Vec<[u32; 2]>);

/// The edges of quads, each once.
fn edges(quads: &[[u32; 4]]) -> Vec<[u32; 2]> {
    let of_quad = |quad: &[u32; 4]| [0, 1, 2, 3].map(|k| [quad[k], quad[(k + 1) % 4]]);
    quads.iter().flat_map(of_quad).filter(|[a, b]| a < b).collect()
}

/// The faces of unit cubes, with creases where faces meet at an angle.
fn sharp(cubes: &[[i32; 3]]) -> Creased {
    let (quads, positions) = voxels(cubes);
    let normal = |quad: &[u32; 4]| {
        let [a, b, c, _] = quad.map(|v| positions[v as usize]);
        (b - a).cross(c - a)
    };
    let is_sharp = |edge: &[u32; 2]| {
        let both: Vec<DVec3> =
            quads.iter().filter(|quad| edge.iter().all(|v| quad.contains(v))).map(normal).collect();
        both[0].dot(both[1]) < 0.5
    };
    let creases = edges(&quads).into_iter().filter(is_sharp).collect();
    (quads, positions, creases)
}

fn two_sharp_holes() -> Creased {
    let cubes = (0..15).map(|k| [k % 5, k / 5, 0]).filter(|c| c[1] != 1 || c[0] % 2 == 0);
    sharp(&cubes.collect::<Vec<_>>())
}

/// A plate with two holes, and edges chosen at random as creases: darts, corners and curves of all kinds.
fn random_creases(share: f64, seed: u64) -> Creased {
    let (quads, positions) = two_holes();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let creases = edges(&quads).into_iter().filter(|_| rng.random_range(0.0..1.0) < share).collect();
    (quads, positions, creases)
}

/// A closed crease on a torus, and one that ends within it.
fn torus(is_closed: bool) -> Creased {
    let quads = grid(8, 7, true);
    let turn = |k: usize, n: usize| std::f64::consts::TAU * k as f64 / n as f64;
    let at = |k: usize| {
        let (a, b) = (turn(k % 8, 8), turn(k / 8, 7));
        DVec3::new((3.0 + b.cos()) * a.cos(), (3.0 + b.cos()) * a.sin(), b.sin())
    };
    let length = if is_closed { 8 } else { 4 };
    (quads, (0..56).map(at).collect(), (0..length).map(|k| [k, (k + 1) % 8]).collect())
}

/// Control vertices, displaced at random, over a domain that is divided `divisions` times.
fn creased((quads, positions, creases): &Creased, divisions: usize, noise: f64) -> Surface {
    let mut domain = QuadDomain::with_creases(quads, creases, &[]).unwrap();
    let mut vertices = positions.clone();
    for _ in 0..divisions {
        let division = domain.divided().unwrap();
        vertices = division.apply(&vertices);
        domain = division.domain;
    }
    displaced(&over(domain, &vertices), noise)
}

/// The surface with control vertices that are displaced at random.
fn displaced(surface: &Surface, noise: f64) -> Surface {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut moved = |p: &DVec3| *p + noise * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
    surface.with_vertices(surface.vertices().iter().map(&mut moved).collect()).unwrap()
}

/// The position of each vertex of a domain over a flat grid, those beyond borders included.
fn flat_grid(domain: &QuadDomain, columns: usize) -> Vec<DVec3> {
    let mut known = vec![DVec3::ZERO; domain.vertex_count()];
    for quad in 0..domain.cells().len() {
        let cell = LevelCell { quad: quad as u32, at: [0, 0] };
        for (k, vertex) in Level::new(domain, 0).plain_neighbourhood(cell).into_iter().enumerate() {
            let [x, y] = [quad % columns + k % 4, quad / columns + k / 4].map(|x| x as f64 - 1.0);
            known[vertex] = DVec3::new(x, y, 0.0);
        }
    }
    known
}

/// A sheet with a crease from a border that ends within it, and one from another border that ends on that.
fn sheet() -> Creased {
    let quads = grid(5, 4, false);
    let positions = flat_grid(&QuadDomain::new(&quads).unwrap(), 5);
    (quads, positions, vec![[12, 13], [13, 14], [14, 20], [20, 26], [14, 15]])
}

fn cases() -> Vec<Creased> {
    let mut cases = vec![sharp(&[[0; 3]]), two_sharp_holes(), torus(true), torus(false), sheet()];
    cases.extend([(0.1, 1), (0.2, 2), (0.3, 3), (0.5, 4), (0.8, 5)].map(|(p, seed)| random_creases(p, seed)));
    cases
}

/// The volume within a closed surface, by Gauss's rule, which is exact for polynomials of its degree.
fn volume(surface: &Surface) -> f64 {
    // Five places of Gauss in [0, 1] are exact up to degree nine; the integrand has degree eight.
    let (a, b) = (
        (5.0 - 2.0 * (10.0_f64 / 7.0).sqrt()).sqrt() / 3.0,
        (5.0 + 2.0 * (10.0_f64 / 7.0).sqrt()).sqrt() / 3.0,
    );
    let (wa, wb) = ((322.0 + 13.0 * 70.0_f64.sqrt()) / 900.0, (322.0 - 13.0 * 70.0_f64.sqrt()) / 900.0);
    let rule =
        [(0.0, 128.0 / 225.0), (a, wa), (-a, wa), (b, wb), (-b, wb)].map(|(x, w)| (0.5 + 0.5 * x, 0.5 * w));
    let mut sum = 0.0;
    for (leaf, cell) in surface.space().leaves().iter().enumerate() {
        for (s, ws) in rule {
            for (t, wt) in rule {
                let jet = surface.leaf_jet(leaf, s, t);
                sum += ws * wt * cell.side().powi(2) * jet.point.dot(jet.du.cross(jet.dv)) / 3.0;
            }
        }
    }
    sum
}

/// Solids of cubes keep their flat faces, sharp edges and volumes exactly.
#[test]
fn sharp_solids_are_exact() {
    let ring: Vec<[i32; 3]> = (0..9).filter(|&k| k != 4).map(|k| [k % 3, k / 3, 0]).collect();
    let steps = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
    for (cubes, divisions) in [(&[[0; 3]][..], 0), (&[[0; 3]], 1), (&ring, 1), (&steps, 1), (&steps, 2)] {
        let surface = creased(&sharp(cubes), divisions, 0.0);
        let refined = surface.refined(refined_at_random(surface.space(), 3, 1).into()).unwrap();
        for surface in [surface, refined] {
            let error = volume(&surface) - cubes.len() as f64;
            assert!(error.abs() < 1e-11, "{} cubes, divided {divisions} times: {error:.1e}", cubes.len());
            for quad in 0..surface.space().domain().unwrap().cells().len() as u32 {
                // All points of a quad lie in the plane of one face.
                let places = (0..49).map(|k| in_quad(quad, [k % 7, k / 7].map(|x| f64::from(x) / 6.0)));
                let points: Vec<DVec3> = places.map(|[u, v]| surface.point(u, v)).collect();
                let flat = (0..3).any(|d| points.iter().all(|p| (p[d] - p[d].round()).abs() < 1e-12));
                assert!(flat, "quad {quad}");
            }
        }
    }
}

/// Weights sum to one, functions are hardly negative, and each has a support.
#[test]
fn weights_beside_creases_are_sound() {
    let mut least = f64::INFINITY;
    for (case, creased_mesh) in cases().iter().enumerate() {
        let space = creased(creased_mesh, 1, 0.0).space().clone();
        let fine = refined_at_random(&space, 4, case as u64);
        for space in [&*space, &fine] {
            space.sanity_check().unwrap();
            assert!(space.node_count() >= space.domain().unwrap().vertex_count());
            for leaf in 0..space.leaves().len() {
                for at in 0..25 {
                    let values = basis_values(f64::from(at % 5) / 4.0, f64::from(at / 5) / 4.0);
                    for w in space.extraction(leaf).1 {
                        least = least.min(w.iter().zip(values).map(|(w, b)| w * b).sum());
                    }
                }
            }
        }
        let domain = Arc::clone(fine.domain().unwrap());
        let rebuilt = Hierarchy::over_leaves(domain, fine.leaves()).unwrap();
        assert_eq!((rebuilt.leaves(), rebuilt.node_count()), (fine.leaves(), fine.node_count()));
    }
    println!("least value of a function: {least:.1e}");
    // At concave corners, directions are opposite to those of creases: see `fans_at_creases_do_not_fold`.
    assert!(least > -0.05, "{least}");
}

/// Positions agree across all edges, normals across all but creases.
#[test]
fn normals_jump_at_creases_only() {
    let (mut worst, mut least_jump) = ([0.0_f64; 2], f64::INFINITY);
    for (case, mesh) in cases().iter().enumerate() {
        let coarse = creased(mesh, 1, 0.1);
        let fine = refined_at_random(coarse.space(), 3, case as u64);
        let domain = Arc::clone(fine.domain().unwrap());
        let fine = coarse.refined(fine.into()).unwrap();
        let ends = |quad: u32, side: u32| {
            let corners = domain.cells()[quad as usize];
            [corners[side as usize], corners[(side as usize + 1) % 4]]
        };
        for surface in [coarse.clone(), fine.clone(), displaced(&fine, 0.02)] {
            let mut jumps: HashMap<[u32; 2], f64> = HashMap::new();
            let differences = |at: [f64; 2], to: [f64; 2]| {
                let [a, b] = [at, to].map(|[u, v]| surface.jet(u, v));
                let [m, n] = [&a, &b].map(|jet| jet.normal().unwrap());
                [a.point.distance(b.point), m.distance(n)]
            };
            for quad in 0..domain.cells().len() as u32 {
                for step in 0..=32 {
                    let t = f64::from(step) / 32.0;
                    for side in 0..4 {
                        let place = on_side(0, side, t);
                        let Some((next, to, _)) = domain.across(quad, side, place, 1.0) else { continue };
                        if next as usize >= domain.cells().len() {
                            continue;
                        }
                        let to = in_quad(next, to.map(|x| x.clamp(0.0, 1.0)));
                        let [position, normal] = differences(in_quad(quad, place), to);
                        worst[0] = worst[0].max(position);
                        let edge = ends(quad, side);
                        if !domain.is_crease(edge) {
                            worst[1] = worst[1].max(normal);
                            assert!(normal < 1e-9, "case {case}, {edge:?}, {t}: {normal:.1e}");
                        } else {
                            let own = jumps.entry([edge[0].min(edge[1]), edge[0].max(edge[1])]).or_default();
                            *own = normal.max(*own);
                        }
                    }
                    let (x, e) = (f64::from(step.clamp(1, 31)) / 32.0, 1e-12);
                    for (a, b) in [([x - e, 0.3], [x + e, 0.3]), ([0.61, x - e], [0.61, x + e])] {
                        let [position, normal] = differences(in_quad(quad, a), in_quad(quad, b));
                        assert!(
                            position < 1e-10 && normal < 1e-8,
                            "case {case}, {quad}: {position} {normal}"
                        );
                    }
                }
            }
            assert_eq!(jumps.len(), domain.creases().len());
            least_jump = jumps.into_values().fold(least_jump, f64::min);
        }
    }
    println!(
        "positions differ by {:.1e}, normals by {:.1e}, at creases by {least_jump:.1e}",
        worst[0], worst[1]
    );
    assert!(worst[0] < 1e-12 && worst[1] < 1e-10, "{worst:?}");
    assert!(least_jump > 1e-3, "{least_jump}");
}

/// Refinement keeps the surface, except in cells at extraordinary vertices that are split.
#[test]
fn refinement_keeps_creases() {
    for (case, mesh) in cases().iter().enumerate() {
        let coarse = creased(mesh, 1, 0.05);
        let domain = Arc::clone(coarse.space().domain().unwrap());
        for fine in [coarse.space().refine_all(), refined_at_random(coarse.space(), 4, case as u64)] {
            let fine = coarse.refined(fine.into()).unwrap();
            let [mut kept, mut changed] = [0.0_f64; 2];
            for quad in 0..domain.cells().len() as u32 {
                let special = (0..4).any(|k| domain.is_extraordinary_corner(quad as usize, k));
                for k in 0..81 {
                    let [u, v] = in_quad(quad, [k % 9, k / 9].map(|x| f64::from(x) / 8.0));
                    let distance = coarse.point(u, v).distance(fine.point(u, v));
                    let own = if special { &mut changed } else { &mut kept };
                    *own = own.max(distance);
                }
            }
            println!("case {case}: change of regular cells {kept:.1e}, of others {changed:.1e}");
            // The last part of a crease, in which the jump fades, becomes shorter.
            assert!(kept < 1e-12 && changed < 0.1, "{kept}, {changed}");
        }
    }
}

/// Division keeps creases, the surface beside them, and the curves of creases.
#[test]
fn division_keeps_creases() {
    for mesh in [sharp(&[[0; 3]]), torus(true), two_sharp_holes()] {
        let (quads, mut positions, creases) = mesh;
        positions.iter_mut().enumerate().for_each(|(k, p)| p.z += 0.05 * (k as f64).sin());
        let coarse = QuadDomain::with_creases(&quads, &creases, &[]).unwrap().divided().unwrap();
        assert_eq!(coarse.domain.creases().len(), 2 * creases.len());
        let vertices = coarse.apply(&positions);
        let division = coarse.domain.divided().unwrap();
        let [coarse, fine] =
            [(coarse.domain, vertices.clone()), (division.domain.clone(), division.apply(&vertices))]
                .map(|(domain, at)| over(domain, &at));
        let domain = coarse.space().domain().unwrap();
        for quad in 0..domain.cells().len() as u32 {
            let special = (0..4).any(|k| domain.is_extraordinary_corner(quad as usize, k));
            for k in (0..64).filter(|_| !special) {
                let place = [k % 8, k / 8].map(|x| f64::from(x) / 8.0 + 0.01);
                let quarter = match place.map(|x| x > 0.5) {
                    [false, false] => 0,
                    [true, false] => 1,
                    [true, true] => 2,
                    [false, true] => 3,
                };
                let [u, v] = in_quad(quad, place);
                let [x, y] = in_quad(4 * quad + quarter, place.map(|x| (2.0 * x).fract()));
                assert!(coarse.point(u, v).distance(fine.point(x, y)) < 1e-12, "{quad}, {place:?}");
            }
        }
    }
}

/// Marked corners stay corners, and the surface passes through them. Borders end creases.
#[test]
fn corners_and_borders_keep_their_rules() {
    // A flat grid of 5 × 4 quads, with a crease from border to border that turns at (2, 2).
    let quads = grid(5, 4, false);
    let at = |i: u32, j: u32| j * 6 + i;
    let creases = [[at(0, 2), at(1, 2)], [at(1, 2), at(2, 2)], [at(2, 2), at(2, 3)], [at(2, 3), at(2, 4)]];
    let domain = QuadDomain::with_creases(&quads, &creases, &[at(2, 2)]).unwrap();
    let mut vertices = flat_grid(&domain, 5);
    let flat = over(domain.clone(), &vertices);
    let division = domain.divided().unwrap();
    let divided = over(division.domain.clone(), &division.apply(&vertices));
    assert_eq!((division.domain.creases().len(), division.domain.corners().len()), (8, 1));
    // The grid is reproduced: parameters are coordinates in all quads with uniform splines.
    for quad in 0..20_u32 {
        let special = (0..4).any(|k| domain.is_extraordinary_corner(quad as usize, k));
        for k in (0..25).filter(|_| !special) {
            let [x, y] = [k % 5, k / 5].map(|x| f64::from(x) / 4.0);
            let [u, v] = in_quad(quad, [x, y]);
            let expected = DVec3::new(f64::from(quad % 5) + x, f64::from(quad / 5) + y, 0.0);
            assert!(flat.point(u, v).distance(expected) < 1e-12, "{quad}, {x}, {y}");
        }
    }
    vertices.iter_mut().enumerate().for_each(|(k, p)| p.z = 0.3 * (2.0 * k as f64).sin());
    let bent = over(domain, &vertices);
    let again = over(division.domain.clone(), &division.apply(&vertices));
    let [u, v] = in_quad(12, [0.0, 0.0]);
    assert!(bent.point(u, v).distance(vertices[at(2, 2) as usize]) < 1e-13);
    // The first quarter of quad 12 has the same corner.
    let [u, v] = in_quad(48, [0.0, 0.0]);
    assert!(again.point(u, v).distance(vertices[at(2, 2) as usize]) < 1e-13);
    assert!(divided.point(u, v).distance(DVec3::new(2.0, 2.0, 0.0)) < 1e-12);
}

/// A ridge between flat sides is exact. Where a side is curved across the crease, its second derivative is
/// zero there, which misses up to 0.041 of it times the square of a cell.
#[test]
fn ridges_are_exact_and_curved_sides_are_not() {
    // A crease along the middle of 8 × 4 unit cells, from border to border.
    let creases: Vec<[u32; 2]> = (0..4).map(|j| [9 * j + 4, 9 * j + 13]).collect();
    let domain = QuadDomain::with_creases(&grid(8, 4, false), &creases, &[]).unwrap();
    let space = Hierarchy::over(domain.into()).unwrap();
    let (n, places) = (space.node_count(), 10);
    let samples = (0..space.leaves().len()).flat_map(|leaf| (0..places * places).map(move |k| (leaf, k)));
    let samples: Vec<(f64, Vec<(usize, f64)>)> = samples
        .map(|(leaf, k)| {
            let [s, t] = [k % places, k / places].map(|k| (f64::from(k) + 0.5) / f64::from(places));
            let values = basis_values(s, t);
            let (nodes, weights) = space.extraction(leaf);
            let row = nodes.iter().zip(weights);
            let row = row.map(|(&node, w)| (node as usize, w.iter().zip(values).map(|(w, b)| w * b).sum()));
            (f64::from(space.leaves()[leaf].i % 8) + s - 4.0, row.collect())
        })
        .collect();
    // The largest error of the fit by least squares to a function of the distance from the crease.
    let largest_error = |f: &dyn Fn(f64) -> f64| {
        let (mut normal, mut right) = (DMatrix::<f64>::zeros(n, n), nalgebra::DVector::<f64>::zeros(n));
        for (x, row) in &samples {
            for &(i, a) in row {
                right[i] += a * f(*x);
                row.iter().for_each(|&(j, b)| normal[(i, j)] += a * b);
            }
        }
        let vertices = normal.cholesky().unwrap().solve(&right);
        let error = |(x, row): &(f64, Vec<(usize, f64)>)| {
            (row.iter().map(|&(i, a)| a * vertices[i]).sum::<f64>() - f(*x)).abs()
        };
        samples.iter().map(error).fold(0.0, f64::max)
    };
    let (flat, curved) = (largest_error(&f64::abs), largest_error(&|x| 0.5 * x * x));
    println!("errors of a ridge {flat:.1e}, of second derivative 1 {curved:.4}");
    assert!(flat < 1e-10, "{flat}");
    assert!((0.03..0.05).contains(&curved), "{curved}");
}

/// A crease that ends on the curve of two others leaves that curve smooth.
#[test]
fn a_crease_ends_on_the_curve_of_others() {
    let (quads, positions, mut creases) = torus(true);
    creases.extend([[2, 10], [10, 18]]);
    let surface = creased(&(quads, positions, creases), 0, 0.1);
    let jet = |quad: u32, place: [f64; 2]| {
        let [u, v] = in_quad(quad, place);
        surface.jet(u, v)
    };
    // The four quads at vertex 2, and its place in them.
    let jets = [jet(1, [1.0, 0.0]), jet(2, [0.0, 0.0]), jet(49, [1.0, 1.0]), jet(50, [0.0, 1.0])];
    for jet in &jets[1..] {
        assert!(jet.point.distance(jets[0].point) < 1e-12, "{jets:?}");
        assert!(jet.du.distance(jets[0].du) < 1e-10, "{jets:?}");
    }
    let normals = jets.map(|jet| jet.normal().unwrap());
    assert!(normals[2].distance(normals[3]) < 1e-10, "{normals:?}");
    assert!(normals[0].distance(normals[2]) > 1e-3, "{normals:?}");
    // Both sides of the third crease have its direction and that of the curve at the vertex, so the jump of
    // the normal begins there.
    assert!(normals[0].distance(normals[1]) < 1e-10, "{normals:?}");
    let [left, right] = [jet(1, [1.0, 0.5]), jet(2, [0.0, 0.5])].map(|jet| jet.normal().unwrap());
    assert!(left.distance(right) > 1e-3, "{left:?}, {right:?}");
}

/// Foot points on a cube with sharp edges are the nearest points, from starts on any face.
#[test]
fn foot_points_cross_creases() {
    let cube = creased(&sharp(&[[0; 3]]), 1, 0.0);
    let search = FootPointSearch::new(&cube, 3, 0.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let options = ProjectionOptions::default();
    let mut missed = 0;
    for _ in 0..3000 {
        // Points near edges, within and outside of the cube.
        let mut p = DVec3::from_array([0; 3].map(|_| rng.random_range(-0.1..1.1)));
        let d = rng.random_range(0..3);
        for e in [(d + 1) % 3, (d + 2) % 3] {
            p[e] = f64::from(rng.random_range(0..2)) + rng.random_range(-0.1..0.1);
        }
        let inside = p.clamp(DVec3::ZERO, DVec3::ONE);
        let nearest = if inside == p {
            let depths = (0..3).flat_map(|d| [p[d], 1.0 - p[d]]);
            depths.fold(f64::INFINITY, f64::min)
        } else {
            inside.distance(p)
        };
        // A start up to 0.25 away, often beyond the edge.
        let near = p + 0.15 * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
        for start in [search.nearest(p, DVec3::ZERO), search.nearest(near, DVec3::ZERO)] {
            let foot = cube.project(p, start, &options);
            let distance = foot.jet.point.distance(p);
            if distance > nearest + 1e-9 {
                missed += 1;
                if missed < 12 {
                    println!("{p:?} from {start:?}: {distance} instead of {nearest}, {foot:?}");
                }
            }
        }
    }
    assert_eq!(missed, 0);
}

/// Along a curved crease, no sample of the surface is nearer than the foot point.
#[test]
fn foot_points_lie_on_curved_creases() {
    let surface = creased(&torus(true), 1, 0.15);
    let search = FootPointSearch::new(&surface, 3, 0.0).unwrap();
    let domain = surface.space().domain().unwrap();
    let places = (0..domain.cells().len() as u32)
        .flat_map(|quad| (0..400).map(move |k| in_quad(quad, [k % 20, k / 20].map(|x| f64::from(x) / 19.0))));
    let samples: Vec<DVec3> = places.map(|[u, v]| surface.point(u, v)).collect();
    let on_crease = |quad: u32| (0..4).find(|&side| domain.is_crease_side(quad, side));
    let beside: Vec<(u32, u32)> =
        (0..domain.cells().len() as u32).filter_map(|quad| Some((quad, on_crease(quad)?))).collect();
    let (mut rng, mut held) = (ChaCha8Rng::seed_from_u64(2), 0);
    for _ in 0..400 {
        let (quad, side) = beside[rng.random_range(0..beside.len())];
        let [u, v] = in_quad(quad, on_side(0, side, rng.random_range(0.0..1.0)));
        let p = surface.point(u, v) + 0.1 * DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
        let foot = surface.project(p, search.nearest(p, DVec3::ZERO), &ProjectionOptions::default());
        let nearest = samples.iter().map(|q| q.distance(p)).fold(f64::INFINITY, f64::min);
        assert!(foot.converged && foot.jet.point.distance(p) < nearest + 1e-9, "{p:?} {nearest} {foot:?}");
        let at = surface.space().parameters(foot.leaf as usize, foot.local);
        held += usize::from(surface.space().on_crease(at).contains(&true));
        assert!(!foot.at_border);
    }
    assert!(held > 20, "{held} feet on the crease");
}

/// Triangles of both sides of a crease share their vertices.
#[test]
fn meshes_with_creases_are_closed() {
    for (case, mesh) in cases().iter().enumerate() {
        let surface = creased(mesh, 1, 0.05);
        if surface.space().domain().unwrap().borders() > 0 {
            continue;
        }
        let fine = surface.refined(refined_at_random(surface.space(), 2, 4).into()).unwrap();
        let options = TessellationOptions { tolerance: 0.02, ..TessellationOptions::default() };
        let made = tessellate(&fine, &options).unwrap();
        let mut sides: HashMap<[u32; 2], i32> = HashMap::new();
        for &[a, b, c] in &made.triangles {
            for [a, b] in [[a, b], [b, c], [c, a]] {
                *sides.entry([a.min(b), a.max(b)]).or_default() += if a < b { 1 } else { -1 };
            }
        }
        assert!(sides.values().all(|&sum| sum == 0), "case {case}");
        for (k, &[u, v]) in made.parameters.iter().enumerate() {
            assert!(fine.point(u, v).distance(made.positions[k]) < 1e-9, "case {case}, vertex {k}");
        }
    }
}

/// The functions of domains with creases are as independent as without them.
#[test]
fn functions_beside_creases_are_independent() {
    for mesh in cases() {
        let (quads, positions, _) = mesh.clone();
        let [own, smooth] = [mesh, (quads, positions, Vec::new())].map(|mesh| creased(&mesh, 1, 0.0));
        for rounds in [0, 2] {
            let [own, smooth] = [&own, &smooth].map(|surface| {
                let space = refined_at_random(surface.space(), rounds, 5);
                (space.node_count(), gram_condition(&space))
            });
            println!("{own:?} functions and condition, without creases {smooth:?}");
            assert!(own.1 > 0.0 && own.1 < 2.0 * smooth.1.max(300.0), "{own:?}, {smooth:?}");
        }
    }
}
