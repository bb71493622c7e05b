//! A fitted surface with what is known of it: the thing that is saved, compared, updated and exported.
//!
//! Prior and data information are kept apart, so that a later session adds its data to yesterday's and counts
//! the prior once.

mod point_sigmas;

pub(crate) use point_sigmas::order_by_leaf;
pub use point_sigmas::sigmas_along;

use planish_estimate::sparse::{BlockInformation, Bordered, CholeskyFactor, SelectedInverse};
use planish_estimate::vector3::{add, dot};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_mesh::quantile_of_sorted;
use planish_spline::{PatchFilter, StateLayout, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What a fit says of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// Its name.
    pub name: String,
    /// What it read: `position`, `normal` or `curvature`; σ and residuals are in the model's unit, in
    /// degrees, or in one over the unit.
    #[serde(default = "position")]
    pub quantity: String,
    /// Readings used.
    pub observations: usize,
    /// σ as stated; none where it was not.
    pub sigma_stated: Option<f64>,
    /// σ as the residuals say.
    pub sigma_estimated: f64,
    /// Root mean square of the residuals along the normals.
    pub rms: f64,
    /// Whether the fit used the estimated σ: it was not stated, or the data contradict it.
    pub sigma_used_is_estimated: bool,
}

/// What sensors measured before they could measure anything else.
fn position() -> String {
    "position".to_owned()
}

/// Quantiles of the surface's σ along its normal, over its measured area.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SigmaSummary {
    /// The median.
    pub median: f64,
    /// The 95th percentile.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

impl SigmaSummary {
    /// Quantiles over values, all alike; zero of none.
    #[must_use]
    pub fn from_values(mut sigmas: Vec<f64>) -> Self {
        sigmas.sort_by(f64::total_cmp);
        let at = |share: f64| match sigmas.is_empty() {
            true => 0.0,
            false => quantile_of_sorted(&sigmas, share),
        };
        Self { median: at(0.5), p95: at(0.95), max: at(1.0) }
    }
}

/// The pose of a scan.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ScanPoseReport {
    /// The scan's name.
    pub scan: String,
    /// Translation, world from scanner.
    pub translation: [f64; 3],
    /// Rotation, world from scanner.
    pub quaternion_xyzw: [f64; 4],
    /// σ of the translation.
    pub sigma_translation: Option<f64>,
    /// σ of the rotation in degrees.
    pub sigma_rotation_deg: Option<f64>,
    /// Where the pose was estimated with the surface: the covariance of its translation and of its rotation
    /// vector (radians, about the world's axes).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<[[f64; 6]; 6]>,
    /// Directions of translation and rotation vector that no reading determines, each as long as one σ of
    /// what was stated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undetermined: Vec<[f64; 6]>,
    /// How far the scan's readings were moved from where they were stated to be (root mean square), and by
    /// which angle they were turned, in degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<f64>,
    /// See [`Self::moved`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turned_deg: Option<f64>,
    /// What the sensor added to every reading of the scan, where that was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias: Option<f64>,
    /// Its σ.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_bias: Option<f64>,
}

impl ScanPoseReport {
    /// Sets the covariance of translation and rotation vector, and σ of both: the root mean square over the
    /// three axes.
    pub fn set_covariance(&mut self, covariance: [[f64; 6]; 6]) {
        let sigma = |from: usize| {
            let trace: f64 = (from..from + 3).map(|k| covariance[k][k]).sum();
            (trace / 3.0).max(0.0).sqrt()
        };
        self.sigma_translation = Some(sigma(0));
        self.sigma_rotation_deg = Some(sigma(3).to_degrees());
        self.covariance = Some(covariance);
    }
}

/// What readings say of unknowns that whole scans share, poses and biases, beside the vertices.
///
/// Vertices move along the surface's normals at their nodes; the unknowns are those of [`ScanPoseReport`]s, scan
/// after scan. See [`planish_estimate::sparse::Bordered`].
#[derive(Debug, Clone, PartialEq)]
pub struct ScanErrorInformation {
    /// The coupling of vertices and unknowns, nodes × unknowns, row by row.
    pub coupling: Vec<f64>,
    /// The information about the unknowns, with what was stated of them.
    pub corner: Vec<f64>,
}

