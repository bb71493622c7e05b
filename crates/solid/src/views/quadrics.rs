//! Intersections of planes and cylinders in general position that are lines, circles or ellipses.

use super::surfaces::Curve3;
use crate::brep::{FaceSurface, unit};
use planish_core::DVec3;

/// Directions are parallel below this sine of the angle between them.
///
/// Directions come from coordinates of drawings, so a smaller value would treat parallel faces as crossing
/// far away; a larger one misses intersections of faces at a small angle.
const PARALLEL: f64 = 1e-6;

/// Intersection of two surfaces; `None` if it is not made of lines, circles or ellipses.
///
/// Surfaces that touch within the tolerance share one line.
pub(super) fn quadrics(s: &FaceSurface, t: &FaceSurface, tolerance: f64) -> Option<Vec<Curve3>> {
    match (*s, *t) {
        (
            FaceSurface::Plane { origin, normal, .. },
            FaceSurface::Plane { origin: second, normal: other, .. },
        ) => {
            let direction = normal.cross(other);
            let square = direction.length_squared();
            if square.sqrt() < PARALLEL {
                return Some(Vec::new());
            }
            // The point of both planes that is nearest to the origin of the frame.
            let (d, e) = (normal.dot(origin), other.dot(second));
            let across = d * other - e * normal;
            let at = 1.0 / square * across.cross(direction);
            Some(vec![Curve3::Line { origin: at, direction: unit(direction) }])
        }
        (plane @ FaceSurface::Plane { .. }, FaceSurface::Cylinder { .. }) => {
            Some(cylinder_and_plane(t, &plane, tolerance))
        }
        (FaceSurface::Cylinder { .. }, plane @ FaceSurface::Plane { .. }) => {
            Some(cylinder_and_plane(s, &plane, tolerance))
        }
        (
            FaceSurface::Cylinder { origin, axis, radius, .. },
            FaceSurface::Cylinder { origin: second, axis: other, radius: r2, .. },
        ) if axis.cross(other).length() < PARALLEL => {
            let d = second - origin;
            let d = d - d.dot(axis) * axis;
            let apart = d.length();
            if apart < tolerance {
                return Some(Vec::new());
            }
            let to = unit(d);
            let off = (apart * apart + radius * radius - r2 * r2) / (2.0 * apart);
            let (middle, chord) = (origin + off * to, axis.cross(to));
            Some(lines_at_chord_ends(middle, chord, axis, off.abs(), radius, tolerance))
        }
        _ => None,
    }
}

/// Lines parallel to an axis through both ends of a chord of a circle.
///
/// The chord is given by its middle, its direction and its distance `off` from the centre.
fn lines_at_chord_ends(
    middle: DVec3,
    chord: DVec3,
    axis: DVec3,
    off: f64,
    radius: f64,
    tolerance: f64,
) -> Vec<Curve3> {
    let line = |shift: f64| Curve3::Line { origin: middle + shift * chord, direction: axis };
    if (off - radius).abs() <= tolerance {
        return vec![line(0.0)];
    }
    if off > radius {
        return Vec::new();
    }
    // Not r² − d², which cancels where the chord is short.
    let half = ((radius - off) * (radius + off)).sqrt();
    vec![line(-half), line(half)]
}

/// Lines parallel to the axis, or the ellipse with semi-axes r/|cos| and r for the angle between axis and
/// normal.
fn cylinder_and_plane(cylinder: &FaceSurface, plane: &FaceSurface, tolerance: f64) -> Vec<Curve3> {
    let (
        FaceSurface::Cylinder { origin, axis, radius, .. },
        FaceSurface::Plane { origin: on_plane, normal, .. },
    ) = (cylinder, plane)
    else {
        return Vec::new();
    };
    let steep = axis.dot(*normal);
    if steep.abs() < PARALLEL {
        let off = (*origin - *on_plane).dot(*normal);
        let middle = *origin - off * *normal;
        let chord = unit(axis.cross(*normal));
        return lines_at_chord_ends(middle, chord, *axis, off.abs(), *radius, tolerance);
    }
    let center = *origin + (*on_plane - *origin).dot(*normal) / steep * *axis;
    // The minor axis lies in the plane and across the cylinder's axis. For a circle this direction is
    // undetermined, and any one serves.
    let across = axis.cross(*normal);
    let b = match across.length() > PARALLEL {
        true => unit(across),
        false => planish_core::vector3::tangents(*axis).0,
    };
    vec![Curve3::Ellipse { center, a: radius / steep.abs() * unit(normal.cross(b)), b: *radius * b }]
}
