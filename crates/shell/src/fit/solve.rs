//! Levenberg–Marquardt iterations on the equations of a shell, from coarse fields to sharp ones, followed by
//! the covariance.
//!
//! In: the mesh, its deformation, the readings, the options, and a callback for progress. Out: a
//! [`ShellFit`].
//! The unknowns are the parameters of the deformation, then six numbers for each uncertain camera pose.
//!
//! Stages: prepare the mesh and the cameras ([`Setup`]); for each sharpness iterate until converged
//! ([`run_stage`]); repeat the last stage with more smoothness while the mesh folds ([`FoldControl`]);
//! compute
//! the covariance ([`finished`]).

use super::dense::Factor;
use super::equations::{Equations, SCALES, Source, cost, sum};
use super::folds::FoldControl;
use super::orientation::outward;
use super::point_selection::chosen_points;
use super::priors::Priors;
use super::problem::{Problem, State, WeightRule};
use super::readings::{PoseNoise, ShellReadings};
use super::result::finished;
use super::smoothness::Smoothness;
use super::{ShellFit, ShellFitOptions, ShellProgress, undetermined};
use crate::deformation::Deformation;
use crate::field::{Metaball, ShellOptions, subdivide_for_spheres};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::{Error, Result, Termination, gated_scale};
use planish_mesh::TriangleMesh;

/// Reach of the last field: metaballs below `exp(−9)` of the largest are ignored.
///
/// A larger reach visits more facets per point. On a surface all ignored terms together are 0.1 % of the sum.
const REACH: f64 = 9.0;
/// [`REACH`] of coarse fields.
///
/// A smaller value is faster. A larger one includes more of the far side of a thin part in the sum, and loses
/// parts that start far away more often; so do fewer points.
const COARSE_REACH: f64 = 4.0;
/// Gate for the scale of the residuals, in standard deviations. Lower values reject more outliers and use
/// fewer readings.
const SCALE_GATE: f64 = 3.0;
/// Attempts with increasing damping before an iteration gives up: eight factors of ten reduce the step to
/// almost nothing.
const MAX_DAMPING_TRIES: usize = 8;
/// Extra smoothness of the first stage, as a multiple of the weight, before the first iteration, and the
/// share of it that each iteration leaves.
///
/// Large values keep a distant mesh in shape until the equations refer to the right part of it, and cost
/// iterations.
const STIFFENING: (f64, f64) = (100.0, 0.75);
/// [`STIFFENING`] of an energy that allows rotations: parts turn as a whole before they bend. A body whose
/// upper half turns by 30° was off by 20 to 45 σ with the values above (`benches/peers/deformation.py`,
/// `armadillo`, `turn-30`), by less than 3 σ with these.
const STIFFENING_OF_RIGID: (f64, f64) = (1000.0, 0.8);
/// The same for a start in which parts are turned already. Of three turns by 90° with 150 controls, errors of
/// seen vertices were 4.0, 4.1 and 17 σ with 30; 4.5, 9.5 and 23 σ with 3; and 4.9, 8.5 and 23 σ with 0.
/// Large values turn the parts back.
const STIFFENING_OF_POSES: f64 = 30.0;
/// Iterations of the first stage in addition to those of the options, until that stiffening has decayed.
const STIFFENING_ITERATIONS: usize = 20;
/// Largest move of a control in one step, as a share of the mesh size. The equations are linear only near the
/// current mesh.
const MAX_MOVE: f64 = 0.03;
/// Minimum number of residuals from which a scale is estimated. A median of fewer is too uncertain.
const MIN_SCALE_RESIDUALS: usize = 8;
/// Largest number of unknowns for which the redundancy is computed. It needs an inverse, which for more
/// unknowns costs as much as the fit.
const MAX_REDUNDANCY_UNKNOWNS: usize = 3000;
/// Minimum number of points for a coarse field: per unknown, and in total.
///
/// A coarse field only provides the start of the next one, so a subset is enough.
const COARSE_POINTS: (usize, usize) = (12, 5000);
/// Number of stages of a fit that continues an earlier one. The last field alone does not reach shape that
/// the earlier fit did not follow.
const RESUMED_STEPS: usize = 2;
/// Mean step per unknown, in σ, below which the last stage has converged.
const CONVERGED_STEP: f64 = 0.1;
/// The same for a coarse stage, which only provides the start of the next one.
const COARSE_CONVERGED_STEP: f64 = 0.25;
/// One edge in this many may join two inconsistently oriented facets when outlines are fitted.
const MISORIENTED_EDGES: usize = 50;