/// What a part of a surface is known by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Observed {
    /// The smoothness prior alone.
    #[default]
    PriorOnly,
    /// Measurements: an ungated foot point within one knot span.
    Measured,
    /// What was concluded from measurements elsewhere: a symmetry, a simple shape, an earlier state.
    /// Inferred, however likely.
    Inferred,
}

impl Observed {
    /// Whether it was measured.
    #[must_use]
    pub fn is_measured(self) -> bool {
        self == Self::Measured
    }

    /// The number that stands for it in files.
    #[must_use]
    pub fn mark(self) -> u8 {
        match self {
            Self::PriorOnly => 0,
            Self::Measured => 1,
            Self::Inferred => 2,
        }
    }

    /// What a number in a file stands for.
    #[must_use]
    pub fn from_mark(mark: u8) -> Option<Self> {
        [Self::PriorOnly, Self::Measured, Self::Inferred].into_iter().find(|o| o.mark() == mark)
    }

    /// Of marks of measured parts.
    #[must_use]
    pub fn from_measured(measured: bool) -> Self {
        if measured { Self::Measured } else { Self::PriorOnly }
    }
}

/// A surface and the information about its control vertices.
///
/// Blocks of three, one for each node of `surface.space()`; linearised at `surface`.
#[derive(Debug, Clone)]
pub struct SurfaceModel {
    /// Unit of every length.
    pub unit: Unit,
    /// The posterior mean.
    pub surface: Surface,
    /// Information of the smoothness prior and of the weak hold on tangential motion.
    pub prior: BlockInformation,
    /// Information of the measurements.
    pub data: BlockInformation,
    /// For each leaf, what it is known by.
    pub observed: Vec<Observed>,
    /// For each leaf, the mean square of the shape along its normal that it leaves out, as its readings show;
    /// it is a part of σ. Empty where nothing was looked at.
    pub unresolved_shape: Vec<f64>,
    /// Sensors that went in.
    pub sensors: Vec<SensorReport>,
    /// Poses that went in.
    pub poses: Vec<ScanPoseReport>,
    /// Weight of the thin-plate energy.
    pub smoothness_weight: f64,
    /// How many readings the data information holds.
    pub observations: usize,
    /// Where the parameters of all readings were known: which coordinates were measured, the others being
    /// exact functions of the parameters. All coordinates of a vertex have the same information then, and are
    /// independent. None where readings were projected.
    pub measured_coordinates: Option<[bool; 3]>,
    /// Where a patch filter filtered the readings: what it knows. `prior` and `data` are empty then, because
    /// beliefs of single patches are no information of the whole; σ and later readings are the filter's.
    pub patches: Option<Arc<PatchFilter>>,
    /// What the readings of whole scans err in together; none where every pose was exact.
    pub scan_errors: Option<ScanErrorInformation>,
    /// Whether vertices move in every direction, because more than readings of position holds them: of a
    /// sheet that bends without stretch, `prior` knows the lengths.
    pub moves_freely: bool,
}

/// The posterior covariance of a model's shape, ready for questions.
///
/// Every vertex moves along the surface's normal at its node: the one coordinate that measurements of
/// position determine. Motion along the surface only renames its points, so it is held; see `DESIGN.md`.
/// Where parameters were known every coordinate moves.
pub struct Posterior<'a> {
    surface: &'a Surface,
    covariance: Arc<NodeCovariance>,
    /// Whether what scans share counts as known.
    given_shared: bool,
    /// For each leaf what it leaves out of the shape; nothing where it is empty.
    unresolved_shape: &'a [f64],
}

/// The covariance of a surface's vertices where they share a leaf.
pub enum NodeCovariance {
    /// Of the nodes, from the information of the whole.
    Nodes(WholeCovariance),
    /// Of the coefficients that each patch knows.
    Patches(Arc<PatchFilter>),
}

