//! Surface normals of raw scans, and checks of single readings.
//!
//! In: scans. Out: a unit normal for every point (zero if undetermined), and marks for points at depth edges
//! and grazing angles. Normals point towards the sensor if its viewpoint is known; otherwise they are
//! consistent over the cloud.
//!
//! Not guaranteed: without a viewpoint, distant parts of a cloud may be oriented differently.

use crate::neighbours::{flattest_direction, mean, on_one_line, places, share_on_line, surrounding, tree};
use crate::{Scan, Viewing};
use kiddo::SquaredEuclidean;
use planish_core::DVec3;
use planish_estimate::Result;
use rayon::prelude::*;
use std::collections::BinaryHeap;
use std::num::NonZero;

/// Reason to distrust a point, found in the scan itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum PointFlag {
    /// Nothing.
    None,
    /// A jump in depth to all of its neighbours: a gross error, or dust.
    Isolated,
    /// Next to a jump in depth: mixed readings and curled edges.
    DepthEdge,
    /// Seen at a grazing angle.
    Grazing,
}

/// Settings of the scan checks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanChecks {
    /// Minimum angle between ray and normal of a grazing reading, in degrees.
    pub grazing_deg: f64,
    /// Angle between the ray and the perpendicular of a grid edge above which the edge is a jump in depth, in
    /// degrees.
    pub jump_deg: f64,
    /// Neighbours for normals of unorganised clouds.
    pub neighbours: usize,
}

impl Default for ScanChecks {
    fn default() -> Self {
        // At 80° the depth changes by 5.7 grid steps per step; beyond that, two neighbours are rarely on the
        // same surface.
        Self { grazing_deg: 78.0, jump_deg: 83.0, neighbours: 12 }
    }
}

/// A reading with fewer grid neighbours is not tested for isolation.
const MIN_NEIGHBOURS: u32 = 4;

/// Normals and suspicions of one scan, in its own frame.
#[derive(Debug, Clone, Default)]
pub struct ScanGeometry {
    /// Unit normals, zero where unknown.
    pub normals: Vec<DVec3>,
    /// The mark of each point.
    pub flags: Vec<PointFlag>,
    /// True if the normals point towards the sensor.
    pub oriented: bool,
}

/// Unit direction of the ray that hit `p`; `None` if the viewing is unknown.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::{Viewing, ray_at};
/// assert_eq!(ray_at(Viewing::Origin(DVec3::ZERO), 2.0 * DVec3::Z), Some(DVec3::Z));
/// assert_eq!(ray_at(Viewing::Unknown, DVec3::ZERO), None);
/// ```
#[must_use]
pub fn ray_at(viewing: Viewing, p: DVec3) -> Option<DVec3> {
    match viewing {
        Viewing::Unknown => None,
        Viewing::Direction(d) => d.try_normalize(),
        Viewing::Origin(o) => (p - o).try_normalize(),
    }
}

/// Normals and marks of a scan, from its own normals, else from its grid, else from nearest neighbours.
///
/// # Errors
/// `Undetermined` when an unorganised scan has fewer than three points.
pub fn scan_geometry(scan: &Scan, checks: &ScanChecks) -> Result<ScanGeometry> {
    let count = scan.points.len();
    let mut geometry =
        ScanGeometry { normals: Vec::new(), flags: vec![PointFlag::None; count], oriented: true };
    if let Some(grid) = &scan.grid {
        grid_geometry(scan, grid, checks, &mut geometry);
    } else {
        let cloud = cloud_geometry(&scan.points, checks.neighbours)?;
        geometry.normals = cloud.normals;
        geometry.oriented = scan.viewing != Viewing::Unknown;
        for (mark, _) in geometry.flags.iter_mut().zip(cloud.isolated).filter(|(_, i)| *i) {
            *mark = PointFlag::Isolated;
        }
    }
    if let Some(normals) = &scan.normals {
        geometry.normals = normals.iter().map(|&n| n.normalize_or_zero()).collect();
        geometry.oriented = true;
    }
    for i in 0..count {
        let Some(ray) = ray_at(scan.viewing, scan.points[i]) else {
            break;
        };
        let n = &mut geometry.normals[i];
        // Estimated normals have no sign of their own; stated ones are not changed.
        if scan.normals.is_none() && n.dot(ray) > 0.0 {
            *n = -(*n);
        }
        let facing = -n.dot(ray);
        if geometry.flags[i] == PointFlag::None
            && n.length() > 0.5
            && facing < checks.grazing_deg.to_radians().cos()
        {
            geometry.flags[i] = PointFlag::Grazing;
        }
    }
    Ok(geometry)
}

