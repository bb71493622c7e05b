//! A model from the tensors and metadata of a file, with every check that one value, tensor or pair of them
//! allows.
//!
//! In: a [`ModelFile`] whose checksums were verified, if it has any. Out: a [`SavedModel`]. Errors name the
//! tensor or metadata field, and the index of the first value that is out of range.

use super::consistency::MeanResidual;
use super::ranges::{check_information, check_metadata, check_pose, check_rows, check_semidefinite};
use super::{
    CORNERS, CREASES, DEPARTURE, DEPARTURE_OF_LEAVES, Metadata, PREDICTIVE_ERRORS, PREDICTIVE_LIMITS, QUADS,
    SHARED_CORNER, SHARED_COUPLING, SUPPORT_DEPTH, SUPPORT_DISTANCE, SUPPORT_MARKS, SavedModel,
    UNRESOLVED_SHAPE, flat_pattern,
};
use crate::model::{
    Departure, Knowledge, MAX_SUPPORT_DEPTH, Observed, PredictionError, PredictiveSigma,
    ScanErrorInformation, ScanPoseReport, Support, SupportCell, SurfaceModel, VertexInformation,
};
use planish_core::vector3::from_arrays;
use planish_core::{Finding, FindingCode};
use planish_estimate::sparse::{BlockInformation, BlockPattern};
use planish_estimate::{Error, Result};
use planish_exchange::Unit;
use planish_exchange::model::{ModelFile, Tensor, TensorData};
use planish_spline::{Cell, Hierarchy, MAX_LEVEL, QuadDomain, Shape, Surface};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Largest number of cells of the finest grid. A hierarchy keeps a mark for each, so more would take
/// gigabytes.
const MAX_CELLS_OF_A_LEVEL: u64 = 1 << 27;

