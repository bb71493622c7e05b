//! The neighbours of a point in a cloud, and the plane through them.
//!
//! Scanners often measure denser along their lines than across. The nearest neighbours then lie on one line
//! and show no normal. The plane of a curved line, which is perpendicular to the surface, is even the best
//! plane through them.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::DVec3;
use planish_core::vector3::as_arrays;
use planish_estimate::{Error, Result};
use std::num::NonZero;

/// Neighbours lie along a line if more of them than by chance, by so many standard deviations, are within
/// this share of their radius of it. On a regular grid, four of twelve are.
const MAX_EXCESS: f64 = 1.5;
const LINE_WIDTH: f64 = 0.15;
/// Most neighbours that take the place of those on one line, over their number.
const MAX_WIDENED: usize = 16;
/// Least distance of spread neighbours, over the side of the square that each of `k` would have.
const EVEN_SPACING: f64 = 0.6;

pub(crate) fn tree(points: &[DVec3]) -> Result<ImmutableKdTree<f64, 3>> {
    if points.len() < 3 {
        return Err(Error::undetermined(format!(
            "expected at least 3 points for normals, found {}",
            points.len()
        )));
    }
    ImmutableKdTree::new_from_slice(as_arrays(points))
        .map_err(|e| Error::undetermined(format!("the points cannot be searched: {e:?}")))
}

/// The mean of points; the origin where there are none.
pub(crate) fn mean(points: &[DVec3]) -> DVec3 {
    let sum = points.iter().sum::<DVec3>();
    1.0 / points.len().max(1) as f64 * sum
}

