//! A fitted surface with its information: what is saved, compared, updated and exported.
//!
//! Prior and data information are kept apart, so that a later session adds its data and counts the prior
//! once.

mod creases;
mod departure;
mod knowledge;
mod point_sigmas;
mod posterior;
mod predictive;
mod reports;
mod support;
mod topology;

pub use creases::CreaseSummary;
pub use departure::Departure;
pub use knowledge::{Knowledge, VertexInformation};
pub(crate) use point_sigmas::order_by_leaf;
pub use point_sigmas::sigmas_along;
pub use posterior::{GlobalCovariance, LeafCovariance, NodeCovariance, Posterior, VertexMotion};
pub use predictive::{PredictionError, PredictiveSigma};
pub use reports::{ScanPoseReport, SensorReport, SigmaSummary};
pub(crate) use support::middles;
pub use support::{MAX_SUPPORT_DEPTH, Support, SupportCell};
pub use topology::SurfaceTopology;
pub(crate) use topology::is_closed;

use planish_core::DVec3;
use planish_estimate::sparse::{BlockInformation, Bordered, CholeskyFactor, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_spline::{PatchFilter, Surface, SurfaceSystem};
use posterior::ScanErrorRows;
use std::sync::Arc;

/// Information about poses and biases of scans, which are unknowns in addition to the vertices.
///
/// Vertices move along the surface's [`directions`](Surface::directions). The unknowns are those of
/// [`ScanPoseReport`]s, scan after scan. See [`planish_estimate::sparse::Bordered`].
#[derive(Debug, Clone, PartialEq)]
pub struct ScanErrorInformation {
    /// Coupling of displacements of vertices and unknowns, row by row.
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
    /// By measurements: readings within the gate lie within a few of their own spacings in several
    /// directions.
    Measured,
    /// By inference from measurements elsewhere: a symmetry, a simple shape, an earlier state.
    Inferred,
    /// By measurements that the surface does not follow: an edge, a handle, a thin part, or a wrong shape.
    NotFollowed,
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
            Self::NotFollowed => 3,
        }
    }

    /// The meaning of a number in a file; none if it has none.
    #[must_use]
    pub fn from_mark(mark: u8) -> Option<Self> {
        [Self::PriorOnly, Self::Measured, Self::Inferred, Self::NotFollowed]
            .into_iter()
            .find(|o| o.mark() == mark)
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
    /// For each leaf, how most of it is known.
    pub observed: Vec<Observed>,
    /// How each place is known; empty if it is known by leaf only (then as `observed` states).
    pub support: Support,
    /// Errors of places without readings; none if the covariance alone gives their σ.
    pub predictive: Option<PredictiveSigma>,
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
        self.area_fraction_of(&areas, kind)
    }

    /// [`SurfaceModel::area_fraction`] with the area of each leaf at hand.
    pub(crate) fn area_fraction_of(&self, areas: &[f64], kind: Observed) -> f64 {
        let share = |leaf: usize| match self.support.is_empty() {
            true => f64::from(u8::from(self.observed[leaf] == kind)),
            false => self.support.share(leaf, kind),
        };
        // A fold from 0, since the sum of no numbers is −0.
        areas.iter().enumerate().fold(0.0, |sum, (leaf, area)| sum + share(leaf) * area)
            / areas.iter().sum::<f64>()
    }

    /// How the place at leaf-local coordinates is known.
    #[must_use]
    pub fn observed_at(&self, leaf: usize, local: [f64; 2]) -> Observed {
        match self.support.is_empty() {
            true => self.observed.get(leaf).copied().unwrap_or_default(),
            false => self.support.at(leaf, local).observed,
        }
    }

    /// Marks the places of a leaf that were not measured as inferred.
    pub(crate) fn set_inferred(&mut self, leaf: usize) {
        if self.support.is_empty() {
            self.observed[leaf] = Observed::Inferred;
        } else {
            self.support.set_inferred(leaf);
            self.observed[leaf] = self.support.of_leaf(leaf);
        }
    }

    /// Marks the measured places of a leaf in a rectangle of leaf-local coordinates (from, to) as not
    /// followed by the surface.
    pub fn set_not_followed(&mut self, leaf: usize, part: [[f64; 2]; 2]) {
        if self.support.is_empty() {
            let whole = |observed: &Observed| (0, vec![SupportCell { observed: *observed, distance: 0.0 }]);
            self.support = Support::new(self.observed.iter().map(whole).collect()).unwrap_or_default();
        }
        self.support.set_not_followed(leaf, part);
        if let Some(observed) = self.observed.get_mut(leaf) {
            *observed = self.support.of_leaf(leaf);
        }
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
        Ok(Posterior::new(&self.surface, Arc::new(covariance)).of_model(self))
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
                let directions = self.surface.directions();
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
