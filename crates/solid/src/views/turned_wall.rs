//! Surfaces of revolution about an axis that is parallel to a line of sight.
//!
//! The profile is a curve of the distance from the axis and the height along it. A straight profile makes a
//! cone, a circle centred on the axis a sphere, and any other circle a torus. All axes are parallel to lines
//! of sight. A line of sight therefore meets the surface where it meets the profile, or the circle of its
//! height. Both are quadratic equations; a general line meets a torus in the roots of a quartic.

use super::candidate_surface::{Extent, Side, across};
use super::profile::Profile;
use crate::brep::FaceSurface;
use planish_core::DVec3;

/// A surface of revolution.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Turned {
    /// Axis of the frame to which the axis of revolution is parallel.
    pub(crate) axis: usize,
    /// The other two coordinates of the axis of revolution, in the order of [`across`].
    pub(crate) center: [f64; 2],
    /// Profile in the coordinates (distance from the axis, height along it).
    pub(crate) profile: Profile,
    pub(crate) extents: Vec<Extent>,
}

impl Turned {
    /// Distance from the axis, and height along it.
    pub(crate) fn on_profile(&self, p: DVec3) -> [f64; 2] {
        let [a, b] = across(self.axis);
        let d = [p[a] - self.center[0], p[b] - self.center[1]];
        // Several times faster than `hypot`; coordinates are far from overflow.
        [(d[0] * d[0] + d[1] * d[1]).sqrt(), p[self.axis]]
    }

    /// The point at an angle around the axis and a point of the profile.
    pub(crate) fn point(&self, angle: f64, [distance, height]: [f64; 2]) -> DVec3 {
        let [a, b] = across(self.axis);
        let mut p = DVec3::ZERO;
        p[a] = self.center[0] + distance * angle.cos();
        p[b] = self.center[1] + distance * angle.sin();
        p[self.axis] = height;
        p
    }

    /// Signed distance from the whole surface.
    pub(crate) fn value(&self, p: DVec3) -> f64 {
        self.profile.value(self.on_profile(p))
    }

    /// A function whose sign is the side of the wall on which a point is.
    ///
    /// If only one half of a tube is used, the wall continues beyond it as two planes across the axis, which
    /// touch the tube.
    pub(crate) fn value_of(&self, side: Side, p: DVec3) -> f64 {
        let at = self.on_profile(p);
        match (side, &self.profile) {
            (Side::Both, _) | (_, Profile::Line { .. }) => self.profile.value(at),
            (_, Profile::Circle { center, radius }) => match self.is_on_side(side, p) {
                true => self.profile.value(at),
                false => (at[1] - center[1]).abs() - radius,
            },
        }
    }

    /// True if a point is on the same side of the tube's centre line as the half of the tube that is used.
    pub(crate) fn is_on_side(&self, side: Side, p: DVec3) -> bool {
        let at = self.on_profile(p);
        match (side, &self.profile) {
            (Side::Both, _) | (_, Profile::Line { .. }) => true,
            (_, Profile::Circle { center, .. }) => (side == Side::Inner) != (at[0] > center[0]),
        }
    }

    /// The gradient of the signed distance.
    pub(crate) fn normal(&self, p: DVec3) -> DVec3 {
        let at = self.on_profile(p);
        let n = self.profile.normal(at);
        let [a, b] = across(self.axis);
        // On the axis the direction is undetermined; the result is then finite and along the axis.
        let distance = at[0].max(f64::MIN_POSITIVE);
        let mut normal = DVec3::ZERO;
        normal[a] = n[0] * (p[a] - self.center[0]) / distance;
        normal[b] = n[0] * (p[b] - self.center[1]) / distance;
        normal[self.axis] = n[1];
        normal
    }

    /// Coordinates at which the line along an axis through a point meets the wall.
    ///
    /// A line that touches the wall within `touching` meets it once.
    pub(crate) fn crossings(&self, side: Side, along: usize, p: DVec3, touching: f64) -> Vec<f64> {
        let at = self.on_profile(p);
        let is_used = |distance: f64| match (side, &self.profile) {
            (Side::Both, _) | (_, Profile::Line { .. }) => distance >= 0.0,
            (Side::Inner, Profile::Circle { center, .. }) => {
                distance >= 0.0 && distance <= center[0] + touching
            }
            (Side::Outer, Profile::Circle { center, .. }) => distance >= center[0] - touching,
        };
        if along == self.axis {
            return match is_used(at[0]) {
                true => self.profile.crossings(0, at[0], touching),
                false => Vec::new(),
            };
        }
        let known = usize::from(across(self.axis)[0] == along);
        let value = p[across(self.axis)[known]];
        let mut found = Vec::new();
        for radius in self.profile.crossings(1, at[1], touching) {
            if is_used(radius) {
                let circle = Profile::Circle { center: self.center, radius };
                found.extend(circle.crossings(known, value, touching));
            }
        }
        found
    }

