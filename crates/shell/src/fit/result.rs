//! The result of a fit: the covariance, and the residuals and outliers of each kind of readings.
//!
//! In: the equations after the last iteration. Out: a [`ShellFit`].

use super::correlation::{Residual, ResidualCorrelation};
use super::equations::{ByVertex, Equation, Equations, NormalEquations, SCALES, Source, sum};
use super::interpolation::{CloserControls, FitSmoothness, noise_vectors};
use super::priors::Priors;
use super::problem::State;
use super::readings::LandmarkReading;
use super::residual_leverage::{Signs, leverage_of_signs};
use super::roundness::{Roundness, roundness};
use super::strain::strained_share;
use super::support::{PointFoot, Support, support, unfollowed};
use super::weight_spread::WeighedSmoothness;
use super::{ShellFit, SourceFit, undetermined};
use crate::deformation::{Deformation, displaced_positions};
use nalgebra::{DMatrix, DVector};
use planish_core::DVec3;
use planish_estimate::{Loss, LossMoments, Result, Termination};
use planish_mesh::{MeshSearch, TriangleMesh};

/// Weight of the loss below which a reading is reported as an outlier: for Tukey's loss, a residual of
/// 4.1 σ.
const OUTLIER_WEIGHT: f64 = 0.05;

/// Computes the covariance and the statistics of the readings.
pub(super) fn finished(
    mesh: &TriangleMesh,
    full_deformation: &dyn Deformation,
    priors: &Priors<'_>,
    mut state: State,
    equations: &[Equations],
    factors: &[f64; SCALES],
    weight: f64,
) -> Result<ShellFit> {
    let initial = displaced_positions(&mesh.positions, full_deformation, &DVector::zeros(state.q.len()));
    let linear = full_deformation.linearised_at(&state.q);
    let deformation = linear.as_deref().unwrap_or(full_deformation);
    let loss = &priors.options.loss;
    let poses = priors.poses.len();
    let parameters = state.q.len();
    let moments = loss.moments(1)?;
    let mut alone = sum(equations, deformation, poses, loss, (factors, &[1.0; SCALES]), false);
    alone.information *= moments.slope / moments.weight;
    let (with_priors, _) = priors.add(&state, weight, &alone);
    let smoothness = WeighedSmoothness::new(priors, &state, weight, &alone);
    let scale = moments.slope / moments.weight;
    let rounded = rounded(mesh, full_deformation, priors, &state, equations, factors, (&with_priors, scale))?;
    let (round, equations) = match &rounded {
        Some((round, corrected)) => {
            state = priors.moved(&state, &(round.found.share * &round.change));
            (Some(round), &corrected[..])
        }
        None => (None, equations),
    };
    let positions = displaced_positions(&mesh.positions, full_deformation, &state.q);
    let strained_share = strained_share(mesh, &initial, &positions);
    let counts = |e: &Equation| {
        e.source != Source::Region
            && e.is_likely()
            && e.source.loss(loss).weight(e.normalized() / factors[e.source.scale()]) >= OUTLIER_WEIGHT
    };
    // The correlation is found from the residuals first; the information then counts correlated readings as
    // fewer.
    let left = leverage_of_signs(equations, deformation, (&with_priors, moments.slope), factors, counts)?;
    let misfits = misfits(equations, &left, priors, counts);
    let together = misfits.map(|misfit| misfit.together);
    let pass = robust_sum(equations, deformation, poses, (loss, &moments), (factors, &together));
    let mut of_data = priors.without_poses(&state, &pass)?;
    // Correlated readings count less here than in the estimate of the share.
    let relative = moments.slope / (moments.influence_squared * together[Source::Point.scale()]);
    if let Some(round) = round {
        round.marginalise(relative, &mut of_data.information, &mut of_data.vector);
    }
    let data_vector = &of_data.information * &state.q + of_data.vector;
    let (without_smoothness, _) = priors.add(&state, 0.0, &pass);
    let mut covariance = smoothness.covariance(&without_smoothness).ok_or_else(undetermined)?;
    if let Some(Roundness { found, change, .. }) = round {
        covariance.ger(found.sigma.powi(2), change, change, 1.0);
    }
    let shape = ResidualCorrelation::sigma(&misfits);
    let readings = priors.readings;
    let around = match readings.points.is_empty() {
        true => Support::default(),
        false => {
            let found = TriangleMesh { positions: positions.clone(), triangles: mesh.triangles.clone() };
            let mut feet = point_feet(equations, priors, counts);
            feet.extend(unfollowed_feet(&found, equations, priors, factors)?);
            let errors = interpolation_errors(
                (mesh, &found),
                full_deformation,
                priors,
                equations,
                (&left, factors),
                weight,
                counts,
            )?;
            support(&found, &feet, shape)?.with_errors(&errors)
        }
    };
    let outlines = readings.views.iter().map(|view| view.outline.len()).sum();
    let fit_of = |source: Source, count: usize| source_fit(equations, source, count, factors, priors);
    Ok(ShellFit {
        positions,
        covariance: covariance.view((0, 0), (parameters, parameters)).into_owned(),
        points: fit_of(Source::Point, readings.points.len()),
        outlines: fit_of(Source::Outline, outlines),
        tracks: fit_of(Source::Track, readings.tracks.len()),
        landmarks: fit_of(Source::Landmark, readings.landmarks.len()),
        pose_covariances: pose_covariances(&covariance, priors, &state),
        parameters: state.q,
        cameras: state.cameras,
        smoothness_weight: weight,
        unresolved_shape: shape,
        facet_roundness: round.map(|round| round.found),
        unresolved_at: around.shape,
        support: around.of_vertices,
        unfollowed_points: around.unfollowed,
        strained_share,
        residuals_at: around.residuals,
        data_vector,
        data_information: of_data.information,
        termination: Termination::Limit,
        iterations: 0,
    })
}

