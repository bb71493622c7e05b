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
//! | `observed` | L, u8 | 1 for a measured leaf, 2 for one inferred by symmetry or smoothness, else 0 |
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
//! if parameters were known, `moves_freely` for a sheet that bends, and `patch_filter` for a patch filter.
//!
//! Not guaranteed: that the information is positive definite; [`SurfaceModel::posterior`] checks it.

mod patches;

use crate::model::{
    Knowledge, Observed, ScanErrorInformation, ScanPoseReport, SensorReport, SurfaceModel, VertexInformation,
};
use planish_core::vector3::{coordinates, from_arrays};
use planish_estimate::sparse::{BlockInformation, BlockPattern};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::model::{ModelFile, Tensor, TensorData, read_model, write_model};
use planish_spline::{Cell, Hierarchy, MAX_LEVEL, Shape, Surface};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Largest number of cells of the finest grid. A hierarchy keeps a mark for each, so more would take
/// gigabytes.
const MAX_CELLS_OF_A_LEVEL: u64 = 1 << 27;

/// An input file of a session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionInput {
    /// Its name as the user or a list gave it.
    pub name: String,
    /// Number of points in it; 0 for a list of files.
    pub points: usize,
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
    let sigmas = model.sensors.iter().flat_map(|s| [s.sigma_stated.unwrap_or(0.0), s.sigma_estimated, s.rms]);
    let pose_sigmas = model
        .poses
        .iter()
        .flat_map(|p| [p.sigma_translation.unwrap_or(0.0), p.sigma_rotation_deg.unwrap_or(0.0)]);
    if !sigmas.chain(pose_sigmas).chain([model.smoothness_weight]).all(f64::is_finite) {
        return Err(Error::input("expected finite σ and weights in the model, found another value"));
    }
    let metadata = Metadata {
        unit: model.unit.name().to_owned(),
        shape: space.shape().name().to_owned(),
        base: space.base(),
        observations: model.observations,
        smoothness_weight: model.smoothness_weight,
        sensors: model.sensors.clone(),
        poses: model
            .poses
            .iter()
            .map(|pose| PoseNotes {
                scan: pose.scan.clone(),
                sigma_translation: pose.sigma_translation,
                sigma_rotation_deg: pose.sigma_rotation_deg,
                covariance: pose.covariance,
                undetermined: pose.undetermined.clone(),
                moved: pose.moved,
                turned_deg: pose.turned_deg,
                bias: pose.bias,
                sigma_bias: pose.sigma_bias,
            })
            .collect(),
        provenance: provenance.to_vec(),
        measured_coordinates: model.known.measured_coordinates(),
        moves_freely: matches!(model.known, Knowledge::Free { .. }),
        patch_filter: model.known.filter().map(Arc::as_ref).map(patches::Notes::from_filter),
    };
    let metadata = serde_json::to_value(metadata)
        .map_err(|e| Error::input("expected JSON in the metadata").with_source(e))?;
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
    Ok(ModelFile { tensors, metadata })
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

/// The tensors of a file, taken out with checks of type and shape.
struct Tensors(BTreeMap<String, Tensor>);

impl Tensors {
    /// The tensor of that name and number of axes, the trailing ones of the given lengths.
    fn take(&mut self, name: &str, trailing: &[usize]) -> Result<(usize, TensorData)> {
        let Tensor { shape, data } = self
            .0
            // Taken out instead of borrowed, so that large tensors are not held twice.
            .remove(name)
            .ok_or_else(|| Error::input(format!("expected the tensor `{name}`, found none")))?;
        match shape.split_first() {
            Some((&rows, rest)) if rest == trailing => Ok((rows, data)),
            _ => {
                let rest: String = trailing.iter().map(|n| format!(", {n}")).collect();
                Err(Error::input(format!("tensor `{name}`: expected the shape [n{rest}], found {shape:?}")))
            }
        }
    }

    /// The unresolved shape of each leaf; `order` maps cells of the file to leaves. Empty if the file has
    /// none.
    fn excess_variance(&mut self, order: &[usize]) -> Result<Vec<f64>> {
        if !self.0.contains_key(UNRESOLVED_SHAPE) {
            return Ok(Vec::new());
        }
        let of_cells = self.f64(UNRESOLVED_SHAPE, &[])?;
        if of_cells.len() != order.len() || of_cells.iter().any(|&square| square < 0.0) {
            return Err(Error::input(format!(
                "tensor `{UNRESOLVED_SHAPE}`: expected a mean square ≥ 0 for each of {} cells",
                order.len()
            )));
        }
        let mut left = vec![0.0; order.len()];
        for (&leaf, square) in order.iter().zip(of_cells) {
            left[leaf] = square;
        }
        Ok(left)
    }

