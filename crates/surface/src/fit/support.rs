//! Which places of a surface its readings support.
//!
//! In: feet of readings on the surface. Out: the cells of a [`Support`](crate::model::Support). Each reading
//! has a spacing `h`, a property of its neighbourhood: for evenly spread readings `h = 1/√ρ` with `ρ`
//! readings per area. A place is supported if its nearest reading is within `h`, or if readings within `2.5
//! h` lie around it: directions to them leave no gap of 180° or more. Extrapolation therefore ends one
//! spacing beyond the last reading, and holes of more than a few spacings stay open. On closed surfaces it
//! ends a quarter of a spacing beyond: readings of objects end at edges, where the surface turns away.
//!
//! Two estimates of `h` are compared, and the larger one counts. The distance `d` to the eighth neighbour
//! gives `d √(π/8)`. Scan lines are dense along the line only; their spacing is the radius within which
//! neighbours lie on all sides. At the rim of the readings both are too large, and those of gross errors
//! beyond the rim even more so: `h` is at most the median over the closest readings, and a reading whose
//! own spacing is more than twice that supports nothing.
//!
//! Feet are used instead of readings, so that noise across the surface does not enlarge the spacing.
//!
//! Not guaranteed: that scan lines are recognised whose spacing along the line is less than a twentieth of
//! that between lines; places between such lines count as not observed.

use crate::fit::leaves::neighbourhood;
use crate::model::{MAX_SUPPORT_DEPTH, Observed, SupportCell, middles};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::vector3::{as_arrays, tangents};
use planish_core::{DVec3, DisjointSets};
use planish_estimate::{Error, Result};
use planish_spline::Surface;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::num::NonZero;

/// Distance in spacings up to which a reading supports a place that has readings on other sides as well.
const REACH: f64 = 2.5;
/// Distance in spacings up to which a single reading supports a place.
const REACH_ALONE: f64 = 1.0;
/// The same for closed surfaces at a rim, where no readings are on the other side.
const REACH_AT_RIM: f64 = 0.25;
/// Widest gap between the directions to the neighbours of a reading that is not at a rim. 23 neighbours on
/// all sides leave 45°, and those of a reading at a straight rim 150° or more.
const GAP_INSIDE: f64 = 1.75;
/// The neighbour whose distance gives the spacing. Fewer neighbours make it noisy; more blur its changes.
const SPACING_NEIGHBOUR: usize = 8;
/// Neighbours searched for readings on all sides.
const NEIGHBOURS: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(23);
/// A reading supports nothing if its spacing is more than this many times the median of its closest
/// readings, of which there are so many, itself included.
const ALONE: f64 = 2.0;
const CLOSE: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(8);
/// A group of fewer readings without a link to others supports nothing, if there are so many in all. Of a
/// sample of the readings, a group has at least so many.
const MIN_ISLAND: usize = 12;
const MIN_SAMPLED_ISLAND: usize = 4;
const MIN_FOR_ISLANDS: usize = 100;
/// Readings near a place that are examined. Within the reach are 20 of evenly spread readings.
const CANDIDATES: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(31);
/// Readings that are examined first. Inside of the data they suffice.
const FIRST_CANDIDATES: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(7);
/// Readings whose spacing is computed; the others have that of the nearest of these. Spacing varies slowly.
const MAX_SAMPLE: usize = 20_000;
/// Neighbours that must be enclosed themselves to show the radius that encloses a reading.
const MIN_ENCLOSED: usize = 6;
/// Radius within which evenly spread neighbours lie on all sides, in spacings (median of Poisson points).
const ENCLOSING_RADIUS: f64 = 1.25;
/// Smallest cosine between the normals of a place and a reading on the same side of a thin part.
const SAME_SIDE: f64 = 0.3;
/// Largest side in spacings of the bins by which a leaf full of readings is recognised, where these are not
/// limited by [`OCCUPANCY_DEPTH`]. Of evenly spread readings, one bin in 55 is empty by chance.
const BIN: f64 = 2.0;
/// Divisions of an unobserved leaf, for the distance to the readings.
const DEPTH_OF_DISTANCES: u8 = 2;

/// Points of a surface with readings, and the spacing of these.
pub(super) struct Supporters {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    spacing: Vec<f64>,
    /// Whether neighbours lie on all sides; empty if it was found for a sample only.
    is_inside: Vec<bool>,
    tree: ImmutableKdTree<f64, 3>,
    reach_alone: f64,
}

