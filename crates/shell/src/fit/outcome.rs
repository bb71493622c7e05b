//! What came of a fit: the covariance, and what became of the readings.
//!
//! Comes in: the equations at the end of the last iteration. Goes out: a [`ShellFit`].

use super::dense::Factor;
use super::equations::{Equations, SCALES, Source, sum};
use super::known::Known;
use super::misfit::{Misfit, Residual};
use super::problem::State;
use super::{ShellFit, SourceFit, undetermined};
use crate::deformation::{Deformation, displaced};
use planish_estimate::{Result, Termination};
use planish_mesh::TriangleMesh;

/// A weight below which a reading is a gross error.
const NOTHING: f64 = 0.05;

/// The covariance, and what became of the readings.
pub(super) fn finished(
    mesh: &TriangleMesh,
    deformation: &dyn Deformation,
    known: &Known<'_>,
    state: State,
    equations: &[Equations],
    factors: &[f64; SCALES],
    weight: f64,
) -> Result<ShellFit> {
    let loss = &known.options.loss;
    let poses = known.poses.len();
    let parameters = state.q.len();
    let misfits = misfits(equations, factors, known);
    let together = misfits.map(|misfit| misfit.together);
    let mut pass = sum(equations, deformation, poses, loss, (factors, &together), false);
    // Reweighted equations are mean-weight times those of the data; an M-estimate's covariance is ψ²/ψ'² of these.
    let moments = loss.moments(1)?;
    pass.information *= moments.slope * moments.slope / (moments.influence_squared * moments.weight);
    let data_information = known.without_poses(&state, &pass)?.information;
    let (information, _) = known.add(&state, weight, &pass);
    let covariance = Factor::of(&information).ok_or_else(undetermined)?.inverse();
    let mut pose_covariances = vec![None; state.cameras.len()];
    for (slot, (view, _)) in known.poses.iter().enumerate() {
        let at = parameters + 6 * slot;
        pose_covariances[*view] = Some(covariance.view((at, at), (6, 6)).into_owned());
    }
    let readings = known.readings;
    let outlines = readings.views.iter().map(|view| view.outline.len()).sum();
    let of = |source: Source, count: usize| source_fit(equations, source, count, factors, known);
    Ok(ShellFit {
        positions: displaced(&mesh.positions, deformation, &state.q),
        covariance: covariance.view((0, 0), (parameters, parameters)).into_owned(),
        points: of(Source::Point, readings.points.len()),
        outlines: of(Source::Outline, outlines),
        tracks: of(Source::Track, readings.tracks.len()),
        parameters: state.q,
        cameras: state.cameras,
        pose_covariances,
        smoothness_weight: weight,
        lack_of_fit: Misfit::sigma(&misfits),
        data_information,
        termination: Termination::Limit,
        iterations: 0,
    })
}

/// What residuals of points and of outlines have in common.
fn misfits(equations: &[Equations], factors: &[f64; SCALES], known: &Known<'_>) -> [Misfit; SCALES] {
    let readings = known.readings;
    // Pixels of one view lie in a plane, and views far from one another.
    let pixels: Vec<[f64; 3]> = (readings.views.iter().enumerate())
        .flat_map(|(v, view)| (view.outline.iter()).map(move |place| [place.pixel[0], place.pixel[1], 1e6 * v as f64]))
        .collect();
    let of = |source: Source| {
        let factor = factors[source.scale()];
        let residuals: Vec<Residual> = (equations.iter().flat_map(|some| &some.list))
            .filter(|e| {
                e.source == source && e.is_likely() && known.options.loss.weight(e.normalized() / factor) >= NOTHING
            })
            .map(|e| Residual {
                at: match source {
                    Source::Point => readings.points[e.reading as usize].at,
                    _ => pixels[e.reading as usize],
                },
                distance: e.distance,
                sigma: e.sigma,
            })
            .collect();
        Misfit::of(&residuals)
    };
    let mut all = [Misfit::NONE; SCALES];
    for source in [Source::Point, Source::Outline] {
        all[source.scale()] = of(source);
    }
    all
}

fn source_fit(
    equations: &[Equations],
    source: Source,
    count: usize,
    factors: &[f64; SCALES],
    known: &Known<'_>,
) -> SourceFit {
    let sigmas_px: Vec<f64> = match source {
        Source::Outline => (known.readings.views.iter())
            .flat_map(|view| view.outline.iter().map(|place| place.sigma_px))
            .collect(),
        _ => Vec::new(),
    };
    let factor = factors[source.scale()];
    let mut outliers = vec![true; count];
    let (mut squares, mut kept) = (0.0, 0_usize);
    for equation in equations
        .iter()
        .flat_map(|some| &some.list)
        .filter(|e| e.source == source)
    {
        let reading = equation.reading as usize;
        if known.options.loss.weight(equation.normalized() / factor) < NOTHING {
            continue;
        }
        outliers[reading] = false;
        if !equation.is_likely() {
            continue;
        }
        let residual = match source {
            Source::Point => equation.distance,
            Source::Outline => equation.normalized() * sigmas_px[reading],
            _ => equation.normalized(),
        };
        squares += residual * residual;
        kept += 1;
    }
    SourceFit {
        sigma_factor: factor,
        rms: (squares / kept.max(1) as f64).sqrt(),
        outliers,
    }
}
