//! The figures of a fit.

use super::enclosing_mesh::TopologyMargin;
use super::misfit_report::MisfitReport;
use super::surface_misfit::UnresolvedPlace;
use super::unresolved_shape::UnresolvedShape;
use super::verdict::FitVerdict;
use super::{Filter, PropagationReport};
use crate::model::{CreaseSummary, ScanPoseReport, SensorReport, SigmaSummary, SurfaceTopology};
use crate::observe::RejectionCause;
use crate::subdivision::LevelRefinement;
use planish_core::finding::{Finding, with_warnings};
use serde::Serialize;
use std::collections::BTreeMap;

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FitTermination {
    /// Nothing is left to refine, and the surface no longer moves.
    Converged,
    /// The tolerance of the options was reached.
    ReachedTolerance,
    /// The limit of coefficients, depth or iterations was reached first.
    Limit,
}

/// Held-out readings compared with the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldOut {
    /// Number of readings.
    pub n: usize,
    /// Root mean square of residual over its predicted σ: 1 if the stated uncertainties are true.
    pub rms_normalised: f64,
}

/// The figures of a fit: the keys of the JSON summary.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FitReport {
    /// Readings used.
    pub observations: usize,
    /// Rejected readings, by cause.
    pub rejected: BTreeMap<String, usize>,
    /// Topology.
    #[serde(flatten)]
    pub topology: SurfaceTopology,
    /// How steadily the readings show it; none for base shapes, and if a model gives the topology.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topology_margin: Option<TopologyMargin>,
    /// Control vertices.
    pub coefficients: usize,
    /// Levels of the hierarchy.
    pub levels: usize,
    /// Leaf cells.
    pub cells: usize,
    /// How readings were fused.
    pub filter: Filter,
    /// Divided cells by level and cause.
    pub refined: Vec<LevelRefinement>,
    /// Root mean square of the residuals along the normals, in the model's unit.
    pub rms: f64,
    /// Root mean square of each residual over its σ.
    pub rms_normalised: f64,
    /// Residual χ² over the degrees of freedom.
    pub reduced_chi_square: f64,
    /// One entry for each sensor and quantity.
    pub sensors: Vec<SensorReport>,
    /// One entry for each scan.
    pub poses: Vec<ScanPoseReport>,
    /// σ of the surface along its normal.
    pub sigma: SigmaSummary,
    /// Sharp edges; none if the surface has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub creases: Option<CreaseSummary>,
    /// Shape smaller than the cells, as the readings show it; it is included in σ. None if they show none.
    #[serde(rename = "shape_left", skip_serializing_if = "Option::is_none")]
    pub unresolved_shape: Option<UnresolvedShape>,
    /// What the surface does not follow; it is included in σ. None if it follows its readings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub misfit: Option<MisfitReport>,
    /// Share of the surface's area that was measured.
    pub observed_area_fraction: f64,
    /// Whether the surface follows its readings.
    pub verdict: FitVerdict,
    /// Share of the measured area on which it does not.
    pub unresolved_area_fraction: f64,
    /// The places where it does not, largest first; at most 20.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unresolved_places: Vec<UnresolvedPlace>,
    /// Weight of the thin-plate energy, by marginal likelihood.
    pub smoothness_weight: f64,
    /// What was completed from measurements elsewhere, if that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub propagation: Option<PropagationReport>,
    /// Comparison with the held-out readings.
    pub held_out: HeldOut,
    /// How the fit ended.
    pub termination: FitTermination,
    /// What a user should know.
    #[serde(flatten, serialize_with = "with_warnings")]
    pub findings: Vec<Finding>,
}

impl FitReport {
    /// Rejected readings that might have been of the surface: all but those of unwanted classes, and those
    /// above the ground if only the ground is fitted.
    #[must_use]
    pub fn rejected_readings(&self) -> usize {
        rejected_readings(&self.rejected)
    }
}

/// [`FitReport::rejected_readings`] of a table of causes.
pub(super) fn rejected_readings(rejected: &BTreeMap<String, usize>) -> usize {
    let out_of_scope = [RejectionCause::Class, RejectionCause::AboveGround]
        .map(|cause| rejected.get(cause.name()).copied().unwrap_or(0));
    rejected.values().sum::<usize>() - out_of_scope.iter().sum::<usize>()
}