/// Normals from the triangles of each grid square, without triangles across a jump in depth.
fn grid_geometry(scan: &Scan, grid: &crate::RangeGrid, checks: &ScanChecks, geometry: &mut ScanGeometry) {
    let count = scan.points.len();
    let mut sums = vec![DVec3::ZERO; count];
    let mut at_jump = vec![false; count];
    let jump = checks.jump_deg.to_radians().sin();
    let is_jump = |a: usize, b: usize| {
        let edge = scan.points[b] - scan.points[a];
        match (edge.try_normalize(), ray_at(scan.viewing, scan.points[a])) {
            // The edge's slope against the plane across the ray.
            (Some(direction), Some(ray)) => direction.dot(ray).abs() > jump,
            _ => false,
        }
    };
    // A gross error must not cost its eight neighbours: it is found first and then counts as absent.
    let mut isolated = vec![false; count];
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let Some(own) = grid.point(column, row) else {
                continue;
            };
            let (mut neighbours, mut jumps) = (0, 0);
            for r in row.saturating_sub(1)..(row + 2).min(grid.rows) {
                for c in column.saturating_sub(1)..(column + 2).min(grid.columns) {
                    if let Some(other) = grid.point(c, r).filter(|&other| other != own) {
                        neighbours += 1;
                        jumps += u32::from(is_jump(own, other));
                    }
                }
            }
            // One neighbour may agree by chance, for example a second gross error.
            isolated[own] = neighbours >= MIN_NEIGHBOURS && jumps + 1 >= neighbours;
        }
    }
    let point = |column: usize, row: usize| grid.point(column, row).filter(|&i| !isolated[i]);
    for row in 0..grid.rows.saturating_sub(1) {
        for column in 0..grid.columns.saturating_sub(1) {
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(dc, dr)| point(column + dc, row + dr));
            let present: Vec<usize> = corners.iter().flatten().copied().collect();
            if present.len() < 3 {
                continue;
            }
            let mut triangle = |t: [usize; 3]| {
                let mut broken = false;
                for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                    if is_jump(a, b) {
                        at_jump[a] = true;
                        at_jump[b] = true;
                        broken = true;
                    }
                }
                if broken {
                    return;
                }
                let [a, b, c] = t.map(|i| scan.points[i]);
                // Not normalised: large triangles, whose normals are more accurate, weigh more.
                let mut n = (b - a).cross(c - a);
                if let Some(ray) = ray_at(scan.viewing, a)
                    && n.dot(ray) > 0.0
                {
                    n = -n;
                }
                for i in t {
                    sums[i] += n;
                }
            };
            if present.len() == 3 {
                triangle([present[0], present[1], present[2]]);
            } else {
                // The shorter diagonal.
                let d = |a: usize, b: usize| (scan.points[present[a]] - scan.points[present[b]]).length();
                let split = if d(0, 2) <= d(1, 3) { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] };
                for t in split {
                    triangle(t.map(|k| present[k]));
                }
            }
        }
    }
    geometry.normals = sums.iter().map(|&n| n.normalize_or_zero()).collect();
    for (i, mark) in geometry.flags.iter_mut().enumerate() {
        if isolated[i] {
            *mark = PointFlag::Isolated;
        } else if at_jump[i] {
            *mark = PointFlag::DepthEdge;
        }
    }
}

/// Normals and isolated points of a cloud, from nearest neighbours.
#[derive(Debug, Clone, Default)]
pub struct CloudGeometry {
    /// Unit normals with arbitrary sign; zero if the neighbours determine none.
    pub normals: Vec<DVec3>,
    /// For each point, true if it is far from all others and not on a surface with them (dust, gross errors).
    pub isolated: Vec<bool>,
}

/// Minimum distance of a suspect point from its neighbours, as a multiple of the median over the cloud.
/// Smaller values reject sparse parts of surfaces.
const FAR_SPACINGS: f64 = 6.0;
/// A suspect point is kept if its neighbourhood is flat (smallest variance over their sum below
/// `MAX_FLATNESS`) and its neighbours surround it (offset over their spread at most `MAX_OFFSET_SPREADS`).
/// This keeps sparse regions of a surface.
const MAX_FLATNESS: f64 = 0.02;
const MAX_OFFSET_SPREADS: f64 = 1.0;

