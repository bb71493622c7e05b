//! Fit of few readings: σ and the smoothness weight are integrated out.
//!
//! Input: [`Observations`] of at most [`MAX_READINGS`] positions. Output: a [`ConvergedFit`]: heights over a
//! fitted plane, sphere, cylinder or torus. The prior resists departures from any shape of that kind, so the
//! place and the size of the base cost nothing.
//!
//! Not guaranteed: objects that are no height field over such a base. Their fit is vague and refused, or
//! their readings are rejected.

mod base;

use super::FitOptions;
use super::first::{ShownShape, base_grid};
use super::leaves::{leaf_areas, leaves_with_feet, with_neighbours};
use super::marginal::{MarginalHeights, row_of_heights};
use super::minimum::{free_parameters, refuse_line, refuse_too_few, refuse_vague};
use super::noise::SensorNoise;
use super::refine::{ConvergedFit, ConvergedKind, TANGENTIAL_HOLD};
use super::weights::{Weighting, weight_of_length, weights};
use crate::observe::{
    Foot, FootState, Observations, ProjectedReadings, Quantity, accumulate, project, surface_extent,
};
use crate::subdivision::RefinementLog;
use base::base_of_few;
use nalgebra::{DMatrix, DVector};
use planish_core::vector3::coordinates;
use planish_core::{DVec3, Progress, Vec3};
use planish_estimate::sparse::BlockInformation;
use planish_estimate::{Dispersion, Error, PenalizedReadings, Result, SmoothnessPosterior};
use planish_spline::{BaseShape, FootPointSearch, Shape, Surface, SurfaceSystem, principal_axes};

/// Positions up to which σ and the weight are integrated out.
///
/// With more, both are known well enough to be taken as they are found, and refinement resolves more detail
/// than the grid of this fit.
const MAX_READINGS: usize = 300;
/// Numbers that the readings measure in all: normals count two, curvatures three. The equations are dense.
const MAX_EQUATIONS: usize = 2500;
/// Cells of the grid. A sheet has as many as readings within these bounds, since more show no more; bodies
/// have the most, which is 16 about a ball: a sphere is then exact to 1e-5 of its radius.
const CELLS: (usize, usize) = (32, 128);
/// Maximum number of projections on the surface.
const ITERATIONS: usize = 25;
/// The fit has converged when the mean square step at the readings is this share of their variance.
const CONVERGED: f64 = 1e-4;
/// Iterations before readings are rejected or a stated σ is contradicted: the shape is found first.
const FIRST_ITERATIONS: usize = 3;
/// Smallest cosine between the normal of the surface and the direction of its heights. A steeper surface is
/// no height field: its heights are not determined.
const MIN_COSINE: f64 = 0.1;

/// True if a fit is one of few readings.
pub(super) fn is_few(observations: &Observations) -> bool {
    let fitted = observations.fitted();
    let is_position = |&&i: &&u32| observations.quantity(i as usize) == Quantity::Position;
    fitted.iter().filter(is_position).count() <= MAX_READINGS
        && fitted.iter().map(|&i| observations.quantity(i as usize).rows()).sum::<usize>() <= MAX_EQUATIONS
        && observations.scan_errors.is_empty()
        && !observations.intake.ground
        && !observations.channels.iter().any(|channel| channel.inferred)
}

