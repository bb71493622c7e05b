//! Curves in which a plane or a cylinder in general position meets another surface, where they are lines,
//! circles or ellipses.

use super::surfaces::Curve3;
use crate::brep::{FaceSurface, along, unit};
use planish_estimate::vector3::{cross, dot, norm, scale, sub};

/// Directions are parallel below this sine of the angle between them: they are measured on drawings.
const PARALLEL: f64 = 1e-6;

/// Where two surfaces meet; none where that is no line, circle or ellipse. Touching within a tolerance counts
/// once.
pub(super) fn quadrics(s: &FaceSurface, t: &FaceSurface, tolerance: f64) -> Option<Vec<Curve3>> {
    match (*s, *t) {
        (
            FaceSurface::Plane { origin, normal, .. },
            FaceSurface::Plane { origin: second, normal: other, .. },
        ) => {
            let direction = cross(normal, other);
            let square = dot(direction, direction);
            if square.sqrt() < PARALLEL {
                return Some(Vec::new());
            }
            // The point of both planes that is nearest to the origin of the frame.
            let (d, e) = (dot(normal, origin), dot(other, second));
            let across = sub(scale(d, other), scale(e, normal));
            let at = scale(1.0 / square, cross(across, direction));
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
        ) if norm(cross(axis, other)) < PARALLEL => {
            let d = sub(second, origin);
            let d = along(d, -dot(d, axis), axis);
            let apart = norm(d);
            if apart < tolerance {
                return Some(Vec::new());
            }
            let to = unit(d);
            let off = (apart * apart + radius * radius - r2 * r2) / (2.0 * apart);
            Some(halves(along(origin, off, to), cross(axis, to), axis, off.abs(), radius, tolerance))
        }
        _ => None,
    }
}

/// Lines along an axis at both ends of a chord: its middle and direction, how far it is from the centre of
/// the circle, and the circle's radius.
fn halves(
    middle: [f64; 3],
    chord: [f64; 3],
    axis: [f64; 3],
    off: f64,
    radius: f64,
    tolerance: f64,
) -> Vec<Curve3> {
    let line = |shift: f64| Curve3::Line { origin: along(middle, shift, chord), direction: axis };
    if (off - radius).abs() <= tolerance {
        return vec![line(0.0)];
    }
    if off > radius {
        return Vec::new();
    }
    let half = ((radius - off) * (radius + off)).sqrt();
    vec![line(-half), line(half)]
}

fn cylinder_and_plane(cylinder: &FaceSurface, plane: &FaceSurface, tolerance: f64) -> Vec<Curve3> {
    let (
        FaceSurface::Cylinder { origin, axis, radius, .. },
        FaceSurface::Plane { origin: on_plane, normal, .. },
    ) = (cylinder, plane)
    else {
        return Vec::new();
    };
    let steep = dot(*axis, *normal);
    if steep.abs() < PARALLEL {
        let off = dot(sub(*origin, *on_plane), *normal);
        let middle = along(*origin, -off, *normal);
        return halves(middle, unit(cross(*axis, *normal)), *axis, off.abs(), *radius, tolerance);
    }
    let center = along(*origin, dot(sub(*on_plane, *origin), *normal) / steep, *axis);
    let across = cross(*axis, *normal);
    let b = match norm(across) > PARALLEL {
        true => unit(across),
        false => planish_estimate::vector3::tangents(*axis).0,
    };
    vec![Curve3::Ellipse {
        center,
        a: scale(radius / steep.abs(), unit(cross(*normal, b))),
        b: scale(*radius, b),
    }]
}
