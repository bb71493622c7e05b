//! Update with one reading: locate it, form scalar rows, test the innovation, and update the patch.
//!
//! Input: a [`SurfaceReading`]. Output: the updated belief of the patch, and the innovation.
//!
//! Not guaranteed: detection of outliers where there are no other readings yet.

use super::belief::Workspace;
use super::filter::{Member, PatchFilter, PatchUpdate};
use super::options::StateLayout;
use super::quadtree::{SparseRow, vertex_of};
use super::reading::{EquationKind, SurfaceReading};
use crate::foot::{FootPoint, ProjectionOptions, project_onto};
use crate::surface::jet_of;
use planish_core::DVec3;
use planish_estimate::{Error, Result};

/// One row of a reading over the unknowns of its patch: `rowᵀ x = value`, for each column of the mean.
#[derive(Debug, Clone, Default)]
pub(super) struct ScalarReading {
    row: SparseRow,
    value: [f64; 3],
    variance: f64,
    /// Number of scalar values: three for a position whose coordinates share one covariance.
    numbers: usize,
}

/// Patch and cell of a reading.
#[derive(Clone, Copy)]
struct Place {
    patch: usize,
    cell: usize,
    local: [f64; 2],
    side: f64,
}

impl PatchFilter {
    /// Updates the patch of a reading, at a cost that does not depend on the number of earlier readings.
    ///
    /// Cost: 6,000 to 12,000 multiply-adds for [`StateLayout::Height`], [`StateLayout::Isotropic`] and
    /// [`StateLayout::Normal`]; ten times as much for every equation of [`StateLayout::Full`]. Neighbours
    /// receive the information at the next [`Self::reconcile`].
    ///
    /// # Errors
    /// `Input` for values that are not finite, negative variances, and directions that are not unit vectors.
    /// `Undetermined` if the surface has no tangent plane for a normal, or if a noise-free reading measures
    /// something known exactly. `Unsupported` for readings along a direction in an isotropic filter, and for
    /// positions in a filter along normals.
    pub fn observe(&mut self, reading: &SurfaceReading) -> Result<PatchUpdate> {
        self.observe_within(reading, f64::INFINITY)
    }

    /// [`Self::observe`] with a gate: rejects and counts a reading with an innovation beyond `gate` standard
    /// deviations.
    ///
    /// If more than a quarter of the readings of a cell are beyond the gate, they are not outliers but shape
    /// that the patch cannot represent. They are then used with a variance that matches their distance, and
    /// the criteria subdivide the patch.
    ///
    /// # Errors
    /// As for [`Self::observe`].
    pub fn observe_within(&mut self, reading: &SurfaceReading, gate: f64) -> Result<PatchUpdate> {
        let [u, v] = reading.parameters();
        if !(u.is_finite() && v.is_finite()) {
            return Err(Error::input("the parameters of a reading are not finite"));
        }
        let (leaf, local) = self.quadtree.space.locate(u, v);
        let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
        let place = Place {
            patch: patch as usize,
            cell: usize::from(cell),
            local,
            side: self.quadtree.space.leaves()[leaf].side(),
        };
        // Moved out and back instead of borrowed: the rows of the last reading are reused without an
        // allocation.
        let mut scalars = std::mem::take(&mut self.scalars);
        let count = self.scalar_rows(reading, place, &mut scalars);
        let update = count.and_then(|count| self.update_patch(place, &mut scalars[..count], gate));
        self.scalars = scalars;
        update
    }

    fn update_patch(
        &mut self,
        place: Place,
        scalars: &mut [ScalarReading],
        gate: f64,
    ) -> Result<PatchUpdate> {
        let mut update = PatchUpdate {
            patch: self.quadtree.patches[place.patch],
            equations: scalars.iter().map(|s| s.numbers).sum(),
            normalized_squared: 0.0,
            within_gate: true,
        };
        let member = &mut self.members[place.patch];
        // All equations of a reading are judged before any is used; a reading that is half used could not be
        // withdrawn.
        let far = if gate.is_finite() { farthest(member, scalars, gate) } else { None };
        if let Some(square) = far {
            update.within_gate = false;
            let sum = &mut member.innovations[place.cell];
            // Counted although rejected: many rejected readings in one cell are shape and not outliers.
            sum.far += update.equations as u64;
            if !sum.far_is_shape() {
                return Ok(update);
            }
            for scalar in scalars.iter_mut() {
                // Readings of unresolved shape are used with the misfit as additional variance: they pull the
                // surface without being trusted.
                scalar.variance += square;
            }
        }
        // One copy per reconciliation, not per reading.
        if member.before.is_none() {
            member.before = Some(member.belief.clone());
        }
        for scalar in scalars.iter() {
            update.normalized_squared += filtered(member, scalar, &mut self.workspace)?;
        }
        if update.within_gate {
            let sum = &mut member.innovations[place.cell];
            sum.count += update.equations as u64;
            sum.normalized_squared += update.normalized_squared;
        }
        self.readings += 1;
        Ok(update)
    }

