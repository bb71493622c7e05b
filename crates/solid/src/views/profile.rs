//! Profiles: the lines and circles along which surfaces are seen edge-on.

use crate::drawing::distance;

/// A line or a circle in a view, without ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Profile {
    /// `normal · p = offset`, the normal of unit length.
    Line { normal: [f64; 2], offset: f64 },
    /// All points at the radius from the centre.
    Circle { center: [f64; 2], radius: f64 },
}

impl Profile {
    /// The line through two points.
    pub(crate) fn line(a: [f64; 2], b: [f64; 2]) -> Self {
        let length = distance(a, b);
        let normal = [-(b[1] - a[1]) / length, (b[0] - a[0]) / length];
        // One sign for both directions, so that equal lines compare equal.
        let sign =
            if normal[0] < -1e-12 || (normal[0].abs() <= 1e-12 && normal[1] < 0.0) { -1.0 } else { 1.0 };
        let normal = normal.map(|c| sign * c);
        Self::Line { normal, offset: normal[0] * a[0] + normal[1] * a[1] }
    }

    /// Signed distance: positive on the normal's side, or outside.
    pub(crate) fn value(&self, p: [f64; 2]) -> f64 {
        match self {
            Self::Line { normal, offset } => normal[0] * p[0] + normal[1] * p[1] - offset,
            Self::Circle { center, radius } => {
                // Several times faster than `hypot`; coordinates are far from overflow.
                let d = [p[0] - center[0], p[1] - center[1]];
                (d[0] * d[0] + d[1] * d[1]).sqrt() - radius
            }
        }
    }

    /// The gradient of [`Profile::value`]: of unit length.
    pub(crate) fn normal(&self, p: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Line { normal, .. } => *normal,
            Self::Circle { center, .. } => {
                // At the centre the direction is undetermined; the result is zero instead of NaN.
                let d = distance(p, *center).max(f64::MIN_POSITIVE);
                [(p[0] - center[0]) / d, (p[1] - center[1]) / d]
            }
        }
    }

    /// The parameter of a point: along the line, or the angle.
    pub(crate) fn parameter(&self, p: [f64; 2]) -> f64 {
        match self {
            Self::Line { normal, .. } => normal[0] * p[1] - normal[1] * p[0],
            Self::Circle { center, .. } => (p[1] - center[1]).atan2(p[0] - center[0]),
        }
    }

    /// The point of a parameter.
    pub(crate) fn point(&self, t: f64) -> [f64; 2] {
        match self {
            Self::Line { normal, offset } => {
                [offset * normal[0] - t * normal[1], offset * normal[1] + t * normal[0]]
            }
            Self::Circle { center, radius } => [center[0] + radius * t.cos(), center[1] + radius * t.sin()],
        }
    }

    /// True if two profiles agree within a tolerance over a drawing of the given size.
    ///
    /// An angle between two lines is multiplied by the size, so it has the unit of the tolerance.
    pub(crate) fn same(&self, other: &Self, tolerance: f64, size: f64) -> bool {
        match (self, other) {
            (Self::Line { normal, offset }, Self::Line { normal: n2, offset: o2 }) => {
                (normal[0] * n2[1] - normal[1] * n2[0]).abs() * size < 3.0 * tolerance
                    && (offset - o2).abs() < 3.0 * tolerance
            }
            (Self::Circle { center, radius }, Self::Circle { center: c2, radius: r2 }) => {
                distance(*center, *c2) < tolerance && (radius - r2).abs() < tolerance
            }
            _ => false,
        }
    }

    /// Values of one coordinate at which the coordinate `known` has a given value, ascending.
    ///
    /// If the line at this value touches the circle within the tolerance, there is one. An error e of the
    /// coordinate would otherwise give two, apart by the order of √(e · radius).
    pub(crate) fn crossings(&self, known: usize, value: f64, tolerance: f64) -> Vec<f64> {
        let other = 1 - known;
        match self {
            Self::Line { normal, offset } => match normal[other].abs() > 1e-9 {
                true => vec![(offset - normal[known] * value) / normal[other]],
                false => Vec::new(),
            },
            Self::Circle { center, radius } => {
                let d = (value - center[known]).abs();
                if (d - radius).abs() <= tolerance {
                    return vec![center[other]];
                }
                // Outside of the circle by more than the tolerance: no intersection.
                let square = radius * radius - d * d;
                if square <= 0.0 {
                    return Vec::new();
                }
                let h = square.sqrt();
                vec![center[other] - h, center[other] + h]
            }
        }
    }
}
