//! How far the object departs from continuations of its measured surface.
//!
//! In: feet of readings with their normals, and the places without readings. Out: a [`Departure`].
//!
//! *Measured surface.* Of two feet `p` and `b`, the mirror image of `b` in the plane through `p` that is
//! normal to the tangential direction from `b` to `p` continues the surface beyond `p`. It lies on the
//! surface if this is a plane, a ball, or a cylinder that is continued along or across. Its distance from the
//! measured surface, as a share of the distance of the feet, is the departure. Readings are often missing
//! because the surface turns away from the sensor, so rims of openings are at edges more often than by
//! chance: a high quantile counts.
//!
//! *Closing surface.* Beyond the nearest foot `p` of an unobserved place, the measured surface continues as a
//! circle: tangent at `p`, and through a foot as far on the other side of `p` as the place. The distance of
//! the place from this circle is what the measured surface does not explain. An opening has one share, since
//! nothing shows where within it the object turns.

use super::openings::{UnobservedCell, openings};
use crate::fit::support::{Supporters, search_tree};
use crate::model::{Departure, SurfaceModel};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use planish_core::DVec3;
use planish_core::vector3::tangents;
use planish_estimate::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Smallest distance of two feet, in spacings, and ratio of successive distances.
const SMALLEST_DISTANCE: f64 = 2.0;
const DISTANCE_STEP: f64 = 1.5;
/// Largest number of distances: 1.5¹⁹ is 2200.
const MAX_DISTANCES: usize = 20;
/// Pairs of feet of each distance, and how many of them must be of use. Others have no foot near the wanted
/// distance, or are continued into an opening.
const PAIRS: usize = 2000;
const MIN_PAIRS: usize = 40;
/// Limits of the distance of two feet, as shares of the wanted one.
const OF_DISTANCE: [f64; 2] = [0.5, 1.6];
/// Quantile of the shares of the measured surface that counts.
const QUANTILE_OF_PAIRS: f64 = 0.98;
/// Quantile over the area of an opening that counts. A part of a closing surface crosses the continuation of
/// the rim in any case.
const QUANTILE_OF_OPENING: f64 = 0.9;
/// An opening shows how it is closed far from its rim: beyond this share of its largest distance.
const FAR_SHARE: f64 = 1.0 / 3.0;
/// Largest distance in spacings of openings that are too small to show how they are closed.
const SMALL_OPENING: f64 = 3.0;
/// Smallest cosine between the normals of feet of which one continues the other. Opposite sides of a thin
/// wall have less.
const MIN_COSINE: f64 = -0.3;
/// Smallest distance behind the rim of the foot that shows its curvature, as a share of the place's distance.
const MIN_BEHIND: f64 = 0.3;

/// How far the places without readings may depart from the object.
///
/// # Errors
/// `Undetermined` if places cannot be searched.
pub(super) fn departure(
    model: &SurfaceModel,
    measured: &Supporters,
    cells: &[UnobservedCell],
) -> Result<Departure> {
    let spacing = measured.median_spacing();
    let reach = cells.iter().map(|cell| cell.distance).fold(0.0, f64::max);
    let mut of_leaf = vec![0.0; model.surface.space().leaves().len()];
    for opening in openings(model, cells) {
        let share = share_of_opening(measured, spacing, &opening);
        for cell in opening {
            of_leaf[cell.leaf] = share;
        }
    }
    let places: Vec<DVec3> = cells.iter().map(|cell| cell.place).collect();
    let open = search_tree(&places)?;
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut by_distance = Vec::new();
    // Shares increase: what the surface does within a distance, it may do beyond.
    let mut largest = 0.0_f64;
    for step in 0..MAX_DISTANCES {
        let distance = SMALLEST_DISTANCE * spacing * DISTANCE_STEP.powi(step as i32);
        let Some(share) = share_at(measured, &open, spacing, distance, &mut rng) else { break };
        largest = largest.max(share);
        by_distance.push([distance, largest]);
        if distance > reach {
            break;
        }
    }
    // Too little is seen to show anything: faces may turn at any place.
    if by_distance.is_empty() {
        by_distance.push([spacing, 1.0]);
    }
    Departure::new(by_distance, of_leaf)
}

