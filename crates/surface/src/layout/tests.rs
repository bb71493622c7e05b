//! Layouts of closed surfaces.

use super::*;
use planish_core::BoundingBox;
use planish_mesh::{icosphere, isosurface};

/// The zero surface of a function that is negative inside.
fn surface_of(value: impl Fn(DVec3) -> f64 + Sync, reach: f64, cell: f64) -> TriangleMesh {
    let bounds = BoundingBox { min: DVec3::splat(-reach), max: DVec3::splat(reach + 0.37 * cell) };
    isosurface(&bounds, cell, value, |_, _| true).unwrap()
}

/// Distance from a ring around an axis through a centre.
fn ring(p: DVec3, centre: DVec3, axis: DVec3, radius: f64) -> f64 {
    let p = p - centre;
    let along = p.dot(axis);
    ((p - along * axis).length() - radius).hypot(along)
}

/// Rings in a row, each touching the next: a chain has one handle for each.
fn chain(count: usize) -> TriangleMesh {
    let centre = |k: usize| DVec3::new(2.0 * k as f64 - count as f64 + 1.0, 0.05 * k as f64, 0.0);
    let nearest =
        |p: DVec3| (0..count).map(|k| ring(p, centre(k), DVec3::Z, 1.0)).fold(f64::INFINITY, f64::min);
    surface_of(|p| nearest(p) - 0.35, count as f64 + 0.6, 0.09)
}

/// Layouts have the topology of the mesh, no quad is turned over, and few vertices are extraordinary.
fn check(mesh: TriangleMesh, genus: usize, quads: usize) {
    let meshed = LayoutMesh::new(mesh, quads).unwrap();
    let layout = meshed.layout(quads).unwrap();
    assert_eq!((layout.domain.genus(), layout.domain.components()), (genus, 1));
    let extraordinary = layout.domain.extraordinary_vertices().len();
    let most = 16 + 16 * genus + quads / 10;
    assert!(extraordinary <= most, "{extraordinary} extraordinary vertices, genus {genus}, {quads} quads");
    let count = layout.domain.cells().len();
    assert!((quads / 2..2 * quads).contains(&count), "{count} quads");
    let finer = meshed.divided(&layout).unwrap();
    for quad in finer.domain.cells() {
        let [a, b, c, d] = quad.map(|v| finer.positions[v as usize]);
        let normal = (c - a).cross(d - b);
        let on = meshed.search.closest(0.25 * (a + b + c + d)).unwrap();
        assert!(normal.dot(on.normal) > 0.0, "a quad at {:?} is turned over", on.point);
    }
}

#[test]
fn spheres_and_chains_of_rings_are_covered() {
    check(icosphere(10.0, 5), 0, 100);
    check(icosphere(10.0, 5), 0, 1000);
    for count in 1..4 {
        check(chain(count), count, 150 * count);
        check(chain(count), count, 1000);
    }
}
