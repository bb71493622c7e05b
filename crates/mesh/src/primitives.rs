//! Simple bodies of known shape, for tests, examples and simulated scenes.
//!
//! In: sizes in the unit of the model, and counts. Out: meshes centred at the origin that face outwards
//! (sheets face +z). Not guaranteed: a faceted ball or cylinder has a smaller area and volume than the smooth
//! one.

use planish_core::DVec3;
use std::collections::HashMap;
use std::f64::consts::TAU;

use crate::mesh::TriangleMesh;
use crate::triangle::unit_or_zero;

/// A watertight ball of `20 · 4^subdivisions` triangles with vertices on the sphere.
///
/// The maximum chord error is about `0.3 · 4^-subdivisions · radius`.
///
/// # Examples
/// ```
/// let ball = planish_mesh::icosphere(2.0, 3);
/// assert_eq!(ball.triangles.len(), 20 * 64);
/// assert!(ball.check().watertight);
/// ```
#[must_use]
pub fn icosphere(radius: f64, subdivisions: u32) -> TriangleMesh {
    // The corners of a regular icosahedron are those of three golden rectangles.
    let g = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut positions: Vec<DVec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(|p| unit_or_zero(DVec3::from_array(p)))
    .to_vec();
    let mut triangles: Vec<[u32; 3]> = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ]
    .to_vec();
    for _ in 0..subdivisions {
        // The two triangles at an edge share its middle vertex, which keeps the mesh watertight.
        let mut middles = HashMap::with_capacity(triangles.len() * 3 / 2);
        let mut finer = Vec::with_capacity(triangles.len() * 4);
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    positions.push(unit_or_zero(positions[i as usize] + positions[j as usize]));
                    (positions.len() - 1) as u32
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    TriangleMesh { positions: positions.into_iter().map(|p| radius * p).collect(), triangles }
}

/// A flat sheet in the plane z = 0 with `columns × rows` rectangles of two triangles each.
///
/// There is at least one column and one row. Vertex `i + (columns + 1) j` lies in column `i` (along x) and
/// row `j` (along y).
///
/// # Examples
/// ```
/// let sheet = planish_mesh::grid_sheet(2.0, 3.0, 4, 5);
/// assert_eq!((sheet.positions.len(), sheet.triangles.len()), (5 * 6, 2 * 4 * 5));
/// ```
#[must_use]
pub fn grid_sheet(width: f64, height: f64, columns: usize, rows: usize) -> TriangleMesh {
    // A sheet without cells would have no triangles, which no search accepts.
    let (columns, rows) = (columns.max(1), rows.max(1));
    let positions = (0..=rows)
        .flat_map(|j| {
            (0..=columns).map(move |i| {
                let (x, y) = (i as f64 / columns as f64 - 0.5, j as f64 / rows as f64 - 0.5);
                DVec3::new(width * x, height * y, 0.0)
            })
        })
        .collect();
    let at = |i: usize, j: usize| (i + (columns + 1) * j) as u32;
    let triangles = (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i, j)))
        .flat_map(|(i, j)| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        })
        .collect();
    TriangleMesh { positions, triangles }
}

/// A closed parallelepiped around `center` with the given edges.
///
/// It faces outwards if the edges are right-handed. Vertex `k` lies at the end of edge `d` if bit `d` of `k`
/// is set, else at its start.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// let edges = [DVec3::X, 2.0 * DVec3::Y, 3.0 * DVec3::Z];
/// let block = planish_mesh::parallelepiped(DVec3::ZERO, edges);
/// assert_eq!(block.signed_volume(), Some(6.0));
/// ```
#[must_use]
pub fn parallelepiped(center: DVec3, edges: [DVec3; 3]) -> TriangleMesh {
    let corner = |k: u32| {
        (0..3).fold(center, |p, d| {
            let half = if k >> d & 1 == 1 { 0.5 } else { -0.5 };
            p + half * edges[d]
        })
    };
    TriangleMesh {
        positions: (0..8).map(corner).collect(),
        // Vertex numbers are bits of x, y and z. Each pair of rows is one side, counter-clockwise from
        // outside.
        triangles: vec![
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ],
    }
}

/// A cylinder around the z axis from `−height/2` to `height/2`.
///
/// It has `segments` (at least 3) around and `rings` (at least 1) along the axis. `capped` makes it
/// watertight.
///
/// # Examples
/// ```
/// use planish_mesh::cylinder;
/// assert!(cylinder(1.0, 3.0, 12, 2, true).check().watertight);
/// assert_eq!(cylinder(1.0, 3.0, 12, 2, false).check().boundary_loops, 2);
/// ```
#[must_use]
pub fn cylinder(radius: f64, height: f64, segments: usize, rings: usize, capped: bool) -> TriangleMesh {
    let (segments, rings) = (segments.max(3), rings.max(1));
    let mut positions: Vec<DVec3> = (0..=rings)
        .flat_map(|j| {
            (0..segments).map(move |i| {
                let (sin, cos) = (TAU * i as f64 / segments as f64).sin_cos();
                DVec3::new(radius * cos, radius * sin, height * (j as f64 / rings as f64 - 0.5))
            })
        })
        .collect();
    // The last segment ends at the first vertices, so there is no seam of doubled vertices.
    let at = |i: usize, j: usize| (i % segments + segments * j) as u32;
    let mut triangles = Vec::with_capacity(2 * segments * (rings + 1));
    for j in 0..rings {
        for i in 0..segments {
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    if capped {
        // A fan around a vertex on the axis; one around a vertex of the rim would have slivers.
        let bottom = positions.len() as u32;
        positions.extend([-0.5 * height * DVec3::Z, 0.5 * height * DVec3::Z]);
        for i in 0..segments {
            triangles.push([bottom, at(i + 1, 0), at(i, 0)]);
            triangles.push([bottom + 1, at(i, rings), at(i + 1, rings)]);
        }
    }
    TriangleMesh { positions, triangles }
}
