//! Saved models: a [`SurfaceModel`] as a `.planish` file and back.
//!
//! A model is restored bit by bit, and equal models give equal bytes. A `.planish` file has the safetensors
//! format; any reader of that format opens it. With L leaves, N nodes and E entries of the pattern:
//!
//! | tensor | shape, type | what |
//! |---|---|---|
//! | `knots_u`, `knots_v` | f64 | knots of the base grid, each once: 0, 1, … |
//! | `cells` | L × 3, u32 | the leaves: level, column, row |
//! | `shape_left` | L | mean square of the unresolved shape along the normal, if any; a part of σ² |
//! | `observed` | L, u8 | how most of a leaf is known: 1 measured, 2 inferred, 3 not followed, else 0 |
//! | `support_depth` | L, u8 | d of each leaf, if places are known finer than by leaf |
//! | `support_marks` | Σ 4ᵈ, u8 | `observed` of 2ᵈ × 2ᵈ parts of each leaf, row by row |
//! | `support_distance` | Σ 4ᵈ | distance of their middles to the nearest reading; 0 if measured |
//! | `predictive_errors` | n × 3 | distance to the nearest reading, factor and floor of σ there, if any |
//! | `predictive_limits` | 2 | power of the distance beyond these, and the largest σ |
//! | `predictive_departure` | m × 2 | distance, and share of it by which a closed surface departs, if any |
//! | `predictive_departure_of_cells` | L | the same share of each leaf, by the surface that closes it |
//! | `quads` | Q × 4, u32 | corners of the quads, of a surface over quads |
//! | `creases` | C × 2, u32 | vertices of the edges of quads across which normals jump, if any |
//! | `corners` | u32 | vertices on creases that are marked as corners, if there are creases |
//! | `vertices` | N × 3, f64 | control vertices, in the order of the hierarchy's nodes |
//! | `information_data_offsets` | N + 1, u32 | where each column of the lower triangle begins |
//! | `information_data_indices` | E, u32 | row of each entry; the diagonal comes first |
//! | `information_data_values` | E × 3 × 3, f64 | blocks of Λ: rows by entry, columns by column |
//! | `information_data_vector` | N × 3, f64 | η |
//! | `information_prior_…` | as above | the prior's |
//! | `poses` | P × 7, f64 | world from scanner: translation, quaternion x y z w |
//!
//! If a patch filter fused the readings, its state replaces both informations (P patches with 7 × 7 vertices
//! each):
//!
//! | tensor | shape, type | what |
//! |---|---|---|
//! | `patch_cells` | P × 3, u32 | the leaf patches: depth, column, row |
//! | `patch_means` | P × 49 × c, f64 | vertices of each patch; c = 3 coordinates, or 1 height |
//! | `patch_covariances` | P × 49 × 49, f64 | covariance of each coordinate |
//! | `patch_priors` | P × 49 × 49, f64 | the same before any reading |
//! | `patch_innovations` | P × 16 × 3, f64 | by cell: components read, their `Σ e²/S`, those gated |
//! | `patch_initial` | B × 3, f64 | vertices of the first surface over the base grid |
//! | `patch_metric` | B × 3, f64 | the same of the surface whose metric the smoothness prior has |
//!
//! The metadata holds `schema`, `unit`, `shape`, `base`, `observations`, `smoothness_weight`, `sensors`,
//! `poses` (names and σ) and `provenance`: one entry for each session. It also holds `measured_coordinates`
//! if parameters were known, `unit_assumed` if no input stated the unit, `moves_freely` for a sheet that
//! bends, and `patch_filter` for a patch filter.
//! `mean_residual` is the root mean square over all unknowns of the residual of `Λ x = η`, each in its own σ
//! given all others. For a patch filter, it is that of the distances of the vertices from those of the
//! patches.
//!
//! Reading checks the checksums, the range of every number, and the agreement of the vertices with the
//! information. Not guaranteed: that the information is positive definite, of which reading checks only 2 × 2
//! minors; [`SurfaceModel::posterior`] checks it.

mod consistency;
mod patches;
mod ranges;
mod reading;

use crate::model::{Knowledge, SensorReport, SupportCell, SurfaceModel, VertexInformation};
use consistency::MeanResidual;
use planish_core::Finding;
use planish_core::vector3::coordinates;
use planish_estimate::sparse::{BlockInformation, BlockPattern};
use planish_estimate::{Error, Result};
use planish_exchange::model::{ModelFile, Tensor, TensorData, read_model, write_model};
use planish_spline::QuadDomain;
use reading::from_file;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// An input file of a session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionInput {
    /// Its name as the user or a list gave it.
    pub name: String,
    /// Number of points in it; 0 for a list of files.
    pub points: usize,
    /// Hash of the coordinates of its points, in hexadecimal digits; unknown for a list and in older files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points_hash: Option<String>,
}

