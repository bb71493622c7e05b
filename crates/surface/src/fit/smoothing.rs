//! Smoothing splines of positions with known parameters: vertices, and the prior's weight by restricted
//! likelihood.
//!
//! Input: sums of positions and the metric of a reference surface. Output: the weight, the factored equations
//! and the vertices. One matrix serves all coordinates, so there is one unknown for each node.

use planish_core::DVec3;
use planish_estimate::sparse::{BlockInformation, CholeskyFactor};
use planish_estimate::{
    Dispersion, Error, Result, SmoothnessEvaluation, SmoothnessModel, SmoothnessSearch, SmoothnessWeight,
    maximize_restricted_likelihood,
};
use planish_spline::{Cell, Hierarchy, PositionSums, Shape, Surface, SurfaceSystem};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Tolerance of `log w`. Its standard error is rarely below 0.1, so a finer search would fit noise.
const TOLERANCE: f64 = 0.03;
/// First steps of `log w`: from a weight found before, from one of a coarser grid, and from a guess.
///
/// Each evaluation is a factorisation. A small step needs many of them to reach the maximum from afar; a
/// large one leaves the neighbourhood of a good start.
const STEP_FROM_EARLIER: f64 = 0.5;
const STEP_FROM_COARSER: f64 = 1.0;
const STEP_FROM_GUESS: f64 = 2.0;
/// Shortest length over which the plate smooths, in cells, and longest, in sides of the surface. Beyond these
/// the equations are lost in rounding.
const SOFTEST: f64 = 1e-3;
const STIFFEST: f64 = 10.0;
/// Grids of at most this many cells are searched directly, without a coarser grid first.
const FEW_CELLS: usize = 100;
/// A coordinate counts as an affine function of the parameters if its variance about one is less than this
/// share of its own.
///
/// Rounding leaves far less. Noise of more than a millionth of the spread of a coordinate counts as measured.
const EXACT_SHARE: f64 = 1e-12;

/// Sums of the readings of all sensors, with their equations.
pub(super) struct Totals {
    pub sums: PositionSums,
    pub information: BlockInformation,
    squares: [f64; 3],
}

impl Totals {
    /// The sums of every sensor, each over its variance.
    pub(super) fn new(sums: &[PositionSums], variances: &[f64], system: &SurfaceSystem) -> Result<Self> {
        let mut total = PositionSums::new(system.space());
        for (sums, variance) in sums.iter().zip(variances) {
            total.merge(sums, 1.0 / variance)?;
        }
        Self::from_sums(total, system)
    }

    fn from_sums(sums: PositionSums, system: &SurfaceSystem) -> Result<Self> {
        let (information, squares) = (sums.information(system)?, sums.squares());
        Ok(Self { sums, information, squares })
    }
}

/// A smoothness weight and the solution with it.
pub(super) struct Smoothing {
    /// The prior's information is `w K`, where that of the readings is the sums'.
    pub found: SmoothnessWeight,
    /// `K` of one coordinate.
    pub energy: BlockInformation,
    /// The smallest and the largest weight to consider.
    bounds: (f64, f64),
    /// Which coordinates have noise; the others are affine in the parameters.
    pub measured: [bool; 3],
    pub factor: CholeskyFactor,
    /// Vertices relative to the sums' origin, node after node.
    solution: Vec<f64>,
}

/// Where the search for a weight starts.
struct SearchStart {
    weight: f64,
    /// First step of `log w`.
    step: f64,
    dispersion: Dispersion,
    /// An earlier factor, whose memory is used again.
    memory: Option<CholeskyFactor>,
}

impl Smoothing {
    /// Finds the weight in the metric of a reference surface; `known` is an approximate weight.
    pub(super) fn new(
        system: &SurfaceSystem,
        reference: &Surface,
        total: &Totals,
        known: Option<f64>,
    ) -> Result<Self> {
        let space = system.space();
        let leaves = space.leaves().len();
        let (energy, area) = if space.shape() == Some(Shape::Sheet) {
            // The reference of a sheet is affine, so all leaves have the same metric.
            (system.thin_plate_over_plane(reference)?, leaves as f64 * reference.leaf_area(0))
        } else {
            let areas = (0..leaves).map(|leaf| reference.leaf_area(leaf));
            (system.thin_plate(reference)?, areas.sum())
        };
        // The search starts with the weight that smooths over one cell.
        let readings: f64 = total.sums.weight();
        let of_length2 = |square: f64| readings / area * square * square;
        let cell = area / leaves as f64;
        let start = of_length2(cell);
        let bounds = (of_length2(SOFTEST * SOFTEST * cell), of_length2(STIFFEST * STIFFEST * area));
        let step = if known.is_some() { STEP_FROM_COARSER } else { STEP_FROM_GUESS };
        let start = known.unwrap_or(start);
        let start = SearchStart { weight: start, step, dispersion: Dispersion::Estimated, memory: None };
        Self::search(system, energy, bounds, total, start)
    }