/// Fits the mesh; the arguments have passed their checks, so there is at least one stage and one iteration.
pub(super) fn solve(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFit> {
    let with_outlines = readings.views.iter().any(|view| !view.outline.is_empty());
    let mesh = prepared_mesh(mesh, with_outlines)?;
    let oriented = is_oriented(&mesh, with_outlines)?;
    check_cameras(&mesh, readings)?;
    let (slots, poses) = uncertain_poses(readings);
    let mut search = Search::new(deformation.parameters(), poses, readings, options)?;
    let unknowns = deformation.parameters() + 6 * search.priors.poses.len();
    let setup = Setup::new(mesh, deformation, readings, options, slots, oriented, unknowns)?;
    // From coarse to sharp: each field only has to bring the mesh within reach of the next one. An earlier
    // fit has already used the coarsest fields.
    let first = if options.resume.is_some() { options.steps.saturating_sub(RESUMED_STEPS) } else { 0 };
    for step in first..options.steps - 1 {
        run_stage(&setup, &mut search, step, 1.0, watch)?;
    }
    let mut folds = FoldControl::default();
    let (equations, weight) = loop {
        let (equations, weight) = run_stage(&setup, &mut search, options.steps - 1, folds.factor, watch)?;
        if !folds.needs_more_smoothness(&setup, &search, &equations, weight)? {
            break (equations, weight);
        }
    };
    let (termination, iterations, indicated) = (search.termination, search.iterations, search.indicated);
    let mut made = match folds.folded {
        Some((made, _)) => made,
        None => {
            let weight = folds.likelihood_weight.unwrap_or(weight);
            let Search { priors, state, factors, .. } = search;
            finished(&setup.mesh, deformation, &priors, state, &equations, &factors, weight)?
        }
    };
    for (source, of) in [
        (Source::Point, &mut made.points),
        (Source::Outline, &mut made.outlines),
        (Source::Track, &mut made.tracks),
        (Source::Landmark, &mut made.landmarks),
    ] {
        of.sigma_factor = indicated[source.scale()];
    }
    Ok(ShellFit { termination, iterations, ..made })
}

/// The mesh with each triangle once; with outlines, turned so that front sides are outer sides.
fn prepared_mesh(mesh: &TriangleMesh, with_outlines: bool) -> Result<TriangleMesh> {
    let once = TriangleMesh { positions: mesh.positions.clone(), triangles: mesh.triangles_once() };
    if !with_outlines {
        return Ok(once);
    }
    // The sign of the distance along a line of sight depends on the orientation.
    let triangles = outward(&once)?;
    Ok(TriangleMesh { positions: once.positions, triangles })
}

/// True if the facets of a mesh are oriented consistently; an error if outlines `need` that and they are not.
fn is_oriented(mesh: &TriangleMesh, needed: bool) -> Result<bool> {
    let check = mesh.welded().check();
    if needed && check.misoriented_edges * MISORIENTED_EDGES > check.edges {
        return Err(Error::input(format!(
            "expected a mesh whose facets all face outwards for outlines, found inconsistent facets at {} \
             of its {} edges: make the normals consistent first",
            check.misoriented_edges, check.edges
        )));
    }
    Ok(check.misoriented_edges == 0 && (needed || check.watertight))
}

/// Checks that the centre of the mesh is in front of every camera.
fn check_cameras(mesh: &TriangleMesh, readings: &ShellReadings<'_>) -> Result<()> {
    let middle = mesh.surface_bounds().map_or(DVec3::ZERO, |b| b.center());
    for (v, view) in readings.views.iter().enumerate() {
        if view.camera.project(middle).is_none() {
            return Err(Error::input(format!(
                "view {v}: expected the mesh in front of the camera, found it behind: correct the pose or \
                 the sign of the projection matrix"
            )));
        }
    }
    Ok(())
}

/// For each view its index among the uncertain poses, and for each uncertain pose its view and noise.
fn uncertain_poses(readings: &ShellReadings<'_>) -> (Vec<Option<u32>>, Vec<(usize, PoseNoise)>) {
    let mut slots = vec![None; readings.views.len()];
    let mut poses = Vec::new();
    for (v, view) in readings.views.iter().enumerate() {
        if let Some(noise) = view.pose {
            slots[v] = Some(poses.len() as u32);
            poses.push((v, noise));
        }
    }
    (slots, poses)
}

/// A subdivided mesh, and for each of its vertices the vertices and weights on the original.
type Subdivision = (TriangleMesh, Vec<[(u32, f64); 3]>);

/// What stays the same in all stages of a fit.
pub(super) struct Setup<'a> {
    pub(super) mesh: TriangleMesh,
    pub(super) deformation: &'a dyn Deformation,
    pub(super) readings: &'a ShellReadings<'a>,
    pub(super) options: &'a ShellFitOptions,
    /// For each view the index of its pose in the state, if the pose is uncertain.
    slots: Vec<Option<u32>>,
    /// Whether the facets are oriented consistently.
    oriented: bool,
    /// Diagonal of the mesh.
    size: f64,
    /// Largest change of a parameter in one step; `None` if parameters are not displacements.
    max_move: Option<f64>,
    /// The points of the coarse stages, and of the last one.
    coarse_points: Vec<u32>,
    all_points: Vec<u32>,
}

