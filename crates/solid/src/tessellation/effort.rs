//! Estimates the number of triangles for a tolerance before meshing.

use super::WIDEST_CHORD;
use crate::brep::{Edge, EdgeCurve, FaceSurface, Solid};

/// Maximum number of triangles of a mesh. It bounds memory and time; finer tolerances are rejected.
pub const MAX_TRIANGLES: f64 = 1e6;

/// Approximate number of triangles of a mesh with a chord error of `tolerance`, in the unit of the
/// coordinates.
///
/// A chord over the angle θ has the error `r (1 − cos θ/2)` on an arc of radius r. Edges therefore need of
/// the order of `1/√tolerance` chords, each with a triangle on both sides. Faces curved in two directions
/// need of the order of `1/tolerance` triangles: four times their area over the product of these chords,
/// because the errors of both directions add up.
///
/// ```
/// use planish_solid::brep::Solid;
/// use planish_solid::tessellation::triangles_needed;
///
/// assert_eq!(triangles_needed(&Solid::default(), 0.1), 0.0);
/// ```
#[must_use]
pub fn triangles_needed(solid: &Solid, tolerance: f64) -> f64 {
    let edges: f64 = solid.edges.iter().map(|edge| 2.0 * chords(edge, tolerance)).sum();
    let chord = |radius: f64| radius * widest(radius, tolerance);
    let faces = solid.faces.iter().enumerate().map(|(index, face)| match face.surface {
        FaceSurface::Sphere { radius, .. } => 4.0 * solid.area_of(&[index]) / chord(radius).powi(2),
        FaceSurface::Torus { major, minor, .. } => {
            4.0 * solid.area_of(&[index]) / (chord(major + minor) * chord(minor))
        }
        _ => 0.0,
    });
    edges + faces.sum::<f64>()
}

/// The smallest tolerance for which a mesh needs at most [`MAX_TRIANGLES`], with an accuracy of 1 %.
#[must_use]
pub fn min_tolerance(solid: &Solid) -> f64 {
    let is_enough = |tolerance: f64| triangles_needed(solid, tolerance) <= MAX_TRIANGLES;
    let size = solid.measures().area.abs().sqrt().max(f64::MIN_POSITIVE);
    // Bisection of the logarithm, between 1e-15 and 1 times the size of the solid. The upper end is enough
    // unless the edges alone need more than a million triangles.
    let (mut enough, mut too_fine) = (size.ln(), (1e-15 * size).ln());
    if is_enough(too_fine.exp()) {
        return too_fine.exp();
    }
    while enough - too_fine > 0.01 {
        let middle = (enough + too_fine) / 2.0;
        *(if is_enough(middle.exp()) { &mut enough } else { &mut too_fine }) = middle;
    }
    enough.exp()
}

/// The largest angle of a chord of a circle within the tolerance.
fn widest(radius: f64, tolerance: f64) -> f64 {
    // 2 acos(1 − s) is 2 √(2 s) for small s, where 1 − s has no digits left.
    let share = (tolerance / radius).min(1.0);
    let angle = if share < 1e-8 { 2.0 * (2.0 * share).sqrt() } else { 2.0 * (1.0 - share).acos() };
    angle.min(WIDEST_CHORD)
}

/// Approximate number of chords of an edge.
fn chords(edge: &Edge, tolerance: f64) -> f64 {
    let range = edge.range[1] - edge.range[0];
    match &edge.curve {
        EdgeCurve::Line { .. } => 1.0,
        EdgeCurve::Ellipse { a, .. } => range / widest(a.length(), tolerance),
        EdgeCurve::Spline { .. } => super::chords(edge, tolerance) as f64,
    }
}