    /// Writes the rows of a reading to `out` and returns their number.
    fn scalar_rows(
        &self,
        reading: &SurfaceReading,
        place: Place,
        out: &mut [ScalarReading; 3],
    ) -> Result<usize> {
        let Place { patch, cell, local, side } = place;
        let (layout, member) = (self.options.layout, &self.members[patch]);
        // A fixed point of linearisation makes the result independent of the order of readings.
        let coefficients = if self.options.linearize_at_initial {
            std::array::from_fn(|k| member.initial[vertex_of(cell, k)])
        } else {
            self.cell_coefficients(patch, cell)
        };
        let jet = || jet_of(&coefficients, 1.0 / side, local[0], local[1]);
        let detail = self.detail_variance[usize::from(self.quadtree.patches[patch].depth)];
        let at = |k: usize| vertex_of(cell, k) as u16;
        let mut count = 0;
        let mut add = |value: [f64; 3],
                       variance: f64,
                       numbers: usize,
                       entries: &mut dyn Iterator<Item = (u16, f64)>| {
            let to = &mut out[count];
            to.row.clear();
            to.row.extend(entries);
            (to.value, to.variance, to.numbers) = (value, variance, numbers);
            count += 1;
        };
        if layout == StateLayout::Normal {
            let mut offsets = [None; 3];
            reading.offsets(local, side, jet, &mut offsets)?;
            for offset in offsets.iter().flatten() {
                let value = [0, 1, 2].map(|d| {
                    let predicted: f64 =
                        offset.weights.iter().zip(&coefficients).map(|(w, p)| w * p[d]).sum();
                    predicted + offset.residual * offset.direction[d]
                });
                let variance = offset.variance + offset.detail_fraction * detail;
                add(value, variance, 1, &mut (0..16).map(|k| (at(k), offset.weights[k])));
            }
            return Ok(count);
        }
        let mut equations = [None; 3];
        reading.equations(local, side, jet, &mut equations)?;
        for equation in equations.iter().flatten() {
            let variance = equation.variance + equation.detail_fraction * detail;
            match (layout, equation.what) {
                (StateLayout::Height, EquationKind::Point(weights, p)) => {
                    add([p[2], 0.0, 0.0], variance, 1, &mut (0..16).map(|k| (at(k), weights[k])));
                }
                (StateLayout::Isotropic, EquationKind::Point(weights, p)) => {
                    add(p.to_array(), variance, 3, &mut (0..16).map(|k| (at(k), weights[k])));
                }
                (StateLayout::Full, EquationKind::Point(weights, p)) => {
                    for (d, z) in (0..3).zip(p.to_array()) {
                        let mut entries = (0..16).map(|k| (3 * at(k) + d, weights[k]));
                        add([z, 0.0, 0.0], variance, 1, &mut entries);
                    }
                }
                (StateLayout::Height, EquationKind::Form(form, mut value)) => {
                    // The first two coordinates are fixed in this layout, so their contribution moves to the
                    // value.
                    for (k, f) in form.iter().enumerate() {
                        let known = member.initial[vertex_of(cell, k)];
                        value -= f[0] * known[0] + f[1] * known[1];
                    }
                    add([value, 0.0, 0.0], variance, 1, &mut (0..16).map(|k| (at(k), form[k][2])));
                }
                (StateLayout::Full, EquationKind::Form(form, value)) => {
                    let mut entries = (0..16)
                        .flat_map(|k| (0..3).zip(form[k].to_array()).map(move |(d, f)| (3 * at(k) + d, f)));
                    add([value, 0.0, 0.0], variance, 1, &mut entries);
                }
                (StateLayout::Isotropic, EquationKind::Form(..)) => {
                    return Err(Error::unsupported(
                        "a filter whose coordinates share one covariance accepts only positions with \
                         isotropic noise: use the full layout",
                    ));
                }
                (StateLayout::Normal, _) => unreachable!("a filter along normals has separate rows"),
            }
        }
        Ok(count)
    }

    /// The foot point of `z` on the current estimate, by damped Newton from `(u, v)`:
    /// [`crate::Surface::project`] without building a surface. Every patch provides its own cells.
    #[must_use]
    pub fn project(&self, z: DVec3, start: [f64; 2], options: &ProjectionOptions) -> FootPoint {
        let space = &self.quadtree.space;
        let jet_at = |leaf: usize, [s, t]: [f64; 2]| {
            let (patch, cell) = self.quadtree.patch_of_leaf[leaf];
            let coefficients = self.cell_coefficients(patch as usize, usize::from(cell));
            jet_of(&coefficients, 1.0 / space.leaves()[leaf].side(), s, t)
        };
        project_onto(space, jet_at, z, start, options)
    }
}

/// The square of the largest normalised innovation, if it is beyond `gate` standard deviations.
fn farthest(member: &Member, scalars: &[ScalarReading], gate: f64) -> Option<f64> {
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for scalar in scalars {
        let expected = member.belief.mean_of(&scalar.row);
        let variance = member.belief.variance_of(&scalar.row).max(0.0) + scalar.variance;
        let residual = [0, 1, 2].map(|d| scalar.value[d] - expected[d]);
        let columns = &residual[..member.belief.columns()];
        // The three columns of one value form a vector along its direction.
        let square = if scalar.numbers == 1 {
            dot3(columns)
        } else {
            columns.iter().fold(0.0, |m: f64, r| m.max(r * r))
        };
        worst = worst.max(square / variance);
        largest = largest.max(square);
    }
    (worst > gate * gate).then_some(largest)
}

fn dot3(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum()
}

/// Updates a patch with one row. Returns the squared innovation divided by its variance, summed over all
/// columns.
fn filtered(member: &mut Member, scalar: &ScalarReading, workspace: &mut Workspace) -> Result<f64> {
    let innovation = (member.belief).update(&scalar.row, scalar.value, scalar.variance, workspace)?;
    Ok(dot3(&innovation.residual) / innovation.variance)
}

#[cfg(test)]
mod tests;