    fn f64(&mut self, name: &str, trailing: &[usize]) -> Result<Vec<f64>> {
        match self.take(name, trailing)?.1 {
            // One NaN would spread through the factor to every σ.
            TensorData::F64(values) => match values.iter().position(|v| !v.is_finite()) {
                Some(at) => {
                    Err(Error::input(format!("tensor `{name}`: number {at} is not finite: {}", values[at])))
                }
                None => Ok(values),
            },
            _ => Err(Error::input(format!("tensor `{name}`: expected numbers of the type F64"))),
        }
    }

    fn u32(&mut self, name: &str, trailing: &[usize]) -> Result<Vec<u32>> {
        match self.take(name, trailing)?.1 {
            TensorData::U32(values) => Ok(values),
            _ => Err(Error::input(format!("tensor `{name}`: expected numbers of the type U32"))),
        }
    }

    fn u8(&mut self, name: &str) -> Result<Vec<u8>> {
        match self.take(name, &[])?.1 {
            TensorData::U8(values) => Ok(values),
            _ => Err(Error::input(format!("tensor `{name}`: expected numbers of the type U8"))),
        }
    }

    /// Information about poses and biases of scans, if the file has any.
    fn shared(&mut self, nodes: usize) -> Result<Option<ScanErrorInformation>> {
        if !self.0.contains_key(SHARED_CORNER) && !self.0.contains_key(SHARED_COUPLING) {
            return Ok(None);
        }
        let width = (self.0.get(SHARED_CORNER)).map_or(0, |t| t.shape.first().copied().unwrap_or(0));
        let corner = self.f64(SHARED_CORNER, &[width])?;
        let coupling = self.f64(SHARED_COUPLING, &[width])?;
        if coupling.len() != nodes * width {
            return Err(Error::input(format!(
                "tensor `{SHARED_COUPLING}`: expected {nodes} rows, found {}",
                coupling.len() / width.max(1)
            )));
        }
        Ok(Some(ScanErrorInformation { coupling, corner }))
    }

    fn information(&mut self, name: &str, pattern: &Arc<BlockPattern>) -> Result<BlockInformation> {
        let part = |part: &str| format!("{name}_{part}");
        let found = (self.u32(&part("offsets"), &[])?, self.u32(&part("indices"), &[])?);
        if found != flat_pattern(pattern) {
            return Err(Error::input(format!(
                "`{name}`: expected the couplings of the cells, found others: the file was changed or is \
                 damaged"
            )));
        }
        let mut information = BlockInformation::zeros(Arc::clone(pattern), 3, 1)?;
        fill(&part("values"), information.values_mut(), &self.f64(&part("values"), &[3, 3])?)?;
        fill(&part("vector"), information.vector_mut(), &self.f64(&part("vector"), &[3])?)?;
        Ok(information)
    }
}

fn fill(name: &str, to: &mut [f64], from: &[f64]) -> Result<()> {
    if to.len() != from.len() {
        return Err(Error::input(format!(
            "tensor `{name}`: expected {} numbers, found {}",
            to.len(),
            from.len()
        )));
    }
    to.copy_from_slice(from);
    Ok(())
}