/// The covariance of nodes that share a leaf.
pub struct WholeCovariance {
    inverse: SelectedInverse,
    motion: VertexMotion,
    /// What shared unknowns add: `G Gᵀ`, node by node a row of `G`.
    shared: Option<SharedRows>,
}

/// The rows of `G`.
struct SharedRows {
    bordered: Bordered,
    rows: Vec<f64>,
}

/// How vertices may move.
pub enum VertexMotion {
    /// One unknown a node, along these directions.
    Along(Vec<[f64; 3]>),
    /// The coordinates independently of each other, each with so many times the covariance.
    Coordinates([f64; 3]),
    /// Three unknowns a node.
    Freely,
}

/// The covariance of one leaf's nodes: for the many points of one leaf.
pub struct LeafCovariance<'a> {
    weights: &'a [[f64; 16]],
    motion: VertexMotion,
    covariance: Vec<f64>,
    /// The mean square of what the leaf leaves out of the shape.
    unresolved_shape: f64,
}

/// The sixteen coefficients of a leaf as functions of themselves.
const IDENTITY_WEIGHTS: [[f64; 16]; 16] = {
    let mut weights = [[0.0; 16]; 16];
    let mut k = 0;
    while k < 16 {
        weights[k][k] = 1.0;
        k += 1;
    }
    weights
};

impl SurfaceModel {
    /// Share of the area that is known so.
    #[must_use]
    pub fn area_fraction(&self, known: Observed) -> f64 {
        let areas: Vec<f64> = (0..self.observed.len()).map(|leaf| self.surface.leaf_area(leaf)).collect();
        let of_kind = areas.iter().zip(&self.observed).filter(|(_, o)| **o == known);
        // The sum of nothing is −0.
        of_kind.fold(0.0, |sum, (a, _)| sum + a) / areas.iter().sum::<f64>()
    }

    /// The same model in coordinates whose origin lies at `−by`: every point moves by `by`, no covariance
    /// changes.
    ///
    /// # Errors
    /// `Input` when a coordinate would not be finite.
    pub(crate) fn translated(mut self, by: [f64; 3]) -> Result<Self> {
        let vertices = self.surface.vertices().iter().map(|p| add(*p, by)).collect();
        self.surface = self.surface.with_vertices(vertices)?;
        if let Some(filter) = &self.patches {
            let mut state = filter.state();
            state.translate(by);
            self.patches = Some(Arc::new(PatchFilter::from_state(&state)?));
        }
        for information in [&mut self.prior, &mut self.data] {
            let repeated: Vec<f64> = (0..information.vector().len()).map(|k| by[k % 3]).collect();
            information.translate(&repeated)?;
        }
        Ok(self)
    }

