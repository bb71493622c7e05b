//! Faces without a boundary: complete spheres and complete tori.
//!
//! Their loops contain only seams, along which the face borders itself. They are divided by a lattice of
//! their parameters; the seams are ignored.

use super::{Points, WIDEST_CHORD};
use crate::brep::{Face, FaceSurface};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Number of chords of a circle with an error of at most half of a tolerance.
///
/// The errors of both directions add up on a doubly curved surface, so each may have half.
fn around(radius: f64, tolerance: f64) -> usize {
    let widest = 2.0 * (1.0 - (0.5 * tolerance / radius).min(1.0)).acos();
    (TAU / widest.clamp(1e-3, WIDEST_CHORD)).ceil() as usize
}

/// The triangles of a complete sphere or torus; none for other faces.
pub(super) fn triangles(face: &Face, points: &mut Points, tolerance: f64) -> Vec<[u32; 3]> {
    let (columns, rows, is_sphere) = match face.surface {
        FaceSurface::Sphere { radius, .. } => {
            let n = around(radius, tolerance).next_multiple_of(2);
            (n, n / 2, true)
        }
        FaceSurface::Torus { major, minor, .. } => {
            (around(major + minor, tolerance), around(minor, tolerance), false)
        }
        _ => return Vec::new(),
    };
    let surface = face.surface;
    let mut lattice: Vec<Vec<u32>> = Vec::with_capacity(rows + 1);
    for row in 0..if is_sphere { rows + 1 } else { rows } {
        let v = match is_sphere {
            true => -FRAC_PI_2 + TAU / 2.0 * row as f64 / rows as f64,
            false => TAU * row as f64 / rows as f64,
        };
        let is_pole = is_sphere && (row == 0 || row == rows);
        let made = if is_pole { 1 } else { columns };
        let at: Vec<u32> =
            (0..made).map(|k| points.add(surface.point([TAU * k as f64 / columns as f64, v]))).collect();
        lattice.push((0..columns).map(|k| at[k % made]).collect());
    }
    let mut found = Vec::with_capacity(2 * columns * rows);
    for row in 0..rows {
        let (low, high) = (&lattice[row], &lattice[(row + 1) % lattice.len()]);
        for k in 0..columns {
            let next = (k + 1) % columns;
            for [a, b, c] in [[low[k], low[next], high[next]], [low[k], high[next], high[k]]] {
                // At a pole, one side of the lattice square is a point, and one of its triangles is
                // degenerate.
                if a != b && b != c && c != a {
                    found.push(if face.outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    found
}
