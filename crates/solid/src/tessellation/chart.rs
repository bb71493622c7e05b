//! Plane coordinates of the surface of a face, in which it is triangulated.
//!
//! Parameters are undetermined at a pole of a sphere or at the apex of a cone. A face of a sphere is
//! therefore projected from a point of the sphere outside of the face (stereographic: circles stay circles).
//! A face of a cone that contains the apex is projected along its axis.

use crate::brep::{FaceSurface, unit};
use planish_core::DVec3;

/// A map from a surface to a plane.
#[derive(Debug, Clone, Copy)]
pub(super) enum Chart {
    /// The parameters of the surface times the lengths of its derivatives. With `is_swapped`, the second
    /// parameter comes first, which mirrors the plane.
    Parameters { surface: FaceSurface, steps: [f64; 2], is_swapped: bool },
    /// A sphere, projected from `center + radius pole` to the tangent plane at the opposite point.
    Sphere {
        center: DVec3,
        radius: f64,
        pole: DVec3,
        /// Two directions of the plane. Seen from outside of the sphere, the second is left of the first.
        plane: [DVec3; 2],
    },
    /// A cone, seen from its apex along the axis.
    Cone { tip: DVec3, axis: DVec3, plane: [DVec3; 2], slope: f64 },
}

impl Chart {
    /// The stereographic projection of a sphere from a pole (a unit vector).
    pub(super) fn sphere(center: DVec3, radius: f64, pole: DVec3) -> Self {
        // An axis at an angle of at least 44° to the pole, so that the cross product is accurate.
        let axis = if pole[0].abs() < 0.7 { DVec3::X } else { DVec3::Y };
        let x = unit(axis.cross(pole));
        Self::Sphere { center, radius, pole, plane: [x, x.cross(pole)] }
    }

    /// The projection of a cone along its axis; `None` for other surfaces.
    pub(super) fn cone(surface: &FaceSurface) -> Option<Self> {
        let FaceSurface::Cone { origin, axis, x, radius, half_angle_rad } = *surface else {
            return None;
        };
        let slope = half_angle_rad.tan();
        Some(Self::Cone { tip: origin - radius / slope * axis, axis, plane: [x, x.cross(axis)], slope })
    }

    /// The point of the plane for a point on the surface. Of periodic parameters, those in (−π, π] are used.
    pub(super) fn at(&self, p: DVec3) -> [f64; 2] {
        match self {
            Self::Parameters { surface, steps, is_swapped } => {
                let [u, v] = surface.parameters(p);
                let at = if *is_swapped { [v, u] } else { [u, v] };
                [at[0] * steps[0], at[1] * steps[1]]
            }
            Self::Sphere { center, radius, pole, plane } => {
                let d = unit(p - *center);
                // The pole itself is at infinity; the bound keeps the division finite there.
                let stretch = 2.0 * radius / (1.0 - d.dot(*pole)).max(f64::MIN_POSITIVE);
                plane.map(|x| stretch * d.dot(x))
            }
            Self::Cone { tip, plane, .. } => plane.map(|x| (p - *tip).dot(x)),
        }
    }

    /// The point of the surface for a point of the plane.
    pub(super) fn point(&self, at: [f64; 2]) -> DVec3 {
        match self {
            Self::Parameters { surface, steps, is_swapped } => {
                let [a, b] = [at[0] / steps[0], at[1] / steps[1]];
                surface.point(if *is_swapped { [b, a] } else { [a, b] })
            }
            Self::Sphere { center, radius, pole, plane } => {
                let q = at.map(|c| c / (2.0 * radius));
                let square = q[0] * q[0] + q[1] * q[1];
                let across = 2.0 * q[0] * plane[0] + 2.0 * q[1] * plane[1];
                let d = 1.0 / (square + 1.0) * (across + (square - 1.0) * *pole);
                *center + *radius * d
            }
            Self::Cone { tip, axis, plane, slope } => {
                let across = at[0] * plane[0] + at[1] * plane[1];
                *tip + across + across.length() / slope * *axis
            }
        }
    }

    /// True if triangles that are counter-clockwise in the plane are clockwise seen against the normal of the
    /// surface.
    pub(super) fn is_mirrored(&self) -> bool {
        matches!(self, Self::Parameters { is_swapped: true, .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cone() -> FaceSurface {
        FaceSurface::Cone {
            origin: DVec3::new(1.0, 2.0, 3.0),
            axis: DVec3::new(0.0, 0.6, 0.8),
            x: DVec3::X,
            radius: 2.0,
            half_angle_rad: 0.4,
        }
    }

    #[test]
    fn charts_invert_and_keep_the_orientation() {
        let sphere = FaceSurface::Sphere {
            center: DVec3::new(1.0, -2.0, 0.5),
            axis: DVec3::Z,
            x: DVec3::X,
            radius: 3.0,
        };
        let charts = [
            (Chart::sphere(DVec3::new(1.0, -2.0, 0.5), 3.0, unit(DVec3::new(0.3, -0.5, 0.8))), sphere),
            (Chart::cone(&cone()).unwrap(), cone()),
        ];
        for (chart, surface) in charts {
            for at in [[0.7, 0.2], [-1.3, 2.0], [4.0, -0.1]] {
                let p = chart.point(at);
                assert!(surface.distance(p).abs() < 1e-12);
                let back = chart.at(p);
                assert!((0..2).all(|k| (back[k] - at[k]).abs() < 1e-12), "{back:?} is not {at:?}");
                let h = 1e-5;
                let [right, up] = [[h, 0.0], [0.0, h]].map(|d| chart.point([at[0] + d[0], at[1] + d[1]]) - p);
                assert!(right.cross(up).dot(surface.normal(p)) > 0.0);
            }
        }
    }
}
