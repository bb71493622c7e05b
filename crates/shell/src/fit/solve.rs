//! Levenberg and Marquardt's steps on the equations of a shell, from coarse fields to sharp ones; then the
//! covariance.
//!
//! Comes in: what is to be fitted, and who is told of every iteration. Goes out: a [`ShellFit`]. Unknowns are
//! the parameters, then six numbers for every pose that is uncertain.

use super::choice::chosen_points;
use super::dense::Factor;
use super::equations::{Equations, SCALES, Source, cost, sum};
use super::known::Known;
use super::outcome::finished;
use super::outward::outward;
use super::problem::{Problem, State, Weighing};
use super::readings::ShellReadings;
use super::smoothness::Smoothness;
use super::{ShellFit, ShellFitOptions, ShellProgress, undetermined};
use crate::deformation::{Deformation, displaced};
use crate::field::{Metaball, ShellOptions, subdivided};
use nalgebra::{DMatrix, DVector};
use planish_estimate::{Error, Result, Termination, gated_scale};
use planish_mesh::TriangleMesh;

/// Metaballs that give less than `exp(−9)` of the largest are left out: on a surface all of them together
/// give 0.1 %.
const REACH: f64 = 9.0;
/// Gate of the scale of residuals, in standard deviations.
const GATE: f64 = 3.0;
/// Damping is raised so often before an iteration is given up.
const TRIES: usize = 8;
/// Where a fit folds its mesh, smoothness weighs so many times more, again and again, up to this.
const HEAVIER: f64 = 4.0;
const HEAVIEST: f64 = 256.0;
/// A fit without folds may have residuals so many times larger.
const WORSE: f64 = 1.1;
/// How much stiffer a mesh is in the first iteration, and how much of that is left after each.
const STIFFER: f64 = 100.0;
const STIFF_LASTS: f64 = 0.75;
/// No control moves farther at once than this share of the mesh's size: equations are linear only near by.
const LONGEST: f64 = 0.03;
/// Residuals that a scale needs.
const LEAST_READINGS: usize = 8;
/// Of more unknowns no redundancy is counted: it costs as much as the fit.
const MOST_COUNTED: usize = 3000;
/// Points for each unknown, and in all, that a coarse field is fitted to at least: it only finds where the
/// sharp one starts.
const COARSE_POINTS: (usize, usize) = (12, 5000);
/// [`REACH`] of coarse fields. With more of a thin part's far side in the sum, and with fewer points, parts
/// that start far away are lost more often.
const COARSE_REACH: f64 = 4.0;
/// A step of so many σ, in the mean over the unknowns, is none.
const SETTLED: f64 = 0.1;
/// The same in a coarse field, which only finds where the next one starts.
const NEAR: f64 = 0.25;
/// One facet in so many may be turned the wrong way where outlines are fitted.
const TURNED: usize = 50;

/// Whether the facets of a mesh are turned the same way; an error where outlines need that and they are not.
fn is_oriented(mesh: &TriangleMesh, needed: bool) -> Result<bool> {
    let check = mesh.welded().check();
    if needed && check.misoriented_edges * TURNED > check.edges {
        return Err(Error::input(format!(
            "outlines need a mesh whose facets are all turned outwards, and at {} of its {} edges two facets are turned against each other: make normals consistent first",
            check.misoriented_edges, check.edges
        )));
    }
    Ok(check.misoriented_edges == 0 && (needed || check.watertight))
}

