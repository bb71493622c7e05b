//! The direction in which each vertex of a model moves, for models with one unknown a vertex.

use planish_estimate::{Error, Result};
use planish_spline::SurfaceSystem;
use planish_surface::model::{Knowledge, SurfaceModel};

/// One direction for each node.
///
/// # Errors
/// `Unsupported` for models with more than one unknown a vertex, and for those of the patch filter.
pub(super) fn directions(model: &SurfaceModel, system: &SurfaceSystem) -> Result<Vec<[f64; 3]>> {
    match &model.known {
        Knowledge::AlongNormals { .. } => Ok(system.node_normals(&model.surface)),
        Knowledge::PerCoordinate { measured, .. } => {
            Ok(vec![only_coordinate(*measured)?; model.surface.space().node_count()])
        }
        Knowledge::Patches(_) => Err(Error::unsupported(
            "the model is one of the patch filter, which does not know how far apart places vary together: \
             needed one of `fit --filter global`",
        )),
        Knowledge::Free { .. } => Err(Error::unsupported(
            "the model is a state of a sheet that bends, whose vertices move in every direction: needed one \
             of `fit` without --motion bend",
        )),
    }
}

/// The axis of the one coordinate that was measured.
fn only_coordinate(measured: [bool; 3]) -> Result<[f64; 3]> {
    if measured.iter().filter(|m| **m).count() != 1 {
        return Err(Error::unsupported(
            "needed a model along its normals, or one of heights: of this one several coordinates were \
             measured, each for itself",
        ));
    }
    Ok(measured.map(|m| if m { 1.0 } else { 0.0 }))
}
