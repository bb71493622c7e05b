//! Reconciliation of neighbouring patches at shared vertices, without counting information twice.
//!
//! Input: beliefs of a patch about shared vertices before and after its own readings. Output: a [`Message`]
//! with the *new* information only, and the updated belief of the neighbour. This is the channel filter:
//! common information (the prior, and information inherited from one parent) cancels in the difference.
//!
//! With `s = G x` the shared vertices, `(Σ⁻, μ⁻)` and `(Σ⁺, μ⁺)` the beliefs of the sender before and after,
//! the new information is `Λ = (Σ⁺)⁻¹ − (Σ⁻)⁻¹`. It is computed in the whitened frame of `Σ⁻ = L Lᵀ`, where
//! `L⁻¹ (Σ⁻ − Σ⁺) L⁻ᵀ` has eigenvalues `γ ∈ [0, 1)` with vectors `q`: each is one scalar reading
//!
//! ```text
//! qᵀL⁻¹ s = qᵀL⁻¹ (μ⁻ + (μ⁺ − μ⁻)/γ),    variance (1 − γ)/γ,
//! ```
//!
//! independent of the others. The receiver uses them like any reading, so its interior follows the shared
//! vertices: the mean by `Σ_is Σ_ss⁻¹ δ`, and all covariances. These are eq. 20–22 of the paper with three
//! corrections. Common information is removed first: eq. 21 as printed halves the variance of two children
//! with the same information. The cross term is `Σ_ii,ij (Σ_i + Σ_j)⁻¹ Σ_j`: eq. 22 as printed is transposed
//! and gives indefinite covariances. The interior is updated, too.
//!
//! Not guaranteed: optimality if patches form a loop. On a chain, messages carry all information. In a grid
//! each reading reaches each patch on one path; information on other paths is dropped.
//!
//! # References
//! Grime, Durrant-Whyte, *Data fusion in decentralized sensor networks*, Control Engineering Practice 1994
//! (channel filter); Wang, Wang, *On 3D model construction by fusing heterogeneous sensor data*, 1994, eq.
//! 19–22.

use super::belief::{PatchBelief, Workspace};
use super::quadtree::{Quadtree, SparseRow};
use nalgebra::{DMatrix, DVector};
use planish_estimate::Result;
use std::collections::VecDeque;

/// Directions with a variance below this fraction of the largest are ignored, because they are dominated by
/// rounding. A larger fraction loses information about precisely known directions (test
/// `a_message_gives_the_neighbour_the_joint_estimate`).
const MIN_RELATIVE_VARIANCE: f64 = 1e-11;

/// New information about shared vertices: independent scalar readings of them.
#[derive(Debug, Clone, Default)]
pub(super) struct Message {
    readings: Vec<SharedReading>,
}

#[derive(Debug, Clone)]
struct SharedReading {
    /// Over the shared vertices.
    row: Vec<f64>,
    value: [f64; 3],
    variance: f64,
}

impl Message {
    /// The information about the shared functions `rows` that the sender gained between two beliefs. Relative
    /// reductions of variance below `min_gain` are dropped. Cost: two symmetric eigenproblems of the number
    /// of shared functions.
    pub fn between(before: &PatchBelief, after: &PatchBelief, rows: &[SparseRow], min_gain: f64) -> Self {
        let old = shared_covariance(before, rows);
        let lost = &old - shared_covariance(after, rows);
        // Nothing but rounding has changed.
        if lost.amax() <= 1e-15 * old.amax() {
            return Self::default();
        }
        let eigen = old.symmetric_eigen();
        let largest = eigen.eigenvalues.amax();
        let kept: Vec<usize> =
            (0..rows.len()).filter(|&k| eigen.eigenvalues[k] > MIN_RELATIVE_VARIANCE * largest).collect();
        // W = D^−½ Uᵀ whitens the earlier belief of the sender.
        let whiten = DMatrix::from_fn(kept.len(), rows.len(), |r, c| {
            eigen.eigenvectors[(c, kept[r])] / eigen.eigenvalues[kept[r]].sqrt()
        });
        let gained = (&whiten * lost * whiten.transpose()).symmetric_eigen();
        let (mean, moved) = (shared_mean(before, rows), shared_mean(after, rows));
        let readings = (0..kept.len())
            .filter_map(|k| {
                // A noise-free reading has γ = 1 and would give a reading of variance zero, or slightly below
                // by rounding.
                let gain = gained.eigenvalues[k].min(1.0 - 1e-12);
                (gain > min_gain).then(|| {
                    let row: DVector<f64> = whiten.tr_mul(&gained.eigenvectors.column(k));
                    let at = |m: &DMatrix<f64>, c: usize| m.column(c).dot(&row);
                    let mut value = [0.0; 3];
                    for (c, v) in value.iter_mut().enumerate().take(before.columns()) {
                        let old = at(&mean, c);
                        *v = old + (at(&moved, c) - old) / gain;
                    }
                    SharedReading { row: row.as_slice().to_vec(), value, variance: (1.0 - gain) / gain }
                })
            })
            .collect();
        Self { readings }
    }

