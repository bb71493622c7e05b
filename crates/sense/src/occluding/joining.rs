//! Joins points to strips: rejects inconsistent matches, adds the model error of the circle, and finds
//! connected components.
//!
//! In: points with their matches. Out: points ordered by strip.
//!
//! A match must be mutual: it has a depth itself, and its own match in the first view is next to the point. A
//! contour that splits, or that another part occludes, is therefore not joined to the wrong one.

use super::circle::add_along;
use super::matching::Found;
use super::organised::{Following, relaxed, triangles};
use super::{OccludingOptions, OccludingPoint, Ready, Spot};
use planish_core::{DVec3, DisjointSets};

/// Maximum distance of a mutual match along the contour, in steps. Both matches are rounded to points, so an
/// exact match can differ by one step.
const MAX_MUTUAL_STEPS: f64 = 2.5;
/// Maximum distance of neighbours along a contour, as a multiple of the step, in addition to their σ.
const MAX_NEIGHBOUR_STEPS: f64 = 4.0;
/// Number of neighbours on either side whose changes of radius are averaged. More reduce noise and blur
/// changes along the contour.
const AVERAGED_NEIGHBOURS: usize = 3;
/// Upper limit of σ of a normal, in degrees: about that of a uniformly random direction.
const MAX_NORMAL_DEG: f64 = 60.0;

type Places = Vec<Vec<Vec<Result<Found, &'static str>>>>;
/// View, line and place.
type Key = (usize, usize, usize);

/// The point of a line that is nearest to a length along it.
fn nearest(view: &Ready<'_>, spot: Spot) -> usize {
    let line = &view.lines[spot.line];
    let count = line.places.len();
    let k = (spot.length / line.step).round().max(0.0) as usize;
    if line.curve.closed() { k % count } else { k.min(count - 1) }
}

fn found(places: &Places, (view, line, place): Key) -> Option<&Found> {
    places[view][line][place].as_ref().ok()
}