pub(super) fn solve(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    readings: &ShellReadings<'_>,
    options: &ShellFitOptions,
    watch: &mut dyn FnMut(ShellProgress) -> Result<()>,
) -> Result<ShellFit> {
    let parameters = deformation.parameters();
    let once = TriangleMesh { positions: mesh.positions.clone(), triangles: mesh.triangles_once() };
    let mesh = &once;
    let size = mesh.surface_bounds().map_or(0.0, |b| b.diagonal());
    let with_outlines = readings.views.iter().any(|view| !view.outline.is_empty());
    let turned = match with_outlines {
        true => Some(TriangleMesh { positions: mesh.positions.clone(), triangles: outward(mesh)? }),
        false => None,
    };
    let mesh = turned.as_ref().unwrap_or(mesh);
    let oriented = is_oriented(mesh, with_outlines)?;
    let middle = mesh.surface_bounds().map_or([0.0; 3], |b| b.center());
    for (v, view) in readings.views.iter().enumerate() {
        if view.camera.project(middle).is_none() {
            return Err(Error::input(format!(
                "view {v}: the mesh lies behind the camera: its pose, or the sign of its projection matrix, is another"
            )));
        }
    }
    let mut slots = vec![None; readings.views.len()];
    let mut poses = Vec::new();
    for (v, view) in readings.views.iter().enumerate() {
        if let Some(noise) = view.pose {
            slots[v] = Some(poses.len() as u32);
            poses.push((v, noise));
        }
    }
    let stiffness = (options.stiffness.clone()).unwrap_or_else(|| DMatrix::zeros(parameters, parameters));
    let start = match (&options.start, &options.prior) {
        (Some(start), _) => start.clone(),
        (None, Some(prior)) => prior.mean.clone(),
        (None, None) => DVector::zeros(parameters),
    };
    let mut known =
        Known { smooth: Smoothness::new(stiffness, options.start_sigma)?, options, start, poses, readings };
    let mut state =
        State { q: known.start.clone(), cameras: readings.views.iter().map(|view| view.camera).collect() };
    let mut factors = [1.0; SCALES];
    let mut used = 0.0;
    let mut iterations = 0;
    let mut termination = Termination::Limit;
    let mut last: Option<(Vec<Equations>, f64)> = None;
    // Parameters that are no displacements have other units.
    let longest = deformation.controls().map(|_| LONGEST * size);
    let (first, finest) = options.softness;
    let bounds = mesh.surface_bounds().ok_or_else(|| Error::input("a mesh without vertices"))?;
    let enough = (COARSE_POINTS.0 * (parameters + 6 * known.poses.len())).max(COARSE_POINTS.1);
    let few = chosen_points(readings.points, enough, &bounds);
    let all = chosen_points(readings.points, usize::MAX, &bounds);
    // Where the controls lack something, folds make up for it: smoothness counts for more until none is left,
    // if that costs little. What the data show to the last σ may fold, and what outlines alone draw has more
    // faults than folds.
    let mut heavier = 1.0;
    // The weight by likelihood: σ is by this one, as to be held is not to be known.
    let mut likely = None;
    let mut folded: Option<(ShellFit, f64)> = None;
    let mut step = 0;
    while step < options.steps {
        let coarse = step + 1 < options.steps;
        let share = if options.steps > 1 { step as f64 / (options.steps - 1) as f64 } else { 1.0 };
        let softness = size * first * (finest / first).powf(share);
        let fine = match options.metaball {
            Metaball::Triangular => None,
            Metaball::Spherical => Some(subdivided(mesh, 1.5 * softness, options.most_facets)),
        };
        let problem = Problem {
            mesh,
            origins: fine.as_ref().map(|(_, origins)| &origins[..]),
            triangles: fine.as_ref().map_or(&mesh.triangles, |(fine, _)| &fine.triangles),
            deformation,
            readings,
            shell: ShellOptions {
                reach: Some(if coarse { COARSE_REACH } else { REACH }),
                oriented,
                ..ShellOptions::new(options.metaball, 1.0 / softness)
            },
            slots: &slots,
            chosen: if coarse { &few } else { &all },
            by_sheets: !coarse,
        };
        let mut damping = 1e-3;
        termination = Termination::Limit;
        let first = Weighing { loss: &options.loss, factors };
        // Derivatives that were left out are asked for again, by the factors that now hold.
        let again = |factors| {
            let loss = &options.loss;
            problem.by_sheets.then_some(Weighing { loss, factors })
        };
        let mut equations = problem.equations(&state, (step > 0 || problem.by_sheets).then_some(first))?;
        let mut weight = 0.0;
        let mut length_before = f64::INFINITY;
        for k in 0..options.iterations {
            watch(ShellProgress {
                share: (step as f64 + k as f64 / options.iterations as f64) / options.steps as f64,
                iteration: iterations,
                rms_points: rms_of_points(&equations),
            })?;
            iterations += 1;
            if !options.believe_sigma {
                // While the mesh is far away, residuals are shape; σ falls to that of the noise as it comes
                // near.
                factors = scales(&equations, used, factors)?;
            }
            if Equations::lack_derivatives(&equations, &options.loss, &factors) {
                equations = problem.equations(&state, again(factors))?;
            }
            let weighing = Weighing { loss: &options.loss, factors };
            let pass = sum(
                &equations,
                deformation,
                known.poses.len(),
                &options.loss,
                (&factors, &[1.0; SCALES]),
                true,
            );
            let alone = known.without_poses(&state, &pass)?;
            weight = (known.smooth).weight(&alone.information, &alone.vector, &(&state.q - &known.start))?;
            weight *= heavier;
            if step == 0 && options.start_sigma.is_none() {
                // From far away a mesh comes stiff first: what pulls at it is not yet where it belongs.
                weight *= 1.0 + STIFFER * STIFF_LASTS.powi(iterations as i32);
            }
            let (wanted, slope) = known.add(&state, weight, &pass);
            let before = cost(&equations, &options.loss, &factors) + known.cost(&state, weight);
            let mut accepted = None;
            let mut shorter = false;
            for _ in 0..TRIES {
                let change = bounded_step(&wanted, damping, &slope, parameters, longest)?;
                let next = known.moved(&state, &change);
                let tried = problem.equations(&next, Some(weighing))?;
                let after = cost(&tried, &options.loss, &factors) + known.cost(&next, weight);
                if after <= before * (1.0 + 1e-12) {
                    let length = (change.dot(&(&wanted * &change)) / change.len() as f64).sqrt();
                    shorter = is_settled(length, length_before, coarse) || before - after < 1e-6 * before;
                    length_before = length;
                    accepted = Some((next, tried));
                    damping = (damping * 0.1).max(1e-9);
                    break;
                }
                damping = (damping * 10.0).max(1e-6);
            }
            used = redundancy_used(&wanted, &pass.information);
            let Some((next, tried)) = accepted else {
                termination = Termination::ReachedTolerance;
                break;
            };
            state = next;
            equations = tried;
            if shorter {
                termination = Termination::Converged;
                break;
            }
        }
        if step + 1 == options.steps && !options.believe_sigma {
            factors = scales(&equations, used, factors)?;
            if Equations::lack_derivatives(&equations, &options.loss, &factors) {
                equations = problem.equations(&state, again(factors))?;
            }
        }
        let may_be_heavier = weight > 0.0 && options.prior.is_none() && heavier < HEAVIEST;
        if step + 1 == options.steps && may_be_heavier && !readings.points.is_empty() {
            let folds = mesh.distortion(&displaced(&mesh.positions, deformation, &state.q)).folds > 0;
            let rms = rms_normalized(&equations);
            let good = folded.as_ref().is_none_or(|before| rms < WORSE * before.1);
            if folds && good {
                if folded.is_none() {
                    let made =
                        finished(mesh, deformation, &known, state.clone(), &equations, &factors, weight)?;
                    if made.lack_of_fit > 0.0 {
                        likely = Some(weight);
                        folded = Some((made, rms));
                    }
                }
                if folded.is_some() {
                    heavier *= HEAVIER;
                    continue;
                }
            } else if good {
                folded = None;
            }
        }
        last = Some((equations, weight));
        step += 1;
    }
    if let Some((made, _)) = folded {
        return Ok(ShellFit { termination, iterations, ..made });
    }
    let (equations, weight) =
        last.ok_or_else(|| Error::input("a fit needs at least one step of sharpness"))?;
    let weight = likely.unwrap_or(weight);
    finished(mesh, deformation, &known, state, &equations, &factors, weight).map(|made| ShellFit {
        termination,
        iterations,
        ..made
    })
}