/// Estimates normals as the direction of least variance of each point's `k` nearest neighbours, and finds
/// isolated points.
///
/// Cost: one tree and one query per point, in parallel.
///
/// # Errors
/// `Undetermined` for fewer than three points.
///
/// # Examples
/// ```
/// use planish_core::DVec3;
/// use planish_sense::cloud_geometry;
/// let point = |i: u32| DVec3::new(f64::from(i % 10), f64::from(i / 10), 0.0);
/// let points: Vec<DVec3> = (0..100).map(point).collect();
/// let found = cloud_geometry(&points, 8)?;
/// assert!(found.normals.iter().all(|n| n[2].abs() > 0.999) && !found.isolated.contains(&true));
/// # Ok::<(), planish_estimate::Error>(())
/// ```
///
/// # References
/// Hoppe et al., *Surface reconstruction from unorganized points*, 1992.
pub fn cloud_geometry(points: &[DVec3], k: usize) -> Result<CloudGeometry> {
    let tree = tree(points)?;
    let k = NonZero::new(k.clamp(3, points.len())).unwrap_or(NonZero::<usize>::MIN);
    let found: Vec<(DVec3, f64, bool)> = points
        .par_iter()
        .with_min_len(256)
        .map(|p| {
            let near = tree.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(k).execute();
            let sample: Vec<DVec3> = near.iter().map(|n| points[n.item as usize]).collect();
            let distance = near.iter().map(|n| n.distance.sqrt()).sum::<f64>() / near.len() as f64;
            let (mut normal, flatness) = flattest_direction(&sample);
            if on_one_line(share_on_line(&sample, *p), sample.len()) {
                normal = flattest_direction(&places(&surrounding(&tree, points, *p, k), points)).0;
            }
            let others: Vec<DVec3> = sample.iter().copied().filter(|q| q != p).collect();
            let count = others.len().max(1) as f64;
            let middle = mean(&others);
            let spread = (others.iter().map(|q| (*q - middle).length_squared()).sum::<f64>() / count).sqrt();
            // Far from its neighbours alone is no evidence: sparse parts of a surface are, too.
            let on_surface = flatness < MAX_FLATNESS && (*p - middle).length() <= MAX_OFFSET_SPREADS * spread;
            (normal, distance, on_surface)
        })
        .collect();
    let mut distances: Vec<f64> = found.iter().map(|(_, distance, _)| *distance).collect();
    let middle = distances.len() / 2;
    let median = *distances.select_nth_unstable_by(middle, f64::total_cmp).1;
    Ok(CloudGeometry {
        isolated: found
            .iter()
            .map(|(_, distance, on_surface)| *distance > FAR_SPACINGS * median && !on_surface)
            .collect(),
        normals: found.into_iter().map(|(normal, ..)| normal).collect(),
    })
}

