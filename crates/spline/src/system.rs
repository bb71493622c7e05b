//! Sparse equations of the control vertices: pattern, ordering and symbolic factor of a hierarchy.
//!
//! Input: a [`Hierarchy`]. Output: information accumulated by leaf, the smoothness prior as information, and
//! factors. Each node has three unknowns, the coordinates of its vertex, or one along a direction; vertices
//! on creases have more than one direction (see [`Surface::directions`]). Built once per hierarchy and used
//! for every iteration.

use crate::cell_information::{CellInformation, add_to_triangle, scalar_element};
use crate::energy::{LeafEnergy, quadrature};
use crate::hierarchy::Hierarchy;
use crate::surface::{Surface, leaf_weights};
use planish_core::DVec3;
use planish_estimate::sparse::{
    BlockInformation, BlockPattern, CholeskyFactor, ElementScatter, NodeOrdering, SymbolicFactor,
};
use planish_estimate::{Error, Result};
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// Number of leaves whose elements are computed in parallel before they are added in order to the global
/// matrix. Trades memory against parallel work.
const BATCH: usize = 256;
/// Columns of a matrix that a thread restricts at a time.
const COLUMNS: usize = 512;

/// Sparse equations over the nodes of a hierarchy.
#[derive(Debug, Clone)]
pub struct SurfaceSystem {
    space: Arc<Hierarchy>,
    pattern: Arc<BlockPattern>,
    ordering: NodeOrdering,
    /// For three unknowns per node; built on first use, because not every use needs it.
    symbolic: OnceLock<Arc<SymbolicFactor>>,
    symbolic_scalar: Arc<SymbolicFactor>,
    scatters: Vec<ElementScatter>,
    /// The equations of displacements along directions, where there are more of them than nodes.
    displacements: Option<Displacements>,
}

/// Pattern, scatters and symbolic factor of the displacements of vertices of which some are on creases.
#[derive(Debug, Clone)]
struct Displacements {
    pattern: Arc<BlockPattern>,
    symbolic: Arc<SymbolicFactor>,
    scatters: Vec<ElementScatter>,
}

impl Displacements {
    /// None if each node has one.
    fn new(space: &Hierarchy) -> Result<Option<Self>> {
        let count = space.unknown_count();
        if count == space.node_count() {
            return Ok(None);
        }
        let of_leaves: Vec<Vec<u32>> = (0..space.leaves().len())
            .map(|leaf| space.unknowns(leaf).map(|(unknown, _)| unknown).collect())
            .collect();
        let pattern = Arc::new(BlockPattern::from_elements(count, of_leaves.iter().map(Vec::as_slice))?);
        let symbolic = Arc::new(SymbolicFactor::analyse(&pattern, &NodeOrdering::amd(&pattern)?, 1)?);
        let scatters = (of_leaves.par_iter().with_min_len(64))
            .map(|unknowns| ElementScatter::new(&pattern, unknowns))
            .collect::<Result<_>>()?;
        Ok(Some(Self { pattern, symbolic, scatters }))
    }
}

impl SurfaceSystem {
    /// Computes pattern, nested-dissection ordering and symbolic factor of a hierarchy.
    ///
    /// # Errors
    /// `Input` when the hierarchy is too large for the sparse matrices.
    pub fn new(space: &Arc<Hierarchy>) -> Result<Self> {
        let leaves = space.leaves().len();
        let pattern = Arc::new(BlockPattern::from_elements(
            space.node_count(),
            (0..leaves).map(|leaf| space.extraction(leaf).0),
        )?);
        // Over quads, parameters do not show which nodes are near.
        let ordering = match space.domain() {
            None => NodeOrdering::nested_dissection(&pattern, space.node_anchors())?,
            Some(_) => NodeOrdering::amd(&pattern)?,
        };
        let symbolic_scalar = Arc::new(SymbolicFactor::analyse(&pattern, &ordering, 1)?);
        let scatters = (0..leaves)
            .into_par_iter()
            .with_min_len(64)
            .map(|leaf| ElementScatter::new(&pattern, space.extraction(leaf).0))
            .collect::<Result<_>>()?;
        Ok(Self {
            space: Arc::clone(space),
            pattern,
            ordering,
            symbolic: OnceLock::new(),
            symbolic_scalar,
            scatters,
            displacements: Displacements::new(space)?,
        })
    }