    /// Factors the information and inverts it where nodes share a leaf.
    ///
    /// # Errors
    /// `Undetermined` when prior and data leave a vertex open.
    pub fn posterior(&self) -> Result<Posterior<'_>> {
        let covariance = self.covariance(&SurfaceSystem::new(self.surface.space())?)?;
        Ok(Posterior::new(&self.surface, Arc::new(covariance)).with_unresolved_shape(&self.unresolved_shape))
    }

    /// What [`SurfaceModel::posterior`] is made of, by the equations of the surface's own hierarchy.
    pub(crate) fn covariance(&self, system: &SurfaceSystem) -> Result<NodeCovariance> {
        if let Some(filter) = &self.patches {
            return Ok(NodeCovariance::Patches(Arc::clone(filter)));
        }
        if let Some(measured) = self.measured_coordinates {
            // One coordinate's information is that of all that were measured.
            let mut axis = [0.0; 3];
            axis[measured.iter().position(|m| *m).unwrap_or(0)] = 1.0;
            let along = vec![axis; self.surface.space().node_count()];
            let factor = system.factorize_scalar(&self.information_along(system, &along)?)?;
            return Ok(NodeCovariance::of_coordinates(SelectedInverse::new(&factor), measured, 1.0));
        }
        if self.moves_freely {
            let mut total = self.data.on_pattern(system.pattern())?;
            total.add_scaled(&self.prior.on_pattern(system.pattern())?, 1.0)?;
            let factor = system.factorize(&total)?;
            return Ok(NodeCovariance::of_motion(SelectedInverse::new(&factor), VertexMotion::Freely));
        }
        let directions = system.node_normals(&self.surface);
        let factor = system.factorize_scalar(&self.information_along(system, &directions)?)?;
        self.covariance_along(&factor, directions)
    }

    /// Information of data and prior about vertices that move along one direction each.
    pub fn information_along(
        &self,
        system: &SurfaceSystem,
        directions: &[[f64; 3]],
    ) -> Result<BlockInformation> {
        let mut total = system.contract(&self.data, directions)?;
        total.add_scaled(&system.contract(&self.prior, directions)?, 1.0)?;
        Ok(total)
    }

    /// The covariance of vertices that move along one direction each, from the factor of their information,
    /// with what scans share.
    pub fn covariance_along(
        &self,
        factor: &CholeskyFactor,
        directions: Vec<[f64; 3]>,
    ) -> Result<NodeCovariance> {
        let shared = match &self.scan_errors {
            None => None,
            Some(ScanErrorInformation { coupling, corner }) => Some(Bordered::new(factor, coupling, corner)?),
        };
        Ok(NodeCovariance::Nodes(WholeCovariance {
            inverse: SelectedInverse::new(factor),
            motion: VertexMotion::Along(directions),
            shared: shared.map(|bordered| SharedRows { rows: bordered.shared_rows(), bordered }),
        }))
    }
}

impl SharedRows {
    /// Adds what two nodes share, for each pair of some.
    fn add_to(&self, covariance: &mut [f64], nodes: &[u32]) {
        let width = self.bordered.shared();
        let row = |node: u32| &self.rows[node as usize * width..][..width];
        for (line, &a) in covariance.chunks_exact_mut(nodes.len()).zip(nodes) {
            for (entry, &b) in line.iter_mut().zip(nodes) {
                *entry += row(a).iter().zip(row(b)).map(|(a, b)| a * b).sum::<f64>();
            }
        }
    }
}

impl NodeCovariance {
    /// From the inverse of one coordinate's information: `scale` times that for each measured coordinate,
    /// nothing for the others.
    pub(crate) fn of_coordinates(inverse: SelectedInverse, measured: [bool; 3], scale: f64) -> Self {
        let motion = VertexMotion::Coordinates(measured.map(|m| if m { scale } else { 0.0 }));
        Self::of_motion(inverse, motion)
    }

    /// From the inverse of the information of vertices that move so.
    pub(crate) fn of_motion(inverse: SelectedInverse, motion: VertexMotion) -> Self {
        Self::Nodes(WholeCovariance { inverse, motion, shared: None })
    }

    /// The equations of what scans share, the vertices left open.
    pub(crate) fn shared(&self) -> Option<&Bordered> {
        match self {
            Self::Nodes(whole) => whole.shared.as_ref().map(|shared| &shared.bordered),
            Self::Patches(_) => None,
        }
    }

    /// Leaves out information about what scans share that is only noise, never below what `least` says; and
    /// by how much their own has changed.
    pub(crate) fn without_noise_of_shared(self, noise: &[f64], least: &[f64]) -> Result<(Self, Vec<f64>)> {
        match self {
            Self::Nodes(WholeCovariance { inverse, motion, shared: Some(shared) }) => {
                let (bordered, change) = shared.bordered.without_noise(noise, least)?;
                let shared = Some(SharedRows { rows: bordered.shared_rows(), bordered });
                let whole = WholeCovariance { inverse, motion, shared };
                Ok((Self::Nodes(whole), change))
            }
            other => Ok((other, Vec::new())),
        }
    }

