//! Separation of readings into parts, and the contour of each.
//!
//! In: the readings of a file and the job. Out: [`Part`]s, the largest first, and what was not used as
//! findings. Readings are separated by level and by gaps. A part of which no single contour explains the
//! readings is searched for walls; a log of scans is searched for walls as a whole, because a wall continues
//! behind what hides it.

use super::{ContourJob, MIN_READINGS};
use planish_contour::planar::{
    Choice, ContourKind, ContourReading, ContourTarget, WallErrors, WallMap, auto_kinds, choose, find_walls,
    fit, separate, typical_gap,
};
use planish_core::{Finding, FindingCode, Progress, Setting};
use planish_estimate::{Error, Result};
use planish_exchange::contours::{ContourReadings, DEFAULT_SIGMA_RANGE};

/// Maximum share of a contour's readings beyond the gate without a finding. A few percent are gross errors;
/// more are systematic, as with a wrong kind.
pub(super) const MAX_SKIPPED_SHARE: f64 = 0.15;

/// Reduced χ² within which residuals agree with σ: about 0.63 to 1.6 in σ. Stated σ are rarely more exact.
pub(super) const CONSISTENT: std::ops::Range<f64> = 0.4..2.5;

/// Maximum number of readings of a part of a log that is also tried as one contour. The choice among all
/// kinds takes seconds for more, and what a scanner sees from inside is a room.
const MAX_OBJECT_READINGS: usize = 250;

/// Relative change of σ below which its estimate has converged; a tenth of it changes no wall.
const SIGMA_TOLERANCE: f64 = 0.05;
/// Smallest estimated σ of a range, as a fraction of the default, which is the largest: logs round ranges to
/// 1 cm or 1 mm.
const MIN_SIGMA_SHARE: f64 = 0.1;
/// Rounds of estimating σ; in the five logs of the benchmark three suffice.
const SIGMA_ROUNDS: usize = 5;
/// Smallest number of rejected readings on one line that may be a side: two are always on a line.
const MIN_SIDE_READINGS: usize = 3;
/// Number of ranges of indices in a message; the report lists all.
const MAX_RANGES: usize = 12;
/// The share of residuals from which σ is computed, and that many σ of a normal distribution on both sides.
///
/// Residuals of real walls have wide tails. The median, which ignores them, gave 0.007 m in a log whose
/// walls then lost a tenth of their readings to the gate.
const RESIDUAL_SHARE: (f64, f64) = (0.9, 1.645);

/// A part of the readings, with the identified contour.
pub(super) struct Part {
    pub(super) level: Option<f64>,
    pub(super) members: Vec<usize>,
    pub(super) choice: Choice,
    /// The measured parts of a wall; none for other contours.
    pub(super) spans: Vec<[[f64; 2]; 2]>,
    /// Distances of the readings at both ends of each span of a wall.
    pub(super) end_spacings: Vec<[f64; 2]>,
}

/// The parts of all readings.
pub(super) struct Parts {
    pub(super) parts: Vec<Part>,
    /// σ of ranges estimated from the residuals of the walls of a log that states none.
    pub(super) sigma_range: Option<f64>,
    /// Indices of the readings that were searched for walls and lie on none, in increasing order.
    pub(super) on_no_wall: Vec<usize>,
    /// Errors of readings about walls; those of the first level if there are several.
    pub(super) wall_errors: Option<WallErrors>,
}

