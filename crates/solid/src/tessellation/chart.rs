//! Plane coordinates of a face's surface, in which it is cut into triangles.
//!
//! Parameters have no one value at a pole of a sphere or the tip of a cone. A face of a sphere is therefore
//! projected from a point of the sphere that it does not hold (stereographic: circles stay circles), and a
//! cone's face that holds the tip is looked at along its axis.

use crate::brep::{FaceSurface, unit};
use planish_estimate::vector3::{add_scaled, cross, dot, norm, scale, sub};

/// A point of a plane for every point of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) enum Chart {
    /// The surface's parameters times the lengths of their steps; `is_swapped`: the second one first, so that
    /// it is seen mirrored.
    Parameters { surface: FaceSurface, steps: [f64; 2], is_swapped: bool },
    /// A sphere, projected from `center + radius pole` on the plane that touches it opposite of that.
    Sphere {
        center: [f64; 3],
        radius: f64,
        pole: [f64; 3],
        /// Two directions of the plane; seen from outside of the sphere the second lies left of the first.
        plane: [[f64; 3]; 2],
    },
    /// A cone, seen from its tip along the axis.
    Cone { tip: [f64; 3], axis: [f64; 3], plane: [[f64; 3]; 2], slope: f64 },
}

impl Chart {
    /// A sphere from a pole.
    pub(super) fn sphere(center: [f64; 3], radius: f64, pole: [f64; 3]) -> Self {
        let aside = if pole[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let x = unit(cross(aside, pole));
        Self::Sphere { center, radius, pole, plane: [x, cross(x, pole)] }
    }

    /// A cone from its tip; none of another surface.
    pub(super) fn cone(surface: &FaceSurface) -> Option<Self> {
        let FaceSurface::Cone { origin, axis, x, radius, half_angle_rad } = *surface else {
            return None;
        };
        let slope = half_angle_rad.tan();
        Some(Self::Cone {
            tip: add_scaled(origin, -radius / slope, axis),
            axis,
            plane: [x, cross(x, axis)],
            slope,
        })
    }

    /// The plane's point of a point on the surface; parameters come back by turns, and here those between −π
    /// and π.
    pub(super) fn at(&self, p: [f64; 3]) -> [f64; 2] {
        match self {
            Self::Parameters { surface, steps, is_swapped } => {
                let [u, v] = surface.parameters(p);
                let at = if *is_swapped { [v, u] } else { [u, v] };
                [at[0] * steps[0], at[1] * steps[1]]
            }
            Self::Sphere { center, radius, pole, plane } => {
                let d = unit(sub(p, *center));
                let stretch = 2.0 * radius / (1.0 - dot(d, *pole)).max(f64::MIN_POSITIVE);
                plane.map(|x| stretch * dot(d, x))
            }
            Self::Cone { tip, plane, .. } => plane.map(|x| dot(sub(p, *tip), x)),
        }
    }

    /// The surface's point of a point of the plane.
    pub(super) fn point(&self, at: [f64; 2]) -> [f64; 3] {
        match self {
            Self::Parameters { surface, steps, is_swapped } => {
                let [a, b] = [at[0] / steps[0], at[1] / steps[1]];
                surface.point(if *is_swapped { [b, a] } else { [a, b] })
            }
            Self::Sphere { center, radius, pole, plane } => {
                let q = at.map(|c| c / (2.0 * radius));
                let square = q[0] * q[0] + q[1] * q[1];
                let across = add_scaled(scale(2.0 * q[0], plane[0]), 2.0 * q[1], plane[1]);
                let d = scale(1.0 / (square + 1.0), add_scaled(across, square - 1.0, *pole));
                add_scaled(*center, *radius, d)
            }
            Self::Cone { tip, axis, plane, slope } => {
                let across = add_scaled(scale(at[0], plane[0]), at[1], plane[1]);
                add_scaled(add_scaled(*tip, 1.0, across), norm(across) / slope, *axis)
            }
        }
    }

    /// Whether triangles that run counter-clockwise in the plane run clockwise as seen along the surface's
    /// normal.
    pub(super) fn is_mirrored(&self) -> bool {
        matches!(self, Self::Parameters { is_swapped: true, .. })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cone() -> FaceSurface {
        FaceSurface::Cone {
            origin: [1.0, 2.0, 3.0],
            axis: [0.0, 0.6, 0.8],
            x: [1.0, 0.0, 0.0],
            radius: 2.0,
            half_angle_rad: 0.4,
        }
    }

    #[test]
    fn points_come_back_and_left_stays_left() {
        let sphere = FaceSurface::Sphere {
            center: [1.0, -2.0, 0.5],
            axis: [0.0, 0.0, 1.0],
            x: [1.0, 0.0, 0.0],
            radius: 3.0,
        };
        let charts = [
            (Chart::sphere([1.0, -2.0, 0.5], 3.0, unit([0.3, -0.5, 0.8])), sphere),
            (Chart::cone(&cone()).unwrap(), cone()),
        ];
        for (chart, surface) in charts {
            for at in [[0.7, 0.2], [-1.3, 2.0], [4.0, -0.1]] {
                let p = chart.point(at);
                assert!(surface.distance(p).abs() < 1e-12);
                let back = chart.at(p);
                assert!((0..2).all(|k| (back[k] - at[k]).abs() < 1e-12), "{back:?} is not {at:?}");
                let h = 1e-5;
                let [right, up] =
                    [[h, 0.0], [0.0, h]].map(|d| sub(chart.point([at[0] + d[0], at[1] + d[1]]), p));
                assert!(dot(cross(right, up), surface.normal(p)) > 0.0);
            }
        }
    }
}
