//! What is known about the control vertices of a surface.

use super::ScanErrorInformation;
use planish_core::DVec3;
use planish_estimate::Result;
use planish_estimate::sparse::BlockInformation;
use planish_spline::PatchFilter;
use std::sync::Arc;

/// Information about all control vertices of a surface, linearised at it.
///
/// Blocks of three coordinates, one for each node of the hierarchy, in one over the squared unit of length.
/// Prior and data are kept apart, so that an update adds its data and counts the prior once.
#[derive(Debug, Clone)]
pub struct VertexInformation {
    /// Information of the smoothness prior. It includes what holds vertices along the surface: a weak hold,
    /// or the lengths of a sheet that bends without stretch.
    pub prior: BlockInformation,
    /// Information of the measurements.
    pub data: BlockInformation,
}

impl VertexInformation {
    /// Moves the vertices by `by`; the covariance does not change.
    pub(super) fn translate(&mut self, by: DVec3) -> Result<()> {
        for information in [&mut self.prior, &mut self.data] {
            let repeated: Vec<f64> = (0..information.vector().len()).map(|k| by[k % 3]).collect();
            // The matrix does not depend on the origin; the vector becomes η + Λ o (decision 0010).
            information.translate(&repeated)?;
        }
        Ok(())
    }
}

/// What is known about the control vertices, and which of their coordinates are unknowns.
///
/// | variant | made by | unknowns of a vertex |
/// |---|---|---|
/// | `AlongNormals` | a global fit | its displacement along the normal |
/// | `PerCoordinate` | a fit with known parameters | the measured coordinates, independent of each other |
/// | `Free` | a sheet that bends | three coordinates |
/// | `Patches` | the patch filter, a stream | displacements along the normal, by patch |
///
/// # Examples
/// ```
/// use planish_surface::model::Knowledge;
/// use planish_surface::test_support::small_model;
/// let model = small_model(planish_spline::Shape::Ball);
/// assert!(matches!(model.known, Knowledge::AlongNormals { .. }));
/// // Blocks of three for each node.
/// let information = model.known.information().expect("the patch filter alone has none");
/// assert_eq!(information.data.dimension(), 3 * model.surface.space().node_count());
/// ```
#[derive(Debug, Clone)]
pub enum Knowledge {
    /// Vertices move along the normals of the surface at their nodes.
    AlongNormals {
        /// The information of the whole surface.
        information: VertexInformation,
        /// Information about poses and biases of scans; none if all poses are exact.
        scan_errors: Option<ScanErrorInformation>,
    },
    /// The parameters of all readings were known. All measured coordinates of a vertex have the same
    /// information; the others are exact functions of the parameters.
    PerCoordinate {
        /// The information of the whole surface.
        information: VertexInformation,
        /// The coordinates that were measured.
        measured: [bool; 3],
    },
    /// Vertices move in every direction.
    Free {
        /// The information of the whole surface.
        information: VertexInformation,
    },
    /// The state of a patch filter, to which later readings go. Beliefs of single patches are no information
    /// of the whole surface.
    Patches(Arc<PatchFilter>),
}

impl Knowledge {
    /// The information of the whole surface; none for the patch filter.
    #[must_use]
    pub fn information(&self) -> Option<&VertexInformation> {
        match self {
            Self::AlongNormals { information, .. }
            | Self::PerCoordinate { information, .. }
            | Self::Free { information } => Some(information),
            Self::Patches(_) => None,
        }
    }

    /// The information of the whole surface, to be changed; none for the patch filter.
    pub fn information_mut(&mut self) -> Option<&mut VertexInformation> {
        match self {
            Self::AlongNormals { information, .. }
            | Self::PerCoordinate { information, .. }
            | Self::Free { information } => Some(information),
            Self::Patches(_) => None,
        }
    }

    /// Information about poses and biases of scans, if any of them is uncertain.
    #[must_use]
    pub fn scan_errors(&self) -> Option<&ScanErrorInformation> {
        match self {
            // All other kinds of fits take poses as exact.
            Self::AlongNormals { scan_errors, .. } => scan_errors.as_ref(),
            _ => None,
        }
    }

    /// The place of that information; none unless vertices move along normals.
    pub fn scan_errors_mut(&mut self) -> Option<&mut Option<ScanErrorInformation>> {
        match self {
            Self::AlongNormals { scan_errors, .. } => Some(scan_errors),
            _ => None,
        }
    }

    /// The coordinates that were measured, if parameters were known.
    #[must_use]
    pub fn measured_coordinates(&self) -> Option<[bool; 3]> {
        match self {
            Self::PerCoordinate { measured, .. } => Some(*measured),
            _ => None,
        }
    }

    /// The patch filter, if one fused the readings.
    #[must_use]
    pub fn filter(&self) -> Option<&Arc<PatchFilter>> {
        match self {
            Self::Patches(filter) => Some(filter),
            _ => None,
        }
    }
}