/// The share by which pairs of feet at a distance depart from the measured surface; none if there are too
/// few.
fn share_at(
    measured: &Supporters,
    open: &ImmutableKdTree<f64, 3>,
    spacing: f64,
    distance: f64,
    rng: &mut ChaCha8Rng,
) -> Option<f64> {
    let count = measured.points().len();
    let draws: Vec<(usize, f64)> =
        (0..PAIRS).map(|_| (rng.random_range(0..count), TAU * rng.random::<f64>())).collect();
    let mut shares: Vec<f64> = (draws.par_iter().with_min_len(64))
        .filter_map(|&(k, angle)| share_of_pair(measured, open, spacing, distance, (k, angle)))
        .collect();
    if shares.len() < MIN_PAIRS {
        return None;
    }
    let rank = (QUANTILE_OF_PAIRS * shares.len() as f64) as usize;
    Some(*shares.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// The departure of the continuation beyond foot `k` of the surface in a direction; none if there is no foot
/// in that direction, or no reading where it continues.
fn share_of_pair(
    measured: &Supporters,
    open: &ImmutableKdTree<f64, 3>,
    spacing: f64,
    wanted: f64,
    (k, angle): (usize, f64),
) -> Option<f64> {
    let (p, normal) = (measured.points()[k], measured.normals()[k]);
    let (e1, e2) = tangents(normal);
    let behind = measured.nearest_foot(p + wanted * (angle.cos() * e1 + angle.sin() * e2))?;
    let to = behind.point - p;
    let (distance, tangential) = (to.length(), to - to.dot(normal) * normal);
    let is_wanted = (OF_DISTANCE[0] * wanted..OF_DISTANCE[1] * wanted).contains(&distance);
    if !is_wanted || behind.normal.dot(normal) < MIN_COSINE || tangential.length() < 0.5 * distance {
        return None;
    }
    let image = behind.point - 2.0 * tangential;
    let found = measured.nearest_foot(image)?;
    let from_foot = image - found.point;
    let across = from_foot.dot(found.normal).abs();
    let along = (from_foot.length_squared() - across * across).max(0.0).sqrt();
    // The nearest foot of an image above an opening is at its rim.
    let from_opening = open.query(found.point.as_ref()).nearest_one::<SquaredEuclidean<f64>>().execute();
    let is_at_rim = from_opening.distance.sqrt() < 2.0 * spacing && across < 0.95 * from_foot.length();
    if is_at_rim || along > distance {
        return None;
    }
    let departure = if along < 2.0 * spacing { across } else { from_foot.length() };
    Some((departure / distance).min(1.0))
}

/// The share by which the closing surface of an opening departs from the continuation of its rim; 0 if it is
/// too small to show this.
fn share_of_opening(measured: &Supporters, spacing: f64, opening: &[&UnobservedCell]) -> f64 {
    let reach = opening.iter().map(|cell| cell.distance).fold(0.0, f64::max);
    if reach < SMALL_OPENING * spacing {
        return 0.0;
    }
    let mut shares: Vec<(f64, f64)> = (opening.par_iter().with_min_len(64))
        .filter(|cell| cell.distance > FAR_SHARE * reach)
        .map(|cell| (share_of_place(measured, cell), cell.area))
        .collect();
    shares.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = shares.iter().map(|(_, area)| area).sum();
    let mut sum = 0.0;
    let at_quantile = shares.iter().find(|(_, area)| {
        sum += area;
        sum >= QUANTILE_OF_OPENING * total
    });
    at_quantile.or(shares.last()).map_or(0.0, |(share, _)| *share)
}

/// The distance of a place from the continuation of its nearest foot, as a share of its distance to it. All
/// of it if no foot behind shows how the surface continues.
fn share_of_place(measured: &Supporters, cell: &UnobservedCell) -> f64 {
    let Some(rim) = measured.nearest_foot(cell.place) else { return 1.0 };
    let to = cell.place - rim.point;
    let height = to.dot(rim.normal);
    let tangential = to - height * rim.normal;
    let (length, distance) = (tangential.length(), to.length());
    let Some(direction) = tangential.try_normalize() else { return 1.0 };
    let Some(behind) = measured.nearest_foot(rim.point - distance * direction) else { return 1.0 };
    let back = behind.point - rim.point;
    let (run, rise) = (-back.dot(direction), back.dot(rim.normal));
    if run < MIN_BEHIND * distance || behind.normal.dot(rim.normal) < MIN_COSINE {
        return 1.0;
    }
    // The circle that is tangent at the rim and passes through the foot behind it.
    let curvature = 2.0 * rise / (run * run + rise * rise);
    let departure = match curvature.abs() * distance > 1e-6 {
        true => (length.hypot(height - 1.0 / curvature) - 1.0 / curvature.abs()).abs(),
        false => height.abs(),
    };
    (departure / distance).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points with normals on a body, by a function of random numbers.
    fn readings(seed: u64, place: impl Fn(&mut ChaCha8Rng) -> (DVec3, DVec3)) -> Supporters {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (points, normals) = (0..6000).map(|_| place(&mut rng)).unzip();
        Supporters::new(points, normals).unwrap().unwrap()
    }

    fn on_box(rng: &mut ChaCha8Rng) -> (DVec3, DVec3) {
        let mut p = DVec3::from_array([0; 3].map(|_| rng.random_range(-10.0..10.0)));
        let (axis, side) = (rng.random_range(0..3), if rng.random() { 1.0 } else { -1.0 });
        p[axis] = 10.0 * side;
        let mut normal = DVec3::ZERO;
        normal[axis] = side;
        (p, normal)
    }

    /// A torus of radii 20 and 8, by angles of its ring and its tube.
    fn on_torus(rng: &mut ChaCha8Rng) -> (DVec3, DVec3) {
        let [u, v] = [0; 2].map(|_| TAU * rng.random::<f64>());
        let normal = DVec3::new(v.cos() * u.cos(), v.cos() * u.sin(), v.sin());
        (20.0 * DVec3::new(u.cos(), u.sin(), 0.0) + 8.0 * normal, normal)
    }

    fn on_ball(rng: &mut ChaCha8Rng) -> (DVec3, DVec3) {
        loop {
            let p = DVec3::from_array([0; 3].map(|_| rng.random_range(-1.0..1.0)));
            if let Some(normal) = p.try_normalize().filter(|_| p.length() < 1.0) {
                return (15.0 * normal, normal);
            }
        }
    }

    /// The share at a distance on a body without openings.
    fn share(measured: &Supporters, distance: f64) -> f64 {
        let open = search_tree(&[DVec3::splat(1e6)]).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        share_at(measured, &open, measured.median_spacing(), distance, &mut rng).unwrap()
    }

    #[test]
    fn edges_depart_by_most_of_the_distance_and_smooth_bodies_by_little() {
        for seed in 0..3 {
            let [edged, ball, torus] =
                [readings(seed, on_box), readings(seed, on_ball), readings(seed, on_torus)];
            for distance in [2.0, 4.0, 8.0] {
                let shares = [&edged, &ball, &torus].map(|body| share(body, distance));
                assert!(shares[0] > 0.55, "seed {seed}, box at {distance}: {}", shares[0]);
                assert!(shares[1] < 0.05, "seed {seed}, ball at {distance}: {}", shares[1]);
                assert!(shares[2] < 0.25, "seed {seed}, torus at {distance}: {}", shares[2]);
            }
        }
    }

    /// A half ball and a tube, both open below, continued as a ball.
    #[test]
    fn a_cap_continues_a_ball_but_not_a_tube() {
        let half = readings(4, |rng| {
            loop {
                let (p, normal) = on_ball(rng);
                if p.z > 0.0 {
                    return (p, normal);
                }
            }
        });
        let tube = readings(5, |rng| {
            let angle = TAU * rng.random::<f64>();
            let normal = DVec3::new(angle.cos(), angle.sin(), 0.0);
            (15.0 * normal + DVec3::new(0.0, 0.0, rng.random_range(0.0..40.0)), normal)
        });
        // The lower half of the ball, beyond both.
        let place = DVec3::new(3.0, 2.0, -14.0).normalize() * 15.0;
        let shares = [half, tube].map(|measured| {
            let distance = measured.nearest_foot(place).unwrap().point.distance(place);
            share_of_place(&measured, &UnobservedCell { leaf: 0, place, distance, area: 1.0 })
        });
        assert!(shares[0] < 0.15 && shares[1] > 0.4, "{shares:?}");
    }
}