fn from_file(file: ModelFile) -> Result<SavedModel> {
    let metadata: Metadata = serde_json::from_value(file.metadata)
        .map_err(|e| Error::input("the metadata lacks a key or has another form").with_source(e))?;
    let unit: Unit = metadata.unit.parse()?;
    let shape = Shape::from_name(&metadata.shape).ok_or_else(|| {
        Error::input(format!("shape: expected sheet, tube, ball or torus, found `{}`", metadata.shape))
    })?;
    if !(metadata.smoothness_weight.is_finite() && metadata.smoothness_weight >= 0.0) {
        return Err(Error::input(format!(
            "expected smoothness_weight ≥ 0, found {}",
            metadata.smoothness_weight
        )));
    }
    let mut tensors = Tensors(file.tensors);
    for (name, cells) in [("knots_u", metadata.base[0]), ("knots_v", metadata.base[1])] {
        let knots = tensors.f64(name, &[])?;
        // A damaged file may state any number of cells.
        if knots.len() != cells.saturating_add(1)
            || knots.iter().enumerate().any(|(k, &knot)| knot != k as f64)
        {
            return Err(Error::input(format!("tensor `{name}`: expected the knots 0, 1, …, {cells}")));
        }
    }
    // Another program may write the cells in any order; columns by cell are sorted with `order`.
    let (space, order) = hierarchy(shape, metadata.base, &tensors.u32("cells", &[3])?)?;
    let marks = tensors.u8("observed")?;
    if marks.len() != order.len() || marks.iter().any(|&m| Observed::from_mark(m).is_none()) {
        return Err(Error::input(format!(
            "tensor `observed`: expected 0, 1 or 2 for each of {} cells",
            order.len()
        )));
    }
    let mut observed = vec![Observed::default(); order.len()];
    for (&leaf, &mark) in order.iter().zip(&marks) {
        observed[leaf] = Observed::from_mark(mark).unwrap_or_default();
    }
    let excess_variance = tensors.excess_variance(&order)?;
    let vertices = tensors.f64("vertices", &[3])?;
    let surface = Surface::new(Arc::clone(&space), from_arrays(vertices.as_chunks::<3>().0).to_vec())?;
    // The pattern follows from the hierarchy; the file repeats it so that other readers need no B-splines.
    let elements = (0..space.leaves().len()).map(|leaf| space.extraction(leaf).0);
    let pattern = Arc::new(BlockPattern::from_elements(space.node_count(), elements)?);
    let numbers = tensors.f64("poses", &[7])?;
    if numbers.len() != 7 * metadata.poses.len() {
        return Err(Error::input(format!(
            "tensor `poses`: expected the {} poses that the metadata names, found {}",
            metadata.poses.len(),
            numbers.len() / 7
        )));
    }
    let poses =
        metadata.poses.into_iter().zip(numbers.as_chunks::<7>().0).map(|(notes, &[x, y, z, a, b, c, w])| {
            ScanPoseReport {
                scan: notes.scan,
                translation: [x, y, z],
                quaternion_xyzw: [a, b, c, w],
                sigma_translation: notes.sigma_translation,
                sigma_rotation_deg: notes.sigma_rotation_deg,
                covariance: notes.covariance,
                undetermined: notes.undetermined,
                moved: notes.moved,
                turned_deg: notes.turned_deg,
                bias: notes.bias,
                sigma_bias: notes.sigma_bias,
            }
        });
    let known = match metadata.patch_filter {
        None => {
            let data = tensors.information("information_data", &pattern)?;
            let prior = tensors.information("information_prior", &pattern)?;
            let information = VertexInformation { prior, data };
            let scan_errors = tensors.shared(space.node_count())?;
            match metadata.measured_coordinates {
                Some(measured) => Knowledge::PerCoordinate { information, measured },
                None if metadata.moves_freely => Knowledge::Free { information },
                None => Knowledge::AlongNormals { information, scan_errors },
            }
        }
        Some(notes) => {
            let filter = notes.filter(shape, metadata.base, &mut tensors)?;
            if filter.space().leaves() != space.leaves() {
                return Err(Error::input("expected patches of cells of the model, found others"));
            }
            Knowledge::Patches(Arc::new(filter))
        }
    };
    let model = SurfaceModel {
        unit,
        known,
        surface,
        observed,
        sensors: metadata.sensors,
        poses: poses.collect(),
        excess_variance,
        smoothness_weight: metadata.smoothness_weight,
        observations: metadata.observations,
    };
    Ok(SavedModel { model, provenance: metadata.provenance })
}

/// The hierarchy of the cells, and for each cell in the file's order its leaf.
fn hierarchy(shape: Shape, base: [usize; 2], numbers: &[u32]) -> Result<(Arc<Hierarchy>, Vec<usize>)> {
    let mut cells = Vec::with_capacity(numbers.len() / 3);
    for &[level, i, j] in numbers.as_chunks::<3>().0 {
        let level = u8::try_from(level).ok().filter(|&l| usize::from(l) <= MAX_LEVEL).ok_or_else(|| {
            Error::input(format!("tensor `cells`: expected levels up to {MAX_LEVEL}, found {level}"))
        })?;
        cells.push(Cell { level, i, j });
    }
    // Every cell of the base grid is a leaf or divided into leaves. More cells than leaves mean a damaged
    // file, and would cost memory.
    let base_cells = (base[0] as u64).saturating_mul(base[1] as u64);
    let finest = cells.iter().map(|c| c.level).max().unwrap_or(0);
    if base_cells > cells.len() as u64 || base_cells << (2 * finest) > MAX_CELLS_OF_A_LEVEL {
        return Err(Error::input(format!(
            "expected a base grid that fits the leaves, found {} × {} cells for {} leaves down to level \
             {finest}",
            base[0],
            base[1],
            cells.len()
        )));
    }
    let space = Hierarchy::from_leaves(shape, base, &cells)?;
    let order = cells
        .iter()
        .map(|&cell| {
            space
                .leaf_over(cell)
                .ok_or_else(|| Error::input(format!("expected a leaf, found the cell {cell:?}")))
        })
        .collect::<Result<_>>()?;
    Ok((Arc::new(space), order))
}

#[cfg(test)]
mod tests;
