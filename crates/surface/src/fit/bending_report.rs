//! The states of a sheet that bends without stretch, and their report.

use super::motion::scans_in_time;
use planish_core::Setting;
use planish_estimate::{Error, Result};
use planish_exchange::ScanSet;
use serde::Serialize;

/// The bending of a sheet.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BendingReport {
    /// Assumed relative σ of lengths along the sheet.
    pub sigma_stretch: f64,
    /// True if every state is the same sheet, bent but not stretched.
    pub isometric: bool,
    /// Number of times that the cells of the first state were divided to follow the bending of the others.
    pub divisions: usize,
    /// One entry for each state, in the order of time.
    pub states: Vec<BendingState>,
}

/// The sheet at one time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BendingState {
    /// Scans of this time.
    pub scans: Vec<String>,
    /// Time in seconds, if the scans state one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_s: Option<f64>,
    /// Readings used.
    pub observations: usize,
    /// Root mean square of their residuals along the normals.
    pub rms: f64,
    /// σ of the readings: the stated one, or the estimate of the first state.
    pub sigma: f64,
    /// `rms` over `sigma`: 1 if the residuals are noise only.
    pub misfit: f64,
    /// Mean absolute relative changes of E, F and G since the first state; that of F is relative to √(EG).
    pub mean_change: [f64; 3],
    /// Largest of these changes, where the sheet was measured.
    pub largest_change: [f64; 3],
    /// Readings beyond the border of the sheet by more than their spacing.
    pub beyond_border: usize,
    /// True if the state is the same sheet, bent but not stretched.
    pub isometric: bool,
    /// Share of the area that was measured at this time.
    pub measured_area_fraction: f64,
    /// Share of the area that is known from other times only.
    pub carried_area_fraction: f64,
    /// Median σ of the measured surface along its normal.
    pub sigma_surface: f64,
}

/// The scans of one time.
pub(crate) struct State {
    /// Time in seconds, if the scans state one.
    pub time_s: Option<f64>,
    /// Indices of the scans in the set.
    pub scans: Vec<usize>,
}

impl State {
    /// Name of the state in messages.
    pub(crate) fn name(&self, set: &ScanSet) -> String {
        let names: Vec<&str> = self.scans.iter().map(|&k| set.scans[k].scan.name.as_str()).collect();
        names.join(", ")
    }
}

/// The states of a sheet in the order of time. Scans of one time form one state. If no scan states a time,
/// each is a state of its own, in the given order.
///
/// # Errors
/// `Input` if there is one state only, or only some scans state a time.
pub(crate) fn states_in_time(set: &ScanSet) -> Result<Vec<State>> {
    if set.scans.len() < 2 {
        let found = set.scans.first().map_or("none", |posed| posed.scan.name.as_str());
        return Err(Error::input(format!(
            "expected scans of at least two states of a bending sheet, found one: {found}"
        ))
        .with_setting(Setting::Motion));
    }
    if set.scans.iter().all(|posed| posed.scan.time_s.is_none()) {
        let each = (0..set.scans.len()).map(|k| State { time_s: None, scans: vec![k] });
        return Ok(each.collect());
    }
    // If only some scans state a time, `scans_in_time` refuses the set.
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
