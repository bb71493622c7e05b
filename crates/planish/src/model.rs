//! A fitted surface with what is known of it: the thing that is saved, compared, updated and exported.
//!
//! Prior and data information are kept apart, so that a later session adds its data to yesterday's and counts the prior once.

use planish_estimate::sparse::{BlockInformation, SelectedInverse};
use planish_estimate::vector3::{add, dot};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_spline::{Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What a fit says of one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// Its name.
    pub name: String,
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

/// The pose of a scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PoseReport {
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
    /// For each leaf, whether it was measured: an ungated foot point within one knot span.
    pub observed: Vec<bool>,
    /// Sensors that went in.
    pub sensors: Vec<SensorReport>,
    /// Poses that went in.
    pub poses: Vec<PoseReport>,
    /// Weight of the thin-plate energy.
    pub smoothness_weight: f64,
    /// How many readings the data information holds.
    pub observations: usize,
}

/// The posterior covariance of a model's shape, ready for questions.
///
/// Every vertex moves along the surface's normal at its node: the one coordinate that measurements of position determine. Motion along
/// the surface only renames its points, so it is held; see `DESIGN.md`.
pub struct Posterior<'a> {
    surface: &'a Surface,
    covariance: Arc<NodeCovariance>,
}

/// The covariance of a surface's vertices along their normals, where they share a leaf.
pub struct NodeCovariance {
    inverse: SelectedInverse,
    directions: Vec<[f64; 3]>,
}

/// The covariance of one leaf's nodes along their normals: for the many points of one leaf.
pub struct LeafCovariance<'a> {
    weights: &'a [[f64; 16]],
    directions: Vec<[f64; 3]>,
    covariance: Vec<f64>,
}

impl SurfaceModel {
    /// The same model in coordinates whose origin lies at `−by`: every point moves by `by`, no covariance changes.
    ///
    /// # Errors
    /// `Input` when a coordinate would not be finite.
    pub(crate) fn translated(mut self, by: [f64; 3]) -> Result<Self> {
        let vertices = self.surface.vertices().iter().map(|p| add(*p, by)).collect();
        self.surface = self.surface.with_vertices(vertices)?;
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
        Ok(Posterior::new(&self.surface, Arc::new(covariance)))
    }

    /// What [`SurfaceModel::posterior`] is made of, by the equations of the surface's own hierarchy.
    pub(crate) fn covariance(&self, system: &SurfaceSystem) -> Result<NodeCovariance> {
        let directions = system.node_normals(&self.surface);
        let mut total = system.contract(&self.data, &directions)?;
        total.add_scaled(&system.contract(&self.prior, &directions)?, 1.0)?;
        let factor = system.factorize_scalar(&total)?;
        Ok(NodeCovariance {
            inverse: SelectedInverse::new(&factor),
            directions,
        })
    }
}

impl NodeCovariance {
    /// `tr(Σ Λ)` for information of three coordinates on the pattern of the system: the degrees of freedom that it determines.
    pub(crate) fn trace_with(&self, information: &BlockInformation, system: &SurfaceSystem) -> Result<f64> {
        self.inverse
            .trace_with(&system.contract(information, &self.directions)?)
    }
}

impl<'a> Posterior<'a> {
    pub(crate) fn new(surface: &'a Surface, covariance: Arc<NodeCovariance>) -> Self {
        Self { surface, covariance }
    }

    /// The covariance of a leaf's nodes.
    ///
    /// # Errors
    /// `Undetermined` when the leaf's nodes are not coupled, which a model made here never shows.
    pub fn leaf(&self, leaf: usize) -> Result<LeafCovariance<'a>> {
        let (nodes, weights) = self.surface.space().extraction(leaf);
        let NodeCovariance { inverse, directions } = &*self.covariance;
        let covariance = inverse
            .dense(nodes)
            .ok_or_else(|| Error::undetermined(format!("leaf {leaf} has no covariance")))?;
        Ok(LeafCovariance {
            weights,
            directions: nodes.iter().map(|&n| directions[n as usize]).collect(),
            covariance,
        })
    }

    /// The surface that this is the covariance of.
    #[must_use]
    pub fn surface(&self) -> &'a Surface {
        self.surface
    }

    /// σ along the normal at the middle of every leaf that counts as observed (of every leaf where none does), by area.
    ///
    /// # Errors
    /// `Undetermined` when the surface has no area there.
    pub fn sigma_summary(&self, observed: &[bool]) -> Result<SigmaSummary> {
        let any = observed.contains(&true);
        let surface = self.surface();
        let mut by_area: Vec<(f64, f64)> = (0..observed.len())
            .into_par_iter()
            .with_min_len(64)
            .filter(|&leaf| observed[leaf] || !any)
            .map(|leaf| {
                let normal = surface.leaf_jet(leaf, 0.5, 0.5).normal().unwrap_or([0.0; 3]);
                let sigma = Self::sigma_along(&self.leaf(leaf)?, [0.5, 0.5], normal);
                Ok((sigma, surface.leaf_area(leaf)))
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
        Ok(SigmaSummary {
            median: quantile(0.5),
            p95: quantile(0.95),
            max,
        })
    }

    /// σ of the surface point at leaf-local coordinates along a unit direction.
    #[must_use]
    pub fn sigma_along(cell: &LeafCovariance<'_>, local: [f64; 2], direction: [f64; 3]) -> f64 {
        cell.variance_along(&leaf_weights(local[0], local[1]), direction)
            .max(0.0)
            .sqrt()
    }
}

impl LeafCovariance<'_> {
    /// Variance of `a · Σ_k c_k P_k` for the leaf's sixteen coefficients `P_k`.
    #[must_use]
    pub fn variance_along(&self, c: &[f64; 16], a: [f64; 3]) -> f64 {
        // By fours and by rows: a plain sum would wait for each of its additions.
        let row: Vec<f64> = self
            .weights
            .iter()
            .zip(&self.directions)
            .map(|(w, d)| {
                let mut sums = [0.0; 4];
                for k in 0..16 {
                    sums[k % 4] += w[k] * c[k];
                }
                dot(a, *d) * ((sums[0] + sums[1]) + (sums[2] + sums[3]))
            })
            .collect();
        let mut along = vec![0.0; row.len()];
        for (r, line) in row.iter().zip(self.covariance.chunks_exact(row.len())) {
            for (y, s) in along.iter_mut().zip(line) {
                *y += r * s;
            }
        }
        along.iter().zip(&row).map(|(y, r)| y * r).sum()
    }
}