/// Fits few readings; none if their shape cannot be chosen without normals.
///
/// # Errors
/// `Undetermined` for fewer readings than the shape needs, and for a surface that is hardly known; `Input`
/// for fewer coefficients than the shape takes.
pub(super) fn fit_few_readings(
    observations: &mut Observations,
    options: &FitOptions,
    progress: &dyn Progress,
) -> Result<Option<ConvergedFit>> {
    let subset = observations.fitted();
    let positions: Vec<usize> = (subset.iter().map(|&i| i as usize))
        .filter(|&i| observations.quantity(i) == Quantity::Position)
        .collect();
    let points: Vec<DVec3> = positions.iter().map(|&i| observations.readings.points[i]).collect();
    let known =
        |i: usize| if observations.readings.oriented[i] { observations.normal(i) } else { DVec3::ZERO };
    let normals: Vec<DVec3> = positions.iter().map(|&i| known(i)).collect();
    let estimated: Vec<DVec3> = positions.iter().map(|&i| observations.normal(i)).collect();
    let Some(base) = base_of_few(&points, &normals, &estimated, options.shape)? else {
        return Ok(None);
    };
    refuse_too_few(base.shape, points.len())?;
    progress.check("first shape", 0.02)?;
    // Normals from neighbours are wrong among so few, and would reject readings.
    for i in 0..observations.len() {
        if !observations.readings.oriented[i] && observations.quantity(i) == Quantity::Position {
            observations.readings.normals[i] = Vec3::ZERO;
        }
    }
    let cells = match base.shape {
        Shape::Sheet => points.len().clamp(CELLS.0, CELLS.1),
        _ => CELLS.1,
    };
    let reference = base.surface(base_grid(&base, cells, 1, options.max_coefficients)?)?;
    let system = SurfaceSystem::new(reference.space())?;
    let fit = HeightFit::new(observations, options, &system, &reference, &base, subset)?;
    let spread = principal_axes(&points).2.map(|variance| variance.max(0.0).sqrt());
    fit.converge(progress)?.finish(spread).map(Some)
}

/// Heights over a base, on the way to their posterior.
struct HeightFit<'a> {
    observations: &'a Observations,
    options: &'a FitOptions,
    system: &'a SurfaceSystem,
    reference: &'a Surface,
    base: &'a BaseShape,
    /// Unit directions of the heights, and `K` of the heights.
    directions: Vec<DVec3>,
    plate: BlockInformation,
    /// `K` without what changes the place and the size of the base.
    penalty: DMatrix<f64>,
    subset: Vec<u32>,
    surface: Surface,
    heights: DVector<f64>,
    at: Vec<[f64; 2]>,
    feet: Vec<Foot>,
    noise: SensorNoise,
    information: Vec<f64>,
    degrees: Vec<f64>,
    /// `φ` of the last iteration; the noise contains it.
    dispersion: f64,
    posterior: Option<SmoothnessPosterior>,
    typical_weight: f64,
}

impl<'a> HeightFit<'a> {
    fn new(
        observations: &'a Observations,
        options: &'a FitOptions,
        system: &'a SurfaceSystem,
        reference: &'a Surface,
        base: &'a BaseShape,
        subset: Vec<u32>,
    ) -> Result<Self> {
        let directions = reference.node_normals();
        let plate = plate(system, base, reference)?;
        let penalty = without_free_motions(plate.to_dense(), &free_motions(base, reference, &directions));
        let mut degrees = vec![0.0; observations.channels.len()];
        for &i in &subset {
            // A start: as if the surface followed a quarter of what its readings say.
            let channel = observations.channel(i as usize);
            degrees[channel] += 0.25 * observations.channels[channel].quantity.rows() as f64;
        }
        Ok(Self {
            observations,
            options,
            system,
            reference,
            base,
            heights: DVector::zeros(directions.len()),
            directions,
            plate,
            penalty,
            subset,
            surface: reference.clone(),
            at: vec![[f64::NAN; 2]; observations.len()],
            feet: Vec::new(),
            noise: SensorNoise::stated(&observations.channels),
            information: Vec::new(),
            degrees,
            dispersion: 1.0,
            posterior: None,
            typical_weight: 1.0,
        })
    }

    /// Iterates until the surface stays, first with every reading and the stated σ.
    fn converge(mut self, progress: &dyn Progress) -> Result<Self> {
        let mut is_settled = false;
        for iteration in 0..ITERATIONS {
            progress.check("refining", 0.1 + 0.8 * iteration as f64 / ITERATIONS as f64)?;
            let step = self.step(is_settled)?;
            if step < CONVERGED && is_settled {
                break;
            }
            is_settled |= step < CONVERGED || iteration >= FIRST_ITERATIONS;
        }
        Ok(self)
    }

