//! Fits of objects with handles.

use super::{Draft, is_piece, leaf_areas};
use crate::export::{BrepOptions, Closing, brep_from_model, mesh_from_model};
use crate::fit::enclosing_mesh::{BodiesAndHandles, bodies_and_handles, enclosing_mesh};
use crate::fit::options::Handles;
use crate::fit::{Fit, FitOptions, FitVerdict, GlobalOptions, Strategy, fit};
use crate::layout::{Layout, LayoutMesh};
use planish_core::{BoundingBox, DVec3, Silent};
use planish_exchange::{PosedScan, ScanSet, Unit};
use planish_mesh::{TriangleMesh, isosurface};
use planish_sense::{Noise, Scan, Sensor};
use planish_spline::{Hierarchy, Surface};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;
use std::sync::Arc;

pub(super) const SIGMA: f64 = 0.1;

/// Height above two rings that are joined smoothly, and its gradient.
fn two_rings(p: DVec3) -> (f64, DVec3) {
    let (mut sum, mut slope) = (0.0, DVec3::ZERO);
    for x in [-20.0, 20.0] {
        let q = p - DVec3::new(x, 0.05 * x, 0.0);
        let (out, up) = (q.truncate().length() - 20.0, q.z);
        let distance = out.hypot(up).max(1e-12);
        let along = q.truncate().normalize_or_zero().extend(0.0);
        let weight = (-0.3 * distance).exp();
        sum += weight;
        slope += weight / distance * (out * along + up * DVec3::Z);
    }
    (-sum.ln() / 0.3 - 7.0, slope / sum)
}