/// Root mean square of residuals over what was stated, of readings that may be of the mesh.
fn rms_normalized(equations: &[Equations]) -> f64 {
    let of_readings = (equations.iter().flat_map(|some| &some.list))
        .filter(|e| e.source != Source::Region && e.is_likely());
    let (squares, count) =
        of_readings.fold((0.0, 0_usize), |(sum, n), e| (sum + e.normalized().powi(2), n + 1));
    (squares / count.max(1) as f64).sqrt()
}

/// Root mean square distance of the points that have an equation.
fn rms_of_points(equations: &[Equations]) -> Option<f64> {
    let of_points =
        (equations.iter().flat_map(|some| &some.list)).filter(|e| e.source == Source::Point && e.is_likely());
    let (squares, count) =
        of_points.fold((0.0, 0_usize), |(sum, n), e| (sum + e.distance * e.distance, n + 1));
    (count > 0).then(|| (squares / count as f64).sqrt())
}

/// Whether a step of so many σ after another is as good as the last: it is short, or those that follow are,
/// if each shrinks as this one did.
fn is_settled(length: f64, before: f64, coarse: bool) -> bool {
    let limit = if coarse { NEAR } else { SETTLED };
    let ratio = length / before;
    length < limit || (ratio < 1.0 && before.is_finite() && length * ratio / (1.0 - ratio) < 0.5 * limit)
}