/// The sum of equations of an M-estimate: its information is E[ψ']²/E[ψ²] times that of unweighted equations,
/// and the weights have already multiplied that by their mean.
fn robust_sum(
    equations: &[Equations],
    deformation: &dyn Deformation,
    poses: usize,
    (loss, moments): (&Loss, &LossMoments),
    scales: (&[f64; SCALES], &[f64; SCALES]),
) -> NormalEquations {
    let mut pass = sum(equations, deformation, poses, loss, scales, false);
    let share = moments.slope * moments.slope / (moments.influence_squared * moments.weight);
    pass.information *= share;
    pass.vector *= share;
    pass
}

/// The covariance of each camera's pose; none for known poses.
fn pose_covariances(
    covariance: &DMatrix<f64>,
    priors: &Priors<'_>,
    state: &State,
) -> Vec<Option<DMatrix<f64>>> {
    let mut found = vec![None; state.cameras.len()];
    for (slot, (view, _)) in priors.poses.iter().enumerate() {
        let at = state.q.len() + 6 * slot;
        found[*view] = Some(covariance.view((at, at), (6, 6)).into_owned());
    }
    found
}

/// The roundness of the facets, and the equations corrected for it; none without points.
fn rounded(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    priors: &Priors<'_>,
    state: &State,
    equations: &[Equations],
    factors: &[f64; SCALES],
    information: (&DMatrix<f64>, f64),
) -> Result<Option<(Roundness, Vec<Equations>)>> {
    if priors.readings.points.is_empty() {
        return Ok(None);
    }
    let found = TriangleMesh {
        positions: displaced_positions(&mesh.positions, deformation, &state.q),
        triangles: mesh.triangles.clone(),
    };
    let foot_of = |e: &Equation, by_vertices: &[ByVertex]| {
        foot(priors.readings.points[e.reading as usize].at, e.distance, by_vertices)
    };
    let linear = deformation.linearised_at(&state.q);
    let rows = linear.as_deref().unwrap_or(deformation);
    let scale = (&priors.options.loss, factors);
    let (made, changes) = roundness(&found, equations, rows, information, scale, foot_of)?;
    let corrected =
        (equations.iter().zip(&changes)).map(|(e, by)| e.corrected(made.found.share, by)).collect();
    Ok(Some((made, corrected)))
}

/// The error of interpolation at each vertex of a mesh, given at rest and as fitted; empty for parameters
/// that are no displacements of controls.
fn interpolation_errors(
    (mesh, found): (&TriangleMesh, &TriangleMesh),
    deformation: &dyn Deformation,
    priors: &Priors<'_>,
    equations: &[Equations],
    (left, factors): (&[Signs], &[f64; SCALES]),
    weight: f64,
    counts: impl Fn(&Equation) -> bool,
) -> Result<Vec<f64>> {
    let controls = deformation.controls().filter(|points| 3 * points.len() == deformation.parameters());
    let closer = match controls {
        Some(controls) => CloserControls::new(mesh, controls)?,
        None => None,
    };
    let Some(closer) = closer else { return Ok(Vec::new()) };
    let (loss, poses) = (&priors.options.loss, priors.poses.len());
    let mut pass = sum(equations, &closer.deformation, poses, loss, (factors, &[1.0; SCALES]), false);
    let moments = loss.moments(1)?;
    pass.information *= moments.slope / moments.weight;
    let scale = (factors, poses, moments.influence_squared.sqrt());
    let noise = noise_vectors(equations, left, &closer.deformation, scale, counts);
    let start = displaced_positions(&mesh.positions, deformation, &priors.start);
    let allows_rotations = priors.smooth.allows_rotations();
    closer.changes(found, &start, &pass, &noise, FitSmoothness { weight, allows_rotations })
}