    /// True if there is no new information.
    pub fn is_empty(&self) -> bool {
        self.readings.is_empty()
    }

    /// Updates a neighbour with the new information. `rows` are the shared functions in the coefficients of
    /// the neighbour.
    pub fn apply(&self, to: &mut PatchBelief, rows: &[SparseRow], workspace: &mut Workspace) -> Result<()> {
        let mut dense = vec![0.0; to.dimension()];
        for reading in &self.readings {
            dense.fill(0.0);
            for (weight, row) in reading.row.iter().zip(rows) {
                for &(index, w) in row {
                    dense[usize::from(index)] += weight * w;
                }
            }
            let row: SparseRow =
                (0..).zip(&dense).filter(|(_, w)| **w != 0.0).map(|(k, &w)| (k, w)).collect();
            to.update(&row, reading.value, reading.variance, workspace)?;
        }
        Ok(())
    }
}

/// `G Σ Gᵀ`.
fn shared_covariance(belief: &PatchBelief, rows: &[SparseRow]) -> DMatrix<f64> {
    let (n, covariance) = (belief.dimension(), belief.covariance());
    let mut half = DMatrix::<f64>::zeros(n, rows.len());
    for (c, row) in rows.iter().enumerate() {
        for &(index, w) in row {
            let line = &covariance[usize::from(index) * n..][..n];
            for (to, x) in half.column_mut(c).iter_mut().zip(line) {
                *to += w * x;
            }
        }
    }
    let m = DMatrix::from_fn(rows.len(), rows.len(), |r, c| {
        rows[r].iter().map(|&(k, w)| w * half[(usize::from(k), c)]).sum()
    });
    0.5 * (&m + m.transpose())
}

/// `G μ`, with one column per column of the mean.
fn shared_mean(belief: &PatchBelief, rows: &[SparseRow]) -> DMatrix<f64> {
    let columns = belief.columns();
    DMatrix::from_fn(rows.len(), columns, |r, c| {
        rows[r].iter().map(|&(k, w)| w * belief.mean()[usize::from(k) * columns + c]).sum()
    })
}

/// The shared functions of a separator for a state with three coordinates per vertex.
fn for_coordinates(rows: &[SparseRow]) -> Vec<SparseRow> {
    rows.iter()
        .flat_map(|row| (0..3).map(move |d| row.iter().map(|&(k, w)| (3 * k + d, w)).collect()))
        .collect()
}

/// A patch with new readings: its index, and its belief before and after.
pub(super) struct PatchChange {
    pub patch: usize,
    pub before: PatchBelief,
    pub after: PatchBelief,
}

/// Sends the new information of each patch to all others along one path, breadth first from its origin.
///
/// Beliefs already contain the readings of their own patch. Each receiver forms the message to the next patch
/// from its own change, so information is attenuated along the path.
pub(super) fn spread(
    quadtree: &Quadtree,
    beliefs: &mut [&mut PatchBelief],
    changes: &[PatchChange],
    three_coordinates: bool,
    min_gain: f64,
) -> Result<()> {
    let rows: Vec<[Vec<SparseRow>; 2]> = quadtree
        .separators
        .iter()
        .map(|s| match three_coordinates {
            true => [for_coordinates(&s.rows[0]), for_coordinates(&s.rows[1])],
            false => s.rows.clone(),
        })
        .collect();
    let mut workspace = Workspace::default();
    let mut reached = vec![usize::MAX; beliefs.len()];
    // Breadth first: information is attenuated on its path, least on the shortest one.
    for (number, change) in changes.iter().enumerate() {
        reached[change.patch] = number;
        let mut queue: VecDeque<(usize, PatchBelief)> =
            VecDeque::from([(change.patch, change.before.clone())]);
        while let Some((from, before)) = queue.pop_front() {
            for &separator in &quadtree.separators_of[from] {
                let pair = quadtree.separators[separator as usize].patches;
                let side = usize::from(pair[1] as usize == from);
                let to = pair[1 - side] as usize;
                if reached[to] == number {
                    continue;
                }
                let after = if from == change.patch { &change.after } else { &*beliefs[from] };
                let rows = &rows[separator as usize];
                let message = Message::between(&before, after, &rows[side], min_gain);
                if message.is_empty() {
                    continue;
                }
                // Marked even if a later path would carry more: a second message would count the same
                // readings twice.
                reached[to] = number;
                let earlier = beliefs[to].clone();
                message.apply(beliefs[to], &rows[1 - side], &mut workspace)?;
                queue.push_back((to, earlier));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
