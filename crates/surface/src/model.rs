//! A fitted surface with its information: what is saved, compared, updated and exported.
//!
//! Prior and data information are kept apart, so that a later session adds its data and counts the prior
//! once.

mod knowledge;
mod point_sigmas;
mod posterior;
mod reports;

pub use knowledge::{Knowledge, VertexInformation};
pub(crate) use point_sigmas::order_by_leaf;
pub use point_sigmas::sigmas_along;
pub use posterior::{GlobalCovariance, LeafCovariance, NodeCovariance, Posterior, VertexMotion};
pub use reports::{ScanPoseReport, SensorReport, SigmaSummary};

use planish_core::DVec3;
use planish_estimate::sparse::{BlockInformation, Bordered, CholeskyFactor, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_spline::{PatchFilter, Surface, SurfaceSystem};
use posterior::ScanErrorRows;
use std::sync::Arc;

/// Information about poses and biases of scans, which are unknowns in addition to the vertices.
///
/// Vertices move along the surface's normals at their nodes. The unknowns are those of [`ScanPoseReport`]s,
/// scan after scan. See [`planish_estimate::sparse::Bordered`].
#[derive(Debug, Clone, PartialEq)]
pub struct ScanErrorInformation {
    /// Coupling of vertices and unknowns, nodes × unknowns, row by row.
    pub coupling: Vec<f64>,
    /// Information about the unknowns, including what was stated.
    pub corner: Vec<f64>,
}

/// How a part of a surface is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Observed {
    /// By the smoothness prior alone.
    #[default]
    PriorOnly,
    /// By measurements: a reading within the gate has its foot point within one knot span.
    Measured,
    /// By inference from measurements elsewhere: a symmetry, a simple shape, an earlier state.
    Inferred,
}

impl Observed {
    /// True if it was measured.
    #[must_use]
    pub fn is_measured(self) -> bool {
        self == Self::Measured
    }

    /// The number for it in files.
    #[must_use]
    pub fn mark(self) -> u8 {
        match self {
            // These numbers are part of model and mesh files, so they never change.
            Self::PriorOnly => 0,
            Self::Measured => 1,
            Self::Inferred => 2,
        }
    }

    /// The meaning of a number in a file; none if it has none.
    #[must_use]
    pub fn from_mark(mark: u8) -> Option<Self> {
        [Self::PriorOnly, Self::Measured, Self::Inferred].into_iter().find(|o| o.mark() == mark)
    }

    /// `Measured` or `PriorOnly`.
    #[must_use]
    pub fn from_measured(measured: bool) -> Self {
        if measured { Self::Measured } else { Self::PriorOnly }
    }
}

/// A surface and what is known about its control vertices.
#[derive(Debug, Clone)]
pub struct SurfaceModel {
    /// Unit of every length.
    pub unit: Unit,
    /// True if no file and no option stated the unit. A later session may then state it.
    pub unit_assumed: bool,
    /// The posterior mean.
    pub surface: Surface,
    /// What is known about its control vertices, from which σ follows.
    pub known: Knowledge,
    /// For each leaf, how it is known.
    pub observed: Vec<Observed>,
    /// For each leaf, the part of σ² along the normal that is not in the covariance: the mean square of shape
    /// smaller than the leaf, and errors that neighbouring readings share. Empty if there is none.
    pub excess_variance: Vec<f64>,
    /// Sensors of the readings.
    pub sensors: Vec<SensorReport>,
    /// Poses of the scans.
    pub poses: Vec<ScanPoseReport>,
    /// Weight of the thin-plate energy.
    pub smoothness_weight: f64,
    /// Number of readings in the data information.
    pub observations: usize,
}

impl SurfaceModel {
    /// Share of the area that is known in the given way.
    #[must_use]
    pub fn area_fraction(&self, kind: Observed) -> f64 {
        let areas: Vec<f64> = (0..self.observed.len()).map(|leaf| self.surface.leaf_area(leaf)).collect();
        let of_kind = areas.iter().zip(&self.observed).filter(|(_, o)| **o == kind);
        // A fold from 0, since the sum of no numbers is −0.
        of_kind.fold(0.0, |sum, (a, _)| sum + a) / areas.iter().sum::<f64>()
    }