/// The correlation of the residuals of points and of outlines.
fn misfits(
    equations: &[Equations],
    left: &[Signs],
    priors: &Priors<'_>,
    counts: impl Fn(&Equation) -> bool,
) -> [ResidualCorrelation; SCALES] {
    let readings = priors.readings;
    // The third coordinate keeps views apart, so that only pixels of one view are neighbours.
    let pixels: Vec<DVec3> = (readings.views.iter().enumerate())
        .flat_map(|(v, view)| {
            (view.outline.iter()).map(move |place| DVec3::new(place.pixel[0], place.pixel[1], 1e6 * v as f64))
        })
        .collect();
    let mut all = [ResidualCorrelation::NONE; SCALES];
    for source in [Source::Point, Source::Outline] {
        let residuals: Vec<Residual> = (equations.iter().flat_map(Equations::iter))
            .zip(left)
            .filter(|((e, ..), _)| e.source == source && counts(e))
            .map(|((e, by_vertices, _), [signs, left])| Residual {
                at: match source {
                    Source::Point => foot(readings.points[e.reading as usize].at, e.distance, by_vertices),
                    _ => pixels[e.reading as usize],
                },
                distance: e.distance,
                sigma: e.sigma,
                signs: *signs,
                left: *left,
            })
            .collect();
        all[source.scale()] = ResidualCorrelation::from_residuals(&residuals);
    }
    all
}

/// Feet and residuals of the points that count.
fn point_feet(
    equations: &[Equations],
    priors: &Priors<'_>,
    counts: impl Fn(&Equation) -> bool,
) -> Vec<PointFoot> {
    (equations.iter().flat_map(Equations::iter))
        .filter(|(e, ..)| e.source == Source::Point && counts(e))
        .map(|(e, by_vertices, _)| {
            let point = priors.readings.points[e.reading as usize].at;
            PointFoot {
                at: foot(point, e.distance, by_vertices),
                residual: e.distance,
                sigma: e.sigma,
                follows: true,
            }
        })
        .collect()
}

/// Feet of the points that the fit rejected although they agree with their neighbours.
fn unfollowed_feet(
    found: &TriangleMesh,
    equations: &[Equations],
    priors: &Priors<'_>,
    factors: &[f64; SCALES],
) -> Result<Vec<PointFoot>> {
    let points = priors.readings.points;
    let places: Vec<DVec3> = points.iter().map(|p| p.at).collect();
    let sigmas: Vec<f64> = points.iter().map(|p| (p.covariance.trace() / 3.0).sqrt()).collect();
    let rejected = source_fit(equations, Source::Point, points.len(), factors, priors).outliers;
    let search = MeshSearch::try_new(found)?;
    let feet = unfollowed(&places, &sigmas, &rejected)?.into_iter().filter_map(|i| {
        let foot = search.closest(places[i as usize])?;
        Some(PointFoot { at: foot.point, residual: foot.distance, sigma: sigmas[i as usize], follows: false })
    });
    Ok(feet.collect())
}

/// The foot point of a point on the mesh. A height is invariant under a common translation, so `∇h = −Σ
/// ∂h/∂V_j`, and the foot is `x − h ∇h/|∇h|²`.
///
/// Neighbours are found by foot points, not by the points themselves. Nearest points in space tend to have
/// the same height over the mesh, which correlates their noise.
fn foot(at: DVec3, height: f64, by_vertices: &[ByVertex]) -> DVec3 {
    let against = (by_vertices.iter()).fold(DVec3::ZERO, |sum, (_, by)| sum + *by);
    let square = against.length_squared();
    if square > 0.0 { at + height / square * against } else { at }
}

fn source_fit(
    equations: &[Equations],
    source: Source,
    count: usize,
    factors: &[f64; SCALES],
    priors: &Priors<'_>,
) -> SourceFit {
    let units: Vec<f64> = match source {
        Source::Outline => (priors.readings.views.iter())
            .flat_map(|view| view.outline.iter().map(|place| place.sigma_px))
            .collect(),
        Source::Landmark => priors.readings.landmarks.iter().map(LandmarkReading::sigma).collect(),
        _ => Vec::new(),
    };
    let factor = factors[source.scale()];
    let mut outliers = vec![true; count];
    let (mut squares, mut kept) = (0.0, 0_usize);
    for equation in equations.iter().flat_map(|some| &some.list).filter(|e| e.source == source) {
        let reading = equation.reading as usize;
        if priors.options.loss.weight(equation.normalized() / factor) < OUTLIER_WEIGHT {
            continue;
        }
        outliers[reading] = false;
        if !equation.is_likely() {
            continue;
        }
        let residual = match source {
            Source::Point => equation.distance,
            Source::Outline | Source::Landmark => equation.normalized() * units[reading],
            _ => equation.normalized(),
        };
        squares += residual * residual;
        kept += 1;
    }
    if source == Source::Landmark {
        // A landmark is an outlier if any of its coordinates is.
        for e in equations.iter().flat_map(|some| &some.list).filter(|e| e.source == source) {
            outliers[e.reading as usize] |=
                priors.options.loss.weight(e.normalized() / factor) < OUTLIER_WEIGHT;
        }
    }
    SourceFit { sigma_factor: factor, rms: (squares / kept.max(1) as f64).sqrt(), outliers }
}