/// A point of the surface with a reading, and the normal there.
pub(super) struct NearestFoot {
    pub point: DVec3,
    pub normal: DVec3,
}

impl Supporters {
    /// From surface points with readings and the normals there; none without points.
    ///
    /// # Errors
    /// `Undetermined` if the points cannot be searched.
    pub(super) fn new(points: Vec<DVec3>, normals: Vec<DVec3>) -> Result<Option<Self>> {
        if points.is_empty() {
            return Ok(None);
        }
        let tree = search_tree(&points)?;
        let step = points.len().div_ceil(MAX_SAMPLE);
        let sample: Vec<usize> = (0..points.len()).step_by(step).collect();
        let places: Vec<DVec3> = sample.iter().map(|&k| points[k]).collect();
        let of_sample: Vec<OwnSpacings> = (sample.par_iter().with_min_len(64))
            .map(|&k| own_spacings(&tree, &points, points[k], normals[k]))
            .collect();
        let nearest = search_tree(&places)?;
        // At the rim of the data and of holes, neighbours on all sides are far away. The median over a
        // neighbourhood is that of the readings inside.
        let neighbours: Vec<Vec<(u32, f64)>> = (places.par_iter().with_min_len(64))
            .map(|p| {
                let near = nearest.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(NEIGHBOURS).execute();
                near.iter().map(|n| (n.item, n.distance.sqrt())).collect()
            })
            .collect();
        let smoothed: Vec<f64> = (neighbours.par_iter().with_min_len(64).zip(&of_sample))
            .map(|(near, own)| {
                let others = || near.iter().map(|(k, _)| of_sample[*k as usize]);
                let mut enclosing: Vec<f64> = others().filter_map(|other| other.enclosing).collect();
                // At the rim, few are enclosed; between scan lines far apart, none is.
                if enclosing.len() < MIN_ENCLOSED {
                    enclosing = others().map(|other| other.farthest).collect();
                }
                let middle = enclosing.len() / 2;
                let median = *enclosing.select_nth_unstable_by(middle, f64::total_cmp).1;
                own.spacing.max(median / ENCLOSING_RADIUS)
            })
            .collect();
        // A gross error near the continuation of a surface is alone, while neighbours of a reading of the
        // surface are as far apart as its own are from it: twice as far at a corner of the data. There, its
        // own spacing would reach too far.
        let limited: Vec<f64> = (places.par_iter().with_min_len(64).zip(&smoothed))
            .map(|(p, own)| {
                let near = nearest.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(CLOSE).execute();
                let mut around: Vec<f64> = near.iter().skip(1).map(|n| smoothed[n.item as usize]).collect();
                let middle = around.len() / 2;
                if around.is_empty() {
                    return *own;
                }
                let typical = *around.select_nth_unstable_by(middle, f64::total_cmp).1;
                if *own > ALONE * typical { 0.0 } else { own.min(typical) }
            })
            .collect();
        // Places of the sample are √step spacings of the readings apart.
        let reach = REACH * (step as f64).sqrt();
        let fewest = MIN_ISLAND.div_ceil(step).max(MIN_SAMPLED_ISLAND);
        let limited = without_islands(&neighbours, limited, reach, fewest);
        // A gross error outside of the sample would have the spacing of a reading far away.
        let spacing = (points.par_iter().with_min_len(256))
            .map(|p| {
                let near = nearest.query(p.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
                let own = limited[near.item as usize];
                if near.distance.sqrt() <= reach * own { own } else { 0.0 }
            })
            .collect();
        let is_inside = match step {
            1 => of_sample.iter().map(|own| own.gap < GAP_INSIDE).collect(),
            _ => Vec::new(),
        };
        Ok(Some(Self { points, normals, spacing, is_inside, tree, reach_alone: REACH_ALONE }))
    }

    /// The same for a closed surface.
    pub(super) fn on_closed_surface(self) -> Self {
        Self { reach_alone: REACH_AT_RIM, ..self }
    }

    fn is_on_closed_surface(&self) -> bool {
        self.reach_alone < REACH_ALONE
    }

    /// The median spacing.
    pub(super) fn median_spacing(&self) -> f64 {
        let mut spacing = self.spacing.clone();
        let middle = spacing.len() / 2;
        *spacing.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// Distance of a place to the nearest reading, and the spacing of that reading.
    pub(super) fn nearest(&self, p: DVec3) -> (f64, f64) {
        let near = self.tree.query(p.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
        (near.distance.sqrt(), self.spacing[near.item as usize])
    }

    /// The points of the surface with readings.
    pub(super) fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The normals of the surface there.
    pub(super) fn normals(&self) -> &[DVec3] {
        &self.normals
    }

    /// The nearest point with a reading; none if that reading is alone and supports nothing.
    pub(super) fn nearest_foot(&self, p: DVec3) -> Option<NearestFoot> {
        let near = self.tree.query(p.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
        let k = near.item as usize;
        (self.spacing[k] > 0.0).then(|| NearestFoot { point: self.points[k], normal: self.normals[k] })
    }

    /// Whether the readings support a place with the given normal.
    fn support(&self, p: DVec3, normal: DVec3) -> bool {
        // Most places are beside a reading inside of the data, which one cheap search shows.
        let nearest = self.tree.query(p.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
        let k = nearest.item as usize;
        let is_inside = self.is_inside.get(k).copied().unwrap_or(false);
        let reach = if is_inside { REACH_ALONE } else { self.reach_alone };
        if nearest.distance.sqrt() <= reach * self.spacing[k] && self.normals[k].dot(normal) >= SAME_SIDE {
            return true;
        }
        // Farther readings take no support away, so a few that suffice decide.
        self.is_supported_by(p, normal, FIRST_CANDIDATES) || self.is_supported_by(p, normal, CANDIDATES)
    }

    /// Whether the nearest readings, of a number, support a place with the given normal.
    fn is_supported_by(&self, p: DVec3, normal: DVec3, count: NonZero<usize>) -> bool {
        let (e1, e2) = tangents(normal);
        let near = self.tree.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let mut directions = Vec::with_capacity(near.len());
        // Readings beyond an edge show that the data do not end there, though they support no place before
        // it.
        let mut of_all_sides = Vec::with_capacity(near.len());
        let mut is_near = false;
        for found in near {
            let k = found.item as usize;
            let (distance, h) = (found.distance.sqrt(), self.spacing[k]);
            if distance > REACH * h {
                continue;
            }
            let to = self.points[k] - p;
            let direction = to.dot(e2).atan2(to.dot(e1));
            of_all_sides.push(direction);
            if self.normals[k].dot(normal) < SAME_SIDE {
                continue;
            }
            if distance <= self.reach_alone * h {
                return true;
            }
            is_near |= distance <= REACH_ALONE * h;
            directions.push(direction);
        }
        widest_gap(&mut directions) < PI || (is_near && widest_gap(&mut of_all_sides) < PI)
    }
}

/// The spacings of places, where those of small groups apart from the others are 0: a few gross errors near
/// the continuation of a surface lie within a few of their own spacings of each other, but not within a few
/// spacings of the surface's readings. `neighbours` holds their numbers and distances for each place; links
/// are up to `reach` spacings long, and a small group has less than `fewest` places.
fn without_islands(
    neighbours: &[Vec<(u32, f64)>],
    mut spacing: Vec<f64>,
    reach: f64,
    fewest: usize,
) -> Vec<f64> {
    if spacing.len() < MIN_FOR_ISLANDS {
        return spacing;
    }
    let mut groups = DisjointSets::new(spacing.len());
    for (k, near) in neighbours.iter().enumerate() {
        for &(other, distance) in near {
            if distance <= reach * spacing[k].min(spacing[other as usize]) {
                groups.join(k as u32, other);
            }
        }
    }
    let roots = groups.into_roots();
    let mut sizes = vec![0; spacing.len()];
    roots.iter().for_each(|&root| sizes[root as usize] += 1);
    for (h, root) in spacing.iter_mut().zip(roots) {
        if sizes[root as usize] < fewest {
            *h = 0.0;
        }
    }
    spacing
}

/// A search structure of points, of which there is at least one.
///
/// # Errors
/// `Undetermined` if too many points agree in a coordinate.
pub(super) fn search_tree(points: &[DVec3]) -> Result<ImmutableKdTree<f64, 3>> {
    ImmutableKdTree::new_from_slice(as_arrays(points))
        .map_err(|e| Error::undetermined(format!("the readings cannot be searched: {e:?}")))
}

/// The widest angle between neighbouring directions; 2π of fewer than two.
fn widest_gap(directions: &mut [f64]) -> f64 {
    directions.sort_unstable_by(f64::total_cmp);
    let (Some(first), Some(last)) = (directions.first(), directions.last()) else { return 2.0 * PI };
    let across = first + 2.0 * PI - last;
    directions.windows(2).map(|pair| pair[1] - pair[0]).fold(across, f64::max)
}

/// Distances from a reading to its neighbours.
#[derive(Clone, Copy, Default)]
struct OwnSpacings {
    /// Spacing by the distance to a neighbour.
    spacing: f64,
    /// Radius within which neighbours lie on all sides; none if those that are searched do not.
    enclosing: Option<f64>,
    farthest: f64,
    /// Widest gap between the directions to all neighbours that are searched.
    gap: f64,
}

fn own_spacings(tree: &ImmutableKdTree<f64, 3>, points: &[DVec3], p: DVec3, normal: DVec3) -> OwnSpacings {
    let (e1, e2) = tangents(normal);
    let near = tree.query(p.as_ref()).nearest_n::<SquaredEuclidean<f64>>(NEIGHBOURS).execute();
    // Readings at one place (several sensors, repeated touches) are no neighbours of each other.
    let others: Vec<(f64, DVec3)> = (near.iter())
        .filter(|n| n.distance > 0.0)
        .map(|n| (n.distance.sqrt(), points[n.item as usize] - p))
        .collect();
    let Some(&(farthest, _)) = others.last() else { return OwnSpacings::default() };
    let count = others.len().min(SPACING_NEIGHBOUR);
    let mut all: Vec<f64> = others.iter().map(|(_, to)| to.dot(e2).atan2(to.dot(e1))).collect();
    let mut directions = Vec::with_capacity(others.len());
    let enclosing = others.iter().zip(&all).find_map(|((distance, _), direction)| {
        directions.push(*direction);
        (widest_gap(&mut directions) < PI).then_some(*distance)
    });
    let spacing = others[count - 1].0 * (PI / count as f64).sqrt();
    OwnSpacings { spacing, enclosing, farthest, gap: widest_gap(&mut all) }
}

/// Where the readings of a leaf lie: a bit for each of 8 × 8 bins of its parameter square.
pub(super) type Occupancy = u64;

/// Divisions of the bins of an [`Occupancy`].
pub(super) const OCCUPANCY_DEPTH: u8 = 3;

/// The bit of a place in leaf-local coordinates.
pub(super) fn occupancy_at(local: [f64; 2]) -> Occupancy {
    let [i, j] = local.map(|x| ((8.0 * x).max(0.0) as u32).min(7));
    1 << (8 * j + i)
}

/// Whether every one of `2ᵈ × 2ᵈ` bins has a reading.
fn is_full(occupied: Occupancy, depth: u8) -> bool {
    let width = 8_u32 >> depth;
    let side = 1_u32 << depth;
    (0..side * side).all(|bin| {
        let [i, j] = [bin % side, bin / side].map(|c| c * width);
        let row = ((1_u64 << width) - 1) << i;
        (0..width).any(|r| occupied >> (8 * (j + r)) & row != 0)
    })
}

/// The cells of every leaf, by the readings alone.
///
/// `occupied` holds the bins with readings of each leaf. `measured` are readings; `inferred` are readings
/// inferred from others, if there are any.
pub(super) fn supported_cells(
    surface: &Surface,
    occupied: &[Occupancy],
    measured: &Supporters,
    inferred: Option<&Supporters>,
) -> Vec<(u8, Vec<SupportCell>)> {
    let typical = measured.median_spacing();
    (0..occupied.len())
        .into_par_iter()
        .with_min_len(16)
        .map(|leaf| {
            let jet = surface.leaf_jet(leaf, 0.5, 0.5);
            let side = surface.space().leaves()[leaf].side();
            // At a steep rim, a leaf is stretched towards one side.
            let stretch = [[0.0, 0.0], [1.0, 0.0], [0.5, 0.5], [0.0, 1.0], [1.0, 1.0]].map(|[s, t]| {
                let jet = surface.leaf_jet(leaf, s, t);
                jet.du.length().max(jet.dv.length())
            });
            let length = side * stretch.into_iter().fold(0.0, f64::max);
            let (distance, spacing) = measured.nearest(jet.point);
            let divisions = |size: f64| (length / size.max(f64::MIN_POSITIVE)).log2();
            let bins = (divisions(BIN * spacing).ceil().max(1.0) as u8).min(OCCUPANCY_DEPTH);
            // Bins at a rim are full, too, if readings end within them; the leaf beyond has none then.
            let is_at_rim = || {
                measured.is_on_closed_surface()
                    && neighbourhood(surface.space(), leaf).into_iter().any(|other| occupied[other] == 0)
            };
            if is_full(occupied[leaf], bins) && !is_at_rim() {
                return (0, vec![SupportCell { observed: Observed::Measured, distance: 0.0 }]);
            }
            let depth = (divisions(spacing).ceil().max(0.0) as u8).min(MAX_SUPPORT_DEPTH);
            // The nearest reading may be alone, with a spacing of 0.
            let reach = REACH * spacing.max(typical);
            let is_near = occupied[leaf] != 0 || distance < length + reach || inferred.is_some();
            let depth = if is_near { depth } else { DEPTH_OF_DISTANCES.min(depth) };
            let cell = |local: [f64; 2]| cell_at(surface, leaf, local, measured, inferred);
            collapsed(depth, middles(depth).map(cell).collect())
        })
        .collect()
}

fn cell_at(
    surface: &Surface,
    leaf: usize,
    local: [f64; 2],
    measured: &Supporters,
    inferred: Option<&Supporters>,
) -> SupportCell {
    let jet = surface.leaf_jet(leaf, local[0], local[1]);
    let normal = jet.normal().unwrap_or(DVec3::Z);
    if measured.support(jet.point, normal) {
        return SupportCell { observed: Observed::Measured, distance: 0.0 };
    }
    let is_inferred = inferred.is_some_and(|inferred| inferred.support(jet.point, normal));
    let observed = if is_inferred { Observed::Inferred } else { Observed::PriorOnly };
    SupportCell { observed, distance: measured.nearest(jet.point).0 }
}

/// One cell instead of many if all are measured.
pub(super) fn collapsed(depth: u8, cells: Vec<SupportCell>) -> (u8, Vec<SupportCell>) {
    match cells.iter().all(|cell| cell.observed.is_measured()) {
        true => (0, vec![SupportCell { observed: Observed::Measured, distance: 0.0 }]),
        false => (depth, cells),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn on_plane(points: Vec<[f64; 2]>) -> Supporters {
        let normals = vec![DVec3::Z; points.len()];
        Supporters::new(points.iter().map(|p| DVec3::new(p[0], p[1], 0.0)).collect(), normals)
            .unwrap()
            .unwrap()
    }

    fn is_supported(by: &Supporters, x: f64, y: f64) -> bool {
        by.support(DVec3::new(x, y, 0.0), DVec3::Z)
    }

    fn scattered(seed: u64, count: usize, hole: f64) -> Vec<[f64; 2]> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| [rng.random::<f64>(), rng.random::<f64>()].map(|x| 100.0 * x - 50.0))
            .filter(|p| p[0].hypot(p[1]) > hole)
            .collect()
    }

    /// Spacing 1. Of places on a fine grid, the share that is supported, within a radius and outside of it.
    #[test]
    fn a_hole_of_ten_spacings_is_open_and_the_rest_is_supported() {
        for seed in 0..5 {
            let by = on_plane(scattered(seed, 10_000, 5.0));
            let mut spacing = by.spacing.clone();
            spacing.sort_unstable_by(f64::total_cmp);
            let median = spacing[spacing.len() / 2];
            assert!((median - 1.0).abs() < 0.1, "{median}");
            let (mut inside, mut outside) = ([0, 0], [0, 0]);
            for k in 0..10_000 {
                let [x, y] = [k % 100, k / 100].map(|c| f64::from(c) * 0.6 - 30.0);
                let radius = x.hypot(y);
                let sum = if radius < 3.0 { &mut inside } else { &mut outside };
                if !(3.0..6.0).contains(&radius) {
                    sum[0] += 1;
                    sum[1] += usize::from(is_supported(&by, x, y));
                }
            }
            // Where readings happen to be sparse, their reach is longer.
            assert!(inside[1] as f64 <= 0.05 * inside[0] as f64, "seed {seed}: {inside:?}");
            assert!(outside[1] as f64 > 0.999 * outside[0] as f64, "seed {seed}: {outside:?}");
        }
    }

    /// Spacings are those of all readings, also where they are computed for a sample.
    #[test]
    fn many_readings_support_the_surface_between_them() {
        for count in [30_000, 500_000] {
            let by = on_plane(scattered(7, count, 0.0));
            let inside = (0..10_000).map(|k| [k % 100, k / 100].map(|c| f64::from(c) * 0.95 - 47.0));
            let supported = inside.filter(|[x, y]| is_supported(&by, *x, *y)).count();
            assert!(supported > 9990, "{count}: {supported}");
        }
    }

    #[test]
    fn a_few_readings_apart_from_the_others_support_nothing() {
        for seed in 0..5 {
            let mut points = scattered(seed, 2500, 0.0);
            points.extend(scattered(seed + 10, 6, 0.0).iter().map(|p| [80.0 + 0.2 * p[0], p[1]]));
            let by = on_plane(points.clone());
            assert!(points[2500..].iter().all(|p| !is_supported(&by, p[0] + 0.1, p[1])), "seed {seed}");
            assert!(is_supported(&by, 0.0, 0.0));
            // As many as a cluster they are a part of their own.
            points.extend(scattered(seed + 20, 30, 0.0).iter().map(|p| [80.0 + 0.2 * p[0], p[1]]));
            let by = on_plane(points.clone());
            let supported = points[2500..].iter().filter(|p| is_supported(&by, p[0], p[1])).count();
            assert!(supported > 25, "seed {seed}: {supported}");
        }
    }

    #[test]
    fn short_scan_lines_far_apart_are_no_islands() {
        let lines =
            (0..11).flat_map(|line| (0..11).map(move |k| [f64::from(k) * 0.25, f64::from(line) * 2.0]));
        let by = on_plane(lines.collect());
        assert!(is_supported(&by, 1.2, 9.0) && is_supported(&by, 1.2, 11.0));
    }

    #[test]
    fn places_between_scan_lines_are_supported_and_places_beyond_them_are_not() {
        let lines =
            (0..40).flat_map(|line| (0..400).map(move |k| [f64::from(k) * 0.25, f64::from(line) * 2.0]));
        let by = on_plane(lines.collect());
        for k in 0..30 {
            let (x, y) = (10.0 + 2.7 * f64::from(k), 10.0 + 1.7 * f64::from(k));
            assert!(is_supported(&by, x, y), "({x}, {y})");
            assert!(!is_supported(&by, x, -8.0));
        }
    }

    #[test]
    fn sparse_readings_support_places_by_their_own_spacing() {
        let mut points = scattered(3, 400, 0.0);
        // A dense spot does not make the sparse readings around it worthless, nor does it reach farther.
        points.extend(scattered(4, 2000, 0.0).iter().map(|p| p.map(|x| 0.05 * x + 200.0)));
        let by = on_plane(points);
        assert!((0..40).all(|k| is_supported(&by, f64::from(k) - 20.0, 5.0)));
        assert!(is_supported(&by, 200.0, 200.0) && !is_supported(&by, 204.0, 200.0));
    }

    #[test]
    fn a_lone_reading_supports_no_surface_around_it() {
        for count in [10_000, 200_000] {
            let mut points = scattered(6, count, 0.0);
            points.extend([[75.0, 3.0], [-20.0, 90.0]]);
            let by = on_plane(points);
            for [x, y] in [[74.9, 3.0], [74.0, 3.0], [-20.0, 80.0], [-20.0, 89.9]] {
                assert!(!is_supported(&by, x, y), "{count}: ({x}, {y})");
            }
            let at_corner = (0..100).map(|k| [k % 10, k / 10].map(|c| 50.0 - 0.5 * f64::from(c)));
            let supported = at_corner.filter(|[x, y]| is_supported(&by, *x, *y)).count();
            assert!(supported > 85, "{count}: {supported} of 100 places at a corner of the data");
        }
    }

    #[test]
    fn the_other_side_of_a_thin_plate_is_not_supported() {
        let by = on_plane(scattered(5, 10_000, 0.0));
        assert!(by.support(DVec3::new(0.0, 0.0, 0.2), DVec3::Z));
        assert!(!by.support(DVec3::new(0.0, 0.0, -0.2), DVec3::Z.map(|c| -c)));
    }

    #[test]
    fn a_leaf_is_full_only_if_every_bin_is() {
        let all =
            (0..64).fold(0, |sum, k| sum | occupancy_at([k % 8, k / 8].map(|c| (f64::from(c) + 0.5) / 8.0)));
        assert_eq!(all, u64::MAX);
        let without = all & !occupancy_at([0.99, 0.01]);
        assert!(!is_full(without, 3) && is_full(without, 2) && is_full(without, 0));
        assert!(!is_full(0, 0) && !is_full(occupancy_at([0.1, 0.1]), 1));
    }
}