impl<'a> Setup<'a> {
    fn new(
        mesh: TriangleMesh,
        deformation: &'a dyn Deformation,
        readings: &'a ShellReadings<'a>,
        options: &'a ShellFitOptions,
        slots: Vec<Option<u32>>,
        oriented: bool,
        unknowns: usize,
    ) -> Result<Self> {
        let bounds =
            mesh.surface_bounds().ok_or_else(|| Error::input("expected a mesh with vertices, found none"))?;
        let size = bounds.diagonal();
        // Coarse stages only move the mesh close, so a subset of the points is sufficient and saves most of
        // the time.
        let enough = (COARSE_POINTS.0 * unknowns).max(COARSE_POINTS.1);
        Ok(Self {
            deformation,
            readings,
            options,
            slots,
            oriented,
            size,
            // Parameters that are no displacements have other units.
            max_move: deformation.controls().map(|_| MAX_MOVE * size),
            coarse_points: chosen_points(readings.points, enough, &bounds),
            all_points: chosen_points(readings.points, usize::MAX, &bounds),
            mesh,
        })
    }

    fn is_last(&self, step: usize) -> bool {
        step + 1 == self.options.steps
    }

    /// Thickness `1/k` of the field in a stage: a geometric sequence from the first softness to the last.
    fn softness(&self, step: usize) -> f64 {
        let (first, finest) = self.options.softness;
        let steps = self.options.steps;
        let share = if steps > 1 { step as f64 / (steps - 1) as f64 } else { 1.0 };
        // Geometric: each stage is sharper by the same factor, so that the next one starts within its reach.
        self.size * first * (finest / first).powf(share)
    }

    /// The equations of a stage. `fine` is the subdivided mesh of spherical metaballs.
    fn problem<'b>(&'b self, step: usize, softness: f64, fine: Option<&'b Subdivision>) -> Problem<'b> {
        let coarse = !self.is_last(step);
        Problem {
            mesh: &self.mesh,
            origins: fine.map(|(_, origins)| &origins[..]),
            triangles: fine.map_or(&self.mesh.triangles, |(fine, _)| &fine.triangles),
            deformation: self.deformation,
            readings: self.readings,
            shell: ShellOptions {
                reach: Some(if coarse { COARSE_REACH } else { REACH }),
                oriented: self.oriented,
                ..ShellOptions::new(self.options.metaball, 1.0 / softness)
            },
            slots: &self.slots,
            chosen: if coarse { &self.coarse_points } else { &self.all_points },
            by_sheets: !coarse,
        }
    }
}

/// What changes from one iteration to the next, over all stages.
pub(super) struct Search<'a> {
    pub(super) priors: Priors<'a>,
    pub(super) state: State,
    /// Factors of σ by kind of reading.
    pub(super) factors: [f64; SCALES],
    /// Those that the residuals indicate. They are the same unless the stated σ hold.
    indicated: [f64; SCALES],
    /// Number of readings that the unknowns use up.
    redundancy_used: f64,
    /// Iterations of all stages.
    iterations: usize,
    termination: Termination,
}