    /// `tr(Σ Λ)` for information of three coordinates on the pattern of the system: the degrees of freedom
    /// that it determines.
    pub(crate) fn trace_with(&self, information: &BlockInformation, system: &SurfaceSystem) -> Result<f64> {
        let directions = |axis| vec![axis; system.space().node_count()];
        let Self::Nodes(WholeCovariance { inverse, motion, .. }) = self else {
            return Err(Error::unsupported("patches know nothing of vertices far from each other"));
        };
        match motion {
            VertexMotion::Along(directions) => inverse.trace_with(&system.contract(information, directions)?),
            VertexMotion::Freely => inverse.trace_with(information),
            VertexMotion::Coordinates(scales) => (0..3)
                .filter(|&d| scales[d] > 0.0)
                .map(|d| {
                    let mut axis = [0.0; 3];
                    axis[d] = 1.0;
                    Ok(scales[d] * inverse.trace_with(&system.contract(information, &directions(axis))?)?)
                })
                .sum(),
        }
    }
}

impl<'a> Posterior<'a> {
    /// A surface with the covariance of its control vertices.
    #[must_use]
    pub fn new(surface: &'a Surface, covariance: Arc<NodeCovariance>) -> Self {
        Self { surface, covariance, given_shared: false, unresolved_shape: &[] }
    }

    /// The same with what each leaf leaves out of the shape.
    pub(crate) fn with_unresolved_shape(self, unresolved_shape: &'a [f64]) -> Self {
        Self { unresolved_shape, ..self }
    }

    /// The same as if poses and biases of all scans were known: what readings of these scans see.
    pub(crate) fn given_shared(&self) -> Self {
        Self {
            surface: self.surface,
            covariance: Arc::clone(&self.covariance),
            given_shared: true,
            unresolved_shape: self.unresolved_shape,
        }
    }