/// The point next to the match in the neighbouring view, on side 0 or 1.
fn linked(
    ready: &[Ready<'_>],
    neighbours: &[[Option<usize>; 2]],
    places: &Places,
    key: Key,
    side: usize,
) -> Option<Key> {
    let other = neighbours[key.0][side]?;
    let spot = found(places, key)?.spots[side];
    Some((other, spot.line, nearest(&ready[other], spot)))
}

/// The accepted points, strip by strip.
pub(super) struct Joined {
    pub points: Vec<OccludingPoint>,
    /// Their positions with regularised depths.
    pub relaxed: Vec<DVec3>,
    pub triangles: Vec<[u32; 3]>,
    pub strips: usize,
}

/// Rejects points with inconsistent matches, and joins the others to strips.
pub(super) fn joined(
    ready: &[Ready<'_>],
    neighbours: &[[Option<usize>; 2]],
    places: &mut Places,
    options: &OccludingOptions,
) -> Joined {
    let keys = keys(places);
    // All tests refer to the original matches; removing points at once would make the result depend on their
    // order.
    let wrong: Vec<Key> = (keys.iter().copied())
        .filter(|key| (0..2).any(|side| !is_mutual(ready, neighbours, places, *key, side)))
        .collect();
    for (view, line, place) in wrong {
        places[view][line][place] = Err("not_mutual");
    }
    let keys = self::keys(places);
    let changes: Vec<f64> = keys.iter().map(|key| changing(ready, neighbours, places, *key)).collect();
    let of_key: std::collections::BTreeMap<Key, usize> =
        keys.iter().enumerate().map(|(k, key)| (*key, k)).collect();
    let mut points: Vec<OccludingPoint> =
        (keys.iter()).map(|key| point(ready, places, &of_key, &changes, *key)).collect();
    // Strips, by links along contours and between views.
    let mut strips = DisjointSets::new(keys.len());
    let mut reach = vec![0.0_f64; keys.len()];
    let mut following = Following { along: vec![None; keys.len()], across: vec![None; keys.len()] };
    for (k, key) in keys.iter().enumerate() {
        let along = next_along(ready, *key).and_then(|next| of_key.get(&next));
        let across = linked(ready, neighbours, places, *key, 1).and_then(|next| of_key.get(&next));
        for (is_along, other) in [(true, along), (false, across)] {
            let Some(&other) = other else { continue };
            let apart = points[k].position.distance(points[other].position);
            // Neighbours may differ by their errors, by one step along the surface, and by the motion of the
            // contact between views. A larger distance is a jump between surfaces.
            let uncertainty = 3.0 * points[k].sigma_depth.hypot(points[other].sigma_depth);
            let step = ready[key.0].lines[key.1].step * width(ready, *key, &points[k]);
            // Between views a contour point slides over the surface by its radius times the angle.
            let glide = if is_along { 0.0 } else { 2.0 * turn(places, *key) * points[k].radius.abs() };
            if apart <= MAX_NEIGHBOUR_STEPS * step + uncertainty + glide {
                strips.join(k as u32, other as u32);
                let next = if is_along { &mut following.along } else { &mut following.across };
                next[k] = Some(other);
                reach[k] = reach[k].max(apart);
                reach[other] = reach[other].max(apart);
            }
        }
    }
    let roots: Vec<usize> = strips.into_roots().into_iter().map(|root| root as usize).collect();
    let mut size = vec![0; keys.len()];
    roots.iter().for_each(|r| size[*r] += 1);
    let mut order: Vec<usize> =
        (0..keys.len()).filter(|r| size[*r] >= options.min_strip_points.max(1)).collect();
    // Largest strip first; ties by number, so that the order is the same in every run.
    order.sort_by_key(|r| (std::cmp::Reverse(size[*r]), *r));
    let strip_of: std::collections::BTreeMap<usize, usize> =
        order.iter().enumerate().map(|(s, r)| (*r, s)).collect();
    let mut kept: Vec<usize> = Vec::new();
    for k in 0..keys.len() {
        let (view, line, place) = keys[k];
        match strip_of.get(&roots[k]) {
            Some(strip) => {
                points[k].strip = *strip;
                points[k].reach = reach[k];
                kept.push(k);
            }
            None => places[view][line][place] = Err("speck"),
        }
    }
    kept.sort_by_key(|k| points[*k].strip);
    let mut index = vec![None; keys.len()];
    kept.iter().enumerate().for_each(|(new, old)| index[*old] = Some(new));
    let moved = |next: &[Option<usize>]| kept.iter().map(|k| index[next[*k]?]).collect();
    let following = Following { along: moved(&following.along), across: moved(&following.across) };
    let ways: Vec<DVec3> =
        (kept.iter()).map(|k| found(places, keys[*k]).map_or(DVec3::ZERO, |f| f.sight.way)).collect();
    let points: Vec<OccludingPoint> = kept.iter().map(|k| points[*k]).collect();
    let relaxed = relaxed(&points, &ways, &following);
    Joined { triangles: triangles(&points, &relaxed, &following), points, relaxed, strips: order.len() }
}

fn keys(places: &Places) -> Vec<Key> {
    let mut keys = Vec::new();
    for (view, lines) in places.iter().enumerate() {
        for (line, along) in lines.iter().enumerate() {
            keys.extend((0..along.len()).filter(|k| along[*k].is_ok()).map(|k| (view, line, k)));
        }
    }
    keys
}

/// True if the match on a side is mutual. A view at the end of its sequence has no depths, so that its
/// matches cannot be checked.
fn is_mutual(
    ready: &[Ready<'_>],
    neighbours: &[[Option<usize>; 2]],
    places: &Places,
    key: Key,
    side: usize,
) -> bool {
    let Some((view, line, place)) = linked(ready, neighbours, places, key, side) else {
        return true;
    };
    if neighbours[view].contains(&None) {
        return true;
    }
    let count = places[view][line].len();
    let own = &ready[key.0].lines[key.1];
    [0, 1, count - 1].into_iter().any(|by| {
        let Some(match_point) = found(places, (view, line, (place + by) % count)) else {
            return false;
        };
        let back = match_point.spots[1 - side];
        back.line == key.1
            && own.curve.between(back.length, key.2 as f64 * own.step) <= MAX_MUTUAL_STEPS * own.step
    })
}

fn next_along(ready: &[Ready<'_>], (view, line, place): Key) -> Option<Key> {
    let contour = &ready[view].lines[line];
    let next = place + 1;
    match (next < contour.places.len(), contour.curve.closed()) {
        (true, _) => Some((view, line, next)),
        (false, true) => Some((view, line, 0)),
        (false, false) => None,
    }
}

/// The width of a pixel at a point.
fn width(ready: &[Ready<'_>], key: Key, point: &OccludingPoint) -> f64 {
    let eye = &ready[key.0].eye;
    eye.centre.distance(point.position) * eye.pixel()
}

fn turn(places: &Places, key: Key) -> f64 {
    found(places, key).map_or(0.0, |f| f.placed.solved.angles.iter().fold(0.0, |a, b| a.max(b.abs())))
}

/// `R'²`: the squared change of the radius with the angle, corrected for noise. Without a neighbour, the
/// square of the radius itself.
fn changing(ready: &[Ready<'_>], neighbours: &[[Option<usize>; 2]], places: &Places, key: Key) -> f64 {
    let Some(own) = found(places, key) else { return 0.0 };
    let side = |side: usize| {
        let other = linked(ready, neighbours, places, key, side)?;
        let other = found(places, other)?;
        let angle = own.placed.solved.angles[side].abs();
        Some((other.placed.solved.radius, other.placed.radius, angle))
    };
    let own_side = (own.placed.solved.radius, own.placed.radius, 0.0);
    let (a, b) = match (side(0), side(1)) {
        (Some(a), Some(b)) => (a, b),
        (Some(a), None) => (a, own_side),
        (None, Some(b)) => (own_side, b),
        (None, None) => return own.placed.solved.radius.powi(2),
    };
    let turn = a.2 + b.2;
    // The difference of two noisy radii is too large on average by the sum of their variances.
    ((b.0 - a.0).powi(2) - a.1 - b.1) / (turn * turn)
}

fn point(
    ready: &[Ready<'_>],
    places: &Places,
    of_key: &std::collections::BTreeMap<Key, usize>,
    changes: &[f64],
    key: Key,
) -> OccludingPoint {
    let Some(own) = found(places, key) else { unreachable!("keys are of places that were found") };
    let (view, line, place) = key;
    // The change of radius is smooth along the contour, so that an average reduces its noise.
    let count = places[view][line].len();
    let closed = ready[view].lines[line].curve.closed();
    let (mut sum, mut of) = (0.0, 0.0);
    for by in 0..=2 * AVERAGED_NEIGHBOURS {
        let k = (place + by) as isize - AVERAGED_NEIGHBOURS as isize;
        let k = if closed { k.rem_euclid(count as isize) } else { k };
        if let Some(index) = usize::try_from(k).ok().and_then(|k| of_key.get(&(view, line, k))) {
            sum += changes[*index];
            of += 1.0;
        }
    }
    let change = (sum / of).max(0.0).sqrt();
    let solved = own.placed.solved;
    // The first neglected term of the depth, for a radius that changes linearly with the angle.
    let circle = change * (solved.angles[0] * solved.angles[1]).abs() / 6.0;
    let mut covariance = own.placed.covariance;
    add_along(&mut covariance, own.sight.way, circle * circle);
    let depth = own.placed.depth + circle * circle;
    // An error δ along the line of sight moves the point off the surface by δ²/2R, but at most by δ.
    let radius = solved.radius.max(own.placed.radius.sqrt());
    let bend = (0.75 * depth * depth / (radius * radius)).min(depth);
    add_along(&mut covariance, own.sight.normal, bend);
    // An error of depth tilts the normal about the tangent of the contour; an error of the tangent tilts it
    // about the line of sight.
    let tilt = (0.5 * (depth / (radius * radius) + own.local.sigma_turn.powi(2))).sqrt();
    OccludingPoint {
        view,
        contour: line,
        place,
        pixel: own.local.place,
        position: own.placed.position,
        covariance,
        normal: own.sight.normal,
        sigma_normal_deg: tilt.to_degrees().min(MAX_NORMAL_DEG),
        sigma_depth: depth.sqrt(),
        sigma_circle: circle,
        radius: solved.radius,
        sigma_radius: own.placed.radius.sqrt(),
        strip: 0,
        reach: 0.0,
    }
}