impl<'a> Search<'a> {
    fn new(
        parameters: usize,
        poses: Vec<(usize, PoseNoise)>,
        readings: &'a ShellReadings<'a>,
        options: &'a ShellFitOptions,
    ) -> Result<Self> {
        let stiffness = (options.stiffness.clone()).unwrap_or_else(|| DMatrix::zeros(parameters, parameters));
        let start = match (&options.start, &options.prior) {
            (Some(start), _) => start.clone(),
            (None, Some(prior)) => prior.mean.clone(),
            (None, None) => DVector::zeros(parameters),
        };
        let mut smooth = Smoothness::new(stiffness, options.rigidity.clone(), options.start_sigma)?;
        let state = match &options.resume {
            Some(resume) if resume.cameras.len() == readings.views.len() => {
                smooth.resume(resume.smoothness_weight);
                State { q: resume.parameters.clone(), cameras: resume.cameras.clone() }
            }
            Some(resume) => {
                return Err(Error::input(format!(
                    "expected a camera for each of {} views in the state to resume, found {}",
                    readings.views.len(),
                    resume.cameras.len()
                )));
            }
            None => {
                let cameras = readings.views.iter().map(|view| view.camera).collect();
                State { q: options.initial.as_ref().unwrap_or(&start).clone(), cameras }
            }
        };
        Ok(Self {
            state,
            priors: Priors { smooth, options, start, poses, readings },
            factors: [1.0; SCALES],
            indicated: [1.0; SCALES],
            redundancy_used: 0.0,
            iterations: 0,
            termination: Termination::Limit,
        })
    }

    /// Estimates the factors of σ from the residuals, unless the stated σ hold.
    fn update_factors(&mut self, equations: &[Equations]) -> Result<()> {
        // While the mesh is far away, residuals contain shape; σ falls to that of the noise as the mesh
        // approaches the readings.
        self.indicated = scales(equations, self.redundancy_used, self.indicated)?;
        if !self.priors.options.believe_sigma {
            self.factors = self.indicated;
        }
        Ok(())
    }

    /// Evaluates the equations again if one without derivatives has a weight by the current factors.
    fn complete_derivatives(&self, problem: &Problem<'_>, equations: &mut Vec<Equations>) -> Result<()> {
        let loss = &self.priors.options.loss;
        if Equations::lack_derivatives(equations, loss, &self.factors) {
            let weighing = problem.by_sheets.then_some(WeightRule { loss, factors: self.factors });
            *equations = problem.equations(&self.state, weighing)?;
        }
        Ok(())
    }

    /// Extra smoothness in the current iteration of a stage.
    ///
    /// A distant mesh approaches almost rigidly at first: the facets that attract it are not yet the ones
    /// that correspond to the readings.
    fn stiffening(&self, step: usize) -> f64 {
        let options = self.priors.options;
        let allows_rotations = self.priors.smooth.allows_rotations();
        let is_near = options.start_sigma.is_some() && !allows_rotations;
        if step > 0 || is_near || options.resume.is_some() {
            return 0.0;
        }
        let (first, decay) = if allows_rotations { STIFFENING_OF_RIGID } else { STIFFENING };
        let first = if options.initial.is_some() { STIFFENING_OF_POSES } else { first };
        first * decay.powi(self.iterations as i32)
    }

    /// Sums the equations, the smoothness and the priors at the current state.
    fn normal_equations(
        &mut self,
        setup: &Setup<'_>,
        equations: &[Equations],
        weight_factor: f64,
        stiffening: f64,
    ) -> Result<NormalEquations> {
        let options = setup.options;
        let poses = self.priors.poses.len();
        let scale = (&self.factors, &[1.0; SCALES]);
        let linear = setup.deformation.linearised_at(&self.state.q);
        let rows = linear.as_deref().unwrap_or(setup.deformation);
        let pass = sum(equations, rows, poses, &options.loss, scale, true);
        // The weight must not count shape as determined that a camera pose could explain as well.
        let alone = self.priors.without_poses(&self.state, &pass)?;
        let displacement = &self.state.q - &self.priors.start;
        let mut weight = self.priors.smooth.weight(&alone.information, &alone.vector, &displacement)?;
        weight *= weight_factor * (1.0 + stiffening);
        let (information, vector) = self.priors.add(&self.state, weight, &pass);
        let cost = cost(equations, &options.loss, &self.factors) + self.priors.cost(&self.state, weight);
        Ok(NormalEquations { information, vector, of_readings: pass.information, weight, cost })
    }