/// One session that made or updated a model: enough to repeat it, without the time or place of the run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Session {
    /// Version of Planish.
    pub version: String,
    /// The arguments that affect the result, as on the command line.
    pub arguments: Vec<String>,
    /// Seed of every random choice.
    pub seed: u64,
    /// Input files.
    pub inputs: Vec<SessionInput>,
}

/// A model with the sessions that made it.
#[derive(Debug, Clone)]
pub struct SavedModel {
    /// The model.
    pub model: SurfaceModel,
    /// The sessions, oldest first.
    pub provenance: Vec<Session>,
    /// Findings about the file.
    pub findings: Vec<Finding>,
}

/// The metadata of a file.
#[derive(Serialize, Deserialize)]
struct Metadata {
    unit: String,
    shape: String,
    base: [usize; 2],
    observations: usize,
    smoothness_weight: f64,
    sensors: Vec<SensorReport>,
    poses: Vec<PoseNotes>,
    provenance: Vec<Session>,
    /// See [`MeanResidual`]; absent in files of schema 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mean_residual: Option<f64>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    unit_assumed: bool,
    // Older files lack these keys. They are written only if they say something, so other files keep their
    // bytes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    measured_coordinates: Option<[bool; 3]>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    moves_freely: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    patch_filter: Option<patches::Notes>,
}

/// Tensor of the unresolved shape. The name is part of the format and older than the term.
const UNRESOLVED_SHAPE: &str = "shape_left";
/// How parts of leaves are known: see [`Support`](crate::model::Support).
const SUPPORT_DEPTH: &str = "support_depth";
const SUPPORT_MARKS: &str = "support_marks";
const SUPPORT_DISTANCE: &str = "support_distance";
/// Errors where nothing was measured: see [`PredictiveSigma`](crate::model::PredictiveSigma).
const PREDICTIVE_ERRORS: &str = "predictive_errors";
const PREDICTIVE_LIMITS: &str = "predictive_limits";
const DEPARTURE: &str = "predictive_departure";
const DEPARTURE_OF_LEAVES: &str = "predictive_departure_of_cells";
/// Corners of the quads, of a surface over quads.
const QUADS: &str = "quads";
/// Edges of quads across which normals jump, and vertices that are marked as corners; absent without creases.
const CREASES: &str = "creases";
const CORNERS: &str = "corners";
/// Poses and biases of scans: the coupling of vertices, along the surface's normals, with these unknowns, and
/// the information about them.
const SHARED_COUPLING: &str = "information_shared_coupling";
const SHARED_CORNER: &str = "information_shared_corner";

/// Metadata of a pose; its numbers are in the tensor `poses`.
#[derive(Serialize, Deserialize)]
struct PoseNotes {
    scan: String,
    sigma_translation: Option<f64>,
    sigma_rotation_deg: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    undetermined: Vec<[f64; 6]>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    moved: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    turned_deg: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bias: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sigma_bias: Option<f64>,
}

/// Writes a model; `provenance` names the sessions that made it, oldest first.
///
/// # Errors
/// `Input` if a number of the model is not finite; `Io` if the file cannot be written. No partial file is
/// left.
///
/// # Examples
/// ```
/// use planish_surface::saved::{load, save};
/// use planish_surface::test_support::{assert_same_model, small_model};
/// # let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("ball.planish");
/// let model = small_model(planish_spline::Shape::Ball);
/// save(&model, &[], &path)?;
/// assert_same_model(&load(&path)?, &model);
/// # Ok::<(), planish_core::Error>(())
/// ```
pub fn save(model: &SurfaceModel, provenance: &[Session], path: &Path) -> Result<()> {
    let file = to_file(model, provenance).map_err(|e| e.in_context(path.display()))?;
    write_model(path, &file)
}

/// Reads a model.
///
/// # Errors
/// `Io` if the file is missing or unreadable; `Input` if it is damaged or inconsistent; `Unsupported` if a
/// newer version wrote it.
pub fn load(path: &Path) -> Result<SurfaceModel> {
    load_with_provenance(path).map(|saved| saved.model)
}

/// [`load`], with the sessions that made the model.
///
/// # Errors
/// As for [`load`].
pub fn load_with_provenance(path: &Path) -> Result<SavedModel> {
    let file = read_model(path)?;
    from_file(file).map_err(|e| e.in_context(path.display()))
}

fn tensor(shape: &[usize], data: TensorData) -> Tensor {
    Tensor { shape: shape.to_vec(), data }
}

