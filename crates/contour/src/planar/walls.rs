//! Straight walls in readings of a room, a corridor or a building.
//!
//! In: readings from inside or outside, in any order; scans of one origin keep their order in the file.
//! Out: a [`WallMap`]: each wall as a fitted line with its readings and the spans where it was measured,
//! and the readings on no wall. Not guaranteed: a curved wall becomes several short ones. Errors that walls
//! share, such as that of a pose, are part of each σ, but correlations between walls are not reported.
//!
//! | stage | method |
//! |---|---|
//! | runs | order of the readings, then the optimal partition into lines and outliers (`runs`) |
//! | merge | two walls become one if that lowers the BIC and they are near each other |
//! | assign | each reading to its nearest wall within the gate; walls are refitted or dropped by BIC |
//! | fit | each line by the estimator of [`super::fit()`], without readings near another wall |
//! | errors | scale of σ, heading, correlated deviations by restricted likelihood (`errors`) |

mod corners;
mod errors;
mod line;
mod runs;

use super::fit::{ContourFit, fit};
use super::kind::ContourKind;
use super::likelihood::{MeasuredPoint, Stroke};
use super::options::{ContourFitOptions, outlier_gate};
use super::reading::{ContourReading, ContourTarget};
pub use corners::{WallCorner, wall_corners};
pub use errors::WallErrors;
use line::WallLine;
use planish_core::BoundingBox;
use planish_estimate::{Error, Result};
use std::f64::consts::{SQRT_2, TAU};

/// Minimum number of readings of a wall in scans, whose order is known, and among readings without an order.
///
/// A line needs two. Of four scattered readings next to each other in a scan, one in ten thousand sets is as
/// straight as a wall; a path through unordered readings can be chosen among many.
const MIN_WALL_READINGS: [usize; 2] = [4, 5];
/// Cost of a wall in units of `ln n`, in scans and without an order: two parameters of its line and two ends,
/// and without an order the choice of the path. With four, one of 20 sets of 60 unordered scattered points
/// had a wall.
const PARAMETERS: [f64; 2] = [4.0, 6.0];
/// A space along a wall without readings ends a span if it exceeds this multiple of the spacing beside it.
const SPAN_SPACINGS: f64 = 4.0;
/// Maximum number of rounds of assigning readings; the assignment rarely changes after the fifth.
const MAX_ROUNDS: usize = 12;
/// Smallest cost of a reading on no wall, in units of `−2 ln L`. In a region that is hardly larger than its
/// walls, chance explains readings about as well as a wall, and everything would be an outlier.
const MIN_OUTLIER_COST: f64 = 6.0;

/// A wall: a straight line with the readings on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Fit of the line; its readings are those of `members`.
    pub fit: ContourFit,
    /// Indices of the readings on the wall, in increasing order.
    pub members: Vec<usize>,
    /// Measured parts of the wall, in order along the line: their ends.
    pub spans: Vec<[[f64; 2]; 2]>,
    /// Distances of the readings at both ends of each span: it may continue that far unseen.
    pub end_spacings: Vec<[f64; 2]>,
}

/// The walls in a set of readings.
#[derive(Debug, Clone, PartialEq)]
pub struct WallMap {
    /// Walls, those with the most readings first.
    pub walls: Vec<Wall>,
    /// Indices of the readings on no wall, in increasing order.
    pub others: Vec<usize>,
    /// BIC of all readings, comparable with [`ContourFit::bic`] of the same readings. Each wall has four
    /// parameters and each further span two.
    pub bic: f64,
    /// Errors of the readings beyond those stated, which the covariances of the walls include.
    pub errors: WallErrors,
}

/// Readings with what all stages need of them.
pub(super) struct WallReadings<'a> {
    readings: &'a [ContourReading],
    points: Vec<[f64; 2]>,
    covariances: Vec<[f64; 3]>,
    /// Readings farther than this many σ from a line are not on it.
    gate: f64,
    /// Cost of a reading on no wall, in units of `−2 ln L`.
    outlier_cost: f64,
    /// Cost of a wall: its parameters times the logarithm of the number of readings.
    wall_cost: f64,
    min_readings: usize,
}

/// A line with the readings assigned to it, during the search.
#[derive(Debug, Clone)]
pub(super) struct Candidate {
    line: WallLine,
    members: Vec<usize>,
}