    /// Moves the state by the first step that does not raise the cost, with damping increased until one is
    /// found. Returns its equations and whether the stage has converged; `None` if no step helps.
    fn take_step(
        &mut self,
        setup: &Setup<'_>,
        problem: &Problem<'_>,
        system: &NormalEquations,
        damping: &mut Damping,
    ) -> Result<Option<(Vec<Equations>, bool)>> {
        let loss = &setup.options.loss;
        let weighing = WeightRule { loss, factors: self.factors };
        for _ in 0..MAX_DAMPING_TRIES {
            let parameters = self.state.q.len();
            let change =
                bounded_step(&system.information, damping.value, &system.vector, parameters, setup.max_move)?;
            let next = self.priors.moved(&self.state, &change);
            let tried = problem.equations(&next, Some(weighing))?;
            let after = cost(&tried, loss, &self.factors) + self.priors.cost(&next, system.weight);
            // The tolerance admits a step whose cost differs by rounding only.
            if after <= system.cost * (1.0 + 1e-12) {
                let length = (change.dot(&(&system.information * &change)) / change.len() as f64).sqrt();
                let converged = is_converged(length, damping.last_length, !problem.by_sheets)
                    || system.cost - after < 1e-6 * system.cost;
                damping.last_length = length;
                damping.value = (damping.value * 0.1).max(1e-9);
                self.state = next;
                return Ok(Some((tried, converged)));
            }
            // The field is not smooth in the state: nearest facets change. A failed step is repeated with
            // more damping before the stage ends.
            damping.value = (damping.value * 10.0).max(1e-6);
        }
        Ok(None)
    }
}

/// The linearised problem of one iteration.
struct NormalEquations {
    /// Information with smoothness and priors.
    information: DMatrix<f64>,
    vector: DVector<f64>,
    /// Information of the readings alone.
    of_readings: DMatrix<f64>,
    /// Smoothness weight `λ`.
    weight: f64,
    /// Total cost at the current state.
    cost: f64,
}

/// Damping of the next step, and the length of the last one in σ.
struct Damping {
    value: f64,
    last_length: f64,
}