    /// Projects, weighs and solves; returns the mean square step at the readings in their variances. Readings
    /// are rejected, and stated σ contradicted, only once the shape `is_settled`.
    fn step(&mut self, is_settled: bool) -> Result<f64> {
        let search = FootPointSearch::new(&self.surface, 2, 0.1 * surface_extent(&self.surface))?;
        let factors = &self.noise.variance_factors;
        self.feet =
            project(&self.surface, self.observations, &self.subset, &mut self.at, Some(&search), factors);
        let is_estimated = self.weigh(is_settled)?;
        let used = self.information.iter().filter(|&&w| w > 0.0).count();
        let null = free_parameters(self.base.shape);
        if used < null + 3 {
            return Err(Error::undetermined(format!(
                "expected readings near a {}, found {used} of {}: the others lie beyond its border or face \
                 another side; add readings",
                self.base.shape.name(),
                self.subset.len()
            )));
        }
        let (rows, values, channels) = self.equations();
        let area: f64 = leaf_areas(&self.surface).iter().sum();
        self.typical_weight =
            weight_of_length(&self.feet, &self.information, area, (area / used as f64).sqrt());
        let readings = PenalizedReadings {
            rows: &rows,
            values: &values,
            penalty: &self.penalty,
            null,
            typical_weight: self.typical_weight,
        };
        let dispersion = if is_estimated { Dispersion::Estimated } else { Dispersion::Known(1.0) };
        let posterior = SmoothnessPosterior::new(&readings, dispersion)?;
        self.degrees.fill(0.0);
        for (row, &channel) in rows.row_iter().zip(&channels) {
            self.degrees[channel] += posterior.degrees(&row.transpose());
        }
        self.dispersion = posterior.dispersion();
        let moved = &rows * (posterior.mean() - &self.heights);
        self.heights.copy_from(posterior.mean());
        self.posterior = Some(posterior);
        let lifted = (self.reference.vertices().iter().zip(&self.directions).zip(self.heights.iter()))
            .map(|((p, d), h)| *p + *h * *d);
        self.surface = self.reference.with_vertices(lifted.collect())?;
        Ok(moved.norm_squared() / (moved.len() as f64 * self.dispersion))
    }

    /// Sets the noise and the information of each reading; true if σ of all of them is estimated.
    fn weigh(&mut self, is_settled: bool) -> Result<bool> {
        let channels = &self.observations.channels;
        let readings =
            ProjectedReadings { observations: self.observations, subset: &self.subset, feet: &self.feet };
        let mut noise =
            SensorNoise::estimate(readings, self.options.noise_rules(), &self.degrees, is_settled)?;
        let mut is_estimated = true;
        for (c, channel) in channels.iter().enumerate().filter(|(c, _)| noise.count[*c] > 0) {
            if !is_settled && channel.stated {
                noise.variance_factors[c] = 1.0;
            }
            is_estimated &= !channel.stated || noise.is_contradicted[c];
        }
        self.information = if is_settled {
            // The gate is that of the last posterior: residuals alone are small where readings are followed.
            let mut gate = noise.clone();
            if is_estimated {
                gate.variance_factors.iter_mut().for_each(|factor| *factor *= self.dispersion.max(1.0));
            }
            let kept = weights(readings, &gate, self.options.gate, Weighting::Gated);
            let all = weights(readings, &noise, f64::INFINITY, Weighting::Gated);
            all.iter().zip(kept).map(|(all, kept)| if kept > 0.0 { *all } else { 0.0 }).collect()
        } else {
            weights(readings, &noise, f64::INFINITY, Weighting::Gated)
        };
        self.noise = noise;
        Ok(is_estimated)
    }

    /// Rows, values and channels of all equations in σ of their readings, for the heights over the base.
    fn equations(&self) -> (DMatrix<f64>, DVector<f64>, Vec<usize>) {
        let (mut rows, mut values, mut channels) = (Vec::new(), Vec::new(), Vec::new());
        for (k, foot) in self.feet.iter().enumerate().filter(|(k, _)| self.information[*k] > 0.0) {
            let scale = self.information[k].sqrt();
            foot.rows(&self.surface, |r, c| {
                let row = row_of_heights(&self.directions, &self.surface, foot.leaf as usize, c, foot.normal)
                    * scale;
                values.push(scale * foot.residuals[r] + row.dot(&self.heights));
                rows.push(row.transpose());
                channels.push(self.observations.channel(self.subset[k] as usize));
            });
        }
        (DMatrix::from_rows(&rows), DVector::from_vec(values), channels)
    }