    /// The hierarchy.
    #[must_use]
    pub fn space(&self) -> &Arc<Hierarchy> {
        &self.space
    }

    /// The pattern of coupled nodes.
    #[must_use]
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    /// Zero information with three coupled coordinates per node.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn zero_information(&self) -> Result<BlockInformation> {
        BlockInformation::zeros(Arc::clone(&self.pattern), 3, 1)
    }

    /// Accumulates information by leaf: `fill(leaf, cell)` adds the readings of that leaf and returns true if
    /// there are any.
    ///
    /// Leaves are filled in parallel and added in order, which gives the same bytes for any number of
    /// threads.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn accumulate(
        &self,
        fill: impl Fn(usize, &mut CellInformation) -> bool + Sync,
    ) -> Result<BlockInformation> {
        let mut information = self.zero_information()?;
        self.add_elements(&mut information, &self.scatters, CellInformation::default, |cell, leaf| {
            cell.clear();
            fill(leaf, cell).then(|| {
                let (mut matrix, mut vector) = (Vec::new(), Vec::new());
                cell.element(&self.space, leaf, &mut matrix, &mut vector);
                (matrix, vector)
            })
        })?;
        Ok(information)
    }

    /// Accumulates scalar rows for displacements along `directions`: one for each node, or those of
    /// [`Surface::directions`]. `rows(leaf, add)` calls `add(weights over the sixteen coefficients,
    /// direction, value, information)` for each measurement.
    ///
    /// Cheaper than [`Self::accumulate`] for few readings per leaf: about `n (4 + n/2)` multiply-adds per
    /// reading for `n` nodes on its leaf.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    ///
    /// # Examples
    /// ```
    /// use planish_core::DVec3;
    /// use planish_spline::{Hierarchy, Shape, SurfaceSystem, leaf_weights};
    /// use std::sync::Arc;
    ///
    /// let space = Arc::new(Hierarchy::uniform(Shape::Sheet, [4, 4])?);
    /// let system = SurfaceSystem::new(&space)?;
    /// let up = DVec3::Z;
    /// let information = system.accumulate_along(&vec![up; space.node_count()], |leaf, add| {
    ///     if leaf == 5 {
    ///         add(&leaf_weights(0.5, 0.5), up, 0.2, 100.0); // z = 0.2 with σ = 0.1
    ///     }
    /// })?;
    /// assert!((information.quadratic_form(&vec![1.0; space.node_count()])? - 100.0).abs() < 1e-9);
    /// # Ok::<(), planish_spline::Error>(())
    /// ```
    pub fn accumulate_along(
        &self,
        directions: &[DVec3],
        rows: impl Fn(usize, &mut dyn FnMut(&[f64; 16], DVec3, f64, f64)) + Sync,
    ) -> Result<BlockInformation> {
        let (pattern, scatters) = self.along(directions.len());
        let mut information = BlockInformation::zeros(Arc::clone(pattern), 1, 1)?;
        let nodes = self.space.node_count();
        // Directions of nodes alone leave out the further unknowns on creases.
        let with_further = directions.len() > nodes;
        self.add_elements(
            &mut information,
            scatters,
            || (),
            |(), leaf| {
                let unknowns = || {
                    let all = self.space.unknowns(leaf);
                    all.filter(|&(unknown, _)| with_further || (unknown as usize) < nodes)
                };
                let n = unknowns().count();
                // Skip zero weights: a node affects only a few of the sixteen coefficients.
                let sparse: Vec<(usize, usize, f64)> = unknowns()
                    .enumerate()
                    .flat_map(|(a, (_, w))| w.iter().enumerate().map(move |(k, w)| (a, k, *w)))
                    .filter(|(_, _, w)| *w != 0.0)
                    .collect();
                // Leaves without readings allocate nothing and add nothing.
                let mut made: Option<(Vec<f64>, Vec<f64>)> = None;
                let mut row = vec![0.0; n];
                rows(leaf, &mut |c, direction, value, w| {
                    let (matrix, vector) = made.get_or_insert_with(|| (vec![0.0; n * n], vec![0.0; n]));
                    row.fill(0.0);
                    for &(a, k, weight) in &sparse {
                        row[a] += weight * c[k];
                    }
                    for (r, (unknown, _)) in row.iter_mut().zip(unknowns()) {
                        *r *= direction.dot(directions[unknown as usize]);
                    }
                    add_outer(matrix, vector, &row, value, w);
                });
                if let Some((matrix, _)) = &mut made {
                    for a in 0..n {
                        for b in 0..a {
                            matrix[b * n + a] = matrix[a * n + b];
                        }
                    }
                }
                made
            },
        )?;
        Ok(information)
    }

    /// Pattern and scatters of displacements along this number of directions.
    fn along(&self, directions: usize) -> (&Arc<BlockPattern>, &[ElementScatter]) {
        match &self.displacements {
            Some(own) if directions > self.space.node_count() => (&own.pattern, &own.scatters),
            _ => (&self.pattern, &self.scatters),
        }
    }

    /// Adds a matrix and a vector over the unknowns of each leaf, computed in parallel by batches and added
    /// in order, while the next batch is computed. `scratch` creates the buffers that a thread reuses.
    fn add_elements<S>(
        &self,
        information: &mut BlockInformation,
        scatters: &[ElementScatter],
        scratch: impl Fn() -> S + Sync,
        element: impl Fn(&mut S, usize) -> Option<(Vec<f64>, Vec<f64>)> + Sync,
    ) -> Result<()> {
        let elements = |first: usize| -> Vec<Option<(Vec<f64>, Vec<f64>)>> {
            (first..scatters.len().min(first + BATCH))
                .into_par_iter()
                .with_min_len(16)
                .map_init(&scratch, &element)
                .collect()
        };
        let mut ready = elements(0);
        for (number, scatters) in scatters.chunks(BATCH).enumerate() {
            // Additions of floating-point numbers are not associative, so the elements are added serially in
            // their order.
            let add = || {
                scatters.iter().zip(&ready).try_for_each(|(scatter, element)| match element {
                    Some((matrix, vector)) => information.add_scattered(scatter, matrix, vector),
                    None => Ok(()),
                })
            };
            let (next, added) = rayon::join(|| elements((number + 1) * BATCH), add);
            added?;
            ready = next;
        }
        Ok(())
    }

    /// Restricts information to displacements along `directions`: `d_aᵀ Λ_ij d_b` and `d_aᵀ η_i` for unknowns
    /// `a` of node `i` and `b` of node `j`. Directions are one for each node, or those of
    /// [`Surface::directions`].
    ///
    /// # Errors
    /// `Input` when the information has another pattern.
    pub fn contract(&self, information: &BlockInformation, directions: &[DVec3]) -> Result<BlockInformation> {
        // Information of another source may have a smaller pattern.
        let information = information.on_pattern(&self.pattern)?;
        let (pattern, _) = self.along(directions.len());
        let mut out = BlockInformation::zeros(Arc::clone(pattern), 1, 1)?;
        let values = information.values();
        let scalar = information.block_size() == 1;
        let entry = |to: usize, row: u32, column: usize| -> Result<f64> {
            let (a, b) = (directions[row as usize], directions[column]);
            let [of_row, of_column] = [row as usize, column].map(|k| self.space.node_of_unknown(k));
            // Both patterns are the same up to the first further unknown.
            let from = match Arc::ptr_eq(pattern, &self.pattern) {
                true => to,
                false => self
                    .pattern
                    .position(of_row as u32, of_column as u32)
                    .ok_or_else(|| Error::input(format!("nodes {of_row} and {of_column} share no leaf")))?,
            };
            if scalar {
                return Ok(values[from] * a.dot(b));
            }
            let block = &values[9 * from..9 * from + 9];
            // Blocks below the diagonal are stored.
            let (a, b) = if of_row < of_column { (b, a) } else { (a, b) };
            Ok((0..3)
                .map(|r| a[r] * DVec3::new(block[3 * r], block[3 * r + 1], block[3 * r + 2]).dot(b))
                .sum())
        };
        let parts: Vec<Vec<f64>> = (0..pattern.nodes().div_ceil(COLUMNS))
            .into_par_iter()
            .map(|part| {
                let columns = part * COLUMNS..pattern.nodes().min((part + 1) * COLUMNS);
                let of_column = |column: usize| pattern.column_range(column).zip(pattern.column(column));
                columns
                    .flat_map(|column| of_column(column).map(move |(to, &row)| (to, row, column)))
                    .map(|(to, row, column)| entry(to, row, column))
                    .collect()
            })
            .collect::<Result<_>>()?;
        for (to, value) in out.values_mut().iter_mut().zip(parts.iter().flatten()) {
            *to = *value;
        }
        for (unknown, (to, d)) in out.vector_mut().iter_mut().zip(directions).enumerate() {
            let eta = &information.vector()[3 * self.space.node_of_unknown(unknown)..][..3];
            *to = DVec3::new(eta[0], eta[1], eta[2]).dot(*d);
        }
        Ok(out)
    }

    /// The thin-plate energy in the metric of a reference surface, as the matrix `K` of one coordinate:
    /// `b = 1`.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn thin_plate(&self, reference: &Surface) -> Result<BlockInformation> {
        self.assemble_energy(&reference.thin_plate(&self.space))
    }

    /// [`Self::thin_plate`] of a uniform grid over an affine reference. All leaves have the same form, so
    /// only one is computed.
    ///
    /// # Errors
    /// `Input` when the grid is not uniform, or the matrix would be too large.
    pub fn thin_plate_over_plane(&self, reference: &Surface) -> Result<BlockInformation> {
        if self.space.levels() > 1 {
            return Err(Error::input("the hierarchy is not uniform: its leaves differ in size"));
        }
        // Over a plane all leaves of one size have the same form.
        let form = reference.leaf_thin_plate(0);
        self.assemble_forms(|_| form)
    }

    /// The matrix `K` of one coordinate from the energies of all leaves.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn assemble_energy(&self, leaves: &[LeafEnergy]) -> Result<BlockInformation> {
        self.assemble_forms(|leaf| leaves[leaf].thin_plate)
    }

    /// Information of one unknown per node with three right-hand sides, from that about the sixteen
    /// coefficients of the leaves.
    pub(crate) fn assemble_scalar(
        &self,
        form: impl Fn(usize) -> Option<([[f64; 16]; 16], [[f64; 3]; 16])> + Sync,
    ) -> Result<BlockInformation> {
        let mut information = BlockInformation::zeros(Arc::clone(&self.pattern), 1, 3)?;
        self.add_elements(
            &mut information,
            &self.scatters,
            || (),
            |(), leaf| {
                let (matrix, vector) = form(leaf)?;
                let (nodes, weights) = self.space.extraction(leaf);
                let mut of_nodes = vec![0.0; 3 * nodes.len()];
                for (to, weights) in of_nodes.chunks_exact_mut(3).zip(weights) {
                    for (w, from) in weights.iter().zip(&vector) {
                        for d in 0..3 {
                            to[d] += w * from[d];
                        }
                    }
                }
                Some((scalar_element(&self.space, leaf, &matrix), of_nodes))
            },
        )?;
        Ok(information)
    }

    /// The matrix of one coordinate from a symmetric form on the sixteen coefficients of every leaf.
    fn assemble_forms(&self, form: impl Fn(usize) -> [[f64; 16]; 16] + Sync) -> Result<BlockInformation> {
        let mut matrix = BlockInformation::zeros(Arc::clone(&self.pattern), 1, 3)?;
        self.add_elements(
            &mut matrix,
            &self.scatters,
            || (),
            |(), leaf| {
                let zeros = vec![0.0; 3 * self.space.extraction(leaf).0.len()];
                Some((scalar_element(&self.space, leaf, &form(leaf)), zeros))
            },
        )?;
        Ok(matrix)
    }

    /// A weak prior on tangential motion: information `1/σ²` per leaf about the two tangential coordinates,
    /// with σ a fraction `share` of the size of the leaf. The normal coordinate stays free.
    ///
    /// Positions do not determine how vertices slide along the surface, so without this prior they would
    /// drift. `reference` has the hierarchy of these equations.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn tangential_hold(&self, reference: &Surface, share: f64) -> Result<BlockInformation> {
        self.accumulate(|leaf, cell| {
            let side = self.space.leaves()[leaf].side();
            for q in quadrature() {
                let jet = reference.leaf_jet(leaf, q.local[0], q.local[1]);
                let Some(n) = jet.normal() else { continue };
                let [e, _, g] = jet.first_form();
                // The shorter side of the leaf, but at least a tenth of the longer one: slivers at poles
                // would be held too stiffly.
                let size2 = (e.min(g)).max(0.01 * e.max(g)) * side * side;
                let w = q.weight / (share * share * size2);
                let information = [
                    // `w (I − n nᵀ)`: only tangential motion is held, so the shape is free.
                    w * (1.0 - n[0] * n[0]),
                    -w * n[0] * n[1],
                    -w * n[0] * n[2],
                    w * (1.0 - n[1] * n[1]),
                    -w * n[1] * n[2],
                    w * (1.0 - n[2] * n[2]),
                ];
                cell.add_vector(&leaf_weights(q.local[0], q.local[1]), jet.point, &information);
            }
            true
        })
    }

    /// The mass matrix `∫ B_a B_b dA` in the metric of a reference surface, for one coordinate: `b = 1`,
    /// three right-hand sides.
    ///
    /// # Errors
    /// `Input` when the matrix would be too large.
    pub fn mass(&self, reference: &Surface) -> Result<BlockInformation> {
        self.assemble_forms(|leaf| {
            let side = self.space.leaves()[leaf].side();
            let mut form = [[0.0; 16]; 16];
            for q in quadrature() {
                let [u, v] = self.space.parameters(leaf, q.local);
                let w = q.weight * side * side * reference.jet(u, v).area_element();
                let c = leaf_weights(q.local[0], q.local[1]);
                for k in 0..16 {
                    for l in 0..16 {
                        form[k][l] += w * c[k] * c[l];
                    }
                }
            }
            form
        })
    }

    /// Factors a matrix of displacements along directions.
    ///
    /// # Errors
    /// `Undetermined` when it is not positive definite.
    pub fn factorize_scalar(&self, matrix: &BlockInformation) -> Result<CholeskyFactor> {
        let symbolic = match &self.displacements {
            Some(own) if matrix.dimension() > self.space.node_count() => &own.symbolic,
            _ => &self.symbolic_scalar,
        };
        CholeskyFactor::factorize(symbolic, matrix)
    }

    /// [`Self::factorize_scalar`] that reuses the memory of an earlier factor of this system.
    ///
    /// # Errors
    /// As for [`Self::factorize_scalar`].
    pub fn refactorize_scalar(
        &self,
        earlier: Option<CholeskyFactor>,
        matrix: &BlockInformation,
    ) -> Result<CholeskyFactor> {
        // Memory and symbolic analysis are reused.
        match earlier {
            Some(factor) => factor.refactorize(matrix),
            None => self.factorize_scalar(matrix),
        }
    }

    /// Factors information of this system.
    ///
    /// # Errors
    /// `Undetermined` when the information does not determine every vertex.
    pub fn factorize(&self, information: &BlockInformation) -> Result<CholeskyFactor> {
        let symbolic = match self.symbolic.get() {
            Some(symbolic) => symbolic,
            None => {
                // The analysis can fail, so it is done outside `get_or_init`. Two threads may both do it; the
                // results are equal.
                let made = Arc::new(SymbolicFactor::analyse(&self.pattern, &self.ordering, 3)?);
                self.symbolic.get_or_init(|| made)
            }
        };
        CholeskyFactor::factorize(symbolic, information)
    }

    /// The surface with the solved vertices.
    ///
    /// # Errors
    /// `Input` when a vertex is not finite.
    pub fn surface(&self, solution: &[f64]) -> Result<Surface> {
        let vertices = solution.chunks_exact(3).map(DVec3::from_slice).collect();
        Surface::new(Arc::clone(&self.space), vertices)
    }
}

/// Adds `w r rᵀ` to the lower triangle of a row-major matrix, and `w r value` to a vector.
fn add_outer(matrix: &mut [f64], vector: &mut [f64], row: &[f64], value: f64, w: f64) {
    let n = row.len();
    for (a, (line, v)) in matrix.chunks_exact_mut(n).zip(vector).enumerate() {
        let wa = w * row[a];
        *v += wa * value;
        // Values above the diagonal are overwritten when the triangle is mirrored.
        add_to_triangle(line, a, wa, row);
    }
}
