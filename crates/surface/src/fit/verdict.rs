//! The verdict on a first fit, from data that did not inflate their own σ.
//!
//! Input: a converged surface with its readings. Output: a [`FitVerdict`] with the places that the surface
//! does not follow, or a refusal. See decision 0101.

use super::enclosed::{EnclosedTopology, enclosed_topology};
use super::surface_misfit::{SurfaceMisfit, UnresolvedPlace, surface_misfit};
use crate::observe::{Observations, ProjectedReadings};
use planish_core::numbers::significant;
use planish_core::{DVec3, Finding, FindingCode, Setting};
use planish_estimate::{Error, Result};
use planish_spline::Shape;
use serde::Serialize;

/// Largest share of the measured area that may be unresolved in a result; with a topology that the surface
/// cannot have, a tenth of it.
const MAX_UNRESOLVED: f64 = 0.05;
const MAX_UNRESOLVED_OF_OTHER_TOPOLOGY: f64 = 0.005;
/// Places that a report lists.
const MAX_PLACES: usize = 20;
/// Readings from which the enclosed solid is found.
const TOPOLOGY_SAMPLE: usize = 30_000;

/// Whether a surface can be trusted where its readings are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FitVerdict {
    /// The surface follows its readings everywhere.
    #[default]
    Converged,
    /// A small share of the measured area is not followed; it is marked as such.
    Unresolved,
    /// Too much is not followed; the result exists only because it was asked for in spite of that.
    Refused,
}

/// The verdict with its reasons.
#[derive(Debug, Clone, Default)]
pub(super) struct Verdict {
    pub verdict: FitVerdict,
    pub misfit: SurfaceMisfit,
    pub finding: Option<Finding>,
}

impl Verdict {
    /// The largest places, for reports.
    pub(super) fn listed_places(&self) -> Vec<UnresolvedPlace> {
        self.misfit.places.iter().take(MAX_PLACES).copied().collect()
    }
}

/// What the verdict depends on besides the readings.
#[derive(Clone, Copy)]
pub(super) struct VerdictInput {
    pub shape: Shape,
    pub gate: f64,
    /// Keep a surface that would be refused.
    pub force: bool,
    /// World coordinates of the origin.
    pub origin: DVec3,
}

/// Judges a first fit.
///
/// # Errors
/// `Undetermined` if the surface does not follow more than 5 % of the measured area, or 0.5 % if the readings
/// enclose a solid of another topology, unless `force` is set.
pub(super) fn judge_surface(readings: ProjectedReadings<'_>, input: VerdictInput) -> Result<Verdict> {
    let misfit = surface_misfit(readings, input.gate, input.origin)?;
    let Some(largest) = misfit.places.first() else {
        return Ok(Verdict::default());
    };
    let enclosed = (input.shape == Shape::Ball && misfit.area_fraction > MAX_UNRESOLVED_OF_OTHER_TOPOLOGY)
        .then(|| topology_of(readings.observations));
    let is_other = enclosed.is_some_and(|found| found.bodies > 1 || found.handles > 0);
    let allowed = if is_other { MAX_UNRESOLVED_OF_OTHER_TOPOLOGY } else { MAX_UNRESOLVED };
    let refused = misfit.area_fraction > allowed;
    let text = format!(
        "the surface does not follow the readings on {} of the measured area, most of it around ({}) over a \
         length of {}: {}",
        percent(misfit.area_fraction),
        largest.centre.map(|c| significant(c, 4)).join(", "),
        significant(largest.size, 2),
        reason(input.shape, enclosed)
    );
    if refused && !input.force {
        let text = format!("{text}; a result can be forced, but is wrong there");
        return Err(Error::undetermined(text).with_setting(Setting::Force));
    }
    let (verdict, code) = if refused {
        (FitVerdict::Refused, FindingCode::SurfaceRefused)
    } else {
        (FitVerdict::Unresolved, FindingCode::SurfaceMisfit)
    };
    Ok(Verdict { verdict, misfit, finding: Some(Finding::new(code, text)) })
}

/// Why a surface does not follow its readings, as far as the readings show it.
fn reason(shape: Shape, enclosed: Option<EnclosedTopology>) -> String {
    let several = |count: usize, one: &str, many: &str| {
        if count == 1 { format!("1 {one}") } else { format!("{count} {many}") }
    };
    match enclosed {
        Some(EnclosedTopology { bodies, .. }) if bodies > 1 => format!(
            "the readings show {bodies} separate bodies, and a {} is one: fit each body alone",
            shape.name()
        ),
        Some(EnclosedTopology { handles, .. }) if handles > 0 => format!(
            "the object has {}, which a {} cannot have",
            several(handles, "hole through it or handle", "holes through it or handles"),
            shape.name()
        ),
        _ => format!(
            "there is an edge, a hole, a thin part or another feature that a smooth {} of this resolution \
             does not have",
            shape.name()
        ),
    }
}

/// A share as a percentage with two digits.
fn percent(share: f64) -> String {
    format!("{} %", significant(100.0 * share, 2))
}

/// The topology of the solid that the readings on a surface enclose.
fn topology_of(observations: &Observations) -> EnclosedTopology {
    let readings = &observations.readings;
    let on: Vec<usize> = (0..readings.len())
        .filter(|&i| readings.on_surface[i] && readings.normal(i) != DVec3::ZERO)
        .collect();
    let step = on.len().div_ceil(TOPOLOGY_SAMPLE).max(1);
    let (points, normals): (Vec<_>, Vec<_>) =
        on.iter().step_by(step).map(|&i| (readings.points[i], readings.normal(i))).unzip();
    if points.is_empty() {
        EnclosedTopology { bodies: 1, handles: 0 }
    } else {
        enclosed_topology(&points, &normals)
    }
}
