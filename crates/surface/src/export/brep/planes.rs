//! The faces of a surface, and where its cells lie in the planes of their parameters.

use super::over_quads::Rectangles;
use super::{BrepOptions, Patches, encloses_positive_volume};
use planish_exchange::step::BsplineSurface;
use planish_spline::{Cell, Surface};

/// The planes of all faces.
pub(in super::super) struct FacePlanes<'a> {
    surface: &'a Surface,
    faces: Faces<'a>,
}

enum Faces<'a> {
    Patches(Patches),
    Rectangles(Rectangles<'a>),
}

impl<'a> FacePlanes<'a> {
    pub(in super::super) fn new(surface: &'a Surface, options: &BrepOptions) -> Self {
        let space = surface.space();
        let faces = match space.domain() {
            Some(domain) => Faces::Rectangles(Rectangles::new(surface, domain)),
            None => Faces::Patches(Patches::within(space, options)),
        };
        Self { surface, faces }
    }

    /// The face that contains a cell, and a point of the cell in its plane, in steps of which a base cell has
    /// `scale` along its side.
    pub(in super::super) fn place(&self, cell: Cell, at: [i64; 2], scale: i64) -> (usize, [i64; 2]) {
        match &self.faces {
            Faces::Patches(patches) => (patches.of_cell(cell), at),
            Faces::Rectangles(rectangles) => {
                let quad = cell.i >> cell.level;
                rectangles.place(quad, [at[0] - i64::from(quad) * scale, at[1]], scale)
            }
        }
    }

    /// The surface of a face.
    pub(in super::super) fn surface(&self, face: usize) -> BsplineSurface {
        match &self.faces {
            Faces::Patches(patches) => {
                let columns = patches.count()[0];
                patches.surface(self.surface, [face % columns, face / columns])
            }
            Faces::Rectangles(rectangles) => rectangles.surface(face),
        }
    }

    /// True if the normals of a closed surface point outwards, and for open ones.
    pub(in super::super) fn is_outward(&self) -> bool {
        let is_closed = match &self.faces {
            Faces::Patches(patches) => patches.is_closed(),
            Faces::Rectangles(rectangles) => rectangles.is_closed(),
        };
        !is_closed || encloses_positive_volume(self.surface)
    }
}
