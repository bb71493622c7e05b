//! Runs of successive readings along straight lines: the first walls.
//!
//! The order of readings is that of their scan, or a path from each to its nearest neighbour. The partition
//! into runs and outliers with the least cost is found by dynamic programming; unlike split-and-merge, it
//! does not depend on a first split.

use super::super::reading::{ContourReading, ContourTarget};
use super::super::start::Sums;
use super::{Candidate, WallReadings};

/// Minimum number of successive ranges from one origin that count as a scan.
const MIN_SCAN: usize = 8;
/// Maximum length of a run; the cost of a partition is the number of readings times this. Longer walls are
/// merged from their runs.
const MAX_RUN: usize = 800;
/// Maximum number of readings that are ordered by nearest neighbours, which costs their square. More keep the
/// order of the file.
const MAX_ORDERED: usize = 6000;

/// Walls of successive readings.
pub(super) fn runs(data: &WallReadings<'_>) -> Vec<Candidate> {
    let (scans, single) = scans(data.readings);
    let mut found: Vec<Candidate> = scans.iter().flat_map(|order| partition(data, order)).collect();
    if !single.is_empty() {
        found.extend(partition(data, &path(data, single)));
    }
    found
}

/// Successive ranges from one origin, and the readings that are in no scan.
pub(super) fn scans(readings: &[ContourReading]) -> (Vec<Vec<usize>>, Vec<usize>) {
    let origin = |i: usize| match readings[i].target {
        ContourTarget::Range { origin, .. } => Some(origin),
        ContourTarget::Point { .. } => None,
    };
    let (mut scans, mut single) = (Vec::new(), Vec::new());
    let mut at = 0;
    while at < readings.len() {
        let mut end = at + 1;
        while end < readings.len() && origin(end).is_some() && origin(end) == origin(at) {
            end += 1;
        }
        if end - at >= MIN_SCAN {
            scans.push((at..end).collect());
        } else {
            single.extend(at..end);
        }
        at = end;
    }
    (scans, single)
}

/// A path through readings: from each to the nearest that is left.
fn path(data: &WallReadings<'_>, mut left: Vec<usize>) -> Vec<usize> {
    if left.len() > MAX_ORDERED {
        return left;
    }
    let mut order = Vec::with_capacity(left.len());
    let mut at = data.points[left[0]];
    while !left.is_empty() {
        let squared = |&i: &usize| {
            let p = data.points[i];
            (p[0] - at[0]).powi(2) + (p[1] - at[1]).powi(2)
        };
        let nearest = (0..left.len()).min_by(|&a, &b| squared(&left[a]).total_cmp(&squared(&left[b])));
        let next = left.swap_remove(nearest.unwrap_or(0));
        at = data.points[next];
        order.push(next);
    }
    order
}

/// The partition of ordered readings into lines and outliers with the least cost: `−2 ln L` and that of
/// each line (optimal partitioning).
fn partition(data: &WallReadings<'_>, order: &[usize]) -> Vec<Candidate> {
    let n = order.len();
    // Moments about a distant origin would lose the residuals to cancellation.
    let origin = data.points[order[n / 2]];
    let mut cumulated = vec![Sums::default(); n + 1];
    for (k, &i) in order.iter().enumerate() {
        let p = data.points[i];
        let mut sums = cumulated[k];
        sums.add([p[0] - origin[0], p[1] - origin[1]], data.covariances[i]);
        cumulated[k + 1] = sums;
    }
    let mut cost = vec![0.0; n + 1];
    // First reading of the run that ends here; `None` if the last reading is an outlier.
    let mut from: Vec<Option<usize>> = vec![None; n + 1];
    for end in 1..=n {
        cost[end] = cost[end - 1] + data.outlier_cost;
        for begin in end.saturating_sub(MAX_RUN)..(end + 1).saturating_sub(data.min_readings) {
            let squares = cumulated[end].minus(&cumulated[begin]).line().2;
            let with = cost[begin] + squares + data.wall_cost;
            if with < cost[end] {
                (cost[end], from[end]) = (with, Some(begin));
            }
        }
    }
    let (mut found, mut end) = (Vec::new(), n);
    while end > 0 {
        match from[end] {
            Some(begin) => {
                let members = order[begin..end].to_vec();
                found.push(Candidate { line: data.line(&members), members });
                end = begin;
            }
            None => end -= 1,
        }
    }
    found
}
