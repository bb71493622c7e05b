//! The zero surface of a function as a manifold mesh, by marching tetrahedra.
//!
//! In: a function that is negative inside and positive outside, a box, the size of a cell, and a test that
//! excludes cells without the surface. Out: triangles that face outwards.
//!
//! The box is halved recursively where the surface may pass. The smallest cubes are cut into six tetrahedra
//! around their diagonal (H. W. Kuhn 1960), which fit those of the neighbouring cubes. A tetrahedron contains
//! the surface as one or two triangles whose vertices are zeros of the function on its edges.
//!
//! Every vertex belongs to an edge of the grid, and every edge of the mesh to a face of two tetrahedra. The
//! mesh is therefore closed and manifold for any function, unless the surface leaves the box or the test
//! excludes a cell that contains it. Marching cubes lack this property: their ambiguous cases leave holes.
//!
//! Not guaranteed: features smaller than a cell, and well-shaped triangles.
//!
//! # References
//! Doi, Koide, *An efficient method of triangulating equi-valued surfaces by using tetrahedral cells*, IEICE
//! Transactions 1991.

use crate::mesh::TriangleMesh;
use crate::surface_cells::{SurfaceCells, corner_numbers, corner_of};
use planish_core::{BoundingBox, DVec3};
use planish_estimate::Result;
use rayon::prelude::*;

/// Maximum number of evaluations along an edge; only jumps of the function need more than about five.
const MAX_STEPS: usize = 30;
/// Accuracy of a vertex, relative to its edge, or to the difference of the values at the ends of the edge.
const ACCURACY: f64 = 1e-6;
/// Corners of the tetrahedra of a cube, as bits of x, y and z: one tetrahedron for each order of the axes.
///
/// The first three are positively oriented, the others mirrored.
const TETRAHEDRA: [[u32; 4]; 6] =
    [[0, 1, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 2, 3, 7], [0, 4, 6, 7], [0, 1, 5, 7]];
/// Even permutations of four corners, by the corner that comes first.
const SINGLE_CORNER: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
/// Even permutations of four corners, by the pair that comes first.
const PAIRS: [[usize; 4]; 6] =
    [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]];

/// The zero surface of `value` within `bounds`, by cubes of side `cell`.
///
/// `may_pass(middle, reach)` returns whether the surface may pass within `reach` of a point. Where it returns
/// false, nothing is evaluated. Cost: one test for each cube of every size, one value for each corner of the
/// smallest cubes, and about five for each vertex.
///
/// # Errors
/// `Input` for a cell size that is not positive or an empty box; `Unsupported` for more than 40 million
/// cells, or a million along a side.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_mesh::{BoundingBox, isosurface};
/// let bounds = BoundingBox { min: DVec3::splat(-1.2), max: DVec3::splat(1.2) };
/// let height = |p: DVec3| p.length() - 1.0;
/// let ball = isosurface(&bounds, 0.1, height, |p, reach| height(p).abs() <= reach)?;
/// assert!(ball.check().watertight && ball.check().euler_characteristic == 2);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
pub fn isosurface(
    bounds: &BoundingBox,
    cell: f64,
    value: impl Fn(DVec3) -> f64 + Sync,
    may_pass: impl Fn(DVec3, f64) -> bool + Sync,
) -> Result<TriangleMesh> {
    let SurfaceCells { grid, cubes, corners } = SurfaceCells::find(bounds, cell, may_pass)?;
    let values: Vec<f64> = (corners.par_iter()).map(|c| value(grid.place(corner_of(*c)))).collect();
    // The sign is decided once per corner. Zero and NaN count as outside for every cube alike, which
    // keeps the mesh closed.
    let inside: Vec<bool> = values.iter().map(|v| *v < 0.0).collect();
    // Triangles, whose vertices are named by the grid edge that they lie on: a pair of corners, the inner one
    // first. Equal edges are the same vertex, by which the triangles of different cubes join.
    let triangles: Vec<[[u32; 2]; 3]> = (cubes.par_iter())
        .flat_map_iter(|cube| {
            let numbers = corner_numbers(&corners, *cube);
            let mut made = Vec::new();
            let first = inside[numbers[0] as usize];
            if numbers.iter().any(|&c| inside[c as usize] != first) {
                for (t, tetrahedron) in TETRAHEDRA.iter().enumerate() {
                    triangles_of(tetrahedron.map(|c| numbers[c as usize]), &inside, t >= 3, &mut made);
                }
            }
            made
        })
        .collect();
    // Sorting instead of a hash map: vertices get the same numbers for any number of threads.
    let mut edges: Vec<[u32; 2]> = triangles.par_iter().flat_map_iter(|t| t.iter().copied()).collect();
    edges.par_sort_unstable();
    edges.dedup();
    let positions: Vec<DVec3> = (edges.par_iter())
        .map(|edge| {
            let ends = edge.map(|c| (grid.place(corner_of(corners[c as usize])), values[c as usize]));
            zero_between(ends, &value)
        })
        .collect();
    let vertex = |edge: &[u32; 2]| edges.binary_search(edge).unwrap_or(0) as u32;
    Ok(TriangleMesh {
        triangles: triangles.par_iter().map(|t| [vertex(&t[0]), vertex(&t[1]), vertex(&t[2])]).collect(),
        positions,
    })
}

