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
use crate::fit::open_leaves;
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
    /// None but small ones: rims run along the measured surface, whatever its shape. Openings of closed
    /// surfaces that are smaller than those that a fit reports are closed.
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
    /// For each leaf, true if parts without readings are left out there.
    is_open: Vec<bool>,
}

impl<'a> KeptParts<'a> {
    /// The kept parts of a model; none if all or nothing would be kept.
    pub(super) fn new(model: &'a SurfaceModel, closing: Closing) -> Option<Self> {
        let is_sheet = model.surface.space().shape() == Some(Shape::Sheet);
        let is_trimmed = closing == Closing::Never || closing == Closing::Auto && is_sheet;
        if !is_trimmed {
            return None;
        }
        // Readings leave small openings of a closed surface by chance.
        let is_open =
            if is_sheet { vec![true; model.surface.space().leaves().len()] } else { open_leaves(model) };
        let kept = Self { model, is_open };
        let has = |keep: bool| {
            let mut leaves = model.support.leaves().enumerate();
            leaves.any(|(leaf, (_, parts))| parts.iter().any(|part| kept.keeps(leaf, part.observed) == keep))
        };
        (has(true) && has(false)).then_some(kept)
    }

    fn keeps(&self, leaf: usize, observed: Observed) -> bool {
        observed != Observed::PriorOnly || !self.is_open[leaf]
    }

    /// Halvings of a leaf's sides after which every square lies in one cell.
    pub(super) fn halvings(&self, leaf: usize) -> u8 {
        let mixed = [false, true].map(|keep| {
            self.model.support.cells(leaf).iter().any(|cell| self.keeps(leaf, cell.observed) == keep)
        });
        if mixed == [true, true] { self.model.support.depth(leaf) } else { 0 }
    }

    /// True if a place of a leaf is kept.
    pub(super) fn has(&self, leaf: usize, local: [f64; 2]) -> bool {
        self.keeps(leaf, self.model.observed_at(leaf, local))
    }
}