    /// The same model with every point moved by `by`; covariances do not change.
    ///
    /// # Errors
    /// `Input` if a coordinate would not be finite.
    pub(crate) fn translated(mut self, by: DVec3) -> Result<Self> {
        let vertices = self.surface.vertices().iter().map(|p| *p + by).collect();
        self.surface = self.surface.with_vertices(vertices)?;
        // Poses are reported in world coordinates in any case, so they stay.
        if let Some(information) = self.known.information_mut() {
            information.translate(by)?;
        }
        if let Knowledge::Patches(filter) = &mut self.known {
            let mut state = filter.state();
            state.translate(by);
            *filter = Arc::new(PatchFilter::from_state(&state)?);
        }
        Ok(self)
    }

    /// The posterior covariance: factors the information and inverts it where nodes share a leaf.
    ///
    /// Cost: one sparse factorisation and Takahashi's selected inverse.
    ///
    /// # Errors
    /// `Undetermined` if prior and data leave a vertex open.
    ///
    /// # Examples
    /// ```
    /// use planish_surface::model::Posterior;
    /// use planish_surface::test_support::small_model;
    /// let model = small_model(planish_spline::Shape::Ball);
    /// let posterior = model.posterior()?;
    /// // σ at the middle of a leaf, along the normal there.
    /// let normal = model.surface.leaf_jet(7, 0.5, 0.5).normal().unwrap();
    /// let sigma = Posterior::sigma_along(&posterior.leaf(7)?, [0.5, 0.5], normal);
    /// assert!(sigma > 0.0);
    /// # Ok::<(), planish_core::Error>(())
    /// ```
    pub fn posterior(&self) -> Result<Posterior<'_>> {
        let covariance = self.covariance(&SurfaceSystem::new(self.surface.space())?)?;
        Ok(Posterior::new(&self.surface, Arc::new(covariance)).with_excess_variance(&self.excess_variance))
    }

    /// The covariance behind [`SurfaceModel::posterior`]; `system` is of the surface's hierarchy.
    pub(crate) fn covariance(&self, system: &SurfaceSystem) -> Result<NodeCovariance> {
        match &self.known {
            Knowledge::Patches(filter) => Ok(NodeCovariance::Patches(Arc::clone(filter))),
            Knowledge::PerCoordinate { measured, .. } => {
                // All measured coordinates have the same information, so one of them is enough.
                let mut axis = DVec3::ZERO;
                axis[measured.iter().position(|m| *m).unwrap_or(0)] = 1.0;
                let along = vec![axis; self.surface.space().node_count()];
                let factor = system.factorize_scalar(&self.information_along(system, &along)?)?;
                Ok(NodeCovariance::of_coordinates(SelectedInverse::new(&factor), *measured, 1.0))
            }
            Knowledge::Free { information } => {
                // A saved model has a pattern object of its own; sums need the one of the system.
                let mut total = information.data.on_pattern(system.pattern())?;
                total.add_scaled(&information.prior.on_pattern(system.pattern())?, 1.0)?;
                let factor = system.factorize(&total)?;
                Ok(NodeCovariance::of_motion(SelectedInverse::new(&factor), VertexMotion::Freely))
            }
            Knowledge::AlongNormals { .. } => {
                let directions = system.node_normals(&self.surface);
                let factor = system.factorize_scalar(&self.information_along(system, &directions)?)?;
                self.covariance_along(&factor, directions)
            }
        }
    }

    /// Information of data and prior about vertices that move along one direction each.
    ///
    /// # Errors
    /// `Unsupported` for a model of the patch filter; what the contraction reports for a system of another
    /// hierarchy.
    pub fn information_along(
        &self,
        system: &SurfaceSystem,
        directions: &[DVec3],
    ) -> Result<BlockInformation> {
        let Some(information) = self.known.information() else {
            return Err(Error::unsupported(
                "the patch filter has no information matrix of the whole surface",
            ));
        };
        let mut total = system.contract(&information.data, directions)?;
        total.add_scaled(&system.contract(&information.prior, directions)?, 1.0)?;
        Ok(total)
    }

    /// The covariance of vertices that move along one direction each, from the factor of their information;
    /// poses and biases of scans are included.
    ///
    /// # Errors
    /// `Undetermined` if the poses are not determined.
    pub fn covariance_along(
        &self,
        factor: &CholeskyFactor,
        directions: Vec<DVec3>,
    ) -> Result<NodeCovariance> {
        let shared = match self.known.scan_errors() {
            None => None,
            Some(ScanErrorInformation { coupling, corner }) => Some(Bordered::new(factor, coupling, corner)?),
        };
        Ok(NodeCovariance::Nodes(GlobalCovariance {
            inverse: SelectedInverse::new(factor),
            motion: VertexMotion::Along(directions),
            shared: shared.map(|bordered| ScanErrorRows { rows: bordered.shared_rows(), bordered }),
        }))
    }
}
