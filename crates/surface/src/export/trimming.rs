//! Surfaces without the parts that nothing measured or implies: faces with trimming curves, and meshes.
//!
//! A sheet extends over a rectangle of parameters, beyond the rim of the data and over their holes; a closed
//! surface continues where nothing was measured. The parts kept are cells of its
//! [`Support`](crate::model::Support). Their rims run along lines of constant parameters, on which a bicubic
//! surface is a cubic curve: trimming curves are exact, with steps of a cell.
//!
//! Not guaranteed: that separate parts that touch in a corner are separate for every reader.

mod edges;
mod rims;
#[cfg(test)]
mod tests;

use super::brep::{BrepOptions, FacePlanes, brep_from_surface};
use crate::model::{Observed, SurfaceModel};
use edges::TrimmedBuilder;
use planish_exchange::step::Brep;
use planish_spline::Shape;
use rims::Rims;

/// Which parts of a surface that were neither measured nor inferred meshes and faces have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Closing {
    /// Those of all shapes but sheets: closed surfaces stay closed.
    #[default]
    Auto,
    /// All of them.
    Always,
    /// None: rims run along the measured surface, whatever its shape.
    Never,
}

/// The surface of a model as B-spline faces, without the parts that `closing` leaves out. Holes and rims are
/// stepped by cells of [`Support`](crate::model::Support).
///
/// # Examples
/// ```
/// use planish_surface::export::{BrepOptions, Closing, brep_from_model};
/// use planish_surface::test_support::small_model;
/// let ball = small_model(planish_spline::Shape::Ball);
/// let brep = brep_from_model(&ball, Closing::Auto, &BrepOptions::default());
/// assert!(brep.closed);
/// ```
#[must_use]
pub fn brep_from_model(model: &SurfaceModel, closing: Closing, options: &BrepOptions) -> Brep {
    let Some(kept) = KeptParts::new(model, closing) else {
        return brep_from_surface(&model.surface, options);
    };
    let planes = FacePlanes::new(&model.surface, options);
    let rims = Rims::new(&kept, &planes);
    TrimmedBuilder::new(&model.surface, &rims).brep(&rims, &planes)
}

/// The kept parts of a surface.
pub(super) struct KeptParts<'a> {
    model: &'a SurfaceModel,
}

impl<'a> KeptParts<'a> {
    /// The kept parts of a model; none if all or nothing would be kept.
    pub(super) fn new(model: &'a SurfaceModel, closing: Closing) -> Option<Self> {
        let is_sheet = model.surface.space().shape() == Some(Shape::Sheet);
        let is_trimmed = closing == Closing::Never || closing == Closing::Auto && is_sheet;
        let has = |keep: bool| {
            model.support.leaves().any(|(_, parts)| parts.iter().any(|part| is_kept(part.observed) == keep))
        };
        (is_trimmed && has(true) && has(false)).then_some(Self { model })
    }

    /// Halvings of a leaf's sides after which every square lies in one cell.
    pub(super) fn halvings(&self, leaf: usize) -> u8 {
        let mixed = [false, true]
            .map(|keep| self.model.support.cells(leaf).iter().any(|cell| is_kept(cell.observed) == keep));
        if mixed == [true, true] { self.model.support.depth(leaf) } else { 0 }
    }

    /// True if a place of a leaf is kept.
    pub(super) fn has(&self, leaf: usize, local: [f64; 2]) -> bool {
        is_kept(self.model.observed_at(leaf, local))
    }
}

fn is_kept(observed: Observed) -> bool {
    observed != Observed::PriorOnly
}
