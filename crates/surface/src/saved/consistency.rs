//! Agreement of the surface with its information: `Λ x = η`.
//!
//! In: a model. Out: how far its vertices are from those that its information determines. A fit stops when
//! steps are small compared with σ, and its vertices move along normals only, so the residual of the equation
//! is small but not zero. A file therefore states the residual at saving, and reading computes it again.
//!
//! Cost: two products of the sparse matrix and a vector.
//!
//! Not guaranteed: that vertices are right along the surface, where they do not change the shape.

use crate::model::{Knowledge, SurfaceModel, VertexInformation};
use planish_core::DVec3;
use planish_core::vector3::coordinates;
use planish_estimate::{Error, Result};
use planish_spline::PatchFilter;

/// Relative difference of the residuals at saving and at reading that rounding explains.
///
/// The same program gives the same bits. Another processor or version may add in another order, which changes
/// the last digits of each term; [`MeanResidual::rounding`] is their sum.
const RELATIVE_TOLERANCE: f64 = 1e-6;

/// Largest residual of a vertex, in its own σ, if the file states none.
///
/// With directions along the surface, which are not compared here, nine fits of the examples and of simulated
/// scenes have 0.2 to 1.1; one that was stopped at 300 coefficients has 11. Three vertices of the pebble
/// example that were moved by 5 mm have 97 to 222.
const MAX_UNSTATED_RESIDUAL: f64 = 50.0;

/// How far a surface is from what its information determines.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeanResidual {
    /// Root mean square over the unknowns. Each is in its own σ given all others; with a patch filter, it is
    /// the distance from the filter's vertices in the model's unit.
    pub rms: f64,
    /// Part of `rms` that rounding can cause.
    rounding: f64,
    /// The vertex with the largest residual.
    vertex: usize,
    /// Its residual.
    largest: f64,
    /// Distance that removes its residual if all other vertices stay.
    distance: f64,
}

impl MeanResidual {
    /// The residual of a model.
    ///
    /// # Errors
    /// `Input` if parts of the model have different sizes.
    pub(super) fn of_model(model: &SurfaceModel) -> Result<Self> {
        match &model.known {
            Knowledge::AlongNormals { information, .. } => {
                let mut directions = vec![Vec::new(); model.surface.vertices().len()];
                for (unknown, direction) in model.surface.directions().into_iter().enumerate() {
                    directions[model.surface.space().node_of_unknown(unknown)].push(direction);
                }
                Self::of_information(model, information, |vertex| directions[vertex].clone())
            }
            Knowledge::PerCoordinate { information, measured } => {
                let axes = DVec3::AXES.into_iter().zip(measured).filter(|(_, measured)| **measured);
                let axes: Vec<DVec3> = axes.map(|(axis, _)| axis).collect();
                Self::of_information(model, information, |_| axes.clone())
            }
            Knowledge::Free { information } => {
                Self::of_information(model, information, |_| DVec3::AXES.to_vec())
            }
            Knowledge::Patches(filter) => Self::of_filter(model, filter),
        }
    }

    /// Residual of the equations along the given directions of each vertex.
    fn of_information(
        model: &SurfaceModel,
        VertexInformation { prior, data }: &VertexInformation,
        directions: impl Fn(usize) -> Vec<DVec3>,
    ) -> Result<Self> {
        let x = coordinates(model.surface.vertices());
        let mut residual: Vec<f64> = vec![0.0; x.len()];
        let mut product = residual.clone();
        for information in [prior, data] {
            product.fill(0.0);
            information.multiply(x, &mut product)?;
            for ((r, eta), p) in residual.iter_mut().zip(information.vector()).zip(&product) {
                *r += eta - p;
            }
        }
        // Rounding of a row is at most that of its largest term times the number of terms.
        let extent = x.iter().fold(0.0_f64, |largest, x| largest.max(x.abs()));
        let rows = row_sums(model.surface.vertices().len(), [prior, data]);
        let diagonals = [prior, data].map(diagonal_blocks);
        let mut sums = Sums::default();
        for (vertex, r) in residual.as_chunks::<3>().0.iter().enumerate() {
            for d in directions(vertex) {
                let information: f64 = diagonals.iter().map(|blocks| quadratic(&blocks[vertex], d)).sum();
                // No information about an unknown: its equation is 0 = 0.
                if information > 0.0 {
                    let force = DVec3::from_array(*r).dot(d);
                    let rounding = f64::EPSILON * rows[vertex] * extent;
                    sums.add(
                        vertex,
                        force / information.sqrt(),
                        force / information,
                        rounding / information.sqrt(),
                    );
                }
            }
        }
        Ok(sums.residual())
    }