/// Appends the triangles of the surface in a tetrahedron, facing outwards; `mirrored` is its orientation.
fn triangles_of(corners: [u32; 4], inside: &[bool], mirrored: bool, made: &mut Vec<[[u32; 2]; 3]>) {
    let mut push = |[a, b, c]: [[u32; 2]; 3], reverse: bool| {
        made.push(if reverse != mirrored { [a, c, b] } else { [a, b, c] });
    };
    let is = corners.map(|c| inside[c as usize]);
    let count = is.iter().filter(|inside| **inside).count();
    match count {
        1 | 3 => {
            let single_corner = (0..4).find(|&c| is[c] == (count == 1)).unwrap_or(0);
            let [a, b, c, d] = SINGLE_CORNER[single_corner].map(|c| corners[c]);
            let edge = |to: u32| if count == 1 { [a, to] } else { [to, a] };
            push([edge(b), edge(c), edge(d)], count == 3);
        }
        2 => {
            if let Some(pair) = PAIRS.iter().find(|p| is[p[0]] && is[p[1]]) {
                let [a, b, c, d] = pair.map(|c| corners[c]);
                push([[a, c], [a, d], [b, d]], false);
                push([[a, c], [b, d], [b, c]], false);
            }
        }
        _ => {}
    }
}

/// A point between an inner and an outer corner where the value changes its sign.
///
/// The Illinois method (M. Dowell, P. Jarratt 1971): secants, with the value of an end that stays halved.
/// Plain secants would approach the zero of a curved function from one side only, which is slow.
pub(crate) fn zero_between([inside, outside]: [(DVec3, f64); 2], value: impl Fn(DVec3) -> f64) -> DVec3 {
    let at = |share: f64| inside.0 + share * (outside.0 - inside.0);
    let ([mut low, mut high], [mut below, mut above]) = ([0.0, 1.0], [inside.1, outside.1]);
    let small = ACCURACY * (above - below);
    let mut share = 0.5;
    let mut last = 0;
    for _ in 0..MAX_STEPS {
        share = low + (high - low) * below / (below - above);
        // Infinite values give NaN, and jumps can leave the interval: bisection then.
        if !(share > low && share < high) {
            share = 0.5 * (low + high);
        }
        let found = value(at(share));
        if found < 0.0 {
            (low, below) = (share, found);
            above *= if last == 1 { 0.5 } else { 1.0 };
            last = 1;
        } else {
            (high, above) = (share, found);
            below *= if last == 2 { 0.5 } else { 1.0 };
            last = 2;
        }
        if high - low < ACCURACY || found.abs() <= small {
            break;
        }
    }
    at(share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn unit_box(half: f64) -> BoundingBox {
        BoundingBox { min: DVec3::splat(-half), max: DVec3::splat(half) }
    }

    /// The vertices of a ball lie on it, its volume is right within the chord error, and excluding cells
    /// changes nothing.
    #[test]
    fn a_ball_is_exact_at_vertices_with_and_without_culling() {
        let ball = |p: DVec3| p.length() - 1.0;
        let unculled = isosurface(&unit_box(1.3), 0.11, ball, |_, _| true).unwrap();
        let culled =
            isosurface(&unit_box(1.3), 0.11, ball, |at, reach| (at.length() - 1.0).abs() <= reach).unwrap();
        assert_eq!(unculled, culled);
        let check = unculled.check();
        assert!(check.watertight && check.manifold && check.oriented);
        assert_eq!(check.euler_characteristic, 2);
        assert!(unculled.positions.iter().all(|p| (p.length() - 1.0).abs() < 1e-6));
        let volume = unculled.signed_volume().unwrap();
        assert!((volume / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01, "{volume}");
    }

    /// Independent random values at every point are the hardest case for the topology.
    #[test]
    fn noise_has_a_manifold_surface() {
        for seed in 0..5 {
            let noise = |p: DVec3| {
                if p.abs().max_element() > 0.9 {
                    return 1.0;
                }
                let bits = p
                    .to_array()
                    .map(f64::to_bits)
                    .iter()
                    .fold(seed, |h: u64, x| (h ^ x).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (h >> 29));
                ChaCha8Rng::seed_from_u64(bits).random_range(-1.0..1.0)
            };
            let made = isosurface(&unit_box(1.1), 0.2, noise, |_, _| true).unwrap();
            let check = made.check();
            assert!(
                check.watertight
                    && check.oriented
                    && check.nonmanifold_edges == 0
                    && made.triangles.len() > 1000
            );
            assert_eq!(check.nonmanifold_vertices, 0);
        }
    }

    #[test]
    fn invalid_cell_sizes_are_rejected() {
        let value = |p: DVec3| p.length() - 1.0;
        for cell in [0.0, -1.0, f64::NAN, 1e-9] {
            assert!(isosurface(&unit_box(2.0), cell, value, |_, _| true).is_err());
        }
    }
}
