//! The posterior covariance of a surface.

use super::predictive::PredictiveSigma;
use super::reports::SigmaSummary;
use super::support::Support;
use super::{Observed, SurfaceModel};
use planish_core::DVec3;
use planish_estimate::sparse::{BlockInformation, Bordered, SelectedInverse};
use planish_estimate::{Error, Result};
use planish_spline::{PatchFilter, StateLayout, Surface, SurfaceSystem, leaf_weights};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;

/// The posterior covariance of a model's shape.
///
/// Every vertex moves along the surface's normal at its node, the one coordinate that measurements of
/// position determine. Vertices on creases move across them as well. Motion along the surface only changes
/// the parameters of its points, so it is held; see decision 0002. If parameters were known, every
/// coordinate moves.
pub struct Posterior<'a> {
    surface: &'a Surface,
    covariance: Arc<NodeCovariance>,
    /// True if poses and biases of scans count as known.
    given_scan_errors: bool,
    /// For each leaf the part of σ² that is not in the covariance; none if empty.
    excess_variance: &'a [f64],
    /// Where nothing was measured, and the errors there.
    prediction: Option<(&'a Support, &'a PredictiveSigma)>,
}

/// The covariance of vertices of a surface that share a leaf.
pub enum NodeCovariance {
    /// Of the nodes, from the information of the whole surface.
    Nodes(GlobalCovariance),
    /// Of the coefficients of each patch of a patch filter.
    Patches(Arc<PatchFilter>),
}

/// The covariance of nodes that share a leaf, from the information of the whole surface.
pub struct GlobalCovariance {
    pub(super) inverse: SelectedInverse,
    pub(super) motion: VertexMotion,
    /// What poses and biases of scans add: `G Gᵀ`, with a row of `G` for each unknown of the
    /// vertices.
    pub(super) shared: Option<ScanErrorRows>,
}

/// The rows of `G`: see [`GlobalCovariance`].
pub(super) struct ScanErrorRows {
    pub(super) bordered: Bordered,
    pub(super) rows: Vec<f64>,
}

/// The directions in which vertices move.
pub enum VertexMotion {
    /// One unknown for each of these directions: those of the nodes, or of [`Surface::directions`].
    Along(Vec<DVec3>),
    /// Independent coordinates, each with this multiple of the covariance.
    Coordinates(DVec3),
    /// Three unknowns for each node.
    Freely,
}

/// The covariance of one leaf's nodes, from which σ of any of its points follows.
pub struct LeafCovariance<'a> {
    weights: Cow<'a, [[f64; 16]]>,
    motion: VertexMotion,
    covariance: Vec<f64>,
    /// Part of σ² along the normal that is not in the covariance.
    excess_variance: f64,
    /// The support of the model, this leaf's number, and errors where nothing was measured.
    prediction: Option<(&'a Support, usize, &'a PredictiveSigma)>,
}

/// Identity: the weights of a leaf's sixteen coefficients on themselves.
const IDENTITY_WEIGHTS: [[f64; 16]; 16] = {
    let mut weights = [[0.0; 16]; 16];
    let mut k = 0;
    // Constants cannot be made by `for` loops.
    while k < 16 {
        weights[k][k] = 1.0;
        k += 1;
    }
    weights
};

impl ScanErrorRows {
    /// Adds the covariance that poses and biases cause, for each pair of `unknowns` of vertices.
    fn add_to(&self, covariance: &mut [f64], unknowns: &[u32]) {
        let width = self.bordered.shared();
        let row = |unknown: u32| &self.rows[unknown as usize * width..][..width];
        for (line, &a) in covariance.chunks_exact_mut(unknowns.len()).zip(unknowns) {
            for (entry, &b) in line.iter_mut().zip(unknowns) {
                *entry += row(a).iter().zip(row(b)).map(|(a, b)| a * b).sum::<f64>();
            }
        }
    }
}