impl PoseNotes {
    fn from_report(pose: &crate::model::ScanPoseReport) -> Self {
        Self {
            scan: pose.scan.clone(),
            sigma_translation: pose.sigma_translation,
            sigma_rotation_deg: pose.sigma_rotation_deg,
            covariance: pose.covariance,
            undetermined: pose.undetermined.clone(),
            moved: pose.moved,
            turned_deg: pose.turned_deg,
            bias: pose.bias,
            sigma_bias: pose.sigma_bias,
        }
    }
}

/// The quads of a domain, with its creases if it has any.
fn domain_tensors(domain: &QuadDomain) -> Vec<(String, Tensor)> {
    let column = |name: &str, shape: &[usize], numbers: &[u32]| {
        (name.to_owned(), Tensor { shape: shape.to_vec(), data: TensorData::U32(numbers.to_vec()) })
    };
    let (quads, creases, corners) = (domain.cells(), domain.creases(), domain.corners());
    let mut tensors = vec![column(QUADS, &[quads.len(), 4], quads.as_flattened())];
    if !creases.is_empty() {
        tensors.push(column(CREASES, &[creases.len(), 2], creases.as_flattened()));
        tensors.push(column(CORNERS, &[corners.len()], corners));
    }
    tensors
}

fn to_file(model: &SurfaceModel, provenance: &[Session]) -> Result<ModelFile> {
    let space = model.surface.space();
    let leaves = space.leaves();
    if model.observed.len() != leaves.len() {
        return Err(Error::input(format!(
            "expected one mark of `observed` per leaf, found {} marks and {} leaves",
            model.observed.len(),
            leaves.len()
        )));
    }
    // JSON has no NaN or infinity, so numbers of the metadata are checked before they are written.
    let sigmas = model.sensors.iter().flat_map(|s| {
        [s.sigma_stated.unwrap_or(0.0), s.sigma_shared.unwrap_or(0.0), s.sigma_estimated, s.rms]
    });
    let pose_sigmas = model
        .poses
        .iter()
        .flat_map(|p| [p.sigma_translation.unwrap_or(0.0), p.sigma_rotation_deg.unwrap_or(0.0)]);
    if !sigmas.chain(pose_sigmas).chain([model.smoothness_weight]).all(f64::is_finite) {
        return Err(Error::input("expected finite σ and weights in the model, found another value"));
    }
    let mut metadata = Metadata {
        unit: model.unit.name().to_owned(),
        unit_assumed: model.unit_assumed,
        shape: space.topology_name().to_owned(),
        base: space.base(),
        observations: model.observations,
        smoothness_weight: model.smoothness_weight,
        sensors: model.sensors.clone(),
        poses: model.poses.iter().map(PoseNotes::from_report).collect(),
        provenance: provenance.to_vec(),
        // Set below, because numbers that are not finite are refused first.
        mean_residual: None,
        measured_coordinates: model.known.measured_coordinates(),
        moves_freely: matches!(model.known, Knowledge::Free { .. }),
        patch_filter: model.known.filter().map(Arc::as_ref).map(patches::Notes::from_filter),
    };
    let knots = |d: usize| Tensor::f64_list((0..=space.base()[d]).map(|k| k as f64).collect());
    let cells = leaves.iter().flat_map(|c| [u32::from(c.level), c.i, c.j]).collect();
    let poses: Vec<f64> =
        model.poses.iter().flat_map(|p| p.translation.into_iter().chain(p.quaternion_xyzw)).collect();
    // Sorted by name, so that equal models give equal bytes.
    let mut tensors: BTreeMap<String, Tensor> = [
        ("knots_u", knots(0)),
        ("knots_v", knots(1)),
        ("cells", tensor(&[leaves.len(), 3], TensorData::U32(cells))),
        (
            "observed",
            tensor(&[leaves.len()], TensorData::U8(model.observed.iter().map(|o| o.mark()).collect())),
        ),
        (
            "vertices",
            tensor(&[space.node_count(), 3], TensorData::F64(coordinates(model.surface.vertices()).to_vec())),
        ),
        ("poses", tensor(&[model.poses.len(), 7], TensorData::F64(poses))),
    ]
    .map(|(name, tensor)| (name.to_owned(), tensor))
    .into();
    if let Some(domain) = space.domain() {
        tensors.extend(domain_tensors(domain));
    }
    if let Some(shared) = model.known.scan_errors() {
        let width = shared.corner.len().isqrt();
        tensors.insert(
            SHARED_COUPLING.to_owned(),
            tensor(&[space.node_count(), width], TensorData::F64(shared.coupling.clone())),
        );
        tensors.insert(
            SHARED_CORNER.to_owned(),
            tensor(&[width, width], TensorData::F64(shared.corner.clone())),
        );
    }
    if !model.excess_variance.is_empty() {
        tensors.insert(UNRESOLVED_SHAPE.to_owned(), Tensor::f64_list(model.excess_variance.clone()));
    }
    if !model.support.is_empty() {
        add_support(&mut tensors, model)?;
    }
    if let Some(predictive) = &model.predictive {
        let errors: Vec<f64> =
            predictive.errors().iter().flat_map(|e| [e.distance, e.factor, e.floor]).collect();
        let limits = vec![predictive.growth(), predictive.largest()];
        tensors.insert(PREDICTIVE_ERRORS.to_owned(), tensor(&[errors.len() / 3, 3], TensorData::F64(errors)));
        tensors.insert(PREDICTIVE_LIMITS.to_owned(), Tensor::f64_list(limits));
        if let Some(departure) = predictive.departure() {
            let shares = departure.by_distance().concat();
            let table = tensor(&[shares.len() / 2, 2], TensorData::F64(shares));
            tensors.insert(DEPARTURE.to_owned(), table);
            let of_leaf = Tensor::f64_list(departure.of_leaf().to_vec());
            tensors.insert(DEPARTURE_OF_LEAVES.to_owned(), of_leaf);
        }
    }
    if let Some(filter) = model.known.filter() {
        patches::add(&mut tensors, filter)?;
    }
    if let Some(VertexInformation { prior, data }) = model.known.information() {
        add_information(&mut tensors, "information_data", data, space.node_count())?;
        add_information(&mut tensors, "information_prior", prior, space.node_count())?;
    }
    // Reading refuses numbers that are not finite, so such a file must not be written.
    for (name, tensor) in &tensors {
        if tensor.as_f64().is_some_and(|values| !values.iter().all(|v| v.is_finite())) {
            return Err(Error::input(format!("`{name}`: expected finite numbers, found another")));
        }
    }
    metadata.mean_residual = Some(MeanResidual::of_model(model)?.rms);
    let metadata =
        serde_json::to_value(metadata).map_err(|e| Error::input("the metadata is no JSON").with_source(e))?;
    Ok(ModelFile { tensors, metadata })
}