/// About `k` neighbours of a place, itself included: the nearest if they surround it, or else evenly spread
/// ones of up to [`MAX_WIDENED`] times as many. Scanners often measure denser along their lines than across,
/// and neighbours on one line show no normal.
pub(crate) fn surrounding(
    tree: &ImmutableKdTree<f64, 3>,
    points: &[DVec3],
    at: DVec3,
    k: NonZero<usize>,
) -> Vec<u32> {
    let nearest = |count: NonZero<usize>| -> Vec<u32> {
        let near = tree.query(at.as_ref()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        near.iter().map(|n| n.item).collect()
    };
    let mut best = nearest(k);
    let mut least = share_on_line(&places(&best, points), at);
    for widened in (1..).map(|power| k.get() << power).take_while(|&n| n <= MAX_WIDENED * k.get()) {
        if !on_one_line(least, best.len()) {
            break;
        }
        let Some(count) = NonZero::new(widened.min(points.len())) else { break };
        let near = nearest(count);
        let radius = near.last().map_or(0.0, |&i| (points[i as usize] - at).length());
        let spacing = radius * (std::f64::consts::PI / k.get() as f64).sqrt();
        let spread = evenly_spread(&near, points, EVEN_SPACING * spacing);
        let share = share_on_line(&places(&spread, points), at);
        if share < least {
            (least, best) = (share, spread);
        }
    }
    best
}

/// Some of the points, nearest first, that are at least `spacing` apart.
fn evenly_spread(numbers: &[u32], points: &[DVec3], spacing: f64) -> Vec<u32> {
    let mut chosen: Vec<u32> = Vec::new();
    for &i in numbers {
        let near = |&j: &u32| (points[i as usize] - points[j as usize]).length() < spacing;
        if !chosen.iter().any(near) {
            chosen.push(i);
        }
    }
    chosen
}

/// The points of some numbers.
pub(crate) fn places(numbers: &[u32], points: &[DVec3]) -> Vec<DVec3> {
    numbers.iter().map(|&i| points[i as usize]).collect()
}

/// True if more points lie near a line than by chance, given their share.
pub(crate) fn on_one_line(share: f64, points: usize) -> bool {
    // A strip through the middle of a disc has this share of its area, if it is narrow.
    let by_chance = 4.0 / std::f64::consts::PI * LINE_WIDTH;
    let others = points.saturating_sub(1).max(1) as f64;
    share > by_chance + MAX_EXCESS * (by_chance * (1.0 - by_chance) / others).sqrt()
}

/// Share of points near a line through one of them, itself left out, in the direction in which they extend
/// farthest.
pub(crate) fn share_on_line(points: &[DVec3], at: DVec3) -> f64 {
    let farthest = points.iter().map(|p| (*p - at).length_squared()).fold(0.0, f64::max);
    // The longest direction, by power iteration from the farthest point.
    let mut axis = points
        .iter()
        .map(|p| *p - at)
        .max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
        .unwrap_or(DVec3::ZERO)
        .normalize_or_zero();
    for _ in 0..2 {
        axis = points.iter().map(|p| (*p - at).dot(axis) * (*p - at)).sum::<DVec3>().normalize_or_zero();
    }
    let on_line = |p: &&DVec3| (**p - at).cross(axis).length_squared() <= LINE_WIDTH.powi(2) * farthest;
    // The place itself is on every line.
    (points.iter().filter(on_line).count() as f64 - 1.0) / (points.len() as f64 - 1.0).max(1.0)
}

/// The eigenvector of least variance of a few points and that variance over the sum of all three, by the
/// closed form for symmetric 3 × 3 matrices.
pub(crate) fn flattest_direction(points: &[DVec3]) -> (DVec3, f64) {
    let mean = mean(points);
    let mut m = [DVec3::ZERO; 3];
    for p in points {
        let d = *p - mean;
        for i in 0..3 {
            m[i] += d[i] * d;
        }
    }
    let trace = m[0][0] + m[1][1] + m[2][2];
    if trace <= 0.0 {
        return (DVec3::ZERO, 1.0);
    }
    let q = trace / 3.0;
    let off = m[0][1].powi(2) + m[0][2].powi(2) + m[1][2].powi(2);
    let p =
        (((m[0][0] - q).powi(2) + (m[1][1] - q).powi(2) + (m[2][2] - q).powi(2) + 2.0 * off) / 6.0).sqrt();
    if p <= 1e-12 * trace {
        return (DVec3::ZERO, 1.0);
    }
    // The trigonometric solution for the smallest eigenvalue, without iteration: this runs for every point.
    // It loses accuracy for nearly equal eigenvalues, for which the normal is arbitrary anyway.
    let less = |diagonal: f64| -> [DVec3; 3] {
        std::array::from_fn(|i| {
            let mut row = m[i];
            row[i] -= diagonal;
            row
        })
    };
    let b = less(q).map(|row| row / p);
    let r = (0.5 * b[0].dot(b[1].cross(b[2]))).clamp(-1.0, 1.0);
    let smallest = q + 2.0 * p * (r.acos() / 3.0 + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    let shifted = less(smallest);
    // The null vector is the longest of the rows' cross products.
    let candidates =
        [shifted[0].cross(shifted[1]), shifted[1].cross(shifted[2]), shifted[2].cross(shifted[0])];
    let best = candidates.into_iter().max_by(|a, b| a.length().total_cmp(&b.length())).unwrap_or(DVec3::ZERO);
    (best.normalize_or_zero(), smallest / trace)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cloud_geometry, surface_consensus};
    use planish_core::random::{SplitMix64, unit_interval};

    /// A tube of radius 20 and length 100, scanned along circles `ratio` times farther apart than their
    /// points are.
    fn scanned_tube(count: usize, ratio: f64) -> Vec<DVec3> {
        let mut random = SplitMix64::new(5);
        let mut draw = || unit_interval(random.next_u64());
        let between = (std::f64::consts::TAU * 20.0 * 100.0 / count as f64 * ratio).sqrt();
        (0..count)
            .map(|_| {
                let angle = std::f64::consts::TAU * draw();
                let z = (100.0 * draw() / between).round() * between;
                let noise = DVec3::new(draw(), draw(), draw()) - DVec3::splat(0.5);
                DVec3::new(20.0 * angle.cos(), 20.0 * angle.sin(), z) + 0.17 * noise
            })
            .collect()
    }

    /// Share of normals that are off by more than 37°.
    fn wrong_share(points: &[DVec3], normals: &[DVec3]) -> f64 {
        let radial = |p: &DVec3| DVec3::new(p.x, p.y, 0.0).normalize();
        let wrong = points.iter().zip(normals).filter(|(p, n)| radial(p).dot(**n).abs() < 0.8);
        wrong.count() as f64 / points.len() as f64
    }

    #[test]
    fn neighbours_of_scan_lines_show_the_surface() {
        for (ratio, limit) in [(3.0, 0.003), (5.0, 0.01), (10.0, 0.1)] {
            let points = scanned_tube(10_000, ratio);
            let nearest = cloud_geometry(&points, 12).unwrap().normals;
            assert!(wrong_share(&points, &nearest) < 0.002, "{ratio}: {}", wrong_share(&points, &nearest));
            let found = surface_consensus(&points).unwrap().unwrap();
            let share = wrong_share(&points, &found.normals);
            assert!(share < limit, "{ratio}: {share}");
        }
    }

    #[test]
    fn neighbours_that_surround_a_point_are_the_nearest() {
        let points: Vec<DVec3> =
            (0..400).map(|k| DVec3::new((k % 20) as f64, (k / 20) as f64, 0.0)).collect();
        let near = surrounding(&tree(&points).unwrap(), &points, points[210], NonZero::new(9).unwrap());
        assert!(near.iter().all(|&i| (points[i as usize] - points[210]).length() < 1.5), "{near:?}");
        // On a single line there are no others to take.
        let line: Vec<DVec3> = (0..400).map(|k| DVec3::new(k as f64, 0.0, 0.0)).collect();
        let near = surrounding(&tree(&line).unwrap(), &line, line[200], NonZero::new(9).unwrap());
        assert_eq!(near.len(), 9);
    }
}