impl<'a> WallReadings<'a> {
    fn new(readings: &'a [ContourReading], gate: f64) -> Self {
        let points: Vec<[f64; 2]> = readings.iter().map(ContourReading::point).collect();
        let covariances: Vec<[f64; 3]> = readings.iter().map(ContourReading::covariance).collect();
        let bounds: BoundingBox<[f64; 2]> = points.iter().copied().collect();
        let [width, height] = bounds.extent();
        let n = readings.len().max(1) as f64;
        let sigma = (covariances.iter().map(|c| 0.5 * (c[0] + c[2])).sum::<f64>() / n).sqrt();
        let is_unordered = usize::from(!runs::scans(readings).1.is_empty());
        let ratio = match is_unordered {
            // The direction of a ray is given, so only the range counts: it is anywhere up to the longest, or
            // within σ of the wall.
            0 => longest_range(readings) / (TAU.sqrt() * SQRT_2 * sigma).max(f64::MIN_POSITIVE),
            // A reading on no wall lies anywhere in the bounding box; one on a wall within σ of walls about
            // as long as the perimeter of the box.
            _ => width * height / (TAU.sqrt() * sigma * 2.0 * (width + height)).max(f64::MIN_POSITIVE),
        };
        let outlier_cost = (2.0 * ratio.max(1.0).ln()).clamp(MIN_OUTLIER_COST, gate * gate);
        let wall_cost = PARAMETERS[is_unordered] * n.max(2.0).ln();
        let min_readings = MIN_WALL_READINGS[is_unordered];
        Self { readings, points, covariances, gate, outlier_cost, wall_cost, min_readings }
    }

    /// Distance of a reading from a line in its own σ.
    fn distance(&self, line: &WallLine, i: usize) -> f64 {
        line.distance(self.points[i]) / line.sigma_across(self.covariances[i])
    }

    /// The line through readings, weighted by their σ across it.
    fn line(&self, members: &[usize]) -> WallLine {
        WallLine::weighted(members.iter().map(|&i| (self.points[i], self.covariances[i])))
    }

    /// What a wall saves: the cost of its readings as outliers, less its own.
    fn gain(&self, candidate: &Candidate) -> f64 {
        let each = |&i: &usize| self.outlier_cost - self.distance(&candidate.line, i).powi(2);
        candidate.members.iter().map(each).sum::<f64>() - self.wall_cost
    }

    /// Parts of a wall between spaces without readings, as intervals along its line.
    fn spans(&self, candidate: &Candidate) -> Vec<[f64; 2]> {
        let mut along: Vec<f64> =
            candidate.members.iter().map(|&i| candidate.line.along(self.points[i])).collect();
        along.sort_by(f64::total_cmp);
        let steps: Vec<f64> = along.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut sorted = steps.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
        let mut spans: Vec<[f64; 2]> = Vec::new();
        for (k, &t) in along.iter().enumerate() {
            // The spacing grows with the distance from the sensor, so that the steps beside a space count.
            let beside = [k.wrapping_sub(2), k].map(|s| steps.get(s).copied().unwrap_or(0.0));
            let is_next = k > 0 && steps[k - 1] <= SPAN_SPACINGS * beside[0].max(beside[1]).max(median);
            match spans.last_mut() {
                Some(last) if is_next => last[1] = t,
                _ => spans.push([t, t]),
            }
        }
        spans
    }
}

/// The longest range of readings that are ranges.
fn longest_range(readings: &[ContourReading]) -> f64 {
    let range = |reading: &ContourReading| match reading.target {
        ContourTarget::Range { range, .. } => range,
        ContourTarget::Point { .. } => 0.0,
    };
    readings.iter().map(range).fold(0.0, f64::max)
}

/// Finds the walls in readings.
///
/// Walls are added, merged and dropped as long as that lowers `−2 ln L` plus `4 ln n` per wall (`6 ln n`
/// without scans), where a reading on no wall is spread evenly up to the longest range, or over the bounding
/// box without scans. Lines are then fitted
/// as by [`super::fit()`]. Cost: for
/// `n` readings in scans of `m`, `n m` for the runs and `n` times the number of walls for each round.
///
/// # Errors
/// `Undetermined` if no readings form a wall: four of a scan, or five without an order.
///
/// # Examples
/// ```
/// use planish_contour::planar::{ContourFitOptions, ContourKind, find_walls, points};
///
/// // Two parallel walls and a door frame: no closed contour.
/// let line = |y: f64, seed| {
///     let wall = ContourKind::Chain { arcs: vec![false], closed: false };
///     points(&wall, &[0.0, y, 6.0, y], 80, 0.01, seed).noisy
/// };
/// let readings = [line(0.0, 1), line(2.0, 2)].concat();
/// let map = find_walls(&readings, &ContourFitOptions::default())?;
/// assert_eq!(map.walls.len(), 2);
/// assert!(map.others.len() < 5);
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Jackson et al. 2005, *An algorithm for optimal partitioning of data on an interval*; Schwarz 1978,
/// *Estimating the dimension of a model*.
pub fn find_walls(readings: &[ContourReading], options: &ContourFitOptions) -> Result<WallMap> {
    let data = WallReadings::new(readings, outlier_gate(options));
    let mut found: Vec<Candidate> = runs::runs(&data);
    merge(&data, &mut found);
    for _ in 0..MAX_ROUNDS {
        let before: Vec<usize> = found.iter().map(|one| one.members.len()).collect();
        assign(&data, &mut found);
        merge(&data, &mut found);
        if found.iter().map(|one| one.members.len()).eq(before) {
            break;
        }
    }
    let mut walls = Vec::new();
    for (k, candidate) in found.iter().enumerate() {
        // A wall whose line cannot be fitted, such as one of coincident readings, is no wall.
        if let Some(wall) = fitted(&data, &found, k, candidate, options) {
            walls.push(wall);
        }
    }
    if walls.is_empty() {
        return Err(Error::undetermined(format!(
            "expected {} or more readings along a straight wall, found none among {}",
            data.min_readings,
            readings.len()
        )));
    }
    let errors = errors::apply(&data, &mut walls);
    walls.sort_by_key(|wall| std::cmp::Reverse(wall.members.len()));
    let mut is_on_wall = vec![false; readings.len()];
    for &i in walls.iter().flat_map(|wall| &wall.members) {
        is_on_wall[i] = true;
    }
    let others = (0..readings.len()).filter(|&i| !is_on_wall[i]).collect();
    let bic = criterion(&data, &walls);
    Ok(WallMap { walls, others, bic, errors })
}