/// Factors of σ by the residuals of each kind; `used` is how many readings the unknowns take up.
fn scales(equations: &[Equations], used: f64, before: [f64; SCALES]) -> Result<[f64; SCALES]> {
    let mut of_scale: [Vec<f64>; SCALES] = Default::default();
    for equation in equations.iter().flat_map(|some| &some.list) {
        if equation.source != Source::Region && equation.is_likely() {
            of_scale[equation.source.scale()].push(equation.normalized());
        }
    }
    let count = of_scale.iter().map(Vec::len).sum::<usize>() as f64;
    // Of fewer readings than unknowns nothing is left to tell σ by: at most half of the variance is taken for
    // redundancy that is missing.
    let redundancy = (1.0 - used / count.max(1.0)).max(0.5);
    let mut factors = before;
    for (factor, residuals) in factors.iter_mut().zip(of_scale) {
        if residuals.len() >= LEAST_READINGS {
            let sigma = gated_scale(&residuals, GATE)?.sigma / redundancy.sqrt();
            if sigma > 0.0 {
                *factor = sigma;
            }
        }
    }
    Ok(factors)
}

/// `tr(A⁻¹ N)`: how many readings the unknowns take up.
fn redundancy_used(wanted: &DMatrix<f64>, information: &DMatrix<f64>) -> f64 {
    if wanted.nrows() > MOST_COUNTED {
        return 0.0;
    }
    Factor::of(wanted).map_or(0.0, |factor| factor.inverse().dot(information))
}

/// A step that is shortened where a parameter would move farther than stated.
fn bounded_step(
    equations: &DMatrix<f64>,
    damping: f64,
    right: &DVector<f64>,
    parameters: usize,
    longest: Option<f64>,
) -> Result<DVector<f64>> {
    let change = damped_step(equations, damping, right)?;
    let share = longest.map_or(1.0, |longest| longest / change.rows(0, parameters).amax().max(longest));
    Ok(change * share)
}

/// `(N + μ diag N) x = b`.
fn damped_step(equations: &DMatrix<f64>, damping: f64, right: &DVector<f64>) -> Result<DVector<f64>> {
    let mut damped = equations.clone();
    let mean = equations.trace() / equations.nrows() as f64;
    for k in 0..damped.nrows() {
        let own = damped[(k, k)];
        damped[(k, k)] += damping * own.max(1e-12 * mean);
    }
    Ok(Factor::of(&damped).ok_or_else(undetermined)?.solve(right))
}
