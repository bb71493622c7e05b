//! The equations of poses and biases, and their coupling with the control vertices.

use super::{Rows, ScanError, ScanErrors};
use crate::model::ScanErrorInformation;
use crate::observe::{Foot, FootChannels, Quantity};
use planish_core::DVec3;
use planish_estimate::Result;
use planish_estimate::sparse::{Bordered, CholeskyFactor};
use planish_spline::Surface;
use rayon::prelude::*;

/// The equations `[… C; Cᵀ P] [x; p] = [… ; h]` of the unknowns `p` of scans.
pub(crate) struct ScanErrorEquations {
    /// `C`, displacements of vertices × unknowns.
    pub coupling: Vec<f64>,
    /// `P`, with what was stated.
    pub corner: Vec<f64>,
    /// `h`.
    pub gradient: Vec<f64>,
    /// The part of `P` that was stated.
    pub prior: Vec<f64>,
    /// What unknowns of earlier sessions add to the right-hand side of the vertices; empty if there are none.
    pub pull: Vec<f64>,
}

/// The linearisation of readings: their feet on a surface whose vertices move along `directions`, with the
/// information of each.
#[derive(Clone, Copy)]
pub(crate) struct Linearized<'a> {
    pub surface: &'a Surface,
    pub directions: &'a [DVec3],
    pub feet: &'a [Foot],
    pub information: &'a [f64],
    pub channels: &'a FootChannels<'a>,
}

/// Writes an `m × m` block on the diagonal of a square matrix of size `width`.
fn put_block(matrix: &mut [f64], width: usize, start: usize, block: &[f64], m: usize) {
    for (a, row) in block.chunks_exact(m).enumerate() {
        matrix[(start + a) * width + start..][..m].copy_from_slice(row);
    }
}

impl ScanErrorEquations {
    /// Equations without information about `width` unknowns.
    fn zeros(displacements: usize, width: usize) -> Self {
        Self {
            coupling: vec![0.0; displacements * width],
            corner: vec![0.0; width * width],
            gradient: vec![0.0; width],
            prior: vec![0.0; width * width],
            pull: Vec::new(),
        }
    }

    /// The information for a model with `factor` times as many readings like these.
    pub(crate) fn into_information(mut self, factor: f64) -> ScanErrorInformation {
        self.coupling.iter_mut().for_each(|c| *c *= factor);
        for (p, prior) in self.corner.iter_mut().zip(&self.prior) {
            // More readings add information, but what was stated counts once.
            *p = factor * (*p - prior) + prior;
        }
        ScanErrorInformation { coupling: self.coupling, corner: self.corner }
    }
}

impl ScanError {
    /// What a draw of the surface's noise adds to [`Self::rows`] of a position, by the tilt of the normal.
    fn noise_rows(&self, surface: &Surface, drawn: &[[DVec3; 16]], foot: &Foot, point: DVec3) -> Rows {
        let mut rows = Rows::default();
        let leaf = foot.leaf as usize;
        if let Some(frame) =
            surface.tangent_rows(leaf, foot.local).filter(|_| foot.quantity == Quantity::Position)
        {
            let [a, b] = [0, 1].map(|t| -> f64 {
                (frame.slopes[t].iter().zip(&drawn[leaf])).map(|(s, c)| s * foot.normal.dot(*c)).sum()
            });
            let turned = a * frame.tangents[0] + b * frame.tangents[1];
            rows[0] = self.position_row(point, turned, foot.normal);
        }
        rows
    }

    /// The equations of one scan, from its readings `own` with their `rows`.
    fn equations(
        &self,
        at: &Linearized<'_>,
        own: &[u32],
        rows: impl Fn(&Foot, usize) -> Rows,
    ) -> ScanErrorEquations {
        let Linearized { surface, directions, feet, information, channels } = *at;
        let (space, m) = (surface.space(), self.width());
        let mut made = ScanErrorEquations::zeros(directions.len(), m);
        for &k in own {
            let (foot, w) = (&feet[k as usize], information[k as usize]);
            let rows = rows(foot, channels.subset[k as usize] as usize);
            foot.rows(surface, |r, over_leaf| {
                let row: Vec<f64> = self.unknowns.iter().map(|&k| rows[r][k]).collect();
                let residual = foot.residuals()[r];
                for (a, ra) in row.iter().enumerate() {
                    made.gradient[a] -= w * ra * residual;
                    for (b, rb) in row.iter().enumerate() {
                        made.corner[a * m + b] += w * ra * rb;
                    }
                }
                for (unknown, weights) in space.unknowns(foot.leaf as usize) {
                    let along: f64 = weights.iter().zip(over_leaf).map(|(w, c)| w * c).sum();
                    // The coupling of a displacement is the product of its row and that of the unknowns,
                    // along its own direction.
                    let of_vertex = w * along * foot.normal.dot(directions[unknown as usize]);
                    if of_vertex != 0.0 {
                        for (c, r) in made.coupling[unknown as usize * m..].iter_mut().zip(&row) {
                            // Negative, because a residual grows with the motion of the scan and falls with
                            // that of the surface.
                            *c -= of_vertex * r;
                        }
                    }
                }
            });
        }
        made
    }
}