impl NodeCovariance {
    /// From the inverse of one coordinate's information: `scale` times that for each measured coordinate,
    /// zero for the others.
    pub(crate) fn of_coordinates(inverse: SelectedInverse, measured: [bool; 3], scale: f64) -> Self {
        let motion = VertexMotion::Coordinates(DVec3::from(measured.map(|m| if m { scale } else { 0.0 })));
        Self::of_motion(inverse, motion)
    }

    /// From the inverse of the information of vertices with the given motion.
    pub(crate) fn of_motion(inverse: SelectedInverse, motion: VertexMotion) -> Self {
        Self::Nodes(GlobalCovariance { inverse, motion, shared: None })
    }

    /// The equations of poses and biases, with the vertices eliminated.
    pub(crate) fn scan_errors(&self) -> Option<&Bordered> {
        match self {
            Self::Nodes(covariance) => covariance.shared.as_ref().map(|shared| &shared.bordered),
            Self::Patches(_) => None,
        }
    }

    /// Removes spurious information about poses and biases, but keeps at least `stated`; returns the change
    /// of their information, too.
    pub(crate) fn without_spurious_information(
        self,
        noise: &[f64],
        stated: &[f64],
    ) -> Result<(Self, Vec<f64>)> {
        match self {
            Self::Nodes(GlobalCovariance { inverse, motion, shared: Some(shared) }) => {
                // The rows of `G` follow from the reduced equations of the scans, so they are made anew.
                let (bordered, change) = shared.bordered.without_noise(noise, stated)?;
                let shared = Some(ScanErrorRows { rows: bordered.shared_rows(), bordered });
                let covariance = GlobalCovariance { inverse, motion, shared };
                Ok((Self::Nodes(covariance), change))
            }
            other => Ok((other, Vec::new())),
        }
    }