/// The tensors of a file, taken out with checks of type and shape.
pub(super) struct Tensors(BTreeMap<String, Tensor>);

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
        expect_rows(UNRESOLVED_SHAPE, of_cells.len(), order.len(), "cells")?;
        check_rows(UNRESOLVED_SHAPE, &of_cells, 1, "a mean square ≥ 0", |square| square[0] >= 0.0)?;
        let mut left = vec![0.0; order.len()];
        for (&leaf, square) in order.iter().zip(of_cells) {
            left[leaf] = square;
        }
        Ok(left)
    }

    /// How each place is known; `order` maps cells of the file to leaves. Empty if the file knows it by leaf.
    fn support(&mut self, order: &[usize]) -> Result<Support> {
        if !self.0.contains_key(SUPPORT_DEPTH) {
            return Ok(Support::default());
        }
        let depths = self.u8(SUPPORT_DEPTH)?;
        expect_rows(SUPPORT_DEPTH, depths.len(), order.len(), "cells")?;
        check_rows(SUPPORT_DEPTH, &depths, 1, "0 to 5 divisions", |d| d[0] <= MAX_SUPPORT_DEPTH)?;
        let marks = self.u8(SUPPORT_MARKS)?;
        let distances = self.f64(SUPPORT_DISTANCE, &[])?;
        let total = depths.iter().map(|depth| 1_usize << (2 * depth)).sum();
        expect_rows(SUPPORT_MARKS, marks.len(), total, "parts of cells")?;
        expect_rows(SUPPORT_DISTANCE, distances.len(), total, "parts of cells")?;
        check_rows(SUPPORT_MARKS, &marks, 1, "0, 1, 2 or 3", |mark| Observed::from_mark(mark[0]).is_some())?;
        check_rows(SUPPORT_DISTANCE, &distances, 1, "a distance ≥ 0", |distance| distance[0] >= 0.0)?;
        let mut leaves = vec![(0, Vec::new()); order.len()];
        let mut parts = marks.iter().zip(&distances);
        for (&leaf, &depth) in order.iter().zip(&depths) {
            let own = parts.by_ref().take(1 << (2 * depth)).map(|(&mark, &distance)| SupportCell {
                observed: Observed::from_mark(mark).unwrap_or_default(),
                distance,
            });
            leaves[leaf] = (depth, own.collect());
        }
        Support::new(leaves)
    }

    /// Errors where nothing was measured, if the file has any; `order` maps cells of the file to leaves.
    fn predictive(&mut self, order: &[usize]) -> Result<Option<PredictiveSigma>> {
        if !self.0.contains_key(PREDICTIVE_ERRORS) {
            return Ok(None);
        }
        let errors = self.f64(PREDICTIVE_ERRORS, &[3])?;
        let limits = self.f64(PREDICTIVE_LIMITS, &[])?;
        expect_rows(PREDICTIVE_LIMITS, limits.len(), 2, "limits")?;
        let errors = (errors.as_chunks::<3>().0.iter())
            .map(|&[distance, factor, floor]| PredictionError { distance, factor, floor })
            .collect();
        let found = PredictiveSigma::new(errors, limits[0], limits[1])
            .map_err(|e| e.in_context(format_args!("tensor `{PREDICTIVE_ERRORS}`")))?;
        Ok(Some(match self.departure(order)? {
            Some(departure) => found.with_departure(departure),
            None => found,
        }))
    }

    /// How far closed surfaces may depart where nothing was measured, if the file has it.
    fn departure(&mut self, order: &[usize]) -> Result<Option<Departure>> {
        if !self.0.contains_key(DEPARTURE) {
            return Ok(None);
        }
        let by_distance = self.f64(DEPARTURE, &[2])?.as_chunks::<2>().0.to_vec();
        let of_cells = self.f64(DEPARTURE_OF_LEAVES, &[])?;
        expect_rows(DEPARTURE_OF_LEAVES, of_cells.len(), order.len(), "cells")?;
        let mut of_leaf = vec![0.0; order.len()];
        for (&leaf, share) in order.iter().zip(of_cells) {
            of_leaf[leaf] = share;
        }
        let found = Departure::new(by_distance, of_leaf);
        found.map(Some).map_err(|e| e.in_context(format_args!("tensor `{DEPARTURE}`")))
    }

    pub(super) fn f64(&mut self, name: &str, trailing: &[usize]) -> Result<Vec<f64>> {
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

    pub(super) fn u32(&mut self, name: &str, trailing: &[usize]) -> Result<Vec<u32>> {
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

    /// Vertices of creases, two for each, and marked corners; empty if the file has none.
    fn creases(&mut self) -> Result<(Vec<u32>, Vec<u32>)> {
        if !self.0.contains_key(CREASES) {
            return Ok((Vec::new(), Vec::new()));
        }
        Ok((self.u32(CREASES, &[2])?, self.u32(CORNERS, &[])?))
    }

    /// Information about poses and biases of scans, if the file has any.
    fn shared(&mut self, displacements: usize) -> Result<Option<ScanErrorInformation>> {
        if !self.0.contains_key(SHARED_CORNER) && !self.0.contains_key(SHARED_COUPLING) {
            return Ok(None);
        }
        let width = (self.0.get(SHARED_CORNER)).map_or(0, |t| t.shape.first().copied().unwrap_or(0));
        let corner = self.f64(SHARED_CORNER, &[width])?;
        let coupling = self.f64(SHARED_COUPLING, &[width])?;
        expect_rows(SHARED_CORNER, corner.len() / width.max(1), width, "unknowns of scans")?;
        expect_rows(
            SHARED_COUPLING,
            coupling.len() / width.max(1),
            displacements,
            "displacements of vertices",
        )?;
        check_semidefinite(format_args!("tensor `{SHARED_CORNER}`"), &corner, width)?;
        Ok(Some(ScanErrorInformation { coupling, corner }))
    }

    /// The information of that name; `proper` if every vertex must have some.
    fn information(
        &mut self,
        name: &str,
        pattern: &Arc<BlockPattern>,
        proper: bool,
    ) -> Result<BlockInformation> {
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
        check_information(name, &information, proper)?;
        Ok(information)
    }
}

/// Requires a tensor to have `expected` rows, one for each of the `items`.
fn expect_rows(name: &str, found: usize, expected: usize, items: &str) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::input(format!(
        "tensor `{name}`: expected a row for each of {expected} {items}, found {found} rows"
    )))
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