impl ScanErrors {
    /// The equations of the unknowns: information of the readings and of the prior, and the coupling with the
    /// vertices.
    pub(crate) fn equations(&self, at: &Linearized<'_>) -> ScanErrorEquations {
        let mut made = self.of_readings(at, |error, foot, i| {
            let observations = at.channels.observations;
            error.rows(at.surface, foot, observations.readings.points[i], &observations.measured(i))
        });
        let width = self.width();
        if let Some(earlier) = &self.earlier {
            let m = earlier.width();
            for (row, part) in
                (made.coupling.chunks_exact_mut(width)).zip(earlier.information.coupling.chunks_exact(m))
            {
                row[..m].copy_from_slice(part);
            }
            put_block(&mut made.corner, width, 0, &earlier.information.corner, m);
            // What earlier sessions know counts as stated: the spurious part was removed from it at their
            // end.
            put_block(&mut made.prior, width, 0, &earlier.information.corner, m);
            let (of_shared, of_vertices) = earlier.products(at.surface, at.directions);
            for (g, product) in made.gradient.iter_mut().zip(of_shared) {
                *g = -product;
            }
            made.pull = of_vertices.iter().map(|product| -product).collect();
        }
        let mut start = self.earlier_width();
        for error in &self.errors {
            let (m, (prior, pull)) = (error.width(), error.prior());
            for a in 0..m {
                for b in 0..m {
                    made.corner[(start + a) * width + start + b] += prior[a * m + b];
                }
                made.gradient[start + a] += pull[a];
            }
            put_block(&mut made.prior, width, start, &prior, m);
            start += m;
        }
        made
    }

    /// The equations of the readings alone, without prior and earlier sessions.
    fn of_readings(
        &self,
        at: &Linearized<'_>,
        rows: impl Fn(&ScanError, &Foot, usize) -> Rows + Sync,
    ) -> ScanErrorEquations {
        let own = self.readings(at.information, at.channels);
        // In parallel by scan, since each has columns of its own.
        let parts: Vec<_> = (self.errors.par_iter().zip(&own))
            .map(|(error, own)| error.equations(at, own, |foot, i| rows(error, foot, i)))
            .collect();
        let (mut start, width) = (self.earlier_width(), self.width());
        let mut made = ScanErrorEquations::zeros(at.directions.len(), width);
        for (error, part) in self.errors.iter().zip(parts) {
            let m = error.width();
            for (row, part) in made.coupling.chunks_exact_mut(width).zip(part.coupling.chunks_exact(m)) {
                row[start..start + m].copy_from_slice(part);
            }
            // A reading belongs to one scan, so scans are coupled through the vertices only.
            put_block(&mut made.corner, width, start, &part.corner, m);
            made.gradient[start..start + m].copy_from_slice(&part.gradient);
            start += m;
        }
        made
    }

    /// Spurious information about poses that comes from the noise of the surface alone: the mean of
    /// `P − Cᵀ A⁻¹ C` over draws of that noise.
    ///
    /// The rows are `J δn`, where the noise adds `δn` to the normals at the feet and
    /// `J = ∂(n, (z − c) × n)/∂n`. The equations of a pose use the normals of the estimated surface. On a
    /// sphere every true row of a rotation is zero. Those of its noisy estimate are not, and would count as
    /// information that does not exist: the more noise, the more of it. All readings are `parts` times as
    /// many as those at hand.
    pub(crate) fn noise_information(
        &self,
        at: &Linearized<'_>,
        factor: &CholeskyFactor,
        noise: &[Vec<[DVec3; 16]>],
        parts: f64,
    ) -> Result<Vec<f64>> {
        let mut mean = vec![0.0; self.width() * self.width()];
        for drawn in noise {
            let equations = self.of_readings(at, |error, foot, i| {
                error.noise_rows(at.surface, drawn, foot, at.channels.observations.readings.points[i])
            });
            let ScanErrorInformation { coupling, corner } = equations.into_information(parts);
            for (mean, seen) in mean.iter_mut().zip(Bordered::complement_of(factor, &coupling, &corner)?) {
                *mean += seen / noise.len() as f64;
            }
        }
        Ok(mean)
    }

    /// For each entry of `errors`, the readings of its scan with a weight.
    fn readings(&self, information: &[f64], channels: &FootChannels<'_>) -> Vec<Vec<u32>> {
        let mut own: Vec<Vec<u32>> = vec![Vec::new(); self.errors.len()];
        for (k, (&i, &w)) in channels.subset.iter().zip(information).enumerate() {
            let scan = channels.observations.readings.scan[i as usize] as usize;
            if w > 0.0
                && let Some(error) = self.of_scan[scan]
            {
                own[error].push(k as u32);
            }
        }
        own
    }
}