/// Separates the readings and fits each part.
pub(super) fn parts_of(
    read: &mut ContourReadings,
    job: &ContourJob,
    progress: &dyn Progress,
    findings: &mut Vec<Finding>,
) -> Result<Parts> {
    let mut groups: Vec<(Option<f64>, Vec<usize>)> = Vec::new();
    for i in 0..read.sightings.len() {
        let level = read.levels.as_ref().map(|levels| levels[i]);
        // Levels are compared exactly: they are labels of the file. A list keeps their order of appearance,
        // which a hash map would not.
        match groups.iter_mut().find(|(l, _)| *l == level) {
            Some((_, members)) => members.push(i),
            None => groups.push((level, vec![i])),
        }
    }
    let is_auto = job.kinds.is_empty() && !job.chains && !job.walls;
    let sigma_range = match (job.walls || is_auto) && read.in_metres && job.sigma.range.is_none() {
        true => estimate_sigma(&mut read.sightings, job),
        false => None,
    };
    let mut search = Search {
        readings: &read.sightings,
        job,
        is_auto,
        parts: Vec::new(),
        on_no_wall: Vec::new(),
        wall_errors: None,
        findings,
    };
    let count = groups.len();
    for (k, (level, members)) in groups.into_iter().enumerate() {
        let at = [k, k + 1].map(|k| 0.05 + 0.9 * k as f64 / count as f64);
        if job.walls || (is_auto && read.in_metres) {
            search.rooms(level, &members, progress, at)?;
        } else {
            search.objects(level, &members, progress, at, count)?;
        }
    }
    let Search { mut parts, mut on_no_wall, wall_errors, .. } = search;
    if parts.is_empty() {
        return Err(Error::undetermined("no part of the readings determines a contour"));
    }
    // Stable sort: parts of equal size keep the order of the file.
    parts.sort_by_key(|part| std::cmp::Reverse(part.members.len()));
    on_no_wall.sort_unstable();
    Ok(Parts { parts, sigma_range, on_no_wall, wall_errors })
}

/// The search for contours in one file.
struct Search<'a> {
    readings: &'a [ContourReading],
    job: &'a ContourJob,
    is_auto: bool,
    parts: Vec<Part>,
    on_no_wall: Vec<usize>,
    wall_errors: Option<WallErrors>,
    findings: &'a mut Vec<Finding>,
}

