//! Candidate surfaces that no view sees edge-on.
//!
//! These *walls* are surfaces of revolution about an axis along a line of sight ([`Turned`]), or planes and
//! cylinders oblique to all views ([`Oblique`]). Their intersections with a line of sight have a closed form
//! (a square root).

use super::oblique_wall::Oblique;
use super::turned_wall::Turned;
use crate::brep::FaceSurface;
use planish_core::DVec3;

/// Selects a half of the tube of a torus; other surfaces use `Both`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Side {
    /// Nearer to the axis than the centre line of the tube.
    Inner,
    /// Farther from the axis.
    Outer,
    /// The whole surface.
    Both,
}

/// Region to which a candidate surface is limited.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Extent {
    /// Minimum and maximum along each axis.
    pub(crate) bounds: [[f64; 2]; 3],
    pub(crate) side: Side,
}

/// A candidate surface that no view sees edge-on.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum CandidateSurface {
    /// About an axis parallel to a line of sight.
    Turned(Turned),
    /// A plane or cylinder oblique to all lines of sight.
    Oblique(Oblique),
}

/// The two axes other than one.
pub(crate) fn across(axis: usize) -> [usize; 2] {
    [(axis + 1) % 3, (axis + 2) % 3]
}

impl CandidateSurface {
    /// Regions to which the surface is limited; it may be a face only within one of them.
    pub(crate) fn extents(&self) -> &[Extent] {
        match self {
            Self::Turned(wall) => &wall.extents,
            Self::Oblique(wall) => &wall.extents,
        }
    }

    /// The box around all of its extents.
    pub(crate) fn bounds(&self) -> [[f64; 2]; 3] {
        [0, 1, 2].map(|k| {
            let ends = self.extents().iter().map(|e| e.bounds[k]);
            ends.fold([f64::MAX, f64::MIN], |m, e| [m[0].min(e[0]), m[1].max(e[1])])
        })
    }

    /// Signed distance from the whole, unlimited surface.
    pub(crate) fn value(&self, p: DVec3) -> f64 {
        match self {
            Self::Turned(wall) => wall.value(p),
            Self::Oblique(wall) => wall.value(p),
        }
    }

    /// A function whose sign is the side of the wall on which a point is.
    ///
    /// If only a half of a tube or a sector of a cylinder is used, the surface continues as a tangent plane
    /// beyond its ends. The whole surface would divide space a second time, behind the part that is used.
    pub(crate) fn value_of(&self, side: Side, p: DVec3) -> f64 {
        match self {
            Self::Turned(wall) => wall.value_of(side, p),
            Self::Oblique(wall) => wall.value_of(p),
        }
    }

    /// True if a point is nearer to the used part of the wall than a distance.
    ///
    /// Its tangent continuation (see [`CandidateSurface::value_of`]) cannot be a face, so it does not count.
    pub(crate) fn is_near(&self, side: Side, p: DVec3, near: f64) -> bool {
        match self {
            // The half is tested first: beside the other half of the tube there is no wall.
            Self::Turned(wall) => wall.is_on_side(side, p) && wall.value(p).abs() < near,
            Self::Oblique(wall) => wall.is_within(p) && wall.value(p).abs() < near,
        }
    }

    /// The gradient of [`CandidateSurface::value_of`] on the wall.
    pub(crate) fn normal_of(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Turned(wall) => wall.normal(p),
            Self::Oblique(wall) => wall.normal_of(p),
        }
    }

    /// The gradient of the signed distance from the unlimited surface.
    pub(crate) fn normal(&self, p: DVec3) -> DVec3 {
        match self {
            Self::Turned(wall) => wall.normal(p),
            Self::Oblique(wall) => wall.normal(p),
        }
    }

    /// Coordinates at which the line along an axis through a point meets the wall.
    ///
    /// A line that touches the wall within `touching` meets it once.
    pub(crate) fn crossings(&self, side: Side, along: usize, p: DVec3, touching: f64) -> Vec<f64> {
        match self {
            Self::Turned(wall) => wall.crossings(side, along, p, touching),
            Self::Oblique(wall) => wall.crossings(along, p, touching),
        }
    }

    /// The part of the wall that passes through a box, if any.
    pub(crate) fn passes(&self, lo: DVec3, hi: DVec3, tolerance: f64) -> Option<Side> {
        match self {
            Self::Turned(wall) => wall.passes(lo, hi, tolerance),
            // The sector of an oblique cylinder is tested by `value_of`, so the wall needs no halves.
            Self::Oblique(wall) => wall.passes(lo, hi, tolerance).then_some(Side::Both),
        }
    }

    /// The surface. Its normal is the direction of the gradient.
    pub(crate) fn surface(&self) -> FaceSurface {
        match self {
            Self::Turned(wall) => wall.surface(),
            Self::Oblique(wall) => wall.surface(),
        }
    }
}