/// Assigns each reading to its nearest wall, refits the walls, and drops those that no longer pay.
fn assign(data: &WallReadings<'_>, found: &mut Vec<Candidate>) {
    let extents: Vec<[f64; 2]> = found.iter().map(|one| reach(data, one)).collect();
    for one in found.iter_mut() {
        one.members.clear();
    }
    for i in 0..data.points.len() {
        let mut best: Option<(f64, usize)> = None;
        for (k, one) in found.iter().enumerate() {
            let t = one.line.along(data.points[i]);
            if t < extents[k][0] || t > extents[k][1] {
                continue;
            }
            let distance = data.distance(&one.line, i).abs();
            if distance <= data.gate && best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, k));
            }
        }
        if let Some((_, k)) = best {
            found[k].members.push(i);
        }
    }
    found.retain(|one| one.members.len() >= data.min_readings);
    for one in found.iter_mut() {
        one.line = data.line(&one.members);
    }
    found.retain(|one| data.gain(one) > 0.0);
}

/// The interval along a wall in which readings may belong to it: its extent and a few spacings more.
fn reach(data: &WallReadings<'_>, one: &Candidate) -> [f64; 2] {
    let spans = data.spans(one);
    let (Some(first), Some(last)) = (spans.first(), spans.last()) else {
        return [f64::INFINITY, f64::NEG_INFINITY];
    };
    let length: f64 = spans.iter().map(|span| span[1] - span[0]).sum();
    let margin = SPAN_SPACINGS * length / one.members.len().max(1) as f64;
    [first[0] - margin, last[1] + margin]
}

/// Merges the pair of walls that lowers the BIC most, until none does.
fn merge(data: &WallReadings<'_>, found: &mut Vec<Candidate>) {
    // Merging the largest walls first gives each decision the most evidence.
    found.sort_by_key(|one| std::cmp::Reverse(one.members.len()));
    let mut k = 0;
    while k < found.len() {
        let mut best: Option<(f64, usize, Candidate)> = None;
        for j in k + 1..found.len() {
            if let Some((saved, both)) = merged(data, &found[k], &found[j])
                && best.as_ref().is_none_or(|(most, _, _)| saved > *most)
            {
                best = Some((saved, j, both));
            }
        }
        match best {
            Some((_, j, both)) => {
                found[k] = both;
                found.remove(j);
            }
            None => k += 1,
        }
    }
}

/// Both walls as one, with the BIC that this saves; `None` if it saves nothing, or if they are far apart.
fn merged(data: &WallReadings<'_>, a: &Candidate, b: &Candidate) -> Option<(f64, Candidate)> {
    let extent = |line: &WallLine, one: &Candidate| {
        let along = one.members.iter().map(|&i| line.along(data.points[i]));
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)])
    };
    // A wide bound first: most pairs are far from collinear, and a fit of both costs more.
    let middle = |one: &Candidate| one.members[one.members.len() / 2];
    let far = 10.0 * data.gate;
    if data.distance(&a.line, middle(b)).abs() > far && data.distance(&b.line, middle(a)).abs() > far {
        return None;
    }
    let ends = [extent(&a.line, a), extent(&a.line, b)];
    let space = (ends[1][0] - ends[0][1]).max(ends[0][0] - ends[1][1]);
    // Collinear by chance is likely only for a short wall far away: a longer space needs a longer wall.
    let longest = (ends[0][1] - ends[0][0]).max(ends[1][1] - ends[1][0]);
    if space > longest {
        return None;
    }
    let members = [&a.members[..], &b.members].concat();
    let both = Candidate { line: data.line(&members), members };
    // A reading that leaves the gate counts as one, so that a merge cannot hide misfits.
    let squares = |one: &Candidate| {
        let each = |&i: &usize| data.distance(&one.line, i).powi(2).min(data.gate * data.gate);
        one.members.iter().map(each).sum::<f64>()
    };
    let saved = squares(a) + squares(b) + data.wall_cost - squares(&both);
    (saved > 0.0).then_some((saved, both))
}