    /// The converged fit, with the information of the mean weight and σ.
    fn finish(mut self, spread: [f64; 3]) -> Result<ConvergedFit> {
        let posterior = self
            .posterior
            .take()
            .ok_or_else(|| Error::undetermined("the readings do not determine the surface"))?;
        // The stored σ is enlarged, so that normal intervals with it are those of Student's t.
        let enlarged = if posterior.margin() > 1.0 { posterior.dispersion() } else { 1.0 };
        let margin2 = posterior.margin().powi(2);
        let estimated = |c: usize| !self.observations.channels[c].stated || self.noise.is_contradicted[c];
        for c in (0..self.observations.channels.len()).filter(|&c| estimated(c)) {
            self.noise.estimated_factors[c] = self.noise.variance_factors[c] * enlarged;
            self.noise.variance_factors[c] *= enlarged * margin2;
        }
        let factors = &self.noise.variance_factors;
        self.feet = project(&self.surface, self.observations, &self.subset, &mut self.at, None, factors);
        let readings =
            ProjectedReadings { observations: self.observations, subset: &self.subset, feet: &self.feet };
        self.information = weights(readings, &self.noise, self.options.gate, Weighting::Gated);
        let weight = self.typical_weight * posterior.relative_weight() / (enlarged * margin2);
        let prior = self.prior(weight)?;
        let marginal = MarginalHeights { posterior, directions: self.directions };
        refuse_line(self.base.shape, spread, sigma_of_readings(&self.feet, factors, readings))?;
        refuse_vague(
            self.base,
            self.subset.len(),
            median_sigma(&marginal, &self.surface, &self.feet, &self.information),
        )?;
        Ok(ConvergedFit {
            surface: self.surface,
            system: self.system.clone(),
            subset: self.subset,
            feet: self.feet,
            noise: self.noise,
            weight,
            prior,
            at: self.at,
            reached_limit: false,
            reached_tolerance: self.options.tolerance.is_some(),
            refined: RefinementLog::default(),
            kind: ConvergedKind::AlongNormals,
            marginal: Some(marginal),
            shown: ShownShape::default(),
        })
    }

    /// The prior about the vertices, whose mean makes the surface the most likely one.
    fn prior(&self, weight: f64) -> Result<BlockInformation> {
        // A vertex that moves by v lifts the surface by v·n / n·d along d.
        let lift: Vec<DVec3> = (self.surface.node_normals().iter().zip(&self.directions))
            .map(|(normal, direction)| {
                let cosine = normal.dot(*direction);
                if cosine > MIN_COSINE { Ok(*normal / cosine) } else { Err(self.folded()) }
            })
            .collect::<Result<_>>()?;
        let mut heights = self.plate.expanded(3)?;
        let pattern = self.system.pattern();
        for column in 0..pattern.nodes() {
            for (position, &row) in pattern.column_range(column).zip(pattern.column(column)) {
                let block = &mut heights.values_mut()[9 * position..9 * position + 9];
                let (value, a, b) = (weight * block[0], lift[row as usize], lift[column]);
                for (k, entry) in block.iter_mut().enumerate() {
                    *entry = value * a[k / 3] * b[k % 3];
                }
            }
        }
        let mut prior = self.system.tangential_hold(&self.surface, TANGENTIAL_HOLD)?;
        prior.add_scaled(&heights, 1.0)?;
        // The surface is the mean over all weights, the information that of one: Λ x = η holds with this η.
        let data = accumulate(self.system, &self.surface, &self.feet, &self.information)?;
        let x = coordinates(self.surface.vertices());
        let (mut of_prior, mut of_data) = (vec![0.0; x.len()], vec![0.0; x.len()]);
        prior.multiply(x, &mut of_prior)?;
        data.multiply(x, &mut of_data)?;
        let balanced = of_prior.iter().zip(&of_data).zip(data.vector()).map(|((p, d), eta)| p + d - eta);
        let balanced: Vec<f64> = balanced.collect();
        prior.vector_mut().copy_from_slice(&balanced);
        Ok(prior)
    }

