//! Planes and cylinders oblique to all lines of sight.

use super::candidate_surface::{Extent, Side};
use crate::brep::{FaceSurface, unit};
use planish_core::{DVec3, vector3::tangents};

/// Number of steps of the search for the point of an axis nearest to a box.
///
/// Each step keeps 60 % of the interval, so 60 steps reduce it by 5e-14, near the accuracy of f64.
const HALVINGS: usize = 60;

/// Shape of an oblique wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Form {
    /// `normal · p = offset`, the normal of unit length.
    Plane { normal: DVec3, offset: f64 },
    /// All points at the radius from an axis of unit length.
    Cylinder { origin: DVec3, axis: DVec3, radius: f64 },
}

/// A sector of less than half of a cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sector {
    /// Unit vector across the axis, towards the middle of the sector.
    pub(crate) middle: DVec3,
    /// Angle from the middle to either end, in radians; less than π/2.
    pub(crate) half_width: f64,
}

/// A plane or a cylinder that no view sees edge-on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Oblique {
    pub(crate) form: Form,
    /// The part of a cylinder that is used; `None` for all of it.
    pub(crate) sector: Option<Sector>,
    pub(crate) extents: Vec<Extent>,
}

impl Oblique {
    /// A wall limited to a box.
    pub(crate) fn within(form: Form, bounds: [[f64; 2]; 3]) -> Self {
        let side = Side::Both;
        Self { form, sector: None, extents: vec![Extent { bounds, side }] }
    }

    /// A function whose sign is the side of the wall on which a point is.
    ///
    /// Beyond the sector of a cylinder, the wall continues as the tangent planes at its ends.
    pub(crate) fn value_of(&self, p: DVec3) -> f64 {
        match (self.form, self.end_near(p)) {
            (Form::Cylinder { origin, axis, radius }, Some(end)) => {
                end.dot(from_axis(origin, axis, p)) - radius
            }
            _ => self.value(p),
        }
    }

    /// True if a point is within the sector of a cylinder, or if there is no sector.
    pub(crate) fn is_within(&self, p: DVec3) -> bool {
        self.end_near(p).is_none()
    }

    /// The gradient of [`Oblique::value_of`].
    pub(crate) fn normal_of(&self, p: DVec3) -> DVec3 {
        self.end_near(p).unwrap_or_else(|| self.normal(p))
    }

    /// The end of the sector beyond which a point is, as a unit vector across the axis; `None` if the point
    /// is within the sector.
    fn end_near(&self, p: DVec3) -> Option<DVec3> {
        let (Form::Cylinder { origin, axis, .. }, Some(sector)) = (self.form, self.sector) else {
            return None;
        };
        let d = from_axis(origin, axis, p);
        let perpendicular = axis.cross(sector.middle);
        let angle = d.dot(perpendicular).atan2(d.dot(sector.middle));
        (angle.abs() > sector.half_width).then(|| sector_end(axis, sector, angle.signum()))
    }

    /// Signed distance.
    pub(crate) fn value(&self, p: DVec3) -> f64 {
        match self.form {
            Form::Plane { normal, offset } => normal.dot(p) - offset,
            Form::Cylinder { origin, axis, radius } => from_axis(origin, axis, p).length() - radius,
        }
    }

    /// The gradient of the signed distance.
    pub(crate) fn normal(&self, p: DVec3) -> DVec3 {
        match self.form {
            Form::Plane { normal, .. } => normal,
            Form::Cylinder { origin, axis, .. } => unit(from_axis(origin, axis, p)),
        }
    }

    /// Coordinates at which the line along an axis of the frame through a point meets the wall.
    ///
    /// A line that touches a cylinder within `touching` meets it once.
    pub(crate) fn crossings(&self, along: usize, p: DVec3, touching: f64) -> Vec<f64> {
        let mut found = self.crossings_of_all(along, p, touching);
        let (Form::Cylinder { origin, axis, radius }, Some(sector)) = (self.form, self.sector) else {
            return found;
        };
        let end_at = |depth: f64| {
            let mut at = p;
            at[along] = depth;
            self.end_near(at)
        };
        found.retain(|depth| end_at(*depth).is_none());
        // Intersections with the tangent planes, as far as they are beyond the sector. An end that is
        // parallel to the line gives an infinite depth.
        let mut start = p;
        start[along] = 0.0;
        for end in [-1.0, 1.0].map(|sign| sector_end(axis, sector, sign)) {
            let depth = (radius - end.dot(from_axis(origin, axis, start))) / end[along];
            // Each tangent plane counts only beyond its own end of the sector.
            let is_on = depth.is_finite() && end_at(depth).is_some_and(|e| e.dot(end) > 1.0 - 1e-12);
            found.extend(is_on.then_some(depth));
        }
        found
    }

    /// Intersections with the whole surface.
    fn crossings_of_all(&self, along: usize, mut p: DVec3, touching: f64) -> Vec<f64> {
        p[along] = 0.0;
        match self.form {
            Form::Plane { normal, offset } => vec![(offset - normal.dot(p)) / normal[along]],
            Form::Cylinder { origin, axis, radius } => {
                // |b + t a| = r for the parts across the axis. The nearest point is found first: its distance
                // gives the contact, and (r − d)(r + d) does not cancel where the line nearly touches.
                let mut e = DVec3::ZERO;
                e[along] = 1.0;
                let (a, b) = (from_axis(DVec3::ZERO, axis, e), from_axis(origin, axis, p));
                let square = a.length_squared();
                let nearest = -a.dot(b) / square;
                let distance = (b + nearest * a).length();
                if (distance - radius).abs() <= touching {
                    return vec![nearest];
                }
                if distance > radius {
                    return Vec::new();
                }
                let half = ((radius - distance) * (radius + distance) / square).sqrt();
                vec![nearest - half, nearest + half]
            }
        }
    }