/// The fit of a wall with its spans.
fn fitted(
    data: &WallReadings<'_>,
    found: &[Candidate],
    own: usize,
    candidate: &Candidate,
    options: &ContourFitOptions,
) -> Option<Wall> {
    let mut members = candidate.members.clone();
    members.sort_unstable();
    // Readings near a corner may be on either wall, and the nearer one was chosen: they would bias it.
    let is_clear = |&i: &usize| {
        (found.iter().enumerate())
            .all(|(k, other)| k == own || data.distance(&other.line, i).abs() > data.gate)
    };
    let clear: Vec<usize> = members.iter().copied().filter(is_clear).collect();
    let used = if 2 * clear.len() > members.len() && clear.len() >= data.min_readings {
        clear
    } else {
        members.clone()
    };
    let sightings: Vec<ContourReading> = used.iter().map(|&i| data.readings[i]).collect();
    let start = vec![candidate.line.angle(), candidate.line.offset()];
    let options = ContourFitOptions { start: Some(start), ..options.clone() };
    let mut fit = fit(&ContourKind::Line, &sightings, &options).ok()?;
    let line = WallLine::new(fit.state[0], fit.state[1]);
    // Distances and use of all members: those near a corner are on the wall, though the fit left them out.
    let mut distances = vec![f64::NAN; members.len()];
    let mut is_used = vec![false; members.len()];
    for (k, &i) in members.iter().enumerate() {
        let at = used.binary_search(&i).ok();
        distances[k] = at.map_or_else(|| data.distance(&line, i), |at| fit.distances[at]);
        is_used[k] = at.map_or(distances[k].abs() <= data.gate, |at| fit.used[at]);
    }
    (fit.distances, fit.used) = (distances, is_used);
    let intervals = data.spans(&Candidate { line, members: members.clone() });
    let spans = intervals.iter().map(|span| span.map(|t| line.at(t))).collect();
    let mut along: Vec<f64> = members.iter().map(|&i| line.along(data.points[i])).collect();
    along.sort_by(f64::total_cmp);
    let end_spacings = intervals.iter().map(|span| end_spacings(&along, *span)).collect();
    Some(Wall { fit, members, spans, end_spacings })
}

/// Distances of the readings at both ends of a span. `along` has the places of all readings, in order.
fn end_spacings(along: &[f64], [from, to]: [f64; 2]) -> [f64; 2] {
    // Steps outside of the span count if it has less than three readings. The larger of two steps: readings
    // of several scans may coincide.
    let first = along.partition_point(|t| *t < from).min(along.len().saturating_sub(3));
    let last = along.partition_point(|t| *t <= to).max(3);
    let step = |k: usize| (along[k + 1] - along[k]).max(along[k + 2] - along[k + 1]);
    [step(first), step(last - 3)]
}

/// BIC of all readings: each anywhere on the spans of all walls, or an outlier at the gate.
fn criterion(data: &WallReadings<'_>, walls: &[Wall]) -> f64 {
    let bounds: BoundingBox<[f64; 2]> = data.points.iter().copied().collect();
    let [width, height] = bounds.extent();
    let spans: Vec<[[f64; 2]; 2]> = walls.iter().flat_map(|wall| wall.spans.iter().copied()).collect();
    let strokes: Vec<Stroke> = spans.iter().map(|&span| Stroke::Straight(span)).collect();
    let length = strokes.iter().map(Stroke::speed).sum::<f64>().max(width).max(height);
    let share = TAU.sqrt() * 2.0 * (width + height) / length.max(f64::MIN_POSITIVE);
    let outlier = (-0.5 * data.gate * data.gate).exp();
    let log_likelihood: f64 = (0..data.points.len())
        .map(|i| {
            let measured = MeasuredPoint { point: data.points[i], covariance: data.covariances[i] };
            let density: f64 = strokes.iter().map(|stroke| stroke.density(&measured)).sum();
            (share * measured.variance().sqrt() * density + outlier).ln()
        })
        .sum();
    let parameters = 2.0 * (walls.len() + spans.len()) as f64;
    parameters * (data.points.len().max(2) as f64).ln() - 2.0 * log_likelihood
}

#[cfg(test)]
mod tests;
