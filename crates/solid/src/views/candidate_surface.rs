//! Candidate surfaces that no view sees edge-on.
//!
//! These are surfaces of revolution about an axis along a line of sight ([`Turned`]), or planes and cylinders
//! oblique to all views ([`Oblique`]). Their intersections with a line of sight have a closed form (a square
//! root).

use super::oblique_wall::Oblique;
use super::turned_wall::Turned;
use crate::brep::FaceSurface;

/// Selects a half of the tube of a torus; other surfaces use `Both`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Side {
    /// Nearer to the axis than the tube's middle.
    Inner,
    /// Farther from it.
    Outer,
    /// Both.
    Both,
}

/// Region to which a candidate surface is limited.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Extent {
    /// The box around it.
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
    /// Where it may stand.
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

    /// Signed distance from the whole surface.
    pub(crate) fn value(&self, p: [f64; 3]) -> f64 {
        match self {
            Self::Turned(wall) => wall.value(p),
            Self::Oblique(wall) => wall.value(p),
        }
    }

    /// On which side of the wall a point is, where only one half of a tube or a sector of a cylinder is
    /// meant.
    pub(crate) fn value_of(&self, side: Side, p: [f64; 3]) -> f64 {
        match self {
            Self::Turned(wall) => wall.value_of(side, p),
            Self::Oblique(wall) => wall.value_of(p),
        }
    }

    /// Whether a point lies so near to the wall; where it goes on level beyond half a tube or the sector of
    /// an oblique one, it is no surface of the solid.
    pub(crate) fn is_near(&self, side: Side, p: [f64; 3], near: f64) -> bool {
        match self {
            Self::Turned(wall) => wall.is_meant(side, p) && wall.value(p).abs() < near,
            Self::Oblique(wall) => wall.is_within(p) && wall.value(p).abs() < near,
        }
    }

    /// The gradient of [`CandidateSurface::value_of`] on the wall.
    pub(crate) fn normal_of(&self, p: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Turned(wall) => wall.normal(p),
            Self::Oblique(wall) => wall.normal_of(p),
        }
    }

    /// The gradient of the signed distance from the whole surface.
    pub(crate) fn normal(&self, p: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Turned(wall) => wall.normal(p),
            Self::Oblique(wall) => wall.normal(p),
        }
    }

    /// Where the line along an axis through a point meets the wall; touching within a distance counts once.
    pub(crate) fn crossings(&self, side: Side, along: usize, p: [f64; 3], touching: f64) -> Vec<f64> {
        match self {
            Self::Turned(wall) => wall.crossings(side, along, p, touching),
            Self::Oblique(wall) => wall.crossings(along, p, touching),
        }
    }

    /// Which side of the wall passes through a box; none where none does.
    pub(crate) fn passes(&self, lo: [f64; 3], hi: [f64; 3], tolerance: f64) -> Option<Side> {
        match self {
            Self::Turned(wall) => wall.passes(lo, hi, tolerance),
            Self::Oblique(wall) => wall.passes(lo, hi, tolerance).then_some(Side::Both),
        }
    }

    /// The surface; its normal is the gradient's direction.
    pub(crate) fn surface(&self) -> FaceSurface {
        match self {
            Self::Turned(wall) => wall.surface(),
            Self::Oblique(wall) => wall.surface(),
        }
    }
}
