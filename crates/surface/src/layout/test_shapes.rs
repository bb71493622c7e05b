//! Closed meshes with creases.

use super::CreasedMesh;
use planish_core::DVec3;
use planish_mesh::TriangleMesh;
use std::collections::HashMap;
use std::f64::consts::TAU;

/// Marks the edges at which the normal turns by more than an angle, and as corners the vertices at which a
/// crease turns by more than 45°.
pub(crate) fn with_sharp_edges(mesh: TriangleMesh, angle_deg: f64) -> CreasedMesh {
    let normals = mesh.face_normals();
    let opposite = mesh.opposite_half_edges();
    let end = |half: usize| mesh.triangles[half / 3][half % 3];
    let mut creases: Vec<[u32; 2]> = (0..opposite.len())
        .filter(|&half| (opposite[half] as usize) > half)
        .filter(|&half| {
            let over = normals[opposite[half] as usize / 3];
            normals[half / 3].dot(over) < angle_deg.to_radians().cos()
        })
        .map(|half| [end(half), end(half / 3 * 3 + (half + 1) % 3)])
        .collect();
    creases.sort_unstable();
    let mut around: HashMap<u32, Vec<u32>> = HashMap::new();
    for &[a, b] in &creases {
        around.entry(a).or_default().push(b);
        around.entry(b).or_default().push(a);
    }
    let way = |v: u32, w: u32| mesh.positions[w as usize] - mesh.positions[v as usize];
    let turns = |v: u32, near: &[u32]| {
        near.len() == 2 && way(v, near[0]).angle_between(way(v, near[1])) < 135.0_f64.to_radians()
    };
    let mut corners: Vec<u32> = around.iter().filter(|(v, near)| turns(**v, near)).map(|(v, _)| *v).collect();
    corners.sort_unstable();
    CreasedMesh { mesh, creases, corners }
}

/// The boundary of some boxes of a grid, with its planes at given coordinates along each axis.
pub(crate) fn blocks(planes: [&[f64]; 3], is_full: impl Fn([i32; 3]) -> bool) -> TriangleMesh {
    let counts = planes.map(|own| own.len() as i32 - 1);
    let inside = |at: [i32; 3]| (0..3).all(|d| (0..counts[d]).contains(&at[d])) && is_full(at);
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let mut number = |at: [i32; 3]| {
        *numbers.entry(at).or_insert_with(|| {
            positions.push(DVec3::from_array([0, 1, 2].map(|d| planes[d][at[d] as usize])));
            positions.len() as u32 - 1
        })
    };
    let [nx, ny, nz] = counts;
    let all = (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| [x, y, z])));
    for at in all.filter(|at| inside(*at)) {
        for (d, side) in (0..3).flat_map(|d| [(d, 0), (d, 1)]) {
            let mut over = at;
            over[d] += 2 * side - 1;
            if inside(over) {
                continue;
            }
            let corner = |u: i32, v: i32| {
                let mut own = at;
                own[d] += side;
                own[(d + 1) % 3] += u;
                own[(d + 2) % 3] += v;
                own
            };
            let quad = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)].map(&mut number);
            let [a, b, c, e] = if side == 1 { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
            triangles.extend([[a, b, c], [a, c, e]]);
        }
    }
    TriangleMesh::try_new(positions, triangles).unwrap()
}

/// A convex polygon in the plane z = 0 as the base of a cylinder.
pub(crate) fn prism(polygon: &[[f64; 2]], height: f64) -> TriangleMesh {
    let count = polygon.len() as u32;
    let level = |z: f64| polygon.iter().map(move |&[x, y]| DVec3::new(x, y, z));
    let middle = level(0.0).sum::<DVec3>() / f64::from(count);
    let mut positions: Vec<DVec3> = level(0.0).chain(level(height)).collect();
    positions.extend([middle, middle + height * DVec3::Z]);
    let mut triangles = Vec::new();
    for k in 0..count {
        let next = (k + 1) % count;
        let (a, b, c, d) = (k, next, count + next, count + k);
        triangles.extend([[a, b, c], [a, c, d], [b, a, 2 * count], [d, c, 2 * count + 1]]);
    }
    TriangleMesh::try_new(positions, triangles).unwrap()
}

pub(crate) fn circle(radius: f64, count: usize) -> Vec<[f64; 2]> {
    let angle = |k: usize| TAU * k as f64 / count as f64;
    (0..count).map(|k| [radius * angle(k).cos(), radius * angle(k).sin()]).collect()
}

/// A cone with a sharp rim.
pub(crate) fn cone(height: f64) -> CreasedMesh {
    let rim = circle(1.0, 48);
    let mut positions: Vec<DVec3> = rim.iter().map(|&[x, y]| DVec3::new(x, y, 0.0)).collect();
    positions.extend([DVec3::ZERO, height * DVec3::Z]);
    let triangles = (0..48).flat_map(|k| [[k, (k + 1) % 48, 49], [(k + 1) % 48, k, 48]]);
    with_sharp_edges(TriangleMesh::try_new(positions, triangles.collect()).unwrap(), 50.0)
}

/// A box with a ridge on its top that fades out in the middle.
pub(crate) fn fading_ridge() -> CreasedMesh {
    let even: Vec<f64> = (0..=16).map(|k| f64::from(k) / 8.0 - 1.0).collect();
    let mut mesh = blocks([&even, &even, &[-0.5, 0.0]], |_| true);
    let mut creased = with_sharp_edges(mesh.clone(), 60.0);
    for p in mesh.positions.iter_mut().filter(|p| p.z == 0.0) {
        p.z = p.x.min(0.0) * p.y.abs() * 0.4 + 0.2;
    }
    let is_ridge = |v: u32| {
        let p = mesh.positions[v as usize];
        p.z > 0.0 && p.y == 0.0 && p.x <= 0.0
    };
    let edges = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    creased.creases.extend(edges.filter(|[a, b]| a < b && is_ridge(*a) && is_ridge(*b)));
    CreasedMesh { mesh, corners: Vec::new(), ..creased }
}

/// A shape by its name.
pub(crate) fn shape(name: &str) -> CreasedMesh {
    let thirds = [0.0, 1.0, 2.0, 3.0];
    let mesh = match name {
        "box" => blocks([&[0.0, 3.0], &[0.0, 2.0], &[0.0, 1.0]], |_| true),
        "plate" => blocks([&thirds, &thirds, &[0.0, 0.6]], |[x, y, _]| [x, y] != [1, 1]),
        "pocket" => blocks([&thirds, &thirds, &[0.0, 0.8, 1.6]], |at| at != [1, 1, 1]),
        "bracket" => blocks([&[0.0, 1.0, 3.0], &[0.0, 2.0], &[0.0, 1.0, 3.0]], |[x, _, z]| x == 0 || z == 0),
        "cylinder" => prism(&circle(1.0, 64), 2.0),
        "sharp" => prism(&[[0.0, 0.0], [3.0, 0.0], [3.0, 3.0 * 30.0_f64.to_radians().tan()]], 1.0),
        "cone" => return cone(1.5),
        "ridge" => return fading_ridge(),
        other => panic!("no shape {other}"),
    };
    with_sharp_edges(mesh, 30.0)
}