/// The model of a file.
///
/// # Errors
/// `Input` if a part is missing, out of range, or does not agree with another.
pub(super) fn from_file(file: ModelFile) -> Result<SavedModel> {
    let findings = missing_checksums(&file);
    let metadata: Metadata = serde_json::from_value(file.metadata)
        .map_err(|e| Error::input("the metadata lacks something or has another form").with_source(e))?;
    let unit: Unit = metadata.unit.parse()?;
    check_metadata(&metadata)?;
    let mut tensors = Tensors(file.tensors);
    let unrefined = unrefined(&metadata, &mut tensors)?;
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
    let (space, order) = hierarchy(&unrefined, &tensors.u32("cells", &[3])?)?;
    let marks = tensors.u8("observed")?;
    expect_rows("observed", marks.len(), order.len(), "cells")?;
    check_rows("observed", &marks, 1, "0, 1, 2 or 3", |mark| Observed::from_mark(mark[0]).is_some())?;
    let mut observed = vec![Observed::default(); order.len()];
    for (&leaf, &mark) in order.iter().zip(&marks) {
        observed[leaf] = Observed::from_mark(mark).unwrap_or_default();
    }
    let support = tensors.support(&order)?;
    let predictive = tensors.predictive(&order)?;
    let excess_variance = tensors.excess_variance(&order)?;
    let vertices = tensors.f64("vertices", &[3])?;
    let surface = Surface::new(Arc::clone(&space), from_arrays(vertices.as_chunks::<3>().0).to_vec())?;
    // The pattern follows from the hierarchy; the file repeats it so that other readers need no B-splines.
    let elements = (0..space.leaves().len()).map(|leaf| space.extraction(leaf).0);
    let pattern = Arc::new(BlockPattern::from_elements(space.node_count(), elements)?);
    let numbers = tensors.f64("poses", &[7])?;
    expect_rows("poses", numbers.len() / 7, metadata.poses.len(), "poses that the metadata names")?;
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
    let poses: Vec<ScanPoseReport> = poses.collect();
    poses.iter().enumerate().try_for_each(|(k, pose)| check_pose(k, pose))?;
    let known = match metadata.patch_filter {
        None => {
            let data = tensors.information("information_data", &pattern, false)?;
            let prior =
                tensors.information("information_prior", &pattern, metadata.smoothness_weight > 0.0)?;
            let information = VertexInformation { prior, data };
            let scan_errors = tensors.shared(space.unknown_count())?;
            match metadata.measured_coordinates {
                Some(measured) => Knowledge::PerCoordinate { information, measured },
                None if metadata.moves_freely => Knowledge::Free { information },
                None => Knowledge::AlongNormals { information, scan_errors },
            }
        }
        Some(notes) => {
            let shape = space.shape().ok_or_else(|| Error::input("expected patches over a grid"))?;
            let filter = notes.filter(shape, metadata.base, &mut tensors)?;
            if filter.space().leaves() != space.leaves() {
                return Err(Error::input("expected patches of cells of the model, found others"));
            }
            Knowledge::Patches(Arc::new(filter))
        }
    };
    let model = SurfaceModel {
        unit,
        unit_assumed: metadata.unit_assumed,
        known,
        surface,
        observed,
        support,
        predictive,
        sensors: metadata.sensors,
        poses,
        excess_variance,
        smoothness_weight: metadata.smoothness_weight,
        observations: metadata.observations,
    };
    MeanResidual::of_model(&model)?.check(metadata.mean_residual, &model)?;
    Ok(SavedModel { model, provenance: metadata.provenance, findings })
}

/// A finding for a file of an older version, in which damage may stay undetected.
fn missing_checksums(file: &ModelFile) -> Vec<Finding> {
    let finding = || {
        Finding::new(
            FindingCode::ModelWithoutChecksums,
            "the model was saved by an older version without checksums, so damage may stay undetected",
        )
    };
    (!file.has_checksums()).then(finding).into_iter().collect()
}

/// What the cells of a hierarchy divide.
enum Unrefined {
    Grid(Shape, [usize; 2]),
    Quads(Arc<QuadDomain>),
}

impl Unrefined {
    fn base(&self) -> [usize; 2] {
        match self {
            Self::Grid(_, base) => *base,
            Self::Quads(domain) => [domain.cells().len(), 1],
        }
    }
}

fn unrefined(metadata: &Metadata, tensors: &mut Tensors) -> Result<Unrefined> {
    if let Some(shape) = Shape::from_name(&metadata.shape) {
        return Ok(Unrefined::Grid(shape, metadata.base));
    }
    if metadata.shape != "quads" {
        return Err(Error::input(format!(
            "shape: expected sheet, tube, ball, torus or quads, found `{}`",
            metadata.shape
        )));
    }
    let quads = tensors.u32(QUADS, &[4])?;
    let (creases, corners) = tensors.creases()?;
    let domain = QuadDomain::with_creases(quads.as_chunks::<4>().0, creases.as_chunks().0, &corners)?;
    if metadata.base != [domain.cells().len(), 1] {
        return Err(Error::input(format!(
            "expected one row of {} base cells, one for each quad, found {} × {}",
            domain.cells().len(),
            metadata.base[0],
            metadata.base[1]
        )));
    }
    Ok(Unrefined::Quads(Arc::new(domain)))
}

/// The hierarchy of the cells, and for each cell in the file's order its leaf.
fn hierarchy(unrefined: &Unrefined, numbers: &[u32]) -> Result<(Arc<Hierarchy>, Vec<usize>)> {
    let base = unrefined.base();
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
    let space = match unrefined {
        Unrefined::Grid(shape, base) => Hierarchy::from_leaves(*shape, *base, &cells)?,
        Unrefined::Quads(domain) => Hierarchy::over_leaves(Arc::clone(domain), &cells)?,
    };
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
