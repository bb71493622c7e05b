//! Surfaces as boundary representations: the faces are the surface, and Open Cascade agrees.

use planish::export::{BrepOptions, brep_from_surface};
use planish_core::DVec3;
use planish_exchange::Unit;
use planish_exchange::step::{Brep, BsplineCurve, BsplineSurface, StepOptions, read_step, write_step};
use planish_mesh::{BoundingBox, MeshSearch, TriangleMesh};
use planish_spline::{
    BaseShape, Hierarchy, QuadDomain, Shape, Surface, TessellationOptions, quadrature, tessellate,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};
use std::process::Command;

const SHAPES: [Shape; 4] = [Shape::Sheet, Shape::Tube, Shape::Ball, Shape::Torus];

/// In as few faces as possible, and in one for each base cell.
const MODES: [BrepOptions; 2] =
    [BrepOptions { max_control_points: usize::MAX }, BrepOptions { max_control_points: 0 }];

fn base(shape: Shape, size: f64) -> BaseShape {
    let axis = DVec3::new(0.0, 0.6, 0.8);
    let centre = DVec3::new(size, -0.5 * size, 0.2 * size);
    match shape {
        Shape::Sheet => BaseShape::plane(centre, [DVec3::X, DVec3::new(0.0, 0.6, 0.8)], [size, 0.7 * size]),
        Shape::Tube => BaseShape::cylinder(centre, axis, 0.5 * size, size),
        Shape::Ball => BaseShape::sphere(centre, size, axis),
        Shape::Torus => BaseShape::torus(centre, axis, size, 0.4 * size),
    }
}

/// A bumpy surface, refined here and there `rounds` levels deep.
fn bumpy(shape: Shape, size: f64, grid: [usize; 2], rounds: usize) -> Surface {
    let mut random = ChaCha8Rng::seed_from_u64(17 + rounds as u64);
    let mut surface = base(shape, size).surface(grid).unwrap();
    for round in 0..=rounds {
        let bump = 0.03 * size * 0.4_f64.powi(round as i32);
        let vertices = surface
            .vertices()
            .iter()
            .map(|p| *p + bump * DVec3::from_array(std::array::from_fn(|_| random.random_range(-1.0..1.0))));
        let vertices = vertices.collect();
        surface = surface.with_vertices(vertices).unwrap();
        if round < rounds {
            let supports = surface.space().support_leaves();
            let mut marked = Vec::new();
            for support in &supports {
                if random.random_range(0.0..1.0) < 0.05 {
                    marked.extend(support.iter().map(|&leaf| leaf as usize));
                }
            }
            surface = surface.refined(surface.space().refine(&marked).into()).unwrap();
        }
    }
    surface
}

fn all_knots(knots: &[(f64, usize)]) -> Vec<f64> {
    knots.iter().flat_map(|&(value, times)| std::iter::repeat_n(value, times)).collect()
}

/// de Boor's algorithm, for cubics.
fn spline_point(knots: &[f64], poles: &[DVec3], t: f64) -> DVec3 {
    let span = (3..poles.len()).rev().find(|&k| knots[k] <= t).unwrap_or(3);
    let mut d: [DVec3; 4] = std::array::from_fn(|k| poles[span - 3 + k]);
    for r in 1..=3 {
        for k in (r..=3).rev() {
            let (low, high) = (knots[span - 3 + k], knots[span + 1 + k - r]);
            let w = (t - low) / (high - low);
            d[k] = (1.0 - w) * d[k - 1] + w * d[k];
        }
    }
    d[3]
}

fn surface_point(surface: &BsplineSurface, u: f64, v: f64) -> DVec3 {
    let (ku, kv) = (all_knots(&surface.knots_u), all_knots(&surface.knots_v));
    let column: Vec<DVec3> = surface.poles.chunks(surface.n_v).map(|row| spline_point(&kv, row, v)).collect();
    spline_point(&ku, &column, u)
}