fn add_support(tensors: &mut BTreeMap<String, Tensor>, model: &SurfaceModel) -> Result<()> {
    let leaves = model.surface.space().leaves().len();
    if model.support.len() != leaves {
        return Err(Error::input(format!(
            "expected the support of {leaves} leaves, found that of {}",
            model.support.len()
        )));
    }
    let depths: Vec<u8> = model.support.leaves().map(|(depth, _)| depth).collect();
    let cells: Vec<&SupportCell> = model.support.leaves().flat_map(|(_, cells)| cells).collect();
    let marks = cells.iter().map(|cell| cell.observed.mark()).collect();
    let distances = cells.iter().map(|cell| cell.distance).collect();
    tensors.insert(SUPPORT_DEPTH.to_owned(), tensor(&[leaves], TensorData::U8(depths)));
    tensors.insert(SUPPORT_MARKS.to_owned(), tensor(&[cells.len()], TensorData::U8(marks)));
    tensors.insert(SUPPORT_DISTANCE.to_owned(), Tensor::f64_list(distances));
    Ok(())
}

fn add_information(
    tensors: &mut BTreeMap<String, Tensor>,
    name: &str,
    information: &BlockInformation,
    nodes: usize,
) -> Result<()> {
    let pattern = information.pattern();
    if information.block_size() != 3 || information.columns() != 1 || pattern.nodes() != nodes {
        return Err(Error::input(format!(
            "`{name}`: expected blocks of 3 and one vector over {nodes} nodes, found blocks of {} and {} \
             over {}",
            information.block_size(),
            information.columns(),
            pattern.nodes()
        )));
    }
    let (offsets, indices) = flat_pattern(pattern);
    let entries = indices.len();
    for (part, made) in [
        ("offsets", tensor(&[offsets.len()], TensorData::U32(offsets))),
        ("indices", tensor(&[entries], TensorData::U32(indices))),
        ("values", tensor(&[entries, 3, 3], TensorData::F64(information.values().to_vec()))),
        ("vector", tensor(&[nodes, 3], TensorData::F64(information.vector().to_vec()))),
    ] {
        tensors.insert(format!("{name}_{part}"), made);
    }
    Ok(())
}

/// Column offsets and row indices of a pattern's lower triangle.
fn flat_pattern(pattern: &BlockPattern) -> (Vec<u32>, Vec<u32>) {
    let (mut offsets, mut indices) = (vec![0], Vec::with_capacity(pattern.entries()));
    for node in 0..pattern.nodes() {
        indices.extend_from_slice(pattern.column(node));
        offsets.push(indices.len() as u32);
    }
    (offsets, indices)
}

#[cfg(test)]
mod tests;
