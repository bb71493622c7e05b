//! Splits the points of one file into scans by its columns `scan` and `time`.
//!
//! **Input.** A scan with the scan number and time of each point.
//!
//! **Output.** One scan per number, in ascending order, with its time. If a file has times and no numbers,
//! points with equal times form one scan, unless nearly every point has its own time. The time of a scan
//! whose points were measured one after the other is their mean.
//!
//! **Limits.** Motion during a scan is ignored.

use planish_estimate::{Error, Result};
use planish_sense::Scan;
use std::collections::BTreeMap;

/// Minimum average number of points per distinct time for times to separate scans.
///
/// Too small a value splits a scan of a slow sensor, whose points have times of their own, into many scans.
/// Too large a value joins small scans. Guarded by `times_split_only_if_many_points_share_each`.
const MIN_POINTS_PER_TIME: usize = 100;

/// Splits a scan by the scan number of each point, or else by its time.
///
/// # Errors
/// `Unsupported` for an organised grid of several scans.
pub(crate) fn split_scans(mut scan: Scan) -> Result<Vec<Scan>> {
    let (numbers, times) = (scan.scan_numbers.take(), scan.times_s.take());
    let part: Vec<u64> = match (&numbers, &times) {
        (Some(numbers), _) => numbers.iter().map(|&n| n.into()).collect(),
        (None, Some(times)) => times.iter().map(|&t| ordered_bits(t)).collect(),
        (None, None) => return Ok(vec![scan]),
    };
    // Sorted by number or time, whatever the order of the points.
    let mut points: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (k, &part) in part.iter().enumerate() {
        points.entry(part).or_default().push(k);
    }
    let mean = |indices: &[usize]| {
        let times = times.as_ref()?;
        // Summed relative to the first, so that the mean of equal times is exactly that time.
        let first = times[*indices.first()?];
        Some(first + indices.iter().map(|&k| times[k] - first).sum::<f64>() / indices.len() as f64)
    };
    let by_time_alone = numbers.is_none();
    if points.len() < 2 || by_time_alone && points.len() * MIN_POINTS_PER_TIME > part.len() {
        scan.time_s = mean(&(0..part.len()).collect::<Vec<_>>()).or(scan.time_s);
        return Ok(vec![scan]);
    }
    // The cells of one grid hold points of all scans, and no part has a grid of its own.
    if scan.grid.is_some() {
        return Err(Error::unsupported(format!(
            "{}: expected one scan in an organised file, found {}: write one file per scan, or points \
             without a grid",
            scan.name,
            points.len()
        )));
    }
    let mut dropped_not_finite = scan.dropped_not_finite;
    Ok(points
        .into_iter()
        .map(|(part, indices)| {
            let time_s = mean(&indices);
            let name = match (by_time_alone, time_s) {
                (true, Some(time)) => format!("{}, time {time}", scan.name),
                _ => format!("{}, scan {part}", scan.name),
            };
            Scan {
                name,
                points: indices.iter().map(|&k| scan.points[k]).collect(),
                sigma: pick(scan.sigma.as_ref(), &indices),
                covariance: pick(scan.covariance.as_ref(), &indices),
                normals: pick(scan.normals.as_ref(), &indices),
                sigma_normal_deg: pick(scan.sigma_normal_deg.as_ref(), &indices),
                curvatures: pick(scan.curvatures.as_ref(), &indices),
                sigma_curvature: pick(scan.sigma_curvature.as_ref(), &indices),
                classes: pick(scan.classes.as_ref(), &indices),
                parameters: pick(scan.parameters.as_ref(), &indices),
                times_s: None,
                scan_numbers: None,
                grid: None,
                viewing: scan.viewing,
                world_from_scanner: scan.world_from_scanner,
                time_s,
                // Dropped records have no scan number; the first scan counts them, so that the sum is right.
                dropped_not_finite: std::mem::take(&mut dropped_not_finite),
            }
        })
        .collect())
}

fn pick<T: Copy>(column: Option<&Vec<T>>, indices: &[usize]) -> Option<Vec<T>> {
    column.map(|all| indices.iter().map(|&k| all[k]).collect())
}

/// Maps a finite number to bits that have the order of the numbers, for use as a key.
fn ordered_bits(x: f64) -> u64 {
    // Adding zero turns −0 into +0, so that both are one time.
    let bits = (x + 0.0).to_bits();
    // The bits of negative numbers ascend with their size, so they are inverted; the others get the highest
    // bit, which places them above.
    if bits >> 63 == 1 { !bits } else { bits | 1 << 63 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planish_core::DVec3;

    fn scan(times: Option<Vec<f64>>, numbers: Option<Vec<u32>>, points: usize) -> Scan {
        Scan {
            name: "a.csv".to_owned(),
            points: (0..points).map(|k| DVec3::new(k as f64, 0.0, 0.0)).collect(),
            sigma: Some((1..=points).map(|k| k as f64).collect()),
            times_s: times,
            scan_numbers: numbers,
            ..Scan::default()
        }
    }

    #[test]
    fn scan_numbers_split_a_file_with_all_its_columns() {
        let made = split_scans(scan(Some(vec![2.0, 1.0, 4.0, 1.0]), Some(vec![7, 3, 7, 3]), 4)).unwrap();
        let found: Vec<_> = made
            .iter()
            .map(|s| (s.name.as_str(), s.points.len(), s.sigma.clone().unwrap(), s.time_s))
            .collect();
        assert_eq!(
            found,
            [
                ("a.csv, scan 3", 2, vec![2.0, 4.0], Some(1.0)),
                ("a.csv, scan 7", 2, vec![1.0, 3.0], Some(3.0))
            ]
        );
    }

    #[test]
    fn times_split_only_if_many_points_share_each() {
        let shared = |k: usize| if k.is_multiple_of(2) { -1.5 } else { 0.5 };
        let made = split_scans(scan(Some((0..400).map(shared).collect()), None, 400)).unwrap();
        let found: Vec<_> = made.iter().map(|s| (s.points.len(), s.time_s)).collect();
        assert_eq!(found, [(200, Some(-1.5)), (200, Some(0.5))]);
        let own = split_scans(scan(Some((0..40).map(f64::from).collect()), None, 40)).unwrap();
        assert_eq!((own.len(), own[0].points.len(), own[0].time_s), (1, 40, Some(19.5)));
    }
}