    /// True if the wall passes through a box, within its extents.
    pub(crate) fn passes(&self, lo: DVec3, hi: DVec3, tolerance: f64) -> bool {
        self.extents.iter().any(|extent| {
            let ends = [0, 1, 2].map(|k| [lo[k].max(extent.bounds[k][0]), hi[k].min(extent.bounds[k][1])]);
            ends.iter().all(|e| e[1] - e[0] > tolerance) && self.crosses(ends, tolerance)
        })
    }

    /// True if the unlimited surface passes through a box.
    ///
    /// The signed distance to a plane is extreme at corners, so these are enough. That to a cylinder is
    /// convex: its maximum is at a corner, but its minimum may be anywhere.
    fn crosses(&self, ends: [[f64; 2]; 3], tolerance: f64) -> bool {
        let corners = (0..8_usize).map(|c| DVec3::from_array([0, 1, 2].map(|k| ends[k][c >> k & 1])));
        let values: Vec<f64> = corners.clone().map(|p| self.value(p)).collect();
        let is_beyond = values.iter().any(|v| *v > tolerance);
        match self.form {
            Form::Plane { .. } => is_beyond && values.iter().any(|v| *v < -tolerance),
            Form::Cylinder { origin, axis, radius } => {
                // The distance of a point of the axis from the box is convex along the axis, so a section
                // search finds its minimum.
                let off = |t: f64| {
                    let p = origin + t * axis;
                    DVec3::from_array([0, 1, 2].map(|k| p[k] - p[k].clamp(ends[k][0], ends[k][1]))).length()
                };
                let heights: Vec<f64> = corners.map(|p| (p - origin).dot(axis)).collect();
                // The nearest point of the axis lies between the corners, projected to the axis; the margin
                // of a radius is safe.
                let mut lo = heights.iter().copied().fold(f64::MAX, f64::min) - radius;
                let mut hi = heights.iter().copied().fold(f64::MIN, f64::max) + radius;
                for _ in 0..HALVINGS {
                    let (a, b) = (lo + (hi - lo) * 0.4, lo + (hi - lo) * 0.6);
                    match off(a) < off(b) {
                        true => hi = b,
                        false => lo = a,
                    }
                }
                is_beyond && off((lo + hi) / 2.0) < radius - tolerance
            }
        }
    }

    /// The surface. Its normal is the direction of the gradient.
    pub(crate) fn surface(&self) -> FaceSurface {
        match self.form {
            Form::Plane { normal, offset } => {
                FaceSurface::Plane { origin: offset * normal, normal, x: tangents(normal).0 }
            }
            Form::Cylinder { origin, axis, radius } => {
                FaceSurface::Cylinder { origin, axis, x: tangents(axis).0, radius }
            }
        }
    }

    /// A lattice of points on a cylinder, in rows along the axis; empty for a plane.
    pub(crate) fn lattice(&self, rows: usize, around: usize) -> Vec<Vec<DVec3>> {
        let Form::Cylinder { origin, axis, radius } = self.form else {
            return Vec::new();
        };
        let (x, y) = tangents(axis);
        let [from, to] = self.span();
        // Shifted, so that no point lies on a plane of symmetry of the part.
        let share = |k: usize, of: usize| (k as f64 + 0.213) / of as f64;
        (0..rows)
            .map(|row| {
                let middle = origin + (from + (to - from) * share(row, rows)) * axis;
                let turn = |k: usize| std::f64::consts::TAU * share(k, around);
                let at = |k: usize| middle + radius * turn(k).cos() * x + radius * turn(k).sin() * y;
                (0..around).map(at).collect()
            })
            .collect()
    }

    /// Minimum and maximum of the extents along the axis of a cylinder, from its origin.
    pub(crate) fn span(&self) -> [f64; 2] {
        let Form::Cylinder { origin, axis, .. } = self.form else {
            return [0.0; 2];
        };
        let mut span = [f64::MAX, f64::MIN];
        for extent in &self.extents {
            for c in 0..8_usize {
                let corner = DVec3::from_array([0, 1, 2].map(|k| extent.bounds[k][c >> k & 1]));
                let h = (corner - origin).dot(axis);
                span = [span[0].min(h), span[1].max(h)];
            }
        }
        span
    }

    /// The outlines of a cylinder along a line of sight: a point of each, and their direction.
    pub(crate) fn outlines(&self, sight: usize) -> Option<([DVec3; 2], DVec3)> {
        let Form::Cylinder { origin, axis, radius } = self.form else {
            return None;
        };
        let mut e = DVec3::ZERO;
        e[sight] = 1.0;
        let across = unit(axis.cross(e));
        Some(([-radius, radius].map(|r| origin + r * across), axis))
    }
}

/// A unit vector across the axis to an end of a sector.
fn sector_end(axis: DVec3, sector: Sector, sign: f64) -> DVec3 {
    let (sin, cos) = sector.half_width.sin_cos();
    cos * sector.middle + sign * sin * axis.cross(sector.middle)
}

/// The component across an axis of the vector from a point of the axis to another point.
fn from_axis(origin: DVec3, axis: DVec3, p: DVec3) -> DVec3 {
    let d = p - origin;
    d - d.dot(axis) * axis
}
