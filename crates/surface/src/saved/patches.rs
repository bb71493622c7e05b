//! The state of a patch filter as tensors, and back, to the last bit.

use super::ranges::{check_rows, check_semidefinite};
use super::reading::Tensors;
use super::tensor;
use planish_core::DVec3;
use planish_core::vector3::{coordinates, from_arrays};
use planish_estimate::{Error, Result};
use planish_exchange::model::{Tensor, TensorData};
use planish_spline::{
    FilterPatch, InnovationSum, PATCH_VERTICES, PatchBelief, PatchFilter, PatchFilterOptions,
    PatchFilterState, PatchState, Shape, SmoothnessPrior, StateLayout,
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

const VERTICES: usize = PATCH_VERTICES * PATCH_VERTICES;
const CELLS: usize = 16;

/// Metadata of a filter.
#[derive(Serialize, Deserialize)]
pub(super) struct Notes {
    // The field names are keys of the file format, so they stay.
    layout: String,
    weight: f64,
    hold: f64,
    maximum_depth: u8,
    least_gain: f64,
    expect_detail: bool,
    linearize_at_initial: bool,
    readings: u64,
}

fn name(layout: StateLayout) -> &'static str {
    match layout {
        StateLayout::Height => "height",
        StateLayout::Isotropic => "isotropic",
        StateLayout::Normal => "normal",
        StateLayout::Full => "full",
    }
}

/// Columns of the mean for layouts that can be saved.
fn columns(layout: StateLayout) -> Option<usize> {
    match layout {
        StateLayout::Height => Some(1),
        StateLayout::Isotropic | StateLayout::Normal => Some(3),
        StateLayout::Full => None,
    }
}

fn unsaved() -> Error {
    Error::unsupported(
        "expected the layout of heights, positions or normals for a saved patch filter, found the full \
         layout",
    )
}

/// Adds the tensors of a filter whose patches are reconciled.
pub(super) fn add(tensors: &mut BTreeMap<String, Tensor>, filter: &PatchFilter) -> Result<()> {
    let state = filter.state();
    let columns = columns(state.options.layout).ok_or_else(unsaved)?;
    // Messages between patches are not saved, so none may be pending.
    if state.patches.iter().any(|p| p.before.is_some()) {
        return Err(Error::input("expected reconciled patches in a saved patch filter"));
    }
    let count = state.patches.len();
    let numbers =
        |of: &dyn Fn(&PatchState) -> Vec<f64>| TensorData::F64(state.patches.iter().flat_map(of).collect());
    let cells = (state.patches.iter()).flat_map(|p| [u32::from(p.patch.depth), p.patch.i, p.patch.j]);
    let square = [count, VERTICES, VERTICES];
    let innovations = |p: &PatchState| -> Vec<f64> {
        // Counts share a tensor with sums; a 64-bit float holds them exactly up to 2⁵³.
        let of_cell = |s: &InnovationSum| [s.count as f64, s.normalized_squared, s.far as f64];
        p.innovations.iter().flat_map(of_cell).collect()
    };
    let points = |p: &[DVec3]| tensor(&[p.len(), 3], TensorData::F64(coordinates(p).to_vec()));
    for (name, made) in [
        ("patch_cells", tensor(&[count, 3], TensorData::U32(cells.collect()))),
        ("patch_means", tensor(&[count, VERTICES, columns], numbers(&|p| p.belief.mean().to_vec()))),
        ("patch_covariances", tensor(&square, numbers(&|p| p.belief.covariance().to_vec()))),
        ("patch_priors", tensor(&square, numbers(&|p| p.prior_covariance.clone()))),
        ("patch_innovations", tensor(&[count, CELLS, 3], numbers(&innovations))),
        ("patch_initial", points(&state.initial_vertices)),
        ("patch_metric", points(&state.metric_vertices)),
    ] {
        tensors.insert(name.to_owned(), made);
    }
    Ok(())
}

impl Notes {
    pub(super) fn from_filter(filter: &PatchFilter) -> Self {
        let (options, prior) = (filter.options(), filter.prior());
        Self {
            layout: name(options.layout).to_owned(),
            weight: prior.weight,
            hold: prior.hold,
            maximum_depth: options.maximum_depth,
            least_gain: options.min_gain,
            expect_detail: options.expect_detail,
            linearize_at_initial: options.linearize_at_initial,
            readings: filter.readings(),
        }
    }