    /// The covariance of a leaf's nodes.
    ///
    /// # Errors
    /// `Undetermined` when the leaf's nodes are not coupled, which a model made here never shows.
    pub fn leaf(&self, leaf: usize) -> Result<LeafCovariance<'a>> {
        let unresolved_shape = self.unresolved_shape.get(leaf).copied().unwrap_or(0.0);
        let unknown = || Error::undetermined(format!("leaf {leaf} has no covariance"));
        let WholeCovariance { inverse, motion, shared } = match &*self.covariance {
            NodeCovariance::Nodes(whole) => whole,
            NodeCovariance::Patches(filter) => {
                return Ok(LeafCovariance {
                    weights: &IDENTITY_WEIGHTS,
                    motion: VertexMotion::Coordinates(match filter.options().layout {
                        StateLayout::Height => [0.0, 0.0, 1.0],
                        _ => [1.0; 3],
                    }),
                    covariance: filter.leaf_covariance(leaf).ok_or_else(unknown)?,
                    unresolved_shape,
                });
            }
        };
        let (nodes, weights) = self.surface.space().extraction(leaf);
        let mut covariance = inverse.dense(nodes).ok_or_else(unknown)?;
        if let Some(shared) = shared.as_ref().filter(|_| !self.given_shared) {
            shared.add_to(&mut covariance, nodes);
        }
        Ok(LeafCovariance {
            weights,
            motion: match motion {
                VertexMotion::Along(directions) => {
                    VertexMotion::Along(nodes.iter().map(|&n| directions[n as usize]).collect())
                }
                VertexMotion::Coordinates(scales) => VertexMotion::Coordinates(*scales),
                VertexMotion::Freely => VertexMotion::Freely,
            },
            covariance,
            unresolved_shape,
        })
    }

    /// The variance of the middle of a leaf along its normal.
    pub(crate) fn variance_at_middle(&self, leaf: usize) -> Result<f64> {
        self.variance_in(leaf, [0.5; 2])
    }

    /// The variance of a place in a leaf along its normal.
    pub(crate) fn variance_in(&self, leaf: usize, [s, t]: [f64; 2]) -> Result<f64> {
        let normal = self.surface.leaf_jet(leaf, s, t).normal().unwrap_or_default();
        Ok(self.leaf(leaf)?.variance_along(&leaf_weights(s, t), normal))
    }

    /// The surface that this is the covariance of.
    #[must_use]
    pub fn surface(&self) -> &'a Surface {
        self.surface
    }

    /// σ along the normal at the middle of every leaf that was measured (of every leaf where none was), by
    /// area.
    ///
    /// # Errors
    /// `Undetermined` when the surface has no area there.
    pub fn sigma_summary(&self, observed: &[Observed]) -> Result<SigmaSummary> {
        let any = observed.contains(&Observed::Measured);
        let surface = self.surface();
        let mut by_area: Vec<(f64, f64)> = (0..observed.len())
            .into_par_iter()
            .with_min_len(64)
            .filter(|&leaf| observed[leaf].is_measured() || !any)
            .map(|leaf| {
                let jet = surface.leaf_jet(leaf, 0.5, 0.5);
                let sigma =
                    Self::sigma_along(&self.leaf(leaf)?, [0.5, 0.5], jet.normal().unwrap_or([0.0; 3]));
                let side = surface.space().leaves()[leaf].side();
                Ok((sigma, jet.area_element() * side * side))
            })
            .collect::<Result<_>>()?;
        by_area.retain(|(sigma, area)| *sigma > 0.0 && *area > 0.0);
        by_area.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(max, _)) = by_area.last() else {
            return Err(Error::undetermined("the surface has no area whose σ could be told"));
        };
        let total: f64 = by_area.iter().map(|(_, area)| area).sum();
        let quantile = |share: f64| {
            let mut sum = 0.0;
            let found = by_area.iter().find(|(_, area)| {
                sum += area;
                sum >= share * total
            });
            found.map_or(max, |(sigma, _)| *sigma)
        };
        Ok(SigmaSummary { median: quantile(0.5), p95: quantile(0.95), max })
    }

    /// σ of the surface point at leaf-local coordinates along a unit direction.
    #[must_use]
    pub fn sigma_along(cell: &LeafCovariance<'_>, local: [f64; 2], direction: [f64; 3]) -> f64 {
        cell.variance_along(&leaf_weights(local[0], local[1]), direction).max(0.0).sqrt()
    }
}

impl LeafCovariance<'_> {
    /// Variance of `a · Σ_k c_k P_k` for the leaf's sixteen coefficients `P_k`: of points of the surface with
    /// what the leaf leaves out of the shape, of differences between them without.
    #[must_use]
    pub fn variance_along(&self, c: &[f64; 16], a: [f64; 3]) -> f64 {
        // By fours and by rows: a plain sum would wait for each of its additions.
        let at_point = |w: &[f64; 16]| {
            let mut sums = [0.0; 4];
            for k in 0..16 {
                sums[k % 4] += w[k] * c[k];
            }
            (sums[0] + sums[1]) + (sums[2] + sums[3])
        };
        let (row, scale): (Vec<f64>, f64) = match &self.motion {
            VertexMotion::Along(directions) => {
                ((self.weights.iter().zip(directions)).map(|(w, d)| dot(a, *d) * at_point(w)).collect(), 1.0)
            }
            VertexMotion::Coordinates(scales) => {
                (self.weights.iter().map(at_point).collect(), (0..3).map(|d| scales[d] * a[d] * a[d]).sum())
            }
            VertexMotion::Freely => {
                ((self.weights.iter().map(at_point)).flat_map(|w| a.map(|c| w * c)).collect(), 1.0)
            }
        };
        let mut along = vec![0.0; row.len()];
        for (r, line) in row.iter().zip(self.covariance.chunks_exact(row.len())) {
            for (y, s) in along.iter_mut().zip(line) {
                *y += r * s;
            }
        }
        let placed: f64 = c.iter().sum();
        scale * along.iter().zip(&row).map(|(y, r)| y * r).sum::<f64>()
            + self.unresolved_shape * placed * placed * dot(a, a)
    }
}