    /// An approximate weight from a grid of cells four times as large: much cheaper than [`Self::new`], and a
    /// better start than any guess. None if there are few cells, or the metric is not known from the
    /// readings.
    pub(super) fn first_weight(sums: &PositionSums) -> Result<Option<f64>> {
        let space = sums.space();
        if space.shape() != Some(Shape::Sheet) || space.leaves().len() <= FEW_CELLS {
            return Ok(None);
        }
        // Sums over coarse cells follow from those over fine ones, so no reading is visited again.
        let coarse = sums.coarsened()?.coarsened()?;
        let start = Self::first_weight(&coarse)?;
        let system = SurfaceSystem::new(coarse.space())?;
        let total = Totals::from_sums(coarse, &system)?;
        let found = Self::new(&system, &reference_surface(total.sums.space(), &total.sums)?, &total, start);
        // A search that fails on large cells may succeed on small ones, so its error is dropped.
        Ok(found.ok().map(|smoothing| smoothing.found.weight))
    }

    /// The solution for other readings, starting from the weight found before.
    pub(super) fn again(self, system: &SurfaceSystem, total: &Totals) -> Result<Self> {
        let start = SearchStart {
            weight: self.found.weight,
            step: STEP_FROM_EARLIER,
            dispersion: Dispersion::Estimated,
            memory: Some(self.factor),
        };
        Self::search(system, self.energy, self.bounds, total, start)
    }

    /// The solution with the stated noise, for readings too few to separate noise from shape.
    pub(super) fn with_stated_noise(self, system: &SurfaceSystem, total: &Totals) -> Result<Self> {
        let start = SearchStart {
            weight: self.found.weight,
            step: STEP_FROM_GUESS,
            dispersion: Dispersion::Known(1.0),
            memory: Some(self.factor),
        };
        Self::search(system, self.energy, self.bounds, total, start)
    }

    fn search(
        system: &SurfaceSystem,
        energy: BlockInformation,
        bounds: (f64, f64),
        total: &Totals,
        SearchStart { weight: start, step, dispersion, memory }: SearchStart,
    ) -> Result<Self> {
        if !(start > 0.0 && start.is_finite()) {
            return Err(Error::undetermined(
                "expected readings that span an area, found all on one line or at one point",
            ));
        }
        let measured = measured_coordinates(total);
        let coordinates = measured.iter().filter(|m| **m).count();
        // Functions without energy: affine ones over a plane, the constant and the height along a tube, and
        // the constant alone over a closed shape.
        let null = match system.space().shape() {
            Some(Shape::Sheet) => 3,
            Some(Shape::Tube) => 2,
            Some(Shape::Ball | Shape::Torus) | None => 1,
        };
        let nodes = system.pattern().nodes();
        let model = SmoothnessModel {
            rank: coordinates * (nodes - null),
            unknowns: coordinates * nodes,
            equations: coordinates * total.sums.count(),
            // That of K does not depend on the weight, so it does not move the maximum.
            log_pseudo_determinant: 0.0,
            dispersion,
        };
        let search = SmoothnessSearch {
            tolerance: TOLERANCE,
            step,
            bounds,
            ..SmoothnessSearch::from_start(start.clamp(bounds.0, bounds.1))
        };
        let vector = total.information.vector();
        // Exact coordinates would make the residual too small for their number.
        let noisy: Vec<f64> = (vector.chunks_exact(3))
            .flat_map(|eta| (0..3).filter(|&d| measured[d]).map(|d| eta[d]))
            .collect();
        let squares: f64 = (0..3).filter(|&d| measured[d]).map(|d| total.squares[d]).sum();
        let mut factor = memory;
        let mut factored_at = None;
        let mut matrix = total.information.clone();
        // The values are overwritten in place: the pattern stays, and with it the symbolic factorisation.
        let mut factorize = |weight: f64, factor: &mut Option<CholeskyFactor>| -> Result<()> {
            matrix.values_mut().copy_from_slice(total.information.values());
            matrix.add_scaled(&energy, weight)?;
            *factor = Some(system.refactorize_scalar(factor.take(), &matrix)?);
            Ok(())
        };
        let mut whitened = Vec::new();
        let found = maximize_restricted_likelihood(&model, &search, |weight| {
            factored_at = None;
            factorize(weight, &mut factor)?;
            let Some(made) = &factor else { unreachable!("a factor was made") };
            factored_at = Some(weight);
            // zᵀWz − ηᵀA⁻¹η is the residual and w times the roughness together.
            // The likelihood needs a forward substitution only, not the solution (decision 0012).
            whitened.clone_from(&noisy);
            made.solve_lower_in_place(&mut whitened)?;
            let explained: f64 = whitened.iter().map(|x| x * x).sum();
            Ok(SmoothnessEvaluation {
                log_determinant: coordinates as f64 * made.log_determinant(),
                // Exact data cancel to zero, or by rounding to less; the logarithm needs a positive number.
                residual: (squares - explained).max(f64::MIN_POSITIVE),
                roughness: 0.0,
                trace: None,
            })
        })?;
        // The search may return another weight than it evaluated last; the solution must belong to the
        // result.
        if factored_at != Some(found.weight) {
            factorize(found.weight, &mut factor)?;
        }
        let factor = factor
            .ok_or_else(|| Error::undetermined("the readings do not determine the weight of smoothness"))?;
        let mut solution = vector.to_vec();
        factor.solve_in_place(&mut solution)?;
        Ok(Self { found, energy, bounds, measured, factor, solution })
    }

