//! Topology of the solid that the readings enclose: separate bodies and handles.
//!
//! Input: oriented readings. Output: numbers of bodies and handles of the level set of their [`Indicator`],
//! which shows what a ball cannot follow.
//!
//! The cells inside form a cubical complex with one vertex for each cell. Its Euler characteristic
//! `χ = V − E + F − C` counts edges between neighbours, squares of four and cubes of eight cells that are all
//! inside. With `b₀` bodies and `b₂` enclosed cavities, the number of handles is `b₁ = b₀ + b₂ − χ`. Noise
//! makes small handles at one level that are gone at another, so the smallest number over three levels
//! counts. That of a single level counts only with other evidence.
//!
//! Not guaranteed: holes narrower than about three grid cells, which is 5 % of the size of the cloud.

use super::indicator::{BlurredIndicator, Indicator, MIN_BLUR_CELLS};
use planish_core::{DVec3, DisjointSets};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Smallest body, as a share of the volume of all.
const MIN_BODY: f64 = 0.01;
/// Distance of the levels from that of the points, in grid cells of the steepest slope.
const LEVEL_SHIFT_CELLS: f64 = 0.75;

/// A point has left the solid's surface if the indicator differs from the level by this share of its jump,
/// and its slope is at most this share of that at the points: further than about 1.5 cells inside or outside.
const STRAY_DIFFERENCE: f64 = 0.7;
const STRAY_SLOPE: f64 = 0.3;

/// What the readings enclose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct EnclosedTopology {
    /// Separate solids.
    pub bodies: usize,
    /// Handles of all bodies: one for each hole through them.
    pub handles: usize,
}

impl EnclosedTopology {
    /// True if a ball can have it.
    pub(super) fn is_ball(self) -> bool {
        self.bodies <= 1 && self.handles == 0
    }
}

/// The solid that points with outward normals enclose.
pub(super) struct EnclosedSolid {
    field: BlurredIndicator,
    level: f64,
    /// Slope of the indicator at the points, and its difference between inside and the level.
    steepness: f64,
    jump: f64,
    /// The smallest numbers of bodies and of handles over the levels.
    pub topology: EnclosedTopology,
    /// The simplest topology of a level that a ball does not have; `topology` if there is none.
    pub at_any_level: EnclosedTopology,
}

impl EnclosedSolid {
    pub(super) fn new(points: &[DVec3], normals: &[DVec3]) -> Self {
        let indicator = Indicator::new(points, normals);
        let field = indicator.blurred(MIN_BLUR_CELLS * indicator.cell());
        let level = field.level(points);
        let steepness = field.steepness(points);
        let step = indicator.cell() * steepness;
        let levels = [0.0, -LEVEL_SHIFT_CELLS, LEVEL_SHIFT_CELLS];
        let at: Vec<EnclosedTopology> =
            levels.par_iter().map(|shift| topology(&field, level + shift * step)).collect();
        let topology = EnclosedTopology {
            bodies: at.iter().map(|found| found.bodies).min().unwrap_or(0),
            handles: at.iter().map(|found| found.handles).min().unwrap_or(0),
        };
        let other = at.iter().copied().filter(|found| !found.is_ball());
        let at_any_level = other.min_by_key(|found| found.bodies + found.handles).unwrap_or(topology);
        let jump = field.inside() - level;
        Self { field, level, steepness, jump, topology, at_any_level }
    }

    /// True if a point is far from the surface of the solid, inside or outside: a film across a hole, or two
    /// ends of a surface that meet.
    pub(super) fn is_stray(&self, point: DVec3) -> bool {
        let (value, gradient) = self.field.sample(point);
        (value - self.level).abs() > STRAY_DIFFERENCE * self.jump
            && gradient.length() < STRAY_SLOPE * self.steepness
    }
}

/// The topology of the cells above a level.
fn topology(field: &BlurredIndicator, level: f64) -> EnclosedTopology {
    let (values, cells) = field.grid_values();
    // The grid reaches far beyond the points, where it is periodic: only its middle is of interest.
    let margin = cells / 8;
    let n = cells - 2 * margin;
    let is_inside = |k: usize| {
        let [a, b, c] = [k % n, k / n % n, k / n / n];
        let on_border = [a, b, c].iter().any(|&x| x == 0 || x + 1 == n);
        !on_border && values[((c + margin) * cells + b + margin) * cells + a + margin] > level
    };
    let mut inside: Vec<bool> = (0..n.pow(3)).map(is_inside).collect();
    let bodies = keep_large_bodies(&mut inside, n);
    let cavities = components(&inside, n, false).len().saturating_sub(1);
    let handles = (bodies + cavities) as i64 - euler_characteristic(&inside, n);
    EnclosedTopology { bodies, handles: handles.max(0) as usize }
}