    /// `tr(Σ Λ)` for information `Λ` of three coordinates: the degrees of freedom that it determines.
    pub(crate) fn trace_with(&self, information: &BlockInformation, system: &SurfaceSystem) -> Result<f64> {
        let directions = |axis| vec![axis; system.space().node_count()];
        let Self::Nodes(GlobalCovariance { inverse, motion, .. }) = self else {
            return Err(Error::unsupported("patches have no covariance between distant vertices"));
        };
        match motion {
            VertexMotion::Along(directions) => inverse.trace_with(&system.contract(information, directions)?),
            VertexMotion::Freely => inverse.trace_with(information),
            VertexMotion::Coordinates(scales) => (0..3)
                .filter(|&d| scales[d] > 0.0)
                .map(|d| {
                    let mut axis = DVec3::ZERO;
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
        Self { surface, covariance, given_scan_errors: false, excess_variance: &[], prediction: None }
    }

    /// The same with the part of σ² of each leaf that is not in the covariance.
    pub(crate) fn with_excess_variance(self, excess_variance: &'a [f64]) -> Self {
        Self { excess_variance, ..self }
    }

    /// The same with what a model states about σ besides the covariance: excess variance, and errors where
    /// nothing was measured.
    pub(crate) fn of_model(self, model: &'a SurfaceModel) -> Self {
        let prediction = model.predictive.as_ref().map(|errors| (&model.support, errors));
        Self { excess_variance: &model.excess_variance, prediction, ..self }
    }

    /// The same as if poses and biases of all scans were known. This is the surface as seen from the scans.
    pub(crate) fn given_scan_errors(&self) -> Self {
        Self {
            surface: self.surface,
            covariance: Arc::clone(&self.covariance),
            given_scan_errors: true,
            excess_variance: self.excess_variance,
            prediction: self.prediction,
        }
    }

    /// The covariance of a leaf's nodes.
    ///
    /// # Errors
    /// `Undetermined` if the leaf's nodes are not coupled, which does not happen for models of this crate.
    pub fn leaf(&self, leaf: usize) -> Result<LeafCovariance<'a>> {
        let excess_variance = self.excess_variance.get(leaf).copied().unwrap_or(0.0);
        let prediction = self.prediction.map(|(support, errors)| (support, leaf, errors));
        let unknown = || Error::undetermined(format!("leaf {leaf} has no covariance"));
        let GlobalCovariance { inverse, motion, shared } = match &*self.covariance {
            NodeCovariance::Nodes(covariance) => covariance,
            NodeCovariance::Patches(filter) => {
                return Ok(LeafCovariance {
                    weights: Cow::Borrowed(&IDENTITY_WEIGHTS),
                    // A patch filter knows coefficients of leaves directly, so the weights are the identity.
                    motion: VertexMotion::Coordinates(match filter.options().layout {
                        StateLayout::Height => DVec3::Z,
                        _ => DVec3::splat(1.0),
                    }),
                    covariance: filter.leaf_covariance(leaf).ok_or_else(unknown)?,
                    excess_variance,
                    prediction,
                });
            }
        };
        let space = self.surface.space();
        let (nodes, weights) = space.extraction(leaf);
        let (mut unknowns, mut weights) = (Cow::Borrowed(nodes), Cow::Borrowed(weights));
        if let VertexMotion::Along(directions) = motion
            && directions.len() > space.node_count()
        {
            let (all, of_all): (Vec<u32>, Vec<[f64; 16]>) =
                space.unknowns(leaf).map(|(unknown, weights)| (unknown, *weights)).unzip();
            (unknowns, weights) = (Cow::Owned(all), Cow::Owned(of_all));
        }
        // Unknowns of a leaf are coupled in the pattern, so the selected inverse has all of their entries.
        let mut covariance = inverse.dense(&unknowns).ok_or_else(unknown)?;
        if let Some(shared) = shared.as_ref().filter(|_| !self.given_scan_errors) {
            shared.add_to(&mut covariance, &unknowns);
        }
        Ok(LeafCovariance {
            weights,
            motion: match motion {
                VertexMotion::Along(directions) => {
                    VertexMotion::Along(unknowns.iter().map(|&n| directions[n as usize]).collect())
                }
                VertexMotion::Coordinates(scales) => VertexMotion::Coordinates(*scales),
                VertexMotion::Freely => VertexMotion::Freely,
            },
            covariance,
            excess_variance,
            prediction,
        })
    }

    /// Variance of the surface along its normal, at the middle of a leaf.
    pub(crate) fn variance_at_middle(&self, leaf: usize) -> Result<f64> {
        self.variance_in(leaf, [0.5; 2])
    }

    /// Variance of the surface along its normal, at leaf-local coordinates.
    pub(crate) fn variance_in(&self, leaf: usize, [s, t]: [f64; 2]) -> Result<f64> {
        let normal = self.surface.leaf_jet(leaf, s, t).normal().unwrap_or_default();
        Ok(self.leaf(leaf)?.variance_along(&leaf_weights(s, t), normal))
    }

    /// The surface.
    #[must_use]
    pub fn surface(&self) -> &'a Surface {
        self.surface
    }

    /// Quantiles, by area, of σ along the normal at the middle of every measured leaf (of every leaf if none
    /// was measured).
    ///
    /// # Errors
    /// `Undetermined` if the surface has no area there.
    pub fn sigma_summary(&self, observed: &[Observed]) -> Result<SigmaSummary> {
        let is_known = |leaf: usize| observed[leaf].is_measured() && self.is_supported_at_middle(leaf);
        let any = (0..observed.len()).any(is_known);
        let surface = self.surface();
        let mut by_area: Vec<(f64, f64)> = (0..observed.len())
            .into_par_iter()
            .with_min_len(64)
            .filter(|&leaf| is_known(leaf) || !any)
            .map(|leaf| {
                let jet = surface.leaf_jet(leaf, 0.5, 0.5);
                // A collapsed leaf has no normal. Its σ is then zero, and it is dropped below.
                let sigma =
                    Self::sigma_along(&self.leaf(leaf)?, [0.5, 0.5], jet.normal().unwrap_or(DVec3::ZERO));
                // Leaves have different sizes, so quantiles are weighted by area.
                let side = surface.space().leaves()[leaf].side();
                Ok((sigma, jet.area_element() * side * side))
            })
            .collect::<Result<_>>()?;
        // Collapsed leaves have neither area nor σ.
        by_area.retain(|(sigma, area)| *sigma > 0.0 && *area > 0.0);
        by_area.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(max, _)) = by_area.last() else {
            return Err(Error::undetermined(
                "expected measured parts of the surface, found none: σ cannot be summarised",
            ));
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

    /// False if the middle of a leaf was not measured although most of it was.
    fn is_supported_at_middle(&self, leaf: usize) -> bool {
        self.prediction.is_none_or(|(support, _)| support.at(leaf, [0.5; 2]).observed.is_measured())
    }

    /// σ of the surface point at leaf-local coordinates along a unit direction, with the errors of places
    /// where nothing was measured.
    #[must_use]
    pub fn sigma_along(cell: &LeafCovariance<'_>, local: [f64; 2], direction: DVec3) -> f64 {
        // Terms of both signs cancel, and rounding may leave a variance slightly below zero.
        let variance = cell.variance_along(&leaf_weights(local[0], local[1]), direction).max(0.0);
        cell.predicted_variance(local, variance).sqrt()
    }
}

impl LeafCovariance<'_> {
    /// The variance at leaf-local coordinates, with the errors of places where nothing was measured.
    fn predicted_variance(&self, local: [f64; 2], variance: f64) -> f64 {
        let Some((support, leaf, errors)) = self.prediction else { return variance };
        let cell = support.at(leaf, local);
        match cell.observed {
            Observed::PriorOnly => errors.variance_in(leaf, variance, cell.distance),
            Observed::Measured | Observed::Inferred | Observed::NotFollowed => variance,
        }
    }

    /// Variance of `a · Σ_k c_k P_k` for the leaf's sixteen coefficients `P_k`. Unresolved shape is included
    /// for points (weights `c` with sum 1), not for differences of points.
    #[must_use]
    pub fn variance_along(&self, c: &[f64; 16], a: DVec3) -> f64 {
        // Four partial sums: a plain sum would wait for each of its additions.
        let at_point = |w: &[f64; 16]| {
            let mut sums = [0.0; 4];
            for k in 0..16 {
                sums[k % 4] += w[k] * c[k];
            }
            (sums[0] + sums[1]) + (sums[2] + sums[3])
        };
        let (row, scale): (Vec<f64>, f64) = match &self.motion {
            VertexMotion::Along(directions) => {
                ((self.weights.iter().zip(directions)).map(|(w, d)| a.dot(*d) * at_point(w)).collect(), 1.0)
            }
            VertexMotion::Coordinates(scales) => {
                (self.weights.iter().map(at_point).collect(), (0..3).map(|d| scales[d] * a[d] * a[d]).sum())
            }
            VertexMotion::Freely => {
                ((self.weights.iter().map(at_point)).flat_map(|w| a.to_array().map(|c| w * c)).collect(), 1.0)
            }
        };
        // rᵀ Σ r, with Σ row by row in memory order.
        let mut along = vec![0.0; row.len()];
        for (r, line) in row.iter().zip(self.covariance.chunks_exact(row.len())) {
            for (y, s) in along.iter_mut().zip(line) {
                *y += r * s;
            }
        }
        let sum_of_weights: f64 = c.iter().sum();
        scale * along.iter().zip(&row).map(|(y, r)| y * r).sum::<f64>()
            + self.excess_variance * sum_of_weights * sum_of_weights * a.length_squared()
    }
}