    /// The surface.
    pub(super) fn surface(&self, system: &SurfaceSystem, total: &Totals) -> Result<Surface> {
        let origin = total.sums.origin();
        let vertices = (self.solution.chunks_exact(3))
            .map(|x| DVec3::new(origin[0] + x[0], origin[1] + x[1], origin[2] + x[2]))
            .collect();
        Surface::new(Arc::clone(system.space()), vertices)
    }
}

/// The coordinates that are not affine functions of the parameters; all of them if none is left.
fn measured_coordinates(total: &Totals) -> [bool; 3] {
    if total.sums.space().shape() != Some(Shape::Sheet) {
        return [true; 3];
    }
    let measured = match total.sums.affine() {
        Some(affine) => affine.unexplained_share.map(|share| share > EXACT_SHARE),
        None => [true; 3],
    };
    // If every coordinate is affine, the readings lie on a plane without noise. The search still needs one
    // coordinate to weigh.
    if measured == [false; 3] { [true; 3] } else { measured }
}

/// # Errors
/// `Input` over a domain of quads, whose metric no formula gives.
fn known_shape(space: &Hierarchy) -> Result<Shape> {
    space.shape().ok_or_else(|| Error::input("known parameters need a sheet, tube, ball or torus"))
}

/// A surface with approximately the metric of the readings: for a sheet the best affine map, for other shapes
/// a round one with square cells, as far as closing allows.
///
/// # Errors
/// `Undetermined` if the readings lie on one line.
pub(super) fn reference_surface(space: &Arc<Hierarchy>, sums: &PositionSums) -> Result<Surface> {
    let [nu, nv] = space.extent();
    let point: Box<dyn Fn(f64, f64) -> DVec3> = match known_shape(space)? {
        Shape::Sheet => {
            let undetermined = || {
                Error::undetermined(
                    "expected parameters that span an area, found all on one line: they \
                    do not determine a surface",
                )
            };
            let [origin, along_u, along_v] = sums.affine().ok_or_else(undetermined)?.map;
            let [origin, along_u, along_v] = [origin, along_u, along_v].map(DVec3::from);
            Box::new(move |u, v| origin + u * along_u + v * along_v)
        }
        Shape::Tube => {
            let radius = nu / TAU;
            Box::new(move |u, v| DVec3::new(radius * (TAU * u / nu).cos(), radius * (TAU * u / nu).sin(), v))
        }
        Shape::Ball => {
            let radius = nu / TAU;
            Box::new(move |u, v| {
                let (longitude, latitude) = (TAU * u / nu, PI * (v / nv - 0.5));
                DVec3::new(
                    radius * latitude.cos() * longitude.cos(),
                    radius * latitude.cos() * longitude.sin(),
                    radius * latitude.sin(),
                )
            })
        }
        Shape::Torus => {
            let tube = nv / TAU;
            // A ring narrower than its tube would pass through itself, and its metric would be singular at
            // the axis.
            let ring = (nu / TAU).max(1.5 * tube);
            Box::new(move |u, v| {
                let (a, b) = (TAU * u / nu, TAU * v / nv);
                let out = ring + tube * b.cos();
                DVec3::new(out * a.cos(), out * a.sin(), tube * b.sin())
            })
        }
    };
    // Coefficients at their Greville abscissae: exact for an affine map, near enough for a metric otherwise.
    let vertices = space.vertices_from(|cell: Cell| {
        let side = cell.side();
        std::array::from_fn(|k| {
            let (i, j) = (f64::from(cell.i) + (k % 4) as f64 - 1.0, f64::from(cell.j) + (k / 4) as f64 - 1.0);
            point(i * side, j * side)
        })
    });
    Surface::new(Arc::clone(space), vertices)
}