    /// The part of the wall that passes through a box, if any.
    pub(crate) fn passes(&self, lo: DVec3, hi: DVec3, tolerance: f64) -> Option<Side> {
        let mut found: Option<Side> = None;
        for extent in &self.extents {
            let ends = [0, 1, 2].map(|k| [lo[k].max(extent.bounds[k][0]), hi[k].min(extent.bounds[k][1])]);
            if ends.iter().any(|e| e[1] - e[0] <= tolerance) || !self.crosses(ends, extent.side, tolerance) {
                continue;
            }
            // Several extents of one wall may lie in a box; halves of a tube then combine to the whole.
            found = match found {
                None => Some(extent.side),
                Some(side) if side == extent.side => found,
                _ => Some(Side::Both),
            };
        }
        found
    }

    /// True if the surface passes through a box.
    ///
    /// The box has a range of distances from the axis and a range of heights. The profile crosses this
    /// rectangle if its signed distance has both signs there.
    fn crosses(&self, ends: [[f64; 2]; 3], side: Side, tolerance: f64) -> bool {
        let [a, b] = across(self.axis);
        let near = |k: usize, c: f64| c - c.clamp(ends[k][0], ends[k][1]);
        let far = |k: usize, c: f64| (c - ends[k][0]).abs().max((ends[k][1] - c).abs());
        let [ca, cb] = self.center;
        // Minimum and maximum distance of the box from the axis.
        let mut radii = [near(a, ca).hypot(near(b, cb)), far(a, ca).hypot(far(b, cb))];
        let heights = ends[self.axis];
        match &self.profile {
            // A linear function has its extremes at corners.
            Profile::Line { .. } => {
                let values =
                    [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[i, j]| self.profile.value([radii[i], heights[j]]));
                values.iter().any(|v| *v > tolerance) && values.iter().any(|v| *v < -tolerance)
            }
            Profile::Circle { center, radius } => {
                match side {
                    Side::Inner => radii[1] = radii[1].min(center[0]),
                    Side::Outer => radii[0] = radii[0].max(center[0]),
                    Side::Both => {}
                }
                if radii[1] - radii[0] <= tolerance {
                    return false;
                }
                // The nearest and the farthest point of the rectangle from the centre of the circle: it
                // crosses the circle if the radius lies between both distances.
                let off = |range: [f64; 2], c: f64| {
                    let near = c - c.clamp(range[0], range[1]);
                    [near.abs(), (c - range[0]).abs().max((range[1] - c).abs())]
                };
                let (r, h) = (off(radii, center[0]), off(heights, center[1]));
                r[0].hypot(h[0]) < radius - tolerance && r[1].hypot(h[1]) > radius + tolerance
            }
        }
    }

    /// True if two walls lie on the same surface.
    pub(crate) fn same(&self, other: &Self, tolerance: f64, size: f64) -> bool {
        self.axis == other.axis
            && crate::drawing::distance(self.center, other.center) < tolerance
            && self.profile.same(&other.profile, tolerance, size)
    }

    /// True for a sphere.
    pub(crate) fn is_sphere(&self) -> bool {
        matches!(self.profile, Profile::Circle { center, .. } if center[0] == 0.0)
    }

    /// The surface. Its normal is the direction of the gradient.
    pub(crate) fn surface(&self) -> FaceSurface {
        let unit_of = |k: usize, sign: f64| {
            let mut e = DVec3::ZERO;
            e[k] = sign;
            e
        };
        let at = |height: f64| self.point(0.0, [0.0, height]);
        let x = unit_of(across(self.axis)[0], 1.0);
        match self.profile {
            Profile::Circle { center, radius } if center[0] == 0.0 => {
                FaceSurface::Sphere { center: at(center[1]), axis: unit_of(self.axis, 1.0), x, radius }
            }
            Profile::Circle { center, radius } => FaceSurface::Torus {
                center: at(center[1]),
                axis: unit_of(self.axis, 1.0),
                x,
                major: center[0],
                minor: radius,
            },
            Profile::Line { normal, offset } => {
                // From normal · (r, h) = offset, dr/dh = −n₁/n₀. The axis of a cone points to its wider end.
                let slope = -normal[1] / normal[0];
                let middle = self
                    .extents
                    .iter()
                    .map(|e| e.bounds[self.axis])
                    .fold([f64::MAX, f64::MIN], |m, e| [m[0].min(e[0]), m[1].max(e[1])]);
                let narrow = if slope > 0.0 { middle[0] } else { middle[1] };
                let radius = ((offset - normal[1] * narrow) / normal[0]).max(0.0);
                // A cone that ends at its apex starts exactly there: with a rounded height, the radius would
                // not be zero and the face would have a tiny hole.
                let narrow = if radius < 1e-9 { offset / normal[1] } else { narrow };
                FaceSurface::Cone {
                    origin: at(narrow),
                    axis: unit_of(self.axis, slope.signum()),
                    x,
                    radius: if radius < 1e-9 { 0.0 } else { radius },
                    half_angle_rad: slope.abs().atan(),
                }
            }
        }
    }
}