    fn folded(&self) -> Error {
        Error::undetermined(format!(
            "{} readings do not determine a surface over a {}: it would be too steep to be a height over it; \
             specify another shape or add readings",
            self.subset.len(),
            self.base.shape.name()
        ))
    }
}

/// Root mean square σ of the positions.
fn sigma_of_readings(feet: &[Foot], factors: &[f64], readings: ProjectedReadings<'_>) -> f64 {
    let variances: Vec<f64> = (feet.iter().enumerate())
        .filter(|(_, foot)| foot.state == FootState::Good && foot.quantity == Quantity::Position)
        .map(|(k, foot)| factors[readings.channel(k)] * foot.variance)
        .collect();
    (variances.iter().sum::<f64>() / variances.len().max(1) as f64).sqrt()
}

/// Median σ of the surface at the middles of its measured leaves.
fn median_sigma(marginal: &MarginalHeights, surface: &Surface, feet: &[Foot], information: &[f64]) -> f64 {
    let observed = with_neighbours(surface.space(), &leaves_with_feet(surface, feet, information, |_| true));
    let mut variances: Vec<f64> = (0..observed.len())
        .filter(|&leaf| observed[leaf])
        .map(|leaf| marginal.variance_in(surface, leaf, [0.5; 2]))
        .collect();
    variances.sort_by(f64::total_cmp);
    variances.get(variances.len() / 2).map_or(f64::INFINITY, |variance| variance.sqrt())
}

/// `K` in the metric in which changes are smooth, that of the base but for a torus.
///
/// On a torus, a wave once around the tube may be as likely as one of the same length, or as one that goes
/// once around the ring. The tube of the metric is half way: its radius is the geometric mean of both
/// radii. In the metric of the torus, 50 and 100 readings of tori that vary with the angles had 95 %
/// intervals that covered 0.91.
fn plate(system: &SurfaceSystem, base: &BaseShape, reference: &Surface) -> Result<BlockInformation> {
    if base.shape != Shape::Torus {
        return system.thin_plate(reference);
    }
    let [ring, _, tube] = base.size;
    let metric = BaseShape::torus(base.centre, base.frame[2], ring, (ring * tube).sqrt());
    system.thin_plate(&metric.surface(reference.space().base())?)
}

/// Heights, node by node, of changes of the base that the plate resists, but the prior should not: motions
/// and changes of size keep the shape, and the curvatures of a sheet are the first thing that tells it from a
/// plane.
fn free_motions(base: &BaseShape, reference: &Surface, directions: &[DVec3]) -> Vec<DVector<f64>> {
    let [e1, e2, e3] = base.frame;
    let of = |motion: &dyn Fn(DVec3) -> DVec3| {
        let nodes = reference.vertices().iter().zip(directions);
        DVector::from_iterator(directions.len(), nodes.map(|(p, d)| d.dot(motion(*p - base.centre))))
    };
    let shift = |e: DVec3| of(&|_| e);
    let turn = |e: DVec3| of(&|p| e.cross(p));
    match base.shape {
        // An affine height has no energy.
        Shape::Sheet => {
            let curved = |a: DVec3, b: DVec3| of(&|p| p.dot(a) * p.dot(b) * e3);
            vec![curved(e1, e1), curved(e1, e2), curved(e2, e2)]
        }
        Shape::Ball => vec![shift(e1), shift(e2), shift(e3)],
        Shape::Tube => vec![shift(e1), shift(e2), turn(e1), turn(e2)],
        Shape::Torus => {
            let outwards = of(&|p| (p - p.dot(e3) * e3).normalize_or_zero());
            vec![shift(e1), shift(e2), shift(e3), turn(e1), turn(e2), outwards]
        }
    }
}

/// `K − KF (FᵀKF)⁻¹ FᵀK`: the energy that is left when the motions `F` may lower it.
fn without_free_motions(plate: DMatrix<f64>, motions: &[DVector<f64>]) -> DMatrix<f64> {
    if motions.is_empty() {
        return plate;
    }
    let free = DMatrix::from_columns(motions);
    let forces = &plate * &free;
    match free.tr_mul(&forces).cholesky() {
        Some(factor) => &plate - &forces * factor.solve(&forces.transpose()),
        None => plate,
    }
}