    /// Distance of the surface from that of the filter.
    fn of_filter(model: &SurfaceModel, filter: &PatchFilter) -> Result<Self> {
        let mut sums = Sums::default();
        let of_filter = filter.surface()?;
        for (vertex, (a, b)) in model.surface.vertices().iter().zip(of_filter.vertices()).enumerate() {
            // A vertex is a weighted mean of few copies.
            let rounding = 100.0 * f64::EPSILON * a.abs().max_element();
            sums.add(vertex, a.distance(*b), a.distance(*b), rounding);
        }
        Ok(sums.residual())
    }

    /// Compares the residual of a model that was read with the one that its file states.
    ///
    /// # Errors
    /// `Input` that names the vertex which is farthest from its place.
    pub(super) fn check(&self, stated: Option<f64>, model: &SurfaceModel) -> Result<()> {
        let unit = model.unit.name();
        let in_patches = model.known.filter().is_some();
        let (agrees, expected) = match stated {
            Some(stated) => (
                (self.rms - stated).abs() <= RELATIVE_TOLERANCE * stated + self.rounding,
                format!("{stated:.4e}, as when it was saved"),
            ),
            // Residuals of a filter are no multiples of σ, so there is no limit for them.
            None if in_patches => return Ok(()),
            None => (
                self.largest <= MAX_UNSTATED_RESIDUAL,
                format!("at most {MAX_UNSTATED_RESIDUAL} at each vertex"),
            ),
        };
        if agrees {
            return Ok(());
        }
        let equation = match in_patches {
            true => "the distance from the vertices of the patches".to_owned(),
            false => "the residual of Λ x = η (in σ)".to_owned(),
        };
        Err(Error::input(format!(
            "the tensor `vertices` does not agree with the information of the model: expected {equation} \
             to be {expected}, found {:.4e} in the root mean square, largest {:.4e} at vertex {}, which is \
             {:.3e} {unit} from its place; restore the file from a copy or fit the model again",
            self.rms, self.largest, self.vertex, self.distance
        )))
    }
}

/// Sums over all unknowns.
#[derive(Default)]
struct Sums {
    squares: f64,
    squares_of_rounding: f64,
    count: usize,
    /// Vertex, residual and distance of the largest.
    largest: (usize, f64, f64),
}

impl Sums {
    fn add(&mut self, vertex: usize, residual: f64, distance: f64, rounding: f64) {
        self.squares += residual * residual;
        self.squares_of_rounding += rounding * rounding;
        self.count += 1;
        if residual.abs() > self.largest.1 {
            self.largest = (vertex, residual.abs(), distance.abs());
        }
    }

    fn residual(&self) -> MeanResidual {
        let rms = |squares: f64| (squares / self.count.max(1) as f64).sqrt();
        let (vertex, largest, distance) = self.largest;
        let rounding = rms(self.squares_of_rounding);
        MeanResidual { rms: rms(self.squares), rounding, vertex, largest, distance }
    }
}

type Information = planish_estimate::sparse::BlockInformation;

/// The diagonal block of each vertex; it is the first of its column.
fn diagonal_blocks(information: &Information) -> Vec<[f64; 9]> {
    let blocks = information.values().as_chunks::<9>().0;
    (0..information.pattern().nodes())
        .map(|vertex| blocks[information.pattern().column_range(vertex).start])
        .collect()
}

/// `dᵀ B d`
fn quadratic(block: &[f64; 9], d: DVec3) -> f64 {
    let d = d.to_array();
    (0..9).map(|k| d[k / 3] * block[k] * d[k % 3]).sum()
}

/// Sum of the absolute values in the rows of each vertex, of both triangles of the matrices.
fn row_sums(vertices: usize, matrices: [&Information; 2]) -> Vec<f64> {
    let mut sums = vec![0.0; vertices];
    for information in matrices {
        let (pattern, blocks) = (information.pattern(), information.values().as_chunks::<9>().0);
        for column in 0..pattern.nodes() {
            for (block, &row) in pattern.column_range(column).zip(pattern.column(column)) {
                let size: f64 = blocks[block].iter().map(|v| v.abs()).sum();
                sums[column] += size;
                if row as usize != column {
                    sums[row as usize] += size;
                }
            }
        }
    }
    sums
}