impl Search<'_> {
    fn sightings(&self, members: &[usize]) -> Vec<ContourReading> {
        members.iter().map(|&i| self.readings[i]).collect()
    }

    /// Fits a contour to each group of readings that gaps separate.
    fn objects(
        &mut self,
        level: Option<f64>,
        members: &[usize],
        progress: &dyn Progress,
        [from, to]: [f64; 2],
        levels: usize,
    ) -> Result<()> {
        let sightings = self.sightings(members);
        // Per level, because levels may be sampled at different distances.
        let gap = self.job.gap.unwrap_or_else(|| typical_gap(&sightings));
        let (mut clusters, mut strays) = (Vec::new(), 0);
        for cluster in separate(&sightings, gap) {
            // A level that consists of one small group is fitted: the user measured just these points.
            if cluster.len() < MIN_READINGS && cluster.len() < sightings.len() {
                strays += cluster.len();
            } else {
                clusters.push(cluster.into_iter().map(|k| members[k]).collect::<Vec<usize>>());
            }
        }
        if strays > 0 {
            let lie = if strays == 1 { "reading lies" } else { "readings lie" };
            let text = format!(
                "{strays} {lie} apart from all others and not used: increase the gap if they belong together"
            );
            self.findings.push(Finding::new(FindingCode::ReadingsIsolated, text).with_setting(Setting::Gap));
        }
        let count = clusters.len();
        for (k, members) in clusters.into_iter().enumerate() {
            progress.check("fitting", from + (to - from) * k as f64 / count as f64)?;
            progress.items(self.parts.iter().map(|part| part.members.len()).sum(), "readings");
            match self.object(&members) {
                Ok(found) => self.add(level, &members, found),
                // One part among several must not discard the others. A single part is the whole answer, so
                // there it is an error.
                Err(e) if count > 1 || levels > 1 => self.findings.push(Finding::new(
                    FindingCode::PartNotFitted,
                    format!("no contour could be fitted to a part of {} readings: {e}", members.len()),
                )),
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    /// The contour of a group, or its walls if no contour explains the readings and walls do.
    fn object(&self, members: &[usize]) -> Result<Object> {
        let sightings = self.sightings(members);
        let choice = self.choose(&sightings);
        if !self.is_auto || choice.as_ref().is_ok_and(is_consistent) {
            return choice.map(|choice| Object::Contour(Box::new(choice)));
        }
        match (choice, find_walls(&sightings, &self.job.fit)) {
            (Ok(choice), Ok(map)) if map.bic >= choice.fit.bic() => Ok(Object::Contour(Box::new(choice))),
            (Ok(choice), Err(_)) => Ok(Object::Contour(Box::new(choice))),
            (Err(e), Err(_)) => Err(e),
            (_, Ok(map)) => Ok(Object::Walls(map)),
        }
    }

    fn choose(&self, sightings: &[ContourReading]) -> Result<Choice> {
        let (kinds, chains) = match self.is_auto {
            true => (auto_kinds(), true),
            false => (self.job.kinds.clone(), self.job.chains),
        };
        choose(&kinds, chains, sightings, &self.job.fit)
    }

    fn add(&mut self, level: Option<f64>, members: &[usize], object: Object) {
        match object {
            Object::Contour(choice) => {
                self.findings.extend(self.missing_side(members, &choice));
                let members = members.to_vec();
                self.parts.push(Part {
                    level,
                    members,
                    choice: *choice,
                    spans: Vec::new(),
                    end_spacings: Vec::new(),
                });
            }
            Object::Walls(map) => {
                if !map.others.is_empty() {
                    let others: Vec<usize> = map.others.iter().map(|&k| members[k]).collect();
                    let verb = if others.len() == 1 { "lies" } else { "lie" };
                    let text = format!(
                        "{} of {} readings {verb} on no wall (people, furniture, glass or depth edges): {}",
                        others.len(),
                        members.len(),
                        ranges_text(&others)
                    );
                    self.findings.push(Finding::new(FindingCode::ReadingsOnNoWall, text));
                    self.on_no_wall.extend(others);
                }
                self.wall_errors = self.wall_errors.or(Some(map.errors));
                self.parts.extend(map.walls.into_iter().map(|wall| Part {
                    level,
                    members: wall.members.iter().map(|&k| members[k]).collect(),
                    choice: Choice { fit: wall.fit, bic_margin: None, alternatives: Vec::new() },
                    spans: wall.spans,
                    end_spacings: wall.end_spacings,
                }));
            }
        }
    }

    /// A warning if rejected readings lie on one line: the contour may lack a side.
    ///
    /// Scattered gross errors are rarely straight within σ. An L-shaped part in a picture lost a short side
    /// with three of 34 readings without a warning.
    fn missing_side(&self, members: &[usize], choice: &Choice) -> Option<Finding> {
        let rejected = members.iter().zip(&choice.fit.used).filter(|(_, used)| !**used);
        let rejected: Vec<usize> = rejected.map(|(&i, _)| i).collect();
        if rejected.len() < MIN_SIDE_READINGS {
            return None;
        }
        let gap = self.job.gap.unwrap_or_else(|| typical_gap(&self.sightings(members)));
        let is_line = |readings: &[ContourReading]| {
            fit(&ContourKind::Line, readings, &self.job.fit).is_ok_and(|line| {
                line.used.iter().all(|used| *used) && line.reduced_chi_square() < CONSISTENT.end
            })
        };
        // Successive rejected readings may show two sides that meet: the longest run on one line counts. Each
        // start lengthens the run as far as it can, so the fits are at most twice as many as the readings.
        let on_line = |cluster: &Vec<usize>| {
            let readings: Vec<ContourReading> = cluster.iter().map(|&k| self.readings[rejected[k]]).collect();
            let mut longest = MIN_SIDE_READINGS - 1;
            for start in 0..readings.len() {
                while readings.get(start..=start + longest).is_some_and(is_line) {
                    longest += 1;
                }
            }
            (longest >= MIN_SIDE_READINGS).then_some(longest)
        };
        let clusters = separate(&self.sightings(&rejected), gap);
        let count = clusters.iter().filter_map(on_line).max()?;
        let text = format!(
            "{} of {} readings: {count} rejected readings lie on one line, which may be a further side",
            choice.fit.kind,
            members.len()
        );
        Some(Finding::new(FindingCode::BeyondGate, text).with_setting(Setting::Kind))
    }

    /// Walls of all readings, after closed contours of groups that such a contour explains better.
    fn rooms(
        &mut self,
        level: Option<f64>,
        members: &[usize],
        progress: &dyn Progress,
        [from, to]: [f64; 2],
    ) -> Result<()> {
        let mut rest: Vec<usize> = Vec::new();
        let sightings = self.sightings(members);
        let gap = self.job.gap.unwrap_or_else(|| typical_gap(&sightings));
        let clusters = if self.is_auto { separate(&sightings, gap) } else { Vec::new() };
        let count = clusters.len();
        for (k, cluster) in clusters.into_iter().enumerate() {
            progress.check("fitting", from + (to - from) * k as f64 / count as f64)?;
            let cluster: Vec<usize> = cluster.into_iter().map(|k| members[k]).collect();
            match self.closed_object(&cluster) {
                Some(choice) => self.add(level, &cluster, Object::Contour(Box::new(choice))),
                None => rest.extend(cluster),
            }
        }
        if !self.is_auto {
            rest = members.to_vec();
        }
        // In the order of the file: readings of a scan are neighbours.
        rest.sort_unstable();
        match find_walls(&self.sightings(&rest), &self.job.fit) {
            Ok(map) => self.add(level, &rest, Object::Walls(map)),
            Err(e) if self.parts.is_empty() => return Err(e),
            Err(_) if rest.is_empty() => {}
            Err(e) => self.findings.push(Finding::new(
                FindingCode::PartNotFitted,
                format!("no contour could be fitted to a part of {} readings: {e}", rest.len()),
            )),
        }
        Ok(())
    }

    /// A closed contour of a group in a log, if it explains the readings better than walls.
    fn closed_object(&self, members: &[usize]) -> Option<Choice> {
        if !(MIN_READINGS..=MAX_OBJECT_READINGS).contains(&members.len()) {
            return None;
        }
        let sightings = self.sightings(members);
        let walls = find_walls(&sightings, &self.job.fit).map_or(f64::INFINITY, |map| map.bic);
        let choice = self.choose(&sightings).ok()?;
        let is_open = matches!(choice.fit.kind, ContourKind::Line | ContourKind::Chain { closed: false, .. });
        (!is_open && is_consistent(&choice) && choice.fit.bic() < walls).then_some(choice)
    }
}

/// Indices as ranges: `3-7, 20`.
fn ranges_text(indices: &[usize]) -> String {
    let mut ranges: Vec<[usize; 2]> = Vec::new();
    for &i in indices {
        match ranges.last_mut() {
            Some(last) if last[1] + 1 == i => last[1] = i,
            _ => ranges.push([i, i]),
        }
    }
    let shown = ranges.iter().take(MAX_RANGES).map(|[from, to]| match from == to {
        true => from.to_string(),
        false => format!("{from}-{to}"),
    });
    let mut words: Vec<String> = shown.collect();
    if ranges.len() > MAX_RANGES {
        words.push(format!("and {} more ranges", ranges.len() - MAX_RANGES));
    }
    format!("indices {} (from 0)", words.join(", "))
}

/// What explains a group of readings.
enum Object {
    Contour(Box<Choice>),
    Walls(WallMap),
}

/// True if most readings are used, and their residuals agree with σ.
fn is_consistent(choice: &Choice) -> bool {
    let rejected = choice.fit.used.iter().filter(|used| !**used).count();
    rejected as f64 <= MAX_SKIPPED_SHARE * choice.fit.used.len() as f64
        && choice.fit.reduced_chi_square() < CONSISTENT.end
}

/// Replaces the default σ of the ranges of a log by the scatter of the readings about their walls.
///
/// The result includes the roughness of walls, which is an error for a straight one. It is at most the
/// default. Readings without walls keep their σ. The error of the heading, without which readings at small
/// angles to a wall would decide its line, follows as well unless it is given.
fn estimate_sigma(sightings: &mut [ContourReading], job: &ContourJob) -> Option<f64> {
    let mut sigma = DEFAULT_SIGMA_RANGE;
    let mut heading = 0.0;
    for _ in 0..SIGMA_ROUNDS {
        let map = find_walls(sightings, &job.fit).ok()?;
        let mut residuals: Vec<f64> = Vec::new();
        for wall in &map.walls {
            // A line through n readings leaves √((n − 2)/n) of their σ.
            let n = wall.members.len() as f64;
            let scale = (n / (n - 2.0)).sqrt();
            residuals.extend(wall.fit.distances.iter().filter(|d| d.is_finite()).map(|d| scale * d.abs()));
        }
        let (share, sigmas) = RESIDUAL_SHARE;
        let rank = ((share * residuals.len() as f64) as usize).min(residuals.len().saturating_sub(1));
        let (_, residual, _) = residuals.select_nth_unstable_by(rank, f64::total_cmp);
        let next =
            (sigma * *residual / sigmas).clamp(MIN_SIGMA_SHARE * DEFAULT_SIGMA_RANGE, DEFAULT_SIGMA_RANGE);
        let is_converged = (next / sigma - 1.0).abs() < SIGMA_TOLERANCE;
        (sigma, heading) = (next, map.errors.heading_rad);
        for sighting in sightings.iter_mut() {
            if let ContourTarget::Range { sigma: [.., of_range], .. } = &mut sighting.target {
                *of_range = sigma;
            }
        }
        if is_converged {
            break;
        }
    }
    if job.sigma.heading_deg.is_none() {
        // Only now: with it, the next estimate would be what is left.
        for sighting in sightings.iter_mut() {
            if let ContourTarget::Range { sigma: [_, _, of_heading, _], .. } = &mut sighting.target {
                *of_heading = heading;
            }
        }
    }
    Some(sigma)
}

#[cfg(test)]
mod tests {
    use super::super::ContourJob;
    use super::{Parts, parts_of, ranges_text};
    use planish_contour::planar::{ContourKind, ContourReading, ContourTarget};
    use planish_core::{FindingCode, Silent};
    use planish_exchange::contours::ContourReadings;

    #[test]
    fn indices_are_shown_as_ranges() {
        assert_eq!(ranges_text(&[3, 4, 5, 9, 11, 12]), "indices 3-5, 9, 11-12 (from 0)");
        let many: Vec<usize> = (0..40).map(|k| 2 * k).collect();
        assert!(ranges_text(&many).ends_with("22, and 28 more ranges (from 0)"), "{}", ranges_text(&many));
    }

    /// Codes of the findings about a rectangle of 20 × 10 and six more points.
    fn findings(extra: [[f64; 2]; 6]) -> Vec<FindingCode> {
        let side = |k: u32, length: f64| length * (f64::from(k) + 0.5) / 30.0;
        let outline = (0..30).flat_map(|k| {
            [[side(k, 20.0), 0.0], [side(k, 20.0), 10.0], [0.0, side(k, 10.0)], [20.0, side(k, 10.0)]]
        });
        let sightings = outline.chain(extra).enumerate().map(|(line, position)| {
            // A pattern without a trend instead of noise.
            let error = 0.02 * ((7 * line % 5) as f64 - 2.0);
            let target =
                ContourTarget::Point { position: [position[0] + error, position[1] - error], sigma: 0.05 };
            ContourReading { target, pose: None, time_s: 0.0, line }
        });
        let mut read = ContourReadings { sightings: sightings.collect(), ..ContourReadings::default() };
        let job = ContourJob { kinds: vec![ContourKind::Rectangle], ..ContourJob::default() };
        let mut findings = Vec::new();
        let Parts { parts, .. } = parts_of(&mut read, &job, &Silent, &mut findings).expect("a rectangle");
        assert_eq!(parts.len(), 1);
        findings.iter().map(|finding| finding.code).collect()
    }

    #[test]
    fn rejected_readings_on_a_line_are_reported() {
        let step = [0, 1, 2, 3, 4, 5].map(|k| [8.0 + 0.6 * f64::from(k), 8.5]);
        assert!(findings(step).contains(&FindingCode::BeyondGate));
        let scattered = [[3.0, 8.9], [5.1, 2.0], [8.3, 8.1], [11.9, 1.4], [15.2, 8.5], [17.0, 1.1]];
        assert!(!findings(scattered).contains(&FindingCode::BeyondGate));
    }
}