/// Removes small bodies, and returns the number of those that are left.
fn keep_large_bodies(inside: &mut [bool], n: usize) -> usize {
    let bodies = components(inside, n, true);
    let volume: usize = bodies.iter().map(Vec::len).sum();
    let (large, small): (Vec<_>, Vec<_>) =
        bodies.into_iter().partition(|body| body.len() as f64 >= MIN_BODY * volume as f64);
    small.into_iter().flatten().for_each(|k| inside[k as usize] = false);
    large.len()
}

/// The connected components of the cells that are `wanted`: inside by faces, outside by corners as well, so
/// that each is the complement of the other.
fn components(inside: &[bool], n: usize, wanted: bool) -> Vec<Vec<u32>> {
    let mut sets = DisjointSets::new(inside.len());
    // Neighbours with a smaller number: three by faces, thirteen by faces, edges and corners.
    let offsets: Vec<[i64; 3]> = (-1..=1_i64)
        .flat_map(|c| (-1..=1).flat_map(move |b| (-1..=1).map(move |a| [a, b, c])))
        .filter(|d| d[0] + 3 * d[1] + 9 * d[2] < 0)
        .filter(|d| !wanted || d.iter().map(|x| x.abs()).sum::<i64>() == 1)
        .collect();
    for k in 0..inside.len() {
        if inside[k] != wanted {
            continue;
        }
        let at = [k % n, k / n % n, k / n / n].map(|c| c as i64);
        for d in &offsets {
            let other = [0, 1, 2].map(|axis| at[axis] + d[axis]);
            if other.iter().all(|&c| c >= 0 && c < n as i64) {
                let j = (other[2] as usize * n + other[1] as usize) * n + other[0] as usize;
                if inside[j] == wanted {
                    sets.join(j as u32, k as u32);
                }
            }
        }
    }
    let mut all: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (k, root) in (0..).zip(sets.into_roots()) {
        if inside[k as usize] == wanted {
            all.entry(root).or_default().push(k);
        }
    }
    all.into_values().collect()
}

/// `V − E + F − C` of the cells inside.
fn euler_characteristic(inside: &[bool], n: usize) -> i64 {
    let mut sum = 0_i64;
    for c in 0..n - 1 {
        for b in 0..n - 1 {
            for a in 0..n - 1 {
                let cell = |i: usize, j: usize, k: usize| inside[((c + k) * n + b + j) * n + a + i];
                if !cell(0, 0, 0) {
                    continue;
                }
                let (x, y, z) = (cell(1, 0, 0), cell(0, 1, 0), cell(0, 0, 1));
                let (xy, xz, yz) =
                    (x && y && cell(1, 1, 0), x && z && cell(1, 0, 1), y && z && cell(0, 1, 1));
                let cube = xy && xz && yz && cell(1, 1, 1);
                let count = |all: [bool; 3]| all.iter().filter(|is| **is).count() as i64;
                sum += 1 - count([x, y, z]) + count([xy, xz, yz]) - i64::from(cube);
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn torus(n: usize, centre: DVec3) -> (Vec<DVec3>, Vec<DVec3>) {
        (0..n)
            .map(|k| {
                let (u, v) = (TAU * (k as f64 * 0.618_034).fract(), TAU * (k as f64 * 0.754_878).fract());
                let outwards = DVec3::new(u.cos(), u.sin(), 0.0);
                let normal = v.cos() * outwards + v.sin() * DVec3::Z;
                (centre + 3.0 * outwards + normal, normal)
            })
            .unzip()
    }

    fn ball(n: usize, centre: DVec3) -> (Vec<DVec3>, Vec<DVec3>) {
        (0..n)
            .map(|k| {
                let z = 1.0 - 2.0 * (k as f64 + 0.5) / n as f64;
                let (s, c) = (k as f64 * 2.399_963).sin_cos();
                let normal = DVec3::new((1.0 - z * z).sqrt() * c, (1.0 - z * z).sqrt() * s, z);
                (centre + normal, normal)
            })
            .unzip()
    }

    #[test]
    fn bodies_and_handles_are_counted() {
        let count = |(points, normals): (Vec<DVec3>, Vec<DVec3>)| {
            let found = EnclosedSolid::new(&points, &normals).topology;
            (found.bodies, found.handles)
        };
        let both = |a: (Vec<DVec3>, Vec<DVec3>), b: (Vec<DVec3>, Vec<DVec3>)| {
            ([a.0, b.0].concat(), [a.1, b.1].concat())
        };
        assert_eq!(count(ball(4000, DVec3::ZERO)), (1, 0));
        assert_eq!(count(torus(8000, DVec3::ZERO)), (1, 1));
        assert_eq!(count(both(ball(3000, DVec3::ZERO), ball(3000, 3.5 * DVec3::X))), (2, 0));
        assert_eq!(count(both(torus(6000, DVec3::ZERO), ball(3000, 6.0 * DVec3::X))), (2, 1));
    }
}
