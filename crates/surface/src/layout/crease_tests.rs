//! Layouts of meshes with creases.

use super::network::CreaseNetwork;
use super::test_shapes::{shape, with_sharp_edges};
use super::*;
use planish_estimate::ErrorKind;
use planish_exchange::mesh::read_mesh;
use std::path::PathBuf;

/// Largest distance of points on some segments from others.
fn farthest(from: &[[DVec3; 2]], to: &[[DVec3; 2]]) -> f64 {
    let distance = |p: DVec3, [a, b]: [DVec3; 2]| {
        let way = b - a;
        p.distance(a + ((p - a).dot(way) / way.length_squared()).clamp(0.0, 1.0) * way)
    };
    let points = from.iter().flat_map(|&[a, b]| [a, 0.5 * (a + b)]);
    points
        .map(|p| to.iter().map(|&segment| distance(p, segment)).fold(f64::INFINITY, f64::min))
        .fold(0.0, f64::max)
}

/// What a layout of a creased mesh has to be.
struct Judged {
    domain: QuadDomain,
    /// Quads whose normal is opposite to that of the mesh, or that have a corner of 180° or more.
    turned_over: usize,
}

/// Makes a layout and divides it. Both have the topology of the mesh and all its creases, and no others.
fn judge(creased: &CreasedMesh, quads: usize) -> Judged {
    let meshed = LayoutMesh::with_creases(creased.clone(), quads).unwrap();
    let mesh = &creased.mesh;
    let genus = 1 - mesh.check().euler_characteristic / 2;
    let layout = meshed.layout(quads).unwrap();
    let finer = meshed.divided(&layout).unwrap();
    let side = (mesh.area() / layout.domain.cells().len() as f64).sqrt();
    for (made, side) in [(&layout, side), (&finer, 0.5 * side)] {
        assert_eq!((made.domain.genus() as i64, made.domain.borders()), (genus, 0));
        let segments = |edges: &[[u32; 2]], at: &[DVec3]| -> Vec<[DVec3; 2]> {
            edges.iter().map(|edge| edge.map(|v| at[v as usize])).collect()
        };
        let of_mesh = segments(&creased.creases, &mesh.positions);
        let of_layout = segments(made.domain.creases(), &made.positions);
        let gaps = [farthest(&of_mesh, &of_layout), farthest(&of_layout, &of_mesh)];
        assert!(gaps.iter().all(|gap| *gap < 0.3 * side), "{gaps:?} from creases, quads of {side}");
        let network = CreaseNetwork::new(creased).unwrap();
        let corners = network.corner_positions();
        assert!(corners.iter().all(|corner| made.positions.contains(corner)), "a corner is not kept");
    }
    planish_spline::Hierarchy::over(finer.domain.clone().into()).unwrap();
    let is_turned_over = |quad: &&[u32; 4]| {
        let corners = quad.map(|v| finer.positions[v as usize]);
        let [a, b, c, d] = corners;
        let normal = (c - a).cross(d - b);
        let on = meshed.search.closest_compatible(0.25 * (a + b + c + d), normal, 1.0);
        on.is_none_or(|on| on.distance > side)
            || (0..4).any(|k| {
                let [p, q] = [1, 3].map(|j| corners[(k + j) % 4] - corners[k]);
                p.cross(q).dot(normal) <= 0.0
            })
    };
    let turned_over = finer.domain.cells().iter().filter(is_turned_over).count();
    Judged { domain: layout.domain, turned_over }
}

#[test]
fn layouts_keep_the_creases_of_solids() {
    for name in ["box", "plate", "bracket", "cylinder", "sharp", "cone", "ridge"] {
        for quads in [100, 400] {
            let found = judge(&shape(name), quads);
            let count = found.domain.cells().len();
            assert!((quads / 2..2 * quads).contains(&count), "{name}: {count} quads");
            assert_eq!(found.turned_over, 0, "{name}, {quads} quads");
        }
    }
}