/// Readings all over the two rings.
fn scan(count: usize, seed: u64) -> ScanSet {
    let bounds = BoundingBox { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let mesh = isosurface(&bounds, 2.0, |p| two_rings(p).0, |_, _| true).unwrap();
    let mut until = 0.0;
    let areas: Vec<f64> = (0..mesh.triangles.len())
        .map(|k| {
            let [a, b, c] = mesh.corners(k);
            until += (b - a).cross(c - a).length();
            until
        })
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for _ in 0..count {
        let at = rng.random_range(0.0..until);
        let [a, b, c] = mesh.corners(areas.partition_point(|area| *area < at).min(areas.len() - 1));
        let (s, t): (f64, f64) = (rng.random(), rng.random());
        let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
        let p = on_two_rings(a + s * (b - a) + t * (c - a));
        normals.push(two_rings(p).1.normalize());
        points.push(p + SIGMA * DVec3::from_array([0; 3].map(|_| rng.sample::<f64, _>(StandardNormal))));
    }
    set_of(points, normals)
}

/// One scan.
pub(super) fn set_of(points: Vec<DVec3>, normals: Vec<DVec3>) -> ScanSet {
    let scan = Scan { name: "object".to_owned(), points, normals: Some(normals), ..Scan::default() };
    let sensor = Sensor { noise: Some(Noise::Isotropic { sigma: SIGMA }), ..Sensor::default() };
    ScanSet {
        unit: Some(Unit::Millimetre),
        sensors: vec![sensor],
        scans: vec![PosedScan { scan, sensor: 0, sigma_translation: None, sigma_rotation_deg: None }],
        ..ScanSet::default()
    }
}

fn fitted(count: usize, seed: u64) -> Fit {
    let strategy = Strategy::Global(GlobalOptions::default());
    fit(&scan(count, seed), &FitOptions { strategy, ..FitOptions::default() }, &Silent).unwrap()
}

#[test]
fn two_rings_are_fitted_and_covered() {
    let made = fitted(10_000, 1);
    let model = &made.model;
    let domain = model.surface.space().domain().expect("a ball has no handles");
    assert_eq!((domain.genus(), domain.components(), domain.borders()), (2, 1, 0));
    assert_eq!(made.report.verdict, FitVerdict::Converged);
    let mesh = mesh_from_model(model, &made.posterior(), Some(0.1)).unwrap();
    let check = mesh.mesh.check();
    assert!(check.watertight && check.euler_characteristic == -2);
    let errors = mesh.mesh.positions.iter().map(|p| {
        let (height, slope) = two_rings(*p);
        (height / slope.length()).abs()
    });
    let covered = errors.zip(&mesh.sigma).filter(|(error, sigma)| *error < 1.96 * **sigma).count();
    let share = covered as f64 / mesh.sigma.len() as f64;
    println!("{} coefficients, covered {share:.3}", made.report.coefficients);
    assert!((0.9..0.99).contains(&share), "{share}");
}

#[test]
fn models_over_quads_are_saved_and_exported() {
    let made = fitted(3_000, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rings.planish");
    crate::saved::save(&made.model, &[], &path).unwrap();
    let read = crate::saved::load(&path).unwrap();
    assert_eq!(read.surface.space().leaves(), made.model.surface.space().leaves());
    assert_eq!(read.surface.vertices(), made.model.surface.vertices());
    let brep = brep_from_model(&read, Closing::Auto, &BrepOptions::default());
    brep.check(1e-6).unwrap();
    let domain = read.surface.space().domain().unwrap();
    assert!(brep.closed && 4 * brep.faces.len() < domain.cells().len());
    // A closed surface of genus 2: V − E + F = −2.
    assert_eq!(brep.vertices.len() as i64 - brep.edges.len() as i64 + brep.faces.len() as i64, -2);
}

/// The point of two rings nearest to `p`, along the gradient.
fn on_two_rings(mut p: DVec3) -> DVec3 {
    for _ in 0..8 {
        let (height, slope) = two_rings(p);
        p -= height / slope.length_squared() * slope;
    }
    p
}

/// Root mean square distance of a surface from the two rings, over all of its leaves and over those that are
/// no pieces of cells at extraordinary vertices.
fn distances_from_two_rings(surface: &Surface) -> [f64; 2] {
    let areas = leaf_areas(surface);
    let places = [0.5 - 0.15_f64.sqrt(), 0.5, 0.5 + 0.15_f64.sqrt()];
    let (mut squares, mut area) = ([0.0; 2], [0.0; 2]);
    for (leaf, own) in areas.iter().enumerate() {
        let mut mean = 0.0;
        for (s, t) in places.iter().flat_map(|s| places.map(|t| (*s, t))) {
            let (height, slope) = two_rings(surface.leaf_jet(leaf, s, t).point);
            mean += height * height / slope.length_squared() / 9.0;
        }
        for which in 0..if is_piece(surface.space(), leaf) { 1 } else { 2 } {
            squares[which] += own * mean;
            area[which] += own;
        }
    }
    [0, 1].map(|k| f64::sqrt(squares[k] / area[k]))
}

/// Prints the table of the book: `cargo test -p planish-surface --lib -- --nocapture distances_fall`.
#[test]
fn distances_fall_with_the_size_of_cells() {
    let bounds = BoundingBox { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let mesh = isosurface(&bounds, 2.0, |p| two_rings(p).0, |_, _| true).unwrap();
    let meshed = LayoutMesh::new(mesh, 200).unwrap();
    let mut layout = meshed.divided(&meshed.layout(100).unwrap()).unwrap();
    let mut found = Vec::new();
    for _ in 0..4 {
        layout.positions.iter_mut().for_each(|p| *p = on_two_rings(*p));
        let space = Arc::new(Hierarchy::over(Arc::new(layout.domain.clone())).unwrap());
        let cells = layout.domain.cells().len();
        let start = Surface::new(space, layout.positions.clone()).unwrap();
        let draft = Draft { meshed: &meshed, finest: 0, layouts: vec![layout.clone()] };
        let made = draft.interpolating(draft.interpolating(start, 0.0).unwrap(), 0.0).unwrap();
        found.push((cells, distances_from_two_rings(&made)));
        let division = layout.domain.divided().unwrap();
        layout = Layout { positions: division.apply(&layout.positions), domain: division.domain };
    }
    let order = |k: usize, which: usize| (found[k - 1].1[which] / found[k].1[which]).log2();
    for (k, (cells, [all, regular])) in found.iter().enumerate() {
        let orders = if k == 0 { [f64::NAN; 2] } else { [order(k, 0), order(k, 1)] };
        println!("| {cells} | {all:.2e} | {:.1} | {regular:.2e} | {:.1} |", orders[0], orders[1]);
    }
    // Cells at extraordinary vertices have order 2 and shrink, so their share of the mean square is order 3.
    assert!(order(2, 0) > 2.8 && order(3, 0) > 2.5, "{found:?}");
    assert!(order(2, 1) > 3.7 && order(3, 1) > 3.0, "{found:?}");
}

/// Points all over a pipe of radius 1 and length 2 with a thin wall, with normals.
fn pipe(count: usize, wall: f64) -> (Vec<DVec3>, Vec<DVec3>) {
    let rim = wall * (1.0 - 0.5 * wall);
    let all = 2.0 + 2.0 * (1.0 - wall) + 2.0 * rim;
    let (across, side) = (DVec3::new(0.8, 0.0, -0.6), DVec3::new(-0.48, 0.6, -0.64));
    let axis = across.cross(side);
    (0..count)
        .map(|k| {
            let [u, v, w] = [0.618_034, 0.754_878, 0.569_840].map(|step| (k as f64 * step).fract());
            let angle = TAU * v;
            let out = angle.cos() * across + angle.sin() * side;
            match all * u {
                at if at < 2.0 => (out + (2.0 * w - 1.0) * axis, out),
                at if at < all - 2.0 * rim => ((1.0 - wall) * out + (2.0 * w - 1.0) * axis, -out),
                at => {
                    let end = if at < all - rim { axis } else { -axis };
                    ((1.0 - wall * w) * out + end, end)
                }
            }
        })
        .unzip()
}

#[test]
fn a_wall_of_two_grid_cells_has_no_handles_between_its_sides() {
    // Wall 0.08, grid cells 0.046.
    let (points, normals) = pipe(5000, 0.08);
    let mesh = enclosing_mesh(&points, &normals, Handles::AsSeen).unwrap().mesh;
    assert_eq!(bodies_and_handles(&mesh), Some(BodiesAndHandles { components: 1, genus: 1 }));
    // A level set that leaves the grid has a border, and no layout takes it.
    let open = TriangleMesh { triangles: mesh.triangles[1..].to_vec(), ..mesh };
    assert_eq!(bodies_and_handles(&open), None);
}
