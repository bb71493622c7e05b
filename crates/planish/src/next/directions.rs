//! The directions in which the vertices of a model move, for models whose unknowns are displacements along
//! directions.

use planish_core::{DVec3, Setting};
use planish_estimate::{Error, Result};
use planish_surface::model::{Knowledge, SurfaceModel};

/// The direction of each unknown.
///
/// # Errors
/// `Unsupported` for models with three unknowns for each vertex, and for those of the patch filter.
pub(super) fn directions(model: &SurfaceModel) -> Result<Vec<DVec3>> {
    match &model.known {
        Knowledge::AlongNormals { .. } => Ok(model.surface.directions()),
        Knowledge::PerCoordinate { measured, .. } => {
            Ok(vec![only_coordinate(*measured)?; model.surface.space().node_count()])
        }
        // Both keep no joint covariance of distant vertices, which the choice of points compares.
        Knowledge::Patches(_) => Err(Error::unsupported(
            "expected a model of the global filter, found one of the patch filter, which has no covariance \
             between distant points",
        )
        .with_setting(Setting::Filter)),
        Knowledge::Free { .. } => {
            Err(Error::unsupported("expected a model of a rigid object, found a bending sheet")
                .with_setting(Setting::Motion))
        }
    }
}

/// The axis of the one coordinate that was measured.
fn only_coordinate(measured: [bool; 3]) -> Result<DVec3> {
    if measured.iter().filter(|m| **m).count() != 1 {
        return Err(Error::unsupported(
            "expected a model along normals or of heights, found one with several independently measured \
             coordinates",
        ));
    }
    Ok(DVec3::from(measured.map(|m| if m { 1.0 } else { 0.0 })))
}