/// Iterates at one sharpness. Returns the equations at the end and the smoothness weight.
fn run_stage(
    setup: &Setup<'_>,
    search: &mut Search<'_>,
    step: usize,
    weight_factor: f64,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<(Vec<Equations>, f64)> {
    let options = setup.options;
    let softness = setup.softness(step);
    let fine = match options.metaball {
        Metaball::Triangular => None,
        Metaball::Spherical => Some(subdivide_for_spheres(&setup.mesh, 1.5 * softness, options.max_facets)),
    };
    let problem = setup.problem(step, softness, fine.as_ref());
    search.termination = Termination::Limit;
    // In the first stage σ has not been estimated yet, so that no reading may be ignored by it.
    let weighing = WeightRule { loss: &options.loss, factors: search.factors };
    let weighing = (step > 0 || problem.by_sheets).then_some(weighing);
    let mut equations = problem.equations(&search.state, weighing)?;
    let mut damping = Damping { value: 1e-3, last_length: f64::INFINITY };
    let mut weight = 0.0;
    let mut iterations = options.iterations;
    if search.stiffening(step) > STIFFENING_OF_POSES {
        iterations += STIFFENING_ITERATIONS;
    }
    for k in 0..iterations {
        watch(ShellProgress {
            share: (step as f64 + k as f64 / iterations as f64) / options.steps as f64,
            iteration: search.iterations,
            rms_points: rms_of_points(&equations),
        })?;
        let stiffening = search.stiffening(step);
        search.iterations += 1;
        search.update_factors(&equations)?;
        search.complete_derivatives(&problem, &mut equations)?;
        let system = search.normal_equations(setup, &equations, weight_factor, stiffening)?;
        weight = system.weight;
        let accepted = search.take_step(setup, &problem, &system, &mut damping)?;
        // From the state before the step. One step later it hardly differs, and no second factorisation is
        // needed.
        search.redundancy_used = redundancy_used(&system.information, &system.of_readings);
        let Some((next, converged)) = accepted else {
            search.termination = Termination::ReachedTolerance;
            break;
        };
        equations = next;
        // A stiff mesh that rests still moves when the stiffness decays.
        if converged && (stiffening < 1.0 || !search.priors.smooth.allows_rotations()) {
            search.termination = Termination::Converged;
            break;
        }
    }
    // The covariance needs the factors and the derivatives at the final state.
    if setup.is_last(step) {
        search.update_factors(&equations)?;
        search.complete_derivatives(&problem, &mut equations)?;
    }
    Ok((equations, weight))
}

/// Root mean square distance of the points that have an equation.
fn rms_of_points(equations: &[Equations]) -> Option<f64> {
    let of_points =
        (equations.iter().flat_map(|some| &some.list)).filter(|e| e.source == Source::Point && e.is_likely());
    let (squares, count) =
        of_points.fold((0.0, 0_usize), |(sum, n), e| (sum + e.distance * e.distance, n + 1));
    (count > 0).then(|| (squares / count as f64).sqrt())
}

/// True if a step of `length` (in σ) after one of `before` ends a stage: it is short, or all further ones add
/// up to little if each shrinks by the same ratio.
fn is_converged(length: f64, before: f64, coarse: bool) -> bool {
    let limit = if coarse { COARSE_CONVERGED_STEP } else { CONVERGED_STEP };
    // Linear convergence: the remaining way is `length · ratio/(1 − ratio)`, a geometric series.
    let ratio = length / before;
    length < limit || (ratio < 1.0 && before.is_finite() && length * ratio / (1.0 - ratio) < 0.5 * limit)
}

/// Factors of σ estimated from the residuals of each kind; `used` is the number of readings that the unknowns
/// use up. A kind with few residuals keeps its factor.
fn scales(equations: &[Equations], used: f64, before: [f64; SCALES]) -> Result<[f64; SCALES]> {
    let mut of_scale: [Vec<f64>; SCALES] = Default::default();
    for equation in equations.iter().flat_map(|some| &some.list) {
        let is_judged = !matches!(equation.source, Source::Region | Source::DistantLandmark);
        if is_judged && equation.is_likely() {
            of_scale[equation.source.scale()].push(equation.normalized());
        }
    }
    let count = of_scale.iter().map(Vec::len).sum::<usize>() as f64;
    // With few redundant readings the correction grows without bound, so it is limited to half of the
    // variance.
    let redundancy = (1.0 - used / count.max(1.0)).max(0.5);
    let mut factors = before;
    for (kind, (factor, residuals)) in factors.iter_mut().zip(of_scale).enumerate() {
        if residuals.len() >= MIN_SCALE_RESIDUALS {
            // Outliers are excluded by a gate, because their share would otherwise increase σ, which admits
            // more of them.
            let sigma = gated_scale(&residuals, SCALE_GATE)?.sigma / redundancy.sqrt();
            if sigma > 0.0 {
                // Few landmarks agree by chance better than their σ, and the mesh then follows them exactly.
                *factor = if kind == Source::Landmark.scale() { sigma.max(1.0) } else { sigma };
            }
        }
    }
    Ok(factors)
}

/// `tr(A⁻¹ N)`: the number of readings that the unknowns use up; zero if there are too many unknowns to
/// count.
fn redundancy_used(wanted: &DMatrix<f64>, information: &DMatrix<f64>) -> f64 {
    if wanted.nrows() > MAX_REDUNDANCY_UNKNOWNS {
        return 0.0;
    }
    Factor::new(wanted).map_or(0.0, |factor| factor.inverse().dot(information))
}

/// A damped step, shortened as a whole so that no parameter moves farther than `longest`.
fn bounded_step(
    equations: &DMatrix<f64>,
    damping: f64,
    right: &DVector<f64>,
    parameters: usize,
    longest: Option<f64>,
) -> Result<DVector<f64>> {
    let change = damped_step(equations, damping, right)?;
    // The whole step is shortened, so that its direction stays that of descent.
    let share = longest.map_or(1.0, |longest| longest / change.rows(0, parameters).amax().max(longest));
    Ok(change * share)
}

/// Solves `(N + μ diag N) x = b`.
fn damped_step(equations: &DMatrix<f64>, damping: f64, right: &DVector<f64>) -> Result<DVector<f64>> {
    let mut damped = equations.clone();
    let mean = equations.trace() / equations.nrows() as f64;
    for k in 0..damped.nrows() {
        // Relative to the diagonal, so that damping does not depend on units. The floor damps parameters
        // without information.
        let own = damped[(k, k)];
        damped[(k, k)] += damping * own.max(1e-12 * mean);
    }
    Ok(Factor::new(&damped).ok_or_else(undetermined)?.solve(right))
}
