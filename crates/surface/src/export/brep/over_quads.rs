//! Faces of a surface over quads: one for each.
//!
//! A face has the cells of the finest leaf of its quad. Inside of a quad with an extraordinary vertex, the
//! surface has continuous derivatives only; there, knots are triple, so that each piece keeps its
//! coefficients.

use super::{border_curve, clamp_ends, encloses_positive_volume};
use planish_core::DVec3;
use planish_exchange::step::{Brep, BrepEdge, BrepFace, BsplineSurface};
use planish_spline::{Cell, QuadDomain, Surface, cubic_bezier};
use std::collections::HashMap;

/// The faces of all quads of a domain.
pub(super) fn brep(surface: &Surface, domain: &QuadDomain) -> Brep {
    let closed = domain.borders() == 0;
    let outward = !closed || encloses_positive_volume(surface);
    let mut levels = vec![0_u8; domain.cells().len()];
    for cell in surface.space().leaves() {
        let level = &mut levels[(cell.i >> cell.level) as usize];
        *level = cell.level.max(*level);
    }
    let faces: Vec<BsplineSurface> = (domain.cells().iter().zip(&levels).enumerate())
        .map(|(quad, (corners, &level))| {
            let is_special = corners.iter().any(|&v| domain.valence(v) != 4);
            face(surface, quad as u32, level, is_special)
        })
        .collect();
    // Each vertex, and each edge from its finer side; the first of both where they are equal.
    let mut vertices = vec![None; domain.inner_vertex_count()];
    let mut finest: HashMap<(u32, u32), (usize, usize)> = HashMap::new();
    for (quad, corners) in domain.cells().iter().enumerate() {
        for k in 0..4 {
            vertices[corners[k] as usize].get_or_insert_with(|| corner(&faces[quad], k));
            let own = finest.entry(key(corners, k)).or_insert((quad, k));
            if levels[quad] > levels[own.0] {
                *own = (quad, k);
            }
        }
    }
    let vertices: Vec<DVec3> = vertices.into_iter().map(Option::unwrap_or_default).collect();
    let mut sides: Vec<(usize, usize)> = finest.values().copied().collect();
    sides.sort_unstable();
    let mut numbers = HashMap::new();
    let mut edges = Vec::with_capacity(sides.len());
    for (quad, k) in sides {
        let corners = &domain.cells()[quad];
        let (a, b) = (corners[k] as usize, corners[(k + 1) % 4] as usize);
        // The last two sides run against the parameters.
        let (start, end) = if k < 2 { (a, b) } else { (b, a) };
        let mut curve = border_curve(&faces[quad], k % 2, k == 0 || k == 3);
        // Faces of different levels differ in the last digit, so ends are set to the shared vertices.
        let last = curve.poles.len() - 1;
        curve.poles[0] = vertices[start];
        curve.poles[last] = vertices[end];
        numbers.insert(key(corners, k), edges.len());
        edges.push(BrepEdge { curve, start, end });
    }
    let faces = domain.cells().iter().zip(faces).map(|(corners, surface)| {
        let around = (0..4).map(|k| {
            let edge: usize = numbers[&key(corners, k)];
            (edge, (edges[edge].start == corners[k] as usize) == outward)
        });
        let mut around: Vec<(usize, bool)> = around.collect();
        if !outward {
            around.reverse();
        }
        BrepFace { surface, edges: around, holes: Vec::new(), same_sense: outward }
    });
    let faces = faces.collect();
    Brep { vertices, edges, faces, closed }
}

/// The edge at a side of a quad.
fn key(corners: &[u32; 4], k: usize) -> (u32, u32) {
    let (a, b) = (corners[k], corners[(k + 1) % 4]);
    (a.min(b), a.max(b))
}

/// The control point at a corner.
fn corner(surface: &BsplineSurface, k: usize) -> DVec3 {
    let [i, j] = [[0, 0], [1, 0], [1, 1], [0, 1]][k];
    surface.poles[i * (surface.n_u - 1) * surface.n_v + j * (surface.n_v - 1)]
}

/// The face of a quad with cells of a level.
fn face(surface: &Surface, quad: u32, level: u8, is_special: bool) -> BsplineSurface {
    let cells = 1_usize << level;
    let (step, inner) = if is_special { (3, 3) } else { (1, 1) };
    let n = if is_special { 3 * cells + 1 } else { cells + 3 };
    let mut poles = vec![DVec3::ZERO; n * n];
    for j in 0..cells {
        for i in 0..cells {
            let cell = Cell { level, i: (quad << level) + i as u32, j: j as u32 };
            let Some(mut c) = surface.cell_coefficients(cell) else { continue };
            if is_special {
                c = bezier(&c);
            }
            for k in 0..16 {
                poles[(step * i + k % 4) * n + step * j + k / 4] = c[k];
            }
        }
    }
    if !is_special {
        for k in 0..n {
            clamp_ends(&mut poles, k, n, n);
        }
        for k in 0..n {
            clamp_ends(&mut poles, k * n, 1, n);
        }
    }
    let knots = |start: f64| -> Vec<(f64, usize)> {
        let side = 0.5_f64.powi(i32::from(level));
        (0..=cells).map(|k| (start + k as f64 * side, if k == 0 || k == cells { 4 } else { inner })).collect()
    };
    let (knots_u, knots_v) = (knots(f64::from(quad)), knots(0.0));
    BsplineSurface { degree_u: 3, degree_v: 3, knots_u, knots_v, n_u: n, n_v: n, poles }
}

/// Bézier ordinates of a bicubic piece.
fn bezier(c: &[DVec3; 16]) -> [DVec3; 16] {
    let line = |p: [DVec3; 4]| -> [DVec3; 4] {
        let of = [0, 1, 2].map(|d| cubic_bezier(p.map(|p| p[d])));
        std::array::from_fn(|k| DVec3::new(of[0][k], of[1][k], of[2][k]))
    };
    let rows: [[DVec3; 4]; 4] = std::array::from_fn(|r| line(std::array::from_fn(|k| c[4 * r + k])));
    let columns: [[DVec3; 4]; 4] = std::array::from_fn(|k| line(std::array::from_fn(|r| rows[r][k])));
    std::array::from_fn(|k| columns[k % 4][k / 4])
}