    /// The filter from this metadata and the tensors of a file.
    pub(super) fn filter(
        &self,
        shape: Shape,
        base: [usize; 2],
        tensors: &mut Tensors,
    ) -> Result<PatchFilter> {
        let layout = [StateLayout::Height, StateLayout::Isotropic, StateLayout::Normal]
            .into_iter()
            .find(|layout| name(*layout) == self.layout)
            .ok_or_else(|| {
                Error::input(format!(
                    "patch_filter: expected the layout height, isotropic or normal, found `{}`",
                    self.layout
                ))
            })?;
        let columns = columns(layout).ok_or_else(unsaved)?;
        let cells = tensors.u32("patch_cells", &[3])?;
        let means = tensors.f64("patch_means", &[VERTICES, columns])?;
        let covariances = tensors.f64("patch_covariances", &[VERTICES, VERTICES])?;
        let priors = tensors.f64("patch_priors", &[VERTICES, VERTICES])?;
        let innovations = tensors.f64("patch_innovations", &[CELLS, 3])?;
        let count = cells.len() / 3;
        let square = VERTICES * VERTICES;
        // The tensors are compared before they are cut up: a damaged file must give an error, not a panic.
        for (name, found) in [
            ("patch_means", means.len() / (VERTICES * columns)),
            ("patch_covariances", covariances.len() / square),
            ("patch_priors", priors.len() / square),
            ("patch_innovations", innovations.len() / (3 * CELLS)),
        ] {
            if found != count {
                return Err(Error::input(format!(
                    "tensor `{name}`: expected one for each of {count} patches, found {found}"
                )));
            }
        }
        for (name, matrices) in [("patch_covariances", &covariances), ("patch_priors", &priors)] {
            for (p, matrix) in matrices.chunks(square).enumerate() {
                check_semidefinite(format_args!("tensor `{name}`, patch {p}"), matrix, VERTICES)?;
            }
        }
        check_rows("patch_innovations", &innovations, 3, "three numbers ≥ 0", |row| {
            row.iter().all(|&x| x >= 0.0)
        })?;
        let patches = (0..count)
            .map(|p| {
                let depth = u8::try_from(cells[3 * p]).map_err(|_| {
                    Error::input(format!("tensor `patch_cells`: expected a depth, found {}", cells[3 * p]))
                })?;
                let mean = means[p * VERTICES * columns..][..VERTICES * columns].to_vec();
                let of_cell = |k: usize| {
                    let [count, normalized_squared, far] =
                        [0, 1, 2].map(|d| innovations[3 * (CELLS * p + k) + d]);
                    InnovationSum { count: count as u64, normalized_squared, far: far as u64 }
                };
                Ok(PatchState {
                    patch: FilterPatch { depth, i: cells[3 * p + 1], j: cells[3 * p + 2] },
                    belief: PatchBelief::from_covariance(
                        columns,
                        mean,
                        covariances[p * square..][..square].to_vec(),
                    )?,
                    // Messages between patches are not saved: a filter is written after reconciliation
                    // only.
                    before: None,
                    prior_covariance: priors[p * square..][..square].to_vec(),
                    innovations: std::array::from_fn(of_cell),
                })
            })
            .collect::<Result<_>>()?;
        PatchFilter::from_state(&PatchFilterState {
            shape,
            base,
            initial_vertices: from_arrays(tensors.f64("patch_initial", &[3])?.as_chunks::<3>().0).to_vec(),
            metric_vertices: from_arrays(tensors.f64("patch_metric", &[3])?.as_chunks::<3>().0).to_vec(),
            prior: SmoothnessPrior { weight: self.weight, hold: self.hold },
            options: PatchFilterOptions {
                layout,
                maximum_depth: self.maximum_depth,
                min_gain: self.least_gain,
                expect_detail: self.expect_detail,
                linearize_at_initial: self.linearize_at_initial,
            },
            readings: self.readings,
            patches,
        })
    }
}
