//! The states of a sheet that bends without stretch, and what a fit says of them.

use super::motion::scans_in_time;
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use serde::Serialize;

/// A sheet's bending.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BendingReport {
    /// σ of a length along the sheet, as a share of it: how much sheets are taken to stretch.
    pub sigma_stretch: f64,
    /// Whether every state is one of the same sheet, bent and not stretched.
    pub isometric: bool,
    /// How often the cells of the first state were divided so that they could follow the bending of the
    /// others.
    pub divisions: usize,
    /// State by state, in the order of time.
    pub states: Vec<BendingState>,
}

/// A sheet at one time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BendingState {
    /// The scans that were taken then.
    pub scans: Vec<String>,
    /// When, in seconds, where the scans say so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Readings used.
    pub observations: usize,
    /// Root mean square of their residuals along the normals.
    pub rms: f64,
    /// σ of the readings, as stated, or as the first state's residuals say where that is not stated.
    pub sigma: f64,
    /// The one over the other: 1 where the bent sheet goes through its readings as well as their noise lets
    /// it.
    pub misfit: f64,
    /// Mean size of the relative changes of E, F and G since the first state, that of F over √(EG).
    pub mean_change: [f64; 3],
    /// The largest of each, where the sheet was measured.
    pub largest_change: [f64; 3],
    /// Readings beyond the border of the sheet, farther than their spacing explains.
    pub beyond_border: usize,
    /// Whether the state is one of the same sheet, bent and not stretched.
    pub isometric: bool,
    /// Share of the area that was measured at this time.
    pub measured_area_fraction: f64,
    /// Share of the area that is known from other times alone.
    pub carried_area_fraction: f64,
    /// Median σ of the surface along its normal, where it was measured.
    pub sigma_surface: f64,
}

/// The scans of one time.
pub(crate) struct State {
    /// When, where the scans say so.
    pub time_s: Option<f64>,
    /// Their numbers in the set.
    pub scans: Vec<usize>,
}

impl State {
    /// What messages call it.
    pub(crate) fn name(&self, set: &ScanSet) -> String {
        let names: Vec<&str> = self.scans.iter().map(|&k| set.scans[k].scan.name.as_str()).collect();
        names.join(", ")
    }
}

/// The states of a thing in the order of time: scans of one time are of one state. Where no scan states a
/// time, each is a state of its own, in the order in which they are given.
///
/// # Errors
/// `Input` where there is one state only, and where some scans state a time and others do not.
pub(crate) fn states_in_time(set: &ScanSet) -> Result<Vec<State>> {
    if set.scans.len() < 2 {
        let found = set.scans.first().map_or("none", |posed| posed.scan.name.as_str());
        return Err(Error::input(format!(
            "--motion bend needs scans of at least two states of the sheet, found one: {found}"
        )));
    }
    if set.scans.iter().all(|posed| posed.scan.time_s.is_none()) {
        let each = (0..set.scans.len()).map(|k| State { time_s: None, scans: vec![k] });
        return Ok(each.collect());
    }
    let mut states: Vec<State> = Vec::new();
    for k in scans_in_time(set)? {
        let time_s = set.scans[k].scan.time_s;
        match states.last_mut().filter(|state| state.time_s == time_s) {
            Some(state) => state.scans.push(k),
            None => states.push(State { time_s, scans: vec![k] }),
        }
    }
    Ok(states)
}