fn range(knots: &[(f64, usize)]) -> [f64; 2] {
    [knots[0].0, knots[knots.len() - 1].0]
}

fn curve_point(curve: &BsplineCurve, share: f64) -> DVec3 {
    let [from, to] = range(&curve.knots);
    spline_point(&all_knots(&curve.knots), &curve.poles, from + share * (to - from))
}

#[test]
fn faces_match_the_surface_and_neighbours_share_edges() {
    for shape in SHAPES {
        for (grid, rounds) in [([4, 4], 0), ([9, 5], 0), ([8, 6], 2), ([7, 6], 3)] {
            let surface = bumpy(shape, 1.0, grid, rounds);
            assert_eq!(surface.space().levels(), rounds + 1);
            for options in MODES {
                let brep = brep_from_surface(&surface, &options);
                brep.check(1e-12).unwrap();
                for face in &brep.faces {
                    let s = &face.surface;
                    let ([u0, u1], [v0, v1]) = (range(&s.knots_u), range(&s.knots_v));
                    for a in 0..=8 {
                        for b in 0..=8 {
                            let u = u0 + (u1 - u0) * f64::from(a) / 8.0;
                            let v = v0 + (v1 - v0) * f64::from(b) / 8.0;
                            let apart = surface_point(s, u, v).distance(surface.point(u, v));
                            assert!(apart < 1e-12, "{shape:?} {grid:?} at {u} {v}: {apart}");
                        }
                    }
                    // Its edges are its borders.
                    for &(edge, _) in &face.edges {
                        let curve = &brep.edges[edge].curve;
                        for n in 0..=10 {
                            let share = f64::from(n) / 10.0;
                            let p = curve_point(curve, share);
                            let (u, v) = (u0 + share * (u1 - u0), v0 + share * (v1 - v0));
                            let nearest = [(u, v0), (u, v1), (u0, v), (u1, v)]
                                .into_iter()
                                .map(|(u, v)| surface_point(s, u, v).distance(p))
                                .fold(f64::INFINITY, f64::min);
                            assert!(nearest < 1e-12, "{shape:?}: an edge is {nearest} away from its face");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn numbers_of_faces_and_edges_match_the_topology() {
    let counts = |brep: &Brep| (brep.faces.len(), brep.edges.len(), brep.vertices.len());
    for (shape, few, many) in [
        (Shape::Sheet, (1, 4, 4), (48, 110, 63)),
        (Shape::Tube, (2, 6, 4), (48, 104, 56)),
        (Shape::Ball, (2, 2, 2), (48, 88, 42)),
        (Shape::Torus, (4, 8, 4), (48, 96, 48)),
    ] {
        let surface = base(shape, 1.0).surface([8, 6]).unwrap();
        let closed = matches!(shape, Shape::Ball | Shape::Torus);
        for (options, expected) in MODES.iter().zip([few, many]) {
            let brep = brep_from_surface(&surface, options);
            assert_eq!(counts(&brep), expected, "{shape:?}");
            assert_eq!(brep.closed, closed);
        }
    }
}

#[test]
fn a_surface_above_the_limit_is_cut_at_the_base_grid() {
    let surface = base(Shape::Sheet, 1.0).surface([10, 7]).unwrap();
    for (max_control_points, faces) in [(130, 1), (129, 70)] {
        let brep = brep_from_surface(&surface, &BrepOptions { max_control_points });
        assert_eq!(brep.faces.len(), faces);
    }
}

#[test]
fn a_ball_turned_inside_out_still_encloses_its_solid() {
    let ball = base(Shape::Ball, 1.0).surface([8, 6]).unwrap();
    let mirrored = ball.vertices().iter().map(|p| DVec3::new(-p[0], p[1], p[2])).collect();
    let ball = ball.with_vertices(mirrored).unwrap();
    for options in MODES {
        let brep = brep_from_surface(&ball, &options);
        brep.check(1e-12).unwrap();
        assert!(brep.faces.iter().all(|face| !face.same_sense));
    }
}

/// Result of Open Cascade for STEP files. Without Open Cascade there is none, and a message is printed.
fn open_cascade(files: &[PathBuf]) -> Option<Vec<serde_json::Value>> {
    let Ok(python) = std::env::var("PLANISH_OCC_PYTHON") else {
        println!("skipped: PLANISH_OCC_PYTHON names no python that has cadquery-ocp-novtk");
        return None;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/check_step.py");
    let output = Command::new(python).arg(script).args(files).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let results: Vec<_> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(results.len(), files.len(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(results)
}

#[test]
fn written_surfaces_read_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    for shape in SHAPES {
        let surface = bumpy(shape, 100.0, [12, 8], 1);
        for options in &MODES {
            let path = folder.path().join("part.step");
            let brep = brep_from_surface(&surface, options);
            write_step(&path, &brep, &StepOptions::default()).unwrap();
            let faces = read_step(&path).unwrap();
            let chord = 0.02;
            let read = faces.triangles(&faces.fineness(Some(chord))).unwrap();
            assert_eq!((read.parts.len(), read.faces, read.unreadable.len()), (1, brep.faces.len(), 0));
            let mesh =
                TriangleMesh::try_new(read.parts[0].points.clone(), read.parts[0].triangles.clone()).unwrap();
            let check = mesh.check();
            assert!(check.manifold && check.oriented && check.watertight == brep.closed, "{check:?}");
            let truth = tessellate(
                &surface,
                &TessellationOptions { tolerance: chord, ..TessellationOptions::default() },
            )
            .unwrap();
            let truth = TriangleMesh::try_new(truth.positions, truth.triangles).unwrap();
            for (from, to) in [(&mesh, &truth), (&truth, &mesh)] {
                let search = MeshSearch::try_new(to).unwrap();
                let off = from.positions.iter().map(|p| search.closest(*p).unwrap().distance);
                let off = off.fold(0.0, f64::max);
                assert!(off < 3.0 * chord, "{}: {off}", shape.name());
            }
        }
    }
}

#[test]
fn open_cascade_confirms_validity_area_and_box_of_every_shape() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("brep");
    std::fs::create_dir_all(&folder).unwrap();
    let mut files = Vec::new();
    let mut cases = Vec::new();
    for shape in SHAPES {
        // A tenth of a metre, and a hundred millimetres: the same part in two units.
        for (size, unit, millimetres) in [(0.1, Unit::Metre, 1000.0), (100.0, Unit::Millimetre, 1.0)] {
            for rounds in [0, 2] {
                let surface = bumpy(shape, size, [12, 8], rounds);
                for (mode, options) in MODES.iter().enumerate() {
                    let path = folder.join(format!("{}-{size}-{rounds}-{mode}.step", shape.name()));
                    let step =
                        StepOptions { unit, uncertainty: 1e-6 / millimetres, ..StepOptions::default() };
                    let brep = brep_from_surface(&surface, options);
                    write_step(&path, &brep, &step).unwrap();
                    files.push(path);
                    cases.push((surface.clone(), millimetres, brep.faces.len(), brep.closed));
                }
            }
        }
    }
    // A ball turned inside out, too.
    let ball = bumpy(Shape::Ball, 100.0, [12, 8], 1);
    let mirrored = ball.vertices().iter().map(|p| DVec3::new(-p[0], p[1], p[2])).collect();
    let ball = ball.with_vertices(mirrored).unwrap();
    for (mode, options) in MODES.iter().enumerate() {
        let path = folder.join(format!("mirrored-{mode}.step"));
        let brep = brep_from_surface(&ball, options);
        write_step(&path, &brep, &StepOptions::default()).unwrap();
        files.push(path);
        cases.push((ball.clone(), 1.0, brep.faces.len(), true));
    }
    let Some(results) = open_cascade(&files) else {
        return;
    };
    for ((file, result), (surface, millimetres, faces, closed)) in files.iter().zip(&results).zip(&cases) {
        let name = file.file_stem().unwrap().to_string_lossy();
        let fine = surface.space().refine_all().refine_all();
        let area: f64 = surface.thin_plate(&fine).iter().map(|leaf| leaf.area).sum();
        let area = area * millimetres * millimetres;
        let found = result["area"].as_f64().unwrap();
        println!(
            "{name}: valid {}, faces {faces}, area {found:.6} (ours {area:.6}, off {:.1e}), volume {}, \
             tolerance {}",
            result["valid"],
            found / area - 1.0,
            result["volume"],
            result["tolerance"]
        );
        assert_eq!(result["valid"], true, "{name}");
        assert_eq!(result["faces"], *faces, "{name}");
        assert_eq!(result["solids"], usize::from(*closed), "{name}");
        assert!((found / area - 1.0).abs() < 1e-6, "{name}: area {found}, ours {area}");
        assert!(result["volume"].as_f64().is_none_or(|volume| volume > 0.0), "{name}");
        let mesh = tessellate(
            surface,
            &TessellationOptions { tolerance: 1e-3 / millimetres, ..TessellationOptions::default() },
        )
        .unwrap();
        let bounds = BoundingBox::from_points(&mesh.positions).unwrap();
        for d in 0..3 {
            for (k, bound) in [bounds.min[d], bounds.max[d]].into_iter().enumerate() {
                let reference = result["box"][k][d].as_f64().unwrap();
                let apart = (reference - bound * millimetres).abs();
                assert!(apart < 2e-3, "{name}: box {reference}, ours {}", bound * millimetres);
            }
        }
    }
}

/// Two rounded cubes over quads, of 100 and 50 mm.
fn rounded_cubes() -> Surface {
    let cube = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let quads: Vec<[u32; 4]> = cube.into_iter().chain(cube.map(|quad| quad.map(|v| v + 8))).collect();
    let corner = |k: u32| DVec3::from_array([k & 1, k >> 1 & 1, k >> 2 & 1].map(f64::from));
    let mut positions: Vec<DVec3> = (0..8).map(|k| 100.0 * corner(k)).collect();
    positions.extend((0..8).map(|k| DVec3::new(200.0, 0.0, 0.0) + 50.0 * corner(k)));
    let mut domain = QuadDomain::new(&quads).unwrap();
    for _ in 0..3 {
        let division = domain.divided().unwrap();
        positions = division.apply(&positions);
        domain = division.domain;
    }
    Surface::new(Hierarchy::over(domain.into()).unwrap().into(), positions).unwrap()
}

#[test]
fn open_cascade_confirms_large_faces_and_bodies_over_quads() {
    let cubes = rounded_cubes();
    // Six faces each, one for each side.
    let brep = brep_from_surface(&cubes, &BrepOptions::default());
    assert_eq!((brep.faces.len(), brep.edges.len(), brep.vertices.len()), (12, 24, 16));
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cubes.step");
    write_step(&path, &brep, &StepOptions::default()).unwrap();
    let read = read_step(&path).unwrap();
    let mesh = read.triangles(&read.fineness(Some(0.02))).unwrap();
    assert_eq!((mesh.parts.len(), mesh.faces, mesh.unreadable.len()), (2, 12, 0));
    let Some(results) = open_cascade(&[path]) else {
        return;
    };
    let result = &results[0];
    println!("{result}");
    assert_eq!(
        (&result["valid"], &result["solids"], &result["faces"]),
        (&true.into(), &2.into(), &12.into())
    );
    assert!(result["crease_deg"].as_f64().unwrap() < 0.1);
    let mut expected = 0.0;
    for (leaf, cell) in cubes.space().leaves().iter().enumerate() {
        for q in quadrature() {
            let jet = cubes.leaf_jet(leaf, q.local[0], q.local[1]);
            expected += cell.side().powi(2) * q.weight * jet.point.dot(jet.du.cross(jet.dv)) / 3.0;
        }
    }
    let found = result["volume"].as_f64().unwrap();
    assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
}
