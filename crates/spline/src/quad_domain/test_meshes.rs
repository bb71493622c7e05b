//! Meshes of quads for tests.

use planish_core::DVec3;
use std::collections::{BTreeSet, HashMap};

/// A grid of quads, with vertex `j · columns + i` at (i, j).
#[must_use]
pub fn grid(columns: usize, rows: usize, periodic: bool) -> Vec<[u32; 4]> {
    let (width, height) = if periodic { (columns, rows) } else { (columns + 1, rows + 1) };
    let at = |i: usize, j: usize| (j % height * width + i % width) as u32;
    let cell = |k: usize| (k % columns, k / columns);
    (0..columns * rows)
        .map(cell)
        .map(|(i, j)| [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)])
        .collect()
}

/// The faces of a set of unit cubes, and the positions of their vertices. Cubes may not meet in an edge only.
#[must_use]
pub fn voxels(cubes: &[[i32; 3]]) -> (Vec<[u32; 4]>, Vec<DVec3>) {
    open_voxels(cubes, |_, _| false)
}

/// [`voxels`] without the faces of a cube across an axis for which `is_open` is true.
pub fn open_voxels(
    cubes: &[[i32; 3]],
    is_open: impl Fn([i32; 3], usize) -> bool,
) -> (Vec<[u32; 4]>, Vec<DVec3>) {
    let all: BTreeSet<[i32; 3]> = cubes.iter().copied().collect();
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let mut quads = Vec::new();
    for &cube in &all {
        for axis in 0..3 {
            for side in [0, 1] {
                let mut beyond = cube;
                beyond[axis] += 2 * side - 1;
                if all.contains(&beyond) || is_open(cube, axis) {
                    continue;
                }
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let mut turns = [[0, 0], [1, 0], [1, 1], [0, 1]];
                if side == 0 {
                    turns.reverse();
                }
                quads.push(turns.map(|[p, q]| {
                    let mut corner = cube;
                    corner[axis] += side;
                    corner[b] += p;
                    corner[c] += q;
                    let next = numbers.len() as u32;
                    *numbers.entry(corner).or_insert(next)
                }));
            }
        }
    }
    let mut positions = vec![DVec3::ZERO; numbers.len()];
    for (corner, number) in numbers {
        positions[number as usize] = DVec3::from_array(corner.map(f64::from));
    }
    (quads, positions)
}

/// A plate with two holes.
#[must_use]
pub fn two_holes() -> (Vec<[u32; 4]>, Vec<DVec3>) {
    let cubes = (0..15).map(|k| [k % 5, k / 5, 0]).filter(|c| c[1] != 1 || c[0] % 2 == 0);
    voxels(&cubes.collect::<Vec<_>>())
}