/// Median standard deviation of points from the planes of their neighbours, over a sample of the cloud.
///
/// It contains the noise and the curvature between neighbours. It is therefore an upper bound of the noise,
/// unless the errors of neighbours are correlated. `None` for clouds that are too small.
#[must_use]
pub fn local_roughness(points: &[DVec3], k: usize) -> Option<f64> {
    const MAX_SAMPLE: usize = 2000;
    if points.len() < 2 * k || k < 6 {
        return None;
    }
    let tree = tree(points).ok()?;
    let k = NonZero::new(k)?;
    // A sample of the points is sufficient for a median.
    let sample: Vec<DVec3> = points.iter().copied().step_by(points.len().div_ceil(MAX_SAMPLE)).collect();
    let mut found: Vec<f64> = sample
        .par_iter()
        .map(|p| {
            let near = tree.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(k).execute();
            let own: Vec<DVec3> = near.iter().map(|n| points[n.item as usize]).collect();
            let middle = mean(&own);
            let (normal, _) = flattest_direction(&own);
            let square: f64 = own.iter().map(|q| normal.dot(*q - middle).powi(2)).sum();
            // Three degrees of freedom go to the plane.
            (square / (own.len() as f64 - 3.0)).sqrt()
        })
        .collect();
    let middle = found.len() / 2;
    Some(*found.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Flips normals so that neighbours agree. It starts from the fixed ones. A part of the cloud that they do
/// not reach is turned so that the sum of `n · (p − c)` over its points `p` with centre `c` is positive:
/// for a closed surface it is three times the volume over the area of a point, whatever the shape. A flat
/// part, for which that is nearly zero, faces the side of the nearest points that it continues.
///
/// The method is greedy growth over the neighbour graph, most reliable pairs first. Between two points, the
/// surface is taken to be an arc, so the normal of one is the mirror image of the other's in the plane
/// between them. The two sides of a thin wall then face away from each other, and edges pass signs on.
///
/// # Errors
/// `Undetermined` for fewer than three points.
///
/// # References
/// Hoppe et al., *Surface reconstruction from unorganized points*, 1992, §3.3 (growth); König, Gumhold,
/// *Consistent propagation of normal orientations in point clouds*, 2009 (arcs between points).
pub fn orient_normals(points: &[DVec3], normals: &mut [DVec3], fixed: &[bool], k: usize) -> Result<()> {
    let tree = tree(points)?;
    let k = NonZero::new(k.clamp(3, points.len())).unwrap_or(NonZero::<usize>::MIN);
    let neighbours = (points.par_iter().with_min_len(256))
        .map(|p| surrounding(&tree, points, *p, k).into_boxed_slice())
        .collect();
    let mut growth = NormalGrowth { neighbours, done: fixed.to_vec(), queue: BinaryHeap::new() };
    for i in (0..points.len()).filter(|&i| fixed[i]) {
        growth.push_neighbours(points, normals, i);
    }
    growth.run(points, normals);
    // Parts in the order of their farthest points, so that the largest comes first.
    let middle = mean(points);
    let mut seeds: Vec<u32> = (0..points.len() as u32).collect();
    let from_middle = |i: u32| (points[i as usize] - middle).length();
    seeds.sort_by(|&a, &b| from_middle(b).total_cmp(&from_middle(a)));
    for seed in seeds.into_iter().map(|i| i as usize) {
        if growth.done[seed] {
            continue;
        }
        let turned = growth.turned_by_neighbour(points, normals, seed);
        if turned == Some(true) {
            normals[seed] = -normals[seed];
        }
        growth.done[seed] = true;
        growth.push_neighbours(points, normals, seed);
        let mut part = growth.run(points, normals);
        part.push(seed);
        let place = |&i: &usize| points[i];
        let centre = mean(&part.iter().map(place).collect::<Vec<_>>());
        let outwards: f64 = part.iter().map(|&i| normals[i].dot(points[i] - centre)).sum();
        let size: f64 = part.iter().map(|&i| points[i].distance(centre)).sum();
        let is_flat = part.len() >= MIN_FLAT_PART && outwards.abs() < MAX_FLAT * size;
        let is_turned = turned.is_none()
            && if is_flat { growth.continues_turned(points, normals, &part) } else { None }
                .unwrap_or(outwards < 0.0);
        if is_turned {
            part.into_iter().for_each(|i| normals[i] = -normals[i]);
        }
    }
    Ok(())
}

/// Smallest number of points of a flat part, and largest `Σ n · (p − c)` over `Σ |p − c|` of one: a
/// hemisphere has 0.6, an arc of 115° has 0.2.
const MIN_FLAT_PART: usize = 12;
const MAX_FLAT: f64 = 0.3;
/// Smallest cosine between the normals of the nearest points of a flat part and of the others that it
/// continues, and largest one between these normals and the line across the gap.
const CONTINUES: f64 = 0.8;
const ACROSS: f64 = 0.4;

/// The greedy growth of [`orient_normals`].
struct NormalGrowth {
    /// The points around each.
    neighbours: Vec<Box<[u32]>>,
    done: Vec<bool>,
    /// Reliability, and the numbers of a point and of its neighbour that is done.
    queue: BinaryHeap<(u64, u32, u32)>,
}

impl NormalGrowth {
    fn neighbours(&self, i: usize) -> impl Iterator<Item = usize> {
        self.neighbours[i].iter().map(|&j| j as usize)
    }

    fn push_neighbours(&mut self, points: &[DVec3], normals: &[DVec3], i: usize) {
        for j in self.neighbours(i).filter(|&j| !self.done[j]).collect::<Vec<_>>() {
            // The most reliable pair first: signs are passed on across sharp edges only if there is no other
            // way. Ties go to the smaller index, so that the result is the same in every run.
            let arc = Arc::between(points, normals, i, j);
            self.queue.push((arc.reliability, u32::MAX - j as u32, i as u32));
        }
    }

    /// Orients all points that the queue reaches, and returns them.
    fn run(&mut self, points: &[DVec3], normals: &mut [DVec3]) -> Vec<usize> {
        let mut reached = Vec::new();
        while let Some((_, j, i)) = self.queue.pop() {
            let (j, i) = ((u32::MAX - j) as usize, i as usize);
            if self.done[j] {
                continue;
            }
            if Arc::between(points, normals, i, j).is_turned {
                normals[j] = -normals[j];
            }
            self.done[j] = true;
            reached.push(j);
            self.push_neighbours(points, normals, j);
        }
        reached
    }

    /// Whether a flat part, which has no outside of its own, faces the other side than the nearest points
    /// that are done and that it continues, as an island in a sheet does; none if it continues none.
    fn continues_turned(&self, points: &[DVec3], normals: &[DVec3], part: &[usize]) -> Option<bool> {
        let mut is_other = self.done.clone();
        part.iter().for_each(|&i| is_other[i] = false);
        let others: Vec<usize> = (0..points.len()).filter(|&i| is_other[i]).collect();
        let places: Vec<DVec3> = others.iter().map(|&i| points[i]).collect();
        let tree = tree(&places).ok()?;
        let nearest = |&i: &usize| {
            let near = tree.query(points[i].as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
            (near.distance, i, others[near.item as usize])
        };
        let (_, own, other) = part.iter().map(nearest).min_by(|a, b| a.0.total_cmp(&b.0))?;
        let across = (points[own] - points[other]).normalize_or_zero();
        let is_beside = across.dot(normals[own]).abs() < ACROSS;
        let cosine = normals[own].dot(normals[other]);
        (is_beside && cosine.abs() > CONTINUES).then_some(cosine < 0.0)
    }

    /// Whether the most reliable neighbour that is done faces the other side; none if no neighbour is done.
    /// It may have been done without passing its side on, because it has nearer neighbours.
    fn turned_by_neighbour(&self, points: &[DVec3], normals: &[DVec3], i: usize) -> Option<bool> {
        (self.neighbours(i).filter(|&j| self.done[j]))
            .map(|j| (Arc::between(points, normals, j, i), std::cmp::Reverse(j)))
            .max_by_key(|(arc, j)| (arc.reliability, *j))
            .map(|(arc, _)| arc.is_turned)
    }
}

/// The surface between two points, as an arc on which both lie.
struct Arc {
    /// True if the normals of its ends face different sides.
    is_turned: bool,
    /// From 0 to 1, as an ordered integer: how parallel the normals are along the arc, and how far it is from
    /// leading through a wall. Of pairs across a wall some are as parallel as those on one side of it.
    reliability: u64,
}

impl Arc {
    fn between(points: &[DVec3], normals: &[DVec3], i: usize, j: usize) -> Self {
        let across = (points[j] - points[i]).normalize_or_zero();
        let expected = normals[i] - 2.0 * normals[i].dot(across) * across;
        let agreement = expected.dot(normals[j]);
        let through = normals[i].dot(across).abs().max(normals[j].dot(across).abs());
        let reliability = agreement.abs() * (1.0 - through * through);
        Self { is_turned: agreement < 0.0, reliability: (reliability.max(0.0) * 1e9) as u64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RangeGrid;

    fn sphere(n: usize) -> Vec<DVec3> {
        (0..n)
            .map(|i| {
                let z = 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
                let a = i as f64 * 2.399_963_229_728_653;
                let r = (1.0 - z * z).sqrt();
                DVec3::new(r * a.cos(), r * a.sin(), z)
            })
            .collect()
    }

    #[test]
    fn normals_of_an_unorganised_sphere_point_outwards() {
        let points = sphere(4000);
        let mut normals = cloud_geometry(&points, 12).unwrap().normals;
        orient_normals(&points, &mut normals, &vec![false; points.len()], 8).unwrap();
        for (p, n) in points.iter().zip(&normals) {
            assert!(p.dot(*n) > 0.99, "{p:?} {n:?}");
        }
    }

    /// The reading farthest from the centre is a gross error whose normal says nothing of the outside.
    #[test]
    fn one_gross_error_does_not_turn_a_tube_inside_out() {
        let mut points: Vec<DVec3> = (0..3000)
            .map(|k| {
                let angle = std::f64::consts::TAU * (f64::from(k) * 0.618_034).fract();
                DVec3::new(angle.cos(), angle.sin(), 4.0 * (f64::from(k) * 0.754_878).fract() - 2.0)
            })
            .collect();
        points.push(DVec3::new(0.9, 0.0, 3.0));
        let mut normals: Vec<DVec3> =
            points.iter().map(|p| DVec3::new(p[0], p[1], 0.0).normalize()).collect();
        for (k, normal) in normals.iter_mut().enumerate().filter(|(k, _)| k % 3 == 0) {
            *normal = if k < 3000 { -*normal } else { DVec3::new(0.1, 0.0, -1.0).normalize() };
        }
        orient_normals(&points, &mut normals, &vec![false; points.len()], 8).unwrap();
        let inwards = points.iter().zip(&normals).take(3000).filter(|(p, n)| p.dot(**n) < 0.0).count();
        assert_eq!(inwards, 0);
    }

    /// An island in a hole of a sheet has no outside of its own.
    #[test]
    fn an_island_faces_the_side_of_the_sheet_around_it() {
        let points: Vec<DVec3> = (0..5000)
            .map(|k| [(f64::from(k) * 0.618_034).fract(), (f64::from(k) * 0.754_878).fract()])
            .map(|at| at.map(|c| 60.0 * c - 30.0))
            .filter(|[x, y]| !(8.0..14.0).contains(&x.hypot(*y)))
            .map(|[x, y]| DVec3::new(x, y, 3.0 * (0.1 * x).sin()))
            .collect();
        let mut normals = cloud_geometry(&points, 12).unwrap().normals;
        for (k, normal) in normals.iter_mut().enumerate() {
            *normal = if k % 2 == 0 { *normal } else { -*normal };
        }
        orient_normals(&points, &mut normals, &vec![false; points.len()], 8).unwrap();
        let up = normals.iter().filter(|n| n.z > 0.0).count();
        assert!(up == 0 || up == points.len(), "{up} of {}", points.len());
    }

    /// A plate whose thickness is two spacings of its points: the nearest point of some is on its other side.
    #[test]
    fn sides_of_a_thin_plate_face_away_from_each_other() {
        let (half, height) = (15.0, 1.0);
        let points: Vec<DVec3> = (0..2000)
            .map(|k| [0.618_034, 0.754_878, 0.569_840].map(|step| (f64::from(k) * step).fract()))
            .map(|[u, v, w]| {
                let (along, across) = (half * (2.0 * v - 1.0), half * (2.0 * w - 1.0));
                let up = height * (2.0 * w - 1.0);
                match (100.0 * u) as u32 {
                    0..44 => DVec3::new(along, across, height),
                    44..88 => DVec3::new(along, across, -height),
                    88..91 => DVec3::new(half, along, up),
                    91..94 => DVec3::new(-half, along, up),
                    94..97 => DVec3::new(along, half, up),
                    _ => DVec3::new(along, -half, up),
                }
            })
            .collect();
        let mut normals = cloud_geometry(&points, 8).unwrap().normals;
        orient_normals(&points, &mut normals, &vec![false; points.len()], 8).unwrap();
        let faces = points
            .iter()
            .zip(&normals)
            .filter(|(p, n)| p.z.abs() == height && p.x.abs().max(p.y.abs()) < half - 2.0 && n.z.abs() > 0.7);
        let (mut all, mut inwards) = (0, 0);
        for (p, n) in faces {
            all += 1;
            inwards += usize::from(p.z * n.z < 0.0);
        }
        assert!(all > 1000 && inwards == 0, "{inwards} of {all} face into the plate");
    }

    #[test]
    fn only_steps_of_a_range_grid_are_depth_edges() {
        let (columns, rows) = (20, 10);
        let mut scan = Scan { viewing: Viewing::Direction(DVec3::new(0.0, 0.0, -1.0)), ..Scan::default() };
        let mut cells = Vec::new();
        for r in 0..rows {
            for c in 0..columns {
                cells.push(scan.points.len() as u32);
                scan.points.push(DVec3::new(
                    c as f64,
                    r as f64,
                    if c < 10 { 0.0 } else { 20.0 } + 0.3 * r as f64,
                ));
            }
        }
        scan.grid = Some(RangeGrid { columns, rows, cells });
        let geometry = scan_geometry(&scan, &ScanChecks::default()).unwrap();
        for (i, p) in scan.points.iter().enumerate() {
            let at_step = p[0] == 9.0 || p[0] == 10.0;
            assert_eq!(geometry.flags[i] == PointFlag::DepthEdge, at_step, "{p:?}");
            let n = geometry.normals[i];
            assert!((n[2] - 1.0 / 1.09_f64.sqrt()).abs() < 1e-12 && n[1] < 0.0, "{n:?}");
        }
    }
}
