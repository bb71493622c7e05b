//! Layouts of meshes with creases.

use super::test_shapes::{blocks, shape, with_sharp_edges};
use super::*;
use planish_estimate::ErrorKind;
use planish_exchange::mesh::read_mesh;
use std::collections::{BTreeMap, BTreeSet};
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

/// Vertices at which other than two creases meet, and marked ones.
fn corners_of(creased: &CreasedMesh) -> Vec<u32> {
    let mut count: BTreeMap<u32, usize> = BTreeMap::new();
    creased.creases.iter().flatten().for_each(|&v| *count.entry(v).or_default() += 1);
    let is_corner = |(v, count): &(&u32, &usize)| **count != 2 || creased.corners.contains(v);
    count.iter().filter(is_corner).map(|(v, _)| *v).collect()
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
        let is_kept = |v: &u32| made.positions.contains(&mesh.positions[*v as usize]);
        assert!(corners_of(creased).iter().all(is_kept), "a corner is not kept");
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
    // The prism has an edge of 30°, at which quads are narrow.
    for (name, most_special, most_turned_over) in [
        ("box", 0, 0),
        ("plate", 8, 0),
        ("pocket", 28, 0),
        ("bracket", 16, 0),
        ("cylinder", 12, 0),
        ("sharp", 24, 2),
        ("cone", 16, 0),
        ("ridge", 12, 0),
    ] {
        let found = judge(&shape(name), 100);
        let count = found.domain.cells().len();
        assert!((70..160).contains(&count), "{name}: {count} quads");
        assert!(found.turned_over <= most_turned_over, "{name}: {} are turned over", found.turned_over);
        let domain = &found.domain;
        let corners = (0..count).flat_map(|q| (0..4).map(move |k| (q, k)));
        let special: BTreeSet<u32> = corners
            .filter(|&(q, k)| domain.is_extraordinary_corner(q, k))
            .map(|(q, k)| domain.cells()[q][k])
            .collect();
        assert!(special.len() <= most_special, "{name}: {} vertices are not regular", special.len());
    }
}

/// Edges between the quads of a corner of 270° point where the cells of a spline need them: opposite to the
/// creases. Pieces of cells folded there.
#[test]
fn edges_at_concave_corners_have_the_directions_of_their_cells() {
    let meshed = LayoutMesh::with_creases(shape("bracket"), 200).unwrap();
    let made = meshed.divided(&meshed.layout(60).unwrap()).unwrap();
    let at = |v: u32| made.positions[v as usize];
    let on_crease: BTreeSet<u32> = made.domain.creases().iter().flatten().copied().collect();
    let mut tested = 0;
    for fan in made.domain.concave_fans() {
        let ways: Vec<DVec3> = fan.ends.iter().map(|&v| at(v) - at(fan.corner)).collect();
        for (k, [a, b]) in (1..).zip(&fan.shares).filter(|(k, _)| !on_crease.contains(&fan.ends[*k])) {
            let wanted = *a * ways[0] + *b * ways[ways.len() - 1];
            let off = ways[k].angle_between(wanted).to_degrees();
            assert!(off < 8.0, "an edge is {off:.1}° off");
            tested += 1;
        }
    }
    assert!(tested >= 4, "{tested} edges");
}

/// The rims of a cylinder are smooth curves: no vertex is a corner, and two quads lie on each side.
#[test]
fn rims_have_two_quads_on_both_sides() {
    let found = judge(&shape("cylinder"), 100);
    assert!(found.domain.corners().is_empty());
    let rim: BTreeSet<u32> = found.domain.creases().iter().flatten().copied().collect();
    assert!(rim.iter().all(|&v| found.domain.valence(v) == 4));
}

#[test]
fn strips_narrower_than_quads_need_more_quads() {
    let mesh = blocks([&[0.0, 1.0, 1.02, 2.0], &[0.0, 2.0], &[0.0, 0.5, 1.0]], |[x, _, z]| x != 1 || z == 0);
    let creased = with_sharp_edges(mesh, 30.0);
    let layout = |quads| LayoutMesh::with_creases(creased.clone(), quads).unwrap().layout(quads);
    match layout(60) {
        Err(error) => assert_eq!(error.kind(), ErrorKind::Undetermined),
        // The slot is kept: both of its edges are there.
        Ok(made) => {
            assert!(made.positions.iter().any(|p| p.x == 1.0) && made.positions.iter().any(|p| p.x == 1.02))
        }
    }
}

#[test]
fn creases_that_are_no_edges_are_refused() {
    let CreasedMesh { mesh, creases, .. } = shape("cylinder");
    let opposite = |[a, b]: &[u32; 2]| {
        !creases.contains(&[*a, *b])
            && mesh.positions[*a as usize].distance(mesh.positions[*b as usize]) > 1.9
    };
    let count = mesh.positions.len() as u32;
    let wrong = (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b])).find(opposite).unwrap();
    let made = LayoutMesh::with_creases(
        CreasedMesh { mesh: mesh.clone(), creases: vec![wrong], corners: vec![] },
        100,
    );
    let error = made.err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(error.to_string().contains(&format!("{} to {}", wrong[0], wrong[1])), "{error}");
    let lonely = (0..count).find(|v| !creases.iter().flatten().any(|w| w == v)).unwrap();
    let made = LayoutMesh::with_creases(CreasedMesh { mesh, creases, corners: vec![lonely] }, 100);
    assert_eq!(made.err().unwrap().kind(), ErrorKind::Input);
}

/// Meshes of parts, in `../shared/data` beside the repository or in the folder that PLANISH_DATA names.
#[test]
fn layouts_keep_the_creases_of_parts() {
    let data = std::env::var_os("PLANISH_DATA").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")),
        PathBuf::from,
    );
    // At most so many quads of the divided layout are turned over.
    for (file, most) in [("fandisk.obj", 12), ("joint.off", 8), ("rotor_small.off", 4), ("spool.off", 8)] {
        let path = data.join("meshes").join(file);
        if !path.is_file() {
            println!("skipped: {} is not there", path.display());
            continue;
        }
        let read = read_mesh(&path).unwrap();
        let mesh = TriangleMesh::try_new(read.points, read.triangles).unwrap().welded();
        let found = judge(&with_sharp_edges(mesh, 30.0), 1000);
        assert!(found.turned_over <= most, "{file}: {} quads are turned over", found.turned_over);
    }
}
